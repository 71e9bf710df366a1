//! Formatting of numbers and text for output.

use std::{borrow::Cow, sync::OnceLock};

use glam::DVec3;
use unit_prefix::NumberPrefix;

/// The name under which the program was started, for texts that say what to type.
static PROGRAM: OnceLock<String> = OnceLock::new();

/// The name of the program on a command line.
pub fn program() -> &'static str {
    PROGRAM.get().map_or("meldscope", String::as_str)
}

/// Sets [`program`], once.
pub fn set_program(name: String) {
    let _ = PROGRAM.set(name);
}

/// A size in bytes, as "512 B" or "1.5 GiB".
pub fn bytes(n: u64) -> String {
    match NumberPrefix::binary(n as f64) {
        NumberPrefix::Standalone(n) => format!("{n} B"),
        NumberPrefix::Prefixed(prefix, n) => format!("{n:.1} {prefix}B"),
    }
}

/// A number with thousands separators: `1234567` as "1,234,567".
#[cfg(feature = "viewer")]
pub fn thousands(n: u64) -> String {
    indicatif::HumanCount(n).to_string()
}

/// A count with its noun: `1` as "1 step", `1234` as "1,234 steps".
#[cfg(feature = "viewer")]
pub fn counted(n: u64, noun: &str) -> String {
    let plural = match noun {
        _ if n == 1 => noun.to_owned(),
        "body" => "bodies".to_owned(),
        "vertex" => "vertices".to_owned(),
        _ => format!("{noun}s"),
    };
    format!("{} {plural}", thousands(n))
}

/// A list in prose: "a", "a and b", "a, b and c".
#[cfg(feature = "viewer")]
pub fn listed(list: &[String]) -> String {
    match list {
        [] => String::new(),
        [only] => only.clone(),
        [most @ .., last] => format!("{} and {last}", most.join(", ")),
    }
}

/// A table as lines, one per row, with the columns of the first aligned: to the left where `is_left`, otherwise to the
/// right.
#[cfg(feature = "cli")]
pub fn aligned(rows: &[Vec<String>], is_left: impl Fn(usize) -> bool) -> Vec<String> {
    let width = |column: usize| rows.iter().filter_map(|row| Some(row.get(column)?.chars().count())).max().unwrap_or(0);
    let widths: Vec<usize> = (0..rows.first().map_or(0, Vec::len)).map(width).collect();
    let line = |row: &Vec<String>| {
        let cells = row.iter().zip(&widths).enumerate().map(|(column, (cell, &width))| match is_left(column) {
            true => format!("{cell:<width$}"),
            false => format!("{cell:>width$}"),
        });
        cells.collect::<Vec<_>>().join("  ").trim_end().to_owned()
    };
    rows.iter().map(line).collect()
}

/// A step Δt [s], with enough digits to recognise it.
#[cfg(feature = "viewer")]
pub fn step_size(dt: f64) -> String {
    if dt >= 1e-4 { format!("{dt:.6}") } else { format!("{dt:e}") }
}

/// A number with three significant digits.
#[cfg(feature = "viewer")]
pub fn significant(x: f64) -> String {
    if x == 0.0 {
        return "0".to_owned();
    }
    let digits = 2 - x.abs().log10().floor().clamp(-9.0, 2.0) as i32;
    format!("{x:.*}", digits as usize)
}

/// A measured change of any magnitude, with its sign and four significant digits.
pub fn change(x: f64) -> String {
    let sign = if x > 0.0 { "+" } else { "" };
    format!("{sign}{}", short(x))
}

/// A written number without the zeros at the end of its fraction.
#[cfg(feature = "viewer")]
pub fn trimmed(number: &str) -> &str {
    if number.contains('.') { number.trim_end_matches('0').trim_end_matches('.') } else { number }
}

/// A measured number of any magnitude, with four significant digits.
pub fn short(x: f64) -> String {
    match x.abs() {
        0.0 => "0".to_owned(),
        1e-3..1e5 => format!("{x:.*}", (3 - x.abs().log10().floor() as i32).max(0) as usize),
        _ => format!("{x:.3e}"),
    }
}

/// The round numbers next to a positive one, ascending: 1, 2, 5 and 10 times the power of ten below it.
pub fn round_numbers(x: f64) -> [f64; 4] {
    let decade = 10f64.powf(x.log10().floor());
    [1.0, 2.0, 5.0, 10.0].map(|step| step * decade)
}

/// A number with at least three digits; large numbers have no fraction.
#[cfg(feature = "cli")]
pub fn number(x: f64) -> String {
    if x >= 100.0 { thousands(x.round() as u64) } else { significant(x) }
}

/// A vector in full precision, which is single for recorded positions.
pub fn vector(v: &DVec3) -> String {
    let [x, y, z] = v.to_array().map(|x| match x as f32 {
        single if f64::from(single) == x => format!("{single:?}"),
        _ => format!("{x:?}"),
    });
    format!("({x}, {y}, {z})")
}

/// `; did you mean "…"?` with the closest of the `known` words, or nothing if none is close.
pub fn did_you_mean<'k>(word: &str, known: impl Iterator<Item = &'k str>) -> String {
    let plain = |text: &str| text.to_lowercase().replace(['-', ' '], "_");
    let word: String = plain(&word.chars().take(64).collect::<String>()); // the distance takes O(length²) time
    let near = known.filter_map(|candidate| {
        let plain = plain(candidate);
        let abbreviated = word.len() >= 3 && plain.starts_with(&word);
        let distance = usize::min(strsim::osa_distance(&word, &plain), if abbreviated { 1 } else { usize::MAX });
        // a third of the letters, but never all letters of a short word
        let limit = usize::min((word.chars().count().max(candidate.chars().count()) + 1) / 3, 3);
        (distance <= limit).then_some((distance, candidate))
    });
    near.min_by_key(|(distance, _)| *distance).map_or(String::new(), |(_, word)| format!("; did you mean \"{word}\"?"))
}

/// Escapes `text` for output on one line: every character that a terminal would act on instead of showing. These are
/// control characters (C0, C1 and DEL: they move the cursor, set titles, erase), and characters that change the text
/// direction or end a line.
///
/// Use this for all text from files, including names and paths: their author is not trusted.
pub fn printable(text: &str) -> Cow<'_, str> {
    if !text.contains(is_unsafe) {
        return Cow::Borrowed(text);
    }
    let mut escaped = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        match c {
            c if c.is_control() => escaped.extend(c.escape_debug()),
            c if is_unsafe(c) => escaped.extend(c.escape_unicode()),
            c => escaped.push(c),
        }
    }
    Cow::Owned(escaped)
}

/// Whether a terminal acts on this character instead of showing it.
fn is_unsafe(c: char) -> bool {
    c.is_control()
        || matches!(c,
            '\u{61c}' | '\u{200e}' | '\u{200f}'         // direction marks
            | '\u{2028}' | '\u{2029}'                   // line and paragraph separators
            | '\u{202a}'..='\u{202e}'                   // embeddings and overrides
            | '\u{2066}'..='\u{2069}'                   // isolates
            | '\u{fff9}'..='\u{fffb}'                   // annotations
            | '\u{e0000}'..='\u{e007f}'                 // tags, which are invisible
        )
}

#[cfg(all(test, feature = "viewer"))]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn digits_are_grouped_and_nouns_agree() {
        let cases = [(0, "0 messages"), (1, "1 message"), (999, "999 messages"), (1_234, "1,234 messages")];
        for (n, expected) in cases {
            assert_eq!(counted(n, "message"), expected);
        }
        assert_eq!(counted(12_345_678, "byte"), "12,345,678 bytes");
        assert_eq!(
            [counted(1, "vertex"), counted(2, "vertex"), counted(2, "body")],
            ["1 vertex", "2 vertices", "2 bodies"]
        );
    }

    #[test]
    fn lists_are_joined_as_prose() {
        let of = |n: usize| listed(&["a", "b", "c"].map(str::to_owned)[..n]);
        assert_eq!([of(0), of(1), of(2), of(3)], ["", "a", "a and b", "a, b and c"]);
    }

    #[test]
    fn sizes_have_binary_prefixes() {
        let cases = [(0, "0 B"), (1023, "1023 B"), (1024, "1.0 KiB"), (1536 << 20, "1.5 GiB"), (u64::MAX, "16.0 EiB")];
        for (n, expected) in cases {
            assert_eq!(bytes(n), expected);
        }
    }

    #[test]
    fn only_characters_that_a_terminal_acts_on_are_escaped() {
        let cases = [
            ("größe 大きさ ~ q = 1.05 → b\\c", "größe 大きさ ~ q = 1.05 → b\\c"),
            ("\u{1b}[2J\u{1b}]0;title\u{7}", r"\u{1b}[2J\u{1b}]0;title\u{7}"),
            ("a\r\nb\tc\0\u{7f}", r"a\r\nb\tc\0\u{7f}"),
            ("\u{9b}31m\u{85}", r"\u{9b}31m\u{85}"),
            ("\u{202e}txt.exe\u{2066}\u{2028}", r"\u{202e}txt.exe\u{2066}\u{2028}"),
        ];
        for (text, expected) in cases {
            assert_eq!(printable(text), expected);
        }
    }

    /// Independent of the list above: Unicode's control characters, line separators and bidirectional controls.
    fn acts_on_terminal(c: char) -> bool {
        let code = u32::from(c);
        code < 0x20
            || (0x7f..0xa0).contains(&code)
            || [0x61c, 0x200e, 0x200f, 0x2028, 0x2029].contains(&code)
            || (0x202a..=0x202e).contains(&code)
            || (0x2066..=0x2069).contains(&code)
    }

    proptest! {
        #[test]
        fn no_control_character_remains(text in any::<String>(), more in prop::collection::vec(0u32..0x2100, 0..40)) {
            let text = text + &more.into_iter().filter_map(char::from_u32).collect::<String>();
            let shown = printable(&text).into_owned();
            prop_assert!(!shown.contains(acts_on_terminal), "{shown:?}");
            prop_assert_eq!(printable(&shown), shown.as_str());
        }
    }
}
