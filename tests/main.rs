//! The cell as real processes, and the rules of the tree.
//!
//! Every cell has a bus of its own, so the tests run side by side and beside a living cell.
#![expect(missing_docs, reason = "a test's name says what it shows")]

mod harness;
mod pipeline;
mod refusals;
mod stopping;
mod tidy;
