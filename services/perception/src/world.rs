//! What the stub remembers when its process dies. Boxes and containers are matter: a restart of the program that
//! watches them moves none.

use bincode::config::{Configuration, Limit};
use packing::{ContainerSize, Grid};
use serde::{Deserialize, Serialize};

use crate::belt::Position;
use crate::{Motion, Reported};

/// The first bytes of the file: what it is, in words, and the version of all that follows.
const HEADER: &[u8] = b"packcell world 3\n";

/// Most bytes that a world may take: every cell of the largest grid, and a true box of 88 bytes for every cell of
/// sixteen of the paper's containers.
const BYTES_MAX: usize = 1 << 28;

/// Containers, belt and arm between two motions, or in the middle of one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct World {
    /// Length, breadth and height limit of the containers [cells], and the side of a cell [mm].
    size: ([u16; 3], u32),
    revision: u64,
    slots: Vec<Slot>,
    pub(crate) next_container: u32,
    pub(crate) position: Position,
    pub(crate) moving: Option<Moving>,
    pub(crate) last: Option<Reported>,
    pub(crate) taken: u64,
    /// How the boxes really stand or lie, if that is another thing.
    pub(crate) matter: Option<physical::Matter>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Slot {
    container: u32,
    boxes: u32,
    revision: u64,
    /// Nothing for an empty container.
    heights: Vec<u16>,
}

/// A motion that the arm was in.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Moving {
    pub(crate) order: u64,
    pub(crate) revision: u64,
    pub(crate) motion: Motion,
}

/// Why a world cannot be gone on with.
#[derive(Debug, thiserror::Error)]
pub enum WorldError {
    /// The file is none, or damaged.
    #[error("it is no world of this version, or damaged")]
    Damaged,
    /// The cell has other containers now.
    #[error("it holds {of_world} containers, and the cell has {of_cell} (section [container])")]
    OtherContainers {
        /// What is remembered.
        of_world: String,
        /// What is configured.
        of_cell: String,
    },
    /// Boxes stand there, and nobody knows how they really stand.
    #[error("it was left by a world of another kind, or by other containers (sections [world] and [belief])")]
    OtherReality,
    /// The boxes on the belt are others.
    #[error("it was left in the middle of another stream (perception.stream, perception.seed)")]
    OtherStream,
}

impl World {
    pub(crate) fn of(grid: &Grid, next_container: u32, position: Position, taken: u64) -> Self {
        let heights =
            |slot: &packing::Slot| if slot.is_open() { slot.surface().heights().to_vec() } else { Vec::new() };
        let slots = grid.slots().iter().map(|slot| Slot {
            container: slot.container(),
            boxes: slot.boxes(),
            revision: slot.revision(),
            heights: heights(slot),
        });
        let (size, revision, slots) = (shape(grid.size()), grid.revision(), slots.collect());
        Self { size, revision, slots, next_container, position, moving: None, last: None, taken, matter: None }
    }

    /// The containers as they were left, for a cell that begins with those of `empty`.
    ///
    /// # Errors
    /// [`WorldError`] if the cell has other containers, or the file lies.
    pub(crate) fn grid(&self, empty: &Grid) -> Result<Grid, WorldError> {
        let (size, slots) = (empty.size(), empty.slots().len());
        let describe = |count: usize, (size, mm): ([u16; 3], u32)| format!("{count} x {size:?} cells of {mm} mm");
        if self.size != shape(size) || self.slots.len() != slots {
            let (of_world, of_cell) = (describe(self.slots.len(), self.size), describe(slots, shape(size)));
            return Err(WorldError::OtherContainers { of_world, of_cell });
        }
        let mut grid = empty.clone();
        let empty = vec![0; size.footprint_cells()];
        for (index, slot) in (0..).zip(&self.slots) {
            let heights = if slot.boxes == 0 { &empty } else { &slot.heights };
            if heights.len() != size.footprint_cells() {
                return Err(WorldError::Damaged);
            }
            grid.update_slot(index, slot.container, slot.boxes, slot.revision, heights);
        }
        grid.set_revision(self.revision);
        Ok(grid)
    }

    /// Writes it into `bytes`, which are cleared first.
    pub fn encode(&self, bytes: &mut Vec<u8>) {
        bytes.clear();
        bytes.extend(HEADER);
        bytes.extend([0; 4]);
        bincode::serde::encode_into_std_write(self, bytes, format())
            .expect("memory takes what is written, and the largest grid is smaller than the limit");
        let body = HEADER.len() + 4;
        let sum = crc32fast::hash(&bytes[body..]);
        bytes[HEADER.len()..body].copy_from_slice(&sum.to_le_bytes());
    }

    /// Reads it back.
    ///
    /// # Errors
    /// [`WorldError::Damaged`] for anything but the bytes of [`World::encode`].
    pub fn decode(bytes: &[u8]) -> Result<Self, WorldError> {
        let behind = bytes.strip_prefix(HEADER).ok_or(WorldError::Damaged)?;
        let (sum, body) = behind.split_first_chunk::<4>().ok_or(WorldError::Damaged)?;
        if crc32fast::hash(body) != u32::from_le_bytes(*sum) {
            return Err(WorldError::Damaged);
        }
        match bincode::serde::decode_from_slice(body, format()) {
            Ok((world, used)) if used == body.len() => Ok(world),
            _ => Err(WorldError::Damaged),
        }
    }
}

fn shape(size: ContainerSize) -> ([u16; 3], u32) {
    ([size.length(), size.breadth(), size.height()], size.cell_mm())
}

fn format() -> Configuration<bincode::config::LittleEndian, bincode::config::Varint, Limit<BYTES_MAX>> {
    bincode::config::standard().with_limit()
}
