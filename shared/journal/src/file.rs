//! The journal as a file that only grows.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Seek as _, SeekFrom, Write as _};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, SyncSender};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};

use rustix::fs::FlockOperation;

use crate::frame::{Contents, FRAME_BYTES_MAX, HEADER, Rest, decode, encode};
use crate::record::{Entry, Record, State};

/// A journal that is being written. Only one process at a time has it open.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    file: File,
    /// Bytes that are written whole.
    whole_bytes: u64,
    /// Above this the file makes room for a new one, when there is time [bytes].
    limit_bytes: u64,
    frame: Vec<u8>,
    state: State,
    syncing: Syncing,
}

/// What was found when a journal was opened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Found {
    /// No journal: this is the first.
    Nothing,
    /// A whole journal.
    Whole,
    /// A journal whose last entry was cut short by a crash; so many bytes were removed.
    Cut(u64),
    /// A damaged journal. It was moved here, and the new one goes on from its last whole entry.
    Damaged(PathBuf),
}

/// Why a journal cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The operating system says no.
    #[error("cannot use the journal {path} (state.dir): {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the operating system says.
        source: io::Error,
    },
    /// Another commander has it.
    #[error("another commander writes the journal {path}: two cells need two directories (state.dir)")]
    InUse {
        /// The file.
        path: PathBuf,
    },
}

/// Why an entry was not written. The journal is as it was before.
#[derive(Debug, thiserror::Error)]
pub enum AppendError {
    /// The file cannot grow.
    #[error("cannot write the journal {path}: {source}")]
    Write {
        /// The file.
        path: PathBuf,
        /// What the operating system says.
        source: io::Error,
    },
    /// What was written before may not have reached the disk.
    #[error("the disk did not take the journal {path}: {reason}")]
    Sync {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        reason: String,
    },
}

/// Reads a journal without opening it for writing: a journal that is in use may be read.
///
/// # Errors
/// [`io::Error`] if the file cannot be read.
pub fn read(path: &Path) -> io::Result<Contents> {
    fs::read(path).map(|bytes| decode(&bytes))
}

impl Journal {
    /// Opens the journal, or begins it. Its directory is made if it is missing.
    ///
    /// When the file has grown beyond `limit_bytes`, [`Journal::make_room`] puts it aside as `FILE.previous`.
    ///
    /// # Errors
    /// [`OpenError`] says what stands in the way.
    pub fn open(path: &Path, limit_bytes: u64) -> Result<(Self, Found), OpenError> {
        let unusable = |source| OpenError::Io { path: path.into(), source };
        if let Some(dir) = path.parent() {
            fs::create_dir_all(dir).map_err(unusable)?;
        }
        // A crash between the two renames of `make_room` leaves the previous journal and none.
        let previous = aside(path, "previous");
        let before = if path.exists() { None } else { read(&previous).ok() };
        let file = create(path, false).map_err(unusable)?;
        rustix::fs::flock(&file, FlockOperation::NonBlockingLockExclusive)
            .map_err(|_| OpenError::InUse { path: path.into() })?;
        let contents = read(path).map_err(unusable)?;
        let is_first = contents.entries.is_empty() && contents.rest == Rest::Nothing;
        let state = before.as_ref().unwrap_or(&contents).state();
        let syncing = Syncing::start(&file).map_err(unusable)?;
        let (path, frame, whole_bytes) =
            (path.to_owned(), Vec::with_capacity(FRAME_BYTES_MAX), contents.whole_bytes as u64);
        let mut journal = Self { path, file, whole_bytes, limit_bytes, frame, state, syncing };
        let found = match contents.rest {
            Rest::Damage => {
                let damaged = aside(&journal.path, &format!("damaged-{}", std::process::id()));
                journal.begin_anew(&damaged).map_err(|source| OpenError::Io { path: journal.path.clone(), source })?;
                Found::Damaged(damaged)
            }
            Rest::Cut | Rest::Nothing => {
                let cut = journal.truncate().map_err(|source| OpenError::Io { path: journal.path.clone(), source })?;
                if before.is_none() && is_first {
                    Found::Nothing
                } else if cut > 0 {
                    Found::Cut(cut)
                } else {
                    Found::Whole
                }
            }
        };
        Ok((journal, found))
    }

    /// What follows from all that is written.
    #[must_use]
    pub fn state(&self) -> &State {
        &self.state
    }

    /// Writes an entry. When this returns, it survives the death of this process; a power cut it survives only after
    /// the sync that [`Journal::sync_soon`] asks for.
    ///
    /// # Errors
    /// [`AppendError`] if it could not be written; nothing of it is left then.
    pub fn append(&mut self, entry: &Entry) -> Result<(), AppendError> {
        if let Some(reason) = self.syncing.failure() {
            return Err(AppendError::Sync { path: self.path.clone(), reason });
        }
        self.frame.clear();
        encode(entry, &mut self.frame);
        match self.file.write_all(&self.frame) {
            Ok(()) => {
                self.whole_bytes += self.frame.len() as u64;
                self.state = self.state.after(&entry.record);
                Ok(())
            }
            Err(source) => {
                // A part may have been written. If it cannot be removed now, the next opening does.
                let _part = self.truncate();
                Err(AppendError::Write { path: self.path.clone(), source })
            }
        }
    }

    /// Asks for everything written so far to reach the disk, and does not wait for it.
    pub fn sync_soon(&self) {
        self.syncing.ask();
    }

    /// Puts the file aside if it has grown beyond its limit, and goes on in a new one. Takes milliseconds: never while
    /// a box waits.
    ///
    /// # Errors
    /// [`AppendError`] if there is no room for a new one; the old one is used further.
    pub fn make_room(&mut self) -> Result<(), AppendError> {
        if self.whole_bytes < self.limit_bytes {
            return Ok(());
        }
        let previous = aside(&self.path, "previous");
        self.begin_anew(&previous).map_err(|source| AppendError::Write { path: self.path.clone(), source })
    }

    /// Moves the file to `aside` and goes on in a new one that begins with the present state.
    fn begin_anew(&mut self, old: &Path) -> io::Result<()> {
        let unfinished = aside(&self.path, "new");
        let mut file = create(&unfinished, true)?;
        let mut bytes = HEADER.to_vec();
        encode(&Entry { unix_ms: 0, record: Record::Carried(self.state) }, &mut bytes);
        file.write_all(&bytes)?;
        file.sync_all()?;
        rustix::fs::flock(&file, FlockOperation::NonBlockingLockExclusive)?;
        fs::rename(&self.path, old)?;
        fs::rename(&unfinished, &self.path)?;
        self.syncing = Syncing::start(&file)?;
        (self.file, self.whole_bytes) = (file, bytes.len() as u64);
        Ok(())
    }

    /// Removes everything behind the last whole entry and begins the file if it has no header; how many bytes went.
    fn truncate(&mut self) -> io::Result<u64> {
        let length = self.file.metadata()?.len();
        self.file.set_len(self.whole_bytes)?;
        self.file.seek(SeekFrom::Start(self.whole_bytes))?;
        let removed = length.saturating_sub(self.whole_bytes);
        if self.whole_bytes == 0 {
            let mut bytes = HEADER.to_vec();
            if self.state != State::default() {
                encode(&Entry { unix_ms: 0, record: Record::Carried(self.state) }, &mut bytes);
            }
            self.file.write_all(&bytes)?;
            self.whole_bytes = bytes.len() as u64;
        }
        Ok(removed)
    }
}

fn create(path: &Path, truncate: bool) -> io::Result<File> {
    OpenOptions::new().read(true).write(true).create(true).truncate(truncate).mode(0o640).open(path)
}

fn aside(path: &Path, what: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".");
    name.push(what);
    name.into()
}

/// A thread that brings the file to the disk. However often it is asked while it works, it does so once more.
#[derive(Debug)]
struct Syncing {
    asked: Option<SyncSender<()>>,
    failure: Arc<Mutex<Option<String>>>,
    thread: Option<JoinHandle<()>>,
}

impl Syncing {
    fn start(file: &File) -> io::Result<Self> {
        let file = file.try_clone()?;
        let (asked, requests) = mpsc::sync_channel(1);
        let failure = Arc::new(Mutex::new(None));
        let failed = Arc::clone(&failure);
        let sync = move || {
            while requests.recv().is_ok() {
                if let Err(error) = file.sync_data() {
                    *failed.lock().unwrap_or_else(PoisonError::into_inner) = Some(error.to_string());
                }
            }
        };
        let thread = thread::Builder::new().name("journal-sync".to_owned()).spawn(sync)?;
        Ok(Self { asked: Some(asked), failure, thread: Some(thread) })
    }

    fn ask(&self) {
        if let Some(asked) = &self.asked {
            let _asked_already = asked.try_send(());
        }
    }

    /// Why a sync failed. It stays failed: nobody knows what the disk has, until somebody looks and starts anew.
    fn failure(&self) -> Option<String> {
        self.failure.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl Drop for Syncing {
    fn drop(&mut self) {
        self.ask();
        self.asked = None;
        if let Some(thread) = self.thread.take() {
            let _it_cannot_panic = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use messages::MotionOutcome;

    use super::*;
    use crate::Outcome;
    use crate::record::intent;

    const LIMIT: u64 = 1 << 20;

    fn entry(record: Record) -> Entry {
        Entry { unix_ms: 5, record }
    }

    /// A journal with one order that is over and one that is open.
    fn write(path: &Path) -> State {
        let (mut journal, found) = Journal::open(path, LIMIT).unwrap();
        assert_eq!(found, Found::Nothing);
        let outcome = Outcome { order: 1, outcome: MotionOutcome::Done };
        for record in [Record::Intent(intent(1)), Record::Outcome(outcome), Record::Intent(intent(2))] {
            journal.append(&entry(record)).unwrap();
            journal.sync_soon();
        }
        *journal.state()
    }

    #[test]
    fn a_journal_is_found_again_as_it_was_left() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("state/journal.bin");
        let state = write(&path);
        let (journal, found) = Journal::open(&path, LIMIT).unwrap();
        assert_eq!((found, *journal.state()), (Found::Whole, state));
        assert_eq!(journal.state().open(), Some(&intent(2)));
        assert_eq!(read(&path).unwrap().entries.len(), 3);
    }

    #[test]
    fn a_journal_that_was_cut_at_any_byte_goes_on_from_its_last_whole_entry() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("journal.bin");
        write(&path);
        let bytes = fs::read(&path).unwrap();
        for length in 0..bytes.len() {
            fs::write(&path, &bytes[..length]).unwrap();
            let whole = decode(&bytes[..length]).entries;
            let (mut journal, _) = Journal::open(&path, LIMIT).unwrap();
            journal.append(&entry(Record::Active(1))).unwrap();
            drop(journal);
            let contents = read(&path).unwrap();
            assert_eq!(contents.rest, Rest::Nothing, "cut at {length}");
            assert_eq!(contents.entries[..whole.len()], whole);
            assert_eq!(contents.entries.last(), Some(&entry(Record::Active(1))));
        }
    }

    #[test]
    fn a_damaged_journal_is_put_aside_and_its_state_carried_over() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("journal.bin");
        write(&path);
        let mut bytes = fs::read(&path).unwrap();
        let second = HEADER.len() + 8 + bytes[HEADER.len()] as usize;
        bytes[second + 9] ^= 0x40;
        fs::write(&path, &bytes).unwrap();
        let (journal, found) = Journal::open(&path, LIMIT).unwrap();
        let Found::Damaged(aside) = found else { panic!("{found:?}") };
        assert_eq!(fs::read(aside).unwrap(), bytes, "nothing is thrown away");
        assert_eq!(journal.state().open(), Some(&intent(1)));
        drop(journal);
        let (journal, found) = Journal::open(&path, LIMIT).unwrap();
        assert_eq!((found, journal.state().open()), (Found::Whole, Some(&intent(1))));
    }

    #[test]
    fn a_full_journal_makes_room_and_forgets_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("journal.bin");
        let state = write(&path);
        let (mut journal, _) = Journal::open(&path, 10).unwrap();
        journal.make_room().unwrap();
        assert_eq!(*journal.state(), state);
        journal.append(&entry(Record::Active(4))).unwrap();
        drop(journal);
        assert_eq!(read(&dir.path().join("journal.bin.previous")).unwrap().entries.len(), 3);
        let (journal, found) = Journal::open(&path, LIMIT).unwrap();
        assert_eq!((found, journal.state().last, journal.state().active), (Found::Whole, state.last, 4));
        drop(journal);
        // Killed between the two renames: there is a previous journal and no other.
        fs::remove_file(&path).unwrap();
        let (journal, found) = Journal::open(&path, LIMIT).unwrap();
        assert_eq!((found, *journal.state()), (Found::Whole, state));
    }

    #[test]
    fn a_journal_has_one_writer() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("journal.bin");
        let (_journal, _) = Journal::open(&path, LIMIT).unwrap();
        let message = Journal::open(&path, LIMIT).unwrap_err().to_string();
        assert!(message.starts_with("another commander writes the journal"), "{message}");
        let message = Journal::open(Path::new("/proc/none/journal.bin"), LIMIT).unwrap_err().to_string();
        assert!(message.contains("/proc/none") && message.contains("state.dir"), "{message}");
    }

    /// /dev/full takes nothing, as a full disk does.
    #[test]
    fn a_full_disk_is_said_and_nothing_is_half_written() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("journal.bin");
        write(&path);
        let (mut journal, _) = Journal::open(&path, LIMIT).unwrap();
        let before = *journal.state();
        let file = std::mem::replace(&mut journal.file, OpenOptions::new().write(true).open("/dev/full").unwrap());
        let message = journal.append(&entry(Record::Active(7))).unwrap_err().to_string();
        assert!(message.contains("No space left on device"), "{message}");
        assert_eq!(*journal.state(), before);
        journal.file = file;
        journal.truncate().unwrap();
        journal.append(&entry(Record::Active(7))).unwrap();
        assert_eq!(read(&path).unwrap().entries.len(), 4);
    }
}
