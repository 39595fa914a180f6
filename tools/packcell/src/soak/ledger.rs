//! What became of every box, judged by the commander's journal.
//!
//! Orders and boxes are numbered, so a few numbers are enough for any count of them: a box whose number was passed
//! over is lost, and one whose number came before is doubled.

use std::collections::BTreeMap;

use journal::{Intent, Outcome, Record};
use messages::{Action, ChosenBy, MotionOutcome};

/// The judgement so far.
#[derive(Debug, Default)]
pub(crate) struct Ledger {
    /// The order whose end is not written down.
    open: Option<Intent>,
    last_order: u64,
    /// The last box that is over; nothing until it is known.
    last_box: Option<u64>,
    pub(crate) placed: u64,
    pub(crate) set_aside: u64,
    pub(crate) replaced: u64,
    /// Orders that the arm refused.
    pub(crate) refused: u64,
    /// Boxes that no order moved, although a later one was moved.
    pub(crate) lost: u64,
    /// Boxes that were moved by more than one order, or orders that began before another was over.
    pub(crate) doubled: u64,
    /// Orders that the journal held and this reader missed.
    pub(crate) unseen: u64,
    pub(crate) chosen_by: BTreeMap<&'static str, u64>,
}

impl Ledger {
    /// A judge of a cell whose first box is number 1.
    pub(crate) fn of_new_cell() -> Self {
        Self { last_box: Some(0), ..Self::default() }
    }

    /// Boxes that are over.
    pub(crate) fn boxes(&self) -> u64 {
        self.placed + self.set_aside
    }

    /// Forgets what was counted, and goes on from where the journal stands.
    pub(crate) fn begin_here(&mut self) {
        let (open, last_order, last_box) = (self.open, self.last_order, self.last_box);
        *self = Self { open, last_order, last_box, ..Self::default() };
    }

    /// One more record of the journal.
    pub(crate) fn take(&mut self, record: &Record) {
        match record {
            Record::Intent(intent) => self.begin(intent),
            Record::Outcome(outcome) => self.end(outcome),
            Record::Carried(state) => {
                let last = state.last.map_or(0, |(intent, _)| intent.order);
                if last > self.last_order {
                    // The journal was put aside more than once since it was read: what was missed is not judged.
                    self.unseen += last - self.last_order;
                    (self.last_order, self.last_box, self.open) = (last, None, state.open().copied());
                }
            }
            Record::Active(_) => {}
        }
    }

    fn begin(&mut self, intent: &Intent) {
        self.unseen += intent.order.saturating_sub(self.last_order + 1);
        let is_early = self.open.is_some() || intent.order <= self.last_order;
        self.doubled += u64::from(is_early);
        self.last_order = self.last_order.max(intent.order);
        self.open = Some(*intent);
    }

    fn end(&mut self, outcome: &Outcome) {
        let Some(intent) = self.open.take_if(|intent| intent.order == outcome.order) else { return };
        if outcome.outcome == MotionOutcome::Refused {
            self.refused += 1;
            return;
        }
        match intent.action {
            Action::Replace => {
                self.replaced += 1;
                return;
            }
            Action::Place => self.placed += 1,
            Action::SetAside => self.set_aside += 1,
        }
        *self.chosen_by.entry(name(intent.chosen_by)).or_default() += 1;
        let (id, before) = (intent.spec.id, self.last_box.unwrap_or(intent.spec.id.saturating_sub(1)));
        if id <= before {
            self.doubled += 1;
        } else {
            self.lost += id - before - 1;
            self.last_box = Some(id);
        }
    }
}

fn name(by: ChosenBy) -> &'static str {
    match by {
        ChosenBy::Model => "model",
        ChosenBy::Standby => "standby",
        ChosenBy::Fallback => "fallback",
        ChosenBy::Rules => "rules",
    }
}

#[cfg(test)]
mod tests {
    use journal::State;
    use messages::{WireBox, WirePlacement};

    use super::*;

    fn intent(order: u64, id: u64, action: Action) -> Intent {
        Intent {
            order,
            spec: WireBox { id, size_mm: [1, 1, 1], reserved: 0 },
            revision: order,
            action,
            placement: WirePlacement::default(),
            container: 0,
            chosen_by: ChosenBy::Model,
            instance: 0,
            model: 0,
            observed_ns: 0,
        }
    }

    fn order(ledger: &mut Ledger, order: u64, id: u64, action: Action, outcome: MotionOutcome) {
        ledger.take(&Record::Intent(intent(order, id, action)));
        ledger.take(&Record::Outcome(Outcome { order, outcome }));
    }

    #[test]
    fn every_box_is_over_once() {
        let mut ledger = Ledger::of_new_cell();
        order(&mut ledger, 1, 1, Action::Place, MotionOutcome::Done);
        order(&mut ledger, 2, 2, Action::Replace, MotionOutcome::Done);
        order(&mut ledger, 3, 2, Action::Place, MotionOutcome::Refused);
        order(&mut ledger, 4, 2, Action::SetAside, MotionOutcome::Unreported);
        assert_eq!((ledger.boxes(), ledger.replaced, ledger.refused), (2, 1, 1));
        assert_eq!((ledger.lost, ledger.doubled, ledger.unseen), (0, 0, 0));
        assert_eq!(ledger.chosen_by["model"], 2);
    }

    #[test]
    fn lost_and_doubled_boxes_are_told_by_their_numbers() {
        let mut ledger = Ledger::of_new_cell();
        order(&mut ledger, 1, 2, Action::Place, MotionOutcome::Done);
        order(&mut ledger, 2, 5, Action::Place, MotionOutcome::Done);
        order(&mut ledger, 3, 5, Action::Place, MotionOutcome::Done);
        assert_eq!((ledger.lost, ledger.doubled), (3, 1));
        ledger.take(&Record::Intent(intent(4, 6, Action::Place)));
        ledger.take(&Record::Intent(intent(5, 6, Action::Place)));
        assert_eq!(ledger.doubled, 2, "an order that began before another was over");
    }

    #[test]
    fn what_was_not_seen_is_not_judged_but_counted() {
        let mut ledger = Ledger::default();
        order(&mut ledger, 1, 71, Action::Place, MotionOutcome::Done);
        assert_eq!(ledger.lost, 0, "the first box that is seen may have any number");
        ledger.begin_here();
        let last = Some((intent(9, 79, Action::Place), Some(MotionOutcome::Done)));
        ledger.take(&Record::Carried(State { last, active: 0 }));
        order(&mut ledger, 10, 80, Action::Place, MotionOutcome::Done);
        assert_eq!((ledger.boxes(), ledger.lost, ledger.doubled, ledger.unseen), (1, 0, 0, 8));
    }
}
