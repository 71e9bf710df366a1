//! Hostile clients cannot harm a serving process; memory and descriptors are measured by the operating system.

use std::io::{BufRead as _, BufReader, ErrorKind, Read as _, Write as _};
use std::net::{Ipv4Addr, TcpStream};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use super::{GRPC_WEB, SERVICE, ask, connect};
use crate::recording::Dir;
use crate::sinks::watch;

/// `run --serve` as a separate process, because the limits are per process.
struct Server {
    child: Child,
    web: u16,
    data: u16,
    lines: std::sync::mpsc::Receiver<String>,
}

impl Server {
    /// Serves the scene `two`; with `--steps 0`, it never ends.
    fn start(dir: &Dir, options: &[&str]) -> Server {
        let mut command = Command::new(env!("CARGO_BIN_EXE_meldscope"));
        command.args(["run", "two", "--serve", "--bind", "127.0.0.1:0"]).args(options);
        command.current_dir(dir.path()).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
        let mut child = command.spawn().expect("it starts");
        let stderr = BufReader::new(child.stderr.take().expect("a pipe"));
        let (send, lines) = std::sync::mpsc::channel();
        std::thread::spawn(move || stderr.lines().map_while(Result::ok).try_for_each(|line| send.send(line)));
        let mut server = Server { child, web: 0, data: 0, lines };
        let line = server.wait_for_line("listening on ");
        let port = |at: usize| {
            let digits: String =
                line[at..].chars().skip_while(|c| *c != ':').skip(1).take_while(char::is_ascii_digit).collect();
            digits.parse().expect("a port")
        };
        server.web = port(line.find("127.0.0.1").expect("an address"));
        server.data = port(line.find("and 127.0.0.1").expect("an address"));
        server
    }

    /// The next line that contains `part`.
    fn wait_for_line(&self, part: &str) -> String {
        loop {
            let line =
                self.lines.recv_timeout(Duration::from_secs(60)).unwrap_or_else(|_| panic!("no line contains {part}"));
            assert!(!line.contains("panicked"), "{line}");
            if line.contains(part) {
                return line;
            }
        }
    }

    /// Ends the server as Ctrl-C does; waits for its report of refused requests.
    fn end(mut self, part: &str) -> String {
        let interrupt = || Command::new("kill").args(["-INT", &self.child.id().to_string()]).status().expect("a shell");
        interrupt();
        let line = self.wait_for_line(part);
        let started = Instant::now();
        while self.child.try_wait().expect("a child").is_none() {
            assert!(started.elapsed() < Duration::from_secs(20), "it does not end");
            std::thread::sleep(Duration::from_millis(20));
        }
        assert_eq!(self.child.wait().expect("a child").code(), Some(0));
        line
    }

    fn descriptors(&self) -> usize {
        std::fs::read_dir(format!("/proc/{}/fd", self.child.id())).expect("it runs").count()
    }

    /// Resident memory [KiB].
    fn memory(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).expect("it runs");
        let line = status.lines().find(|line| line.starts_with("VmRSS:")).expect("a process has memory");
        line.split_whitespace().nth(1).and_then(|number| number.parse().ok()).expect("a number")
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

/// The content of a file of the page.
fn get(port: u16, path: &str) -> Vec<u8> {
    let mut stream = connect(port);
    let request = format!("GET {path} HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).expect("the server reads the request");
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).expect("the answer is whole");
    let head = answer.windows(4).position(|end| end == b"\r\n\r\n").expect("a head") + 4;
    assert!(answer.starts_with(b"HTTP/1.1 200 OK\r\n"), "{}", String::from_utf8_lossy(&answer[..head]));
    answer.split_off(head)
}

/// Asserts that the page and the run are still served.
fn assert_serves(web: u16, data: u16) {
    let page = get(web, "/?url=x");
    assert!(String::from_utf8_lossy(&page).contains("<html"), "{} bytes", page.len());
    assert!(get(web, "/re_viewer_bg.wasm").starts_with(b"\0asm"));
    assert!(!watch(data, 3)[0].is_empty());
}

fn eventually(what: &str, mut is_so: impl FnMut() -> bool) {
    let started = Instant::now();
    while !is_so() {
        assert!(started.elapsed() < Duration::from_secs(30), "{what}: not within 30 s");
        std::thread::sleep(Duration::from_millis(50));
    }
}

#[test]
fn no_request_ends_the_server_or_leaks_its_memory() {
    let dir = Dir::new();
    let server = Server::start(&dir, &["--steps", "0", "--realtime"]);
    let (web, data) = (server.web, server.data);
    assert_serves(web, data);
    let files = server.descriptors();
    let memory = server.memory();

    let host = "host: localhost\r\n";
    for port in [web, data] {
        for length in ["99999999999999", "18446744073709551615", "99999999999999999999999", "-1", "4294967296"] {
            for method in ["POST", "GET", "PUT"] {
                ask(port, format!("{method} / HTTP/1.1\r\n{host}content-length: {length}\r\n\r\nx").as_bytes());
                let call = format!(
                    "{method} {SERVICE}/ReadMessages HTTP/1.1\r\n{host}{GRPC_WEB}content-length: {length}\r\n\r\n"
                );
                ask(port, &[call.as_bytes(), &[0; 8192]].concat());
            }
        }
        // endless heads: a line, a header value, many headers, and an HTTP/2 one
        let endless: [(&[u8], &[u8]); 4] = [
            (b"GET /", b"aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa"),
            (b"GET / HTTP/1.1\r\nhost: localhost\r\nx: ", b"aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa"),
            (b"GET / HTTP/1.1\r\nhost: localhost\r\n", b"aaaaaaaaaaaaaaaa: bbbbbbbbbbbb\r\n"),
            (
                b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0\0\0\x20\x01\0\0\0\0\x01",
                b"\0\0\x17\x09\0\0\0\0\x01\x40\x0aaaaaaaaaaa\x0abbbbbbbbbb",
            ),
        ];
        for (start, more) in endless {
            let mut stream = connect(port);
            let block = more.repeat((64 << 10) / more.len());
            let mut taken = stream.write(start).expect("the server reads it");
            while taken < 64 << 20 {
                match stream.write(&block) {
                    Ok(count) => taken += count,
                    Err(_) => break,
                }
            }
            // the system's buffers, and what is read before the request is refused
            assert!(taken < 32 << 20, "{taken} bytes of a head were taken");
        }
        for garbage in [
            "PRI * HTTP/2.0\r\n\r\n",
            "PRI",
            "PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
            "",
            "\0\0\0",
            "GET",
            "\u{16}\u{3}\u{1}",
        ] {
            for _ in 0..100 {
                connect(port).write_all(garbage.as_bytes()).ok();
            }
        }
        for nonsense in [
            "GET http://[::1 HTTP/1.1\r\n\r\n",
            "GET / HTTP/9.9\r\n\r\n",
            "POST / HTTP/1.1\r\nhost: localhost\r\ntransfer-encoding: chunked\r\n\r\nffffffffffffffffffff\r\n",
            "POST / HTTP/1.1\r\nhost: localhost\r\ntransfer-encoding: chunked\r\n\r\n7fffffffffffffff\r\nx",
            "GET / HTTP/1.1\r\nhost: localhost\r\nexpect: 100-continue\r\ncontent-length: 9\r\n\r\n",
            "GET / HTTP/1.1\r\nhost: localhost\r\nupgrade: h2c\r\nconnection: upgrade\r\n\r\n",
            "CONNECT localhost:80 HTTP/1.1\r\nhost: localhost\r\n\r\n",
            "GET /../../etc/passwd HTTP/1.1\r\nhost: localhost\r\n\r\n",
            "OPTIONS * HTTP/1.1\r\nhost: localhost\r\n\r\n",
        ] {
            let mut stream = connect(port);
            stream.write_all(nonsense.as_bytes()).expect("the server reads it");
            stream.shutdown(std::net::Shutdown::Write).ok();
            stream.set_read_timeout(Some(Duration::from_secs(1))).expect("a timeout");
            let mut answer = Vec::new();
            stream.take(1 << 20).read_to_end(&mut answer).ok();
            assert!(!String::from_utf8_lossy(&answer).contains("root:"));
        }
    }
    assert_serves(web, data);
    eventually("the connections are gone", || server.descriptors() <= files);
    let grown = server.memory().saturating_sub(memory);
    assert!(grown < 100 << 10, "{grown} KiB more");
    let line = server.end("refused ");
    assert!(line.contains("closed ") && line.contains("without a complete request"), "{line}");
}

/// A hostile client of one of several kinds, on a connection that stays open.
fn bad_client(port: u16, kind: usize) -> Option<TcpStream> {
    let mut stream = TcpStream::connect((Ipv4Addr::LOCALHOST, port)).ok()?;
    let call =
        format!("POST {SERVICE}/ReadMessages HTTP/1.1\r\nhost: 127.0.0.1\r\n{GRPC_WEB}content-length: 5\r\n\r\n");
    let sends: &[u8] = match kind % 12 {
        0 => b"",
        1 => b"GET /re_viewer_bg.wasm HTTP/1.1\r\nhost: localhost\r\n\r\n",
        2 => b"POST / HTTP/1.1\r\nhost: localhost\r\ncontent-length: 100\r\n\r\nunfinished",
        3 => b"GET / HTTP/1.1\r\nhost: loc",
        4 => b"PRI * HTTP/2.0\r\n\r\n",
        5 => b"\x16\x03\x01\0\xa5\x01\0\0\xa1\x03\x03garbage that looks like TLS",
        6 => b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0",
        7 => b"GET / HTTP/1.1\r\nhost: localhost\r\n\r\n",
        8 => b"POST / HTTP/1.1\r\nhost: localhost\r\ntransfer-encoding: chunked\r\n\r\n",
        9 => &[call.as_bytes(), &[0; 5]].concat(),
        10 => &[call.as_bytes(), &[0; 2]].concat(),
        _ => b"\n\n\n\n",
    };
    stream.write_all(sends).ok()?;
    if kind.is_multiple_of(5) {
        stream.shutdown(std::net::Shutdown::Write).ok();
    }
    Some(stream)
}

#[test]
fn three_hundred_bad_clients_per_port_lock_nobody_out() {
    // all kinds that keep their connection; only clients that never read; only clients that send nothing
    let crowds: [&dyn Fn(usize) -> usize; 4] = [&|i| i, &|_| 9, &|_| 1, &|_| 0];
    // during the run and after it
    for options in [["--steps", "0", "--realtime"], ["--steps", "300", "--quiet"]] {
        let dir = Dir::new();
        let server = Server::start(&dir, &[&options[..], &["--save", "x.rrd"]].concat());
        let (web, data) = (server.web, server.data);
        assert_serves(web, data);
        let memory = server.memory();
        for crowd in crowds {
            let bad: Vec<TcpStream> =
                (0..300).flat_map(|i| [bad_client(web, crowd(i)), bad_client(data, crowd(i))]).flatten().collect();
            let started = Instant::now();
            assert_serves(web, data);
            assert!(started.elapsed() < Duration::from_secs(15), "{:?}", started.elapsed());
            let grown = server.memory().saturating_sub(memory);
            assert!(grown < 100 << 10, "{grown} KiB more for {} clients", bad.len());
        }
        assert_serves(web, data);
        let line = server.end("closed ");
        assert!(line.contains("connections: "), "{line}");
        assert_eq!(dir.names(), ["x.rrd"]);
    }
}

/// Whoever is served longest goes last, however many clients come that never read.
#[test]
fn a_flood_of_readers_cuts_no_viewer_off() {
    for options in [["--steps", "0", "--realtime"], ["--steps", "300", "--quiet"]] {
        let dir = Dir::new();
        let server = Server::start(&dir, &[&options[..], &["--save", "x.rrd"]].concat());
        // a viewer that reads what there is
        let mut viewer = bad_client(server.data, 9).expect("a connection");
        viewer.set_read_timeout(Some(Duration::from_millis(20))).expect("a timeout");
        let mut read = move || {
            let mut bytes = vec![0; 1 << 20];
            loop {
                match viewer.read(&mut bytes) {
                    Ok(0) => return false,
                    Ok(_) => {}
                    Err(error) => return matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut),
                }
            }
        };
        let started = Instant::now();
        while started.elapsed() < Duration::from_secs(2) {
            assert!(read(), "it is served");
        }
        // 100 a second, twice as many as there may be
        let mut flood = Vec::new();
        for number in 0..512 {
            flood.extend(bad_client(server.data, 9));
            std::thread::sleep(Duration::from_millis(10));
            if number % 50 == 0 {
                assert!(read(), "cut off after {} clients", flood.len());
            }
        }
        assert!(read(), "cut off by the last ones");
        assert_serves(server.web, server.data);
        assert!(read());
        server.end("closed ");
    }
}
