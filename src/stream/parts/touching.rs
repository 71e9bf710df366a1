//! With several variants of a scene side by side: which surfaces touch in each, as one lane per variant.

use super::FrameView;
use crate::{
    colors::GREY,
    observe::surface::PairMeasures,
    sdk::{StateChange, StateConfiguration},
    stream::{
        chunks::Chunks,
        contract::TOUCHING,
        palette::{self, color},
    },
    text::counted,
};

/// A state names this many pairs at most.
const MOST_NAMED: usize = 2;
/// With more states than this, new ones only say how many pairs touch.
const MOST_STATES: usize = 48;
const NONE: &str = "none";

/// The lanes, with what was last logged.
#[derive(Default)]
pub struct Touching {
    /// The state of each variant.
    last: Vec<String>,
    /// All states so far: a state has the same colour in all lanes.
    known: Vec<String>,
}

impl Touching {
    /// Logs which of `pairs` touch, by their measures, where it has changed.
    pub fn log(
        &mut self,
        view: FrameView<'_>,
        pairs: &[[usize; 2]],
        measures: &[Option<PairMeasures>],
        chunks: &mut Chunks,
    ) {
        let (schema, size) = (view.schema, view.schema.variant_size());
        self.last.resize(schema.variants.len(), String::new());
        let touching = || {
            let is_touching = |of: &Option<PairMeasures>| of.as_ref().is_some_and(|measures| measures.gap <= 0.0);
            pairs.iter().zip(measures).filter(move |(_, of)| is_touching(of)).map(|([a, b], _)| (*a, *b))
        };
        let mut is_new = false;
        let mut changed = Vec::new();
        for (number, (variant, last)) in schema.variants.iter().zip(&mut self.last).enumerate() {
            let names = touching().filter(|(a, _)| a / size == number);
            let names: Vec<String> =
                names.map(|(a, b)| format!("{}~{}", schema.plain_name(a), schema.plain_name(b))).collect();
            let state = state(&names, &self.known);
            if *last == state {
                continue;
            }
            if !self.known.contains(&state) {
                self.known.push(state.clone());
                is_new = true;
            }
            last.clone_from(&state);
            changed.push((TOUCHING.of(&[variant.name]), state));
        }
        if is_new {
            let hues = (0..).scan(0, |hue, at: usize| {
                let is_none = self.known.get(at)? == NONE;
                let rgb = if is_none { GREY } else { palette::distance(*hue) };
                *hue += usize::from(!is_none);
                Some(color(rgb))
            });
            let states = StateConfiguration::new()
                .with_values(self.known.iter().map(String::as_str))
                .with_labels(self.known.iter().map(String::as_str))
                .with_colors(hues);
            schema.variants.iter().for_each(|of| chunks.log_static(&TOUCHING.of(&[of.name]), &states));
        }
        changed.iter().for_each(|(lane, state)| chunks.log(lane, view.at, &StateChange::single(state.as_str())));
    }
}

/// The state in which these pairs touch.
fn state(names: &[String], known: &[String]) -> String {
    if names.is_empty() {
        return NONE.to_owned();
    }
    let named = names.join(", ");
    match names.len() <= MOST_NAMED && (known.len() < MOST_STATES || known.contains(&named)) {
        true => named,
        false => counted(names.len() as u64, "pair"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_known_state_keeps_its_name_among_many() {
        let known: Vec<String> = (0..MOST_STATES).map(|k| format!("a~{k}")).collect();
        assert_eq!(state(&["a~1".to_owned()], &known), "a~1");
        assert_eq!(state(&["b~1".to_owned()], &known), "1 pair");
        assert_eq!(state(&["b~1".to_owned()], &known[1..]), "b~1");
        assert_eq!(state(&[], &known), NONE);
    }
}
