//! `packlab study`: questions that one command answers.

mod loading;

use std::path::PathBuf;

use anyhow::Context as _;
use clap::{Args, Subcommand};
use dataset::ReadOptions;
use packing::{BoxSpec, ContainerSize};
use rayon::prelude::*;
use report::{Page, Table};
use serde::Serialize;

use crate::method::{Method, Settings};
use crate::output;
use crate::source::{Episodes, Source};
use loading::{Loaded, World};

/// The standard deviations of the arm's error [mm].
const ACTUATOR_MM: [f64; 5] = [0.0, 2.0, 5.0, 10.0, 20.0];

/// What a box keeps free on each side [mm].
const CLEARANCE_MM: [u16; 4] = [0, 5, 10, 20];

/// The standard deviations of the camera's errors [mm]; nothing for no camera.
const CAMERA_MM: [Option<f64>; 4] = [None, Some(1.0), Some(5.0), Some(10.0)];

/// A study.
#[derive(Debug, Args)]
pub(crate) struct StudyArgs {
    #[command(subcommand)]
    study: Study,
}

#[derive(Debug, Subcommand)]
enum Study {
    /// What boxes that do not land where they are told to cost, against clearance and a camera.
    Robustness(RobustnessArgs),
}

#[derive(Debug, Args)]
struct RobustnessArgs {
    /// Data set: a name or a .json file.
    #[arg(long, default_value = "standard")]
    data: String,
    /// The method that places the boxes.
    #[arg(long, default_value = "walle-corners")]
    policy: String,
    /// Episodes.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=dataset::EPISODES_MAX as i64))]
    episodes: u32,
    /// Seed of the boxes and of all errors.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Write the figures as JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Write the figures as a page.
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
}

/// What all episodes came to under one set of conditions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
struct Row {
    actuator_mm: f64,
    clearance_mm: u16,
    camera_mm: Option<f64>,
    c_mean: Option<f64>,
    fill: Option<f64>,
    collisions_per_100: f64,
    corrections_per_100: f64,
    alarms_per_100: f64,
    /// Share of the episodes without a collision [-].
    clean_share: f64,
    set_aside: usize,
}

/// Runs the command.
///
/// # Errors
/// Names what cannot be read, packed or written.
pub(crate) fn run(args: &StudyArgs) -> anyhow::Result<()> {
    match &args.study {
        Study::Robustness(args) => robustness(args),
    }
}

fn robustness(args: &RobustnessArgs) -> anyhow::Result<()> {
    [&args.json, &args.html].into_iter().flatten().try_for_each(|path| output::check_folder(path))?;
    let method = Method::parse(&args.policy, &Settings { order: None, weights: packing::WalleWeights::PAPER })?;
    let options = ReadOptions { container: ContainerSize::PAPER, skip_bad: false };
    let Source { set, slots } =
        Source::load(&args.data, Some(args.episodes as usize), args.seed, Episodes::Test, &options)?;
    let conditions: Vec<_> = CLEARANCE_MM
        .into_iter()
        .flat_map(|clearance| ACTUATOR_MM.map(|actuator| (clearance, actuator)))
        .flat_map(|(clearance, actuator)| CAMERA_MM.map(|camera| (clearance, actuator, camera)))
        .collect();
    let load = |&(clearance_mm, actuator_mm, camera_mm): &(u16, f64, Option<f64>)| -> anyhow::Result<Row> {
        let mut loaded = Vec::new();
        for (episode, boxes) in set.episodes.iter().enumerate() {
            let boxes = numbered(boxes)?;
            let extents: Vec<_> = boxes.iter().map(|spec| spec.extent(set.container.cell_mm())).collect();
            let mut chooser = method.chooser(args.seed, episode)?;
            let mut failure = None;
            let world = World { seed: args.seed + episode as u64, actuator_mm, clearance_mm, camera_mm };
            let choose = |grid: &packing::Grid, extent, index: usize| {
                let upcoming = &extents[index + 1..(index + 3).min(extents.len())];
                chooser(grid, extent, upcoming).unwrap_or_else(|error| {
                    failure = Some(error);
                    None
                })
            };
            loaded.push(world.load(set.container, slots, &boxes, set.optimum, choose)?);
            if let Some(error) = failure {
                return Err(error.context(format!("{} failed in episode {episode}", method.name)));
            }
        }
        let boxes = set.episodes.iter().map(Vec::len).sum();
        Ok(Row::of(clearance_mm, actuator_mm, camera_mm, &loaded, boxes))
    };
    let rows = conditions.par_iter().map(load).collect::<anyhow::Result<Vec<_>>>()?;
    let about = format!(
        "{} on {}: {} episodes, seed {}, containers of {}, {slots} open",
        method.name,
        set.name,
        set.episodes.len(),
        args.seed,
        set.container
    );
    println!("{about}\n{}", text(&rows));
    if let Some(path) = &args.json {
        let json = serde_json::to_string_pretty(&rows).context("the figures do not become JSON")?;
        output::write(path, &(json + "\n"))?;
    }
    if let Some(path) = &args.html {
        output::write(path, &page(&about, &rows))?;
    }
    Ok(())
}

/// The boxes with identities of their own, by which their errors are drawn.
fn numbered(boxes: &[BoxSpec]) -> Result<Vec<BoxSpec>, packing::BoxError> {
    (1..).zip(boxes).map(|(id, spec)| BoxSpec::new(id, spec.size_mm())).collect()
}

impl Row {
    fn of(clearance_mm: u16, actuator_mm: f64, camera_mm: Option<f64>, loaded: &[Loaded], boxes: usize) -> Self {
        let mean = |figure: fn(&Loaded) -> Option<f64>| {
            let known: Vec<f64> = loaded.iter().filter_map(figure).collect();
            (!known.is_empty()).then(|| known.iter().sum::<f64>() / known.len() as f64)
        };
        let per_100 = |count: fn(&Loaded) -> u32| {
            100.0 * loaded.iter().map(|one| f64::from(count(one))).sum::<f64>() / boxes.max(1) as f64
        };
        let clean = loaded.iter().filter(|one| one.collisions == 0).count();
        Self {
            actuator_mm,
            clearance_mm,
            camera_mm,
            c_mean: mean(|one| one.outcome.competitive_ratio),
            fill: mean(|one| one.outcome.fill),
            collisions_per_100: per_100(|one| one.collisions),
            corrections_per_100: per_100(|one| one.corrections),
            alarms_per_100: per_100(|one| one.alarms),
            clean_share: clean as f64 / loaded.len().max(1) as f64,
            set_aside: loaded.iter().map(|one| one.outcome.set_aside).sum(),
        }
    }

    fn cells(&self) -> [String; 9] {
        let number = |value: Option<f64>, factor: f64, digits: usize| {
            value.map_or_else(|| "-".to_owned(), |value| format!("{:.digits$}", factor * value))
        };
        [
            self.clearance_mm.to_string(),
            self.actuator_mm.to_string(),
            self.camera_mm.map_or_else(|| "none".to_owned(), |mm| mm.to_string()),
            number(self.c_mean, 1.0, 3),
            number(self.fill, 100.0, 1),
            number(Some(self.collisions_per_100), 1.0, 2),
            number(Some(100.0 * self.clean_share), 1.0, 0),
            number(Some(self.corrections_per_100), 1.0, 1),
            number(Some(self.alarms_per_100), 1.0, 1),
        ]
    }
}

const COLUMNS: [&str; 9] = [
    "clearance [mm]",
    "arm [mm]",
    "camera [mm]",
    "c",
    "fill [%]",
    "collisions per 100",
    "clean episodes [%]",
    "corrections per 100",
    "alarms per 100",
];

fn text(rows: &[Row]) -> String {
    let mut table = comfy_table::Table::new();
    table.load_style(comfy_table::presets::ASCII_MARKDOWN);
    table.set_header(COLUMNS);
    for row in rows {
        table.add_row(row.cells());
    }
    table.to_string()
}

fn page(about: &str, rows: &[Row]) -> String {
    let mut page = Page::new("Boxes that do not land where they are told to", about);
    page.text(
        "Arm and camera are standard deviations; no error exceeds three of them. The clearance is kept by every box on \
         every side, so the gap between two boxes is twice as wide. A collision is a box that touched another one on \
         its way down, or whose place was taken; a correction is a box after which the belief follows the camera.",
    );
    let mut table = Table::new(COLUMNS);
    for row in rows {
        table.row(row.cells());
    }
    page.table(&table);
    page.to_html()
}

#[cfg(test)]
mod tests {
    use packing::{Heuristic, Recipe, Split, WalleWeights};

    use super::*;

    /// The rows of two test episodes of the standard set.
    fn row(clearance_mm: u16, actuator_mm: f64, camera_mm: Option<f64>) -> Row {
        let walle = Heuristic::WalleCorners(WalleWeights::PAPER);
        let episodes: Vec<_> = (0..2).map(|index| Recipe::standard().episode(Split::Test, 1, index).unwrap()).collect();
        let load = |(seed, episode): (u64, &packing::Episode)| {
            let world = World { seed, actuator_mm, clearance_mm, camera_mm };
            let boxes = numbered(&episode.boxes).unwrap();
            let choose = |grid: &packing::Grid, extent, _index| walle.choose(grid, extent);
            world.load(episode.container, 16, &boxes, episode.optimum, choose).unwrap()
        };
        let loaded: Vec<_> = (1..).zip(&episodes).map(load).collect();
        Row::of(clearance_mm, actuator_mm, camera_mm, &loaded, episodes.iter().map(|one| one.boxes.len()).sum())
    }

    /// The target: 5 mm of noise, a camera of 1 mm, no collision, and c as without noise.
    #[test]
    fn a_centimetre_and_a_good_camera_suffice_for_five_millimetres() {
        let (perfect, corrected) = (row(10, 0.0, None), row(10, 5.0, Some(1.0)));
        assert_eq!((corrected.collisions_per_100, corrected.set_aside), (0.0, 0));
        // The c of two episodes moves in steps of 0.05.
        assert!(corrected.c_mean.unwrap() < perfect.c_mean.unwrap() + 0.075, "{corrected:?} and {perfect:?}");
        assert!(row(0, 5.0, None).collisions_per_100 > 50.0, "without a gap, boxes touch");
    }

    #[test]
    fn a_perfect_world_is_left_as_it_is() {
        let (plain, seen) = (row(0, 0.0, None), row(0, 0.0, Some(0.0)));
        assert_eq!((plain.collisions_per_100, seen.corrections_per_100), (0.0, 0.0));
        assert_eq!((plain.c_mean, plain.fill), (seen.c_mean, seen.fill));
    }
}
