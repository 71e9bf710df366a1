//! A world of rigid bodies, as a physics engine has them: boxes come one after the other, fall, spin, hit a floor and each
//! other, and the first one goes. It has no thresholds, no phase that joins and no net force, names its events as the
//! crate names its own, and has forces at points of contact only.

use std::{sync::Arc, time::Duration};

use glam::{DMat3, DQuat, DVec3};
use meldscope::{
    colors,
    geometry::Mesh,
    hash,
    observe::{
        self, BodyFrame, Experiment, Frame, Instant, InvalidVariation, MotionFrame, PairEvent, PairFrame, Parameter,
        PointForce, Refusal, Schema, Simulation, StepSummary, Variation, Want,
        frame::TermFrame,
        schema::{BodySchema, PlaneSchema, ScalarOf, ScalarSchema, TermSchema},
    },
    recording::{
        Recorded, diff,
        frames::FrameReader,
        replay::{self, Verdict},
    },
    stream::{
        self, Settings,
        settings::{Around, Entities, Trigger},
        sinks::Destinations,
    },
};

use crate::recording::{Dir, Recording};

/// Corner `i` of a box of side 1: bit 0 of its number is that of x.
fn corner(i: usize) -> DVec3 {
    DVec3::from_array([0, 1, 2].map(|axis| (i >> axis & 1) as f64 - 0.5))
}

const CORNERS: usize = 8;
const FACES: [[u32; 3]; 12] = [
    [0, 2, 1],
    [1, 2, 3],
    [4, 5, 6],
    [5, 7, 6],
    [0, 1, 4],
    [1, 5, 4],
    [2, 6, 3],
    [3, 6, 7],
    [0, 4, 2],
    [2, 4, 6],
    [1, 3, 5],
    [3, 7, 5],
];
/// Length of a box's diagonal over 2.
const RADIUS: f64 = 0.866_025_403_784_438_6;
const GRAVITY: DVec3 = DVec3::new(0.0, 0.0, -9.8);
const STEP: f64 = 0.002;

/// Boxes above a floor, whose contacts have this stiffness [1/s²].
#[derive(Clone, Debug)]
pub struct Boxes {
    pub count: usize,
    pub stiffness: f64,
}

#[derive(Clone, Copy, Default)]
struct Rigid {
    centre: DVec3,
    rotation: DQuat,
    velocity: DVec3,
    spin: DVec3,
}

struct Running {
    schema: Schema,
    stiffness: f64,
    step: u64,
    bodies: Vec<Rigid>,
    touching: Vec<bool>,
}

impl Running {
    fn at(&self) -> Instant {
        Instant { step: self.step, time: self.step as f64 * STEP }
    }

    fn pairs(&self) -> impl Iterator<Item = [usize; 2]> + use<> {
        let count = self.bodies.len();
        (0..count).flat_map(move |a| (a + 1..count).map(move |b| [a, b]))
    }

    /// A box comes every 60 steps, and the first one goes after 500.
    fn is_there(&self, body: usize) -> bool {
        self.step >= 60 * body as u64 && (body > 0 || self.step < 500)
    }

    fn q(&self, [a, b]: [usize; 2]) -> f64 {
        self.bodies[a].centre.distance(self.bodies[b].centre) / (2.0 * RADIUS)
    }

    /// Acceleration of a box of mass 1 at corner `i`: the floor, with friction.
    fn floor(&self, body: &Rigid, i: usize) -> DVec3 {
        let arm = body.rotation * corner(i);
        let depth = -(body.centre + arm).z;
        if depth <= 0.0 {
            return DVec3::ZERO;
        }
        let velocity = body.velocity + body.spin.cross(arm);
        let normal = (self.stiffness * depth - 4.0 * velocity.z).max(0.0);
        DVec3::new(-0.3 * normal * velocity.x, -0.3 * normal * velocity.y, normal)
    }

    /// Acceleration of `a` by `b`: their inscribed spheres repel each other.
    fn repulsion(&self, a: usize, b: usize) -> DVec3 {
        if !self.is_there(a) || !self.is_there(b) {
            return DVec3::ZERO;
        }
        let apart = self.bodies[a].centre - self.bodies[b].centre;
        self.stiffness * (1.0 - apart.length()).max(0.0) * apart.normalize_or_zero()
    }
}

impl Simulation for Running {
    fn schema(&self) -> Schema {
        self.schema.clone()
    }
    fn steps_taken(&self) -> u64 {
        self.step
    }
    fn time(&self) -> f64 {
        self.at().time
    }
    fn step(&mut self, summary: &mut StepSummary) {
        let count = self.bodies.len();
        let moved = (0..count).map(|a| {
            let mut body = self.bodies[a];
            if !self.is_there(a) {
                return body;
            }
            let others = (0..count).filter(|&b| b != a).map(|b| self.repulsion(a, b)).sum::<DVec3>();
            let forces: Vec<_> = (0..CORNERS).map(|i| (body.rotation * corner(i), self.floor(&body, i))).collect();
            body.velocity += STEP * (GRAVITY + others + forces.iter().map(|(_, force)| *force).sum::<DVec3>());
            // the moment of inertia of a box of side 1 and mass 1 is 1/6 about any axis
            body.spin += 6.0 * STEP * forces.iter().map(|(arm, force)| arm.cross(*force)).sum::<DVec3>();
            body.centre += STEP * body.velocity;
            body.rotation = (DQuat::from_scaled_axis(STEP * body.spin) * body.rotation).normalize();
            body
        });
        self.bodies = moved.collect();
        self.step += 1;
        let at = self.at();
        (summary.at, summary.timings) = (at, vec![Duration::ZERO]);
        for (index, pair) in self.pairs().enumerate() {
            let (q, was) = (self.q(pair), self.touching[index]);
            self.touching[index] = self.repulsion(pair[0], pair[1]) != DVec3::ZERO;
            if self.touching[index] != was {
                let name = ["part", "touch"][usize::from(!was)];
                summary.events.push(PairEvent::new(name, at, pair, q, [usize::from(was), usize::from(!was)]));
            }
        }
    }
    fn checksum(&self) -> u64 {
        let numbers = self.bodies.iter().flat_map(|body| {
            let [x, y, z, w] = body.rotation.to_array();
            [body.centre, body.velocity, body.spin, DVec3::new(x, y, z)]
                .map(|v| v.to_array())
                .concat()
                .into_iter()
                .chain([w])
        });
        hash::sequence(numbers.map(f64::to_bits))
    }
    fn observe(&self, want: Want, frame: &mut Frame) {
        frame.at = self.at();
        let pairs: Vec<_> =
            self.pairs().filter(|&pair| self.q(pair) < 1.5 && pair.iter().all(|&body| self.is_there(body))).collect();
        let number = |pair: &[usize; 2]| self.pairs().position(|other| other == *pair).expect("a pair");
        let phase = |pair: &[usize; 2]| usize::from(self.touching[number(pair)]);
        frame.pairs = pairs.iter().map(|pair| PairFrame::new(pair[0], pair[1], self.q(*pair), phase(pair))).collect();
        frame.bodies.resize_with(self.bodies.len(), BodyFrame::default);
        for (index, (now, body)) in frame.bodies.iter_mut().zip(&self.bodies).enumerate() {
            (now.centre, now.rotation) = (body.centre, body.rotation);
            now.motion = Some(MotionFrame::new(body.velocity, body.spin));
            now.is_absent = !self.is_there(index);
            now.rest();
            now.clear_forces();
            if want.forces && !now.is_absent {
                let floor =
                    (0..CORNERS).map(|i| PointForce::new(0, body.rotation * corner(i), self.floor(body, i), None));
                let others = (0..self.bodies.len()).filter(|&other| other != index).map(|other| {
                    let force = self.repulsion(index, other);
                    PointForce::new(1, -0.5 * force.normalize_or_zero(), force, Some(other as u32))
                });
                now.point_forces = floor.chain(others).filter(|force| force.acceleration != DVec3::ZERO).collect();
                now.terms = vec![TermFrame::default(); 2];
                now.has_forces = !now.point_forces.is_empty();
            }
        }
        let energy = |(index, body): (usize, &Rigid)| match self.is_there(index) {
            true => 0.5 * body.velocity.length_squared(),
            false => f64::NAN,
        };
        frame.body_scalars = self.bodies.iter().enumerate().map(energy).collect();
        let push = |pair: &[usize; 2]| self.repulsion(pair[0], pair[1]).length();
        frame.pair_scalars = pairs.iter().map(push).collect();
    }
}

impl Experiment for Boxes {
    fn schema(&self) -> Schema {
        let mesh = Mesh::new((0..CORNERS).map(|i| corner(i) / RADIUS).collect(), FACES.to_vec());
        let mesh = Arc::new(mesh.faceted());
        let body = |index: usize| {
            let body = BodySchema::new(&format!("box{index}"), "box", Arc::clone(&mesh), RADIUS, 0.0);
            BodySchema { is_free: true, can_be_absent: true, ..body }
        };
        Schema {
            name: "boxes".to_owned(),
            source: format!("{} {:?}", self.count, self.stiffness),
            integrator: "symplectic".to_owned(),
            dt: STEP,
            steps: 600,
            bodies: (0..self.count).map(body).collect(),
            planes: vec![PlaneSchema { normal: DVec3::Z, offset: 0.0, friction: 0.3 }],
            terms: vec![
                TermSchema::new("floor", "Floor", colors::ORANGE),
                TermSchema { has_source: true, ..TermSchema::new("boxes", "Other boxes", colors::SKY_BLUE) },
            ],
            events: [("touch", "Boxes touch."), ("part", "Boxes part.")].map(Into::into).into(),
            phases: [("apart", colors::SILVER), ("touching", colors::ORANGE)].map(Into::into).into(),
            // as many kinds of energy as the simulation is built of
            body_scalars: ["kinetic"]
                .map(|kind| {
                    ScalarSchema::new(observe::name(&format!("energy_{kind}")), "energy [unit²/s²]", ScalarOf::State)
                })
                .into(),
            pair_scalars: vec![ScalarSchema::new("push", "push [unit/s²]", ScalarOf::State)],
            stages: vec!["step"],
            ..Schema::default()
        }
    }
    fn start(&self) -> Result<Box<dyn Simulation>, String> {
        let body = |index: usize| Rigid {
            centre: DVec3::new(0.3 * (index % 3) as f64, 0.2 * (index % 2) as f64, 1.0 + 1.1 * index as f64),
            rotation: DQuat::from_mat3(&DMat3::from_rotation_y(0.3 * index as f64)),
            spin: DVec3::new(0.5, 0.0, index as f64),
            velocity: DVec3::ZERO,
        };
        Ok(Box::new(Running {
            schema: self.schema(),
            stiffness: self.stiffness,
            step: 0,
            bodies: (0..self.count).map(body).collect(),
            touching: vec![false; self.count * self.count.saturating_sub(1) / 2],
        }))
    }
    fn read(&self, _: &str, text: &str, _: &toml::Table) -> Result<Arc<dyn Experiment>, Refusal> {
        let boxes = || {
            let (count, stiffness) = text.split_once(' ')?;
            Some(Boxes { count: count.parse().ok()?, stiffness: stiffness.parse().ok()? })
        };
        boxes().map(|boxes| Arc::new(boxes) as _).ok_or(Refusal::Source("it is not of boxes".to_owned()))
    }
    fn parameters(&self) -> Vec<Parameter> {
        vec![Parameter {
            key: "stiffness".to_owned(),
            group: "Contacts".to_owned(),
            label: "stiffness".to_owned(),
            unit: "1/s²".to_owned(),
            about: "Stiffness of contacts.".to_owned(),
            value: self.stiffness,
            range: [0.0, 20_000.0],
            can_branch: false,
        }]
    }
    fn varied(&self, variation: &Variation) -> Result<Arc<dyn Experiment>, InvalidVariation> {
        let stiffness = variation.values.get("stiffness").copied().unwrap_or(self.stiffness);
        Ok(Arc::new(Boxes { stiffness, ..self.clone() }))
    }
}

#[test]
fn rigid_bodies_are_recorded_replayed_and_compared() {
    let (dir, stiff, soft) = (Dir::new(), Boxes { count: 4, stiffness: 4000.0 }, Boxes { count: 4, stiffness: 3000.0 });
    assert_eq!(observe::verify(&stiff, 600), Ok(()));
    let record = |name: &str, boxes: &Boxes| {
        let destinations = Destinations { save: Some(dir.file(name)), ..Destinations::default() };
        let around = Around::parse("touch box0~box1", &boxes.schema()).expect("its event");
        let settings = Settings { around: Some(around), ..Settings::of(boxes) };
        assert_eq!(stream::record(boxes, settings, &destinations).expect("a recording"), 601);
        let kind = Boxes { count: 0, stiffness: 0.0 };
        Recorded::open_as(&dir.file(name), &|file, text, run| kind.read(file, text, run)).expect("a recording")
    };
    let (one, other) = (record("one", &stiff), record("other", &soft));
    for recorded in [&one, &other] {
        assert_eq!(replay::verify(recorded, |_| true).expect("it runs"), Verdict::Identical);
    }
    assert!(one.events.len() > 4, "{:?}", one.events);

    // its own events alone have these names
    let recording = Recording::open(&dir.file("one"));
    let entities = recording.entities();
    for entity in
        ["bodies/energy_kinetic/box3", "between/push/box0~box1", "world/forces/floor", "pairs/box0~box1/phase"]
    {
        assert!(entities.contains(&entity.into()), "{entity}");
    }
    assert!(!entities.contains(&"events/surfaces".into()));
    assert!(Trigger::parse("touch", &stiff.schema()).is_ok());

    let same = diff::diff([&one, &one], 1e-6).expect("the same bodies");
    assert_eq!((same.instants, same.first_bits, same.events.len()), (601, None, 0));
    let difference = diff::diff([&one, &other], 1e-6).expect("the same bodies");
    let first = difference.first_beyond.as_ref().expect("they differ");
    // they are equal until the first contact
    assert!((100..400).contains(&first.step), "{}", first.step);
    assert!(!difference.events.is_empty() && difference.to_string().contains("box"), "{difference}");
}

/// What is recorded of a body that is not there says so, as an entity of its own and in a batch.
#[test]
fn bodies_come_and_go_in_a_recording() {
    let (dir, boxes) = (Dir::new(), Boxes { count: 4, stiffness: 4000.0 });
    for (name, entities) in [("body", Entities::Body), ("batch", Entities::Batch)] {
        let destinations = Destinations { save: Some(dir.file(name)), ..Destinations::default() };
        let settings = Settings { entities, ..Settings::of(&boxes) };
        stream::record(&boxes, settings, &destinations).expect("a recording");
        let open = |file: &str, text: &str, run: &toml::Table| boxes.read(file, text, run);
        let recorded = Recorded::open_as(&dir.file(name), &open).expect("a recording");
        let mut frames = FrameReader::open(&recorded).expect("a recording");
        let mut simulation = boxes.start().expect("enough memory");
        let (schema, mut now, mut seen) = (boxes.schema(), Frame::default(), 0);
        while let Some(frame) = frames.next().expect("frames") {
            simulation.observe(Want::default(), &mut now);
            assert_eq!(frame.compare(&schema, &now), None, "{name}, step {}", frame.step);
            for (index, body) in now.bodies.iter().enumerate() {
                let surface = frame.local_positions(index).expect("a surface");
                let extent = surface.iter().map(|position| position.length()).fold(0.0, f64::max);
                let expected = if body.is_absent { 0.0 } else { RADIUS };
                assert!((extent - expected).abs() < 1e-6, "{name}, step {}, box {index}: {extent}", frame.step);
                seen += u64::from(body.is_absent);
            }
            simulation.step(&mut StepSummary::default());
        }
        assert_eq!(seen, 60 + 120 + 180 + 101);
    }
}
