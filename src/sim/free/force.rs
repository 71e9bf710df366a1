//! Forces on the vertices of a body at the samples of a step, and the instants of their kinks.

use glam::DVec3;
use pulp::Arch;

use super::{
    body::Body,
    crossing::{self, Course as Polynomial, Crossings},
    field::{Field, Pair, Push},
    kernels::{self, Pull},
    step::{Course, Held, Own, Piece, Place, Reaction, Span},
};
use crate::model::{influence::Weight, shape_matching::Plane};

/// A sphere that acts on a body.
#[derive(Clone, Copy, Debug)]
pub struct Sphere {
    /// Index of the body that the sphere belongs to.
    pub source: u32,
    /// Radius r_e [scene unit].
    pub radius: f64,
    /// Strength at each sample [1/s²].
    pub strength: [f64; 5],
    /// Position and velocity of its centre at each sample.
    pub places: [Place; 5],
    /// Motion relative to the sphere in the step that the choice of active vertices allows for [scene unit].
    pub band: f64,
}

/// Everything that acts on a body.
#[derive(Clone, Debug, Default)]
pub struct Acting {
    pub spheres: Vec<Sphere>,
    pub pushes: Vec<Push>,
    /// [`Sphere::band`] of each plane.
    pub plane_bands: Vec<f64>,
}

/// A body in a step, its centre at the samples as estimated, and the first node at which forces are wanted.
#[derive(Clone, Copy)]
pub struct View<'a> {
    pub body: &'a Body,
    pub field: &'a Field,
    pub span: &'a Span,
    pub places: &'a [Place; 5],
    pub first: usize,
    pub arch: Arch,
}

/// One sphere, plane or push that acts on a body.
#[derive(Clone, Copy)]
pub(super) enum Contact<'a> {
    Sphere(&'a Sphere),
    Plane(u32, &'a Plane),
    Push(u32, &'a Push),
}

/// The state of a vertex at a sample, relative to the centre.
#[derive(Clone, Copy)]
pub(super) struct Seen {
    /// Q l [scene unit].
    pub a: DVec3,
    /// Q l + x [scene unit].
    pub s: DVec3,
    /// s′ [scene unit/s].
    pub rate: DVec3,
    /// Position and velocity of the centre.
    pub place: Place,
    /// Angular velocity of the frame [rad/s].
    pub turning: DVec3,
}

impl Contact<'_> {
    /// Depth, positive where the contact acts, and its rate: a difference of squares [scene unit²] for spheres, a
    /// length [scene unit] for planes, a cosine for pushes.
    #[inline(always)]
    pub(super) fn depth(&self, look: usize, seen: &Seen) -> (f64, f64) {
        let Seen { a, s, rate, place, turning } = *seen;
        match self {
            Contact::Sphere(sphere) => {
                let d = (sphere.places[look].centre - place.centre) - s;
                let v = (sphere.places[look].velocity - place.velocity) - rate;
                let distance = d.length();
                ((sphere.radius - distance) * (sphere.radius + distance), -2.0 * d.dot(v))
            }
            Contact::Plane(_, plane) => (plane.depth(place.centre + s), -plane.normal.dot(place.velocity + rate)),
            Contact::Push(_, push) => (-push.direction.dot(unit(a)), -push.direction.dot(turning.cross(unit(a)))),
        }
    }

    /// Acceleration, continued smoothly to where the contact does not act [scene unit/s²].
    #[inline(always)]
    pub(super) fn acceleration(&self, weight: Weight, look: usize, seen: &Seen) -> DVec3 {
        let Seen { a, s, rate, place, .. } = *seen;
        match self {
            Contact::Sphere(sphere) => {
                let d = (sphere.places[look].centre - place.centre) - s;
                let z = d.length() / sphere.radius;
                let y = 1.0 - z;
                let w = match weight {
                    Weight::Linear => y, // (3.3)
                    Weight::Wendland => (y * y) * (y * y) * (4.0 * z + 1.0),
                };
                d * (sphere.strength[look] * w)
            }
            Contact::Plane(_, plane) => plane.acceleration(plane.depth(place.centre + s), place.velocity + rate),
            Contact::Push(_, push) => push.direction * (-push.strength * push.direction.dot(unit(a))),
        }
    }
}

/// a/|a|; zero at the mass centre, where a vertex faces nothing.
#[inline]
fn unit(a: DVec3) -> DVec3 {
    a.normalize_or_zero()
}

impl Acting {
    /// Collects the spheres and pushes that act on body `index` in a step; `pairs` are the pairs that it belongs to.
    pub fn find<'a>(
        &mut self,
        index: usize,
        bodies: &[Body],
        pairs: impl Iterator<Item = &'a Pair>,
        field: &Field,
        span: &Span,
        places: &[[Place; 5]],
    ) {
        let mut count = 0;
        for pair in pairs {
            let other = if pair.a as usize == index { pair.b } else { pair.a };
            let (own, source) = (&bodies[index], &bodies[other as usize]);
            let scale = field.scale(own.radius, source.radius);
            let (mine, its) = (&places[index], &places[other as usize]);
            let radii = own.radius + source.radius;
            let is_gradual = pair.law.rim(pair.phase).is_some();
            let strength = std::array::from_fn(|look| {
                let q = if is_gradual { mine[look].centre.distance(its[look].centre) / radii } else { 0.0 };
                scale * pair.law.strength(pair.phase, q)
            });
            if is_gradual || strength != [0.0; 5] {
                let radius = field.reach * source.radius;
                // the spheres stay the same within a step: keep their bands
                let band = self.spheres.get(count).map_or(0.0, |sphere| sphere.band);
                let sphere = Sphere { source: other, radius, strength, places: *its, band };
                match self.spheres.get_mut(count) {
                    Some(known) => *known = sphere,
                    None => self.spheres.push(sphere),
                }
                count += 1;
            }
        }
        self.spheres.truncate(count);
        self.pushes.clear();
        let acts = |push: &&Push| push.body as usize == index && push.start <= span.start && span.start < push.end;
        self.pushes.extend(field.pushes.iter().filter(acts));
    }

    /// Evaluates the forces on the vertices at the nodes from `view.first` on: a part without kinks in the step, and
    /// pieces that begin or end in it.
    pub fn evaluate(&self, view: &View<'_>, course: &mut Course) {
        let View { body, field, span, places, first, arch } = *view;
        course.pieces.clear();
        course.reactions.clear();
        std::mem::swap(&mut course.held, &mut course.held_before);
        course.held.clear();
        course.pushed.clear();
        course.stiffness = self.spheres.iter().map(|sphere| sphere.strength[0].abs()).sum();
        let extent = (0..4).map(|look| course.frames[look].extent).fold(0.0, f64::max);
        let speed = (0..4).map(|look| {
            let frame = &course.frames[look];
            frame.speed + frame.frame_spin.length() * frame.extent
        });
        let speed = speed.fold(0.0, f64::max);
        let mut crossing = std::mem::take(&mut course.crossing);
        let mut fresh = true;
        for sphere in &self.spheres {
            let apart: [DVec3; 4] = std::array::from_fn(|look| sphere.places[look].centre - places[look].centre);
            let nearest = apart.iter().map(|apart| apart.length()).fold(f64::INFINITY, f64::min);
            let passing = (0..4).map(|look| (sphere.places[look].velocity - places[look].velocity).length());
            let band = 0.5 * span.h * (speed + passing.fold(0.0, f64::max));
            if nearest > sphere.radius + extent + band || course.active.len() == 0 {
                continue;
            }
            crossing.clear();
            let power = (!body.is_free()).then(|| std::array::from_fn(|node| places[node].velocity));
            let passing = std::array::from_fn(|node| sphere.places[node].velocity - places[node].velocity);
            let turning = std::array::from_fn(|node| course.frames[node].frame_spin);
            let (weight, h) = (field.weight, span.h);
            let (active, crossing) = (&mut course.active, &mut crossing);
            let basis = crossing::basis();
            let pull =
                Pull { active, sphere, weight, apart, passing, turning, h, band, crossing, power, first, fresh, basis };
            let pulled = pull.find(arch);
            fresh = false;
            let mut reaction = Reaction { source: sphere.source, force: [DVec3::ZERO; 5], power: [0.0; 4] };
            for node in 0..4 {
                reaction.force[node] = -pulled.force[node];
                reaction.power[node] = -pulled.power[node];
            }
            for &i in &*crossing {
                view.touch(Contact::Sphere(sphere), false, course, i as usize, Some(&mut reaction));
            }
            course.reactions.push(reaction);
        }
        course.crossing = crossing;
        if fresh {
            course.active.clear_forces(first..4);
        }
        for (number, plane) in (0..).zip(&field.planes) {
            let depth = |look: usize| plane.depth(places[look].centre);
            let deepest = (0..4).map(depth).fold(f64::NEG_INFINITY, f64::max);
            let passing = (0..4).map(|look| plane.normal.dot(places[look].velocity).abs()).fold(0.0, f64::max);
            let band = 0.5 * span.h * (speed + passing);
            if deepest + extent + band < 0.0 {
                continue;
            }
            for i in 0..course.active.len() {
                let depth = |look: usize| plane.depth(places[look].centre + course.active.s(look, i));
                let depths = [depth(0), depth(1), depth(2), depth(3)];
                if depths.iter().all(|&d| d < -band) {
                    continue;
                }
                let inside = depths.iter().all(|&d| d > band);
                view.touch(Contact::Plane(number, plane), inside, course, i, None);
            }
        }
        for (number, push) in (0..).zip(&self.pushes) {
            for i in 0..course.active.len() {
                view.touch(Contact::Push(number, push), false, course, i, None);
            }
        }
        for look in first..4 {
            course.gather(arch, body, look);
        }
    }

    /// Evaluates the forces that act at a single sample.
    pub fn evaluate_at(&self, look: usize, view: &View<'_>, course: &mut Course) {
        let View { body, field, places, arch, .. } = *view;
        course.active.clear_forces(look..look + 1);
        let extent = course.frames[look].extent;
        for sphere in &self.spheres {
            let apart = sphere.places[look].centre - places[look].centre;
            let mut force = DVec3::ZERO;
            if apart.length() < sphere.radius + extent {
                force = -kernels::pull_at(arch, &mut course.active, sphere, field.weight, look, apart);
            }
            match course.reactions.iter_mut().find(|known| known.source == sphere.source) {
                Some(known) => known.force[look] = force,
                None => {
                    let mut reaction = Reaction { source: sphere.source, force: [DVec3::ZERO; 5], power: [0.0; 4] };
                    reaction.force[look] = force;
                    course.reactions.push(reaction);
                }
            }
        }
        let planes = (0..).zip(&field.planes).map(|(number, plane)| Contact::Plane(number, plane));
        let pushes = (0..).zip(&self.pushes).map(|(number, push)| Contact::Push(number, push));
        for contact in planes.chain(pushes) {
            if let Contact::Plane(_, plane) = contact
                && plane.depth(places[look].centre) + extent < 0.0
            {
                continue;
            }
            for i in 0..course.active.len() {
                let seen = see(course, places, look, i);
                if contact.depth(look, &seen).0 > 0.0 {
                    let g = contact.acceleration(field.weight, look, &seen);
                    course.active.accelerate(look, i, g);
                    if let (0, Contact::Plane(contact, _)) = (look, contact) {
                        let (vertex, crossings) = (i as u32, Crossings::default());
                        course.held.push(Held { contact, vertex, g: [g; 4], starts_inside: true, crossings });
                    }
                }
            }
        }
        course.gather(arch, body, look);
    }
}

impl View<'_> {
    /// Adds the force of a contact on a vertex over the step, with a kink wherever it begins or ends, unless the vertex
    /// is known to be `inside` throughout.
    fn touch(
        &self,
        contact: Contact<'_>,
        inside: bool,
        course: &mut Course,
        i: usize,
        reaction: Option<&mut Reaction>,
    ) {
        let View { body, field, span, places, first, .. } = *self;
        let see = |look: usize| see(course, places, look, i);
        let seen = [see(0), see(1), see(2), see(3)];
        let (mut starts_inside, mut polynomial) = (true, None);
        if !inside {
            let depth = |look: usize| contact.depth(look, &seen[look]);
            let depths = [depth(0), depth(1), depth(2), depth(3)];
            let (values, rates) = (depths.map(|d| d.0), depths.map(|d| span.h * d.1));
            starts_inside = values[0] > 0.0 || (values[0] == 0.0 && rates[0] > 0.0);
            let fastest = rates.iter().fold(0.0, |m: f64, r| m.max(r.abs()));
            let nearest = values.iter().fold(f64::INFINITY, |m, v| m.min(v.abs()));
            let alike = values.iter().all(|&v| (v > 0.0) == (values[0] > 0.0));
            if !(alike && nearest > fastest) {
                polynomial = Some(Polynomial::new(&values, &rates));
            }
        }
        let toggles = polynomial.map(|p| p.crossings()).unwrap_or_default();
        let crossings = toggles.as_slice();
        if !starts_inside && crossings.is_empty() {
            return;
        }
        let mass = course.active.mass(i);
        let pull = |look: usize| contact.acceleration(field.weight, look, &seen[look]);
        let mut g = [pull(0), pull(1), pull(2), pull(3)];
        let held = |contact: u32, g| Held { contact, vertex: i as u32, g, starts_inside, crossings: toggles };
        if let Contact::Push(number, _) = contact {
            course.pushed.push(held(number, g));
        }
        if let Contact::Plane(number, plane) = contact {
            let key = (number, i as u32);
            let known = course.held_before.binary_search_by_key(&key, |held| (held.contact, held.vertex));
            if let Ok(known) = known {
                let responses = course.responses(body.oscillator, span.h, starts_inside, crossings);
                g = hold(plane, &course.held_before[known].g, &g, &seen, &responses);
            }
            course.held.push(held(number, g));
        }
        let mut source = None;
        if let Some(reaction) = reaction {
            source = Some(reaction.source);
            if starts_inside {
                for look in 0..4 {
                    reaction.force[look] -= mass * g[look];
                    if !body.is_free() {
                        reaction.power[look] -= (mass * g[look]).dot(seen[look].place.velocity + seen[look].rate);
                    }
                }
            }
        }
        if starts_inside {
            for look in first..4 {
                course.active.accelerate(look, i, g[look]);
            }
        }
        let mut sign = if starts_inside { -1.0 } else { 1.0 };
        for &from in crossings {
            let share = mass / body.mass();
            let torque =
                std::array::from_fn(|look| (span.arm(places[look].centre) + seen[look].s).cross(mass * g[look]));
            let turn = std::array::from_fn(|look| {
                if body.turns() { course.turn_of(look, seen[look].a.cross(mass * g[look])) } else { DVec3::ZERO }
            });
            course.pieces.push(Piece {
                from,
                sign,
                acceleration: g.map(|g| share * g),
                torque,
                own: Some(Own { vertex: i as u32, source, g, turn }),
            });
            sign = -sign;
        }
    }
}

/// The state of an active vertex at a sample.
#[inline(always)]
fn see(course: &Course, places: &[Place; 5], look: usize, i: usize) -> Seen {
    let (frame, active) = (&course.frames[look], &course.active);
    let s = active.s(look, i);
    let a = s - active.x(look, i);
    let rate = frame.frame_spin.cross(a) + active.u(look, i);
    Seen { a, s, rate, place: places[look], turning: frame.frame_spin }
}

/// The force of a plane on a vertex at the nodes depends on the displacement that it causes. Returns the result of one
/// Newton step from the guess `before`, which led to `found`: for a stiff plane or sharp friction, plain iteration
/// diverges. A force acts mostly on its own vertex; its effect on others is left to the sweeps.
fn hold(
    plane: &Plane,
    before: &[DVec3; 4],
    found: &[DVec3; 4],
    seen: &[Seen; 4],
    responses: &[[(f64, f64); 3]; 3],
) -> [DVec3; 4] {
    // (1 − J W) change = found − before, at the nodes after the first
    let mut a = [[0.0; 10]; 9];
    for i in 0..3 {
        let at = &seen[i + 1];
        let (by_position, by_velocity) =
            plane.derivatives(plane.depth(at.place.centre + at.s), at.place.velocity + at.rate);
        let residual = found[i + 1] - before[i + 1];
        for j in 0..3 {
            let (x, u) = responses[i][j];
            let block = by_position * x + by_velocity * u;
            for column in 0..3 {
                for row in 0..3 {
                    let one = if i == j && row == column { 1.0 } else { 0.0 };
                    a[3 * i + row][3 * j + column] = one - block.col(column)[row];
                }
            }
        }
        for row in 0..3 {
            a[3 * i + row][9] = residual[row];
        }
    }
    let change = solve(a);
    std::array::from_fn(|node| match node {
        0 => found[0],
        node => before[node] + DVec3::from_slice(&change[3 * node - 3..3 * node]),
    })
}

/// Solves nine linear equations, with the right-hand side in the last column (Gaussian elimination with pivoting).
fn solve(mut a: [[f64; 10]; 9]) -> [f64; 9] {
    for p in 0..9 {
        let pivot = (p..9).max_by(|&i, &j| a[i][p].abs().total_cmp(&a[j][p].abs())).unwrap_or(p);
        a.swap(p, pivot);
        let row = a[p];
        let scale = 1.0 / row[p];
        for other in &mut a[p + 1..] {
            let factor = other[p] * scale;
            for column in p + 1..10 {
                other[column] -= factor * row[column];
            }
        }
    }
    let mut solution = [0.0; 9];
    for p in (0..9).rev() {
        let known: f64 = (p + 1..9).map(|column| a[p][column] * solution[column]).sum();
        solution[p] = (a[p][9] - known) / a[p][p];
    }
    solution
}
