//! Merged surfaces in recordings and in exported files, and random unions compared with `manifold-rust`: the first ones,
//! or with `MELDSCOPE_FUZZ_SECONDS` different ones for that long. `cargo bench --bench union -- fuzz` runs any number of
//! them.

#[path = "../benches/union/fuzz.rs"]
mod fuzz;
#[path = "../benches/union/scenes.rs"]
mod scenes;

use std::{
    fs,
    process::Command,
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use meldscope::geometry::files;
use meldscope::sdk;

use crate::{
    random::fuzz_seconds,
    recording::{Dir, Recording},
};

/// Two spheres that merge, with a single surface at step 60.
const MERGING: &str = r#"
duration = 1.5
[[body]]
name = "a"
radius = 1.0
motion = { fixed = [0, 0, 0] }
[[body]]
name = "b"
radius = 0.5
motion = { line = { from = [2.0, 0.4, 0.1], velocity = [-0.8, 0, 0] } }
"#;

#[test]
fn a_merged_surface_is_recorded_and_exported_equally_in_every_format() {
    let dir = Dir::new();
    fs::write(dir.file("merging.toml"), MERGING).expect("disk space");
    let run = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_meldscope")).args(arguments).current_dir(dir.path()).output();
        let output = output.expect("it starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    };
    run(&["run", "merging.toml", "--quiet", "--save", "x.rrd"]);
    let recording = Recording::open(&dir.file("x.rrd"));
    let at = |entity: &str, step: u64| recording.held(entity, [step]).pop().unwrap_or_default();
    let number = |entity: &str| at(entity, 60).scalar().expect("a number");
    let surface = at("/world/merged/surface", 60);
    let positions = surface.get::<sdk::datatypes::Vec3D>("Mesh3D:vertex_positions");
    let triangles = surface.get::<sdk::datatypes::UVec3D>("Mesh3D:triangle_indices");
    assert_eq!(number("/groups/a/components"), 1.0);
    assert_eq!((number("/groups/a/euler"), number("/groups/a/genus")), (2.0, 0.0));
    assert_eq!(positions.len() - triangles.len() / 2, 2, "χ of the drawn surface");
    let position = |v: u32| glam::DVec3::from(positions[v as usize].0.map(f64::from));
    let volume: f64 = (triangles.iter())
        .map(|triangle| {
            let [a, b, c] = triangle.0.map(position);
            a.dot(b.cross(c)) / 6.0
        })
        .sum();
    assert!((volume / number("/groups/a/volume") - 1.0).abs() < 5e-3, "{volume}");
    let [gap, overlap, neck] = ["gap", "overlap", "neck"].map(|measure| number(&format!("/pairs/a~b/{measure}")));
    assert!(gap < 0.0 && overlap > 0.0 && neck > 0.1, "{gap} {overlap} {neck}");
    // its bodies are not drawn in addition, and before they merge there is no merged surface
    assert!(at("/world/merged/surface", 0).get::<sdk::datatypes::Vec3D>("Mesh3D:vertex_positions").is_empty());

    for format in ["glb", "obj", "ply", "stl"] {
        let range = ["--from", "60", "--to", "60", "--format", format];
        run(&[&["export", "x.rrd", "--mesh", format][..], &range].concat());
        let names: Vec<_> =
            fs::read_dir(dir.file(format)).expect("a folder").flatten().map(|file| file.path()).collect();
        let [file] = names.as_slice() else { panic!("{names:?}") };
        // only closed surfaces can be loaded
        let loaded = files::load(file, &|_| ()).unwrap_or_else(|error| panic!("{format}: {error}"));
        let mesh = loaded.mesh.mesh();
        assert_eq!((mesh.vertex_count(), mesh.triangles().len()), (positions.len(), triangles.len()), "{format}");
    }
}

#[test]
fn unions_are_closed_and_match_another_library() {
    let (scenes, time) = match fuzz_seconds() {
        None => (0..400, Duration::MAX),
        Some(seconds) => {
            let first = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |now| now.as_secs()) << 16;
            (first..u64::MAX, Duration::from_secs_f64(seconds))
        }
    };
    let tallies = fuzz::run(scenes, time, |_, _| ());
    assert_eq!(fuzz::print(&tallies), 0);
}
