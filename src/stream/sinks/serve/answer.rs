//! Responses: the files of the web viewer on one port, the messages of the run on the other.
//!
//! The page around the viewer is our own: the SDK's loads fonts from the web. The viewer itself would report its use and
//! load a list of examples. A content security policy makes the browser send nothing to other machines.

use std::net::IpAddr;
use std::pin::pin;
use std::sync::atomic::Ordering;
use std::task::{Context, Poll, ready};

use hyper::body::{Body, Bytes, Frame, Incoming};
use hyper::header::{self, HeaderMap, HeaderName, HeaderValue};
use hyper::{Method, Request, Response, StatusCode};
use re_protos::sdk_comms::v1alpha1::message_proxy_service_server::SERVICE_NAME;
use re_web_viewer_server::WebViewerData;

use super::follow::Parts;
use super::guard::{Guard, Host};
use super::history::History;
use super::port::Site;

/// Upper limit on the body of a gRPC request: an empty message, in its frame [bytes].
const REQUEST: usize = 4 << 10;
/// The gRPC status header; [the codes](https://grpc.io/docs/guides/status-codes/).
const GRPC_STATUS: HeaderName = HeaderName::from_static("grpc-status");
const GRPC_MESSAGE: HeaderName = HeaderName::from_static("grpc-message");
const PERMISSION_DENIED: HeaderValue = HeaderValue::from_static("7");
const UNIMPLEMENTED: HeaderValue = HeaderValue::from_static("12");
/// The policy that lets a browser load nothing.
const NOTHING: HeaderValue = HeaderValue::from_static("default-src 'none'");

/// Largest part of a response that is sent at once, and the amount that a client must read for it to count as activity
/// [bytes].
pub(super) const SHARE: usize = 64 << 10;

/// The body of a response.
pub(crate) enum Content {
    Whole(Bytes),
    /// Parts as they become known, followed by a final frame, if any.
    Parts(Parts, Option<Frame<Bytes>>),
}

impl Content {
    /// The next part of the response.
    pub fn poll_frame(&mut self, context: &mut Context<'_>) -> Poll<Option<Frame<Bytes>>> {
        match self {
            Content::Whole(rest) if rest.is_empty() => Poll::Ready(None),
            Content::Whole(rest) => Poll::Ready(Some(Frame::data(rest.split_to(rest.len().min(SHARE))))),
            Content::Parts(parts, end) => {
                let part = ready!(parts.as_mut().poll_next(context));
                Poll::Ready(part.map(Frame::data).or_else(|| end.take()))
            }
        }
    }
}

/// What the two ports of a run serve.
pub(super) enum OfRun {
    /// The web viewer, which gets its data from this port.
    Viewer(&'static WebViewerData, u16),
    /// The run's messages, like the SDK's proxy: gRPC for native viewers, gRPC-web for browsers.
    Data(History),
}

impl Site for OfRun {
    fn is_endless(&self) -> bool {
        matches!(self, OfRun::Data(_))
    }

    async fn answer(&self, guard: &Guard, request: Request<Incoming>, at: IpAddr) -> Response<Content> {
        if let Err(name) = guard.admits(request.uri(), request.headers(), at) {
            let help = format!(
                "this program does not serve {name}: start it with `--bind NAME`, which listens on the address of that name\n"
            );
            return text(StatusCode::FORBIDDEN, help);
        }
        match self {
            OfRun::Viewer(files, data_port) => {
                let mut response = file(files, guard, &request);
                confine(&mut response, policy(request.headers(), at, *data_port));
                response
            }
            OfRun::Data(history) => {
                // the page is on another port, hence another origin; the guard has checked it
                let origin = request.headers().get(header::ORIGIN).cloned();
                let mut response = data(history, guard, request).await;
                if let Some(origin) = origin {
                    let headers = response.headers_mut();
                    headers.insert(header::ACCESS_CONTROL_ALLOW_ORIGIN, origin);
                    headers.insert(header::VARY, HeaderValue::from_static("origin"));
                    let exposed = HeaderValue::from_static("grpc-status, grpc-message");
                    headers.insert(header::ACCESS_CONTROL_EXPOSE_HEADERS, exposed);
                }
                response
            }
        }
    }
}

/// What a browser may load for the page: its own files, and the data of the run from the host that it was requested
/// from, or from this machine under a usual name.
fn policy(headers: &HeaderMap, at: IpAddr, data_port: u16) -> HeaderValue {
    let host = headers.get(header::HOST).and_then(|host| Host::of(host.as_bytes()));
    let host = match host.unwrap_or(Host::Ip(at)) {
        Host::Ip(IpAddr::V6(ip)) => format!("[{ip}]"),
        Host::Ip(ip) => ip.to_string(),
        Host::Name(name) => name,
    };
    let data = [&host, "127.0.0.1", "localhost"].map(|host| format!("http://{host}:{data_port}")).join(" ");
    let policy = format!(
        "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; img-src 'self' data: blob:; \
         connect-src 'self' {data}; base-uri 'none'; form-action 'none'"
    );
    HeaderValue::try_from(policy).unwrap_or(NOTHING)
}

/// Responds with a file of the web viewer.
fn file(files: &'static WebViewerData, guard: &Guard, request: &Request<Incoming>) -> Response<Content> {
    if !matches!(*request.method(), Method::GET | Method::HEAD) {
        guard.invalid.fetch_add(1, Ordering::Relaxed);
        let mut response = text(StatusCode::METHOD_NOT_ALLOWED, "there are only files to GET\n");
        response.headers_mut().insert(header::ALLOW, HeaderValue::from_static("GET, HEAD"));
        return response;
    }
    let (kind, bytes): (_, &'static [u8]) = match request.uri().path() {
        "/" => ("text/html", include_bytes!("page/index.html")),
        "/page.js" => ("text/javascript", include_bytes!("page/page.js")),
        "/page.css" => ("text/css", include_bytes!("page/page.css")),
        "/favicon.ico" => ("image/x-icon", files.favicon()),
        "/apple-touch-icon.png" => ("image/png", files.apple_touch_icon()),
        "/re_viewer.js" => ("text/javascript", files.viewer_js()),
        "/re_viewer_bg.wasm" => ("application/wasm", files.viewer_wasm()),
        _ => return text(StatusCode::NOT_FOUND, "there is no such file\n"),
    };
    respond(StatusCode::OK, kind, Content::Whole(Bytes::from_static(bytes)))
}

/// Responds to a call of the SDK's message proxy.
async fn data(history: &History, guard: &Guard, request: Request<Incoming>) -> Response<Content> {
    if request.method() == Method::OPTIONS {
        return preflight(request.headers());
    }
    let content_type = request.headers().get(header::CONTENT_TYPE).cloned();
    let kind = content_type.as_ref().and_then(|kind| kind.to_str().ok()).unwrap_or_default();
    let is_text = kind.starts_with("application/grpc-web-text");
    let method = request.uri().path().strip_prefix('/').and_then(|path| path.strip_prefix(SERVICE_NAME));
    let invalid = |status, help: &'static str| {
        guard.invalid.fetch_add(1, Ordering::Relaxed);
        text(status, help)
    };
    match (method, &content_type) {
        (Some("/WriteMessages" | "/WriteTable"), _) => {
            guard.writes.fetch_add(1, Ordering::Relaxed);
            let help = "this program serves its own run and accepts no data";
            status(text(StatusCode::FORBIDDEN, help), PERMISSION_DENIED, help)
        }
        _ if request.method() != Method::POST => {
            invalid(StatusCode::METHOD_NOT_ALLOWED, "there are only gRPC calls here\n")
        }
        (Some("/ReadMessages"), Some(content_type)) if kind.starts_with("application/grpc") && !is_text => {
            let end = end(kind);
            let content_type = content_type.clone();
            if body(request.into_body(), REQUEST).await.is_none() {
                return invalid(StatusCode::PAYLOAD_TOO_LARGE, "a read request must be empty\n");
            }
            let mut response = Response::new(Content::Parts(history.read(), Some(end)));
            response.headers_mut().insert(header::CONTENT_TYPE, content_type);
            response
        }
        (_, Some(content_type)) if kind.starts_with("application/grpc") && !is_text => {
            let mut response = status(Response::new(Content::Whole(Bytes::new())), UNIMPLEMENTED, "no such call");
            response.headers_mut().insert(header::CONTENT_TYPE, content_type.clone());
            response
        }
        _ => invalid(StatusCode::UNSUPPORTED_MEDIA_TYPE, "there are only gRPC calls here\n"),
    }
}

/// Responds to a CORS preflight request, which a browser sends before a page may call another port.
fn preflight(asked: &HeaderMap) -> Response<Content> {
    let mut response = Response::new(Content::Whole(Bytes::new()));
    *response.status_mut() = StatusCode::NO_CONTENT;
    let headers = response.headers_mut();
    headers.insert(header::ACCESS_CONTROL_ALLOW_METHODS, HeaderValue::from_static("POST"));
    headers.insert(header::ACCESS_CONTROL_MAX_AGE, HeaderValue::from_static("3600"));
    if let Some(names) = asked.get(header::ACCESS_CONTROL_REQUEST_HEADERS) {
        headers.insert(header::ACCESS_CONTROL_ALLOW_HEADERS, names.clone());
    }
    response
}

/// The end of a stream: trailers, or in gRPC-web a frame that contains them.
fn end(kind: &str) -> Frame<Bytes> {
    if kind.starts_with("application/grpc-web") {
        return Frame::data(Bytes::from_static(b"\x80\0\0\0\x0fgrpc-status:0\r\n"));
    }
    let mut trailers = HeaderMap::new();
    trailers.insert(GRPC_STATUS, HeaderValue::from_static("0"));
    Frame::trailers(trailers)
}

/// Reads the body of a request; `None` if that fails or the body is longer than `most` [bytes].
pub(crate) async fn body(body: Incoming, most: usize) -> Option<Vec<u8>> {
    let (mut body, mut read) = (pin!(body), Vec::new());
    while let Some(frame) = std::future::poll_fn(|context| body.as_mut().poll_frame(context)).await {
        let frame = frame.ok()?;
        read.extend_from_slice(frame.data_ref().map_or(&[], |data| data));
        if read.len() > most {
            return None;
        }
    }
    Some(read)
}

/// A response of a media type.
pub(crate) fn respond(status: StatusCode, kind: &'static str, content: Content) -> Response<Content> {
    let mut response = Response::new(content);
    *response.status_mut() = status;
    response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static(kind));
    response
}

/// Lets a browser load and send only what `policy` says.
pub(crate) fn confine(response: &mut Response<Content>, policy: HeaderValue) {
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_SECURITY_POLICY, policy);
    headers.insert(header::REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
}

fn text(status: StatusCode, text: impl Into<Bytes>) -> Response<Content> {
    respond(status, "text/plain", Content::Whole(text.into()))
}

/// Adds the gRPC status to a response.
fn status(mut response: Response<Content>, code: HeaderValue, message: &'static str) -> Response<Content> {
    response.headers_mut().insert(GRPC_STATUS, code);
    response.headers_mut().insert(GRPC_MESSAGE, HeaderValue::from_static(message));
    response
}
