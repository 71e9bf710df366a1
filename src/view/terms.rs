//! How force terms, phases and the labels of vertices are called and coloured.

use crate::{
    colors::{self, Rgb},
    model::{
        PairLaw,
        phase::{Phase, Thresholds},
    },
    observe::schema::TermSchema,
    scene::{Model, Scene},
    sim::Cause,
};

use super::scales::{net_force_scale, plane_scale, reaction_scale};

/// Label of a vertex, by what influence spheres do to it.
pub const LABELS: [&str; 5] = ["out of reach", "attracted", "repelled", "attracted and repelled", "in a core"];

/// The label of a vertex, given which kinds of sphere act on it: attraction, repulsion of bodies apart, core.
pub fn label([is_attracted, is_repelled, is_in_core]: [bool; 3]) -> u8 {
    match (is_attracted, is_repelled, is_in_core) {
        (_, _, true) => 4,
        (is_attracted, is_repelled, _) => u8::from(is_attracted) + 2 * u8::from(is_repelled),
    }
}

/// Colour of a phase: the colour of the force that it causes.
pub fn phase_color(phase: Phase) -> Rgb {
    match phase {
        Phase::Apart => colors::SKY_BLUE,
        Phase::Merged => colors::ORANGE,
        Phase::Core => colors::PURPLE,
    }
}

/// The q at which a pair enters a phase [–], if there is one.
pub fn level(law: &PairLaw, phase: Phase) -> Option<f64> {
    let Thresholds { merge_at, split_at, core_at } = law.thresholds;
    match phase {
        Phase::Merged => Some(merge_at),
        Phase::Apart => Some(split_at),
        Phase::Core => (core_at > 0.0).then_some(core_at),
    }
}

/// The schema of a force term.
pub fn term(scene: &Scene, cause: Cause) -> TermSchema {
    let (has_pairs, has_free) = (scene.bodies.len() > 1, scene.bodies.iter().any(|body| body.path().is_none()));
    let has_core = scene.lowest_level(|law| level(law, Phase::Core)).is_some();
    #[allow(unreachable_patterns)] // a term without its own line gets the defaults
    let (label, color, can_act, is_shown) = match cause {
        Cause::Attraction => ("Attraction", colors::ORANGE, has_pairs, true),
        Cause::Repulsion => ("Repulsion of bodies apart", colors::SKY_BLUE, has_pairs, true),
        Cause::Core => ("Repulsion in the core", colors::PURPLE, has_pairs && has_core, true),
        Cause::Point => ("Force points", colors::LIME, true, true),
        Cause::Restoring => ("Restoring", colors::GREEN, true, false),
        Cause::Damping => ("Damping", colors::YELLOW, true, false),
        Cause::Push => ("Push", colors::VERMILION, !scene.pushes.is_empty(), !scene.pushes.is_empty()),
        Cause::Carry => ("Carry: its own motion", colors::SILVER, true, false),
        Cause::Gravity => ("Gravity", colors::BROWN, scene.ever_has_gravity(), false),
        Cause::Plane => ("Planes: pressure and friction", colors::BLUE, !scene.planes.is_empty(), true),
        Cause::Reaction => ("Reaction to its sphere", colors::PINK, has_free && has_pairs, false),
        // white lines would not be seen in the light theme
        Cause::Net => ("Net", colors::MAGENTA, true, false),
        _ => (cause.name(), colors::BLUE, true, true),
    };
    let has_source = matches!(cause, Cause::Attraction | Cause::Repulsion | Cause::Core);
    let is_uniform = matches!(cause, Cause::Gravity | Cause::Reaction);
    let arrow_scale = match cause {
        Cause::Plane => plane_scale(scene),
        // one arrow for a whole body, which would not be seen at the length of those at vertices
        Cause::Gravity => Some(net_force_scale(scene)),
        Cause::Reaction => Some(reaction_scale(scene)),
        _ => None,
    };
    let (name, is_sum) = (cause.name(), cause == Cause::Net);
    TermSchema { name, label, color, has_source, can_act, is_shown, is_sum, is_uniform, arrow_scale }
}

/// The interaction between bodies in words.
pub fn law(scene: &Scene) -> String {
    let edits = scene.edits.iter().map(|edit| format!(" At {} s: {}.", edit.time, edit.set.join(", ")));
    law_at_start(scene) + &edits.collect::<String>()
}

fn law_at_start(scene: &Scene) -> String {
    let (influence, thresholds) = (&scene.influence, &scene.thresholds);
    let reaches = || scene.bodies.iter().map(|body| body.reach);
    let [least, most] = [reaches().fold(f64::INFINITY, f64::min), reaches().fold(0.0, f64::max)];
    let spheres = if least == most { format!("{least:.3}") } else { format!("{least:.3} to {most:.3}") };
    let has_free = scene.bodies.iter().any(|body| body.path().is_none());
    let rim = scene.common_law().of_pair(has_free).rim(Phase::Merged);
    let balance = rim.filter(|rim| rim.alpha > 0.0 && rim.beta > 0.0).map(|rim| rim.balance());
    let core = match (thresholds.core_at > 0.0, balance) {
        (false, _) => String::new(),
        (true, None) => format!(", with a core below {}", thresholds.core_at),
        (true, Some(balance)) => format!(
            ", with a core below {} (attraction gradually turns into repulsion, at q = {balance:.3})",
            thresholds.core_at
        ),
    };
    format!(
        "Bodies merge at q = {} and split at {}{}; q is the distance of their centres over the sum of their radii. α = {}/s², \
         β = {}/s², spheres {spheres} R.{}{}",
        thresholds.merge_at,
        thresholds.split_at,
        core,
        influence.alpha,
        influence.beta,
        match scene.pairs.laws().len() {
            0 => String::new(),
            1 => " One `[[pair]]` has another law.".to_owned(),
            n => format!(" {n} `[[pair]]`s have other laws."),
        },
        match scene.model {
            Model::Oscillators =>
                " Nothing joins neighbouring vertices: spikes after a split are vertices swinging back, not an error.",
            Model::Metaballs | Model::Lattice | Model::Fem => "",
        },
    )
}
