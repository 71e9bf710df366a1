//! `meldscope replay`: simulates a recording's scene again and verifies every step.

use std::path::PathBuf;

use super::{
    Failure, may_print, may_save, print,
    program::Program,
    progress::{Progress, Work},
    say, say_note,
};
use crate::{
    observe::{Frame, Run, Schema, Simulation, Want},
    recording::{
        Recorded,
        contents::Contents,
        existing::{Existing, Kind},
        recorded::RecordedEvent,
        replay::{self, Verdict},
    },
    scene::template::Override,
    stream::{
        Pipeline, Recorder,
        blueprint::Tab,
        machine,
        pipeline::PipelineEnd,
        settings::{DETAILS, Detail, Frames, Settings, application},
        sinks::{Complete, Destinations, Sinks},
    },
    text::{bytes, counted, short, thousands, vector},
};

#[derive(clap::Args)]
pub struct Arguments {
    /// The recording: from `run`, `run --thin` or `replay --save`, or left by a killed run (F.rrd.partial). Of a file that
    /// holds several, all are verified; F.rrd/NAME is one, by the name of its scene or its id.
    recording: PathBuf,
    /// Record the replay with every frame, including those that the original recording lacks.
    #[arg(long, value_name = "G.rrd")]
    save: Option<PathBuf>,
    /// The first step to record [default: 0].
    #[arg(long, value_name = "STEP", requires = "save")]
    from: Option<u64>,
    /// The last step to record [default: the last].
    #[arg(long, value_name = "STEP", requires = "save")]
    to: Option<u64>,
    /// Level of detail of each frame.
    #[arg(long, value_name = DETAILS, default_value_t = Detail::Forces, requires = "save")]
    detail: Detail,
    /// Run the scene with another value for one of its keys, such as integrator=rk4 or influence.merge_at=1.1, and verify
    /// nothing; may be repeated.
    #[arg(long, value_name = "KEY=VALUE", value_parser = Override::parse)]
    set: Vec<Override>,
}

/// Replays and verifies a recording or all of a file, or runs a recording's scene with other settings and verifies
/// nothing.
pub fn replay(program: Program<'_>, arguments: Arguments) -> Result<(), Failure> {
    let contents = Contents::read(&arguments.recording)?;
    may_print(contents.path())?;
    let is_one_run = arguments.save.is_some() || !arguments.set.is_empty();
    if contents.names().len() > 1 && !is_one_run {
        return verify_all(program, &arguments, &contents);
    }
    let recorded = program.recreate(&contents, contents.only()?)?;
    match arguments.set.is_empty() {
        true => verify(&arguments, &recorded, &recorded.path.display().to_string()),
        false => vary(program, &arguments, &recorded),
    }
}

/// Verifies each recording of a file. The exit status is that of the worst.
fn verify_all(program: Program<'_>, arguments: &Arguments, contents: &Contents) -> Result<(), Failure> {
    let (path, names) = (contents.path().display(), contents.names());
    let (mut failed, mut is_input) = (0, false);
    for (index, name) in names.iter().enumerate() {
        let recorded = program.recreate(contents, index).map_err(Failure::from);
        if let Err(failure) = recorded.and_then(|recorded| verify(arguments, &recorded, &format!("{path}, {name}"))) {
            say(&format!("error: {name}: {failure}"));
            failed += 1;
            is_input |= matches!(failure, Failure::Input(_));
        }
    }
    let summary = format!("{path}: {failed} of {} failed", counted(names.len() as u64, "recording"));
    match (failed, is_input) {
        (0, _) => Ok(()),
        (_, true) => Err(Failure::Input(summary)),
        (_, false) => Err(Failure::Run(summary)),
    }
}

/// Verifies a recording, which results call `name`.
fn verify(arguments: &Arguments, recorded: &Recorded, name: &str) -> Result<(), Failure> {
    let (from, to) = range(arguments, recorded.last())?;
    let mut saver = Saver::open(arguments, recorded, &recorded.schema, from..=to)?;
    let progress = Progress::new("", Work::Units("step", Some(recorded.last())));
    let mut run = Run::again(recorded.start()?, recorded.last());
    let (mut events, mut last) = (Vec::new(), 0);
    let verdict = replay::verify_run(recorded, &mut run, |run| {
        last = run.simulation.steps_taken();
        progress.step(last, run.simulation.time());
        events.extend(run.summary.events.iter().map(|event| RecordedEvent::of(&recorded.schema, event)));
        saver.observe(run)
    });
    saver.end(&run);
    drop(progress);
    let verdict = verdict?;
    if let Some(failure) = saver.failure.take() {
        return Err(Failure::Run(failure));
    }
    let path = recorded.path.display();
    let steps = recorded.last();
    let differences = recorded.foreign_to(&machine::describe());
    let overrides = recorded.overrides.lines().collect::<Vec<_>>().join(", ");
    let settings = if overrides.is_empty() { String::new() } else { format!(" (run with {overrides})") };
    match verdict {
        Verdict::Identical => {
            replay::verify_events(recorded, &events, last)?;
            print(&format!(
                "{name}: identical, {}{settings}",
                if recorded.first == 0 {
                    counted(steps, "step")
                } else {
                    format!("{} ({} to {steps})", counted(steps - recorded.first + 1, "step"), recorded.first)
                }
            ));
            for difference in &differences {
                print(&format!("  though {difference}"));
            }
            if let Some(failure) = &recorded.failure {
                print(&format!("  and it fails as it did: {failure}"));
            }
            saver.finish()?;
            check_end(recorded)
        }
        Verdict::OtherEnd { replayed } => {
            let recorded = recorded.failure.as_deref().unwrap_or("nothing");
            let now = replayed.as_deref().unwrap_or("nothing");
            print(&format!(
                "{name}: {} steps are identical, but the reason for its end is not{settings}",
                thousands(steps)
            ));
            print(&format!("  recorded: {recorded}"));
            print(&format!("  now: {now}"));
            saver.finish()?;
            Err(Failure::Run(format!("{path} now ends for another reason")))
        }
        Verdict::Divergent(divergence) => {
            print(&format!(
                "{name}: divergent at step {} of {} (t = {:.6} s){settings}: checksum {:016x} recorded, {:016x} now",
                divergence.step, steps, divergence.time, divergence.recorded, divergence.replayed
            ));
            print(&match divergence.step.checked_sub(1) {
                Some(before) if before >= recorded.first => format!("  up to step {before} the states are identical"),
                _ => "  no step is identical".to_owned(),
            });
            match divergence.worst(recorded)? {
                Some(worst) => {
                    let at = if worst.step == divergence.step {
                        "there".to_owned()
                    } else {
                        format!("at step {} (t = {:.6} s), the first frame that shows it", worst.step, worst.time)
                    };
                    print(&format!(
                        "  worst {at}: body \"{}\", vertex {}: {} recorded, {} now, from the centre: {} radii apart; {} differ",
                        worst.body,
                        worst.vertex,
                        vector(&worst.recorded),
                        vector(&worst.found),
                        short(worst.difference),
                        counted(worst.vertices as u64, "vertex")
                    ));
                }
                None if recorded.settings.frames == Frames::Thin => {
                    print("  a thin recording has no states that show which vertex differs, and by how much");
                }
                None => print("  no recorded frame shows it: the difference stays below single precision"),
            }
            if differences.is_empty() {
                print("  version and machine are the same: the program must have changed without its version");
            }
            for difference in &differences {
                print(&format!("  {difference}"));
            }
            saver.finish()?;
            Err(Failure::Run(format!("{path} is not reproduced from step {} on", divergence.step)))
        }
    }
}

/// Rejects a truncated recording unless one is expected.
fn check_end(recorded: &Recorded) -> Result<(), Failure> {
    let Some(what) = recorded.cut_short() else { return Ok(()) };
    let path = recorded.path.display();
    if recorded.path.extension().is_some_and(|extension| extension == "partial") {
        say(&format!("note: {what}"));
        return Ok(());
    }
    Err(Failure::Input(format!("{what}; name it {path}.partial to accept what it has")))
}

/// Upper limit on the number of events that are listed.
const MOST_LISTED: usize = 20;

/// Runs the scene with changed settings, to answer "does it go away?". Lists its events beside the number of recorded
/// ones.
fn vary(program: Program<'_>, arguments: &Arguments, recorded: &Recorded) -> Result<(), Failure> {
    let was = &recorded.schema;
    let experiment = program.varied(recorded, &arguments.set)?;
    let simulation = experiment.start().map_err(Failure::Input)?;
    let schema = experiment.schema();
    let steps = match arguments.set.iter().any(|set| set.key() == "duration") {
        true => schema.steps,
        false => (recorded.last() as f64 * was.dt / schema.dt).round() as u64,
    };
    let (from, to) = range(arguments, steps)?;
    let mut saver = Saver::open(arguments, recorded, &schema, from..=to)?;

    let (mut frame, mut events) = (Frame::default(), Vec::new());
    let mut largest = (0.0, 0.0, String::new());
    let progress = Progress::new("", Work::Units("step", Some(steps)));
    let mut run = Run::new(simulation, Some(steps));
    loop {
        let simulation = &*run.simulation;
        progress.step(simulation.steps_taken(), simulation.time());
        simulation.observe(Want::default(), &mut frame);
        for (body, now) in schema.bodies.iter().zip(&frame.bodies) {
            let displacement = now.max_displacement / body.radius;
            if displacement > largest.0 {
                largest = (displacement, frame.at.time, body.name.clone());
            }
        }
        events.extend(run.summary.events.iter().map(|event| schema.describe(event)));
        if !saver.observe(&run) || !run.step() {
            break;
        }
    }
    saver.end(&run);
    drop(progress);
    let method = |of: &Schema| format!("{} s{}, tolerance {:e}", of.dt, of.method(), of.tolerance);
    let instead = match method(was) {
        same if same == method(&schema) => String::new(),
        other => format!(", instead of {} of {other}", thousands(recorded.last())),
    };
    print(&format!(
        "{}: {} of {}{instead}; set: {}; not verified",
        recorded.path.display(),
        counted(run.simulation.steps_taken(), "step"),
        method(&schema),
        arguments.set.iter().map(ToString::to_string).collect::<Vec<_>>().join(", "),
    ));
    match largest {
        (0.0, ..) => print("  no vertex is displaced"),
        (displacement, time, body) => {
            print(&format!("  largest displacement: {displacement:.6} radii, of body \"{body}\" at t = {time:.6} s"));
        }
    }
    let changes = counted(events.len() as u64, "phase change");
    let listed = if events.is_empty() { "" } else { ":" };
    print(&format!("  {changes}, {} recorded{listed}", thousands(recorded.events.len() as u64)));
    for event in events.iter().take(MOST_LISTED) {
        print(&format!("    {event}"));
    }
    if events.len() > MOST_LISTED {
        print(&format!("    … and {} more", thousands((events.len() - MOST_LISTED) as u64)));
    }
    let failure = saver.failure.take().or(run.failure.map(|failure| failure.to_string()));
    saver.finish()?;
    match failure {
        Some(failure) => Err(Failure::Run(failure)),
        None => Ok(()),
    }
}

/// The range of steps to record.
fn range(arguments: &Arguments, last: u64) -> Result<(u64, u64), Failure> {
    let (from, to) = (arguments.from.unwrap_or(0), arguments.to.unwrap_or(last));
    if from > last || to > last {
        return Err(Failure::Input(format!("step {} is beyond the last, {last}", from.max(to))));
    }
    if from > to {
        return Err(Failure::Input(format!("--from {from} is after --to {to}")));
    }
    if let Detail::Stages { from: first, to: end } = arguments.detail
        && (first > to || end < from)
    {
        return Err(Failure::Input(format!("--detail {}: none of the steps {from} to {to}", arguments.detail)));
    }
    Ok((from, to))
}

/// Records a range of steps of a replay, if requested.
struct Saver {
    settings: Settings,
    steps: std::ops::RangeInclusive<u64>,
    /// Until the first of these steps.
    sinks: Option<Sinks>,
    /// From then on.
    pipeline: Option<Pipeline>,
    /// From the last of them on, or the last of the replay.
    end: Option<PipelineEnd>,
    /// The last step recorded.
    last: u64,
    failure: Option<String>,
}

impl Saver {
    fn open(
        arguments: &Arguments,
        recorded: &Recorded,
        schema: &Schema,
        steps: std::ops::RangeInclusive<u64>,
    ) -> Result<Saver, Failure> {
        let new = Existing { application: application(&schema.name), kind: Some(Kind::Run) };
        let open = |save: &PathBuf| {
            let note = may_save(save, &[(&recorded.path, "the recording to be replayed")], &new)?;
            let destinations = Destinations::file(save);
            let sinks = Sinks::open(&destinations)?;
            say_note(note);
            Ok::<_, Failure>(sinks)
        };
        let sinks = arguments.save.as_ref().map(open).transpose()?;
        // the stages of a step start from the state of the previous step
        let steps = match arguments.detail {
            Detail::Stages { from, to } if (from..=to).contains(steps.start()) => {
                steps.start().saturating_sub(1)..=*steps.end()
            }
            Detail::Stages { .. } | Detail::Surface | Detail::Forces => steps,
        };
        let settings = Settings {
            steps: Some(*steps.end()),
            detail: arguments.detail,
            entities: recorded.settings.entities,
            pairs: recorded.settings.pairs,
            only: recorded.settings.only.clone(),
            around: recorded.settings.around.clone(),
            ..Settings::for_schema(schema)
        };
        Ok(Saver { settings, steps, sinks, pipeline: None, end: None, last: 0, failure: None })
    }

    /// Records a step; returns `false` if the replay need not continue.
    fn observe(&mut self, run: &Run) -> bool {
        let step = run.simulation.steps_taken();
        let mut is_recording = true;
        if let Some(pipeline) = &mut self.pipeline {
            is_recording = pipeline.observe(&*run.simulation, &run.summary, None);
        } else if self.steps.contains(&step)
            && let Some(sinks) = self.sinks.take()
        {
            match self.start(&*run.simulation, sinks) {
                Ok(pipeline) => self.pipeline = Some(pipeline),
                Err(failure) => self.failure = Some(failure),
            }
        }
        if is_recording && self.pipeline.is_some() {
            self.last = step;
        }
        if !is_recording || step == *self.steps.end() {
            self.end(run);
        }
        self.failure.is_none()
    }

    fn start(&self, simulation: &dyn Simulation, sinks: Sinks) -> Result<Pipeline, String> {
        let recorder = Recorder::new(simulation, self.settings.clone())?;
        Pipeline::start(simulation, recorder, sinks, Tab::Scene).map_err(|error| error.to_string())
    }

    /// Ends the recording with the last step observed, if it has not ended yet.
    fn end(&mut self, run: &Run) {
        let Some(pipeline) = self.pipeline.take() else { return };
        match pipeline.finish(&*run.simulation, run.cause().as_deref()) {
            Ok(mut end) => {
                self.failure = end.failure.take();
                self.end = Some(end);
            }
            Err(broken) => self.failure = Some(broken),
        }
    }

    /// Finishes the file and says what it holds. There is none of a replay that failed before the first step to record.
    fn finish(self) -> Result<(), Failure> {
        if let Some(sinks) = self.sinks {
            let (_, file) = sinks.complete();
            file.into_iter().for_each(Complete::discard);
            print(&format!("nothing is saved: the replay ended before step {}", self.steps.start()));
            return Ok(());
        }
        let Some(PipelineEnd { recorder, sinks, .. }) = self.end else { return Ok(()) };
        let finished = sinks.finish()?;
        if let Some(saved) = finished.save {
            print(&format!(
                "saved {}: steps {} to {}, {}, {}",
                saved.path.display(),
                self.steps.start(),
                self.last,
                counted(recorder.written(), "frame"),
                bytes(saved.bytes)
            ));
        }
        Ok(())
    }
}
