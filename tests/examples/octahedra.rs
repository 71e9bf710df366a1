//! Records a simulation that shares nothing with this crate's own: octahedra with forces, phases and thresholds of their
//! own. The viewer shows `octahedra.rrd` with the same tabs as a run of `meldscope`.
//!
//! ```sh
//! cargo run --release --example octahedra
//! ```

#[path = "../suite/octahedra.rs"]
mod octahedra;

use meldscope::stream::{self, Settings, sinks::Destinations};
use octahedra::Octahedra;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let octahedra = Octahedra::two(3.0);
    let destinations = Destinations { save: Some("octahedra.rrd".into()), ..Destinations::default() };
    let frames = stream::record(&octahedra, Settings::of(&octahedra), &destinations)?;
    println!("saved octahedra.rrd: {frames} frames; open it with `rerun octahedra.rrd`");
    Ok(())
}
