//! A labelled point in space: its label stands at the end of a line, where it hides nothing.

use glam::DVec3;

use crate::{
    sdk::{LineStrips3D, Points3D, Radius},
    stream::{
        chunks::Chunks,
        extract::Float3,
        palette::{Rgb, color},
    },
};

/// The line from a point to its label, which stands above it: it ends below the label, which hangs from its place.
pub fn leader(point: DVec3, label: DVec3) -> [Float3; 2] {
    const SHARE: f64 = 0.85;
    [point, point.lerp(label, SHARE)].map(|end| end.as_vec3().to_array())
}

/// Logs the style of an entity whose rows have the point and the place of its label, the labels of both, of which the first
/// is empty, and the line between them.
pub fn log_style(entity: &str, rgb: Rgb, chunks: &mut Chunks) {
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
}
