//! What the log says of boxes: little while all is well, and what a person needs who asks what happened.

use messages::{ChosenBy, CycleReport};
use tracing::field::display;
use tracing::{debug, info, warn};

/// Longest time from the observation of a box to its command [ns].
const BUDGET_NS: u64 = 40_000_000;

/// Writes a line for every box at level debug, and at higher levels only what is out of the ordinary: a box over its
/// budget, and every change of who chooses.
#[derive(Debug, Default)]
pub struct CycleLog {
    chosen_by: Option<ChosenBy>,
}

impl CycleLog {
    /// Takes in the report of a cycle that is complete.
    pub fn record(&mut self, report: &CycleReport) {
        let Ok(by) = ChosenBy::from_wire(report.chosen_by) else { return };
        let (id, stamps) = (report.spec.id, &report.stamps);
        let latency_ns = stamps.command_published_ns.saturating_sub(stamps.observed_ns);
        let latency_us = latency_ns / 1000;
        let letter = char::from(b'a'.saturating_add(report.instance as u8));
        let instance = matches!(by, ChosenBy::Model | ChosenBy::Standby).then(|| display(letter));
        debug!("box" = id, instance, "box {id} done: {by:?}, {latency_us} us, container {}", report.container);
        if latency_ns > BUDGET_NS {
            warn!("box" = id, instance, "box {id} was over its budget of 40 ms: {latency_us} us, {by:?}");
        }
        if by == ChosenBy::Rules || self.chosen_by.replace(by) == Some(by) {
            return;
        }
        match by {
            ChosenBy::Model => info!("box" = id, instance, "box {id}: the active scorer {letter} decides"),
            ChosenBy::Standby => {
                warn!("box" = id, instance, "box {id}: the active scorer is late, the standby {letter} decides")
            }
            ChosenBy::Fallback => warn!("box" = id, "box {id}: no scorer answers in time, the fallback decides"),
            ChosenBy::Rules => {}
        }
    }
}
