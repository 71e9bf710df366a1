//! The goals for step cost, with their measured values.

use super::{Point, Report, Run, free_oscillation::Cause, scenes::Family};
use crate::bench::goals::{Goal, at_least, at_most};

/// Vertex-steps per second of a plain loop over damped oscillators, limited by memory bandwidth, on one core of the
/// machine for which the goals were set. The baseline for free oscillation.
const MEMORY_BOUND: f64 = 0.85e9;

/// The goals for which there is a measurement. (The permitted slow-down of small scenes by threads was not specified;
/// 0.95 was chosen here.)
pub fn goals(report: &Report) -> Vec<Goal> {
    let mut goals = vec![at_least("two, one core", 300_000.0, " steps/s", report.two.steps_per_second())];
    let contact = report.at(Family::Contact, 10_000);
    if let Some(point) = contact {
        let what = format!("10,000 bodies in contact, {} cores", point.best().threads);
        goals.push(at_least(&what, 60.0, " steps/s", point.best().steps_per_second()));
    }
    if let (Some(all), Some(few)) = (contact, report.at(Family::Hundredth, 10_000)) {
        let ratio = |of: fn(&Point) -> &Run| of(all).seconds / of(few).seconds;
        goals.push(at_least("1 % in contact against all, 10,000 bodies, one core", 50.0, " ×", ratio(|p| &p.one)));
        if all.all.is_some() {
            goals.push(at_least(
                "1 % in contact against all, 10,000 bodies, all cores",
                50.0,
                " ×",
                ratio(Point::best),
            ));
        }
    }
    if let (Some(pair), Some(rest)) = (report.at(Family::Rest, 2), report.at(Family::Rest, 100_000)) {
        let ratio = rest.one.seconds / pair.one.seconds;
        goals.push(at_most("100,000 bodies, all at rest but one pair, against the pair alone", 2.0, " ×", ratio));
    }
    for family in Family::ALL {
        let one = report.slope(family, |point| Some(&point.one));
        let all = report.slope(family, |point| point.all.as_ref());
        for (cores, slope) in [("one core", one), ("all cores", all)] {
            if let Some(slope) = slope {
                let what = format!("cost against bodies from 100 on, {}, {cores}: exponent", family.name());
                goals.push(at_most(&what, 1.05, "", slope));
            }
        }
    }
    if let Some(each) = report.free_oscillation.iter().find(|one| one.cause == Cause::Sphere) {
        let share = 100.0 * each.one / MEMORY_BOUND;
        goals.push(at_least("free oscillation, every frame, of 0.85 G vertices/s, one core", 50.0, " %", share));
    }
    if let Some(point) = report.of(Family::Contact).last() {
        let bytes = point.memory as f64 / point.vertices as f64;
        goals.push(at_most("memory of a vertex of an active body", 40.0, " B", bytes));
    }
    if let Some(point) = report.of(Family::Rest).last().filter(|point| point.bodies >= 1000) {
        goals.push(at_most("memory of a body at rest", 1024.0, " B", point.memory as f64 / point.bodies as f64));
    }
    if let Some(contact) = report.free.contact.last() {
        let what = format!("{} free bodies in contact, of the prescribed rate, one core", contact.bodies);
        goals.push(at_least(&what, 0.4, " ×", contact.rate()));
    }
    if let Some(resting) = report.free.resting.last() {
        let what = match resting.asleep == resting.bodies {
            true => {
                format!("{} free bodies at rest on a plane and one that moves, against that one alone", resting.bodies)
            }
            false => {
                let (bodies, asleep) = (resting.bodies, resting.asleep);
                format!("{bodies} free bodies on a plane, of which only {asleep} have come to rest, and one that moves")
            }
        };
        goals.push(at_most(&what, 1.3, " ×", resting.seconds / resting.alone));
    }
    // subnormal floats take a hundred times as long; the factor of 2 was chosen here
    let what = "a scene that decays to rest: slowest steps against the first";
    goals.push(at_most(what, 2.0, " ×", report.decay.slowest / report.decay.early));
    for point in report.of(Family::Contact) {
        let Some(speed_up) = point.speed_up() else { continue };
        let bodies = point.bodies;
        // specified for two cores; with more cores the result can be no worse
        let (what, goal) = if bodies >= 1000 { ("in contact", 1.8) } else { ("in contact: not slowed down", 0.95) };
        goals.push(at_least(&format!("all cores against one, {bodies} bodies {what}"), goal, " ×", speed_up));
    }
    goals
}
