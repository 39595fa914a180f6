//! The package on a machine of its own, used as an operator would use it.
//!
//! It needs root, namespaces and the package, so it is run by name only, as `.ci/run` does:
//! `deploy/debian/build && cargo test --release --workspace --test cell -- --ignored systemd::`.
#![expect(clippy::print_stdout, reason = "the times are figures for whoever runs it, and no condition")]

use std::fs;
use std::path::PathBuf;
use std::process::Command;
use std::thread;

use rustix::time::{ClockId, clock_gettime};
use serde_json::Value;

use crate::harness::{program, root, wait_until};
use crate::machine::Machine;

/// The services of a cell, and the program that each of them runs.
const SERVICES: [&str; 4] = ["packcell-candidates", "packcell-scorer@a", "packcell-commander", "packcell-perception"];

/// Nobody, who has no business with the cell.
const NOBODY: [&str; 5] = ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups", "--"];

const CONFIG: &str = "/etc/packcell/packcell.toml";

#[test]
#[ignore = "boots a systemd: needs root, namespaces and the package; .ci/run runs it"]
fn an_installed_cell_is_run_watched_upgraded_and_removed_under_systemd() {
    let packages = tempfile::tempdir().unwrap();
    let (package, next) = (package(), packages.path().join("next.deb"));
    make_next_version(&package, &next);
    let machine = Machine::boot();

    installing_starts_nothing(&machine, &package);
    units_are_valid_and_hardened(&machine);
    edit(&machine, &[("pace_ms = 1000", "pace_ms = 20"), ("level = \"info\"", "level = \"debug\"")]);
    starting_packs_boxes(&machine);
    an_operator_sees_everything_and_nobody_else_anything(&machine);
    for service in SERVICES {
        a_killed_service_comes_back(&machine, service);
    }
    a_frozen_service_is_replaced(&machine);
    a_good_configuration_is_taken_over_and_a_bad_one_refused(&machine);
    a_scorer_is_swapped_and_stays_swapped(&machine);
    a_swap_survives_a_restart_of_anybody(&machine);
    a_service_that_cannot_run_is_given_up_and_started_again_by_hand(&machine);
    real_time_is_given_and_read_back(&machine);
    an_upgrade_waits_to_be_finished(&machine, &next);
    stopping_leaves_no_memory(&machine);
    removing_keeps_what_an_operator_made_and_purging_does_not(&machine);
}

fn installing_starts_nothing(machine: &Machine, package: &PathBuf) {
    fs::copy(package, machine.path("/root/packcell.deb")).unwrap();
    let said = machine.must(&["dpkg", "--install", "/root/packcell.deb"]);
    assert!(said.contains("systemctl start packcell.target"), "{said}");
    assert_eq!(machine.run(&["systemctl", "is-enabled", "packcell.target"]).stdout, "enabled\n");
    assert_eq!(machine.run(&["systemctl", "is-active", "packcell.target"]).stdout, "inactive\n");
    assert_eq!(machine.must(&["stat", "--format=%U %a", "/run/packcell/bus"]), "packcell 700\n");
    machine.must(&["packcell", "check"]);
    let page = machine.path("/usr/share/man/man1/packcell-status.1.gz");
    assert!(page.exists(), "{} is missing", page.display());
}

fn units_are_valid_and_hardened(machine: &Machine) {
    let units = machine.must(&["sh", "-c", "ls /usr/lib/systemd/system/packcell*.service"]);
    for unit in units.lines().map(|unit| unit.replace("@.", "@a.")) {
        let name = unit.rsplit('/').next().unwrap();
        let verified = machine.run(&["systemd-analyze", "verify", name]);
        assert_eq!((verified.stdout.as_str(), verified.stderr.as_str()), ("", ""), "{name}");
        // The exposure is printed with one digit, and compared in tenths.
        let rated = machine.run(&["systemd-analyze", "security", "--offline=true", "--threshold=10", &unit]);
        assert!(rated.is_success, "{name}\n{}{}", rated.stdout, rated.stderr);
        println!("{}", rated.stdout.lines().last().unwrap_or_default());
    }
    let verified = machine.run(&["systemd-analyze", "verify", "packcell.target"]);
    assert_eq!((verified.stdout.as_str(), verified.stderr.as_str()), ("", ""));
}

fn starting_packs_boxes(machine: &Machine) {
    let begun_us = monotonic_us();
    machine.must(&["systemctl", "start", "packcell.target"]);
    let first_us = await_packed_after(machine, begun_us);
    println!("start of the target to the first box done: {} ms", (first_us - begun_us) / 1000);
    for service in SERVICES {
        // The first box may be done before whoever brought it has said that it is ready.
        wait_until(service, || (property(machine, service, "ActiveState") == "active").then_some(()));
        let status = property(machine, service, "StatusText");
        assert!(status.contains("boxes"), "{service}: {status}");
    }
}

fn an_operator_sees_everything_and_nobody_else_anything(machine: &Machine) {
    let status = machine.must(&["packcell", "status"]);
    for role in ["perception", "candidates", "scorer", "commander", "the belt:"] {
        assert!(status.contains(role), "{status}");
    }
    let find = |who: &[&str], what: &[&str]| {
        let command = [who, &["find", "/run/packcell/bus", "/dev/shm"], what].concat();
        machine.run(&command).stdout
    };
    assert_eq!(find(&[], &["-name", "packcell*", "!", "-user", "packcell"]), "", "root leaves nothing of its own");
    assert_ne!(find(&[], &["-name", "packcell_*"]), "", "the cell has shared memory");
    let open = find(&NOBODY, &["-mindepth", "1", "(", "-readable", "-o", "-writable", ")"]);
    assert_eq!(open, "", "nobody may read or write what the cell shares");
    for command in [&["packcell", "status"][..], &["/usr/lib/packcell/commander"], &["packcell", "clean"]] {
        let said = machine.run(&[&NOBODY, command].concat());
        let is_told = said.stderr.contains("belongs to the user packcell");
        assert!(!said.is_success && is_told, "{command:?}: {}{}", said.stdout, said.stderr);
    }
    let clean = machine.run(&["packcell", "clean"]);
    assert!(!clean.is_success && clean.stderr.contains("stop them first"), "{}", clean.stderr);

    for service in SERVICES {
        let pid = property(machine, service, "MainPID");
        let sockets = machine.must(&["cat", &format!("/proc/{pid}/net/tcp"), &format!("/proc/{pid}/net/udp")]);
        assert_eq!(sockets.lines().count(), 2, "{service} has no network, so two headers: {sockets}");
    }
    let of_box = ["PACKCELL_STAGE=commander", "PACKCELL_BOX=1"];
    let line = journal(machine, &of_box).pop().expect("the first box has its line");
    assert_eq!(line["PACKCELL_INSTANCE"], "a");
    assert_eq!(line["_SYSTEMD_UNIT"], "packcell-commander.service");
}

fn a_killed_service_comes_back(machine: &Machine, service: &str) {
    let pid = property(machine, service, "MainPID");
    let killed_us = monotonic_us();
    machine.must(&["kill", "-9", &pid]);
    let (back_us, decided_us) = await_back(machine, service, &pid);
    println!(
        "kill -9 of {service} to ready: {} ms, to the next box: {} ms",
        since(killed_us, back_us),
        since(killed_us, decided_us)
    );
    for other in SERVICES.iter().filter(|&other| *other != service) {
        assert_eq!(property(machine, other, "ActiveState"), "active", "{other} goes on without {service}");
    }
}

fn a_frozen_service_is_replaced(machine: &Machine) {
    let pid = property(machine, "packcell-scorer@a", "MainPID");
    let frozen_us = monotonic_us();
    machine.must(&["kill", "-STOP", &pid]);
    let (back_us, _) = await_back(machine, "packcell-scorer@a", &pid);
    println!("SIGSTOP of packcell-scorer@a to ready: {} ms", since(frozen_us, back_us));
    let watchdog = ["_PID=1", "UNIT=packcell-scorer@a.service"];
    let is_seen = journal(machine, &watchdog).iter().any(|line| message(line).contains("Watchdog timeout"));
    assert!(is_seen, "it was the watchdog that replaced it");
    let fallback = journal(machine, &["PACKCELL_STAGE=commander"]);
    let decided = |line: &Value| message(line).contains("the fallback decides");
    assert!(fallback.iter().any(decided), "the fallback decided meanwhile, and the log says so");
}

fn a_good_configuration_is_taken_over_and_a_bad_one_refused(machine: &Machine) {
    let pids = ["packcell-commander", "packcell-perception"].map(|service| property(machine, service, "MainPID"));
    edit(machine, &[("hard_deadline_ms = 25", "hard_deadline_ms = 30"), ("pace_ms = 20", "pace_ms = 30")]);
    machine.must(&["systemctl", "reload", "packcell-commander", "packcell-perception"]);
    wait_until("both have read it", || {
        let taken = "taken over: commander.hard_deadline_ms, perception.pace_ms";
        let lines = machine.must(&["journalctl", "--output=cat", "--unit=packcell-*"]);
        (lines.matches(taken).count() == 2).then_some(())
    });
    edit(machine, &[("hard_deadline_ms = 30", "hard_deadline_ms = 0")]);
    let refused = machine.run(&["systemctl", "reload", "packcell-commander"]);
    assert!(!refused.is_success, "systemctl says that it was refused");
    wait_until("the commander's log says why", || {
        let said = machine.must(&["journalctl", "--unit=packcell-commander", "--output=cat"]);
        said.contains("it must be 1 to 1000 ms").then_some(())
    });
    edit(machine, &[("hard_deadline_ms = 0", "hard_deadline_ms = 25")]);
    await_packed_after(machine, monotonic_us());
    let after = ["packcell-commander", "packcell-perception"].map(|service| property(machine, service, "MainPID"));
    assert_eq!(pids, after, "nobody was restarted");
}

fn a_scorer_is_swapped_and_stays_swapped(machine: &Machine) {
    let state = |instance: &str| property(machine, &format!("packcell-scorer@{instance}"), "ActiveState");
    let swap = |args: &[&str]| machine.must(&[&["packcell", "swap", "--sets", "10"], args].concat());
    swap(&["--policy", "walle", "--dry-run"]);
    assert_eq!((state("a").as_str(), state("b").as_str()), ("active", "inactive"), "a dry run changes nothing");

    let model = root().join("deploy/models/packman-published.safetensors");
    fs::copy(&model, machine.path("/var/tmp/new.safetensors")).unwrap();
    machine.must(&["install", "-m", "600", "/var/tmp/new.safetensors", "/root/locked.safetensors"]);
    let refused = machine.run(&["packcell", "swap", "--model", "/root/locked.safetensors"]);
    let is_told = refused.stderr.contains("/root/locked.safetensors") && refused.stderr.contains("Permission denied");
    assert!(!refused.is_success && is_told, "{}", refused.stderr);
    assert_eq!((state("a").as_str(), state("b").as_str()), ("active", "inactive"), "a model that nobody may read");
    let swap_file = "cd /var/tmp && packcell swap --sets 10 --policy packman-published --model new.safetensors";
    let said = machine.must(&["sh", "-c", swap_file]);
    assert!(said.contains("scorer b is active"), "{said}");
    assert_eq!((state("a").as_str(), state("b").as_str()), ("inactive", "active"));
    for unit in ["packcell-commander", "packcell-scorer@b"] {
        let restarted_us = monotonic_us();
        machine.must(&["systemctl", "restart", unit]);
        await_packed_after(machine, restarted_us);
        let status = machine.must(&["packcell", "status"]);
        assert!(status.contains("the active scorer: b"), "after the restart of {unit}: {status}");
    }
    let said = swap(&["--back"]);
    assert!(said.contains("scorer a is active"), "{said}");
    assert_eq!((state("a").as_str(), state("b").as_str()), ("active", "inactive"));
    let listed = machine.must(&["packcell", "journal", "--last", "0"]);
    assert!(listed.contains("scorer b is active") && listed.contains("scorer a is active"), "{listed}");
}

/// A restart in the middle: the new scorer has begun to answer beside the active one, and is not promoted yet.
fn a_swap_survives_a_restart_of_anybody(machine: &Machine) {
    let state = |instance: &str| property(machine, &format!("packcell-scorer@{instance}"), "ActiveState");
    let [mut active, mut newcomer] = ["a", "b"];
    for unit in ["packcell-commander", "packcell-candidates", "packcell-perception", "the active", "the new"] {
        let unit = match unit {
            "the active" => format!("packcell-scorer@{active}"),
            "the new" => format!("packcell-scorer@{newcomer}"),
            _ => unit.to_owned(),
        };
        let policy = if newcomer == "b" { "walle" } else { "packman" };
        thread::scope(|scope| {
            let swap = scope.spawn(|| machine.run(&["packcell", "swap", "--sets", "40", "--policy", policy]));
            wait_until("the new scorer is ready", || (state(newcomer) == "active").then_some(()));
            machine.must(&["systemctl", "restart", &unit]);
            let said = swap.join().unwrap();
            assert!(said.is_success, "restart of {unit}: {}{}", said.stdout, said.stderr);
        });
        let status = machine.must(&["packcell", "status"]);
        assert!(status.contains(&format!("the active scorer: {newcomer}")), "restart of {unit}: {status}");
        wait_until("the old scorer has ended", || (state(active) == "inactive").then_some(()));
        await_packed_after(machine, monotonic_us());
        (active, newcomer) = (newcomer, active);
    }
    machine.must(&["packcell", "swap", "--sets", "10", "--back"]);
}

fn a_service_that_cannot_run_is_given_up_and_started_again_by_hand(machine: &Machine) {
    edit(machine, &[("hard_deadline_ms = 25", "hard_deadline_ms = 0")]);
    machine.run(&["systemctl", "restart", "packcell-commander"]);
    wait_until("systemd gives it up", || {
        (property(machine, "packcell-commander", "ActiveState") == "failed").then_some(())
    });
    for other in SERVICES.iter().filter(|&other| *other != "packcell-commander") {
        assert_eq!(property(machine, other, "ActiveState"), "active", "{other} goes on without the commander");
    }
    let last_words = machine.must(&["journalctl", "--unit=packcell-commander", "--priority=err", "--output=cat"]);
    assert!(last_words.contains("Error: commander.hard_deadline_ms = 0"), "{last_words}");
    edit(machine, &[("hard_deadline_ms = 0", "hard_deadline_ms = 25")]);
    machine.must(&["systemctl", "reset-failed", "packcell-commander"]);
    let started_us = monotonic_us();
    machine.must(&["systemctl", "start", "packcell.target"]);
    await_packed_after(machine, started_us);
}

fn real_time_is_given_and_read_back(machine: &Machine) {
    let example = "/usr/share/doc/packcell/examples/realtime.conf";
    let dropin = "/etc/systemd/system/packcell-.service.d/realtime.conf";
    machine.must(&["install", "-D", "-m", "644", example, dropin]);
    machine.must(&["sed", "-i", "s/^#CPUAffinity=.*/CPUAffinity=0/", dropin]);
    machine.must(&["systemctl", "daemon-reload"]);
    let restarted_us = monotonic_us();
    machine.must(&["systemctl", "restart", "packcell.target"]);
    await_packed_after(machine, restarted_us);
    for stage in ["candidates", "commander", "perception", "scorer"] {
        let lines = journal(machine, &[&format!("PACKCELL_STAGE={stage}")]);
        let mut granted = lines.iter().map(message).filter(|line| line.starts_with("granted by the kernel"));
        let granted = granted.next_back().expect("every process says what it got");
        assert!(granted.contains("fifo 20 on processors 0, memory"), "{stage}: {granted}");
        println!("{stage} was {granted}");
    }
    fs::remove_file(machine.path(dropin)).unwrap();
    machine.must(&["systemctl", "daemon-reload"]);
}

fn an_upgrade_waits_to_be_finished(machine: &Machine, next: &PathBuf) {
    let pids = || SERVICES.map(|service| property(machine, service, "MainPID"));
    let before = pids();
    fs::copy(next, machine.path("/root/next.deb")).unwrap();
    let said = machine.must(&["dpkg", "--install", "--force-confold", "/root/next.deb"]);
    assert!(said.contains("systemctl restart packcell.target"), "{said}");
    assert_eq!(pids(), before, "an upgrade does not stop a running cell unasked");
    let restarted_us = monotonic_us();
    machine.must(&["systemctl", "restart", "packcell.target"]);
    await_packed_after(machine, restarted_us);
    assert!(pids().iter().zip(&before).all(|(new, old)| new != old), "everybody runs the new version");
}

fn stopping_leaves_no_memory(machine: &Machine) {
    let begun_us = monotonic_us();
    machine.must(&["systemctl", "stop", "packcell.target", "packcell-*.service"]);
    println!("stop of the target: {} ms", since(begun_us, monotonic_us()));
    for service in SERVICES {
        let result = property(machine, service, "Result");
        assert_eq!(result, "success", "{service} ended by itself when asked");
    }
    assert_eq!(machine.must(&["find", "/dev/shm", "/run/packcell/bus", "-mindepth", "1"]), "");
    let status = machine.run(&["packcell", "status"]);
    assert!(!status.is_success && status.stderr.contains("systemctl start packcell.target"), "{}", status.stderr);
}

fn removing_keeps_what_an_operator_made_and_purging_does_not(machine: &Machine) {
    machine.must(&["systemctl", "start", "packcell.target"]);
    machine.must(&["dpkg", "--remove", "packcell"]);
    assert_eq!(machine.run(&["systemctl", "is-active", "packcell-commander"]).stdout, "inactive\n");
    assert_eq!(machine.must(&["find", "/dev/shm", "-mindepth", "1"]), "");
    assert!(machine.path(CONFIG).exists() && machine.path("/var/lib/packcell").exists());

    machine.must(&["dpkg", "--purge", "packcell"]);
    let left = machine.must(&["find", "/etc", "/usr", "/var/lib", "/run", "/dev/shm", "-xdev", "-name", "*packcell*"]);
    let cgroup = |line: &&str| !line.starts_with("/run/systemd/");
    assert_eq!(left.lines().filter(cgroup).collect::<Vec<_>>(), [] as [&str; 0]);
    assert!(!machine.run(&["getent", "passwd", "packcell"]).is_success, "the user has gone too");
}

/// The package that `deploy/debian/build` made of the programs that are tested here.
pub(crate) fn package() -> PathBuf {
    let own = program("packcell");
    let dir = own.ancestors().nth(2).unwrap().join("debian");
    let entries = fs::read_dir(&dir).into_iter().flatten().flatten().map(|entry| entry.path());
    let package = entries.filter(|path| path.extension().is_some_and(|extension| extension == "deb")).max();
    let age = |path: &PathBuf| fs::metadata(path).unwrap().modified().unwrap();
    let package = package.filter(|package| age(package) >= age(&own));
    package.expect("there is no package of the present programs: run deploy/debian/build")
}

/// The same package under a later version.
fn make_next_version(package: &PathBuf, next: &PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let files = dir.path().join("files");
    let run = |command: &mut Command| assert!(command.output().unwrap().status.success(), "{command:?} failed");
    run(Command::new("dpkg-deb").arg("--raw-extract").arg(package).arg(&files));
    let control = files.join("DEBIAN/control");
    let text = fs::read_to_string(&control).unwrap();
    let version = text.lines().find(|line| line.starts_with("Version: ")).unwrap();
    fs::write(&control, text.replace(version, &format!("{version}+next"))).unwrap();
    run(Command::new("dpkg-deb").args(["-Znone", "--root-owner-group", "--build"]).arg(&files).arg(next));
}

/// Edits the configuration as with a text editor.
#[track_caller]
pub(crate) fn edit(machine: &Machine, changes: &[(&str, &str)]) {
    let path = machine.path(CONFIG);
    let mut text = fs::read_to_string(&path).unwrap();
    for (old, new) in changes {
        assert!(text.contains(old), "{old} is not in the file");
        text = text.replace(old, new);
    }
    fs::write(path, text).unwrap();
}

fn property(machine: &Machine, unit: &str, name: &str) -> String {
    machine.must(&["systemctl", "show", "--value", "--property", name, unit]).trim().to_owned()
}

/// The journal's lines with these fields, oldest first.
fn journal(machine: &Machine, fields: &[&str]) -> Vec<Value> {
    let lines = machine.must(&[&["journalctl", "--output=json", "--no-pager"], fields].concat());
    lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

fn message(line: &Value) -> &str {
    line["MESSAGE"].as_str().unwrap_or_default()
}

/// Waits until a box is done after `after_us`; when that was logged [us, CLOCK_MONOTONIC].
fn await_packed_after(machine: &Machine, after_us: u64) -> u64 {
    wait_until("a box is packed", || {
        let lines = machine.must(&["journalctl", "--output=json", "--lines=200", "PACKCELL_STAGE=commander"]);
        let lines = lines.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
        let packed = lines.filter(|line| message(line).contains(" done: "));
        packed.filter_map(|line| line["__MONOTONIC_TIMESTAMP"].as_str()?.parse().ok()).find(|&us: &u64| us > after_us)
    })
}

/// Waits until another process than `pid` runs as the service and is ready, and a box was packed since then; when both
/// happened [us, CLOCK_MONOTONIC].
fn await_back(machine: &Machine, service: &str, pid: &str) -> (u64, u64) {
    let back_us = wait_until("the service is back", || {
        let is_back =
            property(machine, service, "MainPID") != pid && property(machine, service, "ActiveState") == "active";
        is_back.then(|| property(machine, service, "ActiveEnterTimestampMonotonic").parse().unwrap())
    });
    (back_us, await_packed_after(machine, back_us))
}

fn monotonic_us() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000 + now.tv_nsec as u64 / 1000
}

/// Time from one stamp to a later one [ms].
fn since(from_us: u64, until_us: u64) -> u64 {
    until_us.saturating_sub(from_us) / 1000
}
