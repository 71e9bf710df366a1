//! A labelled point in space: its label stands at the end of a line, where it hides nothing.

use glam::DVec3;

use crate::{
    sdk::{LineStrips3D, Points3D, Radius},
    stream::{
        chunks::{Chunks, TrackId},
        extract::Float3,
        instant::Instant,
        palette::{Rgb, color},
    },
};

/// The line from a point to its label, which stands above it: it ends below the label, which hangs from its place.
pub fn leader(point: DVec3, label: DVec3) -> [Float3; 2] {
    const SHARE: f64 = 0.85;
    [point, point.lerp(label, SHARE)].map(|end| end.as_vec3().to_array())
}

/// A labelled point that moves.
pub struct Callout(TrackId);

impl Callout {
    /// Logs the style of the entity.
    pub fn new(entity: &str, rgb: Rgb, chunks: &mut Chunks) -> Callout {
        let ends = Points3D::update_fields()
            .with_radii([6.0, 0.0].map(Radius::new_ui_points))
            .with_colors([color(rgb)])
            .with_show_labels(true);
        chunks.log_static(entity, &ends);
        let leader = LineStrips3D::update_fields()
            .with_radii([Radius::new_ui_points(0.75)])
            .with_colors([color(rgb)])
            .with_show_labels(false);
        chunks.log_static(entity, &leader);
        let components =
            [Points3D::descriptor_positions(), Points3D::descriptor_labels(), LineStrips3D::descriptor_strips()];
        Callout(chunks.track(entity, components))
    }

    /// Logs the point, the place of its label, and the label, or that there is none, if this has changed. The line between them
    /// first goes by `front` [scene unit], if given, so that the body of the point does not hide it.
    pub fn log(&self, mark: Option<([DVec3; 2], String)>, front: Option<DVec3>, at: Instant, chunks: &mut Chunks) {
        let ends: Vec<Float3> = mark.iter().flat_map(|(ends, _)| ends.map(|end| end.as_vec3().to_array())).collect();
        let line = |&([from, to], _): &([DVec3; 2], String)| -> Vec<Float3> {
            let first = front.map(|_| from.as_vec3().to_array());
            first.into_iter().chain(leader(from + front.unwrap_or_default(), to)).collect()
        };
        let leader: Vec<Vec<Float3>> = mark.iter().map(line).collect();
        let labels: Vec<String> = mark.into_iter().flat_map(|(_, label)| [String::new(), label]).collect();
        chunks.push_changed(self.0, at, &[&ends, &labels, &leader]);
    }
}
