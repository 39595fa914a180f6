//! The figures of an evaluation as text, JSON and a page.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use anyhow::Context as _;
use comfy_table::{CellAlignment, presets};
use packing::Rules;
use report::{Page, Table, box_plot_groups, box_plots, isometric, standalone};
use serde::Serialize;

use crate::evaluate::Evaluated;
use crate::method::Method;
use crate::published::{self, AH_REMARK};
use crate::trial::{self, Trial};

/// Most containers of the packed episode that are drawn.
const PICTURES_MAX: u32 = 32;

/// Refuses a file that could not be written, before the work is done.
pub(crate) fn check_folder(path: &Path) -> anyhow::Result<()> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    anyhow::ensure!(folder.is_dir(), "{} cannot be written: there is no folder {}", path.display(), folder.display());
    Ok(())
}

pub(crate) fn write(path: &Path, text: &str) -> anyhow::Result<()> {
    fs::write(path, text).with_context(|| format!("{} cannot be written", path.display()))
}

/// The tables as they are printed.
pub(crate) fn text(evaluated: &[Evaluated]) -> String {
    let mut text = String::new();
    for set in evaluated {
        let mut table = comfy_table::Table::new();
        table.load_style(presets::ASCII_MARKDOWN);
        let columns = columns(set);
        table.set_header(&columns);
        lines(set).into_iter().for_each(|line| {
            table.add_row(line.cells);
        });
        table.column_iter_mut().skip(1).for_each(|column| column.set_cell_alignment(CellAlignment::Right));
        let _ = writeln!(text, "{}\n{table}", about(set));
        if lines(set).iter().any(|line| line.quoted) {
            let _ = writeln!(text, "{AH_REMARK}");
        }
        text.push('\n');
    }
    text.truncate(text.trim_end().len());
    text
}

/// One line that says what a table is about.
fn about(evaluated: &Evaluated) -> String {
    let Evaluated { set, conditions, .. } = evaluated;
    let boxes: usize = set.episodes.iter().map(Vec::len).sum();
    let mut about = format!(
        "{}: {} episodes, {boxes} boxes, containers of {}, {} open, {} support",
        set.name,
        set.episodes.len(),
        set.container,
        conditions.slots,
        conditions.rules.support
    );
    if let Some(optimum) = set.optimum {
        let _ = write!(about, ", optimum {optimum}");
    }
    let Rules { clearance_mm, level_mm, .. } = conditions.rules;
    if (clearance_mm, level_mm) != (0, 0) {
        let _ = write!(about, ", clearance {clearance_mm} mm, level within {level_mm} mm");
    }
    if conditions.stop_at_misfit {
        about.push_str(", until the first box that does not fit");
    }
    let skipped = set.skipped;
    if skipped.boxes + skipped.episodes > 0 {
        let _ = write!(about, " (skipped {} unusable boxes and {} empty episodes)", skipped.boxes, skipped.episodes);
    }
    about
}

/// A row of a table; quoted rows are the paper's.
struct Line {
    cells: Vec<String>,
    quoted: bool,
}

fn columns(evaluated: &Evaluated) -> Vec<String> {
    let fill = evaluated.set.optimum.map_or("fill".to_owned(), |optimum| format!("fill of first {optimum}"));
    ["method", "c", "containers", &fill, "utilisation", "boxes packed", "best", "p50 [us]", "p99 [us]"]
        .map(str::to_owned)
        .to_vec()
}

fn lines(evaluated: &Evaluated) -> Vec<Line> {
    let is_published = evaluated.set.name == published::DATA;
    let mut lines = Vec::new();
    for trial in &evaluated.trials {
        lines.push(Line { cells: cells(trial), quoted: false });
        lines.extend(published::row_of(&trial.method).filter(|_| is_published).map(quote));
    }
    lines
}

fn cells(trial: &Trial) -> Vec<String> {
    let none = || "-".to_owned();
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    let fill: Option<Vec<f64>> = trial.outcomes.iter().map(|outcome| outcome.fill).collect();
    vec![
        trial.method.clone(),
        trial.competitive_ratio().map_or_else(none, |(mean, stderr)| format!("{mean:.3} ± {stderr:.3}")),
        format!("{:.2}", trial.mean(|outcome| f64::from(outcome.containers_used))),
        fill.map_or_else(none, |_| percent(trial.mean(|outcome| outcome.fill.unwrap_or(0.0)))),
        percent(trial.mean(|outcome| outcome.utilisation)),
        format!("{:.1}", trial.mean(|outcome| outcome.placed as f64)),
        format!("{:.0} %", 100.0 * trial.best_share()),
        format!("{:.1}", trial.us_p50),
        format!("{:.1}", trial.us_p99),
    ]
}

fn quote(row: &published::Published) -> Line {
    let or_none = |value: Option<String>| value.unwrap_or_else(|| "-".to_owned());
    let cells = vec![
        format!("paper: {}", row.name),
        format!("{:.2}", row.c),
        "-".to_owned(),
        or_none(row.fill_percent.map(|fill| format!("{fill:.1} %"))),
        "-".to_owned(),
        "-".to_owned(),
        or_none(row.best_percent.map(|best| format!("{best} %"))),
        or_none(row.time_us.map(|time| format!("{time} (mean)"))),
        "-".to_owned(),
    ];
    Line { cells, quoted: true }
}

#[derive(Serialize)]
struct Figures<'a> {
    seed: u64,
    sets: Vec<SetFigures<'a>>,
}

#[derive(Serialize)]
struct SetFigures<'a> {
    name: &'a str,
    episodes: usize,
    boxes: usize,
    optimum: Option<u32>,
    open: usize,
    support: String,
    clearance_mm: u16,
    level_mm: u16,
    skipped_boxes: usize,
    skipped_episodes: usize,
    methods: Vec<MethodFigures<'a>>,
}

#[derive(Serialize)]
struct MethodFigures<'a> {
    name: &'a str,
    c_mean: Option<f64>,
    c_stderr: Option<f64>,
    containers_mean: f64,
    fill_first_opt: Option<f64>,
    utilisation: f64,
    boxes_packed_mean: f64,
    set_aside_mean: f64,
    best_share: f64,
    us_p50: f64,
    us_p99: f64,
}

/// The figures as JSON: the same for the same seed, byte for byte, except the times.
pub(crate) fn json(seed: u64, evaluated: &[Evaluated]) -> anyhow::Result<String> {
    let sets = evaluated.iter().map(|Evaluated { set, conditions, trials }| SetFigures {
        name: &set.name,
        episodes: set.episodes.len(),
        boxes: set.episodes.iter().map(Vec::len).sum(),
        optimum: set.optimum,
        open: conditions.slots,
        support: conditions.rules.support.to_string(),
        clearance_mm: conditions.rules.clearance_mm,
        level_mm: conditions.rules.level_mm,
        skipped_boxes: set.skipped.boxes,
        skipped_episodes: set.skipped.episodes,
        methods: trials.iter().map(method_figures).collect(),
    });
    let figures = Figures { seed, sets: sets.collect() };
    Ok(serde_json::to_string_pretty(&figures).context("the figures do not become JSON")? + "\n")
}

fn method_figures(trial: &Trial) -> MethodFigures<'_> {
    let ratio = trial.competitive_ratio();
    MethodFigures {
        name: &trial.method,
        c_mean: ratio.map(|(mean, _)| mean),
        c_stderr: ratio.map(|(_, stderr)| stderr),
        containers_mean: trial.mean(|outcome| f64::from(outcome.containers_used)),
        fill_first_opt: ratio.map(|_| trial.mean(|outcome| outcome.fill.unwrap_or(0.0))),
        utilisation: trial.mean(|outcome| outcome.utilisation),
        boxes_packed_mean: trial.mean(|outcome| outcome.placed as f64),
        set_aside_mean: trial.mean(|outcome| outcome.set_aside as f64),
        best_share: trial.best_share(),
        us_p50: trial.us_p50,
        us_p99: trial.us_p99,
    }
}

/// Box plots of every method on every set, as a picture of its own.
pub(crate) fn svg(evaluated: &[Evaluated], methods: &[Method]) -> String {
    if let [set] = evaluated {
        return standalone(&box_plots(&goodness_name(set), &named_goodness(set)));
    }
    let names: Vec<_> = methods.iter().map(|method| method.name.as_str()).collect();
    let boxes = |set: &Evaluated| set.trials.iter().map(goodness_percent).collect();
    let groups: Vec<_> = evaluated.iter().map(|set| (set.set.name.as_str(), boxes(set))).collect();
    standalone(&box_plot_groups(goodness_name_of_all(evaluated), &names, &groups))
}

/// The figures, charts and one packed episode as a page.
pub(crate) fn html(evaluated: &[Evaluated], methods: &[Method]) -> anyhow::Result<String> {
    let names: Vec<_> = evaluated.iter().map(|evaluated| evaluated.set.name.as_str()).collect();
    let mut page = Page::new("Packing methods compared", &format!("packlab evaluate: {}", names.join(", ")));
    for set in evaluated {
        page.section(&set.set.name);
        page.text(&about(set));
        page.table(&html_table(set));
        if lines(set).iter().any(|line| line.quoted) {
            page.text(AH_REMARK);
        }
        page.figure(
            &box_plots(&goodness_name(set), &named_goodness(set)),
            &format!("{}, episode by episode", goodness_name(set)),
        );
    }
    if evaluated.len() > 1 {
        page.section("From set to set");
        page.gallery_wide(methods.iter().enumerate().map(|(index, method)| {
            let series: Vec<_> =
                evaluated.iter().map(|set| (set.set.name.clone(), goodness_percent(&set.trials[index]))).collect();
            (box_plots(goodness_name_of_all(evaluated), &series), method.name.clone())
        }));
    }
    if let Some(set) = evaluated.first() {
        push_pictures(&mut page, set, methods)?;
    }
    Ok(page.to_html())
}

fn html_table(evaluated: &Evaluated) -> Table {
    let mut table = Table::new(columns(evaluated));
    for line in lines(evaluated) {
        if line.quoted { table.quoted_row(line.cells) } else { table.row(line.cells) }
    }
    table
}

/// What box plots of several sets measure.
fn goodness_name_of_all(evaluated: &[Evaluated]) -> &'static str {
    let known = evaluated.iter().filter(|set| set.set.optimum.is_some()).count();
    match known {
        0 => "utilisation of all containers [%]",
        _ if known == evaluated.len() => "fill of the first Opt containers [%]",
        _ => "fill of the first Opt containers, or utilisation [%]",
    }
}

fn named_goodness(evaluated: &Evaluated) -> Vec<(String, Vec<f64>)> {
    evaluated.trials.iter().map(|trial| (trial.method.clone(), goodness_percent(trial))).collect()
}

fn goodness_name(evaluated: &Evaluated) -> String {
    match evaluated.set.optimum {
        Some(optimum) => format!("fill of the first {optimum} containers [%]"),
        None => "utilisation of all containers [%]".to_owned(),
    }
}

fn goodness_percent(trial: &Trial) -> Vec<f64> {
    (0..trial.outcomes.len()).map(|episode| 100.0 * trial.goodness(episode)).collect()
}

/// The first episode as the method packs it that is best on average.
fn push_pictures(page: &mut Page, evaluated: &Evaluated, methods: &[Method]) -> anyhow::Result<()> {
    let Evaluated { set, conditions, trials } = evaluated;
    let mean = |trial: &Trial| goodness_percent(trial).iter().sum::<f64>();
    let best = methods.iter().zip(trials).max_by(|(_, a), (_, b)| mean(a).total_cmp(&mean(b)));
    let Some((method, _)) = best else { return Ok(()) };
    let placed = trial::plan(set, 0, method, conditions)?;
    page.section(&format!("Episode 0 of {}, packed by {}", set.name, method.name));
    let containers = placed.iter().map(|placed| placed.container + 1).max().unwrap_or(0);
    page.gallery((0..containers.min(PICTURES_MAX)).map(|container| {
        let boxes = trial::of_container(&placed, container);
        (isometric(set.container, conditions.rules, &boxes), format!("container {container}: {} boxes", boxes.len()))
    }));
    Ok(())
}
