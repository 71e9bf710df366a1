//! PLY (Stanford): a header that declares elements and their properties, then their values as text or binary.

use glam::DVec3;

use super::Soup;

#[derive(Clone, Copy, PartialEq)]
enum Form {
    Ascii,
    Little,
    Big,
}

/// A number type, with its size in bytes.
#[derive(Clone, Copy)]
enum Kind {
    Signed(usize),
    Unsigned(usize),
    Float(usize),
}

struct Property {
    name: String,
    /// The kind of a list's length, if it is a list.
    length: Option<Kind>,
    kind: Kind,
}

struct Element {
    name: String,
    count: u64,
    properties: Vec<Property>,
}

pub fn parse(bytes: &[u8]) -> Result<Soup, String> {
    let (form, elements, body) = header(bytes)?;
    let mut numbers = Numbers { form, bytes: body };
    let mut soup = Soup::default();
    let (mut list, mut corners) = (Vec::new(), Vec::new());
    for element in &elements {
        if element.properties.is_empty() {
            continue;
        }
        for index in 0..element.count {
            let at = |what: String| format!("{} {index} (counted from 0): {what}", element.name);
            let mut position = [None; 3];
            for property in &element.properties {
                let Some(length) = property.length else {
                    let value = numbers.next(property.kind).map_err(at)?;
                    if let Some(axis) = ["x", "y", "z"].iter().position(|axis| *axis == property.name) {
                        position[axis] = Some(value);
                    }
                    continue;
                };
                let length = numbers.next(length).map_err(at)?;
                if !(0.0..=1e6).contains(&length) {
                    return Err(at(format!("a list of {length} numbers")));
                }
                list.clear();
                for _ in 0..length as u64 {
                    list.push(numbers.next(property.kind).map_err(at)?);
                }
                if element.name == "face" && ["vertex_indices", "vertex_index"].contains(&property.name.as_str()) {
                    corners.clear();
                    for &corner in &list {
                        if !(0.0..4294967295.0).contains(&corner) {
                            return Err(at(format!("there is no vertex {corner}")));
                        }
                        corners.push(corner as u32);
                    }
                    soup.polygon(&corners).map_err(at)?;
                }
            }
            if element.name == "vertex" {
                let [Some(x), Some(y), Some(z)] = position else {
                    return Err("its vertices have no x, y and z".to_owned());
                };
                soup.positions.push(DVec3::new(x, y, z));
            }
        }
    }
    Ok(soup)
}

fn header(bytes: &[u8]) -> Result<(Form, Vec<Element>, &[u8]), String> {
    let (mut rest, mut form, mut elements) = (bytes, None, Vec::<Element>::new());
    for number in 1.. {
        let end = rest.iter().take(4096).position(|&byte| byte == b'\n').ok_or("its header has no end")?;
        let (line, after) = rest.split_at(end);
        rest = &after[1..];
        let line = String::from_utf8_lossy(line); // comments may be in any encoding
        let line = line.trim();
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        let unknown = || format!("line {number}: \"{}\" is not known", line.chars().take(64).collect::<String>());
        match words[..] {
            ["ply"] if number == 1 => {}
            _ if number == 1 => return Err("it does not begin with \"ply\"".to_owned()),
            ["format", "ascii", _] => form = Some(Form::Ascii),
            ["format", "binary_little_endian", _] => form = Some(Form::Little),
            ["format", "binary_big_endian", _] => form = Some(Form::Big),
            ["comment" | "obj_info", ..] | [] => {}
            ["element", name, count] => {
                let count = count.parse().map_err(|_| unknown())?;
                elements.push(Element { name: name.to_owned(), count, properties: Vec::new() });
            }
            ["property", "list", length, kind, name] => {
                let property = Property {
                    name: name.to_owned(),
                    length: Some(kind_of(length).ok_or_else(unknown)?),
                    kind: kind_of(kind).ok_or_else(unknown)?,
                };
                elements.last_mut().ok_or_else(unknown)?.properties.push(property);
            }
            ["property", kind, name] => {
                let property =
                    Property { name: name.to_owned(), length: None, kind: kind_of(kind).ok_or_else(unknown)? };
                elements.last_mut().ok_or_else(unknown)?.properties.push(property);
            }
            ["end_header"] => return Ok((form.ok_or("its header has no format")?, elements, rest)),
            _ => return Err(unknown()),
        }
    }
    Err("its header has no end".to_owned())
}

fn kind_of(name: &str) -> Option<Kind> {
    Some(match name {
        "char" | "int8" => Kind::Signed(1),
        "uchar" | "uint8" => Kind::Unsigned(1),
        "short" | "int16" => Kind::Signed(2),
        "ushort" | "uint16" => Kind::Unsigned(2),
        "int" | "int32" => Kind::Signed(4),
        "uint" | "uint32" => Kind::Unsigned(4),
        "float" | "float32" => Kind::Float(4),
        "double" | "float64" => Kind::Float(8),
        _ => return None,
    })
}

struct Numbers<'a> {
    form: Form,
    bytes: &'a [u8],
}

impl Numbers<'_> {
    fn next(&mut self, kind: Kind) -> Result<f64, String> {
        if self.form == Form::Ascii {
            self.bytes = self.bytes.trim_ascii_start();
            let end = self.bytes.iter().position(u8::is_ascii_whitespace).unwrap_or(self.bytes.len());
            let (word, rest) = self.bytes.split_at(end);
            self.bytes = rest;
            let number = std::str::from_utf8(word).ok().and_then(|word| word.parse().ok());
            return number
                .ok_or_else(|| if word.is_empty() { "the file ends".to_owned() } else { "not a number".to_owned() });
        }
        let (Kind::Signed(size) | Kind::Unsigned(size) | Kind::Float(size)) = kind;
        let (word, rest) = self.bytes.split_at_checked(size).ok_or("the file ends")?;
        self.bytes = rest;
        let mut raw = [0; 8];
        raw[..size].copy_from_slice(word);
        if self.form == Form::Big {
            raw[..size].reverse();
        }
        let bits = u64::from_le_bytes(raw);
        Ok(match kind {
            Kind::Unsigned(_) => bits as f64,
            Kind::Signed(size) => {
                let unused = 64 - 8 * size as u32;
                ((bits << unused) as i64 >> unused) as f64
            }
            Kind::Float(4) => f64::from(f32::from_bits(bits as u32)),
            Kind::Float(_) => f64::from_bits(bits),
        })
    }
}
