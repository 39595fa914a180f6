//! What a cell did, as an observer of its cycle reports sees it.

use std::collections::{BTreeMap, BTreeSet};

use dataset::DataSet;
use messages::{Action, ChosenBy, CycleReport, Malformed, MotionOutcome};
use packing::{BoxSpec, Outcome, PlacedBox, Placement};
use serde::Serialize;

use crate::latency::{Latencies, Summary};

/// Everything that was reported of one stream.
#[derive(Debug)]
pub(crate) struct Session {
    set: DataSet,
    /// Number of the first box of every episode.
    first_ids: Vec<u64>,
    placed: Vec<PlacedBox>,
    seen: BTreeSet<u64>,
    set_aside: usize,
    replaced: usize,
    doubled: usize,
    chosen_by: BTreeMap<ChosenBy, u64>,
    candidates_max: u32,
    left_out: u64,
    pub(crate) latencies: Latencies,
    next_sequence: u64,
    /// The last order that was reported.
    last_order: u64,
    lost_reports: u64,
}

/// The figures of a session, as `--json` writes them.
#[derive(Debug, Serialize)]
pub(crate) struct Figures {
    /// Boxes of the stream.
    pub(crate) boxes: usize,
    pub(crate) placed: usize,
    pub(crate) set_aside: usize,
    /// Boxes that were reported more than once: always 0, or the cell is broken.
    pub(crate) doubled: usize,
    pub(crate) containers_used: u32,
    pub(crate) containers_replaced: usize,
    pub(crate) competitive_ratio: Option<f64>,
    pub(crate) fill: Option<f64>,
    pub(crate) utilisation: f64,
    pub(crate) chosen_by: Chosen,
    /// Candidates of the box that had most.
    pub(crate) candidates_max: u32,
    /// Candidates for which a set had no room, over all boxes.
    pub(crate) candidates_left_out: u64,
    pub(crate) over_budget: u64,
    /// Reports that the observer was too slow to read; the figures above lack them.
    pub(crate) lost_reports: u64,
    pub(crate) latency_us: BTreeMap<&'static str, Summary>,
}

/// Who chose, in boxes.
#[derive(Debug, Serialize)]
pub(crate) struct Chosen {
    pub(crate) model: u64,
    pub(crate) standby: u64,
    pub(crate) fallback: u64,
}

impl Session {
    /// A session that expects these boxes, episode after episode.
    pub(crate) fn new(set: DataSet) -> Self {
        let mut next_id = 1;
        let first_ids = set.episodes.iter().map(|boxes| {
            next_id += boxes.len() as u64;
            next_id - boxes.len() as u64
        });
        Self {
            first_ids: first_ids.collect(),
            set,
            placed: Vec::new(),
            seen: BTreeSet::new(),
            set_aside: 0,
            replaced: 0,
            doubled: 0,
            chosen_by: BTreeMap::new(),
            candidates_max: 0,
            left_out: 0,
            latencies: Latencies::new(),
            next_sequence: 1,
            last_order: 0,
            lost_reports: 0,
        }
    }

    /// Boxes that are done with.
    pub(crate) fn done(&self) -> usize {
        self.placed.len() + self.set_aside
    }

    /// Boxes of the stream.
    pub(crate) fn expected(&self) -> usize {
        self.set.episodes.iter().map(Vec::len).sum()
    }

    /// Takes in one report.
    pub(crate) fn record(&mut self, report: &CycleReport) -> Result<(), Malformed> {
        self.lost_reports += report.header.sequence.saturating_sub(self.next_sequence);
        self.next_sequence = report.header.sequence + 1;
        let is_said_again = report.order <= self.last_order;
        self.last_order = self.last_order.max(report.order);
        if is_said_again || MotionOutcome::from_wire(report.outcome)? == MotionOutcome::Refused {
            return Ok(());
        }
        let action = Action::from_wire(report.action)?;
        if action == Action::Replace {
            self.replaced += 1;
            return Ok(());
        }
        let spec = BoxSpec::try_from(report.spec)?;
        if !self.seen.insert(spec.id()) {
            self.doubled += 1;
            return Ok(());
        }
        if action == Action::Place {
            let placement = Placement::try_from(report.placement)?;
            self.placed.push(PlacedBox { spec, placement, container: report.container });
            *self.chosen_by.entry(ChosenBy::from_wire(report.chosen_by)?).or_default() += 1;
        } else {
            self.set_aside += 1;
        }
        self.candidates_max = self.candidates_max.max(report.candidates);
        self.left_out += u64::from(report.left_out);
        self.latencies.record(&report.stamps);
        Ok(())
    }

    /// The boxes in every container that was used, by the containers' identities.
    pub(crate) fn containers(&self) -> BTreeMap<u32, Vec<PlacedBox>> {
        let mut containers: BTreeMap<u32, Vec<PlacedBox>> = BTreeMap::new();
        for placed in &self.placed {
            containers.entry(placed.container).or_default().push(*placed);
        }
        containers
    }

    /// The container all boxes went into.
    pub(crate) fn container_size(&self) -> packing::ContainerSize {
        self.set.container
    }

    /// The figures so far.
    pub(crate) fn figures(&self) -> Figures {
        let outcomes: Vec<Outcome> = (0..self.first_ids.len()).map(|episode| self.outcome(episode)).collect();
        let mean = |of: fn(&Outcome) -> Option<f64>| {
            let known: Vec<f64> = outcomes.iter().filter_map(of).collect();
            (!known.is_empty()).then(|| known.iter().sum::<f64>() / known.len() as f64)
        };
        let chosen = |by| self.chosen_by.get(&by).copied().unwrap_or_default();
        Figures {
            boxes: self.expected(),
            placed: self.placed.len(),
            set_aside: self.set_aside,
            doubled: self.doubled,
            containers_used: outcomes.iter().map(|outcome| outcome.containers_used).sum(),
            containers_replaced: self.replaced,
            competitive_ratio: mean(|outcome| outcome.competitive_ratio),
            fill: mean(|outcome| outcome.fill),
            utilisation: mean(|outcome| Some(outcome.utilisation)).unwrap_or_default(),
            chosen_by: Chosen {
                model: chosen(ChosenBy::Model),
                standby: chosen(ChosenBy::Standby),
                fallback: chosen(ChosenBy::Fallback),
            },
            candidates_max: self.candidates_max,
            candidates_left_out: self.left_out,
            over_budget: self.latencies.over_budget,
            lost_reports: self.lost_reports,
            latency_us: self.latencies.summaries().collect(),
        }
    }

    /// The outcome of one episode. Containers are emptied between episodes, so no two share one.
    fn outcome(&self, episode: usize) -> Outcome {
        let from = self.first_ids[episode];
        let to = self.first_ids.get(episode + 1).copied().unwrap_or(u64::MAX);
        let mut packed_cells: BTreeMap<u32, u64> = BTreeMap::new();
        let mut placed = 0;
        for one in self.placed.iter().filter(|one| (from..to).contains(&one.spec.id())) {
            *packed_cells.entry(one.container).or_default() +=
                one.spec.extent(self.set.container.cell_mm()).volume_cells();
            placed += 1;
        }
        let packed_cells: Vec<u64> = packed_cells.into_values().collect();
        Outcome::of(&packed_cells, self.set.container, placed, 0, self.set.optimum)
    }
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable as _;
    use messages::WirePlacement;
    use packing::ContainerSize;

    use super::*;

    /// Two episodes of two boxes, for containers of 4 x 4 x 4 cells.
    fn session() -> Session {
        let container = ContainerSize::new(4, 4, 4, 10).unwrap();
        let boxes = |ids: [u64; 2]| ids.map(|id| BoxSpec::new(id, [40, 40, 20]).unwrap()).to_vec();
        let episodes = vec![boxes([0, 1]), boxes([0, 1])];
        let skipped = dataset::Skipped::default();
        Session::new(DataSet { name: "test".into(), container, optimum: Some(1), episodes, skipped })
    }

    fn report(sequence: u64, id: u64, container: u32, action: Action) -> CycleReport {
        let mut report = CycleReport::zeroed();
        report.header.sequence = sequence;
        report.order = sequence;
        report.spec = BoxSpec::new(id, [40, 40, 20]).unwrap().into();
        report.action = action.to_wire();
        report.container = container;
        report.placement = WirePlacement::default();
        report
    }

    #[test]
    fn figures_by_hand() {
        let mut session = session();
        for (sequence, id, container) in [(1, 1, 0), (2, 2, 1), (3, 3, 2), (4, 4, 2)] {
            session.record(&report(sequence, id, container, Action::Place)).unwrap();
        }
        let figures = session.figures();
        // The first episode used two containers and filled the first by half, the second one and all of it.
        assert_eq!((figures.placed, figures.containers_used), (4, 3));
        assert_eq!((figures.competitive_ratio, figures.fill), (Some(1.5), Some(0.75)));
        assert_eq!((figures.chosen_by.model, figures.lost_reports, figures.doubled), (4, 0, 0));
    }

    #[test]
    fn lost_and_doubled_boxes_show() {
        let mut session = session();
        session.record(&report(1, 1, 0, Action::Place)).unwrap();
        session.record(&report(4, 1, 0, Action::Place)).unwrap();
        session.record(&report(5, 2, 0, Action::SetAside)).unwrap();
        session.record(&report(6, 3, 0, Action::Replace)).unwrap();
        let figures = session.figures();
        assert_eq!((figures.lost_reports, figures.doubled, figures.set_aside), (2, 1, 1));
        assert_eq!((session.done(), figures.containers_replaced), (2, 1));
        let again = CycleReport { order: 6, ..report(7, 3, 0, Action::Replace) };
        session.record(&again).unwrap();
        assert_eq!(session.done(), 2, "an order that is reported again is the same order");
        assert!(session.record(&CycleReport { action: 9, ..report(8, 4, 0, Action::Place) }).is_err());
    }
}
