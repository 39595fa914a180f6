//! The stub of the physical side: belt, containers, sensor and arm.
//!
//! It says what it sees until the arm has the box (rule "level, not edge"), so that whoever comes late, or comes
//! back, sees the present. The arm obeys a command once, and only for the box at the pick position on the present
//! revision; any other command is reported as refused.

mod belt;

use messages::{
    Action, BeltState, BoxQueue, Malformed, MotionOutcome, MotionReport, PlaceCommand, UPCOMING_MAX, WireBox,
};
use packing::{BoxSpec, Extent, Grid, Placement};
use runtime::{PerceptionConfig, Tally};

pub use belt::{Belt, StreamError};

const NS_PER_MS: u64 = 1_000_000;

/// How the stub behaves.
#[derive(Clone, Copy, Debug)]
pub struct Behaviour {
    /// Interval at which boxes reach the pick position [ns]; 0 for as soon as the last one is gone.
    pub pace_ns: u64,
    /// How long the arm takes for a motion [ns].
    pub motion_ns: u64,
    /// How often an observation is said again [ns].
    pub repeat_ns: u64,
    /// Upcoming boxes that the sensor sees.
    pub upcoming: usize,
}

/// The physical side between two events.
#[derive(Debug)]
pub struct Perception {
    behaviour: Behaviour,
    grid: Grid,
    /// Identity of the next container that is brought in.
    next_container: u32,
    belt: Belt,
    phase: Phase,
    /// When the next box is due at the pick position [ns].
    due_ns: u64,
    taken: u64,
    tally: Tally,
}

/// What the belt and the arm are doing.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    /// The next box is on its way.
    Waiting,
    /// A box lies at the pick position.
    Present { spec: BoxSpec, observed_ns: u64, repeat_at_ns: u64 },
    /// The arm moves.
    Moving { spec: BoxSpec, motion: Motion, revision: u64, done_ns: u64 },
    /// There are no more boxes.
    Ended,
}

/// What the arm does with a box.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Motion {
    Place(Placement),
    SetAside,
    Replace { slot: u16 },
}

/// What is to be published, in this order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Say {
    /// The arm's report.
    Motion(MotionReport),
    /// The grid, because it changed.
    Belief,
    /// What lies on the belt, observed at this time [ns].
    Boxes(u64),
}

/// Why the arm does not move.
#[derive(Debug, thiserror::Error)]
enum Refusal {
    #[error(transparent)]
    Malformed(#[from] Malformed),
    #[error("the command is for box {commanded} on revision {revision}, which is not what lies on the belt")]
    NotPresent { commanded: u64, revision: u64 },
    #[error("the commanded motion is impossible: {0}")]
    Impossible(#[from] packing::PlaceError),
}

impl Behaviour {
    /// As configured.
    #[must_use]
    pub fn of(config: &PerceptionConfig) -> Self {
        let [pace_ns, motion_ns, repeat_ns] =
            [config.pace_ms, config.motion_ms, config.repeat_ms].map(|ms| ms * NS_PER_MS);
        Self { pace_ns, motion_ns, repeat_ns, upcoming: config.upcoming }
    }
}

impl Perception {
    /// Empty containers and a belt whose first box is due at `now_ns`.
    #[must_use]
    pub fn new(behaviour: Behaviour, grid: Grid, belt: Belt, now_ns: u64) -> Self {
        let next_container = grid.slots().len() as u32;
        let (phase, tally) = (Phase::Waiting, Tally::default());
        Self { behaviour, grid, next_container, belt, phase, due_ns: now_ns, taken: 0, tally }
    }

    /// Behaves like this from `now_ns` on; the next box comes at the new pace if that is sooner.
    pub fn set_behaviour(&mut self, behaviour: Behaviour, now_ns: u64) {
        self.behaviour = behaviour;
        self.due_ns = self.due_ns.min(now_ns + behaviour.pace_ns);
    }

    /// The containers as they stand.
    #[must_use]
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Lets the world move on to `now_ns`, and appends what is to be said of it.
    pub fn on_time(&mut self, now_ns: u64, say: &mut Vec<Say>) {
        if let Phase::Moving { spec, motion, revision, done_ns } = self.phase
            && now_ns >= done_ns
        {
            self.finish(spec, motion, revision, now_ns, say);
        }
        if self.phase == Phase::Waiting && now_ns >= self.due_ns {
            self.bring_next(now_ns, say);
        }
        if let Phase::Present { observed_ns, repeat_at_ns, .. } = &mut self.phase
            && now_ns >= *repeat_at_ns
        {
            *repeat_at_ns = now_ns + self.behaviour.repeat_ns;
            say.push(Say::Boxes(*observed_ns));
        }
    }

    /// When [`Perception::on_time`] has something to do next [ns].
    #[must_use]
    pub fn wake_ns(&self) -> Option<u64> {
        match self.phase {
            Phase::Waiting => Some(self.due_ns),
            Phase::Present { repeat_at_ns, .. } => Some(repeat_at_ns),
            Phase::Moving { done_ns, .. } => Some(done_ns),
            Phase::Ended => None,
        }
    }

    /// The next box comes to the pick position, or the episode ends, or the stream.
    fn bring_next(&mut self, now_ns: u64, say: &mut Vec<Say>) {
        if self.belt.episode_is_over() {
            if !self.belt.begin_episode(&mut self.tally) {
                self.phase = Phase::Ended;
                say.push(Say::Boxes(0));
                return;
            }
            if self.grid.slots().iter().any(packing::Slot::is_open) {
                for slot in 0..self.grid.slots().len() as u16 {
                    self.replace(slot);
                }
                say.push(Say::Belief);
            }
        }
        if let Some(spec) = self.belt.take_next() {
            self.due_ns = if self.behaviour.pace_ns == 0 { now_ns } else { self.due_ns + self.behaviour.pace_ns };
            self.phase = Phase::Present { spec, observed_ns: now_ns, repeat_at_ns: now_ns };
        }
    }

    /// The commander's word. The arm moves if it is for what lies on the belt, and reports why if it is not.
    pub fn on_command(&mut self, command: &PlaceCommand, now_ns: u64, say: &mut Vec<Say>) {
        match self.check(command) {
            Ok((spec, motion)) => {
                let done_ns = now_ns + self.behaviour.motion_ns;
                self.phase = Phase::Moving { spec, motion, revision: command.revision, done_ns };
                self.tally.handle(spec.id());
                if self.behaviour.motion_ns > 0 {
                    say.push(Say::Boxes(0));
                }
                self.on_time(now_ns, say);
            }
            Err(Refusal::NotPresent { .. }) => self.tally.pass_over(),
            Err(refusal @ (Refusal::Malformed(_) | Refusal::Impossible(_))) => {
                self.tally.refuse(&refusal);
                say.push(Say::Motion(report(
                    command.spec.id,
                    command.revision,
                    command.action,
                    MotionOutcome::Refused,
                )));
            }
        }
    }

    fn check(&self, command: &PlaceCommand) -> Result<(BoxSpec, Motion), Refusal> {
        let not_present = Refusal::NotPresent { commanded: command.spec.id, revision: command.revision };
        let Phase::Present { spec, .. } = self.phase else { return Err(not_present) };
        if WireBox::from(spec) != command.spec || command.revision != self.grid.revision() {
            return Err(not_present);
        }
        let placement = Placement::try_from(command.placement)?;
        let motion = match Action::from_wire(command.action)? {
            Action::Place => {
                self.grid.check(self.extent(&spec), placement)?;
                Motion::Place(placement)
            }
            Action::SetAside => Motion::SetAside,
            Action::Replace => {
                let (slot, slots) = (placement.slot, self.grid.slots().len());
                let missing = packing::PlaceError::NoSuchSlot { slot, slots };
                self.grid.slots().get(usize::from(slot)).ok_or(missing)?;
                Motion::Replace { slot }
            }
        };
        Ok((spec, motion))
    }

    /// The arm has done it.
    fn finish(&mut self, spec: BoxSpec, motion: Motion, revision: u64, now_ns: u64, say: &mut Vec<Say>) {
        let action = match motion {
            Motion::Place(placement) => {
                // Nothing but the arm changes the containers, so what was checked before the motion still holds.
                if let Err(error) = self.grid.place(&spec, placement) {
                    self.tally.refuse(&error);
                }
                Action::Place
            }
            Motion::SetAside => Action::SetAside,
            Motion::Replace { slot } => {
                self.replace(slot);
                Action::Replace
            }
        };
        say.push(Say::Motion(report(spec.id(), revision, action.to_wire(), MotionOutcome::Done)));
        if action != Action::SetAside {
            say.push(Say::Belief);
        }
        self.phase = match action {
            // The box still lies there, before other containers: that is a new observation.
            Action::Replace => Phase::Present { spec, observed_ns: now_ns, repeat_at_ns: now_ns },
            Action::Place | Action::SetAside => {
                self.taken += 1;
                Phase::Waiting
            }
        };
    }

    fn replace(&mut self, slot: u16) {
        if self.grid.replace(slot, self.next_container).is_ok() {
            self.next_container += 1;
        }
    }

    fn extent(&self, spec: &BoxSpec) -> Extent {
        spec.extent(self.grid.size().cell_mm())
    }

    /// Writes what lies on the belt.
    pub fn write_boxes(&self, queue: &mut BoxQueue) {
        let (state, current) = match self.phase {
            Phase::Waiting => (BeltState::Waiting, None),
            Phase::Present { spec, .. } => (BeltState::BoxPresent, Some(spec)),
            Phase::Moving { spec, .. } => (BeltState::Taken, Some(spec)),
            Phase::Ended => (BeltState::Ended, None),
        };
        queue.belt = state.to_wire();
        queue.revision = self.grid.revision();
        queue.current = current.map_or(WireBox::default(), WireBox::from);
        queue.write_upcoming(self.belt.upcoming().take(self.behaviour.upcoming.min(UPCOMING_MAX)));
        (queue.taken, queue.episodes) = (self.taken, self.belt.episodes_begun());
    }

    /// What it did so far.
    #[must_use]
    pub fn tally(&self) -> &Tally {
        &self.tally
    }
}

fn report(box_id: u64, revision: u64, action: u32, outcome: MotionOutcome) -> MotionReport {
    MotionReport { header: messages::Header::default(), box_id, revision, action, outcome: outcome.to_wire() }
}

#[cfg(test)]
mod tests;
