//! The instants of a step at which forces are sampled, as fractions of the step.

/// The nodes of Lobatto quadrature with four points, on [0, 1]: exact for polynomials of degree five.
pub const NODES: [f64; 4] = [0.0, 0.276_393_202_250_021, 0.723_606_797_749_978_9, 1.0];

/// The instants at which a step samples forces: its nodes and its middle.
pub const SAMPLES: [f64; 5] = [NODES[0], NODES[1], NODES[2], NODES[3], 0.5];

/// Instants between the nodes at which the residual of a step is sampled.
pub const MIDPOINTS: [f64; 3] = [0.5 * NODES[1], 0.5, 1.0 - 0.5 * NODES[1]];
