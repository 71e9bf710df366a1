//! The SDK's own way to record, for comparison.

use std::{path::Path, thread::JoinHandle, time::Duration};

use crate::sdk::{
    AsComponents, BatcherHooks, ChunkBatcher, ChunkBatcherConfig, FileSink, LogMsg, PendingRow, RowId, SetStoreInfo,
    StoreId, StoreInfo, StoreKind, StoreSource, TimeCell, TimePoint, Timeline,
};

/// What `log()` of the SDK does: every call is a row, the SDK's batcher collects the rows of an entity into chunks on
/// one thread, another thread passes them on, and the SDK's file sink encodes and writes them on a third.
///
/// The call itself is part of the crate `re_sdk`, which is not a dependency because of what it takes to build. It adds
/// a lookup of the time that was set; files and rates are the same.
pub struct PlainLog {
    batcher: ChunkBatcher,
    encoding: JoinHandle<Result<(), String>>,
}

impl PlainLog {
    /// Starts a recording in a file.
    ///
    /// # Errors
    /// What the SDK says of the file or of a thread.
    pub fn save(file: &Path) -> Result<PlainLog, String> {
        let store = StoreId::random(StoreKind::Recording, "meldscope_bench");
        let sink = FileSink::new(file).map_err(|error| error.to_string())?;
        let info = StoreInfo::new(store.clone(), StoreSource::Other("meldscope".to_owned()));
        sink.send(LogMsg::SetStoreInfo(SetStoreInfo { row_id: *RowId::new(), info }));
        let batcher = ChunkBatcher::new(ChunkBatcherConfig::DEFAULT, BatcherHooks::NONE);
        let batcher = batcher.map_err(|error| error.to_string())?;
        let chunks = batcher.chunks();
        let encoding = std::thread::Builder::new().name("plain log".to_owned()).spawn(move || {
            while let Ok(chunk) = chunks.recv() {
                let message = chunk.to_arrow_msg().map_err(|error| error.to_string())?;
                sink.send(LogMsg::ArrowMsg(store.clone(), message));
            }
            sink.flush_blocking(Duration::MAX).map_err(|error| error.to_string())
        });
        Ok(PlainLog { batcher, encoding: encoding.map_err(|error| error.to_string())? })
    }

    /// Logs components to an entity, at no time if they are static.
    pub fn log(&self, entity: &str, mut at: TimePoint, components: &dyn AsComponents) {
        if !at.is_static() {
            at.insert_cell(*Timeline::log_time().name(), TimeCell::timestamp_now());
        }
        self.batcher.push_row(entity.into(), PendingRow::from_iter(at, components.as_serialized_batches()));
    }

    /// Writes everything.
    ///
    /// # Errors
    /// What the SDK says of a chunk or of the file.
    pub fn finish(self) -> Result<(), String> {
        self.batcher.flush_blocking(Duration::MAX).map_err(|error| error.to_string())?;
        drop(self.batcher);
        self.encoding.join().map_err(|_| "a thread has panicked".to_owned())?
    }
}
