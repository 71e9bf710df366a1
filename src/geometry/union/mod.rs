//! The union of closed triangle meshes: one closed, manifold, oriented surface of many overlapping ones.
//!
//! The union is {winding number of any body ≥ 1}. Bodies may intersect themselves, touch, coincide, lie inside each
//! other, or be inside out. Remaining vertices of bodies keep their position to the bit; every other vertex records the
//! edge and triangle that it comes from. The cost of a union depends on the overlap, not on the size of the meshes.
//!
//! # Method
//!
//! 1. Predicates see the bodies in general position (`placement`): displaced by some 1e-9 of their size, such that
//!    bodies in contact are apart. The result has the true positions. With numerical instead of symbolic displacements
//!    (Edelsbrunner and Mücke, *Simulation of Simplicity*, 1990; Smith, *Towards Robust Inexact Geometric Computation*,
//!    2009, and the library Manifold, which displace along normals), every predicate remains an ordinary polynomial.
//! 2. The sign of a polynomial is that of its f64 value where an error bound allows, otherwise that of its exact value
//!    (`exact`; Shewchuk 1997). The intersection of an edge and a triangle is never rounded: it stays the pair (edge,
//!    triangle), as with the implicit points of Attene (*Indirect Predicates for Geometric Constructions*, 2020) and of
//!    Cherchi et al. (*Fast and Robust Mesh Arrangements*, 2020; *Interactive and Robust Mesh Booleans*, 2022).
//! 3. Boxes of bodies, of blocks of triangles and of triangles find candidates (`candidates`); signs determine which of
//!    them intersect (`arrangement`). Triangles well inside another body (`placement`) are not on the boundary:
//!    intersections of two such triangles are skipped.
//!    A body is tested against itself only where it may intersect itself (`folds`).
//! 4. Winding numbers (Zhou et al., *Mesh Arrangements for Solid Geometry*, 2016) are flood-filled from known values
//!    (`winding`), and checked at the end of every edge and segment. A part of a triangle bounds the union if the space
//!    in front of it is outside all bodies and the space behind it is not.
//! 5. Cut triangles are retriangulated (`faces`, `triangulate`), whole ones kept; a final check verifies that the
//!    surface is closed (`surface`).
//!
//! Bodies are first put into a canonical order, and each loop that may run on several threads has a fixed order of
//! results: the surface depends neither on the order in which bodies are given nor on the number of threads.
//!
//! # Cost
//!
//! Compared with the exact mode of `manifold-rust`, by `cargo bench --bench union` on one core of an AMD EPYC;
//! neither computes volumes:
//!
//! | spheres | union, best | times as fast | goal |
//! | --- | --- | --- | --- |
//! | two of 266 vertices | 0.12 ms | 13.4 | 15 |
//! | two of 10,000 vertices | 1.5 ms | 40.8 | 50 |
//! | a chain of 300 | 61 ms | 13.1 | 20 |
//! | 64 overlapping ones | 43 ms | 4.5 | 1 |
//!
//! Small unions miss the goal because no single stage dominates: for two spheres of 266 vertices, cutting triangles
//! takes 24 %, nodes and segments 16 %, signs of candidates 13 %, assembly with its audit 12 %, boxes 8 %,
//! [`Body::new`] and the proof that a body does not intersect itself 8 %. Reusing the previous frame could only save
//! the candidates, because everything else depends on positions: unions keep nothing from frame to frame, only the
//! search for gaps does ([`Hint`]). The chain is 299 such small unions; each takes as many instructions there as alone,
//! but 40 % more time.
//!
//! Ten times the vertices, all of them away from the overlap, cost 63 to 70 % more (goal 10 %): 4 ns per vertex for
//! boxes in [`Body::new`], and 12 ns for the proof, which reads the corners of every triangle. That time is spent
//! loading them: single precision or fewer divisions do not reduce it. Volume and area read them again, and are
//! computed on request.

mod arrangement;
mod bits;
mod body;
mod candidates;
mod contact;
mod distance;
mod exact;
mod faces;
mod folds;
mod measures;
mod placement;
mod report;
mod seams;
mod self_contact;
mod surface;
mod sweep;
#[cfg(test)]
mod tests;
mod topology;
mod triangulate;
mod winding;

pub use body::{Aabb, Body, BodyError};
pub use contact::{Contact, Crossing, contact};
pub use measures::{Hint, PairMeasures, are_apart, measures_apart, measures_of};
pub use report::{Budget, UnionError};
pub use seams::Seam;
pub use self_contact::{SelfContactError, self_contact};
pub use surface::{NewTriangle, NewVertex, Origin, Statistics, Union, UnionMesh};
pub use topology::{Topology, TopologyError};

use rayon::prelude::*;

use crate::parallel;
use arrangement::Arrangement;
use candidates::{EdgeAndTriangle, Meeting, Near};
use faces::Faces;
use placement::Placement;
use report::{Failure, Meter};
use winding::Classified;

/// Number of displacements to try. One has always sufficed, except for bodies without any extent.
const ATTEMPTS: u32 = 6;
/// The unions of two of more bodies than this cost no less together than one by one.
const FEW: usize = 8;

/// The boundary of the union of `bodies`.
///
/// # Errors
///
/// If the budget is exhausted, there are too many vertices to index, or no attempt brings the bodies into general
/// position. The only remedy is to show the bodies individually.
pub fn union<'a, 'b>(bodies: &'b [Body<'a>], budget: &Budget) -> Result<Union<'a, 'b>, UnionError> {
    Ok(union_and_pairs(bodies, &[], budget)?.0)
}

/// A union of two of several bodies, with their indices: of a union in which the others are left out.
pub type PairUnion<'a, 'b> = ([usize; 2], Union<'a, 'b>);

/// Like [`union`], with the unions of some pairs of more bodies, where these follow from the same intersections at less
/// cost than anew.
///
/// # Errors
///
/// Those of [`union`].
pub fn union_and_pairs<'a, 'b>(
    bodies: &'b [Body<'a>],
    pairs: &[[usize; 2]],
    budget: &Budget,
) -> Result<(Union<'a, 'b>, Vec<PairUnion<'a, 'b>>), UnionError> {
    let total = |count: &dyn Fn(&Topology) -> usize| bodies.iter().map(|b| count(b.topology())).sum::<usize>();
    let largest = total(&|t| t.edges.len()).max(total(&Topology::fan_count));
    if largest >= 1 << 30 {
        return Err(UnionError::TooLarge);
    }
    let meter = Meter::new(*budget);
    let order = canonical_order(bodies);
    let mut reason = "";
    for attempt in 0..ATTEMPTS {
        match attempt_union(bodies, pairs, &order, attempt, &meter) {
            Ok((mut union, of_pairs)) => {
                union.statistics.retries = attempt;
                union.statistics.work = meter.spent();
                return Ok((union, of_pairs));
            }
            Err(Failure::GaveUp) => return Err(meter.gave_up()),
            Err(Failure::Tie) => reason = "a tie",
            Err(Failure::Inconsistent(what)) => reason = what,
        }
    }
    Err(UnionError::Undecided { attempts: ATTEMPTS, reason })
}

fn attempt_union<'a, 'b>(
    bodies: &'b [Body<'a>],
    pairs: &[[usize; 2]],
    order: &[u32],
    attempt: u32,
    meter: &Meter,
) -> Result<(Union<'a, 'b>, Vec<PairUnion<'a, 'b>>), Failure> {
    let chosen: Vec<&Body> = order.iter().map(|&b| &bodies[b as usize]).collect();
    let mut placement = Placement::new(chosen, attempt);
    meter.check()?;
    let order: Vec<u32> = placement.kept.iter().map(|&i| order[i as usize]).collect();
    let mut included = vec![false; bodies.len()];
    for &b in &order {
        included[b as usize] = true;
    }
    let mut union = Union::untouched(bodies, &included);
    union.statistics.folds = placement.folds.iter().filter(|f| **f).count();
    union.statistics.dropped = placement.dropped;
    let is_done = |placement: &Placement| placement.pairs.is_empty() && !placement.folds.contains(&true);
    if is_done(&placement) {
        return Ok((union, Vec::new()));
    }

    let meetings = candidates::meetings(&placement);
    let threads = rayon::current_num_threads() > 1 && winding::is_worth_threads(&meetings);
    union.may_cross_itself.fill(false);
    let mut folded = Vec::new();
    for Fold { body, is_simple, meets_itself, mut candidates } in folds(&mut placement, meter, threads)? {
        union.may_cross_itself[order[body as usize] as usize] = meets_itself;
        placement.folds[body as usize] = !is_simple;
        if !is_simple {
            placement.place_all(body);
            folded.append(&mut candidates);
        }
    }
    if is_done(&placement) {
        return Ok((union, Vec::new()));
    }
    // whether or not pairs are asked for: except through the budget, the union does not depend on it
    let is_shared = (3..=FEW).contains(&bodies.len());
    if !is_shared {
        placement.bury(&meetings); // a third body hides nothing of a pair
    }
    let near = candidates::near(&placement, &meetings, meter, threads)?;
    for (body, triangles) in near.iter().flat_map(Near::triangles) {
        placement.place(body, triangles);
    }
    let candidates = candidates::edges_and_triangles(&placement, &near, folded, meter, threads)?;
    drop(near);
    union.statistics.tests = candidates.len();
    let arrangement = Arrangement::new(&placement, &candidates, meter, threads)?;
    let mut of_pairs = Vec::new();
    // without copies of bodies, which would be left out of a pair, too
    if is_shared && order.len() == bodies.len() {
        let folds = placement.folds.clone();
        for &pair in pairs {
            let is_one = |body: u32| pair.contains(&(order[body as usize] as usize));
            for (body, is_folded) in (0..).zip(&mut placement.folds) {
                *is_folded = folds[body as usize] && is_one(body);
            }
            let is_in_pair: Vec<bool> = (0..bodies.len()).map(|body| pair.contains(&body)).collect();
            let mut of_pair = Union::untouched(bodies, &is_in_pair);
            of_pair.may_cross_itself.clone_from(&union.may_cross_itself);
            let meetings = meetings.iter().filter(|meeting| meeting.bodies.into_iter().all(is_one));
            let meetings: Vec<Meeting> = meetings.cloned().collect();
            let of_pair = arrangement
                .of_some(&placement, is_one)
                .and_then(|arrangement| complete(of_pair, &placement, &meetings, arrangement, &order, meter, false));
            of_pairs.extend(of_pair.ok().map(|of_pair| (pair, of_pair)));
        }
        placement.folds = folds;
    }
    Ok((complete(union, &placement, &meetings, arrangement, &order, meter, threads)?, of_pairs))
}

/// Cuts the bodies of an arrangement, in which they meet in `meetings`, and removes what is inside.
fn complete<'a, 'b>(
    union: Union<'a, 'b>,
    placement: &Placement<'a, 'b>,
    meetings: &[Meeting],
    mut arrangement: Arrangement,
    order: &[u32],
    meter: &Meter,
    threads: bool,
) -> Result<Union<'a, 'b>, Failure> {
    meter.check()?;
    let mut classified = Classified::new(placement, meetings, &mut arrangement, meter, threads)?;
    arrangement.find_triple_points(placement, meter, threads)?;
    classified.walk_segments(&arrangement, meter)?;
    let faces = Faces::new(placement, &arrangement, &classified, meter, threads)?;

    meter.check()?;
    union.assemble(placement, &arrangement, &classified, faces, order)
}

/// A body that was tested against itself.
struct Fold {
    body: u32,
    /// Whether it is known not to intersect itself and to be the right way out.
    is_simple: bool,
    meets_itself: bool,
    /// Its edges and triangles that may meet.
    candidates: Vec<EdgeAndTriangle>,
}

/// Tests each body that may intersect itself.
fn folds(placement: &mut Placement, meter: &Meter, threads: bool) -> Result<Vec<Fold>, Failure> {
    let folds: Vec<u32> = (0..placement.bodies.len() as u32).filter(|&b| placement.folds[b as usize]).collect();
    let near = |&body: &u32| {
        let suspects = folds::suspects(placement.bodies[body as usize], placement.displaced[body as usize]);
        let near = candidates::near_itself(placement, body, suspects.as_deref(), meter)?;
        Ok((suspects.is_some(), near))
    };
    let near: Vec<(bool, Near)> = parallel::collect::<_, _, Result<_, _>>(threads, &folds, near)?;
    for (body, triangles) in near.iter().flat_map(|(_, near)| near.triangles()) {
        placement.place(body, triangles);
    }
    let fold = |(&body, (encloses_centre, near)): (&u32, &(bool, Near))| {
        let candidates =
            candidates::edges_and_triangles(placement, std::slice::from_ref(near), Vec::new(), meter, false)?;
        let meets_itself = arrangement::meets_itself(placement, body, &candidates, meter)?;
        Ok(Fold { body, is_simple: *encloses_centre && !meets_itself, meets_itself, candidates })
    };
    if threads { folds.par_iter().zip(&near).map(fold).collect() } else { folds.iter().zip(&near).map(fold).collect() }
}

/// The bodies sorted by their positions, without duplicates, so that the result does not depend on their given order.
fn canonical_order(bodies: &[Body]) -> Vec<u32> {
    let compare = |&a: &u32, &b: &u32| {
        let (a, b) = (&bodies[a as usize], &bodies[b as usize]);
        let keys = |body: &Body| (body.bounds.min.to_array(), body.bounds.max.to_array());
        let ((a_min, a_max), (b_min, b_max)) = (keys(a), keys(b));
        let by_bounds = (0..3).map(|k| a_min[k].total_cmp(&b_min[k]).then(a_max[k].total_cmp(&b_max[k])));
        let by_positions = (a.positions.iter().zip(b.positions))
            .flat_map(|(p, q)| [p.x.total_cmp(&q.x), p.y.total_cmp(&q.y), p.z.total_cmp(&q.z)]);
        by_bounds
            .chain(by_positions)
            .find(|ordering| ordering.is_ne())
            .unwrap_or_else(|| a.positions.len().cmp(&b.positions.len()))
            .then_with(|| a.topology.triangles.cmp(&b.topology.triangles))
    };
    let mut order: Vec<u32> = (0..bodies.len() as u32).collect();
    order.sort_by(compare);
    order.dedup_by(|a, b| compare(a, b).is_eq());
    order
}
