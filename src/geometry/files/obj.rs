//! Wavefront OBJ: `v x y z` and `f a b c …`, indices from 1, or from the end if negative. A `\` at the end of a line
//! continues it.

use std::borrow::Cow;

use glam::DVec3;

use super::{Soup, number};

pub fn parse(bytes: &[u8]) -> Result<Soup, String> {
    let mut soup = Soup::default();
    let mut corners = Vec::new();
    // material names may be in any encoding; positions and faces are ASCII
    let bytes = bytes.strip_prefix("\u{feff}".as_bytes()).unwrap_or(bytes); // a byte-order mark
    let mut lines = (1..).zip(bytes.split(|&byte| byte == b'\n'));
    while let Some((line, bytes)) = lines.next() {
        if !matches!(bytes.trim_ascii_start(), [b'v' | b'f', b' ' | b'\t', ..]) {
            continue;
        }
        let mut text = Cow::Borrowed(super::text(bytes).map_err(|what| format!("line {line}: {what}"))?);
        while let Some(begun) = text.trim_ascii_end().strip_suffix('\\').map(str::len) {
            let (_, next) = lines.next().unwrap_or_default();
            let text = text.to_mut();
            text.replace_range(begun.., " ");
            text.push_str(super::text(next).map_err(|what| format!("line {line}: {what}"))?.trim_ascii());
        }
        let mut words = text.split_ascii_whitespace();
        match words.next() {
            Some("v") => {
                let mut next = || number(&mut words, line);
                soup.positions.push(DVec3::new(next()?, next()?, next()?));
            }
            Some("f") => {
                corners.clear();
                for word in words.take_while(|word| !word.starts_with('#')) {
                    let index = word.split('/').next().and_then(|index| index.parse::<i64>().ok());
                    let count = soup.positions.len() as i64;
                    let index = match index {
                        Some(index) if index > 0 => index - 1,
                        Some(index) if index < 0 => count.saturating_add(index),
                        _ => return Err(format!("line {line}: a face needs numbers of vertices, from 1")),
                    };
                    corners.push(u32::try_from(index).map_err(|_| format!("line {line}: there is no vertex {word}"))?);
                }
                soup.polygon(&corners).map_err(|what| format!("line {line}: {what}"))?;
            }
            _ => {}
        }
    }
    Ok(soup)
}
