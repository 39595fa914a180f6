//! A box costs no heap allocation once as many boxes were seen as are kept.

use allocation_counter::measure;
use bytemuck::Zeroable;
use candidates::Candidates;
use messages::{Belief, BeltState, BoxQueue, CandidateSet, UPCOMING_MAX, WireBox};
use packing::{ContainerSize, Grid, Heuristic, Recipe, Split, WalleWeights};

/// Boxes before the counting begins. All containers are open before it, so that memory for each is there.
const WARM_UP: usize = 16 + UPCOMING_MAX;

#[test]
fn a_box_is_answered_without_allocation() {
    let episode = Recipe::standard().episode(Split::Test, 1, 0).unwrap();
    let mut service = Candidates::new(WalleWeights::PAPER);
    let mut grid = Grid::new(ContainerSize::PAPER, 16).unwrap();
    let mut belief: Box<Belief> = Box::new(Zeroable::zeroed());
    let mut set: Box<CandidateSet> = Box::new(Zeroable::zeroed());
    let mut queue = BoxQueue { belt: BeltState::BoxPresent.to_wire(), ..BoxQueue::zeroed() };
    for (number, boxes) in episode.boxes.windows(3).enumerate() {
        belief.write(&grid);
        (queue.revision, queue.current) = (grid.revision(), WireBox::from(boxes[0]));
        queue.write_upcoming(boxes[1..].iter().copied());
        let counted = measure(|| {
            let found = service.find(&queue, &belief).expect("a box on the belt is answered");
            found.write(&mut set, 0);
            service.look_ahead(&queue);
        });
        assert!(number < WARM_UP || counted.count_total == 0, "box {number}: {counted:?}");
        let mut candidates = Vec::new();
        set.read_candidates(&mut candidates).unwrap();
        let best = Heuristic::walle_choice(&candidates).expect("a box that fits has candidates");
        grid.place(&boxes[0], candidates[best].placement).unwrap();
    }
    assert_eq!(service.tally().counters.handled, episode.boxes.len() as u64 - 2);
}
