//! Boxes that must fall, and boxes that must not.

use packing::{
    BoxSpec, ClosePolicy, Environment, Grid, Heuristic, PlacedBox, Placement, Recipe, Rules, Split, WalleWeights, Yaw,
};

use super::*;
use crate::Imperfections;

/// A container of 300 x 300 x 300 mm.
fn size() -> ContainerSize {
    ContainerSize::new(30, 30, 30, 10).unwrap()
}

/// Sets a box of these sides down at these cells with an arm that does not err.
fn set_down(container: &mut RigidContainer, id: u64, sides_mm: [u32; 3], i: u16, j: u16, base: u16) -> Settled {
    let spec = BoxSpec::new(id, sides_mm).unwrap();
    let placement = Placement { slot: 0, yaw: Yaw::Deg0, i, j, base };
    let brought = Imperfections::default().bring(&spec, spec.extent(10), placement, size()).unwrap();
    container.set_down(&brought)
}

fn fate(container: &RigidContainer, settled: &Settled) -> Fate {
    let lies = container.lying().iter().find(|lying| lying.box_id == settled.let_go.box_id);
    Fate::of(&settled.let_go, lies)
}

#[test]
fn a_box_on_the_floor_and_one_on_top_of_it_stay() {
    let mut container = RigidContainer::new(size());
    for (id, base) in [(1, 0), (2, 10), (3, 20)] {
        let settled = set_down(&mut container, id, [100; 3], 10, 10, base);
        assert_eq!((settled.collided, settled.stays, settled.pushed, settled.is_at_rest), (false, true, 0, true));
        assert_eq!(fate(&container, &settled), Fate::default());
        let standing = container.lying().last().unwrap().standing();
        assert!((standing.top_mm - f64::from(10 * (base + 10))).abs() < 0.5, "{standing:?}");
        assert!(standing.middle_mm.iter().all(|mm| (mm - 150.0).abs() < 0.1), "{standing:?}");
    }
}

#[test]
fn a_box_set_down_more_than_half_over_an_edge_falls() {
    let mut container = RigidContainer::new(size());
    set_down(&mut container, 1, [100, 300, 200], 0, 0, 0);
    let kept = set_down(&mut container, 2, [100, 100, 50], 4, 0, 20);
    assert_eq!(fate(&container, &kept), Fate::default(), "six tenths of it rest on the first");
    let falls = set_down(&mut container, 3, [100, 100, 50], 6, 20, 20);
    let fate = fate(&container, &falls);
    assert!(fate.fell && fate.moved, "four tenths do not do: {:?}", container.lying());
    assert!(falls.stays && falls.is_at_rest);
    assert_eq!(container.lying().len(), 3);
}

#[test]
fn what_is_touched_on_the_way_down_is_a_collision() {
    let mut container = RigidContainer::new(size());
    set_down(&mut container, 1, [100, 100, 200], 0, 0, 0);
    let hits = set_down(&mut container, 2, [100; 3], 9, 0, 0);
    assert!(hits.collided);
    assert!((hits.let_go.middle_mm[2] - 250.0).abs() < 1.0, "it is let go on top of the column: {:?}", hits.let_go);
    assert!(fate(&container, &hits).fell);
    assert!(!set_down(&mut container, 3, [100; 3], 20, 20, 0).collided);
}

#[test]
fn a_box_beside_another_touches_nothing() {
    let mut container = RigidContainer::new(size());
    for (id, (i, j)) in (1..).zip([(0, 0), (0, 20), (20, 0), (20, 20), (0, 10), (10, 0), (20, 10), (10, 20), (10, 10)])
    {
        let settled = set_down(&mut container, id, [100, 100, 200], i, j, 0);
        assert!(!settled.collided && settled.let_go.middle_mm[2] == 100.0, "{settled:?}");
        assert_eq!((fate(&container, &settled), settled.pushed), (Fate::default(), 0));
    }
}

#[test]
fn a_box_that_falls_over_the_wall_is_gone() {
    let mut container = RigidContainer::new(ContainerSize::new(30, 30, 10, 10).unwrap());
    set_down(&mut container, 1, [100, 100, 290], 0, 0, 0);
    // Tall, and by more than half beside the column, towards the wall.
    let wall = Brought {
        held: Standing {
            box_id: 2,
            middle_mm: [10.0, 50.0],
            half_mm: [50.0; 2],
            turn_rad: 0.0,
            base_mm: 0.0,
            top_mm: 0.0,
        },
        height_mm: 100.0,
        planned_mm: 290.0,
        meant_mm: [10.0, 50.0],
        walls: false,
    };
    let wall = Brought { held: Standing { middle_mm: [-10.0, 50.0], ..wall.held }, ..wall };
    let settled = container.set_down(&wall);
    assert!(!settled.stays);
    assert_eq!(container.lying().len(), 1);
    assert!(Fate::of(&settled.let_go, None).fell);
}

/// By hand: a cube of 100 mm on its edge is 141.42 mm high and wide, and 100 mm long.
#[test]
fn from_above_a_tilted_box_is_a_level_one_around_it() {
    let eighth = std::f64::consts::FRAC_PI_8;
    let mut lying =
        Lying { box_id: 1, half_mm: [50.0; 3], middle_mm: [100.0; 3], turn: [eighth.sin(), 0.0, 0.0, eighth.cos()] };
    let standing = lying.standing();
    assert!((standing.top_mm - 170.711).abs() < 1e-3 && (standing.base_mm - 29.289).abs() < 1e-3, "{standing:?}");
    assert!((standing.half_mm[0] - 50.0).abs() < 1e-3 && (standing.half_mm[1] - 70.711).abs() < 1e-3, "{standing:?}");
    assert!((lying.corners_mm().iter().map(|corner| corner[2]).fold(0.0, f64::max) - 170.711).abs() < 1e-3);
    // A quarter turn exchanges the sides, and what is left is never more than an eighth.
    lying = Lying {
        half_mm: [10.0, 20.0, 30.0],
        turn: [0.0, 0.0, 50f64.to_radians().sin(), 50f64.to_radians().cos()],
        ..lying
    };
    let standing = lying.standing();
    assert!((standing.half_mm[0] - 20.0).abs() < 1e-3 && (standing.half_mm[1] - 10.0).abs() < 1e-3, "{standing:?}");
    assert!((standing.turn_rad - 10f64.to_radians()).abs() < 1e-6);
}

#[test]
fn what_became_of_a_box_is_judged_by_where_it_was_let_go() {
    let let_go = Lying { box_id: 1, half_mm: [50.0; 3], middle_mm: [100.0, 100.0, 50.0], turn: [0.0, 0.0, 0.0, 1.0] };
    let check = |middle_mm: [f64; 3], tilt_deg: f64, expected: [bool; 3]| {
        let half = tilt_deg.to_radians() / 2.0;
        let fate = Fate::of(&let_go, Some(&Lying { middle_mm, turn: [half.sin(), 0.0, 0.0, half.cos()], ..let_go }));
        assert_eq!([fate.moved, fate.tilted, fate.fell], expected, "{middle_mm:?}, {tilt_deg}");
    };
    check([103.0, 103.9, 50.0], 4.9, [false; 3]);
    check([103.0, 104.1, 50.0], 4.9, [true, false, false]);
    check([100.0, 100.0, 1.0], 5.1, [false, true, false]);
    check([100.0, 100.0, -1.0], 0.0, [false, false, true]);
}

/// By hand: at 0.3 g a box slides only if friction is less, and tips only if it is 1 / 0.3 times as high as wide.
#[test]
fn shaking_topples_towers_and_leaves_slabs() {
    let mut container = RigidContainer::new(size());
    set_down(&mut container, 1, [100, 100, 100], 10, 10, 0);
    assert_eq!(container.shifted_by_shaking(0.3), 0);
    assert_eq!(container.shifted_by_shaking(1.0), 1, "friction holds half a g");
    set_down(&mut container, 2, [40, 40, 190], 13, 13, 10);
    assert_eq!(container.shifted_by_shaking(0.3), 1, "it is 4.75 times as high as wide");
}

/// The first containers of a test episode as a heuristic packs them with so much room around every box.
fn plan(clearance_mm: u16) -> Vec<PlacedBox> {
    let episode = Recipe::standard().episode(Split::Test, 1, 0).unwrap();
    let rules = Rules { clearance_mm, ..Rules::default() };
    let mut environment = Environment::on(Grid::with_rules(episode.container, 16, rules).unwrap(), ClosePolicy::Never);
    let walle = Heuristic::WalleCorners(WalleWeights::PAPER);
    for spec in &episode.boxes {
        environment.pack(spec, |grid, extent| walle.choose(grid, extent)).unwrap();
    }
    environment.placed().iter().filter(|placed| placed.container < 3).copied().collect()
}

/// Plays such a plan; every box's fate, and how all lie in the end.
fn play(plan: &[PlacedBox], clearance_mm: u16, imperfections: &Imperfections) -> (Vec<Fate>, Vec<Lying>) {
    let rules = Rules { clearance_mm, ..Rules::default() };
    let mut containers = vec![RigidContainer::new(ContainerSize::PAPER); 3];
    let mut let_go = Vec::new();
    for placed in plan {
        let room = rules.extent(&placed.spec, ContainerSize::PAPER).turned(placed.placement.yaw);
        let brought = imperfections.bring(&placed.spec, room, placed.placement, ContainerSize::PAPER).unwrap();
        let settled = containers[placed.container as usize].set_down(&brought);
        let is_perfect = imperfections.actuator_mm == 0.0;
        assert!(settled.is_at_rest || !is_perfect, "box {} never comes to rest", placed.spec.id());
        let_go.push(settled.let_go);
    }
    let lying: Vec<_> = containers.iter().flat_map(|container| container.lying().iter().copied()).collect();
    let find = |id: u64| lying.iter().find(|lying| lying.box_id == id);
    (let_go.iter().map(|let_go| Fate::of(let_go, find(let_go.box_id))).collect(), lying)
}

/// Also where every stack stands alone, and after as many motions as there are boxes.
#[test]
fn a_plan_with_full_support_stands_if_the_arm_does_not_err() {
    for clearance_mm in [0, 10] {
        let perfect = Imperfections::default();
        let plan = plan(clearance_mm);
        let (fates, lying) = play(&plan, clearance_mm, &perfect);
        assert!(fates.len() > 50 && lying.len() == fates.len());
        let fallen: Vec<_> = fates.iter().enumerate().filter(|(_, fate)| **fate != Fate::default()).collect();
        assert!(fallen.is_empty(), "clearance {clearance_mm}: {} of {}: {fallen:?}", fallen.len(), fates.len());
        let rules = Rules { clearance_mm, ..Rules::default() };
        for lies in &lying {
            let placed = plan.iter().find(|placed| placed.spec.id() == lies.box_id).unwrap();
            let room = rules.extent(&placed.spec, ContainerSize::PAPER).turned(placed.placement.yaw);
            let brought = perfect.bring(&placed.spec, room, placed.placement, ContainerSize::PAPER).unwrap();
            let off_mm = [0, 1].map(|axis| lies.middle_mm[axis] - brought.held.middle_mm[axis]);
            assert!(off_mm.iter().all(|mm| mm.abs() < 1.0), "box {} crept by {off_mm:?} mm", lies.box_id);
        }
    }
}

#[test]
fn the_same_errors_give_the_same_bits() {
    let noisy = Imperfections { seed: 5, actuator_mm: 5.0, yaw_deg: 1.0, ..Imperfections::default() };
    let plan = plan(0);
    let (first, again) = (play(&plan, 0, &noisy), play(&plan, 0, &noisy));
    assert!(first.0.iter().any(|fate| fate.tilted || fate.moved), "errors of 5 mm without clearance do something");
    assert_eq!(first, again);
}
