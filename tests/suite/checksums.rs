//! Dependences of the checksum of the exact state. (`meldscope bench record` measures its cost.)

use std::fmt::Write as _;

use meldscope::{Scene, World, scene::builtin};

#[test]
fn a_checksum_depends_only_on_the_state() {
    let checksums = |look: &dyn Fn(&World)| -> Vec<u64> {
        let mut world = World::new(Scene::builtin("two").expect("a built-in scene")).expect("enough memory");
        let mut checksums = vec![world.checksum()];
        for _ in 0..200 {
            let _ = world.step();
            look(&world);
            checksums.push(world.checksum());
        }
        checksums
    };
    let plain = checksums(&|_| {});
    assert_eq!(
        plain,
        checksums(&|world| {
            world.energy();
            world.bodies().for_each(|body| drop(body.positions().collect::<Vec<_>>()));
        })
    );
    let mut distinct = plain.clone();
    distinct.sort_unstable();
    distinct.dedup();
    assert_eq!(distinct.len(), plain.len(), "no two steps have the same");

    let mut scene = Scene::builtin("two").expect("a built-in scene");
    scene.influence.alpha = scene.influence.alpha.next_up();
    let mut world = World::new(scene).expect("enough memory");
    for expected in &plain[1..80] {
        let _ = world.step();
        assert_eq!(world.checksum(), *expected, "nothing attracts before the merge");
    }
    for _ in 80..=200 {
        let _ = world.step();
    }
    assert_ne!(world.checksum(), plain[200], "one bit of the law is enough");
}

/// Runs every scene with 1, 2, 3 and 8 threads, with the kernels that this machine supports.
#[test]
fn checksums_do_not_depend_on_threads() {
    for builtin in builtin::ALL {
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            pool.install(|| {
                let mut world =
                    World::new(Scene::builtin(builtin.name).expect("a built-in scene")).expect("enough memory");
                let steps = world.scene().steps().min(if world.body_count() > 500 { 3 } else { 480 });
                let checksums = (0..steps).map(|_| {
                    let _ = world.step();
                    world.checksum()
                });
                checksums.collect::<Vec<_>>()
            })
        };
        let one = run(1);
        for threads in [2, 3, 8] {
            assert!(run(threads) == one, "{} on {threads} threads", builtin.name);
        }
    }
}

/// Two bodies that meet and separate, and this many that they do not affect, half of which oscillate after a push.
fn pair_among(others: usize) -> Scene {
    let mut text = "duration = 100.0\n[influence]\nsplit_at = 1.2\n[[body]]\nname = \"still\"\nradius = 1.0\n\
                    motion = { fixed = [0, 0, 0] }\n[[body]]\nname = \"moving\"\nradius = 1.0\n\
                    motion = { sine = { center = [2.2, 0, 0], amplitude = [0.24, 0, 0], frequency = 0.25 } }\n"
        .to_owned();
    for i in 0..others {
        let _ = write!(
            text,
            "[[body]]\nname = \"b{i}\"\nradius = 1.0\nshape = {{ sphere = {{ stacks = 4, slices = 6 }} }}\n\
             motion = {{ fixed = [{}, 50, 0] }}\n",
            10 * i
        );
        if i % 2 == 0 {
            let _ = write!(
                text,
                "[[push]]\nbody = \"b{i}\"\ndirection = [1, 0, 0]\nstrength = 9.0\nstart = 0.0\nduration = 0.05\n"
            );
        }
    }
    Scene::parse(&text, "pair").expect("a scene")
}

/// Bodies at rest and bodies that oscillate after a push contribute to the checksum, as do bodies affected by a sphere.
#[test]
fn a_checksum_covers_all_bodies() {
    let base = pair_among(40);
    let checksum = |scene: Scene| {
        let mut world = World::new(scene).expect("enough memory");
        for _ in 0..60 {
            let _ = world.step();
            assert_ne!(world.checksum(), 0);
        }
        world.checksum()
    };
    let plain = checksum(base.clone());
    assert_eq!(plain, checksum(base.clone()));
    let mut other = base.clone();
    let pushed = &mut other.pushes[7];
    pushed.strength = pushed.strength.next_up();
    assert_ne!(plain, checksum(other), "a bit of a push on a body that no sphere reaches");
    assert_ne!(plain, checksum(pair_among(41)), "a body that rests");
}
