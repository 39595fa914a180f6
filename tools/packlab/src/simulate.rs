//! `packlab simulate`: what becomes of a packing plan when boxes are rigid bodies and the arm errs.

mod play;

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context as _;
use clap::Args;
use dataset::{DataSet, ReadOptions};
use packing::{ClosePolicy, ContainerSize, Rules, Support, WalleWeights};
use physical::{Fate, Imperfections};
use rayon::prelude::*;
use report::{Lying, Page, Table, isometric_lying};
use serde::Serialize;

use crate::method::{Method, Settings};
use crate::output;
use crate::source::{Episodes, Source};
use crate::trial::{self, Conditions};
use play::{Footing, PlayedBox, PlayedContainer, play};

/// Boxes known after the current one, as in a cell.
const LOOKAHEAD: usize = 2;

/// Most containers of one row that a page shows.
const PICTURES_MAX: usize = 6;

/// What is packed, how the arm errs, and what is written.
#[derive(Debug, Args)]
pub(crate) struct SimulateArgs {
    /// Data set: a name or a .json file.
    #[arg(long, default_value = "standard")]
    data: String,
    /// The method that makes the plan.
    #[arg(long, default_value = "walle-corners")]
    policy: String,
    /// Episodes.
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=dataset::EPISODES_MAX as i64))]
    episodes: u32,
    /// Seed of the boxes and of all errors.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Standard deviations of where the arm sets a box down, along each axis, in millimetres.
    #[arg(long, value_name = "MM", value_delimiter = ',', default_value = "0", value_parser = actuator_mm)]
    actuator: Vec<f64>,
    /// Standard deviation of how far the arm turns a box askew, in degrees.
    #[arg(long, value_name = "DEG", default_value = "0", value_parser = yaw_deg)]
    yaw: f64,
    /// What a box keeps free on each of its sides by the plan, in millimetres.
    #[arg(long, value_name = "MM", value_delimiter = ',', default_value = "0", value_parser = clap::value_parser!(u16).range(..=500))]
    clearance: Vec<u16>,
    /// What a box needs under its base by the plan: full or partial.
    #[arg(long, value_delimiter = ',', default_value = "full")]
    support: Vec<Support>,
    /// How hard the packed containers are shaken, in parts of gravity.
    #[arg(long, value_name = "G", default_value = "0.3", value_parser = shake_g)]
    shake: f64,
    /// Threads (one a core). The figures do not depend on it, the times do.
    #[arg(long, default_value_t = 0)]
    threads: usize,
    /// Write the figures as JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Write the figures, and pictures of containers as they lie, as a page.
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
}

/// What plans are made and played under.
#[derive(Clone, Copy, Debug)]
struct Setting {
    rules: Rules,
    actuator_mm: f64,
}

/// One episode as it was played.
struct Played {
    containers: Vec<PlayedContainer>,
    set_aside: usize,
    elapsed_s: f64,
}

/// What all episodes came to under one setting.
#[derive(Clone, Debug, Serialize)]
struct Row {
    support: String,
    clearance_mm: u16,
    actuator_mm: f64,
    containers: usize,
    set_aside: usize,
    shifted_share: f64,
    /// Boxes after which not all came to rest within ten seconds.
    restless: usize,
    /// All boxes, and then those of every footing that occurs.
    footings: Vec<Figures>,
    ms_per_box: f64,
}

/// What became of some boxes.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Figures {
    footing: &'static str,
    boxes: usize,
    collided_per_100: f64,
    moved_per_100: f64,
    tilted_per_100: f64,
    fell_per_100: f64,
}

/// The figures of a file.
#[derive(Serialize)]
struct Report<'a> {
    data: &'a str,
    policy: &'a str,
    episodes: usize,
    seed: u64,
    yaw_deg: f64,
    shake_g: f64,
    rows: &'a [Row],
}

/// Runs the command.
///
/// # Errors
/// Names what cannot be read, packed or written.
pub(crate) fn run(args: &SimulateArgs) -> anyhow::Result<()> {
    [&args.json, &args.html].into_iter().flatten().try_for_each(|path| output::check_folder(path))?;
    let method = Method::parse(&args.policy, &Settings { order: None, weights: WalleWeights::PAPER })?;
    let options = ReadOptions { container: ContainerSize::PAPER, skip_bad: false };
    let source = Source::load(&args.data, Some(args.episodes as usize), args.seed, Episodes::Test, &options)?;
    let settings = settings(args);
    let threads =
        rayon::ThreadPoolBuilder::new().num_threads(args.threads).build().context("no threads to work with")?;
    let played = threads.install(|| play_all(&source, &method, args, &settings))?;
    let rows: Vec<Row> = settings.iter().zip(&played).map(|(setting, played)| Row::of(setting, played)).collect();
    let set = &source.set;
    let about = format!(
        "{} on {}: {} episodes, seed {}, containers of {}; yaw {} degrees; shaken with {} g",
        method.name,
        set.name,
        set.episodes.len(),
        args.seed,
        set.container,
        args.yaw,
        args.shake
    );
    println!("{about}\n\n{}", text(&COLUMNS, rows.iter().map(Row::cells)));
    println!("\nby what a box stands on\n\n{}", text(&FOOTING_COLUMNS, rows.iter().flat_map(Row::footing_cells)));
    if let Some(path) = &args.json {
        let (data, policy, episodes) = (&*set.name, &*method.name, set.episodes.len());
        let (seed, yaw_deg, shake_g) = (args.seed, args.yaw, args.shake);
        let report = Report { data, policy, episodes, seed, yaw_deg, shake_g, rows: &rows };
        let json = serde_json::to_string_pretty(&report).context("the figures do not become JSON")?;
        output::write(path, &(json + "\n"))?;
    }
    if let Some(path) = &args.html {
        output::write(path, &page(&about, set, &rows, &played))?;
    }
    Ok(())
}

/// Every support with every clearance with every error.
fn settings(args: &SimulateArgs) -> Vec<Setting> {
    let with_errors = |rules: Rules| args.actuator.iter().map(move |&actuator_mm| Setting { rules, actuator_mm });
    let rules = args.support.iter().flat_map(|&support| {
        args.clearance.iter().map(move |&clearance_mm| Rules { support, clearance_mm, ..Rules::default() })
    });
    rules.flat_map(with_errors).collect()
}

/// All episodes under all settings, on all threads; what comes of them does not depend on how many there are.
fn play_all(
    source: &Source,
    method: &Method,
    args: &SimulateArgs,
    settings: &[Setting],
) -> anyhow::Result<Vec<Vec<Played>>> {
    let episodes = source.set.episodes.len();
    let jobs: Vec<_> = settings.iter().flat_map(|setting| (0..episodes).map(move |at| (setting, at))).collect();
    let play_one = |&(setting, episode): &(&Setting, usize)| play_episode(source, method, args, setting, episode);
    let mut played = jobs.par_iter().map(play_one).collect::<anyhow::Result<Vec<_>>>()?.into_iter();
    Ok(settings.iter().map(|_| played.by_ref().take(episodes).collect()).collect())
}

#[expect(clippy::disallowed_methods, reason = "the time of a box is one of the figures")]
fn play_episode(
    Source { set, slots }: &Source,
    method: &Method,
    args: &SimulateArgs,
    setting: &Setting,
    episode: usize,
) -> anyhow::Result<Played> {
    let conditions = Conditions {
        slots: *slots,
        close: ClosePolicy::Fullest,
        containers_max: u32::MAX,
        stop_at_misfit: false,
        rules: setting.rules,
        lookahead: LOOKAHEAD,
        seed: args.seed,
    };
    let plan = trial::plan(set, episode, method, &conditions)?;
    let imperfections = Imperfections {
        seed: args.seed + episode as u64,
        actuator_mm: setting.actuator_mm,
        yaw_deg: args.yaw,
        ..Imperfections::default()
    };
    let begun = Instant::now();
    let count = plan.iter().map(|placed| placed.container + 1).max().unwrap_or(0);
    let play_container = |container| {
        play(&trial::of_container(&plan, container), set.container, setting.rules, &imperfections, args.shake)
    };
    let containers = (0..count).map(play_container).collect::<Result<Vec<_>, _>>()?;
    let set_aside = set.episodes[episode].len() - plan.len();
    Ok(Played { containers, set_aside, elapsed_s: begun.elapsed().as_secs_f64() })
}

impl Row {
    fn of(setting: &Setting, played: &[Played]) -> Self {
        let Setting { rules: Rules { support, clearance_mm, .. }, actuator_mm } = *setting;
        let containers: Vec<&PlayedContainer> = played.iter().flat_map(|episode| &episode.containers).collect();
        let boxes: Vec<&PlayedBox> = containers.iter().flat_map(|container| &container.boxes).collect();
        let mut footings = vec![Figures::of("any", &boxes)];
        for footing in Footing::ALL {
            let such: Vec<_> = boxes.iter().filter(|played| played.footing == footing).copied().collect();
            if !such.is_empty() {
                footings.push(Figures::of(footing.name(), &such));
            }
        }
        let lying: usize = containers.iter().map(|container| container.lying.len()).sum();
        let shifted: usize = containers.iter().map(|container| container.shifted).sum();
        let elapsed_s: f64 = played.iter().map(|episode| episode.elapsed_s).sum();
        Self {
            support: support.to_string(),
            clearance_mm,
            actuator_mm,
            containers: containers.len(),
            set_aside: played.iter().map(|episode| episode.set_aside).sum(),
            shifted_share: shifted as f64 / lying.max(1) as f64,
            restless: containers.iter().map(|container| container.restless).sum(),
            footings,
            ms_per_box: 1e3 * elapsed_s / boxes.len().max(1) as f64,
        }
    }

    /// What the row is of.
    fn setting(&self) -> Vec<String> {
        vec![self.support.clone(), self.clearance_mm.to_string(), self.actuator_mm.to_string()]
    }

    fn cells(&self) -> Vec<String> {
        let mut cells = self.setting();
        cells.extend(self.footings.first().into_iter().flat_map(Figures::cells));
        cells.push(format!("{:.1}", 100.0 * self.shifted_share));
        cells.push(self.restless.to_string());
        cells.push(self.set_aside.to_string());
        cells.push(format!("{:.1}", self.ms_per_box));
        cells
    }

    fn footing_cells(&self) -> impl Iterator<Item = Vec<String>> {
        self.footings.iter().skip(1).map(|figures| {
            let mut cells = self.setting();
            cells.push(figures.footing.to_owned());
            cells.extend(figures.cells());
            cells
        })
    }
}

impl Figures {
    fn of(footing: &'static str, boxes: &[&PlayedBox]) -> Self {
        let per_100 = |is_such: fn(&PlayedBox) -> bool| {
            100.0 * boxes.iter().filter(|played| is_such(played)).count() as f64 / boxes.len().max(1) as f64
        };
        Self {
            footing,
            boxes: boxes.len(),
            collided_per_100: per_100(|played| played.collided),
            moved_per_100: per_100(|played| played.fate.moved),
            tilted_per_100: per_100(|played| played.fate.tilted),
            fell_per_100: per_100(|played| played.fate.fell),
        }
    }

    fn cells(&self) -> [String; 5] {
        let Self { boxes, collided_per_100, moved_per_100, tilted_per_100, fell_per_100, .. } = self;
        let per_100 = |value: &f64| format!("{value:.2}");
        [
            boxes.to_string(),
            per_100(collided_per_100),
            per_100(moved_per_100),
            per_100(tilted_per_100),
            per_100(fell_per_100),
        ]
    }
}

const COLUMNS: [&str; 12] = [
    "support",
    "clearance [mm]",
    "arm [mm]",
    "boxes",
    "collided per 100",
    "moved per 100",
    "tilted per 100",
    "fell per 100",
    "shifted [%]",
    "restless",
    "set aside",
    "ms a box",
];

const FOOTING_COLUMNS: [&str; 9] = [
    "support",
    "clearance [mm]",
    "arm [mm]",
    "stands on",
    "boxes",
    "collided per 100",
    "moved per 100",
    "tilted per 100",
    "fell per 100",
];

fn text(columns: &[&str], rows: impl Iterator<Item = Vec<String>>) -> String {
    let mut table = comfy_table::Table::new();
    table.load_style(comfy_table::presets::ASCII_MARKDOWN);
    table.set_header(columns);
    for row in rows {
        table.add_row(row);
    }
    table.to_string()
}

fn page(about: &str, set: &DataSet, rows: &[Row], played: &[Vec<Played>]) -> String {
    let mut page = Page::new("Packing plans played with rigid bodies", about);
    page.text(
        "Every box is lowered straight down, where the arm brings it, and let go at the first thing that it touches; then \
         all boxes of its container come to rest. Collided: that was another box more than 5 mm above where it was to \
         stand. Moved: its middle was more than 5 mm aside of where it was let go, at any time until its container was \
         full. Tilted: more than 5 degrees. Fell: it came down by more than half its height, or over a wall. A box counts \
         under all that it did.",
    );
    let mut table = Table::new(COLUMNS);
    rows.iter().for_each(|row| table.row(row.cells()));
    page.table(&table);
    page.text(
        "Shifted: every full container is accelerated sideways for half a second in each of the four directions, each time \
         from how its boxes lie, and such a box ends more than 20 mm from where it lay or leaves the container. Restless: \
         boxes after which not all lay still within ten seconds.",
    );
    page.section("By what a box stands on");
    let mut table = Table::new(FOOTING_COLUMNS);
    rows.iter().flat_map(Row::footing_cells).for_each(|cells| table.row(cells));
    page.table(&table);
    for (row, played) in rows.iter().zip(played) {
        let Some(first) = played.first() else { continue };
        let (support, clearance_mm, actuator_mm) = (&row.support, row.clearance_mm, row.actuator_mm);
        page.section(&format!("Episode 0, {support} support, {clearance_mm} mm clearance, arm {actuator_mm} mm"));
        let mut order: Vec<_> = first.containers.iter().enumerate().collect();
        order.sort_by_key(|(_, container)| std::cmp::Reverse(container.askew()));
        page.gallery(order.iter().take(PICTURES_MAX).map(|(number, container)| {
            let lying: Vec<_> = container.lying.iter().map(drawn).collect();
            let (boxes, left, askew) = (container.boxes.len(), lying.len(), container.askew());
            let caption =
                format!("container {number}: {boxes} boxes, {askew} moved, tilted or fell, {left} still in it");
            (isometric_lying(set.container, &lying), caption)
        }));
    }
    page.to_html()
}

impl PlayedContainer {
    /// Boxes that do not lie where they were let go.
    fn askew(&self) -> usize {
        self.boxes.iter().filter(|played| played.fate != Fate::default()).count()
    }
}

fn drawn(lying: &physical::Lying) -> Lying {
    let [length_mm, breadth_mm, height_mm] = lying.half_mm.map(|half_mm| (2.0 * half_mm).round());
    let about = format!("{length_mm} x {breadth_mm} x {height_mm} mm, tilted by {:.1} degrees", lying.tilt_deg());
    Lying { box_id: lying.box_id, about, corners_mm: lying.corners_mm() }
}

/// A number of a flag that must lie from 0 to `most`.
fn number(text: &str, most: f64, unit: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "it is not a number".to_owned())?;
    if (0.0..=most).contains(&value) { Ok(value) } else { Err(format!("it must be 0 to {most} {unit}")) }
}

fn actuator_mm(text: &str) -> Result<f64, String> {
    number(text, 500.0, "mm")
}

fn yaw_deg(text: &str) -> Result<f64, String> {
    number(text, 15.0, "degrees")
}

fn shake_g(text: &str) -> Result<f64, String> {
    number(text, 2.0, "g")
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    struct Command {
        #[command(flatten)]
        args: SimulateArgs,
    }

    fn args(flags: &[&str]) -> Result<SimulateArgs, String> {
        let command = Command::try_parse_from(["simulate"].iter().chain(flags));
        command.map(|command| command.args).map_err(|error| error.to_string())
    }

    /// The rows of one episode with `three` containers, without their times.
    fn rows(threads: usize) -> Vec<Row> {
        let flags = ["--data", "three", "--episodes", "2", "--actuator", "0,8", "--support", "full,partial"];
        let args = args(&flags).unwrap();
        let method = Method::parse(&args.policy, &Settings { order: None, weights: WalleWeights::PAPER }).unwrap();
        let options = ReadOptions { container: ContainerSize::PAPER, skip_bad: false };
        let source = Source::load(&args.data, Some(2), 1, Episodes::Test, &options).unwrap();
        let settings = settings(&args);
        let threads = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let played = threads.install(|| play_all(&source, &method, &args, &settings)).unwrap();
        settings
            .iter()
            .zip(&played)
            .map(|(setting, played)| Row { ms_per_box: 0.0, ..Row::of(setting, played) })
            .collect()
    }

    #[test]
    fn the_figures_do_not_depend_on_the_threads() {
        let (one, two) = (rows(1), rows(2));
        assert_eq!(serde_json::to_string(&one).unwrap(), serde_json::to_string(&two).unwrap());
        let [perfect, noisy, partial, _] = &one[..] else { panic!("four settings") };
        let Figures { boxes, collided_per_100, moved_per_100, tilted_per_100, fell_per_100, .. } = perfect.footings[0];
        assert!(boxes > 50);
        assert_eq!([collided_per_100, moved_per_100, tilted_per_100, fell_per_100], [0.0; 4], "a perfect arm");
        assert!(noisy.footings[0].collided_per_100 > 10.0, "8 mm without clearance: {noisy:?}");
        assert_eq!(perfect.footings.len(), 2, "on full support there is one footing");
        assert!(partial.footings.len() > 2, "{partial:?}");
    }

    #[test]
    fn bad_flags_are_refused_with_a_reason() {
        for (flags, reason) in [
            (["--actuator", "-1"], "it must be 0 to 500 mm"),
            (["--actuator", "nan"], "it must be 0 to 500 mm"),
            (["--actuator", "5,much"], "it is not a number"),
            (["--yaw", "16"], "it must be 0 to 15 degrees"),
            (["--shake", "inf"], "it must be 0 to 2 g"),
            (["--clearance", "501"], "501 is not in"),
            (["--support", "half"], "there is no support rule \"half\""),
            (["--episodes", "0"], "0 is not in"),
        ] {
            let flags = [&format!("{}={}", flags[0], flags[1])[..]];
            let message = args(&flags).unwrap_err();
            assert!(message.contains(reason), "{flags:?}: {message}");
        }
    }
}
