//! The cell as real processes, and the rules of the tree.
//!
//! Every cell has a bus of its own, so the tests run side by side and beside a living cell.
#![expect(clippy::unwrap_used, reason = "a test that cannot run its programs has failed")]

mod coming_back;
mod faults;
mod hardening;
mod harness;
mod hostile;
mod machine;
mod pipeline;
mod refusals;
mod soak;
mod stopping;
mod systemd;
mod tidy;
