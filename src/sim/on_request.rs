//! What is computed when it is first asked for.

use std::sync::Mutex;

/// A value that is computed on first use; a clone computes it again.
pub(super) struct OnRequest<T>(pub Mutex<Option<T>>);

impl<T> Default for OnRequest<T> {
    fn default() -> OnRequest<T> {
        OnRequest(Mutex::new(None))
    }
}

impl<T> Clone for OnRequest<T> {
    fn clone(&self) -> OnRequest<T> {
        OnRequest::default()
    }
}
