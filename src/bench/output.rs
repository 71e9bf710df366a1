//! Files that are written in the end, and checked in the beginning: nobody should wait minutes for "permission denied".

use std::{
    fs::{self, File, OpenOptions},
    io::{self, Write},
    path::{Path, PathBuf},
};

/// A file that can be written, as far as that can be known before.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Output {
    /// Symbolic links followed.
    path: PathBuf,
    /// A device or a pipe is written to, everything else is replaced.
    is_replaced: bool,
}

impl Output {
    /// Finds out whether `path` can be written; leaves everything as it is.
    ///
    /// # Errors
    /// The operating system's answer.
    pub fn claim(path: &Path) -> io::Result<Output> {
        let path = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
        match fs::metadata(&path) {
            Ok(there) if there.is_dir() => return Err(io::ErrorKind::IsADirectory.into()),
            Ok(there) => {
                // a rename would replace even a file that is write-protected
                OpenOptions::new().write(true).open(&path)?;
                if !there.is_file() {
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
        File::create_new(output.partial())?; // through no link
        fs::remove_file(output.partial())?;
        Ok(output)
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The name under which it is written.
    fn partial(&self) -> PathBuf {
        let mut name = self.path.file_name().unwrap_or_default().to_owned();
        name.push(format!(".{}.partial", std::process::id()));
        self.path.with_file_name(name)
    }

    /// Makes `text` what is in the file: all of it, or the file stays as it was.
    ///
    /// # Errors
    /// The operating system's answer.
    pub fn write(&self, text: &str) -> io::Result<()> {
        if !self.is_replaced {
            return OpenOptions::new().write(true).open(&self.path)?.write_all(text.as_bytes());
        }
        let partial = self.partial();
        let written = File::create_new(&partial)
            .and_then(|mut file| file.write_all(text.as_bytes()).and_then(|()| file.sync_all()))
            .and_then(|()| fs::rename(&partial, &self.path));
        if written.as_ref().is_err_and(|error| error.kind() != io::ErrorKind::AlreadyExists) {
            fs::remove_file(&partial).ok();
        }
        written
    }
}
