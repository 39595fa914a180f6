//! Command and measurement into the heights that are believed.
//!
//! The rules, in this order:
//!
//! 1. A look is trusted if it is there, has the right size, is not the look before it bit by bit, and sees at least
//!    [`SEEN_SHARE_MIN`] of all pixels; infinite heights count as not seen. Else the command is believed.
//! 2. Frames are filtered pixel by pixel: the median of what was seen around the box, and everywhere else whether more
//!    than half of the frames agree. No single frame changes the belief.
//! 3. The pixels that rose by at least half the box's height are the box; their middle is where it stands. Fewer than
//!    half as many as it has: it is missing, and the heights before it are believed again.
//! 4. A box no farther than the tolerance from where it was commanded to stands there, exactly: its whole room (with its
//!    clearance) has the commanded height, so that flat stays flat. A farther one takes the cells that its room reaches
//!    by more than the tolerance and leaves those that its room has left by more than that.
//! 5. Heights only rise by measurement (but for rule 3): what is rounded up in the belief lies lower in the world. A
//!    top more than a tolerance above what was commanded is believed as measured, rounded up; a cell all of whose pixels
//!    lie more than a tolerance above everything that is believed within the tolerance of it likewise. If no neighbour is
//!    that high, something foreign lies there.

use std::ops::Range;

use packing::{ContainerSize, Extent, Placement};

use crate::Look;
use crate::camera::{Optics, PIXEL_MM};

/// A look that sees less than this share of its pixels is not trusted [-].
pub(crate) const SEEN_SHARE_MIN: f64 = 0.5;

/// How far around a box's room its pixels are searched [cells].
const REACH_CELLS: u16 = 3;

/// The box that was set down since the last look at its container.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Commanded {
    /// The box.
    pub box_id: u64,
    /// Where it was to stand.
    pub placement: Placement,
    /// Its room, already turned [cells].
    pub room: Extent,
    /// Its sides along `x`, `y` and `z`, already turned [mm].
    pub sides_mm: [u32; 3],
}

/// What became of a look.
#[derive(Clone, Debug, PartialEq)]
pub struct Fused {
    /// Whether other heights are believed than those that were commanded.
    pub is_corrected: bool,
    /// From where the box was to stand to where it was seen, along `x` and `y` [mm]; nothing if it was not seen.
    pub offset_mm: Option<[f64; 2]>,
    /// What cannot be explained by anything that was commanded.
    pub irreconcilable: Option<Irreconcilable>,
}

/// Why a look is not trusted.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Blind {
    /// There is none.
    #[error("the camera says nothing")]
    Away,
    /// Its frames are not as large as the container.
    #[error("the camera's frames are {found:?} pixels, not {expected:?}")]
    WrongSize {
        /// Pixels along `x` and `y`.
        found: [usize; 2],
        /// Pixels along `x` and `y`.
        expected: [usize; 2],
    },
    /// It is the look before.
    #[error("the camera is frozen: it says the look before again")]
    Frozen,
    /// Too much of it is missing, no number or infinite.
    #[error("the camera sees only {0} % of the container")]
    Holes(u32),
}

/// What no command explains.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Irreconcilable {
    /// The box is not there.
    #[error("box {box_id} is missing from slot {slot}, where the arm says that it put it")]
    Missing {
        /// The box.
        box_id: u64,
        /// Where it should be.
        slot: u16,
    },
    /// Something is there.
    #[error("something foreign lies in slot {slot} at cell ({i}, {j}), {cells} cells high")]
    Foreign {
        /// Where it lies.
        slot: u16,
        /// The first of its cells.
        i: u16,
        /// The first of its cells.
        j: u16,
        /// Its height [cells].
        cells: u16,
    },
}

/// What a cell knows of its containers beyond the grid: what was seen of them last.
#[derive(Clone, Debug)]
pub struct Fusion {
    size: ContainerSize,
    tolerance_mm: f64,
    pixels: [usize; 2],
    /// The filtered heights [mm] by slot; NaN where nothing was seen since the container came or the process began.
    seen_mm: Vec<Vec<f32>>,
    /// Checksum of the look before.
    last_look: Option<u64>,
    limits_mm: Vec<f32>,
    agreeing: Vec<u32>,
    sorted_mm: Vec<f32>,
    median_mm: Vec<f32>,
}

impl Fusion {
    /// Nothing was seen yet of `slots` containers. Boxes that stand no farther than the tolerance from where they were
    /// commanded to are believed to stand there.
    #[must_use]
    pub fn new(size: ContainerSize, slots: usize, tolerance_mm: f64) -> Self {
        let pixels = [size.length(), size.breadth()]
            .map(|cells| (f64::from(cells) * f64::from(size.cell_mm()) / PIXEL_MM).ceil() as usize);
        let seen_mm = vec![vec![f32::NAN; pixels[0] * pixels[1]]; slots];
        let (limits_mm, agreeing, sorted_mm, median_mm) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        Self { size, tolerance_mm, pixels, seen_mm, last_look: None, limits_mm, agreeing, sorted_mm, median_mm }
    }

    /// The container of this slot left, and an empty one came.
    pub fn replace(&mut self, slot: u16) {
        if let Some(seen_mm) = self.seen_mm.get_mut(usize::from(slot)) {
            seen_mm.fill(f32::NAN);
        }
    }

    /// Fuses a look at a container with the box that was set down in it. `before` are its heights before the box [cells];
    /// `heights` are those with the box as commanded, and those that are believed afterwards.
    ///
    /// # Errors
    /// [`Blind`] if the look is not trusted; `heights` stay as they were commanded.
    ///
    /// # Panics
    /// If there is no such slot, or there are not as many heights as the container has cells.
    pub fn fuse(
        &mut self,
        look: Option<Look<'_>>,
        commanded: &Commanded,
        before: &[u16],
        heights: &mut [u16],
    ) -> Result<Fused, Blind> {
        let look = self.check(look)?;
        let window = self.window(commanded);
        self.filter(&look, &window);
        let pose = self.find_box(commanded, &window, before);
        let mut fused = Fused { is_corrected: false, offset_mm: None, irreconcilable: None };
        match pose {
            Some((offset_mm, top_mm)) => {
                fused.offset_mm = Some(offset_mm);
                fused.is_corrected = self.set_box(commanded, offset_mm, top_mm, before, heights);
            }
            None => {
                let Commanded { box_id, placement: Placement { slot, .. }, .. } = *commanded;
                fused.irreconcilable = Some(Irreconcilable::Missing { box_id, slot });
                fused.is_corrected = true;
                heights.copy_from_slice(before);
            }
        }
        if let Some(rest) = self.raise_rest(&look, commanded, heights) {
            fused.is_corrected = true;
            fused.irreconcilable = fused.irreconcilable.or(rest);
        }
        self.remember(commanded.placement.slot, &window);
        Ok(fused)
    }

    /// Rule 1.
    fn check<'a>(&mut self, look: Option<Look<'a>>) -> Result<Look<'a>, Blind> {
        let look = look.ok_or(Blind::Away)?;
        let (frame, count) = (self.pixels[0] * self.pixels[1], look.heights_mm.len());
        let is_whole = count > 0 && count.is_multiple_of(frame) && count / frame <= Optics::FRAMES_MAX;
        if look.pixels != self.pixels || !is_whole {
            return Err(Blind::WrongSize { found: look.pixels, expected: self.pixels });
        }
        // Counted in the width of the heights, so that the compiler takes several at once.
        let finite = |part: &[f32]| part.iter().map(|height| u32::from(height.is_finite())).sum::<u32>();
        let seen: usize = look.heights_mm.chunks(4096).map(|part| finite(part) as usize).sum();
        if (seen as f64) < SEEN_SHARE_MIN * count as f64 {
            return Err(Blind::Holes((100 * seen / count) as u32));
        }
        let sum = checksum(&look.heights_mm[..frame]);
        if self.last_look.replace(sum) == Some(sum) {
            return Err(Blind::Frozen);
        }
        Ok(look)
    }

    /// The cells around a box's room.
    fn window(&self, commanded: &Commanded) -> [Range<u16>; 2] {
        let Commanded { placement, room, .. } = commanded;
        let around = |first: u16, cells: u16, limit: u16| {
            first.saturating_sub(REACH_CELLS)..(first + cells).saturating_add(REACH_CELLS).min(limit)
        };
        [around(placement.i, room.length, self.size.length()), around(placement.j, room.breadth, self.size.breadth())]
    }

    fn pixels_of(&self, cells: &Range<u16>, axis: usize) -> Range<usize> {
        let cell_mm = f64::from(self.size.cell_mm());
        let first = (f64::from(cells.start) * cell_mm / PIXEL_MM).round() as usize;
        let end = (f64::from(cells.end) * cell_mm / PIXEL_MM).round() as usize;
        first.min(self.pixels[axis])..end.min(self.pixels[axis])
    }

    fn cell_of(&self, pixel: usize, axis: usize) -> usize {
        let cells = [self.size.length(), self.size.breadth()][axis];
        let cell = ((pixel as f64 + 0.5) * PIXEL_MM / f64::from(self.size.cell_mm())) as usize;
        cell.min(usize::from(cells) - 1)
    }

    /// Rule 2 in the window: the median over the frames of every pixel, NaN where most frames saw nothing.
    fn filter(&mut self, look: &Look<'_>, window: &[Range<u16>; 2]) {
        let frame = self.pixels[0] * self.pixels[1];
        let frames = look.heights_mm.len() / frame;
        let columns = self.pixels_of(&window[1], 1);
        let width = columns.len();
        self.median_mm.clear();
        for row in self.pixels_of(&window[0], 0) {
            let first = row * self.pixels[1] + columns.start;
            let seen = |index: usize| &look.heights_mm[index * frame + first..][..width];
            self.sorted_mm.clear();
            (0..frames).for_each(|index| self.sorted_mm.extend_from_slice(seen(index)));
            // Whole rows are compared and exchanged, so that the compiler takes several pixels at once.
            for last in (1..frames).rev() {
                for index in 0..last {
                    let (low, high) = self.sorted_mm[index * width..].split_at_mut(width);
                    for (low, high) in low.iter_mut().zip(high) {
                        let (a, b) = (*low, *high);
                        (*low, *high) = if a < b { (a, b) } else { (b, a) };
                    }
                }
            }
            for column in 0..width {
                // A sum is finite if all of it is.
                let all: f32 = (0..frames).map(|index| seen(index)[column]).sum();
                let median = if all.is_finite() {
                    self.sorted_mm[frames / 2 * width + column]
                } else {
                    median((0..frames).map(|index| seen(index)[column]), frames)
                };
                self.median_mm.push(median);
            }
        }
    }

    /// Rule 3: where the box stands (from where it was to stand) and how high its top is [mm]; nothing if it is not there.
    fn find_box(&self, commanded: &Commanded, window: &[Range<u16>; 2], before: &[u16]) -> Option<([f64; 2], f64)> {
        let cell_mm = f64::from(self.size.cell_mm());
        let Commanded { placement, room, sides_mm, .. } = commanded;
        let [length_mm, breadth_mm, height_mm] = sides_mm.map(f64::from);
        let seen_mm = &self.seen_mm[usize::from(placement.slot)];
        let (mut count, mut sum, mut tops_mm) = (0_usize, [0.0; 2], 0.0);
        let mut medians = self.median_mm.iter();
        for row in self.pixels_of(&window[0], 0) {
            let cells = &before[self.cell_of(row, 0) * usize::from(self.size.breadth())..];
            for (column, &median) in self.pixels_of(&window[1], 1).zip(&mut medians) {
                // What was believed is rounded up, so what was seen is the better measure of what rose.
                let seen = f64::from(seen_mm[row * self.pixels[1] + column]);
                let was_mm = if seen.is_nan() { f64::from(cells[self.cell_of(column, 1)]) * cell_mm } else { seen };
                let is_box = f64::from(median) >= was_mm + height_mm / 2.0;
                if is_box {
                    count += 1;
                    sum = [sum[0] + row as f64, sum[1] + column as f64];
                    tops_mm += f64::from(median);
                }
            }
        }
        let expected = length_mm * breadth_mm / (PIXEL_MM * PIXEL_MM);
        if (count as f64) < expected / 2.0 {
            return None;
        }
        let middle = |first: u16, cells: u16| (f64::from(first) + f64::from(cells) / 2.0) * cell_mm;
        let meant = [middle(placement.i, room.length), middle(placement.j, room.breadth)];
        let found = sum.map(|sum| (sum / count as f64 + 0.5) * PIXEL_MM);
        Some(([found[0] - meant[0], found[1] - meant[1]], tops_mm / count as f64))
    }

    /// Rules 4 and 5 for the box; whether other heights are believed than those that were commanded.
    fn set_box(
        &self,
        commanded: &Commanded,
        offset_mm: [f64; 2],
        top_mm: f64,
        before: &[u16],
        heights: &mut [u16],
    ) -> bool {
        let Commanded { placement, room, .. } = commanded;
        let cell_mm = f64::from(self.size.cell_mm());
        let planned = placement.base + room.height;
        let is_higher = top_mm > f64::from(planned) * cell_mm + self.tolerance_mm;
        let top = if is_higher { (top_mm / cell_mm).ceil().min(f64::from(u16::MAX)) as u16 } else { planned };
        let shifted = |first: u16, cells: u16, limit: u16, offset_mm: f64| {
            let beyond_mm = (offset_mm.abs() - self.tolerance_mm).max(0.0);
            if beyond_mm == 0.0 {
                return first..first + cells;
            }
            let taken = (beyond_mm / cell_mm).ceil() as u16;
            let left = ((beyond_mm / cell_mm) as u16).min(cells - 1);
            if offset_mm > 0.0 {
                first + left..(first + cells).saturating_add(taken).min(limit)
            } else {
                first.saturating_sub(taken)..first + cells - left
            }
        };
        let rows = shifted(placement.i, room.length, self.size.length(), offset_mm[0]);
        let columns = shifted(placement.j, room.breadth, self.size.breadth(), offset_mm[1]);
        let commanded_rows = placement.i..placement.i + room.length;
        let commanded_columns = placement.j..placement.j + room.breadth;
        if top == planned && rows == commanded_rows && columns == commanded_columns {
            return false;
        }
        let breadth = usize::from(self.size.breadth());
        let range = |i: u16, columns: &Range<u16>| {
            usize::from(i) * breadth + usize::from(columns.start)..usize::from(i) * breadth + usize::from(columns.end)
        };
        for i in commanded_rows {
            let cells = range(i, &commanded_columns);
            heights[cells.clone()].copy_from_slice(&before[cells]);
        }
        for i in rows {
            heights[range(i, &columns)].iter_mut().for_each(|height| *height = (*height).max(top));
        }
        true
    }

    /// Rule 5 for everything else. Something if a cell was raised: what is foreign, if anything is.
    fn raise_rest(
        &mut self,
        look: &Look<'_>,
        commanded: &Commanded,
        heights: &mut [u16],
    ) -> Option<Option<Irreconcilable>> {
        let (length, breadth) = (usize::from(self.size.length()), usize::from(self.size.breadth()));
        let cell_mm = f64::from(self.size.cell_mm());
        let [rows, columns] = self.pixels;
        let tolerance_mm = self.tolerance_mm.max(cell_mm);
        let limit_mm = |cells: u16| (f64::from(cells) * cell_mm + tolerance_mm) as f32;
        let frame = rows * columns;
        let frames = look.heights_mm.len() / frame;
        let columns_per_cell = columns / breadth;
        let is_even = columns_per_cell * breadth == columns;
        self.limits_mm.resize(columns, 0.0);
        self.agreeing.resize(columns, 0);
        // The pixels of a cell that are not above it; a cell is raised if there are none.
        let mut raised: Option<Option<Irreconcilable>> = None;
        let mut is_above = vec![true; breadth];
        for i in 0..length {
            is_above.fill(true);
            let cells = &heights[i * breadth..(i + 1) * breadth];
            if is_even {
                for (limits, &cell) in self.limits_mm.chunks_exact_mut(columns_per_cell).zip(cells) {
                    limits.fill(limit_mm(cell));
                }
            } else {
                for column in 0..columns {
                    self.limits_mm[column] = limit_mm(heights[i * breadth + self.cell_of(column, 1)]);
                }
            }
            let mut any = false;
            for row in self.pixels_of(&(i as u16..i as u16 + 1), 0) {
                self.agreeing.fill(0);
                for index in 0..frames {
                    let pixels = &look.heights_mm[index * frame + row * columns..][..columns];
                    for ((above, &height), &limit) in self.agreeing.iter_mut().zip(pixels).zip(&self.limits_mm) {
                        *above += u32::from(height > limit);
                    }
                }
                any = self.agreeing.iter().any(|&above| 2 * above > frames as u32);
                if !any {
                    break;
                }
                for column in 0..columns {
                    if 2 * self.agreeing[column] <= frames as u32 {
                        is_above[self.cell_of(column, 1)] = false;
                    }
                }
            }
            if !any {
                continue;
            }
            for j in (0..breadth).filter(|&j| is_above[j]) {
                let found = self.cell_height(look, i, j);
                if self.is_explained(heights, i, j, found) {
                    continue;
                }
                let near = [(i.wrapping_sub(1), j), (i + 1, j), (i, j.wrapping_sub(1)), (i, j + 1)];
                let is_level = near
                    .into_iter()
                    .any(|(i, j)| i < length && j < breadth && heights[i * breadth + j].abs_diff(found) <= 1);
                heights[i * breadth + j] = found.max(heights[i * breadth + j]);
                let (slot, i, j) = (commanded.placement.slot, i as u16, j as u16);
                let foreign = (!is_level).then_some(Irreconcilable::Foreign { slot, i, j, cells: found });
                raised = Some(raised.flatten().or(foreign));
            }
        }
        raised
    }

    /// Whether something as high is believed to lie within the tolerance.
    fn is_explained(&self, heights: &[u16], i: usize, j: usize, found: u16) -> bool {
        let reach = (self.tolerance_mm / f64::from(self.size.cell_mm())) as usize;
        let (length, breadth) = (usize::from(self.size.length()), usize::from(self.size.breadth()));
        let around = |at: usize, limit: usize| at.saturating_sub(reach)..(at + reach + 1).min(limit);
        reach > 0
            && around(i, length)
                .any(|i| around(j, breadth).any(|j| heights[i * breadth + j].saturating_add(1) >= found))
    }

    /// The height of a cell by the median of all its pixels in all frames, rounded up [cells].
    fn cell_height(&self, look: &Look<'_>, i: usize, j: usize) -> u16 {
        let frame = self.pixels[0] * self.pixels[1];
        let cell = |at: usize| at as u16..at as u16 + 1;
        let mut values: Vec<f32> = Vec::new();
        for row in self.pixels_of(&cell(i), 0) {
            for column in self.pixels_of(&cell(j), 1) {
                let pixels = look.heights_mm[row * self.pixels[1] + column..].iter().step_by(frame);
                values.extend(pixels.filter(|height| height.is_finite()));
            }
        }
        values.sort_unstable_by(f32::total_cmp);
        let median = values.get(values.len() / 2).copied().unwrap_or(0.0);
        // A tenth of a cell above a whole one is the camera's noise and no other cell.
        (f64::from(median) / f64::from(self.size.cell_mm()) - 0.1).ceil().clamp(0.0, f64::from(u16::MAX)) as u16
    }

    fn remember(&mut self, slot: u16, window: &[Range<u16>; 2]) {
        let (rows, columns) = (self.pixels_of(&window[0], 0), self.pixels_of(&window[1], 1));
        let seen_mm = &mut self.seen_mm[usize::from(slot)];
        for (row, medians) in rows.zip(self.median_mm.chunks_exact(columns.len().max(1))) {
            let seen = &mut seen_mm[row * self.pixels[1]..][columns.clone()];
            for (seen, &median) in seen.iter_mut().zip(medians).filter(|(_, median)| !median.is_nan()) {
                *seen = median;
            }
        }
    }
}

/// A number that differs for two frames unless they are the same, or made to deceive. Eight pixels are taken at once.
fn checksum(frame: &[f32]) -> u64 {
    let mut lanes = [0_u32; 8];
    for pixels in frame.chunks(lanes.len()) {
        for (lane, height) in lanes.iter_mut().zip(pixels) {
            *lane = lane.rotate_left(5) ^ height.to_bits();
        }
    }
    lanes.iter().fold(0, |sum, &lane| sum.rotate_left(7) ^ u64::from(lane))
}

/// The median of those heights that are finite; NaN if they are no majority.
fn median(heights: impl Iterator<Item = f32>, frames: usize) -> f32 {
    let mut finite = [0.0; Optics::FRAMES_MAX];
    let mut count = 0;
    for height in heights.filter(|height| height.is_finite()) {
        finite[count] = height;
        count += 1;
    }
    finite[..count].sort_unstable_by(f32::total_cmp);
    if 2 * count > frames { finite[count / 2] } else { f32::NAN }
}

#[cfg(test)]
mod tests;
