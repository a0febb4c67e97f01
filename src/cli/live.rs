//! `tractrix live`: vehicles while the camera records. The source is recorded first, byte for byte; the recording is
//! followed while it grows, and run when it has ended.

mod cot;
#[cfg(feature = "live")]
mod mavlink;
#[cfg(feature = "live")]
mod mavlink_log;
#[cfg(feature = "live")]
mod network;
#[cfg(not(feature = "live"))]
#[path = "live/no_network.rs"]
mod network;
#[cfg(feature = "live")]
mod page;
mod source;
mod telemetry;
mod updates;

use std::fs::File;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow};

use super::Call;
use super::job::{JobArgs, resolve, use_machine};
use super::output::{Failure, Form};
use super::recording;
use super::run;
use super::terminal::TerminalProgress;
use crate::files::Growth;
use crate::live::{self, EndLine, Job, Order};
use crate::pipeline::{MaskChoice, Options, Progress, Stage, TelemetryChoice, check_map_points};
use cot::Cot;
use network::Network;
use source::Source;
use telemetry::Telemetry;
use updates::Updates;

/// Name of the file of results in the output folder.
const LINES: &str = "live.jsonl";
/// Bytes that are copied at once at most.
const CHUNK_BYTES: usize = 64 << 10;
/// A file that has not grown for so long has ended.
const END_OF_GROWTH: Duration = Duration::from_secs(3);
/// Wait for a file to grow.
const POLL: Duration = Duration::from_millis(20);

/// Flags of `live`.
#[derive(Debug, clap::Args)]
pub(super) struct LiveArgs {
    #[command(flatten)]
    job: JobArgs,
    /// Do not run on the recording when the source ends
    #[arg(long)]
    no_final_run: bool,
    /// Send a Cursor on Target event per georeferenced vehicle and second, to an address or into a file
    #[arg(long, value_name = "udp:HOST:PORT|FILE", help_heading = "Outputs while it records")]
    cot: Option<cot::Target>,
    #[command(flatten)]
    network: network::NetworkArgs,
}

/// Records a source, prints and writes its vehicles while it lasts, and runs on the recording.
///
/// # Errors
/// A source that cannot be read or decoded, an earlier recording without `--overwrite`, a full disk.
pub(super) fn run(args: &LiveArgs, call: Call) -> Result<(), Failure> {
    let job = &args.job;
    let (source, mut options) = resolve(job, Stage::Report)?;
    args.network.check()?;
    check_map_points(&options.metric).map_err(|error| Failure::Usage(error.to_string()))?;
    use_machine(&options)?;
    let recorded = follow(&source, args, &mut options, call)?;
    if let Some(signal) = call.talk.stopped_by() {
        let (path, output) = (recorded.display(), job.output.display());
        call.talk.say(&format!("stopped; run the recording with `tractrix run {path} --output {output}`"));
        return Err(Failure::Stopped(signal));
    }
    match args.no_final_run {
        true => Ok(()),
        false => run::run_on(&recorded, job, &options, Stage::Report, call),
    }
}

/// Follows a source to its end; gives the recording. Options name the recorded telemetry afterwards.
fn follow(source: &Path, args: &LiveArgs, options: &mut Options, call: Call) -> Result<PathBuf, Failure> {
    let Call { form, talk, .. } = call;
    let job = &args.job;
    let Source { mut input, is_file, receiver } = source::open(source)?;
    let folder = recording::own(&job.output)?;
    let earlier = recording::replaceable(&job.output, job.overwrite)?;
    let telemetry = match &options.metric.telemetry {
        TelemetryChoice::File(path) => Some(Telemetry::start(path, &job.output, job.overwrite)?),
        TelemetryChoice::Auto | TelemetryChoice::None => None,
    };
    let outputs = Outputs::open(args, talk)?;
    let (path, file) = recording::begin(&mut input, source, &job.output, &earlier)?;
    let mut lines = Lines::create(&job.output.join(LINES), form, outputs)?;
    let growth = Arc::new(Growth::default());
    let recorder = Recorder { input, file, growth: growth.clone(), grows: is_file };
    let shown = path.display().to_string();
    let copying = thread::Builder::new().name("recorder".into()).spawn(move || {
        if let Err(error) = recorder.copy() {
            tracing::error!("{shown}: recording failed: {error}; what was received before is there");
        }
    });
    copying.context("recorder cannot be started")?;
    talk.ends_in_order();
    // The small mask network is the only one that is fast enough.
    let mut own = options.clone();
    own.vehicles.mask_network = job.mask_network.unwrap_or(MaskChoice::Small);
    let feed = telemetry.as_ref().map(|telemetry| telemetry.feed.clone());
    let watch = lines.outputs.network.watch();
    let task =
        Job { recording: &path, growth, is_paced: is_file, telemetry: feed, watch: watch.as_deref(), options: &own };
    let stop = talk.stop();
    let order = || match (talk.is_stopped(), stop.has_ended_recording()) {
        (true, _) => Order::Stop,
        (false, true) => Order::EndRecording,
        (false, false) => Order::Continue,
    };
    stop.begin_recording();
    let found = live::run(&task, &mut |line| lines.write(line), &order);
    stop.complete_recording();
    if stop.has_ended_recording() {
        talk.say("recording ended by a signal; another one stops the program");
    }
    drop((folder, receiver));
    if let Some(telemetry) = &telemetry {
        // Where nothing came, the run has none either.
        let choice = telemetry.finish().map(|path| TelemetryChoice::File(path.to_owned()));
        options.metric.telemetry = choice.unwrap_or(TelemetryChoice::None);
    }
    match found {
        Ok(end) => talk.say(&in_words(&end)),
        Err(error) if talk.stopped_by().is_some() => tracing::error!("{error}"),
        Err(error) => return Err(Failure::Input(anyhow!("{}: {error}", source.display()))),
    }
    Ok(path)
}

/// Receivers of lines other than the file and stdout; none is open unless its flag is given.
struct Outputs {
    updates: Updates,
    cot: Option<Cot>,
    network: Network,
}

impl Outputs {
    fn open(args: &LiveArgs, talk: &TerminalProgress) -> anyhow::Result<Self> {
        let name = args.job.output.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let cot = args.cot.as_ref().map(|target| Cot::open(target, &name)).transpose()?;
        let network = Network::open(&args.network)?;
        if let Some(url) = network.url() {
            talk.say(&format!("page: {url}"));
        }
        Ok(Self { updates: Updates::default(), cot, network })
    }

    fn take(&mut self, line: &live::Line, text: &str) {
        self.network.take_line(line, text);
        let Some((vehicle, geo)) = self.updates.due(line) else { return };
        if let Some(cot) = &mut self.cot {
            cot.send(vehicle, geo);
        }
        self.network.send(vehicle, geo);
    }
}

/// Copies a source into the recording.
struct Recorder {
    input: Box<dyn Read + Send>,
    file: File,
    growth: Arc<Growth>,
    /// True if the end of the input is not that of the source.
    grows: bool,
}

impl Recorder {
    fn copy(mut self) -> io::Result<()> {
        // A receiving program is ended with the recording, which is no failure.
        let copied = self.copy_all().or_else(|error| if self.growth.is_finished() { Ok(()) } else { Err(error) });
        let synced = self.file.sync_all();
        self.growth.finish();
        copied.and(synced)
    }

    fn copy_all(&mut self) -> io::Result<()> {
        let mut chunk = vec![0; CHUNK_BYTES];
        let mut grown = Instant::now();
        loop {
            match self.input.read(&mut chunk) {
                Ok(0) if self.grows && grown.elapsed() < END_OF_GROWTH && !self.growth.is_finished() => {
                    thread::sleep(POLL);
                }
                Ok(0) => return Ok(()),
                Ok(count) => {
                    let Self { file, growth, .. } = self;
                    if !growth.grow(|| file.write_all(&chunk[..count]))? {
                        return Ok(());
                    }
                    grown = Instant::now();
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
    }
}

/// Result lines: to the file, and to stdout as long as somebody reads it.
struct Lines {
    file: File,
    stdout: Option<io::Stdout>,
    outputs: Outputs,
}

impl Lines {
    fn create(path: &Path, form: Form, outputs: Outputs) -> anyhow::Result<Self> {
        let file = File::create(path).with_context(|| format!("{}: cannot be written", path.display()))?;
        Ok(Self { file, stdout: (form != Form::Nothing).then(io::stdout), outputs })
    }

    /// Writes a line with one call each, so that a process that is killed leaves whole lines.
    fn write(&mut self, line: &live::Line) -> io::Result<()> {
        let text = serde_json::to_string(line).map_err(io::Error::from)? + "\n";
        self.file.write_all(text.as_bytes())?;
        if let Some(stdout) = &mut self.stdout
            && let Err(error) = stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush())
        {
            if error.kind() != io::ErrorKind::BrokenPipe {
                return Err(error);
            }
            self.stdout = None;
        }
        self.outputs.take(line, &text);
        Ok(())
    }
}

fn in_words(end: &EndLine) -> String {
    let EndLine { t, frames, dropped, skipped, registered, maps, mean_ms: [perception, points, positions] } = end;
    format!(
        "live: {t:.1} s, {frames} frames processed ({registered} registered), {dropped} dropped, {skipped} skipped, \
         {maps} maps; per frame {perception:.0} + {points:.0} + {positions:.0} ms (perception, points, positions)"
    )
}
