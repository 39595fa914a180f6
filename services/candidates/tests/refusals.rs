//! A bus that cannot be used.
#![expect(clippy::unwrap_used, reason = "a test that cannot run its program has failed")]

use std::process::Command;

/// What the service says when it refuses to start with these arguments.
#[track_caller]
fn refused(args: &[&str]) -> String {
    let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/../../deploy/packcell.toml");
    let program = env!("CARGO_BIN_EXE_candidates");
    let output = Command::new(program).args(["--config", shipped]).args(args).output().unwrap();
    assert!(!output.status.success(), "{args:?} was accepted");
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn a_bus_that_cannot_be_used_is_named() {
    let said = refused(&["--set", "bus.root_dir=/proc/packcell"]);
    assert!(said.contains("/proc/packcell") && said.contains("bus.root_dir"), "{said}");
    let said = refused(&["--set", "bus.prefix=a/b"]);
    assert!(said.contains("bus.prefix"), "{said}");
}
