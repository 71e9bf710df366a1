//! One step of one vertex: exponential collocation.

use glam::DVec3;

use super::{
    super::State,
    course::{Course, Moment},
    lanes::Lanes,
    weights::Weights,
};
use crate::{model::influence::Weight, scene::path::Bounds};

/// Corrections after which a step that has not settled is given up.
const MOST_SWEEPS: usize = 6;

/// A step: its weights, and what acts at its nodes and in its middle.
#[derive(Clone, Debug, Default)]
pub struct Step {
    /// Where it starts [s].
    pub start: f64,
    /// Of the step's length.
    pub weights: Weights,
    /// At the four nodes, and in the middle.
    pub moments: [Moment; 5],
    /// Bounds of the motion of the centre of each sphere relative to that of the body.
    pub relative: Vec<Bounds>,
}

/// A vertex, and what acts on it all through the step. Those that step together all know what they are inside of, or none.
#[derive(Clone, Copy, Debug)]
pub struct Vertex {
    /// Rest position l [scene unit].
    pub rest: DVec3,
    /// Pushes [scene unit/s²].
    pub push: DVec3,
    /// Which spheres it is inside of, a bit each, if that is known and is to be taken as it is throughout the step;
    /// otherwise the weight is cut off at the rim where the vertex is found.
    pub inside: Option<u64>,
}

/// Where a step leads.
#[derive(Clone, Copy, Debug)]
pub struct Outcome {
    /// State at the end.
    pub end: State,
    /// Acceleration by forces other than the oscillator's at the start and at the end [scene unit/s²].
    pub forces: [DVec3; 2],
    /// Estimate of the error of the displacement that the step makes [scene unit].
    pub error: f64,
}

/// F: influence, push and carry, of each vertex for its displacement `x` at one of the step's moments
/// [scene unit/s²].
#[inline(always)]
fn force<const N: usize>(course: &Course<'_>, group: &Group<N>, moment: &Moment, x: Lanes<N>) -> Lanes<N> {
    let position = group.rest + x;
    let mut force = group.push - Lanes::splat(moment.carry);
    let mut spheres = course.spheres.iter().zip(&moment.centres);
    if let Some(mut inside) = group.inside {
        // The linear weight goes on smoothly beyond the rim: the step then has no kink in it.
        for (sphere, centre) in spheres.by_ref().take(64) {
            if inside.iter().any(|bits| bits & 1 == 1) {
                let to_centre = Lanes::splat(*centre) - position;
                let mut pull = to_centre.length_squared();
                for i in 0..N {
                    let strength = if inside[i] & 1 == 1 { sphere.strength } else { 0.0 };
                    pull[i] = strength * (1.0 - pull[i].sqrt() * sphere.inverse_radius);
                }
                force.add_scaled(&to_centre, &pull);
            }
            for bits in &mut inside {
                *bits >>= 1;
            }
        }
    }
    for (sphere, centre) in spheres {
        let to_centre = Lanes::splat(*centre) - position;
        let mut pull = to_centre.length_squared();
        for pull in &mut pull {
            *pull = sphere.strength * course.weight().at(pull.sqrt() * sphere.inverse_radius);
        }
        force.add_scaled(&to_centre, &pull);
    }
    force
}

/// Vertices that take a step together.
struct Group<const N: usize> {
    rest: Lanes<N>,
    push: Lanes<N>,
    inside: Option<[u64; N]>,
}

impl Step {
    /// Sets the step up.
    pub fn prepare(&mut self, course: &Course<'_>, start: f64, weights: Weights) {
        let h = weights.h;
        let end = start + h;
        self.start = start;
        self.weights = weights;
        let [_, a, b, _] = super::weights::NODES;
        let times = [start, start + a * h, start + b * h, end, start + 0.5 * h];
        for (moment, t) in self.moments.iter_mut().zip(times) {
            course.look(t, moment);
        }
        self.relative.clear();
        self.relative.extend((0..course.spheres.len()).map(|j| course.relative_bounds(j, start, end)));
    }

    /// Where the step ends [s].
    pub fn end(&self) -> f64 {
        self.start + self.weights.h
    }

    /// Takes the step with several vertices, so exactly that the errors it estimates are below `wanted` [scene unit] if
    /// corrections can do that.
    ///
    /// The force is taken as the cubic through its values at the four Lobatto nodes; against the exact oscillator that
    /// is exponential collocation (Hochbruck & Ostermann 2005). The forces depend on the displacements at the nodes and
    /// these on the forces: predicted from the nodes before, then corrected (Picard), once at least, which makes it of
    /// order five; corrected to the end it is of order six. Each correction leaves of the last change at most the part
    /// that the stiffness of the influence lets through.
    pub fn take<const N: usize>(
        &self,
        course: &Course<'_>,
        vertices: &[Vertex; N],
        states: &[State; N],
        stiffness: f64,
        wanted: f64,
    ) -> [Outcome; N] {
        let weights = &self.weights;
        let group = Group {
            rest: Lanes::from_fn(|i| vertices[i].rest),
            push: Lanes::from_fn(|i| vertices[i].push),
            inside: vertices[0].inside.map(|_| vertices.map(|vertex| vertex.inside.unwrap_or_default())),
        };
        let (x, u) = (Lanes::from_fn(|i| states[i].x), Lanes::from_fn(|i| states[i].u));
        let force_at = |node: usize, x: Lanes<N>| force(course, &group, &self.moments[node], x);

        let mut forces = [force_at(0, x), Lanes::ZERO, Lanes::ZERO, Lanes::ZERO];
        for node in 1..4 {
            let stage = &weights.nodes[node];
            forces[node] = force_at(node, Lanes::combine(stage.xx, &x, stage.xu, &u, &stage.predict, &forces));
        }
        // What an error of the force is in the displacement, now or after the oscillator has taken the velocity up.
        let gain = weights.constant.abs() + weights.h * weights.swing;
        let mut unsettled = [f64::INFINITY; N];
        for _ in 0..MOST_SWEEPS {
            let mut change = [0.0; N];
            for node in 1..4 {
                let stage = &weights.nodes[node];
                let corrected = force_at(node, Lanes::combine(stage.xx, &x, stage.xu, &u, &stage.force, &forces));
                let by = (corrected - forces[node]).length_squared();
                for i in 0..N {
                    change[i] = f64::max(change[i], by[i]);
                }
                forces[node] = corrected;
            }
            for i in 0..N {
                unsettled[i] = stiffness * weights.constant.abs() * change[i].sqrt() * gain;
            }
            if unsettled.iter().all(|&unsettled| unsettled <= 0.25 * wanted) {
                break;
            }
        }

        // How far the true force in the middle is from the cubic says how much a cubic leaves out.
        let middle = &weights.middle;
        let found = force_at(4, Lanes::combine(middle.xx, &x, middle.xu, &u, &middle.force, &forces));
        let cubic = Lanes::combine(0.0, &x, 0.0, &u, &weights.polynomial, &forces);
        let left_out = (found - cubic).length_squared();
        let last = &weights.nodes[3];
        let end_x = Lanes::combine(last.xx, &x, last.xu, &u, &last.force, &forces);
        let end_u = Lanes::combine(weights.ux, &x, weights.uu, &u, &weights.velocity, &forces);
        std::array::from_fn(|i| Outcome {
            end: State { x: end_x.lane(i), u: end_u.lane(i) },
            forces: [forces[0].lane(i), forces[3].lane(i)],
            error: unsettled[i] + 0.1 * left_out[i].sqrt() * gain,
        })
    }
}

/// Whether the weight has a kink at the rim that has to be stepped around.
pub fn has_kink(weight: Weight) -> bool {
    weight == Weight::Linear
}
