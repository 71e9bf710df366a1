//! Free bodies that a file places so deep in a plane that it would throw them out start outside instead.

use glam::DVec3;

use super::{Body, Motion, Plane, Scene, keys::LARGEST};
use crate::geometry::Shape;

/// Speed at which a plane may throw a body out: its springs, which stop it within 1/ω, then deform it by a quarter of
/// its radius [ω R].
const GENTLE: f64 = 0.25;
/// Moves out of one plane may lead into another: how often to try.
const ROUNDS: usize = 8;

/// A free body that was moved out of a plane that would throw it out.
#[derive(Clone, Debug, PartialEq)]
pub struct PushedOut {
    /// Name of the body.
    pub body: String,
    /// How deep the file places it in the plane [scene unit].
    pub depth: f64,
    /// At which speed that would throw it out [scene unit/s].
    pub speed: f64,
    /// How far it was moved [scene unit].
    pub by: DVec3,
}

/// A plane that would throw a body out.
struct Throw {
    normal: DVec3,
    /// How deep the body is in it [scene unit].
    depth: f64,
    /// At which speed it throws it out [scene unit/s].
    speed: f64,
}

impl Throw {
    /// The energy of the springs, (k/2) ⟨d²⟩ per mass over the surface, becomes that of the motion; for a cap of depth D of a
    /// sphere, ⟨d²⟩ = D³/(6 R).
    fn of(plane: &Plane, body: &Body, centre: DVec3) -> Throw {
        let radius = body.radius;
        let mut depth = (plane.depth(centre) + radius).max(0.0);
        // no vertex is deeper than that
        let is_gentle = plane.stiffness.sqrt() * depth <= GENTLE * body.material.omega * radius;
        let mean_square = if let (Shape::Mesh(file), false) = (&body.shape, is_gentle) {
            let rest = file.mesh().at(radius);
            let depths = || (0..rest.len()).map(|vertex| plane.depth(centre + rest.position(vertex)).max(0.0));
            depth = depths().fold(0.0, f64::max);
            depths().zip(file.mesh().shares()).map(|(depth, share)| share * depth * depth).sum()
        } else if depth < 2.0 * radius {
            depth.powi(3) / (6.0 * radius)
        } else {
            (depth - radius).powi(2) + radius * radius / 3.0
        };
        Throw { normal: plane.normal, depth, speed: (plane.stiffness * mean_square).sqrt() }
    }

    /// By the plane that would throw a body with its centre at `centre` out the fastest, if faster than gently.
    fn fastest(planes: &[Plane], body: &Body, centre: DVec3) -> Option<Throw> {
        let all = planes.iter().map(|plane| Throw::of(plane, body, centre));
        let fastest = all.max_by(|one, other| one.speed.total_cmp(&other.speed));
        fastest.filter(|throw| throw.speed > GENTLE * body.material.omega * body.radius)
    }
}

impl Scene {
    /// Moves the free bodies that a plane would throw out along its normal until they touch it.
    pub(super) fn push_out(&mut self) {
        for body in &mut self.bodies {
            let Motion::Free(free) = &body.motion else { continue };
            let Some(Throw { depth, speed, .. }) = Throw::fastest(&self.planes, body, free.from) else { continue };
            let mut from = free.from;
            for _ in 0..ROUNDS {
                let Some(Throw { normal, depth, .. }) = Throw::fastest(&self.planes, body, from) else { break };
                from += normal * depth;
            }
            let is_valid = from.abs().max_element() <= LARGEST;
            if is_valid && Throw::fastest(&self.planes, body, from).is_none() {
                let by = from - free.from;
                body.motion = body.motion.moved_by(by);
                self.pushed_out.push(PushedOut { body: body.name.clone(), depth, speed, by });
            }
        }
    }

    /// A warning for each body that was moved out of a plane, or that a plane will throw out.
    pub(super) fn thrown_out(&self) -> Vec<String> {
        let start = |name: &str, depth: f64, speed: f64| {
            format!(
                "{name} is placed {depth:.3} deep in a plane, which would throw it out at {speed:.3e} scene units/s"
            )
        };
        let moved = |PushedOut { body, depth, speed, by: DVec3 { x, y, z } }: &PushedOut| {
            let start = start(body, *depth, *speed);
            format!("{start}: it starts outside, moved by [{x:.3}, {y:.3}, {z:.3}]; place it there")
        };
        let left = self.bodies.iter().filter_map(|body| {
            let Motion::Free(free) = &body.motion else { return None };
            let Throw { depth, speed, .. } = Throw::fastest(&self.planes, body, free.from)?;
            let start = start(&body.name, depth, speed);
            Some(format!(
                "{start}: the solver may fail; place it outside of all planes, lower the plane's stiffness, or raise omega"
            ))
        });
        self.pushed_out.iter().map(moved).chain(left).collect()
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use crate::{
        Scene, World,
        geometry::{Shape, files},
        scene::FreeMotion,
    };

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

    /// Started at any depth, in soft and stiff planes, a body never rises above the place where it touches the plane.
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
                        assert!((0.09..0.5 + 1e-9).contains(&height), "{stiffness} {rotation} {z}: {height}");
                    }
                }
            }
        }
    }

    /// A plate that lies on a plane is not in it, though a ball of its size would be.
    #[test]
    fn a_mesh_is_as_deep_as_its_deepest_vertex() {
        let high = |z: f64| {
            let mut text = String::new();
            for k in 0..8 {
                let at = |bit: u32, size: f64| if k >> bit & 1 == 1 { size } else { -size };
                text += &format!("v {} {} {}\n", at(0, 1.0), at(1, 1.0), at(2, 0.05));
            }
            text += "f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\nf 2 4 8 6\n";
            let mut scene = scene(&[[0.0, 0.0, 1.0, 0.0]], 4e3, DVec3::Z * 9.0, "free");
            let plate = files::from_content("p.obj", &text).unwrap().mesh;
            let body = &mut scene.bodies[0];
            (body.radius, body.shape, body.motion) = (1.0, Shape::Mesh(plate), FreeMotion::at(DVec3::Z * z).into());
            scene.push_out();
            scene.bodies[0].motion.start().z
        };
        let half = 0.05 / 2.0025f64.sqrt();
        assert_eq!(high(0.04), 0.04);
        assert_eq!(high(0.03), 0.03); // it is lifted gently
        assert!((high(-0.2) - half).abs() < 1e-12 && (high(-2.0) - half).abs() < 1e-12, "{}", high(-0.2));
    }

    #[test]
    fn a_corner_is_left_and_a_slit_is_reported() {
        let corner = [[0.0, 0.0, 1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [-0.6, 0.0, 0.8, 0.0]];
        let found = scene(&corner, 4e3, DVec3::new(-2.0, 0.0, -1.0), "free");
        let from = found.bodies[0].motion.start();
        assert!(found.planes.iter().all(|plane| plane.depth(from) < -0.42), "{from}");
        assert!(found.warnings()[0].contains("it starts outside, moved by ["), "{:?}", found.warnings());
        let slit = [[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, -1.0, -0.5]];
        let found = scene(&slit, 4e3, DVec3::ZERO, "free");
        assert_eq!(found.bodies[0].motion.start(), DVec3::ZERO);
        assert!(found.warnings()[0].contains("place it outside of all planes"), "{:?}", found.warnings());
    }

    /// A body that a plane lifts gently stays where the file has it.
    #[test]
    fn a_body_that_is_lifted_gently_is_not_moved() {
        let found = scene(&[[0.0, 0.0, 1.0, 0.0]], 4e3, DVec3::Z * 0.46, "free");
        assert_eq!((found.bodies[0].motion.start(), found.warnings().len()), (DVec3::Z * 0.46, 0));
    }
}
