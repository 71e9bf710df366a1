//! Announces scenes that take minutes or gigabytes, before the time or the memory is spent.

use std::collections::HashSet;

use super::{Failure, say};
use crate::{
    scene::{Model, Scene},
    sim::{
        memory,
        reach::{Ball, Grid},
    },
    stream::settings::Detail,
    text::{bytes, counted, significant},
};

/// Estimates above these are announced [s], [bytes].
const LONG: f64 = 1.0;
const LARGE: u64 = 1 << 30;
/// Processor time of a step per sphere that acts on a vertex: measured with 2,000 spheres in one place [s].
const FORCE_SECONDS: f64 = 3e-8;
/// Memory for recording a frame, per vertex that moves: measured with 10,000 free bodies in a layer, without and with
/// forces [bytes].
const FRAME_BYTES: [u64; 2] = [1100, 2200];
/// Time and memory for the matrices of a sphere of 32 finite elements along a diameter [s], [bytes]; they grow with the
/// sixth and the fourth power.
const FEM: [f64; 2] = [20.0, 6.3e8];
const FEM_CELLS: f64 = 32.0;
/// Pairs of bodies are counted up to this number of tests, and bodies. The rest is extrapolated.
const MOST_TESTS: u64 = 4_000_000;
const MOST_BODIES: usize = 100_000;

/// Bodies within reach of each other at the start.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Near {
    pairs: f64,
    /// Spheres that may act on a vertex, of all vertices.
    forces: f64,
    /// Vertices of bodies in such pairs.
    vertices: f64,
}

impl Near {
    fn of(scene: &Scene) -> Near {
        let mut grid = Grid::default();
        let mut is_near = vec![false; scene.bodies.len()];
        let (mut near, mut tests, mut seen) = (Near::default(), 0, 0);
        for (b, body) in scene.bodies.iter().enumerate().take(MOST_BODIES) {
            if tests > MOST_TESTS {
                break;
            }
            seen = b + 1;
            let (centre, b) = (body.motion.start(), b as u32);
            // A ball within which the body acts and is acted on.
            grid.place(b, Ball { centre, radius: body.sphere_radius().max(body.radius) });
            grid.each_touching(b, |a| {
                tests += 1;
                let other = &scene.bodies[a as usize];
                let reach = f64::max(body.sphere_radius() + other.radius, other.sphere_radius() + body.radius);
                if centre.distance(other.motion.start()) < reach {
                    near.pairs += 1.0;
                    near.forces += (body.shape.vertex_count() + other.shape.vertex_count()) as f64;
                    (is_near[a as usize], is_near[b as usize]) = (true, true);
                }
            });
        }
        let of_near = scene.bodies.iter().zip(&is_near).filter(|(_, is_near)| **is_near);
        near.vertices = of_near.map(|(body, _)| body.shape.vertex_count() as f64).sum();
        // pairs grow with the square of the bodies where these are dense, which is where it matters
        let share = scene.bodies.len() as f64 / seen.max(1) as f64;
        let pairs = if tests > MOST_TESTS { share * share } else { share };
        Near { pairs: near.pairs * pairs, forces: near.forces * pairs, vertices: near.vertices * share }
    }
}

/// Announces what a scene takes to be simulated, and to have its frames recorded in this detail.
///
/// # Errors
/// The scene, or its recording, needs more memory than there is.
pub fn announce(scene: &Scene, recorded: Option<Detail>) -> Result<(), Failure> {
    if scene.model == Model::Oscillators {
        memory::check(scene).map_err(Failure::input)?;
    }
    for note in notes(scene, recorded, memory::available())? {
        say(&format!("note: {note}"));
    }
    Ok(())
}

fn notes(scene: &Scene, recorded: Option<Detail>, available: u64) -> Result<Vec<String>, Failure> {
    let mut notes = Vec::new();
    if scene.model == Model::Fem {
        let material = |of: &crate::scene::Body| [of.radius, of.mass, of.material.omega, of.material.damping];
        let kinds: HashSet<_> =
            scene.bodies.iter().map(|body| (&body.shape, material(body).map(f64::to_bits))).collect();
        let finer = f64::from(scene.fem.cells) / FEM_CELLS;
        let [seconds, size] = [FEM[0] * finer.powi(6), FEM[1] * finer.powi(4)].map(|one| one * kinds.len() as f64);
        if seconds > LONG || size > LARGE as f64 {
            notes.push(format!(
                "finite elements, fem.cells = {}: their matrices take about {} s and {}; lower `cells` in [fem]",
                scene.fem.cells,
                significant(seconds),
                bytes(size as u64)
            ));
        }
    }
    let near = Near::of(scene);
    let seconds = FORCE_SECONDS * near.forces;
    if seconds > LONG {
        notes.push(format!(
            "about {} of bodies are within reach of each other at the start: a step takes about {} s; move bodies apart, \
             lower their reach, or `stacks` and `slices` of the shapes",
            counted(near.pairs as u64, "pair"),
            significant(seconds)
        ));
    }
    if let Some(detail) = recorded {
        let needed = FRAME_BYTES[usize::from(detail != Detail::Surface)].saturating_mul(near.vertices as u64);
        let what = format!(
            "recording {} of bodies near each other takes about {} of memory; lower `stacks` and `slices` of the shapes or \
             `count` of grids, or record with --thin",
            counted(near.vertices as u64, "vertex"),
            bytes(needed)
        );
        if needed > available / 10 * 9 {
            return Err(Failure::Input(format!(
                "scene \"{}\" is too large for this machine: {what} ({} are available)",
                scene.name,
                bytes(available)
            )));
        }
        if needed > LARGE {
            notes.push(what);
        }
    }
    Ok(notes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(count: &str, spacing: &str, shape: &str) -> Scene {
        let text = format!(
            "duration = 1\n[[grid]]\nname = 'a'\nradius = 1\ncount = {count}\nspacing = {spacing}\nshape = {{ sphere = {shape} }}\n\
             motion = {{ fixed = [0, 0, 0] }}\n"
        );
        Scene::parse(&text, "grid.toml").unwrap()
    }

    const USUAL: &str = "{ stacks = 12, slices = 24 }";

    #[test]
    fn pairs_are_counted_and_extrapolated() {
        let near = Near::of(&grid("[10, 10, 1]", "[2, 2, 0]", USUAL));
        // reach is 2.414: only the neighbours along the axes
        assert_eq!(near, Near { pairs: 180.0, forces: 180.0 * 532.0, vertices: 26_600.0 });
        assert_eq!(Near::of(&grid("[10, 10, 1]", "[3, 3, 0]", USUAL)), Near::default());
        let many = Near::of(&grid("[20000, 1, 1]", "[0, 0, 0]", "{ stacks = 2, slices = 3 }"));
        assert!((many.pairs / 2e8 - 1.0).abs() < 0.01, "{many:?}");
    }

    #[test]
    fn what_takes_long_or_much_is_announced_with_its_key() {
        let of = |scene: &Scene, available| notes(scene, Some(Detail::Forces), available);
        let usual = Scene::builtin("crowd").unwrap();
        assert_eq!(of(&usual, 1 << 40).unwrap(), [""; 0]);
        let coincident = grid("[2000, 1, 1]", "[0, 0, 0]", USUAL);
        let found = of(&coincident, 1 << 40).unwrap();
        assert!(found.iter().any(|note| note.contains("1,999,000 pairs") && note.contains("reach")), "{found:?}");
        let fine = grid("[2, 1, 1]", "[1.5, 0, 0]", "{ stacks = 1500, slices = 1500 }");
        let found = of(&fine, 1 << 40).unwrap();
        assert!(found.iter().any(|note| note.contains("9.2 GiB") && note.contains("stacks")), "{found:?}");
        let refused = of(&fine, 4 << 30).unwrap_err().to_string();
        assert!(refused.contains("9.2 GiB") && refused.contains("(4.0 GiB are available)"), "{refused}");
        let mut fem = Scene::builtin("two").unwrap();
        fem.model = Model::Fem;
        assert_eq!(of(&fem, 1 << 40).unwrap(), [""; 0]);
        fem.fem.cells = 64;
        let found = of(&fem, 1 << 40).unwrap();
        assert!(found.len() == 1 && found[0].contains("fem.cells = 64") && found[0].contains("GiB"), "{found:?}");
    }
}
