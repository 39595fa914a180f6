//! The belt: where boxes come from, one after the other.

use std::path::Path;

use dataset::{DataSet, Named, ReadOptions};
use packing::{BoxSpec, ContainerSize, Recipe, RecipeError, Split};
use runtime::Tally;
use serde::{Deserialize, Serialize};

use crate::WorldError;

/// A stream of boxes, episode after episode, numbered through.
#[derive(Debug)]
pub struct Belt {
    source: Source,
    /// Episodes until the stream ends; 0 for one without end.
    episodes: u64,
    begun: u64,
    boxes: Vec<BoxSpec>,
    /// The next box of `boxes`.
    next: usize,
    /// Boxes of the episodes before this one.
    before: u64,
}

#[derive(Debug)]
enum Source {
    Generated { recipe: Recipe, seed: u64 },
    File(DataSet),
}

/// How far a stream has come.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Position {
    /// Episodes begun.
    begun: u64,
    /// Boxes of this episode that the arm has dealt with.
    dealt_with: u64,
    /// Boxes of the episodes before this one.
    before: u64,
    /// CRC-32 of the sizes of this episode's boxes, by which another stream is noticed.
    sizes: u32,
}

/// Why there is no stream.
#[derive(Debug, thiserror::Error)]
pub enum StreamError {
    /// The file is not one.
    #[error("cannot pack the stream")]
    File(#[from] dataset::FileError),
    /// The name is none, and no file either.
    #[error(transparent)]
    Name(#[from] dataset::UnknownName),
    /// The recipe cannot be followed.
    #[error("cannot generate the stream")]
    Recipe(#[from] RecipeError),
    /// The boxes are meant for other containers.
    #[error(
        "{stream} is for containers of {of_stream}, and the cell has containers of {of_cell} (section [container])"
    )]
    OtherContainer {
        /// The stream.
        stream: String,
        /// What it is for.
        of_stream: ContainerSize,
        /// What there is.
        of_cell: ContainerSize,
    },
}

impl Belt {
    /// The stream of this name or file: so many episodes, or without end if `episodes` is 0. A file begins again
    /// when its last episode is over.
    ///
    /// # Errors
    /// [`StreamError`] says what is wrong with it.
    pub fn open(stream: &str, seed: u64, episodes: u64, size: ContainerSize) -> Result<Self, StreamError> {
        let path = Path::new(stream);
        let source = if path.extension().is_some() {
            Source::File(dataset::read(path, &ReadOptions { container: size, skip_bad: false })?)
        } else {
            Source::Generated { recipe: Named::find(stream)?.recipe(), seed }
        };
        let of_stream = match &source {
            Source::Generated { recipe, .. } => {
                recipe.episode(Split::Live, seed, 0)?;
                recipe.container
            }
            Source::File(set) => set.container,
        };
        let stream = stream.to_owned();
        if of_stream != size {
            return Err(StreamError::OtherContainer { stream, of_stream, of_cell: size });
        }
        Ok(Self { source, episodes, begun: 0, boxes: Vec::new(), next: 0, before: 0 })
    }

    /// Boxes of a set, so many episodes of it.
    #[must_use]
    pub fn of(set: DataSet, episodes: u64) -> Self {
        Self { source: Source::File(set), episodes, begun: 0, boxes: Vec::new(), next: 0, before: 0 }
    }

    /// How far it has come, if the box taken last is still on the belt (`is_box_out`) or is not.
    #[must_use]
    pub fn position(&self, is_box_out: bool) -> Position {
        let dealt_with = (self.next - usize::from(is_box_out)) as u64;
        Position { begun: self.begun, dealt_with, before: self.before, sizes: checksum(&self.boxes) }
    }

    /// Goes to where a stream was left.
    ///
    /// # Errors
    /// [`WorldError::OtherStream`] if it was another stream.
    pub fn go_to(&mut self, position: Position) -> Result<(), WorldError> {
        if position.begun == 0 {
            return Ok(());
        }
        self.begun = position.begun - 1;
        let boxes = self.episode(self.begun).map_err(|_| WorldError::OtherStream)?;
        if checksum(&boxes) != position.sizes || position.dealt_with > boxes.len() as u64 {
            return Err(WorldError::OtherStream);
        }
        (self.begun, self.before) = (position.begun, position.before);
        (self.boxes, self.next) = (boxes, position.dealt_with as usize);
        Ok(())
    }

    fn episode(&self, index: u64) -> Result<Vec<BoxSpec>, RecipeError> {
        match &self.source {
            Source::File(set) => Ok(set.episodes[(index % set.episodes.len() as u64) as usize].clone()),
            Source::Generated { recipe, seed } => Ok(recipe.episode(Split::Live, *seed, index)?.boxes),
        }
    }

    /// Whether the last box of the episode has been taken.
    #[must_use]
    pub fn episode_is_over(&self) -> bool {
        self.next == self.boxes.len()
    }

    /// Begins the next episode; `false` if the stream has ended.
    pub fn begin_episode(&mut self, tally: &mut Tally) -> bool {
        if self.episodes > 0 && self.begun == self.episodes {
            return false;
        }
        let boxes = match self.episode(self.begun) {
            Ok(boxes) => boxes,
            Err(error) => {
                tally.refuse(&error);
                return false;
            }
        };
        self.before += self.boxes.len() as u64;
        (self.boxes, self.next) = (boxes, 0);
        self.begun += 1;
        true
    }

    /// The next box of the episode, if there is one. Boxes are numbered from 1 over all episodes.
    pub fn take_next(&mut self) -> Option<BoxSpec> {
        let spec = self.numbered(self.next)?;
        self.next += 1;
        Some(spec)
    }

    /// The boxes behind the one taken last, as far as the episode goes.
    pub fn upcoming(&self) -> impl Iterator<Item = BoxSpec> {
        (self.next..self.boxes.len()).map_while(|index| self.numbered(index))
    }

    /// Episodes begun so far.
    #[must_use]
    pub fn episodes_begun(&self) -> u64 {
        self.begun
    }

    fn numbered(&self, index: usize) -> Option<BoxSpec> {
        let id = self.before + index as u64 + 1;
        self.boxes.get(index).and_then(|spec| BoxSpec::new(id, spec.size_mm()).ok())
    }
}

fn checksum(boxes: &[BoxSpec]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    boxes.iter().flat_map(BoxSpec::size_mm).for_each(|side_mm: u32| hasher.update(&side_mm.to_le_bytes()));
    hasher.finalize()
}
