//! Box plots: how a figure spreads over episodes.

use std::fmt::Write as _;

use crate::chart::{Axis, colour, open_svg, push_legend, push_name};
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

/// Room for a legend above the boxes [px].
const LEGEND_PX: f64 = 26.0;

/// What one box, its gap and its share of the gap between groups take in a chart of groups [px].
const GROUPED_BOX_PX: f64 = 34.0;

/// One box plot for each named series, side by side, over an axis that says what is measured.
///
/// Line: median. Diamond: mean. Whiskers: 1.5 times the box. Dots: episodes beyond.
#[must_use]
pub fn box_plots(axis: &str, series: &[(String, Vec<f64>)]) -> String {
    let scale = scale_over(series.iter().map(|(_, values)| values), TOP_PX);
    let mut svg = open_svg(WIDTH_PX, HEIGHT_PX, axis);
    scale.push_vertical(&mut svg, axis, LEFT_PX, WIDTH_PX - RIGHT_PX);
    let slot_px = (WIDTH_PX - LEFT_PX - RIGHT_PX) / series.len().max(1) as f64;
    let half_px = (slot_px * 0.32).min(BOX_PX_MAX / 2.0);
    for (index, (name, values)) in series.iter().enumerate() {
        let x = LEFT_PX + (index as f64 + 0.5) * slot_px;
        push_name(&mut svg, name, x, HEIGHT_PX - BOTTOM_PX + 20.0, slot_px);
        push_box(&mut svg, name, values, x, half_px, &scale, colour(0));
    }
    svg.push_str("</svg>\n");
    svg
}

/// As [`box_plots`], group by group: each group holds the values of every one of the `names`, which have their colours.
#[must_use]
pub fn box_plot_groups(axis: &str, names: &[&str], groups: &[(&str, Vec<Vec<f64>>)]) -> String {
    let scale = scale_over(groups.iter().flat_map(|(_, series)| series), TOP_PX + LEGEND_PX);
    let group_px = GROUPED_BOX_PX * (names.len() as f64 + 1.0);
    let width_px = (LEFT_PX + RIGHT_PX + group_px * groups.len() as f64).max(WIDTH_PX);
    let mut svg = open_svg(width_px, HEIGHT_PX, axis);
    scale.push_vertical(&mut svg, axis, LEFT_PX, width_px - RIGHT_PX);
    push_legend(&mut svg, names.iter().copied().enumerate(), LEFT_PX, TOP_PX + 8.0);
    let group_px = (width_px - LEFT_PX - RIGHT_PX) / groups.len().max(1) as f64;
    for (index, (group, series)) in groups.iter().enumerate() {
        let middle = LEFT_PX + (index as f64 + 0.5) * group_px;
        push_name(&mut svg, group, middle, HEIGHT_PX - BOTTOM_PX + 20.0, group_px);
        let box_px = group_px / (names.len() as f64 + 1.0);
        for (place, (name, values)) in names.iter().zip(series).enumerate() {
            let x = middle + (place as f64 + 0.5 - names.len() as f64 / 2.0) * box_px;
            push_box(&mut svg, &format!("{group}, {name}"), values, x, box_px * 0.36, &scale, colour(place));
        }
    }
    svg.push_str("</svg>\n");
    svg
}

fn scale_over<'a>(series: impl Iterator<Item = &'a Vec<f64>> + Clone, top_px: f64) -> Axis {
    Axis::over(series.flatten().copied(), HEIGHT_PX - BOTTOM_PX, top_px)
}

/// Draws one box plot around `x`; nothing for values none of which is finite.
fn push_box(svg: &mut String, name: &str, values: &[f64], x: f64, half_px: f64, scale: &Axis, colour: &str) {
    if let Some(spread) = Spread::of(values) {
        let _ = writeln!(svg, "<g><title>{}</title>", escape(&spread.describe(name, values.len())));
        spread.push(svg, x, half_px, scale, colour);
        svg.push_str("</g>\n");
    }
}

impl Spread {
    fn describe(&self, name: &str, count: usize) -> String {
        let [low, median, high] = self.quartiles;
        format!("{name}: median {median:.3}, half of {count} between {low:.3} and {high:.3}, mean {:.3}", self.mean)
    }

    fn push(&self, svg: &mut String, x: f64, half_px: f64, scale: &Axis, colour: &str) {
        let [low, median, high] = self.quartiles.map(|value| scale.px(value));
        let [bottom, top] = self.whiskers.map(|value| scale.px(value));
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
            "<rect x=\"{left:.1}\" y=\"{high:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" fill=\"{colour}\" \
             fill-opacity=\"0.45\" stroke=\"currentColor\"/>"
        );
        let _ = writeln!(
            svg,
            "<path d=\"M{left:.1} {median:.1}H{right:.1}\" stroke=\"currentColor\" stroke-width=\"2.5\" stroke-linecap=\"butt\"/>"
        );
        let mean = scale.px(self.mean);
        let _ = writeln!(
            svg,
            "<path d=\"M{x:.1} {mean:.1}m-4 0l4 -4l4 4l-4 4z\" fill=\"#fff\" stroke=\"#1b2330\" stroke-width=\"0.9\"/>"
        );
        for &outlier in &self.outliers {
            let _ = writeln!(
                svg,
                "<circle cx=\"{x:.1}\" cy=\"{:.1}\" r=\"2.2\" fill-opacity=\"0.55\"/>",
                scale.px(outlier)
            );
        }
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
    fn a_chart_shows_every_series() {
        let svg = box_plots("fill [%]", &[("a<b".to_owned(), vec![1.0, 2.0, 9.0]), ("none".to_owned(), Vec::new())]);
        assert!(svg.contains(">a&lt;b</text>") && svg.contains(">none</text>"), "{svg}");
        assert_eq!(svg.matches("<rect").count(), 1);
        assert!(box_plots("nothing", &[]).ends_with("</svg>\n"));
    }

    #[test]
    fn a_chart_of_groups_shows_every_box_in_its_colour() {
        let series = vec![vec![1.0, 2.0, 3.0], vec![2.0, 4.0]];
        let svg = box_plot_groups("fill [%]", &["walle", "packman"], &[("three", series.clone()), ("a<b", series)]);
        assert_eq!(svg.matches("<g>").count(), 4);
        assert!(svg.contains(">a&lt;b</text>") && svg.contains("<title>three, packman: median 3.000"), "{svg}");
        assert_eq!(svg.matches(&format!("fill=\"{}\"", colour(1))).count(), 3, "two boxes and the legend");
        assert!(box_plot_groups("nothing", &[], &[]).ends_with("</svg>\n"));
    }
}
