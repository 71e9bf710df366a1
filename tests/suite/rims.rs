//! Vertices that cross the rim of an influence sphere within a step, where the linear weight has a kink.
//!
//! Each scene is run with a coarse step and compared with itself at a step 256 times smaller, where many steps lie on
//! either side of every crossing.

use glam::DVec3;
use meldscope::{Scene, World, scene::Push};

/// The largest distance of any vertex between the two runs, over all times of the coarse run, in radii of body `a`.
fn error(motion: &str, dt: f64, alpha: f64) -> (f64, u64) {
    let text = format!(
        r#"
        dt = {dt}
        duration = {}
        [material]
        omega = 12.0
        damping = 0.5
        response = "rigid"
        [influence]
        alpha = {alpha}
        merge_at = 5.0
        split_at = 50.0
        reach = 1.0
        [[body]]
        name = "a"
        radius = 1.0
        shape = {{ sphere = {{ stacks = 6, slices = 8 }} }}
        motion = {{ fixed = [0, 0, 0] }}
        [[body]]
        name = "b"
        radius = 1.0
        shape = {{ sphere = {{ stacks = 2, slices = 3 }} }}
        motion = {{ {motion} }}
        "#,
        8.0 * dt
    );
    const FINER: u64 = 256;
    let coarse = Scene::parse(&text, "rims.toml").expect("a valid scene");
    let fine = Scene { dt: dt / FINER as f64, tolerance: 1e-11, ..coarse.clone() };
    let steps = coarse.steps();
    let (mut coarse, mut fine) = (World::new(coarse).expect("enough memory"), World::new(fine).expect("enough memory"));
    let (mut worst, mut substeps) = (0.0, 0);
    for _ in 0..steps {
        substeps += coarse.step().substeps;
        (0..FINER).for_each(|_| {
            let _ = fine.step();
        });
        for (a, b) in coarse.body(0).positions().zip(fine.body(0).positions()) {
            worst = f64::max(worst, a.distance(b));
        }
    }
    (worst, substeps)
}

/// A sphere passes so fast that vertices enter and leave it within one step, between two samples of the step: 2 units
/// in 1/50 of the step.
#[test]
fn a_vertex_that_enters_and_leaves_within_a_step() {
    let (error, substeps) = error("line = { from = [1.7, -40, 0], velocity = [0, 1000, 0] }", 0.1, 100.0);
    assert!(substeps > 16, "{substeps}: no crossing was detected");
    assert!(error < 1e-8, "{error:e}");
}

/// A sphere passes so slowly that the crossings within a step belong to different vertices.
#[test]
fn vertices_that_enter_one_by_one() {
    for speed in [0.5, 3.0, 20.0] {
        let motion = format!("line = {{ from = [1.9, {}, 0.1], velocity = [0, {speed}, 0] }}", -0.2 * speed);
        let (error, _) = error(&motion, 0.05, 100.0);
        assert!(error < 2e-7, "speed {speed}: {error:e}");
    }
}

/// The rim approaches a vertex to within `gap`, touches it, or encloses it by that much, and recedes: vertex 0 of the
/// sphere is at (0, 0, 1), and the sphere's centre passes above it at a distance of 1 + gap.
#[test]
fn a_vertex_that_grazes_the_rim() {
    for gap in [1e-3, 1e-6, 1e-9, 0.0, -1e-9, -1e-6, -1e-3] {
        let motion = format!("line = {{ from = [-0.35, 0, {}], velocity = [1, 0, 0] }}", 2.0 + gap);
        let (error, _) = error(&motion, 0.1, 100.0);
        // Measured: 1.1e-9 at most; 8e-7 is allowed.
        assert!(error < 2e-9, "gap {gap:e}: {error:e}");
    }
}

/// A vertex that starts exactly on the rim of a sphere that moves towards it or away from it.
#[test]
fn a_vertex_that_starts_on_the_rim() {
    for velocity in [-1.0, 1.0] {
        let motion = format!("line = {{ from = [0, 0, 2], velocity = [0, 0, {velocity}] }}");
        let (error, _) = error(&motion, 0.02, 100.0);
        assert!(error < 1e-8, "velocity {velocity}: {error:e}");
    }
}

/// The attraction itself is stiff: α Δt² = 100, where the vertices oscillate within a step.
#[test]
fn a_stiff_attraction() {
    let (error, substeps) = error("fixed = [1.6, 0, 0]", 0.1, 1e4);
    assert!(substeps > 100, "{substeps}: the stiffness was not detected");
    assert!(error < 1e-6, "{error:e}");
}

/// The linear weight has a kink at the centre, too: vertex 0 of the sphere is at (0, 0, 1), and another sphere's centre passes
/// it closely, at any time of a step.
#[test]
fn a_vertex_that_passes_a_centre() {
    for gap in [0.0, 0.003, 0.03] {
        for time in [0.2, 0.36, 0.5, 0.64, 0.8] {
            let (dt, speed) = (1.0 / 60.0, 6.0);
            let motion = format!(
                "line = {{ from = [{}, {gap}, 0.98], velocity = [{speed}, 0, 0] }}",
                -speed * dt * (3.0 + time)
            );
            let (error, _) = error(&motion, dt, 200.0);
            // 1.3e-7 is allowed.
            assert!(error < 1e-7, "gap {gap}, time {time}: {error:e}");
        }
    }
}

/// In steps three times as long as usual most vertices that cross a rim do so far from both ends, several of them in a
/// step, and bodies that wobble move along no cubic.
#[test]
fn crossings_in_long_steps_meet_the_tolerance() {
    const FINER: u64 = 8;
    for (name, duration) in [("two", 4.0), ("three", 4.0), ("crowd", 1.0)] {
        for tolerance in [1e-4, 1e-6] {
            let scene = Scene::builtin(name).expect("a built-in scene");
            let coarse = Scene { dt: 0.05, duration, tolerance, ..scene };
            let fine = Scene { dt: coarse.dt / FINER as f64, tolerance: 1e-11, ..coarse.clone() };
            let radii: Vec<f64> = coarse.bodies.iter().map(|body| body.radius).collect();
            let steps = coarse.steps();
            let mut coarse = World::new(coarse).expect("enough memory");
            let mut fine = World::new(fine).expect("enough memory");
            let mut worst = 0.0;
            for _ in 0..steps {
                let _ = coarse.step();
                (0..FINER).for_each(|_| {
                    let _ = fine.step();
                });
                for (body, radius) in radii.iter().enumerate() {
                    let (a, b) = (coarse.body(body), fine.body(body));
                    for vertex in 0..a.vertex_count() {
                        worst = f64::max(worst, a.displacement(vertex).distance(b.displacement(vertex)) / radius);
                    }
                }
            }
            assert!(worst < 0.1 * tolerance, "{name} at {tolerance:e}: {worst:e}");
        }
    }
}

/// Vertices that cross rims are stepped side by side, except where pushes move their rest positions: pushes that are too weak
/// to matter must change nothing.
#[test]
fn crossings_side_by_side_agree_with_those_of_single_vertices() {
    for (name, dt) in [("two", 1.0 / 60.0), ("two", 0.05), ("three", 0.05)] {
        let scene = Scene { dt, ..Scene::builtin(name).expect("a built-in scene") };
        let mut pushed = scene.clone();
        pushed.pushes.extend((0..scene.bodies.len()).map(|body| Push {
            body,
            direction: DVec3::X,
            strength: 1e-13,
            start: 0.0,
            duration: scene.duration,
        }));
        let bodies = scene.bodies.len();
        let steps = scene.steps();
        let mut beside = World::new(scene).expect("enough memory");
        let mut alone = World::new(pushed).expect("enough memory");
        let mut worst = 0.0;
        for _ in 0..steps {
            let _ = beside.step();
            let _ = alone.step();
            for body in 0..bodies {
                for (a, b) in beside.body(body).positions().zip(alone.body(body).positions()) {
                    worst = f64::max(worst, a.distance(b));
                }
            }
        }
        assert!(worst < 1e-11, "{name} at {dt}: {worst:e}");
    }
}
