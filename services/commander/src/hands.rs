//! The effects on a real bus and a real disk.

use commander::{CycleLog, Effects, Order};
use journal::{AppendError, Entry, Journal, Record};
use messages::topics::{COMMANDS, CYCLES};
use messages::{CycleReport, PlaceCommand};
use runtime::{Bus, BusError, Publisher, unix_ms};

/// What the commander acts with.
#[derive(Debug)]
pub(crate) struct Hands {
    journal: Journal,
    commands: Publisher<PlaceCommand>,
    cycles: Publisher<CycleReport>,
    log: CycleLog,
}

impl Hands {
    pub(crate) fn new(bus: &Bus, journal: Journal) -> Result<Self, BusError> {
        let (commands, cycles, log) = (bus.publisher(&COMMANDS)?, bus.publisher(&CYCLES)?, CycleLog::default());
        Ok(Self { journal, commands, cycles, log })
    }

    /// Says the last word again to those that came late.
    pub(crate) fn greet_newcomers(&self) -> Result<(), BusError> {
        self.commands.greet_newcomers()?;
        self.cycles.greet_newcomers()
    }

    /// Puts a journal aside that has grown large.
    pub(crate) fn tidy(&mut self) {
        if let Err(error) = self.journal.make_room() {
            tracing::warn!(%error, "the journal stays as long as it is");
        }
    }
}

impl Effects for Hands {
    type Error = BusError;

    fn append(&mut self, record: &Record) -> Result<(), AppendError> {
        self.journal.append(&Entry { unix_ms: unix_ms(), record: *record })
    }

    fn command(&mut self, order: &Order) -> Result<u64, BusError> {
        let stamp_ns = self.commands.publish(order.observed_ns(), |command| order.write(command))?;
        self.journal.sync_soon();
        Ok(stamp_ns)
    }

    fn report(&mut self, report: &CycleReport) -> Result<(), BusError> {
        self.cycles.publish(report.stamps.observed_ns, |cycle| *cycle = *report)?;
        self.log.record(report);
        self.journal.sync_soon();
        Ok(())
    }
}
