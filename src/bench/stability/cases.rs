//! The cases of the sweep: small scenes, generated from their numbers alone.

use std::{f64::consts::PI, fmt, fmt::Write as _};

use crate::{Scene, SceneError, random::Random};

/// Seed of all cases.
pub const SEED: u64 = 2006;

/// The setting that a case takes to its limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Axis {
    /// Δt from 1e-6 to 10 s.
    Step,
    /// ω from 0 to 1e6 rad/s.
    Omega,
    /// κ from 0 to 1e6 1/s, and around ω.
    Damping,
    /// α/ω² and β/ω² from 0 to 1e3.
    Influence,
    /// Radii from 1:1 to 1:1e4, both scalings.
    Sizes,
    /// Coincident centres, or centres passing through each other; vertices at centres and on rims.
    Coincident,
    /// Hundreds of overlapping bodies.
    Crowd,
    /// Positions up to 1e9.
    Far,
    /// ωΔt around every multiple of π up to 10π, undamped, inside an influence sphere at rest.
    Resonance,
    /// No influence: pushes and the body's own motion, which have a closed form.
    Free,
    /// Many events per step, fast bodies.
    Events,
    /// Everything combined.
    Mixed,
}

impl Axis {
    /// Each axis, its name in tables, and its number of cases in one [`Axis::CYCLE`].
    const SHARES: [(Axis, &'static str, u64); 12] = [
        (Axis::Step, "step", 4),
        (Axis::Omega, "omega", 4),
        (Axis::Damping, "damping", 5),
        (Axis::Influence, "influence", 4),
        (Axis::Sizes, "sizes", 4),
        (Axis::Coincident, "coincident", 3),
        (Axis::Crowd, "crowd", 1),
        (Axis::Far, "far", 3),
        (Axis::Resonance, "resonance", 1),
        (Axis::Free, "free", 5),
        (Axis::Events, "events", 2),
        (Axis::Mixed, "mixed", 4),
    ];
    /// The axes repeat after this many cases.
    const CYCLE: u64 = 40;

    /// The axis of a case, and its number on that axis.
    pub fn of(index: u64) -> (Axis, u64) {
        let (cycle, mut rest) = (index / Axis::CYCLE, index % Axis::CYCLE);
        for (axis, _, share) in Axis::SHARES {
            if rest < share {
                return (axis, cycle * share + rest);
            }
            rest -= share;
        }
        (Axis::Mixed, index) // unreachable: the counts add up to the cycle
    }

    /// Maximum number of integrator steps of a run over all vertices, so that every case terminates.
    pub fn most_substeps(self) -> u64 {
        if self == Axis::Resonance { 1_000_000 } else { 100_000 }
    }

    /// The name used in tables.
    pub fn name(self) -> &'static str {
        Axis::SHARES.iter().find(|(axis, ..)| *axis == self).map_or("", |(_, name, _)| name)
    }
}

/// A scene that is hard for integrators.
#[derive(Clone, Debug)]
pub struct Case {
    /// The number from which it is generated.
    pub index: u64,
    /// The setting it takes to its limits.
    pub axis: Axis,
    /// A short description with the relevant numbers.
    pub what: String,
    /// The scene; its source is the text of a scene file.
    pub scene: Scene,
}

impl Case {
    /// Generates the case with this number.
    ///
    /// # Errors
    /// The generated scene is invalid, which happens for no case.
    pub fn new(index: u64) -> Result<Case, SceneError> {
        let (axis, number) = Axis::of(index);
        let mut dice = Random::new(SEED ^ index.wrapping_mul(0xd134_2543_de82_ef95));
        dice.bits(); // small seeds begin alike
        let draft = draft(axis, number, &mut dice);
        let scene = Scene::parse(&draft.text(index), &format!("case-{index}.toml"))?;
        Ok(Case { index, axis, what: draft.what, scene })
    }
}

// --- random numbers -------------------------------------------------------------------------------------------------

/// Random settings.
trait Draw {
    fn between(&mut self, low: f64, high: f64) -> f64;
    fn chance(&mut self, one_in: u64) -> bool;
    fn scale(&mut self, low: f64, high: f64) -> f64;
    fn scale_or_zero(&mut self, low: f64, high: f64) -> f64;
    fn vector(&mut self, size: f64) -> Position;
}

impl Draw for Random {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        rounded(low + (high - low) * self.unit())
    }

    fn chance(&mut self, one_in: u64) -> bool {
        self.below(one_in) == 0
    }

    /// Log-uniform over the range, and sometimes exactly one of its limits.
    fn scale(&mut self, low: f64, high: f64) -> f64 {
        match self.below(10) {
            0 => low,
            1 => high,
            _ => rounded(libm::exp(libm::log(low) + (libm::log(high) - libm::log(low)) * self.unit())).clamp(low, high),
        }
    }

    fn scale_or_zero(&mut self, low: f64, high: f64) -> f64 {
        if self.chance(8) { 0.0 } else { self.scale(low, high) }
    }

    fn vector(&mut self, size: f64) -> Position {
        std::array::from_fn(|_| self.between(-size, size))
    }
}

/// Rounds to four significant digits, to keep scenes readable.
fn rounded(x: f64) -> f64 {
    format!("{x:.3e}").parse().unwrap_or(x)
}

// --- scenes ---------------------------------------------------------------------------------------------------------

type Position = [f64; 3];

/// A scene file under construction.
struct Draft {
    what: String,
    dt: f64,
    steps: u64,
    tolerance: Option<f64>,
    omega: f64,
    damping: f64,
    response: &'static str,
    alpha: f64,
    beta: f64,
    weight: &'static str,
    scaling: &'static str,
    merge_at: f64,
    split_at: f64,
    core_at: f64,
    apart: &'static str,
    bodies: Vec<BodyDraft>,
    pushes: Vec<PushDraft>,
}

struct BodyDraft {
    radius: f64,
    stacks: u64,
    slices: u64,
    motion: Motion,
}

enum Motion {
    Fixed(Position),
    Line { from: Position, velocity: Position },
    Sine { center: Position, amplitude: Position, frequency: f64, phase: f64 },
    Keyframes(Vec<(f64, Position)>),
}

struct PushDraft {
    body: usize,
    direction: Position,
    strength: f64,
    start: f64,
    duration: f64,
}

impl fmt::Display for Motion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Motion::Fixed(at) => write!(f, "{{ fixed = {at:?} }}"),
            Motion::Line { from, velocity } => write!(f, "{{ line = {{ from = {from:?}, velocity = {velocity:?} }} }}"),
            Motion::Sine { center, amplitude, frequency, phase } => write!(
                f,
                "{{ sine = {{ center = {center:?}, amplitude = {amplitude:?}, frequency = {frequency:?}, phase = {phase:?} }} }}"
            ),
            Motion::Keyframes(keys) => {
                let keys: Vec<[f64; 4]> = keys.iter().map(|&(t, [x, y, z])| [t, x, y, z]).collect();
                write!(f, "{{ keyframes = {keys:?} }}")
            }
        }
    }
}

impl Draft {
    /// A scene without bodies, with the defaults of a scene file or random choices.
    fn new(dice: &mut Random) -> Draft {
        Draft {
            what: String::new(),
            dt: dice.of(&[1.0 / 240.0, 1.0 / 60.0, 1.0 / 15.0]),
            steps: dice.of(&[50, 200, 600]),
            tolerance: None,
            omega: 12.0,
            damping: 1.5,
            response: dice.of(&["rigid", "inertial", "world"]),
            alpha: 100.0,
            beta: 60.0,
            weight: dice.of(&["linear", "linear", "linear", "wendland"]),
            scaling: dice.of(&["relative", "absolute"]),
            merge_at: 1.05,
            split_at: dice.of(&[1.05, 1.15]),
            core_at: dice.of(&[0.0, 0.0, 0.9]),
            apart: dice.of(&["repel", "repel", "none"]),
            bodies: vec![],
            pushes: vec![],
        }
    }

    fn duration(&self) -> f64 {
        self.dt * self.steps as f64
    }

    fn body(&mut self, dice: &mut Random, radius: f64, motion: Motion) {
        let (stacks, slices) = (2 + dice.below(3), 3 + dice.below(4));
        self.bodies.push(BodyDraft { radius, stacks, slices, motion });
    }

    /// Adds a body at the origin, one or two bodies that pass it, and sometimes a push.
    fn neighbours(&mut self, dice: &mut Random) {
        self.body(dice, 1.0, Motion::Fixed([0.0; 3]));
        for _ in 0..dice.of(&[1, 1, 2]) {
            let radius = dice.between(0.4, 1.0);
            let motion = self.passing(dice, 1.0 + radius);
            self.body(dice, radius, motion);
        }
        if dice.chance(3) {
            self.push(dice);
        }
    }

    /// A path near the origin, in units of `reach`.
    fn passing(&self, dice: &mut Random, reach: f64) -> Motion {
        // over the whole run, or on a scale of seconds
        let time = if dice.chance(2) { self.duration() } else { f64::max(self.duration(), 2.0) };
        let side = [0.0, dice.between(-0.5, 0.5) * reach, dice.between(-0.5, 0.5) * reach];
        let at = |x: f64| [x * reach, side[1], side[2]].map(rounded);
        match dice.below(4) {
            0 => Motion::Fixed(at(dice.between(0.2, 1.2))),
            1 => {
                let (from, to) = (dice.between(0.8, 1.5), dice.between(-1.2, 1.2));
                Motion::Line { from: at(from), velocity: [rounded((to - from) * reach / time), 0.0, 0.0] }
            }
            2 => Motion::Sine {
                center: at(dice.between(0.6, 1.2)),
                amplitude: [dice.between(0.1, 0.6) * reach, 0.0, dice.between(-0.2, 0.2) * reach].map(rounded),
                frequency: rounded(dice.between(0.5, 4.0) / time),
                phase: dice.between(-PI, PI),
            },
            _ => {
                let keys = 2 + dice.below(4);
                let key =
                    |k: u64, dice: &mut Random| (k as f64 * rounded(time / keys as f64), at(dice.between(0.3, 1.4)));
                Motion::Keyframes((0..=keys).map(|k| key(k, dice)).collect())
            }
        }
    }

    fn push(&mut self, dice: &mut Random) {
        let duration = self.duration();
        self.pushes.push(PushDraft {
            body: dice.below(self.bodies.len() as u64) as usize,
            direction: dice.of(&[[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [1.0, -2.0, 0.5]]),
            strength: dice.scale(1.0, 100.0),
            start: rounded(duration * dice.unit()),
            duration: rounded(duration * dice.unit()),
        });
    }

    fn shift(&mut self, by: Position) {
        let add = |at: &mut Position| *at = std::array::from_fn(|i| at[i] + by[i]);
        for body in &mut self.bodies {
            match &mut body.motion {
                Motion::Fixed(at) | Motion::Line { from: at, .. } | Motion::Sine { center: at, .. } => add(at),
                Motion::Keyframes(keys) => keys.iter_mut().for_each(|(_, at)| add(at)),
            }
        }
    }

    fn text(&self, index: u64) -> String {
        let mut text = String::new();
        // writing to a string cannot fail
        let _ = write!(
            text,
            "# {}\nname = \"case-{index}\"\ndt = {:?}\nduration = {:?}\n{}\n\
             [material]\nomega = {:?}\ndamping = {:?}\nresponse = {:?}\n\n\
             [influence]\nalpha = {:?}\nbeta = {:?}\nweight = {:?}\nscaling = {:?}\n\
             merge_at = {:?}\nsplit_at = {:?}\ncore_at = {:?}\napart = {:?}\n",
            self.what,
            self.dt,
            self.duration(),
            self.tolerance.map_or(String::new(), |tolerance| format!("tolerance = {tolerance:?}\n")),
            self.omega,
            self.damping,
            self.response,
            self.alpha,
            self.beta,
            self.weight,
            self.scaling,
            self.merge_at,
            self.split_at,
            self.core_at,
            self.apart,
        );
        for (k, BodyDraft { radius, stacks, slices, motion }) in self.bodies.iter().enumerate() {
            let _ = write!(
                text,
                "\n[[body]]\nname = \"b{k}\"\nradius = {radius:?}\n\
                 shape = {{ sphere = {{ stacks = {stacks}, slices = {slices} }} }}\nmotion = {motion}\n"
            );
        }
        for PushDraft { body, direction, strength, start, duration } in &self.pushes {
            let _ = write!(
                text,
                "\n[[push]]\nbody = \"b{body}\"\ndirection = {direction:?}\nstrength = {strength:?}\n\
                 start = {start:?}\nduration = {duration:?}\n"
            );
        }
        text
    }
}

fn draft(axis: Axis, number: u64, dice: &mut Random) -> Draft {
    let mut draft = Draft::new(dice);
    match axis {
        Axis::Step => {
            draft.dt = dice.scale(1e-6, 10.0);
            draft.neighbours(dice);
            draft.what = format!("dt {:e} s", draft.dt);
        }
        Axis::Omega => {
            draft.dt = dice.scale(1e-4, 1.0);
            draft.omega = dice.scale_or_zero(1e-3, 1e6);
            draft.damping = dice.of(&[0.0, 1.5]);
            draft.neighbours(dice);
            draft.what = format!("omega {:e}, dt {:e} s", draft.omega, draft.dt);
        }
        Axis::Damping => {
            draft.dt = dice.scale(1e-4, 10.0);
            draft.omega = dice.of(&[12.0, 12.0, 0.1, 1e3]);
            draft.damping = if dice.chance(2) {
                dice.scale_or_zero(1e-3, 1e6)
            } else {
                // slightly above or below critical damping
                draft.omega * (1.0 + dice.of(&[0.0, 1e-15, 1e-12, 1e-8, 1e-4, 1e-2]) * dice.of(&[-1.0, 1.0]))
            };
            draft.neighbours(dice);
            draft.what =
                format!("damping {:e} (omega {:+e}), dt {:e} s", draft.damping, draft.damping - draft.omega, draft.dt);
        }
        Axis::Influence => {
            draft.omega = dice.scale(1.0, 1e3);
            draft.damping = draft.omega * dice.of(&[0.0, 0.1, 1.0]);
            draft.dt = rounded(dice.scale(1e-2, 10.0) / draft.omega);
            let strength = |dice: &mut Random| rounded(draft.omega * draft.omega * dice.scale_or_zero(1e-3, 1e3));
            (draft.alpha, draft.beta) = (strength(dice), strength(dice));
            draft.neighbours(dice);
            let per = draft.omega * draft.omega;
            let (alpha, beta) = (draft.alpha / per, draft.beta / per);
            draft.what = format!("alpha {alpha:.1e} w2, beta {beta:.1e} w2, omega dt {:.2}", draft.omega * draft.dt);
        }
        Axis::Sizes => {
            let ratio = dice.scale(1.0, 1e4);
            let small = 1.0 / ratio;
            draft.body(dice, 1.0, Motion::Fixed([0.0; 3]));
            let motion = draft.passing(dice, 1.0 + small);
            draft.body(dice, small, motion);
            if dice.chance(3) {
                draft.bodies.swap(0, 1);
            }
            draft.what = format!("radii 1:{ratio:.0}, {}", draft.scaling);
        }
        Axis::Coincident => {
            // Vertices lie on the x axis, so that the centre of one body meets a vertex or a rim of another.
            let offset = dice.of(&[0.0, 0.0, 1e-300, 1e-15, 1.0, 2f64.sqrt(), 2f64.sqrt() - 1.0, 1.0 + 2f64.sqrt()]);
            let radius = dice.of(&[1.0, 1.0, 0.5]);
            draft.body(dice, 1.0, Motion::Fixed([0.0; 3]));
            let motion = match dice.below(3) {
                0 => Motion::Fixed([offset, 0.0, 0.0]),
                // through the centre, in the middle of a step or at its end
                1 => {
                    let back = dice.of(&[0.5, 1.0]) + (draft.steps / 2) as f64;
                    Motion::Line { from: [-0.1 * back, 0.0, 0.0], velocity: [0.1 / draft.dt, 0.0, 0.0] }
                }
                _ => Motion::Sine {
                    center: [0.0; 3],
                    amplitude: [offset.max(0.2), 0.0, 0.0],
                    frequency: rounded(1.0 / draft.duration()),
                    phase: 0.0,
                },
            };
            draft.body(dice, radius, motion);
            if dice.chance(2) {
                draft.body(dice, 1.0, Motion::Fixed([0.0; 3]));
            }
            draft.damping = dice.of(&[0.0, 1.5]);
            // sometimes the pair is exactly on a threshold
            (draft.merge_at, draft.split_at) =
                dice.of(&[(1.05, 1.15), (offset.max(0.5) / (1.0 + radius), offset.max(0.5) / (1.0 + radius))]);
            draft.core_at = dice.of(&[0.0, 0.25 / (1.0 + radius)]);
            draft.what = format!("{} bodies, centres {offset:e} apart", draft.bodies.len());
        }
        Axis::Crowd => {
            let (count, dt) =
                [(100, 1.0 / 240.0), (150, 1e-3), (100, 1e-2), (200, 1e-3), (300, 1e-3)][(number % 5) as usize];
            for _ in 0..count {
                let (radius, at) = (dice.between(0.5, 1.0), dice.vector(0.5));
                let motion = match dice.below(4) {
                    0 => Motion::Line { from: at, velocity: dice.vector(1.0) },
                    _ => Motion::Fixed(at),
                };
                draft.bodies.push(BodyDraft { radius, stacks: 2, slices: 3, motion });
            }
            (draft.steps, draft.dt) = (if count <= 150 { 4 } else { 2 }, dt);
            draft.damping = dice.of(&[0.0, 1.5]);
            draft.what = format!("{count} bodies, all overlapping, dt {:.4} s", draft.dt);
        }
        Axis::Far => {
            let far = dice.scale(1e3, 1e9);
            draft.neighbours(dice);
            draft.shift(dice.of(&[[far, 0.0, 0.0], [far, -far, far], [-far, 0.0, far]]));
            if dice.chance(4) {
                // one body arrives from afar, another leaves
                let speed = rounded(far / draft.duration());
                for (from, velocity) in [(-2.0 * far, speed), (far, -speed)] {
                    let [from, velocity] = [[from, 0.0, 0.5], [velocity, 0.0, 0.0]];
                    draft.body(dice, 1.0, Motion::Line { from, velocity });
                }
            }
            draft.what = format!("{far:.1e} from the origin, {} bodies", draft.bodies.len());
        }
        Axis::Resonance => {
            let multiple = 1 + number % 10;
            let off = [0.0, 1e-9, -1e-9, 1e-6, -1e-6, 1e-3, -1e-3][(number / 10 % 7) as usize];
            draft.omega = dice.of(&[1.0, 12.0, 300.0]);
            draft.damping = 0.0;
            draft.dt = multiple as f64 * PI * (1.0 + off) / draft.omega;
            draft.steps = 2_000;
            // per unit of the oscillator's time, in which all these cases are equal
            draft.tolerance = Some(1e-6 * draft.omega);
            let part = dice.between(0.05, 0.5);
            (draft.alpha, draft.beta) = (part * draft.omega * draft.omega, part * draft.omega * draft.omega);
            // one vertex of each body, a pole, is inside the other's sphere
            (draft.merge_at, draft.split_at) = dice.of(&[(1.05, 1.15), (0.5, 0.5)]);
            draft.core_at = 0.0;
            draft.apart = "repel";
            let aside = dice.between(0.0, 0.3);
            for at in [[0.0; 3], [aside, 0.0, dice.between(1.7, 2.0)]] {
                draft.bodies.push(BodyDraft { radius: 1.0, stacks: 2, slices: 3, motion: Motion::Fixed(at) });
            }
            draft.what = format!("omega dt = {multiple} pi (1 {off:+e}), alpha {part} w2, omega {}", draft.omega);
        }
        Axis::Free => {
            draft.dt = dice.scale(1e-6, 10.0);
            draft.omega = dice.scale_or_zero(1e-3, 1e6);
            draft.damping = match dice.below(3) {
                0 => 0.0,
                1 => dice.scale(1e-3, 1e6),
                _ => draft.omega * (1.0 + dice.of(&[0.0, 1e-12, 1e-8, 1e-4, 1e-2]) * dice.of(&[-1.0, 1.0])),
            };
            let motion = match dice.below(4) {
                0 | 1 => Motion::Fixed([0.0; 3]),
                2 => Motion::Line { from: [0.0; 3], velocity: dice.vector(3.0) },
                _ => Motion::Sine {
                    center: [0.0; 3],
                    amplitude: dice.vector(1.0),
                    frequency: rounded(dice.scale(1e-2, 3.0) / draft.dt / 10.0),
                    phase: dice.between(-PI, PI),
                },
            };
            let kind = match &motion {
                Motion::Fixed(_) => "pushed",
                Motion::Line { .. } => "on a line",
                _ => "on a sine",
            };
            if matches!(motion, Motion::Line { .. }) {
                draft.response = "world";
            }
            draft.body(dice, 1.0, motion);
            if kind == "pushed" || dice.chance(2) {
                draft.push(dice);
            }
            draft.what = format!("{kind}: omega {:e}, damping {:e}, dt {:e} s", draft.omega, draft.damping, draft.dt);
        }
        Axis::Events => {
            draft.dt = dice.scale(1e-2, 10.0);
            draft.steps = 50;
            let per_step = dice.scale(0.5, 20.0);
            draft.body(dice, 1.0, Motion::Fixed([0.0; 3]));
            let motion = Motion::Sine {
                center: [dice.of(&[1.0, 2.0, 2.2]), 0.0, dice.between(0.0, 0.5)],
                amplitude: [dice.scale(0.1, 1e4), 0.0, 0.0],
                frequency: rounded(per_step / draft.dt),
                phase: dice.between(-PI, PI),
            };
            draft.body(dice, 1.0, motion);
            draft.response = dice.of(&["rigid", "inertial"]);
            draft.what = format!("{per_step} turns a step, dt {:e} s", draft.dt);
        }
        Axis::Mixed => {
            draft.dt = dice.scale(1e-6, 10.0);
            draft.omega = dice.scale_or_zero(1e-3, 1e6);
            draft.damping = dice.scale_or_zero(1e-3, 1e6);
            let stiff = if draft.omega > 0.0 { draft.omega * draft.omega } else { 144.0 };
            draft.alpha = rounded(stiff * dice.scale_or_zero(1e-3, 1e3));
            draft.beta = rounded(stiff * dice.scale_or_zero(1e-3, 1e3));
            draft.neighbours(dice);
            let small = dice.scale(1e-4, 1.0);
            for body in draft.bodies.iter_mut().skip(1) {
                body.radius = rounded(body.radius * small);
            }
            draft.what = format!(
                "omega {:e}, damping {:e}, alpha {:.1e} w2, beta {:.1e} w2, dt {:e} s",
                draft.omega,
                draft.damping,
                draft.alpha / stiff,
                draft.beta / stiff,
                draft.dt
            );
        }
    }
    draft
}
