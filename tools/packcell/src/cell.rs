//! The processes of a cell: started together, kept running, stopped together.

use std::fs;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::Duration;

use anyhow::{Context as _, bail};
use messages::topics::{HEALTH, Role};
use messages::{Health, Instance};
use runtime::{Bus, Config, Subscriber, monotonic_ns};
use rustix::process::{Pid, Signal, kill_process};

use crate::args::CELL_FILE;
use crate::restart::{Deaths, Verdict};

/// How long a process may take from its start to its first word.
const START_PATIENCE_NS: u64 = 20_000_000_000;

/// How long a process may take to stop when asked.
const STOP_PATIENCE_NS: u64 = 3_000_000_000;

/// Pause between two looks at processes that start or stop.
const PAUSE: Duration = Duration::from_millis(5);

/// A cell's processes. Dropping it stops them.
#[derive(Debug)]
pub(crate) struct Cell {
    /// The configuration that all processes read.
    file: PathBuf,
    health: Subscriber<Health>,
    services: Vec<Service>,
}

/// One process that is to run.
#[derive(Debug)]
struct Service {
    role: Role,
    /// Which scorer it is.
    instance: Option<Instance>,
    /// Nothing while it waits for its restart, or was given up.
    child: Option<Child>,
    started_ns: u64,
    is_ready: bool,
    deaths: Deaths,
    /// When it is to be started again [ns].
    restart_ns: Option<u64>,
}

impl Cell {
    /// Starts all processes on the configured bus, with these scorers, and returns when all are ready.
    pub(crate) fn start(config: &Config, scorers: &[Instance], bus: &Bus) -> anyhow::Result<Self> {
        let mut cell = Self::start_without_perception(config, scorers, bus)?;
        cell.add(Role::Perception, None)?;
        cell.await_ready()?;
        Ok(cell)
    }

    /// As [`Cell::start`], for a caller that is perception itself.
    pub(crate) fn start_without_perception(config: &Config, scorers: &[Instance], bus: &Bus) -> anyhow::Result<Self> {
        let file = config.bus.root_dir.join(CELL_FILE);
        fs::write(&file, config.to_toml()).with_context(|| format!("cannot write {}", file.display()))?;
        let mut cell = Self { file, health: bus.subscriber(&HEALTH)?, services: Vec::new() };
        // Whoever brings boxes comes last, so that everybody is there for the first.
        let scorers = scorers.iter().map(|&instance| (Role::Scorer, Some(instance)));
        let others = [(Role::Candidates, None), (Role::Commander, None)];
        for (role, instance) in others.into_iter().chain(scorers) {
            cell.add(role, instance)?;
        }
        cell.await_ready()?;
        Ok(cell)
    }

    fn add(&mut self, role: Role, instance: Option<Instance>) -> anyhow::Result<()> {
        let (child, started_ns, deaths) = (None, 0, Deaths::default());
        let mut service = Service { role, instance, child, started_ns, is_ready: false, deaths, restart_ns: None };
        service.start(&self.file)?;
        self.services.push(service);
        Ok(())
    }

    /// Waits until every process has said how it is.
    fn await_ready(&mut self) -> anyhow::Result<()> {
        let patience_ends_ns = monotonic_ns() + START_PATIENCE_NS;
        loop {
            self.hear()?;
            self.check()?;
            let silent: Vec<_> = self.services.iter().filter(|service| !service.is_ready).map(Service::name).collect();
            if silent.is_empty() {
                return Ok(());
            }
            if monotonic_ns() > patience_ends_ns {
                bail!("not ready in time: {}", silent.join(", "));
            }
            thread::sleep(PAUSE);
        }
    }

    /// Notes who has said that it is ready.
    fn hear(&mut self) -> anyhow::Result<()> {
        while let Some(word) = self.health.receive()? {
            let speaks = |service: &&mut Service| service.child.as_ref().is_some_and(|child| child.id() == word.pid);
            if let Some(service) = self.services.iter_mut().find(speaks) {
                service.is_ready = true;
            }
        }
        Ok(())
    }

    /// Fails if a process has ended.
    pub(crate) fn check(&mut self) -> anyhow::Result<()> {
        for service in &mut self.services {
            if let Some(status) = service.child.as_mut().map(Child::try_wait).transpose()?.flatten() {
                bail!("{} ended ({status}); its own message stands above", service.name());
            }
        }
        Ok(())
    }

    /// Starts again what has died. Fails if something that a cell cannot do without dies again and again before it is
    /// ready; a scorer is given up then, and the cell goes on without it.
    pub(crate) fn tend(&mut self) -> anyhow::Result<()> {
        self.hear()?;
        let now = monotonic_ns();
        for service in &mut self.services {
            if let Some(status) = service.child.as_mut().map(Child::try_wait).transpose()?.flatten() {
                service.child = None;
                let lived_ns = now.saturating_sub(service.started_ns);
                match service.deaths.count(lived_ns, service.is_ready) {
                    Verdict::Restart { after_ns } => {
                        tracing::warn!(service = service.name(), %status, "died; it is started again");
                        service.restart_ns = Some(now + after_ns);
                    }
                    Verdict::GiveUp if service.role == Role::Scorer => {
                        tracing::error!(service = service.name(), %status, "given up: it dies before it is ready");
                    }
                    Verdict::GiveUp => {
                        bail!("{} dies again and again before it is ready ({status}); see above", service.name());
                    }
                }
            }
            if service.restart_ns.is_some_and(|due_ns| now >= due_ns) {
                service.start(&self.file)?;
            }
        }
        Ok(())
    }

    /// Starts a scorer instance, unless it runs already.
    pub(crate) fn start_scorer(&mut self, instance: Instance) -> anyhow::Result<()> {
        let known = self.services.iter_mut().find(|service| service.instance == Some(instance));
        match known {
            Some(service) if service.child.is_some() || service.restart_ns.is_some() => Ok(()),
            Some(service) => {
                service.deaths = Deaths::default();
                service.start(&self.file)
            }
            None => self.add(Role::Scorer, Some(instance)),
        }
    }

    /// Stops a scorer instance and does not start it again.
    pub(crate) fn retire_scorer(&mut self, instance: Instance) -> anyhow::Result<()> {
        let Some(index) = self.services.iter().position(|service| service.instance == Some(instance)) else {
            return Ok(());
        };
        let service = self.services.remove(index);
        stop_all(&mut [service])
    }

    /// How often processes were started again.
    pub(crate) fn restarts(&self) -> u64 {
        self.services.iter().map(|service| service.deaths.restarts()).sum()
    }

    /// Asks all processes to stop, waits for them, and kills those that do not.
    pub(crate) fn stop(mut self) -> anyhow::Result<()> {
        let mut services = std::mem::take(&mut self.services);
        stop_all(&mut services)
    }
}

impl Drop for Cell {
    fn drop(&mut self) {
        let _whoever_drops_it_has_an_error_already = stop_all(&mut self.services);
    }
}

impl Service {
    fn name(&self) -> String {
        match self.instance {
            Some(instance) => format!("{} {instance}", self.role.name()),
            None => self.role.name().to_owned(),
        }
    }

    fn start(&mut self, config: &Path) -> anyhow::Result<()> {
        let program = program_path(self.role.name())?;
        let mut command = Command::new(&program);
        command.arg("--config").arg(config).arg("--with-parent").arg(std::process::id().to_string());
        command.stdin(Stdio::null()).stdout(Stdio::null());
        if let Some(instance) = self.instance {
            command.arg("--instance").arg(instance.to_string());
        }
        // A group of its own: Ctrl-C goes to packcell, which stops the processes in order.
        command.process_group(0);
        let child = command.spawn().with_context(|| format!("cannot start {}", program.display()))?;
        (self.child, self.started_ns, self.is_ready, self.restart_ns) = (Some(child), monotonic_ns(), false, None);
        Ok(())
    }
}

fn stop_all(services: &mut [Service]) -> anyhow::Result<()> {
    let mut failed = Vec::new();
    for child in services.iter().filter_map(|service| service.child.as_ref()) {
        signal(child, Signal::TERM);
    }
    let patience_ends_ns = monotonic_ns() + STOP_PATIENCE_NS;
    for service in services {
        let name = service.name();
        let Some(mut child) = service.child.take() else { continue };
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
            failed.push(format!("{name} ({status})"));
        }
    }
    if failed.is_empty() { Ok(()) } else { bail!("not stopped cleanly: {}", failed.join(", ")) }
}

/// A program lies beside this one, or where the package installs it.
pub(crate) fn program_path(name: &str) -> anyhow::Result<PathBuf> {
    let own = std::env::current_exe().context("cannot tell where packcell lies")?;
    let beside = own.with_file_name(name);
    let installed = own.with_file_name("../lib/packcell").join(name);
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
