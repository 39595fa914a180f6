//! `packlab evaluate`: which method, on which boxes, at what cost.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context as _;
use clap::Args;
use dataset::{DataSet, ReadOptions};
use indicatif::{ProgressBar, ProgressStyle};
use packing::{ClosePolicy, ContainerOrder, ContainerSize, Support, WalleWeights};

use crate::method::{Method, Settings};
use crate::output;
use crate::source::{Episodes, Source};
use crate::trial::{self, Conditions, Trial};

/// Longest lookahead: as many as the cell's messages carry.
const LOOKAHEAD_MAX: u64 = 8;

/// Which methods, on which boxes, under which rules.
#[derive(Debug, Args)]
pub(crate) struct EvaluateArgs {
    /// Data sets: names (standard, cut-order, fine, small-boxes, three, balanced, ten) or .json and .csv files.
    #[arg(long, value_name = "NAME|FILE", value_delimiter = ',', num_args = 1.., default_value = "standard")]
    data: Vec<String>,
    /// Methods: first-fit, floor, column, walle, walle-corners, harmonic, random, packman-published, packman, packman-lookahead. With "/all-open" or
    /// "/first-that-fits" behind it, a method goes through the containers in that order; "packman:FILE" takes a
    /// model of yours.
    #[arg(long, value_name = "A,B", value_delimiter = ',', num_args = 1.., default_value = Method::DEFAULT)]
    policy: Vec<String>,
    /// Episodes of each set (100 of a named one, all of a file).
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=dataset::EPISODES_MAX as i64))]
    episodes: Option<u32>,
    /// Which episodes of named sets.
    #[arg(long, value_enum, default_value_t = Episodes::Test)]
    split: Episodes,
    /// Seed of the generated sets and of methods that draw.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Containers that are open at once (16, or what the set asks for).
    #[arg(long, value_name = "T")]
    open: Option<usize>,
    /// Which container leaves when none has a place and all are open: never, oldest or fullest.
    #[arg(long, default_value = "fullest")]
    close: ClosePolicy,
    /// Most containers of an episode; boxes beyond are set aside.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    containers: Option<u32>,
    /// End an episode at the first box that finds no place.
    #[arg(long)]
    stop_at_misfit: bool,
    /// What a box needs under its base: full, or partial (over 95 % of the base at the top level, or three level
    /// corners and 85 %, or four and 60 %).
    #[arg(long, default_value = "full")]
    support: Support,
    /// Order in which every method goes through the open containers: first-that-fits or all-open (each method's
    /// published reading).
    #[arg(long)]
    order: Option<ContainerOrder>,
    /// WallE's five weights, eq. (1) of the paper.
    #[arg(long, value_delimiter = ',', num_args = 1, default_value = "0.75,1,1,0.01,1")]
    walle_weights: Vec<f32>,
    /// Boxes known after the current one, for methods that look at them.
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u64).range(..=LOOKAHEAD_MAX))]
    lookahead: u64,
    /// Container of CSV files: length, breadth and height [mm].
    #[arg(long, value_name = "L,B,H", value_delimiter = ',', num_args = 1, default_value = "450,800,500")]
    container: Vec<u32>,
    /// Grid cell of files [mm].
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=1000))]
    cell_mm: u32,
    /// Count unusable boxes and empty episodes of files and go on.
    #[arg(long)]
    skip_bad: bool,
    /// Threads (one a core). The figures do not depend on it, the times do.
    #[arg(long, default_value_t = 0)]
    threads: usize,
    /// Write the figures as JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Write the figures, charts and a packed episode as one page.
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    /// Write box plots of all sets and methods as one picture.
    #[arg(long, value_name = "FILE")]
    svg: Option<PathBuf>,
}

/// One data set and what every method made of it.
pub(crate) struct Evaluated {
    pub(crate) set: DataSet,
    pub(crate) conditions: Conditions,
    pub(crate) trials: Vec<Trial>,
}

#[expect(clippy::disallowed_methods, reason = "a person waits for this and is told how long it took")]
pub(crate) fn run(args: &EvaluateArgs) -> anyhow::Result<()> {
    [&args.json, &args.html, &args.svg].into_iter().flatten().try_for_each(|path| output::check_folder(path))?;
    let methods = methods(args)?;
    let sources = sources(args)?;
    rayon::ThreadPoolBuilder::new().num_threads(args.threads).build_global().context("no threads to work with")?;
    let begun = Instant::now();
    let packings: usize = sources.iter().map(|source| source.set.episodes.len() * methods.len()).sum();
    let progress = progress_bar(packings as u64);
    let mut evaluated = Vec::new();
    for Source { set, slots } in sources {
        let conditions = conditions(args, slots);
        set.container.check_slots(conditions.slots).with_context(|| format!("data set {}", set.name))?;
        progress.set_message(set.name.clone());
        let trials = trial::run(&set, &methods, &conditions, || progress.inc(1))
            .with_context(|| format!("data set {}", set.name))?;
        evaluated.push(Evaluated { set, conditions, trials });
    }
    progress.finish_and_clear();
    println!("{}", output::text(&evaluated));
    println!("{packings} packings in {:.1} s", begun.elapsed().as_secs_f64());
    if let Some(path) = &args.json {
        output::write(path, &output::json(args.seed, &evaluated)?)?;
    }
    if let Some(path) = &args.html {
        output::write(path, &output::html(&evaluated, &methods)?)?;
    }
    if let Some(path) = &args.svg {
        output::write(path, &output::svg(&evaluated, &methods))?;
    }
    Ok(())
}

fn methods(args: &EvaluateArgs) -> anyhow::Result<Vec<Method>> {
    let alpha: [f32; 5] = args
        .walle_weights
        .as_slice()
        .try_into()
        .with_context(|| format!("--walle-weights needs five numbers and got {}", args.walle_weights.len()))?;
    let settings = Settings { order: args.order, weights: WalleWeights::new(alpha)? };
    let mut methods: Vec<Method> = Vec::new();
    for name in &args.policy {
        let method = Method::parse(name.trim(), &settings)?;
        anyhow::ensure!(methods.iter().all(|other| other.name != method.name), "policy {} is named twice", method.name);
        methods.push(method);
    }
    Ok(methods)
}

fn sources(args: &EvaluateArgs) -> anyhow::Result<Vec<Source>> {
    let container = csv_container(&args.container, args.cell_mm)?;
    let options = ReadOptions { container, skip_bad: args.skip_bad };
    let episodes = args.episodes.map(|episodes| episodes as usize);
    args.data.iter().map(|data| Source::load(data.trim(), episodes, args.seed, args.split, &options)).collect()
}

fn csv_container(sides_mm: &[u32], cell_mm: u32) -> anyhow::Result<ContainerSize> {
    let whole = |side_mm: u32| {
        let cells = u16::try_from(side_mm / cell_mm).ok().filter(|_| side_mm.is_multiple_of(cell_mm));
        cells.with_context(|| format!("--container: {side_mm} mm are not a number of whole cells of {cell_mm} mm"))
    };
    let &[length, breadth, height] = sides_mm else {
        anyhow::bail!("--container needs length, breadth and height and got {} sides", sides_mm.len());
    };
    ContainerSize::new(whole(length)?, whole(breadth)?, whole(height)?, cell_mm).context("--container")
}

fn conditions(args: &EvaluateArgs, slots: usize) -> Conditions {
    let containers_max = args.containers.unwrap_or(u32::MAX);
    Conditions {
        slots: args.open.unwrap_or(slots).min(containers_max as usize),
        close: args.close,
        containers_max,
        stop_at_misfit: args.stop_at_misfit,
        support: args.support,
        lookahead: args.lookahead as usize,
        seed: args.seed,
    }
}

fn progress_bar(length: u64) -> ProgressBar {
    let style = ProgressStyle::with_template("{msg:12} [{bar:40}] {pos}/{len} packings, {eta} left");
    ProgressBar::new(length).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "))
}
