//! Corrupt recordings and scenes lead to an error or a result, never to a panic or to excessive memory use.
//!
//! Fuzzes real recordings; `MELDSCOPE_FUZZ_SECONDS` lets each test run longer.

use std::{
    fs,
    path::Path,
    process::Command,
    sync::Arc,
    time::{Duration, Instant as Clock},
};

use meldscope::{
    Scene,
    recording::{ReadError, Recorded, frames::FrameReader, golden, read::Reader, replay},
    scene::builtin,
    sdk::{
        self, AnyValues, CrateVersion, Encoder, EncodingOptions, StoreId, StoreKind, TextDocument, TextLog,
        arrow::{
            array::{ArrayRef, Float64Array, UInt32Array, UInt64Array},
            ipc::root_as_message,
        },
        lz4_flex,
    },
    stream::{
        chunks,
        contract::GOLDEN_STATES,
        instant::Instant,
        settings::{Entities, Settings},
    },
};

use crate::{random::cases, recording::Dir};

pub const SCENE: &str = r#"
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
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!stderr.contains("panicked"), "{stderr}");
    (output.status.code().expect("a status"), stderr)
}

/// Small recordings of every kind.
fn corpus(dir: &Dir) -> Vec<Vec<u8>> {
    fs::write(dir.file("small.toml"), SCENE).expect("disk space");
    for (name, options) in [
        ("full", &[] as &[&str]),
        ("surface", &["--detail", "surface", "--every", "3"]),
        ("batch", &["--entities", "batch"]),
        ("thin", &["--thin"]),
        ("keep", &["--keep", "4"]),
    ] {
        let file = format!("{name}.rrd");
        let (status, stderr) = program(dir, &[&["run", "small.toml", "--quiet", "--save", &file], options].concat());
        assert_eq!(status, 0, "{stderr}");
    }
    let scene = Scene::parse(SCENE, "small").expect("a scene");
    golden::bless(&scene, &dir.file("golden.rrd"), "a test").expect("disk space");
    let files = ["full", "surface", "batch", "thin", "keep", "golden"];
    files.map(|name| fs::read(dir.file(&format!("{name}.rrd"))).expect("a file")).into()
}

/// A xorshift64* generator.
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

/// Corrupts bytes in one of many ways.
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
                // a length, or bytes that are interpreted as one
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

/// Reads, replays and checks a file, as the commands do.
fn read_and_replay(path: &Path, scene: &Scene) -> Result<(), ReadError> {
    let recorded = Recorded::open(path)?;
    let mut frames = FrameReader::open(&recorded)?;
    while let Some(frame) = frames.next()? {
        for body in 0..recorded.schema.bodies.len() {
            frame.world_positions(body);
        }
    }
    if let replay::Verdict::Divergent(divergence) = replay::verify(&recorded, |_| true)? {
        divergence.worst(&recorded)?;
    }
    golden::check(scene, path, None)?;
    Ok(())
}

#[test]
fn no_broken_recording_crashes_the_reader() {
    let dir = Dir::new();
    let corpus = corpus(&dir);
    let scene = Scene::parse(SCENE, "small").expect("a scene");
    let mut random = Random(0x9e37_79b9_7f4a_7c15);
    let (mut runs, mut rejected) = (0u64, 0u64);
    let path = dir.file("broken.rrd");
    for _ in cases(150) {
        let mut bytes = corpus[random.below(corpus.len())].clone();
        mutate(&mut bytes, &mut random);
        fs::write(&path, &bytes).expect("disk space");
        let outcome = std::panic::catch_unwind(|| read_and_replay(&path, &scene));
        match outcome {
            Ok(Ok(())) => {}
            Ok(Err(error)) => {
                let text = error.to_string();
                assert!(!text.contains('\n') && text.contains("broken.rrd"), "{text}");
                rejected += 1;
            }
            Err(_) => {
                let kept = std::env::temp_dir().join("meldscope-broken.rrd");
                fs::write(&kept, &bytes).expect("disk space");
                panic!("after {runs} recordings, {} brought it down", kept.display());
            }
        }
        runs += 1;
    }
    println!("{runs} broken recordings, {rejected} rejected");
    assert!(runs > 50 && rejected > runs / 4, "{runs} {rejected}");
}

#[test]
fn no_broken_scene_crashes_the_parser() {
    let mut random = Random(0x2545_f491_4f6c_dd1d);
    let texts: Vec<&str> =
        builtin::ALL.iter().map(|builtin| builtin.text).filter(|text| text.len() < 4096).chain([SCENE]).collect();
    let (mut runs, mut rejected) = (0u64, 0u64);
    for _ in cases(20_000) {
        let mut bytes = texts[random.below(texts.len())].as_bytes().to_vec();
        mutate(&mut bytes, &mut random);
        let text = String::from_utf8_lossy(&bytes);
        if let Err(error) = Scene::parse(&text, "broken.toml") {
            assert!(error.to_string().contains("broken.toml"), "{error}");
            rejected += 1;
        }
        runs += 1;
    }
    println!("{runs} broken scenes, {rejected} rejected");
    assert!(runs > 100 && rejected > runs / 4, "{runs} {rejected}");
}

/// A flipped bit is detected wherever it matters: it never makes a finished recording appear to differ.
#[test]
fn a_flipped_bit_is_not_reported_as_divergence() {
    let dir = Dir::new();
    let corpus = corpus(&dir);
    let path = dir.file("flipped.rrd");
    let mut random = Random(1);
    for _ in 0..300 {
        let mut bytes = corpus[3].clone();
        let at = random.below(bytes.len());
        bytes[at] ^= 1 << random.below(8);
        fs::write(&path, &bytes).expect("disk space");
        let Ok(recorded) = Recorded::open(&path) else { continue };
        let verdict = replay::verify(&recorded, |_| true);
        assert_eq!(verdict.expect("its own checksums"), replay::Verdict::Identical, "byte {at}");
    }
}

/// Checksums do not cover events.
#[test]
fn replays_compare_events() {
    let dir = Dir::new();
    let (status, stderr) = program(&dir, &["run", "two", "--steps", "90", "--thin", "--save", "thin.rrd", "-q"]);
    assert_eq!(status, 0, "{stderr}");
    let mut bytes = fs::read(dir.file("thin.rrd")).expect("a recording");
    let phase = bytes.windows(5).rposition(|window| window == b"apart").expect("the phase before the event");
    bytes[phase] ^= 2;
    fs::write(dir.file("event.rrd"), bytes).expect("disk space");
    let (status, stderr) = program(&dir, &["replay", "event.rrd"]);
    assert!(status == 2 && stderr.contains("event.rrd") && stderr.contains("event 1 is not: "), "{status}, {stderr}");
}

#[test]
fn broken_recordings_are_rejected_with_the_reason() {
    let dir = Dir::new();
    let corpus = corpus(&dir);
    let rejected = |bytes: &[u8], what: &str| {
        fs::write(dir.file("bad.rrd"), bytes).expect("disk space");
        for command in
            [&["replay", "bad.rrd"] as &[&str], &["diff", "bad.rrd", "full.rrd"], &["diff", "full.rrd", "bad.rrd"]]
        {
            let (status, stderr) = program(&dir, command);
            if command[0] == "diff" && what == "cut short" {
                continue; // existing data is compared
            }
            assert_eq!(status, 2, "{command:?}: {stderr}");
            assert!(
                stderr.starts_with("error: ") && stderr.contains("bad.rrd") && stderr.contains(what),
                "{what}: {stderr}"
            );
            assert_eq!(stderr.lines().count(), 1, "{stderr}");
        }
    };
    let full = &corpus[0];
    rejected(b"", "it is empty");
    rejected(b"RRF2", "ends within its header");
    rejected(b"hello, world; this is a letter", "not an .rrd file");
    rejected(&full[..200], "before its header is complete");
    rejected(&full[..full.len() / 2], "cut short");
    rejected(&full[..full.len() - 10], "cut short");
    rejected(&[full.as_slice(), b"more"].concat(), "data after its end");
    rejected(&[full.as_slice(), full].concat(), "data after its end");

    let with = |at: usize, bytes: &[u8]| {
        let mut changed = full.clone();
        changed[at..at + bytes.len()].copy_from_slice(bytes);
        changed
    };
    rejected(&with(4, &[0, 99, 0, 0]), "Rerun 0.99.0");
    rejected(&with(4, &[0, 2, 0, 0]), "too old");
    rejected(&with(0, b"RRF0"), "early version");
    rejected(&with(8, &[9]), "options");
    rejected(&with(12, &77u64.to_le_bytes()), "unknown kind 77");
    rejected(&with(20, &u64::MAX.to_le_bytes()), "bytes");
    rejected(&with(20, &(5u64 << 30).to_le_bytes()), "bytes");

    // a recording of something else
    let store = StoreId::new(StoreKind::Recording, "other", "other");
    let mut other = chunks::Chunks::new(store);
    other.log_static("/text", &TextDocument::new("hello"));
    rejected(&encoded(other), "lacks the properties of one");
}

/// The chunks as a recording file.
pub fn encoded(mut chunks: chunks::Chunks) -> Vec<u8> {
    let mut bytes = Vec::new();
    let (messages, options) = (chunks.take(), EncodingOptions::PROTOBUF_COMPRESSED);
    Encoder::encode_into(CrateVersion::LOCAL, options, messages.iter().map(Ok), &mut bytes).expect("an encoding");
    bytes
}

/// Claimed sizes in a header are not trusted: with 3 GiB of address space, the program reports an error instead of
/// crashing.
#[cfg(target_os = "linux")]
#[test]
fn claimed_sizes_allocate_no_memory() {
    let dir = Dir::new();
    let corpus = corpus(&dir);
    for (name, at, value) in [("length", 20usize, (1u64 << 30) - 1), ("length", 20, 1 << 45)] {
        let mut bytes = corpus[0].clone();
        bytes[at..at + 8].copy_from_slice(&value.to_le_bytes());
        fs::write(dir.file("claims.rrd"), bytes).expect("disk space");
        let script = format!("ulimit -v 3000000; exec '{}' replay claims.rrd", env!("CARGO_BIN_EXE_meldscope"));
        let output = Command::new("sh").args(["-c", &script]).current_dir(dir.path()).output().expect("a shell");
        assert_eq!(output.status.code(), Some(2), "{name}: {}", String::from_utf8_lossy(&output.stderr));
    }
}

/// A format version that is not supported yet, or no longer.
#[test]
fn unsupported_formats_are_named() {
    let dir = Dir::new();
    let scene = Scene::parse(SCENE, "small").expect("a scene");
    for (format, what) in [(Some(99.0), "has format 99"), (None, "before recordings carried checksums")] {
        let settings = Settings { entities: Entities::Body, ..Settings::of(&scene) };
        let text = |value: &str| [sdk::components::Text::from(value)];
        let mut properties = sdk::AnyValues::default()
            .with_component::<sdk::components::Text>("scene", text(SCENE))
            .with_component::<sdk::components::Text>("settings", text(&settings.to_toml()))
            .with_component::<sdk::components::Text>("version", text("9.9.9"));
        if let Some(format) = format {
            properties = properties.with_component::<sdk::components::Scalar>("format", [format]);
        }
        let mut chunks = chunks::Chunks::new(StoreId::new(StoreKind::Recording, "meldscope_small", "small-0"));
        chunks.log_static("/__properties/meldscope", &properties);
        fs::write(dir.file("format.rrd"), encoded(chunks)).expect("disk space");
        let (status, stderr) = program(&dir, &["replay", "format.rrd"]);
        assert!(status == 2 && stderr.contains(what), "{stderr}");
    }
}

// ---- forged chunks
// -----------------------------------------------------------------------------------------------------

/// A message as stored in a file: its kind and its body.
#[derive(Clone)]
pub struct Message {
    pub kind: u64,
    pub body: Vec<u8>,
}

/// The messages of a whole recording, except its end.
fn messages(bytes: &[u8]) -> Vec<Message> {
    let mut rest = &bytes[12..];
    let mut messages = Vec::new();
    while let Some((header, after)) = rest.split_at_checked(16) {
        let [kind, length] = [&header[..8], &header[8..]].map(|word| u64::from_le_bytes(word.try_into().expect("8")));
        if kind == 0 {
            break;
        }
        let (body, after) = after.split_at(length as usize);
        messages.push(Message { kind, body: body.to_vec() });
        rest = after;
    }
    messages
}

/// The messages as a file without a footer.
pub fn file(messages: &[Message]) -> Vec<u8> {
    let mut bytes = b"RRF2\x00\x24\x03\x00\x01\x02\x00\x00".to_vec();
    for Message { kind, body } in messages {
        bytes.extend(kind.to_le_bytes());
        bytes.extend((body.len() as u64).to_le_bytes());
        bytes.extend(body);
    }
    bytes.extend([0; 16]);
    bytes
}

/// A Protobuf message: numbers and bytes by field.
pub type Fields = Vec<(u64, Result<u64, Vec<u8>>)>;

pub fn fields(mut bytes: &[u8]) -> Fields {
    fn varint(bytes: &mut &[u8]) -> u64 {
        let mut value = 0;
        for shift in (0..).step_by(7) {
            let (&byte, rest) = bytes.split_first().expect("a byte");
            *bytes = rest;
            value |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                break;
            }
        }
        value
    }
    let mut fields = Fields::new();
    while !bytes.is_empty() {
        let key = varint(&mut bytes);
        let value = varint(&mut bytes);
        fields.push((
            key >> 3,
            if key & 7 == 0 {
                Ok(value)
            } else {
                let (head, rest) = bytes.split_at(value as usize);
                bytes = rest;
                Err(head.to_vec())
            },
        ));
    }
    fields
}

fn unfields(fields: &Fields) -> Vec<u8> {
    fn varint(bytes: &mut Vec<u8>, mut value: u64) {
        while value >= 0x80 {
            bytes.push(value as u8 | 0x80);
            value >>= 7;
        }
        bytes.push(value as u8);
    }
    let mut bytes = Vec::new();
    for (field, value) in fields {
        match value {
            Ok(number) => {
                varint(&mut bytes, field << 3);
                varint(&mut bytes, *number);
            }
            Err(data) => {
                varint(&mut bytes, field << 3 | 2);
                varint(&mut bytes, data.len() as u64);
                bytes.extend(data);
            }
        }
    }
    bytes
}

/// `data` followed by this many zeros, compressed with LZ4.
fn packed(data: &[u8], zeros: usize) -> Vec<u8> {
    if zeros == 0 {
        return lz4_flex::block::compress(data);
    }
    fn length(bytes: &mut Vec<u8>, mut rest: usize) {
        while rest >= 255 {
            bytes.push(255);
            rest -= 255;
        }
        bytes.push(rest as u8);
    }
    // literals, including one zero more than requested; then that zero repeated; then the literals required at the end
    let mut bytes = vec![0xff];
    length(&mut bytes, (data.len() + 1).max(15) - 15);
    bytes.extend(data.iter().chain(std::iter::repeat_n(&0, 1 + 15usize.saturating_sub(data.len() + 1))));
    bytes.extend(1u16.to_le_bytes());
    length(&mut bytes, zeros.max(27) - 26);
    bytes.push(12 << 4);
    bytes.extend([0; 12]);
    bytes
}

/// Upper limit on data that is unpacked for further corruption [bytes].
const MAX_UNPACKED: usize = 32 << 20;

/// The uncompressed payload of a message, and its envelope.
fn unpacked(message: &Message) -> (Fields, Vec<u8>) {
    let envelope = fields(&message.body);
    let number = |field: u64| envelope.iter().find_map(|(f, value)| value.as_ref().ok().filter(|_| *f == field));
    let payload = envelope.iter().find_map(|(f, value)| value.as_ref().err().filter(|_| *f == 5)).expect("a payload");
    let data = match number(2) {
        Some(2) => {
            let size = *number(3).expect("a size") as usize;
            assert!(size <= MAX_UNPACKED, "already forged to be too large");
            lz4_flex::block::decompress(payload, size).expect("a valid message")
        }
        _ => payload.clone(),
    };
    (envelope, data)
}

/// The message with other data, followed by this many zeros.
fn repacked(message: &Message, data: &[u8], zeros: usize) -> Message {
    let (mut envelope, _) = unpacked_or_empty(message);
    let payload = packed(data, zeros);
    let size = if zeros == 0 { data.len() } else { (data.len() + 1).max(15) + zeros.max(27) - 26 + 19 + 12 };
    envelope.retain(|(field, _)| ![2, 3, 5].contains(field));
    envelope.extend([(2, Ok(2)), (3, Ok(size as u64)), (5, Err(payload))]);
    Message { kind: message.kind, body: unfields(&envelope) }
}

/// The ranges of the metadata in an Arrow stream.
fn metadata(data: &[u8]) -> Vec<std::ops::Range<usize>> {
    let word =
        |at: usize| data.get(at..at.saturating_add(4)).map(|word| u32::from_le_bytes(word.try_into().expect("4")));
    let (mut at, mut ranges) = (0, Vec::new());
    while let (Some(u32::MAX), Some(length @ 1..)) = (word(at), word(at + 4)) {
        let range = at + 8..at + 8 + length as usize;
        // the metadata may already be corrupt
        let Some(Ok(message)) = data.get(range.clone()).map(root_as_message) else { break };
        at = range.end.saturating_add(message.bodyLength().unsigned_abs() as usize);
        ranges.push(range);
    }
    ranges
}

/// A forged number.
fn lie(random: &mut Random, truth: u64) -> u64 {
    let lies =
        [0, 1, truth.wrapping_sub(1), truth + 1, 2 * truth, 255 * truth, 1 << 20, 1 << 28, 1 << 30, 1 << 31, 1 << 40];
    let more = [1 << 62, i64::MAX as u64, 1 << 63, u64::MAX, u64::from(u32::MAX), i32::MAX as u64, random.next()];
    let lies = [&lies[..], &more].concat();
    lies[random.below(lies.len())]
}

/// Chunks with known and unknown content, of any size.
fn strange(random: &mut Random, id: &str) -> Vec<Message> {
    let mut chunks = chunks::Chunks::new(StoreId::new(StoreKind::Recording, "meldscope_small", id));
    let many = [0, 1, 7, 1000, 100_000, 3_000_000][random.below(6)];
    let few = [0, 1, 100, 5_000][random.below(4)];
    let at = |step: u64| Instant { step, time: step as f64 / 60.0 };
    let step = [0, 1, 31, 32, many as u64, i64::MAX as u64, u64::MAX][random.below(7)];
    let values = |count: usize| Arc::new(UInt64Array::from(vec![0; count])) as ArrayRef;
    let checksum = |count| AnyValues::default().with_component_from_data("checksum", values(count));
    match random.below(9) {
        0 => chunks.log("/checksum", at(step), &checksum(many)),
        1 => (0..few).for_each(|row| chunks.log("/checksum", at(31 + row as u64), &checksum(row % 3))),
        2 => {
            let line = TextLog::new("merge a~b at t = 0.1").with_level("merge");
            (0..few).for_each(|_| chunks.log("/events", at(step), &line));
        }
        3 => {
            let text = ["x", "[[", "a.", "\u{1b}[2J", "é"][random.below(5)].repeat(many);
            let name = ["scene", "settings", "version", "overrides", "blessed", "digest", "counts"][random.below(7)];
            let property = AnyValues::default().with_component::<sdk::components::Text>(name, [text]);
            chunks.log_static("/__properties/meldscope", &property);
        }
        4 => {
            let points = vec![[0.0f32; 3]; many.min(1_000_000)];
            let entity = ["/world/bodies/a/surface", "/world/bodies/none/surface", "/world/deforming/surface"];
            chunks.log(entity[random.below(3)], at(step), &sdk::Mesh3D::update_fields().with_vertex_positions(points));
        }
        5 => (0..few).for_each(|n| chunks.log(&format!("/world/bodies/{n}"), at(step), &sdk::Scalars::single(0.0))),
        6 => (0..few).for_each(|row| chunks.log("/timings/integrate", at(row as u64), &sdk::Scalars::single(0.0))),
        7 => {
            let bodies = Arc::new(UInt32Array::from(vec![1; many])) as ArrayRef;
            let floats = Arc::new(Float64Array::from(vec![0.0; many])) as ArrayRef;
            let states = AnyValues::default()
                .with_component_from_data("bodies", bodies)
                .with_component_from_data("displacements", floats);
            chunks.log(GOLDEN_STATES.path, at(step), &states);
        }
        _ => {
            let format = [f64::NAN, 1.0, 2.0, -0.0, 1e300][random.below(5)];
            let property = AnyValues::default().with_component::<sdk::components::Scalar>("format", [format]);
            chunks.log_static("/__properties/meldscope", &property);
        }
    }
    messages(&encoded(chunks))
}

/// Forges messages in one of many ways.
fn distort(messages: &mut Vec<Message>, random: &mut Random) {
    let of_chunks: Vec<usize> = (0..messages.len()).filter(|&i| messages[i].kind == 2).collect();
    let Some(&chosen) = of_chunks.get(random.below(of_chunks.len())) else { return };
    let (envelope, mut data) = unpacked_or_empty(&messages[chosen]);
    match random.below(12) {
        // uncompressed size, compression, and recording id
        0 => {
            let mut envelope = envelope;
            let field = random.below(envelope.len());
            if let Some((_, value)) = envelope.get_mut(field) {
                match value {
                    Ok(number) => *number = lie(random, *number),
                    Err(bytes) => mutate(bytes, random),
                }
            }
            messages[chosen].body = unfields(&envelope);
        }
        1 => {
            let zeros = [1 << 10, 1 << 20, 1 << 24, 1 << 27, 3 << 28][random.below(5)];
            messages[chosen] = repacked(&messages[chosen], &data, zeros);
        }
        // Arrow's own numbers, inside an intact envelope
        2..=5 => {
            let ranges = metadata(&data);
            if let Some(range) = ranges.get(random.below(ranges.len())) {
                for _ in 0..=random.below(2) {
                    let wide = if random.below(2) == 0 { 8 } else { 4 };
                    let at = range.start + random.below(range.len() / wide) * wide;
                    let Some(word) = data.get_mut(at..at + wide) else { continue };
                    let truth = word.iter().rev().fold(0, |n, &byte| n << 8 | u64::from(byte));
                    word.copy_from_slice(&lie(random, truth & 0xffff_ffff).to_le_bytes()[..wide]);
                }
            }
            messages[chosen] = repacked(&messages[chosen], &data, 0);
        }
        // the payload: offsets, ids, times, values
        6 | 7 => {
            let from = metadata(&data).last().map_or(0, |range| range.end);
            for _ in 0..=random.below(3) {
                let at = from + random.below((data.len() - from.min(data.len())) / 4) * 4;
                let Some(word) = data.get_mut(at..at + 4) else { continue };
                let truth = word.iter().rev().fold(0, |n, &byte| n << 8 | u64::from(byte));
                word.copy_from_slice(&(lie(random, truth) as u32).to_le_bytes());
            }
            messages[chosen] = repacked(&messages[chosen], &data, 0);
        }
        8 => {
            mutate(&mut data, random);
            messages[chosen] = repacked(&messages[chosen], &data, 0);
        }
        // the order, number and kind of messages
        9 => match random.below(4) {
            0 => {
                let other = random.below(messages.len());
                messages.swap(chosen, other);
            }
            1 => drop(messages.remove(chosen)),
            2 => {
                let message = messages[chosen].clone();
                let times = [1, 2, 500][random.below(3)].min(1 + (16 << 20) / message.body.len().max(1));
                messages.splice(chosen..chosen, std::iter::repeat_n(message, times));
            }
            _ => messages[chosen].kind = random.next() % 5,
        },
        // chunks that another program could have written
        _ => {
            let (envelope, _) = unpacked_or_empty(&messages[chosen]);
            let store = envelope.iter().find_map(|(field, value)| value.as_ref().err().filter(|_| *field == 1));
            let id = store.and_then(|store| {
                fields_or_none(store)?.into_iter().find_map(|(field, value)| value.err().filter(|_| field == 2))
            });
            let id = String::from_utf8(id.unwrap_or_default()).unwrap_or_default();
            let to = random.below(messages.len() + 1);
            messages.splice(to..to, strange(random, &id));
        }
    }
}

/// The message, or empty fields if an earlier corruption has made it unreadable.
fn unpacked_or_empty(message: &Message) -> (Fields, Vec<u8>) {
    let message = message.clone();
    catch_panic(move || unpacked(&message)).unwrap_or_default()
}

fn fields_or_none(bytes: &[u8]) -> Option<Fields> {
    let bytes = bytes.to_vec();
    catch_panic(move || fields(&bytes))
}

/// Runs `work`; `None` if it panics.
fn catch_panic<T>(work: impl FnOnce() -> T) -> Option<T> {
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(work)).ok()
}

/// Limits on the memory [bytes] and time for reading a recording.
const MAX_MEMORY: u64 = 1 << 30;
const MAX_TIME: Duration = Duration::from_secs(10);

#[test]
fn no_broken_structure_crashes_the_reader() {
    let dir = Dir::new();
    let corpus: Vec<Vec<Message>> = corpus(&dir).iter().map(|bytes| messages(bytes)).collect();
    let scene = Scene::parse(SCENE, "small").expect("a scene");
    let mut random = Random(0x0dd_c0ffee);
    let (mut runs, mut rejected, mut slowest, mut largest) = (0u64, 0u64, Duration::ZERO, 0);
    let path = dir.file("broken.rrd");
    for _ in cases(60) {
        let mut messages = corpus[random.below(corpus.len())].clone();
        for _ in 0..=random.below(3) {
            distort(&mut messages, &mut random);
        }
        let mut bytes = file(&messages);
        if random.below(10) == 0 {
            mutate(&mut bytes, &mut random);
        }
        fs::write(&path, &bytes).expect("disk space");
        let keep = |what: &str| {
            let kept = std::env::temp_dir().join("meldscope-broken.rrd");
            fs::write(&kept, &bytes).expect("disk space");
            panic!("after {runs} recordings, {}: {what}", kept.display());
        };
        let began = Clock::now();
        let mut outcome = None;
        let memory = allocation_counter::measure(|| outcome = catch_panic(|| read_and_replay(&path, &scene)));
        match outcome {
            Some(Ok(())) => {}
            Some(Err(error)) => {
                let text = error.to_string();
                assert!(!text.contains('\n') && text.contains("broken.rrd"), "{text}");
                rejected += 1;
            }
            None => keep("it brought the reader down"),
        }
        (slowest, largest) = (slowest.max(began.elapsed()), largest.max(memory.bytes_max));
        if began.elapsed() > MAX_TIME || memory.bytes_max > MAX_MEMORY {
            keep(&format!("it took {:?} and {} bytes", began.elapsed(), memory.bytes_max));
        }
        runs += 1;
    }
    println!("{runs} forged recordings, {rejected} rejected");
    println!("at most {slowest:.1?} and {:.0} MiB", largest as f64 / f64::from(1 << 20));
    assert!(runs > 20 && rejected > runs / 4, "{runs} {rejected}");
}

/// Highly compressible data does not justify large allocations: all-zero checksums, an empty scene, endless texts.
#[test]
fn claims_are_limited_by_the_size_of_the_recording() {
    let dir = Dir::new();
    let corpus = corpus(&dir);
    let thin = messages(&corpus[3]);
    let id = Recorded::open(&dir.file("thin.rrd")).map(|_| ()).and_then(|()| {
        let mut reader = Reader::open(&dir.file("thin.rrd"))?;
        while reader.next(|_| false)?.is_some() {}
        Ok(reader.id().expect("an id").to_owned())
    });
    let id = id.expect("a recording");
    let with = |chunks: chunks::Chunks| {
        let mut all = thin.clone();
        all.extend(messages(&encoded(chunks)));
        fs::write(dir.file("claims.rrd"), file(&all)).expect("disk space");
        let mut error = String::new();
        let start = Clock::now();
        let memory = allocation_counter::measure(|| {
            error = match Recorded::open(&dir.file("claims.rrd")) {
                Ok(_) => panic!("the false claim is not reported"),
                Err(found) => found.to_string(),
            };
        });
        assert!(start.elapsed() < MAX_TIME && memory.bytes_max < 400 << 20, "{error}: {} bytes", memory.bytes_max);
        error
    };
    let store = || chunks::Chunks::new(StoreId::new(StoreKind::Recording, "meldscope_small", id.as_str()));
    let at = |step: u64| Instant { step, time: step as f64 / 60.0 };

    // 80 and 8 MB of zeros
    for (count, what) in [(10_000_000, "unpack to"), (1_000_000, "checksums in")] {
        let mut chunks = store();
        let zeros = Arc::new(UInt64Array::from(vec![0; count])) as ArrayRef;
        let row = AnyValues::default().with_component_from_data("checksum", zeros);
        chunks.log("/checksum", at(30 + count as u64), &row);
        let error = with(chunks);
        assert!(error.contains(what), "{error}");
    }
    // a scene longer than the limit of scene files and their meshes, and one longer than the size of the recording justifies
    for (length, what) in [(65 << 20, "over the limit of 67108864"), (25 << 20, "over the limit of")] {
        let mut chunks = store();
        let mut text = String::from(SCENE);
        text.extend(std::iter::repeat_n('#', length));
        if length > 64 << 20 {
            // compresses badly
            let mut random = Random(3);
            text.extend((0..5 << 20).map(|_| char::from(b'!' + (random.next() % 64) as u8)));
        }
        let property = AnyValues::default().with_component::<sdk::components::Text>("scene", [text]);
        chunks.log_static("/__properties/meldscope", &property);
        let error = with(chunks);
        assert!(error.contains("its scene has") && error.contains(what), "{error}");
    }
    for name in ["settings", "version", "overrides", "machine", "blessed", "digest"] {
        let mut chunks = store();
        let text = "[".repeat(2 << 20);
        let property = AnyValues::default().with_component::<sdk::components::Text>(name, [text]);
        chunks.log_static("/__properties/meldscope", &property);
        let error = with(chunks);
        assert!(error.contains(&format!("its {name} has")), "{error}");
    }
}
