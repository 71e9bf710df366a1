//! Fuzzes the union and compares it with an independent one, `manifold-rust`.
//!
//! A union must be closed, manifold and oriented, and have the oracle's volume. If Euler characteristics or numbers of
//! components differ, bodies touch exactly or are closer than one of the two resolves: with every body displaced by a
//! ten-thousandth of a radius, the numbers must agree.

use std::{
    collections::HashMap,
    panic::{AssertUnwindSafe, catch_unwind},
    time::{Duration, Instant},
};

use manifold_rust::{
    csg_tree::CsgNode,
    manifold::Manifold,
    types::{BooleanEngine, Error, MeshGL64, OpType, WindingRule},
};
use meldscope::geometry::union::{Body, Budget, Topology, UnionError, UnionMesh, union};

use super::scenes::{Kind, Scene, Shape};

/// Largest difference of volumes that count as equal, relative to the sum of the bodies' volumes.
const VOLUME: f64 = 1e-7;
/// Displacement of bodies in contact, to check whether a difference is due to the contact [radii].
const SHIFT: f64 = 1e-4;
/// Maximum number of triangles for the oracle's robust mode, whose exact rationals take minutes for more.
const MAX_ROBUST: usize = 700;

/// A number of scenes.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    pub scenes: u64,
    pub rejected: u64,
    pub gave_up: u64,
    pub retries: u64,
    pub compared: u64,
    /// Differences of χ or components that are ties of exact contact.
    pub ties: u64,
    /// Scenes that the oracle did not unite, or not to a closed surface.
    pub oracle_failed: u64,
    /// Largest relative difference of volumes.
    pub volume: f64,
    /// Longest time of a union.
    pub longest: Duration,
    /// Defects: the number of the scene, and the description.
    pub defects: Vec<(u64, String)>,
}

/// Runs a range of scenes, at most for this time; one tally for each kind.
pub fn run(numbers: std::ops::Range<u64>, time: Duration, mut progress: impl FnMut(u64, &[Tally])) -> Vec<Tally> {
    let mut tallies = vec![Tally::default(); Kind::ALL.len()];
    let start = Instant::now();
    for number in numbers {
        if start.elapsed() > time {
            break;
        }
        let scene = Scene::new(number);
        let tally = &mut tallies[scene.kind as usize];
        tally.scenes += 1;
        if let Err(defect) = compare(&scene, tally) {
            tally.defects.push((number, defect));
        }
        progress(number, &tallies);
    }
    tallies
}

/// Prints the tallies; returns the number of defects.
pub fn print(tallies: &[Tally]) -> usize {
    println!("kind               scenes rejected  gave up  retries  compared  ties  oracle failed  volume   longest");
    let all = tallies.iter().skip(1).fold(tallies[0].clone(), |sum, t| Tally {
        scenes: sum.scenes + t.scenes,
        rejected: sum.rejected + t.rejected,
        gave_up: sum.gave_up + t.gave_up,
        retries: sum.retries + t.retries,
        compared: sum.compared + t.compared,
        ties: sum.ties + t.ties,
        oracle_failed: sum.oracle_failed + t.oracle_failed,
        volume: sum.volume.max(t.volume),
        longest: sum.longest.max(t.longest),
        defects: [sum.defects, t.defects.clone()].concat(),
    });
    for (name, t) in Kind::ALL.iter().map(|kind| kind.name()).zip(tallies).chain([("all", &all)]) {
        println!(
            "{name:<17} {:>7} {:>8} {:>8} {:>8} {:>9} {:>5} {:>14}  {:>7.1e} {:>6.0} ms",
            t.scenes,
            t.rejected,
            t.gave_up,
            t.retries,
            t.compared,
            t.ties,
            t.oracle_failed,
            t.volume,
            1e3 * t.longest.as_secs_f64()
        );
    }
    for (number, defect) in &all.defects {
        println!("scene {number}: {defect}");
    }
    all.defects.len()
}

/// The compared quantities.
#[derive(Clone, Copy, Debug)]
struct Numbers {
    volume: f64,
    euler: i64,
    components: usize,
}

fn compare(scene: &Scene, tally: &mut Tally) -> Result<(), String> {
    let start = Instant::now();
    let own = unite(scene, tally)?;
    tally.longest = tally.longest.max(start.elapsed());
    let Some(own) = own else { return Ok(()) };
    let volumes: Vec<f64> = scene.shapes.iter().map(Shape::volume).collect();
    let scale = volumes.iter().map(|volume| volume.abs()).sum::<f64>().max(f64::MIN_POSITIVE);
    if scene.kind == Kind::Inverted && volumes.iter().all(|&volume| volume <= 0.0) {
        // an inverted solid has no inside; the oracle reorients some of these
        let is_empty = own.components == 0 && own.volume.abs() <= VOLUME * scale;
        return if is_empty { Ok(()) } else { Err(format!("{own:?} instead of nothing")) };
    }
    let Some(oracle) = oracle(scene) else {
        tally.oracle_failed += u64::from(has_oracle(scene));
        return Ok(());
    };
    tally.compared += 1;
    let difference = (own.volume - oracle.volume).abs() / scale;
    if difference > VOLUME {
        // the oracle's first engine joins surfaces that are closer than its resolution
        let robust = if scene.is_of_solids() { robust(scene) } else { None };
        if robust.is_none_or(|robust| (own.volume - robust.volume).abs() > VOLUME * scale) {
            return Err(format!("volume {} instead of {} ({})", own.volume, oracle.volume, scene.kind.name()));
        }
    } else {
        tally.volume = tally.volume.max(difference);
    }
    if (own.euler, own.components) != (oracle.euler, oracle.components) {
        for seed in 0..3 {
            let shifted = scene.shifted(seed, SHIFT);
            // a shift may itself bring bodies into contact: in scene 104547, the second one leaves two planes 4e-9
            // apart
            if let Some(first) = difference_in_topology(&shifted)?
                && difference_in_topology(&shifted.shifted(seed + 3, SHIFT))?.is_some()
            {
                return Err(format!("{first} ({})", scene.kind.name()));
            }
        }
        tally.ties += 1;
    }
    Ok(())
}

/// How Euler characteristic or components differ from the oracle's, if they do.
fn difference_in_topology(scene: &Scene) -> Result<Option<String>, String> {
    let (Some(own), Some(oracle)) = (unite(scene, &mut Tally::default())?, oracle(scene)) else {
        return Ok(None);
    };
    let differs = (own.euler, own.components) != (oracle.euler, oracle.components);
    Ok(differs.then(|| format!("{own:?} instead of {oracle:?}")))
}

/// The union, checked; `None` if bodies or the union were rejected.
fn unite(scene: &Scene, tally: &mut Tally) -> Result<Option<Numbers>, String> {
    let attempt = || -> Result<Option<Numbers>, String> {
        let topologies: Result<Vec<_>, _> =
            scene.shapes.iter().map(|s| Topology::new(s.positions.len(), &s.triangles)).collect();
        let topologies = topologies.map_err(|error| error.to_string())?;
        let bodies: Result<Vec<_>, _> =
            topologies.iter().zip(&scene.shapes).map(|(t, s)| Body::new(t, &s.positions)).collect();
        let Ok(bodies) = bodies else {
            tally.rejected += 1;
            return if scene.kind == Kind::NotNumbers { Ok(None) } else { Err("rejected".to_owned()) };
        };
        let united = match union(&bodies, &Budget::default()) {
            Ok(united) => united,
            Err(UnionError::GaveUp { .. } | UnionError::Undecided { .. }) => {
                tally.gave_up += 1;
                return if scene.is_of_solids() { Err("gave up".to_owned()) } else { Ok(None) };
            }
            Err(error) => return Err(error.to_string()),
        };
        tally.retries += u64::from(united.statistics.retries);
        closed(&united.mesh())?;
        let components = united.component_count();
        Ok(Some(Numbers { volume: united.volume(), euler: united.euler(), components }))
    };
    let name = scene.kind.name();
    match catch_unwind(AssertUnwindSafe(attempt)) {
        Ok(result) => result.map_err(|what| format!("{what} ({name})")),
        Err(_) => Err(format!("panicked ({name})")),
    }
}

/// Why a mesh is not closed, manifold and oriented, if it is not.
fn closed(mesh: &UnionMesh) -> Result<(), String> {
    let mut next: HashMap<(u32, u32), u32> = HashMap::new();
    let mut count = vec![0; mesh.positions.len()];
    for corners in &mesh.triangles {
        for k in 0..3 {
            let (a, b, c) = (corners[k], corners[(k + 1) % 3], corners[(k + 2) % 3]);
            if a == b || next.insert((a, b), c).is_some() {
                return Err(format!("not manifold at the edge {a} {b}"));
            }
            count[a as usize] += 1;
        }
    }
    if let Some((a, b)) = next.keys().find(|(a, b)| !next.contains_key(&(*b, *a))) {
        return Err(format!("open at the edge {a} {b}"));
    }
    for (&(v, start), _) in next.iter().filter(|((a, _), _)| count[*a as usize] > 0) {
        let (mut at, mut around) = (start, 0);
        while around <= count[v as usize] {
            at = next[&(v, at)];
            around += 1;
            if at == start {
                break;
            }
        }
        if around != count[v as usize] {
            return Err(format!("several fans at vertex {v}"));
        }
    }
    match mesh.positions.iter().position(|position| !position.is_finite()) {
        Some(v) => Err(format!("vertex {v} is not finite")),
        None => Ok(()),
    }
}

fn has_oracle(scene: &Scene) -> bool {
    scene.kind != Kind::NotNumbers
        && (scene.is_of_solids() || scene.shapes.iter().map(|shape| shape.triangles.len()).sum::<usize>() <= MAX_ROBUST)
}

/// The oracle's result for a scene; `None` if it cannot unite it.
fn oracle(scene: &Scene) -> Option<Numbers> {
    match scene.is_of_solids() {
        _ if !has_oracle(scene) => None,
        true => catch_unwind(AssertUnwindSafe(|| numbers(&exact(&scene.shapes)?))).ok()?,
        false => robust(scene),
    }
}

fn robust(scene: &Scene) -> Option<Numbers> {
    let unite = || {
        let all = scene.shapes.iter().map(|shape| Manifold::from_mesh_gl64_robust(&mesh(shape))).collect::<Vec<_>>();
        numbers(&match all.as_slice() {
            [only] => only.rebuild_solid(WindingRule::Positive),
            all => Manifold::batch_boolean_with_engine(all, OpType::Add, BooleanEngine::Robust),
        })
    };
    catch_unwind(AssertUnwindSafe(unite)).ok()?
}

/// The oracle's union of solids.
pub fn exact(shapes: &[Shape]) -> Option<Manifold> {
    let leaf = |shape: &Shape| {
        let manifold = Manifold::from_mesh_gl64(&mesh(shape));
        (manifold.status() == Error::NoError).then(|| CsgNode::leaf(manifold.as_impl().clone()))
    };
    let leaves: Option<Vec<CsgNode>> = shapes.iter().map(leaf).collect();
    Some(Manifold::from_impl(CsgNode::op_n(OpType::Add, leaves?).evaluate()))
}

/// A shape in the oracle's format.
pub fn mesh(shape: &Shape) -> MeshGL64 {
    MeshGL64 {
        num_prop: 3,
        vert_properties: shape.positions.iter().flat_map(|position| position.to_array()).collect(),
        tri_verts: shape.triangles.iter().flatten().map(|&v| u64::from(v)).collect(),
        ..MeshGL64::default()
    }
}

/// Volume, χ and components of a mesh of the oracle.
fn numbers(manifold: &Manifold) -> Option<Numbers> {
    if manifold.status() != Error::NoError {
        return None;
    }
    let mesh = manifold.get_mesh_gl64(-1);
    let stride = mesh.num_prop as usize;
    let vertices = mesh.vert_properties.len() / stride.max(1);
    // vertices that differ only in properties count as one
    let mut same: Vec<usize> = (0..vertices).collect();
    for (from, to) in mesh.merge_from_vert.iter().zip(&mesh.merge_to_vert) {
        same[*from as usize] = *to as usize;
    }
    fn root(same: &mut [usize], mut v: usize) -> usize {
        while same[v] != v {
            same[v] = same[same[v]];
            v = same[v];
        }
        v
    }
    let corners: Vec<usize> = mesh.tri_verts.iter().map(|&v| root(&mut same, v as usize)).collect();
    let mut used = corners.clone();
    used.sort_unstable();
    used.dedup();
    let mut group: Vec<usize> = (0..vertices).collect();
    for triangle in corners.chunks_exact(3) {
        for k in 0..2 {
            let (a, b) = (root(&mut group, triangle[k]), root(&mut group, triangle[k + 1]));
            group[a.max(b)] = a.min(b);
        }
    }
    let components = used.iter().filter(|&&v| root(&mut group, v) == v).count();
    let euler = used.len() as i64 - (corners.len() / 3) as i64 / 2;
    Some(Numbers { volume: manifold.volume(), euler, components })
}
