//! Vehicles for other programs: provisional georeferenced positions, one per vehicle and second, and where they go.

use std::collections::BTreeMap;
use std::fmt;
use std::io;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, ToSocketAddrs, UdpSocket};
use std::str::FromStr;
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::{Context, anyhow};

use crate::live::{GeoPosition, Line, State, VehicleLine};
use crate::scene::ObjectId;

/// Least time between two updates of a vehicle, seconds: one second, with rounded time stamps.
const PERIOD_S: f64 = 0.99;
/// Time after which a vehicle that is not seen is forgotten, seconds.
const FORGOTTEN_S: f64 = 60.0;

/// Clock of the computer, seconds after 1970.
pub(super) fn now_s() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |now| now.as_secs_f64())
}

/// Chooses the lines that are sent.
#[derive(Debug, Default)]
pub(super) struct Updates {
    last_s: BTreeMap<ObjectId, f64>,
}

impl Updates {
    /// The vehicle and its position, if a line has one that is due. A final line comes seconds after the provisional
    /// ones: a program that shows the latest position would jump back.
    pub(super) fn due<'a>(&mut self, line: &'a Line) -> Option<(&'a VehicleLine, &'a GeoPosition)> {
        let Line::Vehicle(vehicle) = line else { return None };
        let geo = vehicle.geo.as_deref().filter(|_| vehicle.state == State::Provisional)?;
        let is_early = |last: &f64| vehicle.t - last < PERIOD_S;
        if self.last_s.get(&vehicle.id).is_some_and(is_early) {
            return None;
        }
        self.last_s.retain(|_, last| vehicle.t - *last < FORGOTTEN_S);
        self.last_s.insert(vehicle.id, vehicle.t);
        Some((vehicle, geo))
    }
}

/// An address for datagrams: `udp:HOST:PORT`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct UdpAddress(String);

impl FromStr for UdpAddress {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let address = text.strip_prefix("udp:").map(|rest| rest.strip_prefix("//").unwrap_or(rest));
        let is_whole = |address: &&str| {
            let parts = address.rsplit_once(':');
            parts.is_some_and(|(host, port)| !host.is_empty() && port.parse().is_ok_and(|port: u16| port > 0))
        };
        let found = address.filter(is_whole);
        found.map(|address| Self(address.to_owned())).ok_or_else(|| format!("'{text}': expected udp:HOST:PORT"))
    }
}

impl fmt::Display for UdpAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "udp:{}", self.0)
    }
}

impl UdpAddress {
    /// A socket that sends to this address alone.
    pub(super) fn open(&self) -> anyhow::Result<UdpSocket> {
        let address = self.0.to_socket_addrs().with_context(|| format!("{self}: unknown host"))?.next();
        let address = address.ok_or_else(|| anyhow!("{self}: unknown host"))?;
        let any: SocketAddr = match address {
            SocketAddr::V4(_) => (Ipv4Addr::UNSPECIFIED, 0).into(),
            SocketAddr::V6(_) => (Ipv6Addr::UNSPECIFIED, 0).into(),
        };
        let opened = UdpSocket::bind(any).and_then(|socket| socket.connect(address).map(|()| socket));
        let socket = opened.with_context(|| format!("{self}: cannot be opened"))?;
        // A full buffer must not delay the frames.
        socket.set_nonblocking(true).with_context(|| format!("{self}: cannot be opened"))?;
        Ok(socket)
    }
}

/// A receiver of updates. It must not stop the recording: what fails is reported once.
#[derive(Debug)]
pub(super) struct Health {
    name: String,
    has_failed: bool,
}

impl Health {
    pub(super) fn of(name: impl fmt::Display) -> Self {
        Self { name: name.to_string(), has_failed: false }
    }

    /// Reports the first failure. Nobody who listens is none: a receiver may come later.
    pub(super) fn note(&mut self, result: io::Result<()>) {
        let Err(error) = result else { return };
        let is_harmless = matches!(error.kind(), io::ErrorKind::ConnectionRefused | io::ErrorKind::WouldBlock);
        if !is_harmless && !std::mem::replace(&mut self.has_failed, true) {
            tracing::error!("{}: updates are lost: {error}", self.name);
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::live::{LengthUnit, MotionState, PositionMethod};

    /// A vehicle that drives to the north-east.
    pub(in super::super) fn line(id: u32, t: f64) -> Line {
        Line::Vehicle(VehicleLine {
            t,
            utc: Some("2024-06-01T12:00:00Z".to_owned()),
            frame: 7,
            id: ObjectId(id),
            class: "car".to_owned(),
            confidence: 0.8,
            state: State::Provisional,
            revision: 3,
            rect: [10.0, 20.0, 60.0, 50.0],
            unit: LengthUnit::M,
            method: Some(PositionMethod::GroundContact),
            position: Some([1.0, 2.0, 0.0]),
            covariance: Some([1.0, 0.0, 0.0, 1.0, 0.0, 1.0]),
            motion: Some(MotionState::Moving),
            geo: Some(Box::new(GeoPosition {
                latitude: 47.123_456_7,
                longitude: -8.765_432_1,
                height: Some(412.5),
                horizontal_std: 3.25,
                vertical_std: Some(6.5),
                distance: 55.5,
                velocity: Some([3.0, 4.0, 0.25]),
                speed_std: Some(0.5),
                course_deg: Some(36.87),
                course_std_deg: Some(5.0),
            })),
            reason: None,
            velocity: Some([4.0, 3.0, 0.25]),
            speed_std: Some(0.5),
            heading_deg: Some(53.13),
            heading_std_deg: Some(4.0),
            lag_s: 0.25,
        })
    }

    #[test]
    fn a_vehicle_is_sent_once_a_second() {
        let mut updates = Updates::default();
        let mut sent = Vec::new();
        for k in 0..40u32 {
            let lines = [line(1, 0.1 * f64::from(k)), line(2, 0.1 * f64::from(k))];
            sent.extend(lines.iter().filter_map(|line| updates.due(line).map(|(vehicle, _)| vehicle.id.0)));
        }
        assert_eq!(sent, [1, 2, 1, 2, 1, 2, 1, 2]);
        let Line::Vehicle(vehicle) = line(3, 9.0) else { panic!() };
        let of = |vehicle: VehicleLine| Updates::default().due(&Line::Vehicle(vehicle)).is_some();
        assert!(of(vehicle.clone()));
        assert!(
            !of(VehicleLine { state: State::Final, ..vehicle.clone() }) && !of(VehicleLine { geo: None, ..vehicle })
        );
    }

    #[test]
    fn addresses_have_host_and_port() {
        let of = |text: &str| text.parse::<UdpAddress>().map(|address| address.to_string());
        assert_eq!(of("udp:127.0.0.1:14550").as_deref(), Ok("udp:127.0.0.1:14550"));
        assert_eq!(of("udp://[::1]:6969").as_deref(), Ok("udp:[::1]:6969"));
        for wrong in ["127.0.0.1:14550", "udp:127.0.0.1", "udp::14550", "udp:host:0", "tcp:host:1"] {
            assert!(of(wrong).is_err_and(|error| error.contains("udp:HOST:PORT")), "{wrong}");
        }
    }
}
