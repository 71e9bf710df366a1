//! Cost against scene size: step time of scenes with 2 to 100,000 bodies, of which all, one in a hundred, or two are in
//! contact.
//!
//! Every scene is built from the same pairs ([`scenes`]), so one reference solution of these pairs serves all scenes. A
//! world is stepped on one core and on all cores alternately, so that other load on the machine affects both equally.
//! Blocks cover whole periods of the pairs' motion where that does not take too long. The naive baseline is measured
//! for comparison: the thesis's scheme with every vertex, one number at a time.

pub mod csv;
pub mod decay;
pub mod diagram;
pub mod free;
pub mod free_oscillation;
pub mod goals;
pub mod scenes;
pub mod table;

use std::time::{Duration, Instant};

use pulp::Arch;
use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};

use super::{
    MeasureError,
    reference::{Accuracy, NoReference, Reference},
};
use crate::{
    Scene, World,
    scene::Integrator,
    sim::{Options, Stage, TooLarge},
};
use decay::Decay;
use free_oscillation::FreeOscillation;
use scenes::{Family, Layout, PERIOD, PHASES};

/// Settings of the benchmark.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Numbers of bodies, ascending.
    pub bodies: Vec<usize>,
    /// Approximate duration of timed steps, for each number of bodies, family and number of threads.
    pub time: Duration,
    /// Number of steps of the decaying scene.
    pub decay: u64,
}

impl Default for Settings {
    fn default() -> Settings {
        Settings {
            bodies: vec![2, 10, 100, 1_000, 10_000, 100_000],
            time: Duration::from_millis(500),
            decay: 1_000_000,
        }
    }
}

/// Warm-up steps, after which bodies that start at rest have met their neighbours.
const WARM: u64 = 60;
/// The best of this many blocks of steps is reported, because other load only ever adds to run times.
const BLOCKS: usize = 9;
/// Number of blocks if [`BLOCKS`] would take too long.
const LONG_BLOCKS: usize = 3;
/// The naive baseline is skipped in scenes where its step is expected to take longer.
const LONGEST_PLAIN_STEP: Duration = Duration::from_secs(4);
/// The naive baseline is skipped in larger scenes if no smaller one has been measured.
const LARGEST_FIRST_PLAIN: usize = 1000;
/// Number of steps between checks of the error, for up to a period.
const JUDGED_EVERY: u64 = 20;
/// Upper limit on the checked pairs, which are spread over the scene.
const MAX_JUDGED: usize = 64;
/// Number of counts per period of the vertices inside spheres.
const COUNTS: u64 = 24;

/// Timed steps.
#[derive(Clone, Debug, PartialEq)]
pub struct Run {
    /// Number of threads.
    pub threads: usize,
    /// Number of steps.
    pub steps: u64,
    /// Time per step in the best block [s].
    pub seconds: f64,
    /// Share of each stage in the step time [–].
    pub stages: [f64; Stage::ALL.len()],
}

impl Run {
    /// Steps per second [1/s].
    pub fn steps_per_second(&self) -> f64 {
        1.0 / self.seconds
    }
}

/// The error of vertex positions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Judged {
    /// The largest error of a vertex at any checked time [radii].
    pub error: f64,
    /// The last checked step.
    pub steps: u64,
}

/// Measurements of the naive baseline.
#[derive(Clone, Debug, PartialEq)]
pub struct Plain {
    /// Timing on one thread.
    pub run: Run,
    /// The error, if the run was long enough to determine it.
    pub judged: Option<Judged>,
}

/// The measurements of one scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    /// The family of the scene.
    pub family: Family,
    /// Number of bodies.
    pub bodies: usize,
    /// Number of bodies in contact with another.
    pub touching: usize,
    /// Number of vertices.
    pub vertices: u64,
    /// Number of vertices inside a sphere, averaged over some steps.
    pub reached: f64,
    /// Number of bodies that take steps or have stored state.
    pub active: usize,
    /// Memory allocated by the world [bytes].
    pub memory: usize,
    /// Timing on one core.
    pub one: Run,
    /// Timing on all cores; `None` on a single-core machine.
    pub all: Option<Run>,
    /// The error, if it could be determined.
    pub judged: Option<Judged>,
    /// The naive baseline, unless its steps take too long.
    pub plain: Option<Plain>,
}

impl Point {
    /// The timings on one core and, if there are more, on all cores.
    pub fn runs(&self) -> impl Iterator<Item = &Run> {
        std::iter::once(&self.one).chain(&self.all)
    }

    /// The timing on all available cores.
    pub fn best(&self) -> &Run {
        self.all.as_ref().unwrap_or(&self.one)
    }

    /// Step time on one core per vertex inside a sphere [s].
    pub fn seconds_per_reached(&self) -> f64 {
        self.one.seconds / self.reached
    }

    /// Speed-up on all cores over one core [–].
    pub fn speed_up(&self) -> Option<f64> {
        self.all.as_ref().map(|all| self.one.seconds / all.seconds)
    }
}

/// All measurements.
#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    /// Ordered by family, then by number of bodies, ascending.
    pub points: Vec<Point>,
    /// The built-in scene `two`, on one core.
    pub two: Run,
    /// Bodies whose vertices all oscillate freely, with every frame requested.
    pub free_oscillation: Vec<FreeOscillation>,
    /// Bodies that come to rest.
    pub decay: Decay,
    /// Free bodies.
    pub free: free::Free,
    /// Scenes that need more memory than is available.
    pub too_large: Vec<TooLarge>,
    /// Number of threads on all cores.
    pub threads: usize,
}

impl Report {
    /// The points of a family, by number of bodies.
    pub fn of(&self, family: Family) -> impl Iterator<Item = &Point> + Clone {
        self.points.iter().filter(move |point| point.family == family)
    }

    /// The point of a family with this many bodies.
    pub fn at(&self, family: Family, bodies: usize) -> Option<&Point> {
        self.of(family).find(|point| point.bodies == bodies)
    }

    /// The exponent with which step time grows with the number of bodies, by least squares of the logarithms over
    /// points of at least 100 bodies [–]; `None` with fewer than two such points.
    pub fn slope(&self, family: Family, run: impl Fn(&Point) -> Option<&Run>) -> Option<f64> {
        let points = self.of(family).filter(|point| point.bodies >= 100);
        let logs: Vec<(f64, f64)> =
            points.filter_map(|point| Some(((point.bodies as f64).ln(), run(point)?.seconds.ln()))).collect();
        let n = logs.len() as f64;
        let (x, y) = (logs.iter().map(|p| p.0).sum::<f64>() / n, logs.iter().map(|p| p.1).sum::<f64>() / n);
        let spread: f64 = logs.iter().map(|p| (p.0 - x).powi(2)).sum();
        let slope = logs.iter().map(|p| (p.0 - x) * (p.1 - y)).sum::<f64>() / spread;
        slope.is_finite().then_some(slope)
    }
}

/// The thread pools on which worlds are stepped.
pub(super) struct Pools {
    one: ThreadPool,
    /// Present if there is more than one core.
    all: Option<ThreadPool>,
}

impl Pools {
    fn new() -> Result<Pools, ThreadPoolBuildError> {
        let cores = std::thread::available_parallelism().map_or(1, |cores| cores.get());
        let pool = |threads| ThreadPoolBuilder::new().num_threads(threads).build();
        Ok(Pools { one: pool(1)?, all: if cores > 1 { Some(pool(cores)?) } else { None } })
    }

    fn each(&self) -> impl Iterator<Item = &ThreadPool> {
        [Some(&self.one), self.all.as_ref()].into_iter().flatten()
    }

    fn best(&self) -> &ThreadPool {
        self.all.as_ref().unwrap_or(&self.one)
    }
}

/// Measures all families at all sizes. Reports the completed fraction of the work to `progress`.
///
/// # Errors
/// [`MeasureError`]. A scene that needs too much memory is skipped and reported instead.
pub fn measure(settings: &Settings, progress: &mut dyn FnMut(f64)) -> Result<Report, MeasureError> {
    let pair = Scene::builtin("two").ok_or(MeasureError::NoScene)?;
    let pools = Pools::new()?;
    let largest = settings.bodies.iter().copied().max().unwrap_or(0);
    let judge = pools.best().install(|| Judge::new(&pair, largest))?;
    let two = take_two(&pair, &pools, settings.time)?;

    let (mut points, mut too_large) = (vec![], vec![]);
    let mut done = 0;
    for family in Family::ALL {
        let mut plain_step = 0.0;
        let mut before = 0;
        for &bodies in &settings.bodies {
            let layout = Layout::new(family, bodies);
            let scene = layout.scene(&pair);
            match measure_point(&layout, scene.clone(), &judge, &pools, settings.time) {
                Ok(mut point) => {
                    // the baseline's step time grows with the number of pairs
                    let expected = plain_step * (bodies as f64 / before as f64).powi(2);
                    let is_short = expected <= LONGEST_PLAIN_STEP.as_secs_f64();
                    let is_worth = if before == 0 { bodies <= LARGEST_FIRST_PLAIN } else { is_short };
                    if is_worth {
                        // fails where there are more pairs than can be stepped
                        if let Ok(plain) = measure_plain(&layout, scene, &judge, &pools, settings.time) {
                            plain_step = plain.run.seconds;
                            before = bodies;
                            point.plain = Some(plain);
                        }
                    }
                    points.push(point);
                }
                Err(error) => too_large.push(error),
            }
            done += 1;
            progress(done as f64 / (Family::ALL.len() * settings.bodies.len() + 1) as f64);
        }
    }
    let free_oscillation = free_oscillation::measure(&pair, &pools, settings.time, largest)?;
    let prescribed = |bodies| {
        let mut of_contact = points.iter().filter(|point| point.family == Family::Contact);
        of_contact.find(|point| point.bodies == bodies).map(|point| point.one.seconds)
    };
    let free = free::measure(&pair, &pools, &settings.bodies, settings.time, prescribed)?;
    let threads = pools.best().current_num_threads();
    let decay = pools.one.install(|| decay::measure(&pair, settings.decay))?;
    Ok(Report { points, two, free_oscillation, decay, free, too_large, threads })
}

/// Steps the whole of `two` repeatedly.
fn take_two(two: &Scene, pools: &Pools, time: Duration) -> Result<Run, TooLarge> {
    let steps = two.steps();
    let mut clock = Clock::new(1);
    while clock.seconds() < time.as_secs_f64() || clock.blocks.len() < BLOCKS {
        let mut world = World::new(two.clone())?;
        pools.one.install(|| clock.take(&mut world, steps));
    }
    Ok(clock.run())
}

fn measure_point(
    layout: &Layout,
    scene: Scene,
    judge: &Judge,
    pools: &Pools,
    time: Duration,
) -> Result<Point, TooLarge> {
    let mut world = pools.best().install(|| World::new(scene))?;
    let mut judging = Judging { judge, layout, judged: None };
    let start = Instant::now();
    pools.best().install(|| judging.advance(&mut world, WARM, &mut |world, steps| run(world, steps)));
    let estimate = start.elapsed().as_secs_f64() / WARM as f64;

    let steps = block(estimate, time.as_secs_f64() / BLOCKS as f64);
    let mut clocks: Vec<Clock> = pools.each().map(|pool| Clock::new(pool.current_num_threads())).collect();
    let mut reached = Mean::default();
    let is_long = steps as f64 * estimate > time.as_secs_f64();
    for _ in 0..if is_long { LONG_BLOCKS } else { BLOCKS } {
        for (pool, clock) in pools.each().zip(&mut clocks) {
            pool.install(|| judging.advance_timed(&mut world, steps, clock));
        }
        reached.add(world.energy().reached_vertices as f64);
    }
    if !is_long {
        // blocks may end at the phase at which they began, so sample within a period instead
        reached = Mean::default();
        for _ in 0..COUNTS {
            run(&mut world, PERIOD / COUNTS);
            reached.add(world.energy().reached_vertices as f64);
        }
    }
    let mut runs = clocks.into_iter().map(Clock::run);
    let one = runs.next().unwrap_or_else(|| Clock::new(1).run());
    Ok(Point {
        family: layout.family,
        bodies: layout.bodies,
        touching: 2 * layout.pairs.len(),
        vertices: world.scene().vertex_count(),
        reached: reached.mean(),
        active: world.bodies().filter(|body| !body.is_at_rest()).count(),
        memory: world.memory(),
        one,
        all: runs.next(),
        judged: judging.judged,
        plain: None,
    })
}

fn measure_plain(
    layout: &Layout,
    mut scene: Scene,
    judge: &Judge,
    pools: &Pools,
    time: Duration,
) -> Result<Plain, TooLarge> {
    scene.integrator = Integrator::Thesis;
    let mut world = World::with_options(scene, Options { arch: Arch::Scalar, ..Options::default() })?;
    let mut judging = Judging { judge, layout, judged: None };
    let mut clock = Clock::new(1);
    pools.one.install(|| {
        judging.advance_timed(&mut world, 1, &mut clock);
        let steps = ((time.as_secs_f64() / BLOCKS as f64 / clock.seconds()) as u64).max(1);
        clock = Clock::new(1);
        while clock.blocks.len() < BLOCKS && clock.seconds() < time.as_secs_f64() {
            judging.advance_timed(&mut world, steps, &mut clock);
        }
    });
    Ok(Plain { run: clock.run(), judged: judging.judged })
}

/// Number of steps that take about `share` [s] or more, at about `estimate` [s] per step. It is a number of whole
/// periods, or at least a multiple of the phase offset, so that every block does the same work.
fn block(estimate: f64, share: f64) -> u64 {
    let steps = (share / estimate) as u64;
    let unit = if steps >= PERIOD / 2 { PERIOD } else { PERIOD / PHASES as u64 };
    steps.div_ceil(unit).max(1) * unit
}

fn run(world: &mut World, steps: u64) {
    for _ in 0..steps {
        world.step();
    }
}

/// Times steps.
struct Clock {
    threads: usize,
    steps: u64,
    /// Time per step of each block [s].
    blocks: Vec<f64>,
    stages: [Duration; Stage::ALL.len()],
    all: Duration,
}

impl Clock {
    fn new(threads: usize) -> Clock {
        Clock { threads, steps: 0, blocks: vec![], stages: Default::default(), all: Duration::ZERO }
    }

    fn seconds(&self) -> f64 {
        self.all.as_secs_f64()
    }

    /// Takes a block of steps.
    fn take(&mut self, world: &mut World, steps: u64) {
        let elapsed = self.part(world, steps);
        self.blocks.push(elapsed.as_secs_f64() / steps as f64);
    }

    /// Takes steps that are part of a block; returns their duration.
    fn part(&mut self, world: &mut World, steps: u64) -> Duration {
        let start = Instant::now();
        for _ in 0..steps {
            let report = world.step();
            for (sum, stage) in self.stages.iter_mut().zip(&report.timings) {
                *sum += *stage;
            }
        }
        let elapsed = start.elapsed();
        self.all += elapsed;
        self.steps += steps;
        elapsed
    }

    fn run(self) -> Run {
        Run {
            threads: self.threads,
            steps: self.steps,
            seconds: self.blocks.iter().copied().fold(f64::INFINITY, f64::min),
            stages: self.stages.map(|stage| stage.as_secs_f64() / self.all.as_secs_f64()),
        }
    }
}

#[derive(Default)]
struct Mean {
    sum: f64,
    count: u64,
}

impl Mean {
    fn add(&mut self, value: f64) {
        self.sum += value;
        self.count += 1;
    }

    fn mean(&self) -> f64 {
        self.sum / self.count as f64
    }
}

/// The exact motion of the pairs of all scenes.
struct Judge {
    reference: Reference,
}

impl Judge {
    /// Solves the motion for scenes with up to this many bodies.
    fn new(two: &Scene, bodies: usize) -> Result<Judge, NoReference> {
        let scene = scenes::every_phase(two, (bodies / 2).clamp(1, PHASES));
        let times: Vec<f64> = (0..=PERIOD / JUDGED_EVERY).map(|k| (k * JUDGED_EVERY) as f64 * scene.dt).collect();
        Ok(Judge { reference: Reference::solve(&scene, &times, Accuracy::DEFAULT)? })
    }

    /// The largest error of a vertex [radii], if it can be determined at this time.
    fn error(&self, world: &World, layout: &Layout) -> Option<f64> {
        let step = world.steps_taken();
        if !step.is_multiple_of(JUDGED_EVERY) || step > PERIOD {
            return None;
        }
        let instant = (step / JUDGED_EVERY) as usize;
        let stride = layout.pairs.len().div_ceil(MAX_JUDGED);
        let mut largest = 0.0;
        for pair in layout.pairs.iter().step_by(stride) {
            for (side, index) in [pair.still, pair.moving].into_iter().enumerate() {
                let body = world.body(index);
                let states = body.states();
                let found = (0..body.vertex_count()).map(|vertex| states.displacement.get(vertex));
                let error = self.reference.distance(2 * pair.phase + side, instant, found) / body.scene().radius;
                largest = if error > largest || error.is_nan() { error } else { largest };
            }
        }
        Some(largest)
    }
}

/// Checks the errors of a world at intervals while it is stepped.
struct Judging<'a> {
    judge: &'a Judge,
    layout: &'a Layout,
    judged: Option<Judged>,
}

impl Judging<'_> {
    /// Takes this many steps with `take`, in pieces between which errors are checked.
    fn advance(&mut self, world: &mut World, steps: u64, take: &mut dyn FnMut(&mut World, u64)) {
        let end = world.steps_taken() + steps;
        while world.steps_taken() < end {
            let step = world.steps_taken();
            let next = if step < PERIOD { (step / JUDGED_EVERY + 1) * JUDGED_EVERY } else { end };
            take(world, next.min(end) - step);
            if let Some(error) = self.judge.error(world, self.layout) {
                let before = self.judged.map_or(0.0, |judged| judged.error);
                self.judged = Some(Judged { error: f64::max(before, error), steps: world.steps_taken() });
            }
        }
    }

    /// Takes a block of steps and times it with the clock.
    fn advance_timed(&mut self, world: &mut World, steps: u64, clock: &mut Clock) {
        let mut block = Duration::ZERO;
        self.advance(world, steps, &mut |world, steps| block += clock.part(world, steps));
        clock.blocks.push(block.as_secs_f64() / steps as f64);
    }
}
