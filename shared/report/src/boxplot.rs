//! Box plots: how a figure spreads over episodes.

use std::fmt::Write as _;

use crate::escape;

/// The five numbers of a box plot, its mean, and what lies beyond the whiskers.
#[derive(Clone, Debug, PartialEq)]
pub struct Spread {
    /// Quarter, half and three quarters of the values lie below these.
    pub quartiles: [f64; 3],
    /// The lowest and highest value within 1.5 times the height of the box (Tukey).
    pub whiskers: [f64; 2],
    /// The values beyond the whiskers, in rising order.
    pub outliers: Vec<f64>,
    /// The mean of all values.
    pub mean: f64,
}

impl Spread {
    /// The spread of the finite ones among the values; nothing if there is none.
    #[must_use]
    pub fn of(values: &[f64]) -> Option<Self> {
        let mut sorted: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
        sorted.sort_by(f64::total_cmp);
        let last = sorted.len().checked_sub(1)?;
        let quantile = |share: f64| {
            let position = share * last as f64;
            let (below, above) = (sorted[position.floor() as usize], sorted[position.ceil() as usize]);
            below + (above - below) * position.fract()
        };
        let quartiles = [0.25, 0.5, 0.75].map(quantile);
        let reach = 1.5 * (quartiles[2] - quartiles[0]);
        let (lowest, highest) = (quartiles[0] - reach, quartiles[2] + reach);
        let (inside, outliers): (Vec<f64>, _) = sorted.iter().partition(|&&value| (lowest..=highest).contains(&value));
        let whiskers = [inside.first(), inside.last()].map(|end| end.copied().unwrap_or(quartiles[1]));
        Some(Self { quartiles, whiskers, outliers, mean: sorted.iter().sum::<f64>() / sorted.len() as f64 })
    }
}

const WIDTH_PX: f64 = 720.0;
const HEIGHT_PX: f64 = 360.0;
const LEFT_PX: f64 = 64.0;
const RIGHT_PX: f64 = 12.0;
const TOP_PX: f64 = 12.0;
const BOTTOM_PX: f64 = 56.0;

/// Widest box [px].
const BOX_PX_MAX: f64 = 46.0;

/// About so many steps on the axis.
const TICKS: f64 = 6.0;

/// One box plot for each named series, side by side, over an axis that says what is measured.
///
/// Line: median. Diamond: mean. Whiskers: 1.5 times the box. Dots: episodes beyond.
#[must_use]
pub fn box_plots(axis: &str, series: &[(String, Vec<f64>)]) -> String {
    let spreads: Vec<_> = series.iter().map(|(_, values)| Spread::of(values)).collect();
    let all = || series.iter().flat_map(|(_, values)| values).copied().filter(|value| value.is_finite());
    let scale = Scale::over(all().fold(f64::INFINITY, f64::min), all().fold(f64::NEG_INFINITY, f64::max));
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH_PX} {HEIGHT_PX}\" width=\"{WIDTH_PX}\" \
         height=\"{HEIGHT_PX}\" role=\"img\" font-family=\"system-ui, sans-serif\" font-size=\"13\" \
         fill=\"currentColor\" stroke-linecap=\"round\">\n<title>{}</title>\n",
        escape(axis)
    );
    scale.push_axis(&mut svg, axis);
    let slot_px = (WIDTH_PX - LEFT_PX - RIGHT_PX) / series.len().max(1) as f64;
    let half_px = (slot_px * 0.32).min(BOX_PX_MAX / 2.0);
    for (index, ((name, values), spread)) in series.iter().zip(&spreads).enumerate() {
        let x = LEFT_PX + (index as f64 + 0.5) * slot_px;
        push_name(&mut svg, name, x, slot_px);
        if let Some(spread) = spread {
            let _ = writeln!(svg, "<g><title>{}</title>", escape(&spread.describe(name, values.len())));
            spread.push(&mut svg, x, half_px, &scale);
            svg.push_str("</g>\n");
        }
    }
    svg.push_str("</svg>\n");
    svg
}

/// The name under its box, in two lines where it is long.
fn push_name(svg: &mut String, name: &str, x: f64, slot_px: f64) {
    let y = HEIGHT_PX - BOTTOM_PX + 20.0;
    let chars_max = (slot_px / 7.0) as usize;
    let middle =
        name.match_indices(['-', ' ', '/']).map(|(at, _)| at + 1).min_by_key(|&at| (2 * at).abs_diff(name.len()));
    match middle {
        Some(at) if name.chars().count() > chars_max => {
            let (first, second) = name.split_at(at);
            let _ = writeln!(
                svg,
                "<text text-anchor=\"middle\"><tspan x=\"{x:.1}\" y=\"{y}\">{}</tspan><tspan x=\"{x:.1}\" dy=\"16\">{}</tspan></text>",
                escape(first.trim_end()),
                escape(second)
            );
        }
        _ => {
            let _ = writeln!(svg, "<text x=\"{x:.1}\" y=\"{y}\" text-anchor=\"middle\">{}</text>", escape(name));
        }
    }
}

impl Spread {
    fn describe(&self, name: &str, count: usize) -> String {
        let [low, median, high] = self.quartiles;
        format!("{name}: median {median:.3}, half of {count} between {low:.3} and {high:.3}, mean {:.3}", self.mean)
    }

    fn push(&self, svg: &mut String, x: f64, half_px: f64, scale: &Scale) {
        let [low, median, high] = self.quartiles.map(|value| scale.y(value));
        let [bottom, top] = self.whiskers.map(|value| scale.y(value));
        let (left, right, cap_px) = (x - half_px, x + half_px, half_px * 0.5);
        let (cap_left, cap_right) = (x - cap_px, x + cap_px);
        let _ = writeln!(
            svg,
            "<path d=\"M{x:.1} {bottom:.1}V{low:.1}M{x:.1} {high:.1}V{top:.1}M{cap_left:.1} {bottom:.1}H{cap_right:.1}\
             M{cap_left:.1} {top:.1}H{cap_right:.1}\" fill=\"none\" stroke=\"currentColor\"/>"
        );
        let (width, height) = (2.0 * half_px, (low - high).max(0.5));
        let _ = writeln!(
            svg,
            "<rect x=\"{left:.1}\" y=\"{high:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" fill=\"#3b82c4\" \
             fill-opacity=\"0.45\" stroke=\"currentColor\"/>"
        );
        let _ = writeln!(
            svg,
            "<path d=\"M{left:.1} {median:.1}H{right:.1}\" stroke=\"currentColor\" stroke-width=\"2.5\" stroke-linecap=\"butt\"/>"
        );
        let mean = scale.y(self.mean);
        let _ = writeln!(
            svg,
            "<path d=\"M{x:.1} {mean:.1}m-4 0l4 -4l4 4l-4 4z\" fill=\"#e0762f\" stroke=\"currentColor\" stroke-width=\"0.7\"/>"
        );
        for &outlier in &self.outliers {
            let _ =
                writeln!(svg, "<circle cx=\"{x:.1}\" cy=\"{:.1}\" r=\"2.2\" fill-opacity=\"0.55\"/>", scale.y(outlier));
        }
    }
}

/// A vertical axis with round steps.
struct Scale {
    low: f64,
    high: f64,
    step: f64,
}

impl Scale {
    /// An axis over the values from `lowest` to `highest`.
    fn over(lowest: f64, highest: f64) -> Self {
        let (lowest, highest) = if lowest <= highest { (lowest, highest) } else { (0.0, 1.0) };
        let span = (highest - lowest).max(1e-9 + 0.01 * highest.abs());
        let power = 10f64.powf((span / TICKS).log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * power).into_iter().find(|&s| span / s <= TICKS).unwrap_or(span);
        Self { low: (lowest / step).floor() * step, high: (highest / step).floor() * step + step, step }
    }

    fn y(&self, value: f64) -> f64 {
        let share = (value - self.low) / (self.high - self.low);
        HEIGHT_PX - BOTTOM_PX - share * (HEIGHT_PX - TOP_PX - BOTTOM_PX)
    }

    fn push_axis(&self, svg: &mut String, title: &str) {
        let decimals = (-self.step.log10().floor()).max(0.0) as usize;
        let steps = ((self.high - self.low) / self.step).round() as usize;
        let (right, middle) = (WIDTH_PX - RIGHT_PX, (HEIGHT_PX - BOTTOM_PX + TOP_PX) / 2.0);
        for step in 0..=steps {
            let value = self.low + step as f64 * self.step;
            let y = self.y(value);
            let _ = writeln!(
                svg,
                "<path d=\"M{LEFT_PX} {y:.1}H{right}\" stroke=\"currentColor\" stroke-opacity=\"0.15\"/>\
                 <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{value:.decimals$}</text>",
                LEFT_PX - 8.0,
                y + 4.5
            );
        }
        let _ = writeln!(
            svg,
            "<text transform=\"translate(16 {middle:.1}) rotate(-90)\" text-anchor=\"middle\" fill-opacity=\"0.75\">{}</text>",
            escape(title)
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn five_numbers_by_hand() {
        let spread = Spread::of(&[5.0, 1.0, 2.0, 3.0, 4.0, f64::NAN]).unwrap();
        assert_eq!((spread.quartiles, spread.whiskers, spread.mean), ([2.0, 3.0, 4.0], [1.0, 5.0], 3.0));
        let spread = Spread::of(&[1.0, 2.0, 3.0, 4.0, 100.0]).unwrap();
        assert_eq!((spread.whiskers, spread.outliers.as_slice()), ([1.0, 4.0], [100.0].as_slice()));
        assert_eq!(Spread::of(&[2.0, 3.0]).unwrap().quartiles, [2.25, 2.5, 2.75]);
        assert_eq!(Spread::of(&[]), None);
    }

    #[test]
    fn the_axis_has_round_steps_that_hold_all_values() {
        for (lowest, highest) in [(0.71, 0.93), (1.2, 1.9), (0.0, 0.0), (5.0, 5.0), (-3.0, 1e6), (1e-12, 2e-12)] {
            let scale = Scale::over(lowest, highest);
            assert!(scale.low <= lowest && highest <= scale.high, "{lowest} to {highest}");
            assert!((scale.high - scale.low) / scale.step < 9.0, "{lowest} to {highest}");
        }
        let scale = Scale::over(0.71, 0.93);
        assert!((scale.low - 0.7).abs() < 1e-9 && (scale.step - 0.05).abs() < 1e-9);
        let nothing = Scale::over(f64::INFINITY, f64::NEG_INFINITY);
        assert_eq!((nothing.low, nothing.high.is_finite()), (0.0, true));
    }

    #[test]
    fn a_chart_shows_every_series() {
        let svg = box_plots("fill [%]", &[("a<b".to_owned(), vec![1.0, 2.0, 9.0]), ("none".to_owned(), Vec::new())]);
        assert!(svg.contains(">a&lt;b</text>") && svg.contains(">none</text>"), "{svg}");
        assert_eq!(svg.matches("<rect").count(), 1);
        assert!(box_plots("nothing", &[]).ends_with("</svg>\n"));
    }
}
