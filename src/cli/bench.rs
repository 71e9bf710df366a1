//! `meldscope bench`: performance and accuracy benchmarks.

use std::{
    fs::File,
    io::{Read as _, Write as _},
    path::{Path, PathBuf},
    time::Duration,
};

use rayon::prelude::*;

use super::{
    Failure, announce, may_save, print, print_lines,
    progress::{Progress, Work},
    run::scene,
    say,
};
use crate::{
    atomic::{self, AtomicFile},
    bench::{
        MeasureError, error, models, random, record,
        report::{self, Column, Machine, Report},
        scale,
        stability::{self, cases::Case, drift, free},
        surface,
    },
    models::{need_oscillators, side_by_side::SideBySide},
    observe::Experiment as _,
    recording::existing::{Existing, Kind},
    scene::{Integrator, Model, Scene},
    sim::{Options, memory},
    stream::{self, Settings, settings::application, sinks::Destinations},
    table::{self, TableError},
    text::counted,
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
    Scale(ScaleArguments),
    /// Recording cost: frames per second, bytes per frame, cost of verification.
    Record(RecordArguments),
    /// Models of a soft body side by side: cost, error, stability, volume, and when two bodies merged.
    Models(ModelsArguments),
    /// Merged surfaces: time of unions of 2 to 300 bodies.
    Surface,
    /// Stress sweep: thousands of small scenes at the limits of every setting, with every integrator.
    Stability(StabilityArguments),
}

/// Where measurements are written besides standard output.
#[derive(clap::Args, Default)]
struct Files {
    /// Write the measurements to a table: .csv, .json or .parquet.
    #[arg(long, value_name = "F.csv")]
    csv: Option<PathBuf>,
    /// Draw the measurements as an SVG diagram.
    #[arg(long, value_name = "F.svg")]
    svg: Option<PathBuf>,
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

#[derive(clap::Args)]
struct ScaleArguments {
    /// Numbers of bodies, each from 2 to a million.
    #[arg(long, value_name = "N", num_args = 1.., default_values = ["2", "10", "100", "1000", "10000", "100000"],
          value_parser = clap::value_parser!(u32).range(2..=1_000_000))]
    bodies: Vec<u32>,
    /// Seconds of timed steps per combination of body count, scene family, and one core or all.
    #[arg(long, value_name = "S", default_value = "0.5", value_parser = seconds)]
    seconds: f64,
    #[command(flatten)]
    files: Files,
}

#[derive(clap::Args)]
struct RecordArguments {
    /// Scene files, or names of built-in scenes (see `meldscope scenes`).
    #[arg(default_values = ["two", "crowd"])]
    scene: Vec<String>,
    /// Write the rates and sizes to a table: .csv, .json or .parquet.
    #[arg(long, value_name = "F.csv")]
    csv: Option<PathBuf>,
}

#[derive(clap::Args)]
struct ModelsArguments {
    /// Scene files, or names of built-in scenes (see `meldscope scenes`).
    #[arg(default_values = ["two"])]
    scene: Vec<String>,
    /// Record all models of the first scene side by side, aligned in time.
    #[arg(long, value_name = "F.rrd")]
    save: Option<PathBuf>,
    #[command(flatten)]
    files: Files,
}

#[derive(clap::Args)]
struct StabilityArguments {
    /// Number of cases to run.
    #[arg(long, value_name = "N", default_value_t = 4000, value_parser = clap::value_parser!(u64).range(1..=MAX_CASES))]
    cases: u64,
    /// Run this integrator only.
    #[arg(long, value_parser = super::run::parse_integrator, value_name = "thesis|mps|euler|verlet|rk4|exponential")]
    integrator: Option<Integrator>,
    /// Run the cases with this model instead of the integrators.
    #[arg(long, value_parser = other_model, value_name = "metaballs|lattice|fem",
          conflicts_with_all = ["integrator", "case", "csv"])]
    model: Option<Model>,
    /// Run a single case, and show its scene and its details.
    #[arg(long, value_name = "N", conflicts_with_all = ["cases", "csv"],
          value_parser = clap::value_parser!(u64).range(0..MAX_CASES))]
    case: Option<u64>,
    /// Write the outcome of every case to a table: .csv, .json or .parquet.
    #[arg(long, value_name = "F.csv")]
    csv: Option<PathBuf>,
}

/// Maximum number of cases of the stress sweep.
const MAX_CASES: u64 = 1_000_000;

fn tolerance(text: &str) -> Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|number| (1e-12..=1e-2).contains(number));
    number.ok_or_else(|| "expected radii per second, from 1e-12 to 1e-2".to_owned())
}

fn seconds(text: &str) -> Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|number| (0.001..=60.0).contains(number));
    number.ok_or_else(|| "expected 0.001 to 60 seconds".to_owned())
}

fn other_model(text: &str) -> Result<Model, String> {
    match crate::models::parse(text)? {
        Model::Oscillators => {
            Err("the oscillators are what the integrators solve: leave --model out, or name an --integrator".to_owned())
        }
        model => Ok(model),
    }
}

/// Runs a benchmark.
pub fn bench(arguments: Arguments) -> Result<(), Failure> {
    match arguments.what {
        What::Error(ErrorArguments { random: Some(count), seed, tolerance, out, .. }) => {
            random(&random::Settings { count, seed, tolerance }, out.as_deref())
        }
        What::Error(arguments) => error(arguments),
        What::Scale(arguments) => scale(arguments),
        What::Record(arguments) => record(arguments),
        What::Models(arguments) => models(arguments),
        What::Surface => Claimed::default().finish(&surface::report(&surface::measure()), &Machine::detect()),
        What::Stability(arguments) => stability(arguments),
    }
}

fn error(arguments: ErrorArguments) -> Result<(), Failure> {
    let scenes = oscillators(&arguments.scene, "bench error")?;
    let claimed = arguments.files.claim(&error::columns())?;
    let mut measured = vec![];
    for scene in &scenes {
        let progress = Progress::new(format!("measuring {}", scene.name), Work::Share);
        let of_scene = error::measure(scene, &error::Settings::of(scene), &mut |share| progress.set_share(share));
        measured.push(of_scene.map_err(|error| match error {
            MeasureError::Failed(_) | MeasureError::Threads(_) => Failure::Run(error.to_string()),
            error => Failure::Input(format!("scene {}: {error}", scene.name)),
        })?);
    }
    let machine = Machine::detect();
    claimed.finish(&error::report(&measured, &machine), &machine)
}

fn random(settings: &random::Settings, folder: Option<&Path>) -> Result<(), Failure> {
    if let Some(folder) = folder {
        std::fs::create_dir_all(folder).map_err(|error| unwritable(folder, &error))?;
    }
    let progress = Progress::new("random scenes", Work::Units("scene", Some(settings.count)));
    let outcomes = random::measure(settings, &|| progress.add(1)).map_err(|error| Failure::Run(error.to_string()))?;
    drop(progress);
    for outcome in outcomes.iter().filter(|outcome| outcome.is_listed()) {
        print(&outcome.to_string());
        if let Some(folder) = folder {
            let path = folder.join(format!("{}.toml", outcome.scene.name));
            let mut file = claim(&path, WRITTEN)?;
            let text = format!("{WRITTEN} error`.\n{}", outcome.scene.source);
            let written = file.write_all(text.as_bytes()).and_then(|()| file.commit());
            written.map_err(|error| unwritable(&path, &error))?;
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

fn scale(arguments: ScaleArguments) -> Result<(), Failure> {
    let claimed = arguments.files.claim(&scale::columns())?;
    let mut bodies: Vec<usize> = arguments.bodies.iter().map(|&n| n as usize).collect();
    bodies.sort_unstable();
    bodies.dedup();
    let settings = scale::Settings { bodies, time: Duration::from_secs_f64(arguments.seconds) };
    let progress = Progress::new("measuring scenes of all sizes", Work::Share);
    let measured = scale::measure(&settings, &mut |share| progress.set_share(share));
    drop(progress);
    let machine = Machine::detect();
    claimed.finish(&measured.map_err(|error| Failure::Run(error.to_string()))?.report(&machine), &machine)
}

fn record(arguments: RecordArguments) -> Result<(), Failure> {
    let scenes = oscillators(&arguments.scene, "bench record")?;
    let claimed = Files { csv: arguments.csv, svg: None }.claim(&record::columns())?;
    let (mut measurements, mut verifications) = (vec![], vec![]);
    for scene in &scenes {
        let _progress = Progress::new(format!("measuring {}", scene.name), Work::Uncounted);
        measurements.extend(record::measure(scene).map_err(Failure::Run)?);
        verifications.push(record::verify(scene).map_err(Failure::Run)?);
    }
    claimed.finish(&record::report(&measurements, &verifications), &Machine::detect())
}

fn models(arguments: ModelsArguments) -> Result<(), Failure> {
    let scenes = arguments.scene.iter().map(|name| scene(name)).collect::<Result<Vec<_>, _>>()?;
    let claimed = arguments.files.claim(&models::columns())?;
    if let (Some(path), [first, ..]) = (&arguments.save, scenes.as_slice()) {
        record_models(first, path)?;
    }
    let mut measured = Vec::new();
    for scene in &scenes {
        let progress = Progress::new(format!("measuring {}", scene.name), Work::Share);
        measured.push(models::measure(scene, &Model::ALL, &mut |share| progress.set_share(share)));
    }
    let machine = Machine::detect();
    claimed.finish(&models::report(&measured, &machine), &machine)
}

/// Records all models that can run a scene.
fn record_models(scene: &Scene, path: &Path) -> Result<(), Failure> {
    let all = SideBySide::all(scene, Options::default());
    let schema = all.schema();
    let new = Existing { application: application(&schema.name), kind: Some(Kind::Run) };
    may_save(path, &[], &new)?;
    announce(path, &new)?;
    let destinations = Destinations { save: Some(path.to_owned()), ..Destinations::default() };
    let settings = Settings::for_bodies(schema.bodies.len(), schema.steps);
    let _progress = Progress::new("recording all models", Work::Uncounted).with_file(path);
    let frames = stream::record(&all, settings, &destinations).map_err(|error| Failure::Run(error.to_string()))?;
    let names = schema.model.replace('+', ", ");
    print(&format!("saved {}: {}, {}\n", path.display(), counted(frames, "frame"), names));
    Ok(())
}

fn stability(arguments: StabilityArguments) -> Result<(), Failure> {
    let failed = |error: MeasureError| Failure::Run(error.to_string());
    let machine = Machine::detect();
    let progress = || Progress::new("stability", Work::Units("case", Some(arguments.cases)));
    if let Some(model) = arguments.model {
        let progress = progress();
        let judged = stability::models::measure(model, arguments.cases, &|| progress.add(1)).map_err(failed)?;
        drop(progress);
        return Claimed::default().finish(&stability::of_model(&judged), &machine);
    }
    let integrators = arguments.integrator.map_or(Integrator::ALL.to_vec(), |integrator| vec![integrator]);
    let settings = stability::Settings { cases: arguments.cases, integrators, most_steps: u64::MAX };
    if let Some(index) = arguments.case {
        let case = Case::new(index).map_err(|error| Failure::Run(error.to_string()))?;
        print_lines(&case.scene.source);
        let row = stability::run(case, &settings).map_err(failed)?;
        return Claimed::default().finish(&stability::of_case(&row), &machine);
    }
    let claimed = Files { csv: arguments.csv, svg: None }.claim(&stability::columns())?;
    let swept = progress();
    let rows = stability::sweep(&settings, &|| swept.add(1)).map_err(failed)?;
    drop(swept);
    let progress = Progress::new("energy over a million steps, free bodies", Work::Uncounted);
    let drift = |&integrator: &Integrator| drift::measure(integrator, drift::STEPS);
    let drifts = settings.integrators.par_iter().map(drift).collect::<Result<Vec<_>, _>>().map_err(failed)?;
    let free = free::measure(&settings.integrators).map_err(failed)?;
    drop(progress);
    claimed.finish(&stability::report(&rows, &drifts, &free), &machine)
}

/// Scenes that the benchmark `what` can run: of the default model, within the memory that there is.
fn oscillators(names: &[String], what: &str) -> Result<Vec<Scene>, Failure> {
    let scenes = names.iter().map(|name| scene(name)).collect::<Result<Vec<_>, _>>()?;
    for scene in &scenes {
        memory::check(scene).map_err(Failure::input)?;
        need_oscillators(scene, what).map_err(Failure::input)?;
    }
    Ok(scenes)
}

/// First words of the scene files that benchmarks write.
const WRITTEN: &str = "# Written by `meldscope bench";
/// What an SVG file of this program has near its beginning.
const DRAWN: &str = "<desc>meldscope</desc>";
/// Number of bytes within which a file has its mark.
const HEAD: u64 = 4096;

/// The files of a benchmark: begun before anything is measured, so that "permission denied" is reported at once instead
/// of after minutes, and put in place at the end.
#[derive(Default)]
struct Claimed {
    csv: Option<(PathBuf, table::Table)>,
    svg: Option<(PathBuf, AtomicFile)>,
}

impl Files {
    fn claim(self, columns: &[Column]) -> Result<Claimed, Failure> {
        if let (Some(csv), Some(svg)) = (&self.csv, &self.svg)
            && atomic::is_same_destination(csv, svg)
        {
            return Err(Failure::Input("--csv and --svg name the same file: give each its own".to_owned()));
        }
        let table = |path: PathBuf| match table::Table::create(&path, report::file_columns(columns)) {
            Ok(table) => Ok((path, table)),
            Err(TableError::Refused(why)) => Err(Failure::Input(why)),
            Err(TableError::Failed(why)) => Err(Failure::Run(why)),
        };
        let csv = self.csv.map(table).transpose()?;
        let svg = self.svg.map(|path| claim(&path, DRAWN).map(|file| (path, file))).transpose()?;
        Ok(Claimed { csv, svg })
    }
}

impl Claimed {
    /// Prints the results and writes them to the files. A benchmark that fails has printed and written them all.
    fn finish(self, report: &Report, machine: &Machine) -> Result<(), Failure> {
        for table in &report.tables {
            print_lines(&table.to_string());
        }
        if !report.notes.is_empty() {
            print_lines(&report.notes);
        }
        print(&machine.to_string());
        if let Some((path, table)) = self.csv {
            report::write(table, report, machine).map_err(|error| Failure::Run(error.to_string()))?;
            say(&format!("wrote {}", path.display()));
        }
        if let (Some((path, mut file)), Some(chart)) = (self.svg, &report.chart) {
            let written = file.write_all(chart.svg().as_bytes()).and_then(|()| file.commit());
            written.map_err(|error| unwritable(&path, &error))?;
            say(&format!("wrote {}", path.display()));
        }
        report.failure.as_ref().map_or(Ok(()), |failure| Err(Failure::Run(failure.clone())))
    }
}

/// Begins a file. Rejects a path that cannot be written, and an existing file without `mark` near its beginning.
fn claim(path: &Path, mark: &str) -> Result<AtomicFile, Failure> {
    if path.is_dir() {
        return Err(unwritable(path, &std::io::ErrorKind::IsADirectory.into()));
    }
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
    AtomicFile::create(path).map_err(|error| unwritable(path, &error))
}

fn unwritable(path: &Path, error: &std::io::Error) -> Failure {
    Failure::Run(format!("cannot write {}: {error}; write it elsewhere", path.display()))
}
