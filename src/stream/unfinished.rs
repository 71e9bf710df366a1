//! Unfinished files, which are removed when the program is interrupted.

use std::{
    fs::{self, File, OpenOptions},
    io,
    path::{Path, PathBuf},
    sync::{Mutex, MutexGuard, PoisonError},
};

static FILES: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

fn files() -> MutexGuard<'static, Vec<PathBuf>> {
    FILES.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Creates a file that does not exist yet; never follows a link.
///
/// # Errors
/// The operating system's error.
pub fn create_new(path: &Path) -> io::Result<File> {
    let mut files = files(); // locked, so that an interrupt cannot come between creating and listing the file
    let file = OpenOptions::new().write(true).create_new(true).open(path)?;
    files.push(path.to_owned());
    Ok(file)
}

/// Adds a temporary file of this program.
pub fn add(path: &Path) {
    files().push(path.to_owned());
}

/// Removes a file from the list: it is finished, or kept unfinished.
pub fn forget(path: &Path) {
    files().retain(|file| file != path);
}

/// Removes all unfinished files and ends the program.
pub fn exit(status: i32) -> ! {
    let files = files(); // locked, so that no other file is created meanwhile
    for file in &*files {
        fs::remove_file(file).ok();
    }
    std::process::exit(status)
}
