//! `meldscope check`: compares scripted scenes with their golden recordings.

use std::{
    collections::HashSet,
    fs,
    io::{self, Write as _},
    path::{Path, PathBuf},
    sync::Arc,
};

use glam::DVec3;
use rayon::prelude::*;

use super::{
    Failure, load,
    overrides::Overrides,
    print,
    program::{Program, Subject},
    progress::{Progress, Work},
    say,
};
use crate::{
    atomic::{self, AtomicFile},
    observe::Experiment,
    recording::{
        ReadError, events,
        existing::{Existing, Kind, REASONS, replace},
        golden::{self, BlessError, Blessed, GoldenDifference, GoldenOutcome, Moved},
    },
    scene::Scene,
    stream::{settings::application, sinks::Complete},
    text::{self, bytes, counted, thousands, vector},
};

/// The folder to check if no path is given.
const DEFAULT: &str = "recordings";
/// Upper limit on listed vertices or events; the rest are counted.
const LISTED: usize = 8;

#[derive(clap::Args)]
pub struct Arguments {
    /// Scene files, or folders of them [default: recordings]. The golden recording of SCENE.toml is SCENE.rrd.
    #[arg(value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// Bless: replace golden recordings that differ and create missing ones. The reason is stored in them and in
    /// BLESSED.md.
    #[arg(long, value_name = "REASON", value_parser = parse_reason)]
    bless: Option<String>,
    /// Accept results that are not bit-identical if values are within the scene's tolerance and events are the same.
    #[arg(long, conflicts_with = "bless")]
    tolerant: bool,
    /// The folder for recordings of failed checks, SCENE.check.rrd [default: the current one].
    #[arg(long, value_name = "DIR", conflicts_with = "bless")]
    out: Option<PathBuf>,
}

fn parse_reason(text: &str) -> Result<String, String> {
    let reason = text.split_whitespace().collect::<Vec<_>>().join(" ");
    if reason.is_empty() { Err("expected the reason for the change".to_owned()) } else { Ok(reason) }
}

/// A scene and the path of its golden recording.
struct Script {
    experiment: Arc<dyn Experiment>,
    golden: PathBuf,
    /// The name used in reports: that of its file, with its folder if another file has the same.
    name: String,
    /// The name of its comparison, without an extension.
    comparison: String,
}

/// Checks the scenes, or blesses them.
pub fn check(program: Program<'_>, arguments: Arguments) -> Result<(), Failure> {
    let scripts = scripts(program, &arguments.paths)?;
    match &arguments.bless {
        Some(reason) => bless(&scripts, reason),
        None => compare(&scripts, &arguments),
    }
}

fn compare(scripts: &[Script], arguments: &Arguments) -> Result<(), Failure> {
    let folder = arguments.out.clone().unwrap_or_default();
    if !folder.as_os_str().is_empty() {
        fs::create_dir_all(&folder).map_err(|error| Failure::folder("create", &folder, &error))?;
    }
    let progress = Progress::new("", Work::Units("scene", Some(scripts.len() as u64)));
    let results: Vec<_> = scripts
        .par_iter()
        .map(|script| match script.golden.exists() {
            true => {
                let comparison = folder.join(format!("{}.check.rrd", script.comparison));
                golden::check(&*script.experiment, &script.golden, Some(&comparison)).map(Some)
            }
            false => Ok(None),
        })
        .inspect(|_| progress.add(1))
        .collect();
    drop(progress);
    let (mut failed, mut rejected) = (Vec::new(), None);
    for (script, result) in scripts.iter().zip(results) {
        let name = &script.name;
        match result {
            Err(error @ ReadError::Failed { .. }) => {
                print(&format!("{name}: {error}"));
                failed.push(name.as_str());
            }
            Err(error) => {
                print(&format!("{name}: {error}"));
                rejected = rejected.or(Some(error.to_string()));
            }
            Ok(None) => {
                print(&format!(
                    "{name}: no golden recording; `{} check --bless REASON` creates {}",
                    text::program(),
                    script.golden.display()
                ));
                failed.push(name.as_str());
            }
            Ok(Some(GoldenOutcome::Identical { steps, events, digest, is_rewritten, .. })) => {
                let rewritten = if is_rewritten { " (its text has changed, without effect)" } else { "" };
                print(&format!(
                    "{name}: identical, {}, {}, {digest:016x}{rewritten}",
                    counted(steps, "step"),
                    counted(events as u64, "event")
                ));
            }
            Ok(Some(GoldenOutcome::Different(difference))) => {
                let is_accepted = arguments.tolerant && difference.is_tolerable();
                report(name, &difference, is_accepted);
                if !is_accepted {
                    failed.push(name);
                }
            }
        }
    }
    match (rejected, failed.len()) {
        (Some(error), _) => Err(Failure::Input(error)),
        (None, 0) => Ok(()),
        (None, count) => Err(Failure::Run(format!(
            "{count} of {} scenes differ from their golden recordings, or have none: {}",
            scripts.len(),
            failed.join(", ")
        ))),
    }
}

/// Prints the result on one line, followed by where and by how much the recording differs.
fn report(name: &str, difference: &GoldenDifference, is_accepted: bool) {
    let verdict = match (is_accepted, difference.is_tolerable()) {
        (true, _) => "different bits, accepted: values are within tolerance, events are the same",
        (false, true) => "DIFFERENT bits, though values are within tolerance and events are the same",
        (false, false) => "DIFFERENT",
    };
    print(&format!("{name}: {verdict}"));
    if let Some(cut_short) = &difference.cut_short {
        print(&format!("  {cut_short}"));
    }
    if difference.is_rewritten {
        print("  the scene's text differs from that of its golden recording");
    }
    if let Some([then, now]) = difference.steps {
        print(&format!("  {}, {} in the golden recording", counted(now, "step"), thousands(then)));
    }
    if let Some([then, now]) = &difference.counts {
        print(&format!("  {now}, {then} in the golden recording"));
    }
    if let Some([then, now]) = &difference.methods {
        print(&format!("  run{now}, the golden recording{then}"));
    }
    if let Some(first) = &difference.first {
        print(&format!(
            "  first at step {} (t = {:.6} s): checksum {:016x}, now {:016x}",
            first.step, first.time, first.golden, first.found
        ));
        match first.bodies.first() {
            _ if !difference.is_golden => print(&format!(
                "    where and by how much is not known: this is no golden recording; `{} check --bless REASON` makes one",
                text::program()
            )),
            None => print(
                "    no vertex differs there: the difference is in a pair's phase, or in the time of a stored state",
            ),
            Some((body, vertices)) => {
                let listed: Vec<String> = vertices.iter().take(LISTED).map(usize::to_string).collect();
                let more = if vertices.len() > LISTED { ", …" } else { "" };
                print(&format!(
                    "    body \"{body}\", {}: {}{more}{}",
                    counted(vertices.len() as u64, "vertex"),
                    listed.join(", "),
                    match first.bodies.len() {
                        1 => String::new(),
                        2 => ", and some of another body".to_owned(),
                        bodies => format!(", and some of {} more bodies", bodies - 1),
                    }
                ));
                let vertex = vertices.first().copied().unwrap_or_default();
                print(&format!("    displacement of vertex {vertex} there now: {}", vector(&first.displacement)));
            }
        }
    }
    match &difference.worst {
        Some(worst) => print(&format!(
            "  worst at step {} (t = {:.6} s): body \"{}\", vertex {}: displacement {}, now {}: {} radii apart, {} \
             tolerance; {} vertices differ",
            worst.step,
            worst.time,
            worst.body,
            worst.vertex,
            vector(&worst.recorded),
            vector(&worst.found),
            text::short(worst.difference),
            if difference.is_within_tolerance { "within" } else { "BEYOND" },
            thousands(worst.vertices as u64),
        )),
        None if difference.first.is_some() && difference.is_golden => {
            print("  no state of the golden recording shows the difference");
        }
        None => {}
    }
    if let Some(Moved { step, body, places: [then, now] }) = &difference.moved {
        let place = |(radius, centre): &(f64, DVec3)| format!("radius {radius}, centre {}", vector(centre));
        print(&format!(
            "  at step {step}: body \"{body}\" has {}, in the golden recording {}; no displacement differs",
            place(now),
            place(then)
        ));
    }
    for change in events::listed(&difference.events, LISTED) {
        print(&format!("  event {change}"));
    }
    if difference.events.len() > LISTED {
        print(&format!("  … and {}", counted((difference.events.len() - LISTED) as u64, "more event")));
    }
    for deviation in difference.surfaces.iter().take(LISTED) {
        print(&format!("  surfaces: {deviation}"));
    }
    if difference.surfaces.len() > LISTED {
        print(&format!("  … and {}", counted((difference.surfaces.len() - LISTED) as u64, "more difference")));
    }
    match &difference.comparison {
        Some(Ok(path)) => print(&format!("  compare them in the viewer: rerun {}", path.display())),
        Some(Err(error)) => print(&format!("  the comparison could not be written: {error}")),
        None => {}
    }
}

fn bless(scripts: &[Script], reason: &str) -> Result<(), Failure> {
    let progress = Progress::new("", Work::Units("scene", Some(scripts.len() as u64)));
    let results: Vec<_> = scripts
        .par_iter()
        .map(|script| {
            let (experiment, schema) = (&*script.experiment, script.experiment.schema());
            let is_same = script.golden.exists()
                && matches!(
                    golden::check(experiment, &script.golden, None),
                    Ok(GoldenOutcome::Identical { is_rewritten: false, is_golden: true, .. })
                );
            if is_same {
                return Ok(None);
            }
            let new = Existing { application: application(&schema.name), kind: Some(Kind::Golden) };
            let note = replace(&script.golden, &new)?;
            golden::prepare(experiment, &script.golden, reason).map(|(blessed, file)| Some((blessed, file, note)))
        })
        .inspect(|_| progress.add(1))
        .collect();
    drop(progress);
    let (mut made, mut notes, mut failed) = (Vec::new(), Vec::new(), Vec::new());
    for (script, result) in scripts.iter().zip(results) {
        match result {
            Ok(None) => print(&format!("{}: identical, kept", script.name)),
            Ok(Some((blessed, file, note))) => {
                made.push((script, blessed, file));
                notes.push(note);
            }
            Err(BlessError::Sink(error)) => failed.push((script, Failure::from(error))),
            Err(BlessError::Scene(error)) => failed.push((script, Failure::Run(error))),
        }
    }
    // The reasons come first: whenever the machine fails, no golden recording is without its reason.
    let placed = atomic::together(|| {
        let written = give_reasons(&made, reason);
        made.into_iter()
            .map(|(script, blessed, file)| {
                let placed = match (&written, file) {
                    (Ok(()), Some(file)) => file.place().map_err(|error| error.to_string()),
                    (Ok(()), None) => Ok(()),
                    (Err(error), file) => {
                        file.into_iter().for_each(Complete::discard);
                        Err(error.clone())
                    }
                };
                (script, blessed, placed)
            })
            .collect::<Vec<_>>()
    });
    for ((script, blessed, placed), note) in placed.into_iter().zip(notes) {
        match placed {
            Ok(()) => {
                note.iter().for_each(|note| say(&format!("note: {note}")));
                let size = bytes(blessed.bytes);
                print(&format!("{}: {:016x}, {} ({size})", script.name, blessed.digest, script.golden.display()));
            }
            Err(error) => failed.push((script, Failure::Run(error))),
        }
    }
    let is_input = failed.iter().all(|(_, error)| matches!(error, Failure::Input(_)));
    let failure = if is_input { Failure::Input } else { Failure::Run };
    match failed.as_slice() {
        [] => Ok(()),
        [(script, error)] => Err(failure(format!("{}: {error}", script.name))),
        all => {
            all.iter().for_each(|(script, error)| say(&format!("{}: {error}", script.name)));
            let names: Vec<&str> = all.iter().map(|(script, _)| script.name.as_str()).collect();
            let (count, of) = (all.len(), scripts.len());
            Err(failure(format!("{count} of {of} scenes were not blessed: {}", names.join(", "))))
        }
    }
}

/// A golden recording that has been made for a script.
type Made<'a> = (&'a Script, Blessed, Option<Complete>);

/// Adds the reason for new golden recordings to the list in each of their folders.
fn give_reasons(made: &[Made<'_>], reason: &str) -> Result<(), String> {
    let mut folders: Vec<(&Path, Vec<String>)> = Vec::new();
    for (script, blessed, _) in made {
        let folder = script.golden.parent().unwrap_or(Path::new(""));
        let entry = format!("{} {:016x}", script.name, blessed.digest);
        match folders.iter_mut().find(|(known, _)| *known == folder) {
            Some((_, entries)) => entries.push(entry),
            None => folders.push((folder, vec![entry])),
        }
    }
    for (folder, entries) in folders {
        let path = folder.join(REASONS);
        let written = || {
            let mut text = match fs::read(&path) {
                Err(error) if error.kind() == io::ErrorKind::NotFound => head().into_bytes(),
                read => read?,
            };
            let (date, version) = (jiff::Timestamp::now().strftime("%F"), env!("CARGO_PKG_VERSION"));
            writeln!(text, "- {date}, meldscope {version}: {}: {reason}", entries.join(", "))?;
            let mut file = AtomicFile::create(&path)?;
            file.write_all(&text)?;
            file.commit()
        };
        written().map_err(|error| format!("cannot write the reason to {}: {error}", path.display()))?;
    }
    Ok(())
}

/// The beginning of a list of reasons.
fn head() -> String {
    format!(
        "# Why golden recordings were made\n\nWritten by `{} check --bless REASON`: what was run, and the hash of all \
         checksums.\n\n",
        text::program()
    )
}

/// The path of a file by which it is known again, however its folder is named.
fn in_folder(file: &Path) -> PathBuf {
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let folder = fs::canonicalize(folder).unwrap_or_else(|_| folder.to_owned());
    folder.join(file.file_name().unwrap_or_default())
}

/// The scenes found under `paths`, sorted by name; of another program, the experiments of golden recordings there.
fn scripts(program: Program<'_>, paths: &[PathBuf]) -> Result<Vec<Script>, Failure> {
    let default = [PathBuf::from(DEFAULT)];
    let paths = if paths.is_empty() { &default } else { paths };
    let (extension, what) = match program {
        Program::Scenes => ("toml", "scenes (*.toml)"),
        Program::Own(_) => ("rrd", "golden recordings (*.rrd)"),
    };
    let is_of_check =
        |file: &Path| file.file_stem().is_some_and(|stem| Path::new(stem).extension() == Some("check".as_ref()));
    let mut files = Vec::new();
    for path in paths {
        let unreadable = |error: std::io::Error| Failure::Input(format!("cannot read {}: {error}", path.display()));
        if path.is_dir() {
            let (mut found, mut notes) = (Vec::new(), Vec::new());
            let is_of_program = matches!(program, Program::Scenes);
            for entry in fs::read_dir(path).map_err(unreadable)? {
                let file = entry.map_err(unreadable)?.path();
                let is_text = || fs::metadata(&file).is_ok_and(|of| of.is_file() && of.len() <= Scene::LARGEST_TEXT);
                let says_so = || fs::read_to_string(&file).is_ok_and(|text| Scene::is_sweep(&text));
                let is_sweep = || is_of_program && is_text() && says_so();
                let is_golden = || Existing::at(&file).is_some_and(|there| there.kind == Some(Kind::Golden));
                let is_script =
                    |file: &Path| file.extension().is_some_and(|found| found == extension) && !is_of_check(file);
                // results of a sweep have their sweep.toml
                if file.is_dir() && !file.join("sweep.toml").exists() {
                    let mut inside = fs::read_dir(&file).into_iter().flatten().flatten();
                    if inside.any(|entry| is_script(&entry.path())) {
                        notes.push(format!("note: check does not look into {}: name it, too", file.display()));
                    }
                } else if is_script(&file) {
                    match is_sweep() {
                        true => notes.push(format!("note: {} is a sweep, which check does not run", file.display())),
                        false => found.push(file),
                    }
                } else if is_of_program
                    && file.extension().is_some_and(|found| found == "rrd")
                    && !file.with_extension(extension).exists()
                    && is_golden()
                {
                    let scene = file.with_extension(extension);
                    notes.push(format!(
                        "warning: {} is a golden recording without {}",
                        file.display(),
                        scene.display()
                    ));
                }
            }
            notes.sort();
            notes.iter().for_each(|note| say(note));
            if found.is_empty() {
                return Err(Failure::Input(format!("there are no {what} in {}", path.display())));
            }
            found.sort();
            files.extend(found);
        } else if path.extension().is_some_and(|extension| extension == "rrd") {
            // given the golden recording, check its scene
            files.push(path.with_extension(extension));
        } else {
            files.push(path.clone());
        }
    }
    // one given twice would be run and written twice at once
    let mut seen = HashSet::new();
    files.retain(|file| seen.insert(in_folder(file)));
    let is_missing = |file: &&PathBuf| matches!(program, Program::Scenes) && !file.exists();
    if let Some(file) = files.iter().find(is_missing) {
        let help = "give scene files, or folders of them";
        return Err(Failure::Input(format!("there is no scene {}: {help}", file.display())));
    }
    let stem = |file: &PathBuf| file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let stems: Vec<String> = files.iter().map(stem).collect();
    // scenes in different folders may have the same name
    let mut taken: HashSet<String> = stems.iter().cloned().collect();
    files
        .into_iter()
        .enumerate()
        .map(|(index, file)| {
            let name = stems[index].clone();
            let is_first = !stems[..index].contains(&name);
            let mut numbered = (2..).map(|number| format!("{name}-{number}"));
            let comparison = if is_first {
                name.clone()
            } else {
                numbered.find(|name| taken.insert(name.clone())).unwrap_or_default()
            };
            let subject = match program {
                Program::Scenes => {
                    let scene = Overrides::default().apply(load::read(&file)?, &file.display().to_string())?;
                    Subject::Scene(Box::new(scene))
                }
                Program::Own(_) => program.subject(&name, &Overrides::default())?,
            };
            let is_alone = stems.iter().filter(|other| **other == name).count() == 1;
            let name = if is_alone { name } else { file.with_extension("").display().to_string() };
            Ok(Script { experiment: subject.experiment(None), golden: file.with_extension("rrd"), name, comparison })
        })
        .collect()
}
