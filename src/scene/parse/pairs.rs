//! `[[pair]]`: laws of pairs of bodies or groups.

use super::{Names, SceneError, read_law, reader::Table, reader::Value, unknown_name};
use crate::{
    model::PairLaw,
    scene::{
        Body,
        keys::SIDES_FORM,
        pairs::{Members, PairLaws},
    },
};

/// Limit on the number of tables; with groups, far fewer suffice.
const MAX_TABLES: usize = 10_000;

/// The laws of pairs in these tables; missing keys are as in `common`.
pub(super) fn read(
    tables: &[Table<'_>],
    bodies: &[Body],
    names: &Names,
    common: PairLaw,
) -> Result<PairLaws, SceneError> {
    if tables.is_empty() {
        return Ok(PairLaws::default());
    }
    if let Some(table) = tables.get(MAX_TABLES) {
        let message = format!("expected at most {MAX_TABLES} [[pair]]s, found {}", tables.len());
        return Err(table.error("bodies", message).with_help("give bodies a group, and the law to the group"));
    }
    let mut rules = Vec::with_capacity(tables.len());
    for table in tables {
        rules.push((read_sides(table, bodies, names)?, read_law(table, common)?));
    }
    let group_of = bodies.iter().map(|body| names.groups.get(body.group.as_ref()?).copied()).collect();
    PairLaws::new(group_of, &rules).map_err(|overlap| {
        let [earlier, later] = [overlap.earlier, overlap.later].map(|index| &tables[index]);
        let line = earlier.line();
        let message = format!("expected pairs without a [[pair]] so far, found some of the one at line {line}");
        later
            .error("bodies", message)
            .with_help("each pair of bodies can have one [[pair]]: join the two, or divide the groups")
    })
}

fn read_sides(table: &Table<'_>, bodies: &[Body], names: &Names) -> Result<[Members; 2], SceneError> {
    let value = table.present("bodies", SIDES_FORM)?;
    let sides = value.items().filter(|items| items.len() == 2).ok_or_else(|| value.unexpected(SIDES_FORM))?;
    let sides = sides.map(|side| read_side(&side, bodies, names)).collect::<Result<Vec<_>, _>>()?;
    match sides[..] {
        [Members::Body(a), Members::Body(b)] if a == b => Err(value
            .error("expected two bodies, found one twice".to_owned())
            .with_help("name the body and another one")),
        [a, b] => Ok([a, b]),
        _ => Err(value.unexpected(SIDES_FORM)),
    }
}

pub(super) fn read_side(value: &Value<'_>, bodies: &[Body], names: &Names) -> Result<Members, SceneError> {
    let name = value.text().ok_or_else(|| value.unexpected("the name of a body or a group"))?;
    let body = names.bodies.get(name).map(|&index| Members::Body(index));
    let found = body.or_else(|| names.groups.get(name).map(|&group| Members::Group(group)));
    found.ok_or_else(|| {
        let groups: std::collections::BTreeSet<&str> = names.groups.keys().map(String::as_str).collect();
        let known = || groups.iter().copied().chain(bodies.iter().map(|body| body.name.as_str()));
        unknown_name(value, "the name of a body or a group", known)
    })
}
