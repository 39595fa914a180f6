//! What every process of the cell does besides its own work: join the bus, sleep until a bell rings, read the one
//! configuration file, log, and say how it is, to the cell and to systemd. The only crate that names iceoryx2's ports.
//!
//! What iceoryx2 0.10.0 does that one has to know is handled here, in [`Bus`], and nowhere else.

mod bus;
mod clock;
mod config;
mod health;
mod log;
mod presence;
mod process;
mod reload;
mod scheduling;
mod supervision;

pub use bus::{Bell, Bus, BusError, Latest, Publisher, Subscriber, shared_memory_bytes};
pub use clock::{monotonic_ns, unix_ms};
pub use config::{
    BeliefConfig, BeliefSource, BusConfig, CameraFault, CandidatesConfig, CommanderConfig, Config, ConfigError,
    ContainerConfig, LogConfig, LogLevel, PerceptionConfig, RulesConfig, ScorerConfig, StateConfig, WithoutCamera,
    WorldConfig, WorldKind,
};
pub use health::{Reporter, Tally};
pub use log::init_log;
pub use presence::{BusOwner, processes_on};
pub use process::{ServiceArgs, StopSignal};
pub use reload::ReloadSignal;
