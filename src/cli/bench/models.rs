//! `meldscope bench models`.

use std::path::{Path, PathBuf};

use super::{
    super::{announce, may_save, run::scene},
    Failure, Files, Progress, Work, print, write,
};
use crate::{
    Scene,
    bench::{
        machine::Machine,
        models::{self, csv, footer, svg, table},
    },
    models::side_by_side::SideBySide,
    observe::Experiment as _,
    recording::existing::{Existing, Kind},
    scene::Model,
    sim::Options,
    stream::{self, Settings, settings::application, sinks::Destinations},
    text::counted,
};

#[derive(clap::Args)]
pub struct Arguments {
    /// Scene files, or names of built-in scenes (see `meldscope scenes`).
    #[arg(default_values = ["two"])]
    scene: Vec<String>,
    /// Record all models of the first scene side by side, aligned in time.
    #[arg(long, value_name = "F.rrd")]
    save: Option<PathBuf>,
    #[command(flatten)]
    files: Files,
}

pub fn models(arguments: Arguments) -> Result<(), Failure> {
    let scenes = arguments.scene.iter().map(|name| scene(name)).collect::<Result<Vec<_>, _>>()?;
    let [csv_file, svg_file] = arguments.files.claim("scene,model,dt_s,", "Models: work and precision")?;
    if let (Some(path), [first, ..]) = (&arguments.save, scenes.as_slice()) {
        record(first, path)?;
    }
    let machine = Machine::detect();
    let mut reports = Vec::new();
    for scene in &scenes {
        let progress = Progress::new(format!("measuring {}", scene.name), Work::Share);
        let report = models::measure(scene, &Model::ALL, &mut |share| progress.set_share(share));
        drop(progress);
        print(&format!("{}\n", table(&report)));
        reports.push(report);
    }
    print(&footer(&machine));
    write(csv_file, || csv(&reports, &machine))?;
    write(svg_file, || svg(&reports, &machine))
}

/// Records all models that can run a scene.
fn record(scene: &Scene, path: &Path) -> Result<(), Failure> {
    let all = SideBySide::all(scene, Options::default());
    let schema = all.schema();
    let new = Existing { application: application(&schema.name), kind: Some(Kind::Run) };
    may_save(path, &[], &new)?;
    announce(path, &new)?;
    let destinations = Destinations { save: Some(path.to_owned()), ..Destinations::default() };
    let settings = Settings::for_bodies(schema.bodies.len(), schema.steps);
    let _progress = Progress::new("recording all models", Work::Uncounted).with_file(path);
    let frames = stream::record(&all, settings, &destinations).map_err(|error| Failure::Run(error.to_string()))?;
    let names = schema.model.replace('+', ", ");
    print(&format!("saved {}: {}, {}\n", path.display(), counted(frames, "frame"), names));
    Ok(())
}
