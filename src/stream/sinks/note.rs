//! Text fragments for messages to users.

use std::time::Duration;

use crate::sdk;

/// A duration as "5 s" or "0.5 s".
pub(super) fn seconds(duration: Duration) -> String {
    format!("{} s", (duration.as_secs_f64() * 10.0).round() / 10.0)
}

/// Advice on installing the viewer version that matches this program.
pub(super) fn install_help() -> String {
    let version = sdk::VERSION;
    format!(
        "install it with `python3 -m pip install rerun-sdk=={version}` \
         or `cargo install rerun-cli --version {version} --locked`"
    )
}

/// Advice on starting a viewer that was expected on this machine.
pub(super) fn viewer_help(local: bool) -> String {
    if local { format!(" (if `rerun` is missing: {})", install_help()) } else { String::new() }
}
