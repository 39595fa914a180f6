//! `packcell swap`: another model for a running cell, without a pause.
//!
//! The new scorer instance answers every set beside the active one and is not obeyed. When it has answered enough of
//! them, and nothing speaks against it, one message to the commander makes it the active one. Whatever happens
//! before that message, the cell packs on as it did; whatever happens after it, as it will.

mod settings;
mod shadow;

use std::path::PathBuf;
use std::thread;
use std::time::Duration;

use anyhow::{Context as _, bail};
use comfy_table::{Table, presets};
use messages::topics::{ACTIVE, CANDIDATES, CONTROL, CYCLES, DECISIONS, HEALTH, Role};
use messages::{Active, CandidateSet, Control, CycleReport, Decision, Health, Instance, Wish};
use runtime::{Bus, Config, Latest, Publisher, ScorerConfig, Subscriber, monotonic_ns, processes_on};

use crate::args::WhichCell;
use crate::owner::act_as_owner;
use shadow::{Answers, Shadow};

/// How often the bus is looked at.
const LOOK: Duration = Duration::from_millis(1);

/// How long the cell's processes are listened to before anything is done: each speaks five times a second [ns].
const CENSUS_NS: u64 = 1_000_000_000;

/// How long a new scorer may take to be ready [ns].
const READY_NS: u64 = 20_000_000_000;

/// How long the commander may take to answer [ns].
const ANSWER_NS: u64 = 5_000_000_000;

/// How often a wish is said again [ns].
const REPEAT_NS: u64 = 100_000_000;

/// How long boxes may take that the old scorer still decides [ns].
const DRAIN_NS: u64 = 2_000_000_000;

#[derive(Debug, clap::Args)]
pub(crate) struct SwapArgs {
    #[command(flatten)]
    which: WhichCell,
    /// The new scorer's model file
    #[arg(long, value_name = "FILE", conflicts_with = "back")]
    model: Option<PathBuf>,
    /// The new scorer's policy; without it, the active scorer's
    #[arg(long, value_name = "NAME", conflicts_with = "back")]
    policy: Option<String>,
    /// Return to the model before the last swap
    #[arg(long)]
    back: bool,
    /// Compare, and change nothing
    #[arg(long)]
    dry_run: bool,
    /// Sets that the new scorer must have answered beside the active one
    #[arg(long, value_name = "N", default_value_t = 50)]
    sets: u64,
    /// How long that may take, in seconds
    #[arg(long, value_name = "S", default_value_t = 120)]
    patience: u64,
    /// Slowest answer of the new scorer that is accepted, p99 in milliseconds; without it, the soft deadline
    #[arg(long, value_name = "MS")]
    p99_max_ms: Option<u64>,
    /// Share of the sets, from 0 to 1, on which the new scorer must choose as the active one does
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    agree_min: f64,
}

pub(crate) fn run(args: &SwapArgs) -> anyhow::Result<()> {
    if args.model.is_none() && args.policy.is_none() && !args.back {
        bail!("say what to swap in: --model FILE, --policy NAME, or --back");
    }
    let config = args.which.config()?;
    act_as_owner(&config.bus)?;
    if processes_on(&config.bus)? == 0 {
        bail!("no cell runs on the bus {}", config.bus.root_dir.display());
    }
    let mut swap = Swap::begin(args, &config)?;
    let shadow = match swap.compare(args) {
        Ok(shadow) => shadow,
        Err(error) => {
            swap.withdraw()?;
            return Err(error);
        }
    };
    println!("{}", swap.table(&shadow));
    let p99_max_us = 1000 * args.p99_max_ms.unwrap_or(config.commander.soft_deadline_ms);
    if let Some(objection) = shadow.objection(p99_max_us, args.agree_min) {
        swap.withdraw()?;
        bail!("not promoted: {objection}; scorer {} goes on", swap.active);
    }
    if args.dry_run {
        swap.withdraw()?;
        println!("nothing speaks against it; nothing was changed (--dry-run)");
        return Ok(());
    }
    if let Err(error) = swap.promote() {
        swap.withdraw()?;
        return Err(error);
    }
    swap.retire_old()?;
    println!("scorer {} is active; 'packcell swap --back' returns to the model before", swap.newcomer);
    Ok(())
}

/// A swap under way.
struct Swap {
    config: Config,
    bus: Bus,
    controls: Publisher<Control>,
    health: Subscriber<Health>,
    said_active: Latest<Active>,
    sets: Subscriber<CandidateSet>,
    decisions: Subscriber<Decision>,
    cycles: Subscriber<CycleReport>,
    /// The instance that is obeyed when the swap begins.
    active: Instance,
    /// Its process, if it runs.
    active_pid: Option<u32>,
    newcomer: Instance,
    /// Its process, once it is ready.
    newcomer_pid: Option<u32>,
}

impl Swap {
    /// Looks at the cell, and starts the new scorer.
    fn begin(args: &SwapArgs, config: &Config) -> anyhow::Result<Self> {
        let bus = Bus::join(&config.bus, Role::Tool)?;
        let controls = bus.publisher(&CONTROL).context("is another swap under way?")?;
        let (health, mut said_active) = (bus.subscriber(&HEALTH)?, bus.latest(&ACTIVE)?);
        let mut scorers = Vec::new();
        let until_ns = monotonic_ns() + CENSUS_NS;
        while monotonic_ns() < until_ns && !bus.is_stopping() {
            while let Some(word) = health.receive()? {
                if let Ok(instance) = Instance::from_wire(word.instance) {
                    scorers.push((instance, word.pid));
                }
            }
            said_active.refresh()?;
            thread::sleep(LOOK);
        }
        let active = said_active.get().context("the commander does not say whom it obeys: has it stopped?")?;
        let active = Instance::from_wire(active.instance)?;
        let is_free = |instance: &Instance| scorers.iter().all(|(taken, _)| taken != instance) && *instance != active;
        let newcomer = Instance::all().find(is_free).context("all scorer instances are in use")?;
        let mut swap = Self {
            active_pid: scorers.iter().find(|(instance, _)| *instance == active).map(|(_, pid)| *pid),
            sets: bus.subscriber(&CANDIDATES)?,
            decisions: bus.subscriber(&DECISIONS)?,
            cycles: bus.subscriber(&CYCLES)?,
            config: config.clone(),
            newcomer_pid: None,
            bus,
            controls,
            health,
            said_active,
            active,
            newcomer,
        };
        if let Err(error) = swap.start_newcomer(args) {
            swap.withdraw()?;
            return Err(error);
        }
        Ok(swap)
    }

    /// What the new scorer is to run with.
    fn wanted(&self, args: &SwapArgs) -> anyhow::Result<ScorerConfig> {
        let mut settings = self.config.scorer_instance(self.active)?;
        if args.back {
            let path = settings::previous(&self.config.state);
            let text = std::fs::read_to_string(&path)
                .with_context(|| format!("there is nothing to go back to ({})", path.display()))?;
            return toml::from_str(&text).with_context(|| path.display().to_string());
        }
        if let Some(policy) = &args.policy {
            settings.policy.clone_from(policy);
            settings.model = PathBuf::new();
        }
        if let Some(model) = &args.model {
            settings.model = std::path::absolute(model).context("--model")?;
        }
        Ok(settings)
    }

    fn start_newcomer(&mut self, args: &SwapArgs) -> anyhow::Result<()> {
        let (state, newcomer) = (&self.config.state, self.newcomer);
        settings::install(state, newcomer, self.wanted(args)?)?;
        settings::check(&args.which.file()?, state, newcomer)?;
        // 'packcell up' hears the wish; systemd sees the instance's settings.
        publish(&mut self.controls, Wish::Start, newcomer, 0)?;
        println!("scorer {newcomer} is started beside scorer {}", self.active);
        let until_ns = monotonic_ns() + READY_NS;
        while self.newcomer_pid.is_none() {
            self.go_on(
                until_ns,
                "the new scorer is not ready in time: does 'packcell up' or systemd keep this cell running?",
            )?;
            while let Some(word) = self.health.receive()? {
                if word.instance == newcomer.to_wire() {
                    self.newcomer_pid = Some(word.pid);
                }
            }
        }
        Ok(())
    }

    /// Lets the new scorer answer beside the active one.
    fn compare(&self, args: &SwapArgs) -> anyhow::Result<Shadow> {
        let mut shadow = Shadow::new(self.newcomer.to_wire(), self.active.to_wire());
        let until_ns = monotonic_ns() + args.patience * 1_000_000_000;
        while shadow.answered() < args.sets && shadow.answers_newcomer.rubbish.is_empty() {
            self.go_on(until_ns, "the new scorer has not answered enough sets in time (--sets, --patience)")?;
            // Decisions first: whatever decision is seen, its set is seen too.
            let mut decided = Vec::new();
            while let Some(decision) = self.decisions.receive()? {
                decided.push(*decision);
            }
            while let Some(set) = self.sets.receive()? {
                shadow.on_set(&set);
            }
            decided.iter().for_each(|decision| shadow.on_decision(decision));
        }
        Ok(shadow)
    }

    /// Makes the new scorer the active one.
    fn promote(&mut self) -> anyhow::Result<()> {
        let request = monotonic_ns();
        let (until_ns, mut repeat_ns) = (request + ANSWER_NS, 0);
        loop {
            if monotonic_ns() >= repeat_ns {
                publish(&mut self.controls, Wish::Promote, self.newcomer, request)?;
                repeat_ns = monotonic_ns() + REPEAT_NS;
            }
            self.said_active.refresh()?;
            let is_answered = |said: &&Active| said.request == request && said.instance == self.newcomer.to_wire();
            if self.said_active.get().filter(is_answered).is_some() {
                return Ok(());
            }
            self.go_on(until_ns, "the commander does not answer: 'packcell status' shows its alarm")?;
        }
    }

    /// Stops the scorer that was active, after the boxes that it still decided.
    fn retire_old(&mut self) -> anyhow::Result<()> {
        let until_ns = monotonic_ns() + DRAIN_NS;
        let mut is_drained = false;
        while !is_drained && monotonic_ns() < until_ns {
            while let Some(cycle) = self.cycles.receive()? {
                is_drained |= cycle.instance == self.newcomer.to_wire();
            }
            thread::sleep(LOOK);
        }
        settings::put_aside(&self.config, self.active)?;
        self.stop(self.active, self.active_pid)?;
        println!("scorer {} is retired", self.active);
        Ok(())
    }

    /// Stops the new scorer: the cell is as it was.
    fn withdraw(&mut self) -> anyhow::Result<()> {
        // Its settings first: as long as they are there, systemd would start it again.
        settings::remove(&self.config.state, self.newcomer)?;
        self.stop(self.newcomer, self.newcomer_pid)
    }

    /// Has an instance stopped, and sees it end: the process that is known, and any that systemd or `packcell up` put in
    /// its place meanwhile.
    fn stop(&mut self, instance: Instance, pid: Option<u32>) -> anyhow::Result<()> {
        let begun_ns = monotonic_ns();
        let (mut pid, mut heard_ns, mut repeat_ns) = (pid, begun_ns, begun_ns);
        let is_running = |pid: Option<u32>| pid.is_some_and(|pid| PathBuf::from(format!("/proc/{pid}")).exists());
        while is_running(pid) || monotonic_ns() < heard_ns + CENSUS_NS {
            if monotonic_ns() > begun_ns + ANSWER_NS {
                bail!("scorer {instance} does not stop; the cell packs on");
            }
            if monotonic_ns() >= repeat_ns {
                publish(&mut self.controls, Wish::Retire, instance, 0)?;
                repeat_ns = monotonic_ns() + REPEAT_NS;
            }
            while let Some(word) = self.health.receive()? {
                if word.instance == instance.to_wire() {
                    (pid, heard_ns) = (Some(word.pid), monotonic_ns());
                }
            }
            thread::sleep(LOOK);
        }
        Ok(())
    }

    /// Waits a little; fails at the end of patience, or when the operator interrupts.
    fn go_on(&self, until_ns: u64, too_late: &'static str) -> anyhow::Result<()> {
        if self.bus.is_stopping() {
            bail!("interrupted; scorer {} goes on", self.active);
        }
        if monotonic_ns() > until_ns {
            bail!("{too_late}; scorer {} goes on", self.active);
        }
        thread::sleep(LOOK);
        Ok(())
    }

    fn table(&self, shadow: &Shadow) -> Table {
        let mut table = Table::new();
        table.load_style(presets::UTF8_HORIZONTAL_ONLY);
        table.set_header(["scorer", "sets answered", "p50 [us]", "p99 [us]", "mean value", "same choice"]);
        let row = |name: String, answers: &Answers, agreement: String| {
            let at = |quantile| answers.latency_us.value_at_quantile(quantile).to_string();
            let (sets, mean) = (answers.latency_us.len().to_string(), format!("{:.3}", answers.mean_value()));
            [name, sets, at(0.5), at(0.99), mean, agreement]
        };
        let agreement =
            shadow.agreement().map_or_else(|| "unknown".to_owned(), |share| format!("{:.0} %", 100.0 * share));
        table.add_row(row(format!("{} (active)", self.active), &shadow.answers_active, String::new()));
        table.add_row(row(format!("{} (new)", self.newcomer), &shadow.answers_newcomer, agreement));
        table
    }
}

fn publish(controls: &mut Publisher<Control>, wish: Wish, instance: Instance, request: u64) -> anyhow::Result<()> {
    controls.publish(0, |control| {
        (control.request, control.wish, control.instance) = (request, wish.to_wire(), instance.to_wire());
    })?;
    Ok(())
}
