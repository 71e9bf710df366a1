//! Dense output: the states of an island's bodies at any time within its last step.
//!
//! States between the solver's steps are kept during the step if some were asked for in the step before; else the
//! solver repeats the step when it is asked. Between these states, cubic Hermite polynomials interpolate. Where they
//! are not accurate enough, the solver advances the island to the middle of the interval, and both halves are
//! interpolated: their error is a sixteenth of that which was found in the middle. So the cost does not grow with the
//! number of times asked for.

use glam::{DQuat, DVec3};

use super::islands::OfScene;
use crate::{
    model::hermite::Hermite,
    sim::{
        free::{Body, Failure, Field, Island, Pair, Parts, Report, Scratch},
        numerics::control::INTERPOLATED,
        work::Tally,
    },
};

/// An interval between two steps is halved at most this often; then the solver answers.
const MAX_HALVINGS: u32 = 6;
/// Largest memory for the states of a step [bytes].
const MEMORY: usize = 256 << 20;
/// Largest number of states of a step that are kept.
const MOST_STATES: usize = 256;
/// States within a step may take this many times the work of the step, …
const MOST_WORK: u64 = 20;
/// … and this much besides [units].
const FREE_WORK: u64 = 10_000_000;

/// The states of a step.
pub(super) struct DenseOutput {
    field: Field,
    tolerance: f64,
    scratch: Scratch,
    states: Vec<State>,
    /// Those between the solver's steps, then their halves.
    spans: Vec<Interval>,
    own_spans: usize,
    most_states: usize,
    /// Work that may still be done for states within the step [units].
    left: u64,
    /// Whether a state was asked for.
    pub is_used: bool,
}

/// The state at an instant.
struct State {
    time: f64,
    /// Before the jumps due at this instant, with the phases from then on.
    bodies: Vec<Body>,
    pairs: Vec<Pair>,
    /// After the jumps, if there are any.
    after: Option<Vec<Body>>,
}

/// An interval between two states.
#[derive(Clone, Copy)]
struct Interval {
    ends: [usize; 2],
    /// The state in the middle, and the interval that ends with it; the next one begins with it.
    halves: Option<(usize, usize)>,
}

/// The interpolated state of a body.
pub(crate) struct Interpolated<'a> {
    bodies: [&'a Body; 2],
    at: Hermite,
}

impl Interpolated<'_> {
    pub fn centre(&self) -> DVec3 {
        self.at.vector(self.bodies.map(|body| body.centre), self.bodies.map(|body| body.velocity))
    }

    pub fn rotation(&self) -> DQuat {
        self.at.rotation(self.bodies.map(|body| body.rotation), self.bodies.map(Body::frame_spin))
    }

    /// The displacements of all vertices [scene unit].
    pub fn displacements(&self) -> impl Iterator<Item = DVec3> {
        let [from, to] = self.bodies;
        let ends = from.x.iter().zip(&from.u).zip(to.x.iter().zip(&to.u));
        ends.map(|((x, u), (x1, u1))| self.at.vector([*x, *x1], [*u, *u1]))
    }

    /// The largest distance of a vertex from where it is in `body` [scene unit]. Both have the same reference, so that
    /// a difference of centres is one of all vertices.
    fn error(&self, body: &Body) -> f64 {
        let centre = (self.centre() - body.centre).length();
        let turn = 2.0 * (self.rotation() * body.rotation.inverse()).xyz().length() * body.shape.extent();
        let apart = self.displacements().zip(&body.x).map(|(x, y)| x.distance(*y)).fold(0.0, f64::max);
        centre + turn + apart
    }
}

impl DenseOutput {
    /// Advances an island with these parts from `start` to `end` [s], and keeps its states. The island is then at the end, or
    /// where the solver failed, which returns no states.
    pub fn advance(
        parts: Parts,
        tolerance: f64,
        [start, end]: [f64; 2],
        scratch: &mut Scratch,
        paths: &OfScene<'_>,
        work: &Tally<'_>,
        report: &mut Report,
    ) -> (Island, Result<DenseOutput, Failure>) {
        let size: usize = parts.bodies.iter().map(|body| size_of::<Body>() + 48 * body.x.len()).sum();
        let most_states = (MEMORY / size.max(1)).clamp(8, MOST_STATES);
        let field = parts.field.clone();
        let (states, spans) = (Vec::new(), Vec::new());
        let mut dense = DenseOutput {
            field,
            tolerance,
            scratch: Scratch::new(scratch.arch),
            states,
            spans,
            own_spans: 0,
            most_states,
            left: 0,
            is_used: false,
        };
        let before = work.done();
        let mut island = Island::resume(parts, tolerance, start);
        let done = island.advance_with(scratch, end, paths, work, report, &mut |island| {
            dense.keep(island, paths);
            if dense.states.len() > most_states / 2 {
                dense.thin();
            }
        });
        dense.spans = (1..dense.states.len()).map(|i| Interval { ends: [i - 1, i], halves: None }).collect();
        dense.own_spans = dense.spans.len();
        dense.left = FREE_WORK + MOST_WORK * (work.done() - before);
        (island, done.map(|()| dense))
    }

    fn keep(&mut self, island: &Island, paths: &OfScene<'_>) {
        if self.states.last().is_some_and(|last| last.time == island.time()) {
            self.states.pop(); // a change of phase, which takes no time
        }
        let after = island.is_at_break().then(|| {
            let mut island = island.clone();
            island.kick(paths);
            island.jump(paths, &mut Report::default());
            island.into_parts().bodies
        });
        let (bodies, pairs) = (island.bodies().to_vec(), island.pairs().to_vec());
        self.states.push(State { time: island.time(), bodies, pairs, after });
    }

    /// Drops every other state at which nothing jumps.
    fn thin(&mut self) {
        let last = self.states.len() - 1;
        let mut index = 0;
        self.states.retain(|state| {
            index += 1;
            index % 2 == 1 || index > last || state.after.is_some()
        });
    }

    /// Calls `write` with the states of some of the bodies at a time [s], if it can be found within `work`. Once too much
    /// has been done for states within this step, they are interpolated between those that are known.
    pub fn at(
        &mut self,
        time: f64,
        bodies: &[usize],
        paths: &OfScene<'_>,
        work: &Tally<'_>,
        mut write: impl FnMut(usize, &Interpolated<'_>),
    ) -> Option<()> {
        self.is_used = true;
        let own = &self.spans[..self.own_spans];
        let mut span = own.partition_point(|span| self.states[span.ends[1]].time < time).min(own.len().checked_sub(1)?);
        for _ in 0..MAX_HALVINGS {
            let Some((middle, first)) = self.halve(span, paths, work)? else { break };
            let is_accurate = bodies.iter().all(|&body| {
                let found = &self.states[middle].bodies[body];
                let error = self.interpolate(span, self.states[middle].time, body).error(found);
                error / 16.0 <= INTERPOLATED * found.radius
            });
            span = if time <= self.states[middle].time { first } else { first + 1 };
            if is_accurate {
                bodies.iter().for_each(|&body| write(body, &self.interpolate(span, time, body)));
                return Some(());
            }
        }
        if self.left == 0 {
            bodies.iter().for_each(|&body| write(body, &self.interpolate(span, time, body)));
            return Some(());
        }
        let found = self.exactly(span, time, paths, work)?.0;
        let at = Hermite { values: [1.0, 0.0], rates: [0.0; 2] };
        bodies.iter().for_each(|&body| write(body, &Interpolated { bodies: [&found[body]; 2], at }));
        Some(())
    }

    /// The state in the middle of an interval, and its first half; `None` if no more states can be kept.
    fn halve(&mut self, span: usize, paths: &OfScene<'_>, work: &Tally<'_>) -> Option<Option<(usize, usize)>> {
        let Interval { ends: [from, to], halves } = self.spans[span];
        if halves.is_some() {
            return Some(halves);
        }
        let [start, end] = [from, to].map(|end| self.states[end].time);
        let time = start + 0.5 * (end - start);
        if self.left == 0 || self.states.len() >= self.most_states || time <= start || time >= end {
            return Some(None);
        }
        let (bodies, pairs) = self.exactly(span, time, paths, work)?;
        let (middle, first) = (self.states.len(), self.spans.len());
        self.states.push(State { time, bodies, pairs, after: None });
        self.spans.push(Interval { ends: [from, middle], halves: None });
        self.spans.push(Interval { ends: [middle, to], halves: None });
        self.spans[span].halves = Some((middle, first));
        Some(Some((middle, first)))
    }

    /// Advances the island to a time within an interval.
    fn exactly(
        &mut self,
        span: usize,
        time: f64,
        paths: &OfScene<'_>,
        work: &Tally<'_>,
    ) -> Option<(Vec<Body>, Vec<Pair>)> {
        let from = &self.states[self.spans[span].ends[0]];
        let parts = Parts {
            bodies: from.bodies.clone(),
            pairs: from.pairs.clone(),
            field: self.field.clone(),
            ..Parts::default()
        };
        let mut island = Island::resume(parts, self.tolerance, from.time);
        let before = work.done();
        let done = island.advance_with(&mut self.scratch, time, paths, work, &mut Report::default(), &mut |_| ());
        self.left = self.left.saturating_sub(work.done() - before);
        done.ok()?;
        let parts = island.into_parts();
        Some((parts.bodies, parts.pairs))
    }

    fn interpolate(&self, span: usize, time: f64, body: usize) -> Interpolated<'_> {
        let [from, to] = self.spans[span].ends.map(|end| &self.states[end]);
        let start = from.after.as_ref().unwrap_or(&from.bodies);
        Interpolated { bodies: [&start[body], &to.bodies[body]], at: Hermite::new([from.time, to.time], time) }
    }
}
