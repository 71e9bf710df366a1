//! The state of one body.

use std::sync::Arc;

use glam::DVec3;
use pulp::{Arch, Simd, WithSimd};

use super::{
    arrays::Vectors,
    deformation::{Deformation, Now, REST, larger},
    integrator::exponential::{StepStatistics, together::Largest},
    neighbours::{FatBounds, Neighbour},
    state::{Common, Pushed, State},
};
use crate::{
    geometry::{Mesh, Rest},
    model::oscillator::Oscillator,
    scene::{self, Scene},
};

/// A body, whatever it does.
pub(super) struct Body {
    /// Its rest shape, shared by all bodies of the same shape.
    pub mesh: Arc<Mesh>,
    /// Its radius [scene unit].
    pub radius: f64,
    /// The scene's pushes on this body.
    pub pushes: Box<[scene::Push]>,
    /// Its place among the active bodies, if it isn't at rest.
    pub active: Option<u32>,
    /// Bodies near it, ascending.
    pub neighbours: Vec<Neighbour>,
    /// What its neighbours were found for.
    pub fat_bounds: FatBounds,
}

impl Body {
    /// Body `index` of the scene, at rest.
    pub fn new(scene: &Scene, index: usize) -> Body {
        Body {
            mesh: scene.bodies[index].shape.mesh(),
            radius: scene.bodies[index].radius,
            pushes: scene.pushes.iter().filter(|push| push.body == index).copied().collect(),
            active: None,
            neighbours: Vec::new(),
            fat_bounds: FatBounds::NONE,
        }
    }
}

impl Body {
    /// Its rest shape at its own scale.
    pub fn rest(&self) -> Rest<'_> {
        self.mesh.at(self.radius)
    }

    /// What was allocated for it [bytes].
    pub fn memory(&self) -> usize {
        self.neighbours.capacity() * size_of::<Neighbour>() + size_of_val(&*self.pushes)
    }
}

/// A body that isn't at rest.
pub(super) struct Active {
    /// Index of the body.
    pub body: u32,
    /// What its vertices do.
    pub state: BodyState,
    /// What the active set was chosen for.
    pub chosen: Chosen,
    /// How far it can get in this step, and who can reach it.
    pub bounds: StepBounds,
    /// What its last step took.
    pub statistics: StepStatistics,
}

/// The state of a body's vertices. It is that at the end of the last step as long as the body is awake; of one that isn't, as
/// it was when it was last needed: nothing acts on it, so that the flow takes it to any later time.
pub(super) struct BodyState {
    /// ω and κ of its vertices.
    pub oscillator: Oscillator,
    /// What all its vertices do alike …
    pub common: Common,
    /// … at the end of this step.
    pub common_as_of: u64,
    /// What single vertices do beyond that.
    pub deformation: Deformation,
    /// Bounds over these.
    pub state_bounds: StateBounds,
    /// What √(|u|² + ω²|x|²) of no vertex can exceed, whatever happened so far: it grows by no more than the forces
    /// that the body was under [scene unit/s].
    pub bound: f64,
}

/// What an active set was chosen for, which is good until spheres have moved too far.
#[derive(Default)]
pub(super) struct Chosen {
    /// Where the spheres were.
    pub seen: Vec<Seen>,
    /// The responses to pushes then [scene unit].
    pub pushed: Vec<f64>,
    /// How far the spheres may move before it is chosen anew [scene unit].
    pub skin: f64,
}

/// Bounds of what can happen to a body in a step.
pub(super) struct StepBounds {
    /// Bodies whose spheres can reach it.
    pub reachable: Vec<Neighbour>,
    /// How far from the centre it can have vertices [scene unit].
    pub farthest: f64,
    /// A bound of the acceleration of any vertex by spheres [scene unit/s²].
    pub pull: f64,
    /// How far from the centre it can have vertices in this step, or later if nothing else acts [scene unit].
    pub max_reach: f64,
    /// Whether no sphere is so near that it would be reached then.
    pub may_sleep: bool,
}

/// Where a sphere was when an active set was chosen.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    /// Index of the body that it belongs to.
    pub body: u32,
    /// Its centre relative to the body's, shifted by what all vertices do alike [scene unit].
    pub centre: DVec3,
    /// How far all rest positions of the active set were outside of it [scene unit].
    pub clear: f64,
}

impl Active {
    /// Body `index` of the scene, at rest; `pushes` act on it at some time.
    pub fn new(scene: &Scene, index: usize, pushes: usize, step: u64) -> Active {
        let material = scene.bodies[index].material;
        Active {
            body: index as u32,
            state: BodyState {
                oscillator: Oscillator { omega: material.omega, damping: material.damping },
                common: Common { carried: State::default(), pushed: vec![Pushed::default(); pushes] },
                common_as_of: step,
                deformation: Deformation::default(),
                state_bounds: StateBounds::default(),
                bound: 0.0,
            },
            chosen: Chosen::default(),
            bounds: StepBounds { reachable: Vec::new(), farthest: 0.0, pull: 0.0, max_reach: 0.0, may_sleep: true },
            statistics: StepStatistics::default(),
        }
    }

    /// What was allocated for it [bytes].
    pub fn memory(&self) -> usize {
        self.state.deformation.memory()
            + self.state.common.pushed.capacity() * size_of::<Pushed>()
            + self.chosen.seen.capacity() * size_of::<Seen>()
            + self.chosen.pushed.capacity() * size_of::<f64>()
            + self.bounds.reachable.capacity() * size_of::<Neighbour>()
    }

    /// Whether nothing has acted on the body yet: every displacement and velocity is exactly zero.
    pub fn is_at_rest(&self) -> bool {
        self.state.deformation.is_empty() && self.state.common.is_zero()
    }

    /// Whether it may be left alone when nothing acts on it: where vertices swing, that has an end.
    pub fn can_sleep(&self) -> bool {
        self.state.oscillator.omega > 0.0 || self.is_at_rest()
    }

    /// What all its vertices do alike at the end of the last step.
    pub fn common_at(&self, now: Now) -> Common {
        let flow = self.common_flow(now);
        Common { carried: flowed(self.state.common.carried, flow), pushed: self.pushed_at(flow).collect() }
    }

    /// Adds that to the states of all vertices of `mesh`, which are zero.
    pub fn add_common_to(
        &self,
        mesh: &Mesh,
        pushes: &[scene::Push],
        displacement: &mut Vectors,
        velocity: &mut Vectors,
        now: Now,
    ) {
        if self.state.common.is_zero() {
            return;
        }
        let flow = self.common_flow(now);
        let State { x, u } = flowed(self.state.common.carried, flow);
        displacement.fill(x);
        velocity.fill(u);
        for (pushed, push) in self.pushed_at(flow).zip(pushes) {
            let (facing, direction) = (mesh.directions(), push.direction);
            now.arch.dispatch(AddPush { facing, direction, pushed, displacement, velocity });
        }
    }

    /// The flow that takes what all vertices do alike to the end of the last step.
    fn common_flow(&self, now: Now) -> [f64; 4] {
        let steps = now.step - self.state.common_as_of;
        if steps == 0 || self.state.common.is_zero() {
            return [1.0, 0.0, 0.0, 1.0];
        }
        let flow = now.oscillator.flow(steps as f64 * now.dt);
        let [xx, xu, ux, uu] = flow;
        let (x, momentum) = self.state.common.bounds(now.oscillator.omega);
        let left = (xx.abs() + ux.abs()) * x + (xu.abs() + uu.abs()) * momentum;
        // numbers that are much smaller still are slow to compute with
        if left < REST { [0.0; 4] } else { flow }
    }

    fn pushed_at(&self, [xx, xu, ux, uu]: [f64; 4]) -> impl Iterator<Item = Pushed> + '_ {
        self.state.common.pushed.iter().map(move |&Pushed { x, u }| Pushed { x: xx * x + xu * u, u: ux * x + uu * u })
    }

    /// When it is looked at.
    pub fn now(&self, step: u64, dt: f64, arch: Arch) -> Now {
        Now { step, dt, oscillator: self.state.oscillator, arch }
    }

    /// How far from rest its vertices swing if nothing else acts [scene unit]: no less than any |x|, and unlike those
    /// it does not swing itself.
    pub fn amplitude(&self) -> f64 {
        let omega = self.state.oscillator.omega;
        let (x, momentum) = self.state.common.bounds(omega);
        let StateBounds { displacement, momentum: own } = self.state.state_bounds;
        let swings = if omega > 0.0 { (momentum + own) / omega } else { x + displacement };
        swings.max(self.state.deformation.free_vertices.largest)
    }

    /// How far from rest it can have vertices within `h` [s] if no more than `common` and `single` [scene unit/s²] act on
    /// all and on single ones.
    pub fn farthest(&self, common: f64, single: f64, h: f64) -> f64 {
        let omega = self.state.oscillator.omega;
        let (displacement, momentum) = self.state.common.bounds(omega);
        let (mut alike, mut own) = (StateBounds { displacement, momentum }, self.state.state_bounds);
        if self.statistics.substeps == 0 && omega > 0.0 {
            // left to the flow, it has swung on since these were found
            for state_bounds in [&mut alike, &mut own] {
                state_bounds.displacement = state_bounds.momentum / omega;
            }
        }
        alike.after(self.state.oscillator, common, h) + own.after(self.state.oscillator, single, h)
    }

    /// Whether its state is one that the equation of motion cannot lead to: not finite, or far beyond [`Active::bound`].
    /// The margin leaves room for schemes that are merely inaccurate.
    pub fn has_diverged(&self) -> bool {
        const MARGIN: f64 = 100.0;
        let StateBounds { displacement, momentum } = self.state.state_bounds;
        let (x, m) = self.state.common.bounds(self.state.oscillator.omega);
        let (x, m) = (x + displacement, m + momentum);
        !x.is_finite() || !m.is_finite() || m > MARGIN * self.state.bound
    }
}

/// What a flow makes of a state.
fn flowed(State { x, u }: State, [xx, xu, ux, uu]: [f64; 4]) -> State {
    State { x: xx * x + xu * u, u: ux * x + uu * u }
}

/// Adds the response to a push to the states of all vertices; see [`Common::of`].
struct AddPush<'a> {
    /// Directions of the rest positions.
    facing: &'a Vectors,
    direction: DVec3,
    pushed: Pushed,
    displacement: &'a mut Vectors,
    velocity: &'a mut Vectors,
}

impl WithSimd for AddPush<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        add_push(self.facing, self.direction, self.pushed, self.displacement, self.velocity);
    }
}

#[inline(always)]
fn add_push(facing: &Vectors, d: DVec3, pushed: Pushed, displacement: &mut Vectors, velocity: &mut Vectors) {
    // slices of one length, so that the loop has no bounds to check and is vectorised
    let n = facing.len();
    let (lx, ly, lz) = (&facing.x[..n], &facing.y[..n], &facing.z[..n]);
    let [x, y, z] = [&mut displacement.x[..n], &mut displacement.y[..n], &mut displacement.z[..n]];
    let [u, v, w] = [&mut velocity.x[..n], &mut velocity.y[..n], &mut velocity.z[..n]];
    for i in 0..n {
        let squarely = -(lx[i] * d.x + ly[i] * d.y + lz[i] * d.z);
        let facing = if squarely > 0.0 { squarely } else { 0.0 };
        let (ax, ay, az) = (d.x * facing, d.y * facing, d.z * facing);
        x[i] += ax * pushed.x;
        y[i] += ay * pushed.x;
        z[i] += az * pushed.x;
        u[i] += ax * pushed.u;
        v[i] += ay * pushed.u;
        w[i] += az * pushed.u;
    }
}

/// Bounds over the vertices of a body, from which it is told how far they can get in a step.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct StateBounds {
    /// Largest |x| [scene unit].
    pub displacement: f64,
    /// Largest √(|u|² + ω²|x|²) [scene unit/s].
    pub momentum: f64,
}

impl StateBounds {
    /// The bounds of a state; NaN if any of it isn't.
    pub fn of(deformation: &Deformation, oscillator: Oscillator, arch: Arch) -> StateBounds {
        let omega_squared = oscillator.omega * oscillator.omega;
        let [x2, m2] = arch.dispatch(Largest { active_set: &deformation.active_set, omega_squared });
        let free_vertices = deformation.free_vertices.largest;
        let swings = if free_vertices > 0.0 { oscillator.omega * free_vertices } else { 0.0 };
        StateBounds { displacement: larger(x2.sqrt(), free_vertices), momentum: larger(m2.sqrt(), swings) }
    }

    /// How far from its rest position a vertex can get within `h` [s] under no more than `force` [scene unit/s²].
    ///
    /// Without force √(|u|² + ω²|x|²) never grows, and under one at no more than its size: so |x| grows by no more
    /// than that times h, nor beyond that over ω.
    pub fn after(&self, oscillator: Oscillator, force: f64, h: f64) -> f64 {
        let momentum = self.momentum + force * h;
        let travelled = self.displacement + momentum * h;
        if oscillator.omega > 0.0 { travelled.min(momentum / oscillator.omega) } else { travelled }
    }
}
