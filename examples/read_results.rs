//! Mean speeds of all vehicles of an output folder: `cargo run --no-default-features --example read_results OUT`.
use tractrix::io::RunFolder;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = RunFolder::at(std::env::args().nth(1).ok_or("usage: read_results OUT")?);
    for object in folder.read_trajectories()?.objects {
        let verdict = object.verdict.as_ref().map_or("not judged", |verdict| verdict.state.name());
        let speed = object.travel.and_then(|travel| travel.mean_speed_m_s).map(|speed| speed.scaled(3.6));
        let shown = speed.map_or("unknown".to_owned(), |s| format!("{:.1} ± {:.1} km/h", s.value, s.std));
        println!("{} {} ({verdict}): {shown}", object.class, object.id);
    }
    Ok(())
}
