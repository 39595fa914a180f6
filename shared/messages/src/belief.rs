//! `packcell/belief`: the grid we act on.

use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;
use packing::{ContainerSize, GRID_CELLS_MAX, Grid, Rules, SLOTS_MAX, Support};

use crate::header::impl_message;
use crate::{Header, Malformed};

/// The heights of all containers. Perception builds it in shared memory, and everybody reads it there.
#[derive(Clone, Copy, Debug, Pod, Zeroable, ZeroCopySend)]
#[type_name("packcell/Belief/v2")]
#[repr(C)]
pub struct Belief {
    /// See [`Header`]. It answers no observation: it is one.
    pub header: Header,
    /// Counts every change of the belief. What was decided on another revision is void.
    pub revision: u64,
    /// Cells of a container along `i`.
    pub length: u16,
    /// Cells of a container along `j`.
    pub breadth: u16,
    /// Height limit of a container [cells].
    pub height: u16,
    /// Slots in use, at most [`SLOTS_MAX`].
    pub slot_count: u16,
    /// Side of a grid cell [mm].
    pub cell_mm: u32,
    /// What a box keeps free on each side, see [`packing::Rules`] [mm].
    pub clearance_mm: u16,
    /// Heights that differ by no more count as level, see [`packing::Rules`] [mm].
    pub level_mm: u16,
    /// The slots in the order they stand in the cell; those beyond `slot_count` mean nothing.
    pub slots: [SlotState; SLOTS_MAX],
    /// Slot by slot, row by row along `i`: cell `(i, j)` of slot `s` is at `(s * length + i) * breadth + j` [cells].
    pub heights: [u16; GRID_CELLS_MAX],
}

/// One slot of the grid and the container that stands in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable, ZeroCopySend)]
#[type_name("packcell/SlotState/v1")]
#[repr(C)]
pub struct SlotState {
    /// The belief's revision when this container last changed.
    pub revision: u64,
    /// Identity of the container.
    pub container: u32,
    /// Boxes in it; the first one opens it.
    pub boxes: u32,
}

const _: () = assert!(size_of::<SlotState>() == 16);
const _: () = assert!(size_of::<Belief>() == 32 + 8 + 16 + 64 * 16 + 65_536 * 2);

impl_message!(Belief);

impl Belief {
    /// Writes the grid; only the slots in use are touched.
    pub fn write(&mut self, grid: &Grid) {
        self.write_unless(grid, |_, _| false);
    }

    /// As [`Belief::write`], over an earlier belief of the same grid or over zeros: only containers that changed since
    /// are copied. Memory that a publisher lends holds nothing else.
    pub fn update(&mut self, grid: &Grid) {
        let size = grid.size();
        let is_same_shape = self.shape().is_ok_and(|shape| shape == (size, grid.slots().len()));
        self.write_unless(grid, |old, new| is_same_shape && old == new);
    }

    fn write_unless(&mut self, grid: &Grid, is_there: impl Fn(SlotState, SlotState) -> bool) {
        let size = grid.size();
        self.revision = grid.revision();
        (self.length, self.breadth, self.height) = (size.length(), size.breadth(), size.height());
        (self.slot_count, self.cell_mm) = (grid.slots().len() as u16, size.cell_mm());
        (self.clearance_mm, self.level_mm) = (grid.rules().clearance_mm, grid.rules().level_mm);
        let heights = self.heights.chunks_exact_mut(size.footprint_cells());
        for ((state, heights), slot) in self.slots.iter_mut().zip(heights).zip(grid.slots()) {
            let new = SlotState { revision: slot.revision(), container: slot.container(), boxes: slot.boxes() };
            if !is_there(*state, new) {
                *state = new;
                heights.copy_from_slice(slot.surface().heights());
            }
        }
    }

    /// The size of the containers and the number of slots, checked.
    fn shape(&self) -> Result<(ContainerSize, usize), Malformed> {
        let size = ContainerSize::new(self.length, self.breadth, self.height, self.cell_mm)?;
        let slots = usize::from(self.slot_count);
        size.check_slots(slots)?;
        Ok((size, slots))
    }
}

/// A reader's own grid, kept equal to the belief by copying the containers that changed and no other.
#[derive(Debug, Default)]
pub struct GridCopy {
    grid: Option<Grid>,
    publisher: u64,
}

impl GridCopy {
    /// Brings the copy to the belief's revision and returns it.
    ///
    /// # Errors
    /// [`Malformed`] if the belief's size is none; the copy keeps its state.
    pub fn follow(&mut self, belief: &Belief) -> Result<&Grid, Malformed> {
        let (size, slots) = belief.shape()?;
        // A cell fills its containers with full support only; the other rules are as perception has them.
        let rules = Rules { support: Support::Full, clearance_mm: belief.clearance_mm, level_mm: belief.level_mm };
        let same_shape = |grid: &Grid| grid.size() == size && grid.slots().len() == slots && grid.rules() == rules;
        let kept = self.grid.take().filter(|grid| same_shape(grid) && self.publisher == belief.header.publisher);
        let is_new = kept.is_none();
        let mut grid = match kept {
            Some(grid) => grid,
            None => Grid::with_rules(size, slots, rules)?,
        };
        if is_new || grid.revision() != belief.revision {
            let heights = belief.heights.chunks_exact(size.footprint_cells());
            for ((index, state), heights) in (0..).zip(&belief.slots[..slots]).zip(heights) {
                if is_new || grid.slots()[usize::from(index)].revision() != state.revision {
                    grid.update_slot(index, state.container, state.boxes, state.revision, heights);
                }
            }
            grid.set_revision(belief.revision);
        }
        self.publisher = belief.header.publisher;
        Ok(self.grid.insert(grid))
    }

    /// The copy as it is, if a belief was ever followed.
    #[must_use]
    pub fn grid(&self) -> Option<&Grid> {
        self.grid.as_ref()
    }
}

#[cfg(test)]
mod tests {
    use packing::{BoxSpec, Placement, Yaw};
    use proptest::prelude::*;

    use super::*;

    fn belief() -> Box<Belief> {
        Box::new(Zeroable::zeroed())
    }

    fn place(grid: &mut Grid, slot: u16, i: u16) {
        let spec = BoxSpec::new(1, [10, 20, 30]).unwrap();
        grid.place(&spec, Placement { slot, yaw: Yaw::Deg0, i, j: 0, base: 0 }).unwrap();
    }

    fn assert_same(copy: &Grid, grid: &Grid) {
        assert_eq!(copy.revision(), grid.revision());
        for (copy, slot) in copy.slots().iter().zip(grid.slots()) {
            assert_eq!(
                (copy.container(), copy.boxes(), copy.revision()),
                (slot.container(), slot.boxes(), slot.revision())
            );
            assert_eq!(copy.surface().heights(), slot.surface().heights());
            assert_eq!(copy.surface().corners(), slot.surface().corners());
        }
    }

    #[test]
    fn a_copy_follows_the_belief_over_the_wire() {
        let mut grid = Grid::new(ContainerSize::new(4, 5, 6, 10).unwrap(), 3).unwrap();
        let (mut wire, mut copy) = (belief(), GridCopy::default());
        for (slot, i) in [(0, 0), (1, 2), (0, 3), (2, 1)] {
            place(&mut grid, slot, i);
            wire.write(&grid);
            assert_same(copy.follow(&wire).unwrap(), &grid);
        }
        grid.replace(0, 3).unwrap();
        wire.write(&grid);
        assert_same(copy.follow(&wire).unwrap(), &grid);
    }

    #[test]
    fn a_copy_goes_by_the_rules_of_the_belief() {
        let rules = Rules { clearance_mm: 5, level_mm: 20, ..Rules::default() };
        let mut grid = Grid::with_rules(ContainerSize::new(9, 9, 9, 10).unwrap(), 2, rules).unwrap();
        place(&mut grid, 0, 0);
        let (mut wire, mut copy) = (belief(), GridCopy::default());
        wire.write(&grid);
        let followed = copy.follow(&wire).unwrap();
        assert_same(followed, &grid);
        assert_eq!(followed.rules(), rules);
        wire.write(&Grid::new(grid.size(), 2).unwrap());
        assert_eq!(copy.follow(&wire).unwrap().rules(), Rules::default(), "other rules, another grid");
    }

    #[test]
    fn a_restarted_publisher_is_not_mistaken_for_the_old_one() {
        let size = ContainerSize::new(4, 5, 6, 10).unwrap();
        let (mut wire, mut copy) = (belief(), GridCopy::default());
        let (mut before, mut after) = (Grid::new(size, 1).unwrap(), Grid::new(size, 1).unwrap());
        place(&mut before, 0, 0);
        place(&mut after, 0, 2);
        wire.write(&before);
        copy.follow(&wire).unwrap();
        // The same revision number, another grid.
        wire.write(&after);
        wire.header.publisher = 7;
        assert_same(copy.follow(&wire).unwrap(), &after);
    }

    proptest! {
        /// Three samples take turns, as on the bus.
        #[test]
        fn an_updated_belief_is_a_written_one(changes in prop::collection::vec((0u16..3, 0u16..4, 0usize..3), 1..20)) {
            let mut grid = Grid::new(ContainerSize::new(4, 5, 60, 10).unwrap(), 3).unwrap();
            let mut samples = [belief(), belief(), belief()];
            for (number, (slot, change, sample)) in (3..).zip(changes) {
                match change {
                    0 => grid.replace(slot, number).unwrap(),
                    1 => grid.correct(slot, &[number as u16; 20]),
                    i => {
                        let spec = BoxSpec::new(1, [10, 20, 30]).unwrap();
                        let base = grid.slots()[usize::from(slot)].surface().rest(spec.extent(10), i, 0).unwrap();
                        grid.place(&spec, Placement { slot, yaw: Yaw::Deg0, i, j: 0, base }).unwrap();
                    }
                }
                samples[sample].update(&grid);
                let mut fresh = belief();
                fresh.write(&grid);
                prop_assert!(bytemuck::bytes_of(&*samples[sample]) == bytemuck::bytes_of(&*fresh));
            }
        }

        #[test]
        fn no_bytes_make_a_reader_panic(
            shape in any::<[u16; 4]>(), small in any::<bool>(), cell_mm in any::<u32>(), fill in any::<u16>(), revision in any::<u64>(),
        ) {
            let mut wire = belief();
            let [length, breadth, height, slots] = if small { shape.map(|n| n % 70) } else { shape };
            (wire.length, wire.breadth, wire.height, wire.slot_count) = (length, breadth, height, slots);
            wire.cell_mm = cell_mm;
            wire.revision = revision;
            wire.heights.fill(fill);
            let valid = wire.shape().is_ok();
            prop_assert_eq!(GridCopy::default().follow(&wire).is_ok(), valid);
        }
    }
}
