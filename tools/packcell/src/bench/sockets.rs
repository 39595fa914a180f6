//! The services' work on Unix sockets: as processes of their own, and all in one.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::Duration;

use anyhow::{Context as _, bail};
use bytemuck::Zeroable as _;
use messages::{Belief, BoxQueue, Header, MotionReport, PlaceCommand};
use packing::Grid;
use peer::{Inbox, Outbox, path_of};
use runtime::monotonic_ns;

use super::Decision;
use crate::cell::program_path;

/// What is started, by name.
const STAGES: [&str; 4] = ["candidates", "scorer", "commander", "alone"];

/// How long they may take to start.
const START_PATIENCE_NS: u64 = 20_000_000_000;

/// Pause between two looks at processes that start.
const PAUSE: Duration = Duration::from_millis(5);

/// The processes and the ways to them. Dropping it ends them.
pub(crate) struct Peers {
    children: Vec<Child>,
    inbox: Inbox,
    /// By stage.
    outboxes: Vec<Outbox>,
    belief: Box<Belief>,
    command: PlaceCommand,
}

impl Peers {
    /// Starts the peers with the cell's configuration, which lies in `dir`, and returns when all are ready.
    pub(crate) fn start(dir: &Path) -> anyhow::Result<Self> {
        let inbox = Inbox::bind(dir, "arm")?;
        inbox.wait_with_patience()?;
        let belief = Box::new(Belief::zeroed());
        let mut peers =
            Self { children: Vec::new(), inbox, outboxes: Vec::new(), belief, command: PlaceCommand::zeroed() };
        for stage in STAGES {
            peers.children.push(spawn(stage, dir)?);
        }
        let patience_ends_ns = monotonic_ns() + START_PATIENCE_NS;
        for stage in STAGES {
            let socket: PathBuf = path_of(dir, stage);
            while !socket.exists() {
                if monotonic_ns() > patience_ends_ns {
                    bail!("peer {stage} is not ready in time");
                }
                thread::sleep(PAUSE);
            }
            peers.outboxes.push(Outbox::to(dir, stage)?);
        }
        Ok(peers)
    }

    /// Shows containers and boxes to the three peers and waits for their command.
    pub(crate) fn decide(&mut self, grid: &Grid, queue: &BoxQueue) -> anyhow::Result<Decision> {
        let [candidates, scorer, commander, _] = self.outboxes.as_mut_slice() else { bail!("no peers") };
        let begin_ns = monotonic_ns();
        self.belief.update(grid);
        for reader in [&mut *commander, &mut *scorer, &mut *candidates] {
            reader.send(&*self.belief)?;
        }
        let seen = BoxQueue { header: Header { observed_ns: begin_ns, ..queue.header }, ..*queue };
        commander.send(&seen)?;
        candidates.send(&seen)?;
        self.receive()?;
        Ok(Decision { command: self.command, total_ns: monotonic_ns() - begin_ns })
    }

    /// Lets one process do it all. Its own clock counts, from the box that has arrived to the command that is ready.
    pub(crate) fn decide_alone(&mut self, grid: &Grid, queue: &BoxQueue) -> anyhow::Result<Decision> {
        let [.., alone] = self.outboxes.as_mut_slice() else { bail!("no peers") };
        self.belief.update(grid);
        alone.send(&*self.belief)?;
        alone.send(queue)?;
        self.receive()?;
        Ok(Decision { command: self.command, total_ns: self.inbox.stages_ns()?.iter().sum() })
    }

    /// Says that the arm has obeyed: the three peers, and the one.
    pub(crate) fn report(&mut self, motions: [MotionReport; 2]) -> anyhow::Result<()> {
        let [.., commander, alone] = self.outboxes.as_mut_slice() else { bail!("no peers") };
        commander.send(&motions[0])?;
        Ok(alone.send(&motions[1])?)
    }

    fn receive(&mut self) -> anyhow::Result<()> {
        self.inbox.receive().context("a peer gives no command")?;
        Ok(self.inbox.read(&mut self.command)?)
    }
}

impl Drop for Peers {
    fn drop(&mut self) {
        for child in &mut self.children {
            let _one_that_has_ended_need_not_be_killed = child.kill().and_then(|()| child.wait());
        }
    }
}

fn spawn(stage: &str, dir: &Path) -> anyhow::Result<Child> {
    let program = program_path("peer")?;
    let mut command = Command::new(&program);
    command.arg(stage).arg("--sockets").arg(dir).arg("--config").arg(dir.join("cell.toml"));
    command.arg("--with-parent").arg(std::process::id().to_string());
    command.stdin(Stdio::null()).stdout(Stdio::null());
    command.spawn().with_context(|| format!("cannot start {}", program.display()))
}
