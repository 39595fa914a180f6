//! `candidates`: answers every box on the belt with the places where it could go.
//!
//! Reads `packcell/boxes` and `packcell/belief`, writes `packcell/candidates`.

use candidates::Candidates;
use clap::Parser;
use messages::topics::{BELIEF, BOXES, CANDIDATES, Role};
use runtime::{Bus, Reporter, ServiceArgs, monotonic_ns};
use tracing::info;

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

    while bell.wait(None)? {
        let received_ns = monotonic_ns();
        if queues.refresh()? {
            beliefs.refresh()?;
            if let (Some(queue), Some(belief)) = (queues.get(), beliefs.get())
                && let Some(found) = candidates.find(queue, belief)
            {
                sets.publish(found.observed_ns(), |set| found.write(set, received_ns))?;
                candidates.look_ahead(queue);
            }
        }
        sets.greet_newcomers()?;
        reporter.report_if_due(candidates.tally())?;
    }
    info!("stopped");
    Ok(())
}
