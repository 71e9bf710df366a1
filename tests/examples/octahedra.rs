//! A program of its own for a simulation that shares nothing with this crate's: octahedra with forces, phases and
//! thresholds of their own. The viewer shows `octahedra.rrd` with the same tabs as a run of `meldscope`.
//!
//! ```sh
//! cargo run --release --example octahedra -- run octahedra
//! cargo run --release --example octahedra -- replay octahedra.rrd
//! ```

#[path = "../suite/octahedra.rs"]
mod octahedra;

use std::{process::ExitCode, sync::Arc};

use meldscope::cli;
use octahedra::Octahedra;

fn main() -> ExitCode {
    cli::run(std::env::args_os(), |name| match name {
        "octahedra" => Ok(Arc::new(Octahedra::two(3.0))),
        _ => Err("there is octahedra only".to_owned()),
    })
}
