//! Streams that cannot be packed.
#![expect(clippy::unwrap_used, reason = "a test that cannot run its program has failed")]

use std::process::Command;

/// What the service says when it refuses to start with these arguments.
#[track_caller]
fn refused(args: &[&str]) -> String {
    let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/../../deploy/packcell.toml");
    let program = env!("CARGO_BIN_EXE_perception");
    let output = Command::new(program).args(["--config", shipped]).args(args).output().unwrap();
    assert!(!output.status.success(), "{args:?} was accepted");
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn streams_that_cannot_be_packed_are_named() {
    let said = refused(&["--set", "perception.stream=/nonexistent.csv"]);
    assert!(said.contains("/nonexistent.csv"), "{said}");
    let said = refused(&["--set", "container.cell_mm=50"]);
    assert!(said.contains("[container]"), "{said}");
}
