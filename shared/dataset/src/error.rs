//! What can be wrong with a data set.

use std::fmt;
use std::io;
use std::path::PathBuf;

use packing::{ContainerSize, Extent, SizeError};

use crate::{BOXES_MAX, EPISODES_MAX, FILE_BYTES_MAX};

/// A data file that cannot be used, and why.
#[derive(Debug, thiserror::Error)]
#[error("data file {}", path.display())]
pub struct FileError {
    /// The file.
    pub path: PathBuf,
    /// What is wrong with it.
    #[source]
    pub problem: Problem,
}

/// What is wrong with a data set.
#[derive(Debug, thiserror::Error)]
pub enum Problem {
    /// The operating system refused.
    #[error("it cannot be read or written")]
    Io(#[from] io::Error),
    /// The name does not say how to read it.
    #[error("its name must end in .json or .csv")]
    Ending,
    /// Beyond [`FILE_BYTES_MAX`].
    #[error("it is larger than {} MiB: split it", FILE_BYTES_MAX >> 20)]
    TooManyBytes,
    /// Beyond [`EPISODES_MAX`].
    #[error("it has more than {EPISODES_MAX} episodes: split it")]
    TooManyEpisodes,
    /// Beyond [`BOXES_MAX`].
    #[error("it has more than {BOXES_MAX} boxes: split it")]
    TooManyBoxes,
    /// No JSON, or JSON of another shape.
    #[error("it is not an episode file, as seen {0}")]
    Json(At, #[source] serde_json::Error),
    /// CSV without the header that says what its columns are.
    #[error("its first line is {found:?} and must be \"episode,l,b,h\"")]
    Columns {
        /// The line as read.
        found: String,
    },
    /// CSV that cannot be split into fields.
    #[error("it is not a CSV file")]
    Csv(#[source] csv::Error),
    /// A container side that is no length in whole cells.
    #[error(
        "its container is {0:?} mm: every side must be a whole number of cells of {1} mm (another cell size may fit)"
    )]
    ContainerSide([f64; 3], u32),
    /// A container that cannot be.
    #[error("its container cannot be")]
    Container(#[source] SizeError),
    /// A box that cannot be used.
    #[error("{0}")]
    Box(At, #[source] BadBox),
    /// An episode without a box.
    #[error("{0}: there is no box in it")]
    EmptyEpisode(At),
    /// Nothing to pack.
    #[error("it has no usable episode")]
    NoEpisode,
}

/// A place in a data set. Episodes and boxes are counted from 0, lines from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct At {
    /// The episode, where one had begun.
    pub episode: Option<u64>,
    /// The box, where one had begun.
    pub index: Option<u64>,
    /// The line, where the format has one a box.
    pub line: Option<u64>,
}

impl fmt::Display for At {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.episode {
            Some(episode) => write!(f, "in episode {episode}")?,
            None => f.write_str("before its episodes")?,
        }
        self.index.map_or(Ok(()), |index| write!(f, ", box {index}"))?;
        self.line.map_or(Ok(()), |line| write!(f, " (line {line})"))
    }
}

/// Why a box cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BadBox {
    /// Not three sides.
    #[error("a box has 3 sides and this one {0}")]
    Sides(usize),
    /// A side that is text, nothing, NaN or endless.
    #[error("its {} is not a number", side_name(*side))]
    NotANumber {
        /// Which of the three.
        side: usize,
    },
    /// A side that no box can have.
    #[error("its {} is {millimetres} mm: it must be more than 0 and at most {} mm", side_name(*side), packing::BOX_SIDE_MM_MAX)]
    Length {
        /// Which of the three.
        side: usize,
        /// In millimetres.
        millimetres: f64,
    },
    /// Larger than the container at every yaw.
    #[error(
        "its {} x {} x {} cells fit no container of {container}",
        extent.length, extent.breadth, extent.height
    )]
    FitsNoContainer {
        /// The box in cells.
        extent: Extent,
        /// The container.
        container: ContainerSize,
    },
    /// A CSV line without a whole number of an episode.
    #[error("the episode is {0:?} and must be a whole number")]
    EpisodeNumber(String),
    /// A CSV line of an episode that was over.
    #[error("episode {0} had ended: the lines of an episode must stand together, in rising order")]
    EpisodeOver(u64),
}

fn side_name(side: usize) -> &'static str {
    ["length", "breadth", "height"].get(side).copied().unwrap_or("side")
}
