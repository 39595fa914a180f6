//! The stub's world in a file with two places, written in turns: whatever interrupts a writing, the other is whole.
//!
//! The file is written over and never replaced: a rename at every box would keep a disk's own journal busy, and with it
//! everybody who writes there.

use std::fs::{self, File, OpenOptions};
use std::os::unix::fs::FileExt as _;
use std::path::Path;

use anyhow::{Context as _, bail};
use perception::{Perception, World};
use rustix::fs::FlockOperation;

/// Bytes from one place to the other: more than the largest world takes.
const PLACE_BYTES: u64 = 2 << 20;

/// Bytes before a world: its number, its length, and the CRC-32 of both and of the world.
const HEAD_BYTES: usize = 16;

/// The file, and the number of the world that was kept last.
#[derive(Debug)]
pub(crate) struct WorldFile {
    file: File,
    path: String,
    number: u64,
    world: Vec<u8>,
    written: Vec<u8>,
}

impl WorldFile {
    /// The file at `path` and the last world that was kept in it, if there is one. Only one stub at a time has it.
    pub(crate) fn open(path: &Path) -> anyhow::Result<(Self, Option<World>)> {
        let name = path.display().to_string();
        let dir = path.parent().context("the state directory (state.dir) has no name")?;
        let open = || OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path);
        let file = fs::create_dir_all(dir).and_then(|()| open());
        let file = file.with_context(|| format!("cannot use the world {name} (state.dir)"))?;
        rustix::fs::flock(&file, FlockOperation::NonBlockingLockExclusive)
            .with_context(|| format!("another perception uses the world {name}: two cells need two state.dir"))?;
        let bytes = fs::read(path).with_context(|| format!("cannot read the world {name}"))?;
        let places = [0, PLACE_BYTES as usize].into_iter().filter_map(|from| bytes.get(from..).and_then(read));
        let last = places.max_by_key(|(number, _)| *number);
        if last.is_none() && !bytes.is_empty() {
            bail!("the world {name} is damaged: remove it to begin with empty containers");
        }
        let number = last.as_ref().map_or(0, |(number, _)| *number);
        let (world, written) = (Vec::new(), Vec::new());
        Ok((Self { file, path: name, number, world, written }, last.map(|(_, world)| world)))
    }

    /// Keeps the world if it has changed; whether it is kept. What cannot be kept must not be said.
    pub(crate) fn keep(&mut self, perception: &mut Perception) -> bool {
        if perception.is_changed() {
            perception.world().encode(&mut self.world);
            write(self.number + 1, &self.world, &mut self.written);
            match self.file.write_all_at(&self.written, (self.number + 1) % 2 * PLACE_BYTES) {
                Ok(()) => {
                    self.number += 1;
                    perception.kept(Ok(()));
                }
                Err(error) => perception.kept(Err(&format!("cannot write {}: {error}", self.path))),
            }
        }
        !perception.is_changed()
    }
}

/// The bytes of one place.
fn write(number: u64, world: &[u8], place: &mut Vec<u8>) {
    place.clear();
    place.extend(number.to_le_bytes());
    place.extend((world.len() as u32).to_le_bytes());
    let sum = checksum(place, world);
    place.extend(sum.to_le_bytes());
    place.extend(world);
}

/// The world in a place and its number, unless it was not written whole.
fn read(place: &[u8]) -> Option<(u64, World)> {
    let (head, behind) = place.split_at_checked(HEAD_BYTES)?;
    let (number, rest) = head.split_first_chunk::<8>()?;
    let (length, sum) = rest.split_first_chunk::<4>()?;
    let world = behind.get(..u32::from_le_bytes(*length) as usize)?;
    if *sum != checksum(&head[..12], world).to_le_bytes() {
        return None;
    }
    Some((u64::from_le_bytes(*number), World::decode(world).ok()?))
}

fn checksum(head: &[u8], world: &[u8]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(head);
    hasher.update(world);
    hasher.finalize()
}

#[cfg(test)]
mod tests {
    use packing::{ContainerSize, Grid};
    use perception::{Behaviour, Belt};

    use super::*;

    /// A stub with so many containers, whose world has never been kept.
    fn perception(slots: usize) -> Perception {
        let size = ContainerSize::new(45, 80, 50, 10).unwrap();
        let belt = Belt::open("standard", 1, 1, size).unwrap();
        let behaviour = Behaviour { pace_ns: 0, motion_ns: 0, repeat_ns: 1, upcoming: 0 };
        Perception::new(behaviour, Grid::new(size, slots).unwrap(), belt, 0)
    }

    fn found(path: &Path) -> Option<World> {
        WorldFile::open(path).unwrap().1
    }

    #[test]
    fn a_writing_that_is_cut_short_leaves_the_world_before() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("state/world.bin");
        assert_eq!(found(&path), None);
        let worlds = [1, 2, 3].map(|slots| perception(slots).world());
        for slots in [1, 2, 3] {
            let (mut file, _) = WorldFile::open(&path).unwrap();
            assert!(file.keep(&mut perception(slots)));
            drop(file);
            assert_eq!(found(&path).as_ref(), Some(&worlds[slots - 1]));
        }
        // The third one lies in the second place; every byte of it counts.
        let whole = fs::read(&path).unwrap();
        for at in PLACE_BYTES as usize..whole.len() {
            let mut damaged = whole.clone();
            damaged[at] ^= 0x10;
            fs::write(&path, &damaged).unwrap();
            assert_eq!(found(&path).as_ref(), Some(&worlds[1]), "byte {at}");
            fs::write(&path, &whole[..at]).unwrap();
            assert_eq!(found(&path).as_ref(), Some(&worlds[1]), "cut at {at}");
        }
        fs::write(&path, b"no world").unwrap();
        let message = WorldFile::open(&path).unwrap_err().to_string();
        assert!(message.contains("is damaged: remove it"), "{message}");
    }

    #[test]
    fn a_world_has_one_stub() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("world.bin");
        let _first = WorldFile::open(&path).unwrap();
        let message = WorldFile::open(&path).unwrap_err().to_string();
        assert!(message.starts_with("another perception uses the world"), "{message}");
    }
}
