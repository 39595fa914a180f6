//! `packcell/decisions`: which candidate a scorer would take.

use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;

use crate::Header;
use crate::header::impl_message;

/// One scorer's answer to one candidate set. All instances answer; the commander obeys one.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable, ZeroCopySend)]
#[type_name("packcell/Decision/v1")]
#[repr(C)]
pub struct Decision {
    /// See [`Header`].
    pub header: Header,
    /// When the scorer received the set [ns, CLOCK_MONOTONIC].
    pub received_ns: u64,
    /// The box of the set.
    pub box_id: u64,
    /// The revision of the set.
    pub revision: u64,
    /// The digest of the set.
    pub set_digest: u64,
    /// First 8 bytes of the model's SHA-256; 0 for a policy without a model.
    pub model: u64,
    /// The scorer's instance: 0 is `a`, 1 is `b`, and so on.
    pub instance: u32,
    /// Index of the best candidate in the set.
    pub best: u32,
    /// What the policy thinks it worth, finite; comparable only between decisions of one model.
    pub value: f32,
    /// Boxes the choice was planned for, the current one included.
    pub depth: u32,
}

const _: () = assert!(size_of::<Decision>() == 32 + 40 + 16);

impl_message!(Decision);
