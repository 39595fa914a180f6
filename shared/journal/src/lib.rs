//! The commander's memory: what it was about to command, and what became of it.
//!
//! An [`Intent`] is written before its command, an [`Outcome`] after its motion. Whoever starts with the journal of a
//! commander that died knows by [`State`] which order is open, and which scorer instance is obeyed. The file only
//! grows at its end ([`Journal::append`]); what a crash or a power cut leaves there is told from what was written
//! whole by a length and a checksum before every record ([`decode`]).

mod file;
mod follow;
mod frame;
mod record;

pub use file::{AppendError, Found, Journal, OpenError, read};
pub use follow::Follower;
pub use frame::{Contents, HEADER, Rest, decode, encode};
pub use record::{Entry, Intent, Outcome, Record, State};
