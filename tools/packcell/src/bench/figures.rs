//! What was measured, as a table and as JSON.

use std::collections::BTreeMap;
use std::fmt;
use std::fs;
use std::thread;

use anyhow::Context as _;
use comfy_table::{CellAlignment, Table, presets};
use runtime::Config;
use serde::Serialize;

use super::Decision;
use crate::latency::{Latencies, STAGES, Summary};

/// Times of all boxes [ns].
#[derive(Debug, Default)]
pub(crate) struct Times {
    /// Bus, sockets, one process.
    totals_ns: [Vec<u64>; 3],
    differences: usize,
}

impl Times {
    /// Counts one box.
    pub(crate) fn record(&mut self, decisions: [Decision; 3]) {
        for (totals_ns, decision) in self.totals_ns.iter_mut().zip(decisions) {
            totals_ns.push(decision.total_ns);
        }
        let is_other = |decision: &Decision| decision.command.placement != decisions[0].command.placement;
        self.differences += usize::from(decisions.iter().any(is_other));
    }
}

/// What was measured, as `--json` writes it.
#[derive(Debug, Serialize)]
pub(crate) struct Figures {
    policy: String,
    engine: String,
    processor: String,
    processors: usize,
    /// Mean number of processes that wanted to run, over the last minute, before and after.
    load: [f64; 2],
    /// Boxes that the three did not put in one place: 0, unless the policy plans for a time.
    differences: usize,
    /// From the box to the command.
    bus_us: Summary,
    sockets_us: Summary,
    one_process_us: Summary,
    /// What carrying the messages costs, box by box: all of it less the work in one process.
    bus_transport_us: Summary,
    sockets_transport_us: Summary,
    /// Sockets over bus, medians [-].
    transport_ratio: f64,
    /// Where the time goes on the bus.
    stages_us: BTreeMap<&'static str, Summary>,
}

impl Figures {
    /// The figures of some boxes.
    pub(crate) fn new(config: &Config, times: &Times, stages: &Latencies, load: [f64; 2]) -> anyhow::Result<Self> {
        let [bus, sockets, alone] = &times.totals_ns;
        let less = |totals: &[u64]| totals.iter().zip(alone).map(|(total, work)| total.saturating_sub(*work)).collect();
        let summary = |times_ns: Vec<u64>| summary(times_ns).context("stopped before a box was measured");
        let (bus_transport_us, sockets_transport_us) = (summary(less(bus))?, summary(less(sockets))?);
        Ok(Self {
            policy: config.scorer.policy.clone(),
            engine: config.scorer.engine.clone(),
            processor: processor(),
            processors: thread::available_parallelism()?.get(),
            load,
            differences: times.differences,
            bus_us: summary(bus.clone())?,
            sockets_us: summary(sockets.clone())?,
            one_process_us: summary(alone.clone())?,
            transport_ratio: sockets_transport_us.p50 / bus_transport_us.p50,
            bus_transport_us,
            sockets_transport_us,
            stages_us: stages.summaries().collect(),
        })
    }
}

impl Figures {
    /// The stages of a box on the bus, one after the other; medians, which add up to about the median of the whole.
    pub(crate) fn picture(&self) -> String {
        let medians = STAGES.iter().filter_map(|(stage, _)| Some((*stage, self.stages_us.get(stage)?.p50)));
        let (stages, medians): (Vec<&str>, Vec<f64>) = medians.unzip();
        let name = format!("{} on {}, from box to command", self.policy, self.engine);
        report::standalone(&report::stacked_bars("median [us]", &stages, &[(&name, medians)]))
    }
}

impl fmt::Display for Figures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "policy             {} on {}", self.policy, self.engine)?;
        writeln!(f, "machine            {} processors, {}", self.processors, self.processor)?;
        writeln!(f, "load               {:.1} before, {:.1} after", self.load[0], self.load[1])?;
        writeln!(f, "decided alike      {} of {}", self.bus_us.count - self.differences as u64, self.bus_us.count)?;
        writeln!(f, "transport          sockets cost {:.2} times what the bus costs", self.transport_ratio)?;
        let mut table = Table::new();
        table.load_style(presets::UTF8_HORIZONTAL_ONLY);
        table.set_header(["from box to command [us]", "count", "p50", "p99", "p99.9", "max"]);
        let rows = [
            ("four processes on the bus", self.bus_us),
            ("four processes on sockets", self.sockets_us),
            ("one process", self.one_process_us),
            ("bus less one process", self.bus_transport_us),
            ("sockets less one process", self.sockets_transport_us),
        ];
        let stages = self.stages_us.iter().map(|(name, us)| (*name, *us));
        for (name, us) in rows.into_iter().chain(stages) {
            let numbers = [us.p50, us.p99, us.p99_9, us.max].map(|us| format!("{us:.0}"));
            table.add_row([name.to_owned(), us.count.to_string()].into_iter().chain(numbers));
        }
        for column in table.column_iter_mut().skip(1) {
            column.set_cell_alignment(CellAlignment::Right);
        }
        write!(f, "{table}")
    }
}

fn summary(mut times_ns: Vec<u64>) -> Option<Summary> {
    times_ns.sort_unstable();
    let us = |ns: u64| (ns / 100) as f64 / 10.0;
    let at = |quantile: f64| {
        let rank = (quantile * times_ns.len() as f64).ceil() as usize;
        times_ns.get(rank.saturating_sub(1)).copied().map(us)
    };
    let (p50, p99, p99_9, max) = (at(0.5)?, at(0.99)?, at(0.999)?, us(*times_ns.last()?));
    Some(Summary { count: times_ns.len() as u64, p50, p99, p99_9, max })
}

/// Mean number of processes that wanted to run over the last minute.
pub(crate) fn load() -> anyhow::Result<f64> {
    let text = fs::read_to_string("/proc/loadavg").context("cannot tell the machine's load")?;
    text.split(' ').next().and_then(|load| load.parse().ok()).context("/proc/loadavg has no load")
}

fn processor() -> String {
    let text = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = text.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    name.map_or_else(|| "of unknown name".to_owned(), |(_, name)| name.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_values_that_were_measured() {
        let summary = summary((1..=1000).map(|us| us * 1000).rev().collect()).unwrap();
        assert_eq!((summary.count, summary.p50, summary.p99), (1000, 500.0, 990.0));
        assert_eq!((summary.p99_9, summary.max), (999.0, 1000.0));
        assert!(super::summary(Vec::new()).is_none());
    }
}
