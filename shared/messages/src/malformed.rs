//! What no correct process sends.

use packing::{BoxError, SizeError};

/// Why a message was refused: it breaks a documented range. The reader counts, logs and drops it.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Malformed {
    /// The grid's size is none.
    #[error("the grid has no valid size")]
    Size(#[from] SizeError),
    /// A box's dimensions are none.
    #[error("the box has no valid dimensions")]
    Box(#[from] BoxError),
    /// A count exceeds its array.
    #[error("{what}: {count} exceeds the limit of {limit}")]
    Count {
        /// What is counted.
        what: &'static str,
        /// As received.
        count: u32,
        /// What the message has room for.
        limit: usize,
    },
    /// A field holds a number that stands for nothing.
    #[error("{field} is {value}, which stands for nothing")]
    Unknown {
        /// The field's name.
        field: &'static str,
        /// As received.
        value: u32,
    },
    /// A score is not a number.
    #[error("candidate {index} has a score that is not finite")]
    Score {
        /// Position in the set.
        index: usize,
    },
    /// The candidates do not add up to the digest beside them.
    #[error("the candidates do not match their digest")]
    Digest,
}
