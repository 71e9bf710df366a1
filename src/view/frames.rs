//! Converts parts of the world to frames.

use std::mem::take;

use glam::DVec3;

use super::label;
use crate::{
    geometry::Vectors,
    observe::{BodyFrame, NetForce, PairFrame},
    sim::{
        Cause, PairView, World,
        free::{Forces, Snapshot},
        observe::Observed,
        terms::{self, Surroundings},
    },
};

/// The frame of a pair.
pub fn pair_frame(pair: PairView) -> PairFrame {
    PairFrame::new(pair.a, pair.b, pair.q, pair.phase as usize).with_rate(pair.rate)
}

/// Adds the forces on a body of a coupled scene in its current state, and the labels of its vertices.
pub(super) fn add_coupled_forces(
    world: &World,
    causes: &[Cause],
    snapshot: &Snapshot<'_>,
    index: usize,
    forces: &mut Forces,
    now: &mut BodyFrame,
) {
    snapshot.forces(index, terms::uniform_on(world.scene(), index, world.time()), forces);
    now.has_forces = true;
    now.terms.resize_with(causes.len(), Default::default);
    let rest = world.body(index).rest_shape();
    add_labels(rest.len(), &forces.by_cause, now);
    for (&cause, term) in causes.iter().zip(&mut now.terms) {
        term.source = forces.sources[cause as usize];
        std::mem::swap(&mut term.accelerations, &mut forces.by_cause[cause as usize]);
    }
    let body = &world.scene().bodies[index];
    now.net_force = body.path().is_none().then_some(NetForce::new(forces.force, forces.torque, body.mass));
}

/// Labels the vertices of a body by the kinds of sphere that act on them.
fn add_labels(count: usize, by_cause: &[Vectors; Cause::ALL.len()], now: &mut BodyFrame) {
    let contributing = [Cause::Attraction, Cause::Repulsion, Cause::Core].map(|cause| &by_cause[cause as usize]);
    now.labels.clear();
    let feels = |i: usize| contributing.map(|forces| !forces.is_empty() && forces.get(i) != DVec3::ZERO);
    now.labels.extend((0..count).map(|i| label(feels(i))));
}

/// Adds the forces on a body in the state of `now`, in a scene that is not coupled, and the labels of its vertices.
pub(super) fn add_forces(
    world: &World,
    causes: &[Cause],
    index: usize,
    surroundings: &Surroundings,
    now: &mut BodyFrame,
) {
    now.has_forces = true;
    now.terms.resize_with(causes.len(), Default::default);
    let mut by_cause: [Vectors; Cause::ALL.len()] = Default::default();
    for (&cause, term) in causes.iter().zip(&mut now.terms) {
        by_cause[cause as usize] = take(&mut term.accelerations);
    }
    let seen: Observed<'_> = world.seen(index, [&now.displacements, &now.velocities], surroundings);
    seen.forces(world.scene().influence.weight, &mut by_cause);
    add_labels(seen.rest.len(), &by_cause, now);
    for (&cause, term) in causes.iter().zip(&mut now.terms) {
        let mut sources = surroundings.sources.iter().filter(|source| source.cause() == cause);
        term.source = match (sources.next(), sources.next()) {
            (Some(source), None) => source.body(),
            _ => None,
        };
        term.accelerations = take(&mut by_cause[cause as usize]);
    }
}
