//! `scorer`: answers every candidate set with the candidate that its policy values most.
//!
//! Reads `packcell/candidates` and `packcell/belief`, writes `packcell/decisions`. Several instances may run; the
//! commander obeys one.

use anyhow::Context as _;
use clap::Parser;
use messages::topics::{BELIEF, CANDIDATES, CONTROL, DECISIONS, Role};
use messages::{Instance, Wish};
use policy::{Engine, Model, Policy, PolicyKind};
use runtime::{Bus, Reporter, ScorerConfig, ServiceArgs, monotonic_ns};
use scorer::Scorer;
use tracing::info;

/// Scores the candidates of every box with a trained network.
#[derive(Parser)]
#[command(version)]
struct Args {
    #[command(flatten)]
    service: ServiceArgs,
    /// The letter of this instance: a to h
    #[arg(long, default_value = "a")]
    instance: Instance,
    /// Only load the policy and its model, say what they are, and end
    #[arg(long)]
    check: bool,
}

fn main() -> anyhow::Result<()> {
    let args = Args::parse();
    let config = args.service.load()?;
    let settings = config.scorer_instance(args.instance)?;
    let (policy, detail) = load_policy(&settings)?;
    let mut scorer = Scorer::new(policy, args.instance);
    let think_ns = settings.think_us * 1000;
    scorer.warm_up(config.container_size()?, config.container.slots);
    if args.check {
        info!(policy = detail, "can be used");
        return Ok(());
    }

    let bus = Bus::join(&config.bus, Role::Scorer)?;
    let bell = bus.bell()?;
    let mut beliefs = bus.latest(&BELIEF)?;
    let mut sets = bus.latest(&CANDIDATES)?;
    let mut decisions = bus.publisher(&DECISIONS)?;
    let controls = bus.subscriber(&CONTROL)?;
    let mut reporter = Reporter::new(&bus, &detail)?.of_instance(args.instance.to_wire());
    info!(instance = %args.instance, "ready: {detail}");

    while bell.wait(None)? {
        let received_ns = monotonic_ns();
        if sets.refresh()? {
            beliefs.refresh()?;
            if let (Some(set), Some(belief)) = (sets.get(), beliefs.get())
                && let Some(verdict) =
                    scorer.decide(set, belief, received_ns, &mut || monotonic_ns() >= received_ns + think_ns)
            {
                decisions.publish(verdict.observed_ns(), |decision| verdict.write(decision, received_ns))?;
            }
        }
        while let Some(control) = controls.receive()? {
            if control.wish == Wish::Retire.to_wire() && control.instance == args.instance.to_wire() {
                info!("retired");
                return Ok(());
            }
        }
        reporter.report_if_due(scorer.tally())?;
    }
    info!("stopped");
    Ok(())
}

/// The configured policy, and what it is in a few words.
fn load_policy(config: &ScorerConfig) -> anyhow::Result<(Policy, String)> {
    let kind: PolicyKind = config.policy.parse().context("scorer.policy")?;
    let engine: Engine = config.engine.parse().context("scorer.engine")?;
    let file = &config.model;
    let is_built_in = file.as_os_str().is_empty() || kind == PolicyKind::Walle;
    let model =
        if is_built_in { kind.built_in_model() } else { Model::load(file).map(Some) }.context("scorer.model")?;
    let policy = Policy::new(kind, engine, model.as_ref())?;
    let detail = format!("{kind} {:016x} on {engine}", policy.fingerprint());
    Ok((policy, detail))
}
