//! A flight recorder: keeps the last frames in memory until a trigger fires.
//!
//! Unchanged values are not logged again, so the kept frames alone do not give the full state. For each component, the
//! last value that has left the window is therefore kept too, and written at the first kept frame. After the last one,
//! everything is cleared: where there are no frames, the viewer's latest-at query shows nothing.

use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    sync::Arc,
};

use super::{
    contract::{MARKS_AT_Q, MARKS_ON_AXIS, path_of, plain},
    instant::Instant,
};
use crate::sdk::{
    Chunk, ComponentIdentifier, EntityPath, Scalars, SerializedComponentBatch, SizeBytes as _, StateChange,
    arrow::array::Array as _,
};
use crate::text::bytes;

/// Limit on the size of the kept frames [bytes].
const MAX_BYTES: u64 = 1 << 30;

/// Size of a chunk of several frames that is written [bytes].
const CHUNK_BYTES: u64 = 1 << 20;

/// Size of frames that are written together, while all are to be written [bytes].
const ENOUGH_BYTES: u64 = 16 << 20;

/// The last frames of a run.
pub(super) struct FlightRecorder {
    /// Upper limit on the number of frames kept, ≥ 1.
    max_frames: usize,
    /// Rows logged since the end of the last frame.
    open: Vec<Chunk>,
    frames: VecDeque<(Instant, Vec<Chunk>)>,
    /// Size of `frames` [bytes], its upper limit, and whether frames were dropped because of it.
    bytes: u64,
    max_bytes: u64,
    is_cut: bool,
    /// The chunk and row with the last value that has left `frames` or was written, by entity and component.
    held: BTreeMap<EntityPath, BTreeMap<ComponentIdentifier, (Arc<Chunk>, usize)>>,
    /// Whether frames have been dropped since the last ones were written.
    has_gap: bool,
    /// Lines that were written up to the last frame.
    lines: BTreeSet<String>,
}

/// What ends with the last frame before a gap.
pub(super) struct Ended {
    /// The first instant of the gap.
    pub at: Instant,
    /// Lines of plots.
    pub lines: BTreeSet<String>,
    /// Lanes of states that are known from frames.
    pub lanes: Vec<String>,
    /// Other entities.
    pub shown: Vec<String>,
}

/// The state at an instant: entities and their components.
pub(super) type State = (Instant, Vec<(String, Vec<SerializedComponentBatch>)>);

impl FlightRecorder {
    /// Keeps `max_frames` frames.
    pub fn new(max_frames: u64) -> FlightRecorder {
        FlightRecorder {
            max_frames: usize::try_from(max_frames).unwrap_or(usize::MAX).max(1),
            open: Vec::new(),
            frames: VecDeque::new(),
            bytes: 0,
            max_bytes: MAX_BYTES,
            is_cut: false,
            held: BTreeMap::new(),
            has_gap: false,
            lines: BTreeSet::new(),
        }
    }

    /// Adds a chunk to the current frame.
    pub fn push(&mut self, chunk: Chunk) {
        self.open.push(chunk);
    }

    /// Ends the current frame, and drops the oldest one if there are too many. If frames were written up to the dropped one,
    /// returns what ends there.
    pub fn end_frame(&mut self, at: Instant) -> Option<Ended> {
        self.bytes += size(&self.open);
        self.frames.push_back((at, std::mem::take(&mut self.open)));
        let mut ended = None;
        while self.frames.len() > self.max_frames || (self.bytes > self.max_bytes && self.frames.len() > 1) {
            self.is_cut |= self.frames.len() <= self.max_frames;
            let Some((at, chunks)) = self.frames.pop_front() else { break };
            self.bytes -= size(&chunks);
            if !std::mem::replace(&mut self.has_gap, true) {
                let is_lane =
                    |of: &BTreeMap<ComponentIdentifier, _>| of.contains_key(&StateChange::descriptor_state().component);
                // phases go on: their changes are always written
                let (lanes, shown): (Vec<_>, Vec<_>) = self.held.iter().partition(|(_, of)| is_lane(of));
                let [lanes, shown] =
                    [lanes, shown].map(|all| all.into_iter().map(|(entity, _)| plain(entity)).collect::<Vec<_>>());
                ended = Some(Ended { at, lines: std::mem::take(&mut self.lines), lanes, shown });
            }
            chunks.into_iter().for_each(|chunk| self.hold(chunk));
        }
        ended
    }

    /// Whether the frames that are kept are as many as can be, or enough to be written together.
    pub fn is_full(&self) -> bool {
        self.frames.len() >= self.max_frames || self.bytes >= u64::min(ENOUGH_BYTES, self.max_bytes / 2)
    }

    /// The instants of the first and the last frame that are kept now.
    pub fn range(&self) -> Option<[Instant; 2]> {
        Some([self.frames.front()?.0, self.frames.back()?.0])
    }

    /// A note if not all requested frames fit.
    pub fn note(&self) -> Option<String> {
        let limit = bytes(self.max_bytes);
        self.is_cut.then(|| format!("--keep {}: only the last frames that fit into {limit} are kept", self.max_frames))
    }

    fn hold(&mut self, chunk: Chunk) {
        if is_plotted(&chunk) {
            return;
        }
        let chunk = Arc::new(chunk);
        let held = self.held.entry(chunk.entity_path().clone()).or_default();
        for (component, column) in chunk.components().iter() {
            let rows = &column.list_array;
            if let Some(last) = (0..rows.len()).rev().find(|&row| rows.is_valid(row)) {
                held.insert(*component, (Arc::clone(&chunk), last));
            }
        }
    }

    /// The entities that have been written or dropped.
    pub fn entities(&self) -> impl Iterator<Item = String> {
        self.held.keys().map(plain)
    }

    /// After a gap, the state at the first frame that is kept, where that frame lacks it.
    pub fn state_after_gap(&self) -> Option<State> {
        let (at, chunks) = self.frames.front().filter(|_| self.has_gap)?;
        let mut present: BTreeSet<(&EntityPath, ComponentIdentifier)> = BTreeSet::new();
        for chunk in chunks {
            present.extend(chunk.components().keys().map(|component| (chunk.entity_path(), *component)));
        }
        let state = self.held.iter().map(|(entity, held)| {
            let missing = held.iter().filter(|(component, _)| !present.contains(&(entity, **component)));
            let batch = |(component, (chunk, row)): (&_, &(Arc<Chunk>, usize))| {
                let column = chunk.components().get(*component)?;
                Some(SerializedComponentBatch::new(column.list_array.value(*row), column.descriptor.clone()))
            };
            (plain(entity), missing.filter_map(batch).collect::<Vec<_>>())
        });
        Some((*at, state.filter(|(_, missing)| !missing.is_empty()).collect()))
    }

    /// Takes everything kept, to be written, with the number of frames. The recorder is empty afterwards.
    pub fn take(&mut self) -> (Vec<Chunk>, u64) {
        self.bytes = 0;
        self.has_gap = false;
        let count = self.frames.len() as u64;
        let frames = self.frames.drain(..).flat_map(|(_, chunks)| chunks);
        let chunks: Vec<Chunk> = frames.chain(self.open.drain(..)).collect();
        chunks.iter().for_each(|chunk| self.hold(chunk.clone()));
        let chunks = concatenated(chunks.into_iter());
        self.lines.extend(chunks.iter().filter(|chunk| is_line(chunk)).map(path_of));
        (chunks, count)
    }
}

/// The same rows in fewer chunks: those of a single row take more room for their columns' names than for values.
fn concatenated(chunks: impl Iterator<Item = Chunk>) -> Vec<Chunk> {
    let mut of_entities: BTreeMap<(String, BTreeSet<String>), Vec<Chunk>> = BTreeMap::new();
    for chunk in chunks {
        let components = chunk.components().keys().map(ToString::to_string).collect();
        of_entities.entry((path_of(&chunk), components)).or_default().push(chunk);
    }
    let mut all = Vec::new();
    for chunks in of_entities.into_values() {
        let mut bytes = 0;
        let part = |one: &Chunk, _: &Chunk| {
            bytes += one.heap_size_bytes();
            let fits = bytes < CHUNK_BYTES;
            bytes = if fits { bytes } else { 0 };
            fits
        };
        for part in chunks.chunk_by(part) {
            match concatenate(part) {
                Some(chunk) => all.push(chunk),
                None => all.extend(part.iter().cloned()),
            }
        }
    }
    all
}

/// The rows of all of these chunks in one, which has the id of the first; `None` if their columns differ.
fn concatenate(chunks: &[Chunk]) -> Option<Chunk> {
    let [first, .., _] = chunks else { return chunks.first().cloned() };
    let (left, right) = chunks.split_at(chunks.len() / 2);
    let both = Chunk::concat_and_sort(&concatenate(left)?, &concatenate(right)?).ok()?;
    Some(both.with_id(first.id()))
}

fn size(chunks: &[Chunk]) -> u64 {
    chunks.iter().map(|chunk| chunk.heap_size_bytes()).sum()
}

/// Whether a chunk has values of a plot.
fn is_plotted(chunk: &Chunk) -> bool {
    chunk.components().contains_key(&Scalars::descriptor_scalars().component)
}

/// Whether a chunk has points of a plot line. Markers are no lines: the viewer draws a marker without a value at 0.
fn is_line(chunk: &Chunk) -> bool {
    let entity = path_of(chunk);
    is_plotted(chunk) && ![&MARKS_ON_AXIS, &MARKS_AT_Q].iter().any(|marks| marks.is(&entity))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sdk::TimePoint;

    #[test]
    fn frames_that_do_not_fit_are_dropped() {
        let mut flight = FlightRecorder { max_bytes: 100_000, ..FlightRecorder::new(4_000_000_000) };
        for step in 0..1000 {
            let values = Scalars::new((0..1000).map(f64::from));
            flight.push(Chunk::builder("many").with_archetype_auto_row(TimePoint::STATIC, &values).build().unwrap());
            flight.end_frame(Instant { step, time: 0.0 });
        }
        assert!(flight.note().is_some_and(|note| note.contains("--keep 4000000000")));
        let (_, frames) = flight.take();
        assert!((2..=12).contains(&frames), "{frames}");
    }

    /// Frames that are all to be written are never dropped, and wait for no more than are worth writing together.
    #[test]
    fn frames_to_be_written_do_not_fill_the_memory() {
        let mut flight = FlightRecorder { max_bytes: 100_000, ..FlightRecorder::new(4_000_000_000) };
        let mut written = 0;
        for step in 0..1000 {
            let at = TimePoint::default().with(crate::sdk::Timeline::new_sequence("step"), step as i64);
            let values = Scalars::new((0..1000).map(f64::from));
            flight.push(Chunk::builder("many").with_archetype_auto_row(at, &values).build().unwrap());
            flight.end_frame(Instant { step, time: 0.0 });
            if flight.is_full() {
                let (chunks, frames) = flight.take();
                // one chunk has the rows of all
                assert_eq!((chunks.len(), chunks[0].num_rows() as u64), (1, frames));
                written += frames;
            }
        }
        assert_eq!(written + flight.take().1, 1000);
        assert_eq!(flight.note(), None);
    }
}
