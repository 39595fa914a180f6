//! Policy search over whole episodes: an evolution strategy that adapts its steps.
//!
//! The matrix adaptation of Beyer and Sendhoff, *Simplify Your Covariance Matrix Adaptation Evolution Strategy*
//! (IEEE Transactions on Evolutionary Computation, 2017), with the constants they recommend.

use packing::Draw;
use serde::{Deserialize, Serialize};

/// A search for the numbers that score highest. Saved and loaded, it goes on bit for bit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evolution {
    seed: u64,
    generation: u64,
    samples: usize,
    mean: Vec<f64>,
    step: f64,
    /// The directions in which the search steps, row by row.
    matrix: Vec<f64>,
    path: Vec<f64>,
}

/// Draws of different purposes never share a stream; see also `dqn`.
const PURPOSE: u64 = 103;

impl Evolution {
    /// A search around `mean` with steps of about `step` in every direction, `samples` at a time.
    #[must_use]
    pub fn new(mean: Vec<f64>, step: f64, samples: usize, seed: u64) -> Self {
        let n = mean.len();
        let mut matrix = vec![0.0; n * n];
        (0..n).for_each(|k| matrix[k * n + k] = 1.0);
        Self { seed, generation: 0, samples: samples.max(2), path: vec![0.0; n], mean, step, matrix }
    }

    /// Generations done.
    #[must_use]
    pub fn generation(&self) -> u64 {
        self.generation
    }

    /// The centre of the search.
    #[must_use]
    pub fn mean(&self) -> &[f64] {
        &self.mean
    }

    /// The size of its steps.
    #[must_use]
    pub fn step(&self) -> f64 {
        self.step
    }

    /// The points to try in this generation, the same however often it is asked.
    #[must_use]
    pub fn ask(&self) -> Vec<Vec<f64>> {
        let point = |normal: &Vec<f64>| {
            let direction = self.direction(normal);
            self.mean.iter().zip(direction).map(|(mean, direction)| mean + self.step * direction).collect()
        };
        self.normals().iter().map(point).collect()
    }

    /// Moves on, given how well the points of [`Evolution::ask`] did; larger is better.
    ///
    /// A score that is not a number counts as the worst.
    pub fn tell(&mut self, scores: &[f64]) {
        let n = self.mean.len();
        let parents = self.samples / 2;
        let mut order: Vec<usize> = (0..scores.len().min(self.samples)).collect();
        let score = |index: usize| if scores[index].is_nan() { f64::NEG_INFINITY } else { scores[index] };
        order.sort_by(|&a, &b| score(b).total_cmp(&score(a)).then(a.cmp(&b)));
        let raw: Vec<f64> = (0..parents).map(|k| (parents as f64 + 0.5).ln() - (k as f64 + 1.0).ln()).collect();
        let total: f64 = raw.iter().sum();
        let shares: Vec<f64> = raw.iter().map(|share| share / total).collect();
        let mass = 1.0 / shares.iter().map(|share| share * share).sum::<f64>();
        let dimension = n as f64;
        let path_rate = (mass + 2.0) / (dimension + mass + 5.0);
        let rank_one = 2.0 / ((dimension + 1.3).powi(2) + mass);
        let rank_parents = (2.0 * (mass + 1.0 / mass - 2.0) / ((dimension + 2.0).powi(2) + mass)).min(1.0 - rank_one);
        let damping = 1.0 + path_rate + 2.0 * (((mass - 1.0) / (dimension + 1.0)).sqrt() - 1.0).max(0.0);

        let normals = self.normals();
        let chosen: Vec<&Vec<f64>> = order.iter().take(parents).map(|&index| &normals[index]).collect();
        let blend = |k: usize| chosen.iter().zip(&shares).map(|(normal, share)| share * normal[k]).sum::<f64>();
        let normal: Vec<f64> = (0..n).map(blend).collect();
        let direction = self.direction(&normal);
        let pull = (mass * path_rate * (2.0 - path_rate)).sqrt();
        for k in 0..n {
            self.mean[k] += self.step * direction[k];
            self.path[k] = (1.0 - path_rate) * self.path[k] + pull * normal[k];
        }
        // M <- M (I + c1/2 (s s' - I) + cw/2 (sum w z z' - I)), without forming the inner matrix.
        let keep = 1.0 - (rank_one + rank_parents) / 2.0;
        let mut images = vec![(rank_one / 2.0, self.path.clone(), self.direction(&self.path))];
        for (normal, share) in chosen.iter().zip(&shares) {
            images.push((rank_parents / 2.0 * share, (*normal).clone(), self.direction(normal)));
        }
        self.matrix.iter_mut().for_each(|entry| *entry *= keep);
        for (rate, vector, image) in &images {
            for (row, image) in self.matrix.chunks_exact_mut(n).zip(image) {
                row.iter_mut().zip(vector).for_each(|(entry, value)| *entry += rate * image * value);
            }
        }
        let length = self.path.iter().map(|value| value * value).sum::<f64>().sqrt();
        let usual = dimension.sqrt() * (1.0 - 1.0 / (4.0 * dimension) + 1.0 / (21.0 * dimension * dimension));
        self.step *= ((path_rate / damping) * (length / usual - 1.0)).exp();
        self.generation += 1;
    }

    fn direction(&self, normal: &[f64]) -> Vec<f64> {
        let product = |row: &[f64]| row.iter().zip(normal).map(|(entry, value)| entry * value).sum();
        self.matrix.chunks_exact(self.mean.len().max(1)).map(product).collect()
    }

    fn normals(&self) -> Vec<Vec<f64>> {
        let mut draw = Draw::new(PURPOSE, self.seed, self.generation);
        let normals = (0..self.samples).map(|_| (0..self.mean.len()).map(|_| normal(&mut draw)).collect());
        normals.collect()
    }
}

/// A number of nearly normal distribution: twelve uniform draws, whose sum needs no function that differs between
/// machines.
fn normal(draw: &mut Draw) -> f64 {
    (0..12).map(|_| draw.unit()).sum::<f64>() - 6.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_climbs_a_crooked_hill_and_continues_bit_for_bit() {
        let score = |point: &Vec<f64>| -> f64 {
            -point.iter().enumerate().map(|(k, value)| 10f64.powi(k as i32) * (value - 1.0).powi(2)).sum::<f64>()
        };
        let mut search = Evolution::new(vec![0.0; 5], 0.5, 12, 1);
        let mut copy = None;
        for generation in 0..150 {
            if generation == 70 {
                copy = Some(search.clone());
            }
            let scores: Vec<_> = search.ask().iter().map(score).collect();
            search.tell(&scores);
            if let Some(copy) = &mut copy {
                copy.tell(&scores);
            }
        }
        assert!(search.mean().iter().all(|value| (value - 1.0).abs() < 1e-3), "{:?}", search.mean());
        assert_eq!(copy, Some(search));
    }
}
