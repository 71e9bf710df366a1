//! The surfaces in a recording, frame by frame, in the memory of a few chunks.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::path::PathBuf;
use std::sync::Arc;

use glam::{DVec3, Vec3};
use rerun::{
    datatypes::{Float64, Utf8, Vec3D},
    external::re_chunk_store::external::re_chunk::Chunk,
};

use super::{
    ReadError, Recorded,
    read::Reader,
    recorded::{cell, step_of},
};
use crate::{
    geometry::Mesh,
    scene::Scene,
    sim::World,
    stream::recorder::{DEFORMED, resting_entity},
};

/// Logged with every frame but the first: a frame is complete when the line of its stages is there.
const MARKER: &str = "/timings/integrate";

/// The surface of a body in a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Surface {
    /// Of the vertices [scene unit].
    pub positions: Vec<Vec3>,
    /// How they were recorded.
    pub kind: Kind,
}

/// How a surface was recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Relative to the centre.
    Local,
    /// In the world, with those of other bodies.
    World,
    /// As an instance of its shape, relative to the centre: displaced by less than is drawn.
    Resting,
}

/// All bodies at one step.
#[derive(Clone, Debug)]
pub struct Frame {
    /// The step.
    pub step: u64,
    /// Its time [s].
    pub time: f64,
    /// By the order of the scene; `None`: not recorded (yet).
    pub surfaces: Vec<Option<Surface>>,
    /// Recorded centres [scene unit]; `None`: not recorded apart.
    pub centres: Vec<Option<Vec3>>,
}

/// The vertex at which two states differ most.
#[derive(Clone, Debug, PartialEq)]
pub struct Worst {
    /// The step.
    pub step: u64,
    /// Its time [s].
    pub time: f64,
    /// Name of the body.
    pub body: String,
    /// The vertex.
    pub vertex: usize,
    /// Where it was recorded, from the centre of its body [scene unit].
    pub recorded: DVec3,
    /// Where it is now [scene unit].
    pub found: DVec3,
    /// How far these are apart [radii of the body].
    pub difference: f64,
    /// How many vertices differ at all.
    pub vertices: usize,
}

impl Frame {
    /// The worst vertex beside a world at the same step, both in the precision of the recording; `None` without surfaces.
    pub fn compare(&self, world: &World) -> Option<Worst> {
        let mut worst: Option<Worst> = None;
        let mut vertices = 0;
        for ((body, surface), centre) in world.bodies().zip(&self.surfaces).zip(&self.centres) {
            let Some(surface) = surface else { continue };
            if surface.kind == Kind::Resting && body.max_displacement() <= DEFORMED * body.scene().radius {
                continue;
            }
            let origin = if surface.kind == Kind::World { body.centre() } else { DVec3::ZERO };
            let shift = centre.map_or(Vec3::ZERO, |centre| centre - body.centre().as_vec3());
            for (vertex, &recorded) in surface.positions.iter().enumerate().take(body.vertex_count()) {
                let found = (body.local_position(vertex) + origin).as_vec3();
                if found == recorded && shift == Vec3::ZERO {
                    continue;
                }
                vertices += 1;
                let difference = f64::from((recorded - found + shift).length()) / body.scene().radius;
                if worst.as_ref().is_none_or(|worst| !(difference <= worst.difference)) {
                    worst = Some(Worst {
                        step: self.step,
                        time: self.time,
                        body: body.name().to_owned(),
                        vertex,
                        recorded: recorded.as_dvec3() - origin + shift.as_dvec3(),
                        found: found.as_dvec3() - origin,
                        difference,
                        vertices: 0,
                    });
                }
            }
        }
        worst.map(|worst| Worst { vertices, ..worst })
    }

    /// Where the vertices of a body are in the world [scene unit].
    pub fn world_positions(&self, scene: &Scene, body: usize) -> Option<Vec<DVec3>> {
        let surface = self.surfaces.get(body)?.as_ref()?;
        let origin = match (surface.kind, self.centres.get(body).copied().flatten()) {
            (Kind::World, _) => DVec3::ZERO,
            (_, Some(centre)) => centre.as_dvec3(),
            (_, None) => scene.bodies[body].path.position(self.time),
        };
        Some(surface.positions.iter().map(|position| position.as_dvec3() + origin).collect())
    }
}

/// Reads frames one after the other.
pub struct Frames {
    reader: Reader,
    path: PathBuf,
    names: HashMap<String, usize>,
    shapes: HashMap<String, Arc<Mesh>>,
    scene: Scene,
    first: u64,
    /// Chunks that are not in frames yet; an entity that comes a second time belongs to later frames.
    pending: Vec<Chunk>,
    entities: HashSet<String>,
    /// Rows of `pending` by step, and the steps that are frames.
    rows: BTreeMap<i64, Vec<(usize, usize)>>,
    marked: Vec<i64>,
    next_chunk: Option<Chunk>,
    /// Complete frames to be given, as steps.
    ready: std::collections::VecDeque<i64>,
    surfaces: Vec<Option<Surface>>,
    centres: Vec<Option<Vec3>>,
    /// Who is in the one mesh of deformed bodies, and how many vertices of each.
    deforming: Vec<(usize, usize)>,
    has_given: bool,
    is_over: bool,
}

impl Frames {
    /// From the start of a recording.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn open(recorded: &Recorded) -> Result<Frames, ReadError> {
        let scene = recorded.scene.clone();
        let names = scene.bodies.iter().enumerate().map(|(index, body)| (body.name.clone(), index)).collect();
        let shapes = scene.bodies.iter().map(|body| (resting_entity(&body.shape), body.shape.mesh()));
        Ok(Frames {
            reader: Reader::open(&recorded.path)?,
            path: recorded.path.clone(),
            names,
            shapes: shapes.collect(),
            first: recorded.first,
            pending: Vec::new(),
            entities: HashSet::new(),
            rows: BTreeMap::new(),
            marked: Vec::new(),
            next_chunk: None,
            ready: std::collections::VecDeque::new(),
            surfaces: vec![None; scene.bodies.len()],
            centres: vec![None; scene.bodies.len()],
            deforming: Vec::new(),
            has_given: false,
            is_over: false,
            scene,
        })
    }

    /// The next frame.
    ///
    /// # Errors
    /// The recording cannot be read.
    #[expect(clippy::should_implement_trait, reason = "it can fail")]
    pub fn next(&mut self) -> Result<Option<Frame>, ReadError> {
        loop {
            if let Some(step) = self.ready.pop_front() {
                let path = self.path.clone();
                self.apply(step).map_err(|what| ReadError::Damaged { path, at: None, what })?;
                let number = u64::try_from(step).unwrap_or(0);
                let (surfaces, centres) = (self.surfaces.clone(), self.centres.clone());
                return Ok(Some(Frame { step: number, time: number as f64 * self.scene.dt, surfaces, centres }));
            }
            if self.is_over {
                return Ok(None);
            }
            self.gather()?;
        }
    }

    /// Reads chunks until an entity comes again, and finds out which frames are complete.
    fn gather(&mut self) -> Result<(), ReadError> {
        let path = self.path.clone();
        let damaged = |what| ReadError::Damaged { path: path.clone(), at: None, what };
        // what is left of older chunks are rows of frames that were not complete
        let left: Vec<(i64, usize, usize)> = self
            .rows
            .iter()
            .flat_map(|(&step, rows)| rows.iter().map(move |&(chunk, row)| (step, chunk, row)))
            .collect();
        let mut kept: Vec<Chunk> = Vec::new();
        let mut places: HashMap<usize, usize> = HashMap::new();
        self.rows.clear();
        for (step, chunk, row) in left {
            let place = *places.entry(chunk).or_insert_with(|| {
                kept.push(self.pending[chunk].clone());
                kept.len() - 1
            });
            self.rows.entry(step).or_default().push((place, row));
        }
        self.pending = kept;
        self.entities.clear();

        let is_wanted =
            |entity: &str| entity == MARKER || (entity.starts_with("/world/") && !entity.starts_with("/world/forces/"));
        loop {
            let chunk = match self.next_chunk.take() {
                Some(chunk) => chunk,
                None => match self.reader.next(is_wanted)? {
                    Some(chunk) if chunk.is_static() => continue,
                    Some(chunk) => chunk,
                    None => {
                        self.is_over = true;
                        break;
                    }
                },
            };
            let entity = chunk.entity_path().to_string();
            if !self.entities.insert(entity.clone()) {
                self.next_chunk = Some(chunk);
                break;
            }
            for row in 0..chunk.num_rows() {
                let step = step_of(&chunk, row).map_err(damaged)?;
                if entity == MARKER {
                    // where a line has a gap there is no frame
                    if !cell::<Float64>(&chunk, "Scalars:scalars", row).is_empty() {
                        self.marked.push(step);
                    }
                } else {
                    self.rows.entry(step).or_default().push((self.pending.len(), row));
                }
            }
            self.pending.push(chunk);
        }
        let first = i64::try_from(self.first).unwrap_or(i64::MAX);
        // the first frame has no line of its own: it is complete when another is
        if !self.has_given && (self.is_over || !self.marked.is_empty()) {
            self.has_given = true;
            self.ready.extend(self.rows.contains_key(&first).then_some(first));
        }
        self.marked.sort_unstable();
        self.ready.extend(self.marked.drain(..).filter(|&step| step > first));
        Ok(())
    }

    /// Brings the surfaces to what was recorded up to `step`.
    fn apply(&mut self, step: i64) -> Result<(), String> {
        while let Some((&at, _)) = self.rows.first_key_value().filter(|(at, _)| **at <= step) {
            let Some(mut rows) = self.rows.remove(&at) else { break };
            // who is in a mesh comes before where its vertices are
            rows.sort_unstable();
            for pass in [true, false] {
                for &(chunk, row) in &rows {
                    self.apply_row(chunk, row, pass)?;
                }
            }
        }
        Ok(())
    }

    fn apply_row(&mut self, chunk: usize, row: usize, is_naming: bool) -> Result<(), String> {
        let Some(chunk) = self.pending.get(chunk) else { return Ok(()) };
        let entity = chunk.entity_path().to_string();
        let vectors = |component| -> Vec<Vec3> {
            cell::<Vec3D>(chunk, component, row).into_iter().map(|v| Vec3::from(v.0)).collect()
        };
        let bodies = || -> Result<Vec<usize>, String> {
            let names = cell::<Utf8>(chunk, "body", row);
            let index = |name: &Utf8| self.names.get(name.as_str()).copied();
            names
                .iter()
                .map(|name| index(name).ok_or_else(|| format!("{entity} has a body {:?}", name.as_str())))
                .collect()
        };
        if let Some(rest) = entity.strip_prefix("/world/bodies/") {
            if is_naming {
                return Ok(());
            }
            let (name, is_surface) = match rest.strip_suffix("/surface") {
                Some(name) => (name, true),
                None => (rest, false),
            };
            let index = *self.names.get(name).ok_or_else(|| format!("{entity} is no body of its scene"))?;
            if is_surface {
                let positions = vectors("Mesh3D:vertex_positions");
                if !positions.is_empty() {
                    self.surfaces[index] = Some(Surface { positions, kind: Kind::Local });
                }
            } else if let Some(&centre) = vectors("Transform3D:translation").first() {
                self.centres[index] = Some(centre);
            }
        } else if entity == "/world/deforming/surface" {
            if is_naming {
                if super::recorded::raw(chunk, "body", row).is_some() {
                    let vertices = bodies()?;
                    let runs = vertices.chunk_by(|a, b| a == b);
                    let deforming = runs.filter_map(|run| run.first().map(|&body| (body, run.len()))).collect();
                    self.deforming = deforming;
                }
            } else {
                let positions = vectors("Mesh3D:vertex_positions");
                let mut rest = positions.as_slice();
                for (body, count) in self.deforming.clone() {
                    let Some((own, others)) = rest.split_at_checked(count) else { break };
                    rest = others;
                    self.surfaces[body] = Some(Surface { positions: own.to_vec(), kind: Kind::World });
                    self.centres[body] = None;
                }
            }
        } else if let Some(mesh) = self.shapes.get(&entity) {
            // where they are is known from their paths; who they are is what counts
            if is_naming && super::recorded::raw(chunk, "body", row).is_some() {
                let resting = bodies()?;
                let surface = |body: usize| {
                    let rest = mesh.at(self.scene.bodies[body].radius);
                    (0..rest.len()).map(|i| rest.position(i).as_vec3()).collect::<Vec<_>>()
                };
                let surfaces: Vec<_> = resting.iter().map(|&body| (body, surface(body))).collect();
                for (body, positions) in surfaces {
                    self.surfaces[body] = Some(Surface { positions, kind: Kind::Resting });
                    self.centres[body] = None;
                }
            }
        }
        Ok(())
    }
}
