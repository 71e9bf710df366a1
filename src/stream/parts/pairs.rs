//! Pairs: the distance of each against its thresholds, its phase, and what happens to it.

use std::collections::{BTreeMap, BTreeSet};

use rerun::{StateChange, StateConfiguration, TextLog};

use super::Look;
use crate::{
    model::phase::{Phase, Thresholds},
    scene::Scene,
    sim::Event,
    stream::{
        chunks::Chunks,
        instant::Instant,
        palette::{self, color},
        series::{LineId, Series, Shape},
    },
};

/// Threshold lines get a point at least every so many frames, so that they keep up with a live plot.
const THRESHOLD_FRAMES: u64 = 64;

/// The pairs that have entities of their own.
pub struct Pairs {
    /// At most so many.
    most: usize,
    known: BTreeMap<(usize, usize), Pair>,
    in_reach: BTreeSet<(usize, usize)>,
    /// Reused.
    next_in_reach: BTreeSet<(usize, usize)>,
    new: Vec<(f64, usize, usize, Phase)>,
}

struct Pair {
    phase: String,
    distance: LineId,
    thresholds: Vec<(LineId, f64)>,
}

impl Pairs {
    /// None yet, and never more than `most`.
    pub fn new(most: usize) -> Pairs {
        Pairs {
            most,
            known: BTreeMap::new(),
            in_reach: BTreeSet::new(),
            next_in_reach: BTreeSet::new(),
            new: Vec::new(),
        }
    }

    /// Logs the distances of those within reach; it is frame number `frame`.
    pub fn log(&mut self, look: Look<'_>, frame: u64, series: &mut Series, chunks: &mut Chunks) {
        let Look { scene, snapshot, at } = look;
        if self.known.len() < self.most {
            // of those that come within reach together the closest first
            let is_new = |&(_, a, b, _): &(f64, usize, usize, Phase)| !self.known.contains_key(&(a, b));
            self.new.clear();
            self.new.extend(snapshot.pairs.iter().map(|pair| (pair.q, pair.a, pair.b, pair.phase)).filter(is_new));
            self.new.sort_by(|x, y| x.0.total_cmp(&y.0));
            for (_, a, b, phase) in std::mem::take(&mut self.new) {
                self.track(scene, a, b, phase, at, series, chunks);
            }
        }
        self.next_in_reach.clear();
        for pair in &snapshot.pairs {
            let Some(known) = self.known.get(&(pair.a, pair.b)) else { continue };
            series.log(chunks, known.distance, pair.q, at);
            for &(line, level) in &known.thresholds {
                series.log(chunks, line, level, at);
                // A level line has nothing new to say, but should keep up with a plot that is looked at live.
                if frame.is_multiple_of(THRESHOLD_FRAMES) {
                    series.extend(chunks, line);
                }
            }
            self.next_in_reach.insert((pair.a, pair.b));
        }
        for left in self.in_reach.difference(&self.next_in_reach) {
            let Pair { distance, thresholds, .. } = &self.known[left];
            series.interrupt(chunks, *distance, at);
            for &(line, _) in thresholds {
                series.interrupt(chunks, line, at);
            }
        }
        std::mem::swap(&mut self.in_reach, &mut self.next_in_reach);
    }

    /// The entity of a pair's phase, its entities made when it first comes within reach; `None` beyond the bound.
    #[allow(clippy::too_many_arguments)] // a pair, when, and where to
    fn track(
        &mut self,
        scene: &Scene,
        a: usize,
        b: usize,
        phase: Phase,
        at: Instant,
        series: &mut Series,
        chunks: &mut Chunks,
    ) -> Option<&str> {
        if !self.known.contains_key(&(a, b)) {
            if self.known.len() >= self.most {
                return None;
            }
            let pair = Pair::new(scene, a, b, palette::distance(self.known.len()), series, chunks);
            chunks.log(&pair.phase, at, &StateChange::single(phase.name()));
            self.known.insert((a, b), pair);
        }
        self.known.get(&(a, b)).map(|pair| pair.phase.as_str())
    }

    /// A log line and a change of lane, at the exact time of the event.
    pub fn log_event(&mut self, scene: &Scene, event: &Event, series: &mut Series, chunks: &mut Chunks) {
        let (a, b) = (event.a as usize, event.b as usize);
        let at = Instant { step: event.step, time: event.time };
        if let Some(entity) = self.track(scene, a, b, event.from, at, series, chunks) {
            chunks.log(entity, at, &StateChange::single(event.to.name()));
        }
        log_event_line(scene, event, chunks);
    }
}

impl Pair {
    fn new(scene: &Scene, a: usize, b: usize, rgb: palette::Rgb, series: &mut Series, chunks: &mut Chunks) -> Pair {
        let name = pair_name(scene, a, b);
        let entity = |part: &str| format!("/pairs/{name}/{part}");
        Series::style(chunks, &entity("distance"), &format!("q {name}"), rgb, 2.0, Shape::Linear);
        let thresholds = thresholds(scene).map(|(part, label, level)| {
            let rgb = palette::threshold(part);
            Series::style(chunks, &entity(part), &format!("{label} {level}"), rgb, 1.0, Shape::Step);
            (series.line(chunks, &entity(part), Shape::Step), level)
        });
        let thresholds = thresholds.collect();
        let phases = [Phase::Apart, Phase::Merged, Phase::Core];
        let lane = StateConfiguration::new()
            .with_values(phases.map(Phase::name))
            .with_labels(phases.map(Phase::name))
            .with_colors(phases.map(|phase| color(palette::phase(phase))));
        chunks.log_static(&entity("phase"), &lane);
        let distance = series.line(chunks, &entity("distance"), Shape::Linear);
        Pair { phase: entity("phase"), distance, thresholds }
    }
}

/// The log line of an event.
pub fn log_event_line(scene: &Scene, event: &Event, chunks: &mut Chunks) {
    let at = Instant { step: event.step, time: event.time };
    let line =
        TextLog::new(describe(scene, event)).with_level(event.name()).with_color(color(palette::phase(event.to)));
    chunks.log("/events", at, &line);
}

/// The thresholds that a scene has: entity, label, level of q.
fn thresholds(scene: &Scene) -> impl Iterator<Item = (&'static str, &'static str, f64)> + use<> {
    let Thresholds { merge_at, split_at, core_at } = scene.thresholds;
    let all = [
        ("merge_at", "merge at", merge_at),
        ("split_at", "split at", split_at), //
        ("core_at", "core at", core_at),
    ];
    all.into_iter().filter(move |&(part, _, _)| part != "core_at" || core_at > 0.0)
}

/// The name of a pair: `A~B`, in the order of the scene.
pub fn pair_name(scene: &Scene, a: usize, b: usize) -> String {
    format!("{}~{}", scene.bodies[a].name, scene.bodies[b].name)
}

/// An event in words: what, which pair, exactly when, at which q, felt by which step.
pub fn describe(scene: &Scene, event: &Event) -> String {
    let pair = pair_name(scene, event.a as usize, event.b as usize);
    format!("{} {pair} at t = {:.9} s, q = {:.6}, step {}", event.name(), event.time, event.q, event.step)
}
