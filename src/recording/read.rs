//! Reads the chunks of a recording one after the other, from an untrusted file.
//!
//! The SDK's own decoder trusts every length in a file: it allocates what a header claims, and panics where Arrow's
//! reader does. So the frames are read here: no message is larger than the file, total unpacked data is bounded by the
//! file's size, and no buffer is larger than the message that contains it. The SDK and Arrow only decode single
//! messages whose sizes are consistent; if they panic, the message counts as damaged.
//!
//! Frames of an .rrd file: `RRF2`, version (4 bytes), options (4 bytes); messages, each with a kind and a length (8
//! bytes each, little-endian); an end message and a footer for random access, which is not needed here.

use std::{
    cell::Cell,
    fs::File,
    io::{self, BufReader, Read},
    panic::{AssertUnwindSafe, catch_unwind},
    path::{Path, PathBuf},
};

use re_protos::{
    common::v1alpha1::{Compression, StoreKind},
    external::prost::{Message as _, bytes::Bytes},
    log_msg::v1alpha1 as proto,
};

use super::{ReadError, Recorded};
use crate::sdk::{
    ArrowMsg, Chunk, CrateVersion, Tuid,
    arrow::{array::RecordBatch, error::ArrowError, ipc},
    lz4_flex,
};

/// Upper limit on the size of a message of this program, packed or not [bytes].
const MAX_MESSAGE: u64 = 1 << 30;
/// The largest compression ratio of LZ4 [bytes per byte].
const LZ4_RATIO: u64 = 255;
/// Upper limit on the total unpacked size of a recording's messages: a constant, plus a multiple of what was read of
/// the file so far. Typical recordings need a factor of 2 or 3, long texts 20. Memory and time are thereby bounded by
/// the size of the file.
const UNPACKED: (u64, u64) = (64 << 20, 16);
/// Upper limit on the rows of a recording: a constant, plus one row per this many bytes of the file. The ids, times and
/// values of a row take at least 14 bytes.
const ROWS: (u64, u64) = (4096, 8);

/// How a file ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// With the end message of a finished recording.
    Whole,
    /// Without one: the run was killed, or the file was truncated.
    Cut,
}

/// Reads the recordings of a file from start to end, with one message in memory at a time.
pub struct Reader {
    path: PathBuf,
    input: Input,
    /// Bytes read so far.
    at: u64,
    /// Size of the file [bytes].
    size: u64,
    /// Total unpacked size so far [bytes].
    unpacked: u64,
    /// Rows of the chunks returned so far.
    rows: u64,
    /// Reading stops here [bytes from the start].
    limit: u64,
    /// The recording that is read; `None`: all that the file holds.
    only: Option<String>,
    /// Ids of the recording of the last message.
    id: Option<String>,
    application: Option<String>,
    end: Option<End>,
}

type Input = BufReader<File>;

impl Reader {
    /// Opens a file.
    ///
    /// # Errors
    /// The file cannot be read, or does not begin like a recording that this program can read.
    pub fn open(path: &Path) -> Result<Reader, ReadError> {
        let file_error = |source| ReadError::File { path: path.to_owned(), source };
        let file = File::open(path).map_err(file_error)?;
        let metadata = file.metadata().map_err(file_error)?;
        if metadata.is_dir() {
            return Err(file_error(io::ErrorKind::IsADirectory.into()));
        }
        // a pipe or a device does not report its size: assume the largest possible
        let size = if metadata.is_file() { metadata.len() } else { u64::MAX };
        let input = BufReader::with_capacity(256 << 10, file);
        let mut reader = Reader {
            path: path.to_owned(),
            input,
            at: 0,
            size,
            unpacked: 0,
            rows: 0,
            limit: u64::MAX,
            only: None,
            id: None,
            application: None,
            end: None,
        };
        reader.header()?;
        Ok(reader)
    }

    /// Opens the file of a recording, to read that recording only.
    ///
    /// # Errors
    /// As for [`Reader::open`].
    pub fn of(recorded: &Recorded) -> Result<Reader, ReadError> {
        let mut reader = Reader::open(&recorded.path)?;
        reader.read_only(&recorded.id);
        Ok(reader)
    }

    fn header(&mut self) -> Result<(), ReadError> {
        let mut header = [0; 12];
        let length = self.fill(&mut header)?;
        let (magic, rest) = header.split_at(4);
        let [major, minor, patch, _, compression, serializer, zeros @ ..] = rest else { return Ok(()) };
        let local = CrateVersion::LOCAL;
        let what = match magic {
            _ if length == 0 => "it is empty".to_owned(),
            b"RRF2" if length < header.len() => return Err(self.damaged("it ends within its header")),
            b"RRF2" if (*major, *minor) > (local.major, local.minor) => {
                let what = format!(
                    "was written by Rerun {major}.{minor}.{patch}, and this program reads up to {}.{}: use a newer meldscope",
                    local.major, local.minor
                );
                return Err(ReadError::Unsupported { path: self.path.clone(), what });
            }
            b"RRF2" if (*major, *minor) < (0, 23) => {
                let what = format!("was written by Rerun {major}.{minor}.{patch}, which is too old to be read");
                return Err(ReadError::Unsupported { path: self.path.clone(), what });
            }
            b"RRF2" if *compression > 1 || *serializer != 2 || zeros != [0, 0] => {
                return Err(self.damaged("its header has unknown options"));
            }
            b"RRF2" => return Ok(()),
            b"RRF0" | b"RRF1" | b"RRIO" => "it is an .rrd file of an early version of Rerun".to_owned(),
            _ => "it is not an .rrd file".to_owned(),
        };
        Err(ReadError::Foreign { path: self.path.clone(), what })
    }

    /// The path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Reads the recording with this id only, from here on.
    pub fn read_only(&mut self, id: &str) {
        self.only = Some(id.to_owned());
    }

    /// The id of the recording that the last message belongs to.
    pub fn id(&self) -> Option<&str> {
        self.id.as_deref()
    }

    /// The application id of the recording that the last message belongs to.
    pub fn application(&self) -> Option<&str> {
        self.application.as_deref()
    }

    /// Bytes read so far.
    pub fn at(&self) -> u64 {
        self.at
    }

    /// Stops at the first message that begins beyond this many bytes.
    pub fn stop_after(&mut self, bytes: u64) {
        self.limit = bytes;
    }

    /// How the file ended; `None` before its end was reached.
    pub fn end(&self) -> Option<End> {
        self.end
    }

    /// The next chunk whose entity is `wanted`; blueprints are skipped.
    ///
    /// # Errors
    /// The file cannot be read, or its next bytes are not a message. A truncated message is the end of the file, not an
    /// error.
    pub fn next(&mut self, wanted: impl Fn(&str) -> bool) -> Result<Option<Chunk>, ReadError> {
        while self.end.is_none() {
            if self.at > self.limit {
                self.end = Some(End::Cut);
                break;
            }
            let mut header = [0; 16];
            if self.fill(&mut header)? < header.len() {
                self.end = Some(End::Cut);
                break;
            }
            let (kind, length) = header.split_at(8);
            let [kind, length] = [kind, length].map(|bytes| bytes.iter().rev().fold(0, |n, &b| n << 8 | u64::from(b)));
            if kind > 3 {
                return Err(self.damaged(&format!("a message of unknown kind {kind}")));
            }
            if length > self.size.saturating_sub(self.at) {
                // a truncated message, unless it claims an impossible size
                if length > MAX_MESSAGE {
                    return Err(self.damaged(&format!("a message of {length} bytes")));
                }
                self.end = Some(End::Cut);
                break;
            }
            if length > MAX_MESSAGE {
                return Err(self.damaged(&format!("a message of {length} bytes, over the limit of {MAX_MESSAGE}")));
            }
            let start = self.at;
            let mut message = Vec::new();
            let read = Read::by_ref(&mut self.input).take(length).read_to_end(&mut message);
            read.map_err(|source| ReadError::File { path: self.path.clone(), source })?;
            self.at += message.len() as u64;
            if (message.len() as u64) < length {
                self.end = Some(End::Cut);
                break;
            }
            match kind {
                0 => self.footer(length)?,
                2 => {
                    let damaged = |what: String| ReadError::Damaged { path: self.path.clone(), at: Some(start), what };
                    let message = proto::ArrowMsg::decode(Bytes::from(message))
                        .map_err(|_| damaged("a message with a malformed envelope".to_owned()))?;
                    if message.encoding() != proto::Encoding::ArrowIpc {
                        return Err(damaged("a message that is not in Arrow's format".to_owned()));
                    }
                    let Some(store) = message.store_id.as_ref().filter(|id| id.kind() == StoreKind::Recording) else {
                        continue;
                    };
                    if self.only.as_ref().is_some_and(|only| *only != store.recording_id) {
                        continue;
                    }
                    if self.id.as_ref() != Some(&store.recording_id) {
                        self.id = Some(store.recording_id.clone());
                        self.application = Some(store.application_id.clone().unwrap_or_default().id);
                    }
                    self.unpacked = self.unpacked.saturating_add(unpacked_size(&message));
                    let max_unpacked = UNPACKED.0.saturating_add(UNPACKED.1.saturating_mul(self.at));
                    if self.unpacked > max_unpacked {
                        let (read, unpacked) = (self.at, self.unpacked);
                        return Err(damaged(format!("{read} bytes claim to unpack to {unpacked} bytes")));
                    }
                    if let Some(chunk) = catching(|| chunk(&message, &wanted)).map_err(damaged)? {
                        self.rows = self.rows.saturating_add(chunk.num_rows() as u64);
                        if self.rows > ROWS.0 + self.at / ROWS.1 {
                            return Err(damaged(format!("{} rows within {} bytes", self.rows, self.at)));
                        }
                        return Ok(Some(chunk));
                    }
                }
                _ => {}
            }
        }
        Ok(None)
    }

    /// Checks that the end message is followed by a footer of 32 bytes, and the footer by nothing.
    fn footer(&mut self, length: u64) -> Result<(), ReadError> {
        let mut footer = [0; 32];
        let read = self.fill(&mut footer)?;
        if length > 0 && read == footer.len() && footer.get(20..28) != Some(b"RRF2FOOT") {
            return Err(self.damaged("its footer is invalid"));
        }
        let is_whole = read == footer.len() || (length == 0 && read == 0);
        self.end = Some(if is_whole { End::Whole } else { End::Cut });
        let mut more = [0];
        if self.fill(&mut more)? > 0 {
            return Err(self.damaged("there is data after its end"));
        }
        Ok(())
    }

    /// Reads until `buffer` is full or the file ends; returns the number of bytes read.
    fn fill(&mut self, buffer: &mut [u8]) -> Result<usize, ReadError> {
        let mut filled = 0;
        while let Some(rest) = buffer.get_mut(filled..).filter(|rest| !rest.is_empty()) {
            match self.input.read(rest) {
                Ok(0) => break,
                Ok(n) => filled += n,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(source) => return Err(ReadError::File { path: self.path.clone(), source }),
            }
        }
        self.at += filled as u64;
        Ok(filled)
    }

    fn damaged(&self, what: &str) -> ReadError {
        ReadError::Damaged { path: self.path.clone(), at: Some(self.at), what: what.to_owned() }
    }
}

/// The unpacked size that a message claims [bytes].
fn unpacked_size(message: &proto::ArrowMsg) -> u64 {
    match message.compression() {
        Compression::Lz4 => message.uncompressed_size,
        Compression::Unspecified | Compression::None => message.payload.len() as u64,
    }
}

/// Decodes the chunk if its entity is wanted.
fn chunk(message: &proto::ArrowMsg, wanted: impl Fn(&str) -> bool) -> Result<Option<Chunk>, String> {
    let (payload, claimed) = (message.payload.as_ref(), message.uncompressed_size);
    let mut unpacked = Vec::new();
    let data = match Compression::try_from(message.compression) {
        Ok(Compression::Unspecified | Compression::None) => payload,
        Ok(Compression::Lz4) => {
            let max_size = MAX_MESSAGE.min(LZ4_RATIO.saturating_mul(payload.len() as u64) + 64);
            if claimed > max_size {
                return Err(format!("{} bytes claim to unpack to {claimed} bytes", payload.len()));
            }
            unpacked.resize(claimed as usize, 0);
            let length = lz4_flex::block::decompress_into(payload, &mut unpacked)
                .map_err(|error| format!("a message cannot be unpacked ({})", brief(&error)))?;
            unpacked.truncate(length);
            unpacked.as_slice()
        }
        Err(_) => return Err(format!("a message with unknown compression {}", message.compression)),
    };
    check_lengths(data)?;
    let arrow = |error: ArrowError| format!("a message is not Arrow data ({})", brief(&error));
    let mut stream = ipc::reader::StreamReader::try_new(data, None).map_err(arrow)?;
    if let Some(entity) = stream.schema().metadata().get("rerun:entity_path")
        && !wanted(entity)
    {
        return Ok(None);
    }
    let batch: RecordBatch = stream.next().ok_or("a message has no data")?.map_err(arrow)?;
    let decoded = ArrowMsg { chunk_id: Tuid::ZERO, batch, on_release: None };
    let chunk =
        Chunk::from_arrow_msg(&decoded).map_err(|error| format!("a message is not a chunk ({})", brief(&error)))?;
    Ok(Some(chunk).filter(|chunk| wanted(&chunk.entity_path().to_string())))
}

/// The first line of an error message, which may have many.
fn brief(error: &dyn std::fmt::Display) -> String {
    let text = error.to_string();
    text.lines().next().unwrap_or_default().chars().take(120).collect()
}

/// Checks that the lengths of an Arrow stream's frames do not exceed the stream: Arrow's reader would trust them.
fn check_lengths(mut data: &[u8]) -> Result<(), String> {
    fn split<'a>(data: &mut &'a [u8], length: usize) -> Option<&'a [u8]> {
        let (head, rest) = data.split_at_checked(length)?;
        *data = rest;
        Some(head)
    }
    let short = || "a message is shorter than it claims".to_owned();
    let word = |data: &mut &[u8]| {
        split(data, 4).and_then(|word| word.try_into().ok()).map(i32::from_le_bytes).ok_or_else(short)
    };
    while !data.is_empty() {
        let mut length = word(&mut data)?;
        if length == -1 {
            length = word(&mut data)?;
        }
        if length == 0 {
            break;
        }
        let metadata = usize::try_from(length).ok().and_then(|length| split(&mut data, length)).ok_or_else(short)?;
        let message = ipc::root_as_message(metadata)
            .map_err(|error| format!("a message is not Arrow data ({})", brief(&error)))?;
        // bodies are never compressed twice; Arrow's reader would trust the claimed unpacked size
        let is_packed = |batch: Option<ipc::RecordBatch<'_>>| batch.is_some_and(|batch| batch.compression().is_some());
        let dictionary = message.header_as_dictionary_batch().and_then(|dictionary| dictionary.data());
        if is_packed(message.header_as_record_batch()) || is_packed(dictionary) {
            return Err("a message that is compressed twice".to_owned());
        }
        let body = usize::try_from(message.bodyLength()).ok();
        body.and_then(|length| split(&mut data, length)).ok_or_else(short)?;
    }
    Ok(())
}

thread_local! {
    static EXPECTS_PANICS: Cell<bool> = const { Cell::new(false) };
}

/// Whether a panic of this thread only means that Arrow found malformed data in a file. Such a panic is caught and
/// becomes a [`ReadError`]. A program's panic hook can call this to avoid printing it.
pub fn expects_panics() -> bool {
    EXPECTS_PANICS.get()
}

/// Returns the result of `work`, which decodes data; a panic becomes an error.
pub fn catching<T>(work: impl FnOnce() -> Result<T, String>) -> Result<T, String> {
    let before = EXPECTS_PANICS.replace(true);
    let result = catch_unwind(AssertUnwindSafe(work));
    EXPECTS_PANICS.set(before);
    result.unwrap_or_else(|_| Err("its data is malformed".to_owned()))
}
