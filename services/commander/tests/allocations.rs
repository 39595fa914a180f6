//! A box costs no heap allocation, from its belief to the end of its order in the journal.

use std::convert::Infallible;

use allocation_counter::measure;
use bytemuck::Zeroable;
use commander::{Commander, Deadlines, Effects, Order};
use journal::{AppendError, Entry, Journal, Record, State};
use messages::{
    Action, Belief, BeltState, BoxQueue, CandidateSet, CycleReport, Decision, MotionReport, PlaceCommand, WireBox,
};
use packing::{ClosePolicy, ContainerSize, Grid, Heuristic, Placement, Recipe, Split, WalleWeights, corner_candidates};

/// Boxes before the counting begins: the first creates the copy of the grid.
const WARM_UP: usize = 1;

/// Containers, few enough that some have to leave.
const SLOTS: usize = 4;

/// A journal on a disk, and the last command.
struct Hands {
    journal: Journal,
    command: PlaceCommand,
    reports: usize,
}

impl Effects for Hands {
    type Error = Infallible;

    fn append(&mut self, record: &Record) -> Result<(), AppendError> {
        self.journal.append(&Entry { unix_ms: 0, record: *record })
    }

    fn command(&mut self, order: &Order) -> Result<u64, Infallible> {
        order.write(&mut self.command);
        Ok(0)
    }

    fn report(&mut self, _report: &CycleReport) -> Result<(), Infallible> {
        self.reports += 1;
        Ok(())
    }
}

#[test]
fn a_box_is_ordered_without_allocation() {
    let dir = tempfile::tempdir().unwrap();
    let (journal, _) = Journal::open(&dir.path().join("journal.bin"), 64 << 20).unwrap();
    let mut hands = Hands { journal, command: PlaceCommand::zeroed(), reports: 0 };
    let deadlines = Deadlines { soft_ns: 12_000_000, hard_ns: 25_000_000 };
    let mut commander = Commander::new(deadlines, ClosePolicy::Fullest, &State::default(), 0);
    let mut grid = Grid::new(ContainerSize::PAPER, SLOTS).unwrap();
    let mut belief: Box<Belief> = Box::new(Zeroable::zeroed());
    let mut set: Box<CandidateSet> = Box::new(Zeroable::zeroed());
    let (mut candidates, mut replaced) = (Vec::new(), 0);
    let episode = Recipe::standard().episode(Split::Test, 1, 0).unwrap();
    for (number, spec) in episode.boxes.iter().enumerate() {
        // Once, or twice if a container has to leave first.
        loop {
            corner_candidates(&grid, spec.extent(10), &WalleWeights::PAPER, &mut candidates);
            belief.write(&grid);
            let (current, revision) = (WireBox::from(*spec), grid.revision());
            let queue = BoxQueue { current, revision, belt: BeltState::BoxPresent.to_wire(), ..BoxQueue::zeroed() };
            (set.current, set.revision) = (current, revision);
            set.write_candidates(&candidates);
            let best = Heuristic::walle_choice(&candidates).unwrap_or(0) as u32;
            let decision =
                Decision { box_id: current.id, revision, set_digest: set.digest, best, ..Decision::zeroed() };
            let counted = measure(|| {
                commander.on_belief(&belief);
                let Ok(()) = commander.on_boxes(&queue, 0, &mut hands);
                let Ok(()) = commander.on_candidates(&set, 0, &mut hands);
                let Ok(()) = commander.on_decision(&decision, 0, &mut hands);
                let PlaceCommand { order, spec, revision, action, .. } = hands.command;
                let motion = MotionReport { order, box_id: spec.id, revision, action, ..MotionReport::zeroed() };
                let Ok(()) = commander.on_motion(&motion, &mut hands);
            });
            assert!(number < WARM_UP || counted.count_total == 0, "box {number}: {counted:?}");
            let placement = Placement::try_from(hands.command.placement).unwrap();
            if Action::from_wire(hands.command.action) == Ok(Action::Place) {
                grid.place(spec, placement).unwrap();
                break;
            }
            assert_eq!(Action::from_wire(hands.command.action), Ok(Action::Replace));
            grid.replace(placement.slot, SLOTS as u32 + replaced).unwrap();
            replaced += 1;
        }
    }
    assert_eq!(hands.reports, episode.boxes.len() + replaced as usize);
    assert!(replaced > 0, "containers had to leave");
}
