//! `commander`: turns candidate sets and decisions into one command for every box.
//!
//! Reads `packcell/boxes`, `packcell/belief`, `packcell/candidates`, `packcell/decisions`, `packcell/motions` and
//! `packcell/control`; writes `packcell/commands`, `packcell/cycles`, `packcell/active` and the journal. One runs on a
//! bus; a second one is refused.

mod ears;
mod hands;

use clap::Parser;
use commander::{Commander, Deadlines};
use ears::Ears;
use hands::Hands;
use journal::{Found, Journal};
use messages::topics::{ACTIVE, Role};
use runtime::{Bus, ReloadSignal, Reporter, ServiceArgs, monotonic_ns};
use tracing::{info, warn};

/// How often the dead are cleaned up after, when no box waits [ns].
const CLEANING_NS: u64 = 1_000_000_000;

/// Commands the arm, once for every box.
#[derive(Parser)]
#[command(version)]
struct Args {
    #[command(flatten)]
    service: ServiceArgs,
}

fn main() -> anyhow::Result<()> {
    let args = Args::parse().service;
    let config = args.load()?;
    let bus = Bus::join(&config.bus, Role::Commander)?;
    let (journal, found) = Journal::open(&config.state.journal(), config.commander.journal_mib << 20)?;
    match found {
        Found::Nothing | Found::Whole => info!(?found, "journal"),
        Found::Cut(_) | Found::Damaged(_) => warn!(?found, "the journal was not whole; it goes on from what was"),
    }
    let state = *journal.state();
    let mut commander =
        Commander::new(Deadlines::of(&config.commander), config.close_policy()?, &state, monotonic_ns());

    let mut reload = ReloadSignal::catch(args, config)?;
    let mut hands = Hands::new(&bus, journal)?;
    let mut ears = Ears::new(&bus)?;
    let mut active = bus.publisher(&ACTIVE)?;
    let bell = bus.bell()?;
    let mut reporter = Reporter::new(&bus, "one command a box")?;
    commander.begin(&state, monotonic_ns(), &mut hands)?;
    info!(active = state.active, next_order = state.next_order(), "ready");

    let (mut is_active_said, mut cleaning_due_ns) = (false, 0);
    while bell.wait(commander.wake_ns())? {
        if let Some(config) = reload.take() {
            commander.set_rules(Deadlines::of(&config.commander), config.close_policy()?);
        }
        is_active_said &= !ears.listen(&mut commander, &mut hands)?;
        if !is_active_said {
            let (instance, request) = commander.active();
            active.publish(0, |said| (said.instance, said.request, said.reserved) = (instance, request, 0))?;
            is_active_said = true;
        }
        if commander.wake_ns().is_none() && monotonic_ns() >= cleaning_due_ns {
            bus.clean_up_after_the_dead();
            hands.tidy();
            cleaning_due_ns = monotonic_ns() + CLEANING_NS;
        }
        hands.greet_newcomers()?;
        active.greet_newcomers()?;
        reporter.report_if_due(commander.tally())?;
    }
    info!("stopped");
    Ok(())
}
