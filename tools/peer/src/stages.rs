//! The services' main loops, on sockets.

use std::convert::Infallible;
use std::path::Path;
use std::thread;
use std::time::Duration;

use anyhow::Context as _;
use candidates::Candidates;
use commander::{Commander, Deadlines, Effects, Order};
use journal::{AppendError, Entry, Journal, Record, State};
use messages::{Belief, BoxQueue, CandidateSet, CycleReport, Decision, Instance, MotionReport, PlaceCommand};
use peer::{Inbox, Outbox, Sent as _, path_of};
use policy::{Engine, Policy, PolicyKind};
use runtime::{Config, monotonic_ns, unix_ms};
use scorer::Scorer;

const NS_PER_MS: u64 = 1_000_000;

/// More than any benchmark writes down.
const JOURNAL_BYTES: u64 = 64 << 20;

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
                if let Some(verdict) = service.decide(&set, &belief, received_ns, &mut is_over) {
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
    let (mut queue, mut motion) = (zeroed::<BoxQueue>(), zeroed::<MotionReport>());
    let mut inbox = Inbox::bind(dir, "commander")?;
    let mut hands = Hands::new(dir, "commander")?;
    let mut arm = outbox(dir, ARM)?;
    loop {
        match inbox.receive()? {
            Belief::KIND => {
                inbox.read(&mut *belief)?;
                service.on_belief(&belief);
            }
            BoxQueue::KIND => {
                inbox.read(&mut *queue)?;
                service.on_boxes(&queue, monotonic_ns(), &mut hands)?;
            }
            CandidateSet::KIND => {
                inbox.read(&mut *set)?;
                service.on_candidates(&set, monotonic_ns(), &mut hands)?;
            }
            Decision::KIND => {
                inbox.read(&mut *decision)?;
                service.on_decision(&decision, monotonic_ns(), &mut hands)?;
            }
            MotionReport::KIND => {
                inbox.read(&mut *motion)?;
                service.on_motion(&motion, &mut hands)?;
            }
            _ => {}
        }
        if hands.has_command() {
            arm.send(&*hands.command)?;
        }
    }
}

/// All of it in one process: the time of each stage goes along with the command.
pub(crate) fn alone(config: &Config, dir: &Path) -> anyhow::Result<()> {
    let mut candidates = Candidates::new(config.walle_weights()?);
    let (mut scorer, mut commander) = (new_scorer(config)?, new_commander(config)?);
    let (mut belief, mut queue) = (zeroed::<Belief>(), zeroed::<BoxQueue>());
    let (mut set, mut decision) = (zeroed::<CandidateSet>(), zeroed::<Decision>());
    let mut motion = zeroed::<MotionReport>();
    let mut inbox = Inbox::bind(dir, "alone")?;
    let mut hands = Hands::new(dir, "alone")?;
    let mut arm = outbox(dir, ARM)?;
    let think_ns = config.scorer.think_us * 1000;
    loop {
        match inbox.receive()? {
            Belief::KIND => inbox.read(&mut *belief)?,
            BoxQueue::KIND => {
                inbox.read(&mut *queue)?;
                let begin_ns = monotonic_ns();
                queue.header.observed_ns = begin_ns;
                if let Some(found) = candidates.find(&queue, &belief) {
                    found.write(&mut set, begin_ns);
                    set.header.observed_ns = begin_ns;
                }
                let found_ns = monotonic_ns();
                let mut is_over = || monotonic_ns() >= found_ns + think_ns;
                if let Some(verdict) = scorer.decide(&set, &belief, found_ns, &mut is_over) {
                    verdict.write(&mut decision, found_ns);
                }
                let decided_ns = monotonic_ns();
                commander.on_belief(&belief);
                commander.on_boxes(&queue, decided_ns, &mut hands)?;
                commander.on_candidates(&set, decided_ns, &mut hands)?;
                commander.on_decision(&decision, decided_ns, &mut hands)?;
                if hands.has_command() {
                    let stages_ns = [found_ns - begin_ns, decided_ns - found_ns, monotonic_ns() - decided_ns];
                    arm.send_timed(&*hands.command, stages_ns)?;
                }
            }
            MotionReport::KIND => {
                inbox.read(&mut *motion)?;
                commander.on_motion(&motion, &mut hands)?;
            }
            _ => {}
        }
    }
}

/// A commander's effects: its own journal, and a command that is sent afterwards.
struct Hands {
    journal: Journal,
    command: Box<PlaceCommand>,
    is_new: bool,
}

impl Hands {
    fn new(dir: &Path, name: &str) -> anyhow::Result<Self> {
        let (journal, _) = Journal::open(&dir.join(format!("{name}.journal")), JOURNAL_BYTES)?;
        Ok(Self { journal, command: zeroed(), is_new: false })
    }

    /// Whether there is a command that was not asked for yet.
    fn has_command(&mut self) -> bool {
        std::mem::take(&mut self.is_new)
    }
}

impl Effects for Hands {
    type Error = Infallible;

    fn append(&mut self, record: &Record) -> Result<(), AppendError> {
        self.journal.append(&Entry { unix_ms: unix_ms(), record: *record })
    }

    fn command(&mut self, order: &Order) -> Result<u64, Infallible> {
        order.write(&mut self.command);
        self.is_new = true;
        Ok(monotonic_ns())
    }

    fn report(&mut self, _: &CycleReport) -> Result<(), Infallible> {
        Ok(())
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
    let policy = Policy::new(kind, engine, kind.built_in_model()?.as_ref())?;
    let mut scorer = Scorer::new(policy, Instance::default());
    scorer.warm_up(config.container_size()?, config.container.slots);
    Ok(scorer)
}

fn new_commander(config: &Config) -> anyhow::Result<Commander> {
    let deadlines = Deadlines {
        soft_ns: config.commander.soft_deadline_ms * NS_PER_MS,
        hard_ns: config.commander.hard_deadline_ms * NS_PER_MS,
    };
    Ok(Commander::new(deadlines, config.close_policy()?, &State::default(), monotonic_ns()))
}
