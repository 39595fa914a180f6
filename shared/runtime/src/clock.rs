//! The one clock of the cell.

use rustix::time::{ClockId, clock_gettime};

/// Milliseconds since 1970, for people who read when something was. Nothing is decided by it.
#[must_use]
pub fn unix_ms() -> u64 {
    let now = clock_gettime(ClockId::Realtime);
    now.tv_sec as u64 * 1000 + now.tv_nsec as u64 / 1_000_000
}

/// Nanoseconds of CLOCK_MONOTONIC, which all processes of one machine share: stamps subtract across processes.
#[must_use]
pub fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}
