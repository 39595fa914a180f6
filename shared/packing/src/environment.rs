//! Packing a stream box by box, and what came of it.

use std::fmt;
use std::str::FromStr;

use crate::{BoxSpec, ContainerSize, Extent, Grid, PlaceError, Placement, SizeError};

/// The packing of one stream: the grid, and what was done so far.
#[derive(Clone, Debug)]
pub struct Environment {
    grid: Grid,
    close: ClosePolicy,
    placed: Vec<PlacedBox>,
    set_aside: Vec<BoxSpec>,
    /// Volume in every container that ever stood in the cell, by its identity [cells].
    packed_cells: Vec<u64>,
    containers_max: u32,
}

/// A box that stands in a container.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlacedBox {
    /// The box.
    pub spec: BoxSpec,
    /// Where and how it stands.
    pub placement: Placement,
    /// Identity of the container.
    pub container: u32,
}

/// Which open container leaves when a box fits into none and no slot is free.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClosePolicy {
    /// None: the box is set aside.
    Never,
    /// The one opened first.
    Oldest,
    /// The one with the largest packed volume; the oldest of those.
    Fullest,
}

/// What became of one box.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// It stands where the placement says.
    Placed(Placement),
    /// It fits nowhere.
    SetAside,
}

/// The figures of a packed stream. Paper: section "Problem Description".
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome {
    /// Boxes that stand in a container.
    pub placed: usize,
    /// Boxes that fitted nowhere.
    pub set_aside: usize,
    /// Containers that hold a box, or held one when they were closed.
    pub containers_used: u32,
    /// `c`: containers used over the optimum, where that is known [-].
    pub competitive_ratio: Option<f64>,
    /// Volume share of the first `optimum` containers opened, where that is known [-].
    pub fill: Option<f64>,
    /// Volume share of all used containers [-]; 0 if none is.
    pub utilisation: f64,
}

impl Environment {
    /// An empty cell of `slots` containers.
    ///
    /// # Errors
    /// [`SizeError`] beyond the limits of a grid.
    pub fn new(size: ContainerSize, slots: usize, close: ClosePolicy) -> Result<Self, SizeError> {
        Ok(Self::on(Grid::new(size, slots)?, close))
    }

    /// A cell with the containers of `grid`, none of which has been opened.
    #[must_use]
    pub fn on(grid: Grid, close: ClosePolicy) -> Self {
        let packed_cells = vec![0; grid.slots().len()];
        Self { grid, close, placed: Vec::new(), set_aside: Vec::new(), packed_cells, containers_max: u32::MAX }
    }

    /// Brings no more than `containers_max` containers into the cell, those it begins with included.
    #[must_use]
    pub fn with_containers_max(self, containers_max: u32) -> Self {
        Self { containers_max, ..self }
    }

    /// The containers as they stand.
    #[must_use]
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Believes what was measured of one container, as [`Grid::correct`].
    ///
    /// # Panics
    /// As [`Grid::correct`].
    pub fn correct(&mut self, slot: u16, heights: &[u16]) {
        self.grid.correct(slot, heights);
    }

    /// The boxes that stand in containers, in the order they were placed.
    #[must_use]
    pub fn placed(&self) -> &[PlacedBox] {
        &self.placed
    }

    /// Packs one box where `choose` says, given the grid and the box's extent at yaw 0.
    ///
    /// If it says nowhere, the close policy makes room; a box for which there is no room then is set aside.
    ///
    /// # Errors
    /// [`PlaceError`] if the choice is infeasible; nothing has changed then but a container that was closed.
    pub fn pack(
        &mut self,
        spec: &BoxSpec,
        mut choose: impl FnMut(&Grid, Extent) -> Option<Placement>,
    ) -> Result<Step, PlaceError> {
        let extent = self.grid.extent(spec);
        let mut choice = choose(&self.grid, extent);
        if choice.is_none()
            && (self.packed_cells.len() as u64) < u64::from(self.containers_max)
            && self.grid.size().admits(extent)
            && let Some(slot) = self.close.select(&self.grid)
        {
            self.grid.replace(slot, self.packed_cells.len() as u32)?;
            self.packed_cells.push(0);
            choice = choose(&self.grid, extent);
        }
        let Some(placement) = choice else {
            self.set_aside.push(*spec);
            return Ok(Step::SetAside);
        };
        self.grid.place(spec, placement)?;
        let container = self.grid.slots()[usize::from(placement.slot)].container();
        self.packed_cells[container as usize] += spec.extent(self.grid.size().cell_mm()).volume_cells();
        self.placed.push(PlacedBox { spec: *spec, placement, container });
        Ok(Step::Placed(placement))
    }

    /// The figures so far, beside the optimum if it is known.
    #[must_use]
    pub fn outcome(&self, optimum: Option<u32>) -> Outcome {
        Outcome::of(&self.packed_cells, self.grid.size(), self.placed.len(), self.set_aside.len(), optimum)
    }
}

impl Outcome {
    /// The figures of a stream, from the volume [cells] in every container that ever stood in the cell, by identity.
    #[must_use]
    pub fn of(
        packed_cells: &[u64],
        size: ContainerSize,
        placed: usize,
        set_aside: usize,
        optimum: Option<u32>,
    ) -> Self {
        let containers_used = packed_cells.iter().filter(|&&cells| cells > 0).count() as u32;
        let share = |cells: u64, containers: u32| match containers {
            0 => 0.0,
            _ => cells as f64 / (f64::from(containers) * size.volume_cells() as f64),
        };
        let optimum = optimum.filter(|&optimum| optimum > 0);
        Self {
            placed,
            set_aside,
            containers_used,
            competitive_ratio: optimum.map(|optimum| f64::from(containers_used) / f64::from(optimum)),
            fill: optimum.map(|optimum| share(packed_cells.iter().take(optimum as usize).sum(), optimum)),
            utilisation: share(packed_cells.iter().sum(), containers_used),
        }
    }
}

impl ClosePolicy {
    /// The names of all policies, as [`FromStr`] reads them.
    pub const NAMES: [&str; 3] = ["never", "oldest", "fullest"];

    /// The slot whose container leaves, if one does: only when every slot holds an open container.
    #[must_use]
    pub fn select(self, grid: &Grid) -> Option<u16> {
        if grid.fresh_slot().is_some() {
            return None;
        }
        match self {
            Self::Never => None,
            Self::Oldest => grid.open_slots().next(),
            Self::Fullest => {
                // Nothing stands under anything, so the heights of a container add up to its packed volume (and to what
                // is lost under overhangs, where the rules allow any).
                let packed = |slot: u16| {
                    grid.slots()[usize::from(slot)].surface().heights().iter().map(|&h| u64::from(h)).sum::<u64>()
                };
                grid.open_slots().min_by_key(|&slot| std::cmp::Reverse(packed(slot)))
            }
        }
    }
}

impl fmt::Display for ClosePolicy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Never => "never",
            Self::Oldest => "oldest",
            Self::Fullest => "fullest",
        })
    }
}

impl FromStr for ClosePolicy {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        match name {
            "never" => Ok(Self::Never),
            "oldest" => Ok(Self::Oldest),
            "fullest" => Ok(Self::Fullest),
            _ => Err(format!("there is no close policy {name:?}: use one of {}", Self::NAMES.join(", "))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Heuristic, Yaw};

    fn size() -> ContainerSize {
        ContainerSize::new(4, 4, 4, 10).unwrap()
    }

    fn spec(id: u64, size_mm: [u32; 3]) -> BoxSpec {
        BoxSpec::new(id, size_mm).unwrap()
    }

    fn pack(environment: &mut Environment, spec: &BoxSpec) -> Step {
        environment.pack(spec, |grid, extent| Heuristic::FirstFit.choose(grid, extent)).unwrap()
    }

    #[test]
    fn figures_by_hand() {
        let mut environment = Environment::new(size(), 3, ClosePolicy::Never).unwrap();
        pack(&mut environment, &spec(0, [40, 40, 20]));
        pack(&mut environment, &spec(1, [40, 40, 30]));
        pack(&mut environment, &spec(2, [40, 40, 10]));
        assert_eq!(pack(&mut environment, &spec(3, [10, 10, 50])), Step::SetAside);
        // Container 0 holds 32 + 16 of 64 cells, container 1 holds 48.
        let outcome = environment.outcome(Some(1));
        assert_eq!((outcome.placed, outcome.set_aside, outcome.containers_used), (3, 1, 2));
        assert_eq!((outcome.competitive_ratio, outcome.fill), (Some(2.0), Some(0.75)));
        assert!((outcome.utilisation - 0.75).abs() < 1e-12);
        assert_eq!(environment.outcome(None).fill, None);
    }

    #[test]
    fn a_full_cell_closes_by_policy() {
        for (close, left, used) in
            [(ClosePolicy::Never, None, 2), (ClosePolicy::Oldest, Some(0), 3), (ClosePolicy::Fullest, Some(1), 3)]
        {
            let mut environment = Environment::new(size(), 2, close).unwrap();
            pack(&mut environment, &spec(0, [40, 40, 20]));
            pack(&mut environment, &spec(1, [40, 40, 30]));
            let step = pack(&mut environment, &spec(2, [40, 40, 30]));
            let expected = left
                .map_or(Step::SetAside, |slot| Step::Placed(Placement { slot, yaw: Yaw::Deg0, i: 0, j: 0, base: 0 }));
            assert_eq!(step, expected, "{close}");
            assert_eq!(environment.outcome(None).containers_used, used, "{close}");
        }
    }

    #[test]
    fn no_more_containers_than_allowed() {
        let grid = Grid::new(size(), 1).unwrap();
        let mut environment = Environment::on(grid, ClosePolicy::Oldest).with_containers_max(2);
        let steps = [0, 1, 2].map(|id| pack(&mut environment, &spec(id, [40, 40, 40])));
        assert!(matches!(steps, [Step::Placed(_), Step::Placed(_), Step::SetAside]), "{steps:?}");
    }

    #[test]
    fn a_box_too_large_for_any_container_closes_none() {
        let mut environment = Environment::new(size(), 1, ClosePolicy::Oldest).unwrap();
        pack(&mut environment, &spec(0, [40, 40, 40]));
        assert_eq!(pack(&mut environment, &spec(1, [50, 10, 10])), Step::SetAside);
        assert_eq!(environment.grid().revision(), 1);
    }
}
