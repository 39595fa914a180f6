//! Two scorers compared on the sets of a running cell, while one is obeyed and the other is not.

use std::collections::{BTreeMap, VecDeque};

use hdrhistogram::Histogram;
use messages::{CandidateSet, Decision};

/// Sets that are remembered while their answers are awaited.
const OPEN_SETS_MAX: usize = 64;

/// Longest latency that is told apart [us].
const LONGEST_US: u64 = 60_000_000;

/// What was seen of the newcomer and of the active instance.
#[derive(Debug)]
pub(crate) struct Shadow {
    newcomer: u32,
    active: u32,
    open: VecDeque<OpenSet>,
    pub(crate) answers_newcomer: Answers,
    pub(crate) answers_active: Answers,
    /// Sets that both answered, and those of them with the same choice.
    pub(crate) both: u64,
    pub(crate) agreed: u64,
}

/// One scorer's answers.
#[derive(Debug)]
pub(crate) struct Answers {
    /// From the set's publication to the decision's [us].
    pub(crate) latency_us: Histogram<u64>,
    /// Sum of the values, for their mean.
    value_sum: f64,
    /// Answers that break a rule, by what they broke.
    pub(crate) rubbish: BTreeMap<&'static str, u64>,
}

#[derive(Debug)]
struct OpenSet {
    digest: u64,
    count: u32,
    published_ns: u64,
    newcomer: Option<u32>,
    active: Option<u32>,
}

impl Shadow {
    pub(crate) fn new(newcomer: u32, active: u32) -> Self {
        let (answers_newcomer, answers_active) = (Answers::new(), Answers::new());
        Self { newcomer, active, open: VecDeque::new(), answers_newcomer, answers_active, both: 0, agreed: 0 }
    }

    /// Sets that the newcomer answered.
    pub(crate) fn answered(&self) -> u64 {
        self.answers_newcomer.latency_us.len()
    }

    /// A set was published. A set without a choice needs no scorer, and one that is said again is the same set.
    pub(crate) fn on_set(&mut self, set: &CandidateSet) {
        let (digest, count, published_ns) = (set.digest, set.count, set.header.stamp_ns);
        if count == 0 || self.open.iter().any(|open| open.digest == digest) {
            return;
        }
        if self.open.len() == OPEN_SETS_MAX {
            self.open.pop_front();
        }
        self.open.push_back(OpenSet { digest, count, published_ns, newcomer: None, active: None });
    }

    /// A decision was published.
    pub(crate) fn on_decision(&mut self, decision: &Decision) {
        let is_newcomer = decision.instance == self.newcomer;
        if !is_newcomer && decision.instance != self.active {
            return;
        }
        let answers = if is_newcomer { &mut self.answers_newcomer } else { &mut self.answers_active };
        let Some(set) = self.open.iter_mut().find(|set| set.digest == decision.set_digest) else { return };
        if !decision.value.is_finite() {
            *answers.rubbish.entry("a value that is not finite").or_default() += 1;
            return;
        }
        if decision.best >= set.count {
            *answers.rubbish.entry("a candidate that is none").or_default() += 1;
            return;
        }
        let answer = if is_newcomer { &mut set.newcomer } else { &mut set.active };
        if answer.replace(decision.best).is_some() {
            return;
        }
        let latency_us = decision.header.stamp_ns.saturating_sub(set.published_ns) / 1000;
        answers.latency_us.saturating_record(latency_us);
        answers.value_sum += f64::from(decision.value);
        if let (Some(newcomer), Some(active)) = (set.newcomer, set.active) {
            self.both += 1;
            self.agreed += u64::from(newcomer == active);
        }
    }

    /// Share of the sets that both answered on which they chose the same; nothing if there was none.
    pub(crate) fn agreement(&self) -> Option<f64> {
        (self.both > 0).then(|| self.agreed as f64 / self.both as f64)
    }

    /// Why the newcomer must not be promoted, if there is a reason.
    pub(crate) fn objection(&self, p99_max_us: u64, agreement_min: f64) -> Option<String> {
        if let Some((what, times)) = self.answers_newcomer.rubbish.first_key_value() {
            return Some(format!("it gave {what}, {times} time(s)"));
        }
        let p99_us = self.answers_newcomer.latency_us.value_at_quantile(0.99);
        if p99_us > p99_max_us {
            return Some(format!("it is too slow: p99 {p99_us} us, allowed are {p99_max_us} us (--p99-max-ms)"));
        }
        match self.agreement() {
            Some(share) if share < agreement_min => Some(format!(
                "it agrees on {:.0} % of the sets, wanted are {:.0} % (--agree-min)",
                100.0 * share,
                100.0 * agreement_min
            )),
            None if agreement_min > 0.0 => Some("there was nothing to compare it with (--agree-min)".to_owned()),
            _ => None,
        }
    }
}

impl Answers {
    fn new() -> Self {
        let latency_us = Histogram::new_with_bounds(1, LONGEST_US, 3).expect("the bounds are in order");
        Self { latency_us, value_sum: 0.0, rubbish: BTreeMap::new() }
    }

    /// Mean value of the choices.
    pub(crate) fn mean_value(&self) -> f64 {
        self.value_sum / self.latency_us.len().max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable as _;

    use super::*;

    /// One set with three candidates, published at 1 ms.
    fn shadow() -> Shadow {
        let mut shadow = Shadow::new(1, 0);
        let mut set: Box<CandidateSet> = Box::new(CandidateSet::zeroed());
        (set.digest, set.count, set.header.stamp_ns) = (7, 3, 1_000_000);
        shadow.on_set(&set);
        shadow.on_set(&set);
        shadow
    }

    fn decision(instance: u32, best: u32, value: f32) -> Decision {
        let mut decision = Decision { set_digest: 7, instance, best, value, ..Decision::zeroed() };
        decision.header.stamp_ns = 3_000_000;
        decision
    }

    #[test]
    fn a_set_counts_once_and_both_answers_are_compared() {
        let mut shadow = shadow();
        for decision in [decision(0, 2, 4.0), decision(1, 2, 5.0), decision(1, 1, 9.0), decision(3, 0, 0.0)] {
            shadow.on_decision(&decision);
        }
        assert_eq!((shadow.answered(), shadow.both, shadow.agreement()), (1, 1, Some(1.0)));
        assert_eq!(shadow.answers_newcomer.mean_value(), 5.0);
        assert_eq!(shadow.answers_newcomer.latency_us.max(), 2000);
        assert_eq!(shadow.objection(2000, 1.0), None);
        assert!(shadow.objection(1000, 0.0).unwrap().contains("too slow"));
    }

    #[test]
    fn disagreement_and_rubbish_are_objected_to() {
        let mut disagreeing = shadow();
        disagreeing.on_decision(&decision(0, 2, 4.0));
        assert!(disagreeing.objection(9000, 0.5).unwrap().contains("nothing to compare"));
        disagreeing.on_decision(&decision(1, 0, 4.0));
        assert_eq!(disagreeing.objection(9000, 0.0), None);
        assert!(disagreeing.objection(9000, 0.5).unwrap().contains("agrees on 0 %"));
        for rubbish in [decision(1, 3, 1.0), decision(1, 0, f32::NAN)] {
            let mut shadow = shadow();
            shadow.on_decision(&rubbish);
            assert_eq!(shadow.answered(), 0);
            assert!(shadow.objection(9000, 0.0).unwrap().starts_with("it gave a"));
        }
    }
}
