//! Planes that bodies cannot pass: a translucent sheet with a grid, as large as the scene.

use glam::DVec3;

use crate::{
    geometry::bounds,
    observe::{Schema, schema::PlaneSchema},
    sdk::{self, LineStrips3D, Mesh3D},
    stream::{
        chunks::Chunks,
        contract::{PLANE, PLANE_GRID},
        instant::Instant,
        palette::{self, color},
    },
};

/// Lines of the grid in each direction.
const LINES: i32 = 12;

/// Logs the planes from `now` on; `spheres` (centre and radius) bound everything visible. All changes are known ahead.
pub fn log(schema: &Schema, spheres: &[(DVec3, f64)], now: Instant, chunks: &mut Chunks) {
    let [low, high] = bounds(spheres.iter().copied());
    let (middle, half) = (0.5 * (low + high), 0.5 * (high - low).max_element());
    if !(half.is_finite() && half > 0.0) {
        return;
    }
    let of = |planes: &[PlaneSchema], chunks: &mut Chunks, at: Option<Instant>| {
        planes
            .iter()
            .enumerate()
            .for_each(|(number, plane)| draw(plane, &number.to_string(), (middle, half), at, chunks));
    };
    if schema.changes.is_empty() {
        return of(&schema.planes, chunks, None);
    }
    of(schema.planes(now.time), chunks, Some(now));
    for change in schema.changes.iter().filter(|change| change.after >= now.time) {
        let step = (change.after / schema.dt).floor() as u64 + 1;
        of(&change.planes, chunks, Some(Instant { step, time: step as f64 * schema.dt }));
    }
}

/// Logs a plane, at an instant or for the whole recording.
fn draw(plane: &PlaneSchema, name: &str, (middle, half): (DVec3, f64), at: Option<Instant>, chunks: &mut Chunks) {
    let [centre, along, across] = sheet(plane, middle, half);
    let corner = |x: f64, y: f64| (centre + x * along + y * across).as_vec3();
    let corners = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
    let mesh = Mesh3D::new(corners)
        .with_vertex_normals([plane.normal.as_vec3(); 4])
        .with_triangle_indices([[0, 1, 2], [0, 2, 3]])
        .with_albedo_factor(palette::sheet());
    let lines = (0..=LINES).flat_map(|k| {
        let at = 2.0 * f64::from(k) / f64::from(LINES) - 1.0;
        [[corner(at, -1.0), corner(at, 1.0)], [corner(-1.0, at), corner(1.0, at)]]
    });
    let friction = if plane.friction > 0.0 { format!(", friction {}", plane.friction) } else { String::new() };
    let grid = LineStrips3D::new(lines)
        .with_radii([sdk::Radius::new_ui_points(0.6)])
        .with_colors([color(palette::GRID)])
        .with_labels([format!("plane {name}{friction}")])
        .with_show_labels(false);
    let (sheet, lines) = (PLANE.of(&[name]), PLANE_GRID.of(&[name]));
    match at {
        Some(at) => {
            chunks.log(&sheet, at, &mesh);
            chunks.log(&lines, at, &grid);
        }
        None => {
            chunks.log_static(&sheet, &mesh);
            chunks.log_static(&lines, &grid);
        }
    }
}

/// Centre and half edges of the square in which a plane is drawn.
fn sheet(plane: &PlaneSchema, middle: DVec3, half: f64) -> [DVec3; 3] {
    let normal = plane.normal;
    let centre = middle + (plane.offset - normal.dot(middle)) * normal;
    let reference = if normal.z.abs() > 0.9 { DVec3::X } else { DVec3::Z };
    let along = (reference - normal.dot(reference) * normal).normalize_or_zero();
    [centre, 1.15 * half * along, 1.15 * half * normal.cross(along)]
}
