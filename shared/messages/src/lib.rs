//! What the processes of a packing cell say to each other over shared memory.
//!
//! Every message is plain data ([`Message`]): fixed size, no pointer, no padding, valid for every bit pattern, and
//! its layout is asserted at compile time. The wire may hold anything; the types of `packing` hold only what is
//! valid. Between them stands one checked door per message, which returns [`Malformed`] and never panics.
//!
//! [`topics`] is the table of everything that crosses a process border.
//!
//! A change of a layout is a new version in its `type_name`, and processes of different versions then refuse to
//! connect; a change of meaning is a new field name.

mod belief;
mod box_queue;
mod candidate_set;
mod command;
mod control;
mod cycle;
mod decision;
mod header;
mod health;
mod instance;
mod malformed;
mod text;
pub mod topics;

pub use belief::{Belief, GridCopy, SlotState};
pub use box_queue::{BeltState, BoxQueue, UPCOMING_MAX, WireBox};
pub use candidate_set::{CANDIDATES_MAX, CandidateSet, WireCandidate};
pub use command::{Action, MotionOutcome, MotionReport, PlaceCommand, WirePlacement};
pub use control::{Active, Control, Wish};
pub use cycle::{ChosenBy, CycleReport, Stamps, Why};
pub use decision::Decision;
pub use header::{Header, Message};
pub use health::{Counters, Health, NO_INSTANCE};
pub use instance::{Instance, UnknownInstance};
pub use malformed::Malformed;
pub use text::Text;
