//! A changed configuration, taken over while the process runs.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use signal_hook::consts::SIGHUP;
use tracing::{error, info, warn};

use crate::{Config, ServiceArgs};

/// The keys that a running service takes over; every other one counts from its next start on.
const AT_RUN_TIME: [&str; 7] = [
    "commander.soft_deadline_ms",
    "commander.hard_deadline_ms",
    "commander.close_policy",
    "perception.pace_ms",
    "perception.motion_ms",
    "perception.repeat_ms",
    "perception.upcoming",
];

/// Whether SIGHUP asked the process to read its configuration again, and the one it runs with.
#[derive(Debug)]
pub struct ReloadSignal {
    args: ServiceArgs,
    current: Config,
    is_asked: Arc<AtomicBool>,
}

impl ReloadSignal {
    /// Catches SIGHUP from here on, for a service that runs with `current`.
    ///
    /// # Errors
    /// [`io::Error`] if the signal cannot be caught.
    pub fn catch(args: ServiceArgs, current: Config) -> io::Result<Self> {
        let is_asked = Arc::new(AtomicBool::new(false));
        signal_hook::flag::register(SIGHUP, Arc::clone(&is_asked))?;
        Ok(Self { args, current, is_asked })
    }

    /// The new configuration, if one was asked for since the last call and it is valid. One that is not is refused
    /// with a line in the log, and the old one stays.
    pub fn take(&mut self) -> Option<&Config> {
        if !self.is_asked.swap(false, Ordering::Relaxed) {
            return None;
        }
        match Config::load(&self.args.config, &self.args.overrides) {
            Ok(config) => {
                let changed = self.current.changed_keys(&config).into_iter();
                let (taken, later) = changed.partition::<Vec<_>, _>(|key| AT_RUN_TIME.contains(&key.as_str()));
                info!("read the configuration again; taken over: {}", list(&taken));
                if !later.is_empty() {
                    warn!("these keys count from the next start on: {}", list(&later));
                }
                self.current = config;
                Some(&self.current)
            }
            Err(error) => {
                error!("refused the changed configuration, the old one stays: {error}");
                None
            }
        }
    }
}

fn list(keys: &[String]) -> String {
    if keys.is_empty() { "nothing".to_owned() } else { keys.join(", ") }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn a_good_file_is_taken_and_a_bad_one_is_not() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("packcell.toml");
        let args = ServiceArgs {
            config: file.clone(),
            overrides: vec!["commander.soft_deadline_ms=3".into()],
            with_parent: None,
        };
        let mut reload = ReloadSignal::catch(args, Config::default()).unwrap();
        fs::write(&file, "[commander]\nhard_deadline_ms = 30\n").unwrap();
        assert!(reload.take().is_none(), "nobody asked");

        signal_hook::low_level::raise(SIGHUP).unwrap();
        let taken = reload.take().unwrap().commander.clone();
        assert_eq!((taken.soft_deadline_ms, taken.hard_deadline_ms), (3, 30), "overrides override a new file too");
        assert!(reload.take().is_none(), "one signal, one configuration");

        fs::write(&file, "[commander]\nhard_deadline_ms = 0\n").unwrap();
        signal_hook::low_level::raise(SIGHUP).unwrap();
        assert!(reload.take().is_none());
        assert_eq!(reload.current.commander.hard_deadline_ms, 30);
    }

    #[test]
    fn every_key_that_is_taken_over_exists() {
        let file: toml::Table = toml::from_str(&Config::default().to_toml()).unwrap();
        for key in AT_RUN_TIME {
            let (section, name) = key.split_once('.').unwrap();
            assert!(file[section].as_table().unwrap().contains_key(name), "{key}");
        }
    }
}
