//! A bus of one's own, which leaves nothing behind.

use std::fs::{self, File};
use std::os::unix::fs::DirBuilderExt as _;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use runtime::BusConfig;
use rustix::fs::FlockOperation;

/// Where shared memory and private buses live.
const SHARED_MEMORY: &str = "/dev/shm";

/// What the directories of private buses are called, before the process id.
const NAME: &str = "packcell-private-";

/// A bus that only this process and its children use. Dropping it removes it.
///
/// A lock on its directory is held as long as this process lives, so that the next private bus can tell the leftovers
/// of a killed one from a bus in use.
#[derive(Debug)]
pub(crate) struct PrivateBus {
    config: BusConfig,
    _lock: File,
}

impl PrivateBus {
    /// A fresh bus. What killed processes left of theirs is removed first.
    pub(crate) fn new() -> anyhow::Result<Self> {
        sweep(Path::new(SHARED_MEMORY));
        let id = std::process::id();
        let root_dir = Path::new(SHARED_MEMORY).join(format!("{NAME}{id}"));
        let create = || {
            fs::DirBuilder::new().mode(0o700).create(&root_dir)?;
            let lock = File::create(root_dir.join("lock"))?;
            rustix::fs::flock(&lock, FlockOperation::NonBlockingLockExclusive)?;
            Ok::<_, std::io::Error>(lock)
        };
        let lock = create().with_context(|| format!("cannot create the private bus {}", root_dir.display()))?;
        Ok(Self { config: BusConfig { prefix: prefix_of(&root_dir), root_dir }, _lock: lock })
    }

    /// How its processes reach it.
    pub(crate) fn config(&self) -> &BusConfig {
        &self.config
    }
}

impl Drop for PrivateBus {
    fn drop(&mut self) {
        remove_bus(&self.config.root_dir, &self.config.prefix);
    }
}

/// Removes a bus that nobody uses any more: its directory and its shared memory.
pub(crate) fn remove_bus(root_dir: &Path, prefix: &str) {
    let _what_is_gone_is_gone = fs::remove_dir_all(root_dir);
    for entry in fs::read_dir(SHARED_MEMORY).into_iter().flatten().flatten() {
        if entry.file_name().to_string_lossy().starts_with(prefix) {
            let _what_is_gone_is_gone = fs::remove_file(entry.path());
        }
    }
}

/// Removes the private buses whose processes are dead.
fn sweep(dir: &Path) {
    for entry in fs::read_dir(dir).into_iter().flatten().flatten() {
        let is_private = entry.file_name().to_string_lossy().starts_with(NAME);
        if is_private && is_abandoned(&entry.path()) {
            remove_bus(&entry.path(), &prefix_of(&entry.path()));
        }
    }
}

fn is_abandoned(root_dir: &Path) -> bool {
    let lock: PathBuf = root_dir.join("lock");
    File::open(lock).is_ok_and(|lock| rustix::fs::flock(&lock, FlockOperation::NonBlockingLockExclusive).is_ok())
}

fn prefix_of(root_dir: &Path) -> String {
    let name = root_dir.file_name().unwrap_or_default().to_string_lossy();
    format!("pc{}_", name.trim_start_matches(NAME))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_abandoned_buses_are_swept() {
        let dir = tempfile::tempdir().unwrap();
        let make = |name: &str| {
            let path = dir.path().join(name);
            fs::create_dir(&path).unwrap();
            let lock = File::create(path.join("lock")).unwrap();
            (path, lock)
        };
        let (living, lock) = make("packcell-private-1");
        rustix::fs::flock(&lock, FlockOperation::LockExclusive).unwrap();
        let (dead, _) = make("packcell-private-2");
        let (foreign, _) = make("somebody-elses");
        sweep(dir.path());
        assert!(living.exists() && !dead.exists() && foreign.exists());
        assert_eq!(prefix_of(&living), "pc1_");
    }
}
