//! Starting, watching and ending real cells.

use std::collections::BTreeMap;
use std::fs;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal};
use serde_json::Value;
use tempfile::TempDir;

/// How long anything may take before a test gives up. Nothing is measured by it.
const WATCHDOG: Duration = Duration::from_secs(120);

/// The repository.
pub(crate) fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().to_owned()
}

/// A program of this workspace, built by the command that built this test.
pub(crate) fn program(name: &str) -> PathBuf {
    let test = std::env::current_exe().unwrap();
    let path = test.ancestors().nth(2).unwrap().join(name);
    assert!(path.exists(), "{} is missing: run the tests with 'cargo test --release --workspace'", path.display());
    path
}

/// Waits until `condition` gives something.
#[track_caller]
#[expect(clippy::disallowed_methods, reason = "a watchdog is no measurement")]
pub(crate) fn wait_until<T>(what: &str, mut condition: impl FnMut() -> Option<T>) -> T {
    let end = Instant::now() + WATCHDOG;
    loop {
        if let Some(value) = condition() {
            return value;
        }
        assert!(Instant::now() < end, "waited in vain until {what}");
        thread::sleep(Duration::from_millis(10));
    }
}

/// What `packcell demo` did.
pub(crate) struct Demo {
    pub(crate) pid: u32,
    pub(crate) output: Output,
    pub(crate) json: Option<Value>,
}

impl Demo {
    /// Runs `packcell demo` with these arguments to its end.
    pub(crate) fn run(args: &[&str]) -> Self {
        Self::begin(args).finish()
    }

    /// Starts `packcell demo` with these arguments.
    pub(crate) fn begin(args: &[&str]) -> RunningDemo {
        let dir = tempfile::tempdir().unwrap();
        let mut command = Command::new(program("packcell"));
        command.arg("demo").args(args).arg("--json").arg(dir.path().join("figures.json"));
        command.stdout(Stdio::piped()).stderr(Stdio::piped()).stdin(Stdio::null());
        RunningDemo { child: command.spawn().unwrap(), dir }
    }

    /// The figures of a demo that went well.
    #[track_caller]
    pub(crate) fn figures(&self) -> &Value {
        assert!(self.output.status.success(), "{}", self.stderr());
        self.json.as_ref().expect("a demo that succeeds writes its figures")
    }

    /// One number of the figures.
    #[track_caller]
    pub(crate) fn number(&self, pointer: &str) -> f64 {
        self.figures().pointer(pointer).and_then(Value::as_f64).unwrap_or_else(|| panic!("no number at {pointer}"))
    }

    pub(crate) fn stderr(&self) -> String {
        String::from_utf8_lossy(&self.output.stderr).into_owned()
    }

    /// Whatever a demo does, it leaves nothing behind.
    #[track_caller]
    pub(crate) fn assert_nothing_is_left(&self) {
        assert_eq!(leftovers(&format!("pc{}_", self.pid)), [] as [String; 0]);
        assert_eq!(leftovers(&format!("packcell-private-{}", self.pid)), [] as [String; 0]);
    }
}

/// A demo that is not over.
pub(crate) struct RunningDemo {
    pub(crate) child: Child,
    dir: TempDir,
}

impl RunningDemo {
    /// Waits for its end.
    pub(crate) fn finish(self) -> Demo {
        let pid = self.child.id();
        let output = self.child.wait_with_output().unwrap();
        let json = fs::read(self.dir.path().join("figures.json")).ok();
        let json = json.map(|bytes| serde_json::from_slice(&bytes).expect("figures are JSON"));
        Demo { pid, output, json }
    }
}

/// Entries of shared memory whose names begin with `prefix`.
pub(crate) fn leftovers(prefix: &str) -> Vec<String> {
    let names = fs::read_dir("/dev/shm").unwrap().flatten().map(|entry| entry.file_name().into_string().unwrap());
    names.filter(|name| name.starts_with(prefix)).collect()
}

/// Sends a signal to a process.
pub(crate) fn signal(pid: u32, signal: Signal) {
    rustix::process::kill_process(Pid::from_raw(pid.cast_signed()).unwrap(), signal).unwrap();
}

/// The processes that `parent` started.
pub(crate) fn children_of(parent: u32) -> Vec<u32> {
    let stat_of = |pid: u32| fs::read_to_string(format!("/proc/{pid}/stat")).ok();
    let parent_of = |stat: &str| stat.rsplit_once(')')?.1.split_whitespace().nth(1)?.parse::<u32>().ok();
    let pids = fs::read_dir("/proc").unwrap().flatten().filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    pids.filter(|&pid| stat_of(pid).as_deref().and_then(parent_of) == Some(parent)).collect()
}

/// A cell that `packcell up` keeps running on a bus of its own. Dropping it kills it.
pub(crate) struct UpCell {
    pub(crate) child: Child,
    pub(crate) prefix: String,
    root_dir: String,
    state: TempDir,
    /// Reads what it says, so that it never waits for somebody to listen.
    listener: Option<JoinHandle<String>>,
}

impl UpCell {
    /// Starts a cell on the bus called `name`.
    pub(crate) fn start(name: &str, args: &[&str]) -> Self {
        let prefix = format!("pctest{}{name}_", std::process::id());
        let root_dir = format!("/dev/shm/pctest{}{name}", std::process::id());
        let mut command = Command::new(program("packcell"));
        let state = tempfile::tempdir().unwrap();
        command.arg("up").args(args).args(bus_args(&root_dir, &prefix, state.path()));
        let (child, listener) = listened(&mut command);
        Self { child, prefix, root_dir, state, listener }
    }

    /// The arguments by which other programs reach its bus.
    pub(crate) fn bus_args(&self) -> Vec<String> {
        bus_args(&self.root_dir, &self.prefix, self.state.path())
    }

    /// The same bus, for a test that listens itself.
    pub(crate) fn bus_config(&self) -> runtime::BusConfig {
        runtime::BusConfig { root_dir: (&self.root_dir).into(), prefix: self.prefix.clone() }
    }

    /// Where it keeps what must outlive its processes.
    pub(crate) fn state_dir(&self) -> &Path {
        self.state.path()
    }

    /// The commander's journal.
    pub(crate) fn journal(&self) -> PathBuf {
        self.state_dir().join("journal.bin")
    }

    /// Starts a cell that was killed again, with its bus and its state as they were left.
    pub(crate) fn restart(mut self, args: &[&str]) -> Self {
        let mut command = Command::new(program("packcell"));
        command.arg("up").args(args).args(self.bus_args());
        (self.child, self.listener) = listened(&mut command);
        self
    }

    /// The configuration that its services run with.
    pub(crate) fn config_file(&self) -> PathBuf {
        Path::new(&self.root_dir).join("cell.toml")
    }

    /// What `packcell status` prints once all four processes speak.
    pub(crate) fn await_status(&self) -> String {
        wait_until("the cell runs", || {
            let status = Command::new(program("packcell")).arg("status").args(self.bus_args()).output().unwrap();
            let text = String::from_utf8(status.stdout).unwrap();
            let all = ["perception", "candidates", "scorer", "commander"].iter().all(|name| text.contains(name));
            (status.status.success() && all && !text.contains("no ")).then_some(text)
        })
    }

    /// Stops it with a signal; its exit code and what it said.
    pub(crate) fn stop_with(&mut self, how: Signal) -> (Option<i32>, String) {
        if self.child.try_wait().unwrap().is_none() {
            signal(self.child.id(), how);
        }
        let status = self.child.wait().unwrap();
        (status.code(), self.listener.take().unwrap().join().unwrap())
    }

    /// What is left of it in shared memory.
    pub(crate) fn leftovers(&self) -> Vec<String> {
        let mut left = leftovers(&self.prefix);
        left.extend(leftovers(self.root_dir.trim_start_matches("/dev/shm/")));
        left
    }
}

impl Drop for UpCell {
    fn drop(&mut self) {
        if self.child.try_wait().unwrap().is_none() {
            let _the_test_has_failed_already = self.child.kill();
        }
    }
}

/// Starts a program, and somebody who reads what it and its children say on stderr.
fn listened(command: &mut Command) -> (Child, Option<JoinHandle<String>>) {
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).stdin(Stdio::null()).spawn().unwrap();
    let mut stderr = child.stderr.take().unwrap();
    let listen = move || {
        let mut said = Vec::new();
        stderr.read_to_end(&mut said).unwrap();
        String::from_utf8_lossy(&said).into_owned()
    };
    (child, Some(thread::spawn(listen)))
}

fn bus_args(root_dir: &str, prefix: &str, state_dir: &Path) -> Vec<String> {
    let settings = [
        format!("bus.root_dir={root_dir}"),
        format!("bus.prefix={prefix}"),
        format!("state.dir={}", state_dir.display()),
    ];
    settings.into_iter().flat_map(|setting| ["--set".to_owned(), setting]).collect()
}

/// A cell whose services are started one by one, as an operator or systemd would. Dropping it kills them all and
/// removes the bus.
pub(crate) struct Services {
    config: PathBuf,
    prefix: String,
    root_dir: String,
    running: BTreeMap<&'static str, Child>,
}

impl Services {
    /// A bus called `name`, and a configuration with these lines, which may not have a section `[bus]`.
    pub(crate) fn new(name: &str, lines: &str) -> Self {
        let prefix = format!("pctest{}{name}_", std::process::id());
        let root_dir = format!("/dev/shm/pctest{}{name}", std::process::id());
        fs::create_dir(&root_dir).unwrap();
        let config = Path::new(&root_dir).join("cell.toml");
        fs::write(
            &config,
            format!(
                "[bus]\nroot_dir = \"{root_dir}\"\nprefix = \"{prefix}\"\n[state]\ndir = \"{root_dir}/state\"\n{lines}"
            ),
        )
        .unwrap();
        Self { config, prefix, root_dir, running: BTreeMap::new() }
    }

    /// Starts a service.
    pub(crate) fn start(&mut self, name: &'static str) {
        let mut command = Command::new(program(name));
        command.arg("--config").arg(&self.config).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        let replaced = self.running.insert(name, command.spawn().unwrap());
        assert!(replaced.is_none(), "{name} runs already");
    }

    /// Ends a service by kill -9.
    pub(crate) fn kill(&mut self, name: &'static str) {
        let mut child = self.running.remove(name).unwrap();
        child.kill().unwrap();
        child.wait().unwrap();
    }

    /// Where iceoryx2 keeps the files of the bus.
    pub(crate) fn root_dir(&self) -> &Path {
        Path::new(&self.root_dir)
    }

    /// The bus, for a test that speaks or listens itself.
    pub(crate) fn bus_config(&self) -> runtime::BusConfig {
        runtime::BusConfig { root_dir: (&self.root_dir).into(), prefix: self.prefix.clone() }
    }

    /// Messages that a service refused, as it says itself; nothing while it does not speak.
    pub(crate) fn refused(&self, name: &str) -> Option<u64> {
        let output = self.status_command().output().unwrap();
        let text = String::from_utf8(output.stdout).unwrap();
        let row = text.lines().find(|line| line.trim_start().starts_with(name))?;
        let numbers: Vec<u64> = row.split_whitespace().filter_map(|word| word.parse().ok()).collect();
        // Process id, seconds, boxes, last box, refused.
        numbers.get(4).copied()
    }

    /// Whether all services that were started run.
    #[track_caller]
    pub(crate) fn assert_all_run(&mut self) {
        for (name, child) in &mut self.running {
            assert!(child.try_wait().unwrap().is_none(), "{name} has ended");
        }
    }

    /// Looks at the cell with `packcell status`.
    pub(crate) fn status_command(&self) -> Command {
        let mut command = Command::new(program("packcell"));
        command
            .arg("status")
            .args(bus_args(&self.root_dir, &self.prefix, &self.root_dir().join("state")))
            .stdin(Stdio::null());
        command
    }

    /// Boxes that the arm has taken, as `packcell status` says; nothing while no cell speaks.
    pub(crate) fn taken(&self) -> Option<u64> {
        let output = self.status_command().output().unwrap();
        let text = String::from_utf8(output.stdout).unwrap();
        text.split_once("the belt: ")?.1.split_whitespace().next()?.parse().ok()
    }

    /// Waits until boxes are taken, and some more after that.
    #[track_caller]
    pub(crate) fn await_progress(&self, what: &str) {
        let before = wait_until(what, || self.taken());
        wait_until(what, || self.taken().filter(|&taken| taken > before + 20));
    }
}

impl Drop for Services {
    fn drop(&mut self) {
        for child in self.running.values_mut() {
            let _what_has_ended_need_not_be_killed = child.kill().and_then(|()| child.wait());
        }
        let _what_is_gone_is_gone = fs::remove_dir_all(&self.root_dir);
        for left in leftovers(&self.prefix) {
            let _what_is_gone_is_gone = fs::remove_file(Path::new("/dev/shm").join(left));
        }
    }
}
