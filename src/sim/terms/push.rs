//! Pushes (Fig. 4.1): vertices that face a push accelerate along it.

use glam::DVec3;

use super::{Acting, Cause, Moment, On, Phases, Surroundings, Term};
use crate::{
    scene::{self, Scene, path::Kinematics},
    sim::{neighbours::Neighbour, span::Span},
};

/// An acceleration that acts on each vertex in proportion to how squarely the vertex faces it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weighted {
    /// The cause that it counts as.
    pub cause: Cause,
    /// Unit direction d.
    pub direction: DVec3,
    /// Acceleration of a vertex that faces it squarely [scene unit/s²]; 0 while it does not act.
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

fn weighted(push: &scene::Push, strength: f64) -> Weighted {
    Weighted { cause: Cause::Push, direction: push.direction, strength }
}

impl Term for Pushes {
    fn at<P: Phases>(on: &On<'_, P>, moment: Moment, _: &Kinematics, _: f64, surroundings: &mut Surroundings) {
        surroundings.weighted.extend(on.pushes.acting(moment.time).map(|push| weighted(push, push.strength)));
    }

    fn over<P: Phases>(on: &On<'_, P>, _: &[Neighbour], part: Span, acting: &mut Acting) {
        let inside = part.start + 0.5 * part.length();
        let acts = |push: &scene::Push| push.start <= inside && inside < push.end();
        let strength = |push: &scene::Push| if acts(push) { push.strength } else { 0.0 };
        acting.weighted.extend(on.pushes.shared().iter().map(|push| weighted(push, strength(push))));
    }

    fn own_bound<P>(on: &On<'_, P>, span: Span) -> f64 {
        on.pushes.bound(span)
    }

    fn jumps<P: Phases>(on: &On<'_, P>, _: &[Neighbour], span: Span, jumps: &mut Vec<f64>) {
        on.pushes.jumps(span, jumps);
    }

    fn starts(scene: &Scene, starts: &mut Vec<(f64, u32)>) {
        starts.extend(scene.pushes.iter().map(|push| (push.start, push.body as u32)));
    }
}
