//! What a run prints: its progress, notes and results.

use std::path::Path;

use super::{Arguments, simulate::Outcome};
use crate::{
    cli::{
        is_quiet,
        load::shell_word,
        print,
        progress::{Progress, Work},
        run::events::Events,
        say,
    },
    observe::Experiment,
    stream::{
        recorder::MOST_APPROACHES,
        settings::{Detail, Frames, Settings},
        sinks::Finished,
        size,
    },
    text::{self, bytes, counted, step_size, thousands},
};

/// A rate of steps is reported only if they took at least this long [s].
const LEAST_TIMED: f64 = 0.5;

/// Reports the progress of a run, and prints its results.
pub struct Console {
    pub progress: Progress,
    /// Standard output carries the recording, so results go to standard error.
    piped: bool,
}

impl Console {
    pub fn new(arguments: &Arguments) -> Console {
        Console { progress: Progress::hidden(), piped: arguments.stdout }
    }

    /// Begins to report the steps of a run.
    pub fn begin(&mut self, settings: &Settings, save: Option<&Path>) {
        let progress = Progress::new("recording the first frame", Work::Units("step", settings.steps));
        self.progress = match save {
            Some(save) => progress.with_file(save),
            None => progress,
        };
    }

    pub fn end(&mut self) {
        self.progress = Progress::hidden();
    }

    /// Prints notes, even with --quiet: they report failed destinations and warnings.
    pub fn notes(&self, notes: &[String]) {
        for note in notes {
            self.progress.suspend(|| say(note));
        }
    }

    /// Reports the predicted size of a large recording, and the options that change it. Returns the interval between
    /// frames: the requested one, or one that keeps the file small.
    pub fn say_size(&self, experiment: &dyn Experiment, settings: &Settings, asked: Option<u64>) -> Option<u64> {
        let size = size::project(experiment, settings, size::LARGE).filter(|size| size.bytes > size::LARGE);
        let Some(size) = size else { return asked };
        let every = size.every(settings);
        if is_quiet() {
            return asked.or(Some(every));
        }
        let about = |bytes: u64| format!("about {} MB", thousands(bytes / 1_000_000));
        let all = about(size.bytes);
        let few = about(size.bytes / (every / settings.every).max(1));
        let from = match settings.steps {
            Some(steps) if size.seen < steps => format!(", judging by the first {}", counted(size.seen, "step")),
            _ => String::new(),
        };
        let frames = counted(size.frames, "frame");
        let other = match asked {
            Some(_) => format!("`--every {every}` reduces it to {few}"),
            None => format!("`--every 1` records all {frames}, {all}"),
        };
        let surface = if settings.detail == Detail::Surface { "" } else { "; `--detail surface` takes less" };
        let program = text::program();
        let thin = bytes(10 * settings.steps.unwrap_or(0) + 20_000);
        let taken = match asked {
            Some(_) => format!("the recording will take {all} ({frames}{from})"),
            None => format!("the recording has a frame every {every} steps and will take {few}{from}"),
        };
        self.notes(&[format!(
            "note: {taken}; {other}{surface}; `--thin` takes about {thin} (`{program} replay` restores the frames of any part \
             later)"
        )]);
        asked.or(Some(every))
    }

    pub fn say(&self, line: &str) {
        if !is_quiet() {
            say(line);
        }
    }

    /// Prints a result during the run.
    pub fn print_beside(&self, line: &str) {
        self.progress.suspend(|| self.print(line));
    }

    pub fn print(&self, line: &str) {
        if self.piped { self.say(line) } else { print(line) }
    }
}

/// Prints a summary of the run, and how to open its recording.
pub fn summarize(console: &Console, outcome: &Outcome, finished: &Finished) {
    let Outcome { simulation, schema, settings, frames, events, approaches, seconds: [simulating, all] } = outcome;
    let Events { first: events, count: event_count, of_bodies, .. } = events;
    console.notes(&finished.notes);
    let (bodies, steps) = (schema.bodies.len() as u64, simulation.steps_taken());
    // the first steps warm caches, and other load comes and goes: a rate needs a while
    let rate = match *simulating >= LEAST_TIMED {
        true => format!(" ({} steps/s)", thousands((steps as f64 / simulating) as u64)),
        false => String::new(),
    };
    console.print(&format!(
        "{}: {}, {}; {} of {} s{}, {:.3} s simulated in {simulating:.3} s{rate}, recorded in {all:.3} s",
        schema.name,
        counted(bodies, "body"),
        counted(schema.vertex_count(), "vertex"),
        counted(steps, "step"),
        step_size(schema.dt),
        schema.method(),
        simulation.time(),
    ));
    match event_count {
        0 => console.print("no events"),
        n => console.print(&format!("{}:", counted(*n, "event"))),
    }
    for event in events {
        console.print(&format!("  {}", event.line));
    }
    let more = event_count - of_bodies - events.len() as u64;
    for (more, what) in [(more, "more"), (*of_bodies, "of single bodies")] {
        if more > 0 {
            let and = if events.is_empty() && what != "more" { "" } else { "… and " };
            console.print(&format!("  {and}{} {what}, in the recording's event log", thousands(more)));
        }
    }
    for approach in approaches.iter().take(MOST_APPROACHES) {
        console.print(&format!("  {approach}"));
    }
    if let Some(account) = simulation.account() {
        console.print(&account);
    }
    if let Some(saved) = &finished.save {
        let (path, program) = (saved.path.display(), text::program());
        let word = shell_word(&path.to_string());
        let size = bytes(saved.bytes);
        if outcome.is_unwritten() {
            console.print(&format!("no --on event occurred: {path} is not written"));
            return;
        }
        if settings.frames == Frames::Thin {
            let events = counted(*event_count, "event");
            console.print(&format!("saved {path}: the scene, {events} and {}, {size}", counted(steps + 1, "checksum")));
            console.print(&format!(
                "verify it with `{program} replay {word}`; `{program} replay {word} --save full.rrd` restores the frames"
            ));
            return;
        }
        console.print(&format!("saved {path}: {}, {size}", counted(*frames, "frame")));
        console.print(&format!(
            "open it with `rerun {word}` (pip install rerun-sdk==0.36.3), or install nothing: \
             `{program} run … --serve` shows a run in the browser"
        ));
    }
}
