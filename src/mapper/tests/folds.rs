//! Maps that are folded between two views.

use super::*;
use crate::mapper::initialization::InitializationAttempt;

#[test]
fn a_folded_map_is_grown_anew_from_its_longer_side() {
    const FOLD: usize = 14;
    let (world, options) = (world(20, 150), Options::object());
    let table = tracks(&world, 0.2, 0, &mut seeded_rng(3, 1));
    let (cameras, known) = ([world.camera], KnownIntrinsics::from(Intrinsics::FIXED));
    let task = InitializationAttempt {
        table: &table,
        cameras: &cameras,
        known: &known,
        options: &options,
        beside: Priors::default(),
    };
    let flat = task.grow_from_starts(0, &mut |_| {}).unwrap().best.unwrap();
    assert_eq!(flat.discontinuity(), None);
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.6);
    let mut folded = flat.clone();
    for view in FOLD..20 {
        let pose = folded.map_mut().poses[view].as_mut().unwrap();
        pose.rotation *= turn;
    }
    let discontinuity = folded.discontinuity().unwrap();
    assert_eq!(discontinuity.views, [FOLD - 1, FOLD]);
    assert_eq!(folded.longer_side(&discontinuity).poses.iter().flatten().count(), FOLD);
    let mended = task.without_folds(folded, 0).unwrap();
    assert_eq!((mended.discontinuity(), mended.num_registered()), (None, 20));
    for view in 0..20 {
        let (found, before) = (mended.map().poses[view].unwrap(), flat.map().poses[view].unwrap());
        assert!(found.rotation.angle_to(&before.rotation) < 0.01, "{view}: {found:?} {before:?}");
    }
    // Without a fold nothing is done.
    let kept = task.without_folds(flat.clone(), 0).unwrap();
    assert_eq!(kept.map().poses, flat.map().poses);
}
