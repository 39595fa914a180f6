//! Deadlines that make no sense.
#![expect(clippy::unwrap_used, reason = "a test that cannot run its program has failed")]

use std::process::Command;

/// What the service says when it refuses to start with these arguments.
#[track_caller]
fn refused(args: &[&str]) -> String {
    let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/../../deploy/packcell.toml");
    let program = env!("CARGO_BIN_EXE_commander");
    let output = Command::new(program).args(["--config", shipped]).args(args).output().unwrap();
    assert!(!output.status.success(), "{args:?} was accepted");
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn deadlines_that_make_no_sense_are_named() {
    let said = refused(&["--set", "commander.soft_deadline_ms=30"]);
    assert!(said.contains("commander.soft_deadline_ms = 30") && said.contains("not be later"), "{said}");
    let said = refused(&["--set", "commander.close_policy=sometimes"]);
    assert!(said.contains("never, oldest, fullest"), "{said}");
}
