//! Whole episodes at high speed, for learning: one policy of moves, every container stays open.

use std::convert::Infallible;

use packing::{
    ClosePolicy, ContainerSize, Environment, Episode, Extent, Placement, SizeError, Step, Surface, WalleWeights,
    corner_candidates, corner_places,
};

use crate::lookahead::{Planner, Value};
use crate::moves::{ContainerView, Features, features};
use crate::policy::describe;
use crate::weights::Weights;

/// What an episode came to.
#[derive(Clone, Debug, PartialEq)]
pub struct Packed {
    /// Volume in every container, in the order they were opened [cells].
    pub packed_cells: Vec<u32>,
    /// Boxes that fitted into none of the containers allowed.
    pub set_aside: u32,
}

impl Packed {
    /// Volume share of the first `optimum` containers [-].
    #[must_use]
    pub fn fill(&self, size: ContainerSize, optimum: u32) -> f64 {
        let first = self.packed_cells.iter().take(optimum as usize).map(|&cells| u64::from(cells)).sum::<u64>();
        first as f64 / (f64::from(optimum) * size.volume_cells() as f64)
    }

    /// Containers used, the last one by how much of 60 % of it is full, so that a step towards saving it counts.
    #[must_use]
    pub fn containers(&self, size: ContainerSize) -> f64 {
        let Some((&last, others)) = self.packed_cells.split_last() else { return 0.0 };
        let last = f64::from(last) / size.volume_cells() as f64;
        others.len() as f64 + (last / 0.6).min(1.0) + f64::from(self.set_aside)
    }
}

/// Packs an episode by the highest value among the corner places of all open containers.
#[must_use]
pub fn pack_fast(episode: &Episode, weights: &Weights, containers_max: usize) -> Packed {
    let size = episode.container;
    let mut packed = Packed { packed_cells: Vec::new(), set_aside: 0 };
    let (mut surfaces, mut highest) = (Vec::<Surface>::new(), Vec::<u16>::new());
    let empty = Surface::empty(size);
    for spec in &episode.boxes {
        let extent = spec.extent(size.cell_mm());
        let open = surfaces.len() as u16;
        let mut best: Option<(f32, Placement)> = None;
        for (rank, surface) in (0..).zip(&surfaces) {
            let packed_cells = packed.packed_cells[usize::from(rank)];
            let view = ContainerView { rank, open, packed_cells, highest: highest[usize::from(rank)] };
            consider(surface, &view, extent, weights, &mut best);
        }
        if best.is_none() && surfaces.len() < containers_max {
            surfaces.push(empty.clone());
            packed.packed_cells.push(0);
            highest.push(0);
            let view = ContainerView { rank: open, open, packed_cells: 0, highest: 0 };
            consider(&empty, &view, extent, weights, &mut best);
        }
        let placed = best.and_then(|(_, placement)| {
            let turned = extent.turned(placement.yaw);
            let slot = usize::from(placement.slot);
            let base = surfaces[slot].place(turned, placement.i, placement.j).ok()?;
            packed.packed_cells[slot] += extent.volume_cells() as u32;
            highest[slot] = highest[slot].max(base + extent.height);
            Some(())
        });
        packed.set_aside += u32::from(placed.is_none());
    }
    packed
}

/// Packs an episode by plans for every box and the `upcoming` after it, searched by one beam of `width`.
///
/// # Errors
/// [`SizeError`] if the containers make no grid.
pub fn pack_planned(
    episode: &Episode,
    weights: &Weights,
    containers_max: usize,
    upcoming: usize,
    width: usize,
) -> Result<Packed, SizeError> {
    let size = episode.container;
    let mut environment = Environment::new(size, containers_max, ClosePolicy::Never)?;
    let (mut candidates, mut moves, mut values) = (Vec::new(), Vec::new(), Vec::new());
    let (mut planner, mut plain) = (Planner::new(&[width]), Plain(weights));
    let extents: Vec<Extent> = episode.boxes.iter().map(|spec| spec.extent(size.cell_mm())).collect();
    let mut packed = Packed { packed_cells: vec![0; containers_max], set_aside: 0 };
    for (index, spec) in episode.boxes.iter().enumerate() {
        let known = &extents[index..extents.len().min(index + 1 + upcoming)];
        let placed = environment.pack(spec, |grid, extent| {
            corner_candidates(grid, extent, &WalleWeights::PAPER, &mut candidates);
            describe(grid, extent, &candidates, &mut moves);
            let Ok(()) = plain.values(&moves, &mut values);
            let known = known.iter().copied();
            let Ok(plan) = planner.plan(grid, known, &candidates, &values, &mut plain, &mut || false);
            plan.map(|plan| candidates[plan.first].placement)
        });
        match placed {
            Ok(Step::Placed(placement)) => {
                packed.packed_cells[usize::from(placement.slot)] += extents[index].volume_cells() as u32;
            }
            Ok(Step::SetAside) | Err(_) => packed.set_aside += 1,
        }
    }
    packed.packed_cells.retain(|&cells| cells > 0);
    Ok(packed)
}

/// The network computed here and now.
struct Plain<'a>(&'a Weights);

impl Value for Plain<'_> {
    type Error = Infallible;

    fn values(&mut self, moves: &[Features], values: &mut Vec<f32>) -> Result<(), Infallible> {
        values.clear();
        values.extend(moves.iter().map(|features| self.0.value_of_move(features)));
        Ok(())
    }
}

fn consider(
    surface: &Surface,
    view: &ContainerView,
    extent: Extent,
    weights: &Weights,
    best: &mut Option<(f32, Placement)>,
) {
    corner_places(surface, view.rank, extent, &mut Vec::new(), |placement| {
        let value = weights.value_of_move(&features(surface, view, extent.turned(placement.yaw), placement));
        if best.is_none_or(|(highest, _)| value > highest) {
            *best = Some((value, placement));
        }
    });
}

#[cfg(test)]
mod tests {
    use packing::{Grid, Recipe, Split};

    use super::*;
    use crate::{Engine, Model, Policy, PolicyKind};

    /// The figures of the cell's own policy, box by box: the volume in every container.
    fn slowly(kind: PolicyKind, episode: &Episode, upcoming: usize) -> Vec<u32> {
        let model = Model::built_in().unwrap();
        let mut policy = Policy::new(kind, Engine::BurnFlex, Some(&model)).unwrap();
        let mut environment = Environment::new(episode.container, 16, ClosePolicy::Never).unwrap();
        let mut candidates = Vec::new();
        for (index, spec) in episode.boxes.iter().enumerate() {
            let cell_mm = episode.container.cell_mm();
            let known: Vec<_> =
                episode.boxes[index + 1..].iter().take(upcoming).map(|spec| spec.extent(cell_mm)).collect();
            let choose = |grid: &Grid, extent| {
                corner_candidates(grid, extent, &WalleWeights::PAPER, &mut candidates);
                let choice = policy.choose(grid, extent, &known, &candidates).unwrap();
                choice.map(|choice| candidates[choice.index].placement)
            };
            environment.pack(spec, choose).unwrap();
        }
        let packed = |slot: &packing::Slot| slot.surface().heights().iter().map(|&height| u32::from(height)).sum();
        environment.grid().slots().iter().map(packed).filter(|&cells| cells > 0).collect()
    }

    #[test]
    fn the_fast_way_is_the_cells_way_on_any_grid() {
        let model = Model::built_in().unwrap();
        let coarse = Recipe { container: ContainerSize::new(9, 16, 10, 50).unwrap(), ..Recipe::standard() };
        let coarse_episode = coarse.episode(Split::Validation, 3, 0).unwrap();
        let fast = pack_fast(&coarse_episode, model.weights(), 16);
        assert_eq!(fast.set_aside, 0);
        assert_eq!(slowly(PolicyKind::Packman, &coarse_episode, 0), fast.packed_cells);
        // A 1 cm grid rounds differently in the last bits, but the same boxes come to the same containers.
        let fine_episode = Recipe::standard().episode(Split::Validation, 3, 0).unwrap();
        let fine = slowly(PolicyKind::Packman, &fine_episode, 0);
        assert_eq!(fine.iter().map(|cells| u64::from(*cells)).sum::<u64>(), 10 * ContainerSize::PAPER.volume_cells());
        assert!(fine.len().abs_diff(fast.packed_cells.len()) <= 1, "{} and {}", fine.len(), fast.packed_cells.len());
    }

    /// Two containers of 100 cells, the second one third full: it counts as 0.333 / 0.6 of one.
    #[test]
    fn a_step_towards_saving_a_container_counts() {
        let size = ContainerSize::new(5, 4, 5, 10).unwrap();
        let packed = Packed { packed_cells: vec![90, 30], set_aside: 0 };
        assert!((packed.containers(size) - 1.5).abs() < 1e-9);
        assert!((packed.fill(size, 1) - 0.9).abs() < 1e-9);
        let misfit = Packed { set_aside: 1, ..packed };
        assert!((misfit.containers(size) - 2.5).abs() < 1e-9);
    }
}
