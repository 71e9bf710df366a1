//! Forces on the vertices of a body at the samples of a step, and the instants of their kinks.

use std::sync::atomic::{AtomicU64, Ordering};

use glam::DVec3;
use pulp::Arch;

use super::{
    body::Body,
    field::{Field, Pair},
    kernels::{Detect, Kernel, Pull, PullAt},
    split::{self, hold, passages},
    step::{Course, Held, Place, Reaction, Span},
};
use crate::{
    model::{PairLaw, influence::Weight, phase::Phase, shape_matching::Plane},
    scene::Push,
    sim::numerics::bernstein::{self, Crossings, Polynomial},
};

/// A sphere that acts on a body.
#[derive(Clone, Copy, Debug)]
pub struct Sphere {
    /// Index of the body that the sphere belongs to.
    pub source: u32,
    /// Radius r_e [scene unit].
    pub radius: f64,
    /// Strength at each sample [1/s²].
    pub strength: [f64; 5],
    /// Factor on the strength of the pair's law, for the sizes of the bodies [–].
    pub scale: f64,
    /// Sum of the radii of the bodies [scene unit].
    pub radii: f64,
    pub law: PairLaw,
    pub phase: Phase,
    /// Position and velocity of its centre at each sample.
    pub places: [Place; 5],
    /// Motion relative to the sphere in the step that the choice of active vertices allows for [scene unit].
    pub band: f64,
}

impl Sphere {
    /// Strength at a distance of the centres [1/s²].
    pub fn strength_at(&self, distance: f64) -> f64 {
        self.scale * self.law.strength(self.phase, distance / self.radii)
    }
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
    Plane(&'a Plane),
    Push(&'a Push),
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
    pub(super) fn depth(&self, sample: usize, seen: &Seen) -> (f64, f64) {
        let Seen { a, s, rate, place, turning } = *seen;
        match self {
            Contact::Sphere(sphere) => {
                let d = (sphere.places[sample].centre - place.centre) - s;
                let v = (sphere.places[sample].velocity - place.velocity) - rate;
                let distance = d.length();
                ((sphere.radius - distance) * (sphere.radius + distance), -2.0 * d.dot(v))
            }
            Contact::Plane(plane) => (plane.depth(place.centre + s), -plane.normal.dot(place.velocity + rate)),
            Contact::Push(push) => {
                let facing = a.normalize_or_zero(); // zero at the mass centre, where a vertex faces nothing
                (-push.direction.dot(facing), -push.direction.dot(turning.cross(facing)))
            }
        }
    }

    /// Whether the contact acts at the start of a step of length `h` [s], from the state of a vertex at its nodes, and
    /// when it begins and ceases to. Wendland's weight has no kink at the rim, so that sphere acts throughout.
    pub(super) fn passage(&self, weight: Weight, h: f64, seen: &[Seen; 4]) -> (bool, Crossings) {
        let depth = |sample: usize| self.depth(sample, &seen[sample]);
        let depths = [depth(0), depth(1), depth(2), depth(3)];
        let (values, rates) = (depths.map(|d| d.0), depths.map(|d| h * d.1));
        if weight == Weight::Wendland && matches!(self, Contact::Sphere(_)) {
            return (values.iter().any(|&value| value > 0.0), Crossings::default());
        }
        let starts_inside = values[0] > 0.0 || (values[0] == 0.0 && rates[0] > 0.0);
        let fastest = rates.iter().fold(0.0, |m: f64, r| m.max(r.abs()));
        let nearest = values.iter().fold(f64::INFINITY, |m, v| m.min(v.abs()));
        let alike = values.iter().all(|&v| (v > 0.0) == (values[0] > 0.0));
        if alike && nearest > fastest {
            return (starts_inside, Crossings::default());
        }
        (starts_inside, Polynomial::new(&values, &rates).crossings())
    }

    /// Acceleration, continued smoothly to where the contact does not act [scene unit/s²].
    #[inline(always)]
    pub(super) fn acceleration(&self, weight: Weight, sample: usize, seen: &Seen) -> DVec3 {
        let Seen { a, s, rate, place, .. } = *seen;
        match self {
            Contact::Sphere(sphere) => {
                let d = (sphere.places[sample].centre - place.centre) - s;
                influence(d, weight, sphere.radius, sphere.strength[sample])
            }
            Contact::Plane(plane) => plane.acceleration(plane.depth(place.centre + s), place.velocity + rate),
            Contact::Push(push) => push.direction * (-push.strength * push.direction.dot(a.normalize_or_zero())),
        }
    }
}

/// The acceleration of a vertex at `-d` from the centre of a sphere; the linear weight continues beyond the rim.
#[inline(always)]
pub(super) fn influence(d: DVec3, weight: Weight, radius: f64, strength: f64) -> DVec3 {
    let z = d.length() / radius;
    let w = if weight == Weight::Linear { weight.inside(z) } else { weight.at(z) };
    d * (strength * w)
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
            let strength = std::array::from_fn(|sample| {
                let q = if is_gradual { mine[sample].centre.distance(its[sample].centre) / radii } else { 0.0 };
                scale * pair.law.strength(pair.phase, q)
            });
            if is_gradual || strength != [0.0; 5] {
                let radius = source.sphere_radius;
                // the spheres stay the same within a step: keep their bands
                let band = self.spheres.get(count).map_or(0.0, |sphere| sphere.band);
                let (law, phase) = (pair.law, pair.phase);
                let sphere = Sphere { source: other, radius, strength, scale, radii, law, phase, places: *its, band };
                match self.spheres.get_mut(count) {
                    Some(known) => *known = sphere,
                    None => self.spheres.push(sphere),
                }
                count += 1;
            }
        }
        self.spheres.truncate(count);
        self.pushes.clear();
        let acts = |push: &&Push| push.body == index && push.acts_at(span.start);
        self.pushes.extend(field.pushes.iter().filter(acts));
    }

    /// Finds the vertices on which a contact begins or ceases to act within the step, and those on which a plane or a
    /// push acts throughout. Returns whether the set of individually advanced vertices changed. Adds their [load](split::Split::load)
    /// to `load`, and leaves vertices out once that is too much.
    pub fn find_splits(&self, view: &View<'_>, course: &mut Course, load: &AtomicU64) -> bool {
        let View { field, span, places, arch, .. } = *view;
        let mut crossing = std::mem::take(&mut course.crossing);
        crossing.clear();
        let n = course.active.len();
        let extent = (0..4).map(|sample| course.frames[sample].extent).fold(0.0, f64::max);
        let speed = (0..4).map(|sample| {
            let frame = &course.frames[sample];
            frame.speed + frame.frame_spin.length() * frame.extent
        });
        let speed = speed.fold(0.0, f64::max);
        if field.weight == Weight::Linear && n > 0 {
            let turning = std::array::from_fn(|node| course.frames[node].frame_spin);
            for sphere in &self.spheres {
                let apart: [DVec3; 4] =
                    std::array::from_fn(|sample| sphere.places[sample].centre - places[sample].centre);
                let passing: [DVec3; 4] =
                    std::array::from_fn(|node| sphere.places[node].velocity - places[node].velocity);
                let nearest = apart.iter().map(|apart| apart.length()).fold(f64::INFINITY, f64::min);
                let band = 0.5 * span.h * (speed + passing.iter().map(|v| v.length()).fold(0.0, f64::max));
                if nearest > sphere.radius + extent + band {
                    continue;
                }
                let (active, radius, h) = (&mut course.active, sphere.radius, span.h);
                let (listed, basis) = (&mut crossing, bernstein::basis());
                Detect { active, radius, apart, passing, turning, h, band, crossing: listed, basis }.find(arch);
            }
        }
        std::mem::swap(&mut course.held, &mut course.held_before);
        course.held.clear();
        let seen =
            |course: &Course, i: usize| -> [Seen; 4] { std::array::from_fn(|sample| see(course, places, sample, i)) };
        for (number, plane) in (0..).zip(&field.planes) {
            let depth = |sample: usize| plane.depth(places[sample].centre);
            let deepest = (0..4).map(depth).fold(f64::NEG_INFINITY, f64::max);
            let passing = (0..4).map(|sample| plane.normal.dot(places[sample].velocity).abs()).fold(0.0, f64::max);
            let band = 0.5 * span.h * (speed + passing);
            if deepest + extent + band < 0.0 {
                continue;
            }
            for i in 0..n {
                let depth = |sample: usize| plane.depth(places[sample].centre + course.active.s(sample, i));
                let depths = [depth(0), depth(1), depth(2), depth(3)];
                if depths.iter().all(|&d| d < -band) {
                    continue;
                }
                let contact = Contact::Plane(plane);
                let (acts, crossings) = match depths.iter().all(|&d| d > band) {
                    true => (true, Crossings::default()),
                    false => contact.passage(field.weight, span.h, &seen(course, i)),
                };
                if !crossings.as_slice().is_empty() {
                    crossing.push(i as u32);
                } else if acts {
                    course.held.push(Held { contact: number, vertex: i as u32, g: [DVec3::ZERO; 4] });
                }
            }
        }
        course.pushed.clear();
        for (number, push) in (0..).zip(&self.pushes) {
            for i in 0..n {
                let contact = Contact::Push(push);
                let (acts, crossings) = contact.passage(field.weight, span.h, &seen(course, i));
                if !crossings.as_slice().is_empty() {
                    crossing.push(i as u32);
                } else if acts {
                    course.pushed.push(Held { contact: number, vertex: i as u32, g: [DVec3::ZERO; 4] });
                }
            }
        }
        crossing.sort_unstable();
        crossing.dedup();
        let [mut old, mut splits, mut spare] =
            [&mut course.splits, &mut course.splits_before, &mut course.spare_splits].map(std::mem::take);
        let (mut before, mut changed) = (old.drain(..).peekable(), false);
        for &vertex in &crossing {
            let Some(passages) = passages(vertex as usize, course, self, view) else { continue };
            while let Some(gone) = before.next_if(|split| split.vertex < vertex) {
                course.active.set_split(gone.vertex as usize, false);
                spare.push(gone);
                changed = true;
            }
            let mut split = before.next_if(|split| split.vertex == vertex).unwrap_or_else(|| {
                course.active.set_split(vertex as usize, true);
                changed = true;
                spare.pop().unwrap_or_default().restart(vertex)
            });
            split.pass(passages);
            let own = split.load();
            splits.push(split);
            if load.fetch_add(own, Ordering::Relaxed).saturating_add(own) > split::MAX_LOAD {
                break;
            }
        }
        for gone in before {
            course.active.set_split(gone.vertex as usize, false);
            spare.push(gone);
            changed = true;
        }
        (course.splits, course.splits_before, course.spare_splits) = (splits, old, spare);
        let Course { held, pushed, active, .. } = course;
        held.retain(|held| !active.is_split(held.vertex as usize));
        pushed.retain(|held| !active.is_split(held.vertex as usize));
        course.crossing = crossing;
        changed
    }

    /// Evaluates the forces on the vertices at the nodes from `view.first` on, except those that are advanced alone.
    pub fn evaluate(&self, view: &View<'_>, course: &mut Course) {
        let View { body, field, places, first, arch, .. } = *view;
        course.reactions.clear();
        let extent = (0..4).map(|sample| course.frames[sample].extent).fold(0.0, f64::max);
        let mut fresh = true;
        for sphere in &self.spheres {
            let apart: [DVec3; 4] = std::array::from_fn(|sample| sphere.places[sample].centre - places[sample].centre);
            let nearest = apart.iter().map(|apart| apart.length()).fold(f64::INFINITY, f64::min);
            if nearest > sphere.radius + extent || course.active.len() == 0 {
                continue;
            }
            let power = (!body.is_free()).then(|| std::array::from_fn(|node| places[node].velocity));
            let pull = Pull { active: &mut course.active, sphere, weight: field.weight, apart, power, first, fresh };
            let pulled = pull.find(arch);
            fresh = false;
            let mut reaction = Reaction { source: sphere.source, force: [DVec3::ZERO; 5], power: [0.0; 4] };
            for node in 0..4 {
                reaction.force[node] = -pulled.force[node];
                reaction.power[node] = -pulled.power[node];
            }
            course.reactions.push(reaction);
        }
        if fresh {
            course.active.clear_forces(first..4);
        }
        let responses = course.responses();
        let mut held = std::mem::take(&mut course.held);
        for Held { contact: number, vertex, g } in &mut held {
            let plane = &field.planes[*number as usize];
            let seen: [Seen; 4] = std::array::from_fn(|sample| see(course, places, sample, *vertex as usize));
            *g = std::array::from_fn(|sample| Contact::Plane(plane).acceleration(field.weight, sample, &seen[sample]));
            let key = (*number, *vertex);
            let known = course.held_before.binary_search_by_key(&key, |held| (held.contact, held.vertex));
            if let Ok(known) = known {
                *g = hold(plane, &course.held_before[known].g, g, &seen, &responses);
            }
            for sample in first..4 {
                course.active.accelerate(sample, *vertex as usize, g[sample]);
            }
        }
        course.held = held;
        let mut pushed = std::mem::take(&mut course.pushed);
        for Held { contact: number, vertex, g } in &mut pushed {
            let contact = Contact::Push(&self.pushes[*number as usize]);
            *g = std::array::from_fn(|sample| {
                contact.acceleration(field.weight, sample, &see(course, places, sample, *vertex as usize))
            });
            for sample in first..4 {
                course.active.accelerate(sample, *vertex as usize, g[sample]);
            }
        }
        course.pushed = pushed;
        for sample in first..4 {
            course.gather(arch, body, sample);
        }
    }

    /// Evaluates the forces that act at a single sample.
    pub fn evaluate_at(&self, sample: usize, view: &View<'_>, course: &mut Course) {
        let View { body, field, places, arch, .. } = *view;
        course.active.clear_forces(sample..sample + 1);
        let extent = course.frames[sample].extent;
        for sphere in &self.spheres {
            let apart = sphere.places[sample].centre - places[sample].centre;
            let mut force = DVec3::ZERO;
            if apart.length() < sphere.radius + extent {
                let active = &mut course.active;
                force = -PullAt { active, sphere, weight: field.weight, sample, apart }.find(arch);
            }
            match course.reactions.iter_mut().find(|known| known.source == sphere.source) {
                Some(known) => known.force[sample] = force,
                None => {
                    let mut reaction = Reaction { source: sphere.source, force: [DVec3::ZERO; 5], power: [0.0; 4] };
                    reaction.force[sample] = force;
                    course.reactions.push(reaction);
                }
            }
        }
        let planes = (0..).zip(field.planes.iter().map(Contact::Plane));
        let pushes = (0..).zip(self.pushes.iter().map(Contact::Push));
        for (number, contact) in planes.chain(pushes) {
            if let Contact::Plane(plane) = contact
                && plane.depth(places[sample].centre) + extent < 0.0
            {
                continue;
            }
            for i in 0..course.active.len() {
                if course.active.is_split(i) {
                    continue;
                }
                let seen = see(course, places, sample, i);
                if contact.depth(sample, &seen).0 > 0.0 {
                    let g = contact.acceleration(field.weight, sample, &seen);
                    course.active.accelerate(sample, i, g);
                    if let (0, Contact::Plane(_)) = (sample, contact) {
                        course.held.push(Held { contact: number, vertex: i as u32, g: [g; 4] });
                    }
                }
            }
        }
        course.gather(arch, body, sample);
    }
}

/// The state of an active vertex at a sample.
#[inline(always)]
pub(super) fn see(course: &Course, places: &[Place; 5], sample: usize, i: usize) -> Seen {
    let (frame, active) = (&course.frames[sample], &course.active);
    let s = active.s(sample, i);
    let a = s - active.x(sample, i);
    let rate = frame.frame_spin.cross(a) + active.u(sample, i);
    Seen { a, s, rate, place: places[sample], turning: frame.frame_spin }
}
