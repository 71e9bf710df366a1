//! STL, binary and ASCII: triangles without shared vertices.

use glam::DVec3;

use super::{MOST_TRIANGLES, Soup, number};

pub fn parse(bytes: &[u8]) -> Result<Soup, String> {
    // a binary file may also begin with "solid": its length decides; trailing bytes are allowed
    let triangles = match bytes.get(80..84) {
        Some(&[a, b, c, d]) => bytes[84..].get(..50 * u32::from_le_bytes([a, b, c, d]) as usize),
        _ => None,
    };
    match triangles {
        Some(triangles) if triangles.len() + 84 == bytes.len() => binary(triangles),
        Some(triangles) if !triangles.is_empty() && !is_ascii(bytes) => binary(triangles),
        _ => ascii(bytes),
    }
}

/// Whether the file begins like an ASCII file: with "solid" and, soon after, a facet.
fn is_ascii(bytes: &[u8]) -> bool {
    let head = &bytes[..bytes.len().min(1024)];
    let has = |word: &[u8]| head.windows(word.len()).any(|part| part.eq_ignore_ascii_case(word));
    starts_with(bytes, b"solid") && has(b"facet")
}

fn starts_with(bytes: &[u8], word: &[u8]) -> bool {
    bytes.trim_ascii_start().get(..word.len()).is_some_and(|start| start.eq_ignore_ascii_case(word))
}

fn corner(soup: &mut Soup, position: DVec3) -> Result<(), String> {
    let index = soup.positions.len() as u32;
    soup.positions.push(position);
    if index % 3 == 2 {
        if soup.triangles.len() == MOST_TRIANGLES {
            return Err(format!("more than {MOST_TRIANGLES} triangles"));
        }
        soup.triangles.push([index - 2, index - 1, index]);
    }
    Ok(())
}

fn binary(bytes: &[u8]) -> Result<Soup, String> {
    let mut soup = Soup::default();
    for triangle in bytes.chunks_exact(50) {
        for position in triangle[12..48].chunks_exact(12) {
            let axis = |i: usize| {
                f64::from(f32::from_le_bytes([position[i], position[i + 1], position[i + 2], position[i + 3]]))
            };
            corner(&mut soup, DVec3::new(axis(0), axis(4), axis(8)))?;
        }
    }
    Ok(soup)
}

fn ascii(bytes: &[u8]) -> Result<Soup, String> {
    if !starts_with(bytes, b"solid") {
        return Err("it neither starts with \"solid\" nor has the length of a binary file".to_owned());
    }
    let mut soup = Soup::default();
    for (line, bytes) in (1..).zip(bytes.split(|&byte| byte == b'\n')) {
        if !starts_with(bytes, b"vertex") {
            continue;
        }
        let mut words =
            super::text(bytes).map_err(|what| format!("line {line}: {what}"))?.split_ascii_whitespace().skip(1);
        let mut next = || number(&mut words, line);
        corner(&mut soup, DVec3::new(next()?, next()?, next()?))?;
    }
    if soup.positions.len() % 3 != 0 {
        return Err("its last triangle has fewer than three corners".to_owned());
    }
    Ok(soup)
}
