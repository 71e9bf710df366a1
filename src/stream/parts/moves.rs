//! How far each vertex moved since the state before, as arrows.

use glam::{DVec3, Vec3};

use super::{FrameView, callout::Callout, recent};
use crate::{
    colors,
    geometry::Vectors,
    observe::{Frame, Schema},
    sdk::{Arrows3D, Radius},
    stream::{
        chunks::{Chunks, TrackId},
        contract::{FURTHEST, MOVES},
        extract::{Arrows, Extractor},
        palette::{Rgb, color},
    },
    text::significant,
};

/// The colour of the arrows.
pub const MOVED: Rgb = colors::VERMILION;
/// A shorter move is rounding [radii].
const STILL: f64 = 1e-9;
/// Lengths of the longest arrow [largest radius] and of the shortest one drawn [longest].
const LONGEST: f64 = 0.5;
const SHORTEST: f64 = 0.02;

/// The vertex that moved furthest.
#[derive(Clone, Copy)]
pub struct Furthest {
    /// Its body.
    pub body: usize,
    /// Its number.
    pub vertex: usize,
    /// How far [radii].
    pub distance: f64,
}

/// The arrows, and the vertex that moved furthest.
pub struct Moves {
    arrows: TrackId,
    mark: Callout,
}

impl Moves {
    /// Logs the style of the arrows.
    pub fn new(chunks: &mut Chunks) -> Moves {
        let arrows = Arrows3D::update_fields().with_radii([Radius::new_ui_points(1.2)]).with_show_labels(false);
        chunks.log_static(MOVES.path, &arrows.with_colors([color(MOVED)]));
        let components = [Arrows3D::descriptor_origins(), Arrows3D::descriptor_vectors()];
        Moves { arrows: chunks.track(MOVES.path, components), mark: Callout::new(FURTHEST.path, MOVED, chunks) }
    }

    /// Logs how [vertices moved](between) since the state before, or `would move`; `longest` is the length of the longest move between two
    /// stages of the step [scene unit]. Returns the vertex that moved furthest, unless none moved.
    pub fn log(
        &self,
        moved: Vec<Vectors>,
        (view, longest, how): (FrameView<'_>, f64, &str),
        extractor: &mut Extractor,
        chunks: &mut Chunks,
    ) -> Option<Furthest> {
        let furthest = furthest(view.schema, &moved);
        let mut arrows = Arrows::default();
        let mut mark = None;
        if let Some(Furthest { body, vertex, distance }) = furthest {
            let of_body = |body: usize| (&view.schema.bodies[body], &view.frame.bodies[body]);
            let scale = LONGEST * view.schema.largest_radius() / longest;
            let mut ends = Vec::new();
            for (index, mut moved) in moved.into_iter().enumerate() {
                let (schema, now) = of_body(index);
                extractor.world_positions(schema, now, &mut ends);
                for i in 0..moved.len() {
                    if moved.get(i).length() < SHORTEST * longest {
                        moved.set(i, DVec3::ZERO);
                    }
                }
                arrows.append(&ends, None, &moved, scale);
                if index == body {
                    let text = format!("{}:{vertex} {how} {} R", schema.name, significant(distance));
                    let ends = ends.get(vertex).map(|&[x, y, z]| {
                        let place = Vec3::new(x, y, z).as_dvec3();
                        [place, view.schema.raised(place, recent::label_height(view))]
                    });
                    mark = ends.map(|ends| (ends, text));
                }
            }
        }
        chunks.push_changed(self.arrows, view.at, &[&arrows.origins, &arrows.vectors]);
        self.mark.log(mark, None, view.at, chunks);
        furthest
    }
}

/// The length of the longest move [scene unit]; 0 if nothing moved.
pub fn longest(moved: &[Vectors]) -> f64 {
    moved.iter().flat_map(|moved| moved.iter().map(|vector| vector.length())).fold(0.0, f64::max)
}

/// How each vertex of each body moved between two frames [scene unit], of a body on a path relative to its centre; none of a
/// body whose vertices are not the same.
pub fn between(schema: &Schema, frames: [&Frame; 2]) -> Vec<Vectors> {
    let mut positions = [Vectors::default(), Vectors::default()];
    let bodies = schema.bodies.iter().zip(frames[0].bodies.iter().zip(&frames[1].bodies));
    let moved = bodies.map(|(body, (before, now))| {
        for (state, positions) in [before, now].into_iter().zip(&mut positions) {
            state.local_positions(state.rest_of(body), positions);
        }
        let [from, to] = &positions;
        let shift = if body.is_free { now.centre - before.centre } else { DVec3::ZERO };
        match from.len() == to.len() {
            true => from.iter().zip(to.iter()).map(|(from, to)| to - from + shift).collect(),
            false => Vectors::default(),
        }
    });
    moved.collect()
}

fn furthest(schema: &Schema, moved: &[Vectors]) -> Option<Furthest> {
    let moves = moved.iter().enumerate().flat_map(|(body, moved)| {
        moved.iter().enumerate().map(move |(vertex, vector)| (body, vertex, vector.length()))
    });
    let (body, vertex, length) = moves.reduce(|one, other| if other.2 > one.2 { other } else { one })?;
    let distance = length / schema.bodies[body].radius;
    (distance > STILL).then_some(Furthest { body, vertex, distance })
}
