//! Free bodies that a file places so deep in a plane that it would throw them out start outside instead.

use glam::DVec3;

use super::{Body, Motion, Plane, Scene};

/// Speed at which a plane may throw a body out: its springs, which stop it within 1/ω, then deform it by a quarter of
/// its radius [ω R].
const GENTLE: f64 = 0.25;
/// Moves out of one plane may lead into another: how often to try.
const ROUNDS: usize = 8;

/// A free body that a plane would throw out, as the file places it.
#[derive(Clone, Debug, PartialEq)]
pub struct PushedOut {
    /// Name of the body.
    pub body: String,
    /// How deep it is in the plane that would throw it out the fastest [scene unit].
    pub depth: f64,
    /// At which speed that would throw it out [scene unit/s].
    pub speed: f64,
    /// How far it is moved [scene unit]; `None` if no place outside of all planes was found.
    pub by: Option<DVec3>,
}

/// How deep a body with its centre at `from` is in a plane [scene unit], and the speed at which the plane would throw it
/// out [scene unit/s].
///
/// The energy of the springs, (k/2) ⟨d²⟩ per mass over a sphere's surface, becomes that of the motion; for a cap of depth
/// D, ⟨d²⟩ = D³/(6 R).
fn thrown(plane: &Plane, body: &Body, from: DVec3) -> (f64, f64) {
    let (radius, depth) = (body.radius, (plane.depth(from) + body.radius).max(0.0));
    let mean_square = if depth < 2.0 * radius {
        depth.powi(3) / (6.0 * radius)
    } else {
        (depth - radius).powi(2) + radius * radius / 3.0
    };
    (depth, (plane.stiffness * mean_square).sqrt())
}

impl Scene {
    /// Moves the free bodies that a plane would throw out along its normal until their radius touches it.
    pub(super) fn push_out(&mut self) {
        let planes = &self.planes;
        for body in &mut self.bodies {
            let Motion::Free(free) = &body.motion else { continue };
            let limit = GENTLE * body.material.omega * body.radius;
            let fastest = |from: DVec3| {
                let all = planes.iter().map(|plane| (plane, thrown(plane, body, from)));
                let fastest = all.max_by(|(_, (_, one)), (_, (_, other))| one.total_cmp(other));
                fastest.filter(|(_, (_, speed))| *speed > limit)
            };
            let mut from = free.from;
            let Some((_, (depth, speed))) = fastest(from) else { continue };
            for _ in 0..ROUNDS {
                let Some((plane, (depth, _))) = fastest(from) else { break };
                from += plane.normal * depth;
            }
            let by = fastest(from).is_none().then_some(from - free.from);
            if let Some(by) = by {
                body.motion = body.motion.moved_by(by);
            }
            self.pushed_out.push(PushedOut { body: body.name.clone(), depth, speed, by });
        }
    }

    /// A warning for each body that a plane would throw out.
    pub(super) fn warnings_of_pushed_out(&self) -> Vec<String> {
        let warning = |PushedOut { body, depth, speed, by }: &PushedOut| {
            let start = format!(
                "{body} is placed {depth:.3} deep in a plane, which would throw it out at {speed:.3e} scene units/s"
            );
            match by {
                Some(DVec3 { x, y, z }) => {
                    format!("{start}: it starts outside, moved by [{x:.3}, {y:.3}, {z:.3}]; place it there")
                }
                None => format!(
                    "{start}, and no place outside of all planes was found near it: the solver may fail; place it outside, \
                     lower the plane's stiffness, or raise omega"
                ),
            }
        };
        self.pushed_out.iter().map(warning).collect()
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use crate::{Scene, World};

    fn scene(planes: &[[f64; 4]], stiffness: f64, from: DVec3, rotation: &str) -> Scene {
        let plane = |[x, y, z, offset]: &[f64; 4]| {
            format!("[[plane]]\nnormal = [{x:?}, {y:?}, {z:?}]\noffset = {offset:?}\nstiffness = {stiffness:e}\n")
        };
        let planes: String = planes.iter().map(plane).collect();
        let text = format!(
            "duration = 2.0\ngravity = [0, 0, -9.81]\n{planes}[[body]]\nname = 'a'\nradius = 0.5\nmass = 3.0\nmotion = {{ free = {{ \
             from = [{:?}, {:?}, {:?}], rotation = '{rotation}' }} }}\n",
            from.x, from.y, from.z
        );
        Scene::parse(&text, "pushed.toml").unwrap()
    }

    /// Started at any depth, in soft and stiff planes, a body never rises higher than a radius above the place where it
    /// touches the plane, and rests there.
    #[test]
    fn a_body_inside_a_plane_is_not_thrown_out() {
        for stiffness in [4e3, 1e5] {
            for rotation in ["free", "fixed"] {
                for z in [0.45, 0.4, 0.3, 0.1, -0.3, -3.0] {
                    let mut world =
                        World::new(scene(&[[0.0, 0.0, 1.0, 0.0]], stiffness, DVec3::Z * z, rotation)).unwrap();
                    for _ in 0..120 {
                        let failure = world.step().failure.clone();
                        assert!(failure.is_none(), "{stiffness} {rotation} {z}: {failure:?}");
                        let height = world.bodies().next().unwrap().centre().z;
                        assert!((0.0..1.0).contains(&height), "{stiffness} {rotation} {z}: {height}");
                    }
                }
            }
        }
    }

    #[test]
    fn a_corner_is_left_and_a_slit_is_reported() {
        let corner = [[0.0, 0.0, 1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [-0.6, 0.0, 0.8, 0.0]];
        let found = scene(&corner, 4e3, DVec3::new(-2.0, 0.0, -1.0), "free");
        let from = found.bodies[0].motion.start();
        assert!(found.planes.iter().all(|plane| plane.depth(from) < -0.4), "{from}");
        assert!(found.warnings()[0].contains("it starts outside, moved by ["), "{:?}", found.warnings());
        let slit = [[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, -1.0, -0.5]];
        let found = scene(&slit, 4e3, DVec3::ZERO, "free");
        assert_eq!(found.bodies[0].motion.start(), DVec3::ZERO);
        assert!(found.warnings()[0].contains("no place outside of all planes"), "{:?}", found.warnings());
    }

    /// Bodies no deeper than their weight presses them into a plane stay where the file has them.
    #[test]
    fn a_body_that_rests_on_a_plane_is_not_moved() {
        let found = scene(&[[0.0, 0.0, 1.0, 0.0]], 4e3, DVec3::Z * 0.46, "free");
        assert_eq!((found.bodies[0].motion.start(), found.warnings().len()), (DVec3::Z * 0.46, 0));
    }
}
