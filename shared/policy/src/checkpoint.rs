//! Unfinished training as a file: sealed, so that a checkpoint cut short or damaged is never continued from.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde::de::DeserializeOwned;
use sha2::{Digest as _, Sha256};

use crate::model::write_atomically;

/// First bytes of every checkpoint; the number is the version of all state that training keeps.
const MAGIC: &[u8] = b"packcell checkpoint 1\n";

/// Largest checkpoint that is read: a full replay buffer takes about 25 MB.
const CHECKPOINT_BYTES_MAX: usize = 1 << 30;

const DIGEST_BYTES: usize = 32;

/// A checkpoint that cannot be saved or continued from.
#[derive(Debug, thiserror::Error)]
#[error("checkpoint {}", path.display())]
pub struct CheckpointError {
    /// The file.
    pub path: PathBuf,
    /// What is wrong with it.
    #[source]
    pub fault: CheckpointFault,
}

/// What is wrong with a checkpoint.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointFault {
    /// It cannot be read.
    #[error("cannot be read")]
    Read(#[source] io::Error),
    /// It cannot be written.
    #[error("cannot be written: the checkpoint before it is unchanged, make room and train again to continue from it")]
    Write(#[source] io::Error),
    /// It is not this build's.
    #[error("is no checkpoint of this build: remove it to start again")]
    Foreign,
    /// Its digest is not that of its content.
    #[error("is damaged or cut short: remove it to start again")]
    Damaged,
    /// It belongs to another kind of training.
    #[error("does not hold the state of this training ({0}): remove it to start again")]
    State(String),
}

/// Writes the state of a training: whoever reads `path` finds the checkpoint before or the whole new one.
///
/// # Errors
/// [`CheckpointError`] with the reason.
pub fn save_checkpoint<T: Serialize>(path: &Path, state: &T) -> Result<(), CheckpointError> {
    let at = |fault| CheckpointError { path: path.to_owned(), fault };
    let state = bincode::serde::encode_to_vec(state, bincode::config::legacy())
        .map_err(|error| at(CheckpointFault::State(error.to_string())))?;
    let bytes = [MAGIC, Sha256::digest(&state).as_slice(), &state].concat();
    write_atomically(path, &bytes).map_err(|error| at(CheckpointFault::Write(error)))
}

/// Reads the state of a training.
///
/// # Errors
/// [`CheckpointError`] says what is wrong and what to do.
pub fn load_checkpoint<T: DeserializeOwned>(path: &Path) -> Result<T, CheckpointError> {
    let at = |fault| CheckpointError { path: path.to_owned(), fault };
    let bytes = fs::read(path).map_err(|error| at(CheckpointFault::Read(error)))?;
    open(&bytes).map_err(at)
}

fn open<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, CheckpointFault> {
    let sealed = bytes.strip_prefix(MAGIC).ok_or(CheckpointFault::Foreign)?;
    let (digest, state) = sealed.split_at_checked(DIGEST_BYTES).ok_or(CheckpointFault::Damaged)?;
    if Sha256::digest(state).as_slice() != digest {
        return Err(CheckpointFault::Damaged);
    }
    let limited = bincode::config::legacy().with_limit::<CHECKPOINT_BYTES_MAX>();
    let decoded: Result<(T, usize), _> = bincode::serde::decode_from_slice(state, limited);
    match decoded {
        Ok((value, read)) if read == state.len() => Ok(value),
        Ok((_, read)) => Err(CheckpointFault::State(format!("{} bytes too many", state.len() - read))),
        Err(error) => Err(CheckpointFault::State(error.to_string())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_saved_is_loaded_and_what_is_damaged_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("training.checkpoint");
        let state = (7u64, vec![1.5f32, -0.25], "recipe".to_owned());
        save_checkpoint(&path, &state).unwrap();
        assert_eq!(load_checkpoint::<(u64, Vec<f32>, String)>(&path).unwrap(), state);
        let mut bytes = fs::read(&path).unwrap();
        for length in 0..bytes.len() {
            assert!(open::<(u64, Vec<f32>, String)>(&bytes[..length]).is_err(), "{length} bytes");
        }
        for byte in 0..bytes.len() {
            bytes[byte] ^= 4;
            assert!(open::<(u64, Vec<f32>, String)>(&bytes).is_err(), "byte {byte}");
            bytes[byte] ^= 4;
        }
        assert!(matches!(open::<(u64, u64)>(&bytes), Err(CheckpointFault::State(_))));
        let error = load_checkpoint::<u64>(Path::new("/nowhere/x")).unwrap_err();
        assert_eq!(error.to_string(), "checkpoint /nowhere/x");
    }
}
