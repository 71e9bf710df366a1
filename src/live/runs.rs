//! Runs of the changed experiment: the newest change first, and what it replaces is interrupted.

use std::{
    collections::VecDeque,
    path::{Path, PathBuf},
    sync::{
        Arc, Condvar, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant as Clock},
};

use serde::Serialize;
use serde_json::{Value, json};

use super::{
    change::{Change, Problem},
    feed::Feed,
    outline::Outline,
    recording::{Recording, Writer},
    thresholds,
};
use crate::{
    atomic,
    colors::hex,
    lock,
    observe::{BodyFrame, Experiment, Frame, Parameter, StepSummary, Want, schema::BodySchema},
    sdk::LogMsg,
    stream::{
        self, Recorder, Settings,
        sinks::{Destinations, serve::Parts},
        step::{StepRecord, StepWatch},
    },
};

/// Number of runs whose recordings are kept: the one on screen, the one that is being opened, and the newest.
const KEPT: usize = 3;
/// Upper limit on a recording [bytes], about. Of a larger one, only every Nth step has a frame.
const RECORDING: u64 = 256 << 20;
/// Frames that are recorded between two looks at whether the run is outdated.
const BATCH: usize = 16;
/// Upper limit on the steps between two of these looks.
const MAX_RECORDS: usize = 1024;
/// A run that takes longer reports its progress, at this interval.
const PATIENCE: Duration = Duration::from_millis(300);
/// Scenes with more bodies have no poke control: the list of names would be too long.
const MAX_POKED: usize = 1000;
/// Upper limit on the files that are asked for and not yet saved.
const MAX_SAVES: usize = 16;
/// Upper limit on the numbers that are tried for the name of a saved file.
const NAMES: usize = 10_000;

/// The runs of a page, and what it asks for.
pub struct Runs {
    /// What every page knows.
    pub feed: Feed,
    wanted: Mutex<Wanted>,
    wake: Condvar,
    /// Interrupts the simulation that is running.
    interrupt: &'static AtomicBool,
    save: PathBuf,
    recordings: Mutex<VecDeque<Recording>>,
}

struct Wanted {
    experiment: Arc<dyn Experiment>,
    change: Change,
    /// Number of the run that is asked for.
    number: u64,
    /// Whether it has begun.
    has_begun: bool,
    /// What is to be saved, in the order of the requests, each with the change that the page showed.
    saves: VecDeque<(Save, Arc<dyn Experiment>, Change)>,
    /// Whether it is being saved: changes wait.
    is_saving: bool,
    /// The parameter whose thresholds are asked for.
    thresholds: Option<String>,
    /// What is wrong with a scene file that could not be read: the experiment is that of the file before.
    problem: Option<Problem>,
    has_ended: bool,
}

/// What a page can save.
#[derive(Clone, Copy, Debug, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Save {
    /// A recording of the run.
    Recording,
    /// The changed scene.
    Scene,
}

enum Job {
    Run,
    Save(Save),
    Thresholds(String),
}

/// A run that was interrupted: the experiment that was changed, and what it became.
struct Unfinished {
    experiment: Arc<dyn Experiment>,
    changed: Arc<dyn Experiment>,
}

/// A body that a force point can act on, at the start.
#[derive(Serialize)]
struct Body {
    name: String,
    radius: f64,
    at: [f64; 3],
}

impl Runs {
    /// The runs of an experiment; the first is that of the experiment itself. What is saved goes to `save`, or beside
    /// it.
    pub fn new(experiment: Arc<dyn Experiment>, save: PathBuf, interrupt: &'static AtomicBool) -> Runs {
        let feed = Feed::default();
        feed.send("scene", scene_of(&*experiment, &bodies_to_poke(&*experiment)));
        let wanted = Wanted {
            experiment,
            change: Change::default(),
            number: 1,
            has_begun: false,
            saves: VecDeque::new(),
            is_saving: false,
            thresholds: None,
            problem: None,
            has_ended: false,
        };
        Runs { feed, wanted: Mutex::new(wanted), wake: Condvar::new(), interrupt, save, recordings: Mutex::default() }
    }

    /// Asks for another run, and returns its number.
    fn want(&self, set: impl FnOnce(&mut Wanted)) -> u64 {
        let mut wanted = lock(&self.wanted);
        set(&mut wanted);
        wanted.number += 1;
        wanted.has_begun = false;
        if !wanted.is_saving || wanted.has_ended {
            self.interrupt.store(true, Ordering::Relaxed);
        }
        let Change { page, values, branches, poke, .. } = &wanted.change;
        self.feed.send(
            "changes",
            json!({
                // the page that asked for it, if it was one
                "page": page,
                "values": values,
                "branches": branches,
                "poke": poke,
            }),
        );
        let number = wanted.number;
        drop(wanted);
        self.wake.notify_all();
        number
    }

    /// Asks for the run of a change, in place of any other, and returns its number.
    pub fn ask(&self, change: Change) -> u64 {
        self.want(|wanted| wanted.change = change)
    }

    /// Continues with another experiment and the same changes, where its parameters have them.
    pub fn replace(&self, experiment: Arc<dyn Experiment>) {
        let (parameters, bodies) = (experiment.parameters(), bodies_to_poke(&*experiment));
        let scene = scene_of(&*experiment, &bodies);
        self.want(|wanted| {
            let known = |key: &String| parameters.iter().find(|parameter| parameter.key == *key);
            let Change { page, values, branches, poke, .. } = &mut wanted.change;
            page.clear();
            values.retain(|key, _| known(key).is_some());
            for branch in branches.iter_mut() {
                branch.values.retain(|key, _| known(key).is_some_and(|parameter| parameter.can_branch));
            }
            branches.retain(|branch| !branch.values.is_empty());
            // not of `bodies`: a run that is interrupted at its start has none
            let named = |name: &str| experiment.schema().bodies.iter().any(|body| body.name == name);
            let can_poke = experiment.can_poke() && experiment.schema().bodies.len() <= MAX_POKED;
            *poke = poke.take().filter(|poke| can_poke && named(&poke.body));
            wanted.experiment = experiment;
            wanted.problem = None;
            self.feed.send("scene", scene);
        });
    }

    /// Asks for the values of a parameter at which the outcome of the run changes.
    pub fn find_thresholds(&self, key: String) {
        lock(&self.wanted).thresholds = Some(key);
        self.wake.notify_all();
    }

    /// Asks for a file of what is asked for now.
    ///
    /// # Errors
    /// `MAX_SAVES` files are waiting already.
    pub fn save(&self, what: Save) -> Result<(), Problem> {
        let mut wanted = lock(&self.wanted);
        if wanted.saves.len() >= MAX_SAVES {
            return Err(Problem::new(format!("{MAX_SAVES} files are still to be saved: ask again later")));
        }
        let of = (what, Arc::clone(&wanted.experiment), wanted.change.clone());
        wanted.saves.push_back(of);
        drop(wanted);
        self.wake.notify_all();
        Ok(())
    }

    /// Shows a problem beside the runs, until there is [another experiment](Runs::replace).
    pub fn report(&self, problem: Problem) {
        lock(&self.wanted).problem = Some(problem.clone());
        self.feed.problem(&problem);
    }

    /// Ends [`Runs::work`].
    pub fn end(&self) {
        self.want(|wanted| wanted.has_ended = true);
    }

    /// Runs what is asked for, until [`Runs::end`].
    pub fn work(&self) {
        let mut unfinished = None;
        while let Some((job, experiment, change, number)) = self.next_job() {
            match job {
                Job::Run => self.answer(&experiment, &change, number, &mut unfinished),
                Job::Save(what) => {
                    let saved = varied(&*experiment, &change).and_then(|varied| self.save_now(&*varied, what));
                    lock(&self.wanted).is_saving = false;
                    if let Err(problem) = &saved {
                        self.feed.problem(problem);
                    }
                }
                Job::Thresholds(key) => self.mark(&*experiment, &change, number, key),
            }
        }
    }

    /// Runs a change. If it is invalid, shows the problem, and starts the run before it again if that was `unfinished`.
    fn answer(
        &self,
        experiment: &Arc<dyn Experiment>,
        change: &Change,
        number: u64,
        unfinished: &mut Option<Unfinished>,
    ) {
        let before = unfinished.take().filter(|before| Arc::ptr_eq(&before.experiment, experiment));
        let (changed, problem) = match varied(&**experiment, change) {
            Ok(changed) => (changed, None),
            Err(problem) => {
                if self.is_current(number) {
                    self.feed.problem(&problem);
                }
                let Some(Unfinished { changed, .. }) = before else { return };
                (changed, Some(problem))
            }
        };
        let done = self.run(&*changed, number, change.cursor, problem);
        let is_current = self.is_current(number);
        *unfinished = (!is_current).then(|| Unfinished { experiment: Arc::clone(experiment), changed });
        // an outdated run ends with an error where a model cannot be interrupted halfway
        if let Err(problem) = done
            && is_current
        {
            self.feed.problem(&problem);
        }
    }

    /// Waits for something to do: with the experiment, its change, and the number of its run. `None` at the end.
    fn next_job(&self) -> Option<(Job, Arc<dyn Experiment>, Change, u64)> {
        let mut wanted = lock(&self.wanted);
        loop {
            if wanted.has_ended {
                return None;
            }
            let job = if !wanted.has_begun {
                Some((Job::Run, Arc::clone(&wanted.experiment), wanted.change.clone()))
            } else if let Some((what, experiment, change)) = wanted.saves.pop_front() {
                Some((Job::Save(what), experiment, change))
            } else {
                let job = wanted.thresholds.take().map(Job::Thresholds);
                job.map(|job| (job, Arc::clone(&wanted.experiment), wanted.change.clone()))
            };
            if let Some((job, experiment, change)) = job {
                wanted.has_begun = true;
                wanted.is_saving = matches!(job, Job::Save(_));
                self.interrupt.store(false, Ordering::Relaxed);
                return Some((job, experiment, change, wanted.number));
            }
            wanted = self.wake.wait(wanted).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn is_current(&self, number: u64) -> bool {
        lock(&self.wanted).number == number
    }

    /// Finds the thresholds of a parameter. Any other request interrupts the search, which then starts over.
    fn mark(&self, experiment: &dyn Experiment, change: &Change, number: u64, key: String) {
        let is_waited_for = || {
            let wanted = lock(&self.wanted);
            wanted.number == number && wanted.saves.is_empty() && wanted.thresholds.is_none()
        };
        match thresholds::find(experiment, &change.variation(), &key, &is_waited_for) {
            Some(marks) => self.feed.send("marks", json!({ "number": number, "key": key, "marks": marks })),
            None => {
                lock(&self.wanted).thresholds.get_or_insert(key);
            }
        }
    }

    /// Runs an experiment twice: for its events and curves, which are sent at once, and to record it. Runs are
    /// reproducible to the bit, and the first is quick, because nothing is drawn. An outdated run ends early. If it
    /// stands in for a change that is invalid, pages show that `problem` beside it.
    fn run(
        &self,
        experiment: &dyn Experiment,
        number: u64,
        cursor: u64,
        problem: Option<Problem>,
    ) -> Result<(), Problem> {
        let start = Clock::now();
        let mut reported = start;
        let mut report = |doing, step, steps| {
            if reported.elapsed() > PATIENCE {
                reported = Clock::now();
                self.feed.send("progress", json!({ "number": number, "doing": doing, "step": step, "steps": steps }));
            }
        };
        let mut simulation = experiment.start().map_err(Problem::new)?;
        let settings = Settings::of(experiment);
        let mut outline = Outline::new(simulation.schema(), problem);
        let of_file = || lock(&self.wanted).problem.clone();
        let mut frame = Frame::default();
        let (mut at_cursor, mut summary) = (Frame::default(), StepSummary::default());
        simulation.observe(Want::default(), &mut frame);
        outline.frame(&frame);
        let steps = outline.schema.steps;
        while outline.failure.is_none() && simulation.steps_taken() < steps {
            if simulation.steps_taken() == cursor {
                simulation.observe(settings.want(), &mut at_cursor);
            }
            summary.clear();
            simulation.step(&mut summary);
            if outline.step(&*simulation, &summary) {
                simulation.observe(Want::default(), &mut frame);
                outline.frame(&frame);
            }
            if !self.is_current(number) {
                return Ok(());
            }
            report("simulating", simulation.steps_taken(), steps);
        }
        if simulation.steps_taken() <= cursor {
            simulation.observe(settings.want(), &mut at_cursor);
        }
        outline.simulated_ms = 1e3 * start.elapsed().as_secs_f64();
        self.feed.send("run", outline.answer(number, None, of_file()));

        let start = Clock::now();
        let mut simulation = experiment.start().map_err(Problem::new)?;
        let mut recorder = Recorder::numbered(&*simulation, settings.clone(), number).map_err(Problem::new)?;
        let mut writer = self.open(number, &recorder.layout_beside_controls(&*simulation))?;
        self.feed.send("open", recorded(number, 0, 0.0, 1));
        writer.write(&recorder.preview(&at_cursor))?;
        let mut lookahead = recorder.lookahead();
        let mut watch = StepWatch::new(&*simulation, &settings);
        let (mut records, mut frames, mut contacts) = (Vec::new(), Vec::new(), Vec::new());
        let (last, mut every) = (outline.steps, 1);
        while simulation.steps_taken() < last {
            let mut step = StepRecord::default();
            simulation.step(&mut step.summary);
            if !self.is_current(number) {
                return Ok(());
            }
            let taken = simulation.steps_taken();
            let mut frame = taken.is_multiple_of(every).then(Frame::default);
            watch.step(&*simulation, &settings, &mut step, frame.as_mut()).map_err(Problem::new)?;
            contacts.extend(step.surfaces.iter().filter(|found| found.is_contact()).copied());
            records.push(step);
            frames.extend(frame);
            if frames.len() == BATCH || records.len() == MAX_RECORDS || taken == last {
                let foreseen = recorder.foresee([&[], &frames]);
                recorder.expect(lookahead.compute(&frames, &foreseen, || {}));
                let mut frames = frames.drain(..).peekable();
                for step in records.drain(..) {
                    let frame = frames.next_if(|frame| frame.at.step == step.summary.at.step);
                    recorder.record(&step, frame.as_ref());
                }
                drop(frames);
                if recorder.has_full() {
                    // with what goes with it, so that nothing on screen is of another instant while the rest arrives
                    writer.write(&recorder.take())?;
                    every = every.max(interval(writer.bytes(), recorder.written(), last - taken));
                }
            }
            report("recording", taken, steps);
        }
        recorder.watched_by(watch);
        recorder.finish();
        writer.write(&recorder.take())?;
        drop(writer);
        if self.is_current(number) {
            self.feed.send("run", outline.answer(number, Some(&contacts), of_file()));
            let ms = 1e3 * start.elapsed().as_secs_f64();
            self.feed.send("frames", recorded(number, recorder.written(), ms, every));
        }
        Ok(())
    }

    /// Begins the recording of a run.
    fn open(&self, number: u64, layout: &[LogMsg]) -> Result<Writer, Problem> {
        let (recording, writer) = Recording::begin(number, layout)?;
        let mut recordings = lock(&self.recordings);
        recordings.push_back(recording);
        while recordings.len() > KEPT {
            recordings.pop_front();
        }
        Ok(writer)
    }

    /// The recording of a run, as a file that grows; with the layout if `is_first`. `None` if it has been replaced.
    pub fn recording(&self, number: u64, is_first: bool) -> Option<Parts> {
        let recordings = lock(&self.recordings);
        recordings.iter().find(|recording| recording.number == number).map(|recording| recording.read(is_first))
    }

    fn save_now(&self, experiment: &dyn Experiment, what: Save) -> Result<(), Problem> {
        let text = match what {
            Save::Recording => {
                let path = free_name(&self.save, "rrd")?;
                let destinations = Destinations::file(&path);
                let frames = stream::record(experiment, Settings::of(experiment), &destinations)
                    .map_err(|error| Problem::new(error.to_string()))?;
                let is_whole = !self.interrupt.load(Ordering::Relaxed);
                let what = if is_whole { "" } else { ", interrupted" };
                let frames = if frames == 1 { "1 frame".to_owned() } else { format!("{frames} frames") };
                format!("saved {}: {frames}{what}", path.display())
            }
            Save::Scene => {
                let path = free_name(&self.save, "toml")?;
                atomic::write_new(&path, &experiment.schema().source)
                    .map_err(|error| Problem::new(format!("{} cannot be written: {error}", path.display())))?;
                format!("saved {}", path.display())
            }
        };
        self.feed.send("saved", json!({ "text": text }));
        Ok(())
    }
}

/// The experiment with a change.
fn varied(experiment: &dyn Experiment, change: &Change) -> Result<Arc<dyn Experiment>, Problem> {
    experiment.varied(&change.variation()).map_err(|invalid| Problem { key: invalid.key, text: invalid.text })
}

/// A path like this one that is free, because saving replaces nothing: `name.rrd`, `name-2.rrd` …
fn free_name(path: &Path, extension: &str) -> Result<PathBuf, Problem> {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let numbered = (2..NAMES).map(|number| format!("{stem}-{number}"));
    let names = std::iter::once(stem.to_string()).chain(numbered);
    let mut paths = names.map(|name| path.with_file_name(format!("{name}.{extension}")));
    let taken = || Problem::new(format!("all names from {} on are taken: remove some of these files", path.display()));
    paths.find(|path| !path.exists()).ok_or_else(taken)
}

/// Steps from one frame to the next with which the rest of a recording stays below its upper limit, if its frames are
/// as large as those so far.
fn interval(bytes: u64, frames: u64, steps_left: u64) -> u64 {
    let affordable = RECORDING.saturating_sub(bytes).saturating_mul(frames.max(1)) / bytes.max(1);
    steps_left.div_ceil(affordable.max(1)).max(1)
}

/// What pages know of the recording of a run: its frames, how long it took [ms], and the steps from one frame to the next at
/// the end.
fn recorded(number: u64, frames: u64, ms: f64, every: u64) -> Value {
    json!({ "number": number, "frames": frames, "ms": ms, "every": every })
}

/// What pages know of an experiment.
fn scene_of(experiment: &dyn Experiment, bodies: &[Body]) -> Value {
    let schema = experiment.schema();
    let parameter = |parameter: Parameter| {
        json!({
            "key": parameter.key,
            "label": parameter.label,
            "group": parameter.group,
            "unit": parameter.unit,
            "about": parameter.about,
            "value": parameter.value,
            "min": parameter.range[0],
            "max": parameter.range[1],
            "can_branch": parameter.can_branch,
        })
    };
    let phases = schema.phases.iter().map(|phase| (phase.name, phase.color, false));
    let terms = schema.terms.iter().filter(|term| term.is_shown && term.can_act);
    let terms = terms.map(|term| (term.label, term.color, true));
    let entry = |(label, color, is_arrow)| json!({ "label": label, "color": hex(color), "is_arrow": is_arrow });
    json!({
        "name": schema.name,
        "dt": schema.dt,
        "steps": schema.steps,
        "parameters": experiment.parameters().into_iter().map(parameter).collect::<Vec<Value>>(),
        "legend": phases.chain(terms).map(entry).collect::<Vec<Value>>(),
        "bodies": bodies,
    })
}

/// The first bodies of an experiment, where they are at the start.
fn bodies_to_poke(experiment: &dyn Experiment) -> Vec<Body> {
    let schema = experiment.schema();
    if !experiment.can_poke() || schema.bodies.len() > MAX_POKED {
        return Vec::new();
    }
    let Ok(simulation) = experiment.start() else { return Vec::new() };
    let mut frame = Frame::default();
    simulation.observe(Want::default(), &mut frame);
    let body = |(body, now): (&BodySchema, &BodyFrame)| Body {
        name: body.name.clone(),
        radius: body.radius,
        at: now.centre.into(),
    };
    schema.bodies.iter().zip(&frame.bodies).map(body).collect()
}
