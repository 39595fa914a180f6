//! `packlab curve`: how trainings went, as a picture.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;
use report::{Line, LineChart, line_charts, standalone};

use crate::output;

/// The learning curves to draw, and where to.
#[derive(Debug, Args)]
pub(crate) struct CurveArgs {
    /// Learning curves of one recipe, as `packlab train --curve` writes them.
    #[arg(value_name = "FILE.csv", required = true)]
    curves: Vec<PathBuf>,
    /// The picture to write.
    #[arg(long, value_name = "FILE")]
    svg: PathBuf,
    /// Episodes over which the training's own figures are averaged.
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..))]
    mean_of: u32,
}

/// One training's figures, each with its episode or generation.
#[derive(Debug, Default, PartialEq)]
struct Curve {
    name: String,
    /// What counts from left to right: episode or generation.
    counter: String,
    fill_percent: Vec<(f64, f64)>,
    ratio: Vec<(f64, f64)>,
    validation_fill_percent: Vec<(f64, f64)>,
    validation_ratio: Vec<(f64, f64)>,
}

/// Runs the command.
///
/// # Errors
/// Names the file and the line that cannot be read.
pub(crate) fn run(args: &CurveArgs) -> anyhow::Result<()> {
    let curves = args.curves.iter().map(|path| read(path)).collect::<anyhow::Result<Vec<_>>>()?;
    let counter = curves[0].counter.clone();
    let other = curves.iter().find(|curve| curve.counter != counter);
    if let Some(Curve { name, counter: theirs, .. }) = other {
        anyhow::bail!("{name} counts {theirs}s and {} {counter}s: draw each recipe by itself", curves[0].name);
    }
    output::write(&args.svg, &standalone(&draw(&curves, &counter, args.mean_of as usize)))
}

fn draw(curves: &[Curve], counter: &str, mean_of: usize) -> String {
    let lines = |training: fn(&Curve) -> &[(f64, f64)], validation: fn(&Curve) -> &[(f64, f64)]| {
        let line = |curve: &Curve, points, dots| Line { name: curve.name.clone(), points, dots };
        let trained = curves.iter().map(|curve| line(curve, running_mean(training(curve), mean_of), false));
        let validated = curves.iter().map(|curve| line(curve, validation(curve).to_vec(), true));
        trained.filter(|line| !line.points.is_empty()).chain(validated).collect()
    };
    let charts = [
        LineChart {
            x: counter,
            y: "fill of the first Opt containers [%]",
            lines: lines(|curve| &curve.fill_percent, |curve| &curve.validation_fill_percent),
        },
        LineChart {
            x: counter,
            y: "containers used / Opt",
            lines: lines(|curve| &curve.ratio, |curve| &curve.validation_ratio),
        },
    ];
    let validation = "Dots: greedy choices on validation episodes.";
    let has_training = curves.iter().any(|curve| !curve.fill_percent.is_empty());
    let training = format!("Lines: training episodes, mean of {mean_of}. ");
    line_charts(&charts, &if has_training { training + validation } else { validation.to_owned() })
}

/// Means of as many points as `count`, or as there are, about ten to each stretch of that length.
fn running_mean(points: &[(f64, f64)], count: usize) -> Vec<(f64, f64)> {
    let count = count.min(points.len()).max(1);
    let mean = |window: &[(f64, f64)]| {
        let sum = window.iter().fold((0.0, 0.0), |(x, y), point| (x + point.0, y + point.1));
        (sum.0 / window.len() as f64, sum.1 / window.len() as f64)
    };
    points.windows(count).step_by((count / 10).max(1)).map(mean).collect()
}

fn read(path: &Path) -> anyhow::Result<Curve> {
    let named = || format!("learning curve {}", path.display());
    let text = std::fs::read_to_string(path).with_context(|| format!("{} cannot be read", named()))?;
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    parse(&name, &text).with_context(named)
}

fn parse(name: &str, text: &str) -> anyhow::Result<Curve> {
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let header = reader.headers()?.clone();
    let column = |name: &str| header.iter().position(|column| column == name);
    let is_curve = matches!(header.get(0), Some("episode" | "generation")) && column("validation_c").is_some();
    anyhow::ensure!(is_curve, "is not one that packlab train --curve wrote: its columns are {header:?}");
    let mut curve = Curve { name: name.to_owned(), counter: header[0].to_owned(), ..Curve::default() };
    for (row, line) in reader.records().zip(2..) {
        let row = row?;
        let number = |column: usize| {
            let text = row.get(column).unwrap_or_default();
            let bad = || format!("line {line}: {text:?} under {:?} is no number", &header[column]);
            if text.is_empty() { Ok(None) } else { text.parse::<f64>().map(Some).with_context(bad) }
        };
        let counted = number(0)?.with_context(|| format!("line {line}: no number under {:?}", &header[0]))?;
        let push = |points: &mut Vec<(f64, f64)>, name: &str, factor: f64| {
            let value = column(name).map(number).transpose()?.flatten();
            points.extend(value.map(|value| (counted, factor * value)));
            anyhow::Ok(())
        };
        push(&mut curve.fill_percent, "fill", 100.0)?;
        push(&mut curve.ratio, "c", 1.0)?;
        push(&mut curve.validation_fill_percent, "validation_fill", 100.0)?;
        push(&mut curve.validation_ratio, "validation_c", 1.0)?;
    }
    Ok(curve)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_is_read_by_its_columns() {
        let text =
            "episode,epsilon,loss,c,fill,validation_c,validation_fill\n0,1,1e-3,1.5,0.5,,\n1,1,1e-3,1.3,0.7,1.4,0.86\n";
        let curve = parse("seed-1", text).unwrap();
        assert_eq!(curve.counter, "episode");
        assert_eq!(curve.ratio, [(0.0, 1.5), (1.0, 1.3)]);
        assert_eq!(curve.validation_fill_percent, [(1.0, 86.0)]);
        let svg = draw(&[curve], "episode", 50);
        assert!(svg.contains(">seed-1</text>") && svg.contains("mean of 50. Dots"), "{svg}");
        let best = parse("best", "generation,step,validation_c,validation_fill\n10,0.3,1.3,0.9\n").unwrap();
        assert!(best.fill_percent.is_empty());
        assert!(!draw(&[best], "generation", 50).contains("mean of"));
    }

    #[test]
    fn what_is_no_curve_is_refused_with_its_line() {
        let message = |text: &str| format!("{:#}", parse("x", text).unwrap_err());
        assert!(message("l,b,h\n1,2,3\n").contains("packlab train --curve"));
        let header = "generation,step,validation_c,validation_fill\n";
        assert!(message(&format!("{header}10,0.3,1.3,0.9\n20,0.3,much,0.9\n")).contains("line 3: \"much\" under"));
        assert!(message(&format!("{header}10,0.3\n")).contains("found record with 2 fields"));
    }

    /// Of the points 0, 2, 4, 6 in pairs: 1, 3, 5.
    #[test]
    fn a_running_mean_by_hand() {
        let points = [(0.0, 0.0), (1.0, 2.0), (2.0, 4.0), (3.0, 6.0)];
        assert_eq!(running_mean(&points, 2), [(0.5, 1.0), (1.5, 3.0), (2.5, 5.0)]);
        assert_eq!(running_mean(&points, 100), [(1.5, 3.0)]);
        assert_eq!(running_mean(&[], 100), []);
    }
}
