//! `packcell/control` and `packcell/active`: what an operator asks for, and which scorer instance is obeyed.

use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;

use crate::header::impl_message;
use crate::{Header, Malformed};

/// One wish of an operator. Said again until it is answered or the operator gives up; granted once or many times, it
/// comes to the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable, ZeroCopySend)]
#[type_name("packcell/Control/v1")]
#[repr(C)]
pub struct Control {
    /// See [`Header`].
    pub header: Header,
    /// Names the request, so that its answer can be told from those to others.
    pub request: u64,
    /// A [`Wish`].
    pub wish: u32,
    /// The scorer instance it is about: 0 is `a`.
    pub instance: u32,
}

/// Which scorer instance the commander obeys first. Said whenever that changes and in answer to every request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable, ZeroCopySend)]
#[type_name("packcell/Active/v1")]
#[repr(C)]
pub struct Active {
    /// See [`Header`].
    pub header: Header,
    /// The request that was answered last; 0 if there was none.
    pub request: u64,
    /// The instance that is obeyed: 0 is `a`.
    pub instance: u32,
    /// Zero.
    pub reserved: u32,
}

/// What an operator may ask for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wish {
    /// Start the instance and keep it running: to whoever supervises the processes.
    Start,
    /// Obey the instance first from now on: to the commander.
    Promote,
    /// End, and stay ended: to the instance itself, and to whoever supervises the processes.
    Retire,
}

const _: () = assert!(size_of::<Control>() == 32 + 16);
const _: () = assert!(size_of::<Active>() == 32 + 16);

impl_message!(Control, Active);

impl Wish {
    /// The number that stands for it on the wire.
    #[must_use]
    pub fn to_wire(self) -> u32 {
        match self {
            Self::Start => 0,
            Self::Promote => 1,
            Self::Retire => 2,
        }
    }

    /// What the number stands for.
    ///
    /// # Errors
    /// [`Malformed::Unknown`] for a number that stands for nothing.
    pub fn from_wire(value: u32) -> Result<Self, Malformed> {
        match value {
            0 => Ok(Self::Start),
            1 => Ok(Self::Promote),
            2 => Ok(Self::Retire),
            _ => Err(Malformed::Unknown { field: "wish", value }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wishes_cross_the_wire_unchanged() {
        for wish in [Wish::Start, Wish::Promote, Wish::Retire] {
            assert_eq!(Wish::from_wire(wish.to_wire()), Ok(wish));
        }
        assert!(Wish::from_wire(3).is_err());
    }
}
