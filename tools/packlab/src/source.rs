//! What `--data` names: a generated data set or a file.

use std::path::Path;

use anyhow::Context as _;
use clap::ValueEnum;
use dataset::{DataSet, Named, ReadOptions};
use packing::{ContainerSize, GRID_CELLS_MAX, SLOTS_MAX, Split};

/// Containers that stand in the cell for a file, where there is room: the paper's number.
const SLOTS: usize = 16;

/// Episodes of a named data set unless told otherwise: as many as the paper's test.
const EPISODES: usize = 100;

/// Which episodes of a named data set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Episodes {
    /// For figures that are published; they decide nothing.
    Test,
    /// For choices between models.
    Validation,
}

/// A data set, and how many containers stand in the cell unless told otherwise.
pub(crate) struct Source {
    pub(crate) set: DataSet,
    pub(crate) slots: usize,
}

impl Source {
    /// Loads what `data` names, with no more than `count` episodes.
    pub(crate) fn load(
        data: &str,
        count: Option<usize>,
        seed: u64,
        episodes: Episodes,
        options: &ReadOptions,
    ) -> anyhow::Result<Self> {
        let path = Path::new(data);
        let is_file = path.extension().is_some() || data.contains(std::path::MAIN_SEPARATOR);
        if !is_file {
            let named = Named::find(data)?;
            let (split, note) = match episodes {
                Episodes::Test => (Split::Test, ""),
                Episodes::Validation => (Split::Validation, " (validation)"),
            };
            let mut set = named
                .generate(split, seed, count.unwrap_or(EPISODES))
                .with_context(|| format!("data set {data} cannot be made"))?;
            set.name.push_str(note);
            return Ok(Self { set, slots: named.slots });
        }
        let mut set = dataset::read(path, options)?;
        set.episodes.truncate(count.unwrap_or(usize::MAX));
        let slots = SLOTS.min(slots_max(set.container));
        Ok(Self { set, slots })
    }
}

/// Most containers of this size that make a grid.
pub(crate) fn slots_max(container: ContainerSize) -> usize {
    SLOTS_MAX.min(GRID_CELLS_MAX / container.footprint_cells())
}
