//! Latencies of any number of boxes: from when each was due, at every stage, and over time.

use hdrhistogram::Histogram;
use messages::{Action, CycleReport, Stamps};
use serde::{Deserialize, Serialize};

use crate::latency::STAGES;

/// Longest latency that is told apart [us]: ten minutes. A longer one counts as that.
const LONGEST_US: u64 = 600_000_000;

/// Sections of the time line. When more are needed, two become one, and every section is twice as long.
pub(crate) const SECTIONS_MAX: usize = 256;

/// Length of a section at the beginning [ns].
const SECTION_NS: u64 = 1_000_000_000;

/// Late boxes that are listed, the slowest ones; all are counted.
pub(crate) const LATE_LISTED_MAX: usize = 100;

/// Stages of a box's way, in its order, the wait of a box that could not be brought in included.
pub(crate) const STAGE_COUNT: usize = STAGES.len();

/// The latency of one stage [us].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Percentiles {
    pub(crate) count: u64,
    pub(crate) p50: u64,
    pub(crate) p90: u64,
    pub(crate) p99: u64,
    pub(crate) p99_9: u64,
    pub(crate) p99_99: u64,
    pub(crate) p99_999: u64,
    pub(crate) max: u64,
}

/// A histogram of microseconds, exact to one up to 262 ms and to five digits beyond.
#[derive(Clone, Debug)]
pub(crate) struct Micros(Histogram<u32>);

/// A part of the time line.
#[derive(Clone, Debug)]
pub(crate) struct Section {
    end_to_end: Histogram<u32>,
    /// Time that its boxes spent at each stage [ns].
    stage_sums_ns: [u64; STAGE_COUNT],
}

/// A box that was decided later than the budget allows.
#[derive(Clone, Debug)]
pub(crate) struct Late {
    pub(crate) latency_ns: u64,
    pub(crate) cycle: CycleReport,
    /// What the processes went through meanwhile.
    pub(crate) circumstances: String,
}

/// One answer of the cell, as far as whoever watches faults needs it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Answer {
    /// When the box was due [ns].
    pub(crate) due_ns: u64,
    /// From then to the command [ns].
    pub(crate) latency_ns: u64,
    pub(crate) is_late: bool,
}

/// The latencies of many boxes.
#[derive(Debug)]
pub(crate) struct Latencies {
    budget_ns: u64,
    began_ns: u64,
    pub(crate) stages: [Micros; STAGE_COUNT],
    pub(crate) end_to_end: Micros,
    sections: Vec<Section>,
    section_ns: u64,
    pub(crate) over_budget: u64,
    /// The slowest late boxes, the slowest first.
    pub(crate) late: Vec<Late>,
    /// Answers whose command stamp died with a commander: they count to the motion, or to the report.
    pub(crate) bounded: u64,
    /// Orders whose report never came: their latency is not known.
    pub(crate) lost_reports: u64,
    pub(crate) candidates_max: u32,
    pub(crate) left_out: u64,
    /// The last order that was reported; nothing until it is known.
    last_order: Option<u64>,
}

impl Micros {
    pub(crate) fn new() -> Self {
        Self(Histogram::new_with_bounds(1, LONGEST_US, 5).expect("the bounds are in order"))
    }

    pub(crate) fn record_ns(&mut self, ns: u64) {
        self.0.saturating_record(ns / 1000);
    }

    pub(crate) fn percentiles(&self) -> Percentiles {
        let at = |quantile| self.0.value_at_quantile(quantile);
        let (count, max) = (self.0.len(), self.0.max());
        let (p50, p90, p99) = (at(0.5), at(0.9), at(0.99));
        let (p99_9, p99_99, p99_999) = (at(0.999), at(0.9999), at(0.99999));
        Percentiles { count, p50, p90, p99, p99_9, p99_99, p99_999, max }
    }

    /// Quantile and latency [us] along the curve, up to the last quantile that so many boxes can show.
    pub(crate) fn curve(&self) -> Vec<(f64, f64)> {
        let mut points = Vec::new();
        // Twenty points to a factor of ten in the share of slower boxes.
        for step in 0..=140 {
            let slower = 10f64.powf(-f64::from(step) / 20.0);
            if slower * (self.0.len() as f64) < 1.0 {
                break;
            }
            points.push((1.0 - slower, self.0.value_at_quantile(1.0 - slower) as f64));
        }
        points
    }
}

impl Section {
    fn new() -> Self {
        let end_to_end = Histogram::new_with_bounds(1, LONGEST_US, 2).expect("the bounds are in order");
        Self { end_to_end, stage_sums_ns: [0; STAGE_COUNT] }
    }

    fn add(&mut self, other: &Self) {
        // The bounds are equal, so nothing can be too large.
        let _cannot_fail = self.end_to_end.add(&other.end_to_end);
        self.stage_sums_ns.iter_mut().zip(other.stage_sums_ns).for_each(|(sum, more)| *sum += more);
    }

    pub(crate) fn count(&self) -> u64 {
        self.end_to_end.len()
    }

    /// Latency at this quantile [us].
    pub(crate) fn at(&self, quantile: f64) -> f64 {
        self.end_to_end.value_at_quantile(quantile) as f64
    }

    pub(crate) fn max_us(&self) -> f64 {
        self.end_to_end.max() as f64
    }

    /// Mean time at each stage [us].
    pub(crate) fn means_us(&self) -> [f64; STAGE_COUNT] {
        self.stage_sums_ns.map(|sum| sum as f64 / 1000.0 / self.count().max(1) as f64)
    }
}

impl Latencies {
    /// Nothing yet; a box is late after `budget_ns`. `last_order` is the order before the first that is to come, if
    /// that is known.
    pub(crate) fn new(budget_ns: u64, last_order: Option<u64>, now_ns: u64) -> Self {
        Self {
            budget_ns,
            began_ns: now_ns,
            stages: std::array::from_fn(|_| Micros::new()),
            end_to_end: Micros::new(),
            sections: Vec::new(),
            section_ns: SECTION_NS,
            over_budget: 0,
            late: Vec::new(),
            bounded: 0,
            lost_reports: 0,
            candidates_max: 0,
            left_out: 0,
            last_order,
        }
    }

    /// Takes in a report that was read at `now_ns`; nothing for one that says an order again. Every order counts, that
    /// for a container too: it is an answer to a box that lies there.
    pub(crate) fn record(&mut self, report: &CycleReport, now_ns: u64) -> Option<Answer> {
        let before = self.last_order.unwrap_or(report.order.saturating_sub(1));
        if report.order <= before {
            return None;
        }
        self.lost_reports += report.order - before - 1;
        self.last_order = Some(report.order);
        self.candidates_max = self.candidates_max.max(report.candidates);
        self.left_out += u64::from(report.left_out);
        let stamps = &report.stamps;
        let due_ns = due_ns(stamps);
        let known = [stamps.command_published_ns, stamps.motion_published_ns].into_iter().find(|&stamp| stamp > 0);
        self.bounded += u64::from(stamps.command_published_ns == 0);
        let latency_ns = known.unwrap_or(now_ns).saturating_sub(due_ns);
        self.end_to_end.record_ns(latency_ns);
        let index = self.section_index(now_ns);
        let section = &mut self.sections[index];
        section.end_to_end.saturating_record(latency_ns / 1000);
        for (stage, (_, between)) in STAGES.iter().enumerate() {
            let (from_ns, to_ns) = between(stamps);
            if from_ns > 0 && to_ns >= from_ns {
                self.stages[stage].record_ns(to_ns - from_ns);
                section.stage_sums_ns[stage] += to_ns - from_ns;
            }
        }
        let is_late = latency_ns > self.budget_ns;
        self.over_budget += u64::from(is_late);
        Some(Answer { due_ns, latency_ns, is_late })
    }

    /// Lists a late box if it is among the slowest.
    pub(crate) fn list_late(&mut self, cycle: &CycleReport, latency_ns: u64, circumstances: String) {
        let place = self.late.partition_point(|late| late.latency_ns >= latency_ns);
        if place < LATE_LISTED_MAX {
            self.late.insert(place, Late { latency_ns, cycle: *cycle, circumstances });
            self.late.truncate(LATE_LISTED_MAX);
        }
    }

    fn section_index(&mut self, now_ns: u64) -> usize {
        let since_ns = now_ns.saturating_sub(self.began_ns);
        while since_ns / self.section_ns >= SECTIONS_MAX as u64 {
            self.section_ns *= 2;
            let mut pairs = std::mem::take(&mut self.sections).into_iter();
            while let Some(mut section) = pairs.next() {
                if let Some(second) = pairs.next() {
                    section.add(&second);
                }
                self.sections.push(section);
            }
        }
        let index = (since_ns / self.section_ns) as usize;
        while self.sections.len() <= index {
            self.sections.push(Section::new());
        }
        index
    }

    /// The time line: the middle of every section [s], and what happened in it.
    pub(crate) fn sections(&self) -> impl Iterator<Item = (f64, &Section)> {
        let length_s = self.section_ns as f64 / 1e9;
        self.sections.iter().enumerate().map(move |(index, section)| ((index as f64 + 0.5) * length_s, section))
    }

    /// Length of a section [s].
    pub(crate) fn section_s(&self) -> f64 {
        self.section_ns as f64 / 1e9
    }
}

/// When a box was due; one whose due time died with a commander was due when it was observed.
pub(crate) fn due_ns(stamps: &Stamps) -> u64 {
    if stamps.due_ns > 0 { stamps.due_ns } else { stamps.observed_ns }
}

/// What was commanded, for people.
pub(crate) fn action_name(action: u32) -> &'static str {
    match Action::from_wire(action) {
        Ok(Action::Place) => "place",
        Ok(Action::SetAside) => "set aside",
        Ok(Action::Replace) => "replace a container",
        Err(_) => "unknown",
    }
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable as _;

    use super::*;

    const MS: u64 = 1_000_000;

    fn report(order: u64, due_ms: u64, observed_ms: u64, command_ms: u64) -> CycleReport {
        let mut report = CycleReport { order, ..CycleReport::zeroed() };
        (report.stamps.due_ns, report.stamps.observed_ns) = (due_ms * MS, observed_ms * MS);
        report.stamps.command_published_ns = command_ms * MS;
        report
    }

    /// A stall of 100 ms at a pace of 10 ms: the box that met it waited 100 ms, and those behind it 91, 82, ... ms.
    #[test]
    fn a_stall_is_charged_to_every_box_that_it_delayed() {
        let mut latencies = Latencies::new(40 * MS, None, 0);
        latencies.record(&report(1, 1000, 1000, 1100), 1100 * MS);
        for order in 2..=12 {
            let (due, decided) = (1000 + 10 * (order - 1), 1100 + order - 1);
            latencies.record(&report(order, due, decided - 1, decided), decided * MS);
        }
        assert_eq!(latencies.end_to_end.percentiles().max, 100_000);
        assert_eq!(latencies.over_budget, 7, "100, 91, 82, 73, 64, 55 and 46 ms");
        let (name, _) = STAGES[0];
        assert_eq!(name, "arrival");
        assert_eq!(latencies.stages[0].percentiles().max, 90_000);
    }

    #[test]
    fn an_order_counts_once_and_a_missing_stamp_is_no_good_news() {
        let mut latencies = Latencies::new(40 * MS, Some(0), 0);
        latencies.record(&report(1, 10, 10, 11), 12 * MS);
        assert!(latencies.record(&report(1, 10, 10, 11), 13 * MS).is_none());
        let mut recovered = report(4, 0, 20, 0);
        let answer = latencies.record(&recovered, 90 * MS).unwrap();
        assert_eq!((answer.latency_ns, answer.is_late), (70 * MS, true), "it counts to when it was reported");
        (recovered.order, recovered.stamps.motion_published_ns) = (5, 50 * MS);
        assert_eq!(latencies.record(&recovered, 90 * MS).unwrap().latency_ns, 30 * MS);
        assert_eq!((latencies.bounded, latencies.lost_reports), (2, 2));
    }

    #[test]
    fn the_time_line_and_the_list_of_late_boxes_stay_short() {
        let mut latencies = Latencies::new(0, Some(0), 0);
        for order in 1..=3000 {
            let second = order * 1000;
            let late = report(order, second, second, second + order % 700);
            latencies.record(&late, second * MS);
            latencies.list_late(&late, order % 700, String::new());
        }
        assert!(latencies.sections().count() <= SECTIONS_MAX);
        assert_eq!(latencies.sections().map(|(_, section)| section.count()).sum::<u64>(), 3000);
        assert_eq!(latencies.section_s(), 16.0);
        assert_eq!(latencies.late.len(), LATE_LISTED_MAX);
        assert!(latencies.late.iter().all(|late| late.latency_ns >= 675));
    }

    #[test]
    fn the_curve_ends_where_the_boxes_end() {
        let mut micros = Micros::new();
        (1..=1000).for_each(|us| micros.record_ns(us * 1000));
        let curve = micros.curve();
        assert_eq!(curve[0], (0.0, 1.0));
        assert!(curve.last().unwrap().0 <= 0.999 + 1e-9 && curve.last().unwrap().1 >= 998.0, "{curve:?}");
        assert_eq!(micros.percentiles().p50, 500);
    }
}
