//! `packlab` as a person types it.
#![expect(clippy::unwrap_used, reason = "a test that cannot run its program has failed")]

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn packlab(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_packlab")).args(args).output().unwrap()
}

#[track_caller]
fn succeeds(args: &[&str]) -> String {
    let output = packlab(args);
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

#[track_caller]
fn refuses(args: &[&str], says: &[&str]) {
    let output = packlab(args);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success(), "{args:?} was accepted");
    for words in says {
        assert!(said.contains(words), "{args:?} says:\n{said}\nand not: {words}");
    }
    assert!(!said.contains("panicked"), "{said}");
}

/// The figures of a run without its times.
fn figures(dir: &Path, args: &[&str]) -> Value {
    let file = dir.join("figures.json");
    succeeds(&[args, &["--json", file.to_str().unwrap()]].concat());
    let mut figures: Value = serde_json::from_slice(&fs::read(file).unwrap()).unwrap();
    for set in figures["sets"].as_array_mut().unwrap() {
        for method in set["methods"].as_array_mut().unwrap() {
            for time in ["us_p50", "us_p99"] {
                assert!(method[time].as_f64().unwrap() >= 0.0);
                method[time] = Value::Null;
            }
        }
    }
    figures
}

#[test]
fn the_same_seed_gives_the_same_figures_on_any_number_of_threads() {
    let dir = tempfile::tempdir().unwrap();
    let args = ["evaluate", "--policy", "first-fit,walle-corners,random,packman", "--episodes", "3"];
    let one = figures(dir.path(), &[&args[..], &["--threads", "1"]].concat());
    let two = figures(dir.path(), &[&args[..], &["--threads", "2"]].concat());
    assert_eq!(one, two);
    let other = figures(dir.path(), &[&args[..], &["--seed", "2"]].concat());
    assert_ne!(one, other);
    let methods = one["sets"][0]["methods"].as_array().unwrap();
    let c = |name: &str| {
        let method = methods.iter().find(|method| method["name"] == name).unwrap();
        method["c_mean"].as_f64().unwrap()
    };
    assert!(c("packman") < c("first-fit"));
}

#[test]
fn generated_files_pack_like_the_set_they_come_from() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("three.json");
    let path = file.to_str().unwrap();
    succeeds(&["generate", "--data", "three", "--episodes", "4", "--seed", "1", "--out", path]);
    let args = ["evaluate", "--policy", "first-fit,walle", "--open", "6", "--episodes", "4", "--data"];
    let named = figures(dir.path(), &[&args[..], &["three"]].concat());
    let from_file = figures(dir.path(), &[&args[..], &[path]].concat());
    assert_eq!(named["sets"][0]["methods"], from_file["sets"][0]["methods"]);
}

#[test]
fn a_bad_box_is_named_and_may_be_skipped() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("monday.csv");
    fs::write(&file, "episode,l,b,h\n0,100,100,100\n0,100,-1,100\n0,100,100,100\n").unwrap();
    let path = file.to_str().unwrap();
    let args = ["evaluate", "--policy", "first-fit", "--data", path];
    refuses(&args, &["monday.csv", "episode 0", "box 1"]);
    let said = packlab(&[&args[..], &["--skip-bad"]].concat());
    assert!(said.status.success());
    let text = String::from_utf8_lossy(&said.stdout) + String::from_utf8_lossy(&said.stderr);
    assert!(text.contains("1 ") && text.contains("skipped"), "{text}");
}

#[test]
fn what_does_not_exist_is_named() {
    refuses(&["evaluate", "--policy", "best-fit"], &["best-fit", "walle-corners", "packman-lookahead"]);
    refuses(&["evaluate", "--data", "standrad"], &["standrad", "small-boxes"]);
    refuses(&["evaluate", "--policy", "packman:/nonexistent.safetensors"], &["/nonexistent.safetensors"]);
    refuses(&["evaluate", "--walle-weights", "1,2,3,4,-5"], &["weights"]);
    refuses(&["generate", "--data", "standard", "--out", "boxes.txt"], &[".json"]);
    refuses(&["train", "--recipe", "secret", "--out", "x.safetensors"], &["secret"]);
}
