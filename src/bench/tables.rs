//! What the tables of several benchmarks have in common.

use super::error::table::significant;
use crate::stream::sinks::thousands;

/// Columns side by side: the first flush left, the others flush right.
pub(super) fn aligned<const N: usize>(rows: &[[String; N]]) -> Vec<String> {
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let widths: [usize; N] = std::array::from_fn(width);
    let line = |row: &[String; N]| {
        let cell = |(column, text): (usize, &String)| {
            let padding = " ".repeat(widths[column] - text.chars().count());
            if column == 0 { format!("{text}{padding}") } else { format!("  {padding}{text}") }
        };
        row.iter().enumerate().map(cell).collect::<String>().trim_end().to_owned()
    };
    rows.iter().map(line).collect()
}

/// Three digits at least, and no fractions of large numbers.
pub(super) fn number(x: f64) -> String {
    if x >= 100.0 { thousands(x.round() as u64) } else { significant(x) }
}
