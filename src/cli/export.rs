//! `meldscope export`: writes the surfaces and tables of a run to files for other programs.

mod formats;
mod parts;
pub mod tables;

use std::{
    fs,
    io::BufWriter,
    path::{Path, PathBuf},
};

use super::{
    Failure, expense, is_marked, is_same_file, must_reproduce, one_of,
    overrides::Overrides,
    print,
    program::Program,
    progress::{Progress, Work},
    say, warnings,
};
use crate::{
    analysis::{surface::Merger, touch::Touches},
    atomic::{self, AtomicFile},
    observe::{Frame, Run, Want, row::rows, verify},
    recording::{Recorded, existing::Existing},
    scene::template::Override,
    stream::settings::file_stem,
    table::Table,
    text::{bytes, counted},
};
use formats::{Format, GENERATOR};
use tables::{BY_STEP, EVENTS, StepData, add_event};

/// Placeholder for the path of a table; its extension selects the format.
const TABLE: &str = "F.csv|F.json|F.parquet";

#[derive(clap::Args)]
#[command(group = clap::ArgGroup::new("what").required(true).multiple(true))]
pub struct Arguments {
    /// A scene file, the name of a built-in scene, or a recording; of a file that holds several, F.rrd/NAME.
    scene: String,
    /// Another value for a key of the scene, such as model=lattice; may be repeated.
    #[arg(long, value_name = "KEY=VALUE", value_parser = Override::parse)]
    set: Vec<Override>,
    /// Write the surfaces to this folder, one file per step: one closed mesh per group of merged bodies, and one per
    /// single body.
    #[arg(long, value_name = "DIR", group = "what")]
    mesh: Option<PathBuf>,
    /// Write a table of events: exact time, pair, q and its rate of change, phases before and after.
    #[arg(long, value_name = TABLE, group = "what")]
    events: Option<PathBuf>,
    /// Write a table of q, phase, gap, overlap and neck of every pair within reach, by step.
    #[arg(long, value_name = TABLE, group = "what")]
    pairs: Option<PathBuf>,
    /// Write a table of the centre, the largest displacement and the scalars of every body, by step.
    #[arg(long, value_name = TABLE, group = "what")]
    bodies: Option<PathBuf>,
    /// Write a table of energy, errors, counts and all other scalars, by step.
    #[arg(long, value_name = TABLE, group = "what")]
    scalars: Option<PathBuf>,
    /// Write a table of exact states: position, displacement and velocity of every vertex, by step.
    #[arg(long, value_name = TABLE, group = "what")]
    states: Option<PathBuf>,
    /// Write a table of forces: acceleration of every vertex by cause, by step.
    #[arg(long, value_name = TABLE, group = "what")]
    forces: Option<PathBuf>,
    /// The format of the meshes.
    #[arg(long, requires = "mesh", default_value = Format::Glb.name(), value_parser = one_of(&Format::ALL, Format::name))]
    format: Format,
    /// The first step to write [default: 0].
    #[arg(long, value_name = "STEP")]
    from: Option<u64>,
    /// The last step to write [default: the last].
    #[arg(long, value_name = "STEP")]
    to: Option<u64>,
    /// Write every Nth step, from the first.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..))]
    every: u64,
}

/// A run to export, its last step, and the recording that it must reproduce, if any.
struct Source {
    run: Run,
    last: u64,
    recorded: Option<Recorded>,
}

/// Writes the surfaces and tables of a run.
pub fn export(program: Program<'_>, arguments: Arguments) -> Result<(), Failure> {
    let Source { mut run, last, recorded } = source(program, &arguments)?;
    let (from, to) = (arguments.from.unwrap_or(0), arguments.to.unwrap_or(last));
    if from > to {
        return Err(Failure::Input(format!("there are no steps from {from} to {to}: the last is {last}")));
    }
    if to > last {
        return Err(Failure::Input(format!("--to {to} is beyond the last step, {last}")));
    }
    run.last = Some(to);
    let schema = run.simulation.schema();
    verify::schema(&schema).map_err(Failure::Run)?;
    let is_wanted = |step: u64| (from..=to).contains(&step) && (step - from).is_multiple_of(arguments.every);
    let (stem, format) = (file_stem(&schema.name), arguments.format);
    let folder = arguments.mesh.as_ref().map(|path| Folder { path, stem, format });
    let inputs = if folder.is_some() { mesh_files(Path::new(&arguments.scene), &schema.source) } else { Vec::new() };
    folder.iter().try_for_each(|folder| folder.prepare(is_wanted, &inputs))?;
    let by_step = BY_STEP.iter().filter_map(|table| Some(((table.path)(&arguments)?, table)));
    let given: Vec<&PathBuf> = arguments.events.iter().chain(by_step.clone().map(|(path, _)| path)).collect();
    let is_twice = |i: &usize| given[..*i].iter().any(|other| atomic::is_same_destination(other, given[*i]));
    if let Some(twice) = (0..given.len()).find(is_twice).map(|i| given[i]) {
        return Err(Failure::Input(format!("{} is given for two tables: give each its own file", twice.display())));
    }
    let mut events = arguments.events.as_deref().map(|path| Table::create(path, EVENTS.into())).transpose()?;
    let tables = by_step.map(|(path, of)| Ok((Table::create(path, (of.columns)(&schema))?, of.add)));
    let mut tables = tables.collect::<Result<Vec<_>, Failure>>()?;
    let Arguments { pairs, bodies, scalars, forces, .. } = &arguments;
    let has_scalars = [pairs, bodies, scalars].into_iter().any(Option::is_some);
    let want = Want { scalars: has_scalars, forces: forces.is_some() };
    let needs_frames = folder.is_some() || !tables.is_empty();

    let [mut merger, mut measurer] = [(); 2].map(|()| Merger::new(&schema, None));
    let mut frame = Frame::default();
    let (mut files, mut size, mut overlapping) = (0, 0, 0);
    let (mut touches, mut surfaces) = (events.is_some().then(|| Touches::new(&*run.simulation)), Vec::new());
    let progress = Progress::new("", Work::Units("step", Some(to)));
    loop {
        let simulation = &*run.simulation;
        let step = simulation.steps_taken();
        progress.step(step, simulation.time());
        must_reproduce(recorded.as_ref(), simulation)?;
        if is_wanted(step) && needs_frames {
            simulation.observe(want, &mut frame);
            verify::frame(&schema, &frame, want).map_err(Failure::Run)?;
        }
        if let Some(folder) = folder.as_ref().filter(|_| is_wanted(step)) {
            let merged = merger.merge(&schema, &frame, &[]);
            overlapping += u64::from(merged.overlapping > 0);
            size += folder.write(step, &parts::parts(&schema, &frame, merged))?;
            files += 1;
        }
        if is_wanted(step) {
            let mut data = StepData { schema: &schema, frame: &frame, summary: &run.summary, merger: &mut measurer };
            tables.iter_mut().try_for_each(|(table, add)| add(table, &mut data))?;
        }
        let has_stepped = run.valid_step().map_err(|failure| {
            let written =
                folder.as_ref().map(|folder| format!("; {} contains the steps up to here", folder.path.display()));
            let is_tabled = events.is_some() || !tables.is_empty();
            let tabled = is_tabled.then(|| format!("; no table was written: --to {step} stops before this step"));
            Failure::Run(format!("{failure}{}{}", written.unwrap_or_default(), tabled.unwrap_or_default()))
        })?;
        if !has_stepped {
            break;
        }
        if let (Some(table), Some(touches)) = (&mut events, &mut touches) {
            let (simulation, summary) = (&*run.simulation, &run.summary);
            simulation.observe(Want::default(), &mut frame);
            touches.step_and_take(simulation, &mut frame, &summary.events, &mut surfaces);
            let all = rows(&summary.events, &surfaces, &summary.body_events);
            all.iter()
                .filter(|row| (from..=to).contains(&row.step()))
                .try_for_each(|row| add_event(table, &schema, row))?;
        }
    }
    drop(progress);
    if overlapping > 0 {
        say(&format!(
            "note: in {} a group of bodies could not be united, and its meshes overlap",
            counted(overlapping, "file")
        ));
    }
    if let Some(folder) = &folder {
        print(&format!("wrote {} to {}, {}", counted(files, "file"), folder.path.display(), bytes(size)));
    }
    for (table, path) in events.into_iter().chain(tables.into_iter().map(|(table, _)| table)).zip(given) {
        let size = table.finish()?;
        print(&format!("wrote {}, {}", path.display(), bytes(size)));
    }
    Ok(())
}

fn source(program: Program<'_>, arguments: &Arguments) -> Result<Source, Failure> {
    let path = Path::new(&arguments.scene);
    if Existing::is_recording(path) {
        if !arguments.set.is_empty() {
            return Err(Failure::Input("--set is for scenes: a recording is exported as it was made".to_owned()));
        }
        let recorded = program.recorded(path)?;
        let (simulation, last) = (recorded.start()?, recorded.last());
        return Ok(Source { run: Run::new(simulation, Some(last)), last, recorded: Some(recorded) });
    }
    let overrides = Overrides { set: arguments.set.clone(), ..Overrides::default() };
    let subject = program.subject(&arguments.scene, &overrides)?;
    if let Some(scene) = subject.scene() {
        expense::announce(scene, None)?;
    }
    let schema = subject.schema();
    warnings(&schema).iter().for_each(|line| say(line));
    let last = schema.steps;
    let simulation = subject.experiment(None).start().map_err(Failure::Input)?;
    Ok(Source { run: Run::new(simulation, Some(last)), last, recorded: None })
}

/// The output folder.
struct Folder<'a> {
    path: &'a Path,
    stem: String,
    format: Format,
}

impl Folder<'_> {
    fn file(&self, step: u64) -> PathBuf {
        self.path.join(format!("{}-{step:06}.{}", self.stem, self.format.name()))
    }

    /// Creates the folder. Fails if it would have to replace files that this program did not write, or one of `inputs`.
    fn prepare(&self, is_wanted: impl Fn(u64) -> bool, inputs: &[PathBuf]) -> Result<(), Failure> {
        let failed = |what: &str, error: std::io::Error| Failure::folder(what, self.path, &error);
        fs::create_dir_all(self.path).map_err(|error| failed("create", error))?;
        for entry in fs::read_dir(self.path).map_err(|error| failed("read", error))? {
            let path = entry.map_err(|error| failed("read", error))?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let step = name.strip_prefix(&self.stem).and_then(|rest| rest.strip_prefix('-'));
            let step = step.and_then(|rest| rest.strip_suffix(&format!(".{}", self.format.name())));
            let step = step.and_then(|digits| digits.parse().ok());
            let refuse = |why: &str| {
                let path = path.display();
                Err(Failure::Input(format!("{path} {why} and is not replaced: choose another folder")))
            };
            if !step.is_some_and(&is_wanted) {
                continue;
            }
            if !is_ours(&path) {
                return refuse("was not written by meldscope");
            }
            if inputs.iter().any(|input| is_same_file(&path, input)) {
                return refuse("is a mesh of the scene");
            }
        }
        Ok(())
    }

    /// Writes a file atomically; returns its size [bytes].
    fn write(&self, step: u64, parts: &[parts::Part]) -> Result<u64, Failure> {
        let path = self.file(step);
        let failed = |error| {
            Failure::Run(format!("cannot write {}: {error}; {}", path.display(), atomic::remedy(&path, &error)))
        };
        if path.symlink_metadata().is_ok() && !is_ours(&path) {
            let path = path.display();
            return Err(Failure::Run(format!("{path} was not written by meldscope and is not replaced")));
        }
        let written = || {
            let mut file = BufWriter::new(AtomicFile::create(&path)?);
            self.format.write(parts, &mut file)?;
            file.into_inner().map_err(std::io::IntoInnerError::into_error)?.commit()
        };
        written().map_err(failed)
    }
}

/// The files of the meshes of a scene file, whose text is `source`; of another scene, files that need not exist.
fn mesh_files(scene: &Path, source: &str) -> Vec<PathBuf> {
    let text: toml::Table = source.parse().unwrap_or_default();
    let tables = text.get("mesh").and_then(toml::Value::as_array).into_iter().flatten();
    let names = tables.filter_map(|table| table.get("file")?.as_str());
    names.map(|name| scene.with_file_name(name)).collect()
}

/// Whether a file was written by this command, or is empty.
fn is_ours(path: &Path) -> bool {
    path.symlink_metadata().is_ok_and(|metadata| metadata.is_file()) && is_marked(path, GENERATOR).unwrap_or(false)
}
