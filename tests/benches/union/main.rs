//! The union compared with an independent one, `manifold-rust`: speed, and any number of random scenes.
//!
//! ```text
//! cargo bench --bench union                      # speed, with ratios
//! cargo bench --bench union -- fuzz 100000       # 100,000 scenes, from number 0
//! cargo bench --bench union -- fuzz 1000 5000    # 1,000 scenes, from number 5,000
//! ```

mod fuzz;
mod scenes;
mod speed;

use std::time::{Duration, Instant};

fn main() {
    // cargo adds --bench
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    let number = |index: usize| arguments.get(index).and_then(|argument| argument.parse::<u64>().ok());
    if arguments.first().map(String::as_str) != Some("fuzz") {
        speed::print();
        return;
    }
    let (count, first) = (number(1).unwrap_or(1000), number(2).unwrap_or(0));
    std::panic::set_hook(Box::new(|_| ())); // panics are counted instead of printed
    let mut reported = Instant::now();
    let tallies = fuzz::run(first..first + count, Duration::MAX, |number, tallies| {
        if reported.elapsed() > Duration::from_secs(60) {
            reported = Instant::now();
            println!("up to scene {number}:");
            fuzz::print(tallies);
        }
    });
    if fuzz::print(&tallies) > 0 {
        std::process::exit(1);
    }
}
