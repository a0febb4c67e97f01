//! The report in a real browser: headless Chromium with WebGL in software.
//!
//! Where no Chromium is installed the tests say so and pass, unless `TRACTRIX_REQUIRE_BROWSER=1`: then they fail.
//! `TRACTRIX_REPORT_DIR` names a folder that keeps pages and screenshots, to look at.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use image::RgbImage;
use tractrix::report::{self, Data, Fact, Missing, Model, Object, Stage, Thumbnail, object_colour, strip_frames};
use tractrix::scene::{FrameId, Unit};
use tractrix::synthetic::showcase::{BICYCLE, CAR, Showcase, showcase};

/// A name that would run a script if it were pasted into the page as it is.
const HOSTILE: &str = "<script>console.error('injected')</script>.mp4";

/// Chromium, if there is one.
fn browser() -> Option<PathBuf> {
    let names = ["chromium", "chromium-browser", "google-chrome"];
    let folders: Vec<_> = std::env::split_paths(&std::env::var_os("PATH").unwrap_or_default()).collect();
    let found = names.iter().flat_map(|n| folders.iter().map(move |f| f.join(n))).find(|p| p.is_file());
    if found.is_none() {
        let message = "no Chromium found: apt-get install chromium";
        assert!(std::env::var_os("TRACTRIX_REQUIRE_BROWSER").is_none_or(|v| v != "1"), "{message}");
        eprintln!("skipped: {message}");
    }
    found
}

/// Runs the browser once with an empty profile; its standard output and its log.
fn run(browser: &Path, arguments: &[&str], page: &Path, fragment: &str) -> (String, String) {
    let profile = tempfile::tempdir().expect("a temporary folder");
    let output = Command::new(browser)
        .args(["--headless=new", "--no-sandbox", "--no-first-run", "--disable-extensions", "--hide-scrollbars"])
        .args(["--disable-background-networking", "--disable-dev-shm-usage", "--enable-logging=stderr"])
        .arg(format!("--user-data-dir={}", profile.path().display()))
        // Virtual time runs on while a busy machine decodes pictures and draws the first frames: there must be plenty of it.
        .args(["--virtual-time-budget=60000", "--timeout=120000"])
        .args(arguments)
        .arg(format!("file://{}{fragment}", page.display()))
        .stdin(Stdio::null())
        .output()
        .expect("the browser starts");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (text(&output.stdout), text(&output.stderr))
}

const WITH_WEBGL: [&str; 3] = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"];
const WITHOUT_WEBGL: [&str; 2] = ["--disable-gpu", "--disable-3d-apis"];

/// Where pages and pictures go; the guard keeps a temporary folder alive.
fn folder() -> (PathBuf, Option<tempfile::TempDir>) {
    if let Some(kept) = std::env::var_os("TRACTRIX_REPORT_DIR") {
        std::fs::create_dir_all(&kept).expect("the folder can be made");
        return (kept.into(), None);
    }
    let guard = tempfile::tempdir().expect("a temporary folder");
    (guard.path().to_owned(), Some(guard))
}

/// How often a page is opened that was not ready when virtual time was over.
const ATTEMPTS: usize = 8;

/// The document once its page is ready, and the browser's log.
fn loaded(browser: &Path, flags: &[&str], page: &Path) -> (String, String) {
    let arguments: Vec<&str> = flags.iter().copied().chain(["--dump-dom"]).collect();
    let mut found = run(browser, &arguments, page, "");
    for _ in 1..ATTEMPTS {
        if attribute(&found.0, "data-ready") == Some("true") {
            break;
        }
        found = run(browser, &arguments, page, "");
    }
    found
}

fn screenshot(browser: &Path, page: &Path, fragment: &str, size: (u32, u32), name: &str) -> RgbImage {
    let file = page.with_file_name(name);
    let window = format!("--window-size={},{}", size.0, size.1);
    let target = format!("--screenshot={}", file.display());
    let mut arguments = WITH_WEBGL.to_vec();
    arguments.extend([window.as_str(), target.as_str()]);
    let (_, log) = run(browser, &arguments, page, fragment);
    image::open(&file).unwrap_or_else(|e| panic!("no screenshot: {e}\n{log}")).to_rgb8()
}

/// The page's own list of errors and what it says of itself.
fn attribute<'a>(document: &'a str, name: &str) -> Option<&'a str> {
    let head = document.split_once("<head")?.0;
    Some(head.split_once(&format!("{name}=\""))?.1.split_once('"')?.0)
}

fn strip(result: &Showcase) -> Vec<Thumbnail> {
    let ids: Vec<_> = result.frames.iter().map(|f| f.id).collect();
    let picture = |frame| {
        let masks = result.masks(frame);
        let masks: Vec<_> = masks.iter().map(|(id, mask)| (*id, mask)).collect();
        Thumbnail::new(frame, &result.picture(frame), &masks).expect("the picture encodes")
    };
    strip_frames(&ids).into_iter().step_by(3).map(picture).collect()
}

fn data<'a>(result: &'a Showcase, strip: Vec<Thumbnail>) -> Data<'a> {
    let mut objects: Vec<_> = result.vehicles.iter().map(|v| vehicle(v)).collect();
    objects.push(Object {
        id: BICYCLE,
        class: "bicycle".into(),
        confidence: 0.51,
        visible: result.frames.iter().map(|f| f.id).collect(),
        model: None,
        trajectory: None,
        ratio_per_frame: Vec::new(),
        failure: Some("no pair of frames shares enough features inside its mask (best: 9, needed: 30)".into()),
    });
    let stage = |name: &str, wall_s, cpu_s, peak_rss_mib, reused| Stage {
        name: name.into(),
        wall_s,
        cpu_s,
        peak_rss_mib,
        reused,
    };
    Data {
        title: HOSTILE.into(),
        input: vec![
            Fact::new("video", "960 × 540, 15 frames per second"),
            Fact::new("intrinsics", "f = 820 px").with_note("estimated"),
        ],
        version: "0.1.0".into(),
        arguments: ["tractrix", "run", HOSTILE, "--output", "out"].map(String::from).to_vec(),
        unit: Unit::Background,
        frames: &result.frames,
        background: Model {
            reconstruction: &result.background,
            unregistered: BTreeMap::from(
                [48, 49].map(|f| (FrameId(f), "too few matches with registered frames".into())),
            ),
        },
        ground: Some(&result.ground),
        objects,
        missing: vec![Missing { what: "Metric scale".into(), reason: "no known length was given".into() }],
        strip,
        warnings: vec!["The video has a variable frame rate; the time stamps of its container are used.".into()],
        stages: vec![
            stage("frames", 0.9, 1.2, 118.0, false),
            stage("perception", 8.1, 15.7, 402.0, true),
            stage("background", 11.2, 20.9, 446.0, false),
            stage("objects", 3.4, 6.1, 446.0, false),
            stage("ground", 0.3, 0.4, 446.0, false),
            stage("trajectories", 0.1, 0.1, 446.0, false),
        ],
        evaluation: vec![
            Fact::new("Trajectory error", "0.063 m").with_note("mean distance of the points from the true mesh"),
            Fact::new("Scale deviation", "1.1 %").with_note("from the reference ratio by ray casting"),
        ],
    }
}

fn vehicle(vehicle: &tractrix::synthetic::showcase::Vehicle) -> Object<'_> {
    let trajectory = &vehicle.trajectory;
    let wobble = |f: FrameId| 1.0 + 0.05 * f64::from(f.0).sin() + 0.03 * f64::from(f.0 * 7 % 11) / 11.0;
    let lost = if trajectory.id == CAR { 31..36 } else { 0..0 };
    Object {
        id: trajectory.id,
        class: trajectory.class.clone(),
        confidence: trajectory.confidence,
        visible: vehicle.visible.clone(),
        model: Some(Model {
            reconstruction: &vehicle.model,
            unregistered: lost.map(|f| (FrameId(f), "fewer than 12 inliers in the resection".into())).collect(),
        }),
        trajectory: Some(trajectory),
        ratio_per_frame: trajectory.poses.iter().map(|p| (p.frame, trajectory.scale.ratio * wobble(p.frame))).collect(),
        failure: None,
    }
}

/// Pixels of about this colour, and the box round them.
fn coloured(picture: &RgbImage, colour: [u8; 3]) -> (usize, [u32; 4]) {
    let mut count = 0;
    let mut bounds = [u32::MAX, u32::MAX, 0, 0];
    for (x, y, pixel) in picture.enumerate_pixels() {
        if pixel.0.iter().zip(&colour).all(|(a, b)| a.abs_diff(*b) <= 14) {
            count += 1;
            bounds = [bounds[0].min(x), bounds[1].min(y), bounds[2].max(x), bounds[3].max(y)];
        }
    }
    (count, bounds)
}

#[test]
fn the_page_runs_without_errors_and_shows_the_trajectory() {
    let Some(browser) = browser() else { return };
    let (folder, _guard) = folder();
    let result = showcase(60, 1);
    let page = folder.join("report.html");
    report::write(&page, &data(&result, strip(&result))).expect("the report is written");
    let size = std::fs::metadata(&page).expect("it is there").len();
    assert!(size < 6 << 20, "{size} bytes");

    let (document, log) = loaded(&browser, &WITH_WEBGL, &page);
    assert_eq!(attribute(&document, "data-ready"), Some("true"), "{log}");
    assert_eq!(attribute(&document, "data-renderer"), Some("webgl"), "{log}");
    assert_eq!(attribute(&document, "data-errors"), None, "{log}");
    assert!(!log.contains("CONSOLE"), "{log}");

    // The strip's pictures carry the masks' colours, so this page has none.
    let bare = folder.join("bare.html");
    report::write(&bare, &data(&result, Vec::new())).expect("the report is written");
    // A picture cannot say whether its page was ready: only one that has nothing of the car is taken again.
    let shoot = || {
        let picture = screenshot(&browser, &bare, "#full&theme=dark", (1400, 1000), "bare.png");
        coloured(&picture, object_colour(CAR))
    };
    let mut shots = (0..ATTEMPTS).map(|_| shoot());
    let (count, [x0, y0, x1, y1]) = shots.find(|(count, _)| *count > 0).expect("the car's colour shows");
    assert!(count > 700, "{count} pixels in the colour of the car's trajectory");
    assert!(x1 - x0 > 300 && y1 - y0 > 100, "they span {x0}..{x1} × {y0}..{y1}");
}

#[test]
fn without_webgl_the_page_says_so_and_shows_the_top_view() {
    let Some(browser) = browser() else { return };
    let (folder, _guard) = folder();
    let result = showcase(60, 1);
    let page = folder.join("plan.html");
    report::write(&page, &data(&result, Vec::new())).expect("the report is written");
    let (document, log) = loaded(&browser, &WITHOUT_WEBGL, &page);
    assert_eq!(attribute(&document, "data-ready"), Some("true"), "{log}");
    assert_eq!(attribute(&document, "data-renderer"), Some("plan"), "{log}");
    assert_eq!(attribute(&document, "data-errors"), None, "{log}");
    assert!(document.contains("This browser has no WebGL"));
}

#[test]
fn a_thousand_frames_stay_within_the_size_limit() {
    let result = showcase(1000, 1);
    let strip: Vec<_> = strip(&showcase(60, 1));
    // The showcase's own pictures, as many as a long strip holds.
    let ids: Vec<_> = result.frames.iter().map(|f| f.id).collect();
    let long: Vec<_> = strip_frames(&ids)
        .into_iter()
        .zip(strip.iter().cycle())
        .map(|(frame, thumbnail)| Thumbnail { frame, ..thumbnail.clone() })
        .collect();
    let page = report::render(&data(&result, long)).expect("the report renders");
    assert!(page.len() < 6 << 20, "{} bytes", page.len());
    assert!(page.contains("The frame strip shows 72 of 1000 frames"));
}
