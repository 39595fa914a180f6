//! Candidate set and decisions to one command: the only process that causes effects.
//!
//! For every box the commander obeys, in this order: the active scorer instance; after the soft deadline, any
//! instance; after the hard deadline, WallE's ranking, which lies in the candidate set already. Whoever chose, the
//! placement is checked against the belief before it is commanded. An empty set is answered by the rules: the close
//! policy makes room, or the box is set aside.

mod cycle_log;

use messages::topics::SCORERS_MAX;
use messages::{
    Action, Belief, CandidateSet, ChosenBy, CycleReport, Decision, GridCopy, Malformed, MotionOutcome, MotionReport,
    PlaceCommand, Stamps, WireBox, WirePlacement,
};
use packing::{BoxSpec, Candidate, ClosePolicy, Extent, Grid, Heuristic, PlaceError, Placement, Yaw};
use runtime::{CommanderConfig, Tally};

pub use cycle_log::CycleLog;

const NS_PER_MS: u64 = 1_000_000;

/// When the commander stops waiting, counted from the observation.
#[derive(Clone, Copy, Debug)]
pub struct Deadlines {
    /// After this, any instance's decision is taken [ns].
    pub soft_ns: u64,
    /// After this, WallE's ranking is taken [ns].
    pub hard_ns: u64,
}

/// The commander's state between two events.
#[derive(Debug)]
pub struct Commander {
    deadlines: Deadlines,
    close: ClosePolicy,
    active: u32,
    grid: GridCopy,
    /// The box that waits for a decision.
    pending: Option<Pending>,
    /// The candidates of the pending box.
    candidates: Vec<Candidate>,
    /// The order whose motion has not been reported.
    ordered: Option<Order>,
    tally: Tally,
}

/// A box that waits for a decision.
#[derive(Clone, Copy, Debug)]
struct Pending {
    spec: BoxSpec,
    revision: u64,
    set_digest: u64,
    left_out: u32,
    observed_ns: u64,
    stamps: Stamps,
    /// The first decision of an instance that is not active, kept until the soft deadline.
    standby: Option<Choice>,
}

/// A placement and where it comes from.
#[derive(Clone, Copy, Debug)]
struct Choice {
    placement: Placement,
    by: ChosenBy,
    instance: u32,
    model: u64,
    scorer_received_ns: u64,
    decision_published_ns: u64,
    decision_received_ns: u64,
}

/// What the arm is to be told, and everything that led to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Order {
    report: CycleReport,
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
    /// A commander with these deadlines and this close policy, which obeys the instance `active` first.
    #[must_use]
    pub fn new(deadlines: Deadlines, close: ClosePolicy, active: u32) -> Self {
        Self {
            deadlines,
            close,
            active,
            grid: GridCopy::default(),
            pending: None,
            candidates: Vec::new(),
            ordered: None,
            tally: Tally::default(),
        }
    }

    /// Deadlines and a close policy for everything that comes from here on.
    pub fn set_rules(&mut self, deadlines: Deadlines, close: ClosePolicy) {
        (self.deadlines, self.close) = (deadlines, close);
    }

    /// Takes over the belief. A box that waits for a decision on another revision is void.
    pub fn on_belief(&mut self, belief: &Belief) {
        match self.grid.follow(belief) {
            Ok(grid) => {
                let revision = grid.revision();
                self.pending = self.pending.filter(|pending| pending.revision == revision);
            }
            Err(malformed) => self.tally.refuse(&malformed),
        }
    }

    /// A candidate set came at `now_ns`. The belief must have been taken over before.
    pub fn on_candidates(&mut self, set: &CandidateSet, now_ns: u64) -> Option<Order> {
        match self.try_candidates(set, now_ns) {
            Ok(order) => order,
            Err(malformed) => {
                self.tally.refuse(&malformed);
                None
            }
        }
    }

    fn try_candidates(&mut self, set: &CandidateSet, now_ns: u64) -> Result<Option<Order>, Malformed> {
        let spec = set.spec()?;
        if self.grid.grid().is_none_or(|grid| grid.revision() != set.revision) {
            self.tally.pass_over();
            return Ok(None);
        }
        if let Some(order) = &self.ordered
            && (order.report.spec.id, order.report.revision) == (spec.id(), set.revision)
        {
            // The box is still on the belt: the arm may have missed the command. It moves a box once.
            return Ok(Some(*order));
        }
        let is_known = self.pending.as_ref().is_some_and(|pending| {
            (pending.spec.id(), pending.revision, pending.set_digest) == (spec.id(), set.revision, set.digest)
        });
        if !is_known {
            set.read_candidates(&mut self.candidates)?;
            // A stamp from the future would postpone the deadlines.
            let observed_ns = set.header.observed_ns.min(now_ns);
            let stamps = Stamps {
                observed_ns,
                boxes_published_ns: set.boxes_stamp_ns,
                candidates_received_ns: set.received_ns,
                candidates_published_ns: set.header.stamp_ns,
                ..Stamps::default()
            };
            let (revision, set_digest, left_out) = (set.revision, set.digest, set.left_out);
            self.pending = Some(Pending { spec, revision, set_digest, left_out, observed_ns, stamps, standby: None });
            self.ordered = None;
        }
        if self.candidates.is_empty() { Ok(self.order_by_rules()) } else { Ok(self.on_time(now_ns)) }
    }

    /// A decision came at `now_ns`.
    pub fn on_decision(&mut self, decision: &Decision, now_ns: u64) -> Option<Order> {
        let Some(pending) = self.pending.filter(|pending| {
            (pending.spec.id(), pending.revision, pending.set_digest)
                == (decision.box_id, decision.revision, decision.set_digest)
        }) else {
            self.tally.pass_over();
            return None;
        };
        match self.check_decision(&pending, decision, now_ns) {
            Ok(choice) => {
                let soft_ns = pending.observed_ns + self.deadlines.soft_ns;
                if choice.by == ChosenBy::Model || now_ns >= soft_ns {
                    return self.order(choice);
                }
                if let Some(pending) = &mut self.pending
                    && pending.standby.is_none()
                {
                    pending.standby = Some(choice);
                }
                None
            }
            Err(refusal) => {
                self.tally.refuse(&refusal);
                None
            }
        }
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
        self.check_placement(&pending.spec, placement)?;
        Ok(Choice {
            placement,
            by: if instance == self.active { ChosenBy::Model } else { ChosenBy::Standby },
            instance,
            model: decision.model,
            scorer_received_ns: decision.received_ns,
            decision_published_ns: decision.header.stamp_ns,
            decision_received_ns: now_ns,
        })
    }

    fn check_placement(&self, spec: &BoxSpec, placement: Placement) -> Result<(), PlaceError> {
        let no_grid = PlaceError::NoSuchSlot { slot: placement.slot, slots: 0 };
        let grid = self.grid.grid().ok_or(no_grid)?;
        grid.check(extent(grid, spec), placement)
    }

    /// What is due at `now_ns`.
    pub fn on_time(&mut self, now_ns: u64) -> Option<Order> {
        let pending = self.pending?;
        if now_ns >= pending.observed_ns + self.deadlines.soft_ns
            && let Some(choice) = pending.standby
        {
            return self.order(choice);
        }
        if now_ns >= pending.observed_ns + self.deadlines.hard_ns {
            return self.order_by_walle(&pending);
        }
        None
    }

    /// When [`Commander::on_time`] has something to do next [ns].
    #[must_use]
    pub fn wake_ns(&self) -> Option<u64> {
        let pending = self.pending?;
        let wait_ns = if pending.standby.is_some() { self.deadlines.soft_ns } else { self.deadlines.hard_ns };
        Some(pending.observed_ns + wait_ns)
    }

    fn order_by_walle(&mut self, pending: &Pending) -> Option<Order> {
        while let Some(best) = Heuristic::walle_choice(&self.candidates) {
            let placement = self.candidates[best].placement;
            match self.check_placement(&pending.spec, placement) {
                Ok(()) => return self.order(Choice::unscored(placement, ChosenBy::Fallback)),
                Err(error) => {
                    self.tally.refuse(&Refusal::Infeasible(error));
                    self.candidates.remove(best);
                }
            }
        }
        // Not one candidate holds on the belief: the set is void, and the next repetition brings another.
        self.pending = None;
        None
    }

    /// Nothing fits: the close policy makes room, or the box is set aside.
    fn order_by_rules(&mut self) -> Option<Order> {
        let spec = self.pending?.spec;
        let grid = self.grid.grid()?;
        let leaving = if grid.size().admits(extent(grid, &spec)) { self.close.select(grid) } else { None };
        let placement = Placement { slot: leaving.unwrap_or(0), yaw: Yaw::Deg0, i: 0, j: 0, base: 0 };
        let action = if leaving.is_some() { Action::Replace } else { Action::SetAside };
        self.order_action(action, Choice::unscored(placement, ChosenBy::Rules))
    }

    fn order(&mut self, choice: Choice) -> Option<Order> {
        self.order_action(Action::Place, choice)
    }

    fn order_action(&mut self, action: Action, choice: Choice) -> Option<Order> {
        let pending = self.pending.take()?;
        let slot = self.grid.grid()?.slots().get(usize::from(choice.placement.slot))?;
        let report = CycleReport {
            header: messages::Header::default(),
            spec: pending.spec.into(),
            revision: pending.revision,
            stamps: Stamps {
                scorer_received_ns: choice.scorer_received_ns,
                decision_published_ns: choice.decision_published_ns,
                decision_received_ns: choice.decision_received_ns,
                ..pending.stamps
            },
            model: choice.model,
            action: action.to_wire(),
            placement: choice.placement.into(),
            container: slot.container(),
            chosen_by: choice.by.to_wire(),
            instance: choice.instance,
            candidates: self.candidates.len() as u32,
            left_out: pending.left_out,
            outcome: MotionOutcome::Done.to_wire(),
        };
        let order = Order { report };
        self.ordered = Some(order);
        self.tally.handle(pending.spec.id());
        Some(order)
    }

    /// The order was published at `stamp_ns`; only the first publication counts.
    pub fn on_commanded(&mut self, stamp_ns: u64) {
        if let Some(order) = &mut self.ordered
            && order.report.stamps.command_published_ns == 0
        {
            order.report.stamps.command_published_ns = stamp_ns;
        }
    }

    /// The arm reported a motion: the report of the whole cycle, if it is of the last order.
    pub fn on_motion(&mut self, motion: &MotionReport) -> Option<CycleReport> {
        let is_ordered = |order: &&Order| {
            (order.report.spec.id, order.report.revision, order.report.action)
                == (motion.box_id, motion.revision, motion.action)
        };
        let Some(order) = self.ordered.as_ref().filter(is_ordered) else {
            self.tally.pass_over();
            return None;
        };
        if let Err(malformed) = MotionOutcome::from_wire(motion.outcome) {
            self.tally.refuse(&malformed);
            return None;
        }
        let mut report = order.report;
        report.outcome = motion.outcome;
        report.stamps.motion_published_ns = motion.header.stamp_ns;
        self.ordered = None;
        Some(report)
    }

    /// What it did so far.
    #[must_use]
    pub fn tally(&self) -> &Tally {
        &self.tally
    }
}

fn extent(grid: &Grid, spec: &BoxSpec) -> Extent {
    spec.extent(grid.size().cell_mm())
}

impl Choice {
    /// A choice that no scorer made.
    fn unscored(placement: Placement, by: ChosenBy) -> Self {
        let (instance, model) = (0, 0);
        let (scorer_received_ns, decision_published_ns, decision_received_ns) = (0, 0, 0);
        Self { placement, by, instance, model, scorer_received_ns, decision_published_ns, decision_received_ns }
    }
}

impl Order {
    /// When the observation was made [ns].
    #[must_use]
    pub fn observed_ns(&self) -> u64 {
        self.report.stamps.observed_ns
    }

    /// The box.
    #[must_use]
    pub fn spec(&self) -> WireBox {
        self.report.spec
    }

    /// Where the box goes, or which slot's container leaves.
    #[must_use]
    pub fn placement(&self) -> WirePlacement {
        self.report.placement
    }

    /// Writes the command.
    pub fn write(&self, command: &mut PlaceCommand) {
        (command.spec, command.revision) = (self.report.spec, self.report.revision);
        (command.action, command.placement) = (self.report.action, self.report.placement);
    }
}

#[cfg(test)]
mod tests;
