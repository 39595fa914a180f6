//! Deep Q-learning as published. Paper: "Rewards and training" and "Training".
//!
//! Symbols: `rho` is [`DqnConfig::reward_discount`], `gamma` is [`DqnConfig::value_discount`], `zeta` the terminal
//! reward, `tau` the mean packing fraction so far, `epsilon` the share of random decisions.

use burn::tensor::{Device, Tensor, TensorData};
use packing::{
    Candidate, ClosePolicy, Draw, Environment, Episode, Outcome, PlaceError, SizeError, Step, WalleWeights,
    corner_candidates,
};
use serde::{Deserialize, Serialize};

use crate::encoding::{Batch, Encoder, Encoding, Walls};
use crate::model::Scope;
use crate::network::{Network, tensors};
use crate::policy::best;
use crate::weights::{Architecture, Layer, Weights};

/// Everything that can be set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DqnConfig {
    /// The number of the network's input.
    pub encoding: u32,
    /// The candidates it chooses among.
    pub scope: Scope,
    /// `rho`: how the terminal reward fades towards the episode's start [-].
    pub reward_discount: f64,
    /// `gamma`: the share of the next value in a value [-].
    pub value_discount: f64,
    /// SGD's learning rate [-].
    pub learning_rate: f32,
    /// SGD's momentum [-].
    pub momentum: f32,
    /// Steps in one training.
    pub batch: usize,
    /// Trainings after which the target network becomes the online network.
    pub target_every: u64,
    /// Episodes over which `epsilon` falls linearly from 1 to 0.
    pub exploring_episodes: u64,
    /// Steps the replay buffer holds; the oldest episodes leave. The paper does not say: about 35 episodes.
    pub replay_steps_max: usize,
    /// `T`: containers an episode may use.
    pub containers: usize,
}

impl DqnConfig {
    /// The published values.
    #[must_use]
    pub fn published() -> Self {
        Self {
            encoding: Encoding::Published(Walls::Empty).number(),
            scope: Scope::FirstContainer,
            reward_discount: 0.99,
            value_discount: 0.75,
            learning_rate: 0.001,
            momentum: 0.5,
            batch: 256,
            target_every: 10,
            exploring_episodes: 1000,
            replay_steps_max: 10_000,
            containers: 16,
        }
    }

    /// `epsilon` in the episode with this number, counted from 0: 1 in the first, 0 from `exploring_episodes` on.
    #[must_use]
    pub fn epsilon(&self, episode: u64) -> f64 {
        (1.0 - episode as f64 / self.exploring_episodes.max(1) as f64).max(0.0)
    }

    /// `r_t = rho^(N-t) * zeta` for every step `t` of 1 to `N`.
    fn rewards(&self, zeta: f64, steps: usize) -> impl Iterator<Item = f64> {
        let rho = self.reward_discount;
        (1..=steps).map(move |t| rho.powf((steps - t) as f64) * zeta)
    }

    /// `(1 - gamma) * r_t + gamma * Q(s_t+1, a_t+1)`; the last step has no next value.
    fn target(&self, reward: f32, next_value: Option<f32>) -> f32 {
        let gamma = self.value_discount as f32;
        (1.0 - gamma) * reward + next_value.map_or(0.0, |value| gamma * value)
    }
}

/// One played episode in the replay buffer.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Played {
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<u16>,
    rewards: Vec<f32>,
}

/// A network in training, with all it needs to continue: saved and loaded, it goes on bit for bit.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Dqn {
    config: DqnConfig,
    seed: u64,
    online: Vec<Layer>,
    target: Vec<Layer>,
    velocity: Vec<Layer>,
    replay: Vec<Played>,
    episodes: u64,
    fraction_sum: f64,
}

/// What one episode of training came to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trained {
    /// The episode's figures while exploring.
    pub outcome: Outcome,
    /// Whether all boxes found a place; if not, it counts as one container more than there are.
    pub complete: bool,
    /// Containers used, by that rule.
    pub containers_used: u32,
    /// Mean squared error of the training before its step.
    pub loss: f32,
}

/// Why training cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum DqnError {
    /// The episode's containers make no grid.
    #[error("the episode cannot be played")]
    Size(#[from] SizeError),
    /// A candidate was infeasible.
    #[error("a candidate cannot be placed, which is an error of this program")]
    Place(#[from] PlaceError),
    /// The network's values or gradients are not finite.
    #[error("the training diverged in episode {0}: use a smaller learning rate")]
    Diverged(u64),
    /// A checkpoint's state does not fit together.
    #[error("the training's state holds no network of this build")]
    State,
}

/// Draws of different purposes never share a stream; episodes use the numbers below these.
mod purpose {
    pub(super) const WEIGHTS: u64 = 100;
    pub(super) const EXPLORE: u64 = 101;
    pub(super) const SAMPLE: u64 = 102;
}

impl Dqn {
    /// An untrained network; all that is random follows from `seed`.
    #[must_use]
    pub fn new(config: DqnConfig, seed: u64) -> Self {
        let weights = Weights::untrained(Architecture::Published, &mut Draw::new(purpose::WEIGHTS, seed, 0));
        let zero = |layer: &Layer| Layer { weight: vec![0.0; layer.weight.len()], bias: vec![0.0; layer.bias.len()] };
        let online = weights.layers().to_vec();
        Self {
            config,
            seed,
            velocity: online.iter().map(zero).collect(),
            target: online.clone(),
            online,
            replay: Vec::new(),
            episodes: 0,
            fraction_sum: 0.0,
        }
    }

    /// What was set.
    #[must_use]
    pub fn config(&self) -> &DqnConfig {
        &self.config
    }

    /// The seed of all that is random.
    #[must_use]
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// Episodes trained on.
    #[must_use]
    pub fn episodes(&self) -> u64 {
        self.episodes
    }

    /// The online network.
    ///
    /// # Errors
    /// [`DqnError::State`] if a checkpoint held something else.
    pub fn weights(&self) -> Result<Weights, DqnError> {
        Weights::new(Architecture::Published, self.online.clone()).ok_or(DqnError::State)
    }

    /// The network's input.
    ///
    /// # Errors
    /// [`DqnError::State`] if a checkpoint held something else.
    pub fn encoding(&self) -> Result<Encoding, DqnError> {
        self.walls().map(Encoding::Published)
    }

    fn walls(&self) -> Result<Walls, DqnError> {
        match Encoding::from_number(self.config.encoding) {
            Some(Encoding::Published(walls)) => Ok(walls),
            Some(Encoding::Moves) | None => Err(DqnError::State),
        }
    }

    /// Plays one episode, puts it into the replay buffer, and trains once. Paper: "Training".
    ///
    /// # Errors
    /// [`DqnError`]; the network is then unchanged.
    pub fn train_on(&mut self, episode: &Episode) -> Result<Trained, DqnError> {
        let (mut batch, outcome, complete) = self.play(episode)?;
        let containers_used = if complete { outcome.containers_used } else { self.config.containers as u32 + 1 };
        // zeta = V_packed / (T_used * L * B * H) - tau, tau over the episodes before this one.
        let packed = outcome.utilisation * f64::from(outcome.containers_used);
        let fraction = if containers_used == 0 { 0.0 } else { packed / f64::from(containers_used) };
        let tau = if self.episodes == 0 { fraction } else { self.fraction_sum / self.episodes as f64 };
        let rewards = self.config.rewards(fraction - tau, batch.len()).map(|reward| reward as f32).collect();
        let (x, y, z) = (std::mem::take(&mut batch.x), std::mem::take(&mut batch.y), std::mem::take(&mut batch.z));
        self.replay.push(Played { x, y, z, rewards });
        while self.replay.len() > 1 && self.replay_steps() > self.config.replay_steps_max {
            self.replay.remove(0);
        }
        let loss = self.train()?;
        self.fraction_sum += fraction;
        self.episodes += 1;
        if self.episodes.is_multiple_of(self.config.target_every) {
            self.target.clone_from(&self.online);
        }
        Ok(Trained { outcome, complete, containers_used, loss })
    }

    /// Plays with `epsilon`-greedy choices; gives the chosen rows, the figures, and whether all boxes were placed.
    fn play(&self, episode: &Episode) -> Result<(Batch, Outcome, bool), DqnError> {
        let device = Device::flex();
        let network = Network::new(&self.weights()?, &device).ok_or(DqnError::State)?;
        let mut encoder = Encoder::new(self.walls()?);
        let mut draw = Draw::new(purpose::EXPLORE, self.seed, self.episodes);
        let epsilon = self.config.epsilon(self.episodes);
        let mut environment = Environment::new(episode.container, self.config.containers, ClosePolicy::Never)?;
        let (mut candidates, mut batch, mut chosen) = (Vec::<Candidate>::new(), Batch::default(), Batch::default());
        let mut diverged = false;
        for spec in &episode.boxes {
            let step = environment.pack(spec, |grid, extent| {
                corner_candidates(grid, extent, &WalleWeights::PAPER, &mut candidates);
                let considered = self.config.scope.considered(&candidates);
                encoder.encode(grid, extent, considered, &mut batch);
                if batch.is_empty() {
                    return None;
                }
                let index = if draw.unit() < epsilon {
                    draw.below(batch.len() as u64) as usize
                } else {
                    let choice = network.values(&batch, &device).and_then(|values| best(&values).ok().flatten());
                    diverged |= choice.is_none();
                    choice?.index
                };
                chosen.push_row(&batch, index);
                Some(considered[index].placement)
            })?;
            if diverged {
                return Err(DqnError::Diverged(self.episodes));
            }
            if step == Step::SetAside {
                return Ok((chosen, environment.outcome(episode.optimum), false));
            }
        }
        Ok((chosen, environment.outcome(episode.optimum), true))
    }

    fn replay_steps(&self) -> usize {
        self.replay.iter().map(|played| played.rewards.len()).sum()
    }

    /// One step of SGD on the mean squared error over a batch drawn from the replay buffer.
    fn train(&mut self) -> Result<f32, DqnError> {
        let steps = self.replay_steps();
        if steps == 0 {
            return Ok(0.0);
        }
        let mut draw = Draw::new(purpose::SAMPLE, self.seed, self.episodes);
        let (mut now, mut next) = (Batch::default(), Batch::default());
        let mut rewards = Vec::new();
        for _ in 0..self.config.batch {
            let (played, step) = self.step_at(draw.below(steps as u64) as usize);
            let last = step + 1 == played.rewards.len();
            push_step(&mut now, played, step);
            if !last {
                push_step(&mut next, played, step + 1);
            }
            rewards.push((played.rewards[step], last));
        }
        let targets = self.targets(&next, &rewards)?;

        let device = Device::flex().autodiff();
        let network = Network::new(&self.weights()?, &device).ok_or(DqnError::State)?;
        let targets = Tensor::<2>::from_data(TensorData::new(targets, [rewards.len(), 1]), &device);
        let loss = (network.forward(tensors(&now, &device)) - targets).square().mean();
        let diverged = DqnError::Diverged(self.episodes);
        let gradients = network.gradients(&loss.backward());
        let (Some(gradients), Ok(loss)) = (gradients, loss.try_into_scalar::<f32>()) else { return Err(diverged) };
        let (momentum, rate) = (self.config.momentum, self.config.learning_rate);
        let (mut online, mut velocity) = (self.online.clone(), self.velocity.clone());
        for ((layer, velocity), gradient) in online.iter_mut().zip(&mut velocity).zip(&gradients) {
            descend(&mut layer.weight, &mut velocity.weight, &gradient.weight, momentum, rate);
            descend(&mut layer.bias, &mut velocity.bias, &gradient.bias, momentum, rate);
        }
        let finite = Weights::new(Architecture::Published, online.clone()).is_some_and(|w| w.not_finite().is_none());
        if !finite || !loss.is_finite() {
            return Err(diverged);
        }
        (self.online, self.velocity) = (online, velocity);
        Ok(loss)
    }

    /// The step with this number in the whole buffer: its episode, and its number there.
    fn step_at(&self, mut step: usize) -> (&Played, usize) {
        let mut played = self.replay.iter();
        loop {
            match played.next() {
                Some(episode) if step < episode.rewards.len() => return (episode, step),
                Some(episode) => step -= episode.rewards.len(),
                None => return (&self.replay[0], 0),
            }
        }
    }

    /// The target of every drawn step; `next` holds the steps that follow those that are not the last.
    fn targets(&self, next: &Batch, rewards: &[(f32, bool)]) -> Result<Vec<f32>, DqnError> {
        let device: Device = Device::flex();
        let target = Weights::new(Architecture::Published, self.target.clone()).ok_or(DqnError::State)?;
        let network = Network::new(&target, &device).ok_or(DqnError::State)?;
        let mut next_values = network.values(next, &device).ok_or(DqnError::State)?.into_iter();
        let target = |&(reward, last): &(f32, bool)| {
            let next_value = if last { None } else { next_values.next() };
            self.config.target(reward, next_value)
        };
        Ok(rewards.iter().map(target).collect())
    }
}

/// `v = momentum * v + gradient`, `w = w - rate * v`: without dampening.
fn descend(weights: &mut [f32], velocity: &mut [f32], gradient: &[f32], momentum: f32, rate: f32) {
    for ((weight, velocity), gradient) in weights.iter_mut().zip(velocity).zip(gradient) {
        *velocity = momentum * *velocity + gradient;
        *weight -= rate * *velocity;
    }
}

fn push_step(batch: &mut Batch, played: &Played, step: usize) {
    let (x_len, y_len) = (crate::encoding::X_LEN, crate::encoding::Y_LEN);
    batch.x.extend_from_slice(&played.x[step * x_len..(step + 1) * x_len]);
    batch.y.extend_from_slice(&played.y[step * y_len..(step + 1) * y_len]);
    batch.z.push(played.z[step]);
}

#[cfg(test)]
mod tests {
    use packing::{ContainerSize, Recipe, Split};

    use super::*;

    fn recipe() -> Recipe {
        let container = ContainerSize::new(9, 16, 10, 50).unwrap();
        Recipe { container, optimum: 2, boxes_per_container: 8..=10, ..Recipe::standard() }
    }

    fn config() -> DqnConfig {
        DqnConfig { containers: 5, batch: 32, exploring_episodes: 6, target_every: 3, ..DqnConfig::published() }
    }

    #[track_caller]
    fn close(found: f64, expected: f64) {
        assert!((found - expected).abs() < 1e-6, "{found} and not {expected}");
    }

    /// Three steps with zeta = 0.2: 0.99^2 * 0.2, 0.99 * 0.2, 0.2.
    #[test]
    fn rewards_by_hand() {
        let rewards: Vec<_> = DqnConfig::published().rewards(0.2, 3).collect();
        close(rewards[0], 0.19602);
        close(rewards[1], 0.198);
        close(rewards[2], 0.2);
    }

    /// 0.25 * 0.2 + 0.75 * 0.4 = 0.35, and 0.25 * 0.2 = 0.05 at the end.
    #[test]
    fn targets_by_hand() {
        let config = DqnConfig::published();
        close(config.target(0.2, Some(0.4)).into(), 0.35);
        close(config.target(0.2, None).into(), 0.05);
    }

    #[test]
    fn epsilon_falls_from_one_to_zero() {
        let config = DqnConfig::published();
        assert_eq!([0, 500, 1000, 1999].map(|episode| config.epsilon(episode)), [1.0, 0.5, 0.0, 0.0]);
    }

    /// v = 0.5 * 2 + 1 = 2, w = 3 - 0.1 * 2 = 2.8.
    #[test]
    fn a_step_of_sgd_by_hand() {
        let (mut weights, mut velocity) = ([3.0], [2.0]);
        descend(&mut weights, &mut velocity, &[1.0], 0.5, 0.1);
        close(velocity[0].into(), 2.0);
        close(weights[0].into(), 2.8);
    }

    /// The first episode's zeta is 0, the second's is its fraction minus the first's.
    #[test]
    fn the_terminal_reward_is_measured_against_the_past() {
        let mut dqn = Dqn::new(config(), 1);
        let fraction = |trained: &Trained| {
            trained.outcome.utilisation * f64::from(trained.outcome.containers_used)
                / f64::from(trained.containers_used)
        };
        let first = dqn.train_on(&recipe().episode(Split::Training, 1, 0).unwrap()).unwrap();
        assert!(dqn.replay[0].rewards.iter().all(|&reward| reward == 0.0));
        let second = dqn.train_on(&recipe().episode(Split::Training, 1, 1).unwrap()).unwrap();
        let last = *dqn.replay[1].rewards.last().unwrap();
        close(last.into(), fraction(&second) - fraction(&first));
    }

    #[test]
    fn the_loss_falls_on_one_fixed_batch() {
        let mut dqn = Dqn::new(DqnConfig { learning_rate: 0.02, ..config() }, 3);
        for index in 0..4 {
            dqn.train_on(&recipe().episode(Split::Training, 3, index).unwrap()).unwrap();
        }
        let first = dqn.train().unwrap();
        let last = (0..60).map(|_| dqn.train().unwrap()).last().unwrap();
        assert!(last < first * 0.8, "{first} to {last}");
    }

    #[test]
    fn a_training_that_was_killed_continues_bit_for_bit() {
        let mut whole = Dqn::new(config(), 5);
        let mut resumed = None;
        for index in 0..10 {
            if index == 4 {
                let folder = tempfile::tempdir().unwrap();
                let path = folder.path().join("checkpoint");
                crate::save_checkpoint(&path, &whole).unwrap();
                resumed = Some(crate::load_checkpoint::<Dqn>(&path).unwrap());
            }
            let episode = recipe().episode(Split::Training, 5, index).unwrap();
            let trained = whole.train_on(&episode).unwrap();
            if let Some(resumed) = &mut resumed {
                assert_eq!(resumed.train_on(&episode).unwrap(), trained);
            }
        }
        assert_eq!(resumed.unwrap().online, whole.online);
        assert_ne!(Dqn::new(config(), 5).online, whole.online);
    }
}
