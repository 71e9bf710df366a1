//! Random valid scenes: recorded in every way, they do not panic and replay to the same bits.

use std::{fmt::Write, fs, time::Instant};

use meldscope::{
    Scene,
    recording::{
        Recorded,
        replay::{self, Verdict},
    },
    stream::{
        self, RecordError, Settings,
        settings::{Detail, Entities, Frames, Trigger},
        sinks::Destinations,
    },
};

use crate::recording::Dir;

/// Pseudo-random numbers (xorshift64*).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }

    fn below(&mut self, n: usize) -> usize {
        (self.next() >> 33) as usize % n
    }

    fn one_in(&mut self, n: usize) -> bool {
        self.below(n) == 0
    }

    fn of<T: Copy>(&mut self, values: &[T]) -> T {
        values[self.below(values.len())]
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// A vector of TOML with components between -size and size.
    fn vector(&mut self, size: f64) -> String {
        format!("{:?}", [(); 3].map(|()| self.between(-size, size)))
    }
}

fn motion(random: &mut Random, may_be_free: bool) -> String {
    let at = random.vector(3.0);
    match random.below(6) {
        0 | 1 if may_be_free => format!(
            "free = {{ from = {at}, velocity = {}, spin = {}, rotation = \"{}\" }}",
            random.vector(6.0),
            random.vector(4.0),
            random.of(&["free", "fixed"])
        ),
        2 => {
            let frequency = 10f64.powf(random.between(-1.0, 1.3));
            format!("sine = {{ center = {at}, amplitude = {}, frequency = {frequency:?} }}", random.vector(3.0))
        }
        3 => format!("line = {{ from = {at}, velocity = {} }}", random.vector(9.0)),
        4 => format!("fixed = {at}"),
        _ => {
            let mut time = 0.0;
            let keys = [(); 4].map(|()| {
                let key = format!("[{time:?}, {}", &random.vector(3.0)[1..]);
                time += random.between(0.05, 0.4);
                key
            });
            let interpolation = random.of(&["spline", "linear", "hold"]);
            format!("keyframes = {{ keys = [{}], interpolation = \"{interpolation}\" }}", keys.join(", "))
        }
    }
}

/// A scene of a few bodies, of which most come near each other or a plane within a second.
fn scene(random: &mut Random) -> String {
    let mut text = format!("duration = {:?}\n", random.between(0.2, 0.6));
    let model = random.of(&["oscillators", "oscillators", "oscillators", "metaballs", "lattice", "fem"]);
    let integrator = random.of(&["exponential", "exponential", "exponential", "thesis", "verlet", "rk4"]);
    let tolerance = random.of(&["1e-3", "1e-5", "1e-6"]);
    writeln!(text, "model = \"{model}\"\nintegrator = \"{integrator}\"\ntolerance = {tolerance}").unwrap();
    writeln!(text, "gravity = [0, 0, {}]", random.of(&[0, 0, -10, -40])).unwrap();
    let (weight, apart) = (random.of(&["linear", "wendland"]), random.of(&["repel", "none"]));
    writeln!(text, "[influence]\nweight = \"{weight}\"\napart = \"{apart}\"").unwrap();
    let core = random.of(&["core_at = 0", "core_at = 0.8", "core_at = 0.8\ncore_width = 0.3"]);
    writeln!(text, "{core}").unwrap();
    writeln!(text, "[lattice]\ncells = 3\ntear = \"{}\"\n[fem]\ncells = 3", random.of(&["none", "cut", "split"]))
        .unwrap();
    for _ in 0..random.of(&[0, 0, 1, 2]) {
        let normal = format!("[{:?}, {:?}, 1]", random.between(-0.3, 0.3), random.between(-0.3, 0.3));
        let (stiffness, friction) = (random.of(&[400, 4000, 50_000]), random.of(&[0.0, 0.4]));
        let offset = random.between(-4.0, -1.0);
        writeln!(
            text,
            "[[plane]]\nnormal = {normal}\noffset = {offset:?}\nstiffness = {stiffness}\nfriction = {friction}"
        )
        .unwrap();
    }
    let count = random.of(&[1, 2, 2, 3, 4, 5]);
    for body in 0..count {
        let motion = motion(random, model != "metaballs");
        let response = match motion.starts_with("free") {
            true => "inertial",
            false => random.of(&["rigid", "inertial", "world"]),
        };
        let radius = 10f64.powf(random.between(-0.7, 0.4));
        let shape = format!("stacks = {}, slices = {}", random.of(&[4, 6, 8]), random.of(&[6, 12]));
        writeln!(
            text,
            "[[body]]\nname = \"b{body}\"\nradius = {radius:?}\nresponse = \"{response}\"\ngroup = \"g{}\"\n\
             shape = {{ sphere = {{ {shape} }} }}\nmotion = {{ {motion} }}",
            body % 2
        )
        .unwrap();
    }
    if random.one_in(4) {
        writeln!(
            text,
            "[[grid]]\nname = \"grid\"\ncount = [3, 2, 1]\nspacing = [1.2, 1.2, 1.2]\njitter = 0.2\nradius = 0.5\n\
             shape = {{ sphere = {{ stacks = 4, slices = 6 }} }}\nmotion = {{ fixed = {} }}",
            random.vector(2.0)
        )
        .unwrap();
    }
    if count > 1 && random.one_in(3) {
        let merge_at = random.between(0.6, 1.4);
        writeln!(
            text,
            "[[pair]]\nbodies = [\"b0\", \"b1\"]\nmerge_at = {merge_at:?}\nsplit_at = {:?}\ncore_at = 0.5\nalpha = 300.0",
            merge_at + random.of(&[0.0, 0.1])
        )
        .unwrap();
    }
    for _ in 0..random.of(&[0, 0, 1, 3, 30]) {
        let body = random.below(count);
        let (start, lasts) = (random.between(0.0, 0.4), random.between(0.001, 0.3));
        writeln!(
            text,
            "[[push]]\nbody = \"b{body}\"\ndirection = {}\nstrength = {:?}\nstart = {start:?}\nduration = {lasts:?}",
            random.vector(1.0),
            random.between(1.0, 90.0)
        )
        .unwrap();
    }
    text
}

fn settings(random: &mut Random, own: Settings) -> Settings {
    let detail = random.of(&[Detail::Surface, Detail::Forces, Detail::Stages { from: 3, to: 12 }]);
    let kept = |on| Frames::Last { most: 5, on, after: 3 };
    let frames = match random.below(6) {
        0 => Frames::Thin,
        1 => kept(vec![Trigger::Event("merge".to_owned()), Trigger::Diverge]),
        2 => kept(vec![]),
        _ => Frames::All,
    };
    let entities = random.of(&[Entities::Body, Entities::Body, Entities::Batch]);
    Settings { detail, entities, frames, every: random.of(&[1, 1, 4]), ..own }
}

/// How long fuzzers run [s], if `MELDSCOPE_FUZZ_SECONDS` says so.
pub fn fuzz_seconds() -> Option<f64> {
    std::env::var("MELDSCOPE_FUZZ_SECONDS").ok().and_then(|text| text.parse().ok())
}

/// The cases of a fuzzer: the first `count`, the same on every machine, or as many as fit into [`fuzz_seconds`].
pub fn cases(count: u64) -> impl Iterator<Item = u64> {
    let (start, seconds) = (Instant::now(), fuzz_seconds());
    (0..).take_while(move |&case| seconds.map_or(case < count, |seconds| start.elapsed().as_secs_f64() < seconds))
}

#[test]
fn random_scenes_are_recorded_and_replayed() {
    let (dir, mut random) = (Dir::new(), Random(0x853c_49e6_748f_ea9b));
    let (mut scenes, mut failed, mut refused, mut steps) = (0, 0, 0, 0);
    let path = dir.file("random.rrd");
    for number in cases(60) {
        scenes += 1;
        let text = scene(&mut random);
        let kept = std::env::temp_dir().join("meldscope-random.toml");
        fs::write(&kept, &text).expect("disk space");
        let scene = Scene::parse(&text, "random.toml").unwrap_or_else(|error| panic!("{error}\n{text}"));
        let settings = settings(&mut random, Settings::of(&scene));
        let destinations = Destinations { save: Some(path.clone()), ..Destinations::default() };
        match stream::record(&scene, settings, &destinations) {
            Ok(_) => {}
            Err(RecordError::Start(_)) => {
                refused += 1; // the model does not support the scene
                continue;
            }
            Err(error) => panic!("{number}: {error}\n{text}"),
        }
        let recorded = Recorded::open(&path).unwrap_or_else(|error| panic!("{number}: {error}\n{text}"));
        steps += recorded.checksums.len();
        failed += usize::from(recorded.failure.is_some());
        let verdict = replay::verify(&recorded, |_| true).expect("it runs");
        assert_eq!(verdict, Verdict::Identical, "{number}\n{text}");
    }
    println!("{scenes} random scenes of {steps} steps, {failed} of them ended with a failure, {refused} were refused");
}
