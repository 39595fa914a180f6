//! What decides: a kind of policy, an engine and a model, ready to be asked.

use std::fmt;
use std::str::FromStr;

use burn::tensor::Device;
use packing::{Candidate, Extent, Grid, Heuristic};

use crate::encoding::{Batch, Encoder};
use crate::engine::Engine;
use crate::model::{ContainerOrder, Model};
use crate::network::Network;

/// How a policy comes to its choice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PolicyKind {
    /// WallE's score, without a network: the highest in the first container that has a candidate.
    Walle,
    /// The highest value by the network of a model.
    Packman,
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
}

/// A model on its engine, with buffers.
#[derive(Debug)]
struct Scorer {
    fingerprint: u64,
    container_order: ContainerOrder,
    network: Network,
    device: Device,
    encoder: Encoder,
    batch: Batch,
}

/// The chosen candidate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice {
    /// Its index among the candidates of the decision.
    pub index: usize,
    /// What the policy thinks of it; comparable only within one decision.
    pub value: f32,
}

/// Why a policy cannot be made.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PolicyError {
    /// The kind has a network and no model was given.
    #[error("the policy {0} needs a model: give a model file, or use walle")]
    NoModel(PolicyKind),
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
        let scorer = match kind {
            PolicyKind::Walle => None,
            PolicyKind::Packman => {
                Some(model.and_then(|model| Scorer::new(engine, model)).ok_or(PolicyError::NoModel(kind))?)
            }
        };
        Ok(Self { kind, engine, scorer })
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
        _upcoming: &[Extent],
        candidates: &[Candidate],
    ) -> Result<Option<Choice>, NotFinite> {
        match &mut self.scorer {
            None => {
                Ok(Heuristic::walle_choice(candidates).map(|index| Choice { index, value: candidates[index].walle }))
            }
            Some(scorer) => scorer.choose(grid, extent, candidates),
        }
    }
}

impl Scorer {
    fn new(engine: Engine, model: &Model) -> Option<Self> {
        let device = engine.device();
        Some(Self {
            fingerprint: model.fingerprint(),
            container_order: model.card().container_order,
            network: Network::new(model.weights(), &device)?,
            device,
            encoder: Encoder::new(model.card().encoding),
            batch: Batch::default(),
        })
    }

    fn choose(&mut self, grid: &Grid, extent: Extent, candidates: &[Candidate]) -> Result<Option<Choice>, NotFinite> {
        let candidates = self.container_order.considered(candidates);
        self.encoder.encode(grid, extent, candidates, &mut self.batch);
        let values = self.network.values(&self.batch, &self.device).ok_or(NotFinite { candidate: 0 })?;
        best(&values)
    }
}

/// The highest value, the earlier of equal ones.
pub(crate) fn best(values: &[f32]) -> Result<Option<Choice>, NotFinite> {
    if let Some(candidate) = values.iter().position(|value| !value.is_finite()) {
        return Err(NotFinite { candidate });
    }
    let better = |best: Option<Choice>, (index, &value): (usize, &f32)| match best {
        Some(choice) if choice.value >= value => best,
        _ => Some(Choice { index, value }),
    };
    Ok(values.iter().enumerate().fold(None, better))
}

impl ContainerOrder {
    /// The candidates that a policy of this order looks at: a leading part of all.
    #[must_use]
    pub fn considered(self, candidates: &[Candidate]) -> &[Candidate] {
        match (self, candidates.first()) {
            (Self::FirstThatFits, Some(first)) => {
                let same = |candidate: &Candidate| candidate.placement.slot == first.placement.slot;
                &candidates[..candidates.iter().take_while(|candidate| same(candidate)).count()]
            }
            (Self::All, _) | (_, None) => candidates,
        }
    }
}

impl PolicyKind {
    /// The names of all policies, as [`FromStr`] reads them.
    pub const NAMES: [&str; 2] = ["walle", "packman"];
}

impl fmt::Display for PolicyKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Walle => "walle",
            Self::Packman => "packman",
        })
    }
}

impl FromStr for PolicyKind {
    type Err = PolicyKindError;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        match name {
            "walle" => Ok(Self::Walle),
            "packman" => Ok(Self::Packman),
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
        let model = Model::built_in().unwrap();
        for kind in PolicyKind::NAMES.map(|name| name.parse::<PolicyKind>().unwrap()) {
            let mut chosen = Vec::new();
            for engine in Engine::NAMES.map(|name| name.parse::<Engine>().unwrap()) {
                let mut policy = Policy::new(kind, engine, Some(&model)).unwrap();
                for _ in 0..2 {
                    chosen.push(policy.choose(&grid, extent, &[], &candidates).unwrap().unwrap().index);
                }
                assert_eq!(policy.choose(&grid, extent, &[], &[]), Ok(None), "{kind} of nothing");
                let fingerprint = if kind == PolicyKind::Walle { 0 } else { model.fingerprint() };
                assert_eq!((policy.kind(), policy.engine(), policy.fingerprint()), (kind, engine, fingerprint));
            }
            assert!(chosen.iter().all(|&index| index == chosen[0]), "{kind}: {chosen:?}");
            assert!(chosen[0] < candidates.len());
        }
    }

    #[test]
    fn the_published_order_looks_at_the_first_container_only() {
        let (_, _, candidates) = decision();
        let considered = ContainerOrder::FirstThatFits.considered(&candidates);
        assert!(considered.len() < candidates.len() && considered.iter().all(|c| c.placement.slot == 0));
        assert_eq!(ContainerOrder::All.considered(&candidates).len(), candidates.len());
        assert!(ContainerOrder::FirstThatFits.considered(&[]).is_empty());
    }

    #[test]
    fn the_earlier_of_equal_values_is_chosen_and_nonsense_is_refused() {
        assert_eq!(best(&[1.0, 3.0, 3.0, 2.0]), Ok(Some(Choice { index: 1, value: 3.0 })));
        assert_eq!(best(&[0.0, -0.0]), Ok(Some(Choice { index: 0, value: 0.0 })));
        assert_eq!(best(&[]), Ok(None));
        assert_eq!(best(&[1.0, f32::NAN, 3.0]), Err(NotFinite { candidate: 1 }));
        assert_eq!(best(&[f32::INFINITY]), Err(NotFinite { candidate: 0 }));
    }

    #[test]
    fn a_network_needs_a_model() {
        let error = Policy::new(PolicyKind::Packman, Engine::BurnFlex, None).unwrap_err();
        assert_eq!(error, PolicyError::NoModel(PolicyKind::Packman));
        assert!(Policy::new(PolicyKind::Walle, Engine::BurnFlex, None).is_ok());
        assert!("packmann".parse::<PolicyKind>().unwrap_err().to_string().contains("walle, packman"));
    }
}
