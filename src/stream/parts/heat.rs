//! The colours of displacements: a texture that the displacement view maps onto surfaces, and its colour scale.
//!
//! The displacement of a vertex is its texture coordinate. The colour range can thus follow the data: only the texture
//! is logged again when a displacement exceeds its range.

use crate::sdk::{
    self, AnyValues, Image, Points2D,
    components::{ImageBuffer, ImageFormat},
};
use crate::stream::{
    blueprint::Mapping,
    chunks::Chunks,
    contract::{HEAT_FORMAT, HEAT_PLACES, HEAT_TEXTURE, LEGEND},
    light,
    palette::{self, color},
};

/// Visualizer sources of surfaces in the displacement view, instead of their own colours and normals.
pub const MAPPINGS: [Mapping; 4] = [
    Mapping { target: "Mesh3D:vertex_texcoords", source: HEAT_PLACES.0 },
    Mapping { target: "Mesh3D:albedo_texture_buffer", source: HEAT_TEXTURE.0 },
    Mapping { target: "Mesh3D:albedo_texture_format", source: HEAT_FORMAT.0 },
    light::NO_LIGHT,
];

/// Texels of the colour range.
const WIDTH: usize = 256;
/// Displacement at the end of the texture [radii]. A texture coordinate is the root of the fraction of it, so that
/// small displacements are resolved too.
const END: f32 = 16.0;
/// Possible ends of the colour range [radii].
const RANGES: [f64; 14] = [0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 0.8, 1.0, 2.0, 4.0, 8.0, 16.0];

/// The texture coordinates of a displacement [radii]. The viewer repeats textures, so this one is mirrored in its
/// second half, to have the same colour at both ends.
pub fn place(displacement: f32) -> [f32; 2] {
    [0.5 * (displacement / END).sqrt().min(1.0), 0.5]
}

/// The colour range, and the surfaces that use it.
#[derive(Debug)]
pub struct Heat {
    surfaces: Vec<String>,
    range: usize,
}

impl Heat {
    /// Logs the smallest range.
    pub fn new(surfaces: Vec<String>, chunks: &mut Chunks) -> Heat {
        let heat = Heat { surfaces, range: 0 };
        heat.log(chunks);
        heat
    }

    /// Extends the range to a displacement [radii].
    pub fn add(&mut self, displacement: f64, chunks: &mut Chunks) {
        let before = self.range;
        while displacement > RANGES[self.range] && self.range + 1 < RANGES.len() {
            self.range += 1;
        }
        if self.range > before {
            self.log(chunks);
        }
    }

    fn log(&self, chunks: &mut Chunks) {
        let range = RANGES[self.range];
        let texels = (0..WIDTH).chain((0..WIDTH).rev()).flat_map(|i| {
            let share = (i as f64 + 0.5) / WIDTH as f64;
            palette::heat(f64::from(END) * share * share / range)
        });
        let texture = AnyValues::default()
            .with_component::<ImageBuffer>(HEAT_TEXTURE.0, [ImageBuffer::from(texels.collect::<Vec<u8>>())])
            .with_component::<ImageFormat>(HEAT_FORMAT.0, [ImageFormat::rgb8([2 * WIDTH as u32, 1])]);
        for surface in &self.surfaces {
            chunks.log_static(surface, &texture);
        }
        const HEIGHT: usize = 10;
        let row: Vec<u8> = (0..WIDTH).flat_map(|i| palette::heat((i as f64 + 0.5) / WIDTH as f64)).collect();
        let bar = Image::from_rgb24(row.repeat(HEIGHT), [WIDTH as u32, HEIGHT as u32]);
        chunks.log_static(&LEGEND.of(&["bar"]), &bar);
        let ticks = [0.0, 0.25, 0.5, 0.75, 1.0];
        let digits = if range < 0.1 { 4 } else { 3 };
        let labels = ticks.map(|share| {
            let text = format!("{:.digits$}", share * range);
            text.trim_end_matches('0').trim_end_matches('.').to_owned()
        });
        let ticks = Points2D::new(ticks.map(|share| [(share * WIDTH as f64) as f32, HEIGHT as f32]))
            .with_labels(labels)
            .with_radii([sdk::Radius::new_ui_points(2.0)])
            .with_colors([color(palette::DOT)])
            .with_show_labels(true);
        chunks.log_static(&LEGEND.of(&["ticks"]), &ticks);
    }
}
