//! `packlab` as a person types it.
#![expect(clippy::unwrap_used, reason = "a test that cannot run its program has failed")]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

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

/// A training that takes a second or two; a later flag overrides an earlier one.
fn training<'a>(recipe: &'a str, episodes: &'a str, out: &'a Path) -> Vec<&'a str> {
    let out = out.to_str().unwrap();
    let flags = ["train", "--data", "three", "--validation-episodes", "2", "--seed", "7"];
    [&flags[..], &["--recipe", recipe, "--episodes", episodes, "--out", out]].concat()
}

fn checkpoint(out: &Path) -> PathBuf {
    out.with_extension("checkpoint")
}

#[test]
fn a_training_gives_the_same_bytes_on_any_number_of_threads() {
    let dir = tempfile::tempdir().unwrap();
    for (recipe, episodes) in [("best", "48"), ("published", "12")] {
        let trained = ["1", "2", "3"].map(|threads| {
            let out = dir.path().join(format!("{recipe}-{threads}.safetensors"));
            let mut command = Command::new(env!("CARGO_BIN_EXE_packlab"));
            command.args(training(recipe, episodes, &out)).env("RAYON_NUM_THREADS", threads);
            assert!(command.output().unwrap().status.success());
            fs::read(out).unwrap()
        });
        assert!(trained.iter().all(|bytes| *bytes == trained[0]), "{recipe}");
    }
}

#[test]
fn a_training_that_was_killed_gives_the_bytes_of_one_that_was_not() {
    let dir = tempfile::tempdir().unwrap();
    let (whole, killed) = (dir.path().join("whole.safetensors"), dir.path().join("killed.safetensors"));
    succeeds(&training("best", "96", &whole));
    let mut command = Command::new(env!("CARGO_BIN_EXE_packlab"));
    let mut process = command.args(training("best", "1000000", &killed)).stderr(Stdio::null()).spawn().unwrap();
    while !checkpoint(&killed).exists() {
        assert!(process.try_wait().unwrap().is_none(), "it trains until it is killed");
        std::thread::yield_now();
    }
    process.kill().unwrap();
    process.wait().unwrap();
    assert!(!killed.exists());
    succeeds(&training("best", "96", &killed));
    assert_eq!(fs::read(&killed).unwrap(), fs::read(&whole).unwrap());
}

/// A limit on the size of files stands in for a disk that is full.
#[test]
fn a_full_disk_leaves_the_last_good_checkpoint() {
    let dir = tempfile::tempdir().unwrap();
    let (whole, stopped) = (dir.path().join("whole.safetensors"), dir.path().join("stopped.safetensors"));
    succeeds(&training("best", "24", &stopped));
    let before = [checkpoint(&stopped), stopped.clone()].map(|file| fs::read(file).unwrap());
    let limited = "trap '' XFSZ; ulimit -f 8; exec \"$0\" \"$@\"";
    let mut command = Command::new("sh");
    command.args(["-c", limited, env!("CARGO_BIN_EXE_packlab")]).args(training("best", "48", &stopped));
    let output = command.output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success());
    for words in ["stopped.checkpoint", "cannot be written", "make room", "File too large"] {
        assert!(said.contains(words), "{said}");
    }
    assert_eq!([checkpoint(&stopped), stopped.clone()].map(|file| fs::read(file).unwrap()), before);
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 2, "nothing half written is left");
    succeeds(&training("best", "48", &stopped));
    succeeds(&training("best", "48", &whole));
    assert_eq!(fs::read(&stopped).unwrap(), fs::read(&whole).unwrap());
}

#[test]
fn a_checkpoint_or_model_that_is_not_whole_or_not_its_own_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("model.safetensors");
    succeeds(&training("best", "24", &out));
    let (good, model) = (fs::read(checkpoint(&out)).unwrap(), fs::read(&out).unwrap());
    for length in [0, 1, 22, 40, good.len() / 2, good.len() - 1] {
        fs::write(checkpoint(&out), &good[..length]).unwrap();
        refuses(&training("best", "48", &out), &["model.checkpoint", "remove it"]);
        assert_eq!(fs::read(checkpoint(&out)).unwrap(), good[..length], "it is left for a person to look at");
    }
    assert_eq!(fs::read(&out).unwrap(), model);
    let named = |kind: &str| format!("{kind}:{}", out.display());
    refuses(&["evaluate", "--policy", &named("packman-published")], &["packman-published", "another model"]);
    fs::write(&out, &model[..model.len() - 1]).unwrap();
    refuses(&["evaluate", "--policy", &named("packman")], &["model.safetensors", "cut short"]);
}

#[test]
fn learning_curves_are_drawn_and_nothing_else_is() {
    let dir = tempfile::tempdir().unwrap();
    let (curve, svg) = (dir.path().join("seed-7.csv"), dir.path().join("curve.svg"));
    let out = dir.path().join("model.safetensors");
    let flags = training("published", "3", &out);
    succeeds(&[&flags[..], &["--curve", curve.to_str().unwrap()]].concat());
    succeeds(&["curve", curve.to_str().unwrap(), "--svg", svg.to_str().unwrap()]);
    assert!(fs::read_to_string(&svg).unwrap().contains(">seed-7</text>"));
    refuses(&["curve", out.to_str().unwrap(), "--svg", "x.svg"], &["model.safetensors"]);
    refuses(&["curve", "/nonexistent.csv", "--svg", "x.svg"], &["/nonexistent.csv"]);
    let transfer = dir.path().join("transfer.svg");
    let args = ["evaluate", "--data", "three,ten", "--policy", "first-fit,walle-corners", "--episodes", "2", "--svg"];
    succeeds(&[&args[..], &[transfer.to_str().unwrap()]].concat());
    assert_eq!(fs::read_to_string(transfer).unwrap().matches("<g>").count(), 4);
}

#[test]
fn what_does_not_exist_is_named() {
    refuses(&["evaluate", "--policy", "best-fit"], &["best-fit", "walle-corners", "packman-lookahead"]);
    refuses(&["evaluate", "--data", "standrad"], &["standrad", "small-boxes"]);
    refuses(&["evaluate", "--policy", "packman:/nonexistent.safetensors"], &["/nonexistent.safetensors"]);
    refuses(&["evaluate", "--walle-weights", "1,2,3,4,-5"], &["weights"]);
    refuses(&["generate", "--data", "standard", "--out", "boxes.txt"], &[".json"]);
    refuses(&["train", "--minutes=-1", "--out", "x.safetensors"], &["-1", "minutes"]);
    refuses(&["train", "--out", "/nonexistent/x.safetensors"], &["/nonexistent"]);
    refuses(&["train", "--recipe", "secret", "--out", "x.safetensors"], &["secret"]);
}
