//! Fig. 3.3: the weight W of an influence sphere (3.3) and its forces (3.4), (3.5) against the distance, as a chart.
//!
//! The forces are those on the vertex, at rest, of the first body of a scene that is nearest to the centre of the
//! second. Its distance r from that centre follows from that of the centres, so the thresholds have their places too.

use std::f64::consts::SQRT_2;

use super::chart::{Axis, Chart, Line, Mark, Marker, Panel, Style};
use crate::{
    Scene,
    model::influence::Weight,
    svg::{BLUE, GREEN, ORANGE, Rgb, VERMILION},
};

/// The scenes whose forces are drawn: the switch as in the thesis's figure, one with a snap, and one with a core.
pub const SCENES: [&str; 3] = ["figure-4-2", "two", "collide"];

/// The largest distance that is drawn [radii of the second body].
const FARTHEST: f64 = 1.6;
/// Number of points of a line.
const POINTS: u32 = 320;

/// Draws the weights, and the forces in the first pair of each scene.
pub fn chart(scenes: &[Scene]) -> Chart {
    Chart {
        title: "Influence against distance (Fig. 3.3)".to_owned(),
        heading: [
            "Weight: of a vertex at distance r from the centre of an influence sphere of radius r_e = √2 R.",
            "Force: on the vertex, at rest, of one body that is nearest to the other’s centre. Up is towards that centre.",
        ],
        panels: [weights()].into_iter().chain(scenes.iter().map(forces)).collect(),
        notes: vec![
            "The thesis gives (3.3) to (3.5) and r_e. α, β and the thresholds are those of the scenes.".to_owned(),
            "A threshold stands at the distance that the vertex has when the pair reaches it.".to_owned(),
        ],
    }
}

/// The force of attraction on the nearest vertex when the first pair of a scene merges, over the largest at any
/// distance [–].
pub fn at_the_switch(scene: &Scene) -> f64 {
    let z = distance(scene, scene.law(0, 1).thresholds.merge_at) / scene.bodies[1].reach;
    let weight = scene.influence.weight;
    z * weight.at(z) / weight.max_pull()
}

/// The distance of the nearest vertex from the centre [radii of the second body], from q.
fn distance(scene: &Scene, q: f64) -> f64 {
    let [own, source] = [0, 1].map(|body| scene.bodies[body].radius);
    (q * (own + source) - own) / source
}

/// The inverse of [`distance`].
fn level(scene: &Scene, r: f64) -> f64 {
    let [own, source] = [0, 1].map(|body| scene.bodies[body].radius);
    (r * source + own) / (own + source)
}

fn distances() -> impl DoubleEndedIterator<Item = f64> {
    (0..=POINTS).map(|k| FARTHEST * f64::from(k) / f64::from(POINTS))
}

fn line(name: &str, color: Rgb, width: f64, points: Vec<[f64; 2]>) -> Line {
    Line { name: name.to_owned(), style: Style { color, marker: Marker::None, width }, points, ringed: None }
}

fn weights() -> Panel {
    let of = |weight: Weight| distances().map(|r| [r, weight.at(r / SQRT_2)]).collect();
    Panel {
        title: "weight".to_owned(),
        axes: [Axis::linear("r [R]", 0.0..FARTHEST), Axis::linear("W [–]", 0.0..1.0)],
        lines: vec![
            line("linear (3.3)", VERMILION, 3.0, of(Weight::Linear)),
            line("wendland (ours)", BLUE, 3.0, of(Weight::Wendland)),
        ],
        marks: vec![Mark { at: SQRT_2, name: "r_e".to_owned() }],
    }
}

fn forces(scene: &Scene) -> Panel {
    let (law, influence, reach) = (scene.law(0, 1), scene.influence, scene.bodies[1].reach);
    let scale = influence.scale(scene.bodies[0].radius, scene.bodies[1].radius);
    let force = |strength: f64, r: f64| scale * strength * r * influence.weight.at(r / reach);
    let of = |strength: f64| distances().map(|r| [r, force(strength, r)]).collect();
    // the phase has a memory, so it is followed from where the pair starts
    let switched = |from: f64, order: &mut dyn Iterator<Item = f64>| -> Vec<[f64; 2]> {
        let mut phase = law.thresholds.initial(level(scene, from));
        let point = |r: f64| {
            let q = level(scene, r);
            while let Some(next) = law.thresholds.next(phase, q) {
                phase = next;
            }
            [r, force(law.strength(phase, q), r)]
        };
        order.map(point).collect()
    };
    let mut approaching = switched(FARTHEST, &mut distances().rev());
    approaching.reverse();
    let parting = switched(0.0, &mut distances());
    let has_memory = approaching != parting;
    let mut lines = vec![
        line("attraction (3.4)", VERMILION, 1.5, of(law.alpha)),
        line("repulsion (3.5)", BLUE, 1.5, of(-law.beta)),
    ];
    if has_memory {
        lines.push(line("while they part", ORANGE, 5.0, parting));
    }
    lines.push(line(if has_memory { "as they approach" } else { "as switched" }, GREEN, 3.0, approaching));
    let thresholds = law.thresholds;
    let mut marks =
        vec![(thresholds.merge_at, "merge_at"), (thresholds.split_at, "split_at"), (thresholds.core_at, "core_at")];
    marks.retain(|(q, _)| *q > 0.0);
    if thresholds.merge_at == thresholds.split_at {
        marks[0].1 = "merge_at = split_at";
        marks.remove(1);
    }
    let most = reach * influence.weight.max_pull() * 1.1;
    Panel {
        title: scene.name.clone(),
        axes: [Axis::linear("r [R]", 0.0..FARTHEST), Axis::linear("force [R/s²]", -law.beta * most..law.alpha * most)],
        lines,
        marks: marks
            .into_iter()
            .map(|(q, name)| Mark { at: distance(scene, q), name: format!("{name} {q}") })
            .collect(),
    }
}
