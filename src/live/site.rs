//! The page and its requests. Everything is below a token that only who started the program knows.

use std::{net::IpAddr, sync::Arc};

use hyper::{
    Method, Request, Response, StatusCode,
    body::{Bytes, Incoming},
    header::{self, HeaderValue},
};
use re_web_viewer_server::WebViewerData;
use serde::de::DeserializeOwned;
use serde_json::json;

use super::{
    change::{Change, Problem},
    runs::{Runs, Save},
};
use crate::stream::sinks::serve::{Content, Guard, Site, body, confine, respond, viewer_files};

/// Upper limit on the body of a request [bytes].
const REQUEST: usize = 256 << 10;

/// The page sends nothing to other machines: a browser enforces this policy.
const POLICY: &str = "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; img-src 'self' data: blob:; \
                      connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// What the page's port serves.
pub struct Page {
    token: String,
    runs: Arc<Runs>,
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Thresholds {
    key: String,
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct ToSave {
    what: Save,
}

impl Page {
    pub fn new(token: String, runs: Arc<Runs>) -> Page {
        Page { token, runs }
    }

    /// The path of a request below the token; `None` without it.
    fn path<'p>(&self, path: &'p str) -> Option<&'p str> {
        let rest = path.strip_prefix('/')?.strip_prefix(&*self.token)?;
        rest.strip_prefix('/')
    }

    async fn posted(&self, path: &str, request: Request<Incoming>) -> Response<Content> {
        let Some(body) = body(request.into_body(), REQUEST).await else {
            return text(StatusCode::PAYLOAD_TOO_LARGE, "the request is too large");
        };
        let done = match path {
            "change" => read(&body).map(|change: Change| Some(json!({ "number": self.runs.ask(change) }))),
            "thresholds" => read(&body).map(|Thresholds { key }| {
                self.runs.find_thresholds(key);
                None
            }),
            "save" => read(&body).and_then(|ToSave { what }| self.runs.save(what).map(|()| None)),
            _ => return text(StatusCode::NOT_FOUND, "there is no such request"),
        };
        match done {
            Ok(Some(asked)) => json(StatusCode::OK, &asked),
            Ok(None) => text(StatusCode::NO_CONTENT, ""),
            Err(problem) => json(StatusCode::BAD_REQUEST, &problem),
        }
    }

    fn got(&self, path: &str) -> Response<Content> {
        let files = match viewer_files() {
            Ok(files) => files,
            Err(reason) => return text(StatusCode::INTERNAL_SERVER_ERROR, reason),
        };
        if path == "feed" {
            return respond(StatusCode::OK, "text/event-stream", Content::Parts(self.runs.feed.read(), None));
        }
        if let Some((folder, number)) = path.strip_suffix(".rrd").and_then(|path| path.split_once('/')) {
            let run = number.parse().ok().and_then(|number| self.runs.recording(number, folder == "first"));
            let Some(parts) = run.filter(|_| matches!(folder, "first" | "runs")) else {
                return text(StatusCode::NOT_FOUND, "this run has been replaced");
            };
            return respond(StatusCode::OK, "application/octet-stream", Content::Parts(parts, None));
        }
        match file(files, path) {
            Some((kind, bytes)) => respond(StatusCode::OK, kind, Content::Whole(Bytes::from_static(bytes))),
            None => text(StatusCode::NOT_FOUND, "there is no such file"),
        }
    }
}

impl Site for Page {
    fn is_endless(&self) -> bool {
        true // the feed
    }

    async fn answer(&self, guard: &Guard, request: Request<Incoming>, at: IpAddr) -> Response<Content> {
        let path = request.uri().path().to_owned();
        let mut response = match (guard.admits(request.uri(), request.headers(), at), self.path(&path)) {
            (Err(name), _) => text(StatusCode::FORBIDDEN, format!("this program does not serve {name}")),
            (_, None) => text(StatusCode::NOT_FOUND, "open the address that the program printed"),
            (_, Some(path)) if request.method() == Method::POST => self.posted(path, request).await,
            (_, Some(path)) if request.method() == Method::GET => self.got(path),
            _ => text(StatusCode::METHOD_NOT_ALLOWED, "there is only GET and POST"),
        };
        confine(&mut response, HeaderValue::from_static(POLICY));
        response.headers_mut().insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
        response
    }
}

fn file(files: &'static WebViewerData, path: &str) -> Option<(&'static str, &'static [u8])> {
    Some(match path {
        "" => ("text/html; charset=utf-8", include_bytes!("page/index.html")),
        "live.js" => ("text/javascript", include_bytes!("page/live.js")),
        "live.css" => ("text/css", include_bytes!("page/live.css")),
        "favicon.ico" => ("image/x-icon", files.favicon()),
        "re_viewer.js" => ("text/javascript", files.viewer_js()),
        "re_viewer_bg.wasm" => ("application/wasm", files.viewer_wasm()),
        _ => return None,
    })
}

fn read<T: DeserializeOwned>(body: &[u8]) -> Result<T, Problem> {
    serde_json::from_slice(body).map_err(|error| Problem::new(format!("the request cannot be read: {error}")))
}

fn text(status: StatusCode, text: impl Into<Bytes>) -> Response<Content> {
    respond(status, "text/plain; charset=utf-8", Content::Whole(text.into()))
}

fn json(status: StatusCode, value: &impl serde::Serialize) -> Response<Content> {
    respond(status, "application/json", Content::Whole(serde_json::to_vec(value).unwrap_or_default().into()))
}
