//! `meldscope sweep`: runs a scene at every point of a grid over its parameters.

use std::{
    collections::HashMap,
    io::{self, Write as _},
    path::{Path, PathBuf},
    time::Instant,
};

use super::{
    Failure,
    interrupt::{self, STOP},
    is_marked, load, print,
    program::Program,
    progress::{Progress, Work},
    say,
};
use crate::{
    models,
    recording::{Recorded, existing::Existing},
    scene::template::{Setting, Template},
    stream::settings::application,
    sweep::{
        Sweep,
        bisect::{self, Threshold},
        builtin,
        classes::FAILED,
        design::{Axis, Design, MOST_LEVELS, Sampling},
        file::duration,
        level::{self, Ended, LevelError, Plan},
        map::{self, Map},
        picture,
        refine::Known,
        row::{Cell, Row, columns},
        run::Runner,
        store::{Shard, Store, StoreError},
        svg, table,
    },
    table::may_replace,
    text::{self, bytes, counted, did_you_mean, significant, thousands},
};

#[derive(clap::Args)]
pub struct Arguments {
    /// A sweep file, or the name of a built-in sweep: speed_merge_at, speed_offset, alpha_split_at, size_mass,
    /// runs_of_two.
    #[arg(value_name = "SWEEP.toml")]
    sweep: String,
    /// The folder of the rows and maps. An interrupted sweep is resumed from it.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Refine the grid N times where neighbours differ in outcome, or by a [jump]. Each level halves their distance. A region
    /// smaller than a first cell may be missed.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(..=i64::from(MOST_LEVELS)))]
    refine: u32,
    /// Find the changes of outcome along this axis, to 1e-9, where neighbours of the grid differ: KEY of an [[axis]], or
    /// its name. An even number of changes between two neighbours shows in none of them.
    #[arg(long, value_name = "AXIS", conflicts_with_all = ["shard", "open"])]
    bisect: Option<String>,
    /// Run only part I, from 0, of N equal parts of a level. Processes share only the folder.
    #[arg(long, value_name = "I/N", requires = "level", value_parser = parse_shard)]
    shard: Option<Shard>,
    /// The level to run, from 0, whose predecessors are complete.
    #[arg(long, value_name = "L", requires = "shard", value_parser = clap::value_parser!(u32).range(..=i64::from(MOST_LEVELS)))]
    level: Option<u32>,
    /// Record the run of a row to DIR/row-ROW.rrd, and compare its checksum.
    #[arg(long, value_name = "ROW", conflicts_with_all = ["shard", "refine"])]
    open: Option<u64>,
}

fn parse_shard(text: &str) -> Result<Shard, String> {
    let parts = text.split_once('/').and_then(|(index, count)| Some((index.parse().ok()?, count.parse().ok()?)));
    match parts {
        Some((index, count)) if index < count && count <= 1_000_000 => Ok(Shard { index, count }),
        _ => Err("expected I/N, such as 0/8, with I from 0 to N - 1".to_owned()),
    }
}

impl From<StoreError> for Failure {
    fn from(error: StoreError) -> Failure {
        match error {
            StoreError::Other { .. } | StoreError::Taken { .. } => Failure::Input(error.to_string()),
            _ => Failure::Run(error.to_string()),
        }
    }
}

impl From<LevelError> for Failure {
    fn from(error: LevelError) -> Failure {
        match error {
            LevelError::Store(error) => error.into(),
            LevelError::Incomplete { .. } => Failure::Input(error.to_string()),
        }
    }
}

/// Runs a sweep, or the part of it that the options select.
pub fn sweep(program: Program<'_>, arguments: Arguments) -> Result<(), Failure> {
    let sweep = match (program, builtin::named(&arguments.sweep)) {
        (Program::Own(find), _) => Sweep::load_own(Path::new(&arguments.sweep), find),
        (Program::Scenes, Some(builtin)) => Sweep::parse(builtin.text, builtin.name, None),
        (Program::Scenes, None) => {
            load::file("sweep", &arguments.sweep, &builtin::ALL.map(|builtin| builtin.name), "")?;
            Sweep::load(Path::new(&arguments.sweep))
        }
    };
    let sweep = sweep.map_err(Failure::input)?;
    if arguments.refine > 0 || arguments.bisect.is_some() {
        if sweep.design.sampling != Sampling::Grid {
            return Err(Failure::Input(
                "--refine and --bisect are for grids: leave sample out of the sweep".to_owned(),
            ));
        }
        let most = sweep.design.most_levels();
        if arguments.refine > most {
            return Err(Failure::Input(format!(
                "--refine {} has more points than can be counted: the maximum is {most}",
                arguments.refine
            )));
        }
    }
    let template = match &sweep.experiment {
        Some(_) if arguments.open.is_some() => {
            return Err(Failure::Input(format!(
                "--open is for scenes: record a run with `{} run {} --set KEY=VALUE`",
                text::program(),
                sweep.scene_file
            )));
        }
        Some(_) => None,
        None => Some(sweep.template().map_err(Failure::input)?),
    };
    if let Some(template) = &template {
        models::need_oscillators(template.base(), "a sweep").map_err(Failure::input)?;
        if let Some(moved) = template.base().placement_warning() {
            say(&format!("warning: {moved}")); // rows that place such a body differently may be the same run
        }
    }
    if let Some(invalid) = &sweep.invalid {
        say(&format!("warning: {invalid}; such runs fail"));
    }
    let axis = arguments.bisect.as_ref().map(|name| axis_to_bisect(&sweep.design, name)).transpose()?;
    for (number, divided) in sweep.design.axes.iter().enumerate() {
        if divided.is_range() && arguments.refine > 0 {
            may_take(&sweep, template.as_ref(), number, divided.value(arguments.refine, 1), "--refine")?;
        }
        if axis == Some(number) {
            may_take(&sweep, template.as_ref(), number, divided.at(ANYWHERE), "--bisect")?;
        }
    }
    if arguments.out.exists() && !arguments.out.is_dir() {
        return Err(Failure::Input(format!("--out {} is not a folder: choose another name", arguments.out.display())));
    }
    may_draw(&arguments.out)?;
    if let Some(axis) = axis {
        let path = arguments.out.join(thresholds_file(axis));
        may_replace(&path, &bisect::columns(&sweep.design)).map_err(Failure::input)?;
    }
    let store = || Store::open(&arguments.out, &sweep, columns(&sweep));
    if let Some(row) = arguments.open {
        if !arguments.out.join("sweep.toml").exists() {
            return Err(Failure::Input(format!("{} has no row {row}: run the sweep first", arguments.out.display())));
        }
        return open(&sweep, &store()?, row); // the run listens for Ctrl-C itself
    }
    interrupt::raise_stop()?;
    let store = store()?;
    // shapes stay cached as long as they are referenced
    let base = template.iter().flat_map(|template| &template.base().bodies);
    let _shapes: Vec<_> = base.map(|body| body.shape.mesh()).collect();
    let runner = Runner::new(&sweep, template.as_ref(), Some(&STOP));
    let running = RunningSweep { runner, sweep: &sweep, store: &store, start: Instant::now() };
    if let (Some(shard), Some(level)) = (arguments.shard, arguments.level) {
        let mut known = Known::new(&sweep, arguments.refine);
        let plan = level::plan(&store, &sweep, &mut known, level)?;
        if plan.is_empty() {
            let refine = arguments.refine;
            let by = if level > refine { format!(" with --refine {refine}") } else { String::new() };
            print(&format!("level {level}: complete, nothing is left to refine{by}"));
            return Ok(());
        }
        print(&format!(
            "level {level}: {}, {} of them in shard {}/{}",
            counted(plan.len(), "row"),
            thousands(plan.row_count(shard)),
            shard.index,
            shard.count
        ));
        return running.level(level, &plan, shard);
    }

    let mut known = Known::new(&sweep, arguments.refine);
    let mut plan = level::plan(&store, &sweep, &mut known, 0)?;
    let (mut total, mut levels) = (0, 0);
    for level in 0.. {
        running.level(level, &plan, Shard::ALL)?;
        (total, levels) = (total + plan.len(), level + 1);
        if arguments.refine == 0 {
            break;
        }
        known.add(level::given(&store, &sweep, level)?);
        plan = Plan::List(known.wanted());
        if plan.is_empty() {
            break;
        }
    }
    running.summarize(total, levels, arguments.refine)?;
    let mut drawn = running.draw(&[], &arguments.sweep)?;
    if let Some(axis) = axis {
        let thresholds = running.bisect(axis)?;
        drawn = running.draw(&thresholds, &arguments.sweep)?;
    }
    drawn.into_iter().for_each(|line| print(&line));
    Ok(())
}

/// The axis with this key or name.
fn axis_to_bisect(design: &Design, name: &str) -> Result<usize, Failure> {
    let axis = design.axes.iter().position(|axis| axis.key.to_string() == name || axis.name.as_deref() == Some(name));
    axis.filter(|&axis| design.axes[axis].is_number()).ok_or_else(|| {
        let axes = design.axes.iter().filter(|axis| axis.is_number());
        let keys: Vec<String> = axes.map(|axis| axis.key.to_string()).collect();
        let hint = did_you_mean(name, keys.iter().map(String::as_str));
        Failure::Input(format!(
            "--bisect {name}: no axis of numbers has this key or name{hint} (such axes: {})",
            if keys.is_empty() { "none".to_owned() } else { keys.join(", ") }
        ))
    })
}

/// A fraction of a range that lies on no grid.
const ANYWHERE: f64 = 0.381_966_011_250_105;

/// Checks that values of an axis between those of the grid are valid, by one of them, with the first or the last values
/// of the other axes.
fn may_take(
    sweep: &Sweep,
    template: Option<&Template<'_>>,
    axis: usize,
    value: Setting,
    option: &str,
) -> Result<(), Failure> {
    let axes = &sweep.design.axes;
    let with_others = |is_last: bool| {
        let end = |axis: &Axis| axis.sample(if is_last { axis.sample_count() - 1 } else { 0 });
        let mut point: Vec<Setting> = axes.iter().map(end).collect();
        point[axis] = value.clone();
        match template {
            Some(template) => template.scene(sweep.settings(&point)).err().map(|error| error.message),
            None => sweep.own(&point).and_then(Result::err).map(|invalid| invalid.text),
        }
    };
    with_others(false).filter(|_| with_others(true).is_some()).map_or(Ok(()), |invalid| {
        let key = &axes[axis].key;
        Err(Failure::Input(format!(
            "{option} needs values between those of the axis {key}, and {value} is invalid: {invalid}"
        )))
    })
}

fn thresholds_file(axis: usize) -> String {
    format!("thresholds-{axis}.parquet")
}

/// Checks that the maps replace no file of the user.
fn may_draw(folder: &Path) -> Result<(), Failure> {
    let recording = folder.join(MAP_RECORDING);
    // that of a scene called "map" has a kind
    let is_map = || {
        Existing::at(&recording).is_some_and(|there| there.application == application("map") && there.kind.is_none())
    };
    if recording.symlink_metadata().is_ok() && !is_map() {
        return Err(not_replaced(&recording));
    }
    may_write(&folder.join(MAP), MARK)
}

/// Checks that a file is missing, empty, or has this mark near its beginning.
fn may_write(path: &Path, mark: &str) -> Result<(), Failure> {
    match is_marked(path, mark) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        Ok(true) => Ok(()),
        _ => Err(not_replaced(path)),
    }
}

fn not_replaced(path: &Path) -> Failure {
    Failure::Input(format!("{} was not written by a sweep and is not replaced: choose another folder", path.display()))
}

/// The map as a diagram, which has this mark, and as a recording.
const MAP: &str = "map.svg";
const MARK: &str = "; meldscope ";
const MAP_RECORDING: &str = "map.rrd";

/// A running sweep.
struct RunningSweep<'a> {
    runner: Runner<'a>,
    sweep: &'a Sweep,
    store: &'a Store,
    start: Instant,
}

impl RunningSweep<'_> {
    /// Runs a shard of a level; does not return if interrupted.
    fn level(&self, level: u32, plan: &Plan, shard: Shard) -> Result<(), Failure> {
        let progress = Progress::new(format!("level {level}"), Work::Units("run", Some(plan.row_count(shard))));
        let ended = level::run(&self.runner, self.store, (level, plan, shard), &STOP, &|rows| progress.add(rows));
        drop(progress);
        match ended? {
            Ended::Complete => Ok(()),
            Ended::Interrupted => self.interrupted(),
        }
    }

    fn interrupted(&self) -> ! {
        let path = self.store.path().display();
        say(&format!("interrupted: {path} contains every finished run; the same command resumes"));
        interrupt::exit()
    }

    /// Prints a summary of the rows of the first levels.
    fn summarize(&self, rows: u64, levels: u32, refine: u32) -> Result<(), Failure> {
        let (mut counts, mut steps, mut seconds) = ([0u64; FAILED as usize + 1], 0, 0.0);
        let classes = &self.sweep.classes;
        let mut failure = None;
        let columns = self.store.named(&["outcome", "steps", "run_time", "failure"]);
        self.store.read(0..levels, None, &columns, |(row, cells)| {
            counts[usize::from(classes.of(cells.first()))] += 1;
            if let [_, Cell::Integer(of_row), Cell::Float(time), why] = &cells[..] {
                (steps, seconds) = (steps + of_row, seconds + time);
                if let Cell::Text(why) = why {
                    failure.get_or_insert((row, why.clone()));
                }
            }
        })?;
        let design = &self.sweep.design;
        let full = design.size(refine).filter(|_| refine > 0);
        let of_full = full.map_or(String::new(), |full| {
            format!(", {} % of a grid as fine as the last level", significant(100.0 * rows as f64 / full as f64))
        });
        print(&format!(
            "{}: {}{of_full}; {}; run times add up to {}",
            self.sweep.file,
            counted(rows, "run"),
            counted(steps as u64, "step"),
            duration(seconds)
        ));
        let counts = (0..=FAILED).zip(counts).filter(|(_, count)| *count > 0);
        let counts: Vec<String> =
            counts.map(|(class, count)| format!("{} {}", classes.name(class), thousands(count))).collect();
        print(&format!("outcomes: {}", counts.join(", ")));
        if let Some((row, why)) = failure {
            print(&format!("the first run that failed is row {row}: {why}"));
        }
        print(&format!(
            "rows: {}/rows-*.parquet, after {}",
            self.store.path().display(),
            duration(self.start.elapsed().as_secs_f64())
        ));
        Ok(())
    }

    /// Draws the map, with thresholds, and says where it is. `name` is the sweep's on the command line.
    fn draw(&self, thresholds: &[Threshold], name: &str) -> Result<Vec<String>, Failure> {
        let Some(map) = Map::new(self.sweep, self.store, thresholds)? else { return Ok(Vec::new()) };
        let first = self.sweep.text.lines().next().and_then(|line| line.strip_prefix('#')).unwrap_or(&self.sweep.file);
        let about = format!(
            "{}, {} {}{MARK}{}\n{}",
            counted(map.rows, "run"),
            if self.sweep.experiment.is_none() { "scene" } else { "experiment" },
            self.sweep.scene_file,
            env!("CARGO_PKG_VERSION"),
            map::missable(&self.sweep.design)
        );
        let drawn = svg::svg(&map, first.trim(), &about);
        let path = self.store.write(MAP, |to| to.write_all(drawn.as_bytes()))?;
        let recording = self.store.path().join(MAP_RECORDING);
        let open = format!("{} sweep {name} --out {} --open ROW", text::program(), self.store.path().display());
        picture::save(&map, self.sweep, self.store, first.trim(), &open, &recording)
            .map_err(|error| Failure::Run(error.to_string()))?;
        let size = bytes(drawn.len() as u64);
        let where_to = format!("map: {}, {size}, and for the viewer {}", path.display(), recording.display());
        Ok(vec![where_to, format!("note: {}", map::missable(&self.sweep.design))])
    }

    /// Finds the thresholds along an axis.
    fn bisect(&self, axis: usize) -> Result<Vec<Threshold>, Failure> {
        let design = &self.sweep.design;
        let mut classes: HashMap<u64, u8> = HashMap::new();
        self.store.read(0..1, None, &self.store.named(&["outcome"]), |(row, cells)| {
            classes.insert(row, self.sweep.classes.of(cells.first()));
        })?;
        let progress = Progress::new("searching", Work::Units("threshold", None));
        let outcome = |index: &[u64]| classes.get(&design.row(0, index)).copied();
        let found = bisect::thresholds(&self.runner, design, axis, &outcome, &STOP, &|more| progress.add(more));
        drop(progress);
        let Some(found) = found else {
            say("the search for thresholds was not finished: it begins anew next time");
            self.interrupted()
        };
        let rows = bisect::rows(&found, &self.sweep.classes);
        let path = self.store.write(&thresholds_file(axis), |to| table::write(&bisect::columns(design), &rows, to))?;
        const LISTED: usize = 20;
        for Threshold { point, bracket: [low, high], classes: [below, above], .. } in found.iter().take(LISTED) {
            let others = design.axes.iter().zip(point).enumerate().filter(|(index, _)| *index != axis);
            let others: Vec<String> = others.map(|(_, (axis, value))| format!("{} = {value}", axis.key)).collect();
            let at = if others.is_empty() { String::new() } else { format!("{}: ", others.join(", ")) };
            print(&format!(
                "{at}{} changes to {} at {} = {:?}",
                self.sweep.classes.name(*below),
                self.sweep.classes.name(*above),
                design.axes[axis].key,
                0.5 * (low + high)
            ));
        }
        if found.len() > LISTED {
            print(&format!("… and {} more", thousands((found.len() - LISTED) as u64)));
        }
        print(&format!("{} to 1e-9: {}", counted(found.len() as u64, "threshold"), path.display()));
        print(
            "note: searched between neighbours of the grid that differ in outcome: two changes between neighbours of the \
             same outcome are not found, and of three only one; a finer grid separates them",
        );
        Ok(found)
    }
}

/// Records the run of a row.
fn open(sweep: &Sweep, store: &Store, row: u64) -> Result<(), Failure> {
    let template = sweep.template().map_err(Failure::input)?;
    let mut known: Option<Row> = None;
    let (mut count, mut last) = (0, 0);
    let columns = store.named(&["outcome", "steps", "checksum"]);
    store.read(0..u32::MAX, None, &columns, |found| {
        (count, last) = (count + 1, last.max(found.0));
        if found.0 == row {
            known = Some(found);
        }
    })?;
    let Some(((_, cells), point)) = known.and_then(|known| Some((known, sweep.design.point(row)?))) else {
        let why = if count == 0 {
            "run the sweep first".to_owned()
        } else {
            format!("it has {}, the last is {last}", counted(count, "row"))
        };
        return Err(Failure::Input(format!("{} has no row {row}: {why}", store.path().display())));
    };
    let [outcome, Cell::Integer(steps), Cell::Count(checksum)] = &cells[..] else {
        return Err(Failure::Run(format!("row {row} has no checksum")));
    };
    if *steps == 0 {
        return Err(Failure::Run(format!("row {row} failed before its first step: there is nothing to record")));
    }
    let text = template.text(sweep.settings(&point)).map_err(Failure::input)?;
    let values = sweep.design.axes.iter().zip(&point).map(|(axis, value)| format!("{} = {value}", axis.key));
    let about = values.collect::<Vec<_>>().join(", ");
    let (scene, mark) = (format!("row-{row}.toml"), format!("# Row {row} of "));
    may_write(&store.path().join(&scene), &mark)?;
    let scene = store.write(&scene, |to| write!(to, "{mark}{}: {about}\n{text}", sweep.file))?;
    let recording = store.path().join(format!("row-{row}.rrd"));
    let outcome = if let Cell::Text(outcome) = outcome { outcome.as_str() } else { "failed" };
    print(&format!("row {row}: {about}; {outcome} after {}", counted(*steps as u64, "step")));
    super::record(&scene, &recording, *steps as u64)?;
    let recorded = Recorded::open(&recording).map_err(Failure::input)?;
    match recorded.checksum(*steps as u64) {
        Some(found) if found == *checksum => {
            print(&format!("checksum {found:016x}: the same as in the table"));
            Ok(())
        }
        Some(found) => Err(Failure::Run(format!(
            "checksum {found:016x}, but the table has {checksum:016x}: it was made by another version"
        ))),
        None => Err(Failure::Run(format!("the recording ends before step {steps}"))),
    }
}
