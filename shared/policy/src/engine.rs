//! What computes a network, chosen at run time.

use std::fmt;
use std::str::FromStr;

use burn::tensor::Device;
use packing::{Candidate, Extent, Grid};

use crate::encoding::{Batch, Encoder, Walls};
use crate::fused::Fused;
use crate::moves::Features;
use crate::network::{MovesNetwork, Network};
use crate::weights::{Architecture, Weights};

/// What computes a network. All serve in the calling thread: a thread pool's wakeups cost more in the tail, on a busy
/// machine, than a second core gains.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Engine {
    /// Code of this crate, made for the candidates of one box: the fastest, and the same bits on every machine.
    #[default]
    Fused,
    /// burn's own CPU backend: the reference.
    BurnFlex,
    /// burn's older CPU backend, on the ndarray crate.
    BurnNdarray,
}

/// A name that no engine has.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no engine {0:?}: use one of {names}", names = Engine::NAMES.join(", "))]
pub struct EngineError(pub String);

impl Engine {
    /// The names of all engines, as [`FromStr`] reads them.
    pub const NAMES: [&str; 3] = ["fused", "burn-flex", "burn-ndarray"];

    /// Where burn's tensors live, if it is one of burn's.
    pub(crate) fn device(self) -> Option<Device> {
        match self {
            Self::Fused => None,
            Self::BurnFlex => Some(Device::flex()),
            #[expect(deprecated, reason = "kept as another engine, to compare with; upstream recommends flex")]
            Self::BurnNdarray => Some(Device::ndarray()),
        }
    }
}

/// The published network on its engine, with its buffers.
#[derive(Debug)]
pub(crate) struct PublishedScorer {
    encoder: Encoder,
    network: Published,
}

#[derive(Debug)]
enum Published {
    Fused(Box<Fused>),
    Burn { network: Box<Network>, device: Device, batch: Batch },
}

impl PublishedScorer {
    /// A scorer with these weights, or nothing if they are another architecture's.
    pub(crate) fn new(engine: Engine, walls: Walls, weights: &Weights) -> Option<Self> {
        let network = match engine.device() {
            None => Published::Fused(Box::new(Fused::new(weights)?)),
            Some(device) => {
                let network = Box::new(Network::new(weights, &device)?);
                Published::Burn { network, device, batch: Batch::default() }
            }
        };
        Some(Self { encoder: Encoder::new(walls), network })
    }

    /// Writes the value of every candidate into `values`, which is cleared first; nothing if the device failed.
    pub(crate) fn values(
        &mut self,
        grid: &Grid,
        extent: Extent,
        candidates: &[Candidate],
        values: &mut Vec<f32>,
    ) -> Option<()> {
        values.clear();
        match &mut self.network {
            Published::Fused(fused) => {
                values.extend_from_slice(fused.values(self.encoder.changes(grid, extent, candidates)));
            }
            Published::Burn { network, device, batch } => {
                self.encoder.encode(grid, extent, candidates, batch);
                values.append(&mut network.values(batch, device)?);
            }
        }
        Some(())
    }
}

/// The moves' network on its engine.
#[derive(Debug)]
pub(crate) enum MovesScorer {
    Fused(Weights),
    Burn { network: Box<MovesNetwork>, device: Device },
}

impl MovesScorer {
    /// A scorer with these weights, or nothing if they are another architecture's.
    pub(crate) fn new(engine: Engine, weights: &Weights) -> Option<Self> {
        if weights.architecture() != Architecture::Moves {
            return None;
        }
        Some(match engine.device() {
            None => Self::Fused(weights.clone()),
            Some(device) => Self::Burn { network: Box::new(MovesNetwork::new(weights, &device)?), device },
        })
    }

    /// Writes the value of every move into `values`, which is cleared first; nothing if the device failed.
    pub(crate) fn values(&self, moves: &[Features], values: &mut Vec<f32>) -> Option<()> {
        values.clear();
        match self {
            Self::Fused(weights) => values.extend(moves.iter().map(|features| weights.value_of_move(features))),
            Self::Burn { network, device } => values.append(&mut network.values(moves, device)?),
        }
        Some(())
    }
}

impl fmt::Display for Engine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Fused => "fused",
            Self::BurnFlex => "burn-flex",
            Self::BurnNdarray => "burn-ndarray",
        })
    }
}

impl FromStr for Engine {
    type Err = EngineError;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        match name {
            "fused" => Ok(Self::Fused),
            "burn-flex" => Ok(Self::BurnFlex),
            "burn-ndarray" => Ok(Self::BurnNdarray),
            _ => Err(EngineError(name.to_owned())),
        }
    }
}
