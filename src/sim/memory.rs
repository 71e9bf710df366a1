//! Estimates the memory that a scene needs before it is built: a typing error must not exhaust the machine's memory.

use std::{
    collections::HashSet,
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

use crate::{geometry::Shape, scene::Scene, text::bytes};

/// State of a vertex: displacement and velocity, three doubles each [bytes].
const STATE_BYTES: u64 = 48;
/// A rest shape, shared by all bodies of it, per vertex: a position, two triangles and a share of the mass [bytes].
const SHAPE_BYTES: u64 = 56;
/// The same from a file, with directions and normals [bytes].
const MESH_BYTES: u64 = 104;
/// What looking at a vertex takes, at most: six forces by cause and their sum, positions, normals, arrows [bytes].
const OBSERVE_BYTES: u64 = 400;
/// A vertex in a scene with free bodies: rest position and mass at the scale of its body, and its motion and what acts on
/// it at the five samples of a step, as if all bodies were one island [bytes].
const COUPLED_BYTES: u64 = 32 + 5 * 72;
/// The same where there are planes: their forces by the last two evaluations [bytes].
const PLANE_BYTES: u64 = 2 * 160;
/// A body of such a scene in a step, without its vertices [bytes].
const COUPLED_BODY_BYTES: u64 = 4096;
/// A body without its vertices: names, path, surroundings [bytes].
const BODY_BYTES: u64 = 2048;
/// A pair of bodies that are near each other, and what each knows of the other [bytes].
const PAIR_BYTES: u64 = 256;
/// More pairs than this, and this many a body, are more than can be stepped, whatever the memory.
const MOST_PAIRS: u64 = 2_000_000;
const MOST_PAIRS_PER_BODY: u64 = 64;

/// The scene needs more memory than the machine has, or has more pairs of bodies near each other than can be stepped.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("scene \"{scene}\" is too large{}", self.reason())]
pub struct TooLarge {
    /// Name of the scene.
    pub scene: String,
    /// Number of bodies.
    pub bodies: u64,
    /// Number of vertices of all bodies.
    pub vertices: u64,
    /// There are more pairs of bodies near each other than these, if they are what is too much.
    pub pairs: Option<u64>,
    /// [bytes]
    pub needed: u64,
    /// [bytes]
    pub available: u64,
}

impl TooLarge {
    fn reason(&self) -> String {
        let TooLarge { bodies, vertices, needed, available, .. } = self;
        let (needs, has) = (bytes(*needed), bytes(*available));
        let is_memory = !fits(*needed, *available);
        match self.pairs {
            Some(pairs) if is_memory => format!(
                " for this machine: {bodies} bodies with more than {pairs} pairs near each other need more than {needs}, and {has} \
                 are available; move bodies apart, lower `reach`, or use fewer bodies"
            ),
            Some(pairs) => format!(
                ": {bodies} bodies have more than {pairs} pairs near each other at the start, more than can be stepped; move \
                 bodies apart, lower `reach`, or use fewer bodies"
            ),
            None => format!(
                " for this machine: {bodies} bodies with {vertices} vertices need about {needs}, and {has} are available; lower \
                 `stacks` and `slices` of the shapes, or use fewer bodies"
            ),
        }
    }
}

/// What there is has to leave a tenth to others.
fn fits(needed: u64, available: u64) -> bool {
    needed / 9 * 10 <= available
}

/// An upper estimate of the memory that simulating and observing the scene takes [bytes]: every vertex awake.
pub fn needed(scene: &Scene) -> u64 {
    let mut seen = HashSet::new();
    let shapes: u64 = scene
        .bodies
        .iter()
        .filter(|body| seen.insert(&body.shape))
        .map(|body| {
            body.shape.vertex_count().saturating_mul(if matches!(body.shape, Shape::Mesh(_)) {
                MESH_BYTES
            } else {
                SHAPE_BYTES
            })
        })
        .fold(0, u64::saturating_add);
    let (of_vertex, of_body) = match (scene.is_coupled(), scene.planes.is_empty()) {
        (false, _) => (STATE_BYTES, BODY_BYTES),
        (true, true) => (STATE_BYTES + COUPLED_BYTES, BODY_BYTES + COUPLED_BODY_BYTES),
        (true, false) => (STATE_BYTES + COUPLED_BYTES + PLANE_BYTES, BODY_BYTES + COUPLED_BODY_BYTES),
    };
    let largest = scene.bodies.iter().map(|body| body.shape.vertex_count()).max().unwrap_or(0);
    scene
        .vertex_count()
        .saturating_mul(of_vertex)
        .saturating_add(largest.saturating_mul(OBSERVE_BYTES))
        .saturating_add((scene.bodies.len() as u64).saturating_mul(of_body))
        .saturating_add(shapes)
        .saturating_add(3 * scene.source.len() as u64) // kept by the scene, by the schema, and for the recording
}

/// What the scene of a world holds of its bodies, by what was allocated for it [bytes].
pub fn of_bodies(scene: &Scene) -> usize {
    let names: usize = scene.bodies.iter().map(|body| body.name.capacity() + of_motion(body)).sum();
    names + scene.bodies.capacity() * size_of::<crate::scene::Body>()
}

fn of_motion(body: &crate::scene::Body) -> usize {
    body.path().map_or(0, crate::scene::Path::memory)
}

/// Memory that this process may still take, by the machine and by its control group [bytes].
pub fn available() -> u64 {
    let mut system = sysinfo::System::new();
    system.refresh_memory();
    let limit = system.cgroup_limits().map_or(u64::MAX, |limits| limits.free_memory);
    system.available_memory().min(limit)
}

/// Scenes that need less than this are checked against what was available a moment ago [bytes].
const SMALL: u64 = 16 << 20;
/// For this long. Asking the system takes as long as tens of steps of a small scene, which sweeps build by the thousand.
const MOMENT: Duration = Duration::from_millis(100);

/// What was available when it was last asked for.
static RECENT: Mutex<Option<(Instant, u64)>> = Mutex::new(None);

fn recently_available() -> u64 {
    let mut recent = RECENT.lock().unwrap_or_else(PoisonError::into_inner);
    match *recent {
        Some((then, available)) if then.elapsed() < MOMENT => available,
        _ => recent.insert((Instant::now(), available())).1,
    }
}

/// Refuses a scene that needs more than nine tenths of what is available; what is known of it by then, pairs are not.
pub fn check(scene: &Scene) -> Result<Room, TooLarge> {
    let needed = needed(scene);
    let available = if needed < SMALL { recently_available() } else { available() };
    let room = Room { needed, available };
    if fits(needed, available) { Ok(room) } else { Err(room.refuse(scene, None)) }
}

/// What a scene needs without its pairs, and what there is [bytes].
#[derive(Clone, Copy, Debug)]
pub struct Room {
    needed: u64,
    available: u64,
}

impl Room {
    /// The most pairs of bodies near each other for which there is room.
    pub(super) fn most_pairs(&self, scene: &Scene) -> u64 {
        let left = (self.available / 10 * 9).saturating_sub(self.needed);
        (MOST_PAIRS + MOST_PAIRS_PER_BODY * scene.bodies.len() as u64).min(left / PAIR_BYTES)
    }

    /// Refuses a scene, for `pairs` if there are more of them.
    pub(super) fn refuse(&self, scene: &Scene, pairs: Option<u64>) -> TooLarge {
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
