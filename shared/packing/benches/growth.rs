//! What finer grid cells cost: the same half-full container at 1, 4 and 16 times the paper's 45 x 80 cells; and what
//! more open containers cost.
//!
//! `cargo bench --workspace --bench growth` prints the time of one box; with linear cost it grows by 4 from row to row.

use divan::{Bencher, counter::ItemsCount};
use packing::{
    BoxSpec, CandidateFinder, ContainerOrder, ContainerSize, Extent, Grid, Heuristic, Placement, Recipe, Split,
    WalleWeights, corner_candidates,
};

/// Grid cells along a side of the paper's, so that a container has its square times as many.
const SIDES: [u16; 3] = [1, 2, 4];

/// Containers that are open.
const CONTAINERS: [usize; 3] = [1, 4, 16];

/// Boxes that stand in a container.
const PLACED: usize = 20;

/// Boxes that are asked about, so that one size does not decide.
const ASKED: usize = 32;

fn main() {
    divan::main();
}

/// A half-full container with `side` times the paper's cells along each side, and the boxes to come.
fn scene(side: u16) -> (Grid, Vec<Extent>) {
    let paper = ContainerSize::PAPER;
    let size = ContainerSize::new(paper.length() * side, paper.breadth() * side, paper.height() * side, 10);
    let mut grid = size.and_then(|size| Grid::new(size, 1)).expect("one container makes a grid");
    let episode = Recipe::standard().episode(Split::Test, 1, 0).expect("the standard recipe is possible");
    let scaled = |spec: &BoxSpec| BoxSpec::new(spec.id(), spec.size_mm().map(|mm| mm * u32::from(side)));
    let boxes: Vec<BoxSpec> = episode.boxes.iter().map(|spec| scaled(spec).expect("a box within limits")).collect();
    let walle = Heuristic::WalleCorners(WalleWeights::PAPER);
    for spec in &boxes[..PLACED] {
        if let Some(place) = walle.choose(&grid, spec.extent(10)) {
            grid.place(spec, place).expect("a feasible choice");
        }
    }
    (grid, boxes[PLACED..PLACED + ASKED].iter().map(|spec| spec.extent(10)).collect())
}

fn choose(bencher: Bencher, side: u16, heuristic: Heuristic) {
    let (grid, extents) = scene(side);
    let order = ContainerOrder::FirstThatFits;
    bencher.counter(ItemsCount::new(ASKED)).bench(|| {
        extents.iter().filter_map(|&extent| heuristic.choose_in(order, &grid, extent)).map(|place| place.base).max()
    });
}

#[divan::bench(args = SIDES)]
fn corner_candidates_of_a_box(bencher: Bencher, side: u16) {
    let (grid, extents) = scene(side);
    let mut candidates = Vec::new();
    bencher.counter(ItemsCount::new(ASKED)).bench_local(|| {
        let found = extents.iter().map(|&extent| {
            corner_candidates(&grid, extent, &WalleWeights::PAPER, &mut candidates);
            candidates.len()
        });
        found.sum::<usize>()
    });
}

/// Every feasible place is looked at: floor building needs them all.
#[divan::bench(args = SIDES)]
fn feasible_places_of_a_box(bencher: Bencher, side: u16) {
    choose(bencher, side, Heuristic::Floor);
}

#[divan::bench(args = SIDES)]
fn walle_over_all_cells(bencher: Bencher, side: u16) {
    choose(bencher, side, Heuristic::Walle(WalleWeights::PAPER));
}

/// Setting a box down brings the surface up to date.
#[divan::bench(args = SIDES)]
fn placing_a_box(bencher: Bencher, side: u16) {
    let (grid, _) = scene(side);
    let spec = BoxSpec::new(0, [10; 3]).expect("a box within limits");
    let place = Heuristic::FirstFit.choose(&grid, spec.extent(10)).expect("room for the smallest box");
    let place = Placement { slot: 0, ..place };
    bencher.with_inputs(|| grid.clone()).bench_values(|mut grid| {
        grid.place(&spec, place).expect("a feasible choice");
        grid
    });
}

/// The containers of a cell, each half full, and a box to come.
fn containers(count: usize) -> (Grid, BoxSpec) {
    let (half_full, _) = scene(1);
    let mut grid = Grid::new(ContainerSize::PAPER, count).expect("the paper's grid");
    for slot in 0..count as u16 {
        grid.update_slot(slot, u32::from(slot), PLACED as u32, 1, half_full.slots()[0].surface().heights());
    }
    (grid, BoxSpec::new(0, [150, 200, 50]).expect("a box within limits"))
}

/// Every open container is searched.
#[divan::bench(args = CONTAINERS)]
fn an_unexpected_box_among_containers(bencher: Bencher, count: usize) {
    let ((grid, spec), mut candidates) = (containers(count), Vec::new());
    bencher.bench_local(|| {
        corner_candidates(&grid, spec.extent(10), &WalleWeights::PAPER, &mut candidates);
        candidates.len()
    });
}

/// One container changed since the box was expected: it is copied and searched, and no other.
#[divan::bench(args = CONTAINERS)]
fn an_expected_box_among_containers(bencher: Bencher, count: usize) {
    let ((mut grid, spec), mut candidates) = (containers(count), Vec::new());
    let mut finder = CandidateFinder::new(WalleWeights::PAPER, 9);
    finder.expect(&grid, spec.extent(10));
    let before = grid.slots()[0].surface().heights().to_vec();
    let first = Heuristic::FirstFit.choose(&grid, spec.extent(10)).expect("room for the box");
    grid.place(&spec, Placement { slot: 0, ..first }).expect("a feasible choice");
    let states = [before, grid.slots()[0].surface().heights().to_vec()];
    let mut revision = grid.revision();
    bencher.bench_local(|| {
        revision += 1;
        grid.update_slot(0, 0, PLACED as u32, revision, &states[revision as usize % 2]);
        finder.find(&grid, spec.extent(10), &mut candidates);
        candidates.len()
    });
}
