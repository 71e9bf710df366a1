//! Measurements as tables for people, and as comma-separated values for programs.

use comfy_table::{CellAlignment, Row, presets};
use serde::Serialize;

/// Columns side by side: the first flush left, the others flush right.
pub(super) fn table(heading: impl Into<Row>, rows: impl IntoIterator<Item: Into<Row>>) -> String {
    let mut table = comfy_table::Table::new();
    table.load_preset(presets::NOTHING).add_row(heading).add_rows(rows);
    for (k, column) in table.column_iter_mut().enumerate() {
        let (gap, alignment) = if k == 0 { (0, CellAlignment::Left) } else { (2, CellAlignment::Right) };
        column.set_padding((gap, 0)).set_cell_alignment(alignment);
    }
    table.trim_fmt()
}

/// What does not apply.
pub(super) fn missing() -> String {
    "–".to_owned()
}

/// A heading, and a line for each row, complete in itself; what does not apply is empty.
///
/// # Errors
/// None is known.
pub(super) fn csv(rows: impl IntoIterator<Item: Serialize>) -> Result<String, String> {
    let mut writer = ::csv::Writer::from_writer(vec![]);
    rows.into_iter().try_for_each(|row| writer.serialize(row)).map_err(|error| error.to_string())?;
    let bytes = writer.into_inner().map_err(|error| error.to_string())?;
    String::from_utf8(bytes).map_err(|error| error.to_string())
}
