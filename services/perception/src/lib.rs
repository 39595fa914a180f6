//! The stub of the physical side: belt, containers, sensor and arm.
//!
//! It says what it sees until the arm has the box (rule "level, not edge"), so that whoever comes late, or comes
//! back, sees the present. The arm obeys a command once, and only for the box at the pick position on the present
//! revision; any other command is reported as refused.
//!
//! Everything that a motion changes is matter: [`Perception::world`] is kept in a file, which is written before anybody
//! is told, so that a restarted stub finds the containers, the belt and the arm as they stand.

mod belt;
mod reality;
mod world;

use messages::{
    Action, BeltState, BoxQueue, Malformed, MotionOutcome, MotionReport, PlaceCommand, UPCOMING_MAX, WireBox,
    WirePlacement,
};
use packing::{BoxSpec, Grid, Placement};
use runtime::{PerceptionConfig, Tally};
use serde::{Deserialize, Serialize};

use world::Moving;

pub use belt::{Belt, Position, StreamError};
pub use reality::Reality;
pub use world::{World, WorldError};

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
    /// What is believed of the containers.
    grid: Grid,
    /// How they really are, if that is kept apart.
    reality: Option<Reality>,
    /// Identity of the next container that is brought in.
    next_container: u32,
    belt: Belt,
    phase: Phase,
    /// When the next box is due at the pick position [ns].
    due_ns: u64,
    taken: u64,
    /// The arm's last report.
    last: Option<Reported>,
    /// Whether the world has changed since it was kept last.
    is_changed: bool,
    tally: Tally,
}

/// What the belt and the arm are doing.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    /// The next box is on its way.
    Waiting,
    /// A box lies at the pick position.
    Present { spec: BoxSpec, due_ns: u64, observed_ns: u64, repeat_at_ns: u64 },
    /// The arm moves.
    Moving { spec: BoxSpec, moving: Moving, done_ns: u64 },
    /// There are no more boxes.
    Ended,
}

/// What the arm does with a box.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
enum Motion {
    Place(WirePlacement),
    SetAside,
    Replace { slot: u16 },
}

/// What the arm reported of one order.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Reported {
    order: u64,
    box_id: u64,
    revision: u64,
    action: u32,
    outcome: MotionOutcome,
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
    #[error("the arm fails (world.refuse_share)")]
    Arm,
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
        let (due_ns, taken, last, is_changed) = (now_ns, 0, None, true);
        Self { behaviour, grid, reality: None, next_container, belt, phase, due_ns, taken, last, is_changed, tally }
    }

    /// The world as it was left, whose next box is due at `now_ns`. A motion that was under way begins anew.
    ///
    /// # Errors
    /// [`WorldError`] if the cell or the stream is another one.
    pub fn resume(
        behaviour: Behaviour,
        empty: &Grid,
        mut belt: Belt,
        world: &World,
        now_ns: u64,
    ) -> Result<Self, WorldError> {
        let grid = world.grid(empty)?;
        belt.go_to(world.position)?;
        let mut phase = Phase::Waiting;
        if let Some(moving) = world.moving {
            let spec = belt.take_next().ok_or(WorldError::Damaged)?;
            phase = Phase::Moving { spec, moving, done_ns: now_ns + behaviour.motion_ns };
        }
        let (next_container, taken, last, is_changed) = (world.next_container, world.taken, world.last, false);
        let (due_ns, tally) = (now_ns, Tally::default());
        let reality = None;
        Ok(Self { behaviour, grid, reality, next_container, belt, phase, due_ns, taken, last, is_changed, tally })
    }

    /// The same in a true world, which goes on from how `world` was left.
    ///
    /// # Errors
    /// [`WorldError::OtherReality`] if boxes stand there of which the true world knows nothing.
    pub fn in_reality(mut self, reality: Option<Reality>, world: Option<&World>) -> Result<Self, WorldError> {
        self.reality = reality;
        let Some(reality) = &mut self.reality else { return Ok(self) };
        match world.map(|world| &world.matter) {
            Some(Some(matter)) if reality.go_on(matter) => {}
            None => {}
            Some(None) if !self.grid.slots().iter().any(packing::Slot::is_open) => {}
            Some(_) => return Err(WorldError::OtherReality),
        }
        if let Phase::Moving { spec, .. } | Phase::Present { spec, .. } = &mut self.phase {
            *spec = reality.measured(spec);
        }
        Ok(self)
    }

    /// What whoever begins to listen has to know: the containers, and the arm's last report.
    pub fn begin(&self, say: &mut Vec<Say>) {
        say.push(Say::Belief);
        say.extend(self.last.map(|reported| Say::Motion(reported.message())));
    }

    /// Everything that must outlive the process.
    #[must_use]
    pub fn world(&self) -> World {
        let moving = if let Phase::Moving { moving, .. } = self.phase { Some(moving) } else { None };
        let is_box_out = moving.is_some() || matches!(self.phase, Phase::Present { .. });
        let position = self.belt.position(is_box_out);
        let mut world = World::of(&self.grid, self.next_container, position, self.taken);
        (world.moving, world.last) = (moving, self.last);
        world.matter = self.reality.as_ref().map(Reality::matter);
        world
    }

    /// Whether the world has changed since it was kept last. Until it is kept, nobody may be told.
    #[must_use]
    pub fn is_changed(&self) -> bool {
        self.is_changed
    }

    /// The world was kept as it is now, or could not be.
    pub fn kept(&mut self, result: Result<(), &dyn std::fmt::Display>) {
        match result {
            Ok(()) => {
                self.is_changed = false;
                self.say_alarm();
            }
            Err(error) => self.tally.raise(error),
        }
    }

    /// What a person should know of the containers, if anything.
    fn say_alarm(&mut self) {
        match self.reality.as_ref().and_then(Reality::alarm) {
            Some(alarm) => self.tally.raise(&alarm),
            None => self.tally.clear_alarm(),
        }
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

    /// Lets the world move on to `now_ns`, one change at a time, and appends what is to be said of it.
    pub fn on_time(&mut self, now_ns: u64, say: &mut Vec<Say>) {
        if let Phase::Moving { spec, moving, done_ns } = self.phase
            && now_ns >= done_ns
        {
            // That is kept and said first; then the next box comes.
            self.finish(spec, moving, now_ns, say);
            return;
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
        if let Some(reality) = &mut self.reality {
            let revision = self.grid.revision();
            let may_go_on = reality.may_take_boxes(&mut self.grid);
            if self.grid.revision() != revision {
                // What the camera saw at last is kept and said first.
                say.push(Say::Belief);
                self.is_changed = true;
                return;
            }
            self.say_alarm();
            if !may_go_on {
                self.due_ns = now_ns + self.behaviour.repeat_ns;
                return;
            }
        }
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
                self.is_changed = true;
                return;
            }
        }
        if let Some(spec) = self.belt.take_next() {
            let spec = self.measured(&spec);
            // A belt with a pace keeps its schedule, whoever is behind it; one without has none.
            let due_ns = if self.behaviour.pace_ns == 0 { now_ns } else { self.due_ns };
            self.due_ns = due_ns + self.behaviour.pace_ns;
            self.phase = Phase::Present { spec, due_ns, observed_ns: now_ns, repeat_at_ns: now_ns };
        }
    }

    /// The commander's word. The arm moves if it is for what lies on the belt, and refuses if it cannot.
    pub fn on_command(&mut self, command: &PlaceCommand, now_ns: u64, say: &mut Vec<Say>) {
        match self.check(command) {
            Ok((spec, motion)) => {
                let moving = Moving { order: command.order, revision: command.revision, motion };
                self.tally.handle(spec.id());
                self.is_changed = true;
                if self.behaviour.motion_ns == 0 {
                    self.finish(spec, moving, now_ns, say);
                } else {
                    self.phase = Phase::Moving { spec, moving, done_ns: now_ns + self.behaviour.motion_ns };
                    say.push(Say::Boxes(0));
                }
            }
            Err(Refusal::NotPresent { .. }) => self.tally.pass_over(),
            Err(refusal @ (Refusal::Malformed(_) | Refusal::Impossible(_) | Refusal::Arm)) => {
                self.tally.refuse(&refusal);
                let (order, box_id, revision) = (command.order, command.spec.id, command.revision);
                let (action, outcome) = (command.action, MotionOutcome::Refused);
                let reported = Reported { order, box_id, revision, action, outcome };
                say.push(Say::Motion(reported.message()));
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
                self.grid.check(self.grid.extent(&spec), placement)?;
                Motion::Place(placement.into())
            }
            Action::SetAside => Motion::SetAside,
            Action::Replace => {
                let (slot, slots) = (placement.slot, self.grid.slots().len());
                let missing = packing::PlaceError::NoSuchSlot { slot, slots };
                self.grid.slots().get(usize::from(slot)).ok_or(missing)?;
                Motion::Replace { slot }
            }
        };
        if self.reality.as_ref().is_some_and(|reality| reality.refuses(command.order)) {
            return Err(Refusal::Arm);
        }
        Ok((spec, motion))
    }

    /// The arm has done it.
    fn finish(&mut self, spec: BoxSpec, moving: Moving, now_ns: u64, say: &mut Vec<Say>) {
        let Moving { order, revision, motion } = moving;
        let action = match motion {
            Motion::Place(placement) => {
                // Nothing but the arm changes the belief, so what was checked before the motion still holds.
                let placed = Placement::try_from(placement).map_err(Refusal::from);
                if let Err(error) = placed.and_then(|placement| self.place(&spec, placement)) {
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
        let (box_id, outcome) = (spec.id(), MotionOutcome::Done);
        let reported = Reported { order, box_id, revision, action: action.to_wire(), outcome };
        self.last = Some(reported);
        self.is_changed = true;
        say.push(Say::Motion(reported.message()));
        if action != Action::SetAside {
            say.push(Say::Belief);
        }
        self.phase = match action {
            // The box still lies there, before other containers: that is a new observation, due when the arm is done.
            Action::Replace => Phase::Present { spec, due_ns: now_ns, observed_ns: now_ns, repeat_at_ns: now_ns },
            Action::Place | Action::SetAside => {
                self.taken += 1;
                Phase::Waiting
            }
        };
    }

    /// The box is believed to stand where it was commanded to, or where it is seen.
    fn place(&mut self, spec: &BoxSpec, placement: Placement) -> Result<(), Refusal> {
        let Some(reality) = &mut self.reality else { return Ok(self.grid.place(spec, placement)?) };
        let slot = self.grid.slots().get(usize::from(placement.slot));
        let before = slot.map(|slot| slot.surface().heights().to_vec()).unwrap_or_default();
        self.grid.place(spec, placement)?;
        let real = self.belt.taken().unwrap_or(*spec);
        reality.set_down(&real, spec, placement, before, &mut self.grid);
        Ok(())
    }

    fn replace(&mut self, slot: u16) {
        if self.grid.replace(slot, self.next_container).is_ok() {
            self.next_container += 1;
            if let Some(reality) = &mut self.reality {
                reality.replace(slot);
            }
        }
    }

    fn measured(&self, spec: &BoxSpec) -> BoxSpec {
        self.reality.as_ref().map_or(*spec, |reality| reality.measured(spec))
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
        let upcoming = self.belt.upcoming().take(self.behaviour.upcoming.min(UPCOMING_MAX));
        queue.write_upcoming(upcoming.map(|spec| self.measured(&spec)));
        (queue.taken, queue.episodes) = (self.taken, self.belt.episodes_begun());
        queue.due_ns = if let Phase::Present { due_ns, .. } = self.phase { due_ns } else { 0 };
    }

    /// What it did so far.
    #[must_use]
    pub fn tally(&self) -> &Tally {
        &self.tally
    }
}

impl Reported {
    fn message(self) -> MotionReport {
        let Self { order, box_id, revision, action, outcome } = self;
        let (header, outcome) = (messages::Header::default(), outcome.to_wire());
        MotionReport { header, order, box_id, revision, action, outcome }
    }
}

#[cfg(test)]
mod tests;
