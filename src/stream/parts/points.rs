//! Force points: influence spheres without a body, while they act.

use glam::DVec3;

use super::FrameView;
use crate::{
    observe::Schema,
    sdk::{self, Ellipsoids3D, Points3D, components::FillMode},
    stream::{chunks::Chunks, contract::POINTS, palette::color},
};

/// Line width of the spheres [points on the screen].
const LINE: f32 = 0.8;

/// The force points, with the last logged values.
pub struct Points {
    /// Index, centre and radius of the sphere of each point that acts [scene unit].
    last: Option<Vec<(usize, DVec3, f64)>>,
}

impl Points {
    /// Logs static data; `None` if there are no force points.
    pub fn new(schema: &Schema, chunks: &mut Chunks) -> Option<Points> {
        if schema.points.is_empty() {
            return None;
        }
        let style = Ellipsoids3D::update_fields()
            .with_fill_mode(FillMode::MajorWireframe)
            .with_line_radii([sdk::Radius::new_ui_points(LINE)])
            .with_show_labels(false);
        chunks.log_static(POINTS.path, &style);
        let names = Points3D::update_fields().with_radii([sdk::Radius::new_ui_points(LINE)]).with_show_labels(true);
        chunks.log_static(POINTS.path, &names);
        Some(Points { last: None })
    }

    /// Logs changed values.
    pub fn log(&mut self, view: FrameView<'_>, chunks: &mut Chunks) {
        let points = view.schema.points.iter().enumerate();
        let acting = points.filter_map(|(index, point)| {
            let (centre, reach) = point.sphere.at(view.at.time)?;
            Some((index, centre, reach))
        });
        let acting: Vec<_> = acting.collect();
        if self.last.as_ref() == Some(&acting) {
            return;
        }
        let of = |index: usize| &view.schema.points[index];
        let colors = || acting.iter().map(|&(index, ..)| color(of(index).color));
        let spheres = Ellipsoids3D::update_fields()
            .with_centers(acting.iter().map(|(_, centre, _)| centre.as_vec3().to_array()))
            .with_half_sizes(acting.iter().map(|&(_, _, reach)| [reach as f32; 3]))
            .with_colors(colors());
        chunks.log(POINTS.path, view.at, &spheres);
        // above the sphere: at its centre are the bodies that it acts on, and their labels
        let top = |centre: DVec3, reach: f64| (centre + reach * view.schema.up).as_vec3().to_array();
        let names = Points3D::update_fields()
            .with_positions(acting.iter().map(|&(_, centre, reach)| top(centre, reach)))
            .with_labels(acting.iter().map(|&(index, ..)| of(index).label.as_str()))
            .with_colors(colors());
        chunks.log(POINTS.path, view.at, &names);
        self.last = Some(acting);
    }
}
