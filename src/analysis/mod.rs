//! What is computed from the frames of any simulation.
//!
//! | contents | module |
//! | --- | --- |
//! | closest approaches of pairs that did not change phase | [`approach`] |
//! | the merged surface of groups of bodies, and geometric measures of pairs | [`surface`] |
//! | times at which surfaces touch and part | [`touch`] |
//! | the largest difference between two states | [`worst`] |

pub mod approach;
pub mod surface;
pub mod touch;
pub mod worst;

pub use approach::{Approach, Approaches};
pub use touch::Touches;
pub use worst::Worst;
