//! More starts where a map explains too little.

use super::super::map::Map;
use super::super::{initial_pair, motion};
use super::*;
use crate::mapper::incremental_mapper::IncrementalMapper;
use crate::mapper::initialization::InitializationAttempt;

/// The views of a map that is made better, from one that has not grown beyond its first pair.
fn views_after_rounds(poses: Option<&PosePriors>) -> usize {
    let (world, options) = (world(20, 150), Options::object());
    let table = tracks(&world, 0.2, 0, &mut seeded_rng(3, 1));
    assert!(!table.has_gaps());
    let (cameras, known) = ([world.camera], KnownIntrinsics::from(Intrinsics::FIXED));
    let beside = Priors { silhouettes: None, poses };
    let task = InitializationAttempt { table: &table, cameras: &cameras, known: &known, options: &options, beside };
    let (pairs, _): (_, motion::Survey) = initial_pair::ranked(&table, &cameras, &known, &options, 0);
    let mut growth = IncrementalMapper::new(Map::new(&table, &cameras).knowing(known.clone()), &options, 0);
    assert!(growth.start(&pairs[0]).unwrap());
    task.best_of_rounds(growth, 0).unwrap().num_registered()
}

#[test]
fn a_map_that_explains_little_is_grown_again_where_nothing_else_tells() {
    assert_eq!(views_after_rounds(None), 20);
    let poses = PosePriors { poses: vec![None; 20], error_px: 5.0 };
    assert_eq!(views_after_rounds(Some(&poses)), 2);
}

#[test]
fn two_starts_that_agree_need_no_third() {
    let (world, options) = (world(30, 200), Options::object());
    let starts = |outliers: usize| {
        let table = tracks(&world, 0.2, outliers, &mut seeded_rng(3, 1));
        let (cameras, known) = ([world.camera], KnownIntrinsics::from(Intrinsics::FIXED));
        let task = InitializationAttempt {
            table: &table,
            cameras: &cameras,
            known: &known,
            options: &options,
            beside: Priors::default(),
        };
        task.grow_from_starts(0, &mut |_| {}).unwrap().tried
    };
    // Where a third of the tracks is wrong, no map explains what right tracks let a map explain.
    assert_eq!((starts(0), starts(100)), (2, options.min_starts));
}
