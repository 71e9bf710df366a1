//! `--serve` against hostile clients: which clients may read or write, and that none can harm the run.

use std::io::{Read as _, Write as _};
use std::net::{Ipv4Addr, SocketAddr, TcpStream};
use std::time::Duration;

use hyper_util::rt::{TokioExecutor, TokioIo};
use meldscope::stream::sinks::{Destinations, Serve, Sinks};
use rerun::external::re_grpc_client::write::{Client, Options};

use crate::sinks::{opening, recording, watch};

#[cfg(target_os = "linux")]
mod process;

const SERVICE: &str = "/rerun.sdk_comms.v1alpha1.MessageProxyService";

// ---- tools ----

/// Both servers in this process, serving `opening()` and 20 steps.
fn serve(options: Serve) -> (Sinks, u16, u16) {
    let destinations =
        Destinations { serve: Some(Serve { web_port: 0, grpc_port: 0, ..options }), ..Destinations::default() };
    let mut sinks = Sinks::open(&destinations).expect("free ports");
    let note = sinks.notes()[1].clone();
    let port = |part: &str| part.rsplit(':').next().and_then(|port| port.parse().ok()).expect("a port");
    let words: Vec<&str> = note.split(' ').filter(|word| word.starts_with("127.0.0.1:")).collect();
    let (web, data) = (port(words[0]), port(words[1]));
    for msg in recording(20) {
        sinks.send(msg).expect("the server accepts it");
    }
    (sinks, web, data)
}

fn connect(port: u16) -> TcpStream {
    let address = SocketAddr::from((Ipv4Addr::LOCALHOST, port));
    let stream = TcpStream::connect_timeout(&address, Duration::from_secs(20)).expect("it listens");
    stream.set_read_timeout(Some(Duration::from_secs(20))).expect("a timeout");
    stream.set_write_timeout(Some(Duration::from_secs(20))).expect("a timeout");
    stream
}

/// The head of the response to `request`, as far as it arrives.
fn ask(port: u16, request: &[u8]) -> String {
    let mut stream = connect(port);
    // the response may arrive before the whole request is read
    stream.write_all(request).ok();
    let (mut answer, mut bytes) = (Vec::new(), [0; 1024]);
    while !answer.windows(4).any(|end| end == b"\r\n\r\n") {
        match stream.read(&mut bytes) {
            Ok(count) if count > 0 => answer.extend_from_slice(&bytes[..count]),
            _ => break,
        }
    }
    String::from_utf8_lossy(&answer).into_owned()
}

/// The status of the response to a request with these headers; 0 if there is no response.
fn status(port: u16, line: &str, headers: &str, body: &[u8]) -> u16 {
    let head = format!("{line} HTTP/1.1\r\n{headers}content-length: {}\r\n\r\n", body.len());
    let answer = ask(port, &[head.as_bytes(), body].concat());
    answer.split(' ').nth(1).and_then(|code| code.parse().ok()).unwrap_or(0)
}

const GRPC_WEB: &str = "content-type: application/grpc-web+proto\r\n";

/// Requests the whole run, as `watch` does.
fn read_messages(port: u16, headers: &str) -> u16 {
    status(port, &format!("POST {SERVICE}/ReadMessages"), &format!("{GRPC_WEB}{headers}"), &[0; 5])
}

// ---- reading ----

#[test]
fn other_hosts_and_pages_are_refused_on_both_ports() {
    let (sinks, web, data) = serve(Serve::default());
    let good = ["localhost", "127.0.0.1", "[::1]", "LocalHost", "localhost:1"];
    for host in good {
        assert_eq!(status(web, "GET /", &format!("host: {host}\r\n"), b""), 200, "{host}");
        assert_eq!(read_messages(data, &format!("host: {host}\r\n")), 200, "{host}");
        assert_eq!(read_messages(data, &format!("host: localhost\r\norigin: http://{host}\r\n")), 200, "{host}");
    }
    let bad = [
        "evil.example",
        "localhost.evil.example",
        "127.0.0.1.evil.example",
        "0.0.0.0",
        "8.8.8.8",
        "evil@localhost",
        "",
    ];
    for host in bad {
        let host_line = format!("host: {host}\r\n");
        let origin_line = format!("host: localhost\r\norigin: http://{host}\r\n");
        for headers in [&host_line, &origin_line] {
            assert_eq!(status(web, "GET /", headers, b""), 403, "{headers:?}");
            assert_eq!(status(web, "GET /re_viewer_bg.wasm", headers, b""), 403, "{headers:?}");
            assert_eq!(read_messages(data, headers), 403, "{headers:?}");
            assert_eq!(status(data, "OPTIONS /", headers, b""), 403, "{headers:?}");
        }
    }
    for headers in ["", "host: localhost\r\nhost: evil.example\r\n", "host: localhost\r\norigin: null\r\n"] {
        for (port, line) in [(web, "GET /"), (data, "OPTIONS /")] {
            assert_eq!(status(port, line, headers, b""), 403, "{headers:?}");
        }
    }
    assert_eq!(status(web, "GET http://evil.example/", "host: localhost\r\n", b""), 403);
    let serving = sinks.finish().expect("the server accepts everything").serving.expect("it stays up");
    let note = serving.refused().expect("refused requests");
    assert!(note.starts_with("refused ") && note.contains("evil.example"), "{note}");
}

#[test]
fn a_host_that_is_allowed_may_read() {
    let allow = vec!["studio.example".parse().expect("a host")];
    let (_sinks, web, data) = serve(Serve { allow, ..Serve::default() });
    for host in ["studio.example", "Studio.Example:9090"] {
        assert_eq!(status(web, "GET /", &format!("host: {host}\r\n"), b""), 200);
        assert_eq!(read_messages(data, &format!("host: {host}\r\norigin: http://{host}\r\n")), 200);
    }
    assert_eq!(read_messages(data, "host: evil.example\r\n"), 403);
}

#[test]
fn a_page_of_the_other_port_passes_cors() {
    let (_sinks, web, data) = serve(Serve::default());
    let page = format!("http://localhost:{web}");
    let asked = format!(
        "OPTIONS {SERVICE}/ReadMessages HTTP/1.1\r\nhost: localhost:{data}\r\norigin: {page}\r\n\
         access-control-request-method: POST\r\naccess-control-request-headers: content-type,x-grpc-web\r\n\r\n"
    );
    let answer = ask(data, asked.as_bytes());
    assert!(answer.starts_with("HTTP/1.1 204 "), "{answer}");
    for line in [
        format!("access-control-allow-origin: {page}\r\n"),
        "access-control-allow-methods: POST\r\n".to_owned(),
        "access-control-allow-headers: content-type,x-grpc-web\r\n".to_owned(),
    ] {
        assert!(answer.contains(&line), "{line}: {answer}");
    }
    let call = format!(
        "POST {SERVICE}/ReadMessages HTTP/1.1\r\nhost: localhost\r\norigin: {page}\r\n{GRPC_WEB}content-length: 5\r\n\r\n\0\0\0\0\0"
    );
    let answer = ask(data, call.as_bytes());
    assert!(answer.starts_with("HTTP/1.1 200 ") && answer.contains(&format!("allow-origin: {page}\r\n")), "{answer}");
}

// ---- writing ----

#[test]
fn only_the_run_can_write() {
    let (sinks, _web, data) = serve(Serve::default());
    // from a browser or any other HTTP client
    for method in ["WriteMessages", "WriteTable"] {
        for kind in ["application/grpc-web+proto", "application/grpc", "application/grpc-web-text", "text/plain"] {
            let headers = format!("host: localhost\r\ncontent-type: {kind}\r\n");
            let line = format!("POST {SERVICE}/{method}");
            let answer =
                ask(data, format!("{line} HTTP/1.1\r\n{headers}content-length: 5\r\n\r\n\0\0\0\0\0").as_bytes());
            assert!(answer.starts_with("HTTP/1.1 403 ") && answer.contains("grpc-status: 7\r\n"), "{kind}: {answer}");
        }
    }
    // from the SDK
    let address = format!("rerun+http://127.0.0.1:{data}/proxy").parse().expect("an address");
    let client = Client::new(address, Options::default());
    opening().into_iter().for_each(|msg| client.send_blocking(msg));
    client.flush_blocking(Duration::from_secs(5)).ok();
    let other = [&["WriteMessages"][..], &["Quit"], &["OpenUrl"], &["CaptureScreenshot"]].concat();
    for method in other {
        let line = format!("POST /rerun.sdk_comms.v1alpha1.ViewerControlService/{method}");
        let answer =
            ask(data, format!("{line} HTTP/1.1\r\nhost: localhost\r\n{GRPC_WEB}content-length: 0\r\n\r\n").as_bytes());
        assert!(answer.contains("grpc-status: 12\r\n"), "{answer}");
    }
    // readers receive the run and nothing else
    let serving = sinks.finish().expect("the server accepts everything").serving.expect("it stays up");
    let end = std::thread::spawn(move || frames_until_the_end(data));
    std::thread::sleep(Duration::from_millis(300));
    let note = serving.refused().expect("refused requests");
    serving.close();
    assert_eq!(end.join().expect("no panic").len(), 22);
    assert!(note.contains("to write"), "{note}");
}

/// The messages that a native viewer receives over HTTP/2 until the server signals the end.
fn frames_until_the_end(port: u16) -> Vec<Vec<u8>> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    let work = async {
        let stream = tokio::net::TcpStream::connect((Ipv4Addr::LOCALHOST, port)).await.expect("it listens");
        let (mut sender, connection) =
            hyper::client::conn::http2::handshake(TokioExecutor::new(), TokioIo::new(stream))
                .await
                .expect("it is HTTP/2");
        tokio::spawn(connection);
        let request = hyper::Request::post(format!("http://localhost:{port}{SERVICE}/ReadMessages"))
            .header("content-type", "application/grpc")
            .header("te", "trailers")
            .body("\0\0\0\0\0".to_owned());
        let answer = sender.send_request(request.expect("a request")).await.expect("an answer");
        assert_eq!(
            (answer.status(), &answer.headers()["content-type"]),
            (hyper::StatusCode::OK, &"application/grpc".parse().expect("a header"))
        );
        let mut body = std::pin::pin!(answer.into_body());
        let (mut bytes, mut status) = (Vec::new(), None);
        while let Some(frame) =
            std::future::poll_fn(|context| hyper::body::Body::poll_frame(body.as_mut(), context)).await
        {
            match frame.expect("a frame").into_data() {
                Ok(data) => bytes.extend_from_slice(&data),
                Err(rest) => status = rest.trailers_ref().map(|trailers| trailers["grpc-status"].clone()),
            }
        }
        assert_eq!(status.expect("a final status"), "0");
        let (mut frames, mut rest) = (Vec::new(), &bytes[..]);
        while let [0, a, b, c, d, more @ ..] = rest {
            let (frame, more) = more.split_at(u32::from_be_bytes([*a, *b, *c, *d]) as usize);
            frames.push(frame.to_vec());
            rest = more;
        }
        assert_eq!(rest, b"");
        frames
    };
    runtime.block_on(async { tokio::time::timeout(Duration::from_secs(20), work).await.expect("it ends") })
}

#[test]
fn native_viewers_and_browsers_get_the_same_messages() {
    let (sinks, _web, data) = serve(Serve::default());
    let browser = watch(data, 22);
    let native = std::thread::spawn(move || frames_until_the_end(data));
    std::thread::sleep(Duration::from_millis(300));
    drop(sinks);
    assert_eq!(native.join().expect("no panic"), browser);
}

/// The page names no other machine, and the browser may ask none.
#[test]
fn the_page_stays_on_this_machine() {
    let allow = vec!["studio.example".parse().expect("a host")];
    let (_sinks, web, data) = serve(Serve { allow, ..Serve::default() });
    for path in ["/", "/page.js", "/page.css"] {
        for host in ["localhost", "127.0.0.1", "studio.example"] {
            let answer = ask(web, format!("GET {path} HTTP/1.1\r\nhost: {host}:{web}\r\n\r\n").as_bytes());
            let policy = answer.lines().find_map(|line| line.strip_prefix("content-security-policy: "));
            let policy = policy.unwrap_or_else(|| panic!("{path}: {answer}"));
            let directives: Vec<&str> = policy.split("; ").collect();
            assert!(directives.contains(&"default-src 'none'"), "{policy}");
            let connect =
                format!("connect-src 'self' http://{host}:{data} http://127.0.0.1:{data} http://localhost:{data}");
            assert!(directives.contains(&connect.as_str()), "{policy}");
            assert!(!policy.contains("unsafe-inline") && !policy.contains('*'), "{policy}");
        }
    }
    for path in ["/sw.js", "/signed-in", "/signed-out", "/index.html"] {
        assert_eq!(status(web, &format!("GET {path}"), "host: localhost\r\n", b""), 404, "{path}");
    }
}
