//! The simulation: a [`World`] built from a scene, its time step, and access to its state.
//!
//! | contents | module |
//! | --- | --- |
//! | the world and its step; a body and a pair at its current time | `world`, `body` |
//! | the two solvers, and what both read; an interval of time; the state of vertices | `solver`, `span`, `state` |
//! | the solver of bodies on paths | `prescribed` |
//! | the solver of coupled scenes: free bodies, planes, cores with a width | `coupled` |
//! | free bodies as plain data, which `coupled` steps | [`free`] |
//! | what acts on vertices, one file per force term | `terms` |
//! | how vertices of a body on a path are advanced | [`integrator`] |
//! | when pairs merge, split, enter and leave their core | [`events`] |
//! | which bodies are near each other, by a grid | `neighbours`, [`reach`] |
//! | nodes, polynomials, responses of oscillators, roots, SIMD lanes | `numerics` |
//! | changes between steps; handles of bodies | `edit`, `handle` |
//! | observation: forces by cause, energy; what is computed when asked for | `observe`, `on_request` |
//! | what a step reports | `report` |
//! | how much work a step may do | `work` |
//! | hash of the exact state | `checksum` |
//! | memory that a scene needs, estimated before it is built | `memory` |
//!
//! This module does not depend on Rerun or files. Clocks serve the step's timers and the estimate of free memory alone.
//!
//! # Glossary
//! | term | meaning |
//! | --- | --- |
//! | rest shape | positions l of a body's vertices about its centre while nothing acts on it |
//! | displacement | x, from the rest shape to a vertex |
//! | carry | the inertial acceleration of vertices by their own body's motion |
//! | influence sphere | the ball in which a body or a force point attracts or repels vertices; its surface is the rim |
//! | source | what has an influence sphere: the bodies, then the force points |
//! | pair | two bodies near each other |
//! | q | centre distance of a pair over the sum of the radii |
//! | phase | of a pair: apart, merged or in the core; it decides which force acts |
//! | event | a change of phase, where q passes a threshold |
//! | jump | an instant at which a force or a path is discontinuous; a step is divided there |
//! | coupled | of a scene: its bodies must be stepped together |
//! | island | bodies of a coupled scene that can act on each other in a step |
//! | active set | the vertices of a body that are stepped, because a sphere may reach them |
//! | asleep | of a body: not stepped, because nothing acts on it |
//! | fat bounds | a ball around a body for which its neighbours were found |
//! | substep | a part of a step for which the integrator is called once |
//! | nodes, samples | the instants of a substep at which forces are collocated, and those at which they are evaluated |
//! | residual | what the polynomial through the nodes leaves out of a force; it estimates the error |
//! | tolerance | the error that a second of simulated time may add, in radii |
//!
//! # A step of bodies on paths
//! Names in front are those of the stages in `/timings`.
//!
//! 1. [`World::step`] → `World::advance`, which divides a step at edits → `Solver::step` → `Prescribed::step` (`prescribed`)
//! 2. reach: `Tracks::evaluate` (`tracks`) evaluates the paths; `Pairs::update` searches for `neighbours`
//! 3. events: `Pairs::find_events` → `Search::first_change` ([`events`]) → `roots`
//! 4. reach: `wake_pushed`, `wake_moved`, `wake_near_points`; `find_bounds` → `Context::find_reachable` (`advance`)
//! 5. integrate: `Context::advance` for every awake body
//! 6. ‥ of an explicit scheme: `explicit::advance` ([`integrator`]); otherwise:
//! 7. ‥ `choose_active_set` (`advance`), then `find_breaks` divides the step where something jumps
//! 8. ‥ for every part: `over` (`terms`) collects what acts, `exponential::advance` steps the active set
//! 9. ‥ ‥ all of its vertices in SIMD lanes (`together`), then one by one those that cross a rim or need
//!    shorter steps (`single`); vertices that left the set are released to the exact flow
//! 10. integrate: `Pairs::enter_phases`; `sleep` puts bodies to sleep
//!
//! # A step of a coupled scene
//! 1. [`World::step`] → `World::advance`, which divides a step at edits → `Solver::step` → `Coupled::step` (`coupled`)
//! 2. reach: `wake_pushed`, `wake_near_points`; `find_neighbours` → `Near::update` searches for `neighbours`
//! 3. integrate, of an explicit scheme: `explicit::step` (`coupled`); otherwise:
//! 4. reach: `find_islands` groups the bodies that can act on each other, and wakes those in reach
//! 5. integrate: `islands::advance` → `Island::advance_with` ([`free`]) for every island
//! 6. ‥ `Island::substep`: `enter` applies what jumps now; then an `attempt` after another, until the error is within the tolerance:
//! 7. ‥ ‥ `solve` → `converge`: `evaluate` (`force`, `kernels`) computes forces, `Course::correct` (`step`) moves bodies
//! 8. ‥ ‥ `end_at` shortens it to the `first_crossing` of a threshold; `estimate_error`; `commit` makes it the state
//! 9. ‥ an island for which that is too much work is advanced by `Island::advance_in_fixed_steps` (`verlet`) instead
//! 10. again from 4 with wider bounds for bodies that moved farther than expected (`has_left_bounds`)
//! 11. reach: `end` takes the results over, moves bodies on which nothing acts (`advance_unforced`), and lets slow ones `sleep`
//!
//! # What a step skips
//! Step cost scales with active interactions, not with vertices, and skipping changes no result:
//!
//! - **Broad phase**: a multi-level grid, one level per size class, finds pairs. Its result holds until a body leaves
//!   its fat bounds. A step checks only bodies that move.
//! - **Bodies at rest cost nothing**: no time in a step, and undeformed no memory for their vertices. They wake when a push begins,
//!   when their own motion acts on them, or when a sphere can reach them.
//! - **Motion shared by all vertices of a body**, caused by the body's own motion, is one state per body.
//! - **Only the active set is stepped**: the vertices near a sphere, selected again after spheres have moved by a tenth
//!   of a radius. All other vertices are free. The exact flow advances them over any number of steps at once when a
//!   sphere or an observer needs them: `run --every 10` pays for a tenth of the observation.
//! - **Only contributing spheres are summed**: those that can reach the active set.
//! - The active set is stepped in SIMD lanes (AVX-512, AVX2 or SSE2), and bodies on as many threads as pay off, with
//!   bit-identical results.

mod body;
mod checksum;
mod coupled;
mod edit;
#[doc(hidden)]
pub mod events;
#[doc(hidden)]
pub mod free;
mod handle;
#[doc(hidden)]
pub mod integrator;
pub(crate) mod memory;
mod neighbours;
pub(crate) mod numerics;
pub(crate) mod observe;
mod on_request;
pub(crate) mod prescribed;
#[doc(hidden)]
pub mod reach;
mod report;
mod solver;
pub(crate) mod span;
mod state;
pub(crate) mod terms;
pub(crate) mod work;
mod world;

pub use body::{BodyView, PairView, States};
pub use events::Event;
pub use free::{Conserved, Ledger};
pub use handle::{BodyHandle, BodyId};
pub use memory::TooLarge;
pub use numerics::arrays::Vectors;
pub use observe::{BodyForces, Energy};
pub use report::{
    Diverged, EditError, Failure, Fallback, Overworked, Shortfall, Stage, StepReport, Strain, Toil, WorldError,
};
pub use terms::{Cause, Origin, Source, Surroundings, Weighted};
pub(crate) use world::Part;
pub use world::{Options, World};
