//! A data set in memory, and the one door through which the boxes of a file come into it.

use packing::{BOX_SIDE_MM_MAX, BoxSpec, ContainerSize, Episode};

use crate::{At, BOXES_MAX, BadBox, EPISODES_MAX, Problem, ReadOptions};

/// Episodes for one size of container.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DataSet {
    /// What it is called in tables.
    pub name: String,
    /// The container its boxes are meant for.
    pub container: ContainerSize,
    /// The least number of containers that hold an episode, where known.
    pub optimum: Option<u32>,
    /// The boxes of every episode in the order they arrive, numbered from 0.
    pub episodes: Vec<Vec<BoxSpec>>,
    /// What was left out in reading.
    pub skipped: Skipped,
}

/// What a reader left out because it was told to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Skipped {
    /// Unusable boxes.
    pub boxes: usize,
    /// Episodes without a usable box.
    pub episodes: usize,
}

impl DataSet {
    /// One episode with its container and optimum, ready to pack.
    #[must_use]
    pub fn episode(&self, index: usize) -> Option<Episode> {
        let boxes = self.episodes.get(index)?.clone();
        Some(Episode { container: self.container, optimum: self.optimum, boxes })
    }
}

/// A box as a file gives it; a side that is no number is NaN.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct RawBox {
    pub(crate) sides: [f64; 3],
    pub(crate) count: usize,
}

impl RawBox {
    /// Adds one side; those beyond the third are only counted.
    pub(crate) fn push(&mut self, side: f64) {
        if let Some(slot) = self.sides.get_mut(self.count) {
            *slot = side;
        }
        self.count = self.count.saturating_add(1);
    }
}

/// Collects checked boxes into episodes.
pub(crate) struct Builder {
    set: DataSet,
    skip_bad: bool,
    boxes_total: usize,
    /// The open episode's number in its file.
    number: u64,
    /// Boxes of the open episode so far, the skipped ones too.
    seen: u64,
    boxes: Vec<BoxSpec>,
}

impl Builder {
    pub(crate) fn new(name: String, container: ContainerSize, optimum: Option<u32>, options: &ReadOptions) -> Self {
        let set = DataSet { name, container, optimum, episodes: Vec::new(), skipped: Skipped::default() };
        Self { set, skip_bad: options.skip_bad, boxes_total: 0, number: 0, seen: 0, boxes: Vec::new() }
    }

    /// Begins the episode that the file calls `number`.
    pub(crate) fn begin(&mut self, number: u64) {
        (self.number, self.seen) = (number, 0);
    }

    /// Takes a box with sides in units of `unit_mm`.
    pub(crate) fn push(&mut self, raw: Result<RawBox, BadBox>, unit_mm: f64, line: Option<u64>) -> Result<(), Problem> {
        let at = At { episode: Some(self.number), index: Some(self.seen), line };
        self.seen += 1;
        match raw.and_then(|raw| check(raw, unit_mm, self.set.container, self.boxes.len() as u64)) {
            Ok(spec) => self.boxes.push(spec),
            Err(_) if self.skip_bad => self.set.skipped.boxes += 1,
            Err(bad) => return Err(Problem::Box(at, bad)),
        }
        self.boxes_total += 1;
        if self.boxes_total > BOXES_MAX { Err(Problem::TooManyBoxes) } else { Ok(()) }
    }

    /// Ends the open episode.
    pub(crate) fn end(&mut self) -> Result<(), Problem> {
        if self.boxes.is_empty() {
            if !self.skip_bad {
                return Err(Problem::EmptyEpisode(At { episode: Some(self.number), index: None, line: None }));
            }
            self.set.skipped.episodes += 1;
            return Ok(());
        }
        self.set.episodes.push(std::mem::take(&mut self.boxes));
        if self.set.episodes.len() > EPISODES_MAX { Err(Problem::TooManyEpisodes) } else { Ok(()) }
    }

    pub(crate) fn finish(self) -> Result<DataSet, Problem> {
        if self.set.episodes.is_empty() { Err(Problem::NoEpisode) } else { Ok(self.set) }
    }
}

/// Float noise of a unit conversion that does not make a box a millimetre longer [mm].
const ROUNDING_MM: f64 = 1e-6;

fn check(raw: RawBox, unit_mm: f64, container: ContainerSize, id: u64) -> Result<BoxSpec, BadBox> {
    if raw.count != 3 {
        return Err(BadBox::Sides(raw.count));
    }
    let mut size_mm = [0; 3];
    for (side, value) in raw.sides.into_iter().enumerate() {
        if !value.is_finite() {
            return Err(BadBox::NotANumber { side });
        }
        let millimetres = value * unit_mm;
        let rounded = (millimetres - ROUNDING_MM).ceil().max(1.0);
        if millimetres <= 0.0 || rounded > f64::from(BOX_SIDE_MM_MAX) {
            return Err(BadBox::Length { side, millimetres });
        }
        size_mm[side] = rounded as u32;
    }
    // Every side was checked above; the type asks for the same.
    let spec = BoxSpec::new(id, size_mm).map_err(|_| BadBox::Sides(0))?;
    let extent = spec.extent(container.cell_mm());
    if container.admits(extent) { Ok(spec) } else { Err(BadBox::FitsNoContainer { extent, container }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sides(sides: [f64; 3], unit_mm: f64) -> Result<[u32; 3], BadBox> {
        check(RawBox { sides, count: 3 }, unit_mm, ContainerSize::PAPER, 0).map(|spec| spec.size_mm())
    }

    #[test]
    fn fractions_of_a_millimetre_are_rounded_up_and_float_noise_is_not() {
        assert_eq!(sides([1.1, 12.3, 29.7], 10.0), Ok([11, 123, 297]));
        assert_eq!(sides([1.11, 0.001, 29.7], 10.0), Ok([12, 1, 297]));
    }

    #[test]
    fn unusable_sides_are_named() {
        assert_eq!(sides([1.0, f64::NAN, 1.0], 1.0), Err(BadBox::NotANumber { side: 1 }));
        assert_eq!(sides([1.0, 1.0, f64::INFINITY], 1.0), Err(BadBox::NotANumber { side: 2 }));
        let message = sides([1.0, -5.0, 1.0], 10.0).unwrap_err().to_string();
        assert_eq!(message, "its breadth is -50 mm: it must be more than 0 and at most 10000 mm");
        assert!(matches!(sides([1.0, 1.0, 0.0], 1.0), Err(BadBox::Length { side: 2, .. })));
        assert!(matches!(sides([1e300, 1.0, 1.0], 1e10), Err(BadBox::Length { side: 0, .. })));
        let message = sides([810.0, 10.0, 10.0], 1.0).unwrap_err().to_string();
        assert_eq!(message, "its 81 x 1 x 1 cells fit no container of 45 x 80 x 50 cells of 10 mm");
    }
}
