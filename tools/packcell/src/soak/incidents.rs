//! What faults cost: the boxes around them, and the time until all is as it was.

use std::collections::BTreeMap;

use hdrhistogram::Histogram;
use messages::topics::Role;
use messages::{ChosenBy, CycleReport};
use serde::Serialize;

use super::faults::{Fault, Kind, Target};
use super::latency::Answer;

/// Faults that are listed one by one, the first ones; all are in the sums.
pub(crate) const LISTED_MAX: usize = 1000;

/// How long after its end a fault is held responsible for late boxes [ns].
const AFTERMATH_NS: u64 = 1_000_000_000;

/// How long a killed or frozen process is waited for [ns].
const BACK_PATIENCE_NS: u64 = 30_000_000_000;

/// Longest time that is told apart [us].
const LONGEST_US: u64 = 600_000_000;

/// One fault, in the figures.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct FaultFigures {
    pub(crate) at_box: u64,
    /// Seconds since the soak began.
    pub(crate) at_s: f64,
    pub(crate) kind: &'static str,
    pub(crate) target: String,
    pub(crate) for_ms: u64,
    /// Boxes over the budget for which this fault is held responsible.
    pub(crate) cost_boxes_late: u64,
    /// The slowest box while it lasted and a second after.
    pub(crate) worst_ms: f64,
    /// From the kill or the thaw to the first command in which that stage had its part again.
    pub(crate) back_ms: Option<f64>,
    /// What went wrong with the fault itself; empty if nothing did.
    pub(crate) note: String,
}

/// All faults of a kind on one target.
#[derive(Debug)]
pub(crate) struct Sum {
    pub(crate) count: u64,
    /// Those that could not be done.
    pub(crate) failed: u64,
    pub(crate) boxes_late: u64,
    pub(crate) worst_us: Histogram<u32>,
    pub(crate) back_us: Histogram<u32>,
    /// Processes that were not back in time.
    pub(crate) not_back: u64,
}

/// Faults and their costs.
#[derive(Debug)]
pub(crate) struct Incidents {
    began_ns: u64,
    open: Vec<Open>,
    pub(crate) listed: Vec<FaultFigures>,
    pub(crate) count: u64,
    pub(crate) sums: BTreeMap<(&'static str, &'static str), Sum>,
}

#[derive(Debug)]
struct Open {
    number: u64,
    fault: Fault,
    figures: FaultFigures,
    began_ns: u64,
    /// When it is over; nothing while that is not known.
    ended_ns: Option<u64>,
    back_ns: Option<u64>,
}

impl Incidents {
    pub(crate) fn new(now_ns: u64) -> Self {
        Self { began_ns: now_ns, open: Vec::new(), listed: Vec::new(), count: 0, sums: BTreeMap::new() }
    }

    /// A fault begins; its number.
    pub(crate) fn begin(&mut self, fault: Fault, target: String, at_box: u64, now_ns: u64) -> u64 {
        self.count += 1;
        let figures = FaultFigures {
            at_box,
            at_s: now_ns.saturating_sub(self.began_ns) as f64 / 1e9,
            kind: fault.kind.name(),
            target,
            for_ms: fault.for_ms,
            cost_boxes_late: 0,
            worst_ms: 0.0,
            back_ms: None,
            note: String::new(),
        };
        let number = self.count;
        self.open.push(Open { number, fault, figures, began_ns: now_ns, ended_ns: None, back_ns: None });
        number
    }

    /// A fault is over, or could not be done: `note` says why.
    pub(crate) fn end(&mut self, number: u64, note: String, now_ns: u64) {
        if let Some(open) = self.open.iter_mut().find(|open| open.number == number) {
            (open.ended_ns, open.figures.note) = (Some(now_ns), note);
        }
    }

    /// The cell answered a box.
    pub(crate) fn answer(&mut self, report: &CycleReport, answer: &Answer) {
        let commanded_ns = answer.due_ns + answer.latency_ns;
        for open in &mut self.open {
            if open.back_ns.is_none() && open.was_part_of(report) {
                open.back_ns = Some(commanded_ns);
            }
        }
        let is_in = |open: &Open| {
            let until_ns = open.ended_ns.map_or(u64::MAX, |ended| open.responsible_until_ns(ended));
            commanded_ns >= open.began_ns && answer.due_ns <= until_ns
        };
        for open in self.open.iter_mut().filter(|open| is_in(open)) {
            open.figures.worst_ms = open.figures.worst_ms.max(answer.latency_ns as f64 / 1e6);
        }
        // A late box is one fault's: the newest that it met.
        if answer.is_late
            && let Some(open) = self.open.iter_mut().rev().find(|open| is_in(open))
        {
            open.figures.cost_boxes_late += 1;
        }
    }

    /// Settles what is over.
    pub(crate) fn settle(&mut self, now_ns: u64, is_last: bool) {
        let (settled, open): (Vec<_>, Vec<_>) =
            std::mem::take(&mut self.open).into_iter().partition(|open| is_last || open.is_settled(now_ns));
        self.open = open;
        for mut open in settled {
            open.figures.back_ms = open.back_ns.map(|ns| ns.saturating_sub(open.back_from_ns()) as f64 / 1e6);
            let key = (open.fault.kind.name(), open.fault.target.name());
            let sum = self.sums.entry(key).or_insert_with(Sum::new);
            sum.add(&open);
            if self.listed.len() < LISTED_MAX {
                self.listed.push(open.figures);
            }
        }
    }

    /// Whether nothing is under way or being settled.
    pub(crate) fn is_settled(&self) -> bool {
        self.open.is_empty()
    }

    /// The faults that are listed.
    pub(crate) fn marks(&self) -> impl Iterator<Item = &FaultFigures> {
        self.listed.iter()
    }
}

impl Open {
    /// From when the time until the process is back counts.
    fn back_from_ns(&self) -> u64 {
        if self.fault.kind == Kind::Freeze { self.began_ns + self.fault.for_ms * 1_000_000 } else { self.began_ns }
    }

    /// Whether a process is missing until it has its part in a command again.
    fn waits_for(&self) -> Option<Role> {
        match (self.fault.kind, self.fault.target) {
            (Kind::Kill | Kind::Freeze, Target::Process(role)) => Some(role),
            _ => None,
        }
    }

    /// Whether the process that was killed or frozen had its part in this report, and came back for it.
    fn was_part_of(&self, report: &CycleReport) -> bool {
        let stamps = &report.stamps;
        let stamp_ns = match self.waits_for() {
            Some(Role::Perception) => stamps.boxes_published_ns,
            Some(Role::Candidates) => stamps.candidates_received_ns,
            Some(Role::Scorer) if report.chosen_by == ChosenBy::Model.to_wire() => stamps.scorer_received_ns,
            Some(Role::Commander) => stamps.command_published_ns,
            Some(Role::Scorer | Role::Tool) | None => 0,
        };
        stamp_ns > self.back_from_ns()
    }

    fn responsible_until_ns(&self, ended_ns: u64) -> u64 {
        ended_ns.max(self.back_ns.unwrap_or(0)) + AFTERMATH_NS
    }

    fn is_settled(&self, now_ns: u64) -> bool {
        let Some(ended_ns) = self.ended_ns else { return false };
        let is_back = self.waits_for().is_none() || self.back_ns.is_some() || !self.figures.note.is_empty();
        (is_back || now_ns > ended_ns + BACK_PATIENCE_NS) && now_ns > self.responsible_until_ns(ended_ns) + AFTERMATH_NS
    }
}

impl Sum {
    fn new() -> Self {
        let micros = || Histogram::new_with_bounds(1, LONGEST_US, 3).expect("the bounds are in order");
        Self { count: 0, failed: 0, boxes_late: 0, worst_us: micros(), back_us: micros(), not_back: 0 }
    }

    fn add(&mut self, open: &Open) {
        let figures = &open.figures;
        self.count += 1;
        if !figures.note.is_empty() {
            self.failed += 1;
            return;
        }
        self.boxes_late += figures.cost_boxes_late;
        self.worst_us.saturating_record((figures.worst_ms * 1000.0) as u64);
        match figures.back_ms {
            Some(ms) => self.back_us.saturating_record((ms * 1000.0) as u64),
            None => self.not_back += u64::from(open.waits_for().is_some()),
        }
    }
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable as _;

    use super::*;

    const MS: u64 = 1_000_000;

    fn kill() -> Fault {
        Fault { kind: Kind::Kill, target: Target::Process(Role::Candidates), for_ms: 0 }
    }

    fn answered(incidents: &mut Incidents, due_ms: u64, received_ms: u64, commanded_ms: u64) {
        let mut report = CycleReport::zeroed();
        report.stamps.candidates_received_ns = received_ms * MS;
        let latency_ns = (commanded_ms - due_ms) * MS;
        let answer = Answer { due_ns: due_ms * MS, latency_ns, is_late: latency_ns > 40 * MS };
        incidents.answer(&report, &answer);
    }

    #[test]
    fn a_kill_costs_the_boxes_that_it_delayed_and_ends_when_the_process_is_back() {
        let mut incidents = Incidents::new(0);
        let number = incidents.begin(kill(), "candidates".to_owned(), 7, 1000 * MS);
        incidents.end(number, String::new(), 1000 * MS);
        answered(&mut incidents, 999, 999, 1001);
        answered(&mut incidents, 1010, 1110, 1111);
        answered(&mut incidents, 1020, 1112, 1113);
        answered(&mut incidents, 1100, 1114, 1115);
        incidents.settle(1500 * MS, false);
        assert!(incidents.listed.is_empty());
        incidents.settle(5000 * MS, false);
        let figures = &incidents.listed[0];
        assert_eq!((figures.at_box, figures.cost_boxes_late, figures.worst_ms), (7, 2, 101.0));
        assert_eq!(figures.back_ms, Some(111.0), "the set in flight when it died is no sign of life");
        let sum = &incidents.sums[&("kill", "candidates")];
        assert_eq!((sum.count, sum.boxes_late, sum.back_us.max() / 1000, sum.not_back), (1, 2, 111, 0));
    }

    #[test]
    fn a_late_box_is_one_faults_and_a_fault_that_failed_costs_nothing() {
        let mut incidents = Incidents::new(0);
        let first = incidents.begin(kill(), "candidates".to_owned(), 7, 1000 * MS);
        incidents.end(first, String::new(), 1000 * MS);
        let second = incidents.begin(kill(), "candidates".to_owned(), 8, 1050 * MS);
        incidents.end(second, "no candidates runs".to_owned(), 1050 * MS);
        answered(&mut incidents, 1010, 1110, 1111);
        incidents.settle(1_000_000 * MS, true);
        assert_eq!(incidents.listed.iter().map(|fault| fault.cost_boxes_late).sum::<u64>(), 1);
        let sum = &incidents.sums[&("kill", "candidates")];
        assert_eq!((sum.count, sum.failed), (2, 1));
    }
}
