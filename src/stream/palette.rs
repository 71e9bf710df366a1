//! Colours of everything without a colour in the schema, in the viewer's types; see [`colors`](crate::colors).

pub use crate::colors::Rgb;
use crate::sdk::{Color, Rgba32};
use crate::{
    colors::{BLUE, BROWN, GREEN, GREY, LIME, MAGENTA, ORANGE, PURPLE, SILVER, SKY_BLUE, VERMILION},
    observe::{Schema, surface::VertexOrigin},
};

/// Background colour of 3D views.
pub const BACKGROUND: Rgb = [0x10, 0x13, 0x18];

/// Colour of an influence sphere that reaches no other body.
pub const IDLE_SPHERE: Rgb = GREY;

/// Colour of the lines along which surfaces meet.
pub const SEAM: Rgb = [0xE8, 0xEA, 0xEE];

/// Colour of an influence sphere that reaches no other body among more than a few: dark, because many bright spheres
/// would hide everything else.
pub const IDLE_SPHERE_OF_MANY: Rgb = [0x26, 0x2B, 0x33];

/// Colour of plot lines that are about all bodies together.
pub const BODY_LINE: Rgb = SKY_BLUE;

/// Colour of resting bodies in a batched scene.
pub const RESTING: Rgb = GREY;

/// Colour of the grid on planes.
pub const GRID: Rgb = [0x3A, 0x41, 0x4B];

/// Colour of the grid on the ground.
pub const GROUND: Rgb = [0x24, 0x29, 0x31];

/// Colour of selectable vertices.
pub const DOT: Rgb = [0x8A, 0x92, 0x9C];

/// Colours of q lines, in order: eight that differ from each other and from those of phases, the same paler, and darker.
/// Legible on dark and light backgrounds.
pub fn distance(index: usize) -> Rgb {
    const HUES: [Rgb; 8] = [
        [0x3C, 0xB0, 0x50],
        [0xD8, 0x48, 0x58],
        [0x20, 0xA8, 0xA8],
        [0xD0, 0x58, 0xC0],
        [0xB8, 0xA8, 0x28],
        [0x58, 0x78, 0xE0],
        [0xB0, 0x7A, 0x50],
        [0x98, 0xC8, 0x30],
    ];
    let hue = HUES[index % HUES.len()];
    match index / HUES.len() % 3 {
        0 => hue,
        1 => hue.map(|channel| channel / 2 + 0x70),
        _ => hue.map(|channel| channel / 5 * 3),
    }
}

/// Neutral colours of bodies: hue is for phases and forces.
pub fn body(index: usize) -> Rgb {
    const BODIES: [Rgb; 8] = [
        [0x9B, 0xAA, 0xBD],
        [0xDA, 0xCE, 0xBA],
        [0x82, 0x94, 0x88],
        [0xC9, 0xBC, 0xD2],
        [0x86, 0x80, 0x90],
        [0xB7, 0xC8, 0xBC],
        [0xA4, 0x94, 0x86],
        [0xD6, 0xDA, 0xE0],
    ];
    // the next eight are darker
    let rgb = BODIES[index % BODIES.len()];
    if (index / BODIES.len()).is_multiple_of(2) { rgb } else { rgb.map(|channel| channel / 8 * 5) }
}

/// Colour of a vertex of a merged surface: its body's colour, blended with that of the adjacent body.
pub fn blended(schema: &Schema, origin: &VertexOrigin) -> Rgb {
    let [a, b] = origin.bodies.map(|index| of_body(schema, index as usize));
    if origin.share == 0.0 || a == b {
        return a; // most vertices are far from any seam
    }
    between([a, b], f64::from(origin.share))
}

/// The colour at a fraction of the way from the first to the second.
pub fn between([from, to]: [Rgb; 2], share: f64) -> Rgb {
    let [from, to] = [from, to].map(|rgb| rgb.map(f64::from));
    std::array::from_fn(|i| (from[i] + (to[i] - from[i]) * share).round() as u8)
}

/// The colour of a body: its own, or one of the neutral colours, the same in all variants of the scene.
pub fn of_body(schema: &Schema, index: usize) -> Rgb {
    schema.bodies.get(index).and_then(|of| of.color).unwrap_or_else(|| body(index % schema.variant_size()))
}

/// The colour of a label of something with this colour: lighter, to be read on it and on a dark ground.
pub fn label(rgb: Rgb) -> Rgb {
    rgb.map(|channel| channel / 2 + 0x7F)
}

/// Colours of plot lines without other meaning, in order.
pub fn line(index: usize) -> Rgb {
    const LINES: [Rgb; 10] = [SKY_BLUE, ORANGE, GREEN, VERMILION, PURPLE, SILVER, MAGENTA, LIME, BROWN, BLUE];
    LINES.get(index).copied().unwrap_or_else(|| distance(index - LINES.len()))
}

/// Converts a colour to the viewer's type.
pub fn color([r, g, b]: Rgb) -> Color {
    Color::from_rgb(r, g, b)
}

/// Translucent colour of surfaces, so that their inside is visible.
pub fn translucent([r, g, b]: Rgb) -> Rgba32 {
    Rgba32::from_unmultiplied_rgba(r, g, b, 150)
}

/// Opaque colour of surfaces whose inside is not visible: thousands of them are drawn twice as fast as translucent
/// ones.
pub fn opaque([r, g, b]: Rgb) -> Rgba32 {
    Rgba32::from_rgb(r, g, b)
}

/// Colour of planes: bodies behind them remain visible.
pub fn sheet() -> Rgba32 {
    let [r, g, b] = GREY;
    Rgba32::from_unmultiplied_rgba(r, g, b, 40)
}

/// Almost transparent colour of surfaces in views of arrows.
pub fn sheer([r, g, b]: Rgb) -> Rgba32 {
    Rgba32::from_unmultiplied_rgba(r, g, b, 70)
}

/// The strain at which a spring has its full colour [–].
pub const MAX_STRAIN: f64 = 0.2;

/// Colour of a spring by its strain: blue if shortened, white at rest, red-orange if stretched.
pub fn strain(strain: f64) -> Rgb {
    let end = if strain < 0.0 { BLUE } else { VERMILION };
    let share = (strain.abs() / MAX_STRAIN).min(1.0);
    between([[0xFF; 3], end], share)
}

/// Colour of a fraction from 0 to 1: viridis, which increases monotonically in lightness and is legible with any
/// colour vision.
pub fn heat(share: f64) -> Rgb {
    const STOPS: [[f64; 3]; 6] = [
        [72.0, 32.0, 112.0],
        [65.0, 68.0, 135.0],
        [42.0, 120.0, 142.0],
        [34.0, 168.0, 132.0],
        [122.0, 209.0, 81.0],
        [253.0, 231.0, 37.0],
    ];
    let position = share.clamp(0.0, 1.0) * (STOPS.len() - 1) as f64;
    // NaN is drawn like the maximum
    let stop = if position.is_nan() { STOPS.len() - 2 } else { (position as usize).min(STOPS.len() - 2) };
    let rest = if position.is_nan() { 1.0 } else { position - stop as f64 };
    std::array::from_fn(|i| (STOPS[stop][i] + rest * (STOPS[stop + 1][i] - STOPS[stop][i])) as u8)
}
