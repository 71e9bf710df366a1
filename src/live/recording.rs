//! The recording of a run, which viewers read while it is made.

use std::{
    io::{self, Write},
    sync::{Arc, Mutex},
    task::Poll,
};

use hyper::body::Bytes;
use tokio::sync::watch;

use super::change::Problem;
use crate::{
    lock,
    sdk::{CrateVersion, EncodeError, Encoder, EncodingOptions, LogMsg},
    stream::sinks::serve::{Parts, follow},
};

/// The recording of a run, as it becomes known.
pub struct Recording {
    /// Number of the run.
    pub number: u64,
    log: Arc<Mutex<Log>>,
    news: watch::Sender<()>,
}

#[derive(Default)]
struct Log {
    /// The beginning of every recording file.
    header: Bytes,
    /// The layout, for a page that has none yet.
    layout: Bytes,
    parts: Vec<Bytes>,
    is_complete: bool,
}

impl Recording {
    /// Begins a recording with a layout.
    pub fn begin(number: u64, layout: &[LogMsg]) -> Result<(Recording, Writer), EncodeError> {
        let (mut encoder_of_layout, out) = encoder()?;
        let header = out.take();
        for message in layout {
            encoder_of_layout.append(message)?;
        }
        encoder_of_layout.flush_blocking()?;
        let log = Arc::new(Mutex::new(Log { header, layout: out.take(), ..Log::default() }));
        let news = watch::channel(()).0;
        let (encoder, out) = encoder()?;
        out.take(); // the header again
        let writer = Writer { encoder, out, bytes: 0, log: Arc::clone(&log), news: news.clone() };
        Ok((Recording { number, log, news }, writer))
    }

    /// The recording as a file that grows; with the layout if `is_first`.
    pub fn read(&self, is_first: bool) -> Parts {
        let (log, mut next) = (Arc::clone(&self.log), 0);
        follow(self.news.subscribe(), move || {
            let log = lock(&log);
            let layout = is_first.then_some(&log.layout);
            match std::iter::once(&log.header).chain(layout).chain(&log.parts).nth(next) {
                Some(part) => {
                    next += 1;
                    Poll::Ready(Some(part.clone()))
                }
                None if log.is_complete => Poll::Ready(None),
                None => Poll::Pending,
            }
        })
    }
}

/// An encoder that has written the header of a file.
fn encoder() -> Result<(Encoder<Collected>, Collected), EncodeError> {
    let out = Collected::default();
    let mut encoder = Encoder::new_eager(CrateVersion::LOCAL, EncodingOptions::PROTOBUF_COMPRESSED, out.clone())?;
    encoder.flush_blocking()?;
    Ok((encoder, out))
}

impl From<EncodeError> for Problem {
    fn from(error: EncodeError) -> Problem {
        Problem::new(format!("the recording cannot be encoded: {error}"))
    }
}

/// Encodes the messages of a recording.
pub struct Writer {
    encoder: Encoder<Collected>,
    out: Collected,
    bytes: u64,
    log: Arc<Mutex<Log>>,
    news: watch::Sender<()>,
}

impl Writer {
    /// Size of what was written [bytes].
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Adds messages.
    pub fn write(&mut self, messages: &[LogMsg]) -> Result<(), EncodeError> {
        for message in messages {
            self.encoder.append(message)?;
        }
        self.encoder.flush_blocking()?;
        let part = self.out.take();
        self.bytes += part.len() as u64;
        if !part.is_empty() {
            lock(&self.log).parts.push(part);
            self.news.send_replace(());
        }
        Ok(())
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        lock(&self.log).is_complete = true;
        self.news.send_replace(());
    }
}

/// Bytes that an encoder has written.
#[derive(Clone, Default)]
struct Collected(Arc<Mutex<Vec<u8>>>);

impl Collected {
    fn take(&self) -> Bytes {
        std::mem::take(&mut *lock(&self.0)).into()
    }
}

impl Write for Collected {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        lock(&self.0).extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
