//! Output files, checked before measuring and written afterwards, so that "permission denied" is reported at once
//! instead of after minutes.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, Write},
    path::{Path, PathBuf},
};

use crate::stream::unfinished;

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
        let output = Output { path, is_replaced: true };
        File::create_new(output.partial())?; // does not follow links
        fs::remove_file(output.partial())?;
        Ok(output)
    }

    /// The path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The temporary path to which it is first written.
    fn partial(&self) -> PathBuf {
        let mut name = self.path.file_name().unwrap_or_default().to_owned();
        name.push(format!(".{}.partial", std::process::id()));
        self.path.with_file_name(name)
    }

    /// Replaces the file's content with `text` atomically: on failure, the file is unchanged.
    ///
    /// # Errors
    /// The operating system's error.
    pub fn write(&self, text: &str) -> io::Result<()> {
        if !self.is_replaced {
            return OpenOptions::new().write(true).open(&self.path)?.write_all(text.as_bytes());
        }
        let partial = self.partial();
        let written = unfinished::create_new(&partial)
            .and_then(|mut file| file.write_all(text.as_bytes()).and_then(|()| file.sync_all()))
            .and_then(|()| fs::rename(&partial, &self.path));
        if written.as_ref().is_err_and(|error| error.kind() != io::ErrorKind::AlreadyExists) {
            fs::remove_file(&partial).ok();
        }
        unfinished::forget(&partial);
        written
    }
}
