//! The figures of a soak, as `--json` writes them.

use std::collections::BTreeMap;

use serde::Serialize;

use super::incidents::FaultFigures;
use super::latency::Percentiles;
use super::machine::Machine;
use super::processes::ProcessFigures;

/// Everything that was measured.
#[derive(Debug, Serialize)]
pub(crate) struct Figures {
    /// The command that made it.
    pub(crate) command: String,
    /// How it ended: as planned, interrupted, or by what.
    pub(crate) end: String,
    pub(crate) seconds: f64,
    /// Boxes that are over, by the journal.
    pub(crate) boxes: u64,
    pub(crate) boxes_per_s: f64,
    pub(crate) placed: u64,
    pub(crate) set_aside: u64,
    pub(crate) containers_replaced: u64,
    /// Boxes that no order moved although a later one was moved.
    pub(crate) lost: u64,
    /// Boxes that more than one order moved.
    pub(crate) doubled: u64,
    /// Orders that the journal held and the soak did not get to read: they are not judged.
    pub(crate) unseen: u64,
    pub(crate) budget_ms: u64,
    /// Answers later than the budget after their box was due.
    pub(crate) over_budget: u64,
    /// Those of them in whose second the baseline was over the budget too; nothing without a baseline.
    pub(crate) over_budget_with_baseline: Option<u64>,
    pub(crate) chosen_by: BTreeMap<&'static str, u64>,
    pub(crate) orders_refused: u64,
    pub(crate) messages_refused: u64,
    pub(crate) candidates_max: u32,
    pub(crate) candidates_left_out: u64,
    pub(crate) restarts: BTreeMap<String, u64>,
    /// Orders whose report never came: their latency is not known.
    pub(crate) lost_reports: u64,
    /// Answers whose command stamp died with a commander; they count to the motion or to the report.
    pub(crate) bounded: u64,
    /// By stage, and from when a box was due to its command.
    pub(crate) latency_us: BTreeMap<&'static str, Percentiles>,
    /// The machine itself in the same minutes.
    pub(crate) baseline: Option<BaselineFigures>,
    pub(crate) late: Vec<LateFigures>,
    pub(crate) faults: Vec<FaultFigures>,
    /// Faults in all; `faults` lists the first ones.
    pub(crate) faults_count: u64,
    pub(crate) faults_by_kind: Vec<FaultSum>,
    pub(crate) processes: Vec<ProcessFigures>,
    /// Shared memory of the cell's bus.
    pub(crate) bus: BusFigures,
    pub(crate) machine: Machine,
}

#[derive(Debug, Serialize)]
pub(crate) struct BaselineFigures {
    /// How late a thread woke that had asked for a moment.
    pub(crate) timer_us: Percentiles,
    /// A message to another process and one back.
    pub(crate) ping_us: Percentiles,
}

/// A late box. Times in microseconds.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct LateFigures {
    pub(crate) box_id: u64,
    pub(crate) order: u64,
    pub(crate) action: &'static str,
    pub(crate) latency_us: u64,
    /// Time at each stage; nothing for one that had no part.
    pub(crate) stages_us: BTreeMap<&'static str, Option<u64>>,
    pub(crate) candidates: u32,
    /// What the processes went through since they were looked at last.
    pub(crate) circumstances: String,
}

/// All faults of a kind on one target. Times in milliseconds.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct FaultSum {
    pub(crate) kind: &'static str,
    pub(crate) target: &'static str,
    pub(crate) count: u64,
    pub(crate) failed: u64,
    pub(crate) boxes_late: u64,
    /// Of the slowest box around each: p50, p99, max.
    pub(crate) worst_ms: [f64; 3],
    /// Until the stage had its part in a command again: p50, p99, max; nothing if that was not asked or never came.
    pub(crate) back_ms: Option<[f64; 3]>,
    pub(crate) not_back: u64,
}

#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(crate) struct BusFigures {
    pub(crate) files_start: u64,
    pub(crate) files_end: u64,
    pub(crate) bytes_start: u64,
    pub(crate) bytes_end: u64,
    /// Growth after warm-up [bytes an hour]; nothing for a soak that was too short.
    pub(crate) bytes_slope: Option<f64>,
}

impl Figures {
    /// Why this soak did not go well; nothing if it did. `late_max` boxes may be late, if a budget was asked for.
    pub(crate) fn verdict(&self, late_max: Option<u64>) -> Option<String> {
        let mut faults = Vec::new();
        if self.lost > 0 {
            faults.push(format!("{} box(es) lost", self.lost));
        }
        if self.doubled > 0 {
            faults.push(format!("{} box(es) doubled", self.doubled));
        }
        if let Some(late_max) = late_max.filter(|&late_max| self.over_budget > late_max) {
            faults.push(format!("{} over {} ms, allowed are {late_max}", self.over_budget, self.budget_ms));
        }
        (!faults.is_empty()).then(|| faults.join(", "))
    }
}
