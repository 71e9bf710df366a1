//! Plots of pairs: q and its thresholds, the phase, events, and geometric measures (gap, overlap and neck).

use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    sync::Arc,
};

use super::{
    FrameView,
    marks::{self, Marks},
};
use crate::{
    analysis::approach::Approach,
    colors,
    observe::{
        BodyEvent, EventRow, Frame, PairEvent, PairFrame, Schema, Shortfall, SurfaceEvent,
        surface::{Finding, PairMeasures},
    },
    sdk::{
        AnyValues, AsComponents, SerializedComponentBatch, SeriesLines, StateChange, StateConfiguration, TextLog,
        arrow::array::{Array, Float64Array},
        components::Text,
    },
    stream::{
        chunks::Chunks,
        contract::{
            ACCURACY, BODIES, BODY_EVENTS, ENERGY, EVENTS, Entity, MARKS_AT_Q, MARKS_OF_DRAWN, PAIR_CONTACT,
            PAIR_DISTANCE, PAIR_GAP, PAIR_LEVEL, PAIR_NECK, PAIR_OVERLAP, PAIR_PHASE, PAIR_SCALAR, PHASES, Q, RATE,
            SURFACE_EVENTS, TIME,
        },
        instant::Instant,
        palette::{self, color},
        series::{Interpolation, LineId, Series},
        settings::Settings,
    },
};

/// The q of a pair with three decimals, or six if three equal those of a threshold.
pub fn told_q(schema: &Schema, pair: [usize; 2], q: f64, time: f64) -> String {
    let text = format!("{q:.3}");
    let mut levels = (0..schema.thresholds.len()).filter_map(|threshold| schema.level(threshold, pair, time));
    let is_same = levels.any(|level| level != q && format!("{level:.3}") == text);
    if is_same { format!("{q:.6}") } else { text }
}

/// A q that changes less is not worth a line in a plot [–].
const STILL: f64 = 1e-4;
/// Colour of the lines about steps beyond the tolerance.
const SHORTFALL: palette::Rgb = colors::VERMILION;
/// Maximum interval between points of threshold lines [frames], so that they keep up with a live plot.
const THRESHOLD_FRAMES: u64 = 64;

/// A frame of a pair without a plot.
#[derive(Clone, Copy)]
struct Kept {
    at: Instant,
    q: f64,
    phase: usize,
}

/// Upper limits on the frames and pairs whose q is kept for pairs without a plot, in case they have an event.
const KEPT_FRAMES: usize = 512;
const KEPT_PAIRS: usize = 1024;

/// The pairs that have their own entities.
///
/// The settings limit the number of pairs that get entities because they come within reach. Up to as many again get them at
/// their first event, with q of the previous frames; the last of these places are for events late in the run.
pub struct PairPlots {
    /// Upper limit on the number of pairs that have entities because they came within reach.
    max_in_reach: usize,
    /// The last step of the run, if it is known.
    steps: Option<u64>,
    /// The only pairs that may have entities, as `A~B`; empty: all.
    only: Vec<String>,
    known: BTreeMap<(usize, usize), PairPlot>,
    /// q of pairs without a plot.
    kept: BTreeMap<(usize, usize), VecDeque<Kept>>,
    marks: Marks,
    in_reach: BTreeSet<(usize, usize)>,
    /// Scratch storage, reused.
    next_in_reach: BTreeSet<(usize, usize)>,
    new: Vec<PairFrame>,
    /// The pairs of the current frame that have their own entities.
    shown: Vec<[usize; 2]>,
    /// The error over the tolerance that was logged last, while the error exceeds the tolerance.
    shortfall: Option<f64>,
    /// Number of steps whose error exceeds the tolerance.
    missed: u64,
}

/// The axis of plots of q.
#[derive(Clone, Debug)]
pub struct Axis {
    /// Its ends [–].
    pub ends: [f64; 2],
    /// The pairs with thresholds beyond these: those far from all q would leave its lines no room.
    pub beyond: Vec<(usize, usize)>,
}

struct PairPlot {
    phase: String,
    /// The first changes of its phase, up to [`MOST_CHANGES`].
    changes: Vec<PairEvent>,
    /// Whether its surfaces touched or its phase joined them.
    has_met: bool,
    distance: LineId,
    thresholds: Vec<(LineId, usize)>,
    /// Lines of gap, overlap and neck.
    measures: [LineId; 3],
    /// Lines of the scalars of the schema.
    scalars: Vec<LineId>,
    /// The lane that compares phase and surfaces, and the state that was last logged.
    contact: String,
    last_contact: Option<usize>,
}

/// Upper limits on the numbers of lines and of lanes in one view: of more, one would find none.
const MOST_LINES: usize = 8;
const MOST_LANES: usize = 12;
/// With fewer lanes of pairs that change phase, there is room for others, which came closest.
const FEW_LANES: usize = 5;
/// Share of the places for pairs with events that is free from the start; the rest becomes free in proportion to time.
const FIRST_EVENTS: f64 = 0.25;
/// Upper limit on the known phase changes of a pair: a run need not end.
const MOST_CHANGES: usize = 1024;
/// Upper limit on the instants at which the levels of a pair are looked up for its legend.
const MOST_LEVELS: usize = 16;

/// The pairs that have plots worth a look, as `A~B`; where none has, all of them. Of many, some that change phase at the
/// instant at which the viewer opens and throughout the run.
#[derive(Clone, Debug, Default)]
pub struct Told {
    /// Those whose q changed.
    pub moving: Vec<String>,
    /// Number of others whose q changed.
    pub left_out: usize,
    /// Those whose phase changed, and others where there is room for their lanes.
    pub changed: Vec<String>,
    /// Those that touched, or were joined.
    pub met: Vec<String>,
    /// Number of pairs that have plots.
    pub all: usize,
}

impl PairPlot {
    /// Whether q stays the same, but for what resting bodies tremble.
    fn is_still(&self, series: &Series) -> bool {
        series.outline(self.distance).range.is_none_or(|[low, high]| high - low < STILL)
    }
}

/// Whether two bodies are joined by their phase, and touch by their surfaces: names and colours.
pub const CONTACTS: [(&str, palette::Rgb); 5] = [
    ("apart", colors::GREY),
    ("joined and touching", colors::YELLOW),
    ("joined, not touching", colors::ORANGE),
    ("touching, not joined", colors::GREEN),
    ("not measured", palette::IDLE_SPHERE_OF_MANY),
];
/// Indices in [`CONTACTS`].
const APART: usize = 0;
/// Joined and touching.
pub const TOGETHER: usize = 1;
/// Joined, but not touching.
pub const JOINED: usize = 2;
/// Touching, but not joined.
pub const TOUCHING: usize = 3;
const UNKNOWN: usize = 4;

/// The index in [`CONTACTS`].
fn contact_of(is_joined: bool, is_touching: bool) -> usize {
    match (is_joined, is_touching) {
        (false, false) => APART,
        (true, true) => TOGETHER,
        (true, false) => JOINED,
        (false, true) => TOUCHING,
    }
}

/// The geometric measures of a pair: their entities, names with units, and colours.
pub const MEASURES: [(&Entity, &str, palette::Rgb); 3] = [
    (&PAIR_GAP, "gap [R]", colors::SKY_BLUE),
    (&PAIR_OVERLAP, "overlap [R³]", colors::SILVER),
    (&PAIR_NECK, "neck [R]", colors::GREEN),
];

/// Scenes with more pairs than this initially hide the lines of measures: the layout cannot name them all.
pub const MOST_NAMED: usize = 120;

impl PairPlots {
    /// Starts without pairs.
    pub fn new(settings: &Settings) -> PairPlots {
        PairPlots {
            max_in_reach: settings.pairs,
            steps: settings.steps,
            only: settings.only.clone(),
            known: BTreeMap::new(),
            kept: BTreeMap::new(),
            marks: Marks::default(),
            in_reach: BTreeSet::new(),
            next_in_reach: BTreeSet::new(),
            new: Vec::new(),
            shown: Vec::new(),
            shortfall: None,
            missed: 0,
        }
    }

    /// The pairs that have plots worth a look, those that change phase at about `opening` [s] among them.
    pub fn told(&self, schema: &Schema, series: &Series, opening: f64) -> Told {
        let of = |is_told: &dyn Fn(&PairPlot) -> bool, first: &[(usize, usize)], most: usize| {
            // where nothing happens, the plots say so
            let is_any = self.known.values().any(is_told);
            let told = self.known.iter().filter(|(_, plot)| is_told(plot) || !is_any);
            let (mut told, others): (Vec<_>, Vec<_>) = told.partition(|(pair, _)| first.contains(pair));
            let count = told.len() + others.len();
            told.extend(spread(others, series, opening, most.saturating_sub(told.len())));
            (told.into_iter().map(|(pair, _)| *pair).collect::<Vec<_>>(), count)
        };
        let (moving, count) = of(&|plot| !plot.changes.is_empty() || !plot.is_still(series), &[], MOST_LINES);
        // lanes of the same pairs, and of others
        let (mut changed, _) = of(&|plot| !plot.changes.is_empty(), &moving, MOST_LANES);
        let others = self.known.iter().filter(|(pair, _)| !changed.contains(pair)).collect();
        let others = spread(others, series, opening, FEW_LANES.saturating_sub(changed.len()));
        changed.extend(others.into_iter().map(|(pair, _)| *pair));
        let (met, _) = of(&|plot| plot.has_met, &moving, MOST_LANES);
        let left_out = count - moving.len();
        let [moving, changed, met] = [moving, changed, met]
            .map(|pairs| pairs.into_iter().map(|(a, b)| schema.pair_name(a, b)).collect::<Vec<_>>());
        Told { left_out, moving, changed, met, all: self.known.len() }
    }

    /// Marks the events of the pairs whose lines are drawn, if not all are.
    pub fn log_events_of_told(&self, schema: &Schema, told: &Told, chunks: &mut Chunks) {
        self.marks.finish(chunks);
        if told.left_out == 0 {
            return;
        }
        let drawn = self.known.iter().filter(|&(&(a, b), _)| told.moving.contains(&schema.pair_name(a, b)));
        let mut events: Vec<&PairEvent> = drawn.flat_map(|(_, plot)| &plot.changes).collect();
        events.sort_by(|x, y| x.time.total_cmp(&y.time));
        marks::log_events(schema, &events, chunks);
    }

    /// Marks the closest approaches of pairs that have plots, and those of the pairs whose lines are drawn, if not all are.
    pub fn log_approaches(&self, schema: &Schema, told: &Told, approaches: &[Approach], chunks: &mut Chunks) {
        let plotted = approaches.iter().filter(|approach| self.known.contains_key(&(approach.a, approach.b)));
        let plotted: Vec<&Approach> = plotted.collect();
        marks::log_near_misses(&MARKS_AT_Q, schema, &plotted, chunks);
        if told.left_out > 0 {
            let is_drawn = |of: &&Approach| told.moving.contains(&schema.pair_name(of.a, of.b));
            let drawn: Vec<&Approach> = plotted.into_iter().filter(is_drawn).collect();
            marks::log_near_misses(&MARKS_OF_DRAWN, schema, &drawn, chunks);
        }
    }

    /// The pairs of the current frame that have their own entities.
    pub fn shown(&self) -> &[[usize; 2]] {
        &self.shown
    }

    /// The axis of plots of q; `None` without a plot.
    pub fn axis(&self, series: &Series, schema: &Schema, told: &Told) -> Option<Axis> {
        /// How far from q, as a ratio to its range.
        const FAR: f64 = 1.5;
        /// A range of q that leaves thresholds room [–].
        const LEAST: f64 = 0.2;
        /// The top, as a ratio to the highest threshold and to the smallest q of any pair: one that flies away would leave
        /// the thresholds no room.
        const HIGHEST: f64 = 1.5;

        let extended = |[low, high]: [f64; 2], by: [f64; 2]| [low.min(by[0]), high.max(by[1])];
        let is_drawn = |&(a, b): &(usize, usize)| told.left_out == 0 || told.moving.contains(&schema.pair_name(a, b));
        let drawn = || self.known.iter().filter(|(pair, _)| is_drawn(pair));
        let of_q = drawn().filter_map(|(_, plot)| series.outline(plot.distance).range);
        let [low, high] = of_q.reduce(extended)?;
        let margin = FAR * (high - low).max(LEAST);
        let is_near = |level: &[f64; 2]| level[1] >= low - margin && level[0] <= high + margin;
        let level = |&(line, _): &(LineId, usize)| series.outline(line).range;
        let near = drawn().flat_map(|(_, plot)| plot.thresholds.iter().filter_map(level)).filter(is_near);
        let near = near.map(|level| level.map(|end| end.max(low - margin).min(high + margin)));
        let mut ends = near.clone().fold([low, high], extended);
        let levels = near.map(|[_, level]| level).reduce(f64::max);
        let least = drawn().filter_map(|(_, plot)| series.outline(plot.distance).range).map(|[low, _]| low);
        if let Some(level) = levels {
            ends[1] = ends[1].min(HIGHEST * least.fold(level, f64::max));
        }
        let missing = (LEAST - (ends[1] - ends[0])).max(0.0);
        ends = [ends[0] - 0.5 * missing, ends[1] + 0.5 * missing];
        let is_beyond = |plot: &PairPlot| plot.thresholds.iter().filter_map(level).any(|level| !is_near(&level));
        let beyond = self.known.iter().filter(|(_, plot)| is_beyond(plot)).map(|(pair, _)| *pair);
        Some(Axis { ends, beyond: beyond.collect() })
    }

    /// The pairs that [`PairPlots::choose`] will choose in each frame of the second list, after those of the first. Pairs
    /// that get their plots because of an event are not foreseen.
    pub fn foresee(&self, schema: &Schema, [first, then]: [&[Frame]; 2]) -> Vec<Vec<[usize; 2]>> {
        let mut known: BTreeSet<(usize, usize)> = self.known.keys().copied().collect();
        let of_frame = |frame: &Frame| {
            if known.len() < self.max_in_reach {
                let is_new = |pair: &&PairFrame| !known.contains(&(pair.a, pair.b)) && self.is_shown(schema, pair);
                let mut new: Vec<&PairFrame> = frame.pairs.iter().filter(is_new).collect();
                new.sort_by(|x, y| x.q.total_cmp(&y.q));
                let free = self.max_in_reach - known.len();
                known.extend(new.into_iter().take(free).map(|pair| (pair.a, pair.b)));
            }
            let is_known = |pair: &&PairFrame| known.contains(&(pair.a, pair.b));
            frame.pairs.iter().filter(is_known).map(|pair| [pair.a, pair.b]).collect()
        };
        let mut all: Vec<_> = first.iter().chain(then).map(of_frame).collect();
        all.split_off(first.len())
    }

    /// Whether a pair may have its own entities.
    fn is_shown(&self, schema: &Schema, pair: &PairFrame) -> bool {
        self.only.is_empty() || self.only.contains(&schema.pair_name(pair.a, pair.b))
    }

    /// Chooses the pairs of a frame that have their own entities, and creates the entities of new pairs.
    pub fn choose(&mut self, view: FrameView<'_>, series: &mut Series, chunks: &mut Chunks) -> &[[usize; 2]] {
        let FrameView { schema, frame: now, at, .. } = view;
        if self.known.len() < self.max_in_reach {
            // of pairs that come within reach in the same frame, take the closest first
            self.new.clear();
            self.new.extend(now.pairs.iter().filter(|pair| !self.known.contains_key(&(pair.a, pair.b))));
            self.new.sort_by(|x, y| x.q.total_cmp(&y.q));
            for pair in std::mem::take(&mut self.new) {
                self.track(schema, pair, at, self.max_in_reach, series, chunks);
            }
        }
        if self.known.len() >= self.max_in_reach && self.max_in_reach > 0 {
            self.keep(view);
        }
        self.shown.clear();
        let is_known = |pair: &&PairFrame| self.known.contains_key(&(pair.a, pair.b));
        self.shown.extend(now.pairs.iter().filter(is_known).map(|pair| [pair.a, pair.b]));
        &self.shown
    }

    /// Keeps q of the pairs without a plot.
    fn keep(&mut self, FrameView { frame, at, .. }: FrameView<'_>) {
        let mut last = std::mem::take(&mut self.kept);
        for pair in frame.pairs.iter().filter(|pair| !self.known.contains_key(&(pair.a, pair.b))).take(KEPT_PAIRS) {
            let mut kept = last.remove(&(pair.a, pair.b)).unwrap_or_default();
            if kept.len() == KEPT_FRAMES {
                kept.pop_front();
            }
            kept.push_back(Kept { at, q: pair.q, phase: pair.phase });
            self.kept.insert((pair.a, pair.b), kept);
        }
    }

    /// Logs the q and the measures of the chosen pairs; `frame` is the number of the frame.
    pub fn log(
        &mut self,
        view: FrameView<'_>,
        measures: &[Option<PairMeasures>],
        frame: u64,
        series: &mut Series,
        chunks: &mut Chunks,
    ) {
        let FrameView { frame: now, at, .. } = view;
        self.next_in_reach.clear();
        let mut measures = measures.iter();
        let of_pair = view.schema.pair_scalars.len();
        for (index, pair) in now.pairs.iter().enumerate() {
            let Some(known) = self.known.get_mut(&(pair.a, pair.b)) else { continue };
            if let Some(Some(PairMeasures { gap, overlap, neck, .. })) = measures.next() {
                let contact = contact_of(view.schema.phases[pair.phase].is_joined, *gap <= 0.0);
                known.has_met |= contact != APART;
                if known.last_contact.replace(contact) != Some(contact) {
                    chunks.log(&known.contact, at, &StateChange::single(CONTACTS[contact].0));
                }
                for (line, value) in known.measures.into_iter().zip([*gap, *overlap, *neck]) {
                    series.log(chunks, line, value, at);
                }
            }
            let scalars = now.pair_scalars.get(index * of_pair..).unwrap_or_default();
            for (&line, &value) in known.scalars.iter().zip(scalars) {
                series.log_or_interrupt(chunks, line, value, at);
            }
            series.log(chunks, known.distance, pair.q, at);
            for &(line, threshold) in &known.thresholds {
                let Some(level) = view.schema.level(threshold, [pair.a, pair.b], at.time) else { continue };
                series.log(chunks, line, level, at);
                // A constant line has no new values, but should keep up with a live plot.
                if frame.is_multiple_of(THRESHOLD_FRAMES) {
                    series.extend(chunks, line);
                }
            }
            self.next_in_reach.insert((pair.a, pair.b));
        }
        for left in self.in_reach.difference(&self.next_in_reach) {
            let Some(known) = self.known.get_mut(left) else { continue };
            // it may have parted and left between two frames
            if known.last_contact.is_some_and(|last| last != APART) {
                known.last_contact = Some(APART);
                chunks.log(&known.contact, at, &StateChange::single(CONTACTS[APART].0));
            }
            let PairPlot { distance, thresholds, measures, scalars, .. } = &*known;
            for line in measures.iter().chain(scalars).chain([distance]) {
                series.interrupt(chunks, *line, at);
            }
            for &(line, _) in thresholds {
                series.interrupt(chunks, line, at);
            }
        }
        std::mem::swap(&mut self.in_reach, &mut self.next_in_reach);
    }

    /// The phase entity of a pair. Creates the pair's entities if needed; `None` if `max` pairs have some already, or
    /// if the pair is not to be shown.
    fn track(
        &mut self,
        schema: &Schema,
        pair: PairFrame,
        at: Instant,
        max: usize,
        series: &mut Series,
        chunks: &mut Chunks,
    ) -> Option<&str> {
        let PairFrame { a, b, phase, .. } = pair;
        if !self.known.contains_key(&(a, b)) {
            if self.known.len() >= max || !self.is_shown(schema, &pair) {
                return None;
            }
            let mut pair = PairPlot::new(schema, a, b, palette::distance(self.known.len()), series, chunks);
            let before = self.kept.remove(&(a, b)).unwrap_or_default();
            let mut last = None;
            for (at, phase) in before.iter().map(|&Kept { at, phase, .. }| (at, phase)).chain([(at, phase)]) {
                if last.replace(phase) != Some(phase) {
                    chunks.log(&pair.phase, at, &StateChange::single(schema.phases[phase].name));
                }
            }
            // the pair was in reach for long before its event
            if let Some(Kept { at, .. }) = before.front() {
                pair.last_contact = Some(UNKNOWN);
                chunks.log(&pair.contact, *at, &StateChange::single(CONTACTS[UNKNOWN].0));
            }
            for Kept { at, q, .. } in before {
                series.log(chunks, pair.distance, q, at);
                for &(line, threshold) in &pair.thresholds {
                    if let Some(level) = schema.level(threshold, [a, b], at.time) {
                        series.log(chunks, line, level, at);
                    }
                }
                self.in_reach.insert((a, b));
            }
            self.known.insert((a, b), pair);
        }
        self.known.get(&(a, b)).map(|pair| pair.phase.as_str())
    }

    /// Logs an event as a change of phase, at its exact time.
    pub fn log_event(&mut self, schema: &Schema, event: &PairEvent, series: &mut Series, chunks: &mut Chunks) {
        let at = Instant { step: event.step, time: event.time };
        let pair = PairFrame::new(event.a, event.b, event.q, event.from);
        // so that later events find places, too
        let share = (event.step as f64 / self.steps.unwrap_or(schema.steps) as f64).clamp(FIRST_EVENTS, 1.0);
        let most = self.max_in_reach + (share * self.max_in_reach as f64).ceil() as usize;
        let entity = self.track(schema, pair, at, most, series, chunks);
        let is_plotted = entity.is_some();
        if let Some(entity) = entity {
            chunks.log(entity, at, &StateChange::single(schema.phases[event.to].name));
        }
        let plot = self.known.get_mut(&(event.a, event.b)).filter(|plot| plot.changes.len() < MOST_CHANGES);
        if let Some(plot) = plot {
            plot.changes.push(*event);
        }
        self.marks.log(schema, event, is_plotted, chunks);
    }

    /// Number of steps whose error exceeds the tolerance, so far.
    pub fn missed(&self) -> u64 {
        self.missed
    }

    /// Logs that the error of a step exceeds the tolerance, unless it does so for long and is less than twice what was
    /// logged last: a line for each step would hide the events.
    pub fn log_shortfall(&mut self, schema: &Schema, of: Option<&Shortfall>, at: Instant, chunks: &mut Chunks) {
        let Some(shortfall) = of else { return self.shortfall = None };
        self.missed += 1;
        if self.shortfall.is_none_or(|before| shortfall.ratio() >= 2.0 * before) {
            let line = TextLog::new(shortfall.describe(schema, at)).with_level("warning").with_color(color(SHORTFALL));
            chunks.log(ACCURACY.path, at, &line);
            self.shortfall = Some(shortfall.ratio());
        }
    }
}

/// A pair that has plots.
type Known<'p> = (&'p (usize, usize), &'p PairPlot);

/// Of many pairs, the one that changes phase nearest to `opening` [s], others that do so at times spread over the run, and the
/// one that comes closest without a change; then others that come close.
fn spread<'p>(mut pairs: Vec<Known<'p>>, series: &Series, opening: f64, most: usize) -> Vec<Known<'p>> {
    if pairs.len() <= most {
        return pairs;
    }
    let closest = |plot: &PairPlot| series.outline(plot.distance).range.map_or(f64::INFINITY, |[low, _]| low);
    let missed = (0..pairs.len()).filter(|&index| pairs[index].1.changes.is_empty() && most > 2);
    let missed = missed.min_by(|&x, &y| closest(pairs[x].1).total_cmp(&closest(pairs[y].1)));
    let missed = missed.map(|index| pairs.remove(index));
    let most = most - usize::from(missed.is_some());
    let changes = || pairs.iter().flat_map(|(_, plot)| plot.changes.iter().map(|event| event.time));
    let [first, last] = [changes().fold(f64::INFINITY, f64::min), changes().fold(0.0, f64::max)];
    let others = most.saturating_sub(1);
    let times = (0..others).map(|k| first + (k as f64 + 0.5) / others as f64 * (last - first));
    let times: Vec<f64> = [opening].into_iter().chain(times).take(most).collect();
    let mut chosen: Vec<Known<'p>> = missed.into_iter().collect();
    for time in times {
        let away =
            |plot: &PairPlot| plot.changes.iter().map(|event| (event.time - time).abs()).fold(f64::INFINITY, f64::min);
        let nearest = (0..pairs.len()).min_by(|&x, &y| {
            let [x, y] = [x, y].map(|index| pairs[index].1);
            away(x).total_cmp(&away(y)).then(closest(x).total_cmp(&closest(y)))
        });
        chosen.extend(nearest.map(|nearest| pairs.remove(nearest)));
    }
    let start = |plot: &PairPlot| plot.changes.first().map_or(f64::INFINITY, |event| event.time);
    chosen.sort_by(|(_, one), (_, other)| start(one).total_cmp(&start(other)));
    chosen
}

/// Whether the layout names every pair of the scene.
pub fn has_named_pairs(schema: &Schema) -> bool {
    let bodies = schema.bodies.len();
    bodies * bodies.saturating_sub(1) / 2 <= MOST_NAMED
}

/// The entities of this family of every pair of the scene, if the layout names them.
pub fn named<'a>(schema: &'a Schema, family: &'a Entity) -> impl Iterator<Item = String> + 'a {
    let bodies = if has_named_pairs(schema) { schema.bodies.len() } else { 0 };
    (0..bodies)
        .flat_map(move |a| (a + 1..bodies).map(move |b| (a, b)))
        .map(move |(a, b)| family.of(&[&schema.pair_name(a, b)]))
}

impl PairPlot {
    fn new(
        schema: &Schema,
        a: usize,
        b: usize,
        rgb: palette::Rgb,
        series: &mut Series,
        chunks: &mut Chunks,
    ) -> PairPlot {
        let name = schema.pair_name(a, b);
        let entity = |family: &Entity| family.of(&[&name]);
        Series::style(chunks, &entity(&PAIR_DISTANCE), &format!("q {name}"), rgb, 2.0, Interpolation::Linear);
        // levels change at these instants, if they do
        let changes = schema.scheduled.iter().filter(|_| schema.own_levels.is_changing()).take(MOST_LEVELS);
        let instants: Vec<f64> = [0.0].into_iter().chain(changes.map(|of| of.time + schema.dt)).collect();
        let thresholds = schema.thresholds.iter().enumerate().filter_map(|(index, threshold)| {
            let entity = PAIR_LEVEL.of(&[&name, threshold.name]);
            let mut levels: Vec<Option<f64>> = instants.iter().map(|time| schema.level(index, [a, b], *time)).collect();
            levels.dedup();
            let known: Vec<String> = levels.iter().flatten().map(f64::to_string).collect();
            if known.is_empty() {
                return None; // the pair does not have it
            }
            let mut label = format!("{} {}", threshold.label, known.join(", then "));
            if levels[0] != Some(threshold.level) {
                label += &format!(" ({name})");
            }
            Series::style(chunks, &entity, &label, threshold.color, 1.0, Interpolation::Step);
            Some((series.line(chunks, &entity, Interpolation::Step), index))
        });
        let thresholds = thresholds.collect();
        let names = || schema.phases.iter().map(|phase| phase.name);
        let lane = StateConfiguration::new()
            .with_values(names())
            .with_labels(names())
            .with_colors(schema.phases.iter().map(|phase| color(phase.color)));
        chunks.log_static(&entity(&PAIR_PHASE), &lane);
        let distance = series.line(chunks, &entity(&PAIR_DISTANCE), Interpolation::Linear);
        let measures = MEASURES.map(|(measure, label, of_measure)| {
            // of several pairs, each has the colour of its q
            let rgb = if schema.bodies.len() > 2 { rgb } else { of_measure };
            Series::style(chunks, &entity(measure), &format!("{label} {name}"), rgb, 2.0, Interpolation::Linear);
            if !has_named_pairs(schema) {
                chunks.log_static(&entity(measure), &SeriesLines::update_fields().with_visible_series([false]));
            }
            series.line(chunks, &entity(measure), Interpolation::Linear)
        });
        let scalars = schema
            .pair_scalars
            .iter()
            .map(|scalar| series.scalar(chunks, &PAIR_SCALAR.of(&[scalar.name, &name]), scalar, &name, rgb));
        let scalars = scalars.collect();
        let lane = StateConfiguration::new()
            .with_values(CONTACTS.map(|(name, _)| name))
            .with_labels(CONTACTS.map(|(name, _)| name))
            .with_colors(CONTACTS.map(|(_, rgb)| color(rgb)));
        chunks.log_static(&entity(&PAIR_CONTACT), &lane);
        let (phase, contact) = (entity(&PAIR_PHASE), entity(&PAIR_CONTACT));
        PairPlot {
            changes: Vec::new(),
            has_met: false,
            phase,
            distance,
            thresholds,
            measures,
            scalars,
            contact,
            last_contact: None,
        }
    }
}

/// Logs an event as a line, at its exact time. In a thin recording, surfaces that touch and part are among the phase
/// changes, in rows without phases: another entity would be a tenth of the file.
pub fn log_row(schema: &Schema, row: &EventRow<'_>, is_thin: bool, chunks: &mut Chunks) {
    match row {
        EventRow::Phase(event, _) => {
            let phases = [event.from, event.to].map(|phase| schema.phases[phase].name);
            let rgb = schema.phases[event.to].color;
            let line =
                line(schema, row, event.name, rgb, [event.a, event.b], &phases, [event.time, event.q, event.rate]);
            let at = Instant { step: event.step, time: event.time };
            match event.energy {
                Some(energy) => {
                    let energy = AnyValues::default().with_component_from_data(ENERGY.0, number(energy));
                    chunks.log(EVENTS.path, at, &Together(&[&line.0, &line.1, &energy]));
                }
                None => chunks.log(EVENTS.path, at, &Together(&[&line.0, &line.1])),
            }
        }
        EventRow::Contact(event) => {
            let rgb = contact_color(event);
            let line = line(schema, row, event.name(), rgb, [event.a, event.b], &[], [event.time, event.q, f64::NAN]);
            let at = Instant { step: event.step, time: event.time };
            let entity = if is_thin { EVENTS.path } else { SURFACE_EVENTS.path };
            chunks.log(entity, at, &Together(&[&line.0, &line.1]));
        }
        EventRow::Body(event) => log_body_event(schema, event, chunks),
    }
}

/// The line of an event of a pair, and its components for the same row: time, q and its rate.
fn line(
    schema: &Schema,
    row: &EventRow<'_>,
    name: &str,
    rgb: palette::Rgb,
    bodies: [usize; 2],
    phases: &[&str],
    [time, q, rate]: [f64; 3],
) -> (TextLog, AnyValues) {
    // the viewer cuts long lines: the remark on its surfaces is one of its own
    let text = row.describe(schema).replacen("; ", ";\n    ", 1);
    let line = TextLog::new(text).with_level(name).with_color(color(rgb));
    let typed = AnyValues::default()
        .with_component::<Text>(BODIES.0, bodies.map(|body| schema.bodies[body].name.as_str()))
        .with_component::<Text>(PHASES.0, phases.iter().copied())
        .with_component_from_data(TIME.0, number(time))
        .with_component_from_data(Q.0, number(q));
    let typed = if rate.is_nan() { typed } else { typed.with_component_from_data(RATE.0, number(rate)) };
    (line, typed)
}

/// A number that is no scalar of a plot: the viewer draws those of a recording without a layout as lines.
fn number(value: f64) -> Arc<dyn Array> {
    Arc::new(Float64Array::from(vec![value]))
}

fn contact_color(event: &SurfaceEvent) -> palette::Rgb {
    if event.what == Finding::Touch { CONTACTS[TOUCHING].1 } else { colors::SILVER }
}

/// Logs the line of a body event.
fn log_body_event(schema: &Schema, event: &BodyEvent, chunks: &mut Chunks) {
    let at = Instant { step: event.step, time: event.time };
    let line = TextLog::new(event.describe(schema)).with_level(event.name).with_color(color(colors::VERMILION));
    chunks.log(BODY_EVENTS.path, at, &line);
}

/// Several component batches in one row.
struct Together<'a>(&'a [&'a dyn AsComponents]);

impl AsComponents for Together<'_> {
    fn as_serialized_batches(&self) -> Vec<SerializedComponentBatch> {
        self.0.iter().flat_map(|components| components.as_serialized_batches()).collect()
    }
}
