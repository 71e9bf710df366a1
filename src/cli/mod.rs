//! The command line: one file per subcommand.
//!
//! Results go to standard output, everything else to standard error. Exit status: 0 success; 1 the run failed, or a
//! check found a difference; 2 bad input or usage; 130 interrupted before the end.

mod bench;
mod check;
mod diff;
mod expense;
mod explain;
mod export;
mod interrupt;
mod live;
mod load;
mod overrides;
mod program;
mod progress;
mod reference;
mod replay;
mod run;
mod scenes;
mod sweep;

use std::{
    ffi::OsString,
    fmt,
    fs::File,
    io::{self, Read as _, Write},
    path::Path,
    process::ExitCode,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
};

use clap::{
    CommandFactory as _, FromArgMatches as _, Parser, Subcommand,
    builder::{PossibleValuesParser, TypedValueParser},
    error::ContextValue,
};

use crate::{
    atomic,
    observe::{Experiment, Schema, Simulation},
    recording::{
        ReadError, Recorded,
        existing::{self, Existing},
        read::expects_panics,
    },
    stream::sinks::SinkError,
    text::{self, printable},
};
use program::Program;

/// A visual debugger for soft bodies that merge and split.
///
/// Steps the simulation and streams meshes, influence spheres, force vectors, pair phases and frame timings to the
/// Rerun viewer or to an .rrd file.
#[derive(Parser)]
#[command(name = "meldscope", version)]
struct Arguments<C: Subcommand> {
    #[command(subcommand)]
    command: C,
    /// Print errors and warnings only.
    #[arg(short, long, global = true)]
    quiet: bool,
    /// Number of threads [default: one per core].
    #[arg(short = 'j', long, value_name = "N", global = true, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
}

/// The commands of any program.
#[derive(Subcommand)]
enum Command {
    /// Simulate a scene and record it.
    Run(Box<run::Arguments>),
    /// Open a page with sliders beside the viewer: each change repeats the whole run.
    Live(live::Arguments),
    /// Simulate a recording's scene again and verify every step.
    Replay(replay::Arguments),
    /// Run scripted scenes and compare them with their golden recordings.
    Check(check::Arguments),
    /// Explain a step: forces by cause on a body or a vertex, and why a pair is in its phase.
    Explain(explain::Arguments),
    /// Compare two recordings of the same scene.
    Diff(diff::Arguments),
    /// Write the surfaces of a run to mesh files, or its numbers to tables, for other programs.
    Export(export::Arguments),
    /// Run a scene at every point of a grid over its parameters: rows in Parquet, and a map of their outcomes.
    Sweep(sweep::Arguments),
}

/// The commands of this crate's own program.
#[derive(Subcommand)]
enum OwnCommand {
    #[command(flatten)]
    Any(Command),
    /// List the built-in scenes and sweeps, or show one.
    Scenes(scenes::Arguments),
    /// List every key of a scene or a sweep, every entity of a recording, every column of a table, every event.
    Reference(reference::Arguments),
    /// Run benchmarks: accuracy against run time, cost against scene size, recording cost, integrator stability.
    Bench(bench::Arguments),
}

/// Why a command failed.
#[derive(Debug)]
enum Failure {
    /// The run failed, or a check found a difference: exit status 1.
    Run(String),
    /// Bad input or usage: exit status 2.
    Input(String),
    /// Ctrl-C or a termination request came before the end: exit status 130.
    Interrupted(String),
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (Failure::Run(message) | Failure::Input(message) | Failure::Interrupted(message)) = self;
        f.write_str(message)
    }
}

impl From<ReadError> for Failure {
    fn from(error: ReadError) -> Failure {
        match error {
            ReadError::Failed { .. } => Failure::Run(error.to_string()),
            _ => Failure::Input(error.to_string()),
        }
    }
}

impl From<SinkError> for Failure {
    fn from(error: SinkError) -> Failure {
        if error.is_usage() { Failure::input(error) } else { Failure::Run(error.to_string()) }
    }
}

impl Failure {
    fn input(error: impl fmt::Display) -> Failure {
        Failure::Input(error.to_string())
    }

    /// A folder cannot be created, or read: `what`.
    fn folder(what: &str, path: &Path, error: &io::Error) -> Failure {
        let text = format!("cannot {what} the folder {}: {error}; {}", path.display(), atomic::remedy(path, error));
        match error.kind() {
            io::ErrorKind::AlreadyExists | io::ErrorKind::NotADirectory => Failure::Input(text),
            _ => Failure::Run(text),
        }
    }
}

/// The entry point of this crate's own program. Ends the process.
pub fn main() -> ! {
    let status = start(Arguments::<OwnCommand>::command(), std::env::args_os(), |command| match command {
        OwnCommand::Any(command) => command.run(Program::Scenes),
        OwnCommand::Bench(arguments) => interrupt::end().and_then(|()| bench::bench(arguments)),
        // `--quiet` does not apply: these commands only print
        OwnCommand::Scenes(arguments) => unquiet(|| scenes::scenes(&arguments)),
        OwnCommand::Reference(arguments) => unquiet(|| {
            reference::reference(&arguments);
            Ok(())
        }),
    });
    // Not `std::process::exit`: the allocator's exit handler gives back its memory piece by piece, which takes up to a tenth of
    // the time of a short run.
    signal_hook::low_level::exit(status.into())
}

/// The entry point of another program, with experiments of its own: `run`, `live`, `replay`, `check`, `explain`, `diff`,
/// `export` and `sweep`, as those of `meldscope`, where the name of an experiment stands for a scene. `args` begins with the
/// name of the program, as [`std::env::args_os`] does; `experiment` finds an experiment by its name, and says which there
/// are if it knows no such name.
///
/// A recording names its experiment by [`Schema::name`](crate::observe::Schema::name): `replay` and others find that and
/// restart it by [`Experiment::read`]. `--set KEY=VALUE` varies its [parameters](Experiment::parameters), and so do the
/// axes of a [sweep](crate::sweep), whose rows have the events, the steps, the checksum and the scalars at the end; its
/// `--refine`, `--bisect` and maps take the kinds of events for the outcome. `check` compares
/// golden recordings NAME.rrd, by default those in the folder `recordings`, with the experiments of these names.
///
/// ```no_run
/// use std::{process::ExitCode, sync::Arc};
///
/// use meldscope::{Scene, cli};
///
/// fn main() -> ExitCode {
///     cli::run(std::env::args_os(), |name| match Scene::builtin(name) {
///         Some(scene) => Ok(Arc::new(scene)), // or any other experiment
///         None => Err("there are two and three".to_owned()),
///     })
/// }
/// ```
///
/// The exit status is 0 for success, 1 if the run failed or a check found a difference, 2 for bad input or usage, and 130
/// for an interrupt before the end.
pub fn run(
    args: impl IntoIterator<Item = impl Into<OsString>>,
    experiment: impl Fn(&str) -> Result<Arc<dyn Experiment>, String>,
) -> ExitCode {
    let args: Vec<OsString> = args.into_iter().map(Into::into).collect();
    let name =
        args.first().and_then(|path| Path::new(path).file_stem()).map(|name| name.to_string_lossy().into_owned());
    let name = name.unwrap_or_else(|| "program".to_owned());
    let command = program::described(Arguments::<Command>::command(), &name);
    text::set_program(name);
    ExitCode::from(start(command, args, |command: Command| command.run(Program::Own(&experiment))))
}

/// Parses a command line, and runs its command. Returns the exit status.
fn start<C: Subcommand>(
    described: clap::Command,
    args: impl IntoIterator<Item = impl Into<OsString> + Clone>,
    run: impl FnOnce(C) -> Result<(), Failure>,
) -> u8 {
    interrupt::survive_limit_on_files();
    // The decoder may panic on a damaged recording, which is reported as an ordinary error on one line.
    let usual = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        if !expects_panics() {
            usual(panic)
        }
    }));
    let parsed = described.try_get_matches_from(args);
    let result = match parsed.and_then(|matches| Arguments::<C>::from_arg_matches(&matches)) {
        Ok(arguments) => prepare(arguments.quiet, arguments.threads).and_then(|()| run(arguments.command)),
        // help and version are results; everything else is a usage error
        Err(error) if error.use_stderr() => {
            let text = escaped(error).render().to_string();
            text.trim_end().split('\n').for_each(say);
            return 2;
        }
        Err(help) => {
            note_unprinted(help.print());
            Ok(())
        }
    };
    note_unprinted(io::stdout().flush());
    let unprinted = UNPRINTED.lock().ok().and_then(|mut error| error.take());
    let unprinted = unprinted.map(|error| format!("cannot write the results to standard output: {error}"));
    let (status, message) = match (result, unprinted) {
        (Ok(()), None) => return 0,
        (Ok(()), Some(unprinted)) => (1, unprinted),
        (Err(failure), unprinted) => {
            let status = match failure {
                Failure::Run(_) => 1,
                Failure::Input(_) => 2,
                Failure::Interrupted(_) => interrupt::STATUS,
            };
            (status, failure.to_string() + &unprinted.map_or(String::new(), |unprinted| format!("; {unprinted}")))
        }
    };
    say(&format!("error: {message}"));
    status
}

/// A usage error with what it quotes on one line each.
fn escaped(mut error: clap::Error) -> clap::Error {
    let plain = |text: &String| printable(text).into_owned();
    let quoted = error.context().map(|(kind, value)| {
        let value = match value {
            ContextValue::String(text) => ContextValue::String(plain(text)),
            ContextValue::Strings(texts) => ContextValue::Strings(texts.iter().map(plain).collect()),
            other => other.clone(),
        };
        (kind, value)
    });
    for (kind, value) in quoted.collect::<Vec<_>>() {
        error.insert(kind, value);
    }
    error
}

/// Applies the options that all commands have.
fn prepare(quiet: bool, threads: Option<u16>) -> Result<(), Failure> {
    QUIET.store(quiet, Ordering::Relaxed);
    let Some(threads) = threads else { return Ok(()) };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(usize::from(threads)).build_global();
    pool.map_err(|error| Failure::Run(format!("cannot start {threads} threads: {error}")))
}

/// Runs a command whose results are printed always.
fn unquiet(command: impl FnOnce() -> Result<(), Failure>) -> Result<(), Failure> {
    QUIET.store(false, Ordering::Relaxed);
    command()
}

impl Command {
    fn run(self, program: Program<'_>) -> Result<(), Failure> {
        // those that save what they have done so far listen for Ctrl-C themselves
        if !matches!(self, Command::Run(_) | Command::Live(_) | Command::Sweep(_)) {
            interrupt::end()?;
        }
        match self {
            Command::Run(arguments) => run::run(program, *arguments),
            Command::Live(arguments) => live::live(program, arguments),
            Command::Replay(arguments) => replay::replay(program, arguments),
            Command::Check(arguments) => check::check(program, arguments),
            Command::Explain(arguments) => explain::explain(program, &arguments),
            Command::Diff(arguments) => diff::diff(program, arguments),
            Command::Export(arguments) => export::export(program, arguments),
            Command::Sweep(arguments) => sweep::sweep(program, arguments),
        }
    }
}

/// Checks that the state of a simulation is the recorded one, if there is a recording.
fn must_reproduce(recorded: Option<&Recorded>, simulation: &dyn Simulation) -> Result<(), Failure> {
    let step = simulation.steps_taken();
    match recorded.filter(|of| of.checksum(step).is_some_and(|checksum| checksum != simulation.checksum())) {
        None => Ok(()),
        Some(Recorded { path, .. }) => {
            let help = format!("see `{} replay`", text::program());
            Err(Failure::Run(format!("{} is not reproduced from step {step} on: {help}", path.display())))
        }
    }
}

/// Records a scene as `run SCENE --save F.rrd --steps N` does.
fn record(scene: &Path, recording: &Path, steps: u64) -> Result<(), Failure> {
    // so that a path that begins with a dash is no option
    let mut save = OsString::from("--save=");
    save.push(recording);
    let steps = format!("--steps={steps}");
    let line =
        ["meldscope".as_ref(), "run".as_ref(), save.as_os_str(), steps.as_ref(), "--".as_ref(), scene.as_os_str()];
    Arguments::<Command>::try_parse_from(line).map_err(Failure::input)?.command.run(Program::Scenes)
}

/// Whether only errors and warnings are printed.
static QUIET: AtomicBool = AtomicBool::new(false);

fn is_quiet() -> bool {
    QUIET.load(Ordering::Relaxed)
}

/// The first error in writing results to standard output.
static UNPRINTED: Mutex<Option<io::Error>> = Mutex::new(None);

/// Records a failed write. A closed pipe is not an error: its reader has all it needs.
fn note_unprinted(printed: io::Result<()>) {
    if let Err(error) = printed
        && error.kind() != io::ErrorKind::BrokenPipe
        && let Ok(mut first) = UNPRINTED.lock()
    {
        first.get_or_insert(error);
    }
}

/// Prints a line to standard output, escaped, unless only errors and warnings are wanted. If it cannot be written, the
/// program ends with status 1.
fn print(line: &str) {
    if !is_quiet() {
        print_always(line);
    }
}

/// Prints a line without which the command would be of no use.
fn print_always(line: &str) {
    note_unprinted(writeln!(io::stdout(), "{}", printable(line)));
}

/// Prints several lines to standard output, such as a table or a scene.
fn print_lines(text: &str) {
    text.split('\n').for_each(print);
}

/// Prints a line to standard error, escaped.
fn say(line: &str) {
    let _ = writeln!(io::stderr(), "{}", printable(line));
}

/// Prints a note to standard error, if there is one.
fn say_note(note: Option<String>) {
    if let Some(note) = note {
        say(&format!("note: {note}"));
    }
}

/// What is valid but probably not intended in an experiment, as lines.
fn warnings(schema: &Schema) -> Vec<String> {
    schema.warnings.iter().map(|warning| format!("warning: {warning}")).collect()
}

/// A parser for an argument that selects one of `all` by name; the help lists the names.
fn one_of<T: Copy + Send + Sync + 'static>(
    all: &'static [T],
    name: fn(T) -> &'static str,
) -> impl TypedValueParser<Value = T> {
    let names = PossibleValuesParser::new(all.iter().map(|&one| name(one)));
    names.try_map(move |text| all.iter().copied().find(|&one| name(one) == text).ok_or("there is no such name"))
}

/// Rejects an output path that is an input of the recording, or a file that the program must not replace. Returns a note
/// if a file of another kind or scene will be replaced: to be [said](say_note) once the path is claimed, when it is
/// certain.
fn may_save(path: &Path, inputs: &[(&Path, &str)], new: &Existing) -> Result<Option<String>, Failure> {
    let mut partial = path.as_os_str().to_owned();
    partial.push(".partial");
    for (input, what) in inputs {
        if is_same_file(path, input) {
            return Err(Failure::Input(format!("{} is {what}: save under another name", path.display())));
        }
        if is_same_file(Path::new(&partial), input) {
            let (path, input) = (path.display(), input.display());
            return Err(Failure::Input(format!(
                "{input} is {what}, and the file that {path} is first written to: save under another name"
            )));
        }
    }
    Ok(existing::replace(path, new)?)
}

/// Rejects an input file that is also standard output.
fn may_print(input: &Path) -> Result<(), Failure> {
    let is_stdout = || Ok::<_, io::Error>(same_file::Handle::stdout()? == same_file::Handle::from_path(input)?);
    match input.is_file() && is_stdout().unwrap_or(false) {
        true => {
            Err(Failure::Input(format!("{} is also standard output: redirect the results elsewhere", input.display())))
        }
        false => Ok(()),
    }
}

/// Whether a file is empty, or has near its beginning the mark of what writes such files here.
fn is_marked(path: &Path, mark: &str) -> io::Result<bool> {
    let mut head = Vec::new();
    File::open(path)?.take(4096).read_to_end(&mut head)?;
    Ok(head.is_empty() || head.windows(mark.len()).any(|part| part == mark.as_bytes()))
}

/// Whether two paths refer to the same file.
fn is_same_file(a: &Path, b: &Path) -> bool {
    // opening a pipe could block forever
    let are_files = [a, b].into_iter().all(|path| path.is_file());
    are_files && same_file::is_same_file(a, b).unwrap_or(false)
}
