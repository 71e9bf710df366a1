//! Any simulation can use all tools of this crate. One that shares nothing with this crate's own is recorded with its
//! terms, thresholds, phases, events, stages and scalars, replayed, compared, checked, and kept by the flight recorder.

use std::path::Path;

use glam::DQuat;
use meldscope::{
    geometry::Vectors,
    observe::{Experiment as _, Frame, Want},
    recording::{
        Recorded, diff,
        frames::FrameReader,
        golden::{self, GoldenOutcome},
        replay::{self, Verdict},
    },
    stream::{
        self, Settings,
        settings::{Detail, Entities, Frames, Trigger},
        sinks::Destinations,
    },
};

use crate::{
    octahedra::Octahedra,
    recording::{Dir, Recording},
};

/// Records and reads the recording back; also returns the number of frames.
fn record(path: &Path, pull: f64, settings: Settings) -> (Recorded, u64) {
    let destinations = Destinations { save: Some(path.to_owned()), ..Destinations::default() };
    let frames = stream::record(&Octahedra(pull), settings, &destinations).expect("a recording");
    let recorded = Recorded::open_as(path, &|name, text, run| Octahedra(0.0).read(name, text, run));
    (recorded.expect("a recording"), frames)
}

#[test]
fn any_simulation_is_recorded_replayed_compared_and_checked() {
    let (dir, own) = (Dir::new(), Settings::of(&Octahedra(3.0)));
    let with = |name: &str, pull, settings| record(&dir.file(name), pull, settings);
    let (full, frames) = with("full", 3.0, Settings { detail: Detail::Stages { from: 20, to: 30 }, ..own.clone() });
    let (thin, _) = with("thin", 3.0, Settings { frames: Frames::Thin, ..own.clone() });
    let (other, _) = with("other", 3.1, Settings { entities: Entities::Batch, ..own.clone() });
    let last = Frames::Last { most: 3, on: vec![Trigger::Merge], after: 0 };
    assert_eq!((frames, with("kept", 3.0, Settings { frames: last, ..own }).1), (101, 3));
    let phases: Vec<_> = full.events.iter().filter_map(|event| event.phases.clone()).collect();
    assert_eq!(phases, [["loose", "gripped"], ["gripped", "loose"]]);
    for recorded in [&full, &thin, &other] {
        assert_eq!(replay::verify(recorded, |_| true).expect("it runs"), Verdict::Identical);
    }
    let entities = Recording::open(&dir.file("other")).entities();
    for entity in
        ["world/forces/grip", "pairs/a~b/slip_at", "pairs/a~b/phase", "timings/project", "diagnostics/stretch"]
    {
        assert!(entities.contains(&entity.into()), "{entity}");
    }

    let same = diff::diff([&full, &thin], 1e-6).expect("the same bodies");
    assert_eq!((same.instants, same.first_bits, same.bodies, same.events), (101, None, vec![], vec![]));
    let differing = diff::diff([&full, &other], 1e-6).expect("the same bodies");
    let first = differing.first_beyond.expect("they differ").step;
    assert_eq!((differing.first_bits, differing.bodies.len()), (Some(first), 2));
    let path = dir.file("golden");
    golden::bless(&Octahedra(3.0), &path, "a test").expect("disk space");
    let check = |pull| golden::check(&Octahedra(pull), &path, None).expect("it runs");
    assert!(matches!(check(3.0), GoldenOutcome::Identical { events: 2, .. }));
    assert!(
        matches!(check(3.1), GoldenOutcome::Different(found) if found.first.as_ref().is_some_and(|at| at.step == first))
    );
}

/// A rotating body is recorded in its own axes and read back in world axes, as its own entity and in a batch, at rest
/// and deformed.
#[test]
fn rotations_are_recorded_and_read_back() {
    let (dir, own) = (Dir::new(), Settings::of(&Octahedra(3.0)));
    for (name, entities) in [("body", Entities::Body), ("batch", Entities::Batch)] {
        let (recorded, _) = record(&dir.file(name), 3.0, Settings { entities, ..own.clone() });
        let mut frames = FrameReader::open(&recorded).expect("a recording");
        let mut simulation = Octahedra(3.0).start().expect("enough memory");
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
            simulation.step();
        }
        assert_eq!(count, 101);
        assert!(now.bodies[1].rotation.angle_between(DQuat::IDENTITY) > 2.0);

        let entities = Recording::open(&dir.file(name)).entities();
        let has = |entity: &str| entities.contains(&entity.into());
        assert_eq!([has("world/bodies/b"), has("world/resting/octahedron")], [name == "body", name == "batch"]);
    }
}
