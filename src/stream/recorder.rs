//! A recording from its first message to its last: writes the entities listed in [`stream`](super).
//!
//! Unchanged values are not logged again; the viewer's latest-at query holds them. Plot lines therefore either
//! hold each value until the next one (`StepAfter`), or get a point where an unchanged value ends (see
//! [`series`](super::series)). All get a final point at the end of the run.

use std::{
    mem::take,
    sync::atomic::AtomicBool,
    time::{Duration, Instant as Clock},
};

use glam::DVec3;

use super::{
    blueprint::{self, Measured, Subject, Tab},
    checksums::Checksums,
    chunks::{Audience, Chunks},
    contract::{
        self, ABOUT, ABOUT_STAGES, ACCURACY, ARROWS, BODY_EVENTS, Component, DIGEST, EVENTS, Entity, FAILED, FAILURE,
        INTEGRATOR, MACHINE, MODEL, NOT_RECORDED, OVERRIDES, PAIR_PHASE, PROPERTIES, RECORDING_INFO, SCENE, SCHEDULED,
        SETTINGS, STAGE, STAGES, STEPS, SURFACE_EVENTS, VERSION, WORLD, path_of,
    },
    extract::Extractor,
    flight::{Ended, FlightRecorder},
    focus::{self, FocusFinder},
    instant::Instant,
    machine, palette,
    parts::{
        FrameView,
        batch::BatchedBodies,
        bodies::SeparateBodies,
        body_forces::BodyForces,
        changes::Changes,
        forces::Forces,
        groups::GroupPlots,
        heat::Heat,
        lines::Lines,
        marks, merged,
        merged::MergedEntities,
        moves::{self, Furthest, Moves},
        numbers::FrameNumbers,
        pairs,
        pairs::{PairPlots, Told},
        planes,
        points::Points,
        ranking,
        spheres::SphereEntities,
        springs::Springs,
        touching::Touching,
        trails::Trails,
    },
    series::Series,
    settings::{FORMAT, Frames, Trigger, application, recording_id},
    step::{StepRecord, StepWatch},
};
pub use super::{
    parts::batch::DEFORMED,
    settings::{Detail, Entities, MOST_PAIRS, Settings, file_stem},
};
use crate::{
    geometry::bounds,
    observe::{Frame, Schema, Simulation, StageFrame, StepSummary, row::rows, verify},
    sdk::{
        self, AnyValues, ApplicationId, AsComponents, Clear, LogMsg, Points3D, Scalars, StateChange, StoreId,
        StoreKind, TextDocument, TextLog, Timeline, ViewCoordinates,
        components::{MediaType, Scalar, Text},
    },
    text::{counted, significant},
};

/// Upper limit on the number of near misses listed.
pub const MOST_APPROACHES: usize = 5;

/// How far planes are drawn beyond the box of the start [its extent].
const WIDEST_SHEETS: f64 = 4.0;
/// Upper limit on the ranges of frames that the panel of a flight recorder lists.
const RANGES: usize = 8;

/// What a flight recorder writes whether or not a trigger fires.
/// Not the marks of events, which would make plots as long as the run.
static ALWAYS_WRITTEN: [&Entity; 7] =
    [&EVENTS, &SURFACE_EVENTS, &BODY_EVENTS, &SCHEDULED, &ACCURACY, &FAILED, &PAIR_PHASE];

/// Converts a simulation, step by step, to the messages of a recording.
pub struct Recorder {
    schema: Schema,
    settings: Settings,
    chunks: Chunks,
    checksums: Checksums,
    flight: Option<FlightRecorder>,
    /// Frames that are still to be written after a trigger.
    frames_after: u64,
    /// The parts of a frame; `None` in a recording without frames.
    parts: Option<FrameParts>,
    /// Number of frames made.
    frames: u64,
    /// Step of the initial state.
    first: u64,
    /// Number of those frames that are in the recording.
    written: u64,
    /// The ranges of them without a gap, of a flight recorder.
    kept: Vec<Kept>,
    /// The middle of all bodies in the last frame.
    middle: DVec3,
    /// The body with the largest displacement in the last frame, that displacement [radii], and its centre.
    worst: Option<(usize, f64, DVec3)>,
    /// The spheres (centre and radius) that are in view at first.
    framed: Vec<(DVec3, f64)>,
    /// The box in which planes are drawn.
    spread: [DVec3; 2],
    /// The parts that show stages inside steps.
    stages: Option<(StateParts, Moves)>,
    /// Number of stages shown.
    stage_count: u64,
    /// The first and the last stage of the step with the event at which the viewer opens.
    opening_stages: Option<[u64; 2]>,
    /// Why the run has failed, if it has.
    failure: Option<String>,
    /// The last step.
    at: Instant,
    watch: StepWatch,
    /// Storage for the current step, reused.
    step: StepRecord,
    frame: Frame,
}

/// Frames that a flight recorder has written, all from the first to the last.
struct Kept {
    first: Instant,
    last: Instant,
    /// Where a label stands after them.
    middle: DVec3,
}

/// The parts of a frame.
struct FrameParts {
    state: StateParts,
    pairs: PairPlots,
    /// The pairs that change phase next.
    changes: Option<Changes>,
    groups: GroupPlots,
    touching: Touching,
    numbers: FrameNumbers,
    /// Paths of free bodies; not in a batch, where they would hide everything.
    trails: Option<Trails>,
    series: Series,
    focus: FocusFinder,
    /// With forces.
    body_forces: Option<BodyForces>,
    /// Colours of displacements, with forces.
    heat: Option<Heat>,
}

/// The parts that show the state.
struct StateParts {
    extractor: Extractor,
    merged: MergedEntities,
    surfaces: Surfaces,
    spheres: SphereEntities,
    points: Option<Points>,
    forces: Option<Forces>,
    springs: Option<Springs>,
    lines: Lines,
}

#[allow(clippy::large_enum_variant)] // only one exists
enum Surfaces {
    Bodies(SeparateBodies),
    Batch(BatchedBodies),
}

impl Recorder {
    /// Number of initial messages that identify the recording: its store and its properties.
    pub const HEAD: usize = 4;

    /// Begins a recording: logs its properties, everything static, and the current state.
    ///
    /// # Errors
    /// Those of [`Simulation::overrides`]: the recording could not be run again. Or the schema or the current frame
    /// breaks the contract of [`observe`](crate::observe): names the field.
    pub fn new(simulation: &dyn Simulation, settings: Settings) -> Result<Recorder, String> {
        Recorder::numbered(simulation, settings, 0)
    }

    /// Like [`Recorder::new`], for run `number` (from 0) of several that a viewer must keep apart, even if they are
    /// equal.
    ///
    /// # Errors
    /// As for [`Recorder::new`].
    pub fn numbered(simulation: &dyn Simulation, settings: Settings, number: u64) -> Result<Recorder, String> {
        let overrides = simulation.overrides(settings.steps)?;
        let (schema, mut frame) = (simulation.schema(), Frame::default());
        verify::schema(&schema)?;
        simulation.observe(settings.want(), &mut frame);
        verify::frame(&schema, &frame, settings.want())?;
        let application = ApplicationId::new_or_unknown(application(&schema.name));
        let run = schema.run.clone() + &settings.to_toml();
        let mut id = recording_id(&schema.name, &schema.source, &run, env!("CARGO_PKG_VERSION"));
        if number > 0 {
            id = format!("{number}-{id}");
        }
        let mut chunks = Chunks::new(StoreId::new(StoreKind::Recording, application, id));
        let framing = simulation.framing(false);
        log_properties(&schema, &run, &overrides, &settings, &mut chunks);
        if settings.frames != Frames::Thin {
            // a thin recording would open an empty 3D view
            chunks.log_static(WORLD.path, &ViewCoordinates::RIGHT_HAND_Z_UP());
        }
        log_about(blueprint::about(&schema, &settings, simulation.steps_taken(), &frame, ""), &mut chunks);
        if settings.frames != Frames::Thin && settings.detail != Detail::Surface {
            log_text(&ARROWS, blueprint::arrows(&schema), &mut chunks);
        }
        if settings.frames != Frames::Thin && !schema.scheduled.is_empty() {
            marks::log_style_of_scheduled(&mut chunks);
        }
        if settings.frames != Frames::Thin && !schema.planes.is_empty() {
            planes::log(&schema, &framing, now(simulation), &mut chunks);
        }
        let mut recorder = Recorder {
            checksums: match settings.frames {
                Frames::Thin => Checksums::packed(schema.vertex_count()),
                Frames::All | Frames::Last { .. } => Checksums::by_step(),
            },
            flight: match settings.frames {
                Frames::Last { most, .. } => Some(FlightRecorder::new(most)),
                Frames::All | Frames::Thin => None,
            },
            frames_after: 0,
            parts: (settings.frames != Frames::Thin)
                .then(|| FrameParts::new(&schema, &settings, simulation.interrupt(), &mut chunks)),
            frames: 0,
            first: simulation.steps_taken(),
            written: 0,
            kept: Vec::new(),
            middle: DVec3::ZERO,
            worst: None,
            framed: focus::furthest(&simulation.framing(true)),
            spread: bounds(framing.iter().copied()),
            stages: matches!(settings.detail, Detail::Stages { .. }).then(|| {
                log_text(&ABOUT_STAGES, blueprint::stages(), &mut chunks);
                (StateParts::new(&schema, &settings, simulation.interrupt(), &mut chunks), Moves::new(&mut chunks))
            }),
            stage_count: 0,
            opening_stages: None,
            failure: None,
            at: now(simulation),
            watch: StepWatch::new(simulation, &settings),
            step: StepRecord::default(),
            frame,
            schema,
            settings,
            chunks,
        };
        let at = now(simulation);
        recorder.checksums.push(at, simulation.checksum());
        // in its own row, so that a killed run has at least this checksum
        recorder.checksums.log(&mut recorder.chunks, true);
        if recorder.parts.is_some() {
            let frame = take(&mut recorder.frame);
            recorder.log_frame(&frame, at);
            recorder.frame = frame;
        }
        recorder.keep(&StepSummary { at, ..StepSummary::default() });
        Ok(recorder)
    }

    /// Returns the messages since the last call, for the sinks. The first [`Recorder::HEAD`] identify the recording.
    pub fn take(&mut self) -> Vec<LogMsg> {
        self.checksums.log(&mut self.chunks, false);
        self.chunks.take()
    }

    /// Like [`Recorder::take`], but only returns data that fills a chunk: a file of few large chunks is smaller, and
    /// faster to write and read.
    pub fn take_full(&mut self) -> Vec<LogMsg> {
        if self.chunks.has_full() {
            self.checksums.log(&mut self.chunks, false); // frames without checksums could not be verified
        }
        self.chunks.take_full()
    }

    /// Whether [`Recorder::take_full`] would return a full chunk.
    pub fn has_full(&self) -> bool {
        self.chunks.has_full()
    }

    /// Returns the data that viewers have not received yet. Files receive theirs from the two methods above.
    pub fn show(&mut self) -> Vec<(Audience, LogMsg)> {
        self.chunks.show()
    }

    /// The layout that the viewer opens with, at `tab`, to be sent before anything else.
    pub fn blueprint(&self, simulation: &dyn Simulation, tab: Tab) -> Vec<LogMsg> {
        match self.settings.frames {
            // the viewer finds the text and the events without it, and a layout would be as large as everything else
            Frames::Thin => Vec::new(),
            _ => blueprint::messages(&self.subject(simulation), tab, self.chunks.store()),
        }
    }

    /// The layout for a page that has its own controls of time, curves and list of events.
    pub fn layout_beside_controls(&self, simulation: &dyn Simulation) -> Vec<LogMsg> {
        blueprint::beside_controls(&self.subject(simulation), self.chunks.store())
    }

    /// Layout changes for the end of a file: it opens at its first event, and timing plots are scaled to typical
    /// values, because the first frames and waits for the disk would dwarf everything else. A viewer that has been open
    /// for a while would lose the user's arrangement.
    pub fn measured_layout(&self, simulation: &dyn Simulation, tab: Tab) -> Vec<LogMsg> {
        let Some(parts) = &self.parts else { return Vec::new() };
        let pairs = parts.told(&self.schema);
        let measured = Measured {
            duration: self.at.time,
            durations: Some(parts.numbers.totals()),
            fastest: parts.numbers.fastest(),
            changed_volume: parts.groups.changed_volume(),
            distances: parts.pairs.axis(&parts.series, &self.schema, &pairs),
            lines: parts.series.outlines().collect(),
            pairs,
            stages: self.opening_stages,
            focus: parts.focus.focus(),
            kept: self.kept.first().zip(self.kept.last()).map(|(first, last)| [first.first.time, last.last.time]),
            missed: parts.pairs.missed(),
            have_acted: parts.body_forces.as_ref().map_or(&[], BodyForces::have_acted),
        };
        blueprint::measured(&self.subject(simulation), tab, self.chunks.store(), &measured)
    }

    fn subject<'a>(&'a self, simulation: &'a dyn Simulation) -> Subject<'a> {
        Subject { simulation, schema: &self.schema, settings: &self.settings }
    }

    /// The settings of the recording.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Number of frames made so far.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// Number of frames in the recording so far: a flight recorder makes more than it writes.
    pub fn written(&self) -> u64 {
        self.written
    }

    /// Adds the time that the caller spent on sending messages to the logging time.
    pub fn messages_sent(&mut self, time: Duration) {
        if let Some(parts) = &mut self.parts {
            parts.numbers.add_sending(time);
        }
    }

    /// Observes the simulation after a step, whose summary it wrote: always its events, and a frame if one is due.
    ///
    /// # Errors
    /// As for [`StepWatch::step`].
    pub fn observe(&mut self, simulation: &dyn Simulation, summary: &StepSummary) -> Result<(), String> {
        let (mut step, mut frame) = (take(&mut self.step), take(&mut self.frame));
        let has_frame = self.settings.has_frame(simulation.steps_taken());
        step.summary.clone_from(summary);
        self.watch.step(simulation, &self.settings, &mut step, has_frame.then_some(&mut frame))?;
        self.record(&step, has_frame.then_some(&frame));
        (self.step, self.frame) = (step, frame);
        Ok(())
    }

    /// The state of a frame alone, for a viewer that shows it before the rest of the run.
    pub fn preview(&self, frame: &Frame) -> Vec<LogMsg> {
        let mut chunks = Chunks::preview(self.chunks.store().clone());
        let mut state = StateParts::new(&self.schema, &self.settings, None, &mut chunks);
        state.log(FrameView::of(&self.schema, frame, frame.at), &[], &mut chunks);
        chunks.take()
    }

    /// Computes the merged surfaces of frames before they are recorded.
    pub fn lookahead(&self) -> merged::Lookahead {
        self.parts.as_ref().map(|parts| parts.state.merged.lookahead(&self.schema)).unwrap_or_default()
    }

    /// The pairs to be measured in the second frames, which are recorded after the first ones.
    pub fn foresee(&self, frames: [&[Frame]; 2]) -> Vec<Vec<[usize; 2]>> {
        self.parts.as_ref().map_or_else(Vec::new, |parts| parts.pairs.foresee(&self.schema, frames))
    }

    /// Takes the merged surfaces of the frames that are recorded next.
    pub fn expect(&mut self, ahead: merged::Ahead) {
        if let Some(parts) = &mut self.parts {
            parts.state.merged.expect(ahead);
        }
    }

    /// Records a step, and its frame if one is due.
    pub fn record(&mut self, step: &StepRecord, frame: Option<&Frame>) {
        let start = Clock::now();
        let (at, before) = (step.summary.at, self.at.time);
        self.at = at;
        self.checksums.push(at, step.checksum);
        // an instant this close to the end of a step is at it but for rounding
        let rounding = 1e-9 * self.schema.dt;
        let [first, end] =
            [before, at.time].map(|time| self.schema.scheduled.partition_point(|of| of.time <= time + rounding));
        let now = self.schema.scheduled.get(first..end).unwrap_or_default();
        marks::log_scheduled(at.step, now, self.parts.is_some(), &mut self.chunks);
        for row in rows(&step.summary.events, &step.surfaces, &step.summary.body_events) {
            pairs::log_row(&self.schema, &row, self.settings.frames == Frames::Thin, &mut self.chunks);
        }
        let Some(parts) = &mut self.parts else { return };
        parts.numbers.add(step);
        let opening = parts.focus.event_time();
        for event in &step.summary.events {
            parts.pairs.log_event(&self.schema, event, &mut parts.series, &mut self.chunks);
            parts.focus.event(&self.schema, event);
        }
        parts.state.lines.events(&self.schema, &step.summary.events, &step.pairs, &mut self.chunks);
        parts.pairs.log_shortfall(&self.schema, step.summary.shortfall.as_ref(), at, &mut self.chunks);
        parts.numbers.add_recording(Duration::ZERO, start.elapsed());
        if parts.focus.event_time() != opening {
            let last = (self.stage_count + step.stages.len() as u64).saturating_sub(1);
            self.opening_stages = (!step.stages.is_empty()).then_some([self.stage_count, last]);
        }
        self.log_stages(&step.stages, at);
        if let Some(frame) = frame {
            self.log_frame(frame, at);
        }
        self.keep(&step.summary);
    }

    fn log_stages(&mut self, stages: &[StageFrame], at: Instant) {
        let Some((state, moves)) = &mut self.stages else { return };
        let moved = stages.iter().enumerate().map(|(index, stage)| {
            let mut before = stages[..index].iter();
            let since =
                if stage.is_hypothetical { before.next() } else { before.rfind(|before| !before.is_hypothetical) };
            since.map_or_else(Vec::new, |since| moves::between(&self.schema, [&since.frame, &stage.frame]))
        });
        let moved: Vec<_> = moved.collect();
        let longest = moved.iter().map(|moved| moves::longest(moved)).fold(0.0, f64::max);
        for (StageFrame { name: stage, frame, is_hypothetical }, moved) in stages.iter().zip(moved) {
            self.chunks.set_stage(Some(self.stage_count));
            let view = FrameView::of(&self.schema, frame, at);
            let displacements = view.bodies().map(|(body, now)| now.max_displacement / body.radius);
            let (displaced, largest) = largest(displacements);
            let name = |body: usize| self.schema.bodies[body].name.as_str();
            let how = if *is_hypothetical { "would move" } else { "moved" };
            let moved = match moves.log(moved, (view, longest, how), &mut state.extractor, &mut self.chunks) {
                Some(Furthest { body, vertex, distance }) => {
                    format!("{how} {}:{vertex} {} R, ", name(body), significant(distance))
                }
                None => String::new(),
            };
            let displaced = format!("displaced {} {largest:.4} R", name(displaced));
            let line = format!("step {}: {stage} — {moved}{displaced}", at.step);
            // also by step, where it says when there are stages
            let when = at.time_point().with(Timeline::new_sequence(STAGE), self.stage_count as i64);
            self.chunks.row(STAGES.path, when, &TextLog::new(line).with_level("stage"));
            state.log(view, &[], &mut self.chunks);
            self.stage_count += 1;
        }
        self.chunks.set_stage(None);
    }

    fn log_frame(&mut self, frame: &Frame, at: Instant) {
        let view = FrameView::in_run(&self.schema, frame, at, &self.framed);
        if let Some(parts) = &mut self.parts {
            parts.log(view, self.frames, &mut self.chunks);
            let displaced = view.bodies().enumerate().filter(|(_, (_, now))| !now.is_absent);
            let displaced = displaced.map(|(body, (of, now))| {
                let is_finite = now.lengths.iter().sum::<f64>().is_finite();
                (body, if is_finite { now.max_displacement / of.radius } else { f64::INFINITY }, now.centre)
            });
            self.worst = displaced.max_by(|one, other| one.1.total_cmp(&other.1));
            if self.flight.is_some() {
                let [low, high] = view.bounds();
                self.middle = 0.5 * (low + high);
            }
            self.frames += 1;
            self.written += u64::from(self.flight.is_none());
        }
    }

    /// Logs additional components at the simulation's current instant.
    pub fn log(&mut self, entity: &str, simulation: &dyn Simulation, components: &dyn AsComponents) {
        self.chunks.log(entity, now(simulation), components);
    }

    /// Adds why the run failed to the recording's properties; before it is [finished](Recorder::finish).
    pub fn fail(&mut self, cause: &str) {
        self.log_property(FAILURE, cause);
        let line = TextLog::new(cause).with_level("error").with_color(palette::color(crate::colors::VERMILION));
        self.chunks.log(FAILED.path, self.at, &line);
        self.failure = Some(cause.to_owned());
        /// A body that is displaced further is what failed, or shows it best [radii].
        const FAR: f64 = 1.0;
        /// Vertices further out may be out of view [radii].
        const MOST: f64 = 10.0;
        if let (Some(parts), Some((body, displacement, centre))) = (&mut self.parts, self.worst)
            && displacement > FAR
            && centre.is_finite()
        {
            let of = &self.schema.bodies[body];
            let text = match displacement.is_finite() {
                true => format!("failed; largest displacement: {}, {} R", of.name, significant(displacement)),
                false => format!("failed: {} is not finite", of.name),
            };
            let seen = of.radius * (1.0 + displacement.min(MOST));
            // above the body: at its centre are other labels
            let place = centre + seen * self.schema.up;
            self.chunks.log(NOT_RECORDED.path, self.at, &notice(place, &text));
            parts.focus.fail(self.at.time, (centre, seen));
        }
    }

    /// Adds a text to the recording's properties.
    pub fn log_property(&mut self, property: Component, text: &str) {
        let property = AnyValues::default().with_component::<Text>(property.0, [text]);
        self.chunks.log_static(PROPERTIES.path, &property);
    }

    /// Moves the data logged in this step to the flight recorder, if there is one, and writes its contents if the step
    /// fires a trigger. Events and phases are always written.
    fn keep(&mut self, summary: &StepSummary) {
        let (Some(flight), Frames::Last { on, after, .. }) = (&mut self.flight, &self.settings.frames) else { return };
        for chunk in self.chunks.drain() {
            let entity = path_of(&chunk);
            if ALWAYS_WRITTEN.iter().any(|family| family.is(&entity)) {
                self.chunks.send(chunk);
            } else {
                flight.push(chunk);
            }
        }
        let has_frame = summary.at.step.is_multiple_of(self.settings.every);
        let is_after = has_frame && self.frames_after > 0;
        self.frames_after -= u64::from(is_after);
        let is_on = on.iter().any(|trigger| trigger.is_in(summary));
        if is_on {
            self.frames_after = *after;
        }
        if has_frame && let Some(Ended { at, lines, lanes, shown }) = flight.end_frame(summary.at) {
            lines.iter().for_each(|line| self.chunks.log(line, at, &Scalars::new([0.0; 0])));
            // an empty state is a gap in the lane
            lanes.iter().for_each(|lane| self.chunks.log(lane, at, &StateChange::single("")));
            shown.iter().for_each(|entity| self.chunks.log(entity, at, &Clear::new(false)));
            for ended in self.chunks.drain() {
                self.chunks.send(ended);
            }
        }
        // together they take less room than one by one
        if is_on || is_after && (self.frames_after == 0 || flight.is_full()) {
            self.write_kept();
        }
    }

    /// Writes the contents of the flight recorder.
    fn write_kept(&mut self) {
        let Some(flight) = &mut self.flight else { return };
        if let Some([first, last]) = flight.range() {
            let middle = self.middle;
            match self.kept.last_mut().filter(|kept| first.step <= kept.last.step + self.settings.every) {
                Some(before) => (before.last, before.middle) = (last, middle),
                None => self.kept.push(Kept { first, last, middle }),
            }
        }
        let state = flight.state_after_gap();
        let (chunks, frames) = flight.take();
        chunks.into_iter().for_each(|chunk| self.chunks.send(chunk));
        self.written += frames;
        if let Some((at, state)) = state {
            state.iter().for_each(|(entity, batches)| self.chunks.row(entity, at.time_point(), batches));
            for chunk in self.chunks.drain() {
                self.chunks.send(chunk);
            }
        }
    }

    /// The instant after a step.
    fn instant(&self, step: u64) -> Instant {
        Instant { step, time: step as f64 * self.schema.dt }
    }

    /// Labels where a flight recorder has no frames.
    fn label_gaps(&mut self) {
        let every = self.settings.every;
        let Some(middle) = self.kept.first().map(|kept| kept.middle) else { return };
        let shown = self.flight.iter().flat_map(FlightRecorder::entities);
        let rankings: Vec<String> = shown.filter(|entity| ranking::is_one(entity)).collect();
        let mut gap = (self.first, middle);
        let ends = self.kept.iter().map(|kept| (kept.first.step, Some(kept))).chain([(self.at.step + 1, None)]);
        for (next, kept) in ends {
            let (from, middle) = gap;
            if from < next {
                let text = format!("no frames of steps {from} to {}", next - 1);
                let at = self.instant(from);
                rankings.iter().for_each(|ranking| self.chunks.log(ranking, at, &ranking::note(&text)));
                self.chunks.log(NOT_RECORDED.path, at, &notice(middle, &text));
                if kept.is_some() {
                    self.chunks.log(NOT_RECORDED.path, self.instant(next), &Points3D::clear_fields());
                }
            }
            if let Some(Kept { last, middle, .. }) = kept {
                gap = (last.step + every, *middle);
            }
        }
    }

    /// A note if a flight recorder could not keep all requested frames.
    pub fn dropped_frames(&self) -> Option<String> {
        self.flight.as_ref().and_then(FlightRecorder::note)
    }

    /// A note if the event at which the file should open did not happen.
    pub fn missed_event(&self) -> Option<String> {
        let (around, seen) = self.parts.as_ref()?.focus.missed()?;
        let seen = if seen > 0 { format!(", only {} of that kind", counted(seen, "event")) } else { String::new() };
        let around = around.to_string();
        // a number alone is that of a phase change
        let kind = if around.bytes().all(|byte| byte.is_ascii_digit()) { "phase change " } else { "" };
        Some(format!("--around: there was no {kind}{around}{seen}; a file opens at its first event"))
    }

    /// Describes the closest approaches of pairs that stayed in their first phase, closest first.
    pub fn approaches(&self) -> Vec<String> {
        self.watch.approaches().iter().map(|approach| approach.describe(&self.schema)).collect()
    }

    /// Takes over from who observed the steps of this recording in its place.
    pub fn watched_by(&mut self, watch: StepWatch) {
        self.watch = watch;
    }

    /// Ends the recording with the last step observed: extends plot lines to it, and logs the final number of steps and near
    /// misses.
    pub fn finish(&mut self) {
        let is_waiting = match &self.settings.frames {
            // a step that was not completed was not observed either
            Frames::Last { on, .. } => !(on.is_empty() || self.failure.is_some() && on.contains(&Trigger::Diverge)),
            _ => false,
        };
        if !is_waiting || self.frames_after > 0 {
            self.write_kept();
        }
        let first = self.instant(self.first);
        if let Some(parts) = self.parts.as_mut().filter(|_| !is_waiting) {
            parts.series.extend_all(&mut self.chunks);
            parts.numbers.log_ranking(&mut self.chunks);
            // bodies may have left the sheets on which they seemed to lie; those that change stay as they are
            let [low, high] = self.spread;
            let corners = [low, high].map(|corner| (corner, 0.0));
            let wide = WIDEST_SHEETS * (high - low).max_element();
            let run = bounds(parts.focus.run().chain(corners).collect::<Vec<_>>().into_iter())
                .map(|corner| (corner.clamp(low - wide, high + wide), 0.0));
            if self.schema.changes.is_empty() && run != corners {
                planes::log(&self.schema, &run, self.at, &mut self.chunks);
            }
            if self.flight.is_none() {
                let told = parts.told(&self.schema);
                let level = parts.pairs.axis(&parts.series, &self.schema, &told).map(|axis| axis.ends[0]);
                marks::log_ends([first, self.at], level, &mut self.chunks);
                parts.pairs.log_events_of_told(&self.schema, &told, &mut self.chunks);
                let approaches = self.watch.approaches();
                let nearest = &approaches[..approaches.len().min(MOST_APPROACHES)];
                parts.pairs.log_approaches(&self.schema, &told, nearest, &mut self.chunks);
            }
        }
        let ranges: Vec<String> =
            self.kept.iter().take(RANGES).map(|kept| format!("{} to {}", kept.first.step, kept.last.step)).collect();
        let more = if self.kept.len() > RANGES { " and others" } else { "" };
        let kept = match (&self.flight, ranges.is_empty()) {
            (None, _) => String::new(),
            (Some(_), false) => format!(
                "**Frames: only of steps {}{more}.** At others, views of an instant are empty.\n\n",
                ranges.join(", ")
            ),
            (Some(_), true) => {
                "**No frames**: what they are kept for did not happen. Ignore the 3D views.\n\n".to_owned()
            }
        };
        self.label_gaps();
        let mut nearest = String::new();
        for (number, line) in self.approaches().iter().take(MOST_APPROACHES).enumerate() {
            let head = if number == 0 { "\nNearest without a change of phase:\n" } else { "" };
            nearest += &format!("{head}- {line}\n");
        }
        let failed = self.failure.as_ref().map(|cause| format!("**Failed**: {cause}.\n\n"));
        if failed.is_some() || !(kept.is_empty() && nearest.is_empty()) {
            // without an event, they are what there is to say
            let is_first = self.parts.as_ref().is_some_and(|parts| parts.focus.focus().is_none());
            let [first, later] = if is_first { [nearest + "\n", String::new()] } else { [String::new(), nearest] };
            let about = blueprint::about(&self.schema, &self.settings, self.first, &self.frame, &later);
            log_about(failed.unwrap_or_default() + &kept + &first + &about, &mut self.chunks);
        }
        self.checksums.log(&mut self.chunks, true);
        self.log_property(DIGEST, &format!("{:016x}", self.checksums.digest()));
        log_steps(Some(self.at.step), &mut self.chunks);
    }
}

impl FrameParts {
    /// The pairs that have plots worth a look in the layout.
    fn told(&self, schema: &Schema) -> Told {
        self.pairs.told(schema, &self.series, self.focus.focus().map_or(0.0, |focus| focus.time))
    }

    /// Logs static data.
    fn new(
        schema: &Schema,
        settings: &Settings,
        interrupt: Option<&'static AtomicBool>,
        chunks: &mut Chunks,
    ) -> FrameParts {
        let mut series =
            if matches!(settings.frames, Frames::Last { .. }) { Series::whole() } else { Series::default() };
        let state = StateParts::new(schema, settings, interrupt, chunks);
        let numbers = FrameNumbers::new(schema, &mut series, chunks);
        let trails = if settings.entities == Entities::Body { Trails::new(schema, chunks) } else { None };
        let heat = (settings.detail != Detail::Surface)
            .then(|| Heat::new(schema, &blueprint::surfaces(schema, settings), &mut series, chunks));
        FrameParts {
            state,
            pairs: PairPlots::new(settings),
            changes: Changes::new(schema, settings.steps, chunks),
            groups: GroupPlots::new(schema, settings.pairs, &mut series, chunks),
            touching: Touching::default(),
            numbers,
            trails,
            series,
            focus: FocusFinder::new(settings),
            body_forces: (settings.detail != Detail::Surface).then(|| BodyForces::new(schema, chunks)),
            heat,
        }
    }

    /// Logs changed values; `number` is the number of the frame.
    fn log(&mut self, view: FrameView<'_>, number: u64, chunks: &mut Chunks) {
        let start = Clock::now();
        let FrameParts { state, pairs, changes, groups, touching, numbers, trails, series, focus, body_forces, heat } =
            self;
        focus.frame(view);
        let [extracting, ahead] = state.log(view, pairs.choose(view, series, chunks), chunks);
        if let Some(trails) = trails {
            trails.log(view, chunks);
        }
        if let Some(body_forces) = body_forces {
            body_forces.log(view, series, chunks);
        }
        if let (Some(heat), Some(forces)) = (heat, &state.forces) {
            heat.log(view, &forces.displacements, series, chunks);
        }
        let merged = state.merged.merged();
        pairs.log(view, &merged.pairs, number, series, chunks);
        if let Some(changes) = changes {
            changes.log(view, chunks);
        }
        groups.log(view, merged, series, chunks);
        touching.log(view, pairs.shown(), &merged.pairs, chunks);
        numbers.log_scalars(view, series, chunks);
        numbers.add_recording(extracting + ahead, start.elapsed().saturating_sub(extracting));
        numbers.log_timings(view.at, chunks);
    }
}

impl StateParts {
    /// Logs static data.
    fn new(
        schema: &Schema,
        settings: &Settings,
        interrupt: Option<&'static AtomicBool>,
        chunks: &mut Chunks,
    ) -> StateParts {
        let extractor = Extractor::default();
        let detail = settings.detail;
        let spheres = SphereEntities::new(schema, settings.entities, chunks);
        let surfaces = match settings.entities {
            Entities::Body => Surfaces::Bodies(SeparateBodies::new(schema, detail, chunks)),
            Entities::Batch => Surfaces::Batch(BatchedBodies::new(detail, chunks)),
        };
        let forces = (detail != Detail::Surface).then(|| Forces::new(schema, settings.entities, chunks));
        let springs = if detail != Detail::Surface { Springs::new(schema, chunks) } else { None };
        let lines = Lines::new(schema, settings, chunks);
        let merged = MergedEntities::new(schema, interrupt, chunks);
        let points = Points::new(schema, chunks);
        StateParts { extractor, merged, surfaces, spheres, points, forces, springs, lines }
    }

    /// Logs changed values, and measures `pairs`; returns the time spent on extraction, now and ahead.
    fn log(&mut self, view: FrameView<'_>, pairs: &[[usize; 2]], chunks: &mut Chunks) -> [Duration; 2] {
        let start = Clock::now();
        let StateParts { extractor, merged, surfaces, spheres, points, forces, springs, lines } = self;
        let ahead = merged.log(view, pairs, chunks);
        if let Some(forces) = forces {
            forces.extract(view, &merged.merged().groups, extractor);
        }
        let vertices = forces.as_ref().map_or(&[] as &[_], |forces| &forces.vertices);
        let is_merged = &merged.merged().is_merged;
        match surfaces {
            Surfaces::Bodies(bodies) => bodies.log(view, is_merged, vertices, extractor, chunks),
            Surfaces::Batch(batch) => batch.log(view, is_merged, vertices, extractor, chunks),
        }
        let extracting = start.elapsed();
        if let Some(forces) = forces {
            forces.log(view, chunks);
        }
        if let Some(springs) = springs {
            springs.log(view, chunks);
        }
        spheres.log(view, chunks);
        if let Some(points) = points {
            points.log(view, chunks);
        }
        lines.log(view, chunks);
        [extracting, ahead]
    }
}

/// The first of the largest numbers, with its index.
fn largest(numbers: impl Iterator<Item = f64>) -> (usize, f64) {
    numbers.enumerate().fold((0, 0.0), |largest, of| if of.1 > largest.1 { of } else { largest })
}

/// A label in space about the recording.
fn notice(place: DVec3, text: &str) -> Points3D {
    let label = Points3D::update_fields().with_radii([sdk::Radius::new_ui_points(0.0)]).with_show_labels(true);
    let label = label.with_positions([place.as_vec3().to_array()]).with_labels([text]);
    label.with_colors([palette::color(crate::colors::VERMILION)])
}

fn log_about(text: String, chunks: &mut Chunks) {
    log_text(&ABOUT, text, chunks);
}

fn log_text(entity: &Entity, text: String, chunks: &mut Chunks) {
    chunks.log_static(entity.path, &TextDocument::new(text).with_media_type(MediaType::MARKDOWN));
}

fn log_properties(schema: &Schema, run: &str, overrides: &str, settings: &Settings, chunks: &mut Chunks) {
    let properties = AnyValues::default()
        .with_component::<Text>(SCENE.0, [schema.source.as_str()])
        .with_component::<Text>(SETTINGS.0, [run])
        .with_component::<Text>(OVERRIDES.0, [overrides])
        .with_component::<Text>(VERSION.0, [env!("CARGO_PKG_VERSION")])
        .with_component::<Scalar>(contract::FORMAT.0, [f64::from(FORMAT)])
        .with_component::<Text>(MACHINE.0, [machine::describe()])
        .with_component::<Text>(INTEGRATOR.0, [schema.integrator.as_str()]);
    // omitted for oscillators, as in recordings made before there were other models
    let properties = match schema.non_default_model() {
        None => properties,
        Some(model) => properties.with_component::<Text>(MODEL.0, [model]),
    };
    chunks.log_static(PROPERTIES.path, &properties);
    chunks.log_static(RECORDING_INFO.path, &sdk::RecordingInfo::new().with_name(schema.name.as_str()));
    log_steps(settings.steps, chunks);
}

/// Logs the number of steps: the planned one, and at the end the actual one.
fn log_steps(steps: Option<u64>, chunks: &mut Chunks) {
    let steps = AnyValues::default().with_component::<Scalar>(STEPS.0, [steps.unwrap_or(0) as f64]);
    chunks.log_static(PROPERTIES.path, &steps);
}

fn now(simulation: &dyn Simulation) -> Instant {
    Instant { step: simulation.steps_taken(), time: simulation.time() }
}
