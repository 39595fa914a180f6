//! The commander alone, in a time that the tests make.

use std::convert::Infallible;
use std::io;

use bytemuck::Zeroable;
use messages::{Header, PlaceCommand, WirePlacement};
use packing::{ContainerSize, corner_candidates};

use super::*;

const MS: u64 = 1_000_000;
const OBSERVED: u64 = 1_000 * MS;

/// Everything that a commander did, in the order in which it did it.
#[derive(Default)]
struct Deeds {
    done: Vec<Deed>,
    is_disk_full: bool,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Deed {
    Wrote(Record),
    Commanded(Order),
    Reported(CycleReport),
}

impl Effects for Deeds {
    type Error = Infallible;

    fn append(&mut self, record: &Record) -> Result<(), AppendError> {
        if self.is_disk_full {
            return Err(AppendError::Write { path: "/full/journal.bin".into(), source: io::Error::other("full") });
        }
        self.done.push(Deed::Wrote(*record));
        Ok(())
    }

    fn command(&mut self, order: &Order) -> Result<u64, Infallible> {
        self.done.push(Deed::Commanded(*order));
        Ok(OBSERVED + 3 * MS)
    }

    fn report(&mut self, report: &CycleReport) -> Result<(), Infallible> {
        self.done.push(Deed::Reported(*report));
        Ok(())
    }
}

/// A cell whose perception and generator are this struct.
struct Bench {
    commander: Commander,
    deeds: Deeds,
    grid: Grid,
    queue: BoxQueue,
    set: Box<CandidateSet>,
}

impl Bench {
    fn new(close: ClosePolicy) -> Self {
        Self::from(close, &State::default())
    }

    fn from(close: ClosePolicy, state: &State) -> Self {
        let deadlines = Deadlines { soft_ns: 12 * MS, hard_ns: 25 * MS };
        let grid = Grid::new(ContainerSize::new(6, 6, 6, 10).unwrap(), 2).unwrap();
        let commander = Commander::new(deadlines, close, state, OBSERVED);
        let (deeds, queue) = (Deeds::default(), BoxQueue::zeroed());
        Self { commander, deeds, grid, queue, set: Box::new(Zeroable::zeroed()) }
    }

    /// Shows the commander the belief, the belt and the candidates of a box, 1 ms after it was observed.
    fn observe(&mut self, id: u64, size_mm: [u32; 3]) -> Option<Order> {
        let mut belief: Box<Belief> = Box::new(Zeroable::zeroed());
        belief.write(&self.grid);
        self.commander.on_belief(&belief);
        let spec = BoxSpec::new(id, size_mm).unwrap();
        (self.queue.current, self.queue.revision) = (spec.into(), self.grid.revision());
        (self.queue.belt, self.queue.header.observed_ns) = (BeltState::BoxPresent.to_wire(), OBSERVED);
        let mut candidates = Vec::new();
        corner_candidates(&self.grid, spec.extent(10), &WalleWeights::PAPER, &mut candidates);
        self.set.header = Header { observed_ns: OBSERVED, ..Header::default() };
        (self.set.current, self.set.revision) = (spec.into(), self.grid.revision());
        self.set.write_candidates(&candidates);
        self.look(OBSERVED + MS)
    }

    /// What the commander orders when it sees belt and candidates at `now_ns`.
    fn look(&mut self, now_ns: u64) -> Option<Order> {
        let before = self.deeds.done.len();
        self.commander.on_boxes(&self.queue, now_ns, &mut self.deeds).unwrap();
        self.commander.on_candidates(&self.set, now_ns, &mut self.deeds).unwrap();
        self.commanded_since(before)
    }

    fn decide(&mut self, decision: &Decision, now_ns: u64) -> Option<Order> {
        let before = self.deeds.done.len();
        self.commander.on_decision(decision, now_ns, &mut self.deeds).unwrap();
        self.commanded_since(before)
    }

    fn decide_as(&mut self, instance: u32, best: u32, now_ns: u64) -> Option<Order> {
        let decision = self.decision(instance, best);
        self.decide(&decision, now_ns)
    }

    fn wait(&mut self, now_ns: u64) -> Option<Order> {
        let before = self.deeds.done.len();
        self.commander.on_time(now_ns, &mut self.deeds).unwrap();
        self.commanded_since(before)
    }

    /// What the commander reports when the arm does.
    fn report(&mut self, motion: &MotionReport) -> Option<CycleReport> {
        let before = self.deeds.done.len();
        self.commander.on_motion(motion, &mut self.deeds).unwrap();
        self.deeds.done[before..].iter().find_map(|deed| match deed {
            Deed::Reported(report) => Some(*report),
            Deed::Wrote(_) | Deed::Commanded(_) => None,
        })
    }

    fn commanded_since(&self, before: usize) -> Option<Order> {
        self.deeds.done[before..].iter().find_map(|deed| match deed {
            Deed::Commanded(order) => Some(*order),
            Deed::Wrote(_) | Deed::Reported(_) => None,
        })
    }

    /// The journal that a commander after this one finds.
    fn journal(&self) -> State {
        let written = self.deeds.done.iter().filter_map(|deed| match deed {
            Deed::Wrote(record) => Some(record),
            Deed::Commanded(_) | Deed::Reported(_) => None,
        });
        written.fold(State::default(), |state, record| state.after(record))
    }

    fn decision(&self, instance: u32, best: u32) -> Decision {
        let (box_id, revision, set_digest) = (self.set.current.id, self.set.revision, self.set.digest);
        Decision { box_id, revision, set_digest, instance, best, model: 7, ..Decision::zeroed() }
    }

    /// What the arm says after it did as ordered.
    fn motion(order: &Order) -> MotionReport {
        let mut command = PlaceCommand::zeroed();
        order.write(&mut command);
        let PlaceCommand { order, spec, revision, action, .. } = command;
        MotionReport { order, box_id: spec.id, revision, action, ..MotionReport::zeroed() }
    }

    fn refused(&self) -> u64 {
        self.commander.tally().counters.refused
    }
}

fn chosen(order: Option<Order>) -> (ChosenBy, Action, WirePlacement) {
    let order = order.expect("an order");
    (order.intent().chosen_by, order.action(), order.placement())
}

#[test]
fn the_active_instance_is_obeyed_at_once() {
    let mut bench = Bench::new(ClosePolicy::Never);
    assert_eq!(bench.observe(1, [20, 30, 20]), None);
    let order = bench.decide_as(0, 3, OBSERVED + 2 * MS);
    let placement = bench.set.candidates[3].placement;
    assert_eq!(chosen(order), (ChosenBy::Model, Action::Place, placement));
    assert_eq!(bench.commander.wake_ns(), None);
    // A second opinion on a decided box changes nothing.
    assert_eq!(bench.decide_as(1, 2, OBSERVED + 3 * MS), None);
}

#[test]
fn new_rules_hold_for_the_box_that_waits() {
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(1, [20, 30, 20]);
    bench.commander.set_rules(Deadlines { soft_ns: 5 * MS, hard_ns: 6 * MS }, ClosePolicy::Fullest);
    assert_eq!(bench.commander.wake_ns(), Some(OBSERVED + 6 * MS));
    let order = bench.wait(OBSERVED + 6 * MS);
    assert_eq!(chosen(order).0, ChosenBy::Fallback);
}

#[test]
fn a_standby_is_obeyed_after_the_soft_deadline() {
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(1, [20, 30, 20]);
    assert_eq!(bench.decide_as(1, 2, OBSERVED + 2 * MS), None);
    assert_eq!(bench.commander.wake_ns(), Some(OBSERVED + 12 * MS));
    assert_eq!(bench.wait(OBSERVED + 12 * MS - 1), None);
    let order = bench.wait(OBSERVED + 12 * MS);
    assert_eq!(chosen(order), (ChosenBy::Standby, Action::Place, bench.set.candidates[2].placement));
}

#[test]
fn a_standby_that_answers_after_the_soft_deadline_is_obeyed_at_once() {
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(1, [20, 30, 20]);
    let order = bench.decide_as(1, 2, OBSERVED + 13 * MS);
    assert_eq!(chosen(order).0, ChosenBy::Standby);
}

#[test]
fn the_active_instance_overtakes_a_waiting_standby() {
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(1, [20, 30, 20]);
    bench.decide_as(1, 2, OBSERVED + 2 * MS);
    let order = bench.decide_as(0, 3, OBSERVED + 5 * MS);
    assert_eq!(chosen(order).0, ChosenBy::Model);
}

#[test]
fn walles_ranking_is_taken_at_the_hard_deadline() {
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(1, [20, 30, 20]);
    assert_eq!(bench.commander.wake_ns(), Some(OBSERVED + 25 * MS));
    let order = bench.wait(OBSERVED + 25 * MS);
    let best = Heuristic::walle_choice(&bench.commander.candidates).unwrap();
    assert_eq!(chosen(order), (ChosenBy::Fallback, Action::Place, bench.set.candidates[best].placement));
}

#[test]
fn an_observation_that_is_late_already_is_decided_at_once() {
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(1, [20, 30, 20]);
    bench.commander = Commander::new(bench.commander.deadlines, ClosePolicy::Never, &State::default(), OBSERVED);
    let mut belief: Box<Belief> = Box::new(Zeroable::zeroed());
    belief.write(&bench.grid);
    bench.commander.on_belief(&belief);
    assert_eq!(chosen(bench.look(OBSERVED + 300 * MS)).0, ChosenBy::Fallback);
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
        assert_eq!(bench.decide(decision, OBSERVED + 2 * MS), None);
    }
    assert_eq!(bench.refused(), 4);
    let of_another =
        [Decision { box_id: 2, ..good }, Decision { revision: 1, ..good }, Decision { set_digest: 1, ..good }];
    for decision in &of_another {
        assert_eq!(bench.decide(decision, OBSERVED + 2 * MS), None);
    }
    assert_eq!((bench.refused(), bench.commander.tally().counters.stale), (4, 3));
    assert_eq!(chosen(bench.wait(OBSERVED + 25 * MS)).0, ChosenBy::Fallback);
}

#[test]
fn a_set_that_breaks_the_rules_is_never_commanded() {
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(1, [20, 30, 20]);
    // A generator that would put the box through the wall, everywhere.
    let floating = |slot| Placement { slot, yaw: Yaw::Deg0, i: 5, j: 0, base: 0 };
    bench.set.write_candidates(&[0, 1].map(|slot| Candidate { placement: floating(slot), walle: 1.0 }));
    bench.look(OBSERVED + MS);
    assert_eq!(bench.decide_as(0, 0, OBSERVED + 2 * MS), None);
    assert_eq!(bench.wait(OBSERVED + 25 * MS), None);
    assert_eq!(bench.refused(), 3, "the decision, and the fallback's two");
    assert_eq!(bench.commander.wake_ns(), None);
}

#[test]
fn sets_of_another_box_or_revision_and_stamps_from_the_future_do_not_delay() {
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(1, [20, 30, 20]);
    bench.set.revision = 9;
    assert_eq!(bench.look(OBSERVED + MS), None);
    (bench.set.revision, bench.set.current.id) = (0, 2);
    assert_eq!(bench.look(OBSERVED + MS), None);
    assert_eq!(bench.commander.tally().counters.stale, 2);
    assert_eq!(bench.commander.wake_ns(), Some(OBSERVED + 25 * MS));
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(2, [20, 30, 20]);
    bench.queue.header.observed_ns = u64::MAX;
    bench.look(OBSERVED + 2 * MS);
    bench.look(OBSERVED + 9 * MS);
    assert_eq!(bench.commander.wake_ns(), Some(OBSERVED + 27 * MS), "it was seen when it was first heard of");
}

#[test]
fn an_empty_set_is_not_believed_when_the_box_fits() {
    let mut bench = Bench::new(ClosePolicy::Fullest);
    bench.observe(1, [20, 30, 20]);
    let mut lying = Bench::new(ClosePolicy::Fullest);
    lying.observe(9, [10, 10, 10]);
    (lying.queue, lying.set) = (bench.queue, bench.set);
    lying.set.write_candidates(&[]);
    assert_eq!(lying.look(OBSERVED + MS), None);
    assert_eq!(lying.refused(), 1);
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
fn an_order_is_written_down_before_it_is_commanded_and_over_before_it_is_reported() {
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(1, [20, 30, 20]);
    let order = bench.decide_as(0, 3, OBSERVED + 2 * MS).unwrap();
    let report = bench.report(&Bench::motion(&order)).unwrap();
    let outcome = Outcome { order: 1, outcome: MotionOutcome::Done };
    let deeds = [
        Deed::Wrote(Record::Intent(*order.intent())),
        Deed::Commanded(order),
        Deed::Wrote(Record::Outcome(outcome)),
        Deed::Reported(report),
    ];
    assert_eq!(bench.deeds.done[0], deeds[0]);
    assert!(matches!(bench.deeds.done[1], Deed::Commanded(commanded) if commanded.intent() == order.intent()));
    assert_eq!(bench.deeds.done[2..], deeds[2..]);
    assert_eq!(report.order, 1);
}

#[test]
fn a_repeated_set_repeats_the_command_until_the_arm_reports() {
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(1, [20, 30, 20]);
    let order = bench.decide_as(0, 3, OBSERVED + 2 * MS).unwrap();
    let repeated = bench.look(OBSERVED + 20 * MS).unwrap();
    assert_eq!(repeated.intent(), order.intent());
    let report = bench.report(&Bench::motion(&order)).unwrap();
    assert_eq!(report.stamps.command_published_ns, OBSERVED + 3 * MS, "the first publication counts");
    assert_eq!(bench.report(&Bench::motion(&order)), None, "a motion is reported once");
}

#[test]
fn a_refused_motion_lets_the_box_be_decided_again_but_not_for_ever() {
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(1, [20, 30, 20]);
    for number in 1..=u64::from(REFUSALS_MAX) {
        let order = bench.decide_as(0, 3, OBSERVED + 2 * MS).unwrap();
        assert_eq!((order.action(), order.intent().order), (Action::Place, number));
        let refused = MotionReport { outcome: MotionOutcome::Refused.to_wire(), ..Bench::motion(&order) };
        assert_eq!(bench.report(&refused).unwrap().outcome, MotionOutcome::Refused.to_wire());
        if number < u64::from(REFUSALS_MAX) {
            assert_eq!(bench.look(OBSERVED + 4 * MS), None);
        }
    }
    assert_eq!(chosen(bench.look(OBSERVED + 5 * MS)).1, Action::SetAside);
}

#[test]
fn nothing_is_commanded_that_cannot_be_written_down() {
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(1, [20, 30, 20]);
    bench.deeds.is_disk_full = true;
    assert_eq!(bench.decide_as(0, 3, OBSERVED + 2 * MS), None);
    assert_eq!(bench.commander.wake_ns(), None, "it waits for the next repetition and not in a busy loop");
    assert_eq!(bench.look(OBSERVED + 20 * MS), None);
    bench.deeds.is_disk_full = false;
    let order = bench.decide_as(0, 3, OBSERVED + 21 * MS).unwrap();
    // The disk is full again when the arm reports: the next box waits until the outcome is written.
    bench.deeds.is_disk_full = true;
    assert_eq!(bench.report(&Bench::motion(&order)), None);
    assert_eq!(bench.observe(2, [10, 10, 10]), None);
    assert_eq!(bench.decide_as(0, 0, OBSERVED + 22 * MS), None);
    bench.deeds.is_disk_full = false;
    bench.look(OBSERVED + 23 * MS);
    assert!(bench.journal().open().is_none());
    assert_eq!(bench.decide_as(0, 0, OBSERVED + 24 * MS).unwrap().intent().order, 2);
}

#[test]
fn a_restarted_commander_says_the_open_order_again_and_gives_no_other() {
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(1, [20, 30, 20]);
    let order = bench.decide_as(0, 3, OBSERVED + 2 * MS).unwrap();
    let mut restarted = Bench::from(ClosePolicy::Never, &bench.journal());
    let repeated = restarted.observe(1, [20, 30, 20]).unwrap();
    assert_eq!(repeated.intent(), order.intent());
    assert_eq!(restarted.deeds.done.len(), 1, "it is written down already");
    assert_eq!(restarted.decide_as(0, 1, OBSERVED + 4 * MS), None);
    assert_eq!(restarted.report(&Bench::motion(&order)).unwrap().order, 1);
    restarted.observe(2, [10, 10, 10]);
    assert_eq!(restarted.decide_as(0, 0, OBSERVED + 5 * MS).unwrap().intent().order, 2);
}

#[test]
fn an_order_whose_motion_nobody_reported_is_over_when_another_box_lies_there() {
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(1, [20, 30, 20]);
    bench.decide_as(0, 3, OBSERVED + 2 * MS).unwrap();
    bench.observe(2, [10, 10, 10]);
    assert_eq!(bench.journal().last.unwrap().1, Some(MotionOutcome::Unreported));
    assert_eq!(bench.decide_as(0, 0, OBSERVED + 5 * MS).unwrap().intent().order, 2);
}

#[test]
fn a_restarted_commander_says_the_last_report_again() {
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(1, [20, 30, 20]);
    let order = bench.decide_as(0, 3, OBSERVED + 2 * MS).unwrap();
    let report = bench.report(&Bench::motion(&order)).unwrap();
    let state = bench.journal();
    let mut restarted = Bench::from(ClosePolicy::Never, &state);
    restarted.commander.begin(&state, OBSERVED, &mut restarted.deeds).unwrap();
    let [Deed::Reported(again)] = restarted.deeds.done[..] else { panic!("{:?}", restarted.deeds.done) };
    assert_eq!((again.order, again.spec, again.outcome), (report.order, report.spec, report.outcome));
}

#[test]
fn a_promoted_instance_is_obeyed_and_stays_promoted() {
    let mut bench = Bench::new(ClosePolicy::Never);
    let promote = |instance| Control { request: 5, wish: Wish::Promote.to_wire(), instance, ..Control::zeroed() };
    assert!(bench.commander.on_control(&promote(1), &mut bench.deeds));
    assert!(bench.commander.on_control(&promote(1), &mut bench.deeds), "asked again, answered again");
    assert_eq!((bench.commander.active(), bench.deeds.done.len()), ((1, 5), 1));
    let rubbish = [promote(8), Control { wish: 9, ..promote(1) }];
    for control in &rubbish {
        assert!(!bench.commander.on_control(control, &mut bench.deeds));
    }
    assert_eq!(bench.refused(), 2);
    bench.observe(1, [20, 30, 20]);
    assert_eq!(bench.decide_as(0, 3, OBSERVED + 2 * MS), None, "the old one is a standby now");
    assert_eq!(chosen(bench.decide_as(1, 3, OBSERVED + 2 * MS)).0, ChosenBy::Model);
    let restarted = Bench::from(ClosePolicy::Never, &bench.journal());
    assert_eq!(restarted.commander.active().0, 1);
}

#[test]
fn who_chose_and_why_is_reported() {
    let why = |bench: &mut Bench, order: Option<Order>| {
        let report = bench.report(&Bench::motion(&order.unwrap())).unwrap();
        (ChosenBy::from_wire(report.chosen_by).unwrap(), Why::from_wire(report.why).unwrap())
    };
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(1, [20, 30, 20]);
    let order = bench.decide_as(0, 3, OBSERVED + 2 * MS);
    assert_eq!(why(&mut bench, order), (ChosenBy::Model, Why::InTime));
    bench.observe(2, [10, 10, 10]);
    let order = bench.wait(OBSERVED + 25 * MS);
    assert_eq!(why(&mut bench, order), (ChosenBy::Fallback, Why::Silent));
    bench.observe(3, [10, 10, 10]);
    assert_eq!(bench.decide_as(0, 99, OBSERVED + 2 * MS), None);
    bench.decide_as(1, 0, OBSERVED + 2 * MS);
    let order = bench.wait(OBSERVED + 12 * MS);
    assert_eq!(why(&mut bench, order), (ChosenBy::Standby, Why::Refused));
}

/// Found by the simulation: perception died between saying the motion and saying the belief.
#[test]
fn a_box_that_was_moved_is_not_ordered_again_while_the_old_belief_still_shows_it() {
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(1, [20, 30, 20]);
    let order = bench.decide_as(0, 3, OBSERVED + 2 * MS).unwrap();
    bench.report(&Bench::motion(&order)).unwrap();
    assert_eq!(bench.look(OBSERVED + 20 * MS), None);
    assert_eq!(bench.wait(OBSERVED + 30 * MS), None);
    let mut restarted = Bench::from(ClosePolicy::Never, &bench.journal());
    assert_eq!(restarted.observe(1, [20, 30, 20]), None);
    assert_eq!(restarted.wait(OBSERVED + 30 * MS), None);
}

/// Found by the simulation: the last box of a stream, and a disk that was full for a moment.
#[test]
fn an_outcome_that_could_not_be_written_down_is_tried_again_without_an_event() {
    let mut bench = Bench::new(ClosePolicy::Never);
    bench.observe(1, [20, 30, 20]);
    let order = bench.decide_as(0, 3, OBSERVED + 2 * MS).unwrap();
    bench.deeds.is_disk_full = true;
    bench.report(&Bench::motion(&order));
    bench.deeds.is_disk_full = false;
    bench.wait(OBSERVED + 50 * MS);
    assert_eq!(bench.journal().last.unwrap().1, Some(MotionOutcome::Done));
}

#[test]
fn when_a_box_was_due_is_reported_and_delays_no_deadline() {
    for (said_ns, due_ns) in [(OBSERVED - 90 * MS, OBSERVED - 90 * MS), (u64::MAX, OBSERVED)] {
        let mut bench = Bench::new(ClosePolicy::Never);
        bench.queue.due_ns = said_ns;
        assert_eq!(bench.observe(1, [20, 20, 20]), None);
        assert_eq!(bench.wait(OBSERVED + 24 * MS), None, "a box that waited has the time of any other");
        let order = bench.wait(OBSERVED + 25 * MS).unwrap();
        let report = bench.report(&Bench::motion(&order)).unwrap();
        assert_eq!((report.stamps.due_ns, report.stamps.observed_ns), (due_ns, OBSERVED));
    }
}
