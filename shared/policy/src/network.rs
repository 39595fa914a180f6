//! The paper's network. Paper: "Architecture" and figure 6.

use burn::module::{Module, Param};
use burn::nn::Linear;
use burn::tensor::activation::relu;
use burn::tensor::{Device, Gradients, Tensor, TensorData};

use crate::encoding::{Batch, X_LEN, Y_LEN, Z_LEN};
use crate::moves::{FEATURES, Features};
use crate::weights::{Architecture, Layer, LayerShape, Weights};

/// `x` -> dense 144 tanh; joined by `y` and `z` -> dense 144 tanh -> 24 tanh -> 4 tanh -> 1.
#[derive(Module, Debug)]
pub(crate) struct Network {
    grid: Linear,
    place: Linear,
    third: Linear,
    fourth: Linear,
    value: Linear,
}

impl Network {
    /// The network with these weights on `device`, or nothing if they are another architecture's.
    pub(crate) fn new(weights: &Weights, device: &Device) -> Option<Self> {
        let [grid, place, third, fourth, value] = linears(weights, Architecture::Published, device)?;
        Some(Self { grid, place, third, fourth, value })
    }

    /// The gradient of every weight as plain numbers, or nothing if the device failed.
    pub(crate) fn gradients(&self, gradients: &Gradients) -> Option<Vec<Layer>> {
        let layers = [&self.grid, &self.place, &self.third, &self.fourth, &self.value];
        let of = |layer: &Linear| {
            let weight = layer.weight.val().grad(gradients)?.try_into_data().ok()?.try_into_vec().ok()?;
            let bias = layer.bias.as_ref()?.val().grad(gradients)?.try_into_data().ok()?.try_into_vec().ok()?;
            Some(Layer { weight, bias })
        };
        layers.into_iter().map(of).collect()
    }

    /// The value of every row.
    ///
    /// # Shapes
    /// - x: `[rows, 432]`, y: `[rows, 144]`, z: `[rows, 144]`
    /// - values: `[rows, 1]`
    pub(crate) fn forward(&self, [x, y, z]: [Tensor<2>; 3]) -> Tensor<2> {
        let grid = self.grid.forward(x).tanh();
        let place = self.place.forward(Tensor::cat(vec![grid, y, z], 1)).tanh();
        let third = self.third.forward(place).tanh();
        let fourth = self.fourth.forward(third).tanh();
        self.value.forward(fourth)
    }

    /// The value of every row of a batch, or nothing if the device failed.
    pub(crate) fn values(&self, batch: &Batch, device: &Device) -> Option<Vec<f32>> {
        if batch.is_empty() {
            return Some(Vec::new());
        }
        self.forward(tensors(batch, device)).try_into_data().ok()?.try_into_vec().ok()
    }
}

/// A batch as the network reads it: `[rows, 432]`, `[rows, 144]`, `[rows, 144]`.
pub(crate) fn tensors(batch: &Batch, device: &Device) -> [Tensor<2>; 3] {
    let rows = batch.len();
    let matrix = |values: Vec<f32>, columns| Tensor::from_data(TensorData::new(values, [rows, columns]), device);
    [matrix(batch.x.clone(), X_LEN), matrix(batch.y.clone(), Y_LEN), matrix(batch.one_hot(), Z_LEN)]
}

/// The moves' network: a linear score beside a correction by a hidden layer of rectified units.
#[derive(Module, Debug)]
pub(crate) struct MovesNetwork {
    direct: Linear,
    hidden: Linear,
    value: Linear,
}

impl MovesNetwork {
    /// The network with these weights on `device`, or nothing if they are another architecture's.
    pub(crate) fn new(weights: &Weights, device: &Device) -> Option<Self> {
        let [direct, hidden, value] = linears(weights, Architecture::Moves, device)?;
        Some(Self { direct, hidden, value })
    }

    /// The value of every move.
    ///
    /// # Shapes
    /// - moves: `[rows, 28]`
    /// - values: `[rows, 1]`
    pub(crate) fn forward(&self, moves: Tensor<2>) -> Tensor<2> {
        let hidden = relu(self.hidden.forward(moves.clone()));
        self.direct.forward(moves) + self.value.forward(hidden)
    }

    /// The value of every move, or nothing if the device failed.
    pub(crate) fn values(&self, moves: &[Features], device: &Device) -> Option<Vec<f32>> {
        if moves.is_empty() {
            return Some(Vec::new());
        }
        let data = TensorData::new(moves.as_flattened().to_vec(), [moves.len(), FEATURES]);
        self.forward(Tensor::from_data(data, device)).try_into_data().ok()?.try_into_vec().ok()
    }
}

/// The layers of an architecture on `device`, or nothing if the weights are another's.
fn linears<const N: usize>(weights: &Weights, architecture: Architecture, device: &Device) -> Option<[Linear; N]> {
    if weights.architecture() != architecture {
        return None;
    }
    let layers: Vec<_> = weights.named().map(|(shape, layer)| linear(shape, layer, device)).collect();
    layers.try_into().ok()
}

fn linear(shape: &LayerShape, layer: &Layer, device: &Device) -> Linear {
    let weight = TensorData::new(layer.weight.clone(), [shape.inputs, shape.outputs]);
    let bias = TensorData::new(layer.bias.clone(), [shape.outputs]);
    Linear { weight: Param::from_data(weight, device), bias: Some(Param::from_data(bias, device)) }
}

#[cfg(test)]
mod tests {
    use packing::Draw;

    use super::*;
    use crate::Engine;

    /// The definition in double precision.
    fn by_definition(weights: &Weights, batch: &Batch, row: usize) -> f64 {
        let wide = |values: &[f32]| values.iter().map(|&value| f64::from(value)).collect::<Vec<_>>();
        let dense = |index: usize, input: &[f64]| -> Vec<f64> {
            let (layer, outputs) = (&weights.layers()[index], weights.architecture().layers()[index].outputs);
            let column = |output: usize| -> f64 {
                let weight = |(k, value): (usize, &f64)| value * f64::from(layer.weight[k * outputs + output]);
                input.iter().enumerate().map(weight).sum::<f64>() + f64::from(layer.bias[output])
            };
            (0..outputs).map(column).collect()
        };
        let tanh = |values: Vec<f64>| values.into_iter().map(f64::tanh).collect::<Vec<_>>();
        let mut joined = tanh(dense(0, &wide(&batch.x[row * X_LEN..(row + 1) * X_LEN])));
        joined.extend(wide(&batch.y[row * Y_LEN..(row + 1) * Y_LEN]));
        joined.extend(wide(&batch.one_hot()[row * Z_LEN..(row + 1) * Z_LEN]));
        dense(4, &tanh(dense(3, &tanh(dense(2, &tanh(dense(1, &joined)))))))[0]
    }

    #[test]
    fn both_of_burns_engines_compute_the_moves_network() {
        let mut draw = Draw::new(0, 0, 1);
        let weights = Weights::untrained(Architecture::Moves, &mut draw);
        let numbers: Vec<f32> = weights.to_numbers().iter().map(|n| n + draw.unit() as f32 - 0.5).collect();
        let weights = Weights::from_numbers(Architecture::Moves, &numbers).unwrap();
        assert_eq!(weights.to_numbers(), numbers);
        assert_eq!(Weights::from_numbers(Architecture::Moves, &numbers[1..]), None);
        let moves: Vec<Features> = (0..7).map(|_| std::array::from_fn(|_| draw.unit() as f32)).collect();
        for name in Engine::NAMES {
            let Some(device) = name.parse::<Engine>().unwrap().device() else { continue };
            let values = MovesNetwork::new(&weights, &device).unwrap().values(&moves, &device).unwrap();
            for (features, value) in moves.iter().zip(values) {
                let expected = weights.value_of_move(features);
                assert!((value - expected).abs() < 1e-5, "{name}: {value} and not {expected}");
            }
        }
    }

    fn random_batch(rows: usize, draw: &mut Draw) -> Batch {
        let mut unit = |count| (0..count).map(|_| draw.unit() as f32).collect();
        let (x, y) = (unit(rows * X_LEN), unit(rows * Y_LEN));
        Batch { x, y, z: (0..rows).map(|_| draw.below(Z_LEN as u64) as u16).collect() }
    }

    #[test]
    fn both_of_burns_engines_compute_the_papers_network() {
        let mut draw = Draw::new(0, 0, 0);
        let mut weights = Weights::untrained(Architecture::Published, &mut draw);
        let mut layers = weights.layers().to_vec();
        layers.iter_mut().for_each(|layer| layer.bias.iter_mut().for_each(|bias| *bias = draw.unit() as f32 - 0.5));
        weights = Weights::new(Architecture::Published, layers).unwrap();
        let batch = random_batch(5, &mut draw);
        for name in Engine::NAMES {
            let Some(device) = name.parse::<Engine>().unwrap().device() else { continue };
            let network = Network::new(&weights, &device).unwrap();
            let values = network.values(&batch, &device).unwrap();
            for (row, &value) in values.iter().enumerate() {
                let expected = by_definition(&weights, &batch, row);
                assert!((f64::from(value) - expected).abs() < 1e-5, "{name}: {value} and not {expected}");
            }
            // A row's value does not depend on the rows beside it, so the order of candidates decides nothing.
            let mut alone = Batch::default();
            alone.push_row(&batch, 3);
            let lonely = network.values(&alone, &device).unwrap()[0];
            assert!((lonely - values[3]).abs() < 1e-6, "{name}: {lonely} alone and {} in company", values[3]);
        }
    }
}
