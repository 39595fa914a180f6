//! `packlab train`: learns a model and writes it, with everything needed to do it again.

mod best;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::bail;
use clap::{Args, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};
use packing::{ClosePolicy, Environment, Outcome, Recipe, Split, WalleWeights, corner_candidates};
use policy::{
    Card, Dqn, DqnConfig, Encoding, Engine, Model, Policy, PolicyKind, Training, Validation, Walls, load_checkpoint,
    save_checkpoint,
};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::output;

/// Learns a model and writes it to a file.
///
/// The same seed gives the same model whatever the number of cores. A training that was stopped continues from its
/// checkpoint when the same command is given again.
#[derive(Args, Debug)]
pub(crate) struct TrainArgs {
    /// How to learn.
    #[arg(long, value_enum, default_value_t = Method::Published)]
    recipe: Method,
    /// What to learn from.
    #[arg(long, value_enum, default_value_t = Data::Standard)]
    data: Data,
    /// Stop after this many episodes [default: as the recipe says].
    #[arg(long)]
    episodes: Option<u64>,
    /// Stop after this many minutes.
    #[arg(long, value_parser = minutes)]
    minutes: Option<Duration>,
    /// The seed of all that is random.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// The model file to write.
    #[arg(long)]
    out: PathBuf,
    /// Validation episodes for the model's record.
    #[arg(long, default_value_t = 100)]
    validation_episodes: u64,
    /// A CSV file for the learning curve.
    #[arg(long)]
    curve: Option<PathBuf>,
    /// What a wall counts as in the published network's input.
    #[arg(long, value_enum, default_value_t = Wall::Empty)]
    walls: Wall,
}

/// A way to learn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Method {
    /// The paper's deep Q-learning.
    Published,
    /// Policy search over whole episodes, for a network that reads moves.
    Best,
}

/// Episodes to learn from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Data {
    /// Ten containers on a 5 cm lattice, shuffled.
    Standard,
    /// Three containers, of which six may be used.
    Three,
}

/// What a wall counts as.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Wall {
    /// Height 0.
    Empty,
    /// The height limit.
    Full,
}

/// Validation episodes played between trainings.
const VALIDATION_EPISODES: u64 = 30;
/// The seed of the validation episodes, the same for all trainings so that they can be compared.
const VALIDATION_SEED: u64 = 1;
/// Episodes between two validations, which is also how much a kill can lose.
const EPISODES_PER_CHECKPOINT: u64 = 100;

impl Data {
    fn name(self) -> &'static str {
        match self {
            Self::Standard => "standard",
            Self::Three => "three",
        }
    }

    fn recipe(self) -> Recipe {
        match self {
            Self::Standard => Recipe::standard(),
            Self::Three => Recipe { optimum: 3, ..Recipe::standard() },
        }
    }

    /// `T`: containers an episode may use.
    fn containers(self) -> usize {
        match self {
            Self::Standard => 16,
            Self::Three => 6,
        }
    }
}

/// Runs the command.
///
/// # Errors
/// Says what stopped the training; its last checkpoint is intact.
pub(crate) fn run(args: &TrainArgs) -> anyhow::Result<()> {
    [Some(&args.out), args.curve.as_ref()].into_iter().flatten().try_for_each(|path| output::check_folder(path))?;
    match args.recipe {
        Method::Published => published(args),
        Method::Best => best::run(args),
    }
}

/// What is kept between two runs of one training.
#[derive(Serialize, Deserialize)]
struct Progress<T> {
    recipe: String,
    data: String,
    seed: u64,
    learner: T,
    curve: String,
}

impl<T: Serialize + for<'a> Deserialize<'a>> Progress<T> {
    /// The training as it was left, or a new one.
    fn resume(args: &TrainArgs, recipe: &str, header: &str, fresh: impl FnOnce() -> T) -> anyhow::Result<Self> {
        let path = checkpoint_path(&args.out);
        if !path.exists() {
            let (recipe, data, seed) = (recipe.to_owned(), args.data.name().to_owned(), args.seed);
            return Ok(Self { recipe, data, seed, learner: fresh(), curve: header.to_owned() });
        }
        let found: Self = load_checkpoint(&path)?;
        if (found.recipe.as_str(), found.data.as_str(), found.seed) != (recipe, args.data.name(), args.seed) {
            bail!(
                "checkpoint {} belongs to recipe {}, data {}, seed {}: give another --out, or remove it",
                path.display(),
                found.recipe,
                found.data,
                found.seed
            );
        }
        Ok(found)
    }

    fn save(&self, args: &TrainArgs) -> anyhow::Result<()> {
        save_checkpoint(&checkpoint_path(&args.out), self)?;
        if let Some(path) = &args.curve {
            output::write(path, &self.curve)?;
        }
        Ok(())
    }
}

fn checkpoint_path(out: &Path) -> PathBuf {
    out.with_extension("checkpoint")
}

/// The paper's training. Paper: "Training".
fn published(args: &TrainArgs) -> anyhow::Result<()> {
    let encoding = Encoding::Published(match args.walls {
        Wall::Empty => Walls::Empty,
        Wall::Full => Walls::Full,
    });
    let config =
        DqnConfig { encoding: encoding.number(), containers: args.data.containers(), ..DqnConfig::published() };
    let header = "episode,epsilon,loss,c,fill,validation_c,validation_fill\n";
    let mut progress = Progress::resume(args, "published", header, || Dqn::new(config.clone(), args.seed))?;
    if progress.learner.config() != &config {
        bail!("checkpoint {} has other settings: remove it to start again", checkpoint_path(&args.out).display());
    }
    let episodes = args.episodes.unwrap_or(2000);
    let clock = Clock::start(args.minutes);
    let bar = progress_bar(episodes, progress.learner.episodes())?;
    let recipe = args.data.recipe();
    while progress.learner.episodes() < episodes && !clock.is_up() {
        let index = progress.learner.episodes();
        let episode = recipe.episode(Split::Training, args.seed, index)?;
        let trained = progress.learner.train_on(&episode)?;
        let fill = trained.outcome.fill.unwrap_or(0.0);
        let epsilon = config.epsilon(index);
        let ratio = f64::from(trained.containers_used) / f64::from(recipe.optimum);
        write!(progress.curve, "{index},{epsilon:.4},{:.6e},{ratio:.4},{fill:.4}", trained.loss)?;
        if (index + 1).is_multiple_of(EPISODES_PER_CHECKPOINT) {
            let validation = validate(&dqn_model(&progress.learner, args, None)?, args.data, VALIDATION_EPISODES)?;
            write!(progress.curve, ",{:.4},{:.4}", validation.competitive_ratio, validation.fill)?;
            bar.set_message(format!("c {:.3}, fill {:.3}", validation.competitive_ratio, validation.fill));
        } else {
            progress.curve.push_str(",,");
        }
        progress.curve.push('\n');
        if (index + 1).is_multiple_of(EPISODES_PER_CHECKPOINT) {
            progress.save(args)?;
        }
        bar.inc(1);
    }
    progress.save(args)?;
    let untested = dqn_model(&progress.learner, args, None)?;
    let validation = validate(&untested, args.data, args.validation_episodes)?;
    bar.finish_with_message(format!("c {:.3}, fill {:.3}", validation.competitive_ratio, validation.fill));
    dqn_model(&progress.learner, args, Some(validation))?.save(&args.out)?;
    Ok(())
}

fn dqn_model(dqn: &Dqn, args: &TrainArgs, validation: Option<Validation>) -> anyhow::Result<Model> {
    let training = Training {
        recipe: "published".to_owned(),
        seed: dqn.seed(),
        data: args.data.name().to_owned(),
        episodes: dqn.episodes(),
        git_revision: git_revision(),
        validation,
    };
    let card = Card { encoding: dqn.encoding()?, scope: dqn.config().scope, training };
    Ok(Model::new(card, dqn.weights()?)?)
}

/// Mean figures of a model's greedy choices on validation episodes, the same for any number of threads.
fn validate(model: &Model, data: Data, episodes: u64) -> anyhow::Result<Validation> {
    let recipe = data.recipe();
    let outcomes = (0..episodes)
        .into_par_iter()
        .map(|index| play(model, &recipe, data.containers(), index))
        .collect::<anyhow::Result<Vec<_>>>()?;
    let mean = |figure: &dyn Fn(&Outcome) -> Option<f64>| {
        outcomes.iter().filter_map(figure).sum::<f64>() / outcomes.len().max(1) as f64
    };
    let competitive_ratio = |outcome: &Outcome| {
        let incomplete = f64::from(u32::from(outcome.set_aside > 0)) / f64::from(recipe.optimum);
        outcome.competitive_ratio.map(|ratio| ratio + incomplete)
    };
    Ok(Validation {
        data: data.name().to_owned(),
        episodes,
        competitive_ratio: mean(&competitive_ratio),
        fill: mean(&|outcome| outcome.fill),
    })
}

/// The figures of one validation episode. It ends when a box fits into none of its containers.
fn play(model: &Model, recipe: &Recipe, containers: usize, index: u64) -> anyhow::Result<Outcome> {
    let episode = recipe.episode(Split::Validation, VALIDATION_SEED, index)?;
    let mut policy = Policy::new(PolicyKind::PackmanPublished, Engine::BurnFlex, Some(model))?;
    let mut environment = Environment::new(episode.container, containers, ClosePolicy::Never)?;
    let (mut candidates, mut failed) = (Vec::new(), None);
    for spec in &episode.boxes {
        environment.pack(spec, |grid, extent| {
            corner_candidates(grid, extent, &WalleWeights::PAPER, &mut candidates);
            let choice = policy.choose(grid, extent, &[], &candidates);
            let choice = choice.unwrap_or_else(|error| {
                failed = Some(error);
                None
            });
            choice.map(|choice| candidates[choice.index].placement)
        })?;
        if environment.outcome(None).set_aside > 0 {
            break;
        }
    }
    failed.map_or(Ok(()), Err)?;
    Ok(environment.outcome(episode.optimum))
}

/// Tells whether the time that a run was given is over. What is learned does not depend on it, only how much.
struct Clock {
    end: Option<Instant>,
}

impl Clock {
    #[expect(clippy::disallowed_methods, reason = "a limit in minutes is measured by the machine's clock")]
    fn start(limit: Option<Duration>) -> Self {
        Self { end: limit.and_then(|limit| Instant::now().checked_add(limit)) }
    }

    #[expect(clippy::disallowed_methods, reason = "a limit in minutes is measured by the machine's clock")]
    fn is_up(&self) -> bool {
        self.end.is_some_and(|end| Instant::now() >= end)
    }
}

/// A time limit as it is typed.
fn minutes(text: &str) -> Result<Duration, String> {
    let minutes: f64 = text.parse().map_err(|_| format!("{text:?} is no number of minutes"))?;
    Duration::try_from_secs_f64(minutes * 60.0).map_err(|_| format!("{text} is no number of minutes to train for"))
}

fn progress_bar(length: u64, done: u64) -> anyhow::Result<ProgressBar> {
    let bar = ProgressBar::new(length);
    bar.set_style(ProgressStyle::with_template("{bar:40} {pos}/{len} {elapsed} left {eta} {msg}")?);
    bar.set_position(done);
    Ok(bar)
}

/// The revision of the code, as far as it can be found out where the command runs.
fn git_revision() -> String {
    let output = std::process::Command::new("git").args(["describe", "--always", "--dirty", "--abbrev=12"]).output();
    let revision = output.ok().filter(|output| output.status.success());
    let revision = revision.and_then(|output| String::from_utf8(output.stdout).ok());
    revision.map_or_else(|| "unknown".to_owned(), |revision| revision.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Cli {
        #[command(flatten)]
        train: TrainArgs,
    }

    fn train(out: &Path, more: &[&str]) -> anyhow::Result<Model> {
        let out_flag = out.display().to_string();
        let flags = ["train", "--data", "three", "--validation-episodes", "2", "--out", &out_flag];
        run(&Cli::try_parse_from(flags.iter().chain(more))?.train)?;
        Ok(Model::load(out)?)
    }

    #[test]
    fn a_training_that_was_stopped_gives_the_model_of_one_that_was_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        for recipe in ["published", "best"] {
            let (few, more) = if recipe == "best" { ("24", "48") } else { ("2", "4") };
            let whole = train(&path("whole.safetensors"), &["--recipe", recipe, "--episodes", more]).unwrap();
            let stopped = path("stopped.safetensors");
            let first = train(&stopped, &["--recipe", recipe, "--episodes", few]).unwrap();
            let resumed = train(&stopped, &["--recipe", recipe, "--episodes", more]).unwrap();
            assert_ne!(first.weights(), resumed.weights());
            assert_eq!(resumed, whole);
            let error = train(&stopped, &["--recipe", recipe, "--seed", "2"]).unwrap_err().to_string();
            assert!(error.contains("belongs to recipe") && error.contains("--out"), "{error}");
            std::fs::remove_file(checkpoint_path(&path("whole.safetensors"))).unwrap();
            std::fs::remove_file(checkpoint_path(&stopped)).unwrap();
        }
    }

    #[test]
    fn a_damaged_checkpoint_is_not_continued_from() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("model.safetensors");
        std::fs::write(checkpoint_path(&out), b"packcell checkpoint 1\nand half of it").unwrap();
        let error = train(&out, &["--episodes", "1"]).unwrap_err();
        assert!(format!("{error:#}").contains("damaged or cut short"), "{error:#}");
        assert!(!out.exists());
    }
}
