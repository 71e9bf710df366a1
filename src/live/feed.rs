//! What every open page knows: messages that replace one another by kind, and are sent to each page as they come.

use std::{
    sync::{Arc, Mutex},
    task::Poll,
};

use hyper::body::Bytes;
use serde_json::{Value, json};
use tokio::sync::watch;

use super::change::Problem;
use crate::{
    lock,
    stream::sinks::serve::{Parts, follow},
};

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

    /// The messages for a page that is opened now, as server-sent events. One that reads slowly misses messages that were
    /// replaced.
    pub fn read(&self) -> Parts {
        let (messages, mut seen) = (Arc::clone(&self.messages), 0);
        follow(self.news.subscribe(), move || match lock(&messages).last.iter().find(|(number, ..)| *number > seen) {
            Some((number, _, text)) => {
                seen = *number;
                Poll::Ready(Some(text.clone()))
            }
            None => Poll::Pending,
        })
    }
}
