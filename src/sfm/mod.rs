//! Structure from motion: cameras and points of the background, and of each object, from what is seen of them.
//!
//! A front end turns frames and masks into a [`TrackTable`] ([`front_end`]); the [`mapper`] turns that into a
//! reconstruction. Both serve background and objects alike; only their options differ.

pub mod bundle;
pub mod features;
pub mod front_end;
pub mod mapper;
pub mod matching;
pub mod resection;
pub mod solvers;
pub mod tracks;
pub mod triangulation;
pub mod two_view;

mod error;

pub use error::SfmError;
pub use front_end::{FrontEndOptions, SiftFrontEnd};
pub use mapper::{Intrinsics, Options, Report, reconstruct};
pub use tracks::TrackTable;
