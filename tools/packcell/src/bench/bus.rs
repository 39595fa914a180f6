//! The cell itself, with this process in place of perception.

use anyhow::bail;
use messages::topics::{BELIEF, BOXES, COMMANDS, CYCLES, MOTIONS};
use messages::{Belief, BoxQueue, CycleReport, MotionReport, PlaceCommand};
use packing::Grid;
use runtime::{Bell, Bus, Publisher, Subscriber, monotonic_ns};

use super::Decision;
use crate::latency::Latencies;

/// How long a command may take.
const PATIENCE_NS: u64 = 5_000_000_000;

/// Belt, sensor and arm on the bus.
pub(crate) struct OnBus {
    beliefs: Publisher<Belief>,
    queues: Publisher<BoxQueue>,
    motions: Publisher<MotionReport>,
    commands: Subscriber<PlaceCommand>,
    cycles: Subscriber<CycleReport>,
    bell: Bell,
    /// The stages of the boxes that were measured.
    pub(crate) stages: Latencies,
}

impl OnBus {
    pub(crate) fn new(bus: &Bus) -> anyhow::Result<Self> {
        Ok(Self {
            beliefs: bus.publisher(&BELIEF)?,
            queues: bus.publisher(&BOXES)?,
            motions: bus.publisher(&MOTIONS)?,
            commands: bus.subscriber(&COMMANDS)?,
            cycles: bus.subscriber(&CYCLES)?,
            bell: bus.bell()?,
            stages: Latencies::new(),
        })
    }

    /// Shows containers and boxes to the cell and waits for its command.
    pub(crate) fn decide(&mut self, grid: &Grid, queue: &BoxQueue) -> anyhow::Result<Decision> {
        let begin_ns = monotonic_ns();
        self.beliefs.publish(0, |belief| belief.update(grid))?;
        self.queues.publish(begin_ns, |shown| *shown = *queue)?;
        loop {
            while let Some(command) = self.commands.receive()? {
                if (command.spec, command.revision) == (queue.current, queue.revision) {
                    return Ok(Decision { command: *command, total_ns: monotonic_ns() - begin_ns });
                }
            }
            if !self.bell.wait(None)? {
                bail!("stopped");
            }
            if monotonic_ns() > begin_ns + PATIENCE_NS {
                bail!("the cell gives no command for box {}", queue.current.id);
            }
        }
    }

    /// Says that the arm has obeyed, and takes in what the commander reports of it.
    pub(crate) fn report(&mut self, report: MotionReport, is_measured: bool) -> anyhow::Result<()> {
        self.motions.publish(0, |motion| *motion = report)?;
        while let Some(cycle) = self.cycles.receive()? {
            if is_measured {
                self.stages.record(&cycle.stamps);
            }
        }
        Ok(())
    }
}
