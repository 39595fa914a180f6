//! What computes the network: one of burn's backends, chosen at run time.

use std::fmt;
use std::str::FromStr;

use burn::tensor::Device;

/// A backend of burn. Both serve in the calling thread: neither is built with a thread pool, whose wakeups on a
/// busy machine cost more in the tail than a second core gains.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Engine {
    /// burn's own CPU backend, the faster one here.
    #[default]
    BurnFlex,
    /// The older CPU backend, on the ndarray crate.
    BurnNdarray,
}

/// A name that no engine has.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no engine {0:?}: use one of {names}", names = Engine::NAMES.join(", "))]
pub struct EngineError(pub String);

impl Engine {
    /// The names of all engines, as [`FromStr`] reads them.
    pub const NAMES: [&str; 2] = ["burn-flex", "burn-ndarray"];

    /// The device on which tensors of this engine live.
    pub(crate) fn device(self) -> Device {
        match self {
            Self::BurnFlex => Device::flex(),
            #[expect(deprecated, reason = "kept as the second engine, to compare with; upstream recommends flex")]
            Self::BurnNdarray => Device::ndarray(),
        }
    }
}

impl fmt::Display for Engine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::BurnFlex => "burn-flex",
            Self::BurnNdarray => "burn-ndarray",
        })
    }
}

impl FromStr for Engine {
    type Err = EngineError;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        match name {
            "burn-flex" => Ok(Self::BurnFlex),
            "burn-ndarray" => Ok(Self::BurnNdarray),
            _ => Err(EngineError(name.to_owned())),
        }
    }
}
