//! Processes that die and freeze at random moments, and an operator who swaps scorers: no box is lost or moved twice.
//!
//! The schedule is drawn from a seed that is printed first. What is asserted is read from the journal and from the
//! cycle reports, never from what the services say of themselves.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::hash::{BuildHasher as _, RandomState};
use std::path::Path;
use std::process::{Command, Output};
use std::thread;
use std::time::Duration;

use dataset::Named;
use journal::{Intent, Record, Rest};
use messages::topics::{BOXES, CYCLES, Role};
use messages::{Action, BeltState, CycleReport, MotionOutcome};
use packing::{Draw, Split};
use runtime::{Bus, BusConfig};
use rustix::process::Signal;

use crate::harness::{UpCell, children_of, program, signal, wait_until};

const SEED_OF_STREAM: u64 = 5;

/// Boxes of the one episode that the cells below pack.
fn boxes() -> u64 {
    Named::find("standard").unwrap().generate(Split::Live, SEED_OF_STREAM, 1).unwrap().episodes[0].len() as u64
}

/// A cell that packs so many episodes at this pace and then has an empty belt; 0 for an endless stream.
fn cell(name: &str, pace_ms: &str, episodes: u64) -> UpCell {
    let episodes = format!("perception.episodes={episodes}");
    UpCell::start(name, &["--pace", pace_ms, "--seed", "5", "--policy", "walle", "--set", &episodes])
}

/// Reads what the cell reports. A report that a commander published just before it was killed may be lost with it; the
/// journal has it.
struct Observer {
    cycles: runtime::Subscriber<CycleReport>,
    queues: runtime::Latest<messages::BoxQueue>,
    /// By order.
    reports: BTreeMap<u64, CycleReport>,
}

impl Observer {
    fn new(config: BusConfig) -> Self {
        let bus = Bus::join(&config, Role::Tool).unwrap();
        let (cycles, queues) = (bus.subscriber(&CYCLES).unwrap(), bus.latest(&BOXES).unwrap());
        Self { cycles, queues, reports: BTreeMap::new() }
    }

    fn look(&mut self) {
        while let Some(report) = self.cycles.receive().unwrap() {
            self.reports.insert(report.order, *report);
        }
    }

    fn belt_is_empty(&mut self) -> bool {
        self.queues.refresh().unwrap();
        self.queues.get().is_some_and(|queue| queue.belt_state() == Ok(BeltState::Ended))
    }

    /// What was reported agrees with what was written down.
    #[track_caller]
    fn assert_agrees_with(&self, journal: &Path) {
        let contents = journal::read(journal).unwrap();
        let intents = contents.entries.iter().filter_map(|entry| match entry.record {
            Record::Intent(intent) => Some((intent.order, intent)),
            Record::Outcome(_) | Record::Active(_) | Record::Carried(_) => None,
        });
        let intents: BTreeMap<u64, Intent> = intents.collect();
        assert!(!self.reports.is_empty());
        for (order, report) in &self.reports {
            let intent = &intents[order];
            assert_eq!(
                (report.spec, report.revision, report.placement),
                (intent.spec, intent.revision, intent.placement)
            );
        }
    }
}

/// Every box up to some last one is in the journal as moved by one order, and no order began before another was over.
/// How many boxes that were.
#[track_caller]
fn assert_exactly_once(journal: &Path) -> u64 {
    let contents = journal::read(journal).unwrap();
    assert_eq!(contents.rest, Rest::Nothing);
    let mut moved: BTreeMap<u64, Vec<u64>> = BTreeMap::new();
    let mut open = None;
    for entry in &contents.entries {
        match entry.record {
            Record::Intent(intent) => assert!(open.replace(intent).is_none(), "order {} began too early", intent.order),
            Record::Outcome(outcome) => {
                let intent = open.take().expect("an outcome has its intent");
                assert_eq!(intent.order, outcome.order);
                if outcome.outcome != MotionOutcome::Refused && intent.action != Action::Replace {
                    moved.entry(intent.spec.id).or_default().push(intent.order);
                }
            }
            Record::Active(_) | Record::Carried(_) => {}
        }
    }
    let doubled: Vec<_> = moved.iter().filter(|(_, orders)| orders.len() > 1).collect();
    assert!(doubled.is_empty(), "moved more than once: {doubled:?}");
    let count = moved.len() as u64;
    assert_eq!(moved.keys().copied().collect::<Vec<_>>(), (1..=count).collect::<Vec<_>>());
    count
}

/// The services of a cell that run, by name.
fn services(cell: &UpCell) -> Vec<(String, u32)> {
    let name = |pid: u32| fs::read_to_string(format!("/proc/{pid}/comm")).ok().map(|name| name.trim().to_owned());
    children_of(cell.child.id()).into_iter().filter_map(|pid| Some((name(pid)?, pid))).collect()
}

fn packcell(command: &str, cell: &UpCell, args: &[&str]) -> Output {
    Command::new(program("packcell")).arg(command).args(cell.bus_args()).args(args).output().unwrap()
}

#[test]
fn an_episode_survives_whatever_dies_and_freezes() {
    let seed = RandomState::new().hash_one("faults");
    println!("seed {seed}");
    let mut draw = Draw::new(601, seed, 0);
    let mut cell = cell("faults", "20", 1);
    cell.await_status();
    let mut observer = Observer::new(cell.bus_config());
    let mut faults = 0;
    let mut is_over = false;
    while !is_over {
        observer.look();
        let packed = journal::read(&cell.journal()).unwrap().state().next_order() - 1;
        is_over = observer.belt_is_empty() && packed >= boxes();
        if cell.child.try_wait().unwrap().is_some() {
            panic!("the supervisor gave up: {}", cell.stop_with(Signal::TERM).1);
        }
        if packed + 40 < boxes() {
            let services = services(&cell);
            let drawn = draw.below(4) as usize;
            let Some((_, pid)) = services.get(drawn) else { continue };
            let how = if draw.below(4) == 0 { Signal::STOP } else { Signal::KILL };
            signal(*pid, how);
            faults += 1;
            if how == Signal::STOP {
                thread::sleep(Duration::from_millis(draw.below(60)));
                signal(*pid, Signal::CONT);
            }
        }
        thread::sleep(Duration::from_millis(100 + draw.below(200)));
    }
    assert!(faults > 0);
    wait_until("the last order is over", || {
        journal::read(&cell.journal()).unwrap().state().open().is_none().then_some(())
    });
    observer.look();
    observer.assert_agrees_with(&cell.journal());
    drop(observer);
    assert_eq!(cell.stop_with(Signal::TERM).0, Some(0));
    assert_eq!(assert_exactly_once(&cell.journal()), boxes());
    assert_eq!(cell.leftovers(), [] as [String; 0]);
}

#[test]
fn scorers_are_swapped_while_boxes_keep_coming() {
    let mut cell = cell("swap", "10", 0);
    cell.await_status();
    let mut observer = Observer::new(cell.bus_config());
    let output = packcell("swap", &cell, &["--policy", "packman", "--sets", "20", "--p99-max-ms", "5000", "--dry-run"]);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success() && said.contains("nothing was changed"), "{said}");
    // A model that is none, one that disagrees, and one that is too slow, are not promoted.
    let rubbish = cell.state_dir().join("rubbish.safetensors");
    fs::write(&rubbish, b"no model").unwrap();
    let refused = [
        (vec!["--model", rubbish.to_str().unwrap(), "--policy", "packman"], "the new scorer cannot be used"),
        (vec!["--policy", "packman", "--sets", "20", "--agree-min", "1"], "it agrees on"),
        (vec!["--policy", "packman", "--sets", "20", "--p99-max-ms", "0"], "it is too slow"),
        (vec!["--back"], "nothing to go back to"),
    ];
    for (args, says) in &refused {
        let output = packcell("swap", &cell, args);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && said.contains(says), "{args:?}: {said}");
    }
    // However slow the machine is: what is tried here is the swap.
    let output = packcell("swap", &cell, &["--policy", "packman", "--sets", "20", "--p99-max-ms", "5000"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let status = cell.await_status();
    assert!(status.contains("the active scorer: b") && !status.contains("scorer a"), "{status}");
    // Whom the commander obeys outlives the commander.
    let commander = services(&cell).into_iter().find(|(name, _)| name == "commander").unwrap().1;
    signal(commander, Signal::KILL);
    wait_until("the commander is back and obeys b", || {
        cell.await_status().contains("the active scorer: b").then_some(())
    });
    let output = packcell("swap", &cell, &["--back", "--sets", "10", "--p99-max-ms", "5000"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    observer.look();
    let models: BTreeSet<u64> = observer.reports.values().map(|report| report.model).collect();
    assert!(models.len() >= 2, "both policies decided boxes");
    drop(observer);
    assert_eq!(cell.stop_with(Signal::TERM).0, Some(0));
    assert!(assert_exactly_once(&cell.journal()) > 100);
}

#[test]
fn a_cell_goes_on_where_it_stopped_and_the_journal_can_be_read() {
    let mut first = cell("again", "5", 1);
    first.await_status();
    wait_until("some boxes are packed", || {
        let contents = journal::read(&first.journal()).ok()?;
        (contents.state().next_order() > 30).then_some(())
    });
    // Killed, not stopped: whoever supervised is dead, and so are the services.
    first.child.kill().unwrap();
    first.child.wait().unwrap();
    let mut second = first.restart(&["--pace", "5", "--seed", "5", "--set", "perception.episodes=1"]);
    second.await_status();
    let mut observer = Observer::new(second.bus_config());
    wait_until("the second run packs the rest", || {
        observer.look();
        let contents = journal::read(&second.journal()).ok()?;
        (contents.state().next_order() > boxes() && contents.state().open().is_none()).then_some(())
    });
    let listed = packcell("journal", &second, &["--last", "5"]);
    let text = String::from_utf8_lossy(&listed.stdout).into_owned();
    assert!(listed.status.success() && text.contains("next order") && text.contains("done"), "{text}");
    drop(observer);
    assert_eq!(second.stop_with(Signal::TERM).0, Some(0));
    assert_eq!(assert_exactly_once(&second.journal()), boxes());
}
