//! `packcell/boxes`: what lies on the belt.

use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;
use packing::BoxSpec;
use serde::{Deserialize, Serialize};

use crate::header::impl_message;
use crate::{Header, Malformed};

/// Most upcoming boxes that a queue shows. The paper shows two.
pub const UPCOMING_MAX: usize = 8;

/// The box to place now and the next ones. Published again until its box is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable, ZeroCopySend)]
#[type_name("packcell/BoxQueue/v2")]
#[repr(C)]
pub struct BoxQueue {
    /// See [`Header`]. `observed_ns` is when this box was first seen on this revision, also when it is said again.
    pub header: Header,
    /// The revision of the belief on which the box is to be placed.
    pub revision: u64,
    /// The box at the pick position; meaningless unless `belt` is [`BeltState::BoxPresent`].
    pub current: WireBox,
    /// The boxes behind it, nearest first; those beyond `upcoming_count` mean nothing.
    pub upcoming: [WireBox; UPCOMING_MAX],
    /// How many of `upcoming` are known.
    pub upcoming_count: u32,
    /// A [`BeltState`].
    pub belt: u32,
    /// Boxes taken from the belt since the stream began.
    pub taken: u64,
    /// Episodes completed since the stream began.
    pub episodes: u64,
    /// When the current box was due at the pick position [ns, CLOCK_MONOTONIC]: earlier than its observation if the
    /// cell still had the box before it. 0 if the belt follows no schedule that is known.
    pub due_ns: u64,
}

/// A box as measured on the belt.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable, ZeroCopySend, Serialize, Deserialize)]
#[type_name("packcell/WireBox/v1")]
#[repr(C)]
pub struct WireBox {
    /// Its identity, unique over the life of a cell.
    pub id: u64,
    /// Length, breadth and height at yaw 0 [mm].
    pub size_mm: [u32; 3],
    /// Zero.
    pub reserved: u32,
}

/// What the belt does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BeltState {
    /// No box is at the pick position yet.
    Waiting,
    /// A box is at the pick position.
    BoxPresent,
    /// The arm has the box.
    Taken,
    /// The stream has ended: there will be no more boxes.
    Ended,
}

const _: () = assert!(size_of::<WireBox>() == 24);
const _: () = assert!(size_of::<BoxQueue>() == 32 + 8 + 24 + 8 * 24 + 8 + 24);

impl_message!(BoxQueue);

impl BeltState {
    /// The number that stands for it on the wire.
    #[must_use]
    pub fn to_wire(self) -> u32 {
        match self {
            Self::Waiting => 0,
            Self::BoxPresent => 1,
            Self::Taken => 2,
            Self::Ended => 3,
        }
    }
}

impl From<BoxSpec> for WireBox {
    fn from(spec: BoxSpec) -> Self {
        Self { id: spec.id(), size_mm: spec.size_mm(), reserved: 0 }
    }
}

impl TryFrom<WireBox> for BoxSpec {
    type Error = Malformed;

    fn try_from(wire: WireBox) -> Result<Self, Malformed> {
        Ok(Self::new(wire.id, wire.size_mm)?)
    }
}

impl BoxQueue {
    /// What the belt does.
    ///
    /// # Errors
    /// [`Malformed::Unknown`] for a number that stands for nothing.
    pub fn belt_state(&self) -> Result<BeltState, Malformed> {
        match self.belt {
            0 => Ok(BeltState::Waiting),
            1 => Ok(BeltState::BoxPresent),
            2 => Ok(BeltState::Taken),
            3 => Ok(BeltState::Ended),
            value => Err(Malformed::Unknown { field: "belt", value }),
        }
    }

    /// Writes the boxes behind the current one, as many as there is room for.
    pub fn write_upcoming(&mut self, upcoming: impl IntoIterator<Item = BoxSpec>) {
        self.upcoming = Zeroable::zeroed();
        self.upcoming_count = 0;
        for (wire, spec) in self.upcoming.iter_mut().zip(upcoming) {
            *wire = spec.into();
            self.upcoming_count += 1;
        }
    }
}

/// The known boxes of a queue, checked.
///
/// # Errors
/// [`Malformed`] if there are too many or one has no valid dimensions.
pub(crate) fn check_upcoming(boxes: &[WireBox; UPCOMING_MAX], count: u32) -> Result<&[WireBox], Malformed> {
    let too_many = Malformed::Count { what: "upcoming boxes", count, limit: UPCOMING_MAX };
    let known = boxes.get(..count as usize).ok_or(too_many)?;
    known.iter().try_for_each(|&wire| BoxSpec::try_from(wire).map(drop))?;
    Ok(known)
}

impl BoxQueue {
    /// The boxes behind the current one, nearest first.
    ///
    /// # Errors
    /// [`Malformed`] if there are too many or one has no valid dimensions.
    pub fn known_upcoming(&self) -> Result<&[WireBox], Malformed> {
        check_upcoming(&self.upcoming, self.upcoming_count)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn spec(id: u64) -> BoxSpec {
        BoxSpec::new(id, [100, 200, 300]).unwrap()
    }

    #[test]
    fn a_box_crosses_the_wire_unchanged() {
        assert_eq!(BoxSpec::try_from(WireBox::from(spec(9))), Ok(spec(9)));
        let flat = WireBox { size_mm: [1, 0, 1], ..WireBox::from(spec(9)) };
        assert!(matches!(BoxSpec::try_from(flat), Err(Malformed::Box(_))));
    }

    #[test]
    fn belt_states_cross_the_wire_unchanged() {
        for state in [BeltState::Waiting, BeltState::BoxPresent, BeltState::Taken, BeltState::Ended] {
            let queue = BoxQueue { belt: state.to_wire(), ..Zeroable::zeroed() };
            assert_eq!(queue.belt_state(), Ok(state));
        }
    }

    #[test]
    fn only_eight_upcoming_boxes_are_shown() {
        let mut queue = BoxQueue::zeroed();
        queue.write_upcoming((0..12).map(spec));
        assert_eq!(queue.known_upcoming().unwrap().len(), UPCOMING_MAX);
        queue.write_upcoming((0..2).map(spec));
        assert_eq!(queue.known_upcoming().unwrap(), [spec(0).into(), spec(1).into()]);
        queue.upcoming_count = 9;
        assert!(matches!(queue.known_upcoming(), Err(Malformed::Count { count: 9, .. })));
    }

    proptest! {
        #[test]
        fn no_bytes_make_a_reader_panic(bytes in prop::collection::vec(any::<u8>(), size_of::<BoxQueue>())) {
            let queue: BoxQueue = bytemuck::pod_read_unaligned(&bytes);
            prop_assert!(queue.belt_state().is_ok() == (queue.belt < 4));
            if let Ok(known) = queue.known_upcoming() {
                prop_assert!(known.len() <= UPCOMING_MAX);
            }
        }
    }
}
