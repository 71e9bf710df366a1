//! Any simulation can use all tools of this crate. One that shares nothing with this crate's own is recorded with its
//! terms, thresholds, phases, events, stages and scalars, replayed, compared, checked, and kept by the flight recorder.

use std::path::Path;

use glam::DQuat;
use meldscope::{
    geometry::Vectors,
    observe::{Experiment as _, Frame, StepSummary, Want},
    recording::{
        Recorded, diff,
        frames::FrameReader,
        golden::{self, GoldenOutcome},
        replay::{self, Verdict},
    },
    sdk::{Chunk, LogMsg, arrow::array::AsArray as _, blueprint::archetypes::ViewContents},
    stream::{
        self, Recorder, Settings,
        blueprint::Tab,
        settings::{Around, Detail, Entities, Frames, Trigger},
        sinks::Destinations,
    },
};

use crate::{
    octahedra::Octahedra,
    recording::{Dir, Recording},
};

/// Records and reads the recording back; also returns the number of frames.
fn record(path: &Path, octahedra: &Octahedra, settings: Settings) -> (Recorded, u64) {
    let destinations = Destinations { save: Some(path.to_owned()), ..Destinations::default() };
    let frames = stream::record(octahedra, settings, &destinations).expect("a recording");
    let recorded = Recorded::open_as(path, &|name, text, run| Octahedra::two(0.0).read(name, text, run));
    (recorded.expect("a recording"), frames)
}

#[test]
fn any_simulation_is_recorded_replayed_compared_and_checked() {
    let (dir, own, schema) = (Dir::new(), Settings::of(&Octahedra::two(3.0)), Octahedra::two(3.0).schema());
    let with = |name: &str, pull, settings| record(&dir.file(name), &Octahedra::two(pull), settings);
    let (full, frames) = with("full", 3.0, Settings { detail: Detail::Stages { from: 20, to: 30 }, ..own.clone() });
    let (thin, _) = with("thin", 3.0, Settings { frames: Frames::Thin, ..own.clone() });
    let (other, _) = with("other", 3.1, Settings { entities: Entities::Batch, ..own.clone() });
    let last = Frames::Last { most: 3, on: vec![Trigger::parse("grip", &schema).expect("its event")], after: 0 };
    assert_eq!((frames, with("kept", 3.0, Settings { frames: last, ..own }).1), (101, 3));
    let phases: Vec<_> = full.events.iter().map(|event| event.phases.clone()).collect();
    assert_eq!(phases, [["loose", "gripped"], ["gripped", "loose"]]);
    for recorded in [&full, &thin, &other] {
        assert_eq!(replay::verify(recorded, |_| true).expect("it runs"), Verdict::Identical);
    }
    let entities = Recording::open(&dir.file("other")).entities();
    for entity in
        ["world/forces/grip", "pairs/a~b/slip_at", "pairs/a~b/phase", "timings/project", "diagnostics/stretch"]
            .into_iter()
            .chain(["bodies/corner_speed/a", "bodies/corner_speed/b", "between/hold/a~b"])
    {
        assert!(entities.contains(&entity.into()), "{entity}");
    }

    let same = diff::diff([&full, &thin], 1e-6).expect("the same bodies");
    assert_eq!((same.instants, same.first_bits, same.bodies, same.events), (101, None, vec![], vec![]));
    let differing = diff::diff([&full, &other], 1e-6).expect("the same bodies");
    let first = differing.first_beyond.expect("they differ").step;
    assert_eq!((differing.first_bits, differing.bodies.len()), (Some(first), 2));
    let path = dir.file("golden");
    golden::bless(&Octahedra::two(3.0), &path, "a test").expect("disk space");
    let check = |pull| golden::check(&Octahedra::two(pull), &path, None).expect("it runs");
    assert!(matches!(check(3.0), GoldenOutcome::Identical { events: 2, .. }));
    assert!(
        matches!(check(3.1), GoldenOutcome::Different(found) if found.first.as_ref().is_some_and(|at| at.step == first))
    );
}

/// A rotating body is recorded in its own axes and read back in world axes, as its own entity and in a batch, at rest
/// and deformed.
#[test]
fn rotations_are_recorded_and_read_back() {
    let (dir, own) = (Dir::new(), Settings::of(&Octahedra::two(3.0)));
    for (name, entities) in [("body", Entities::Body), ("batch", Entities::Batch)] {
        let (recorded, _) = record(&dir.file(name), &Octahedra::two(3.0), Settings { entities, ..own.clone() });
        let mut frames = FrameReader::open(&recorded).expect("a recording");
        let mut simulation = Octahedra::two(3.0).start().expect("enough memory");
        let (schema, mut now, mut expected) = (simulation.schema(), Frame::default(), Vectors::default());
        let mut count = 0;
        while let Some(frame) = frames.next().expect("frames") {
            simulation.observe(Want::default(), &mut now);
            assert_eq!(frame.compare(&schema, &now), None, "{name}, step {}", frame.step);
            for (index, body) in now.bodies.iter().enumerate() {
                body.local_positions(schema.bodies[index].rest(), &mut expected);
                let local = frame.local_positions(index).expect("a surface");
                let world = frame.world_positions(index).expect("a surface");
                for ((local, world), expected) in local.into_iter().zip(world).zip(expected.iter()) {
                    assert!(local.distance(expected) < 2e-6, "{name}: {local} {expected}");
                    assert!(world.distance(body.centre + expected) < 2e-6, "{name}: {world} {expected}");
                }
            }
            count += 1;
            simulation.step(&mut StepSummary::default());
        }
        assert_eq!(count, 101);
        assert!(now.bodies[1].rotation.angle_between(DQuat::IDENTITY) > 2.0);

        let entities = Recording::open(&dir.file(name)).entities();
        let has = |entity: &str| entities.contains(&entity.into());
        assert_eq!([has("world/bodies/b"), has("world/resting/octahedron")], [name == "body", name == "batch"]);
    }
}

/// Its own events select what the flight recorder writes and where a file opens; those of this crate's simulation mean
/// nothing to it.
#[test]
fn its_own_events_are_triggers() {
    let schema = Octahedra::two(3.0).schema();
    assert!(Trigger::parse("diverge", &schema).is_ok());
    let unknown = Trigger::parse("merge", &schema).expect_err("not its event");
    assert_eq!(unknown, "no event \"merge\" (known: grip, slip, diverge)");
    let unknown = Around::parse("slipp a~b", &schema).expect_err("not its event");
    assert!(unknown.contains("did you mean \"slip\"") && unknown.contains("`grip a~b 2`"), "{unknown}");

    let dir = Dir::new();
    let around = Around::parse("slip b~a", &schema).expect("its event");
    assert_eq!(around.to_string(), "slip a~b");
    let (recorded, _) = record(
        &dir.file("x"),
        &Octahedra::two(3.0),
        Settings { around: Some(around.clone()), ..Settings::of(&Octahedra::two(3.0)) },
    );
    assert_eq!(recorded.settings.around, Some(around));
}

/// With more pairs than can be named at the start, the plots of those that have some are chosen at the end, with their
/// thresholds.
#[test]
fn its_own_thresholds_are_plotted_with_many_bodies() {
    let many = Octahedra { pull: 3.0, bodies: 17 };
    let mut simulation = many.start().expect("enough memory");
    let mut recorder = Recorder::new(&*simulation, Settings::of(&many)).expect("its text describes it");
    for _ in 0..100 {
        let mut summary = StepSummary::default();
        simulation.step(&mut summary);
        recorder.observe(&*simulation, &summary).expect("a valid step");
    }
    recorder.finish();
    let lines: Vec<String> = recorder
        .measured_layout(&*simulation, Tab::Scene)
        .iter()
        .filter_map(|message| match message {
            LogMsg::ArrowMsg(_, message) => Chunk::from_arrow_msg(message).ok(),
            _ => None,
        })
        .filter_map(|chunk| chunk.components().get(ViewContents::descriptor_query().component).cloned())
        .flat_map(|queries| {
            let lines = queries.list_array.values().as_string::<i32>().iter().flatten().map(str::to_owned);
            lines.collect::<Vec<_>>()
        })
        .collect();
    for part in ["distance", "grip_at", "slip_at", "phase"] {
        let line = format!("+ /pairs/a~b/{part}");
        assert!(lines.contains(&line), "{line} is not in {lines:?}");
    }
}
