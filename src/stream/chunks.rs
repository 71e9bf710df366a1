//! Batches rows into chunks, and chunks into messages.
//!
//! The SDK's own recording stream would add wall-clock timelines and random row ids, and flush by a timer. Here a
//! recording is a deterministic function of what is logged: times are simulated time, ids are counters.

use std::collections::HashMap;

use super::{
    columns::{Cell, ChunkParts, Columns},
    contract::STAGE,
    instant::Instant,
};
use crate::sdk::{
    AsComponents, Chunk, ChunkBuilder, ChunkId, ComponentDescriptor, EntityPath, LogMsg, RowId, SetStoreInfo, StoreId,
    StoreInfo, StoreSource, TimePoint, Timeline, Tuid,
};

/// The destinations of a message: files get the same rows as viewers, but in larger chunks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Audience {
    /// All destinations.
    All,
    /// Viewers and servers.
    Viewers,
    /// Files and pipes.
    Files,
}

/// Handle of an entity that is logged in columns, see [`Chunks::track`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TrackId(usize);

/// An entity, and whether its rows are at stages: all rows of a chunk must have the same timelines.
type RowKey = (EntityPath, bool);

/// Collects rows by entity until they are taken.
pub struct Chunks {
    store: StoreId,
    tracks: Vec<Columns>,
    open: HashMap<RowKey, ChunkBuilder>,
    /// Entities in `open` in the order of their first row, so that the order of messages does not depend on hashing.
    order: Vec<RowKey>,
    done: Vec<LogMsg>,
    /// The stage at which rows are logged; `None` if they are at instants.
    stage: Option<u64>,
    rows: u64,
    /// Number of rows whose contents depend on the machine.
    rows_apart: u64,
    chunks: u64,
}

/// The first number of the ids of a preview: no recording has so many rows.
const PREVIEW: u64 = 1 << 48;

impl Chunks {
    /// Starts the recording or blueprint `store`. The first message identifies it.
    pub fn new(store: StoreId) -> Chunks {
        let source = StoreSource::Other("meldscope".to_owned());
        let info = SetStoreInfo { row_id: Tuid::from_nanos_and_inc(1, 0), info: StoreInfo::new(store.clone(), source) };
        Chunks {
            store,
            tracks: Vec::new(),
            open: HashMap::new(),
            order: Vec::new(),
            done: vec![LogMsg::SetStoreInfo(info)],
            stage: None,
            rows: 0,
            rows_apart: 0,
            chunks: 0,
        }
    }

    /// Rows of a recording that has been started, with ids of their own: the same rows may be logged again.
    pub fn preview(store: StoreId) -> Chunks {
        let mut chunks = Chunks::new(store);
        chunks.done.clear();
        chunks.rows_apart = PREVIEW;
        (chunks.rows, chunks.chunks) = (PREVIEW, PREVIEW);
        chunks
    }

    /// The recording or blueprint that the rows belong to.
    pub fn store(&self) -> &StoreId {
        &self.store
    }

    // Counted separately: the number of chunks depends on the machine, the rows do not.
    fn row_id(&mut self) -> RowId {
        self.rows += 1;
        RowId::from_tuid(Tuid::from_nanos_and_inc(1, self.rows))
    }

    fn chunk_id(&mut self) -> ChunkId {
        self.chunks += 1;
        ChunkId::from_tuid(Tuid::from_nanos_and_inc(2, self.chunks))
    }

    /// Sets whether the following rows are at a stage, on its own timeline, or at instants. A track must not mix the
    /// two.
    pub fn set_stage(&mut self, stage: Option<u64>) {
        self.stage = stage;
    }

    /// Creates a track: an entity that is logged frame after frame with the same components.
    pub fn track(&mut self, entity: &str, components: impl IntoIterator<Item = ComponentDescriptor>) -> TrackId {
        self.tracks.push(Columns::new(entity, components.into_iter().collect()));
        TrackId(self.tracks.len() - 1)
    }

    /// Like [`Chunks::push`], for values that depend on the machine. Their rows are counted separately, so that all
    /// other rows have the same ids in equal runs.
    pub fn push_apart(&mut self, TrackId(track): TrackId, at: Instant, cells: &[&dyn Cell]) {
        self.rows_apart += 1;
        let row = RowId::from_tuid(Tuid::from_nanos_and_inc(4, self.rows_apart));
        self.tracks[track].push(row, at, None, cells);
    }

    /// Logs a row of a track, one cell per component.
    pub fn push(&mut self, TrackId(track): TrackId, at: Instant, cells: &[&dyn Cell]) {
        let row = self.row_id();
        self.tracks[track].push(row, at, self.stage, cells);
    }

    /// Whether cells, one per component, differ from those of the last row of a track. Those before the first row are empty.
    pub fn has_changed(&mut self, TrackId(track): TrackId, cells: &[&dyn Cell]) -> bool {
        self.tracks[track].has_changed(cells)
    }

    /// Logs a row of a track if its cells [have changed](Chunks::has_changed).
    pub fn push_changed(&mut self, track: TrackId, at: Instant, cells: &[&dyn Cell]) {
        if self.has_changed(track, cells) {
            self.push(track, at, cells);
        }
    }

    /// Logs components of an entity at an instant of the simulation.
    pub fn log(&mut self, entity: &str, at: Instant, components: &dyn AsComponents) {
        let stage = |stage: u64| TimePoint::from_iter([(Timeline::new_sequence(STAGE), stage as i64)]);
        self.row(entity, self.stage.map_or_else(|| at.time_point(), stage), components);
    }

    /// Logs components of an entity at a time point on any timelines.
    pub fn row(&mut self, entity: &str, at: TimePoint, components: &dyn AsComponents) {
        let row = self.row_id();
        let path = EntityPath::from(entity);
        let key = (path.clone(), self.stage.is_some());
        let builder = self.open.remove(&key).unwrap_or_else(|| {
            self.order.push(key.clone());
            let id = self.chunk_id();
            Chunk::builder_with_id(id, path)
        });
        let builder = builder.with_serialized_batches(row, at, components.as_serialized_batches());
        self.open.insert(key, builder);
    }

    /// Logs static components of an entity, in a separate message.
    pub fn log_static(&mut self, entity: &str, components: &dyn AsComponents) {
        let (id, row) = (self.chunk_id(), self.row_id());
        let builder = Chunk::builder_with_id(id, EntityPath::from(entity));
        let builder = builder.with_serialized_batches(row, TimePoint::STATIC, components.as_serialized_batches());
        self.finish(builder);
    }

    /// Logs the rows of an entity that is no track, in a separate message.
    pub(super) fn send_columns(&mut self, mut columns: Columns) {
        let parts = ours(columns.take());
        let chunk = self.chunk(columns.entity, parts);
        self.send(chunk);
    }

    /// Returns the messages since the last call.
    pub fn take(&mut self) -> Vec<LogMsg> {
        for chunk in self.drain() {
            self.send(chunk);
        }
        std::mem::take(&mut self.done)
    }

    /// Like [`Chunks::take`], but includes tracks only if they have enough rows to fill a chunk.
    pub fn take_full(&mut self) -> Vec<LogMsg> {
        if self.tracks.iter().any(Columns::is_long) {
            return self.take(); // otherwise a file could contain scalars without their frames
        }
        for track in 0..self.tracks.len() {
            if self.tracks[track].is_full() {
                let chunk = self.close(track);
                self.send(chunk);
            }
        }
        std::mem::take(&mut self.done)
    }

    /// Returns the rows that viewers have not received yet. Rows of tracks are for viewers only; they remain to be
    /// taken for files, in larger chunks.
    pub fn show(&mut self) -> Vec<(Audience, LogMsg)> {
        for chunk in self.drain_rows() {
            self.send(chunk);
        }
        let mut shown: Vec<_> =
            std::mem::take(&mut self.done).into_iter().map(|message| (Audience::All, message)).collect();
        for track in 0..self.tracks.len() {
            if let Some(parts) = self.tracks[track].show() {
                let chunk = self.chunk(self.tracks[track].entity.clone(), ours(parts));
                self.send(chunk);
            }
        }
        shown.extend(std::mem::take(&mut self.done).into_iter().map(|message| (Audience::Viewers, message)));
        shown
    }

    /// Whether [`Chunks::take_full`] would return a full chunk.
    pub fn has_full(&self) -> bool {
        !self.done.is_empty() || self.tracks.iter().any(|track| track.is_full() || track.is_long())
    }

    /// Returns the rows since the last call as chunks, not yet converted to messages. Static data and
    /// [`Chunks::send_columns`] are converted at once.
    pub fn drain(&mut self) -> Vec<Chunk> {
        let mut chunks = self.drain_rows();
        for track in 0..self.tracks.len() {
            if !self.tracks[track].is_empty() {
                chunks.push(self.close(track));
            }
        }
        chunks
    }

    /// Like [`Chunks::drain`], without the tracks.
    fn drain_rows(&mut self) -> Vec<Chunk> {
        let order = std::mem::take(&mut self.order);
        let rows = order.into_iter().filter_map(|path| self.open.remove(&path));
        rows.map(|builder| ours(builder.build())).collect()
    }

    /// Converts the rows of a track to a chunk.
    fn close(&mut self, track: usize) -> Chunk {
        let parts = ours(self.tracks[track].take());
        self.chunk(self.tracks[track].entity.clone(), parts)
    }

    fn chunk(&mut self, entity: EntityPath, (ids, timelines, components): ChunkParts) -> Chunk {
        let id = self.chunk_id();
        let timelines = timelines.into_iter().map(|column| (*column.timeline().name(), column)).collect();
        ours(Chunk::from_native_row_ids(id, entity, Some(true), &ids, timelines, components))
    }

    fn finish(&mut self, builder: ChunkBuilder) {
        self.send(ours(builder.build()));
    }

    /// Converts a chunk to a message.
    pub fn send(&mut self, chunk: Chunk) {
        self.done.push(LogMsg::ArrowMsg(self.store.clone(), ours(chunk.to_arrow_msg())));
    }
}

/// Unwraps a result that fails only for malformed columns, which this program does not build.
fn ours<T, E: std::fmt::Display>(result: Result<T, E>) -> T {
    match result {
        Ok(result) => result,
        Err(error) => unreachable!("a chunk of our own columns: {error}"),
    }
}

/// The time point of everything in a blueprint.
pub(super) fn blueprint_time() -> TimePoint {
    TimePoint::from_iter([(Timeline::new_sequence("blueprint"), 0)])
}
