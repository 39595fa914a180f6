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

#[cfg(test)]
mod tests {
    use packing::{ContainerSize, Yaw};
    use proptest::prelude::*;

    use super::*;

    fn extent(length: u16, breadth: u16, height: u16) -> Extent {
        Extent { length, breadth, height }
    }

    fn at(i: u16, j: u16, base: u16) -> Placement {
        Placement { slot: 0, yaw: Yaw::Deg0, i, j, base }
    }

    /// A 5 x 8 container of height 10 with a 2 x 2 x 4 box in its corner.
    fn step() -> Surface {
        let mut surface = Surface::empty(ContainerSize::new(5, 8, 10, 10).unwrap());
        surface.place(extent(2, 2, 4), 0, 0).unwrap();
        surface
    }

    /// A 2 x 1 x 3 box at (0, 2), right of the box: perimeter 6, of which 1 is wall, 2 are higher, 3 at the base.
    #[test]
    fn a_move_on_the_floor_by_hand() {
        let surface = step();
        let view = ContainerView::of(&surface, 1, 3);
        assert_eq!(view, ContainerView { rank: 1, open: 3, packed_cells: 16, highest: 4 });
        let found = features(&surface, &view, extent(2, 1, 3), at(0, 2, 0));
        let gaps = [0.0, 3.0 / 5.0, 0.0, 5.0 / 8.0];
        let expected = [
            1.0 / 6.0,                 // walls
            2.0 / 6.0,                 // higher than the top
            0.0,                       // level with it
            0.0,                       // between
            3.0 / 6.0,                 // as low as the base
            0.0,                       // lower
            (2.0 + 3.0 * 3.0) / 60.0,  // |4 - 3| twice, |0 - 3| three times
            0.0,                       // depth
            0.0,                       // base
            0.3,                       // top
            1.0,                       // on the floor
            0.0,                       // not at the limit
            0.0,                       // 70 % of the height is left
            2.0 / 4.0,                 // closed above and on the left
            0.0,                       // not between two closed sides along i
            0.0,                       // nor along j
            0.0,                       // no side continues the top
            0.0,                       // no gap is thin
            (gaps[1] + gaps[3]) / 4.0, // open gaps
            0.0,                       // not above the highest box
            2.0 / 13.0,                // position
            1.0 / 16.0,                // rank
            2.0 / 8.0,                 // containers opened since
            16.0 / 400.0,              // fill
            2.0 / 5.0 - 1.0 / 8.0,     // direction
            0.3,                       // the box's height
            2.0 / 40.0,                // its footprint
            6.0 / 400.0,               // its volume
        ];
        for (k, (found, expected)) in found.iter().zip(expected).enumerate() {
            let found = found * SPREAD[k];
            assert!((found - expected).abs() < 1e-6, "feature {k}: {found} and not {expected}");
        }
    }

    /// A 2 x 2 x 6 box on top of the other: walls on two sides, the floor 4 below on the others, flush with the limit.
    #[test]
    fn a_move_on_top_by_hand() {
        let surface = step();
        let found = features(&surface, &ContainerView::of(&surface, 0, 1), extent(2, 2, 6), at(0, 0, 4));
        let check = |k: usize, expected: f32| {
            let found = found[k] * SPREAD[k];
            assert!((found - expected).abs() < 1e-6, "feature {k}: {found} and not {expected}");
        };
        check(0, 0.5);
        check(5, 0.5);
        check(6, 4.0 * 10.0 / 8.0 / 10.0);
        check(7, 4.0 * 4.0 / 8.0 / 10.0);
        check(8, 0.4);
        check(11, 1.0);
        check(12, 0.0);
        check(13, 0.5);
        check(19, 0.6);
    }

    /// Beside the box, as high as it: its side is continued; three cells before the wall, a gap is thin.
    #[test]
    fn a_continued_side_and_a_thin_gap_by_hand() {
        let surface = step();
        let found = features(&surface, &ContainerView::of(&surface, 0, 1), extent(2, 5, 4), at(0, 2, 0));
        assert!((found[16] * SPREAD[16] - 0.25).abs() < 1e-6);
        // One cell of eight is left on the right: 1 - (1/8) / 0.25 = 0.5; three of five below are not thin.
        assert!((found[17] * SPREAD[17] - 0.5 / 4.0).abs() < 1e-6);
    }

    proptest! {
        #[test]
        fn a_finer_grid_gives_the_same_features(
            drops in prop::collection::vec((1u16..4, 1u16..5, 1u16..4, 0u16..6, 0u16..8), 0..16),
            next in (1u16..4, 1u16..5, 1u16..4),
        ) {
            let mut coarse = Surface::empty(ContainerSize::new(6, 8, 7, 50).unwrap());
            let mut fine = Surface::empty(ContainerSize::new(30, 40, 35, 10).unwrap());
            for (l, b, h, i, j) in drops {
                if coarse.place(extent(l, b, h), i, j).is_ok() {
                    fine.place(extent(5 * l, 5 * b, 5 * h), 5 * i, 5 * j).unwrap();
                }
            }
            let (turned, wide) = (extent(next.0, next.1, next.2), extent(5 * next.0, 5 * next.1, 5 * next.2));
            let (a, b) = (ContainerView::of(&coarse, 2, 4), ContainerView::of(&fine, 2, 4));
            for i in 0..6 {
                for j in 0..8 {
                    let Ok(base) = coarse.rest(turned, i, j) else { continue };
                    let expected = features(&coarse, &a, turned, at(i, j, base));
                    let found = features(&fine, &b, wide, at(5 * i, 5 * j, 5 * base));
                    for k in 0..FEATURES {
                        prop_assert!((found[k] - expected[k]).abs() < 1e-5, "feature {k}: {found:?} {expected:?}");
                    }
                }
            }
        }
    }
}
