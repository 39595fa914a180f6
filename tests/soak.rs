//! A soak of real processes: short, with faults, and judged by what must always hold. Nothing here depends on how fast
//! the machine is.

use std::fs;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

use rustix::process::Signal;
use serde_json::Value;
use tempfile::TempDir;

use crate::harness::{UpCell, children_of, leftovers, program, signal, wait_until};

/// Every kind of fault, each soon and more than once.
const FAULTS: &str = r#"
[[fault]]
kind = "kill"
target = "scorer"
first_boxes = 30
every_boxes = 150
times = 2
[[fault]]
kind = "kill"
target = "candidates"
first_boxes = 60
every_boxes = 150
times = 2
[[fault]]
kind = "kill"
target = "commander"
first_boxes = 90
every_boxes = 150
times = 2
[[fault]]
kind = "freeze"
target = "candidates"
every_s = 0.7
for_ms = 30
times = 2
[[fault]]
kind = "slow"
every_s = 0.7
for_ms = 100
times = 2
[[fault]]
kind = "rubbish"
target = "decisions"
every_s = 0.5
for_ms = 200
times = 3
[[fault]]
kind = "rubbish"
target = "candidates"
every_s = 0.5
for_ms = 100
times = 2
[[fault]]
kind = "hog"
every_s = 1.0
for_ms = 100
times = 1
[[fault]]
kind = "full-disk"
every_s = 1.0
for_ms = 50
times = 2
[[fault]]
kind = "swap"
first_s = 1.0
every_s = 1.0
times = 1
"#;

struct Soak {
    child: Child,
    dir: TempDir,
}

impl Soak {
    fn begin(args: &[&str]) -> Self {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("faults.toml"), FAULTS).unwrap();
        let mut command = Command::new(program("packcell"));
        command.current_dir(dir.path()).arg("soak").args(args);
        command.args(["--json", "figures.json", "--report", "report.html", "--svg", "curve.svg"]);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        Self { child: command.spawn().unwrap(), dir }
    }

    /// The figures that it writes whatever happened, how it ended, and its directory.
    fn finish(self) -> (Value, Output, TempDir) {
        let pid = self.child.id();
        let output = self.child.wait_with_output().unwrap();
        assert_eq!(leftovers(&format!("pc{pid}_")), [] as [String; 0]);
        assert_eq!(leftovers(&format!("packcell-private-{pid}")), [] as [String; 0]);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        let text = fs::read(self.dir.path().join("figures.json")).unwrap_or_else(|_| panic!("no figures: {said}"));
        (serde_json::from_slice(&text).unwrap(), output, self.dir)
    }
}

/// A cell of the soak's own whose state is in the test's directory, where the test can read it.
fn own(args: &[&str]) -> Soak {
    Soak::begin(&[&["--policy", "walle", "--set", "state.dir=./state"], args].concat())
}

fn number(figures: &Value, pointer: &str) -> u64 {
    figures.pointer(pointer).and_then(Value::as_u64).unwrap_or_else(|| panic!("no number at {pointer}"))
}

#[track_caller]
fn assert_sound(figures: &Value) {
    for pointer in ["/lost", "/doubled", "/unseen", "/orders_refused"] {
        assert_eq!(number(figures, pointer), 0, "{pointer}: {figures:#}");
    }
    let latency = figures.pointer("/latency_us/end_to_end").unwrap();
    let answers = number(figures, "/boxes") + number(figures, "/containers_replaced");
    assert!(number(latency, "/count") + number(figures, "/lost_reports") >= answers, "{figures:#}");
    assert!(number(latency, "/p50") <= number(latency, "/max"));
}

#[track_caller]
fn assert_page(dir: &Path) {
    let page = fs::read_to_string(dir.join("report.html")).unwrap();
    assert!(page.starts_with("<!doctype html>") && page.ends_with("</html>\n"));
    for outside in ["http:", "https:", "url(", "<script", "@import"] {
        assert!(!page.replace("http://www.w3.org/2000/svg", "").contains(outside), "{outside}");
    }
    assert!(fs::read_to_string(dir.join("curve.svg")).unwrap().starts_with("<svg "));
}

#[test]
fn no_box_is_lost_or_doubled_whatever_the_schedule_does() {
    let soak = own(&["--pace", "5", "--faults", "faults.toml", "--baseline", "--seed", "7"]);
    let (figures, output, dir) = soak.finish();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(figures["end"], "all faults");
    assert_sound(&figures);
    let faults = figures["faults"].as_array().unwrap();
    assert_eq!(faults.len(), 19, "{figures:#}");
    let late: u64 = faults.iter().map(|fault| fault["cost_boxes_late"].as_u64().unwrap()).sum();
    assert!(late <= number(&figures, "/over_budget"));
    let restarts = figures["restarts"].as_object().unwrap();
    assert!(restarts["candidates"].as_u64() >= Some(1) && restarts["commander"].as_u64() >= Some(1), "{restarts:?}");
    assert!(number(&figures, "/messages_refused") > 0, "rubbish is refused and counted");
    assert!(number(&figures, "/baseline/ping_us/count") > 0 && number(&figures, "/baseline/timer_us/count") > 0);
    assert!(figures["processes"].as_array().unwrap().len() >= 5, "the swapped scorer is listed too");
    assert_page(dir.path());
}

#[test]
fn a_soak_ends_when_told_and_reports_what_it_has() {
    let soak = own(&["--faults", "none"]);
    let children = wait_until("the cell runs", || {
        let children = children_of(soak.child.id());
        (children.len() == 4).then_some(children)
    });
    let journal = soak.dir.path().join("state/journal.bin");
    wait_until("boxes are packed", || (fs::metadata(&journal).ok()?.len() > 20_000).then_some(()));
    signal(soak.child.id(), Signal::INT);
    let (figures, output, dir) = soak.finish();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(figures["end"], "interrupted");
    assert_sound(&figures);
    assert!(number(&figures, "/boxes") > 50);
    assert!(children.iter().all(|pid| !Path::new(&format!("/proc/{pid}")).exists()));
    assert_page(dir.path());
}

#[test]
fn a_budget_that_is_not_kept_fails_the_soak() {
    let (figures, output, _dir) =
        own(&["--faults", "none", "--boxes", "200", "--budget", "0", "--late-max", "5"]).finish();
    assert_eq!(output.status.code(), Some(1));
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(said.contains("over 0 ms, allowed are 5"), "{said}");
    assert_sound(&figures);
    assert_eq!(figures["late"].as_array().unwrap().len(), 100, "the slowest are listed, all are counted");
    assert!(number(&figures, "/over_budget") >= 200);
}

#[test]
fn a_cell_that_runs_already_is_watched_and_left_as_it_is() {
    let mut cell = UpCell::start("soaked", &["--pace", "5", "--policy", "walle"]);
    cell.await_status();
    let bus = cell.bus_args();
    let bus: Vec<&str> = bus.iter().map(String::as_str).collect();
    let (figures, output, _dir) = Soak::begin(&[&["--attach", "--boxes", "100"], &bus[..]].concat()).finish();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_sound(&figures);
    assert!(number(&figures, "/boxes") >= 100 && number(&figures, "/faults_count") == 0);
    let harmed =
        Command::new(program("packcell")).args(["soak", "--attach", "--faults", "default"]).args(&bus).output();
    let said = String::from_utf8_lossy(&harmed.unwrap().stderr).into_owned();
    assert!(said.contains("is not done to an attached cell"), "{said}");
    // The cell goes away under the soak's eyes.
    let soak = Soak::begin(&[&["--attach"], &bus[..]].concat());
    wait_until("the soak watches", || {
        let status = cell.await_status();
        (!status.is_empty() && Path::new(&format!("/proc/{}/fd", soak.child.id())).exists()).then_some(())
    });
    assert_eq!(cell.stop_with(Signal::TERM).0, Some(0));
    let output = soak.child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(1), "a cell that is gone is no success");
}
