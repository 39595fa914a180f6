//! The heights of one container, made ready for questions.

use std::ops::Range;

use crate::{ContainerSize, Extent, Rules, Support};

/// Corners that have room from the start: more than a nearly full container of lattice boxes has.
const CORNERS_RESERVED: usize = 256;

/// One container seen from above: the height of every cell, row by row along `i`.
///
/// Beside the heights it keeps what makes feasibility cheap, refreshed only where a box changed it: how many
/// cells from each cell on, along `i` and along `j`, share its height, and the cells that are [`Corner`]s.
#[derive(Debug)]
pub struct Surface {
    size: ContainerSize,
    rules: Rules,
    /// The largest difference of heights that counts as level.
    level_cells: u16,
    heights: Vec<u16>,
    /// Cells from here on along `i` that have this cell's height, at least 1.
    run_i: Vec<u16>,
    /// Cells from here on along `j` that have this cell's height, at least 1.
    run_j: Vec<u16>,
    /// In scan order, so that what is derived from it is deterministic.
    corners: Vec<Corner>,
}

/// A cell at which a footprint's corner meets a corner of the container or of the loaded structure.
///
/// At least one pair of neighbours (one along `i`, one along `j`) is a wall or not level with the cell. Paper: "Conceptual approach" and figure 5. It depends on the surface alone, not on any box.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Corner {
    /// The cell along `i`.
    pub i: u16,
    /// The cell along `j`.
    pub j: u16,
    /// The neighbour towards smaller `i` is a wall or not level.
    pub towards_low_i: bool,
    /// The neighbour towards larger `i` is a wall or not level.
    pub towards_high_i: bool,
    /// The neighbour towards smaller `j` is a wall or not level.
    pub towards_low_j: bool,
    /// The neighbour towards larger `j` is a wall or not level.
    pub towards_high_j: bool,
}

/// Why a box cannot stand somewhere.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Infeasible {
    /// The footprint leaves the container.
    #[error("the footprint leaves the container")]
    OutsideFootprint,
    /// The cells under the base have different heights.
    #[error("the cells under the base have different heights")]
    NotLevel,
    /// Too little of the base would rest on something.
    #[error("too little of the base would rest on something")]
    Unsupported,
    /// The top would exceed the height limit.
    #[error("the top would exceed the height limit")]
    TooHigh,
}

/// A copy has room for as many corners as any; copying over one that there is allocates nothing.
impl Clone for Surface {
    fn clone(&self) -> Self {
        let (heights, run_i, run_j) = (self.heights.clone(), self.run_i.clone(), self.run_j.clone());
        let mut corners = Vec::with_capacity(self.corners.len().max(CORNERS_RESERVED));
        corners.extend_from_slice(&self.corners);
        Self { size: self.size, rules: self.rules, level_cells: self.level_cells, heights, run_i, run_j, corners }
    }

    fn clone_from(&mut self, other: &Self) {
        let Self { size, rules, level_cells, heights, run_i, run_j, corners } = self;
        (*size, *rules, *level_cells) = (other.size, other.rules, other.level_cells);
        heights.clone_from(&other.heights);
        run_i.clone_from(&other.run_i);
        run_j.clone_from(&other.run_j);
        corners.clone_from(&other.corners);
    }
}

impl Surface {
    /// An empty container that is filled by the paper's rules.
    #[must_use]
    pub fn empty(size: ContainerSize) -> Self {
        Self::with_rules(size, Rules::default())
    }

    /// An empty container that is filled by these rules.
    #[must_use]
    pub fn with_rules(size: ContainerSize, rules: Rules) -> Self {
        let nothing = vec![0; size.footprint_cells()];
        let (run_i, run_j) = (nothing.clone(), nothing.clone());
        let (level_cells, corners) = (rules.level_cells(size.cell_mm()), Vec::with_capacity(CORNERS_RESERVED));
        let mut surface = Self { size, rules, level_cells, heights: nothing, run_i, run_j, corners };
        surface.refresh(0..usize::from(size.length()), 0..usize::from(size.breadth()));
        surface
    }

    /// Takes the heights of a container as measured or received, row by row along `i`. What differs is refreshed.
    ///
    /// # Panics
    /// If there are not as many heights as the container has cells.
    pub fn set_heights(&mut self, heights: &[u16]) {
        assert_eq!(heights.len(), self.heights.len(), "the container has {} cells", self.heights.len());
        let breadth = usize::from(self.size.breadth());
        let mut changed: Option<(Range<usize>, Range<usize>)> = None;
        for (row, (old, new)) in self.heights.chunks_exact(breadth).zip(heights.chunks_exact(breadth)).enumerate() {
            let differs = |column: &usize| old[*column] != new[*column];
            if old != new
                && let (Some(first), Some(last)) = ((0..breadth).find(differs), (0..breadth).rfind(differs))
            {
                let (rows, columns) = changed.unwrap_or((row..row, first..last));
                changed = Some((rows.start..row + 1, columns.start.min(first)..columns.end.max(last + 1)));
            }
        }
        if let Some((rows, columns)) = changed {
            self.heights.copy_from_slice(heights);
            self.refresh(rows, columns);
        }
    }

    /// The container's size.
    #[must_use]
    pub fn size(&self) -> ContainerSize {
        self.size
    }

    /// What a box may stand on, and how near to anything.
    #[must_use]
    pub fn rules(&self) -> Rules {
        self.rules
    }

    /// All heights [cells], row by row along `i`.
    #[must_use]
    pub fn heights(&self) -> &[u16] {
        &self.heights
    }

    /// The heights of row `i` [cells].
    #[must_use]
    pub fn row(&self, i: usize) -> &[u16] {
        let breadth = usize::from(self.size.breadth());
        &self.heights[i * breadth..(i + 1) * breadth]
    }

    /// The corners of the container and of the loaded structure, in scan order.
    #[must_use]
    pub fn corners(&self) -> &[Corner] {
        &self.corners
    }

    /// The base height [cells] at which a box of `extent` (already turned) would rest at `(i, j)`.
    ///
    /// This is the definition of feasible, cell by cell: inside the footprint, the base supported as [`Support`]
    /// says by cells that are level with the highest, top not above `H`. Paper: "Robot-implementability".
    ///
    /// # Errors
    /// [`Infeasible`] names the first rule it breaks.
    pub fn rest(&self, extent: Extent, i: u16, j: u16) -> Result<u16, Infeasible> {
        let (Some(i_end), Some(j_end)) = (i.checked_add(extent.length), j.checked_add(extent.breadth)) else {
            return Err(Infeasible::OutsideFootprint);
        };
        if i_end > self.size.length() || j_end > self.size.breadth() {
            return Err(Infeasible::OutsideFootprint);
        }
        let cell = |i: u16, j: u16| self.row(usize::from(i))[usize::from(j)];
        let cells = || (i..i_end).flat_map(|row| &self.row(usize::from(row))[usize::from(j)..usize::from(j_end)]);
        let base = cells().copied().max().unwrap_or(0);
        let carries = |height: u16| base - height <= self.level_cells;
        let level = cells().filter(|&&height| carries(height)).count();
        match self.rules.support {
            Support::Full if level < cells().count() => return Err(Infeasible::NotLevel),
            Support::Partial => {
                let corners = [cell(i, j), cell(i, j_end - 1), cell(i_end - 1, j), cell(i_end - 1, j_end - 1)];
                let level_corners = corners.into_iter().filter(|&height| carries(height)).count();
                if !Support::suffices(level as u64, cells().count() as u64, level_corners) {
                    return Err(Infeasible::Unsupported);
                }
            }
            Support::Full => {}
        }
        if u32::from(base) + u32::from(extent.height) > u32::from(self.size.height()) {
            return Err(Infeasible::TooHigh);
        }
        Ok(base)
    }

    /// Whether the cell carries a box whose base is at `base` [cells].
    pub(crate) fn carries(&self, i: u16, j: u16, base: u16) -> bool {
        base - self.row(usize::from(i))[usize::from(j)] <= self.level_cells
    }

    /// As [`Surface::rest`], fast, for a footprint known to lie inside the container.
    pub(crate) fn rest_inside(&self, extent: Extent, i: usize, j: usize) -> Option<u16> {
        match self.rules.support {
            _ if self.level_cells > 0 => self.rest(extent, i as u16, j as u16).ok(),
            Support::Full => self.rest_level(extent, i, j),
            Support::Partial => self.rest_partial(extent, i, j),
        }
    }

    fn rest_level(&self, extent: Extent, i: usize, j: usize) -> Option<u16> {
        let start = i * usize::from(self.size.breadth()) + j;
        let base = self.heights[start];
        let fits = u32::from(base) + u32::from(extent.height) <= u32::from(self.size.height())
            && self.run_j[start] >= extent.breadth
            && self.run_i[start..start + usize::from(extent.breadth)].iter().all(|&run| run >= extent.length);
        fits.then_some(base)
    }

    /// Goes through the footprint run by run rather than cell by cell.
    fn rest_partial(&self, extent: Extent, i: usize, j: usize) -> Option<u16> {
        let breadth = usize::from(self.size.breadth());
        let (i_end, j_end) = (i + usize::from(extent.length), j + usize::from(extent.breadth));
        let (mut base, mut level) = (0, 0);
        for row in i..i_end {
            for (height, cells) in self.runs_along_j(row as u16, j as u16..j_end as u16) {
                if height > base {
                    (base, level) = (height, 0);
                }
                if height == base {
                    level += u64::from(cells);
                }
            }
        }
        if u32::from(base) + u32::from(extent.height) > u32::from(self.size.height()) {
            return None;
        }
        let rows = [i * breadth, (i_end - 1) * breadth];
        let corners = rows.map(|row| [self.heights[row + j], self.heights[row + j_end - 1]]);
        let level_corners = corners.as_flattened().iter().filter(|&&height| height == base).count();
        let area = u64::from(extent.length) * u64::from(extent.breadth);
        Support::suffices(level, area, level_corners).then_some(base)
    }

    /// The heights [cells] of row `i` from one end of `j` to the other, as runs of equal ones: `(height, cells)`.
    ///
    /// # Panics
    /// If the range leaves the container.
    pub fn runs_along_j(&self, i: u16, j: Range<u16>) -> impl Iterator<Item = (u16, u16)> + '_ {
        let row = usize::from(i) * usize::from(self.size.breadth());
        runs(&self.heights, &self.run_j, row + usize::from(j.start), j.end - j.start, 1)
    }

    /// The heights [cells] of column `j` from one end of `i` to the other, as runs of equal ones: `(height, cells)`.
    ///
    /// # Panics
    /// If the range leaves the container.
    pub fn runs_along_i(&self, i: Range<u16>, j: u16) -> impl Iterator<Item = (u16, u16)> + '_ {
        let breadth = usize::from(self.size.breadth());
        runs(&self.heights, &self.run_i, usize::from(i.start) * breadth + usize::from(j), i.end - i.start, breadth)
    }

    /// All feasible places of a box of `extent` (already turned), in scan order: `(i, j, base)`.
    pub(crate) fn feasible(&self, extent: Extent) -> impl Iterator<Item = (u16, u16, u16)> + '_ {
        let rows = (self.size.length() + 1).saturating_sub(extent.length);
        (0..rows).flat_map(move |i| FeasibleInRow { surface: self, extent, i, j: 0 })
    }

    /// Puts a box of `extent` (already turned) on the surface: its cells rise to its top.
    ///
    /// # Errors
    /// [`Infeasible`] as [`Surface::rest`]; the surface is then unchanged.
    pub fn place(&mut self, extent: Extent, i: u16, j: u16) -> Result<u16, Infeasible> {
        let base = self.rest(extent, i, j)?;
        let breadth = usize::from(self.size.breadth());
        let rows = usize::from(i)..usize::from(i + extent.length);
        let columns = usize::from(j)..usize::from(j + extent.breadth);
        for row in rows.clone() {
            self.heights[row * breadth + columns.start..row * breadth + columns.end].fill(base + extent.height);
        }
        self.refresh(rows, columns);
        Ok(base)
    }

    /// Brings everything up to date after heights changed in these rows and columns.
    fn refresh(&mut self, rows: Range<usize>, columns: Range<usize>) {
        self.refresh_runs_j(rows);
        self.refresh_runs_i(columns);
        self.refresh_corners();
    }

    fn refresh_runs_j(&mut self, rows: Range<usize>) {
        let breadth = usize::from(self.size.breadth());
        for row in rows {
            let heights = &self.heights[row * breadth..(row + 1) * breadth];
            let runs = &mut self.run_j[row * breadth..(row + 1) * breadth];
            let (mut run, mut height) = (0, heights[breadth - 1]);
            for (cell, &h) in runs.iter_mut().zip(heights).rev() {
                run = if h == height { run + 1 } else { 1 };
                height = h;
                *cell = run;
            }
        }
    }

    fn refresh_runs_i(&mut self, columns: Range<usize>) {
        let (length, breadth) = (usize::from(self.size.length()), usize::from(self.size.breadth()));
        let last = (length - 1) * breadth;
        self.run_i[last + columns.start..last + columns.end].fill(1);
        for row in (0..length - 1).rev() {
            let (start, end) = (row * breadth + columns.start, row * breadth + columns.end);
            let (runs, runs_below) = self.run_i.split_at_mut(start + breadth);
            let heights = self.heights[start..end].iter().zip(&self.heights[start + breadth..]);
            for ((run, run_below), (height, below)) in runs[start..end].iter_mut().zip(runs_below).zip(heights) {
                *run = if height == below { *run_below + 1 } else { 1 };
            }
        }
    }

    /// Only the ends of a row's runs can be corners.
    fn refresh_corners(&mut self) {
        let (length, breadth) = (usize::from(self.size.length()), usize::from(self.size.breadth()));
        self.corners.clear();
        let level_cells = self.level_cells;
        for i in 0..length {
            let row = i * breadth;
            let mut j = 0;
            while j < breadth {
                let end = j + usize::from(self.run_j[row + j]);
                let height = self.heights[row + j];
                let differs = |other: usize| self.heights[other].abs_diff(height) > level_cells;
                let is_low_end = j == 0 || differs(row + j - 1);
                let is_high_end = end == breadth || differs(row + end);
                let ends =
                    [(j, is_low_end, is_high_end && j + 1 == end), (end - 1, is_low_end && j + 1 == end, is_high_end)];
                for &(j, towards_low_j, towards_high_j) in if j + 1 == end { &ends[..1] } else { &ends[..] } {
                    let here = row + j;
                    let towards_low_i = i == 0 || differs(here - breadth);
                    let towards_high_i = i + 1 == length || differs(here + breadth);
                    if (towards_low_j || towards_high_j) && (towards_low_i || towards_high_i) {
                        let (i, j) = (i as u16, j as u16);
                        let corner = Corner { i, j, towards_low_i, towards_high_i, towards_low_j, towards_high_j };
                        self.corners.push(corner);
                    }
                }
                j = end;
            }
        }
    }
}

/// The runs of equal heights among the `cells` from `here` on, `step` apart, each at most as long as `run` says.
fn runs<'a>(
    heights: &'a [u16],
    run: &'a [u16],
    mut here: usize,
    mut cells: u16,
    step: usize,
) -> impl Iterator<Item = (u16, u16)> + 'a {
    std::iter::from_fn(move || {
        let length = (cells > 0).then(|| run[here].min(cells))?;
        let height = heights[here];
        cells -= length;
        here += usize::from(length) * step;
        Some((height, length))
    })
}

/// The feasible places of one box in one row, left to right.
struct FeasibleInRow<'a> {
    surface: &'a Surface,
    extent: Extent,
    i: u16,
    j: u16,
}

impl Iterator for FeasibleInRow<'_> {
    type Item = (u16, u16, u16);

    fn next(&mut self) -> Option<Self::Item> {
        match self.surface.rules.support {
            Support::Full if self.surface.level_cells == 0 => self.next_level(),
            Support::Full | Support::Partial => self.next_place(),
        }
    }
}

impl FeasibleInRow<'_> {
    fn next_place(&mut self) -> Option<(u16, u16, u16)> {
        while self.j + self.extent.breadth <= self.surface.size.breadth() {
            self.j += 1;
            if let Some(base) = self.surface.rest_inside(self.extent, self.i.into(), (self.j - 1).into()) {
                return Some((self.i, self.j - 1, base));
            }
        }
        None
    }

    fn next_level(&mut self) -> Option<(u16, u16, u16)> {
        let size = self.surface.size;
        let row = usize::from(self.i) * usize::from(size.breadth());
        while self.j + self.extent.breadth <= size.breadth() {
            let start = row + usize::from(self.j);
            let base = self.surface.heights[start];
            // No place starts on a run that is too short, or too high: the next run is the next hope.
            if self.surface.run_j[start] < self.extent.breadth
                || u32::from(base) + u32::from(self.extent.height) > u32::from(size.height())
            {
                self.j += self.surface.run_j[start];
                continue;
            }
            // The last column that is too short along i rules out every start up to itself.
            let columns = &self.surface.run_i[start..start + usize::from(self.extent.breadth)];
            if let Some(short) = columns.iter().rposition(|&run| run < self.extent.length) {
                self.j += short as u16 + 1;
                continue;
            }
            self.j += 1;
            return Some((self.i, self.j - 1, base));
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::{Draw, Yaw};

    fn extent(length: u16, breadth: u16, height: u16) -> Extent {
        Extent { length, breadth, height }
    }

    /// A small container with boxes dropped wherever they are feasible.
    pub(crate) fn arb_surface() -> impl Strategy<Value = Surface> {
        let support = prop_oneof![Just(Support::Full), Just(Support::Partial)];
        let rules = (support, prop_oneof![Just(0), 10u16..30]).prop_map(|(support, level_mm)| Rules {
            support,
            level_mm,
            ..Rules::default()
        });
        (1u16..9, 1u16..9, 1u16..9, rules).prop_flat_map(|(l, b, h, rules)| {
            let drops = prop::collection::vec((1u16..=l, 1u16..=b, 1u16..=h, 0..l, 0..b), 0..12);
            drops.prop_map(move |drops| {
                let mut surface = Surface::with_rules(ContainerSize::new(l, b, h, 10).unwrap(), rules);
                for (dl, db, dh, i, j) in drops {
                    let _infeasible_drops_are_skipped = surface.place(extent(dl, db, dh), i, j);
                }
                surface
            })
        })
    }

    #[track_caller]
    fn assert_same(a: &Surface, b: &Surface) {
        assert_eq!((&a.run_i, &a.run_j, &a.corners), (&b.run_i, &b.run_j, &b.corners));
    }

    #[test]
    fn figure_3_of_the_paper() {
        let mut surface = Surface::empty(ContainerSize::new(5, 3, 5, 10).unwrap());
        assert_eq!(surface.place(extent(3, 2, 5), 0, 0), Ok(0));
        assert_eq!(surface.heights(), [5, 5, 0, 5, 5, 0, 5, 5, 0, 0, 0, 0, 0, 0, 0]);
    }

    #[test]
    fn the_rules_name_what_is_broken() {
        let mut surface = Surface::empty(ContainerSize::new(4, 4, 5, 10).unwrap());
        surface.place(extent(2, 2, 3), 0, 0).unwrap();
        assert_eq!(surface.rest(extent(2, 2, 2), 0, 0), Ok(3));
        assert_eq!(surface.rest(extent(2, 2, 3), 0, 0), Err(Infeasible::TooHigh));
        assert_eq!(surface.rest(extent(2, 2, 1), 1, 1), Err(Infeasible::NotLevel));
        assert_eq!(surface.rest(extent(2, 2, 1), 3, 0), Err(Infeasible::OutsideFootprint));
        assert_eq!(surface.rest(extent(2, u16::MAX, 1), 3, 1), Err(Infeasible::OutsideFootprint));
    }

    /// A 2 x 2 box of height 3 in the corner, and a larger one that would stand on it.
    #[test]
    fn partial_support_by_hand() {
        let mut surface = Surface::with_rules(ContainerSize::new(9, 9, 9, 10).unwrap(), Support::Partial.into());
        surface.place(extent(2, 2, 3), 0, 0).unwrap();
        assert_eq!(surface.rest(extent(2, 3, 1), 0, 0), Err(Infeasible::Unsupported), "two corners, 4 of 6 cells");
        surface.place(extent(2, 2, 3), 0, 3).unwrap();
        assert_eq!(surface.rest(extent(2, 5, 1), 0, 0), Ok(3), "four corners, 8 of 10 cells");
        assert_eq!(surface.place(extent(2, 5, 1), 0, 0), Ok(3));
        assert_eq!(surface.row(0), [4, 4, 4, 4, 4, 0, 0, 0, 0]);
    }

    /// A step of one cell is level by this rule, one of two is not; what stands on both stands on the higher.
    #[test]
    fn a_tolerance_by_hand() {
        let rules = Rules { level_mm: 19, ..Rules::default() };
        let mut surface = Surface::with_rules(ContainerSize::new(1, 4, 9, 10).unwrap(), rules);
        surface.set_heights(&[3, 2, 1, 1]);
        assert_eq!(surface.rest(extent(1, 2, 1), 0, 0), Ok(3));
        assert_eq!(surface.rest(extent(1, 3, 1), 0, 0), Err(Infeasible::NotLevel));
        assert_eq!(surface.rest(extent(1, 3, 1), 0, 1), Ok(2));
        let corners: Vec<_> = surface.corners().iter().map(|c| (c.j, c.towards_low_j, c.towards_high_j)).collect();
        assert_eq!(corners, [(0, true, false), (3, false, true)], "the walls and no step");
        surface.place(extent(1, 2, 1), 0, 0).unwrap();
        assert_eq!(surface.heights(), [4, 4, 1, 1]);
    }

    #[test]
    fn an_empty_container_has_its_four_corners() {
        let surface = Surface::empty(ContainerSize::new(3, 4, 5, 10).unwrap());
        let cells: Vec<_> = surface.corners().iter().map(|c| (c.i, c.j)).collect();
        assert_eq!(cells, [(0, 0), (0, 3), (2, 0), (2, 3)]);
    }

    proptest! {
        #[test]
        fn fast_feasibility_equals_the_definition(surface in arb_surface(), l in 1u16..9, b in 1u16..9, h in 1u16..9) {
            let size = surface.size();
            let extent = extent(l, b, h);
            let mut by_definition = Vec::new();
            for i in 0..size.length() {
                for j in 0..size.breadth() {
                    if let Ok(base) = surface.rest(extent, i, j) {
                        by_definition.push((i, j, base));
                        prop_assert_eq!(surface.rest_inside(extent, i.into(), j.into()), Some(base));
                    } else if i + l <= size.length() && j + b <= size.breadth() {
                        prop_assert_eq!(surface.rest_inside(extent, i.into(), j.into()), None);
                    }
                }
            }
            prop_assert_eq!(surface.feasible(extent).collect::<Vec<_>>(), by_definition);
        }

        #[test]
        fn placing_keeps_what_a_full_refresh_would_give(surface in arb_surface()) {
            let mut fresh = Surface::with_rules(surface.size(), surface.rules());
            fresh.heights.copy_from_slice(surface.heights());
            fresh.refresh(0..usize::from(surface.size().length()), 0..usize::from(surface.size().breadth()));
            assert_same(&fresh, &surface);
        }

        #[test]
        fn taking_heights_over_refreshes_all_that_differs(surface in arb_surface(), seed in any::<u64>()) {
            let mut other = Surface::with_rules(surface.size(), surface.rules());
            let mut draw = Draw::new(0, seed, 0);
            let few: Vec<u16> = surface.heights().iter().map(|&h| if draw.below(9) == 0 { 1 } else { h }).collect();
            for heights in [surface.heights(), &few, surface.heights()] {
                other.set_heights(heights);
                prop_assert_eq!(other.heights(), heights);
            }
            assert_same(&other, &surface);
        }

        #[test]
        fn corners_equal_the_definition(surface in arb_surface()) {
            let (length, breadth) = (i32::from(surface.size().length()), i32::from(surface.size().breadth()));
            let height = |i: i32, j: i32| surface.row(i as usize)[j as usize];
            let differs = |i: i32, j: i32, from: u16| {
                !(0..length).contains(&i) || !(0..breadth).contains(&j) || height(i, j).abs_diff(from) > surface.level_cells
            };
            let mut expected = Vec::new();
            for (i, j) in (0..length).flat_map(|i| (0..breadth).map(move |j| (i, j))) {
                let here = height(i, j);
                let corner = Corner {
                    i: i as u16,
                    j: j as u16,
                    towards_low_i: differs(i - 1, j, here),
                    towards_high_i: differs(i + 1, j, here),
                    towards_low_j: differs(i, j - 1, here),
                    towards_high_j: differs(i, j + 1, here),
                };
                if (corner.towards_low_i || corner.towards_high_i) && (corner.towards_low_j || corner.towards_high_j) {
                    expected.push(corner);
                }
            }
            prop_assert_eq!(surface.corners(), expected);
        }

        #[test]
        fn a_refused_box_changes_nothing(surface in arb_surface(), l in 1u16..9, b in 1u16..9, h in 1u16..9, i in 0u16..9, j in 0u16..9) {
            let mut after = surface.clone();
            let extent = extent(l, b, h).turned(Yaw::Deg90);
            match after.place(extent, i, j) {
                Err(_) => prop_assert_eq!(after.heights(), surface.heights()),
                Ok(_) => {
                    let sum = |s: &Surface| s.heights().iter().map(|&h| u64::from(h)).sum::<u64>();
                    let risen = sum(&after) - sum(&surface);
                    prop_assert!(risen == extent.volume_cells() || surface.rules() != Rules::default());
                    prop_assert!(risen >= extent.volume_cells(), "what lies under an overhang is lost too");
                }
            }
        }
    }
}
