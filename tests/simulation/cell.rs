//! A whole cell in one thread and in a time of its own: the services' own state machines on a bus of the mind.
//!
//! Each process is stepped as its `main.rs` steps it. Between any two of its looks at the bus others may run, and it
//! may die between any two of its deeds. Everything that happens is drawn from one seed.

use std::rc::Rc;

use candidates::Candidates;
use commander::{Commander, Deadlines, Effects, Order};
use dataset::DataSet;
use journal::{AppendError, Entry, HEADER, Record, decode, encode};
use messages::{
    Active, Belief, BoxQueue, CandidateSet, Control, CycleReport, Decision, Header, MotionReport, PlaceCommand, Wish,
};
use packing::{BoxSpec, Candidate, ClosePolicy, ContainerSize, Draw, Grid, Placement, WalleWeights, Yaw};
use perception::{Behaviour, Belt, Perception, Say, World};
use policy::{Engine, Policy, PolicyKind};
use scorer::Scorer;

use crate::bus::{Pool, Sample, Topic};
use crate::ledger::{Ledger, Violation};

pub(crate) const US: u64 = 1_000;
pub(crate) const MS: u64 = 1_000_000;

/// Longest that anybody is kept from running who is not dead or frozen [ns].
pub(crate) const DELAY_NS_MAX: u64 = 4 * MS;
/// The idle beat of every process [ns].
const BEAT_NS: u64 = 50 * MS;
/// After this nothing bad happens any more [ns].
const FAULTS_END_NS: u64 = 300 * MS;
/// By then everything must be over [ns].
const END_NS: u64 = 3_000 * MS;

/// When the commander stops waiting.
pub(crate) const DEADLINES: Deadlines = Deadlines { soft_ns: 12 * MS, hard_ns: 25 * MS };

const GENERATORS: usize = 2;
const SCORERS: usize = 2;
/// Perception, two generators, two scorers, the commander: in this order.
const PROCESSES: usize = 2 + GENERATORS + SCORERS;
const PERCEPTION: usize = 0;
const COMMANDER: usize = PROCESSES - 1;

/// A defect to plant, to see that it is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Bug {
    None,
    /// The intent is written down after the command and not before it.
    JournalAfterCommand,
    /// The arm does not ask on which revision a command was decided.
    ArmIgnoresRevision,
    /// The stub says what it did before it keeps it.
    SaysBeforeKeeping,
}

/// Memory that outlives a run, so that the next one is fast.
pub(crate) struct Memory {
    beliefs: Pool<Belief>,
    queues: Pool<BoxQueue>,
    sets: Pool<CandidateSet>,
    decisions: Pool<Decision>,
    commands: Pool<PlaceCommand>,
    motions: Pool<MotionReport>,
    controls: Pool<Control>,
}

impl Memory {
    pub(crate) fn new() -> Self {
        Self {
            beliefs: Pool::new(),
            queues: Pool::new(),
            sets: Pool::new(),
            decisions: Pool::new(),
            commands: Pool::new(),
            motions: Pool::new(),
            controls: Pool::new(),
        }
    }
}

/// What a process is doing.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Life {
    /// It runs next at this time [ns].
    Awake(u64),
    /// It is started again at this time [ns].
    Dead(u64),
    /// It is running now.
    Running,
}

/// The disk: what survives the processes.
#[derive(Debug, Default)]
struct Disk {
    journal: Vec<u8>,
    world: Vec<u8>,
    full_until_ns: u64,
}

pub(crate) struct Cell {
    draw: Draw,
    bug: Bug,
    now_ns: u64,
    lives: [Life; PROCESSES],
    /// Every life of a process is another publisher.
    publisher: [u64; PROCESSES],
    sequence: u64,
    disk: Disk,
    pub(crate) ledger: Ledger,

    beliefs: Topic<Belief>,
    queues: Topic<BoxQueue>,
    sets: Topic<CandidateSet>,
    decisions: Topic<Decision>,
    commands: Topic<PlaceCommand>,
    motions: Topic<MotionReport>,
    controls: Topic<Control>,

    perception: Option<Perception>,
    /// What perception says as soon as its world is kept.
    unsaid: Vec<Say>,
    generators: [Option<(Candidates, Seen)>; GENERATORS],
    scorers: [Option<(Scorer, Seen)>; SCORERS],
    commander: Option<(Commander, Seen)>,
    boxes: Vec<BoxSpec>,
    depth: u32,
}

/// The messages that a process holds on to.
#[derive(Default)]
struct Seen {
    belief: Option<Rc<Sample<Belief>>>,
    queue: Option<Rc<Sample<BoxQueue>>>,
    set: Option<Rc<Sample<CandidateSet>>>,
}

/// Readers of the belief and the boxes: generators, scorers, commander.
fn reader(process: usize) -> usize {
    process - 1
}

fn size() -> ContainerSize {
    ContainerSize::new(3, 3, 3, 10).expect("27 cells are a container")
}

impl Cell {
    /// A cell of two small containers, and a belt with a few boxes drawn from the seed.
    pub(crate) fn new(seed: u64, bug: Bug, memory: &Memory) -> Self {
        let mut draw = Draw::new(501, seed, 0);
        let count = 3 + draw.below(4);
        let mut side = || 10 * (1 + draw.below(3) as u32);
        let boxes: Vec<BoxSpec> =
            (0..count).map(|id| BoxSpec::new(id, [side(), side(), side()]).expect("sides of 10 to 30 mm")).collect();
        let readers = PROCESSES - 1;
        Self {
            bug,
            now_ns: 1000 * MS,
            lives: [Life::Dead(1000 * MS); PROCESSES],
            publisher: [0; PROCESSES],
            sequence: 0,
            disk: Disk::default(),
            ledger: Ledger::new(boxes.len()),
            beliefs: Topic::new(&memory.beliefs, readers, 1),
            queues: Topic::new(&memory.queues, readers, 1),
            sets: Topic::new(&memory.sets, readers, 2),
            decisions: Topic::new(&memory.decisions, 1, 4),
            commands: Topic::new(&memory.commands, 1, 2),
            motions: Topic::new(&memory.motions, 1, 2),
            controls: Topic::new(&memory.controls, 1, 4),
            perception: None,
            unsaid: Vec::new(),
            generators: Default::default(),
            scorers: Default::default(),
            commander: None,
            boxes,
            depth: 0,
            draw,
        }
    }

    fn chance(&mut self, one_in: u64) -> bool {
        self.draw.below(one_in) == 0
    }

    fn is_calm(&self) -> bool {
        self.now_ns >= 1000 * MS + FAULTS_END_NS
    }

    /// How long a process waits for a processor.
    fn delay_ns(&mut self) -> u64 {
        match self.draw.below(16) {
            0 => self.draw.below(DELAY_NS_MAX),
            1..4 => 200 * US + self.draw.below(600 * US),
            _ => 5 * US + self.draw.below(60 * US),
        }
    }

    fn header(&mut self, process: usize, observed_ns: u64) -> Header {
        self.sequence += 1;
        let (publisher, sequence, stamp_ns) = (self.publisher[process], self.sequence, self.now_ns);
        Header { publisher, sequence, stamp_ns, observed_ns }
    }

    /// Rings a process's bell.
    fn ring(&mut self, process: usize) {
        let at_ns = self.now_ns + self.delay_ns();
        if let Life::Awake(due_ns) = &mut self.lives[process] {
            *due_ns = (*due_ns).min(at_ns.max(self.now_ns));
        }
    }

    /// Runs until every box is dealt with and everybody knows, or a rule is broken.
    pub(crate) fn run(&mut self) -> Result<(), Violation> {
        while !self.is_over() {
            if self.now_ns > 1000 * MS + END_NS {
                return Err(Violation::new("the cell stands still", self.now_ns));
            }
            if !self.is_calm() && self.chance(40) {
                self.fault();
            }
            let (process, due_ns) = self.next(None);
            self.now_ns = self.now_ns.max(due_ns);
            self.step(process)?;
        }
        self.ledger.audit(&self.disk.journal, &self.boxes)
    }

    /// Everything that two runs of one schedule must have in common.
    pub(crate) fn trace(&self) -> (u64, u64, Vec<u8>, Vec<u8>) {
        (self.now_ns, self.sequence, self.disk.journal.clone(), self.disk.world.clone())
    }

    fn is_over(&self) -> bool {
        let is_empty = self.perception.as_ref().is_some_and(|p| p.wake_ns().is_none() && !p.is_changed());
        is_empty && self.ledger.is_complete() && self.commander.is_some()
    }

    fn next(&self, except: Option<usize>) -> (usize, u64) {
        let due = self.lives.iter().enumerate().filter_map(|(process, life)| match life {
            Life::Awake(due_ns) | Life::Dead(due_ns) => Some((process, *due_ns)),
            Life::Running => None,
        });
        let due = due.filter(|(process, _)| Some(*process) != except);
        due.min_by_key(|&(process, due_ns)| (due_ns, process)).expect("somebody is always waiting")
    }

    /// Something that must not matter.
    fn fault(&mut self) {
        self.ledger.is_disturbed = true;
        let process = self.draw.below(PROCESSES as u64) as usize;
        match self.draw.below(10) {
            0..4 => self.kill(process),
            4..6 => {
                // Frozen for a while.
                let thaw_ns = self.now_ns + self.draw.below(100 * MS);
                if let Life::Awake(due_ns) = &mut self.lives[process] {
                    *due_ns = (*due_ns).max(thaw_ns);
                }
            }
            6 => self.disk.full_until_ns = self.now_ns + self.draw.below(60 * MS),
            7 => self.swap(),
            8 => self.rubbish_decision(),
            _ => self.rubbish_set(),
        }
    }

    fn kill(&mut self, process: usize) {
        if self.lives[process] != Life::Running {
            self.die(process);
        }
    }

    /// The end of a process's life, and when the next one begins.
    fn die(&mut self, process: usize) {
        self.ledger.is_disturbed = true;
        let dead = self.publisher[process];
        self.beliefs.bury(dead);
        self.queues.bury(dead);
        self.sets.bury(dead);
        self.decisions.bury(dead);
        self.commands.bury(dead);
        self.motions.bury(dead);
        match process {
            PERCEPTION => {
                self.perception = None;
                self.unsaid.clear();
            }
            COMMANDER => {
                self.commander = None;
                if self.chance(6) {
                    self.cut_power();
                }
            }
            1..=GENERATORS => self.generators[process - 1] = None,
            _ => self.scorers[process - 1 - GENERATORS] = None,
        }
        let back_ns = self.now_ns + MS + self.draw.below(80 * MS);
        self.lives[process] = Life::Dead(back_ns);
    }

    /// The end of the journal never reached the disk.
    fn cut_power(&mut self) {
        let length = self.disk.journal.len() as u64;
        let kept = length - self.draw.below(1 + length.min(120));
        self.ledger.cut(kept < length);
        self.disk.journal.truncate(kept as usize);
    }

    fn swap(&mut self) {
        let instance = self.draw.below(SCORERS as u64) as u32;
        let request = self.now_ns;
        let header = Header::default();
        self.controls.publish(header, |control| {
            (control.request, control.wish, control.instance) = (request, Wish::Promote.to_wire(), instance);
        });
        self.ring(COMMANDER);
    }

    /// A scorer's answer as no scorer gives it, to what may be the present question.
    fn rubbish_decision(&mut self) {
        let Some((_, seen)) = &self.commander else { return };
        let Some(set) = seen.set.as_ref().map(Rc::clone) else { return };
        let set = set.get();
        let value = [0.0, f32::NAN, f32::INFINITY][self.draw.below(3) as usize];
        let best = [0, set.count, u32::MAX, self.draw.below(20) as u32][self.draw.below(4) as usize];
        let instance = [0, 1, 7, 8, u32::MAX][self.draw.below(5) as usize];
        let revision = set.revision.wrapping_sub(self.draw.below(2));
        let header = Header { publisher: 99, stamp_ns: u64::MAX, observed_ns: u64::MAX, ..Header::default() };
        let (box_id, set_digest) = (set.current.id, set.digest);
        self.decisions.publish(header, |decision| {
            (decision.box_id, decision.revision, decision.set_digest) = (box_id, revision, set_digest);
            (decision.instance, decision.best, decision.value) = (instance, best, value);
        });
        self.ring(COMMANDER);
    }

    /// Candidates that are none, with a digest that is right.
    fn rubbish_set(&mut self) {
        let Some(perception) = &self.perception else { return };
        let revision = perception.grid().revision().wrapping_sub(self.draw.below(2));
        let spec = self.boxes[self.draw.below(self.boxes.len() as u64) as usize];
        let id = spec.id() + 1;
        let spec = BoxSpec::new(id, spec.size_mm()).expect("the box is one of the belt's");
        let count = self.draw.below(4);
        let mut cell = || self.draw.below(4) as u16;
        let mut candidate = || Candidate {
            placement: Placement { slot: cell(), yaw: Yaw::Deg0, i: cell(), j: cell(), base: cell() },
            walle: 1.0,
        };
        let candidates: Vec<Candidate> = (0..count).map(|_| candidate()).collect();
        let header = Header { publisher: 98, stamp_ns: u64::MAX, observed_ns: 0, ..Header::default() };
        self.sets.publish(header, |set| {
            (set.revision, set.current, set.upcoming_count) = (revision, spec.into(), 0);
            set.write_candidates(&candidates);
        });
        self.sets.bury(98);
        (1 + GENERATORS..PROCESSES).for_each(|process| self.ring(process));
    }

    /// Others run while this process is between two looks.
    fn interleave(&mut self, process: usize) -> Result<(), Violation> {
        if self.depth < 2 && self.chance(8) {
            self.depth += 1;
            let (other, _) = self.next(Some(process));
            let result = self.step(other);
            self.depth -= 1;
            return result;
        }
        Ok(())
    }

    fn step(&mut self, process: usize) -> Result<(), Violation> {
        if let Life::Dead(_) = self.lives[process] {
            self.start(process)?;
        }
        self.lives[process] = Life::Running;
        let wake_ns = match process {
            PERCEPTION => self.step_perception()?,
            COMMANDER => self.step_commander()?,
            1..=GENERATORS => self.step_generator(process)?,
            _ => self.step_scorer(process)?,
        };
        if self.lives[process] == Life::Running {
            let due_ns = wake_ns.unwrap_or(u64::MAX).min(self.now_ns + BEAT_NS);
            self.lives[process] = Life::Awake(due_ns.max(self.now_ns) + self.delay_ns());
        }
        Ok(())
    }

    fn start(&mut self, process: usize) -> Result<(), Violation> {
        self.sequence += 1;
        self.publisher[process] = 100 + self.sequence;
        if process != PERCEPTION {
            self.beliefs.rejoin(reader(process));
            self.queues.rejoin(reader(process));
            self.sets.rejoin(reader(process));
        }
        match process {
            PERCEPTION => self.start_perception()?,
            COMMANDER => self.start_commander()?,
            1..=GENERATORS => {
                self.generators[process - 1] = Some((Candidates::new(WalleWeights::PAPER), Seen::default()));
            }
            _ => {
                let policy = Policy::new(PolicyKind::Walle, Engine::BurnFlex, None).expect("WallE needs no model");
                let number = process - 1 - GENERATORS;
                let instance = messages::Instance::from_wire(number as u32).expect("two instances are two of eight");
                self.scorers[number] = Some((Scorer::new(policy, instance), Seen::default()));
            }
        }
        Ok(())
    }

    fn start_perception(&mut self) -> Result<(), Violation> {
        self.commands.rejoin(0);
        let set = DataSet {
            name: "simulated".to_owned(),
            container: size(),
            optimum: None,
            episodes: vec![self.boxes.clone()],
            skipped: dataset::Skipped::default(),
        };
        let belt = Belt::of(set, 1);
        let grid = Grid::new(size(), 2).expect("two small containers are a grid");
        let motion_ns = self.draw.below(3) * 10 * MS;
        let behaviour = Behaviour { pace_ns: 0, motion_ns, repeat_ns: 20 * MS, upcoming: 2 };
        let perception = if self.disk.world.is_empty() {
            Perception::new(behaviour, grid, belt, self.now_ns)
        } else {
            let world = World::decode(&self.disk.world);
            let resumed = world.and_then(|world| Perception::resume(behaviour, &grid, belt, &world, self.now_ns));
            resumed.map_err(|error| Violation::new(format!("the stub cannot go on: {error}"), self.now_ns))?
        };
        let mut say = Vec::new();
        perception.begin(&mut say);
        self.perception = Some(perception);
        self.publish(&say);
        Ok(())
    }

    fn step_perception(&mut self) -> Result<Option<u64>, Violation> {
        let mut perception = self.perception.take().expect("a process that is stepped lives");
        let mut say = std::mem::take(&mut self.unsaid);
        while !perception.is_changed()
            && let Some(command) = self.commands.receive(0)
        {
            let mut command = *command.get();
            if self.bug == Bug::ArmIgnoresRevision {
                command.revision = perception.grid().revision();
            }
            perception.on_command(&command, self.now_ns, &mut say);
        }
        if !perception.is_changed() {
            perception.on_time(self.now_ns, &mut say);
        }
        let dies = !self.is_calm() && self.chance(60);
        let dies_after = if dies { self.draw.below(2 + say.len() as u64) } else { u64::MAX };
        if self.bug == Bug::SaysBeforeKeeping {
            self.perception = Some(perception);
            self.publish(&say);
            perception = self.perception.take().expect("it was put there just now");
        }
        if dies_after == 0 {
            self.die(PERCEPTION);
            return Ok(None);
        }
        if perception.is_changed() {
            if self.disk.full_until_ns > self.now_ns && !self.is_calm() {
                self.unsaid = say;
                self.perception = Some(perception);
                return Ok(None);
            }
            perception.world().encode(&mut self.disk.world);
            perception.kept(Ok(()));
            self.ledger.happened(&say, self.now_ns)?;
        }
        self.perception = Some(perception);
        for (count, said) in say.iter().enumerate() {
            if count as u64 + 1 == dies_after {
                self.die(PERCEPTION);
                return Ok(None);
            }
            if self.bug != Bug::SaysBeforeKeeping {
                self.publish(std::slice::from_ref(said));
            }
        }
        Ok(self.perception.as_ref().and_then(Perception::wake_ns))
    }

    fn publish(&mut self, say: &[Say]) {
        for one in say {
            let observed_ns = if let Say::Boxes(observed_ns) = one { *observed_ns } else { 0 };
            let header = self.header(PERCEPTION, observed_ns);
            let Some(perception) = &self.perception else { return };
            match one {
                Say::Motion(report) => {
                    self.motions.publish(header, |motion| *motion = *report);
                    self.ring(COMMANDER);
                }
                Say::Belief => self.beliefs.publish(header, |belief| belief.write(perception.grid())),
                Say::Boxes(_) => {
                    self.queues.publish(header, |queue| perception.write_boxes(queue));
                    (1..=GENERATORS).for_each(|process| self.ring(process));
                }
            }
        }
    }

    fn step_generator(&mut self, process: usize) -> Result<Option<u64>, Violation> {
        let (mut service, mut seen) = self.generators[process - 1].take().expect("a process that is stepped lives");
        let received_ns = self.now_ns;
        if let Some(queue) = self.queues.newest(reader(process)) {
            seen.queue = Some(queue);
            self.interleave(process)?;
            if let Some(belief) = self.beliefs.newest(reader(process)) {
                seen.belief = Some(belief);
            }
            if let (Some(queue), Some(belief)) = (&seen.queue, &seen.belief) {
                let (queue, belief) = (Rc::clone(queue), Rc::clone(belief));
                self.now_ns += 30 * US;
                if let Some(found) = service.find(queue.get(), belief.get()) {
                    let header = self.header(process, found.observed_ns());
                    self.sets.publish(header, |set| found.write(set, received_ns));
                    (1 + GENERATORS..PROCESSES).for_each(|process| self.ring(process));
                }
            }
        }
        self.generators[process - 1] = Some((service, seen));
        Ok(None)
    }

    fn step_scorer(&mut self, process: usize) -> Result<Option<u64>, Violation> {
        let number = process - 1 - GENERATORS;
        let (mut service, mut seen) = self.scorers[number].take().expect("a process that is stepped lives");
        let received_ns = self.now_ns;
        if let Some(set) = self.sets.newest(reader(process)) {
            seen.set = Some(set);
            self.interleave(process)?;
            if let Some(belief) = self.beliefs.newest(reader(process)) {
                seen.belief = Some(belief);
            }
            if let (Some(set), Some(belief)) = (&seen.set, &seen.belief) {
                self.now_ns += 100 * US;
                let verdict = service.decide(set.get(), belief.get(), received_ns, &mut || false);
                if let Some(verdict) = verdict {
                    let header = self.header(process, verdict.observed_ns());
                    self.decisions.publish(header, |decision| verdict.write(decision, received_ns));
                    self.ring(COMMANDER);
                }
            }
        }
        self.scorers[number] = Some((service, seen));
        Ok(None)
    }

    fn start_commander(&mut self) -> Result<(), Violation> {
        self.decisions.rejoin(0);
        self.motions.rejoin(0);
        self.controls.rejoin(0);
        let contents = decode(&self.disk.journal);
        self.disk.journal.truncate(contents.whole_bytes);
        if self.disk.journal.is_empty() {
            self.disk.journal.extend(HEADER);
        }
        let state = contents.state();
        self.ledger.restarted(&state, self.now_ns)?;
        let mut commander = Commander::new(DEADLINES, ClosePolicy::Fullest, &state, self.now_ns);
        let mut hands = Hands::new(self, None);
        let _reported = commander.begin(&state, hands.now_ns(), &mut hands);
        hands.finish()?;
        self.commander = Some((commander, Seen::default()));
        Ok(())
    }

    fn step_commander(&mut self) -> Result<Option<u64>, Violation> {
        let (mut commander, mut seen) = self.commander.take().expect("a process that is stepped lives");
        let mut heard: Vec<Decision> = Vec::new();
        while let Some(decision) = self.decisions.receive(0) {
            heard.push(*decision.get());
        }
        self.interleave(COMMANDER)?;
        let set = self.sets.newest(reader(COMMANDER));
        self.interleave(COMMANDER)?;
        let queue = self.queues.newest(reader(COMMANDER));
        self.interleave(COMMANDER)?;
        let belief = self.beliefs.newest(reader(COMMANDER));
        self.interleave(COMMANDER)?;
        let mut motions = Vec::new();
        while let Some(motion) = self.motions.receive(0) {
            motions.push(motion);
        }
        let mut controls = Vec::new();
        while let Some(control) = self.controls.receive(0) {
            controls.push(control);
        }
        let dies_after = if !self.is_calm() && self.chance(40) { Some(self.draw.below(4)) } else { None };
        let now_ns = self.now_ns;
        let mut hands = Hands::new(self, dies_after);
        // The hands' only failure is death, after which nothing has an effect.
        for motion in &motions {
            let _alive = commander.on_motion(motion.get(), &mut hands);
        }
        if let Some(belief) = belief {
            commander.on_belief(belief.get());
            seen.belief = Some(belief);
        }
        if let Some(queue) = queue {
            let _alive = commander.on_boxes(queue.get(), now_ns, &mut hands);
            seen.queue = Some(queue);
        }
        if let Some(set) = set {
            let _alive = commander.on_candidates(set.get(), now_ns, &mut hands);
            seen.set = Some(set);
        }
        for decision in &heard {
            let _alive = commander.on_decision(decision, now_ns, &mut hands);
        }
        let _alive = commander.on_time(now_ns, &mut hands);
        for control in &controls {
            if commander.on_control(control.get(), &mut hands) {
                let (instance, request) = commander.active();
                hands.answer(&Active { instance, request, ..bytemuck::Zeroable::zeroed() });
            }
        }
        let is_dead = hands.finish()?;
        if is_dead {
            self.die(COMMANDER);
            return Ok(None);
        }
        let wake_ns = commander.wake_ns();
        self.ledger.waits(wake_ns, now_ns)?;
        self.commander = Some((commander, seen));
        Ok(wake_ns)
    }
}

/// The commander's hands, which may die between any two deeds.
struct Hands<'a> {
    cell: &'a mut Cell,
    deeds_left: Option<u64>,
    is_dead: bool,
    /// What the planted bug writes too late.
    unwritten: Option<Record>,
    violation: Option<Violation>,
}

/// The end of a commander in the middle of a step.
#[derive(Debug)]
struct Died;

impl<'a> Hands<'a> {
    fn new(cell: &'a mut Cell, deeds_left: Option<u64>) -> Self {
        Self { cell, deeds_left, is_dead: false, unwritten: None, violation: None }
    }

    fn now_ns(&self) -> u64 {
        self.cell.now_ns
    }

    /// Whether it lives to do one more deed.
    fn lives(&mut self) -> bool {
        if let Some(left) = &mut self.deeds_left {
            self.is_dead |= *left == 0;
            *left = left.saturating_sub(1);
        }
        !self.is_dead
    }

    fn note(&mut self, result: Result<(), Violation>) {
        if let Err(violation) = result {
            self.violation.get_or_insert(violation);
        }
    }

    fn answer(&mut self, active: &Active) {
        if !self.is_dead {
            self.cell.ledger.promoted(active.instance);
        }
    }

    fn finish(self) -> Result<bool, Violation> {
        self.violation.map_or(Ok(self.is_dead), Err)
    }

    fn write(&mut self, record: &Record) {
        encode(&Entry { unix_ms: 0, record: *record }, &mut self.cell.disk.journal);
    }
}

impl Effects for Hands<'_> {
    type Error = Died;

    fn append(&mut self, record: &Record) -> Result<(), AppendError> {
        let refusal = |why: &str| AppendError::Write { path: "journal.bin".into(), source: std::io::Error::other(why) };
        if !self.lives() {
            return Err(refusal("dead"));
        }
        if self.cell.disk.full_until_ns > self.cell.now_ns && !self.cell.is_calm() {
            return Err(refusal("full"));
        }
        if self.cell.bug == Bug::JournalAfterCommand && matches!(record, Record::Intent(_)) {
            self.unwritten = Some(*record);
        } else {
            self.write(record);
        }
        Ok(())
    }

    fn command(&mut self, order: &Order) -> Result<u64, Died> {
        if !self.lives() {
            return Err(Died);
        }
        let truth = self.cell.perception.as_ref().map(|perception| perception.grid().revision());
        let result = self.cell.ledger.commanded(order, truth, self.cell.now_ns);
        self.note(result);
        let header = self.cell.header(COMMANDER, order.observed_ns());
        self.cell.commands.publish(header, |command| order.write(command));
        self.cell.ring(PERCEPTION);
        if let Some(record) = self.unwritten.take()
            && self.lives()
        {
            self.write(&record);
        }
        Ok(self.cell.now_ns)
    }

    fn report(&mut self, report: &CycleReport) -> Result<(), Died> {
        if !self.lives() {
            return Err(Died);
        }
        let result = self.cell.ledger.reported(report, self.cell.now_ns);
        self.note(result);
        Ok(())
    }
}
