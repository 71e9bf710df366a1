//! A stand-in for a viewer: the part of its server that receives what a run sends.

use std::{
    convert::Infallible,
    future::poll_fn,
    net::{Ipv4Addr, TcpListener},
    pin::{Pin, pin},
    sync::{Arc, Mutex},
    task::{Context, Poll},
    thread::JoinHandle,
    time::{Duration, Instant},
};

use hyper::{
    HeaderMap, Request, Response,
    body::{Body, Bytes, Frame, Incoming},
    server::conn::http2,
    service::service_fn,
};
use hyper_util::rt::{TokioExecutor, TokioIo};
use tokio::sync::oneshot;

/// Listens until it is dropped, which breaks its connections.
pub struct Viewer {
    pub port: u16,
    received: Arc<Mutex<Received>>,
    thread: Option<(oneshot::Sender<()>, JoinHandle<()>)>,
}

#[derive(Default)]
struct Received {
    messages: Vec<Vec<u8>>,
    /// Number of runs that send messages, and of those that have ended.
    begun: usize,
    ended: usize,
}

impl Viewer {
    pub fn start() -> Viewer {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a free port");
        listener.set_nonblocking(true).expect("an option of every socket");
        let port = listener.local_addr().expect("an address").port();
        let received = Arc::default();
        let (stop, stopped) = oneshot::channel();
        let serving = serve(listener, Arc::clone(&received));
        let thread = std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
            runtime.block_on(async {
                tokio::spawn(serving);
                stopped.await.ok();
            });
        });
        Viewer { port, received, thread: Some((stop, thread)) }
    }

    /// The address for `--connect`.
    pub fn url(&self) -> String {
        format!("rerun+http://127.0.0.1:{}/proxy", self.port)
    }

    /// All messages, as soon as the runs that sent them have ended.
    pub fn messages(&self) -> Vec<Vec<u8>> {
        let started = Instant::now();
        loop {
            let received = self.received.lock().expect("no panic");
            if received.begun > 0 && received.ended == received.begun {
                return received.messages.clone();
            }
            assert!(started.elapsed() < Duration::from_secs(20), "{} messages in 20 s", received.messages.len());
            drop(received);
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        if let Some((stop, thread)) = self.thread.take() {
            drop(stop);
            thread.join().ok();
        }
    }
}

async fn serve(listener: TcpListener, received: Arc<Mutex<Received>>) {
    let listener = tokio::net::TcpListener::from_std(listener).expect("a socket that does not block");
    while let Ok((stream, _)) = listener.accept().await {
        let received = Arc::clone(&received);
        let answer = service_fn(move |request| receive(request, Arc::clone(&received)));
        tokio::spawn(http2::Builder::new(TokioExecutor::new()).serve_connection(TokioIo::new(stream), answer));
    }
}

/// Receives the messages of a run until it ends: gRPC frames, which are a flag byte, a length and a message.
async fn receive(request: Request<Incoming>, to: Arc<Mutex<Received>>) -> Result<Response<Answer>, Infallible> {
    assert_eq!(request.uri().path(), "/rerun.sdk_comms.v1alpha1.MessageProxyService/WriteMessages");
    to.lock().expect("no panic").begun += 1;
    let (mut body, mut bytes) = (pin!(request.into_body()), Vec::new());
    while let Some(Ok(frame)) = poll_fn(|context| body.as_mut().poll_frame(context)).await {
        bytes.extend_from_slice(&frame.into_data().unwrap_or_default());
        let mut rest = &bytes[..];
        while let [0, a, b, c, d, more @ ..] = rest
            && let Some((message, more)) = more.split_at_checked(u32::from_be_bytes([*a, *b, *c, *d]) as usize)
        {
            to.lock().expect("no panic").messages.push(message.to_vec());
            rest = more;
        }
        bytes.drain(..bytes.len() - rest.len());
    }
    to.lock().expect("no panic").ended += 1;
    let status = HeaderMap::from_iter([("grpc-status".parse().expect("a name"), "0".parse().expect("a value"))]);
    let empty = Bytes::from_static(&[0; 5]);
    let answer = Answer(vec![Frame::trailers(status), Frame::data(empty)]);
    Ok(Response::builder().header("content-type", "application/grpc").body(answer).expect("a response"))
}

/// The frames of a response, the last one first.
struct Answer(Vec<Frame<Bytes>>);

impl Body for Answer {
    type Data = Bytes;
    type Error = Infallible;

    fn poll_frame(mut self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Infallible>>> {
        Poll::Ready(self.0.pop().map(Ok))
    }
}
