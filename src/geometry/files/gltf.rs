//! glTF 2.0 and its binary form GLB: the triangles of the default scene, with the transforms of its nodes.

use std::{borrow::Cow, path::Path};

use base64::{Engine as _, engine::general_purpose::STANDARD};
use glam::{DMat4, DQuat, DVec3};
use serde_json::Value;

use super::{LARGEST_FILE, MOST_TRIANGLES, Soup};

/// Limits on the depth of the node tree and on the number of node instances: a file beyond them probably contains a
/// cycle.
const MAX_DEPTH: u32 = 64;
const MAX_NODES: u32 = 100_000;
/// Limit on the values in the JSON, which take up to some 100 bytes each.
const MAX_VALUES: usize = 4_000_000;
/// Limits on sums over all instances: a file may name a part of it any number of times.
const MAX_PRIMITIVES: u32 = 1_000_000;
const MAX_POSITIONS: usize = 3 * MOST_TRIANGLES;

pub fn parse(bytes: &[u8], path: &Path) -> Result<Soup, String> {
    let (json, binary) = match bytes {
        [b'g', b'l', b'T', b'F', ..] => chunks(bytes)?,
        _ => (bytes, None),
    };
    if json.iter().filter(|&&byte| byte == b',').count() >= MAX_VALUES {
        return Err(format!("its JSON has more than {MAX_VALUES} values"));
    }
    let document: Value = serde_json::from_slice(json).map_err(|error| format!("its JSON: {error}"))?;
    let (mut buffers, mut size) = (Vec::new(), 0);
    for (index, buffer) in array(&document["buffers"]).iter().enumerate() {
        let buffer = match buffer["uri"].as_str() {
            Some(uri) => Cow::Owned(load(uri, path).map_err(|what| format!("buffer {index}: {what}"))?),
            None => Cow::Borrowed(binary.ok_or_else(|| format!("buffer {index} has no uri"))?),
        };
        size += buffer.len() as u64;
        if size > LARGEST_FILE {
            return Err(format!("its buffers take more than {} MiB together", LARGEST_FILE >> 20));
        }
        buffers.push(buffer);
    }
    let mut reader = Reader { document: &document, buffers, soup: Soup::default(), nodes: 0, primitives: 0 };
    let scene = &document["scenes"][document["scene"].as_u64().unwrap_or(0) as usize];
    // y-up to z-up
    let upright = DMat4::from_cols_array(&[1., 0., 0., 0., 0., 0., 1., 0., 0., -1., 0., 0., 0., 0., 0., 1.]);
    for node in array(&scene["nodes"]) {
        reader.node(node, upright, 0)?;
    }
    Ok(reader.soup)
}

/// The two chunks of a GLB: JSON, and binary data.
fn chunks(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), String> {
    let mut rest = bytes.get(12..).ok_or("it ends in its header")?;
    let mut chunk = |kind: &[u8; 4]| -> Option<&[u8]> {
        let length = u32::from_le_bytes(rest.get(..4)?.try_into().ok()?) as usize;
        let data = rest.get(8..8usize.checked_add(length)?).filter(|_| rest[4..8] == *kind)?;
        rest = &rest[8 + length..];
        Some(data)
    };
    let json = chunk(b"JSON").ok_or("it has no JSON chunk")?;
    Ok((json, chunk(b"BIN\0")))
}

/// A buffer inside the file or beside it.
fn load(uri: &str, path: &Path) -> Result<Vec<u8>, String> {
    if let Some(data) = uri.strip_prefix("data:") {
        let (_, data) = data.split_once(";base64,").ok_or("a data URI that is not base64")?;
        return STANDARD.decode(data).map_err(|error| error.to_string());
    }
    if uri.contains("://") {
        return Err("it is not on this machine".to_owned());
    }
    let read = |name: &str| {
        let file = path.parent().unwrap_or(Path::new("")).join(name);
        super::read(&file).map_err(|error| format!("{}: {error}", file.display()))
    };
    // not all programs encode names, so a name with % may be meant as it is
    read(uri).or_else(|error| read(&decoded(uri).ok_or(error)?))
}

/// A URI without its percent-encoding; `None` if it has none.
fn decoded(uri: &str) -> Option<String> {
    let mut parts = uri.split('%');
    let mut bytes = parts.next()?.as_bytes().to_vec();
    let start = bytes.len();
    for part in parts {
        let digits = part.get(..2).filter(|digits| digits.bytes().all(|digit| digit.is_ascii_hexdigit()))?;
        bytes.push(u8::from_str_radix(digits, 16).ok()?);
        bytes.extend(&part.as_bytes()[2..]);
    }
    String::from_utf8(bytes).ok().filter(|_| start < uri.len())
}

fn array(value: &Value) -> &[Value] {
    value.as_array().map_or(&[], Vec::as_slice)
}

struct Reader<'a> {
    document: &'a Value,
    buffers: Vec<Cow<'a, [u8]>>,
    soup: Soup,
    nodes: u32,
    primitives: u32,
}

impl Reader<'_> {
    fn node(&mut self, index: &Value, above: DMat4, depth: u32) -> Result<(), String> {
        self.nodes += 1;
        if depth > MAX_DEPTH || self.nodes > MAX_NODES {
            return Err("it has too many nodes, or nodes that contain themselves".to_owned());
        }
        let document = self.document;
        let node = index.as_u64().map_or(&Value::Null, |index| &document["nodes"][index as usize]);
        let transform = above * transform(node)?;
        if let Some(mesh) = node["mesh"].as_u64() {
            for primitive in array(&document["meshes"][mesh as usize]["primitives"]) {
                self.primitive(primitive, transform).map_err(|what| format!("mesh {mesh}: {what}"))?;
            }
        }
        for child in array(&node["children"]) {
            self.node(child, transform, depth + 1)?;
        }
        Ok(())
    }

    fn primitive(&mut self, primitive: &Value, transform: DMat4) -> Result<(), String> {
        if primitive["mode"].as_u64().unwrap_or(4) != 4 {
            return Err("it has primitives other than triangles".to_owned());
        }
        self.primitives += 1;
        if self.primitives > MAX_PRIMITIVES {
            return Err(format!("the scene has more than {MAX_PRIMITIVES} primitives, with those that it names again"));
        }
        let first = self.soup.positions.len() as u32;
        let numbers = self.accessor(&primitive["attributes"]["POSITION"], "VEC3", 3)?;
        let corners = match primitive.get("indices") {
            Some(indices) => self.accessor(indices, "SCALAR", 1)?,
            None => (0..numbers.len() / 3).map(|i| i as f64).collect(),
        };
        if numbers.len() / 3 > MAX_POSITIONS - self.soup.positions.len() {
            return Err(format!("the scene has more than {MAX_POSITIONS} positions, with those that it names again"));
        }
        let count = (numbers.len() / 3) as f64;
        for position in numbers.chunks_exact(3) {
            self.soup.positions.push(transform.transform_point3(DVec3::new(position[0], position[1], position[2])));
        }
        let mirrored = transform.determinant() < 0.0;
        for corners in corners.chunks_exact(3) {
            if let Some(corner) = corners.iter().find(|&&corner| !(0.0..count).contains(&corner)) {
                return Err(format!("a triangle refers to vertex {corner} (counted from 0) of only {count}"));
            }
            let [a, b, c] = [corners[0], corners[1], corners[2]].map(|corner| first + corner as u32);
            self.soup.polygon(&if mirrored { [a, c, b] } else { [a, b, c] })?;
        }
        Ok(())
    }

    /// The numbers of an accessor, `width` for each element.
    fn accessor(&self, index: &Value, kind: &str, width: usize) -> Result<Vec<f64>, String> {
        let index = index.as_u64().ok_or("it has no positions")? as usize;
        let accessor = &self.document["accessors"][index];
        let rejected = |what: &str| format!("accessor {index}: {what}");
        if accessor["type"].as_str() != Some(kind) || accessor.get("sparse").is_some() {
            return Err(rejected("expected one of the usual type, not sparse"));
        }
        let size = match (accessor["componentType"].as_u64(), width) {
            (Some(5126), 3) | (Some(5125), 1) => 4,
            (Some(5121), 1) => 1,
            (Some(5123), 1) => 2,
            _ => return Err(rejected("expected floats for positions and unsigned integers for indices")),
        };
        let view = accessor["bufferView"].as_u64().map(|view| &self.document["bufferViews"][view as usize]);
        let view = view.ok_or_else(|| rejected("it has no view"))?;
        let buffer = view["buffer"].as_u64().and_then(|buffer| self.buffers.get(buffer as usize));
        let buffer = buffer.ok_or_else(|| rejected("its buffer is missing"))?;
        let number = |value: &Value| value.as_u64().unwrap_or(0) as usize;
        let start = number(&view["byteOffset"]).saturating_add(number(&accessor["byteOffset"]));
        let stride = match number(&view["byteStride"]) {
            0 => size * width,
            stride => stride,
        };
        if stride < size * width {
            return Err(rejected("its elements overlap"));
        }
        let count = number(&accessor["count"]);
        let bytes = buffer.get(start..).ok_or_else(|| rejected("it is outside of its buffer"))?;
        // the number of elements that fit, whatever the file claims
        let room = if bytes.len() < size * width { 0 } else { (bytes.len() - size * width) / stride + 1 };
        if count > room {
            return Err(rejected("it is outside of its buffer"));
        }
        if count > MAX_POSITIONS {
            return Err(rejected("it has more elements than a mesh may have corners"));
        }
        let mut numbers = Vec::with_capacity(count * width);
        for element in 0..count {
            for part in bytes[element * stride..][..size * width].chunks_exact(size) {
                let mut raw = [0; 4];
                raw[..size].copy_from_slice(part);
                let bits = u32::from_le_bytes(raw);
                numbers.push(if width == 3 { f64::from(f32::from_bits(bits)) } else { f64::from(bits) });
            }
        }
        Ok(numbers)
    }
}

/// The transform from a node to its parent.
fn transform(node: &Value) -> Result<DMat4, String> {
    let numbers = |name: &str| -> Result<Option<Vec<f64>>, String> {
        let Some(value) = node.get(name) else { return Ok(None) };
        let numbers: Option<Vec<f64>> = array(value).iter().map(Value::as_f64).collect();
        numbers.map(Some).ok_or_else(|| format!("the {name} of a node is not of numbers"))
    };
    let wrong = |name: &str| format!("the {name} of a node has too many or too few numbers");
    if let Some(matrix) = numbers("matrix")? {
        let columns: [f64; 16] = matrix.try_into().map_err(|_| wrong("matrix"))?;
        return Ok(DMat4::from_cols_array(&columns));
    }
    let vector = |name: &str, default| match numbers(name)? {
        None => Ok(default),
        Some(numbers) => <[f64; 3]>::try_from(numbers).map(DVec3::from_array).map_err(|_| wrong(name)),
    };
    let rotation = match numbers("rotation")? {
        None => DQuat::IDENTITY,
        Some(numbers) => {
            let numbers = <[f64; 4]>::try_from(numbers).map_err(|_| wrong("rotation"))?;
            let rotation = DQuat::from_array(numbers);
            if rotation.length_squared() > 0.0 {
                rotation.normalize()
            } else {
                return Err("the rotation of a node is 0: a quaternion must not be".to_owned());
            }
        }
    };
    let (scale, translation) = (vector("scale", DVec3::ONE)?, vector("translation", DVec3::ZERO)?);
    Ok(DMat4::from_scale_rotation_translation(scale, rotation, translation))
}
