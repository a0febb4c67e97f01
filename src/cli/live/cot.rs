//! Cursor on Target while the camera records: one event per vehicle and second, by the writer of the export.

use std::convert::Infallible;
use std::fs::File;
use std::io::Write;
use std::net::UdpSocket;
use std::path::PathBuf;
use std::str::FromStr;

use anyhow::Context;

use super::updates::{Health, UdpAddress, now_s};
use crate::export::{CotEvent, CotTrack};
use crate::live::{GeoPosition, VehicleLine};
use crate::telemetry::clock_s;

/// Declaration in front of every datagram.
const DECLARATION: &str = "<?xml version=\"1.0\" encoding=\"UTF-8\" standalone=\"yes\"?>";

/// Destination of events.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Target {
    Udp(UdpAddress),
    File(PathBuf),
}

impl FromStr for Target {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.starts_with("udp:") {
            true => text.parse().map(Self::Udp),
            false => text.parse().map(Self::File).map_err(|error: Infallible| match error {}),
        }
    }
}

enum Sink {
    Udp(UdpSocket),
    File(File),
}

/// Sends events.
pub(super) struct Cot {
    sink: Sink,
    health: Health,
    /// Identity of this run: uids of two must differ.
    title: String,
}

impl Cot {
    /// * `title` – name of the run.
    ///
    /// # Errors
    /// An address that cannot be resolved, a file that cannot be written.
    pub(super) fn open(target: &Target, title: &str) -> anyhow::Result<Self> {
        let title = title.to_owned();
        Ok(match target {
            Target::Udp(address) => Self { sink: Sink::Udp(address.open()?), health: Health::of(address), title },
            Target::File(path) => {
                let file = File::create(path).with_context(|| format!("{}: cannot be written", path.display()))?;
                Self { sink: Sink::File(file), health: Health::of(path.display()), title }
            }
        })
    }

    pub(super) fn send(&mut self, vehicle: &VehicleLine, geo: &GeoPosition) {
        let Some(line) = event(&self.title, vehicle, geo).to_line() else { return };
        let sent = match &mut self.sink {
            Sink::Udp(socket) => socket.send(format!("{DECLARATION}{line}").as_bytes()).map(drop),
            Sink::File(file) => file.write_all(format!("{line}\n").as_bytes()),
        };
        self.health.note(sent);
    }
}

/// The event of a vehicle. Where the telemetry has no universal time, the clock of the computer serves.
fn event(title: &str, vehicle: &VehicleLine, geo: &GeoPosition) -> CotEvent {
    let time_s = vehicle.utc.as_deref().and_then(clock_s).unwrap_or_else(|| now_s() - vehicle.lag_s);
    let speed = geo.velocity.map(|[east, north, _]| east.hypot(north));
    let track = speed.zip(geo.speed_std).map(|(speed_m_s, speed_std_m_s)| CotTrack {
        course_deg: geo.course_deg,
        course_std_deg: geo.course_std_deg,
        speed_m_s,
        speed_std_m_s,
    });
    let VehicleLine { id, class, confidence, .. } = vehicle;
    CotEvent {
        uid: format!("tractrix.{title}.{id}"),
        callsign: format!("{} {id}", if class.is_empty() { "vehicle" } else { class }),
        remarks: format!("provisional, detector score {confidence:.2}"),
        time_s,
        // Three updates, of which some may be lost.
        valid_s: 3.0,
        latitude: geo.latitude,
        longitude: geo.longitude,
        height_m: geo.height,
        horizontal_std_m: geo.horizontal_std,
        vertical_std_m: geo.vertical_std,
        track,
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::super::updates::{Updates, tests::line};
    use super::*;

    #[test]
    fn an_event_is_one_datagram_and_one_line_of_a_file() {
        let receiver = UdpSocket::bind("127.0.0.1:0").unwrap();
        receiver.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("events.xml");
        let address: Target = format!("udp:{}", receiver.local_addr().unwrap()).parse().unwrap();
        let (mut updates, line) = (Updates::default(), line(4, 2.0));
        let (vehicle, geo) = updates.due(&line).unwrap();
        for target in [address, Target::File(path.clone())] {
            Cot::open(&target, "flight").unwrap().send(vehicle, geo);
        }
        let mut datagram = [0; 4096];
        let count = receiver.recv(&mut datagram).unwrap();
        let text = std::str::from_utf8(&datagram[..count]).unwrap();
        let event = text.strip_prefix(DECLARATION).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), format!("{event}\n"));
        for part in [
            "<event version=\"2.0\" uid=\"tractrix.flight.4\" type=\"a-u-G-E-V-C\" how=\"m-i\"",
            "time=\"2024-06-01T12:00:00Z\" start=\"2024-06-01T12:00:00Z\" stale=\"2024-06-01T12:00:03Z\"",
            "<point lat=\"47.123456700\" lon=\"-8.765432100\" hae=\"412.5000\" ce=\"3.2500\" le=\"6.5000\"/>",
            "<contact callsign=\"car 4\"/>",
            "<track course=\"36.8700\" speed=\"5.0000\" eCourse=\"5.0000\" eSpeed=\"0.5000\"/>",
        ] {
            assert!(event.contains(part), "{part}: {event}");
        }
        assert!(event.ends_with("</event>") && !event.contains('\n'), "{event}");
    }
}
