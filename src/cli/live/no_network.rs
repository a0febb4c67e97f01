//! A program without the feature `live`: neither MAVLink nor a page.

use super::super::output::Failure;
use crate::live::{GeoPosition, Line, VehicleLine, Watch};

/// No flags.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct NetworkArgs {}

impl NetworkArgs {
    pub(super) fn check(&self) -> Result<(), Failure> {
        Ok(())
    }
}

/// No outputs.
pub(super) struct Network;

impl Network {
    pub(super) fn open(_: &NetworkArgs) -> anyhow::Result<Self> {
        Ok(Self)
    }

    pub(super) fn url(&self) -> Option<String> {
        None
    }

    pub(super) fn watch(&self) -> Option<Box<Watch>> {
        None
    }

    pub(super) fn take_line(&self, _: &Line, _: &str) {}

    pub(super) fn send(&mut self, _: &VehicleLine, _: &GeoPosition) {}
}
