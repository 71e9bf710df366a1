//! `meldscope bench scale`.

use std::time::Duration;

use super::{Failure, Files, Progress, Work, print, write};
use crate::bench::{
    MeasureError, goals,
    machine::Machine,
    scale::{self, Settings, csv::csv, diagram, table},
};

#[derive(clap::Args)]
pub struct Arguments {
    /// Numbers of bodies, each from 2 to a million.
    #[arg(long, value_name = "N", num_args = 1.., default_values = ["2", "10", "100", "1000", "10000", "100000"],
          value_parser = clap::value_parser!(u32).range(2..=1_000_000))]
    bodies: Vec<u32>,
    /// Seconds of timed steps per combination of body count, scene family, and one core or all.
    #[arg(long, value_name = "S", default_value = "0.5", value_parser = parse_seconds)]
    seconds: f64,
    #[command(flatten)]
    files: Files,
}

fn parse_seconds(text: &str) -> Result<f64, String> {
    let seconds: f64 = text.parse().map_err(|_| "expected a number of seconds".to_owned())?;
    if (0.001..=60.0).contains(&seconds) { Ok(seconds) } else { Err("expected 0.001 to 60 seconds".to_owned()) }
}

pub fn scale(arguments: Arguments) -> Result<(), Failure> {
    let [csv_file, svg_file] = arguments.files.claim("family,bodies,touching_bodies,", "Cost and size")?;
    let mut bodies: Vec<usize> = arguments.bodies.iter().map(|&n| n as usize).collect();
    bodies.sort_unstable();
    bodies.dedup();
    let time = Duration::from_secs_f64(arguments.seconds);
    let decay = Settings::default().decay.min((2e6 * arguments.seconds) as u64);
    let settings = Settings { bodies, time, decay };

    let machine = Machine::detect();
    let progress = Progress::new("measuring scenes of all sizes", Work::Share);
    let measured = scale::measure(&settings, &mut |share| progress.set_share(share));
    drop(progress);
    let report = measured.map_err(|error| match error {
        MeasureError::TooLarge(_) => Failure::input(error),
        error => Failure::Run(error.to_string()),
    })?;
    print(&table::table(&report));
    print("");
    print(&goals::table(&scale::goals::goals(&report)));
    print("");
    print(&table::footer(&report, &machine));

    write(csv_file, || csv(&report, &machine))?;
    write(svg_file, || diagram::svg(&report, &machine))
}
