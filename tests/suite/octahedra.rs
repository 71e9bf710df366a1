//! A simulation that shares nothing with this crate's. Two octahedra pass each other; each corner is pulled back to its
//! rest position and, while the octahedra grip, towards the other octahedron. The second one rotates about z. Any others
//! rest far away.

use std::{sync::Arc, time::Duration};

use glam::{DQuat, DVec3};
use meldscope::{
    colors,
    geometry::{Mesh, Vectors},
    hash,
    observe::{
        BodyFrame, Experiment, Frame, Instant, InvalidVariation, PairEvent, PairFrame, Parameter, Refusal, Schema,
        Simulation, StepSummary, Variation, Want,
        frame::TermFrame,
        schema::{BodySchema, ScalarOf, ScalarSchema, TermSchema},
    },
};

const AXES: [DVec3; 6] = [DVec3::X, DVec3::Y, DVec3::Z, DVec3::NEG_X, DVec3::NEG_Y, DVec3::NEG_Z];
const FACES: [[u32; 3]; 8] = [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]];
const GRIP: f64 = 0.8;
const SLIP: f64 = 1.1;

/// Two octahedra or more.
#[derive(Clone, Debug)]
pub struct Octahedra {
    /// Strength of the grip [1/s²].
    pub pull: f64,
    /// Their number.
    pub bodies: usize,
}

impl Octahedra {
    /// Two octahedra.
    pub fn two(pull: f64) -> Octahedra {
        Octahedra { pull, bodies: 2 }
    }
}

struct Projected {
    schema: Schema,
    pull: f64,
    step: u64,
    moved: Vec<Vectors>,
    velocity: Vec<Vectors>,
    phase: usize,
}

impl Projected {
    fn centre(&self, body: usize) -> DVec3 {
        match body {
            1 => DVec3::new(4.0 * self.time() - 4.0, 1.2, 0.0),
            _ => 8.0 * body as f64 * DVec3::Y,
        }
    }

    fn rotation(&self, body: usize) -> DQuat {
        if body == 1 { DQuat::from_rotation_z(1.3 * self.time()) } else { DQuat::IDENTITY }
    }

    fn at(&self) -> Instant {
        Instant { step: self.step, time: self.time() }
    }

    fn forces(&self, body: usize, i: usize) -> [DVec3; 2] {
        let grip = if self.phase == 1 && body < 2 { self.pull } else { 0.0 };
        [-50.0 * self.moved[body].get(i), grip * (self.centre(usize::from(body == 0)) - self.centre(body))]
    }
}

impl Simulation for Projected {
    fn schema(&self) -> Schema {
        self.schema.clone()
    }
    fn steps_taken(&self) -> u64 {
        self.step
    }
    fn time(&self) -> f64 {
        self.step as f64 * self.schema.dt
    }
    fn step(&mut self, summary: &mut StepSummary) {
        for (body, i) in (0..self.moved.len()).flat_map(|body| (0..AXES.len()).map(move |i| (body, i))) {
            let (x, dt) = (self.moved[body].get(i), self.schema.dt);
            let u = 0.98 * self.velocity[body].get(i) + dt * self.forces(body, i).iter().sum::<DVec3>();
            self.velocity[body].set(i, u);
            self.moved[body].set(i, x + dt * u);
        }
        self.step += 1;
        let (from, q, at) = (self.phase, self.centre(1).length() / 2.0, self.at());
        self.phase = usize::from(q < if from == 1 { SLIP } else { GRIP });
        let name = ["slip", "grip"][self.phase];
        let event = PairEvent::new(name, at, [0, 1], q, [from, self.phase]);
        summary.events.extend((from != self.phase).then_some(event));
        (summary.at, summary.timings, summary.scalars) = (at, vec![Duration::ZERO], vec![0.0, 12.0]);
    }
    fn checksum(&self) -> u64 {
        let numbers = self.moved.iter().chain(&self.velocity).flat_map(Vectors::iter).flat_map(|v| v.to_array());
        hash::sequence(numbers.map(f64::to_bits).chain([self.phase as u64]))
    }
    fn observe(&self, want: Want, frame: &mut Frame) {
        frame.at = self.at();
        frame.pairs = vec![PairFrame::new(0, 1, self.centre(1).length() / 2.0, self.phase)];
        frame.bodies.resize_with(self.moved.len(), BodyFrame::default);
        for (body, now) in frame.bodies.iter_mut().enumerate() {
            (now.centre, now.rotation) = (self.centre(body), self.rotation(body));
            (now.displacements, now.velocities) = (self.moved[body].clone(), self.velocity[body].clone());
            now.displaced(self.schema.bodies[body].rest());
            if want.forces {
                let forces: Vec<_> = (0..AXES.len()).map(|i| self.forces(body, i)).collect();
                let spring = (forces.iter().map(|[spring, _]| *spring).collect(), None);
                let grip = (forces.iter().map(|[_, grip]| *grip).collect(), Some(u32::from(body == 0)));
                let net = (forces.iter().map(|[spring, grip]| *spring + *grip).collect(), None);
                now.terms =
                    [spring, grip, net].map(|(accelerations, source)| TermFrame::new(accelerations, source)).into();
                (now.has_forces, now.labels) = (true, vec![self.phase as u8; AXES.len()]);
            }
        }
        frame.scalars = vec![self.moved[0].iter().map(DVec3::length).sum(), 0.0];
        let fastest = |corners: &Vectors| corners.iter().map(DVec3::length).fold(0.0, f64::max);
        frame.body_scalars = self.velocity.iter().map(fastest).collect();
        frame.pair_scalars = vec![if self.phase == 1 { self.forces(0, 0)[1].length() } else { f64::NAN }];
    }
}

impl Experiment for Octahedra {
    fn schema(&self) -> Schema {
        let mesh = Arc::new(Mesh::new(AXES.into_iter().collect(), FACES.to_vec()));
        let body = |index: usize| {
            let name = char::from(b'a' + index as u8).to_string();
            let body = BodySchema::new(&name, "octahedron", Arc::clone(&mesh), 1.0, 2.0);
            BodySchema { is_free: index == 1, ..body }
        };
        let grip = TermSchema { has_source: true, ..TermSchema::new("grip", "Grip", colors::ORANGE) };
        let net = TermSchema { is_sum: true, ..TermSchema::new("net", "Net", colors::WHITE) };
        let terms = [TermSchema::new("spring", "Spring", colors::GREEN), grip, net];
        Schema {
            name: "octahedra".to_owned(),
            source: format!("{:?} {}", self.pull, self.bodies),
            dt: 0.02,
            steps: 100,
            bodies: (0..self.bodies).map(body).collect(),
            terms: terms.into(),
            labels: vec!["free", "held"],
            events: [("grip", "They come closer."), ("slip", "They part.")].map(Into::into).into(),
            phases: [("loose", colors::SILVER), ("gripped", colors::ORANGE)].map(Into::into).into(),
            thresholds: [("grip_at", GRIP, colors::ORANGE), ("slip_at", SLIP, colors::SILVER)].map(Into::into).into(),
            scalars: vec![
                ScalarSchema::new("stretch", "stretch [unit]", ScalarOf::State),
                ScalarSchema::new("projections", "projections", ScalarOf::SumOfSteps),
            ],
            body_scalars: vec![ScalarSchema::new("corner_speed", "fastest corner [unit/s]", ScalarOf::State)],
            pair_scalars: vec![ScalarSchema::new("hold", "pull of the grip [unit/s²]", ScalarOf::State)],
            stages: vec!["project"],
            ..Schema::default()
        }
    }
    fn start(&self) -> Result<Box<dyn Simulation>, String> {
        let zeros = || vec![Vectors::zeros(AXES.len()); self.bodies];
        let (moved, velocity, schema) = (zeros(), zeros(), self.schema());
        Ok(Box::new(Projected { schema, pull: self.pull, step: 0, moved, velocity, phase: 0 }))
    }
    fn read(&self, _: &str, text: &str, _: &toml::Table) -> Result<Arc<dyn Experiment>, Refusal> {
        let octahedra = || {
            let (pull, bodies) = text.split_once(' ')?;
            Some(Octahedra { pull: pull.parse().ok()?, bodies: bodies.parse().ok()? })
        };
        octahedra().map(|octahedra| Arc::new(octahedra) as _).ok_or(Refusal::Source("it has no pull".to_owned()))
    }
    fn parameters(&self) -> Vec<Parameter> {
        vec![Parameter {
            key: "pull".to_owned(),
            group: "Grip".to_owned(),
            label: "pull".to_owned(),
            unit: "1/s²".to_owned(),
            about: "Strength of the grip.".to_owned(),
            value: self.pull,
            range: [0.0, 10.0],
            can_branch: false,
        }]
    }
    fn varied(&self, variation: &Variation) -> Result<Arc<dyn Experiment>, InvalidVariation> {
        let pull = variation.values.get("pull").copied().unwrap_or(self.pull);
        match pull >= 0.0 {
            true => Ok(Arc::new(Octahedra { pull, ..self.clone() })),
            false => {
                Err(InvalidVariation { key: Some("pull".to_owned()), text: "pull: expected 0 or more".to_owned() })
            }
        }
    }
}
