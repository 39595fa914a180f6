//! The data sets that have a name and are generated.

use packing::{ContainerSize, CutRule, Episode, Order, Recipe, RecipeError, Split};

use crate::{DataSet, Skipped};

/// A data set that is generated from a recipe.
#[derive(Debug)]
pub struct Named {
    /// What it is called.
    pub name: &'static str,
    /// What it is, in one line.
    pub about: &'static str,
    /// Containers that stand in the cell (`T`) unless told otherwise.
    pub slots: usize,
    recipe: fn() -> Recipe,
}

/// Every named data set.
pub const NAMED: [Named; 7] = [
    Named {
        name: "standard",
        about: "10 containers of 45 x 80 x 50 cm, 230 to 370 boxes, 5 cm lattice, shuffled",
        slots: 16,
        recipe: Recipe::standard,
    },
    Named {
        name: "cut-order",
        about: "standard, but the boxes arrive in the order they were cut",
        slots: 16,
        recipe: || Recipe { order: Order::Cut, ..Recipe::standard() },
    },
    Named {
        name: "fine",
        about: "standard, but on a 1 cm lattice with sides of 3 cm or more",
        slots: 16,
        recipe: || Recipe { lattice_mm: 10, side_min_mm: 30, ..Recipe::standard() },
    },
    Named {
        name: "small-boxes",
        about: "standard, but twice as many boxes from the same volume",
        slots: 16,
        recipe: || Recipe { boxes_per_container: 46..=74, ..Recipe::standard() },
    },
    Named {
        name: "three",
        about: "standard, but cut from 3 containers, for a cell of 6",
        slots: 6,
        recipe: || Recipe { optimum: 3, ..Recipe::standard() },
    },
    Named {
        name: "balanced",
        about: "standard, but every cut near the middle, so that the boxes are more alike",
        slots: 16,
        recipe: || Recipe { cut_rule: CutRule::Balanced, ..Recipe::standard() },
    },
    Named {
        name: "ten",
        about: "100 boxes with sides of 1 to 5 cells for one container of 10 x 10 x 10, as the single-container literature",
        slots: 1,
        recipe: || Recipe {
            container: ContainerSize::TEN,
            lattice_mm: 10,
            side_min_mm: 10,
            optimum: 1,
            boxes_per_container: 100..=100,
            cut_rule: CutRule::Uncut { side_max_mm: 50 },
            order: Order::Shuffled,
        },
    },
];

/// A name that no data set has.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no data set {0:?}: use one of {names}, or a file that ends in .json or .csv", names = NAMED.map(|n| n.name).join(", "))]
pub struct UnknownName(pub String);

impl Named {
    /// The data set called `name`.
    ///
    /// # Errors
    /// [`UnknownName`] lists those that exist.
    pub fn find(name: &str) -> Result<&'static Self, UnknownName> {
        NAMED.iter().find(|named| named.name == name).ok_or_else(|| UnknownName(name.to_owned()))
    }

    /// How its episodes are made.
    #[must_use]
    pub fn recipe(&self) -> Recipe {
        (self.recipe)()
    }

    /// The first `episodes` episodes of the series that `split` and `seed` name.
    ///
    /// # Errors
    /// [`RecipeError`], which no recipe of the table gives.
    pub fn generate(&self, split: Split, seed: u64, episodes: usize) -> Result<DataSet, RecipeError> {
        let recipe = self.recipe();
        let boxes = |index| recipe.episode(split, seed, index).map(|Episode { boxes, .. }| boxes);
        Ok(DataSet {
            name: self.name.to_owned(),
            container: recipe.container,
            optimum: recipe.known_optimum(),
            episodes: (0..episodes as u64).map(boxes).collect::<Result<_, _>>()?,
            skipped: Skipped::default(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_generates_its_set() {
        for named in &NAMED {
            let set = Named::find(named.name).unwrap().generate(Split::Test, 1, 3).unwrap();
            assert_eq!((set.name.as_str(), set.episodes.len()), (named.name, 3));
            assert!(set.container.check_slots(named.slots).is_ok(), "{}", named.name);
        }
        assert!(Named::find("standrad").unwrap_err().to_string().contains("small-boxes"));
    }

    #[test]
    fn small_boxes_are_about_twice_as_many() {
        let count = |name| Named::find(name).unwrap().generate(Split::Test, 1, 10).unwrap().episodes.concat().len();
        let ratio = count("small-boxes") as f64 / count("standard") as f64;
        assert!((1.8..2.2).contains(&ratio), "{ratio}");
    }
}
