//! Grid and box to candidate set.
//!
//! Keeps nothing between boxes but a copy of the grid, which it brings up to date container by container, and what it
//! found for the boxes that are known to follow. A restart loses nothing: the next repetition of the observation is
//! answered.

use messages::{Belief, BeltState, BoxQueue, CANDIDATES_MAX, CandidateSet, GridCopy, Malformed, UPCOMING_MAX};
use packing::{BoxSpec, Candidate, CandidateFinder, WalleWeights};
use runtime::Tally;

/// The generator's state between two events.
#[derive(Debug)]
pub struct Candidates {
    finder: CandidateFinder,
    grid: GridCopy,
    /// Whose grid it is: another publisher's revisions count something else.
    publisher: u64,
    found: Vec<Candidate>,
    tally: Tally,
}

/// The candidates of one observation, ready to be written where scorers will read them.
#[derive(Debug)]
pub struct Found<'a> {
    queue: &'a BoxQueue,
    candidates: &'a [Candidate],
}

impl Candidates {
    /// A generator that ranks by these weights, for whoever has no better opinion in time.
    #[must_use]
    pub fn new(weights: WalleWeights) -> Self {
        let finder = CandidateFinder::new(weights, 1 + UPCOMING_MAX);
        let (grid, found) = (GridCopy::default(), Vec::with_capacity(CANDIDATES_MAX));
        Self { finder, grid, publisher: 0, found, tally: Tally::default() }
    }

    /// The candidates of the box at the pick position; nothing if there is none, or if box and belief are not of one
    /// revision. A repeated observation is answered again: somebody may have missed the first answer.
    pub fn find<'a>(&'a mut self, queue: &'a BoxQueue, belief: &Belief) -> Option<Found<'a>> {
        match self.try_find(queue, belief) {
            Ok(true) => Some(Found { queue, candidates: &self.found }),
            Ok(false) => None,
            Err(malformed) => {
                self.tally.refuse(&malformed);
                None
            }
        }
    }

    fn try_find(&mut self, queue: &BoxQueue, belief: &Belief) -> Result<bool, Malformed> {
        if queue.belt_state()? != BeltState::BoxPresent {
            return Ok(false);
        }
        if queue.revision != belief.revision {
            self.tally.pass_over();
            return Ok(false);
        }
        let spec = BoxSpec::try_from(queue.current)?;
        queue.known_upcoming()?;
        let grid = self.grid.follow(belief)?;
        if self.publisher != belief.header.publisher {
            self.publisher = belief.header.publisher;
            self.finder.forget();
        }
        self.finder.find(grid, grid.extent(&spec), &mut self.found);
        self.tally.handle(spec.id());
        Ok(true)
    }

    /// Searches for the boxes behind the one that was answered, while nobody waits: when one of them comes, only the
    /// containers that changed are searched again.
    pub fn look_ahead(&mut self, queue: &BoxQueue) {
        let (Some(grid), Ok(upcoming)) = (self.grid.grid(), queue.known_upcoming()) else { return };
        for spec in upcoming.iter().flat_map(|&wire| BoxSpec::try_from(wire)) {
            self.finder.expect(grid, grid.extent(&spec));
        }
    }

    /// What it did so far.
    #[must_use]
    pub fn tally(&self) -> &Tally {
        &self.tally
    }
}

impl Found<'_> {
    /// When the observation was made [ns].
    #[must_use]
    pub fn observed_ns(&self) -> u64 {
        self.queue.header.observed_ns
    }

    /// Writes the set for an observation that was received at `received_ns`.
    pub fn write(&self, set: &mut CandidateSet, received_ns: u64) {
        let queue = self.queue;
        (set.received_ns, set.boxes_stamp_ns) = (received_ns, queue.header.stamp_ns);
        (set.revision, set.current) = (queue.revision, queue.current);
        (set.upcoming, set.upcoming_count) = (queue.upcoming, queue.upcoming_count);
        set.write_candidates(self.candidates);
    }
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;
    use messages::WireBox;
    use packing::{ContainerSize, Extent, Grid, Placement, Yaw};

    use super::*;

    fn observation(size_mm: [u32; 3]) -> (Box<Belief>, BoxQueue) {
        let grid = Grid::new(ContainerSize::new(9, 9, 9, 10).unwrap(), 2).unwrap();
        let mut belief: Box<Belief> = Box::new(Zeroable::zeroed());
        belief.write(&grid);
        let current = WireBox { id: 5, size_mm, reserved: 0 };
        (belief, BoxQueue { current, belt: BeltState::BoxPresent.to_wire(), ..BoxQueue::zeroed() })
    }

    fn candidates() -> Candidates {
        Candidates::new(WalleWeights::PAPER)
    }

    #[test]
    fn an_observation_becomes_a_set() {
        let (belief, mut queue) = observation([30, 40, 50]);
        queue.header.observed_ns = 7;
        queue.header.stamp_ns = 8;
        let mut service = candidates();
        let found = service.find(&queue, &belief).unwrap();
        assert_eq!(found.observed_ns(), 7);
        let mut set: Box<CandidateSet> = Box::new(Zeroable::zeroed());
        found.write(&mut set, 9);
        assert_eq!((set.count, set.current.id, set.boxes_stamp_ns, set.received_ns), (8, 5, 8, 9));
        assert_eq!((service.tally().counters.handled, service.tally().counters.last_box), (1, 5));
    }

    #[test]
    fn an_expected_box_and_another_perception_get_what_the_grid_offers() {
        let mut grid = Grid::new(ContainerSize::new(9, 9, 9, 10).unwrap(), 2).unwrap();
        let (mut belief, mut queue) = observation([30, 40, 50]);
        let mut service = candidates();
        for publisher in 1..4 {
            belief.header.publisher = publisher;
            let mut expected = Vec::new();
            packing::corner_candidates(
                &grid,
                Extent { length: 3, breadth: 4, height: 5 },
                &WalleWeights::PAPER,
                &mut expected,
            );
            assert_eq!(service.find(&queue, &belief).unwrap().candidates, expected);
            (queue.upcoming[0], queue.upcoming_count) = (queue.current, 1);
            service.look_ahead(&queue);
            // Another perception begins anew: the same revisions mean other grids.
            grid = Grid::new(grid.size(), 2).unwrap();
            let place = Placement { slot: publisher as u16 % 2, yaw: Yaw::Deg0, i: 0, j: 0, base: 0 };
            grid.place(&BoxSpec::new(1, [20, 20, 10 * publisher as u32]).unwrap(), place).unwrap();
            belief.write(&grid);
            queue.revision = grid.revision();
        }
    }

    #[test]
    fn a_box_that_fits_nowhere_has_an_empty_set() {
        let (belief, queue) = observation([30, 40, 100]);
        let mut service = candidates();
        assert_eq!(service.find(&queue, &belief).unwrap().candidates.len(), 0);
    }

    #[test]
    fn an_empty_belt_and_an_old_revision_have_none() {
        let (mut belief, mut queue) = observation([30, 40, 50]);
        let mut service = candidates();
        belief.revision = 1;
        assert!(service.find(&queue, &belief).is_none());
        assert_eq!(service.tally().counters.stale, 1);
        queue.belt = BeltState::Waiting.to_wire();
        assert!(service.find(&queue, &belief).is_none());
        assert_eq!((service.tally().counters.stale, service.tally().counters.refused), (1, 0));
    }

    #[test]
    fn rubbish_is_refused_and_counted() {
        let (belief, good) = observation([30, 40, 50]);
        let mut service = candidates();
        let rubbish = [
            BoxQueue { belt: 9, ..good },
            BoxQueue { current: WireBox { size_mm: [0, 1, 1], ..good.current }, ..good },
            BoxQueue { upcoming_count: 99, ..good },
        ];
        for queue in &rubbish {
            assert!(service.find(queue, &belief).is_none());
        }
        let (mut belief, queue) = observation([30, 40, 50]);
        belief.slot_count = 0;
        assert!(service.find(&queue, &belief).is_none());
        assert_eq!(service.tally().counters.refused, 4);
    }
}
