//! Forces set by a program.

use std::{
    fmt,
    panic::{RefUnwindSafe, UnwindSafe},
    sync::Arc,
};

use glam::DVec3;

/// A force on a free body, set by a program, as an acceleration shared by all of its vertices: it moves the centre, and
/// neither rotates nor deforms the body. Scene files cannot express it, so a recording of it cannot be replayed. A body
/// with such a force never comes to rest.
///
/// ```
/// # use meldscope::{Scene, World};
/// # use glam::DVec3;
/// use meldscope::scene::Force;
///
/// let scene = Scene::parse(
///     r#"
///     duration = 1.0
///     [[body]]
///     name = "ball"
///     radius = 1.0
///     motion = { free = { from = [1, 0, 0] } }
///     "#,
///     "spring.toml",
/// )?;
/// let mut world = World::new(scene)?;
/// // a spring between the centre and the origin: one oscillation in a second
/// let stiffness = std::f64::consts::TAU.powi(2);
/// world.set_force(0, Some(Force::new(2.0 * stiffness, move |_t, centre, _velocity| -stiffness * centre)))?;
/// for _ in 0..60 {
///     let _ = world.step();
/// }
/// assert!(world.body(0).centre().distance(DVec3::X) < 1e-6);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone)]
pub struct Force {
    at: Arc<dyn Fn(f64, DVec3, DVec3) -> DVec3 + Send + Sync>,
    bound: f64,
}

impl Force {
    /// The acceleration `at(t, c, c′)` [scene unit/s²] as a function of time [s] and of position [scene unit] and
    /// velocity [scene unit/s] of the centre.
    ///
    /// The function must be continuous and deterministic, and its magnitude must not exceed `bound` [scene unit/s²]
    /// anywhere that the body moves: `bound` limits the search for what the body may touch in a step. It is called
    /// several times within a step, also for error estimates, from any thread. The smoother it is, the longer the
    /// substeps; a discontinuity ends the run.
    pub fn new(bound: f64, at: impl Fn(f64, DVec3, DVec3) -> DVec3 + Send + Sync + 'static) -> Force {
        Force { at: Arc::new(at), bound }
    }

    /// The acceleration [scene unit/s²].
    pub fn acceleration(&self, t: f64, centre: DVec3, velocity: DVec3) -> DVec3 {
        (self.at)(t, centre, velocity)
    }

    /// Upper bound of its magnitude [scene unit/s²].
    pub fn bound(&self) -> f64 {
        self.bound
    }
}

// a deterministic function has no state that a panic could leave half changed
impl UnwindSafe for Force {}
impl RefUnwindSafe for Force {}

impl fmt::Debug for Force {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Force").field("bound", &self.bound).finish_non_exhaustive()
    }
}
