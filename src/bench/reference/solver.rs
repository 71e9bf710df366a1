//! The solution of a system: steps of extrapolation that end at every kink.
//!
//! A step is taken as if no kink were crossed. Where the path between its ends, by quintic Hermite interpolation,
//! crosses a kink, the step is taken again up to there, corrected by Newton's method on the step itself.

use glam::DVec3;

use super::{
    NoReference, PhaseChange,
    extrapolation::{Extrapolation, Start, Step},
    system::{Chunk, Kink, Link, Mode, Places, System, World, vector},
};
use crate::scene::Path;

/// A step no longer than this, relative to t or 1 s, is always accepted: only rounding errors remain.
const SHORTEST_STEP: f64 = 1e-12;
/// A kink this soon, relative to t or 1 s, is crossed at once: no step is taken up to it.
const AT_ONCE: f64 = 1e-14;
/// Upper limit on trial steps of any length, per longest step: far more than crossings and halvings need.
const TRIALS_PER_STEP: f64 = 200.0;
/// Margin that counts as none, as a fraction of the kink's scale: rounding.
const TIE: f64 = 1e-14;
/// Parts of a step between which the margins of kinks are looked at.
const PARTS: usize = 8;
/// Iterations of the root search in a step: halvings in the worst case.
const MAX_ITERATIONS: usize = 60;
/// Corrections of the time of a crossing.
const MAX_CORRECTIONS: usize = 6;
/// Margin up to which a kink counts as crossed by a step that ends at it, as a fraction of the kink's scale. The force
/// has a kink there but does not jump, so the effect is of the order of its square.
const CROSSED: f64 = 1e-11;
/// The same for thresholds, at which the force jumps: rounding.
const CROSSED_JUMP: f64 = 4.0 * f64::EPSILON;

/// The solution of a system.
pub(super) struct Track {
    /// Coordinates at the requested instants, `[instant][vertex]`.
    pub(super) coordinates: Vec<Vec<DVec3>>,
    /// Phase changes that were found on the way.
    pub(super) changes: Vec<PhaseChange>,
}

/// What a solution needs besides the system.
pub(super) struct Settings {
    /// Permitted errors of a step, for each coordinate of the state.
    pub(super) tolerances: Vec<f64>,
    /// [s]
    pub(super) longest_step: f64,
    /// A solution in which a vertex moves farther from rest is given up [scene unit].
    pub(super) leash: f64,
}

/// Solves a system over `chunks`; `None` if a vertex moves farther from rest than the leash.
pub(super) fn solve(
    system: &System<'_>,
    chunks: &[Chunk<'_>],
    settings: &Settings,
) -> Result<Option<Track>, NoReference> {
    let end = chunks.last().map_or(0.0, |chunk| chunk.end);
    let trials = TRIALS_PER_STEP * (chunks.len() as f64 + end / settings.longest_step);
    let mut solver = Solver {
        system,
        settings,
        state: system.initial(),
        slope: vec![0.0; 6 * system.len()],
        next: Vec::new(),
        next_slope: vec![0.0; 6 * system.len()],
        mode: Mode::default(),
        step: settings.longest_step,
        trials: trials as u64,
        extrapolation: Extrapolation::default(),
        from: World::default(),
        to: World::default(),
        scratch: World::default(),
        changes: Vec::new(),
    };
    let mut coordinates = Vec::new();
    for (index, chunk) in chunks.iter().enumerate() {
        solver.enter(chunk, index.checked_sub(1).map(|before| &chunks[before]));
        if !system.is_calm(chunk, &solver.state) {
            solver.advance(chunk)?;
        }
        let at = |i| vector(&solver.state, i);
        if settings.leash < f64::INFINITY && (0..system.len()).any(|i| !(at(i).length() <= settings.leash)) {
            return Ok(None);
        }
        if chunk.is_sample {
            coordinates.push((0..system.len()).map(at).collect());
        }
    }
    Ok(Some(Track { coordinates, changes: solver.changes }))
}

struct Solver<'s, 'a> {
    system: &'s System<'a>,
    settings: &'s Settings,
    state: Vec<f64>,
    /// Its rate.
    slope: Vec<f64>,
    /// The state at the end of a step …
    next: Vec<f64>,
    /// … and its rate.
    next_slope: Vec<f64>,
    mode: Mode,
    /// The next step size, unless something intervenes [s].
    step: f64,
    /// Remaining trial steps.
    trials: u64,
    extrapolation: Extrapolation,
    /// The world at the start of a step …
    from: World,
    /// … and at its end.
    to: World,
    scratch: World,
    changes: Vec<PhaseChange>,
}

impl Solver<'_, '_> {
    /// Prepares the state and the mode for a chunk.
    fn enter(&mut self, chunk: &Chunk<'_>, before: Option<&Chunk<'_>>) {
        if chunk.start > 0.0 {
            self.system.kick(chunk, &mut self.state);
        }
        self.system.place(chunk, chunk.start, &self.state, &mut self.scratch);
        let known = before.filter(|_| !chunk.is_jump).map(|before| (before, &self.mode));
        let names = |chunk: &Chunk<'_>, link: &Link| link.bodies.map(|body| chunk.bodies[body]);
        let phases = before.map(|before| {
            let known = before.links.iter().zip(&self.mode.links);
            known.map(|(link, side)| (names(before, link), side.phase)).collect::<Vec<_>>()
        });
        self.mode = self.system.mode(chunk, &self.scratch, known);
        // a jump leaves the phases of pairs with free bodies where they were, until they pass a threshold by it
        if let (true, Some(phases)) = (chunk.is_jump, phases) {
            for (index, link) in chunk.links.iter().enumerate().filter(|(_, link)| link.phase.is_none()) {
                let known = phases.iter().find(|(earlier, _)| *earlier == names(chunk, link));
                let Some(&(_, phase)) = known else { continue };
                self.mode.links[index] = self.system.sides_of(chunk, index, phase, &self.scratch, None);
                self.pass(chunk, index, chunk.start);
            }
        }
    }

    /// Changes the phase of a pair while it is beyond a threshold.
    fn pass(&mut self, chunk: &Chunk<'_>, index: usize, t: f64) {
        for _ in 0..3 {
            let link = &chunk.links[index];
            let q = self.system.q(chunk, link, &self.scratch);
            let mut transitions = link.law.thresholds.transitions(self.mode.links[index].phase);
            let passed = transitions.find(|change| if change.falling { q < change.level } else { q > change.level });
            let Some(transition) = passed else { break };
            let kink = Kink::Threshold { link: index, transition };
            self.system.cross(chunk, &mut self.mode, kink, &self.scratch);
            self.note(chunk, kink, t);
        }
    }

    /// Notes the change of a phase.
    fn note(&mut self, chunk: &Chunk<'_>, kink: Kink, time: f64) {
        if let Kink::Threshold { link, transition } = kink {
            let [a, b] = chunk.links[link].bodies.map(|body| chunk.bodies[body]);
            self.changes.push(PhaseChange { time, a: a.min(b), b: a.max(b), to: transition.to });
        }
    }

    /// Writes the rate of the present state.
    fn start(&mut self, chunk: &Chunk<'_>, t: f64) {
        self.system.slope(chunk, &self.mode, t, &self.state, &mut self.scratch, &mut self.slope);
    }

    /// Takes a trial step over `h` [s]; returns how well it went.
    fn trial(&mut self, chunk: &Chunk<'_>, t: f64, h: f64) -> Step {
        let Solver { system, mode, scratch, .. } = self;
        let mut slope = |t: f64, state: &[f64], slope: &mut [f64]| system.slope(chunk, mode, t, state, scratch, slope);
        let start = Start { t, y: &self.state, slope: &self.slope };
        self.extrapolation.step(&mut slope, start, h, &self.settings.tolerances, &mut self.next)
    }

    /// Integrates through one chunk.
    fn advance(&mut self, chunk: &Chunk<'_>) -> Result<(), NoReference> {
        let mut t = chunk.start;
        // kinks crossed since the last step that was worth the name
        let (mut turns, mut kinks) = (0, Vec::new());
        self.start(chunk, t);
        while t < chunk.end {
            let stuck = || NoReference::Stuck { body: self.system.body_of(0), time: t };
            // ends the loop even if crossings are only a rounding error apart or steps never grow
            self.trials = self.trials.checked_sub(1).ok_or_else(stuck)?;
            let left = chunk.end - t;
            let mut h = if self.step < left { self.step } else { left };
            let step = self.trial(chunk, t, h);
            if !step.is_accurate() {
                if h > SHORTEST_STEP * f64::max(1.0, t) {
                    self.step = 0.5 * h;
                    continue;
                } else if step.error.is_nan() {
                    let coordinate = self.next.iter().position(|value| !value.is_finite()).unwrap_or(0);
                    let particle = coordinate / 3 % self.system.len();
                    return Err(NoReference::TooLarge { body: self.system.body_of(particle), time: t });
                }
            }
            if step.is_easy() {
                self.step = f64::min(f64::max(self.step, 2.0 * h), self.settings.longest_step);
            }
            self.system.place(chunk, t, &self.state, &mut self.from);
            self.system.place(chunk, t + h, &self.next, &mut self.to);
            if turns > 2 * kinks.len() + 2 {
                // The state crosses kinks to and fro without progress: it touches one, or stays on one. It is assigned
                // to the side on which it is a little later.
                h /= 1024.0;
                self.trial(chunk, t, h);
                self.accept(chunk, &mut t, h);
                self.system.place(chunk, t, &self.state, &mut self.scratch);
                let phases: Vec<_> = self.mode.links.iter().map(|side| side.phase).collect();
                for (index, phase) in phases.into_iter().enumerate() {
                    self.mode.links[index] = self.system.sides_of(chunk, index, phase, &self.scratch, None);
                }
                self.start(chunk, t);
                turns = 0;
                continue;
            }
            kinks.clear();
            self.system.each_kink_near(chunk, &self.mode, [&self.from, &self.to], h, |kink| kinks.push(kink));
            let first = if kinks.is_empty() { None } else { self.first_crossing(chunk, &kinks, t, h) };
            let Some((kink, after)) = first else {
                self.accept(chunk, &mut t, h);
                self.start(chunk, t);
                turns = 0;
                continue;
            };
            let at_once = AT_ONCE * f64::max(1.0, t);
            if after > at_once {
                let taken = self.step_to(chunk, kink, t, after, h)?;
                turns = if taken > SHORTEST_STEP * f64::max(1.0, t) { 0 } else { turns + 1 };
                self.accept(chunk, &mut t, taken);
            } else {
                turns += 1;
            }
            self.system.place(chunk, t, &self.state, &mut self.scratch);
            self.cross(chunk, kink, &kinks, t);
            self.start(chunk, t);
        }
        Ok(())
    }

    /// Makes the end of the last trial step, over `h` [s], the present state.
    fn accept(&mut self, chunk: &Chunk<'_>, t: &mut f64, h: f64) {
        std::mem::swap(&mut self.state, &mut self.next);
        *t = if h < chunk.end - *t { *t + h } else { chunk.end };
    }

    /// Crosses a kink that the state has reached, and all others that it reaches at the same instant.
    fn cross(&mut self, chunk: &Chunk<'_>, kink: Kink, near: &[Kink], t: f64) {
        let others: Vec<Kink> = near
            .iter()
            .copied()
            .filter(|&other| {
                let limit = if other.is_jump() { CROSSED_JUMP } else { 0.1 * CROSSED };
                let margin = self.system.margin(chunk, &self.mode, other, &self.scratch).abs();
                margin <= limit * self.system.scale(chunk, other)
                    && self.system.margin_rate(chunk, &self.mode, other, &self.scratch) < 0.0
                    && other != kink
            })
            .collect();
        let is_jump = kink.is_jump();
        self.system.cross(chunk, &mut self.mode, kink, &self.scratch);
        self.note(chunk, kink, t);
        // a change of phase puts all kinks of the pair where they belong; those found before it no longer hold
        for other in others.into_iter().filter(|other| !is_jump && !other.is_jump()) {
            self.system.cross(chunk, &mut self.mode, other, &self.scratch);
        }
    }

    /// Takes the step from time `t` that ends at a kink, expected `after` [s] later, in a step of length `h` [s] that
    /// crosses it. Returns its length.
    fn step_to(&mut self, chunk: &Chunk<'_>, kink: Kink, t: f64, mut after: f64, h: f64) -> Result<f64, NoReference> {
        let limit = if kink.is_jump() { CROSSED_JUMP } else { CROSSED } * self.system.scale(chunk, kink);
        for _ in 0..MAX_CORRECTIONS {
            self.trials =
                self.trials.checked_sub(1).ok_or(NoReference::Stuck { body: self.system.body_of(0), time: t })?;
            self.trial(chunk, t, after);
            self.system.place(chunk, t + after, &self.next, &mut self.to);
            let margin = self.system.margin(chunk, &self.mode, kink, &self.to);
            let rate = self.system.margin_rate(chunk, &self.mode, kink, &self.to);
            let better = after - margin / rate;
            if margin.abs() <= limit || !(rate < 0.0 && better > 0.0 && better < h) || better == after {
                break;
            }
            after = better;
        }
        Ok(after)
    }

    /// The kink that is crossed first in the trial step of length `h` [s] from time `t` [s], and how long after its
    /// start.
    fn first_crossing(&mut self, chunk: &Chunk<'_>, kinks: &[Kink], t: f64, h: f64) -> Option<(Kink, f64)> {
        // `start` wrote the slope of the state; that of the end makes the interpolation
        self.system.slope(chunk, &self.mode, t + h, &self.next, &mut self.scratch, &mut self.next_slope);
        let n = 3 * self.system.len();
        let (states, slopes) = ([&*self.state, &*self.next], [&*self.slope, &*self.next_slope]);
        let mean = |body: usize| {
            let mean = |of: &[f64]| self.system.mean(body, of);
            let of_centre = || [states.map(mean), slopes.map(mean), slopes.map(|slope| mean(&slope[n..]))];
            self.system.is_free(chunk, body).then(of_centre)
        };
        let centres: Vec<_> = (0..chunk.bodies.len()).map(mean).collect();
        let between = Between { system: self.system, chunk, t, h, states, slopes, centres: &centres, theta: 0.0 };
        let mut first: Option<(Kink, f64)> = None;
        for &kink in kinks {
            let rates = [&self.from, &self.to].map(|world| self.system.margin_rate(chunk, &self.mode, kink, world));
            let tie = TIE * self.system.scale(chunk, kink);
            let margin = |theta: f64| self.system.margin(chunk, &self.mode, kink, &Between { theta, ..between });
            if let Some(theta) = crossing(margin, rates, tie)
                && first.is_none_or(|(_, first)| theta < first)
            {
                first = Some((kink, theta));
            }
        }
        first.map(|(kink, theta)| (kink, theta * h))
    }
}

/// The first place in [0, 1] at which a margin falls below zero, by more than `tie`; `rates` are its derivatives in
/// time at both ends.
fn crossing(margin: impl Fn(f64) -> f64, rates: [f64; 2], tie: f64) -> Option<f64> {
    let at = |k: usize| k as f64 / PARTS as f64;
    let samples: [f64; PARTS + 1] = std::array::from_fn(|k| margin(at(k)));
    let mut is_inside = samples[0] > 0.0;
    if !is_inside && samples[1] < -tie {
        if rates[0] < 0.0 {
            return Some(0.0); // it starts at the kink, and leaves to the other side
        }
        // it starts at the kink, and stays on this side for less than a part
        let (top, below) = minimum(&|theta| tie - margin(theta), 0.0, at(1));
        if below < 0.0 {
            return Some(root(&margin, (top, tie - below), (at(1), samples[1])));
        }
    }
    // whether the margin has a minimum near a sample
    let is_low = |k: usize| match k {
        0 => rates[0] < 0.0 && samples[0] <= samples[1],
        PARTS => rates[1] > 0.0 && samples[PARTS] <= samples[PARTS - 1],
        _ => samples[k] <= samples[k - 1] && samples[k] <= samples[k + 1],
    };
    for k in 1..=PARTS {
        if samples[k] < -tie {
            if is_inside {
                return Some(root(&margin, (at(k - 1), samples[k - 1]), (at(k), samples[k])));
            } else if k == PARTS {
                return Some(0.0); // it was assigned to the wrong side
            }
        } else if samples[k] > 0.0 {
            // a visit to the other side between two samples
            if is_inside && (is_low(k) || is_low(k - 1)) {
                let (low, least) = minimum(&margin, at(k - 1), at(k));
                if least < -tie {
                    return Some(root(&margin, (at(k - 1), samples[k - 1]), (low, least)));
                }
            }
            is_inside = true;
        }
    }
    None
}

/// The place and the value of the least value in an interval, by golden section.
fn minimum(f: &impl Fn(f64) -> f64, mut low: f64, mut high: f64) -> (f64, f64) {
    let share = 0.5 * (5f64.sqrt() - 1.0);
    let (mut a, mut b) = (high - share * (high - low), low + share * (high - low));
    let (mut f_a, mut f_b) = (f(a), f(b));
    for _ in 0..30 {
        if f_a < 0.0 || f_b < 0.0 {
            break;
        }
        if f_a < f_b {
            (high, b, f_b) = (b, a, f_a);
            a = high - share * (high - low);
            f_a = f(a);
        } else {
            (low, a, f_a) = (a, b, f_b);
            b = low + share * (high - low);
            f_b = f(b);
        }
    }
    if f_a < f_b { (a, f_a) } else { (b, f_b) }
}

/// The root of `f` between two places at which its values have opposite signs, by regula falsi, Illinois variant
/// (Dahlquist & Björck, Numerical Methods, section 6.2).
fn root(f: &impl Fn(f64) -> f64, low: (f64, f64), high: (f64, f64)) -> f64 {
    let ((mut low, mut f_low), (mut high, mut f_high)) = (low, high);
    let mut stayed = 0;
    for iteration in 0..MAX_ITERATIONS {
        let guess = low + (high - low) * (f_low / (f_low - f_high));
        let is_useful = guess > low && guess < high && iteration % 8 != 7;
        let middle = if is_useful { guess } else { 0.5 * (low + high) };
        if middle <= low || middle >= high {
            break;
        }
        let value = f(middle);
        if value == 0.0 {
            return middle;
        }
        if value > 0.0 {
            (low, f_low) = (middle, value);
            f_high *= if stayed > 0 { 0.5 } else { 1.0 };
            stayed = 1;
        } else {
            (high, f_high) = (middle, value);
            f_low *= if stayed < 0 { 0.5 } else { 1.0 };
            stayed = -1;
        }
    }
    high
}

/// The places within a step, by interpolation.
#[derive(Clone, Copy)]
struct Between<'s, 'a> {
    system: &'s System<'a>,
    chunk: &'s Chunk<'s>,
    t: f64,
    h: f64,
    states: [&'s [f64]; 2],
    slopes: [&'s [f64]; 2],
    /// Centre, its velocity and its acceleration at both ends, of free bodies.
    centres: &'s [Option<[[DVec3; 2]; 3]>],
    /// The instant, as a fraction of the step.
    theta: f64,
}

impl Between<'_, '_> {
    /// The quintic that has a value, its first and its second derivative at both ends.
    fn hermite(&self, value: [DVec3; 2], rate: [DVec3; 2], second: [DVec3; 2]) -> DVec3 {
        let (s, h) = (self.theta, self.h);
        let (v, w) = ([h * rate[0], h * rate[1]], [h * h * second[0], h * h * second[1]]);
        let d = value[1] - value[0];
        let cubic = 10.0 * d - 6.0 * v[0] - 4.0 * v[1] - 1.5 * w[0] + 0.5 * w[1];
        let quartic = -15.0 * d + 8.0 * v[0] + 7.0 * v[1] + 1.5 * w[0] - w[1];
        let quintic = 6.0 * d - 3.0 * (v[0] + v[1]) - 0.5 * (w[0] - w[1]);
        value[0] + s * (v[0] + s * (0.5 * w[0] + s * (cubic + s * (quartic + s * quintic))))
    }

    fn path(&self, path: &Path) -> DVec3 {
        super::system::on_path(path, self.chunk, self.t + self.theta * self.h).position
    }
}

impl Places for Between<'_, '_> {
    fn vertex(&self, particle: usize) -> DVec3 {
        let n = 3 * self.system.len();
        let x = self.hermite(
            self.states.map(|state| vector(state, particle)),
            self.slopes.map(|slope| vector(slope, particle)),
            self.slopes.map(|slope| vector(&slope[n..], particle)),
        );
        match self.system.prescribed(particle) {
            Some((path, rest)) => self.path(path) + rest + x,
            None => x,
        }
    }

    fn centre(&self, body: usize) -> DVec3 {
        match self.centres[body] {
            Some([value, rate, second]) => self.hermite(value, rate, second),
            None => self.path(self.system.path_of(self.chunk, body)),
        }
    }
}
