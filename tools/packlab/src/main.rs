//! `packlab`: research without a cell. It makes boxes, judges methods and learns models on what the services run.
#![expect(clippy::print_stdout, reason = "tables are its work")]

mod curve;
mod evaluate;
mod generate;
mod method;
mod output;
mod published;
mod simulate;
mod source;
mod study;
mod train;
mod trial;

use clap::Parser;

/// Makes boxes, judges packing methods on them and learns models; needs no running cell.
#[derive(Parser)]
#[command(version)]
enum Command {
    /// Write episodes of a named data set to a file.
    Generate(generate::GenerateArgs),
    /// Run methods on the same episodes and compare them.
    Evaluate(evaluate::EvaluateArgs),
    /// Learn a model and write it to a file.
    Train(train::TrainArgs),
    /// Draw the learning curves of trainings.
    Curve(curve::CurveArgs),
    /// Play packing plans with rigid bodies: what collides, moves, tilts and falls.
    Simulate(simulate::SimulateArgs),
    /// Answer a question that takes many packings.
    Study(study::StudyArgs),
}

fn main() -> anyhow::Result<()> {
    match Command::parse() {
        Command::Generate(args) => generate::run(&args),
        Command::Evaluate(args) => evaluate::run(&args),
        Command::Train(args) => train::run(&args),
        Command::Curve(args) => curve::run(&args),
        Command::Simulate(args) => simulate::run(&args),
        Command::Study(args) => study::run(&args),
    }
}
