//! The equations, scalar and readable, and nothing else.
//!
//! | equation | where |
//! | --- | --- |
//! | (3.2) damped oscillator about the rest position, its exact flow | [`oscillator`] |
//! | (3.3) weight, (3.4) attraction, (3.5) repulsion | [`influence`] |
//! | which of (3.4) and (3.5) acts: pair phases | [`phase`] |
//! | energy and potentials | [`energy`] |
//!
//! Nothing here knows about bodies, scenes, arrays or time steps: every function takes numbers and vectors and
//! returns them. Units are those of the scene file: scene unit, second, radian.

pub mod energy;
pub mod influence;
pub mod oscillator;
pub mod phase;
