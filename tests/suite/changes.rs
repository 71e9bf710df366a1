//! Changes of a world between steps, which are made in place: of free bodies, and of bodies on paths.

use glam::DVec3;
use meldscope::{
    Scene, World,
    model::phase::Phase,
    scene::Push,
    sim::{BodyForces, Cause},
};

/// Four bodies that meet: free ones above a plane, and the same on paths.
const MEETING: [[&str; 5]; 2] = [
    [
        "duration = 4.0\ndt = 0.02\ngravity = [0, 0, -4]\n[[plane]]\nnormal = [0, 0, 1]\nstiffness = 900.0\n",
        "{ free = { from = [0, 0, 1.3] } }",
        "{ free = { from = [1.7, 0.2, 1.6], velocity = [-0.2, 0, 0] } }",
        "{ sine = { center = [0.8, 1.9, 1.4], amplitude = [0, 0.6, 0], frequency = 0.4, phase = 0 } }",
        "{ line = { from = [0.9, -9, 1.2], velocity = [0, 8, 0] } }",
    ],
    [
        "duration = 4.0\ndt = 0.02\n",
        "{ fixed = [0, 0, 1.3] }",
        "{ line = { from = [1.9, 0.2, 1.6], velocity = [-0.2, 0, 0] } }",
        "{ sine = { center = [0.8, 1.9, 1.4], amplitude = [0, 0.6, 0], frequency = 0.4, phase = 0 } }",
        "{ line = { from = [0.9, -9, 1.2], velocity = [0, 8, 0] } }",
    ],
];

/// A scene of these bodies: the head of `kind`, and names with motions.
fn meeting(kind: usize, bodies: &[(&str, &str)], pushes: &str) -> World {
    let body = |(name, motion): &(&str, &str)| {
        format!(
            "[[body]]\nname = \"{name}\"\nradius = 1.0\nshape = {{ sphere = {{ stacks = 6, slices = 8 }} }}\nmotion = {motion}\n"
        )
    };
    let text = MEETING[kind][0].to_owned() + &bodies.iter().map(body).collect::<String>() + pushes;
    World::new(Scene::parse(&text, "meeting.toml").expect("a scene")).expect("enough memory")
}

/// Steps both worlds, expects identical bits, and returns the pairs that have changed phase.
fn assert_same_bits(known: &mut World, changed: &mut World, steps: u32, what: &str) -> Vec<[u32; 2]> {
    let mut pairs = Vec::new();
    for _ in 0..steps {
        assert_eq!((&known.step().failure, &changed.step().failure), (&None, &None));
        assert_eq!(known.checksum(), changed.checksum(), "{what}: {} s", known.time());
        assert_eq!(known.report().events, changed.report().events, "{what}: {} s", known.time());
        for body in 0..known.body_count() {
            let [known, changed] = [&*known, &*changed].map(|world| {
                let mut forces = BodyForces::default();
                world.forces(body, &mut forces);
                forces.of(Cause::Push).clone()
            });
            assert_eq!(known, changed, "{what}: pushes on body {body}");
        }
        pairs.extend(known.report().events.iter().map(|event| [event.a, event.b]));
    }
    pairs
}

/// What is changed before it acts leads to the same bits as a scene that has had it from the start, for free bodies and
/// for bodies on paths.
#[test]
fn changes_in_time_leave_no_trace() {
    for (kind, [_, a, b, c, d]) in MEETING.into_iter().enumerate() {
        let all = [("a", a), ("b", b), ("c", c), ("d", d)];
        let far = ("far", "{ fixed = [90, 0, 50] }");
        let push = |name: &str| {
            format!("[[push]]\nbody = \"{name}\"\ndirection = [1, 0, 0]\nstrength = 9.0\nstart = 0.9\nduration = 0.3\n")
        };
        // a body is added
        let (mut known, mut changed) = (meeting(kind, &all, ""), meeting(kind, &all[..3], ""));
        known.run(20).expect("it runs");
        changed.run(20).expect("it runs");
        changed.add(known.scene().bodies[3].clone()).expect("a new name");
        let events = assert_same_bits(&mut known, &mut changed, 120, "add");
        assert!(events.contains(&[0, 3]) && events.contains(&[1, 3]), "it meets none: {events:?}");
        // one in the middle of the list is removed
        let (mut known, mut changed) = (
            meeting(kind, &all, &push("d")),
            meeting(kind, &[all[0], far, all[1], all[2], all[3]], &(push("far") + &push("d"))),
        );
        known.run(20).expect("it runs");
        changed.run(20).expect("it runs");
        changed.remove(1usize).expect("it is there");
        assert_same_bits(&mut known, &mut changed, 120, "remove");
        // pushes, and the motion of a body that is far from all others
        let (mut known, mut changed) = (meeting(kind, &all, &push("b")), meeting(kind, &all, ""));
        known.run(20).expect("it runs");
        changed.run(20).expect("it runs");
        changed.push(known.scene().pushes[0]).expect("it is there");
        assert_same_bits(&mut known, &mut changed, 120, "push");
        let away = ("d", "{ line = { from = [60, -9, 1.2], velocity = [0, 1, 0] } }");
        let (mut known, mut changed) = (meeting(kind, &all, ""), meeting(kind, &[all[0], all[1], all[2], away], ""));
        known.run(6).expect("it runs");
        changed.run(6).expect("it runs");
        changed.set_motion(3, known.scene().bodies[3].motion.clone()).expect("it is there");
        assert_same_bits(&mut known, &mut changed, 120, "set_motion");
    }
}

/// Changes while bodies touch: the state goes on without a jump, and phases follow their thresholds.
#[test]
fn changes_in_contact_are_taken_up() {
    for (kind, [_, a, b, c, d]) in MEETING.into_iter().enumerate() {
        let all = [("a", a), ("b", b), ("c", c), ("d", d)];
        let mut world = meeting(kind, &all, "");
        world.run(50).expect("it runs");
        let positions = |world: &World, name: &str| {
            let body = world.bodies().find(|body| body.name() == name).expect("it is there");
            (0..body.vertex_count()).map(|i| body.position(i)).collect::<Vec<_>>()
        };
        let before: Vec<_> = ["a", "c", "d"].iter().map(|name| positions(&world, name)).collect();
        assert_ne!(world.phase(0, 1), Phase::Apart);
        world.remove(1usize).expect("it is there");
        let after: Vec<_> = ["a", "c", "d"].iter().map(|name| positions(&world, name)).collect();
        assert_eq!(before, after, "{kind}");
        world.run(1).expect("it runs");
        let again = meeting(kind, &all, "").scene().bodies[1].clone();
        let added = world.add(again).expect("its name is free");
        world
            .push(Push { body: 0, direction: DVec3::Y, strength: 8.0, start: world.time() - 0.01, duration: 0.2 })
            .expect("it is there");
        world.run(20).expect("it runs");
        assert_eq!(world.get(added).expect("it is there").name(), "b");
        let pairs: Vec<_> = world.pairs().map(|pair| (pair.a, pair.b)).collect();
        assert!(pairs.iter().all(|&(a, b)| a < b && b < 4), "{pairs:?}");
        world.run(60).expect("it runs");
        let q = |a: usize, b: usize| world.body(a).centre().distance(world.body(b).centre()) / 2.0;
        for (a, b) in [(0, 1), (0, 2), (1, 2), (0, 3), (1, 3), (2, 3)] {
            let phase = world.phase(a, b);
            assert!(phase != Phase::Apart || q(a, b) > 1.04, "{kind}: {a} {b} {phase} {}", q(a, b));
            assert!(phase == Phase::Apart || q(a, b) < 1.16, "{kind}: {a} {b} {phase} {}", q(a, b));
        }
    }
}
