//! Cost against scene size: layouts of the scenes, and reports of the measurements.

use std::{collections::HashSet, path::PathBuf, process::Command, time::Duration};

use meldscope::{
    Scene, World,
    bench::{
        machine::Machine,
        scale::{
            self, Report, Settings, csv, diagram, goals,
            scenes::{Family, Layout},
            table,
        },
    },
};

fn two() -> Scene {
    Scene::builtin("two").expect("a built-in scene")
}

/// In every family, exactly the bodies that are in contact move, and each touches only its partner.
#[test]
fn the_bodies_that_touch_are_those_of_the_layout() {
    for (family, bodies, pairs) in [(Family::Contact, 40, 20), (Family::Hundredth, 600, 3), (Family::Rest, 41, 1)] {
        let layout = Layout::new(family, bodies);
        assert_eq!(layout.pairs.len(), pairs);
        let touching: HashSet<usize> = layout.pairs.iter().flat_map(|pair| [pair.still, pair.moving]).collect();
        let mut world = World::new(layout.scene(&two())).expect("enough memory");
        assert_eq!(world.body_count(), bodies);
        for _ in 0..scale::scenes::PERIOD {
            let events = &world.step().events;
            assert!(events.iter().all(|event| event.a % 2 == 0 && event.b == event.a + 1), "{events:?}");
        }
        for (index, body) in world.bodies().enumerate() {
            assert_eq!(!body.is_at_rest(), touching.contains(&index), "{family:?} {index}");
        }
    }
}

fn measured() -> Report {
    let settings = Settings { bodies: vec![2, 10], time: Duration::from_millis(2), decay: 60_000 };
    let mut shares = vec![];
    let report = scale::measure(&settings, &mut |share| shares.push(share)).expect("enough memory");
    assert!(shares.is_sorted() && shares.len() == 6, "{shares:?}");
    report
}

#[test]
fn every_family_is_measured_at_every_size() {
    let report = measured();
    assert_eq!(report.points.len(), 6);
    for point in &report.points {
        let name = format!("{} {}", point.bodies, point.family.name());
        let judged = point.judged.expect("a reference");
        // Measured: 2.2e-8 over a period.
        assert!(judged.error < 5e-8 && judged.steps >= 60, "{name}: {judged:?}");
        let plain = point.plain.as_ref().expect("quick");
        assert!(plain.judged.is_none_or(|judged| judged.error > 1e-3), "{name}: {plain:?}");
        assert!(point.one.seconds > 0.0 && point.one.threads == 1 && point.reached > 0.0, "{name}");
        assert!((0.1..=1.0).contains(&point.one.stages.iter().sum::<f64>()), "{name}: {:?}", point.one.stages);
        assert!(point.memory > 300 * point.bodies, "{name}: {}", point.memory);
    }
    let at = |family| report.at(family, 10).expect("measured");
    assert_eq!([Family::Contact, Family::Hundredth, Family::Rest].map(|family| at(family).touching), [10, 2, 2]);
    assert_eq!(report.free_oscillation.len(), 2);
    assert!(report.free_oscillation.iter().all(|one| one.one > 1e6));
    assert_eq!(report.decay.steps, 60_000);
    let is_time = |time: f64| time.is_finite() && time > 0.0;
    let decay = &report.decay;
    assert!([decay.early, decay.slowest, decay.late].into_iter().all(is_time), "{decay:?}");

    let machine = Machine { cpu: "a, \"b\"".to_owned(), cores: 2, version: "0" };
    let csv = csv::csv(&report, &machine).expect("made");
    let rows: Vec<&str> = csv.lines().collect();
    let threads = if report.threads > 1 { 2 } else { 1 };
    assert_eq!(rows.len(), 1 + 6 * (threads + 1));
    assert!(rows[1].starts_with("all in contact,2,2,2,532,default,1,"), "{}", rows[1]);

    let text = format!(
        "{}\n{}\n{}",
        table::table(&report),
        meldscope::bench::goals::table(&goals::goals(&report)),
        table::footer(&report, &machine)
    );
    let svg = diagram::svg(&report, &machine).expect("drawn");
    assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"));
    for family in Family::ALL {
        assert!(text.contains(family.name()) && svg.contains(family.name()), "{}", family.name());
    }
    assert!(text.contains("≥ 300,000 steps/s") && text.lines().all(|line| line == line.trim_end()), "{text}");
    assert!(goals::goals(&report).iter().all(|goal| !goal.measured.contains("NaN")), "{text}");
}

#[test]
fn the_command_accepts_only_valid_sizes() {
    let run = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_meldscope"));
        let output = command.args(["bench", "scale"]).args(arguments).output().expect("starts");
        let text = |bytes| String::from_utf8(bytes).expect("text");
        (output.status.code(), text(output.stdout), text(output.stderr))
    };
    let directory = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("scale");
    std::fs::create_dir_all(&directory).expect("a directory");
    let file = directory.join("scale.csv");
    let (status, out, err) = run(&["--bodies", "2", "--seconds", "0.001", "--csv", file.to_str().expect("a name")]);
    assert_eq!(status, Some(0), "{err}");
    assert!(out.contains("goals") && err.contains("wrote"), "{out}{err}");
    assert!(std::fs::read_to_string(&file).expect("written").lines().count() > 3);

    for wrong in [["--bodies", "1"], ["--bodies", "2000000"], ["--seconds", "0"], ["--seconds", "soon"]] {
        let (status, out, err) = run(&wrong);
        assert!(status == Some(2) && out.is_empty() && err.contains(wrong[1]), "{wrong:?}: {err}");
    }
}
