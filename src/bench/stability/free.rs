//! Free bodies at the limits: mass ratios, spins, deep overlap, corners of planes, stacks, stiff springs.
//!
//! The energy of free bodies is bounded by the initial kinetic energy, the initial potential energy of planes and
//! gravity, and the maximum that spheres can add initially and at each event. A run that exceeds this bound by the
//! factor [`super::MARGIN`], or is not finite, is not a solution. Runs that the integrator ends with a reason are
//! counted separately.
//!
//! A run of the exponential integrator is also compared with a [`Reference`], where there is one that does not take too
//! long: its error at any time must be within the tolerance, unless the motion itself amplifies errors.

use std::fmt::Write as _;

use rayon::prelude::*;

use super::MARGIN;
use crate::{
    Scene, SceneError, World,
    bench::{
        MeasureError,
        error::random,
        reference::{Accuracy, Reference},
        tables,
    },
    model::energy::influence_potential,
    scene::{Integrator, Motion},
};

/// Steps of each case.
const STEPS: u32 = 60;

/// A reference is computed only if it takes at most this many evaluations of a vertex's equation of motion.
const MAX_EVALUATIONS: f64 = 1e8;

/// The setting that a case takes to its limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// Mass ratios from 10 to 1e6, for bodies that meet and merge.
    Masses,
    /// Spins from 10 to 1e4 rad/s, for soft and stiff bodies, alone, on a plane and merged.
    Spins,
    /// Centres that are close or coincident.
    Overlap,
    /// A body thrown into a corner of three planes, soft and stiff, smooth and rough.
    Corners,
    /// A stack of fifty bodies on a plane.
    Stacks,
    /// ωΔt from 1 to 1e3, for bodies that meet.
    Stiffness,
}

impl Axis {
    /// All axes, in the order of tables.
    pub const ALL: [Axis; 6] = [Axis::Masses, Axis::Spins, Axis::Overlap, Axis::Corners, Axis::Stacks, Axis::Stiffness];

    /// The name used in tables.
    pub fn name(self) -> &'static str {
        match self {
            Axis::Masses => "mass ratios to 1e6",
            Axis::Spins => "spins to 1e4 rad/s",
            Axis::Overlap => "deep overlap",
            Axis::Corners => "corners of planes",
            Axis::Stacks => "stacks of 50",
            Axis::Stiffness => "ωΔt to 1e3",
        }
    }
}

/// A scene with free bodies that is hard for integrators.
#[derive(Clone, Debug)]
pub struct Case {
    /// The setting that it takes to its limits.
    pub axis: Axis,
    /// A short description with the relevant numbers.
    pub what: String,
    /// The scene.
    pub scene: Scene,
}

fn case(axis: Axis, what: String, text: &str) -> Result<Case, SceneError> {
    let scene = Scene::parse(&format!("duration = 1.0\n{text}"), &format!("{what}.toml"))?;
    Ok(Case { axis, what, scene })
}

/// A ball of 38 vertices; `lines` are further keys.
fn ball(name: &str, lines: &str, motion: &str) -> String {
    format!(
        "[[body]]\nname = \"{name}\"\nradius = 1.0\nshape = {{ sphere = {{ stacks = 7, slices = 6 }} }}\n{lines}\nmotion = {{ \
         free = {{ {motion} }} }}\n"
    )
}

const FLOOR: &str = "gravity = [0, 0, -9.81]\n[[plane]]\nnormal = [0, 0, 1]\nfriction = 0.5\nslip = 0.05\n";

/// All cases.
///
/// # Errors
/// A case is not a valid scene.
pub fn cases() -> Result<Vec<Case>, SceneError> {
    let mut cases = Vec::new();
    let core = "[influence]\ncore_at = 0.6\ncore_width = 0.3\n";
    for ratio in [1e1, 1e2, 1e3, 1e4, 1e5, 1e6] {
        for speed in [1.0, 6.0] {
            let text = core.to_owned()
                + &ball("heavy", &format!("mass = {ratio:e}"), "from = [-1.2, 0, 0]")
                + &ball("light", "mass = 1.0", &format!("from = [1.2, 0.2, 0], velocity = [{:?}, 0, 0]", -speed));
            cases.push(case(Axis::Masses, format!("1:{ratio:.0e} at {speed}/s"), &text)?);
        }
    }
    for spin in [1e1, 1e2, 1e3, 1e4] {
        for omega in [12.0, 300.0] {
            let lines = format!("omega = {omega:?}");
            let turning = |z: f64| format!("from = [0, 0, {z:?}], spin = [0, {spin:e}, {:e}]", 0.1 * spin);
            let alone = ball("a", &lines, &turning(0.0));
            let merged = format!("{core}{}{}", ball("a", &lines, &turning(0.0)), ball("b", "", "from = [1.5, 0, 0.2]"));
            let landing = format!("{FLOOR}{}", ball("a", &lines, &turning(1.05)));
            for (how, text) in [("alone", alone), ("merged", merged), ("on a plane", landing)] {
                cases.push(case(Axis::Spins, format!("{spin:.0e} rad/s, ω {omega}, {how}"), &text)?);
            }
        }
    }
    for distance in [0.0, 1e-12, 1e-6, 1e-2, 0.3] {
        for (what, law) in [("", ""), (", core", core)] {
            let text = law.to_owned()
                + &ball("a", "", "from = [0, 0, 0]")
                + &ball("b", "", &format!("from = [{distance:?}, 0, 0]"))
                + &ball("c", "", "from = [0, 0.1, 0.1], spin = [1, 0, 0]");
            cases.push(case(Axis::Overlap, format!("{distance:.0e} apart{what}"), &text)?);
        }
    }
    for stiffness in [1e2, 4e3, 1e6, 1e9] {
        for friction in [0.0, 0.8] {
            let plane = |normal: [f64; 3]| {
                format!(
                    "[[plane]]\nnormal = {normal:?}\nstiffness = {stiffness:e}\nfriction = {friction:?}\nslip = 0.05\n"
                )
            };
            let text = "gravity = [0, 0, -9.81]\n".to_owned()
                + &plane([1.0, 0.0, 0.3])
                + &plane([-0.5, 0.8, 0.2])
                + &plane([-0.5, -0.8, 0.3])
                + &ball("a", "", "from = [0.1, 0.2, 1.9], velocity = [1, 0.5, -4], spin = [2, 1, 0]");
            cases.push(case(Axis::Corners, format!("k {stiffness:.0e}, μ {friction}"), &text)?);
        }
    }
    for damping in [2.0, 10.0] {
        let mut text = format!(
            "tolerance = 1e-3\n{FLOOR}[material]\nomega = 30.0\ndamping = {damping:?}\n[influence]\ncore_at = 0.9\ncore_width = 0.2\n"
        );
        for k in 0..50 {
            text += &format!(
                "[[body]]\nname = \"b{k}\"\nradius = 1.0\nshape = {{ sphere = {{ stacks = 4, slices = 5 }} }}\nmotion = {{ free \
                 = {{ from = [{:?}, 0, {:?}] }} }}\n",
                0.02 * f64::from(k % 3),
                1.0 + 1.9 * f64::from(k)
            );
        }
        cases.push(case(Axis::Stacks, format!("κ {damping}"), &text)?);
    }
    for reduced in [1.0, 1e1, 1e2, 1e3] {
        for damping in [0.0, 0.1] {
            let omega = reduced * 60.0;
            let lines = format!("omega = {omega:?}\ndamping = {:?}", damping * omega);
            let text = core.to_owned()
                + &ball("a", &lines, "from = [-1.2, 0.1, 0], velocity = [2, 0, 0], spin = [0, 1, 0]")
                + &ball("b", &lines, "from = [1.2, -0.1, 0], velocity = [-2, 0, 0]");
            cases.push(case(Axis::Stiffness, format!("ωΔt {reduced:.0e}, κ {damping} ω"), &text)?);
        }
    }
    Ok(cases)
}

/// How a run ended.
#[derive(Clone, Debug, PartialEq)]
pub enum Verdict {
    /// Finite and within the bound, to the end.
    Passed,
    /// It ended earlier, with this reason.
    NotFollowed(String),
    /// Its state contains NaN or infinity.
    NotFinite,
    /// Its energy exceeds the bound by this factor.
    BeyondBound(f64),
    /// Its error exceeds what the tolerance allows by this factor.
    Inaccurate(f64),
}

impl Verdict {
    /// Whether the run went on with a wrong state.
    fn is_failure(&self) -> bool {
        matches!(self, Verdict::NotFinite | Verdict::BeyondBound(_) | Verdict::Inaccurate(_))
    }
}

/// A case and how it ended with each integrator.
#[derive(Clone, Debug)]
pub struct Row {
    /// The case.
    pub case: Case,
    /// Verdicts, in the order of the requested integrators.
    pub verdicts: Vec<(Integrator, Verdict)>,
    /// Whether the exponential integrator's run was compared with a reference.
    pub is_compared: bool,
}

impl Row {
    /// Whether the exponential integrator failed: it must pass, or stop with a reason.
    pub fn is_defect(&self) -> bool {
        self.verdicts.iter().any(|(of, verdict)| *of == Integrator::Exponential && verdict.is_failure())
    }
}

/// Runs all cases on all cores.
///
/// # Errors
/// [`MeasureError`]
pub fn measure(integrators: &[Integrator]) -> Result<Vec<Row>, MeasureError> {
    let row = |case: Case| {
        let verdict = |&integrator: &Integrator| Ok((integrator, run(&case.scene, integrator)?));
        let mut verdicts = integrators.iter().map(verdict).collect::<Result<Vec<_>, MeasureError>>()?;
        let mut is_compared = false;
        for (of, verdict) in &mut verdicts {
            if *of == Integrator::Exponential && *verdict == Verdict::Passed {
                let factor = excess(&case.scene)?;
                is_compared = factor.is_some();
                if let Some(factor) = factor.filter(|&factor| factor > 1.0) {
                    *verdict = Verdict::Inaccurate(factor);
                }
            }
        }
        Ok(Row { case, verdicts, is_compared })
    };
    cases()?.into_par_iter().map(row).collect()
}

fn run(scene: &Scene, integrator: Integrator) -> Result<Verdict, MeasureError> {
    let mut world = World::new(Scene { integrator, ..scene.clone() })?;
    let by_influence = max_influence_energy(scene);
    let (mut bound, mut used) = (energy_at_start(&world) + by_influence, 0.0);
    for _ in 0..STEPS {
        let report = world.step();
        bound += by_influence * report.events.len() as f64;
        if let Some(failure) = report.failure.as_ref().filter(|failure| !failure.is_whole_step()) {
            return Ok(Verdict::NotFollowed(failure.to_string()));
        }
        let Some(now) = world.conserved() else { continue };
        let energy = now.kinetic + now.spin + now.vibration + now.elastic + now.plane;
        used = if energy / bound > used || energy.is_nan() { energy / bound } else { used };
        if !(used < f64::INFINITY) {
            return Ok(Verdict::NotFinite);
        }
    }
    Ok(if used > MARGIN { Verdict::BeyondBound(used) } else { Verdict::Passed })
}

/// The largest ratio of an error to what the tolerance allows; `None` without a reference, or if the motion amplifies.
fn excess(scene: &Scene) -> Result<Option<f64>, MeasureError> {
    let scene = Scene { duration: f64::from(STEPS) * scene.dt, ..scene.clone() };
    let instants: Vec<f64> = (0..=scene.steps()).map(|step| step as f64 * scene.dt).collect();
    if Reference::evaluations(&scene, &instants, Accuracy::TIGHTER) > MAX_EVALUATIONS {
        return Ok(None);
    }
    let outcome = random::judge(scene)?;
    Ok((outcome.failure.is_none() && !outcome.amplifies).then_some(outcome.factor))
}

/// The initial energy of bodies, including that of the longest possible fall during the run.
fn energy_at_start(world: &World) -> f64 {
    let Some(first) = world.conserved() else { return 0.0 };
    let (scene, time) = (world.scene(), f64::from(STEPS) * world.scene().dt);
    let fall = |body: &crate::scene::Body| match &body.motion {
        Motion::Free(free) => {
            let height = free.velocity.length() * time + 0.5 * scene.gravity.length() * time * time;
            body.mass * scene.gravity.length() * height
        }
        Motion::Prescribed(_) => 0.0,
    };
    first.kinetic
        + first.spin
        + first.vibration
        + first.elastic
        + first.plane
        + scene.bodies.iter().map(fall).sum::<f64>()
}

/// Upper bound of the energy that spheres can add initially or at an event.
fn max_influence_energy(scene: &Scene) -> f64 {
    let mut sum = 0.0;
    for (a, body) in scene.bodies.iter().enumerate() {
        for (b, source) in scene.bodies.iter().enumerate().filter(|&(b, _)| b != a) {
            let (law, reach) = (scene.law(a, b), scene.influence.sphere_radius(source.radius));
            let scale = scene.influence.scale(body.radius, source.radius);
            let depth = influence_potential(scene.influence.weight, reach, reach);
            sum += body.mass * scale * (law.alpha + law.beta) * depth;
        }
    }
    sum
}

/// Number of cases of each axis that each integrator passed, stopped or failed.
pub fn table(rows: &[Row]) -> String {
    let integrators: Vec<Integrator> =
        rows.first().map_or(vec![], |row| row.verdicts.iter().map(|verdict| verdict.0).collect());
    let heading =
        ["free bodies", "cases"].map(str::to_owned).into_iter().chain(integrators.iter().map(Integrator::to_string));
    let line = |axis: Axis| {
        let of_axis = || rows.iter().filter(move |row| row.case.axis == axis);
        let cell = |k: usize| {
            let count = |is: fn(&Verdict) -> bool| of_axis().filter(|row| is(&row.verdicts[k].1)).count();
            let passed = count(|verdict| *verdict == Verdict::Passed);
            let failed = count(Verdict::is_failure);
            let stopped = count(|verdict| matches!(verdict, Verdict::NotFollowed(_)));
            let mut text = format!("{passed} passed");
            for (count, what) in [(failed, "failed"), (stopped, "not followed")] {
                if count > 0 {
                    _ = write!(text, ", {count} {what}");
                }
            }
            text
        };
        let cells = (0..integrators.len()).map(cell);
        [axis.name().to_owned(), of_axis().count().to_string()].into_iter().chain(cells).collect::<Vec<_>>()
    };
    let compared = rows.iter().filter(|row| row.is_compared).count();
    format!(
        "{}\nexponential: errors of {compared} of {} cases compared with a reference",
        tables::table(heading.collect::<Vec<_>>(), Axis::ALL.into_iter().map(line)),
        rows.len()
    )
}

/// The cases that an integrator stopped or failed, with the reasons. For the exponential integrator, these are all
/// cases; for the explicit schemes, which fail many for the same reason, only the first of each axis.
pub fn failures(rows: &[Row], of: Integrator) -> Vec<String> {
    let failure = |row: &Row| {
        let (_, verdict) = row.verdicts.iter().find(|verdict| verdict.0 == of)?;
        let what = match verdict {
            Verdict::Passed => return None,
            Verdict::NotFollowed(reason) => format!("not followed: {reason}"),
            Verdict::NotFinite => "not finite".to_owned(),
            Verdict::BeyondBound(factor) => format!("{factor:.1} times the available energy"),
            Verdict::Inaccurate(factor) => format!("{factor:.1} times the error that the tolerance allows"),
        };
        Some(format!("{of}, {}, {}: {what}", row.case.axis.name(), row.case.what))
    };
    let of_axis = |axis: Axis| {
        let all: Vec<String> = rows.iter().filter(|row| row.case.axis == axis).filter_map(failure).collect();
        match &all[..] {
            [first, _, ..] if of != Integrator::Exponential => vec![format!("{first}; {} more", all.len() - 1)],
            _ => all,
        }
    };
    Axis::ALL.into_iter().flat_map(of_axis).collect()
}
