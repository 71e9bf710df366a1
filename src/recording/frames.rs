//! The surfaces in a recording, read frame by frame, with only a few chunks in memory.

use std::{
    collections::{BTreeMap, HashMap, HashSet},
    path::PathBuf,
    sync::Arc,
};

use glam::{DQuat, DVec3, Quat, Vec3};

use super::{
    ReadError, Recorded,
    read::Reader,
    recorded::{cell, raw, step_of},
};
use crate::{
    analysis::Worst,
    geometry::{Mesh, Vectors},
    observe::{Frame, Instant, Schema},
    sdk::{
        Chunk, ComponentDescriptor, Ellipsoids3D, InstancePoses3D, Mesh3D, Scalars, Transform3D,
        datatypes::{Float64, Quaternion, UVec3D, Utf8, Vec3D},
    },
    stream::{
        contract::{BODY, BODY_SURFACE, DEFORMING, INFLUENCE, RESTING, STAGE, TIMING, VERTEX_BODY, path_of},
        recorder::DEFORMED,
    },
};

/// The stage that has a timing in every frame but the first: a frame is complete once it has a row for it.
const MARKER: &str = "observe";

/// The surface of a body in a recorded frame.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedSurface {
    /// Vertex positions [scene unit].
    pub positions: Vec<Vec3>,
    /// Triangles of a body that can tear; `None`: those of its shape.
    pub triangles: Option<Arc<[[u32; 3]]>>,
    /// How the surface was recorded.
    pub kind: SurfaceKind,
}

/// How a surface was recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SurfaceKind {
    /// Relative to the centre of the body, in body axes.
    Local,
    /// In world coordinates, in one mesh with other bodies.
    World,
    /// As an instance of its shape, in body axes: its displacement is too small to be drawn.
    Resting,
}

/// The recorded state of all bodies at one step.
#[derive(Clone, Debug)]
pub struct RecordedFrame {
    /// Step number.
    pub step: u64,
    /// Simulated time of the step [s].
    pub time: f64,
    /// Surfaces in the order of the scene; `None` if a surface is not recorded (yet).
    pub surfaces: Vec<Option<RecordedSurface>>,
    /// Centres of the bodies [scene unit].
    pub centres: Vec<Vec3>,
    /// Rotations of the bodies, from body axes to world axes; not updated for bodies in a mesh in world coordinates.
    pub rotations: Vec<Quat>,
}

impl RecordedFrame {
    /// Converts a frame to the precision of recordings.
    pub fn of(schema: &Schema, frame: &Frame) -> RecordedFrame {
        let mut positions = Vectors::default();
        let surfaces = schema.bodies.iter().zip(&frame.bodies).map(|(body, now)| {
            now.body_positions(now.rest_of(body), &mut positions);
            let positions = positions.iter().map(|position| position.as_vec3()).collect();
            let triangles = now.mesh.as_ref().map(|mesh| mesh.triangles().into());
            Some(RecordedSurface { positions, triangles, kind: SurfaceKind::Local })
        });
        let centres = frame.bodies.iter().map(|body| body.centre.as_vec3()).collect();
        let rotations = frame.bodies.iter().map(|body| body.rotation.as_quat()).collect();
        RecordedFrame { step: frame.at.step, time: frame.at.time, surfaces: surfaces.collect(), centres, rotations }
    }

    /// The worst vertex compared with another state at the same step, both in the precision of the recording; `None` if
    /// there is no difference or no surface.
    pub fn compare(&self, schema: &Schema, frame: &Frame) -> Option<Worst> {
        let mut local = Vectors::default();
        let mut worst = None;
        for (index, (body, now)) in schema.bodies.iter().zip(&frame.bodies).enumerate() {
            let Some(Some(surface)) = self.surfaces.get(index) else { continue };
            if surface.kind == SurfaceKind::Resting && now.max_displacement <= DEFORMED * body.radius {
                continue;
            }
            let here = if surface.kind == SurfaceKind::World {
                now.local_positions(now.rest_of(body), &mut local);
                let positions = surface.positions.iter().zip(local.iter()).map(|(&recorded, found)| {
                    let found = (found + now.centre).as_vec3();
                    (recorded.as_dvec3() - now.centre, found.as_dvec3() - now.centre)
                });
                Worst::of(self.at(), body, 0.0, positions)
            } else {
                now.body_positions(now.rest_of(body), &mut local);
                let shift = self.centres[index] - now.centre.as_vec3();
                let rotations = [self.rotations[index], now.rotation.as_quat()];
                let positions = surface.positions.iter().zip(local.iter()).map(|(&recorded, found)| {
                    let [recorded, found] = if rotations == [Quat::IDENTITY; 2] {
                        [recorded + shift, found.as_vec3()].map(|v| v.as_dvec3())
                    } else {
                        let [then, now] = rotations.map(|rotation| rotation.as_dquat());
                        [then * recorded.as_dvec3() + shift.as_dvec3(), now * found.as_vec3().as_dvec3()]
                    };
                    (recorded, found)
                });
                Worst::of(self.at(), body, 0.0, positions)
            };
            worst = Worst::and(worst, here);
        }
        worst
    }

    /// The instant of the frame.
    pub fn at(&self) -> Instant {
        Instant { step: self.step, time: self.time }
    }

    /// World positions of the vertices of a body [scene unit].
    pub fn world_positions(&self, body: usize) -> Option<Vec<DVec3>> {
        let surface = self.surfaces.get(body)?.as_ref()?;
        let centre = self.centres[body].as_dvec3();
        Some(match surface.kind {
            SurfaceKind::World => surface.positions.iter().map(|position| position.as_dvec3()).collect(),
            SurfaceKind::Local | SurfaceKind::Resting => {
                self.rotated(body, surface).map(|position| position + centre).collect()
            }
        })
    }

    /// Vertex positions of a body relative to its centre, in world axes [scene unit].
    pub fn local_positions(&self, body: usize) -> Option<Vec<DVec3>> {
        let surface = self.surfaces.get(body)?.as_ref()?;
        let centre = self.centres[body].as_dvec3();
        Some(match surface.kind {
            SurfaceKind::World => surface.positions.iter().map(|position| position.as_dvec3() - centre).collect(),
            SurfaceKind::Local | SurfaceKind::Resting => self.rotated(body, surface).collect(),
        })
    }

    /// Rotates the vertices of a surface from body axes to world axes.
    fn rotated<'a>(&self, body: usize, surface: &'a RecordedSurface) -> impl Iterator<Item = DVec3> + 'a {
        let rotation = self.rotations[body].as_dquat();
        surface.positions.iter().map(move |position| {
            let position = position.as_dvec3();
            if rotation == DQuat::IDENTITY { position } else { rotation * position }
        })
    }

    /// Rounding error of a body's surface relative to its centre due to how it was recorded: in single precision [scene unit].
    pub fn noise(&self, body: usize, radius: f64) -> f64 {
        let rounding = |far: f64| 2.0 * f64::from(f32::EPSILON) * far;
        match self.surfaces.get(body).and_then(Option::as_ref).map(|surface| surface.kind) {
            Some(SurfaceKind::World) => rounding(self.distance_of_centre(body) + 2.0 * radius),
            Some(SurfaceKind::Resting) => DEFORMED * radius,
            Some(SurfaceKind::Local) | None => rounding(2.0 * radius),
        }
    }

    /// The largest coordinate of a body's centre [scene unit], whose rounding error is that of the centre.
    pub fn distance_of_centre(&self, body: usize) -> f64 {
        f64::from(self.centres[body].abs().max_element())
    }
}

/// Reads frames one after the other.
pub struct FrameReader {
    reader: Reader,
    path: PathBuf,
    names: HashMap<String, usize>,
    shapes: HashMap<String, Arc<Mesh>>,
    schema: Schema,
    first: u64,
    /// Rows that do not belong to a frame yet, by step, in the order of the file.
    rows: BTreeMap<i64, Vec<(Arc<Chunk>, usize)>>,
    /// Steps with a row of [`MARKER`] whose other rows may still follow, and whether any have.
    marked: Vec<i64>,
    has_states: bool,
    next_chunk: Option<Chunk>,
    /// Steps of complete frames that have not been returned yet.
    ready: std::collections::VecDeque<i64>,
    surfaces: Vec<Option<RecordedSurface>>,
    /// The triangles of bodies that can tear.
    triangles: Vec<Option<Arc<[[u32; 3]]>>>,
    centres: Vec<Vec3>,
    rotations: Vec<Quat>,
    /// The instances of each shape, by entity.
    resting: HashMap<String, Vec<usize>>,
    /// Bodies in the shared mesh of deformed bodies, with the number of vertices of each.
    deforming: Vec<(usize, usize)>,
    has_first: bool,
    is_over: bool,
}

impl FrameReader {
    /// Opens a recording at its start.
    ///
    /// # Errors
    /// The recording cannot be read.
    pub fn open(recorded: &Recorded) -> Result<FrameReader, ReadError> {
        let schema = recorded.schema.clone();
        let names = schema.bodies.iter().enumerate().map(|(index, body)| (body.name.clone(), index)).collect();
        let shapes = schema.bodies.iter().map(|body| (RESTING.of(&[&body.shape]), Arc::clone(&body.mesh)));
        Ok(FrameReader {
            reader: Reader::of(recorded)?,
            path: recorded.path.clone(),
            names,
            shapes: shapes.collect(),
            first: recorded.first,
            rows: BTreeMap::new(),
            marked: Vec::new(),
            has_states: false,
            next_chunk: None,
            ready: std::collections::VecDeque::new(),
            surfaces: vec![None; schema.bodies.len()],
            triangles: vec![None; schema.bodies.len()],
            centres: vec![Vec3::ZERO; schema.bodies.len()],
            rotations: vec![Quat::IDENTITY; schema.bodies.len()],
            resting: HashMap::new(),
            deforming: Vec::new(),
            has_first: false,
            is_over: false,
            schema,
        })
    }

    /// Returns the next frame.
    ///
    /// # Errors
    /// The recording cannot be read.
    #[expect(clippy::should_implement_trait, reason = "it can fail")]
    pub fn next(&mut self) -> Result<Option<RecordedFrame>, ReadError> {
        loop {
            if let Some(step) = self.ready.pop_front() {
                let path = self.path.clone();
                self.apply(step).map_err(|what| ReadError::Damaged { path, at: None, what })?;
                let number = u64::try_from(step).unwrap_or(0);
                let (surfaces, centres, rotations) =
                    (self.surfaces.clone(), self.centres.clone(), self.rotations.clone());
                let time = number as f64 * self.schema.dt;
                return Ok(Some(RecordedFrame { step: number, time, surfaces, centres, rotations }));
            }
            if self.is_over {
                return Ok(None);
            }
            self.gather()?;
        }
    }

    /// Reads chunks until an entity repeats, and finds which frames are complete.
    fn gather(&mut self) -> Result<(), ReadError> {
        let path = self.path.clone();
        let damaged = |what| ReadError::Damaged { path: path.clone(), at: None, what };
        let (mut entities, mut complete) = (HashSet::new(), Vec::new());
        let marker = TIMING.of(&[MARKER]);
        let states = [&BODY, &BODY_SURFACE, &INFLUENCE, &DEFORMING, &RESTING];
        let is_wanted = |entity: &str| entity == marker || states.iter().any(|state| state.is(entity));
        loop {
            let chunk = match self.next_chunk.take() {
                Some(chunk) => chunk,
                None => match self.reader.next(is_wanted)? {
                    // stages inside a step are not frames
                    Some(chunk) if chunk.is_static() || chunk.timelines().keys().any(|name| name.as_str() == STAGE) => {
                        continue;
                    }
                    Some(chunk) => chunk,
                    None => {
                        self.is_over = true;
                        break;
                    }
                },
            };
            let entity = path_of(&chunk);
            if !entities.insert(entity.clone()) {
                // a second chunk of the same entity belongs to later frames
                self.next_chunk = Some(chunk);
                break;
            }
            let chunk = Arc::new(chunk);
            if entity != marker {
                self.has_states = true;
            } else if std::mem::take(&mut self.has_states) {
                complete.append(&mut self.marked);
            }
            for row in 0..chunk.num_rows() {
                let step = step_of(&chunk, row).map_err(damaged)?;
                if entity == marker {
                    // an empty row is a gap in the line, not a frame
                    if !cell::<Float64>(&chunk, &Scalars::descriptor_scalars(), row).is_empty() {
                        self.marked.push(step);
                    }
                } else {
                    self.rows.entry(step).or_default().push((Arc::clone(&chunk), row));
                }
            }
        }
        if self.is_over {
            complete.append(&mut self.marked);
        }
        let first = i64::try_from(self.first).unwrap_or(i64::MAX);
        // the first frame has no timings of its own: it is complete when another frame is
        if !self.has_first && (self.is_over || !complete.is_empty()) {
            self.has_first = true;
            self.ready.extend(self.rows.contains_key(&first).then_some(first));
        }
        complete.sort_unstable();
        self.ready.extend(complete.into_iter().filter(|&step| step > first));
        Ok(())
    }

    /// Applies the rows up to `step`.
    fn apply(&mut self, step: i64) -> Result<(), String> {
        while let Some(entry) = self.rows.first_entry().filter(|entry| *entry.key() <= step) {
            let rows = entry.remove();
            // the bodies of a mesh must be known before its vertex positions
            for pass in [true, false] {
                for (chunk, row) in &rows {
                    self.apply_row(chunk, *row, pass)?;
                }
            }
        }
        Ok(())
    }

    /// Removes the copies with which faces are drawn flat.
    fn without_copies(&self, body: usize, positions: &mut Vec<Vec3>) {
        let mesh = &self.schema.bodies[body].mesh;
        if mesh.facets().is_some() {
            positions.truncate(mesh.vertex_count());
        }
    }

    fn apply_row(&mut self, chunk: &Chunk, row: usize, is_naming_pass: bool) -> Result<(), String> {
        let entity = path_of(chunk);
        let vectors = |component: &ComponentDescriptor| -> Vec<Vec3> {
            cell::<Vec3D>(chunk, component, row).into_iter().map(|v| Vec3::from(v.0)).collect()
        };
        let quaternions = |component: &ComponentDescriptor| -> Vec<Quat> {
            cell::<Quaternion>(chunk, component, row).into_iter().map(|q| Quat::from_array(q.0)).collect()
        };
        let bodies = || -> Result<Vec<usize>, String> {
            let names = cell::<Utf8>(chunk, &VERTEX_BODY.descriptor(), row);
            let index = |name: &Utf8| self.names.get(name.as_str()).copied();
            names
                .iter()
                .map(|name| index(name).ok_or_else(|| format!("{entity} has an unknown body {:?}", name.as_str())))
                .collect()
        };
        let index_of = |names: &[&str]| {
            let index = names.first().and_then(|&name| self.names.get(name).copied());
            index.ok_or_else(|| format!("{entity} is not a body of its scene"))
        };
        if let Some(names) = BODY.names(&entity) {
            if !is_naming_pass && let Some(&rotation) = quaternions(&Transform3D::descriptor_quaternion()).first() {
                self.rotations[index_of(&names)?] = rotation;
            }
        } else if let Some(names) = BODY_SURFACE.names(&entity) {
            if !is_naming_pass {
                let index = index_of(&names)?;
                let mut positions = vectors(&Mesh3D::descriptor_vertex_positions());
                self.without_copies(index, &mut positions);
                let triangles = cell::<UVec3D>(chunk, &Mesh3D::descriptor_triangle_indices(), row);
                let triangles: Vec<[u32; 3]> = triangles.into_iter().map(|triangle| triangle.0).collect();
                if !triangles.is_empty() {
                    self.triangles[index] = Some(triangles.into());
                }
                let surface = &mut self.surfaces[index];
                if !positions.is_empty() {
                    *surface = Some(RecordedSurface { positions, triangles: None, kind: SurfaceKind::Local });
                }
                if let Some(surface) = surface {
                    surface.triangles.clone_from(&self.triangles[index]);
                }
            }
        } else if INFLUENCE.is(&entity) {
            if !is_naming_pass {
                let centres = vectors(&Ellipsoids3D::descriptor_centers());
                self.centres.iter_mut().zip(centres).for_each(|(centre, now)| *centre = now);
            }
        } else if DEFORMING.is(&entity) {
            if is_naming_pass {
                if raw(chunk, &VERTEX_BODY.descriptor(), row).is_some() {
                    let vertices = bodies()?;
                    let runs = vertices.chunk_by(|a, b| a == b);
                    let deforming = runs.filter_map(|run| run.first().map(|&body| (body, run.len()))).collect();
                    self.deforming = deforming;
                }
            } else {
                let positions = vectors(&Mesh3D::descriptor_vertex_positions());
                let mut rest = positions.as_slice();
                for (body, count) in self.deforming.clone() {
                    let Some((own, others)) = rest.split_at_checked(count) else { break };
                    rest = others;
                    let (mut positions, triangles) = (own.to_vec(), None);
                    self.without_copies(body, &mut positions);
                    self.surfaces[body] = Some(RecordedSurface { positions, triangles, kind: SurfaceKind::World });
                }
            }
        } else if let Some(mesh) = self.shapes.get(&entity) {
            // the influence spheres give the positions; only the identity and rotation of the bodies matter here
            if !is_naming_pass {
                let rotations = quaternions(&InstancePoses3D::descriptor_quaternions());
                let bodies = self.resting.get(&entity).map(Vec::as_slice).unwrap_or_default();
                bodies.iter().zip(rotations).for_each(|(&body, rotation)| self.rotations[body] = rotation);
                // an absent body has no extent
                for (&body, scale) in bodies.iter().zip(vectors(&InstancePoses3D::descriptor_scales())) {
                    let Some(surface) = &mut self.surfaces[body] else { continue };
                    let was_absent = surface.positions.iter().all(|position| *position == Vec3::ZERO);
                    if was_absent != (scale == Vec3::ZERO) {
                        let rest = mesh.at(if was_absent { self.schema.bodies[body].radius } else { 0.0 });
                        surface.positions = (0..rest.len()).map(|i| rest.position(i).as_vec3()).collect();
                    }
                }
            } else if raw(chunk, &VERTEX_BODY.descriptor(), row).is_some() {
                let resting = bodies()?;
                let surface = |body: usize| {
                    let rest = mesh.at(self.schema.bodies[body].radius);
                    (0..rest.len()).map(|i| rest.position(i).as_vec3()).collect::<Vec<_>>()
                };
                let surfaces: Vec<_> = resting.iter().map(|&body| (body, surface(body))).collect();
                for (body, positions) in surfaces {
                    self.surfaces[body] =
                        Some(RecordedSurface { positions, triangles: None, kind: SurfaceKind::Resting });
                }
                self.resting.insert(entity, resting);
            }
        }
        Ok(())
    }
}
