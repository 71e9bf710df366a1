//! Force terms: what acts on the vertices of a body beyond the inertia of its own displacement, one file a term.
//!
//! A term says what it adds in the three kinds that integrators know, see [`Surroundings`]: the same acceleration for all
//! vertices, one times a weight of each vertex, one that depends on where a vertex is. It says how much that can be at most,
//! when it jumps, and when it first needs a body that is at rest. All who add up what acts on a body, the integrators, the
//! bounds on what vertices can do, arrows, energy, the inside of a step, ask the table below; a new term is a file beside this
//! one and its line there.

mod carry;
pub(super) mod oscillator;
mod push;
pub(super) mod spheres;

use glam::DVec3;

use super::{Span, neighbours::Neighbour, tracks::Tracks};
use crate::{
    model::{
        influence::{self, Weight},
        phase::Phase,
    },
    scene::{self, Scene, path::Kinematics},
};
pub use push::Weighted;
pub use spheres::{Source, Sphere};

macro_rules! terms {
    ($($module:ident::$Term:ident => [$($(#[$doc:meta])* $Cause:ident: $name:literal),*];)*) => {
        /// Why a vertex accelerates.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Cause {
            $($($(#[$doc])* $Cause,)*)*
            /// The sum of all: x″.
            Net,
        }

        impl Cause {
            /// All causes, the sum last.
            pub const ALL: [Cause; Cause::Net as usize + 1] = [$($(Cause::$Cause,)*)* Cause::Net];

            /// The name used in recordings. The unit of all is scene unit/s².
            pub fn name(self) -> &'static str {
                match self {
                    $($(Cause::$Cause => $name,)*)*
                    Cause::Net => "net",
                }
            }
        }

        /// What is the same for all vertices of body `index`, which moves like that, at an instant [scene unit/s²].
        pub(super) fn uniform(scene: &Scene, index: usize, motion: &Kinematics) -> DVec3 {
            let mut sum = DVec3::ZERO;
            $(sum += $module::$Term::uniform(scene, index, motion).map_or(DVec3::ZERO, |(_, force)| force);)*
            sum
        }

        impl<P: Phases> On<'_, P> {
            /// What acts on the body at an instant, with no vertices farther from its centre than `farthest` [scene unit].
            pub fn surroundings_into(&self, moment: Moment, farthest: f64, surroundings: &mut Surroundings) {
                let motion = self.tracks.track(self.scene, self.index as usize).at(moment.time);
                surroundings.clear();
                $(surroundings.uniform.extend($module::$Term::uniform(self.scene, self.index as usize, &motion));)*
                $($module::$Term::at(self, moment, &motion, farthest, surroundings);)*
            }

            /// What acts all through a part of a step in which nothing jumps, of what `near` can bring.
            pub fn over(&self, near: &[Neighbour], part: Span, acting: &mut Acting) {
                acting.clear();
                $($module::$Term::over(self, near, part, acting);)*
            }

            /// A bound of the acceleration of any vertex during `span` by what acts wherever other bodies are
            /// [scene unit/s²].
            pub fn own_bound(&self, span: Span) -> f64 {
                let mut sum = 0.0;
                $(sum += $module::$Term::own_bound(self, span);)*
                sum
            }

            /// Adds the instants within `span` at which something jumps for the body or by what `near` bring.
            pub fn jumps(&self, near: &[Neighbour], span: Span, jumps: &mut Vec<f64>) {
                $($module::$Term::jumps(self, near, span, jumps);)*
            }
        }

        /// Adds when terms begin to act on bodies by themselves, and on which [s].
        pub(super) fn starts(scene: &Scene) -> Vec<(f64, u32)> {
            let mut starts = Vec::new();
            $($module::$Term::starts(scene, &mut starts);)*
            starts.sort_by(|a, b| a.0.total_cmp(&b.0));
            starts
        }
    };
}

// In the order in which their accelerations are added up. A new term is a file beside this one and a line here.
terms! {
    spheres::Spheres => [
        /// (3.4): influence spheres of merged bodies.
        Attraction: "attraction",
        /// (3.5): influence spheres of bodies apart.
        Repulsion: "repulsion",
        /// The same of bodies in their core.
        Core: "core"
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
}

/// What a term adds to the acceleration of the vertices of a body; nothing of what it doesn't say.
trait Term {
    /// What is the same for all vertices of body `index`, which moves like that, at an instant [scene unit/s²].
    fn uniform(_scene: &Scene, _index: usize, _motion: &Kinematics) -> Option<(Cause, DVec3)> {
        None
    }

    /// Adds what else acts on a body at an instant, with no vertices farther from its centre than `farthest` [scene unit].
    fn at<P: Phases>(_: &On<'_, P>, _: Moment, _motion: &Kinematics, _farthest: f64, _: &mut Surroundings) {}

    /// Adds the same for all of a part of a step in which nothing jumps, of what `near` can bring.
    fn over<P: Phases>(_: &On<'_, P>, _near: &[Neighbour], _part: Span, _: &mut Acting) {}

    /// A bound of the acceleration of any vertex during `span` by what acts wherever other bodies are [scene unit/s²].
    fn own_bound<P>(_: &On<'_, P>, _span: Span) -> f64 {
        0.0
    }

    /// Adds the instants within `span` at which what it adds jumps, or has a kink [s].
    fn jumps<P: Phases>(_: &On<'_, P>, _near: &[Neighbour], _span: Span, _: &mut Vec<f64>) {}

    /// Adds when it begins to act on bodies by itself, and on which [s].
    fn starts(_: &Scene, _: &mut Vec<(f64, u32)>) {}
}

/// A body that terms act on, and what they may know about it.
#[derive(Clone, Copy)]
pub(super) struct On<'a, P> {
    pub scene: &'a Scene,
    /// Its index in the scene.
    pub index: u32,
    /// Bodies that are near it.
    pub neighbours: &'a [Neighbour],
    /// The scene's pushes on it.
    pub pushes: &'a [scene::Push],
    pub tracks: &'a Tracks,
    /// The phases of its pairs.
    pub phases: P,
}

impl<'a, P> On<'a, P> {
    /// The same with phases from elsewhere.
    pub fn with_phases<Q>(self, phases: Q) -> On<'a, Q> {
        let On { scene, index, neighbours, pushes, tracks, .. } = self;
        On { scene, index, neighbours, pushes, tracks, phases }
    }
}

/// The phases of the pairs of a body in the course of a step.
pub(super) trait Phases {
    /// From `t` on.
    fn from(&self, index: u32, neighbour: &Neighbour, t: f64) -> Phase;

    /// Adds when it changes.
    fn changes(&self, index: u32, neighbour: &Neighbour, times: &mut Vec<f64>);
}

/// An instant at which it is wanted what acts.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moment {
    /// When [s].
    pub time: f64,
    /// Pairs have the phases that they have from this time on [s].
    pub phases_at: f64,
}

/// What acts on the vertices of one body at one instant, but for its own oscillators: the right-hand side of the equation
/// of motion beyond (3.2), in body coordinates.
#[derive(Clone, Debug, Default)]
pub struct Surroundings {
    /// What is the same for all vertices [scene unit/s²], once a cause.
    pub uniform: Vec<(Cause, DVec3)>,
    /// What acts on each vertex by a weight of its own.
    pub weighted: Vec<Weighted>,
    /// What depends on where a vertex is: the influence spheres that can reach the body.
    pub sources: Vec<Source>,
}

impl Surroundings {
    fn clear(&mut self) {
        self.uniform.clear();
        self.weighted.clear();
        self.sources.clear();
    }

    /// The acceleration of the vertex with rest position `rest`, whose direction is `facing`, and displacement `x`
    /// [scene unit/s²].
    #[inline]
    pub fn acceleration(&self, weight: Weight, rest: DVec3, facing: DVec3, x: DVec3) -> DVec3 {
        let mut acceleration = DVec3::ZERO;
        let position = rest + x;
        for source in &self.sources {
            let to_centre = source.centre - position;
            acceleration += influence::acceleration(weight, source.strength, source.sphere_radius, to_centre);
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

/// What acts on the vertices of a body all through a part of a step in which nothing jumps, but for what is the same for all
/// of them; see [`uniform`].
#[derive(Clone, Debug, Default)]
pub(super) struct Acting {
    /// The body's weighted terms, those that do not act now with strength zero.
    pub weighted: Vec<Weighted>,
    /// The spheres that can reach it.
    pub spheres: Vec<Sphere>,
}

impl Acting {
    fn clear(&mut self) {
        self.weighted.clear();
        self.spheres.clear();
    }
}
