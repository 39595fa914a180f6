//! The stub's world in a file, replaced whole at every change.

use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use perception::{Perception, World};
use rustix::fs::FlockOperation;

/// The file and what is needed to replace it.
#[derive(Debug)]
pub(crate) struct WorldFile {
    path: PathBuf,
    unfinished: PathBuf,
    bytes: Vec<u8>,
    _lock: File,
}

impl WorldFile {
    /// The file at `path` and the world in it, if there is one. Only one stub at a time has it.
    pub(crate) fn open(path: &Path) -> anyhow::Result<(Self, Option<World>)> {
        let remedy = || format!("the world {}: remove it to begin with empty containers", path.display());
        let dir = path.parent().context("the state directory (state.dir) has no name")?;
        let lock = fs::create_dir_all(dir).and_then(|()| File::create(path.with_extension("lock")));
        let lock = lock.with_context(|| format!("cannot use the directory {} (state.dir)", dir.display()))?;
        rustix::fs::flock(&lock, FlockOperation::NonBlockingLockExclusive)
            .with_context(|| format!("another perception uses {}: two cells need two state.dir", dir.display()))?;
        let world = match fs::read(path) {
            Ok(bytes) => Some(World::decode(&bytes).with_context(remedy)?),
            Err(error) if error.kind() == io::ErrorKind::NotFound => None,
            Err(error) => return Err(error).with_context(remedy),
        };
        let (path, unfinished, bytes) = (path.to_owned(), path.with_extension("new"), Vec::new());
        Ok((Self { path, unfinished, bytes, _lock: lock }, world))
    }

    /// Keeps the world if it has changed; whether it is kept. What cannot be kept must not be said.
    pub(crate) fn keep(&mut self, perception: &mut Perception) -> bool {
        if perception.is_changed() {
            perception.world().encode(&mut self.bytes);
            let written = File::create(&self.unfinished).and_then(|mut file| file.write_all(&self.bytes));
            match written.and_then(|()| fs::rename(&self.unfinished, &self.path)) {
                Ok(()) => perception.kept(Ok(())),
                Err(error) => perception.kept(Err(&format!("cannot write {}: {error}", self.path.display()))),
            }
        }
        !perception.is_changed()
    }
}
