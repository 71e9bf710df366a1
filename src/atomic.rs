//! Files that are either complete or not there: the one place that puts files in the place of others.
//!
//! A file is first written under a temporary name in the folder of its destination, and renamed when it is complete.
//! Temporary names are random, and a temporary file is created exclusively: processes that share a folder, on machines
//! that know nothing of each other, never write or remove each other's files. An interrupt removes the temporary files
//! of this process.

use std::{
    ffi::OsString,
    fs::{self, File, OpenOptions},
    io::{self, Write},
    path::{Path, PathBuf},
    sync::Mutex,
};

use crate::lock;

/// The end of every temporary name.
pub const PARTIAL: &str = ".partial";

/// The temporary files of this process.
static UNFINISHED: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());
/// Held while files are put in place together.
static PLACING: Mutex<()> = Mutex::new(());

/// Creates a temporary file, which must not exist yet; never follows a link. An interrupt removes it.
///
/// # Errors
/// The operating system's error.
pub fn create_new(path: &Path) -> io::Result<File> {
    let mut files = lock(&UNFINISHED); // locked, so that an interrupt cannot come between creating and listing the file
    let file = OpenOptions::new().write(true).create_new(true).open(path)?;
    files.push(path.to_owned());
    Ok(file)
}

/// Adds a temporary file of this process: an interrupt removes it.
pub fn add(path: &Path) {
    lock(&UNFINISHED).push(path.to_owned());
}

/// An interrupt no longer removes this file: it is complete, or kept incomplete.
pub fn forget(path: &Path) {
    lock(&UNFINISHED).retain(|file| file != path);
}

/// Removes all temporary files and ends the program. Waits for files that are being put in place together.
pub fn exit(status: i32) -> ! {
    let _held = PLACING.lock();
    let files = lock(&UNFINISHED); // locked, so that no other file is created meanwhile
    for file in &*files {
        fs::remove_file(file).ok();
    }
    std::process::exit(status)
}

/// Puts several files in place, without an interrupt in between.
pub fn together<T>(place: impl FnOnce() -> T) -> T {
    let _held = lock(&PLACING);
    place()
}

/// Puts a complete file, already synced, in the place of another one.
///
/// # Errors
/// The operating system's error.
pub fn place(temporary: &Path, destination: &Path) -> io::Result<()> {
    fs::rename(temporary, destination)?;
    sync_folder(destination);
    Ok(())
}

/// Makes a new name durable, on systems that can open a folder; elsewhere there is no remedy.
fn sync_folder(path: &Path) {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    File::open(folder).and_then(|folder| folder.sync_all()).ok();
}

/// A name that no other process has: `start`, random digits, `end`.
///
/// # Errors
/// The system has no random numbers.
pub fn unique_name(start: impl Into<OsString>, end: &str) -> io::Result<OsString> {
    let mut bytes = [0; 8];
    getrandom::fill(&mut bytes).map_err(io::Error::other)?;
    let mut name = start.into();
    name.push(format!("{:016x}{end}", u64::from_le_bytes(bytes)));
    Ok(name)
}

/// What to do where the folder of a file is missing.
pub fn missing_folder(path: &Path) -> Option<String> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty() && !folder.is_dir())?;
    Some(format!("there is no directory {}: create it first", folder.display()))
}

/// What to do about a file that cannot be written, for the end of a message.
pub fn remedy(path: &Path, error: &io::Error) -> String {
    if let (io::ErrorKind::NotFound, Some(remedy)) = (error.kind(), missing_folder(path)) {
        return remedy;
    }
    let remedy = match error.kind() {
        io::ErrorKind::StorageFull => "the disk is full: make room or save elsewhere",
        io::ErrorKind::QuotaExceeded => "your disk quota is used up: make room or save elsewhere",
        io::ErrorKind::FileTooLarge => "the file system or a limit (`ulimit -f`) allows no larger file: save elsewhere",
        io::ErrorKind::PermissionDenied => "you have no write permission there: save elsewhere",
        io::ErrorKind::ReadOnlyFilesystem => "the file system is read-only: save elsewhere",
        io::ErrorKind::AlreadyExists | io::ErrorKind::NotADirectory => "a file is in the way: choose another folder",
        io::ErrorKind::BrokenPipe => "the program that was reading it has gone",
        io::ErrorKind::InvalidFilename => {
            "the system does not allow that name, or its temporary one: choose another, shorter one"
        }
        io::ErrorKind::IsADirectory => "give the name of a file",
        _ => "save elsewhere",
    };
    remedy.to_owned()
}

/// The destination that a path leads to, with the links in it resolved; the file need not exist.
pub fn destination(path: &Path) -> PathBuf {
    let there = || {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        Some(fs::canonicalize(folder).ok()?.join(path.file_name()?))
    };
    fs::canonicalize(path).ok().or_else(there).unwrap_or_else(|| path.to_owned())
}

/// Whether two paths are the same destination. Names that differ in case only may be, where most file systems ignore it.
pub fn is_same_destination(a: &Path, b: &Path) -> bool {
    let [a, b] = [a, b].map(destination);
    let ignores_case = cfg!(any(windows, target_os = "macos"));
    a == b || ignores_case && a.to_string_lossy().to_lowercase() == b.to_string_lossy().to_lowercase()
}

/// Writes a file unless there is one by now: of several processes that start at once, one writes it.
///
/// # Errors
/// [`io::ErrorKind::AlreadyExists`], or another of the operating system's errors.
pub fn write_new(path: &Path, text: &str) -> io::Result<()> {
    let mut file = AtomicFile::create(path)?;
    file.write_all(text.as_bytes())?;
    file.commit_new()
}

/// A file being written, under a temporary name; removed when dropped.
pub struct AtomicFile {
    destination: PathBuf,
    temporary: PathBuf,
    /// `None` once closed.
    file: Option<File>,
}

impl AtomicFile {
    /// Begins a file.
    ///
    /// # Errors
    /// The operating system's error.
    pub fn create(path: &Path) -> io::Result<AtomicFile> {
        let destination = destination(path);
        let name = destination.file_name().ok_or(io::ErrorKind::IsADirectory)?;
        // short enough for the rest, wherever the file's own name is
        let start: String = name.to_string_lossy().chars().take(50).collect();
        let temporary = destination.with_file_name(unique_name(format!(".{start}."), PARTIAL)?);
        let file = Some(create_new(&temporary)?);
        Ok(AtomicFile { destination, temporary, file })
    }

    /// Another handle to the file.
    ///
    /// # Errors
    /// The operating system's error.
    pub fn handle(&self) -> io::Result<File> {
        self.open()?.try_clone()
    }

    fn open(&self) -> io::Result<&File> {
        self.file.as_ref().ok_or_else(|| io::ErrorKind::NotFound.into())
    }

    /// Replaces the destination; returns the size [bytes].
    ///
    /// # Errors
    /// The operating system's error. The destination is unchanged.
    pub fn commit(mut self) -> io::Result<u64> {
        let size = self.close()?;
        place(&self.temporary, &self.destination)?;
        Ok(size)
    }

    /// Puts the file in place unless there is one already, even if other processes try at the same time.
    ///
    /// # Errors
    /// [`io::ErrorKind::AlreadyExists`], or another of the operating system's errors.
    pub fn commit_new(mut self) -> io::Result<()> {
        self.close()?;
        match fs::hard_link(&self.temporary, &self.destination) {
            Err(error) if error.kind() != io::ErrorKind::AlreadyExists && !self.destination.exists() => {
                // A file system without links: its creation alone is exclusive, so a crash may leave it incomplete.
                let mut to = OpenOptions::new().write(true).create_new(true).open(&self.destination)?;
                io::copy(&mut File::open(&self.temporary)?, &mut to)?;
                to.sync_all()?;
            }
            linked => linked?,
        }
        sync_folder(&self.destination);
        Ok(())
    }

    /// Syncs and closes the file; returns its size [bytes].
    fn close(&mut self) -> io::Result<u64> {
        let file = self.open()?;
        file.sync_all()?;
        let size = file.metadata()?.len();
        self.file = None;
        Ok(size)
    }
}

impl Write for AtomicFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.open()?.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.open()?.flush()
    }
}

impl Drop for AtomicFile {
    fn drop(&mut self) {
        self.file = None; // some systems do not remove open files
        fs::remove_file(&self.temporary).ok(); // gone if it was renamed
        forget(&self.temporary);
    }
}
