//! Candidate set to decision.
//!
//! Keeps nothing between boxes but a copy of the grid and its last verdict. A restart loses nothing: the next
//! repetition of the set is answered, and meanwhile the commander has other opinions.

use messages::{Belief, CANDIDATES_MAX, CandidateSet, Decision, GridCopy, Instance, Malformed, UPCOMING_MAX, WireBox};
use packing::{BoxSpec, Candidate, ContainerSize, Extent, Grid, PlaceError, Placement, Yaw};
use policy::{NotFinite, Policy};
use runtime::Tally;

/// A scorer's state between two events.
#[derive(Debug)]
pub struct Scorer {
    policy: Policy,
    instance: Instance,
    /// The set that was answered last.
    answered: Option<Answered>,
    grid: GridCopy,
    candidates: Vec<Candidate>,
    upcoming: Vec<Extent>,
    tally: Tally,
}

/// Which set was answered, whose it was, and when.
#[derive(Clone, Copy, Debug)]
struct Answered {
    box_id: u64,
    revision: u64,
    set_digest: u64,
    publisher: u64,
    received_ns: u64,
}

/// For so long after an answer, the same set from another generator is the same work [ns]. After that it may be that
/// the first generator has died and somebody missed the answer.
const EQUAL_WORK_NS: u64 = 10_000_000;

/// The answer to one set, ready to be written where the commander will read it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Verdict {
    box_id: u64,
    revision: u64,
    set_digest: u64,
    observed_ns: u64,
    model: u64,
    instance: u32,
    best: u32,
    value: f32,
    depth: u32,
}

/// Why a set has no answer.
#[derive(Debug, thiserror::Error)]
enum Refusal {
    #[error(transparent)]
    Malformed(#[from] Malformed),
    #[error(transparent)]
    NotFinite(#[from] NotFinite),
    #[error("a candidate breaks a rule: {0}")]
    Infeasible(#[from] PlaceError),
}

impl Scorer {
    /// The instance of this number with this policy.
    #[must_use]
    pub fn new(policy: Policy, instance: Instance) -> Self {
        let (candidates, upcoming) = (Vec::with_capacity(CANDIDATES_MAX), Vec::with_capacity(UPCOMING_MAX));
        let (grid, tally, answered) = (GridCopy::default(), Tally::default(), None);
        Self { policy, instance, answered, grid, candidates, upcoming, tally }
    }

    /// Scores as many candidates as a set can have, so that no box pays for what is done only once: the memory of all
    /// buffers is there and touched.
    pub fn warm_up(&mut self, size: ContainerSize, slots: usize) {
        let Ok(grid) = Grid::new(size, slots) else { return };
        let extent = Extent { length: size.length().div_ceil(2), breadth: size.breadth().div_ceil(2), height: 1 };
        let (rows, columns) = (size.length() - extent.length, size.breadth() - extent.breadth);
        // Neighbours differ in `i`, so that nothing is shared between them.
        let places = (0..=columns).flat_map(|j| (0..=rows).map(move |i| (i, j))).cycle().take(CANDIDATES_MAX);
        self.candidates.clear();
        self.candidates.extend(
            places.map(|(i, j)| Candidate {
                placement: Placement { slot: 0, yaw: Yaw::Deg0, i, j, base: 0 },
                walle: 0.0,
            }),
        );
        for _ in 0..2 {
            let _only_the_exercise_counts = self.policy.choose(&grid, extent, &[], &self.candidates);
        }
        self.candidates.truncate(4);
        for _ in 0..10 {
            let _only_the_exercise_counts = self.policy.choose(&grid, extent, &[extent], &self.candidates);
        }
    }

    /// The policy's answer to a set that was received at `received_ns`; nothing if the set is empty, if set and belief
    /// are not of one revision, or if another generator's equal set was answered just now. A policy that plans gives
    /// its best so far once `is_over` says so.
    pub fn decide(
        &mut self,
        set: &CandidateSet,
        belief: &Belief,
        received_ns: u64,
        is_over: &mut dyn FnMut() -> bool,
    ) -> Option<Verdict> {
        if set.revision != belief.revision || self.is_equal_work(set, received_ns) {
            self.tally.pass_over();
            return None;
        }
        match self.try_decide(set, belief, is_over) {
            Ok(verdict) => {
                let (box_id, revision, set_digest) = (set.current.id, set.revision, set.digest);
                let publisher = set.header.publisher;
                self.answered = Some(Answered { box_id, revision, set_digest, publisher, received_ns });
                self.tally.handle(box_id);
                verdict
            }
            Err(refusal) => {
                self.tally.refuse(&refusal);
                None
            }
        }
    }

    /// Whether another generator's equal set was answered just now. A set that its own generator says again is
    /// answered again: somebody may have missed the first answer.
    fn is_equal_work(&self, set: &CandidateSet, received_ns: u64) -> bool {
        self.answered.is_some_and(|answered| {
            (answered.box_id, answered.revision, answered.set_digest) == (set.current.id, set.revision, set.digest)
                && answered.publisher != set.header.publisher
                && received_ns.saturating_sub(answered.received_ns) < EQUAL_WORK_NS
        })
    }

    fn try_decide(
        &mut self,
        set: &CandidateSet,
        belief: &Belief,
        is_over: &mut dyn FnMut() -> bool,
    ) -> Result<Option<Verdict>, Refusal> {
        let spec = set.spec()?;
        set.read_candidates(&mut self.candidates)?;
        let grid = self.grid.follow(belief)?;
        let extent = grid.extent(&spec);
        self.candidates.iter().try_for_each(|candidate| grid.check(extent, candidate.placement))?;
        let extent_of = |&wire: &WireBox| BoxSpec::try_from(wire).map(|spec| grid.extent(&spec));
        self.upcoming.clear();
        for wire in set.known_upcoming()? {
            self.upcoming.push(extent_of(wire)?);
        }
        let choice = self.policy.choose_within(grid, extent, &self.upcoming, &self.candidates, is_over)?;
        Ok(choice.map(|choice| Verdict {
            box_id: spec.id(),
            revision: set.revision,
            set_digest: set.digest,
            observed_ns: set.header.observed_ns,
            model: self.policy.fingerprint(),
            instance: self.instance.to_wire(),
            best: choice.index as u32,
            value: choice.value,
            depth: u32::from(choice.depth),
        }))
    }

    /// What it did so far.
    #[must_use]
    pub fn tally(&self) -> &Tally {
        &self.tally
    }
}

impl Verdict {
    /// When the observation that it answers was made [ns].
    #[must_use]
    pub fn observed_ns(&self) -> u64 {
        self.observed_ns
    }

    /// Writes the decision for a set that was received at `received_ns`.
    pub fn write(&self, decision: &mut Decision, received_ns: u64) {
        decision.received_ns = received_ns;
        (decision.box_id, decision.revision, decision.set_digest) = (self.box_id, self.revision, self.set_digest);
        (decision.model, decision.instance) = (self.model, self.instance);
        (decision.best, decision.value, decision.depth) = (self.best, self.value, self.depth);
    }
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;
    use packing::{Heuristic, WalleWeights, corner_candidates};
    use policy::{Engine, PolicyKind};

    use super::*;

    fn scorer() -> Scorer {
        Scorer::new(Policy::new(PolicyKind::Walle, Engine::BurnFlex, None).unwrap(), "b".parse().unwrap())
    }

    fn question() -> (Box<Belief>, Box<CandidateSet>, Vec<Candidate>) {
        let grid = Grid::new(ContainerSize::new(9, 9, 9, 10).unwrap(), 2).unwrap();
        let mut belief: Box<Belief> = Box::new(Zeroable::zeroed());
        belief.write(&grid);
        let mut set: Box<CandidateSet> = Box::new(Zeroable::zeroed());
        set.current = WireBox { id: 5, size_mm: [30, 40, 50], reserved: 0 };
        let mut candidates = Vec::new();
        corner_candidates(&grid, Extent { length: 3, breadth: 4, height: 5 }, &WalleWeights::PAPER, &mut candidates);
        set.write_candidates(&candidates);
        (belief, set, candidates)
    }

    #[test]
    fn a_set_is_answered_with_the_policys_choice() {
        let (belief, set, candidates) = question();
        let verdict = scorer().decide(&set, &belief, 0, &mut || false).unwrap();
        let best = Heuristic::walle_choice(&candidates).unwrap();
        assert_eq!((verdict.box_id, verdict.instance, verdict.best), (5, 1, best as u32));
        assert_eq!(verdict.set_digest, set.digest);
    }

    #[test]
    fn an_old_set_an_empty_set_and_rubbish_have_no_answer() {
        let mut scorer = scorer();
        let (belief, mut set, _) = question();
        set.revision = 1;
        assert_eq!(scorer.decide(&set, &belief, 0, &mut || false), None);
        let (_, mut set, candidates) = question();
        set.write_candidates(&[]);
        assert_eq!(scorer.decide(&set, &belief, 0, &mut || false), None);
        assert_eq!((scorer.tally().counters.stale, scorer.tally().counters.refused), (1, 0));
        for stray in [Placement { slot: 2, ..candidates[0].placement }, Placement { i: 60, ..candidates[0].placement }]
        {
            set.write_candidates(&[Candidate { placement: stray, ..candidates[0] }]);
            assert_eq!(scorer.decide(&set, &belief, 0, &mut || false), None);
        }
        set.count = 9999;
        assert_eq!(scorer.decide(&set, &belief, 0, &mut || false), None);
        assert_eq!(scorer.tally().counters.refused, 3);
    }

    #[test]
    fn two_generators_make_work_once_unless_one_of_them_says_it_again() {
        let (belief, mut set, _) = question();
        let mut scorer = scorer();
        let mut answers = |publisher, received_ns| {
            set.header.publisher = publisher;
            scorer.decide(&set, &belief, received_ns, &mut || false).is_some()
        };
        assert!(answers(1, 100));
        assert!(!answers(2, 200), "the same set of the other generator");
        assert!(answers(1, 300), "a repetition");
        assert!(answers(2, 300 + EQUAL_WORK_NS), "the first generator says nothing any more");
    }
}
