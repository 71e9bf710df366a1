//! The machine on which a recording was made.

use sysinfo::{CpuRefreshKind, RefreshKind, System};

/// The processor's model name.
pub fn processor() -> String {
    let system = System::new_with_specifics(RefreshKind::nothing().with_cpu(CpuRefreshKind::nothing()));
    let brand = system.cpus().first().map(|cpu| cpu.brand().trim()).filter(|brand| !brand.is_empty());
    brand.map_or_else(|| format!("a {} processor", std::env::consts::ARCH), str::to_owned)
}

/// Operating system, architecture and processor: a result could depend on these, though it should not.
pub fn describe() -> String {
    format!("{} {}, {}", std::env::consts::OS, std::env::consts::ARCH, processor())
}
