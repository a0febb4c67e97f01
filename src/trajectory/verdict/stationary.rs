//! Error of the models of stationary vehicles, and the bound that it gives for moving ones.
//!
//! The camera path seen from the model of a stationary vehicle is that seen from the background. The residual is the
//! error of the model, and a moving vehicle that is as large in the image has a model of the same quality.

use super::scale::{GOOD_STD, WEAK_STD};
use super::{Candidate, HALF, Measures, SMALL, percent};
use crate::math::median;
use crate::scene::ReasonKind::{Movement as MovementKind, Path};
use crate::scene::{Movement, Reason};

/// Factor by which sides of vehicles in the image may differ for their models to be alike.
const ALIKE: f64 = 1.5;

/// Residual of a stationary vehicle's model, as a share of its distance, and the vehicle's longer side in the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ModelError {
    residual: f64,
    pixels: f64,
}

/// Residuals of all stationary vehicles whose ratio comes from the camera path.
pub(super) fn model_errors(candidates: &[Candidate], measures: &[Measures]) -> Vec<ModelError> {
    let error = |(candidate, measures): (&Candidate, &Measures)| {
        let residual = candidate.trajectory.scale.camera_path?.residual;
        Some(ModelError { residual, pixels: measures.pixels? })
    };
    candidates.iter().zip(measures).filter_map(error).collect()
}

/// Checks a vehicle's model by the camera path: by its own residual, or by those of stationary vehicles of its size.
pub(super) fn model(candidate: &Candidate, measures: &Measures, errors: &[ModelError]) -> Option<Reason> {
    if let Some(path) = candidate.trajectory.scale.camera_path {
        let said = format!("model of a stationary vehicle: RMS residual {} of the distance", percent(path.residual));
        return Some(match path.residual {
            residual if residual > WEAK_STD => Reason::doubts(MovementKind, 1.0, said),
            residual if residual > GOOD_STD => Reason::doubts(MovementKind, HALF, said),
            _ => Reason::supports(MovementKind, said),
        });
    }
    if candidate.tracked.is_some_and(|tracked| tracked.movement.state == Movement::Stationary) {
        return None;
    }
    let pixels = measures.pixels?;
    let alike: Vec<f64> = errors
        .iter()
        .filter(|error| (error.pixels / pixels).ln().abs() <= ALIKE.ln())
        .map(|error| error.residual)
        .collect();
    let num = alike.len();
    let residual = median(alike).filter(|residual| *residual > GOOD_STD)?;
    let weight = if residual > WEAK_STD { HALF } else { SMALL };
    let says =
        format!("models of {num} stationary vehicles of its size: RMS residual {} of the distance", percent(residual));
    Some(Reason::doubts(Path, weight, says))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{CameraPathRatio, Finding, ScaleEstimate, ScaleMethod};
    use crate::scene::{ObjectId, Unit};
    use crate::synthetic::drive::{self, Drive, drive};
    use crate::trajectory::{ObjectDescription, Options, assemble};

    #[test]
    fn a_bad_residual_of_stationary_vehicles_counts_against_moving_ones_of_their_size() {
        let Drive { background, object, frames, planes, ratio, .. } = drive(&drive::Options::default(), 1);
        let options = Options::default();
        let judged = |camera_path: Option<CameraPathRatio>, errors: &[ModelError]| {
            let scale = ScaleEstimate { camera_path, ..ScaleEstimate::new(ratio, ScaleMethod::Joint) };
            let description = ObjectDescription { id: ObjectId(1), class: "car".into(), confidence: 1.0 };
            let trajectory = assemble(description, &background, &object, scale, &frames, Unit::Background);
            let candidate = Candidate {
                trajectory: &trajectory,
                tracked: None,
                object: &object,
                background: &background,
                planes: &planes,
                options: &options,
            };
            let measures = Measures { pixels: Some(100.0), ..Measures::default() };
            model(&candidate, &measures, errors).map(|reason| (reason.finding, reason.weight))
        };
        let path = |residual| CameraPathRatio {
            ratio,
            std: 0.01 * ratio,
            residual,
            ratio_without: ratio,
            std_without: None,
            degenerate_without: false,
        };
        assert_eq!(judged(Some(path(0.01)), &[]), Some((Finding::Supports, 0.0)));
        assert_eq!(judged(Some(path(0.05)), &[]), Some((Finding::Doubts, HALF)));
        assert_eq!(judged(Some(path(0.3)), &[]), Some((Finding::Doubts, 1.0)));
        let error = |residual, pixels| ModelError { residual, pixels };
        assert_eq!(judged(None, &[error(0.01, 90.0)]), None);
        assert_eq!(judged(None, &[error(0.05, 90.0)]), Some((Finding::Doubts, SMALL)));
        assert_eq!(judged(None, &[error(0.3, 120.0)]), Some((Finding::Doubts, HALF)));
        assert_eq!(judged(None, &[error(0.3, 20.0)]), None, "another size");
    }
}
