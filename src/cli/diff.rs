//! `meldscope diff`: compares two recordings of a scene.

use std::path::PathBuf;

use super::{
    Failure, may_print, may_save, print, print_lines,
    program::Program,
    progress::{Progress, Work},
    say_note,
};
use crate::{
    recording::{diff, existing::Existing},
    stream::settings::Frames,
    text::{bytes, counted},
};

#[derive(clap::Args)]
pub struct Arguments {
    /// A recording of the scene; of a file that holds several, one by its name: A.rrd/NAME.
    #[arg(value_name = "A.rrd")]
    first: PathBuf,
    /// Another recording of it, made with a different integrator, step size or version of the program.
    #[arg(value_name = "B.rrd")]
    second: PathBuf,
    /// Record the first, coloured by how much the second differs, with arrows to its vertices and plots of both.
    #[arg(long, value_name = "D.rrd")]
    save: Option<PathBuf>,
    /// Ignore differences up to this, in radii [default: the larger tolerance of the two scenes].
    #[arg(long, value_name = "R", value_parser = parse_radii)]
    within: Option<f64>,
}

fn parse_radii(text: &str) -> Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|number| (0.0..=1e15).contains(number));
    number.ok_or_else(|| "expected a number of radii, from 0 to 1e15".to_owned())
}

/// Compares two recordings. The exit status is 0 if no difference exceeds the tolerance, 1 otherwise.
pub fn diff(program: Program<'_>, arguments: Arguments) -> Result<(), Failure> {
    let (a, b) = (program.recorded(&arguments.first)?, program.recorded(&arguments.second)?);
    [&a, &b].into_iter().try_for_each(|recorded| may_print(&recorded.path))?;
    let tolerance = arguments.within.unwrap_or_else(|| a.schema.tolerance.max(b.schema.tolerance));
    let what = "one of the recordings to be compared";
    let may_save = |save: &PathBuf| may_save(save, &[(&a.path, what), (&b.path, what)], &Existing::comparison());
    let note = arguments.save.as_ref().map(may_save).transpose()?.flatten();
    let progress = Progress::new("comparing", Work::Uncounted);
    let difference = diff::diff([&a, &b], tolerance)?;
    drop(progress);
    let (first, second) = (a.path.display(), b.path.display());
    for ([recorded, other], again) in [[&a, &b], [&b, &a]].into_iter().zip(difference.run_again) {
        let again = match again {
            true if recorded.settings.frames != Frames::Thin => {
                "; cut short before its frames were complete, so it was run again"
            }
            true => "; recorded without surfaces, so it was run again",
            false => "",
        };
        print(&format!(
            "{}: {}, {} of {} s{}{}, by meldscope {}{again}",
            recorded.path.display(),
            recorded.schema.name,
            counted(recorded.last(), "step"),
            recorded.schema.dt,
            recorded.schema.method(),
            recorded.overridden_beside(other),
            recorded.version,
        ));
    }
    if a.schema.source != b.schema.source {
        print("the texts of the two scenes differ");
    }
    print_lines(&difference.to_string());
    if difference.instants < 2 {
        let remedy = match a.schema.dt == b.schema.dt {
            true if a.last() == 0 || b.last() == 0 => "there is no step to compare: record more of them",
            true => "they have too few frames of the same steps, or one was cut short: record it again",
            false => "record them with step sizes of which one is a multiple of the other",
        };
        return Err(Failure::Input(format!(
            "{first} and {second} have {} in common: {remedy}",
            if difference.instants == 0 { "no instant" } else { "one instant" }
        )));
    }
    if let Some(save) = &arguments.save {
        let saved = diff::save([&a, &b], &difference, tolerance, save)??;
        say_note(note);
        if let Some(saved) = saved {
            print(&format!("saved {}: {}", saved.path.display(), bytes(saved.bytes)));
        }
    }
    let has_surfaces = difference.surfaces.iter().flatten().next().is_some();
    let has_events = !(difference.events.is_empty() && difference.starts.is_empty());
    match (&difference.first_beyond, has_events, has_surfaces) {
        (None, false, false) => {
            if difference.first_bits.is_some() || !difference.bodies.is_empty() {
                print(&format!("no difference exceeds {tolerance:e} radii"));
            }
            Ok(())
        }
        _ => Err(Failure::Run(format!("{first} and {second} differ"))),
    }
}
