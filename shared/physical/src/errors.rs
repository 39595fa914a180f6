//! Errors that are fixed by a seed and by what they befall.

use packing::Draw;

/// What an error is of; it keeps the draws of one box apart.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Of {
    Size = 0x51,
    Motion = 0x52,
    Refusal = 0x53,
    Drop = 0x54,
    Look = 0x55,
}

/// The draws for one thing that happens.
pub(crate) fn draw(of: Of, seed: u64, number: u64) -> Draw {
    Draw::new(of as u64, seed, number)
}

/// A normal error with standard deviation 1 that never exceeds 3: larger ones are drawn again.
///
/// It is the sum of twelve uniform draws, which needs nothing but addition and so is the same on every machine.
pub(crate) fn normal(draw: &mut Draw) -> f64 {
    loop {
        let sum: f64 = (0..12).map(|_| draw.unit()).sum();
        if (sum - 6.0).abs() <= 3.0 {
            return sum - 6.0;
        }
    }
}

/// Whether something happens that happens with this probability.
pub(crate) fn happens(draw: &mut Draw, share: f64) -> bool {
    draw.unit() < share
}

/// A quick stream of coarse normal errors for the thousands of pixels of a frame (splitmix64).
#[derive(Debug)]
pub(crate) struct PixelNoise(u64);

impl PixelNoise {
    pub(crate) fn new(draw: &mut Draw) -> Self {
        Self(draw.below(u64::MAX))
    }

    /// A normal error with standard deviation 1 that never exceeds 3.5, and a number from `0..65536` for something else.
    pub(crate) fn next(&mut self) -> (f32, u16) {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut word = self.0;
        word = (word ^ (word >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        word = (word ^ (word >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        word ^= word >> 31;
        // Four sums of 12 bits each have the variance 4 / 12.
        let twelve = |at: u32| ((word >> at) & 0xfff) as f32 / 4096.0;
        let sum = twelve(0) + twelve(12) + twelve(24) + twelve(36);
        ((sum - 2.0) * 1.732_050_8, (word >> 48) as u16)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn check_normal(values: &[f64], largest: f64) {
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count;
        assert!(mean.abs() < 0.05 && (variance - 1.0).abs() < 0.06, "mean {mean}, variance {variance}");
        assert!(values.iter().all(|value| value.abs() <= largest));
    }

    #[test]
    fn errors_have_their_spread_and_their_bound() {
        let mut draw = draw(Of::Motion, 1, 2);
        check_normal(&(0..4000).map(|_| normal(&mut draw)).collect::<Vec<_>>(), 3.0);
        let mut noise = PixelNoise::new(&mut draw);
        check_normal(&(0..4000).map(|_| f64::from(noise.next().0)).collect::<Vec<_>>(), 3.5);
    }
}
