//! The texts of panels: what colours, lines and arrows mean.

use super::tabs::{capitalized, draws_springs};
use crate::{
    colors,
    observe::{Frame, Schema, schema::TermSchema},
    stream::{
        palette,
        parts::{body_forces::longest, forces, moves, numbers, ranking::is_ranked, recent, trails},
        settings::{Detail, Entities, Frames, Settings},
    },
    text::{self, counted, significant, trimmed},
};

/// A force term with its colour.
fn called(term: &TermSchema) -> String {
    format!("{} {}", colors::name(term.color), term.name)
}

/// A force term with its colour, by the first words of its label.
fn described(term: &TermSchema) -> String {
    let label = term.label.split(':').next().unwrap_or_default();
    format!("{} {}", colors::name(term.color), label.to_lowercase())
}

/// The accelerations at which arrows are as long as the largest radius, with the terms of which this is true, each as
/// `told` describes it.
fn lengths(schema: &Schema, told: fn(&TermSchema) -> String, is_listed: impl Fn(&TermSchema) -> bool) -> String {
    let radius = schema.largest_radius();
    let mut lengths: Vec<(f64, Vec<String>)> = Vec::new();
    for term in schema.terms.iter().filter(|term| term.can_act && is_listed(term)) {
        let scale = schema.arrow_scale_of(term);
        match lengths.iter_mut().find(|(of, _)| *of == scale) {
            Some((_, terms)) => terms.push(told(term)),
            None => lengths.push((scale, vec![told(term)])),
        }
    }
    let lengths =
        lengths.iter().map(|(scale, terms)| format!("{} = {} unit/s²", terms.join(", "), rounded(radius / scale)));
    lengths.collect::<Vec<_>>().join("; ")
}

/// A number with three digits at most.
fn rounded(x: f64) -> String {
    trimmed(&significant(x)).to_owned()
}

/// The text about the arrows at the centres of free bodies.
fn at_centres(schema: &Schema) -> String {
    let radius = schema.largest_radius();
    let of = forces::NET_KINDS.map(|(name, rgb, _)| format!("{} {}", colors::name(rgb), name.replace('_', " ")));
    format!(
        "- **At the centres** of free bodies, cut off at {} unit: {} (over M, and over M R), {} unit long: {} unit/s²\n",
        rounded(forces::LONGEST_NET * radius),
        of.join(", "),
        rounded(radius),
        rounded(radius / schema.net_force_scale),
    )
}

/// The text of the panel beside arrows and plots of forces: their colours, and what their lengths mean.
pub fn arrows(schema: &Schema) -> String {
    let radius = schema.largest_radius();
    let is_uniform = schema.terms.iter().any(|term| term.can_act && term.is_uniform);
    if !schema.terms.iter().any(|term| term.can_act) {
        return "No force can act in this scene.\n".to_owned();
    }
    format!(
        "**By body**, plots and rows: means over a body; arrows are scaled per step, the longest {} unit long, less for small bodies, weak ones left out; {}: the net force and its \
         strongest cause in unit/s². **Others**: at vertices{}; an arrow of **{} unit** means: {}.\n",
        rounded(longest(schema) * radius),
        if is_ranked(schema) { "rows" } else { "labels" },
        if is_uniform { "; uniform forces at the centre" } else { "" },
        rounded(radius),
        lengths(schema, described, |_| true),
    )
}

/// The text of the panel beside the stages inside steps.
pub fn stages() -> String {
    format!(
        "**How does a step come about?** The timeline `stage` counts the rows below: each is a state inside a step, with the vertex that \
         moved most since the stage before (“if no sphere acted”: since the start), and the body displaced most.\n\n\
         - **{} arrows**, on this timeline alone: how vertices moved since then, of bodies on paths relative to their centres; the longest of a step is half of the largest radius long\n\
         - **Other arrows**: the forces in that state, as in Scene\n",
        capitalized(colors::name(moves::MOVED)),
    )
}

/// The text of the panel: what the colours mean, the scene, integrator, step and settings. The recording begins with
/// step `first`; `frame` is one of its states, and `nearest` the closest approaches, once they are known.
pub fn about(schema: &Schema, settings: &Settings, first: u64, frame: &Frame, nearest: &str) -> String {
    let program = text::program();
    let frames = match (&settings.frames, settings.every) {
        (Frames::Thin, _) => "no frames".to_owned(),
        (Frames::All, 1) => "a frame every step".to_owned(),
        (Frames::All, every) => format!("a frame every {every} steps"),
        (Frames::Last { most: 1, on, .. }, _) if on.is_empty() => "the last frame".to_owned(),
        (Frames::Last { most, on, .. }, _) if on.is_empty() => format!("the last {most} frames"),
        (Frames::Last { most, on, after }, _) => {
            let on: Vec<&str> = on.iter().map(|trigger| trigger.name()).collect();
            let frames = if *most == 1 { "frame".to_owned() } else { format!("{most} frames") };
            let after = if *after > 0 { format!(" and {} after it", counted(*after, "frame")) } else { String::new() };
            format!("the last {frames} before each {}{after}", on.join(", "))
        }
    };
    let steps = match settings.steps {
        None => "until stopped".to_owned(),
        Some(last) if first > 0 => format!("steps {first} to {last}"),
        Some(1) => "1 step".to_owned(),
        Some(steps) => format!("{steps} steps"),
    };
    let integrator = if schema.integrator.is_empty() { String::new() } else { format!("`{}`, ", schema.integrator) };
    let head = format!(
        "**{}**: {} {}, {} vertices{}. {integrator}Δt = {:.6} s, {steps}, {frames}.\n\n{} R is the radius of a body, for a pair that of the smaller one.\n\n",
        schema.name,
        schema.bodies.len(),
        if schema.bodies.len() == 1 { "body" } else { "bodies" },
        schema.vertex_count(),
        schema.non_default_model().map(|model| format!(", model **{model}**")).unwrap_or_default(),
        schema.dt,
        schema.law,
    );
    let warnings = schema.warnings.iter().map(|warning| format!("\n**Warning**: {warning}.\n"));
    let warnings = warnings.collect::<String>();
    if settings.frames == Frames::Thin {
        return format!(
            "**This recording is thin**: what was simulated, its events, and a checksum of every step. It has no frames; make \
             them:\n\n\
             - `{program} replay F.rrd --save full.rrd`: all frames, to be opened here\n\
             - `… --from STEP --to STEP`: those of some steps\n\
             - `{program} replay F.rrd`: verifies every step\n\
             - `{program} explain F.rrd --step N`: forces and phases in numbers\n\n{head}{warnings}{nearest}"
        );
    }
    let phases = schema.phases.iter().map(|phase| format!("{} {}", colors::name(phase.color), phase.name));
    let phases = phases.collect::<Vec<_>>().join(", ");
    let is_crowd = recent::is_drawn_alone(schema);
    let spheres = match settings.entities {
        _ if schema.bodies.iter().all(|body| body.reach == 0.0) => format!("- **Lines, lanes**: {phases}\n"),
        Entities::Body if is_crowd => {
            format!("- **Lines, lanes**, and the spheres of the last event's pair: {phases}\n")
        }
        Entities::Body => format!("- **Spheres, lines, lanes**: {phases}; grey: reaches no body\n"),
        Entities::Batch => {
            format!("- **Spheres** (only of bodies that reach another), **lines, lanes**: {phases}\n")
        }
    };
    let changes = match is_ranked(schema) && !schema.thresholds.is_empty() {
        true => {
            "- **Next phase changes**: q and its rate, or when it soon reaches the next threshold; right, q as a dot, its thresholds as lines\n"
        }
        false => "",
    };
    let arrows = match settings.detail {
        Detail::Surface => "- Force arrows were not recorded (`--detail forces`)\n".to_owned(),
        // among many bodies, arrows are hidden here, and explained beside those of forces
        Detail::Forces | Detail::Stages { .. } if is_crowd => String::new(),
        Detail::Forces | Detail::Stages { .. } => {
            let shown = lengths(schema, called, |term| term.is_shown);
            let hidden = schema.terms.iter().filter(|term| term.can_act && !term.is_shown);
            let hidden: Vec<String> = hidden.map(called).collect();
            let hidden = (!hidden.is_empty()).then(|| format!("hidden at first: {}", hidden.join(", ")));
            let shown = (!shown.is_empty()).then(|| format!("{} unit long: {shown}", rounded(schema.largest_radius())));
            let parts: Vec<String> = shown.into_iter().chain(hidden).collect();
            if parts.is_empty() { String::new() } else { format!("- **Arrows**, {}\n", parts.join("; ")) }
        }
    };
    let bound = if !settings.only.is_empty() {
        let has = if settings.only.len() == 1 { "has" } else { "have" };
        format!("- Only {} {has} plots, lanes and lines (`--pair`); events list all pairs\n", settings.only.join(", "))
    } else if schema.bodies.len() * schema.bodies.len().saturating_sub(1) / 2 > settings.pairs {
        let max = settings.pairs;
        format!(
            "- The first {max} pairs within reach, and up to as many with events, have plots and lanes, the closest {max} lines \
             (`--plots`, `--pair a~b`); events list them all\n"
        )
    } else {
        String::new()
    };
    let joined: Vec<String> =
        schema.phases.iter().filter(|phase| phase.is_joined).map(|phase| phase.name.to_owned()).collect();
    // a surface of its own is part of the law
    let merged = if schema.surfaces.get().is_none() && schema.bodies.len() > 1 && !joined.is_empty() {
        let smooth = match schema.blend {
            0.0 => "sharp where they meet".to_owned(),
            blend => format!("smooth within {blend} R of where they meet"),
        };
        format!("- **Surface**: bodies that are {} share one, {smooth}; white: their seams\n", joined.join(" or "))
    } else {
        String::new()
    };
    // those of a free body are not 0 for long
    let has_net = frame.bodies.iter().zip(&schema.bodies).any(|(now, body)| now.net_force.is_some() || body.is_free);
    let net_forces =
        if settings.detail != Detail::Surface && has_net && !is_crowd { at_centres(schema) } else { String::new() };
    let is_free = schema.bodies.iter().any(|body| body.is_free);
    let trails = if is_free && !is_crowd && settings.entities == Entities::Body {
        format!("- **Trails**: the centres of free bodies in the last {} s\n", trails::SECONDS)
    } else {
        String::new()
    };
    let springs = match draws_springs(schema, settings) {
        true => format!(
            "- **Springs**: blue shorter, white as long, red-orange longer than at rest (full colour: {} %)\n",
            100.0 * palette::MAX_STRAIN
        ),
        false => String::new(),
    };
    let credit = if schema.credit.is_empty() { String::new() } else { format!("\nAfter {}.\n", schema.credit) };
    let stages = numbers::colors(schema).map(|(stage, rgb)| format!("{} {stage}", colors::name(rgb)));
    let timings = match schema.bodies.len() > 1 && is_crowd {
        true => String::new(), // the plot has no room
        false => format!("- **Timings**: {}\n", stages.collect::<Vec<_>>().join(", ")),
    };
    // what is first is visible in a small panel
    let colors = spheres + changes + &springs + &arrows + &net_forces + &merged + &trails + &timings + &bound;
    format!("{}{colors}{nearest}\n{head}{credit}", warnings.trim_start())
}
