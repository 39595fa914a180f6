//! Where the time of a box goes.

use hdrhistogram::Histogram;
use messages::Stamps;
use serde::Serialize;

/// The budget from observation to command [us].
pub(crate) const BUDGET_US: u64 = 40_000;

/// Longest latency that is told apart [us]: an hour.
const LONGEST_US: u64 = 3_600_000_000;

/// What is measured: a name, and the stamps between which it lies. The stages follow each other.
type Stage = (&'static str, fn(&Stamps) -> (u64, u64));

/// The stages of a box's way, in order. The first is the wait of a box that was due before it could be brought in.
pub(crate) const STAGES: [Stage; 8] = [
    ("arrival", |s| (s.due_ns, s.observed_ns)),
    ("perception", |s| (s.observed_ns, s.boxes_published_ns)),
    ("to_candidates", |s| (s.boxes_published_ns, s.candidates_received_ns)),
    ("candidates", |s| (s.candidates_received_ns, s.candidates_published_ns)),
    ("to_scorer", |s| (s.candidates_published_ns, s.scorer_received_ns)),
    ("scorer", |s| (s.scorer_received_ns, s.decision_published_ns)),
    ("to_commander", |s| (s.decision_published_ns, s.decision_received_ns)),
    ("commander", |s| (s.decision_received_ns, s.command_published_ns)),
];

/// What a demo measures: the stages behind the observation, and all of them together.
fn measured() -> impl Iterator<Item = Stage> {
    let end_to_end: Stage = ("end_to_end", |s| (s.observed_ns, s.command_published_ns));
    STAGES.into_iter().skip(1).chain([end_to_end])
}

/// The latencies of many boxes.
#[derive(Debug)]
pub(crate) struct Latencies {
    stages: Vec<(&'static str, Histogram<u64>)>,
    /// Boxes that were decided later than the budget allows.
    pub(crate) over_budget: u64,
}

/// The latency of one stage [us].
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Summary {
    pub(crate) count: u64,
    pub(crate) p50: f64,
    pub(crate) p99: f64,
    pub(crate) p99_9: f64,
    pub(crate) max: f64,
}

impl Latencies {
    pub(crate) fn new() -> Self {
        let histogram = || Histogram::new_with_bounds(1, LONGEST_US * 10, 4).expect("the bounds are in order");
        let stages = measured().map(|(name, _)| (name, histogram())).collect();
        Self { stages, over_budget: 0 }
    }

    /// Counts one box. A stage that had no part in it (a scorer when the fallback chose) is left out.
    pub(crate) fn record(&mut self, stamps: &Stamps) {
        for ((_, histogram), (_, between)) in self.stages.iter_mut().zip(measured()) {
            let (from_ns, to_ns) = between(stamps);
            if from_ns > 0 && to_ns >= from_ns {
                histogram.saturating_record((to_ns - from_ns) / 100);
            }
        }
        let late_ns = stamps.command_published_ns.saturating_sub(stamps.observed_ns);
        self.over_budget += u64::from(late_ns > BUDGET_US * 1000);
    }

    /// All stages in the order of a box's way.
    pub(crate) fn summaries(&self) -> impl Iterator<Item = (&'static str, Summary)> {
        self.stages.iter().map(|(name, histogram)| {
            let us = |tenths: u64| tenths as f64 / 10.0;
            let at = |quantile| us(histogram.value_at_quantile(quantile));
            let (p50, p99, p99_9) = (at(0.5), at(0.99), at(0.999));
            (*name, Summary { count: histogram.len(), p50, p99, p99_9, max: us(histogram.max()) })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_lie_between_their_stamps() {
        let mut latencies = Latencies::new();
        let stamps = Stamps {
            due_ns: 0,
            observed_ns: 1_000_000,
            boxes_published_ns: 1_010_000,
            candidates_received_ns: 1_030_000,
            candidates_published_ns: 1_060_000,
            scorer_received_ns: 1_100_000,
            decision_published_ns: 1_600_000,
            decision_received_ns: 1_660_000,
            command_published_ns: 1_730_000,
            motion_published_ns: 0,
        };
        latencies.record(&stamps);
        let p50: Vec<_> = latencies.summaries().map(|(_, summary)| summary.p50).collect();
        assert_eq!(p50, [10.0, 20.0, 30.0, 40.0, 500.0, 60.0, 70.0, 730.0]);
        assert_eq!(latencies.over_budget, 0);
    }

    #[test]
    fn a_fallback_has_no_scorer_and_a_late_box_is_counted() {
        let mut latencies = Latencies::new();
        let stamps = Stamps { observed_ns: 1, command_published_ns: 40_000_002, ..Stamps::default() };
        latencies.record(&stamps);
        let counts: Vec<_> = latencies.summaries().map(|(_, summary)| summary.count).collect();
        assert_eq!(counts, [0, 0, 0, 0, 0, 0, 0, 1]);
        assert_eq!(latencies.over_budget, 1);
    }
}
