//! A mesh as text, bit-exact: a version, counts, positions and triangles in base64.
//!
//! Positions are doubles, or singles if that is exact, as for most files. Each corner of a triangle is the difference
//! to the previous corner, as a zigzag varint. A million triangles take about 16 MB.

use base64::{Engine as _, engine::general_purpose::STANDARD_NO_PAD};
use glam::DVec3;

use super::{MOST_TRIANGLES, Soup};

const VERSION: u8 = 1;

/// The text of a mesh.
pub fn encode(soup: &Soup) -> String {
    let is_single =
        soup.positions.iter().flat_map(|p| p.to_array()).all(|x| f64::from(x as f32).to_bits() == x.to_bits());
    let mut bytes = vec![VERSION, if is_single { 4 } else { 8 }];
    for count in [soup.positions.len(), soup.triangles.len()] {
        bytes.extend((count as u32).to_le_bytes());
    }
    for x in soup.positions.iter().flat_map(|p| p.to_array()) {
        if is_single {
            bytes.extend((x as f32).to_le_bytes());
        } else {
            bytes.extend(x.to_le_bytes());
        }
    }
    let mut before = 0;
    for &corner in soup.triangles.iter().flatten() {
        let difference = i64::from(corner) - before;
        let mut left = (difference << 1 ^ difference >> 63) as u64;
        while left >= 0x80 {
            bytes.push(left as u8 | 0x80);
            left >>= 7;
        }
        bytes.push(left as u8);
        before = i64::from(corner);
    }
    STANDARD_NO_PAD.encode(bytes)
}

/// The positions and triangles of such a text. The corners are not checked to be in range.
///
/// # Errors
/// The text is not an encoded mesh.
pub fn decode(text: &str) -> Result<Soup, String> {
    let bytes = STANDARD_NO_PAD.decode(text).map_err(|error| error.to_string())?;
    let [VERSION, size @ (4 | 8), rest @ ..] = &bytes[..] else { return Err("its version is unknown".to_owned()) };
    let ends = || "it ends too early, or too late".to_owned();
    let (counts, rest) = rest.split_at_checked(8).ok_or_else(ends)?;
    let count = |i: usize| u32::from_le_bytes([counts[i], counts[i + 1], counts[i + 2], counts[i + 3]]) as usize;
    let (vertices, triangles, size) = (count(0), count(4), usize::from(*size));
    let (positions, mut rest) = rest.split_at_checked(vertices.saturating_mul(3 * size)).ok_or_else(ends)?;
    if triangles > MOST_TRIANGLES || triangles > rest.len() / 3 {
        return Err(ends());
    }
    let number = |bytes: &[u8]| match *bytes {
        [a, b, c, d] => f64::from(f32::from_le_bytes([a, b, c, d])),
        [a, b, c, d, e, f, g, h] => f64::from_le_bytes([a, b, c, d, e, f, g, h]),
        _ => f64::NAN,
    };
    let position =
        |bytes: &[u8]| DVec3::new(number(&bytes[..size]), number(&bytes[size..2 * size]), number(&bytes[2 * size..]));
    let mut soup = Soup { positions: positions.chunks_exact(3 * size).map(position).collect(), triangles: vec![] };
    soup.triangles.reserve_exact(triangles);
    let mut before = 0_i64;
    let mut next = || {
        let (mut value, mut shift) = (0_u64, 0);
        loop {
            let (&byte, after) = rest.split_first().ok_or_else(ends)?;
            rest = after;
            value |= u64::from(byte & 0x7f) << shift;
            shift += 7;
            if byte < 0x80 {
                break;
            }
            if shift > 35 {
                return Err(ends());
            }
        }
        before += (value >> 1) as i64 ^ -((value & 1) as i64);
        u32::try_from(before).map_err(|_| ends())
    };
    for _ in 0..triangles {
        soup.triangles.push([next()?, next()?, next()?]);
    }
    if rest.is_empty() { Ok(soup) } else { Err(ends()) }
}
