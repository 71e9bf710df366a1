//! Terms of scenes with free bodies: gravity, planes, and the reactions to the forces of their spheres. The solver of
//! such scenes computes its own forces, so these terms contribute nothing here; their names are needed for observation.

use super::Term;

pub struct Coupled;

impl Term for Coupled {}
