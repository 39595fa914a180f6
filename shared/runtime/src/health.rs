//! A process's word about itself.

use messages::topics::{HEALTH, Role};
use messages::{Counters, Health, Text};

use crate::{Bus, BusError, Publisher, monotonic_ns};

/// How often a process says how it is [ns].
const PERIOD_NS: u64 = 200_000_000;

/// Publishes a process's [`Health`] a few times a second.
#[derive(Debug)]
pub struct Reporter {
    publisher: Publisher<Health>,
    role: Role,
    detail: Text,
    ready_ns: u64,
    due_ns: u64,
}

impl Reporter {
    /// A reporter for this process, which is `detail` in its own words; its first report says it is ready.
    ///
    /// # Errors
    /// [`BusError`] if the topic cannot be joined.
    pub fn new(bus: &Bus, detail: &str) -> Result<Self, BusError> {
        let now = monotonic_ns();
        let publisher = bus.publisher(&HEALTH)?;
        Ok(Self { publisher, role: bus.role(), detail: Text::new(detail), ready_ns: now, due_ns: 0 })
    }

    /// Publishes a report if one is due.
    ///
    /// # Errors
    /// [`BusError`] if the bus failed.
    pub fn report_if_due(&mut self, counters: Counters, refusal: &Text) -> Result<(), BusError> {
        let now = monotonic_ns();
        if now < self.due_ns {
            return Ok(());
        }
        self.due_ns = now + PERIOD_NS;
        self.publisher.publish(0, |health| {
            (health.role, health.pid) = (self.role.to_wire(), std::process::id());
            (health.ready_ns, health.counters) = (self.ready_ns, counters);
            (health.detail, health.refusal) = (self.detail, *refusal);
        })?;
        Ok(())
    }
}
