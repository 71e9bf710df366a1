//! The machine that a run time belongs to.

use std::fmt;

use crate::stream::machine;

/// Which machine, and which program on it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Machine {
    /// What the processor calls itself.
    pub cpu: String,
    /// How many cores the program may use.
    pub cores: usize,
    /// Version of this program.
    pub version: &'static str,
}

impl Machine {
    /// This one.
    pub fn detect() -> Machine {
        Machine {
            cpu: machine::processor(),
            cores: std::thread::available_parallelism().map_or(1, |cores| cores.get()),
            version: env!("CARGO_PKG_VERSION"),
        }
    }
}

impl fmt::Display for Machine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.describe(f, 1)
    }
}

impl Machine {
    /// It, for what was run on all cores.
    pub fn at_full_load(&self) -> impl fmt::Display + '_ {
        std::fmt::from_fn(|f| self.describe(f, self.cores))
    }

    fn describe(&self, f: &mut fmt::Formatter<'_>, used: usize) -> fmt::Result {
        write!(f, "{}, {used} of {} cores used; meldscope {}", self.cpu, self.cores, self.version)
    }
}
