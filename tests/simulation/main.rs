//! The protocol in a deterministic simulation: the services' state machines, no process, no clock.
//!
//! A schedule is one number. It decides the boxes, who runs when, who dies between which two deeds, who is frozen,
//! when the disk is full, when the power is cut, who says rubbish and when scorers are swapped. After every deed the
//! [`ledger`] says whether a rule is broken: a box is moved once, an order is one order, nothing is decided on a stale
//! belief, every box comes to its end, whoever is obeyed stays obeyed, and nobody waits longer than the deadlines say.
//!
//! `PACKCELL_SEED=N cargo test --release --workspace --test simulation` replays schedule `N`.

mod bus;
mod cell;
mod ledger;

use std::hash::{BuildHasher as _, RandomState};
use std::time::Duration;

use cell::{Bug, Cell, Memory};
use ledger::Violation;

/// Schedules that a test run tries.
const SCHEDULES: u64 = 50_000;

/// Schedules in which a planted bug must show.
const SCHEDULES_WITH_BUG_MAX: u64 = 20_000;

fn run(seed: u64, bug: Bug, memory: &Memory) -> Result<(), Violation> {
    Cell::new(seed, bug, memory).run()
}

#[test]
#[expect(clippy::disallowed_methods, reason = "a failing seed is named by the person who replays it")]
fn nothing_that_happens_breaks_a_rule() {
    let memory = Memory::new();
    let replayed = std::env::var("PACKCELL_SEED").ok().map(|seed| seed.parse::<u64>().unwrap());
    let first = replayed.unwrap_or_else(|| RandomState::new().hash_one("packcell") >> 32);
    let count = if replayed.is_some() { 1 } else { SCHEDULES };
    println!("schedules {first} to {}", first + count - 1);
    let started = std::time::Instant::now();
    for seed in first..first + count {
        if let Err(violation) = run(seed, Bug::None, &memory) {
            panic!("schedule {seed}: {violation}; replay it with PACKCELL_SEED={seed}");
        }
    }
    let elapsed = started.elapsed().max(Duration::from_millis(1));
    println!("{:.0} schedules a minute", count as f64 * 60.0 / elapsed.as_secs_f64());
}

#[test]
fn planted_bugs_are_found() {
    let memory = Memory::new();
    for bug in [Bug::JournalAfterCommand, Bug::ArmIgnoresRevision, Bug::SaysBeforeKeeping] {
        let found = (0..SCHEDULES_WITH_BUG_MAX).find_map(|seed| run(seed, bug, &memory).err().map(|why| (seed, why)));
        let (seed, violation) = found.unwrap_or_else(|| panic!("{bug:?} was not found"));
        println!("{bug:?} was found in schedule {seed}: {violation}");
    }
}

#[test]
fn a_schedule_replays_exactly() {
    let memory = Memory::new();
    for seed in 0..50 {
        let trace = || {
            let mut cell = Cell::new(seed, Bug::None, &memory);
            cell.run().unwrap();
            cell.trace()
        };
        assert_eq!(trace(), trace(), "schedule {seed}");
    }
}
