//! The commander alone, in a time that the tests make.

use bytemuck::Zeroable;
use messages::Header;
use packing::{ContainerSize, WalleWeights, corner_candidates};

use super::*;

const MS: u64 = 1_000_000;
const OBSERVED: u64 = 1_000 * MS;

/// A cell whose perception and generator are this struct.
struct Bench {
    commander: Commander,
    grid: Grid,
    set: Box<CandidateSet>,
}

impl Bench {
    fn new(close: ClosePolicy) -> Self {
        let deadlines = Deadlines { soft_ns: 12 * MS, hard_ns: 25 * MS };
        let grid = Grid::new(ContainerSize::new(6, 6, 6, 10).unwrap(), 2).unwrap();
        Self { commander: Commander::new(deadlines, close, 0), grid, set: Box::new(Zeroable::zeroed()) }
    }

    /// Shows the commander the belief and the candidates of a box, 1 ms after it was observed.
    fn observe(&mut self, id: u64, size_mm: [u32; 3]) -> Option<Order> {
        let mut belief: Box<Belief> = Box::new(Zeroable::zeroed());
        belief.write(&self.grid);
        self.commander.on_belief(&belief);
        let spec = BoxSpec::new(id, size_mm).unwrap();
        let mut candidates = Vec::new();
        corner_candidates(&self.grid, spec.extent(10), &WalleWeights::PAPER, &mut candidates);
        self.set.header = Header { observed_ns: OBSERVED, ..Header::default() };
        (self.set.current, self.set.revision) = (spec.into(), self.grid.revision());
        self.set.write_candidates(&candidates);
        self.commander.on_candidates(&self.set, OBSERVED + MS)
    }

    fn decision(&self, instance: u32, best: u32) -> Decision {
        let (box_id, revision, set_digest) = (self.set.current.id, self.set.revision, self.set.digest);
        Decision { box_id, revision, set_digest, instance, best, model: 7, ..Decision::zeroed() }
    }

    /// What the arm says after it did as ordered.
    fn motion(order: &Order) -> MotionReport {
        let CycleReport { spec, revision, action, .. } = order.report;
        MotionReport { box_id: spec.id, revision, action, ..MotionReport::zeroed() }
    }

    fn refused(&self) -> u64 {
        self.commander.tally().counters.refused
    }
}

fn chosen(order: Option<Order>) -> (ChosenBy, Action, WirePlacement) {
    let report = order.expect("an order").report;
    (ChosenBy::from_wire(report.chosen_by).unwrap(), Action::from_wire(report.action).unwrap(), report.placement)
}

#[test]
fn the_active_instance_is_obeyed_at_once() {
    let mut bench = Bench::new(ClosePolicy::Never);
    assert_eq!(bench.observe(1, [20, 30, 20]), None);
    let order = bench.commander.on_decision(&bench.decision(0, 3), OBSERVED + 2 * MS);
    let placement = bench.set.candidates[3].placement;
    assert_eq!(chosen(order), (ChosenBy::Model, Action::Place, placement));
    assert_eq!(bench.commander.wake_ns(), None);
    // A second opinion on a decided box changes nothing.
    assert_eq!(bench.commander.on_decision(&bench.decision(1, 2), OBSERVED + 3 * MS), None);
}

#[test]
fn new_rules_hold_for_the_box_that_waits() {
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(1, [20, 30, 20]);
    bench.commander.set_rules(Deadlines { soft_ns: 5 * MS, hard_ns: 6 * MS }, ClosePolicy::Fullest);
    assert_eq!(bench.commander.wake_ns(), Some(OBSERVED + 6 * MS));
    let order = bench.commander.on_time(OBSERVED + 6 * MS);
    assert_eq!(chosen(order).0, ChosenBy::Fallback);
}

#[test]
fn a_standby_is_obeyed_after_the_soft_deadline() {
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(1, [20, 30, 20]);
    assert_eq!(bench.commander.on_decision(&bench.decision(1, 2), OBSERVED + 2 * MS), None);
    assert_eq!(bench.commander.wake_ns(), Some(OBSERVED + 12 * MS));
    assert_eq!(bench.commander.on_time(OBSERVED + 12 * MS - 1), None);
    let order = bench.commander.on_time(OBSERVED + 12 * MS);
    assert_eq!(chosen(order), (ChosenBy::Standby, Action::Place, bench.set.candidates[2].placement));
}

#[test]
fn a_standby_that_answers_after_the_soft_deadline_is_obeyed_at_once() {
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(1, [20, 30, 20]);
    let order = bench.commander.on_decision(&bench.decision(1, 2), OBSERVED + 13 * MS);
    assert_eq!(chosen(order).0, ChosenBy::Standby);
}

#[test]
fn the_active_instance_overtakes_a_waiting_standby() {
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(1, [20, 30, 20]);
    bench.commander.on_decision(&bench.decision(1, 2), OBSERVED + 2 * MS);
    let order = bench.commander.on_decision(&bench.decision(0, 3), OBSERVED + 5 * MS);
    assert_eq!(chosen(order).0, ChosenBy::Model);
}

#[test]
fn walles_ranking_is_taken_at_the_hard_deadline() {
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(1, [20, 30, 20]);
    assert_eq!(bench.commander.wake_ns(), Some(OBSERVED + 25 * MS));
    let order = bench.commander.on_time(OBSERVED + 25 * MS);
    let best = Heuristic::walle_choice(&bench.commander.candidates).unwrap();
    assert_eq!(chosen(order), (ChosenBy::Fallback, Action::Place, bench.set.candidates[best].placement));
}

#[test]
fn an_observation_that_is_late_already_is_decided_at_once() {
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(1, [20, 30, 20]);
    let mut restarted = Bench::new(ClosePolicy::Never);
    restarted.observe(2, [10, 10, 10]);
    restarted.set = bench.set;
    let order = restarted.commander.on_candidates(&restarted.set, OBSERVED + 300 * MS);
    assert_eq!(chosen(order).0, ChosenBy::Fallback);
}

#[test]
fn nonsense_is_refused_and_the_deadline_decides() {
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(1, [20, 30, 20]);
    let good = bench.decision(0, 1);
    let nonsense = [
        Decision { best: 99, ..good },
        Decision { value: f32::NAN, ..good },
        Decision { value: f32::INFINITY, ..good },
        Decision { instance: 8, ..good },
    ];
    for decision in &nonsense {
        assert_eq!(bench.commander.on_decision(decision, OBSERVED + 2 * MS), None);
    }
    assert_eq!(bench.refused(), 4);
    let of_another =
        [Decision { box_id: 2, ..good }, Decision { revision: 1, ..good }, Decision { set_digest: 1, ..good }];
    for decision in &of_another {
        assert_eq!(bench.commander.on_decision(decision, OBSERVED + 2 * MS), None);
    }
    assert_eq!((bench.refused(), bench.commander.tally().counters.stale), (4, 3));
    assert_eq!(chosen(bench.commander.on_time(OBSERVED + 25 * MS)).0, ChosenBy::Fallback);
}

#[test]
fn a_set_that_breaks_the_rules_is_never_commanded() {
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(1, [20, 30, 20]);
    // A generator that would put the box through the wall, everywhere.
    let floating = |slot| Placement { slot, yaw: Yaw::Deg0, i: 5, j: 0, base: 0 };
    bench.set.write_candidates(&[0, 1].map(|slot| Candidate { placement: floating(slot), walle: 1.0 }));
    bench.commander.on_candidates(&bench.set, OBSERVED + MS);
    assert_eq!(bench.commander.on_decision(&bench.decision(0, 0), OBSERVED + 2 * MS), None);
    assert_eq!(bench.commander.on_time(OBSERVED + 25 * MS), None);
    assert_eq!(bench.refused(), 3, "the decision, and the fallback's two");
    assert_eq!(bench.commander.wake_ns(), None);
}

#[test]
fn sets_of_another_revision_and_stamps_from_the_future_do_not_delay() {
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(1, [20, 30, 20]);
    let mut future = bench.set.clone();
    future.revision = 9;
    assert_eq!(bench.commander.on_candidates(&future, OBSERVED + MS), None);
    assert_eq!(bench.commander.tally().counters.stale, 1);
    assert_eq!(bench.commander.wake_ns(), Some(OBSERVED + 25 * MS));
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(2, [20, 30, 20]);
    bench.set.current.id = 3;
    bench.set.header.observed_ns = u64::MAX;
    let candidates = bench.commander.candidates.clone();
    bench.set.write_candidates(&candidates);
    bench.commander.on_candidates(&bench.set, OBSERVED + MS);
    assert_eq!(bench.commander.wake_ns(), Some(OBSERVED + 26 * MS));
}

#[test]
fn a_box_that_fits_nowhere_is_set_aside_or_makes_a_container_leave() {
    let too_tall = [10, 10, 70];
    let order = Bench::new(ClosePolicy::Fullest).observe(1, too_tall);
    assert_eq!(chosen(order).1, Action::SetAside);
    for (close, action) in [(ClosePolicy::Never, Action::SetAside), (ClosePolicy::Fullest, Action::Replace)] {
        let mut bench = Bench::new(close);
        for (slot, height) in [(0, 50), (1, 60)] {
            let spec = BoxSpec::new(9, [60, 60, height]).unwrap();
            bench.grid.place(&spec, Placement { slot, yaw: Yaw::Deg0, i: 0, j: 0, base: 0 }).unwrap();
        }
        let (by, found, placement) = chosen(bench.observe(1, [20, 30, 20]));
        assert_eq!((by, found), (ChosenBy::Rules, action));
        assert_eq!(placement.slot, if action == Action::Replace { 1 } else { 0 });
    }
}

#[test]
fn a_repeated_set_repeats_the_command_until_the_arm_reports() {
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(1, [20, 30, 20]);
    let order = bench.commander.on_decision(&bench.decision(0, 3), OBSERVED + 2 * MS).unwrap();
    bench.commander.on_commanded(OBSERVED + 3 * MS);
    let repeated = bench.commander.on_candidates(&bench.set, OBSERVED + 20 * MS).unwrap();
    assert_eq!((repeated.spec(), repeated.placement()), (order.spec(), order.placement()));
    bench.commander.on_commanded(OBSERVED + 21 * MS);
    let report = bench.commander.on_motion(&Bench::motion(&order)).unwrap();
    assert_eq!(report.stamps.command_published_ns, OBSERVED + 3 * MS, "the first publication counts");
    assert_eq!(bench.commander.on_motion(&Bench::motion(&order)), None, "a motion is reported once");
}

#[test]
fn a_refused_motion_lets_the_box_be_decided_again() {
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(1, [20, 30, 20]);
    let order = bench.commander.on_decision(&bench.decision(0, 3), OBSERVED + 2 * MS).unwrap();
    let refused = MotionReport { outcome: MotionOutcome::Refused.to_wire(), ..Bench::motion(&order) };
    let report = bench.commander.on_motion(&refused).unwrap();
    assert_eq!(report.outcome, MotionOutcome::Refused.to_wire());
    assert_eq!(bench.commander.on_candidates(&bench.set, OBSERVED + 4 * MS), None);
    assert_eq!(chosen(bench.commander.on_decision(&bench.decision(0, 3), OBSERVED + 5 * MS)).0, ChosenBy::Model);
}
