//! Words and figures for people.

use std::time::Duration;

/// `1234567` as "1,234,567".
pub fn thousands(n: u64) -> String {
    let digits = n.to_string();
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// `1` as "1 message", `1234` as "1,234 messages".
pub(super) fn counted(n: u64, noun: &str) -> String {
    format!("{} {noun}{}", thousands(n), if n == 1 { "" } else { "s" })
}

/// A duration as "5 s" or "0.5 s".
pub(super) fn seconds(duration: Duration) -> String {
    format!("{} s", (duration.as_secs_f64() * 10.0).round() / 10.0)
}

/// How to get the viewer that fits this program.
pub(super) fn install_help() -> String {
    let version = rerun::build_info().version;
    format!(
        "install it with `python3 -m pip install rerun-sdk=={version}` \
         or `cargo install rerun-cli --version {version} --locked`"
    )
}

/// How to get a viewer that should have been on this machine.
pub(super) fn viewer_help(local: bool) -> String {
    if local { format!(" (if `rerun` is missing: {})", install_help()) } else { String::new() }
}

/// `list` as "a", "a and b", "a, b and c".
pub(super) fn listed(list: &[String]) -> String {
    match list {
        [] => String::new(),
        [only] => only.clone(),
        [most @ .., last] => format!("{} and {last}", most.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_grouped_and_nouns_agree() {
        let cases = [(0, "0 messages"), (1, "1 message"), (999, "999 messages"), (1_234, "1,234 messages")];
        for (n, expected) in cases {
            assert_eq!(counted(n, "message"), expected);
        }
        assert_eq!(counted(12_345_678, "byte"), "12,345,678 bytes");
    }

    #[test]
    fn lists_read_as_sentences() {
        let of = |n: usize| listed(&["a", "b", "c"].map(str::to_owned)[..n]);
        assert_eq!([of(0), of(1), of(2), of(3)], ["", "a", "a and b", "a, b and c"]);
    }
}
