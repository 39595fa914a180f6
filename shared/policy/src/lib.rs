//! From grids to choices: the network's input, the network, model files, and the policies that use them.
//!
//! This is the only crate that names burn. The network and its input are those of Verma et al., *A Generalized
//! Reinforcement Learning Algorithm for Online 3D Bin-Packing* (2020), called "the paper" in these docs.
//!
//! - **encoding** ([`Encoding`]): a numbered version of what the network reads of a grid and a candidate.
//! - **weights** ([`Weights`]): a network's numbers; **model** ([`Model`]): weights and their origin, as a file.
//! - **engine** ([`Engine`]): what computes the network.
//! - **policy** ([`Policy`]): chooses among the candidates of a box.

mod checkpoint;
mod dqn;
mod encoding;
mod engine;
mod evolution;
mod fast;
mod fused;
mod lookahead;
mod model;
pub mod moves;
mod network;
mod policy;
mod pool;
mod weights;

pub use checkpoint::{CheckpointError, CheckpointFault, load_checkpoint, save_checkpoint};
pub use dqn::{Dqn, DqnConfig, DqnError, Trained};
pub use encoding::{Batch, Encoder, Encoding, Walls, X_LEN, Y_LEN, Z_LEN};
pub use engine::{Engine, EngineError};
pub use evolution::Evolution;
pub use fast::{Packed, pack_fast, pack_planned};
pub use lookahead::UPCOMING_MAX;
pub use model::{Card, FORMAT, MODEL_BYTES_MAX, Model, ModelError, ModelFault, Scope, Training, Validation};
pub use policy::{Choice, NotFinite, Policy, PolicyError, PolicyKind, PolicyKindError};
pub use pool::{FIELD_COLUMNS, FIELD_ROWS, FIELDS};
pub use weights::{Architecture, HIDDEN_UNITS, Layer, LayerShape, Weights};
