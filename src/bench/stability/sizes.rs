//! Bodies of very different sizes (thesis, 4.3): a small body passes a large one that stands still.
//!
//! The path is that of `recordings/size_ratio.toml`, scaled with the sum of the radii: q goes from 1.37 to 0.96 and
//! back. Settings are the defaults, except that the small body's response is `rigid`, so that only influence deforms
//! it.

use glam::DVec3;
use rayon::prelude::*;

use crate::{Scene, World, bench::MeasureError, model::influence::Scaling, sim::BodyView};

/// Radius of the large body over that of the small one [–].
pub const RATIOS: [f64; 8] = [1.0, 2.0, 5.0, 10.0, 30.0, 100.0, 300.0, 1000.0];
/// Largest permitted displacement [radii].
pub const MOST: f64 = 0.5;

/// The deformation of one body.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Deformation {
    /// The largest displacement [radii].
    pub displacement: f64,
    /// The largest number of triangles that faced inwards at the same time.
    pub inverted: usize,
}

/// One passage of a small body past a large one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Passage {
    /// Radius of the large body over that of the small one [–].
    pub ratio: f64,
    /// The scaling law.
    pub scaling: Scaling,
    /// Deformation of the large body.
    pub large: Deformation,
    /// Deformation of the small body.
    pub small: Deformation,
}

/// The scene of a passage, as a scene file.
pub fn scene(ratio: f64, scaling: Scaling) -> String {
    let radius = 1.0 / ratio;
    let key = |[t, x, y, z]: [f64; 4]| {
        let [x, y, z] = [x, y, z].map(|v| v * (1.0 + radius) / 1.1);
        [t, x, y, z]
    };
    let keys =
        [[0.0, 1.45, -0.4, 0.1], [1.0, 1.06, -0.1, 0.05], [1.8, 1.05, 0.15, 0.05], [3.0, 1.45, 0.5, 0.1]].map(key);
    let scaling = match scaling {
        Scaling::Relative => "relative",
        Scaling::Absolute => "absolute",
    };
    format!(
        r#"name = "sizes"
dt = 0.008333333333333333
duration = 4.0

[material]
response = "rigid"

[influence]
scaling = "{scaling}"

[[body]]
name = "large"
radius = 1.0
shape = {{ sphere = {{ stacks = 24, slices = 48 }} }}
motion = {{ fixed = [0, 0, 0] }}

[[body]]
name = "small"
radius = {radius:?}
motion = {{ keyframes = {keys:?} }}
"#
    )
}

/// Measures all ratios under both laws.
///
/// # Errors
/// [`MeasureError`]
pub fn measure() -> Result<Vec<Passage>, MeasureError> {
    let laws = [Scaling::Absolute, Scaling::Relative];
    let cases: Vec<_> = RATIOS.into_iter().flat_map(|ratio| laws.map(|scaling| (ratio, scaling))).collect();
    cases.into_par_iter().with_max_len(1).map(|(ratio, scaling)| passage(ratio, scaling)).collect()
}

fn passage(ratio: f64, scaling: Scaling) -> Result<Passage, MeasureError> {
    let mut world = World::new(Scene::parse(&scene(ratio, scaling), "sizes.toml")?)?;
    let meshes: Vec<_> = world.bodies().map(|body| body.scene().shape.mesh()).collect();
    let mut deformations = [Deformation::default(); 2];
    for _ in 0..world.scene().steps() {
        world.step();
        for ((body, mesh), deformation) in world.bodies().zip(&meshes).zip(&mut deformations) {
            deformation.displacement = deformation.displacement.max(body.max_displacement() / body.scene().radius);
            deformation.inverted = deformation.inverted.max(inverted(&body, mesh.triangles()));
        }
    }
    let [large, small] = deformations;
    Ok(Passage { ratio, scaling, large, small })
}

/// Number of triangles whose normal points away from its direction at rest.
fn inverted(body: &BodyView<'_>, triangles: &[[u32; 3]]) -> usize {
    let normal = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a);
    let is_inverted = |triangle: &&[u32; 3]| {
        let rest = normal(triangle.map(|i| body.rest(i as usize)));
        let now = normal(triangle.map(|i| body.local_position(i as usize)));
        now.dot(rest) < 0.0
    };
    triangles.iter().filter(is_inverted).count()
}
