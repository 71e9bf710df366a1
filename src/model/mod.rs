//! The equations, scalar and readable, and nothing else.
//!
//! From 海上 一徳, 「リアルタイム 3DCG における融合・分裂を考慮したソフトボディ表現」 (soft bodies with merging and splitting in real-time 3D
//! graphics), graduation thesis of fiscal 2006, メディア学部 ゲームサイエンスプロジェクト, adviser 渡辺 大地; equation numbers are its own. Every vertex is a damped oscillator about its
//! rest position l, which moves with the centre c of its body; x is its displacement from there, r = c + l + x:
//!
//! ```text
//! x″ = −ω² x − 2κ x′ + Σ_j s_j (c_j − r) W(|c_j − r| / r_e,j) + push − carry          (3.2), (3.4), (3.5)
//! W(z) = 1 − z for z ≤ 1, else 0                                                      (3.3)
//! ```
//!
//! The sum is over the influence spheres of the *other* bodies, of radius r_e = √2 R by default; s is +α (attraction)
//! or −β (repulsion). Vertices do not act on each other.
//!
//! # Pair phases
//! The thesis switches between (3.4) and (3.5) "according to the distance" (section 3.2) without giving the distance: thresholds
//! and hysteresis are ours. Here each pair is a state machine on q, the centre distance over the sum of the radii:
//!
//! ```text
//! apart → merged  when q falls to merge_at         merged → apart  when q rises to split_at
//! merged → core   when q falls below core_at       core → merged   when q rises to core_at
//! ```
//!
//! Apart repels (or does nothing), merged attracts, core repels. With merge_at < split_at there is hysteresis: a neck
//! breaks at a larger distance than it forms. The times of these events are found by root finding, which misses none,
//! however brief.
//!
//! # Differences from the thesis
//! - **Its integrator is wrong as printed.** (3.7) and (3.10) both advance the position, by u\* Δt and by u Δt, while
//!   the velocity is advanced once. As Δt → 0 that converges to x″ = −2ω²x − 2κx′ under twice the force: an oscillator
//!   √2 times too fast. The integrator `thesis` implements (3.6)–(3.10) to the bit, as the baseline; `mps` is the
//!   consistent scheme that it builds on (r⁺ = r + u⁺Δt).
//! - **Sizes may differ.** The pull of a sphere grows with its radius, so a large body stretches a small neighbour to
//!   many times its size; the thesis reports that (4.3). `scaling = "relative"` multiplies s by min(1, R_i/R_j), where
//!   R_i is the radius of the body acted on: this makes no difference for equal sizes and bounds the displacement for
//!   any ratio. With the default constants (`bench stability`), a small body that passes a large one is displaced by
//!   0.42 to 0.45 of its own radius at every ratio from 1:1 to 1:1000; under `absolute`, the thesis's law, by 4.4 radii
//!   at 1:10 and by 440 at 1:1000.
//! - **A body may respond to its own motion** (`carry`): not at all (`rigid`, the thesis in body coordinates), by c″
//!   (`inertial`), or by c″ + 2κc′ (`world`, (3.8) read in world coordinates).
//!
//! # Misprints of the thesis
//! - 3.3 says that velocity and position are advanced to u\* and r\* by (3.9) and (3.10): by (3.6) and (3.7).
//! - 4.1 gives the influence sphere as √2 times r_e: r_e is √2 times R.
//! - 3.1.1 calls k the spring constant: it is the damping rate; the stiffness is w².
//!
//! # Where the equations are
//!
//! | equation | where |
//! | --- | --- |
//! | (3.2) damped oscillator about the rest position, its exact flow | [`oscillator`] |
//! | (3.3) weight, (3.4) attraction, (3.5) repulsion | [`influence`] |
//! | which of (3.4) and (3.5) acts: pair phases | [`phase`] |
//! | strengths and thresholds of a pair | [`pair_law`] |
//! | free bodies: shape matching, planes | [`shape_matching`] |
//! | energy and potentials | [`energy`] |
//!
//! This module does not depend on bodies, scenes, arrays or time steps: every function takes and returns numbers and
//! vectors. Units are those of the scene file: scene unit, second, radian.

pub mod energy;
pub(crate) mod hermite;
pub mod influence;
pub mod oscillator;
pub mod pair_law;
pub mod phase;
pub mod shape_matching;

pub use pair_law::{ForFree, PairLaw};

/// The thesis that the equations come from.
pub const THESIS: &str = "海上 一徳, 「リアルタイム 3DCG における融合・分裂を考慮したソフトボディ表現」, graduation thesis of fiscal 2006, \
                          メディア学部 ゲームサイエンスプロジェクト, adviser 渡辺 大地";
/// The same in the viewer, whose fonts lack Japanese characters.
pub const THESIS_IN_ENGLISH: &str = "the graduation thesis \u{201c}Representing soft bodies that merge and split in real-time 3D \
                                     graphics\u{201d} (fiscal 2006); see Citation in the README for its author";
