//! One number for the exact state: what it depends on, and what it costs.

use std::time::Instant;

use meldscope::{Scene, World, scene::builtin};

#[test]
fn a_checksum_is_that_of_the_state_alone() {
    let checksums = |look: &dyn Fn(&World)| -> Vec<u64> {
        let mut world = World::new(Scene::builtin("two").expect("built in")).expect("it fits");
        let mut checksums = vec![world.checksum()];
        for _ in 0..200 {
            world.step();
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

    let mut scene = Scene::builtin("two").expect("built in");
    scene.influence.alpha = scene.influence.alpha.next_up();
    let mut world = World::new(scene).expect("it fits");
    for expected in &plain[1..80] {
        world.step();
        assert_eq!(world.checksum(), *expected, "nothing attracts before the merge");
    }
    for _ in 80..=200 {
        world.step();
    }
    assert_ne!(world.checksum(), plain[200], "one bit of the law is enough");
}

/// Every scene under 1, 2, 3 and 8 threads, with the kernels that this machine has.
#[test]
fn checksums_do_not_depend_on_threads() {
    for builtin in builtin::ALL {
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            pool.install(|| {
                let mut world = World::new(Scene::builtin(builtin.name).expect("built in")).expect("it fits");
                let steps = world.scene().steps();
                let checksums = (0..steps).map(|_| {
                    world.step();
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

/// What the steps of a scene and their checksums take, of each the least of ten times [s].
fn costs(scene: &Scene) -> [f64; 2] {
    let mut least = vec![[f64::INFINITY; 2]; scene.steps() as usize];
    for _ in 0..10 {
        let mut world = World::new(scene.clone()).expect("it fits");
        for [step, checksum] in &mut least {
            let start = Instant::now();
            world.step();
            let stepped = Instant::now();
            assert_ne!(world.checksum(), 0);
            *checksum = checksum.min(stepped.elapsed().as_secs_f64());
            *step = step.min((stepped - start).as_secs_f64());
        }
    }
    [0, 1].map(|what| least.iter().map(|times| times[what]).sum())
}

#[test]
fn hashing_costs_little_beside_a_step() {
    for builtin in builtin::ALL {
        let scene = Scene::builtin(builtin.name).expect("built in");
        let [step, checksum] = costs(&scene).map(|time| 1e6 * time / scene.steps() as f64);
        println!("{}: a step takes {step:.3} µs, its checksum {checksum:.3} µs", scene.name);
        // seen: 3 % of `two`, of which a third is the clock; in `push`, where most steps have nothing to do, 40 ns
        assert!(checksum < 0.1 * step || checksum < 0.1, "{}: {step} µs, {checksum} µs", scene.name);
    }
}

/// Two bodies that merge among many that rest or swing by themselves.
#[test]
fn hashing_follows_the_influence() {
    let pair = r#"
        name = "pair"
        duration = 1.0
        [[body]]
        name = "still"
        radius = 1.0
        motion = { fixed = [0, 0, 0] }
        [[body]]
        name = "comes"
        radius = 1.0
        motion = { line = { from = [2.2, 0, 0], velocity = [-0.4, 0, 0] } }
        "#;
    let mut many = pair.to_owned();
    for i in 0..4000 {
        many += &format!("[[body]]\nname = \"b{i}\"\nradius = 1.0\nmotion = {{ fixed = [{}, 50, 0] }}\n", 10 * i);
        many += "shape = { sphere = { stacks = 4, slices = 6 } }\n";
        if i % 2 == 0 {
            many += &format!(
                "[[push]]\nbody = \"b{i}\"\ndirection = [1, 0, 0]\nstart = 0.0\nduration = 0.05\nstrength = 9.0\n"
            );
        }
    }
    let mut worlds =
        [pair, &many].map(|text| World::new(Scene::parse(text, "pair").expect("a scene")).expect("it fits"));
    let mut least = [f64::INFINITY; 2];
    for step in 0..60 {
        for (world, least) in worlds.iter_mut().zip(&mut least) {
            world.step();
            let start = Instant::now();
            let checksum = world.checksum();
            let time = start.elapsed().as_secs_f64();
            assert_ne!(checksum, 0);
            if step > 10 {
                *least = least.min(time);
            }
        }
    }
    println!("{:.0} ns of a pair, {:.0} ns of it among 4,000 bodies", 1e9 * least[0], 1e9 * least[1]);
    assert!(least[1] < 10.0 * least[0] + 1e-6, "{least:?}");
}
