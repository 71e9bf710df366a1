//! Measurements as tables for the terminal.

use super::{Judged, Point, Report, Run, scenes::Family};
use crate::{
    bench::{
        machine::Machine,
        tables::{self, missing},
    },
    sim::Stage,
    text::{bytes, number, significant, thousands},
};

/// All measurements, one table per family.
pub fn table(report: &Report) -> String {
    let mut parts = vec![];
    let mut add = |what: String, table: String| parts.push(format!("{what}\n\n{table}"));
    let all = format!("{} cores\nsteps/s", report.threads);
    let heading = [
        "bodies",
        "one core\nsteps/s",
        &all,
        "ratio",
        "one core\nM vertices/s",
        "reached\nvertices",
        "per reached\nns",
        "memory\nper body",
        "error\n[R]",
        "plain\nsteps/s",
        "error\n[R]",
    ];
    for family in Family::ALL {
        let what = format!("{}: 266 vertices per body, exponential, tolerance 1e-6", family.name());
        add(what, tables::table(heading, report.of(family).map(row)));
    }
    let rows = report.points.iter().flat_map(|point| point.runs().map(move |run| shares(point, run)));
    let heading = ["", "bodies", "threads", "reach", "events", "integrate"];
    add("share of the stages in a step [%]".to_owned(), tables::table(heading, rows));

    let rows = report.free_oscillation.iter().map(|each| {
        [
            each.cause.name().to_owned(),
            thousands(each.vertices),
            significant(1e-6 * each.one),
            each.all.map_or_else(missing, |all| significant(1e-6 * all)),
            significant(each.memory),
        ]
    });
    let heading = ["", "vertices", "one core\nM vertices/s", "all\nM vertices/s", "memory\nB/vertex"];
    add("all vertices oscillate freely, every frame requested".to_owned(), tables::table(heading, rows));

    let (decay, time) = (&report.decay, |seconds: f64| format!("{} µs", significant(1e6 * seconds)));
    let rows = [[thousands(decay.steps), time(decay.early), time(decay.slowest), time(decay.late)]].into_iter();
    let what = "two bodies that decay to rest: time of a step and of reading all vertices";
    add(what.to_owned(), tables::table(["steps", "at the start", "slowest", "at the end"], rows));

    let time = |seconds: f64| format!("{} µs", significant(1e6 * seconds));
    let rows = report.free.contact.iter().map(|each| {
        let rate = format!("{:.3}", each.rate());
        [thousands(each.bodies as u64), time(each.free), time(each.prescribed), rate]
    });
    let heading = ["bodies", "step, free", "on paths", "relative rate"];
    add("free bodies in contact, in pairs, one core".to_owned(), tables::table(heading, rows));
    let rows = report.free.resting.iter().map(|each| {
        let [bodies, asleep] = [each.bodies, each.asleep].map(|count| thousands(count as u64));
        [bodies, asleep, time(each.seconds), time(each.alone)]
    });
    let heading = ["bodies", "at rest", "step", "moving one alone"];
    add("free bodies on a plane, and one that moves, one core".to_owned(), tables::table(heading, rows));

    parts.extend(report.too_large.iter().map(|too_large| format!("skipped: {too_large}")));
    parts.join("\n\n")
}

fn row(point: &Point) -> [String; 11] {
    let rate = |run: &Run| number(run.steps_per_second());
    let error = |judged: Option<Judged>| judged.map_or_else(missing, |it| format!("{:.0e}", it.error));
    [
        thousands(point.bodies as u64),
        rate(&point.one),
        point.all.as_ref().map_or_else(missing, rate),
        point.speed_up().map_or_else(missing, |ratio| format!("{ratio:.2}")),
        significant(1e-6 * point.vertices as f64 / point.one.seconds),
        number(point.reached),
        significant(1e9 * point.seconds_per_reached()),
        bytes((point.memory / point.bodies) as u64),
        error(point.judged),
        point.plain.as_ref().map_or_else(missing, |plain| rate(&plain.run)),
        error(point.plain.as_ref().and_then(|plain| plain.judged)),
    ]
}

fn shares(point: &Point, run: &Run) -> [String; 6] {
    let share = |stage: Stage| format!("{:.0}", 100.0 * run.stages[stage as usize]);
    let [reach, events, integrate] = Stage::ALL.map(share);
    let name = point.family.name().to_owned();
    [name, thousands(point.bodies as u64), run.threads.to_string(), reach, events, integrate]
}

/// Explains the columns, and names the machine.
pub fn footer(report: &Report, machine: &Machine) -> String {
    let threads = report.threads;
    format!(
        "reached: vertices inside a sphere; memory: allocated by the world; error: the largest of any vertex, checked every 20 \
         steps\nup to step 240, in radii, against an independent solution; plain: the thesis’s scheme, every vertex, all pairs,\n\
         one number at a time, one core; run times: the best of 9 blocks of steps, or of 3 long ones\n\
         {}, 1 and {threads} of {} cores used; meldscope {}",
        machine.cpu, machine.cores, machine.version
    )
}
