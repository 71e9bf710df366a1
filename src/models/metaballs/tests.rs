//! Metaballs against closed forms and independent quadratures.

use std::{collections::HashSet, f64::consts::SQRT_2};

use glam::DVec3;

use super::{
    Metaballs,
    density::{Ball, Kernel, density_of, slope_of},
    surface::{Mesh, extract, measures},
};
use crate::{
    analysis::surface::Merger,
    geometry::union::Topology,
    observe::{Frame, Simulation, StepSummary, SurfaceEvent, Want, surface::Finding},
    scene::{Model, Scene},
    sim::{Options, numerics::roots::root},
};

fn ball(centre: DVec3, radius: f64, reach: f64) -> Ball {
    Ball { centre, radius, kernel: Kernel::new(reach).unwrap() }
}

/// Euler characteristic and number of components of a mesh, which must be closed and oriented.
fn topology(mesh: &Mesh) -> (i64, usize) {
    let topology = Topology::new(mesh.positions.len(), &mesh.triangles).expect("closed and oriented");
    let used: HashSet<u32> = mesh.triangles.iter().flatten().copied().collect();
    assert_eq!(used.len(), mesh.positions.len());
    (mesh.positions.len() as i64 - mesh.triangles.len() as i64 / 2, topology.components.len())
}

/// Gauss–Legendre nodes and weights on [0, 1].
const GAUSS: [[f64; 2]; 5] = [
    [0.046_910_077_030_668_0, 0.118_463_442_528_094_5],
    [0.230_765_344_947_158_5, 0.239_314_335_249_683_2],
    [0.5, 0.284_444_444_444_444_4],
    [0.769_234_655_052_841_5, 0.239_314_335_249_683_2],
    [0.953_089_922_969_332, 0.118_463_442_528_094_5],
];

/// The volume within the exact surface of a mesh [scene unit³]: the volume of the mesh plus that between its triangles
/// and the surface.
///
/// The gap between a triangle p(u, v) and the surface is filled with the lines p + s d, where d is interpolated
/// linearly between the normals at the corners, so that neighbours fit. It is integrated in s exactly and by a Gauss
/// product rule over the triangle. With the mesh of [`extract`], the error is below 1e-7 of the volume for balls of
/// similar size, and below 1e-6 beside a much smaller one, because the third derivative of the density jumps at the end
/// of a support.
fn volume(balls: &[Ball], mesh: &Mesh) -> f64 {
    let normals: Vec<DVec3> = mesh.positions.iter().map(|&at| (-slope_of(balls, at)).normalize_or(DVec3::Z)).collect();
    let beyond = mesh.triangles.iter().map(|corners| {
        let [p, q, r] = corners.map(|v| mesh.positions[v as usize]);
        let [n, o, m] = corners.map(|v| normals[v as usize]);
        let (e1, e2, d1, d2) = (q - p, r - p, o - n, m - n);
        let mut sum = 0.0;
        for [z, weight_z] in GAUSS {
            for [w, weight_w] in GAUSS {
                // the unit square, folded onto the triangle
                let (u, v) = (z * (1.0 - w), w);
                let (at, d) = (p + u * e1 + v * e2, n + u * d1 + v * d2);
                let s = height(balls, at, d, e1.length().max(e2.length()));
                let flat = d.dot(e1.cross(e2));
                let bent = d.dot(e1.cross(d2) + d1.cross(e2));
                let twisted = d.dot(d1.cross(d2));
                let within = s * (flat + s * (0.5 * bent + s * twisted / 3.0));
                sum += weight_z * weight_w * (1.0 - w) * within;
            }
        }
        sum
    });
    measures(&mesh.positions, &mesh.triangles)[0] + beyond.sum::<f64>()
}

/// The signed distance from a point to the surface along a direction [scene unit], at most `max` either way.
fn height(balls: &[Ball], at: DVec3, direction: DVec3, max: f64) -> f64 {
    let mut s = 0.0;
    for _ in 0..20 {
        let here = at + s * direction;
        let step = (density_of(balls, here) - 1.0) / slope_of(balls, here).dot(direction);
        if !step.is_finite() {
            return 0.0;
        }
        s = (s - step).clamp(-max, max);
        if step.abs() <= 1e-15 * max {
            break;
        }
    }
    s
}

/// The volume of balls whose centres are on the x axis, by Simpson's rule over the areas of cross-sections. A ball is its
/// place, radius and reach.
fn turned(balls: &[(f64, f64, f64)]) -> f64 {
    // F as a function of x and the squared distance from the axis, implemented independently
    let density = |x: f64, square: f64| -> f64 {
        let of = |&(at, radius, reach): &(f64, f64, f64)| {
            let u = 1.0 - ((x - at) * (x - at) + square) / (reach * reach * radius * radius);
            u.max(0.0).powi(3) / (1.0 - 1.0 / (reach * reach)).powi(3)
        };
        balls.iter().map(of).sum()
    };
    let cut = |x: f64| {
        let (mut low, mut high) = (0.0, 9.0);
        if density(x, 0.0) < 1.0 {
            return 0.0;
        }
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if density(x, middle) >= 1.0 { low = middle } else { high = middle }
        }
        std::f64::consts::PI * low
    };
    let left = |x: f64| root(0.0, 3.0, |by| density(x - by, 0.0) - 1.0);
    let right = |x: f64| root(0.0, 3.0, |by| density(x + by, 0.0) - 1.0);
    let (from, to) = (balls[0].0 - left(balls[0].0), balls[balls.len() - 1].0 + right(balls[balls.len() - 1].0));
    let count = 20_000;
    let h = (to - from) / f64::from(count);
    let weight = |k: i32| match k {
        0 => 1.0,
        k if k == count => 1.0,
        k => 2.0 + 2.0 * f64::from(k % 2),
    };
    (0..=count).map(|k| weight(k) * cut(from + h * f64::from(k))).sum::<f64>() * h / 3.0
}

#[test]
fn volumes_match_an_independent_quadrature() {
    for (balls, allowed) in [
        (vec![(0.0, 1.0, SQRT_2), (2.05, 1.0, SQRT_2)], 1e-6),
        (vec![(0.0, 1.0, SQRT_2), (1.3, 0.7, SQRT_2)], 1e-6),
        (vec![(0.0, 1.0, 2.0), (2.2, 0.8, 2.0)], 1e-6),
        (vec![(0.0, 1.0, 1.6), (2.1, 1.0, 1.6), (4.1, 0.9, 1.6)], 1e-6),
        (vec![(0.0, 1.0, SQRT_2), (1.03, 0.15, SQRT_2)], 1e-6),
        // the narrower a support, the more the third derivative of the density jumps at its end
        (vec![(0.0, 1.0, 1.3), (2.1, 0.9, 2.2)], 5e-5),
    ] {
        // along a direction that is not aligned with the grid of three balls
        let along = DVec3::new(2.0, 1.0, -2.0) / 3.0;
        let all: Vec<Ball> = balls.iter().map(|&(x, radius, reach)| ball(x * along, radius, reach)).collect();
        let mesh = extract(&all, all.len(), None).unwrap();
        assert_eq!(topology(&mesh), (2, 1), "{balls:?}");
        let (found, expected) = (volume(&all, &mesh), turned(&balls));
        assert!((found / expected - 1.0).abs() < allowed, "{balls:?}: {found} {expected}");
    }
    let alone = ball(DVec3::new(0.3, 0.2, 0.1), 0.8, 1.5);
    let mesh = extract(&[alone], 1, None).unwrap();
    let sphere = 4.0 / 3.0 * std::f64::consts::PI * 0.8f64.powi(3);
    assert!((volume(&[alone], &mesh) / sphere - 1.0).abs() < 1e-9);
}

/// Connected exactly if the saddle is above the threshold, however thin the neck; a ring of balls has a hole.
#[test]
fn surfaces_have_the_expected_topology() {
    // 2 (1 − d²/8)³ = 1/8
    let d = (8.0 * (1.0 - 0.0625f64.cbrt())).sqrt();
    for (distance, expected) in [(d - 1e-9, (2, 1)), (d + 1e-9, (4, 2)), (1.4, (2, 1)), (0.1, (2, 1)), (0.0, (2, 1))] {
        let balls = [DVec3::ZERO, DVec3::new(0.6, -0.48, 0.64) * distance].map(|centre| ball(centre, 1.0, SQRT_2));
        let mesh = extract(&balls, 2, None).unwrap();
        assert_eq!(topology(&mesh), expected, "{distance}");
    }
    let ring: Vec<Ball> = (0..8)
        .map(|k| {
            let (sin, cos) = libm::sincos(std::f64::consts::TAU * f64::from(k) / 8.0);
            ball(2.6 * DVec3::new(cos, sin, 0.0), 1.0, SQRT_2)
        })
        .collect();
    let mesh = extract(&ring, 8, None).unwrap();
    assert_eq!(topology(&mesh), (0, 1), "a torus");
    // a neighbour outside the group contributes nothing to the mesh
    let mesh = extract(&[ring[0], ring[2], ring[1]], 2, None).unwrap();
    assert_eq!(topology(&mesh), (4, 2));
}

fn scene(text: &str) -> Scene {
    Scene { model: Model::Metaballs, ..Scene::parse(text, "balls.toml").unwrap() }
}

fn contacts(text: &str) -> Vec<SurfaceEvent> {
    let scene = scene(text);
    let mut balls = Metaballs::new(&scene, Options::default()).unwrap();
    let mut all = Vec::new();
    for _ in 0..scene.steps() {
        balls.step(&mut StepSummary::default());
        all.extend_from_slice(balls.contacts().unwrap());
    }
    all
}

const TWO: &str = "duration = 8.0\ndt = 0.1\n[[body]]\nname = 'a'\nradius = 1.0\nmotion = { fixed = [0, 0, 0] }\n\
                   [[body]]\nname = 'b'\nradius = 1.0\n\
                   motion = { line = { from = [-4, 0.5, 0], velocity = [1, 0, 0] } }\n";

#[test]
fn two_balls_become_one_and_two_at_times_in_closed_form() {
    let d2 = 8.0 * (1.0 - 0.0625f64.cbrt());
    let half = (d2 - 0.25).sqrt();
    let events = contacts(TWO);
    let expected = [(Finding::Touch, 4.0 - half), (Finding::Part, 4.0 + half)];
    assert_eq!(events.len(), 2, "{events:?}");
    for (event, (what, time)) in events.iter().zip(expected) {
        assert!(event.what == what && (event.time - time).abs() < 1e-11, "{event:?} {time}");
        assert!((event.q - 0.5 * d2.sqrt()).abs() < 1e-11 && event.step == (event.time / 0.1).ceil() as u64);
    }
}

/// The density between a large ball and a small one is least close to the small one: the root of that density is found by
/// itself here, on a fine grid.
#[test]
fn balls_of_different_sizes_touch_where_the_least_density_reaches_the_threshold() {
    let text = "duration = 4\ndt = 0.1\n[[body]]\nname = 'a'\nradius = 9.23783179901658\nreach = 5.558385510179625\n\
                motion = { fixed = [0, 0, 0] }\n[[body]]\nname = 'b'\nradius = 1.0\nreach = 1.333672736607671\n\
                motion = { line = { from = [10.762486359343165, 0, 0], velocity = [-0.1, 0, 0] } }\n";
    let density = |distance: f64, reach: f64, radius: f64| {
        let of = |r: f64| (1.0 - (r / (reach * radius)).powi(2)).max(0.0).powi(3);
        of(distance) / of(radius)
    };
    let least = |apart: f64| {
        let at = |k: u32| 9.23783179901658 + f64::from(k) * 1e-5 * (apart - 10.23783179901658);
        let sum = |x: f64| density(x, 5.558385510179625, 9.23783179901658) + density(apart - x, 1.333672736607671, 1.0);
        (0..=100_000).map(|k| sum(at(k))).fold(f64::INFINITY, f64::min)
    };
    let (mut near, mut far) = (10.3, 10.76);
    while far - near > 1e-9 {
        let middle = 0.5 * (near + far);
        if least(middle) >= 1.0 { near = middle } else { far = middle }
    }
    let events = contacts(text);
    assert_eq!(events.len(), 1, "{events:?}");
    assert!((10.762486359343165 - 0.1 * events[0].time - near).abs() < 2e-9, "{events:?}, at a distance of {near}");
}

/// A ball that is at one place at both ends of a step, and visits another within it.
#[test]
fn a_visit_within_a_step_is_found() {
    let events = contacts(
        "duration = 1.0\ndt = 0.5\n[[body]]\nname = 'a'\nradius = 1.0\nmotion = { fixed = [0, 0, 0] }\n\
         [[body]]\nname = 'b'\nradius = 1.0\n\
         motion = { keyframes = { interpolation = 'linear', keys = [[0, 3, 0, 0], [0.25, 1.5, 0, 0], [0.5, 3, 0, 0]] } }\n",
    );
    let found: Vec<_> = events.iter().map(|event| (event.what, event.step)).collect();
    assert_eq!(found, [(Finding::Touch, 1), (Finding::Part, 1)]);
    assert!((events[0].time + events[1].time - 0.5).abs() < 1e-9, "{events:?}");
}

/// A ball that swings past another several times in a step.
#[test]
fn all_visits_within_a_step_are_found() {
    let visits = |dt: f64| {
        contacts(&format!(
            "duration = 1.0\ndt = {dt}\n[[body]]\nname = 'a'\nradius = 1.0\nmotion = {{ fixed = [0, 0, 0] }}\n\
             [[body]]\nname = 'b'\nradius = 0.9\nmotion = {{ sine = {{ center = [1.9, 0, 0], amplitude = [0, 0.9, 0], \
             frequency = 7.0, phase = 1.0 }} }}\n"
        ))
    };
    let [few, many] = [0.1, 0.01].map(visits);
    assert_eq!((few.len(), many.len()), (28, 28));
    for (one, other) in few.iter().zip(&many) {
        assert!(one.what == other.what && (one.time - other.time).abs() < 1e-12, "{one:?} {other:?}");
    }
}

/// Three balls moving to the middle of their triangle: by symmetry the saddle of a pair is on an altitude of the
/// triangle, where the density is a function of one variable.
#[test]
fn three_balls_become_one_at_the_time_of_a_one_dimensional_problem() {
    let body = |name: &str, k: f64| {
        let (sin, cos) = libm::sincos(std::f64::consts::TAU * k / 3.0);
        format!(
            "[[body]]\nname = '{name}'\nradius = 1.0\nmotion = {{ line = {{ from = [{:?}, {:?}, 0.5], velocity = [{:?}, {:?}, 0] }} }}\n",
            2.0 * cos,
            2.0 * sin,
            -0.4 * cos,
            -0.4 * sin
        )
    };
    let text = format!(
        "duration = 2.0\ndt = 0.05\n[influence]\nreach = 3.0\n{}{}{}",
        body("a", 0.0),
        body("b", 1.0),
        body("c", 2.0)
    );
    let events = contacts(&text);
    // relative to the middle of the triangle: the balls at distance s, the saddle at −y on the third one's altitude
    let density = |s: f64, y: f64| {
        let of = |square: f64| ((1.0 - square / 9.0).max(0.0) * 1.125).powi(3);
        let (side, along) = (0.75f64.sqrt() * s, 0.5 * s - y);
        2.0 * of(side * side + along * along) + of((s + y) * (s + y))
    };
    // the largest density from the outside to the middle, across the path from one ball to the other
    let highest = |s: f64| {
        let coarse = (0..=1000)
            .map(|k| 0.5 * s * f64::from(k) / 1000.0)
            .max_by(|x, y| density(s, *x).total_cmp(&density(s, *y)));
        let (mut low, mut high) = (coarse.unwrap() - 1e-3 * s, coarse.unwrap() + 1e-3 * s);
        for _ in 0..200 {
            let [one, other] = [low + (high - low) / 3.0, high - (high - low) / 3.0];
            if density(s, one) < density(s, other) { low = one } else { high = other }
        }
        density(s, 0.5 * (low + high))
    };
    let s = root(1.0, 2.0, |s| highest(s) - 1.0);
    let expected = (2.0 - s) / 0.4;
    assert_eq!(events.len(), 3, "{events:?}");
    assert!(events.iter().all(|event| (event.time - expected).abs() < 1e-10), "{events:?} {expected}");
    assert!(highest(s) > density(s, 0.5 * s) + 1e-6, "the third ball is felt");
}

#[test]
fn vertices_are_on_the_surface_and_move_with_it() {
    let text = TWO.replace("[-4, 0.5, 0]", "[-2.6, 0.5, 0.1]");
    let scene = scene(&text);
    let mut balls = Metaballs::new(&scene, Options::default()).unwrap();
    let (mut frame, mut before, mut after) = (Frame::default(), Frame::default(), Frame::default());
    let mut seen = 0;
    for _ in 0..6 {
        balls.step(&mut StepSummary::default());
        balls.observe(Want::ALL, &mut frame);
        let h = 1e-6;
        balls.within(&Frame::default(), balls.time() - h, &[0, 1], &mut before);
        balls.within(&Frame::default(), balls.time() + h, &[0, 1], &mut after);
        let all: Vec<Ball> = frame.bodies.iter().map(|body| ball(body.centre, 1.0, SQRT_2)).collect();
        for (index, now) in frame.bodies.iter().enumerate().filter(|(_, now)| !now.is_at_rest) {
            for i in 0..now.positions.len() {
                let at = now.centre + now.positions.get(i);
                let [own, other] = [index, 1 - index].map(|of| all[of].density(at));
                let is_shared = (own - other).abs() < 1e-12 && own + other >= 1.0;
                assert!((own + other - 1.0).abs() < 1e-12 || is_shared, "{own} {other}");
                let [from, to] = [&before, &after].map(|frame| frame.bodies[index].displacements.get(i));
                let rate = (to - from) / (2.0 * h);
                // except the vertex at which the surface meets the other body's part
                if (own - other).abs() > 1e-3 || own + other > 1.001 {
                    assert!(rate.distance(now.velocities.get(i)) < 1e-6, "{rate} {}", now.velocities.get(i));
                    seen += 1;
                }
            }
        }
    }
    assert!(seen > 1000, "{seen}");
}

/// The neck of two balls of different sizes is the thinnest section across the line of their centres.
#[test]
fn the_neck_is_the_thinnest_section() {
    for distance in [1.95, 1.9, 1.85, 1.7] {
        let scene = scene(&format!(
            "duration = 1\n[influence]\nreach = 1.5\n[[body]]\nname = 'a'\nradius = 0.5\nmotion = {{ fixed = [0, 0, 0] }}\n\
             [[body]]\nname = 'b'\nradius = 1.4\nmotion = {{ fixed = [{distance}, 0, 0] }}\n"
        ));
        let balls = Metaballs::new(&scene, Options::default()).unwrap();
        let (schema, mut frame) = (balls.schema(), Frame::default());
        balls.observe(Want::ALL, &mut frame);
        let measures = Merger::new(&schema, None).merge(&schema, &frame, &[[0, 1]]).pairs[0].unwrap();
        // f(r) = (1 − r²/r_e²)³, and the threshold is its value at r = R
        let density = |s: f64, h: f64| {
            let of = |radius: f64, along: f64| {
                let reach = 1.5 * radius;
                let of = |r2: f64| f64::max(0.0, 1.0 - r2 / (reach * reach)).powi(3);
                of(along * along + h * h) / of(radius * radius)
            };
            of(0.5, s) + of(1.4, distance - s)
        };
        let section = |s: f64| (1..).map(|k| f64::from(k) * 1e-4).find(|&h| density(s, h) < 1.0).unwrap();
        let thinnest = (0..=2000).map(|k| section(distance * f64::from(k) / 2000.0)).fold(f64::INFINITY, f64::min);
        let neck = 0.5 * measures.neck;
        assert!((neck - thinnest).abs() < 2e-4, "{distance}: {neck} {thinnest}");
    }
}

#[test]
fn groups_are_drawn_as_one_surface() {
    let scene = scene(TWO);
    let mut balls = Metaballs::new(&scene, Options::default()).unwrap();
    let (schema, mut frame) = (balls.schema(), Frame::default());
    let mut merger = Merger::new(&schema, None);
    let mut pieces = Vec::new();
    for _ in 0..scene.steps() {
        balls.step(&mut StepSummary::default());
        balls.observe(Want::ALL, &mut frame);
        let merged = merger.merge(&schema, &frame, &[[0, 1]]);
        let measures = merged.pairs[0].unwrap();
        let is_one = frame.scalars[1] == 1.0;
        pieces.push(is_one);
        // by q, they merge later and split later
        let is_group = is_one || frame.pairs.iter().any(|pair| pair.phase > 0);
        assert_eq!(merged.groups.len(), usize::from(is_group), "{}", frame.at.time);
        assert_eq!(merged.groups.first().map_or(2, |group| if is_group { group.components } else { 2 }) == 1, is_one);
        assert_eq!(measures.gap > 0.0, !is_one);
        assert_eq!(measures.neck > 0.0, is_one);
    }
    assert!(pieces.contains(&true) && !pieces[0] && pieces.last() == Some(&false));
}

#[test]
fn unsupported_scenes_are_rejected_or_warned_about() {
    let error = |text: &str| Metaballs::new(&scene(text), Options::default()).map(|_| ()).unwrap_err();
    let free = error(&TWO.replace("{ fixed = [0, 0, 0] }", "{ free = { from = [0, 0, 0] } }"));
    assert!(free.contains("body[\"a\"].motion.free: ") && free.contains("give it a path"), "{free}");
    let narrow = error(&TWO.replace("dt = 0.1", "dt = 0.1\n[influence]\nreach = 0.9"));
    assert!(
        narrow.contains("body[\"a\"].reach: ") && narrow.contains(" 0.9: ") && narrow.contains("above 1"),
        "{narrow}"
    );
    let narrow = error(&TWO.replacen("radius = ", "reach = 1.0\nradius = ", 1));
    assert!(narrow.contains("body[\"a\"].reach: ") && narrow.contains(" 1: a density"), "{narrow}");
    let push = "[[push]]\nbody = 'a'\ndirection = [1, 0, 0]\nstrength = 1\nstart = 0\nduration = 1\n";
    let warned = Metaballs::new(&scene(&format!("{TWO}{push}")), Options::default()).unwrap().schema().warnings;
    assert!(warned.iter().any(|warning| warning.contains("[[push]]")), "{warned:?}");
}
