//! Estimates the memory that a scene needs before it is built: a typo must not exhaust the machine's memory.

use std::{
    collections::HashSet,
    sync::Mutex,
    time::{Duration, Instant},
};

use crate::{geometry::Shape, scene::Scene, text::bytes};

/// State of a vertex: displacement and velocity, three doubles each [bytes].
const STATE_BYTES: u64 = 48;
/// Per vertex of a rest shape, which bodies share: a position, two triangles and a mass [bytes].
const SHAPE_BYTES: u64 = 56;
/// Per vertex of a rest shape from a file, which also has directions and normals [bytes].
const MESH_BYTES: u64 = 104;
/// Per observed vertex, at most: six forces by cause and their sum, positions, normals, arrows [bytes].
const OBSERVE_BYTES: u64 = 400;
/// Per vertex of a coupled scene: rest position and mass at its body's scale, and state and forces at the five samples
/// of a step. Assumes the worst case, a single island of all bodies [bytes].
const COUPLED_BYTES: u64 = 32 + 5 * 72;
/// Extra per vertex of a coupled scene with planes: the plane forces of the last two evaluations [bytes].
const PLANE_BYTES: u64 = 2 * 160;
/// Per body of a coupled scene during a step, without its vertices [bytes].
const COUPLED_BODY_BYTES: u64 = 4096;
/// Per body, without its vertices: names, path, surroundings [bytes].
const BODY_BYTES: u64 = 2048;
/// Per pair of nearby bodies, with their neighbour entries, and per pair of a body and a force point [bytes].
const PAIR_BYTES: u64 = 256;
/// Constant part of the limit on the number of pairs, whatever the memory.
const MAX_PAIRS: u64 = 2_000_000;
/// Part of that limit per body.
const MAX_PAIRS_PER_BODY: u64 = 64;

/// The scene needs more memory than is available, or has more pairs of nearby bodies than can be stepped.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("scene \"{scene}\" is too large{}", self.reason())]
pub struct TooLarge {
    /// Name of the scene.
    pub scene: String,
    /// Number of bodies.
    pub bodies: u64,
    /// Number of vertices of all bodies.
    pub vertices: u64,
    /// The limit on pairs of nearby bodies, if the scene exceeds it.
    pub pairs: Option<u64>,
    /// Estimated memory that the scene needs [bytes].
    pub needed: u64,
    /// Memory available to this process [bytes].
    pub available: u64,
}

impl TooLarge {
    fn reason(&self) -> String {
        let TooLarge { bodies, vertices, needed, available, .. } = self;
        let (needs, has) = (bytes(*needed), bytes(*available));
        let (noun, have, need) = if *bodies == 1 { ("body", "has", "needs") } else { ("bodies", "have", "need") };
        let is_memory = !fits(*needed, *available);
        match self.pairs {
            Some(pairs) if is_memory => format!(
                " for this machine: {bodies} {noun} with more than {pairs} pairs near each other {need} more than {needs}, and {has} \
                 are available; move bodies apart, lower `reach`, or use fewer bodies"
            ),
            Some(pairs) => format!(
                ": {bodies} {noun} {have} more than {pairs} pairs near each other, more than can be stepped; move \
                 bodies apart, lower `reach`, or use fewer bodies"
            ),
            None => format!(
                " for this machine: {bodies} {noun} with {vertices} vertices {need} about {needs}, and {has} are available; lower \
                 `stacks` and `slices` of the shapes, or use fewer bodies"
            ),
        }
    }
}

/// Whether nine tenths of the available memory suffice; a tenth is left to other processes.
fn fits(needed: u64, available: u64) -> bool {
    needed / 9 * 10 <= available
}

/// The memory for all different rest shapes [bytes].
fn shapes(scene: &Scene) -> u64 {
    let mut seen = HashSet::new();
    let different = scene.bodies.iter().map(|body| &body.shape).filter(|shape| seen.insert(*shape));
    let per_vertex = |shape: &Shape| if matches!(shape, Shape::Mesh(_)) { MESH_BYTES } else { SHAPE_BYTES };
    different.map(|shape| shape.vertex_count().saturating_mul(per_vertex(shape))).fold(0, u64::saturating_add)
}

/// An upper estimate of the memory for simulating and observing the scene, with every vertex awake [bytes].
pub fn needed(scene: &Scene) -> u64 {
    let (per_vertex, per_body) = match (scene.is_coupled(), scene.planes.is_empty()) {
        (false, _) => (STATE_BYTES, BODY_BYTES),
        (true, true) => (STATE_BYTES + COUPLED_BYTES, BODY_BYTES + COUPLED_BODY_BYTES),
        (true, false) => (STATE_BYTES + COUPLED_BYTES + PLANE_BYTES, BODY_BYTES + COUPLED_BODY_BYTES),
    };
    let largest = scene.bodies.iter().map(|body| body.shape.vertex_count()).max().unwrap_or(0);
    scene
        .vertex_count()
        .saturating_mul(per_vertex)
        .saturating_add(largest.saturating_mul(OBSERVE_BYTES))
        .saturating_add((scene.bodies.len() as u64).saturating_mul(per_body))
        .saturating_add((scene.bodies.len() * scene.points.len()) as u64 * PAIR_BYTES)
        .saturating_add(shapes(scene))
        .saturating_add(3 * scene.source.len() as u64) // kept by the scene, by the schema, and for the recording
}

/// Memory that this process can still allocate, limited by the machine and by its control group [bytes].
pub fn available() -> u64 {
    let mut system = sysinfo::System::new();
    system.refresh_memory();
    let limit = system.cgroup_limits().map_or(u64::MAX, |limits| limits.free_memory);
    system.available_memory().min(limit)
}

/// New scenes that need less than this are checked against a cached value of the available memory [bytes].
const SMALL: u64 = 16 << 20;
/// Lifetime of the cached value. Asking the system costs as much as tens of steps of a small scene, and sweeps build
/// thousands of those.
const CACHE_LIFETIME: Duration = Duration::from_millis(100);

/// When the available memory was last read, and its value [bytes].
static RECENT: Mutex<Option<(Instant, u64)>> = Mutex::new(None);

fn recently_available() -> u64 {
    let mut recent = crate::lock(&RECENT);
    match *recent {
        Some((then, available)) if then.elapsed() < CACHE_LIFETIME => available,
        _ => recent.insert((Instant::now(), available())).1,
    }
}

/// Rejects a scene that needs more than nine tenths of the available memory. Pairs are not known yet and not counted.
pub fn check(scene: &Scene) -> Result<Budget, TooLarge> {
    let needed = needed(scene);
    within(scene, needed, if needed < SMALL { recently_available() } else { available() })
}

/// Rejects a scene whose shapes alone do not fit, whatever its model: those are built before all else.
pub fn check_shapes(scene: &Scene) -> Result<(), TooLarge> {
    let shapes = shapes(scene);
    let available = if shapes < SMALL { recently_available() } else { available() };
    if fits(shapes, available) {
        return Ok(());
    }
    Err(Budget { needed: needed(scene), available }.exceeded(scene, None))
}

/// Rejects a scene that has grown, as [`check`] does. What it has allocated since the cached value was read is part of
/// what it needs, so that this is not too lenient.
pub fn check_grown(scene: &Scene) -> Result<Budget, TooLarge> {
    within(scene, needed(scene), recently_available())
}

fn within(scene: &Scene, needed: u64, available: u64) -> Result<Budget, TooLarge> {
    let budget = Budget { needed, available };
    if fits(needed, available) { Ok(budget) } else { Err(budget.exceeded(scene, None)) }
}

/// The memory that a scene needs without its pairs, and the available memory [bytes].
#[derive(Clone, Copy, Debug)]
pub struct Budget {
    needed: u64,
    available: u64,
}

impl Budget {
    /// The largest number of pairs of nearby bodies that fits.
    pub(super) fn max_pairs(&self, scene: &Scene) -> u64 {
        let left = (self.available / 10 * 9).saturating_sub(self.needed);
        (MAX_PAIRS + MAX_PAIRS_PER_BODY * scene.bodies.len() as u64).min(left / PAIR_BYTES)
    }

    /// The error for a scene that exceeds the budget, by having more than `pairs` pairs if given.
    pub(super) fn exceeded(&self, scene: &Scene, pairs: Option<u64>) -> TooLarge {
        let of_pairs = pairs.map_or(0, |pairs| (pairs + 1).saturating_mul(PAIR_BYTES));
        TooLarge {
            scene: scene.name.clone(),
            bodies: scene.bodies.len() as u64,
            vertices: scene.vertex_count(),
            pairs,
            needed: self.needed.saturating_add(of_pairs),
            available: self.available,
        }
    }
}
