//! The state of one body.

use std::sync::Arc;

use glam::DVec3;
use pulp::Arch;
use smallvec::SmallVec;

use super::{
    deformation::{Deformation, Now, REST, Scratch},
    tracks::Tracks,
};
use crate::{
    geometry::{Mesh, Rest},
    model::oscillator::Oscillator,
    scene::{Material, Push, Scene},
    sim::{
        integrator::exponential::{StepStatistics, together::Largest},
        neighbours::{FatBounds, Neighbour, Neighbours},
        numerics::larger,
        state::State,
        terms::{On, points},
    },
};

/// A body of the scene, at rest or not: what a step reads of it besides its state, in one place.
#[derive(Clone)]
pub(in crate::sim) struct Body {
    /// Its rest shape, shared by all bodies of the same shape.
    pub mesh: Arc<Mesh>,
    /// Its radius [scene unit].
    pub radius: f64,
    /// The constants of its oscillators.
    pub material: Material,
    /// The scene's pushes on this body.
    pub pushes: Box<[Push]>,
    /// The force points that act on it at some time.
    pub points: Box<[Neighbour]>,
    /// Its index among the active bodies; `None` if it is at rest.
    pub active: Option<u32>,
    /// Nearby bodies, ascending.
    pub neighbours: Neighbours,
    /// The bounds for which its neighbours were found.
    pub fat_bounds: FatBounds,
    /// Until this time, its centre stays within them [s].
    pub known_until: f64,
    /// No pair of the body changes its phase before this time, if the body moves [s].
    pub unchanged_until: f64,
}

impl Body {
    /// Body `index` of the scene, at rest, with the scene's pushes on it.
    pub fn new(scene: &Scene, index: usize, pushes: Vec<Push>) -> Body {
        Body {
            mesh: scene.bodies[index].shape.mesh(),
            radius: scene.bodies[index].radius,
            material: scene.bodies[index].material,
            pushes: pushes.into(),
            points: points::neighbours(scene, index),
            active: None,
            neighbours: Neighbours::new(),
            fat_bounds: FatBounds::default(),
            known_until: f64::NEG_INFINITY,
            unchanged_until: f64::NEG_INFINITY,
        }
    }

    /// Its rest shape at the body's scale.
    pub fn rest(&self) -> Rest<'_> {
        self.mesh.at(self.radius)
    }

    /// The data about the body that force terms use; `index` is its index in the scene.
    pub fn on<'a, P>(&'a self, scene: &'a Scene, index: u32, tracks: &'a Tracks, phases: P) -> On<'a, P> {
        let Body { material, neighbours, points, pushes, .. } = self;
        On { scene, index, material, neighbours, points, pushes, tracks, phases }
    }
}

/// The state of a body that isn't at rest.
#[derive(Clone)]
pub(in crate::sim) struct Active {
    /// Index of the body.
    pub body: u32,
    /// The state of its vertices.
    pub state: BodyState,
    /// The conditions for which the active set was selected.
    pub chosen: Chosen,
    /// Bounds on its vertices in this step, and the bodies that can reach it.
    pub bounds: StepBounds,
    /// Statistics of its last step.
    pub statistics: StepStatistics,
}

/// The state of a body's vertices: at the end of the last step if the body is awake, otherwise as of the last time it
/// was needed. Nothing acts on a sleeping body, so the flow advances it to any later time.
#[derive(Clone, Default)]
pub(in crate::sim) struct BodyState {
    /// ω and κ of its vertices.
    pub oscillator: Oscillator,
    /// The response to the body's own motion, which all its vertices share, as of step [`BodyState::carried_as_of`].
    pub carried: State,
    /// The step at whose end [`BodyState::carried`] is valid.
    pub carried_as_of: u64,
    /// The motion of single vertices beyond that.
    pub deformation: Deformation,
    /// Number of times that the steps of its vertices are halved.
    pub halvings: u32,
    /// Bounds over [`BodyState::deformation`], without the shared motion.
    pub state_bounds: StateBounds,
    /// An upper bound of √(|u|² + ω²|x|²) of every vertex, whatever has happened so far: it grows by no more than the
    /// forces that acted on the body [scene unit/s].
    pub bound: f64,
}

/// The conditions for which an active set was selected. It is valid until spheres have moved too far.
#[derive(Clone, Default)]
pub(in crate::sim) struct Chosen {
    /// Where the spheres were when the active set was selected.
    pub references: SmallVec<[Reference; 2]>,
    /// How far the spheres may move before it is selected again [scene unit].
    pub skin: f64,
    /// Whether it has all vertices, because something acts on each of them.
    pub all: bool,
}

/// Bounds on the motion of a body's vertices in a step, and on the spheres that reach them.
#[derive(Clone, Default)]
pub(in crate::sim) struct StepBounds {
    /// Bodies whose spheres can reach it.
    pub reachable: Neighbours,
    /// The largest distance of its vertices from the centre in this step [scene unit].
    pub farthest: f64,
    /// A bound on the acceleration of any vertex by spheres [scene unit/s²].
    pub pull: f64,
    /// The largest distance of its vertices from the centre in this step, or later if nothing else acts [scene unit].
    pub max_reach: f64,
    /// Whether no sphere is near enough to be reached within [`StepBounds::max_reach`].
    pub may_sleep: bool,
}

/// Where a sphere was when an active set was selected.
#[derive(Clone, Copy, Debug)]
pub(in crate::sim) struct Reference {
    /// Index of the body that it belongs to.
    pub body: u32,
    /// Its centre relative to the body's, shifted by the motion that all vertices share [scene unit].
    pub centre: DVec3,
    /// Distance of the sphere's surface from the nearest rest position of the active set [scene unit].
    pub clear: f64,
}

impl Active {
    /// Body `index` of the scene, at rest after `step` steps.
    pub fn new(scene: &Scene, index: usize, step: u64) -> Active {
        Active {
            body: index as u32,
            state: BodyState {
                oscillator: scene.bodies[index].material.oscillator(),
                carried_as_of: step,
                ..BodyState::default()
            },
            chosen: Chosen::default(),
            bounds: StepBounds { may_sleep: true, ..StepBounds::default() },
            statistics: StepStatistics::default(),
        }
    }

    /// Brings all parts of its state to the same time: the end of the last step, or within the next one if an edit has
    /// divided that. `step` is the number of steps taken.
    pub fn settle(&mut self, step: u64, dt: f64, rest: Rest<'_>, arch: Arch) {
        let now = self.now(step, dt, arch);
        if self.state.carried_as_of < step {
            self.state.carried = self.carried_at(now);
        }
        self.state.carried_as_of = step;
        if !self.state.deformation.is_empty() {
            let every = vec![0.0; rest.len()];
            self.state.deformation.choose_active_set(rest, &every, f64::INFINITY, now, &mut Scratch::default());
        }
        (self.chosen, self.statistics) = (Chosen::default(), StepStatistics::default());
    }

    /// Continues with other oscillators.
    pub fn change_oscillator(&mut self, material: &Material, arch: Arch) {
        let oscillator = material.oscillator();
        self.state.oscillator = oscillator;
        self.state.state_bounds = StateBounds::of(&self.state.deformation, oscillator, arch);
        let momentum = self.state.carried.momentum(oscillator.omega) + self.state.state_bounds.momentum;
        self.state.bound = self.state.bound.max(momentum);
    }

    /// Whether nothing has acted on the body yet: every displacement and velocity is exactly zero.
    pub fn is_at_rest(&self) -> bool {
        self.state.deformation.is_empty() && self.state.carried.is_zero()
    }

    /// Whether the body may sleep when nothing acts on it: without a spring, vertices that move may drift anywhere.
    pub fn can_sleep(&self) -> bool {
        self.state.oscillator.omega > 0.0 || self.is_at_rest()
    }

    /// The motion that all its vertices share, at the end of the last step.
    pub fn carried_at(&self, now: Now) -> State {
        let State { x, .. } = self.state.carried;
        // a step that was not completed may have carried it already
        let steps = now.step.saturating_sub(self.state.carried_as_of);
        if steps == 0 || self.state.carried.is_zero() {
            return self.state.carried;
        }
        let flow = now.oscillator.flow(steps as f64 * now.dt);
        let [xx, xu, ux, uu] = flow;
        let momentum = self.state.carried.momentum(now.oscillator.omega);
        let left = (xx.abs() + ux.abs()) * x.length() + (xu.abs() + uu.abs()) * momentum;
        // subnormal numbers are slow to compute with
        if left < REST { State::default() } else { self.state.carried.after(flow) }
    }

    /// The time at which its state is requested.
    pub fn now(&self, step: u64, dt: f64, arch: Arch) -> Now {
        Now { step, dt, oscillator: self.state.oscillator, arch }
    }

    /// An upper bound of |x| of every vertex, now and later if nothing else acts [scene unit]. Unlike |x| itself it
    /// does not oscillate.
    pub fn amplitude(&self) -> f64 {
        let omega = self.state.oscillator.omega;
        let StateBounds { displacement: x, momentum } = StateBounds::of_state(self.state.carried, omega);
        let StateBounds { displacement, momentum: own } = self.state.state_bounds;
        let swings = if omega > 0.0 { (momentum + own) / omega } else { x + displacement };
        swings.max(self.state.deformation.free_vertices.largest)
    }

    /// The largest distance of its vertices from rest within `h` [s] if accelerations of at most `common` and `single`
    /// [scene unit/s²] act on all vertices and on single ones.
    pub fn farthest(&self, common: f64, single: f64, h: f64) -> f64 {
        let [alike, own] = self.bounds_now();
        alike.after(self.state.oscillator, common, h) + own.after(self.state.oscillator, single, h)
    }

    /// Bounds on the shared motion and on the deformation, at the end of the last step.
    fn bounds_now(&self) -> [StateBounds; 2] {
        let omega = self.state.oscillator.omega;
        let (mut alike, mut own) = (StateBounds::of_state(self.state.carried, omega), self.state.state_bounds);
        if self.statistics.substeps == 0 && omega > 0.0 {
            // the flow has continued the oscillation since these bounds were computed
            for state_bounds in [&mut alike, &mut own] {
                state_bounds.displacement = state_bounds.momentum / omega;
            }
        }
        [alike, own]
    }

    /// Whether the equation of motion cannot lead to its state: not finite, or far beyond [`BodyState::bound`]. The
    /// margin leaves room for schemes that are merely inaccurate.
    pub fn has_diverged(&self) -> bool {
        const MARGIN: f64 = 100.0;
        let StateBounds { displacement, momentum } = self.state.state_bounds;
        let alike = StateBounds::of_state(self.state.carried, self.state.oscillator.omega);
        let (x, m) = (alike.displacement + displacement, alike.momentum + momentum);
        !x.is_finite() || !m.is_finite() || m > MARGIN * self.state.bound
    }
}

/// Bounds over the vertices of a body, from which bounds on their motion in a step follow.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::sim) struct StateBounds {
    /// Largest |x| [scene unit].
    pub displacement: f64,
    /// Largest √(|u|² + ω²|x|²) [scene unit/s].
    pub momentum: f64,
}

impl StateBounds {
    /// The bounds of one state.
    pub fn of_state(state: State, omega: f64) -> StateBounds {
        StateBounds { displacement: state.x.length(), momentum: state.momentum(omega) }
    }

    /// The bounds of a state; NaN if any of it is NaN.
    pub fn of(deformation: &Deformation, oscillator: Oscillator, arch: Arch) -> StateBounds {
        let omega_squared = oscillator.omega * oscillator.omega;
        let [x2, m2] = arch.dispatch(Largest { active_set: &deformation.active_set, omega_squared });
        let free_vertices = deformation.free_vertices.largest;
        let swings = if free_vertices > 0.0 { oscillator.omega * free_vertices } else { 0.0 };
        StateBounds { displacement: larger(x2.sqrt(), free_vertices), momentum: larger(m2.sqrt(), swings) }
    }

    /// The largest distance of a vertex from its rest position within `h` [s] under at most `force` [scene unit/s²].
    ///
    /// Without force √(|u|² + ω²|x|²) never grows, so |x| grows by no more than this bound times h, and never exceeds it
    /// over ω. A force f adds ∫ S(h − t) f dt, and the response S(t) to an impulse is at most t and at most 1/ω.
    pub fn after(&self, oscillator: Oscillator, force: f64, h: f64) -> f64 {
        let (pulled, travelled) = (0.5 * h * h, self.displacement + self.momentum * h);
        if oscillator.omega > 0.0 {
            travelled.min(self.momentum / oscillator.omega) + force * pulled.min(h / oscillator.omega)
        } else {
            travelled + force * pulled
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compares the bound with the closed form under a constant force. It is never smaller, and from rest at most a
    /// tenth larger within a quarter of a time scale.
    #[test]
    fn vertices_stay_within_the_bound_under_a_constant_force() {
        for (omega, damping) in [(0.0, 0.0), (12.0, 0.0), (12.0, 1.5), (2.0, 9.0)] {
            let oscillator = Oscillator { omega, damping };
            for (x, u) in [(0.0, 0.0), (0.3, 0.0), (-0.2, 1.5), (0.1, -4.0)] {
                let bounds = StateBounds { displacement: f64::abs(x), momentum: f64::hypot(u, omega * x) };
                for h in [1e-3, 1.0 / 60.0, 0.08, 0.7, 10.0] {
                    let (force, propagator) = (70.0, oscillator.propagator(h));
                    let reached = propagator.xx * x + propagator.xu * u + propagator.x[0] * force;
                    let bound = bounds.after(oscillator, force, h);
                    assert!(reached.abs() <= bound * (1.0 + 1e-12), "{omega} {damping} {x} {u} {h}: {reached} {bound}");
                    if bounds.momentum == 0.0 && (omega + 2.0 * damping) * h < 1.0 / 4.0 {
                        assert!(bound <= 1.1 * reached, "{omega} {damping} {h}: {bound} for {reached}");
                    }
                }
            }
        }
    }
}
