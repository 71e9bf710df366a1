use meldscope::{Scene, World};
use std::time::Instant;
fn main() {
    let name = std::env::args().nth(1).unwrap_or("two".into());
    let mode = std::env::args().nth(2).unwrap_or_default();
    for _ in 0..5 {
        let mut world = World::new(Scene::builtin(&name).unwrap()).unwrap();
        let n = world.scene().steps();
        let (mut step, mut hash, mut x) = (0.0, 0.0, 0u64);
        for _ in 0..n {
            let t = Instant::now();
            world.step();
            step += t.elapsed().as_secs_f64();
            if mode != "plain" {
                let t = Instant::now();
                x ^= world.checksum();
                hash += t.elapsed().as_secs_f64();
            }
        }
        println!("{name}: step {:.3} ms, hash {:.3} ms, {:.2} % {x:x}", step * 1e3, hash * 1e3, 100.0 * hash / step);
    }
}
