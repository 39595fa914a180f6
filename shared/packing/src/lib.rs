//! Online 3D bin packing, pure: no clock, no files, no ambient randomness, no serialisation, no IPC.
//!
//! The problem and its baselines are those of Verma et al., *A Generalized Reinforcement Learning
//! Algorithm for Online 3D Bin-Packing* (2020), called "the paper" in these docs.
//!
//! # Words
//!
//! - **box** ([`BoxSpec`]): a cuboid on the belt, with identity and millimetre dimensions.
//! - **extent** ([`Extent`]): a box, with the clearance that the [`Rules`] ask for, in whole grid cells, at one yaw.
//! - **container** ([`ContainerSize`]): what is filled. It stands in a **slot** of the [`Grid`].
//! - **surface** ([`Surface`]): the heights of one container, seen from above.
//! - **grid** ([`Grid`]): all containers that stand in the cell, and how often they changed (its revision).
//! - **placement** ([`Placement`]): where and how a box stands. It is **feasible** if [`Surface::rest`] accepts it.
//! - **candidate** ([`Candidate`]): a feasible placement in a corner of the container or of the loaded structure.
//! - **episode** ([`Episode`]): a stream of boxes that is packed from empty containers.
//!
//! # Frame and symbols
//!
//! `i` counts grid cells along the container's length `L`, `j` along its breadth `B`, heights count along `H`;
//! the origin is the container's top-left corner in the paper's figure 3. Heights are whole cells: partial
//! dimensions are rounded up (paper, "Robot-implementability").

mod candidates;
mod draw;
mod environment;
mod episode;
mod finder;
mod geometry;
mod grid;
mod harmonic;
mod heuristics;
mod rules;
mod support;
mod surface;
mod walle;

pub use candidates::{Candidate, Place, corner_candidates, corner_places};
pub use draw::Draw;
pub use environment::{ClosePolicy, Environment, Outcome, PlacedBox, Step};
pub use episode::{CutRule, Episode, Order, Recipe, RecipeError, Split};
pub use finder::CandidateFinder;
pub use geometry::{
    BOX_SIDE_MM_MAX, BoxError, BoxSpec, ContainerSize, Extent, GRID_CELLS_MAX, Placement, SIDE_CELLS_MAX, SLOTS_MAX,
    SizeError, Yaw,
};
pub use grid::{Grid, PlaceError, Slot};
pub use harmonic::{HarmonicColumns, random_place};
pub use heuristics::{ContainerOrder, Heuristic, HeuristicError};
pub use rules::Rules;
pub use support::Support;
pub use surface::{Corner, Infeasible, Surface};
pub use walle::{WalleWeights, WeightsError};
