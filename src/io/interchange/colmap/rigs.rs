//! `rigs` and `frames`, which COLMAP writes next to a model since version 3.12.
//!
//! A rig is a set of cameras that are fixed to one another, a frame their images at one time. Here every camera is a
//! rig of its own and every image a frame of its own, under the same ids: COLMAP's own default if the files are
//! missing. Older versions and other programs ignore them.

use std::io::Write;
use std::path::Path;

use crate::files;
use crate::io::IoError;
use crate::io::interchange::bytes::Bytes;
use crate::scene::Reconstruction;

/// COLMAP's number and name of a sensor that is a camera.
const CAMERA: (i32, &str) = (0, "CAMERA");

pub fn write_rigs_text(out: &mut dyn Write, model: &Reconstruction) -> std::io::Result<()> {
    writeln!(out, "# Rigs, one per line: RIG_ID NUM_SENSORS REF_SENSOR_TYPE REF_SENSOR_ID")?;
    writeln!(out, "# Number of rigs: {}", model.cameras.len())?;
    model.cameras.keys().try_for_each(|id| writeln!(out, "{} 1 {} {}", id.0, CAMERA.1, id.0))
}

pub fn write_frames_text(out: &mut dyn Write, model: &Reconstruction) -> std::io::Result<()> {
    writeln!(out, "# Frames, one per line: FRAME_ID RIG_ID QW QX QY QZ TX TY TZ NUM_DATA_IDS")?;
    writeln!(out, "# (SENSOR_TYPE SENSOR_ID DATA_ID)[]")?;
    writeln!(out, "# Number of frames: {}", model.images.len())?;
    for (id, image) in &model.images {
        let (q, t) = (image.cam_from_world.rotation, image.cam_from_world.translation);
        let camera = image.camera.0;
        write!(out, "{} {camera} {} {} {} {} {} {} {}", id.0, q.w, q.i, q.j, q.k, t.x, t.y, t.z)?;
        writeln!(out, " 1 {} {camera} {}", CAMERA.1, id.0)?;
    }
    Ok(())
}

pub fn write_rigs_binary(out: &mut dyn Write, model: &Reconstruction) -> std::io::Result<()> {
    out.write_all(&(model.cameras.len() as u64).to_le_bytes())?;
    for id in model.cameras.keys() {
        let id = id.0.to_le_bytes();
        out.write_all([id, 1u32.to_le_bytes(), CAMERA.0.to_le_bytes(), id].as_flattened())?;
    }
    Ok(())
}

pub fn write_frames_binary(out: &mut dyn Write, model: &Reconstruction) -> std::io::Result<()> {
    out.write_all(&(model.images.len() as u64).to_le_bytes())?;
    for (id, image) in &model.images {
        let (q, t) = (image.cam_from_world.rotation, image.cam_from_world.translation);
        let camera = image.camera.0.to_le_bytes();
        out.write_all([id.0.to_le_bytes(), camera].as_flattened())?;
        super::binary::write_doubles(out, &[q.w, q.i, q.j, q.k, t.x, t.y, t.z])?;
        out.write_all([1u32.to_le_bytes(), CAMERA.0.to_le_bytes(), camera].as_flattened())?;
        out.write_all(&u64::from(id.0).to_le_bytes())?;
    }
    Ok(())
}

/// Number of rigs with several sensors in a folder's model; none if the files are missing or unreadable: nothing
/// depends on it.
pub fn num_of_several(folder: &Path) -> usize {
    if folder.join("cameras.bin").exists() {
        several_in_binary(&folder.join("rigs.bin")).unwrap_or(0)
    } else {
        files::read_text(&folder.join("rigs.txt")).map_or(0, |text| several_in_text(&String::from_utf8_lossy(&text)))
    }
}

fn several_in_text(text: &str) -> usize {
    let lines = text.lines().filter(|line| !line.trim_start().starts_with('#'));
    let sensors = lines.filter_map(|line| line.split_whitespace().nth(1)?.parse::<u32>().ok());
    sensors.filter(|count| *count > 1).count()
}

fn several_in_binary(path: &Path) -> Result<usize, IoError> {
    let content = Bytes::read_file(path)?;
    let mut bytes = content.cursor();
    let mut several = 0;
    for _ in 0..bytes.count("number of rigs", 8)? {
        bytes.u32("rig id")?;
        let sensors = bytes.u32("number of sensors")?;
        for k in 0..sensors {
            bytes.array::<8>("sensor")?;
            if k > 0 && bytes.u8("pose flag")? != 0 {
                bytes.array::<{ 7 * 8 }>("pose of a sensor")?;
            }
        }
        several += usize::from(sensors > 1);
    }
    Ok(several)
}
