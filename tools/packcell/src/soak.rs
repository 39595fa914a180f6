//! `packcell soak`: hours of boxes, and what became of every one of them.
//!
//! The soak watches the cell from outside: latencies come from the stamps in the cycle reports and count from when a
//! box was due, lost and doubled boxes are judged by the journal, and the rest is what the operating system says.

mod baseline;
mod faults;
mod figures;
mod incidents;
mod inflict;
mod latency;
mod ledger;
mod machine;
mod page;
mod place;
mod processes;
mod progress;
mod series;
mod watch;

use std::path::PathBuf;
use std::thread;
use std::time::Duration;

use anyhow::bail;
use messages::Instance;
use messages::topics::{CONTROL, Role};
use runtime::{Bus, Config, LogLevel, monotonic_ns};

use crate::args::{CellArgs, expected_boxes};
use crate::cell::Cell;
use crate::owner::act_as_owner;
use crate::page::write_file;
use crate::up::obey;
use faults::Schedule;
use figures::Figures;
use inflict::Hand;
use progress::Progress;
use watch::Watch;

pub(crate) use baseline::{BaselineArgs, run as run_baseline};

/// How often the cell is looked at.
const LOOK_NS: u64 = 10_000_000;

/// How long the cell may go without finishing a box, beyond its pace and the arm's motion [ns].
const STANDSTILL_NS: u64 = 30_000_000_000;

/// The budget from a box's due time to its command, unless --budget says another [ms].
const BUDGET_MS: u64 = 40;

#[derive(Debug, clap::Args)]
pub(crate) struct SoakArgs {
    #[command(flatten)]
    cell: CellArgs,
    /// Ends after so many boxes; without --boxes and --hours, at Ctrl-C
    #[arg(long, value_name = "N")]
    boxes: Option<u64>,
    /// Ends after so many hours
    #[arg(long, value_name = "H")]
    hours: Option<f64>,
    /// Boxes due each second, in place of --pace
    #[arg(long, value_name = "BOXES_PER_S", conflicts_with = "pace")]
    rate: Option<f64>,
    /// What happens to the cell: 'default', 'none', or a file; without it 'default', and 'none' with --attach
    #[arg(long, value_name = "FILE|none")]
    faults: Option<String>,
    /// Watches a cell that runs already, whose boxes are numbered without gaps; does only what can be done from outside
    #[arg(long, conflicts_with_all = ["data", "seed", "pace", "rate", "open", "policy", "model", "world", "scorers"])]
    attach: bool,
    /// Scorers that run side by side
    #[arg(long, value_name = "N", default_value_t = 1)]
    scorers: usize,
    /// Measures the machine beside the cell: a bare timer, and a bare ping over a bus
    #[arg(long)]
    baseline: bool,
    /// Fails if more than --late-max boxes are decided later than this after they were due, in milliseconds
    #[arg(long, value_name = "MS")]
    budget: Option<u64>,
    /// Boxes that may be over the budget
    #[arg(long, value_name = "N", default_value_t = 0, requires = "budget")]
    late_max: u64,
    /// Writes the report to this file: one page that shows without a network
    #[arg(long, value_name = "F.html")]
    report: Option<PathBuf>,
    /// Writes the figures to this file
    #[arg(long, value_name = "F.json")]
    json: Option<PathBuf>,
    /// Writes the percentile curve to this file
    #[arg(long, value_name = "F.svg")]
    svg: Option<PathBuf>,
}

pub(crate) fn run(args: &SoakArgs) -> anyhow::Result<()> {
    if args.hours.is_some_and(|hours| !(hours.is_finite() && hours > 0.0)) {
        bail!("--hours must be a number above 0");
    }
    if args.attach {
        let config = args.cell.running_config()?;
        if !config.bus.root_dir.join("iceoryx2.toml").exists() {
            bail!("no cell runs on the bus {}: start one with 'packcell up'", config.bus.root_dir.display());
        }
        act_as_owner(&config.bus)?;
        let schedule = Schedule::named(args.faults.as_deref().unwrap_or("none"), config.perception.seed)?;
        schedule.check_from_outside()?;
        return soak(args, &config, schedule, None);
    }
    let mut config = own_config(args)?;
    let schedule = Schedule::named(args.faults.as_deref().unwrap_or("default"), config.perception.seed)?;
    let bus = place::make(&mut config, args.cell.names_state())?;
    let scorers: Vec<Instance> = Instance::all().take(args.scorers).collect();
    if scorers.len() != args.scorers || scorers.is_empty() {
        bail!("--scorers must be from 1 to {}", Instance::all().count());
    }
    let done = soak(args, &config, schedule, Some(&scorers));
    drop(bus);
    done
}

/// What a cell of the soak's own runs with.
fn own_config(args: &SoakArgs) -> anyhow::Result<Config> {
    let mut config = args.cell.config()?;
    if !args.cell.names_pace() {
        config.perception.pace_ms = 0;
    }
    if let Some(rate) = args.rate {
        let pace_ms = (1000.0 / rate).round();
        if !(rate > 0.0 && pace_ms >= 1.0 && (1000.0 / pace_ms - rate).abs() < 0.01 * rate) {
            bail!("--rate {rate}: boxes come at whole milliseconds, so say 1000, 500, 250, 200, 125, 100, 50, 20, ...");
        }
        config.perception.pace_ms = pace_ms as u64;
    }
    if config.log.level == LogLevel::Info {
        config.log.level = LogLevel::Error;
    }
    config.perception.episodes = 0;
    expected_boxes(&mut config)?;
    Ok(config)
}

/// Watches the cell until the end, and reports. `scorers` are those of a cell of its own.
fn soak(args: &SoakArgs, config: &Config, schedule: Schedule, scorers: Option<&[Instance]>) -> anyhow::Result<()> {
    let bus = Bus::join(&config.bus, Role::Tool)?;
    let budget_ms = args.budget.unwrap_or(BUDGET_MS);
    let mut watch = Watch::new(&bus, config, budget_ms, scorers.is_some())?;
    let cell = scorers.map(|scorers| Cell::start(config, scorers, &bus)).transpose()?;
    let baseline = args.baseline.then(baseline::Measuring::start).transpose()?;
    watch.begin(baseline)?;
    let end = keep_watching(args, config, &bus, schedule, &mut watch, cell);
    let said = end.as_ref().map_or_else(|error| format!("{error:#}"), |end| (*end).to_owned());
    let (figures, story) = watch.finish(command_line(), said);
    progress::print(&figures);
    write_reports(args, config, &figures, &story)?;
    end?;
    match figures.verdict(args.budget.map(|_| args.late_max)) {
        Some(verdict) => bail!("{verdict}"),
        None => Ok(()),
    }
}

/// Looks after the cell until the soak is over; how it ended.
fn keep_watching(
    args: &SoakArgs,
    config: &Config,
    bus: &Bus,
    mut schedule: Schedule,
    watch: &mut Watch,
    mut cell: Option<Cell>,
) -> anyhow::Result<&'static str> {
    // Only one may wish on a bus, and in an attached cell that is whoever supervises it.
    let controls = cell.as_ref().map(|_| bus.subscriber(&CONTROL)).transpose()?;
    let mut hand = Hand::new(bus, config, config.perception.seed);
    let mut progress = Progress::new(args.boxes);
    let patience_ns = STANDSTILL_NS + (config.perception.pace_ms + config.perception.motion_ms) * 1_000_000;
    let ends_ns = args.hours.map(|hours| monotonic_ns() + (hours * 3.6e12) as u64);
    let is_finite = !schedule.is_empty();
    let end = loop {
        if bus.is_stopping() {
            break "interrupted";
        }
        if let Some(cell) = &mut cell {
            while let Some(control) = controls.as_ref().map(|wishes| wishes.receive()).transpose()?.flatten() {
                obey(&control, cell)?;
            }
            cell.tend()?;
        }
        let now = monotonic_ns();
        watch.look(now)?;
        for (number, note) in hand.go_on(now) {
            watch.incidents.end(number, note, now);
        }
        while let Some(fault) = schedule.due(watch.boxes(), watch.seconds(now)) {
            watch.inflict(&mut hand, fault, now);
        }
        progress.show(watch, now);
        if args.boxes.is_some_and(|boxes| watch.boxes() >= boxes) {
            break "all boxes";
        }
        if ends_ns.is_some_and(|ends_ns| now >= ends_ns) {
            break "all hours";
        }
        if args.boxes.is_none() && ends_ns.is_none() && is_finite && schedule.is_over() && watch.is_quiet() {
            break "all faults";
        }
        if watch.still_ns(now) > patience_ns {
            bail!("the cell stands still after {} boxes", watch.boxes());
        }
        let wake_ns = hand.wake_ns().map_or(now + LOOK_NS, |wake_ns| wake_ns.min(now + LOOK_NS));
        thread::sleep(Duration::from_nanos(wake_ns.saturating_sub(monotonic_ns())));
    };
    drop(hand);
    if let Some(cell) = cell {
        cell.stop()?;
    }
    // What was commanded last is in the journal by now.
    watch.look(monotonic_ns())?;
    Ok(end)
}

fn command_line() -> String {
    let words = std::env::args().map(|word| {
        let is_plain = !word.is_empty() && word.chars().all(|c| c.is_ascii_alphanumeric() || "-_./=,:".contains(c));
        if is_plain { word } else { format!("'{word}'") }
    });
    let mut words: Vec<String> = words.collect();
    if let Some(program) = words.first_mut() {
        "packcell".clone_into(program);
    }
    words.join(" ")
}

fn write_reports(args: &SoakArgs, config: &Config, figures: &Figures, story: &watch::Story) -> anyhow::Result<()> {
    if let Some(path) = &args.json {
        write_file(path, &(serde_json::to_string_pretty(figures)? + "\n"))?;
    }
    if let Some(path) = &args.svg {
        write_file(path, &report::standalone(&page::curve(figures, story)))?;
    }
    if let Some(path) = &args.report {
        write_file(path, &page::soak(config, figures, story))?;
    }
    Ok(())
}
