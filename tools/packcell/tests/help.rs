//! What a person sees who asks for help.
#![expect(clippy::unwrap_used, reason = "a test that cannot run its program has failed")]

use std::process::Command;

fn help(args: &[&str]) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_packcell")).args(args).output().unwrap();
    assert!(output.status.success());
    String::from_utf8_lossy(&output.stdout).into_owned()
}

#[test]
fn every_command_and_data_set_is_listed() {
    let text = help(&["--help"]);
    for command in ["demo", "up", "status"] {
        assert!(text.contains(command), "{text}");
    }
    let text = help(&["demo", "--help"]);
    for named in &dataset::NAMED {
        assert!(text.contains(named.name), "{} is not listed in:\n{text}", named.name);
    }
}
