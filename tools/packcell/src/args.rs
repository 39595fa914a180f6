//! The settings of a cell that a person gives on a command line.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use dataset::{DataSet, Named, ReadOptions};
use packing::Split;
use runtime::{BusConfig, Config, StateConfig, WorldKind};
use rustix::process::geteuid;

/// The configuration of the installed cell.
pub(crate) const INSTALLED: &str = "/etc/packcell/packcell.toml";

/// What the processes of a cell are told that 'packcell up' started, in the directory of its bus.
pub(crate) const CELL_FILE: &str = "cell.toml";

/// What a cell packs, and how.
#[derive(Debug, clap::Args)]
pub(crate) struct CellArgs {
    /// Configuration file; without it, the documented defaults on a bus of your own
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    #[arg(long, value_name = "FILE|NAME", help = data_help())]
    data: Option<String>,
    /// Seed of a generated stream
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Interval between two boxes, in milliseconds; 0 for as fast as the cell decides
    #[arg(long, value_name = "MS")]
    pace: Option<u64>,
    /// Containers open at one time
    #[arg(long, value_name = "N")]
    open: Option<usize>,
    /// The scorer's policy
    #[arg(long, value_name = "NAME")]
    policy: Option<String>,
    /// The policy's model file; without it, the built-in model
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// What boxes do in the stub's world: geometric (they stand where they are set down) or physics (they slide, tilt
    /// and fall)
    #[arg(long, value_name = "KIND", value_parser = world_kind)]
    world: Option<WorldKind>,
    /// Overrides one key of the configuration, for example --set commander.hard_deadline_ms=30
    #[arg(long = "set", value_name = "KEY=VALUE")]
    overrides: Vec<String>,
}

impl CellArgs {
    /// The configuration that the file and the flags make.
    pub(crate) fn config(&self) -> anyhow::Result<Config> {
        let mut config = match &self.config {
            Some(path) => Config::load(path, &self.overrides)?,
            None => own_cell()?.overridden(&self.overrides)?,
        };
        if let Some(data) = &self.data {
            config.perception.stream = if Path::new(data).extension().is_some() {
                let path = std::path::absolute(data).with_context(|| format!("--data {data}"))?;
                path.to_str().with_context(|| format!("--data {data}: its path is not UTF-8"))?.to_owned()
            } else {
                data.clone()
            };
        }
        if let Some(model) = &self.model {
            config.scorer.model = std::path::absolute(model).context("--model")?;
        }
        config.perception.seed = self.seed.unwrap_or(config.perception.seed);
        config.perception.pace_ms = self.pace.unwrap_or(config.perception.pace_ms);
        let named_slots = self.data.as_deref().and_then(|name| Named::find(name).ok()).map(|named| named.slots);
        config.container.slots = self.open.or(named_slots).unwrap_or(config.container.slots);
        config.scorer.policy = self.policy.clone().unwrap_or(config.scorer.policy);
        config.world.kind = self.world.unwrap_or(config.world.kind);
        config.check()?;
        Ok(config)
    }

    /// The configuration that the running cell on the meant bus has, as far as it can be known.
    pub(crate) fn running_config(&self) -> anyhow::Result<Config> {
        Ok(Config::load(&running_file(self.config.as_deref(), &self.overrides)?, &self.overrides)?)
    }

    /// Whether a policy or a model was asked for.
    pub(crate) fn names_policy(&self) -> bool {
        self.policy.is_some() || self.model.is_some()
    }

    /// Whether it was said where the state is kept.
    pub(crate) fn names_state(&self) -> bool {
        self.config.is_some() || self.overrides.iter().any(|text| text.starts_with("state.dir"))
    }

    /// Whether a pace was asked for.
    pub(crate) fn names_pace(&self) -> bool {
        let overrides_pace = self.overrides.iter().any(|text| text.starts_with("perception.pace_ms"));
        self.pace.is_some() || self.config.is_some() || overrides_pace
    }
}

/// Which of the cells on this machine is meant.
#[derive(Debug, clap::Args)]
pub(crate) struct WhichCell {
    /// The configuration of the cell; without it, the cell that you keep running with 'packcell up', or else the
    /// installed one
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Overrides one key of the configuration, for example --set bus.root_dir=/dev/shm/two.bus
    #[arg(long = "set", value_name = "KEY=VALUE")]
    overrides: Vec<String>,
}

impl WhichCell {
    /// Its configuration, as far as it can be known.
    pub(crate) fn config(&self) -> anyhow::Result<Config> {
        Ok(Config::load(&self.file()?, &self.overrides)?)
    }

    /// The file that holds it.
    pub(crate) fn file(&self) -> anyhow::Result<PathBuf> {
        running_file(self.config.as_deref(), &self.overrides)
    }
}

/// The configuration file of the cell that is meant by these flags.
fn running_file(file: Option<&Path>, overrides: &[String]) -> anyhow::Result<PathBuf> {
    if let Some(path) = file {
        return Ok(path.to_owned());
    }
    let own = own_cell()?.overridden(overrides)?.bus.root_dir.join(CELL_FILE);
    if own.exists() {
        return Ok(own);
    }
    let installed = PathBuf::from(INSTALLED);
    if installed.exists() {
        return Ok(installed);
    }
    bail!(
        "no cell runs on the bus {}: start one with 'packcell up', or an installed one with \
         'systemctl start packcell.target'",
        own.parent().unwrap_or(&own).display()
    )
}

/// The cell that a person runs without an installation: the documented defaults, with a bus and a state of this user.
fn own_cell() -> anyhow::Result<Config> {
    let home = std::env::home_dir().filter(|home| home.is_absolute());
    let home = home.context("there is no home directory to keep a cell's state in: use --config FILE")?;
    let state = StateConfig { dir: home.join(".local/state/packcell") };
    Ok(Config { bus: BusConfig::of_user(geteuid().as_raw()), state, ..Config::default() })
}

/// The kind of world of this name.
fn world_kind(name: &str) -> Result<WorldKind, String> {
    match name {
        "geometric" => Ok(WorldKind::Geometric),
        "physics" => Ok(WorldKind::Physics),
        _ => Err("use geometric or physics".to_owned()),
    }
}

fn data_help() -> String {
    let names: Vec<&str> = dataset::NAMED.iter().map(|named| named.name).collect();
    format!("Boxes to pack: an episode file (.json or .csv), or the name of a data set: {}", names.join(", "))
}

/// The boxes that a cell of this configuration will see first: all episodes of a file, or one generated episode.
/// The container of a file becomes the cell's.
pub(crate) fn expected_boxes(config: &mut Config) -> anyhow::Result<DataSet> {
    let stream = config.perception.stream.clone();
    let size = config.container_size()?;
    let set = if Path::new(&stream).extension().is_some() {
        dataset::read(Path::new(&stream), &ReadOptions { container: size, skip_bad: false })?
    } else {
        Named::find(&stream)?.generate(Split::Live, config.perception.seed, 1)?
    };
    let container = &mut config.container;
    (container.length_cells, container.breadth_cells) = (set.container.length(), set.container.breadth());
    (container.height_cells, container.cell_mm) = (set.container.height(), set.container.cell_mm());
    config.check()?;
    Ok(set)
}
