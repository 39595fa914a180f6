//! Everything that is seen of a cell while it is soaked.

use std::collections::{BTreeMap, VecDeque};
use std::path::PathBuf;

use anyhow::{Context as _, bail};
use journal::Follower;
use messages::topics::{ACTIVE, CYCLES, HEALTH};
use messages::{Active, CycleReport, Health, Instance};
use runtime::{Bus, Config, Latest, Subscriber, monotonic_ns};

use super::baseline::{Baseline, Measuring, Second};
use super::faults::Fault;
use super::figures::{BaselineFigures, BusFigures, FaultSum, Figures, LateFigures};
use super::incidents::Incidents;
use super::inflict::Hand;
use super::latency::{Answer, Late, Latencies, action_name};
use super::ledger::Ledger;
use super::machine::{CpuTime, Machine};
use super::processes::{Processes, SLOPE_POINTS_MIN, shared_memory};
use super::series::{Series, slope};
use crate::latency::STAGES;

/// How often the journal is read, and the processes are looked at [ns].
const JOURNAL_NS: u64 = 50_000_000;
const SAMPLE_NS: u64 = 1_000_000_000;

/// How soon after another look a late box lets them be looked at again [ns].
const SAMPLE_AGAIN_NS: u64 = 100_000_000;

/// How long a cell may take until all its processes have spoken and a box is over [ns].
const BEGIN_NS: u64 = 20_000_000_000;

/// How long an attached cell may be silent before it counts as gone [ns].
const SILENCE_NS: u64 = 10_000_000_000;

/// Late boxes that wait for the baseline's word about their second.
const UNEXPLAINED_MAX: usize = 100_000;

/// How long shared memory may grow at the beginning [s].
const WARM_UP_S: f64 = 20.0;

/// The watch over one cell.
pub(crate) struct Watch {
    root_dir: PathBuf,
    prefix: String,
    is_own: bool,
    budget_ms: u64,
    cycles: Subscriber<CycleReport>,
    health: Subscriber<Health>,
    active: Latest<Active>,
    journal: Follower,
    journal_path: PathBuf,
    ledger: Ledger,
    pub(crate) latencies: Latencies,
    processes: Processes,
    pub(crate) incidents: Incidents,
    baseline: Option<Measuring>,
    seconds: Series<Second>,
    /// When late boxes were commanded whose second the baseline has not spoken of [ns].
    unexplained: VecDeque<u64>,
    with_baseline: u64,
    machine: Machine,
    cpu: CpuTime,
    /// Second, busy and stolen processors [%].
    cpu_line: Series<(f64, f64, f64)>,
    /// Second, bytes.
    bus_line: Series<(f64, f64)>,
    bus_figures: BusFigures,
    began_ns: u64,
    journal_due_ns: u64,
    sample_due_ns: u64,
    sampled_ns: u64,
    progress_ns: u64,
    seen_boxes: u64,
    heard_ns: u64,
}

/// What the charts are drawn from.
pub(crate) struct Story {
    pub(crate) latencies: Latencies,
    pub(crate) incidents: Incidents,
    pub(crate) processes: Processes,
    pub(crate) baseline: Option<Baseline>,
    /// The slowest ping and timer of a second: second, [us], [us].
    pub(crate) baseline_line: Vec<(f64, f64, f64)>,
    pub(crate) cpu_line: Vec<(f64, f64, f64)>,
    pub(crate) bus_line: Vec<(f64, f64)>,
    pub(crate) began_ns: u64,
}

impl Watch {
    /// A watch that listens already, so that it misses nothing of a cell that is about to start.
    pub(crate) fn new(bus: &Bus, config: &Config, budget_ms: u64, is_own: bool) -> anyhow::Result<Self> {
        let now = monotonic_ns();
        let journal_path = config.state.journal();
        Ok(Self {
            root_dir: config.bus.root_dir.clone(),
            prefix: config.bus.prefix.clone(),
            is_own,
            budget_ms,
            cycles: bus.subscriber(&CYCLES)?,
            health: bus.subscriber(&HEALTH)?,
            active: bus.latest(&ACTIVE)?,
            journal: Follower::from_start(&journal_path),
            journal_path,
            ledger: if is_own { Ledger::of_new_cell() } else { Ledger::default() },
            latencies: Latencies::new(budget_ms * 1_000_000, is_own.then_some(0), now),
            processes: Processes::default(),
            incidents: Incidents::new(now),
            baseline: None,
            seconds: Series::default(),
            unexplained: VecDeque::new(),
            with_baseline: 0,
            machine: Machine::here(),
            cpu: CpuTime::now(),
            cpu_line: Series::default(),
            bus_line: Series::default(),
            bus_figures: BusFigures::default(),
            began_ns: now,
            journal_due_ns: 0,
            sample_due_ns: 0,
            sampled_ns: 0,
            progress_ns: now,
            seen_boxes: 0,
            heard_ns: now,
        })
    }

    /// The cell runs, or should.
    pub(crate) fn begin(&mut self, baseline: Option<Measuring>) -> anyhow::Result<()> {
        self.baseline = baseline;
        if !self.is_own {
            self.read_journal()?;
            self.ledger.begin_here();
            if !self.journal_path.exists() {
                bail!(
                    "the cell's journal {} is not there: name its directory with --set state.dir=DIR",
                    self.journal_path.display()
                );
            }
        }
        let now = monotonic_ns();
        (self.progress_ns, self.heard_ns) = (now + BEGIN_NS, now + BEGIN_NS);
        Ok(())
    }

    /// Boxes that are over.
    pub(crate) fn boxes(&self) -> u64 {
        self.ledger.boxes()
    }

    /// Seconds since the soak began.
    pub(crate) fn seconds(&self, now_ns: u64) -> f64 {
        now_ns.saturating_sub(self.began_ns) as f64 / 1e9
    }

    /// How long no box has been over [ns].
    pub(crate) fn still_ns(&self, now_ns: u64) -> u64 {
        now_ns.saturating_sub(self.progress_ns)
    }

    /// Whether no fault is under way or being settled.
    pub(crate) fn is_quiet(&self) -> bool {
        self.incidents.is_settled()
    }

    /// Takes in what the cell said since the last look.
    pub(crate) fn look(&mut self, now_ns: u64) -> anyhow::Result<()> {
        while let Some(word) = self.health.receive()? {
            self.heard_ns = self.heard_ns.max(now_ns);
            self.processes.hear(&word, now_ns);
        }
        self.active.refresh()?;
        while let Some(report) = self.cycles.receive()? {
            if let Some(answer) = self.latencies.record(&report, now_ns) {
                self.incidents.answer(&report, &answer);
                if answer.is_late {
                    self.note_late(&report, &answer, now_ns);
                }
            }
        }
        if now_ns >= self.journal_due_ns {
            self.journal_due_ns = now_ns + JOURNAL_NS;
            self.read_journal()?;
            if self.boxes() > self.seen_boxes {
                (self.seen_boxes, self.progress_ns) = (self.boxes(), self.progress_ns.max(now_ns));
            }
        }
        if now_ns >= self.sample_due_ns {
            self.sample(now_ns);
        }
        self.incidents.settle(now_ns, false);
        if !self.is_own && now_ns > self.heard_ns + SILENCE_NS {
            bail!("no process of the cell speaks any more: it has stopped or hangs");
        }
        Ok(())
    }

    fn read_journal(&mut self) -> anyhow::Result<()> {
        let (journal, ledger) = (&mut self.journal, &mut self.ledger);
        let read = journal.read(|entry| ledger.take(&entry.record));
        read.with_context(|| format!("cannot read the journal {}", self.journal_path.display()))
    }

    fn note_late(&mut self, report: &CycleReport, answer: &Answer, now_ns: u64) {
        if self.baseline.is_some() && self.unexplained.len() < UNEXPLAINED_MAX {
            self.unexplained.push_back(answer.due_ns + answer.latency_ns);
        }
        let circumstances = self.processes.circumstances(now_ns);
        self.latencies.list_late(report, answer.latency_ns, circumstances);
        if now_ns > self.sampled_ns + SAMPLE_AGAIN_NS {
            self.sample(now_ns);
        }
    }

    /// Looks at processes, shared memory, machine and baseline.
    fn sample(&mut self, now_ns: u64) {
        (self.sampled_ns, self.sample_due_ns) = (now_ns, now_ns + SAMPLE_NS);
        self.processes.sample(now_ns);
        let at_s = self.seconds(now_ns);
        let (files, bytes) = shared_memory(&self.root_dir, &self.prefix);
        if self.bus_figures.files_start == 0 || at_s < WARM_UP_S {
            (self.bus_figures.files_start, self.bus_figures.bytes_start) = (files, bytes);
        }
        (self.bus_figures.files_end, self.bus_figures.bytes_end) = (files, bytes);
        self.bus_line.push((at_s, bytes as f64));
        let cpu = CpuTime::now();
        let (busy, stolen) = cpu.percent_since(self.cpu);
        self.cpu_line.push((at_s, busy, stolen));
        self.cpu = cpu;
        for second in self.baseline.iter().flat_map(Measuring::seconds) {
            self.seconds.push(second);
            let is_slow = second.timer_max_us.max(second.ping_max_us) > self.budget_ms * 1000;
            while self.unexplained.front().is_some_and(|&commanded_ns| commanded_ns <= second.at_ns) {
                self.unexplained.pop_front();
                self.with_baseline += u64::from(is_slow);
            }
        }
    }

    /// Lets a fault happen, and notes it.
    pub(crate) fn inflict(&mut self, hand: &mut Hand<'_>, fault: Fault, now_ns: u64) {
        let active = self.active.get().and_then(|said| Instance::from_wire(said.instance).ok()).unwrap_or_default();
        let target = Hand::target_name(&fault, &self.processes, active);
        let number = self.incidents.begin(fault.clone(), target, self.boxes(), now_ns);
        match hand.begin(number, &fault, &self.processes, active) {
            Ok(true) => {}
            Ok(false) => self.incidents.end(number, String::new(), now_ns),
            Err(error) => self.incidents.end(number, format!("{error:#}"), now_ns),
        }
    }

    /// Ends the watch: the figures, and what the charts are drawn from.
    pub(crate) fn finish(mut self, command: String, mut end: String) -> (Figures, Story) {
        let now = monotonic_ns();
        self.incidents.settle(now, true);
        self.machine.end();
        let with_baseline = self.baseline.is_some().then_some(self.with_baseline);
        let baseline = self.baseline.take().and_then(|measuring| match measuring.stop() {
            Ok(baseline) => Some(baseline),
            Err(error) => {
                end = format!("{end}; {error:#}");
                None
            }
        });
        let seconds = self.seconds(now);
        let boxes = self.boxes();
        let warm: Vec<_> = self.bus_line.points().iter().filter(|(at_s, _)| *at_s > WARM_UP_S).copied().collect();
        let bytes_slope = slope(&warm).filter(|_| warm.len() >= SLOPE_POINTS_MIN).map(|a_second| a_second * 3600.0);
        let mut latency_us: BTreeMap<_, _> =
            STAGES.iter().zip(&self.latencies.stages).map(|((name, _), stage)| (*name, stage.percentiles())).collect();
        latency_us.insert("end_to_end", self.latencies.end_to_end.percentiles());
        let restarts = self.processes.watched.iter().map(|(name, watched)| (name.clone(), watched.restarts));
        let figures = Figures {
            command,
            end,
            seconds,
            boxes,
            boxes_per_s: boxes as f64 / seconds.max(1e-9),
            placed: self.ledger.placed,
            set_aside: self.ledger.set_aside,
            containers_replaced: self.ledger.replaced,
            lost: self.ledger.lost,
            doubled: self.ledger.doubled,
            unseen: self.ledger.unseen,
            budget_ms: self.budget_ms,
            over_budget: self.latencies.over_budget,
            over_budget_with_baseline: with_baseline,
            chosen_by: self.ledger.chosen_by.clone(),
            orders_refused: self.ledger.refused,
            messages_refused: self.processes.refused(),
            candidates_max: self.latencies.candidates_max,
            candidates_left_out: self.latencies.left_out,
            restarts: restarts.collect(),
            lost_reports: self.latencies.lost_reports,
            bounded: self.latencies.bounded,
            latency_us,
            baseline: baseline
                .as_ref()
                .map(|found| BaselineFigures { timer_us: found.timer_us, ping_us: found.ping_us }),
            late: self.latencies.late.iter().map(late_figures).collect(),
            faults: self.incidents.listed.clone(),
            faults_count: self.incidents.count,
            faults_by_kind: fault_sums(&self.incidents),
            processes: self.processes.figures(boxes),
            bus: BusFigures { bytes_slope, ..self.bus_figures },
            machine: self.machine,
        };
        let since_s = |at_ns: u64| at_ns.saturating_sub(self.began_ns) as f64 / 1e9;
        let second = |second: &Second| (since_s(second.at_ns), second.ping_max_us as f64, second.timer_max_us as f64);
        let story = Story {
            baseline_line: self.seconds.points().iter().map(second).collect(),
            latencies: self.latencies,
            incidents: self.incidents,
            processes: self.processes,
            baseline,
            cpu_line: self.cpu_line.points().to_vec(),
            bus_line: self.bus_line.points().to_vec(),
            began_ns: self.began_ns,
        };
        (figures, story)
    }
}

fn late_figures(late: &Late) -> LateFigures {
    let cycle = &late.cycle;
    let stage_us = |between: &dyn Fn() -> (u64, u64)| {
        let (from_ns, to_ns) = between();
        (from_ns > 0 && to_ns >= from_ns).then(|| (to_ns - from_ns) / 1000)
    };
    LateFigures {
        box_id: cycle.spec.id,
        order: cycle.order,
        action: action_name(cycle.action),
        latency_us: late.latency_ns / 1000,
        stages_us: STAGES.iter().map(|(name, between)| (*name, stage_us(&|| between(&cycle.stamps)))).collect(),
        candidates: cycle.candidates,
        circumstances: late.circumstances.clone(),
    }
}

fn fault_sums(incidents: &Incidents) -> Vec<FaultSum> {
    let of = |histogram: &hdrhistogram::Histogram<u32>| {
        let ms = |us: u64| us as f64 / 1000.0;
        [ms(histogram.value_at_quantile(0.5)), ms(histogram.value_at_quantile(0.99)), ms(histogram.max())]
    };
    let sums = incidents.sums.iter().map(|(&(kind, target), sum)| FaultSum {
        kind,
        target,
        count: sum.count,
        failed: sum.failed,
        boxes_late: sum.boxes_late,
        worst_ms: of(&sum.worst_us),
        back_ms: (!sum.back_us.is_empty()).then(|| of(&sum.back_us)),
        not_back: sum.not_back,
    });
    sums.collect()
}
