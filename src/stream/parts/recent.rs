//! The pair that had the last event: a thick line between its centres, labelled with the event. The label stands above all
//! bodies, on a line that leads to the pair. Among many bodies, the pair is drawn once more, alone.

use glam::DVec3;

use super::{FrameView, MAX_LABELS, callout, spheres};
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
/// How far above all bodies the label is [diagonals of the box around them].
const ABOVE: f64 = 0.14;

/// The height at which the label of an event stands [scene unit].
pub fn label_height(view: FrameView<'_>) -> f64 {
    let [low, high] = view.bounds();
    high.z + ABOVE * low.distance(high)
}

/// Whether the last event's pair is drawn alone too: among so many bodies it may be hidden.
pub fn is_drawn_alone(schema: &Schema) -> bool {
    schema.bodies.len() > MAX_LABELS
}

/// The pair of the last event.
pub struct Recent {
    track: TrackId,
    event: Option<RecentEvent>,
    /// Height of the label, above the bodies of the last frame [scene unit].
    top: f64,
    alone: Option<Alone>,
}

struct RecentEvent {
    pair: [usize; 2],
    label: String,
    color: Rgb,
    /// Frames since it happened.
    age: u64,
}

/// Lines, their colours, and the label with its position.
#[derive(Default)]
struct Rows {
    strips: Vec<[Float3; 2]>,
    colors: Vec<u32>,
    places: Vec<Float3>,
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
        // that between the centres, and that up to the label
        let radii = [3.0, 1.0].map(sdk::Radius::new_ui_points);
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
            event: None,
            top: f64::NEG_INFINITY,
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

    /// The pair, while its event is recent.
    pub fn pair(&self) -> Option<(usize, usize)> {
        self.event.as_ref().map(|RecentEvent { pair: [a, b], .. }| (*a, *b))
    }

    /// Logs the events of a step at their exact times, each with the bodies of its pair after the step.
    pub fn events(&mut self, schema: &Schema, events: &[PairEvent], pairs: &[[BodyFrame; 2]], chunks: &mut Chunks) {
        for (number, (event, bodies)) in events.iter().zip(pairs).enumerate() {
            let mut label = titled(event.name, &schema.pair_name(event.a, event.b));
            if events.len() > 1 && self.alone.is_some() {
                label += &format!(", {} of {} in step {}", number + 1, events.len(), event.step);
            }
            let (pair, color) = ([event.a, event.b], schema.phases[event.to].color);
            self.event = Some(RecentEvent { pair, label, color, age: 0 });
            let at = Instant { step: event.step, time: event.time };
            let q = format!(", q = {:.3}", event.q);
            self.draw(schema, bodies.each_ref(), &q, at, chunks);
        }
    }

    /// Drops an event that is no longer recent.
    pub fn age(&mut self) {
        let is_kept = self.alone.is_some();
        self.event.take_if(|event| event.age >= FRAMES && !is_kept);
    }

    /// Logs changed values.
    pub fn log(&mut self, view: FrameView<'_>, chunks: &mut Chunks) {
        self.top = label_height(view);
        let Some(event) = &mut self.event else { return self.push(&Rows::default(), view.at, chunks) };
        event.age += 1;
        let bodies = event.pair.map(|body| &view.frame.bodies[body]);
        let radii = event.pair.map(|body| view.schema.bodies[body].radius);
        let q = bodies[0].centre.distance(bodies[1].centre) / (radii[0] + radii[1]);
        self.draw(view.schema, bodies, &format!("; now q = {q:.3}"), view.at, chunks);
    }

    fn draw(&mut self, schema: &Schema, bodies: [&BodyFrame; 2], q: &str, at: Instant, chunks: &mut Chunks) {
        let Some(RecentEvent { pair, label, color: rgb, age }) = &self.event else { return };
        let centres = bodies.map(|body| body.centre);
        let middle = 0.5 * (centres[0] + centres[1]);
        let place = middle.with_z(f64::max(self.top, middle.z));
        let rows = Rows {
            strips: vec![centres.map(|centre| centre.as_vec3().to_array()), callout::leader(middle, place)],
            colors: vec![color(*rgb).to_u32()],
            places: vec![place.as_vec3().to_array()],
            labels: vec![format!("{label}{q}")],
        };
        if let Some(alone) = &mut self.alone
            && (*age < FRAMES || age.is_multiple_of(SELDOM))
        {
            let radius = pair.map(|body| schema.bodies[body].radius).into_iter().fold(0.0, f64::max);
            alone.log(schema, (*pair, *rgb), bodies, (middle, radius), at, chunks);
        }
        self.push(&rows, at, chunks);
    }

    fn push(&self, rows: &Rows, at: Instant, chunks: &mut Chunks) {
        chunks.push_changed(self.track, at, &[&rows.strips, &rows.colors, &rows.places, &rows.colors, &rows.labels]);
    }
}

impl Alone {
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
        for (index, now) in pair.into_iter().zip(bodies) {
            let body = &schema.bodies[index];
            let first = self.surface.positions.len();
            self.surface.append_in_world(body, now, &mut self.extractor);
            triangles.extend(now.mesh_of(body).drawn_triangles().iter().map(|t| t.map(|v| v + first as u32)));
            let normals = &self.surface.normals[first..];
            let own = palette::of_body(schema, index);
            lit.extend(normals.iter().map(|&normal| Light::in_world().on(own, normal)));
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
            .with_colors(pair.map(|body| color(palette::of_body(schema, body))))
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
