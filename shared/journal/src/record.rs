//! What is written down, and what follows from it.

use messages::{Action, ChosenBy, MotionOutcome, WireBox, WirePlacement};
use serde::{Deserialize, Serialize};

/// A record and when it was written.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// Wall clock [ms since 1970]; for people, nothing is decided by it.
    pub unix_ms: u64,
    /// What was written.
    pub record: Record,
}

/// One thing that the commander must not forget.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Record {
    /// An order is about to be commanded.
    Intent(Intent),
    /// An order is over.
    Outcome(Outcome),
    /// From here on this scorer instance is obeyed first: 0 is `a`.
    Active(u32),
    /// The state in which an earlier file ended: the first record of the file after it.
    Carried(State),
}

/// An order before it is commanded.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Intent {
    /// The order's number.
    pub order: u64,
    /// The box.
    pub spec: WireBox,
    /// The revision of the belief on which it was decided.
    pub revision: u64,
    /// What the arm is told to do.
    pub action: Action,
    /// Where.
    pub placement: WirePlacement,
    /// Identity of the container that is filled or replaced.
    pub container: u32,
    /// Who chose.
    pub chosen_by: ChosenBy,
    /// The scorer instance that chose, if one did.
    pub instance: u32,
    /// First 8 bytes of its model's SHA-256.
    pub model: u64,
    /// When the box was observed [ns, CLOCK_MONOTONIC]; means nothing after a reboot.
    pub observed_ns: u64,
}

/// How an order ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Outcome {
    /// The order's number.
    pub order: u64,
    /// What became of it.
    pub outcome: MotionOutcome,
}

/// What a commander needs to know of all that was written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// The last order, and its outcome if it is over.
    pub last: Option<(Intent, Option<MotionOutcome>)>,
    /// The scorer instance that is obeyed first.
    pub active: u32,
}

impl State {
    /// The number of the next order.
    #[must_use]
    pub fn next_order(&self) -> u64 {
        self.last.map_or(1, |(intent, _)| intent.order + 1)
    }

    /// The order that was to be commanded and of which no outcome is known.
    #[must_use]
    pub fn open(&self) -> Option<&Intent> {
        self.last.as_ref().filter(|(_, outcome)| outcome.is_none()).map(|(intent, _)| intent)
    }

    /// The state after one more record. An outcome of another order than the last changes nothing.
    #[must_use]
    pub fn after(mut self, record: &Record) -> Self {
        match record {
            Record::Intent(intent) => self.last = Some((*intent, None)),
            Record::Outcome(Outcome { order, outcome }) => {
                if let Some((_, known)) = self.last.as_mut().filter(|(intent, _)| intent.order == *order) {
                    *known = Some(*outcome);
                }
            }
            Record::Active(instance) => self.active = *instance,
            Record::Carried(state) => self = *state,
        }
        self
    }
}

/// An order to write down.
#[cfg(test)]
pub(crate) fn intent(order: u64) -> Intent {
    Intent {
        order,
        spec: WireBox { id: 40 + order, size_mm: [300, 200, 100], reserved: 0 },
        revision: order,
        action: Action::Place,
        placement: WirePlacement { slot: 2, ..WirePlacement::default() },
        container: 3,
        chosen_by: ChosenBy::Model,
        instance: 1,
        model: u64::MAX,
        observed_ns: 77,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_order_is_open_until_its_own_outcome() {
        let state = State::default();
        assert_eq!((state.next_order(), state.open()), (1, None));
        let state = state.after(&Record::Intent(intent(1)));
        assert_eq!((state.next_order(), state.open()), (2, Some(&intent(1))));
        let of_another = Record::Outcome(Outcome { order: 9, outcome: MotionOutcome::Done });
        assert_eq!(state.after(&of_another), state);
        let state = state.after(&Record::Outcome(Outcome { order: 1, outcome: MotionOutcome::Done }));
        assert_eq!((state.next_order(), state.open()), (2, None));
    }

    #[test]
    fn a_file_goes_on_where_the_one_before_ended() {
        let state = State::default().after(&Record::Active(1)).after(&Record::Intent(intent(7)));
        assert_eq!(State::default().after(&Record::Carried(state)), state);
        assert_eq!((state.active, state.next_order()), (1, 8));
    }
}
