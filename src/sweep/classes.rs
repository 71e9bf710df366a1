//! The outcomes of runs as small numbers.

use std::sync::Mutex;

use super::{row::Cell, run::Outcome};
use crate::{
    lock,
    svg::{GREEN, ORANGE, PURPLE, SKY_BLUE},
};

/// The class of a run that failed.
pub const FAILED: u8 = u8::MAX - 1;
/// The class of all outcomes beyond those that can be told apart.
const OTHER: u8 = FAILED - 1;

/// Colours of the classes, distinguishable with any colour vision (Okabe & Ito 2008), which repeat.
const COLORS: [([u8; 3], &str); 5] =
    [([222, 222, 222], "light grey"), (SKY_BLUE, "light blue"), (ORANGE, "orange"), (GREEN, "green"), (PURPLE, "pink")];

/// The classes of a sweep: of a scene, its [outcomes](Outcome::ALL); of another experiment, those that occur, as they do.
#[derive(Debug)]
pub struct Classes {
    names: Mutex<Vec<String>>,
    are_known: bool,
}

impl Classes {
    /// Those of scenes.
    pub fn of_scenes() -> Classes {
        let names = Outcome::ALL.iter().map(|outcome| outcome.name().to_owned()).collect();
        Classes { names: Mutex::new(names), are_known: true }
    }

    /// None yet.
    pub fn open() -> Classes {
        Classes { names: Mutex::default(), are_known: false }
    }

    /// New classes of the same kind, without the outcomes found so far.
    pub fn afresh(&self) -> Classes {
        if self.are_known { Classes::of_scenes() } else { Classes::open() }
    }

    /// The class of an outcome.
    pub fn of(&self, outcome: Option<&Cell>) -> u8 {
        let Some(Cell::Text(name)) = outcome else { return FAILED };
        let mut names = lock(&self.names);
        match names.iter().position(|known| known == name) {
            Some(class) => class as u8,
            None if self.are_known => FAILED,
            None if names.len() >= usize::from(OTHER) => OTHER,
            None => {
                names.push(name.clone());
                names.len() as u8 - 1
            }
        }
    }

    /// The name of a class.
    pub fn name(&self, class: u8) -> String {
        let names = lock(&self.names);
        let other = || if class == OTHER { "another outcome".to_owned() } else { "failed".to_owned() };
        names.get(usize::from(class)).cloned().unwrap_or_else(other)
    }
}

impl Classes {
    /// What a class says of a run, as a sentence; empty if that is not known.
    pub fn about(&self, class: u8) -> &'static str {
        match (class, Outcome::ALL.get(usize::from(class))) {
            (FAILED, _) => "The run failed.",
            (_, Some(outcome)) if self.are_known => outcome.about(),
            _ => "",
        }
    }
}

/// The colour of a class, and its name.
pub fn color(class: u8) -> ([u8; 3], &'static str) {
    match class {
        FAILED => ([60, 60, 60], "dark grey"),
        class => COLORS[usize::from(class) % COLORS.len()],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outcomes_have_classes() {
        let text = |name: &str| Cell::Text(name.to_owned());
        let scenes = Classes::of_scenes();
        assert_eq!(
            [scenes.of(Some(&text("merged"))), scenes.of(Some(&Cell::Null)), scenes.of(None)],
            [2, FAILED, FAILED]
        );
        assert_eq!((scenes.name(2), scenes.name(FAILED)), ("merged".to_owned(), "failed".to_owned()));
        let own = Classes::open();
        let found = ["none", "grip slip", "none"].map(|name| own.of(Some(&text(name))));
        assert_eq!((found, own.name(1)), ([0, 1, 0], "grip slip".to_owned()));
        let many: Vec<u8> = (0..300).map(|i| own.of(Some(&text(&i.to_string())))).collect();
        assert_eq!((many[0], many[299], own.name(OTHER)), (2, OTHER, "another outcome".to_owned()));
        assert_eq!(own.afresh().of(Some(&text("grip slip"))), 0);
    }
}
