//! Numbers over time: what the state is like, and what it cost.

use std::time::{Duration, Instant as Clock};

use rerun::Scalars;

use super::Look;
use crate::{
    sim::Stage,
    stream::{
        chunks::{Chunks, Track},
        columns::Cell,
        instant::Instant,
        palette,
        series::{LineId, Series, Shape},
        step::Step,
    },
};

/// The stages in `/timings`: those of a step, then what looking at it costs the simulation, then what recording costs
/// on a thread of its own.
pub const TIMINGS: [&str; 7] =
    [Stage::ALL[0].name(), Stage::ALL[1].name(), Stage::ALL[2].name(), "observe", "wait", "extract", "log"];

/// What a stage took in most frames [ms], in the order of [`TIMINGS`]; `None` if there were no frames.
pub type Typical = [Option<f64>; TIMINGS.len()];

/// Steps per second since the last frame.
pub const SPEED: &str = "/timings/speed";
/// How far a run that keeps to real time is behind it.
pub const LAG: &str = "/timings/lag";

/// The entities in `/diagnostics`, what their lines are called, and how they are drawn.
const DIAGNOSTICS: [(&str, &str, Shape); 6] = [
    ("energy", "energy [unit²/s²]", Shape::Linear),
    ("max_displacement", "largest displacement [radii]", Shape::Linear),
    ("reached_vertices", "vertices inside a sphere", Shape::Step),
    ("substeps", "steps of the integrator", Shape::Step),
    ("estimated_error", "estimated error of the step [radii]", Shape::Step),
    ("sleeping_bodies", "bodies at rest", Shape::Step),
];

/// What adds up between frames.
pub struct Numbers {
    diagnostics: [LineId; DIAGNOSTICS.len()],
    timings: [Track; TIMINGS.len()],
    spread: [Spread; TIMINGS.len()],
    /// Since messages were last sent, and what that took a step.
    steps_since_sent: u32,
    sending: Duration,
    /// Since the last frame.
    steps: u32,
    spent: [Duration; TIMINGS.len()],
    substeps: u64,
    error: f64,
    /// When the last step ended, and the one before the last frame.
    end: Option<Clock>,
    last_frame: Option<Clock>,
    speed: Track,
    lag: Option<Duration>,
    lag_track: Track,
}

impl Numbers {
    /// Logs what the lines are called.
    pub fn new(series: &mut Series, chunks: &mut Chunks) -> Numbers {
        let mut i = 0;
        let timings = TIMINGS.map(|stage| {
            let entity = format!("/timings/{stage}");
            Series::style(chunks, &entity, &format!("{stage} [ms]"), palette::line(i), 1.5, Shape::Step);
            i += 1;
            chunks.track(&entity, [Scalars::descriptor_scalars()])
        });
        i = 0;
        let diagnostics = DIAGNOSTICS.map(|(name, label, shape)| {
            let entity = format!("/diagnostics/{name}");
            Series::style(chunks, &entity, label, palette::line(i), 1.5, shape);
            i += 1;
            series.line(chunks, &entity, shape)
        });
        let speed = line_of_run(SPEED, "steps per second", 0, chunks);
        Numbers {
            diagnostics,
            timings,
            spread: Default::default(),
            steps_since_sent: 0,
            sending: Duration::ZERO,
            steps: 0,
            spent: Default::default(),
            substeps: 0,
            error: 0.0,
            end: None,
            last_frame: None,
            speed,
            lag: None,
            lag_track: line_of_run(LAG, "behind real time [ms]", 1, chunks),
        }
    }

    /// Adds a step.
    pub fn add(&mut self, step: &Step) {
        let report = &step.report;
        self.steps += 1;
        self.steps_since_sent += 1;
        self.end = Some(step.end);
        self.lag = step.lag;
        for (sum, spent) in self.spent.iter_mut().zip(report.timings.into_iter().chain([step.observing, step.waiting]))
        {
            *sum += spent;
        }
        self.substeps += report.substeps;
        self.error = self.error.max(report.error);
    }

    /// Adds what bringing messages to their destinations took: spread over the steps from which they came.
    pub fn add_sending(&mut self, time: Duration) {
        self.sending = time / std::mem::take(&mut self.steps_since_sent).max(1);
    }

    /// Adds what recording took since the last frame.
    pub fn add_recording(&mut self, extracting: Duration, logging: Duration) {
        let [.., extract, log] = &mut self.spent;
        *extract += extracting;
        *log += logging;
    }

    /// What the state is like.
    pub fn log_diagnostics(&mut self, look: Look<'_>, series: &mut Series, chunks: &mut Chunks) {
        let Look { scene, snapshot, at } = look;
        let energy = snapshot.energy(scene);
        let displacement = snapshot.bodies(scene).map(|body| body.max_displacement() / body.scene().radius);
        let values = [
            energy.total(),
            displacement.fold(0.0, f64::max),
            energy.reached_vertices as f64,
            std::mem::take(&mut self.substeps) as f64,
            std::mem::take(&mut self.error),
            snapshot.bodies(scene).filter(|body| body.is_at_rest()).count() as f64,
        ];
        for (&line, value) in self.diagnostics.iter().zip(values) {
            series.log(chunks, line, value, at);
        }
    }

    /// What stages took in all frames but the slowest tenth.
    pub fn typical_timings(&self) -> Typical {
        self.spread.each_ref().map(|spread| spread.quantile(0.9))
    }

    /// Milliseconds per step since the last frame.
    pub fn log_timings(&mut self, at: Instant, chunks: &mut Chunks) {
        let steps = std::mem::take(&mut self.steps);
        let mut spent = std::mem::take(&mut self.spent);
        if steps == 0 {
            return;
        }
        let [.., log] = &mut spent;
        *log += self.sending * steps;
        for ((&track, spread), spent) in self.timings.iter().zip(&mut self.spread).zip(spent) {
            let milliseconds = 1e3 * spent.as_secs_f64() / f64::from(steps);
            spread.add(milliseconds);
            chunks.push_apart(track, at, &[Cell::Scalars(&[milliseconds])]);
        }
        if let (Some(last), Some(end)) = (self.last_frame, self.end) {
            let speed = f64::from(steps) / (end - last).as_secs_f64().max(1e-9);
            chunks.push_apart(self.speed, at, &[Cell::Scalars(&[speed])]);
        }
        self.last_frame = self.end;
        if let Some(lag) = self.lag {
            chunks.push_apart(self.lag_track, at, &[Cell::Scalars(&[1e3 * lag.as_secs_f64()])]);
        }
    }
}

/// How often a number of which size came: to an eighth of an octave, from 2^-24 to 2^16.
#[derive(Default)]
struct Spread {
    counts: Vec<u64>,
    all: u64,
}

impl Spread {
    /// Buckets of an octave, by the first bits of a mantissa, and of them those that are smaller than any that is counted.
    const BITS: u32 = 3;
    const FIRST: usize = (1023 - 24) << Spread::BITS;
    const BUCKETS: usize = 40 << Spread::BITS;

    fn add(&mut self, number: f64) {
        self.counts.resize(Spread::BUCKETS, 0);
        let bucket = (number.max(0.0).to_bits() >> (52 - Spread::BITS)) as usize;
        self.counts[bucket.saturating_sub(Spread::FIRST).min(Spread::BUCKETS - 1)] += 1;
        self.all += 1;
    }

    /// What this share of the numbers does not exceed, rounded up to a bucket.
    fn quantile(&self, share: f64) -> Option<f64> {
        let wanted = (share * self.all as f64).ceil() as u64;
        let mut seen = 0;
        let bucket = self.counts.iter().position(|&count| {
            seen += count;
            seen >= wanted && seen > 0
        })?;
        Some(f64::from_bits(((bucket + Spread::FIRST + 1) as u64) << (52 - Spread::BITS)))
    }
}

fn line_of_run(entity: &str, name: &str, color: usize, chunks: &mut Chunks) -> Track {
    Series::style(chunks, entity, name, palette::line(color), 1.5, Shape::Step);
    chunks.track(entity, [Scalars::descriptor_scalars()])
}

#[cfg(test)]
mod tests {
    use super::Spread;

    #[test]
    fn quantiles_leave_out_what_is_rare() {
        let mut spread = Spread::default();
        assert_eq!(spread.quantile(0.9), None);
        (0..90).for_each(|i| spread.add(0.010 + 1e-5 * f64::from(i)));
        (0..10).for_each(|_| spread.add(15.0));
        let typical = spread.quantile(0.9).expect("numbers");
        assert!((0.0108..0.0125).contains(&typical), "{typical}");
        assert!((15.0..=16.0).contains(&spread.quantile(1.0).expect("numbers")));
        for odd in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e300] {
            spread.add(odd);
        }
        assert!(spread.quantile(0.0).expect("numbers") < 1e-6);
    }
}
