//! Whole episodes at high speed, for learning: one policy of moves, every container stays open.

use packing::{ContainerSize, Episode, Extent, Placement, Surface, corner_places};

use crate::moves::{ContainerView, features};
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

fn consider(
    surface: &Surface,
    view: &ContainerView,
    extent: Extent,
    weights: &Weights,
    best: &mut Option<(f32, Placement)>,
) {
    corner_places(surface, view.rank, extent, |placement| {
        let value = weights.value_of_move(&features(surface, view, extent.turned(placement.yaw), placement));
        if best.is_none_or(|(highest, _)| value > highest) {
            *best = Some((value, placement));
        }
    });
}
