//! What a decision costs: encoding, scoring by engine and number of candidates, and all of it in one process.
//!
//! `cargo bench --workspace --bench scoring`

use divan::{Bencher, counter::ItemsCount};
use packing::{
    Candidate, ContainerSize, Draw, Extent, Grid, Heuristic, Placement, Recipe, Split, WalleWeights, Yaw,
    corner_candidates,
};
use policy::Weights;
use policy::{Architecture, Batch, Card, Encoder, Encoding, Engine, Model, Policy, PolicyKind, Scope, Training, Walls};

/// Candidates of a decision; the last is what a set of a crowded cell may come to.
const BATCHES: [usize; 6] = [1, 32, 128, 256, 512, 1024];

/// Containers that are open.
const OPEN: usize = 16;

/// Boxes that stand in them: most of an episode.
const PLACED: usize = 240;

fn main() {
    divan::main();
}

/// Sixteen open containers, nine tenths full, and the boxes to come.
fn scene() -> (Grid, Vec<Extent>) {
    let mut grid = Grid::new(ContainerSize::PAPER, OPEN).expect("the paper's grid");
    let episode = Recipe::standard().episode(Split::Test, 1, 0).expect("the standard recipe is possible");
    let mut candidates = Vec::new();
    for (number, spec) in episode.boxes[..PLACED].iter().enumerate() {
        let slot = (number % OPEN) as u16;
        corner_candidates(&grid, spec.extent(10), &WalleWeights::PAPER, &mut candidates);
        candidates.retain(|candidate| candidate.placement.slot == slot);
        let corner = Placement { slot, yaw: Yaw::Deg0, i: 0, j: 0, base: 0 };
        let best = Heuristic::walle_choice(&candidates).map_or(corner, |best| candidates[best].placement);
        let _no_room_in_this_container = grid.place(spec, best);
    }
    (grid, episode.boxes[PLACED..].iter().map(|spec| spec.extent(10)).collect())
}

/// A decision with this many candidates: those of the box that has the number nearest to it, repeated if they are few.
fn decision(count: usize) -> (Grid, Extent, Vec<Candidate>) {
    let (grid, extents) = scene();
    let of = |&extent: &Extent| {
        let mut candidates = Vec::new();
        corner_candidates(&grid, extent, &WalleWeights::PAPER, &mut candidates);
        (extent, candidates)
    };
    let all = extents.iter().map(of).filter(|(_, candidates)| !candidates.is_empty());
    let nearest = all.min_by_key(|(_, candidates)| candidates.len().abs_diff(count));
    let (extent, candidates) = nearest.expect("some box fits somewhere");
    let candidates = candidates.iter().copied().cycle().take(count).collect();
    (grid, extent, candidates)
}

/// A policy by the published network that looks at the candidates of all containers.
fn published(engine: Engine) -> Policy {
    let weights = Weights::untrained(Architecture::Published, &mut Draw::new(0, 1, 0));
    let (encoding, scope) = (Encoding::Published(Walls::Empty), Scope::AllContainers);
    let model = Model::new(Card { encoding, scope, training: Training::default() }, weights);
    let model = model.expect("finite weights make a model");
    Policy::new(PolicyKind::PackmanPublished, engine, Some(&model)).expect("the model is the policy's own")
}

fn score(bencher: Bencher, engine: Engine, count: usize) {
    let (grid, extent, candidates) = decision(count);
    let mut policy = published(engine);
    let counter = ItemsCount::new(count);
    bencher.counter(counter).bench_local(|| policy.choose(&grid, extent, &[], &candidates));
}

/// Encoding and the network, as all of these.
#[divan::bench(args = BATCHES)]
fn fused(bencher: Bencher, candidates: usize) {
    score(bencher, Engine::Fused, candidates);
}

#[divan::bench(args = BATCHES)]
fn burn_flex(bencher: Bencher, candidates: usize) {
    score(bencher, Engine::BurnFlex, candidates);
}

#[divan::bench(args = BATCHES)]
fn burn_ndarray(bencher: Bencher, candidates: usize) {
    score(bencher, Engine::BurnNdarray, candidates);
}

/// Writing every number out, as burn needs it; `fused` reads what it is made of.
#[divan::bench(args = BATCHES)]
fn encoding_in_full(bencher: Bencher, candidates: usize) {
    let (grid, extent, candidates) = decision(candidates);
    let (mut encoder, mut batch) = (Encoder::new(Walls::Empty), Batch::default());
    bencher.bench_local(|| {
        encoder.encode(&grid, extent, &candidates, &mut batch);
        batch.len()
    });
}

/// Candidates and choice of each box in turn, by policy.
#[divan::bench(args = PolicyKind::NAMES)]
fn decision_in_one_process(bencher: Bencher, name: &str) {
    let kind: PolicyKind = name.parse().expect("a policy's name");
    let model = kind.built_in_model().expect("the model that ships");
    let mut policy = Policy::new(kind, Engine::Fused, model.as_ref()).expect("the model is the policy's own");
    let ((grid, extents), mut candidates, mut next) = (scene(), Vec::new(), 0);
    bencher.bench_local(|| {
        next = (next + 1) % (extents.len() - 2);
        corner_candidates(&grid, extents[next], &WalleWeights::PAPER, &mut candidates);
        policy.choose(&grid, extents[next], &extents[next + 1..next + 3], &candidates)
    });
}
