//! Free bodies: vertices with masses about a rest shape that follows them. This is shape matching (Müller,
//! Heidelberger, Teschner, Gross: Meshless Deformations Based on Shape Matching, 2005) as a differential equation.
//!
//! | symbol | meaning |
//! | --- | --- |
//! | c, c′ | mass centre of the vertices and its velocity |
//! | Q | the rotation that fits the vertices best; a = Q l, s = r − c, x = s − a |
//! | Ω_Q | the angular velocity of Q, a′ = Ω_Q×a |
//! | Ω | the mean angular velocity of the vertices, I⁻¹ Σ m s×s′ |
//! | f, f̄ | external acceleration of a vertex, and its mean Σ m f/M |
//!
//! ```text
//! r″ = −ω² x − 2κ (s′ − Ω×s) + f + g + R/M
//! ```
//!
//! Because c and Q minimise Σ m |x|², springs and damping exert no net force and no net torque. The motion of x beyond
//! its oscillator (3.2) is smooth, however stiff the spring is; see [`Inner`].
//!
//! Sums over the vertices are given as matrices: Σ m p qᵀ of two vectors p, q per vertex.

use glam::{DMat3, DQuat, DVec3};

/// The outer product p qᵀ.
#[inline]
pub fn outer(p: DVec3, q: DVec3) -> DMat3 {
    DMat3::from_cols(p * q.x, p * q.y, p * q.z)
}

/// Σ m p×q, from Σ m p qᵀ.
#[inline]
pub fn moment(pq: DMat3) -> DVec3 {
    let DMat3 { x_axis: x, y_axis: y, z_axis: z } = pq;
    DVec3::new(z.y - y.z, x.z - z.x, y.x - x.y)
}

/// [v]×, the matrix of the cross product with v from the left.
#[inline]
pub fn cross_matrix(v: DVec3) -> DMat3 {
    DMat3::from_cols(DVec3::new(0.0, v.z, -v.y), DVec3::new(-v.z, 0.0, v.x), DVec3::new(v.y, -v.x, 0.0))
}

/// tr(A) 1 − A. For Σ m s sᵀ it is the inertia tensor I of the vertices at their current positions; for Σ m a sᵀ it is
/// G, in Σ m a×(Ω×s) = Gᵀ Ω and Σ m s×(Ω_Q×a) = G Ω_Q.
#[inline]
pub fn resistance(a: DMat3) -> DMat3 {
    let trace = a.x_axis.x + a.y_axis.y + a.z_axis.z;
    DMat3::from_diagonal(DVec3::splat(trace)) - a
}

/// A⁻¹ v. Not finite if A is singular.
#[inline]
pub fn solve(a: DMat3, v: DVec3) -> DVec3 {
    let DMat3 { x_axis: p, y_axis: q, z_axis: r } = a;
    let (qr, rp, pq) = (q.cross(r), r.cross(p), p.cross(q));
    DVec3::new(qr.dot(v), rp.dot(v), pq.dot(v)) / p.dot(qr)
}

/// exp([v]×) as a quaternion: the rotation by |v| [rad] about v.
pub fn rotation_by(v: DVec3) -> DQuat {
    let square = v.length_squared();
    let half = 0.5 * square.sqrt();
    // sin(|v|/2)/|v| and cos(|v|/2)
    let (sinc, cos) = if half < 1e-3 {
        let half2 = half * half;
        (0.5 * (1.0 - half2 / 6.0 * (1.0 - half2 / 20.0)), 1.0 - half2 / 2.0 * (1.0 - half2 / 12.0))
    } else {
        let (sin, cos) = libm::sincos(half);
        (0.5 * sin / half, cos)
    };
    DQuat::from_xyzw(v.x * sinc, v.y * sinc, v.z * sinc, cos)
}

/// The rate of a rotation vector v when exp([v]×) rotates at the rate `spin`: dexp⁻¹. For |v| well below 2π [rad].
///
/// ```text
/// v′ = Ω − ½ v×Ω + c v×(v×Ω),   c = (1 − (|v|/2) cot(|v|/2))/|v|²
/// ```
pub fn rotation_vector_rate(v: DVec3, spin: DVec3) -> DVec3 {
    let square = v.length_squared();
    let c = if square < 0.25 {
        // Bernoulli numbers: B_2n (−1)ⁿ⁺¹ |v|²ⁿ⁻²/(2n)!
        let terms =
            [1.0 / 12.0, 1.0 / 720.0, 1.0 / 30240.0, 1.0 / 1_209_600.0, 1.0 / 47_900_160.0, 5.284_190_138_687_493e-10];
        terms.iter().rev().fold(0.0, |sum, term| sum * square + term)
    } else {
        let half = 0.5 * square.sqrt();
        let (sin, cos) = libm::sincos(half);
        (1.0 - half * cos / sin) / square
    };
    let turned = v.cross(spin);
    spin - 0.5 * turned + c * v.cross(turned)
}

/// The best-fitting rotation Q: the one with the largest tr(Qᵀ A) for A = Σ m s lᵀ. It is the orthogonal factor of the
/// polar decomposition of A, but always a rotation, never a reflection.
///
/// As a quaternion it is the eigenvector of the largest eigenvalue of a symmetric 4×4 matrix (Horn, Closed-form
/// solution of absolute orientation using unit quaternions, 1987), which is well defined for flat and for inverted
/// shapes. If several rotations fit equally well, the result is the one nearest to `before`; the same choice is made
/// between q and −q, which are the same rotation.
pub fn best_rotation(a: DMat3, before: DQuat) -> DQuat {
    let scale = [a.x_axis, a.y_axis, a.z_axis].iter().map(|c| c.abs().max_element()).fold(0.0, f64::max);
    if !(scale > 0.0 && scale.is_finite()) {
        return before;
    }
    let a = a * (1.0 / scale);
    let (x, y, z) = (a.x_axis, a.y_axis, a.z_axis); // columns; row r of column c is A_rc
    let off = moment(a.transpose()); // A_zy − A_yz, …
    let mut k = [
        [x.x + y.y + z.z, off.x, off.y, off.z],
        [off.x, x.x - y.y - z.z, x.y + y.x, x.z + z.x],
        [off.y, x.y + y.x, y.y - x.x - z.z, y.z + z.y],
        [off.z, x.z + z.x, y.z + z.y, z.z - x.x - y.y],
    ];
    let vectors = eigenvectors(&mut k);
    let largest = (0..4).map(|i| k[i][i]).fold(f64::NEG_INFINITY, f64::max);
    // of all rotations that fit equally well, to rounding, the one nearest to `before`: its projection
    let known = [before.w, before.x, before.y, before.z];
    let mut sum = [0.0; 4];
    let mut only = [0.0; 4];
    for i in 0..4 {
        if k[i][i] < largest - 1e-13 {
            continue;
        }
        let column: [f64; 4] = std::array::from_fn(|row| vectors[row][i]);
        let along: f64 = (0..4).map(|row| column[row] * known[row]).sum();
        let side = if along < 0.0 { -1.0 } else { 1.0 };
        for row in 0..4 {
            sum[row] += along * column[row];
            only[row] = side * column[row];
        }
    }
    let of = |[w, x, y, z]: [f64; 4]| DQuat::from_xyzw(x, y, z, w);
    let best = of(sum);
    if best.length_squared() > 1e-6 { best.normalize() } else { of(only).normalize() }
}

/// Diagonalises a symmetric matrix by Jacobi rotations, and returns its eigenvectors as columns.
fn eigenvectors(k: &mut [[f64; 4]; 4]) -> [[f64; 4]; 4] {
    const MAX_SWEEPS: usize = 12;
    let mut v = [[0.0; 4]; 4];
    for i in 0..4 {
        v[i][i] = 1.0;
    }
    for _ in 0..MAX_SWEEPS {
        let mut left = 0.0;
        for p in 0..3 {
            for q in p + 1..4 {
                left += k[p][q] * k[p][q];
            }
        }
        if left < 1e-34 {
            break;
        }
        for p in 0..3 {
            for q in p + 1..4 {
                if k[p][q] == 0.0 {
                    continue;
                }
                let tau = (k[q][q] - k[p][p]) / (2.0 * k[p][q]);
                let t = f64::copysign(1.0, tau) / (tau.abs() + (1.0 + tau * tau).sqrt());
                let cos = 1.0 / (1.0 + t * t).sqrt();
                let sin = t * cos;
                for i in 0..4 {
                    let (kp, kq) = (k[i][p], k[i][q]);
                    (k[i][p], k[i][q]) = (cos * kp - sin * kq, sin * kp + cos * kq);
                }
                for i in 0..4 {
                    let (kp, kq) = (k[p][i], k[q][i]);
                    (k[p][i], k[q][i]) = (cos * kp - sin * kq, sin * kp + cos * kq);
                    let (vp, vq) = (v[i][p], v[i][q]);
                    (v[i][p], v[i][q]) = (cos * vp - sin * vq, sin * vp + cos * vq);
                }
            }
        }
    }
    v
}

/// Sums over the vertices of a body, which determine the motion of its frame.
#[derive(Clone, Copy, Debug)]
pub struct Inner {
    /// Σ m a sᵀ [mass · scene unit²].
    pub as_: DMat3,
    /// Σ m a x′ᵀ, where x′ is the rate of x in world axes [mass · scene unit²/s].
    pub ax_rate: DMat3,
    /// Σ m x×x′ [mass · scene unit²/s].
    pub x_cross_rate: DVec3,
    /// Σ m s sᵀ [mass · scene unit²].
    pub ss: DMat3,
}

impl Default for Inner {
    fn default() -> Inner {
        // the default of a matrix is the identity, not an empty sum
        let (none, zero) = (DMat3::ZERO, DVec3::ZERO);
        Inner { as_: none, ax_rate: none, x_cross_rate: zero, ss: none }
    }
}

impl Inner {
    /// Ω_Q from the angular momentum S = Σ m s×s′: with s = a + x and s′ = Ω_Q×a + x′,
    ///
    /// ```text
    /// S = G Ω_Q + Σ m s×x′,   G = (Σ m s·a) 1 − Σ m a sᵀ
    /// ```
    ///
    /// Not finite where the best-fitting rotation is not unique: G is singular there.
    pub fn frame_spin(&self, angular_momentum: DVec3) -> DVec3 {
        solve(resistance(self.as_), angular_momentum - moment(self.ax_rate) - self.x_cross_rate)
    }

    /// Ω = I⁻¹ S [rad/s].
    pub fn spin(&self, angular_momentum: DVec3) -> DVec3 {
        solve(resistance(self.ss), angular_momentum)
    }

    /// Ω_Q′ [rad/s²], from the second derivative of Σ m a×s = 0; `turning` is Σ m a×f:
    ///
    /// ```text
    /// G Ω_Q′ = Σ m a×(f − f̄ − 2κ(s′ − Ω×s)) + 2 Σ m (Ω_Q×a)×s′ + Σ m (Ω_Q×(Ω_Q×a))×s
    /// ```
    ///
    /// where Σ m a×s′ = G Ω_Q, Σ m a×(Ω×s) = Gᵀ Ω, and (Ω_Q×a)×s′ = (Ω_Q×a)×x′.
    pub fn frame_spin_rate(&self, turning: DVec3, damping: f64, spin: DVec3, frame_spin: DVec3) -> DVec3 {
        let (g, w) = (resistance(self.as_), frame_spin);
        let damped = g * w - g.transpose() * spin;
        // (w×a)×x′ = a (w·x′) − w (a·x′)
        let coriolis = self.ax_rate * w - w * trace(self.ax_rate);
        // (w×(w×a))×s = (w·a) w×s − w² a×s
        let centrifugal = w.cross(self.as_.transpose() * w) - moment(self.as_) * w.length_squared();
        solve(g, turning - 2.0 * damping * damped + 2.0 * coriolis + centrifugal)
    }
}

fn trace(a: DMat3) -> f64 {
    a.x_axis.x + a.y_axis.y + a.z_axis.z
}

/// The matrix D [1/s²] of the part of the right-hand side that all vertices of a free body share, in x″ = −ω² x − 2κ x′
/// + F:
///
/// ```text
/// F = f − f̄ + 2κ(Ω×s − Ω_Q×a) − Ω_Q′×a − Ω_Q×(Ω_Q×a)
///   = f − f̄ + 2κ Ω×x + D l,   D = (2κ [Ω − Ω_Q]× − [Ω_Q′]× − [Ω_Q]×²) Q
/// ```
///
/// F does not contain ω.
pub fn frame_drive(axes: DMat3, damping: f64, spin: DVec3, frame_spin: DVec3, frame_spin_rate: DVec3) -> DMat3 {
    let turn = cross_matrix(2.0 * damping * (spin - frame_spin) - frame_spin_rate);
    let w = frame_spin;
    let centrifugal = DMat3::from_diagonal(DVec3::splat(w.length_squared())) - outer(w, w); // −[w]×²
    (turn + centrifugal) * axes
}

/// Whether a free body rotates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rotation {
    /// The rest shape rotates with the vertices.
    Free,
    /// Its rest shape keeps its orientation.
    Fixed,
}

/// A plane that keeps vertices on the side that its normal points to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// Unit vector n.
    pub normal: DVec3,
    /// n·r of the points of the plane [scene unit].
    pub offset: f64,
    /// Stiffness k [1/s²].
    pub stiffness: f64,
    /// Coefficient of friction μ [–].
    pub friction: f64,
    /// Speed v_s below which friction fades [scene unit/s], > 0.
    pub slip: f64,
}

impl Plane {
    /// Signed depth d of a point behind the plane, not clamped at zero [scene unit].
    #[inline]
    pub fn depth(&self, position: DVec3) -> f64 {
        self.offset - self.normal.dot(position)
    }

    /// `k d n − μ k d v_t/√(|v_t|² + v_s²)` for a depth d, where v_t is the tangential velocity [scene unit/s²].
    /// Continues smoothly for d < 0, where the plane does not act.
    #[inline]
    pub fn acceleration(&self, depth: f64, velocity: DVec3) -> DVec3 {
        let pressure = self.stiffness * depth;
        if self.friction == 0.0 {
            return pressure * self.normal;
        }
        let slide = velocity - self.normal.dot(velocity) * self.normal;
        let per_speed = 1.0 / (slide.length_squared() + self.slip * self.slip).sqrt();
        pressure * (self.normal - (self.friction * per_speed) * slide)
    }

    /// The derivatives of [`Plane::acceleration`] with respect to position [1/s²] and velocity [1/s].
    pub fn derivatives(&self, depth: f64, velocity: DVec3) -> (DMat3, DMat3) {
        let n = self.normal;
        if self.friction == 0.0 {
            return (outer(-self.stiffness * n, n), DMat3::ZERO);
        }
        let slide = velocity - n.dot(velocity) * n;
        let per_speed = 1.0 / (slide.length_squared() + self.slip * self.slip).sqrt();
        let unit = per_speed * slide;
        let by_position = outer(-self.stiffness * (n - self.friction * unit), n);
        // derivative of v_t/√(|v_t|² + v_s²): (1 − n nᵀ − unit unitᵀ)/√…
        let along = DMat3::IDENTITY - outer(n, n) - outer(unit, unit);
        (by_position, along * (-self.friction * self.stiffness * depth * per_speed))
    }

    /// Potential ½ k d² per unit mass [scene unit²/s²].
    #[inline]
    pub fn potential(&self, depth: f64) -> f64 {
        0.5 * self.stiffness * depth.max(0.0) * depth.max(0.0)
    }
}

/// Gradual change of a pair's strength from attraction to repulsion at the rim of its core, over a finite width:
/// `−β + (α + β)·S((q − core_at)/w + ½)`, S(z) = z²(3 − 2z) clamped to [0, 1].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoreRim {
    /// Strength α of attraction [1/s²].
    pub alpha: f64,
    /// Strength β of repulsion [1/s²].
    pub beta: f64,
    /// The q at which the change is half complete [–].
    pub core_at: f64,
    /// Width w of the change in q [–], > 0.
    pub width: f64,
}

impl CoreRim {
    /// Position of `q` within the rim, from 0 at its inner to 1 at its outer end.
    fn share(&self, q: f64) -> f64 {
        ((q - self.core_at) / self.width + 0.5).clamp(0.0, 1.0)
    }

    /// The strength at centre distance `q` [1/s²].
    pub fn strength(&self, q: f64) -> f64 {
        let z = self.share(q);
        (self.alpha + self.beta) * (z * z * (3.0 - 2.0 * z)) - self.beta
    }

    /// The derivative of the strength with respect to q [1/s²]: it changes the pair's potential energy by Σ m (ds/dq)
    /// q′ Φ per unit of time.
    pub fn slope(&self, q: f64) -> f64 {
        let z = self.share(q);
        (self.alpha + self.beta) * (6.0 * z * (1.0 - z)) / self.width
    }

    /// The q at which attraction turns into repulsion [–], for strengths above 0.
    pub fn balance(&self) -> f64 {
        // 3 z² − 2 z³ = β / (α + β)
        let share = self.beta / (self.alpha + self.beta);
        let z = 0.5 - libm::sin(libm::asin(1.0 - 2.0 * share) / 3.0);
        self.core_at + (z - 0.5) * self.width
    }

    /// The inner and outer end of the rim in q [–]. The slope has a kink at each.
    pub fn ends(&self) -> [f64; 2] {
        [self.core_at - 0.5 * self.width, self.core_at + 0.5 * self.width]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A body of a few vertices, strongly deformed, with arbitrary forces on it.
    struct Particles {
        rest: Vec<DVec3>,
        masses: Vec<f64>,
        position: Vec<DVec3>,
        velocity: Vec<DVec3>,
        force: Vec<DVec3>,
        omega: f64,
        damping: f64,
    }

    impl Particles {
        fn new() -> Particles {
            let mut state = 1u64;
            let mut random = || {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
            };
            let mut any = |size: DVec3| DVec3::new(random(), random(), random()) * size;
            let n = 24;
            let masses: Vec<f64> = (0..n).map(|i| 0.5 + f64::from(i % 5)).collect();
            let mut rest: Vec<DVec3> = (0..n).map(|_| any(DVec3::new(3.0, 2.0, 1.2))).collect();
            let middle = rest.iter().zip(&masses).map(|(&l, &m)| m * l).sum::<DVec3>() / masses.iter().sum::<f64>();
            rest.iter_mut().for_each(|l| *l -= middle);
            let turn = rotation_by(DVec3::new(0.4, -1.1, 0.7));
            let spin = DVec3::new(1.0, -2.0, 0.5);
            let position: Vec<DVec3> = rest.iter().map(|&l| turn * l + any(DVec3::splat(0.5)) + DVec3::X).collect();
            let velocity = position.iter().map(|&r| spin.cross(r) + any(DVec3::splat(2.0))).collect();
            let force = (0..n).map(|_| any(DVec3::splat(20.0))).collect();
            Particles { rest, masses, position, velocity, force, omega: 40.0, damping: 3.0 }
        }

        fn mean(&self, v: &[DVec3]) -> DVec3 {
            v.iter().zip(&self.masses).map(|(&v, &m)| m * v).sum::<DVec3>() / self.masses.iter().sum::<f64>()
        }

        fn rotation(&self, position: &[DVec3]) -> DMat3 {
            let c = self.mean(position);
            let fit = (0..self.rest.len())
                .fold(DMat3::ZERO, |sum, i| sum + outer(self.masses[i] * (position[i] - c), self.rest[i]));
            DMat3::from_quat(best_rotation(fit, DQuat::IDENTITY))
        }

        /// r″ = −ω² (s − Q l) − 2κ (s′ − Ω×s) + f, as in the model.
        fn accelerations(&self) -> Vec<DVec3> {
            let (c, v) = (self.mean(&self.position), self.mean(&self.velocity));
            let (mut inertia, mut momentum) = (DMat3::ZERO, DVec3::ZERO);
            for i in 0..self.rest.len() {
                let (s, m) = (self.position[i] - c, self.masses[i]);
                inertia += (DMat3::from_diagonal(DVec3::splat(s.length_squared())) - outer(s, s)) * m;
                momentum += m * s.cross(self.velocity[i] - v);
            }
            let spin = inertia.inverse() * momentum;
            let q = self.rotation(&self.position);
            (0..self.rest.len())
                .map(|i| {
                    let (s, w) = (self.position[i] - c, self.velocity[i] - v);
                    -self.omega * self.omega * (s - q * self.rest[i]) - 2.0 * self.damping * (w - spin.cross(s))
                        + self.force[i]
                })
                .collect()
        }

        /// Positions at a slightly later or earlier time.
        fn after(&self, t: f64) -> Vec<DVec3> {
            let a = self.accelerations();
            (0..self.rest.len()).map(|i| self.position[i] + t * (self.velocity[i] + 0.5 * t * a[i])).collect()
        }

        /// The sums, with rates of x that follow from the frame's angular velocity.
        fn inner(&self, frame_spin: DVec3) -> (Inner, DVec3, DVec3) {
            let (c, v, q) = (self.mean(&self.position), self.mean(&self.velocity), self.rotation(&self.position));
            let mut inner = Inner::default();
            let (mut momentum, mut turning) = (DVec3::ZERO, DVec3::ZERO);
            for i in 0..self.rest.len() {
                let (a, m, s) = (q * self.rest[i], self.masses[i], self.position[i] - c);
                let rate = self.velocity[i] - v;
                let x_rate = rate - frame_spin.cross(a);
                inner.as_ += outer(m * a, s);
                inner.ax_rate += outer(m * a, x_rate);
                inner.x_cross_rate += m * (s - a).cross(x_rate);
                inner.ss += outer(m * s, s);
                momentum += m * s.cross(rate);
                turning += m * a.cross(self.force[i]);
            }
            (inner, momentum, turning)
        }
    }

    /// The vector w of a matrix that is [w]× up to rounding.
    fn vector_of(m: DMat3) -> DVec3 {
        0.5 * DVec3::new(m.y_axis.z - m.z_axis.y, m.z_axis.x - m.x_axis.z, m.x_axis.y - m.y_axis.x)
    }

    #[test]
    fn the_frame_follows_the_particles() {
        let particles = Particles::new();
        let q = particles.rotation(&particles.position);
        let h = 1e-4;
        let (later, earlier) = (particles.rotation(&particles.after(h)), particles.rotation(&particles.after(-h)));
        let rate = (later - earlier) * (0.5 / h); // Q′ = [Ω_Q]× Q
        let frame_spin = vector_of(rate * q.transpose());
        let second = (later + earlier - q * 2.0) * (1.0 / (h * h)); // Q″ = ([Ω_Q′]× + [Ω_Q]×²) Q
        let spin_rate = vector_of((second * q.transpose()) - cross_matrix(frame_spin) * cross_matrix(frame_spin));

        let (inner, momentum, turning) = particles.inner(frame_spin);
        let found = inner.frame_spin(momentum);
        assert!((found - frame_spin).length() < 1e-5 * frame_spin.length(), "{found} {frame_spin}");
        let (inner, ..) = particles.inner(found);
        let spin = inner.spin(momentum);
        let found_rate = inner.frame_spin_rate(turning, particles.damping, spin, found);
        assert!((found_rate - spin_rate).length() < 1e-5 * spin_rate.length(), "{found_rate} {spin_rate}");

        // x″ of every particle: by finite differences, and by the oscillator with its smooth right-hand side
        let x = |position: &[DVec3], q: DMat3, i: usize| position[i] - particles.mean(position) - q * particles.rest[i];
        let mean = particles.mean(&particles.force);
        let drive = frame_drive(q, particles.damping, spin, found, found_rate);
        let v = particles.mean(&particles.velocity);
        let (after, before) = (particles.after(h), particles.after(-h));
        for i in 0..particles.rest.len() {
            let now = x(&particles.position, q, i);
            let seen = (x(&after, later, i) + x(&before, earlier, i) - 2.0 * now) / (h * h);
            let rate = particles.velocity[i] - v - found.cross(q * particles.rest[i]);
            let smooth =
                particles.force[i] - mean + 2.0 * particles.damping * spin.cross(now) + drive * particles.rest[i];
            let expected = -particles.omega * particles.omega * now - 2.0 * particles.damping * rate + smooth;
            assert!((seen - expected).length() < 1e-4 * expected.length().max(1.0), "{i}: {seen} {expected}");
        }
    }

    #[test]
    fn springs_and_damping_change_neither_momentum_nor_spin() {
        let mut particles = Particles::new();
        particles.force.fill(DVec3::ZERO);
        let a = particles.accelerations();
        let c = particles.mean(&particles.position);
        let torque: DVec3 = (0..a.len()).map(|i| particles.masses[i] * (particles.position[i] - c).cross(a[i])).sum();
        assert!(particles.mean(&a).length() < 1e-11 && torque.length() < 1e-9, "{torque}");
    }

    #[test]
    fn the_strength_at_the_rim_of_a_core_is_zero_where_forces_balance() {
        for (alpha, beta) in [(100.0, 60.0), (1.0, 1.0), (3.0, 500.0), (500.0, 0.1)] {
            let rim = CoreRim { alpha, beta, core_at: 0.8, width: 0.4 };
            let at = rim.balance();
            assert!(
                (0.6..1.0).contains(&at) && rim.strength(at).abs() < 1e-12 * (alpha + beta),
                "{alpha} {beta}: {at}"
            );
        }
    }

    #[test]
    fn the_best_rotation_is_never_a_reflection() {
        let turn = DMat3::from_quat(rotation_by(DVec3::new(0.3, 2.0, -1.0)));
        for (a, what) in [
            (DMat3::from_diagonal(DVec3::new(3.0, 2.0, 1.0)), "a body"),
            (DMat3::from_diagonal(DVec3::new(3.0, 2.0, 0.0)), "flat"),
            (DMat3::from_diagonal(DVec3::new(3.0, 2.0, -1.0)), "inside out"),
            (DMat3::from_diagonal(DVec3::new(3.0, 1e-9, -1e-10)), "nearly a line"),
        ] {
            let found = DMat3::from_quat(best_rotation(turn * a, DQuat::IDENTITY));
            assert!((found.determinant() - 1.0).abs() < 1e-12, "{what}");
            // no nearby rotation fits better
            let fit = |q: DMat3| {
                (q.transpose() * (turn * a)).x_axis.x
                    + (q.transpose() * (turn * a)).y_axis.y
                    + (q.transpose() * (turn * a)).z_axis.z
            };
            for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
                for angle in [1e-3, -1e-3, 1.0, 2.5] {
                    let other = DMat3::from_quat(rotation_by(angle * axis)) * found;
                    assert!(fit(other) <= fit(found) + 1e-12, "{what}: {axis} {angle}");
                }
            }
        }
        // without data the rotation is unchanged; for points on a line it is the nearest that fits
        let before = rotation_by(DVec3::new(0.1, 0.2, 0.3));
        assert_eq!(best_rotation(DMat3::ZERO, before), before);
        let line = best_rotation(outer(DVec3::Z, DVec3::Z), before);
        assert!((line * DVec3::Z - DVec3::Z).length() < 1e-7);
        assert!(line.dot(before) > 0.95);
    }

    #[test]
    fn the_best_rotation_is_continuous() {
        let mut q = DQuat::IDENTITY;
        for i in 0..2000 {
            let turn = rotation_by(DVec3::new(0.0, 0.6, 0.8) * (f64::from(i) * 0.01));
            let next = best_rotation(DMat3::from_quat(turn) * DMat3::from_diagonal(DVec3::new(2.0, 1.0, 0.5)), q);
            assert!(next.dot(q) > 0.9999, "{i}");
            q = next;
        }
    }

    #[test]
    fn rotation_vectors_follow_their_rate() {
        let v = DVec3::new(0.3, -0.5, 0.9);
        for v in [v, 0.1 * v, 2.0 * v, 1e-6 * v] {
            let rate = DVec3::new(0.7, 0.2, -0.4);
            let h = 1e-6;
            let turn = |s: f64| DMat3::from_quat(rotation_by(v + s * rate));
            let spin = vector_of((turn(h) - turn(-h)) * (0.5 / h) * turn(0.0).transpose());
            assert!((rotation_vector_rate(v, spin) - rate).length() < 1e-8);
        }
    }

    #[test]
    fn plane_forces_follow_from_the_potential() {
        let plane =
            Plane { normal: DVec3::new(0.6, 0.0, 0.8), offset: -0.5, stiffness: 4000.0, friction: 0.4, slip: 0.01 };
        let (r, v) = (DVec3::new(0.3, 0.2, -1.0), DVec3::new(0.02, -0.01, 0.3));
        let h = 1e-6;
        let smooth = Plane { friction: 0.0, ..plane };
        for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
            let slope =
                (plane.potential(plane.depth(r + h * axis)) - plane.potential(plane.depth(r - h * axis))) / (2.0 * h);
            assert!((slope + smooth.acceleration(plane.depth(r), v).dot(axis)).abs() < 1e-4);
            let (by_position, by_velocity) = plane.derivatives(plane.depth(r), v);
            let at = |r: DVec3, v: DVec3| plane.acceleration(plane.depth(r), v);
            let seen = (at(r + h * axis, v) - at(r - h * axis, v)) / (2.0 * h);
            assert!((seen - by_position * axis).length() < 1e-4);
            let seen = (at(r, v + h * axis) - at(r, v - h * axis)) / (2.0 * h);
            assert!((seen - by_velocity * axis).length() < 1e-2, "{seen} {}", by_velocity * axis);
        }
        // friction opposes the motion, and never exceeds μ times the pressure
        let drag = plane.acceleration(0.1, v) - smooth.acceleration(0.1, v);
        assert!(drag.dot(v) < 0.0 && drag.length() < 0.4 * 4000.0 * 0.1);
    }

    #[test]
    fn the_slope_of_a_core_rim_is_its_derivative() {
        let rim = CoreRim { alpha: 100.0, beta: 60.0, core_at: 0.7, width: 0.3 };
        let [inner, outer] = rim.ends();
        assert_eq!((rim.strength(inner), rim.strength(outer)), (-60.0, 100.0));
        assert_eq!((rim.strength(0.1), rim.strength(1.0)), (-60.0, 100.0));
        for q in [0.2, 0.56, 0.7, 0.8, 0.9] {
            let slope = (rim.strength(q + 1e-6) - rim.strength(q - 1e-6)) / 2e-6;
            assert!((slope - rim.slope(q)).abs() < 1e-4, "{q}: {slope} {}", rim.slope(q));
        }
    }
}
