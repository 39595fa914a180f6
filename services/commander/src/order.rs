//! An order: what the arm is told, and everything that led to it.

use journal::Intent;
use messages::{
    Action, ChosenBy, CycleReport, Header, MotionOutcome, MotionReport, PlaceCommand, Stamps, Why, WireBox,
    WirePlacement,
};

/// What the arm is told to do with one box, once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Order {
    intent: Intent,
    why: Why,
    value: f32,
    depth: u32,
    candidates: u32,
    left_out: u32,
    stamps: Stamps,
}

/// How an order came about, beyond what is written down before it is commanded.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Origin {
    pub(crate) why: Why,
    /// What the scorer thought of it.
    pub(crate) value: f32,
    /// Boxes the scorer planned for.
    pub(crate) depth: u32,
    /// Candidates of the set.
    pub(crate) candidates: u32,
    /// Candidates for which the set had no room.
    pub(crate) left_out: u32,
    pub(crate) stamps: Stamps,
}

impl Order {
    pub(crate) fn new(intent: Intent, origin: Origin) -> Self {
        let Origin { why, value, depth, candidates, left_out, stamps } = origin;
        Self { intent, why, value, depth, candidates, left_out, stamps }
    }

    /// An order as far as the journal knows it. Its stamps died with the commander that gave it, but for the
    /// observation's.
    pub(crate) fn recovered(intent: Intent, now_ns: u64) -> Self {
        // After a reboot the clock begins anew, and a stamp from before means nothing.
        let observed_ns = if intent.observed_ns <= now_ns { intent.observed_ns } else { 0 };
        let stamps = Stamps { observed_ns, ..Stamps::default() };
        let why = match intent.chosen_by {
            ChosenBy::Model => Why::InTime,
            ChosenBy::Standby | ChosenBy::Fallback => Why::Silent,
            ChosenBy::Rules => Why::NothingFits,
        };
        Self::new(intent, Origin { why, value: 0.0, depth: 0, candidates: 0, left_out: 0, stamps })
    }

    /// What is written down before it is commanded.
    #[must_use]
    pub fn intent(&self) -> &Intent {
        &self.intent
    }

    /// When the observation was made [ns].
    #[must_use]
    pub fn observed_ns(&self) -> u64 {
        self.stamps.observed_ns
    }

    /// Whether it is for this box on this revision of the belief.
    #[must_use]
    pub fn is_for(&self, box_id: u64, revision: u64) -> bool {
        (self.intent.spec.id, self.intent.revision) == (box_id, revision)
    }

    /// Whether the arm's report is of this order.
    #[must_use]
    pub fn is_reported_by(&self, motion: &MotionReport) -> bool {
        let is_same = self.is_for(motion.box_id, motion.revision) && motion.order == self.intent.order;
        is_same && motion.action == self.intent.action.to_wire()
    }

    /// Writes the command.
    pub fn write(&self, command: &mut PlaceCommand) {
        let Intent { order, spec, revision, action, placement, .. } = self.intent;
        (command.order, command.spec, command.revision) = (order, spec, revision);
        (command.action, command.placement) = (action.to_wire(), placement);
    }

    /// It was commanded at `stamp_ns`; only the first time counts.
    pub(crate) fn commanded(&mut self, stamp_ns: u64) {
        if self.stamps.command_published_ns == 0 {
            self.stamps.command_published_ns = stamp_ns;
        }
    }

    /// The report of the whole cycle, now that the order is over.
    pub(crate) fn report(&self, outcome: MotionOutcome, motion_published_ns: u64) -> CycleReport {
        let intent = &self.intent;
        CycleReport {
            header: Header::default(),
            order: intent.order,
            spec: intent.spec,
            revision: intent.revision,
            stamps: Stamps { motion_published_ns, ..self.stamps },
            model: intent.model,
            action: intent.action.to_wire(),
            placement: intent.placement,
            container: intent.container,
            chosen_by: intent.chosen_by.to_wire(),
            why: self.why.to_wire(),
            instance: intent.instance,
            value: self.value,
            depth: self.depth,
            candidates: self.candidates,
            left_out: self.left_out,
            outcome: outcome.to_wire(),
            reserved: 0,
        }
    }

    /// What the arm is told to do.
    #[must_use]
    pub fn action(&self) -> Action {
        self.intent.action
    }

    /// The box.
    #[must_use]
    pub fn spec(&self) -> WireBox {
        self.intent.spec
    }

    /// Where the box goes, or which slot's container leaves.
    #[must_use]
    pub fn placement(&self) -> WirePlacement {
        self.intent.placement
    }
}
