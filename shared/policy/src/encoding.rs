//! Grids and placements into the numbers that the published network reads.
//!
//! Paper: "State definition". For one candidate, on the future grid with the box placed there:
//!
//! - `x` (432): the grid pooled into 9 x 16 disjoint fields: first all averages, then all maxima, then all
//!   differences of maximum and minimum, each row by row and divided by `H`.
//! - `y` (144): the heights of the border cells divided by `H`, walked clockwise: along the row before the
//!   footprint with rising `j`, down the column behind it with rising `i`, along the row behind it with falling
//!   `j`, up the column before it with falling `i`. A shorter border is padded with zeros, a longer one of `n`
//!   cells is sampled at the cells `k*n/144`.
//! - `z` (144): one-hot, the field in which the footprint's first cell `(i, j)` lies.
//!
//! The paper does not say what a wall counts as in `y`. [`Walls::Empty`] takes 0, as WallE's terms do;
//! [`Walls::Full`] takes 1, as a container filled to its limit would.

use std::fmt;
use std::ops::Range;

use packing::{Candidate, Extent, Grid, Placement};

use crate::pool::{FIELDS, Field, Pool};
use crate::weights::Architecture;

/// Numbers in `x`.
pub const X_LEN: usize = 3 * FIELDS;
/// Numbers in `y`.
pub const Y_LEN: usize = 144;
/// Numbers in `z`.
pub const Z_LEN: usize = FIELDS;

/// A version of a network's input. Its number stands in every model file; a number never changes its meaning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// `x`, `y`, `z` of the paper.
    Published(Walls),
    /// What one move does to its surroundings: [`crate::moves`].
    Moves,
}

/// What a wall cell counts as in `y`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Walls {
    /// Height 0.
    Empty,
    /// Height `H`.
    Full,
}

impl Encoding {
    /// All versions.
    pub const ALL: [Self; 3] = [Self::Published(Walls::Empty), Self::Published(Walls::Full), Self::Moves];

    /// The number in model files.
    #[must_use]
    pub fn number(self) -> u32 {
        match self {
            Self::Published(Walls::Empty) => 1,
            Self::Published(Walls::Full) => 2,
            Self::Moves => 3,
        }
    }

    /// The version with this number.
    #[must_use]
    pub fn from_number(number: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|encoding| encoding.number() == number)
    }

    /// Whether networks of this architecture read it.
    #[must_use]
    pub fn is_read_by(self, architecture: Architecture) -> bool {
        match self {
            Self::Published(_) => architecture == Architecture::Published,
            Self::Moves => architecture == Architecture::Moves,
        }
    }
}

impl fmt::Display for Encoding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Published(Walls::Empty) => "published, walls count as empty",
            Self::Published(Walls::Full) => "published, walls count as full",
            Self::Moves => "moves",
        })
    }
}

/// The encoded candidates of one decision, or any other collection of encoded placements.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Batch {
    /// `x` of every row, one after another.
    pub x: Vec<f32>,
    /// `y` of every row, one after another.
    pub y: Vec<f32>,
    /// `z` of every row as the index of its one.
    pub z: Vec<u16>,
}

impl Batch {
    /// Encoded placements.
    #[must_use]
    pub fn len(&self) -> usize {
        self.z.len()
    }

    /// Whether nothing is encoded.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.z.is_empty()
    }

    /// Forgets all rows and keeps the memory.
    pub fn clear(&mut self) {
        self.x.clear();
        self.y.clear();
        self.z.clear();
    }

    /// Appends row `row` of another batch.
    ///
    /// # Panics
    /// If the other batch has no such row.
    pub fn push_row(&mut self, other: &Self, row: usize) {
        self.x.extend_from_slice(&other.x[row * X_LEN..(row + 1) * X_LEN]);
        self.y.extend_from_slice(&other.y[row * Y_LEN..(row + 1) * Y_LEN]);
        self.z.push(other.z[row]);
    }

    /// `z` of every row as the network reads it.
    #[must_use]
    pub fn one_hot(&self) -> Vec<f32> {
        let mut ones = vec![0.0; self.len() * Z_LEN];
        for (row, &field) in self.z.iter().enumerate() {
            ones[row * Z_LEN + usize::from(field)] = 1.0;
        }
        ones
    }
}

/// The candidates of one decision, each as what it changes of the present grid.
///
/// This is all that [`Batch`] holds, in a few numbers a candidate: a box changes few of the 144 fields, a border is a
/// few runs of equal heights, and candidates that differ in `j` alone mostly change the fields alike.
#[derive(Clone, Debug, Default)]
pub(crate) struct Changes {
    /// `x` of the present grid.
    present: Vec<f32>,
    /// What the future grids change of it, one future after another.
    inputs: Vec<Input>,
    /// Where each future's inputs end.
    futures: Vec<usize>,
    /// What the borders are made of, one place after another.
    steps: Vec<Step>,
    places: Vec<Place>,
}

/// A number of `x` that is not what it is in the present grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Input {
    pub(crate) index: u16,
    pub(crate) value: f32,
}

/// From this number of `y` on, up to the next step, all are this height (as a share of `H`).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Step {
    pub(crate) from: u16,
    pub(crate) height: f32,
}

/// One candidate.
#[derive(Clone, Debug)]
struct Place {
    future: usize,
    steps: Range<usize>,
    field: u16,
}

impl Changes {
    /// `x` of the present grid.
    pub(crate) fn present(&self) -> &[f32] {
        &self.present
    }

    /// Encoded candidates.
    pub(crate) fn len(&self) -> usize {
        self.places.len()
    }

    /// What every future grid changes of `x`, no two neighbouring candidates' alike.
    pub(crate) fn futures(&self) -> impl ExactSizeIterator<Item = &[Input]> {
        (0..self.futures.len()).map(|future| self.future(future))
    }

    fn future(&self, future: usize) -> &[Input] {
        let start = if future == 0 { 0 } else { self.futures[future - 1] };
        &self.inputs[start..self.futures[future]]
    }

    /// Every candidate: the index of its future, its `y` as steps, and its `z` as the index of its one.
    pub(crate) fn places(&self) -> impl ExactSizeIterator<Item = (usize, &[Step], usize)> {
        let each = |place: &Place| (place.future, &self.steps[place.steps.clone()], usize::from(place.field));
        self.places.iter().map(each)
    }

    fn clear(&mut self) {
        self.present.clear();
        self.inputs.clear();
        self.futures.clear();
        self.steps.clear();
        self.places.clear();
    }

    /// Writes every number out.
    fn write(&self, batch: &mut Batch) {
        batch.clear();
        for (future, steps, field) in self.places() {
            let x = batch.x.len();
            batch.x.extend_from_slice(&self.present);
            for input in self.future(future) {
                batch.x[x + usize::from(input.index)] = input.value;
            }
            let y = batch.y.len();
            for (index, step) in steps.iter().enumerate() {
                let end = steps.get(index + 1).map_or(Y_LEN, |next| usize::from(next.from));
                batch.y.resize(y + end, step.height);
            }
            batch.z.push(field as u16);
        }
    }
}

/// Encodes the candidates of one box after another, keeping its memory.
#[derive(Clone, Debug)]
pub struct Encoder {
    wall: f32,
    pool: Pool,
    changes: Changes,
    runs: Vec<(u16, u16)>,
}

impl Encoder {
    /// An encoder that counts walls as given.
    #[must_use]
    pub fn new(walls: Walls) -> Self {
        let wall = match walls {
            Walls::Empty => 0.0,
            Walls::Full => 1.0,
        };
        Self { wall, pool: Pool::default(), changes: Changes::default(), runs: Vec::new() }
    }

    /// Encodes the candidates of a box of `extent` (yaw 0) in their order; `batch` is cleared first.
    ///
    /// # Panics
    /// If a candidate does not lie in the grid, which no [`packing::corner_candidates`] returns.
    pub fn encode(&mut self, grid: &Grid, extent: Extent, candidates: &[Candidate], batch: &mut Batch) {
        self.changes(grid, extent, candidates).write(batch);
    }

    /// Encodes the candidates of a box of `extent` (yaw 0) in their order, as what they change.
    ///
    /// The present grid is pooled once, no future grid is ever made, and every border is read once, run by run.
    pub(crate) fn changes(&mut self, grid: &Grid, extent: Extent, candidates: &[Candidate]) -> &Changes {
        let changes = &mut self.changes;
        changes.clear();
        if candidates.is_empty() {
            return changes;
        }
        let limit = f32::from(grid.size().height());
        self.pool.refresh(grid);
        changes.present.resize(X_LEN, 0.0);
        for (index, &field) in self.pool.fields().iter().enumerate() {
            for (input, value) in inputs(index, field, limit) {
                changes.present[input] = value;
            }
        }
        let (mut line, mut first_of_line) = (None, 0);
        for candidate in candidates {
            let placement = candidate.placement;
            let turned = extent.turned(placement.yaw);
            let start = changes.inputs.len();
            self.pool.for_changed(grid, turned, placement, |index, field| {
                let changed = inputs(index, field, limit).into_iter().filter(|&(k, value)| changes.present[k] != value);
                changes.inputs.extend(changed.map(|(k, value)| Input { index: k as u16, value }));
            });
            let its_line = Some((placement.slot, placement.yaw, placement.i));
            if line != its_line {
                (line, first_of_line) = (its_line, changes.futures.len());
            }
            let twin = (first_of_line..changes.futures.len()).find(|&f| changes.future(f) == &changes.inputs[start..]);
            if twin.is_some() {
                changes.inputs.truncate(start);
            } else {
                changes.futures.push(changes.inputs.len());
            }
            let future = twin.unwrap_or(changes.futures.len() - 1);
            let first = changes.steps.len();
            push_border(grid, turned, placement, self.wall, &mut self.runs, &mut changes.steps);
            let field = self.pool.field_of(placement) as u16;
            changes.places.push(Place { future, steps: first..changes.steps.len(), field });
        }
        changes
    }
}

/// The three numbers of `x` that describe a field, with their places.
fn inputs(index: usize, field: Field, limit: f32) -> [(usize, f32); 3] {
    let average = if field.cells == 0 { 0.0 } else { field.sum as f32 / field.cells as f32 };
    [
        (index, average / limit),
        (FIELDS + index, f32::from(field.highest) / limit),
        (2 * FIELDS + index, f32::from(field.highest - field.lowest) / limit),
    ]
}

/// Appends the `y` of one placement; `runs` is scratch.
fn push_border(
    grid: &Grid,
    turned: Extent,
    placement: Placement,
    wall: f32,
    runs: &mut Vec<(u16, u16)>,
    steps: &mut Vec<Step>,
) {
    let size = grid.size();
    let surface = grid.slots()[usize::from(placement.slot)].surface();
    let (i, j) = (placement.i, placement.j);
    let (i_end, j_end) = (i + turned.length, j + turned.breadth);
    let mut walk = Walk {
        limit: f32::from(size.height()),
        border: 2 * (usize::from(turned.length) + usize::from(turned.breadth)),
        walked: 0,
        first: steps.len(),
        steps,
    };
    if i == 0 {
        walk.add(wall, turned.breadth);
    } else {
        walk.add_runs(surface.runs_along_j(i - 1, j..j_end));
    }
    if j_end == size.breadth() {
        walk.add(wall, turned.length);
    } else {
        walk.add_runs(surface.runs_along_i(i..i_end, j_end));
    }
    if i_end == size.length() {
        walk.add(wall, turned.breadth);
    } else {
        runs.clear();
        runs.extend(surface.runs_along_j(i_end, j..j_end));
        walk.add_runs(runs.iter().rev().copied());
    }
    if j == 0 {
        walk.add(wall, turned.length);
    } else {
        runs.clear();
        runs.extend(surface.runs_along_i(i..i_end, j - 1));
        walk.add_runs(runs.iter().rev().copied());
    }
    if walk.border < Y_LEN {
        walk.add(0.0, 1);
    }
}

/// A walk along the border of one footprint.
struct Walk<'a> {
    limit: f32,
    /// Cells of the border.
    border: usize,
    walked: usize,
    /// The first of its steps.
    first: usize,
    steps: &'a mut Vec<Step>,
}

impl Walk<'_> {
    fn add_runs(&mut self, runs: impl Iterator<Item = (u16, u16)>) {
        runs.for_each(|(height, cells)| self.add(f32::from(height) / self.limit, cells));
    }

    /// Goes on by `cells` of one height.
    fn add(&mut self, height: f32, cells: u16) {
        // Of a border that is too long, the cells k*n/144 are kept: this is the first k that comes to this cell.
        let from = if self.border <= Y_LEN { self.walked } else { (self.walked * Y_LEN).div_ceil(self.border) };
        self.walked += usize::from(cells);
        let last = self.steps.len().checked_sub(1).filter(|&last| last >= self.first).map(|last| self.steps[last]);
        if from == Y_LEN || last.is_some_and(|last| last.height == height) {
            return;
        }
        if last.is_some_and(|last| usize::from(last.from) == from) {
            self.steps.pop();
        }
        self.steps.push(Step { from: from as u16, height });
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use packing::{BoxSpec, ContainerSize, WalleWeights, Yaw, corner_candidates};
    use proptest::prelude::*;

    use super::*;
    use crate::pool::{FIELD_COLUMNS, FIELD_ROWS};

    /// The definition, cell by cell, on a materialised future grid.
    fn by_definition(walls: Walls, grid: &Grid, spec: &BoxSpec, placement: Placement) -> (Vec<f32>, Vec<f32>, u16) {
        let size = grid.size();
        let mut future = grid.clone();
        future.place(spec, placement).unwrap();
        let (length, breadth) = (usize::from(size.length()), usize::from(size.breadth()));
        let (columns, limit) = (breadth * grid.slots().len(), f32::from(size.height()));
        let (mut x, mut z) = (vec![0.0; X_LEN], 0);
        for row in 0..FIELD_ROWS {
            for column in 0..FIELD_COLUMNS {
                let mut heights = Vec::new();
                let index = row * FIELD_COLUMNS + column;
                for i in row * length / FIELD_ROWS..(row + 1) * length / FIELD_ROWS {
                    for j in column * columns / FIELD_COLUMNS..(column + 1) * columns / FIELD_COLUMNS {
                        heights.push(future.slots()[j / breadth].surface().row(i)[j % breadth]);
                        let first = usize::from(placement.slot) * breadth + usize::from(placement.j);
                        if (i, j) == (usize::from(placement.i), first) {
                            z = index as u16;
                        }
                    }
                }
                if let (Some(&highest), Some(&lowest)) = (heights.iter().max(), heights.iter().min()) {
                    let sum: u32 = heights.iter().map(|&height| u32::from(height)).sum();
                    x[index] = sum as f32 / heights.len() as f32 / limit;
                    x[FIELDS + index] = f32::from(highest) / limit;
                    x[2 * FIELDS + index] = f32::from(highest - lowest) / limit;
                }
            }
        }
        let turned = spec.extent(size.cell_mm()).turned(placement.yaw);
        let (i, j) = (i32::from(placement.i), i32::from(placement.j));
        let (i_end, j_end) = (i + i32::from(turned.length), j + i32::from(turned.breadth));
        let mut walk: Vec<(i32, i32)> = (j..j_end).map(|j| (i - 1, j)).collect();
        walk.extend((i..i_end).map(|i| (i, j_end)));
        walk.extend((j..j_end).rev().map(|j| (i_end, j)));
        walk.extend((i..i_end).rev().map(|i| (i, j - 1)));
        let surface = grid.slots()[usize::from(placement.slot)].surface();
        let height = |(i, j): (i32, i32)| {
            let inside = (0..length as i32).contains(&i) && (0..breadth as i32).contains(&j);
            let wall = if walls == Walls::Full { 1.0 } else { 0.0 };
            if inside { f32::from(surface.row(i as usize)[j as usize]) / limit } else { wall }
        };
        let y = (0..Y_LEN).map(|k| {
            let step = if walk.len() <= Y_LEN { k } else { k * walk.len() / Y_LEN };
            walk.get(step).map_or(0.0, |&cell| height(cell))
        });
        (x, y.collect(), z)
    }

    #[track_caller]
    fn check(walls: Walls, grid: &Grid, spec: &BoxSpec) {
        let extent = spec.extent(grid.size().cell_mm());
        let (mut candidates, mut batch) = (Vec::new(), Batch::default());
        corner_candidates(grid, extent, &WalleWeights::PAPER, &mut candidates);
        Encoder::new(walls).encode(grid, extent, &candidates, &mut batch);
        assert_eq!(batch.len(), candidates.len());
        for (row, candidate) in candidates.iter().enumerate() {
            let (x, y, z) = by_definition(walls, grid, spec, candidate.placement);
            assert_eq!(batch.x[row * X_LEN..(row + 1) * X_LEN], x, "x of {candidate:?}");
            assert_eq!(batch.y[row * Y_LEN..(row + 1) * Y_LEN], y, "y of {candidate:?}");
            assert_eq!(batch.z[row], z, "z of {candidate:?}");
        }
    }

    /// A 2 x 1 x 3 box at (1, 2) of an empty 9 x 16 x 6 container: every field is one cell.
    #[test]
    fn one_box_by_hand() {
        let mut grid = Grid::new(ContainerSize::new(9, 16, 6, 10).unwrap(), 1).unwrap();
        grid.place(&BoxSpec::new(0, [10, 10, 60]).unwrap(), Placement { slot: 0, yaw: Yaw::Deg0, i: 1, j: 3, base: 0 })
            .unwrap();
        let placement = Placement { slot: 0, yaw: Yaw::Deg0, i: 1, j: 2, base: 0 };
        let extent = Extent { length: 2, breadth: 1, height: 3 };
        let mut batch = Batch::default();
        Encoder::new(Walls::Empty).encode(&grid, extent, &[Candidate { placement, walle: 0.0 }], &mut batch);
        let mut average = [0.0; FIELDS];
        average[FIELD_COLUMNS + 3] = 1.0;
        (average[FIELD_COLUMNS + 2], average[2 * FIELD_COLUMNS + 2]) = (0.5, 0.5);
        assert_eq!(batch.x[..FIELDS], average);
        assert_eq!(batch.x[FIELDS..2 * FIELDS], average);
        assert_eq!(batch.x[2 * FIELDS..], [0.0; FIELDS]);
        // Above (0, 2); right (1, 3), (2, 3); below (3, 2); left (2, 1), (1, 1).
        assert_eq!(batch.y[..8], [0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(batch.z, [FIELD_COLUMNS as u16 + 2]);
        assert_eq!(batch.one_hot()[FIELD_COLUMNS + 2], 1.0);
        assert_eq!(batch.one_hot().iter().sum::<f32>(), 1.0);
    }

    #[test]
    fn a_wall_is_what_the_version_says() {
        let grid = Grid::new(ContainerSize::new(9, 16, 6, 10).unwrap(), 1).unwrap();
        let placement = Placement { slot: 0, yaw: Yaw::Deg0, i: 0, j: 0, base: 0 };
        for (walls, wall) in [(Walls::Empty, 0.0), (Walls::Full, 1.0)] {
            let mut batch = Batch::default();
            let extent = Extent { length: 2, breadth: 1, height: 3 };
            Encoder::new(walls).encode(&grid, extent, &[Candidate { placement, walle: 0.0 }], &mut batch);
            assert_eq!(batch.y[..8], [wall, 0.0, 0.0, 0.0, wall, wall, 0.0, 0.0], "{walls:?}");
        }
        for encoding in Encoding::ALL {
            assert_eq!(Encoding::from_number(encoding.number()), Some(encoding));
        }
        assert_eq!(Encoding::from_number(0), None);
    }

    /// The border of a 45 x 40 box has 170 cells, of which 144 are sampled.
    #[test]
    fn a_long_border_is_sampled_evenly() {
        let mut grid = Grid::new(ContainerSize::PAPER, 2).unwrap();
        grid.place(
            &BoxSpec::new(0, [450, 400, 100]).unwrap(),
            Placement { slot: 0, yaw: Yaw::Deg0, i: 0, j: 0, base: 0 },
        )
        .unwrap();
        check(Walls::Full, &grid, &BoxSpec::new(1, [450, 400, 200]).unwrap());
    }

    prop_compose! {
        /// A grid of small containers with random boxes, and a box to come.
        pub(crate) fn arb_case()(l in 1u16..14, b in 1u16..14, h in 1u16..8, slots in 1usize..5)(
            drops in prop::collection::vec((0..slots, 1u32..7, 1u32..7, 1u32..4, 0..l, 0..b), 0..24),
            next in (1u32..14, 1u32..14, 1u32..8),
            size in Just(ContainerSize::new(l, b, h, 10).unwrap()),
            slots in Just(slots),
        ) -> (Grid, BoxSpec) {
            let mut grid = Grid::new(size, slots).unwrap();
            for (slot, l, b, h, i, j) in drops {
                let spec = BoxSpec::new(1, [l * 10, b * 10, h * 10]).unwrap();
                if let Ok(base) = grid.slots()[slot].surface().rest(spec.extent(10), i, j) {
                    let slot = slot as u16;
                    grid.place(&spec, Placement { slot, yaw: Yaw::Deg0, i, j, base }).unwrap();
                }
            }
            (grid, BoxSpec::new(2, [next.0 * 10, next.1 * 10, next.2 * 10]).unwrap())
        }
    }

    proptest! {
        #[test]
        fn the_fast_encoding_equals_the_definition((grid, spec) in arb_case()) {
            for walls in [Walls::Empty, Walls::Full] {
                check(walls, &grid, &spec);
            }
        }
    }
}
