//! A line of points over any time, in bounded memory.

/// Most points that a line keeps; beyond, every second one goes and the rest are taken half as often.
pub(crate) const POINTS_MAX: usize = 512;

/// Points that came at a steady beat, of which the line keeps some.
#[derive(Clone, Debug)]
pub(crate) struct Series<T> {
    points: Vec<T>,
    /// One point in so many is kept.
    stride: u64,
    seen: u64,
}

impl<T> Default for Series<T> {
    fn default() -> Self {
        Self { points: Vec::new(), stride: 1, seen: 0 }
    }
}

impl<T> Series<T> {
    /// One more point.
    pub(crate) fn push(&mut self, point: T) {
        if self.seen.is_multiple_of(self.stride) {
            if self.points.len() == POINTS_MAX {
                let mut index = 0;
                self.points.retain(|_| {
                    index += 1;
                    index % 2 == 1
                });
                self.stride *= 2;
            }
            // After thinning this point may be one that the longer stride skips.
            if self.seen.is_multiple_of(self.stride) {
                self.points.push(point);
            }
        }
        self.seen += 1;
    }

    /// The points that were kept, oldest first.
    pub(crate) fn points(&self) -> &[T] {
        &self.points
    }
}

/// Growth per unit of x of the straight line through the points (least squares); nothing for fewer than three.
pub(crate) fn slope(points: &[(f64, f64)]) -> Option<f64> {
    if points.len() < 3 {
        return None;
    }
    let count = points.len() as f64;
    let (mean_x, mean_y) = points.iter().fold((0.0, 0.0), |(sum_x, sum_y), (x, y)| (sum_x + x, sum_y + y));
    let (mean_x, mean_y) = (mean_x / count, mean_y / count);
    let covariance: f64 = points.iter().map(|(x, y)| (x - mean_x) * (y - mean_y)).sum();
    let variance: f64 = points.iter().map(|(x, _)| (x - mean_x).powi(2)).sum();
    (variance > 0.0).then(|| covariance / variance)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_keeps_few_points_at_a_steady_beat() {
        let mut series = Series::default();
        (0..5000_u32).for_each(|point| series.push(point));
        let points = series.points();
        assert!((POINTS_MAX / 2..=POINTS_MAX).contains(&points.len()), "{}", points.len());
        assert!(points.windows(2).all(|pair| pair[1] - pair[0] == 16), "{points:?}");
        assert_eq!(points[0], 0);
    }

    #[test]
    fn a_leak_is_a_slope() {
        assert_eq!(slope(&[(0.0, 5.0), (1.0, 7.0), (2.0, 9.0)]), Some(2.0));
        assert_eq!(slope(&[(0.0, 5.0), (1.0, 5.0), (2.0, 5.0)]), Some(0.0));
        assert_eq!(slope(&[(0.0, 5.0), (1.0, 7.0)]), None);
    }
}
