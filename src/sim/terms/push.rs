//! Pushes (Fig. 4.1): for a time, vertices that face a push are accelerated along it, in proportion to how squarely they
//! face it. The acceleration of a vertex is constant while the same pushes act.

use glam::DVec3;

use super::{Cause, Moment, On, Phases, Surroundings, Term, acts_during};
use crate::{
    geometry::Rest,
    scene::{Push, path::Kinematics},
    sim::{integrator::exponential::course::Local, neighbours::Neighbour, numerics::arrays::Vectors, span::Span},
};

/// An acceleration that acts on each vertex in proportion to how squarely the vertex faces it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weighted {
    /// The cause that it counts as.
    pub cause: Cause,
    /// Unit direction d.
    pub direction: DVec3,
    /// Acceleration of a vertex that faces it squarely [scene unit/s²].
    pub strength: f64,
}

impl Weighted {
    /// The acceleration of a vertex whose rest position has the direction `facing` [scene unit/s²].
    #[inline]
    pub fn acceleration(&self, facing: DVec3) -> DVec3 {
        self.direction * (self.strength * f64::max(0.0, -facing.dot(self.direction)))
    }
}

pub struct Pushes;

/// The pushes that act at `t` [s].
pub(in crate::sim) fn acting(pushes: &[Push], t: f64) -> impl Iterator<Item = Weighted> {
    pushes.iter().filter(move |push| push.acts_at(t)).map(Weighted::from)
}

/// Whether a push acts at some time within `span`.
pub fn any_acts(pushes: &[Push], span: Span) -> bool {
    pushes.iter().any(|push| push.start < span.end && span.start < push.end())
}

/// The accelerations of some vertices of a body by the pushes on it, which are constant between the instants at which one
/// begins or ends.
#[derive(Clone, Debug, Default)]
pub struct PushField {
    /// The pushes that act at some time within the step, and whether each is part of the accelerations.
    pushes: Vec<(Push, bool)>,
    /// In the order of the vertices, padded [scene unit/s²].
    accelerations: Vectors,
}

impl PushField {
    /// Begins a step over `span` of `vertices`, with accelerations padded to a multiple of `lanes`. Returns the
    /// number of pushes that act at some time within the step.
    pub fn begin(&mut self, pushes: &[Push], span: Span, vertices: &[u32], lanes: usize) -> usize {
        let within = pushes.iter().filter(|push| push.start < span.end && span.start < push.end());
        self.pushes.clear();
        self.pushes.extend(within.map(|&push| (push, false)));
        self.accelerations.reset(vertices.len().next_multiple_of(lanes));
        self.pushes.len()
    }

    /// Updates the accelerations to those at `t` [s], adding the pushes that have begun and subtracting those that have
    /// ended. Returns the number of these.
    pub fn advance(&mut self, t: f64, rest: Rest<'_>, vertices: &[u32]) -> usize {
        let mut changes = 0;
        for (push, is_in) in &mut self.pushes {
            let acts = push.acts_at(t);
            if acts != *is_in {
                *is_in = acts;
                changes += 1;
                let sign = if acts { 1.0 } else { -1.0 };
                let weighted = Weighted { strength: sign * push.strength, ..Weighted::from(&*push) };
                for (i, &vertex) in vertices.iter().enumerate() {
                    let acceleration = weighted.acceleration(rest.direction(vertex as usize));
                    self.accelerations.set(i, self.accelerations.get(i) + acceleration);
                }
            }
        }
        changes
    }

    /// The accelerations, unless no push acts now.
    pub fn local(&self) -> Option<Local<'_>> {
        let largest = || self.accelerations.iter().map(DVec3::length_squared).fold(0.0, f64::max).sqrt();
        let any = self.pushes.iter().any(|&(_, is_in)| is_in);
        any.then(|| Local { accelerations: &self.accelerations, largest: largest() })
    }
}

impl From<&Push> for Weighted {
    fn from(push: &Push) -> Weighted {
        Weighted { cause: Cause::Push, direction: push.direction, strength: push.strength }
    }
}

impl Term for Pushes {
    fn at<P: Phases>(on: &On<'_, P>, moment: Moment, _: &Kinematics, _: f64, surroundings: &mut Surroundings) {
        surroundings.weighted.extend(acting(on.pushes, moment.windows_at));
    }

    fn own_bound<P>(on: &On<'_, P>, span: Span) -> f64 {
        let acting = on.pushes.iter().filter(|push| acts_during([push.start, push.end()], on.scene, span));
        acting.map(|push| push.strength.abs()).sum()
    }

    fn jumps<P: Phases>(on: &On<'_, P>, _: &[Neighbour], span: Span, jumps: &mut Vec<f64>) {
        let edges = on.pushes.iter().flat_map(|push| [push.start, push.end()]);
        jumps.extend(edges.filter(|&t| span.holds(t)));
    }
}
