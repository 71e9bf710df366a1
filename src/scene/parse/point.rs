//! `[[point]]`: force points.

use super::{
    BODY_NAME, NON_NEGATIVE, Names, POSITIVE, SceneError,
    pairs::read_side,
    read_motion,
    reader::{Choice, Table},
};
use crate::{
    model::influence::Influence,
    scene::{Body, Members, Point},
};

/// Limit on the number of tables.
const MAX_POINTS: usize = 1000;

const BODIES: &str = "an array of one or more names of bodies or groups";

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
    let name = table.required("name", BODY_NAME)?;
    let path = read_motion(table, |free| {
        let message = "expected a path: fixed, line, sine or keyframes; found free".to_owned();
        Err(free.error(message).with_help("nothing acts on a force point, so it cannot move by itself"))
    })?;
    let radius = table.required("radius", POSITIVE)?;
    let attracts = table.required("act", Choice([("attract", true), ("repel", false)]))?;
    let [own, other, act] = if attracts { ["alpha", "beta", "attracts"] } else { ["beta", "alpha", "repels"] };
    if let Some(value) = table.get(other) {
        let message = format!("unexpected: this point {act}, and its strength is {own}");
        return Err(value.error(message).with_help(format!("write {own}, or change act")));
    }
    let strength = table.optional(own, NON_NEGATIVE)?;
    Ok(Point {
        name,
        path,
        radius,
        strength: if attracts { strength.unwrap_or(influence.alpha) } else { -strength.unwrap_or(influence.beta) },
        bodies: read_bodies(table, bodies, names)?,
        start: table.optional("start", NON_NEGATIVE)?.unwrap_or(0.0),
        duration: table.optional("duration", NON_NEGATIVE)?.unwrap_or(f64::INFINITY),
    })
}

fn read_bodies(table: &Table<'_>, bodies: &[Body], names: &Names) -> Result<Option<Vec<u32>>, SceneError> {
    let Some(value) = table.get("bodies") else { return Ok(None) };
    let items = value.items().filter(|items| items.len() > 0).ok_or_else(|| value.unexpected(BODIES))?;
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
