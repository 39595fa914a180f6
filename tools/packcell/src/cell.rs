//! The processes of a cell, started and stopped together.

use std::fs;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::thread;
use std::time::Duration;

use anyhow::{Context as _, bail};
use messages::Health;
use messages::topics::{HEALTH, Role};
use runtime::{Bus, Config, Subscriber, monotonic_ns};
use rustix::process::{Pid, Signal, kill_process};

/// How long a process may take from its start to its first word.
const START_PATIENCE_NS: u64 = 20_000_000_000;

/// How long a process may take to stop when asked.
const STOP_PATIENCE_NS: u64 = 3_000_000_000;

/// Pause between two looks at processes that start or stop.
const PAUSE: Duration = Duration::from_millis(5);

/// The order in which processes are started: whoever brings boxes comes last, so that everybody is there for the first.
const START_ORDER: [Role; 4] = [Role::Candidates, Role::Scorer, Role::Commander, Role::Perception];

/// A cell's processes. Dropping it stops them.
#[derive(Debug)]
pub(crate) struct Cell {
    children: Vec<(Role, Child)>,
}

impl Cell {
    /// Starts the four processes on the configured bus, and returns when all are ready.
    pub(crate) fn start(config: &Config, bus: &Bus) -> anyhow::Result<Self> {
        let file = config.bus.root_dir.join("cell.toml");
        fs::write(&file, config.to_toml()).with_context(|| format!("cannot write {}", file.display()))?;
        let health = bus.subscriber(&HEALTH)?;
        let mut cell = Self { children: Vec::new() };
        for role in START_ORDER {
            if role == Role::Perception {
                cell.await_ready(&health)?;
            }
            cell.children.push((role, spawn(role, &file)?));
        }
        cell.await_ready(&health)?;
        Ok(cell)
    }

    /// Waits until every process has said how it is.
    fn await_ready(&mut self, health: &Subscriber<Health>) -> anyhow::Result<()> {
        let mut silent: Vec<(Role, u32)> = self.children.iter().map(|(role, child)| (*role, child.id())).collect();
        let patience_ends_ns = monotonic_ns() + START_PATIENCE_NS;
        while !silent.is_empty() {
            while let Some(word) = health.receive()? {
                silent.retain(|&(_, pid)| pid != word.pid);
            }
            self.check()?;
            if monotonic_ns() > patience_ends_ns {
                let names: Vec<_> = silent.iter().map(|(role, _)| role.name()).collect();
                bail!("not ready in time: {}", names.join(", "));
            }
            thread::sleep(PAUSE);
        }
        Ok(())
    }

    /// Fails if a process has ended.
    pub(crate) fn check(&mut self) -> anyhow::Result<()> {
        for (role, child) in &mut self.children {
            if let Some(status) = child.try_wait()? {
                bail!("{} ended ({}); its own message stands above", role.name(), describe(status));
            }
        }
        Ok(())
    }

    /// Asks all processes to stop, waits for them, and kills those that do not.
    pub(crate) fn stop(mut self) -> anyhow::Result<()> {
        self.stop_all()
    }

    fn stop_all(&mut self) -> anyhow::Result<()> {
        let mut failed = Vec::new();
        for (_, child) in &self.children {
            signal(child, Signal::TERM);
        }
        let patience_ends_ns = monotonic_ns() + STOP_PATIENCE_NS;
        for (role, child) in &mut self.children {
            let status = loop {
                if let Some(status) = child.try_wait()? {
                    break status;
                }
                if monotonic_ns() > patience_ends_ns {
                    child.kill()?;
                    break child.wait()?;
                }
                thread::sleep(PAUSE);
            };
            if !status.success() {
                failed.push(format!("{} ({})", role.name(), describe(status)));
            }
        }
        self.children.clear();
        if failed.is_empty() { Ok(()) } else { bail!("not stopped cleanly: {}", failed.join(", ")) }
    }
}

impl Drop for Cell {
    fn drop(&mut self) {
        let _whoever_drops_it_has_an_error_already = self.stop_all();
    }
}

fn spawn(role: Role, config: &Path) -> anyhow::Result<Child> {
    let program = program_path(role)?;
    let mut command = Command::new(&program);
    command.arg("--config").arg(config).arg("--with-parent").stdin(Stdio::null()).stdout(Stdio::null());
    // A group of its own: Ctrl-C goes to packcell, which stops the processes in order.
    command.process_group(0);
    command.spawn().with_context(|| format!("cannot start {}", program.display()))
}

/// The program of a role lies beside this one, or where the package installs it.
fn program_path(role: Role) -> anyhow::Result<PathBuf> {
    let own = std::env::current_exe().context("cannot tell where packcell lies")?;
    let beside = own.with_file_name(role.name());
    let installed = own.with_file_name("../lib/packcell").join(role.name());
    if let Some(path) = [&beside, &installed].into_iter().find(|path| path.exists()) {
        Ok(path.clone())
    } else {
        bail!("{} is missing: build or install all programs of packcell together", beside.display())
    }
}

fn signal(child: &Child, signal: Signal) {
    if let Some(pid) = Pid::from_raw(child.id().cast_signed()) {
        let _one_that_has_ended_needs_no_signal = kill_process(pid, signal);
    }
}

fn describe(status: ExitStatus) -> String {
    status.to_string()
}
