//! `packcell/health`: what every process is doing, a few times a second.

use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;

use crate::header::impl_message;
use crate::topics::Role;
use crate::{Header, Malformed, Text};

/// One process's word about itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable, ZeroCopySend)]
#[type_name("packcell/Health/v2")]
#[repr(C)]
pub struct Health {
    /// See [`Header`].
    pub header: Header,
    /// The process's [`Role`].
    pub role: u32,
    /// Its process id.
    pub pid: u32,
    /// A scorer's instance: 0 is `a`. [`NO_INSTANCE`] for every other role.
    pub instance: u32,
    /// Zero.
    pub reserved: u32,
    /// When it was ready [ns, CLOCK_MONOTONIC].
    pub ready_ns: u64,
    /// What it did so far.
    pub counters: Counters,
    /// What it is, in its own words, such as the policy and model of a scorer.
    pub detail: Text,
    /// Why it refused a message last; empty if it never did.
    pub refusal: Text,
    /// What keeps it from doing its work right now; empty if nothing does.
    pub alarm: Text,
}

/// What stands in [`Health::instance`] of a process that is no scorer.
pub const NO_INSTANCE: u32 = u32::MAX;

/// What a process did since it started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable, ZeroCopySend)]
#[type_name("packcell/Counters/v1")]
#[repr(C)]
pub struct Counters {
    /// Boxes it did its part for.
    pub handled: u64,
    /// Messages it refused because no correct process sends them.
    pub refused: u64,
    /// Messages it dropped because the cell had moved on.
    pub stale: u64,
    /// The box it handled last.
    pub last_box: u64,
}

const _: () = assert!(size_of::<Health>() == 32 + 24 + 32 + 3 * 48);

impl_message!(Health);

impl Health {
    /// The role of the process.
    ///
    /// # Errors
    /// [`Malformed::Unknown`] for a number that stands for none.
    pub fn role(&self) -> Result<Role, Malformed> {
        Role::from_wire(self.role)
    }
}
