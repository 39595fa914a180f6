//! What every message begins with.

use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;

/// Who says it, when, and in answer to what.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable, ZeroCopySend)]
#[repr(C)]
pub struct Header {
    /// The process that published it, unique over the life of a bus: a restarted process is another one.
    pub publisher: u64,
    /// Counts the publisher's messages on this topic from 1; a gap is a lost message.
    pub sequence: u64,
    /// When it was published [ns, CLOCK_MONOTONIC].
    pub stamp_ns: u64,
    /// When the observation that it answers was made [ns, CLOCK_MONOTONIC]; 0 if it answers none.
    pub observed_ns: u64,
}

const _: () = assert!(size_of::<Header>() == 32);

/// Plain data that begins with a [`Header`] and may be built in place in shared memory.
pub trait Message: Pod + ZeroCopySend + std::fmt::Debug {
    /// The message's header.
    fn header(&self) -> &Header;
    /// The message's header, for the bus to fill in.
    fn header_mut(&mut self) -> &mut Header;
}

/// Implements [`Message`] for a struct whose first field is its header.
macro_rules! impl_message {
    ($($message:ty),+) => {$(
        impl $crate::Message for $message {
            fn header(&self) -> &$crate::Header {
                &self.header
            }

            fn header_mut(&mut self) -> &mut $crate::Header {
                &mut self.header
            }
        }
    )+};
}
pub(crate) use impl_message;
