//! How many frames a step of the integrator spans.
//!
//! Frames are what an observer counts: the steps of the scene, each Δt long. The length of the integrator's steps follows
//! from the motion and the tolerance instead. A stride is a number of frames, the same throughout a run; states are
//! stored at its ends. For an observer in between, the bodies are advanced from the start of the stride to that frame, and
//! what is stored stays as it is: a run does not pay for frames that nobody looks at, and looking never changes the result.

use crate::scene::{Integrator, Material, Path, Scene};

/// A stride.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Stride {
    /// Number of frames, a power of two.
    pub frames: u64,
    /// Length [s].
    pub length: f64,
}

/// Time scales of the motion that pass in a stride at a tolerance of [`USUAL_TOLERANCE`]. In longer strides too many
/// vertices would need shorter steps of their own. In 48 random scenes with frequencies, strengths and speeds up to ten
/// times the usual, strides of two and of four frames for all took 1.2 and 1.8 times the instructions of single frames.
const RESOLVED: f64 = 1.4;
/// The tolerance for which [`RESOLVED`] was measured [1/s].
const USUAL_TOLERANCE: f64 = 1e-6;
/// A larger tolerance means that errors are not controlled: steps are as long as frames [1/s].
const MAX_TOLERANCE: f64 = 1e-2;
/// The error of a step per unit of time is proportional to this power of its length.
const ORDER: f64 = 6.0;
/// The longest stride [frames]. Searches for events look ahead a multiple of it, so that they do not depend on the stride.
const MAX_FRAMES: f64 = 8.0;

impl Stride {
    /// The stride of a scene. Explicit integrators and bodies that forces move take a step per frame.
    pub fn of(scene: &Scene) -> Stride {
        let frames = frames(scene);
        Stride { frames, length: frames as f64 * scene.dt }
    }
}

fn frames(scene: &Scene) -> u64 {
    if scene.integrator != Integrator::Exponential || scene.is_coupled() || scene.tolerance > MAX_TOLERANCE {
        return 1;
    }
    let strength = scene.laws().map(|law| law.alpha.max(law.beta)).fold(0.0, f64::max);
    let of_oscillator = |material: &Material| material.omega + 2.0 * material.damping;
    let oscillators = scene.bodies.iter().map(|body| of_oscillator(&body.material)).fold(0.0, f64::max);
    let paths = scene.bodies.iter().filter_map(|body| body.path().map(|path| pace(path, body.radius, scene.duration)));
    let rate = oscillators + strength.sqrt() + 2.0 * paths.fold(0.0, f64::max);
    let resolved = RESOLVED * libm::pow(scene.tolerance / USUAL_TOLERANCE, 1.0 / ORDER) / rate;
    // vertices at rims step alone if more than one time scale of their oscillator passes
    let frames = resolved.min(1.0 / oscillators) / scene.dt;
    // written so that NaN gives one frame
    if frames >= 2.0 { 1 << frames.min(MAX_FRAMES).log2() as u32 } else { 1 }
}

/// Radii that a body moves, or radians of its oscillation, per unit of time [1/s].
fn pace(path: &Path, radius: f64, duration: f64) -> f64 {
    let swings = match path {
        Path::Sine { frequency, .. } => (std::f64::consts::TAU * frequency).abs(),
        _ => 0.0,
    };
    swings.max(path.bounds(0.0, duration).speed / radius)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Steps are longer than frames where the motion is slow for its tolerance, and never where it is not controlled.
    #[test]
    fn strides_follow_from_motion_and_tolerance() {
        let two = Scene::builtin("two").unwrap();
        let of = |change: &dyn Fn(&mut Scene)| {
            let mut scene = two.clone();
            change(&mut scene);
            Stride::of(&scene).frames
        };
        assert_eq!(of(&|_| ()), 2);
        assert_eq!(of(&|scene| scene.tolerance = 1e-9), 1);
        assert_eq!(of(&|scene| scene.tolerance = 1e-4), 4);
        assert_eq!(of(&|scene| scene.tolerance = 1.0), 1);
        assert_eq!(of(&|scene| scene.dt /= 4.0), 8);
        assert_eq!(of(&|scene| scene.integrator = Integrator::Rk4), 1);
        assert_eq!(of(&|scene| scene.bodies[0].material.omega = 100.0), 1);
    }
}
