//! A process's word about itself.

use std::fmt::Display;

use messages::topics::{HEALTH, Role};
use messages::{Counters, Health, NO_INSTANCE, Text};

use crate::supervision::Supervision;
use crate::{Bus, BusError, Publisher, monotonic_ns};

/// How often a process says how it is [ns].
const PERIOD_NS: u64 = 200_000_000;

/// What a process did so far, and why it refused a message last.
#[derive(Clone, Debug)]
pub struct Tally {
    /// What it did so far.
    pub counters: Counters,
    refusal: Text,
    alarm: Text,
}

impl Default for Tally {
    fn default() -> Self {
        Self { counters: Counters::default(), refusal: Text::new(""), alarm: Text::new("") }
    }
}

impl Tally {
    /// Counts a box that this process did its part for.
    pub fn handle(&mut self, box_id: u64) {
        self.counters.handled += 1;
        self.counters.last_box = box_id;
    }

    /// Counts a message that no correct process sends. The log has a line whenever the reason changes, so that a
    /// flood of rubbish does not become a flood of lines.
    pub fn refuse(&mut self, reason: &dyn Display) {
        self.counters.refused += 1;
        let refusal = Text::new(&reason.to_string());
        if refusal != self.refusal {
            tracing::warn!("refused a message: {reason} ({} refused so far)", self.counters.refused);
            self.refusal = refusal;
        }
    }

    /// Something keeps the process from its work. Said in the log once, and in every word about itself until it is
    /// cleared.
    pub fn raise(&mut self, alarm: &dyn Display) {
        let text = Text::new(&alarm.to_string());
        if text != self.alarm {
            tracing::error!(%alarm, "alarm");
            self.alarm = text;
        }
    }

    /// What keeps the process from its work; empty if nothing does.
    #[must_use]
    pub fn alarm(&self) -> &str {
        self.alarm.as_str()
    }

    /// The process can do its work.
    pub fn clear_alarm(&mut self) {
        if self.alarm != Text::default() {
            tracing::info!(alarm = self.alarm.as_str(), "alarm is over");
            self.alarm = Text::default();
        }
    }

    /// Why a message was refused last; empty if none was.
    pub(crate) fn refusal(&self) -> &str {
        self.refusal.as_str()
    }

    /// Counts a message on which the cell has moved on.
    pub fn pass_over(&mut self) {
        self.counters.stale += 1;
    }
}

/// Publishes a process's [`Health`] a few times a second, and tells systemd that its loop works.
#[derive(Debug)]
pub struct Reporter {
    publisher: Publisher<Health>,
    role: Role,
    detail: Text,
    instance: u32,
    ready_ns: u64,
    due_ns: u64,
    supervision: Supervision,
}

impl Reporter {
    /// A reporter for this process, which is `detail` in its own words; its first report says it is ready.
    ///
    /// # Errors
    /// [`BusError`] if the topic cannot be joined.
    pub fn new(bus: &Bus, detail: &str) -> Result<Self, BusError> {
        let (publisher, now) = (bus.publisher(&HEALTH)?, monotonic_ns());
        let (role, detail, supervision) = (bus.role(), Text::new(detail), Supervision::default());
        Ok(Self { publisher, role, detail, instance: NO_INSTANCE, ready_ns: now, due_ns: 0, supervision })
    }

    /// The same reporter, for the scorer instance of this number.
    #[must_use]
    pub fn of_instance(self, instance: u32) -> Self {
        Self { instance, ..self }
    }

    /// Publishes a report if one is due. To be called in every pass of the process's loop, and nowhere else: it is
    /// what tells a process that works from one that hangs.
    ///
    /// # Errors
    /// [`BusError`] if the bus failed.
    pub fn report_if_due(&mut self, tally: &Tally) -> Result<(), BusError> {
        let now = monotonic_ns();
        if now < self.due_ns {
            return Ok(());
        }
        self.due_ns = now + PERIOD_NS;
        self.publisher.publish(0, |health| {
            (health.role, health.pid) = (self.role.to_wire(), std::process::id());
            (health.ready_ns, health.counters) = (self.ready_ns, tally.counters);
            (health.instance, health.reserved) = (self.instance, 0);
            (health.detail, health.refusal, health.alarm) = (self.detail, tally.refusal, tally.alarm);
        })?;
        self.supervision.is_working(self.detail.as_str(), tally, now);
        Ok(())
    }
}
