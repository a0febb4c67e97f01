//! Vehicles that nobody points out: found by their motion, their pixels by colours or by the mask network.

mod common;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use common::{Place, drive, outcome, tractrix};

const NUM_FRAMES: u32 = 24;

impl Place {
    /// A run without masks; gives what it says.
    fn run(&self, output: &str, flags: &[&str]) -> String {
        let mut command = tractrix();
        command.arg("run").arg(self.path("images")).arg("--output").arg(self.path(output)).args(["--fps", "10"]);
        command.arg("--intrinsics").arg(drive::intrinsics()).args(["--detector", "none"]).args(flags);
        let (code, stdout, stderr) = outcome(&mut command);
        assert_eq!(code, 0, "{stdout}{stderr}");
        stderr
    }

    fn tracks(&self, output: &str) -> serde_json::Value {
        serde_json::from_slice(&fs::read(self.path(output).join("tracks.json")).unwrap()).unwrap()
    }

    /// Mean overlap (intersection over union) of an object's masks with the truth, over all frames.
    fn overlap(&self, output: &str, id: u64) -> f64 {
        let of_frame = |k: u32| {
            let mask = self.path(output).join(format!("tracks/{id}/{k:04}.png.png"));
            let Ok(mask) = image::open(mask) else { return 0.0 };
            let truth = image::open(self.path(&format!("masks/{k:04}.png"))).unwrap().to_luma8();
            let pairs: Vec<(bool, bool)> =
                mask.to_luma8().pixels().zip(truth.pixels()).map(|(a, b)| (a.0[0] > 0, b.0[0] > 0)).collect();
            let count = |is: fn(&(bool, bool)) -> bool| pairs.iter().filter(|pair| is(pair)).count() as f64;
            count(|&(a, b)| a && b) / count(|&(a, b)| a || b).max(1.0)
        };
        (0..NUM_FRAMES).map(of_frame).sum::<f64>() / f64::from(NUM_FRAMES)
    }

    fn masks(&self, output: &str) -> BTreeMap<PathBuf, Vec<u8>> {
        let mut files = BTreeMap::new();
        collect(&self.path(output).join("tracks"), &mut files);
        let base = self.path(output);
        files.into_iter().map(|(path, bytes)| (path.strip_prefix(&base).unwrap().to_owned(), bytes)).collect()
    }
}

fn collect(folder: &Path, files: &mut BTreeMap<PathBuf, Vec<u8>>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        match path.is_dir() {
            true => collect(&path, files),
            false => drop(files.insert(path.clone(), fs::read(&path).unwrap())),
        }
    }
}

#[test]
fn a_vehicle_without_a_class_is_found_because_it_moves() {
    let place = Place::new(NUM_FRAMES);
    let said = place.run("out", &["--mask-network", "none"]);
    assert!(said.contains("masks are coarse"), "{said}");
    let tracks = place.tracks("out");
    let [object] = &tracks["objects"].as_array().unwrap()[..] else { panic!("one vehicle: {tracks}") };
    assert_eq!((&object["class"], &object["outline"]), (&"vehicle".into(), &"coarse".into()), "{object}");
    assert_eq!(object["movement"]["state"], "moving", "{object}");
    assert!(object["found_in"]["motion"].as_u64() >= Some(u64::from(NUM_FRAMES) / 2), "{object}");
    assert_eq!(object["found_in"]["detector"], 0);
    assert!(place.overlap("out", 1) > 0.6, "{}", place.overlap("out", 1));
    let trajectories = fs::read_to_string(place.path("out/trajectories.json")).unwrap();
    assert!(trajectories.contains("\"id\": 1"), "{trajectories}");
    // The same again, with other threads, gives the same bytes.
    place.run("again", &["--mask-network", "none", "--threads", "1"]);
    assert_eq!(place.masks("out"), place.masks("again"));
}

#[test]
fn without_detector_and_motion_there_is_no_vehicle() {
    let place = Place::new(NUM_FRAMES);
    let said = place.run("out", &["--mask-network", "none", "--motion", "off"]);
    assert!(said.contains("no vehicle tracked"), "{said}");
    assert!(place.tracks("out")["objects"].as_array().unwrap().is_empty());
}
