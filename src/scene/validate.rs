//! What holds for every scene from a file, checked for scenes and parts that a program has built.

use std::{
    collections::{HashMap, HashSet},
    fmt::{Debug, Display},
};

use glam::DVec3;

use super::{
    Body, Force, FreeMotion, Motion, Path, Plane, Point, Push, Response, Scene,
    keys::{self, ANY, Key, Kind, LARGEST, NON_NEGATIVE, Range, SMALLEST},
    pairs::Members,
    parse::{MAX_PLANES, MAX_STEPS, key},
    path::{Bounds, Kinematics},
};
use crate::model::PairLaw;

/// A value that a program has given and that no scene file could have.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{field}: expected {expected}, found {found}")]
pub struct InvalidScene {
    /// Where it is, as in `bodies[1].radius`.
    pub field: String,
    /// What would be right.
    pub expected: String,
    /// What is there.
    pub found: String,
}

type Checked = Result<(), InvalidScene>;

impl InvalidScene {
    /// The error of a part of a scene as an error of the part's owner.
    pub(crate) fn at(self, owner: impl Display) -> InvalidScene {
        let dot = if self.field.is_empty() { "" } else { "." };
        InvalidScene { field: format!("{owner}{dot}{}", self.field), ..self }
    }
}

/// The error of an element of a list as an error of the list's owner; written only where there is one.
fn element(list: &str, index: usize) -> impl FnOnce(InvalidScene) -> InvalidScene {
    move |invalid| invalid.at(format_args!("{list}[{index}]"))
}

/// Masses are those of spheres of all radii, unless they are given.
const MASS: Range = Range { min: SMALLEST * SMALLEST * SMALLEST, max: LARGEST * LARGEST * LARGEST };
/// How far the length of a direction may be from 1.
const UNIT: f64 = 1e-9;

impl Scene {
    /// Checks what holds for every scene from a file. [`World`](crate::World), every other model, and recordings do so
    /// before they start.
    ///
    /// # Errors
    /// The first field with an invalid value: out of the range that `meldscope reference scene` gives, NaN, not unique,
    /// or the index of nothing.
    pub fn validate(&self) -> Result<(), InvalidScene> {
        text(key!(TOP.name), "name", &self.name)?;
        number(key!(TOP.dt), "dt", self.dt)?;
        number(key!(TOP.duration), "duration", self.duration)?;
        let steps = self.duration / self.dt;
        ensure(
            steps <= MAX_STEPS,
            "duration",
            || format!("at most {MAX_STEPS:e} steps of dt ({:?} s)", self.dt),
            &self.duration,
        )?;
        number(key!(TOP.tolerance), "tolerance", self.tolerance)?;
        vector(ANY, "gravity", self.gravity)?;
        integer(key!(LATTICES.cells), "lattice.cells", self.lattice.cells)?;
        number(key!(LATTICES.limit), "lattice.limit", self.lattice.limit)?;
        integer(key!(ELEMENTS.cells), "fem.cells", self.fem.cells)?;
        number(key!(ELEMENTS.poisson), "fem.poisson", self.fem.poisson)?;
        self.fem.young.map_or(Ok(()), |young| number(key!(ELEMENTS.young), "fem.young", young))?;
        self.fem.tear_stress.map_or(Ok(()), |stress| number(key!(ELEMENTS.tear_stress), "fem.tear_stress", stress))?;
        number(key!(SURFACES.blend), "blend", self.blend)?;
        number(key!(REACH.reach), "influence.reach", self.influence.reach)?;
        law(&self.common_law()).map_err(|invalid| invalid.at("influence"))?;
        for (index, own) in self.pairs.laws().iter().enumerate() {
            law(own).map_err(element("pairs", index))?;
        }
        let has_body = |body: usize| body < self.bodies.len();
        let exists = |side: &Members| !matches!(side, Members::Body(body) if !has_body(*body as usize));
        for (sides, _) in self.pairs.rules() {
            ensure(sides.iter().all(exists), "pairs", || self.body_index(), &sides)?;
        }
        ensure(!self.bodies.is_empty(), "bodies", || "at least one body".to_owned(), &"none")?;
        for (index, body) in self.bodies.iter().enumerate() {
            body.validate(0.0).map_err(element("bodies", index))?;
        }
        self.check_groups()?;
        let names = unique("bodies", self.bodies.iter().map(|body| &*body.name))?;
        for (index, body) in self.bodies.iter().enumerate() {
            let is_own = body.group.as_ref().is_none_or(|group| !names.contains(group.as_str()));
            let expected = || "a name that no body has".to_owned();
            ensure(is_own, "group", expected, &body.group).map_err(element("bodies", index))?;
        }
        ensure(self.planes.len() <= MAX_PLANES, "planes", || format!("at most {MAX_PLANES}"), &self.planes.len())?;
        for (index, plane) in self.planes.iter().enumerate() {
            plane.check().map_err(element("planes", index))?;
        }
        for (index, point) in self.points.iter().enumerate() {
            self.check_point(point).map_err(element("points", index))?;
        }
        unique("points", self.points.iter().map(|point| &*point.name))?;
        for (index, push) in self.pushes.iter().enumerate() {
            self.check_push(push).map_err(element("pushes", index))?;
        }
        let mut earlier = 0.0;
        for (index, edit) in self.edits.iter().enumerate() {
            let expected = || format!("a time of at least {earlier:?} s, that of the edit before");
            ensure(edit.time >= earlier, "time", expected, &edit.time).map_err(element("edits", index))?;
            let is_of_these = edit.body_count() == self.bodies.len();
            let expected = || format!("an edit of a scene of {} bodies", self.bodies.len());
            ensure(is_of_these, "", expected, &edit.body_count()).map_err(element("edits", index))?;
            let expected = || {
                "edits made from this scene: they replace all that an edit can set, and some of it has changed since"
                    .to_owned()
            };
            let before = if index == 0 { None } else { Some(&self.edits[index - 1]) };
            ensure(edit.follows(self, before), "", expected, &edit.set).map_err(element("edits", index))?;
            earlier = edit.time;
        }
        Ok(())
    }

    /// Checks that the laws of pairs and the bodies have the same groups.
    fn check_groups(&self) -> Checked {
        let groups = self.pairs.groups();
        let expected = || format!("groups of at most {} bodies", self.bodies.len());
        ensure(groups.len() <= self.bodies.len(), "pairs", expected, &groups.len())?;
        let (mut number_of, mut name_of): (HashMap<&str, Option<u32>>, HashMap<u32, &str>) = Default::default();
        let numbers = groups.iter().copied().chain(std::iter::repeat(None));
        let grouped = self.bodies.iter().zip(numbers).enumerate();
        for (index, (body, number)) in grouped.take(if groups.is_empty() { 0 } else { self.bodies.len() }) {
            let name = body.group.as_deref();
            let is_same = name.and_then(|name| *number_of.entry(name).or_insert(number)) == number
                && number.is_none_or(|number| Some(*name_of.entry(number).or_insert(name.unwrap_or(""))) == name);
            let expected = || "the group of its number in `pairs`, where each name has one number".to_owned();
            ensure(is_same, "group", expected, &body.group).map_err(element("bodies", index))?;
        }
        Ok(())
    }

    fn body_index(&self) -> String {
        format!("the index of one of {} bodies", self.bodies.len())
    }

    fn check_point(&self, point: &Point) -> Checked {
        text(key!(POINTS.name), "name", &point.name)?;
        path(&point.path, 0.0)?;
        number(key!(POINTS.radius), "radius", point.radius)?;
        within(ANY, "strength", point.strength)?;
        number(key!(POINTS.start), "start", point.start)?;
        let is_time = point.duration == f64::INFINITY || NON_NEGATIVE.contains(point.duration);
        ensure(is_time, "duration", || "a time of at least 0 s, or infinity".to_owned(), &point.duration)?;
        let bodies = point.bodies.as_deref().unwrap_or_default();
        let is_list =
            bodies.is_sorted_by(|a, b| a < b) && bodies.iter().all(|&body| (body as usize) < self.bodies.len());
        ensure(is_list, "bodies", || format!("ascending indices of {} bodies", self.bodies.len()), &bodies)
    }

    /// Checks a push of a body of this scene.
    pub(crate) fn check_push(&self, push: &Push) -> Checked {
        let Push { body, direction, strength, start, duration } = *push;
        ensure(body < self.bodies.len(), "body", || self.body_index(), &body)?;
        unit("direction", direction)?;
        number(key!(PUSHES.strength), "strength", strength)?;
        number(key!(PUSHES.start), "start", start)?;
        number(key!(PUSHES.duration), "duration", duration)
    }
}

impl Body {
    /// Checks the body alone, which starts at `time` [s]; the fields of errors are relative to it, as in all checks of parts.
    pub(crate) fn validate(&self, time: f64) -> Checked {
        text(key!(BODIES.name), "name", &self.name)?;
        number(key!(BODIES.radius), "radius", self.radius)?;
        number(key!(REACH.reach), "reach", self.reach)?;
        within(MASS, "mass", self.mass)?;
        number(key!(OSCILLATOR.omega), "material.omega", self.material.omega)?;
        number(key!(OSCILLATOR.damping), "material.damping", self.material.damping)?;
        self.group.as_ref().map_or(Ok(()), |group| text(key!(BODIES.group), "group", group))?;
        if let Some((parameter, value)) = self.shape.out_of_range() {
            let expected = || Kind::Integer([parameter.least, parameter.most]).expected();
            ensure(false, parameter.name, expected, &value).map_err(|invalid| invalid.at("shape"))?;
        }
        self.check_motion(&self.motion, time)?;
        self.force.as_ref().map_or(Ok(()), |force| self.check_force(force, time))
    }

    /// Checks a motion of this body from `time` on [s].
    pub(crate) fn check_motion(&self, motion: &Motion, time: f64) -> Checked {
        match motion {
            Motion::Prescribed(own) => path(own, time),
            Motion::Free(FreeMotion { from, velocity, spin, rotation: _ }) => {
                vector(ANY, "motion.from", *from)?;
                vector(ANY, "motion.velocity", *velocity)?;
                vector(ANY, "motion.spin", *spin)?;
                let response = self.material.response;
                let expected = || "Inertial, the response of every free body".to_owned();
                ensure(response == Response::Inertial, "material.response", expected, &response)
            }
        }
    }

    /// Checks a force on this body, where it starts.
    fn check_force(&self, force: &Force, time: f64) -> Checked {
        match &self.motion {
            Motion::Free(free) => force.validate(time, free.from, free.velocity),
            Motion::Prescribed(_) => {
                ensure(false, "force", || "none: no force moves a body on a path".to_owned(), force)
            }
        }
    }
}

impl Force {
    /// Checks the bound, and the acceleration of a body at `centre` [scene unit] with `velocity` [scene unit/s] at `t` [s].
    pub(crate) fn validate(&self, t: f64, centre: DVec3, velocity: DVec3) -> Checked {
        within(NON_NEGATIVE, "force.bound", self.bound())?;
        let now = self.acceleration(t, centre, velocity);
        let expected = || format!("an acceleration within its bound ({:?}) at t = {t:?} s", self.bound());
        ensure(now.length() <= self.bound() * (1.0 + UNIT), "force", expected, &now)
    }
}

impl Plane {
    fn check(&self) -> Checked {
        unit("normal", self.normal)?;
        number(key!(PLANES.offset), "offset", self.offset)?;
        number(key!(PLANES.stiffness), "stiffness", self.stiffness)?;
        number(key!(PLANES.friction), "friction", self.friction)?;
        number(key!(PLANES.slip), "slip", self.slip)
    }
}

fn law(law: &PairLaw) -> Checked {
    let PairLaw { alpha, beta, thresholds, core_width, .. } = *law;
    number(key!(STRENGTH.alpha), "alpha", alpha)?;
    number(key!(STRENGTH.beta), "beta", beta)?;
    let (merge_at, split_at, core_at) = (thresholds.merge_at, thresholds.split_at, thresholds.core_at);
    number(key!(PHASES.merge_at), "merge_at", merge_at)?;
    number(key!(PHASES.split_at), "split_at", split_at)?;
    ensure(split_at >= merge_at, "split_at", || format!("a number of at least merge_at ({merge_at:?})"), &split_at)?;
    number(key!(PHASES.core_at), "core_at", core_at)?;
    ensure(core_at < merge_at, "core_at", || format!("a number below merge_at ({merge_at:?})"), &core_at)?;
    number(key!(PHASES.core_width), "core_width", core_width)?;
    let has_rim = core_width == 0.0 || core_at > 0.0;
    ensure(has_rim, "core_width", || "0 where there is no core".to_owned(), &core_width)
}

fn path(path: &Path, time: f64) -> Checked {
    match path {
        Path::Fixed(at) => vector(ANY, "motion.fixed", *at),
        Path::Line { from, velocity } => {
            vector(ANY, "motion.from", *from)?;
            vector(ANY, "motion.velocity", *velocity)
        }
        Path::Sine { center, amplitude, frequency, phase } => {
            vector(ANY, "motion.center", *center)?;
            vector(ANY, "motion.amplitude", *amplitude)?;
            number(key!(SINES.frequency), "motion.frequency", *frequency)?;
            number(key!(SINES.phase), "motion.phase", *phase)
        }
        Path::Keyframes(_) => {
            let knots = path.knots();
            let is_ascending = knots.is_sorted_by(|a, b| b - a >= SMALLEST);
            ensure(is_ascending, "motion.keys", || "ascending times".to_owned(), &knots)?;
            knots.iter().try_for_each(|&t| vector(ANY, "motion.keys", path.position(t)))
        }
        Path::Given(given) => {
            let Kinematics { position, velocity, acceleration } = path.at(time);
            let Bounds { speed, acceleration: most } = given.bounds();
            vector(ANY, "motion", position)?;
            within(NON_NEGATIVE, "motion.bounds.speed", speed)?;
            within(NON_NEGATIVE, "motion.bounds.acceleration", most)?;
            // rates follow from their ratio
            let is_path = speed >= SMALLEST || speed == 0.0 && most == 0.0;
            let expected = || format!("a speed of at least {SMALLEST:e}, or a path without acceleration");
            ensure(is_path, "motion.bounds", expected, &given.bounds())?;
            let is_within = velocity.length() <= speed * (1.0 + UNIT) && acceleration.length() <= most * (1.0 + UNIT);
            let expected = || format!("velocity and acceleration within {:?} at t = {time:?} s", given.bounds());
            ensure(is_within, "motion", expected, &[velocity, acceleration])
        }
    }
}

// --- checks of single values --------------------------------------------------------------------------------------

fn ensure(is_valid: bool, field: &'static str, expected: impl FnOnce() -> String, found: &dyn Debug) -> Checked {
    match is_valid {
        true => Ok(()),
        false => Err(InvalidScene { field: field.to_owned(), expected: expected(), found: format!("{found:?}") }),
    }
}

/// The names of a list, each of which must be there once.
fn unique<'n>(list: &str, names: impl ExactSizeIterator<Item = &'n str>) -> Result<HashSet<&'n str>, InvalidScene> {
    let mut seen = HashSet::with_capacity(names.len());
    for (index, name) in names.enumerate() {
        let expected = || format!("a name that no other of the {list} has");
        ensure(seen.insert(name), "name", expected, &name).map_err(element(list, index))?;
    }
    Ok(seen)
}

fn within(range: Range, field: &'static str, x: f64) -> Checked {
    ensure(range.contains(x), field, || Kind::Number(range).expected(), &x)
}

fn vector(range: Range, field: &'static str, vector: DVec3) -> Checked {
    let is_valid = vector.to_array().into_iter().all(|x| range.contains(x));
    ensure(is_valid, field, || "finite numbers of at most 1e15".to_owned(), &vector.to_array())
}

fn unit(field: &'static str, vector: DVec3) -> Checked {
    let is_valid = (vector.length() - 1.0).abs() <= UNIT;
    ensure(is_valid, field, || "a vector of length 1".to_owned(), &vector.to_array())
}

fn number(key: &Key, field: &'static str, x: f64) -> Checked {
    match key.kind {
        Kind::Number(range) => within(range, field, x),
        _ => Ok(()),
    }
}

fn integer(key: &Key, field: &'static str, x: u32) -> Checked {
    match key.kind {
        Kind::Integer([min, max]) => ensure((min..=max).contains(&x), field, || key.kind.expected(), &x),
        _ => Ok(()),
    }
}

fn text(key: &Key, field: &'static str, text: &str) -> Checked {
    match key.kind {
        Kind::Text(keys::Text { form, accepts }) => ensure(accepts(text), field, || form.to_owned(), &text),
        _ => Ok(()),
    }
}
