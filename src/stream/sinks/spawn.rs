//! Starts a viewer.
//!
//! The SDK's own `spawn` is not used because its viewer listens on every interface and inherits standard output, where it
//! would corrupt `--stdout` and keep the pipe of a program that reads our output open until the window is closed.

use std::ffi::OsString;
use std::fs::{File, OpenOptions};
use std::io::{self, Read as _, Seek as _, SeekFrom};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use super::live::within;
use super::note::{install_help, seconds};
use super::{SinkError, Spawn};
use crate::sdk::{self, CrateVersion};

/// Timeout of a viewer's start; the first start on a slow machine takes several seconds.
const START: Duration = Duration::from_secs(30);
/// Timeout of asking a viewer for its version.
const VERSION: Duration = Duration::from_secs(10);
/// Memory limit of the viewer, as a share of the machine's memory; beyond it the viewer drops the oldest data.
const VIEWER_MEMORY: &str = "25%";
/// Memory limit of a started viewer's own gRPC server, for others that connect to it; the viewer has the data already.
const SERVER_MEMORY: &str = "1GiB";

/// A viewer that listens on this machine.
pub(super) struct Spawned {
    pub address: SocketAddr,
    pub notes: Vec<String>,
}

/// Starts a viewer, or finds one that already listens on the port, as `rerun` itself does. With `avoid`, the port
/// is known to be in use by something else, and a free one is used instead.
pub(super) fn spawn(spawn: &Spawn, avoid: bool) -> Result<Spawned, SinkError> {
    let program = spawn.program.to_string_lossy().into_owned();
    let spawn_error = |reason: String, help: String| {
        SinkError::Failed(format!("cannot start the viewer `{program}`: {reason}; {help}"))
    };
    let mut address = SocketAddr::from((Ipv4Addr::LOCALHOST, spawn.port));
    if avoid {
        let free = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).and_then(|listener| listener.local_addr());
        address = free.map_err(|err| spawn_error(format!("no free port ({err})"), install_help()))?;
    } else if TcpStream::connect_timeout(&address, Duration::from_secs(1)).is_ok() {
        let note =
            format!("something already listens on {address}: it is assumed to be a viewer, and no other is started");
        return Ok(Spawned { address, notes: vec![note] });
    }

    #[cfg(windows)]
    const CREATE_NEW_PROCESS_GROUP: u32 = 0x200;

    let mut log = Log::create();
    let mut command = Command::new(&spawn.program);
    command
        .arg(format!("--port={}", address.port()))
        .arg(format!("--bind={}", address.ip()))
        .arg(format!("--memory-limit={VIEWER_MEMORY}"))
        .arg(format!("--server-memory-limit={SERVER_MEMORY}"))
        .arg("--expect-data-soon")
        .stdin(Stdio::null())
        .stdout(log.stdio())
        .stderr(log.stdio());
    // a Ctrl-C that ends the run must not close the viewer's window
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    #[cfg(windows)]
    std::os::windows::process::CommandExt::creation_flags(&mut command, CREATE_NEW_PROCESS_GROUP);
    let mut child = command.spawn().map_err(|err| match err.kind() {
        io::ErrorKind::NotFound => spawn_error("it is not installed, or not on the PATH".to_owned(), install_help()),
        _ => spawn_error(err.to_string(), install_help()),
    })?;

    let started = Instant::now();
    while TcpStream::connect_timeout(&address, Duration::from_secs(1)).is_err() {
        match child.try_wait() {
            Ok(Some(status)) => {
                let help = "check whether it starts on its own; without a screen, use --serve or --save".to_owned();
                return Err(spawn_error(format!("it ended at once ({status}){}", log.tail()), help));
            }
            Ok(None) if started.elapsed() < START => std::thread::sleep(Duration::from_millis(50)),
            _ => {
                end(&mut child);
                let help = "check whether it starts on its own".to_owned();
                let reason = format!("it does not listen on {address} after {}{}", seconds(START), log.tail());
                return Err(spawn_error(reason, help));
            }
        }
    }
    // the viewer outlives the run: it is neither terminated nor waited for
    drop(child);
    let mut notes = vec![format!("started the viewer `{program}`, listening on {address}")];
    notes.extend(other_version(&spawn.program));
    Ok(Spawned { address, notes })
}

/// A warning if the program is a viewer of another version.
fn other_version(program: &OsString) -> Option<String> {
    let mut command = Command::new(program);
    command.arg("--version").stdin(Stdio::null()).stderr(Stdio::null());
    let output = within(VERSION, move || command.output())?.ok()?;
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let theirs = CrateVersion::try_parse_from_build_info_string(text).ok()?;
    let ours = sdk::VERSION;
    (!theirs.is_compatible_with(ours)).then(|| {
        format!("the viewer has version {theirs} and may not understand this program's {ours}: {}", install_help())
    })
}

/// Terminates a viewer that was started and does not respond. The program `rerun` may be a script that started the real
/// viewer, so the signal is sent to the whole process group.
fn end(child: &mut Child) {
    #[cfg(unix)]
    Command::new("kill").args(["-TERM", "--", &format!("-{}", child.id())]).status().ok();
    child.kill().ok();
    child.wait().ok();
}

/// The output of a starting viewer, quoted if it fails. A file instead of a pipe, because a pipe would break once this
/// program has ended. The file is unlinked immediately, and its space is freed when the viewer ends.
struct Log(Option<File>);

impl Log {
    fn create() -> Log {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("meldscope-viewer-{}-{number}.log", std::process::id()));
        let file = OpenOptions::new().read(true).append(true).create_new(true).open(&path).ok();
        if file.is_some() {
            std::fs::remove_file(&path).ok();
        }
        Log(file)
    }

    fn stdio(&self) -> Stdio {
        self.0.as_ref().and_then(|file| file.try_clone().ok()).map_or_else(Stdio::null, Stdio::from)
    }

    /// The last lines, formatted to be appended to a reason.
    fn tail(&mut self) -> String {
        let mut text = Vec::new();
        if let Some(file) = &mut self.0 {
            let length = file.metadata().map_or(0, |metadata| metadata.len());
            // seeking does not affect the viewer's writes, which append
            file.seek(SeekFrom::Start(length.saturating_sub(4096))).ok();
            file.take(4096).read_to_end(&mut text).ok();
        }
        let text = without_escapes(&String::from_utf8_lossy(&text));
        let lines: Vec<&str> = text.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
        // prefer a single line that reports an error; otherwise use the last lines
        let is_error = |line: &&&str| line.to_ascii_lowercase().starts_with("error");
        let message = match lines.iter().rfind(is_error) {
            Some(error) => (*error).to_owned(),
            None => lines[lines.len().saturating_sub(3)..].join(" / "),
        };
        if message.is_empty() { message } else { format!(": {message}") }
    }
}

/// Removes escape sequences and other control characters from `text`, except line breaks.
fn without_escapes(text: &str) -> String {
    let mut plain = String::new();
    let mut chars = text.chars();
    while let Some(c) = chars.next() {
        match c {
            // a control sequence ends with a letter
            '\u{1b}' => {
                chars.find(|c| c.is_ascii_alphabetic());
            }
            '\n' => plain.push('\n'),
            c if c.is_control() => {}
            c => plain.push(c),
        }
    }
    plain
}

#[cfg(test)]
mod tests {
    use super::without_escapes;

    #[test]
    fn colours_are_removed_and_lines_kept() {
        assert_eq!(without_escapes("\u{1b}[31mred\u{1b}[0m\r\nplain\u{7}"), "red\nplain");
    }
}
