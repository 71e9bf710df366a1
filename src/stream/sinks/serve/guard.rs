//! Access control: a foreign web page must not read a run through the user's browser, neither directly nor by resolving
//! its own host name to the address of this machine (DNS rebinding).

use std::net::IpAddr;
use std::str::FromStr;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use hyper::http::uri::Authority;
use hyper::{HeaderMap, Uri, header};

use crate::lock;
use crate::text::{counted, listed, thousands};

/// A host as a viewer may specify it: an address or a name, without a port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Host {
    /// An address.
    Ip(IpAddr),
    /// A name, in lower case.
    Name(String),
}

impl FromStr for Host {
    type Err = String;

    fn from_str(text: &str) -> Result<Host, String> {
        let host = Host::lenient(text);
        let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
        match &host {
            Host::Ip(_) => Ok(host),
            Host::Name(name) if !name.is_empty() && name.len() <= 253 && name.chars().all(is_plain) => Ok(host),
            Host::Name(_) => Err("expected the name or address of a host alone, as in `studio.local`".to_owned()),
        }
    }
}

impl Host {
    /// Anything that is not an address counts as a name, valid or not.
    fn lenient(text: &str) -> Host {
        let bare = text.strip_prefix('[').and_then(|text| text.strip_suffix(']')).unwrap_or(text);
        match bare.parse::<IpAddr>() {
            Ok(ip) => Host::Ip(ip.to_canonical()),
            Err(_) => Host::Name(text.strip_suffix('.').unwrap_or(text).to_ascii_lowercase()),
        }
    }

    /// Parses the host of an authority such as `studio.local:9090`.
    pub fn of(authority: &[u8]) -> Option<Host> {
        let authority = Authority::try_from(authority).ok()?;
        (!authority.as_str().contains('@')).then(|| Host::lenient(authority.host()))
    }
}

/// Decides which requests are admitted, and counts the rejected ones.
#[derive(Debug, Default)]
pub(crate) struct Guard {
    /// Allowed hosts, besides this machine's own.
    allowed: Vec<Host>,
    /// Number of requests for or from other hosts.
    foreign: AtomicU64,
    /// The first of these hosts.
    foreign_name: Mutex<Option<String>>,
    /// Number of attempts to write.
    pub writes: AtomicU64,
    /// Number of invalid requests.
    pub invalid: AtomicU64,
    /// Number of connections closed before they sent a complete request.
    pub unfinished: AtomicU64,
    /// Number of connections closed because they read too little of their responses, or the least of all.
    pub unread: AtomicU64,
}

impl Guard {
    pub fn new(allowed: Vec<Host>) -> Guard {
        Guard { allowed, ..Guard::default() }
    }

    /// Admits a request to this machine's address `at` if its page or program is allowed. Otherwise counts it and
    /// returns the host name that it used.
    pub fn admits(&self, uri: &Uri, headers: &HeaderMap, at: IpAddr) -> Result<(), String> {
        let named = uri.authority().map(|authority| authority.as_str().as_bytes());
        let mut names =
            named.into_iter().chain(headers.get_all(header::HOST).iter().map(|host| host.as_bytes())).peekable();
        // every browser sends the host that it requests, and the origin of the page
        let refused = match names.peek() {
            None => Some("no host".to_owned()),
            Some(_) => names.find(|name| !Host::of(name).is_some_and(|host| self.knows(&host, at))).map(printable),
        };
        let mut origins = headers.get_all(header::ORIGIN).iter().map(|origin| origin.as_bytes());
        let is_known = |origin: &[u8]| {
            let uri = Uri::try_from(origin).ok();
            let authority = uri.as_ref().and_then(|uri| uri.authority());
            authority.and_then(|name| Host::of(name.as_str().as_bytes())).is_some_and(|host| self.knows(&host, at))
        };
        let Some(name) = refused.or_else(|| origins.find(|origin| !is_known(origin)).map(printable)) else {
            return Ok(());
        };
        self.foreign.fetch_add(1, Ordering::Relaxed);
        lock(&self.foreign_name).get_or_insert_with(|| name.clone());
        Err(name)
    }

    fn knows(&self, host: &Host, at: IpAddr) -> bool {
        let is_own = match host {
            Host::Ip(ip) => ip.is_loopback() || *ip == at.to_canonical(),
            Host::Name(name) => name == "localhost",
        };
        is_own || self.allowed.contains(host)
    }

    /// Summary of the requests rejected so far, as a sentence.
    pub fn summary(&self) -> Option<String> {
        let count = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        let [foreign, writes, invalid] = [&self.foreign, &self.writes, &self.invalid].map(count);
        let [unfinished, unread] = [&self.unfinished, &self.unread].map(count);
        let name = lock(&self.foreign_name).clone().unwrap_or_default();
        let part = |n: u64, what: &str| (n > 0).then(|| format!("{} {what}", thousands(n)));
        let foreign = part(foreign, &format!("for or from another host than this one ({name} first; see --bind)"));
        let requests: Vec<String> =
            [foreign, part(writes, "to write"), part(invalid, "that are invalid")].into_iter().flatten().collect();
        let connections: Vec<String> =
            [part(unfinished, "without a complete request"), part(unread, "that read too little of their response")]
                .into_iter()
                .flatten()
                .collect();
        let refused = (!requests.is_empty()).then(|| {
            let total = count(&self.foreign) + writes + invalid;
            format!("refused {}: {}", counted(total, "request"), listed(&requests))
        });
        let closed = (!connections.is_empty())
            .then(|| format!("closed {}: {}", counted(unfinished + unread, "connection"), listed(&connections)));
        let parts: Vec<String> = refused.into_iter().chain(closed).collect();
        (!parts.is_empty()).then(|| parts.join("; "))
    }
}

/// A printable form of untrusted text.
fn printable(name: &[u8]) -> String {
    let is_plain = |c: &char| c.is_ascii_alphanumeric() || "-_.:/[]".contains(*c);
    let plain: String = name.iter().map(|&byte| char::from(byte)).filter(is_plain).take(80).collect();
    if plain.is_empty() { "no name".to_owned() } else { plain }
}

#[cfg(test)]
mod tests {
    use super::*;
    use hyper::header::HeaderValue;

    fn admits(guard: &Guard, uri: &str, headers: &[(header::HeaderName, &str)], at: &str) -> bool {
        let mut map = HeaderMap::new();
        for (name, value) in headers {
            map.append(name, HeaderValue::from_str(value).expect("a header"));
        }
        guard.admits(&uri.parse().expect("an address"), &map, at.parse().expect("an address")).is_ok()
    }

    #[test]
    fn own_names_are_admitted_and_no_others() {
        let guard = Guard::new(vec!["Studio.local".parse().expect("a name"), "fe80::1".parse().expect("an address")]);
        let at = "192.168.1.5";
        for good in [
            "localhost",
            "LOCALHOST:1",
            "localhost.",
            "127.0.0.1",
            "127.0.0.1:9090",
            "127.9.9.9",
            "[::1]",
            "[::1]:9876",
            "[::ffff:127.0.0.1]:1",
            "192.168.1.5",
            "192.168.1.5:80",
            "studio.local",
            "STUDIO.local.:9",
            "[fe80::1]:1",
        ] {
            assert!(admits(&guard, "/", &[(header::HOST, good)], at), "{good}");
            assert!(admits(&guard, &format!("http://{good}/"), &[], at), "{good}");
            let origin = format!("http://{good}");
            assert!(admits(&guard, "/", &[(header::HOST, good), (header::ORIGIN, &origin)], at), "{good}");
        }
        for bad in [
            "evil.example",
            "evil.example:9090",
            "localhost.evil.example",
            "127.0.0.1.evil.example",
            "192.168.1.6",
            "0.0.0.0",
            "8.8.8.8",
            "[::2]",
            "",
            ":9090",
            "localhost@evil.example",
            "evil.example@localhost",
            "a b",
            "127.0.0.1, evil.example",
        ] {
            assert!(!admits(&guard, "/", &[(header::HOST, bad)], at), "{bad}");
            let origin = format!("http://{bad}");
            assert!(!admits(&guard, "/", &[(header::HOST, "localhost"), (header::ORIGIN, &origin)], at), "{bad}");
        }
        // an allowed host does not make another one in the same request acceptable
        let host = |name| (header::HOST, name);
        assert!(!admits(&guard, "/", &[], at));
        assert!(!admits(&guard, "/", &[host("localhost"), host("evil.example")], at));
        assert!(!admits(&guard, "http://evil.example/", &[host("localhost")], at));
        assert!(!admits(&guard, "http://localhost/", &[host("evil.example")], at));
        assert!(!admits(&guard, "/", &[host("localhost"), (header::ORIGIN, "null")], at));
        assert!(!admits(&guard, "/", &[host("localhost"), (header::ORIGIN, "file://")], at));
        // the address that receives the connection is one that --bind covers
        assert!(!admits(&guard, "/", &[host("192.168.1.5")], "127.0.0.1"));
        assert!(admits(&guard, "/", &[host("192.168.1.5")], "::ffff:192.168.1.5"));
    }

    #[test]
    fn a_host_has_no_scheme_port_or_path() {
        for bad in ["", "*", "a:1", "http://a", "a/b", "a b", "*.example", "ü", "a\u{1b}[2J"] {
            assert!(bad.parse::<Host>().is_err(), "{bad:?}");
        }
        assert_eq!("[::1]".parse(), Ok(Host::Ip("::1".parse().expect("an address"))));
        assert_eq!("Studio.".parse(), Ok(Host::Name("studio".to_owned())));
    }

    #[test]
    fn refused_requests_are_reported_without_control_characters() {
        let guard = Guard::default();
        assert_eq!(guard.summary(), None);
        assert!(!admits(&guard, "/", &[(header::HOST, "evil.example")], "127.0.0.1"));
        assert!(!admits(&guard, "/", &[(header::HOST, "worse.example")], "127.0.0.1"));
        guard.writes.store(1, Ordering::Relaxed);
        guard.unfinished.store(300, Ordering::Relaxed);
        assert_eq!(
            guard.summary().as_deref(),
            Some(
                "refused 3 requests: 2 for or from another host than this one (evil.example first; see --bind) \
                 and 1 to write; closed 300 connections: 300 without a complete request"
            )
        );
        assert_eq!(printable(b"\x1b]0;a\x07\xff"), "]0a");
    }
}
