//! Free bodies at the limits: mass ratios, spins, deep overlap, corners of planes, stacks, stiff springs.
//!
//! The energy of free bodies is bounded by the initial kinetic energy, the initial potential energy of planes and
//! gravity, and the maximum that spheres can add initially and at each event. A run that exceeds this bound by the
//! factor [`super::MARGIN`], or is not finite, is not a solution. Runs that the integrator ends with a reason are
//! counted separately.
//!
//! A run of the exponential integrator is also compared with a [`Reference`], where there is one that does not take too
//! long: its error at any time must be within the tolerance, unless the motion itself amplifies errors.

use rayon::prelude::*;

use super::{Judged, MARGIN, Verdict};
use crate::{
    Scene, SceneError, World,
    bench::{
        MeasureError,
        judge::judge,
        reference::{Accuracy, Reference},
    },
    model::energy::influence_potential,
    scene::{Integrator, Motion},
};

/// Steps of each case.
const STEPS: u32 = 60;

/// A reference is computed only if it takes at most this many evaluations of a vertex's equation of motion.
const MAX_EVALUATIONS: f64 = 1e8;

/// A scene with free bodies that is hard for integrators.
#[derive(Clone, Debug)]
struct Case {
    /// The setting that it takes to its limits.
    axis: &'static str,
    /// A short description with the relevant numbers.
    what: String,
    scene: Scene,
}

fn case(axis: &'static str, what: String, text: &str) -> Result<Case, SceneError> {
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
fn cases() -> Result<Vec<Case>, SceneError> {
    let mut cases = Vec::new();
    let core = "[influence]\ncore_at = 0.6\ncore_width = 0.3\n";
    for ratio in [1e1, 1e2, 1e3, 1e4, 1e5, 1e6] {
        for speed in [1.0, 6.0] {
            let text = core.to_owned()
                + &ball("heavy", &format!("mass = {ratio:e}"), "from = [-1.2, 0, 0]")
                + &ball("light", "mass = 1.0", &format!("from = [1.2, 0.2, 0], velocity = [{:?}, 0, 0]", -speed));
            cases.push(case("mass ratios to 1e6", format!("1:{ratio:.0e} at {speed}/s"), &text)?);
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
                cases.push(case("spins to 1e4 rad/s", format!("{spin:.0e} rad/s, ω {omega}, {how}"), &text)?);
            }
        }
    }
    for distance in [0.0, 1e-12, 1e-6, 1e-2, 0.3] {
        for (what, law) in [("", ""), (", core", core)] {
            let text = law.to_owned()
                + &ball("a", "", "from = [0, 0, 0]")
                + &ball("b", "", &format!("from = [{distance:?}, 0, 0]"))
                + &ball("c", "", "from = [0, 0.1, 0.1], spin = [1, 0, 0]");
            cases.push(case("deep overlap", format!("{distance:.0e} apart{what}"), &text)?);
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
            cases.push(case("corners of planes", format!("k {stiffness:.0e}, μ {friction}"), &text)?);
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
        cases.push(case("stacks of 50", format!("κ {damping}"), &text)?);
    }
    for reduced in [1.0, 1e1, 1e2, 1e3] {
        for damping in [0.0, 0.1] {
            let omega = reduced * 60.0;
            let lines = format!("omega = {omega:?}\ndamping = {:?}", damping * omega);
            let text = core.to_owned()
                + &ball("a", &lines, "from = [-1.2, 0.1, 0], velocity = [2, 0, 0], spin = [0, 1, 0]")
                + &ball("b", &lines, "from = [1.2, -0.1, 0], velocity = [-2, 0, 0]");
            cases.push(case("ωΔt to 1e3", format!("ωΔt {reduced:.0e}, κ {damping} ω"), &text)?);
        }
    }
    Ok(cases)
}

/// Runs all cases with some integrators, on all cores.
///
/// # Errors
/// [`MeasureError`]
pub fn measure(integrators: &[Integrator]) -> Result<Vec<Judged>, MeasureError> {
    let judged = |case: Case| {
        let verdict = |&integrator: &Integrator| Ok((integrator.name(), verdict(&case.scene, integrator)?));
        let verdicts = integrators.iter().map(verdict).collect::<Result<_, MeasureError>>()?;
        Ok(Judged { axis: case.axis, what: case.what, verdicts })
    };
    cases()?.into_par_iter().map(judged).collect()
}

fn verdict(scene: &Scene, integrator: Integrator) -> Result<Verdict, MeasureError> {
    let verdict = run(scene, integrator)?;
    if integrator == Integrator::Exponential
        && verdict == Verdict::Passed
        && let Some(factor) = excess(scene)?.filter(|&factor| factor > 1.0)
    {
        return Ok(Verdict::Failed(format!("{factor:.1} times the error that the tolerance allows")));
    }
    Ok(verdict)
}

fn run(scene: &Scene, integrator: Integrator) -> Result<Verdict, MeasureError> {
    let mut world = World::new(Scene { integrator, ..scene.clone() })?;
    let by_influence = max_influence_energy(scene);
    let (mut bound, mut used) = (energy_at_start(&world) + by_influence, 0.0);
    for _ in 0..STEPS {
        let report = world.step();
        bound += by_influence * report.events.len() as f64;
        if let Some(failure) = report.failure.as_ref().filter(|failure| !failure.is_whole_step()) {
            return Ok(Verdict::Stopped(failure.to_string()));
        }
        let Some(now) = world.conserved() else { continue };
        let energy = now.kinetic + now.spin + now.vibration + now.elastic + now.plane;
        used = if energy / bound > used || energy.is_nan() { energy / bound } else { used };
        if !(used < f64::INFINITY) {
            return Ok(Verdict::Failed("not finite".to_owned()));
        }
    }
    Ok(match used {
        ..=MARGIN => Verdict::Passed,
        _ => Verdict::Failed(format!("{used:.1} times the available energy")),
    })
}

/// The largest ratio of an error to what the tolerance allows; `None` without a reference, or if the motion amplifies.
fn excess(scene: &Scene) -> Result<Option<f64>, MeasureError> {
    let scene = Scene { duration: f64::from(STEPS) * scene.dt, ..scene.clone() };
    let instants: Vec<f64> = (0..=scene.steps()).map(|step| step as f64 * scene.dt).collect();
    if Reference::evaluations(&scene, &instants, Accuracy::TIGHTER) > MAX_EVALUATIONS {
        return Ok(None);
    }
    let outcome = judge(scene)?;
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
            let (law, reach) = (scene.law(a, b), source.sphere_radius());
            let scale = scene.influence.scale(body.radius, source.radius);
            let depth = influence_potential(scene.influence.weight, reach, reach);
            sum += body.mass * scale * (law.alpha + law.beta) * depth;
        }
    }
    sum
}
