//! The scenes measured in addition to those that the user names.

use std::fmt::Write as _;

use crate::scene::{Scene, SceneError};

/// Two bodies that meet and separate every four seconds, forever, like the pairs of `bench scale`. Kept as text,
/// because a recording is replayed from its scene text.
const PAIR: &str = r#"name = "pair"
duration = 100.0

[influence]
split_at = 1.2

[[body]]
name = "still"
radius = 1.0
motion = { fixed = [0, 0, 0] }

[[body]]
name = "moving"
radius = 1.0
motion = { sine = { center = [2.2, 0, 0], amplitude = [0.24, 0, 0], frequency = 0.25 } }
"#;

/// The scene of the pair.
///
/// # Errors
/// None: the text is a constant.
pub fn pair() -> Result<Scene, SceneError> {
    Scene::parse(PAIR, "pair")
}

/// The pair and this many bodies that it does not affect, half of which oscillate after a push.
///
/// # Errors
/// None: the generated text is valid.
pub fn pair_among(others: usize) -> Result<Scene, SceneError> {
    let mut text = PAIR.replace("\"pair\"", &format!("\"pair among {others}\""));
    for i in 0..others {
        let x = 10 * i;
        let _ = write!(
            text,
            "\n[[body]]\nname = \"b{i}\"\nradius = 1.0\nshape = {{ sphere = {{ stacks = 4, slices = 6 }} }}\n\
             motion = {{ fixed = [{x}, 50, 0] }}\n"
        );
        if i % 2 == 0 {
            let _ = write!(
                text,
                "\n[[push]]\nbody = \"b{i}\"\ndirection = [1, 0, 0]\nstrength = 9.0\nstart = 0.0\nduration = 0.05\n"
            );
        }
    }
    Scene::parse(&text, "pair")
}

/// A scene file with this many bodies in the style of the built-in `crowd`: a field at rest, in which one body in fifty
/// drifts to its neighbours and back.
pub fn crowd(bodies: usize) -> String {
    /// Distance between centres at which bodies do not touch [radii].
    const PITCH: f64 = 2.6;
    let columns = ((1.6 * bodies as f64).sqrt().ceil() as usize).max(1);
    let rows = bodies.div_ceil(columns);
    let mut text = format!(
        "# {bodies} spheres in a field, of which one in fifty drifts to its neighbours and back.\nname = \"crowd of {bodies}\"\n\
         duration = 4.0\n\n[material]\nresponse = \"rigid\"\n\n[influence]\nalpha = 120.0\n"
    );
    for index in 0..bodies {
        let (column, row) = (index % columns, index / columns);
        let centred = |index: usize, count: usize| PITCH * (index as f64 - 0.5 * (count as f64 - 1.0));
        let (x, y) = (centred(column, columns), centred(row, rows));
        let motion = if column % 8 == 4 && row % 6 == 3 {
            let amplitude = if row % 12 == 3 { "[0.9, 0, 0]" } else { "[0, 0.9, 0]" };
            format!("sine = {{ center = [{x:.1}, {y:.1}, 0], amplitude = {amplitude}, frequency = 0.4 }}")
        } else {
            format!("fixed = [{x:.1}, {y:.1}, 0]")
        };
        let _ = write!(text, "\n[[body]]\nname = \"b{index:04}\"\nradius = 1.0\nmotion = {{ {motion} }}\n");
    }
    text
}
