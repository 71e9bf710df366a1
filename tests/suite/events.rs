//! Times at which pairs merge, split, enter and leave their core, against closed forms and brute force, including hard
//! cases on and near the threshold.

use glam::{DVec3, dvec3};
use meldscope::model::phase::{Phase, Thresholds};
use meldscope::scene::{Path, path::Spline};
use meldscope::sim::{Event, events::PairPaths};
use meldscope::{Scene, World};
use proptest::prelude::*;
use std::f64::consts::TAU;

use Phase::{Apart, Core, Merged};

fn scene(text: &str) -> Scene {
    Scene::parse(text, "events.toml").unwrap_or_else(|error| panic!("{error}\n{text}"))
}

fn thresholds(core_at: f64, merge_at: f64, split_at: f64) -> Thresholds {
    Thresholds { merge_at, split_at, core_at }
}

/// The phase changes of a pair in `(start, end]`.
fn changes(paths: &PairPaths<'_>, thresholds: &Thresholds, phase: Phase, start: f64, end: f64) -> Vec<(f64, Phase)> {
    let mut found = vec![];
    paths.phase_changes(thresholds, phase, start, end, |time, to| found.push((time, to)));
    found
}

/// The phase changes of a pair, found step by step, as a world does.
fn changes_by_steps(
    paths: &PairPaths<'_>,
    thresholds: &Thresholds,
    mut phase: Phase,
    dt: f64,
    steps: u32,
) -> Vec<(f64, Phase)> {
    let mut found = vec![];
    for step in 0..steps {
        found.extend(changes(paths, thresholds, phase, f64::from(step) * dt, f64::from(step + 1) * dt));
        phase = found.last().map_or(phase, |&(_, to)| to);
    }
    found
}

fn line(from: DVec3, velocity: DVec3) -> Path {
    Path::Line { from, velocity }
}

fn sine(center: DVec3, amplitude: DVec3, frequency: f64, phase: f64) -> Path {
    Path::Sine { center, amplitude, frequency, phase }
}

const ORIGIN: Path = Path::Fixed(DVec3::ZERO);

/// A scene of two small spheres on the given paths, radii 0.4 and 0.6, so that q is their distance.
fn two(a: Path, b: Path, thresholds: Thresholds, dt: f64, duration: f64) -> Scene {
    let mut scene = scene(
        "duration = 1\n\
         [[body]]\nname = \"a\"\nradius = 0.4\nshape = { sphere = { stacks = 2, slices = 3 } }\nmotion = { fixed = [0, 0, 0] }\n\
         [[body]]\nname = \"b\"\nradius = 0.6\nshape = { sphere = { stacks = 2, slices = 3 } }\nmotion = { fixed = [0, 0, 0] }\n",
    );
    (scene.bodies[0].motion, scene.bodies[1].motion) = (a.into(), b.into());
    (scene.thresholds, scene.dt, scene.duration) = (thresholds, dt, duration);
    scene
}

/// All events of a scene. Each belongs to the first step that does not end before it.
fn events(scene: Scene) -> Vec<Event> {
    let mut world = World::new(scene).expect("enough memory");
    let mut all = vec![];
    for _ in 0..world.scene().steps() {
        let before = world.time();
        let report = world.step();
        let (events, now, step) = (report.events.clone(), report.time, report.step);
        assert!(events.is_sorted_by_key(|event| event.time));
        for event in &events {
            assert_eq!(event.step, step);
            assert!((before < event.time || event.time == 0.0) && event.time <= now, "{event:?} in {before}..{now}");
        }
        all.extend(events);
    }
    all
}

fn random_vector(range: f64) -> impl Strategy<Value = DVec3> {
    prop::array::uniform3(-range..range).prop_map(DVec3::from_array)
}

// ---------------------------------------------------------------------------------------------------------------------
// Closed forms

proptest! {
    #![proptest_config(ProptestConfig { cases: 1000, failure_persistence: None, ..ProptestConfig::default() })]

    /// Two lines: |p + v t|² = L², a quadratic equation for each threshold.
    #[test]
    fn lines_meet_at_the_roots_of_a_quadratic(
        closest in 0.0..1.4,
        closest_at in 2.0..3.0,
        speed in 1.0..3.0,
        turn in random_vector(1.0),
        (from, velocity) in (random_vector(3.0), random_vector(1.0)),
        (core_at, merge_at, more) in (0.2..0.5, 0.6..1.0, prop_oneof![Just(0.0), 0.0..0.4]),
        radii in 0.5..2.0,
    ) {
        let along = turn.normalize();
        let across = along.any_orthonormal_vector();
        let a = line(from, velocity);
        let b = line(from + closest * across - closest_at * speed * along, velocity + speed * along);
        let paths = PairPaths { a: &a, b: &b, radii };
        let thresholds = thresholds(core_at, merge_at, merge_at + more);
        // p and v of the paths, which are rounded
        let (p, v) = (b.position(0.0) - a.position(0.0), b.at(0.0).velocity - a.at(0.0).velocity);
        let root = |level: f64, side: f64| {
            let (m, v2) = (p.dot(v), v.length_squared());
            // distance² of the closest approach, by the cross product: no cancellation
            let under_root = (level * radii).powi(2) * v2 - p.cross(v).length_squared();
            (under_root > 0.0).then(|| (-m + side * under_root.sqrt()) / v2)
        };
        let mut expected = vec![];
        if let Some(time) = root(merge_at, -1.0) {
            expected.push((time, Merged));
            if let Some(time) = root(core_at, -1.0) {
                expected.extend([(time, Core), (root(core_at, 1.0).expect("a second crossing"), Merged)]);
            }
            expected.push((root(merge_at + more, 1.0).expect("a second crossing"), Apart));
        }
        // rounding decides whether a graze counts
        let distances = p.cross(v).length() / v.length() / radii;
        prop_assume!((distances - merge_at).abs() > 1e-3 && (distances - core_at).abs() > 1e-3);
        for found in [
            changes(&paths, &thresholds, Apart, 0.0, 10.0),
            changes_by_steps(&paths, &thresholds, Apart, 1.0 / 60.0, 600),
        ] {
            prop_assert_eq!(found.len(), expected.len(), "{:?} {:?}", found, expected);
            for (found, expected) in found.iter().zip(&expected) {
                prop_assert_eq!(found.1, expected.1);
                // Measured over 80,000 events: 1.2e-14.
                prop_assert!((found.0 - expected.0).abs() <= 2e-14, "{:?} {:?} {:e}", found, expected, found.0 - expected.0);
            }
        }
    }

    /// A sine through the other centre: L = C + A sin θ, so θ = asin((L − C)/A), up and down, in every period.
    #[test]
    fn a_sine_crosses_at_its_arcsines(
        (centre, amplitude) in (1.0..1.4_f64, 0.6..0.9_f64),
        (frequency, phase) in (0.2..2.0, -3.0..3.0),
        along in random_vector(1.0),
        (core_at, more) in (prop_oneof![Just(0.0), 0.55..0.8], prop_oneof![Just(0.0), 0.0..0.3]),
    ) {
        let along = along.normalize();
        let (merge_at, split_at) = (1.0, 1.0 + more);
        let b = sine(centre * along, amplitude * along, frequency, phase);
        let paths = PairPaths { a: &ORIGIN, b: &b, radii: 1.0 };
        let thresholds = thresholds(core_at, merge_at, split_at);
        let lowest = centre - amplitude;
        prop_assume!(f64::abs(core_at - lowest) > 1e-3 && centre + amplitude > split_at + 1e-3);
        let (mut expected, mut now) = (vec![], thresholds.initial(paths.q(0.0)));
        let first = now;
        let mut t = 0.0;
        // the crossings of a level in time: θ = asin + 2πn rising, π − asin + 2πn falling
        let next = |level: f64, falling: bool, after: f64| {
            let asin = f64::asin((level - centre) / amplitude);
            let theta = if falling { TAU / 2.0 - asin } else { asin };
            let rate = TAU * frequency;
            let turns = ((rate * after + phase - theta) / TAU).floor() + 1.0;
            (theta + TAU * turns - phase) / rate
        };
        loop {
            // just past the crossing, to avoid finding it again
            let ways = thresholds.transitions(now).filter(|way| way.level > lowest);
            let ways = ways.map(|way| (next(way.level, way.falling, t + 1e-9), way.to));
            let Some((time, to)) = ways.min_by(|x, y| x.0.total_cmp(&y.0)).filter(|way| way.0 <= 5.0) else { break };
            expected.push((time, to));
            (t, now) = (time, to);
        }
        for found in [
            changes(&paths, &thresholds, first, 0.0, 5.0),
            changes_by_steps(&paths, &thresholds, first, 5.0 / 128.0, 128),
        ] {
            prop_assert_eq!(found.len(), expected.len(), "{:?} {:?}", found, expected);
            for (found, expected) in found.iter().zip(&expected) {
                prop_assert_eq!(found.1, expected.1);
                // Measured over 600,000 events: 2.7e-15.
                let error = (found.0 - expected.0).abs();
                prop_assert!(error <= 4e-15, "{:?} {:?} {:e}", found, expected, error);
            }
        }
    }
}

/// A switch at one distance, merge_at = split_at and no core: merges and splits alternate.
#[test]
fn one_switching_distance_without_core_alternates() {
    let b = sine(dvec3(1.0, 0.0, 0.0), dvec3(0.5, 0.0, 0.0), 5.0, 0.0);
    let paths = PairPaths { a: &ORIGIN, b: &b, radii: 1.0 };
    // q = 1 + sin(10πt)/2 rises through 1 at n/5, falls at n/5 + 1/10; at t = 0 it is at 1 and rising.
    for found in [
        changes(&paths, &thresholds(0.0, 1.0, 1.0), Merged, 0.0, 2.05),
        changes_by_steps(&paths, &thresholds(0.0, 1.0, 1.0), Merged, 2.05 / 300.0, 300),
    ] {
        assert_eq!(found.len(), 21, "{found:?}");
        for (k, &(time, to)) in found.iter().enumerate() {
            assert_eq!(to, if k % 2 == 0 { Apart } else { Merged });
            assert!((time - k as f64 / 10.0).abs() <= 1e-15 * (1.0 + k as f64), "{k}: {time}");
        }
    }
}

// ---------------------------------------------------------------------------------------------------------------------
// Several events in one step, short visits, grazes

#[test]
fn a_pair_can_merge_and_split_within_a_step() {
    let b = line(dvec3(-50.0, 0.6, 0.0), dvec3(100.0, 0.0, 0.0));
    for (core_at, expected) in [(0.0, vec![Merged, Apart]), (0.8, vec![Merged, Core, Merged, Apart])] {
        let found = events(two(ORIGIN, b.clone(), thresholds(core_at, 1.0, 1.25), 1.0, 3.0));
        assert_eq!(found.iter().map(|event| event.to).collect::<Vec<_>>(), expected);
        assert!(found.iter().all(|event| event.step == 1));
        // chords at height 0.6: 0.8 before the middle at distance 1
        let last = found.len() - 1;
        assert!((found[0].time - (0.5 - 0.8 / 100.0)).abs() <= 1e-15);
        assert!((found[last].time - (0.5 + (1.25f64.powi(2) - 0.36).sqrt() / 100.0)).abs() <= 1e-15);
        if core_at > 0.0 {
            let half = (0.64f64 - 0.36).sqrt() / 100.0;
            assert!((found[1].time - (0.5 - half)).abs() <= 1e-15 && (found[2].time - (0.5 + half)).abs() <= 1e-15);
        }
    }
}

/// A pair leaves its core, at whose rim the force changes gradually, and splits in the same step; also on the way back.
#[test]
fn a_pair_that_leaves_a_gradual_core_splits_in_the_same_step() {
    let body = |name: &str, motion: &str| {
        format!(
            "[[body]]\nname = '{name}'\nradius = 1.0\nshape = {{ sphere = {{ stacks = 3, slices = 4 }} }}\nmotion = {motion}\n"
        )
    };
    for speed in [1.5, 3.0, 7.0, 20.0, 60.0] {
        for (a, b) in [
            ("{ fixed = [0, 0, 0] }", "{ line = { from = [1.0, 0, 0], velocity = [V, 0, 0] } }"),
            ("{ fixed = [0, 0, 0] }", "{ free = { from = [1.0, 0, 0], velocity = [V, 0, 0] } }"),
            ("{ free = { from = [0, 0, 0] } }", "{ free = { from = [1.0, 0, 0], velocity = [V, 0, 0] } }"),
            ("{ fixed = [0, 0, 0] }", "{ line = { from = [-3.0, 0, 0], velocity = [V, 0, 0] } }"),
        ] {
            let motion = b.replace('V', &speed.to_string());
            let start: f64 = if b.contains("-3.0") { -3.0 } else { 1.0 };
            let text =
                "duration = 4.0\n[influence]\nalpha = 0\nbeta = 0\nmerge_at = 1.02\nsplit_at = 1.02\ncore_at = 1.01\n\
                        core_width = 0.3\n"
                    .to_owned()
                    + &body("a", a)
                    + &body("b", &motion);
            let found: Vec<(Phase, f64)> = events(scene(&text)).iter().map(|event| (event.to, event.time)).collect();
            let time = |q: f64| (2.0 * q - start) / speed;
            let mut expected = vec![(Merged, time(1.01)), (Apart, time(1.02))];
            if start < 0.0 {
                expected.splice(0..0, [(Merged, time(-1.02)), (Core, time(-1.01))]);
            }
            let is_same = |(found, expected): (&(Phase, f64), &(Phase, f64))| {
                found.0 == expected.0 && (found.1 - expected.1).abs() < 1e-9
            };
            assert!(
                found.len() == expected.len() && found.iter().zip(&expected).all(is_same),
                "{a} {motion}: {found:?} {expected:?}"
            );
        }
    }
}

/// Visits of 1e-7 s to the inside of each threshold, at various times within a step.
#[test]
fn a_visit_of_a_ten_millionth_of_a_second_is_found() {
    let (speed, half) = (1e4, 0.5e-7);
    for middle in [0.005, 1.0 / 60.0 - 1e-7, 1.0 / 60.0, 0.4321] {
        for (level, inside) in [(1.0, Merged), (0.5, Core)] {
            let height = f64::sqrt(level * level - (speed * half) * (speed * half));
            let b = line(dvec3(-speed * middle, height, 0.0), dvec3(speed, 0.0, 0.0));
            let paths = PairPaths { a: &ORIGIN, b: &b, radii: 1.0 };
            let thresholds = thresholds(0.5, 1.0, 1.0);
            for found in [
                changes(&paths, &thresholds, Apart, 0.0, 1.0),
                changes_by_steps(&paths, &thresholds, Apart, 1.0 / 60.0, 60),
                events(two(ORIGIN, b.clone(), thresholds, 1.0 / 60.0, 1.0)).iter().map(|e| (e.time, e.to)).collect(),
            ] {
                assert_eq!(found.len(), if inside == Core { 4 } else { 2 }, "{found:?}");
                let visit = found.iter().position(|change| change.1 == inside).expect("a visit");
                let visit = if inside == Core { visit } else { 0 };
                let error =
                    f64::max((found[visit].0 - (middle - half)).abs(), (found[visit + 1].0 - (middle + half)).abs());
                // Measured: 5.6e-17.
                assert!(error <= 8e-17, "{middle}: {found:?}, {error:e}");
            }
        }
    }
}

/// A line that passes exactly at the merge distance, or slightly nearer or farther.
#[test]
fn a_graze_has_both_events_or_none() {
    for speed in [1.0, 7.3] {
        for split_at in [1.5, 1.75] {
            let thresholds = thresholds(0.0, 1.5, split_at);
            let graze = |height: f64| {
                let b = line(dvec3(-3.0, height, 0.0), dvec3(speed, 0.0, 0.0));
                let paths = PairPaths { a: &ORIGIN, b: &b, radii: 1.0 };
                let at_once = changes(&paths, &thresholds, Apart, 0.0, 6.0);
                let by_steps = changes_by_steps(&paths, &thresholds, Apart, 1.0 / 64.0, 384);
                // Exactly at that distance, rounding decides, but a pair that merges also splits.
                assert!([0, 2].contains(&at_once.len()), "{at_once:?}");
                assert!([0, 2].contains(&by_steps.len()), "{by_steps:?}");
                if (height - 1.5).abs() > 1e-13 {
                    assert_eq!(at_once.len(), by_steps.len(), "{at_once:?} {by_steps:?}");
                }
                at_once
            };
            // Nearer by one part in 10¹²: merges and splits again.
            for nearer in [1e-3, 1e-6, 1e-9, 1e-12] {
                let found = graze(1.5 - nearer);
                assert_eq!(found.iter().map(|change| change.1).collect::<Vec<_>>(), [Merged, Apart], "{nearer:e}");
                let half = ((3.0 - nearer) * nearer).sqrt() / speed;
                // Near the closest approach, the distance changes only by rounding, and the time is equally uncertain.
                let bound = 1e-15 / (half * speed * speed) + 1e-14;
                assert!((found[0].0 - (3.0 / speed - half)).abs() <= bound, "{nearer:e}: {found:?}");
                if split_at == 1.5 {
                    assert!((found[1].0 - (3.0 / speed + half)).abs() <= bound, "{nearer:e}: {found:?}");
                } else {
                    let out = 3.0 / speed + (split_at.powi(2) - (1.5 - nearer).powi(2)).sqrt() / speed;
                    assert!((found[1].0 - out).abs() <= 1e-14, "{nearer:e}: {found:?}");
                }
            }
            for farther in [1e-3, 1e-6, 1e-9, 1e-12] {
                assert_eq!(graze(1.5 + farther), [], "{farther:e}");
            }
            for nearer in [0.0, 1e-13, 1e-14, 1e-15, -1e-13, -1e-14, -1e-15] {
                graze(1.5 - nearer);
            }
        }
    }
}

// ---------------------------------------------------------------------------------------------------------------------
// On the threshold

/// Bodies that move in parallel keep their distance. Even at the merge distance, they neither merge nor split.
#[test]
fn bodies_in_formation_exactly_at_the_threshold_have_no_events() {
    let keys = |offset: DVec3| {
        let keys = [(0.0, dvec3(0.1, 0.2, 0.3)), (1.0, dvec3(2.3, -0.7, 0.9)), (2.5, dvec3(0.0, 1.1, 0.4))];
        Path::Keyframes(Spline::new(&keys.map(|(t, p)| (t, p + offset))))
    };
    let still = |offset: DVec3| Path::Fixed(dvec3(0.3, 0.1, 0.7) + offset);
    let lines = |offset: DVec3| line(dvec3(0.3, 0.1, 0.7) + offset, dvec3(1.3, -0.37, 0.11));
    let sines = |offset: DVec3| sine(dvec3(0.3, 0.1, 0.7) + offset, dvec3(0.9, 0.33, -0.2), 0.7, 0.4);
    let formations: [&dyn Fn(DVec3) -> Path; 4] = [&still, &lines, &sines, &keys];
    for (kind, formation) in formations.iter().enumerate() {
        for offset in [dvec3(1.0, 0.0, 0.0), dvec3(0.3, 0.7, -0.55), dvec3(-0.123, 0.1, 1.07)] {
            let (a, b) = (formation(DVec3::ZERO), formation(offset));
            let paths = PairPaths { a: &a, b: &b, radii: 1.0 };
            for q in [paths.q(0.0), offset.length()] {
                for (law, phases) in [
                    (thresholds(0.0, q, q), [Apart, Merged].as_slice()),
                    (thresholds(0.0, 0.9 * q, q), &[Apart, Merged]),
                    (thresholds(q, 1.5 * q, 1.5 * q), &[Merged, Core]),
                ] {
                    for &phase in phases {
                        assert_eq!(
                            changes_by_steps(&paths, &law, phase, 1.0 / 60.0, 240),
                            [],
                            "{kind} {phase} {offset}"
                        );
                        assert_eq!(changes(&paths, &law, phase, 0.0, 4.0), [], "{kind} {phase} {offset}");
                    }
                    assert_eq!(events(two(a.clone(), b.clone(), law, 1.0 / 60.0, 1.0)), [], "{kind} {offset}");
                }
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    /// For any merge_at and reach of influence: a pair exactly at merge_at is merged, a pair beyond it is not, and both
    /// stay so.
    #[test]
    fn a_still_pair_on_the_threshold_is_merged_from_the_start(
        (a, b) in (random_vector(5.0), random_vector(5.0)),
        radii in (0.1..2.0, 0.1..2.0),
        reach in prop_oneof![Just(std::f64::consts::SQRT_2), 0.01..3.0],
    ) {
        prop_assume!(a.distance(b) > 0.1);
        let mut scene = two(Path::Fixed(a), Path::Fixed(b), thresholds(0.0, 1.0, 1.0), 1.0 / 60.0, 0.1);
        scene.bodies.iter_mut().for_each(|body| body.reach = reach);
        (scene.bodies[0].radius, scene.bodies[1].radius) = radii;
        let q = (a - b).length() / (radii.0 + radii.1);
        for (merge_at, expected) in [(q, Merged), (q.next_up(), Merged), (q.next_down(), Apart)] {
            for (core_at, expected) in [(0.0, expected), (0.5 * q, expected)] {
                scene.thresholds = thresholds(core_at, merge_at, merge_at);
                let mut world = World::new(scene.clone()).expect("enough memory");
                prop_assert_eq!(world.phase(0, 1), expected);
                for _ in 0..5 {
                    prop_assert!(world.step().events.is_empty());
                    prop_assert_eq!(world.phase(0, 1), expected);
                    prop_assert_eq!(world.pairs().any(|pair| pair.phase == Merged), expected == Merged);
                }
            }
        }
        scene.thresholds = thresholds(q, 2.0 * q, 2.0 * q);
        prop_assert_eq!(World::new(scene.clone()).expect("enough memory").phase(0, 1), Merged);
        scene.thresholds = thresholds(q.next_up(), 2.0 * q, 2.0 * q);
        prop_assert_eq!(World::new(scene).expect("enough memory").phase(0, 1), Core);
    }
}

#[test]
fn a_pair_that_starts_on_its_threshold_and_moves_across_changes_at_once() {
    // at constant speed, and from a standstill
    let movers = |from: f64, way: f64| {
        [
            line(dvec3(from, 0.0, 0.0), dvec3(way, 0.0, 0.0)),
            line(dvec3(0.0, from, 0.0), dvec3(0.0, 1e-3 * way, 0.0)),
            sine(dvec3(from, 0.0, 0.0), dvec3(way, 0.0, 0.0), 0.1, 0.0),
            sine(dvec3(from + way, 0.0, 0.0), dvec3(way, 0.0, 0.0), 0.1, -TAU / 4.0),
            Path::Keyframes(Spline::new(&[(0.0, dvec3(from, 0.0, 0.0)), (9.0, dvec3(from + way, 0.0, 0.0))])),
        ]
    };
    for (law, first, way, to) in [
        (thresholds(0.0, 1.25, 1.25), Merged, 1.0, Apart),
        (thresholds(0.5, 1.25, 1.25), Merged, 1.0, Apart),
        (thresholds(1.25, 2.0, 2.0), Merged, -1.0, Core),
    ] {
        for b in movers(1.25, way) {
            let paths = PairPaths { a: &ORIGIN, b: &b, radii: 1.0 };
            assert_eq!(law.initial(paths.q(0.0)), first);
            let found = events(two(ORIGIN, b.clone(), law, 1.0 / 60.0, 0.5));
            assert_eq!(found.len(), 1, "{b:?}: {found:?}");
            assert_eq!((found[0].from, found[0].to, found[0].step), (first, to, 1), "{b:?}");
            // From a standstill, q stays within a rounding error of the threshold for a while.
            assert!((found[0].q - 1.25).abs() <= 1e-12, "{b:?}: {found:?}");
            if matches!(b, Path::Line { .. }) {
                assert_eq!(found[0].time, 0.0);
            }
        }
        // In the other direction nothing happens.
        for b in movers(1.25, -way) {
            let found = events(two(ORIGIN, b.clone(), law, 1.0 / 60.0, 0.5));
            assert!(found.is_empty(), "{b:?}: {found:?}");
        }
    }
}

/// A pair that comes to rest exactly on its threshold reaches it once.
#[test]
fn a_pair_that_stops_on_its_threshold_has_reached_it() {
    let keys = |keys: &[(f64, f64)]| {
        Path::Keyframes(Spline::new(&keys.iter().map(|&(t, x)| (t, dvec3(x, 0.0, 0.0))).collect::<Vec<_>>()))
    };
    for (stops, first, law, to) in [
        (keys(&[(0.0, 3.0), (1.0, 1.5)]), Apart, thresholds(0.0, 1.5, 1.5), Merged),
        (keys(&[(0.0, 3.0), (1.0, 1.5)]), Apart, thresholds(0.5, 1.5, 2.0), Merged),
        (keys(&[(0.0, 0.5), (1.0, 1.5)]), Merged, thresholds(0.25, 1.0, 1.5), Apart),
        (keys(&[(0.0, 0.5), (1.0, 1.5)]), Merged, thresholds(0.25, 1.5, 1.5), Apart),
        (keys(&[(0.0, 0.5), (1.0, 1.5)]), Core, thresholds(1.5, 2.0, 2.0), Merged),
    ] {
        let paths = PairPaths { a: &ORIGIN, b: &stops, radii: 1.0 };
        for found in [
            changes(&paths, &law, first, 0.0, 4.0),
            changes_by_steps(&paths, &law, first, 1.0 / 60.0, 240),
            events(two(ORIGIN, stops.clone(), law, 0.1, 4.0)).iter().map(|e| (e.time, e.to)).collect(),
        ] {
            assert_eq!(found.iter().map(|change| change.1).collect::<Vec<_>>(), [to], "{law:?}");
            // it stays that close during the last instants
            assert!((0.9999..=1.0).contains(&found[0].0) && (paths.q(found[0].0) - 1.5).abs() <= 1e-12, "{found:?}");
        }
    }
    // A pair that turns back at the threshold may or may not reach it. If it does, and one distance switches both ways,
    // it also splits.
    let turns = keys(&[(0.0, 3.0), (1.0, 1.5), (2.0, 3.0)]);
    let paths = PairPaths { a: &ORIGIN, b: &turns, radii: 1.0 };
    for found in [
        changes(&paths, &thresholds(0.0, 1.5, 1.5), Apart, 0.0, 4.0),
        changes_by_steps(&paths, &thresholds(0.0, 1.5, 1.5), Apart, 1.0 / 60.0, 240),
    ] {
        assert!(found.is_empty() || found.len() == 2, "{found:?}");
    }
}

// ---------------------------------------------------------------------------------------------------------------------
// Brute force

/// The phase changes found by dense sampling, with times by bisection.
fn brute_force(paths: &PairPaths<'_>, law: &Thresholds, mut phase: Phase, end: f64, samples: u32) -> Vec<(f64, Phase)> {
    let time = |k: u32| end * f64::from(k) / f64::from(samples);
    let mut found = vec![];
    for k in 0..samples {
        let (start, end) = (time(k), time(k + 1));
        let mut from = start;
        loop {
            let crossed = |way: &meldscope::model::phase::Transition| {
                let q = paths.q(end);
                if way.falling { q <= way.level } else { q >= way.level }
            };
            let Some(way) = law.transitions(phase).find(crossed) else { break };
            let (mut low, mut high) = (from, end);
            while low + 0.5 * (high - low) > low && low + 0.5 * (high - low) < high {
                let t = low + 0.5 * (high - low);
                let beyond = if way.falling { paths.q(t) <= way.level } else { paths.q(t) >= way.level };
                *(if beyond { &mut high } else { &mut low }) = t;
            }
            found.push((high, way.to));
            (phase, from) = (way.to, high);
        }
    }
    found
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn events_on_keyframes_match_brute_force(
        a in prop::collection::vec(random_vector(1.0), 2..6),
        b in prop::collection::vec(random_vector(1.6), 2..7),
        widths in prop::collection::vec(0.2..0.9, 7),
        (core_at, more) in (prop_oneof![Just(0.0), 0.2..0.95], prop_oneof![Just(0.0), 0.0..0.5]),
    ) {
        let spline = |points: &[DVec3], scale: f64| {
            let mut t = 0.1 * scale;
            let keys: Vec<_> = points.iter().zip(&widths).map(|(p, width)| { t += scale * width; (t, *p) }).collect();
            Path::Keyframes(Spline::new(&keys))
        };
        let (a, b) = (spline(&a, 1.0), spline(&b, 0.9));
        let paths = PairPaths { a: &a, b: &b, radii: 1.3 };
        let law = thresholds(core_at, 1.0, 1.0 + more);
        let first = law.initial(paths.q(0.0));
        let (end, samples) = (4.0, 8000);
        let found = changes(&paths, &law, first, 0.0, end);

        // Every event is a valid transition of the state machine, at its threshold.
        let (mut phase, mut time) = (first, 0.0);
        for &(t, to) in &found {
            let way = law.transitions(phase).find(|way| way.to == to);
            prop_assert!(way.is_some(), "{} to {}", phase, to);
            // Measured: 7.2e-15.
            prop_assert!((paths.q(t) - way.unwrap().level).abs() <= 1.1e-14, "{:e}", paths.q(t) - way.unwrap().level);
            prop_assert!(t >= time && t <= end);
            (phase, time) = (to, t);
        }
        // No threshold is crossed between events.
        let phase_at = |t: f64| found.iter().rev().find(|change| change.0 <= t).map_or(first, |change| change.1);
        for k in 0..=samples {
            let t = end * f64::from(k) / f64::from(samples);
            let q = paths.q(t);
            let range = match phase_at(t) {
                Apart => law.merge_at..=f64::INFINITY,
                Merged => law.core_at..=law.split_at,
                Core => 0.0..=law.core_at,
            };
            prop_assert!(*range.start() - 1e-12 <= q && q <= *range.end() + 1e-12, "{} at {}, {}", q, t, phase_at(t));
        }
        // Sampling finds all events except pairs of events between two samples.
        let brute = brute_force(&paths, &law, first, end, samples);
        let short = found.windows(2).any(|pair| pair[1].0 - pair[0].0 < 2.0 * end / f64::from(samples));
        prop_assert!(found.len() == brute.len() || short, "{:?} {:?}", found, brute);
        if found.len() == brute.len() {
            for (found, brute) in found.iter().zip(&brute) {
                prop_assert_eq!(found.1, brute.1);
                // At both times, q is on the threshold within rounding, which is true for longer the slower q changes.
                // Measured: 2.5e-15.
                let slope = (paths.q(found.0 + 1e-6) - paths.q(found.0 - 1e-6)).abs() / 2e-6;
                // Each is also uncertain by its own rounding.
                let rounding = f64::EPSILON * found.0 * slope;
                prop_assert!((found.0 - brute.0).abs() * slope <= 3.7e-15 + rounding, "{:?} {:?}", found, brute);
            }
        }
        // The search step by step finds the same events.
        let by_steps = changes_by_steps(&paths, &law, first, end / 240.0, 240);
        prop_assert_eq!(by_steps.len(), found.len(), "{:?} {:?}", found, by_steps);
        for (one, other) in found.iter().zip(&by_steps) {
            prop_assert_eq!(one.1, other.1);
            let slope = (paths.q(one.0 + 1e-6) - paths.q(one.0 - 1e-6)).abs() / 2e-6;
            let rounding = f64::EPSILON * one.0 * slope;
            prop_assert!((one.0 - other.0).abs() * slope <= 3.7e-15 + rounding, "{:?} {:?}", one, other);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 100, failure_persistence: None, ..ProptestConfig::default() })]

    /// A world tracks only pairs that can touch. It misses none, however fast or large the bodies and steps are.
    #[test]
    fn a_world_has_the_events_of_all_its_pairs(
        movers in prop::collection::vec(
            (random_vector(4.0), random_vector(4.0), 0.1..1.0, 0.5..2.0, 0.0..1.5, any::<bool>()),
            2..12,
        ),
        dt in prop_oneof![Just(1.0 / 60.0), Just(0.3), Just(2.0)],
        merge_at in 0.5..1.5,
        core_at in prop_oneof![Just(0.0), 0.2..0.45],
    ) {
        let mut scene = two(ORIGIN, ORIGIN, thresholds(core_at, merge_at, 1.2 * merge_at), dt, 2.0);
        let body = scene.bodies.remove(0);
        scene.bodies = movers.iter().enumerate().map(|(index, &(centre, motion, radius, reach, frequency, straight))| {
            let path = if straight { line(centre, motion) } else { sine(centre, motion, frequency, 0.3) };
            meldscope::scene::Body { name: format!("b{index}"), radius, reach, motion: path.into(), ..body.clone() }
        }).collect();
        let steps = scene.steps() as u32;
        let mut expected = vec![];
        for a in 0..scene.bodies.len() {
            for b in a + 1..scene.bodies.len() {
                let (one, other) = (&scene.bodies[a], &scene.bodies[b]);
                let paths = PairPaths { a: one.path().unwrap(), b: other.path().unwrap(), radii: one.radius + other.radius };
                let first = scene.thresholds.initial(paths.q(0.0));
                let changes = changes_by_steps(&paths, &scene.thresholds, first, dt, steps);
                expected.extend(changes.into_iter().map(|(time, to)| (time, a, b, to)));
            }
        }
        expected.sort_by(|x, y| x.0.total_cmp(&y.0));
        let found: Vec<_> = events(scene).iter().map(|e| (e.time, e.a as usize, e.b as usize, e.to)).collect();
        // The world searches for events some steps ahead: times agree up to rounding.
        let same = |found: &(f64, usize, usize, Phase), expected: &(f64, usize, usize, Phase)| {
            (found.0 - expected.0).abs() <= 1e-13 && (found.1, found.2, found.3) == (expected.1, expected.2, expected.3)
        };
        prop_assert_eq!(found.len(), expected.len());
        prop_assert!(found.iter().zip(&expected).all(|(f, e)| same(f, e)), "{:?} {:?}", found, expected);
    }
}

// ---------------------------------------------------------------------------------------------------------------------
// Steps

/// An event exactly at the end of a step belongs to that step, and not also to the next.
#[test]
fn an_event_on_a_step_boundary_happens_once() {
    // q = 4 − t falls to 1.5 at 2.5 and through 1 at 3; q = t − 2 rises to … all exact in binary fractions
    let in_and_out = Path::Keyframes(Spline::new(&[(0.0, dvec3(4.0, 0.0, 0.0)), (4.0, dvec3(0.5, 0.0, 0.0))]));
    let b = line(dvec3(4.0, 0.0, 0.0), dvec3(-1.0, 0.0, 0.0));
    for dt in [1.0 / 64.0, 0.25, 0.5] {
        let found = events(two(ORIGIN, b.clone(), thresholds(1.0, 1.5, 1.75), dt, 8.0));
        let expected = [(2.5, Merged), (3.0, Core), (5.0, Merged), (5.75, Apart)];
        assert_eq!(found.iter().map(|e| (e.time, e.to)).collect::<Vec<_>>(), expected);
        for event in found {
            assert_eq!(event.step, (event.time / dt).ceil() as u64, "{event:?}");
        }
        assert_eq!(events(two(ORIGIN, in_and_out.clone(), thresholds(1.0, 1.5, 1.75), dt, 8.0)).len(), 2);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() })]

    /// A crossing at a step boundary, up to rounding, is found once, in the first step that does not end before it.
    #[test]
    fn an_event_near_a_step_boundary_happens_once(
        step in 1..40_u32,
        dt in prop_oneof![Just(1.0 / 60.0), Just(0.1), 0.01..0.2],
        level in prop_oneof![Just(1.05), 0.5..2.0],
        part in 0.05..0.95,
        ulps in -3..4_i32,
        outwards in any::<bool>(),
    ) {
        // moves over that part of the threshold's distance by then
        let time = f64::from(step) * dt;
        let speed: f64 = part * level / time;
        let way = if outwards { speed } else { -speed };
        let from = level - way * time;
        let from = (0..ulps.abs()).fold(from, |x, _| if ulps > 0 { x.next_up() } else { x.next_down() });
        let b = line(dvec3(from, 0.0, 0.0), dvec3(way, 0.0, 0.0));
        let law = if outwards { thresholds(0.0, level, level) } else { thresholds(0.0, level, 2.0 * level) };
        let mut scene = two(ORIGIN, b, law, dt, 1.0);
        scene.duration = f64::from(step + 3) * dt;
        let found = events(scene); // checks the step of each
        prop_assert_eq!(found.len(), 1, "{:?}", found);
        // Measured: 1.7e-15.
        prop_assert!((found[0].time - time).abs() * speed <= 2.6e-15, "{:?} {}", found, time);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    /// A free body far away, or a core at which the force changes gradually, hands the pair to the solver of free bodies. Its
    /// events stay where they are, also if the path turns several times in a step.
    #[test]
    fn pairs_on_paths_have_the_same_events_in_coupled_scenes(
        (center, amplitude) in (random_vector(1.5), random_vector(3.0)),
        (frequency, phase) in (0.2..1.5, 0.0..TAU),
        from in random_vector(1.0),
        velocity in random_vector(1.0),
        (core_at, merge_at, more) in (0.3..0.7, 0.8..1.2, 0.01..0.4),
        dt in 0.05..1.5,
    ) {
        let text = "duration = 1\n[influence]\ncore_at = 0.3\n[material]\nresponse = 'rigid'\n[[body]]\nname = 'a'\nradius = 0.4\nshape = { sphere = { stacks = 2, slices = 3 } }\n\
                    motion = { fixed = [0, 0, 0] }\n[[body]]\nname = 'b'\nradius = 0.6\nshape = { sphere = { stacks = 2, slices = 3 } }\n\
                    motion = { fixed = [0, 0, 0] }\n";
        let far = "[[body]]\nname = 'far'\nradius = 1\nshape = { sphere = { stacks = 2, slices = 3 } }\nresponse = 'inertial'\n\
                   motion = { free = { from = [900, 0, 0] } }\n";
        let found = |text: &str| {
            let mut scene = scene(text);
            scene.bodies[0].motion = line(from, velocity).into();
            scene.bodies[1].motion = sine(center, amplitude, frequency, phase).into();
            (scene.thresholds, scene.dt, scene.duration) = (thresholds(core_at, merge_at, merge_at + more), dt, 4.0 * dt);
            events(scene)
        };
        let expected = found(text);
        let wide = text.replace("core_at = 0.3\n", "core_at = 0.3\ncore_width = 0.05\n");
        for text in [format!("{text}{far}"), wide] {
            let events = found(&text);
            let kinds = |events: &[Event]| events.iter().map(|event| (event.from, event.to)).collect::<Vec<_>>();
            prop_assert_eq!(kinds(&events), kinds(&expected), "{:?} {:?}", events, expected);
            for (event, expected) in events.iter().zip(&expected) {
                // Measured: 1e-11 s.
                prop_assert!((event.time - expected.time).abs() <= 1e-10, "{:?} {:?}", event, expected);
            }
        }
    }
}

#[test]
fn the_number_of_events_does_not_depend_on_the_step() {
    for (name, text) in [
        ("two", include_str!("../reference/two.toml")),
        ("three", include_str!("../reference/three.toml")),
        ("size_ratio", include_str!("../reference/size_ratio.toml")),
    ] {
        let run = |divided: f64| {
            let mut scene = scene(text);
            scene.dt /= divided;
            events(scene)
        };
        let expected = run(1.0);
        assert!(expected.len() >= 2);
        for divided in [0.05, 0.3, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0] {
            let found = run(divided);
            assert_eq!(found.len(), expected.len(), "{name}, dt/{divided}");
            for (found, expected) in found.iter().zip(&expected) {
                assert_eq!(
                    (found.a, found.b, found.from, found.to),
                    (expected.a, expected.b, expected.from, expected.to)
                );
                // Measured: 1.0e-15.
                assert!((found.time - expected.time).abs() <= 1.5e-15, "{name}, dt/{divided}: {found:?} {expected:?}");
            }
        }
    }
}
