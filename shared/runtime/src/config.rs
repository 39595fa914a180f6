//! The one configuration file of a cell.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use messages::Instance;
use packing::{ClosePolicy, ContainerSize, Rules, SizeError, Support, WalleWeights, WeightsError};
use serde::{Deserialize, Serialize};
use tracing_subscriber::filter::LevelFilter;

/// Everything that can be set. Its defaults are those of `deploy/packcell.toml`, which explains every key.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Where the processes meet.
    pub bus: BusConfig,
    /// What must outlive the processes.
    pub state: StateConfig,
    /// What is filled.
    pub container: ContainerConfig,
    /// What a box may stand on, and how near to anything.
    pub rules: RulesConfig,
    /// The stub of the physical side.
    pub perception: PerceptionConfig,
    /// How wrong the stub's world is.
    pub world: WorldConfig,
    /// What is believed of the containers.
    pub belief: BeliefConfig,
    /// The candidate generator.
    pub candidates: CandidatesConfig,
    /// The scorers.
    pub scorer: ScorerConfig,
    /// The commander.
    pub commander: CommanderConfig,
    /// What is logged.
    pub log: LogConfig,
}

/// Where the processes meet.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BusConfig {
    /// Directory of the bus's files; on tmpfs.
    pub root_dir: PathBuf,
    /// First letters of the names of the bus's shared memory.
    pub prefix: String,
}

/// What must outlive the processes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StateConfig {
    /// Directory of the journal, the stub's world and the scorers' models; on a disk.
    pub dir: PathBuf,
}

/// What is filled.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ContainerConfig {
    /// Cells along `i`.
    pub length_cells: u16,
    /// Cells along `j`.
    pub breadth_cells: u16,
    /// Height limit [cells].
    pub height_cells: u16,
    /// Side of a grid cell [mm].
    pub cell_mm: u32,
    /// Containers that stand in the cell.
    pub slots: usize,
}

/// What a box may stand on, and how near to anything. Perception publishes it with the belief; nobody else reads it here.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RulesConfig {
    /// What a box keeps free on each of its sides [mm].
    pub clearance_mm: u16,
    /// Heights that differ by no more count as level [mm].
    pub level_mm: u16,
}

/// The stub of the physical side.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PerceptionConfig {
    /// The boxes that come: a data set's name or an episode file.
    pub stream: String,
    /// Seed of a generated stream.
    pub seed: u64,
    /// Episodes until the stream ends; 0 for one without end.
    pub episodes: u64,
    /// Interval at which boxes reach the pick position [ms]; 0 for as soon as the last one is placed.
    pub pace_ms: u64,
    /// Upcoming boxes that are known.
    pub upcoming: usize,
    /// How long the arm takes for a motion [ms].
    pub motion_ms: u64,
    /// How often an observation is said again until the arm has the box [ms].
    pub repeat_ms: u64,
}

/// How wrong the stub's world is; not at all by default.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WorldConfig {
    /// What boxes do in it.
    pub kind: WorldKind,
    /// Fixes all errors.
    pub seed: u64,
    /// Standard deviation of where the arm sets a box down, along each axis [mm].
    pub actuator_mm: f64,
    /// Standard deviation of how far the arm turns a box askew [degrees].
    pub yaw_deg: f64,
    /// Standard deviation of each side that is measured at the pick [mm].
    pub size_mm: f64,
    /// Probability that the arm refuses a command [-].
    pub refuse_share: f64,
    /// Probability that a box is lost on its way and the arm does not notice [-].
    pub drop_share: f64,
    /// How far a box gives way to one that is set down into it [mm].
    pub push_mm: f64,
    /// Standard deviation of the camera's heights, pixel by pixel [mm].
    pub camera_mm: f64,
    /// Standard deviation of where the camera sees everything, along each axis and look by look [mm].
    pub camera_shift_mm: f64,
    /// Share of the pixels of a frame in which the camera sees nothing [-].
    pub camera_dropout_share: f64,
    /// What is wrong with the camera.
    pub camera_fault: CameraFault,
    /// From which box on.
    pub camera_fault_from: u64,
    /// For how many looks; 0 for ever.
    pub camera_fault_looks: u64,
}

/// What boxes do in the stub's world.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum WorldKind {
    /// They stand where they are set down.
    #[default]
    Geometric,
    /// They are rigid bodies: they slide, tilt and fall until they lie still.
    Physics,
}

/// What can be wrong with the stub's camera.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CameraFault {
    /// Nothing.
    #[default]
    None,
    /// Its heights are no numbers.
    NotANumber,
    /// Its heights are infinite.
    Infinite,
    /// Its frames have a row too few.
    WrongSize,
    /// It says the last frames again.
    Frozen,
    /// It says nothing.
    Away,
}

/// What is believed of the containers.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BeliefConfig {
    /// What it comes from.
    pub source: BeliefSource,
    /// A box that is seen no farther from where it was commanded to is believed to stand there [mm].
    pub tolerance_mm: u16,
    /// Frames that the camera takes after every box.
    pub frames: usize,
    /// What happens while the camera cannot be trusted.
    pub without_camera: WithoutCamera,
}

/// What the belief comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BeliefSource {
    /// What the arm was commanded to do and reported as done.
    #[default]
    Commanded,
    /// That, corrected by what a camera sees.
    Camera,
}

/// What happens while the camera cannot be trusted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum WithoutCamera {
    /// What was commanded is believed, under an alarm.
    GoOn,
    /// No box is taken until the camera sees again.
    #[default]
    Stop,
}

/// The candidate generator.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CandidatesConfig {
    /// `alpha_1` to `alpha_5` of WallE's stability score.
    pub walle_weights: [f32; 5],
}

/// The scorers.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ScorerConfig {
    /// The policy's name.
    pub policy: String,
    /// Its model file; empty for the one that is built in.
    pub model: PathBuf,
    /// What computes the network.
    pub engine: String,
    /// How long a policy that plans may think about one box [us].
    pub think_us: u64,
}

/// The commander.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CommanderConfig {
    /// After this, any scorer's decision is taken [ms after the observation].
    pub soft_deadline_ms: u64,
    /// After this, WallE's ranking is taken [ms after the observation].
    pub hard_deadline_ms: u64,
    /// Which container leaves when a box fits nowhere.
    pub close_policy: String,
    /// Size at which the journal is put aside and a new one begun [MiB].
    pub journal_mib: u64,
}

/// What is logged.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LogConfig {
    /// The least important lines that are still written.
    pub level: LogLevel,
}

/// How important a log line is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LogLevel {
    /// Something is lost or stopped.
    Error,
    /// Something was refused or replaced.
    Warn,
    /// Processes come and go.
    #[default]
    Info,
    /// Every box.
    Debug,
}

/// Why a configuration was refused.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read the configuration {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// What the operating system says.
        source: std::io::Error,
    },
    /// The file is not a configuration.
    #[error("{path} is not a valid configuration: {message}")]
    Parse {
        /// The file.
        path: PathBuf,
        /// Where and why.
        message: String,
    },
    /// An override is none.
    #[error("--set {text}: write it as section.key=value, for example commander.hard_deadline_ms=30")]
    Override {
        /// As given.
        text: String,
    },
    /// An override names a key or value that does not exist.
    #[error("--set {text}: {message}")]
    Overridden {
        /// As given.
        text: String,
        /// What is wrong with it.
        message: String,
    },
    /// A value is out of range.
    #[error("{key} = {value}: {rule}")]
    Range {
        /// The key.
        key: &'static str,
        /// As given.
        value: String,
        /// What it must be.
        rule: &'static str,
    },
    /// The container is none.
    #[error("section [container]: {0}")]
    Container(#[from] SizeError),
    /// WallE's weights are none.
    #[error("candidates.walle_weights: {0}")]
    Weights(#[from] WeightsError),
    /// The close policy is none.
    #[error("commander.close_policy: {0}")]
    ClosePolicy(String),
}

impl BusConfig {
    /// The bus of the cell that the user `uid` keeps running without an installation.
    #[must_use]
    pub fn of_user(uid: u32) -> Self {
        Self { root_dir: format!("/dev/shm/packcell-{uid}.bus").into(), prefix: format!("packcell{uid}_") }
    }
}

impl Default for BusConfig {
    fn default() -> Self {
        Self { root_dir: "/run/packcell/bus".into(), prefix: "packcell_".into() }
    }
}

impl Default for StateConfig {
    fn default() -> Self {
        Self { dir: "/var/lib/packcell".into() }
    }
}

impl StateConfig {
    /// The commander's journal.
    #[must_use]
    pub fn journal(&self) -> PathBuf {
        self.dir.join("journal.bin")
    }

    /// What the stub of the physical side remembers.
    #[must_use]
    pub fn world(&self) -> PathBuf {
        self.dir.join("world.bin")
    }

    /// The settings of one scorer instance, if it has its own: a file with the keys of the section `[scorer]`.
    #[must_use]
    pub fn scorer(&self, instance: Instance) -> PathBuf {
        self.dir.join(format!("scorer-{instance}.toml"))
    }

    /// The scorer instances that have settings of their own.
    #[must_use]
    pub fn scorers(&self) -> Vec<Instance> {
        Instance::all().filter(|&instance| self.scorer(instance).exists()).collect()
    }
}

impl Default for ContainerConfig {
    fn default() -> Self {
        let paper = ContainerSize::PAPER;
        let (length_cells, breadth_cells, height_cells) = (paper.length(), paper.breadth(), paper.height());
        Self { length_cells, breadth_cells, height_cells, cell_mm: paper.cell_mm(), slots: 16 }
    }
}

impl Default for PerceptionConfig {
    fn default() -> Self {
        let stream = "standard".into();
        Self { stream, seed: 1, episodes: 0, pace_ms: 1000, upcoming: 2, motion_ms: 0, repeat_ms: 20 }
    }
}

impl Default for WorldConfig {
    fn default() -> Self {
        let (actuator_mm, yaw_deg, size_mm, refuse_share, drop_share, push_mm) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        let (camera_mm, camera_shift_mm, camera_dropout_share) = (1.0, 0.0, 0.0);
        let (camera_fault, camera_fault_from, camera_fault_looks) = (CameraFault::None, 0, 0);
        Self {
            kind: WorldKind::Geometric,
            seed: 1,
            actuator_mm,
            yaw_deg,
            size_mm,
            refuse_share,
            drop_share,
            push_mm,
            camera_mm,
            camera_shift_mm,
            camera_dropout_share,
            camera_fault,
            camera_fault_from,
            camera_fault_looks,
        }
    }
}

impl Default for BeliefConfig {
    fn default() -> Self {
        let (source, without_camera) = (BeliefSource::Commanded, WithoutCamera::Stop);
        Self { source, tolerance_mm: 5, frames: 5, without_camera }
    }
}

impl Default for CandidatesConfig {
    fn default() -> Self {
        Self { walle_weights: [0.75, 1.0, 1.0, 0.01, 1.0] }
    }
}

impl Default for ScorerConfig {
    fn default() -> Self {
        let (policy, engine) = ("packman-lookahead".into(), "fused".into());
        Self { policy, model: PathBuf::new(), engine, think_us: 2000 }
    }
}

impl Default for CommanderConfig {
    fn default() -> Self {
        Self { soft_deadline_ms: 12, hard_deadline_ms: 25, close_policy: "fullest".into(), journal_mib: 64 }
    }
}

impl Config {
    /// Reads a configuration file and applies overrides of the form `section.key=value`.
    ///
    /// # Errors
    /// [`ConfigError`] says which file, key or value is wrong, and what it must be.
    pub fn load(path: &Path, overrides: &[String]) -> Result<Self, ConfigError> {
        let text = fs::read_to_string(path).map_err(|source| ConfigError::Read { path: path.into(), source })?;
        let parse = |error: toml::de::Error| ConfigError::Parse { path: path.into(), message: error.to_string() };
        toml::from_str::<Self>(&text).map_err(parse)?.overridden(overrides)
    }

    /// The settings of one scorer instance: its own file in the state directory, or the section `[scorer]`.
    ///
    /// # Errors
    /// [`ConfigError`] says what is wrong with the instance's file.
    pub fn scorer_instance(&self, instance: Instance) -> Result<ScorerConfig, ConfigError> {
        let path = self.state.scorer(instance);
        match fs::read_to_string(&path) {
            Ok(text) => toml::from_str(&text).map_err(|error| ConfigError::Parse { path, message: error.to_string() }),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(self.scorer.clone()),
            Err(source) => Err(ConfigError::Read { path, source }),
        }
    }

    /// This configuration with overrides of the form `section.key=value`.
    ///
    /// # Errors
    /// [`ConfigError`] says which key or value is wrong, and what it must be.
    pub fn overridden(self, overrides: &[String]) -> Result<Self, ConfigError> {
        let mut config = self;
        for text in overrides {
            let invalid =
                |error: &dyn Display| ConfigError::Overridden { text: text.clone(), message: error.to_string() };
            let mut table = toml::Table::try_from(&config).map_err(|error| invalid(&error))?;
            merge(&mut table, parse_override(text)?);
            config = Self::deserialize(table).map_err(|error| invalid(&error))?;
        }
        config.check()?;
        Ok(config)
    }

    /// The file that reads back as this configuration.
    #[must_use]
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("plain sections of plain values are a TOML document")
    }

    /// The keys, as `section.key`, to which `other` gives another value.
    #[must_use]
    pub fn changed_keys(&self, other: &Self) -> Vec<String> {
        let keys = |config: &Self| {
            let table = toml::Table::try_from(config).expect("plain sections of plain values are a TOML document");
            let sections = table.into_iter().filter_map(|(name, section)| Some((name, section.as_table()?.clone())));
            sections
                .flat_map(|(name, section)| {
                    section.into_iter().map(move |(key, value)| (format!("{name}.{key}"), value))
                })
                .collect::<BTreeMap<_, _>>()
        };
        let other = keys(other);
        keys(self).into_iter().filter(|(key, value)| other.get(key) != Some(value)).map(|(key, _)| key).collect()
    }

    /// The size of the containers.
    ///
    /// # Errors
    /// [`ConfigError::Container`].
    pub fn container_size(&self) -> Result<ContainerSize, ConfigError> {
        let ContainerConfig { length_cells, breadth_cells, height_cells, cell_mm, slots } = self.container;
        let size = ContainerSize::new(length_cells, breadth_cells, height_cells, cell_mm)?;
        size.check_slots(slots)?;
        Ok(size)
    }

    /// What a box may stand on, and how near to anything.
    #[must_use]
    pub fn rules(&self) -> Rules {
        let RulesConfig { clearance_mm, level_mm } = self.rules;
        Rules { support: Support::Full, clearance_mm, level_mm }
    }

    /// WallE's weights.
    ///
    /// # Errors
    /// [`ConfigError::Weights`].
    pub fn walle_weights(&self) -> Result<WalleWeights, ConfigError> {
        Ok(WalleWeights::new(self.candidates.walle_weights)?)
    }

    /// Which container leaves when a box fits nowhere.
    ///
    /// # Errors
    /// [`ConfigError::ClosePolicy`].
    pub fn close_policy(&self) -> Result<ClosePolicy, ConfigError> {
        self.commander.close_policy.parse().map_err(ConfigError::ClosePolicy)
    }

    /// Whether all values are in range.
    ///
    /// # Errors
    /// [`ConfigError`] at the first that is not.
    pub fn check(&self) -> Result<(), ConfigError> {
        let in_range = |key, value: u64, range: std::ops::RangeInclusive<u64>, rule| {
            if range.contains(&value) {
                Ok(())
            } else {
                Err(ConfigError::Range { key, value: value.to_string(), rule })
            }
        };
        self.container_size()?;
        self.close_policy()?;
        let RulesConfig { clearance_mm, level_mm } = self.rules;
        in_range("rules.clearance_mm", clearance_mm.into(), 0..=500, "it must be at most half a metre")?;
        in_range("rules.level_mm", level_mm.into(), 0..=500, "it must be at most half a metre")?;
        self.check_world()?;
        in_range("belief.tolerance_mm", self.belief.tolerance_mm.into(), 0..=500, "it must be at most half a metre")?;
        in_range("belief.frames", self.belief.frames as u64, 1..=9, "it must be 1 to 9 frames")?;
        let CommanderConfig { soft_deadline_ms, hard_deadline_ms, .. } = self.commander;
        in_range("commander.hard_deadline_ms", hard_deadline_ms, 1..=1000, "it must be 1 to 1000 ms")?;
        let rule = "it must not be later than commander.hard_deadline_ms";
        in_range("commander.soft_deadline_ms", soft_deadline_ms, 0..=hard_deadline_ms, rule)?;
        let rule = "it must be at most 10 ms, a quarter of the budget";
        in_range("scorer.think_us", self.scorer.think_us, 0..=10_000, rule)?;
        let PerceptionConfig { pace_ms, motion_ms, repeat_ms, upcoming, .. } = self.perception;
        in_range("commander.journal_mib", self.commander.journal_mib, 1..=1 << 20, "it must be 1 MiB to 1 TiB")?;
        in_range("perception.upcoming", upcoming as u64, 0..=8, "at most 8 upcoming boxes can be known")?;
        in_range("perception.pace_ms", pace_ms, 0..=3_600_000, "it must be at most an hour")?;
        in_range("perception.motion_ms", motion_ms, 0..=3_600_000, "it must be at most an hour")?;
        in_range("perception.repeat_ms", repeat_ms, 1..=1000, "it must be 1 to 1000 ms")?;
        self.walle_weights().map(drop)
    }
}

impl Config {
    fn check_world(&self) -> Result<(), ConfigError> {
        let world = &self.world;
        let length = "it must be 0 to 500 mm";
        let share = "it must be a share from 0 to 1";
        for (key, value, most, rule) in [
            ("world.actuator_mm", world.actuator_mm, 500.0, length),
            ("world.yaw_deg", world.yaw_deg, 15.0, "it must be 0 to 15 degrees"),
            ("world.size_mm", world.size_mm, 500.0, length),
            ("world.refuse_share", world.refuse_share, 1.0, share),
            ("world.drop_share", world.drop_share, 1.0, share),
            ("world.push_mm", world.push_mm, 500.0, length),
            ("world.camera_mm", world.camera_mm, 500.0, length),
            ("world.camera_shift_mm", world.camera_shift_mm, 500.0, length),
            ("world.camera_dropout_share", world.camera_dropout_share, 1.0, share),
        ] {
            if !(0.0..=most).contains(&value) {
                return Err(ConfigError::Range { key, value: value.to_string(), rule });
            }
        }
        if world.kind == WorldKind::Physics && world.push_mm != 0.0 {
            let (key, value) = ("world.push_mm", world.push_mm.to_string());
            let rule = "it must be 0 in a world of physics (world.kind), where boxes give way as they do";
            return Err(ConfigError::Range { key, value, rule });
        }
        Ok(())
    }
}

impl LogLevel {
    pub(crate) fn filter(self) -> LevelFilter {
        match self {
            Self::Error => LevelFilter::ERROR,
            Self::Warn => LevelFilter::WARN,
            Self::Info => LevelFilter::INFO,
            Self::Debug => LevelFilter::DEBUG,
        }
    }
}

/// `section.key=value` as a table; a value that is no TOML is text.
fn parse_override(text: &str) -> Result<toml::Table, ConfigError> {
    let invalid = || ConfigError::Override { text: text.to_owned() };
    let (key, value) = text.split_once('=').ok_or_else(invalid)?;
    let is_key = key.split('.').count() == 2 && key.chars().all(|c| c.is_ascii_alphanumeric() || "._".contains(c));
    if !is_key {
        return Err(invalid());
    }
    let as_text = || toml::from_str(&format!("{key} = {}", toml::Value::String(value.to_owned())));
    toml::from_str(&format!("{key} = {value}")).or_else(|_| as_text()).map_err(|_| invalid())
}

/// Puts the values of `over` into `table`, section by section.
fn merge(table: &mut toml::Table, over: toml::Table) {
    for (key, value) in over {
        match (table.get_mut(&key), value) {
            (Some(toml::Value::Table(section)), toml::Value::Table(over)) => merge(section, over),
            (_, value) => {
                table.insert(key, value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn load(text: &str, overrides: &[&str]) -> Result<Config, ConfigError> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("packcell.toml");
        fs::write(&path, text).unwrap();
        Config::load(&path, &overrides.iter().map(|&o| o.to_owned()).collect::<Vec<_>>())
    }

    #[track_caller]
    fn refused(text: &str, overrides: &[&str], says: &str) {
        let message = load(text, overrides).unwrap_err().to_string();
        assert!(message.contains(says), "{message}");
    }

    #[test]
    fn the_shipped_file_states_the_defaults() {
        let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/packcell.toml");
        assert_eq!(Config::load(&shipped, &[]).unwrap(), Config::default());
        let text = fs::read_to_string(shipped).unwrap();
        for section in toml::from_str::<toml::Table>(&Config::default().to_toml()).unwrap() {
            for key in section.1.as_table().unwrap().keys() {
                assert!(text.contains(&format!("\n{key} = ")), "{}.{key} is not in the shipped file", section.0);
            }
        }
    }

    #[test]
    fn a_configuration_reads_back_as_it_was_written() {
        let mut config = Config::default();
        config.perception.stream = "/tmp/with \"quotes\".json".into();
        assert_eq!(load(&config.to_toml(), &[]).unwrap(), config);
    }

    #[test]
    fn overrides_override() {
        let config =
            load("[commander]\nhard_deadline_ms = 30\n", &["commander.hard_deadline_ms=31", "scorer.policy=walle"]);
        let config = config.unwrap();
        assert_eq!((config.commander.hard_deadline_ms, config.scorer.policy.as_str()), (31, "walle"));
        assert_eq!(config.commander.soft_deadline_ms, 12);
    }

    #[test]
    fn changed_keys_are_named() {
        let changed = load("[commander]\nhard_deadline_ms = 31\n", &["scorer.model=x", "log.level=info"]).unwrap();
        assert_eq!(Config::default().changed_keys(&changed), ["commander.hard_deadline_ms", "scorer.model"]);
    }

    #[test]
    fn mistakes_are_named() {
        refused("[commander]\nhard_dedline_ms = 30\n", &[], "unknown field `hard_dedline_ms`");
        refused("[comander]\n", &[], "unknown field `comander`");
        refused("", &["commander.hard=3"], "unknown field `hard`");
        refused("", &["hard=3"], "section.key=value");
        refused("", &["commander.hard_deadline_ms=soon"], "invalid type");
        refused("", &["commander.hard_deadline_ms=0"], "it must be 1 to 1000 ms");
        refused("", &["commander.soft_deadline_ms=26"], "not be later than commander.hard_deadline_ms");
        refused("", &["commander.close_policy=best"], "never, oldest, fullest");
        refused("", &["container.slots=99"], "a grid has 1 to 64 slots");
        refused("", &["perception.upcoming=9"], "at most 8");
        refused("", &["rules.clearance_mm=501"], "half a metre");
        refused("", &["world.actuator_mm=-1"], "it must be 0 to 500 mm");
        refused("", &["world.drop_share=nan"], "a share from 0 to 1");
        refused("", &["world.camera_fault=dirty"], "unknown variant `dirty`");
        refused("", &["world.kind=rigid"], "unknown variant `rigid`, expected `geometric` or `physics`");
        refused("", &["world.kind=physics", "world.push_mm=5"], "it must be 0 in a world of physics");
        refused("", &["belief.frames=10"], "1 to 9 frames");
        refused("", &["rules.clearance_mm=-1"], "invalid value");
        refused("", &["candidates.walle_weights=[1.0, nan, 1.0, 1.0, 1.0]"], "five numbers of 0 or more");
        refused("[log]\nlevel = \"loud\"\n", &[], "unknown variant `loud`");
        let message = Config::load(Path::new("/nonexistent.toml"), &[]).unwrap_err().to_string();
        assert!(message.starts_with("cannot read the configuration /nonexistent.toml"), "{message}");
    }

    #[test]
    fn every_truncation_and_every_flipped_byte_is_read_or_refused() {
        let text = include_bytes!("../../../deploy/packcell.toml");
        let settings = text.split(|&byte| byte == b'\n').filter(|line| !line.starts_with(b"#")).collect::<Vec<_>>();
        let settings = settings.join(&b'\n');
        for at in 0..settings.len() {
            for flip in [1, 0x20, 0x80] {
                let mut flipped = settings.clone();
                flipped[at] ^= flip;
                for bytes in [&flipped[..], &settings[..at]] {
                    if let Ok(config) = toml::from_slice::<Config>(bytes) {
                        let _ = config.overridden(&[]).map_err(|error| error.to_string());
                    }
                }
            }
        }
    }

    proptest::proptest! {
        #[test]
        fn no_text_makes_the_reader_panic(text in ".{0,200}", key in "[a-z_.]{0,30}=.{0,20}") {
            if let Ok(config) = toml::from_str::<Config>(&text) {
                let _ = config.check();
            }
            let _ = Config::default().overridden(&[key]).map_err(|error| error.to_string());
        }
    }
}
