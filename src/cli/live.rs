//! `meldscope live`: sliders beside the viewer.

use std::{
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use super::{
    Failure, interrupt, load,
    overrides::Overrides,
    print_always,
    program::{Program, Subject},
    run, say,
};
use crate::{
    atomic,
    live::{self, Live, change::Problem},
    observe::Experiment,
    scene::{Scene, template::Override},
    stream::sinks::Serve,
};

/// A watched file is checked at this interval.
const CHECK_INTERVAL: Duration = Duration::from_millis(200);

#[derive(clap::Args)]
pub(super) struct Arguments {
    /// A scene file, or the name of a built-in scene.
    #[arg(value_name = "SCENE")]
    scene: String,
    /// Where the page saves recordings, and scenes beside them; files that exist are kept [default: NAME-live.rrd].
    #[arg(long, value_name = "FILE")]
    save: Option<PathBuf>,
    /// Update the page whenever the scene file changes.
    #[arg(long)]
    watch: bool,
    /// The address to listen on, or a name of this machine, and the port of the page [9090], 0 for any free one. At any but this
    /// machine's own, others who know the page's address can use it.
    #[arg(long, value_name = "HOST[:PORT]", default_value = "127.0.0.1")]
    bind: Serve,
    /// Another value for a key of the scene, such as influence.merge_at=1.1; may be repeated.
    #[arg(long, value_name = "KEY=VALUE", value_parser = Override::parse)]
    set: Vec<Override>,
}

/// Set to interrupt the run of an outdated change.
static OUTDATED: AtomicBool = AtomicBool::new(false);

fn experiment(scene: Scene) -> Arc<dyn Experiment> {
    Subject::Scene(Box::new(scene)).experiment(Some(&OUTDATED))
}

pub(super) fn live(program: Program<'_>, arguments: Arguments) -> Result<(), Failure> {
    let path = Path::new(&arguments.scene);
    if arguments.watch && !matches!(program, Program::Scenes) {
        return Err(Failure::Input("--watch is for scene files".to_owned()));
    }
    if arguments.watch && !path.is_file() {
        return Err(Failure::Input(format!("--watch needs a scene file, and there is no file {:?}", arguments.scene)));
    }
    let text = if arguments.watch { std::fs::read_to_string(path).unwrap_or_default() } else { String::new() };
    let mut file = run::Watched::new(text);
    // what is saved has these values in its text
    let overridden = |scene: Scene| {
        let invalid = |error| Failure::Input(format!("--set: {error}"));
        let scene =
            scene.with_files(&arguments.set, &arguments.scene, load::folder(&arguments.scene)).map_err(invalid)?;
        load::supported(scene, &arguments.scene, None)?.rewritten(&arguments.scene).map_err(invalid)
    };
    let first = match program {
        Program::Scenes => experiment(overridden(load::scene(&arguments.scene)?)?),
        Program::Own(_) => {
            let overrides = Overrides { set: arguments.set.clone(), ..Overrides::default() };
            program.subject(&arguments.scene, &overrides)?.experiment(None)
        }
    };
    let name = path.file_stem().map_or(first.schema().name, |stem| stem.to_string_lossy().into_owned());
    let save = arguments.save.unwrap_or_else(|| PathBuf::from(format!("{name}-live.rrd")));
    if save.extension().is_none_or(|extension| extension != "rrd") {
        let named = save.with_extension("rrd");
        return Err(Failure::Input(format!(
            "--save {}: not the name of a recording, such as {}",
            save.display(),
            named.display()
        )));
    }
    if let Some(remedy) = atomic::missing_folder(&save) {
        return Err(Failure::Input(format!("--save: {remedy}")));
    }
    let is_loopback = arguments.bind.bind.is_loopback();
    interrupt::raise_stop()?;
    let options = live::Options { serve: arguments.bind, save, interrupt: &OUTDATED };
    let live = Live::start(first, options)?;
    print_always(&live.address);
    say("Open this address in a browser. Ctrl-C ends.");
    if !is_loopback {
        say("Whoever has this address can change the scene, and save files here; nothing is encrypted.");
    }
    let mut reported = String::new();
    while !interrupt::STOP.load(Ordering::Relaxed) {
        std::thread::sleep(CHECK_INTERVAL);
        let Some(changed) = arguments.watch.then(|| file.changed(path)).flatten() else { continue };
        match changed.and_then(|scene| overridden(scene).map_err(|failure| failure.to_string())) {
            Ok(scene) => {
                reported.clear();
                live.replace(experiment(scene));
            }
            Err(why) if why == reported => (),
            Err(why) => {
                reported.clone_from(&why);
                live.report(Problem::new(why));
            }
        }
    }
    Ok(())
}
