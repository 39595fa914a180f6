//! A stream of boxes through four processes.

use packing::{ClosePolicy, Environment, Heuristic, Recipe, Split, WalleWeights};

use crate::harness::Demo;

#[test]
fn an_episode_is_packed_and_every_box_placed_exactly_once() {
    let demo = Demo::run(&["--seed", "3"]);
    let boxes = demo.number("/boxes");
    assert!(boxes >= 230.0);
    assert_eq!((demo.number("/placed"), demo.number("/set_aside")), (boxes, 0.0));
    assert_eq!((demo.number("/doubled"), demo.number("/lost_reports")), (0.0, 0.0));
    let chosen = ["model", "standby", "fallback"].map(|by| demo.number(&format!("/chosen_by/{by}")));
    assert_eq!(chosen.iter().sum::<f64>(), boxes);
    assert!(chosen[0] > 0.0, "the network chose nothing");
    assert_eq!(demo.number("/latency_us/end_to_end/count"), boxes);
    assert!(demo.number("/competitive_ratio") >= 1.0);
    demo.assert_nothing_is_left();
}

/// WallE's choice lies in the candidate set, so it is the same whether the scorer or the fallback made it.
#[test]
fn four_processes_pack_exactly_as_one_would() {
    let demo = Demo::run(&["--seed", "4", "--policy", "walle"]);
    let episode = Recipe::standard().episode(Split::Live, 4, 0).unwrap();
    let mut environment = Environment::new(episode.container, 16, ClosePolicy::Fullest).unwrap();
    let walle = Heuristic::WalleCorners(WalleWeights::PAPER);
    for spec in &episode.boxes {
        environment.pack(spec, |grid, extent| walle.choose(grid, extent)).unwrap();
    }
    let outcome = environment.outcome(episode.optimum);
    assert_eq!(demo.number("/placed"), outcome.placed as f64);
    assert_eq!(demo.number("/containers_used"), f64::from(outcome.containers_used));
    assert_eq!(demo.number("/fill"), outcome.fill.unwrap());
    assert_eq!(demo.number("/competitive_ratio"), outcome.competitive_ratio.unwrap());
}

/// An arm with errors of 5 mm, a camera with errors of 1 mm, and 1 cm around every box.
#[test]
fn an_arm_that_errs_loses_no_box_and_hits_none() {
    let clearance = ["--seed", "7", "--policy", "walle", "--set", "rules.clearance_mm=10"];
    let errors = ["world.actuator_mm=5", "world.camera_shift_mm=1", "belief.source=camera"];
    let errors: Vec<&str> = errors.iter().flat_map(|setting| ["--set", setting]).collect();
    let perfect = Demo::run(&clearance);
    let demo = Demo::run(&[&clearance[..], &errors].concat());
    assert_eq!(demo.number("/placed"), demo.number("/boxes"));
    assert_eq!((demo.number("/set_aside"), demo.number("/doubled")), (0.0, 0.0));
    assert!(!demo.stderr().contains("collided"), "{}", demo.stderr());
    // One episode's c moves in steps of a tenth.
    assert!(demo.number("/competitive_ratio") <= perfect.number("/competitive_ratio") + 0.11);
    demo.assert_nothing_is_left();
}

/// What falls, slides and tilts is seen, and the line goes on.
#[test]
fn a_cell_packs_in_a_world_of_physics() {
    let settings = ["rules.clearance_mm=5", "world.actuator_mm=5", "belief.source=camera"];
    let settings: Vec<&str> = settings.iter().flat_map(|setting| ["--set", setting]).collect();
    let world = ["--world", "physics", "--data", "three", "--policy", "walle"];
    let demo = Demo::run(&[&world[..], &settings].concat());
    assert_eq!(demo.number("/placed") + demo.number("/set_aside"), demo.number("/boxes"));
    assert!(demo.number("/placed") > 0.9 * demo.number("/boxes"));
    assert_eq!(demo.number("/doubled"), 0.0);
    demo.assert_nothing_is_left();
}

/// Nothing is placed on a belief that is known to be wrong, and whoever waits is told why.
#[test]
fn a_cell_that_lost_its_camera_stands_still_and_says_so() {
    let demo = Demo::run(&["--policy", "walle", "--set", "belief.source=camera", "--set", "world.camera_fault=away"]);
    assert!(!demo.output.status.success());
    let said = demo.stderr();
    assert!(said.contains("stands still after 1 of") && said.contains("perception: the camera says nothing"), "{said}");
    demo.assert_nothing_is_left();
}

#[test]
fn two_cells_side_by_side_do_not_meet() {
    let demos = [Demo::begin(&["--seed", "5"]), Demo::begin(&["--seed", "6"])].map(crate::harness::RunningDemo::finish);
    for demo in &demos {
        assert_eq!(demo.number("/placed"), demo.number("/boxes"));
        assert_eq!(demo.number("/doubled"), 0.0);
        demo.assert_nothing_is_left();
    }
    assert_ne!(demos[0].number("/boxes"), demos[1].number("/boxes"), "two seeds, two streams");
}

#[test]
fn with_few_slots_containers_leave_and_every_box_is_placed() {
    let demo = Demo::run(&["--open", "2", "--policy", "walle"]);
    assert_eq!(demo.number("/placed"), demo.number("/boxes"));
    assert!(demo.number("/containers_replaced") >= 10.0);
    assert_eq!(demo.number("/containers_used"), demo.number("/containers_replaced") + 2.0);
}

#[test]
fn boxes_that_fit_nowhere_are_set_aside_and_the_line_goes_on() {
    let demo = Demo::run(&["--open", "2", "--policy", "walle", "--set", "commander.close_policy=never"]);
    assert_eq!(demo.number("/placed") + demo.number("/set_aside"), demo.number("/boxes"));
    assert!(demo.number("/set_aside") > 0.0 && demo.number("/placed") > 20.0);
    assert_eq!(demo.number("/containers_used"), 2.0);
}

#[test]
fn a_users_own_stream_is_packed_episode_by_episode() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("mine.json");
    let text = r#"{"meta": {"name": "mine", "unit": "cm", "container": [20, 20, 20], "optimum": 1},
        "episodes": [[[20, 20, 10], [20, 20, 10]], [[10, 20, 20], [10, 20, 20], [20, 20, 20]]]}"#;
    std::fs::write(&file, text).unwrap();
    let page = dir.path().join("page.html");
    let demo = Demo::run(&["--data", file.to_str().unwrap(), "--html", page.to_str().unwrap(), "--pace", "5"]);
    assert_eq!((demo.number("/placed"), demo.number("/containers_used")), (5.0, 3.0));
    assert_eq!((demo.number("/fill"), demo.number("/competitive_ratio")), (1.0, 1.5));
    let page = std::fs::read_to_string(page).unwrap();
    assert_eq!(page.matches("<svg").count(), 3, "a picture of every container");
    assert!(!page.contains("http://") || page.contains("http://www.w3.org"), "the page needs no network");
}
