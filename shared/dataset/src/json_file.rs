//! Data sets as JSON.

use std::cell::Cell;
use std::fmt;
use std::io::{self, Write};
use std::num::NonZeroU32;

use packing::{ContainerSize, SIDE_CELLS_MAX};
use serde::de::{DeserializeSeed, Error as _, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use crate::set::{Builder, RawBox};
use crate::{At, BOXES_MAX, DataSet, EPISODES_MAX, Problem, ReadOptions};

/// What the file says about itself.
#[derive(Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct Meta {
    name: String,
    unit: Unit,
    container: [f64; 3],
    #[serde(default, skip_serializing_if = "Option::is_none")]
    optimum: Option<NonZeroU32>,
}

/// What lengths are counted in.
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
enum Unit {
    Mm,
    Cm,
    Cell,
}

impl Unit {
    fn in_mm(self, cell_mm: u32) -> f64 {
        match self {
            Self::Mm => 1.0,
            Self::Cm => 10.0,
            Self::Cell => f64::from(cell_mm),
        }
    }
}

/// Reads a data set from the bytes of a JSON file.
///
/// # Errors
/// [`Problem`] says what is wrong, in which episode and with which box.
pub fn read_json(bytes: &[u8], options: &ReadOptions) -> Result<DataSet, Problem> {
    let cell_mm = options.container.cell_mm();
    let place = Place::default();
    let mut deserializer = serde_json::Deserializer::from_slice(bytes);
    let parsed = FileSeed(&place).deserialize(&mut deserializer).and_then(|file| deserializer.end().map(|()| file));
    let (meta, episodes) = parsed.map_err(|error| Problem::Json(place.at(), error))?;
    let unit_mm = meta.unit.in_mm(cell_mm);
    let container = whole_cells(meta.container.map(|side| side * unit_mm), cell_mm)?;
    let mut builder = Builder::new(meta.name, container, meta.optimum.map(NonZeroU32::get), options);
    for (number, boxes) in (0..).zip(episodes) {
        builder.begin(number);
        boxes.into_iter().try_for_each(|raw| builder.push(Ok(raw), unit_mm, None))?;
        builder.end()?;
    }
    builder.finish()
}

/// Writes a data set as JSON, one episode a line, in millimetres.
///
/// # Errors
/// Whatever `file` refuses.
pub fn write_json(set: &DataSet, file: &mut impl Write) -> io::Result<()> {
    let size = set.container;
    let in_mm = |cells: u16| f64::from(cells) * f64::from(size.cell_mm());
    let meta = Meta {
        name: set.name.clone(),
        unit: Unit::Mm,
        container: [in_mm(size.length()), in_mm(size.breadth()), in_mm(size.height())],
        optimum: set.optimum.and_then(NonZeroU32::new),
    };
    write!(file, "{{\"meta\":{},\n\"episodes\":[", serde_json::to_string(&meta)?)?;
    for (index, boxes) in set.episodes.iter().enumerate() {
        file.write_all(if index == 0 { b"\n" } else { b",\n" })?;
        let sizes: Vec<_> = boxes.iter().map(packing::BoxSpec::size_mm).collect();
        serde_json::to_writer(&mut *file, &sizes)?;
    }
    file.write_all(b"\n]}\n")
}

fn whole_cells(sides_mm: [f64; 3], cell_mm: u32) -> Result<ContainerSize, Problem> {
    let cells = sides_mm.map(|side_mm| side_mm / f64::from(cell_mm));
    let whole =
        |cells: f64| (cells - cells.round()).abs() < 1e-6 && (0.0..=f64::from(SIDE_CELLS_MAX) + 1.0).contains(&cells);
    if !cells.iter().all(|&side| whole(side)) {
        return Err(Problem::ContainerSide(sides_mm, cell_mm));
    }
    let [length, breadth, height] = cells.map(|side| side.round() as u16);
    ContainerSize::new(length, breadth, height, cell_mm).map_err(Problem::Container)
}

/// How far the parser came.
#[derive(Default)]
struct Place {
    episode: Cell<Option<u64>>,
    index: Cell<Option<u64>>,
    boxes_total: Cell<usize>,
}

impl Place {
    fn at(&self) -> At {
        At { episode: self.episode.get(), index: self.index.get(), line: None }
    }
}

/// The whole file, with its two keys in either order.
struct FileSeed<'a>(&'a Place);

impl<'de> DeserializeSeed<'de> for FileSeed<'_> {
    type Value = (Meta, Vec<Vec<RawBox>>);

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for FileSeed<'_> {
    type Value = (Meta, Vec<Vec<RawBox>>);

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object with `meta` and `episodes`")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let (mut meta, mut episodes) = (None, None);
        while let Some(key) = map.next_key::<String>()? {
            match key.as_str() {
                "meta" if meta.is_none() => meta = Some(map.next_value()?),
                "episodes" if episodes.is_none() => episodes = Some(map.next_value_seed(EpisodesSeed(self.0))?),
                "meta" | "episodes" => return Err(A::Error::custom(format_args!("`{key}` is there twice"))),
                _ => return Err(A::Error::unknown_field(&key, &["meta", "episodes"])),
            }
        }
        let meta = meta.ok_or_else(|| A::Error::missing_field("meta"))?;
        Ok((meta, episodes.ok_or_else(|| A::Error::missing_field("episodes"))?))
    }
}

struct EpisodesSeed<'a>(&'a Place);

impl<'de> DeserializeSeed<'de> for EpisodesSeed<'_> {
    type Value = Vec<Vec<RawBox>>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de> Visitor<'de> for EpisodesSeed<'_> {
    type Value = Vec<Vec<RawBox>>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list of episodes")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Self::Value, A::Error> {
        let mut episodes = Vec::new();
        self.0.episode.set(Some(0));
        while let Some(boxes) = seq.next_element_seed(BoxesSeed(self.0))? {
            episodes.push(boxes);
            if episodes.len() > EPISODES_MAX {
                return Err(A::Error::custom(Problem::TooManyEpisodes));
            }
            self.0.episode.set(Some(episodes.len() as u64));
            self.0.index.set(None);
        }
        Ok(episodes)
    }
}

struct BoxesSeed<'a>(&'a Place);

impl<'de> DeserializeSeed<'de> for BoxesSeed<'_> {
    type Value = Vec<RawBox>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de> Visitor<'de> for BoxesSeed<'_> {
    type Value = Vec<RawBox>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an episode: a list of boxes")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Self::Value, A::Error> {
        let mut boxes = Vec::new();
        self.0.index.set(Some(0));
        while let Some(raw) = seq.next_element::<RawBox>()? {
            boxes.push(raw);
            self.0.index.set(Some(boxes.len() as u64));
            self.0.boxes_total.set(self.0.boxes_total.get() + 1);
            if self.0.boxes_total.get() > BOXES_MAX {
                return Err(A::Error::custom(Problem::TooManyBoxes));
            }
        }
        Ok(boxes)
    }
}

impl<'de> Deserialize<'de> for RawBox {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_seq(RawBoxVisitor)
    }
}

/// A list of anything, so that one bad side is that box's problem and not the file's.
struct RawBoxVisitor;

impl<'de> Visitor<'de> for RawBoxVisitor {
    type Value = RawBox;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a box: a list of its length, breadth and height")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Self::Value, A::Error> {
        let mut raw = RawBox::default();
        while let Some(Side(side)) = seq.next_element()? {
            raw.push(side);
        }
        Ok(raw)
    }
}

/// A number, or NaN for anything else.
struct Side(f64);

impl<'de> Deserialize<'de> for Side {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(SideVisitor).map(Side)
    }
}

struct SideVisitor;

impl<'de> Visitor<'de> for SideVisitor {
    type Value = f64;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a length")
    }

    fn visit_f64<E>(self, value: f64) -> Result<f64, E> {
        Ok(value)
    }

    fn visit_u64<E>(self, value: u64) -> Result<f64, E> {
        Ok(value as f64)
    }

    fn visit_i64<E>(self, value: i64) -> Result<f64, E> {
        Ok(value as f64)
    }

    fn visit_bool<E>(self, _: bool) -> Result<f64, E> {
        Ok(f64::NAN)
    }

    fn visit_str<E>(self, _: &str) -> Result<f64, E> {
        Ok(f64::NAN)
    }

    fn visit_unit<E>(self) -> Result<f64, E> {
        Ok(f64::NAN)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<f64, A::Error> {
        while seq.next_element::<IgnoredAny>()?.is_some() {}
        Ok(f64::NAN)
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<f64, A::Error> {
        while map.next_entry::<IgnoredAny, IgnoredAny>()?.is_some() {}
        Ok(f64::NAN)
    }
}
