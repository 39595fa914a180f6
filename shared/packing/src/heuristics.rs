//! The baselines that need no training. Paper: "Baseline heuristics from literature" and "WallE".

use std::fmt;
use std::str::FromStr;

use crate::candidates::{best_by_score, feasible_places, push_corners};
use crate::{Candidate, Extent, Grid, Placement, WalleWeights, Yaw};

/// A rule that places one box on a grid.
///
/// A fresh container is opened only when no open one has a place. Ties go to the first place in scan order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Heuristic {
    /// The first feasible place, row by row: yaw 0 in every open container, then yaw 90.
    FirstFit,
    /// The lowest feasible place; yaws as First Fit.
    Floor,
    /// The highest feasible place; yaws as First Fit.
    Column,
    /// The highest stability score over all feasible places and both yaws.
    Walle(WalleWeights),
    /// The highest stability score over the corner candidates.
    WalleCorners(WalleWeights),
}

/// How a rule goes through the open containers. It decides more than the rule does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ContainerOrder {
    /// In the order they were opened: the best place in the first container that has any. With this reading the
    /// paper's figures come out.
    FirstThatFits,
    /// All at once: the best place of all.
    AllOpen,
}

/// A name that no heuristic has.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no heuristic {0:?}: use one of {names}", names = Heuristic::NAMES.join(", "))]
pub struct HeuristicError(pub String);

impl Heuristic {
    /// The names of all heuristics, as [`FromStr`] reads them.
    pub const NAMES: [&str; 5] = ["first-fit", "floor", "column", "walle", "walle-corners"];

    /// Where the box of `extent` (yaw 0) should go, by the published reading: in the first container that has a
    /// place. Nothing if it fits nowhere.
    #[must_use]
    pub fn choose(&self, grid: &Grid, extent: Extent) -> Option<Placement> {
        self.choose_in(ContainerOrder::FirstThatFits, grid, extent)
    }

    /// Where the box of `extent` (yaw 0) should go, with the open containers in this order.
    #[must_use]
    pub fn choose_in(&self, order: ContainerOrder, grid: &Grid, extent: Extent) -> Option<Placement> {
        match self {
            Self::FirstFit => yaw_by_yaw(order, grid, extent, |places| places.next().map(|place| (0.0, place))),
            Self::Floor => {
                yaw_by_yaw(order, grid, extent, |places| best_by_score(places.map(|p| (-f32::from(p.base), p))))
            }
            Self::Column => {
                yaw_by_yaw(order, grid, extent, |places| best_by_score(places.map(|p| (f32::from(p.base), p))))
            }
            Self::Walle(weights) => container_by_container(order, grid, |slot| {
                let surface = grid.slots()[usize::from(slot)].surface();
                best_by_score(feasible_places(grid, slot, extent, extent.yaws()).map(|place| {
                    (weights.score(surface, extent.turned(place.yaw), place.i, place.j, place.base), place)
                }))
            }),
            Self::WalleCorners(weights) => {
                let mut candidates = Vec::new();
                container_by_container(order, grid, |slot| {
                    candidates.clear();
                    push_corners(grid, slot, extent, weights, &mut Vec::new(), &mut candidates);
                    best_by_score(candidates.iter().map(|candidate| (candidate.walle, candidate.placement)))
                })
            }
        }
    }

    /// The index of WallE's choice among the candidates of one box: the highest score in the first container.
    #[must_use]
    pub fn walle_choice(candidates: &[Candidate]) -> Option<usize> {
        let slot = candidates.first()?.placement.slot;
        let in_slot = candidates.iter().take_while(|candidate| candidate.placement.slot == slot);
        let (_, best) = best_by_score(in_slot.map(|candidate| (candidate.walle, candidate.placement)))?;
        candidates.iter().position(|candidate| candidate.placement == best)
    }
}

/// The choice among the open containers, given each one's best place and its score.
fn in_open(
    order: ContainerOrder,
    grid: &Grid,
    best: impl FnMut(u16) -> Option<(f32, Placement)>,
) -> Option<(f32, Placement)> {
    let mut found = grid.open_slots().filter_map(best);
    match order {
        ContainerOrder::FirstThatFits => found.next(),
        ContainerOrder::AllOpen => best_by_score(found),
    }
}

/// Both yaws in the open containers, then a fresh one.
fn container_by_container(
    order: ContainerOrder,
    grid: &Grid,
    mut best: impl FnMut(u16) -> Option<(f32, Placement)>,
) -> Option<Placement> {
    let found = in_open(order, grid, &mut best).or_else(|| best(grid.fresh_slot()?));
    found.map(|(_, placement)| placement)
}

/// Yaw 0 in the open containers, then yaw 90, then a fresh container. Paper: "First Fit".
fn yaw_by_yaw(
    order: ContainerOrder,
    grid: &Grid,
    extent: Extent,
    best: impl Fn(&mut dyn Iterator<Item = Placement>) -> Option<(f32, Placement)>,
) -> Option<Placement> {
    let in_slot = |slot: u16, yaw: Yaw| best(&mut feasible_places(grid, slot, extent, &[yaw]));
    let in_open = extent.yaws().iter().find_map(|&yaw| in_open(order, grid, |slot| in_slot(slot, yaw)));
    let found = in_open.or_else(|| {
        let fresh = grid.fresh_slot()?;
        extent.yaws().iter().find_map(|&yaw| in_slot(fresh, yaw))
    });
    found.map(|(_, placement)| placement)
}

impl fmt::Display for ContainerOrder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::FirstThatFits => "first-that-fits",
            Self::AllOpen => "all-open",
        })
    }
}

impl FromStr for ContainerOrder {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        match name {
            "first-that-fits" => Ok(Self::FirstThatFits),
            "all-open" => Ok(Self::AllOpen),
            _ => Err(format!("there is no container order {name:?}: use first-that-fits or all-open")),
        }
    }
}

impl fmt::Display for Heuristic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::FirstFit => "first-fit",
            Self::Floor => "floor",
            Self::Column => "column",
            Self::Walle(_) => "walle",
            Self::WalleCorners(_) => "walle-corners",
        })
    }
}

impl FromStr for Heuristic {
    type Err = HeuristicError;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        Ok(match name {
            "first-fit" => Self::FirstFit,
            "floor" => Self::Floor,
            "column" => Self::Column,
            "walle" => Self::Walle(WalleWeights::PAPER),
            "walle-corners" => Self::WalleCorners(WalleWeights::PAPER),
            _ => return Err(HeuristicError(name.to_owned())),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BoxSpec, ContainerSize};

    fn extent(length: u16, breadth: u16, height: u16) -> Extent {
        Extent { length, breadth, height }
    }

    /// A 3 x 6 floor of height 4 with a 3 x 2 x 2 box at its left wall.
    fn step() -> Grid {
        let mut grid = Grid::new(ContainerSize::new(3, 6, 4, 10).unwrap(), 2).unwrap();
        let first = Placement { slot: 0, yaw: Yaw::Deg0, i: 0, j: 0, base: 0 };
        grid.place(&BoxSpec::new(0, [30, 20, 20]).unwrap(), first).unwrap();
        grid
    }

    #[test]
    fn first_fit_takes_the_first_place_in_reading_order() {
        let place = Heuristic::FirstFit.choose(&step(), extent(1, 1, 1)).unwrap();
        assert_eq!((place.i, place.j, place.base), (0, 0, 2));
    }

    #[test]
    fn first_fit_turns_only_when_yaw_0_fits_in_no_open_container() {
        let mut grid = step();
        grid.place(&BoxSpec::new(1, [10; 3]).unwrap(), Placement { slot: 1, yaw: Yaw::Deg0, i: 2, j: 5, base: 0 })
            .unwrap();
        // 2 x 5 fits at yaw 0 only into the second container, at yaw 90 in neither.
        let place = Heuristic::FirstFit.choose(&grid, extent(2, 5, 1)).unwrap();
        assert_eq!((place.slot, place.yaw, place.i, place.j), (1, Yaw::Deg0, 0, 0));
        // 4 x 3 fits at yaw 90 only.
        let place = Heuristic::FirstFit.choose(&grid, extent(4, 3, 1)).unwrap();
        assert_eq!((place.slot, place.yaw, place.j), (0, Yaw::Deg90, 2));
    }

    #[test]
    fn floor_goes_low_and_column_goes_high() {
        let place = Heuristic::Floor.choose(&step(), extent(1, 1, 1)).unwrap();
        assert_eq!((place.i, place.j, place.base), (0, 2, 0));
        let place = Heuristic::Column.choose(&step(), extent(1, 1, 1)).unwrap();
        assert_eq!((place.i, place.j, place.base), (0, 0, 2));
        let place = Heuristic::Column.choose(&step(), extent(1, 1, 3)).unwrap();
        assert_eq!((place.i, place.j, place.base), (0, 2, 0), "three high does not fit on two of four");
    }

    /// Two open containers: the floor of the second is free, and so is the top of the first's tower of three.
    #[test]
    fn the_container_order_decides() {
        let mut grid = Grid::new(ContainerSize::new(2, 4, 5, 10).unwrap(), 3).unwrap();
        let spec = |id, size_mm| BoxSpec::new(id, size_mm).unwrap();
        let at = |slot, j| Placement { slot, yaw: Yaw::Deg0, i: 0, j, base: 0 };
        grid.place(&spec(0, [20, 40, 20]), at(0, 0)).unwrap();
        grid.place(&spec(1, [20, 10, 30]), at(1, 0)).unwrap();
        let place = |heuristic: Heuristic, order| {
            let place = heuristic.choose_in(order, &grid, extent(2, 1, 1)).unwrap();
            (place.slot, place.base)
        };
        let (first, all) = (ContainerOrder::FirstThatFits, ContainerOrder::AllOpen);
        assert_eq!((place(Heuristic::Floor, first), place(Heuristic::Floor, all)), ((0, 2), (1, 0)));
        assert_eq!((place(Heuristic::Column, first), place(Heuristic::Column, all)), ((0, 2), (1, 3)));
        assert_eq!(place(Heuristic::FirstFit, first), place(Heuristic::FirstFit, all));
    }

    #[test]
    fn walle_levels_the_wall() {
        // Two high beside the box of two: flush cells on the left, and nothing sticks out.
        let place = Heuristic::Walle(WalleWeights::PAPER).choose(&step(), extent(3, 2, 2)).unwrap();
        assert_eq!((place.i, place.j, place.base), (0, 2, 0));
        assert_eq!(Heuristic::WalleCorners(WalleWeights::PAPER).choose(&step(), extent(3, 2, 2)), Some(place));
    }

    #[test]
    fn walle_on_candidates_is_walle_corners() {
        let grid = step();
        let mut candidates = Vec::new();
        for size in [extent(3, 2, 2), extent(1, 1, 1), extent(2, 3, 1), extent(3, 6, 4)] {
            crate::corner_candidates(&grid, size, &WalleWeights::PAPER, &mut candidates);
            let chosen = Heuristic::walle_choice(&candidates).map(|index| candidates[index].placement);
            assert_eq!(chosen, Heuristic::WalleCorners(WalleWeights::PAPER).choose(&grid, size));
        }
        assert_eq!(Heuristic::walle_choice(&[]), None);
    }

    #[test]
    fn a_fresh_container_is_the_last_resort() {
        for name in Heuristic::NAMES {
            let heuristic: Heuristic = name.parse().unwrap();
            assert_eq!(heuristic.to_string(), name);
            assert_eq!(heuristic.choose(&step(), extent(3, 6, 4)).map(|place| place.slot), Some(1), "{name}");
            assert_eq!(heuristic.choose(&step(), extent(3, 6, 5)), None, "{name}");
        }
        assert!("best-fit".parse::<Heuristic>().unwrap_err().to_string().contains("first-fit"));
    }
}
