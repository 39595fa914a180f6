//! A machine with a systemd of its own, in namespaces on top of this machine's files. Nothing it does stays.

use std::fs;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};

use rustix::process::{Pid, Signal, kill_process};
use tempfile::TempDir;

use crate::harness::{children_of, root, wait_until};

/// After this the machine is gone, whatever happens to the test [s].
const LIFE_S: &str = "300";

/// The environment of everything that runs there.
const ENVIRONMENT: [&str; 4] = [
    "PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin",
    "LANG=C.UTF-8",
    "SYSTEMD_PAGER=",
    "HOME=/root",
];

/// Machines that this process has booted, so that each has a name of its own.
static BOOTED: AtomicU32 = AtomicU32::new(0);

/// A booted machine. Dropping it switches it off.
pub(crate) struct Machine {
    wrapper: Child,
    systemd: u32,
    cgroup: PathBuf,
    _dir: TempDir,
}

/// What a command said there.
pub(crate) struct Said {
    pub(crate) is_success: bool,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

impl Machine {
    /// Boots it. Panics with a reason where this machine cannot carry it.
    pub(crate) fn boot() -> Self {
        assert!(rustix::process::geteuid().is_root(), "only root can boot a machine in namespaces");
        assert!(Path::new("/lib/systemd/systemd").exists(), "there is no systemd to boot");
        let mounts = fs::read_to_string("/proc/mounts").unwrap();
        let mut mounts = mounts.lines().map(|line| line.split(' ').collect::<Vec<_>>());
        let cgroups =
            mounts.find(|mount| mount[2] == "cgroup2").expect("no cgroup2 hierarchy is mounted")[1].to_owned();
        let number = BOOTED.fetch_add(1, Ordering::Relaxed);
        let cgroup = Path::new(&cgroups).join(format!("packcell-test-{}-{number}", std::process::id()));
        fs::create_dir_all(cgroup.join("machine")).unwrap();

        // The wrapper enters its cgroup first, so that this is the root of the cgroup namespace.
        let dir = tempfile::tempdir().unwrap();
        let script = "echo $$ > \"$1/machine/cgroup.procs\"; shift; exec \"$@\"";
        let mut command = Command::new("sh");
        command.args(["-c", script, "sh"]).arg(&cgroup).args(["timeout", "--signal=KILL", LIFE_S]);
        command.args(["unshare", "--mount", "--pid", "--ipc", "--uts", "--cgroup", "--net", "--fork", "--kill-child"]);
        command.args(["--propagation", "private", "sh"]).arg(root().join("tests/machine.sh")).arg(dir.path());
        let log = dir.path().join("log");
        command.stdin(Stdio::null()).stderr(fs::File::create(&log).unwrap()).process_group(0);
        let mut wrapper = command.spawn().unwrap();
        let only_child = |parent| children_of(parent).first().copied();
        let systemd = wait_until("the machine's first process runs", || {
            let has_failed = wrapper.try_wait().unwrap().is_some();
            assert!(!has_failed, "this machine cannot carry another one: {}", fs::read_to_string(&log).unwrap());
            only_child(only_child(wrapper.id())?)
        });
        let machine = Self { wrapper, systemd, cgroup, _dir: dir };
        wait_until("the machine has booted", || {
            let state = machine.run(&["systemctl", "is-system-running"]).stdout;
            ["running", "degraded"].contains(&state.trim()).then_some(())
        });
        machine
    }

    /// Runs a command as the machine's root.
    pub(crate) fn run(&self, command: &[&str]) -> Said {
        let mut enter = Command::new("nsenter");
        enter.args(["--target", &self.systemd.to_string(), "--mount", "--pid", "--ipc", "--uts", "--cgroup", "--net"]);
        enter.args(["--root", "--wdns=/", "env", "-i"]).args(ENVIRONMENT).args(command).stdin(Stdio::null());
        let Output { status, stdout, stderr } = enter.output().unwrap();
        let text = |bytes| String::from_utf8_lossy(bytes).into_owned();
        Said { is_success: status.success(), stdout: text(&stdout), stderr: text(&stderr) }
    }

    /// Runs a command that must succeed; what it printed.
    #[track_caller]
    pub(crate) fn must(&self, command: &[&str]) -> String {
        let said = self.run(command);
        assert!(said.is_success, "{command:?} failed\n{}{}", said.stdout, said.stderr);
        said.stdout
    }

    /// Where one of its files is for this test.
    pub(crate) fn path(&self, path: &str) -> PathBuf {
        PathBuf::from(format!("/proc/{}/root{path}", self.systemd))
    }
}

impl Drop for Machine {
    fn drop(&mut self) {
        // The first process of a pid namespace takes all others with it.
        let _it_may_have_ended = Pid::from_raw(self.systemd.cast_signed()).map(|pid| kill_process(pid, Signal::KILL));
        let _its_end_is_all_that_counts = self.wrapper.wait();
        wait_until("the machine's cgroups are gone", || remove_tree(&self.cgroup).is_ok().then_some(()));
    }
}

#[test]
#[ignore = "needs root and namespaces; .ci/run asks it whether the tests that boot a systemd can run"]
fn a_machine_can_be_booted_here() {
    let state = Machine::boot().run(&["systemctl", "is-active", "test.target"]);
    assert_eq!(state.stdout, "active\n");
}

/// Removes a tree of cgroups, which holds files that cannot be removed and go with their directory.
fn remove_tree(dir: &Path) -> std::io::Result<()> {
    for entry in fs::read_dir(dir)?.flatten() {
        if entry.file_type()?.is_dir() {
            remove_tree(&entry.path())?;
        }
    }
    fs::remove_dir(dir)
}
