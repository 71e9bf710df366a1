//! `[[grid]]`: many bodies from one description.

use glam::DVec3;

use super::{Body, Inherited, SceneError, Table, Value, key, meshes::Meshes, reader::is_body_name};
use crate::{
    random::Random,
    scene::{
        Motion, Path,
        keys::{COUNT_FORM, LARGEST},
    },
};

/// Limit on the bodies of all grids of a scene together, and on the keys of their paths.
const MAX_BODIES: u64 = 1_000_000;

/// Appends the bodies of these tables, and for each body its table.
pub(super) fn read<'t, 's>(
    tables: &'t [Table<'s>],
    inherited: Inherited,
    meshes: &mut Meshes<'_>,
    bodies: &mut Vec<Body>,
    from: &mut Vec<&'t Table<'s>>,
) -> Result<(), SceneError> {
    let mut room = MAX_BODIES;
    for table in tables {
        let first = super::read_body(table, inherited, meshes)?;
        let value = table.present("count", COUNT_FORM)?;
        let counts = read_count(&value)?;
        let keys = match &first.motion {
            Motion::Prescribed(Path::Keyframes(spline)) => spline.key_count() as u64,
            _ => 1,
        };
        let all = counts.iter().fold(keys, |all, &count| all.saturating_mul(u64::from(count)));
        room = room.checked_sub(all).ok_or_else(|| {
            let [x, y, z] = counts;
            let with_keys = if keys > 1 { format!(", each with {keys} keys") } else { String::new() };
            value.error(format!(
                "expected at most {MAX_BODIES} bodies, or keys of their paths, of all grids together, found {x} × {y} × {z} \
                bodies{with_keys}"
            ))
        })?;
        let spacing = table.vector(key!(GRIDS.spacing))?;
        let jitter = table.number(key!(GRIDS.jitter))?;
        let seed = table.integer(key!(GRIDS.seed))?;
        let name = |[x, y, z]: [u32; 3]| format!("{}-{x}-{y}-{z}", first.name);
        let last = name(counts.map(|count| count - 1));
        if !is_body_name(&last) {
            let message = format!("expected a name that leaves room for the indices, found one that makes \"{last}\"");
            return Err(table.error("name", message).with_help("names have at most 64 characters"));
        }
        let mut random = Random::new(u64::from(seed));
        for z in 0..counts[2] {
            for y in 0..counts[1] {
                for x in 0..counts[0] {
                    let offset = DVec3::new(f64::from(x), f64::from(y), f64::from(z)) * spacing;
                    let jittered = DVec3::from_array(std::array::from_fn(|_| random.signed()));
                    let motion = first.motion.moved_by(offset + jitter * jittered);
                    let farthest = motion.start().abs().max_element();
                    if !(farthest <= LARGEST) {
                        let message =
                            format!("expected bodies at coordinates of at most {LARGEST:e}, found {farthest:e}");
                        return Err(table.error("spacing", message));
                    }
                    bodies.push(Body { name: name([x, y, z]), motion, ..first.clone() });
                    from.push(table);
                }
            }
        }
    }
    Ok(())
}

fn read_count(value: &Value<'_>) -> Result<[u32; 3], SceneError> {
    let items = value.items().filter(|items| items.len() == 3).ok_or_else(|| value.unexpected(COUNT_FORM))?;
    let mut counts = [0; 3];
    for (count, item) in counts.iter_mut().zip(items) {
        *count = item.integer([1, MAX_BODIES as u32])?;
    }
    Ok(counts)
}
