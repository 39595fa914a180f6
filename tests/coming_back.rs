//! Services that come late, or come back: they continue from the present, and what the dead left is in nobody's way.

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::process::Stdio;

use rustix::process::Signal;

use crate::harness::{Services, leftovers, signal, wait_until};

const SETTINGS: &str = "[perception]\npace_ms = 2\n[scorer]\npolicy = \"walle\"\n";

const ALL: [&str; 4] = ["candidates", "scorer", "commander", "perception"];

#[test]
fn whoever_comes_late_sees_the_present() {
    let mut cell = Services::new("late", SETTINGS);
    cell.start("perception");
    wait_until("perception speaks", || cell.taken().filter(|&taken| taken == 0));
    // The first box lies on the belt already, and everybody missed its first publication.
    for name in ["commander", "scorer", "candidates"] {
        cell.start(name);
    }
    cell.await_progress("the cell packs what lay on the belt before it was complete");
}

#[test]
fn whoever_is_killed_may_come_back() {
    let mut cell = Services::new("back", SETTINGS);
    ALL.into_iter().for_each(|name| cell.start(name));
    cell.await_progress("the cell packs");
    for name in ["candidates", "scorer", "commander"] {
        for _ in 0..2 {
            cell.kill(name);
            cell.start(name);
            cell.await_progress(name);
        }
    }
    // Without a scorer, the ranking in the candidate sets decides.
    cell.kill("scorer");
    cell.await_progress("the cell packs without a scorer");
}

/// A writer of iceoryx2 may wait for a dead or frozen reader for ever, unless it is told not to.
#[test]
fn a_frozen_reader_stops_nobody() {
    let mut cell = Services::new("frozen", SETTINGS);
    ALL.into_iter().for_each(|name| cell.start(name));
    cell.await_progress("the cell packs");
    let mut watcher = cell.status_command().stdout(Stdio::null()).spawn().unwrap();
    let nodes = cell.root_dir().join("nodes");
    let count = || fs::read_dir(&nodes).map_or(0, Iterator::count);
    wait_until("the watcher has joined", || (count() > ALL.len()).then_some(()));
    signal(watcher.id(), Signal::STOP);
    cell.await_progress("the cell packs beside a frozen reader");
    watcher.kill().unwrap();
    watcher.wait().unwrap();
    cell.await_progress("the cell packs beside a dead reader");
}

/// A process killed while it creates a service leaves a file that is still writable, and iceoryx2 then refuses to open
/// the service for ever.
#[test]
fn a_bus_that_was_left_half_created_is_repaired() {
    let mut cell = Services::new("half", SETTINGS);
    ALL.into_iter().for_each(|name| cell.start(name));
    cell.await_progress("the cell packs");
    ALL.into_iter().for_each(|name| cell.kill(name));
    let services: Vec<_> = fs::read_dir(cell.root_dir().join("services")).unwrap().flatten().collect();
    assert!(!services.is_empty());
    for service in services.iter().filter(|entry| entry.path().extension().is_some_and(|e| e == "service")) {
        fs::set_permissions(service.path(), fs::Permissions::from_mode(0o600)).unwrap();
    }
    let prefix = cell.root_dir().file_name().unwrap().to_str().unwrap().to_owned() + "_";
    let dynamic: Vec<_> = leftovers(&prefix).into_iter().filter(|name| name.ends_with(".dynamic")).collect();
    assert!(!dynamic.is_empty());
    for name in dynamic {
        fs::remove_file(format!("/dev/shm/{name}")).unwrap();
    }
    ALL.into_iter().for_each(|name| cell.start(name));
    cell.await_progress("the cell packs on the repaired bus");
}

/// A process killed between creating shared memory and giving it a size leaves an empty file. Whoever opens it waits
/// for ever, cleaning up included.
#[test]
fn shared_memory_without_a_size_holds_nobody_up() {
    let mut cell = Services::new("sizeless", SETTINGS);
    ALL.into_iter().for_each(|name| cell.start(name));
    cell.await_progress("the cell packs");
    let prefix = cell.root_dir().file_name().unwrap().to_str().unwrap().to_owned() + "_";
    cell.kill("scorer");
    let connections = leftovers(&prefix).into_iter().filter(|name| name.ends_with(".connection"));
    let mut emptied = 0;
    for name in connections {
        // Those of the dead and those of the living: the living keep what they have mapped.
        let path = format!("/dev/shm/{name}");
        // Somebody who lives may have cleaned up after the dead first.
        if fs::remove_file(&path).is_ok() {
            fs::write(&path, b"").unwrap();
            emptied += 1;
        }
    }
    assert!(emptied > 0);
    cell.start("scorer");
    cell.await_progress("the cell packs on");
    ALL.into_iter().for_each(|name| cell.kill(name));
    ALL.into_iter().for_each(|name| cell.start(name));
    cell.await_progress("the cell packs after a new start");
}
