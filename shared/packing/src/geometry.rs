//! Boxes, containers and placements as plain values.

use std::fmt;

/// Most grid cells that all slots together may have: 16 containers of 45 x 80 are 57,600.
pub const GRID_CELLS_MAX: usize = 65_536;

/// Most slots of a grid. Sixteen is the paper's number; four times that is room for small containers.
pub const SLOTS_MAX: usize = 64;

/// Longest side of a box [mm]. Longer ones are a measurement error, not a parcel.
pub const BOX_SIDE_MM_MAX: u32 = 10_000;

/// Longest side of a container [cells], so that sums of two lengths stay far inside 16 bits.
pub const SIDE_CELLS_MAX: u16 = 10_000;

/// A cuboid on the belt.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct BoxSpec {
    id: u64,
    size_mm: [u32; 3],
}

/// Dimensions that no box can have.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a box of {} x {} x {} mm: every side must be 1 to {BOX_SIDE_MM_MAX} mm", size_mm[0], size_mm[1], size_mm[2])]
pub struct BoxError {
    /// As given: length, breadth, height.
    pub size_mm: [u32; 3],
}

impl BoxSpec {
    /// A box with the identity `id` and its length, breadth and height at yaw 0 [mm].
    ///
    /// # Errors
    /// [`BoxError`] if a side is zero or longer than [`BOX_SIDE_MM_MAX`].
    pub fn new(id: u64, size_mm: [u32; 3]) -> Result<Self, BoxError> {
        if size_mm.iter().all(|side| (1..=BOX_SIDE_MM_MAX).contains(side)) {
            Ok(Self { id, size_mm })
        } else {
            Err(BoxError { size_mm })
        }
    }

    /// The box's identity, unique in its stream.
    #[must_use]
    pub fn id(&self) -> u64 {
        self.id
    }

    /// Length, breadth and height at yaw 0 [mm].
    #[must_use]
    pub fn size_mm(&self) -> [u32; 3] {
        self.size_mm
    }

    /// The box in whole grid cells of `cell_mm`, partial cells rounded up. Paper: "Robot-implementability".
    ///
    /// # Panics
    /// If `cell_mm` is zero, which no [`ContainerSize`] allows.
    #[must_use]
    pub fn extent(&self, cell_mm: u32) -> Extent {
        // No side exceeds BOX_SIDE_MM_MAX, which fits into 16 bits at any cell size.
        let cells = |side_mm: u32| side_mm.div_ceil(cell_mm) as u16;
        let [length, breadth, height] = self.size_mm.map(cells);
        Extent { length, breadth, height }
    }
}

/// The size of a box in whole grid cells, each side at least 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Extent {
    /// Along `i` [cells].
    pub length: u16,
    /// Along `j` [cells].
    pub breadth: u16,
    /// Along the vertical [cells].
    pub height: u16,
}

impl Extent {
    /// The extent after a turn about the vertical axis.
    #[must_use]
    pub fn turned(self, yaw: Yaw) -> Self {
        match yaw {
            Yaw::Deg0 => self,
            Yaw::Deg90 => Self { length: self.breadth, breadth: self.length, height: self.height },
        }
    }

    /// The yaws that differ for this box: a square footprint has one, every other has two.
    #[must_use]
    pub fn yaws(self) -> &'static [Yaw] {
        if self.length == self.breadth { &[Yaw::Deg0] } else { &[Yaw::Deg0, Yaw::Deg90] }
    }

    /// Volume [cells].
    #[must_use]
    pub fn volume_cells(self) -> u64 {
        u64::from(self.length) * u64::from(self.breadth) * u64::from(self.height)
    }
}

/// A turn about the vertical axis, the only one the gripper can make. Paper: "Robot-implementability".
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Yaw {
    /// As on the belt.
    Deg0,
    /// Length and breadth exchanged.
    Deg90,
}

/// The inner size of every container, in grid cells, and the size of a grid cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ContainerSize {
    length: u16,
    breadth: u16,
    height: u16,
    cell_mm: u32,
}

/// A container or grid that cannot be.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SizeError {
    /// A side of the container is zero or too long, or a grid cell has no size.
    #[error(
        "a container of {0} x {1} x {2} cells of {3} mm: sides must be 1 to {SIDE_CELLS_MAX} cells of at least 1 mm"
    )]
    Side(u16, u16, u16, u32),
    /// The slots do not fit into one grid.
    #[error(
        "{slots} slots of {footprint} cells: a grid has 1 to {SLOTS_MAX} slots and at most {GRID_CELLS_MAX} cells \
         (fewer slots, smaller containers or larger cells would fit)"
    )]
    TooLarge {
        /// Number of slots asked for.
        slots: usize,
        /// Cells of one container's floor.
        footprint: usize,
    },
}

impl ContainerSize {
    /// The paper's container: 45 x 80 cells of 1 cm. It gives no height; 50 cm is this project's choice.
    pub const PAPER: Self = Self { length: 45, breadth: 80, height: 50, cell_mm: 10 };

    /// The container of the single-container literature: 10 x 10 x 10 cells.
    pub const TEN: Self = Self { length: 10, breadth: 10, height: 10, cell_mm: 10 };

    /// A container of `length` x `breadth` x `height` cells of `cell_mm`.
    ///
    /// # Errors
    /// [`SizeError`] if a side is not 1 to [`SIDE_CELLS_MAX`], a grid cell has no size, or one floor alone exceeds [`GRID_CELLS_MAX`].
    pub fn new(length: u16, breadth: u16, height: u16, cell_mm: u32) -> Result<Self, SizeError> {
        let sides_valid = [length, breadth, height].iter().all(|side| (1..=SIDE_CELLS_MAX).contains(side));
        if !sides_valid || cell_mm == 0 {
            return Err(SizeError::Side(length, breadth, height, cell_mm));
        }
        let size = Self { length, breadth, height, cell_mm };
        size.check_slots(1)?;
        Ok(size)
    }

    /// Whether `slots` such containers make a grid.
    ///
    /// # Errors
    /// [`SizeError::TooLarge`] beyond [`SLOTS_MAX`] or [`GRID_CELLS_MAX`].
    pub fn check_slots(&self, slots: usize) -> Result<(), SizeError> {
        let footprint = self.footprint_cells();
        if (1..=SLOTS_MAX).contains(&slots) && slots * footprint <= GRID_CELLS_MAX {
            Ok(())
        } else {
            Err(SizeError::TooLarge { slots, footprint })
        }
    }

    /// `L`: cells along `i`.
    #[must_use]
    pub fn length(&self) -> u16 {
        self.length
    }

    /// `B`: cells along `j`.
    #[must_use]
    pub fn breadth(&self) -> u16 {
        self.breadth
    }

    /// `H`: height limit [cells].
    #[must_use]
    pub fn height(&self) -> u16 {
        self.height
    }

    /// Side of one grid cell [mm].
    #[must_use]
    pub fn cell_mm(&self) -> u32 {
        self.cell_mm
    }

    /// Cells of the floor.
    #[must_use]
    pub fn footprint_cells(&self) -> usize {
        usize::from(self.length) * usize::from(self.breadth)
    }

    /// Volume [cells].
    #[must_use]
    pub fn volume_cells(&self) -> u64 {
        self.footprint_cells() as u64 * u64::from(self.height)
    }

    /// Whether the box fits into an empty container at any yaw.
    #[must_use]
    pub fn admits(&self, extent: Extent) -> bool {
        extent.height <= self.height
            && extent.yaws().iter().any(|&yaw| {
                let turned = extent.turned(yaw);
                turned.length <= self.length && turned.breadth <= self.breadth
            })
    }
}

impl fmt::Display for ContainerSize {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} x {} x {} cells of {} mm", self.length, self.breadth, self.height, self.cell_mm)
    }
}

/// Where and how a box stands. Its footprint covers `i..i + length`, `j..j + breadth` of the turned extent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Placement {
    /// The slot whose container it stands in.
    pub slot: u16,
    /// The turn before it is set down.
    pub yaw: Yaw,
    /// First cell along the container's length.
    pub i: u16,
    /// First cell along the container's breadth.
    pub j: u16,
    /// Height of its base [cells].
    pub base: u16,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn partial_cells_are_rounded_up() {
        let spec = BoxSpec::new(1, [101, 100, 1]).unwrap();
        assert_eq!(spec.extent(10), Extent { length: 11, breadth: 10, height: 1 });
        assert_eq!(spec.extent(50), Extent { length: 3, breadth: 2, height: 1 });
    }

    #[test]
    fn no_box_is_flat_or_endless() {
        assert!(BoxSpec::new(1, [100, 0, 100]).is_err());
        assert!(BoxSpec::new(1, [100, 100, BOX_SIDE_MM_MAX + 1]).is_err());
        let message = BoxSpec::new(1, [100, 0, 100]).unwrap_err().to_string();
        assert_eq!(message, "a box of 100 x 0 x 100 mm: every side must be 1 to 10000 mm");
    }

    #[test]
    fn sixteen_paper_containers_make_a_grid_and_nineteen_do_not() {
        assert!(ContainerSize::PAPER.check_slots(16).is_ok());
        assert!(ContainerSize::PAPER.check_slots(18).is_ok());
        assert!(ContainerSize::PAPER.check_slots(19).is_err());
        assert!(ContainerSize::new(4, 4, 4, 10).unwrap().check_slots(65).is_err());
        assert!(ContainerSize::new(0, 4, 4, 10).is_err());
    }

    #[test]
    fn a_square_footprint_has_one_yaw() {
        let square = Extent { length: 3, breadth: 3, height: 9 };
        assert_eq!(square.yaws(), [Yaw::Deg0]);
        let oblong = Extent { length: 3, breadth: 4, height: 9 };
        assert_eq!(oblong.turned(Yaw::Deg90), Extent { length: 4, breadth: 3, height: 9 });
        assert_eq!(oblong.yaws().len(), 2);
    }

    #[test]
    fn a_box_is_admitted_when_one_yaw_fits() {
        let size = ContainerSize::new(4, 8, 5, 10).unwrap();
        assert!(size.admits(Extent { length: 8, breadth: 4, height: 5 }));
        assert!(!size.admits(Extent { length: 8, breadth: 5, height: 5 }));
        assert!(!size.admits(Extent { length: 1, breadth: 1, height: 6 }));
    }
}
