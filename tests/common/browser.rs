//! A headless Chromium, driven through its DevTools protocol: a test waits for what the page says of itself, and no
//! clock of the browser runs out before.

use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use base64::Engine;
use image::RgbImage;
use serde_json::{Value, json};
use tungstenite::{Message, WebSocket};

/// Longest wait for an answer or a page: far more than any machine needs.
const PATIENCE: Duration = Duration::from_secs(120);
const POLL: Duration = Duration::from_millis(50);
/// The browser's own messages, in its profile.
const LOG: &str = "log";

/// Chromium, if there is one.
pub fn installed() -> Option<PathBuf> {
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

/// A browser of its own with an empty profile and one page.
pub struct Browser {
    process: Child,
    profile: tempfile::TempDir,
    socket: WebSocket<TcpStream>,
    session: Option<String>,
    last_id: u64,
    /// Messages of the console, errors of scripts and of the policy.
    pub messages: Vec<String>,
}

impl Browser {
    /// Opens a page in a window of `size` pixels and waits until it is ready (`data-ready` of its root).
    pub fn open(program: &Path, flags: &[&str], page: &Path, fragment: &str, size: [u32; 2]) -> Self {
        let profile = tempfile::tempdir().expect("a temporary folder");
        let log = std::fs::File::create(profile.path().join(LOG)).expect("the log can be written");
        let process = Command::new(program)
            .args(["--headless=new", "--no-sandbox", "--no-first-run", "--disable-extensions", "--hide-scrollbars"])
            .args(["--disable-background-networking", "--disable-dev-shm-usage", "--remote-debugging-port=0"])
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .args(flags)
            .arg("about:blank")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(log)
            .spawn()
            .expect("the browser starts");
        let socket = connect(profile.path());
        let mut browser = Self { process, profile, socket, session: None, last_id: 0, messages: Vec::new() };
        let target = browser.call("Target.createTarget", json!({ "url": "about:blank" }));
        let session = browser.call("Target.attachToTarget", json!({ "targetId": target["targetId"], "flatten": true }));
        browser.session = Some(session["sessionId"].as_str().expect("a session has a name").to_owned());
        let window = json!({ "width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": false });
        browser.call("Emulation.setDeviceMetricsOverride", window);
        for domain in ["Runtime", "Log"] {
            browser.call(&format!("{domain}.enable"), json!({}));
        }
        browser.call("Page.navigate", json!({ "url": format!("file://{}{fragment}", page.display()) }));
        let ready = "new Promise((resolve) => { const wait = () => document.documentElement?.dataset.ready \
            ? resolve('ready') : setTimeout(wait, 20); wait(); })";
        assert_eq!(browser.value_of(ready), "ready");
        browser
    }

    /// What a script finds on the page: the body of an asynchronous function that returns a text.
    pub fn find(&mut self, script: &str) -> String {
        self.value_of(&format!("(async () => {{ {script} }})()"))
    }

    pub fn screenshot(&mut self) -> RgbImage {
        let picture = self.call("Page.captureScreenshot", json!({ "format": "png" }));
        let encoded = picture["data"].as_str().expect("a screenshot has data");
        let png = base64::engine::general_purpose::STANDARD.decode(encoded).expect("it is Base64");
        image::load_from_memory(&png).expect("it is a PNG").to_rgb8()
    }

    /// The text that an expression, or the promise that it is, gives.
    fn value_of(&mut self, expression: &str) -> String {
        let answer = self.call("Runtime.evaluate", json!({ "expression": expression, "awaitPromise": true }));
        let value = answer["result"]["value"].as_str();
        value.unwrap_or_else(|| panic!("the script gave no text: {answer}\n{}", self.log())).to_owned()
    }

    /// The result of a method of the protocol. What the page reports meanwhile is kept.
    fn call(&mut self, method: &str, parameters: Value) -> Value {
        self.last_id += 1;
        let mut request = json!({ "id": self.last_id, "method": method, "params": parameters });
        if let Some(session) = &self.session {
            request["sessionId"] = session.as_str().into();
        }
        self.socket.send(Message::text(request.to_string())).expect("the browser listens");
        loop {
            let message = self.socket.read().unwrap_or_else(|e| panic!("{method}: {e}\n{}", self.log()));
            let Message::Text(text) = message else { continue };
            let mut message: Value = serde_json::from_str(&text).expect("the browser speaks JSON");
            if message["id"] == self.last_id {
                assert!(message.get("error").is_none(), "{method}: {message}");
                return message["result"].take();
            }
            if let Some("Runtime.consoleAPICalled" | "Runtime.exceptionThrown" | "Log.entryAdded") =
                message["method"].as_str()
            {
                self.messages.push(message["params"].to_string());
            }
        }
    }

    fn log(&self) -> String {
        log_in(self.profile.path())
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // The browser ends its own processes, which a signal would leave behind.
        let close = json!({ "id": self.last_id + 1, "method": "Browser.close" });
        if self.socket.send(Message::text(close.to_string())).is_err() {
            _ = self.process.kill();
        }
        _ = self.process.wait();
    }
}

fn log_in(profile: &Path) -> String {
    std::fs::read_to_string(profile.join(LOG)).unwrap_or_default()
}

/// A connection to the browser, which writes its port and address into its profile once it listens.
fn connect(profile: &Path) -> WebSocket<TcpStream> {
    let start = Instant::now();
    loop {
        let written = std::fs::read_to_string(profile.join("DevToolsActivePort")).unwrap_or_default();
        if let Some((port, path)) = written.split_once('\n')
            && !path.is_empty()
        {
            let host = format!("127.0.0.1:{port}");
            let stream = TcpStream::connect(&host).expect("the browser listens");
            stream.set_read_timeout(Some(PATIENCE)).expect("a time limit can be set");
            return tungstenite::client(format!("ws://{host}{path}"), stream).expect("the browser answers").0;
        }
        assert!(start.elapsed() < PATIENCE, "the browser did not start\n{}", log_in(profile));
        std::thread::sleep(POLL);
    }
}
