//! `meldscope bench`: performance and accuracy benchmarks.

mod models;
mod record;
mod scale;

use std::{
    fs::File,
    io::Read as _,
    path::{Path, PathBuf},
};

use rayon::prelude::*;

use super::{
    Failure, print_lines as print,
    progress::{Progress, Work},
    run::scene,
};
use crate::{
    bench::{
        MeasureError,
        error::{self, Settings, csv::csv, diagram, random, table},
        machine::Machine,
        output::Output,
        stability::{self, cases::Case, drift, free, models as of_models, sizes, table as of_stability},
        surface,
    },
    models::need_oscillators,
    scene::{Integrator, Model, Scene},
    sim::memory,
    text::thousands,
};

#[derive(clap::Args)]
pub struct Arguments {
    #[command(subcommand)]
    what: What,
}

// To add a benchmark: a variant here, a function below, and a module in `bench`.
#[derive(clap::Subcommand)]
enum What {
    /// Error against run time: every integrator, over a range of step sizes, against an independent solution.
    Error(ErrorArguments),
    /// Step cost against scene size: 2 to 100,000 bodies, of which all, one in a hundred, or two are in contact.
    Scale(scale::Arguments),
    /// Recording cost: frames per second, bytes per frame, slow-down of the simulation, cost of verification.
    Record(record::Arguments),
    /// Models of a soft body side by side: cost, error, stability, volume, and when two bodies merged.
    Models(models::Arguments),
    /// Merged surfaces: time per frame of unions of 2 to 300 bodies, and frames per second of a scene.
    Surface,
    /// Stress sweep: thousands of small scenes at the limits of every setting, with every integrator.
    Stability(StabilityArguments),
}

#[derive(clap::Args)]
struct ErrorArguments {
    /// Scene files, or names of built-in scenes (see `meldscope scenes`).
    #[arg(default_values = ["push", "two", "three", "size_ratio", "collide", "orbit", "drop"])]
    scene: Vec<String>,
    /// Instead of scenes, compare the errors of N random short ones with what was asked: contacts, rims, cores, planes up
    /// to 1e5, sizes to 1:50, masses to 1:1000, free bodies and paths.
    #[arg(long, value_name = "N", conflicts_with_all = ["scene", "csv", "svg"],
          value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    random: Option<u64>,
    /// Seed of the random scenes.
    #[arg(long, value_name = "S", requires = "random", default_value_t = 1)]
    seed: u64,
    /// Tolerance of the random scenes, radii per second.
    #[arg(long, value_name = "T", requires = "random", default_value_t = Scene::DEFAULT_TOLERANCE, value_parser = tolerance)]
    tolerance: f64,
    /// Write the random scenes that miss to files in this folder, for `meldscope bench error FILE`.
    #[arg(long, value_name = "DIR", requires = "random")]
    out: Option<PathBuf>,
    #[command(flatten)]
    files: Files,
}

/// Where measurements are written besides standard output.
#[derive(clap::Args)]
struct Files {
    /// Write the measurements to a CSV file.
    #[arg(long, value_name = "F.csv")]
    csv: Option<PathBuf>,
    /// Draw the measurements as an SVG diagram.
    #[arg(long, value_name = "F.svg")]
    svg: Option<PathBuf>,
}

impl Files {
    /// Claims the requested files.
    fn claim(&self, csv_mark: &str, svg_mark: &str) -> Result<[Option<Output>; 2], Failure> {
        let [csv, svg] = [claim(self.csv.as_deref(), csv_mark)?, claim(self.svg.as_deref(), svg_mark)?];
        if csv.is_some() && csv == svg {
            return Err(Failure::Input("--csv and --svg name the same file: give each its own".to_owned()));
        }
        Ok([csv, svg])
    }
}

#[derive(clap::Args)]
struct StabilityArguments {
    /// Number of cases to run.
    #[arg(long, value_name = "N", default_value_t = stability::Settings::default().cases,
          value_parser = clap::value_parser!(u64).range(1..=stability::MOST_CASES))]
    cases: u64,
    /// Run this integrator only.
    #[arg(long, value_parser = super::run::parse_integrator, value_name = "thesis|mps|euler|verlet|rk4|exponential")]
    integrator: Option<Integrator>,
    /// Run the cases with this model, and show which of them are stable.
    #[arg(long, value_parser = crate::models::parse, value_name = "metaballs|lattice|fem",
          conflicts_with_all = ["integrator", "case", "csv"])]
    model: Option<Model>,
    /// Run a single case and show its details.
    #[arg(long, value_name = "N", conflicts_with_all = ["cases", "csv"],
          value_parser = clap::value_parser!(u64).range(0..stability::MOST_CASES))]
    case: Option<u64>,
    /// Write the scene of that case to a file, for `meldscope run`.
    #[arg(long, value_name = "F.toml", requires = "case")]
    write: Option<PathBuf>,
    /// Write the outcome of every case to a CSV file.
    #[arg(long, value_name = "F.csv")]
    csv: Option<PathBuf>,
}

/// Runs a benchmark.
pub fn bench(arguments: Arguments) -> Result<(), Failure> {
    match arguments.what {
        What::Error(arguments) => error(arguments),
        What::Scale(arguments) => scale::scale(arguments),
        What::Record(arguments) => record::record(arguments),
        What::Models(arguments) => models::models(arguments),
        What::Surface => surface(),
        What::Stability(arguments) => stability(arguments),
    }
}

fn surface() -> Result<(), Failure> {
    print(&surface::table(&surface::measure()));
    print("");
    for name in ["two", "crowd"] {
        let surface::Run { merged, plain, share, costs } = surface::run(&scene(name)?).map_err(Failure::Run)?;
        print(&format!(
            "{name}, stepped and observed: {} frames/s with surfaces and measures, {} without; {:.0} % of the frames have a \
             group and cost {:.3} ms, the others {:.3} ms",
            thousands(merged as u64),
            thousands(plain as u64),
            100.0 * share,
            1e3 * costs[1],
            1e3 * costs[0]
        ));
    }
    print(&Machine::detect().to_string());
    Ok(())
}

/// A tolerance that asks for error control.
fn tolerance(text: &str) -> Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|number| (1e-12..=1e-2).contains(number));
    number.ok_or_else(|| "expected radii per second, from 1e-12 to 1e-2".to_owned())
}

fn random_errors(count: u64, arguments: &ErrorArguments) -> Result<(), Failure> {
    let settings = random::Settings { count, seed: arguments.seed, tolerance: arguments.tolerance };
    if let Some(folder) = &arguments.out {
        std::fs::create_dir_all(folder).map_err(|error| unwritable(folder, &error))?;
    }
    let progress = Progress::new("random scenes", Work::Units("scene", Some(count)));
    let outcomes = random::measure(&settings, &|| progress.add(1));
    drop(progress);
    let outcomes = outcomes.map_err(|error| Failure::Run(error.to_string()))?;
    for outcome in &outcomes {
        if outcome.factor <= 1.0 && !outcome.is_underestimated && outcome.failure.is_none() {
            continue;
        }
        print(&outcome.to_string());
        if let Some(folder) = &arguments.out {
            let path = folder.join(format!("{}.toml", outcome.scene.name));
            let text = format!("{WRITTEN} error`.\n{}", outcome.scene.source);
            write(claim(Some(&path), WRITTEN)?, || Ok(text))?;
        }
    }
    let counts = random::Counts::of(&outcomes);
    print(&format!("tolerance {:.0e}, seed {}: {counts}", settings.tolerance, settings.seed));
    if counts.are_met() {
        return Ok(());
    }
    Err(Failure::Run(
        "asked are errors below tolerance × time in 99 of 100 scenes, and below the sum of the estimates in 95"
            .to_owned(),
    ))
}

fn error(arguments: ErrorArguments) -> Result<(), Failure> {
    if let Some(count) = arguments.random {
        return random_errors(count, &arguments);
    }
    let scenes = arguments.scene.iter().map(|name| scene(name)).collect::<Result<Vec<_>, _>>()?;
    for scene in &scenes {
        memory::check(scene).map_err(Failure::input)?;
        need_oscillators(scene, "bench error").map_err(Failure::input)?;
    }
    let [csv_file, svg_file] = arguments.files.claim("scene,vertices,integrator,", "Work and precision")?;

    let machine = Machine::detect();
    let mut reports = vec![];
    for scene in &scenes {
        let progress = Progress::new(format!("measuring {}", scene.name), Work::Share);
        let measured = error::measure(scene, &Settings::of(scene), &mut |share| progress.set_share(share));
        drop(progress);
        let report = measured.map_err(|error| match error {
            MeasureError::Failed(_) | MeasureError::Threads(_) => Failure::Run(error.to_string()),
            error => Failure::Input(format!("scene {}: {error}", scene.name)),
        })?;
        print(&table::table(&report));
        print("");
        reports.push(report);
    }
    print(&table::footer(&machine));

    write(csv_file, || csv(&reports, &machine))?;
    write(svg_file, || diagram::svg(&reports, &machine))
}

fn stability(arguments: StabilityArguments) -> Result<(), Failure> {
    if let Some(model) = arguments.model.filter(|model| *model != Model::Oscillators) {
        return stability_of(model, arguments.cases);
    }
    let integrators = arguments.integrator.map_or(Integrator::ALL.to_vec(), |integrator| vec![integrator]);
    let settings = stability::Settings { cases: arguments.cases, integrators, ..stability::Settings::default() };
    if let Some(index) = arguments.case {
        return one_case(index, arguments.write.as_deref(), &settings);
    }
    let csv_file = claim(arguments.csv.as_deref(), "case,axis,what,")?;
    let failed = |error: MeasureError| Failure::Run(error.to_string());
    let clock = std::time::Instant::now();

    let progress = Progress::new("stability", Work::Units("case", Some(settings.cases)));
    let rows = stability::sweep(&settings, &|done| progress.set(done));
    drop(progress);
    let rows = rows.map_err(failed)?;
    let swept = clock.elapsed().as_secs_f64();
    for part in [of_stability::by_integrator, of_stability::by_axis, of_stability::worst_cases, of_stability::extremes]
    {
        print(&format!("{}\n", part(&rows)));
    }
    print(&of_stability::footer());

    let progress = Progress::new("energy over a million steps, sizes, free bodies", Work::Uncounted);
    let drift = |&integrator: &Integrator| drift::measure(integrator, drift::STEPS);
    let drifts = settings.integrators.par_iter().map(drift).collect::<Result<Vec<_>, _>>().map_err(failed)?;
    print(&format!("\n{}", of_stability::energy(&drifts)));
    print(&format!("\n{}", of_stability::sizes(&sizes::measure().map_err(failed)?)));
    let free_rows = free::measure(&settings.integrators).map_err(failed)?;
    drop(progress);
    print(&format!("\n{}", free::table(&free_rows)));
    for failure in settings.integrators.iter().flat_map(|&of| free::failures(&free_rows, of)) {
        print(&failure);
    }
    let whole = clock.elapsed().as_secs_f64();
    print(&format!("\n{}; {whole:.0} s, of which the cases took {swept:.0} s", Machine::detect().at_full_load()));
    write(csv_file, || of_stability::csv(&rows))?;

    if drifts.iter().any(|drift| drift.integrator == Integrator::Exponential && !drift.is_small()) {
        return Err(Failure::Run("exponential does not conserve energy over a million steps".to_owned()));
    }
    if let Some(row) = free_rows.iter().find(|row| row.is_defect()) {
        let (axis, what) = (row.case.axis.name(), &row.case.what);
        return Err(Failure::Run(format!("exponential fails with free bodies: {axis}, {what}")));
    }
    verdict(&rows)
}

fn stability_of(model: Model, cases: u64) -> Result<(), Failure> {
    let progress = Progress::new(model.name(), Work::Units("case", Some(cases)));
    let ends = of_models::measure(model, cases, &|| progress.add(1));
    drop(progress);
    let ends = ends.map_err(|error| Failure::Run(error.to_string()))?;
    print(&format!("{model}\n\n{}\n{}", of_models::table(&ends), Machine::detect().at_full_load()));
    let defects: Vec<_> = (0..).zip(&ends).filter(|(_, (_, end))| *end == of_models::End::Defect).collect();
    match defects.first() {
        Some((first, _)) => Err(Failure::Run(format!("{model} fails {} cases, first case {first}", defects.len()))),
        None => Ok(()),
    }
}

/// The default integrator must pass every case; failures of the others are only reported.
fn verdict(rows: &[stability::Row]) -> Result<(), Failure> {
    let is_defective = |row: &&stability::Row| row.outcomes.iter().any(stability::Outcome::is_defect);
    let failed: Vec<_> = rows.iter().filter(is_defective).map(|row| row.case.index.to_string()).collect();
    match failed.len() {
        0 => Ok(()),
        1 => Err(Failure::Run(format!("exponential fails case {}", failed.concat()))),
        n => Err(Failure::Run(format!("exponential fails {n} cases: {}", failed.join(", ")))),
    }
}

fn one_case(index: u64, file: Option<&Path>, settings: &stability::Settings) -> Result<(), Failure> {
    let file = claim(file, WRITTEN)?;
    let case = Case::new(index).map_err(|error| Failure::Run(error.to_string()))?;
    print(&case.scene.source);
    write(file, || Ok(format!("{WRITTEN} stability`, case {index}.\n{}", case.scene.source)))?;
    let row = stability::run(case, settings).map_err(|error| Failure::Run(error.to_string()))?;
    print(&of_stability::one_case(&row));
    verdict(&[row])
}

/// First words of the scene files that benchmarks write.
const WRITTEN: &str = "# Written by `meldscope bench";
/// Number of bytes within which a file written by a benchmark has its mark.
const HEAD: u64 = 4096;

/// Checks the output path before anything is measured. Rejects a path that cannot be written, and an existing file that
/// this benchmark did not write: one without `mark` near its beginning.
fn claim(path: Option<&Path>, mark: &str) -> Result<Option<Output>, Failure> {
    let Some(path) = path else { return Ok(None) };
    let output = Output::claim(path).map_err(|error| unwritable(path, &error))?;
    if path.is_file() {
        let mut head = Vec::new();
        let read = File::open(path).and_then(|file| file.take(HEAD).read_to_end(&mut head));
        read.map_err(|error| unwritable(path, &error))?;
        if !head.is_empty() && !String::from_utf8_lossy(&head).contains(mark) {
            let path = path.display();
            return Err(Failure::Input(format!(
                "{path} was not written by this benchmark and is not replaced; write elsewhere or remove it first"
            )));
        }
    }
    Ok(Some(output))
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
