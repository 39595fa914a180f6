//! The physical side alone, in a time that the tests make.

use std::fs;

use bytemuck::Zeroable;
use packing::{ContainerSize, Yaw};
use physical::Matter;

use super::*;

const MS: u64 = 1_000_000;

fn size() -> ContainerSize {
    ContainerSize::new(4, 4, 4, 10).unwrap()
}

/// A cell of two small containers and a belt with these boxes.
fn perception(boxes: &str, behaviour: Behaviour) -> Perception {
    perception_of(1, boxes, behaviour)
}

/// The same, whose stream has so many episodes.
fn perception_of(episodes: u64, boxes: &str, behaviour: Behaviour) -> Perception {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("stream.json");
    let text = format!(r#"{{"meta": {{"name": "s", "unit": "cm", "container": [4, 4, 4]}}, "episodes": [{boxes}]}}"#);
    fs::write(&path, text).unwrap();
    let belt = Belt::open(path.to_str().unwrap(), 0, episodes, size()).unwrap();
    Perception::new(behaviour, Grid::new(size(), 2).unwrap(), belt, 0)
}

fn behaviour() -> Behaviour {
    Behaviour { pace_ns: 0, motion_ns: 0, repeat_ns: 20 * MS, upcoming: 2 }
}

fn on_time(perception: &mut Perception, now_ns: u64) -> Vec<Say> {
    let mut say = Vec::new();
    perception.on_time(now_ns, &mut say);
    move_on(perception, now_ns, &mut say);
    say
}

fn command(perception: &mut Perception, action: Action, placement: Placement, now_ns: u64) -> Vec<Say> {
    let queue = boxes(perception);
    let (spec, revision) = (queue.current, queue.revision);
    let action = action.to_wire();
    let (order, placement) = (7, placement.into());
    let command = PlaceCommand { order, spec, revision, action, placement, ..PlaceCommand::zeroed() };
    let mut say = Vec::new();
    perception.on_command(&command, now_ns, &mut say);
    move_on(perception, now_ns, &mut say);
    say
}

/// Keeps the world and lets it move on, as its process does, until there is nothing to do.
fn move_on(perception: &mut Perception, now_ns: u64, say: &mut Vec<Say>) {
    while perception.is_changed() {
        perception.kept(Ok(()));
        perception.on_time(now_ns, say);
    }
}

/// What the arm says of the first order, which is to place the first box.
fn report(outcome: MotionOutcome) -> MotionReport {
    let (box_id, action, outcome) = (1, Action::Place.to_wire(), outcome.to_wire());
    MotionReport { order: 7, box_id, action, outcome, ..MotionReport::zeroed() }
}

fn boxes(perception: &Perception) -> BoxQueue {
    let mut queue = BoxQueue::zeroed();
    perception.write_boxes(&mut queue);
    queue
}

fn at(slot: u16, j: u16) -> Placement {
    Placement { slot, yaw: Yaw::Deg0, i: 0, j, base: 0 }
}

#[test]
fn a_box_is_said_again_until_the_arm_has_it() {
    let mut perception = perception("[[1, 2, 3], [2, 2, 2], [3, 3, 3], [1, 1, 1]]", behaviour());
    assert_eq!(on_time(&mut perception, 5), [Say::Boxes(5)]);
    let queue = boxes(&perception);
    assert_eq!((queue.belt_state(), queue.current.id), (Ok(BeltState::BoxPresent), 1));
    assert_eq!(queue.known_upcoming().unwrap().iter().map(|wire| wire.id).collect::<Vec<_>>(), [2, 3]);
    assert_eq!(on_time(&mut perception, 6), []);
    assert_eq!(on_time(&mut perception, 5 + 20 * MS), [Say::Boxes(5)], "the stamp is that of the first sight");
}

#[test]
fn a_placed_box_changes_the_belief_and_the_next_one_comes() {
    let mut perception = perception("[[1, 2, 3], [2, 2, 2]]", behaviour());
    on_time(&mut perception, 5);
    let said = command(&mut perception, Action::Place, at(0, 0), 9);
    assert_eq!(said, [Say::Motion(report(MotionOutcome::Done)), Say::Belief, Say::Boxes(9)]);
    assert_eq!((perception.grid().revision(), boxes(&perception).current.id), (1, 2));
    command(&mut perception, Action::SetAside, at(0, 0), 10);
    assert_eq!(boxes(&perception).belt_state(), Ok(BeltState::Ended));
    assert_eq!(boxes(&perception).taken, 2);
    assert_eq!(perception.wake_ns(), None);
}

#[test]
fn a_command_is_obeyed_once_and_only_for_what_lies_there() {
    let mut perception = perception("[[1, 2, 3], [1, 2, 3]]", behaviour());
    on_time(&mut perception, 5);
    let queue = boxes(&perception);
    let first = PlaceCommand { spec: queue.current, placement: at(0, 0).into(), ..PlaceCommand::zeroed() };
    let mut say = Vec::new();
    perception.on_command(&first, 6, &mut say);
    move_on(&mut perception, 6, &mut say);
    let before = perception.grid().revision();
    say.clear();
    perception.on_command(&first, 7, &mut say);
    perception.on_command(&PlaceCommand { revision: 77, ..first }, 7, &mut say);
    assert_eq!((say.len(), perception.grid().revision()), (0, before));
    assert_eq!(perception.tally().counters.stale, 2);
}

#[test]
fn an_impossible_command_is_refused_and_the_box_stays() {
    let mut perception = perception("[[1, 2, 3]]", behaviour());
    on_time(&mut perception, 5);
    for placement in [at(7, 0), at(0, 3), Placement { base: 2, ..at(0, 0) }] {
        let said = command(&mut perception, Action::Place, placement, 6);
        assert_eq!(said, [Say::Motion(report(MotionOutcome::Refused))]);
    }
    assert_eq!(boxes(&perception).belt_state(), Ok(BeltState::BoxPresent));
    assert_eq!((perception.tally().counters.refused, perception.grid().revision()), (3, 0));
}

#[test]
fn a_replaced_container_is_empty_and_the_box_is_observed_anew() {
    let mut perception = perception("[[4, 4, 4], [4, 4, 4]]", behaviour());
    on_time(&mut perception, 5);
    command(&mut perception, Action::Place, at(0, 0), 6);
    let said = command(&mut perception, Action::Replace, at(0, 0), 7);
    assert_eq!(said[1..], [Say::Belief, Say::Boxes(7)]);
    assert_eq!((perception.grid().slots()[0].container(), perception.grid().slots()[0].boxes()), (2, 0));
    assert_eq!((boxes(&perception).current.id, boxes(&perception).revision), (2, 2));
}

#[test]
fn boxes_come_at_their_pace_and_the_arm_takes_its_time() {
    let slow = Behaviour { pace_ns: 100 * MS, motion_ns: 30 * MS, ..behaviour() };
    let mut perception = perception("[[1, 1, 1], [1, 1, 1]]", slow);
    on_time(&mut perception, 0);
    assert_eq!(command(&mut perception, Action::Place, at(0, 0), 10 * MS), [Say::Boxes(0)]);
    assert_eq!(boxes(&perception).belt_state(), Ok(BeltState::Taken));
    assert_eq!(perception.wake_ns(), Some(40 * MS));
    assert_eq!(on_time(&mut perception, 40 * MS).len(), 2, "the motion and the belief, and no box yet");
    assert_eq!(perception.wake_ns(), Some(100 * MS));
    assert_eq!(on_time(&mut perception, 100 * MS), [Say::Boxes(100 * MS)]);
}

#[test]
fn containers_are_emptied_between_episodes() {
    let mut perception = perception("[[1, 1, 1]], [[2, 2, 2]]", behaviour());
    perception.belt = {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s.csv");
        fs::write(&path, "episode,l,b,h\n0,10,10,10\n1,20,20,20\n").unwrap();
        Belt::open(path.to_str().unwrap(), 0, 0, size()).unwrap()
    };
    on_time(&mut perception, 5);
    let said = command(&mut perception, Action::Place, at(1, 0), 6);
    assert_eq!(said.len(), 4, "motion, belief, the emptied belief, and the first box of the next episode");
    assert!(perception.grid().slots().iter().all(|slot| !slot.is_open()));
    assert_eq!(perception.grid().slots().iter().map(Slot::container).collect::<Vec<_>>(), [2, 3]);
    assert_eq!((boxes(&perception).current.id, boxes(&perception).episodes), (2, 2));
    command(&mut perception, Action::Place, at(0, 0), 7);
    assert_eq!(
        (boxes(&perception).current.id, boxes(&perception).current.size_mm),
        (3, [10, 10, 10]),
        "the file again"
    );
}

use packing::Slot;

#[test]
fn streams_that_cannot_be_packed_are_refused() {
    let message = Belt::open("standrad", 0, 1, size()).unwrap_err().to_string();
    assert!(message.contains("standard") && message.contains(".json"), "{message}");
    let message = Belt::open("standard", 0, 1, size()).unwrap_err().to_string();
    assert!(message.contains("45 x 80 x 50 cells of 10 mm") && message.contains("[container]"), "{message}");
    assert!(Belt::open("/nonexistent.json", 0, 1, size()).is_err());
}

/// A stub that dies and comes back, with the world that was kept last.
fn restart(perception: &Perception, boxes: &str, behaviour: Behaviour, now_ns: u64) -> Perception {
    let mut bytes = Vec::new();
    perception.world().encode(&mut bytes);
    let world = World::decode(&bytes).unwrap();
    assert_eq!(world, perception.world());
    let belt = self::perception(boxes, behaviour).belt;
    Perception::resume(behaviour, &Grid::new(size(), 2).unwrap(), belt, &world, now_ns).unwrap()
}

#[test]
fn a_restarted_stub_finds_the_world_as_it_was_left() {
    let stream = "[[1, 2, 3], [2, 2, 2], [3, 3, 3]], [[4, 4, 4]]";
    let mut perception = perception(stream, behaviour());
    on_time(&mut perception, 5);
    command(&mut perception, Action::Place, at(0, 0), 9);
    let mut restarted = restart(&perception, stream, behaviour(), 1000);
    let mut said = Vec::new();
    restarted.begin(&mut said);
    assert_eq!(said, [Say::Belief, Say::Motion(report(MotionOutcome::Done))]);
    assert_eq!(on_time(&mut restarted, 1000), [Say::Boxes(1000)]);
    let due_ns = boxes(&perception).due_ns;
    assert_eq!(BoxQueue { due_ns, ..boxes(&restarted) }, boxes(&perception), "the same box on the same belief");
    assert_eq!((due_ns, boxes(&restarted).due_ns), (9, 1000), "a belt that stood still begins its schedule anew");
    assert_eq!(restarted.grid().slots()[0].surface().heights(), perception.grid().slots()[0].surface().heights());
    assert_eq!(restarted.grid().slots()[0].revision(), perception.grid().slots()[0].revision());
    // What the old one was told, the new one does as well.
    let said = command(&mut restarted, Action::Place, at(0, 2), 1001);
    assert_eq!(said, command(&mut perception, Action::Place, at(0, 2), 1001));
}

#[test]
fn a_motion_that_was_under_way_is_not_forgotten() {
    let slow = Behaviour { motion_ns: 30 * MS, ..behaviour() };
    let mut perception = perception("[[1, 1, 1], [1, 1, 1]]", slow);
    on_time(&mut perception, 0);
    command(&mut perception, Action::Place, at(0, 0), 10 * MS);
    let mut restarted = restart(&perception, "[[1, 1, 1], [1, 1, 1]]", slow, 500 * MS);
    assert_eq!(boxes(&restarted).belt_state(), Ok(BeltState::Taken));
    assert_eq!(restarted.wake_ns(), Some(530 * MS));
    let said = on_time(&mut restarted, 530 * MS);
    assert_eq!(said, [Say::Motion(report(MotionOutcome::Done)), Say::Belief, Say::Boxes(530 * MS)]);
    assert_eq!((boxes(&restarted).current.id, boxes(&restarted).taken), (2, 1));
}

#[test]
fn worlds_that_do_not_fit_are_refused() {
    let mut perception = perception("[[1, 2, 3], [2, 2, 2]]", behaviour());
    on_time(&mut perception, 5);
    command(&mut perception, Action::Place, at(0, 0), 9);
    let world = perception.world();
    let resume = |boxes: &str, slots: usize| {
        let belt = self::perception(boxes, behaviour()).belt;
        let message = Perception::resume(behaviour(), &Grid::new(size(), slots).unwrap(), belt, &world, 0);
        message.err().map(|error| error.to_string()).unwrap_or_default()
    };
    assert_eq!(resume("[[1, 2, 3], [2, 2, 2]]", 2), "");
    assert!(resume("[[1, 2, 3], [3, 3, 3]]", 2).contains("another stream"));
    assert!(resume("[[1, 2, 3], [2, 2, 2]]", 3).contains("the cell has 3 x [4, 4, 4] cells"));
    let mut bytes = Vec::new();
    world.encode(&mut bytes);
    for length in 0..bytes.len() {
        assert!(World::decode(&bytes[..length]).is_err(), "cut at {length}");
    }
    for at in 0..bytes.len() {
        let mut flipped = bytes.clone();
        flipped[at] ^= 1;
        assert!(World::decode(&flipped).is_err(), "flipped at {at}");
    }
}

/// A stub in a world of these settings, with two containers of 20 x 20 x 20 cells and boxes of 100 mm.
fn in_world(overrides: &[&str], boxes: usize) -> Perception {
    let overrides: Vec<String> = overrides.iter().map(|&text| text.to_owned()).collect();
    let config = runtime::Config::default().overridden(&overrides).unwrap();
    let size = ContainerSize::new(20, 20, 20, 10).unwrap();
    let grid = Grid::with_rules(size, 2, config.rules()).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("stream.json");
    let list = vec!["[10, 10, 10]"; boxes].join(", ");
    let text =
        format!(r#"{{"meta": {{"name": "s", "unit": "cm", "container": [20, 20, 20]}}, "episodes": [[{list}]]}}"#);
    fs::write(&path, text).unwrap();
    let belt = Belt::open(path.to_str().unwrap(), 0, 1, size).unwrap();
    let reality = Reality::of(&config, &grid);
    Perception::new(behaviour(), grid, belt, 0).in_reality(reality, None).unwrap()
}

const CAMERA: &str = "belief.source=camera";
const PHYSICS: &str = "world.kind=physics";

fn heights(perception: &Perception) -> &[u16] {
    perception.grid().slots()[0].surface().heights()
}

#[test]
fn a_world_without_errors_is_the_commanded_one() {
    assert!(Reality::of(&runtime::Config::default(), &Grid::new(size(), 2).unwrap()).is_none());
    let pack = |settings: &[&str]| {
        let mut perception = in_world(settings, 4);
        on_time(&mut perception, 1);
        for (j, base, now_ns) in [(0, 0, 2), (10, 0, 3), (10, 10, 4)] {
            command(&mut perception, Action::Place, Placement { base, ..at(0, j) }, now_ns);
        }
        perception
    };
    let plain = pack(&[]);
    for seen in [pack(&[CAMERA]), pack(&[CAMERA, PHYSICS])] {
        assert_eq!(heights(&plain), heights(&seen));
        assert_eq!(plain.grid().revision(), seen.grid().revision(), "nothing was corrected");
        assert_eq!(boxes(&plain), boxes(&seen));
    }
}

#[test]
fn what_the_camera_sees_is_believed_and_moves_the_revision() {
    let noisy = ["world.actuator_mm=15", "world.seed=1", CAMERA];
    let mut blind = in_world(&noisy[..2], 4);
    let mut seen = in_world(&noisy, 4);
    for perception in [&mut blind, &mut seen] {
        on_time(perception, 1);
        let said = command(perception, Action::Place, at(0, 5), 2);
        assert_eq!(said.len(), 3, "motion, belief and the next box");
    }
    assert_eq!(blind.grid().revision(), 1);
    assert_eq!(seen.grid().revision(), 2, "placed and corrected");
    assert_eq!(boxes(&seen).revision, 2, "the next box goes with what is believed now");
    assert_ne!(heights(&blind), heights(&seen));
}

#[test]
fn a_lost_box_raises_an_alarm_until_its_container_leaves() {
    let mut perception = in_world(&["world.drop_share=1", CAMERA], 4);
    on_time(&mut perception, 1);
    command(&mut perception, Action::Place, at(0, 0), 2);
    assert!(perception.tally().alarm().contains("box 1 is missing from slot 0"), "{}", perception.tally().alarm());
    assert!(heights(&perception).iter().all(|&height| height == 0), "nothing is believed to stand there");
    command(&mut perception, Action::Replace, at(0, 0), 3);
    assert_eq!(perception.tally().alarm(), "");
}

#[test]
fn an_arm_that_refuses_keeps_the_box() {
    let mut perception = in_world(&["world.refuse_share=1"], 2);
    on_time(&mut perception, 1);
    assert_eq!(command(&mut perception, Action::Place, at(0, 0), 2), [Say::Motion(report(MotionOutcome::Refused))]);
    assert_eq!(boxes(&perception).belt_state(), Ok(BeltState::BoxPresent));
}

#[test]
fn boxes_are_commanded_as_they_were_measured() {
    let mut perception = in_world(&["world.size_mm=3", "world.seed=2"], 3);
    on_time(&mut perception, 1);
    let queue = boxes(&perception);
    assert_ne!(queue.current.size_mm, [100; 3]);
    command(&mut perception, Action::Place, at(0, 0), 2);
    assert_eq!(boxes(&perception).current, queue.upcoming[0], "measured once");
}

/// Noticed at the look after the box, before the next box is taken; reported; and gone on or stopped as configured.
#[test]
fn a_camera_that_fails_is_noticed_before_the_next_box() {
    for (fault, says) in [
        ("not-a-number", "sees only 0 %"),
        ("infinite", "sees only 0 %"),
        ("wrong-size", "pixels, not"),
        ("frozen", "frozen"),
        ("away", "says nothing"),
    ] {
        let fault = format!("world.camera_fault={fault}");
        let settings = [CAMERA, &fault, "world.camera_fault_from=2", "world.camera_fault_looks=3"];
        let mut stops = in_world(&settings, 4);
        let mut goes_on = in_world(&[&settings[..], &["belief.without_camera=go-on"]].concat(), 4);
        for (perception, belt) in [(&mut stops, BeltState::Waiting), (&mut goes_on, BeltState::BoxPresent)] {
            on_time(perception, 1);
            command(perception, Action::Place, at(0, 0), 2);
            assert_eq!(perception.tally().alarm(), "");
            command(perception, Action::Place, at(0, 10), 3);
            assert!(perception.tally().alarm().contains(says), "{}", perception.tally().alarm());
            assert_eq!(boxes(perception).belt_state(), Ok(belt), "{fault}");
        }
        // It looks again every time it would say an observation again; at the second time the camera is well.
        assert_eq!(stops.wake_ns(), Some(3 + 20 * MS));
        on_time(&mut stops, 3 + 20 * MS);
        assert_eq!(boxes(&stops).belt_state(), Ok(BeltState::Waiting));
        on_time(&mut stops, 3 + 40 * MS);
        assert_eq!(boxes(&stops).belt_state(), Ok(BeltState::BoxPresent));
        assert_eq!(stops.tally().alarm(), "", "{fault} is over");
    }
}

/// A stub in the world of these settings that begins anew with the world that was left.
fn resumed(settings: &[&str], world: &World) -> Result<Perception, WorldError> {
    let Perception { grid, belt, reality, .. } = in_world(settings, 4);
    Perception::resume(behaviour(), &grid, belt, world, 3).unwrap().in_reality(reality, Some(world))
}

#[test]
fn a_restarted_stub_finds_the_true_world_as_it_was_left() {
    let errors = ["world.actuator_mm=9", "world.yaw_deg=3", "world.size_mm=2", CAMERA, "world.kind=geometric"];
    let physics = [&errors[..4], &[PHYSICS]].concat();
    for settings in [&errors[..], &physics] {
        let mut perception = in_world(settings, 4);
        on_time(&mut perception, 1);
        command(&mut perception, Action::Place, at(0, 0), 2);
        let mut bytes = Vec::new();
        perception.world().encode(&mut bytes);
        let world = World::decode(&bytes).unwrap();
        let mut restarted = resumed(settings, &world).unwrap();
        assert_eq!(restarted.world(), world);
        on_time(&mut restarted, 3);
        let due_ns = boxes(&perception).due_ns;
        assert_eq!(BoxQueue { due_ns, ..boxes(&restarted) }, boxes(&perception));
        for perception in [&mut perception, &mut restarted] {
            let said = command(perception, Action::Place, at(1, 0), 4);
            assert!(said.len() > 1, "it was placed");
        }
        assert_eq!(restarted.world(), perception.world(), "the same errors, and the same rest");
    }
}

#[test]
fn a_world_of_another_kind_is_refused() {
    let left = |settings: &[&str]| {
        let mut perception = in_world(settings, 4);
        on_time(&mut perception, 1);
        command(&mut perception, Action::Place, at(0, 0), 2);
        perception.world()
    };
    for (was, is) in [(&[][..], &[CAMERA][..]), (&[CAMERA], &[PHYSICS]), (&[PHYSICS], &[CAMERA])] {
        let message = resumed(is, &left(was)).unwrap_err().to_string();
        assert!(message.contains("[world]"), "{message}");
    }
}

/// An arm that errs by 25 mm sets a box down on another. Of twenty such boxes one or another tips over its edge.
#[test]
fn boxes_tip_only_in_a_world_of_physics() {
    let top_mm = |seed: u64, kind: &str| {
        let mut perception = in_world(&["world.actuator_mm=25", &format!("world.seed={seed}"), kind], 4);
        on_time(&mut perception, 1);
        command(&mut perception, Action::Place, Placement { i: 5, ..at(0, 5) }, 2);
        command(&mut perception, Action::Place, Placement { i: 5, base: 10, ..at(0, 5) }, 3);
        let standing = match perception.world().matter.unwrap() {
            Matter::Standing(standing) => standing[0].clone(),
            Matter::Lying(lying) => lying[0].iter().map(physical::Lying::standing).collect(),
        };
        standing.last().map(|standing| standing.top_mm).unwrap()
    };
    let stands = |seed: &u64| top_mm(*seed, "world.kind=geometric") == 200.0;
    let on_top: Vec<u64> = (1..=20).filter(stands).collect();
    let tops_mm: Vec<f64> = on_top.iter().map(|&seed| top_mm(seed, PHYSICS)).collect();
    assert!(on_top.len() > 10 && tops_mm.iter().any(|mm| (mm - 200.0).abs() > 5.0), "{tops_mm:?}");
}

#[test]
fn a_new_pace_counts_from_the_next_box_on() {
    let hourly = Behaviour { pace_ns: 3_600_000 * MS, ..behaviour() };
    let mut perception = perception("[[1, 2, 3], [2, 2, 2], [3, 3, 3]]", hourly);
    assert_eq!(on_time(&mut perception, 0), [Say::Boxes(0)]);
    command(&mut perception, Action::Place, at(0, 0), MS);
    assert_eq!(perception.wake_ns(), Some(3_600_000 * MS));
    perception.set_behaviour(Behaviour { pace_ns: 50 * MS, ..behaviour() }, 2 * MS);
    assert_eq!(perception.wake_ns(), Some(52 * MS));
    assert_eq!(on_time(&mut perception, 52 * MS), [Say::Boxes(52 * MS)]);
    perception.set_behaviour(hourly, 53 * MS);
    command(&mut perception, Action::Place, at(1, 0), 54 * MS);
    assert_eq!(perception.wake_ns(), Some(102 * MS), "a slower one from the box after that on");
}

#[test]
fn a_belt_keeps_its_schedule_whoever_is_behind_it() {
    let behaviour = Behaviour { pace_ns: 10 * MS, ..behaviour() };
    let mut perception = perception_of(2, "[[1, 1, 1], [1, 1, 1]], [[1, 1, 1], [1, 1, 1]]", behaviour);
    assert_eq!(on_time(&mut perception, 0), [Say::Boxes(0)]);
    // Nobody decides for 35 ms: three boxes should have come meanwhile, the last two after other containers.
    command(&mut perception, Action::Place, at(0, 0), 35 * MS);
    assert_eq!(boxes(&perception).due_ns, 10 * MS);
    command(&mut perception, Action::Replace, at(1, 0), 36 * MS);
    assert_eq!(boxes(&perception).due_ns, 36 * MS, "what the arm did is not charged to the decision");
    command(&mut perception, Action::Place, at(0, 1), 37 * MS);
    assert_eq!(boxes(&perception).due_ns, 20 * MS, "an episode's end is no excuse either");
    command(&mut perception, Action::Place, at(0, 0), 38 * MS);
    assert_eq!((boxes(&perception).current.id, boxes(&perception).due_ns), (4, 30 * MS));
    command(&mut perception, Action::Place, at(0, 1), 39 * MS);
    assert_eq!(boxes(&perception).due_ns, 0, "nothing is due at an empty belt");
}
