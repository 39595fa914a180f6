//! All containers that stand in the cell.

use crate::{BoxSpec, ContainerSize, Extent, Infeasible, Placement, Rules, SizeError, Surface};

/// The heights of all containers, slot by slot, and how often any of them changed.
#[derive(Clone, Debug)]
pub struct Grid {
    size: ContainerSize,
    rules: Rules,
    revision: u64,
    slots: Vec<Slot>,
}

/// One slot and the container that stands in it.
#[derive(Clone, Debug)]
pub struct Slot {
    container: u32,
    revision: u64,
    boxes: u32,
    surface: Surface,
}

/// Why a placement was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PlaceError {
    /// The grid has no such slot.
    #[error("slot {slot} of {slots}")]
    NoSuchSlot {
        /// As asked for.
        slot: u16,
        /// Slots of the grid.
        slots: usize,
    },
    /// The base is not where the placement says.
    #[error("the base is at {found} cells and not at {planned}")]
    OtherBase {
        /// Base of the placement [cells].
        planned: u16,
        /// Base by the grid [cells].
        found: u16,
    },
    /// The rules forbid it.
    #[error(transparent)]
    Infeasible(#[from] Infeasible),
}

impl Slot {
    /// Identity of the container: containers are numbered in the order they were brought into the cell.
    #[must_use]
    pub fn container(&self) -> u32 {
        self.container
    }

    /// The grid's revision when this container last changed.
    #[must_use]
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// Boxes in the container.
    #[must_use]
    pub fn boxes(&self) -> u32 {
        self.boxes
    }

    /// A container is opened by its first box.
    #[must_use]
    pub fn is_open(&self) -> bool {
        self.boxes > 0
    }

    /// The container's heights.
    #[must_use]
    pub fn surface(&self) -> &Surface {
        &self.surface
    }
}

impl Grid {
    /// A grid of `slots` empty containers, numbered from 0, at revision 0, by the paper's rules.
    ///
    /// # Errors
    /// [`SizeError`] beyond the limits of a grid.
    pub fn new(size: ContainerSize, slots: usize) -> Result<Self, SizeError> {
        Self::with_rules(size, slots, Rules::default())
    }

    /// As [`Grid::new`], by these rules.
    ///
    /// # Errors
    /// [`SizeError`] beyond the limits of a grid.
    pub fn with_rules(size: ContainerSize, slots: usize, rules: Rules) -> Result<Self, SizeError> {
        size.check_slots(slots)?;
        let slot = |container| Slot { container, revision: 0, boxes: 0, surface: Surface::with_rules(size, rules) };
        Ok(Self { size, rules, revision: 0, slots: (0..slots as u32).map(slot).collect() })
    }

    /// The size of every container.
    #[must_use]
    pub fn size(&self) -> ContainerSize {
        self.size
    }

    /// What a box may stand on, and how near to anything.
    #[must_use]
    pub fn rules(&self) -> Rules {
        self.rules
    }

    /// The room that a box takes at yaw 0: what every question about a place for it is asked with.
    #[must_use]
    pub fn extent(&self, spec: &BoxSpec) -> Extent {
        self.rules.extent(spec, self.size)
    }

    /// Counts every change of the grid.
    #[must_use]
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// The slots in the order they stand in the cell.
    #[must_use]
    pub fn slots(&self) -> &[Slot] {
        &self.slots
    }

    /// The open containers in the order they were opened, as slot indices.
    ///
    /// Containers are opened in the order they were brought in, so the order of their identities is it.
    pub fn open_slots(&self) -> impl Iterator<Item = u16> {
        let mut order = [0u16; crate::SLOTS_MAX];
        let mut count = 0;
        for (index, slot) in self.slots.iter().enumerate().filter(|(_, slot)| slot.is_open()) {
            order[count] = index as u16;
            let mut at = count;
            while at > 0 && self.slots[usize::from(order[at - 1])].container > slot.container {
                order.swap(at - 1, at);
                at -= 1;
            }
            count += 1;
        }
        order.into_iter().take(count)
    }

    /// The container that would be opened next.
    #[must_use]
    pub fn fresh_slot(&self) -> Option<u16> {
        let unopened = self.slots.iter().enumerate().filter(|(_, slot)| !slot.is_open());
        unopened.min_by_key(|(_, slot)| slot.container).map(|(index, _)| index as u16)
    }

    /// Whether the box may stand as planned: the rules, checked cell by cell.
    ///
    /// # Errors
    /// [`PlaceError`] names the first rule it breaks.
    pub fn check(&self, extent: Extent, placement: Placement) -> Result<(), PlaceError> {
        let no_such_slot = PlaceError::NoSuchSlot { slot: placement.slot, slots: self.slots.len() };
        let slot = self.slots.get(usize::from(placement.slot)).ok_or(no_such_slot)?;
        let found = slot.surface.rest(extent.turned(placement.yaw), placement.i, placement.j)?;
        if found == placement.base { Ok(()) } else { Err(PlaceError::OtherBase { planned: placement.base, found }) }
    }

    /// Sets the box down as planned; the grid's revision moves on.
    ///
    /// # Errors
    /// [`PlaceError`] as [`Grid::check`]; the grid is then unchanged.
    pub fn place(&mut self, spec: &BoxSpec, placement: Placement) -> Result<(), PlaceError> {
        let extent = self.extent(spec);
        self.check(extent, placement)?;
        self.revision += 1;
        let slot = &mut self.slots[usize::from(placement.slot)];
        slot.surface.place(extent.turned(placement.yaw), placement.i, placement.j)?;
        slot.boxes += 1;
        slot.revision = self.revision;
        Ok(())
    }

    /// Takes the container of `slot` away and brings an empty one with the identity `container`.
    ///
    /// # Errors
    /// [`PlaceError::NoSuchSlot`].
    pub fn replace(&mut self, slot: u16, container: u32) -> Result<(), PlaceError> {
        let slots = self.slots.len();
        let target = self.slots.get_mut(usize::from(slot)).ok_or(PlaceError::NoSuchSlot { slot, slots })?;
        self.revision += 1;
        let surface = Surface::with_rules(self.size, self.rules);
        *target = Slot { container, revision: self.revision, boxes: 0, surface };
        Ok(())
    }

    /// Takes over one slot as measured or received; `revision` is the slot's own.
    ///
    /// # Panics
    /// If there is no such slot, or there are not as many heights as a container has cells.
    pub fn update_slot(&mut self, slot: u16, container: u32, boxes: u32, revision: u64, heights: &[u16]) {
        let target = &mut self.slots[usize::from(slot)];
        (target.container, target.boxes, target.revision) = (container, boxes, revision);
        target.surface.set_heights(heights);
    }

    /// Believes what was measured of one container; the grid's revision moves on.
    ///
    /// # Panics
    /// If there is no such slot, or there are not as many heights as a container has cells.
    pub fn correct(&mut self, slot: u16, heights: &[u16]) {
        self.revision += 1;
        let target = &mut self.slots[usize::from(slot)];
        target.revision = self.revision;
        target.surface.set_heights(heights);
    }

    /// States the revision of the whole grid after its slots were updated.
    pub fn set_revision(&mut self, revision: u64) {
        self.revision = revision;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Yaw;

    fn grid() -> Grid {
        Grid::new(ContainerSize::new(4, 4, 4, 10).unwrap(), 3).unwrap()
    }

    fn at(slot: u16, i: u16, j: u16, base: u16) -> Placement {
        Placement { slot, yaw: Yaw::Deg0, i, j, base }
    }

    fn cube(mm: u32) -> BoxSpec {
        BoxSpec::new(1, [mm; 3]).unwrap()
    }

    #[test]
    fn a_box_opens_its_container_and_moves_the_revision() {
        let mut grid = grid();
        assert_eq!(grid.fresh_slot(), Some(0));
        grid.place(&cube(20), at(0, 0, 0, 0)).unwrap();
        assert_eq!((grid.revision(), grid.slots()[0].revision(), grid.slots()[1].revision()), (1, 1, 0));
        assert_eq!(grid.open_slots().collect::<Vec<_>>(), [0]);
        assert_eq!(grid.fresh_slot(), Some(1));
    }

    #[test]
    fn a_refused_box_changes_nothing() {
        let mut grid = grid();
        assert_eq!(grid.place(&cube(20), at(7, 0, 0, 0)), Err(PlaceError::NoSuchSlot { slot: 7, slots: 3 }));
        assert_eq!(grid.place(&cube(20), at(0, 0, 0, 1)), Err(PlaceError::OtherBase { planned: 1, found: 0 }));
        assert_eq!(grid.place(&cube(20), at(0, 3, 0, 0)), Err(Infeasible::OutsideFootprint.into()));
        assert_eq!(grid.revision(), 0);
    }

    #[test]
    fn a_correction_moves_the_revision_and_opens_nothing() {
        let mut grid = grid();
        grid.correct(1, &[2; 16]);
        assert_eq!((grid.revision(), grid.slots()[1].revision(), grid.slots()[0].revision()), (1, 1, 0));
        assert_eq!(grid.slots()[1].surface().rest(cube(20).extent(10), 0, 0), Ok(2));
        assert_eq!(grid.open_slots().count(), 0);
    }

    #[test]
    fn a_replaced_container_is_the_youngest() {
        let mut grid = grid();
        for slot in 0..3 {
            grid.place(&cube(20), at(slot, 0, 0, 0)).unwrap();
        }
        grid.replace(1, 3).unwrap();
        assert_eq!(grid.fresh_slot(), Some(1));
        grid.place(&cube(20), at(1, 0, 0, 0)).unwrap();
        assert_eq!(grid.open_slots().collect::<Vec<_>>(), [0, 2, 1]);
    }
}
