//! Cost against scene size: layouts of the scenes, and reports of the measurements.

use std::{collections::HashSet, process::Command, time::Duration};

use meldscope::{
    Scene, World,
    bench::{
        report::Machine,
        scale::{
            self, Settings,
            scenes::{Family, Layout, PERIOD},
        },
    },
};

use crate::recording::Dir;

fn two() -> Scene {
    Scene::builtin("two").expect("a built-in scene")
}

/// In every family, exactly the bodies that are in contact move, and each touches only its partner.
#[test]
fn the_bodies_that_touch_are_those_of_the_layout() {
    for (family, bodies, pairs) in [(Family::Contact, 40, 20), (Family::Hundredth, 600, 3), (Family::Rest, 41, 1)] {
        let layout = Layout::new(family, bodies);
        assert_eq!(layout.pairs.len(), pairs);
        let touching: HashSet<usize> = layout.pairs.iter().flat_map(|pair| [pair.first, pair.first + 1]).collect();
        let mut world = World::new(layout.scene(&two())).expect("enough memory");
        assert_eq!(world.body_count(), bodies);
        for _ in 0..PERIOD {
            let events = &world.step().events;
            assert!(events.iter().all(|event| event.a % 2 == 0 && event.b == event.a + 1), "{events:?}");
        }
        for (index, body) in world.bodies().enumerate() {
            assert_eq!(!body.is_at_rest(), touching.contains(&index), "{family:?} {index}");
        }
    }
}

#[test]
fn every_family_is_measured_at_every_size() {
    let settings = Settings { bodies: vec![2, 10], time: Duration::from_millis(2) };
    let mut shares = vec![];
    let measured = scale::measure(&settings, &mut |share| shares.push(share)).expect("enough memory");
    assert!(shares.is_sorted() && shares.len() == 10, "{shares:?}");
    assert_eq!(measured.points.len(), 10);
    for point in &measured.points {
        let name = format!("{} {}", point.bodies, point.family.name());
        assert_eq!(point.error.is_none(), point.family == Family::FreeRest, "{name}");
        // Measured: 2.2e-8 on paths, 5.0e-8 of free bodies.
        assert!(point.error.is_none_or(|error| error < 1e-7), "{name}: {point:?}");
        assert!(point.one > 0.0, "{name}: {point:?}");
    }
    let awake = |family| measured.of(family).nth(1).expect("measured").awake;
    assert_eq!(Family::ALL.map(awake), [10, 2, 2, 10, 1]);

    let report = measured.report(&Machine::detect());
    let text: String = report.tables.iter().map(ToString::to_string).collect();
    let svg = report.chart.expect("drawn").svg();
    for family in Family::ALL {
        assert!(text.contains(family.name()) && svg.contains(family.name()), "{}", family.name());
    }
    assert!(text.lines().all(|line| line == line.trim_end()), "{text}");
}

#[test]
fn the_command_accepts_only_valid_sizes() {
    let run = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_meldscope"));
        let output = command.args(["bench", "scale"]).args(arguments).output().expect("starts");
        let text = |bytes| String::from_utf8(bytes).expect("text");
        (output.status.code(), text(output.stdout), text(output.stderr))
    };
    let dir = Dir::new();
    let file = dir.file("scale.csv");
    let (status, out, err) = run(&["2", "--csv", file.to_str().expect("a name")]);
    assert_eq!(status, Some(0), "{err}");
    assert!(out.contains("all in contact") && err.contains("wrote"), "{out}{err}");
    assert!(std::fs::read_to_string(&file).expect("written").lines().count() > 3);

    for wrong in ["1", "2000000", "two"] {
        let (status, out, err) = run(&[wrong]);
        assert!(status == Some(2) && out.is_empty() && err.contains(wrong), "{wrong:?}: {err}");
    }
}
