//! Writes recordings as bytes, to a file or to standard output.
//!
//! A file is first written next to its destination, as `F.rrd.partial`, and renamed when it is complete: whatever
//! happens to the run, the previous file remains intact, and everything simulated up to the last flush can be read.

use std::fs::{File, Metadata, OpenOptions, TryLockError};
use std::io::{self, BufWriter, IsTerminal as _, Read as _, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use same_file::Handle;

use super::SinkError;
use super::error::file_help;
use super::queue::{Parcel, Queue, WhenFull};
use crate::atomic;
use crate::sdk::{CrateVersion, EncodeError, Encoder, EncodingOptions};

/// Upper limit on data waiting to be written [bytes]; beyond it the run waits for the disk. A larger queue would not be
/// faster: data would have left the processor's caches by the time it is written.
const LIMIT: u64 = 16 << 20;
/// Write buffer size [bytes].
const BUFFER: usize = 256 << 10;
/// Interval between flushes: a killed run loses at most what was written after the last one.
const FLUSH_EVERY: Duration = Duration::from_millis(100);
/// Messages encoded between two checks of the clock.
const BATCH: usize = 64;

/// Magic numbers of recordings, of all Rerun versions so far.
const MAGICS: [&[u8; 4]; 4] = [b"RRF2", b"RRF1", b"RRF0", b"RRIO"];

/// The claim to a file: checked and locked, but nothing is modified yet.
pub(super) struct Claim {
    /// Destination of the recording, with symbolic links resolved.
    path: PathBuf,
    /// The file to write, open and locked.
    file: File,
    /// The temporary file; `None` if `path` is written directly, as a device or a pipe cannot be replaced by renaming.
    partial: Option<Partial>,
    /// Whether `file` was left by a killed run: it is kept until this run starts to write.
    is_stale: bool,
    /// The existing file to be replaced.
    there: Option<Handle>,
}

/// The temporary file next to the destination; removed when dropped unless it has contents to keep.
struct Partial {
    path: PathBuf,
    is_kept: bool,
}

impl Drop for Partial {
    fn drop(&mut self) {
        if !self.is_kept {
            std::fs::remove_file(&self.path).ok();
        }
        atomic::forget(&self.path);
    }
}

impl Claim {
    /// Performs all checks that are possible before a run: that `path` can be written, that an existing file may be
    /// replaced, and that no other run is writing it.
    pub fn new(path: &Path) -> Result<Claim, SinkError> {
        let is_link = std::fs::symlink_metadata(path).is_ok_and(|there| there.is_symlink());
        // the target of a link is replaced, not the link
        let resolved = if is_link { std::fs::canonicalize(path).ok() } else { None };
        let path = &resolved.unwrap_or_else(|| path.to_owned());
        let file_error = |doing, source: io::Error| {
            let help = file_help(path, &source, None);
            SinkError::File { doing, path: path.clone(), source: Arc::new(source), help }
        };
        let taken = |what: &str| SinkError::taken(path, what);
        if path.to_string_lossy().ends_with(std::path::is_separator) {
            return Err(file_error("write", io::ErrorKind::IsADirectory.into()));
        }

        let mut there = None;
        match std::fs::metadata(path) {
            _ if is_null(path) => {
                let file = OpenOptions::new().write(true).open(path).map_err(|err| file_error("write", err))?;
                return Ok(Claim { path: path.clone(), file, partial: None, is_stale: false, there });
            }
            Ok(found) if found.is_dir() => return Err(file_error("write", io::ErrorKind::IsADirectory.into())),
            Ok(found) if is_disk(&found) => return Err(taken("it is a disk; save to a file")),
            Ok(found) if found.is_file() => {
                // renaming would replace even a write-protected file, so check for write permission here
                let file =
                    OpenOptions::new().read(true).write(true).open(path).map_err(|err| file_error("write", err))?;
                if !may_be_replaced(&file).map_err(|err| file_error("read", err))? {
                    return Err(taken(NO_RECORDING));
                }
                there = Some(Handle::from_file(file).map_err(|err| file_error("read", err))?);
            }
            // what is printed would follow it there
            Ok(found) if is_stdout(&found) => {
                return Err(taken("it is standard output; use `--stdout`"));
            }
            Ok(_) => {
                let file = OpenOptions::new().write(true).open(path).map_err(|err| file_error("write", err))?;
                return Ok(Claim { path: path.clone(), file, partial: None, is_stale: false, there });
            }
            Err(err) if err.kind() == io::ErrorKind::NotFound && is_link => {
                return Err(taken("it is a symbolic link to nothing; remove it or save under another name"));
            }
            Err(err) if err.kind() == io::ErrorKind::NotFound => {}
            Err(err) => return Err(file_error("write", err)),
        }

        let Some(name) = path.file_name() else {
            return Err(file_error("write", io::ErrorKind::IsADirectory.into()));
        };
        // a file that another run writes under that name would be renamed by that run
        if path.extension().is_some_and(|extension| extension == "partial") {
            return Err(taken("names that end in .partial are for unfinished recordings; save under another name"));
        }
        let mut partial_name = name.to_owned();
        partial_name.push(".partial");
        let partial = path.with_file_name(partial_name);
        let in_the_way = |what: &str| taken(&format!("{}, where it is written first, {what}", partial.display()));
        loop {
            // never follow a link, whoever created it
            match atomic::create_new(&partial) {
                Ok(file) => {
                    let locked = lock(&file, path);
                    let is_there = if locked.is_ok() { leads_to(&partial, &file) } else { Ok(false) };
                    if matches!(locked, Ok(None)) || !matches!(is_there, Ok(false)) {
                        let partial = Some(Partial { path: partial, is_kept: false });
                        is_there.map_err(|err| file_error("create", err))?;
                        return Ok(Claim { path: path.clone(), file, partial, is_stale: false, there });
                    }
                    atomic::forget(&partial); // another run's
                    locked?;
                    continue;
                }
                Err(err) if err.kind() == io::ErrorKind::AlreadyExists => {}
                Err(err) => return Err(file_error("create", err)),
            }
            match std::fs::symlink_metadata(&partial) {
                Ok(found) if found.is_file() => {}
                Ok(there) => {
                    let kind = if there.is_symlink() { "is a symbolic link" } else { "is not a file" };
                    return Err(in_the_way(&format!("{kind}; remove it or save under another name")));
                }
                // it was renamed or removed in the meantime
                Err(err) if err.kind() == io::ErrorKind::NotFound => continue,
                Err(err) => return Err(file_error("create the .partial file of", err)),
            }
            let file = match OpenOptions::new().read(true).write(true).open(&partial) {
                Ok(file) => file,
                Err(err) if err.kind() == io::ErrorKind::NotFound => continue,
                Err(err) => return Err(file_error("create the .partial file of", err)),
            };
            if lock(&file, path)?.is_none() {
                return Err(in_the_way(
                    "cannot be locked on this file system and may belong to a run in progress; remove it if there is none",
                ));
            }
            // The run that held the lock may have renamed this very file to `path` in the meantime. Then it is a
            // finished recording.
            if !leads_to(&partial, &file).map_err(|err| file_error("read the .partial file of", err))? {
                continue;
            }
            if !may_be_replaced(&file).map_err(|err| file_error("read the .partial file of", err))? {
                return Err(in_the_way("is not a recording; remove it or save under another name"));
            }
            let partial = Some(Partial { path: partial, is_kept: true });
            return Ok(Claim { path: path.clone(), file, partial, is_stale: true, there });
        }
    }

    /// Starts to write. Returns a note if an unfinished recording was overwritten.
    pub fn start(self) -> Result<(Writer, Option<String>), SinkError> {
        let Claim { path, mut file, mut partial, is_stale, there } = self;
        let mut note = None;
        let target = Target::File { path: path.clone(), partial: partial.as_ref().map(|partial| partial.path.clone()) };
        if let Some(partial) = &mut partial {
            if is_stale {
                let create = |err| target.error("create the .partial file of", err);
                if file.metadata().is_ok_and(|there| there.len() > 0) {
                    let left = partial.path.display();
                    note = Some(format!("overwriting {left}, which an earlier run left unfinished"));
                }
                // not truncated: the file may have another hard link under which it is wanted
                std::fs::remove_file(&partial.path).map_err(create)?;
                drop(file);
                file = match atomic::create_new(&partial.path) {
                    Err(err) if err.kind() == io::ErrorKind::AlreadyExists => return Err(SinkError::Busy { path }),
                    other => other.map_err(create)?,
                };
                lock(&file, &path)?;
            }
            partial.is_kept = true;
        }
        let out = file.try_clone().map_err(|err| target.error("write", err))?;
        let mut writer = Writer::start(target, out)?;
        writer.held = Some(Held { partial, file, there });
        Ok((writer, note))
    }
}

/// The reason for not replacing a file.
const NO_RECORDING: &str =
    "it is not a recording, and only recordings are replaced; save under another name or remove it first";

/// Whether a file may be replaced: it is empty or a recording.
fn may_be_replaced(file: &File) -> io::Result<bool> {
    let mut magic = Vec::new();
    file.take(4).read_to_end(&mut magic)?;
    Ok(magic.is_empty() || MAGICS.iter().any(|known| magic == **known))
}

/// Locks a file that is to become `path`; `None` if the file system does not support locks.
fn lock(file: &File, path: &Path) -> Result<Option<()>, SinkError> {
    match file.try_lock() {
        Ok(()) => Ok(Some(())),
        Err(TryLockError::WouldBlock) => Err(SinkError::Busy { path: path.to_owned() }),
        Err(TryLockError::Error(_)) => Ok(None),
    }
}

/// Whether `path` is a regular file, not a link, and the same file as `file`.
///
/// # Errors
/// The operating system's error, for example that too many files are open.
fn leads_to(path: &Path, file: &File) -> io::Result<bool> {
    let open = Handle::from_file(file.try_clone()?)?;
    let named =
        std::fs::symlink_metadata(path).and_then(|there| Ok(there.is_file() && Handle::from_path(path)? == open));
    match named {
        // Windows denies access to a file that is about to go
        Err(err) if matches!(err.kind(), io::ErrorKind::NotFound | io::ErrorKind::PermissionDenied) => Ok(false),
        named => named,
    }
}

#[cfg(unix)]
fn is_disk(there: &Metadata) -> bool {
    use std::os::unix::fs::FileTypeExt as _;
    there.file_type().is_block_device()
}

/// On other systems, a disk has no file name that could be given by mistake.
#[cfg(not(unix))]
fn is_disk(_there: &Metadata) -> bool {
    false
}

/// Whether it is the pipe that standard output leads to. It is not opened: a pipe without a reader would wait for one.
#[cfg(unix)]
fn is_stdout(there: &Metadata) -> bool {
    use std::os::{
        fd::AsFd as _,
        unix::fs::{FileTypeExt as _, MetadataExt as _},
    };
    let out = io::stdout().as_fd().try_clone_to_owned().and_then(|out| File::from(out).metadata());
    there.file_type().is_fifo() && out.is_ok_and(|out| (out.dev(), out.ino()) == (there.dev(), there.ino()))
}

/// On other systems, standard output has no file name.
#[cfg(not(unix))]
fn is_stdout(_there: &Metadata) -> bool {
    false
}

/// Whether `path` is the null device of Windows, which exists in every folder and cannot be detected by its metadata.
fn is_null(path: &Path) -> bool {
    cfg!(windows) && path.file_name().is_some_and(|name| name.eq_ignore_ascii_case("nul"))
}

/// Destination of the bytes, for error messages.
#[derive(Clone)]
enum Target {
    File { path: PathBuf, partial: Option<PathBuf> },
    Stdout,
}

impl Target {
    fn error(&self, doing: &'static str, source: io::Error) -> SinkError {
        match self {
            Target::File { path, partial } => {
                let help = file_help(path, &source, partial.as_deref());
                SinkError::File { doing, path: path.clone(), source: Arc::new(source), help }
            }
            Target::Stdout => {
                let help = file_help(Path::new(""), &source, None);
                SinkError::Stdout { source: Arc::new(source), help }
            }
        }
    }

    fn encode_error(&self, error: EncodeError) -> SinkError {
        match error {
            EncodeError::Write(source) => self.error("write", source),
            other => SinkError::Failed(format!(
                "cannot encode a message for {}: {other}; this is a bug, please report it",
                self.name()
            )),
        }
    }

    fn name(&self) -> String {
        match self {
            Target::File { path, .. } => path.display().to_string(),
            Target::Stdout => "standard output".to_owned(),
        }
    }
}

/// A thread that encodes messages and writes them.
pub(super) struct Writer {
    target: Target,
    queue: Arc<Queue>,
    thread: Option<JoinHandle<Option<u64>>>,
    /// Number of messages sent.
    sent: u64,
    held: Option<Held>,
}

/// Keeps the claim to a file until the file is renamed.
struct Held {
    partial: Option<Partial>,
    /// Open until the end, because the lock is released with the last handle.
    file: File,
    /// The existing file to be replaced.
    there: Option<Handle>,
}

/// The complete output of a writer. A file still has its temporary name, and keeps it unless it is placed.
pub struct Complete {
    /// Size of the recording, footer included [bytes].
    pub(super) bytes: u64,
    target: Target,
    held: Option<Held>,
}

impl Writer {
    /// Starts to write to standard output, which must not be a terminal.
    ///
    /// Any other output to it would corrupt the recording.
    pub fn stdout() -> Result<Writer, SinkError> {
        if is_terminal() {
            return Err(SinkError::terminal());
        }
        // locked per write, not for the whole run: otherwise a print from elsewhere would block forever
        Writer::start(Target::Stdout, io::stdout())
    }

    fn start(target: Target, out: impl Write + Send + 'static) -> Result<Writer, SinkError> {
        let queue = Arc::new(Queue::new(target.name(), LIMIT, WhenFull::Wait));
        let thread = std::thread::Builder::new().name("recording".to_owned()).spawn({
            let (target, queue) = (target.clone(), Arc::clone(&queue));
            move || {
                let _attendance = queue.attend();
                write(&target, &queue, out).map_err(|err| queue.fail(err)).ok()
            }
        });
        match thread {
            Ok(thread) => Ok(Writer { target, queue, thread: Some(thread), sent: 0, held: None }),
            Err(err) => Err(SinkError::Thread { target: target.name(), reason: err.to_string() }),
        }
    }

    /// Queues a message; waits while the queue is full. `Err` tells why nothing more can be written.
    pub fn send(&mut self, parcel: Parcel) -> Result<(), SinkError> {
        self.sent += 1;
        self.queue.send(parcel)
    }

    /// Waits until everything sent has been passed to the operating system.
    pub fn flush(&self) -> Result<(), SinkError> {
        self.queue.flush()
    }

    /// Whether writing has failed.
    pub fn failed(&self) -> bool {
        self.queue.failure().is_some()
    }

    /// Signals that nothing more will be sent, so that the thread can finish in the background.
    pub fn close(&self) {
        self.queue.close();
    }

    /// The path of the file, or `None` for standard output.
    pub fn path(&self) -> Option<&Path> {
        match &self.target {
            Target::File { path, .. } => Some(path),
            Target::Stdout => None,
        }
    }

    /// Waits until everything is written and synced. A file still has its temporary name.
    pub fn finish(mut self) -> Result<Complete, SinkError> {
        let bytes = self.join()?;
        let held = self.held.take();
        if let Some(Held { partial: Some(_), file, .. }) = &held {
            file.sync_all().map_err(|err| self.target.error("sync", err))?;
        }
        Ok(Complete { bytes, target: self.target.clone(), held })
    }

    fn join(&mut self) -> Result<u64, SinkError> {
        self.queue.close();
        let gone = || SinkError::Thread {
            target: self.target.name(),
            reason: "its thread has ended; this is a bug, please report it".to_owned(),
        };
        let result = self.thread.take().map(JoinHandle::join);
        match (result, self.queue.failure()) {
            (Some(Ok(Some(bytes))), _) => Ok(bytes),
            (_, Some(failure)) => Err(failure),
            _ => Err(gone()),
        }
    }
}

impl Complete {
    /// Removes the file instead of putting it in place.
    pub fn discard(mut self) {
        if let Some(Held { partial: Some(partial), .. }) = &mut self.held {
            partial.is_kept = false;
        }
    }

    /// Puts the file in place. Its destination may have changed during the run.
    pub fn place(self) -> Result<(), SinkError> {
        let Complete { target, held, .. } = self;
        let (Target::File { path, .. }, Some(Held { partial: Some(partial), file, there })) = (&target, held) else {
            return Ok(());
        };
        // another file may have been put at the destination during the run
        let written = partial.path.display();
        if !leads_to(&partial.path, &file).map_err(|err| target.error("rename the .partial file to", err))? {
            return Err(SinkError::taken(path, &format!("another program has replaced {written}; record it again")));
        }
        if let Ok(found) = std::fs::symlink_metadata(path) {
            let is_same = found.is_file() && there.is_some() && Handle::from_path(path).ok() == there;
            if !is_same || !File::open(path).is_ok_and(|file| may_be_replaced(&file).unwrap_or(false)) {
                let what = format!("something else has been put there in the meantime; the recording is in {written}");
                return Err(SinkError::taken(path, &what));
            }
        }
        drop(there);
        atomic::place(&partial.path, path).map_err(|err| target.error("rename the .partial file to", err))
    }
}

/// On failure: the data written so far gets its footer and remains in the temporary file.
impl Drop for Writer {
    fn drop(&mut self) {
        if self.thread.is_none() {
            return;
        }
        self.queue.close();
        // a pipe whose reader is blocked would keep the program from ending; a disk makes progress
        let patience = if self.held.as_ref().is_some_and(|held| held.partial.is_some()) { 60 } else { 2 };
        if self.queue.wait_ended(Duration::from_secs(patience)) {
            self.join().ok();
        }
        if let Some(Held { partial: Some(partial), .. }) = &mut self.held {
            let is_empty = || std::fs::metadata(&partial.path).is_ok_and(|written| written.len() == 0);
            partial.is_kept = self.sent > 0 && !is_empty();
        }
    }
}

/// Rejects a standard output that a recording would corrupt, or that would corrupt one: a non-empty file, or the file
/// to save to.
pub(super) fn check_stdout(save: Option<&Path>) -> Result<(), SinkError> {
    let rejected = |what: &str| Err(SinkError::Usage(what.to_owned()));
    let Ok(stdout) = Handle::stdout() else { return Ok(()) };
    match stdout.as_file().metadata() {
        Ok(there) if there.is_file() && there.len() > 0 => {
            return rejected("standard output is a file that is not empty; send the recording to a new one");
        }
        Ok(there) if !there.is_file() => return Ok(()),
        _ => {}
    }
    let is_file = |path: &&Path| std::fs::metadata(path).is_ok_and(|there| there.is_file());
    match save.filter(is_file).map(Handle::from_path) {
        Some(Ok(save)) if save == stdout => {
            rejected("standard output is the file to save to as well; leave one of them out")
        }
        _ => Ok(()),
    }
}

/// Whether standard output is a terminal.
pub(super) fn is_terminal() -> bool {
    io::stdout().is_terminal()
}

/// Counts the bytes that pass through.
struct Counted<W> {
    out: W,
    bytes: u64,
}

impl<W: Write> Write for Counted<W> {
    fn write(&mut self, buf: &[u8]) -> io::Result<usize> {
        let n = self.out.write(buf)?;
        self.bytes += n as u64;
        Ok(n)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

/// Writes all messages of the queue, then the footer; returns the size [bytes].
fn write<W: Write>(target: &Target, queue: &Queue, out: W) -> Result<u64, SinkError> {
    let out = BufWriter::with_capacity(BUFFER, Counted { out, bytes: 0 });
    let mut encoder = Encoder::new_eager(CrateVersion::LOCAL, EncodingOptions::PROTOBUF_COMPRESSED, out)
        .map_err(|err| target.encode_error(err))?;
    if let Err(err) = encode(target, queue, &mut encoder) {
        // a footer after half a message would corrupt the file further: discard the buffer
        encoder.into_inner().map(BufWriter::into_parts).ok();
        return Err(err);
    }
    let out = encoder.into_inner().map_err(|err| target.encode_error(err))?;
    let out = out.into_inner().map_err(|err| target.error("write", err.into_error()))?;
    Ok(out.bytes)
}

fn encode<W: Write>(target: &Target, queue: &Queue, encoder: &mut Encoder<W>) -> Result<(), SinkError> {
    let mut has_begun = false;
    // the header has not been flushed yet
    let mut is_flushed = false;
    let mut flushed_at = Instant::now();
    loop {
        let idle = (!is_flushed).then(|| FLUSH_EVERY.saturating_sub(flushed_at.elapsed()));
        let batch = queue.take(BATCH, idle);
        if !has_begun {
            flushed_at = Instant::now(); // no data was at risk before
        }
        for msg in &batch.messages {
            encoder.append(msg).map_err(|err| target.encode_error(err))?;
            (has_begun, is_flushed) = (true, false);
        }
        if batch.last {
            encoder.finish().map_err(|err| target.encode_error(err))?;
        }
        if batch.last || batch.flush || (!is_flushed && flushed_at.elapsed() >= FLUSH_EVERY) {
            encoder.flush_blocking().map_err(|err| target.encode_error(err))?;
            is_flushed = true;
            flushed_at = Instant::now();
        }
        queue.done(&batch, batch.messages.len(), is_flushed);
        if batch.last {
            return Ok(());
        }
    }
}
