//! Colours from the palette of Okabe and Ito, distinguishable with any colour vision, for use on a dark background.

/// Red, green, blue.
pub type Rgb = [u8; 3];

/// Okabe and Ito's orange.
pub const ORANGE: Rgb = [0xE6, 0x9F, 0x00];
/// Okabe and Ito's sky blue.
pub const SKY_BLUE: Rgb = [0x56, 0xB4, 0xE9];
/// Okabe and Ito's bluish green.
pub const GREEN: Rgb = [0x00, 0x9E, 0x73];
/// Okabe and Ito's yellow.
pub const YELLOW: Rgb = [0xF0, 0xE4, 0x42];
/// Okabe and Ito's vermilion.
pub const VERMILION: Rgb = [0xD5, 0x5E, 0x00];
/// A clear purple: Okabe and Ito's is nearly pink.
pub const PURPLE: Rgb = [0xA0, 0x70, 0xE8];
/// A lighter variant of Okabe and Ito's blue.
pub const BLUE: Rgb = [0x3D, 0x8B, 0xD9];
/// A yellowish green.
pub const LIME: Rgb = [0xB4, 0xD4, 0x4A];
/// A pale red.
pub const PINK: Rgb = [0xE8, 0xA0, 0x9A];
/// A clear magenta.
pub const MAGENTA: Rgb = [0xE0, 0x52, 0xC2];
/// A light brown.
pub const BROWN: Rgb = [0xBC, 0x8A, 0x5F];
/// A light grey.
pub const SILVER: Rgb = [0x9A, 0xA4, 0xB0];
/// Nearly white.
pub const WHITE: Rgb = [0xF4, 0xF4, 0xF4];
/// A dark grey.
pub const GREY: Rgb = [0x6A, 0x72, 0x7C];

/// A colour as `#rrggbb`.
pub fn hex([r, g, b]: Rgb) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

/// The common name of one of these colours; empty for any other colour.
pub fn name(rgb: Rgb) -> &'static str {
    match rgb {
        ORANGE => "orange",
        SKY_BLUE => "light blue",
        BLUE => "blue",
        GREEN => "green",
        YELLOW => "yellow",
        VERMILION => "red-orange",
        PURPLE => "purple",
        LIME => "lime",
        PINK => "pink",
        BROWN => "brown",
        MAGENTA => "magenta",
        SILVER => "light grey",
        GREY => "grey",
        WHITE => "white",
        _ => "",
    }
}
