//! Positions and event times against independent solutions: SciPy's DOP853 in double precision, restarted at every
//! jump, accurate to 1e-9 of a radius.

use std::{collections::BTreeMap, path::PathBuf};

use glam::DVec3;
use meldscope::{Scene, World};

/// A reference solution: world positions by time and body, and the phase changes.
struct Reference {
    scene: Scene,
    /// (step, body) → positions.
    positions: BTreeMap<(u64, String), Vec<DVec3>>,
    /// (pair, time, new phase)
    events: Vec<(String, f64, String)>,
}

impl Reference {
    fn load(name: &str) -> Reference {
        let file = |ending: &str| PathBuf::from(format!("tests/reference/{name}.{ending}"));
        let scene = Scene::load(&file("toml")).expect("a valid scene");
        let text = std::fs::read_to_string(file("csv")).expect("a reference solution");
        let (mut positions, mut events) = (BTreeMap::<_, Vec<DVec3>>::new(), vec![]);
        for line in text.lines().filter(|line| !line.starts_with("t,")) {
            if let Some(event) = line.strip_prefix("# event ") {
                let mut words = event.split(' ').map(str::to_owned);
                let mut next = || words.next().expect("pair, time and phase");
                events.push((next(), next().parse().expect("a time"), next()));
                continue;
            }
            let fields: Vec<&str> = line.split(',').collect();
            let number = |i: usize| fields[i].parse::<f64>().expect("a number");
            let step = (number(0) / scene.dt).round() as u64;
            let vertices = positions.entry((step, fields[1].to_owned())).or_default();
            assert_eq!(vertices.len(), number(2) as usize);
            vertices.push(DVec3::new(number(3), number(4), number(5)));
        }
        Reference { scene, positions, events }
    }

    /// Largest distance of any vertex at any sampled time, in radii of its body, with steps of dt / `divided`.
    fn error(&self, divided: u64) -> f64 {
        let scene = Scene { dt: self.scene.dt / divided as f64, ..self.scene.clone() };
        let steps = scene.steps();
        let mut world = World::new(scene).expect("fits");
        let mut worst = 0.0;
        for step in 0..=steps {
            if step > 0 {
                world.step();
            }
            for body in world.bodies() {
                let Some(expected) = self.positions.get(&(step / divided, body.name().to_owned())) else { continue };
                if step % divided != 0 {
                    continue;
                }
                for (position, expected) in body.positions().zip(expected) {
                    worst = f64::max(worst, position.distance(*expected) / body.scene().radius);
                }
            }
        }
        worst
    }
}

#[test]
fn print() {
    for name in ["push", "two", "three", "size_ratio"] {
        let mut reference = Reference::load(name);
        for integrator in meldscope::scene::Integrator::ALL {
            reference.scene.integrator = integrator;
            let errors = [1, 2, 4, 8].map(|d| format!("{:.3e}", reference.error(d)));
            println!("{name} {integrator} {errors:?}");
        }
        let mut world = World::new(reference.scene.clone()).unwrap();
        let mut events = vec![];
        for _ in 0..reference.scene.steps() {
            events.extend(world.step().events.iter().copied());
        }
        println!("{:?}\n{:?}", events.iter().map(|e| (e.time, e.to, e.q)).collect::<Vec<_>>(), reference.events);
    }
}
