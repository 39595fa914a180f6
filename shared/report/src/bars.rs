//! Stacked bars: what a whole is made of.

use std::fmt::Write as _;

use crate::chart::{Axis, colour, open_svg, push_legend};
use crate::escape;

const WIDTH_PX: f64 = 720.0;
const LEFT_PX: f64 = 24.0;
const RIGHT_PX: f64 = 24.0;
const TOP_PX: f64 = 64.0;
const BAR_PX: f64 = 42.0;
/// From one bar's top to the next one's, with the bar's name between them [px].
const STEP_PX: f64 = 74.0;
const BOTTOM_PX: f64 = 48.0;

/// The narrowest part that has its number written in it [px].
const LABELLED_PX_MIN: f64 = 26.0;

/// Names in one line of the legend.
const LEGEND_LINE: usize = 4;

/// One bar for each named whole, cut into the `parts` in their order; parts that are not finite or negative are left out.
/// Each part says its name and its value, in a tooltip and, where there is room, in the bar.
#[must_use]
pub fn stacked_bars(axis: &str, parts: &[&str], wholes: &[(&str, Vec<f64>)]) -> String {
    let bottom_px = TOP_PX + STEP_PX * wholes.len() as f64;
    let is_shown = |value: &&f64| value.is_finite() && **value > 0.0;
    let total = |values: &[f64]| values.iter().filter(is_shown).sum::<f64>();
    let totals = wholes.iter().map(|(_, values)| total(values));
    let scale = Axis::over(totals.chain([0.0]), LEFT_PX, WIDTH_PX - RIGHT_PX);
    let mut svg = open_svg(WIDTH_PX, bottom_px + BOTTOM_PX, axis);
    let named: Vec<(usize, &str)> = parts.iter().copied().enumerate().collect();
    for (line, names) in named.chunks(LEGEND_LINE).enumerate() {
        push_legend(&mut svg, names.iter().copied(), LEFT_PX, 18.0 + 20.0 * line as f64);
    }
    for (index, (name, values)) in wholes.iter().enumerate() {
        let top = TOP_PX + STEP_PX * index as f64;
        let _ = writeln!(
            svg,
            "<text x=\"{LEFT_PX}\" y=\"{:.1}\">{} ({:.0})</text>",
            top + 14.0,
            escape(name),
            total(values)
        );
        let mut from = 0.0;
        for (part, (value, name)) in values.iter().zip(parts).enumerate().filter(|(_, (value, _))| is_shown(value)) {
            let (left, right) = (scale.px(from), scale.px(from + value));
            let _ = writeln!(
                svg,
                "<g><title>{}: {value:.1}</title><rect x=\"{left:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{BAR_PX}\" fill=\"{}\"/>",
                escape(name),
                top + 22.0,
                right - left,
                colour(part)
            );
            if right - left >= LABELLED_PX_MIN {
                let (x, y) = ((left + right) / 2.0, top + 22.0 + BAR_PX / 2.0 + 4.5);
                let _ = writeln!(
                    svg,
                    "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"middle\" fill=\"#fff\">{value:.0}</text>"
                );
            }
            svg.push_str("</g>\n");
            from += value;
        }
    }
    scale.push_horizontal(&mut svg, axis, bottom_px);
    svg.push_str("</svg>\n");
    svg
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bar_is_as_long_as_its_parts() {
        let svg =
            stacked_bars("time [us]", &["a < b", "b", "c"], &[("one", vec![60.0, 20.0, 20.0]), ("two", vec![50.0])]);
        let widths: Vec<f64> = svg
            .lines()
            .filter_map(|line| line.split_once("<g>")?.1.split_once(" width=\"")?.1.split_once('"')?.0.parse().ok())
            .collect();
        // 672 pixels are a hundred microseconds.
        assert_eq!(widths, [403.2, 134.4, 134.4, 336.0]);
        assert!(svg.contains("<title>a &lt; b: 60.0</title>") && svg.contains("one (100)"));
    }

    #[test]
    fn what_is_no_length_is_left_out() {
        let svg = stacked_bars("t", &["a", "b", "c"], &[("one", vec![f64::NAN, -1.0, 2.0])]);
        assert_eq!(svg.matches("<g>").count(), 1);
        assert!(stacked_bars("t", &[], &[]).ends_with("</svg>\n"));
    }
}
