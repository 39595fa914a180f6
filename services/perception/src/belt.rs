//! The belt: where boxes come from, one after the other.

use std::path::Path;

use dataset::{DataSet, Named, ReadOptions};
use packing::{BoxSpec, ContainerSize, Recipe, RecipeError, Split};
use runtime::Tally;

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
        let boxes = match &self.source {
            Source::File(set) => set.episodes[(self.begun % set.episodes.len() as u64) as usize].clone(),
            Source::Generated { recipe, seed } => match recipe.episode(Split::Live, *seed, self.begun) {
                Ok(episode) => episode.boxes,
                Err(error) => {
                    tally.refuse(&error);
                    return false;
                }
            },
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
