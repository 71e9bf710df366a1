//! What every open page knows: messages that replace one another by kind, and are sent to each page as they come.

use std::{
    pin::Pin,
    sync::{Arc, Mutex},
    task::{Context, Poll, ready},
};

use hyper::body::Bytes;
use serde_json::{Value, json};
use tokio::sync::watch;
use tokio_stream::{Stream, wrappers::WatchStream};

use super::{change::Problem, lock};

/// The last message of each kind.
pub struct Feed {
    messages: Arc<Mutex<Messages>>,
    news: watch::Sender<()>,
}

#[derive(Default)]
struct Messages {
    /// Number of messages so far.
    count: u64,
    /// Number, kind and text of the last message of each kind, ascending.
    last: Vec<(u64, &'static str, Bytes)>,
}

impl Default for Feed {
    fn default() -> Feed {
        Feed { messages: Arc::default(), news: watch::channel(()).0 }
    }
}

impl Feed {
    /// Sends a message, an object, to every page, in place of the last one of its kind.
    pub fn send(&self, kind: &'static str, mut message: Value) {
        message["kind"] = kind.into();
        let text = Bytes::from(format!("data: {message}\n\n"));
        let mut messages = lock(&self.messages);
        messages.count += 1;
        let number = messages.count;
        messages.last.retain(|(_, other, _)| *other != kind);
        messages.last.push((number, kind, text));
        drop(messages);
        self.news.send_replace(());
    }

    /// Shows a problem on every page.
    pub fn problem(&self, problem: &Problem) {
        self.send("problem", json!(problem));
    }

    /// The messages for a page that is opened now, as server-sent events.
    pub fn read(&self) -> Reader {
        Reader { messages: Arc::clone(&self.messages), seen: 0, news: WatchStream::from_changes(self.news.subscribe()) }
    }
}

/// The messages for one page. One that reads slowly misses messages that were replaced.
pub struct Reader {
    messages: Arc<Mutex<Messages>>,
    /// Number of the last message that it has read.
    seen: u64,
    news: WatchStream<()>,
}

impl Stream for Reader {
    type Item = Bytes;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Bytes>> {
        loop {
            let next = lock(&self.messages).last.iter().find(|(number, ..)| *number > self.seen).cloned();
            if let Some((number, _, text)) = next {
                self.seen = number;
                return Poll::Ready(Some(text));
            }
            if ready!(Pin::new(&mut self.news).poll_next(context)).is_none() {
                return Poll::Ready(None);
            }
        }
    }
}
