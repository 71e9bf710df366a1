//! Labels of bodies in space: seen from the usual direction of the camera, each stands on its own body, and none covers
//! another.

use std::{collections::BTreeMap, f64::consts::TAU};

use glam::{DVec2, DVec3};

use super::{FrameView, MAX_LABELS};
use crate::{
    observe::Schema,
    sdk::{self, Points3D},
    stream::{
        chunks::{Chunks, TrackId},
        contract::NAMES,
        extract::Float3,
        palette::{self, color},
    },
};

/// Upper limit on the number of bodies with names.
pub const MAX_NAMED: usize = 32;

/// Number of places around a body where its label may stand; one more is in the middle of its front.
const SIDES: u8 = 8;
/// How far a place is from the middle of the front, and towards the eye [radii].
const ASIDE: f64 = 0.8;
const TOWARDS: f64 = 0.6;
/// A place may be this far behind another body [its radii].
const NEW_DEPTH: f64 = 0.02;
/// A label that was there in the last frame may come this near to others [sizes], and this far behind other bodies [their radii],
/// so that labels do not come and go in every frame.
const KEPT_SIZE: f64 = 0.8;
const KEPT_DEPTH: f64 = 0.15;
/// With more bodies than this, labels may stand in front of others: the search would take longer than all else.
const MAX_HIDING: usize = 64;
/// Radius of the ball that stands for a body of another shape where it hides others [radii].
const OF_MESH: f64 = 0.7;
/// Number of vertices from which the surface at a place is found.
const SAMPLES: usize = 512;

/// A ball that may hide places.
struct Hiding {
    body: usize,
    centre: DVec3,
    radius: f64,
    /// Centre and radius in the view.
    disc: (DVec2, f64),
}

/// The labels of a frame so far.
pub struct Labels<'a> {
    view: FrameView<'a>,
    /// To the right, upwards, and towards the eye.
    axes: [DVec3; 3],
    /// From the eye to the middle of all bodies [scene unit].
    distance: f64,
    /// The bodies that may hide places.
    hiding: Vec<Hiding>,
    /// Middles and half sizes [scene unit, at the distance of the middle of all bodies].
    taken: Vec<(DVec2, DVec2)>,
}

impl<'a> Labels<'a> {
    /// The size of a label in a small view: its height, and the widths of its margins and of a character [its distance].
    const HEIGHT: f64 = 0.07;
    const MARGINS: f64 = 0.03;
    const CHARACTER: f64 = 0.019;

    /// Without labels.
    pub fn new(view: FrameView<'a>) -> Labels<'a> {
        let right = view.schema.up.cross(view.back).normalize();
        let [low, high] = view.bounds();
        let distance = (view.eye - 0.5 * (low + high)).dot(view.back);
        let axes = [right, view.back.cross(right), view.back];
        let mut labels = Labels { view, axes, distance, hiding: Vec::new(), taken: Vec::new() };
        if view.frame.bodies.len() <= MAX_HIDING {
            let present = view.bodies().enumerate().filter(|(_, (_, now))| !now.is_absent);
            let hiding = present.map(|(body, (of, now))| {
                let radius = of.radius * if now.mesh_of(of).is_round() { 1.0 } else { OF_MESH };
                let (at, scale) = labels.in_view(now.centre);
                Hiding { body, centre: now.centre, radius, disc: (at, scale * radius) }
            });
            labels.hiding = hiding.collect();
        }
        labels
    }

    /// Takes this place for a label if there is room.
    pub fn take(&mut self, place: DVec3, label: &str) -> bool {
        self.take_if(place, label, 1.0, |_| true)
    }

    /// Takes this place unless the label, of a size times `size`, would cover another one, or the place is not suitable.
    fn take_if(&mut self, place: DVec3, label: &str, size: f64, is_suitable: impl FnOnce(&Self) -> bool) -> bool {
        let ((first, _), half) = (self.in_view(place), self.half_size(label));
        let middle = first - DVec2::new(0.0, half.y - self.half_size("").y); // other lines are below the first
        let is_clear = self.taken.iter().all(|&(other, other_half)| {
            let (apart, sum) = ((other - middle).abs(), size * (half + other_half));
            apart.x > sum.x || apart.y > sum.y
        });
        let is_taken = is_clear && is_suitable(self);
        if is_taken {
            self.taken.push((middle, half));
        }
        is_taken
    }

    /// Takes a place for the label of a body, on the visible part of its surface, if there is one with room: that of the last
    /// frame, `side`, unless it is on more other bodies there than elsewhere; or else one where it is on as few as possible,
    /// away from neighbours. Returns it and its side.
    fn take_on(&mut self, body: usize, label: &str, side: Option<u8>) -> Option<(DVec3, u8)> {
        let (away, half_width) = (self.away(body), self.half_size(label).x);
        let at = |labels: &Self, side: u8| {
            let place = labels.place(body, side);
            (side, place, labels.count_under(body, place, half_width))
        };
        if let Some((side, place, count)) = side.map(|side| at(self, side)) {
            let is_best = count == 0 || (0..=SIDES).all(|other| at(self, other).2 >= count);
            if is_best && self.take_if(place, label, KEPT_SIZE, |labels| labels.is_seen(body, place, KEPT_DEPTH)) {
                return Some((place, side));
            }
        }
        let mut sides: Vec<(u8, DVec3, usize)> = (0..=SIDES).map(|side| at(self, side)).collect();
        let along = |side: u8| if side == SIDES { f64::NEG_INFINITY } else { self.towards(side).dot(away) };
        sides.sort_by(|one, other| one.2.cmp(&other.2).then(along(other.0).total_cmp(&along(one.0))));
        sides.into_iter().find_map(|(side, place, _)| {
            let is_seen = |labels: &Labels<'_>| labels.is_seen(body, place, NEW_DEPTH);
            self.take_if(place, label, 1.0, is_seen).then_some((place, side))
        })
    }

    /// Where a place is in the view, and how much larger things are there than at the middle of all bodies.
    fn in_view(&self, place: DVec3) -> (DVec2, f64) {
        let [right, up, back] = self.axes;
        let from = place - self.view.eye;
        let scale = self.distance / f64::max(-from.dot(back), 0.1 * self.distance);
        (scale * DVec2::new(from.dot(right), from.dot(up)), scale)
    }

    /// Half of the size of a label in the view.
    fn half_size(&self, label: &str) -> DVec2 {
        let widest = label.lines().map(|line| line.chars().count()).max().unwrap_or(0);
        let width = Labels::MARGINS + Labels::CHARACTER * widest as f64;
        0.5 * self.distance * DVec2::new(width, Labels::HEIGHT * label.lines().count().max(1) as f64)
    }

    /// The height at which a label above a place is seen above all bodies that would be under it, unless it would be out of view
    /// there [scene unit].
    pub fn height_above(&self, place: DVec3, label: &str) -> f64 {
        /// The top of the view [distance].
        const TOP: f64 = 0.48;

        let ([_, upwards, back], up) = (self.axes, self.view.schema.up);
        let ((at, _), half) = (self.in_view(place), self.half_size(label));
        let under = self.hiding.iter().filter(|of| (of.disc.0.x - at.x).abs() < of.disc.1 + half.x);
        let top = under.map(|of| of.disc.0.y + of.disc.1).fold(f64::NEG_INFINITY, f64::max);
        let tangent = ((top + 2.0 * half.y) / self.distance).min(TOP);
        let from = place - self.view.eye;
        let by = (-tangent * from.dot(back) - from.dot(upwards)) / (up.dot(upwards) + tangent * up.dot(back));
        place.dot(up) + by.max(0.0)
    }

    /// Number of other bodies that the middle or an end of a label at this place is on.
    fn count_under(&self, body: usize, place: DVec3, half_width: f64) -> usize {
        let (middle, _) = self.in_view(place);
        let points = [-1.0, 0.0, 1.0].map(|side| middle + DVec2::new(side * half_width, 0.0));
        let is_under =
            |of: &&Hiding| points.iter().any(|point| point.distance_squared(of.disc.0) < of.disc.1 * of.disc.1);
        self.hiding.iter().filter(|of| of.body != body).filter(is_under).count()
    }

    /// The direction of a side in the plane of the view; 0 for the middle.
    fn towards(&self, side: u8) -> DVec3 {
        let [right, up, _] = self.axes;
        let (sin, cos) = libm::sincos(TAU * f64::from(side) / f64::from(SIDES));
        if side == SIDES { DVec3::ZERO } else { cos * up + sin * right }
    }

    /// A point on the front of a body's surface, on this side; of a ball while it is undeformed.
    fn place(&self, body: usize, side: u8) -> DVec3 {
        let [.., back] = self.axes;
        let direction = (ASIDE * self.towards(side) + TOWARDS * back).normalize();
        let (schema, now) = (&self.view.schema.bodies[body], &self.view.frame.bodies[body]);
        if now.mesh_of(schema).is_round() {
            return now.centre + schema.radius * direction;
        }
        let rest = now.rest_of(schema);
        let vertices = (0..rest.len()).step_by(1 + rest.len() / SAMPLES).map(|vertex| match now.is_at_rest {
            true => now.rotation * rest.position(vertex),
            false => now.positions.get(vertex),
        });
        let furthest = vertices.max_by(|one, other| one.dot(direction).total_cmp(&other.dot(direction)));
        now.centre + furthest.unwrap_or_default()
    }

    /// Whether a place on a body's surface, with this outward normal, faces the eye, and is not behind another body, as far as
    /// their spheres tell: bodies may be dented by that [radii].
    pub fn may_be_in_front(&self, body: usize, place: DVec3, out: DVec3) -> bool {
        const DENT: f64 = 0.15;

        out.dot(self.view.eye - place) > 0.0 && self.is_seen(body, place, DENT) && !self.is_at_rim(body, place)
    }

    /// The other bodies through whose spheres, or close past them, a place is seen.
    pub fn before(&self, body: usize, place: DVec3) -> impl Iterator<Item = usize> {
        /// How far surfaces reach [radii].
        const BULGE: f64 = 1.5;

        let distance = self.view.eye.distance(place);
        let ray = (place - self.view.eye) / distance;
        let is_before = move |of: &&Hiding| {
            let to = of.centre - self.view.eye;
            let (along, reach) = (to.dot(ray), BULGE * self.view.schema.bodies[of.body].radius);
            of.body != body && along - reach < distance && (to - along * ray).length_squared() < reach * reach
        };
        self.hiding.iter().filter(is_before).map(|of| of.body)
    }

    /// Whether a place is behind the rim of another body, or so close to it that the viewer's camera, which is not quite where
    /// the eye is, may not see it.
    fn is_at_rim(&self, body: usize, place: DVec3) -> bool {
        /// How far the rim may be off, and how far in front the middle of the body is at least [its radii].
        const MARGIN: f64 = 0.05;
        const IN_FRONT: f64 = 0.5;

        let distance = self.view.eye.distance(place);
        let ray = (place - self.view.eye) / distance;
        self.hiding.iter().filter(|of| of.body != body).any(|of| {
            let along = (of.centre - self.view.eye).dot(ray);
            let aside = (of.centre - self.view.eye).cross(ray).length();
            along > 0.0 && along < distance - IN_FRONT * of.radius && aside < (1.0 + MARGIN) * of.radius
        })
    }

    /// A place behind the eye, twice as far away: what is moved towards it stays about where it is seen from the eye, and from
    /// a camera that keeps a wider run in view.
    pub fn far(&self) -> DVec3 {
        self.view.eye + self.distance * self.view.back
    }

    /// The share of the way to [`Labels::far`] on which a line that rises from a place has no body in front of it.
    pub fn clearance(&self, place: DVec3) -> f64 {
        const MOST: f64 = 0.2;

        let (up, far) = (self.view.schema.up, self.far());
        let to_eye = (far - place).normalize_or_zero();
        let beside = to_eye.cross(up).normalize_or_zero();
        let depth = self.hiding.iter().map(|of| {
            let to = of.centre - place;
            let is_beside = to.dot(beside).abs() > of.radius || to.dot(up) < -of.radius;
            if is_beside { 0.0 } else { to.dot(to_eye) + of.radius }
        });
        (depth.fold(0.0, f64::max) / far.distance(place)).min(MOST)
    }

    /// Whether no other body is in front of a place, or only by `depth` [its radii].
    fn is_seen(&self, body: usize, place: DVec3, depth: f64) -> bool {
        let distance = self.view.eye.distance(place);
        let ray = (place - self.view.eye) / distance;
        !self.hiding.iter().filter(|of| of.body != body).any(|of| {
            let to = of.centre - self.view.eye;
            let along = to.dot(ray);
            let half = of.radius * of.radius - (to - along * ray).length_squared();
            half > 0.0 && along > 0.0 && along - half.sqrt() < distance - depth * of.radius
        })
    }

    /// Away from the neighbours of a body, and upwards.
    fn away(&self, body: usize) -> DVec3 {
        let frame = self.view.frame;
        let centre = frame.bodies[body].centre;
        let met = frame.pairs.iter().filter_map(|pair| match (pair.a == body, pair.b == body) {
            (true, _) => Some(pair.b),
            (_, true) => Some(pair.a),
            _ => None,
        });
        let away: DVec3 = met.map(|other| (centre - frame.bodies[other].centre).normalize_or_zero()).sum();
        // for bodies at the same position, every other name is on the left
        let [right, up, _] = self.axes;
        away + 0.4 * up + if body.is_multiple_of(2) { -0.05 } else { 0.05 } * right
    }
}

/// Points of which only the labels are seen.
fn style() -> Points3D {
    Points3D::update_fields().with_radii([sdk::Radius::new_ui_points(0.5)]).with_show_labels(true)
}

/// Labels of bodies from frame to frame: on which side each stood, of those that had one.
#[derive(Default)]
struct Sides {
    before: BTreeMap<usize, u8>,
    now: BTreeMap<usize, u8>,
}

impl Sides {
    fn begin_frame(&mut self) {
        self.before = std::mem::take(&mut self.now);
    }

    /// Takes a place for the label of a body, if there is one.
    fn take(&mut self, body: usize, label: &str, labels: &mut Labels<'_>) -> Option<DVec3> {
        let (place, side) = labels.take_on(body, label, self.before.get(&body).copied())?;
        self.now.insert(body, side);
        Some(place)
    }
}

/// The names of bodies for which there is room. Of several variants, the first one's, and the names of all variants.
pub struct Names {
    places: TrackId,
    texts: TrackId,
    /// The bodies that were named last, ascending; `None` if nothing is logged yet.
    named: Option<Vec<usize>>,
    sides: Sides,
}

impl Names {
    /// Without names; `None` if there are too many bodies.
    pub fn new(schema: &Schema, chunks: &mut Chunks) -> Option<Names> {
        if schema.variants.is_empty() && !(2..=MAX_NAMED).contains(&schema.bodies.len()) {
            return None;
        }
        chunks.log_static(NAMES.path, &style());
        Some(Names {
            texts: chunks.track(NAMES.path, [Points3D::descriptor_labels(), Points3D::descriptor_colors()]),
            places: chunks.track(NAMES.path, [Points3D::descriptor_positions()]),
            named: None,
            sides: Sides::default(),
        })
    }

    /// Names the bodies in `first`, then those that had names, then the largest.
    pub fn log(&mut self, view: FrameView<'_>, first: &[usize], labels: &mut Labels<'_>, chunks: &mut Chunks) {
        let FrameView { schema, frame, at, .. } = view;
        for variant in &schema.variants {
            labels.take(variant.heading, variant.name);
        }
        let nameable = Some(schema.variant_size()).filter(|&bodies| bodies <= MAX_NAMED).unwrap_or(0);
        let mut bodies: Vec<usize> = (0..nameable).filter(|&body| !frame.bodies[body].is_absent).collect();
        self.sides.begin_frame();
        let rank = |body: usize| (first.contains(&body), self.sides.before.contains_key(&body));
        let radius = |body: usize| schema.bodies[body].radius;
        bodies.sort_by(|&one, &other| rank(other).cmp(&rank(one)).then(radius(other).total_cmp(&radius(one))));
        let place = |body: usize| Some((body, self.sides.take(body, schema.plain_name(body), labels)?));
        let mut named: Vec<(usize, DVec3)> = bodies.into_iter().filter_map(place).collect();
        named.sort_unstable_by_key(|(body, _)| *body);
        let headings = schema.variants.iter().map(|variant| variant.heading);
        let places = named.iter().map(|(_, place)| *place).chain(headings);
        let places: Vec<Float3> = places.map(|place| place.as_vec3().to_array()).collect();
        let bodies: Vec<usize> = named.into_iter().map(|(body, _)| body).collect();
        if self.named.as_ref() != Some(&bodies) {
            let light = |body: usize| palette::label(palette::of_body(schema, body));
            let names = bodies.iter().map(|&body| (schema.plain_name(body), light(body)));
            let names = names.chain(schema.variants.iter().map(|variant| (variant.name, palette::SEAM)));
            let (names, colors): (Vec<String>, Vec<u32>) =
                names.map(|(name, rgb)| (name.to_owned(), color(rgb).to_u32())).unzip();
            chunks.push(self.texts, at, &[&names, &colors]);
            self.named = Some(bodies);
        }
        chunks.push_changed(self.places, at, &[&places]);
    }
}

/// Labels of the bodies that matter most at an instant, and the names of others.
pub struct BodyLabels {
    track: TrackId,
    sides: Sides,
    /// Number of the first bodies that may be labelled where another one hides them, because bodies are translucent.
    hidden: usize,
}

impl BodyLabels {
    /// Starts without labels.
    pub fn new(entity: &str, hidden: usize, chunks: &mut Chunks) -> BodyLabels {
        chunks.log_static(entity, &style().with_colors([color(palette::SEAM)]));
        let track = chunks.track(entity, [Points3D::descriptor_positions(), Points3D::descriptor_labels()]);
        BodyLabels { track, sides: Sides::default(), hidden }
    }

    /// Logs the labels of `first` for which there is room beside those at the places `taken`, then the names of the rest of
    /// them and of `others`, unless there are many bodies, which these would hide.
    pub fn log<'t>(
        &mut self,
        view: FrameView<'_>,
        taken: impl IntoIterator<Item = &'t (DVec3, String)>,
        first: impl Iterator<Item = (usize, String)>,
        others: impl Iterator<Item = usize>,
        chunks: &mut Chunks,
    ) {
        self.sides.begin_frame();
        let (mut all, mut rest) = (Labels::new(view), Vec::new());
        taken.into_iter().for_each(|(place, label)| _ = all.take(*place, label));
        let (mut places, mut labels): (Vec<Float3>, Vec<String>) = (Vec::new(), Vec::new());
        let mut take = |body: usize, label: String, may_be_hidden: bool| {
            let mut place = self.sides.take(body, &label, &mut all);
            if place.is_none() && may_be_hidden {
                let hiding = std::mem::take(&mut all.hiding);
                place = self.sides.take(body, &label, &mut all);
                all.hiding = hiding;
            }
            if let Some(place) = place {
                places.push(place.as_vec3().to_array());
                labels.push(label);
            }
            place.is_some()
        };
        for (number, (body, label)) in first.enumerate() {
            if !take(body, label, number < self.hidden) {
                rest.push(body);
            }
        }
        if view.schema.bodies.len() <= MAX_LABELS {
            for body in rest.into_iter().chain(others) {
                take(body, view.schema.bodies[body].name.clone(), false);
            }
        }
        chunks.push_changed(self.track, view.at, &[&places, &labels]);
    }
}
