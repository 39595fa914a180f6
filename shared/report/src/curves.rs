//! Line charts: how figures go on, side by side.

use std::fmt::Write as _;

use crate::chart::{Axis, colour, open_svg, push_legend};
use crate::escape;

/// Figures that follow each other.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// What they belong to; lines of one name have one colour.
    pub name: String,
    /// Where they stand, from left to right; points that are not finite are left out.
    pub points: Vec<(f64, f64)>,
    /// Drawn as dots that a thin line joins, in place of a line.
    pub dots: bool,
}

/// One chart of lines.
#[derive(Clone, Debug, PartialEq)]
pub struct LineChart<'a> {
    /// What runs from left to right, and its unit.
    pub x: &'a str,
    /// What runs from bottom to top, and its unit.
    pub y: &'a str,
    /// The lines, the ones behind first.
    pub lines: Vec<Line>,
}

const CHART_PX: f64 = 460.0;
const HEIGHT_PX: f64 = 360.0;
const LEFT_PX: f64 = 64.0;
const RIGHT_PX: f64 = 16.0;
const TOP_PX: f64 = 58.0;
const BOTTOM_PX: f64 = 50.0;

/// The charts side by side, under one legend and a `note` that says what the lines and the dots are.
#[must_use]
pub fn line_charts(charts: &[LineChart<'_>], note: &str) -> String {
    let mut names: Vec<&str> = Vec::new();
    for line in charts.iter().flat_map(|chart| &chart.lines) {
        if !names.contains(&line.name.as_str()) {
            names.push(&line.name);
        }
    }
    let title: Vec<_> = charts.iter().map(|chart| chart.y).collect();
    let mut svg = open_svg(CHART_PX * charts.len().max(1) as f64, HEIGHT_PX, &title.join("; "));
    push_legend(&mut svg, names.iter().copied().enumerate(), LEFT_PX, 22.0);
    let _ = writeln!(svg, "<text x=\"{LEFT_PX}\" y=\"42\" fill-opacity=\"0.75\">{}</text>", escape(note));
    for (index, chart) in charts.iter().enumerate() {
        push_chart(&mut svg, chart, index as f64 * CHART_PX, &names);
    }
    svg.push_str("</svg>\n");
    svg
}

fn push_chart(svg: &mut String, chart: &LineChart<'_>, offset_px: f64, names: &[&str]) {
    let finite = |line: &Line| -> Vec<(f64, f64)> {
        line.points.iter().copied().filter(|(x, y)| x.is_finite() && y.is_finite()).collect()
    };
    let lines: Vec<_> = chart.lines.iter().map(|line| (line, finite(line))).collect();
    let points = || lines.iter().flat_map(|(_, points)| points.iter().copied());
    let (left, right) = (offset_px + LEFT_PX, offset_px + CHART_PX - RIGHT_PX);
    let bottom = HEIGHT_PX - BOTTOM_PX;
    let across = Axis::over(points().map(|(x, _)| x), left, right);
    let up = Axis::over(points().map(|(_, y)| y), bottom, TOP_PX);
    up.push_vertical(svg, chart.y, left, right);
    across.push_horizontal(svg, chart.x, bottom);
    for (line, points) in &lines {
        let colour = colour(names.iter().position(|name| *name == line.name).unwrap_or(0));
        let mut path = String::new();
        for (index, &(x, y)) in points.iter().enumerate() {
            let _ = write!(path, "{}{:.1} {:.1}", if index == 0 { "M" } else { "L" }, across.px(x), up.px(y));
        }
        let (width, opacity) = if line.dots { (1.0, 0.45) } else { (1.5, 0.85) };
        let _ = writeln!(
            svg,
            "<path d=\"{path}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"{width}\" stroke-opacity=\"{opacity}\" \
             stroke-linejoin=\"round\"/>"
        );
        for &(x, y) in points.iter().filter(|_| line.dots) {
            let (x, y) = (across.px(x), up.px(y));
            let _ = writeln!(svg, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"2.6\" fill=\"{colour}\"/>");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_line_is_drawn_in_the_colour_of_its_name() {
        let line = |name: &str, dots| Line {
            name: name.to_owned(),
            points: vec![(0.0, 1.0), (10.0, f64::NAN), (20.0, 2.0)],
            dots,
        };
        let chart =
            |y| LineChart { x: "episode", y, lines: vec![line("a<b", false), line("c", false), line("a<b", true)] };
        let svg = line_charts(&[chart("fill"), chart("c")], "dots: greedy");
        assert!(svg.contains(">a&lt;b</text>") && svg.contains(">dots: greedy</text>"));
        assert_eq!(svg.matches("<rect").count(), 2, "one legend for all charts");
        assert_eq!(svg.matches(&format!("stroke=\"{}\"", colour(0))).count(), 4);
        assert_eq!(svg.matches("<circle").count(), 4, "what is not finite is left out");
        assert!(!svg.contains("NaN"));
        assert!(line_charts(&[], "nothing").ends_with("</svg>\n"));
    }
}
