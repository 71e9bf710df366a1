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
    Builtin { name: "speed_merge_at", text: include_str!("builtin/speed_merge_at.toml") },
    Builtin { name: "speed_offset", text: include_str!("builtin/speed_offset.toml") },
    Builtin { name: "alpha_split_at", text: include_str!("builtin/alpha_split_at.toml") },
    Builtin { name: "size_mass", text: include_str!("builtin/size_mass.toml") },
    Builtin { name: "runs_of_two", text: include_str!("builtin/runs_of_two.toml") },
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
