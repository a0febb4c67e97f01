//! Source of a live run: a pipe, a growing file, or a program `ffmpeg` that receives a network stream or a camera.
//!
//! The program itself opens no socket: of an address that the user names, `ffmpeg` copies the packets into a pipe.

use std::fs;
use std::io::{self, BufRead, BufReader, IsTerminal, Read};
use std::os::unix::fs::FileTypeExt;
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use anyhow::{Context, anyhow};

use super::super::lock;
use super::super::output::Failure;
use super::super::recording::STDIN;
use crate::checks::text::printable;
use crate::ffi::child::end_with_parent;
use crate::files;

/// The program that receives streams.
const FFMPEG: &str = "ffmpeg";
/// RTP has no decoding times, without which ffmpeg writes no frames out of order; it leaves out the first time as well.
/// Decoding precedes presentation by a second, as much as frames are out of order at most.
const DECODING_TIMES: &str = concat!(
    r"setts=pts=if(eq(PTS\,NOPTS)\,DTS-0.5/TB\,PTS)",
    r":dts=if(eq(PREV_OUTDTS\,NOPTS)\,DTS-1/TB\,max(PREV_OUTDTS+1\,PTS-1/TB))",
);
/// Time after which a stream that sends nothing has ended, microseconds. A running RTSP stream gets it twice.
const SILENCE_US: &str = "10000000";

/// An open source.
pub(super) struct Source {
    pub(super) input: Box<dyn Read + Send>,
    /// True for an ordinary file, which may still grow.
    pub(super) is_file: bool,
    /// Ends the program that receives the stream when this is dropped.
    pub(super) receiver: Option<Receiver>,
}

/// Kinds of sources that `ffmpeg` receives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stream {
    Rtsp,
    Udp,
    Camera,
}

/// Opens a source.
///
/// # Errors
/// One that cannot be read, a terminal, no `ffmpeg` for a stream.
pub(super) fn open(source: &Path) -> Result<Source, Failure> {
    if source == Path::new(STDIN) {
        if io::stdin().is_terminal() {
            return Err(Failure::Usage("-: standard input is a terminal; pipe a video into it".to_owned()));
        }
        return Ok(Source { input: Box::new(io::stdin()), is_file: false, receiver: None });
    }
    if let Some(stream) = stream(source) {
        return receive(source, stream);
    }
    let unreadable = || format!("{}: cannot be read", source.display());
    let is_pipe = fs::metadata(source).with_context(unreadable)?.file_type().is_fifo();
    let input = Box::new(files::open_stream(source).with_context(unreadable)?);
    Ok(Source { input, is_file: !is_pipe, receiver: None })
}

/// Kind of a network address or a device.
fn stream(source: &Path) -> Option<Stream> {
    let text = source.to_str()?;
    if text.starts_with("rtsp://") {
        Some(Stream::Rtsp)
    } else if text.starts_with("udp://") {
        Some(Stream::Udp)
    } else {
        let is_device = fs::metadata(source).is_ok_and(|found| found.file_type().is_char_device());
        (is_device && text.starts_with("/dev/video")).then_some(Stream::Camera)
    }
}

/// Arguments by which `ffmpeg` copies the packets of a stream, unchanged, to its standard output. Its protocols are
/// those of the address, and no others.
fn arguments(source: &str, stream: Stream) -> Vec<&str> {
    let mut all = vec!["-nostdin", "-hide_banner", "-loglevel", "error"];
    all.extend(match stream {
        Stream::Rtsp => {
            ["-protocol_whitelist", "rtsp,rtp,udp,tcp", "-rtsp_flags", "prefer_tcp", "-timeout", SILENCE_US].as_slice()
        }
        Stream::Udp => ["-protocol_whitelist", "udp,rtp", "-timeout", SILENCE_US].as_slice(),
        Stream::Camera => ["-f", "v4l2"].as_slice(),
    });
    // Matroska holds what cameras send, JPEG images and raw ones; a transport stream comes with less delay.
    let container = if stream == Stream::Camera { "matroska" } else { "mpegts" };
    if stream != Stream::Camera {
        // Half a second, instead of 5 s, before packets are passed on.
        all.extend(["-analyzeduration", "500000"]);
    }
    all.extend(["-i", source, "-map", "0:v:0", "-c", "copy"]);
    if stream == Stream::Rtsp {
        all.extend(["-bsf:v", DECODING_TIMES]);
    }
    all.extend(["-flush_packets", "1", "-f", container, "pipe:1"]);
    all
}

fn receive(source: &Path, stream: Stream) -> Result<Source, Failure> {
    let text = source.to_str().unwrap_or_default();
    let mut command = Command::new(FFMPEG);
    command.args(arguments(text, stream)).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    end_with_parent(&mut command);
    let mut child = match command.spawn() {
        Ok(child) => child,
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            let reason = "needs the program ffmpeg, which is not installed; install it, or pipe the stream into `-`";
            return Err(Failure::Input(anyhow!("{text}: {reason}")));
        }
        Err(error) => return Err(Failure::Input(anyhow!("{text}: {FFMPEG} cannot be started: {error}"))),
    };
    let (output, errors) = (child.stdout.take(), child.stderr.take());
    let (Some(output), Some(errors)) = (output, errors) else {
        return Err(Failure::Input(anyhow!("{text}: {FFMPEG} has no output")));
    };
    let last = Arc::new(Mutex::new(String::new()));
    let kept = last.clone();
    // Its last line says why it ended.
    let listening = thread::spawn(move || {
        for line in BufReader::new(errors).lines().map_while(Result::ok) {
            let line = printable(line.trim()).into_owned();
            tracing::debug!("{FFMPEG}: {line}");
            *lock(&kept) = line;
        }
    });
    let child = Arc::new(Mutex::new(child));
    let input = Received { output, child: child.clone(), last, listening: Some(listening) };
    Ok(Source { input: Box::new(input), is_file: false, receiver: Some(Receiver { child }) })
}

/// Standard output of `ffmpeg`. Its end is an error where it failed.
struct Received {
    output: ChildStdout,
    child: Arc<Mutex<Child>>,
    last: Arc<Mutex<String>>,
    listening: Option<JoinHandle<()>>,
}

impl Read for Received {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let count = self.output.read(bytes)?;
        if count > 0 || bytes.is_empty() {
            return Ok(count);
        }
        let Some(listening) = self.listening.take() else { return Ok(0) };
        // It closes both pipes at its end.
        drop(listening.join());
        let ended = lock(&self.child).wait()?;
        let last = lock(&self.last).clone();
        match ended.success() {
            true => Ok(0),
            false => Err(io::Error::other(format!("{FFMPEG}: {}", if last.is_empty() { "failed" } else { &last }))),
        }
    }
}

/// The program that receives a stream.
pub(super) struct Receiver {
    child: Arc<Mutex<Child>>,
}

impl Drop for Receiver {
    fn drop(&mut self) {
        let mut child = lock(&self.child);
        if child.try_wait().is_ok_and(|ended| ended.is_some()) {
            return;
        }
        if let Some(id) = rustix::process::Pid::from_raw(i32::try_from(child.id()).unwrap_or(0)) {
            let _ = rustix::process::kill_process(id, rustix::process::Signal::TERM);
        }
        // It may end by itself.
        thread::sleep(Duration::from_millis(200));
        drop(child.kill());
        drop(child.wait());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sources_are_recognized_by_their_beginning() {
        let of = |text: &str| stream(Path::new(text));
        assert_eq!((of("rtsp://camera/main"), of("udp://0.0.0.0:5600")), (Some(Stream::Rtsp), Some(Stream::Udp)));
        assert_eq!((of("/dev/video99"), of("video.mp4"), of("-"), of("/dev/null")), (None, None, None, None));
    }

    #[test]
    fn packets_are_copied_and_other_protocols_refused() {
        for (stream, protocols) in [(Stream::Rtsp, "rtsp,rtp,udp,tcp"), (Stream::Udp, "udp,rtp")] {
            let arguments = arguments("udp://127.0.0.1:1", stream);
            let after = |name: &str| arguments[arguments.iter().position(|found| *found == name).unwrap() + 1];
            assert_eq!((after("-protocol_whitelist"), after("-c"), after("-f")), (protocols, "copy", "mpegts"));
            assert_eq!((after("-i"), arguments.last()), ("udp://127.0.0.1:1", Some(&"pipe:1")));
            // An option after the input would be one of the output.
            let place = |name: &str| arguments.iter().position(|found| *found == name).unwrap();
            assert!(place("-analyzeduration") < place("-i") && place("-timeout") < place("-i"));
            assert_eq!(arguments.contains(&"-bsf:v"), stream == Stream::Rtsp);
        }
        assert!(arguments("/dev/video0", Stream::Camera).ends_with(&["-f", "matroska", "pipe:1"]));
    }
}
