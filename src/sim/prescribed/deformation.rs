//! The motion of single vertices of a body, in addition to their shared motion.
//!
//! A vertex that has only ever followed the shared motion has no state here. One near a sphere is in the active set,
//! which holds its state at the end of the last step. One that no sphere reaches any more is free: its state is kept
//! from the time of its release, and the exact flow advances it to any later time on request.

use std::cell::Cell;

use glam::DVec3;
use pulp::{Arch, Simd, WithSimd};

use crate::{
    geometry::Rest,
    model::oscillator::Oscillator,
    sim::{
        numerics::{
            arrays::{Block, Blocks, LANES, Lanes, Vectors},
            larger,
        },
        state::State,
    },
};

/// The state of the single vertices of a body that are not at rest.
#[derive(Clone, Debug, Default)]
pub struct Deformation {
    /// The vertices near a sphere.
    pub active_set: ActiveSet,
    /// The vertices that oscillate freely.
    pub free_vertices: FreeVertices,
}

/// Index of the displacements in a block [scene unit].
pub const DISPLACEMENT: usize = 0;
/// Index of the velocities in a block [scene unit/s].
pub const VELOCITY: usize = 1;
/// Index of the rest positions in a block of the active set [scene unit].
const REST_POSITION: usize = 2;

/// Vertices that are advanced in every step.
#[derive(Clone, Debug, Default)]
pub struct ActiveSet {
    /// Indices of these vertices.
    pub vertices: Vec<u32>,
    /// Displacements and velocities at the end of the last step, and rest positions; padded by repeating the last
    /// vertex.
    pub blocks: Blocks<3>,
}

/// Vertices that oscillate freely.
#[derive(Clone, Debug, Default)]
pub struct FreeVertices {
    /// Indices of these vertices, ascending.
    pub vertices: Vec<u32>,
    /// The step at whose end they had the states in `blocks`.
    pub as_of: u64,
    /// Displacements and velocities at the end of step `as_of`.
    pub blocks: Blocks<2>,
    /// An upper bound of their amplitudes [scene unit].
    pub largest: f64,
}

/// Buffers for selecting an active set, reused from step to step. They only grow, and hold values of earlier selections
/// beyond what is in use.
#[derive(Clone, Debug, Default)]
pub struct Scratch {
    /// Displacements and velocities at the end of the last step: those of the active set so far, padded to whole blocks,
    /// then those of the free vertices, then a block of zeros.
    states: Vec<Block<2>>,
    /// Amplitudes of these states [scene unit].
    amplitudes_of_states: Vec<[f64; LANES]>,
    /// For each vertex, its index in `states`; that of a zero for vertices that have only followed the shared motion.
    slots: Vec<u32>,
    /// Amplitude of each vertex [scene unit].
    amplitudes: Vec<f64>,
    /// The vertices selected for the active set.
    active_set: Vec<u32>,
    /// The vertices of the active set that are inside no sphere.
    outside: Vec<u32>,
    /// The vertices that will be free.
    free_vertices: Vec<u32>,
}

impl Scratch {
    /// The state of a vertex: block and lane.
    #[inline(always)]
    fn state(&self, vertex: usize) -> (&[Lanes; 2], usize) {
        let slot = self.slots[vertex] as usize;
        (&self.states[slot / LANES].0, slot % LANES)
    }
}

/// The time at which a state is requested.
#[derive(Clone, Copy, Debug)]
pub struct Now {
    /// Steps taken.
    pub step: u64,
    /// Δt [s].
    pub dt: f64,
    /// The body's oscillator.
    pub oscillator: Oscillator,
    /// The instruction set of the kernels.
    pub arch: Arch,
}

impl Now {
    /// Simulated time [s].
    pub fn time(&self) -> f64 {
        self.step as f64 * self.dt
    }
}

/// A displacement or velocity below this counts as rest [scene unit, scene unit/s]: subnormal numbers are slow to
/// compute with.
pub const REST: f64 = 1e-150;

impl Deformation {
    /// Whether every vertex has only followed the shared motion.
    pub fn is_empty(&self) -> bool {
        self.active_set.vertices.is_empty() && self.free_vertices.vertices.is_empty()
    }

    /// The state of one vertex at the end of the last step.
    pub fn state(&self, vertex: usize, now: Now) -> State {
        let v = vertex as u32;
        if let Ok(i) = self.free_vertices.vertices.binary_search(&v) {
            return self.free_vertices.flow(now).map_or(State::default(), |flow| self.free_vertices.state(i, flow));
        }
        let active_set = &self.active_set.vertices;
        let all = (active_set.get(vertex) == Some(&v)).then_some(vertex);
        let slot = all.or_else(|| active_set.iter().position(|&other| other == v));
        slot.map_or(State::default(), |i| self.active_set.state(i))
    }

    /// Adds the states of all vertices at the end of the last step to the arrays.
    pub fn add_to(&self, displacement: &mut Vectors, velocity: &mut Vectors, now: Now) {
        for (i, &vertex) in self.active_set.vertices.iter().enumerate() {
            let (v, State { x, u }) = (vertex as usize, self.active_set.state(i));
            displacement.set(v, displacement.get(v) + x);
            velocity.set(v, velocity.get(v) + u);
        }
        let free_vertices = &self.free_vertices;
        let Some(flow) = free_vertices.flow(now).filter(|_| !free_vertices.vertices.is_empty()) else { return };
        for (i, &vertex) in free_vertices.vertices.iter().enumerate() {
            let (v, State { x, u }) = (vertex as usize, free_vertices.state(i, flow));
            displacement.set(v, displacement.get(v) + x);
            velocity.set(v, velocity.get(v) + u);
        }
    }

    /// Puts all vertices into the active set, in order; those at rest get a state of zero.
    pub fn wake_all(&mut self, rest: Rest<'_>) {
        if !self.is_empty() {
            return;
        }
        let ActiveSet { vertices, blocks } = &mut self.active_set;
        vertices.extend(0..rest.len() as u32);
        blocks.resize(rest.len());
        for i in 0..rest.len() {
            blocks.set(REST_POSITION, i, rest.position(i));
        }
        self.active_set.pad_again();
    }

    /// Brings all vertices to rest.
    pub fn clear(&mut self) {
        self.active_set.clear();
        self.free_vertices.clear();
    }

    /// Gathers the states of all vertices and the amplitude of each.
    fn gather(&self, count: usize, now: Now, scratch: &mut Scratch) {
        let Scratch { states, amplitudes_of_states, slots, amplitudes, .. } = scratch;
        let Deformation { active_set, free_vertices } = self;
        let flow = free_vertices.flow(now);
        let free_blocks = if flow.is_some() { free_vertices.blocks.all() } else { &[] };
        let first_free = active_set.blocks.all().len();
        let zeros = first_free + free_blocks.len();
        // however the vertices are divided: two blocks may be incomplete
        let max_blocks = count.div_ceil(LANES) + 2;
        if states.len() < max_blocks {
            states.resize(max_blocks, Block([[[0.0; LANES]; 3]; 2]));
            amplitudes_of_states.resize(max_blocks, [0.0; LANES]);
        }
        now.arch.dispatch(Gather {
            omega: now.oscillator.omega,
            active_set: active_set.blocks.all(),
            free_vertices: free_blocks,
            flow: flow.unwrap_or_default(),
            states: &mut states[..zeros],
            amplitudes: &mut amplitudes_of_states[..zeros],
        });
        states[zeros] = Block([[[0.0; LANES]; 3]; 2]);

        slots.clear();
        slots.resize(count, (zeros * LANES) as u32);
        amplitudes.clear();
        amplitudes.resize(count, 0.0);
        let free = if flow.is_some() { &*free_vertices.vertices } else { &[] };
        for (first, vertices) in [(0, &*active_set.vertices), (first_free, free)] {
            for (block, vertices) in (first..).zip(vertices.chunks(LANES)) {
                let of_block = &amplitudes_of_states[block];
                for (lane, &vertex) in vertices.iter().enumerate() {
                    slots[vertex as usize] = (block * LANES + lane) as u32;
                    amplitudes[vertex as usize] = of_block[lane];
                }
            }
        }
    }

    /// Selects the active set: the vertices whose `gap`, the distance of their rest position from the nearest sphere,
    /// is no more than `skin` plus their amplitude [scene unit]. The others are free from now on.
    pub fn choose_active_set(&mut self, rest: Rest<'_>, gap: &[f64], skin: f64, now: Now, scratch: &mut Scratch) {
        self.gather(rest.len(), now, scratch);
        let Scratch { amplitudes, active_set, outside, free_vertices, .. } = &mut *scratch;
        for list in [&mut *active_set, &mut *outside, &mut *free_vertices] {
            list.resize(list.len().max(rest.len()), 0);
        }
        // Each vertex is written to every list and stays in one of them at most: branches would be mispredicted. Those
        // inside a sphere come first, so that neighbouring lanes do the same work. NaN counts as inside.
        let (mut inside, mut near, mut free) = (0, 0, 0);
        for (v, (&gap, &amplitude)) in (0..).zip(gap.iter().zip(&*amplitudes)) {
            (active_set[inside], outside[near], free_vertices[free]) = (v, v, v);
            let is_inside = gap < 0.0;
            let is_near = !is_inside & !(gap - amplitude > skin);
            inside += usize::from(is_inside);
            near += usize::from(is_near);
            free += usize::from(!is_inside & !is_near & !(amplitude < REST));
        }
        active_set[inside..inside + near].copy_from_slice(&outside[..near]);
        self.active_set.take(inside + near, rest, scratch);
        self.free_vertices.take(free, now, scratch);
    }

    /// Releases all vertices: they are free from now on.
    pub fn release(&mut self, count: usize, now: Now, scratch: &mut Scratch) {
        if self.active_set.vertices.is_empty() {
            return;
        }
        self.gather(count, now, scratch);
        let Scratch { amplitudes, free_vertices, .. } = &mut *scratch;
        free_vertices.clear();
        free_vertices.extend((0..count as u32).filter(|&v| !(amplitudes[v as usize] < REST)));
        let free = free_vertices.len();
        self.clear();
        self.free_vertices.take(free, now, scratch);
    }
}

/// The states of an active set and of free vertices at the end of the last step, and the amplitude of each [scene unit]:
/// an upper bound of |x| at any later time.
struct Gather<'a> {
    omega: f64,
    active_set: &'a [Block<3>],
    free_vertices: &'a [Block<2>],
    /// Advances the free vertices.
    flow: [f64; 4],
    states: &'a mut [Block<2>],
    amplitudes: &'a mut [[f64; LANES]],
}

impl WithSimd for Gather<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Gather { omega, active_set, free_vertices, flow: [xx, xu, ux, uu], states, amplitudes } = self;
        let (of_active_set, of_free_vertices) = states.split_at_mut(active_set.len());
        for (Block(to), Block([x, u, _])) in of_active_set.iter_mut().zip(active_set) {
            *to = [*x, *u];
        }
        for (Block([x1, u1]), Block([x, u])) in of_free_vertices.iter_mut().zip(free_vertices) {
            for axis in 0..3 {
                for i in 0..LANES {
                    x1[axis][i] = xx * x[axis][i] + xu * u[axis][i];
                    u1[axis][i] = ux * x[axis][i] + uu * u[axis][i];
                }
            }
        }
        for (amplitudes, Block([[x, y, z], [u, v, w]])) in amplitudes.iter_mut().zip(states) {
            if omega == 0.0 {
                for i in 0..LANES {
                    let rests = [x[i], y[i], z[i], u[i], v[i], w[i]] == [0.0; 6];
                    amplitudes[i] = if rests { 0.0 } else { f64::INFINITY }; // without a spring it may drift anywhere
                }
                continue;
            }
            for i in 0..LANES {
                let (u, v, w) = (u[i] / omega, v[i] / omega, w[i] / omega);
                amplitudes[i] = ((x[i] * x[i] + y[i] * y[i] + z[i] * z[i]) + (u * u + v * v + w * w)).sqrt();
            }
        }
    }
}

thread_local! {
    /// The flow that was last requested: most bodies of a scene have the same oscillator.
    static LAST_FLOW: Cell<(Oscillator, f64, [f64; 4])> =
        const { Cell::new((Oscillator { omega: 0.0, damping: 0.0 }, 0.0, [1.0, 0.0, 0.0, 1.0])) };
}

/// The flow of an oscillator over `h` [s].
fn flow(oscillator: Oscillator, h: f64) -> [f64; 4] {
    let (of, over, flow) = LAST_FLOW.get();
    if of == oscillator && over == h {
        return flow;
    }
    let flow = oscillator.flow(h);
    LAST_FLOW.set((oscillator, h, flow));
    flow
}

impl ActiveSet {
    /// Rest position of vertex number `i` of the set [scene unit].
    pub fn rest(&self, i: usize) -> DVec3 {
        self.blocks.get(REST_POSITION, i)
    }

    /// State of vertex number `i` of the set.
    #[inline]
    pub fn state(&self, i: usize) -> State {
        State { x: self.blocks.get(DISPLACEMENT, i), u: self.blocks.get(VELOCITY, i) }
    }

    /// Replaces the state of vertex number `i` of the set.
    #[inline]
    pub fn set_state(&mut self, i: usize, State { x, u }: State) {
        self.blocks.set(DISPLACEMENT, i, x);
        self.blocks.set(VELOCITY, i, u);
    }

    fn clear(&mut self) {
        self.vertices.clear();
        self.blocks.clear();
    }

    /// Replaces the set by the first `count` vertices selected for it, with the states that were gathered.
    fn take(&mut self, count: usize, rest: Rest<'_>, scratch: &Scratch) {
        let list = &scratch.active_set[..count];
        self.vertices.clear();
        self.vertices.extend_from_slice(list);
        self.blocks.resize(count);
        for (Block([x, u, l]), vertices) in self.blocks.all_mut().iter_mut().zip(list.chunks(LANES)) {
            for (lane, &vertex) in vertices.iter().enumerate() {
                let (state, from) = scratch.state(vertex as usize);
                let rest = rest.position(vertex as usize).to_array();
                for axis in 0..3 {
                    (x[axis][lane], u[axis][lane]) = (state[0][axis][from], state[1][axis][from]);
                    l[axis][lane] = rest[axis];
                }
            }
        }
        self.pad_again();
    }

    /// Repeats the last vertex in the padding after all have changed.
    pub fn pad_again(&mut self) {
        self.blocks.pad(self.vertices.len());
    }
}

impl FreeVertices {
    /// The flow that advances them to the end of the last step; `None` if they have decayed to rest by then.
    fn flow(&self, now: Now) -> Option<[f64; 4]> {
        let steps = now.step - self.as_of;
        if steps == 0 || self.vertices.is_empty() {
            return Some([1.0, 0.0, 0.0, 1.0]);
        }
        let flow = flow(now.oscillator, steps as f64 * now.dt);
        let [xx, xu, ux, uu] = flow;
        let omega = now.oscillator.omega;
        // |x| and |u|/ω are no larger than `largest`
        let left = self.largest * (xx.abs() + xu.abs() * omega).max(ux.abs() / omega + uu.abs());
        (!(left < REST)).then_some(flow)
    }

    /// The state of one of them after a flow.
    #[inline(always)]
    fn state(&self, i: usize, flow: [f64; 4]) -> State {
        State { x: self.blocks.get(DISPLACEMENT, i), u: self.blocks.get(VELOCITY, i) }.after(flow)
    }

    fn clear(&mut self) {
        self.vertices.clear();
        self.blocks.clear();
        self.largest = 0.0;
    }

    /// Replaces the set by the first `count` vertices selected for it, with the states that were gathered.
    fn take(&mut self, count: usize, now: Now, scratch: &Scratch) {
        let list = &scratch.free_vertices[..count];
        self.as_of = now.step;
        self.vertices.clear();
        self.vertices.extend_from_slice(list);
        self.blocks.resize(count);
        for (Block([x, u]), vertices) in self.blocks.all_mut().iter_mut().zip(list.chunks(LANES)) {
            for (lane, &vertex) in vertices.iter().enumerate() {
                let (state, from) = scratch.state(vertex as usize);
                for axis in 0..3 {
                    (x[axis][lane], u[axis][lane]) = (state[0][axis][from], state[1][axis][from]);
                }
            }
        }
        self.largest = list.iter().map(|&v| scratch.amplitudes[v as usize]).fold(0.0, larger);
    }
}
