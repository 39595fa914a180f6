//! Everything the commander hears.

use commander::Commander;
use messages::topics::{BELIEF, BOXES, CANDIDATES, CONTROL, DECISIONS, MOTIONS};
use messages::{Belief, BoxQueue, CandidateSet, Control, Decision, MotionReport};
use runtime::{Bus, BusError, Latest, Subscriber, monotonic_ns};

use crate::hands::Hands;

/// The commander's readers.
#[derive(Debug)]
pub(crate) struct Ears {
    decisions: Subscriber<Decision>,
    sets: Latest<CandidateSet>,
    queues: Latest<BoxQueue>,
    beliefs: Latest<Belief>,
    motions: Subscriber<MotionReport>,
    controls: Subscriber<Control>,
    heard: Vec<Decision>,
}

impl Ears {
    pub(crate) fn new(bus: &Bus) -> Result<Self, BusError> {
        Ok(Self {
            decisions: bus.subscriber(&DECISIONS)?,
            sets: bus.latest(&CANDIDATES)?,
            queues: bus.latest(&BOXES)?,
            beliefs: bus.latest(&BELIEF)?,
            motions: bus.subscriber(&MOTIONS)?,
            controls: bus.subscriber(&CONTROL)?,
            heard: Vec::new(),
        })
    }

    /// Lets the commander act on all that has come; whether an operator was answered.
    pub(crate) fn listen(&mut self, commander: &mut Commander, hands: &mut Hands) -> Result<bool, BusError> {
        // Looked at against the stream, so that whatever is seen, what caused it is seen too ...
        while let Some(decision) = self.decisions.receive()? {
            self.heard.push(*decision);
        }
        let has_set = self.sets.refresh()?;
        let has_queue = self.queues.refresh()?;
        let has_belief = self.beliefs.refresh()?;
        // ... and acted upon with the stream.
        while let Some(motion) = self.motions.receive()? {
            commander.on_motion(&motion, hands)?;
        }
        if let Some(belief) = self.beliefs.get().filter(|_| has_belief) {
            commander.on_belief(belief);
        }
        if let Some(queue) = self.queues.get().filter(|_| has_queue) {
            commander.on_boxes(queue, monotonic_ns(), hands)?;
        }
        if let Some(set) = self.sets.get().filter(|_| has_set) {
            commander.on_candidates(set, monotonic_ns(), hands)?;
        }
        for decision in self.heard.drain(..) {
            commander.on_decision(&decision, monotonic_ns(), hands)?;
        }
        commander.on_time(monotonic_ns(), hands)?;
        let mut is_answered = false;
        while let Some(control) = self.controls.receive()? {
            is_answered |= commander.on_control(&control, hands);
        }
        Ok(is_answered)
    }
}
