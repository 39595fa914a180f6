//! Streams of boxes whose optimum is known, because full containers were cut into them.

use std::ops::RangeInclusive;

use crate::{BoxError, BoxSpec, ContainerSize, Draw};

/// A stream of boxes that is packed from empty containers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Episode {
    /// The container it is meant for.
    pub container: ContainerSize,
    /// The least number of containers that hold all boxes, where known.
    pub optimum: Option<u32>,
    /// The boxes in the order they arrive, numbered from 0.
    pub boxes: Vec<BoxSpec>,
}

/// How perfectly packable episodes are made. Paper: "Results" (synthetic data).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Recipe {
    /// The container that is cut up.
    pub container: ContainerSize,
    /// Cuts lie on multiples of this [mm]; it must divide the container's sides.
    pub lattice_mm: u32,
    /// Shortest side of a box [mm], a multiple of the lattice.
    pub side_min_mm: u32,
    /// Full containers an episode is cut from: its optimum, unless the boxes are [`CutRule::Uncut`].
    pub optimum: u32,
    /// Boxes cut from one container.
    pub boxes_per_container: RangeInclusive<u32>,
    /// Where the cuts fall.
    pub cut_rule: CutRule,
    /// The order in which the boxes arrive.
    pub order: Order,
}

/// Where the cuts of a container fall.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CutRule {
    /// A piece with probability proportional to its volume, an axis proportional to its length there, a cut
    /// uniform over the lattice positions that leave both sides the shortest side.
    VolumeProportional,
    /// Recursive halves: an axis proportional to its length, a cut in its middle half, the number of boxes
    /// shared out by volume.
    Balanced,
    /// Nowhere: every side of every box is uniform over the lattice, from the shortest to this [mm]. The optimum of
    /// such an episode is unknown. The single-container literature works with these.
    Uncut {
        /// Longest side [mm], a multiple of the lattice.
        side_max_mm: u32,
    },
}

/// The order in which the boxes of an episode arrive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// All boxes of the episode, shuffled.
    Shuffled,
    /// Container after container, neighbours of one cut beside each other.
    Cut,
}

/// What an episode may be used for. No two splits share an episode, whatever their seeds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Split {
    /// Learning.
    Training,
    /// Choices between trained models.
    Validation,
    /// Published figures.
    Test,
    /// Boxes for a running cell.
    Live,
}

/// A recipe that no episode can follow.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RecipeError {
    /// A container side, or the shortest box side, is not a multiple of the lattice.
    #[error("a lattice of {lattice_mm} mm does not divide {side_mm} mm")]
    Lattice {
        /// As given.
        lattice_mm: u32,
        /// The side it does not divide.
        side_mm: u32,
    },
    /// No container, or no boxes, or more boxes than there is room for.
    #[error("{boxes:?} boxes from each of {optimum} containers: they cannot be cut")]
    Count {
        /// Containers to cut.
        optimum: u32,
        /// Boxes asked of each.
        boxes: RangeInclusive<u32>,
    },
    /// A piece became a box that cannot be.
    #[error(transparent)]
    Box(#[from] BoxError),
}

/// Draws without a cut before a recipe is given up. The standard recipe needs a handful.
const FRUITLESS_DRAWS_MAX: u32 = 100_000;

/// A cuboid of a container under the knife, in lattice steps.
type Piece = [u32; 3];

impl Recipe {
    /// The standard set: 10 paper containers on a 5 cm lattice, 23 to 37 boxes each, shuffled.
    #[must_use]
    pub fn standard() -> Self {
        Self {
            container: ContainerSize::PAPER,
            lattice_mm: 50,
            side_min_mm: 50,
            optimum: 10,
            boxes_per_container: 23..=37,
            cut_rule: CutRule::VolumeProportional,
            order: Order::Shuffled,
        }
    }

    /// Episode number `index` of the series that `split` and `seed` name: the same on every machine.
    ///
    /// # Errors
    /// [`RecipeError`] if no episode can follow the recipe.
    pub fn episode(&self, split: Split, seed: u64, index: u64) -> Result<Episode, RecipeError> {
        let whole = self.container_steps()?;
        let side_min = self.side_min_mm / self.lattice_mm;
        let count_error = || RecipeError::Count { optimum: self.optimum, boxes: self.boxes_per_container.clone() };
        let (fewest, most) = (*self.boxes_per_container.start(), *self.boxes_per_container.end());
        if self.optimum == 0 || fewest == 0 || fewest > most || side_min == 0 {
            return Err(count_error());
        }
        let mut draw = Draw::new(split as u64, seed, index);
        let mut pieces = Vec::new();
        for _ in 0..self.optimum {
            let count = fewest + draw.below(u64::from(most - fewest) + 1) as u32;
            match self.cut_rule {
                CutRule::VolumeProportional => cut_by_volume(whole, count, side_min, &mut draw, &mut pieces),
                CutRule::Balanced => cut_in_halves(whole, count, side_min, &mut draw, &mut pieces),
                CutRule::Uncut { side_max_mm } => {
                    draw_sides(count, side_min..=side_max_mm / self.lattice_mm, &mut draw, &mut pieces)
                }
            }
            .ok_or_else(count_error)?;
        }
        for piece in &mut pieces {
            if draw.below(2) == 1 {
                piece.swap(0, 1);
            }
        }
        match self.order {
            Order::Shuffled => draw.shuffle(&mut pieces),
            Order::Cut => {}
        }
        let to_box = |(id, piece): (u64, Piece)| BoxSpec::new(id, piece.map(|steps| steps * self.lattice_mm));
        let boxes = (0..).zip(pieces).map(to_box).collect::<Result<_, _>>()?;
        Ok(Episode { container: self.container, optimum: self.known_optimum(), boxes })
    }

    /// The optimum of every episode, where the recipe fixes it.
    #[must_use]
    pub fn known_optimum(&self) -> Option<u32> {
        match self.cut_rule {
            CutRule::VolumeProportional | CutRule::Balanced => Some(self.optimum),
            CutRule::Uncut { .. } => None,
        }
    }

    fn container_steps(&self) -> Result<Piece, RecipeError> {
        let lattice_mm = self.lattice_mm;
        let size = self.container;
        let in_mm = |cells: u16| u32::from(cells) * size.cell_mm();
        let steps = |side_mm: u32| {
            let divides = lattice_mm > 0 && side_mm.is_multiple_of(lattice_mm);
            if divides { Ok(side_mm / lattice_mm) } else { Err(RecipeError::Lattice { lattice_mm, side_mm }) }
        };
        steps(self.side_min_mm)?;
        Ok([steps(in_mm(size.length()))?, steps(in_mm(size.breadth()))?, steps(in_mm(size.height()))?])
    }
}

fn volume(piece: Piece) -> u64 {
    piece.iter().map(|&side| u64::from(side)).product()
}

/// Cuts `piece` at `position` along `axis`.
fn cut(piece: Piece, axis: usize, position: u32) -> [Piece; 2] {
    let (mut low, mut high) = (piece, piece);
    low[axis] = position;
    high[axis] -= position;
    [low, high]
}

/// An axis drawn with probability proportional to its weight.
fn draw_axis(weights: [u32; 3], draw: &mut Draw) -> usize {
    let total: u32 = weights.iter().sum();
    let mut left = draw.below(u64::from(total)) as u32;
    weights
        .iter()
        .position(|&weight| {
            left.checked_sub(weight).is_none_or(|rest| {
                left = rest;
                false
            })
        })
        .unwrap_or(2)
}

fn cut_by_volume(whole: Piece, count: u32, side_min: u32, draw: &mut Draw, pieces: &mut Vec<Piece>) -> Option<()> {
    let first = pieces.len();
    pieces.push(whole);
    let mut fruitless = 0;
    while pieces.len() - first < count as usize {
        let mut left = draw.below(volume(whole));
        let chosen = pieces[first..].iter().position(|&piece| {
            left.checked_sub(volume(piece)).is_none_or(|rest| {
                left = rest;
                false
            })
        })?;
        let piece = pieces[first + chosen];
        let axis = draw_axis(piece, draw);
        if piece[axis] < 2 * side_min {
            fruitless += 1;
            if fruitless > FRUITLESS_DRAWS_MAX {
                return None;
            }
            continue;
        }
        fruitless = 0;
        let position = side_min + draw.below(u64::from(piece[axis] - 2 * side_min) + 1) as u32;
        // Both parts stand where the whole stood, so that the order of the pieces is the order of the cuts.
        pieces.splice(first + chosen..=first + chosen, cut(piece, axis, position));
    }
    Some(())
}

fn draw_sides(count: u32, sides: RangeInclusive<u32>, draw: &mut Draw, pieces: &mut Vec<Piece>) -> Option<()> {
    let choices = u64::from(sides.end().checked_sub(*sides.start())?) + 1;
    pieces.extend((0..count).map(|_| [(); 3].map(|()| sides.start() + draw.below(choices) as u32)));
    Some(())
}

fn cut_in_halves(whole: Piece, count: u32, side_min: u32, draw: &mut Draw, pieces: &mut Vec<Piece>) -> Option<()> {
    let capacity = |piece: Piece| piece.iter().map(|&side| u64::from(side / side_min)).product::<u64>();
    if count == 1 {
        pieces.push(whole);
        return Some(());
    }
    for _ in 0..FRUITLESS_DRAWS_MAX {
        let weights = whole.map(|side| if side < 2 * side_min { 0 } else { side });
        if weights == [0; 3] {
            return None;
        }
        let axis = draw_axis(weights, draw);
        let side = whole[axis];
        let lowest = side.div_ceil(4).max(side_min);
        let highest = (side - side.div_ceil(4)).min(side - side_min).max(lowest);
        let position = lowest + draw.below(u64::from(highest - lowest) + 1) as u32;
        let [low, high] = cut(whole, axis, position);
        let shared = (2 * u64::from(count) * volume(low) + volume(whole)) / (2 * volume(whole));
        let least = u64::from(count).saturating_sub(capacity(high)).max(1);
        let most = capacity(low).min(u64::from(count) - 1);
        if least <= most {
            let share = shared.clamp(least, most) as u32;
            cut_in_halves(low, share, side_min, draw, pieces)?;
            return cut_in_halves(high, count - share, side_min, draw, pieces);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn volume_mm3(episode: &Episode) -> u64 {
        episode.boxes.iter().map(|b| b.size_mm().iter().map(|&side| u64::from(side)).product::<u64>()).sum()
    }

    fn variants() -> Vec<Recipe> {
        let standard = Recipe::standard();
        vec![
            Recipe { cut_rule: CutRule::Balanced, ..standard.clone() },
            Recipe { lattice_mm: 10, side_min_mm: 30, ..standard.clone() },
            Recipe { order: Order::Cut, boxes_per_container: 46..=74, ..standard.clone() },
            Recipe { optimum: 3, cut_rule: CutRule::Balanced, lattice_mm: 10, side_min_mm: 30, ..standard.clone() },
            standard,
        ]
    }

    #[test]
    fn boxes_fill_their_containers_exactly() {
        for recipe in variants() {
            for index in 0..20 {
                let episode = recipe.episode(Split::Test, 7, index).unwrap();
                let count = episode.boxes.len() as u32;
                let (fewest, most) = recipe.boxes_per_container.clone().into_inner();
                assert!((fewest * recipe.optimum..=most * recipe.optimum).contains(&count), "{count}");
                assert_eq!(volume_mm3(&episode), u64::from(recipe.optimum) * 450 * 800 * 500);
                for spec in &episode.boxes {
                    assert!(spec.size_mm().iter().all(|side| side % recipe.lattice_mm == 0));
                    assert!(spec.size_mm().iter().all(|&side| side >= recipe.side_min_mm));
                }
            }
        }
    }

    #[test]
    fn uncut_boxes_have_sides_in_range() {
        let container = ContainerSize::new(10, 10, 10, 10).unwrap();
        let cut_rule = CutRule::Uncut { side_max_mm: 50 };
        let recipe = Recipe { container, lattice_mm: 10, side_min_mm: 10, optimum: 1, cut_rule, ..Recipe::standard() };
        let episode = recipe.episode(Split::Test, 1, 0).unwrap();
        assert_eq!(episode.optimum, None);
        let sides: Vec<_> = episode.boxes.iter().flat_map(BoxSpec::size_mm).collect();
        assert!((10..=50).step_by(10).all(|side| sides.contains(&side)) && sides.iter().all(|side| *side <= 50));
        let recipe = Recipe { cut_rule: CutRule::Uncut { side_max_mm: 0 }, ..recipe };
        assert!(matches!(recipe.episode(Split::Test, 1, 0), Err(RecipeError::Count { .. })));
    }

    #[test]
    fn an_episode_is_the_same_on_every_machine() {
        let episode = Recipe::standard().episode(Split::Test, 1, 0).unwrap();
        let first: Vec<_> = episode.boxes.iter().take(4).map(BoxSpec::size_mm).collect();
        let pinned = vec![[250, 350, 50], [100, 400, 200], [250, 250, 150], [50, 650, 50]];
        assert_eq!((episode.boxes.len(), first), (310, pinned));
    }

    #[test]
    fn splits_seeds_and_indices_give_different_episodes() {
        let recipe = Recipe::standard();
        let base = recipe.episode(Split::Test, 1, 0).unwrap();
        assert_eq!(base, recipe.episode(Split::Test, 1, 0).unwrap());
        assert_ne!(base, recipe.episode(Split::Training, 1, 0).unwrap());
        assert_ne!(base, recipe.episode(Split::Test, 2, 0).unwrap());
        assert_ne!(base, recipe.episode(Split::Test, 1, 1).unwrap());
    }

    #[test]
    fn impossible_recipes_are_refused() {
        let recipe = Recipe { lattice_mm: 40, side_min_mm: 40, ..Recipe::standard() };
        let error = recipe.episode(Split::Test, 1, 0).unwrap_err();
        assert_eq!(error.to_string(), "a lattice of 40 mm does not divide 450 mm");
        let recipe = Recipe { boxes_per_container: 2000..=2000, ..Recipe::standard() };
        assert!(matches!(recipe.episode(Split::Test, 1, 0), Err(RecipeError::Count { .. })));
        let recipe = Recipe { cut_rule: CutRule::Balanced, ..recipe };
        assert!(matches!(recipe.episode(Split::Test, 1, 0), Err(RecipeError::Count { .. })));
    }
}
