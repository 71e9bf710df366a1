//! Colours of everything that the schema gives no colour, in the viewer's types; see
//! [`colors`](crate::observe::colors).

use rerun::{Color, Rgba32};

pub use crate::observe::colors::Rgb;
use crate::observe::colors::{BLUE, GREEN, GREY, ORANGE, PURPLE, SILVER, SKY_BLUE, VERMILION};

/// Background colour of 3D views.
pub const BACKGROUND: Rgb = [0x10, 0x13, 0x18];

/// Colour of an influence sphere that reaches no other body.
pub const IDLE_SPHERE: Rgb = GREY;

/// The same for batched scenes, darker, as many spheres would hide everything else.
pub const IDLE_SPHERE_OF_MANY: Rgb = [0x26, 0x2B, 0x33];

/// Colour of resting bodies in a batched scene.
pub const RESTING: Rgb = GREY;

/// Colours of q lines, in order. None is a threshold colour; all are legible on dark and light backgrounds.
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

/// Colours of plot lines without other meaning, in order.
pub fn line(index: usize) -> Rgb {
    [SKY_BLUE, ORANGE, GREEN, VERMILION, PURPLE, SILVER, BLUE][index % 7]
}

/// Converts a colour to the viewer's type.
pub fn color([r, g, b]: Rgb) -> Color {
    Color::from_rgb(r, g, b)
}

/// Translucent colour of surfaces, so that their inside is visible.
pub fn translucent([r, g, b]: Rgb) -> Rgba32 {
    Rgba32::from_unmultiplied_rgba(r, g, b, 150)
}

/// Opaque colour of surfaces without visible inside: thousands of them are drawn twice as fast as translucent ones.
pub fn opaque([r, g, b]: Rgb) -> Rgba32 {
    Rgba32::from_rgb(r, g, b)
}

/// Almost transparent colour of surfaces in views of arrows.
pub fn sheer([r, g, b]: Rgb) -> Rgba32 {
    Rgba32::from_unmultiplied_rgba(r, g, b, 70)
}

/// Packed colour of a fraction from 0 to 1: viridis, which increases monotonically in lightness and is legible with any
/// colour vision.
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
    // NaN is drawn like the maximum
    let stop = if place.is_nan() { STOPS.len() - 2 } else { (place as usize).min(STOPS.len() - 2) };
    let rest = if place.is_nan() { 1.0 } else { place - stop as f64 };
    let [r, g, b] = std::array::from_fn(|i| (STOPS[stop][i] + rest * (STOPS[stop + 1][i] - STOPS[stop][i])) as u8);
    color([r, g, b]).to_u32()
}
