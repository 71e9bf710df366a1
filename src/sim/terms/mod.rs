//! Force terms: everything that acts on the vertices of a body except their own oscillators, one file per term.
//!
//! A term contributes in the three kinds that integrators know, see [`Surroundings`]: the same acceleration for all
//! vertices, an acceleration times a weight per vertex, and one that depends on a vertex's position. It also gives a
//! bound on its contribution, and the instants at which it jumps.
//! Everything that sums what acts on a body (integrators, motion bounds, arrows, energy, the stages of a step) uses the
//! table below.

pub(crate) mod carry;
mod free;
pub(crate) mod oscillator;
pub(super) mod points;
pub(super) mod push;
pub(super) mod spheres;

use glam::DVec3;

use super::{integrator::explicit::Scheme, neighbours::Neighbour, prescribed::tracks::Tracks, span::Span};
use crate::{
    model::{influence::Weight, phase::Phase},
    scene::{Material, Push, Scene, path::Kinematics},
};
pub use push::Weighted;
pub use spheres::{Origin, Source, Sphere};

macro_rules! terms {
    ($($module:ident::$Term:ident => [$($(#[$doc:meta])* $Cause:ident: $name:literal),*];)*) => {
        /// Why a vertex accelerates.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Cause {
            $($($(#[$doc])* $Cause,)*)*
            /// The sum of all causes: x″.
            Net,
        }

        impl Cause {
            /// All causes; the sum is last.
            pub const ALL: [Cause; Cause::Net as usize + 1] = [$($(Cause::$Cause,)*)* Cause::Net];

            /// The name used in recordings. The unit of every cause is scene unit/s².
            pub fn name(self) -> &'static str {
                match self {
                    $($(Cause::$Cause => $name,)*)*
                    Cause::Net => "net",
                }
            }

            /// The cause of the force of a body's sphere, by the phase of the pair and the signed strength. A core with a
            /// gradual rim attracts on the outer side of the rim and repels on the inner side, whatever the phase is.
            pub fn of_sphere(phase: Phase, strength: f64) -> Cause {
                match phase {
                    _ if strength > 0.0 => Cause::Attraction,
                    Phase::Apart => Cause::Repulsion,
                    Phase::Merged | Phase::Core => Cause::Core,
                }
            }

            /// The causes that can occur in a scene, in the order of [`Cause::ALL`].
            pub fn of(scene: &Scene) -> impl Iterator<Item = Cause> + use<> {
                let (is_coupled, has_points) = (scene.is_coupled(), !scene.points.is_empty());
                Cause::ALL.into_iter().filter(move |cause| match cause {
                    Cause::Gravity | Cause::Plane | Cause::Reaction => is_coupled,
                    Cause::Point => has_points,
                    _ => true,
                })
            }
        }

        /// The acceleration that all vertices of a body share at an instant, given its motion [scene unit/s²].
        pub(crate) fn uniform(scene: &Scene, material: &Material, motion: &Kinematics) -> DVec3 {
            let mut sum = DVec3::ZERO;
            $(sum += $module::$Term::uniform(scene, material, motion).map_or(DVec3::ZERO, |(_, force)| force);)*
            sum
        }

        /// The same, by cause.
        pub(crate) fn uniform_by_cause(
            scene: &Scene,
            material: &Material,
            motion: &Kinematics,
        ) -> impl Iterator<Item = (Cause, DVec3)> + use<> {
            [$($module::$Term::uniform(scene, material, motion)),*].into_iter().flatten()
        }

        /// The accelerations of a free body on which nothing else acts, by cause [scene unit/s²].
        pub(crate) fn free_fall_by_cause(scene: &Scene) -> impl Iterator<Item = (Cause, DVec3)> + use<> {
            [$($module::$Term::free_fall(scene)),*].into_iter().flatten()
        }

        impl<P: Phases> On<'_, P> {
            /// Collects what acts on the body at an instant; no vertex is farther from its centre than `farthest`
            /// [scene unit].
            pub fn surroundings_into(&self, moment: Moment, farthest: f64, surroundings: &mut Surroundings) {
                let motion = self.tracks.path(self.index as usize).at(moment.time);
                surroundings.clear();
                surroundings.uniform.extend(uniform_by_cause(self.scene, self.material, &motion));
                $($module::$Term::at(self, moment, &motion, farthest, surroundings);)*
            }

            /// Collects the influence spheres that can reach the body throughout a part of a step without jumps, considering
            /// the neighbours `near`. What else acts there is the same for all vertices ([`uniform`]) or constant for each
            /// ([`PushField`](push::PushField)).
            pub fn over(&self, near: &[Neighbour], part: Span, acting: &mut Vec<Sphere>) {
                acting.clear();
                $($module::$Term::over(self, near, part, acting);)*
            }

            /// A bound on the acceleration of any vertex during `span` by terms that do not depend on other bodies
            /// [scene unit/s²].
            pub fn own_bound(&self, span: Span) -> f64 {
                let mut sum = 0.0;
                $(sum += $module::$Term::own_bound(self, span);)*
                sum
            }

            /// Appends the instants within `span` at which a term jumps for the body, considering the neighbours
            /// `near`.
            pub fn jumps(&self, near: &[Neighbour], span: Span, jumps: &mut Vec<f64>) {
                $($module::$Term::jumps(self, near, span, jumps);)*
            }
        }
    };
}

// In the order in which their accelerations are summed. For bodies on paths, a new term is a file beside this one and a line
// here; if all vertices of a body share its acceleration, that holds for free bodies and the elastic models, too. Terms that
// depend on positions are summed by free bodies (`free::force`, `coupled::explicit`) and the elastic models (`models::elastic`)
// themselves.
terms! {
    spheres::Spheres => [
        /// (3.4): influence spheres of merged bodies.
        Attraction: "attraction",
        /// (3.5): influence spheres of bodies that are apart.
        Repulsion: "repulsion",
        /// (3.5): influence spheres of bodies in their core.
        Core: "core"
    ];
    points::Points => [
        /// Force points (3.1.2), by (3.4) or (3.5).
        Point: "point"
    ];
    oscillator::Springs => [
        /// −ω²x of (3.2).
        Restoring: "restoring",
        /// −2κx′ of (3.2).
        Damping: "damping"
    ];
    push::Pushes => [
        /// Pushes (Fig. 4.1).
        Push: "push"
    ];
    carry::Carry => [
        /// −carry: the body's own motion.
        Carry: "carry"
    ];
    free::Coupled => [
        /// Gravity, of free bodies.
        Gravity: "gravity",
        /// Planes: their pressure and friction.
        Plane: "plane",
        /// Of free bodies: the reaction to the forces of their spheres on other bodies' vertices.
        Reaction: "reaction"
    ];
}

/// The acceleration of a free body on which nothing else acts [scene unit/s²].
pub(crate) fn free_fall(scene: &Scene) -> DVec3 {
    free_fall_by_cause(scene).map(|(_, acceleration)| acceleration).sum()
}

/// The accelerations at `t` [s] that all vertices of a body on a path share, by cause; none of a free body
/// [scene unit/s²].
pub(crate) fn uniform_on(scene: &Scene, index: usize, t: f64) -> impl Iterator<Item = (Cause, DVec3)> + use<> {
    let body = &scene.bodies[index];
    let on_path = body.path().map(|path| uniform_by_cause(scene, &body.material, &path.at(t)));
    on_path.into_iter().flatten()
}

/// A term's contribution to the acceleration of a body's vertices. Every method defaults to no contribution.
trait Term {
    /// The acceleration that all vertices of a body share at an instant, given its motion [scene unit/s²].
    fn uniform(_scene: &Scene, _material: &Material, _motion: &Kinematics) -> Option<(Cause, DVec3)> {
        None
    }

    /// The acceleration of all free bodies [scene unit/s²].
    fn free_fall(_scene: &Scene) -> Option<(Cause, DVec3)> {
        None
    }

    /// Adds the other contributions at an instant; no vertex is farther from the body's centre than `farthest`
    /// [scene unit].
    fn at<P: Phases>(_: &On<'_, P>, _: Moment, _motion: &Kinematics, _farthest: f64, _: &mut Surroundings) {}

    /// Adds its influence spheres for a whole part of a step without jumps, considering the neighbours `near`.
    fn over<P: Phases>(_: &On<'_, P>, _near: &[Neighbour], _part: Span, _: &mut Vec<Sphere>) {}

    /// A bound on the acceleration of any vertex during `span` by contributions that do not depend on other bodies
    /// [scene unit/s²].
    fn own_bound<P>(_: &On<'_, P>, _span: Span) -> f64 {
        0.0
    }

    /// Appends the instants within `span` at which the contribution jumps or has a kink [s].
    fn jumps<P: Phases>(_: &On<'_, P>, _near: &[Neighbour], _span: Span, _: &mut Vec<f64>) {}
}

/// Whether what acts from one instant to another [s] is felt in a step. Explicit schemes evaluate forces at its end as well.
pub(super) fn acts_during([start, end]: [f64; 2], scene: &Scene, span: Span) -> bool {
    let begins = start < span.end || start == span.end && Scheme::of(scene.integrator).is_some();
    begins && span.start < end
}

/// A body that terms act on, with everything that they may depend on.
#[derive(Clone, Copy)]
pub(super) struct On<'a, P> {
    pub scene: &'a Scene,
    /// Its index in the scene.
    pub index: u32,
    /// The constants of its oscillators.
    pub material: &'a Material,
    /// Nearby bodies.
    pub neighbours: &'a [Neighbour],
    /// The force points that act on it at some time.
    pub points: &'a [Neighbour],
    /// The scene's pushes on it.
    pub pushes: &'a [Push],
    pub tracks: &'a Tracks,
    /// The phases of its pairs.
    pub phases: P,
}

/// The phases of a body's pairs during a step.
pub(super) trait Phases {
    /// The phase of the pair from `t` on.
    fn from(&self, index: u32, neighbour: &Neighbour, t: f64) -> Phase;

    /// Appends the times at which the phase changes.
    fn changes(&self, index: u32, neighbour: &Neighbour, times: &mut Vec<f64>);
}

/// An instant at which forces are evaluated.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moment {
    /// Time of the instant [s].
    pub time: f64,
    /// Pairs have the phases that hold from this time on [s].
    pub phases_at: f64,
    /// Pushes and force points act that do so at this time [s].
    pub windows_at: f64,
}

/// What acts on the vertices of one body at one instant, except their own oscillators: the right-hand side of the
/// equation of motion beyond (3.2), in body coordinates.
#[derive(Clone, Debug, Default)]
pub struct Surroundings {
    /// Accelerations that all vertices share [scene unit/s²], one per cause.
    pub uniform: Vec<(Cause, DVec3)>,
    /// Accelerations with a weight per vertex.
    pub weighted: Vec<Weighted>,
    /// The influence spheres that can reach the body: accelerations that depend on a vertex's position.
    pub sources: Vec<Source>,
}

impl Surroundings {
    fn clear(&mut self) {
        self.uniform.clear();
        self.weighted.clear();
        self.sources.clear();
    }

    /// The acceleration of the vertex with rest position `rest`, direction `facing` and displacement `x`
    /// [scene unit/s²].
    #[inline]
    pub fn acceleration(&self, weight: Weight, rest: DVec3, facing: DVec3, x: DVec3) -> DVec3 {
        let mut acceleration = DVec3::ZERO;
        let position = rest + x;
        for source in &self.sources {
            acceleration += source.acceleration(weight, position);
        }
        for weighted in &self.weighted {
            acceleration += weighted.acceleration(facing);
        }
        for (_, force) in &self.uniform {
            acceleration += *force;
        }
        acceleration
    }

    /// Whether nothing acts: a body at rest stays at rest.
    pub fn is_idle(&self) -> bool {
        self.sources.iter().all(|source| source.strength == 0.0)
            && self.weighted.iter().all(|weighted| weighted.strength == 0.0)
            && self.uniform.is_empty()
    }
}
