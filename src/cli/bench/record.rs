//! `meldscope bench record`.

use std::path::PathBuf;

use super::{super::run::scene, Failure, Progress, WRITTEN, Work, claim, print, write};
use crate::{
    Scene,
    bench::{
        goals,
        machine::Machine,
        record::{self, Report, csv::csv, scenes::crowd, table},
    },
    models,
    sim::memory,
};

/// The scenes to measure by default.
const SCENES: [&str; 2] = ["two", "crowd"];
const CROWD: u32 = 1000;

#[derive(clap::Args)]
pub struct Arguments {
    /// Scene files, or names of built-in scenes [default: two, crowd and a crowd of 1000, and also the slow-down of
    /// steps by saving, and the cost of checksums and replays].
    scene: Vec<String>,
    /// Also measure a crowd of this many bodies.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    crowd: Option<u32>,
    /// Write the scene of that crowd to a file, for `meldscope run`, and measure nothing.
    #[arg(long, value_name = "F.toml", requires = "crowd", conflicts_with_all = ["scene", "csv", "folder"])]
    write: Option<PathBuf>,
    /// Write frame rates and sizes to a CSV file.
    #[arg(long, value_name = "F.csv")]
    csv: Option<PathBuf>,
    /// Folder for recordings while they are measured [default: the system's temporary folder].
    #[arg(long, value_name = "DIR")]
    folder: Option<PathBuf>,
}

pub fn record(arguments: Arguments) -> Result<(), Failure> {
    if let (Some(path), Some(bodies)) = (&arguments.write, arguments.crowd) {
        return write(claim(Some(path), WRITTEN)?, || Ok(format!("{WRITTEN} record`.\n{}", crowd(bodies as usize))));
    }
    let has_all = arguments.scene.is_empty() && arguments.crowd.is_none();
    let named = if has_all { SCENES.map(str::to_owned).to_vec() } else { arguments.scene };
    let mut scenes = named.iter().map(|name| scene(name)).collect::<Result<Vec<_>, _>>()?;
    if let Some(bodies) = arguments.crowd.or(has_all.then_some(CROWD)) {
        scenes.push(Scene::parse(&crowd(bodies as usize), "crowd").map_err(Failure::input)?);
    }
    for scene in &scenes {
        memory::check(scene).map_err(Failure::input)?;
        models::need_oscillators(scene, "bench record").map_err(Failure::input)?;
    }
    let csv_file = claim(arguments.csv.as_deref(), "scene,bodies,detail,")?;
    let machine = Machine::detect();
    let folder = arguments.folder.unwrap_or_else(std::env::temp_dir);
    let mut report = Report::default();
    for scene in &scenes {
        let progress = Progress::new(format!("measuring {}", scene.name), Work::Uncounted);
        let measured = record::measure(scene, &folder).map_err(Failure::Run)?;
        drop(progress);
        print(&format!("{}\n", table::table(&measured)));
        report.measurements.extend(measured);
    }
    if has_all {
        let progress = Progress::new("measuring checksums and replays", Work::Uncounted);
        let costs = record::measure_costs(&folder).map_err(Failure::Run)?;
        drop(progress);
        print(&format!("{}\n", table::costs(&costs)));
        report.costs = Some(costs);
    }
    print(&format!("{}\n", goals::table(&record::goals::goals(&report))));
    print(&machine.at_full_load().to_string());
    write(csv_file, || csv(&report.measurements, &machine))
}
