//! Data sets of boxes: episode files, and the named sets that are generated.
//!
//! # Files
//!
//! **JSON** (`.json`) holds a whole data set. Every box is `[length, breadth, height]` at yaw 0:
//!
//! ```json
//! {"meta": {"name": "monday", "unit": "cm", "container": [45, 80, 50], "optimum": 10},
//!  "episodes": [[[12, 30.5, 20], [40, 25, 10]], [[30, 30, 30]]]}
//! ```
//!
//! - `unit` is `mm`, `cm` or `cell`. A cell has the size of [`ReadOptions::container`]'s (10 mm unless told otherwise).
//! - `container` is its inner length, breadth and height, in the same unit. Each must be whole grid cells.
//! - `optimum`, the least number of containers that hold an episode, may be left out.
//!
//! **CSV** (`.csv`) holds one box a line, in millimetres; the container is [`ReadOptions::container`]:
//!
//! ```csv
//! episode,l,b,h
//! 0,120,305,200
//! ```
//!
//! Fractions of a millimetre are rounded up. Episodes and boxes are counted from 0, in messages as in memory; a CSV
//! file counts its episodes itself. Whatever else a file holds is refused by one message that says what and where.

mod csv_file;
mod error;
mod json_file;
mod named;
mod set;

use std::fs::File;
use std::io::{BufWriter, Read as _, Write as _};
use std::path::Path;

pub use csv_file::{read_csv, write_csv};
pub use error::{At, BadBox, FileError, Problem};
pub use json_file::{read_json, write_json};
pub use named::{NAMED, Named, UnknownName};
use packing::ContainerSize;
pub use set::{DataSet, Skipped};

/// Largest file that is read [bytes]. Room for the most boxes, written generously.
pub const FILE_BYTES_MAX: u64 = 128 << 20;

/// Most episodes of a set, a thousand times what a published figure needs.
pub const EPISODES_MAX: usize = 100_000;

/// Most boxes of a set, so that a file takes at most about 100 MB of memory.
pub const BOXES_MAX: usize = 2_000_000;

/// What a file does not say itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReadOptions {
    /// The container of a CSV file. Of a JSON file, only the cell size is taken from here.
    pub container: ContainerSize,
    /// Count unusable boxes and empty episodes and go on, instead of refusing the file.
    pub skip_bad: bool,
}

impl Default for ReadOptions {
    fn default() -> Self {
        Self { container: ContainerSize::PAPER, skip_bad: false }
    }
}

/// How a data set is written down.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Json,
    Csv,
}

impl Format {
    fn of(path: &Path) -> Result<Self, Problem> {
        match path.extension().and_then(|ending| ending.to_str()) {
            Some(ending) if ending.eq_ignore_ascii_case("json") => Ok(Self::Json),
            Some(ending) if ending.eq_ignore_ascii_case("csv") => Ok(Self::Csv),
            _ => Err(Problem::Ending),
        }
    }
}

/// Reads the data set in `path`, whose ending says how.
///
/// # Errors
/// [`FileError`] names the file and, as its source, the [`Problem`].
pub fn read(path: &Path, options: &ReadOptions) -> Result<DataSet, FileError> {
    let read = || {
        let format = Format::of(path)?;
        let mut bytes = Vec::new();
        File::open(path)?.take(FILE_BYTES_MAX + 1).read_to_end(&mut bytes)?;
        if bytes.len() as u64 > FILE_BYTES_MAX {
            return Err(Problem::TooManyBytes);
        }
        match format {
            Format::Json => read_json(&bytes, options),
            Format::Csv => {
                let name = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
                read_csv(&bytes, &name, options)
            }
        }
    };
    read().map_err(|problem| FileError { path: path.to_owned(), problem })
}

/// Writes the data set to `path`, whose ending says how. CSV keeps neither the container nor the optimum.
///
/// # Errors
/// [`FileError`] names the file and, as its source, the [`Problem`].
pub fn write(path: &Path, set: &DataSet) -> Result<(), FileError> {
    let write = || {
        let format = Format::of(path)?;
        let mut file = BufWriter::new(File::create(path)?);
        match format {
            Format::Json => write_json(set, &mut file)?,
            Format::Csv => write_csv(set, &mut file)?,
        }
        Ok(file.flush()?)
    };
    write().map_err(|problem| FileError { path: path.to_owned(), problem })
}
