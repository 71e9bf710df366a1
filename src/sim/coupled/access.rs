//! Access to the state.

use super::{Coupled, dense::Interpolated, member::Member};
use crate::{
    model::phase::Phase,
    scene::{self, Scene},
    sim::{
        body::{BodyView, Solved},
        free::{self, Field, Pair, Snapshot},
        neighbours::{PairId, later_neighbours},
        solver::Setting,
        span::Span,
        terms::{self, Origin, Source, Surroundings},
        work::Tally,
    },
};

impl Coupled {
    /// Body `index` of the scene at the current time.
    pub fn view<'a>(&'a self, body: &'a scene::Body, index: usize) -> BodyView<'a> {
        let member = &self.members[index];
        BodyView { body, mesh: &member.mesh, centre: member.body.centre, solved: Solved::Coupled(member) }
    }

    /// A body.
    pub fn member(&self, index: usize) -> &Member {
        &self.members[index]
    }

    /// A hash of the exact state.
    pub fn hash(&self) -> u64 {
        let awake = self.awake.iter().map(|&body| self.members[body as usize].hash(body));
        awake.fold(self.sleeping_hash.wrapping_add(self.near.hash()), u64::wrapping_add)
    }

    /// All pairs that are near each other or not apart, in ascending order of their bodies.
    pub fn pairs(&self) -> impl Iterator<Item = &free::Pair> + '_ {
        self.pair_ids().map(|pair| self.near.get(pair))
    }

    /// The same by their places in the list.
    pub(super) fn pair_ids(&self) -> impl Iterator<Item = PairId> + '_ {
        later_neighbours(self.members.iter().map(|member| &member.neighbours))
    }

    /// The pairs of a body, with the other body's index.
    pub fn pairs_of(&self, index: usize) -> impl Iterator<Item = (u32, &free::Pair)> + '_ {
        self.members[index].neighbours.iter().map(|neighbour| (neighbour.other, self.near.get(neighbour.pair)))
    }

    /// Calls `write` with the states of some bodies at `time` [s] within the last step, from `ends[0]` to `ends[1]` [s], on the
    /// solver's own solution. Omits bodies that took no step, and those that would be too much work.
    pub fn within(
        &self,
        setting: Setting<'_>,
        ends: [f64; 2],
        time: f64,
        bodies: &[usize],
        work: &Tally<'_>,
        mut write: impl FnMut(usize, &Interpolated<'_>),
    ) {
        for job in &self.jobs {
            let local = |&body: &usize| job.group.bodies.binary_search(&(body as u32)).ok();
            let own: Vec<usize> = bodies.iter().filter_map(local).collect();
            if !own.is_empty() {
                let name = |local: usize, body: &Interpolated<'_>| write(job.group.bodies[local] as usize, body);
                job.within(setting.scene, (ends, time), &own, setting.arch, work, name);
            }
        }
    }

    /// Number of bodies that are awake.
    pub fn awake_count(&self) -> usize {
        self.awake.len()
    }

    /// The phase of a pair.
    pub fn phase(&self, a: usize, b: usize) -> Phase {
        let found = self.pairs_of(a).find(|(other, _)| *other as usize == b);
        found.map_or(Phase::Apart, |(_, pair)| pair.phase)
    }

    /// What acts on a body at `time` [s], except its own oscillators, gravity and planes: carry, spheres in reach, pushes.
    pub fn surroundings_into(&self, scene: &Scene, index: usize, time: f64, surroundings: &mut Surroundings) {
        let Surroundings { uniform, weighted, sources } = surroundings;
        uniform.clear();
        weighted.clear();
        sources.clear();
        let member = &self.members[index];
        uniform.extend(terms::uniform_on(scene, index, time));
        weighted.extend(terms::push::acting(&member.pushes, time));
        for (other, pair) in self.pairs_of(index) {
            let (own, source) = (&member.body, &self.members[other as usize].body);
            let centre = source.centre - own.centre;
            let q = centre.length() / (own.radius + source.radius);
            let scaling = scene.influence.scaling.factor(own.radius, source.radius);
            let (strength, phase) = (scaling * pair.law.strength(pair.phase, q), pair.phase);
            let sphere_radius = source.sphere_radius;
            if strength != 0.0 && centre.length() <= sphere_radius + member.extent {
                sources.push(Source { origin: Origin::Body { index: other, phase }, centre, sphere_radius, strength });
            }
        }
        for (source, point) in scene.points_on(index).filter(|(_, point)| point.acts_at(time)) {
            let centre = point.path.position(time) - member.body.centre;
            let sphere_radius = scene.influence.sphere_radius(point.radius);
            if centre.length() <= sphere_radius + member.extent {
                let origin = Origin::Point { index: source - scene.bodies.len() as u32 };
                sources.push(Source { origin, centre, sphere_radius, strength: scene.point_strength(point, index) });
            }
        }
    }

    /// What acts on all bodies at `time` [s], beside pairs.
    pub(super) fn field(&self, scene: &Scene, time: f64) -> Field {
        let pushes = self.members.iter().flat_map(|member| &member.pushes).filter(|push| push.acts_at(time));
        let forces = (0..).zip(&scene.bodies).filter_map(|(index, body)| Some((index, body.force.clone()?)));
        let mut field = Field {
            pushes: pushes.copied().collect(),
            forces: forces.collect(),
            first_point: scene.bodies.len() as u32,
            ..Field::default()
        };
        field.set_common(scene);
        field
    }

    /// The current state of all bodies, for their forces and conserved quantities.
    pub fn snapshot(&self, scene: &Scene, time: f64) -> Snapshot<'_> {
        let bodies = self.members.iter().map(|member| &member.body).chain(&self.points).collect();
        let here = Span { start: time, end: time };
        let on = |body: u32| {
            let near = self.points_near(scene, here, body as usize);
            near.map(move |(source, point)| Pair::with_point(body, source, point, time))
        };
        let with_points = (0..self.members.len() as u32).flat_map(on);
        Snapshot::new(bodies, self.pairs().copied().chain(with_points).collect(), self.field(scene, time), time)
    }
}
