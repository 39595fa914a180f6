//! `packcell demo`: one stream through a cell of its own.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::thread;
use std::time::Duration;

use anyhow::{Context as _, bail};
use comfy_table::{CellAlignment, Table, presets};
use indicatif::{ProgressBar, ProgressStyle};
use messages::topics::{BOXES, CYCLES, HEALTH, Role};
use messages::{BeltState, Health, Instance};
use runtime::{Bus, Config, LogLevel, Subscriber, monotonic_ns};

use crate::args::{CellArgs, expected_boxes};
use crate::cell::Cell;
use crate::page;
use crate::private_bus::PrivateBus;
use crate::session::{Figures, Session};

/// How often the reports are read. The topic keeps a thousand of them meanwhile.
const LOOK: Duration = Duration::from_millis(20);

/// How long the cell may go without finishing a box, beyond its pace and the arm's motion.
const STANDSTILL_NS: u64 = 10_000_000_000;

#[derive(Debug, clap::Args)]
pub(crate) struct DemoArgs {
    #[command(flatten)]
    cell: CellArgs,
    /// Writes the figures to this file
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Writes a page with the figures and a picture of every packed container to this file
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
}

pub(crate) fn run(args: &DemoArgs) -> anyhow::Result<()> {
    let mut config = args.cell.config()?;
    if !args.cell.names_pace() {
        config.perception.pace_ms = 0;
    }
    if config.log.level == LogLevel::Info {
        config.log.level = LogLevel::Warn;
    }
    let set = expected_boxes(&mut config)?;
    config.perception.episodes = set.episodes.len() as u64;
    let mut session = Session::new(set);

    let private = PrivateBus::new()?;
    config.bus = private.config().clone();
    config.state.dir = config.bus.root_dir.join("state");
    let packed = pack(&config, &mut session);
    drop(private);
    let figures = session.figures();
    if session.done() > 0 {
        print(&figures);
        write_reports(args, &config, &session, &figures)?;
    }
    packed
}

/// Runs the cell until the stream has ended, Ctrl-C, or something fails.
fn pack(config: &Config, session: &mut Session) -> anyhow::Result<()> {
    let bus = Bus::join(&config.bus, Role::Tool)?;
    let cycles = bus.subscriber(&CYCLES)?;
    let mut queues = bus.latest(&BOXES)?;
    let health = bus.subscriber(&HEALTH)?;
    let mut cell = Cell::start(config, &[Instance::default()], &bus)?;
    let bar = progress_bar(session.expected() as u64);
    let perception = &config.perception;
    let patience_ns = STANDSTILL_NS + (perception.pace_ms + perception.motion_ms) * 1_000_000;
    let mut progress_ns = monotonic_ns();
    while session.done() < session.expected() {
        if bus.is_stopping() {
            bar.abandon();
            println!("stopped after {} of {} boxes", session.done(), session.expected());
            return cell.stop();
        }
        while let Some(report) = cycles.receive()? {
            session.record(&report).context("a cycle report of the cell's own commander")?;
            progress_ns = monotonic_ns();
        }
        queues.refresh()?;
        bar.set_position(session.done() as u64);
        let has_ended = queues.get().is_some_and(|queue| queue.belt_state() == Ok(BeltState::Ended));
        if has_ended && monotonic_ns() > progress_ns + 1_000_000_000 {
            break;
        }
        if monotonic_ns() > progress_ns + patience_ns {
            let (done, expected) = (session.done(), session.expected());
            bail!("the cell stands still after {done} of {expected} boxes{}", alarms(&health)?);
        }
        cell.check()?;
        thread::sleep(LOOK);
    }
    bar.finish_and_clear();
    cell.stop()
}

/// What keeps processes from their work, by the last words of each that are still to be heard.
fn alarms(health: &Subscriber<Health>) -> anyhow::Result<String> {
    let mut alarms = BTreeMap::new();
    while let Some(word) = health.receive()? {
        if let Ok(role) = word.role() {
            alarms.insert(role.name(), word.alarm.as_str().to_owned());
        }
    }
    alarms.retain(|_, alarm| !alarm.is_empty());
    Ok(alarms.iter().map(|(role, alarm)| format!("; {role}: {alarm}")).collect())
}

fn progress_bar(boxes: u64) -> ProgressBar {
    let template = "packing {wide_bar} {pos}/{len} boxes, {per_sec}, {eta} left";
    let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(boxes).with_style(style)
}

fn print(figures: &Figures) {
    let unknown = || "unknown".to_owned();
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    println!("boxes placed       {} of {}, {} set aside", figures.placed, figures.boxes, figures.set_aside);
    println!("containers used    {}, {} replaced", figures.containers_used, figures.containers_replaced);
    println!("c                  {}", figures.competitive_ratio.map_or_else(unknown, |c| format!("{c:.3}")));
    println!("fill               {}", figures.fill.map_or_else(unknown, percent));
    println!("utilisation        {}", percent(figures.utilisation));
    let chosen = &figures.chosen_by;
    println!("chosen by          model {}, standby {}, fallback {}", chosen.model, chosen.standby, chosen.fallback);
    let (most, left_out) = (figures.candidates_max, figures.candidates_left_out);
    println!("candidates         at most {most} for a box, {left_out} left out");
    println!("over 40 ms         {} of {}", figures.over_budget, figures.placed + figures.set_aside);
    if figures.lost_reports > 0 {
        println!("reports lost       {}: the figures lack them", figures.lost_reports);
    }
    println!();
    let mut table = Table::new();
    table.load_style(presets::UTF8_HORIZONTAL_ONLY);
    table.set_header(["latency [us]", "count", "p50", "p99", "p99.9", "max"]);
    for (stage, row) in latency_rows(figures) {
        table.add_row(std::iter::once(stage.to_owned()).chain(row));
    }
    for column in table.column_iter_mut().skip(1) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    println!("{table}");
}

/// The latency table, in the order of a box's way.
pub(crate) fn latency_rows(figures: &Figures) -> impl Iterator<Item = (&'static str, [String; 5])> {
    let order =
        ["perception", "to_candidates", "candidates", "to_scorer", "scorer", "to_commander", "commander", "end_to_end"];
    order.into_iter().filter_map(|stage| {
        let s = figures.latency_us.get(stage)?;
        let us = |value: f64| format!("{value:.0}");
        Some((stage, [s.count.to_string(), us(s.p50), us(s.p99), us(s.p99_9), us(s.max)]))
    })
}

fn write_reports(args: &DemoArgs, config: &Config, session: &Session, figures: &Figures) -> anyhow::Result<()> {
    if let Some(path) = &args.json {
        page::write_file(path, &(serde_json::to_string_pretty(figures)? + "\n"))?;
    }
    if let Some(path) = &args.html {
        page::write_file(path, &page::demo(config, session, figures))?;
    }
    Ok(())
}
