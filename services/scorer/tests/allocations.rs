//! A box costs no heap allocation.

use allocation_counter::measure;
use bytemuck::Zeroable;
use messages::{Belief, CandidateSet, Decision, Instance, WireBox};
use packing::{ContainerSize, Grid, Recipe, Split, WalleWeights, corner_candidates};
use policy::{Engine, Policy, PolicyKind};
use scorer::Scorer;

/// Boxes before the counting begins: the first creates the copy of the grid.
const WARM_UP: usize = 1;

#[test]
fn a_box_is_scored_without_allocation() {
    let episode = Recipe::standard().episode(Split::Test, 1, 0).unwrap();
    for kind in [PolicyKind::Walle, PolicyKind::PackmanPublished, PolicyKind::Packman] {
        let policy = Policy::new(kind, Engine::Fused, kind.built_in_model().unwrap().as_ref()).unwrap();
        let mut scorer = Scorer::new(policy, Instance::default());
        scorer.warm_up(ContainerSize::PAPER, 16);
        let mut grid = Grid::new(ContainerSize::PAPER, 16).unwrap();
        let mut belief: Box<Belief> = Box::new(Zeroable::zeroed());
        let mut set: Box<CandidateSet> = Box::new(Zeroable::zeroed());
        let mut decision = Decision::zeroed();
        let mut candidates = Vec::new();
        for (number, spec) in episode.boxes.iter().enumerate() {
            corner_candidates(&grid, spec.extent(10), &WalleWeights::PAPER, &mut candidates);
            belief.write(&grid);
            (set.current, set.revision) = (WireBox::from(*spec), grid.revision());
            set.write_candidates(&candidates);
            let counted = measure(|| {
                let verdict = scorer.decide(&set, &belief, 0, &mut || false).expect("a box that fits has a verdict");
                verdict.write(&mut decision, 0);
            });
            assert!(number < WARM_UP || counted.count_total == 0, "{kind}, box {number}: {counted:?}");
            grid.place(spec, candidates[decision.best as usize].placement).unwrap();
        }
        assert_eq!(scorer.tally().counters.handled, episode.boxes.len() as u64);
    }
}
