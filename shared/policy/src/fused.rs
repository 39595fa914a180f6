//! The published network for all candidates of one box at once, in plain Rust.
//!
//! The candidates of a box share almost everything, so that little is left to compute for each:
//!
//! - **first layer**: the present grid goes through it once; a future grid adds the rows of the few numbers that it
//!   changes. Candidates with equal future grids share the result, and its way through the second layer.
//! - **second layer**: `z` is a look-up. A border is a few runs of equal heights, so `y` adds one row a run: the sum
//!   of the weights' rows from there to the end, made once.
//! - **tanh** is a quotient of polynomials, nowhere more than 4e-7 from the true one.
//!
//! # The same value everywhere
//!
//! A value has the same bits on every machine that adds a product with one rounding (x86-64 with AVX2 and FMA, aarch64):
//! each sum is taken in one order whatever the vector width, because vectors lie across the units of a layer and never
//! along a sum. So a cell with AVX-512 and a laptop with AVX2 choose alike, ties included. A machine without that
//! instruction rounds twice, and its values differ in their last digits: doing the same in software takes a hundred
//! times as long, which would be the end of the budget. A value does not depend on the other candidates.

use crate::encoding::{Changes, Input, Y_LEN};
use crate::weights::{Architecture, Weights};

/// Units of the first and of the second layer.
const UNITS: usize = 144;
/// Units of the third layer.
const THIRD: usize = 24;
/// Units of the fourth layer.
const FOURTH: usize = 4;
/// Candidates that go through a layer together.
const BLOCK: usize = 8;
/// Units of a layer that are summed up together: a vector of AVX2, two of the least that x86-64 has.
const LANES: usize = 8;
/// Units of one candidate that are summed up together, where the terms are few.
const SPAN: usize = 48;

/// One number for every unit of a layer, where whole vectors can be loaded.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct Row<const N: usize>([f32; N]);

/// The network with its buffers.
#[derive(Debug)]
pub(crate) struct Fused {
    width: Width,
    layers: Layers,
    work: Work,
}

/// The weights, arranged for the way they are used.
#[derive(Debug)]
struct Layers {
    /// First layer: `[432]` rows and the bias.
    grid: Vec<Row<UNITS>>,
    grid_bias: Row<UNITS>,
    /// Second layer, the part for the first layer's units: `[144]` rows.
    place: Vec<Row<UNITS>>,
    /// Second layer, the part for `y`: row `k` is the sum of the weights' rows from `k` to the last of `[144]`.
    border: Vec<Row<UNITS>>,
    /// Second layer, the part for `z`: `[144]` rows, the bias in each.
    fields: Vec<Row<UNITS>>,
    third: Vec<Row<THIRD>>,
    third_bias: Row<THIRD>,
    fourth: [[f32; FOURTH]; THIRD],
    fourth_bias: [f32; FOURTH],
    value: [f32; FOURTH],
    value_bias: f32,
}

/// What is computed on the way; all memory is kept.
#[derive(Debug, Default)]
struct Work {
    /// By future grid: the first layer's units.
    hidden: Vec<Row<UNITS>>,
    /// By future grid: what they add to the second layer.
    shared: Vec<Row<UNITS>>,
    /// By candidate: the second layer's units.
    place: Vec<Row<UNITS>>,
    /// By candidate: the third layer's units.
    third: Vec<Row<THIRD>>,
    values: Vec<f32>,
}

/// The vector instructions that are used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Width {
    /// What every machine of this architecture has.
    Least,
    /// With fused products.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Width {
    /// The widths that this machine has, the widest last.
    fn available() -> impl Iterator<Item = Self> {
        #[cfg(target_arch = "x86_64")]
        let wider = {
            let has_avx2 = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma");
            let has_avx512 = has_avx2 && is_x86_feature_detected!("avx512f");
            [has_avx2.then_some(Self::Avx2), has_avx512.then_some(Self::Avx512)].into_iter().flatten()
        };
        #[cfg(not(target_arch = "x86_64"))]
        let wider = None;
        std::iter::once(Self::Least).chain(wider)
    }
}

impl Fused {
    /// The network with these weights, or nothing if they are another architecture's.
    pub(crate) fn new(weights: &Weights) -> Option<Self> {
        let width = Width::available().last()?;
        Some(Self { width, layers: Layers::new(weights)?, work: Work::default() })
    }

    /// The value of every candidate.
    pub(crate) fn values(&mut self, changes: &Changes) -> &[f32] {
        let (layers, work) = (&self.layers, &mut self.work);
        work.make_room(changes);
        match self.width {
            Width::Least => forward(layers, changes, work, Least),
            #[cfg(target_arch = "x86_64")]
            #[expect(unsafe_code, reason = "the compiler cannot know which machine this will run on")]
            // SAFETY: the machine has AVX2 and FMA, or `Width::available` would not have given this width.
            Width::Avx2 => unsafe { forward_avx2(layers, changes, work) },
            #[cfg(target_arch = "x86_64")]
            #[expect(unsafe_code, reason = "the compiler cannot know which machine this will run on")]
            // SAFETY: the machine has AVX-512F, AVX2 and FMA, or `Width::available` would not have given this width.
            Width::Avx512 => unsafe { forward_avx512(layers, changes, work) },
        }
        &work.values[..changes.len()]
    }
}

/// As [`forward`], compiled for AVX2 with fused products.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn forward_avx2(layers: &Layers, changes: &Changes, work: &mut Work) {
    forward(layers, changes, work, Fused32);
}

/// As [`forward_avx2`], with vectors twice as wide.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx2,fma")]
fn forward_avx512(layers: &Layers, changes: &Changes, work: &mut Work) {
    forward(layers, changes, work, Fused512(()));
}

/// What a machine does in one step.
trait Arithmetic: Copy {
    /// `a b + c`, rounded once where there is an instruction for that.
    fn fma(self, a: f32, b: f32, c: f32) -> f32;

    /// The matrix product of some inputs with the second layer's weights: half of all the work.
    #[inline(always)]
    fn multiply(self, inputs: &[Row<UNITS>; BLOCK], weights: &[Row<UNITS>], outputs: &mut [Row<UNITS>; BLOCK]) {
        *outputs = [Row([0.0; UNITS]); BLOCK];
        add_product(inputs, weights, outputs, self);
    }
}

/// What every machine of the architecture does.
#[derive(Clone, Copy)]
struct Least;

/// The instruction.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy)]
struct Fused32;

/// The instruction, and AVX-512 for the product. Only [`forward_avx512`] may make one.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy)]
struct Fused512(());

impl Arithmetic for Least {
    #[inline(always)]
    fn fma(self, a: f32, b: f32, c: f32) -> f32 {
        if cfg!(target_arch = "aarch64") { a.mul_add(b, c) } else { a * b + c }
    }
}

#[cfg(target_arch = "x86_64")]
impl Arithmetic for Fused32 {
    #[inline(always)]
    fn fma(self, a: f32, b: f32, c: f32) -> f32 {
        a.mul_add(b, c)
    }
}

#[cfg(target_arch = "x86_64")]
impl Arithmetic for Fused512 {
    #[inline(always)]
    fn fma(self, a: f32, b: f32, c: f32) -> f32 {
        a.mul_add(b, c)
    }

    #[inline(always)]
    fn multiply(self, inputs: &[Row<UNITS>; BLOCK], weights: &[Row<UNITS>], outputs: &mut [Row<UNITS>; BLOCK]) {
        #[expect(unsafe_code, reason = "the compiler cannot know which machine this will run on")]
        // SAFETY: there is a `Fused512` only where there is AVX-512F.
        unsafe {
            multiply_avx512(inputs, weights, outputs);
        }
    }
}

/// [`Arithmetic::multiply`] with vectors of 16, by hand: the compiler does not keep sums of that size in registers. Three
/// vectors of eight candidates are 24 of its 32.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f")]
fn multiply_avx512(inputs: &[Row<UNITS>; BLOCK], weights: &[Row<UNITS>], outputs: &mut [Row<UNITS>; BLOCK]) {
    use std::arch::x86_64::{_mm512_fmadd_ps, _mm512_loadu_ps, _mm512_set1_ps, _mm512_setzero_ps, _mm512_storeu_ps};
    const WIDE: usize = 16;
    const VECTORS: usize = 3;
    for first in (0..UNITS).step_by(VECTORS * WIDE) {
        let mut sums = [[_mm512_setzero_ps(); VECTORS]; BLOCK];
        for (k, weights) in weights.iter().enumerate() {
            let (weights, _) = weights.0[first..].as_chunks::<WIDE>();
            let weights: [_; VECTORS] = std::array::from_fn(|vector| {
                #[expect(unsafe_code, reason = "vectors are loaded from memory by address")]
                // SAFETY: 16 numbers lie there.
                unsafe {
                    _mm512_loadu_ps(weights[vector].as_ptr())
                }
            });
            for (sums, input) in sums.iter_mut().zip(inputs) {
                let factor = _mm512_set1_ps(input.0[k]);
                for (sum, weights) in sums.iter_mut().zip(weights) {
                    *sum = _mm512_fmadd_ps(factor, weights, *sum);
                }
            }
        }
        for (output, sums) in outputs.iter_mut().zip(sums) {
            let (output, _) = output.0[first..].as_chunks_mut::<WIDE>();
            for (output, sum) in output.iter_mut().zip(sums) {
                #[expect(unsafe_code, reason = "vectors are stored in memory by address")]
                // SAFETY: there is room for 16 numbers.
                unsafe {
                    _mm512_storeu_ps(output.as_mut_ptr(), sum);
                }
            }
        }
    }
}

impl Layers {
    fn new(weights: &Weights) -> Option<Self> {
        let (Architecture::Published, [grid, place, third, fourth, value]) = (weights.architecture(), weights.layers())
        else {
            return None;
        };
        let joined: Vec<Row<UNITS>> = rows(&place.weight, UNITS);
        let (hidden, others) = joined.split_at_checked(UNITS)?;
        let (border, fields) = others.split_at_checked(Y_LEN)?;
        let bias: Row<UNITS> = row(&place.bias);
        let plus_bias = |field: &Row<UNITS>| Row(std::array::from_fn(|unit| bias.0[unit] + field.0[unit]));
        Some(Self {
            grid: rows(&grid.weight, UNITS),
            grid_bias: row(&grid.bias),
            place: hidden.to_vec(),
            border: sums_to_the_end(border),
            fields: fields.iter().map(plus_bias).collect(),
            third: rows(&third.weight, THIRD),
            third_bias: row(&third.bias),
            fourth: fourth.weight.as_chunks().0.try_into().ok()?,
            fourth_bias: fourth.bias.as_slice().try_into().ok()?,
            value: value.weight.as_slice().try_into().ok()?,
            value_bias: *value.bias.first()?,
        })
    }
}

/// The numbers, and zeros after them.
fn row<const N: usize>(numbers: &[f32]) -> Row<N> {
    Row(std::array::from_fn(|unit| numbers.get(unit).copied().unwrap_or(0.0)))
}

fn rows<const N: usize>(weight: &[f32], outputs: usize) -> Vec<Row<N>> {
    weight.chunks_exact(outputs).map(row).collect()
}

fn sums_to_the_end(rows: &[Row<UNITS>]) -> Vec<Row<UNITS>> {
    let mut sum = [0.0f64; UNITS];
    let add = |row: &Row<UNITS>| {
        sum.iter_mut().zip(row.0).for_each(|(sum, weight)| *sum += f64::from(weight));
        Row(sum.map(|sum| sum as f32))
    };
    let mut sums: Vec<_> = rows.iter().rev().map(add).collect();
    sums.reverse();
    sums
}

impl Work {
    /// Makes room for whole blocks. What lies there beyond the candidates is computed with them and means nothing.
    fn make_room(&mut self, changes: &Changes) {
        let grow = |rows: &mut Vec<Row<UNITS>>, count: usize| {
            rows.resize(rows.len().max(count.next_multiple_of(BLOCK)), Row([0.0; UNITS]));
        };
        grow(&mut self.hidden, changes.futures().len());
        grow(&mut self.shared, changes.futures().len());
        grow(&mut self.place, changes.len());
        self.third.resize(self.place.len(), Row([0.0; THIRD]));
        self.values.resize(self.place.len(), 0.0);
    }
}

/// The whole network.
#[inline(always)]
fn forward(layers: &Layers, changes: &Changes, work: &mut Work, machine: impl Arithmetic) {
    let present = changes.present();
    let mut before = layers.grid_bias;
    add_rows(&mut before, present.iter().copied().zip(&layers.grid), machine);
    for (units, inputs) in work.hidden.iter_mut().zip(changes.futures()) {
        *units = before;
        let difference = |input: &Input| input.value - present[usize::from(input.index)];
        let terms = inputs.iter().map(|input| (difference(input), &layers.grid[usize::from(input.index)]));
        add_rows(units, terms, machine);
        tanh_all(&mut units.0, machine);
    }
    let blocks = work.hidden.as_chunks::<BLOCK>().0.iter().zip(work.shared.as_chunks_mut().0);
    for (hidden, shared) in blocks.take(changes.futures().len().div_ceil(BLOCK)) {
        machine.multiply(hidden, &layers.place, shared);
    }
    for (units, (future, steps, field)) in work.place.iter_mut().zip(changes.places()) {
        *units = work.shared[future];
        let heights = steps.iter().map(|step| step.height);
        let rises = std::iter::once(0.0).chain(heights.clone()).zip(heights).map(|(below, height)| height - below);
        let border = rises.zip(steps.iter().map(|step| &layers.border[usize::from(step.from)]));
        add_rows(units, std::iter::once((1.0, &layers.fields[field])).chain(border), machine);
        tanh_all(&mut units.0, machine);
    }
    let blocks = work.place.as_chunks::<BLOCK>().0.iter().zip(work.third.as_chunks_mut().0);
    for ((place, third), values) in blocks.zip(work.values.as_chunks_mut().0).take(changes.len().div_ceil(BLOCK)) {
        *third = [layers.third_bias; BLOCK];
        add_product(place, &layers.third, third, machine);
        third.iter_mut().for_each(|units| tanh_all(&mut units.0, machine));
        last_layers(layers, third, values, machine);
    }
}

/// Adds rows, each with its factor, one after another.
#[inline(always)]
fn add_rows<'a>(
    units: &mut Row<UNITS>,
    terms: impl Iterator<Item = (f32, &'a Row<UNITS>)> + Clone,
    machine: impl Arithmetic,
) {
    for first in (0..UNITS).step_by(SPAN) {
        let mut sums = [0.0; SPAN];
        sums.copy_from_slice(&units.0[first..first + SPAN]);
        for (factor, row) in terms.clone() {
            for (sum, weight) in sums.iter_mut().zip(&row.0[first..first + SPAN]) {
                *sum = machine.fma(factor, *weight, *sum);
            }
        }
        units.0[first..first + SPAN].copy_from_slice(&sums);
    }
}

/// Adds the matrix product of some inputs with the weights.
#[inline(always)]
fn add_product<const N: usize>(
    inputs: &[Row<UNITS>; BLOCK],
    weights: &[Row<N>],
    outputs: &mut [Row<N>; BLOCK],
    machine: impl Arithmetic,
) {
    for first in (0..N).step_by(LANES) {
        let mut sums = [[0.0; LANES]; BLOCK];
        for (sums, output) in sums.iter_mut().zip(&*outputs) {
            sums.copy_from_slice(&output.0[first..first + LANES]);
        }
        for (k, weights) in (0..UNITS).zip(weights) {
            let mut lanes = [0.0; LANES];
            lanes.copy_from_slice(&weights.0[first..first + LANES]);
            for (sums, input) in sums.iter_mut().zip(inputs) {
                let factor = input.0[k];
                for (sum, weight) in sums.iter_mut().zip(lanes) {
                    *sum = machine.fma(factor, weight, *sum);
                }
            }
        }
        for (output, sums) in outputs.iter_mut().zip(sums) {
            output.0[first..first + LANES].copy_from_slice(&sums);
        }
    }
}

/// From the third layer's units to values. The candidates take turns, since each sum waits for itself.
#[inline(always)]
fn last_layers(layers: &Layers, third: &[Row<THIRD>; BLOCK], values: &mut [f32; BLOCK], machine: impl Arithmetic) {
    let mut fourth = [layers.fourth_bias; BLOCK];
    for (k, weights) in layers.fourth.iter().enumerate() {
        for (units, third) in fourth.iter_mut().zip(third) {
            units.iter_mut().zip(weights).for_each(|(unit, &weight)| *unit = machine.fma(third.0[k], weight, *unit));
        }
    }
    tanh_all(fourth.as_flattened_mut(), machine);
    for (value, units) in values.iter_mut().zip(fourth) {
        let terms = units.iter().zip(&layers.value);
        *value = terms.fold(layers.value_bias, |sum, (&unit, &weight)| machine.fma(unit, weight, sum));
    }
}

#[inline(always)]
fn tanh_all(units: &mut [f32], machine: impl Arithmetic) {
    units.iter_mut().for_each(|unit| *unit = tanh(*unit, machine));
}

/// The quotient `x P(x^2) / Q(x^2)` that differs least from tanh up to 9, where tanh is 1 in this precision. What is
/// not a number stays so.
#[inline(always)]
fn tanh(x: f32, machine: impl Arithmetic) -> f32 {
    let x = x.clamp(-9.0, 9.0);
    let s = x * x;
    let fma = |a, b, c| machine.fma(a, b, c);
    let polynomial = |[a, b, c, d, e]: [f32; 5]| fma(fma(fma(fma(a, s, b), s, c), s, d), s, e);
    let p = [1.318_763e-8, 2.047_469_4e-5, 3.486_775_3e-3, 0.133_733_67, 0.999_999_9];
    let q = [7.704_174_4e-7, 3.271_687_6e-4, 2.584_273_7e-2, 0.467_066_65, 1.0];
    x * polynomial(p) / polynomial(q)
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;
    use packing::{Draw, WalleWeights, corner_candidates};
    use proptest::prelude::*;

    use super::*;
    use crate::encoding::tests::arb_case;
    use crate::encoding::{Batch, Encoder, Walls};
    use crate::network::Network;

    fn check_tanh(machine: impl Arithmetic) {
        let mut worst = 0.0f64;
        // Every 101st positive number up to 20, then the ends.
        let steps = (0..20.0f32.to_bits()).step_by(101).map(f32::from_bits);
        for x in steps.chain([f32::MAX, f32::INFINITY]) {
            worst = worst.max((f64::from(tanh(x, machine)) - f64::from(x).tanh()).abs());
            assert_eq!(tanh(-x, machine), -tanh(x, machine));
        }
        assert!(worst < 4e-7, "{worst:e}");
        assert!(tanh(f32::NAN, machine).is_nan());
    }

    #[test]
    fn tanh_keeps_its_bound() {
        check_tanh(Least);
        #[cfg(target_arch = "x86_64")]
        check_tanh(Fused32);
    }

    /// An untrained network with biases, or one whose weights are as large as a long training makes them.
    fn weights(seed: u64, scale: f32) -> Weights {
        let mut draw = Draw::new(0, seed, 0);
        let mut layers = Weights::untrained(Architecture::Published, &mut draw).layers().to_vec();
        for layer in &mut layers {
            layer.weight.iter_mut().for_each(|weight| *weight *= scale);
            layer.bias.iter_mut().for_each(|bias| *bias = draw.unit() as f32 - 0.5);
        }
        Weights::new(Architecture::Published, layers).unwrap()
    }

    fn best(values: &[f32]) -> usize {
        (0..values.len()).reduce(|best, index| if values[index] > values[best] { index } else { best }).unwrap()
    }

    proptest! {
        #[test]
        fn values_are_burns_and_the_same_bits_wherever_products_are_fused(
            (grid, spec) in arb_case(),
            seed in 0u64..4,
            scale in prop_oneof![Just(1.0f32), Just(3.0)],
            full in any::<bool>(),
        ) {
            let extent = spec.extent(grid.size().cell_mm());
            let (mut candidates, mut batch) = (Vec::new(), Batch::default());
            corner_candidates(&grid, extent, &WalleWeights::PAPER, &mut candidates);
            if candidates.is_empty() {
                return Ok(());
            }
            let weights = weights(seed, scale);
            let mut encoder = Encoder::new(if full { Walls::Full } else { Walls::Empty });
            encoder.encode(&grid, extent, &candidates, &mut batch);
            let device = Device::flex();
            let expected = Network::new(&weights, &device).unwrap().values(&batch, &device).unwrap();

            let mut fused = Fused::new(&weights).unwrap();
            let changes = encoder.changes(&grid, extent, &candidates);
            // The larger weights give values of some size, which have no more digits than others.
            let bound = 1e-5 * expected.iter().fold(1.0f32, |largest, value| largest.max(value.abs()));
            let bits = |values: &[f32]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
            let (mut widest, mut chosen, mut fused_bits) = (Vec::new(), 0, None);
            for width in Width::available() {
                fused.width = width;
                let values = fused.values(changes).to_vec();
                for (value, expected) in values.iter().zip(&expected) {
                    prop_assert!((value - expected).abs() < bound, "{:?}: {} and not {}", width, value, expected);
                }
                let burns = best(&expected);
                chosen = best(&values);
                let is_tie = expected[burns] - expected[chosen] < 2.0 * bound;
                prop_assert!(chosen == burns || is_tie, "{:?}: {} and not {}", width, chosen, burns);
                if width != Width::Least {
                    prop_assert!(fused_bits.as_ref().is_none_or(|known| *known == bits(&values)), "{:?}", width);
                    fused_bits = Some(bits(&values));
                }
                widest = values;
            }
            // The other candidates have no part in a value.
            let alone = encoder.changes(&grid, extent, &candidates[chosen..=chosen]);
            prop_assert_eq!(bits(fused.values(alone)), bits(&widest[chosen..=chosen]));
        }
    }

    #[test]
    fn another_architecture_is_refused() {
        assert!(Fused::new(&Weights::untrained(Architecture::Moves, &mut Draw::new(0, 0, 0))).is_none());
    }
}
