//! Simulates two bodies that merge and split, and prints each event at its exact time.
//!
//! ```sh
//! cargo run --release --no-default-features --example world
//! ```

use meldscope::{Scene, World};

const SCENE: &str = r#"
duration = 6.0

[[body]]
name = "still"
radius = 1.0
motion = { fixed = [0, 0, 0] }

[[body]]
name = "passing"
radius = 0.8
motion = { line = { from = [2.6, 0, 0], velocity = [-0.8, 0, 0] } }
"#;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut world = World::new(Scene::parse(SCENE, "example")?)?;
    for event in world.run(world.scene().steps())? {
        println!("{} at {:.9} s, q = {:.6}", event.name(), event.time, event.q);
    }
    Ok(())
}
