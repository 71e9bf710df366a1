//! Mesh files. Each format is simple enough to be written without a crate.

use std::io::{self, Write};

use super::parts::Part;

/// The mark of a file written by this program.
pub const GENERATOR: &str = "meldscope export";

named! {
    /// A format of mesh files.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum Format {
        /// glTF 2.0 in one binary file: a node for each surface; normals and colours.
        Glb = "glb",
        /// Wavefront OBJ: an object for each surface; normals, and colours after the positions.
        Obj = "obj",
        /// Stanford PLY, binary: all surfaces as one mesh; normals and colours.
        Ply = "ply",
        /// STL, binary: all triangles; neither vertex normals nor colours.
        Stl = "stl",
    }
}

impl Format {
    /// Writes surfaces.
    pub fn write(self, parts: &[Part], to: &mut impl Write) -> io::Result<()> {
        match self {
            Format::Glb => glb(parts, to),
            Format::Obj => obj(parts, to),
            Format::Ply => ply(parts, to),
            Format::Stl => stl(parts, to),
        }
    }
}

fn obj(parts: &[Part], to: &mut impl Write) -> io::Result<()> {
    writeln!(to, "# {GENERATOR}")?;
    let mut first = 1;
    for part in parts {
        writeln!(to, "o {}", part.name)?;
        for ([x, y, z], color) in part.positions.iter().zip(&part.colors) {
            let [r, g, b] = color.map(|value| f32::from(value) / 255.0);
            writeln!(to, "v {x} {y} {z} {r:.4} {g:.4} {b:.4}")?;
        }
        for [x, y, z] in &part.normals {
            writeln!(to, "vn {x} {y} {z}")?;
        }
        for corners in &part.triangles {
            let [a, b, c] = corners.map(|v| v + first);
            writeln!(to, "f {a}//{a} {b}//{b} {c}//{c}")?;
        }
        first += part.positions.len() as u32;
    }
    Ok(())
}

fn ply(parts: &[Part], to: &mut impl Write) -> io::Result<()> {
    writeln!(to, "ply\nformat binary_little_endian 1.0\ncomment {GENERATOR}")?;
    writeln!(to, "element vertex {}", parts.iter().map(|part| part.positions.len()).sum::<usize>())?;
    for property in ["x", "y", "z", "nx", "ny", "nz"] {
        writeln!(to, "property float {property}")?;
    }
    for property in ["red", "green", "blue"] {
        writeln!(to, "property uchar {property}")?;
    }
    writeln!(to, "element face {}", parts.iter().map(|part| part.triangles.len()).sum::<usize>())?;
    writeln!(to, "property list uchar int vertex_indices\nend_header")?;
    for part in parts {
        for ((position, normal), color) in part.positions.iter().zip(&part.normals).zip(&part.colors) {
            write_floats(position, to)?;
            write_floats(normal, to)?;
            to.write_all(color)?;
        }
    }
    let mut first = 0;
    for part in parts {
        for corners in &part.triangles {
            to.write_all(&[3])?;
            corners.iter().try_for_each(|v| to.write_all(&(v + first).to_le_bytes()))?;
        }
        first += part.positions.len() as u32;
    }
    Ok(())
}

fn stl(parts: &[Part], to: &mut impl Write) -> io::Result<()> {
    let mut header = [b' '; 80];
    header[..GENERATOR.len()].copy_from_slice(GENERATOR.as_bytes());
    to.write_all(&header)?;
    to.write_all(&(parts.iter().map(|part| part.triangles.len()).sum::<usize>() as u32).to_le_bytes())?;
    for part in parts {
        for corners in &part.triangles {
            let corners = corners.map(|v| glam::Vec3::from(part.positions[v as usize]));
            let [a, b, c] = corners.map(|position| position.as_dvec3());
            write_floats(&(b - a).cross(c - a).normalize_or_zero().as_vec3().to_array(), to)?;
            corners.iter().try_for_each(|position| write_floats(&position.to_array(), to))?;
            to.write_all(&[0; 2])?;
        }
    }
    Ok(())
}

fn write_floats(values: &[f32; 3], to: &mut impl Write) -> io::Result<()> {
    values.iter().try_for_each(|value| to.write_all(&value.to_le_bytes()))
}

/// Binary glTF: a header, a chunk of JSON, a chunk of data (glTF 2.0, section 4.4).
fn glb(parts: &[Part], to: &mut impl Write) -> io::Result<()> {
    let mut data: Vec<u8> = Vec::new();
    let (mut nodes, mut meshes, mut accessors, mut views) = (vec![], vec![], vec![], vec![]);
    for (number, part) in parts.iter().enumerate() {
        let first = 4 * number;
        let count = part.positions.len();
        let mut view = |data: &mut Vec<u8>, target: u32, write: &dyn Fn(&mut Vec<u8>)| {
            let start = data.len();
            write(data);
            let length = data.len() - start;
            views.push(format!(r#"{{"buffer":0,"byteOffset":{start},"byteLength":{length},"target":{target}}}"#));
        };
        let floats = |values: &[[f32; 3]], data: &mut Vec<u8>| {
            values.as_flattened().iter().for_each(|value| data.extend(value.to_le_bytes()));
        };
        view(&mut data, 34962, &|data| floats(&part.positions, data));
        view(&mut data, 34962, &|data| floats(&part.normals, data));
        view(&mut data, 34962, &|data| {
            for &[r, g, b] in &part.colors {
                let values = [linear(r), linear(g), linear(b), u16::MAX];
                values.iter().for_each(|value| data.extend(value.to_le_bytes()));
            }
        });
        view(&mut data, 34963, &|data| {
            part.triangles.as_flattened().iter().for_each(|v| data.extend(v.to_le_bytes()));
        });
        let bound = |pick: fn(f32, f32) -> f32, start: f32| {
            let of = |k: usize| part.positions.iter().map(|position| position[k]).fold(start, pick);
            format!("[{},{},{}]", of(0), of(1), of(2))
        };
        let (low, high) = (bound(f32::min, f32::MAX), bound(f32::max, f32::MIN));
        let of = |view: usize, rest: String| format!(r#"{{"bufferView":{},{rest}}}"#, first + view);
        accessors.extend([
            of(0, format!(r#""componentType":5126,"count":{count},"type":"VEC3","min":{low},"max":{high}"#)),
            of(1, format!(r#""componentType":5126,"count":{count},"type":"VEC3""#)),
            of(2, format!(r#""componentType":5123,"normalized":true,"count":{count},"type":"VEC4""#)),
            of(3, format!(r#""componentType":5125,"count":{},"type":"SCALAR""#, 3 * part.triangles.len())),
        ]);
        meshes.push(format!(
            r#"{{"name":"{}","primitives":[{{"attributes":{{"POSITION":{first},"NORMAL":{},"COLOR_0":{}}},"indices":{},"material":0}}]}}"#,
            part.name,
            first + 1,
            first + 2,
            first + 3,
        ));
        nodes.push(format!(r#"{{"name":"{}","mesh":{number}}}"#, part.name));
    }
    // glTF has y up, scenes have z up
    let children: Vec<String> = (0..parts.len()).map(|node| node.to_string()).collect();
    let turned = "[-0.70710678,0,0,0.70710678]";
    nodes.push(format!(r#"{{"name":"world","children":[{}],"rotation":{turned}}}"#, children.join(",")));
    let mut json = format!(
        r#"{{"asset":{{"version":"2.0","generator":"{GENERATOR}"}},"scene":0,"scenes":[{{"nodes":[{}]}}],"nodes":[{}],"#,
        parts.len(),
        nodes.join(","),
    );
    json += &format!(
        r#""meshes":[{}],"accessors":[{}],"bufferViews":[{}],"buffers":[{{"byteLength":{}}}],"#,
        meshes.join(","),
        accessors.join(","),
        views.join(","),
        data.len(),
    );
    json += r#""materials":[{"pbrMetallicRoughness":{"metallicFactor":0,"roughnessFactor":0.6}}]}"#;
    while json.len() % 4 != 0 {
        json.push(' ');
    }
    let whole = 12 + 8 + json.len() + 8 + data.len();
    let too_long = || io::Error::other("the file would be longer than 4 GiB");
    let length = |length: usize| u32::try_from(length).map(u32::to_le_bytes).map_err(|_| too_long());
    to.write_all(b"glTF")?;
    to.write_all(&2u32.to_le_bytes())?;
    to.write_all(&length(whole)?)?;
    to.write_all(&length(json.len())?)?;
    to.write_all(b"JSON")?;
    to.write_all(json.as_bytes())?;
    to.write_all(&length(data.len())?)?;
    to.write_all(b"BIN\0")?;
    to.write_all(&data)
}

/// Converts an sRGB value to a linear 16-bit one.
fn linear(value: u8) -> u16 {
    let value = f64::from(value) / 255.0;
    let linear = if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) };
    (linear * f64::from(u16::MAX)).round() as u16
}
