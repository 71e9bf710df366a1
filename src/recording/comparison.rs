//! A recording that visualises the difference between two runs: the surfaces of the first, coloured by the difference, arrows
//! to the vertices of the second, and plots of their distance.

use std::{path::Path, sync::Arc};

use glam::DVec3;

use super::{
    events::{self, Change},
    existing::{self, Existing},
    quantities::Deviation,
};
use crate::{
    analysis::worst::Worst,
    colors::SILVER,
    geometry::Mesh,
    geometry::bounds,
    observe::Schema,
    sdk::{
        self, ApplicationId, Arrows3D, LogMsg, Mesh3D, Points3D, Scalars, StoreId, StoreKind, TextDocument, TextLog,
        ViewCoordinates,
        components::{MarkerShape, MediaType},
    },
    stream::{
        blueprint,
        chunks::Chunks,
        contract::{
            ABOUT, COMPARED_DISTANCE, COMPARED_ERROR, COMPARED_EVENTS, COMPARED_LEVEL, COMPARED_SURFACE,
            COMPARED_WORST, DIFFERENCE, EVENTS, LOG_DIFFERENCE, NAMES, RECORDING_INFO, WORLD,
        },
        extract::Extractor,
        instant::Instant,
        light::Light,
        palette::{self, Rgb, color},
        parts::{body_forces, callout::Callout, labels::MAX_NAMED, marks, planes},
        series::{Interpolation, Series},
        settings::file_stem,
        sinks::{Destinations, Saved, SinkError, Sinks},
    },
    text::{counted, short, significant},
};

/// Upper limit on the number of bodies shown.
const MAX_BODIES: usize = 64;
const COLORS: [Rgb; 2] = [[90, 150, 235], [240, 150, 50]];
/// Colour of a surface where the runs agree.
const SAME: Rgb = [170, 174, 182];
/// A smaller difference has neither an arrow nor a dot [largest difference of the instant].
const LEAST: f64 = 0.1;
const ERROR: Rgb = [235, 60, 60];
const LIMIT: Rgb = [150, 150, 150];
/// Name of the line of the tolerance.
const TOLERANCE: &str = "tolerance";
/// Least length of the longest arrow of an instant [radii of the largest body].
const LONGEST: f64 = 0.3;
/// How far above the centre of a body its name stands, and the label of the worst vertex at least [radii].
const NAME_HEIGHT: f32 = 1.3;
const LABEL_HEIGHT: f32 = 1.8;

/// Upper limit on the number of pairs whose distances are plotted.
pub const MAX_PAIRS: usize = 4;
/// If more events differ, this many are named that differ most.
const FEW: usize = 5;
/// The two runs, in the names of entities.
const SIDES: [&str; 2] = ["a", "b"];
/// Upper limit on the changes of scenes at which thresholds are compared.
const MAX_CHANGES: usize = 256;

/// What a comparison shows, known before it is written.
#[derive(Clone, Debug)]
pub struct Plan<'a> {
    /// Differences between the events.
    pub changes: &'a [Change],
    /// The first and the last time that both runs reach [s].
    pub common: [f64; 2],
    /// Display names of the two runs.
    pub labels: [String; 2],
    /// Bodies to show, in descending order of difference.
    pub bodies: Vec<usize>,
    /// The pairs whose events differ, at most [`MAX_PAIRS`].
    pub pairs: Vec<[usize; 2]>,
    /// The schema of the second run.
    pub second: &'a Schema,
    /// Vertices to be listed with the events, and what they are. The viewer opens at the instant of the first.
    pub listed: Vec<(Worst, &'static str)>,
    /// Differences up to this size are ignored [radii].
    pub tolerance: f64,
}

/// The line of a threshold of a pair in one of the runs.
struct Level {
    entity: String,
    /// 0 or 1: the first or the second run.
    run: usize,
    threshold: usize,
    pair: [usize; 2],
}

/// Writes a comparison while the two runs are stepped through.
pub struct Comparison {
    chunks: Chunks,
    sinks: Sinks,
    shown: Vec<(usize, String, Arc<Mesh>)>,
    pairs: Vec<(String, [usize; 2])>,
    /// The thresholds of these pairs that differ between the runs: entities, and the level of each run over time.
    levels: Vec<Level>,
    /// The schema of the second run.
    second: Schema,
    /// The vertex that differs most.
    worst: Callout,
    /// Radius of the largest body shown [scene unit].
    radius: f64,
    frames: u64,
}

impl Comparison {
    /// Starts a comparison; the camera keeps `spheres` (centre and radius) in view.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn new(
        schema: &Schema,
        spheres: &[(DVec3, f64)],
        plan: &Plan<'_>,
        path: &Path,
    ) -> Result<Comparison, SinkError> {
        existing::replace(path, &Existing::comparison())?;
        let destinations = Destinations::file(path);
        let mut sinks = Sinks::open(&destinations)?;
        let application = ApplicationId::new_or_unknown(Existing::comparison().application);
        let store = StoreId::new(StoreKind::Recording, application, format!("{}-difference", file_stem(&schema.name)));
        let bodies = plan.bodies.iter().take(MAX_BODIES);
        let shown: Vec<_> = bodies
            .filter_map(|&index| {
                let body = schema.bodies.get(index)?;
                Some((index, body.name.clone(), Arc::clone(&body.mesh)))
            })
            .collect();
        let radius =
            shown.iter().filter_map(|&(i, ..)| schema.bodies.get(i)).map(|body| body.radius).fold(0.0, f64::max);
        let second: Vec<_> = shown.iter().map(|(_, name, _)| COMPARED_SURFACE.of(&[SIDES[1], name])).collect();
        let first = plan.listed.first().map(|(first, _)| first.time);
        let pairs: Vec<_> = plan.pairs.iter().map(|&[a, b]| (schema.pair_name(a, b), [a, b])).collect();
        let names: Vec<String> = pairs.iter().map(|(name, _)| name.clone()).collect();
        // the label of the worst vertex is in view, too
        let [low, high] = bounds(spheres.iter().copied());
        let tops = spheres.iter().map(|(centre, _)| centre.dot(schema.up));
        let top = tops.fold(f64::NEG_INFINITY, f64::max) + f64::from(LABEL_HEIGHT) * radius;
        let label = (schema.raised(0.5 * (low + high), top), 0.2 * radius);
        let framed: Vec<_> = spheres.iter().copied().chain([label]).filter(|(at, _)| at.is_finite()).collect();
        for message in blueprint::of_comparison(schema, &framed, &second, (SIDES, &names), first, &store) {
            sinks.send(message)?;
        }
        let mut chunks = Chunks::new(store);
        chunks.log_static(WORLD.path, &ViewCoordinates::RIGHT_HAND_Z_UP());
        planes::log(schema, spheres, Instant::default(), &mut chunks);
        let name = format!("{}: {} and {}", schema.name, plan.labels[0], plan.labels[1]);
        chunks.log_static(RECORDING_INFO.path, &sdk::RecordingInfo::new().with_name(name));
        let about = format!(
            "**{}**: {} and {}\n\n{}\
             - **Surface**: the first run; grey up to a hundredth of the largest difference now (of the tolerance, if that is \
             larger), blue at that, on a logarithmic scale. {}\n\
             - **Orange dots**: vertices of the second run that differ by more than {LEAST} of that difference; red arrows point there, \
             all of an instant longer by one factor, so that the longest has at least {LONGEST} radii\n\
             - **Plot**: the largest distance of each body, from a thousandth of the tolerance on; grey: the tolerance, {:e}\n\
             {}",
            schema.name,
            plan.labels[0],
            plan.labels[1],
            differ_most(plan.changes),
            match plan.bodies.len() {
                0 => "No body differs.".to_owned(),
                n if n > MAX_BODIES => format!("The {MAX_BODIES} bodies that differ most are shown, of {n}."),
                _ => "Bodies that never differ are not shown.".to_owned(),
            },
            plan.tolerance,
            if pairs.is_empty() {
                ""
            } else {
                "- **q** of the first pairs whose events differ: the first run thick and blue, the second thin and orange; \
                 diamonds are events that differ, level lines thresholds that do\n"
            },
        );
        chunks.log_static(ABOUT.path, &TextDocument::new(about).with_media_type(MediaType::MARKDOWN));
        for (_, name, mesh) in &shown {
            for side in SIDES {
                let mesh = Mesh3D::update_fields()
                    .with_triangle_indices(mesh.drawn_triangles().iter().copied())
                    .with_albedo_factor(palette::translucent([0xFF; 3]));
                chunks.log_static(&COMPARED_SURFACE.of(&[side, name]), &mesh);
            }
        }
        let names = Points3D::update_fields()
            .with_radii([sdk::Radius::new_ui_points(0.5)])
            .with_colors([color(LIMIT)])
            .with_labels(shown.iter().map(|(_, name, _)| name.as_str()))
            .with_show_labels(shown.len() <= MAX_NAMED);
        chunks.log_static(NAMES.path, &names);
        let style = Arrows3D::update_fields().with_colors([color(ERROR)]).with_radii([sdk::Radius::new_ui_points(1.2)]);
        chunks.log_static(COMPARED_ERROR.path, &style);
        let dots =
            Points3D::update_fields().with_colors([color(COLORS[1])]).with_radii([sdk::Radius::new_ui_points(2.0)]);
        chunks.log_static(COMPARED_ERROR.path, &dots);
        for (number, (body, name, _)) in shown.iter().enumerate() {
            // those of the bodies in plots of a run, where they have some; blue and orange are the two runs
            let rgb = palette::distance(if schema.bodies.len() <= body_forces::MOST_BODIES { *body } else { number });
            for line in [&DIFFERENCE, &LOG_DIFFERENCE] {
                Series::style(&mut chunks, &line.of(&[name]), name, rgb, 1.5, Interpolation::Linear);
            }
        }
        for line in [&DIFFERENCE, &LOG_DIFFERENCE] {
            Series::style(&mut chunks, &line.of(&[TOLERANCE]), TOLERANCE, LIMIT, 1.0, Interpolation::Linear);
        }
        // where the lines coincide, both are visible: the second is drawn last
        for ((side, rgb), (run, width)) in SIDES.into_iter().zip(COLORS).zip([("first", 6.0), ("second", 2.0)]) {
            for (pair, _) in &pairs {
                let entity = COMPARED_DISTANCE.of(&[side, pair]);
                Series::style(&mut chunks, &entity, &format!("q {pair}, {run} run"), rgb, width, Interpolation::Linear);
                let marks = marks::style(&format!("events of the {run} run"), rgb, MarkerShape::Diamond, 5.0);
                chunks.log_static(&COMPARED_EVENTS.of(&[side, pair]), &marks);
            }
        }
        let mut levels = Vec::new();
        for (name, pair) in &pairs {
            for (index, threshold) in schema.thresholds.iter().enumerate() {
                let both = |time: f64| [schema, plan.second].map(|of| of.level(index, *pair, time));
                // levels change where the scene changes something
                let changes = [schema, plan.second].into_iter().flat_map(|of| &of.scheduled).take(MAX_CHANGES);
                let differs = |time: f64| both(time)[0] != both(time)[1];
                if plan.second.bodies.len() != schema.bodies.len()
                    || !(differs(0.0) || changes.map(|of| of.time + schema.dt).any(differs))
                {
                    continue;
                }
                for (run, level) in both(0.0).into_iter().enumerate() {
                    let entity = COMPARED_LEVEL.of(&[SIDES[run], name, threshold.name]);
                    let level = level.map_or(String::new(), |level| format!(" {level}"));
                    let label = format!("{}{level}", threshold.label);
                    Series::style(&mut chunks, &entity, &label, COLORS[run], 1.0, Interpolation::Linear);
                    levels.push(Level { entity, run, threshold: index, pair: *pair });
                }
            }
        }
        // in another colour than the arrows: the line to the label is no difference
        let worst = Callout::new(COMPARED_WORST.path, SILVER, &mut chunks);
        for (Worst { step, time, body, vertex, difference, .. }, what) in &plan.listed {
            let line = format!("{what}: {body}:{vertex}, {} R", short(*difference));
            let at = Instant { step: *step, time: *time };
            chunks.log(EVENTS.path, at, &TextLog::new(line).with_color(color(ERROR)));
        }
        let second = plan.second.clone();
        let mut comparison = Comparison { chunks, sinks, shown, pairs, levels, second, worst, radius, frames: 0 };
        plan.changes.iter().for_each(|change| comparison.change(change, plan.common));
        comparison.send()?;
        Ok(comparison)
    }

    /// Adds an instant: the centres of the bodies in both runs, and the vertex positions of each [scene unit], `None` where
    /// they are unknown.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn frame(
        &mut self,
        schema: &Schema,
        at: Instant,
        tolerance: f64,
        centres: [&[glam::Vec3]; 2],
        mut positions: impl FnMut(usize) -> [Option<Vec<DVec3>>; 2],
    ) -> Result<(), SinkError> {
        let light = Light::in_world(schema);
        let mut extractor = Extractor::default();
        let mut worst: Option<(f64, DVec3, &str, usize)> = None;
        let all: Vec<[Option<Vec<DVec3>>; 2]> = self.shown.iter().map(|(index, ..)| positions(*index)).collect();
        let mut differences: Vec<Vec<f64>> = Vec::new();
        for ((index, name, _), both) in self.shown.iter().zip(&all) {
            let mut of_body = Vec::new();
            if let [Some(a), Some(b)] = both {
                let (mut largest, radius) = (0.0, schema.bodies.get(*index).map_or(1.0, |body| body.radius));
                for (vertex, (&a, &b)) in a.iter().zip(b).enumerate() {
                    let difference = a.distance(b) / radius;
                    of_body.push(difference);
                    largest = f64::max(largest, difference);
                    if difference > 0.0 && worst.as_ref().is_none_or(|(worst, ..)| difference > *worst) {
                        worst = Some((difference, a, name, vertex));
                    }
                }
                log_difference(&mut self.chunks, name, largest, tolerance, at);
            }
            differences.push(of_body);
        }
        // what is within the tolerance counts as equal
        let finite = differences.iter().flatten().copied().filter(|of| of.is_finite());
        let most = finite.fold(tolerance.max(f64::MIN_POSITIVE), f64::max);
        let (mut origins, mut apart, mut dots) = (Vec::new(), Vec::new(), Vec::new());
        for (((_, name, mesh), both), differences) in self.shown.iter().zip(&all).zip(&differences) {
            if let [Some(a), Some(b)] = both {
                for ((a, b), _) in
                    a.iter().zip(b).zip(differences).filter(|(_, of)| of.is_finite() && **of > LEAST * most)
                {
                    origins.push(a.as_vec3());
                    apart.push(*b - *a);
                    dots.push(b.as_vec3());
                }
            }
            for (side, positions) in SIDES.into_iter().zip(both) {
                let Some(positions) = positions else { continue };
                let (count, facets) = (positions.len(), mesh.facets());
                let mut points: Vec<_> = positions.iter().map(|position| position.as_vec3()).collect();
                facets.into_iter().for_each(|facets| facets.extend(&mut points, 0));
                let mut surface = Mesh3D::update_fields().with_vertex_positions(points);
                if side == SIDES[0] {
                    let share =
                        |of: &f64| if of.is_finite() { (1.0 + 0.5 * (of / most).log10()).max(0.0) } else { 1.0 };
                    let mut shares: Vec<f64> = differences.iter().map(share).collect();
                    shares.resize(count, 1.0); // the other run is unknown
                    facets.into_iter().for_each(|facets| facets.extend(&mut shares, 0));
                    let normals = extractor.normals(mesh, &positions.iter().copied().collect());
                    let colors = normals.iter().zip(shares);
                    surface = surface.with_vertex_colors(
                        colors.map(|(&normal, share)| light.on(palette::between([SAME, COLORS[0]], share), normal)),
                    );
                }
                self.chunks.log(&COMPARED_SURFACE.of(&[side, name]), at, &surface);
            }
        }
        for (pair, [a, b]) in &self.pairs {
            for (side, centres) in SIDES.into_iter().zip(centres) {
                let (Some(from), Some(to)) = (centres.get(*a), centres.get(*b)) else { continue };
                let q = f64::from(from.distance(*to)) / (schema.bodies[*a].radius + schema.bodies[*b].radius);
                self.chunks.log(&COMPARED_DISTANCE.of(&[side, pair]), at, &Scalars::single(q));
            }
        }
        for Level { entity, run, threshold, pair } in &self.levels {
            if let Some(level) = [schema, &self.second][*run].level(*threshold, *pair, at.time) {
                self.chunks.log(entity, at, &Scalars::single(level));
            }
        }
        let above = |index: usize, radii: f32| {
            let (now, radius) =
                (centres[0].get(index).copied(), schema.bodies.get(index).map_or(1.0, |body| body.radius));
            now.unwrap_or_default() + radii * radius as f32 * schema.up.as_vec3()
        };
        let names = self.shown.iter().map(|&(index, ..)| above(index, NAME_HEIGHT));
        self.chunks.log(NAMES.path, at, &Points3D::update_fields().with_positions(names));
        let longest = apart.iter().map(|apart| apart.length()).fold(0.0, f64::max);
        // arrows that are shorter than the difference would end beside the dots
        let times = if longest > 0.0 { f64::max(LONGEST * self.radius / longest, 1.0) } else { 1.0 };
        let vectors = apart.iter().map(|apart| (times * *apart).as_vec3());
        let arrows = Arrows3D::update_fields().with_origins(origins).with_vectors(vectors);
        self.chunks.log(COMPARED_ERROR.path, at, &arrows);
        self.chunks.log(COMPARED_ERROR.path, at, &Points3D::update_fields().with_positions(dots));
        let worst = worst.map(|(difference, position, name, vertex)| {
            let mut label = format!("{name}:{vertex}: {} R", short(difference));
            if times > 1.0 {
                label += &format!("\narrows {} times as long", significant(times));
            }
            // above all bodies: beside the vertex the label would hide what differs
            let heights = self.shown.iter().map(|&(index, ..)| above(index, LABEL_HEIGHT).as_dvec3().dot(schema.up));
            let height = heights.fold(f64::NEG_INFINITY, f64::max);
            ([position, schema.raised(position, height)], label)
        });
        self.worst.log(worst, None, at, &mut self.chunks);
        log_difference(&mut self.chunks, TOLERANCE, tolerance, tolerance, at);
        self.frames += 1;
        if self.frames.is_multiple_of(64) { self.send() } else { Ok(()) }
    }

    /// Logs a difference between the events of the two runs.
    fn change(&mut self, change: &Change, common: [f64; 2]) {
        let first = match change {
            Change::Moved(was, is) if is.time < was.time => is,
            _ => change.event(),
        };
        let at = Instant { step: first.step, time: first.time };
        let rgb = match change {
            Change::Vanished(_) => COLORS[0],
            Change::Appeared(_) => COLORS[1],
            Change::Moved(..) | Change::Reordered(_) => LIMIT,
        };
        let line = match change {
            // what differs first: long lines are cut
            Change::Moved(was, is) => {
                format!("{}: {} at t = {:.9} s,\n    now at {:.9} s", change.how(), was.what(), was.time, is.time)
            }
            _ => change.remark(common).map_or_else(|| change.to_string(), |remark| format!("{change};\n    {remark}")),
        };
        self.chunks.log(EVENTS.path, at, &TextLog::new(line).with_color(color(rgb)));
        let runs = match change {
            Change::Moved(was, is) => [Some(was), Some(is)],
            Change::Vanished(event) => [Some(event), None],
            Change::Appeared(event) => [None, Some(event)],
            Change::Reordered(_) => [None, None],
        };
        for (side, event) in SIDES.into_iter().zip(runs) {
            let Some(event) = event else { continue };
            let Some((pair, _)) = self.pairs.iter().find(|(pair, _)| *pair == event.pair) else { continue };
            let at = Instant { step: event.step, time: event.time };
            self.chunks.log(&COMPARED_EVENTS.of(&[side, pair]), at, &Scalars::single(event.q));
        }
    }

    /// Logs a difference between quantities of the surfaces, where it begins.
    pub fn deviation(&mut self, deviation: &Deviation) {
        let at = Instant { step: deviation.step, time: deviation.time };
        self.chunks.log(EVENTS.path, at, &TextLog::new(deviation.line("")));
    }

    /// Logs that the events are equal, and `beyond` what time.
    pub fn same_events(&mut self, events: usize, beyond: &str) {
        let line = match events {
            0 => format!("the same: neither run has events{beyond}"),
            n => format!("the same: {} in both runs{beyond}", counted(n as u64, "event")),
        };
        self.chunks.log(EVENTS.path, Instant::default(), &TextLog::new(line));
    }

    fn send(&mut self) -> Result<(), SinkError> {
        let messages: Vec<LogMsg> = self.chunks.take();
        messages.into_iter().try_for_each(|message| self.sinks.send(message))
    }

    /// Completes the recording.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn finish(mut self) -> Result<Option<Saved>, SinkError> {
        self.send()?;
        Ok(self.sinks.finish()?.save)
    }
}

/// A paragraph that names the events that differ most, if there are many: their list is in order of time.
fn differ_most(changes: &[Change]) -> String {
    if changes.len() <= FEW {
        return String::new();
    }
    let most = events::listed(changes, FEW).into_iter().map(|change| {
        let event = change.event();
        format!("{} at {:.3} s: {}", event.what(), event.time, change.how())
    });
    let most: Vec<String> = most.collect();
    format!("**{} events differ**, most of all: {}.\n\n", changes.len(), most.join("; "))
}

fn log_difference(chunks: &mut Chunks, name: &str, difference: f64, tolerance: f64, at: Instant) {
    /// Of the tolerance: a smaller difference is a gap in the line, as is none.
    const LEAST: f64 = 1e-3;

    chunks.log(&DIFFERENCE.of(&[name]), at, &Scalars::single(difference));
    let logarithm = (difference > LEAST * tolerance).then(|| difference.log10());
    chunks.log(&LOG_DIFFERENCE.of(&[name]), at, &Scalars::new(logarithm));
}
