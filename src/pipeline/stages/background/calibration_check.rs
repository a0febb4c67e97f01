//! Evidence against given intrinsics.

use super::ModelReport;
use crate::camera::Camera;
use crate::mapper::{self, CalibrationFit, Intrinsics};
use crate::pipeline::Result;
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::inputs::cameras::{self, CameraOrigin};
use crate::scene::{CameraId, Reconstruction, Topic, Warning};

/// Largest field of view that a pinhole model with radial distortion describes, degrees.
const MAX_FIELD_DEG: f64 = 150.0;
/// Smallest field of view of a lens, degrees: that of a telescope.
const MIN_FIELD_DEG: f64 = 0.5;
/// Field of view below which a lens is a strong telephoto lens, degrees; more often the focal length is wrong.
const NARROW_FIELD_DEG: f64 = 10.0;
/// Maximum ratio of fx and fy: the strongest anamorphic lenses have 2.
const MAX_ASPECT: f64 = 2.5;
/// Ratio of fx and fy from which a lens is anamorphic.
const ODD_ASPECT: f64 = 1.1;
/// Distance of the principal point from the image center, as a share of the side, from which the image was cropped.
const ODD_CENTRE: f64 = 0.25;

/// Returns the problem of an implausible camera and its remedy; `None` for a plausible one.
pub(in crate::pipeline) fn impossible(camera: &Camera) -> Option<String> {
    let (field_deg, picture) = (field_deg(camera), picture(camera));
    if !(MIN_FIELD_DEG..=MAX_FIELD_DEG).contains(&field_deg) {
        return Some(format!(
            "--intrinsics: focal length {:.1} px in images of {picture} gives a field of view of {field_deg:.0}°, \
             impossible for such a lens; give focal lengths in pixels of the source, not in millimeters",
            camera.mean_focal()
        ));
    }
    let [cx, cy] = camera.principal;
    if !(0.0..=f64::from(camera.width)).contains(&cx) || !(0.0..=f64::from(camera.height)).contains(&cy) {
        return Some(format!(
            "--intrinsics: principal point ({cx:.1}, {cy:.1}) outside the image of {picture}; give cx and cy in pixels \
             of the source, as fx,fy,cx,cy"
        ));
    }
    let aspect = aspect(camera);
    (aspect > MAX_ASPECT).then(|| {
        let [fx, fy] = camera.focal;
        format!("--intrinsics: fx {fx:.1} and fy {fy:.1} differ too much; give them as fx,fy,cx,cy")
    })
}

/// Anomalies of a plausible camera.
pub(in crate::pipeline) fn doubts(camera: &Camera) -> Vec<Warning> {
    let mut doubts = Vec::new();
    let (field_deg, aspect) = (field_deg(camera), aspect(camera));
    if field_deg < NARROW_FIELD_DEG {
        doubts.push(format!(
            "--intrinsics: field of view {field_deg:.1}°, that of a strong telephoto lens; otherwise the focal length \
             is wrong (it is in pixels of the source)"
        ));
    }
    if aspect > ODD_ASPECT {
        let [fx, fy] = camera.focal;
        doubts.push(format!(
            "--intrinsics: fx {fx:.1} and fy {fy:.1} differ; correct only for a stretched image or an anamorphic lens"
        ));
    }
    let off = |centre: f64, side: u32| (centre / f64::from(side) - 0.5).abs();
    let [cx, cy] = camera.principal;
    if off(cx, camera.width).max(off(cy, camera.height)) > ODD_CENTRE {
        doubts.push(format!(
            "--intrinsics: principal point ({cx:.1}, {cy:.1}) far from the center of the image of {}; correct only for \
             an image cropped from a larger one",
            picture(camera)
        ));
    }
    doubts.into_iter().map(|doubt: String| Topic::IntrinsicsDoubtful.warning(doubt)).collect()
}

/// The given calibrations of a model's cameras: those of the options, or those of a given model.
fn given(run: &Run, model: &Reconstruction, is_given: bool) -> Result<Vec<(CameraId, Camera)>> {
    if is_given {
        return Ok(model.cameras.iter().map(|(id, camera)| (*id, *camera)).collect());
    }
    let initial = (1..).map(CameraId).zip(cameras::initial(run)?);
    let given = initial.filter(|(_, initial)| initial.origin == CameraOrigin::Given);
    Ok(given.map(|(id, initial)| (id, initial.camera)).collect())
}

/// Compares given calibrations with a model, warns of those that do not fit, and records the standard deviation of the
/// focal length of a given model.
///
/// # Errors
/// Those of reading the calibrations and of starting threads.
pub(super) fn check_fit(
    run: &Run,
    model: &Reconstruction,
    report: &mut ModelReport,
    outcome: &mut Outcome,
) -> Result<()> {
    let std = run.options.intrinsics_std;
    // Fixed intrinsics are compared, too.
    let known = if std.is_fixed() { Intrinsics::GIVEN } else { std };
    let first = model.cameras.keys().next();
    for (id, camera) in &given(run, model, report.given)? {
        // A model that leaves the intrinsics undetermined is no evidence against any.
        let Ok(Some(fit)) = mapper::calibration_fit(model, *id, camera, known) else { continue };
        if fit.is_bad() {
            outcome.warn(Topic::CalibrationDoesNotFit.warning(misfit(camera, &fit, remedy(report.given, &std))));
        }
        if first == Some(id) {
            let CalibrationFit { given_px, adjusted_px, gain, change, .. } = fit;
            let figures = serde_json::json!({
                "given_px": given_px, "adjusted_px": adjusted_px, "gain": gain, "change": change,
            });
            outcome.figure("calibration_fit", figures);
            if report.given && !std.is_fixed() {
                report.focal_std_px = Some(fit.focal_std * camera.mean_focal());
            }
        }
    }
    Ok(())
}

fn remedy(is_model_given: bool, std: &Intrinsics) -> &'static str {
    match (is_model_given, std.is_fixed()) {
        (true, _) => "the model is used unchanged; adjust its intrinsics in the program that made it",
        (false, true) => "remove --fixed",
        (false, false) => "the adjusted one is used; calibrate this lens in this video mode, or remove --intrinsics",
    }
}

fn misfit(given: &Camera, fit: &CalibrationFit, remedy: &str) -> String {
    let CalibrationFit { given_px, adjusted_px, adjusted, .. } = fit;
    let shown = |camera: &Camera| {
        let [cx, cy] = camera.principal;
        format!("f {:.1}, center {cx:.1}, {cy:.1}, k1 {:.3}", camera.mean_focal(), camera.radial[0])
    };
    format!(
        "the given calibration does not fit: {given_px:.3} px, adjusted {adjusted_px:.3} px ({} → {}); {remedy}",
        shown(given),
        shown(adjusted)
    )
}

/// Field of view across the longer side of the image.
fn field_deg(camera: &Camera) -> f64 {
    let half = f64::from(camera.width.max(camera.height)) / 2.0;
    2.0 * half.atan2(camera.mean_focal()).to_degrees()
}

fn aspect(camera: &Camera) -> f64 {
    let [fx, fy] = camera.focal;
    (fx / fy).max(fy / fx)
}

fn picture(camera: &Camera) -> String {
    format!("{}x{} pixels", camera.width, camera.height)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(values: [f64; 4]) -> Camera {
        let [fx, fy, cx, cy] = values;
        Camera::prior(960, 540).with_intrinsics([fx, fy, cx, cy, 0.0, 0.0])
    }

    #[test]
    fn implausible_cameras_are_rejected() {
        let cases = [
            ([5.0, 5.0, 480.0, 270.0], "field of view of 179°"),
            ([880.0, 880.0, 4800.0, 270.0], "outside the image of 960x540"),
            ([880.0, 88.0, 480.0, 270.0], "differ too much"),
        ];
        for (values, expected) in cases {
            let reason = impossible(&camera(values)).unwrap();
            assert!(reason.contains(expected) && reason.contains("--intrinsics"), "{reason}");
        }
    }

    #[test]
    fn unusual_cameras_give_warnings() {
        let plain = camera([880.0, 880.0, 480.0, 270.0]);
        assert_eq!((impossible(&plain), doubts(&plain)), (None, Vec::new()));
        for (values, expected) in [
            ([9000.0, 9000.0, 480.0, 270.0], "telephoto"),
            ([880.0, 660.0, 480.0, 270.0], "anamorphic"),
            ([880.0, 880.0, 900.0, 270.0], "cropped"),
        ] {
            let odd = camera(values);
            assert_eq!(impossible(&odd), None);
            let said = doubts(&odd);
            assert!(said.len() == 1 && said[0].text.contains(expected), "{said:?}");
        }
    }
}
