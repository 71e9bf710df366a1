//! Output files, checked before measuring and written afterwards, so that "permission denied" is reported at once
//! instead of after minutes.

use std::{
    fs::{self, OpenOptions},
    io::{self, Write},
    path::{Path, PathBuf},
};

use crate::atomic::AtomicFile;

/// A file that can be written, as far as this can be checked in advance.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Output {
    /// The path, with symbolic links resolved.
    path: PathBuf,
    /// Whether the file is replaced; devices and pipes are written to instead.
    is_replaced: bool,
}

impl Output {
    /// Checks whether `path` can be written, without changing anything.
    ///
    /// # Errors
    /// The operating system's error.
    pub fn claim(path: &Path) -> io::Result<Output> {
        let path = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
        match fs::metadata(&path) {
            Ok(metadata) if metadata.is_dir() => return Err(io::ErrorKind::IsADirectory.into()),
            Ok(metadata) => {
                // opened as a test, because a rename would replace even a write-protected file
                OpenOptions::new().write(true).open(&path)?;
                if !metadata.is_file() {
                    return Ok(Output { path, is_replaced: false });
                }
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(error),
        }
        if path.file_name().is_none() {
            return Err(io::ErrorKind::IsADirectory.into());
        }
        AtomicFile::create(&path)?; // removed at once
        Ok(Output { path, is_replaced: true })
    }

    /// The path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Replaces the file's content with `text` atomically: on failure, the file is unchanged.
    ///
    /// # Errors
    /// The operating system's error.
    pub fn write(&self, text: &str) -> io::Result<()> {
        if !self.is_replaced {
            return OpenOptions::new().write(true).open(&self.path)?.write_all(text.as_bytes());
        }
        let mut file = AtomicFile::create(&self.path)?;
        file.write_all(text.as_bytes())?;
        file.commit().map(drop)
    }
}
