//! `meldscope run`: simulates a scene and records it.

mod console;
mod events;
mod simulate;
mod watch;

use std::{
    path::{Path, PathBuf},
    sync::atomic::Ordering,
    time::Duration,
};

use super::{
    Failure, expense,
    interrupt::{self, STOP},
    may_print, may_save, one_of,
    overrides::Overrides,
    program::Program,
    progress::{Progress, Work},
    say_note,
};
use crate::{
    observe::{Experiment, Schema, Simulation},
    recording::existing::{Existing, Kind},
    sdk,
    stream::{
        blueprint::Tab,
        settings::{self, Around, DETAILS, Detail, Entities, Frames, Settings, Trigger, application, file_stem},
        sinks::{Destinations, Serve, Sinks, Spawn},
    },
    text::{self, thousands},
};
use console::{Console, summarize};
use simulate::simulate;
use watch::watch;

pub(super) use watch::Watched;

/// Notes are printed, and a watched file is checked, at this interval.
const CHECK_INTERVAL: Duration = Duration::from_millis(50);

#[derive(clap::Args)]
pub struct Arguments {
    /// A scene file, or the name of a built-in scene (see `meldscope scenes`).
    scene: String,

    /// Write the recording to a file [default, if no other destination is given: NAME.rrd].
    #[arg(long, value_name = "F.rrd", help_heading = "Destinations")]
    save: Option<PathBuf>,
    /// Start the Rerun viewer and stream to it.
    #[arg(long, help_heading = "Destinations")]
    spawn: bool,
    /// Stream to a running viewer.
    #[arg(long, value_name = "URL", num_args = 0..=1, require_equals = true, default_missing_value = sdk::DEFAULT_CONNECT_URL, help_heading = "Destinations")]
    connect: Option<String>,
    /// Serve the recording with a web viewer; nothing to install. Runs until Ctrl-C.
    #[arg(long, help_heading = "Destinations")]
    serve: bool,
    /// Write the recording to standard output.
    #[arg(long, help_heading = "Destinations")]
    stdout: bool,
    /// The address that --serve listens on, or a name of this machine, and the port of its page [9090], 0 for any free one.
    /// The data is on port 9876, or with a port, on the next one. Beyond this machine's own addresses, others can read all that
    /// is served, unencrypted.
    #[arg(
        long,
        value_name = "HOST[:PORT]",
        default_value = "127.0.0.1",
        requires = "serve",
        help_heading = "Destinations"
    )]
    bind: Serve,
    #[command(flatten)]
    overrides: Overrides,
    /// Number of steps, instead of the scene's duration; 0: run until Ctrl-C.
    #[arg(long, value_name = "N", help_heading = "Scene")]
    steps: Option<u64>,
    /// Record every Nth step [default: 1, or for a large scene an N with which the file is expected below 200 MB].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..), help_heading = "What to record")]
    every: Option<u64>,
    /// Level of detail of each frame. `stages` also records the states within each step, or those from FROM to TO; it
    /// cannot be combined with --thin or --keep.
    #[arg(long, value_name = DETAILS, default_value_t = Detail::Forces, help_heading = "What to record")]
    detail: Detail,
    /// Log one entity per body, or batch all bodies into a few entities [default: batch above 64 bodies].
    #[arg(long, value_parser = one_of(&Entities::ALL, Entities::name), help_heading = "What to record")]
    entities: Option<Entities>,
    /// Maximum number of pairs with their own plots, lanes and lines; the closest within reach are chosen [default: 16,
    /// or 5 above 64 bodies].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(..=1000),
          help_heading = "What to record")]
    plots: Option<u64>,
    /// Show plots, lanes and lines of this pair only, and open a file at its first event; may be repeated.
    #[arg(long, value_name = "A~B", conflicts_with = "thin", help_heading = "What to record")]
    pair: Vec<String>,
    /// The event at which a file opens, instead of the first: its kind, pair, number, or a combination, such as
    /// `merge`, `a~b` or "split a~b 2".
    #[arg(long, value_name = "EVENT", conflicts_with_all = ["thin", "keep"], help_heading = "What to record")]
    around: Option<String>,
    /// Record only the scene, checksums and events, about ten bytes per step; `replay --save` restores the frames.
    #[arg(long, conflicts_with_all = ["every", "detail", "entities", "keep", "plots", "tab"], help_heading = "What to record")]
    thin: bool,
    /// Flight recorder: keep the last N frames in memory; write them at the end, or when an --on event occurs, then with the
    /// M frames that follow.
    #[arg(long, value_name = "N[+M]", value_parser = parse_kept, help_heading = "Flight recorder")]
    keep: Option<Kept>,
    /// Write the frames held by --keep whenever one of these events occurs, instead of at the end.
    #[arg(
        long,
        requires = "keep",
        value_delimiter = ',',
        value_name = "merge,split,core,diverge",
        help_heading = "Flight recorder"
    )]
    on: Vec<String>,
    /// Run no faster than real time.
    #[arg(long, help_heading = "Viewer")]
    realtime: bool,
    /// Restart in the viewer whenever the scene file changes; with --spawn, --connect or --serve, and no --save.
    #[arg(long, conflicts_with_all = ["save", "stdout"], help_heading = "Viewer")]
    watch: bool,
    /// The tab that the viewer opens first.
    #[arg(long, default_value = Tab::Scene.name(), value_parser = one_of(&Tab::ALL, Tab::name),
          help_heading = "Viewer")]
    tab: Tab,
}

/// What a flight recorder keeps.
#[derive(Clone, Copy, Debug)]
struct Kept {
    /// Frames up to an event or the end.
    most: u64,
    /// Frames that follow an event.
    after: u64,
}

fn parse_kept(text: &str) -> Result<Kept, String> {
    let (most, after) = text.split_once('+').unwrap_or((text, "0"));
    let kept = most.parse().ok().zip(after.parse().ok()).filter(|&(most, _)| most > 0);
    let kept = kept.map(|(most, after)| Kept { most, after });
    kept.ok_or_else(|| {
        "expected a number of frames, 1 or more, such as 60, or 60+30 with those after an event".to_owned()
    })
}

/// Simulates a scene and records it.
pub fn run(program: Program<'_>, mut arguments: Arguments) -> Result<(), Failure> {
    check(program, &arguments)?;
    may_print(Path::new(&arguments.scene))?;
    let subject = program.subject(&arguments.scene, &arguments.overrides)?;
    if let Some(scene) = subject.scene() {
        expense::announce(scene, (!arguments.thin).then_some(arguments.detail))?;
    }
    // Check the scene first, then the destinations; only then start any work.
    let experiment = subject.experiment(Some(&STOP));
    let simulation = start(&*experiment)?;
    let schema = simulation.schema();
    let destinations = destinations(&arguments, &schema.name);
    let settings = settings(&arguments, &schema)?;
    if let (Detail::Stages { from, .. }, Some(steps)) = (arguments.detail, settings.steps)
        && from > steps
    {
        return Err(Failure::Input(format!("--detail {}: step {from} is beyond the last, {steps}", arguments.detail)));
    }
    let new = Existing { application: application(&schema.name), kind: Some(Kind::of(&settings)) };
    let inputs = [(Path::new(&arguments.scene), "the scene to be run")];
    let note = destinations.save.as_ref().map(|save| may_save(save, &inputs, &new)).transpose()?.flatten();
    interrupt::raise_stop()?; // there is nothing to save before this point
    interrupt::end_before_first_step()?;
    let sinks = Sinks::open(&destinations)?;
    let waits = matches!(&settings.frames, Frames::Last { on, .. } if !on.is_empty());
    say_note(note.map(|note| if waits { format!("{note}, if an --on event occurs") } else { note }));

    let mut console = Console::new(&arguments);
    if destinations.save.is_some() || arguments.stdout {
        let _progress = Progress::new("estimating the size of the recording", Work::Uncounted);
        arguments.every = console.say_size(&*experiment, &settings, arguments.every);
    }
    drop(experiment);
    let simulated = match arguments.watch {
        true => watch(simulation, sinks, &arguments, &mut console)?,
        false => simulate(simulation, sinks, &arguments, None, &mut console)?,
    };
    let (outcome, finished) = simulated.conclude(&console)?;
    summarize(&console, &outcome, &finished);
    if let Some(serving) = &finished.serving {
        console.say("Serving until Ctrl-C.");
        let failure = loop {
            match serving.failure() {
                None if !STOP.load(Ordering::Relaxed) => std::thread::sleep(Duration::from_millis(100)),
                failure => break failure,
            }
        };
        console.notes(serving.refused().as_slice());
        if let Some(error) = failure {
            return Err(error.into());
        }
    }
    match (outcome.settings.steps, outcome.simulation.steps_taken()) {
        (Some(steps), taken) if taken < steps && !arguments.watch => {
            Err(Failure::Interrupted(format!("interrupted after step {} of {}", thousands(taken), thousands(steps))))
        }
        _ => Ok(()), // the run was to end with an interrupt, or has reached its end
    }
}

/// Rejects contradictory options.
fn check(program: Program<'_>, arguments: &Arguments) -> Result<(), Failure> {
    let is_viewed = arguments.spawn || arguments.connect.is_some() || arguments.serve;
    let reject = |what: &str| Err(Failure::Input(what.to_owned()));
    match arguments.detail {
        _ if arguments.watch && !matches!(program, Program::Scenes) => reject("--watch is for scene files"),
        _ if arguments.watch && !is_viewed => reject("--watch is for a viewer: add --spawn, --connect or --serve"),
        _ if arguments.watch && !Path::new(&arguments.scene).is_file() => {
            reject(&format!("--watch needs a scene file, and there is no file {:?}", arguments.scene))
        }
        _ if arguments.keep.is_some_and(|kept| kept.after > 0) && arguments.on.is_empty() => {
            reject("--keep N+M: the M frames follow an event that --on names: add it")
        }
        Detail::Surface | Detail::Forces if arguments.tab == Tab::Stages => {
            reject("--tab stages shows the states within steps, which --detail stages records: add it")
        }
        Detail::Surface if matches!(arguments.tab, Tab::Forces | Tab::Displacement) => {
            reject(&format!("--tab {} shows data that --detail surface omits", arguments.tab.name()))
        }
        Detail::Stages { .. } if arguments.keep.is_some() => reject(&format!(
            "--detail stages records states within steps, but --keep holds only frames: omit one of them, and record the \
             stages later (`{} replay F.rrd --save G.rrd --from STEP --to STEP --detail stages`)",
            text::program()
        )),
        _ => Ok(()),
    }
}

/// Builds the bodies of a scene, with a progress message: factoring a large stiffness matrix may take long.
fn start(experiment: &dyn Experiment) -> Result<Box<dyn Simulation>, Failure> {
    let model = experiment.schema().model;
    let of_model = if model.is_empty() { model } else { format!(": {model}") };
    let _progress = Progress::new(format!("building bodies{of_model}"), Work::Uncounted);
    experiment.start().map_err(Failure::Input)
}

fn settings(arguments: &Arguments, schema: &Schema) -> Result<Settings, Failure> {
    let named = |option: &str| {
        let option = option.to_owned();
        move |error: String| Failure::Input(format!("{option}: {error}"))
    };
    let only = arguments.pair.iter().map(|text| settings::pair(text, schema)).collect::<Result<_, _>>();
    let around = arguments.around.as_ref().map(|text| Around::parse(text, schema)).transpose();
    let on = arguments.on.iter().map(|word| Trigger::parse(word, schema)).collect::<Result<_, _>>();
    let (only, around) = (only.map_err(named("--pair"))?, around.map_err(named("--around"))?);
    let on = on.map_err(named("--on"))?;
    let own = Settings::for_schema(schema);
    Ok(Settings {
        steps: match arguments.steps {
            None => own.steps,
            Some(0) => None,
            some => some,
        },
        every: arguments.every.unwrap_or(own.every),
        detail: arguments.detail,
        entities: arguments.entities.unwrap_or(own.entities),
        frames: match (arguments.thin, arguments.keep) {
            (true, _) => Frames::Thin,
            (false, Some(Kept { most, after })) => Frames::Last { most, on, after },
            (false, None) => own.frames,
        },
        pairs: arguments.plots.map_or(own.pairs, |plots| plots as usize),
        only,
        around,
    })
}

fn destined_live(arguments: &Arguments) -> bool {
    arguments.spawn || arguments.connect.is_some() || arguments.serve || arguments.stdout
}

fn destinations(arguments: &Arguments, name: &str) -> Destinations {
    let fallback = || (!destined_live(arguments)).then(|| PathBuf::from(format!("{}.rrd", file_stem(name))));
    Destinations {
        save: arguments.save.clone().or_else(fallback),
        stdout: arguments.stdout,
        spawn: arguments.spawn.then(Spawn::default),
        connect: arguments.connect.clone(),
        serve: arguments.serve.then(|| arguments.bind.clone()),
        ..Destinations::default()
    }
}
