//! `candidates`: answers every box on the belt with the places where it could go.
//!
//! Reads `packcell/boxes` and `packcell/belief`, writes `packcell/candidates`.

use candidates::Candidates;
use clap::Parser;
use messages::topics::{BELIEF, BOXES, CANDIDATES, Role};
use runtime::{Bus, Reporter, ServiceArgs, monotonic_ns};
use tracing::info;

/// How long after an answer the service looks ahead [ns]. The box is decided by then: nobody waits for a processor.
const LOOK_AHEAD_AFTER_NS: u64 = 5_000_000;

/// Finds the places where the box on the belt could go.
#[derive(Parser)]
#[command(version)]
struct Args {
    #[command(flatten)]
    service: ServiceArgs,
}

fn main() -> anyhow::Result<()> {
    let config = Args::parse().service.load()?;
    let mut candidates = Candidates::new(config.walle_weights()?);

    let bus = Bus::join(&config.bus, Role::Candidates)?;
    let bell = bus.bell()?;
    let mut beliefs = bus.latest(&BELIEF)?;
    let mut queues = bus.latest(&BOXES)?;
    let mut sets = bus.publisher(&CANDIDATES)?;
    let mut reporter = Reporter::new(&bus, "corner placements")?;
    info!("ready");

    let mut look_ahead_ns = None;
    while bell.wait(look_ahead_ns)? {
        let received_ns = monotonic_ns();
        if queues.refresh()? {
            beliefs.refresh()?;
            if let (Some(queue), Some(belief)) = (queues.get(), beliefs.get())
                && let Some(found) = candidates.find(queue, belief)
            {
                let answered_ns = sets.publish(found.observed_ns(), |set| found.write(set, received_ns))?;
                look_ahead_ns = Some(answered_ns + LOOK_AHEAD_AFTER_NS);
            }
        } else if look_ahead_ns.is_some_and(|due_ns| received_ns >= due_ns)
            && let Some(queue) = queues.get()
        {
            candidates.look_ahead(queue);
            look_ahead_ns = None;
        }
        sets.greet_newcomers()?;
        reporter.report_if_due(candidates.tally())?;
    }
    info!("stopped");
    Ok(())
}
