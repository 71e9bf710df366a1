//! The machine on which run times were measured.

use std::fmt;

use crate::stream::machine;

/// The machine and the version of the program that ran on it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Machine {
    /// The processor's model name.
    pub cpu: String,
    /// Number of cores available to the program.
    pub cores: usize,
    /// Version of the program.
    pub version: &'static str,
}

impl Machine {
    /// The current machine.
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
    /// A description for measurements that use all cores.
    pub fn at_full_load(&self) -> impl fmt::Display + '_ {
        std::fmt::from_fn(|f| self.describe(f, self.cores))
    }

    fn describe(&self, f: &mut fmt::Formatter<'_>, used: usize) -> fmt::Result {
        write!(f, "{}, {used} of {} cores used; meldscope {}", self.cpu, self.cores, self.version)
    }
}
