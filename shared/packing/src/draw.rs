//! Random numbers that are the same on every machine and in every release.

use rand_chacha::ChaCha8Rng;
use rand_core::{Rng as _, SeedableRng as _};

/// A stream of random draws, fixed by its key and stream number.
///
/// The generator is ChaCha8, whose output its specification fixes. How draws are made from its words is written
/// here and not taken from a library, because libraries change it between releases, and with it every episode.
#[derive(Clone, Debug)]
pub struct Draw(ChaCha8Rng);

impl Draw {
    /// The stream number `stream` of the generator that `purpose` and `seed` name.
    #[must_use]
    pub fn new(purpose: u64, seed: u64, stream: u64) -> Self {
        let mut key = [0; 32];
        key[..8].copy_from_slice(&purpose.to_le_bytes());
        key[8..16].copy_from_slice(&seed.to_le_bytes());
        let mut generator = ChaCha8Rng::from_seed(key);
        generator.set_stream(stream);
        Self(generator)
    }

    /// A number drawn uniformly from `0..end`.
    ///
    /// # Panics
    /// If `end` is zero: there is nothing to draw from.
    pub fn below(&mut self, end: u64) -> u64 {
        assert!(end > 0, "a draw from an empty range");
        // Lemire's multiplication method: reject the few words that would favour small numbers.
        let rejected_below = end.wrapping_neg() % end;
        loop {
            let product = u128::from(self.0.next_u64()) * u128::from(end);
            if product as u64 >= rejected_below {
                return (product >> 64) as u64;
            }
        }
    }

    /// A number drawn uniformly from `[0, 1)`, in steps of 2^-53.
    pub fn unit(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Puts the items into a uniformly random order (Fisher and Yates).
    pub fn shuffle<T>(&mut self, items: &mut [T]) {
        for last in (1..items.len()).rev() {
            items.swap(last, self.below(last as u64 + 1) as usize);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_stream_is_fixed_for_ever() {
        let mut draw = Draw::new(1, 2, 3);
        let drawn: Vec<_> = (0..6).map(|_| draw.below(1000)).collect();
        assert_eq!(drawn, [236, 755, 123, 116, 670, 48]);
    }

    #[test]
    fn draws_stay_in_range_and_reach_it_all() {
        let mut draw = Draw::new(0, 0, 0);
        let mut seen = [0; 5];
        for _ in 0..5000 {
            seen[draw.below(5) as usize] += 1;
        }
        assert!(seen.iter().all(|&n| (900..1100).contains(&n)), "{seen:?}");
        assert!((0..1000).all(|_| (0.0..1.0).contains(&draw.unit())));
    }

    #[test]
    fn a_shuffle_keeps_every_item() {
        let mut items: Vec<_> = (0..100).collect();
        Draw::new(0, 0, 0).shuffle(&mut items);
        assert_ne!(items, (0..100).collect::<Vec<_>>());
        items.sort_unstable();
        assert_eq!(items, (0..100).collect::<Vec<_>>());
    }
}
