//! The command line: one file a subcommand.
//!
//! Results go to standard output, everything else to standard error. Exit status: 0 done; 1 the run failed or what
//! was checked differs; 2 bad input or usage.

mod bench;
mod check;
mod diff;
mod replay;
mod run;
mod scenes;

use std::{fmt, io::Write, process::ExitCode};

use clap::{
    Parser, Subcommand,
    builder::{PossibleValuesParser, TypedValueParser},
};

use crate::recording::read::expects_panics;

/// A visual debugger for soft bodies that merge and split.
///
/// Steps the simulation and streams meshes, influence spheres, force vectors, pair phases and frame timings to the
/// Rerun viewer or to an .rrd file.
#[derive(Parser)]
#[command(name = "meldscope", version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Simulate a scene and record it.
    Run(Box<run::Arguments>),
    /// Run what a recording holds again, and verify it step by step.
    Replay(replay::Arguments),
    /// Run scripted scenes and compare them with their golden recordings.
    Check(check::Arguments),
    /// Compare two recordings of a scene, run in two ways.
    Diff(diff::Arguments),
    /// List the scenes that come with the program, and what to look at in each.
    Scenes,
    /// Measure: error against run time, cost against size, what recording costs, what integrators endure.
    Bench(bench::Arguments),
}

/// How a command ended badly.
#[derive(Debug)]
enum Failure {
    /// The run failed, or what was checked differs: exit status 1.
    Run(String),
    /// Bad input or usage: exit status 2.
    Input(String),
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (Failure::Run(message) | Failure::Input(message)) = self;
        f.write_str(message)
    }
}

impl Failure {
    fn input(error: impl fmt::Display) -> Failure {
        Failure::Input(error.to_string())
    }
}

/// The program.
pub fn main() -> ExitCode {
    // A damaged recording is an error with a line of its own, even where the decoder panics over it.
    let usual = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        if !expects_panics() {
            usual(panic)
        }
    }));
    // Prints help and usage errors itself, and exits with 0 or 2.
    let arguments = Arguments::parse();
    let result = match arguments.command {
        Command::Run(arguments) => run::run(*arguments),
        Command::Scenes => {
            scenes::list();
            Ok(())
        }
        Command::Replay(arguments) => replay::replay(arguments),
        Command::Check(arguments) => check::check(arguments),
        Command::Diff(arguments) => diff::diff(arguments),
        Command::Bench(arguments) => bench::bench(arguments),
    };
    let (status, message) = match result {
        Ok(()) => return ExitCode::SUCCESS,
        Err(Failure::Run(message)) => (1, message),
        Err(Failure::Input(message)) => (2, message),
    };
    say(&format!("error: {message}"));
    ExitCode::from(status)
}

/// A line on standard output. A reader that went away is no error: there is nobody left to tell.
fn print(line: &str) {
    let _ = writeln!(std::io::stdout(), "{line}");
}

/// A line on standard error.
fn say(line: &str) {
    let _ = writeln!(std::io::stderr(), "{line}");
}

/// An argument that is one of these by its name; the help lists them.
fn one_of<T: Copy + Send + Sync + 'static>(
    all: &'static [T],
    name: fn(T) -> &'static str,
) -> impl TypedValueParser<Value = T> {
    let names = PossibleValuesParser::new(all.iter().map(|&one| name(one)));
    names.try_map(move |text| all.iter().copied().find(|&one| name(one) == text).ok_or("there is none of that name"))
}

/// Whether two paths lead to one file.
fn same_file(a: &std::path::Path, b: &std::path::Path) -> bool {
    match (std::fs::canonicalize(a), std::fs::canonicalize(b)) {
        (Ok(a), Ok(b)) => a == b,
        _ => false,
    }
}

/// A vector in full.
fn vector(v: glam::DVec3) -> String {
    format!("({:?}, {:?}, {:?})", v.x, v.y, v.z)
}
