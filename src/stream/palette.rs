//! Colours of what has none of its own, as the viewer takes them; see [`colors`](crate::observe::colors).

use rerun::{Color, Rgba32};

pub use crate::observe::colors::Rgb;
use crate::observe::colors::{BLUE, GREEN, GREY, ORANGE, PURPLE, SILVER, SKY_BLUE, VERMILION};

/// Behind the bodies.
pub const BACKGROUND: Rgb = [0x10, 0x13, 0x18];

/// Colour of an influence sphere that reaches nobody.
pub const IDLE_SPHERE: Rgb = GREY;

/// The same where there are so many that they would hide what happens.
pub const IDLE_SPHERE_OF_MANY: Rgb = [0x26, 0x2B, 0x33];

/// Colour of bodies that rest in a batch.
pub const RESTING: Rgb = GREY;

/// Colours of the lines of q, in order: none is that of a threshold, all can be read on a dark and on a light page.
pub fn distance(index: usize) -> Rgb {
    [SILVER, GREEN, VERMILION, BLUE][index % 4]
}

/// Muted colours of bodies, so that arrows and spheres stand out against them.
pub fn body(index: usize) -> Rgb {
    const BODIES: [Rgb; 8] = [
        [0x5B, 0x84, 0xB1],
        [0xB5, 0x8A, 0x5A],
        [0x6F, 0x9E, 0x7B],
        [0x9C, 0x77, 0xA6],
        [0xA8, 0x9F, 0x5F],
        [0x5F, 0x9D, 0xA3],
        [0xB0, 0x74, 0x70],
        [0x8A, 0x8F, 0x98],
    ];
    BODIES[index % BODIES.len()]
}

/// Colours of the lines of a plot without other meaning, in order.
pub fn line(index: usize) -> Rgb {
    [SKY_BLUE, ORANGE, GREEN, VERMILION, PURPLE, SILVER, BLUE][index % 7]
}

/// For the viewer.
pub fn color([r, g, b]: Rgb) -> Color {
    Color::from_rgb(r, g, b)
}

/// For surfaces, so that what is inside them shows.
pub fn translucent([r, g, b]: Rgb) -> Rgba32 {
    Rgba32::from_unmultiplied_rgba(r, g, b, 150)
}

/// For surfaces in which there is nothing to see: thousands of them are drawn twice as fast as translucent ones.
pub fn opaque([r, g, b]: Rgb) -> Rgba32 {
    Rgba32::from_rgb(r, g, b)
}

/// For surfaces that only show where arrows are.
pub fn sheer([r, g, b]: Rgb) -> Rgba32 {
    Rgba32::from_unmultiplied_rgba(r, g, b, 70)
}

/// The colour of a share from 0 to 1, packed: viridis, which gets lighter all the way and which readers with any colour
/// vision can read.
pub fn heat(share: f64) -> u32 {
    const STOPS: [[f64; 3]; 6] = [
        [72.0, 32.0, 112.0],
        [65.0, 68.0, 135.0],
        [42.0, 120.0, 142.0],
        [34.0, 168.0, 132.0],
        [122.0, 209.0, 81.0],
        [253.0, 231.0, 37.0],
    ];
    let place = share.clamp(0.0, 1.0) * (STOPS.len() - 1) as f64;
    // NaN is as far as it gets
    let stop = if place.is_nan() { STOPS.len() - 2 } else { (place as usize).min(STOPS.len() - 2) };
    let rest = if place.is_nan() { 1.0 } else { place - stop as f64 };
    let [r, g, b] = std::array::from_fn(|i| (STOPS[stop][i] + rest * (STOPS[stop + 1][i] - STOPS[stop][i])) as u8);
    color([r, g, b]).to_u32()
}
