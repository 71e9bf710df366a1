//! Flags that interrupt long-running work.

use std::sync::atomic::{AtomicBool, Ordering};

/// Whether a flag, if there is one, is set.
pub fn is_raised(flag: Option<&AtomicBool>) -> bool {
    flag.is_some_and(|flag| flag.load(Ordering::Relaxed))
}
