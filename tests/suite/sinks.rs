//! Destinations of a recording, and what happens when one fails.
//!
//! Each test has its own directory and ports; nothing is left behind.

use std::fs;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use meldscope::sdk::{self, Chunk, DecoderApp, LogMsg, RowId, StoreId, StoreKind, TimePoint, Timeline};
use meldscope::stream::sinks::{Destinations, Serve, SinkError, Sinks, Spawn};

use crate::viewer::Viewer;

// ---- messages ----

fn store() -> StoreId {
    StoreId::new(StoreKind::Recording, "sinks_test", "one")
}

fn arrow(chunk: &Chunk) -> LogMsg {
    LogMsg::ArrowMsg(store(), chunk.to_arrow_msg().expect("a chunk of one row encodes"))
}

/// The messages that begin every recording, and a static component.
pub fn opening() -> Vec<LogMsg> {
    let info = sdk::StoreInfo::new_unversioned(store(), sdk::StoreSource::Other("test".to_owned()));
    let row_id = *RowId::new();
    let store_info = LogMsg::SetStoreInfo(sdk::SetStoreInfo { row_id, info });
    let up = Chunk::builder("world")
        .with_archetype_auto_row(TimePoint::STATIC, &sdk::ViewCoordinates::RIGHT_HAND_Z_UP())
        .build();
    vec![store_info, arrow(&up.expect("a valid chunk"))]
}

/// One step with `points` points, which do not compress.
fn step(step: i64, points: usize) -> LogMsg {
    let mut seed = step as u64 * 0x9e37_79b9_7f4a_7c15 + 1;
    let mut random = || {
        seed ^= seed << 13;
        seed ^= seed >> 7;
        seed ^= seed << 17;
        seed as f32
    };
    let positions: Vec<[f32; 3]> = (0..points).map(|_| [random(), random(), random()]).collect();
    let chunk = Chunk::builder("world/bodies/a")
        .with_archetype_auto_row([(Timeline::new_sequence("step"), step)], &sdk::Points3D::new(positions))
        .build();
    arrow(&chunk.expect("a valid chunk"))
}

pub fn recording(steps: i64) -> Vec<LogMsg> {
    opening().into_iter().chain((0..steps).map(|i| step(i, 100))).collect()
}

// ---- tools ----

/// A temporary directory, removed on drop.
struct Dir(PathBuf);

impl Dir {
    fn new() -> Dir {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("meldscope-sinks-{}-{number}", std::process::id()));
        fs::create_dir(&path).expect("a new directory");
        Dir(path)
    }

    fn file(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    fn names(&self) -> Vec<String> {
        let entries = fs::read_dir(&self.0).expect("a directory");
        let mut names: Vec<String> =
            entries.map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }
}

impl Drop for Dir {
    fn drop(&mut self) {
        fs::remove_dir_all(&self.0).ok();
    }
}

fn to_file(path: &Path) -> Destinations {
    Destinations { save: Some(path.to_owned()), patience: Duration::from_secs(1), ..Destinations::default() }
}

/// The error of a result whose value has no `Debug`.
fn rejected<T>(result: Result<T, SinkError>) -> SinkError {
    match result {
        Ok(_) => panic!("this should have been rejected"),
        Err(err) => err,
    }
}

fn send_all(sinks: &mut Sinks, messages: &[LogMsg]) {
    for msg in messages {
        sinks.send(msg.clone()).expect("a destination that works");
    }
}

fn decode(reader: impl std::io::BufRead) -> Vec<LogMsg> {
    DecoderApp::decode_lazy(reader).map_while(Result::ok).collect()
}

/// The messages of a file up to its end or the first truncated message.
fn read(path: &Path) -> Vec<LogMsg> {
    decode(BufReader::new(fs::File::open(path).expect("a file")))
}

/// Asserts the same rows and store infos. Decoding adds its own metadata, so chunks are compared by identity and
/// content.
fn assert_same(read: &[LogMsg], sent: &[LogMsg]) {
    assert_eq!(read.len(), sent.len());
    for (read, sent) in read.iter().zip(sent) {
        match (read, sent) {
            (LogMsg::ArrowMsg(read_store, read), LogMsg::ArrowMsg(sent_store, sent)) => {
                assert_eq!(read_store, sent_store);
                assert_eq!(read.chunk_id, sent.chunk_id);
                assert_eq!(read.batch.columns(), sent.batch.columns());
            }
            (LogMsg::SetStoreInfo(read), LogMsg::SetStoreInfo(sent)) => {
                assert_eq!(read.info.store_id, sent.info.store_id);
            }
            _ => panic!("{read:?} was sent as {sent:?}"),
        }
    }
}

fn has_footer(path: &Path) -> bool {
    let mut decoder = DecoderApp::decode_lazy(BufReader::new(fs::File::open(path).expect("a file")));
    while decoder.next().is_some() {}
    decoder.rrd_manifests().is_ok_and(|manifests| manifests.len() == 1)
}

fn free_port() -> u16 {
    TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).and_then(|listener| listener.local_addr()).expect("a free port").port()
}

fn url(port: u16) -> String {
    format!("rerun+http://127.0.0.1:{port}/proxy")
}

/// Waits until another thread has made a condition true.
fn eventually(what: &str, mut is_so: impl FnMut() -> bool) {
    let started = Instant::now();
    while !is_so() {
        assert!(started.elapsed() < Duration::from_secs(20), "{what}: not within 20 s");
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn answers(port: u16) -> bool {
    TcpStream::connect_timeout(&SocketAddr::from((Ipv4Addr::LOCALHOST, port)), Duration::from_secs(1)).is_ok()
}

/// The first `count` messages that the server at `port` has for a new viewer, requested as a browser does: with
/// gRPC-web, that is, frames of a byte, a length and a message, in HTTP chunks.
pub fn watch(port: u16, count: usize) -> Vec<Vec<u8>> {
    let mut stream = TcpStream::connect((Ipv4Addr::LOCALHOST, port)).expect("the server listens");
    stream.set_read_timeout(Some(Duration::from_secs(10))).expect("a timeout");
    let head = "POST /rerun.sdk_comms.v1alpha1.MessageProxyService/ReadMessages HTTP/1.1\r\nhost: 127.0.0.1\r\n\
                content-type: application/grpc-web+proto\r\ncontent-length: 5\r\n\r\n";
    stream.write_all(head.as_bytes()).and_then(|()| stream.write_all(&[0; 5])).expect("the server reads the request");
    let mut reader = BufReader::new(stream);
    let line = |reader: &mut BufReader<TcpStream>| {
        let mut line = String::new();
        reader.read_line(&mut line).ok()?;
        Some(line.trim_end().to_owned())
    };
    assert_eq!(line(&mut reader).as_deref(), Some("HTTP/1.1 200 OK"));
    while line(&mut reader).is_some_and(|line| !line.is_empty()) {}

    let (mut bytes, mut frames) = (Vec::new(), Vec::new());
    while frames.len() < count {
        let length = line(&mut reader).and_then(|line| usize::from_str_radix(&line, 16).ok());
        let length = length.expect("the length of a chunk");
        let start = bytes.len();
        bytes.resize(start + length, 0);
        reader.read_exact(&mut bytes[start..]).expect("a chunk");
        assert_eq!(line(&mut reader).as_deref(), Some(""));
        while let [_, a, b, c, d, rest @ ..] = &bytes[..]
            && let Some(frame) = rest.get(..u32::from_be_bytes([*a, *b, *c, *d]) as usize)
        {
            frames.push(frame.to_vec());
            bytes.drain(..5 + frames[frames.len() - 1].len());
        }
    }
    assert_eq!(frames.len(), count);
    frames
}

// ---- files ----

#[test]
fn a_file_holds_the_messages_in_order_with_a_footer() {
    let dir = Dir::new();
    let path = dir.file("run.rrd");
    fs::write(&path, "RRF2: what was there").expect("a file");
    let mut sinks = Sinks::open(&to_file(&path)).expect("a file that can be written");
    let sent = recording(500);
    send_all(&mut sinks, &sent);
    let finished = sinks.finish().expect("disk space");

    let saved = finished.save.expect("a file was asked for");
    assert_eq!(saved.path, path);
    assert_eq!(saved.bytes, fs::metadata(&path).expect("a file").len());
    assert_same(&read(&path), &sent);
    assert!(has_footer(&path));
    assert_eq!(dir.names(), ["run.rrd"]);
    assert_eq!(finished.notes, [""; 0]);
}

#[test]
fn the_file_is_unchanged_until_the_run_is_finished() {
    let dir = Dir::new();
    let path = dir.file("run.rrd");
    fs::write(&path, "RRF2: what was there").expect("a file");
    let sent = recording(20);

    // dropped, as when the run panics
    let mut sinks = Sinks::open(&to_file(&path)).expect("a file that can be written");
    send_all(&mut sinks, &sent);
    drop(sinks);
    assert_eq!(fs::read(&path).expect("a file"), b"RRF2: what was there");
    let partial = dir.file("run.rrd.partial");
    assert_same(&read(&partial), &sent);
    assert!(has_footer(&partial));

    // if another destination cannot be opened, the file of the dropped run is not touched either
    let taken = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
    let port = taken.local_addr().expect("an address").port();
    let serve = Serve { web_port: 0, grpc_port: port, ..Serve::default() };
    rejected(Sinks::open(&Destinations { serve: Some(serve), ..to_file(&path) }));
    assert_eq!(fs::read(&path).expect("a file"), b"RRF2: what was there");
    assert_same(&read(&partial), &sent);

    // the next run reports that it overwrites them
    let mut sinks = Sinks::open(&to_file(&path)).expect("a file that can be written");
    let notes = sinks.notes();
    assert!(
        notes.len() == 1 && notes[0].contains("run.rrd.partial, which an earlier run left unfinished"),
        "{notes:?}"
    );
    assert_eq!(sinks.notes(), [""; 0]);
    send_all(&mut sinks, &sent);
    sinks.finish().expect("disk space");
    assert_same(&read(&path), &sent);
    assert_eq!(dir.names(), ["run.rrd"]);
}

#[test]
fn without_messages_no_file_is_left() {
    let dir = Dir::new();
    let taken = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
    let port = taken.local_addr().expect("an address").port();
    let serve = Serve { web_port: port, grpc_port: 0, ..Serve::default() };
    rejected(Sinks::open(&Destinations { serve: Some(serve), ..to_file(&dir.file("run.rrd")) }));
    assert_eq!(dir.names(), [""; 0]);
    drop(Sinks::open(&to_file(&dir.file("run.rrd"))).expect("a file that can be written"));
    assert_eq!(dir.names(), [""; 0]);
}

#[test]
fn a_killed_run_can_be_read_up_to_its_last_flush() {
    let dir = Dir::new();
    let path = dir.file("run.rrd");
    let partial = dir.file("run.rrd.partial");
    let sent = recording(20);
    let mut sinks = Sinks::open(&to_file(&path)).expect("a file that can be written");
    send_all(&mut sinks, &sent[..10]);
    sinks.flush().expect("disk space");
    assert_same(&read(&partial), &sent[..10]);
    // later also without a request
    send_all(&mut sinks, &sent[10..]);
    eventually("everything is flushed", || read(&partial).len() == sent.len());

    // truncated in the middle of a message
    let bytes = fs::read(&partial).expect("a file");
    let cut = dir.file("cut.rrd");
    fs::write(&cut, &bytes[..bytes.len() - 100]).expect("a file");
    assert_same(&read(&cut), &sent[..sent.len() - 1]);
    sinks.finish().expect("disk space");
}

#[test]
fn a_second_writer_is_rejected() {
    let dir = Dir::new();
    let path = dir.file("run.rrd");
    let mut first = Sinks::open(&to_file(&path)).expect("a file that can be written");
    send_all(&mut first, &recording(1));
    let err = rejected(Sinks::open(&to_file(&path)));
    assert!(matches!(err, SinkError::Busy { .. }) && !err.is_usage(), "{err}");
    assert!(err.to_string().contains("another run is writing"), "{err}");
    first.finish().expect("disk space");
    // available again
    drop(Sinks::open(&to_file(&path)).expect("a file that can be written"));
    assert_eq!(read(&path).len(), 3);
}

#[test]
fn a_path_that_cannot_be_written_is_rejected() {
    let dir = Dir::new();
    let cases = [
        (dir.file("missing/run.rrd"), format!("there is no directory {}", dir.file("missing").display())),
        (dir.0.clone(), "is a directory; give the name of a file".to_owned()),
        (PathBuf::new(), "cannot".to_owned()),
        (PathBuf::from("/"), "is a directory; give the name of a file".to_owned()),
    ];
    for (path, expected) in cases {
        let err = rejected(Sinks::open(&to_file(&path)));
        assert!(matches!(err, SinkError::File { .. }) && !err.is_usage(), "{err}");
        assert!(err.to_string().contains(&expected), "{err}");
    }
    assert_eq!(dir.names(), [""; 0]);
}

#[cfg(unix)]
#[test]
fn a_symbolic_link_is_kept() {
    let dir = Dir::new();
    let (path, link) = (dir.file("run.rrd"), dir.file("link.rrd"));
    fs::write(&path, "RRF2: what was there").expect("a file");
    std::os::unix::fs::symlink(&path, &link).expect("a link");
    let mut sinks = Sinks::open(&to_file(&link)).expect("a file that can be written");
    send_all(&mut sinks, &recording(1));
    sinks.finish().expect("disk space");
    assert!(fs::symlink_metadata(&link).expect("a link").is_symlink());
    assert_eq!(read(&path).len(), 3);
}

/// Sends until it fails.
fn send_until_error(sinks: &mut Sinks) -> SinkError {
    let msg = step(0, 1_000);
    for _ in 0..100_000 {
        if let Err(err) = sinks.send(msg.clone()) {
            return err;
        }
    }
    panic!("100,000 messages were lost without an error");
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_reported() {
    let mut sinks = Sinks::open(&to_file(Path::new("/dev/full"))).expect("a device can be opened");
    let err = send_until_error(&mut sinks);
    assert!(err.to_string().contains("cannot write /dev/full: No space left on device"), "{err}");
    assert!(err.to_string().contains("the disk is full: make room or save elsewhere"), "{err}");
    assert!(!err.is_usage());
    // and once more at the end, for a caller that only checks there
    assert_eq!(rejected(sinks.finish()).to_string(), err.to_string());

    // a short run notices it at the end
    let mut sinks = Sinks::open(&to_file(Path::new("/dev/full"))).expect("a device can be opened");
    send_all(&mut sinks, &recording(1));
    assert!(rejected(sinks.finish()).to_string().contains("the disk is full"));
}

#[cfg(unix)]
#[test]
fn a_closed_pipe_is_an_error() {
    let dir = Dir::new();
    let pipe = dir.file("pipe");
    assert!(Command::new("mkfifo").arg(&pipe).status().expect("mkfifo runs").success());
    let reader = std::thread::spawn({
        let pipe = pipe.clone();
        move || {
            let mut begin = [0; 1000];
            fs::File::open(pipe).and_then(|mut pipe| pipe.read_exact(&mut begin)).map(|()| begin[..4].to_vec())
        }
    });
    let mut sinks = Sinks::open(&to_file(&pipe)).expect("a pipe with a reader");
    let err = send_until_error(&mut sinks);
    assert!(err.to_string().contains("the program that was reading it has gone"), "{err}");
    assert_eq!(reader.join().expect("the reader ends").expect("the reader reads"), b"RRF2");
    assert_eq!(dir.names(), ["pipe"]);
}

// ---- standard output ----

/// Environment variable that names the test below to the process that it starts.
const CHILD: &str = "MELDSCOPE_TEST_STDOUT_STEPS";

/// Not a test by itself: `standard_output_*` run it as a process and read its standard output.
#[test]
fn child_that_writes_to_standard_output() {
    let Ok(steps) = std::env::var(CHILD) else { return };
    let mut sinks = Sinks::open(&Destinations { stdout: true, ..Destinations::default() }).expect("a pipe");
    for msg in recording(steps.parse().expect("a number")) {
        if let Err(err) = sinks.send(msg) {
            eprintln!("rejected: {err}");
            std::process::exit(7);
        }
    }
    // do not return to the test harness, which would write there too
    std::process::exit(sinks.finish().map_or(8, |_| 0));
}

fn child(steps: u32) -> Command {
    let mut command = Command::new(std::env::current_exe().expect("this test's program"));
    command
        .args(["--exact", "sinks::child_that_writes_to_standard_output", "--nocapture", "--test-threads=1"])
        .env(CHILD, steps.to_string())
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    command
}

#[test]
fn standard_output_gets_the_same_recording() {
    let output = child(50).output().expect("this test's program runs");
    assert!(output.status.success(), "{output:?}");
    // the test harness has already printed there
    let start = output.stdout.windows(4).position(|bytes| bytes == b"RRF2").expect("a recording");
    assert_eq!(decode(&output.stdout[start..]).len(), 52);
}

#[test]
fn standard_output_without_a_reader_is_an_error() {
    let mut child = child(100_000).spawn().expect("this test's program runs");
    let mut begin = [0; 1000];
    child.stdout.take().expect("a pipe").read_exact(&mut begin).expect("a recording");
    let output = child.wait_with_output().expect("it ends");
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(7), "{message}");
    assert!(message.contains("cannot write the recording to standard output: Broken pipe"), "{message}");
    assert!(!message.contains("panicked"), "{message}");
}

// ---- viewers ----

#[test]
fn a_viewer_and_a_file_both_get_everything() {
    let dir = Dir::new();
    let viewer = Viewer::start();
    let destinations = Destinations { connect: Some(viewer.url()), ..to_file(&dir.file("run.rrd")) };
    let mut sinks = Sinks::open(&destinations).expect("a viewer and a file");
    let sent = recording(300);
    send_all(&mut sinks, &sent);
    let finished = sinks.finish().expect("both destinations");
    assert_eq!(finished.notes, [""; 0]);
    assert_eq!(read(&dir.file("run.rrd")).len(), 302);
    assert_eq!(viewer.messages().len(), 302);
}

/// What a failed file no longer takes, a viewer still gets.
#[cfg(target_os = "linux")]
#[test]
fn a_viewer_gets_the_messages_after_a_file_has_failed() {
    let viewer = Viewer::start();
    let destinations = Destinations { connect: Some(viewer.url()), ..to_file(Path::new("/dev/full")) };
    let mut sinks = Sinks::open(&destinations).expect("a viewer and a device");
    let mut sent = 0;
    while !sinks.failed() {
        std::thread::sleep(Duration::from_millis(1));
        sinks.send(step(sent, 1_000)).ok();
        sent += 1;
        assert!(sent < 10_000, "no error");
    }
    for _ in 0..3 {
        assert!(sinks.send(step(sent, 1_000)).is_err());
        sent += 1;
    }
    rejected(sinks.finish());
    assert_eq!(viewer.messages().len() as i64, sent);
}

#[test]
fn a_missing_viewer_is_an_error_only_without_another_destination() {
    let dir = Dir::new();
    let port = free_port();
    let alone = Destinations { connect: Some(url(port)), ..Destinations::default() };
    let err = rejected(Sinks::open(&alone));
    assert!(!err.is_usage());
    let message = err.to_string();
    assert!(
        message.contains(&format!("no viewer answers at {}", url(port))) && message.contains("--spawn"),
        "{message}"
    );
    assert!(message.contains("pip install rerun-sdk==0.36.3"), "{message}");

    let path = dir.file("run.rrd");
    let mut sinks = Sinks::open(&Destinations { save: Some(path.clone()), ..alone }).expect("a file at least");
    let notes = sinks.notes();
    assert!(notes.len() == 1 && notes[0].starts_with("continuing without a viewer: no viewer answers"), "{notes:?}");
    send_all(&mut sinks, &recording(3));
    sinks.finish().expect("disk space");
    assert_eq!(read(&path).len(), 5);
}

#[test]
fn invalid_addresses_are_usage_errors() {
    for bad in ["", "nonsense", "http://127.0.0.1:9876/proxy", "rerun+http://", "127.0.0.1:9876", "rerun+http://a/b"] {
        let destinations = Destinations { connect: Some(bad.to_owned()), ..Destinations::default() };
        let err = rejected(Sinks::open(&destinations));
        assert!(matches!(err, SinkError::Url { .. }) && err.is_usage(), "{bad}: {err}");
        assert!(err.to_string().contains("rerun+http://127.0.0.1:9876/proxy"), "{err}");
    }
    let err = rejected(Sinks::open(&Destinations::default()));
    assert!(matches!(err, SinkError::Nowhere) && err.is_usage());
}

/// A listener that accepts connections but does not read.
fn stuck_viewer() -> (TcpListener, u16, std::thread::JoinHandle<Option<TcpStream>>) {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
    let port = listener.local_addr().expect("an address").port();
    let accepting = listener.try_clone().expect("a handle");
    // the first connection only checks whether anybody listens
    let thread = std::thread::spawn(move || accepting.incoming().filter_map(Result::ok).nth(1));
    (listener, port, thread)
}

#[test]
fn a_stuck_viewer_delays_nothing() {
    let dir = Dir::new();
    let path = dir.file("run.rrd");
    let (_listener, port, _connection) = stuck_viewer();
    let destinations = Destinations { connect: Some(url(port)), ..to_file(&path) };
    let mut sinks = Sinks::open(&destinations).expect("a viewer and a file");
    // 360 MB for the viewer, of which up to 128 MiB may be pending; each message exists only once, so it needs no
    // memory
    let bulk = [step(0, 100_000), step(1, 100_000)];
    let sent: Vec<LogMsg> =
        opening().into_iter().chain((0..300).map(|i| bulk[i % 2].clone())).chain([step(2, 10)]).collect();
    let started = Instant::now();
    send_all(&mut sinks, &sent);
    let notes = sinks.notes();
    assert!(notes.len() == 1 && notes[0].contains("cannot keep up"), "{notes:?}");
    let finished = sinks.finish().expect("disk space");
    assert!(started.elapsed() < Duration::from_secs(30));

    assert_same(&read(&path), &sent);
    let [note] = &finished.notes[..] else { panic!("{:?}", finished.notes) };
    assert!(note.contains("has accepted nothing for 1 s and is given up, "), "{note}");
}

/// A run that no destination has received completely has failed.
#[test]
fn an_only_viewer_that_is_given_up_is_an_error() {
    let (_listener, port, _connection) = stuck_viewer();
    let patience = Duration::from_secs(1);
    let alone = Destinations { connect: Some(url(port)), patience, ..Destinations::default() };
    let mut sinks = Sinks::open(&alone).expect("a viewer");
    send_all(&mut sinks, &recording(300));
    let err = rejected(sinks.finish());
    assert!(matches!(err, SinkError::GivenUp { .. }) && !err.is_usage(), "{err}");
    assert!(err.to_string().contains("has accepted nothing for 1 s and is given up, "), "{err}");
}

#[test]
fn a_lost_viewer_is_reported_once_and_the_file_is_complete() {
    let dir = Dir::new();
    let path = dir.file("run.rrd");
    // when a process ends, its connections are closed
    let (listener, port, connection) = stuck_viewer();
    let destinations = Destinations { connect: Some(url(port)), ..to_file(&path) };
    let mut sinks = Sinks::open(&destinations).expect("a viewer and a file");
    let sent = recording(2_000);
    send_all(&mut sinks, &sent[..1_000]);
    drop(listener);
    drop(connection.join());
    let mut notes = Vec::new();
    eventually("the viewer is missed", || {
        notes.extend(sinks.notes());
        !notes.is_empty()
    });
    send_all(&mut sinks, &sent[1_000..]);
    notes.extend(sinks.finish().expect("disk space").notes);
    let [note] = &notes[..] else { panic!("{notes:?}") };
    assert!(note.contains(&format!("{} went away after ", url(port))), "{note}");
    assert!(note.contains("run.rrd is still being written"), "{note}");
    assert_same(&read(&path), &sent);
}

#[test]
fn a_server_that_shuts_down_in_the_middle_does_no_harm() {
    let dir = Dir::new();
    let path = dir.file("run.rrd");
    let viewer = Viewer::start();
    let destinations = Destinations { connect: Some(viewer.url()), ..to_file(&path) };
    let mut sinks = Sinks::open(&destinations).expect("a viewer and a file");
    let sent = recording(2_000);
    send_all(&mut sinks, &sent[..1_000]);
    drop(viewer);
    send_all(&mut sinks, &sent[1_000..]);
    let started = Instant::now();
    sinks.finish().expect("disk space");
    assert!(started.elapsed() < Duration::from_secs(10));
    assert_same(&read(&path), &sent);
}

#[test]
fn a_run_ends_when_its_only_viewer_disconnects() {
    let (listener, port, connection) = stuck_viewer();
    let destinations = Destinations { connect: Some(url(port)), ..Destinations::default() };
    let mut sinks = Sinks::open(&destinations).expect("a viewer");
    send_all(&mut sinks, &recording(100));
    drop(listener);
    drop(connection.join());
    let mut error = None;
    eventually("the run is told", || {
        error = sinks.send(step(0, 1)).err();
        error.is_some()
    });
    let err = error.expect("the run waits for it");
    assert!(err.to_string().contains("no other destination is left"), "{err}");
    assert!(!err.is_usage());
    rejected(sinks.finish());
}

// ---- starting a viewer ----

fn spawning(program: &Path, port: u16) -> Destinations {
    let spawn = Spawn { program: program.into(), port };
    Destinations { spawn: Some(spawn), ..Destinations::default() }
}

#[test]
fn a_viewer_that_cannot_be_started_is_an_error_only_without_another_destination() {
    let dir = Dir::new();
    let missing = dir.file("no-such-viewer");
    let err = rejected(Sinks::open(&spawning(&missing, free_port())));
    let message = err.to_string();
    assert!(message.contains("no-such-viewer") && message.contains("pip install rerun-sdk==0.36.3"), "{message}");
    assert!(message.contains("cargo install rerun-cli --version 0.36.3 --locked") && !err.is_usage(), "{message}");

    let path = dir.file("run.rrd");
    let mut sinks = Sinks::open(&Destinations { save: Some(path.clone()), ..spawning(&missing, free_port()) })
        .expect("a file at least");
    assert!(sinks.notes()[0].starts_with("continuing without a viewer: cannot start"));
    send_all(&mut sinks, &recording(3));
    sinks.finish().expect("disk space");
    assert_eq!(read(&path).len(), 5);
}

#[cfg(unix)]
#[test]
fn the_output_of_a_viewer_that_exits_at_once_is_quoted() {
    use std::os::unix::fs::PermissionsExt as _;
    let dir = Dir::new();
    let viewer = dir.file("viewer");
    let script =
        "#!/bin/sh\necho on standard output\nprintf '\\033[31mno display\\033[0m for %s\\n' \"$*\" >&2\nexit 3\n";
    fs::write(&viewer, script).expect("a file");
    fs::set_permissions(&viewer, fs::Permissions::from_mode(0o755)).expect("it can be run");
    let port = free_port();
    let started = Instant::now();
    let message = rejected(Sinks::open(&spawning(&viewer, port))).to_string();
    assert!(started.elapsed() < Duration::from_secs(5));
    assert!(message.contains("it ended at once (exit status: 3)"), "{message}");
    assert!(
        message.contains(&format!("no display for --port={port} --bind=127.0.0.1 --memory-limit=25%")),
        "{message}"
    );
}

#[test]
fn a_running_viewer_is_not_started_again() {
    let viewer = Viewer::start();
    let mut sinks = Sinks::open(&spawning(Path::new("no-such-viewer"), viewer.port)).expect("a viewer");
    let notes = sinks.notes();
    assert!(notes.len() == 1 && notes[0].contains("already"), "{notes:?}");
    send_all(&mut sinks, &recording(3));
    sinks.finish().expect("a viewer");
    assert_eq!(viewer.messages().len(), 5);

    // nor is everything sent to it twice
    let destinations =
        Destinations { connect: Some(viewer.url()), ..spawning(Path::new("no-such-viewer"), viewer.port) };
    let mut sinks = Sinks::open(&destinations).expect("a viewer");
    send_all(&mut sinks, &recording(3));
    sinks.finish().expect("a viewer");
    assert_eq!(viewer.messages().len(), 10);
}

// ---- serving ----

fn get(port: u16, path: &str) -> String {
    let mut stream = TcpStream::connect((Ipv4Addr::LOCALHOST, port)).expect("the web server listens");
    let request = format!("GET {path} HTTP/1.1\r\nhost: 127.0.0.1\r\nconnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).expect("the server reads the request");
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).expect("an answer");
    String::from_utf8_lossy(&answer).into_owned()
}

fn serving(web_port: u16, grpc_port: u16) -> Destinations {
    let serve = Serve { web_port, grpc_port, ..Serve::default() };
    Destinations { serve: Some(serve), ..Destinations::default() }
}

#[test]
fn a_browser_is_served_the_whole_run_until_serving_ends() {
    let (web_port, grpc_port) = (free_port(), free_port());
    let mut sinks = Sinks::open(&serving(web_port, grpc_port)).expect("free ports");
    let notes = sinks.notes();
    let address =
        format!("serving at http://127.0.0.1:{web_port}/?url=rerun%2Bhttp%3A%2F%2F127.0.0.1%3A{grpc_port}%2Fproxy");
    assert_eq!(notes[0], address);
    assert!(notes[1].contains(&format!("listening on 127.0.0.1:{web_port} ")), "{notes:?}");
    assert_eq!(notes.len(), 2);
    let page = get(web_port, "/?url=whatever");
    assert!(page.starts_with("HTTP/1.1 200 OK\r\n") && page.contains("<html"), "{page}");

    let sent = recording(300);
    send_all(&mut sinks, &sent[..200]);
    // during the run
    let early = std::thread::spawn(move || watch(grpc_port, 302));
    std::thread::sleep(Duration::from_millis(100));
    send_all(&mut sinks, &sent[200..]);
    let finished = sinks.finish().expect("the server accepts everything");
    let early = early.join().expect("everything arrives");
    // after the run, from the beginning
    let late = watch(grpc_port, 302);
    assert_eq!(early, late);
    assert!(String::from_utf8_lossy(&late[0]).contains("sinks_test"), "the store info comes first");

    let serving = finished.serving.expect("the servers stay up");
    assert!(serving.failure().is_none());
    let started = Instant::now();
    serving.close();
    assert!(started.elapsed() < Duration::from_secs(3));
    eventually("the ports are free", || !answers(web_port) && !answers(grpc_port));
}

#[test]
fn a_port_in_use_is_rejected_with_the_option_that_changes_it() {
    let taken = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
    let port = taken.local_addr().expect("an address").port();
    for destinations in [serving(port, 0), serving(0, port)] {
        let err = rejected(Sinks::open(&destinations));
        let message = err.to_string();
        assert!(matches!(err, SinkError::Listen { .. }) && !err.is_usage(), "{message}");
        assert!(message.contains(&format!("is using port {port}")) && message.contains("--bind"), "{message}");
    }
    let err = rejected(Sinks::open(&serving(port, port)));
    assert!(matches!(err, SinkError::SamePort { .. }) && err.is_usage(), "{err}");

    let serve = Serve { bind: Ipv4Addr::new(203, 0, 113, 77).into(), ..Serve::default() };
    let message = rejected(Sinks::open(&Destinations { serve: Some(serve), ..Destinations::default() })).to_string();
    assert!(message.contains("203.0.113.77 is not an address of this machine"), "{message}");
}

#[test]
fn a_stuck_browser_does_not_keep_the_servers_up() {
    let (web_port, grpc_port) = (free_port(), free_port());
    let mut sinks = Sinks::open(&serving(web_port, grpc_port)).expect("free ports");
    // 41 MB of viewer files, none of which it reads
    let mut page = TcpStream::connect((Ipv4Addr::LOCALHOST, web_port)).expect("the web server listens");
    page.write_all(b"GET /re_viewer_bg.wasm HTTP/1.1\r\nhost: 127.0.0.1\r\n\r\n")
        .expect("the server reads the request");
    send_all(&mut sinks, &recording(3));
    std::thread::sleep(Duration::from_millis(200));
    let serving = sinks.finish().expect("the server accepts everything").serving.expect("the servers stay up");
    let started = Instant::now();
    serving.close();
    assert!(started.elapsed() < Duration::from_secs(5));
    drop(page);
}

/// Requests the run as a browser does, and reads none of it.
fn stuck_browser(port: u16) -> TcpStream {
    let mut stream = TcpStream::connect((Ipv4Addr::LOCALHOST, port)).expect("the server listens");
    let head = "POST /rerun.sdk_comms.v1alpha1.MessageProxyService/ReadMessages HTTP/1.1\r\nhost: 127.0.0.1\r\n\
                content-type: application/grpc-web+proto\r\ncontent-length: 5\r\n\r\n\0\0\0\0\0";
    stream.write_all(head.as_bytes()).expect("the server reads the request");
    stream
}

#[test]
fn stuck_browsers_delay_neither_the_run_nor_other_browsers() {
    let dir = Dir::new();
    let (web_port, grpc_port) = (free_port(), free_port());
    let path = dir.file("run.rrd");
    let serve = serving(web_port, grpc_port).serve;
    let mut sinks = Sinks::open(&Destinations { serve, ..to_file(&path) }).expect("free ports");
    let browsers: Vec<TcpStream> = (0..50).map(|_| stuck_browser(grpc_port)).collect();
    // far more than the buffers of a connection
    let bulk = [step(0, 10_000), step(1, 10_000)];
    let sent: Vec<LogMsg> = opening().into_iter().chain((0..4_000).map(|i| bulk[i % 2].clone())).collect();
    let started = Instant::now();
    let reader = std::thread::spawn(move || watch(grpc_port, 1_000).len());
    send_all(&mut sinks, &sent);
    assert_eq!(reader.join().expect("it is served"), 1_000);
    assert_eq!(sinks.notes()[2..], [""; 0]);
    let finished = sinks.finish().expect("disk space");
    assert!(started.elapsed() < Duration::from_secs(30));
    assert_eq!(finished.notes, [""; 0]);
    assert_eq!(read(&path).len(), sent.len());
    assert_eq!(watch(grpc_port, sent.len()).len(), sent.len());
    let started = Instant::now();
    drop(finished.serving);
    assert!(started.elapsed() < Duration::from_secs(5));
    drop(browsers);
}

#[cfg(unix)]
#[test]
fn a_viewer_is_not_started_on_the_served_port() {
    use std::os::unix::fs::PermissionsExt as _;
    let dir = Dir::new();
    let viewer = dir.file("viewer");
    fs::write(&viewer, "#!/bin/sh\necho $1\n").expect("a file");
    fs::set_permissions(&viewer, fs::Permissions::from_mode(0o755)).expect("it can be run");
    let port = free_port();
    let destinations = Destinations { serve: serving(0, port).serve, ..spawning(&viewer, port) };
    let mut sinks = Sinks::open(&destinations).expect("a server at least");
    let notes = sinks.notes();
    let note = notes.iter().find(|note| note.contains("it ended at once")).expect("the viewer was started");
    assert!(note.contains("--port=") && !note.contains(&format!("--port={port}")), "{note}");
    sinks.finish().expect("the server accepts everything");
}
