//! A box costs no heap allocation.

use allocation_counter::measure;
use bytemuck::Zeroable;
use messages::{Belief, CandidateSet, Decision, Instance, WireBox};
use packing::{ContainerSize, Grid, Recipe, Split, WalleWeights, corner_candidates};
use policy::{Engine, Policy, PolicyKind};
use scorer::Scorer;

/// Containers.
const SLOTS: usize = 16;

/// Boxes that are known to follow.
const UPCOMING: usize = 2;

#[test]
fn a_box_is_scored_without_allocation() {
    let episode = Recipe::standard().episode(Split::Test, 1, 0).unwrap();
    // Before the counting begins: the first box makes the copy of the grid, and a first episode the lists of plans.
    for (kind, warm_up) in [
        (PolicyKind::Walle, 1),
        (PolicyKind::PackmanPublished, 1),
        (PolicyKind::Packman, 1),
        (PolicyKind::PackmanLookahead, episode.boxes.len()),
    ] {
        let policy = Policy::new(kind, Engine::Fused, kind.built_in_model().unwrap().as_ref()).unwrap();
        let mut scorer = Scorer::new(policy, Instance::default());
        scorer.warm_up(ContainerSize::PAPER, SLOTS);
        let mut grid = Grid::new(ContainerSize::PAPER, SLOTS).unwrap();
        let mut belief: Box<Belief> = Box::new(Zeroable::zeroed());
        let mut set: Box<CandidateSet> = Box::new(Zeroable::zeroed());
        let mut decision = Decision::zeroed();
        let mut candidates = Vec::new();
        for number in 0..2 * episode.boxes.len() {
            let boxes = &episode.boxes[number % episode.boxes.len()..];
            if number == episode.boxes.len() {
                (0..SLOTS as u16).for_each(|slot| grid.replace(slot, SLOTS as u32 + u32::from(slot)).unwrap());
            }
            corner_candidates(&grid, boxes[0].extent(10), &WalleWeights::PAPER, &mut candidates);
            belief.write(&grid);
            (set.current, set.revision) = (WireBox::from(boxes[0]), grid.revision());
            let upcoming = boxes[1..].iter().take(UPCOMING);
            set.upcoming_count = upcoming.len() as u32;
            set.upcoming.iter_mut().zip(upcoming).for_each(|(wire, spec)| *wire = WireBox::from(*spec));
            set.write_candidates(&candidates);
            let counted = measure(|| {
                let verdict = scorer.decide(&set, &belief, 0, &mut || false).expect("a box that fits has a verdict");
                verdict.write(&mut decision, 0);
            });
            assert!(number < warm_up || counted.count_total == 0, "{kind}, box {number}: {counted:?}");
            grid.place(&boxes[0], candidates[decision.best as usize].placement).unwrap();
        }
        assert_eq!(scorer.tally().counters.handled, 2 * episode.boxes.len() as u64);
    }
}
