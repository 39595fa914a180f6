//! The training of the model that ships: policy search over whole episodes.
//!
//! Every generation tries a few sets of numbers on the same fresh episodes, on a grid as coarse as the lattice of
//! the cuts, and moves towards those that did best.

use std::fmt::Write as _;

use anyhow::Context as _;
use packing::{ContainerSize, Draw, Episode, Recipe, Split};
use policy::moves::FEATURES;
use policy::{
    Architecture, Card, Encoding, Evolution, HIDDEN_UNITS, Model, Packed, Scope, Training, Validation, Weights,
    pack_fast, pack_planned,
};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{Clock, Data, Progress, TrainArgs, VALIDATION_EPISODES, VALIDATION_SEED, git_revision, progress_bar};

/// A part of the search.
struct Stage {
    /// Whether all numbers are searched, or the linear part alone.
    all_numbers: bool,
    /// Whether plans count as much as greedy choices, or greedy choices alone.
    with_plans: bool,
    generations: u64,
    /// The first steps.
    step: f64,
}

/// The search, part by part: each starts from the mean centre of the second half of the one before.
const STAGES: [Stage; 3] = [
    Stage { all_numbers: false, with_plans: false, generations: 60, step: 0.3 },
    Stage { all_numbers: true, with_plans: false, generations: 60, step: 0.05 },
    Stage { all_numbers: true, with_plans: true, generations: 24, step: 0.03 },
];

/// Boxes known after the current one while plans are tried.
const UPCOMING: usize = 2;
/// Width of the beam while plans are tried: narrower than in the cell, so that it is fast.
const WIDTH: usize = 4;

/// A policy search, and where it stands.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Search {
    stage: usize,
    evolution: Evolution,
    /// Sum of the search's centres over the second half of the stage.
    sum: Vec<f64>,
}

/// Points tried in one generation.
const SAMPLES: usize = 20;
/// Fresh episodes on which all points of a generation are tried.
const EPISODES_PER_GENERATION: u64 = 24;
/// The draws of the hidden layer's first weights; see also `policy`.
const HIDDEN_PURPOSE: u64 = 104;

impl Search {
    fn new(seed: u64) -> Self {
        // What packers know: fill niches, go on at the level that is there, start low, and use old containers first.
        let mut mean = vec![0.0; FEATURES];
        for (feature, weight) in [(0, 0.2), (1, 0.2), (2, 0.2), (5, -0.2), (8, -0.2), (13, 0.2), (17, -0.2), (21, -0.3)]
        {
            mean[feature] = weight;
        }
        let sum = vec![0.0; FEATURES];
        Self { stage: 0, evolution: Evolution::new(mean, STAGES[0].step, SAMPLES, seed), sum }
    }

    /// All numbers of the network whose searched numbers these are.
    fn weights(&self, searched: &[f64]) -> anyhow::Result<Weights> {
        let mut numbers: Vec<f32> = searched.iter().map(|&number| number as f32).collect();
        if !STAGES[self.stage].all_numbers {
            numbers.push(0.0);
            let untrained = Weights::untrained(Architecture::Moves, &mut Draw::new(HIDDEN_PURPOSE, 0, 0)).to_numbers();
            let last = untrained.len() - HIDDEN_UNITS - 1;
            numbers.extend(&untrained[FEATURES + 1..last]);
            numbers.resize(untrained.len(), 0.0);
        }
        Weights::from_numbers(Architecture::Moves, &numbers).context("a network of another size")
    }

    fn generation(&self) -> u64 {
        STAGES[..self.stage].iter().map(|stage| stage.generations).sum::<u64>() + self.evolution.generation()
    }

    /// The mean centre of the second half so far, or the centre before it.
    fn best(&self) -> anyhow::Result<Weights> {
        let half = STAGES[self.stage].generations / 2;
        let count = self.evolution.generation().saturating_sub(half);
        if count == 0 {
            return self.weights(self.evolution.mean());
        }
        self.weights(&self.sum.iter().map(|sum| sum / count as f64).collect::<Vec<_>>())
    }

    fn step(&mut self, recipe: &Recipe, containers: usize, seed: u64) -> anyhow::Result<()> {
        let points = self.evolution.ask();
        let weights = points.iter().map(|point| self.weights(point)).collect::<anyhow::Result<Vec<_>>>()?;
        let first = self.generation() * EPISODES_PER_GENERATION;
        let episodes = (first..first + EPISODES_PER_GENERATION)
            .map(|index| recipe.episode(Split::Training, seed, index))
            .collect::<Result<Vec<_>, _>>()?;
        let trials: Vec<_> = weights.iter().flat_map(|weights| episodes.iter().map(move |e| (weights, e))).collect();
        let scores: Vec<f64> = trials
            .par_iter()
            .map(|(weights, episode)| score(weights, episode, containers, STAGES[self.stage].with_plans))
            .collect::<anyhow::Result<_>>()?;
        let mean = |scores: &[f64]| scores.iter().sum::<f64>() / scores.len() as f64;
        let scores: Vec<f64> = scores.chunks_exact(episodes.len()).map(mean).collect();
        self.evolution.tell(&scores);
        if self.evolution.generation() > STAGES[self.stage].generations / 2 {
            self.sum.iter_mut().zip(self.evolution.mean()).for_each(|(sum, mean)| *sum += mean);
        }
        if self.evolution.generation() == STAGES[self.stage].generations && self.stage + 1 < STAGES.len() {
            let best: Vec<f64> = self.best()?.to_numbers().into_iter().map(f64::from).collect();
            self.stage += 1;
            let searched = if STAGES[self.stage].all_numbers { best.len() } else { FEATURES };
            self.sum = vec![0.0; searched];
            let seed = seed.wrapping_add(self.stage as u64);
            self.evolution = Evolution::new(best[..searched].to_vec(), STAGES[self.stage].step, SAMPLES, seed);
        }
        Ok(())
    }
}

/// What the search maximises: the fill of the first containers, minus containers used over the optimum.
fn score(weights: &Weights, episode: &Episode, containers: usize, with_plans: bool) -> anyhow::Result<f64> {
    let optimum = episode.optimum.unwrap_or(1);
    let size = episode.container;
    let figure = |packed: &Packed| packed.fill(size, optimum) - packed.containers(size) / f64::from(optimum);
    let greedy = figure(&pack_fast(episode, weights, containers));
    if !with_plans {
        return Ok(greedy);
    }
    Ok((greedy + figure(&pack_planned(episode, weights, containers, UPCOMING, WIDTH)?)) / 2.0)
}

/// The training of the model that ships.
pub(super) fn run(args: &TrainArgs) -> anyhow::Result<()> {
    // On the lattice of the cuts a coarse grid is exact: the same corners, the same features, 25 times fewer cells.
    let coarse = ContainerSize::new(9, 16, 10, 50)?;
    let recipe = Recipe { container: coarse, ..args.data.recipe() };
    let containers = args.data.containers();
    let header = "generation,step,validation_c,validation_fill\n";
    let mut progress = Progress::resume(args, "best", header, || Search::new(args.seed))?;
    let generations = args.episodes.map_or(STAGES.iter().map(|stage| stage.generations).sum(), |episodes| {
        episodes.div_ceil(EPISODES_PER_GENERATION)
    });
    let clock = Clock::start(args.minutes);
    let bar = progress_bar(generations, progress.learner.generation())?;
    while progress.learner.generation() < generations && !clock.is_up() {
        progress.learner.step(&recipe, containers, args.seed)?;
        if progress.learner.generation().is_multiple_of(10) {
            let model = search_model(&progress.learner, args, None)?;
            let validation = validate_fast(&model, &recipe, args.data, VALIDATION_EPISODES)?;
            writeln!(
                progress.curve,
                "{},{:.5},{:.4},{:.4}",
                progress.learner.generation(),
                progress.learner.evolution.step(),
                validation.competitive_ratio,
                validation.fill
            )?;
            bar.set_message(format!("c {:.3}, fill {:.3}", validation.competitive_ratio, validation.fill));
        }
        progress.save(args)?;
        bar.inc(1);
    }
    let model = search_model(&progress.learner, args, None)?;
    let validation = validate_fast(&model, &recipe, args.data, args.validation_episodes)?;
    bar.finish_with_message(format!("c {:.3}, fill {:.3}", validation.competitive_ratio, validation.fill));
    search_model(&progress.learner, args, Some(validation))?.save(&args.out)?;
    Ok(())
}

fn search_model(search: &Search, args: &TrainArgs, validation: Option<Validation>) -> anyhow::Result<Model> {
    let training = Training {
        recipe: "best".to_owned(),
        seed: args.seed,
        data: args.data.name().to_owned(),
        episodes: search.generation() * EPISODES_PER_GENERATION,
        git_revision: git_revision(),
        validation,
    };
    let card = Card { encoding: Encoding::Moves, scope: Scope::AllContainers, training };
    Ok(Model::new(card, search.best()?)?)
}

/// Mean figures on validation episodes, played fast.
fn validate_fast(model: &Model, recipe: &Recipe, data: Data, episodes: u64) -> anyhow::Result<Validation> {
    let packed = (0..episodes)
        .into_par_iter()
        .map(|index| {
            let episode = recipe.episode(Split::Validation, VALIDATION_SEED, index)?;
            Ok(pack_fast(&episode, model.weights(), data.containers()))
        })
        .collect::<anyhow::Result<Vec<_>>>()?;
    let mean = |figure: &dyn Fn(&Packed) -> f64| packed.iter().map(figure).sum::<f64>() / packed.len().max(1) as f64;
    let optimum = recipe.optimum;
    let used = |packed: &Packed| packed.packed_cells.len() as f64 + f64::from(u32::from(packed.set_aside > 0));
    Ok(Validation {
        data: data.name().to_owned(),
        episodes,
        competitive_ratio: mean(&|packed| used(packed) / f64::from(optimum)),
        fill: mean(&|packed| packed.fill(recipe.container, optimum)),
    })
}
