//! Benchmarks: each one measures, and says beside every speed which error, which machine.
//!
//! | what | where |
//! | --- | --- |
//! | error against run time, for every integrator and a range of steps | [`mod@error`] |
//! | cost against the number of bodies, and the goals for it | [`scale`] |
//! | the independent solution that errors are measured against | [`reference`], by [`extrapolation`] |
//! | what the diagrams have in common, and the tables | `drawing`, `tables` |
//! | goals beside measurements | [`goals`] |
//! | the machine that a run time belongs to | [`machine`] |
//! | a stress sweep of every integrator, and bodies of very different sizes | [`stability`] |
//! | what recording costs, by detail and destination; what verifying costs; the goals for both | [`record`] |
//! | files that are written when everything has been measured | [`output`] |

mod drawing;
pub mod error;
pub mod extrapolation;
pub mod goals;
pub mod machine;
pub mod output;
pub mod record;
pub mod reference;
pub mod scale;
pub mod stability;
mod tables;
