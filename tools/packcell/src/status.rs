//! `packcell status`: what every process of a running cell is doing.

use std::collections::BTreeMap;
use std::thread;
use std::time::Duration;

use anyhow::bail;
use comfy_table::{Table, presets};
use messages::topics::{ACTIVE, BOXES, HEALTH, Role};
use messages::{Health, Instance};
use runtime::{Bus, monotonic_ns, processes_on};

use crate::args::WhichCell;
use crate::owner::act_as_owner;

/// How long to listen: every process speaks five times a second.
const LISTEN_NS: u64 = 1_000_000_000;

#[derive(Debug, clap::Args)]
pub(crate) struct StatusArgs {
    #[command(flatten)]
    which: WhichCell,
}

pub(crate) fn run(args: &StatusArgs) -> anyhow::Result<()> {
    let config = args.which.config()?;
    act_as_owner(&config.bus)?;
    let root_dir = &config.bus.root_dir;
    if processes_on(&config.bus)? == 0 {
        bail!(
            "no cell runs on the bus {}: start one with 'packcell up', or an installed one with \
             'systemctl start packcell.target'",
            root_dir.display()
        );
    }
    let bus = Bus::join(&config.bus, Role::Tool)?;
    let health = bus.subscriber(&HEALTH)?;
    let (mut queues, mut active) = (bus.latest(&BOXES)?, bus.latest(&ACTIVE)?);
    let mut words: BTreeMap<u32, Health> = BTreeMap::new();
    let until_ns = monotonic_ns() + LISTEN_NS;
    while monotonic_ns() < until_ns && !bus.is_stopping() {
        while let Some(word) = health.receive()? {
            words.insert(word.pid, *word);
        }
        queues.refresh()?;
        active.refresh()?;
        thread::sleep(Duration::from_millis(20));
    }
    if words.is_empty() {
        bail!("no process speaks on the bus {}: the cell has stopped or hangs", root_dir.display());
    }
    let mut words: Vec<Health> = words.into_values().collect();
    words.sort_by_key(|word| (word.role, word.pid));
    println!("{}", table(&words, monotonic_ns()));
    let missing =
        Role::ALL.into_iter().filter(|&role| role != Role::Tool && !words.iter().any(|w| w.role() == Ok(role)));
    for role in missing {
        println!("no {} speaks: it has stopped or hangs", role.name());
    }
    if let Some(instance) = active.get().and_then(|said| Instance::from_wire(said.instance).ok()) {
        println!("the active scorer: {instance}");
    }
    if let Some(queue) = queues.get() {
        println!("the belt: {} boxes taken in {} episode(s), revision {}", queue.taken, queue.episodes, queue.revision);
    }
    Ok(())
}

fn table(words: &[Health], now_ns: u64) -> Table {
    let mut table = Table::new();
    table.load_style(presets::UTF8_HORIZONTAL_ONLY);
    table.set_header([
        "process",
        "pid",
        "up [s]",
        "boxes",
        "last box",
        "refused",
        "stale",
        "what",
        "last refusal",
        "alarm",
    ]);
    for word in words {
        let up_s = now_ns.saturating_sub(word.ready_ns) / 1_000_000_000;
        let counters = word.counters;
        table.add_row([
            name(word),
            word.pid.to_string(),
            up_s.to_string(),
            counters.handled.to_string(),
            counters.last_box.to_string(),
            counters.refused.to_string(),
            counters.stale.to_string(),
            word.detail.as_str().to_owned(),
            word.refusal.as_str().to_owned(),
            word.alarm.as_str().to_owned(),
        ]);
    }
    table
}

fn name(word: &Health) -> String {
    let role = word.role().map_or("unknown", Role::name);
    match Instance::from_wire(word.instance) {
        Ok(instance) => format!("{role} {instance}"),
        Err(_) => role.to_owned(),
    }
}
