//! `/checksum`: a hash of the exact state for every step, whether or not its frame is recorded.

use super::{
    chunks::Chunks,
    columns::Columns,
    contract::{CHECKSUM, CHECKSUMS},
    instant::Instant,
};
use crate::hash::followed_by;
use crate::sdk::{RowId, Tuid};

/// Checksums of consecutive steps that have not been sent yet.
///
/// A row at step s holds the checksums of the last steps up to s, in order: one per step, or several per row in a thin
/// recording. (A row of Rerun has an overhead of about 30 bytes, which is negligible compared with a frame but not with
/// a checksum.)
pub(super) struct Checksums {
    /// Checksums per row, ≥ 1.
    per_row: usize,
    at: Vec<Instant>,
    values: Vec<u64>,
    /// Rows sent. Their ids are counted separately, because the time at which they are sent depends on the machine.
    rows: u64,
    /// Digest of all checksums, sent or not.
    digest: u64,
}

impl Checksums {
    /// One row per step.
    pub fn by_step() -> Checksums {
        Checksums { per_row: 1, at: Vec::new(), values: Vec::new(), rows: 0, digest: 0 }
    }

    /// Several checksums per row, as many as are computed in a fraction of a second: a killed run loses at most that
    /// many.
    pub fn packed(vertices: u64) -> Checksums {
        Checksums { per_row: (250_000 / vertices.max(1)).clamp(1, 16) as usize, ..Checksums::by_step() }
    }

    /// Adds the checksum of the next step.
    pub fn push(&mut self, at: Instant, value: u64) {
        self.at.push(at);
        self.values.push(value);
        self.digest = followed_by(self.digest, value);
    }

    /// A digest of all checksums, with which a reader can check that they are complete and undamaged.
    pub fn digest(&self) -> u64 {
        self.digest
    }

    /// Logs all full rows, and at the end of the run also an incomplete one.
    pub fn log(&mut self, chunks: &mut Chunks, at_end: bool) {
        let whole = self.values.len() / self.per_row * self.per_row;
        let count = if at_end { self.values.len() } else { whole };
        if count == 0 {
            return;
        }
        let values: Vec<u64> = self.values.drain(..count).collect();
        let at: Vec<Instant> = self.at.drain(..count).collect();
        let mut columns = Columns::new(CHECKSUM.path, vec![CHECKSUMS.descriptor()]);
        for (values, at) in values.chunks(self.per_row).zip(at.chunks(self.per_row)) {
            self.rows += 1;
            let id = RowId::from_tuid(Tuid::from_nanos_and_inc(3, self.rows));
            columns.push(id, at[at.len() - 1], None, &[&values.to_vec()]);
        }
        chunks.send_columns(columns);
    }
}
