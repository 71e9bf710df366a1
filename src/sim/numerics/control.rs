//! The constants that decide how accurate a step is, or how long; that of explicit steps of lattices is
//! `models::elastic::body::OF_LIMIT`.
//!
//! Most are bounds, or what a textbook advises. Where it says "by `bench error`", that shows whether errors stay within the
//! tolerance with the value.

// Both solvers

/// Order of the error of a step per unit of time, with three nodes beside the start that are corrected at least once.
pub const ORDER: i32 = 5;
/// A step that has not converged after this many corrections of the force on a vertex is rejected, or goes on with the
/// next sweep. A correction reduces a change by s h²/2 or more, a factor of 0.014 for a strength s = 100 1/s² and h = 1/60 s:
/// six reach rounding.
pub const MAX_CORRECTIONS: usize = 6;
/// The mean force that the cubic through the nodes leaves out, over its residual in the middle, for a force that acts by a
/// spring: by `bench error`.
pub const RESIDUAL: f64 = 0.1;
/// The same for a force that acts at once, on a centre: the mean of the largest quartic that vanishes at the nodes, over its
/// value in the middle.
pub const RESIDUAL_AT_ONCE: f64 = 0.45;
/// Share of the tolerance that each deliberate approximation may take: corrections, how spheres move between the samples,
/// the deformation of a body that counts as undeformed, and the motion of one that comes to rest.
pub const NEGLIGIBLE: f64 = 0.1;

// Bodies on paths

/// Ratio of the error per unit of time of a step to that of a step of half the length.
pub const SHORTER: f64 = (1 << ORDER) as f64;
/// Time of the sixth sample, as a fraction of the step [–]: near an extremum of the quintic that vanishes at the nodes
/// and in the middle.
pub const ASIDE: f64 = 0.13;
/// Number of time scales of an oscillation that pass in a step up to which its samples resolve it: about a sixth of a turn.
pub const RESOLVED: f64 = 1.0;
/// The part of the residual that is odd about the middle of a step, at `ASIDE`, over its coefficient.
pub const SKEW_ASIDE: f64 = 0.29;
/// Bounds on the mean force that a step leaves out where a sphere passes a vertex, over the residuals [per radius of the sphere
/// passed in the step], for each weight; and where the vertex crosses the rim of Wendland's weight, whose fourth derivative
/// jumps there. Largest over lines at all distances from the centre, of 0.05 to 1 radii per step, by quadrature: 0.046, 0.13
/// and 0.26; over [`OF_BOUND`].
pub const PASSING: f64 = 0.1;
pub const PASSING_WENDLAND: f64 = 0.3;
pub const CROSSING: f64 = 0.6;
/// Share of the bound on an error that counts. The largest seen: 0.15 to 0.4 over the vertices of the scenes of `bench error`,
/// 0.41 over those of random scenes.
pub const OF_BOUND: f64 = 0.45;
/// The mean force that the cubic through the nodes leaves out of |x| x where x passes 0, at most, over the square of the
/// step in x: by quadrature.
pub const TURN: f64 = 0.0037;
/// The distance b from a centre, over the distance travelled, at which √(x² + b²) x leaves out a quarter of that: by quadrature, within a
/// fourth for b up to 0.7.
pub const TURN_WIDTH: f64 = 0.3;

// Free bodies

/// Factor on the step length that is expected to meet the tolerance (Hairer, Nørsett & Wanner, Solving Ordinary
/// Differential Equations I, II.4: 0.8 to 0.9).
pub const SAFETY: f64 = 0.9;
/// Largest ratio by which the expected step length grows from one step to the next, or shrinks (ibid.: 1.5 to 5).
pub const MAX_GROWTH: f64 = 4.0;
/// Largest number of sweeps of a step before a shorter one is tried: those of a step that converges as slowly as pays off,
/// by half in each.
pub const MAX_SWEEPS: u32 = 24;
/// Largest angle by which a body's frame turns in a step, and the stiffest oscillation in a substep of fixed length [rad];
/// there it is also the largest distance that a vertex travels [radii of the smallest body]; also the largest angle by which a sine path
/// turns in a step: the squared distance of two bodies is then off by 2e-9 of the square of the amplitude (the remainder of
/// Hermite interpolation at the four nodes), so that a threshold is passed in time. The rate of a rotation vector is singular
/// at a full turn; velocity Verlet is stable up to 2, and its frequency is off by 1 % here (1/24 of the square).
pub const MAX_ANGLE: f64 = 0.5;
/// Larger tolerances than this make steps longer, but do not permit coarser approximations [radii/s]. Otherwise what corrections
/// leave, which is of low order, would dominate the error of steps much shorter than the tolerance requires.
pub const NEGLIGIBLE_TOLERANCE: f64 = 1e-6;
/// The reported sum of estimates is meant to bound the error: it allows for errors that grow after their step, and for
/// residuals that are larger between the midpoints. tests/suite/random_errors.rs counts errors beyond it.
pub const GROWTH: f64 = 2.0;
/// Largest error of an interpolated position of a vertex [radii]: it moves the time of a contact at 1 R/s by a tenth of the
/// precision to which such times are searched for.
pub const INTERPOLATED: f64 = 1e-8;

// Rest

/// Shortest time for which a body must be slow before it rests [s], as in game engines (Box2D: `b2_timeToSleep`).
pub const SLOW_TIME: f64 = 0.5;
/// Bodies rest no sooner with a larger tolerance than this, or with steps of fixed length [radii/s]: `NEGLIGIBLE` of it is three
/// per cent of the radius in a second (Jolt: `mPointVelocitySleepThreshold`, 0.03 m/s; Box2D: 0.05 m/s). Motion lost by resting
/// is an error that shorter steps do not reduce.
pub const MAX_SLOW_TOLERANCE: f64 = 0.3;

// Rounding, which decides no accuracy

/// Relative error after a few roundings.
pub const ROUNDING: f64 = 8.0 * f64::EPSILON;
/// Distances within this fraction of a threshold, and instants within this fraction of a step, are the same: a few
/// thousand roundings.
pub const STANDING: f64 = 1e-12;
