//! The report in a real browser: headless Chromium with WebGL in software.
//!
//! Where no Chromium is installed the tests say so and pass, unless `TRACTRIX_REQUIRE_BROWSER=1`: then they fail.
//! `TRACTRIX_REPORT_DIR` names a folder that keeps pages and screenshots, to look at.

#[path = "common/browser.rs"]
mod browser;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use browser::Browser;
use image::RgbImage;
use tractrix::eval::Evaluation;
use tractrix::report::{
    self, Data, Fact, Film, Missing, Model, Object, Part, PictureMaker, Pictures, Stage, Thumbnail, object_colour,
    strip_frames,
};
use tractrix::scene::{FrameId, ObjectId, TimeBase};
use tractrix::synthetic::showcase::{BICYCLE, CAR, Showcase, showcase};

/// A name that would run a script if it were pasted into the page as it is.
const HOSTILE: &str = "<script>console.error('injected')</script>.mp4";

/// What `tractrix evaluate` wrote of the bundled clip.
static EVALUATION: LazyLock<Evaluation> =
    LazyLock::new(|| serde_json::from_str(include_str!("golden/evaluation.json")).expect("it is an evaluation"));

const WITH_WEBGL: [&str; 3] = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"];
const WITHOUT_WEBGL: [&str; 2] = ["--disable-gpu", "--disable-3d-apis"];

/// Size of the window in pixels where a test needs no other.
const SIZE: [u32; 2] = [1400, 1000];

/// Where pages and pictures go; the guard keeps a temporary folder alive.
fn folder() -> (PathBuf, Option<tempfile::TempDir>) {
    if let Some(kept) = std::env::var_os("TRACTRIX_REPORT_DIR") {
        std::fs::create_dir_all(&kept).expect("the folder can be made");
        return (kept.into(), None);
    }
    let guard = tempfile::tempdir().expect("a temporary folder");
    (guard.path().to_owned(), Some(guard))
}

/// What the page says of itself in an attribute of its root.
fn attribute(page: &mut Browser, name: &str) -> String {
    page.find(&format!("return document.documentElement.dataset.{name} ?? '';"))
}

/// Film, strip and portraits of every frame.
fn pictures(result: &Showcase) -> Pictures {
    let ids: Vec<_> = result.frames.iter().map(|f| f.id).collect();
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut maker = PictureMaker::new(&ids, &folder.path().join("film.mp4"));
    for frame in maker.wanted() {
        let masks = result.masks(frame);
        let masks: Vec<_> = masks.iter().map(|(id, mask)| (*id, mask)).collect();
        maker.push(frame, &result.picture(frame), &masks).expect("the picture encodes");
    }
    maker.finish().expect("the film is whole")
}

fn without_model(result: &Showcase, id: ObjectId) -> Object<'_> {
    Object {
        ground_track: None,
        id,
        class: "bicycle".into(),
        confidence: 0.51,
        tracked: None,
        visible: result.frames.iter().map(|f| f.id).collect(),
        model: None,
        trajectory: None,
        ratio_per_frame: Vec::new(),
        failure: Some("no pair of frames shares enough features inside its mask (best: 9, needed: 30)".into()),
    }
}

fn data<'a>(result: &'a Showcase, pictures: Pictures) -> Data<'a> {
    let mut objects: Vec<_> = result.vehicles.iter().map(|v| vehicle(v)).collect();
    objects.push(without_model(result, BICYCLE));
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
        time_base: TimeBase::Seconds,
        frames: &result.frames,
        background: Model {
            reconstruction: &result.background,
            unregistered: BTreeMap::from(
                [48, 49].map(|f| (FrameId(f), "too few matches with registered frames".into())),
            ),
        },
        metric: Some(&result.metric),
        ground: Some(&result.ground),
        objects,
        missing: vec![Missing { what: "Metric scale".into(), reason: "no known length was given".into() }],
        pictures,
        warnings: vec!["The video has a variable frame rate; the time stamps of its container are used.".into()],
        stages: vec![
            stage("frames", 0.9, 1.2, 118.0, false),
            stage("perception", 8.1, 15.7, 402.0, true),
            stage("background", 11.2, 20.9, 446.0, false),
            stage("objects", 3.4, 6.1, 446.0, false),
            stage("ground", 0.3, 0.4, 446.0, false),
            stage("trajectories", 0.1, 0.1, 446.0, false),
        ],
        evaluation: Some(&EVALUATION),
        parts: vec![
            Part { object: None, path: "trajectories.json".into(), holds: "trajectories, frame by frame".into() },
            Part { object: Some(CAR), path: "objects/1/".into(), holds: "cameras and points".into() },
        ],
        is_sfm: false,
    }
}

fn vehicle(vehicle: &tractrix::synthetic::showcase::Vehicle) -> Object<'_> {
    let trajectory = &vehicle.trajectory;
    let wobble = |f: FrameId| 1.0 + 0.05 * f64::from(f.0).sin() + 0.03 * f64::from(f.0 * 7 % 11) / 11.0;
    let lost = if trajectory.id == CAR { 31..36 } else { 0..0 };
    Object {
        ground_track: None,
        id: trajectory.id,
        class: trajectory.class.clone(),
        confidence: trajectory.confidence,
        tracked: None,
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

fn write(page: &Path, data: &Data) {
    let text = report::render(data).expect("the report renders");
    std::fs::write(page, text).expect("the report is written");
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
    let Some(browser) = browser::installed() else { return };
    let (folder, _guard) = folder();
    let result = showcase(60, 1);
    let page = folder.join("report.html");
    write(&page, &data(&result, pictures(&result)));
    let size = std::fs::metadata(&page).expect("it is there").len();
    assert!(size < 6 << 20, "{size} bytes");

    let mut opened = Browser::open(&browser, &WITH_WEBGL, &page, "", SIZE);
    assert_eq!(attribute(&mut opened, "renderer"), "webgl");
    assert_eq!(attribute(&mut opened, "errors"), "");
    assert_eq!(opened.messages, [""; 0]);

    // The strip's pictures carry the masks' colours, so this page has none.
    let bare = folder.join("bare.html");
    write(&bare, &data(&result, Pictures::default()));
    let picture = Browser::open(&browser, &WITH_WEBGL, &bare, "#full&theme=dark", SIZE).screenshot();
    picture.save(folder.join("bare.png")).expect("the picture is written");
    let (count, [x0, y0, x1, y1]) = coloured(&picture, object_colour(CAR));
    assert!(count > 700, "the car's trajectory has {count} pixels");
    assert!(x1 - x0 > 300 && y1 - y0 > 100, "they span {x0}..{x1} × {y0}..{y1}");
}

/// Color of the 3D view where nothing is drawn.
const NOTHING: [u8; 3] = [0xe9, 0xed, 0xf1];

#[test]
fn the_view_through_a_narrow_camera_has_its_picture() {
    let Some(browser) = browser::installed() else { return };
    let (folder, _guard) = folder();
    let mut result = showcase(30, 1);
    // A field of view of 33°: a dashcam on a road, a drone with a long lens.
    result.background.cameras.values_mut().for_each(|camera| camera.focal = [1600.0; 2]);
    let page = folder.join("narrow.html");
    write(&page, &data(&result, Pictures { film: None, ..pictures(&result) }));
    let picture = Browser::open(&browser, &WITH_WEBGL, &page, "#view=camera&full&theme=light", SIZE).screenshot();
    picture.save(folder.join("narrow.png")).expect("the picture is written");
    // Between the controls above and below.
    let middle = image::imageops::crop_imm(&picture, 400, 200, 600, 500).to_image();
    let (empty, _) = coloured(&middle, NOTHING);
    assert!(empty < 30_000, "the middle of the view has no picture: {empty} pixels are empty");
}

#[test]
fn without_webgl_the_page_says_so_and_shows_the_top_view() {
    let Some(browser) = browser::installed() else { return };
    let (folder, _guard) = folder();
    let result = showcase(60, 1);
    let page = folder.join("plan.html");
    write(&page, &data(&result, Pictures::default()));
    let mut opened = Browser::open(&browser, &WITHOUT_WEBGL, &page, "", SIZE);
    assert_eq!(attribute(&mut opened, "renderer"), "plan");
    assert_eq!(attribute(&mut opened, "errors"), "");
    assert!(opened.find("return document.body.innerText;").contains("this browser has no WebGL"));
}

/// What a script finds on a page that is ready, in a window of some width. The script returns a text.
fn found_by(browser: &Path, page: &str, width: u32, script: &str) -> String {
    let (folder, _guard) = folder();
    let file = folder.join(format!("measured-{width}.html"));
    std::fs::write(&file, page).expect("the page is written");
    Browser::open(browser, &WITHOUT_WEBGL, &file, "", [width, SIZE[1]]).find(script)
}

const WIDTHS: [u32; 2] = [1400, 420];

#[test]
fn playing_moves_through_the_frames_and_stops() {
    let Some(browser) = browser::installed() else { return };
    let result = showcase(60, 1);
    let page = report::render(&data(&result, Pictures::default())).expect("the report renders");
    let script = "const time = document.getElementById('time'), play = document.getElementById('play'); \
        const cursor = () => document.querySelector('.area .cursor').style.left; \
        time.value = 0; time.dispatchEvent(new Event('input')); \
        const before = cursor(); \
        play.click(); \
        const pressed = play.getAttribute('aria-label'); \
        await new Promise((resolve) => setTimeout(resolve, 1500)); \
        const moved = Number(time.value) > 3 && cursor() !== before; \
        if (play.getAttribute('aria-label') === 'Pause') play.click(); \
        return `${pressed} ${moved} ${play.getAttribute('aria-label')}`;";
    assert_eq!(found_by(&browser, &page, 1400, script), "Pause true Play");
}

#[test]
fn models_alone_have_a_page_with_images_and_residuals() {
    let Some(browser) = browser::installed() else { return };
    let result = showcase(60, 1);
    let mut data = data(&result, pictures(&result));
    data.objects.iter_mut().for_each(|object| object.trajectory = None);
    let data = Data { is_sfm: true, metric: None, ground: None, evaluation: None, ..data };
    let (folder, _guard) = folder();
    let file = folder.join("sfm.html");
    write(&file, &data);
    let mut opened = Browser::open(&browser, &WITH_WEBGL, &file, "", SIZE);
    assert_eq!(attribute(&mut opened, "renderer"), "webgl");
    assert_eq!(attribute(&mut opened, "errors"), "");
    let page = report::render(&data).expect("the report renders");
    let script = "const fold = document.getElementById('models-title').closest('details'); \
        const rows = fold.querySelectorAll('table')[0].querySelectorAll('tbody tr').length; \
        fold.querySelectorAll('details').forEach((inner) => { inner.open = true; }); \
        const images = fold.querySelectorAll('table')[2].querySelectorAll('tbody tr').length; \
        const charts = fold.querySelectorAll('.chart').length; \
        const wide = document.documentElement.scrollWidth > innerWidth; \
        return `${fold.open} ${rows} ${images} ${charts} ${document.querySelector('.vehicles') === null} ${wide}`;";
    let (rows, images) = (1 + result.vehicles.len(), result.background.images.len());
    for width in WIDTHS {
        let expected = format!("true {rows} {images} 2 true false");
        assert_eq!(found_by(&browser, &page, width, script), expected, "{width} pixels wide");
    }
}

#[test]
fn labels_of_the_time_axes_stay_on_one_line() {
    let Some(browser) = browser::installed() else { return };
    let result = showcase(60, 1);
    let page = report::render(&data(&result, Pictures::default())).expect("the report renders");
    let script = "const ticks = [...document.querySelectorAll('.x-tick')]; \
        const bad = ticks.filter((t) => t.offsetHeight > 1.7 * parseFloat(getComputedStyle(t).fontSize) \
            || t.getBoundingClientRect().right > t.closest('.chart').getBoundingClientRect().right); \
        return `${ticks.length > 10} ${bad.map((t) => t.textContent)}`;";
    for width in WIDTHS {
        assert_eq!(found_by(&browser, &page, width, script), "true ", "{width} pixels wide");
    }
}

#[test]
fn no_word_of_the_figures_is_broken() {
    let Some(browser) = browser::installed() else { return };
    let result = showcase(60, 1);
    let page = report::render(&data(&result, Pictures::default())).expect("the report renders");
    // The longest words that a key figure has had. A line may end after a hyphen, as in constant-distance.
    let page = page.replacen("<dd>given</dd>", "<dd>segmentation</dd>", 1);
    let script = "const broken = []; let words = 0; \
        for (const cell of document.querySelectorAll('.key dt, .key dd, .evaluation th, .evaluation td')) { \
            const text = cell.firstChild; \
            for (const match of text.data.matchAll(/[^ -]+/g)) { \
                const range = document.createRange(); \
                range.setStart(text, match.index); range.setEnd(text, match.index + match[0].length); \
                words++; \
                if (new Set([...range.getClientRects()].map((r) => r.top)).size > 1) broken.push(match[0]); \
            } \
        } \
        return `${words > 20} ${broken} ${document.documentElement.scrollWidth > innerWidth}`;";
    assert!(page.contains("segmentation"));
    for width in WIDTHS {
        assert_eq!(found_by(&browser, &page, width, script), "true  false", "{width} pixels wide");
    }
}

#[test]
fn a_small_path_has_its_dots_at_its_ends() {
    let Some(browser) = browser::installed() else { return };
    let mut result = showcase(60, 1);
    for vehicle in &mut result.vehicles {
        let first = vehicle.trajectory.poses[0].position;
        for pose in &mut vehicle.trajectory.poses {
            pose.position = std::array::from_fn(|k| first[k] + 0.02 * (pose.position[k] - first[k]));
        }
    }
    let page = report::render(&data(&result, Pictures::default())).expect("the report renders");
    let script = "const wrong = []; const plans = document.querySelectorAll('.card .plan-svg'); \
        for (const svg of plans) { \
            const box = svg.getBoundingClientRect(), path = svg.querySelector('.plan-path'); \
            const at = (p) => p.matrixTransform(path.getScreenCTM()); \
            for (const [dot, end] of [['.plan-start', 0], ['.plan-end', path.getTotalLength()]]) { \
                const ends = [svg.querySelector(dot).getPointAtLength(0), path.getPointAtLength(end)]; \
                const [place, line] = ends.map(at); \
                const off = Math.hypot(place.x - line.x, place.y - line.y); \
                const across = Math.min(place.x - box.left, box.right - place.x); \
                const inside = Math.min(across, place.y - box.top, box.bottom - place.y); \
                if (off > 1 || inside < 6) wrong.push(`${dot} ${off} ${inside}`); \
            } \
        } \
        return `${plans.length > 0} ${wrong}`;";
    for width in WIDTHS {
        assert_eq!(found_by(&browser, &page, width, script), "true ", "{width} pixels wide");
    }
}

#[test]
fn the_table_lists_vehicles_by_trust_and_leads_to_their_details() {
    let Some(browser) = browser::installed() else { return };
    let result = showcase(60, 1);
    let mut data = data(&result, Pictures::default());
    data.objects.splice(0..0, (90..94).map(|id| without_model(&result, ObjectId(id))));
    let page = report::render(&data).expect("the report renders");
    let script = "const rows = [...document.querySelectorAll('.vehicles tbody tr')]; \
        const trust = rows.map((row) => Number(row.dataset.trust)); \
        const sorted = trust.every((t, k) => k === 0 || trust[k - 1] <= t); \
        const fold = document.querySelector('.cards').closest('details'), folded = !fold.open; \
        const filter = document.getElementById('filter'); filter.value = '2'; \
        filter.dispatchEvent(new Event('change')); \
        const shown = rows.filter((row) => row.offsetHeight > 0).length; \
        const wide = document.documentElement.scrollWidth > innerWidth; \
        rows[0].querySelector('a').click(); dispatchEvent(new Event('hashchange')); \
        return `${rows.length} ${sorted} ${folded} ${shown > 0 && shown < rows.length} ${wide} ${fold.open}`;";
    let num_rows = data.objects.len();
    for width in WIDTHS {
        let expected = format!("{num_rows} true true true false true");
        assert_eq!(found_by(&browser, &page, width, script), expected, "{width} pixels wide");
    }
}

#[test]
fn the_film_follows_the_slider_and_speeds_have_units() {
    let Some(browser) = browser::installed() else { return };
    let result = showcase(60, 1);
    let pictures = pictures(&result);
    // FFmpeg without an encoder of H.264 makes no film; the page then has the strip.
    let width = if pictures.film.is_some() { 640 } else { 400 };
    let page = report::render(&data(&result, pictures)).expect("the report renders");
    let script = "const canvas = document.getElementById('now-picture'), time = document.getElementById('time'); \
        while (canvas.width !== WIDTH) await new Promise((resolve) => setTimeout(resolve, 50)); \
        const labels = () => document.querySelectorAll('#now b').length; \
        const before = [canvas.width, labels() > 0]; \
        time.value = 3; time.dispatchEvent(new Event('input')); \
        const units = document.getElementById('units'), cell = document.querySelector('.vehicles td:nth-child(3)'); \
        const said = [cell.textContent]; \
        for (const unit of ['m/s', 'mph', 'km/h']) { \
            units.value = unit; units.dispatchEvent(new Event('change')); said.push(cell.textContent); \
        } \
        const portrait = document.querySelectorAll('.portrait').length; \
        const clock = document.getElementById('clock').textContent; \
        return `${before} ${clock} ${units.hidden} ${said.join(', ')} ${portrait}`;";
    let found = found_by(&browser, &page, 1400, &script.replace("WIDTH", &width.to_string()));
    let speeds = "32.94 ± 0.66 km/h, 9.15 ± 0.18 m/s, 20.47 ± 0.41 mph, 32.94 ± 0.66 km/h";
    assert_eq!(found, format!("{width},true 0.20 s · frame 3 false {speeds} 3"));
}

#[test]
fn charts_can_be_moved_through_by_keys() {
    let Some(browser) = browser::installed() else { return };
    let result = showcase(60, 1);
    let page = report::render(&data(&result, Pictures::default())).expect("the report renders");
    let script = "document.querySelectorAll('details').forEach((fold) => { fold.open = true; }); \
        const sliders = [...document.querySelectorAll('.chart [role=slider]')]; \
        const now = () => sliders.map((s) => Number(s.getAttribute('aria-valuenow'))); \
        const before = now(); \
        sliders[0].focus(); \
        sliders[0].dispatchEvent(new KeyboardEvent('keydown', { key: 'ArrowRight', bubbles: true })); \
        const steps = now().map((v, k) => v - before[k]); \
        const said = sliders[0].getAttribute('aria-valuetext'); \
        return `${sliders.length} ${document.activeElement === sliders[0]} ${new Set(steps).size} ${steps[0]} \
            ${/seconds, frame .*Car 1/.test(said)}`.replace(/ +/g, ' ');";
    assert_eq!(found_by(&browser, &page, 1400, script), "8 true 1 1 true");
}

#[test]
fn without_a_rate_the_page_never_shows_a_second() {
    let Some(browser) = browser::installed() else { return };
    let mut result = showcase(60, 1);
    for frame in &mut result.frames {
        frame.time_s = f64::from(frame.id.0);
    }
    let data = Data {
        time_base: TimeBase::Frames,
        input: Vec::new(),
        warnings: Vec::new(),
        ..data(&result, Pictures::default())
    };
    let page = report::render(&data).expect("the report renders");
    let script = "document.querySelectorAll('.stages').forEach((table) => table.remove()); \
        const spoken = [...document.querySelectorAll('[aria-valuetext], [aria-label]')].map((e) => \
            `${e.getAttribute('aria-valuetext')} ${e.getAttribute('aria-label')}`); \
        const titles = [...document.querySelectorAll('rect title')].map((e) => e.textContent); \
        const all = [document.body.innerText, ...spoken, ...titles].join(' '); \
        const seconds = all.match(/.{12}([0-9.]+ s(?![a-z])|second).{0,12}/g) ?? []; \
        return `${/frame 36/.test(all)} ${seconds.filter((s) => !/ten frames per/.test(s)).join(',')}`;";
    assert_eq!(found_by(&browser, &page, 1400, script), "true ");
}

#[test]
fn a_thousand_frames_stay_within_the_size_limit() {
    let result = showcase(1000, 1);
    let short = pictures(&showcase(60, 1));
    // The showcase's own pictures, as many as a long strip holds, and a film ten times as long.
    let ids: Vec<_> = result.frames.iter().map(|f| f.id).collect();
    let of_frame = |(frame, thumbnail): (FrameId, &Thumbnail)| Thumbnail { frame, ..thumbnail.clone() };
    let strip = strip_frames(&ids).into_iter().zip(short.strip.iter().cycle()).map(of_frame).collect();
    let film = short.film.map(|film| Film {
        mp4: film.mp4.repeat(10),
        frames: ids.iter().step_by(2).copied().collect(),
        labels: film.labels.iter().cycle().take(500).cloned().collect(),
        ..film
    });
    let pictures = Pictures { film, strip, portraits: short.portraits };
    let page = report::render(&data(&result, pictures)).expect("the report renders");
    assert!(page.len() < 10 << 20, "{} bytes", page.len());
    assert!(
        page.contains("The film shows 500 of 1000 frames") || page.contains("The frame strip shows 16 of 1000 frames")
    );
}
