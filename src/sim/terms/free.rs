//! What acts on free bodies only, or in scenes that have any: gravity, planes, and the reactions to what their spheres
//! do. The solver of such scenes has its own forces, so these terms contribute nothing here; their names are needed for
//! observation.

use super::Term;

pub struct Coupled;

impl Term for Coupled {}
