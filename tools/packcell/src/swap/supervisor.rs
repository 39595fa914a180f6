//! Whoever keeps the processes of a running cell running.

use std::fs::{self, File};
use std::process::Command;

use anyhow::{Context as _, bail};
use messages::{Control, Instance, Wish};
use runtime::{Config, Publisher};
use rustix::fs::FlockOperation;

use super::publish;

/// Who starts and stops scorers.
#[derive(Debug)]
pub(crate) enum Supervisor {
    /// `packcell up`, which hears wishes on the bus.
    Up,
    /// systemd, with one unit an instance.
    Systemd,
}

impl Supervisor {
    /// Who supervises the cell to which the scorer with the process id `scorer_pid` belongs.
    pub(crate) fn of(config: &Config, scorer_pid: u32) -> anyhow::Result<Self> {
        let lock = File::open(config.bus.root_dir.join("lock"));
        if lock.is_ok_and(|lock| rustix::fs::flock(&lock, FlockOperation::NonBlockingLockExclusive).is_err()) {
            return Ok(Self::Up);
        }
        let unit = fs::read_to_string(format!("/proc/{scorer_pid}/cgroup"));
        if unit.is_ok_and(|unit| unit.contains("packcell-scorer@")) {
            return Ok(Self::Systemd);
        }
        bail!("nobody supervises this cell: a swap needs one that 'packcell up' or systemd keeps running")
    }

    pub(crate) fn start(&self, instance: Instance, controls: &mut Publisher<Control>) -> anyhow::Result<()> {
        match self {
            Self::Up => publish(controls, Wish::Start, instance, 0),
            Self::Systemd => systemctl("enable", instance),
        }
    }

    pub(crate) fn retire(&self, instance: Instance, controls: &mut Publisher<Control>) -> anyhow::Result<()> {
        match self {
            Self::Up => publish(controls, Wish::Retire, instance, 0),
            Self::Systemd => systemctl("disable", instance),
        }
    }
}

/// Enables or disables the instance's unit, now and for the next boot.
fn systemctl(verb: &str, instance: Instance) -> anyhow::Result<()> {
    let unit = format!("packcell-scorer@{instance}.service");
    let output = Command::new("systemctl").args(["--now", verb, &unit]).output().context("cannot run systemctl")?;
    if output.status.success() {
        Ok(())
    } else {
        bail!("systemctl --now {verb} {unit}: {}", String::from_utf8_lossy(&output.stderr).trim())
    }
}
