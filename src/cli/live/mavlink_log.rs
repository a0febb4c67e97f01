//! Telemetry as MAVLink: the positions of an autopilot become the lines of a table, which a run reads as well.

use mavlink::dialects::common::{
    GIMBAL_DEVICE_ATTITUDE_STATUS_DATA, GLOBAL_POSITION_INT_DATA, GPS_RAW_INT_DATA, GimbalDeviceFlags, GpsFixType,
    MavMessage,
};
use mavlink::{MAV_STX, MAV_STX_V2, MavHeader};
use nalgebra::{Quaternion, UnitQuaternion};

use crate::telemetry::date;

/// First line of the table.
pub(super) const HEADER: &str = "utc,latitude,longitude,altitude,relative_height,horizontal_std,vertical_std,\
                                 gimbal_yaw,gimbal_pitch,gimbal_roll\n";

/// Returns true if a log begins like a packet of MAVLink 1 or 2.
pub(super) fn is_mavlink(head: &[u8]) -> bool {
    matches!(head.first(), Some(&MAV_STX | &MAV_STX_V2))
}

/// The latest values of what messages state apart.
#[derive(Default)]
pub(super) struct Table {
    /// The system whose positions are taken: the first that sends one.
    system: Option<u32>,
    /// Universal time at which the autopilot's clock began, seconds after 1970.
    booted_s: Option<f64>,
    has_no_fix: bool,
    /// Horizontal and vertical, meters.
    std_m: [Option<f64>; 2],
    /// Yaw, pitch and roll, degrees.
    gimbal_deg: Option<[f64; 3]>,
    heading_deg: f64,
}

impl Table {
    /// Takes a message; gives the line of a position.
    ///
    /// * `now_s` – computer's clock, seconds after 1970: the time of a log that does not state its own.
    pub(super) fn line(&mut self, header: MavHeader, message: &MavMessage, now_s: f64) -> Option<String> {
        // MAV_COMP_ID_AUTOPILOT1.
        let is_autopilot = header.component_id == 1;
        match message {
            MavMessage::SYSTEM_TIME(time) if is_autopilot && time.time_unix_usec > 0 => {
                self.booted_s = Some(1e-6 * time.time_unix_usec as f64 - 1e-3 * f64::from(time.time_boot_ms));
            }
            MavMessage::GPS_RAW_INT(found) if is_autopilot => self.note_receiver(found),
            MavMessage::GIMBAL_DEVICE_ATTITUDE_STATUS(gimbal) => self.note_gimbal(gimbal),
            MavMessage::GLOBAL_POSITION_INT(position) if is_autopilot => {
                let is_first = *self.system.get_or_insert(header.system_id) == header.system_id;
                return is_first.then(|| self.position(position, now_s)).flatten();
            }
            _ => {}
        }
        None
    }

    fn note_receiver(&mut self, found: &GPS_RAW_INT_DATA) {
        use GpsFixType::{GPS_FIX_TYPE_2D_FIX, GPS_FIX_TYPE_NO_FIX, GPS_FIX_TYPE_NO_GPS};
        self.has_no_fix = matches!(found.fix_type, GPS_FIX_TYPE_NO_GPS | GPS_FIX_TYPE_NO_FIX | GPS_FIX_TYPE_2D_FIX);
        let known = |mm: u32| (mm > 0 && mm < u32::MAX).then(|| 1e-3 * f64::from(mm));
        self.std_m = [known(found.h_acc), known(found.v_acc)];
    }

    fn note_gimbal(&mut self, gimbal: &GIMBAL_DEVICE_ATTITUDE_STATUS_DATA) {
        let [w, x, y, z] = gimbal.q.map(f64::from);
        let Some(attitude) = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-3) else { return };
        let (roll, pitch, yaw) = attitude.euler_angles();
        // Without a statement of the frame, a lock of the yaw says that it is the earth's.
        let states = GimbalDeviceFlags::GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME
            | GimbalDeviceFlags::GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME;
        let of_earth = match gimbal.flags.intersects(states) {
            true => GimbalDeviceFlags::GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME,
            false => GimbalDeviceFlags::GIMBAL_DEVICE_FLAGS_YAW_LOCK,
        };
        let heading = if gimbal.flags.contains(of_earth) { 0.0 } else { self.heading_deg };
        self.gimbal_deg = Some([yaw.to_degrees() + heading, pitch.to_degrees(), roll.to_degrees()]);
    }

    fn position(&mut self, found: &GLOBAL_POSITION_INT_DATA, now_s: f64) -> Option<String> {
        // Where the heading is unknown.
        if found.hdg != u16::MAX {
            self.heading_deg = 0.01 * f64::from(found.hdg);
        }
        // An autopilot without a position sends zeros.
        if self.has_no_fix || (found.lat, found.lon) == (0, 0) {
            return None;
        }
        let boot_s = 1e-3 * f64::from(found.time_boot_ms);
        let utc = date(boot_s + *self.booted_s.get_or_insert(now_s - boot_s), true)?;
        let [latitude, longitude] = [found.lat, found.lon].map(|angle| 1e-7 * f64::from(angle));
        let [altitude, relative] = [found.alt, found.relative_alt].map(|height| 1e-3 * f64::from(height));
        let shown = |value: Option<f64>| value.map(|value| format!("{value:.3}")).unwrap_or_default();
        let [horizontal, vertical] = self.std_m.map(shown);
        let [yaw, pitch, roll] = match self.gimbal_deg {
            Some(angles) => angles.map(|angle| shown(Some(angle))),
            None => Default::default(),
        };
        let place = format!("{utc},{latitude:.7},{longitude:.7},{altitude:.3},{relative:.3}");
        Some(format!("{place},{horizontal},{vertical},{yaw},{pitch},{roll}\n"))
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use mavlink::dialects::common::SYSTEM_TIME_DATA;

    use super::*;
    use crate::telemetry::{clock_s, read_bytes};

    const FROM_AUTOPILOT: MavHeader = MavHeader { system_id: 3, component_id: 1, sequence: 0 };

    fn position() -> GLOBAL_POSITION_INT_DATA {
        GLOBAL_POSITION_INT_DATA {
            time_boot_ms: 60_500,
            lat: 471_234_567,
            lon: -87_654_321,
            alt: 512_250,
            relative_alt: 40_125,
            hdg: 9_000,
            ..Default::default()
        }
    }

    /// Lines that a new table gives for messages of an autopilot.
    fn lines(messages: &[MavMessage]) -> Vec<String> {
        let mut table = Table::default();
        messages.iter().filter_map(|message| table.line(FROM_AUTOPILOT, message, 1_700_000_100.0)).collect()
    }

    /// Attitude of a gimbal: roll, pitch and yaw, degrees.
    fn gimbal(angles_deg: [f64; 3], flags: GimbalDeviceFlags) -> MavMessage {
        let [roll, pitch, yaw] = angles_deg.map(f64::to_radians);
        let q = UnitQuaternion::from_euler_angles(roll, pitch, yaw).into_inner();
        let q = [q.w, q.i, q.j, q.k].map(|value| value as f32);
        MavMessage::GIMBAL_DEVICE_ATTITUDE_STATUS(GIMBAL_DEVICE_ATTITUDE_STATUS_DATA { q, flags, ..Default::default() })
    }

    #[test]
    fn a_run_reads_the_table() {
        let receiver = GPS_RAW_INT_DATA {
            fix_type: GpsFixType::GPS_FIX_TYPE_3D_FIX,
            h_acc: 1_200,
            v_acc: u32::MAX,
            ..Default::default()
        };
        let time = SYSTEM_TIME_DATA { time_unix_usec: 1_717_243_200_000_000, time_boot_ms: 60_000 };
        let found = lines(&[
            MavMessage::SYSTEM_TIME(time),
            MavMessage::GPS_RAW_INT(receiver),
            MavMessage::GLOBAL_POSITION_INT(position()),
            gimbal([0.0, -45.0, 10.0], GimbalDeviceFlags::empty()),
            MavMessage::GLOBAL_POSITION_INT(GLOBAL_POSITION_INT_DATA { time_boot_ms: 61_500, ..position() }),
        ]);
        let table = format!("{HEADER}{}", found.concat());
        let log = read_bytes(table.as_bytes(), Path::new("recording.csv")).unwrap();
        assert_eq!((log.fixes.len(), log.num_passed_over), (2, 0), "{:?}", log.passed_over);
        let [first, second] = [&log.fixes[0], &log.fixes[1]];
        assert_eq!(first.clock_s, clock_s("2024-06-01T12:00:00.5Z"));
        assert!((first.latitude_deg - 47.123_456_7).abs() < 1e-9 && first.gimbal.is_none());
        assert_eq!((first.gps_height_m, first.relative_height_m), (Some(512.25), Some(40.125)));
        assert_eq!(first.horizontal_std_m, 1.2);
        let [yaw, pitch] = second.gimbal.map(|angles| [angles.yaw, angles.pitch].map(f64::to_degrees)).unwrap();
        assert!((yaw - 100.0).abs() < 2e-3 && (pitch + 45.0).abs() < 2e-3, "{yaw} {pitch}");
    }

    #[test]
    fn what_is_no_position_gives_no_line() {
        let nowhere = GLOBAL_POSITION_INT_DATA { lat: 0, lon: 0, ..position() };
        assert!(lines(&[MavMessage::GLOBAL_POSITION_INT(nowhere)]).is_empty());
        let without_fix = GPS_RAW_INT_DATA { fix_type: GpsFixType::GPS_FIX_TYPE_NO_FIX, ..Default::default() };
        let messages = [MavMessage::GPS_RAW_INT(without_fix), MavMessage::GLOBAL_POSITION_INT(position())];
        assert!(lines(&messages).is_empty());
        let mut table = Table::default();
        let mut line = |header| table.line(header, &MavMessage::GLOBAL_POSITION_INT(position()), 0.0);
        assert!(line(MavHeader { component_id: 100, ..FROM_AUTOPILOT }).is_none(), "a camera");
        assert!(line(FROM_AUTOPILOT).is_some());
        assert!(line(MavHeader { system_id: 4, ..FROM_AUTOPILOT }).is_none(), "another system");
    }

    #[test]
    fn a_gimbal_that_follows_the_vehicle_has_its_heading() {
        for (flags, heading) in [
            (GimbalDeviceFlags::GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME, 90.0),
            (GimbalDeviceFlags::GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME, 0.0),
            (GimbalDeviceFlags::GIMBAL_DEVICE_FLAGS_YAW_LOCK, 0.0),
            (GimbalDeviceFlags::empty(), 90.0),
        ] {
            let position = MavMessage::GLOBAL_POSITION_INT(position());
            let found = lines(&[position.clone(), gimbal([5.0, -30.0, 6.0], flags), position]);
            let angles: Vec<f64> = found[1].trim_end().split(',').skip(7).map(|cell| cell.parse().unwrap()).collect();
            let expected = [6.0 + heading, -30.0, 5.0];
            assert!(angles.iter().zip(expected).all(|(a, b)| (a - b).abs() < 2e-3), "{flags:?}: {angles:?}");
        }
    }
}
