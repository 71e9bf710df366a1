//! `meldscope diff`: compares two recordings of a scene.

use std::path::PathBuf;

use super::{
    Failure, announce, may_print, may_save, print,
    progress::{Progress, Work},
    sink_failure, vector,
};
use crate::{
    models,
    recording::{contents::Contents, diff, existing::Existing},
    text::{bytes, counted, thousands},
};

/// Upper limit on listed bodies or events; the rest are counted.
const LISTED: usize = 8;

#[derive(clap::Args)]
pub struct Arguments {
    /// A recording of the scene.
    #[arg(value_name = "A.rrd")]
    first: PathBuf,
    /// Another recording of it, made with a different integrator, step size or version of the program.
    #[arg(value_name = "B.rrd")]
    second: PathBuf,
    /// Record both side by side, with arrows between corresponding vertices and their distances.
    #[arg(long, value_name = "D.rrd")]
    save: Option<PathBuf>,
    /// The recording to take from each file that holds several: the name of its scene, or its id.
    #[arg(long = "recording", value_name = "NAME")]
    name: Option<String>,
    /// Ignore differences up to this, in radii [default: the larger tolerance of the two scenes].
    #[arg(long, value_name = "R", value_parser = parse_radii)]
    within: Option<f64>,
}

fn parse_radii(text: &str) -> Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|number| (0.0..=1e15).contains(number));
    number.ok_or_else(|| "expected a number of radii, from 0 to 1e15".to_owned())
}

/// Compares two recordings. The exit status is 0 if no difference exceeds the tolerance, 1 otherwise.
pub fn diff(arguments: Arguments) -> Result<(), Failure> {
    [&arguments.first, &arguments.second].into_iter().try_for_each(|path| may_print(path))?;
    let open = |path| {
        let contents = Contents::read(path)?;
        let name = arguments.name.as_deref().filter(|_| contents.names().len() > 1);
        contents.only(name, &models::read)
    };
    let (a, b) = (open(&arguments.first)?, open(&arguments.second)?);
    let tolerance = arguments.within.unwrap_or_else(|| a.schema.tolerance.max(b.schema.tolerance));
    if let Some(save) = &arguments.save {
        let what = "one of the recordings to be compared";
        may_save(save, &[(&arguments.first, what), (&arguments.second, what)], &Existing::comparison())?;
        announce(save, &Existing::comparison())?;
    }
    let progress = Progress::new("comparing", Work::Uncounted);
    let difference = diff::diff([&a, &b], tolerance)?;
    drop(progress);
    let (first, second) = (a.path.display(), b.path.display());
    for (recorded, again) in [&a, &b].into_iter().zip(difference.run_again) {
        let again = if again { "; recorded without surfaces, so it was run again" } else { "" };
        print(&format!(
            "{}: {}, {} of {} s with {}, by meldscope {}{again}",
            recorded.path.display(),
            recorded.schema.name,
            counted(recorded.last(), "step"),
            recorded.schema.dt,
            recorded.schema.integrator,
            recorded.version,
        ));
    }
    if a.schema.source != b.schema.source {
        print("the texts of the two scenes differ");
    }
    match difference.first_bits {
        Some(step) => print(&format!("bits: different from step {step} (t = {:.6} s) on", step as f64 * a.schema.dt)),
        None if difference.has_bits => print("bits: the same at every common step"),
        None => {}
    }
    if difference.instants < 2 {
        return Err(Failure::Input(format!(
            "{first} and {second} have {} in common: record them with step sizes of which one is a multiple of the other",
            if difference.instants == 0 { "no instant" } else { "one instant" }
        )));
    }
    print(&format!("{} instants in common, tolerance {tolerance:e} radii", thousands(difference.instants)));
    for worst in difference.bodies.iter().take(LISTED) {
        print(&format!(
            "  body \"{}\": up to {:.3e} radii, vertex {} at t = {:.6} s (step {})",
            worst.body, worst.difference, worst.vertex, worst.time, worst.step
        ));
    }
    match difference.bodies.len() {
        0 => print("  no body differs"),
        n if n > LISTED => print(&format!("  … and {} that differ less", counted((n - LISTED) as u64, "body"))),
        _ => {}
    }
    if let Some(worst) = &difference.first_beyond {
        print(&format!(
            "first beyond tolerance: step {} (t = {:.6} s), body \"{}\", vertex {}: {} and {}, from the centre: {:.3e} radii \
             apart",
            worst.step,
            worst.time,
            worst.body,
            worst.vertex,
            vector(worst.recorded),
            vector(worst.found),
            worst.difference
        ));
    }
    if difference.events.is_empty() {
        print("events: the same");
    }
    for change in difference.events.iter().take(LISTED) {
        print(&format!("event {change}"));
    }
    if difference.events.len() > LISTED {
        print(&format!("… and {}", counted((difference.events.len() - LISTED) as u64, "more event")));
    }
    if let Some(surfaces) = &difference.surfaces {
        if surfaces.is_empty() {
            print("surfaces: gap, overlap, neck, volume, area and topology are the same within the tolerance");
        }
        for deviation in surfaces.iter().take(LISTED) {
            print(&format!("surfaces: {deviation}"));
        }
        if surfaces.len() > LISTED {
            print(&format!("… and {}", counted((surfaces.len() - LISTED) as u64, "more difference")));
        }
    }
    if let Some(save) = &arguments.save {
        let saved = diff::save([&a, &b], &difference, tolerance, save)?;
        if let Some(saved) = saved.map_err(sink_failure)? {
            print(&format!("saved {}: {}", saved.path.display(), bytes(saved.bytes)));
        }
    }
    let has_surfaces = difference.surfaces.iter().flatten().next().is_some();
    match (&difference.first_beyond, difference.events.is_empty(), has_surfaces) {
        (None, true, false) => Ok(()),
        _ => Err(Failure::Run(format!("{first} and {second} differ"))),
    }
}
