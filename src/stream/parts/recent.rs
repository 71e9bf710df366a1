//! The pairs that had the events of the last step with any: for each a thick line between its centres, labelled with the event.
//! The label stands above all bodies, on a line that leads to the pair. Among many bodies only the pair of the last event,
//! which is drawn once more, alone.

use std::collections::VecDeque;

use glam::DVec3;

use super::{FrameView, MAX_LABELS, callout, pairs::told_q, spheres};
use crate::{
    observe::{BodyFrame, PairEvent, Schema, schema::titled},
    sdk::{self, Ellipsoids3D, LineStrips3D, Mesh3D, Points3D},
    stream::{
        chunks::{Chunks, TrackId},
        contract::{LIT, RECENT, RECENT_NAMES, RECENT_PAIR, RECENT_SPHERES},
        extract::{Extractor, Float3, Surface},
        instant::Instant,
        light::{self, Light},
        palette::{self, Rgb, color},
    },
};

/// Number of frames for which an event is recent, where names and other labels share the view with it.
const FRAMES: u64 = 24;
/// Interval between drawings of the pair alone, once its event is no longer recent [frames].
const SELDOM: u64 = 8;
/// Upper limit on the number of events of a step that are labelled; among many bodies, one is.
const MOST: usize = 4;
/// How far above all bodies the label is [diagonals of the box around them].
const ABOVE: f64 = 0.14;
/// The distance of two labels, in the same unit.
const APART: f64 = 0.08;

/// The height at which the label of an event stands [scene unit].
pub fn label_height(view: FrameView<'_>) -> f64 {
    let [low, high] = view.bounds();
    view.top() + ABOVE * low.distance(high)
}

/// Whether the last event's pair is drawn alone too: among so many bodies it may be hidden.
pub fn is_drawn_alone(schema: &Schema) -> bool {
    schema.bodies.len() > MAX_LABELS
}

/// The pairs of the events of a step.
pub struct Recent {
    track: TrackId,
    /// The last events of the last step with any, one per pair.
    events: VecDeque<RecentEvent>,
    /// Frames since they happened.
    age: u64,
    /// Height of the lowest label, above the bodies of the last frame, and the distance of two [scene unit].
    top: f64,
    apart: f64,
    alone: Option<Alone>,
}

struct RecentEvent {
    pair: [usize; 2],
    label: String,
    /// The end of the label: q at the event, or now.
    q: String,
    color: Rgb,
    step: u64,
    centres: [DVec3; 2],
}

/// Lines, their colours, and labels with their positions and colours.
#[derive(Default)]
struct Rows {
    strips: Vec<[Float3; 2]>,
    line_colors: Vec<u32>,
    places: Vec<Float3>,
    colors: Vec<u32>,
    labels: Vec<String>,
}

/// The surfaces of the pair.
struct Alone {
    track: TrackId,
    extractor: Extractor,
    surface: Surface,
    pair: Option<[usize; 2]>,
    triangles: Vec<[u32; 3]>,
}

impl Recent {
    /// Logs static data.
    pub fn new(schema: &Schema, chunks: &mut Chunks) -> Recent {
        // those between the centres, and those up to the labels
        let radii = [3.0, 1.0].repeat(MOST).into_iter().map(sdk::Radius::new_ui_points);
        let lines = LineStrips3D::update_fields().with_radii(radii).with_show_labels(false);
        chunks.log_static(RECENT.path, &lines);
        let label = Points3D::update_fields().with_radii([sdk::Radius::new_ui_points(0.0)]).with_show_labels(true);
        chunks.log_static(RECENT.path, &label);
        let components = [
            LineStrips3D::descriptor_strips(),
            LineStrips3D::descriptor_colors(),
            Points3D::descriptor_positions(),
            Points3D::descriptor_colors(),
            Points3D::descriptor_labels(),
        ];
        Recent {
            track: chunks.track(RECENT.path, components),
            events: VecDeque::new(),
            age: 0,
            top: f64::NEG_INFINITY,
            apart: 0.0,
            alone: is_drawn_alone(schema).then(|| {
                let clear = Mesh3D::update_fields().with_albedo_factor(palette::translucent([0xFF; 3]));
                chunks.log_static(RECENT_PAIR.path, &clear);
                chunks.log_static(RECENT_PAIR.path, &light::unlit());
                let names =
                    Points3D::update_fields().with_radii([sdk::Radius::new_ui_points(0.0)]).with_show_labels(true);
                chunks.log_static(RECENT_NAMES.path, &names);
                chunks.log_static(RECENT_SPHERES.path, &spheres::wireframe());
                Alone {
                    track: chunks.track(RECENT_PAIR.path, [Mesh3D::descriptor_vertex_positions(), LIT.descriptor()]),
                    extractor: Extractor::default(),
                    surface: Surface::default(),
                    pair: None,
                    triangles: Vec::new(),
                }
            }),
        }
    }

    /// The pairs, while their events are recent.
    pub fn pairs(&self) -> impl ExactSizeIterator<Item = [usize; 2]> {
        self.events.iter().map(|event| event.pair)
    }

    /// Logs the last events of a step at their exact times: those of which `pairs` has the bodies after the step.
    pub fn events(&mut self, schema: &Schema, events: &[PairEvent], pairs: &[[BodyFrame; 2]], chunks: &mut Chunks) {
        let most = if self.alone.is_some() { 1 } else { MOST };
        let first = events.len() - pairs.len();
        for (number, (event, bodies)) in (first..).zip(events[first..].iter().zip(pairs)) {
            let mut label = titled(event.name, &schema.pair_name(event.a, event.b));
            if events.len() > most {
                label += &format!(", {} of {} changes in step {}", number + 1, events.len(), event.step);
            }
            let (pair, color) = ([event.a, event.b], schema.phases[event.to].color);
            self.events.retain(|before| before.step == event.step && before.pair != pair);
            if self.events.len() == most {
                self.events.pop_front();
            }
            let (q, centres) = (format!(", q = {:.3}", event.q), bodies.each_ref().map(|body| body.centre));
            self.events.push_back(RecentEvent { pair, label, q, color, step: event.step, centres });
            self.age = 0;
            let at = Instant { step: event.step, time: event.time };
            self.draw(schema, bodies.each_ref(), at, chunks);
        }
    }

    /// Drops events that are no longer recent.
    pub fn forget_old(&mut self) {
        if self.age >= FRAMES && self.alone.is_none() {
            self.events.clear();
        }
    }

    /// Logs changed values.
    pub fn log(&mut self, view: FrameView<'_>, chunks: &mut Chunks) {
        let FrameView { schema, frame, at, .. } = view;
        self.top = label_height(view);
        let [low, high] = view.bounds();
        self.apart = APART * low.distance(high);
        self.age += 1;
        for event in &mut self.events {
            event.centres = event.pair.map(|body| frame.bodies[body].centre);
            let radii = event.pair.map(|body| schema.bodies[body].radius);
            let q = event.centres[0].distance(event.centres[1]) / (radii[0] + radii[1]);
            event.q = format!("; now q = {}", told_q(schema, event.pair, q, at.time));
        }
        if let Some(alone) = self.alone.as_ref().filter(|alone| alone.pair.is_none() && self.age == 1) {
            alone.log_none(at, chunks);
        }
        match self.events.back().map(|last| last.pair) {
            Some(pair) => self.draw(schema, pair.map(|body| &frame.bodies[body]), at, chunks),
            None => self.push(&Rows::default(), at, chunks),
        }
    }

    /// Draws the events; `bodies` are those of the last one.
    fn draw(&mut self, schema: &Schema, bodies: [&BodyFrame; 2], at: Instant, chunks: &mut Chunks) {
        let mut rows = Rows::default();
        for (number, RecentEvent { label, q, color: rgb, centres, .. }) in self.events.iter().enumerate() {
            let middle = 0.5 * (centres[0] + centres[1]);
            let height = f64::max(self.top + number as f64 * self.apart, middle.dot(schema.up));
            let place = schema.raised(middle, height);
            rows.strips.extend([centres.map(|centre| centre.as_vec3().to_array()), callout::leader(middle, place)]);
            rows.line_colors.extend([color(*rgb).to_u32(); 2]);
            rows.places.push(place.as_vec3().to_array());
            rows.colors.push(color(*rgb).to_u32());
            rows.labels.push(format!("{label}{q}"));
        }
        if let (Some(alone), Some(RecentEvent { pair, color, centres, .. })) = (&mut self.alone, self.events.back())
            && (self.age < FRAMES || self.age.is_multiple_of(SELDOM))
        {
            let radius = pair.map(|body| schema.bodies[body].radius).into_iter().fold(0.0, f64::max);
            alone.log(schema, (*pair, *color), bodies, (0.5 * (centres[0] + centres[1]), radius), at, chunks);
        }
        self.push(&rows, at, chunks);
    }

    fn push(&self, rows: &Rows, at: Instant, chunks: &mut Chunks) {
        let Rows { strips, line_colors, places, colors, labels } = rows;
        chunks.push_changed(self.track, at, &[strips, line_colors, places, colors, labels]);
    }
}

impl Alone {
    /// Says that there was no event so far.
    fn log_none(&self, at: Instant, chunks: &mut Chunks) {
        let text = Points3D::update_fields().with_positions([[0.0; 3]]).with_labels(["no event yet"]);
        chunks.log(RECENT_NAMES.path, at, &text.with_colors([color(palette::SEAM)]));
    }

    /// Logs the surfaces, and the spheres in this colour, about `middle`, in units of `radius`.
    fn log(
        &mut self,
        schema: &Schema,
        (pair, rgb): ([usize; 2], Rgb),
        bodies: [&BodyFrame; 2],
        (middle, radius): (DVec3, f64),
        at: Instant,
        chunks: &mut Chunks,
    ) {
        self.surface.clear();
        let (mut triangles, mut lit) = (Vec::new(), Vec::new());
        let light = Light::in_world(schema);
        for (index, now) in pair.into_iter().zip(bodies) {
            let body = &schema.bodies[index];
            let first = self.surface.positions.len();
            self.surface.append_in_world(body, now, &mut self.extractor);
            triangles.extend(now.mesh_of(body).drawn_triangles().iter().map(|t| t.map(|v| v + first as u32)));
            let normals = &self.surface.normals[first..];
            let own = palette::of_body(schema, index);
            lit.extend(normals.iter().map(|&normal| light.on(own, normal)));
        }
        let place =
            |&[x, y, z]: &Float3| ((DVec3::new(x.into(), y.into(), z.into()) - middle) / radius).as_vec3().to_array();
        let positions: Vec<Float3> = self.surface.positions.iter().map(place).collect();
        // the names stand on the far sides of the two from each other
        let apart = (bodies[1].centre - bodies[0].centre).normalize_or(DVec3::X);
        let places = [0, 1].map(|which| {
            let own = schema.bodies[pair[which]].radius;
            let aside = if which == 0 { -apart } else { apart };
            ((bodies[which].centre + own * aside - middle) / radius).as_vec3().to_array()
        });
        let names = Points3D::update_fields()
            .with_positions(places)
            .with_colors(pair.map(|body| color(palette::label(palette::of_body(schema, body)))))
            .with_labels(pair.map(|body| schema.bodies[body].name.as_str()));
        chunks.log(RECENT_NAMES.path, at, &names);
        let half_size = |body: usize| [(schema.reach(body, at.time) / radius) as f32; 3];
        let spheres = Ellipsoids3D::update_fields()
            .with_centers(bodies.map(|now| ((now.centre - middle) / radius).as_vec3().to_array()))
            .with_half_sizes(pair.map(half_size))
            .with_colors([color(rgb)]);
        chunks.log(RECENT_SPHERES.path, at, &spheres);
        let is_new = self.pair != Some(pair) || triangles != self.triangles;
        if is_new {
            self.pair = Some(pair);
            self.triangles.clone_from(&triangles);
            chunks.log(RECENT_PAIR.path, at, &Mesh3D::update_fields().with_triangle_indices(triangles));
        }
        if is_new || chunks.has_changed(self.track, &[&positions]) {
            chunks.push(self.track, at, &[&positions, &lit]);
        }
    }
}
