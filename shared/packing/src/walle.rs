//! WallE's stability score.

use crate::{Extent, Surface};

/// The weights of WallE's stability score, eq. (1). Paper: section "Freshly crafted heuristic: WallE".
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WalleWeights {
    /// `alpha_1`, on the variation `G_var`.
    pub variation: f32,
    /// `alpha_2`, on the higher border cells `G_high`.
    pub higher: f32,
    /// `alpha_3`, on the flush border cells `G_flush`.
    pub flush: f32,
    /// `alpha_4`, on the position `i + j`.
    pub position: f32,
    /// `alpha_5`, on the base height `h`.
    pub base: f32,
}

/// Weights that no stability score has.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("WallE's weights are {0:?}: they must be five numbers of 0 or more")]
pub struct WeightsError(pub [f32; 5]);

impl WalleWeights {
    /// The weights `alpha_1` to `alpha_5`.
    ///
    /// # Errors
    /// [`WeightsError`] if one is negative, endless or not a number. Paper: "user-defined non-negative parameters".
    pub fn new(alpha: [f32; 5]) -> Result<Self, WeightsError> {
        if !alpha.iter().all(|weight| weight.is_finite() && *weight >= 0.0) {
            return Err(WeightsError(alpha));
        }
        let [variation, higher, flush, position, base] = alpha;
        Ok(Self { variation, higher, flush, position, base })
    }

    /// The values the paper settled on.
    pub const PAPER: Self = Self { variation: 0.75, higher: 1.0, flush: 1.0, position: 0.01, base: 1.0 };

    /// `S = -a1 G_var + a2 G_high + a3 G_flush - a4 (i + j) - a5 h` for a box of `extent` (already turned) that
    /// rests at `base` on `(i, j)`; larger is better. Paper: eq. (1).
    ///
    /// The border is the cells edge-adjacent to the footprint; with `top = base + height`, `G_var` is the sum of
    /// `|cell - top|`, `G_high` counts cells above `top`, `G_flush` cells exactly at `top`. On a wall side all
    /// three terms are zero.
    #[must_use]
    pub fn score(&self, surface: &Surface, extent: Extent, i: u16, j: u16, base: u16) -> f32 {
        let border = Border::of(surface, extent, i, j, base + extent.height);
        -self.variation * border.variation as f32
            + self.higher * border.higher as f32
            + self.flush * border.flush as f32
            - self.position * (f32::from(i) + f32::from(j))
            - self.base * f32::from(base)
    }
}

impl Default for WalleWeights {
    fn default() -> Self {
        Self::PAPER
    }
}

/// The integer terms of eq. (1).
#[derive(Debug, Default, PartialEq)]
struct Border {
    variation: u32,
    higher: u32,
    flush: u32,
}

impl Border {
    /// Goes along the four sides run by run, since neighbouring cells mostly share their height.
    fn of(surface: &Surface, extent: Extent, i: u16, j: u16, top: u16) -> Self {
        let size = surface.size();
        let (i_end, j_end) = (i + extent.length, j + extent.breadth);
        let mut border = Self::default();
        if i > 0 {
            border.add(surface.runs_along_j(i - 1, j..j_end), top);
        }
        if i_end < size.length() {
            border.add(surface.runs_along_j(i_end, j..j_end), top);
        }
        if j > 0 {
            border.add(surface.runs_along_i(i..i_end, j - 1), top);
        }
        if j_end < size.breadth() {
            border.add(surface.runs_along_i(i..i_end, j_end), top);
        }
        border
    }

    fn add(&mut self, runs: impl Iterator<Item = (u16, u16)>, top: u16) {
        for (height, cells) in runs {
            let cells = u32::from(cells);
            self.variation += cells * u32::from(height.abs_diff(top));
            self.higher += cells * u32::from(height > top);
            self.flush += cells * u32::from(height == top);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ContainerSize;

    /// Heights 4 4 0 / 0 0 0 / 2 0 0 around a 1 x 2 x 2 box at (1, 0): above it 4 4, below it 2 0, right of it 0.
    #[test]
    fn equation_1_by_hand() {
        let mut surface = Surface::empty(ContainerSize::new(3, 3, 9, 10).unwrap());
        surface.set_heights(&[4, 4, 0, 0, 0, 0, 2, 0, 0]);
        let extent = Extent { length: 1, breadth: 2, height: 2 };
        let border = Border::of(&surface, extent, 1, 0, 2);
        // |4-2| + |4-2| + |2-2| + |0-2| + |0-2|, two cells above, one flush; the left side is a wall.
        assert_eq!(border, Border { variation: 8, higher: 2, flush: 1 });
        let score = WalleWeights::PAPER.score(&surface, extent, 1, 0, 0);
        assert!((score - (-0.75 * 8.0 + 2.0 + 1.0 - 0.01)).abs() < 1e-6, "{score}");
    }

    #[test]
    fn weights_are_checked() {
        assert_eq!(WalleWeights::new([0.75, 1.0, 1.0, 0.01, 1.0]), Ok(WalleWeights::PAPER));
        assert!(WalleWeights::new([0.75, 1.0, -1.0, 0.01, 1.0]).is_err());
        assert!(WalleWeights::new([f32::NAN; 5]).is_err());
    }

    #[test]
    fn walls_count_nothing() {
        let surface = Surface::empty(ContainerSize::new(2, 2, 9, 10).unwrap());
        let extent = Extent { length: 2, breadth: 2, height: 3 };
        assert_eq!(WalleWeights::PAPER.score(&surface, extent, 0, 0, 0), 0.0);
    }

    #[test]
    fn the_base_and_the_position_cost() {
        let mut surface = Surface::empty(ContainerSize::new(3, 3, 9, 10).unwrap());
        surface.set_heights(&[3; 9]);
        let extent = Extent { length: 1, breadth: 1, height: 1 };
        // Four border cells at 3 against a top of 4, at (1, 1) on a base of 3.
        let score = WalleWeights::PAPER.score(&surface, extent, 1, 1, 3);
        assert!((score - (-0.75 * 4.0 - 0.02 - 3.0)).abs() < 1e-6, "{score}");
    }
}
