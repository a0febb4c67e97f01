//! Outputs that need a library (feature `live`): MAVLink, and the page.

use std::sync::Arc;

use super::super::output::Failure;
use super::mavlink::Mavlink;
use super::page::{Page, PageAddress};
use super::updates::UdpAddress;
use crate::live::{GeoPosition, Line, VehicleLine, Watch};

/// Their flags.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct NetworkArgs {
    /// Send a MAVLink message CAMERA_TRACKING_GEO_STATUS per georeferenced vehicle and second to an address
    #[arg(long, value_name = "udp:HOST:PORT", help_heading = "Outputs while it records")]
    mavlink: Option<UdpAddress>,
    /// Serve a page with plan view and last frame, for browsers of this computer: 127.0.0.1:8080
    #[arg(long, value_name = "ADDRESS:PORT", help_heading = "Outputs while it records")]
    page: Option<PageAddress>,
    /// Allow an address for --page that other computers can reach; there is no password
    #[arg(long, requires = "page", help_heading = "Outputs while it records")]
    page_public: bool,
}

impl NetworkArgs {
    /// Refuses a page that other computers can reach by mistake.
    ///
    /// # Errors
    /// [`Failure::Usage`].
    pub(super) fn check(&self) -> Result<(), Failure> {
        self.page.map_or(Ok(()), |page| page.check(self.page_public)).map_err(Failure::Usage)
    }
}

/// Open outputs; none without its flag.
pub(super) struct Network {
    mavlink: Option<Mavlink>,
    page: Option<Arc<Page>>,
}

impl Network {
    /// # Errors
    /// An address that cannot be resolved or bound.
    pub(super) fn open(args: &NetworkArgs) -> anyhow::Result<Self> {
        Ok(Self {
            mavlink: args.mavlink.as_ref().map(Mavlink::open).transpose()?,
            page: args.page.map(Page::open).transpose()?.map(Arc::new),
        })
    }

    /// Address of the page.
    pub(super) fn url(&self) -> Option<String> {
        self.page.as_ref().map(|page| page.url())
    }

    /// Shows frames on the page.
    pub(super) fn watch(&self) -> Option<Box<Watch>> {
        let page = self.page.clone()?;
        Some(Box::new(move |frame, image| page.take_frame(frame, image)))
    }

    /// Takes a line, as it is in live.jsonl.
    pub(super) fn take_line(&self, line: &Line, text: &str) {
        if let Some(page) = &self.page {
            page.take_line(line, text);
        }
    }

    /// Takes a vehicle that is due.
    pub(super) fn send(&mut self, vehicle: &VehicleLine, geo: &GeoPosition) {
        if let Some(mavlink) = &mut self.mavlink {
            mavlink.send(vehicle, geo);
        }
    }
}
