//! Policies, engines and instances that do not exist.
#![expect(clippy::unwrap_used, reason = "a test that cannot run its program has failed")]

use std::process::Command;

/// What the service says when it refuses to start with these arguments.
#[track_caller]
fn refused(args: &[&str]) -> String {
    let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/../../deploy/packcell.toml");
    let program = env!("CARGO_BIN_EXE_scorer");
    let output = Command::new(program).args(["--config", shipped]).args(args).output().unwrap();
    assert!(!output.status.success(), "{args:?} was accepted");
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn policies_engines_and_instances_that_do_not_exist_are_named() {
    let said = refused(&["--set", "scorer.policy=best"]);
    assert!(said.contains("scorer.policy") && said.contains("walle"), "{said}");
    let said = refused(&["--set", "scorer.engine=abacus"]);
    assert!(said.contains("scorer.engine") && said.contains("burn-flex"), "{said}");
    let said = refused(&["--instance", "z"]);
    assert!(said.contains("a letter from a to h"), "{said}");
}
