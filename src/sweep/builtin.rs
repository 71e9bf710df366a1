//! Sweeps that are compiled in, and their maps.
//!
#![doc = include_str!("../../recordings/speed_offset.svg")]
//!
#![doc = include_str!("../../recordings/speed_merge_at.svg")]
//!
#![doc = include_str!("../../recordings/alpha_split_at.svg")]
//!
#![doc = include_str!("../../recordings/size_mass.svg")]

/// A sweep that is compiled into the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Builtin {
    /// Its name on the command line.
    pub name: &'static str,
    /// The sweep file.
    pub text: &'static str,
}

/// All built-in sweeps. Approach speed and offset are the axes of regime maps of droplet collisions (Ashgriz and Poo
/// 1990, Qian and Law 1997: Weber number and impact parameter). The last sweep measures the overhead of a sweep in
/// addition to its steps.
pub const ALL: [Builtin; 5] = [
    Builtin {
        name: "speed_merge_at",
        text: r#"# Two balls: approach speed × merge_at
scene = "collide"

[[axis]]
key = "body.left.motion.free.velocity[0]"
name = "approach speed [radii/s]"
from = 0.25
to = 8.25
count = 33

[[axis]]
key = "influence.merge_at"
name = "merge_at"
from = 0.75
to = 1.15
count = 17

[[set]]
key = "body.right.motion.free.velocity[0]"
value = 0.0

[[set]]
key = "duration"
value = 12.0
"#,
    },
    Builtin {
        name: "speed_offset",
        text: r#"# Two balls: approach speed × offset
scene = "collide"

[[axis]]
key = "body.left.motion.free.velocity[0]"
name = "approach speed [radii/s]"
from = 0.25
to = 8.25
count = 33

[[axis]]
key = "body.left.motion.free.from[1]"
name = "offset [radii]"
from = 0.0
to = 2.4
count = 25

[[set]]
key = "body.right.motion.free.from[1]"
value = 0.0

[[set]]
key = "body.right.motion.free.velocity[0]"
value = 0.0

[[set]]
key = "duration"
value = 12.0
"#,
    },
    Builtin {
        name: "alpha_split_at",
        text: r#"# Two bodies on their paths: alpha × split_at
scene = "two"
measures = ["displacement"]
color = "max_displacement"
until = "end"

[[axis]]
key = "influence.alpha"
name = "alpha [1/s²]"
from = 0.0
to = 600.0
count = 25

[[axis]]
key = "influence.split_at"
name = "split_at"
from = 1.05
to = 1.45
count = 33
"#,
    },
    Builtin {
        name: "size_mass",
        text: r#"# A body thrown at another: size ratio × mass ratio, under both scalings
scene = "collide"

[[axis]]
key = "influence.scaling"
name = "scaling"
values = ["relative", "absolute"]

[[axis]]
key = "body.left.radius"
name = "size ratio"
from = 0.1
to = 1.0
count = 19
scale = "log"

[[axis]]
key = "body.left.mass"
name = "mass ratio"
from = 0.001
to = 10.0
count = 17
scale = "log"

[[set]]
key = "body.left.motion.free.velocity[0]"
value = 3.0

[[set]]
key = "body.right.motion.free.velocity[0]"
value = 0.0

[[set]]
key = "duration"
value = 12.0
"#,
    },
    Builtin {
        name: "runs_of_two",
        text: r#"# A million runs of two, 300 steps each
scene = "two"
until = "end"

[[axis]]
key = "influence.alpha"
from = 100.0
to = 300.0
count = 1000

[[axis]]
key = "influence.beta"
from = 60.0
to = 180.0
count = 1000
"#,
    },
];

/// The built-in sweep with this name.
pub fn named(name: &str) -> Option<&'static Builtin> {
    ALL.iter().find(|builtin| builtin.name == name)
}

#[cfg(test)]
mod tests {
    use crate::sweep::Sweep;

    #[test]
    fn built_in_sweeps_are_valid() {
        for builtin in super::ALL {
            let sweep = Sweep::parse(builtin.text, builtin.name, None).map(|_| ()).map_err(|error| error.to_string());
            assert_eq!(sweep, Ok(()), "{}", builtin.name);
        }
    }
}
