//! Measurements as tables for people.

use super::{Judged, Point, Report, Run, scenes::Family};
use crate::{
    bench::{
        error::table::significant,
        machine::Machine,
        tables::{aligned, number},
    },
    sim::{memory::human, report::Stage},
    stream::sinks::thousands,
};

/// All measurements, a table a family.
pub fn table(report: &Report) -> String {
    let mut lines = vec![];
    for family in Family::ALL {
        lines.push(format!("{}: 266 vertices a body, exponential, tolerance 1e-6", family.name()));
        lines.push(String::new());
        let all = format!("{} cores", report.threads);
        let mut rows = vec![
            [
                "bodies", "one core", &all, "ratio", "one core", "reached", "by those", "memory", "error", "plain",
                "error",
            ]
            .map(str::to_owned),
            ["", "steps/s", "steps/s", "", "M vertices/s", "vertices", "ns", "a body", "[R]", "steps/s", "[R]"]
                .map(str::to_owned),
        ];
        rows.extend(report.of(family).map(row));
        lines.extend(aligned(&rows));
        lines.push(String::new());
    }

    lines.push("share of the stages in a step [%]".to_owned());
    lines.push(String::new());
    let mut rows = vec![["", "bodies", "threads", "reach", "events", "integrate"].map(str::to_owned)];
    for point in &report.points {
        rows.extend([Some(&point.one), point.all.as_ref()].into_iter().flatten().map(|run| shares(point, run)));
    }
    lines.extend(aligned(&rows));
    lines.push(String::new());

    lines.push("all vertices swing freely, every frame wanted".to_owned());
    lines.push(String::new());
    let mut rows = vec![
        ["", "vertices", "one core", "all", "memory"].map(str::to_owned),
        ["", "", "M vertices/s", "M vertices/s", "B a vertex"].map(str::to_owned),
    ];
    rows.extend(report.swinging.iter().map(|swinging| {
        [
            swinging.cause.name().to_owned(),
            thousands(swinging.vertices),
            significant(1e-6 * swinging.one),
            swinging.all.map_or("–".to_owned(), |all| significant(1e-6 * all)),
            significant(swinging.memory),
        ]
    }));
    lines.extend(aligned(&rows));
    lines.push(String::new());

    lines
        .push("a scene of two bodies that decays to nothing: time of a step and of looking at all vertices".to_owned());
    lines.push(String::new());
    let mut rows = vec![["", "steps", "in the beginning", "slowest", "in the end"].map(str::to_owned)];
    rows.extend(report.decay.iter().map(|decay| {
        let name = if decay.skip { "default" } else { "nothing skipped" };
        let time = |seconds: f64| format!("{} µs", significant(1e6 * seconds));
        [name.to_owned(), thousands(decay.steps), time(decay.early), time(decay.slowest), time(decay.late)]
    }));
    lines.extend(aligned(&rows));
    for too_large in &report.too_large {
        lines.push(format!("left out: {too_large}"));
    }
    lines.join("\n")
}

fn row(point: &Point) -> [String; 11] {
    let missing = || "–".to_owned();
    let rate = |run: &Run| number(run.steps_per_second());
    let error = |judged: Option<Judged>| judged.map_or(missing(), |it| format!("{:.0e}", it.error));
    [
        thousands(point.bodies as u64),
        rate(&point.one),
        point.all.as_ref().map_or(missing(), rate),
        point.speed_up().map_or(missing(), |ratio| format!("{ratio:.2}")),
        significant(1e-6 * point.vertices as f64 / point.one.seconds),
        number(point.reached),
        significant(1e9 * point.seconds_per_reached()),
        human((point.memory / point.bodies) as u64),
        error(point.judged),
        point.plain.as_ref().map_or(missing(), |plain| rate(&plain.run)),
        error(point.plain.as_ref().and_then(|plain| plain.judged)),
    ]
}

fn shares(point: &Point, run: &Run) -> [String; 6] {
    let share = |stage: Stage| format!("{:.0}", 100.0 * run.stages[stage as usize]);
    let [reach, events, integrate] = Stage::ALL.map(share);
    let name = point.family.name().to_owned();
    [name, thousands(point.bodies as u64), run.threads.to_string(), reach, events, integrate]
}

/// What the numbers mean, and where they were measured.
pub fn footer(report: &Report, machine: &Machine) -> String {
    let threads = report.threads;
    format!(
        "reached: vertices inside of a sphere; memory: what the world has allocated; error: the largest of a vertex, every 20 \
         steps\nof the first 240 or as many as were taken, in radii, against an independent solution; plain: the thesis’s \
         scheme, every vertex, all pairs,\none number at a time, one core; run times: the best of 9 blocks of steps, or of 3 that take long\n\
         {}, 1 and {threads} of {} cores used; meldscope {}",
        machine.cpu, machine.cores, machine.version
    )
}
