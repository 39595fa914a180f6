//! The numbers of a network, without the library that computes with them.

use packing::Draw;
use serde::{Deserialize, Serialize};

/// Networks this project knows, by the shape of their layers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Architecture {
    /// The paper's: `x` -> 144; with `y` and `z` -> 144 -> 24 -> 4 -> 1. Paper: "Architecture".
    Published,
}

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
    pub const ALL: [Self; 1] = [Self::Published];

    /// The name in model files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Published => "432-144-144-24-4-1",
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
