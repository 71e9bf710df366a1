//! The instants of a step at which the exponential integrator samples forces, and at which tracks are therefore known.

/// The nodes of Lobatto quadrature with four points, on [0, 1]: exact for polynomials of degree five.
pub const NODES: [f64; 4] = [0.0, 0.276_393_202_250_021, 0.723_606_797_749_978_9, 1.0];

/// The instants at which a step samples forces: its nodes and its middle.
pub const SAMPLES: [f64; 5] = [NODES[0], NODES[1], NODES[2], NODES[3], 0.5];
