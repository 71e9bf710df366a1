//! The instant at which a recording opens: its first event or the one requested, or else the closest approach of two
//! bodies.

use glam::{BVec3, DVec3};

use super::{
    parts::{FrameView, recent},
    series::halve,
    settings::{Around, Settings},
};
use crate::geometry::bounds;
use crate::observe::{PairEvent, Schema};

/// Upper limit on the events between two frames whose pairs are kept in view.
const MOST_PAIRS: usize = 64;
/// How long the viewer plays on after the instant, at most [s].
const AFTER: f64 = 1.0;
/// How much wider the box around the whole run may be than that around the instant, for all of the run to be in view.
pub const WIDER: f64 = 1.6;

/// An instant of a run, and the spheres to look at.
#[derive(Clone, Debug)]
pub struct Focus {
    /// Time of the instant [s].
    pub time: f64,
    /// Spheres (centre and radius) to keep in view.
    pub spheres: Vec<(DVec3, f64)>,
    /// The two bodies of the pair.
    pub pair: [(DVec3, f64); 2],
    /// All other bodies, which may hide the pair.
    pub others: Vec<(DVec3, f64)>,
}

impl Focus {
    /// The interval around the instant in a run of `duration` [s] that is played in a loop [s].
    pub fn interval(&self, duration: f64) -> [f64; 2] {
        let [before, after] = [(0.5, 0.125), (AFTER, 0.25)].map(|(max, share)| f64::min(max, share * duration));
        [f64::max(0.0, self.time - before), f64::min(duration, self.time + after)]
    }

    fn on(view: FrameView<'_>, time: f64, pair: [usize; 2]) -> Focus {
        let FrameView { schema, frame, .. } = view;
        let bodies = || frame.bodies.iter().zip(&schema.bodies).enumerate();
        let mut spheres = extent(view);
        if !recent::is_drawn_alone(schema) && schema.variants.is_empty() {
            spheres.extend(pair.map(|index| (frame.bodies[index].centre, schema.bodies[index].reach)));
        }
        if schema.variants.is_empty() {
            let middle = 0.5 * (frame.bodies[pair[0]].centre + frame.bodies[pair[1]].centre);
            spheres.push((view.schema.raised(middle, recent::label_height(view)), 0.0));
        }
        let points = schema.points.iter().filter_map(|point| point.sphere.at(view.at.time));
        let reached = |&(centre, reach): &(DVec3, f64)| {
            bodies().any(|(_, (now, body))| now.centre.distance(centre) < reach + body.radius)
        };
        spheres.extend(points.filter(reached));
        let others = bodies().filter(|(index, _)| !pair.contains(index));
        Focus {
            time,
            spheres,
            pair: pair.map(|index| (frame.bodies[index].centre, schema.bodies[index].radius)),
            others: others.map(|(_, (now, body))| (now.centre, body.radius)).collect(),
        }
    }
}

/// What a camera must have in view to show all bodies: their spheres, of many those that are furthest out; of several
/// variants, also their names.
fn extent(view: FrameView<'_>) -> Vec<(DVec3, f64)> {
    let present = view.bodies().filter(|(_, now)| !now.is_absent);
    let headings = view.schema.variants.iter().map(|variant| (variant.heading, 0.0));
    let spheres = present.map(|(body, now)| (now.centre, body.radius)).chain(headings);
    let spheres: Vec<(DVec3, f64)> = spheres.filter(|(centre, _)| centre.is_finite()).collect();
    if !recent::is_drawn_alone(view.schema) {
        return spheres;
    }
    furthest(&spheres)
}

/// The spheres (centre and radius) that reach furthest towards the corners, edges and faces of a box.
pub fn furthest(spheres: &[(DVec3, f64)]) -> Vec<(DVec3, f64)> {
    let directions = (0..27).map(|number| [1, 3, 9].map(|place| f64::from(number / place % 3 - 1)));
    let furthest = |direction: [f64; 3]| {
        let direction = DVec3::from_array(direction).normalize_or_zero();
        let reach = |(centre, radius): &(DVec3, f64)| centre.dot(direction) + radius;
        spheres.iter().copied().max_by(|one, other| reach(one).total_cmp(&reach(other)))
    };
    directions.filter_map(furthest).collect()
}

/// The diagonal of the box around spheres (centre and radius).
pub fn width(spheres: &[(DVec3, f64)]) -> f64 {
    let [low, high] = bounds(spheres.iter().copied());
    low.distance(high)
}

/// One of the eight combinations of coordinates.
fn mask(number: u8) -> BVec3 {
    BVec3::new(number & 1 != 0, number & 2 != 0, number & 4 != 0)
}

/// Finds the focus of a run while it proceeds.
#[derive(Debug, Default)]
pub struct FocusFinder {
    /// The requested event, and the number of matching events so far.
    around: Option<(Around, u64)>,
    /// The only pairs considered, as `A~B`; empty: all.
    only: Vec<String>,
    /// Time and pair of the event in focus.
    event: Option<(f64, [usize; 2])>,
    /// The smallest q so far, if there was no event yet.
    nearest: Option<f64>,
    focus: Option<Focus>,
    /// The time from which on the focus is extended by what follows [s].
    next: f64,
    /// The extents of the bodies in evenly spaced frames of the run so far.
    run: Vec<Vec<(DVec3, f64)>>,
    /// The pairs of events since the last frame, and the box around those of all events, where they were then.
    pairs: Vec<[usize; 2]>,
    events: Option<[DVec3; 2]>,
    /// Whether there are so many bodies that the labels of events stand far from their pairs.
    is_crowd: bool,
    /// Number of frames so far, and from one of these extents to the next, as a power of two.
    frames: u64,
    spacing: u32,
}

impl FocusFinder {
    /// Looks for the first event of the shown pairs, or for the one that the settings request.
    pub fn new(settings: &Settings) -> FocusFinder {
        let around = settings.around.clone().map(|around| (around, 0));
        FocusFinder { around, only: settings.only.clone(), ..FocusFinder::default() }
    }

    /// Adds an event, before the first frame that it affects.
    pub fn event(&mut self, schema: &Schema, event: &PairEvent) {
        let is_requested = self.around.as_mut().is_some_and(|(around, seen)| {
            let is_kind = around.is_kind_of(event, schema);
            *seen += u64::from(is_kind);
            is_kind && *seen == around.number
        });
        let is_shown = self.only.is_empty() || self.only.contains(&schema.pair_name(event.a, event.b));
        if is_shown && self.pairs.len() < MOST_PAIRS {
            self.pairs.push([event.a, event.b]);
        }
        if is_requested || (self.event.is_none() && is_shown) {
            self.event = Some((event.time, [event.a, event.b]));
            self.focus = None;
        }
    }

    /// The run failed at `time` [s], at this body: the instant to look at, unless another one is requested.
    pub fn fail(&mut self, time: f64, body: (DVec3, f64)) {
        if self.around.is_none() {
            let focus = self.focus.get_or_insert_with(|| Focus {
                time,
                spheres: Vec::new(),
                pair: [body; 2],
                others: Vec::new(),
            });
            focus.spheres.push(body);
            (focus.time, focus.pair) = (time, [body; 2]);
            focus.others.clear();
        }
    }

    /// The time of the event in focus, if there is one [s].
    pub fn event_time(&self) -> Option<f64> {
        self.event.map(|(time, _)| time)
    }

    /// Adds a frame.
    pub fn frame(&mut self, view: FrameView<'_>) {
        /// Upper limit on the number of extents that are kept of a run.
        const MOST_EXTENTS: usize = 64;
        /// Number of extents while the instant is shown.
        const EXTENTS_AFTER: f64 = 8.0;

        let FrameView { schema, frame, at, .. } = view;
        // of several variants, the whole run would be too small
        if self.frames.is_multiple_of(1_u64 << self.spacing) && schema.variants.is_empty() {
            self.run.push(extent(view));
        }
        self.is_crowd = recent::is_drawn_alone(schema);
        let bodies = self.pairs.drain(..).flatten();
        let bodies = bodies.map(|body| (frame.bodies[body].centre, schema.bodies[body].radius));
        let bodies: Vec<(DVec3, f64)> = bodies.filter(|(centre, _)| centre.is_finite()).collect();
        if let Some(&(centre, _)) = bodies.first().filter(|_| schema.variants.is_empty()) {
            let known = self.events.into_iter().flatten().map(|corner| (corner, 0.0));
            let label = (view.schema.raised(centre, recent::label_height(view)), 0.0);
            self.events = Some(bounds(known.chain(bodies).chain([label])));
        }
        self.frames += 1;
        if self.run.len() > MOST_EXTENTS {
            halve(&mut self.run);
            self.spacing += 1;
        }
        match self.event {
            Some((time, _)) if let Some(focus) = &mut self.focus => {
                if at.time <= time + AFTER && at.time >= self.next {
                    focus.spheres.extend(extent(view));
                    self.next = at.time + AFTER / EXTENTS_AFTER;
                }
            }
            Some((time, pair)) => self.focus = Some(Focus::on(view, time, pair)),
            None => {
                let is_shown = |a: usize, b: usize| self.only.is_empty() || self.only.contains(&schema.pair_name(a, b));
                let shown = frame.pairs.iter().filter(|pair| is_shown(pair.a, pair.b));
                let Some(pair) = shown.min_by(|x, y| x.q.total_cmp(&y.q)) else { return };
                if self.nearest.is_none_or(|nearest| pair.q < nearest) {
                    self.nearest = Some(pair.q);
                    self.focus = Some(Focus::on(view, at.time, [pair.a, pair.b]));
                }
            }
        }
    }

    /// The focus of the run so far, if any bodies came within reach. The whole run is kept in view unless bodies would be
    /// much smaller then; or else the pairs of all events, unless they would be.
    pub fn focus(&self) -> Option<Focus> {
        /// [`WIDER`] with the pairs of all events.
        const WIDER_FOR_EVENTS: f64 = 2.0;

        let mut focus = self.focus.clone()?;
        let at_instant = width(&focus.spheres);
        let whole = self.run.concat();
        let corners = |[low, high]: [DVec3; 2]| (0..8).map(move |number| (DVec3::select(mask(number), low, high), 0.0));
        let events: Vec<(DVec3, f64)> =
            self.events.into_iter().flat_map(corners).chain(focus.spheres.iter().copied()).collect();
        if width(&whole) <= WIDER * at_instant {
            focus.spheres.extend(whole);
            if self.is_crowd && width(&events) <= WIDER * at_instant {
                focus.spheres.extend(events); // and the labels of all events
            }
        } else if width(&events) <= WIDER_FOR_EVENTS * at_instant {
            focus.spheres = events;
        }
        Some(focus)
    }

    /// The bodies in frames throughout the run so far.
    pub fn run(&self) -> impl Iterator<Item = (DVec3, f64)> + '_ {
        self.run.iter().flatten().copied()
    }

    /// The requested event, if it has not happened so far, and the number of matching events.
    pub fn missed(&self) -> Option<(&Around, u64)> {
        self.around.as_ref().filter(|(around, seen)| *seen < around.number).map(|(around, seen)| (around, *seen))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Scene, World,
        observe::{Frame, Simulation, Want},
        stream::instant::Instant,
        view,
    };

    /// What falls along an axis falls downwards in views: labels stand above the bodies, and the usual camera does, too.
    #[test]
    fn views_are_upright_whatever_the_direction_of_gravity() {
        for (gravity, up) in [
            ([0.0, 0.0, 0.0], DVec3::Z),
            ([0.1, 0.0, -9.8], DVec3::Z),
            ([0.0, -9.8, 0.0], DVec3::Y),
            ([0.0, 0.0, 2.0], DVec3::NEG_Z),
            ([3.0, 1.0, -1.0], DVec3::NEG_X),
        ] {
            let body = |name: &str, x: f64| {
                format!("[[body]]\nname = '{name}'\nradius = 1.0\nmotion = {{ free = {{ from = [{x}, {x}, {x}] }} }}\n")
            };
            let scene = format!("duration = 1.0\ngravity = {gravity:?}\n{}{}", body("a", 0.0), body("b", 1.2));
            let scene = Scene::parse(&scene, "falling.toml").unwrap();
            let schema = view::schema(&scene);
            assert_eq!(schema.up, up, "gravity {gravity:?}");
            assert!((schema.upright() * up).distance(DVec3::Z) < 1e-15);
            let (world, mut frame) = (World::new(scene).unwrap(), Frame::default());
            world.observe(Want::default(), &mut frame);
            let view = FrameView::of(&schema, &frame, Instant { step: 0, time: 0.0 });
            let highest = frame.bodies.iter().map(|body| body.centre.dot(up) + 1.0).fold(f64::NEG_INFINITY, f64::max);
            assert!(recent::label_height(view) > highest);
            assert!(view.back.dot(up) > 0.0);
        }
    }

    /// Two bodies move on side by side, with an event at the start and a later one: the camera has that in view, too, unless
    /// it is far away.
    #[test]
    fn pairs_of_later_events_stay_in_view() {
        let body = |name: &str, y: f64| {
            format!(
                "[[body]]\nname = '{name}'\nradius = 1.0\nmotion = {{ line = {{ from = [0, {y}, 0], velocity = [3, 0, 0] }} }}\n"
            )
        };
        let scene =
            Scene::parse(&format!("duration = 8.0\ndt = 0.25\n{}{}", body("a", 0.0), body("b", 2.2)), "moving.toml");
        let scene = scene.unwrap();
        let schema = view::schema(&scene);
        for (late, right) in [(12, 10.0), (28, 22.0)] {
            let (mut world, mut finder) = (World::new(scene.clone()).unwrap(), FocusFinder::default());
            for step in 1..=scene.steps() {
                let _ = world.step();
                let at = Instant { step, time: world.time() };
                if step == 1 || step == late {
                    finder.event(&schema, &PairEvent::new("merge", at, [0, 1], 1.1, [0, 1]));
                }
                let mut frame = Frame::default();
                world.observe(Want::default(), &mut frame);
                finder.frame(FrameView::of(&schema, &frame, at));
            }
            let [_, high] = bounds(finder.focus().unwrap().spheres.into_iter());
            assert_eq!(high.x >= right, late == 12, "an event at step {late}: up to {}", high.x);
            assert!(high.x < 12.0, "the whole run would be too small: up to {}", high.x);
        }
    }
}
