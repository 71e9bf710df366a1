//! Scalars over time: diagnostics of the state, and timings.

use std::time::{Duration, Instant as Clock};

use super::{
    FrameView,
    ranking::{self, Mark, Ranking, Row},
};
use crate::{
    colors::{self, SILVER},
    observe::{Schema, schema::ScalarOf},
    sdk::Scalars,
    stream::{
        chunks::{Chunks, TrackId},
        contract::{BODY_SCALAR, DIAGNOSTIC, LAG, RANKED_ENERGIES, RANKED_STAGES, SPEED, STACKED, TIMING},
        instant::Instant,
        palette::{self, Rgb},
        series::{Interpolation, LineId, Series},
        settings::MAX_BODY_ENTITIES,
        step::StepRecord,
    },
    text::{short, significant},
};

/// Additional stages in `/timings`: the cost of observation on the simulation thread.
pub const OBSERVING: [&str; 2] = ["observe", WAIT];
/// The stage in which the simulation waits for the recorder: work is slow elsewhere.
pub const WAIT: &str = "wait";
/// Additional stages in `/timings`: the cost of recording on its own thread.
pub const RECORDING: [&str; 2] = ["extract", "log"];

/// The colour of the line that shows how far a run is behind real time.
pub const LAG_COLOR: Rgb = colors::ORANGE;

/// The stages in `/timings`, in order.
pub fn timings(schema: &Schema) -> impl Iterator<Item = &'static str> {
    schema.stages.iter().copied().chain(OBSERVING).chain(RECORDING)
}

/// The stages in `/timings`, in order, with the colours of their lines.
fn colored(schema: &Schema) -> impl Iterator<Item = (&'static str, Rgb)> {
    timings(schema).enumerate().map(|(number, stage)| (stage, palette::line(number)))
}

/// The stages of a step that are stacked, with the colours of their lines.
pub fn colors(schema: &Schema) -> impl Iterator<Item = (&'static str, Rgb)> {
    colored(schema).filter(|(stage, _)| is_work(stage) && !RECORDING.contains(stage))
}

/// How the names of plots of energies begin.
const ENERGY: &str = "Energy";

/// Whether a plot is one of energies.
pub fn is_energy(plot: &str) -> bool {
    plot.starts_with(ENERGY)
}

/// The plots of energies, each with its scalars by their indices in the schema. A plot of one line belongs to that before it.
pub fn energies(schema: &Schema) -> Vec<(&'static str, Vec<usize>)> {
    let mut plots: Vec<(&'static str, Vec<usize>)> = Vec::new();
    for (index, scalar) in schema.scalars.iter().enumerate().filter(|(_, scalar)| is_energy(scalar.plot)) {
        match plots.iter_mut().find(|(plot, _)| *plot == scalar.plot) {
            Some((_, scalars)) => scalars.push(index),
            None => plots.push((scalar.plot, vec![index])),
        }
    }
    let mut merged: Vec<(&'static str, Vec<usize>)> = Vec::new();
    for (plot, scalars) in plots {
        match merged.last_mut().filter(|_| scalars.len() == 1) {
            Some((_, before)) => before.extend(scalars),
            None => merged.push((plot, scalars)),
        }
    }
    merged
}

/// The entity of the ranking of the `number`th of the [plots of energies](energies).
pub fn ranked_energies(number: usize) -> String {
    RANKED_ENERGIES.of(&[&number.to_string()])
}

/// Whether a stage does work: waiting for a slow disk or viewer is not part of the stacked cost of a step.
pub fn is_work(stage: &str) -> bool {
    stage != WAIT
}

/// The entity of the stacked plot of a stage. Its number orders the viewer's legend like the stack, from its top.
pub fn stacked(schema: &Schema, stage: &str) -> String {
    let work: Vec<_> = timings(schema).filter(|stage| is_work(stage)).collect();
    let number = work.iter().rev().position(|of| *of == stage).map_or(0, |place| place + 1);
    STACKED.of(&[&format!("{number}_{stage}")])
}

/// Scalars aggregated between frames.
pub struct FrameNumbers {
    scalars: Vec<ScalarLine>,
    /// Rankings of energies, by indices into `scalars`.
    energies: Vec<(Ranking, Vec<usize>)>,
    /// Lines of the scalars of bodies, body by body.
    of_bodies: Vec<LineId>,
    timings: Vec<Timing>,
    /// Steps since messages were last sent.
    steps_since_sent: u32,
    /// Time per step spent on the last sending.
    sending: Duration,
    /// Steps since the last frame.
    steps: u32,
    /// When the last step ended.
    end: Option<Clock>,
    /// When the step of the last frame ended.
    last_frame: Option<Clock>,
    speed: TrackId,
    /// The largest speed so far [steps per second].
    fastest: f64,
    lag: Option<Duration>,
    lag_track: TrackId,
    /// The total durations of steps on the simulation thread, and of those of recording.
    totals: [Spread; 2],
}

/// A stage that takes less is not listed [time of the run].
const LEAST_SHARE: f64 = 0.005;

/// A scalar of the schema, aggregated since the last frame.
struct ScalarLine {
    id: LineId,
    of: ScalarOf,
    value: f64,
    /// The value of the last frame.
    last: f64,
    label: &'static str,
    color: Rgb,
    /// Its first value.
    first: Option<f64>,
    /// Its largest finite magnitude in all frames.
    largest: f64,
    /// Whether its plot has no other.
    is_alone: bool,
}

/// A stage, the time spent on it since the last frame, and the distribution of that time over previous frames.
struct Timing {
    name: &'static str,
    track: TrackId,
    /// The stacked plot, if the stage [does work](is_work).
    stacked: Option<TrackId>,
    /// Whether it is the first stage on its thread.
    is_first: bool,
    spent: Duration,
    spread: Spread,
    /// The time spent on it in all frames.
    total: Duration,
}

impl FrameNumbers {
    /// Logs the names of the lines.
    pub fn new(schema: &Schema, series: &mut Series, chunks: &mut Chunks) -> FrameNumbers {
        let timings = colored(schema).map(|(name, rgb)| {
            let entity = TIMING.of(&[name]);
            Series::style(chunks, &entity, &format!("{name} [ms]"), rgb, 1.5, Interpolation::Step);
            let track = chunks.track(&entity, [Scalars::descriptor_scalars()]);
            let stacked = is_work(name).then(|| {
                let entity = stacked(schema, name);
                Series::style(chunks, &entity, &format!("{name} [ms]"), rgb, 1.5, Interpolation::Step);
                chunks.track(&entity, [Scalars::descriptor_scalars()])
            });
            let is_first = schema.stages.first() == Some(&name) || name == RECORDING[0];
            Timing {
                name,
                track,
                stacked,
                is_first,
                spent: Duration::ZERO,
                spread: Spread::default(),
                total: Duration::ZERO,
            }
        });
        let timings = timings.collect();
        let energies = energies(schema);
        let scalars = schema.scalars.iter().enumerate().map(|(i, scalar)| {
            let entity = DIAGNOSTIC.of(&[scalar.name]);
            let shape = if scalar.is_smooth { Interpolation::Linear } else { Interpolation::Step };
            let before = schema.scalars[..i].iter().filter(|before| before.plot == scalar.plot).count();
            // those in a ranking all have different colours
            let ranked = energies.iter().find_map(|(_, ranked)| ranked.iter().position(|of| *of == i));
            let color = scalar.color.unwrap_or_else(|| palette::line(ranked.unwrap_or(before)));
            Series::style(chunks, &entity, scalar.label, color, 1.5, shape);
            let id = series.line(chunks, &entity, shape);
            let (first, of, label) = (None, scalar.of, scalar.label);
            let is_alone = schema.scalars.iter().filter(|other| other.plot == scalar.plot).count() == 1;
            ScalarLine { id, of, value: 0.0, last: 0.0, label, color, first, largest: 0.0, is_alone }
        });
        let scalars = scalars.collect();
        let energies = energies.into_iter().enumerate();
        let energies = energies.map(|(number, (_, scalars))| (Ranking::new(&ranked_energies(number), chunks), scalars));
        let energies = energies.collect();
        let of_bodies = schema.bodies.iter().take(MAX_BODY_ENTITIES).enumerate().flat_map(|(index, body)| {
            let rgb = palette::of_body(schema, index);
            schema.body_scalars.iter().map(move |scalar| (scalar, &body.name, rgb))
        });
        let of_bodies = of_bodies
            .map(|(scalar, name, rgb)| series.scalar(chunks, &BODY_SCALAR.of(&[scalar.name, name]), scalar, name, rgb));
        let of_bodies = of_bodies.collect();
        let speed = run_line(SPEED.path, "steps per second", colors::SKY_BLUE, chunks);
        FrameNumbers {
            scalars,
            energies,
            of_bodies,
            timings,
            steps_since_sent: 0,
            sending: Duration::ZERO,
            steps: 0,
            end: None,
            last_frame: None,
            speed,
            fastest: 0.0,
            lag: None,
            lag_track: run_line(LAG.path, "behind real time [ms]", LAG_COLOR, chunks),
            totals: Default::default(),
        }
    }

    /// Adds a step.
    pub fn add(&mut self, step: &StepRecord) {
        let summary = &step.summary;
        self.steps += 1;
        self.steps_since_sent += 1;
        self.end = step.end;
        self.lag = step.lag;
        let spent = summary.timings.iter().copied().chain([step.observing, step.waiting]);
        self.timings.iter_mut().zip(spent).for_each(|(timing, spent)| timing.spent += spent);
        for (line, &value) in self.scalars.iter_mut().zip(&summary.scalars) {
            match line.of {
                ScalarOf::State => {}
                ScalarOf::SumOfSteps => line.value += value,
                ScalarOf::MaxOfSteps => line.value = line.value.max(value),
            }
        }
    }

    /// Adds the time spent on sending messages, distributed over the steps from which they came.
    pub fn add_sending(&mut self, time: Duration) {
        self.sending = time / std::mem::take(&mut self.steps_since_sent).max(1);
    }

    /// Adds the time spent on recording since the last frame.
    pub fn add_recording(&mut self, extracting: Duration, logging: Duration) {
        if let [.., extract, log] = self.timings.as_mut_slice() {
            extract.spent += extracting;
            log.spent += logging;
        }
    }

    /// Logs the schema's scalars.
    pub fn log_scalars(&mut self, view: FrameView<'_>, series: &mut Series, chunks: &mut Chunks) {
        // of a replay that begins later, the step before the first frame is unknown
        let is_unknown = self.steps == 0 && view.at.step > 0;
        for (line, &of_state) in self.scalars.iter_mut().zip(&view.frame.scalars) {
            if is_unknown && line.of != ScalarOf::State {
                continue;
            }
            let value = if line.of == ScalarOf::State { of_state } else { std::mem::take(&mut line.value) };
            series.log(chunks, line.id, value, view.at);
            line.last = value;
            line.first.get_or_insert(value);
            line.largest = line.largest.max(if value.is_finite() { value.abs() } else { 0.0 });
        }
        let energies = self.energies.iter().flat_map(|(_, scalars)| scalars);
        let noise = ranking::NOISE * energies.map(|&index| self.scalars[index].largest).fold(0.0, f64::max);
        for (ranking, scalars) in &self.energies {
            let lines = scalars.iter().map(|&index| &self.scalars[index]);
            let is_listed = |line: &&ScalarLine| line.largest > noise || !line.last.is_finite() || line.is_alone;
            let rows = energy_rows(lines.filter(is_listed).collect());
            ranking.log(rows.into_iter(), "all are 0", view.at, chunks);
        }
        for (&line, &value) in self.of_bodies.iter().zip(&view.frame.body_scalars) {
            series.log_or_interrupt(chunks, line, value, view.at);
        }
    }

    /// Ranks the stages on the simulation thread by their shares of its time, then those of recording, which run meanwhile;
    /// each with its longest step; and the slowest frame.
    pub fn log_ranking(&self, chunks: &mut Chunks) {
        let is_recording = |timing: &Timing| RECORDING.contains(&timing.name);
        let of_run = self.timings.iter().filter(|timing| !is_recording(timing));
        let whole = of_run.map(|timing| timing.total.as_secs_f64()).sum::<f64>();
        let mut stages: Vec<(&Timing, Rgb)> =
            self.timings.iter().enumerate().map(|(number, timing)| (timing, palette::line(number))).collect();
        stages.sort_by_key(|(timing, _)| (is_recording(timing), std::cmp::Reverse(timing.total)));
        let share = |timing: &Timing| timing.total.as_secs_f64() / whole;
        let longest_total = stages.iter().map(|(timing, _)| share(timing)).fold(0.0, f64::max);
        let stages = stages.into_iter().filter(|(timing, _)| share(timing) >= LEAST_SHARE).take(ranking::ROWS - 1);
        let stages = stages.map(|(timing, color)| {
            let (longest, step) = timing.spread.largest();
            let total = format!("{} {} s", timing.name, significant(timing.total.as_secs_f64()));
            let total = match is_recording(timing) {
                true => format!("+ {total}"),
                false => format!("{total}, {:.0} %", 100.0 * share(timing)),
            };
            let label = format!("{total}; {} ms #{step}", significant(longest));
            Row { label, color, marks: vec![(Mark::Bar(share(timing) / longest_total), color)] }
        });
        let (slowest, step) = self.totals[0].largest();
        let slowest = (slowest > 0.0).then(|| {
            let label = format!("slowest, without wait: {} ms #{step}", significant(slowest));
            Row { label, color: SILVER, marks: Vec::new() }
        });
        ranking::log_static(RANKED_STAGES.path, stages.chain(slowest), chunks);
    }

    /// The largest speed of the run [steps per second]; 0 if there were no two frames.
    pub fn fastest(&self) -> f64 {
        self.fastest
    }

    /// The durations of steps, and of their recordings.
    pub fn totals(&self) -> [&Spread; 2] {
        self.totals.each_ref()
    }

    /// Logs the timings since the last frame [ms per step].
    pub fn log_timings(&mut self, at: Instant, chunks: &mut Chunks) {
        let steps = std::mem::take(&mut self.steps);
        if let Some(log) = self.timings.last_mut() {
            log.spent += self.sending * steps;
        }
        let (mut stack, mut totals) = (0.0, [0.0; 2]);
        for Timing { name, track, stacked, is_first, spent, spread, total } in &mut self.timings {
            *total += *spent;
            let milliseconds = 1e3 * std::mem::take(spent).as_secs_f64() / f64::from(steps);
            if steps > 0 {
                spread.add(milliseconds, at.step);
                chunks.push_apart(*track, at, &[&[milliseconds]]);
                let Some(stacked) = stacked else { continue };
                stack = if *is_first { milliseconds } else { stack + milliseconds };
                totals[usize::from(RECORDING.contains(name))] = stack;
                chunks.push_apart(*stacked, at, &[&[stack]]);
            }
        }
        if steps == 0 {
            return;
        }
        for (all, total) in self.totals.iter_mut().zip(totals) {
            all.add(total, at.step);
        }
        if let (Some(last), Some(end)) = (self.last_frame, self.end) {
            let speed = f64::from(steps) / (end - last).as_secs_f64().max(1e-9);
            self.fastest = self.fastest.max(speed);
            chunks.push_apart(self.speed, at, &[&[speed]]);
        }
        self.last_frame = self.end;
        if let Some(lag) = self.lag {
            chunks.push_apart(self.lag_track, at, &[&[1e3 * lag.as_secs_f64()]]);
        }
    }
}

/// The distribution of durations [ms]: a histogram on a logarithmic scale, with eight buckets per octave from 2^-24 to 2^16.
#[derive(Debug, Default)]
pub struct Spread {
    /// The number of values in each bucket, and their sum.
    buckets: Vec<(u64, f64)>,
    all: u64,
    largest: f64,
    /// The step of the largest.
    step: u64,
}

impl Spread {
    /// Mantissa bits that select a bucket within an octave.
    const BITS: u32 = 3;
    /// Leading bits of the first bucket's values.
    const FIRST: usize = (1023 - 24) << Spread::BITS;
    const BUCKETS: usize = 40 << Spread::BITS;

    fn bucket(number: f64) -> usize {
        let bits = (number.max(0.0).to_bits() >> (52 - Spread::BITS)) as usize;
        bits.saturating_sub(Spread::FIRST).min(Spread::BUCKETS - 1)
    }

    fn add(&mut self, number: f64, step: u64) {
        self.buckets.resize(Spread::BUCKETS, (0, 0.0));
        let (count, sum) = &mut self.buckets[Spread::bucket(number)];
        (*count, *sum) = (*count + 1, *sum + number);
        self.all += 1;
        if number > self.largest {
            (self.largest, self.step) = (number, step);
        }
    }

    /// The quantile of this fraction of the values, rounded up to a bucket.
    fn quantile(&self, share: f64) -> Option<f64> {
        let wanted = (share * self.all as f64).ceil() as u64;
        let mut seen = 0;
        let bucket = self.buckets.iter().position(|(count, _)| {
            seen += count;
            seen >= wanted && seen > 0
        })?;
        Some(f64::from_bits(((bucket + Spread::FIRST + 1) as u64) << (52 - Spread::BITS)))
    }

    /// A duration that most do not exceed; 0 if there are none: the 90th percentile, but not more than twice the 75th.
    pub fn typical(&self) -> f64 {
        let [many, most] = [0.75, 0.9].map(|share| self.quantile(share).unwrap_or_default());
        f64::min(most, 2.0 * many)
    }

    /// The number of values.
    pub fn count(&self) -> u64 {
        self.all
    }

    /// The largest value, 0 if there are none, and its step.
    pub fn largest(&self) -> (f64, u64) {
        (self.largest, self.step)
    }

    /// The number of values above a limit that is rounded to a bucket, and their share of the sum of all.
    pub fn beyond(&self, limit: f64) -> (u64, f64) {
        let add = |of: &[(u64, f64)]| of.iter().fold((0, 0.0), |all, of| (all.0 + of.0, all.1 + of.1));
        let above = add(self.buckets.get(Spread::bucket(limit) + 1..).unwrap_or_default());
        (above.0, above.1 / add(&self.buckets).1.max(f64::MIN_POSITIVE))
    }
}

/// Bars to the left of the middle are of negative values; what rounding leaves of the largest is 0. The first row also has its
/// value at the start.
fn energy_rows(mut lines: Vec<&ScalarLine>) -> Vec<Row> {
    while lines.len() > ranking::ROWS {
        let least = (0..lines.len()).min_by(|&one, &other| lines[one].last.abs().total_cmp(&lines[other].last.abs()));
        lines.remove(least.unwrap_or(0));
    }
    let longest = lines.iter().map(|line| line.last.abs()).fold(f64::MIN_POSITIVE, f64::max);
    let row = |(number, line): (usize, &ScalarLine)| {
        let name = line.label.split(" [").next().unwrap_or(line.label);
        let first = line.first.filter(|first| number == 0 && *first != 0.0);
        let first = first.map_or(String::new(), |first| format!(", initially {}", short(first)));
        let value = if line.last.abs() < f64::EPSILON * longest { 0.0 } else { line.last };
        let share = if value.is_finite() { value / longest } else { 0.0 };
        let marks = vec![(Mark::Tick(0.5), SILVER), (Mark::Signed(share), line.color)];
        Row { label: format!("{name} {}{first}", short(value)), color: line.color, marks }
    };
    lines.into_iter().enumerate().map(row).collect()
}

fn run_line(entity: &str, name: &str, rgb: Rgb, chunks: &mut Chunks) -> TrackId {
    Series::style(chunks, entity, name, rgb, 1.5, Interpolation::Step);
    chunks.track(entity, [Scalars::descriptor_scalars()])
}

#[cfg(test)]
mod tests {
    use super::Spread;

    #[test]
    fn quantiles_ignore_rare_values() {
        let mut spread = Spread::default();
        assert_eq!((spread.quantile(0.9), spread.typical(), spread.largest()), (None, 0.0, (0.0, 0)));
        assert_eq!(spread.beyond(1.0), (0, 0.0));
        (0..90).for_each(|i| spread.add(0.010 + 1e-5 * f64::from(i), 1));
        (0..10).for_each(|i| spread.add(15.0 + 1e-3 * f64::from(i), u64::try_from(i).unwrap()));
        let typical = spread.quantile(0.9).expect("numbers");
        assert!((0.0108..0.0125).contains(&typical), "{typical}");
        assert!((15.0..=16.0).contains(&spread.quantile(1.0).expect("numbers")));
        assert_eq!(spread.largest(), (15.009, 9));
        let (count, share) = spread.beyond(1.0);
        assert_eq!(count, 10);
        assert!((share - 150.045 / (150.045 + 0.9 + 1e-5 * 4005.0)).abs() < 1e-12, "{share}");
        for odd in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e300] {
            spread.add(odd, 0);
        }
        assert!(spread.quantile(0.0).expect("numbers") < 1e-6);
    }
}
