//! The cell's topics and bells on iceoryx2.
//!
//! # What iceoryx2 0.10.0 does, and what we do about it
//!
//! - A process killed while it creates a service leaves a half-written file, and the service can never be opened
//!   again (`HangsInCreation`): [`Bus`] removes such files and tries again.
//! - A dead process's resources are cleaned up by the configuration it wrote down, or by the *global* one if it died
//!   early: [`Bus::join`] makes the cell's configuration the global one, from a file in the cell's own directory.
//! - A process killed between creating shared memory and giving it a size leaves an empty file, and whoever opens it,
//!   be it to clean up, waits for ever: cleaning up is ours alone ([`Bus::clean_up_after_the_dead`]), after such files
//!   are gone.
//! - A writer waits for ever for a full, dead reader unless overflow is on: it is on everywhere, and
//!   back-pressure is set to discard besides.
//! - History is delivered by the *living* publisher, at its next message: [`Publisher::greet_newcomers`].
//! - Full shared memory kills the process that touches the page: [`Bus::join`] refuses to start without room.
//! - A timed wait ends at a kernel tick, up to 10 ms late, and one of less than a microsecond never: [`Bell::wait`]
//!   polls the listener's socket instead, with the kernel's high-resolution timers.
//! - Its node counter is writable for all users of the machine: [`Bus::join`] closes it.
//! - The blackboard pattern stays locked after its writer was killed: it is not used.

use std::fs;
use std::io;
use std::os::fd::BorrowedFd;
use std::os::unix::fs::{DirBuilderExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};
use std::thread;
use std::time::Duration;

use iceoryx2::config::Config as IceoryxConfig;
use iceoryx2::node::Node;
use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::PublisherCreateError;
use iceoryx2::port::update_connections::UpdateConnections as _;
use iceoryx2::prelude::{
    BackpressureStrategy, FileDescriptorBased as _, FilePath, LogLevel, NodeBuilder, SemanticString as _,
    SignalHandlingMode, ipc, set_log_level,
};
use iceoryx2::sample::Sample;
use iceoryx2::service::builder::event::{EventOpenError, EventOpenOrCreateError};
use iceoryx2::service::builder::publish_subscribe::{PublishSubscribeOpenError, PublishSubscribeOpenOrCreateError};
use messages::Message;
use messages::topics::{
    ACTIVE, BELIEF, BOXES, CANDIDATES, COMMANDS, CONTROL, CYCLES, DECISIONS, HEALTH, MOTIONS, NODES_MAX, Role,
    SUBSCRIBERS_MAX, Topic,
};
use rustix::event::{PollFd, PollFlags, Timespec};

use crate::{BusConfig, BusOwner, StopSignal, monotonic_ns};

/// How long a process tries to join a topic before it gives up.
const JOIN_PATIENCE: Duration = Duration::from_secs(5);

/// Pause between two tries.
const JOIN_PAUSE: Duration = Duration::from_millis(20);

/// Longest sleep on a bell: the safety net under a lost ring, and the beat of whatever is done when idle [ns].
const SLEEP_NS_MAX: u64 = 50_000_000;

/// Nanoseconds of a second.
const NS_PER_S: u64 = 1_000_000_000;

/// Age after which an unfinished service file belongs to nobody alive.
const UNFINISHED_AGE: Duration = Duration::from_secs(2);

/// Age after which shared memory without a size belongs to nobody alive: to give it one takes microseconds.
const SIZELESS_AGE: Duration = Duration::from_millis(500);

/// Where POSIX shared memory lives on Linux.
const SHARED_MEMORY: &str = "/dev/shm";

/// Why the bus could not be joined, or failed.
#[derive(Debug, thiserror::Error)]
pub enum BusError {
    /// The bus's directory cannot be used.
    #[error("cannot use the bus directory {path} (bus.root_dir): {source}")]
    RootDir {
        /// As configured.
        path: PathBuf,
        /// What the operating system says.
        source: io::Error,
    },
    /// The bus belongs to another user.
    #[error(
        "the bus {path} belongs to the user {owner}, and all processes of a cell must be of one user: \
         run this with 'sudo -u {owner}'"
    )]
    Foreign {
        /// As configured.
        path: PathBuf,
        /// The name of its owner.
        owner: String,
    },
    /// The bus's directory or prefix is no name that iceoryx2 takes.
    #[error(
        "bus.root_dir {root_dir:?} or bus.prefix {prefix:?} is too long or holds a character that no file name has"
    )]
    Name {
        /// As configured.
        root_dir: PathBuf,
        /// As configured.
        prefix: String,
    },
    /// There is too little shared memory.
    #[error(
        "{SHARED_MEMORY} has {available_mib} MiB free and the cell may need {needed_mib} MiB: \
         remove files there, or enlarge it with 'mount -o remount,size=1G {SHARED_MEMORY}'"
    )]
    SharedMemory {
        /// What is free.
        available_mib: u64,
        /// What all topics together may come to use.
        needed_mib: u64,
    },
    /// The exclusive right to publish on a topic is taken.
    #[error("another process publishes on {topic} already: is a second {role} running on the bus {root_dir}?")]
    Taken {
        /// The topic.
        topic: &'static str,
        /// Who may publish on it.
        role: &'static str,
        /// The bus.
        root_dir: PathBuf,
    },
    /// Another version of packcell runs on the bus.
    #[error("{topic} is in use by another version of packcell: stop all processes on the bus {root_dir} first")]
    OtherVersion {
        /// The topic.
        topic: &'static str,
        /// The bus.
        root_dir: PathBuf,
    },
    /// iceoryx2 failed.
    #[error("{action} {name} on the bus {root_dir}: {reason}")]
    Iceoryx {
        /// What was tried.
        action: &'static str,
        /// With what.
        name: &'static str,
        /// The bus.
        root_dir: PathBuf,
        /// What iceoryx2 says.
        reason: String,
    },
    /// The stop signals cannot be caught.
    #[error("cannot catch the signals that stop a process")]
    Signals(#[source] io::Error),
}

/// A process's seat on the bus of one cell.
#[derive(Debug)]
pub struct Bus {
    node: Node<ipc::Service>,
    root_dir: PathBuf,
    prefix: String,
    role: Role,
    publisher_id: u64,
    stop: StopSignal,
}

/// The right to publish messages of one type.
#[derive(Debug)]
pub struct Publisher<M: Message> {
    port: iceoryx2::port::publisher::Publisher<ipc::Service, M, ()>,
    bells: Vec<Notifier<ipc::Service>>,
    topic: &'static str,
    root_dir: PathBuf,
    publisher_id: u64,
    sequence: u64,
}

/// A reader of messages of one type.
#[derive(Debug)]
pub struct Subscriber<M: Message> {
    port: iceoryx2::port::subscriber::Subscriber<ipc::Service, M, ()>,
    topic: &'static str,
    root_dir: PathBuf,
}

/// A reader that keeps the newest message at hand, where its publisher wrote it.
#[derive(Debug)]
pub struct Latest<M: Message> {
    subscriber: Subscriber<M>,
    sample: Option<Sample<ipc::Service, M, ()>>,
}

/// What the processes of one role sleep on.
#[derive(Debug)]
pub struct Bell {
    listener: Listener<ipc::Service>,
    stop: StopSignal,
}

/// Shared memory that all topics of a cell together may come to use [bytes].
#[must_use]
pub fn shared_memory_bytes() -> u64 {
    let total = BELIEF.publisher_bytes()
        + BOXES.publisher_bytes()
        + CANDIDATES.publisher_bytes() * CANDIDATES.publishers_max
        + DECISIONS.publisher_bytes() * DECISIONS.publishers_max
        + COMMANDS.publisher_bytes()
        + MOTIONS.publisher_bytes()
        + CYCLES.publisher_bytes()
        + CONTROL.publisher_bytes()
        + ACTIVE.publisher_bytes()
        + HEALTH.publisher_bytes() * HEALTH.publishers_max;
    total as u64
}

impl Bus {
    /// Joins the bus that the configuration names, creating it if nobody has.
    ///
    /// # Errors
    /// [`BusError`] says what stands in the way and what to do about it.
    pub fn join(config: &BusConfig, role: Role) -> Result<Self, BusError> {
        set_log_level(LogLevel::Fatal);
        let root_dir = config.root_dir.clone();
        let settings = iceoryx_settings(config)?;
        let unusable = |source| BusError::RootDir { path: root_dir.clone(), source };
        fs::DirBuilder::new().recursive(true).mode(0o700).create(&root_dir).map_err(unusable)?;
        BusOwner::require_me(config)?;
        check_shared_memory()?;
        let iceoryx = iceoryx_config(&root_dir, &settings)?;
        let stop = StopSignal::catch().map_err(BusError::Signals)?;
        let patience_ends_ns = monotonic_ns() + JOIN_PATIENCE.as_nanos() as u64;
        while !remove_sizeless_memory(Path::new(SHARED_MEMORY), &config.prefix, SIZELESS_AGE)
            && monotonic_ns() < patience_ends_ns
            && !stop.is_set()
        {
            thread::sleep(JOIN_PAUSE);
        }
        let builder = NodeBuilder::new().config(&iceoryx).signal_handling_mode(SignalHandlingMode::Disabled);
        let node = builder.create::<ipc::Service>().map_err(|error| BusError::Iceoryx {
            action: "join",
            name: role.name(),
            root_dir: root_dir.clone(),
            reason: format!("{error:?}"),
        })?;
        close_to_others(Path::new(SHARED_MEMORY), &config.prefix);
        // A process id is unique among the living, and no two processes with the same one start in one microsecond.
        let publisher_id = u64::from(std::process::id()) << 40 | (monotonic_ns() / 1000) & ((1 << 40) - 1);
        let prefix = config.prefix.clone();
        let bus = Self { node, root_dir, prefix, role, publisher_id, stop };
        bus.clean_up_after_the_dead();
        Ok(bus)
    }

    /// What this process is for.
    #[must_use]
    pub fn role(&self) -> Role {
        self.role
    }

    /// Whether SIGTERM or SIGINT asked the process to end.
    #[must_use]
    pub fn is_stopping(&self) -> bool {
        self.stop.is_set()
    }

    /// Removes what dead processes left on the bus, unless one of them died so recently that it cannot be told from
    /// one that is being born. Takes milliseconds: never while a box waits.
    pub fn clean_up_after_the_dead(&self) {
        if remove_sizeless_memory(Path::new(SHARED_MEMORY), &self.prefix, SIZELESS_AGE) {
            self.node.try_cleanup_dead_nodes();
        }
    }

    /// The right to publish on a topic.
    ///
    /// # Errors
    /// [`BusError::Taken`] if as many processes as may publish already do.
    pub fn publisher<M: Message>(&self, topic: &Topic<M>) -> Result<Publisher<M>, BusError> {
        let service = self.open(topic)?;
        let create = || {
            let builder = service.publisher_builder().max_loaned_samples(1);
            builder.backpressure_strategy(BackpressureStrategy::DiscardData).create()
        };
        let port = self.patiently(|| match create() {
            Ok(port) => Ok(Some(port)),
            Err(PublisherCreateError::ExceedsMaxSupportedPublishers) => Ok(None),
            Err(error) => Err(self.failed("publish on", topic.name, &error)),
        })?;
        let (root_dir, role) = (self.root_dir.clone(), self.role.name());
        let port = port.ok_or(BusError::Taken { topic: topic.name, role, root_dir: root_dir.clone() })?;
        let bells = topic.wakes.iter().map(|&role| self.ringer(role)).collect::<Result<_, _>>()?;
        Ok(Publisher { port, bells, topic: topic.name, root_dir, publisher_id: self.publisher_id, sequence: 0 })
    }

    /// A reader of a topic, which begins with the newest message if its publisher lives.
    ///
    /// # Errors
    /// [`BusError`] if the topic cannot be joined.
    pub fn subscriber<M: Message>(&self, topic: &Topic<M>) -> Result<Subscriber<M>, BusError> {
        let service = self.open(topic)?;
        let create = || service.subscriber_builder().buffer_size(topic.depth).create();
        let port = create().map_err(|error| self.failed("read", topic.name, &error))?;
        port.update_connections().map_err(|error| self.failed("read", topic.name, &error))?;
        Ok(Subscriber { port, topic: topic.name, root_dir: self.root_dir.clone() })
    }

    /// A reader that keeps the newest message of a topic at hand.
    ///
    /// # Errors
    /// [`BusError`] if the topic cannot be joined.
    pub fn latest<M: Message>(&self, topic: &Topic<M>) -> Result<Latest<M>, BusError> {
        Ok(Latest { subscriber: self.subscriber(topic)?, sample: None })
    }

    /// The bell of this process's role.
    ///
    /// # Errors
    /// [`BusError`] if the bell cannot be joined.
    pub fn bell(&self) -> Result<Bell, BusError> {
        let service = self.open_bell(self.role)?;
        let created = service.listener_builder().create();
        let listener = created.map_err(|error| self.failed("sleep on", self.role.bell(), &error))?;
        Ok(Bell { listener, stop: self.stop.clone() })
    }

    fn ringer(&self, role: Role) -> Result<Notifier<ipc::Service>, BusError> {
        let service = self.open_bell(role)?;
        service.notifier_builder().create().map_err(|error| self.failed("ring", role.bell(), &error))
    }

    fn open<M: Message>(
        &self,
        topic: &Topic<M>,
    ) -> Result<iceoryx2::service::port_factory::publish_subscribe::PortFactory<ipc::Service, M, ()>, BusError> {
        use PublishSubscribeOpenError as Open;
        use PublishSubscribeOpenOrCreateError as OpenOrCreate;

        let name = topic.name.try_into().map_err(|error| self.failed("name", topic.name, &error))?;
        let open = || {
            let builder = self.node.service_builder(&name).publish_subscribe::<M>();
            let builder = builder.enable_safe_overflow(true).history_size(1).subscriber_max_buffer_size(topic.depth);
            let builder = builder.subscriber_max_borrowed_samples(2).max_nodes(NODES_MAX);
            builder.max_subscribers(SUBSCRIBERS_MAX).max_publishers(topic.publishers_max).open_or_create()
        };
        let service = self.patiently(|| match open() {
            Ok(service) => Ok(Some(service)),
            Err(OpenOrCreate::PublishSubscribeOpenError(Open::IncompatibleTypes | Open::VersionMismatch)) => {
                Err(BusError::OtherVersion { topic: topic.name, root_dir: self.root_dir.clone() })
            }
            Err(
                OpenOrCreate::SystemInFlux
                | OpenOrCreate::PublishSubscribeOpenError(
                    Open::HangsInCreation
                    | Open::IsMarkedForDestruction
                    | Open::ExceedsMaxNumberOfNodes
                    | Open::Interrupt
                    | Open::DoesNotExist
                    | Open::ServiceInCorruptedState,
                )
                | OpenOrCreate::PublishSubscribeCreateError(_),
            ) => Ok(None),
            Err(error) => Err(self.failed("join", topic.name, &error)),
        })?;
        service.ok_or_else(|| self.failed("join", topic.name, &"it stays unavailable"))
    }

    fn open_bell(
        &self,
        role: Role,
    ) -> Result<iceoryx2::service::port_factory::event::PortFactory<ipc::Service>, BusError> {
        use EventOpenError as Open;
        use EventOpenOrCreateError as OpenOrCreate;

        let name = role.bell().try_into().map_err(|error| self.failed("name", role.bell(), &error))?;
        let open = || {
            let builder = self.node.service_builder(&name).event().max_nodes(NODES_MAX);
            builder.max_listeners(SUBSCRIBERS_MAX).max_notifiers(NODES_MAX).event_id_max_value(1).open_or_create()
        };
        let service = self.patiently(|| match open() {
            Ok(service) => Ok(Some(service)),
            Err(
                OpenOrCreate::SystemInFlux
                | OpenOrCreate::EventOpenError(
                    Open::HangsInCreation
                    | Open::IsMarkedForDestruction
                    | Open::ExceedsMaxNumberOfNodes
                    | Open::Interrupt
                    | Open::DoesNotExist
                    | Open::ServiceInCorruptedState,
                )
                | OpenOrCreate::EventCreateError(_),
            ) => Ok(None),
            Err(error) => Err(self.failed("join", role.bell(), &error)),
        })?;
        service.ok_or_else(|| self.failed("join", role.bell(), &"it stays unavailable"))
    }

    /// Tries until it works, fails for good, or patience ends. Between two tries it removes what the dead left.
    fn patiently<T>(&self, mut attempt: impl FnMut() -> Result<Option<T>, BusError>) -> Result<Option<T>, BusError> {
        let patience_ends_ns = monotonic_ns() + JOIN_PATIENCE.as_nanos() as u64;
        loop {
            if let Some(done) = attempt()? {
                return Ok(Some(done));
            }
            if monotonic_ns() >= patience_ends_ns || self.stop.is_set() {
                return Ok(None);
            }
            self.clean_up_after_the_dead();
            remove_unfinished_services(&self.root_dir.join("services"), UNFINISHED_AGE);
            thread::sleep(JOIN_PAUSE);
        }
    }

    fn failed(&self, action: &'static str, name: &'static str, reason: &dyn std::fmt::Debug) -> BusError {
        BusError::Iceoryx { action, name, root_dir: self.root_dir.clone(), reason: format!("{reason:?}") }
    }
}

impl<M: Message> Publisher<M> {
    /// Builds a message in shared memory, stamps it, sends it and rings the bells of its readers.
    ///
    /// `observed_ns` is the stamp of the observation that it answers. What `build` does not write is left over from
    /// an earlier message. Returns the message's own stamp.
    ///
    /// # Errors
    /// [`BusError`] if the bus failed.
    pub fn publish(&mut self, observed_ns: u64, build: impl FnOnce(&mut M)) -> Result<u64, BusError> {
        let mut sample = self.loan()?;
        build(sample.payload_mut());
        self.sequence += 1;
        let stamp_ns = monotonic_ns();
        *sample.payload_mut().header_mut() =
            messages::Header { publisher: self.publisher_id, sequence: self.sequence, stamp_ns, observed_ns };
        sample.send().map_err(|error| self.failed("publish on", &error))?;
        for bell in &self.bells {
            bell.notify().map_err(|error| self.failed("ring after", &error))?;
        }
        Ok(stamp_ns)
    }

    /// Gives the newest message to readers that came since it was published.
    ///
    /// # Errors
    /// [`BusError`] if the bus failed.
    pub fn greet_newcomers(&self) -> Result<(), BusError> {
        self.port.update_connections().map_err(|error| self.failed("publish on", &error))
    }

    #[expect(unsafe_code, reason = "a message is built where its readers will read it, without a copy")]
    fn loan(&self) -> Result<iceoryx2::sample_mut::SampleMut<ipc::Service, M, ()>, BusError> {
        let sample = self.port.loan_uninit().map_err(|error| self.failed("publish on", &error))?;
        // SAFETY: a message is valid for every bit pattern (`Message` requires `Pod`), and the memory behind a sample
        // is a shared mapping, which the kernel filled with zeros: its bytes are what was written last, never
        // undefined.
        Ok(unsafe { sample.assume_init() })
    }

    fn failed(&self, action: &'static str, reason: &dyn std::fmt::Debug) -> BusError {
        BusError::Iceoryx { action, name: self.topic, root_dir: self.root_dir.clone(), reason: format!("{reason:?}") }
    }
}

impl<M: Message> Subscriber<M> {
    /// The next message, where its publisher wrote it, if there is one.
    ///
    /// # Errors
    /// [`BusError`] if the bus failed.
    pub fn receive(&self) -> Result<Option<Sample<ipc::Service, M, ()>>, BusError> {
        self.port.receive().map_err(|error| BusError::Iceoryx {
            action: "read",
            name: self.topic,
            root_dir: self.root_dir.clone(),
            reason: format!("{error:?}"),
        })
    }
}

impl<M: Message> Latest<M> {
    /// Whether a message came since the last call; [`Latest::get`] is then the newest one.
    ///
    /// # Errors
    /// [`BusError`] if the bus failed.
    pub fn refresh(&mut self) -> Result<bool, BusError> {
        let mut is_new = false;
        while let Some(sample) = self.subscriber.receive()? {
            self.sample = Some(sample);
            is_new = true;
        }
        Ok(is_new)
    }

    /// The newest message, if one ever came.
    #[must_use]
    pub fn get(&self) -> Option<&M> {
        self.sample.as_deref()
    }
}

impl Bell {
    /// Sleeps until the bell rings, `wake_ns` has come, or the idle beat; `false` when the process is to end.
    ///
    /// A ring says that something may have come, not what: whoever wakes looks at everything.
    ///
    /// # Errors
    /// [`BusError`] if the bus failed.
    pub fn wait(&self, wake_ns: Option<u64>) -> Result<bool, BusError> {
        if self.stop.is_set() {
            return Ok(false);
        }
        let now = monotonic_ns();
        let sleep_ns = wake_ns.map_or(SLEEP_NS_MAX, |wake| wake.saturating_sub(now).min(SLEEP_NS_MAX));
        // An interrupted sleep is a wake like any other; the flag below says what interrupted it.
        let _woken = rustix::event::poll(&mut [PollFd::new(&self.socket(), PollFlags::IN)], Some(&timespec(sleep_ns)));
        let _rings = self.listener.try_wait(|_| ());
        Ok(!self.stop.is_set())
    }

    #[expect(unsafe_code, reason = "iceoryx2 gives its socket as a number")]
    fn socket(&self) -> BorrowedFd<'_> {
        // SAFETY: the descriptor belongs to the listener, is open as long as it lives, and is only polled.
        unsafe { BorrowedFd::borrow_raw(self.listener.file_descriptor().native_handle()) }
    }
}

fn timespec(ns: u64) -> Timespec {
    Timespec { tv_sec: (ns / NS_PER_S).cast_signed(), tv_nsec: (ns % NS_PER_S).cast_signed() }
}

/// The bus as iceoryx2 is to see it, in its own words.
fn iceoryx_settings(config: &BusConfig) -> Result<String, BusError> {
    let BusConfig { root_dir, prefix } = config;
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "/._-".contains(c);
    let is_root = |root: &&str| root.starts_with('/') && root.len() <= 80 && root.chars().all(is_plain);
    let is_prefix = (1..=32).contains(&prefix.len()) && prefix.chars().all(|c| is_plain(c) && c != '/');
    let misnamed = || BusError::Name { root_dir: root_dir.clone(), prefix: prefix.clone() };
    let root = root_dir.to_str().filter(is_root).filter(|_| is_prefix).ok_or_else(misnamed)?.trim_end_matches('/');
    Ok(format!(
        "# Written by packcell: how iceoryx2 programs reach this bus.\n\
         [global]\nroot-path = \"{root}/\"\nprefix = \"{prefix}\"\n\
         [global.creation-timeout]\nsecs = 1\nnanos = 0\n\
         [global.node]\ncleanup-dead-nodes-on-creation = false\ncleanup-dead-nodes-on-destruction = false\n\
         [global.service]\ncleanup-dead-nodes-on-open = false\n"
    ))
}

/// Writes the settings beside the bus, so that other iceoryx2 programs can use them too, and makes them this
/// process's own.
fn iceoryx_config(root_dir: &Path, settings: &str) -> Result<IceoryxConfig, BusError> {
    let path = root_dir.join("iceoryx2.toml");
    let unusable = |source| BusError::RootDir { path: root_dir.into(), source };
    if fs::read_to_string(&path).ok().as_deref() != Some(settings) {
        let unfinished = root_dir.join(format!("iceoryx2.toml.{}", std::process::id()));
        fs::write(&unfinished, settings).and_then(|()| fs::rename(&unfinished, &path)).map_err(unusable)?;
    }
    let invalid = |reason: &dyn std::fmt::Debug| unusable(io::Error::other(format!("{}: {reason:?}", path.display())));
    let file = FilePath::new(path.as_os_str().as_encoded_bytes()).map_err(|error| invalid(&error))?;
    IceoryxConfig::setup_global_config_from_file(&file).map_err(|error| invalid(&error))?;
    IceoryxConfig::from_file(&file).map_err(|error| invalid(&error))
}

/// Takes from other users what iceoryx2 gives them: it makes its node counter readable and writable for everybody, and
/// everything else for the owner alone.
fn close_to_others(shared_memory: &Path, prefix: &str) {
    for entry in fs::read_dir(shared_memory).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let name = name.to_string_lossy();
        if name.starts_with(prefix) && name.ends_with(".global_mgmt") {
            let _another_user_s_is_not_ours = fs::set_permissions(entry.path(), fs::Permissions::from_mode(0o600));
        }
    }
}

fn check_shared_memory() -> Result<(), BusError> {
    let Ok(state) = rustix::fs::statvfs(SHARED_MEMORY) else {
        return Ok(()); // Not mounted there: iceoryx2 will say what it misses.
    };
    check_room(state.f_bavail.saturating_mul(state.f_frsize), shared_memory_bytes())
}

fn check_room(available: u64, needed: u64) -> Result<(), BusError> {
    let mib = |bytes: u64| bytes / (1024 * 1024);
    if available >= needed {
        Ok(())
    } else {
        Err(BusError::SharedMemory { available_mib: mib(available), needed_mib: mib(needed) + 1 })
    }
}

/// Removes service files that their creator did not live to finish: still writable, and older than `age`.
fn remove_unfinished_services(services: &Path, age: Duration) {
    let Ok(entries) = fs::read_dir(services) else { return };
    for entry in entries.flatten() {
        let Ok(state) = entry.metadata() else { continue };
        let is_unfinished = state.is_file() && state.permissions().mode() & 0o200 != 0;
        let is_old = state.modified().ok().and_then(|time| time.elapsed().ok()).is_some_and(|elapsed| elapsed > age);
        if is_unfinished && is_old && entry.path().extension().is_some_and(|extension| extension == "service") {
            tracing::warn!("removed {}, which a killed process left half-created", entry.path().display());
            let _somebody_else_may_have_been_faster = fs::remove_file(entry.path());
        }
    }
}

/// Removes shared memory that its creator did not live to give a size, older than `age`; whether none is left.
fn remove_sizeless_memory(dir: &Path, prefix: &str, age: Duration) -> bool {
    let mut is_clean = true;
    for entry in fs::read_dir(dir).into_iter().flatten().flatten() {
        if !entry.file_name().as_encoded_bytes().starts_with(prefix.as_bytes()) {
            continue;
        }
        let Ok(state) = entry.metadata() else { continue };
        if !state.is_file() || state.len() > 0 {
            continue;
        }
        if state.modified().ok().and_then(|time| time.elapsed().ok()).is_some_and(|elapsed| elapsed > age) {
            tracing::warn!(file = %entry.path().display(), "removed what a killed process left half-created");
            let _somebody_else_may_have_been_faster = fs::remove_file(entry.path());
        } else {
            is_clean = false;
        }
    }
    is_clean
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shared_memory_must_have_room() {
        assert!(check_room(100, 100).is_ok());
        let message = check_room(3 << 20, 20 << 20).unwrap_err().to_string();
        assert!(message.starts_with("/dev/shm has 3 MiB free and the cell may need 21 MiB"), "{message}");
    }

    #[test]
    fn names_that_no_bus_has_are_refused() {
        for (root_dir, prefix) in [("relative", "x_"), ("/tmp/a b", "x_"), ("/tmp/a", ""), ("/tmp/a", "a/b")] {
            let config = BusConfig { root_dir: root_dir.into(), prefix: prefix.to_owned() };
            assert!(matches!(iceoryx_settings(&config), Err(BusError::Name { .. })), "{root_dir} {prefix}");
        }
    }

    #[test]
    fn the_node_counter_is_closed_to_others() {
        let dir = tempfile::tempdir().unwrap();
        let make = |name: &str| {
            let path = dir.path().join(name);
            fs::write(&path, "x").unwrap();
            fs::set_permissions(&path, fs::Permissions::from_mode(0o666)).unwrap();
            path
        };
        let (own, foreign) = (make("a_1_node.global_mgmt"), make("b_1_node.global_mgmt"));
        close_to_others(dir.path(), "a_");
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
        assert_eq!((mode(&own), mode(&foreign)), (0o600, 0o666));
    }

    #[test]
    fn only_old_unfinished_service_files_are_removed() {
        let dir = tempfile::tempdir().unwrap();
        let make = |name: &str, mode: u32| {
            let path = dir.path().join(name);
            fs::write(&path, "x").unwrap();
            fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
            path
        };
        let (unfinished, finished) = (make("a.service", 0o600), make("b.service", 0o400));
        let other = make("c.details", 0o600);
        remove_unfinished_services(dir.path(), Duration::from_secs(3600));
        assert!(unfinished.exists(), "a young one may still be finished");
        remove_unfinished_services(dir.path(), Duration::ZERO);
        assert!(!unfinished.exists() && finished.exists() && other.exists());
    }

    #[test]
    fn only_old_memory_without_a_size_is_removed() {
        let dir = tempfile::tempdir().unwrap();
        let make = |name: &str, bytes: &[u8]| {
            let path = dir.path().join(name);
            fs::write(&path, bytes).unwrap();
            path
        };
        let (sizeless, whole, foreign) = (make("x_a", b""), make("x_b", b"b"), make("y_a", b""));
        assert!(!remove_sizeless_memory(dir.path(), "x_", Duration::from_secs(3600)));
        assert!(sizeless.exists(), "a young one may still be given a size");
        assert!(remove_sizeless_memory(dir.path(), "x_", Duration::ZERO));
        assert!(!sizeless.exists() && whole.exists() && foreign.exists());
    }
}
