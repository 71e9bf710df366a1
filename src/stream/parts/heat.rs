//! The colours of displacements: a texture that the displacement view maps onto surfaces, and its colour scale.
//!
//! The displacement of a vertex is its texture coordinate. The colour range can thus follow what is visible in each
//! frame: only the texture is logged again when the range changes.

use glam::DVec3;

use super::FrameView;
use crate::observe::{BodyFrame, schema::BodySchema};
use crate::sdk::{
    self, AnyValues, Image, Points2D, Points3D,
    components::{ImageBuffer, ImageFormat},
};
use crate::stream::{
    blueprint::Mapping,
    chunks::{Chunks, TrackId},
    contract::{HEAT_FORMAT, HEAT_PLACES, HEAT_TEXTURE, LARGEST, LEGEND},
    instant::Instant,
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
/// The range becomes smaller once the largest displacement is below this share of the smaller range: otherwise it would
/// flicker.
const SHRINK: f64 = 0.9;
/// A vertex this close to the centre of another body is hidden by it [radii of that body].
const INSIDE: f64 = 0.95;

/// The texture coordinates of a displacement [radii]. The viewer repeats textures, so this one is mirrored in its
/// second half, to have the same colour at both ends.
pub fn place(displacement: f32) -> [f32; 2] {
    [0.5 * (displacement / END).sqrt().min(1.0), 0.5]
}

/// The colour range, the surfaces that use it, and the mark at the largest displacement.
pub struct Heat {
    surfaces: Vec<String>,
    range: usize,
    mark: TrackId,
    last: Option<(DVec3, String)>,
}

impl Heat {
    /// Logs static data.
    pub fn new(surfaces: Vec<String>, chunks: &mut Chunks) -> Heat {
        let row: Vec<u8> = (0..WIDTH).flat_map(|i| palette::heat((i as f64 + 0.5) / WIDTH as f64)).collect();
        let bar = Image::from_rgb24(row.repeat(HEIGHT), [WIDTH as u32, HEIGHT as u32]);
        chunks.log_static(&LEGEND.of(&["bar"]), &bar);
        let ticks = Points2D::update_fields()
            .with_positions(TICKS.map(|share| [(share * WIDTH as f64) as f32, HEIGHT as f32]))
            .with_radii([sdk::Radius::new_ui_points(2.0)])
            .with_colors([color(palette::DOT)])
            .with_show_labels(true);
        chunks.log_static(&LEGEND.of(&["ticks"]), &ticks);
        let mark = Points3D::update_fields()
            .with_radii([sdk::Radius::new_ui_points(5.0)])
            .with_colors([color(palette::SEAM)])
            .with_show_labels(true);
        chunks.log_static(LARGEST.path, &mark);
        let mark = chunks.track(LARGEST.path, [Points3D::descriptor_positions(), Points3D::descriptor_labels()]);
        Heat { surfaces, range: RANGES.len(), mark, last: None }
    }

    /// Adapts the range to the largest displacement that is visible in a frame, and marks its vertex.
    pub fn log(&mut self, view: FrameView<'_>, chunks: &mut Chunks) {
        let [largest, of_all] = largest(view);
        let displacement = largest.map_or(0.0, |largest| largest.displacement);
        let fits =
            |share: f64| RANGES.iter().position(|range| displacement <= share * range).unwrap_or(RANGES.len() - 1);
        let range = if fits(1.0) > self.range { fits(1.0) } else { fits(SHRINK).min(self.range) };
        if range != self.range {
            self.range = range;
            self.log_range(view.at, chunks);
        }
        let mark = largest.filter(|largest| largest.displacement > 0.0).map(|largest| {
            let hidden = of_all.filter(|of_all| of_all.displacement > largest.displacement);
            let hidden = hidden.map(|hidden| format!("; inside another body: {}", hidden.text(view)));
            (largest.position, format!("largest visible: {}{}", largest.text(view), hidden.unwrap_or_default()))
        });
        if mark != self.last {
            let position: Vec<_> = mark.iter().map(|(position, _)| position.as_vec3().to_array()).collect();
            let label: Vec<_> = mark.iter().map(|(_, label)| label.clone()).collect();
            chunks.push(self.mark, view.at, &[&position, &label]);
            self.last = mark;
        }
    }

    fn log_range(&self, at: Instant, chunks: &mut Chunks) {
        let range = RANGES[self.range];
        let texels = (0..WIDTH).chain((0..WIDTH).rev()).flat_map(|i| {
            let share = (i as f64 + 0.5) / WIDTH as f64;
            palette::heat(f64::from(END) * share * share / range)
        });
        let texture = AnyValues::default()
            .with_component::<ImageBuffer>(HEAT_TEXTURE.0, [ImageBuffer::from(texels.collect::<Vec<u8>>())])
            .with_component::<ImageFormat>(HEAT_FORMAT.0, [ImageFormat::rgb8([2 * WIDTH as u32, 1])]);
        for surface in &self.surfaces {
            chunks.log(surface, at, &texture);
        }
        let digits = if range < 0.1 { 4 } else { 3 };
        let labels = TICKS.map(|share| {
            let text = format!("{:.digits$}", share * range);
            text.trim_end_matches('0').trim_end_matches('.').to_owned()
        });
        chunks.log(&LEGEND.of(&["ticks"]), at, &Points2D::update_fields().with_labels(labels));
    }
}

/// Height of the colour scale [texels].
const HEIGHT: usize = 10;
/// Places of its numbers, as shares of the range.
const TICKS: [f64; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];

/// The vertex with the largest displacement.
#[derive(Clone, Copy)]
struct Largest {
    /// [radii]
    displacement: f64,
    body: usize,
    vertex: usize,
    /// [scene unit]
    position: DVec3,
}

impl Largest {
    fn text(&self, view: FrameView<'_>) -> String {
        format!("{}:{}, {:.3} R", view.schema.bodies[self.body].name, self.vertex, self.displacement)
    }
}

/// The vertex with the largest displacement of those that lie in no other body, and of all.
fn largest(view: FrameView<'_>) -> [Option<Largest>; 2] {
    let (mut visible, mut any): (Option<Largest>, Option<Largest>) = (None, None);
    for (index, (body, now)) in view.bodies().enumerate() {
        let is_larger =
            |length: f64, than: &Option<Largest>| than.is_none_or(|than| length / body.radius > than.displacement);
        if !is_larger(now.max_displacement, &visible) {
            continue;
        }
        for (vertex, &length) in now.lengths.iter().enumerate() {
            if !is_larger(length, &visible) {
                continue;
            }
            let position = now.centre + now.positions.get(vertex);
            let found = Largest { displacement: length / body.radius, body: index, vertex, position };
            if is_larger(length, &any) {
                any = Some(found);
            }
            let mut others = view.bodies().enumerate().filter(|(other, _)| *other != index);
            let hides = |(of, at): (&BodySchema, &BodyFrame)| {
                !at.is_absent && at.centre.distance(position) < INSIDE * of.radius
            };
            if !others.any(|(_, other)| hides(other)) {
                visible = Some(found);
            }
        }
    }
    [visible.or(any), any]
}
