//! Cells that are stopped, killed, or refused a start.

use std::process::Command;

use rustix::process::Signal;

use crate::harness::{Demo, UpCell, children_of, leftovers, program, signal, wait_until};

#[test]
fn ctrl_c_and_sigterm_stop_a_running_cell_cleanly() {
    for (name, how) in [("int", Signal::INT), ("term", Signal::TERM)] {
        let mut cell = UpCell::start(name, &["--pace", "5"]);
        let status = cell.await_status();
        assert!(status.contains("packman"), "{status}");
        let (code, said) = cell.stop_with(how);
        assert_eq!(code, Some(0), "{said}");
        assert_eq!(cell.leftovers(), [] as [String; 0]);
    }
}

#[test]
fn a_demo_that_is_interrupted_reports_what_it_did() {
    let demo = Demo::begin(&["--pace", "20"]);
    let pid = demo.child.id();
    wait_until("the cell has its four processes", || (children_of(pid).len() == 4).then_some(()));
    signal(pid, Signal::INT);
    let demo = demo.finish();
    assert_eq!(demo.output.status.code(), Some(0), "{}", demo.stderr());
    demo.assert_nothing_is_left();
}

#[test]
fn a_killed_demo_takes_its_processes_along_and_the_next_one_cleans_up() {
    let mut demo = Demo::begin(&["--pace", "20"]);
    let pid = demo.child.id();
    let children = wait_until("the cell runs", || Some(children_of(pid)).filter(|children| children.len() == 4));
    demo.child.kill().unwrap();
    demo.child.wait().unwrap();
    let is_gone = |pid: &u32| !std::path::Path::new(&format!("/proc/{pid}")).exists();
    wait_until("the orphans have ended", || children.iter().all(is_gone).then_some(()));
    assert!(!leftovers(&format!("packcell-private-{pid}")).is_empty(), "nobody was left to clean up");
    let next = Demo::run(&["--policy", "walle"]);
    assert_eq!(next.number("/placed"), next.number("/boxes"));
    assert_eq!(leftovers(&format!("packcell-private-{pid}")), [] as [String; 0]);
    assert_eq!(leftovers(&format!("pc{pid}_")), [] as [String; 0]);
}

#[test]
fn a_second_cell_and_a_second_commander_on_one_bus_are_refused() {
    let mut cell = UpCell::start("second", &["--pace", "5"]);
    cell.await_status();
    let second = Command::new(program("packcell")).arg("up").args(cell.bus_args()).output().unwrap();
    let said = String::from_utf8_lossy(&second.stderr);
    assert!(!second.status.success() && said.contains("runs on the bus"), "{said}");

    let second = Command::new(program("commander")).arg("--config").arg(cell.config_file()).output().unwrap();
    let said = String::from_utf8_lossy(&second.stderr);
    assert!(!second.status.success() && said.contains("another commander writes the journal"), "{said}");
    cell.await_status();
    assert_eq!(cell.stop_with(Signal::TERM).0, Some(0));
}

#[test]
fn status_without_a_cell_says_how_to_start_one() {
    let status = Command::new(program("packcell"))
        .args(["status", "--set", "bus.root_dir=/dev/shm/pctest-nobody-here"])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&status.stderr);
    assert!(!status.status.success() && said.contains("start one with 'packcell up'"), "{said}");
    assert_eq!(leftovers("pctest-nobody-here"), [] as [String; 0], "looking creates nothing");
}
