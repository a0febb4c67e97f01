//! The page of a live run: plan view and last frame, for browsers of this computer.
//!
//! A browser gets the lines of live.jsonl as they are, and a small JPEG image of the newest frame twice a second, as
//! Server-Sent Events. A browser that is too slow loses events; nothing waits for it.

use std::io::{self, Cursor, Write};
use std::net::{SocketAddr, TcpListener};
use std::str::FromStr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use ::image::codecs::jpeg::JpegEncoder;
use ::image::{RgbImage, imageops};
use anyhow::{Context, anyhow};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde_json::json;
use tiny_http::{Header, Request, Response, Server};

use super::super::lock;
use crate::live::Line;
use crate::scene::Frame;

/// Longer side of the image, pixels.
const IMAGE_PX: u32 = 960;
/// Time between two images.
const IMAGE_PERIOD: Duration = Duration::from_millis(500);
/// Events that wait for a browser at most: two seconds of ten vehicles.
const MAX_WAITING: usize = 256;
/// Browsers at once.
const MAX_BROWSERS: usize = 8;
/// The page loads nothing, and shows images of its own events alone.
const POLICY: &str = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; \
                      connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// Address of the page: `IP:PORT` or `localhost:PORT`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct PageAddress(SocketAddr);

impl FromStr for PageAddress {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numeric = text.strip_prefix("localhost:").map(|port| format!("127.0.0.1:{port}"));
        let parsed = numeric.as_deref().unwrap_or(text).parse();
        parsed.map(Self).map_err(|_| format!("'{text}': expected an address and a port, such as 127.0.0.1:8080"))
    }
}

impl PageAddress {
    /// Refuses an address that other computers can reach.
    ///
    /// # Errors
    /// Such an address, unless it is public on purpose.
    pub(super) fn check(self, is_public: bool) -> Result<(), String> {
        match self.0.ip().is_loopback() || is_public {
            true => Ok(()),
            false => Err(format!(
                "--page {}: other computers could see the video, without a password; give a loopback address \
                 (127.0.0.1), or --page-public",
                self.0
            )),
        }
    }
}

/// A served page.
pub(super) struct Page {
    hub: Arc<Hub>,
    /// Frames to be encoded.
    frames: SyncSender<(Frame, RgbImage)>,
    last_image: Mutex<Option<Instant>>,
    address: SocketAddr,
    is_over: Arc<AtomicBool>,
}

impl Page {
    /// Serves the page on threads of its own.
    ///
    /// # Errors
    /// An address that cannot be bound.
    pub(super) fn open(PageAddress(address): PageAddress) -> anyhow::Result<Self> {
        let unusable = || format!("--page {address}: cannot be opened");
        let listener = TcpListener::bind(address).with_context(unusable)?;
        let address = listener.local_addr().with_context(unusable)?;
        let server = Server::from_listener(listener, None).map_err(|error| anyhow!("{}: {error}", unusable()))?;
        let (frames, waiting) = sync_channel(1);
        let (hub, is_over) = (Arc::<Hub>::default(), Arc::<AtomicBool>::default());
        let (encoded, served, ends) = (hub.clone(), hub.clone(), is_over.clone());
        let is_local = address.ip().is_loopback();
        let start = |name: &str, work: Box<dyn FnOnce() + Send>| {
            thread::Builder::new().name(name.into()).spawn(work).with_context(unusable).map(drop)
        };
        start("images", Box::new(move || encode(&waiting, &encoded)))?;
        start("page", Box::new(move || serve(&server, &served, &ends, is_local)))?;
        Ok(Self { hub, frames, last_image: Mutex::default(), address, is_over })
    }

    /// Address in a browser.
    pub(super) fn url(&self) -> String {
        format!("http://{}/", self.address)
    }

    /// Takes a result line, as it is in live.jsonl.
    pub(super) fn take_line(&self, line: &Line, text: &str) {
        let kept = match line {
            Line::Map(_) | Line::NoMap(_) => Some("map"),
            Line::Load(_) => Some("load"),
            Line::Vehicle(_) | Line::Camera(_) | Line::End(_) => None,
        };
        self.hub.send(event("line", text), kept);
    }

    /// Takes a frame; it is copied if an image is due and somebody looks.
    pub(super) fn take_frame(&self, frame: &Frame, image: &RgbImage) {
        let mut last = lock(&self.last_image);
        let is_due = last.is_none_or(|last| last.elapsed() >= IMAGE_PERIOD);
        if is_due && self.hub.has_browsers() && self.frames.try_send((frame.clone(), image.clone())).is_ok() {
            *last = Some(Instant::now());
        }
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        lock(&self.hub.state).browsers.clear();
    }
}

/// Browsers, and what a new one gets first.
#[derive(Default)]
struct Hub {
    state: Mutex<HubState>,
}

#[derive(Default)]
struct HubState {
    browsers: Vec<SyncSender<Arc<str>>>,
    /// Last event of each kind that describes a state.
    kept: Vec<(&'static str, Arc<str>)>,
}

impl Hub {
    /// Sends an event to all browsers; those that have gone are forgotten.
    ///
    /// * `kept` – kind of an event that a new browser gets as well.
    fn send(&self, text: String, kept: Option<&'static str>) {
        let text: Arc<str> = text.into();
        let mut state = lock(&self.state);
        if let Some(kind) = kept {
            state.kept.retain(|(other, _)| *other != kind);
            state.kept.push((kind, text.clone()));
        }
        let is_open = |browser: &SyncSender<Arc<str>>| {
            !matches!(browser.try_send(text.clone()), Err(std::sync::mpsc::TrySendError::Disconnected(_)))
        };
        state.browsers.retain(is_open);
    }

    fn has_browsers(&self) -> bool {
        !lock(&self.state).browsers.is_empty()
    }

    /// Events of a new browser; `None` if there are too many.
    fn join(&self) -> Option<Receiver<Arc<str>>> {
        let mut state = lock(&self.state);
        if state.browsers.len() >= MAX_BROWSERS {
            return None;
        }
        let (sender, receiver) = sync_channel(MAX_WAITING);
        for (_, text) in &state.kept {
            drop(sender.try_send(text.clone()));
        }
        state.browsers.push(sender);
        Some(receiver)
    }
}

/// An event of the stream; `data` is one line.
fn event(kind: &str, data: &str) -> String {
    format!("event: {kind}\ndata: {}\n\n", data.trim_end())
}

/// Turns frames into events until there are no more.
fn encode(frames: &Receiver<(Frame, RgbImage)>, hub: &Hub) {
    for (frame, image) in frames {
        let (width, height) = image.dimensions();
        let share = (f64::from(IMAGE_PX) / f64::from(width.max(height))).min(1.0);
        let [small_width, small_height] = [width, height].map(|side| ((f64::from(side) * share) as u32).max(1));
        let small = imageops::thumbnail(&image, small_width, small_height);
        let mut jpeg = Cursor::new(Vec::new());
        if JpegEncoder::new_with_quality(&mut jpeg, 72).encode_image(&small).is_err() {
            continue;
        }
        let url = format!("data:image/jpeg;base64,{}", STANDARD.encode(jpeg.into_inner()));
        let data = json!({ "frame": frame.id.0, "t": frame.time_s, "width": width, "height": height, "image": url });
        hub.send(event("frame", &data.to_string()), Some("frame"));
    }
}

/// Answers requests until the run is over.
///
/// * `is_local` – true if names of other hosts are refused: a page of the internet whose name leads here must not read
///   the video.
fn serve(server: &Server, hub: &Arc<Hub>, is_over: &AtomicBool, is_local: bool) {
    while !is_over.load(Ordering::Relaxed) {
        match server.recv_timeout(Duration::from_millis(200)) {
            Ok(Some(request)) => answer(request, hub, is_local),
            Ok(None) => {}
            Err(_) => return,
        }
    }
}

fn answer(request: Request, hub: &Arc<Hub>, is_local: bool) {
    let host = request.headers().iter().find(|header| header.field.equiv("Host")).map(|header| header.value.as_str());
    let refused = |status: u16, text: &str| Response::from_string(text).with_status_code(status);
    let answered = match request.url() {
        _ if is_local && !host.is_some_and(is_own_name) => request.respond(refused(403, "unknown host")),
        "/" => {
            let mut page = Response::from_string(include_str!("page.html"));
            for (name, value) in [
                ("Content-Type", "text/html; charset=utf-8"),
                ("Content-Security-Policy", POLICY),
                ("X-Content-Type-Options", "nosniff"),
                ("Referrer-Policy", "no-referrer"),
                ("Cache-Control", "no-store"),
            ] {
                if let Ok(header) = Header::from_bytes(name, value) {
                    page.add_header(header);
                }
            }
            request.respond(page)
        }
        "/events" => match hub.join() {
            Some(events) => {
                let writer = request.into_writer();
                thread::Builder::new().name("browser".into()).spawn(move || stream(writer, &events)).map(drop)
            }
            None => request.respond(refused(503, "too many browsers")),
        },
        _ => request.respond(refused(404, "not found")),
    };
    // A browser that has gone is no problem.
    drop(answered);
}

fn is_own_name(host: &str) -> bool {
    let name = host.rsplit_once(':').filter(|(_, port)| port.bytes().all(|byte| byte.is_ascii_digit()));
    ["127.0.0.1", "localhost", "[::1]"].contains(&name.map_or(host, |(name, _)| name))
}

/// Writes events as they come, until the browser or the run has gone.
fn stream(mut to: Box<dyn Write + Send>, events: &Receiver<Arc<str>>) {
    let head = "HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\nCache-Control: no-store\r\n\
                X-Content-Type-Options: nosniff\r\nConnection: close\r\n\r\n";
    let mut put = |text: &str| -> io::Result<()> { to.write_all(text.as_bytes()).and_then(|()| to.flush()) };
    let mut is_open = put(head).is_ok();
    while is_open {
        is_open = match events.recv_timeout(Duration::from_secs(5)) {
            Ok(text) => put(&text).is_ok(),
            // A comment shows whether a silent connection is still open.
            Err(RecvTimeoutError::Timeout) => put(":\n\n").is_ok(),
            Err(RecvTimeoutError::Disconnected) => false,
        };
    }
}

#[cfg(test)]
mod tests {
    use std::io::{BufRead, BufReader, Read};
    use std::net::TcpStream;

    use super::super::updates::tests::line;
    use super::*;
    use crate::scene::FrameId;

    fn request(page: &Page, path: &str, host: &str) -> BufReader<TcpStream> {
        let mut stream = TcpStream::connect(page.address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
        write!(stream, "GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").unwrap();
        BufReader::new(stream)
    }

    fn whole(page: &Page, path: &str, host: &str) -> String {
        let mut text = String::new();
        request(page, path, host).read_to_string(&mut text).unwrap();
        text
    }

    #[test]
    fn lines_and_frames_reach_a_browser() {
        let page = Page::open("127.0.0.1:0".parse().unwrap()).unwrap();
        let found = whole(&page, "/", "localhost:80");
        assert!(found.starts_with("HTTP/1.1 200") && found.contains("Content-Security-Policy: default-src 'none'"));
        assert!(found.contains("text/html; charset=utf-8") && found.contains("EventSource"));
        assert!(whole(&page, "/etc/passwd", "127.0.0.1").starts_with("HTTP/1.1 404"));
        assert!(whole(&page, "/", "rebound.example:80").starts_with("HTTP/1.1 403"));
        assert!(whole(&page, "/events", "rebound.example").starts_with("HTTP/1.1 403"));
        let events = request(&page, "/events", "127.0.0.1:1");
        let mut lines = events.lines().map(Result::unwrap);
        assert!(lines.any(|line| line == "Content-Type: text/event-stream"));
        let sent = line(1, 0.5);
        let text = serde_json::to_string(&sent).unwrap();
        page.take_line(&sent, &text);
        assert!(lines.any(|line| line == "event: line"));
        assert_eq!(lines.next().unwrap(), format!("data: {text}"));
        let frame = Frame { id: FrameId(7), name: String::new(), time_s: 0.5 };
        page.take_frame(&frame, &RgbImage::new(1920, 1080));
        assert!(lines.any(|line| line == "event: frame"));
        let data: serde_json::Value = serde_json::from_str(&lines.next().unwrap()["data: ".len()..]).unwrap();
        assert_eq!((data["frame"].as_u64(), data["width"].as_u64()), (Some(7), Some(1920)));
        let jpeg = data["image"].as_str().unwrap().strip_prefix("data:image/jpeg;base64,").unwrap();
        let image = ::image::load_from_memory(&STANDARD.decode(jpeg).unwrap()).unwrap();
        assert_eq!((image.width(), image.height()), (960, 540));
        drop(page);
        assert_eq!(lines.find(|line| line == "event: line"), None, "the stream ends with the run");
    }

    #[test]
    fn the_page_is_for_this_computer() {
        let of = |text: &str, is_public| text.parse::<PageAddress>().unwrap().check(is_public);
        assert!(
            of("127.0.0.1:8080", false).is_ok() && of("localhost:1", false).is_ok() && of("[::1]:1", false).is_ok()
        );
        assert!(of("0.0.0.0:8080", false).unwrap_err().contains("--page-public") && of("0.0.0.0:8080", true).is_ok());
        assert!("8080".parse::<PageAddress>().is_err() && "host:8080".parse::<PageAddress>().is_err());
        assert!(is_own_name("localhost") && is_own_name("[::1]:80") && !is_own_name("localhost.example:80"));
    }
}
