//! A journal read while it is written.

use std::fs::{self, File};
use std::io::{self, Read as _, Seek as _, SeekFrom};
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};

use crate::frame::{HEADER, Next, Rest, next};
use crate::record::{Entry, Record};

/// Most bytes that are read at one time.
const CHUNK_BYTES: u64 = 1 << 20;

/// A reader that follows a journal entry by entry, also when the commander puts the file aside for a new one. It
/// needs no lock and never disturbs the writer.
#[derive(Debug)]
pub struct Follower {
    path: PathBuf,
    open: Option<Open>,
    /// Bytes that are read and not yet an entry.
    unread: Vec<u8>,
}

#[derive(Debug)]
struct Open {
    file: File,
    inode: u64,
    /// Bytes of the file that are entries already.
    whole_bytes: u64,
}

impl Follower {
    /// A reader that begins with the first entry of the journal at `path`, which need not be there yet.
    #[must_use]
    pub fn from_start(path: &Path) -> Self {
        Self { path: path.into(), open: None, unread: Vec::new() }
    }

    /// Calls `take` for every entry that was written since the last call.
    ///
    /// # Errors
    /// [`io::ErrorKind::InvalidData`] for bytes that no commander writes, and whatever reading fails with.
    pub fn read(&mut self, mut take: impl FnMut(&Entry)) -> io::Result<()> {
        loop {
            if self.open.is_none() {
                let Some(file) = open(&self.path)? else { return Ok(()) };
                let inode = file.metadata()?.ino();
                self.open = Some(Open { file, inode, whole_bytes: 0 });
            }
            let Some(open) = &mut self.open else { return Ok(()) };
            // Looked up before reading: what is put aside is not written any more, so its last entry is found below.
            let is_aside = fs::metadata(&self.path).is_ok_and(|now| now.ino() != open.inode);
            while open.read(&mut self.unread, &mut take)? {}
            if !is_aside {
                return Ok(());
            }
            self.open = None;
        }
    }
}

impl Open {
    /// Reads on from the last whole entry; whether there may be more.
    fn read(&mut self, unread: &mut Vec<u8>, take: &mut impl FnMut(&Entry)) -> io::Result<bool> {
        // Always from the last whole entry: a part of one may have been removed after a write that failed.
        unread.clear();
        self.file.seek(SeekFrom::Start(self.whole_bytes))?;
        let count = (&self.file).take(CHUNK_BYTES).read_to_end(unread)?;
        let mut at = 0;
        if self.whole_bytes == 0 {
            if !unread.starts_with(HEADER) {
                return if HEADER.starts_with(unread) { Ok(false) } else { Err(damaged()) };
            }
            at = HEADER.len();
        }
        loop {
            match next(&unread[at..]) {
                Next::Entry { entry, bytes } => {
                    take(&entry);
                    at += bytes;
                }
                Next::None(Rest::Damage) => return Err(damaged()),
                Next::None(Rest::Nothing | Rest::Cut) => break,
            }
        }
        self.whole_bytes += at as u64;
        let is_full = count as u64 == CHUNK_BYTES;
        if is_full && at == 0 { Err(damaged()) } else { Ok(is_full) }
    }
}

fn open(path: &Path) -> io::Result<Option<File>> {
    match File::open(path) {
        Ok(file) => Ok(Some(file)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

fn damaged() -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, "it is damaged, or no journal of this version")
}

impl Record {
    /// The number of the order that it is about, if it is about one.
    #[must_use]
    pub fn order(&self) -> Option<u64> {
        match self {
            Self::Intent(intent) => Some(intent.order),
            Self::Outcome(outcome) => Some(outcome.order),
            Self::Active(_) | Self::Carried(_) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::intent;
    use crate::{Journal, Outcome};
    use messages::MotionOutcome;

    #[test]
    fn every_entry_is_read_once_however_often_the_file_is_put_aside() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("journal.bin");
        let mut follower = Follower::from_start(&path);
        let mut seen = Vec::new();
        follower.read(|_| panic!("there is none yet")).unwrap();
        let (mut journal, _) = Journal::open(&path, 200).unwrap();
        for order in 1..=40 {
            let outcome = Outcome { order, outcome: MotionOutcome::Done };
            for record in [Record::Intent(intent(order)), Record::Outcome(outcome)] {
                journal.append(&Entry { unix_ms: order, record }).unwrap();
            }
            if order % 3 == 0 {
                follower.read(|entry| seen.extend(entry.record.order())).unwrap();
            }
            journal.make_room().unwrap();
        }
        follower.read(|entry| seen.extend(entry.record.order())).unwrap();
        // Between two looks the file was put aside more than once, and what a whole file held was missed: it shows.
        assert!(seen.is_sorted() && seen.last() == Some(&40), "{seen:?}");
        assert!(seen.windows(2).all(|pair| pair[1] - pair[0] <= 3), "{seen:?}");
    }

    #[test]
    fn an_entry_that_is_written_in_parts_is_read_when_it_is_whole() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("journal.bin");
        let mut bytes = HEADER.to_vec();
        crate::encode(&Entry { unix_ms: 1, record: Record::Active(1) }, &mut bytes);
        crate::encode(&Entry { unix_ms: 2, record: Record::Intent(intent(1)) }, &mut bytes);
        let mut follower = Follower::from_start(&path);
        let mut seen = 0;
        for length in 0..=bytes.len() {
            fs::write(&path, &bytes[..length]).unwrap();
            follower.read(|_| seen += 1).unwrap();
        }
        assert_eq!(seen, 2);
        fs::write(&path, b"something else").unwrap();
        assert_eq!(Follower::from_start(&path).read(|_| ()).unwrap_err().kind(), io::ErrorKind::InvalidData);
    }
}
