//! `meldscope explain`: the numbers of a step, and why a pair is in its phase.

use std::{fmt::Write as _, path::Path};

use glam::DVec3;

use super::{
    Failure, interrupt, must_reproduce,
    overrides::Overrides,
    print, print_lines,
    program::Program,
    progress::{Progress, Work},
    say, warnings,
};
use crate::{
    analysis::{Approaches, surface::Merger},
    geometry::Vectors,
    observe::{BodyFrame, Frame, PairEvent, PairFrame, Run, Schema, Simulation, Want, schema::Scheduled},
    recording::{Recorded, existing::Existing},
    scene::template::Override,
    text::{aligned, counted, did_you_mean, short, thousands, trimmed},
};

/// Bodies and pairs that are listed unless some are named.
const LISTED: usize = 12;

#[derive(clap::Args)]
pub struct Arguments {
    /// A recording, a scene file, or the name of a built-in scene. It is simulated again, so a thin recording will do.
    /// Of a file that holds several, one by its name: F.rrd/NAME.
    #[arg(value_name = "F.rrd|SCENE")]
    subject: String,
    /// The step to explain; 0 is the initial state.
    #[arg(long, value_name = "N")]
    step: u64,
    /// Explain this body; may be repeated.
    #[arg(long, value_name = "NAME")]
    body: Vec<String>,
    /// Explain this vertex of a body; may be repeated.
    #[arg(long, value_name = "BODY:INDEX")]
    vertex: Vec<String>,
    /// Explain this pair; may be repeated.
    #[arg(long, value_name = "A~B")]
    pair: Vec<String>,
    /// Another value for a key of the scene, such as influence.merge_at=1.1; may be repeated.
    #[arg(long, value_name = "KEY=VALUE", value_parser = Override::parse)]
    set: Vec<Override>,
}

/// Simulates a run and explains one of its steps.
pub fn explain(program: Program<'_>, arguments: &Arguments) -> Result<(), Failure> {
    let path = Path::new(&arguments.subject);
    let (simulation, last, recorded) = if Existing::is_recording(path) {
        if !arguments.set.is_empty() {
            return Err(Failure::Input("--set is for scenes: a recording is explained as it was made".to_owned()));
        }
        let recorded = program.recorded(path)?;
        (recorded.start().map_err(Failure::input)?, recorded.last(), Some(recorded))
    } else {
        let subject =
            program.subject(&arguments.subject, &Overrides { set: arguments.set.clone(), ..Overrides::default() })?;
        let simulation = subject.experiment(Some(&interrupt::STOP)).start().map_err(Failure::Input)?;
        let schema = simulation.schema();
        warnings(&schema).iter().for_each(|line| say(line));
        let last = schema.steps;
        (simulation, last, None)
    };
    if arguments.step > last {
        return Err(Failure::Input(format!(
            "--step {} is beyond the last step of {}, {last}",
            arguments.step, arguments.subject
        )));
    }
    let schema = simulation.schema();
    let wanted = Wanted::of(arguments, &schema)?;
    let history = History::of((simulation, recorded.as_ref()), &schema, arguments.step, last)?;
    let explained = Explained { schema: &schema, history: &history };
    let time = history.frame.at.time;
    print(&format!("{}, step {} of {}, t = {time:.6} s", schema.name, arguments.step, thousands(last)));
    let mut pairs = wanted.pairs.clone();
    if wanted.is_default {
        pairs.extend(history.frame.pairs.iter().take(LISTED).map(|pair| [pair.a, pair.b]));
    }
    let mut text = String::new();
    for body in &wanted.bodies {
        text += &explained.body(*body);
    }
    for &(body, vertex) in &wanted.vertices {
        text += &explained.vertex(body, vertex);
    }
    text += &explained.pairs(&pairs);
    let (bodies, found) = (schema.bodies.len(), history.frame.pairs.len());
    if wanted.is_default && bodies > LISTED {
        let _ = write!(text, "\n… and {} more bodies: name them with --body", bodies - LISTED);
    }
    if wanted.is_default && found > LISTED {
        let _ = write!(text, "\n… and {} more pairs within reach: name them with --pair", found - LISTED);
    }
    if wanted.is_default && bodies > 1 && found == 0 {
        let _ = write!(text, "\nno pair is within reach: name one, such as --pair {}", schema.pair_name(0, 1));
    }
    print_lines(text.trim_end());
    match &history.failure {
        Some(failure) => Err(Failure::Run(failure.clone())),
        None => Ok(()),
    }
}

/// What is to be explained.
struct Wanted {
    bodies: Vec<usize>,
    vertices: Vec<(usize, usize)>,
    pairs: Vec<[usize; 2]>,
    /// Whether no body, vertex or pair is named: then an overview is printed.
    is_default: bool,
}

impl Wanted {
    fn of(arguments: &Arguments, schema: &Schema) -> Result<Wanted, Failure> {
        let find = |option: &str, name: &str| {
            schema.body(name).ok_or_else(|| {
                let names = || schema.bodies.iter().map(|body| body.name.as_str());
                let hint = did_you_mean(name, names());
                let listed = names().take(LISTED).collect::<Vec<_>>().join(", ");
                let more = if schema.bodies.len() > LISTED { ", …" } else { "" };
                Failure::Input(format!("{option}: there is no body {name:?}{hint} (bodies: {listed}{more})"))
            })
        };
        let bodies = arguments.body.iter().map(|name| find("--body", name)).collect::<Result<Vec<_>, _>>()?;
        let vertices = arguments.vertex.iter().map(|text| {
            let expected = || Failure::Input(format!("--vertex {text}: expected BODY:INDEX, such as a:100"));
            let (name, index) = text.rsplit_once(':').ok_or_else(expected)?;
            let (body, index) = (find("--vertex", name)?, index.parse::<usize>().map_err(|_| expected())?);
            let count = schema.bodies[body].mesh.vertex_count();
            // a body that tears has more vertices later
            if index >= count && !schema.bodies[body].can_tear {
                return Err(Failure::Input(format!("--vertex {text}: body {name:?} has vertices 0 to {}", count - 1)));
            }
            Ok((body, index))
        });
        let vertices = vertices.collect::<Result<Vec<_>, _>>()?;
        let pairs = arguments.pair.iter().map(|text| {
            let expected = || Failure::Input(format!("--pair {text}: expected two bodies, such as a~b"));
            let (a, b) = text.split_once('~').ok_or_else(expected)?;
            let (a, b) = (find("--pair", a)?, find("--pair", b)?);
            if a == b { Err(expected()) } else { Ok([a.min(b), a.max(b)]) }
        });
        let pairs = pairs.collect::<Result<Vec<_>, _>>()?;
        let is_default = bodies.is_empty() && vertices.is_empty() && pairs.is_empty();
        let bodies = if is_default { (0..schema.bodies.len().min(LISTED)).collect() } else { bodies };
        Ok(Wanted { bodies, vertices, pairs, is_default })
    }
}

/// A run: the state of the explained step, and the events before and after it.
struct History {
    frame: Frame,
    events: Vec<PairEvent>,
    approaches: Approaches,
    /// When the run ends [s].
    end: f64,
    /// Why it ended early.
    failure: Option<String>,
}

impl History {
    /// That of a simulation, which must reproduce the recording, if it is of one.
    fn of(
        (simulation, recorded): (Box<dyn Simulation>, Option<&Recorded>),
        schema: &Schema,
        step: u64,
        last: u64,
    ) -> Result<History, Failure> {
        let progress = Progress::new("simulating", Work::Units("step", Some(last)));
        let mut approaches = Approaches::new(&*simulation, schema);
        let (mut frame, mut events) = (Frame::default(), Vec::new());
        let mut run = Run::new(simulation, Some(last));
        loop {
            let simulation = &*run.simulation;
            progress.step(simulation.steps_taken(), simulation.time());
            must_reproduce(recorded, simulation)?;
            if simulation.steps_taken() == step {
                simulation.observe(Want::ALL, &mut frame);
            }
            if !run.step() {
                break;
            }
            approaches.step(&*run.simulation, schema, &run.summary.events);
            events.extend_from_slice(&run.summary.events);
        }
        let failure = run.failure.map(|failure| format!("the run ends early: {failure}"));
        if let Some(failure) = failure.as_ref().filter(|_| run.simulation.steps_taken() < step) {
            return Err(Failure::Run(format!("step {step} is not reached: {failure}")));
        }
        Ok(History { frame, events, approaches, end: run.simulation.time(), failure })
    }
}

struct Explained<'a> {
    schema: &'a Schema,
    history: &'a History,
}

impl Explained<'_> {
    fn body(&self, index: usize) -> String {
        let (body, now) = (&self.schema.bodies[index], &self.history.frame.bodies[index]);
        let time = self.history.frame.at.time;
        let mut text =
            format!("\nbody {}: {}", body.name, counted(vertices(now, body.mesh.vertex_count()) as u64, "vertex"));
        let mass = now.net_force.map_or(body.mass, |net| net.mass);
        text += &if body.is_free { format!(", free, mass {}", short(mass)) } else { ", on a path".to_owned() };
        let _ = write!(
            text,
            "\n  radius {}, influence sphere {}",
            short(body.radius),
            short(self.schema.reach(index, time))
        );
        let _ = write!(text, "\n  centre {}", vector(now.centre, body.radius));
        if let Some(motion) = now.motion {
            let _ =
                write!(text, ", velocity {}, spin {}", vector(motion.velocity, body.radius), vector(motion.spin, 1.0));
            if let Some(net) = now.net_force {
                let _ = write!(text, "\n  acceleration of the centre {}", vector(net.force / net.mass, body.radius));
            }
        }
        if now.is_absent {
            return text + "\n  it is absent\n";
        }
        match now.most_displaced() {
            Some(most) if now.max_displacement > 0.0 => {
                let share = now.max_displacement / body.radius;
                let _ = write!(text, "\n  largest displacement {} R, of vertex {most}", short(share));
            }
            _ => text += "\n  no vertex is displaced",
        }
        let rows = self.schema.terms.iter().zip(&now.terms).filter_map(|(term, frame)| {
            let (most, at) = largest(&frame.accelerations)?;
            let mean = now.mean_acceleration(body, frame);
            let cells = [mean.x, mean.y, mean.z, mean.length(), most].map(short);
            Some(std::iter::once(term.label.to_owned()).chain(cells).chain([at.to_string()]).collect())
        });
        let header = ["acceleration [unit/s²]", "mean x", "y", "z", "length", "largest", "of vertex"];
        text += &table(&header, rows.collect(), "no force acts on a vertex");
        if !now.point_forces.is_empty() {
            let rows = now.point_forces.iter().map(|force| {
                let (at, by) = (now.centre + force.place, force.acceleration);
                let source = force.source.map_or("", |source| &self.schema.bodies[source as usize].name);
                let cells = [by.x, by.y, by.z, by.length(), at.x, at.y, at.z].map(short);
                let label = self.schema.terms[force.term].label.to_owned();
                std::iter::once(label).chain(cells).chain([source.to_owned()]).collect()
            });
            let header = ["at a point [unit/s²]", "x", "y", "z", "length", "at x", "y", "z", "from"];
            text += &table(&header, rows.collect(), "");
        }
        text + "\n"
    }

    fn vertex(&self, index: usize, i: usize) -> String {
        let (body, now) = (&self.schema.bodies[index], &self.history.frame.bodies[index]);
        let mesh = now.mesh_of(body);
        if i >= mesh.vertex_count() {
            return format!("\nvertex {}:{i}: there is none in this step\n", body.name);
        }
        let displacement = now.displacement(i);
        let rest = now.centre + now.rotation * (body.radius * mesh.positions().get(i));
        let velocity = if now.is_at_rest { DVec3::ZERO } else { now.velocities.get(i) };
        let mut text = format!("\nvertex {}:{i}", body.name);
        let _ = write!(
            text,
            "\n  position {}, at rest {}",
            vector(rest + displacement, body.radius),
            vector(rest, body.radius)
        );
        let length = displacement.length();
        let _ = write!(
            text,
            "\n  displacement {}, length {} = {} R",
            vector(displacement, body.radius),
            short(length),
            short(length / body.radius)
        );
        let _ = write!(
            text,
            "\n  velocity of the displacement {}, {}",
            vector(velocity, body.radius),
            short(velocity.length())
        );
        for (other, source) in self.schema.bodies.iter().enumerate().filter(|&(other, _)| other != index) {
            let distance = (rest + displacement - self.history.frame.bodies[other].centre).length();
            let reach = self.schema.reach(other, self.history.frame.at.time);
            if distance < reach {
                let share = short(distance / reach);
                let _ = write!(text, "\n  in the influence sphere of {}, at {share} of its radius", source.name);
            }
        }
        let rows = self.schema.terms.iter().zip(&now.terms).filter(|(_, frame)| !frame.accelerations.is_empty());
        let rows = rows.map(|(term, frame)| {
            let force = frame.accelerations.get(i);
            let source = frame.source.map_or(String::new(), |source| self.schema.bodies[source as usize].name.clone());
            let cells = [force.x, force.y, force.z, force.length()].map(short);
            std::iter::once(term.label.to_owned()).chain(cells).chain([source]).collect()
        });
        text += &table(&["acceleration [unit/s²]", "x", "y", "z", "length", "from"], rows.collect(), "no force acts");
        text + "\n"
    }

    fn pairs(&self, pairs: &[[usize; 2]]) -> String {
        let mut merger = Merger::new(self.schema, None);
        let merged = merger.merge(self.schema, &self.history.frame, pairs);
        let texts = pairs.iter().enumerate().map(|(index, &[a, b])| {
            let mut text = self.phase(a, b);
            if let Some(Some(measures)) = merged.pairs.get(index) {
                let [gap, neck] = [measures.gap, measures.neck].map(short);
                let touching = if measures.gap > 0.0 { "apart" } else { "touching" };
                let overlap = short(measures.overlap);
                let _ = write!(
                    text,
                    "\n  surfaces: {touching}, gap {gap} R, neck {neck} R, overlap {overlap} R³ (R: the smaller radius)"
                );
            }
            text + &self.between(a, b) + "\n"
        });
        texts.collect()
    }

    /// Why a pair is in its phase, and when that changes.
    fn phase(&self, a: usize, b: usize) -> String {
        let Explained { schema, history: History { frame, events, end, .. } } = self;
        let name = schema.pair_name(a, b);
        let [one, other] = [a, b].map(|body| &schema.bodies[body]);
        let distance = (frame.bodies[b].centre - frame.bodies[a].centre).length();
        let found = frame.pairs.iter().find(|pair| [pair.a, pair.b] == [a, b]).copied();
        let q = distance / (one.radius + other.radius);
        let pair = found.unwrap_or(PairFrame::new(a, b, q, 0));
        let of_pair = || events.iter().filter(|event| [event.a, event.b] == [a, b]);
        let before = of_pair().rfind(|event| event.step <= frame.at.step);
        let after = of_pair().find(|event| event.step > frame.at.step);
        // an edit may change a phase by changing its threshold
        let edit = |from: f64, to: f64| {
            let is_in = |time: f64| (from - ROUNDING * schema.dt..=to + ROUNDING * schema.dt).contains(&time);
            let edits = || schema.scheduled.iter().filter(|of| of.text.starts_with(Scheduled::EDIT) && is_in(of.time));
            let Some(Scheduled { time, .. }) = edits().next_back() else { return String::new() };
            // several at one time: any of them may be the cause
            let texts: Vec<&str> = edits().filter(|of| of.time == *time).map(|of| of.text.as_str()).collect();
            format!("; {} at t = {time:.6} s", texts.join(", "))
        };
        let mut text = format!("\npair {name}: {}", schema.phases[pair.phase].name);
        match before {
            Some(event) => {
                let _ = write!(
                    text,
                    " since t = {:.6} s (step {}: {}, q = {:.6}{})",
                    event.time,
                    event.step,
                    event.name,
                    event.q,
                    edit(event.time, event.time)
                );
            }
            None if found.is_none() => text += " since the start, out of reach",
            None => text += " since the start",
        }
        let _ = write!(
            text,
            "\n  q = {:.6}: centre distance {} over {} + {}",
            pair.q,
            exact(rounded(distance, one.radius)),
            exact(one.radius),
            exact(other.radius)
        );
        for (index, threshold) in schema.thresholds.iter().enumerate() {
            if let Some(level) = schema.level(index, [a, b], frame.at.time).filter(|&level| level > 0.0) {
                let side = if pair.q < level { "below" } else { "above" };
                let off = short((pair.q - level).abs());
                let _ = write!(text, "\n  {} {}: q is {off} {side}", threshold.label, exact(level));
            }
        }
        match after {
            Some(event) => {
                let later = short(event.time - frame.at.time);
                let _ = write!(
                    text,
                    "\n  next: {} at t = {:.6} s (step {}), {later} s later{}",
                    event.name,
                    event.time,
                    event.step,
                    edit(frame.at.time, event.time)
                );
            }
            None => {
                let _ = write!(
                    text,
                    "\n  it stays {} until the end of the run, t = {end:.6} s",
                    schema.phases[pair.phase].name
                );
                if let Some(closest) = self.history.approaches.closest().iter().find(|near| [near.a, near.b] == [a, b])
                {
                    let _ = write!(
                        text,
                        ". The closest of the whole run is q = {:.6} at t = {:.6} s",
                        closest.q, closest.time
                    );
                }
            }
        }
        text
    }

    /// The forces along the line between the centres.
    fn between(&self, a: usize, b: usize) -> String {
        let bodies = &self.history.frame.bodies;
        let towards = (bodies[b].centre - bodies[a].centre).normalize_or_zero();
        let along = |body: usize, term: usize, sign: f64| {
            let term = bodies[body].terms.get(term).filter(|term| !term.accelerations.is_empty())?;
            let mean = bodies[body].mean_acceleration(&self.schema.bodies[body], term);
            Some(sign * mean.dot(towards))
        };
        let rows = self.schema.terms.iter().enumerate().filter_map(|(index, term)| {
            let [one, other] = [along(a, index, 1.0), along(b, index, -1.0)];
            (one.is_some() || other.is_some())
                .then(|| vec![term.label.to_owned(), short(one.unwrap_or(0.0)), short(other.unwrap_or(0.0))])
        });
        let [one, other] = [a, b].map(|body| format!("of {}", self.schema.bodies[body].name));
        let header = ["mean acceleration towards the other, by all that acts [unit/s²]", &one, &other];
        table(&header, rows.collect(), "no force acts on either")
    }
}

fn vertices(now: &BodyFrame, of_mesh: usize) -> usize {
    now.mesh.as_ref().map_or(of_mesh, |mesh| mesh.vertex_count())
}

/// The largest length of some vectors, and its index; `None` if all are zero.
fn largest(of: &Vectors) -> Option<(f64, usize)> {
    let index = (0..of.len()).max_by(|&i, &j| of.get(i).length_squared().total_cmp(&of.get(j).length_squared()))?;
    let length = of.get(index).length();
    (length > 0.0).then_some((length, index))
}

/// A smaller share of the usual size is rounding.
const ROUNDING: f64 = 1e-12;

/// A number, or 0 if it is below the rounding of the arithmetic that made it from numbers of the size `usual`.
fn rounded(x: f64, usual: f64) -> f64 {
    if x.abs() < ROUNDING * usual { 0.0 } else { x }
}

/// A number that a scene gives, without the rounding of its arithmetic.
fn exact(x: f64) -> String {
    match x.abs() {
        0.0 | 1e-3.. => trimmed(&format!("{x:.9}")).to_owned(),
        _ => format!("{:e}", format!("{x:.9e}").parse().unwrap_or(x)),
    }
}

/// A vector; 0 where it is below the rounding of the arithmetic that made it, from numbers of the size `usual`.
fn vector(of: DVec3, usual: f64) -> String {
    let usual = of.length().max(usual);
    let [x, y, z] = of.to_array().map(|part| short(rounded(part, usual)));
    format!("({x}, {y}, {z})")
}

/// An indented table: the first column to the left, numbers to the right.
fn table(header: &[&str], rows: Vec<Vec<String>>, nothing: &str) -> String {
    if rows.is_empty() {
        return format!("\n  {nothing}");
    }
    let header = header.iter().map(|&cell| cell.to_owned()).collect();
    let lines: Vec<Vec<String>> = std::iter::once(header).chain(rows).collect();
    aligned(&lines, |column| column == 0).iter().map(|line| format!("\n    {line}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_numbers_of_small_scenes_are_not_zero() {
        for (number, text) in [(8.05e-7, "8.05e-7"), (1e-10, "1e-10"), (0.1 + 0.2, "0.3"), (0.0, "0"), (1.9, "1.9")] {
            assert_eq!(exact(number), text);
        }
        assert_eq!(exact(rounded(1.1e-16, 1.0)), "0");
    }
}
