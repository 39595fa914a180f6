//! A service as an operating-system process: its arguments, its start, its end.

use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use rustix::process::{Pid, Signal, getppid, set_parent_process_death_signal};
use signal_hook::consts::{SIGINT, SIGTERM, SIGXFSZ};

use crate::log::init_service_log;
use crate::{Config, ConfigError, scheduling};

/// The arguments that every service takes.
#[derive(Clone, Debug, clap::Args)]
pub struct ServiceArgs {
    /// The cell's configuration file, shared by all services
    #[arg(long, value_name = "FILE", default_value = "/etc/packcell/packcell.toml")]
    pub config: PathBuf,
    /// Overrides one key of the file, for example --set commander.hard_deadline_ms=30
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
    /// Stop when the process with this id ends, which is the one that started this one
    #[arg(long, value_name = "PID")]
    pub with_parent: Option<i32>,
}

impl ServiceArgs {
    /// Reads the configuration, starts the log, says what the kernel granted, and ties the process to its parent if
    /// it is to be.
    ///
    /// # Errors
    /// [`ConfigError`] says which file or key is wrong, and how.
    pub fn load(&self) -> Result<Config, ConfigError> {
        if let Some(parent) = self.with_parent {
            // Best effort: without it the cell's supervisor still stops what it started, unless it is killed.
            let _ = set_parent_process_death_signal(Some(Signal::TERM));
            // If the parent ended before that, somebody else is the parent now.
            if getppid().map(Pid::as_raw_pid) != Some(parent) {
                let _ = rustix::process::kill_process(rustix::process::getpid(), Signal::TERM);
            }
        }
        let config = Config::load(&self.config, &self.overrides)?;
        init_service_log(config.log.level);
        scheduling::settle();
        Ok(config)
    }
}

/// Whether SIGTERM or SIGINT asked the process to end.
#[derive(Clone, Debug)]
pub struct StopSignal(Arc<AtomicBool>);

impl StopSignal {
    /// Catches SIGTERM and SIGINT from here on.
    ///
    /// # Errors
    /// [`io::Error`] if the signals cannot be caught.
    pub fn catch() -> io::Result<Self> {
        let flag = Arc::new(AtomicBool::new(false));
        for signal in [SIGTERM, SIGINT] {
            signal_hook::flag::register(signal, Arc::clone(&flag))?;
        }
        // A file that reached the largest size allowed is an error that can be said, not a death.
        signal_hook::flag::register(SIGXFSZ, Arc::default())?;
        Ok(Self(flag))
    }

    /// Whether the process is to end.
    #[must_use]
    pub fn is_set(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}
