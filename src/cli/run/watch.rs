//! `--watch`: the run restarts whenever its scene file changes.

use std::{fs::File, io::Read as _, path::Path, sync::atomic::Ordering};

use super::{
    Arguments, CHECK_INTERVAL,
    console::Console,
    events::ListedEvent,
    simulate::{Outcome, Simulated, simulate},
};
use crate::{
    cli::{Failure, interrupt::STOP, program::Subject},
    observe::Simulation,
    scene::Scene,
    stream::sinks::Sinks,
    text::{counted, thousands},
};

/// Runs the scene, and restarts whenever its file changes, until Ctrl-C.
pub fn watch(
    simulation: Box<dyn Simulation>,
    sinks: Sinks,
    arguments: &Arguments,
    console: &mut Console,
) -> Result<Simulated, Failure> {
    let mut changes = Changes {
        file: Watched::new(Scene::without_meshes(&simulation.schema().source).to_owned()),
        reported: String::new(),
        runs: 0,
    };
    let mut run = simulate(simulation, sinks, arguments, Some(&mut changes), console)?;
    let mut before: Option<EventList> = None;
    loop {
        let listed = EventList::of(&run);
        listed.lines(before.as_ref()).iter().for_each(|line| console.print_beside(line));
        before = Some(listed);
        if let Some(failure) = &run.failure {
            if run.sinks.failed() {
                return Ok(run);
            }
            console.notes(std::slice::from_ref(failure));
        }
        let simulation = loop {
            while run.next.is_none() && !STOP.load(Ordering::Relaxed) {
                std::thread::sleep(CHECK_INTERVAL);
                console.notes(&run.sinks.notes());
                run.next = changes.scene(arguments, console);
            }
            let Some(scene) = run.next.take() else { return Ok(run) };
            match Subject::Scene(Box::new(scene)).experiment(Some(&STOP)).start() {
                Ok(simulation) => break simulation,
                Err(error) => console.notes(&[format!("{error}; continuing with the previous scene")]),
            }
        };
        console.say(&format!("{} has changed: restarting", arguments.scene));
        run = simulate(simulation, run.sinks, arguments, Some(&mut changes), console)?;
    }
}

/// The events of a run, for comparison with those of the next.
struct EventList {
    events: Vec<ListedEvent>,
    /// Number of further events.
    more: u64,
    /// Simulated time at the end of the run [s].
    until: f64,
}

impl EventList {
    fn of(run: &Simulated) -> EventList {
        let Outcome { simulation, events, .. } = &run.outcome;
        let listed = events.first.clone();
        EventList { more: events.count - listed.len() as u64, events: listed, until: simulation.time() }
    }

    /// A line for each event, and for each event of the previous run that no longer occurs.
    fn lines(&self, before: Option<&EventList>) -> Vec<String> {
        let mut lines = Vec::new();
        let all = self.events.len() as u64 + self.more;
        lines.push(match all {
            0 => format!("no events in {} s", three(self.until)),
            n => format!("{} in {} s:", counted(n, "event"), three(self.until)),
        });
        let of = |listed: &EventList, event: &ListedEvent| {
            let same = listed.events.iter().find(|other| (&other.what, other.number) == (&event.what, event.number));
            same.map(|other| other.time)
        };
        for event in &self.events {
            let moved = before.map(|before| match of(before, event) {
                Some(time) if time == event.time => ", as before".to_owned(),
                Some(time) if time < event.time => format!(", {} later", duration(event.time - time)),
                Some(time) => format!(", {} earlier", duration(time - event.time)),
                // an event after the end of the previous list is not necessarily new
                None if before.more > 0 || before.until < event.time => String::new(),
                None => ", new".to_owned(),
            });
            lines.push(format!("  {} at t = {} s{}", event.what, three(event.time), moved.unwrap_or_default()));
        }
        let was = before.into_iter().flat_map(|before| &before.events);
        for gone in was.filter(|event| self.more == 0 && event.time <= self.until && of(self, event).is_none()) {
            lines.push(format!("  gone: {}, previously at t = {} s", gone.what, three(gone.time)));
        }
        if self.more > 0 {
            lines.push(format!("  … and {} more", thousands(self.more)));
        }
        lines
    }
}

fn three(seconds: f64) -> String {
    format!("{seconds:.3}")
}

/// A duration in readable form.
fn duration(seconds: f64) -> String {
    match seconds {
        1.0.. => format!("{seconds:.3} s"),
        0.01.. => format!("{:.0} ms", 1e3 * seconds),
        1e-3.. => format!("{:.1} ms", 1e3 * seconds),
        _ => format!("{:.1e} s", seconds),
    }
}

/// A file that is looked at again and again.
pub struct Watched {
    /// Its content when last read.
    text: String,
    /// How often it was missing or empty since then.
    missing: u32,
}

/// A watched scene file.
pub struct Changes {
    file: Watched,
    /// The last reported error in it.
    reported: String,
    /// Number of runs started.
    runs: u64,
}

impl Changes {
    /// Returns the new scene if the file has changed and is valid. An error in it is reported once.
    pub fn scene(&mut self, arguments: &Arguments, console: &Console) -> Option<Scene> {
        let overridden = |scene| arguments.overrides.apply(scene, &arguments.scene).map_err(|error| error.to_string());
        match self.file.changed(Path::new(&arguments.scene))?.and_then(overridden) {
            Ok(scene) => {
                self.reported.clear();
                Some(scene)
            }
            Err(why) => {
                if why != self.reported {
                    console.notes(&[format!("{why}; continuing with the previous scene")]);
                    self.reported = why;
                }
                None
            }
        }
    }

    /// The number of the run that is about to start, from 0.
    pub fn next_run(&mut self) -> u64 {
        self.runs += 1;
        self.runs - 1
    }
}

impl Watched {
    /// A file with this text.
    pub fn new(text: String) -> Watched {
        Watched { text, missing: 0 }
    }

    /// Returns the scene if the text has changed. While the file is unreadable, returns the reason on every call.
    pub fn changed(&mut self, path: &Path) -> Option<Result<Scene, String>> {
        /// An editor may remove or truncate a file before writing it: for so many calls.
        const PATIENCE: u32 = 20;

        let why = match self.read(path) {
            Ok(read) if !read.is_empty() => {
                self.missing = 0;
                if read == self.text {
                    return None;
                }
                self.text = read;
                return Some(Scene::parse_beside(&self.text, path).map_err(|error| error.to_string()));
            }
            Err(Some(why)) => why,
            Ok(_) | Err(None) => {
                self.missing = self.missing.saturating_add(1);
                if self.missing < PATIENCE {
                    return None;
                }
                format!("{} is missing or empty", path.display())
            }
        };
        self.text.clear(); // what it was before is new again
        Some(Err(why))
    }

    /// Its text, or why it has none; `None` if it cannot be read now.
    fn read(&self, path: &Path) -> Result<String, Option<String>> {
        let unreadable = |error: std::io::Error| match error.kind() {
            std::io::ErrorKind::NotFound => None,
            // a program may be replacing it
            std::io::ErrorKind::PermissionDenied if cfg!(windows) => None,
            _ => Some(format!("cannot read {}: {error}", path.display())),
        };
        let metadata = std::fs::metadata(path).map_err(unreadable)?;
        // anything but a regular file may be endless or block forever
        if !metadata.is_file() {
            return Err(Some(format!("{} is no longer a file", path.display())));
        }
        if metadata.len() > Scene::LARGEST_TEXT {
            return Err(Some(format!("{} now exceeds the size limit of a scene", path.display())));
        }
        let mut bytes = Vec::new();
        let read = File::open(path).and_then(|file| file.take(Scene::LARGEST_TEXT).read_to_end(&mut bytes));
        read.map_err(unreadable)?;
        Scene::text_of(&bytes, path).map(str::to_owned).map_err(|error| Some(error.to_string()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn listed(events: &[(&str, f64)], until: f64) -> EventList {
        let mut list: Vec<ListedEvent> = Vec::new();
        for &(what, time) in events {
            let number = 1 + list.iter().filter(|other| other.what == what).count();
            list.push(ListedEvent { what: what.to_owned(), number, time, line: String::new() });
        }
        EventList { events: list, more: 0, until }
    }

    #[test]
    fn events_are_listed_with_their_shift_since_the_previous_run() {
        let before = listed(&[("merge big~mid", 1.224), ("split big~mid", 2.0), ("merge big~mid", 3.0)], 4.0);
        assert_eq!(before.lines(None)[..2], ["3 events in 4.000 s:", "  merge big~mid at t = 1.224 s"]);
        let now = listed(&[("merge big~mid", 1.2), ("split big~mid", 2.0), ("core big~mid", 2.5)], 3.5);
        assert_eq!(
            now.lines(Some(&before)),
            [
                "3 events in 3.500 s:",
                "  merge big~mid at t = 1.200 s, 24 ms earlier",
                "  split big~mid at t = 2.000 s, as before",
                "  core big~mid at t = 2.500 s, new",
                "  gone: merge big~mid, previously at t = 3.000 s",
            ]
        );
        // a run that ended early does not report events after its end as gone
        assert_eq!(listed(&[], 0.5).lines(Some(&before)), ["no events in 0.500 s"]);
        assert_eq!(duration(0.00123), "1.2 ms");
    }
}
