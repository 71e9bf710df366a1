//! Warnings about scenes that are valid but probably not intended.

use std::collections::HashMap;

use super::{Body, Integrator, Model, Scene};

/// The largest number of bodies that are compared with each other.
const MAX_BODIES: usize = 64;

/// Relative margin around a limit within which a threshold gives no warning.
const MARGIN: f64 = 1e-9;

impl Scene {
    /// Warnings about thresholds without effect, each with a level that has an effect: a `merge_at` at which no sphere
    /// reaches the other body, a `split_at` at which the rest shapes still overlap. Also about what begins after the end, influence spheres that do
    /// not enclose their body, bodies that do not enclose their centre, free bodies without a core, and free bodies that
    /// a plane would throw out.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = [Vec::new(), Vec::new(), Vec::new()];
        for b in 0..self.bodies.len().min(MAX_BODIES) {
            for a in 0..b {
                let (law, pair) = (self.law(a, b), format!("{}~{}", self.bodies[a].name, self.bodies[b].name));
                let (merge_at, split_at) = (law.thresholds.merge_at, law.thresholds.split_at);
                let [one, other] = [a, b].map(|body| &self.bodies[body]);
                let reached = |source: &Body, other: &Body| source.sphere_radius() + other.radius;
                let reach = f64::max(reached(one, other), reached(other, one)) / (one.radius + other.radius);
                if merge_at > reach * (1.0 + MARGIN) {
                    warnings[0].push(format!(
                        "merge_at = {merge_at} is out of reach: at q = {merge_at} neither sphere of {pair} reaches the other \
                         body, so merging changes nothing above q = {reach:.3}; use a merge_at below that"
                    ));
                }
                if self.has_free(a, b) && law.alpha > 0.0 && law.thresholds.core_at == 0.0 {
                    warnings[2].push(format!(
                        "core_at = 0 lets {pair} fall into one place once they have merged; leave it out for the default"
                    ));
                }
                if split_at < 1.0 - MARGIN {
                    warnings[1].push(format!(
                        "split_at = {split_at} is inside the bodies: {pair} split while their rest shapes overlap; they \
                         touch at q = 1, so a split_at above 1 separates them"
                    ));
                }
            }
        }
        let of_pairs = warnings.into_iter().filter_map(|all| summary(all, "pair"));
        let of_bodies = [self.not_enclosed(), self.hollow()].into_iter().filter_map(|all| summary(all, "body"));
        let no_step = (self.steps() == 0).then(|| {
            let Scene { duration, dt, .. } = self;
            format!(
                "duration = {duration} is less than half of dt = {dt}: on its own, the scene has no steps; raise duration or lower dt"
            )
        });
        let late = if no_step.is_some() { None } else { summary(self.late(), "entry") };
        // the timeline counts nanoseconds
        let end = self.steps() as f64 * self.dt;
        let beyond = (end > i64::MAX as f64 * 1e-9).then(|| {
            format!(
                "the scene ends at {end:e} s, but the timeline sim_time ends at 9.2e9 s: use the timeline step beyond"
            )
        });
        no_step
            .into_iter()
            .chain(beyond)
            .chain(late)
            .chain(summary(self.unseen(), "entry"))
            .chain(of_pairs)
            .chain(of_bodies)
            .chain(self.placement_warning())
            .collect()
    }

    /// Pushes, force points and edits that begin when the last step has ended.
    fn late(&self) -> Vec<String> {
        let pushes = self.pushes.iter().map(|of| (format!("the push on {}", self.bodies[of.body].name), of.start));
        let points = self.points.iter().map(|of| (format!("force point {}", of.name), of.start));
        let edits = self.edits.iter().map(|of| ("an edit".to_owned(), of.time));
        let end = self.steps() as f64 * self.dt;
        let late = pushes.chain(points).chain(edits).filter(|(_, start)| *start >= end * (1.0 - MARGIN));
        let warning = |(what, start)| {
            format!(
                "{what} begins at t = {start}, where the scene has ended (its last step ends at {end:.6}): raise duration, or begin earlier"
            )
        };
        late.map(warning).collect()
    }

    /// Pushes and force points that are over between two steps of an integrator that samples forces at steps. Other
    /// models divide steps there.
    fn unseen(&self) -> Vec<String> {
        if self.integrator == Integrator::Exponential || self.model != Model::Oscillators {
            return Vec::new();
        }
        let pushes =
            self.pushes.iter().map(|of| (format!("the push on {}", self.bodies[of.body].name), of.start, of.end()));
        let points = self.points.iter().map(|of| (format!("force point {}", of.name), of.start, of.end()));
        let unseen =
            pushes.chain(points).filter(|(_, start, end)| (start / self.dt * (1.0 - MARGIN)).ceil() * self.dt >= *end);
        let warning = |(what, start, _): (String, f64, f64)| {
            format!(
                "{what} at t = {start} is over before the next step begins: it has no effect with {}; lower dt, or use exponential",
                self.integrator
            )
        };
        unseen.map(warning).collect()
    }

    /// A warning if bodies were moved out of planes, or will be thrown out by one.
    pub(crate) fn placement_warning(&self) -> Option<String> {
        summary(self.thrown_out(), "body")
    }

    /// Bodies that their influence sphere, which acts on others, does not enclose (3.2).
    fn not_enclosed(&self) -> Vec<String> {
        if self.bodies.len() < 2 {
            return Vec::new();
        }
        let warning = |Body { name, reach, .. }: &Body| {
            format!(
                "reach = {reach} leaves the surface of {name} outside its influence sphere: others feel it only once they are \
                 inside it; use a reach above 1"
            )
        };
        self.bodies.iter().filter(|body| body.reach < 1.0).map(warning).collect()
    }

    /// Bodies whose centre, which is that of their influence sphere, is outside their surface (3.2).
    fn hollow(&self) -> Vec<String> {
        let (mut known, mut warnings) = (HashMap::new(), Vec::new());
        for body in self.bodies.iter().take(MAX_BODIES) {
            if !*known.entry(&body.shape).or_insert_with(|| body.shape.mesh().encloses_centre()) {
                warnings.push(format!(
                    "the centre of {} is outside its surface: its influence sphere acts from where the body is not; use a \
                     shape that encloses its mass centre",
                    body.name
                ));
            }
        }
        warnings
    }
}

/// The first of several warnings, with the number of others.
fn summary(all: Vec<String>, what: &str) -> Option<String> {
    let more = all.len().saturating_sub(1);
    let first = all.into_iter().next()?;
    Some(match more {
        0 => first,
        1 => format!("{first} (and one more {what} like it)"),
        _ => match what.strip_suffix('y') {
            Some(stem) => format!("{first} (and {more} more {stem}ies like it)"),
            None => format!("{first} (and {more} more {what}s like it)"),
        },
    })
}

#[cfg(test)]
mod tests {
    use crate::Scene;

    fn warnings(influence: &str) -> Vec<String> {
        let body = |name: &str, x: f64| {
            format!("[[body]]\nname = '{name}'\nradius = 1.0\nmotion = {{ fixed = [{x}, 0, 0] }}\n")
        };
        let text = format!("duration = 1.0\n[influence]\n{influence}\n{}{}", body("a", 0.0), body("b", 4.0));
        Scene::parse(&text, "warned.toml").unwrap().warnings()
    }

    #[test]
    fn a_threshold_without_effect_is_reported_with_a_level_that_has_one() {
        let found = warnings("merge_at = 3.0\nsplit_at = 3.1");
        assert!(found.len() == 1 && found[0].contains("merge_at = 3 ") && found[0].contains("1.207"), "{found:?}");
        let found = warnings("merge_at = 0.8\nsplit_at = 0.9");
        assert!(found.len() == 1 && found[0].contains("split_at = 0.9 "), "{found:?}");
        assert_eq!(warnings(""), [""; 0]);
    }

    #[test]
    fn what_begins_where_the_scene_has_ended_is_reported() {
        let late = |start: f64| {
            let text = format!(
                "duration = 1.1\ndt = 0.4\n[[body]]\nname = 'a'\nradius = 1.0\nmotion = {{ fixed = [0, 0, 0] }}\n[[push]]\n\
                 body = 'a'\ndirection = [1, 0, 0]\nstrength = 1\nstart = {start}\nduration = 1\n[[edit]]\ntime = {start}\n\
                 set = {{ \"influence.beta\" = 1 }}\n"
            );
            Scene::parse(&text, "late.toml").unwrap().warnings()
        };
        // three steps of 0.4 s
        assert_eq!(late(1.15), [""; 0]);
        let found = late(1.2);
        assert!(found.len() == 1 && found[0].starts_with("the push on a begins at t = 1.2, "), "{found:?}");
        assert!(found[0].ends_with("(and one more entry like it)"), "{found:?}");
    }

    #[test]
    fn a_push_between_two_steps_of_an_explicit_integrator_is_reported() {
        let of_model = |model: &str, integrator: &str, start: f64| {
            let text = format!(
                "duration = 2\ndt = 0.4\nmodel = '{model}'\nintegrator = '{integrator}'\n[[body]]\nname = 'a'\nradius = 1.0\n\
                 motion = {{ fixed = [0, 0, 0] }}\n[[push]]\nbody = 'a'\ndirection = [1, 0, 0]\nstrength = 1\nstart = {start}\n\
                 duration = 0.2\n"
            );
            Scene::parse(&text, "push.toml").unwrap().warnings()
        };
        let found = |integrator: &str, start: f64| of_model("oscillators", integrator, start);
        let warned = found("verlet", 0.5);
        assert!(warned.len() == 1 && warned[0].contains("the push on a at t = 0.5 is over"), "{warned:?}");
        assert_eq!([found("verlet", 0.7), found("verlet", 0.4), found("exponential", 0.5)], [[""; 0]; 3]);
        assert_eq!(of_model("lattice", "verlet", 0.5), [""; 0]);
    }

    /// The conditions of 3.2: the influence sphere encloses its body, which encloses their common centre.
    #[test]
    fn a_sphere_within_its_body_and_a_centre_outside_it_are_reported() {
        let found = warnings("reach = 0.9\nmerge_at = 0.9\nsplit_at = 1.0");
        assert!(
            found.len() == 1 && found[0].contains("reach = 0.9 ") && found[0].contains("surface of a outside"),
            "{found:?}"
        );
        assert!(found[0].ends_with("(and one more body like it)"), "{found:?}");
        assert_eq!(warnings("reach = 1.0\nmerge_at = 0.9\nsplit_at = 1.0"), [""; 0]);

        let own = "duration = 1.0\n[[body]]\nname = 'a'\nradius = 1.0\nreach = 0.8\nmotion = { fixed = [0, 0, 0] }\n\
                   [[body]]\nname = 'b'\nradius = 1.0\nmotion = { fixed = [4, 0, 0] }\n";
        let found = Scene::parse(own, "warned.toml").unwrap().warnings();
        assert!(found.len() == 1 && found[0].starts_with("reach = 0.8 leaves the surface of a outside"), "{found:?}");

        let found = Scene::builtin("mesh").unwrap().warnings();
        assert!(found.len() == 1 && found[0].starts_with("the centre of knot is outside its surface"), "{found:?}");
    }
}
