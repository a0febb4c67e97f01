use super::*;
use crate::eval::comparison::{MatchBy, Side, compare};
use crate::report::testing;

fn sides() -> (Side, Side) {
    let ours = Side { name: "ours".into(), model: testing::world().background, cost: None };
    let mut theirs = Side { name: "theirs".into(), ..ours.clone() };
    let turn = nalgebra::UnitQuaternion::from_euler_angles(0.3, 0.2, 0.1);
    theirs.model.transform(&crate::math::Sim3::new(2.0, turn, nalgebra::Vector3::new(1.0, 2.0, 3.0)));
    theirs.model.images.values_mut().nth(4).unwrap().cam_from_world.translation *= 50.0;
    (ours, theirs)
}

fn page(reference: &Side, other: &Side) -> String {
    let comparison = compare(reference, std::slice::from_ref(other), LengthUnit::Reference, MatchBy::Name);
    let models = vec![&reference.model, &other.model];
    render(&Data { comparison: &comparison, models, arguments: vec!["tractrix".into()] }).unwrap()
}

#[test]
fn the_page_holds_everything_and_loads_nothing() {
    let (ours, theirs) = sides();
    let page = page(&ours, &theirs);
    for mark in ["src=\"http", "href=\"http", "@import url(http"] {
        assert!(!page.contains(mark), "{mark}");
    }
    assert!(page.contains("1 camera is lost"));
    assert!(
        page.contains("id=\"scene-data\"") && page.contains("Track lengths") && page.contains("Reprojection errors")
    );
    assert_eq!(page.matches("<script").count(), page.matches("</script>").count());
}

#[test]
fn hostile_names_are_escaped() {
    let (mut ours, mut theirs) = sides();
    let evil = "</script><img src=x onerror=alert(1)>";
    theirs.name = evil.into();
    for side in [&mut ours, &mut theirs] {
        side.model.images.values_mut().next().unwrap().name = evil.into();
    }
    assert!(!page(&ours, &theirs).contains("<img src=x"));
}

#[test]
fn reconstruction_without_cameras_has_a_page() {
    let (ours, _) = sides();
    let nothing = Side { name: "nothing".into(), model: Reconstruction::default(), cost: None };
    assert!(page(&nothing, &ours).contains("cannot be compared with"));
    assert!(page(&ours, &nothing).contains("cannot be compared with"));
}
