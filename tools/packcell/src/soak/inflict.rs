//! Doing to a cell what the schedule says, and undoing it.

use std::io::Read as _;
use std::os::unix::process::CommandExt as _;
use std::process::{Child, Command, Stdio};
use std::thread;

use anyhow::{Context as _, bail};
use bytemuck::bytes_of_mut;
use messages::topics::{CANDIDATES, DECISIONS, Role};
use messages::{CandidateSet, Decision, Instance};
use packing::Draw;
use runtime::{Bus, Config, Latest, Publisher, monotonic_ns};
use rustix::process::{Pid, Resource, Rlimit, Signal, kill_process, prlimit};

use super::faults::{Fault, Kind, Target};
use super::processes::Processes;
use crate::args::CELL_FILE;

/// Purpose of the draws that rubbish is made of.
const PURPOSE: u64 = 612;

/// A slowed process is frozen so long, and runs half as long, in turns [ns].
const SLOW_NS: u64 = 8_000_000;

/// Sets that a scorer must have answered before it is made the active one by a swap.
const SWAP_SETS: &str = "20";

/// The hand that harms. Dropping it undoes whatever is under way.
#[derive(Debug)]
pub(crate) struct Hand<'a> {
    bus: &'a Bus,
    config: &'a Config,
    draw: Draw,
    under_way: Vec<UnderWay>,
}

/// A fault that lasts.
#[derive(Debug)]
struct UnderWay {
    number: u64,
    until_ns: u64,
    doing: Doing,
}

#[derive(Debug)]
enum Doing {
    Frozen { pid: Pid },
    Slowed { pid: Pid, turn_ns: u64, is_frozen: bool },
    Limited { pid: Pid, before: Rlimit },
    Answering { sets: Latest<CandidateSet>, decisions: Publisher<Decision>, instance: Instance },
    Babbling { sets: Publisher<CandidateSet> },
    Hogging,
    Swapping { child: Child },
}

impl<'a> Hand<'a> {
    pub(crate) fn new(bus: &'a Bus, config: &'a Config, seed: u64) -> Self {
        Self { bus, config, draw: Draw::new(PURPOSE, seed, 0), under_way: Vec::new() }
    }

    /// The process that a fault would hit, by name; the target itself if it is none.
    pub(crate) fn target_name(fault: &Fault, processes: &Processes, active: Instance) -> String {
        match fault.target {
            Target::Process(role) => {
                find(processes, role, active).map_or_else(|| role.name().to_owned(), |(name, _)| name)
            }
            target @ (Target::Decisions | Target::Candidates | Target::Machine) => target.name().to_owned(),
        }
    }

    /// Begins a fault; whether it lasts.
    ///
    /// # Errors
    /// Why it cannot be done now.
    pub(crate) fn begin(
        &mut self,
        number: u64,
        fault: &Fault,
        processes: &Processes,
        active: Instance,
    ) -> anyhow::Result<bool> {
        let now = monotonic_ns();
        let until_ns = now + fault.for_ms * 1_000_000;
        let pid = || match fault.target {
            Target::Process(role) => {
                let (_, pid) = find(processes, role, active).with_context(|| format!("no {} runs", role.name()))?;
                Pid::from_raw(pid.cast_signed()).context("no process")
            }
            Target::Decisions | Target::Candidates | Target::Machine => bail!("no process"),
        };
        let doing = match fault.kind {
            Kind::Kill => {
                kill_process(pid()?, Signal::KILL).context("cannot be killed")?;
                return Ok(false);
            }
            Kind::Freeze => {
                kill_process(pid()?, Signal::STOP).context("cannot be frozen")?;
                Doing::Frozen { pid: pid()? }
            }
            Kind::Slow => Doing::Slowed { pid: pid()?, turn_ns: now, is_frozen: false },
            Kind::FullDisk => {
                // As a full disk does, this refuses every byte by which a file would grow.
                let (pid, full) = (pid()?, Rlimit { current: Some(1), maximum: None });
                Doing::Limited { pid, before: prlimit(Some(pid), Resource::Fsize, full).context("cannot be limited")? }
            }
            Kind::Hog => {
                let threads = thread::available_parallelism().map_or(1, usize::from);
                for _ in 0..threads {
                    thread::spawn(move || while monotonic_ns() < until_ns {});
                }
                Doing::Hogging
            }
            Kind::Rubbish if fault.target == Target::Decisions => Doing::Answering {
                sets: self.bus.latest(&CANDIDATES)?,
                decisions: self.bus.publisher(&DECISIONS)?,
                instance: active,
            },
            Kind::Rubbish => Doing::Babbling { sets: self.bus.publisher(&CANDIDATES)? },
            Kind::Swap => {
                let is_swap = |one: &UnderWay| matches!(one.doing, Doing::Swapping { .. });
                if self.under_way.iter().any(is_swap) {
                    bail!("another swap is under way");
                }
                Doing::Swapping { child: self.start_swap()? }
            }
        };
        self.under_way.push(UnderWay { number, until_ns, doing });
        Ok(true)
    }

    /// The scorer that runs is replaced by one like it: what is tried is the exchange.
    fn start_swap(&self) -> anyhow::Result<Child> {
        let own = std::env::current_exe().context("cannot tell where packcell lies")?;
        let mut command = Command::new(own);
        command.arg("swap").arg("--config").arg(self.config.bus.root_dir.join(CELL_FILE));
        command.args(["--sets", SWAP_SETS, "--p99-max-ms", "1000", "--policy", &self.config.scorer.policy]);
        if !self.config.scorer.model.as_os_str().is_empty() {
            command.arg("--model").arg(&self.config.scorer.model);
        }
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).process_group(0);
        command.spawn().context("cannot start packcell swap")
    }

    /// Goes on with what lasts; the numbers of the faults that are over, and what went wrong with them.
    pub(crate) fn go_on(&mut self, now_ns: u64) -> Vec<(u64, String)> {
        let mut over = Vec::new();
        let mut index = 0;
        while index < self.under_way.len() {
            match self.under_way[index].go_on(now_ns, &mut self.draw) {
                Some(note) => over.push((self.under_way.swap_remove(index).number, note)),
                None => index += 1,
            }
        }
        over
    }

    /// When there is something to do next [ns]; nothing if no moment is better than another.
    pub(crate) fn wake_ns(&self) -> Option<u64> {
        let next = |one: &UnderWay| {
            if let Doing::Slowed { turn_ns, .. } = one.doing { turn_ns.min(one.until_ns) } else { one.until_ns }
        };
        self.under_way.iter().filter(|one| !matches!(one.doing, Doing::Swapping { .. })).map(next).min()
    }
}

impl Drop for Hand<'_> {
    fn drop(&mut self) {
        for one in &mut self.under_way {
            one.until_ns = 0;
            if let Doing::Swapping { child } = &mut one.doing {
                let _it_may_be_over_already = child.kill();
            }
            let _nobody_asks_any_more = one.go_on(u64::MAX, &mut self.draw);
        }
    }
}

impl UnderWay {
    /// Goes on with it; what went wrong, empty if nothing did, as soon as it is over.
    fn go_on(&mut self, now_ns: u64, draw: &mut Draw) -> Option<String> {
        let is_over = now_ns >= self.until_ns;
        match &mut self.doing {
            Doing::Frozen { pid } if is_over => return Some(signal(*pid, Signal::CONT)),
            Doing::Slowed { pid, .. } if is_over => return Some(signal(*pid, Signal::CONT)),
            Doing::Limited { pid, before } if is_over => {
                let undone = prlimit(Some(*pid), Resource::Fsize, *before);
                return Some(undone.map_or_else(|error| format!("it died meanwhile: {error}"), |_| String::new()));
            }
            Doing::Answering { .. } | Doing::Babbling { .. } | Doing::Hogging if is_over => return Some(String::new()),
            Doing::Swapping { child } => return swapped(child),
            Doing::Slowed { pid, turn_ns, is_frozen } if now_ns >= *turn_ns => {
                *is_frozen = !*is_frozen;
                signal(*pid, if *is_frozen { Signal::STOP } else { Signal::CONT });
                *turn_ns = now_ns + if *is_frozen { SLOW_NS } else { SLOW_NS / 2 };
            }
            Doing::Answering { sets, decisions, instance } => {
                if let Err(error) = answer_wrongly(sets, decisions, *instance, draw) {
                    return Some(format!("{error:#}"));
                }
            }
            Doing::Babbling { sets } => {
                let fill = |set: &mut CandidateSet| {
                    bytes_of_mut(set).iter_mut().for_each(|byte| *byte = draw.below(4) as u8);
                };
                if let Err(error) = sets.publish(now_ns, fill) {
                    return Some(format!("{error:#}"));
                }
            }
            Doing::Frozen { .. } | Doing::Slowed { .. } | Doing::Limited { .. } | Doing::Hogging => {}
        }
        None
    }
}

/// Answers the set that is on the bus with a candidate and values that are none.
fn answer_wrongly(
    sets: &mut Latest<CandidateSet>,
    decisions: &mut Publisher<Decision>,
    instance: Instance,
    draw: &mut Draw,
) -> anyhow::Result<()> {
    sets.refresh()?;
    let Some(set) = sets.get() else { return Ok(()) };
    let wrong = [(set.count, 1.0), (u32::MAX, 1.0), (0, f32::NAN), (0, f32::INFINITY)];
    let (best, value) = wrong[draw.below(wrong.len() as u64) as usize];
    decisions.publish(set.header.observed_ns, |decision| {
        (decision.received_ns, decision.box_id, decision.revision) = (monotonic_ns(), set.current.id, set.revision);
        (decision.set_digest, decision.model, decision.instance) = (set.digest, 0, instance.to_wire());
        (decision.best, decision.value, decision.depth) = (best, value, 1);
    })?;
    Ok(())
}

fn find(processes: &Processes, role: Role, active: Instance) -> Option<(String, u32)> {
    let instance = (role == Role::Scorer).then_some(active);
    let (name, pid) = processes.find(role, instance)?;
    Some((name.to_owned(), pid))
}

fn signal(pid: Pid, signal: Signal) -> String {
    kill_process(pid, signal).map_or_else(|error| format!("it died meanwhile: {error}"), |()| String::new())
}

/// What became of a swap; nothing while it goes on.
fn swapped(child: &mut Child) -> Option<String> {
    match child.try_wait() {
        Ok(None) => None,
        Ok(Some(status)) if status.success() => Some(String::new()),
        Ok(Some(_)) => {
            let mut said = String::new();
            if let Some(stderr) = &mut child.stderr {
                let _what_can_be_read_is_said = stderr.read_to_string(&mut said);
            }
            let last = said.trim().lines().last().unwrap_or_default().to_owned();
            Some(format!("it failed: {last}"))
        }
        Err(error) => Some(error.to_string()),
    }
}
