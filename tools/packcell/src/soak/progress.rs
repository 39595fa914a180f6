//! What a soak says on the terminal: while it runs, and at its end.

use std::io::{IsTerminal as _, stderr};

use comfy_table::{CellAlignment, Table, presets};
use indicatif::{ProgressBar, ProgressStyle};

use super::figures::Figures;
use super::latency::Percentiles;
use super::watch::Watch;
use crate::latency::STAGES;

/// How often the state is said on a terminal, and in a log [ns].
const TERMINAL_NS: u64 = 500_000_000;
const LOG_NS: u64 = 30_000_000_000;

/// One line that says how far it is.
#[derive(Debug)]
pub(crate) struct Progress {
    /// Nothing where nobody watches; then a line is printed now and then.
    bar: Option<ProgressBar>,
    due_ns: u64,
    /// Boxes and seconds when it was said last.
    before: (u64, f64),
}

impl Progress {
    pub(crate) fn new(boxes: Option<u64>) -> Self {
        let bar = stderr().is_terminal().then(|| {
            let template = if boxes.is_some() { "{wide_bar} {pos}/{len}\n{msg}" } else { "{msg}" };
            let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
            boxes.map_or_else(ProgressBar::no_length, ProgressBar::new).with_style(style)
        });
        Self { bar, due_ns: 0, before: (0, 0.0) }
    }

    /// Says how far it is, if that is due.
    pub(crate) fn show(&mut self, watch: &Watch, now_ns: u64) {
        if now_ns < self.due_ns {
            return;
        }
        self.due_ns = now_ns + if self.bar.is_some() { TERMINAL_NS } else { LOG_NS };
        let (boxes, seconds) = (watch.boxes(), watch.seconds(now_ns));
        let rate = (boxes - self.before.0) as f64 / (seconds - self.before.1).max(1e-9);
        self.before = (boxes, seconds);
        let latency = watch.latencies.end_to_end.percentiles();
        let line = format!(
            "{seconds:7.0} s  {boxes} boxes  {rate:.0}/s  p50 {}  p99 {}  max {}  late {}  faults {}",
            ms(latency.p50),
            ms(latency.p99),
            ms(latency.max),
            watch.latencies.over_budget,
            watch.incidents.count,
        );
        match &self.bar {
            Some(bar) => {
                bar.set_position(boxes);
                bar.set_message(line);
            }
            None => println!("{line}"),
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

fn ms(us: u64) -> String {
    format!("{:.1} ms", us as f64 / 1000.0)
}

/// The rows of the latency table, in the order of a box's way, and the baseline's under them.
pub(crate) fn latency_rows(figures: &Figures) -> Vec<(String, Percentiles)> {
    let stages = STAGES.iter().map(|(name, _)| *name).chain(["end_to_end"]);
    let of_stage = |name: &str| Some((name.to_owned(), *figures.latency_us.get(name)?));
    let mut rows: Vec<_> = stages.filter_map(of_stage).collect();
    if let Some(baseline) = &figures.baseline {
        rows.push(("bare timer".to_owned(), baseline.timer_us));
        rows.push(("bare ping, there and back".to_owned(), baseline.ping_us));
    }
    rows
}

/// The columns of the latency table.
pub(crate) const LATENCY_COLUMNS: [&str; 9] =
    ["latency [us]", "count", "p50", "p90", "p99", "p99.9", "p99.99", "p99.999", "max"];

pub(crate) fn cells(of: &Percentiles) -> [String; 8] {
    [of.count, of.p50, of.p90, of.p99, of.p99_9, of.p99_99, of.p99_999, of.max].map(|value| value.to_string())
}

/// What the whole soak was, in facts: the terminal and the page say the same.
pub(crate) fn facts(figures: &Figures) -> Vec<(&'static str, String)> {
    let chosen = |by: &str| figures.chosen_by.get(by).copied().unwrap_or_default();
    let mut facts = vec![
        ("boxes", format!("{} in {:.0} s, {:.0} a second", figures.boxes, figures.seconds, figures.boxes_per_s)),
        ("lost", figures.lost.to_string()),
        ("doubled", figures.doubled.to_string()),
        ("late", format!("{} over {} ms", figures.over_budget, figures.budget_ms)),
        (
            "chosen by",
            format!(
                "model {}, standby {}, fallback {}, rules {}",
                chosen("model"),
                chosen("standby"),
                chosen("fallback"),
                chosen("rules")
            ),
        ),
        ("set aside", figures.set_aside.to_string()),
        ("containers replaced", figures.containers_replaced.to_string()),
        ("refused", format!("{} messages, {} orders", figures.messages_refused, figures.orders_refused)),
        ("restarts", figures.restarts.values().sum::<u64>().to_string()),
        ("faults", figures.faults_count.to_string()),
        (
            "candidates",
            format!("at most {} for a box, {} left out", figures.candidates_max, figures.candidates_left_out),
        ),
    ];
    if let Some(with_baseline) = figures.over_budget_with_baseline {
        facts.push(("late when the bare machine was", with_baseline.to_string()));
    }
    if figures.bounded > 0 {
        facts.push((
            "stamps lost with a commander",
            format!("{}: they count to the motion or the report", figures.bounded),
        ));
    }
    if figures.lost_reports > 0 {
        facts.push(("reports lost", format!("{}: the latencies lack them", figures.lost_reports)));
    }
    if figures.unseen > 0 {
        facts.push(("orders not judged", figures.unseen.to_string()));
    }
    facts.push(("ended", figures.end.clone()));
    facts
}

/// Prints what was measured.
pub(crate) fn print(figures: &Figures) {
    for (what, value) in facts(figures) {
        println!("{what:<30} {value}");
    }
    println!();
    let mut table = table(&LATENCY_COLUMNS);
    for (stage, percentiles) in latency_rows(figures) {
        table.add_row(std::iter::once(stage).chain(cells(&percentiles)));
    }
    println!("{table}");
    if !figures.faults_by_kind.is_empty() {
        println!("{}", fault_table(figures));
    }
    let mut table = self::table(&PROCESS_COLUMNS);
    for row in process_rows(figures) {
        table.add_row(row);
    }
    println!("{table}");
}

fn fault_table(figures: &Figures) -> Table {
    let mut table = table(&FAULT_COLUMNS);
    for row in fault_rows(figures) {
        table.add_row(row);
    }
    table
}

/// The columns of the table of faults.
pub(crate) const FAULT_COLUMNS: [&str; 7] = [
    "fault",
    "target",
    "count",
    "failed",
    "boxes late",
    "slowest box [ms] p50, p99, max",
    "back after [ms] p50, p99, max",
];

pub(crate) fn fault_rows(figures: &Figures) -> impl Iterator<Item = [String; 7]> {
    let three = |[p50, p99, max]: [f64; 3]| format!("{p50:.1}, {p99:.1}, {max:.1}");
    figures.faults_by_kind.iter().map(move |sum| {
        let back = match (sum.back_ms, sum.not_back) {
            (Some(back), 0) => three(back),
            (Some(back), missing) => format!("{} ({missing} not back)", three(back)),
            (None, 0) => "-".to_owned(),
            (None, missing) => format!("{missing} not back"),
        };
        [
            sum.kind.to_owned(),
            sum.target.to_owned(),
            sum.count.to_string(),
            sum.failed.to_string(),
            sum.boxes_late.to_string(),
            three(sum.worst_ms),
            back,
        ]
    })
}

/// The columns of the table of processes.
pub(crate) const PROCESS_COLUMNS: [&str; 11] = [
    "process",
    "restarts",
    "refused",
    "memory [MiB]",
    "growth [KiB/h]",
    "open files",
    "shared [MiB]",
    "CPU a box [us]",
    "waited for a CPU",
    "page faults after warm-up",
    "of a disk",
];

pub(crate) fn process_rows(figures: &Figures) -> impl Iterator<Item = [String; 11]> {
    let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
    figures.processes.iter().map(move |process| {
        [
            process.name.clone(),
            process.restarts.to_string(),
            process.refused.to_string(),
            format!("{:.2} to {:.2}", mib(process.rss_start), mib(process.rss_end)),
            process.rss_slope.map_or_else(|| "-".to_owned(), |slope| format!("{:+.0}", slope / 1024.0)),
            format!("{} to {}", process.fds_start, process.fds_end),
            format!("{:.2}", mib(process.shm_bytes)),
            format!("{:.0}", process.cpu_us_per_box),
            format!("{:.1} %", 100.0 * process.waited_share),
            process.page_faults.to_string(),
            process.major_faults.to_string(),
        ]
    })
}

fn table(columns: &[&str]) -> Table {
    let mut table = Table::new();
    table.load_style(presets::UTF8_HORIZONTAL_ONLY);
    table.set_header(columns.iter().copied());
    for column in table.column_iter_mut().skip(1) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    table
}
