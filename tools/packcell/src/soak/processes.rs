//! What the operating system says of the cell's processes.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::os::unix::fs::MetadataExt as _;
use std::path::Path;

use messages::topics::Role;
use messages::{Health, Instance};
use serde::Serialize;

use super::series::{Series, slope};

/// Processes that are told apart: four roles, and every scorer instance.
const PROCESSES_MAX: usize = 16;

/// How long a process may warm up before its growth is watched [ns].
const WARM_UP_NS: u64 = 20_000_000_000;

/// Fewest samples after the warm-up by which growth is judged.
pub(crate) const SLOPE_POINTS_MIN: usize = 30;

/// Microseconds of a clock tick of /proc/PID/stat: a hundred a second on every Linux.
const US_PER_TICK: u64 = 10_000;

/// A process as it was at one moment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Sample {
    pub(crate) at_ns: u64,
    /// Memory that is its own or shared [KiB].
    rss_kib: u64,
    /// The part of it that is shared memory [KiB].
    shm_kib: u64,
    fds: u64,
    cpu_us: u64,
    /// Time that it was ready to run and did not [ns].
    waited_ns: u64,
    switches: u64,
    forced_switches: u64,
    minor_faults: u64,
    major_faults: u64,
}

/// One process under one name, however often it was restarted.
#[derive(Debug)]
pub(crate) struct Watched {
    pub(crate) role: Role,
    pub(crate) instance: Option<Instance>,
    pub(crate) pid: u32,
    /// The last time it said something about itself [ns].
    pub(crate) heard_ns: u64,
    pub(crate) restarts: u64,
    refused: u64,
    refused_before: u64,
    /// What it said was wrong, last.
    pub(crate) alarm: String,
    first: Option<Sample>,
    last: Option<Sample>,
    cpu_us: u64,
    pub(crate) line: Series<Sample>,
}

/// The processes of a cell, by name.
#[derive(Debug, Default)]
pub(crate) struct Processes {
    pub(crate) watched: BTreeMap<String, Watched>,
    /// Words of processes for which there was no room.
    pub(crate) passed_over: u64,
}

/// One process in the figures.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct ProcessFigures {
    pub(crate) name: String,
    pub(crate) restarts: u64,
    /// Messages it refused, over all its lives.
    pub(crate) refused: u64,
    /// Memory after warm-up [bytes].
    pub(crate) rss_start: u64,
    pub(crate) rss_end: u64,
    /// Growth of memory after warm-up [bytes an hour]; nothing for a process that lived too shortly.
    pub(crate) rss_slope: Option<f64>,
    pub(crate) fds_start: u64,
    pub(crate) fds_end: u64,
    /// Shared memory that it uses, at the end [bytes].
    pub(crate) shm_bytes: u64,
    pub(crate) cpu_us_per_box: f64,
    /// Share of the time that it was ready to run and did not, in its last life.
    pub(crate) waited_share: f64,
    pub(crate) forced_switches: u64,
    /// Pages that the kernel had to find for it after warm-up, in its last life.
    pub(crate) page_faults: u64,
    /// Those of all its last life that waited for a disk.
    pub(crate) major_faults: u64,
}

impl Processes {
    /// A process said how it is.
    pub(crate) fn hear(&mut self, word: &Health, now_ns: u64) {
        let (Ok(role), instance) = (word.role(), Instance::from_wire(word.instance).ok()) else { return };
        if role == Role::Tool {
            return;
        }
        let name = instance.map_or_else(|| role.name().to_owned(), |instance| format!("{} {instance}", role.name()));
        if self.watched.len() == PROCESSES_MAX && !self.watched.contains_key(&name) {
            self.passed_over += 1;
            return;
        }
        let watched = self.watched.entry(name).or_insert_with(|| Watched::new(role, instance, word.pid));
        if watched.pid != word.pid {
            // The word of a life that is over may still be on the bus.
            if !is_program(word.pid, role) {
                return;
            }
            watched.begin_new_life(word.pid);
        }
        watched.refused = word.counters.refused;
        watched.heard_ns = now_ns;
        word.alarm.as_str().clone_into(&mut watched.alarm);
    }

    /// Looks at all of them.
    pub(crate) fn sample(&mut self, now_ns: u64) {
        self.watched.values_mut().for_each(|watched| watched.sample(now_ns));
    }

    /// The process of a role: the scorer of this instance, or any.
    pub(crate) fn find(&self, role: Role, instance: Option<Instance>) -> Option<(&str, u32)> {
        let is_meant = |watched: &Watched| watched.role == role && (instance.is_none() || watched.instance == instance);
        let newest = self.watched.iter().filter(|(_, watched)| is_meant(watched)).max_by_key(|(_, w)| w.heard_ns)?;
        is_program(newest.1.pid, role).then_some((newest.0.as_str(), newest.1.pid))
    }

    /// What every process went through since it was looked at last.
    pub(crate) fn circumstances(&self, now_ns: u64) -> String {
        let mut text = String::new();
        for (name, watched) in &self.watched {
            let (Some(before), Some(now)) = (watched.last, read_sample(watched.pid, now_ns)) else { continue };
            let separator = if text.is_empty() { "" } else { "; " };
            let _ = write!(
                text,
                "{separator}{name}: waited {:.1} ms, {}+{} switches, {}+{} faults",
                now.waited_ns.saturating_sub(before.waited_ns) as f64 / 1e6,
                now.switches.saturating_sub(before.switches),
                now.forced_switches.saturating_sub(before.forced_switches),
                now.minor_faults.saturating_sub(before.minor_faults),
                now.major_faults.saturating_sub(before.major_faults),
            );
        }
        text
    }

    pub(crate) fn figures(&self, boxes: u64) -> Vec<ProcessFigures> {
        self.watched.iter().map(|(name, watched)| watched.figures(name, boxes)).collect()
    }

    /// Messages that were refused, by all.
    pub(crate) fn refused(&self) -> u64 {
        self.watched.values().map(|watched| watched.refused + watched.refused_before).sum()
    }
}

impl Watched {
    fn new(role: Role, instance: Option<Instance>, pid: u32) -> Self {
        Self {
            role,
            instance,
            pid,
            heard_ns: 0,
            restarts: 0,
            refused: 0,
            refused_before: 0,
            alarm: String::new(),
            first: None,
            last: None,
            cpu_us: 0,
            line: Series::default(),
        }
    }

    fn begin_new_life(&mut self, pid: u32) {
        self.restarts += 1;
        self.refused_before += std::mem::take(&mut self.refused);
        (self.pid, self.first, self.last) = (pid, None, None);
    }

    fn sample(&mut self, now_ns: u64) {
        // One that is being started or is ending has no memory, and says nothing about a process at work.
        let Some(sample) = read_sample(self.pid, now_ns).filter(|sample| sample.rss_kib > 0) else { return };
        self.cpu_us += sample.cpu_us - self.last.map_or(0, |last| last.cpu_us.min(sample.cpu_us));
        self.first.get_or_insert(sample);
        self.last = Some(sample);
        self.line.push(sample);
    }

    fn figures(&self, name: &str, boxes: u64) -> ProcessFigures {
        let (first, last) = (self.first.unwrap_or_default(), self.last.unwrap_or_default());
        // A new life is another process: only the last one's growth is a leak.
        let warm_ns = first.at_ns + WARM_UP_NS;
        let warm: Vec<_> = self.line.points().iter().filter(|sample| sample.at_ns >= warm_ns).collect();
        let start = warm.first().map_or(first, |sample| **sample);
        let points: Vec<_> =
            warm.iter().map(|sample| (sample.at_ns as f64 / 3.6e12, sample.rss_kib as f64 * 1024.0)).collect();
        let lived_ns = last.at_ns.saturating_sub(first.at_ns).max(1);
        ProcessFigures {
            name: name.to_owned(),
            restarts: self.restarts,
            refused: self.refused + self.refused_before,
            rss_start: start.rss_kib * 1024,
            rss_end: last.rss_kib * 1024,
            rss_slope: slope(&points).filter(|_| points.len() >= SLOPE_POINTS_MIN),
            fds_start: start.fds,
            fds_end: last.fds,
            shm_bytes: last.shm_kib * 1024,
            cpu_us_per_box: self.cpu_us as f64 / boxes.max(1) as f64,
            waited_share: last.waited_ns.saturating_sub(first.waited_ns) as f64 / lived_ns as f64,
            forced_switches: last.forced_switches,
            page_faults: (last.minor_faults + last.major_faults)
                .saturating_sub(start.minor_faults + start.major_faults),
            major_faults: last.major_faults,
        }
    }
}

impl Sample {
    /// Memory that is not shared [MiB].
    pub(crate) fn own_mib(&self) -> f64 {
        self.rss_kib.saturating_sub(self.shm_kib) as f64 / 1024.0
    }
}

/// Whether a process runs the program of a role: its number may belong to somebody else by now.
fn is_program(pid: u32, role: Role) -> bool {
    fs::read_to_string(format!("/proc/{pid}/comm")).is_ok_and(|name| name.trim() == role.name())
}

/// A process at this moment; nothing if it is gone.
fn read_sample(pid: u32, now_ns: u64) -> Option<Sample> {
    let read = |file: &str| fs::read_to_string(format!("/proc/{pid}/{file}")).ok();
    let fds = fs::read_dir(format!("/proc/{pid}/fd")).map_or(0, Iterator::count) as u64;
    // A kernel without scheduling statistics has no such file, and the wait is then not known.
    let waits = read("schedstat").unwrap_or_default();
    parse(&read("stat")?, &read("status")?, &waits).map(|sample| Sample { at_ns: now_ns, fds, ..sample })
}

fn parse(stat: &str, status: &str, waits: &str) -> Option<Sample> {
    // The name in brackets may hold anything; what follows it begins with the third field.
    let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    let field = |number: usize| fields.get(number - 3)?.parse::<u64>().ok();
    let line = |name: &str| {
        let value = status.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(':'))?;
        value.split_whitespace().next()?.parse::<u64>().ok()
    };
    Some(Sample {
        at_ns: 0,
        rss_kib: line("VmRSS")?,
        shm_kib: line("RssShmem").unwrap_or_default(),
        fds: 0,
        cpu_us: (field(14)? + field(15)?) * US_PER_TICK,
        waited_ns: waits.split_whitespace().nth(1).and_then(|text| text.parse().ok()).unwrap_or_default(),
        switches: line("voluntary_ctxt_switches")?,
        forced_switches: line("nonvoluntary_ctxt_switches")?,
        minor_faults: field(10)?,
        major_faults: field(12)?,
    })
}

/// Files and bytes of a bus in shared memory.
pub(crate) fn shared_memory(root_dir: &Path, prefix: &str) -> (u64, u64) {
    let (mut files, mut bytes) = (0, 0);
    let mut open = vec![root_dir.to_owned()];
    let mut count = |path: &Path| {
        if let Ok(state) = fs::symlink_metadata(path) {
            files += 1;
            bytes += state.blocks() * 512;
        }
    };
    while let Some(dir) = open.pop() {
        for entry in fs::read_dir(&dir).into_iter().flatten().flatten() {
            if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
                open.push(entry.path());
            } else {
                count(&entry.path());
            }
        }
    }
    for entry in fs::read_dir("/dev/shm").into_iter().flatten().flatten() {
        if entry.file_name().to_string_lossy().starts_with(prefix) {
            count(&entry.path());
        }
    }
    (files, bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    const STAT: &str =
        "77 (a b) c) S 1 77 77 0 -1 4194560 310 0 4 0 12 30 0 0 20 0 2 0 5 1000 200 18446744073709551615";
    const STATUS: &str = "Name:\tx\nVmRSS:\t   9000 kB\nRssShmem:\t  4000 kB\nvoluntary_ctxt_switches:\t50\n\
                          nonvoluntary_ctxt_switches:\t6\n";

    #[test]
    fn what_the_kernel_says_is_understood() {
        let sample = parse(STAT, STATUS, "100 2500 3").unwrap();
        let expected = Sample {
            rss_kib: 9000,
            shm_kib: 4000,
            cpu_us: 420_000,
            waited_ns: 2500,
            switches: 50,
            forced_switches: 6,
            minor_faults: 310,
            major_faults: 4,
            ..Sample::default()
        };
        assert_eq!(sample, expected);
        assert_eq!(parse("", STATUS, ""), None);
        assert!(read_sample(std::process::id(), 5).is_some_and(|own| own.fds > 0 && own.rss_kib > 1000));
    }
}
