//! `packcell/commands` and `packcell/motions`: what the arm is told to do, and what it then did.

use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;
use packing::{Placement, Yaw};
use serde::{Deserialize, Serialize};

use crate::header::impl_message;
use crate::{Header, Malformed, WireBox};

/// What the arm is told to do with one box. Said again until the arm reports the motion; a box is moved once.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable, ZeroCopySend)]
#[type_name("packcell/PlaceCommand/v2")]
#[repr(C)]
pub struct PlaceCommand {
    /// See [`Header`].
    pub header: Header,
    /// Counts the commander's orders over its whole life, restarts included. A command that is said again has the
    /// number it had.
    pub order: u64,
    /// The box.
    pub spec: WireBox,
    /// The revision of the belief on which it was decided; void on any other.
    pub revision: u64,
    /// An [`Action`].
    pub action: u32,
    /// Where the box goes, if it is placed; the slot whose container leaves, if one is replaced.
    pub placement: WirePlacement,
}

/// What the arm did with one box.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable, ZeroCopySend)]
#[type_name("packcell/MotionReport/v2")]
#[repr(C)]
pub struct MotionReport {
    /// See [`Header`].
    pub header: Header,
    /// The order that was commanded.
    pub order: u64,
    /// The box.
    pub box_id: u64,
    /// The revision for which the motion was commanded.
    pub revision: u64,
    /// The [`Action`] that was commanded.
    pub action: u32,
    /// A [`MotionOutcome`].
    pub outcome: u32,
}

/// A [`Placement`] on the wire.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable, ZeroCopySend, Serialize, Deserialize)]
#[type_name("packcell/WirePlacement/v1")]
#[repr(C)]
pub struct WirePlacement {
    /// The slot.
    pub slot: u16,
    /// 0 as on the belt, 1 turned by 90 degrees.
    pub yaw: u16,
    /// First cell along the container's length.
    pub i: u16,
    /// First cell along the container's breadth.
    pub j: u16,
    /// Height of the base [cells].
    pub base: u16,
    /// Zero.
    pub reserved: u16,
}

/// What the arm is told to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Action {
    /// Put the box where the placement says.
    Place,
    /// Put the box on the reject lane: it fits nowhere.
    SetAside,
    /// Take a container away and bring an empty one; the box stays on the belt.
    Replace,
}

/// How a motion ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum MotionOutcome {
    /// As commanded.
    Done,
    /// Not begun: the command did not fit the present state. The box is where it was.
    Refused,
    /// Nobody knows: the arm never said, and the belt or the belief has moved on. No arm reports this; it is what the
    /// commander writes down.
    Unreported,
}

const _: () = assert!(size_of::<WirePlacement>() == 12);
const _: () = assert!(size_of::<PlaceCommand>() == 32 + 8 + 24 + 8 + 4 + 12);
const _: () = assert!(size_of::<MotionReport>() == 32 + 8 + 16 + 8);

impl_message!(PlaceCommand, MotionReport);

impl Action {
    /// The number that stands for it on the wire.
    #[must_use]
    pub fn to_wire(self) -> u32 {
        match self {
            Self::Place => 0,
            Self::SetAside => 1,
            Self::Replace => 2,
        }
    }

    /// The action that the number stands for.
    ///
    /// # Errors
    /// [`Malformed::Unknown`] for a number that stands for nothing.
    pub fn from_wire(value: u32) -> Result<Self, Malformed> {
        match value {
            0 => Ok(Self::Place),
            1 => Ok(Self::SetAside),
            2 => Ok(Self::Replace),
            _ => Err(Malformed::Unknown { field: "action", value }),
        }
    }
}

impl MotionOutcome {
    /// The number that stands for it on the wire.
    #[must_use]
    pub fn to_wire(self) -> u32 {
        match self {
            Self::Done => 0,
            Self::Refused => 1,
            Self::Unreported => 2,
        }
    }

    /// The outcome that the number stands for.
    ///
    /// # Errors
    /// [`Malformed::Unknown`] for a number that stands for nothing.
    pub fn from_wire(value: u32) -> Result<Self, Malformed> {
        match value {
            0 => Ok(Self::Done),
            1 => Ok(Self::Refused),
            2 => Ok(Self::Unreported),
            _ => Err(Malformed::Unknown { field: "outcome", value }),
        }
    }
}

impl From<Placement> for WirePlacement {
    fn from(placement: Placement) -> Self {
        let Placement { slot, yaw, i, j, base } = placement;
        let yaw = match yaw {
            Yaw::Deg0 => 0,
            Yaw::Deg90 => 1,
        };
        Self { slot, yaw, i, j, base, reserved: 0 }
    }
}

impl TryFrom<WirePlacement> for Placement {
    type Error = Malformed;

    fn try_from(wire: WirePlacement) -> Result<Self, Malformed> {
        let WirePlacement { slot, yaw, i, j, base, .. } = wire;
        let yaw = match yaw {
            0 => Yaw::Deg0,
            1 => Yaw::Deg90,
            _ => return Err(Malformed::Unknown { field: "yaw", value: yaw.into() }),
        };
        Ok(Self { slot, yaw, i, j, base })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn placements_cross_the_wire_unchanged() {
        for yaw in [Yaw::Deg0, Yaw::Deg90] {
            let placement = Placement { slot: 1, yaw, i: 2, j: 3, base: 4 };
            assert_eq!(Placement::try_from(WirePlacement::from(placement)), Ok(placement));
        }
        let askew = WirePlacement { yaw: 2, ..WirePlacement::default() };
        assert_eq!(Placement::try_from(askew), Err(Malformed::Unknown { field: "yaw", value: 2 }));
    }

    #[test]
    fn actions_and_outcomes_cross_the_wire_unchanged() {
        for action in [Action::Place, Action::SetAside, Action::Replace] {
            assert_eq!(Action::from_wire(action.to_wire()), Ok(action));
        }
        for outcome in [MotionOutcome::Done, MotionOutcome::Refused, MotionOutcome::Unreported] {
            assert_eq!(MotionOutcome::from_wire(outcome.to_wire()), Ok(outcome));
        }
        assert!(Action::from_wire(3).is_err() && MotionOutcome::from_wire(3).is_err());
    }
}
