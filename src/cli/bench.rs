//! `meldscope bench`: what it costs, and what it is worth.

mod scale;

use std::path::{Path, PathBuf};

use indicatif::{ProgressBar, ProgressStyle};

use super::{Failure, print, run::scene};
use crate::{
    bench::{
        error::{self, MeasureError, Settings, csv::csv, diagram, table},
        machine::Machine,
        output::Output,
    },
    sim::memory,
};

#[derive(clap::Args)]
pub struct Arguments {
    #[command(subcommand)]
    what: What,
}

// A benchmark is a variant here, a function below, and a module of `bench`.
#[derive(clap::Subcommand)]
enum What {
    /// Error against run time: every integrator, over a range of steps, against an independent solution.
    Error(ErrorArguments),
    /// Cost against size: scenes of 2 to 100,000 bodies, of which all, one in a hundred or two touch.
    Scale(scale::Arguments),
}

#[derive(clap::Args)]
struct ErrorArguments {
    /// Scene files, or names of built-in scenes (see `meldscope scenes`).
    #[arg(default_values = ["push", "two", "three", "size_ratio"])]
    scene: Vec<String>,
    /// Write the measurements to a file.
    #[arg(long, value_name = "F.csv")]
    csv: Option<PathBuf>,
    /// Draw the work-precision diagram.
    #[arg(long, value_name = "F.svg")]
    svg: Option<PathBuf>,
}

/// Runs a benchmark.
pub fn bench(arguments: Arguments) -> Result<(), Failure> {
    match arguments.what {
        What::Error(arguments) => error(arguments),
        What::Scale(arguments) => scale::scale(arguments),
    }
}

fn error(arguments: ErrorArguments) -> Result<(), Failure> {
    let scenes = arguments.scene.iter().map(|name| scene(name)).collect::<Result<Vec<_>, _>>()?;
    for scene in &scenes {
        memory::check(scene).map_err(Failure::input)?;
    }
    let [csv_file, svg_file] = [claim(arguments.csv.as_deref())?, claim(arguments.svg.as_deref())?];
    if csv_file.is_some() && csv_file == svg_file {
        return Err(Failure::Input("--csv and --svg name the same file: give each its own".to_owned()));
    }

    let machine = Machine::detect();
    let mut reports = vec![];
    for scene in &scenes {
        let bar = progress_bar(&scene.name);
        let mut progress = |share: f64| bar.set_position((1000.0 * share) as u64);
        let measured = error::measure(scene, &Settings::of(scene), &mut progress);
        bar.finish_and_clear();
        let report = measured.map_err(|error| match error {
            MeasureError::TooLong(_) | MeasureError::TooLarge(_) => {
                Failure::Input(format!("scene {}: {error}", scene.name))
            }
            MeasureError::Thread(_) => Failure::Run(error.to_string()),
        })?;
        print(&table::table(&report));
        print("");
        reports.push(report);
    }
    print(&table::footer(&machine));

    write(csv_file, || Ok(csv(&reports, &machine)))?;
    write(svg_file, || diagram::svg(&reports, &machine))
}

/// Shows on a terminal how far the measurements are, and nothing where standard error is no terminal.
fn progress_bar(scene: &str) -> ProgressBar {
    let bar = ProgressBar::new(1000).with_message(format!("measuring {scene}"));
    if let Ok(style) = ProgressStyle::with_template("{msg} {bar:40} {percent} %, {eta} left") {
        bar.set_style(style);
    }
    bar.tick();
    bar
}

/// Refuses what cannot be written before anything is measured.
fn claim(path: Option<&Path>) -> Result<Option<Output>, Failure> {
    path.map(|path| Output::claim(path).map_err(|error| unwritable(path, &error))).transpose()
}

fn write(file: Option<Output>, text: impl FnOnce() -> Result<String, String>) -> Result<(), Failure> {
    let Some(file) = file else { return Ok(()) };
    let text = text().map_err(|error| Failure::Run(format!("cannot draw {}: {error}", file.path().display())))?;
    file.write(&text).map_err(|error| unwritable(file.path(), &error))?;
    super::say(&format!("wrote {}", file.path().display()));
    Ok(())
}

fn unwritable(path: &Path, error: &std::io::Error) -> Failure {
    Failure::Run(format!("cannot write {}: {error}; write it elsewhere", path.display()))
}
