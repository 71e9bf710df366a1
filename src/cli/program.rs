//! What the names on a command line stand for: scenes, or the experiments of another program.

use std::{
    path::Path,
    sync::{Arc, atomic::AtomicBool},
};

use super::{
    Failure, load,
    overrides::{self, Overrides},
    say,
};
use crate::{
    models::{self, SceneRun},
    observe::{Experiment, Refusal, Schema, Variation, simulation::FindExperiment},
    recording::{ReadError, Recorded, contents::Contents, recorded::called_as},
    scene::{Scene, template::Override},
    sim::Options,
    stream::settings::file_stem,
    text::did_you_mean,
};

/// The program that a command is part of.
#[derive(Clone, Copy)]
pub(super) enum Program<'a> {
    /// This crate's own, for scenes.
    Scenes,
    /// Another one, for experiments of its own.
    Own(&'a FindExperiment<'a>),
}

/// What a name stands for.
pub(super) enum Subject {
    Scene(Box<Scene>),
    Own(Arc<dyn Experiment>),
}

/// The command line of a program with experiments of its own: theirs, not those of scenes, are the names and words.
pub(super) fn described(command: clap::Command, name: &str) -> clap::Command {
    const NAME: &str = "The name of an experiment";
    let named = |command: clap::Command, argument: &'static str, help: &'static str| {
        command.mut_arg(argument, |argument| argument.value_name("NAME").help(help))
    };
    let without = |command: clap::Command, arguments: &[&'static str]| {
        let hidden = |command: clap::Command, &argument: &&'static str| command.mut_arg(argument, |one| one.hide(true));
        arguments.iter().fold(command, hidden)
    };
    let in_words = |argument: clap::Arg| {
        let is_of_scene = argument.get_id() == "set";
        let help = argument.get_help().map(|help| help.to_string().replace("scene", "experiment"));
        let argument =
            if argument.get_help_heading() == Some("Scene") { argument.help_heading("Experiment") } else { argument };
        match help {
            _ if is_of_scene => argument.help("Another value for a parameter of the experiment; may be repeated"),
            Some(help) => argument.help(help),
            None => argument,
        }
    };
    command
        .mut_subcommands(|command| command.mut_args(in_words))
        .display_name(name.to_owned())
        .about("Records, replays and compares the experiments of this program, in the Rerun viewer.")
        .long_about(None)
        .mut_subcommand("run", |run| {
            without(named(run, "scene", NAME), &["integrator", "model", "watch"])
                .about("Simulate an experiment and record it")
                .mut_arg("on", |on| on.value_name("EVENT,…"))
                .mut_arg("around", |around| {
                    around.help("The event at which a file opens, instead of the first: its kind, pair, number, or a combination")
                })
        })
        .mut_subcommand("live", |live| {
            without(named(live, "scene", NAME), &["watch"])
        })
        .mut_subcommand("replay", |replay| {
            replay
                .about("Simulate a recording's experiment again and verify every step")
        })
        .mut_subcommand("check", |check| {
            check.about("Run experiments and compare them with their golden recordings").mut_arg("paths", |paths| {
                paths.help("Golden recordings NAME.rrd of experiments NAME, or folders of them [default: recordings]")
            })
        })
        .mut_subcommand("explain", |explain| {
            explain.mut_arg("subject", |subject| subject.value_name("F.rrd|NAME").help("A recording, or the name of an experiment"))
        })
        .mut_subcommand("diff", |diff| diff.about("Compare two recordings of the same experiment"))
        .mut_subcommand("sweep", |sweep| {
            without(sweep, &["open"])
                .about("Run an experiment at every point of a grid over its parameters: rows in Parquet, a map")
                .mut_arg("sweep", |sweep| sweep.help("A sweep file, whose key `scene` is the name of an experiment"))
        })
        .mut_subcommand("export", |export| {
            named(export, "scene", "The name of an experiment, or a recording")
        })
}

impl Program<'_> {
    /// What `name` stands for, with these changes.
    pub fn subject(&self, name: &str, overrides: &Overrides) -> Result<Subject, Failure> {
        match self {
            Program::Scenes => Ok(Subject::Scene(Box::new(overrides.apply(load::scene(name)?, name)?))),
            Program::Own(find) => {
                let experiment = find(name).map_err(|why| Failure::Input(unknown(name, &why)))?;
                let recorded = called_as(&experiment.schema().name);
                if recorded != name && find(&recorded).is_err() {
                    return Err(Failure::Input(format!(
                        "the experiment {name:?} would be recorded as {recorded:?}, by which this program does not find \
                         it: let Schema::name be a name that it knows"
                    )));
                }
                let foreign =
                    [("--integrator", overrides.integrator.is_some()), ("--model", overrides.model.is_some())];
                if let Some((option, _)) = foreign.into_iter().find(|&(_, is_used)| is_used) {
                    return Err(Failure::Input(format!("{option} is for scenes: use --set with a parameter")));
                }
                Ok(Subject::Own(vary(experiment, &overrides.set)?))
            }
        }
    }

    /// Opens the only recording of a file, or one of several: `F.rrd/NAME`. Warns if it is cut short.
    pub fn recorded(&self, path: &Path) -> Result<Recorded, ReadError> {
        let contents = Contents::read(path)?;
        let recorded = self.recreate(&contents, contents.only()?)?;
        if let Some(what) = recorded.cut_short() {
            say(&format!("warning: {what}"));
        }
        Ok(recorded)
    }

    /// Opens one of the recordings of a file.
    pub fn recreate(&self, contents: &Contents, index: usize) -> Result<Recorded, ReadError> {
        match self {
            Program::Scenes => contents.recorded(index, &models::read),
            Program::Own(find) => {
                let name = contents.scene(index);
                contents.recorded(index, &|file, text, run| {
                    let kind = find(name).or_else(|why| find(&file_stem(name)).map_err(|_| why));
                    let kind = kind.map_err(|why| Refusal::Run(unknown(name, &why)))?;
                    kind.read(file, text, run)
                })
            }
        }
    }

    /// A recorded experiment with changes.
    pub fn varied(&self, recorded: &Recorded, set: &[Override]) -> Result<Arc<dyn Experiment>, Failure> {
        match self {
            Program::Scenes => overrides::rerun(set, recorded),
            Program::Own(_) => vary(Arc::clone(&recorded.experiment), set),
        }
    }
}

fn unknown(name: &str, why: &str) -> String {
    format!("no experiment {name:?}: {why}")
}

/// An experiment with other values of its parameters.
fn vary(experiment: Arc<dyn Experiment>, set: &[Override]) -> Result<Arc<dyn Experiment>, Failure> {
    if set.is_empty() {
        return Ok(experiment);
    }
    let parameters = experiment.parameters();
    let mut variation = Variation::default();
    for one in set {
        let key = one.key();
        if !parameters.iter().any(|parameter| parameter.key == key) {
            let keys = || parameters.iter().map(|parameter| parameter.key.as_str());
            let (hint, known) = (did_you_mean(key, keys()), keys().collect::<Vec<_>>().join(", "));
            let known = if known.is_empty() { "it has none".to_owned() } else { format!("its parameters are {known}") };
            return Err(Failure::Input(format!("--set: the experiment has no parameter {key:?}{hint} ({known})")));
        }
        let number = one.number().ok_or_else(|| Failure::Input(format!("--set {one}: expected a number")))?;
        variation.values.insert(key.to_owned(), number);
    }
    experiment.varied(&variation).map_err(|error| Failure::Input(format!("--set: {error}")))
}

impl Subject {
    /// Its experiment, which ends when `interrupt` is raised, as soon as it can.
    pub fn experiment(self, interrupt: Option<&'static AtomicBool>) -> Arc<dyn Experiment> {
        match self {
            Subject::Scene(scene) => {
                Arc::new(SceneRun { scene: *scene, options: Options { interrupt, ..Options::default() } })
            }
            Subject::Own(experiment) => experiment,
        }
    }

    /// The scene, if it is one.
    pub fn scene(&self) -> Option<&Scene> {
        match self {
            Subject::Scene(scene) => Some(scene),
            Subject::Own(_) => None,
        }
    }

    /// Its schema.
    pub fn schema(&self) -> Schema {
        match self {
            Subject::Scene(scene) => scene.schema(),
            Subject::Own(experiment) => experiment.schema(),
        }
    }
}
