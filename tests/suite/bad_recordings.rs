//! Recordings and scenes that are broken in any way: an error or a result, never a panic, never more memory than they
//! are worth.
//!
//! Real recordings are changed at random: for three seconds each here, longer with `MELDSCOPE_FUZZ_SECONDS`.

use std::{
    fs,
    path::Path,
    process::Command,
    time::{Duration, Instant},
};

use meldscope::{
    Scene,
    recording::{ReadError, Recorded, frames::Frames, golden, replay},
    scene::builtin,
    stream::{
        chunks,
        settings::{Entities, Settings},
    },
};
use rerun::{
    StoreId, StoreKind, TextDocument,
    external::{
        re_build_info::CrateVersion,
        re_log_encoding::{Encoder, EncodingOptions},
    },
};

use crate::recording::Dir;

const SCENE: &str = r#"
name = "small"
duration = 0.5

[[body]]
name = "a"
radius = 1.0
shape = { sphere = { stacks = 3, slices = 4 } }
motion = { fixed = [0, 0, 0] }

[[body]]
name = "b"
radius = 0.5
shape = { sphere = { stacks = 3, slices = 4 } }
motion = { line = { from = [2.0, 0.3, 0], velocity = [-2, 0, 0] } }
"#;

fn program(dir: &Dir, arguments: &[&str]) -> (i32, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_meldscope")).args(arguments).current_dir(dir.path()).output();
    let output = output.expect("it starts");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!said.contains("panicked"), "{said}");
    (output.status.code().expect("a status"), said)
}

/// Recordings of all kinds, small ones.
fn corpus(dir: &Dir) -> Vec<Vec<u8>> {
    fs::write(dir.file("small.toml"), SCENE).expect("room");
    for (name, options) in [
        ("full", &[] as &[&str]),
        ("surface", &["--detail", "surface", "--every", "3"]),
        ("batch", &["--entities", "batch"]),
        ("thin", &["--thin"]),
        ("keep", &["--keep", "4"]),
    ] {
        let file = format!("{name}.rrd");
        let (status, said) = program(dir, &[&["run", "small.toml", "--quiet", "--save", &file], options].concat());
        assert_eq!(status, 0, "{said}");
    }
    let scene = Scene::parse(SCENE, "small").expect("a scene");
    golden::bless(&scene, &dir.file("golden.rrd"), "a test").expect("room");
    let files = ["full", "surface", "batch", "thin", "keep", "golden"];
    files.map(|name| fs::read(dir.file(&format!("{name}.rrd"))).expect("a file")).into()
}

/// xorshift64*.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }

    fn below(&mut self, end: usize) -> usize {
        (self.next() % end.max(1) as u64) as usize
    }
}

/// Changes bytes in one of many ways.
fn mutate(bytes: &mut Vec<u8>, random: &mut Random) {
    for _ in 0..=random.below(3) {
        let length = bytes.len();
        let at = random.below(length);
        match random.below(8) {
            0 => bytes.truncate(at),
            1 => drop(bytes.drain(at..(at + random.below(64)).min(length))),
            2 => {
                let piece = bytes[at..(at + random.below(256)).min(length)].to_vec();
                let to = random.below(length);
                bytes.splice(to..to, piece);
            }
            3 if at + 8 < length => {
                // a length, or something that is taken for one
                let value = [u64::MAX, 1 << 62, 1 << 40, 3 << 30, 0][random.below(5)];
                bytes[at..at + 8].copy_from_slice(&value.to_le_bytes());
            }
            4 => bytes.splice(at..at, [random.next() as u8]).for_each(drop),
            _ => {
                for _ in 0..=random.below(4) {
                    let at = random.below(length);
                    if let Some(byte) = bytes.get_mut(at) {
                        *byte ^= 1 << random.below(8);
                    }
                }
            }
        }
        if bytes.is_empty() {
            break;
        }
    }
}

fn seconds() -> f64 {
    std::env::var("MELDSCOPE_FUZZ_SECONDS").ok().and_then(|text| text.parse().ok()).unwrap_or(3.0)
}

/// What a user's command would do with a file.
fn use_it(path: &Path, scene: &Scene) -> Result<(), ReadError> {
    let recorded = Recorded::open(path)?;
    let mut frames = Frames::open(&recorded)?;
    while let Some(frame) = frames.next()? {
        for body in 0..recorded.scene.bodies.len() {
            frame.world_positions(&recorded.scene, body);
        }
    }
    if let replay::Verdict::Divergent(divergence) = replay::verify(&recorded, |_| true)? {
        divergence.worst(&recorded)?;
    }
    golden::check(scene, path, None)?;
    Ok(())
}

#[test]
fn no_broken_recording_brings_the_reader_down() {
    let dir = Dir::new();
    let corpus = corpus(&dir);
    let scene = Scene::parse(SCENE, "small").expect("a scene");
    let mut random = Random(0x9e37_79b9_7f4a_7c15);
    let (start, limit) = (Instant::now(), Duration::from_secs_f64(seconds()));
    let (mut runs, mut refused) = (0u64, 0u64);
    let path = dir.file("broken.rrd");
    while start.elapsed() < limit {
        let mut bytes = corpus[random.below(corpus.len())].clone();
        mutate(&mut bytes, &mut random);
        fs::write(&path, &bytes).expect("room");
        let outcome = std::panic::catch_unwind(|| use_it(&path, &scene));
        match outcome {
            Ok(Ok(())) => {}
            Ok(Err(error)) => {
                let text = error.to_string();
                assert!(!text.contains('\n') && text.contains("broken.rrd"), "{text}");
                refused += 1;
            }
            Err(_) => {
                let kept = std::env::temp_dir().join("meldscope-broken.rrd");
                fs::write(&kept, &bytes).expect("room");
                panic!("after {runs} recordings, {} brought it down", kept.display());
            }
        }
        runs += 1;
    }
    println!("{runs} broken recordings, {refused} refused");
    assert!(runs > 50 && refused > runs / 4, "{runs} {refused}");
}

#[test]
fn no_broken_scene_brings_the_parser_down() {
    let mut random = Random(0x2545_f491_4f6c_dd1d);
    let texts: Vec<&str> =
        builtin::ALL.iter().map(|builtin| builtin.text).filter(|text| text.len() < 4096).chain([SCENE]).collect();
    let (start, limit) = (Instant::now(), Duration::from_secs_f64(seconds()));
    let (mut runs, mut refused) = (0u64, 0u64);
    while start.elapsed() < limit {
        let mut bytes = texts[random.below(texts.len())].as_bytes().to_vec();
        mutate(&mut bytes, &mut random);
        let text = String::from_utf8_lossy(&bytes);
        if let Err(error) = Scene::parse(&text, "broken.toml") {
            assert!(error.to_string().contains("broken.toml"), "{error}");
            refused += 1;
        }
        runs += 1;
    }
    println!("{runs} broken scenes, {refused} refused");
    assert!(runs > 100 && refused > runs / 4, "{runs} {refused}");
}

/// A flipped bit is found wherever it matters: no recording that was finished is said to differ because of it.
#[test]
fn a_flipped_bit_is_no_divergence() {
    let dir = Dir::new();
    let corpus = corpus(&dir);
    let path = dir.file("flipped.rrd");
    let mut random = Random(1);
    for _ in 0..300 {
        let mut bytes = corpus[3].clone();
        let at = random.below(bytes.len());
        bytes[at] ^= 1 << random.below(8);
        fs::write(&path, &bytes).expect("room");
        let Ok(recorded) = Recorded::open(&path) else { continue };
        let verdict = replay::verify(&recorded, |_| true);
        assert_eq!(verdict.expect("its own checksums"), replay::Verdict::Identical, "byte {at}");
    }
}

#[test]
fn broken_recordings_are_refused_with_what_is_wrong() {
    let dir = Dir::new();
    let corpus = corpus(&dir);
    let refused = |bytes: &[u8], what: &str| {
        fs::write(dir.file("bad.rrd"), bytes).expect("room");
        for command in
            [&["replay", "bad.rrd"] as &[&str], &["diff", "bad.rrd", "full.rrd"], &["diff", "full.rrd", "bad.rrd"]]
        {
            let (status, said) = program(&dir, command);
            if command[0] == "diff" && what == "cut short" {
                continue; // what is there is compared
            }
            assert_eq!(status, 2, "{command:?}: {said}");
            assert!(said.starts_with("error: ") && said.contains("bad.rrd") && said.contains(what), "{what}: {said}");
            assert_eq!(said.lines().count(), 1, "{said}");
        }
    };
    let full = &corpus[0];
    refused(b"", "it is empty");
    refused(b"RRF2", "ends within its header");
    refused(b"hello, world; this is a letter", "no .rrd file at all");
    refused(&full[..200], "before it says what it is");
    refused(&full[..full.len() / 2], "cut short");
    refused(&full[..full.len() - 10], "cut short");
    refused(&[full.as_slice(), b"more"].concat(), "something after its end");
    refused(&[full.as_slice(), full].concat(), "something after its end");

    let with = |at: usize, bytes: &[u8]| {
        let mut changed = full.clone();
        changed[at..at + bytes.len()].copy_from_slice(bytes);
        changed
    };
    refused(&with(4, &[0, 99, 0, 0]), "Rerun 0.99.0");
    refused(&with(4, &[0, 2, 0, 0]), "too old");
    refused(&with(0, b"RRF0"), "early version");
    refused(&with(8, &[9]), "options");
    refused(&with(12, &77u64.to_le_bytes()), "no message of kind 77");
    refused(&with(20, &u64::MAX.to_le_bytes()), "bytes");
    refused(&with(20, &(5u64 << 30).to_le_bytes()), "bytes");

    // a recording of something else
    let store = StoreId::new(StoreKind::Recording, "other", "other");
    let mut other = chunks::Chunks::new(store);
    other.log_static("/text", &TextDocument::new("hello"));
    refused(&encoded(other), "no properties of one");
}

/// A recording of these, as a file has it.
fn encoded(mut chunks: chunks::Chunks) -> Vec<u8> {
    let mut bytes = Vec::new();
    let (messages, options) = (chunks.take(), EncodingOptions::PROTOBUF_COMPRESSED);
    Encoder::encode_into(CrateVersion::LOCAL, options, messages.iter().map(Ok), &mut bytes).expect("it encodes");
    bytes
}

/// What a header claims is not believed: with 3 GiB of address space, the program says no, and does not die.
#[cfg(target_os = "linux")]
#[test]
fn claims_take_no_memory() {
    let dir = Dir::new();
    let corpus = corpus(&dir);
    for (name, at, value) in [("length", 20usize, (1u64 << 30) - 1), ("length", 20, 1 << 45)] {
        let mut bytes = corpus[0].clone();
        bytes[at..at + 8].copy_from_slice(&value.to_le_bytes());
        fs::write(dir.file("claims.rrd"), bytes).expect("room");
        let script = format!("ulimit -v 3000000; exec '{}' replay claims.rrd", env!("CARGO_BIN_EXE_meldscope"));
        let output = Command::new("sh").args(["-c", &script]).current_dir(dir.path()).output().expect("a shell");
        assert_eq!(output.status.code(), Some(2), "{name}: {}", String::from_utf8_lossy(&output.stderr));
    }
}

/// A format that is not ours yet, or no longer.
#[test]
fn other_formats_are_named() {
    let dir = Dir::new();
    let scene = Scene::parse(SCENE, "small").expect("a scene");
    for (format, what) in [(Some(99.0), "has format 99"), (None, "before recordings carried checksums")] {
        let settings = Settings { entities: Entities::Body, ..Settings::of(&scene) };
        let text = |value: &str| [rerun::components::Text::from(value)];
        let mut properties = rerun::AnyValues::default()
            .with_component::<rerun::components::Text>("scene", text(SCENE))
            .with_component::<rerun::components::Text>("settings", text(&settings.to_toml()))
            .with_component::<rerun::components::Text>("version", text("9.9.9"));
        if let Some(format) = format {
            properties = properties.with_component::<rerun::components::Scalar>("format", [format]);
        }
        let mut chunks = chunks::Chunks::new(StoreId::new(StoreKind::Recording, "meldscope_small", "small-0"));
        chunks.log_static("/__properties/meldscope", &properties);
        fs::write(dir.file("format.rrd"), encoded(chunks)).expect("room");
        let (status, said) = program(&dir, &["replay", "format.rrd"]);
        assert!(status == 2 && said.contains(what), "{said}");
    }
}
