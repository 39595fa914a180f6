//! Candidate set and decisions to one command: the only process that causes effects.
//!
//! For every box the commander obeys, in this order: the active scorer instance; after the soft deadline, any
//! instance; after the hard deadline, WallE's ranking, which lies in the candidate set already. Whoever chose, the
//! placement is checked against the belief before it is commanded. An empty set is answered by the rules: the close
//! policy makes room, or the box is set aside.
//!
//! Every order is written down before it is commanded, and its end before anything else is ordered ([`Effects`]). A
//! commander that starts with what an earlier one wrote knows which order is open: it says that command again while
//! the box lies there, and never another one for it.

mod cycle_log;
mod order;

use journal::{AppendError, Intent, Outcome, Record, State};
use messages::topics::SCORERS_MAX;
use messages::{
    Action, Belief, BeltState, BoxQueue, CANDIDATES_MAX, CandidateSet, ChosenBy, Control, CycleReport, Decision,
    GridCopy, Malformed, MotionOutcome, MotionReport, Stamps, Why, Wish,
};
use packing::{
    BoxSpec, Candidate, ClosePolicy, Grid, Heuristic, PlaceError, Placement, WalleWeights, Yaw, corner_candidates,
};
use runtime::{CommanderConfig, Tally};

pub use cycle_log::CycleLog;

pub use order::Order;
use order::Origin;

const NS_PER_MS: u64 = 1_000_000;

/// How often the arm may refuse to place one box; then the box is set aside.
const REFUSALS_MAX: u32 = 3;

/// When the commander stops waiting, counted from the observation.
#[derive(Clone, Copy, Debug)]
pub struct Deadlines {
    /// After this, any instance's decision is taken [ns].
    pub soft_ns: u64,
    /// After this, WallE's ranking is taken [ns].
    pub hard_ns: u64,
}

/// What a commander does to the world, in the order in which it does it.
pub trait Effects {
    /// What ends the commander: a bus that failed.
    type Error;

    /// Writes down what must not be forgotten.
    ///
    /// # Errors
    /// [`AppendError`] if it could not be written; nothing is ordered then.
    fn append(&mut self, record: &Record) -> Result<(), AppendError>;

    /// Tells the arm, or tells it again; when that was [ns].
    ///
    /// # Errors
    /// [`Effects::Error`].
    fn command(&mut self, order: &Order) -> Result<u64, Self::Error>;

    /// Tells whoever watches how an order went.
    ///
    /// # Errors
    /// [`Effects::Error`].
    fn report(&mut self, report: &CycleReport) -> Result<(), Self::Error>;
}

/// The commander's state between two events.
#[derive(Debug)]
pub struct Commander {
    deadlines: Deadlines,
    close: ClosePolicy,
    /// The scorer instance that is obeyed first.
    active: u32,
    /// The request of an operator that was answered last.
    answered: u64,
    grid: GridCopy,
    /// The box that lies at the pick position.
    present: Option<Present>,
    /// The box that waits for a decision.
    pending: Option<Pending>,
    /// The candidates of the pending box.
    candidates: Vec<Candidate>,
    next_order: u64,
    /// The order whose end is not written down.
    ordered: Option<Ordered>,
    /// The box and the revision of the last order that is over and was not refused: nothing more is ordered for them,
    /// even if belt and belief still show them because their successors are not published yet.
    over: Option<(u64, u64)>,
    /// The box that the arm refused to place last, and how often.
    refused: Option<(u64, u32)>,
    tally: Tally,
}

/// A box at the pick position, as perception sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Present {
    spec: BoxSpec,
    revision: u64,
    /// When perception says that it saw it [ns].
    said_ns: u64,
    /// The same, but never later than when it was heard [ns].
    observed_ns: u64,
    /// When the box was due, never later than it was observed [ns].
    due_ns: u64,
}

/// A box that waits for a decision.
#[derive(Clone, Copy, Debug)]
struct Pending {
    present: Present,
    set_digest: u64,
    left_out: u32,
    stamps: Stamps,
    /// The first decision of an instance that is not active, kept until the soft deadline.
    standby: Option<Choice>,
    /// Whether an answer of the active instance was refused.
    active_refused: bool,
}

/// An order, and its end as soon as it is known.
#[derive(Clone, Copy, Debug)]
struct Ordered {
    order: Order,
    end: Option<(MotionOutcome, u64)>,
}

/// What to do and where that comes from.
#[derive(Clone, Copy, Debug)]
struct Choice {
    action: Action,
    placement: Placement,
    by: ChosenBy,
    instance: u32,
    model: u64,
    value: f32,
    depth: u32,
    scorer_received_ns: u64,
    decision_published_ns: u64,
    decision_received_ns: u64,
}

/// Why a decision is not followed.
#[derive(Debug, thiserror::Error)]
enum Refusal {
    #[error(transparent)]
    Malformed(#[from] Malformed),
    #[error("instance {instance} chose candidate {best} of {candidates}")]
    NoSuchCandidate { instance: u32, best: u32, candidates: usize },
    #[error("instance {instance} gave a value that is not finite")]
    NotFinite { instance: u32 },
    #[error("the chosen placement breaks a rule: {0}")]
    Infeasible(#[from] PlaceError),
    #[error("the set is empty, and box {0} fits")]
    FalselyEmpty(u64),
}

impl Deadlines {
    /// As configured.
    #[must_use]
    pub fn of(config: &CommanderConfig) -> Self {
        let [soft_ns, hard_ns] = [config.soft_deadline_ms, config.hard_deadline_ms].map(|ms| ms * NS_PER_MS);
        Self { soft_ns, hard_ns }
    }
}

impl Commander {
    /// A commander with these deadlines and this close policy, which goes on from `state` at `now_ns`.
    #[must_use]
    pub fn new(deadlines: Deadlines, close: ClosePolicy, state: &State, now_ns: u64) -> Self {
        let recovered = |intent: &Intent| Ordered { order: Order::recovered(*intent, now_ns), end: None };
        Self {
            deadlines,
            close,
            active: state.active,
            answered: 0,
            grid: GridCopy::default(),
            present: None,
            pending: None,
            candidates: Vec::with_capacity(CANDIDATES_MAX),
            next_order: state.next_order(),
            ordered: state.open().map(recovered),
            over: state
                .last
                .and_then(|(intent, outcome)| is_final(outcome?).then_some((intent.spec.id, intent.revision))),
            refused: None,
            tally: Tally::default(),
        }
    }

    /// Deadlines and a close policy for everything that comes from here on.
    pub fn set_rules(&mut self, deadlines: Deadlines, close: ClosePolicy) {
        (self.deadlines, self.close) = (deadlines, close);
    }

    /// Says again how the last order went: the commander before may have died between writing that down and saying it.
    ///
    /// # Errors
    /// As [`Effects::report`].
    pub fn begin<E: Effects>(&mut self, state: &State, now_ns: u64, effects: &mut E) -> Result<(), E::Error> {
        match state.last {
            Some((intent, Some(outcome))) => effects.report(&Order::recovered(intent, now_ns).report(outcome, 0)),
            _ => Ok(()),
        }
    }

    /// Takes over the belief. A box that waits for a decision on another revision is void.
    pub fn on_belief(&mut self, belief: &Belief) {
        match self.grid.follow(belief) {
            Ok(grid) => {
                let revision = grid.revision();
                self.pending = self.pending.filter(|pending| pending.present.revision == revision);
            }
            Err(malformed) => self.tally.refuse(&malformed),
        }
    }

    /// Takes over what lies on the belt. Motions that were reported before must have been taken over already.
    ///
    /// # Errors
    /// As [`Effects::report`].
    pub fn on_boxes<E: Effects>(&mut self, queue: &BoxQueue, now_ns: u64, effects: &mut E) -> Result<(), E::Error> {
        match self.try_boxes(queue, now_ns) {
            Ok(present) if present != self.present => {
                self.pending = None;
                self.present = present;
            }
            Ok(_) => {}
            Err(malformed) => self.tally.refuse(&malformed),
        }
        if let (Some(present), Some(ordered)) = (self.present, &mut self.ordered)
            && ordered.end.is_none()
            && !ordered.order.is_for(present.spec.id(), present.revision)
        {
            // Another box lies there, or this one before another belief: the order is over, and nobody said how.
            ordered.end = Some((MotionOutcome::Unreported, 0));
        }
        self.end_order(effects)
    }

    fn try_boxes(&self, queue: &BoxQueue, now_ns: u64) -> Result<Option<Present>, Malformed> {
        if queue.belt_state()? != BeltState::BoxPresent {
            return Ok(None);
        }
        let (spec, revision, said_ns) = (queue.current.try_into()?, queue.revision, queue.header.observed_ns);
        let is_repeated = |known: &Present| (known.spec, known.revision, known.said_ns) == (spec, revision, said_ns);
        // A stamp from the future would postpone the deadlines.
        let observed_ns = said_ns.min(now_ns);
        let new = Present { spec, revision, said_ns, observed_ns, due_ns: queue.due_ns.min(observed_ns) };
        Ok(Some(self.present.filter(is_repeated).unwrap_or(new)))
    }

    /// A candidate set came at `now_ns`. Belief, boxes and motions must have been taken over before.
    ///
    /// # Errors
    /// As [`Effects::command`].
    pub fn on_candidates<E: Effects>(
        &mut self,
        set: &CandidateSet,
        now_ns: u64,
        effects: &mut E,
    ) -> Result<(), E::Error> {
        let Some(present) = self.present.filter(|present| {
            (present.spec.id(), present.spec.size_mm(), present.revision)
                == (set.current.id, set.current.size_mm, set.revision)
                && self.grid.grid().is_some_and(|grid| grid.revision() == set.revision)
                && self.over != Some((set.current.id, set.revision))
        }) else {
            self.tally.pass_over();
            return Ok(());
        };
        if let Some(ordered) = &mut self.ordered {
            // The box is still on the belt: the arm may have missed the command. It moves a box once. An order whose
            // end cannot be written down keeps the next one waiting.
            if ordered.end.is_none() {
                let stamp_ns = effects.command(&ordered.order)?;
                ordered.order.commanded(stamp_ns);
            }
            return Ok(());
        }
        match self.take_up(set, present) {
            Ok(()) => self.on_time(now_ns, effects),
            Err(refusal) => {
                self.tally.refuse(&refusal);
                Ok(())
            }
        }
    }

    /// Makes the set's box the one that waits, unless it is already.
    fn take_up(&mut self, set: &CandidateSet, present: Present) -> Result<(), Refusal> {
        if self.pending.is_some_and(|pending| pending.set_digest == set.digest) {
            return Ok(());
        }
        self.pending = None;
        set.read_candidates(&mut self.candidates)?;
        if self.candidates.is_empty() {
            self.check_emptiness(&present.spec)?;
        }
        let stamps = Stamps {
            due_ns: present.due_ns,
            observed_ns: present.observed_ns,
            boxes_published_ns: set.boxes_stamp_ns,
            candidates_received_ns: set.received_ns,
            candidates_published_ns: set.header.stamp_ns,
            ..Stamps::default()
        };
        let (set_digest, left_out) = (set.digest, set.left_out);
        let (standby, active_refused) = (None, false);
        self.pending = Some(Pending { present, set_digest, left_out, stamps, standby, active_refused });
        Ok(())
    }

    /// An empty set lets a container leave, so it is not believed but looked into.
    fn check_emptiness(&mut self, spec: &BoxSpec) -> Result<(), Refusal> {
        if let Some(grid) = self.grid.grid() {
            corner_candidates(grid, grid.extent(spec), &WalleWeights::PAPER, &mut self.candidates);
        }
        if self.candidates.is_empty() {
            Ok(())
        } else {
            self.candidates.clear();
            Err(Refusal::FalselyEmpty(spec.id()))
        }
    }

    /// A decision came at `now_ns`.
    ///
    /// # Errors
    /// As [`Effects::command`].
    pub fn on_decision<E: Effects>(
        &mut self,
        decision: &Decision,
        now_ns: u64,
        effects: &mut E,
    ) -> Result<(), E::Error> {
        let Some(pending) = self.pending.filter(|pending| {
            let present = &pending.present;
            (present.spec.id(), present.revision, pending.set_digest)
                == (decision.box_id, decision.revision, decision.set_digest)
        }) else {
            self.tally.pass_over();
            return Ok(());
        };
        match self.check_decision(&pending, decision, now_ns) {
            Ok(choice) => {
                let soft_ns = pending.present.observed_ns + self.deadlines.soft_ns;
                if choice.by == ChosenBy::Model || now_ns >= soft_ns {
                    return self.order(choice, effects);
                }
                if let Some(pending) = &mut self.pending {
                    pending.standby.get_or_insert(choice);
                }
            }
            Err(refusal) => {
                self.tally.refuse(&refusal);
                if let Some(pending) = self.pending.as_mut().filter(|_| decision.instance == self.active) {
                    pending.active_refused = true;
                }
            }
        }
        Ok(())
    }

    fn check_decision(&self, pending: &Pending, decision: &Decision, now_ns: u64) -> Result<Choice, Refusal> {
        let instance = decision.instance;
        if instance as usize >= SCORERS_MAX {
            return Err(Malformed::Unknown { field: "instance", value: instance }.into());
        }
        if !decision.value.is_finite() {
            return Err(Refusal::NotFinite { instance });
        }
        let (best, candidates) = (decision.best, self.candidates.len());
        let candidate = self.candidates.get(best as usize);
        let placement = candidate.ok_or(Refusal::NoSuchCandidate { instance, best, candidates })?.placement;
        self.check_placement(&pending.present.spec, placement)?;
        Ok(Choice {
            action: Action::Place,
            placement,
            by: if instance == self.active { ChosenBy::Model } else { ChosenBy::Standby },
            instance,
            model: decision.model,
            value: decision.value,
            depth: decision.depth,
            scorer_received_ns: decision.received_ns,
            decision_published_ns: decision.header.stamp_ns,
            decision_received_ns: now_ns,
        })
    }

    fn check_placement(&self, spec: &BoxSpec, placement: Placement) -> Result<(), PlaceError> {
        let no_grid = PlaceError::NoSuchSlot { slot: placement.slot, slots: 0 };
        let grid = self.grid.grid().ok_or(no_grid)?;
        grid.check(grid.extent(spec), placement)
    }

    /// Does what is due at `now_ns`, and tries again what could not be written down.
    ///
    /// # Errors
    /// As [`Effects::command`].
    pub fn on_time<E: Effects>(&mut self, now_ns: u64, effects: &mut E) -> Result<(), E::Error> {
        self.end_order(effects)?;
        let Some(pending) = self.pending else { return Ok(()) };
        let spec = pending.present.spec;
        if self.refused.is_some_and(|(box_id, times)| box_id == spec.id() && times >= REFUSALS_MAX) {
            return self.order(Choice::by_rules(Action::SetAside, 0), effects);
        }
        if self.candidates.is_empty() {
            return self.order_by_rules(&spec, effects);
        }
        if now_ns >= pending.present.observed_ns + self.deadlines.soft_ns
            && let Some(choice) = pending.standby
        {
            return self.order(choice, effects);
        }
        if now_ns >= pending.present.observed_ns + self.deadlines.hard_ns {
            return self.order_by_walle(&spec, effects);
        }
        Ok(())
    }

    /// When [`Commander::on_time`] has something to do next [ns].
    #[must_use]
    pub fn wake_ns(&self) -> Option<u64> {
        let pending = self.pending?;
        let wait_ns = if pending.standby.is_some() { self.deadlines.soft_ns } else { self.deadlines.hard_ns };
        Some(pending.present.observed_ns + wait_ns)
    }

    fn order_by_walle<E: Effects>(&mut self, spec: &BoxSpec, effects: &mut E) -> Result<(), E::Error> {
        while let Some(best) = Heuristic::walle_choice(&self.candidates) {
            let placement = self.candidates[best].placement;
            match self.check_placement(spec, placement) {
                Ok(()) => return self.order(Choice::by_walle(placement), effects),
                Err(error) => {
                    self.tally.refuse(&Refusal::Infeasible(error));
                    self.candidates.remove(best);
                }
            }
        }
        // Not one candidate holds on the belief: the set is void, and the next repetition brings another.
        self.pending = None;
        Ok(())
    }

    /// Nothing fits: the close policy makes room, or the box is set aside.
    fn order_by_rules<E: Effects>(&mut self, spec: &BoxSpec, effects: &mut E) -> Result<(), E::Error> {
        let Some(grid) = self.grid.grid() else { return Ok(()) };
        let leaving = if grid.size().admits(grid.extent(spec)) { self.close.select(grid) } else { None };
        let action = if leaving.is_some() { Action::Replace } else { Action::SetAside };
        self.order(Choice::by_rules(action, leaving.unwrap_or(0)), effects)
    }

    /// Writes the order down, commands it, and remembers it until it is over. Whatever comes of this, nothing waits
    /// for a decision afterwards: if the order cannot be written down, the next repetition of the set begins anew.
    fn order<E: Effects>(&mut self, choice: Choice, effects: &mut E) -> Result<(), E::Error> {
        let Some(pending) = self.pending.take() else { return Ok(()) };
        let container =
            |grid: &Grid| grid.slots().get(usize::from(choice.placement.slot)).map(packing::Slot::container);
        let Some(container) = self.grid.grid().and_then(container) else { return Ok(()) };
        let mut order = Order::new(
            Intent {
                order: self.next_order,
                spec: pending.present.spec.into(),
                revision: pending.present.revision,
                action: choice.action,
                placement: choice.placement.into(),
                container,
                chosen_by: choice.by,
                instance: choice.instance,
                model: choice.model,
                observed_ns: pending.present.observed_ns,
            },
            Origin {
                why: self.why(choice, &pending),
                value: choice.value,
                depth: choice.depth,
                candidates: self.candidates.len() as u32,
                left_out: pending.left_out,
                stamps: Stamps {
                    scorer_received_ns: choice.scorer_received_ns,
                    decision_published_ns: choice.decision_published_ns,
                    decision_received_ns: choice.decision_received_ns,
                    ..pending.stamps
                },
            },
        );
        if let Err(error) = effects.append(&Record::Intent(*order.intent())) {
            self.tally.raise(&error);
            return Ok(());
        }
        self.tally.clear_alarm();
        self.next_order += 1;
        let stamp_ns = effects.command(&order)?;
        order.commanded(stamp_ns);
        self.ordered = Some(Ordered { order, end: None });
        self.tally.handle(pending.present.spec.id());
        Ok(())
    }

    fn why(&self, choice: Choice, pending: &Pending) -> Why {
        match choice.by {
            ChosenBy::Model => Why::InTime,
            ChosenBy::Standby | ChosenBy::Fallback if pending.active_refused => Why::Refused,
            ChosenBy::Standby | ChosenBy::Fallback => Why::Silent,
            ChosenBy::Rules if self.candidates.is_empty() => Why::NothingFits,
            ChosenBy::Rules => Why::Refused,
        }
    }

    /// The arm reported a motion.
    ///
    /// # Errors
    /// As [`Effects::report`].
    pub fn on_motion<E: Effects>(&mut self, motion: &MotionReport, effects: &mut E) -> Result<(), E::Error> {
        let is_ordered = |ordered: &&mut Ordered| ordered.end.is_none() && ordered.order.is_reported_by(motion);
        let Some(ordered) = self.ordered.as_mut().filter(is_ordered) else {
            self.tally.pass_over();
            return Ok(());
        };
        match MotionOutcome::from_wire(motion.outcome) {
            Ok(outcome @ (MotionOutcome::Done | MotionOutcome::Refused)) => {
                ordered.end = Some((outcome, motion.header.stamp_ns));
            }
            Ok(MotionOutcome::Unreported) => {
                self.tally.refuse(&Malformed::Unknown { field: "outcome", value: motion.outcome });
            }
            Err(malformed) => self.tally.refuse(&malformed),
        }
        self.end_order(effects)
    }

    /// Writes down how the order ended, if it has, and says so. Until that is written, nothing else is ordered.
    fn end_order<E: Effects>(&mut self, effects: &mut E) -> Result<(), E::Error> {
        let Some(Ordered { order, end: Some((outcome, stamp_ns)) }) = self.ordered else { return Ok(()) };
        let number = order.intent().order;
        if let Err(error) = effects.append(&Record::Outcome(Outcome { order: number, outcome })) {
            self.tally.raise(&error);
            return Ok(());
        }
        self.tally.clear_alarm();
        self.ordered = None;
        let box_id = order.spec().id;
        if is_final(outcome) {
            self.over = Some((box_id, order.intent().revision));
        } else if order.action() == Action::Place {
            let times = self.refused.filter(|(refused, _)| *refused == box_id).map_or(0, |(_, times)| times);
            self.refused = Some((box_id, times + 1));
        }
        effects.report(&order.report(outcome, stamp_ns))
    }

    /// An operator's wish; whether there is an answer to it. What cannot be written down is not granted.
    pub fn on_control<E: Effects>(&mut self, control: &Control, effects: &mut E) -> bool {
        match Wish::from_wire(control.wish) {
            Ok(Wish::Promote) if (control.instance as usize) < SCORERS_MAX => self.promote(control, effects),
            Ok(Wish::Promote) => {
                self.tally.refuse(&Malformed::Unknown { field: "instance", value: control.instance });
                false
            }
            Ok(Wish::Start | Wish::Retire) => false,
            Err(malformed) => {
                self.tally.refuse(&malformed);
                false
            }
        }
    }

    fn promote<E: Effects>(&mut self, control: &Control, effects: &mut E) -> bool {
        if control.instance != self.active {
            if let Err(error) = effects.append(&Record::Active(control.instance)) {
                self.tally.raise(&error);
                return false;
            }
            self.active = control.instance;
        }
        self.answered = control.request;
        true
    }

    /// The scorer instance that is obeyed first, and the request that was answered last.
    #[must_use]
    pub fn active(&self) -> (u32, u64) {
        (self.active, self.answered)
    }

    /// What it did so far.
    #[must_use]
    pub fn tally(&self) -> &Tally {
        &self.tally
    }
}

/// Whether an order that ended so must not be given again.
fn is_final(outcome: MotionOutcome) -> bool {
    match outcome {
        MotionOutcome::Done | MotionOutcome::Unreported => true,
        MotionOutcome::Refused => false,
    }
}

impl Choice {
    fn by_walle(placement: Placement) -> Self {
        Self::unscored(Action::Place, placement, ChosenBy::Fallback)
    }

    fn by_rules(action: Action, slot: u16) -> Self {
        Self::unscored(action, Placement { slot, yaw: Yaw::Deg0, i: 0, j: 0, base: 0 }, ChosenBy::Rules)
    }

    /// A choice that no scorer made.
    fn unscored(action: Action, placement: Placement, by: ChosenBy) -> Self {
        let (instance, model, value, depth) = (0, 0, 0.0, 0);
        let (scorer_received_ns, decision_published_ns, decision_received_ns) = (0, 0, 0);
        Self {
            action,
            placement,
            by,
            instance,
            model,
            value,
            depth,
            scorer_received_ns,
            decision_published_ns,
            decision_received_ns,
        }
    }
}

#[cfg(test)]
mod tests;
