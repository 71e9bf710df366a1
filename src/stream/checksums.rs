//! `/checksum`: a hash of the exact state for every step, whether or not its frame is recorded.

use std::sync::Arc;

use super::{
    chunks::Chunks,
    contract::{CHECKSUM, CHECKSUMS, SIM_TIME, STEP},
    instant::Instant,
};
use crate::hash::followed_by;
use crate::sdk::{
    ChunkComponents, RowId, TimeColumn, Tuid,
    arrow::{
        array::{ListArray, UInt64Array},
        buffer::OffsetBuffer,
        datatypes::{DataType, Field},
    },
};

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
        let lengths = values.chunks(self.per_row).map(<[u64]>::len);
        let last: Vec<Instant> = at.chunks(self.per_row).filter_map(|row| row.last().copied()).collect();
        let ids: Vec<RowId> = (0..last.len())
            .map(|_| {
                self.rows += 1;
                RowId::from_tuid(Tuid::from_nanos_and_inc(3, self.rows))
            })
            .collect();

        let field = Field::new_list_field(DataType::UInt64, true);
        let offsets = OffsetBuffer::from_lengths(lengths);
        let lists = ListArray::new(field.into(), offsets, Arc::new(UInt64Array::from(values)), None);
        let components: ChunkComponents = [(CHECKSUMS.descriptor(), lists)].into_iter().collect();
        let timelines = [
            TimeColumn::new_sequence(STEP, last.iter().map(|at| at.step as i64)),
            TimeColumn::new_duration_nanos(SIM_TIME, last.iter().map(|at| at.nanoseconds())),
        ];
        chunks.columns(CHECKSUM.path, &ids, timelines, components);
    }
}
