//! What believing costs: one look at a container of the paper's size in which fifty boxes stand.

use packing::{BoxSpec, ContainerSize, Grid, Placement, Yaw};
use physical::{Camera, Commanded, Fault, Fusion, Imperfections, Matter, Optics, Truth};

fn main() {
    divan::main();
}

/// A look at a box that stands as commanded, over five frames of 90 x 160 pixels.
#[divan::bench(args = [0, 15])]
fn fuse(bencher: divan::Bencher, off_by_mm: i32) {
    let size = ContainerSize::PAPER;
    let optics = Optics {
        frames: 5,
        height_mm: 1.0,
        shift_mm: 1.0,
        dropout_share: 0.01,
        fault: Fault::None,
        fault_from: 0,
        fault_looks: 0,
    };
    let mut truth = Truth::new(Imperfections::default(), size, 1);
    let mut grid = Grid::new(size, 1).expect("one container is a grid");
    let mut before = Vec::new();
    let mut last = None;
    for (id, at) in (1..).zip((0..4).flat_map(|i| (0..8).map(move |j| (i, j)))) {
        let spec = BoxSpec::new(id, [100, 100, 150]).expect("a box");
        let placement = Placement { slot: 0, yaw: Yaw::Deg0, i: 10 * at.0, j: 10 * at.1, base: 0 };
        before = grid.slots()[0].surface().heights().to_vec();
        grid.place(&spec, placement).expect("a free place");
        truth.set_down(&spec, spec.extent(10), placement);
        last = Some(Commanded { box_id: id, placement, room: spec.extent(10), sides_mm: [100, 100, 150] });
    }
    let commanded = last.expect("boxes were placed");
    let mut slots = truth.slots().to_vec();
    if let Some(standing) = slots[0].last_mut() {
        standing.middle_mm[0] += f64::from(off_by_mm);
    }
    assert!(truth.go_on(&Matter::Standing(slots)), "as many slots");
    // Two looks in turn, for the same one twice would be a frozen camera.
    let looks: Vec<Vec<f32>> =
        (1..=2).map(|at| Camera::new(optics, 1).look(&truth, 0, at).expect("a camera").heights_mm.to_vec()).collect();
    let mut fusion = Fusion::new(size, 1, 5.0);
    let mut turn = 0;
    bencher.bench_local(|| {
        turn = 1 - turn;
        fusion.replace(0);
        let mut heights = grid.slots()[0].surface().heights().to_vec();
        let look = physical::Look { pixels: [90, 160], heights_mm: &looks[turn] };
        let fused = fusion.fuse(Some(look), &commanded, &before, &mut heights).expect("a look that is trusted");
        assert!(fused.is_corrected == (off_by_mm > 0) && fused.irreconcilable.is_none(), "{fused:?}");
        heights
    });
}
