//! How a camera above the containers sees them.

use crate::Truth;
use crate::errors::{Of, PixelNoise, draw, normal};

/// Side of a pixel on the floor [mm]. A cell of the paper's grid has four of them.
pub(crate) const PIXEL_MM: f64 = 5.0;

/// How well a camera sees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Optics {
    /// Frames of one look, 1 to [`Optics::FRAMES_MAX`].
    pub frames: usize,
    /// Standard deviation of the heights, pixel by pixel and frame by frame [mm].
    pub height_mm: f64,
    /// Standard deviation of where a whole look lies along each axis [mm]; no error exceeds three of them.
    pub shift_mm: f64,
    /// Share of the pixels that see nothing, frame by frame [-].
    pub dropout_share: f64,
    /// What is wrong with it, and from which box on.
    pub fault: Fault,
    /// The first box that is looked at with the fault.
    pub fault_from: u64,
    /// So many looks later it is well again; 0 for never.
    pub fault_looks: u64,
}

/// What can be wrong with a camera.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Fault {
    /// Nothing.
    #[default]
    None,
    /// Its heights are no numbers.
    NotANumber,
    /// Its heights are infinite.
    Infinite,
    /// Its frames have a row too few.
    WrongSize,
    /// It says the last frame again.
    Frozen,
    /// It says nothing.
    Away,
}

/// What a camera says of one container.
#[derive(Clone, Copy, Debug)]
pub struct Look<'a> {
    /// Pixels of a frame along `x` and along `y`.
    pub pixels: [usize; 2],
    /// Heights [mm], frame by frame, row by row along `x`; NaN where nothing was seen.
    ///
    /// # Shape
    /// `[frames, pixels[0], pixels[1]]`
    pub heights_mm: &'a [f32],
}

/// A camera that sees the truth, more or less.
#[derive(Clone, Debug)]
pub struct Camera {
    optics: Optics,
    seed: u64,
    faulty_looks: u64,
    heights_mm: Vec<f32>,
    exact_mm: Vec<f32>,
}

impl Optics {
    /// Most frames of one look.
    pub const FRAMES_MAX: usize = 9;
}

impl Camera {
    /// A camera with these optics, whose errors the seed fixes.
    #[must_use]
    pub fn new(optics: Optics, seed: u64) -> Self {
        let optics = Optics { frames: optics.frames.clamp(1, Optics::FRAMES_MAX), ..optics };
        Self { optics, seed, faulty_looks: 0, heights_mm: Vec::new(), exact_mm: Vec::new() }
    }

    /// Looks at the container of `slot` after `box_id` was set down there; nothing if the camera is away.
    pub fn look(&mut self, truth: &Truth, slot: u16, box_id: u64) -> Option<Look<'_>> {
        let Optics { fault_from, fault_looks, .. } = self.optics;
        let is_faulty = box_id >= fault_from && (fault_looks == 0 || self.faulty_looks < fault_looks);
        self.faulty_looks += u64::from(is_faulty);
        let fault = if is_faulty { self.optics.fault } else { Fault::None };
        let [rows, columns] = truth.inner_mm().map(|mm| (mm / PIXEL_MM).ceil() as usize);
        let frame = rows * columns;
        let mut pixels = [rows, columns];
        match fault {
            Fault::Away => return None,
            Fault::Frozen if self.heights_mm.len() == frame * self.optics.frames => {}
            Fault::None | Fault::Frozen => self.take(truth, slot, box_id, pixels),
            Fault::NotANumber => self.fill(frame, f32::NAN),
            Fault::Infinite => self.fill(frame, f32::INFINITY),
            Fault::WrongSize => {
                pixels[0] -= 1;
                self.fill(pixels[0] * columns, 0.0);
            }
        }
        Some(Look { pixels, heights_mm: &self.heights_mm })
    }

    fn fill(&mut self, frame: usize, height_mm: f32) {
        self.heights_mm.clear();
        self.heights_mm.resize(frame * self.optics.frames, height_mm);
    }

    fn take(&mut self, truth: &Truth, slot: u16, box_id: u64, pixels: [usize; 2]) {
        let Optics { frames, height_mm, shift_mm, dropout_share, .. } = self.optics;
        let mut draw = draw(Of::Look, self.seed, box_id);
        let shift = [shift_mm * normal(&mut draw), shift_mm * normal(&mut draw)];
        self.see(truth, slot, pixels, shift);
        let mut noise = PixelNoise::new(&mut draw);
        let dropped_below = (dropout_share * 65_536.0) as u16;
        self.heights_mm.clear();
        for _ in 0..frames {
            self.heights_mm.extend(self.exact_mm.iter().map(|exact_mm| {
                let (error, chance) = noise.next();
                if chance < dropped_below { f32::NAN } else { exact_mm + error * height_mm as f32 }
            }));
        }
    }

    /// The heights under the middles of all pixels, the whole look being shifted.
    fn see(&mut self, truth: &Truth, slot: u16, [rows, columns]: [usize; 2], shift_mm: [f64; 2]) {
        self.exact_mm.clear();
        self.exact_mm.resize(rows * columns, 0.0);
        let middle = |pixel: usize, axis: usize| (pixel as f64 + 0.5) * PIXEL_MM - shift_mm[axis];
        for standing in truth.slots().get(usize::from(slot)).into_iter().flatten() {
            let [low, high] = standing.bounds_mm();
            let first = |axis: usize| ((low[axis] + shift_mm[axis]) / PIXEL_MM).floor().max(0.0) as usize;
            let end = |axis: usize, limit: usize| {
                (((high[axis] + shift_mm[axis]) / PIXEL_MM).ceil().max(0.0) as usize).min(limit)
            };
            for row in first(0)..end(0, rows) {
                for column in first(1)..end(1, columns) {
                    let seen = &mut self.exact_mm[row * columns + column];
                    if standing.covers(middle(row, 0), middle(column, 1)) {
                        *seen = seen.max(standing.top_mm as f32);
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use packing::{BoxSpec, ContainerSize, Placement, Yaw};

    use super::*;
    use crate::Imperfections;

    const SHARP: Optics = Optics {
        frames: 3,
        height_mm: 0.0,
        shift_mm: 0.0,
        dropout_share: 0.0,
        fault: Fault::None,
        fault_from: 0,
        fault_looks: 0,
    };

    fn truth() -> Truth {
        let mut truth = Truth::new(Imperfections::default(), ContainerSize::new(4, 6, 9, 10).unwrap(), 1);
        let spec = BoxSpec::new(1, [20, 30, 50]).unwrap();
        truth.set_down(&spec, spec.extent(10), Placement { slot: 0, yaw: Yaw::Deg0, i: 1, j: 2, base: 0 });
        truth
    }

    #[test]
    fn a_sharp_camera_sees_the_truth() {
        let (truth, mut camera) = (truth(), Camera::new(SHARP, 1));
        let look = camera.look(&truth, 0, 1).unwrap();
        assert_eq!((look.pixels, look.heights_mm.len()), ([8, 12], 3 * 96));
        for (at, &seen) in look.heights_mm.iter().enumerate() {
            let (row, column) = (at % 96 / 12, at % 12);
            let inside = (2..6).contains(&row) && (4..10).contains(&column);
            assert_eq!(seen, if inside { 50.0 } else { 0.0 }, "row {row}, column {column}");
        }
    }

    #[test]
    fn noise_and_drop_outs_are_as_stated_and_fixed_by_the_box() {
        let truth = truth();
        let optics = Optics { frames: 9, height_mm: 2.0, dropout_share: 0.1, ..SHARP };
        let seen = |box_id| Camera::new(optics, 1).look(&truth, 0, box_id).unwrap().heights_mm.to_vec();
        let bits = |heights: Vec<f32>| heights.into_iter().map(f32::to_bits).collect::<Vec<_>>();
        assert_eq!(bits(seen(1)), bits(seen(1)));
        assert_ne!(bits(seen(1)), bits(seen(2)));
        let holes = seen(1).iter().filter(|height| height.is_nan()).count();
        assert!((50..130).contains(&holes), "{holes} of {}", 9 * 96);
        assert!(seen(1).iter().all(|height| height.is_nan() || *height < 7.1 || (*height - 50.0).abs() < 7.1));
    }

    #[test]
    fn faults_begin_at_their_box() {
        let truth = truth();
        type Check = fn(Option<Look<'_>>) -> bool;
        for (fault, is_bad) in [
            (Fault::NotANumber, (|look| look.unwrap().heights_mm[0].is_nan()) as Check),
            (Fault::Infinite, |look| look.unwrap().heights_mm[0].is_infinite()),
            (Fault::WrongSize, |look| look.unwrap().pixels == [7, 12]),
            (Fault::Away, |look| look.is_none()),
        ] {
            let mut camera = Camera::new(Optics { fault, fault_from: 5, fault_looks: 2, ..SHARP }, 1);
            let is_well = |look: Option<Look<'_>>| look.is_some_and(|look| look.heights_mm[0] == 0.0);
            assert!(is_well(camera.look(&truth, 0, 4)));
            assert!(is_bad(camera.look(&truth, 0, 5)), "{fault:?}");
            assert!(is_bad(camera.look(&truth, 0, 6)), "{fault:?}");
            assert!(is_well(camera.look(&truth, 0, 7)), "{fault:?} is over");
        }
    }
}
