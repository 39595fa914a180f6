//! What the units' hardening costs, measured on a machine of its own; run by name only, on a quiet machine:
//! `deploy/debian/build && cargo test --release --workspace --test cell -- --ignored hardening --nocapture`.

use std::fs;

use serde_json::Value;

use crate::machine::Machine;
use crate::systemd::{edit, package};

/// The same cell with and without, one after the other, so often.
const ROUNDS: usize = 6;

/// Takes back everything that deploy/systemd/packcell-.service.d asks for beyond user and log.
const UNHARDENED: &str = "[Service]
ProtectSystem=no
ProtectHome=no
PrivateTmp=no
PrivateDevices=no
DevicePolicy=auto
PrivateUsers=no
ProtectProc=default
ProcSubset=all
ProtectClock=no
ProtectControlGroups=no
ProtectHostname=no
ProtectKernelLogs=no
ProtectKernelModules=no
ProtectKernelTunables=no
PrivateNetwork=no
IPAddressDeny=
RestrictAddressFamilies=
CapabilityBoundingSet=~
NoNewPrivileges=no
KeyringMode=inherit
LockPersonality=no
MemoryDenyWriteExecute=no
RestrictNamespaces=no
RestrictRealtime=no
RestrictSUIDSGID=no
SystemCallArchitectures=
SystemCallFilter=
";

#[test]
#[ignore = "boots a systemd and measures for two minutes: needs root, namespaces, the package and a quiet machine"]
fn what_hardening_costs_end_to_end() {
    let machine = Machine::boot();
    fs::copy(package(), machine.path("/root/packcell.deb")).unwrap();
    machine.must(&["dpkg", "--install", "/root/packcell.deb"]);
    edit(&machine, &[("pace_ms = 1000", "pace_ms = 5")]);
    let dropin = machine.path("/etc/systemd/system/packcell-.service.d/zz-unhardened.conf");
    fs::create_dir_all(dropin.parent().unwrap()).unwrap();

    let mut measured: [Vec<[u64; 2]>; 2] = Default::default();
    for _ in 0..ROUNDS {
        for (is_hardened, percentiles) in [true, false].into_iter().zip(&mut measured) {
            fs::write(&dropin, if is_hardened { "" } else { UNHARDENED }).unwrap();
            machine.must(&["systemctl", "daemon-reload"]);
            machine.must(&["systemctl", "restart", "packcell.target"]);
            let protect =
                machine.must(&["systemctl", "show", "--value", "--property=ProtectSystem", "packcell-commander"]);
            assert_eq!(protect.trim() == "strict", is_hardened);
            machine.must(&["packcell", "soak", "--attach", "--faults=none", "--boxes=2000", "--json=/tmp/soak.json"]);
            let figures: Value =
                serde_json::from_str(&fs::read_to_string(machine.path("/tmp/soak.json")).unwrap()).unwrap();
            let at = |percentile: &str| {
                figures.pointer(&format!("/latency_us/end_to_end/{percentile}")).unwrap().as_u64().unwrap()
            };
            percentiles.push([at("p50"), at("p99")]);
        }
    }
    for (name, mut rounds) in ["hardened", "unhardened"].into_iter().zip(measured) {
        println!("{name}: end to end p50, p99 of each round [us]: {rounds:?}");
        let mut median = |which: usize| {
            rounds.sort_unstable_by_key(|round| round[which]);
            rounds[ROUNDS / 2][which]
        };
        println!("{name}: median p50 {} us, median p99 {} us", median(0), median(1));
    }
}
