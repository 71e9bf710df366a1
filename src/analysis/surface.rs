//! The merged surface of a frame: one closed mesh for every group of bodies, and geometric measures of pairs.
//!
//! A group is a set of at least two bodies connected by pairs in a joined phase
//! ([`PhaseSchema::is_joined`](crate::observe::schema::PhaseSchema::is_joined)). Everything here is a function of a frame, so a
//! simulation needs no support for it, and does not pay for it unless frames are recorded.
//!
//! # Cost per frame
//! Single bodies and pairs out of reach cost nothing. For a pair within reach that a plane separates, only the gap is
//! computed, starting from the nearest triangles of the last frame. For a group, the union, the smooth seam, and the
//! gap, overlap and neck of its pairs are computed in every recorded frame: a surface drawn less often would disagree
//! with the bodies, spheres and plots of its frame. For two spheres, this takes tenths of a millisecond, more than the
//! rest of the frame. To record faster, record every Nth frame (`--every N`) or none (`--thin`), and replay the steps
//! of interest.

use std::{
    collections::BTreeMap,
    mem::replace,
    sync::{Arc, OnceLock, atomic::AtomicBool},
};

use glam::DVec3;

use crate::{
    disjoint_sets::DisjointSets,
    geometry::{
        Facets, Mesh, Vectors,
        fairing::Seamed,
        union::{self, Body, Budget, Hint, Origin, Topology, Union},
    },
    interrupt::is_raised,
    observe::{
        Frame, PairFrame, Schema,
        surface::{Group, PairMeasures, SeamLine, Surfaced, Surfaces, VertexOrigin},
    },
    parallel,
};

/// Budget of work steps for the unions of one frame, see [`Budget`]: an estimated one to three seconds. It is a count
/// instead of a time so that equal frames give equal surfaces on every machine.
pub const FRAME_WORK: u64 = 20_000_000;

/// Distance from a seam within which the colours of two bodies blend [radii], unless smoothing reaches farther.
const COLORS_BLEND: f64 = 0.35;

/// The merged surfaces of a frame, and the measures of the requested pairs. Reused.
#[derive(Clone, Debug, Default)]
pub struct Merged {
    /// The groups with a surface, in ascending order of their first body.
    pub groups: Vec<Arc<Group>>,
    /// Measures of pairs, in the order of the request; `None` if they could not be computed.
    pub pairs: Vec<Option<PairMeasures>>,
    /// Whether the surface of each body is part of a group's, `[body_count]`.
    pub is_merged: Vec<bool>,
    /// Number of groups whose surface was too expensive or failed: their bodies are drawn overlapping.
    pub overlapping: usize,
}

/// The shapes of a scene's bodies as closed meshes.
pub struct Closed {
    shapes: Vec<ClosedShape>,
    /// Index of each body's shape.
    of_body: Vec<usize>,
    /// Current meshes of bodies that have torn.
    torn: BTreeMap<usize, ClosedShape>,
    interrupt: Option<&'static AtomicBool>,
}

struct ClosedShape {
    mesh: Arc<Mesh>,
    /// Computed on demand; `None` if the shape is not a closed mesh.
    topology: OnceLock<Option<Topology>>,
    /// That of the mesh turned inside out.
    reversed: OnceLock<Option<Topology>>,
}

impl ClosedShape {
    fn new(mesh: &Arc<Mesh>) -> ClosedShape {
        ClosedShape { mesh: Arc::clone(mesh), topology: OnceLock::new(), reversed: OnceLock::new() }
    }
}

impl Closed {
    /// The shapes of a simulation's bodies.
    pub fn new(schema: &Schema, interrupt: Option<&'static AtomicBool>) -> Closed {
        let (mut shapes, mut of_body) = (Vec::<ClosedShape>::new(), Vec::new());
        for body in &schema.bodies {
            let known = shapes.iter().position(|shape| Arc::ptr_eq(&shape.mesh, &body.mesh));
            of_body.push(known.unwrap_or(shapes.len()));
            if known.is_none() {
                shapes.push(ClosedShape::new(&body.mesh));
            }
        }
        Closed { shapes, of_body, torn: BTreeMap::new(), interrupt }
    }

    /// Sets the current mesh of a body (`None`: the schema's); returns whether it has changed.
    pub fn tear(&mut self, body: usize, mesh: Option<&Arc<Mesh>>) -> bool {
        let known = self.torn.get(&body).map(|torn| &torn.mesh);
        let is_same = match (known, mesh) {
            (None, None) => true,
            (Some(known), Some(mesh)) => Arc::ptr_eq(known, mesh),
            _ => false,
        };
        if !is_same {
            match mesh {
                Some(mesh) => self.torn.insert(body, ClosedShape::new(mesh)),
                None => self.torn.remove(&body),
            };
        }
        !is_same
    }

    /// A body with its vertices at these positions [scene unit]; `None` if it is not closed, if its coordinates are out
    /// of range, or after an interrupt. What a body encloses that is inside out is solid, too.
    pub fn body<'a>(&'a self, index: usize, positions: &'a [DVec3]) -> Option<Body<'a>> {
        let body = Body::new(self.topology(index, false)?, positions).ok()?;
        if body.is_inside_out() { Body::new(self.topology(index, true)?, positions).ok() } else { Some(body) }
    }

    /// The measures of a pair whose vertices are at these positions [scene unit]; `None` if they cannot be computed.
    pub fn measure(&self, schema: &Schema, pair: [usize; 2], positions: [&[DVec3]; 2]) -> Option<PairMeasures> {
        let [a, b] = [0, 1].map(|k| self.body(pair[k], positions[k]));
        let budget = Budget { work: FRAME_WORK, interrupt: self.interrupt };
        measures(schema, pair, [&a?, &b?], &budget, &mut Hint::default())
    }

    fn topology(&self, body: usize, is_reversed: bool) -> Option<&Topology> {
        let own = || self.shapes.get(*self.of_body.get(body)?);
        let ClosedShape { mesh, topology, reversed } = self.torn.get(&body).or_else(own)?;
        if is_raised(self.interrupt) {
            return None;
        }
        // an interrupted (`None`) topology is never needed again
        let compute =
            |triangles: &[[u32; 3]]| Topology::interruptible(mesh.vertex_count(), triangles, self.interrupt).ok();
        if !is_reversed {
            return topology.get_or_init(|| compute(mesh.triangles())).as_ref();
        }
        let turn = || mesh.triangles().iter().map(|&[a, b, c]| [a, c, b]).collect::<Vec<_>>();
        reversed.get_or_init(|| compute(&turn())).as_ref()
    }
}

/// Computes the merged surfaces of successive frames. Reuses the results for bodies that do not move.
pub struct Merger {
    closed: Closed,
    bodies: Vec<Placed>,
    /// The groups of the last frame; `None` for a group without a surface.
    groups: BTreeMap<Vec<usize>, Option<Arc<Group>>>,
    /// The measures of the last frame.
    pairs: BTreeMap<[usize; 2], Measured>,
    merged: Merged,
    /// Number of the current frame, from 1.
    frame: u64,
    /// Work steps that the unions of a frame may take.
    work: u64,
    /// Number of groups and of pairs among which the last frame divided it.
    shares: [usize; 2],
    /// Scratch storage, reused.
    local: Vectors,
}

/// The measures of a pair.
#[derive(Clone, Copy, Default)]
struct Measured {
    measures: Option<PairMeasures>,
    /// The nearest triangles.
    hint: Hint,
    /// Whether they follow from the union of more bodies: rounding depends on all of these.
    is_of_group: bool,
}

/// A body in the world.
#[derive(Default)]
struct Placed {
    positions: Vec<DVec3>,
    /// Number of the frame of these positions; 0 for none.
    frame: u64,
    /// Whether the positions differ from those of the previous frame, or may differ.
    has_moved: bool,
}

impl Merger {
    /// Creates a merger for the frames of a simulation. Once the flag is raised, nothing more is computed.
    pub fn new(schema: &Schema, interrupt: Option<&'static AtomicBool>) -> Merger {
        Merger {
            closed: Closed::new(schema, interrupt),
            bodies: schema.bodies.iter().map(|_| Placed::default()).collect(),
            groups: BTreeMap::new(),
            pairs: BTreeMap::new(),
            merged: Merged::default(),
            frame: 0,
            work: FRAME_WORK,
            shares: [0; 2],
            local: Vectors::default(),
        }
    }

    /// Computes the surfaces of a frame's groups, and the measures of some pairs.
    pub fn merge(&mut self, schema: &Schema, frame: &Frame, pairs: &[[usize; 2]]) -> &Merged {
        if let Some(own) = schema.surfaces.get() {
            return self.merge_own(own, schema, frame, pairs);
        }
        self.merge_groups(&groups(schema, frame), schema, frame, pairs)
    }

    /// The measures of some pairs alone, in their order; `None` if they could not be computed.
    pub fn measure(&mut self, schema: &Schema, frame: &Frame, pairs: &[[usize; 2]]) -> &[Option<PairMeasures>] {
        match schema.surfaces.get() {
            Some(own) => {
                let interrupt = self.closed.interrupt;
                self.merged.pairs = pairs.iter().map(|&pair| own.measure(schema, frame, pair, interrupt)).collect();
                &self.merged.pairs
            }
            None => &self.merge_groups(&[], schema, frame, pairs).pairs,
        }
    }

    fn merge_groups(&mut self, groups: &[Vec<usize>], schema: &Schema, frame: &Frame, pairs: &[[usize; 2]]) -> &Merged {
        self.frame += 1;
        for &body in groups.iter().flatten().chain(pairs.iter().flatten()) {
            self.place(schema, frame, body);
        }
        let Merger { closed, bodies, groups: last_groups, pairs: last_pairs, merged, work, shares, .. } = self;
        let involved = groups.iter().flatten().chain(pairs.iter().flatten());
        let built = involved.map(|&body| (body, OnceLock::new())).collect();
        let scene = Scene { schema, closed, bodies, built: &built };

        let interrupt = closed.interrupt;
        let budget = Budget { work: *work / groups.len().max(1) as u64, interrupt };
        let hint_of = |pair: &[usize; 2]| last_pairs.get(pair).map_or(Hint::default(), |known| known.hint);
        let has_moved = |of: &[usize]| of.iter().any(|&body| bodies[body].has_moved);
        // what was given up may be possible with another budget
        let now = [groups.len(), pairs.len()];
        let is_same_budget = replace(shares, now) == now;
        let known = |pair: &[usize; 2]| last_pairs.get(pair).filter(|known| is_same_budget || known.measures.is_some());
        let united: Vec<(_, Vec<_>)> = for_all(groups, |group| {
            let asked = pairs.iter().copied().filter(|pair| pair.iter().all(|body| group.binary_search(body).is_ok()));
            let known = asked.clone().map(|pair| Some((pair, *known(&pair)?))).collect();
            match (last_groups.get(group), known) {
                (Some(last), Some(known)) if !has_moved(group) && (is_same_budget || last.is_some()) => {
                    (last.clone(), known)
                }
                _ => {
                    let (group, measured) = scene.unite(group, &budget, asked, hint_of);
                    (group.map(Arc::new), measured)
                }
            }
        });
        let of_groups: BTreeMap<[usize; 2], Measured> =
            united.iter().flat_map(|(_, measured)| measured).copied().collect();
        let budget = Budget { work: *work / pairs.len().max(1) as u64, interrupt };
        let measured = for_all(pairs, |pair| {
            if let Some(measured) = of_groups.get(pair) {
                return *measured;
            }
            match known(pair) {
                Some(known) if !known.is_of_group && !has_moved(pair) => *known,
                _ => scene.measure(*pair, &budget, hint_of(pair)),
            }
        });
        merged.pairs.clear();
        merged.pairs.extend(measured.iter().map(|measured| measured.measures));
        *last_pairs = pairs.iter().copied().zip(measured).collect();

        merged.groups.clear();
        merged.overlapping = 0;
        merged.is_merged.clear();
        merged.is_merged.resize(schema.bodies.len(), false);
        for (group, _) in &united {
            let Some(group) = group else {
                merged.overlapping += 1;
                continue;
            };
            group.bodies.iter().for_each(|&body| merged.is_merged[body] = true);
            merged.groups.push(Arc::clone(group));
        }
        *last_groups = groups.iter().cloned().zip(united.into_iter().map(|(group, _)| group)).collect();
        &self.merged
    }

    /// Like [`Merger::merge`], with surfaces defined by the simulation. Unchanged surfaces remain the same object.
    fn merge_own(&mut self, own: &dyn Surfaces, schema: &Schema, frame: &Frame, pairs: &[[usize; 2]]) -> &Merged {
        let Surfaced { groups, pairs } = own.merge(schema, frame, pairs, self.closed.interrupt);
        let merged = &mut self.merged;
        merged.pairs = pairs;
        merged.is_merged.clear();
        merged.is_merged.resize(schema.bodies.len(), false);
        merged.overlapping = groups.iter().filter(|group| group.is_none()).count();
        let last = std::mem::take(&mut merged.groups);
        // another program's groups may be wrong
        let is_valid = |of: &Group| !of.bodies.is_empty() && of.bodies.iter().all(|&body| body < schema.bodies.len());
        for group in groups.into_iter().flatten().filter(is_valid) {
            group.bodies.iter().for_each(|&body| merged.is_merged[body] = true);
            merged.groups.push(last.iter().find(|known| ***known == group).cloned().unwrap_or_else(|| Arc::new(group)));
        }
        &self.merged
    }

    /// The result of the last frame.
    pub fn merged(&self) -> &Merged {
        &self.merged
    }

    /// Updates the positions of a body to those of a frame.
    fn place(&mut self, schema: &Schema, frame: &Frame, body: usize) {
        let placed = &mut self.bodies[body];
        if placed.frame == self.frame {
            return;
        }
        let now = &frame.bodies[body];
        let has_torn = self.closed.tear(body, now.mesh.as_ref());
        now.local_positions(now.rest_of(&schema.bodies[body]), &mut self.local);
        let bits = |position: DVec3| position.to_array().map(f64::to_bits);
        let is_same = placed.positions.len() == self.local.len()
            && (placed.positions.iter().zip(self.local.iter())).all(|(old, new)| bits(*old) == bits(new + now.centre));
        placed.has_moved = !is_same || has_torn || placed.frame + 1 != self.frame;
        placed.frame = self.frame;
        if !is_same {
            placed.positions.clear();
            placed.positions.extend(self.local.iter().map(|position| position + now.centre));
        }
    }
}

/// The bodies of a frame, ready to be united.
#[derive(Clone, Copy)]
struct Scene<'s, 'a> {
    schema: &'a Schema,
    closed: &'a Closed,
    bodies: &'a [Placed],
    /// Bodies as input of a union, built when one is needed: several pairs may share a body.
    built: &'s BTreeMap<usize, OnceLock<Option<Body<'a>>>>,
}

impl<'s, 'a> Scene<'s, 'a> {
    /// A body as input of a union; `None` if it is not closed, or its coordinates are out of range.
    fn body(self, index: usize) -> Option<&'s Body<'a>> {
        let body = || self.closed.body(index, &self.bodies[index].positions);
        self.built.get(&index)?.get_or_init(body).as_ref()
    }

    /// Bodies as input of a union; `None` if one of them is not closed, or its coordinates are out of range.
    fn bodies(self, indices: &[usize]) -> Option<Vec<Body<'a>>> {
        indices.iter().map(|&index| self.body(index).cloned()).collect()
    }

    /// The surface of a group, and the measures of those of the `asked` pairs in it that follow from its union.
    fn unite(
        self,
        group: &[usize],
        budget: &Budget,
        asked: impl Iterator<Item = [usize; 2]>,
        hint_of: impl Fn(&[usize; 2]) -> Hint,
    ) -> (Option<Group>, Vec<([usize; 2], Measured)>) {
        let Some(bodies) = self.bodies(group) else { return (None, Vec::new()) };
        let of_pair = |pair: [usize; 2]| pair.map(|body| group.partition_point(|&other| other < body));
        let is_meeting = |&[a, b]: &[usize; 2]| !union::are_apart(&bodies[a], &bodies[b]);
        let pairs: Vec<[usize; 2]> = asked.map(of_pair).filter(|pair| group.len() == 2 || is_meeting(pair)).collect();
        let Ok((united, of_pairs)) = union::union_and_pairs(&bodies, &pairs, budget) else {
            return (None, Vec::new());
        };
        let measure = |pair: [usize; 2], united: &Union| {
            let named = pair.map(|body| group[body]);
            let mut hint = hint_of(&named);
            let measures = measures_of(self.schema, named, united, pair, budget, &mut hint);
            (named, Measured { measures, hint, is_of_group: group.len() > 2 })
        };
        let measured = match group.len() {
            2 => pairs.iter().map(|&pair| measure(pair, &united)).collect(),
            _ => of_pairs.iter().map(|(pair, united)| measure(*pair, united)).collect(),
        };
        (Group::new(self.schema, group, &united, budget.interrupt), measured)
    }

    /// The measures of a pair by itself.
    fn measure(self, pair: [usize; 2], budget: &Budget, mut hint: Hint) -> Measured {
        let bodies = self.body(pair[0]).zip(self.body(pair[1]));
        let measures = bodies.and_then(|(a, b)| measures(self.schema, pair, [a, b], budget, &mut hint));
        Measured { measures, hint, is_of_group: false }
    }
}

/// The measures of a pair whose bodies are these; updates the nearest triangles.
fn measures(
    schema: &Schema,
    pair: [usize; 2],
    [a, b]: [&Body; 2],
    budget: &Budget,
    hint: &mut Hint,
) -> Option<PairMeasures> {
    match union::measures_apart(a, b, budget, hint).ok()? {
        Some(apart) => in_radii(schema, pair, &apart, [a, b]),
        None => {
            let bodies = [a.clone(), b.clone()];
            measures_of(schema, pair, &union::union(&bodies, budget).ok()?, [0, 1], budget, hint)
        }
    }
}

/// The measures of a pair of which this is the union, with the indices `of` its bodies there.
fn measures_of(
    schema: &Schema,
    pair: [usize; 2],
    united: &Union,
    of: [usize; 2],
    budget: &Budget,
    hint: &mut Hint,
) -> Option<PairMeasures> {
    let measures = union::measures_of(united, of, budget, hint).ok()?;
    in_radii(schema, pair, &measures, of.map(|body| &united.bodies()[body]))
}

/// The measures in radii of the smaller body; `None` if one of them has no surface.
fn in_radii(
    schema: &Schema,
    pair: [usize; 2],
    measures: &union::PairMeasures,
    bodies: [&Body; 2],
) -> Option<PairMeasures> {
    let radius = pair.map(|body| schema.bodies[body].radius).into_iter().fold(f64::INFINITY, f64::min);
    let is_overlap = measures.overlap > 0.0; // skips the volumes, which are sums over all triangles
    let volume = if is_overlap { bodies.iter().map(|body| body.volume()).fold(f64::INFINITY, f64::min) } else { 0.0 };
    measures.gap.is_finite().then(|| PairMeasures {
        gap: measures.gap / radius,
        overlap: measures.overlap / (radius * radius * radius),
        // more where folds enclose space twice
        share: if volume > 0.0 { f64::min(measures.overlap / volume, 1.0) } else { 0.0 },
        neck: measures.neck / radius,
        perimeter: measures.perimeter / radius,
    })
}

impl Group {
    /// The group of bodies whose union is given; `None` after an interrupt.
    fn new(schema: &Schema, bodies: &[usize], united: &Union, interrupt: Option<&AtomicBool>) -> Option<Group> {
        let go_on = || (!is_raised(interrupt)).then_some(());
        let components = united.component_count();
        let number = |body: u32| bodies[body as usize] as u32;
        let origin = |origin: Origin| {
            let (body, vertex) = match origin {
                Origin::Vertex { body, vertex } => (body, Some(vertex)),
                Origin::Edge { body, .. } | Origin::Within { body, .. } | Origin::Triangles([[body, _], ..]) => {
                    (body, None)
                }
            };
            VertexOrigin { bodies: [number(body); 2], share: 0.0, vertex }
        };
        let mesh = united.labelled_mesh(origin);
        go_on()?;
        let mut on_seam = vec![None; mesh.positions.len()];
        let pairs: Vec<[usize; 2]> = united.seams.iter().map(|seam| seam.bodies.map(|b| bodies[b as usize])).collect();
        for (seam, index) in united.seams.iter().zip(0..) {
            seam.vertices.iter().for_each(|&v| on_seam[mesh.names[v as usize] as usize] = Some(index));
        }
        let seams = united.seams.iter().zip(&pairs).map(|(seam, pair)| {
            let closing = seam.vertices.first().filter(|_| seam.is_closed);
            let vertices = seam.vertices.iter().chain(closing);
            SeamLine { bodies: *pair, positions: vertices.map(|&v| united.position(v)).collect() }
        });
        let seams = seams.collect();
        let radius = |pair: &[usize; 2]| f64::min(schema.bodies[pair[0]].radius, schema.bodies[pair[1]].radius);
        let radii: Vec<f64> = pairs.iter().map(radius).collect();
        let mut seamed = Seamed { labels: mesh.origins, positions: mesh.positions, triangles: mesh.triangles, on_seam };
        let reach = f64::max(COLORS_BLEND, schema.blend);
        let of_new = |origin| VertexOrigin { vertex: None, ..origin };
        seamed.fair(schema.blend, reach, &radii, of_new, |origin, near| {
            let (pair, share) = (pairs[near.seam as usize], 1.0 - near.distance / reach);
            let other = if origin.bodies[0] == pair[0] as u32 { pair[1] } else { pair[0] };
            origin.bodies[1] = other as u32;
            origin.share = (0.5 * share * share * (3.0 - 2.0 * share)) as f32;
        });
        go_on()?;
        let euler = united.euler();
        Some(Group {
            bodies: bodies.to_vec(),
            seams,
            components,
            euler,
            genus: components as i64 - euler / 2,
            volume: united.volume(),
            area: united.area(),
            normals: Vec::new(),
            positions: seamed.positions,
            origins: seamed.labels,
            triangles: seamed.triangles,
        })
    }

    /// How it is drawn, if a body of the group is faceted.
    pub fn facets(&self, schema: &Schema) -> Option<Facets> {
        let is_faceted = self.bodies.iter().any(|&body| schema.bodies[body].mesh.facets().is_some());
        is_faceted.then(|| Facets::new(self.positions.len(), &self.triangles))
    }

    /// Appends the outward unit normals of the vertices; `sums` is scratch storage.
    ///
    /// A normal is the mean of the adjacent triangles' normals, weighted by the sine of the angle at the vertex. With
    /// area weights, large triangles would dominate the slivers along a seam.
    pub fn append_normals(&self, sums: &mut Vec<DVec3>, normals: &mut Vec<[f32; 3]>) {
        sums.clear();
        sums.extend_from_slice(&self.normals);
        sums.resize(self.positions.len(), DVec3::ZERO);
        for corners in self.triangles.iter().filter(|_| self.normals.is_empty()) {
            let [a, b, c] = corners.map(|v| self.positions[v as usize]);
            let (ab, bc, ca) = (b - a, c - b, a - c);
            let lengths = [ab.length(), bc.length(), ca.length()];
            let area = ab.cross(bc) / (lengths[0] * lengths[1] * lengths[2]);
            if area.is_finite() {
                // sin(angle) = |ab×bc| / (product of both side lengths at the corner): divide by all three, multiply by
                // the opposite one
                (0..3).for_each(|k| sums[corners[k] as usize] += area * lengths[(k + 1) % 3]);
            }
        }
        normals.extend(sums.iter().map(|sum| sum.normalize_or(DVec3::Z).as_vec3().to_array()));
    }
}

/// The groups of at least two bodies connected by pairs in a joined phase, in ascending order of their first body.
fn groups(schema: &Schema, frame: &Frame) -> Vec<Vec<usize>> {
    let mut groups = connected(frame, |pair| schema.phases[pair.phase].is_joined);
    // a body that has been torn may have nothing left
    let has_surface = |&body: &usize| !frame.bodies[body].mesh_of(&schema.bodies[body]).triangles().is_empty();
    groups.iter_mut().for_each(|group| group.retain(has_surface));
    groups.retain(|group| group.len() > 1);
    groups
}

/// The groups of at least two bodies connected by selected pairs of a frame, in ascending order of their first body.
pub fn connected(frame: &Frame, is_joined: impl Fn(&PairFrame) -> bool) -> Vec<Vec<usize>> {
    let joined: Vec<&PairFrame> = frame.pairs.iter().filter(|pair| is_joined(pair)).collect();
    if joined.is_empty() {
        return Vec::new();
    }
    let mut sets = DisjointSets::singletons(frame.bodies.len());
    joined.iter().for_each(|pair| sets.join(pair.a as u32, pair.b as u32));
    let mut groups: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for body in 0..frame.bodies.len() {
        groups.entry(sets.least(body as u32)).or_default().push(body);
    }
    groups.into_values().filter(|group| group.len() > 1).collect()
}

/// Maps all items, in parallel if there are several.
pub fn for_all<T: Sync, R: Send>(items: &[T], map: impl Fn(&T) -> R + Sync + Send) -> Vec<R> {
    parallel::collect(items.len() > 1, items, map)
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;
    use crate::{
        World,
        geometry::{mesh::signed_volume, shape::Solid as _, sphere::Sphere},
        observe::{Simulation as _, Want},
        scene,
    };

    /// The schema, and the frame after some steps, of a built-in scene.
    fn after(name: &str, steps: u64) -> (Schema, Frame) {
        let mut world = World::new(scene::Scene::builtin(name).unwrap()).unwrap();
        for _ in 0..steps {
            let _ = world.step();
        }
        let mut frame = Frame::default();
        world.observe(Want::default(), &mut frame);
        (world.schema(), frame)
    }

    fn volume(group: &Group) -> f64 {
        signed_volume(group.triangles.iter().map(|corners| corners.map(|v| group.positions[v as usize])))
    }

    #[test]
    fn merged_bodies_have_one_closed_surface() {
        for (name, steps) in
            [("two", 86), ("two", 100), ("two", 150), ("two", 195), ("three", 150), ("size_ratio", 180)]
        {
            let (mut schema, frame) = after(name, steps);
            for blend in [0.0, 0.1, 0.25, 0.5] {
                schema.blend = blend;
                let mut merger = Merger::new(&schema, None);
                let merged = merger.merge(&schema, &frame, &[]);
                assert_eq!(merged.overlapping, 0);
                for group in &merged.groups {
                    let edges = || group.triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
                    let directed: HashSet<[u32; 2]> = edges().collect();
                    assert_eq!(directed.len(), edges().count(), "an edge has two triangles on one side");
                    assert!(edges().all(|[a, b]| directed.contains(&[b, a])), "an edge is open");
                    let used: HashSet<u32> = group.triangles.iter().flatten().copied().collect();
                    assert_eq!(used.len(), group.positions.len());
                    let euler = used.len() as i64 - group.triangles.len() as i64 / 2;
                    assert_eq!(euler, group.euler, "{name}, {steps} steps, blend {blend}");
                    let change = volume(group) / group.volume - 1.0;
                    assert!(change.abs() < if blend == 0.0 { 1e-9 } else { 1e-3 }, "{name} {steps} {blend}: {change}");
                    assert_eq!((group.origins.len(), group.genus), (used.len(), 0));
                }
                assert!(!merged.groups.is_empty(), "{name}, {steps} steps");
            }
        }
    }

    /// A ball is the same mesh when every vertex is opposite to where it was, but inside out: its surface is the same.
    #[test]
    fn a_body_that_is_inside_out_has_a_surface() {
        let text = "duration = 1.0\n[influence]\nmerge_at = 1.0\n[[body]]\nname = 'a'\nradius = 1.0\nmotion = { fixed = [0, 0, 0] }\n\
                    [[body]]\nname = 'b'\nradius = 1.0\nmotion = { fixed = [1.5, 0, 0] }\n";
        let world = World::new(scene::Scene::parse(text, "pair").unwrap()).unwrap();
        let (schema, mut frame) = (world.schema(), Frame::default());
        world.observe(Want::default(), &mut frame);
        let surface = |frame: &Frame| {
            let mut merger = Merger::new(&schema, None);
            let merged = merger.merge(&schema, frame, &[[0, 1]]);
            assert_eq!((merged.groups.len(), merged.overlapping), (1, 0));
            let PairMeasures { gap, overlap, share, neck, .. } = merged.pairs[0].unwrap();
            [merged.groups[0].volume, volume(&merged.groups[0]), merged.groups[0].area, gap, overlap, share, neck]
        };
        let expected = surface(&frame);
        let (now, mut rest) = (&mut frame.bodies[1], Vectors::default());
        now.local_positions(schema.bodies[1].rest(), &mut rest);
        (now.is_at_rest, now.positions) = (false, Vectors::default());
        rest.iter().for_each(|l| now.positions.push(-l));
        for (found, expected) in surface(&frame).into_iter().zip(expected) {
            // seams are smoothed in the order of the vertices
            assert!((found - expected).abs() < 1e-6, "{found} {expected}");
        }
    }

    #[test]
    fn normals_point_outwards_for_any_triangulation() {
        let mut sphere = Group::default();
        let mesh = Sphere { stacks: 12, slices: 24 }.mesh();
        sphere.positions = mesh.positions().iter().collect();
        sphere.triangles = mesh.triangles().to_vec();
        // a sliver on an edge, and a triangle without area
        let (far, [a, b, c]) = (sphere.positions.len() as u32, sphere.triangles[100]);
        sphere.positions.push(sphere.positions[a as usize] * 0.999 + sphere.positions[b as usize] * 0.001);
        sphere.triangles[100] = [far, b, c];
        sphere.triangles.extend([[a, far, c], [a, a, b]]);
        let mut normals = Vec::new();
        sphere.append_normals(&mut Vec::new(), &mut normals);
        for (normal, at) in normals.iter().zip(&sphere.positions) {
            let angle = DVec3::from_array(normal.map(f64::from)).angle_between(*at).to_degrees();
            // all triangles of the new vertex are on one side of its edge
            assert!(angle < 10.0, "{angle}° at {at}");
        }
        sphere.normals = vec![DVec3::X; sphere.positions.len()];
        normals.clear();
        sphere.append_normals(&mut Vec::new(), &mut normals);
        assert!(normals.iter().all(|&normal| normal == [1.0, 0.0, 0.0]), "a surface's own normals are kept");
    }

    /// A group at rest that had too small a share of the work is tried again when others leave it more.
    #[test]
    fn a_surface_that_was_given_up_does_not_depend_on_earlier_frames() {
        let body = |(name, at): (&str, &str)| {
            format!("[[body]]\nname = '{name}'\nradius = 1.0\nmotion = {{ fixed = [{at}] }}\n")
        };
        let bodies = [("a", "0, 0, 0"), ("b", "1.8, 0, 0"), ("c", "0, 9, 0"), ("d", "1.8, 9, 0")].map(body).concat();
        let scene = scene::Scene::parse(&format!("duration = 1.0\n{bodies}"), "four.toml").unwrap();
        let world = World::new(scene).unwrap();
        let (schema, mut first) = (world.schema(), Frame::default());
        world.observe(Want::default(), &mut first);
        let mut second = first.clone();
        second.pairs.retain(|pair| pair.b == 1);
        let surfaces = |merger: &mut Merger, frame: &Frame| merger.merge(&schema, frame, &[[0, 1]]).groups.len();
        let work = (10..)
            .map(|k| 1 << k)
            .find(|work| surfaces(&mut Merger { work: *work, ..Merger::new(&schema, None) }, &second) == 1);
        let mut merger = Merger { work: work.unwrap(), ..Merger::new(&schema, None) };
        assert_eq!([surfaces(&mut merger, &first), surfaces(&mut merger, &second)], [0, 1]);
    }

    #[test]
    fn vertices_beyond_the_blend_are_not_moved() {
        let (mut schema, frame) = after("two", 150);
        schema.blend = 0.25;
        let mut merger = Merger::new(&schema, None);
        let group = &merger.merge(&schema, &frame, &[]).groups[0];
        let seam = || group.seams.iter().flat_map(|seam| &seam.positions);
        let mut kept = 0;
        for (position, origin) in group.positions.iter().zip(&group.origins) {
            let Some(vertex) = origin.vertex else { continue };
            let body = &frame.bodies[origin.bodies[0] as usize];
            let original = body.positions.get(vertex as usize) + body.centre;
            if seam().all(|at| at.distance(original) > 0.25) {
                assert_eq!(*position, original);
                kept += 1;
            }
        }
        assert!(kept > 400, "{kept}");
    }

    /// A vertex assigned to the wrong side of the seam would show as a blotch.
    #[test]
    fn colors_blend_evenly_across_the_seam() {
        for (name, steps) in [("two", 150), ("collide", 100), ("collide", 120)] {
            let (schema, frame) = after(name, steps);
            let mut merger = Merger::new(&schema, None);
            let group = &merger.merge(&schema, &frame, &[]).groups[0];
            let share_of_second = |v: u32| {
                let VertexOrigin { bodies, share, .. } = group.origins[v as usize];
                if bodies[0] == 1 { 1.0 - f64::from(share) } else { f64::from(share) }
            };
            for [a, b] in group.triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]) {
                let length = group.positions[a as usize].distance(group.positions[b as usize]);
                let change = (share_of_second(a) - share_of_second(b)).abs();
                // the steepest gradient of the blend, plus a margin for lengths that fairing changes
                let limit = 2.0 * 0.75 * length / COLORS_BLEND + 0.02;
                assert!(change < limit, "{name}, {steps} steps: {change} over {length}");
            }
        }
    }

    /// A frame over its work budget shows the bodies themselves and is flagged; the next frame starts afresh. The
    /// result does not depend on the number of threads, because work is counted, not timed.
    #[test]
    fn a_frame_over_budget_is_flagged_and_the_next_recovers() {
        let (schema, frame) = after("two", 150);
        let mut merger = Merger::new(&schema, None);
        let whole = merger.merge(&schema, &frame, &[[0, 1]]).clone();
        let mut moved = frame.clone();
        let pool = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        for (work, threads) in [(0, 1), (20, 1), (500, 2), (500, 8)] {
            merger.work = work;
            moved.bodies[0].centre.x += 1e-3; // results for bodies at rest would be reused
            let beyond = pool(threads).install(|| merger.merge(&schema, &moved, &[[0, 1]]).clone());
            assert_eq!((beyond.overlapping, beyond.groups.len()), (1, 0), "{work}");
            assert_eq!((beyond.is_merged, beyond.pairs), (vec![false; 2], vec![None]), "{work}");
        }
        merger.work = FRAME_WORK;
        let again = merger.merge(&schema, &frame, &[[0, 1]]);
        assert_eq!((again.overlapping, &again.is_merged), (0, &vec![true; 2]));
        assert_eq!((&again.groups, &again.pairs), (&whole.groups, &whole.pairs));
    }

    #[test]
    fn surfaces_of_bodies_at_rest_are_reused() {
        let (schema, frame) = after("two", 150);
        let mut merger = Merger::new(&schema, None);
        let first = merger.merge(&schema, &frame, &[[0, 1]]).clone();
        let second = merger.merge(&schema, &frame, &[[0, 1]]);
        assert!(Arc::ptr_eq(&first.groups[0], &second.groups[0]));
        assert_eq!(first.pairs, second.pairs);
        let measures = first.pairs[0].unwrap();
        assert!(measures.gap < 0.0 && measures.neck > 0.1 && measures.overlap > 0.0, "{measures:?}");
        // the measures are the same whether or not the pair is a group
        let mut apart = schema.clone();
        apart.phases.iter_mut().for_each(|phase| phase.is_joined = false);
        let mut merger = Merger::new(&apart, None);
        assert_eq!(merger.merge(&apart, &frame, &[[0, 1]]).pairs[0], Some(measures));
        assert!(merger.merged().groups.is_empty());
    }

    /// The bits of everything in a frame's surfaces.
    fn bits(merged: &Merged) -> Vec<u64> {
        let mut bits = vec![merged.overlapping as u64];
        for group in &merged.groups {
            bits.extend(group.positions.iter().flat_map(|at| at.to_array()).map(f64::to_bits));
            bits.extend(group.triangles.iter().flatten().map(|&v| u64::from(v)));
            bits.extend(group.origins.iter().map(|of| u64::from(of.share.to_bits()) << 32 | u64::from(of.bodies[1])));
            bits.extend(group.seams.iter().flat_map(|seam| &seam.positions).map(|at| at.x.to_bits()));
            bits.extend([group.components as u64, group.euler as u64, group.volume.to_bits(), group.area.to_bits()]);
        }
        for of in &merged.pairs {
            let numbers = of.map(|of| [of.gap, of.overlap, of.share, of.neck, of.perimeter].map(f64::to_bits));
            bits.extend(numbers.into_iter().flatten());
        }
        bits
    }

    /// Surfaces depend neither on the frame at which a run is entered nor on the number of threads.
    #[test]
    fn neither_earlier_frames_nor_threads_change_a_bit() {
        for (name, last, every) in [("two", 230, 2), ("three", 200, 5), ("crowd", 60, 20)] {
            let mut world = World::new(scene::Scene::builtin(name).unwrap()).unwrap();
            let (schema, mut frame) = (world.schema(), Frame::default());
            let pool = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let mut warm = [1, 2, 8].map(|threads| (pool(threads), Merger::new(&schema, None)));
            let mut seen = 0;
            for step in 0..last {
                let _ = world.step();
                if step % every != 0 {
                    continue;
                }
                world.observe(Want::default(), &mut frame);
                let pairs: Vec<[usize; 2]> = frame.pairs.iter().map(|pair| [pair.a, pair.b]).collect();
                let cold = bits(Merger::new(&schema, None).merge(&schema, &frame, &pairs));
                for (pool, merger) in &mut warm {
                    let merged = pool.install(|| bits(merger.merge(&schema, &frame, &pairs)));
                    assert!(merged == cold, "{name}, step {step}, {} threads", pool.current_num_threads());
                }
                seen += usize::from(!warm[0].1.merged().groups.is_empty());
            }
            assert!(seen > 1, "{name}: {seen}");
        }
    }
}
