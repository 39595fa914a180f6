//! Model files: a network's weights, what they read, and where they come from.
//!
//! A model file is a safetensors file with one metadata entry, `packcell`: the SHA-256 of the whole file (with the
//! digest's own 64 digits replaced by zeros, so that no flipped bit anywhere goes unnoticed), a space, and a JSON
//! object with the format's version, the architecture, the encoding's number, the container order, and how the
//! model was trained. The same model is the same bytes on every machine.

use std::collections::HashMap;
use std::fs;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use crate::encoding::Encoding;
use crate::weights::{Architecture, Layer, Weights};

/// The version of the file format that this code writes and reads.
pub const FORMAT: u32 = 1;

/// Largest model file that is read: the paper's network takes half a megabyte.
pub const MODEL_BYTES_MAX: u64 = 64 << 20;

/// The name of the one metadata entry.
const METADATA: &str = "packcell";

/// What stands in the digest's place while it is computed.
const DIGEST_BLANK: &str = "0000000000000000000000000000000000000000000000000000000000000000";

/// A trained network and all that is known about it.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    card: Card,
    weights: Weights,
    fingerprint: u64,
}

/// What a model reads and where it comes from.
#[derive(Clone, Debug, PartialEq)]
pub struct Card {
    /// The input it was trained on.
    pub encoding: Encoding,
    /// The candidates it chooses among.
    pub scope: Scope,
    /// How it was trained.
    pub training: Training,
}

/// Which of a box's candidates a policy looks at.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Scope {
    /// Those of the first open container that has any. Only this reading agrees with the paper's figures.
    #[serde(rename = "first-that-fits")]
    FirstContainer,
    /// Those of all open containers.
    #[serde(rename = "all")]
    AllContainers,
}

/// How a model was trained.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Training {
    /// The training recipe's name.
    pub recipe: String,
    /// The seed of all its randomness.
    pub seed: u64,
    /// The data it learned from.
    pub data: String,
    /// Episodes it learned from.
    pub episodes: u64,
    /// The code that trained it.
    pub git_revision: String,
    /// What it scored on validation episodes, if it was validated.
    pub validation: Option<Validation>,
}

/// What a model scored on episodes it did not learn from, and that decide nothing that is published.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Validation {
    /// The data.
    pub data: String,
    /// Number of episodes.
    pub episodes: u64,
    /// Mean containers used over the optimum [-].
    pub competitive_ratio: f64,
    /// Mean fill of the first `optimum` containers [-].
    pub fill: f64,
}

/// The record in a file's metadata.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Record {
    format: u32,
    architecture: String,
    encoding: u32,
    #[serde(rename = "container_order")]
    scope: Scope,
    training: Training,
}

/// The part of the record that every version has.
#[derive(Deserialize)]
struct Version {
    format: u32,
}

/// A model that cannot be loaded or saved.
#[derive(Debug, thiserror::Error)]
#[error("model {}", origin.display())]
pub struct ModelError {
    /// The file, or what stood in for one.
    pub origin: PathBuf,
    /// What is wrong with it.
    #[source]
    pub fault: ModelFault,
}

/// What is wrong with a model.
#[derive(Debug, thiserror::Error)]
pub enum ModelFault {
    /// It cannot be read.
    #[error("cannot be read: give the path of a file made by packlab train")]
    Read(#[source] io::Error),
    /// It cannot be written.
    #[error("cannot be written: any earlier file of this name is unchanged")]
    Write(#[source] io::Error),
    /// It is far larger than any model.
    #[error("has {0} bytes, and no model has more than {MODEL_BYTES_MAX}: give a file made by packlab train")]
    TooLarge(u64),
    /// It is no safetensors file, or not all of one.
    #[error("is damaged, cut short or no model file ({0}): copy it again, or train it again with packlab train")]
    NotSafetensors(String),
    /// It is a safetensors file that this project did not write.
    #[error("is a safetensors file without packcell's record: only files made by packlab train can be loaded")]
    Foreign,
    /// Its digest is not that of its content.
    #[error("is damaged: its content has the SHA-256 {found} and not {stated}; copy it again")]
    Digest {
        /// As stated in the file.
        stated: String,
        /// As computed.
        found: String,
    },
    /// Its record cannot be understood.
    #[error("has a record that cannot be understood ({0}): train it again with packlab train")]
    Record(String),
    /// It was written in another version of the format.
    #[error(
        "has format version {0}, and this build reads version {FORMAT}: use the build that made it, or train it again"
    )]
    Format(u32),
    /// Its network is not one of this build's.
    #[error("holds a network {0:?} that this build does not know: use the build that made it, or train it again")]
    Architecture(String),
    /// Its network does not read that encoding.
    #[error(
        "reads encoding {encoding}, which this build does not know for a network {architecture}: use the build that made it"
    )]
    Encoding {
        /// As stated in the file.
        encoding: u32,
        /// As stated in the file.
        architecture: &'static str,
    },
    /// A tensor is missing or has another shape.
    #[error("has no tensor {name} of {shape:?} 32-bit floats: train it again with packlab train")]
    Tensor {
        /// The tensor's name.
        name: String,
        /// The shape it should have.
        shape: Vec<usize>,
    },
    /// It has tensors that its network does not.
    #[error("has {found} tensors, and its network has {expected}: train it again with packlab train")]
    TensorCount {
        /// In the file.
        found: usize,
        /// Of the network.
        expected: usize,
    },
    /// A weight is infinite or no number.
    #[error("has a weight in layer {0} that is not a finite number: its training diverged, train it again")]
    NotFinite(&'static str),
}

impl Model {
    /// A model of these weights.
    ///
    /// # Errors
    /// [`ModelFault::NotFinite`] or [`ModelFault::Encoding`] for weights that no file could hold.
    pub fn new(card: Card, weights: Weights) -> Result<Self, ModelError> {
        let in_memory = |fault| ModelError { origin: PathBuf::from("in memory"), fault };
        let mut model = Self { card, weights, fingerprint: 0 };
        model.check().map_err(in_memory)?;
        let (_, digest) = model.encode().map_err(in_memory)?;
        model.fingerprint = fingerprint(&digest);
        Ok(model)
    }

    /// The model that ships for the policies that look at all open containers.
    ///
    /// # Errors
    /// [`ModelError`] if it is damaged, which a test of this crate rules out.
    pub fn built_in() -> Result<Self, ModelError> {
        Self::from_bytes(include_bytes!("../../../deploy/models/packman.safetensors"))
    }

    /// The model that ships for the policy of the paper.
    ///
    /// # Errors
    /// As [`Model::built_in`].
    pub fn built_in_published() -> Result<Self, ModelError> {
        Self::from_bytes(include_bytes!("../../../deploy/models/packman-published.safetensors"))
    }

    /// Reads a model file.
    ///
    /// # Errors
    /// [`ModelError`] says what is wrong with which file and what to do.
    pub fn load(path: &Path) -> Result<Self, ModelError> {
        let at = |fault| ModelError { origin: path.to_owned(), fault };
        let bytes = fs::metadata(path).map_err(|error| at(ModelFault::Read(error)))?.len();
        if bytes > MODEL_BYTES_MAX {
            return Err(at(ModelFault::TooLarge(bytes)));
        }
        let bytes = fs::read(path).map_err(|error| at(ModelFault::Read(error)))?;
        Self::decode(&bytes).map_err(at)
    }

    /// Reads a model from the bytes of a model file.
    ///
    /// # Errors
    /// As [`Model::load`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, ModelError> {
        Self::decode(bytes).map_err(|fault| ModelError { origin: PathBuf::from("in memory"), fault })
    }

    /// Writes a model file: whoever reads `path` finds the earlier file or the whole new one, whatever happens.
    ///
    /// # Errors
    /// [`ModelFault::Write`] with the reason.
    pub fn save(&self, path: &Path) -> Result<(), ModelError> {
        let at = |fault| ModelError { origin: path.to_owned(), fault };
        let (bytes, _) = self.encode().map_err(at)?;
        write_atomically(path, &bytes).map_err(|error| at(ModelFault::Write(error)))
    }

    /// What the model reads and where it comes from.
    #[must_use]
    pub fn card(&self) -> &Card {
        &self.card
    }

    /// The network's numbers.
    #[must_use]
    pub fn weights(&self) -> &Weights {
        &self.weights
    }

    /// The first 8 bytes of the file's SHA-256, which tells models apart in messages and reports.
    #[must_use]
    pub fn fingerprint(&self) -> u64 {
        self.fingerprint
    }

    fn check(&self) -> Result<(), ModelFault> {
        let architecture = self.weights.architecture();
        if !self.card.encoding.is_read_by(architecture) {
            return Err(ModelFault::Encoding {
                encoding: self.card.encoding.number(),
                architecture: architecture.name(),
            });
        }
        self.weights.not_finite().map_or(Ok(()), |layer| Err(ModelFault::NotFinite(layer)))
    }

    /// The file's bytes and digest.
    fn encode(&self) -> Result<(Vec<u8>, String), ModelFault> {
        let record = Record {
            format: FORMAT,
            architecture: self.weights.architecture().name().to_owned(),
            encoding: self.card.encoding.number(),
            scope: self.card.scope,
            training: self.card.training.clone(),
        };
        let unwritable = |error: String| ModelFault::Record(error);
        let record = serde_json::to_string(&record).map_err(|error| unwritable(error.to_string()))?;
        let metadata = HashMap::from([(METADATA.to_owned(), format!("{DIGEST_BLANK} {record}"))]);
        let little_endian = |values: &[f32]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
        let mut tensors = Vec::new();
        for (shape, layer) in self.weights.named() {
            let name = shape.name;
            tensors.push((format!("{name}.weight"), vec![shape.inputs, shape.outputs], little_endian(&layer.weight)));
            tensors.push((format!("{name}.bias"), vec![shape.outputs], little_endian(&layer.bias)));
        }
        let views = tensors
            .iter()
            .map(|(name, shape, bytes)| Ok((name, TensorView::new(Dtype::F32, shape.clone(), bytes)?)))
            .collect::<Result<Vec<_>, safetensors::SafeTensorError>>();
        let bytes = views.and_then(|views| safetensors::serialize(views, Some(metadata)));
        let mut bytes = bytes.map_err(|error| unwritable(error.to_string()))?;
        let digest = digest_of(&bytes);
        let start =
            digest_position(&bytes, DIGEST_BLANK).ok_or_else(|| unwritable("no place for the digest".into()))?;
        bytes[start..start + digest.len()].copy_from_slice(digest.as_bytes());
        Ok((bytes, digest))
    }

    fn decode(bytes: &[u8]) -> Result<Self, ModelFault> {
        let not_safetensors = |error: safetensors::SafeTensorError| ModelFault::NotSafetensors(error.to_string());
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(not_safetensors)?;
        let file = SafeTensors::deserialize(bytes).map_err(not_safetensors)?;
        let entry = header.metadata().as_ref().and_then(|metadata| metadata.get(METADATA));
        let (stated, record) = entry.ok_or(ModelFault::Foreign)?.split_once(' ').ok_or(ModelFault::Foreign)?;
        let digest = check_digest(bytes, stated)?;

        let not_understood = |error: serde_json::Error| ModelFault::Record(error.to_string());
        let Version { format } = serde_json::from_str(record).map_err(not_understood)?;
        if format != FORMAT {
            return Err(ModelFault::Format(format));
        }
        let record: Record = serde_json::from_str(record).map_err(not_understood)?;
        let architecture = Architecture::from_name(&record.architecture)
            .ok_or_else(|| ModelFault::Architecture(record.architecture.clone()))?;
        let unknown_encoding = || ModelFault::Encoding { encoding: record.encoding, architecture: architecture.name() };
        let encoding = Encoding::from_number(record.encoding).ok_or_else(unknown_encoding)?;

        let weights = weights_of(&file, architecture)?;
        let card = Card { encoding, scope: record.scope, training: record.training };
        let model = Self { card, weights, fingerprint: fingerprint(&digest) };
        model.check()?;
        Ok(model)
    }
}

fn weights_of(file: &SafeTensors<'_>, architecture: Architecture) -> Result<Weights, ModelFault> {
    let tensor = |name: String, shape: Vec<usize>| -> Result<Vec<f32>, ModelFault> {
        let found = file.tensor(&name).ok().filter(|view| view.dtype() == Dtype::F32 && view.shape() == shape);
        let view = found.ok_or(ModelFault::Tensor { name, shape })?;
        let (chunks, _) = view.data().as_chunks::<4>();
        Ok(chunks.iter().map(|&bytes| f32::from_le_bytes(bytes)).collect())
    };
    let shapes = architecture.layers();
    if file.len() != 2 * shapes.len() {
        return Err(ModelFault::TensorCount { found: file.len(), expected: 2 * shapes.len() });
    }
    let mut layers = Vec::new();
    for shape in shapes {
        layers.push(Layer {
            weight: tensor(format!("{}.weight", shape.name), vec![shape.inputs, shape.outputs])?,
            bias: tensor(format!("{}.bias", shape.name), vec![shape.outputs])?,
        });
    }
    Weights::new(architecture, layers).ok_or_else(|| ModelFault::Architecture(architecture.name().to_owned()))
}

/// The digest of a file, if it is the stated one.
fn check_digest(bytes: &[u8], stated: &str) -> Result<String, ModelFault> {
    let position = digest_position(bytes, stated).filter(|_| stated.len() == DIGEST_BLANK.len());
    let Some(start) = position else {
        return Err(ModelFault::Record(format!("{stated:?} is no SHA-256")));
    };
    let mut blank = bytes.to_vec();
    blank[start..start + DIGEST_BLANK.len()].copy_from_slice(DIGEST_BLANK.as_bytes());
    let found = digest_of(&blank);
    if found == stated { Ok(found) } else { Err(ModelFault::Digest { stated: stated.to_owned(), found }) }
}

/// Where the digest stands in a file.
fn digest_position(bytes: &[u8], digest: &str) -> Option<usize> {
    let before = format!("\"{METADATA}\":\"");
    let entry = format!("{before}{digest} ");
    let start = bytes.windows(entry.len()).position(|window| window == entry.as_bytes())?;
    Some(start + before.len())
}

fn digest_of(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The first 8 bytes of a digest as a number.
fn fingerprint(digest: &str) -> u64 {
    digest.get(..16).and_then(|digits| u64::from_str_radix(digits, 16).ok()).unwrap_or(0)
}

/// Replaces a file's content so that a reader finds the old content or the new, even after a power cut.
pub(crate) fn write_atomically(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let name = path.file_name().ok_or_else(|| io::Error::other("the path names no file"))?;
    let mut temporary_name = std::ffi::OsString::from(".");
    temporary_name.push(name);
    temporary_name.push(format!(".{}.part", std::process::id()));
    let temporary = folder.join(temporary_name);
    let written = (|| {
        let mut file = fs::File::create(&temporary)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        fs::rename(&temporary, path)?;
        fs::File::open(folder)?.sync_all()
    })();
    if written.is_err() {
        let _the_first_error_is_the_one_to_report = fs::remove_file(&temporary);
    }
    written
}

#[cfg(test)]
mod tests {
    use packing::Draw;

    use super::*;

    fn card() -> Card {
        Card {
            encoding: Encoding::Published(crate::Walls::Empty),
            scope: Scope::FirstContainer,
            training: Training { recipe: "none".into(), seed: 7, ..Training::default() },
        }
    }

    fn model() -> Model {
        Model::new(card(), Weights::untrained(Architecture::Published, &mut Draw::new(0, 1, 0))).unwrap()
    }

    /// The whole story: which file, what is wrong, what to do.
    fn message(error: &ModelError) -> String {
        format!("{error}: {}", error.fault)
    }

    #[track_caller]
    fn refused(bytes: &[u8]) -> ModelFault {
        let error = Model::from_bytes(bytes).unwrap_err();
        assert!(message(&error).starts_with("model in memory: "), "{}", message(&error));
        error.fault
    }

    /// The bytes of a file with another record, correctly sealed.
    fn sealed(record: &str) -> Vec<u8> {
        let value = 1f32.to_le_bytes();
        let view = TensorView::new(Dtype::F32, vec![1], &value).unwrap();
        let metadata = HashMap::from([(METADATA.to_owned(), format!("{DIGEST_BLANK} {record}"))]);
        let mut bytes = safetensors::serialize([("tensor", view)], Some(metadata)).unwrap();
        let digest = digest_of(&bytes);
        let start = digest_position(&bytes, DIGEST_BLANK).unwrap();
        bytes[start..start + 64].copy_from_slice(digest.as_bytes());
        bytes
    }

    fn record(format: u32, architecture: &str, encoding: u32) -> String {
        format!(
            r#"{{"format":{format},"architecture":"{architecture}","encoding":{encoding},"container_order":"all","training":{{"recipe":"","seed":0,"data":"","episodes":0,"git_revision":"","validation":null}}}}"#
        )
    }

    #[test]
    fn the_model_that_ships_can_be_loaded() {
        assert_eq!(Model::built_in().unwrap().card().encoding, Encoding::Moves);
        let published = Model::built_in_published().unwrap();
        assert_eq!(published.card().scope, Scope::FirstContainer);
        assert_ne!(published.fingerprint(), 0);
    }

    #[test]
    fn what_is_saved_is_loaded() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.safetensors");
        let model = model();
        model.save(&path).unwrap();
        assert_eq!(Model::load(&path).unwrap(), model);
        model.save(&path).unwrap();
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "no temporary file is left");
        assert_eq!(fs::read(&path).unwrap(), model.encode().unwrap().0, "the same bytes every time");
    }

    #[test]
    fn a_file_that_cannot_be_read_or_written_is_named() {
        let error = Model::load(Path::new("/nowhere/model.safetensors")).unwrap_err();
        assert!(message(&error).starts_with("model /nowhere/model.safetensors: cannot be read"), "{}", message(&error));
        let error = model().save(Path::new("/nowhere/model.safetensors")).unwrap_err();
        assert!(matches!(error.fault, ModelFault::Write(_)));
        assert!(matches!(Model::load(Path::new("/")).unwrap_err().fault, ModelFault::Read(_)));
    }

    #[test]
    fn a_file_cut_short_is_refused_wherever_it_was_cut() {
        let bytes = model().encode().unwrap().0;
        let header = 8 + u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
        let lengths = (0..header + 64).chain((header + 64..bytes.len()).step_by(997)).chain([bytes.len() - 1]);
        for length in lengths {
            assert!(matches!(refused(&bytes[..length]), ModelFault::NotSafetensors(_)), "{length} bytes");
        }
        let mut longer = bytes;
        longer.push(0);
        assert!(matches!(refused(&longer), ModelFault::NotSafetensors(_)));
    }

    /// Every bit of the header, and a bit of every hundredth byte of the weights.
    #[test]
    fn a_flipped_bit_is_noticed_wherever_it_is() {
        let mut bytes = model().encode().unwrap().0;
        let header = 8 + u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
        let last = bytes.len() - 1;
        let in_header = (0..header).flat_map(|byte| (0..8).map(move |bit| (byte, bit)));
        let in_weights = (header..last).step_by(9973).chain([last]).map(|byte| (byte, byte % 8));
        for (byte, bit) in in_header.chain(in_weights) {
            bytes[byte] ^= 1 << bit;
            refused(&bytes);
            bytes[byte] ^= 1 << bit;
        }
        assert!(Model::from_bytes(&bytes).is_ok());
    }

    #[test]
    fn files_of_others_and_of_other_times_are_told_apart() {
        let view = TensorView::new(Dtype::F32, vec![1], &[0; 4]).unwrap();
        let foreign = safetensors::serialize([("tensor", view)], None).unwrap();
        assert!(matches!(refused(&foreign), ModelFault::Foreign));
        assert!(matches!(refused(b"PK\x03\x04 and so on"), ModelFault::NotSafetensors(_)));
        let published = Architecture::Published.name();
        assert!(matches!(refused(&sealed("{}")), ModelFault::Record(_)));
        assert!(matches!(refused(&sealed(r#"{"format":2,"news":[]}"#)), ModelFault::Format(2)));
        assert!(
            matches!(refused(&sealed(&record(1, "resnet", 1))), ModelFault::Architecture(name) if name == "resnet")
        );
        assert!(matches!(refused(&sealed(&record(1, published, 99))), ModelFault::Encoding { encoding: 99, .. }));
        assert!(matches!(refused(&sealed(&record(1, published, 1))), ModelFault::TensorCount { found: 1, .. }));
    }

    #[test]
    fn weights_that_are_no_numbers_are_refused() {
        for bad in [f32::NAN, f32::INFINITY] {
            let mut layers = model().weights().layers().to_vec();
            layers[2].bias[5] = bad;
            let weights = Weights::new(Architecture::Published, layers).unwrap();
            let error = Model::new(card(), weights).unwrap_err();
            assert!(matches!(error.fault, ModelFault::NotFinite("third")));
        }
    }

    #[test]
    fn a_full_disk_leaves_the_earlier_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.safetensors");
        fs::write(&path, b"earlier").unwrap();
        // A folder in the place of the temporary file stands in for a disk that refuses to write it.
        let temporary = folder.path().join(format!(".model.safetensors.{}.part", std::process::id()));
        fs::create_dir(&temporary).unwrap();
        assert!(matches!(model().save(&path).unwrap_err().fault, ModelFault::Write(_)));
        assert_eq!(fs::read(&path).unwrap(), b"earlier");
    }
}
