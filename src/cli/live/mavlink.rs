//! MAVLink while the camera records: `CAMERA_TRACKING_GEO_STATUS` (message 276), one per vehicle and second.

use std::net::UdpSocket;

use mavlink::dialects::common::{CAMERA_TRACKING_GEO_STATUS_DATA, CameraTrackingStatusFlags, MavMessage};
use mavlink::{MavHeader, write_v2_msg};

use super::updates::{Health, UdpAddress};
use crate::live::{GeoPosition, VehicleLine};

/// Sends messages.
pub(super) struct Mavlink {
    socket: UdpSocket,
    health: Health,
    sequence: u8,
}

impl Mavlink {
    /// # Errors
    /// An address that cannot be resolved.
    pub(super) fn open(address: &UdpAddress) -> anyhow::Result<Self> {
        Ok(Self { socket: address.open()?, health: Health::of(address), sequence: 0 })
    }

    pub(super) fn send(&mut self, vehicle: &VehicleLine, geo: &GeoPosition) {
        // The system is the vehicle which carries the camera; component id MAV_COMP_ID_CAMERA.
        let header = MavHeader { system_id: 1, component_id: 100, sequence: self.sequence };
        self.sequence = self.sequence.wrapping_add(1);
        let mut packet = Vec::new();
        let written = write_v2_msg(&mut packet, header, &MavMessage::CAMERA_TRACKING_GEO_STATUS(message(vehicle, geo)));
        let sent = written.map_err(std::io::Error::other).and_then(|_| self.socket.send(&packet).map(drop));
        self.health.note(sent);
    }
}

/// The message of a vehicle; NaN is unknown. The message has no field for an identity: the id of the camera's device
/// serves, 0 above 255.
fn message(vehicle: &VehicleLine, geo: &GeoPosition) -> CAMERA_TRACKING_GEO_STATUS_DATA {
    let known = |value: Option<f64>| value.map_or(f32::NAN, |value| value as f32);
    let [east, north, up] = geo.velocity.map_or([None; 3], |velocity| velocity.map(Some));
    // −π to π.
    let heading = geo.course_deg.map(|course| (course - 360.0 * (course / 360.0).round()).to_radians());
    CAMERA_TRACKING_GEO_STATUS_DATA {
        lat: (1e7 * geo.latitude).round() as i32,
        lon: (1e7 * geo.longitude).round() as i32,
        alt: known(geo.height),
        h_acc: geo.horizontal_std as f32,
        v_acc: known(geo.vertical_std),
        vel_n: known(north),
        vel_e: known(east),
        vel_d: known(up.map(|up| -up)),
        vel_acc: known(geo.speed_std),
        dist: geo.distance as f32,
        hdg: known(heading),
        hdg_acc: known(geo.course_std_deg.map(f64::to_radians)),
        tracking_status: CameraTrackingStatusFlags::CAMERA_TRACKING_STATUS_FLAGS_ACTIVE,
        camera_device_id: u8::try_from(vehicle.id.0).unwrap_or(0),
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::super::updates::{Updates, tests::line};
    use super::*;

    /// CRC-16/MCRF4XX, as the specification of MAVLink has it.
    fn checksum(bytes: &[u8], extra: u8) -> u16 {
        bytes.iter().chain([&extra]).fold(0xffff, |sum: u16, byte| {
            let mut value = byte ^ (sum & 0xff) as u8;
            value ^= value << 4;
            let value = u16::from(value);
            (sum >> 8) ^ (value << 8) ^ (value << 3) ^ (value >> 4)
        })
    }

    #[test]
    fn a_packet_has_the_layout_of_the_specification() {
        let receiver = UdpSocket::bind("127.0.0.1:0").unwrap();
        receiver.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
        let address = format!("udp:{}", receiver.local_addr().unwrap()).parse().unwrap();
        let mut sender = Mavlink::open(&address).unwrap();
        for k in 0..2 {
            let (mut updates, line) = (Updates::default(), line(4, 2.0));
            let (vehicle, geo) = updates.due(&line).unwrap();
            sender.send(vehicle, geo);
            let mut packet = [0; 300];
            let count = receiver.recv(&mut packet).unwrap();
            let packet = &packet[..count];
            // Start, length, flags, sequence, system, component, message: 276 is 0x000114.
            assert_eq!(packet[..10], [0xfd, 50, 0, 0, k, 1, 100, 0x14, 0x01, 0]);
            let payload = &packet[10..60];
            let integer = |at: usize| i32::from_le_bytes(payload[at..at + 4].try_into().unwrap());
            let float = |at: usize| f32::from_le_bytes(payload[at..at + 4].try_into().unwrap());
            assert_eq!((integer(0), integer(4)), (471_234_567, -87_654_321));
            let floats: Vec<f32> = (2..12).map(|field| float(4 * field)).collect();
            let expected = [412.5, 3.25, 6.5, 4.0, 3.0, -0.25, 0.5, 55.5, 36.87f32.to_radians(), 5f32.to_radians()];
            assert!(floats.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5), "{floats:?}");
            assert_eq!((payload[48], payload[49]), (1, 4));
            assert_eq!(packet[60..], checksum(&packet[1..60], 18).to_le_bytes());
        }
    }

    #[test]
    fn unknown_values_are_no_numbers() {
        let crate::live::Line::Vehicle(vehicle) = line(300, 0.0) else { panic!() };
        let known = *vehicle.geo.clone().unwrap();
        let geo = GeoPosition { height: None, vertical_std: None, velocity: None, course_deg: None, ..known };
        let found = message(&vehicle, &geo);
        assert!([found.alt, found.v_acc, found.vel_n, found.vel_d, found.hdg].iter().all(|value| value.is_nan()));
        assert_eq!(found.camera_device_id, 0);
    }
}
