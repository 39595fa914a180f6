//! The machine on which it was measured.

use std::fs;
use std::thread;

use serde::Serialize;

/// What a reader of latencies wants to know of a machine.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Machine {
    pub(crate) cpu: String,
    pub(crate) cpus: usize,
    pub(crate) kernel: String,
    /// How the clock rate is chosen; "not visible" in most virtual machines.
    pub(crate) governor: String,
    /// How the cell's processes are scheduled.
    pub(crate) policy: String,
    /// Load averages over 1, 5 and 15 minutes when the soak began.
    pub(crate) load_start: String,
    /// The same at its end.
    pub(crate) load_end: String,
}

/// Processor time of the whole machine since it was started [ticks].
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct CpuTime {
    busy: u64,
    stolen: u64,
    all: u64,
}

impl Machine {
    pub(crate) fn here() -> Self {
        let cpuinfo = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
        let model = cpuinfo.lines().find_map(|line| line.strip_prefix("model name")?.split_once(": "));
        let load = load();
        Self {
            cpu: model.map_or_else(|| "unknown".to_owned(), |(_, name)| name.to_owned()),
            cpus: thread::available_parallelism().map_or(0, usize::from),
            kernel: line_of("/proc/sys/kernel/osrelease").unwrap_or_else(|| "unknown".to_owned()),
            governor: line_of("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor")
                .unwrap_or_else(|| "not visible".to_owned()),
            policy: own_policy().unwrap_or_else(|| "unknown".to_owned()),
            load_end: load.clone(),
            load_start: load,
        }
    }

    /// Notes how loaded the machine is at the end.
    pub(crate) fn end(&mut self) {
        self.load_end = load();
    }

    pub(crate) fn facts(&self) -> [(&'static str, String); 6] {
        [
            ("processor", format!("{} x {}", self.cpus, self.cpu)),
            ("kernel", self.kernel.clone()),
            ("clock governor", self.governor.clone()),
            ("scheduling", self.policy.clone()),
            ("load at the start (1, 5, 15 min)", self.load_start.clone()),
            ("load at the end", self.load_end.clone()),
        ]
    }
}

impl CpuTime {
    pub(crate) fn now() -> Self {
        fs::read_to_string("/proc/stat").ok().as_deref().and_then(Self::parse).unwrap_or_default()
    }

    fn parse(stat: &str) -> Option<Self> {
        // user nice system idle iowait irq softirq steal
        let fields: Vec<u64> =
            stat.lines().next()?.split_whitespace().skip(1).take(8).filter_map(|text| text.parse().ok()).collect();
        let [user, nice, system, idle, waiting, irq, soft, stolen] = fields[..] else { return None };
        let busy = user + nice + system + irq + soft;
        Some(Self { busy, stolen, all: busy + idle + waiting + stolen })
    }

    /// Shares of the processors that were busy, and that another virtual machine had, since `before` [%].
    pub(crate) fn percent_since(self, before: Self) -> (f64, f64) {
        let all = self.all.saturating_sub(before.all).max(1) as f64;
        let percent = |now: u64, before: u64| 100.0 * now.saturating_sub(before) as f64 / all;
        (percent(self.busy, before.busy), percent(self.stolen, before.stolen))
    }
}

fn line_of(path: &str) -> Option<String> {
    Some(fs::read_to_string(path).ok()?.trim().to_owned())
}

fn load() -> String {
    let text = line_of("/proc/loadavg").unwrap_or_default();
    text.split_whitespace().take(3).collect::<Vec<_>>().join(", ")
}

/// The policy of this process, which those it starts inherit.
fn own_policy() -> Option<String> {
    let stat = line_of("/proc/self/stat")?;
    let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    let field = |number: usize| fields.get(number - 3).copied();
    let policy = match field(41)? {
        "0" => format!("SCHED_OTHER, nice {}", field(19)?),
        "1" => format!("SCHED_FIFO, priority {}", field(40)?),
        "2" => format!("SCHED_RR, priority {}", field(40)?),
        "3" => "SCHED_BATCH".to_owned(),
        other => format!("policy {other}"),
    };
    Some(policy)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_machine_is_described() {
        let machine = Machine::here();
        assert!(machine.cpus > 0 && !machine.kernel.is_empty() && machine.policy != "unknown");
        let before = CpuTime::parse("cpu  10 0 10 80 0 0 0 0 0 0\n").unwrap();
        let now = CpuTime::parse("cpu  40 0 30 120 0 0 0 10 0 0\n").unwrap();
        assert_eq!(now.percent_since(before), (50.0, 10.0));
        assert!(CpuTime::parse("intr 1").is_none());
    }
}
