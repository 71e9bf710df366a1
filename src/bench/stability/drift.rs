//! Energy drift of two merged, undamped bodies at rest over a million steps. The exact energy is constant.

use std::time::Instant;

use super::bound::Allowance;
use crate::{
    Scene, World,
    bench::{
        MeasureError,
        report::{Column, Table},
    },
    scene::Integrator,
    text::significant,
};

/// Number of steps.
pub const STEPS: u64 = 1_000_000;
/// Permitted energy drift of the exponential integrator, as a fraction of the available energy [–].
pub const MOST: f64 = 1e-3;
/// Steps between energy measurements.
const STRIDE: u64 = 10;
/// A run is stopped once its energy has drifted by this factor [–].
const HOPELESS: f64 = 1e3;

/// The measured energy drift.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drift {
    /// The integrator.
    pub integrator: Integrator,
    /// Number of steps.
    pub steps: u64,
    /// The largest |E(t) − E(0)|, relative to the excess of E(0) over the minimum of E [–].
    pub largest: f64,
    /// Run time [s].
    pub seconds: f64,
}

/// The drifts of some integrators.
pub fn table(drifts: &[Drift]) -> Table {
    let drift = |share: f64| if share.is_finite() { format!("{share:.1e}") } else { "not finite".to_owned() };
    let row = |it: &Drift| vec![it.integrator.name().into(), it.steps.into(), it.largest.into(), it.seconds.into()];
    Table {
        title: format!(
            "two merged bodies without damping: energy drift, relative to the energy above its minimum (exponential: at most \
             {MOST:.0e})"
        ),
        columns: vec![
            Column::text("integrator", ""),
            Column::count("steps", ""),
            Column::number("energy drift", "", drift),
            Column::number("run time [s]", "", significant),
        ],
        rows: drifts.iter().map(row).collect(),
        conclusions: vec![],
    }
}

impl Drift {
    /// Whether the energy was conserved.
    pub fn is_small(&self) -> bool {
        self.largest <= MOST
    }
}

/// Two bodies with few vertices, as a scene file.
const SCENE: &str = r#"# Energy is constant: nothing moves but the vertices, and nothing damps them.
name = "million"
duration = 16666.666666666668

[material]
damping = 0.0

[[body]]
name = "a"
radius = 1.0
shape = { sphere = { stacks = 4, slices = 4 } }
motion = { fixed = [0, 0, 0] }

[[body]]
name = "b"
radius = 0.8
shape = { sphere = { stacks = 2, slices = 3 } }
motion = { fixed = [1.3, 0.2, 0.4] }
"#;

/// Runs the scene and tracks its energy.
///
/// # Errors
/// [`MeasureError`]
pub fn measure(integrator: Integrator, steps: u64) -> Result<Drift, MeasureError> {
    let scene = Scene { integrator, ..Scene::parse(SCENE, "million.toml")? };
    let available: f64 = (0..scene.bodies.len()).map(|index| Allowance::new(&scene, index).energy()).sum();
    let mut world = World::new(scene)?;
    let start = world.energy().total();
    let mut drift = Drift { integrator, steps: 0, largest: 0.0, seconds: 0.0 };
    let clock = Instant::now();
    while drift.steps < steps {
        let _ = world.step();
        drift.steps += 1;
        if !drift.steps.is_multiple_of(STRIDE) {
            continue;
        }
        let change = (world.energy().total() - start).abs() / available;
        // written so that NaN propagates
        if !(change <= drift.largest) {
            drift.largest = change;
        }
        if !(change <= HOPELESS) {
            break;
        }
    }
    drift.seconds = clock.elapsed().as_secs_f64();
    Ok(drift)
}
