//! `packcell/cycles`: one box from observation to motion, for whoever watches.

use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;
use serde::{Deserialize, Serialize};

use crate::header::impl_message;
use crate::{Header, Malformed, WireBox, WirePlacement};

/// What was done with one box, who chose it, and when each stage had it. Published after the motion.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable, ZeroCopySend)]
#[type_name("packcell/CycleReport/v3")]
#[repr(C)]
pub struct CycleReport {
    /// See [`Header`].
    pub header: Header,
    /// The order's number. A report that is said again, as a restarted commander does with its last one, has the
    /// number it had.
    pub order: u64,
    /// The box.
    pub spec: WireBox,
    /// The revision of the belief on which it was decided.
    pub revision: u64,
    /// When each stage had the box.
    pub stamps: Stamps,
    /// First 8 bytes of the SHA-256 of the model that chose; 0 if none did.
    pub model: u64,
    /// The [`Action`](crate::Action) that was commanded.
    pub action: u32,
    /// Where the box went.
    pub placement: WirePlacement,
    /// Identity of the container it went to, or that was replaced.
    pub container: u32,
    /// A [`ChosenBy`].
    pub chosen_by: u32,
    /// A [`Why`].
    pub why: u32,
    /// The scorer's instance that chose; meaningless if none did.
    pub instance: u32,
    /// What that scorer thought the choice worth; 0 if none did.
    pub value: f32,
    /// Boxes that it planned for, the current one included; 0 if none did.
    pub depth: u32,
    /// Candidates of the set.
    pub candidates: u32,
    /// Candidates for which the set had no room.
    pub left_out: u32,
    /// The [`MotionOutcome`](crate::MotionOutcome).
    pub outcome: u32,
    /// Zero.
    pub reserved: u32,
}

/// When each stage had the box [ns, CLOCK_MONOTONIC]; 0 where it had not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable, ZeroCopySend)]
#[type_name("packcell/Stamps/v2")]
#[repr(C)]
pub struct Stamps {
    /// The box was due at the pick position. A box that waited for the cell was due before it could be observed, and
    /// whoever counts from here charges a stall to every box that it delayed.
    pub due_ns: u64,
    /// Perception saw the box on this revision.
    pub observed_ns: u64,
    /// Perception published it.
    pub boxes_published_ns: u64,
    /// The generator woke with it.
    pub candidates_received_ns: u64,
    /// The generator published the set.
    pub candidates_published_ns: u64,
    /// The scorer that was obeyed woke with the set.
    pub scorer_received_ns: u64,
    /// The scorer that was obeyed published its decision.
    pub decision_published_ns: u64,
    /// The commander read that decision.
    pub decision_received_ns: u64,
    /// The commander published the command.
    pub command_published_ns: u64,
    /// The arm reported the motion.
    pub motion_published_ns: u64,
}

/// Who chose what was done.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum ChosenBy {
    /// The active scorer instance.
    Model,
    /// Another instance, after the soft deadline.
    Standby,
    /// WallE's ranking in the candidate set, at the hard deadline.
    Fallback,
    /// Nobody: the set was empty, and the rules say what then.
    Rules,
}

/// Why it was they who chose.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Why {
    /// They are asked first, and answered in time.
    InTime,
    /// Whoever is asked before them had not answered by the deadline.
    Silent,
    /// The active instance had answered, and its answer was refused.
    Refused,
    /// There was nothing to choose from.
    NothingFits,
}

const _: () = assert!(size_of::<Stamps>() == 80);
const _: () = assert!(size_of::<CycleReport>() == 32 + 8 + 24 + 8 + 80 + 8 + 4 + 12 + 10 * 4);

impl_message!(CycleReport);

impl ChosenBy {
    /// The number that stands for it on the wire.
    #[must_use]
    pub fn to_wire(self) -> u32 {
        match self {
            Self::Model => 0,
            Self::Standby => 1,
            Self::Fallback => 2,
            Self::Rules => 3,
        }
    }

    /// Who the number stands for.
    ///
    /// # Errors
    /// [`Malformed::Unknown`] for a number that stands for nobody.
    pub fn from_wire(value: u32) -> Result<Self, Malformed> {
        match value {
            0 => Ok(Self::Model),
            1 => Ok(Self::Standby),
            2 => Ok(Self::Fallback),
            3 => Ok(Self::Rules),
            _ => Err(Malformed::Unknown { field: "chosen_by", value }),
        }
    }
}

impl Why {
    /// The number that stands for it on the wire.
    #[must_use]
    pub fn to_wire(self) -> u32 {
        match self {
            Self::InTime => 0,
            Self::Silent => 1,
            Self::Refused => 2,
            Self::NothingFits => 3,
        }
    }

    /// What the number stands for.
    ///
    /// # Errors
    /// [`Malformed::Unknown`] for a number that stands for nothing.
    pub fn from_wire(value: u32) -> Result<Self, Malformed> {
        match value {
            0 => Ok(Self::InTime),
            1 => Ok(Self::Silent),
            2 => Ok(Self::Refused),
            3 => Ok(Self::NothingFits),
            _ => Err(Malformed::Unknown { field: "why", value }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn choosers_and_reasons_cross_the_wire_unchanged() {
        for by in [ChosenBy::Model, ChosenBy::Standby, ChosenBy::Fallback, ChosenBy::Rules] {
            assert_eq!(ChosenBy::from_wire(by.to_wire()), Ok(by));
        }
        for why in [Why::InTime, Why::Silent, Why::Refused, Why::NothingFits] {
            assert_eq!(Why::from_wire(why.to_wire()), Ok(why));
        }
        assert!(ChosenBy::from_wire(4).is_err() && Why::from_wire(4).is_err());
    }
}
