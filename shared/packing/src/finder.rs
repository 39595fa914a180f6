//! The candidates of one box after another, without looking twice at a container that has not changed.

use crate::candidates::{Place, push_corners};
use crate::{Candidate, ContainerSize, Extent, Grid, WalleWeights};

/// Candidates of one container that have room from the start: more than one that is nearly full offers small boxes.
const RESERVED: usize = 256;

/// Finds what [`crate::corner_candidates`] finds, and keeps it by box and container, so that a box that was expected
/// costs the search of the containers that changed since then, however many are open.
///
/// It serves one grid: it tells changes by the revisions of the slots. [`CandidateFinder::forget`] comes before another
/// grid.
#[derive(Debug)]
pub struct CandidateFinder {
    weights: WalleWeights,
    /// What was found, by box.
    kept: Vec<Kept>,
    /// How often a box was asked about, to tell which was asked about longest ago.
    asked: u64,
    places: Vec<Place>,
}

/// What was found for boxes of one extent.
#[derive(Debug)]
struct Kept {
    extent: Option<Extent>,
    asked: u64,
    slots: Vec<InSlot>,
}

/// What was found in one container.
#[derive(Debug)]
struct InSlot {
    /// The container, its boxes and its revision.
    state: Option<(ContainerSize, u32, u32, u64)>,
    candidates: Vec<Candidate>,
}

impl CandidateFinder {
    /// A finder that ranks by these weights and keeps what it found for the last `boxes` extents, at least one.
    #[must_use]
    pub fn new(weights: WalleWeights, boxes: usize) -> Self {
        let kept = (0..boxes.max(1)).map(|_| Kept { extent: None, asked: 0, slots: Vec::new() }).collect();
        Self { weights, kept, asked: 0, places: Vec::with_capacity(4 * RESERVED) }
    }

    /// As [`crate::corner_candidates`]; `candidates` is cleared first.
    pub fn find(&mut self, grid: &Grid, extent: Extent, candidates: &mut Vec<Candidate>) {
        candidates.clear();
        for slot in grid.open_slots() {
            candidates.extend_from_slice(self.in_slot(grid, extent, slot));
        }
        if candidates.is_empty()
            && let Some(slot) = grid.fresh_slot()
        {
            candidates.extend_from_slice(self.in_slot(grid, extent, slot));
        }
    }

    /// Searches now for a box that will be asked about soon.
    pub fn expect(&mut self, grid: &Grid, extent: Extent) {
        for slot in grid.open_slots().chain(grid.fresh_slot()) {
            self.in_slot(grid, extent, slot);
        }
    }

    /// Forgets everything that was found.
    pub fn forget(&mut self) {
        self.kept.iter_mut().flat_map(|kept| &mut kept.slots).for_each(|slot| slot.state = None);
    }

    /// The candidates in one container.
    fn in_slot(&mut self, grid: &Grid, extent: Extent, slot: u16) -> &[Candidate] {
        self.asked += 1;
        let kept = match self.kept.iter().position(|kept| kept.extent == Some(extent)) {
            Some(index) => &mut self.kept[index],
            None => {
                let oldest = self.kept.iter_mut().min_by_key(|kept| kept.asked).expect("there is at least one");
                oldest.slots.iter_mut().for_each(|slot| slot.state = None);
                oldest.extent = Some(extent);
                oldest
            }
        };
        kept.asked = self.asked;
        let reserved = || InSlot { state: None, candidates: Vec::with_capacity(RESERVED) };
        kept.slots.resize_with(kept.slots.len().max(grid.slots().len()), reserved);
        let (found, container) = (&mut kept.slots[usize::from(slot)], &grid.slots()[usize::from(slot)]);
        let state = Some((grid.size(), container.container(), container.boxes(), container.revision()));
        if found.state != state {
            found.state = state;
            found.candidates.clear();
            push_corners(grid, slot, extent, &self.weights, &mut self.places, &mut found.candidates);
        }
        &found.candidates
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::candidates::tests::arb_grid;
    use crate::{BoxSpec, corner_candidates};

    fn by_definition(grid: &Grid, extent: Extent) -> Vec<Candidate> {
        let mut candidates = Vec::new();
        corner_candidates(grid, extent, &WalleWeights::PAPER, &mut candidates);
        candidates
    }

    proptest! {
        /// Boxes come, some of them expected; containers fill and leave.
        #[test]
        fn what_is_kept_is_what_would_be_found(
            mut grid in arb_grid(),
            boxes in prop::collection::vec((1u32..4, 1u32..4, 1u32..4, any::<prop::sample::Index>()), 1..30),
            kept in 1usize..4,
        ) {
            let mut finder = CandidateFinder::new(WalleWeights::PAPER, kept);
            let mut found = Vec::new();
            let spec = |&(l, b, h, _): &(u32, u32, u32, _)| BoxSpec::new(1, [l * 10, b * 10, h * 10]).unwrap();
            for (step, next) in boxes.iter().enumerate() {
                let extent = grid.extent(&spec(next));
                finder.find(&grid, extent, &mut found);
                prop_assert_eq!(&found, &by_definition(&grid, extent));
                if let Some(upcoming) = boxes.get(step + 1) {
                    finder.expect(&grid, grid.extent(&spec(upcoming)));
                }
                if found.is_empty() {
                    grid.replace(step as u16 % 3, 3 + step as u32).unwrap();
                } else {
                    grid.place(&spec(next), next.3.get(&found).placement).unwrap();
                }
            }
        }

        #[test]
        fn another_grid_is_another_grid(one in arb_grid(), other in arb_grid()) {
            let extent = Extent { length: 1, breadth: 2, height: 1 };
            let (mut finder, mut found) = (CandidateFinder::new(WalleWeights::PAPER, 1), Vec::new());
            for grid in [&one, &other, &one] {
                finder.forget();
                finder.find(grid, extent, &mut found);
                prop_assert_eq!(&found, &by_definition(grid, extent));
            }
        }
    }
}
