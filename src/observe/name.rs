//! Names that are made while the program runs.

use std::{collections::HashSet, sync::Mutex};

/// A name for a schema or an event that is made while the program runs, such as that of the scalar of one of many parts.
/// Equal texts give the same name. Each is kept until the program ends, so that events need no memory of their own: make
/// them from what a simulation is built of, not from what happens in it.
pub fn name(text: &str) -> &'static str {
    static KNOWN: Mutex<Option<HashSet<&'static str>>> = Mutex::new(None);
    let mut known = crate::lock(&KNOWN);
    let known = known.get_or_insert_default();
    match known.get(text) {
        Some(known) => known,
        None => {
            let new: &'static str = Box::leak(text.to_owned().into_boxed_str());
            known.insert(new);
            new
        }
    }
}
