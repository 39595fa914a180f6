//! What decides: a kind of policy, an engine and a model, ready to be asked.

use std::fmt;
use std::str::FromStr;

use packing::{Candidate, Extent, Grid, Heuristic};

use crate::encoding::Encoding;
use crate::engine::{Engine, MovesScorer, PublishedScorer};
use crate::lookahead::{self, Plan, Planner, WIDTHS};
use crate::model::{Model, ModelError, Scope};
use crate::moves::{ContainerView, Features, features};

/// How a policy comes to its choice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PolicyKind {
    /// WallE's score, without a network: the highest in the first container that has a candidate.
    Walle,
    /// The highest value by the paper's network, among the candidates of the first container that has any.
    PackmanPublished,
    /// The highest value by the network of moves, among all candidates.
    Packman,
    /// The first move of the best plan for this box and those known to follow, by the network of moves.
    PackmanLookahead,
}

/// A name that no policy has.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no policy {0:?}: use one of {names}", names = PolicyKind::NAMES.join(", "))]
pub struct PolicyKindError(pub String);

/// A policy, ready to choose. It keeps its buffers between boxes and nothing else, so it may be asked about any
/// grid at any time.
#[derive(Debug)]
pub struct Policy {
    kind: PolicyKind,
    engine: Engine,
    scorer: Option<Scorer>,
    planner: Planner,
    values: Vec<f32>,
}

/// A model on its engine, with buffers.
#[derive(Debug)]
struct Scorer {
    fingerprint: u64,
    scope: Scope,
    judge: Judge,
}

/// A network with what turns candidates into its input.
#[derive(Debug)]
enum Judge {
    Published(Box<PublishedScorer>),
    Moves { network: MovesScorer, moves: Vec<Features> },
}

/// The chosen candidate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice {
    /// Its index among the candidates of the decision.
    pub index: usize,
    /// What the policy thinks of it; comparable only within one decision.
    pub value: f32,
    /// Boxes the choice was planned for, the current one included.
    pub depth: u8,
    /// Width of the widest finished beam of the plan; 0 for a choice without a plan.
    pub width: u16,
}

impl Choice {
    /// A choice by its own value alone.
    fn greedy(index: usize, value: f32) -> Self {
        Self { index, value, depth: 1, width: 0 }
    }
}

/// Why a policy cannot be made.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PolicyError {
    /// The kind has a network and no model was given.
    #[error("the policy {0} needs a model: give a model file, or use walle")]
    NoModel(PolicyKind),
    /// The model's network is not the one that the kind uses.
    #[error(
        "the policy {kind} needs another model than one that reads the encoding {encoding:?}: give its own model file"
    )]
    OtherModel {
        /// The kind asked for.
        kind: PolicyKind,
        /// The input of the model given.
        encoding: String,
    },
}

/// The network gave a value that is no finite number, so nothing can be chosen by it.
///
/// Loaded weights are finite and inputs lie in 0 to 1, so this means weights near the limits of their type or a
/// broken machine. Whoever asked should let somebody else choose, and count it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the network's value of candidate {candidate} is not a finite number: choose by another policy and replace the model"
)]
pub struct NotFinite {
    /// Index of the first such candidate.
    pub candidate: usize,
}

impl Policy {
    /// A policy of this kind on this engine. A kind without a network ignores the model.
    ///
    /// # Errors
    /// [`PolicyError`] if the kind needs a model and none is given.
    pub fn new(kind: PolicyKind, engine: Engine, model: Option<&Model>) -> Result<Self, PolicyError> {
        let scorer = if kind == PolicyKind::Walle {
            None
        } else {
            let model = model.ok_or(PolicyError::NoModel(kind))?;
            let encoding = model.card().encoding;
            let is_its_own = (encoding == Encoding::Moves) != (kind == PolicyKind::PackmanPublished);
            let scorer = is_its_own.then(|| Scorer::new(engine, model)).flatten();
            Some(scorer.ok_or_else(|| PolicyError::OtherModel { kind, encoding: encoding.to_string() })?)
        };
        Ok(Self { kind, engine, scorer, planner: Planner::new(&WIDTHS), values: Vec::new() })
    }

    /// Its kind.
    #[must_use]
    pub fn kind(&self) -> PolicyKind {
        self.kind
    }

    /// What computes its network.
    #[must_use]
    pub fn engine(&self) -> Engine {
        self.engine
    }

    /// The fingerprint of its model; 0 without one.
    #[must_use]
    pub fn fingerprint(&self) -> u64 {
        self.scorer.as_ref().map_or(0, |scorer| scorer.fingerprint)
    }

    /// Chooses among the candidates of a box of `extent` (yaw 0); nothing if there are none. Of equal candidates
    /// the earlier one is chosen. `upcoming` are the extents of the boxes known to follow, nearest first.
    ///
    /// # Errors
    /// [`NotFinite`] if the network fails.
    pub fn choose(
        &mut self,
        grid: &Grid,
        extent: Extent,
        upcoming: &[Extent],
        candidates: &[Candidate],
    ) -> Result<Option<Choice>, NotFinite> {
        self.choose_within(grid, extent, upcoming, candidates, &mut || false)
    }

    /// As [`Policy::choose`], and stops planning once `is_over` says so: the best choice so far is given. It is
    /// asked every few ten microseconds. A choice without a plan takes no notice of it.
    ///
    /// # Errors
    /// [`NotFinite`] if the network fails.
    pub fn choose_within(
        &mut self,
        grid: &Grid,
        extent: Extent,
        upcoming: &[Extent],
        candidates: &[Candidate],
        is_over: &mut dyn FnMut() -> bool,
    ) -> Result<Option<Choice>, NotFinite> {
        let Some(scorer) = &mut self.scorer else {
            let greedy = |index| Choice::greedy(index, candidates[index].walle);
            return Ok(Heuristic::walle_choice(candidates).map(greedy));
        };
        scorer.values(grid, extent, candidates, &mut self.values)?;
        if self.kind != PolicyKind::PackmanLookahead {
            return best(&self.values);
        }
        let candidates = scorer.scope.considered(candidates);
        let extents = [extent].into_iter().chain(upcoming.iter().copied());
        let plan = self.planner.plan(grid, extents, candidates, &self.values, scorer, is_over)?;
        Ok(plan.map(|Plan { first, measure, depth, width }| Choice { index: first, value: measure, depth, width }))
    }
}

impl Scorer {
    fn new(engine: Engine, model: &Model) -> Option<Self> {
        let judge = match model.card().encoding {
            Encoding::Published(walls) => {
                Judge::Published(Box::new(PublishedScorer::new(engine, walls, model.weights())?))
            }
            Encoding::Moves => Judge::Moves { network: MovesScorer::new(engine, model.weights())?, moves: Vec::new() },
        };
        Some(Self { fingerprint: model.fingerprint(), scope: model.card().scope, judge })
    }

    /// Writes the values of the candidates that the model looks at, all finite, into `values`.
    fn values(
        &mut self,
        grid: &Grid,
        extent: Extent,
        candidates: &[Candidate],
        values: &mut Vec<f32>,
    ) -> Result<(), NotFinite> {
        let candidates = self.scope.considered(candidates);
        let computed = match &mut self.judge {
            Judge::Published(network) => network.values(grid, extent, candidates, values),
            Judge::Moves { network, moves } => {
                describe(grid, extent, candidates, moves);
                network.values(moves, values)
            }
        };
        all_finite(computed, values)
    }
}

impl lookahead::Value for Scorer {
    type Error = NotFinite;

    fn values(&mut self, moves: &[Features], values: &mut Vec<f32>) -> Result<(), NotFinite> {
        let computed = match &self.judge {
            Judge::Moves { network, .. } => network.values(moves, values),
            Judge::Published(_) => None,
        };
        all_finite(computed, values)
    }
}

/// Whether the values were computed and all are finite.
fn all_finite(computed: Option<()>, values: &[f32]) -> Result<(), NotFinite> {
    computed.ok_or(NotFinite { candidate: 0 })?;
    let bad = values.iter().position(|value| !value.is_finite());
    bad.map_or(Ok(()), |candidate| Err(NotFinite { candidate }))
}

/// Writes the features of every candidate; candidates of one container stand together.
pub(crate) fn describe(grid: &Grid, extent: Extent, candidates: &[Candidate], moves: &mut Vec<Features>) {
    moves.clear();
    let open = grid.open_slots().count() as u16;
    let rank = |slot: u16| (0..).zip(grid.open_slots()).find(|&(_, s)| s == slot).map_or(open, |(rank, _)| rank);
    let mut seen: Option<(u16, ContainerView)> = None;
    for candidate in candidates {
        let placement = candidate.placement;
        let surface = grid.slots()[usize::from(placement.slot)].surface();
        let view = match seen {
            Some((slot, view)) if slot == placement.slot => view,
            _ => ContainerView::of(surface, rank(placement.slot), open),
        };
        seen = Some((placement.slot, view));
        moves.push(features(surface, &view, extent.turned(placement.yaw), placement));
    }
}

/// The highest value, the earlier of equal ones.
pub(crate) fn best(values: &[f32]) -> Result<Option<Choice>, NotFinite> {
    if let Some(candidate) = values.iter().position(|value| !value.is_finite()) {
        return Err(NotFinite { candidate });
    }
    let better = |best: Option<Choice>, (index, &value): (usize, &f32)| {
        let kept = best.filter(|choice| choice.value >= value);
        kept.or(Some(Choice::greedy(index, value)))
    };
    Ok(values.iter().enumerate().fold(None, better))
}

impl Scope {
    /// The candidates that a policy of this order looks at: a leading part of all.
    #[must_use]
    pub fn considered(self, candidates: &[Candidate]) -> &[Candidate] {
        match (self, candidates.first()) {
            (Self::FirstContainer, Some(first)) => {
                let same = |candidate: &Candidate| candidate.placement.slot == first.placement.slot;
                &candidates[..candidates.iter().take_while(|candidate| same(candidate)).count()]
            }
            (Self::AllContainers, _) | (_, None) => candidates,
        }
    }
}

impl PolicyKind {
    /// The names of all policies, as [`FromStr`] reads them.
    pub const NAMES: [&str; 4] = ["walle", "packman-published", "packman", "packman-lookahead"];

    /// The model that ships for this kind; nothing if it needs none.
    ///
    /// # Errors
    /// [`ModelError`] if it is damaged, which a test of this crate rules out.
    pub fn built_in_model(self) -> Result<Option<Model>, ModelError> {
        match self {
            Self::Walle => Ok(None),
            Self::PackmanPublished => Model::built_in_published().map(Some),
            Self::Packman | Self::PackmanLookahead => Model::built_in().map(Some),
        }
    }
}

impl fmt::Display for PolicyKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Walle => "walle",
            Self::PackmanPublished => "packman-published",
            Self::Packman => "packman",
            Self::PackmanLookahead => "packman-lookahead",
        })
    }
}

impl FromStr for PolicyKind {
    type Err = PolicyKindError;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        match name {
            "walle" => Ok(Self::Walle),
            "packman-published" => Ok(Self::PackmanPublished),
            "packman" => Ok(Self::Packman),
            "packman-lookahead" => Ok(Self::PackmanLookahead),
            _ => Err(PolicyKindError(name.to_owned())),
        }
    }
}

#[cfg(test)]
mod tests {
    use packing::{BoxSpec, ContainerSize, Placement, WalleWeights, Yaw, corner_candidates};

    use super::*;

    fn decision() -> (Grid, Extent, Vec<Candidate>) {
        let mut grid = Grid::new(ContainerSize::PAPER, 16).unwrap();
        let spec = BoxSpec::new(0, [200, 300, 200]).unwrap();
        for slot in 0..3 {
            grid.place(&spec, Placement { slot, yaw: Yaw::Deg0, i: 0, j: 0, base: 0 }).unwrap();
        }
        let (extent, mut candidates) = (Extent { length: 10, breadth: 15, height: 10 }, Vec::new());
        corner_candidates(&grid, extent, &WalleWeights::PAPER, &mut candidates);
        (grid, extent, candidates)
    }

    #[test]
    fn every_policy_chooses_the_same_on_every_engine_and_every_time() {
        let (grid, extent, candidates) = decision();
        let upcoming = [Extent { length: 12, breadth: 8, height: 20 }, Extent { length: 5, breadth: 5, height: 5 }];
        for kind in PolicyKind::NAMES.map(|name| name.parse::<PolicyKind>().unwrap()) {
            let model = kind.built_in_model().unwrap();
            let mut chosen = Vec::new();
            for engine in Engine::NAMES.map(|name| name.parse::<Engine>().unwrap()) {
                let mut policy = Policy::new(kind, engine, model.as_ref()).unwrap();
                for _ in 0..2 {
                    chosen.push(policy.choose(&grid, extent, &upcoming, &candidates).unwrap().unwrap().index);
                }
                assert_eq!(policy.choose(&grid, extent, &upcoming, &[]), Ok(None), "{kind} of nothing");
                let fingerprint = model.as_ref().map_or(0, Model::fingerprint);
                assert_eq!((policy.kind(), policy.engine(), policy.fingerprint()), (kind, engine, fingerprint));
            }
            assert!(chosen.iter().all(|&index| index == chosen[0]), "{kind}: {chosen:?}");
            assert!(chosen[0] < candidates.len());
        }
    }

    #[test]
    fn the_published_order_looks_at_the_first_container_only() {
        let (_, _, candidates) = decision();
        let considered = Scope::FirstContainer.considered(&candidates);
        assert!(considered.len() < candidates.len() && considered.iter().all(|c| c.placement.slot == 0));
        assert_eq!(Scope::AllContainers.considered(&candidates).len(), candidates.len());
        assert!(Scope::FirstContainer.considered(&[]).is_empty());
    }

    #[test]
    fn the_earlier_of_equal_values_is_chosen_and_nonsense_is_refused() {
        assert_eq!(best(&[1.0, 3.0, 3.0, 2.0]), Ok(Some(Choice::greedy(1, 3.0))));
        assert_eq!(best(&[0.0, -0.0]), Ok(Some(Choice::greedy(0, 0.0))));
        assert_eq!(best(&[]), Ok(None));
        assert_eq!(best(&[1.0, f32::NAN, 3.0]), Err(NotFinite { candidate: 1 }));
        assert_eq!(best(&[f32::INFINITY]), Err(NotFinite { candidate: 0 }));
    }

    #[test]
    fn a_network_needs_a_model() {
        let error = Policy::new(PolicyKind::Packman, Engine::BurnFlex, None).unwrap_err();
        assert_eq!(error, PolicyError::NoModel(PolicyKind::Packman));
        assert!(Policy::new(PolicyKind::Walle, Engine::BurnFlex, None).is_ok());
        assert!("packmann".parse::<PolicyKind>().unwrap_err().to_string().contains("walle, packman-published"));
    }
}
