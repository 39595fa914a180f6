//! What is believed, look by look, of a container whose truth the tests make.

use packing::{BoxSpec, Grid, Placement, Rules, Yaw};

use super::*;
use crate::{Camera, Fault, Imperfections, Matter, Truth};

const OPTICS: Optics = Optics {
    frames: 5,
    height_mm: 1.0,
    shift_mm: 0.0,
    dropout_share: 0.02,
    fault: Fault::None,
    fault_from: 0,
    fault_looks: 0,
};

/// One container of 40 x 40 cells with its truth, its camera and what is believed.
struct Cell {
    truth: Truth,
    camera: Camera,
    fusion: Fusion,
    grid: Grid,
}

impl Cell {
    fn new(imperfections: Imperfections, optics: Optics, clearance_mm: u16) -> Self {
        let size = ContainerSize::new(40, 40, 40, 10).unwrap();
        let rules = Rules { clearance_mm, ..Rules::default() };
        Self {
            truth: Truth::new(imperfections, size, 1),
            camera: Camera::new(optics, 1),
            fusion: Fusion::new(size, 1, 5.0),
            grid: Grid::with_rules(size, 1, rules).unwrap(),
        }
    }

    /// Commands a box, which really is set down somewhere else, and fuses what is seen of it.
    fn place(&mut self, id: u64, size_mm: [u32; 3], at: (u16, u16, u16), off_by: (f64, f64)) -> Result<Fused, Blind> {
        let spec = BoxSpec::new(id, size_mm).unwrap();
        let placement = Placement { slot: 0, yaw: Yaw::Deg0, i: at.0, j: at.1, base: at.2 };
        let room = self.grid.extent(&spec);
        let before = self.heights();
        self.grid.place(&spec, placement).unwrap();
        self.truth.set_down(&spec, room, placement);
        let mut slots = self.truth.slots().to_vec();
        if let Some(last) = slots[0].last_mut() {
            last.middle_mm = [last.middle_mm[0] + off_by.0, last.middle_mm[1] + off_by.1];
        }
        assert!(self.truth.go_on(&Matter::Standing(slots)));
        self.look(&Commanded { box_id: id, placement, room, sides_mm: size_mm }, &before)
    }

    fn look(&mut self, commanded: &Commanded, before: &[u16]) -> Result<Fused, Blind> {
        let mut heights = self.heights();
        let look = self.camera.look(&self.truth, 0, commanded.box_id);
        let fused = self.fusion.fuse(look, commanded, before, &mut heights);
        self.grid.update_slot(0, 0, 1, 1, &heights);
        fused
    }

    fn heights(&self) -> Vec<u16> {
        self.grid.slots()[0].surface().heights().to_vec()
    }

    /// The rows and columns that are believed to be so high, as ranges, if they are a rectangle.
    fn rectangle(&self, height: u16) -> (Range<usize>, Range<usize>) {
        let heights = self.heights();
        let cells: Vec<_> = (0..1600).filter(|&at| heights[at] == height).map(|at| (at / 40, at % 40)).collect();
        let range = |of: fn(&(usize, usize)) -> usize| {
            cells.iter().map(of).min().unwrap()..cells.iter().map(of).max().unwrap() + 1
        };
        let (rows, columns) = (range(|cell| cell.0), range(|cell| cell.1));
        assert_eq!(cells.len(), rows.len() * columns.len(), "no rectangle");
        (rows, columns)
    }
}

fn perfect() -> Imperfections {
    Imperfections::default()
}

#[test]
fn what_went_as_commanded_is_believed_as_commanded() {
    for clearance_mm in [0, 10] {
        let mut cell = Cell::new(perfect(), OPTICS, clearance_mm);
        let step = if clearance_mm == 0 { 10 } else { 12 };
        for (id, at) in (1..).zip([(0, 0, 0), (0, step, 0), (step, 0, 0), (0, 0, 10), (step, step, 0), (0, step, 10)]) {
            let fused = cell.place(id, [100; 3], at, (0.0, 0.0)).unwrap();
            assert_eq!((fused.is_corrected, fused.irreconcilable), (false, None), "box {id}");
            assert!(fused.offset_mm.unwrap().iter().all(|mm| mm.abs() < 1.0), "{fused:?}");
        }
    }
}

/// Sides that are no whole cells make the belief higher than the world; it stays as flat as it was commanded.
#[test]
fn flat_stays_flat() {
    let mut cell = Cell::new(perfect(), OPTICS, 0);
    for (id, at) in (1..).zip([(0, 0, 0), (0, 10, 0), (0, 0, 10), (0, 10, 10), (0, 0, 20)]) {
        assert!(!cell.place(id, [95, 97, 93], at, (0.0, 0.0)).unwrap().is_corrected);
    }
    assert_eq!(cell.rectangle(20), (0..10, 10..20));
    assert_eq!(cell.rectangle(30), (0..10, 0..10));
}

#[test]
fn a_box_within_the_tolerance_stands_where_it_was_commanded_to() {
    let mut cell = Cell::new(perfect(), OPTICS, 0);
    let fused = cell.place(1, [100; 3], (10, 10, 0), (4.0, -4.0)).unwrap();
    assert!(!fused.is_corrected);
    let [x, y] = fused.offset_mm.unwrap();
    assert!((x - 4.0).abs() < 1.5 && (y + 4.0).abs() < 1.5, "{fused:?}");
}

/// 8 mm are 3 more than the tolerance: one more cell, and none that it left. 21 mm are 16 more: two cells, and one left.
#[test]
fn a_box_beyond_the_tolerance_takes_the_cells_that_it_reaches() {
    let mut cell = Cell::new(perfect(), OPTICS, 0);
    assert!(cell.place(1, [100; 3], (10, 10, 0), (8.0, 0.0)).unwrap().is_corrected);
    assert_eq!(cell.rectangle(10), (10..21, 10..20));
    let mut cell = Cell::new(perfect(), OPTICS, 0);
    assert!(cell.place(1, [100; 3], (10, 10, 0), (0.0, -21.0)).unwrap().is_corrected);
    assert_eq!(cell.rectangle(10), (10..20, 8..19));
}

#[test]
fn a_box_on_the_edge_of_another_is_believed_as_high_as_it_is() {
    let mut cell = Cell::new(perfect(), OPTICS, 0);
    cell.place(1, [100, 100, 52], (0, 0, 0), (0.0, 0.0)).unwrap();
    // The belief says that the second stands beside the first; it hangs on it.
    let mut slots = cell.truth.slots().to_vec();
    slots[0][0].half_mm = [60.0, 50.0];
    assert!(cell.truth.go_on(&Matter::Standing(slots)));
    let fused = cell.place(2, [100; 3], (10, 0, 0), (0.0, 0.0)).unwrap();
    assert!(fused.is_corrected);
    assert_eq!(cell.rectangle(16), (10..20, 0..10), "152 mm are 16 cells");
}

#[test]
fn a_missing_box_is_noticed_and_not_believed() {
    let mut cell = Cell::new(Imperfections { drop_share: 1.0, ..perfect() }, OPTICS, 0);
    let fused = cell.place(7, [100; 3], (10, 10, 0), (0.0, 0.0)).unwrap();
    assert_eq!(fused.irreconcilable, Some(Irreconcilable::Missing { box_id: 7, slot: 0 }));
    assert!(cell.heights().iter().all(|&height| height == 0));
}

#[test]
fn something_foreign_is_noticed_and_not_built_into() {
    let mut cell = Cell::new(perfect(), OPTICS, 0);
    cell.truth.intrude(0, [350.0, 350.0], [30.0, 30.0], 75.0);
    let fused = cell.place(1, [100; 3], (0, 0, 0), (0.0, 0.0)).unwrap();
    assert_eq!(fused.irreconcilable, Some(Irreconcilable::Foreign { slot: 0, i: 32, j: 32, cells: 8 }));
    assert_eq!(cell.rectangle(8), (32..38, 32..38));
    assert_eq!(cell.place(2, [100; 3], (0, 10, 0), (0.0, 0.0)).unwrap().irreconcilable, None, "said once");
}

#[test]
fn a_neighbour_that_was_pushed_is_no_stranger() {
    let mut cell = Cell::new(perfect(), OPTICS, 0);
    cell.place(1, [100; 3], (15, 15, 0), (0.0, 0.0)).unwrap();
    let mut slots = cell.truth.slots().to_vec();
    slots[0][0].middle_mm[0] += 12.0;
    assert!(cell.truth.go_on(&Matter::Standing(slots)));
    let fused = cell.place(2, [100, 100, 50], (5, 15, 0), (0.0, 0.0)).unwrap();
    assert_eq!((fused.is_corrected, fused.irreconcilable), (true, None));
    assert_eq!(cell.rectangle(10), (15..26, 15..25));
}

/// One bad frame in five, of any kind, changes nothing.
#[test]
fn no_single_frame_is_believed() {
    for bad in [0.0, 500.0, -300.0, f32::NAN, f32::INFINITY] {
        let mut cell = Cell::new(perfect(), OPTICS, 0);
        cell.place(1, [100; 3], (10, 10, 0), (0.0, 0.0)).unwrap();
        let look = cell.camera.look(&cell.truth, 0, 2).unwrap();
        let mut frames = look.heights_mm.to_vec();
        frames[3 * 6400..4 * 6400].fill(bad);
        let look = Look { pixels: look.pixels, heights_mm: &frames };
        let placement = Placement { slot: 0, yaw: Yaw::Deg0, i: 10, j: 10, base: 0 };
        let room = Extent { length: 10, breadth: 10, height: 10 };
        let commanded = Commanded { box_id: 1, placement, room, sides_mm: [100; 3] };
        cell.fusion.replace(0);
        let mut heights = cell.heights();
        let fused = cell.fusion.fuse(Some(look), &commanded, &[0; 1600], &mut heights).unwrap();
        assert_eq!((fused.is_corrected, fused.irreconcilable), (false, None), "a frame of {bad}");
        assert_eq!(heights, cell.heights());
    }
}

#[test]
fn looks_that_cannot_be_trusted_are_named_and_change_nothing() {
    for (fault, says) in [
        (Fault::NotANumber, "sees only 0 %"),
        (Fault::Infinite, "sees only 0 %"),
        (Fault::WrongSize, "[79, 80] pixels, not [80, 80]"),
        (Fault::Frozen, "frozen"),
        (Fault::Away, "says nothing"),
    ] {
        let mut cell = Cell::new(perfect(), Optics { fault, fault_from: 2, ..OPTICS }, 0);
        cell.place(1, [100; 3], (0, 0, 0), (0.0, 0.0)).unwrap();
        let blind = cell.place(2, [100; 3], (0, 10, 0), (0.0, 0.0)).unwrap_err();
        assert!(blind.to_string().contains(says), "{blind}");
        assert_eq!(cell.rectangle(10), (0..10, 0..20), "the command is believed");
    }
    let size = ContainerSize::new(4, 4, 4, 10).unwrap();
    for (pixels, count) in [([8, 8], 0), ([8, 8], 63), ([8, 8], 64 * 10), ([64, 1], 64), ([0, 0], 0)] {
        let (heights_mm, mut heights) = (vec![0.0; count], [0; 16]);
        let placement = Placement { slot: 0, yaw: Yaw::Deg0, i: 0, j: 0, base: 0 };
        let room = Extent { length: 1, breadth: 1, height: 1 };
        let commanded = Commanded { box_id: 1, placement, room, sides_mm: [10; 3] };
        let look = Look { pixels, heights_mm: &heights_mm };
        let fused = Fusion::new(size, 1, 5.0).fuse(Some(look), &commanded, &[0; 16], &mut heights);
        assert!(matches!(fused, Err(Blind::WrongSize { .. })), "{count} heights of {pixels:?}");
    }
}

/// Whatever the heights are, reading them ends.
#[test]
fn no_heights_make_it_panic() {
    let strange = [f32::MAX, f32::MIN, -0.0, 1e30, f32::EPSILON, 1e9];
    for (round, height) in strange.into_iter().enumerate() {
        let mut cell = Cell::new(perfect(), OPTICS, 0);
        cell.place(1, [100; 3], (0, 0, 0), (0.0, 0.0)).unwrap();
        let frames = vec![height; 6400 * (1 + round % 3)];
        let placement = Placement { slot: 0, yaw: Yaw::Deg0, i: 30, j: 30, base: 0 };
        let room = Extent { length: 10, breadth: 10, height: 10 };
        let commanded = Commanded { box_id: 2, placement, room, sides_mm: [100; 3] };
        let mut heights = cell.heights();
        let look = Look { pixels: [80, 80], heights_mm: &frames };
        let before = heights.clone();
        cell.fusion.fuse(Some(look), &commanded, &before, &mut heights).unwrap();
        assert!(heights.iter().zip(&before).all(|(after, before)| after >= before), "{height} lowered something");
    }
}
