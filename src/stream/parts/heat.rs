//! The colours of displacements: a texture that the view of displacements lays over surfaces, and its scale.
//!
//! A vertex has its displacement as a texture coordinate, so that the range of colours can follow the data: it is that of
//! the texture, which is logged again when a displacement exceeds it.

use rerun::{
    AnyValues, ComponentDescriptor, Image, Points2D,
    components::{ImageBuffer, ImageFormat},
};

use crate::stream::{
    blueprint::Mapping,
    chunks::Chunks,
    light,
    palette::{self, color},
};

/// The entity of the scale of colours.
pub const LEGEND: &str = "/legend";
/// The component of a surface that has its displacements as texture coordinates.
const PLACES: &str = "heat_texcoords";
/// The components of a surface that have the texture.
const TEXTURE: &str = "heat_texture";
const FORMAT: &str = "heat_format";

/// What the view of displacements draws surfaces by, instead of their own colours and normals.
pub const MAPPINGS: [Mapping; 4] = [
    Mapping { target: "Mesh3D:vertex_texcoords", source: PLACES },
    Mapping { target: "Mesh3D:albedo_texture_buffer", source: TEXTURE },
    Mapping { target: "Mesh3D:albedo_texture_format", source: FORMAT },
    light::NO_LIGHT,
];

/// Texels of the range of colours.
const WIDTH: usize = 256;
/// The displacement at the end of the texture [radii]; a texture coordinate is the root of the share of it, so that small
/// displacements have many texels, too.
const END: f32 = 16.0;
/// Ends of the range of colours [radii].
const RANGES: [f64; 14] = [0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 0.8, 1.0, 2.0, 4.0, 8.0, 16.0];

/// The component with texture coordinates.
pub fn descriptor() -> ComponentDescriptor {
    ComponentDescriptor::partial(PLACES)
}

/// The texture coordinates of a displacement [radii]. The viewer repeats textures: this one goes back in its second half,
/// so that its ends do not meet in another colour.
pub fn place(displacement: f32) -> [f32; 2] {
    [0.5 * (displacement / END).sqrt().min(1.0), 0.5]
}

/// The range of colours, and the surfaces that have it.
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

    /// Takes note of a displacement [radii].
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
            .with_component::<ImageBuffer>(TEXTURE, [ImageBuffer::from(texels.collect::<Vec<u8>>())])
            .with_component::<ImageFormat>(FORMAT, [ImageFormat::rgb8([2 * WIDTH as u32, 1])]);
        for surface in &self.surfaces {
            chunks.log_static(surface, &texture);
        }
        const HEIGHT: usize = 10;
        let row: Vec<u8> = (0..WIDTH).flat_map(|i| palette::heat((i as f64 + 0.5) / WIDTH as f64)).collect();
        let bar = Image::from_rgb24(row.repeat(HEIGHT), [WIDTH as u32, HEIGHT as u32]);
        chunks.log_static(&format!("{LEGEND}/bar"), &bar);
        let ticks = [0.0, 0.25, 0.5, 0.75, 1.0];
        let digits = if range < 0.1 { 4 } else { 3 };
        let labels = ticks.map(|share| {
            let text = format!("{:.digits$}", share * range);
            text.trim_end_matches('0').trim_end_matches('.').to_owned()
        });
        let ticks = Points2D::new(ticks.map(|share| [(share * WIDTH as f64) as f32, HEIGHT as f32]))
            .with_labels(labels)
            .with_radii([rerun::Radius::new_ui_points(2.0)])
            .with_colors([color(palette::DOT)])
            .with_show_labels(true);
        chunks.log_static(&format!("{LEGEND}/ticks"), &ticks);
    }
}
