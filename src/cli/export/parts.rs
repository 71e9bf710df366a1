//! The surfaces of a frame: closed meshes in the world.

use glam::DVec3;

use crate::{
    analysis::surface::Merged,
    geometry::{
        Facets, Vectors,
        mesh::{append_normals, signed_volume_of},
    },
    observe::{Frame, Schema},
    stream::palette,
};

/// A closed mesh.
pub struct Part {
    /// Name of its body, or names of its group's bodies, joined by `+`.
    pub name: String,
    /// Positions of the vertices in the world [scene unit], `[vertex_count]`.
    pub positions: Vec<[f32; 3]>,
    /// Unit normals, `[vertex_count]`.
    pub normals: Vec<[f32; 3]>,
    /// Colours in sRGB, `[vertex_count]`.
    pub colors: Vec<[u8; 3]>,
    /// Vertices of each triangle, counter-clockwise from outside.
    pub triangles: Vec<[u32; 3]>,
}

/// Upper limit on the body names in a group's name. For more bodies, it is the first name and the number of the others.
const MAX_NAMES: usize = 8;

/// The surfaces of a frame: first groups, then single bodies.
pub fn parts(schema: &Schema, frame: &Frame, merged: &Merged) -> Vec<Part> {
    let (mut parts, mut sums) = (Vec::new(), Vec::new());
    for group in &merged.groups {
        let names: Vec<&str> = group.bodies.iter().map(|&body| schema.bodies[body].name.as_str()).collect();
        let name = match names.as_slice() {
            [first, rest @ ..] if names.len() > MAX_NAMES => format!("{first}+{}", rest.len()),
            names => names.join("+"),
        };
        let colors = group.origins.iter().map(|origin| palette::blended(schema, origin)).collect();
        let part = match group.facets(schema) {
            Some(facets) => Part::faceted(name, &facets, &group.positions, colors),
            None => {
                let mut normals = Vec::new();
                group.append_normals(&mut sums, &mut normals);
                Part::smooth(name, &group.positions, normals, colors, &group.triangles)
            }
        };
        parts.push(part);
    }
    let mut local = Vectors::default();
    for (index, (body, now)) in schema.bodies.iter().zip(&frame.bodies).enumerate() {
        if now.is_absent || merged.is_merged.get(index).copied().unwrap_or(false) {
            continue;
        }
        let mesh = now.mesh_of(body);
        now.local_positions(mesh.at(body.radius), &mut local);
        let positions: Vec<DVec3> = local.iter().map(|position| position + now.centre).collect();
        let colors = vec![palette::of_body(schema, index); positions.len()];
        let name = body.name.clone();
        let mut part = match mesh.facets() {
            Some(facets) => Part::faceted(name, facets, &positions, colors),
            None => {
                let mut normals = Vec::new();
                append_normals(&local, mesh.triangles(), &mut sums, &mut normals);
                Part::smooth(name, &positions, normals, colors, mesh.triangles())
            }
        };
        // a body that is inside out is turned, as in a group
        if signed_volume_of(&local, mesh.triangles()) < 0.0 {
            part.triangles.iter_mut().for_each(|corners| corners.swap(1, 2));
            part.normals.iter_mut().for_each(|normal| *normal = normal.map(|component| -component));
        }
        parts.push(part);
    }
    parts
}

impl Part {
    /// A surface whose triangles share no vertices.
    fn faceted(name: String, facets: &Facets, positions: &[DVec3], mut colors: Vec<[u8; 3]>) -> Part {
        let mut normals = Vec::new();
        facets.append_normals(|i| positions[i], positions.len(), &mut normals);
        let mut positions = positions.iter().map(|position| position.as_vec3().to_array()).collect();
        facets.extend(&mut positions, 0);
        facets.extend(&mut colors, 0);
        Part { name, positions, normals, colors, triangles: facets.triangles().to_vec() }
    }

    /// A surface with these normals.
    fn smooth(
        name: String,
        positions: &[DVec3],
        normals: Vec<[f32; 3]>,
        colors: Vec<[u8; 3]>,
        triangles: &[[u32; 3]],
    ) -> Part {
        let positions = positions.iter().map(|position| position.as_vec3().to_array()).collect();
        Part { name, positions, normals, colors, triangles: triangles.to_vec() }
    }
}
