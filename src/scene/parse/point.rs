//! `[[point]]`: force points.

use super::{Names, SceneError, key, pairs::read_side, read_motion, reader::Table};
use crate::{
    model::influence::Influence,
    scene::{
        Body, Members, Point,
        keys::{ACTS, BODIES_FORM},
    },
};

/// Limit on the number of tables.
const MAX_POINTS: usize = 1000;

/// The force points in these tables.
pub(super) fn read(
    tables: &[Table<'_>],
    bodies: &[Body],
    names: &Names,
    influence: &Influence,
) -> Result<Vec<Point>, SceneError> {
    if let Some(table) = tables.get(MAX_POINTS) {
        let message = format!("expected at most {MAX_POINTS} [[point]]s, found {}", tables.len());
        return Err(table.error("name", message).with_help("every body is tested against every force point"));
    }
    let points = tables.iter().map(|table| read_one(table, bodies, names, influence)).collect::<Result<Vec<_>, _>>()?;
    for (index, point) in points.iter().enumerate() {
        let Some(first) = points[..index].iter().position(|other| other.name == point.name) else { continue };
        if let (Some(first), Some(again)) = (tables[first].get("name"), tables[index].get("name")) {
            let line = first.line();
            return Err(again
                .unexpected(format_args!("a name that no other point has (the point at line {line} has this one)")));
        }
    }
    Ok(points)
}

fn read_one(table: &Table<'_>, bodies: &[Body], names: &Names, influence: &Influence) -> Result<Point, SceneError> {
    let name = table.text(key!(POINTS.name))?;
    let path = read_motion(table, |free| {
        let message = "expected a path: fixed, line, sine or keyframes; found free".to_owned();
        Err(free.error(message).with_help("nothing acts on a force point, so it cannot move by itself"))
    })?;
    let radius = table.number(key!(POINTS.radius))?;
    let attracts = table.word(key!(POINTS.act), &ACTS)?;
    let (alpha, beta) = (key!(STRENGTH.alpha), key!(STRENGTH.beta));
    let (own, other, acts) = if attracts { (alpha, beta, "attracts") } else { (beta, alpha, "repels") };
    if let Some(value) = table.get(other.name) {
        let message = format!("unexpected: this point {acts}, and its strength is {}", own.name);
        return Err(value.error(message).with_help(format!("write {}, or change act", own.name)));
    }
    let strength = table.given_number(own)?;
    Ok(Point {
        name,
        path,
        radius,
        strength: if attracts { strength.unwrap_or(influence.alpha) } else { -strength.unwrap_or(influence.beta) },
        bodies: read_bodies(table, bodies, names)?,
        start: table.number(key!(POINTS.start))?,
        duration: table.given_number(key!(POINTS.duration))?.unwrap_or(f64::INFINITY),
    })
}

fn read_bodies(table: &Table<'_>, bodies: &[Body], names: &Names) -> Result<Option<Vec<u32>>, SceneError> {
    let Some(value) = table.get("bodies") else { return Ok(None) };
    let items = value.items().filter(|items| items.len() > 0).ok_or_else(|| value.unexpected(BODIES_FORM))?;
    let mut found = Vec::new();
    for item in items {
        match read_side(&item, bodies, names)? {
            Members::Body(body) => found.push(body),
            Members::Group(group) => {
                let is_in = |body: &Body| body.group.as_ref().and_then(|name| names.groups.get(name)) == Some(&group);
                found.extend((0..).zip(bodies).filter(|(_, body)| is_in(body)).map(|(index, _)| index));
            }
        }
    }
    found.sort_unstable();
    found.dedup();
    Ok(Some(found))
}
