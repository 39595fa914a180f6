//! Runs methods on the same episodes and sums up what came of it.

use std::time::Instant;

use dataset::DataSet;
use packing::{ClosePolicy, Environment, Extent, Grid, Outcome, PlacedBox, Rules, Step};
use rayon::prelude::*;

use crate::method::Method;

/// The conditions of a trial.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Conditions {
    /// Containers that are open at once.
    pub(crate) slots: usize,
    /// Which leaves when none of them has a place.
    pub(crate) close: ClosePolicy,
    /// Most containers of an episode.
    pub(crate) containers_max: u32,
    /// An episode ends at the first box that finds no place.
    pub(crate) stop_at_misfit: bool,
    /// What a box may stand on, and how near to anything.
    pub(crate) rules: Rules,
    /// Boxes known after the current one.
    pub(crate) lookahead: usize,
    /// For methods that draw.
    pub(crate) seed: u64,
}

/// What one method made of a data set.
#[derive(Clone, Debug)]
pub(crate) struct Trial {
    pub(crate) method: String,
    /// Episode by episode.
    pub(crate) outcomes: Vec<Outcome>,
    /// Episodes in which no other method packed better.
    best: usize,
    /// Time of one decision [us].
    pub(crate) us_p50: f64,
    /// Time of one decision [us].
    pub(crate) us_p99: f64,
}

/// One packed episode.
struct Packed {
    outcome: Outcome,
    decisions_ns: Vec<u32>,
    placed: Vec<PlacedBox>,
}

/// Runs all methods on all episodes, on all cores; what they choose does not depend on how many there are.
pub(crate) fn run(
    set: &DataSet,
    methods: &[Method],
    conditions: &Conditions,
    packed: impl Fn() + Sync,
) -> anyhow::Result<Vec<Trial>> {
    let jobs: Vec<_> =
        methods.iter().flat_map(|method| (0..set.episodes.len()).map(move |episode| (method, episode))).collect();
    let run_one = |&(method, episode): &(&Method, usize)| {
        let result = pack(set, episode, method, conditions);
        packed();
        result.map(|Packed { outcome, decisions_ns, .. }| (outcome, decisions_ns))
    };
    let results = jobs.par_iter().map(run_one).collect::<anyhow::Result<Vec<_>>>()?;
    let mut trials: Vec<_> = methods
        .iter()
        .zip(results.chunks(set.episodes.len()))
        .map(|(method, results)| Trial::of(method, results))
        .collect();
    for episode in 0..set.episodes.len() {
        let best = trials.iter().map(|trial| trial.goodness(episode)).fold(0.0, f64::max);
        trials.iter_mut().filter(|trial| trial.goodness(episode) >= best).for_each(|trial| trial.best += 1);
    }
    Ok(trials)
}

/// The boxes of one episode as a method places them.
pub(crate) fn plan(
    set: &DataSet,
    episode: usize,
    method: &Method,
    conditions: &Conditions,
) -> anyhow::Result<Vec<PlacedBox>> {
    Ok(pack(set, episode, method, conditions)?.placed)
}

#[expect(clippy::disallowed_methods, reason = "the time of a decision is what is measured")]
fn pack(set: &DataSet, episode: usize, method: &Method, conditions: &Conditions) -> anyhow::Result<Packed> {
    let boxes = &set.episodes[episode];
    let grid = Grid::with_rules(set.container, conditions.slots, conditions.rules)?;
    let extents: Vec<Extent> = boxes.iter().map(|spec| grid.extent(spec)).collect();
    let mut environment = Environment::on(grid, conditions.close).with_containers_max(conditions.containers_max);
    let mut chooser = method.chooser(conditions.seed, episode)?;
    let mut decisions_ns = Vec::with_capacity(boxes.len());
    for (index, spec) in boxes.iter().enumerate() {
        let upcoming = &extents[index + 1..(index + 1 + conditions.lookahead).min(extents.len())];
        let (mut decision_ns, mut failure) = (0, None);
        let step = environment.pack(spec, |grid, extent| {
            let begun = Instant::now();
            let choice = chooser(grid, extent, upcoming);
            decision_ns += begun.elapsed().as_nanos();
            choice.unwrap_or_else(|error| {
                failure = Some(error);
                None
            })
        })?;
        if let Some(error) = failure {
            return Err(error.context(format!("{} failed in episode {episode}, box {index}", method.name)));
        }
        decisions_ns.push(u32::try_from(decision_ns).unwrap_or(u32::MAX));
        if step == Step::SetAside && conditions.stop_at_misfit {
            break;
        }
    }
    Ok(Packed { outcome: environment.outcome(set.optimum), decisions_ns, placed: environment.placed().to_vec() })
}

impl Trial {
    fn of(method: &Method, results: &[(Outcome, Vec<u32>)]) -> Self {
        let mut decisions_ns: Vec<u32> = results.iter().flat_map(|(_, decisions_ns)| decisions_ns).copied().collect();
        decisions_ns.sort_unstable();
        let us = |percent: usize| {
            let rank = (decisions_ns.len() * percent).div_ceil(100).max(1) - 1;
            f64::from(decisions_ns.get(rank).copied().unwrap_or(0)) / 1e3
        };
        Self {
            method: method.name.clone(),
            outcomes: results.iter().map(|(outcome, _)| *outcome).collect(),
            best: 0,
            us_p50: us(50),
            us_p99: us(99),
        }
    }

    /// What "best" compares: the fill of the first containers, and the utilisation where the optimum is unknown.
    pub(crate) fn goodness(&self, episode: usize) -> f64 {
        let outcome = &self.outcomes[episode];
        outcome.fill.unwrap_or(outcome.utilisation)
    }

    /// Share of the episodes in which no other method packed better [-]; ties count for all that tie.
    pub(crate) fn best_share(&self) -> f64 {
        self.best as f64 / self.outcomes.len() as f64
    }

    /// The mean of a figure over the episodes.
    pub(crate) fn mean(&self, figure: impl Fn(&Outcome) -> f64) -> f64 {
        self.outcomes.iter().map(figure).sum::<f64>() / self.outcomes.len() as f64
    }

    /// Mean of `c` and its standard error, where the optimum is known.
    pub(crate) fn competitive_ratio(&self) -> Option<(f64, f64)> {
        let ratios: Vec<f64> = self.outcomes.iter().map(|outcome| outcome.competitive_ratio).collect::<Option<_>>()?;
        let count = ratios.len() as f64;
        let mean = ratios.iter().sum::<f64>() / count;
        let squares = ratios.iter().map(|ratio| (ratio - mean).powi(2)).sum::<f64>();
        let stderr = if count > 1.0 { (squares / (count - 1.0) / count).sqrt() } else { 0.0 };
        Some((mean, stderr))
    }
}

/// Boxes of one container, in the order they were placed.
pub(crate) fn of_container(placed: &[PlacedBox], container: u32) -> Vec<PlacedBox> {
    placed.iter().filter(|placed| placed.container == container).copied().collect()
}
