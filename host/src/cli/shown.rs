//! Who sees a run from outside: browsers at a page of its own (`--serve`), and
//! those at the page of a server (`--publish`).

use super::args::RunArgs;
use super::exit::CliError;
use super::out::errln;
use crate::campaign::{Observer, Progress};
use crate::job::{self, Prepared};
use crate::link::Arrival;
use crate::live::{End, Scene, Watch};
use crate::rpc::{Offer, Publisher, Server};
use crate::store::{Place, Store};
use crate::web::Page;

/// A run as it is seen from outside; by nobody, unless it was asked for.
#[derive(Default)]
pub(super) struct Shown {
    /// Each with whether its page has the database that the run is stored in.
    watches: Vec<(Watch, bool)>,
    server: Option<Server>,
    publisher: Option<Publisher>,
}

impl Shown {
    /// Opens the page, and greets the server of another.
    pub(super) fn start(args: &RunArgs, prepared: &Prepared) -> Result<Self, CliError> {
        let mut shown = Self::default();
        let mut outs = Vec::new();
        if let Some(address) = &args.serve {
            // Of its own, beside the one that the run writes through.
            let store = Store::at(&args.database(), true)?;
            let page = Page {
                store: Some(std::sync::Arc::new(std::sync::Mutex::new(store))),
                ..Page::default()
            };
            let offer = Offer {
                page: Some((page, false)),
                ..Offer::default()
            };
            let mut server = Server::start(address, &args.protection.files(), offer)?;
            errln!("page on {}", server.page_url());
            outs.extend(server.show().map(|out| (out, true)));
            shown.server = Some(server);
        }
        if let Some(peer) = args.shown_by() {
            let stored = args.database() == Place::Service(peer.clone());
            let (out, publisher) = Publisher::start(peer)?;
            outs.push((out, stored));
            shown.publisher = Some(publisher);
        }
        let scene = Scene {
            arm: prepared.config.arm.clone(),
            link: args.link.to_string(),
            begun_utc: job::now_utc(),
            ..Scene::new(
                &prepared.robot,
                &prepared.tool,
                &prepared.plan,
                prepared.config.procedure.approach.trigger_n,
            )
        };
        let watch = |out| Watch::new(out, &prepared.robot, &prepared.tool, scene.clone());
        shown.watches = outs.into_iter().map(|(out, stored)| (watch(out), stored)).collect();
        Ok(shown)
    }

    /// Says how the run ended, and closes the page.
    pub(super) fn end(mut self, end: &End) {
        for (watch, stored) in &mut self.watches {
            // A number means nothing where another database is.
            let run = end.run.filter(|_| *stored);
            watch.end(End { run, ..end.clone() });
        }
        // Their channels end with them.
        self.watches.clear();
        if let Some(publisher) = self.publisher.take() {
            publisher.finish();
        }
    }

    /// A remark for those who see the run.
    pub(super) fn remark(&mut self, text: &str) {
        for (watch, _) in &mut self.watches {
            watch.note(text);
        }
    }
}

impl Observer for Shown {
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
