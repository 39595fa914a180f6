//! Boxes as they really stand, how a camera sees them, and what a cell makes of that.
//!
//! Paper, "Conclusion": parcels do not land where they were told to, so they collide unless 1 to 2 cm are left between
//! them, and the gap can go only when the belief is corrected by measurement. Here is the world that does so, pure: it
//! knows no time, and its errors are fixed by a seed and by what they befall, so that it goes on after a restart as if
//! nothing had been.
//!
//! # Words
//!
//! - **truth** ([`Truth`]): every box with its real size and pose in millimetres. Nothing that decides may see it.
//!   It is of one of two kinds: boxes *stand* where they were set down ([`Truth::new`]), or are rigid bodies that slide,
//!   tilt and fall until they *lie* still ([`Truth::rigid`]).
//! - **look** ([`Look`]): the height maps ("frames") that a camera takes of one container, one after the other.
//! - **fusion** ([`Fusion`]): command and look into the heights that are believed.
//!
//! Frame: as in [`packing`], `x` along `i` and `y` along `j` from the container's corner, `z` up, in millimetres.

mod camera;
mod errors;
mod fusion;
mod rigid;
mod truth;

pub use camera::{Camera, Fault, Look, Optics};
pub use fusion::{Blind, Commanded, Fused, Fusion, Irreconcilable};
pub use rigid::{Fate, Lying, RigidContainer, Settled};
pub use truth::{Brought, Imperfections, Landing, Matter, Standing, Truth};
