//! `meldscope reference`: every key, entity and column, from the tables that parse and write them.

use std::fmt::Write as _;

use super::{export, print_lines};
use crate::{
    models::{elastic, metaballs},
    observe::surface::Finding,
    scene::{
        self,
        keys::{Fallback, Key, Kind, Range, Section},
    },
    sim::Cause,
    stream::{
        contract::{self, Component, Entity, SIM_TIME, STAGE, STEP},
        settings::Trigger,
    },
    sweep::{bisect, file as sweep, row, run::Outcome},
    table::{self, Column},
    view::scalars,
};

#[derive(clap::Args)]
pub struct Arguments {
    /// What to list.
    what: What,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum What {
    /// The keys of a scene file.
    Scene,
    /// The keys of a sweep file.
    Sweep,
    /// The entities, components, properties and timelines of a recording.
    Recording,
    /// The columns of tables: of sweeps, and of `export`.
    Tables,
    /// Events and outcomes, as tables and recordings name them, and what --on waits for.
    Events,
}

/// Prints a reference.
pub fn reference(arguments: &Arguments) {
    print_lines(&match arguments.what {
        What::Scene => file(scene::keys::sections()),
        What::Sweep => file(sweep::sections()),
        What::Recording => recording(),
        What::Tables => tables(),
        What::Events => events(),
    });
}

/// The keys of a file, section by section.
fn file(sections: impl Iterator<Item = &'static Section>) -> String {
    let mut text = String::new();
    for section in sections {
        let header = if section.header.is_empty() { String::new() } else { format!("{}\n", section.header) };
        let _ = writeln!(text, "{header}{}", section.about);
        for key in section.keys.iter().copied().flatten() {
            text += &entry(key);
        }
        for (keys, from) in section.shared {
            let names: Vec<&str> = keys.iter().map(|key| key.name).collect();
            let _ = writeln!(text, "  {}\n      As in {from}, and by default the same.", names.join(", "));
        }
        if !section.example.is_empty() {
            let _ = writeln!(
                text,
                "  For example:\n\n      {}",
                section.example.replace('\n', "\n      ").replace("      \n", "\n")
            );
        }
        text.push('\n');
    }
    text.truncate(text.trim_end().len());
    text
}

/// The contract of a recording.
fn recording() -> String {
    let causes: Vec<&str> = Cause::ALL.into_iter().map(Cause::name).collect();
    let mut text = format!(
        "A recording: an .rrd file. Equal runs give equal recordings but for the timings and the name of the machine.\n\
         A value that does not change is not logged again.\n\n\
         Timelines:\n  {STEP}\n      Number of the step; 0 is the initial state.\n  {SIM_TIME}\n      Simulated time [s].\n  \
         {STAGE}\n      Number of the stage, in steps recorded with --detail stages.\n\n\
         Entities; NAME is a body, A~B a pair, CAUSE one of {}:\n",
        causes.join(", ")
    );
    for Entity { path, holds, about } in contract::ENTITIES {
        let _ = writeln!(text, "  {path}  {holds}\n      {about}");
    }
    let mut list = |title: &str, components: &[(Component, &str)]| {
        let _ = writeln!(text, "\n{title}:");
        for (Component(name), about) in components {
            let _ = writeln!(text, "  {name}\n      {about}");
        }
    };
    list("Components that no archetype of Rerun has", contract::COMPONENTS);
    list(&format!("Properties of the recording, on {}", contract::PROPERTIES.path), contract::ALL_PROPERTIES);
    text.truncate(text.trim_end().len());
    text
}

/// The columns of tables.
fn tables() -> String {
    let mut text =
        "Tables: Parquet, of `export` also CSV and JSON. Empty cells do not apply, and are null in Parquet.\n"
            .to_owned();
    let mut section = |title: &str, columns: &[Column]| {
        let _ = writeln!(text, "\n{title}");
        for Column { name, kind, about, is_nullable } in columns {
            let kind = match kind {
                table::Kind::Float => "f64",
                table::Kind::Count => "u64",
                table::Kind::Integer => "i64",
                table::Kind::Text => "string",
                table::Kind::List => "list of f64",
            };
            let optional = if *is_nullable { " or null" } else { "" };
            let _ = match about.is_empty() {
                true => writeln!(text, "  {name}  {kind}{optional}"),
                false => writeln!(text, "  {name}  {kind}{optional}\n      {about}"),
            };
        }
    };
    let axis = |about| Column { name: "KEY".into(), ..Column::required("", table::Kind::Float, about) };
    section("Rows of a sweep (`meldscope sweep`); a column KEY for each axis", &[row::ROW, axis(row::AXIS)]);
    section("  its results", &row::RESULTS);
    section("  with measures = [\"displacement\"]", &row::DISPLACEMENT);
    section("  with measures = [\"surfaces\"]", &row::SURFACES);
    section("  and last", &row::LAST);
    let [first, rest @ ..] = bisect::COLUMNS;
    section("Thresholds (`meldscope sweep --bisect`)", &[&[first, axis(bisect::AXIS)][..], &rest].concat());
    section("Events (`meldscope export --events`)", &export::tables::EVENTS);
    section("Pairs within reach (`meldscope export --pairs`)", &export::tables::PAIRS);
    section("Bodies (`meldscope export --bodies`)", &export::tables::BODIES);
    let mut scalars: Vec<Column> = export::tables::SCALARS.into();
    let of_worlds = scalars::all().map(|scalar| [scalar.name, scalar.plot, scalar.label]);
    for [name, plot, label] in of_worlds.chain(elastic::all_scalars()).chain(metaballs::SCALARS) {
        let about = format!("{plot}: {label}");
        match scalars.iter_mut().find(|known| known.name == name) {
            Some(known) if known.about.split("; or ").any(|known| known == about) => {}
            Some(known) => known.about = format!("{}; or {about}", known.about).into(),
            None => scalars.push(Column { about: about.into(), ..Column::new(name, table::Kind::Float, "") }),
        }
    }
    section("Scalars (`meldscope export --scalars`), those that the scene has", &scalars);
    section("States (`meldscope export --states`), a row for each vertex", &export::tables::STATES);
    section(
        "Forces (`meldscope export --forces`), a row for each cause that acts on a vertex, and each force at another point",
        &export::tables::FORCES,
    );
    text.truncate(text.trim_end().len());
    text
}

/// The events of runs, and the outcomes of sweeps.
fn events() -> String {
    let mut text = String::new();
    let mut list = |title: &str, words: &[(&str, &str)]| {
        let _ = writeln!(text, "{title}");
        for (word, about) in words {
            let _ = writeln!(text, "  {word}\n      {about}");
        }
        text.push('\n');
    };
    list("Events of pairs: changes of phase", &crate::sim::events::KINDS);
    list("Events of surfaces", &Finding::KINDS);
    list("Events of single bodies, of the models lattice and fem", &elastic::KINDS);
    list(
        "What `run --keep N --on` waits for: an event of a pair by its first word, or",
        &[(Trigger::DIVERGE, "The state diverges: the step led to an impossible state.")],
    );
    let outcomes = Outcome::ALL.map(|outcome| (outcome.name(), outcome.about()));
    list(
        "Outcomes of a sweep's runs; of several pairs, merged takes precedence over passed, split, bounced and apart",
        &outcomes,
    );
    text.truncate(text.trim_end().len());
    text
}

fn entry(key: &Key) -> String {
    let default = match key.default {
        Fallback::Required => "required".to_owned(),
        Fallback::Word(word) => format!("[\"{word}\"]"),
        _ => format!("[{}]", key.default.text()),
    };
    let unit = if key.unit.is_empty() { String::new() } else { format!(" {}", key.unit) };
    let number = |x: f64| match x.abs() {
        1e-2..1e5 | 0.0 => x.to_string(),
        _ => format!("{x:e}"),
    };
    let between = |Range { min, max }: Range| format!("{} to {}{unit}", number(min), number(max));
    let values = match key.kind {
        Kind::Number(range) => {
            let usual =
                key.usual.map_or(String::new(), |[low, high]| format!(", usually {} to {}", number(low), number(high)));
            format!("{}{usual}", between(range))
        }
        Kind::Integer([min, max]) => format!("integer, {min} to {max}"),
        Kind::Vector(_) => format!("[x, y, z]{unit}"),
        Kind::Direction => "[x, y, z], not all 0".to_owned(),
        Kind::Word(words) => words().iter().map(|word| format!("\"{word}\"")).collect::<Vec<_>>().join(" | "),
        Kind::Text(text) => text.form.to_owned(),
        Kind::Other(form) => form.to_owned(),
    };
    format!("  {}  {default}  {values}\n      {}\n", key.name, key.about)
}
