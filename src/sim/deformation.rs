//! What single vertices of a body do, beyond what all of them do alike.
//!
//! A vertex that nothing single ever happened to has no state. One near a sphere is in the front, where its state is that
//! at the end of the last step. One that a sphere has left alone swings freely: its state is kept as it was then, and the
//! exact flow takes it to any later time in one go, when somebody asks.

use std::sync::OnceLock;

use glam::DVec3;

use super::{
    arrays::Vectors,
    integrator::{
        State,
        exponential::{
            course::{Common, Pushed},
            lanes::LANES,
        },
    },
};
use crate::{model::oscillator::Oscillator, scene::Push};

/// The single vertices of a body that are not at rest.
#[derive(Clone, Debug, Default)]
pub struct Deformation {
    /// Those near a sphere.
    pub front: Front,
    /// Those that swing freely.
    pub swinging: Swinging,
    /// Where each vertex is, `[vertex_count]`; empty if all are at rest.
    places: Vec<Place>,
    /// Of all but the states of the front, when it was asked for since that last changed.
    pub hash_of_kept: OnceLock<u64>,
}

/// Vertices that take every step, as arrays that are read in lanes: padded with repetitions of the last.
#[derive(Clone, Debug, Default)]
pub struct Front {
    /// Which they are, without padding.
    pub vertices: Vec<u32>,
    /// Rest positions [scene unit].
    pub rest: Vectors,
    /// Displacements [scene unit] …
    pub displacement: Vectors,
    /// … and velocities [scene unit/s] at the end of the last step.
    pub velocity: Vectors,
}

/// Vertices that swing freely.
#[derive(Clone, Debug, Default)]
pub struct Swinging {
    /// Which they are.
    pub vertices: Vec<u32>,
    /// The step at whose end they had the state below.
    pub as_of: Vec<u64>,
    /// Displacements then [scene unit].
    pub displacement: Vectors,
    /// Velocities then [scene unit/s].
    pub velocity: Vectors,
    /// How far each swings at most [scene unit].
    pub amplitude: Vec<f64>,
    /// The largest of these.
    pub largest: f64,
}

/// Where the state of a vertex is kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    Rest,
    Front(u32),
    Swinging(u32),
}

/// Reused from step to step.
#[derive(Clone, Debug, Default)]
pub struct Scratch {
    front: Front,
    swinging: Swinging,
    amplitude: Vec<f64>,
    chosen: Vec<u32>,
}

/// The time that a state is wanted at.
#[derive(Clone, Copy, Debug)]
pub struct Now {
    /// Steps taken.
    pub step: u64,
    /// Δt [s].
    pub dt: f64,
    /// Of the body.
    pub oscillator: Oscillator,
}

impl Deformation {
    /// Whether nothing single has happened to any vertex.
    pub fn is_empty(&self) -> bool {
        self.front.vertices.is_empty() && self.swinging.vertices.is_empty()
    }

    /// What was allocated for it [bytes].
    pub fn memory(&self) -> usize {
        let Deformation { front, swinging, places, .. } = self;
        let vectors = [&front.rest, &front.displacement, &front.velocity, &swinging.displacement, &swinging.velocity];
        vectors.into_iter().map(Vectors::memory).sum::<usize>()
            + (front.vertices.capacity() + swinging.vertices.capacity()) * size_of::<u32>()
            + swinging.as_of.capacity() * size_of::<u64>()
            + swinging.amplitude.capacity() * size_of::<f64>()
            + places.capacity() * size_of::<Place>()
    }

    /// The state of one vertex at the end of the last step.
    pub fn state(&self, vertex: usize, now: Now) -> State {
        match self.places.get(vertex) {
            None | Some(Place::Rest) => State::default(),
            Some(&Place::Front(i)) => self.front.state(i as usize),
            Some(&Place::Swinging(i)) => self.swinging.state(i as usize, now, &mut Flow::none()),
        }
    }

    /// Adds the states of all vertices at the end of the last step to those in the arrays.
    pub fn add_to(&self, displacement: &mut Vectors, velocity: &mut Vectors, now: Now) {
        let mut add = |vertex: u32, State { x, u }: State| {
            let v = vertex as usize;
            displacement.set(v, displacement.get(v) + x);
            velocity.set(v, velocity.get(v) + u);
        };
        for (i, &vertex) in self.front.vertices.iter().enumerate() {
            add(vertex, self.front.state(i));
        }
        let mut flow = Flow::none();
        for (i, &vertex) in self.swinging.vertices.iter().enumerate() {
            add(vertex, self.swinging.state(i, now, &mut flow));
        }
    }

    /// Puts all vertices into the front, in their order, those that were at rest with a state of zero.
    pub fn wake_all(&mut self, unit: &Vectors, radius: f64) {
        if !self.is_empty() {
            return;
        }
        self.hash_of_kept.take();
        self.places.extend((0..unit.len() as u32).map(Place::Front));
        self.front.clear();
        for (i, unit) in unit.iter().enumerate() {
            self.front.push(i as u32, radius * unit, State::default());
        }
        self.front.pad();
    }

    /// Makes what all vertices do alike part of what each does, all of them being in the front.
    pub fn absorb(&mut self, common: &mut Common, unit: &Vectors, pushes: &[Push]) {
        if common.is_zero() {
            return;
        }
        for (i, &vertex) in self.front.vertices.iter().enumerate() {
            let (alike, own) = (common.of(unit.get(vertex as usize), pushes), self.front.state(i));
            self.front.displacement.set(i, alike.x + own.x);
            self.front.velocity.set(i, alike.u + own.u);
        }
        self.front.pad_again();
        common.carried = State::default();
        common.pushed.fill(Pushed::default());
    }

    /// Puts all vertices at rest.
    pub fn clear(&mut self) {
        self.hash_of_kept.take();
        self.front.clear();
        self.swinging.clear();
        self.places.clear();
    }

    /// Chooses the front anew: the vertices whose `gap` [scene unit], by which their rest position is outside of every
    /// sphere, is no more than `skin` and what they may swing. The others swing freely from now on.
    pub fn choose_front(
        &mut self,
        unit: &Vectors,
        radius: f64,
        gap: &[f64],
        skin: f64,
        now: Now,
        scratch: &mut Scratch,
    ) {
        self.hash_of_kept.take();
        let omega = now.oscillator.omega;
        if self.places.is_empty() {
            self.places.resize(unit.len(), Place::Rest);
        }
        let Scratch { front, swinging, amplitude, chosen } = scratch;
        amplitude.clear();
        amplitude.resize(unit.len(), 0.0);
        for (i, &vertex) in self.front.vertices.iter().enumerate() {
            amplitude[vertex as usize] = swing(self.front.state(i), omega);
        }
        for (&vertex, &swing) in self.swinging.vertices.iter().zip(&self.swinging.amplitude) {
            amplitude[vertex as usize] = swing;
        }
        // Those inside a sphere first: vertices side by side then have the same to do. What is not a number is in.
        chosen.clear();
        chosen.extend((0..unit.len() as u32).filter(|&v| gap[v as usize] < 0.0));
        chosen.extend((0..unit.len() as u32).filter(|&v| {
            let v = v as usize;
            !(gap[v] < 0.0 || gap[v] - amplitude[v] > skin)
        }));

        front.clear();
        swinging.clear();
        let mut flow = Flow::none();
        for &v in chosen.iter() {
            let place = &mut self.places[v as usize];
            let state = match *place {
                Place::Rest => State::default(),
                Place::Front(i) => self.front.state(i as usize),
                Place::Swinging(i) => self.swinging.state(i as usize, now, &mut flow),
            };
            *place = Place::Front(u32::MAX); // chosen; its index comes below
            front.push(v, radius * unit.get(v as usize), state);
        }
        for (i, &v) in self.front.vertices.iter().enumerate() {
            if self.places[v as usize] == Place::Front(i as u32) {
                let state = self.front.state(i);
                self.places[v as usize] = swinging.push(v, now.step, state, amplitude[v as usize]);
            }
        }
        for (i, &v) in self.swinging.vertices.iter().enumerate() {
            if self.places[v as usize] == Place::Swinging(i as u32) {
                let state = State { x: self.swinging.displacement.get(i), u: self.swinging.velocity.get(i) };
                self.places[v as usize] = swinging.push(v, self.swinging.as_of[i], state, amplitude[v as usize]);
            }
        }
        for (i, &v) in front.vertices.iter().enumerate() {
            self.places[v as usize] = Place::Front(i as u32);
        }
        front.pad();
        self.front.copy_from(front);
        self.swinging.copy_from(swinging);
        if self.is_empty() {
            self.places.clear();
        }
    }

    /// Lets all vertices swing freely from now on.
    pub fn let_go(&mut self, now: Now) {
        self.hash_of_kept.take();
        for i in 0..self.front.vertices.len() {
            let (v, state) = (self.front.vertices[i], self.front.state(i));
            let amplitude = swing(state, now.oscillator.omega);
            self.places[v as usize] = self.swinging.push(v, now.step, state, amplitude);
        }
        self.front.clear();
        if self.is_empty() {
            self.places.clear();
        }
    }
}

/// How far from rest a vertex swings by itself [scene unit]: no less than |x| at any time to come.
fn swing(State { x, u }: State, omega: f64) -> f64 {
    if x == DVec3::ZERO && u == DVec3::ZERO {
        return 0.0;
    }
    if omega == 0.0 {
        return f64::INFINITY; // it may drift anywhere
    }
    (x.length_squared() + (u / omega).length_squared()).sqrt()
}

/// A flow over some steps, kept for the next who wants the same.
struct Flow {
    steps: u64,
    matrix: [f64; 4],
}

impl Flow {
    fn none() -> Flow {
        Flow { steps: 0, matrix: [1.0, 0.0, 0.0, 1.0] }
    }
}

impl Front {
    fn state(&self, i: usize) -> State {
        State { x: self.displacement.get(i), u: self.velocity.get(i) }
    }

    fn clear(&mut self) {
        self.vertices.clear();
        for vectors in [&mut self.rest, &mut self.displacement, &mut self.velocity] {
            vectors.clear();
        }
    }

    fn push(&mut self, vertex: u32, rest: DVec3, state: State) {
        self.vertices.push(vertex);
        self.rest.push(rest);
        self.displacement.push(state.x);
        self.velocity.push(state.u);
    }

    /// Repeats the last again after all have been changed.
    pub fn pad_again(&mut self) {
        let count = self.vertices.len();
        for vectors in [&mut self.displacement, &mut self.velocity] {
            for i in count..vectors.len() {
                vectors.set(i, vectors.get(count - 1));
            }
        }
    }

    fn pad(&mut self) {
        let count = self.vertices.len();
        for vectors in [&mut self.rest, &mut self.displacement, &mut self.velocity] {
            for _ in count..count.next_multiple_of(LANES) {
                vectors.push(vectors.get(count - 1));
            }
        }
    }

    fn copy_from(&mut self, other: &Front) {
        self.clear();
        self.vertices.extend_from_slice(&other.vertices);
        self.rest.extend(&other.rest);
        self.displacement.extend(&other.displacement);
        self.velocity.extend(&other.velocity);
    }
}

impl Swinging {
    /// The state of one of them at the end of the last step.
    fn state(&self, i: usize, now: Now, flow: &mut Flow) -> State {
        let steps = now.step - self.as_of[i];
        if steps != flow.steps {
            *flow = Flow { steps, matrix: now.oscillator.flow(steps as f64 * now.dt) };
        }
        let (x, u) = (self.displacement.get(i), self.velocity.get(i));
        let [xx, xu, ux, uu] = flow.matrix;
        State { x: xx * x + xu * u, u: ux * x + uu * u }
    }

    fn clear(&mut self) {
        self.vertices.clear();
        self.as_of.clear();
        self.displacement.clear();
        self.velocity.clear();
        self.amplitude.clear();
        self.largest = 0.0;
    }

    /// Adds a vertex, unless it rests.
    fn push(&mut self, vertex: u32, as_of: u64, state: State, amplitude: f64) -> Place {
        if amplitude == 0.0 {
            return Place::Rest;
        }
        self.vertices.push(vertex);
        self.as_of.push(as_of);
        self.displacement.push(state.x);
        self.velocity.push(state.u);
        self.amplitude.push(amplitude);
        self.largest = self.largest.max(amplitude);
        Place::Swinging(self.vertices.len() as u32 - 1)
    }

    fn copy_from(&mut self, other: &Swinging) {
        self.clear();
        self.vertices.extend_from_slice(&other.vertices);
        self.as_of.extend_from_slice(&other.as_of);
        self.displacement.extend(&other.displacement);
        self.velocity.extend(&other.velocity);
        self.amplitude.extend_from_slice(&other.amplitude);
        self.largest = other.largest;
    }
}
