//! Shows a run to viewers outside the terminal: browsers at its own page (`--serve`) and at the
//! page of a server (`--publish`).

use std::io::IsTerminal as _;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use super::args::RunArgs;
use super::exit::CliError;
use super::out::errln;
use spherecal_campaign::{CampaignObserver, Progress};
use spherecal_job::{PreparedRun, open_store, stored_report};
use spherecal_link::Arrival;
#[cfg(feature = "services")]
use spherecal_services::grpc::Publisher;
use spherecal_services::live::{End, LiveScene, LiveWatch};
use spherecal_services::web::{Page, ReportReader, ReportWriter};
use spherecal_services::{Offer, Server};
#[cfg(feature = "services")]
use spherecal_store::StoreLocation;
use spherecal_store::time::now_utc;

/// The outside views of a run; none unless requested.
#[derive(Default)]
pub(super) struct LiveOutput {
    /// Each view, and whether its page has the database in which the run is stored.
    watches: Vec<(LiveWatch, bool)>,
    server: Option<Server>,
    #[cfg(feature = "services")]
    publisher: Option<Publisher>,
}

impl LiveOutput {
    /// Opens the run's own page. It answers while the poses are still being planned.
    pub(super) fn open(args: &RunArgs) -> Result<Self, CliError> {
        let mut live = Self::default();
        if let Some(address) = &args.serve {
            // A separate connection, beside the one through which the run writes.
            let store = open_store(&args.database(), !args.resume)?;
            let page = Page {
                store: Some(Arc::new(std::sync::Mutex::new(store))),
                report: Some(stored_reports()),
                ..Page::default()
            };
            #[allow(clippy::needless_update, reason = "without gRPC a page is all that is offered")]
            let offer = Offer {
                page: Some((page, false)),
                ..Offer::default()
            };
            let server = Server::start(address, &args.protection.files(), offer)?;
            errln!("page on {}", server.page_url());
            live.server = Some(server);
        }
        Ok(live)
    }

    /// Shows the run that begins, also on another server's page.
    #[cfg_attr(
        not(feature = "services"),
        allow(clippy::unnecessary_wraps, reason = "only another server's page can fail")
    )]
    pub(super) fn begin(&mut self, args: &RunArgs, prepared: &PreparedRun) -> Result<(), CliError> {
        let mut outs = Vec::new();
        if let Some(server) = &mut self.server {
            outs.extend(server.show().map(|out| (out, true)));
        }
        #[cfg(feature = "services")]
        if let Some(peer) = args.shown_by() {
            let stored = args.database() == StoreLocation::Service(peer.clone());
            let (out, publisher) = Publisher::start(peer)?;
            outs.push((out, stored));
            self.publisher = Some(publisher);
        }
        let scene = LiveScene {
            arm: prepared.config.arm.clone(),
            link: args.link.to_string(),
            begun_utc: now_utc(),
            ..LiveScene::new(
                &prepared.robot,
                &prepared.tool,
                &prepared.plan,
                prepared.config.procedure.approach.trigger_n,
            )
        };
        let watch = |out| LiveWatch::new(out, &prepared.robot, &prepared.tool, scene.clone());
        self.watches = outs.into_iter().map(|(out, stored)| (watch(out), stored)).collect();
        Ok(())
    }

    /// Says how the run ended. The run's own page stays until this is dropped where a person is at the terminal, and
    /// closes at once where nobody is: a script may read the page to its end before it reads the result.
    pub(super) fn end(&mut self, end: &End) {
        for (watch, stored) in &mut self.watches {
            // A number means nothing where another database is.
            let run = end.run.filter(|_| *stored);
            watch.end(End { run, ..end.clone() });
        }
        // Their channels end with them.
        self.watches.clear();
        #[cfg(feature = "services")]
        if let Some(publisher) = self.publisher.take() {
            publisher.finish();
        }
        if !std::io::stdin().is_terminal() {
            self.server = None;
        }
    }

    /// Keeps the run's own page until the person at the terminal is done with it: Enter, or Ctrl-C.
    pub(super) fn stay(&self, interrupt: &AtomicBool) {
        let Some(server) = &self.server else { return };
        errln!("The page stays on {}. Press Enter to close it.", server.page_url());
        let (done, waiting) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            let _ = std::io::stdin().read_line(&mut String::new());
            let _ = done.send(());
        });
        while !interrupt.load(Ordering::Relaxed) && waiting.recv_timeout(Duration::from_millis(50)).is_err() {}
    }

    /// A remark for those who see the run.
    pub(super) fn remark(&mut self, text: &str) {
        for (watch, _) in &mut self.watches {
            watch.note(text);
        }
    }
}

impl CampaignObserver for LiveOutput {
    fn event(&mut self, now_us: u64, arrival: &Arrival) {
        for (watch, _) in &mut self.watches {
            watch.event(now_us, arrival);
        }
    }

    fn progress(&mut self, progress: &Progress) {
        for (watch, _) in &mut self.watches {
            watch.progress(progress);
        }
    }

    fn note(&mut self, text: &str) {
        self.remark(text);
    }
}

/// Writes the report of a stored run, for a page.
pub(super) fn stored_reports() -> ReportReader {
    Arc::new(|store, info| {
        let stored = stored_report(store, info)?;
        let write: ReportWriter = Box::new(move || Ok(stored.render()?));
        Ok(write)
    })
}
