//! The services' main loops, on sockets.

use std::path::Path;
use std::thread;
use std::time::Duration;

use anyhow::Context as _;
use candidates::Candidates;
use commander::{Commander, Deadlines};
use messages::{Belief, BoxQueue, CandidateSet, Decision, Message as _, PlaceCommand};
use peer::{Inbox, Outbox, Sent as _, path_of};
use policy::{Engine, Policy, PolicyKind};
use runtime::{Config, monotonic_ns};
use scorer::Scorer;

const NS_PER_MS: u64 = 1_000_000;

/// Pause between two looks for a process that starts.
const PAUSE: Duration = Duration::from_millis(2);

/// The name of whoever sends boxes and gets commands.
const ARM: &str = "arm";

/// Box to candidate set.
pub(crate) fn candidates(config: &Config, dir: &Path) -> anyhow::Result<()> {
    let mut service = Candidates::new(config.walle_weights()?);
    let (mut belief, mut queue) = (zeroed::<Belief>(), zeroed::<BoxQueue>());
    let mut set = zeroed::<CandidateSet>();
    let mut inbox = Inbox::bind(dir, "candidates")?;
    let (mut commander, mut scorer) = (outbox(dir, "commander")?, outbox(dir, "scorer")?);
    loop {
        match inbox.receive()? {
            Belief::KIND => inbox.read(&mut *belief)?,
            BoxQueue::KIND => {
                inbox.read(&mut *queue)?;
                let received_ns = monotonic_ns();
                if let Some(found) = service.find(&queue, &belief) {
                    found.write(&mut set, received_ns);
                    set.header.observed_ns = found.observed_ns();
                    commander.send(&*set)?;
                    scorer.send(&*set)?;
                }
            }
            _ => {}
        }
    }
}

/// Candidate set to decision.
pub(crate) fn scorer(config: &Config, dir: &Path) -> anyhow::Result<()> {
    let mut service = new_scorer(config)?;
    let (mut belief, mut set, mut decision) = (zeroed::<Belief>(), zeroed::<CandidateSet>(), zeroed::<Decision>());
    let mut inbox = Inbox::bind(dir, "scorer")?;
    let mut commander = outbox(dir, "commander")?;
    let think_ns = config.scorer.think_us * 1000;
    loop {
        match inbox.receive()? {
            Belief::KIND => inbox.read(&mut *belief)?,
            CandidateSet::KIND => {
                inbox.read(&mut *set)?;
                let received_ns = monotonic_ns();
                let mut is_over = || monotonic_ns() >= received_ns + think_ns;
                if let Some(verdict) = service.decide(&set, &belief, &mut is_over) {
                    verdict.write(&mut decision, received_ns);
                    commander.send(&*decision)?;
                }
            }
            _ => {}
        }
    }
}

/// Candidate set and decision to command.
pub(crate) fn commander(config: &Config, dir: &Path) -> anyhow::Result<()> {
    let mut service = new_commander(config)?;
    let (mut belief, mut set, mut decision) = (zeroed::<Belief>(), zeroed::<CandidateSet>(), zeroed::<Decision>());
    let mut command = zeroed::<PlaceCommand>();
    let mut inbox = Inbox::bind(dir, "commander")?;
    let mut arm = outbox(dir, ARM)?;
    loop {
        let order = match inbox.receive()? {
            Belief::KIND => {
                inbox.read(&mut *belief)?;
                service.on_belief(&belief);
                None
            }
            CandidateSet::KIND => {
                inbox.read(&mut *set)?;
                service.on_candidates(&set, monotonic_ns())
            }
            Decision::KIND => {
                inbox.read(&mut *decision)?;
                service.on_decision(&decision, monotonic_ns())
            }
            _ => None,
        };
        if let Some(order) = order {
            order.write(&mut command);
            arm.send(&*command)?;
        }
    }
}

/// All of it in one process: the time of each stage goes along with the command.
pub(crate) fn alone(config: &Config, dir: &Path) -> anyhow::Result<()> {
    let mut candidates = Candidates::new(config.walle_weights()?);
    let (mut scorer, mut commander) = (new_scorer(config)?, new_commander(config)?);
    let (mut belief, mut queue) = (zeroed::<Belief>(), zeroed::<BoxQueue>());
    let (mut set, mut decision) = (zeroed::<CandidateSet>(), zeroed::<Decision>());
    let mut command = zeroed::<PlaceCommand>();
    let mut inbox = Inbox::bind(dir, "alone")?;
    let mut arm = outbox(dir, ARM)?;
    let think_ns = config.scorer.think_us * 1000;
    loop {
        match inbox.receive()? {
            Belief::KIND => inbox.read(&mut *belief)?,
            BoxQueue::KIND => {
                inbox.read(&mut *queue)?;
                let begin_ns = monotonic_ns();
                if let Some(found) = candidates.find(&queue, &belief) {
                    found.write(&mut set, begin_ns);
                    set.header_mut().observed_ns = begin_ns;
                }
                let found_ns = monotonic_ns();
                if let Some(verdict) = scorer.decide(&set, &belief, &mut || monotonic_ns() >= found_ns + think_ns) {
                    verdict.write(&mut decision, found_ns);
                }
                let decided_ns = monotonic_ns();
                commander.on_belief(&belief);
                let order = commander.on_candidates(&set, decided_ns);
                if let Some(order) = order.or_else(|| commander.on_decision(&decision, decided_ns)) {
                    order.write(&mut command);
                    let stages_ns = [found_ns - begin_ns, decided_ns - found_ns, monotonic_ns() - decided_ns];
                    arm.send_timed(&*command, stages_ns)?;
                }
            }
            _ => {}
        }
    }
}

fn zeroed<M: bytemuck::Zeroable>() -> Box<M> {
    Box::new(M::zeroed())
}

/// The way to a process that may still be starting.
fn outbox(dir: &Path, name: &str) -> anyhow::Result<Outbox> {
    while !path_of(dir, name).exists() {
        thread::sleep(PAUSE);
    }
    Ok(Outbox::to(dir, name)?)
}

fn new_scorer(config: &Config) -> anyhow::Result<Scorer> {
    let kind: PolicyKind = config.scorer.policy.parse().context("scorer.policy")?;
    let engine: Engine = config.scorer.engine.parse().context("scorer.engine")?;
    let mut scorer = Scorer::new(Policy::new(kind, engine, kind.built_in_model()?.as_ref())?, 0);
    scorer.warm_up(config.container_size()?, config.container.slots);
    Ok(scorer)
}

fn new_commander(config: &Config) -> anyhow::Result<Commander> {
    let deadlines = Deadlines {
        soft_ns: config.commander.soft_deadline_ms * NS_PER_MS,
        hard_ns: config.commander.hard_deadline_ms * NS_PER_MS,
    };
    Ok(Commander::new(deadlines, config.close_policy()?, 0))
}
