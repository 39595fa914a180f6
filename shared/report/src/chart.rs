//! What charts share: the frame, axes with round steps, colours and the legend.

use std::fmt::Write as _;

use crate::escape;

/// Colours that can be told apart with any colour vision (Okabe and Ito, and two more), in the order of the series.
const COLOURS: [&str; 8] = ["#0072b2", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#56b4e9", "#8a8f98", "#5b3a8e"];

/// About so many steps on an axis.
const TICKS: f64 = 6.0;

/// Width of a letter of the charts' font, as far as a layout needs it [px].
const LETTER_PX: f64 = 7.0;

/// The colour of the series with this number.
pub(crate) fn colour(series: usize) -> &'static str {
    COLOURS[series % COLOURS.len()]
}

/// The beginning of a chart.
pub(crate) fn open_svg(width_px: f64, height_px: f64, title: &str) -> String {
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width_px} {height_px}\" width=\"{width_px}\" \
         height=\"{height_px}\" role=\"img\" font-family=\"system-ui, sans-serif\" font-size=\"13\" \
         fill=\"currentColor\" stroke-linecap=\"round\">\n<title>{}</title>\n",
        escape(title)
    )
}

/// A picture of this crate as a file of its own: with paper and ink, where a page would give them.
#[must_use]
pub fn standalone(svg: &str) -> String {
    svg.replacen("<svg ", "<svg style=\"background:#fff;color:#1b2330\" ", 1)
}

/// An axis with round steps, along the pixels from `low_px` to `high_px`.
pub(crate) struct Axis {
    low: f64,
    high: f64,
    step: f64,
    low_px: f64,
    high_px: f64,
}

impl Axis {
    /// An axis that holds all of the values that are finite.
    pub(crate) fn over(values: impl Iterator<Item = f64> + Clone, low_px: f64, high_px: f64) -> Self {
        let finite = values.filter(|value| value.is_finite());
        let lowest = finite.clone().fold(f64::INFINITY, f64::min);
        let highest = finite.fold(f64::NEG_INFINITY, f64::max);
        let (lowest, highest) = if lowest <= highest { (lowest, highest) } else { (0.0, 1.0) };
        let span = (highest - lowest).max(1e-9 + 0.01 * highest.abs());
        let power = 10f64.powf((span / TICKS).log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * power).into_iter().find(|&s| span / s <= TICKS).unwrap_or(span);
        let high = ((highest / step - 1e-9).ceil() * step).max((lowest / step).floor() * step + step);
        Self { low: (lowest / step).floor() * step, high, step, low_px, high_px }
    }

    /// Where a value stands [px].
    pub(crate) fn px(&self, value: f64) -> f64 {
        self.low_px + (value - self.low) / (self.high - self.low) * (self.high_px - self.low_px)
    }

    /// Position and label of every step.
    fn ticks(&self) -> impl Iterator<Item = (f64, String)> {
        let decimals = (-self.step.log10().floor()).max(0.0) as usize;
        let steps = ((self.high - self.low) / self.step).round() as usize;
        (0..=steps).map(move |step| {
            let value = self.low + step as f64 * self.step;
            (self.px(value), format!("{value:.decimals$}"))
        })
    }

    /// Draws it as the vertical axis of what lies between `left_px` and `right_px`.
    pub(crate) fn push_vertical(&self, svg: &mut String, title: &str, left_px: f64, right_px: f64) {
        for (y, label) in self.ticks() {
            let _ = writeln!(
                svg,
                "<path d=\"M{left_px} {y:.1}H{right_px}\" stroke=\"currentColor\" stroke-opacity=\"0.15\"/>\
                 <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{label}</text>",
                left_px - 8.0,
                y + 4.5
            );
        }
        let (x, middle) = (left_px - 48.0, (self.low_px + self.high_px) / 2.0);
        let _ = writeln!(
            svg,
            "<text transform=\"translate({x:.1} {middle:.1}) rotate(-90)\" text-anchor=\"middle\" fill-opacity=\"0.75\">{}</text>",
            escape(title)
        );
    }

    /// Draws it as the horizontal axis under what ends at `bottom_px`.
    pub(crate) fn push_horizontal(&self, svg: &mut String, title: &str, bottom_px: f64) {
        for (x, label) in self.ticks() {
            let _ = writeln!(
                svg,
                "<path d=\"M{x:.1} {bottom_px}v5\" stroke=\"currentColor\" stroke-opacity=\"0.4\"/>\
                 <text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{label}</text>",
                bottom_px + 20.0
            );
        }
        let middle = (self.low_px + self.high_px) / 2.0;
        let _ = writeln!(
            svg,
            "<text x=\"{middle:.1}\" y=\"{:.1}\" text-anchor=\"middle\" fill-opacity=\"0.75\">{}</text>",
            bottom_px + 40.0,
            escape(title)
        );
    }
}

/// Draws the names of the series, given by their numbers, in their colours, in one line from `left_px` on.
pub(crate) fn push_legend<'a>(
    svg: &mut String,
    names: impl Iterator<Item = (usize, &'a str)>,
    left_px: f64,
    y_px: f64,
) {
    let mut x = left_px;
    for (series, name) in names {
        let _ = writeln!(
            svg,
            "<rect x=\"{x:.1}\" y=\"{:.1}\" width=\"12\" height=\"12\" rx=\"2\" fill=\"{}\"/>\
             <text x=\"{:.1}\" y=\"{:.1}\">{}</text>",
            y_px - 10.5,
            colour(series),
            x + 18.0,
            y_px,
            escape(name)
        );
        x += 18.0 + LETTER_PX * name.chars().count() as f64 + 22.0;
    }
}

/// Draws a name centred under `x`, in two lines where it is wider than `room_px`.
pub(crate) fn push_name(svg: &mut String, name: &str, x: f64, y: f64, room_px: f64) {
    let chars_max = (room_px / LETTER_PX) as usize;
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_axis_has_round_steps_that_hold_all_values() {
        for (lowest, highest) in [(0.71, 0.93), (1.2, 1.9), (0.0, 0.0), (5.0, 5.0), (-3.0, 1e6), (1e-12, 2e-12)] {
            let axis = Axis::over([lowest, highest, f64::NAN].into_iter(), 100.0, 0.0);
            assert!(axis.low <= lowest && highest <= axis.high, "{lowest} to {highest}");
            assert!((axis.high - axis.low) / axis.step < 9.0, "{lowest} to {highest}");
        }
        let axis = Axis::over([0.71, 0.93].into_iter(), 100.0, 0.0);
        assert!((axis.low - 0.7).abs() < 1e-9 && (axis.step - 0.05).abs() < 1e-9);
        assert!((axis.px(0.7) - 100.0).abs() < 1e-9 && axis.px(0.95).abs() < 1e-9);
        let ends = Axis::over([0.0, 2000.0].into_iter(), 0.0, 100.0);
        assert_eq!((ends.low, ends.high), (0.0, 2000.0), "an end that is round is the end");
        let nothing = Axis::over(std::iter::empty(), 100.0, 0.0);
        assert_eq!((nothing.low, nothing.high), (0.0, 1.0));
    }

    #[test]
    fn a_picture_of_its_own_has_paper_and_ink() {
        let svg = open_svg(10.0, 10.0, "a < b") + "</svg>\n";
        assert!(standalone(&svg).starts_with("<svg style=\"background:#fff"));
        assert!(svg.contains("<title>a &lt; b</title>"));
    }
}
