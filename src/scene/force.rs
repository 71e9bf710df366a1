//! Forces that a program gives.

use std::{
    fmt,
    panic::{RefUnwindSafe, UnwindSafe},
    sync::Arc,
};

use glam::DVec3;

/// A force on a free body that a program gives, as an acceleration that all of its vertices share: it moves the centre,
/// and neither turns nor deforms the body. There is no such force in a scene file, and no recording of it can be
/// replayed. A body on which one acts never rests.
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
///     world.step();
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
    /// The acceleration `at` [scene unit/s²], of time t [s], position c [scene unit] and velocity c′ [scene unit/s] of the
    /// centre.
    ///
    /// The function must be continuous, give the same for the same arguments, and be nowhere longer than `bound` where the
    /// body gets: what the body may touch in a step is searched for as far as that takes it. It is called several times at
    /// instants within a step, for estimates too, from any thread. The smoother it is the longer are the steps; one that
    /// jumps ends the run as a step that cannot be followed.
    pub fn new(bound: f64, at: impl Fn(f64, DVec3, DVec3) -> DVec3 + Send + Sync + 'static) -> Force {
        Force { at: Arc::new(at), bound }
    }

    /// The acceleration [scene unit/s²].
    pub fn acceleration(&self, t: f64, centre: DVec3, velocity: DVec3) -> DVec3 {
        (self.at)(t, centre, velocity)
    }

    /// A bound of its length [scene unit/s²].
    pub fn bound(&self) -> f64 {
        self.bound
    }
}

// a function that gives the same for the same arguments has no state that a panic could leave half changed
impl UnwindSafe for Force {}
impl RefUnwindSafe for Force {}

impl fmt::Debug for Force {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Force").field("bound", &self.bound).finish_non_exhaustive()
    }
}
