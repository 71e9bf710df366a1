//! What a scene needs before it is built: a slip of the finger must not take the machine down.

use std::collections::HashSet;

use crate::{scene::Scene, text::bytes};

/// State of a vertex: displacement and velocity, three doubles each [bytes].
const STATE_BYTES: u64 = 48;
/// A rest shape, shared by all bodies of it, per vertex: a position, two triangles and a share of the mass [bytes].
const SHAPE_BYTES: u64 = 56;
/// What looking at a vertex takes, at most: six forces by cause and their sum, positions, normals, arrows [bytes].
const OBSERVE_BYTES: u64 = 400;
/// A body without its vertices: names, path, surroundings [bytes].
const BODY_BYTES: u64 = 2048;

/// The scene needs more memory than the machine has.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "scene \"{scene}\" is too large for this machine: {bodies} bodies with {vertices} vertices need about {}, \
     and {} are available; lower `stacks` and `slices` of the shapes, or use fewer bodies",
    bytes(*needed), bytes(*available)
)]
pub struct TooLarge {
    /// Name of the scene.
    pub scene: String,
    /// Number of bodies.
    pub bodies: u64,
    /// Number of vertices of all bodies.
    pub vertices: u64,
    /// [bytes]
    pub needed: u64,
    /// [bytes]
    pub available: u64,
}

/// An upper estimate of the memory that simulating and observing the scene takes [bytes]: every vertex awake.
pub fn needed(scene: &Scene) -> u64 {
    let mut seen = HashSet::new();
    let shapes: u64 = scene
        .bodies
        .iter()
        .filter(|body| seen.insert(&body.shape))
        .map(|body| body.shape.vertex_count().saturating_mul(SHAPE_BYTES))
        .fold(0, u64::saturating_add);
    let largest = scene.bodies.iter().map(|body| body.shape.vertex_count()).max().unwrap_or(0);
    scene
        .vertex_count()
        .saturating_mul(STATE_BYTES)
        .saturating_add(largest.saturating_mul(OBSERVE_BYTES))
        .saturating_add((scene.bodies.len() as u64).saturating_mul(BODY_BYTES))
        .saturating_add(shapes)
}

/// What the scene of a world holds of its bodies, by what was allocated for it [bytes].
pub fn of_bodies(scene: &Scene) -> usize {
    let names: usize = scene.bodies.iter().map(|body| body.name.capacity() + body.path.memory()).sum();
    names + scene.bodies.capacity() * size_of::<crate::scene::Body>()
}

/// Memory that this process may still take, by the machine and by its control group [bytes].
pub fn available() -> u64 {
    let mut system = sysinfo::System::new();
    system.refresh_memory();
    let limit = system.cgroup_limits().map_or(u64::MAX, |limits| limits.free_memory);
    system.available_memory().min(limit)
}

/// Refuses a scene that needs more than nine tenths of what is available.
pub fn check(scene: &Scene) -> Result<(), TooLarge> {
    let (needed, available) = (needed(scene), available());
    if needed / 9 * 10 <= available {
        return Ok(());
    }
    Err(TooLarge {
        scene: scene.name.clone(),
        bodies: scene.bodies.len() as u64,
        vertices: scene.vertex_count(),
        needed,
        available,
    })
}
