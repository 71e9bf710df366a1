//! The surfaces of groups: one mesh in world coordinates, and the lines along which bodies meet.

use std::{
    collections::VecDeque,
    sync::{Arc, atomic::AtomicBool},
    time::{Duration, Instant as Clock},
};

use glam::DVec3;
use rayon::{ThreadPool, ThreadPoolBuilder, prelude::*};

use super::FrameView;
use crate::{
    analysis::surface::{Merged, Merger},
    colors::Rgb,
    geometry::Facets,
    observe::{
        self, Frame, Schema,
        surface::{Group, VertexOrigin},
    },
    sdk::{self, AnnotationContext, AnyValues, LineStrips3D, Mesh3D, components::TriangleIndices},
    stream::{
        chunks::{Chunks, TrackId},
        columns::Cell,
        contract::{DRAWN, LIT, MERGED, MERGED_SEAMS, MERGED_SURFACE, VERTEX},
        extract::Float3,
        light::{self, Light},
        palette::{self, color},
    },
};

/// The triangles of a body that is drawn as part of a merged surface. (The viewer treats an empty list as unknown
/// triangles.)
pub const HIDDEN: [[u32; 3]; 1] = [[0; 3]];

/// The component [`DRAWN`].
pub fn drawn(triangles: &[[u32; 3]]) -> AnyValues {
    AnyValues::default().with_component::<TriangleIndices>(DRAWN.0, triangles.iter().copied())
}

/// Merged surfaces, with the last logged values.
pub struct MergedEntities {
    /// Computes frames that were not computed ahead.
    merger: Merger,
    ahead: Ahead,
    /// The surfaces and measures of the last frame.
    merged: Merged,
    interrupt: Option<&'static AtomicBool>,
    surface: TrackId,
    seams: TrackId,
    /// The groups that were last logged.
    last: Vec<Arc<Group>>,
    mesh: Mesh,
}

/// The surfaces of frames that are still to be logged.
pub type Ahead = VecDeque<Computed>;

/// The surfaces of a frame, computed before it is logged.
pub struct Computed {
    frame: observe::Instant,
    pairs: Vec<[usize; 2]>,
    merged: Merged,
    /// Computing time on its thread.
    time: Duration,
}

/// Computes the surfaces of frames before they are logged, on threads of its own: the simulation would otherwise wait
/// for one at each of its parallel loops. By default, computes nothing.
#[derive(Default)]
pub struct Lookahead {
    schema: Schema,
    pool: Option<ThreadPool>,
    /// One per thread.
    mergers: Vec<Merger>,
}

impl Lookahead {
    /// With as many threads as everything else; computes nothing if that is one, or if they cannot be started.
    fn new(schema: &Schema, interrupt: Option<&'static AtomicBool>) -> Lookahead {
        let threads = rayon::current_num_threads();
        let pool = (threads > 1).then(|| ThreadPoolBuilder::new().num_threads(threads).build().ok()).flatten();
        let mergers = (0..threads).map(|_| Merger::new(schema, interrupt)).collect();
        Lookahead { schema: schema.clone(), pool, mergers }
    }

    /// Computes the surfaces of frames that will be logged next, while this thread does `other` work. `pairs` are those to
    /// be measured in each frame. The surfaces of a frame do not depend on other frames, nor on the number of threads.
    pub fn compute(&mut self, frames: &[Frame], pairs: &[Vec<[usize; 2]>], other: impl FnOnce()) -> Ahead {
        let Lookahead { schema, pool, mergers } = self;
        let mut ahead = Vec::new();
        let compute = |ahead: &mut Vec<Vec<Computed>>| {
            // consecutive frames per thread, so that groups at rest are computed once
            let count = frames.len().div_ceil(mergers.len());
            let runs = frames.par_chunks(count).zip(pairs.par_chunks(count)).zip(mergers);
            let runs = runs.map(|((frames, pairs), merger)| {
                let of_frame = |(frame, pairs): (&Frame, &Vec<[usize; 2]>)| {
                    let start = Clock::now();
                    let merged = merger.merge(schema, frame, pairs).clone();
                    Computed { frame: frame.at, pairs: pairs.clone(), merged, time: start.elapsed() }
                };
                frames.iter().zip(pairs).map(of_frame).collect()
            });
            runs.collect_into_vec(ahead);
        };
        match pool {
            Some(pool) if frames.iter().any(|frame| !frame.pairs.is_empty()) => pool.in_place_scope(|scope| {
                scope.spawn(|_| compute(&mut ahead));
                other();
            }),
            _ => other(),
        }
        ahead.into_iter().flatten().collect()
    }
}

/// The mesh of all groups. Reused.
#[derive(Default)]
struct Mesh {
    triangles: Vec<[u32; 3]>,
    positions: Vec<Float3>,
    normals: Vec<Float3>,
    colors: Vec<u32>,
    lit: Vec<u32>,
    classes: Vec<u16>,
    vertices: Vec<u32>,
    seams: Vec<Vec<Float3>>,
    names: Vec<String>,
    /// Scratch storage: sums of the triangle normals around each vertex.
    sums: Vec<DVec3>,
}

impl MergedEntities {
    /// Logs static data. After an interrupt, frames show overlapping meshes.
    pub fn new(schema: &Schema, interrupt: Option<&'static AtomicBool>, chunks: &mut Chunks) -> MergedEntities {
        let components = [
            Mesh3D::descriptor_triangle_indices(),
            Mesh3D::descriptor_vertex_positions(),
            Mesh3D::descriptor_vertex_normals(),
            Mesh3D::descriptor_vertex_colors(),
            LIT.descriptor(),
            Mesh3D::descriptor_class_ids(),
            VERTEX.descriptor(),
        ];
        if schema.bodies.len() > 1 {
            let names = schema.bodies.iter().zip(1..u16::MAX).map(|(body, class)| (class, body.name.as_str()));
            chunks.log_static(MERGED.path, &AnnotationContext::new(std::iter::once((0, "seam")).chain(names)));
            let style = LineStrips3D::update_fields()
                .with_radii([sdk::Radius::new_ui_points(1.0)])
                .with_colors([color(palette::SEAM)])
                .with_show_labels(false);
            chunks.log_static(MERGED_SEAMS.path, &style);
            let clear = Mesh3D::update_fields().with_albedo_factor(palette::translucent([0xFF; 3]));
            chunks.log_static(MERGED_SURFACE.path, &clear);
            chunks.log_static(MERGED_SURFACE.path, &light::unlit());
        }
        MergedEntities {
            merger: Merger::new(schema, interrupt),
            ahead: Ahead::new(),
            merged: Merged::default(),
            interrupt,
            surface: chunks.track(MERGED_SURFACE.path, components),
            seams: chunks
                .track(MERGED_SEAMS.path, [LineStrips3D::descriptor_strips(), LineStrips3D::descriptor_labels()]),
            last: Vec::new(),
            mesh: Mesh::default(),
        }
    }

    /// Computes the surfaces of frames before they are logged.
    pub fn lookahead(&self, schema: &Schema) -> Lookahead {
        Lookahead::new(schema, self.interrupt)
    }

    /// Takes the surfaces of the frames that are logged next.
    pub fn expect(&mut self, ahead: Ahead) {
        self.ahead = ahead;
    }

    /// Computes the surfaces of a frame, measures `pairs`, and logs changed values. Returns the time spent on computing
    /// the frame ahead.
    pub fn log(&mut self, view: FrameView<'_>, pairs: &[[usize; 2]], chunks: &mut Chunks) -> Duration {
        let ahead = self.ahead.pop_front().filter(|ahead| ahead.frame == view.frame.at && ahead.pairs == pairs);
        let time = ahead.as_ref().map_or(Duration::ZERO, |ahead| ahead.time);
        match ahead {
            Some(ahead) => self.merged = ahead.merged,
            None => self.merged.clone_from(self.merger.merge(view.schema, view.frame, pairs)),
        }
        self.log_merged(view, chunks);
        time
    }

    fn log_merged(&mut self, view: FrameView<'_>, chunks: &mut Chunks) {
        let merged = &self.merged;
        // equal surfaces are different objects if different threads computed them
        let is_same = self.last.len() == merged.groups.len()
            && self.last.iter().zip(&merged.groups).all(|(last, now)| Arc::ptr_eq(last, now) || last == now);
        if is_same {
            return;
        }
        self.last.clone_from(&merged.groups);
        self.mesh.clear();
        for group in &merged.groups {
            self.mesh.append(view.schema, group);
        }
        let Mesh { triangles, positions, normals, colors, lit, classes, vertices, seams, names, .. } = &self.mesh;
        let cells: [&dyn Cell; _] = [triangles, positions, normals, colors, lit, classes, vertices];
        chunks.push(self.surface, view.at, &cells);
        chunks.push(self.seams, view.at, &[seams, names]);
    }

    /// The surfaces and measures of the last frame.
    pub fn merged(&self) -> &Merged {
        &self.merged
    }
}

impl Mesh {
    fn clear(&mut self) {
        let Mesh { triangles, positions, normals, colors, lit, classes, vertices, seams, names, sums } = self;
        triangles.clear();
        positions.clear();
        normals.clear();
        colors.clear();
        lit.clear();
        classes.clear();
        vertices.clear();
        seams.clear();
        names.clear();
        sums.clear();
    }

    fn append(&mut self, schema: &Schema, group: &Group) {
        let first = self.positions.len() as u32;
        let single = |position: &DVec3| position.as_vec3().to_array();
        self.positions.extend(group.positions.iter().map(single));
        let facets = group.facets(schema);
        let triangles = facets.as_ref().map_or(&*group.triangles, Facets::triangles);
        self.triangles.extend(triangles.iter().map(|corners| corners.map(|v| v + first)));
        let mut rgbs: Vec<Rgb> = group.origins.iter().map(|origin| palette::blended(schema, origin)).collect();
        match &facets {
            Some(facets) => {
                facets.extend(&mut rgbs, 0);
                facets.append_normals(|i| group.positions[i], group.positions.len(), &mut self.normals);
            }
            None => group.append_normals(&mut self.sums, &mut self.normals),
        }
        let light = Light::in_world(schema);
        for (&rgb, &normal) in rgbs.iter().zip(&self.normals[first as usize..]) {
            self.colors.push(color(rgb).to_u32());
            self.lit.push(light.on(rgb, normal));
        }
        let class = |origin: &VertexOrigin| match origin.vertex {
            Some(_) => u16::try_from(origin.bodies[0] + 1).unwrap_or(0),
            None => 0,
        };
        self.classes.extend(group.origins.iter().map(class));
        self.vertices.extend(group.origins.iter().map(|origin| origin.vertex.unwrap_or(u32::MAX)));
        if let Some(facets) = &facets {
            facets.extend(&mut self.positions, first as usize);
            facets.extend(&mut self.classes, first as usize);
            facets.extend(&mut self.vertices, first as usize);
        }
        for seam in &group.seams {
            self.seams.push(seam.positions.iter().map(single).collect());
            self.names.push(schema.pair_name(seam.bodies[0], seam.bodies[1]));
        }
    }
}

#[cfg(test)]
mod tests {

    use super::*;
    use crate::{
        World,
        observe::{Experiment as _, Simulation as _, Want},
        scene::Scene,
        sdk::{ApplicationId, LogMsg, StoreId, StoreKind},
        stream::{parts::pairs::PairPlots, series::Series, settings::Settings},
    };

    /// The messages of a run whose frames are recorded in packets, on this many threads.
    fn recorded(scene: &Scene, steps: usize, in_packet: usize, threads: usize) -> Vec<LogMsg> {
        let scene = scene.clone();
        let name = scene.name.clone();
        let (schema, settings) = (scene.schema(), Settings::of(&scene));
        let application = ApplicationId::new_or_unknown("test".to_owned());
        let mut chunks = Chunks::new(StoreId::new(StoreKind::Recording, application, "test"));
        let (mut merged, mut pairs) = (MergedEntities::new(&schema, None, &mut chunks), PairPlots::new(&settings));
        let mut series = Series::default();
        let mut world = World::new(scene).unwrap();
        let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut lookahead = pool.install(|| merged.lookahead(&schema));
        let mut frames = vec![Frame::default(); in_packet];
        for _ in 0..steps / in_packet {
            for frame in &mut frames {
                let _ = world.step();
                world.observe(Want::default(), frame);
            }
            merged.expect(lookahead.compute(&frames, &pairs.foresee(&schema, [&[], &frames]), || {}));
            for frame in &frames {
                let view = FrameView::of(&schema, frame, frame.at);
                let shown = pairs.choose(view, &mut series, &mut chunks);
                let ahead = merged.log(view, shown, &mut chunks);
                let is_foreseen = frame.pairs.is_empty() || threads < 2 || ahead > Duration::ZERO;
                assert!(is_foreseen, "{name}, step {}: pairs differ from the foreseen ones", frame.at.step);
            }
        }
        chunks.take()
    }

    /// A recording depends neither on the number of threads nor on the size of packets, even if a group is at rest,
    /// which is logged once.
    #[test]
    fn frames_computed_ahead_are_logged_identically() {
        let at_rest = "duration = 2.0\n[influence]\nalpha = 0\nbeta = 0\n[[body]]\nname = \"a\"\nradius = 1\nmotion = { fixed = [0, 0, 0] }\n\
            [[body]]\nname = \"b\"\nradius = 1\nmotion = { fixed = [1.5, 0, 0] }\n";
        let at_rest = Scene::parse(at_rest, "at_rest").unwrap();
        let builtin = |name| Scene::builtin(name).unwrap();
        for (scene, steps) in [(at_rest, 32), (builtin("two"), 144), (builtin("crowd"), 16)] {
            let one_by_one = recorded(&scene, steps, 1, 1);
            for (in_packet, threads) in [(16, 3), (8, 8)] {
                let messages = recorded(&scene, steps, in_packet, threads);
                assert!(messages == one_by_one, "{}: {in_packet} frames at a time on {threads} threads", scene.name);
            }
        }
    }
}
