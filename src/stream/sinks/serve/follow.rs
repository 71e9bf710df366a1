//! Parts of a response that are sent as they become known.

use std::pin::Pin;
use std::task::{Context, Poll, ready};

use hyper::body::Bytes;
use tokio::sync::watch;
use tokio_stream::{Stream, wrappers::WatchStream};

/// Parts as they become known.
pub(crate) type Parts = Pin<Box<dyn Stream<Item = Bytes> + Send>>;

/// Parts that `look` finds, one by one: it is called again after each part, and whenever there is news after it found none.
/// They end when it says so, or when there will be no more news.
pub(crate) fn follow(
    news: watch::Receiver<()>,
    look: impl FnMut() -> Poll<Option<Bytes>> + Send + Unpin + 'static,
) -> Parts {
    Box::pin(Followed { news: WatchStream::from_changes(news), look })
}

struct Followed<L> {
    news: WatchStream<()>,
    look: L,
}

impl<L: FnMut() -> Poll<Option<Bytes>> + Unpin> Stream for Followed<L> {
    type Item = Bytes;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Bytes>> {
        loop {
            if let Poll::Ready(found) = (self.look)() {
                return Poll::Ready(found);
            }
            if ready!(Pin::new(&mut self.news).poll_next(context)).is_none() {
                return Poll::Ready(None);
            }
        }
    }
}
