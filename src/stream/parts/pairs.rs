//! Plots of pairs: q and its thresholds, the phase, and events.

use std::collections::{BTreeMap, BTreeSet};

use rerun::{
    AnyValues, AsComponents, SerializedComponentBatch, StateChange, StateConfiguration, TextLog,
    components::{Scalar, Text},
};

use super::Look;
use crate::{
    observe::{PairEvent, PairFrame, Schema},
    stream::{
        chunks::Chunks,
        instant::Instant,
        palette::{self, color},
        series::{Interpolation, LineId, Series},
    },
};

/// Maximum interval between points of threshold lines [frames], so that they keep up with a live plot.
const THRESHOLD_FRAMES: u64 = 64;

/// The pairs that have their own entities.
pub struct PairPlots {
    /// Upper limit on their number.
    most: usize,
    known: BTreeMap<(usize, usize), PairPlot>,
    in_reach: BTreeSet<(usize, usize)>,
    /// Scratch storage, reused.
    next_in_reach: BTreeSet<(usize, usize)>,
    new: Vec<PairFrame>,
    /// The least and the greatest number in any plot.
    plotted: Option<[f64; 2]>,
}

fn extended(range: Option<[f64; 2]>, number: f64) -> [f64; 2] {
    range.map_or([number; 2], |[low, high]| [low.min(number), high.max(number)])
}

struct PairPlot {
    phase: String,
    distance: LineId,
    thresholds: Vec<(LineId, f64)>,
}

impl PairPlots {
    /// Starts without pairs; at most `most` are added.
    pub fn new(most: usize) -> PairPlots {
        PairPlots {
            most,
            known: BTreeMap::new(),
            in_reach: BTreeSet::new(),
            next_in_reach: BTreeSet::new(),
            new: Vec::new(),
            plotted: None,
        }
    }

    /// The least and the greatest number in any plot, q or threshold.
    pub fn plotted(&self) -> Option<[f64; 2]> {
        self.plotted
    }

    /// Logs the q of pairs within reach; `frame` is the number of the frame.
    pub fn log(&mut self, look: Look<'_>, frame: u64, series: &mut Series, chunks: &mut Chunks) {
        let Look { schema, frame: now, at } = look;
        if self.known.len() < self.most {
            // of pairs that come within reach in the same frame, take the closest first
            self.new.clear();
            self.new.extend(now.pairs.iter().filter(|pair| !self.known.contains_key(&(pair.a, pair.b))));
            self.new.sort_by(|x, y| x.q.total_cmp(&y.q));
            for pair in std::mem::take(&mut self.new) {
                self.track(schema, pair, at, series, chunks);
            }
        }
        self.next_in_reach.clear();
        for pair in &now.pairs {
            let Some(known) = self.known.get(&(pair.a, pair.b)) else { continue };
            series.log(chunks, known.distance, pair.q, at);
            self.plotted = Some(extended(self.plotted, pair.q));
            for &(line, level) in &known.thresholds {
                series.log(chunks, line, level, at);
                self.plotted = Some(extended(self.plotted, level));
                // A constant line has no new values, but should keep up with a live plot.
                if frame.is_multiple_of(THRESHOLD_FRAMES) {
                    series.extend(chunks, line);
                }
            }
            self.next_in_reach.insert((pair.a, pair.b));
        }
        for left in self.in_reach.difference(&self.next_in_reach) {
            let PairPlot { distance, thresholds, .. } = &self.known[left];
            series.interrupt(chunks, *distance, at);
            for &(line, _) in thresholds {
                series.interrupt(chunks, line, at);
            }
        }
        std::mem::swap(&mut self.in_reach, &mut self.next_in_reach);
    }

    /// The phase entity of a pair. Creates the pair's entities when it first comes within reach; `None` beyond the
    /// limit.
    fn track(
        &mut self,
        schema: &Schema,
        PairFrame { a, b, phase, .. }: PairFrame,
        at: Instant,
        series: &mut Series,
        chunks: &mut Chunks,
    ) -> Option<&str> {
        if !self.known.contains_key(&(a, b)) {
            if self.known.len() >= self.most {
                return None;
            }
            let pair = PairPlot::new(schema, a, b, palette::distance(self.known.len()), series, chunks);
            chunks.log(&pair.phase, at, &StateChange::single(schema.phases[phase].name));
            self.known.insert((a, b), pair);
        }
        self.known.get(&(a, b)).map(|pair| pair.phase.as_str())
    }

    /// Logs an event as a line and as a change of phase, at its exact time.
    pub fn log_event(&mut self, schema: &Schema, event: &PairEvent, series: &mut Series, chunks: &mut Chunks) {
        let at = Instant { step: event.step, time: event.time };
        let pair = PairFrame { a: event.a, b: event.b, q: event.q, phase: event.from };
        if let Some(entity) = self.track(schema, pair, at, series, chunks) {
            chunks.log(entity, at, &StateChange::single(schema.phases[event.to].name));
        }
        log_event_line(schema, event, chunks);
    }
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
        let entity = |part: &str| format!("/pairs/{name}/{part}");
        Series::style(chunks, &entity("distance"), &format!("q {name}"), rgb, 2.0, Interpolation::Linear);
        let thresholds = schema.thresholds.iter().enumerate().filter_map(|(index, threshold)| {
            let level = schema.level(index, a, b)?;
            let (entity, name) = (entity(threshold.name), format!("{} {level}", threshold.label));
            Series::style(chunks, &entity, &name, threshold.color, 1.0, Interpolation::Step);
            Some((series.line(chunks, &entity, Interpolation::Step), level))
        });
        let thresholds = thresholds.collect();
        let names = || schema.phases.iter().map(|phase| phase.name);
        let lane = StateConfiguration::new()
            .with_values(names())
            .with_labels(names())
            .with_colors(schema.phases.iter().map(|phase| color(phase.color)));
        chunks.log_static(&entity("phase"), &lane);
        let distance = series.line(chunks, &entity("distance"), Interpolation::Linear);
        PairPlot { phase: entity("phase"), distance, thresholds }
    }
}

/// Components of an event, in the same row as its line.
pub mod event {
    /// The two bodies, in the order of the scene.
    pub const BODIES: &str = "bodies";
    /// The phases before and after.
    pub const PHASES: &str = "phases";
    /// Exact time of the event [s].
    pub const TIME: &str = "time";
    /// Centre distance over the sum of the radii [–].
    pub const Q: &str = "q";
    /// How fast q changes at that time [1/s].
    pub const RATE: &str = "rate";
}

/// Logs the line of an event, with its components in the same row.
pub fn log_event_line(schema: &Schema, event: &PairEvent, chunks: &mut Chunks) {
    let at = Instant { step: event.step, time: event.time };
    let color = color(schema.phases[event.to].color);
    let line = TextLog::new(schema.describe(event)).with_level(event.name).with_color(color);
    let [before, after] = [event.from, event.to].map(|phase| schema.phases[phase].name);
    let typed = AnyValues::default()
        .with_component::<Text>(event::BODIES, [event.a, event.b].map(|body| schema.bodies[body].name.as_str()))
        .with_component::<Text>(event::PHASES, [before, after])
        .with_component::<Scalar>(event::TIME, [event.time])
        .with_component::<Scalar>(event::Q, [event.q])
        .with_component::<Scalar>(event::RATE, [event.rate]);
    chunks.log("/events", at, &Together(&[&line, &typed]));
}

/// Several component batches in one row.
struct Together<'a>(&'a [&'a dyn AsComponents]);

impl AsComponents for Together<'_> {
    fn as_serialized_batches(&self) -> Vec<SerializedComponentBatch> {
        self.0.iter().flat_map(|components| components.as_serialized_batches()).collect()
    }
}
