//! The numbers of a network, without the library that computes with them.

use packing::Draw;
use serde::{Deserialize, Serialize};

use crate::moves::{FEATURES, Features};

/// Networks this project knows, by the shape of their layers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Architecture {
    /// The paper's: `x` -> 144; with `y` and `z` -> 144 -> 24 -> 4 -> 1. Paper: "Architecture".
    Published,
    /// A small one over the features of one move: a linear score and a correction by a hidden layer.
    Moves,
}

/// Units in the hidden layer of [`Architecture::Moves`].
pub const HIDDEN_UNITS: usize = 8;

/// The shape of one dense layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LayerShape {
    /// Its name in model files.
    pub name: &'static str,
    /// Numbers in.
    pub inputs: usize,
    /// Numbers out.
    pub outputs: usize,
}

const fn layer(name: &'static str, inputs: usize, outputs: usize) -> LayerShape {
    LayerShape { name, inputs, outputs }
}

impl Architecture {
    /// All architectures.
    pub const ALL: [Self; 2] = [Self::Published, Self::Moves];

    /// The name in model files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Published => "432-144-144-24-4-1",
            Self::Moves => "moves 28-8-1 beside 28-1",
        }
    }

    /// The architecture with this name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|architecture| architecture.name() == name)
    }

    /// Its layers, from input to output.
    #[must_use]
    pub fn layers(self) -> &'static [LayerShape] {
        match self {
            Self::Published => {
                const {
                    &[
                        layer("grid", 432, 144),
                        layer("place", 144 + 144 + 144, 144),
                        layer("third", 144, 24),
                        layer("fourth", 24, 4),
                        layer("value", 4, 1),
                    ]
                }
            }
            Self::Moves => {
                const {
                    &[
                        layer("direct", FEATURES, 1),
                        layer("hidden", FEATURES, HIDDEN_UNITS),
                        layer("value", HIDDEN_UNITS, 1),
                    ]
                }
            }
        }
    }
}

/// One dense layer's numbers: `out = in * weight + bias`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Layer {
    /// `[inputs, outputs]`, row by row.
    pub weight: Vec<f32>,
    /// `[outputs]`.
    pub bias: Vec<f32>,
}

/// All numbers of a network, as many as its architecture has.
#[derive(Clone, Debug, PartialEq)]
pub struct Weights {
    architecture: Architecture,
    layers: Vec<Layer>,
}

impl Weights {
    /// An untrained network, the same for the same draws: weights uniform within `sqrt(6 / (inputs + outputs))`
    /// (Glorot), as the paper's library draws them, and biases zero.
    #[must_use]
    pub fn untrained(architecture: Architecture, draw: &mut Draw) -> Self {
        let layers = architecture.layers().iter().map(|shape| {
            let limit = (6.0 / (shape.inputs + shape.outputs) as f64).sqrt();
            let weight = (0..shape.inputs * shape.outputs).map(|_| ((2.0 * draw.unit() - 1.0) * limit) as f32);
            Layer { weight: weight.collect(), bias: vec![0.0; shape.outputs] }
        });
        let layers = layers.collect();
        Self { architecture, layers }
    }

    /// The layers of `architecture`, or nothing if their sizes are not its own.
    #[must_use]
    pub fn new(architecture: Architecture, layers: Vec<Layer>) -> Option<Self> {
        let shapes = architecture.layers();
        let fits = layers.len() == shapes.len()
            && layers.iter().zip(shapes).all(|(layer, shape)| {
                layer.weight.len() == shape.inputs * shape.outputs && layer.bias.len() == shape.outputs
            });
        fits.then_some(Self { architecture, layers })
    }

    /// The network they belong to.
    #[must_use]
    pub fn architecture(&self) -> Architecture {
        self.architecture
    }

    /// The layers, from input to output.
    #[must_use]
    pub fn layers(&self) -> &[Layer] {
        &self.layers
    }

    /// All numbers in the order of the layers, each layer's weight before its bias.
    #[must_use]
    pub fn to_numbers(&self) -> Vec<f32> {
        self.layers.iter().flat_map(|layer| layer.weight.iter().chain(&layer.bias).copied()).collect()
    }

    /// The network with these numbers, or nothing if there are too few or too many.
    #[must_use]
    pub fn from_numbers(architecture: Architecture, numbers: &[f32]) -> Option<Self> {
        let mut rest = numbers;
        let mut take = |count: usize| {
            let (taken, left) = rest.split_at_checked(count)?;
            rest = left;
            Some(taken.to_vec())
        };
        let mut layers = Vec::new();
        for shape in architecture.layers() {
            layers.push(Layer { weight: take(shape.inputs * shape.outputs)?, bias: take(shape.outputs)? });
        }
        rest.is_empty().then_some(Self { architecture, layers })
    }

    /// The value of a move by an [`Architecture::Moves`], computed here and now: the definition that the engines
    /// are held to, and the fast way through whole episodes. Another architecture's value is not a number.
    #[must_use]
    pub fn value_of_move(&self, features: &Features) -> f32 {
        let (Architecture::Moves, [direct, hidden, value]) = (self.architecture, self.layers.as_slice()) else {
            return f32::NAN;
        };
        let mut units = [0.0f32; HIDDEN_UNITS];
        units.copy_from_slice(&hidden.bias);
        let mut sum = direct.bias[0] + value.bias[0];
        for (k, &feature) in features.iter().enumerate() {
            sum += feature * direct.weight[k];
            for (unit, weight) in units.iter_mut().zip(&hidden.weight[k * HIDDEN_UNITS..(k + 1) * HIDDEN_UNITS]) {
                *unit += feature * weight;
            }
        }
        sum + units.iter().zip(&value.weight).map(|(unit, weight)| unit.max(0.0) * weight).sum::<f32>()
    }

    /// Shape and numbers of every layer.
    pub(crate) fn named(&self) -> impl Iterator<Item = (&'static LayerShape, &Layer)> {
        self.architecture.layers().iter().zip(&self.layers)
    }

    /// The name of the first layer that holds a number which is not finite.
    pub(crate) fn not_finite(&self) -> Option<&'static str> {
        let bad = |layer: &Layer| layer.weight.iter().chain(&layer.bias).any(|value| !value.is_finite());
        self.named().find(|(_, layer)| bad(layer)).map(|(shape, _)| shape.name)
    }
}
