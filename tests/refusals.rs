//! Bad input: one clear message, a failure, and nothing left running or lying about.

use std::fs;
use std::path::Path;

use crate::harness::{Demo, root};

#[track_caller]
fn refused(args: &[&str], says: &[&str]) {
    let demo = Demo::run(args);
    let said = demo.stderr();
    assert!(!demo.output.status.success(), "{args:?} was accepted");
    assert!(demo.json.is_none(), "{args:?}");
    for words in says {
        assert!(said.contains(words), "{args:?} says:\n{said}\nand not: {words}");
    }
    assert!(!said.contains("panicked"), "{said}");
    demo.assert_nothing_is_left();
}

#[track_caller]
fn refused_file(name: &str, content: &[u8], flag: &str, says: &[&str]) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join(name);
    fs::write(&path, content).unwrap();
    refused(&[flag, path.to_str().unwrap()], says);
}

#[test]
fn streams_that_are_none() {
    refused(&["--data", "/nonexistent/boxes.json"], &["/nonexistent/boxes.json", "No such file"]);
    refused(&["--data", "standrad"], &["no data set \"standrad\"", "small-boxes"]);
    refused_file("broken.json", b"{\"meta\": ", "--data", &["broken.json"]);
    refused_file("boxes.txt", b"1,2,3", "--data", &["boxes.txt", ".json"]);
    let csv = |line: &str| format!("episode,l,b,h\n{line}\n").into_bytes();
    refused_file("zero.csv", &csv("0,100,0,100"), "--data", &["zero.csv", "episode 0", "box 0"]);
    refused_file("negative.csv", &csv("0,100,100,-5"), "--data", &["negative.csv", "box 0"]);
    refused_file("absurd.csv", &csv("0,1e12,100,100"), "--data", &["absurd.csv", "box 0"]);
    refused_file("large.csv", &csv("0,100,100,100\n0,900,100,100"), "--data", &["large.csv", "box 1"]);
}

#[test]
fn models_that_are_none() {
    let model = fs::read(root().join("deploy/models/packman.safetensors")).unwrap();
    refused(&["--model", "/nonexistent/model.safetensors"], &["/nonexistent/model.safetensors", "scorer a ended"]);
    refused_file("short.safetensors", &model[..model.len() / 2], "--model", &["short.safetensors", "scorer a ended"]);
    refused_file("foreign.safetensors", b"not a model at all", "--model", &["foreign.safetensors", "scorer a ended"]);
    let mut flipped = model.clone();
    flipped[model.len() - 1000] ^= 1;
    refused_file("flipped.safetensors", &flipped, "--model", &["flipped.safetensors", "scorer a ended"]);
}

#[test]
fn settings_that_are_none() {
    refused_file("cell.toml", b"[commander]\nhard_dedline_ms = 3\n", "--config", &["cell.toml", "hard_dedline_ms"]);
    refused(&["--set", "commander.hard_deadline_ms=never"], &["commander.hard_deadline_ms=never"]);
    refused(&["--open", "0"], &["a grid has 1 to 64 slots"]);
    refused(&["--open", "40"], &["a grid has 1 to 64 slots", "65536"]);
    refused(&["--policy", "best"], &["no policy \"best\"", "walle", "scorer a ended"]);
    refused(&["--set", "scorer.engine=abacus"], &["abacus", "scorer a ended"]);
}

#[test]
fn the_shipped_configuration_is_accepted() {
    let shipped = root().join("deploy/packcell.toml");
    assert!(Path::new(&shipped).exists());
    let demo = Demo::run(&["--config", shipped.to_str().unwrap(), "--pace", "0", "--policy", "walle"]);
    assert_eq!(demo.number("/placed"), demo.number("/boxes"));
}
