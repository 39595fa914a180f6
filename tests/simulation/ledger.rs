//! What truly happened, and what must hold of it.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::{Display, Formatter};

use commander::Order;
use journal::{Intent, Outcome, Record, Rest, State, decode};
use messages::{Action, CycleReport, MotionOutcome};
use packing::BoxSpec;
use perception::Say;

use crate::cell::{DEADLINES, MS};

/// From the observation to the command, when nothing bad happens [ns].
const BUDGET_NS: u64 = 40 * MS;

/// A rule that was broken.
#[derive(Debug)]
pub(crate) struct Violation {
    what: String,
    now_ns: u64,
}

/// The truth about one schedule.
pub(crate) struct Ledger {
    /// By box: the order that placed it or set it aside.
    moved: Vec<Option<u64>>,
    /// Orders that had their effect.
    effects: BTreeSet<u64>,
    commanded: BTreeMap<u64, Intent>,
    /// Boxes whose placing or setting aside was reported.
    reported: BTreeSet<u64>,
    /// Whether the end of the journal was lost in a power cut: then an order may be given anew.
    is_cut: bool,
    /// Whether anything bad happened.
    pub(crate) is_disturbed: bool,
    /// The scorer that the commander said it obeys.
    active: Option<u32>,
}

impl Violation {
    pub(crate) fn new(what: impl Into<String>, now_ns: u64) -> Self {
        Self { what: what.into(), now_ns }
    }
}

impl Display for Violation {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} at {:.3} ms", self.what, (self.now_ns as f64 - 1e9) / 1e6)
    }
}

impl Ledger {
    pub(crate) fn new(boxes: usize) -> Self {
        Self {
            moved: vec![None; boxes],
            effects: BTreeSet::new(),
            commanded: BTreeMap::new(),
            reported: BTreeSet::new(),
            is_cut: false,
            is_disturbed: false,
            active: None,
        }
    }

    /// Every box is moved, and that was reported.
    pub(crate) fn is_complete(&self) -> bool {
        let is_reported = |(index, _)| self.is_cut || self.reported.contains(&(index as u64 + 1));
        self.moved.iter().all(Option::is_some) && self.moved.iter().enumerate().all(is_reported)
    }

    pub(crate) fn cut(&mut self, is_cut: bool) {
        self.is_cut |= is_cut;
    }

    /// The world was kept with this in it: it has happened, whether it is said or not.
    pub(crate) fn happened(&mut self, say: &[Say], now_ns: u64) -> Result<(), Violation> {
        let done = say.iter().filter_map(|said| match said {
            Say::Motion(motion) if motion.outcome == MotionOutcome::Done.to_wire() => Some(motion),
            Say::Motion(_) | Say::Belief | Say::Boxes(_) => None,
        });
        for motion in done {
            if !self.effects.insert(motion.order) && !self.is_cut {
                return Err(Violation::new(format!("order {} had its effect twice", motion.order), now_ns));
            }
            if motion.action != Action::Replace.to_wire() {
                let moved = &mut self.moved[motion.box_id as usize - 1];
                if let Some(order) = moved.replace(motion.order) {
                    let (box_id, again) = (motion.box_id, motion.order);
                    return Err(Violation::new(format!("orders {order} and {again} moved box {box_id}"), now_ns));
                }
            }
        }
        Ok(())
    }

    /// The arm is told. `truth` is the revision of the world as it stands.
    pub(crate) fn commanded(&mut self, order: &Order, truth: Option<u64>, now_ns: u64) -> Result<(), Violation> {
        let intent = *order.intent();
        if let Some(known) = self.commanded.get(&intent.order) {
            if *known == intent || self.is_cut {
                return Ok(());
            }
            return Err(Violation::new(format!("two orders have the number {}", intent.order), now_ns));
        }
        let same = |known: &&Intent| (known.spec.id, known.revision) == (intent.spec.id, intent.revision);
        let twice = self.commanded.values().find(same).map(|known| known.order);
        self.commanded.insert(intent.order, intent);
        if self.is_cut {
            return Ok(());
        }
        if let Some(before) = twice {
            let (order, box_id) = (intent.order, intent.spec.id);
            return Err(Violation::new(format!("orders {before} and {order} are both for box {box_id}"), now_ns));
        }
        if truth.is_some_and(|truth| truth != intent.revision) {
            return Err(Violation::new(format!("order {} is on a stale belief", intent.order), now_ns));
        }
        if !self.is_disturbed && now_ns > order.observed_ns() + BUDGET_NS {
            return Err(Violation::new(format!("order {} is late", intent.order), now_ns));
        }
        Ok(())
    }

    /// The commander goes to sleep until `wake_ns`.
    pub(crate) fn waits(&self, wake_ns: Option<u64>, now_ns: u64) -> Result<(), Violation> {
        match wake_ns {
            Some(wake_ns) if wake_ns > now_ns + DEADLINES.hard_ns => {
                Err(Violation::new("a box is left waiting beyond the hard deadline", now_ns))
            }
            Some(wake_ns) if wake_ns <= now_ns => Err(Violation::new("something is due and was not done", now_ns)),
            _ => Ok(()),
        }
    }

    /// A cycle is reported.
    pub(crate) fn reported(&mut self, report: &CycleReport, now_ns: u64) -> Result<(), Violation> {
        let is_over = report.outcome != MotionOutcome::Refused.to_wire();
        if is_over && report.action != Action::Replace.to_wire() {
            let box_id = report.spec.id;
            self.reported.insert(box_id);
            if self.moved[box_id as usize - 1].is_none() {
                return Err(Violation::new(format!("box {box_id} is reported and was never moved"), now_ns));
            }
        }
        Ok(())
    }

    /// The commander says that it obeys this instance.
    pub(crate) fn promoted(&mut self, instance: u32) {
        self.active = Some(instance);
    }

    /// A commander starts and finds this.
    pub(crate) fn restarted(&mut self, state: &State, now_ns: u64) -> Result<(), Violation> {
        let before = self.active.replace(state.active);
        if !self.is_cut && before.is_some_and(|before| before != state.active) {
            return Err(Violation::new("the commander has forgotten whom it obeys", now_ns));
        }
        Ok(())
    }

    /// The journal, read as somebody would who trusts nobody.
    pub(crate) fn audit(&self, journal: &[u8], boxes: &[BoxSpec]) -> Result<(), Violation> {
        let contents = decode(journal);
        let broken = |what: String| Err(Violation::new(what, 0));
        if contents.rest != Rest::Nothing {
            return broken(format!("the journal ends in {:?}", contents.rest));
        }
        if self.is_cut {
            return Ok(());
        }
        let mut moved_by: BTreeMap<u64, Vec<u64>> = BTreeMap::new();
        let mut open: Option<Intent> = None;
        for entry in &contents.entries {
            match entry.record {
                Record::Intent(intent) if open.is_none() => open = Some(intent),
                Record::Outcome(Outcome { order, outcome }) => {
                    let Some(intent) = open.take().filter(|intent| intent.order == order) else {
                        return broken(format!("the journal has an outcome of order {order} and no intent"));
                    };
                    if outcome != MotionOutcome::Refused && intent.action != Action::Replace {
                        moved_by.entry(intent.spec.id).or_default().push(order);
                    }
                }
                Record::Intent(intent) => return broken(format!("order {} began before another ended", intent.order)),
                Record::Active(_) | Record::Carried(_) => {}
            }
        }
        for id in 1..=boxes.len() as u64 {
            match moved_by.get(&id).map(Vec::as_slice) {
                Some([_]) => {}
                other => return broken(format!("by the journal, box {id} was moved by the orders {other:?}")),
            }
        }
        Ok(())
    }
}
