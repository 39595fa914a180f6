//! Charts as wide as a page: percentile curves, and what happened over time.

use std::fmt::Write as _;

use crate::chart::{Axis, colour, open_svg, push_legend};
use crate::escape;

const WIDTH_PX: f64 = 1060.0;
const HEIGHT_PX: f64 = 320.0;
const LEFT_PX: f64 = 70.0;
const RIGHT_PX: f64 = 1020.0;
const TOP_PX: f64 = 40.0;
const BOTTOM_PX: f64 = 262.0;

/// A line with a name.
#[derive(Clone, Debug, PartialEq)]
pub struct Named {
    /// What it shows.
    pub name: String,
    /// Its points from left to right; those that are not finite are left out.
    pub points: Vec<(f64, f64)>,
}

/// A value that is not to be exceeded, drawn across the chart.
#[derive(Clone, Debug, PartialEq)]
pub struct Limit {
    /// Where it lies, in the unit of the vertical axis.
    pub value: f64,
    /// What it is.
    pub name: String,
}

/// How the vertical axis grows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Evenly.
    Linear,
    /// By factors of ten. Values of nought and below stand on the lowest line.
    Log,
}

/// A chart over time.
#[derive(Clone, Debug, PartialEq)]
pub struct Timeline<'a> {
    /// What runs from left to right, and its unit.
    pub x: &'a str,
    /// What runs from bottom to top, and its unit.
    pub y: &'a str,
    /// How the vertical axis grows.
    pub scale: Scale,
    /// The lines.
    pub lines: &'a [Named],
    /// A value that is not to be exceeded.
    pub limit: Option<Limit>,
    /// What happened at which moment: marked at the top, and named when pointed at.
    pub marks: &'a [(f64, String)],
}

/// A vertical axis of either scale.
enum Upward {
    Linear(Axis),
    Log { low: f64, high: f64 },
}

impl Upward {
    fn over(scale: Scale, values: impl Iterator<Item = f64> + Clone) -> Self {
        match scale {
            Scale::Linear => Self::Linear(Axis::over(values.chain([0.0]), BOTTOM_PX, TOP_PX)),
            Scale::Log => {
                let positive = values.filter(|value| value.is_finite() && *value > 0.0);
                let lowest = positive.clone().fold(f64::INFINITY, f64::min);
                let highest = positive.fold(0.0, f64::max);
                if highest == 0.0 {
                    return Self::Log { low: 0.0, high: 1.0 };
                }
                let (low, high) = (lowest.log10().floor(), highest.log10().ceil());
                Self::Log { low, high: high.max(low + 1.0) }
            }
        }
    }

    fn px(&self, value: f64) -> f64 {
        match self {
            Self::Linear(axis) => axis.px(value),
            Self::Log { low, high } => {
                let power = if value > 0.0 { value.log10().clamp(*low, *high) } else { *low };
                BOTTOM_PX + (power - low) / (high - low) * (TOP_PX - BOTTOM_PX)
            }
        }
    }

    fn push(&self, svg: &mut String, title: &str) {
        let Self::Log { low, high } = self else {
            if let Self::Linear(axis) = self {
                axis.push_vertical(svg, title, LEFT_PX, RIGHT_PX);
            }
            return;
        };
        for power in (low.round() as i32)..=(high.round() as i32) {
            let (value, y) = (10f64.powi(power), self.px(10f64.powi(power)));
            let _ = writeln!(
                svg,
                "<path d=\"M{LEFT_PX} {y:.1}H{RIGHT_PX}\" stroke=\"currentColor\" stroke-opacity=\"0.15\"/>\
                 <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{value}</text>",
                LEFT_PX - 8.0,
                y + 4.5
            );
        }
        let (x, middle) = (LEFT_PX - 54.0, (TOP_PX + BOTTOM_PX) / 2.0);
        let _ = writeln!(
            svg,
            "<text transform=\"translate({x:.1} {middle:.1}) rotate(-90)\" text-anchor=\"middle\" fill-opacity=\"0.75\">{}</text>",
            escape(title)
        );
    }
}

/// Latencies at their quantiles (0 up to, not including, 1), every nine as wide as the others: the tail is where one
/// looks.
#[must_use]
pub fn percentile_curves(curves: &[Named], y: &str, limit: &Limit) -> String {
    let nines = |quantile: f64| -(1.0 - quantile).log10();
    let placed: Vec<Named> = curves
        .iter()
        .map(|curve| {
            let points = curve.points.iter().map(|&(quantile, value)| (nines(quantile), value));
            Named { name: curve.name.clone(), points: points.collect() }
        })
        .collect();
    let last = placed.iter().flat_map(finite).map(|(x, _)| x).fold(1.0, f64::max).ceil();
    let mut svg = open_svg(WIDTH_PX, HEIGHT_PX, y);
    push_legend(&mut svg, curves.iter().map(|curve| curve.name.as_str()).enumerate(), LEFT_PX, 22.0);
    let values = placed.iter().flat_map(finite).map(|(_, y)| y).chain([limit.value]);
    let up = Upward::over(Scale::Log, values);
    up.push(&mut svg, y);
    let across = |x: f64| LEFT_PX + x / last * (RIGHT_PX - LEFT_PX);
    for nine in 0..=(last as usize) {
        let x = across(nine as f64);
        let label = match nine {
            0 => "0 %".to_owned(),
            1 => "90 %".to_owned(),
            2 => "99 %".to_owned(),
            more => format!("99.{} %", "9".repeat(more - 2)),
        };
        let _ = writeln!(
            svg,
            "<path d=\"M{x:.1} {TOP_PX}V{BOTTOM_PX}\" stroke=\"currentColor\" stroke-opacity=\"0.08\"/>\
             <text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{label}</text>",
            BOTTOM_PX + 20.0
        );
    }
    let _ = writeln!(
        svg,
        "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\" fill-opacity=\"0.75\">share of the boxes that were at least as fast</text>",
        (LEFT_PX + RIGHT_PX) / 2.0,
        BOTTOM_PX + 42.0
    );
    push_limit(&mut svg, &up, limit);
    for (series, curve) in placed.iter().enumerate() {
        push_line(&mut svg, curve, series, across, &up);
    }
    svg.push_str("</svg>\n");
    svg
}

/// What happened over time.
#[must_use]
pub fn timeline(chart: &Timeline<'_>) -> String {
    let mut svg = open_svg(WIDTH_PX, HEIGHT_PX, chart.y);
    push_legend(&mut svg, chart.lines.iter().map(|line| line.name.as_str()).enumerate(), LEFT_PX, 22.0);
    let values = chart.lines.iter().flat_map(finite).map(|(_, y)| y).chain(chart.limit.iter().map(|limit| limit.value));
    let up = Upward::over(chart.scale, values);
    up.push(&mut svg, chart.y);
    let axis = across(chart.lines.iter().flat_map(finite).map(|(x, _)| x));
    axis.push_horizontal(&mut svg, chart.x, BOTTOM_PX);
    for (at, name) in chart.marks {
        let x = axis.px(*at);
        let _ = writeln!(
            svg,
            "<g stroke=\"#d55e00\" fill=\"#d55e00\"><title>{}</title>\
             <path d=\"M{x:.1} {TOP_PX}V{BOTTOM_PX}\" stroke-opacity=\"0.18\"/>\
             <path d=\"M{:.1} {:.1}h7l-3.5 6z\" stroke=\"none\" fill-opacity=\"0.8\"/></g>",
            escape(name),
            x - 3.5,
            TOP_PX - 7.0
        );
    }
    if let Some(limit) = &chart.limit {
        push_limit(&mut svg, &up, limit);
    }
    for (series, line) in chart.lines.iter().enumerate() {
        push_line(&mut svg, line, series, |x| axis.px(x), &up);
    }
    svg.push_str("</svg>\n");
    svg
}

/// Parts of a whole over time, one on the other, the first at the bottom. All parts have their points at the same
/// places.
#[must_use]
pub fn stack(x: &str, y: &str, parts: &[Named]) -> String {
    let mut svg = open_svg(WIDTH_PX, HEIGHT_PX, y);
    push_legend(&mut svg, parts.iter().map(|part| part.name.as_str()).enumerate(), LEFT_PX, 22.0);
    let count = parts.iter().map(|part| part.points.len()).min().unwrap_or(0);
    let mut levels = vec![vec![0.0; count]];
    for part in parts {
        let below = &levels[levels.len() - 1];
        let value = |index: usize| part.points[index].1;
        let above = (0..count).map(|i| below[i] + if value(i).is_finite() { value(i).max(0.0) } else { 0.0 });
        levels.push(above.collect());
    }
    let up = Upward::over(Scale::Linear, levels.iter().flatten().copied());
    up.push(&mut svg, y);
    let places: Vec<f64> =
        parts.first().map_or_else(Vec::new, |part| part.points[..count].iter().map(|p| p.0).collect());
    let axis = across(places.iter().copied());
    axis.push_horizontal(&mut svg, x, BOTTOM_PX);
    for (part, pair) in levels.windows(2).enumerate() {
        let (below, above) = (&pair[0], &pair[1]);
        let mut path = String::new();
        let there = places.iter().zip(above);
        let back = places.iter().zip(below).rev();
        for (step, (&place, &level)) in there.chain(back).enumerate() {
            let _ = write!(path, "{}{:.1} {:.1}", if step == 0 { "M" } else { "L" }, axis.px(place), up.px(level));
        }
        let _ = writeln!(svg, "<path d=\"{path}Z\" fill=\"{}\" fill-opacity=\"0.8\" stroke=\"none\"/>", colour(part));
    }
    svg.push_str("</svg>\n");
    svg
}

fn across(places: impl Iterator<Item = f64> + Clone) -> Axis {
    Axis::over(places.chain([0.0]), LEFT_PX, RIGHT_PX)
}

fn finite(line: &Named) -> impl Iterator<Item = (f64, f64)> + Clone {
    line.points.iter().copied().filter(|(x, y)| x.is_finite() && y.is_finite())
}

fn push_line(svg: &mut String, line: &Named, series: usize, across: impl Fn(f64) -> f64, up: &Upward) {
    let mut path = String::new();
    for (index, (x, y)) in finite(line).enumerate() {
        let _ = write!(path, "{}{:.1} {:.1}", if index == 0 { "M" } else { "L" }, across(x), up.px(y));
    }
    let _ = writeln!(
        svg,
        "<path d=\"{path}\" fill=\"none\" stroke=\"{}\" stroke-width=\"1.6\" stroke-linejoin=\"round\"/>",
        colour(series)
    );
}

fn push_limit(svg: &mut String, up: &Upward, limit: &Limit) {
    let y = up.px(limit.value);
    let _ = writeln!(
        svg,
        "<path d=\"M{LEFT_PX} {y:.1}H{RIGHT_PX}\" stroke=\"#c0392b\" stroke-width=\"1.2\" stroke-dasharray=\"6 4\"/>\
         <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\" fill=\"#c0392b\">{}</text>",
        RIGHT_PX - 4.0,
        y - 5.0,
        escape(&limit.name)
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(name: &str, points: &[(f64, f64)]) -> Named {
        Named { name: name.to_owned(), points: points.to_vec() }
    }

    fn limit() -> Limit {
        Limit { value: 40.0, name: "40 ms <budget>".to_owned() }
    }

    #[test]
    fn every_nine_is_as_wide_as_the_others() {
        let curve = named("cell", &[(0.0, 0.5), (0.9, 1.0), (0.99, 10.0), (0.999, 100.0)]);
        let svg = percentile_curves(&[curve], "latency [ms]", &limit());
        // Three nines over 950 px, and a latency from 0.1 to 100 ms in three steps of 74 px.
        assert!(svg.contains("M70.0 210.3L386.7 188.0L703.3 114.0L1020.0 40.0"), "{svg}");
        assert!(svg.contains("99.9 %") && svg.contains("40 ms &lt;budget&gt;"));
        assert!(percentile_curves(&[], "y", &limit()).ends_with("</svg>\n"));
    }

    #[test]
    fn a_time_line_shows_its_marks_and_no_rubbish() {
        let lines = [named("p99", &[(0.0, 1.0), (5.0, f64::NAN), (10.0, 0.0)])];
        let marks = [(5.0, "kill <a>".to_owned())];
        for scale in [Scale::Linear, Scale::Log] {
            let chart = Timeline {
                x: "time [s]",
                y: "latency [ms]",
                scale,
                lines: &lines,
                limit: Some(limit()),
                marks: &marks,
            };
            let svg = timeline(&chart);
            assert!(svg.contains("<title>kill &lt;a&gt;</title>") && !svg.contains("NaN") && !svg.contains("inf"));
        }
        let nothing = Timeline { x: "", y: "", scale: Scale::Log, lines: &[], limit: None, marks: &[] };
        assert!(timeline(&nothing).ends_with("</svg>\n"));
    }

    #[test]
    fn parts_stand_on_each_other() {
        let parts = [named("a", &[(0.0, 10.0), (10.0, 10.0)]), named("b", &[(0.0, 10.0), (10.0, 30.0)])];
        let svg = stack("time [s]", "time [us]", &parts);
        // The axis goes to 40: 10 is a quarter of 222 px above the bottom.
        assert!(svg.contains("M70.0 206.5L1020.0 206.5L1020.0 262.0L70.0 262.0Z"), "{svg}");
        assert!(svg.contains("M70.0 151.0L1020.0 40.0L1020.0 206.5L70.0 206.5Z"), "{svg}");
        assert!(stack("", "", &[]).ends_with("</svg>\n"));
    }
}
