//! What one move does to its surroundings: the input of the policies that look at all open containers.
//!
//! Every feature is a share, or a length over the container's own, so that the same weights work for any grid: a
//! container on a 5 cm grid and the same container on a 1 cm grid give the same numbers. Each is divided by its
//! usual spread within one decision, so that equal weights mean equal influence.
//!
//! The *border* is the cells edge-adjacent to the footprint and the walls that stand in their place; its shares are
//! of the footprint's perimeter. A *side* is one of its four parts; it is *closed* if nothing of it is as low as the
//! base. The *gap* of a side is how far the level of the base goes on behind it, where the side begins and ends.

use packing::{Extent, Placement, Surface};

/// Features of a move.
pub const FEATURES: usize = 28;

/// The features of one move.
pub type Features = [f32; FEATURES];

/// What all moves into one container share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContainerView {
    /// Its number in the order of opening; that of a fresh one is the number of open ones.
    pub rank: u16,
    /// Open containers.
    pub open: u16,
    /// Sum of its heights [cells].
    pub packed_cells: u32,
    /// Its largest height [cells].
    pub highest: u16,
}

impl ContainerView {
    /// A view of a container, by its heights.
    #[must_use]
    pub fn of(surface: &Surface, rank: u16, open: u16) -> Self {
        let packed_cells = surface.heights().iter().map(|&height| u32::from(height)).sum();
        let highest = surface.heights().iter().fold(0, |highest, &height| highest.max(height));
        Self { rank, open, packed_cells, highest }
    }
}

/// One side of the border, counted.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Side {
    walls: u32,
    higher: u32,
    level: u32,
    between: u32,
    same: u32,
    lower: u32,
    /// Sum of the differences to the top [cells].
    variation: u32,
    /// Sum of what lies below the base [cells].
    depth: u32,
}

impl Side {
    fn wall(cells: u16) -> Self {
        Self { walls: cells.into(), ..Self::default() }
    }

    fn add(&mut self, height: u16, base: u16, top: u16) {
        self.higher += u32::from(height > top);
        self.level += u32::from(height == top);
        self.between += u32::from(height > base && height < top);
        self.same += u32::from(height == base);
        self.lower += u32::from(height < base);
        self.variation += u32::from(height.abs_diff(top));
        self.depth += u32::from(base.saturating_sub(height));
    }

    fn of(heights: impl Iterator<Item = u16>, base: u16, top: u16) -> Self {
        let mut side = Self::default();
        heights.for_each(|height| side.add(height, base, top));
        side
    }

    fn plus(self, other: Self) -> Self {
        Self {
            walls: self.walls + other.walls,
            higher: self.higher + other.higher,
            level: self.level + other.level,
            between: self.between + other.between,
            same: self.same + other.same,
            lower: self.lower + other.lower,
            variation: self.variation + other.variation,
            depth: self.depth + other.depth,
        }
    }

    fn is_closed(&self) -> bool {
        self.same + self.lower == 0
    }

    /// All of it as high as the top: the surface goes on.
    fn is_continued(&self, cells: u16) -> bool {
        self.level == u32::from(cells)
    }
}

/// The usual spread of every feature among the moves of one decision, on the standard set.
const SPREAD: Features = [
    0.18, 0.10, 0.075, 0.13, 0.13, 0.15, 0.10, 0.04, 0.16, 0.16, 0.28, 0.24, 0.17, 0.17, 0.22, 0.16, 0.06, 0.10, 0.06,
    0.08, 0.18, 0.10, 0.19, 0.14, 0.22, 0.20, 0.10, 0.04,
];

/// The features of setting a box of `turned` extent down as planned.
#[must_use]
pub fn features(surface: &Surface, view: &ContainerView, turned: Extent, placement: Placement) -> Features {
    let size = surface.size();
    let (base, top) = (placement.base, placement.base + turned.height);
    let (i, j) = (usize::from(placement.i), usize::from(placement.j));
    let (i_end, j_end) = (i + usize::from(turned.length), j + usize::from(turned.breadth));
    let (length, breadth, height) = (f32::from(size.length()), f32::from(size.breadth()), f32::from(size.height()));
    let (heights, stride) = (surface.heights(), usize::from(size.breadth()));
    let along = |row: usize| Side::of(heights[row * stride + j..row * stride + j_end].iter().copied(), base, top);
    let column = |column: usize| heights[i * stride + column..].iter().step_by(stride).take(i_end - i);
    let across = |j: usize| Side::of(column(j).copied(), base, top);
    let sides = [
        if i == 0 { Side::wall(turned.breadth) } else { along(i - 1) },
        if i_end == usize::from(size.length()) { Side::wall(turned.breadth) } else { along(i_end) },
        if j == 0 { Side::wall(turned.length) } else { across(j - 1) },
        if j_end == usize::from(size.breadth()) { Side::wall(turned.length) } else { across(j_end) },
    ];
    let cells = [turned.breadth, turned.breadth, turned.length, turned.length];
    let border = sides.into_iter().fold(Side::default(), Side::plus);
    let perimeter = 2.0 * (f32::from(turned.length) + f32::from(turned.breadth));
    let share = |cells: u32| cells as f32 / perimeter;
    let closed = sides.map(|side| side.is_closed());
    let count = |flags: [bool; 4]| flags.into_iter().filter(|&flag| flag).count() as f32;
    let flag = |flag: bool| f32::from(u8::from(flag));
    let continued = [0, 1, 2, 3].map(|side| sides[side].is_continued(cells[side]));
    let gaps = gaps(surface, (i, i_end), (j, j_end), base);
    let thin = |gap: f32| if gap > 0.0 { (1.0 - gap / 0.25).max(0.0) } else { 0.0 };
    let open_gap = |side: usize| if closed[side] { 0.0 } else { gaps[side] };
    let headroom = (height - f32::from(top)) / height;
    let volume = size.volume_cells() as f32;
    let fill = view.packed_cells as f32 / volume;
    let raw = [
        share(border.walls),
        share(border.higher),
        share(border.level),
        share(border.between),
        share(border.same),
        share(border.lower),
        share(border.variation) / height,
        share(border.depth) / height,
        f32::from(base) / height,
        f32::from(top) / height,
        flag(base == 0),
        flag(headroom == 0.0),
        if headroom > 0.0 { (1.0 - headroom / 0.3).max(0.0) } else { 0.0 },
        count(closed) / 4.0,
        flag(closed[0] && closed[1]),
        flag(closed[2] && closed[3]),
        count(continued) / 4.0,
        gaps.map(thin).iter().sum::<f32>() / 4.0,
        (0..4).map(open_gap).sum::<f32>() / 4.0,
        f32::from(top.saturating_sub(view.highest)) / height,
        (f32::from(placement.i) + f32::from(placement.j)) / (length + breadth),
        f32::from(view.rank) / 16.0,
        f32::from(view.open.saturating_sub(view.rank)).min(8.0) / 8.0,
        fill,
        f32::from(turned.length) / length - f32::from(turned.breadth) / breadth,
        // These are the same for all moves of one box: they only bend the others through the hidden layer.
        f32::from(turned.height) / height,
        f32::from(turned.length) * f32::from(turned.breadth) / (length * breadth),
        turned.volume_cells() as f32 / volume,
    ];
    let mut scaled = raw;
    scaled.iter_mut().zip(SPREAD).for_each(|(feature, spread)| *feature /= spread);
    scaled
}

/// The gap of every side as a share of the container: the mean of how far the level of the base goes on outwards
/// from the side's first and last cell.
fn gaps(surface: &Surface, (i, i_end): (usize, usize), (j, j_end): (usize, usize), base: u16) -> [f32; 4] {
    let (length, breadth) = (usize::from(surface.size().length()), usize::from(surface.size().breadth()));
    let heights = surface.heights();
    let up = |column: usize| (0..i).rev().take_while(|&row| heights[row * breadth + column] == base).count();
    let down = |column: usize| (i_end..length).take_while(|&row| heights[row * breadth + column] == base).count();
    let left = |row: usize| surface.row(row)[..j].iter().rev().take_while(|&&height| height == base).count();
    let right = |row: usize| surface.row(row)[j_end..].iter().take_while(|&&height| height == base).count();
    let mean = |first: usize, last: usize, whole: usize| (first + last) as f32 / (2 * whole) as f32;
    [
        mean(up(j), up(j_end - 1), length),
        mean(down(j), down(j_end - 1), length),
        mean(left(i), left(i_end - 1), breadth),
        mean(right(i), right(i_end - 1), breadth),
    ]
}
