//! The colours of displacements: a texture that the displacement view maps onto surfaces, and its colour scale.
//!
//! The place of a vertex in the texture is its displacement as a share of about the largest on the sides that face the
//! eye. What is larger on the far sides, or a single spike, would leave the same colour to all others, and is beyond
//! the end of the scale.

use std::{cell::Cell, sync::Arc};

use glam::DVec3;

use super::{
    FrameView,
    body_forces::MOST_BODIES,
    callout::Callout,
    labels::{BodyLabels, Labels},
    ranking::{self, Mark, Ranking, Row, is_ranked},
    recent,
};
use crate::observe::{
    Schema,
    schema::BodySchema,
    surface::{Group, VertexOrigin},
};
use crate::sdk::{
    self, AnyValues, Image, Points2D,
    components::{ImageBuffer, ImageFormat},
};
use crate::stream::{
    blueprint::Mapping,
    chunks::{Chunks, TrackId},
    contract::{
        BODY_DISPLACEMENT, HEAT_FORMAT, HEAT_PLACES, HEAT_TEXTURE, LARGEST, LARGEST_OF_BODIES, LEGEND,
        RANKED_DISPLACEMENTS,
    },
    light,
    palette::{self, color},
    series::{Interpolation, LineId, Series},
};
use crate::text::significant;
use crate::{
    colors,
    geometry::{Vectors, mesh},
};

/// Visualizer sources of surfaces in the displacement view, instead of their own colours and normals.
pub const MAPPINGS: [Mapping; 4] = [
    Mapping { target: "Mesh3D:vertex_texcoords", source: HEAT_PLACES.0 },
    Mapping { target: "Mesh3D:albedo_texture_buffer", source: HEAT_TEXTURE.0 },
    Mapping { target: "Mesh3D:albedo_texture_format", source: HEAT_FORMAT.0 },
    light::NO_LIGHT,
];

/// Texels of the colour range.
const WIDTH: usize = 256;
/// The smallest end of the colour range [radii]: numbers below would look like displacements.
const LEAST: f64 = 0.01;
/// The end of the colour range is the largest displacement on the sides of bodies that face the eye, but for spikes: at most this
/// ratio to the displacement that this share of these vertices do not exceed …
const OF_USUAL: f64 = 1.5;
const SHARE: f64 = 0.98;
/// … and at least this share of the largest, so that a small dent has more than one colour.
const OF_LARGEST: f64 = 0.5;
/// The numbers at which it can end, by powers of ten, so that consecutive frames mostly have the same colours.
const ENDS: [f64; 7] = [1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0];
/// A point this close to the centre of a round body is inside it, whatever its triangles cut off [radii].
const INSIDE: f64 = 0.95;
/// Number of vertices in front, the most displaced ones, of which one is marked that no body hides.
const CANDIDATES: usize = 64;
/// Number of triangles that are tested in a frame for whether they hide one.
const MOST_TRIANGLES: usize = 20_000;
/// Number of vertices, the most displaced ones, for which the mesh of a body tells whether they are inside.
const MOST_TESTED: usize = 32;
/// How far above all bodies the label of the largest displacement is at most [largest radius].
const ABOVE: f64 = 3.0;

/// Colour of the mark and its label: it is none of the scale, and legible on dark and light.
const MARK: palette::Rgb = colors::VERMILION;

/// The texture coordinates of a displacement, if that at the end of the colours is `end` [radii]. The viewer repeats
/// textures, so this one is mirrored in its second half, to have the same colour at both ends.
pub fn place(displacement: f32, end: f64) -> [f32; 2] {
    [0.5 * (displacement / end as f32).min(1.0), 0.5]
}

/// The least of [`ENDS`] times powers of ten that is, but for rounding, not less than a positive number.
fn rounded_up(x: f64) -> f64 {
    let power = 10f64.powf(x.log10().floor());
    let ends = [power, 10.0 * power].into_iter().flat_map(|power| ENDS.map(|end| end * power));
    ends.into_iter().find(|&end| end >= x * (1.0 - 1e-9)).unwrap_or(x)
}

/// The colour of a body's line and row: its own if the scene gives it one that no other body has.
fn line_color(schema: &Schema, body: usize) -> palette::Rgb {
    let of = |body: &BodySchema| body.color;
    let own = of(&schema.bodies[body])
        .filter(|own| schema.bodies.iter().enumerate().all(|(other, with)| other == body || of(with) != Some(*own)));
    own.unwrap_or_else(|| palette::distance(body))
}

/// Whether the bodies with the largest displacements are labelled with them.
pub fn are_bodies_labelled(schema: &Schema) -> bool {
    schema.variants.is_empty() && !schema.bodies.iter().any(|body| body.can_be_absent)
}

/// The numbers of the colour scale, and the mark at the largest displacement.
pub struct Heat {
    /// The numbers of the scale.
    ticks: TrackId,
    mark: Callout,
    /// The labels of bodies, if they have any.
    bodies: Option<BodyLabels>,
    ranking: Option<Ranking>,
    /// The largest displacement of each body over time; none of more than [`MOST_BODIES`].
    lines: Vec<LineId>,
}

impl Heat {
    /// Logs static data, and the texture of each of these surfaces.
    pub fn new(schema: &Schema, surfaces: &[String], series: &mut Series, chunks: &mut Chunks) -> Heat {
        let texel = |i: usize| palette::heat((i as f64 + 0.5) / WIDTH as f64);
        let row: Vec<u8> = (0..WIDTH).flat_map(texel).collect();
        let bar = Image::from_rgb24(row.repeat(HEIGHT), [WIDTH as u32, HEIGHT as u32]);
        chunks.log_static(&LEGEND.of(&["bar"]), &bar);
        let mirrored: Vec<u8> = (0..WIDTH).chain((0..WIDTH).rev()).flat_map(texel).collect();
        let texture = AnyValues::default()
            .with_component::<ImageBuffer>(HEAT_TEXTURE.0, [ImageBuffer::from(mirrored)])
            .with_component::<ImageFormat>(HEAT_FORMAT.0, [ImageFormat::rgb8([2 * WIDTH as u32, 1])]);
        surfaces.iter().for_each(|surface| chunks.log_static(surface, &texture));
        let ticks = Points2D::update_fields()
            .with_positions(TICKS.map(|share| [(share * WIDTH as f64) as f32, HEIGHT as f32]))
            .with_radii([sdk::Radius::new_ui_points(2.0)])
            .with_colors([color(palette::DOT)])
            .with_show_labels(true);
        chunks.log_static(&LEGEND.of(&["ticks"]), &ticks);
        let with_lines = if schema.bodies.len() <= MOST_BODIES { schema.bodies.as_slice() } else { &[] };
        let line = |(index, body): (usize, &BodySchema)| {
            let entity = BODY_DISPLACEMENT.of(&[&body.name]);
            Series::style(chunks, &entity, &body.name, line_color(schema, index), 1.5, Interpolation::Linear);
            series.line(chunks, &entity, Interpolation::Linear)
        };
        let lines = with_lines.iter().enumerate().map(line).collect();
        Heat {
            ticks: chunks.track(&LEGEND.of(&["ticks"]), [Points2D::descriptor_labels()]),
            mark: Callout::new(LARGEST.path, MARK, chunks),
            bodies: are_bodies_labelled(schema).then(|| BodyLabels::new(LARGEST_OF_BODIES.path, 0, chunks)),
            ranking: is_ranked(schema).then(|| Ranking::new(RANKED_DISPLACEMENTS.path, chunks)),
            lines,
        }
    }

    /// Logs the numbers of the scale, and marks the vertex with the largest displacement. Its label is outside of the
    /// body, at the end of a line from the vertex.
    pub fn log(
        &mut self,
        view: FrameView<'_>,
        displacements: &Displacements,
        series: &mut Series,
        chunks: &mut Chunks,
    ) {
        let Displacements { outside, seen, of_all, end, .. } = displacements;
        let exceeding = outside.filter(|largest| largest.displacement > 1.001 * end);
        let mut ticks: Vec<String> = TICKS.map(|share| significant(share * end)).into();
        if let (Some(largest), Some(last)) = (exceeding, ticks.last_mut()) {
            *last +=
                &format!("; up to {} on the surface, at {}", significant(largest.displacement), largest.place(view));
        }
        chunks.push_changed(self.ticks, view.at, &[&ticks]);
        // the line to the label rises in front of the bodies: seen from there, it is straight
        let space = Labels::new(view);
        let clearance = seen.map_or(0.0, |of| space.clearance(of.position));
        let in_front = |place: DVec3| place.lerp(space.far(), clearance);
        let mark = outside.or(*of_all).filter(|largest| largest.displacement > 0.0).map(|largest| {
            let hidden = of_all.filter(|of_all| outside.is_some_and(|of| of_all.displacement > of.displacement));
            let hidden = hidden.map(|hidden| format!("\ninside another body: {}", hidden.text(view)));
            let place = if outside.is_some() { "on the surface" } else { "inside another body" };
            // the line to a vertex on the far side would seem to end on whatever hides it
            let (marked, front) = match seen {
                Some(seen) if (seen.body, seen.vertex) == (largest.body, largest.vertex) => {
                    (Some(largest), String::new())
                }
                Some(seen) => (Some(*seen), format!("largest in front: {}\n", seen.text(view))),
                None => (None, String::new()),
            };
            let behind = if marked.is_none() { ", not in view" } else { "" };
            let label = format!("{front}largest {place}: {}{behind}{}", largest.text(view), hidden.unwrap_or_default());
            let height = f64::min(recent::label_height(view), view.top() + ABOVE * view.schema.largest_radius());
            let below = marked.unwrap_or(largest).position;
            let height = height.max(space.height_above(below, &label));
            let end = in_front(view.schema.raised(below, height));
            ([marked.map_or(end, |marked| marked.position), end], label)
        });
        let taken = mark.as_ref().map(|([place, end], label)| [(*place, String::new()), (*end, label.clone())]);
        let front = mark.as_ref().zip(*seen).map(|(([_, end], _), seen)| {
            let front = in_front(seen.position) - seen.position;
            let centre = view.frame.bodies[seen.body].centre;
            // as little as keeps the line out of the body: from another camera, it has a bend there
            let is_clear = |share: &f64| {
                let from = seen.position + *share * front;
                let (along, radius) = (*end - from, seen.position.distance(centre));
                let nearest = ((centre - from).dot(along) / along.length_squared()).clamp(0.0, 1.0);
                (from + nearest * along).distance(centre) >= radius * (1.0 - 1e-9)
            };
            [0.0, 0.125, 0.25, 0.5].into_iter().find(is_clear).unwrap_or(1.0) * front
        });
        self.mark.log(mark, front, view.at, chunks);
        let largest = |body: usize| view.frame.bodies[body].max_displacement / view.schema.bodies[body].radius;
        let mut ranked: Vec<usize> = (0..view.schema.bodies.len()).collect();
        for (body, line) in self.lines.iter().enumerate() {
            let value = if view.frame.bodies[body].is_absent { f64::NAN } else { largest(body) };
            series.log_or_interrupt(chunks, *line, value, view.at);
        }
        ranked.sort_by(|&one, &other| largest(other).total_cmp(&largest(one)));
        let longest = ranked.first().map_or(0.0, |&body| largest(body));
        let least = if longest > 2.0 * INVISIBLE { INVISIBLE } else { ranking::NOISE * longest };
        let displaced = ranked.iter().take_while(|&&body| largest(body) > least).count();
        let inside = |body: usize| if displacements.is_inside[body] { ", inside a body" } else { "" };
        if let Some(bodies) = &mut self.bodies {
            // of more than a few bodies, the ranking says the rest: long labels would lie on other bodies
            let rest = |body: usize| if is_ranked(view.schema) { "" } else { inside(body) };
            let label = |&body: &usize| {
                let of = &view.schema.bodies[body].name;
                (body, format!("{of} {}{}", radii(largest(body)), rest(body)))
            };
            let (first, others) = ranked.split_at(displaced.min(ranking::LABELLED));
            let taken = taken.iter().flatten();
            bodies.log(view, taken, first.iter().map(label), others.iter().copied(), chunks);
        }
        if let Some(ranking) = &self.ranking {
            let rows = ranked.into_iter().take(displaced).map(|body| {
                let vertex = view.frame.bodies[body].most_displaced().unwrap_or(0);
                let label =
                    format!("{}:{vertex} {}{}", view.schema.bodies[body].name, radii(largest(body)), inside(body));
                let color = if self.lines.is_empty() { palette::DOT } else { line_color(view.schema, body) };
                Row { label, color, marks: vec![(Mark::Bar(largest(body) / longest), color)] }
            });
            ranking.log(rows, "no vertex is displaced", view.at, chunks);
        }
    }
}

/// Height of the colour scale [texels].
const HEIGHT: usize = 10;
/// Places of its numbers, as shares of the range.
const TICKS: [f64; 3] = [0.0, 0.5, 1.0];

/// A displacement that reads 0.000 [radii]; left out unless all are that small.
const INVISIBLE: f64 = 5e-4;

/// A displacement [radii].
fn radii(x: f64) -> String {
    if x < 1e3 { format!("{x:.3} R") } else { format!("{x:.2e} R") }
}

/// The vertex with the largest displacement.
#[derive(Clone, Copy)]
struct Largest {
    /// [radii]
    displacement: f64,
    body: usize,
    vertex: usize,
    /// [scene unit]
    position: DVec3,
}

impl Largest {
    fn text(&self, view: FrameView<'_>) -> String {
        format!("{}, {}", self.place(view), radii(self.displacement))
    }

    fn place(&self, view: FrameView<'_>) -> String {
        format!("{}:{}", view.schema.bodies[self.body].name, self.vertex)
    }
}

/// The displacements of the vertices on the surface, which lie in no other body, and the largest of all.
#[derive(Clone, Default)]
pub struct Displacements {
    outside: Option<Largest>,
    /// The largest on the surface that is seen from the usual direction of the camera.
    seen: Option<Largest>,
    of_all: Option<Largest>,
    /// Whether the most displaced vertex of each body is not on the surface.
    is_inside: Vec<bool>,
    /// The displacement at the end of the colours [radii].
    end: f64,
    /// Scratch storage, reused.
    lengths: Vec<f32>,
    /// The distances of the nearest and the farthest vertex of each body from its centre [scene unit].
    extents: Vec<[f64; 2]>,
    near: Vec<Near>,
    normals: Vec<DVec3>,
    candidates: Vec<Largest>,
    doubtful: Vec<Largest>,
    /// `[body_count]`
    merged: Vec<PartOfSurface>,
}

/// Writes the outward normals of the vertices of a closed mesh, of any length, to `normals` (reused).
fn outward_normals(triangles: &[[u32; 3]], positions: &Vectors, normals: &mut Vec<DVec3>) {
    mesh::sum_normals(positions, triangles, normals);
    if mesh::signed_volume_of(positions, triangles) < 0.0 {
        normals.iter_mut().for_each(|normal| *normal = -*normal); // it is inside out
    }
}

/// Another body, with which a body is not merged.
#[derive(Clone, Copy)]
struct Near {
    body: usize,
    centre: DVec3,
    /// Points closer to the centre than this are inside it, if it is star-shaped [scene unit].
    surely: f64,
    /// Points closer than this are inside it, if it is not deformed [scene unit].
    usually: f64,
    /// Points farther than this are outside [scene unit].
    reach: f64,
}

impl Near {
    /// Whether a point in the world is inside.
    fn contains(&self, view: FrameView<'_>, point: DVec3) -> bool {
        let distance = self.centre.distance(point);
        distance < self.surely
            || distance < self.reach
                && with_mesh(view, self.body, |positions, triangles| {
                    mesh::encloses(positions, triangles, point - self.centre)
                })
    }
}

/// Asks something about the surface of a body, whose positions are relative to its centre.
fn with_mesh(view: FrameView<'_>, body: usize, ask: impl Fn(&Vectors, &[[u32; 3]]) -> bool) -> bool {
    let (of, now) = (&view.schema.bodies[body], &view.frame.bodies[body]);
    let triangles = now.mesh_of(of).triangles();
    if !now.is_at_rest {
        return ask(&now.positions, triangles);
    }
    let mut positions = Vectors::default();
    now.local_positions(now.rest_of(of), &mut positions);
    ask(&positions, triangles)
}

/// A body's part of a merged surface.
#[derive(Clone, Default)]
struct PartOfSurface {
    /// The number of the surface, if the body is part of one.
    number: Option<usize>,
    /// Whether each of its vertices is on the surface.
    is_on: Vec<bool>,
}

impl Displacements {
    /// Finds them in a frame with these merged surfaces.
    pub fn find(&mut self, view: FrameView<'_>, groups: &[Arc<Group>]) {
        self.merged.resize_with(view.schema.bodies.len(), PartOfSurface::default);
        self.merged.iter_mut().for_each(|part| part.number = None);
        for (number, group) in groups.iter().enumerate() {
            for &body in &group.bodies {
                let part = &mut self.merged[body];
                part.number = Some(number);
                part.is_on.clear();
                part.is_on.resize(view.frame.bodies[body].lengths.len(), false);
            }
            for VertexOrigin { bodies: [body, _], vertex, .. } in &group.origins {
                let is_on = vertex.and_then(|vertex| self.merged[*body as usize].is_on.get_mut(vertex as usize));
                is_on.into_iter().for_each(|is_on| *is_on = true);
            }
        }
        let [mut outside, mut of_all]: [Option<Largest>; 2] = [None; 2];
        let mut in_front = 0.0f64;
        self.lengths.clear();
        self.candidates.clear();
        self.is_inside.clear();
        self.is_inside.resize(view.schema.bodies.len(), false);
        let labels = Labels::new(view);
        let present = view.bodies().enumerate().filter(|(_, (_, now))| !now.is_absent);
        let mut by_x: Vec<(f64, usize)> = present.map(|(body, (_, now))| (now.centre.x, body)).collect();
        by_x.sort_unstable_by(|one, other| one.0.total_cmp(&other.0));
        self.extents.clear();
        self.extents.extend(view.bodies().map(|(body, now)| {
            let range = |squares: &mut dyn Iterator<Item = f64>| {
                squares.fold([f64::INFINITY, 0.0], |[least, most], of| [least.min(of), most.max(of)]).map(f64::sqrt)
            };
            let rest = now.rest_of(body);
            match now.is_at_rest {
                true if now.mesh_of(body).is_round() => [body.radius; 2],
                true => range(&mut (0..rest.len()).map(|vertex| rest.position(vertex).length_squared())),
                false => range(&mut now.positions.iter().map(DVec3::length_squared)),
            }
        }));
        let extents = &self.extents;
        let widest = by_x.iter().map(|&(_, body)| extents[body][1]).fold(0.0, f64::max);
        let others = |index: usize, merged: &[PartOfSurface], near: &mut Vec<Near>| {
            let (centre, reach) = (view.frame.bodies[index].centre, extents[index][1]);
            let first = by_x.partition_point(|(x, _)| *x < centre.x - widest - reach);
            let others = by_x[first..].iter().take_while(|(x, _)| *x <= centre.x + widest + reach);
            near.clear();
            near.extend(others.filter_map(|&(_, other)| {
                let are_merged = merged[index].number.is_some() && merged[other].number == merged[index].number;
                let (now, radius) = (&view.frame.bodies[other], view.schema.bodies[other].radius);
                let [least, reach_of_other] = extents[other];
                let count = now.mesh_of(&view.schema.bodies[other]).vertex_count();
                let other = Near {
                    body: other,
                    centre: now.centre,
                    // the middles of triangles are closer than vertices: by 5 over their number, squared, if all are alike
                    surely: INSIDE * least * (1.0 - 5.0 / count as f64).max(0.0).sqrt(),
                    usually: INSIDE * radius,
                    reach: reach_of_other,
                };
                let is_near = now.centre.distance(centre) < other.reach + reach;
                (other.body != index && !are_merged && is_near).then_some(other)
            }));
        };
        self.doubtful.clear();
        for (index, (body, now)) in view.bodies().enumerate().filter(|(_, (_, now))| now.max_displacement > 0.0) {
            others(index, &self.merged, &mut self.near);
            let PartOfSurface { number, is_on } = &self.merged[index];
            let to_eye = view.eye - now.centre;
            self.normals.clear();
            for (vertex, &length) in now.lengths.iter().enumerate() {
                let position = now.centre + now.positions.get(vertex);
                let found = Largest { displacement: length / body.radius, body: index, vertex, position };
                let larger = |than: &mut Option<Largest>| {
                    if than.is_none_or(|than| found.displacement > than.displacement) {
                        *than = Some(found);
                    }
                };
                larger(&mut of_all);
                let is_off = number.is_some() && !is_on[vertex];
                let is_within = |radius: fn(&Near) -> f64| {
                    self.near.iter().any(|near| near.centre.distance_squared(position) < radius(near).powi(2))
                };
                if is_off {
                    continue;
                }
                let is_free = !is_within(|near| near.usually);
                // on the side of the body that faces the eye
                if is_free && (position - now.centre).dot(to_eye) > 0.0 {
                    self.lengths.push(found.displacement as f32);
                    in_front = in_front.max(found.displacement);
                }
                if is_within(|near| near.surely) {
                    continue;
                }
                if is_within(|near| near.reach) {
                    self.doubtful.push(found);
                } else {
                    larger(&mut outside);
                }
                if is_free {
                    let least = self.candidates.get(CANDIDATES - 1).map_or(0.0, |least| least.displacement);
                    if found.displacement > least {
                        if self.normals.is_empty() {
                            outward_normals(now.mesh_of(body).triangles(), &now.positions, &mut self.normals);
                        }
                        if labels.may_be_in_front(index, position, self.normals[vertex]) {
                            let place =
                                self.candidates.partition_point(|other| other.displacement >= found.displacement);
                            self.candidates.insert(place, found);
                            self.candidates.truncate(CANDIDATES);
                        }
                    }
                }
            }
            if let Some(vertex) = now.most_displaced() {
                let position = now.centre + now.positions.get(vertex);
                let is_off = number.is_some() && !is_on[vertex];
                self.is_inside[index] = is_off || self.near.iter().any(|near| near.contains(view, position));
            }
        }
        let (merged, near) = (&self.merged, &mut self.near);
        let mut is_outside = |of: &Largest| {
            others(of.body, merged, near);
            !near.iter().any(|near| near.contains(view, of.position))
        };
        self.doubtful.sort_by(|one, other| other.displacement.total_cmp(&one.displacement));
        let least = outside.map_or(0.0, |outside| outside.displacement);
        let larger = self.doubtful.iter().take_while(|of| of.displacement > least).take(MOST_TESTED);
        outside = larger.copied().find(&mut is_outside).or(outside);
        // its own body may hide it, too
        let left = Cell::new(MOST_TRIANGLES);
        let is_clear = |of: &&Largest| {
            let hides = |body: usize| {
                let triangles = view.frame.bodies[body].mesh_of(&view.schema.bodies[body]).triangles().len();
                left.set(left.get().saturating_sub(triangles));
                let centre = view.frame.bodies[body].centre;
                with_mesh(view, body, |positions, triangles| {
                    let own = (body == of.body).then_some(of.vertex as u32);
                    mesh::hides(positions, triangles, (of.position - centre, own), view.eye - centre)
                })
            };
            !hides(of.body) && !labels.before(of.body, of.position).any(hides) && is_outside(of)
        };
        self.seen = self.candidates.iter().take_while(|_| left.get() > 0).find(is_clear).copied();
        (self.outside, self.of_all) = (outside, of_all);
        let rank = (SHARE * self.lengths.len() as f64) as usize;
        let usual = match self.lengths.get(rank) {
            Some(_) => f64::from(*self.lengths.select_nth_unstable_by(rank, f32::total_cmp).1),
            None => in_front,
        };
        self.end = rounded_up(in_front.min(OF_USUAL * usual).max(OF_LARGEST * in_front).max(LEAST));
    }

    /// The displacement at the end of the colours [radii].
    pub fn end(&self) -> f64 {
        self.end
    }
}
