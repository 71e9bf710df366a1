//! The crate as a library: what a program builds, changes and implements, and what it is told when that is wrong.

use std::sync::Arc;

use glam::DVec3;
use meldscope::{
    Scene, World,
    geometry::{Shape, Sphere, Vectors},
    model::phase::Phase,
    observe::{
        self, Experiment, Frame, PointForce, Refusal, Schema, Simulation, StepFailure, StepSummary, Want,
        schema::ScalarOf,
    },
    recording::{
        Recorded, diff,
        frames::FrameReader,
        replay::{self, Verdict},
    },
    scene::{
        Body, Force, FreeMotion, Motion, PairLaws, Path, Push, Response,
        path::{Bounds, Given, Kinematics},
    },
    sdk,
    sim::{EditError, WorldError},
    stream::{self, Settings, settings::Entities, sinks::Destinations},
};

use crate::{
    octahedra::Octahedra,
    recording::{Dir, Recording},
};

/// Two balls that fall side by side onto a plane, and a third one far away on a path.
const BALLS: &str = "duration = 2.0
dt = 0.02
gravity = [0, 0, -4]
[[body]]
name = \"a\"
radius = 1.0
shape = { sphere = { stacks = 6, slices = 8 } }
motion = { free = { from = [0, 0, 1.3] } }
[[body]]
name = \"b\"
radius = 0.8
shape = { sphere = { stacks = 6, slices = 8 } }
motion = { free = { from = [1.7, 0.2, 1.6], velocity = [-0.2, 0, 0] } }
[[body]]
name = \"c\"
radius = 1.0
shape = { sphere = { stacks = 6, slices = 8 } }
motion = { fixed = [40, 0, 2] }
[[plane]]
normal = [0, 0, 1]
stiffness = 900.0
";

/// A mistake, and the field that is named for it.
type Mistake<T> = (&'static str, fn(&mut T));

fn balls() -> Scene {
    Scene::parse(BALLS, "balls.toml").expect("a scene")
}

fn world() -> World {
    World::new(balls()).expect("enough memory")
}

fn ball(name: &str, at: [f64; 3]) -> Body {
    Body { shape: balls().bodies[0].shape.clone(), ..Body::new(name, 1.0, FreeMotion::at(at.into())) }
}

fn push(body: usize) -> Push {
    Push { body, direction: DVec3::X, strength: 20.0, start: 0.5, duration: 0.2 }
}

#[test]
fn a_scene_that_no_file_could_describe_names_the_field() {
    assert_eq!(balls().validate(), Ok(()));
    let mistakes: [Mistake<Scene>; 28] = [
        ("dt", |scene| scene.dt = -1.0),
        ("dt", |scene| scene.dt = f64::NAN),
        ("duration", |scene| scene.duration = 0.0),
        ("duration", |scene| scene.duration = 1e14),
        ("tolerance", |scene| scene.tolerance = f64::INFINITY),
        ("gravity", |scene| scene.gravity.y = f64::NAN),
        ("influence.reach", |scene| scene.influence.reach = 0.0),
        ("influence.alpha", |scene| scene.influence.alpha = -1.0),
        ("influence.split_at", |scene| scene.thresholds.split_at = 0.5),
        ("influence.core_at", |scene| scene.thresholds.core_at = 2.0),
        ("bodies", |scene| scene.bodies.clear()),
        ("bodies[1].radius", |scene| scene.bodies[1].radius = -1.0),
        ("bodies[1].radius", |scene| scene.bodies[1].radius = 0.0),
        ("bodies[0].mass", |scene| scene.bodies[0].mass = f64::NAN),
        ("bodies[0].name", |scene| scene.bodies[0].name = "x y~z/".to_owned()),
        ("bodies[2].name", |scene| scene.bodies[2].name = "a".to_owned()),
        ("bodies[0].group", |scene| scene.bodies[0].group = Some("b".to_owned())),
        ("bodies[0].material.response", |scene| scene.bodies[0].material.response = Response::Rigid),
        ("bodies[0].motion.velocity", |scene| {
            let free = FreeMotion { velocity: DVec3::NAN, ..FreeMotion::at(DVec3::ZERO) };
            scene.bodies[0].motion = free.into();
        }),
        ("bodies[2].force", |scene| scene.bodies[2].force = Some(Force::new(1.0, |_, _, _| DVec3::X))),
        ("planes[0].normal", |scene| scene.planes[0].normal = DVec3::new(0.0, 0.0, 10.0)),
        ("bodies[1].shape.slices", |scene| scene.bodies[1].shape = Shape::Sphere(Sphere { stacks: 2, slices: 2 })),
        ("bodies[2].motion.bounds.speed", |scene| scene.bodies[2].motion = given(f64::NAN, 1.0)),
        ("bodies[2].motion.bounds", |scene| scene.bodies[2].motion = given(1e-300, 1.0)),
        ("bodies[2].motion", |scene| scene.bodies[2].motion = given(0.5, 0.0)),
        ("pushes[0].body", |scene| scene.pushes = vec![push(7)]),
        ("pushes[0].direction", |scene| scene.pushes = vec![Push { direction: 10.0 * DVec3::X, ..push(0) }]),
        ("pushes[0].duration", |scene| scene.pushes = vec![Push { duration: -0.1, ..push(0) }]),
    ];
    for (field, mistake) in mistakes {
        let mut scene = balls();
        mistake(&mut scene);
        let invalid = scene.validate().expect_err(field);
        assert_eq!(invalid.field, field, "{invalid}");
        assert!(matches!(World::new(scene.clone()), Err(WorldError::Invalid(found)) if found == invalid));
        assert!(scene.start().is_err_and(|error| error == invalid.to_string()));
    }
}

/// A path at 1 scene unit/s with these bounds.
fn given(speed: f64, acceleration: f64) -> Motion {
    let at = |t| Kinematics { position: DVec3::new(t, 9.0, 0.0), velocity: DVec3::X, acceleration: DVec3::ZERO };
    Path::Given(Given::new(Bounds { speed, acceleration }, at)).into()
}

/// An edit replaces all that edits can set, so it would undo such a change.
#[test]
fn a_scene_with_edits_is_changed_in_its_text_only() {
    let edits =
        "[[edit]]\ntime = 0.1\nset = { 'body.a.omega' = 9 }\n[[edit]]\ntime = 0.2\nset = { 'body.a.omega' = 8 }\n";
    let edited = || Scene::parse(&format!("{BALLS}{edits}"), "balls.toml").expect("a scene");
    assert_eq!(edited().validate(), Ok(()));
    let mistakes: [Mistake<Scene>; 3] = [
        ("edits[0]", |scene| scene.gravity = DVec3::ZERO),
        ("edits[0]", |scene| scene.planes.clear()),
        ("edits[0]", |scene| drop(scene.edits.remove(0))),
    ];
    for (field, mistake) in mistakes {
        let mut scene = edited();
        mistake(&mut scene);
        assert_eq!(scene.validate().expect_err(field).field, field);
    }
    let mut world = World::new(edited()).expect("enough memory");
    world.add(ball("d", [-9.0, 0.0, 5.0])).expect("a new name");
    world.remove(0).expect("a body");
    world.run(50).expect("it runs");
    // without edits, it may be changed
    let mut scene = edited();
    (scene.edits, scene.gravity) = (Vec::new(), DVec3::ZERO);
    assert_eq!(scene.validate(), Ok(()));
}

/// Groups have numbers in the laws of pairs.
#[test]
fn a_body_that_joins_a_group_needs_its_number() {
    let text = BALLS.replacen("name = \"a\"", "name = \"a\"\ngroup = \"g\"", 1);
    let text = format!("{text}[[pair]]\nbodies = ['g', 'b']\nalpha = 7.0\n");
    let mut scene = Scene::parse(&text, "balls.toml").expect("a scene");
    scene.bodies.push(ball("d", [-9.0, 0.0, 5.0]));
    assert_eq!(scene.validate(), Ok(()));
    // a body that is added later does not give its group to one before it
    let mut world = World::new(scene.clone()).expect("enough memory");
    world.add(Body { group: Some("g".to_owned()), ..ball("e", [-9.0, 9.0, 5.0]) }).expect("a new name");
    let law = |a, b| world.scene().law(a, b).alpha;
    assert_eq!([law(1, 4), law(1, 0)], [7.0; 2]);
    assert!(law(1, 3) != 7.0);
    scene.bodies[3].group = Some("g".to_owned());
    assert_eq!(scene.validate().expect_err("no number").field, "bodies[3].group");
    let rules: Vec<_> = scene.pairs.rules().collect();
    scene.pairs = PairLaws::new(vec![Some(0), None, None, Some(0)], &rules).expect("no overlap");
    assert_eq!((scene.validate(), scene.law(1, 3).alpha), (Ok(()), 7.0));
}

#[test]
fn a_change_that_no_file_could_describe_names_the_field_and_changes_nothing() {
    let mut world = world();
    world.run(5).expect("it runs");
    let (checksum, invalid) = (world.checksum(), |result: Result<(), EditError>| match result {
        Err(EditError::Invalid(invalid)) => invalid.field,
        other => panic!("{other:?}"),
    });
    assert_eq!(invalid(world.add(Body { radius: -1.0, ..ball("d", [0.0; 3]) }).map(drop)), "body.radius");
    assert_eq!(invalid(world.add(ball("x y~z/", [0.0; 3])).map(drop)), "body.name");
    assert_eq!(world.add(ball("a", [0.0; 3])), Err(EditError::Name("a".to_owned())));
    assert_eq!(invalid(world.push(Push { direction: 10.0 * DVec3::X, ..push(0) })), "push.direction");
    assert_eq!(world.push(push(7)), Err(EditError::NoBody(7)));
    assert_eq!(invalid(world.set_force(0, Some(Force::new(f64::NAN, |_, _, _| DVec3::ZERO)))), "force.bound");
    assert_eq!(invalid(world.set_force(0, Some(Force::new(1.0, |_, _, _| DVec3::NAN)))), "force");
    assert_eq!(invalid(world.set_force(0, Some(Force::new(1.0, |_, _, _| 2.0 * DVec3::X)))), "force");
    assert_eq!(world.set_force(2, None), Err(EditError::OnPath("c".to_owned())));
    assert_eq!(invalid(world.set_motion(2, Path::Fixed(DVec3::NAN))), "bodies[2].motion.fixed");
    assert_eq!((world.checksum(), world.body_count()), (checksum, 3));
    assert_eq!(world.scene().validate(), Ok(()));
}

#[test]
fn handles_stay_valid_while_bodies_come_and_go() {
    let mut world = world();
    let [a, b, c] = [0, 1, 2].map(|index| world.handle(index).expect("three bodies"));
    let d = world.add(ball("d", [-9.0, 0.0, 5.0])).expect("a new name");
    world.run(10).expect("it runs");
    world.remove(a).expect("it is there");
    assert_eq!([a, b, c, d].map(|body| world.index_of(body)), [None, Some(0), Some(1), Some(2)]);
    assert_eq!(world.get(d).expect("it is there").name(), "d");
    assert!(world.get(a).is_none());
    assert_eq!(world.remove(a), Err(EditError::Stale));
    assert_eq!(world.set_force(a, None), Err(EditError::Stale));
    let e = world.add(ball("e", [-19.0, 0.0, 5.0])).expect("a new name");
    assert_ne!(a, e);
    world.set_force(d, Some(Force::new(30.0, |_, _, _| 30.0 * DVec3::Z))).expect("a free body");
    world.run(40).expect("it runs");
    assert!(world.get(d).expect("it is there").centre().z > 5.0);
    assert!(world.get(e).expect("it is there").centre().z < 5.0);
}

/// A copy of a world continues to the same bits, with bodies on paths and with free ones.
#[test]
fn a_copy_continues_to_the_same_bits() {
    for scene in [balls(), Scene::builtin("two").expect("built in")] {
        let mut world = World::new(scene).expect("enough memory");
        world.run(40).expect("it runs");
        let mut copy = world.clone();
        let checksums = |world: &mut World| {
            let mut all = Vec::new();
            for _ in 0..50 {
                let _ = world.step();
                all.push(world.checksum());
            }
            all
        };
        let first = checksums(&mut world);
        world.push(Push { start: world.time(), ..push(0) }).expect("it is there");
        world.run(3).expect("it runs");
        assert_eq!((copy.steps_taken(), checksums(&mut copy)), (40, first));
    }
}

/// Bodies, pushes and forces that are added in place act as in a scene that has had them from the start, and the energy
/// that they bring is in the ledger.
#[test]
fn changes_in_place_act_as_if_in_the_scene() {
    let (mut known, mut changed) = (world(), world());
    let first = known.conserved().expect("free bodies").energy();
    known.run(12).expect("it runs");
    changed.run(12).expect("it runs");
    // onto the two others
    changed.add(ball("d", [0.9, 0.1, 3.0])).expect("a new name");
    let brought = changed.conserved().expect("free bodies").energy() - known.conserved().expect("free bodies").energy();
    let listed = changed.ledger().total() - known.ledger().total();
    assert!((listed - brought).abs() < 1e-9 * brought.abs(), "{listed} {brought}");
    changed.push(Push { start: changed.time() + 0.05, ..push(1) }).expect("it is there");
    changed.run(60).expect("it runs");
    assert_ne!(changed.phase(0, 3), Phase::Apart);
    let now = changed.conserved().expect("free bodies").energy();
    let left = now - first - changed.ledger().total();
    assert!(left.abs() < 1e-4 * now.abs().max(1.0), "{left:e} of {now}");

    // a world that has entered no step may get anything
    let mut late = World::new(Scene { bodies: balls().bodies[..2].to_vec(), ..balls() }).expect("enough memory");
    late.add(balls().bodies[2].clone()).expect("a new name");
    let mut early = world();
    late.run(30).expect("it runs");
    early.run(30).expect("it runs");
    assert_eq!(late.checksum(), early.checksum());
}

#[test]
fn an_added_body_has_the_law_of_its_group_after_an_edit() {
    let body = |name: &str, group: &str, x: f64| {
        format!(
            "[[body]]\nname = '{name}'\ngroup = '{group}'\nradius = 1.0\nmotion = {{ free = {{ from = [{x}, 0, 0] }} }}\n"
        )
    };
    let scene = |bodies: &[String]| {
        let text = format!(
            "duration = 2.0\n{}[[pair]]\nbodies = ['g', 'h']\nbeta = 200.0\n[[edit]]\ntime = 0.1\nset = {{ 'influence.alpha' = 90.0 }}\n",
            bodies.concat()
        );
        Scene::parse(&text, "groups.toml").expect("a scene")
    };
    let [a, b, c] = [body("a", "g", 0.0), body("b", "h", -9.0), body("c", "h", 2.3)];
    let whole = scene(&[a.clone(), b.clone(), c]);
    let last = whole.bodies[2].clone();
    let mut known = World::new(whole).expect("enough memory");
    let mut added = World::new(scene(&[a, b])).expect("enough memory");
    added.add(last).expect("a new name");
    known.run(60).expect("it runs");
    added.run(60).expect("it runs");
    assert_eq!(added.checksum(), known.checksum());
}

#[test]
fn a_body_at_rest_wakes_for_a_force() {
    let text = BALLS.replace("gravity = [0, 0, -4]", "gravity = [0, 0, 0]").replace("velocity = [-0.2, 0, 0]", "");
    let mut world = World::new(Scene::parse(&text.replace("1.7", "9.7"), "rest.toml").expect("a scene")).unwrap();
    world.run(60).expect("it runs");
    assert_eq!(world.resting_count(), 3);
    world.set_force(1, Some(Force::new(2.0, |_, _, _| 2.0 * DVec3::Y))).expect("a free body");
    let start = world.body(1).centre();
    world.run(50).expect("it runs");
    let moved = world.body(1).centre() - start;
    assert!((moved - DVec3::Y).length() < 1e-6, "{moved}"); // ½ · 2 · 1²
}

/// A path that a program gives a body during a run need not be one before.
#[test]
fn a_given_path_is_checked_where_it_begins() {
    let mut world = world();
    world.run(50).expect("it runs");
    let at = |t: f64| {
        let late = t - 1.0;
        let position = DVec3::new(0.5 * late * late, 9.0, 0.0);
        Kinematics { position, velocity: late * DVec3::X, acceleration: DVec3::X }
    };
    let given = |speed| Path::Given(Given::new(Bounds { speed, acceleration: 1.0 }, at));
    world.set_motion(2, given(0.99)).expect("from t = 1 s on, it is slower");
    world.run(40).expect("it runs");
    assert!(world.set_motion(2, given(0.5)).is_err(), "it is faster by now");
}

/// Not the body that is nearest to it.
#[test]
fn a_force_that_is_no_number_is_named() {
    let mut world = world();
    let force = |t, _, _| if t < 0.3 { DVec3::ZERO } else { DVec3::NAN };
    world.set_force(1, Some(Force::new(1.0, force))).expect("it is free");
    let failure = world.run(100).expect_err("no step is long enough").to_string();
    assert!(failure.contains("force on body \"b\" is not a number"), "{failure}");
}

#[test]
fn a_scene_that_a_program_has_changed_is_recorded_only_with_its_text() {
    let dir = Dir::new();
    let record = |scene: &Scene, name: &str| {
        let destinations = Destinations { save: Some(dir.file(name)), ..Destinations::default() };
        stream::record(scene, Settings::of(scene), &destinations).map_err(|error| error.to_string())
    };
    let mut changed = Scene { duration: 0.1, ..balls() };
    record(&changed, "own.rrd").expect("steps are an override");
    changed.influence.alpha = 50.0;
    let refused = record(&changed, "changed.rrd").expect_err("its text has another alpha");
    assert!(refused.contains("`influence`") && refused.contains("with_source"), "{refused}");
    let text = BALLS.replacen("[[body]]", "[influence]\nalpha = 50\n[[body]]", 1);
    let described = changed.clone().with_source(&text).expect("a scene");
    record(&described, "described.rrd").expect("its text describes it");
    assert!(changed.clone().with_source("no scene").is_err());
    record(&changed.with_source("").expect("no text"), "seen.rrd").expect("only to be looked at");

    let mut world = World::new(balls()).expect("enough memory");
    assert!(world.overrides(None).is_ok());
    world.add(ball("d", [-9.0, 0.0, 5.0])).expect("a new name");
    assert!(world.overrides(None).is_err_and(|why| why.contains("`bodies`")));
}

/// Octahedra that break the contract in one place.
#[derive(Clone, Copy, Debug)]
struct Broken {
    schema: fn(&mut Schema),
    frame: fn(&mut Frame),
    summary: fn(&mut StepSummary),
}

impl Broken {
    const NOWHERE: Broken = Broken { schema: |_| (), frame: |_| (), summary: |_| () };
}

struct BrokenRun(Broken, Box<dyn Simulation>);

impl Experiment for Broken {
    fn schema(&self) -> Schema {
        let mut schema = Octahedra::two(3.0).schema();
        (self.schema)(&mut schema);
        schema
    }
    fn start(&self) -> Result<Box<dyn Simulation>, String> {
        Ok(Box::new(BrokenRun(*self, Octahedra::two(3.0).start()?)))
    }
    fn read(&self, _: &str, _: &str, _: &toml::Table) -> Result<Arc<dyn Experiment>, Refusal> {
        Ok(Arc::new(*self))
    }
}

impl Simulation for BrokenRun {
    fn schema(&self) -> Schema {
        self.0.schema()
    }
    fn steps_taken(&self) -> u64 {
        self.1.steps_taken()
    }
    fn time(&self) -> f64 {
        self.1.time()
    }
    fn step(&mut self, summary: &mut StepSummary) {
        self.1.step(summary);
        (self.0.summary)(summary);
    }
    fn checksum(&self) -> u64 {
        self.1.checksum()
    }
    fn observe(&self, want: Want, frame: &mut Frame) {
        self.1.observe(want, frame);
        (self.0.frame)(frame);
    }
}

#[test]
fn mistakes_of_an_implementer_are_named() {
    assert_eq!(observe::verify(&Octahedra::two(3.0), 100), Ok(()));
    assert_eq!(observe::verify(&Scene::builtin("three").expect("built in"), 100), Ok(()));
    assert_eq!(observe::verify(&balls(), 60), Ok(()));
    let schemas: [Mistake<Schema>; 16] = [
        ("schema.terms has 3 terms with is_sum", |schema| schema.terms.iter_mut().for_each(|term| term.is_sum = true)),
        ("schema.pair_scalars[0].name is \"a/b\"", |schema| schema.pair_scalars[0].name = "a/b"),
        ("schema.body_scalars[0].of", |schema| schema.body_scalars[0].of = ScalarOf::SumOfSteps),
        ("schema.phases is empty", |schema| schema.phases.clear()),
        ("schema.bodies is empty", |schema| schema.bodies.clear()),
        ("schema.bodies[1].name is \"a\"", |schema| schema.bodies[1].name = "a".to_owned()),
        ("schema.bodies[0].name is \"x/y~z\"", |schema| schema.bodies[0].name = "x/y~z".to_owned()),
        ("schema.bodies[0].radius is 0.0", |schema| schema.bodies[0].radius = 0.0),
        ("schema.bodies[0].mass is NaN", |schema| schema.bodies[0].mass = f64::NAN),
        ("schema.dt is -1.0", |schema| schema.dt = -1.0),
        ("schema.terms[1].name is \"spring\"", |schema| schema.terms[1].name = "spring"),
        ("schema.scalars[0].name is \"a b\"", |schema| schema.scalars[0].name = "a b"),
        ("schema.bodies[0].can_tear is set, but its mesh is faceted", |schema| {
            schema.bodies[0].mesh = Arc::new(schema.bodies[0].mesh.as_ref().clone().faceted());
            schema.bodies[0].can_tear = true;
        }),
        ("schema.bodies[0].mesh: triangle 8 refers to vertex 7, but there are 6", |schema| {
            let mesh = &schema.bodies[0].mesh;
            let triangles = mesh.triangles().iter().copied().chain([[0, 1, 7]]).collect();
            schema.bodies[0].mesh = Arc::new(meldscope::geometry::Mesh::new(mesh.positions().clone(), triangles));
        }),
        ("mesh has no triangles", |schema| {
            let corners = schema.bodies[0].mesh.positions().clone();
            schema.bodies[0].mesh = Arc::new(meldscope::geometry::Mesh::new(corners, Vec::new()));
        }),
        ("schema.bodies[0].mesh:", |schema| {
            let mesh = &schema.bodies[0].mesh;
            let open = mesh.triangles()[1..].to_vec();
            schema.bodies[0].mesh = Arc::new(meldscope::geometry::Mesh::new(mesh.positions().clone(), open));
        }),
    ];
    let frames: [Mistake<Frame>; 20] = [
        ("frame.bodies[0].is_absent in step 0 is set, but not", |frame| frame.bodies[0].is_absent = true),
        ("frame.bodies[1].point_forces[0].term", |frame| frame.bodies[1].point_forces = vec![point(7, DVec3::X, 0)]),
        ("frame.bodies[1].point_forces[0].place", |frame| frame.bodies[1].point_forces = vec![point(0, DVec3::NAN, 0)]),
        ("frame.bodies[1].point_forces[0].source", |frame| frame.bodies[1].point_forces = vec![point(0, DVec3::X, 2)]),
        ("but has_forces is not set", |frame| {
            (frame.bodies[1].point_forces, frame.bodies[1].has_forces) = (vec![point(0, DVec3::X, 0)], false);
        }),
        ("frame.body_scalars in step 0 has 1 entries, expected 2", |frame| frame.body_scalars.truncate(1)),
        ("frame.pair_scalars in step 0 has 0 entries, expected 1", |frame| frame.pair_scalars.clear()),
        ("frame.bodies in step 0 has 1 entries, expected 2", |frame| frame.bodies.truncate(1)),
        ("frame.bodies[1].displacements in step 0 has 3", |frame| frame.bodies[1].displacements = some(3)),
        ("frame.bodies[1].velocities in step 0 has 3", |frame| frame.bodies[1].velocities = some(3)),
        ("frame.bodies[0].centre in step 0", |frame| frame.bodies[0].centre.x = f64::NAN),
        ("call `rest()`", |frame| frame.bodies[0].is_at_rest = true),
        ("frame.bodies[0].terms in step 0 has 2 entries", |frame| frame.bodies[0].terms.truncate(2)),
        ("frame.bodies[0].terms[1].accelerations", |frame| frame.bodies[0].terms[1].accelerations = some(3)),
        ("frame.bodies[0].terms[1].source", |frame| frame.bodies[0].terms[1].source = Some(9)),
        ("frame.bodies[0].labels in step 0 has the label", |frame| frame.bodies[0].labels[2] = 9),
        ("frame.pairs[0].a, b in step 0", |frame| frame.pairs[0].b = 9),
        ("frame.pairs[0].a, b in step 0", |frame| (frame.pairs[0].a, frame.pairs[0].b) = (1, 0)),
        ("frame.pairs[0].phase in step 0 is 7", |frame| frame.pairs[0].phase = 7),
        ("frame.pairs[0].q in step 0 is NaN", |frame| frame.pairs[0].q = f64::NAN),
    ];
    let summaries: [Mistake<StepSummary>; 5] = [
        ("summary.timings in step 1 has 0 entries", |summary| summary.timings.clear()),
        ("summary.scalars in step 1 has 0 entries", |summary| summary.scalars.clear()),
        ("summary.events[0].a, b", |summary| summary.events.iter_mut().for_each(|event| event.b = 9)),
        ("summary.events[0].from, to", |summary| summary.events.iter_mut().for_each(|event| event.to = 7)),
        ("summary.events[0].name", |summary| summary.events.iter_mut().for_each(|event| event.name = "bump")),
    ];
    let broken = schemas
        .map(|(text, schema)| (text, Broken { schema, ..Broken::NOWHERE }))
        .into_iter()
        .chain(frames.map(|(text, frame)| (text, Broken { frame, ..Broken::NOWHERE })))
        .chain(summaries.map(|(text, summary)| (text, Broken { summary, ..Broken::NOWHERE })));
    // single vertices are left to `verify`
    let frame = |frame: &mut Frame| frame.bodies[0].positions.x[2] = f64::INFINITY;
    let mistakes = observe::verify(&Broken { frame, ..Broken::NOWHERE }, 100).expect_err("an infinite position");
    assert_eq!(mistakes, ["frame.bodies[0].positions in step 0 has a number that is not finite"]);
    // nor is a failure a mistake of a recording
    let summary = |summary: &mut StepSummary| summary.failure = Some(StepFailure::NotTaken("no more".to_owned()));
    let mistakes = observe::verify(&Broken { summary, ..Broken::NOWHERE }, 100).expect_err("99 steps are left");
    assert!(mistakes[0].ends_with("fails: no more"), "{mistakes:?}");
    let dir = Dir::new();
    for (text, broken) in broken {
        let mistakes = observe::verify(&broken, 100).expect_err(text);
        assert!(mistakes[0].contains(text), "expected {text:?}: {mistakes:?}");
        // a recording says the same
        let file = dir.file("broken.rrd");
        let destinations = Destinations { save: Some(file.clone()), ..Destinations::default() };
        let refused = stream::record(&broken, Settings::of(&broken), &destinations).expect_err(text).to_string();
        assert!(refused.contains(text), "expected {text:?}: {refused}");
    }
}

/// Faceted meshes are drawn with flat faces, alone and as one surface; what is read back are their vertices.
#[test]
fn faces_can_be_drawn_flat() {
    let flat = Broken {
        schema: |schema| {
            let mesh = Arc::new(schema.bodies[0].mesh.as_ref().clone().faceted());
            schema.bodies.iter_mut().for_each(|body| body.mesh = Arc::clone(&mesh));
            schema.phases[1].is_joined = true;
        },
        ..Broken::NOWHERE
    };
    assert_eq!(observe::verify(&flat, 100), Ok(()));
    let dir = Dir::new();
    for (name, entities) in [("body", Entities::Body), ("batch", Entities::Batch)] {
        let destinations = Destinations { save: Some(dir.file(name)), ..Destinations::default() };
        stream::record(&flat, Settings { entities, ..Settings::of(&flat) }, &destinations).expect("disk space");
        let recorded = Recorded::open_as(&dir.file(name), &|_, _, _| Ok(Arc::new(flat))).expect("a recording");
        assert_eq!(replay::verify(&recorded, |_| true).expect("it runs"), Verdict::Identical);
        let difference = diff::diff([&recorded, &recorded], 1e-9).expect("the same bodies");
        assert!(difference.first_bits.is_none() && difference.first_beyond.is_none(), "{difference}");
        let (mut simulation, mut now) = (flat.start().expect("enough memory"), Frame::default());
        let mut frames = FrameReader::open(&recorded).expect("a recording");
        while let Some(frame) = frames.next().expect("frames") {
            simulation.observe(Want::default(), &mut now);
            assert_eq!(frame.compare(&recorded.schema, &now), None, "{name}, step {}", frame.step);
            assert_eq!(frame.surfaces[0].as_ref().map(|surface| surface.positions.len()), Some(6));
            simulation.step(&mut StepSummary::default());
        }
        let recording = Recording::open(&dir.file(name));
        let own = if entities == Entities::Body { "/world/bodies/a/surface" } else { "/world/deforming/surface" };
        for entity in [own, "/world/merged/surface"] {
            let mut seen = 0;
            for row in recording.held(entity, 1..=100) {
                let vectors = |component: &str| row.get::<sdk::datatypes::Vec3D>(component).into_iter();
                let vectors = |component: &str| vectors(component).map(|v| glam::Vec3::from(v.0)).collect::<Vec<_>>();
                let triangles = row.get::<sdk::datatypes::UVec3D>("Mesh3D:triangle_indices");
                let positions = vectors("Mesh3D:vertex_positions");
                let normals = vectors("Mesh3D:vertex_normals");
                assert_eq!((positions.len(), normals.len()), (3 * triangles.len(), 3 * triangles.len()), "{entity}");
                for corners in triangles {
                    let [a, b, c] = corners.0.map(|i| positions[i as usize]);
                    let area = (b - a).cross(c - a);
                    for normal in corners.0.map(|i| normals[i as usize]) {
                        // slivers along a seam have no direction in single precision
                        assert!(area.length() < 1e-4 || normal.distance(area.normalize()) < 1e-3, "{normal} {area}");
                    }
                    seen += 1;
                }
            }
            assert!(seen > 8 * 20, "{name}: {entity} has {seen} triangles");
        }
    }
}

/// A run that fails is recorded up to there, with the cause.
#[test]
fn why_a_run_failed_is_recorded() {
    let diverges = Broken {
        summary: |summary| {
            let failure = || StepFailure::Diverged("the octahedra have burst".to_owned());
            summary.failure = (summary.at.step == 7).then(failure);
        },
        ..Broken::NOWHERE
    };
    let (dir, settings) = (Dir::new(), Settings::of(&diverges));
    let destinations = Destinations { save: Some(dir.file("x.rrd")), ..Destinations::default() };
    assert_eq!(stream::record(&diverges, settings, &destinations).expect("a recording"), 8);
    let open = |read: Broken| Recorded::open_as(&dir.file("x.rrd"), &|_, _, _| Ok(Arc::new(read)));
    let recorded = open(diverges).expect("a recording");
    assert_eq!((recorded.failure.as_deref(), recorded.last()), (Some("the octahedra have burst"), 7));
    let verdict = |recorded: &Recorded| replay::verify(recorded, |_| true).expect("it runs");
    assert_eq!(verdict(&recorded), Verdict::Identical);
    let mended = open(Broken::NOWHERE).expect("a recording");
    assert_eq!(verdict(&mended), Verdict::OtherEnd { replayed: None });
}

fn point(term: usize, place: DVec3, source: u32) -> PointForce {
    PointForce::new(term, place, DVec3::Z, Some(source))
}

fn some(count: usize) -> Vectors {
    (0..count).map(|_| DVec3::ZERO).collect()
}

/// A path as a body's motion, without its enum.
#[test]
fn bodies_are_built_in_a_line() {
    let bodies = vec![
        Body::new("still", 1.0, Path::Fixed(DVec3::ZERO)),
        Body { mass: 2.0, ..Body::new("thrown", 0.5, FreeMotion::at(DVec3::new(3.0, 0.0, 0.0))) },
    ];
    assert!(matches!(bodies[1].motion, Motion::Free(_)));
    let scene = Scene { bodies, ..balls() };
    assert_eq!(World::new(scene).expect("a valid scene").body_count(), 2);
}
