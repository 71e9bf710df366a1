//! A flight recorder: the last frames, kept in memory until something happens.
//!
//! What did not change is not logged again, so a frame alone is not enough to see what was then: of every component
//! that has left the memory its last value is kept, too, and written first. All rows keep their own times, so what is
//! written is true, and the viewer's latest-at query shows every kept frame as it was.

use std::collections::{BTreeMap, VecDeque};

use rerun::external::re_chunk_store::external::re_chunk::{Chunk, ChunkId};

/// The last frames of a run.
pub(super) struct FlightRecorder {
    /// Most frames kept, ≥ 1.
    most: usize,
    /// What was logged since the last frame ended.
    open: Vec<Chunk>,
    frames: VecDeque<Vec<Chunk>>,
    /// What has left `frames` and holds until something newer comes, by entity and component: the chunk it is in.
    held: BTreeMap<(String, String), ChunkId>,
    held_chunks: BTreeMap<ChunkId, (Chunk, usize)>,
}

impl FlightRecorder {
    /// For `most` frames.
    pub fn new(most: u64) -> FlightRecorder {
        FlightRecorder {
            most: usize::try_from(most).unwrap_or(usize::MAX).max(1),
            open: Vec::new(),
            frames: VecDeque::new(),
            held: BTreeMap::new(),
            held_chunks: BTreeMap::new(),
        }
    }

    /// Adds to the frame that is being made.
    pub fn push(&mut self, chunk: Chunk) {
        self.open.push(chunk);
    }

    /// The frame is complete; the oldest goes if there are too many.
    pub fn end_frame(&mut self) {
        self.frames.push_back(std::mem::take(&mut self.open));
        while self.frames.len() > self.most {
            for chunk in self.frames.pop_front().into_iter().flatten() {
                self.hold(chunk);
            }
        }
    }

    fn hold(&mut self, chunk: Chunk) {
        let id = chunk.id();
        let entity = chunk.entity_path().to_string();
        let mut users = 0;
        for component in chunk.components().keys() {
            users += 1;
            if let Some(old) = self.held.insert((entity.clone(), component.to_string()), id)
                && let Some((_, users)) = self.held_chunks.get_mut(&old)
            {
                *users -= 1;
                if *users == 0 {
                    self.held_chunks.remove(&old);
                }
            }
        }
        if users > 0 {
            self.held_chunks.insert(id, (chunk, users));
        }
    }

    /// Everything kept, to be written, and how many frames that is; then nothing is kept any more.
    pub fn take(&mut self) -> (Vec<Chunk>, u64) {
        self.held.clear();
        let held = std::mem::take(&mut self.held_chunks).into_values().map(|(chunk, _)| chunk);
        let count = self.frames.len() as u64;
        let chunks = held.chain(self.frames.drain(..).flatten()).chain(self.open.drain(..)).collect();
        (chunks, count)
    }
}
