//! `meldscope run`: simulates a scene and records it.

use std::{
    collections::HashMap,
    fs::File,
    io::Read as _,
    net::{IpAddr, SocketAddr},
    path::{Path, PathBuf},
    sync::atomic::{AtomicBool, Ordering},
    time::{Duration, Instant},
};

use super::{
    Failure, announce, expense,
    interrupt::{self, HAS_STEPPED, STOP},
    is_quiet, may_print, may_save, one_of,
    overrides::Overrides,
    print,
    progress::{Progress, Work},
    say, sink_failure,
};
use crate::{
    models::SceneRun,
    observe::{self, EventRow, Experiment as _, Schema, Shortfall, Simulation, StepFailure, StepSummary, row::rows},
    recording::existing::{Existing, Kind},
    scene::{Scene, builtin},
    sdk,
    sim::Options,
    stream::{
        Pipeline, Recorder,
        blueprint::Tab,
        chunks::Audience,
        contract,
        pipeline::{PipelineEnd, send},
        recorder::MOST_APPROACHES,
        settings::{self, Around, Detail, Entities, Frames, Settings, Trigger, application, file_stem},
        sinks::{Destinations, Finished, Host, Serve, Serving, Sinks, Spawn},
        size,
    },
    text::{bytes, counted, did_you_mean, step_size, thousands},
};

/// The port of the page with the web viewer.
const PAGE: u16 = 9090;
/// Notes are printed, and a watched file is checked, at this interval, but only every few steps.
const CHECK_INTERVAL: Duration = Duration::from_millis(50);
const STEPS_BETWEEN_CHECKS: u64 = 16;
/// A rate of steps is reported only if they took at least this long [s].
const LEAST_TIMED: f64 = 0.5;
/// At most this many events are listed; the rest are counted.
const LISTED_EVENTS: usize = 20;

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
    /// The address that --serve listens on, and the port of its page, 0 for any free one. The data is on port 9876, or with
    /// a port, on the next one. Beyond this machine's own addresses, others can read all that is served, unencrypted.
    #[arg(long, value_name = "IP[:PORT]", default_value = "127.0.0.1", value_parser = parse_bind, requires = "serve",
          help_heading = "Destinations")]
    bind: Bind,
    /// Also accept requests to --serve under this host name or address, not only this machine's own; may be repeated.
    #[arg(long, value_name = "HOST", requires = "serve", help_heading = "Destinations")]
    allow_host: Vec<Host>,

    #[command(flatten)]
    overrides: Overrides,
    /// Number of steps, instead of the scene's duration; 0: run until Ctrl-C.
    #[arg(long, value_name = "N", help_heading = "Scene")]
    steps: Option<u64>,
    /// Record every Nth step [default: 1, or the smallest N that keeps the file of a large scene below 200 MB].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..), help_heading = "What to record")]
    every: Option<u64>,
    /// Level of detail of each frame. `stages` also records the states within a step; it cannot be combined with
    /// --thin or --keep.
    #[arg(long, default_value = Detail::Forces.name(), value_parser = one_of(&Detail::ALL, Detail::name),
          help_heading = "What to record")]
    detail: Detail,
    /// The first step that --detail stages records [default: the first].
    #[arg(long, value_name = "STEP", help_heading = "What to record")]
    from: Option<u64>,
    /// The last step that --detail stages records [default: the last].
    #[arg(long, value_name = "STEP", help_heading = "What to record")]
    to: Option<u64>,
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
    /// Record only the scene and checksums, about ten bytes per step; `replay --save` restores the frames.
    #[arg(long, conflicts_with_all = ["every", "detail", "entities", "keep"], help_heading = "What to record")]
    thin: bool,
    /// Flight recorder: keep the last N frames in memory; write them at the end, or when an --on event occurs.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..), help_heading = "Flight recorder")]
    keep: Option<u64>,
    /// Write the frames held by --keep whenever one of these events occurs, instead of at the end.
    #[arg(
        long,
        requires = "keep",
        value_delimiter = ',',
        value_name = "merge,split,core,diverge",
        help_heading = "Flight recorder"
    )]
    on: Vec<String>,
    /// After such an event, also write the N frames that follow.
    #[arg(long, requires = "on", value_name = "N", default_value_t = 0, help_heading = "Flight recorder")]
    after: u64,
    /// Run no faster than real time.
    #[arg(long, help_heading = "Viewer")]
    realtime: bool,
    /// Restart in the same viewer whenever the scene file changes; requires --spawn, --connect or --serve.
    #[arg(long, conflicts_with_all = ["save", "stdout"], help_heading = "Viewer")]
    watch: bool,
    /// The tab that the viewer opens first.
    #[arg(long, default_value = Tab::Scene.name(), value_parser = one_of(&Tab::ALL, Tab::name),
          help_heading = "Viewer")]
    tab: Tab,
}

/// What a server listens on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Bind {
    address: IpAddr,
    /// Port of the page with the web viewer.
    page: u16,
    /// Port of the data.
    data: u16,
}

fn parse_bind(text: &str) -> Result<Bind, String> {
    if let Ok(address) = text.parse() {
        return Ok(Bind { address, page: PAGE, data: sdk::DEFAULT_SERVER_PORT });
    }
    let address: Option<SocketAddr> = text.parse().ok();
    let of = |address: SocketAddr| {
        let page = address.port();
        let data = if page == 0 { 0 } else { page.checked_add(1)? };
        Some(Bind { address: address.ip(), page, data })
    };
    address.and_then(of).ok_or_else(|| "expected an IP address, and a port below 65535 after a colon".to_owned())
}

/// Simulates a scene and records it.
pub fn run(mut arguments: Arguments) -> Result<(), Failure> {
    check(&arguments)?;
    may_print(Path::new(&arguments.scene))?;
    let scene = load(&arguments)?;
    let destinations = destinations(&arguments, &scene);
    expense::announce(&scene, (!arguments.thin).then_some(arguments.detail))?;
    // Check the scene first, then the destinations; only then start any work.
    let experiment = experiment(scene);
    let simulation = start(&experiment)?;
    let schema = simulation.schema();
    let settings = settings(&arguments, &schema)?;
    if let (Some(from), Some(steps)) = (arguments.from, settings.steps)
        && from > steps
    {
        return Err(Failure::Input(format!("--from {from} is beyond the last step, {steps}")));
    }
    let new = Existing { application: application(&schema.name), kind: Some(Kind::of(&settings)) };
    if let Some(save) = &destinations.save {
        may_save(save, &[(Path::new(&arguments.scene), "the scene to be run")], &new)?;
    }
    interrupt::raise_stop()?; // there is nothing to save before this point
    interrupt::end_before_first_step()?;
    let sinks = Sinks::open(&destinations).map_err(sink_failure)?;
    if let Some(save) = &destinations.save {
        announce(save, &new)?;
    }

    let mut console = Console::new(&arguments);
    if destinations.save.is_some() || arguments.stdout {
        let _progress = Progress::new("estimating the size of the recording", Work::Uncounted);
        arguments.every = console.say_size(&experiment, &settings, arguments.every);
    }
    drop(experiment);
    let outcome = if arguments.watch {
        watch(simulation, sinks, &arguments, &STOP, &mut console)?
    } else {
        simulate(simulation, sinks, &arguments, &STOP, None, &mut console)?.conclude(&console)?
    };
    summarize(&console, &outcome);
    if let Some(serving) = &outcome.finished.serving {
        console.say("Serving until Ctrl-C.");
        let failure = loop {
            match serving.failure() {
                None if !STOP.load(Ordering::Relaxed) => std::thread::sleep(Duration::from_millis(100)),
                failure => break failure,
            }
        };
        console.notes(serving.refused().as_slice());
        if let Some(error) = failure {
            return Err(sink_failure(error));
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
fn check(arguments: &Arguments) -> Result<(), Failure> {
    let is_viewed = arguments.spawn || arguments.connect.is_some() || arguments.serve;
    let has_range = arguments.from.is_some() || arguments.to.is_some();
    let reject = |what: &str| Err(Failure::Input(what.to_owned()));
    match arguments.detail {
        _ if arguments.watch && !is_viewed => reject("--watch is for a viewer: add --spawn, --connect or --serve"),
        _ if arguments.watch && !Path::new(&arguments.scene).is_file() => {
            reject(&format!("--watch needs a scene file, and there is no file {:?}", arguments.scene))
        }
        Detail::Surface | Detail::Forces if has_range => {
            reject("--from and --to select the steps that --detail stages records: add it")
        }
        _ if arguments.from > arguments.to && arguments.to.is_some() => reject("--from is after --to"),
        Detail::Surface | Detail::Forces if arguments.tab == Tab::Stages => {
            reject("--tab stages shows the states within steps, which --detail stages records: add it")
        }
        Detail::Surface if matches!(arguments.tab, Tab::Forces | Tab::Displacement) => {
            reject(&format!("--tab {} shows data that --detail surface omits", arguments.tab.name()))
        }
        Detail::Stages { .. } if arguments.keep.is_some() => reject(
            "--detail stages records states within steps, but --keep holds only frames: omit one of them, and record the \
             stages later (`meldscope replay F.rrd --save G.rrd --from STEP --to STEP --detail stages`)",
        ),
        _ => Ok(()),
    }
}

fn experiment(scene: Scene) -> SceneRun {
    let options = Options { interrupt: Some(&STOP), ..Options::default() };
    SceneRun { scene, options }
}

/// The result of a run.
struct Outcome {
    simulation: Box<dyn Simulation>,
    schema: Schema,
    settings: Settings,
    finished: Finished,
    /// Number of frames in the recording.
    frames: u64,
    events: Events,
    /// Closest approaches of pairs that did not change phase.
    approaches: Vec<String>,
    /// Wall time of the simulation alone, and including recording [s].
    seconds: [f64; 2],
}

/// The events of a run: the first [`LISTED_EVENTS`] of pairs, and the total count.
#[derive(Default)]
struct Events {
    first: Vec<ListedEvent>,
    count: u64,
    /// Number of those that are of single bodies; they are not listed.
    of_bodies: u64,
    /// When the present phase of a pair began [s].
    begun: HashMap<(usize, usize), f64>,
    /// Number of steps that missed the tolerance.
    inaccurate: u64,
    /// The first and the worst of these steps.
    shortfalls: Option<[(observe::Instant, Shortfall); 2]>,
}

impl Events {
    /// Adds an event.
    fn add(&mut self, row: &EventRow<'_>, schema: &Schema) {
        self.count += 1;
        let what = match row {
            EventRow::Body(_) => {
                self.of_bodies += 1;
                return;
            }
            EventRow::Phase(event, _) => format!("{} {}", event.name, schema.pair_name(event.a, event.b)),
            EventRow::Contact(event) => format!("{} {}", event.name(), schema.pair_name(event.a, event.b)),
        };
        let line = match row {
            EventRow::Phase(event, surfaces) => {
                let direction = if event.rate < 0.0 { "falling" } else { "rising" };
                let lasted = event.time - self.begun.insert((event.a, event.b), event.time).unwrap_or(0.0);
                let (rate, phase) = (event.rate.abs(), schema.phases[event.from].name);
                let surfaces = surfaces.as_ref().map_or(String::new(), |surfaces| format!("; {surfaces}"));
                let line = schema.describe(event);
                format!("{line}; q {direction} by {rate:.3}/s after {lasted:.3} s {phase}{surfaces}")
            }
            _ => row.describe(schema),
        };
        if self.first.len() < LISTED_EVENTS {
            let number = 1 + self.first.iter().filter(|other| other.what == what).count();
            self.first.push(ListedEvent { what, number, time: row.time(), line });
        }
    }

    /// Adds a step that missed the tolerance.
    fn missed(&mut self, at: observe::Instant, shortfall: Shortfall) {
        self.inaccurate += 1;
        let [first, worst] = self.shortfalls.unwrap_or([(at, shortfall); 2]);
        let is_worse = shortfall.ratio() > worst.1.ratio();
        self.shortfalls = Some([first, if is_worse { (at, shortfall) } else { worst }]);
    }

    /// Describes where the tolerance was missed; `None` if it was met.
    fn inaccuracy(&self, schema: &Schema) -> Option<String> {
        let [(at, first), (worst_at, worst)] = self.shortfalls?;
        let steps = counted(self.inaccurate, "step");
        let mut line = format!("warning: the tolerance was not met in {steps}: {}", first.describe(schema, at));
        if worst_at.step != at.step {
            line += &format!("; the worst is {}", worst.describe(schema, worst_at));
        }
        Some(line + "; lower dt, omega, alpha or beta, or raise tolerance")
    }
}

/// A run whose recording is complete and whose destinations are still open.
struct Simulated {
    simulation: Box<dyn Simulation>,
    schema: Schema,
    settings: Settings,
    sinks: Sinks,
    frames: u64,
    events: Events,
    approaches: Vec<String>,
    seconds: [f64; 2],
    failure: Option<String>,
    /// The edited scene that ended the run, if any.
    next: Option<Scene>,
}

impl Simulated {
    /// Finishes every destination.
    fn conclude(self, console: &Console) -> Result<Outcome, Failure> {
        let Simulated { simulation, schema, settings, sinks, frames, events, approaches, seconds, failure, .. } = self;
        let finished = sinks.finish();
        match (failure, finished) {
            (None, Ok(finished)) => {
                Ok(Outcome { simulation, schema, settings, finished, frames, events, approaches, seconds })
            }
            (Some(failure), finished) => {
                let finished = finished.ok();
                let serving = finished.as_ref().and_then(|finished| finished.serving.as_ref());
                console.notes(serving.and_then(Serving::refused).as_slice());
                let saved = finished.and_then(|finished| finished.save);
                let saved = saved.map(|saved| format!("; {} contains the steps up to here", saved.path.display()));
                Err(Failure::Run(format!("{failure}{}", saved.unwrap_or_default())))
            }
            (None, Err(error)) => Err(Failure::Run(error.to_string())),
        }
    }
}

/// The main loop: step, then record. Ends early when `changes` reports an edited scene.
fn simulate(
    mut simulation: Box<dyn Simulation>,
    mut sinks: Sinks,
    arguments: &Arguments,
    stop: &AtomicBool,
    mut changes: Option<&mut Changes>,
    console: &mut Console,
) -> Result<Simulated, Failure> {
    let is_live = destined_live(arguments);
    let schema = simulation.schema();
    let settings = settings(arguments, &schema)?;
    // without its own number, a restarted run would have the id of the previous one, and a viewer would append to that
    let number = changes.as_mut().map_or(0, |changes| changes.next_run());
    let warnings: Vec<String> = schema.warnings.iter().map(|warning| format!("warning: {warning}")).collect();
    console.notes(&warnings);
    console.begin(&settings, arguments.save.as_deref());
    let mut recorder = Recorder::numbered(&*simulation, settings.clone(), number);
    // first write what a replay needs, because the run may be killed at any moment
    let mut first = recorder.take();
    let rest = first.split_off(Recorder::HEAD.min(first.len()));
    let layout = recorder.blueprint_at(&*simulation, arguments.tab);
    let mut failure = send(&mut sinks, first.into_iter().chain(layout).chain(rest));
    if arguments.save.is_some() && !is_live {
        // flush, so that a killed run leaves a file that names its scene
        failure = failure.or(sinks.flush().err().map(|error| error.to_string()));
    }
    let mut pipeline = Pipeline::start(&*simulation, recorder, sinks).map_err(sink_failure)?;
    console.progress.stage("");
    let (mut events, mut next, mut failed, mut summary) = (Events::default(), None, None, StepSummary::default());
    let (start, mut simulating) = (Instant::now(), Duration::ZERO);
    let mut looked = start;
    while failure.is_none()
        && failed.is_none()
        && next.is_none()
        && !stop.load(Ordering::Relaxed)
        && settings.steps.is_none_or(|steps| simulation.steps_taken() < steps)
    {
        let step = Instant::now();
        simulation.step();
        simulating += step.elapsed();
        HAS_STEPPED.store(true, Ordering::Relaxed);
        simulation.summary(&mut summary);
        failed = summary.failure.take();
        if failed.as_ref().is_some_and(|failure| !failure.is_whole_step()) {
            break;
        }
        if let Some(warning) = summary.warning.take() {
            console.notes(&[format!("warning: {warning}")]);
        }
        if let Some(shortfall) = summary.shortfall {
            events.missed(summary.at, shortfall);
        }
        let due = arguments.realtime.then(|| start + Duration::from_secs_f64(simulation.time().min(1e9)));
        let lag = due.map(|due| Instant::now().saturating_duration_since(due));
        failure = pipeline.observe(&*simulation, lag).err();
        let surfaces = pipeline.surface_events();
        for row in rows(&summary.events, &surfaces, simulation.body_events()) {
            events.add(&row, &schema);
        }
        if let Some(due) = due {
            failure = failure.or(pipeline.hand_over().err());
            wait_until(due, stop);
        }
        let is_time = simulation.steps_taken().is_multiple_of(STEPS_BETWEEN_CHECKS) || arguments.realtime;
        console.progress.step(simulation.steps_taken(), simulation.time());
        if is_time && looked.elapsed() >= CHECK_INTERVAL {
            looked = Instant::now();
            console.notes(&pipeline.notes());
            next = changes.as_mut().and_then(|changes| changes.scene(arguments, console));
        }
    }

    // The steps simulated so far are saved, however the run ended.
    console.progress.stage("finishing the recording");
    let mut end = pipeline.finish().map_err(Failure::Run)?;
    let seconds = [simulating, start.elapsed()].map(|time| time.as_secs_f64());
    let failed =
        failed.filter(|failure| !matches!(failure, StepFailure::Interrupted(_))).map(|failure| failure.to_string());
    if let Some(failed) = &failed {
        end.recorder.log_property(contract::FAILURE, failed);
    }
    let unsent = end.finish(&*simulation);
    let PipelineEnd { recorder, mut sinks, mut notes, failure: recording } = end;
    let failure = failed.or(failure).or(recording).or(unsent);
    let layout = recorder.measured_layout(&*simulation, arguments.tab);
    let unsent = layout.into_iter().find_map(|message| sinks.send_to(Audience::Files, message).err());
    let failure = failure.or(unsent.map(|error| error.to_string()));
    notes.append(&mut sinks.notes());
    notes.extend(events.inaccuracy(&schema));
    notes.extend(recorder.dropped_frames());
    if next.is_none() {
        notes.extend(recorder.missed_event());
    }
    console.end();
    console.notes(&notes);
    let (frames, approaches) = (recorder.written(), recorder.approaches());
    Ok(Simulated { simulation, schema, settings, sinks, frames, events, approaches, seconds, failure, next })
}

/// Runs the scene, and restarts whenever its file changes, until Ctrl-C.
fn watch(
    simulation: Box<dyn Simulation>,
    sinks: Sinks,
    arguments: &Arguments,
    stop: &AtomicBool,
    console: &mut Console,
) -> Result<Outcome, Failure> {
    let mut changes = Changes {
        text: Scene::without_meshes(&simulation.schema().source).to_owned(),
        reported: String::new(),
        runs: 0,
    };
    let mut run = simulate(simulation, sinks, arguments, stop, Some(&mut changes), console)?;
    let mut before: Option<EventList> = None;
    loop {
        let listed = EventList::of(&run);
        listed.lines(before.as_ref()).iter().for_each(|line| console.print_beside(line));
        before = Some(listed);
        if let Some(failure) = &run.failure {
            if run.sinks.failed() {
                return run.conclude(console);
            }
            console.notes(std::slice::from_ref(failure));
        }
        while run.next.is_none() && !stop.load(Ordering::Relaxed) {
            std::thread::sleep(CHECK_INTERVAL);
            console.notes(&run.sinks.notes());
            run.next = changes.scene(arguments, console);
        }
        let Some(scene) = run.next.take() else { return run.conclude(console) };
        match experiment(scene).start() {
            Ok(simulation) => {
                console.say(&format!("{} has changed: restarting", arguments.scene));
                run = simulate(simulation, run.sinks, arguments, stop, Some(&mut changes), console)?;
            }
            Err(error) => console.notes(&[format!("{error}; continuing with the previous scene")]),
        }
    }
}

/// The events of a run, for comparison with those of the next.
struct EventList {
    events: Vec<ListedEvent>,
    /// Number of further events.
    more: u64,
    /// Simulated time at the end of the run [s].
    until: f64,
}

/// An event: kind and pair, number among the events of that kind and pair, time [s], and description.
#[derive(Clone)]
struct ListedEvent {
    what: String,
    number: usize,
    time: f64,
    line: String,
}

impl EventList {
    fn of(run: &Simulated) -> EventList {
        let events = run.events.first.clone();
        EventList { more: run.events.count - events.len() as u64, events, until: run.simulation.time() }
    }

    /// A line for each event, and for each event of the previous run that no longer occurs.
    fn lines(&self, before: Option<&EventList>) -> Vec<String> {
        let mut lines = Vec::new();
        let all = self.events.len() as u64 + self.more;
        lines.push(match all {
            0 => format!("no events in {} s", three(self.until)),
            n => format!("{} in {} s:", counted(n, "event"), three(self.until)),
        });
        let of = |listed: &EventList, event: &ListedEvent| {
            let same = listed.events.iter().find(|other| (&other.what, other.number) == (&event.what, event.number));
            same.map(|other| other.time)
        };
        for event in &self.events {
            let moved = before.map(|before| match of(before, event) {
                Some(time) if time == event.time => ", as before".to_owned(),
                Some(time) if time < event.time => format!(", {} later", duration(event.time - time)),
                Some(time) => format!(", {} earlier", duration(time - event.time)),
                // an event after the end of the previous list is not necessarily new
                None if before.more > 0 || before.until < event.time => String::new(),
                None => ", new".to_owned(),
            });
            lines.push(format!("  {} at t = {} s{}", event.what, three(event.time), moved.unwrap_or_default()));
        }
        let was = before.into_iter().flat_map(|before| &before.events);
        for gone in was.filter(|event| self.more == 0 && event.time <= self.until && of(self, event).is_none()) {
            lines.push(format!("  gone: {}, previously at t = {} s", gone.what, three(gone.time)));
        }
        if self.more > 0 {
            lines.push(format!("  … and {} more", thousands(self.more)));
        }
        lines
    }
}

fn three(seconds: f64) -> String {
    format!("{seconds:.3}")
}

/// A duration in readable form.
fn duration(seconds: f64) -> String {
    match seconds {
        1.0.. => format!("{seconds:.3} s"),
        0.01.. => format!("{:.0} ms", 1e3 * seconds),
        1e-3.. => format!("{:.1} ms", 1e3 * seconds),
        _ => format!("{:.1e} s", seconds),
    }
}

/// A watched scene file.
struct Changes {
    /// Its content when last read.
    text: String,
    /// The last reported error in it.
    reported: String,
    /// Number of runs started.
    runs: u64,
}

impl Changes {
    /// Returns the new scene if the file has changed and is valid. An error in it is reported once.
    fn scene(&mut self, arguments: &Arguments, console: &Console) -> Option<Scene> {
        let overridden = |scene| arguments.overrides.apply(scene, &arguments.scene).map_err(|error| error.to_string());
        match changed(&mut self.text, Path::new(&arguments.scene))?.and_then(overridden) {
            Ok(scene) => {
                self.reported.clear();
                Some(scene)
            }
            Err(why) => {
                if why != self.reported {
                    console.notes(&[format!("{why}; continuing with the previous scene")]);
                    self.reported = why;
                }
                None
            }
        }
    }

    /// The number of the run that is about to start, from 0.
    fn next_run(&mut self) -> u64 {
        self.runs += 1;
        self.runs - 1
    }
}

/// The scene in a file, if its text has changed since it was `text`, which is updated.
pub(super) fn changed(text: &mut String, path: &Path) -> Option<Result<Scene, String>> {
    // a missing file may be about to be written; anything but a regular file may be endless or block forever
    let metadata = std::fs::metadata(path).ok()?;
    if !metadata.is_file() {
        return Some(Err(format!("{} is no longer a file", path.display())));
    }
    if metadata.len() > Scene::LARGEST_TEXT {
        return Some(Err(format!("{} now exceeds the size limit of a scene", path.display())));
    }
    let mut bytes = Vec::new();
    File::open(path).ok()?.take(Scene::LARGEST_TEXT).read_to_end(&mut bytes).ok()?;
    let read = String::from_utf8(bytes).ok()?;
    // an editor may truncate a file before writing it
    if read == *text || read.is_empty() {
        return None;
    }
    *text = read;
    Some(Scene::parse_beside(text, path).map_err(|error| error.to_string()))
}

/// Sleeps until `due`, or until `stop` is set.
fn wait_until(due: Instant, stop: &AtomicBool) {
    while !stop.load(Ordering::Relaxed) {
        let left = due.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return;
        }
        std::thread::sleep(left.min(Duration::from_millis(50)));
    }
}

/// Loads the scene and applies the command line's overrides.
fn load(arguments: &Arguments) -> Result<Scene, Failure> {
    arguments.overrides.apply(scene(&arguments.scene)?, &arguments.scene)
}

/// Builds the bodies of a scene, with a progress message: factoring a large stiffness matrix may take long.
fn start(experiment: &SceneRun) -> Result<Box<dyn Simulation>, Failure> {
    let _progress = Progress::new(format!("building bodies: {}", experiment.scene.model), Work::Uncounted);
    experiment.start().map_err(Failure::Input)
}

/// Reads a scene file; meshes may take long.
pub(super) fn read(path: &Path) -> Result<Scene, Failure> {
    let progress = Progress::new("reading the scene", Work::Share);
    let loaded = Scene::load_watched(path, &|mesh, share| {
        progress.stage(format!("reading {mesh}"));
        progress.set_share(share);
    });
    loaded.map_err(Failure::input)
}

/// The built-in scene with this name, or the scene in this file.
pub(super) fn scene(name: &str) -> Result<Scene, Failure> {
    match Scene::builtin(name) {
        Some(scene) => Ok(scene),
        None if !Path::new(name).exists() && !name.contains(['/', '\\', '.']) => {
            let names = builtin::ALL.map(|builtin| builtin.name);
            let hint = did_you_mean(name, names.into_iter());
            Err(Failure::Input(format!(
                "no scene {name:?}{hint} (there is no such file, and the built-in scenes are {}; see `meldscope scenes`)",
                names.join(", ")
            )))
        }
        None => {
            let path = Path::new(name);
            if Existing::is_recording(path) {
                let word = shell_word(name);
                return Err(Failure::Input(format!(
                    "{name} is a recording, not a scene: `meldscope replay {word}` runs it again"
                )));
            }
            read(path)
        }
    }
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
    let own = Settings::for_bodies(schema.bodies.len(), schema.steps);
    Ok(Settings {
        steps: match arguments.steps {
            None => own.steps,
            Some(0) => None,
            some => some,
        },
        every: arguments.every.unwrap_or(own.every),
        detail: match arguments.detail {
            Detail::Stages { from, to } => {
                Detail::Stages { from: arguments.from.unwrap_or(from), to: arguments.to.unwrap_or(to) }
            }
            detail => detail,
        },
        entities: arguments.entities.unwrap_or(own.entities),
        frames: match (arguments.thin, arguments.keep) {
            (true, _) => Frames::Thin,
            (false, Some(most)) => Frames::Last { most, on, after: arguments.after },
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

fn destinations(arguments: &Arguments, scene: &Scene) -> Destinations {
    let fallback = || (!destined_live(arguments)).then(|| PathBuf::from(format!("{}.rrd", file_stem(&scene.name))));
    Destinations {
        save: arguments.save.clone().or_else(fallback),
        stdout: arguments.stdout,
        spawn: arguments.spawn.then(Spawn::default),
        connect: arguments.connect.clone(),
        serve: arguments.serve.then(|| Serve {
            bind: arguments.bind.address,
            web_port: arguments.bind.page,
            grpc_port: arguments.bind.data,
            allow: arguments.allow_host.clone(),
        }),
        ..Destinations::default()
    }
}

/// Prints a summary of the run, and how to open its recording.
fn summarize(console: &Console, outcome: &Outcome) {
    let Outcome { simulation, schema, settings, finished, frames, events, approaches, seconds: [simulating, all] } =
        outcome;
    let Events { first: events, count: event_count, of_bodies, .. } = events;
    console.notes(&finished.notes);
    let (bodies, steps) = (schema.bodies.len() as u64, simulation.steps_taken());
    // the first steps warm caches, and other load comes and goes: a rate needs a while
    let rate = match *simulating >= LEAST_TIMED {
        true => format!(" ({} steps/s)", thousands((steps as f64 / simulating) as u64)),
        false => String::new(),
    };
    console.print(&format!(
        "{}: {}, {}; {} of {} s with {}{}, {:.3} s simulated in {simulating:.3} s{rate}, recorded in {all:.3} s",
        schema.name,
        counted(bodies, "body"),
        counted(schema.vertex_count(), "vertex"),
        counted(steps, "step"),
        step_size(schema.dt),
        schema.non_default_model().map(|model| format!("{model}, ")).unwrap_or_default(),
        schema.integrator,
        simulation.time(),
    ));
    match event_count {
        0 => console.print("no events"),
        n => console.print(&format!("{}:", counted(*n, "event"))),
    }
    for event in events {
        console.print(&format!("  {}", event.line));
    }
    let more = event_count - of_bodies - events.len() as u64;
    for (more, of) in [(more, ""), (*of_bodies, " of single bodies")] {
        if more > 0 {
            console.print(&format!("  … and {} more{of}, in the recording's event log", thousands(more)));
        }
    }
    for approach in approaches.iter().take(MOST_APPROACHES) {
        console.print(&format!("  {approach}"));
    }
    if let Some(account) = simulation.account() {
        console.print(&account);
    }
    if let Some(saved) = &finished.save {
        let path = saved.path.display();
        let word = shell_word(&path.to_string());
        let size = bytes(saved.bytes);
        if settings.frames == Frames::Thin {
            let events = counted(*event_count, "event");
            console.print(&format!("saved {path}: the scene, {events} and {}, {size}", counted(steps + 1, "checksum")));
            console.print(&format!(
                "verify it with `meldscope replay {word}`; `meldscope replay {word} --save full.rrd` restores the frames"
            ));
            return;
        }
        console.print(&format!("saved {path}: {}, {size}", counted(*frames, "frame")));
        if *frames == 0 {
            console.print("no --on event occurred, so no frame was written");
        }
        console.print(&format!(
            "open it with `rerun {word}` (pip install rerun-sdk==0.36.3), or install nothing: \
             `meldscope run … --serve` shows a run in the browser"
        ));
    }
}

/// Quotes a path for a shell, if necessary.
fn shell_word(path: &str) -> String {
    let is_plain = |c: char| c.is_alphanumeric() || "/._-+@%:,".contains(c);
    match path.starts_with('-') {
        true => shell_word(&format!("./{path}")),
        false if path.chars().all(is_plain) => path.to_owned(),
        false => format!("'{}'", path.replace('\'', r"'\''")),
    }
}

/// Reports the progress of a run, and prints its results.
struct Console {
    progress: Progress,
    /// Standard output carries the recording, so results go to standard error.
    piped: bool,
}

impl Console {
    fn new(arguments: &Arguments) -> Console {
        Console { progress: Progress::hidden(), piped: arguments.stdout }
    }

    /// Begins to report the steps of a run.
    fn begin(&mut self, settings: &Settings, save: Option<&Path>) {
        let progress = Progress::new("recording the first frame", Work::Units("step", settings.steps));
        self.progress = match save {
            Some(save) => progress.with_file(save),
            None => progress,
        };
    }

    fn end(&mut self) {
        self.progress = Progress::hidden();
    }

    /// Prints notes, even with --quiet: they report failed destinations and warnings.
    fn notes(&self, notes: &[String]) {
        for note in notes {
            self.progress.suspend(|| say(note));
        }
    }

    /// Reports the predicted size of a large recording, and the options that change it. Returns the interval between
    /// frames: the requested one, or one that keeps the file small.
    fn say_size(&self, experiment: &SceneRun, settings: &Settings, asked: Option<u64>) -> Option<u64> {
        let size = size::project(experiment, settings, size::LARGE).filter(|size| size.bytes > size::LARGE);
        let Some(size) = size else { return asked };
        let every = size.every(settings);
        if is_quiet() {
            return asked.or(Some(every));
        }
        let about = |bytes: u64| format!("about {} MB", thousands(bytes / 1_000_000));
        let all = about(size.bytes);
        let few = about(size.bytes / (every / settings.every).max(1));
        let from = match settings.steps {
            Some(steps) if size.seen < steps => format!(" by the first {}", counted(size.seen, "step")),
            _ => String::new(),
        };
        let frames = counted(size.frames, "frame");
        let mut others = match asked {
            Some(_) => vec![format!("`--every {every}` reduces it to {few}")],
            None => vec![format!("`--every 1` records all {frames}, {all}")],
        };
        others.extend(size.without_forces.map(|bytes| match asked {
            Some(_) => format!("`--detail surface` {}", about(bytes)),
            None => format!("with `--detail surface` {}", about(bytes)),
        }));
        let thin = bytes(10 * settings.steps.unwrap_or(0) + 20_000);
        let taken = match asked {
            Some(_) => format!("the recording will take {all} ({frames}{from})"),
            None => format!("the recording has a frame every {every} steps and will take {few}{from}"),
        };
        self.notes(&[format!(
            "note: {taken}; {}; `--thin` takes about {thin} (`meldscope replay` restores the frames of any part later)",
            others.join(", ")
        )]);
        asked.or(Some(every))
    }

    fn say(&self, line: &str) {
        if !is_quiet() {
            say(line);
        }
    }

    /// Prints a result during the run.
    fn print_beside(&self, line: &str) {
        self.progress.suspend(|| self.print(line));
    }

    fn print(&self, line: &str) {
        if self.piped { self.say(line) } else { print(line) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn listed(events: &[(&str, f64)], until: f64) -> EventList {
        let mut list: Vec<ListedEvent> = Vec::new();
        for &(what, time) in events {
            let number = 1 + list.iter().filter(|other| other.what == what).count();
            list.push(ListedEvent { what: what.to_owned(), number, time, line: String::new() });
        }
        EventList { events: list, more: 0, until }
    }

    #[test]
    fn events_are_listed_with_their_shift_since_the_previous_run() {
        let before = listed(&[("merge big~mid", 1.224), ("split big~mid", 2.0), ("merge big~mid", 3.0)], 4.0);
        assert_eq!(before.lines(None)[..2], ["3 events in 4.000 s:", "  merge big~mid at t = 1.224 s"]);
        let now = listed(&[("merge big~mid", 1.2), ("split big~mid", 2.0), ("core big~mid", 2.5)], 3.5);
        assert_eq!(
            now.lines(Some(&before)),
            [
                "3 events in 3.500 s:",
                "  merge big~mid at t = 1.200 s, 24 ms earlier",
                "  split big~mid at t = 2.000 s, as before",
                "  core big~mid at t = 2.500 s, new",
                "  gone: merge big~mid, previously at t = 3.000 s",
            ]
        );
        // a run that ended early does not report events after its end as gone
        assert_eq!(listed(&[], 0.5).lines(Some(&before)), ["no events in 0.500 s"]);
        assert_eq!(duration(0.00123), "1.2 ms");
    }
}
