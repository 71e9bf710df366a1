//! `meldscope bench`: performance and accuracy benchmarks.

use std::{
    io::Write as _,
    path::{Path, PathBuf},
    time::Duration,
};

use rayon::prelude::*;

use super::{
    Failure, is_marked, is_quiet,
    load::scene,
    may_save,
    overrides::Overrides,
    print, print_lines,
    progress::{Progress, Work},
    say, say_note,
};
use crate::{
    atomic::{self, AtomicFile},
    bench::{
        MeasureError, error, models, record,
        report::{self, Column, Machine, Report},
        scale,
        stability::{self, cases::Case, drift, free},
        surface, thesis,
    },
    models::{need_oscillators, side_by_side::SideBySide},
    observe::Experiment,
    recording::existing::{Existing, Kind},
    scene::{Integrator, Model, Scene, template::Override},
    sim::{Options, memory},
    stream::{self, Settings, settings::application, sinks::Destinations},
    table::{self, TableError},
    text::counted,
};

#[derive(clap::Args)]
pub struct Arguments {
    /// What to measure.
    what: What,
    /// Scene files, or names of built-in scenes; of `scale`, numbers of bodies; of `stability`, a case, to show it.
    #[arg(value_name = "SCENE")]
    of: Vec<String>,
    /// Another value for a key of the scenes, such as tolerance=1e-9; may be repeated.
    #[arg(long, value_name = "KEY=VALUE", value_parser = Override::parse)]
    set: Vec<Override>,
    /// Number of cases of `stability` [default: 4000].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=MAX_CASES))]
    random: Option<u64>,
    /// Record the first scene of `models` with all of them side by side.
    #[arg(long, value_name = "F.rrd")]
    save: Option<PathBuf>,
    /// Write the measurements to a table: .csv, .json or .parquet.
    #[arg(long, value_name = "F.csv")]
    csv: Option<PathBuf>,
    /// Draw the measurements of `error`, `scale` or `models`, or Fig. 3.3 of the thesis, as an SVG diagram.
    #[arg(long, value_name = "F.svg")]
    svg: Option<PathBuf>,
}

// To add a benchmark: a variant here, a function below, and a module in `bench`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum What {
    /// Error against run time: every integrator, over a range of step sizes, against an independent solution.
    Error,
    /// Step cost against scene size: 2 to 100,000 bodies, of which all, one in a hundred, or two are in contact.
    Scale,
    /// Recording cost: frames per second, bytes per frame, cost of verification.
    Record,
    /// Models of a soft body side by side: cost, error, stability, volume, and when two bodies merged.
    Models,
    /// Merged surfaces: time of unions of 2 to 300 bodies.
    Surface,
    /// Stress sweep: thousands of small scenes at the limits of every setting, with every integrator.
    Stability,
    /// The thesis, section by section: its figures, claims and frame rates, beside what is measured here.
    Thesis,
}

/// Maximum number of random cases.
const MAX_CASES: u64 = 1_000_000;
/// Cases of the stress sweep, unless a number is given.
const CASES: u64 = 4000;
/// Duration of timed steps of `bench scale`, for each number of bodies, family and number of threads.
const TIMED: Duration = Duration::from_millis(500);

impl From<MeasureError> for Failure {
    fn from(error: MeasureError) -> Failure {
        Failure::Run(error.to_string())
    }
}

/// Runs a benchmark.
pub fn bench(arguments: Arguments) -> Result<(), Failure> {
    check(&arguments)?;
    match arguments.what {
        What::Error => error(&arguments),
        What::Scale => scale(&arguments),
        What::Record => record(&arguments),
        What::Models => models(&arguments),
        What::Surface => surface(&arguments),
        What::Stability => stability(&arguments),
        What::Thesis => thesis(&arguments),
    }
}

/// Rejects options that a benchmark does not have.
fn check(arguments: &Arguments) -> Result<(), Failure> {
    use What::{Error, Models, Record, Scale, Stability, Surface, Thesis};
    let Arguments { what, of, set, random, save, csv, svg } = arguments;
    let options = [
        (!of.is_empty(), "SCENE", &[Error, Scale, Record, Models, Stability][..]),
        (!set.is_empty(), "--set", &[Error, Record, Models]),
        (random.is_some(), "--random", &[Stability]),
        (save.is_some(), "--save", &[Models]),
        (csv.is_some(), "--csv", &[Error, Scale, Record, Models, Surface, Stability, Thesis]),
        (svg.is_some(), "--svg", &[Error, Scale, Models, Thesis]),
    ];
    let name =
        |what: &What| clap::ValueEnum::to_possible_value(what).map_or(String::new(), |v| v.get_name().to_owned());
    let bench = name(what);
    if let Some((_, option, has)) = options.iter().find(|(is_given, _, has)| *is_given && !has.contains(what)) {
        let has = has.iter().map(name).collect::<Vec<_>>().join(", ");
        return Err(Failure::Input(format!("`bench {bench}` has no {option}: it is for {has}")));
    }
    let conflicts = [
        (*what == Stability && of.len() > 1, "`bench stability` shows one case: give one number"),
        (
            !of.is_empty() && (random.is_some() || csv.is_some()) && *what == Stability,
            "a single case of `bench stability` is only shown: leave the other options out",
        ),
    ];
    match conflicts.into_iter().find(|(is_given, _)| *is_given) {
        Some((_, why)) => Err(Failure::Input(why.to_owned())),
        None => Ok(()),
    }
}

/// Numbers that are given in place of scenes.
fn numbers(of: &[String], range: std::ops::RangeInclusive<u64>, what: &str) -> Result<Vec<u64>, Failure> {
    let number = |text: &String| {
        let number = text.parse().ok().filter(|number| range.contains(number));
        let expected = || format!("{text:?}: expected {what}, from {} to {}", range.start(), range.end());
        number.ok_or_else(|| Failure::Input(expected()))
    };
    of.iter().map(number).collect()
}

/// The scenes of a benchmark: those given, or the usual ones, with the values that are set.
fn scenes(arguments: &Arguments, usual: &[&str]) -> Result<Vec<Scene>, Failure> {
    let overrides = Overrides { set: arguments.set.clone(), ..Overrides::default() };
    let usual = usual.iter().map(|name| (*name).to_owned()).collect();
    let names: Vec<String> = if arguments.of.is_empty() { usual } else { arguments.of.clone() };
    let with_steps = |name: &String| match overrides.apply(scene(name)?, name)? {
        scene if scene.steps() == 0 => Err(Failure::Input(format!("{name} has no steps: raise duration or lower dt"))),
        scene => Ok(scene),
    };
    names.iter().map(with_steps).collect()
}

fn error(arguments: &Arguments) -> Result<(), Failure> {
    let usual = ["push", "two", "three", "size_ratio", "collide", "orbit", "drop"];
    let scenes = oscillators(scenes(arguments, &usual)?, "bench error")?;
    let claimed = Claimed::new(arguments, &error::columns())?;
    let mut measured = vec![];
    for scene in &scenes {
        let progress = Progress::new(format!("measuring {}", scene.name), Work::Share);
        let of_scene = error::measure(scene, &error::Settings::of(scene), &mut |share| progress.set_share(share));
        measured.push(of_scene.map_err(|error| match error {
            MeasureError::Failed(_) | MeasureError::Threads(_) => error.into(),
            error => Failure::Input(format!("scene {}: {error}", scene.name)),
        })?);
    }
    let machine = Machine::detect();
    claimed.finish(&error::report(&measured, &machine), &machine)
}

fn scale(arguments: &Arguments) -> Result<(), Failure> {
    let mut bodies = match arguments.of.as_slice() {
        [] => vec![2, 10, 100, 1000, 10_000, 100_000],
        of => numbers(of, 2..=1_000_000, "a number of bodies")?,
    };
    bodies.sort_unstable();
    bodies.dedup();
    let claimed = Claimed::new(arguments, &scale::columns())?;
    let bodies = bodies.into_iter().map(|n| n as usize).collect();
    let settings = scale::Settings { bodies, time: TIMED };
    let progress = Progress::new("measuring scenes of all sizes", Work::Share);
    let measured = scale::measure(&settings, &mut |share| progress.set_share(share));
    drop(progress);
    let machine = Machine::detect();
    claimed.finish(&measured?.report(&machine), &machine)
}

fn record(arguments: &Arguments) -> Result<(), Failure> {
    let scenes = oscillators(scenes(arguments, &["two", "crowd"])?, "bench record")?;
    let claimed = Claimed::new(arguments, &record::columns())?;
    let (mut measurements, mut verifications) = (vec![], vec![]);
    for scene in &scenes {
        let _progress = Progress::new(format!("measuring {}", scene.name), Work::Uncounted);
        measurements.extend(record::measure(scene).map_err(Failure::Run)?);
        verifications.push(record::verify(scene).map_err(Failure::Run)?);
    }
    claimed.finish(&record::report(&measurements, &verifications), &Machine::detect())
}

fn surface(arguments: &Arguments) -> Result<(), Failure> {
    let claimed = Claimed::new(arguments, &surface::columns())?;
    let _progress = Progress::new("uniting spheres", Work::Uncounted);
    claimed.finish(&surface::report(&surface::measure()), &Machine::detect())
}

fn models(arguments: &Arguments) -> Result<(), Failure> {
    let scenes = scenes(arguments, &["two"])?;
    let claimed = Claimed::new(arguments, &models::columns())?;
    if let (Some(path), [first, ..]) = (&arguments.save, scenes.as_slice()) {
        let all = SideBySide::all(first, Options::default());
        save(&all, path)?;
    }
    let mut measured = Vec::new();
    for scene in &scenes {
        let progress = Progress::new(format!("measuring {}", scene.name), Work::Share);
        measured.push(models::measure(scene, &Model::ALL, &mut |share| progress.set_share(share)));
    }
    let machine = Machine::detect();
    claimed.finish(&models::report(&measured, &machine), &machine)
}

/// Records all models of a scene side by side.
fn save(all: &SideBySide, path: &Path) -> Result<(), Failure> {
    let schema = all.schema();
    let new = Existing { application: application(&schema.name), kind: Some(Kind::Run) };
    let note = may_save(path, &[], &new)?;
    let destinations = Destinations::file(path);
    let progress = Progress::new("recording all models", Work::Uncounted).with_file(path);
    let recorded = stream::record(all, Settings::of(all), &destinations);
    let frames = recorded.map_err(|error| Failure::Run(error.to_string()))?;
    drop(progress);
    say_note(note);
    print(&format!("saved {}: {}, {}", path.display(), counted(frames, "frame"), schema.model.replace('+', ", ")));
    print("");
    Ok(())
}

fn stability(arguments: &Arguments) -> Result<(), Failure> {
    let (machine, cases) = (Machine::detect(), arguments.random.unwrap_or(CASES));
    let settings = stability::Settings { cases, integrators: Integrator::ALL.to_vec(), most_steps: u64::MAX };
    if let [index] = numbers(&arguments.of, 0..=MAX_CASES - 1, "the number of a case")?[..] {
        let case = Case::new(index).map_err(MeasureError::from)?;
        print_lines(&case.scene.source);
        let row = stability::run(case, &settings)?;
        return Claimed::default().finish(&stability::of_case(&row), &machine);
    }
    let claimed = Claimed::new(arguments, &stability::columns())?;
    let swept = Progress::new("stability", Work::Units("case", Some(cases)));
    let rows = stability::sweep(&settings, &|| swept.add(1))?;
    drop(swept);
    let progress = Progress::new("energy over a million steps, free bodies", Work::Uncounted);
    let drift = |&integrator: &Integrator| drift::measure(integrator, drift::STEPS);
    let drifts = settings.integrators.par_iter().map(drift).collect::<Result<Vec<_>, _>>()?;
    let free = free::measure(&settings.integrators)?;
    drop(progress);
    claimed.finish(&stability::report(&rows, &drifts, &free), &machine)
}

fn thesis(arguments: &Arguments) -> Result<(), Failure> {
    let claimed = Claimed::new(arguments, &thesis::columns())?;
    let progress = Progress::new("measuring the thesis", Work::Share);
    let measured = thesis::measure(&mut |share| progress.set_share(share));
    drop(progress);
    claimed.finish(&thesis::report(&measured?)?, &Machine::detect())
}

/// Refuses scenes that the benchmark `what` cannot run: of another model, or larger than the memory that there is.
fn oscillators(scenes: Vec<Scene>, what: &str) -> Result<Vec<Scene>, Failure> {
    for scene in &scenes {
        memory::check(scene).map_err(Failure::input)?;
        need_oscillators(scene, what).map_err(Failure::input)?;
    }
    Ok(scenes)
}

/// What an SVG file of this program has near its beginning.
const DRAWN: &str = "<desc>meldscope</desc>";

/// Says that a file is there, unless only errors and warnings are wanted.
fn say_written(path: &Path) {
    if !is_quiet() {
        say(&format!("wrote {}", path.display()));
    }
}

/// The files of a benchmark: begun before anything is measured, so that "permission denied" is reported at once instead
/// of after minutes, and put in place at the end.
#[derive(Default)]
struct Claimed {
    csv: Option<(PathBuf, table::Table)>,
    svg: Option<(PathBuf, AtomicFile)>,
}

impl Claimed {
    fn new(arguments: &Arguments, columns: &[Column]) -> Result<Claimed, Failure> {
        if let (Some(csv), Some(svg)) = (&arguments.csv, &arguments.svg)
            && atomic::is_same_destination(csv, svg)
        {
            return Err(Failure::Input("--csv and --svg name the same file: give each its own".to_owned()));
        }
        let table = |path: PathBuf| {
            let table = table::Table::create(&path, report::file_columns(columns))?;
            Ok::<_, TableError>((path, table))
        };
        let csv = arguments.csv.clone().map(table).transpose()?;
        let svg = arguments.svg.clone().map(|path| begin_diagram(&path).map(|file| (path, file))).transpose()?;
        Ok(Claimed { csv, svg })
    }

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
            say_written(&path);
        }
        if let (Some((path, mut file)), Some(chart)) = (self.svg, &report.chart) {
            let written = file.write_all(chart.svg().as_bytes()).and_then(|()| file.commit());
            written.map_err(|error| unwritable(&path, &error))?;
            say_written(&path);
        }
        report.failure.as_ref().map_or(Ok(()), |failure| Err(Failure::Run(failure.clone())))
    }
}

/// Begins a diagram. Rejects a path that cannot be written, and an existing file that this program did not draw.
fn begin_diagram(path: &Path) -> Result<AtomicFile, Failure> {
    if path.is_dir() {
        return Err(unwritable(path, &std::io::ErrorKind::IsADirectory.into()));
    }
    if path.is_file() && !is_marked(path, DRAWN).map_err(|error| unwritable(path, &error))? {
        let path = path.display();
        return Err(Failure::Input(format!(
            "{path} was not written by this benchmark and is not replaced; write elsewhere or remove it first"
        )));
    }
    AtomicFile::create(path).map_err(|error| unwritable(path, &error))
}

fn unwritable(path: &Path, error: &std::io::Error) -> Failure {
    Failure::Run(format!("cannot write {}: {error}; {}", path.display(), atomic::remedy(path, error)))
}
