//! The machine itself, measured beside the cell: a bare timer, and a bare ping over the bus.
//!
//! The ping is a box message there and a command back, between two processes that do nothing else, with the bells and
//! ports of the cell and on a bus of its own. What these two show, no cell on this machine can be better than.

use std::io::{BufRead as _, BufReader, Write as _};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{self, Receiver};
use std::thread;
use std::time::Duration;

use anyhow::{Context as _, bail};
use messages::topics::{BOXES, COMMANDS, Role};
use runtime::{Bus, BusConfig, monotonic_ns};
use rustix::process::{Pid, Signal, kill_process, set_parent_process_death_signal};
use serde::{Deserialize, Serialize};

use super::latency::{Micros, Percentiles};
use crate::private_bus::PrivateBus;

/// Beat of the timer, and of the ping [ns].
const TIMER_NS: u64 = 5_000_000;
const PING_NS: u64 = 10_000_000;

/// How often the slowest of each is said [ns].
const SAY_NS: u64 = 1_000_000_000;

/// How long the last word is waited for.
const LAST_WORD: Duration = Duration::from_secs(5);

#[derive(Debug, clap::Args)]
pub(crate) struct BaselineArgs {
    /// Answer pings on the bus in this directory
    #[arg(long, value_name = "DIR", requires = "prefix")]
    answer: Option<PathBuf>,
    /// Prefix of that bus
    #[arg(long, value_name = "PREFIX")]
    prefix: Option<String>,
}

/// The slowest of one second.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(crate) struct Second {
    pub(crate) at_ns: u64,
    pub(crate) timer_max_us: u64,
    pub(crate) ping_max_us: u64,
}

/// The whole time.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Baseline {
    /// How late a thread woke that had asked for a moment.
    pub(crate) timer_us: Percentiles,
    /// A message to another process and one back.
    pub(crate) ping_us: Percentiles,
    pub(crate) timer_curve: Vec<(f64, f64)>,
    pub(crate) ping_curve: Vec<(f64, f64)>,
}

#[derive(Serialize, Deserialize)]
enum Word {
    Second(Second),
    Last(Baseline),
}

/// `packcell baseline`: measures until it is stopped, and says what it found in lines of JSON.
pub(crate) fn run(args: &BaselineArgs) -> anyhow::Result<()> {
    set_parent_process_death_signal(Some(Signal::TERM)).context("cannot be tied to its parent")?;
    match (&args.answer, &args.prefix) {
        (Some(root_dir), Some(prefix)) => answer(&BusConfig { root_dir: root_dir.clone(), prefix: prefix.clone() }),
        _ => measure(),
    }
}

fn answer(bus: &BusConfig) -> anyhow::Result<()> {
    let bus = Bus::join(bus, Role::Candidates)?;
    let (bell, boxes, mut commands) = (bus.bell()?, bus.subscriber(&BOXES)?, bus.publisher(&COMMANDS)?);
    while bell.wait(None)? {
        while let Some(queue) = boxes.receive()? {
            commands.publish(0, |command| command.order = queue.taken)?;
        }
    }
    Ok(())
}

fn measure() -> anyhow::Result<()> {
    let private = PrivateBus::new()?;
    let bus = Bus::join(private.config(), Role::Perception)?;
    let (bell, mut boxes, commands) = (bus.bell()?, bus.publisher(&BOXES)?, bus.subscriber(&COMMANDS)?);
    let own = std::env::current_exe().context("cannot tell where packcell lies")?;
    let BusConfig { root_dir, prefix } = private.config();
    let mut answerer = Command::new(own);
    answerer.arg("baseline").arg("--answer").arg(root_dir).args(["--prefix", prefix]).stdin(Stdio::null());
    let mut answerer = answerer.spawn().context("cannot start who answers")?;
    let (woken, wakes) = mpsc::channel();
    thread::spawn(move || time(&woken));

    let (mut timer, mut ping) = (Micros::new(), Micros::new());
    let mut second = Second { at_ns: monotonic_ns(), timer_max_us: 0, ping_max_us: 0 };
    let (mut number, mut sent_ns, mut next_ns) = (0, 0, monotonic_ns());
    while bell.wait(Some(next_ns))? {
        while let Some(command) = commands.receive()? {
            if command.order == number && sent_ns > 0 {
                let took_ns = monotonic_ns() - sent_ns;
                ping.record_ns(took_ns);
                second.ping_max_us = second.ping_max_us.max(took_ns / 1000);
                sent_ns = 0;
            }
        }
        let now = monotonic_ns();
        // A ping without an answer is waited for; the first ones come before anybody is there to answer.
        if now >= next_ns && (sent_ns == 0 || now > sent_ns + SAY_NS) {
            number += 1;
            sent_ns = boxes.publish(0, |queue| queue.taken = number)?;
            next_ns = now + PING_NS;
        } else if now >= next_ns {
            next_ns = now + PING_NS;
        }
        for late_ns in wakes.try_iter() {
            timer.record_ns(late_ns);
            second.timer_max_us = second.timer_max_us.max(late_ns / 1000);
        }
        if now > second.at_ns + SAY_NS {
            say(&Word::Second(Second { at_ns: now, ..second }))?;
            second = Second { at_ns: now, timer_max_us: 0, ping_max_us: 0 };
        }
    }
    answerer.kill().and_then(|()| answerer.wait()).context("cannot stop who answers")?;
    let (timer_us, ping_us) = (timer.percentiles(), ping.percentiles());
    say(&Word::Last(Baseline { timer_us, ping_us, timer_curve: timer.curve(), ping_curve: ping.curve() }))
}

fn time(woken: &mpsc::Sender<u64>) {
    let mut due_ns = monotonic_ns();
    loop {
        due_ns += TIMER_NS;
        thread::sleep(Duration::from_nanos(due_ns.saturating_sub(monotonic_ns())));
        let now = monotonic_ns();
        if woken.send(now.saturating_sub(due_ns)).is_err() {
            return;
        }
        // Who was late by more than a beat does not make up for it in one go.
        due_ns = due_ns.max(now.saturating_sub(TIMER_NS));
    }
}

fn say(word: &Word) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    writeln!(out, "{}", serde_json::to_string(word)?).and_then(|()| out.flush()).context("nobody listens")
}

/// The baseline as whoever soaks runs it. Dropping it stops it.
#[derive(Debug)]
pub(crate) struct Measuring {
    child: Child,
    words: Receiver<String>,
}

impl Measuring {
    pub(crate) fn start() -> anyhow::Result<Self> {
        let own = std::env::current_exe().context("cannot tell where packcell lies")?;
        let mut command = Command::new(own);
        command.arg("baseline").stdin(Stdio::null()).stdout(Stdio::piped());
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut child = command.spawn().context("cannot start the baseline")?;
        let out = child.stdout.take().context("the baseline has no output")?;
        let (said, words) = mpsc::channel();
        thread::spawn(move || {
            for line in BufReader::new(out).lines().map_while(Result::ok) {
                if said.send(line).is_err() {
                    return;
                }
            }
        });
        Ok(Self { child, words })
    }

    /// The seconds that were said since the last call.
    pub(crate) fn seconds(&self) -> Vec<Second> {
        self.words.try_iter().filter_map(|line| second_of(&line)).collect()
    }

    /// Stops it: what it found over the whole time.
    pub(crate) fn stop(self) -> anyhow::Result<Baseline> {
        self.ask();
        while let Ok(line) = self.words.recv_timeout(LAST_WORD) {
            if let Ok(Word::Last(baseline)) = serde_json::from_str(&line) {
                return Ok(baseline);
            }
        }
        bail!("the baseline ended without a last word")
    }

    fn ask(&self) {
        if let Some(pid) = Pid::from_raw(self.child.id().cast_signed()) {
            let _it_may_have_ended = kill_process(pid, Signal::TERM);
        }
    }
}

impl Drop for Measuring {
    fn drop(&mut self) {
        self.ask();
        let _its_end_says_nothing_more = self.child.wait();
    }
}

fn second_of(line: &str) -> Option<Second> {
    match serde_json::from_str(line) {
        Ok(Word::Second(second)) => Some(second),
        Ok(Word::Last(_)) | Err(_) => None,
    }
}
