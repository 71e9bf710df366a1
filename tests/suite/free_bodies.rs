//! Free bodies in worlds, as defined by scene files: closed forms, conservation, the third law, and changes between
//! steps.

use std::{fs, path::PathBuf};

use glam::{DMat3, DQuat, DVec3};
use meldscope::{
    Scene, World,
    model::phase::Phase,
    scene::Motion,
    sim::{BodyForces, BodyView, Cause},
};

fn scene(text: &str) -> Scene {
    Scene::parse(&format!("duration = 1000.0\n{text}"), "test.toml").expect("a valid scene")
}

fn world(text: &str) -> World {
    World::new(scene(text)).expect("enough memory")
}

fn step(world: &mut World) {
    let report = world.step();
    assert!(report.failure.is_none(), "{:?}", report.failure);
}

fn run(world: &mut World, steps: u32) {
    (0..steps).for_each(|_| step(world));
}

/// A world with a box of these half-lengths, whose radius is the distance of its corners; `lines` go at the top of the
/// scene.
fn world_of_box(name: &str, half: DVec3, lines: &str, motion: &str) -> World {
    let folder = std::env::temp_dir().join(format!("meldscope-box-{name}-{}", std::process::id()));
    let file = |name: &str| -> PathBuf { folder.join(name) };
    fs::create_dir_all(&folder).expect("a folder");
    let mut text = String::new();
    for corner in 0..8 {
        let side = |axis: u32, half: f64| if corner >> axis & 1 == 0 { -half } else { half };
        text += &format!("v {:?} {:?} {:?}\n", side(0, half.x), side(1, half.y), side(2, half.z));
    }
    // a vertex in the middle of each face, so that the eight corners have equal masses
    for (axis, half) in half.to_array().into_iter().enumerate() {
        for half in [-half, half] {
            let mut middle = [0.0; 3];
            middle[axis] = half;
            text += &format!("v {:?} {:?} {:?}\n", middle[0], middle[1], middle[2]);
        }
    }
    let faces = [[1, 5, 7, 3], [2, 4, 8, 6], [1, 2, 6, 5], [3, 7, 8, 4], [1, 3, 4, 2], [5, 6, 8, 7]];
    for (middle, face) in (9..).zip(faces) {
        (0..4).for_each(|k| text += &format!("f {} {} {middle}\n", face[k], face[(k + 1) % 4]));
    }
    fs::write(file("box.obj"), text).expect("a file");
    let radius = half.length();
    let lines = format!(
        "duration = 1000.0\n{lines}\n[[body]]\nname = \"box\"\nradius = {radius:?}\nmass = 1.0\nomega = 1e5\ndamping = 0.0\n\
         shape = {{ mesh = \"box.obj\" }}\nmotion = {{ free = {{ {motion} }} }}\n"
    );
    fs::write(file("box.toml"), lines).expect("a file");
    let scene = Scene::load(&file("box.toml")).expect("a valid scene");
    fs::remove_dir_all(&folder).expect("it exists");
    let world = World::new(scene).expect("enough memory");
    assert!((world.body(0).rest(0) + half).length() < 1e-12, "{}", world.body(0).rest(0));
    world
}

/// Half-lengths of a box with three different moments of inertia.
const BRICK: DVec3 = DVec3::new(1.0, 0.7, 0.4);

// ---- closed forms --------------------------------------------------------------------------------------------------

/// A stiff brick rotates by Euler's equations, here integrated together with the rotation by a Runge–Kutta method with
/// steps so small that only rounding errors remain. About the middle axis, it tumbles.
#[test]
fn a_brick_rotates_by_eulers_equations() {
    for (name, spin) in [("top", DVec3::new(0.6, 0.3, 2.0)), ("tumbling", DVec3::new(1e-3, 3.0, 0.0))] {
        let motion = format!("from = [1, 2, 3], velocity = [0, 0, 1], spin = {:?}", spin.to_array());
        let mut world = world_of_box(name, BRICK, "", &motion);
        // the moments of inertia of the vertices, by definition
        let body = world.body(0);
        let shares = body.mesh().shares();
        let moment = |f: fn(DVec3) -> f64| (0..shares.len()).map(|i| shares[i] * f(body.rest(i))).sum::<f64>();
        let moments = DVec3::new(
            moment(|r| r.y * r.y + r.z * r.z),
            moment(|r| r.x * r.x + r.z * r.z),
            moment(|r| r.x * r.x + r.y * r.y),
        );
        assert!(moments.x < 0.9 * moments.y && moments.y < 0.9 * moments.z);
        // angular velocity in the axes of the body, and its rotation
        let rate = |(spin, turn): (DVec3, DQuat)| {
            let of_spin = (moments * spin).cross(spin) / moments;
            (of_spin, turn * DQuat::from_xyzw(spin.x, spin.y, spin.z, 0.0) * 0.5)
        };
        let (mut top, (parts, seconds)) = ((spin, DQuat::IDENTITY), (100, 6));
        let h = 1.0 / 60.0 / f64::from(parts);
        for _ in 0..60 * seconds * parts {
            let add = |k: (DVec3, DQuat), h: f64| (top.0 + h * k.0, top.1 + k.1 * h);
            let k1 = rate(top);
            let k2 = rate(add(k1, 0.5 * h));
            let k3 = rate(add(k2, 0.5 * h));
            let k4 = rate(add(k3, h));
            top.0 += h / 6.0 * (k1.0 + 2.0 * (k2.0 + k3.0) + k4.0);
            top.1 = (top.1 + (k1.1 + (k2.1 + k3.1) * 2.0 + k4.1) * (h / 6.0)).normalize();
        }
        run(&mut world, (60 * seconds) as u32);
        let body = world.body(0);
        let error = DMat3::from_quat(body.rotation()) - DMat3::from_quat(top.1);
        let error = [error.x_axis, error.y_axis, error.z_axis].map(DVec3::length).into_iter().fold(0.0, f64::max);
        assert!(error < 2e-6, "{name}: {error:e}");
        assert!(body.angular_velocity().distance(top.1 * top.0) < 2e-6, "{name}: {}", body.angular_velocity());
        assert!(body.centre().distance(DVec3::new(1.0, 2.0, 9.0)) < 1e-12);
    }
}

/// A stiff ball that falls on a plane leaves it as fast as it came, after a time that follows from the energy: when the
/// lowest vertex is δ deep, a vertex of mass m at the height h above it has the potential energy ½ m k max(0, δ − h)².
#[test]
fn a_stiff_ball_bounces_as_fast_as_it_came() {
    let (k, speed, above): (f64, f64, f64) = (4000.0, 1.5, 0.33);
    let mut world = world(&format!(
        "[[plane]]\nnormal = [0, 0, 1]\nstiffness = {k:?}\n[[body]]\nname = \"ball\"\nradius = 1.0\nomega = 1e5\ndamping = 0.0\n\
         motion = {{ free = {{ from = [0, 0, {:?}], velocity = [0.2, 0, {:?}] }} }}\n",
        1.0 + above,
        -speed,
    ));
    let body = world.body(0);
    let vertices: Vec<(f64, f64)> =
        (0..body.vertex_count()).map(|i| (body.mesh().shares()[i], body.rest(i).z + 1.0)).collect();
    // v² at a depth
    let squared =
        |depth: f64| speed * speed - vertices.iter().map(|(m, h)| m * k * (depth - h).max(0.0).powi(2)).sum::<f64>();
    let (mut low, mut deepest) = (0.0, 1.0);
    for _ in 0..200 {
        let middle = 0.5 * (low + deepest);
        *(if squared(middle) > 0.0 { &mut low } else { &mut deepest }) = middle;
    }
    // ∫ dδ/v with δ = δ_max (1 − s²), which has no pole
    let parts = 20_000;
    let half: f64 = (0..parts)
        .map(|i| {
            let s = (f64::from(i) + 0.5) / f64::from(parts);
            2.0 * deepest * s / squared(deepest * (1.0 - s * s)).sqrt() / f64::from(parts)
        })
        .sum();
    let away = above / speed + 2.0 * half;
    let mut lowest = f64::INFINITY;
    while world.time() < 0.7 {
        step(&mut world);
        lowest = lowest.min(world.body(0).centre().z);
    }
    let body = world.body(0);
    assert!(lowest < 1.0 - 0.9 * deepest && away < 0.6, "{lowest} {deepest} {away}");
    let velocity = DVec3::new(0.2, 0.0, speed);
    assert!(body.centre_velocity().distance(velocity) < 2e-6, "{}", body.centre_velocity());
    let expected = DVec3::new(0.2 * world.time(), 0.0, 1.0 + speed * (world.time() - away));
    assert!(body.centre().distance(expected) < 2e-6, "{} {expected}", body.centre());
    assert!(body.angular_velocity().length() < 1e-9);
}

/// A block slides until friction stops it: v′ = −μ g v/√(v² + v_s²), so the distance is ∫ √(v² + v_s²) dv / (μ g).
#[test]
fn a_block_slides_as_far_as_friction_lets_it() {
    let (k, friction, slip, g, speed): (f64, f64, f64, f64, f64) = (4000.0, 0.3, 0.02, 9.81, 1.2);
    let floor = format!(
        "gravity = [0, 0, -{g:?}]\n[[plane]]\nnormal = [0, 0, 1]\nstiffness = {k:?}\nfriction = {friction:?}\nslip = {slip:?}"
    );
    let block = |height: f64| {
        let motion = format!("from = [0, 0, {height:?}], velocity = [{speed:?}, 0, 0], rotation = \"fixed\"");
        world_of_box("block", BRICK, &floor, &motion)
    };
    // the lowest five vertices carry its whole weight
    let first = block(9.0);
    let body = first.body(0);
    let lowest = (0..body.vertex_count()).filter(|&i| body.rest(i).z < -0.9 * BRICK.z);
    let height = BRICK.z - g / (k * lowest.map(|i| body.mesh().shares()[i]).sum::<f64>());
    let mut world = block(height);
    run(&mut world, 60);
    let distance = 0.5 * (speed * (speed * speed + slip * slip).sqrt() + slip * slip * (speed / slip).asinh());
    let found = world.body(0).centre() - height * DVec3::Z;
    assert!(found.distance(distance / (friction * g) * DVec3::X) < 2e-6, "{found} {}", distance / (friction * g));
    assert!(world.body(0).centre_velocity().length() < 1e-6, "{}", world.body(0).centre_velocity());
}

// ---- conservation --------------------------------------------------------------------------------------------------

/// Two spinning bodies that repeatedly pass through each other's core.
const BOUND: &str = "[material]\ndamping = 0.0\n[influence]\ncore_at = 0.5\ncore_width = 0.2
[[body]]\nname = \"a\"\nradius = 1.0\nshape = { sphere = { stacks = 6, slices = 8 } }
motion = { free = { from = [-0.8, -0.1, 0.05], velocity = [0.6, 0, 0], spin = [0.3, 0, 0.5] } }
[[body]]\nname = \"b\"\nradius = 0.8\nshape = { sphere = { stacks = 6, slices = 8 } }
motion = { free = { from = [0.8, 0.1, 0], velocity = [-0.6, 0.1, 0], spin = [0, 0.2, 0] } }\n";

/// Two bodies that repeatedly merge and split in the sphere of a third, to which both stay bound.
const CAGED: &str =
    "[material]\ndamping = 0.0\n[influence]\nmerge_at = 0.9\nsplit_at = 0.9\ncore_at = 0.0\nalpha = 30.0\nbeta = 30.0
[[pair]]\nbodies = [\"ball\", \"cage\"]\nmerge_at = 5.0\nsplit_at = 5.0\nalpha = 20.0
[[body]]\nname = \"a\"\ngroup = \"ball\"\nradius = 0.6\nshape = { sphere = { stacks = 6, slices = 8 } }
motion = { free = { from = [-0.9, -0.1, 0.05], velocity = [0.8, 0, 0] } }
[[body]]\nname = \"b\"\ngroup = \"ball\"\nradius = 0.6\nshape = { sphere = { stacks = 6, slices = 8 } }
motion = { free = { from = [0.9, 0.1, 0], velocity = [-0.8, 0.1, 0], spin = [0, 0.2, 0] } }
[[body]]\nname = \"cage\"\nradius = 2.0\nshape = { sphere = { stacks = 6, slices = 8 } }
motion = { free = { from = [0, 0, 0] } }\n";

/// A body whose rotation is fixed has no energy of spin: what its vertices swing is all vibration.
#[test]
fn bodies_of_fixed_rotation_have_no_energy_of_spin() {
    let text = "duration = 1\ndt = 0.05\n[[body]]\nname = 'a'\nradius = 1\nshape = { sphere = { stacks = 5, slices = 7 } }\n\
                motion = { free = { from = [-1, 0, 0], velocity = [0.5, 0, 0], rotation = 'fixed' } }\n\
                [[body]]\nname = 'b'\nradius = 0.7\nmotion = { fixed = [0.5, 0.8, 0] }\n";
    let mut world = World::new(Scene::parse(text, "fixed").expect("a scene")).expect("enough memory");
    for _ in 0..20 {
        step(&mut world);
        let now = world.conserved().expect("it has a free body");
        assert_eq!(now.spin, 0.0);
    }
    assert!(world.conserved().expect("it has a free body").vibration > 1e-3);
}

/// The largest changes of conserved quantities during a run, relative to their scales.
#[derive(Debug, Default)]
struct Drift {
    momentum: f64,
    angular_momentum: f64,
    energy: f64,
    events: u64,
}

impl Drift {
    fn of(world: &mut World, steps: u64) -> Drift {
        let first = world.conserved().expect("it has free bodies");
        let (mut drift, mut scale) = (Drift::default(), [0.0_f64; 3]);
        let (mut momentum, mut angular, mut energy) = (0.0_f64, 0.0_f64, 0.0_f64);
        for _ in 0..steps {
            step(world);
            drift.events += world.report().events.len() as u64;
            let now = world.conserved().expect("it has free bodies");
            momentum = momentum.max((now.momentum - first.momentum).length());
            angular = angular.max((now.angular_momentum - first.angular_momentum).length());
            energy = energy.max((now.energy() - first.energy() - world.ledger().total()).abs());
            // scales of the single bodies, because the total may be zero
            let each = world.bodies().map(|body| {
                let momentum = body.scene().mass * body.centre_velocity();
                (momentum.length(), body.centre().cross(momentum).length())
            });
            let each = each.fold((0.0, 0.0), |sum, body| (sum.0 + body.0, sum.1 + body.1));
            let moving = now.kinetic + now.spin + now.vibration + now.elastic;
            scale = [scale[0].max(each.0), scale[1].max(each.1), scale[2].max(moving)];
        }
        (drift.momentum, drift.angular_momentum, drift.energy) =
            (momentum / scale[0], angular / scale[1], energy / scale[2]);
        drift
    }
}

/// Over 600 steps, or over `MELDSCOPE_STEPS`: 100,000 take minutes.
#[test]
fn conserved_quantities_are_conserved_over_many_encounters() {
    let steps = std::env::var("MELDSCOPE_STEPS").ok().and_then(|text| text.parse().ok()).unwrap_or(600);
    let limit = if steps > 600 { 1e-11 } else { 1e-13 };
    for (name, text) in [("bound", BOUND), ("caged", CAGED)] {
        let drift = Drift::of(&mut world(text), steps);
        println!("{name}, {steps} steps: {drift:?}");
        assert!(drift.events >= 5, "{name}: {drift:?}");
        assert!(drift.momentum < limit && drift.angular_momentum < limit, "{name}: {drift:?}");
        assert!(drift.energy < 1e-6, "{name}: {drift:?}");
    }
}

/// The forces between two bodies sum to zero, bit by bit, after every step and in every phase.
#[test]
fn actions_equal_reactions() {
    for name in ["collide", "orbit"] {
        let mut world = World::new(Scene::builtin(name).expect("a built-in scene")).expect("enough memory");
        let (mut forces, mut phases, mut largest) = (BodyForces::default(), vec![], 0.0_f64);
        for _ in 0..world.scene().steps().min(180) {
            step(&mut world);
            let [a, b] = [0, 1].map(|index| {
                world.forces(index, &mut forces);
                let at_centre = forces.at_centre();
                // it is the sum of the observed forces on the vertices and the reaction, which acts on all of them
                let shares = world.body(index).mesh().shares();
                let mut sum = DVec3::ZERO;
                for cause in [Cause::Attraction, Cause::Repulsion, Cause::Core, Cause::Reaction] {
                    sum += forces.of(cause).iter().zip(shares).map(|(f, share)| *share * f).sum::<DVec3>();
                }
                let sum = world.body(index).scene().mass * sum;
                assert!((sum - at_centre).length() <= 1e-13 * at_centre.length().max(1.0), "{name}: {sum} {at_centre}");
                at_centre
            });
            assert_eq!(a, -b, "{name} at {} s", world.time());
            largest = largest.max(a.length());
            phases.push(world.phase(0, 1));
        }
        assert!(largest > 1.0 && phases.contains(&Phase::Merged) && phases.contains(&Phase::Core), "{name}");
    }
}

/// The cause of a source of [`World::surroundings`] is that under which its force is observed: also at the rim of a core,
/// on the outer side of which a sphere attracts in the phase `core`.
#[test]
fn surroundings_and_forces_agree_on_causes() {
    let mut world = World::new(Scene::builtin("collide").expect("a built-in scene")).expect("enough memory");
    let (mut forces, mut found) = (BodyForces::default(), vec![]);
    for _ in 0..180 {
        step(&mut world);
        for index in 0..2 {
            world.forces(index, &mut forces);
            let acts = |cause: &Cause| forces.of(*cause).iter().any(|force| force != DVec3::ZERO);
            let observed = [Cause::Attraction, Cause::Repulsion, Cause::Core].into_iter().find(acts);
            for source in world.surroundings(index).sources {
                assert!(observed.is_none_or(|cause| cause == source.cause()), "{observed:?} {source:?}");
                found.push((world.phase(0, 1), source.cause()));
            }
        }
    }
    assert!(found.contains(&(Phase::Core, Cause::Attraction)), "the rim is never crossed");
}

// ---- changes between steps -----------------------------------------------------------------------------------------

/// Two bodies that fall on a plane and on each other, and one that approaches them on a path.
const COMPANY: [&str; 4] = [
    "gravity = [0, 0, -3]\n[influence]\ncore_at = 0.6\ncore_width = 0.3\n[[plane]]\nnormal = [0, 0, 1]\noffset = -1.0\n",
    "[[body]]\nname = \"a\"\nradius = 1.0\nshape = { sphere = { stacks = 6, slices = 8 } }\nmotion = { free = { from = [0, 0, 0.3] } }\n",
    "[[body]]\nname = \"b\"\nradius = 1.0\nshape = { sphere = { stacks = 6, slices = 8 } }\nmotion = { free = { from = [1.9, 0.2, 0.3] } }\n",
    "[[body]]\nname = \"c\"\nradius = 1.0\nshape = { sphere = { stacks = 6, slices = 8 } }\nmotion = { line = { from = [1, 9, 0.3], velocity = [0, -8, 0] } }\n",
];

/// Steps both worlds and expects identical bits.
fn assert_identical_steps(known: &mut World, changed: &mut World, steps: u32) {
    for _ in 0..steps {
        step(known);
        step(changed);
        assert_eq!(known.checksum(), changed.checksum(), "{} s", known.time());
    }
}

#[test]
fn a_body_added_in_time_acts_as_if_present_from_the_start() {
    let mut known = world(&COMPANY.concat());
    let mut changed = world(&COMPANY[..3].concat());
    run(&mut known, 20);
    run(&mut changed, 20);
    let added = known.scene().bodies[2].clone();
    let added = changed.add(added).expect("a new name");
    assert_eq!(changed.index_of(added), Some(2));
    assert_identical_steps(&mut known, &mut changed, 60);
    assert_ne!(known.phase(1, 2), Phase::Apart, "it never touches the others");
}

#[test]
fn a_body_removed_in_time_leaves_no_trace() {
    let mut known = world(&COMPANY[..3].concat());
    let mut changed = world(&COMPANY.concat());
    run(&mut known, 20);
    run(&mut changed, 20);
    changed.remove(2).expect("it exists");
    assert_identical_steps(&mut known, &mut changed, 60);
}

#[test]
fn a_body_moved_to_another_path_acts_as_if_always_on_it() {
    let other = COMPANY[3].replace("[0, -8, 0]", "[0, -6, 0]").replace("[1, 9, 0.3]", "[1, 8.6, 0.3]");
    let mut known = world(&[&COMPANY[..3].concat(), other.as_str()].concat());
    let mut changed = world(&COMPANY.concat());
    run(&mut known, 6);
    run(&mut changed, 6);
    changed.set_motion(2, known.scene().bodies[2].motion.clone()).expect("it exists");
    assert_identical_steps(&mut known, &mut changed, 80);
    assert_ne!(known.phase(1, 2), Phase::Apart, "it never touches the others");
}

#[test]
fn everything_can_be_changed_before_the_first_step() {
    let push = "[[push]]\nbody = \"a\"\ndirection = [1, 0, 0]\nstrength = 9.0\nstart = 0.1\nduration = 0.2\n";
    let mut known = world(&[&COMPANY.concat(), push].concat());
    let mut changed =
        world(&[COMPANY[0], &COMPANY[1].replace("0.3]", "7.3]"), &COMPANY[3].replace("\"c\"", "\"x\"")].concat());
    let bodies = &known.scene().bodies;
    let moved = Motion::clone(&bodies[0].motion);
    changed.set_motion(0, moved).expect("it exists");
    changed.remove(1).expect("it exists");
    changed.add(bodies[1].clone()).expect("a new name");
    changed.add(bodies[2].clone()).expect("a new name");
    changed.push(known.scene().pushes[0]).expect("it exists");
    assert_identical_steps(&mut known, &mut changed, 60);
}

/// The forces of a stiff plane on a small body carry rounding of the positions that no shorter step removes.
#[test]
fn a_small_body_on_a_stiff_plane_is_followed_at_a_tight_tolerance() {
    let mut world = world(
        "dt = 0.0010416666666666667
tolerance = 1e-9
gravity = [0, 0, -9.81]
[material]
omega = 12
damping = 6
[influence]
weight = \"wendland\"
core_at = 0.8
core_width = 0.4
[[plane]]
normal = [0, 0, 1]
stiffness = 100000
friction = 0
[[body]]
name = \"b0\"
radius = 1.0
mass = 1.0
shape = { sphere = { stacks = 4, slices = 6 } }
motion = { free = { from = [0, 0, 1.12], velocity = [0, 0, -1.593], spin = [0.925, 0, -0.882] } }
[[body]]
name = \"b1\"
radius = 0.0333
mass = 0.01
shape = { sphere = { stacks = 4, slices = 6 } }
motion = { free = { from = [1.1510962, -0.239, 1.12], velocity = [-1.373, 0, 0], spin = [0, 0, -1.445] } }
",
    );
    run(&mut world, 480);
}

/// Where the rounding of centres exceeds what tells a pair from its threshold elsewhere, pairs merge and reach their core as
/// at the origin, to the rounding.
#[test]
fn bodies_far_from_the_origin_move_as_at_it() {
    let collide = |middle: DVec3| {
        let body = |name: &str, side: f64| {
            let [from, velocity] = [middle + DVec3::new(1.9, 0.12, 0.0) * side, DVec3::X * -side];
            format!(
                "[[body]]\nname = \"{name}\"\nradius = 1.0\nmotion = {{ free = {{ from = {:?}, velocity = {:?} }} }}\n",
                from.to_array(),
                velocity.to_array()
            )
        };
        let text = "dt = 0.016666666666666666\n[influence]\ncore_at = 0.7\ncore_width = 0.3\n".to_owned();
        let mut world = world(&(text + &body("left", -1.0) + &body("right", 1.0)));
        let mut times = Vec::new();
        for _ in 0..90 {
            step(&mut world);
            times.extend(world.report().events.iter().map(|event| event.time));
        }
        let of = |body: BodyView<'_>| (0..body.mesh().vertex_count()).map(|i| body.displacement(i)).collect::<Vec<_>>();
        let displacements: Vec<DVec3> = world.bodies().flat_map(of).collect();
        (times, displacements)
    };
    let (times, near) = collide(DVec3::ZERO);
    assert_eq!(times.len(), 2);
    for far in [DVec3::new(1e4, 0.0, -3e3), DVec3::new(1e5, -7e4, 5e4)] {
        let (far_times, displacements) = collide(far);
        assert_eq!(times.len(), far_times.len(), "{far}");
        assert!(times.iter().zip(&far_times).all(|(one, other)| (one - other).abs() < 1e-8), "{times:?} {far_times:?}");
        let apart = near.iter().zip(&displacements).map(|(one, other)| one.distance(*other)).fold(0.0, f64::max);
        assert!(apart < 2e-8, "{far}: {apart:e}");
    }
}

/// Explicit schemes step all bodies.
#[test]
fn no_body_sleeps_in_explicit_steps() {
    let mut world = world(
        "integrator = \"verlet\"\ngravity = [0, 0, -1]\n[[body]]\nname = \"a\"\nradius = 1.0\nmotion = { free = { from = [0, 0, 0] } }",
    );
    run(&mut world, 2);
    assert_eq!((world.report().sleeping_bodies, world.resting_count()), (0, 0));
}
