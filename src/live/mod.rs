//! The page of `meldscope live`: sliders beside the viewer, and a whole run that answers each of their movements.
//!
//! | contents | module |
//! | --- | --- |
//! | what a page asks for, and why it does not get it | [`change`] |
//! | runs of the changed experiment, the newest first | [`runs`] |
//! | events and curves of a run | [`outline`] |
//! | its recording, which viewers read while it is made | [`recording`] |
//! | values of a parameter at which the outcome changes | [`thresholds`] |
//! | what every open page knows | [`feed`] |
//! | the page and its requests | `site` |
//!
//! A change arrives as a POST request and replaces the one before, whose run is interrupted. The run that answers is
//! simulated whole; then its events and curves go to every page, and its recording, which the viewer in the page reads,
//! begins with the frame under the page's time cursor. A run is a function of the changed scene alone, so that what is
//! on screen is what `meldscope run` records.

pub mod change;
pub mod feed;
pub mod outline;
pub mod recording;
pub mod runs;
mod site;
pub mod thresholds;

use std::{
    net::SocketAddr,
    path::PathBuf,
    sync::{Arc, atomic::AtomicBool},
    thread::JoinHandle,
};

use tokio::sync::oneshot;

use crate::{
    observe::Experiment,
    stream::sinks::{Serve, SinkError, serve},
};
use runs::Runs;

/// What a page is served for.
pub struct Options {
    /// Where to listen.
    pub serve: Serve,
    /// Where a recording is saved on request.
    pub save: PathBuf,
    /// The flag with which the experiment's simulations are interrupted.
    pub interrupt: &'static AtomicBool,
}

/// A page that is being served, until this value is dropped.
pub struct Live {
    /// The address of the page, with its token.
    pub address: String,
    runs: Arc<Runs>,
    stop: Option<oneshot::Sender<()>>,
    server: Option<JoinHandle<()>>,
    worker: Option<JoinHandle<()>>,
}

impl Live {
    /// Serves a page for an experiment, and runs it.
    ///
    /// # Errors
    /// The port is taken, or no thread can be started.
    pub fn start(experiment: Arc<dyn Experiment>, options: Options) -> Result<Live, SinkError> {
        let runs = Arc::new(Runs::new(experiment, options.save, options.interrupt));
        let token = serve::token()?;
        let site = site::Page::new(token.clone(), Arc::clone(&runs));
        let (address, stop, server) = serve::page(&options.serve, site)?;
        let worker = std::thread::Builder::new().name("runs".to_owned()).spawn({
            let runs = Arc::clone(&runs);
            move || runs.work()
        });
        let worker =
            worker.map_err(|error| SinkError::Thread { target: "the runs".into(), reason: error.to_string() })?;
        let address = url(address, &token);
        Ok(Live { address, runs, stop: Some(stop), server: Some(server), worker: Some(worker) })
    }

    /// Continues with another experiment, such as a scene file that was saved: changes that still apply are kept.
    pub fn replace(&self, experiment: Arc<dyn Experiment>) {
        self.runs.replace(experiment);
    }

    /// Shows a problem beside the last good run.
    pub fn report(&self, problem: change::Problem) {
        self.runs.report(problem);
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        self.runs.end();
        drop(self.stop.take());
        for thread in [self.worker.take(), self.server.take()].into_iter().flatten() {
            thread.join().ok();
        }
    }
}

fn url(address: SocketAddr, token: &str) -> String {
    format!("http://{address}/{token}/")
}
