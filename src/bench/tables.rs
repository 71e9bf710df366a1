//! Measurements as tables for the terminal and as CSV.

use comfy_table::{CellAlignment, Row, presets};
use serde::Serialize;

/// A table with the first column left-aligned and the others right-aligned.
pub(super) fn table(heading: impl Into<Row>, rows: impl IntoIterator<Item: Into<Row>>) -> String {
    let mut table = comfy_table::Table::new();
    table.load_preset(presets::NOTHING).add_row(heading).add_rows(rows);
    for (k, column) in table.column_iter_mut().enumerate() {
        let (gap, alignment) = if k == 0 { (0, CellAlignment::Left) } else { (2, CellAlignment::Right) };
        column.set_padding((gap, 0)).set_cell_alignment(alignment);
    }
    table.trim_fmt()
}

/// Placeholder for values that do not apply.
pub(super) fn missing() -> String {
    "–".to_owned()
}

/// A header, then one self-contained line per row; fields that do not apply are empty.
///
/// # Errors
/// None is known to occur.
pub(super) fn csv(rows: impl IntoIterator<Item: Serialize>) -> Result<String, String> {
    let mut writer = ::csv::Writer::from_writer(vec![]);
    rows.into_iter().try_for_each(|row| writer.serialize(row)).map_err(|error| error.to_string())?;
    let bytes = writer.into_inner().map_err(|error| error.to_string())?;
    String::from_utf8(bytes).map_err(|error| error.to_string())
}
