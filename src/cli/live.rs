//! `tractrix live`: vehicles while the camera records. The source is recorded first, byte for byte; the recording is
//! followed while it grows, and run when it has ended.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, IsTerminal, Read, Write};
use std::os::unix::fs::FileTypeExt;
use std::path::Path;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow};

use super::job::{JobArgs, resolve, use_machine};
use super::output::{Failure, Form};
use super::recording::{self, STDIN};
use super::run;
use super::terminal::TerminalProgress;
use crate::files::{self, Growth};
use crate::live::{self, EndLine, Job};
use crate::pipeline::{MaskChoice, Options, Progress, Stage};

/// Name of the file of results in the output folder.
const LINES: &str = "live.jsonl";
/// Bytes that are copied at once at most.
const CHUNK_BYTES: usize = 64 << 10;
/// A file that has not grown for so long has ended.
const END_OF_GROWTH: Duration = Duration::from_secs(3);
/// Longer side at which optical flow is estimated, pixels.
const FLOW_PX: u32 = 640;
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
}

/// Records a source, prints and writes its vehicles while it lasts, and runs on the recording.
///
/// # Errors
/// A source that cannot be read or decoded, an earlier recording without `--overwrite`, a full disk.
pub(super) fn run(args: &LiveArgs, arguments: &[OsString], form: Form, talk: &TerminalProgress) -> Result<(), Failure> {
    let job = &args.job;
    let (source, options) = resolve(job, Stage::Report)?;
    use_machine(&options)?;
    let recorded = follow(&source, job, &options, form, talk)?;
    if let Some(signal) = talk.stopped_by() {
        let (path, output) = (recorded.display(), job.output.display());
        talk.say(&format!("stopped; run the recording with `tractrix run {path} --output {output}`"));
        return Err(Failure::Stopped(signal));
    }
    match args.no_final_run {
        true => Ok(()),
        false => run::run_on(&recorded, job, &options, Stage::Report, arguments, form, talk),
    }
}

/// Follows a source to its end; gives the recording.
fn follow(
    source: &Path,
    job: &JobArgs,
    options: &Options,
    form: Form,
    talk: &TerminalProgress,
) -> Result<std::path::PathBuf, Failure> {
    let (mut input, is_file) = open(source)?;
    let folder = recording::own(&job.output)?;
    let earlier = recording::replaceable(&job.output, job.overwrite)?;
    let (path, file) = recording::begin(&mut input, source, &job.output, &earlier)?;
    let mut lines = Lines::create(&job.output.join(LINES), form)?;
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
    let mut options = options.clone();
    options.vehicles.mask_network = job.mask_network.unwrap_or(MaskChoice::Small);
    // Flow at two thirds of the usual size takes half the time.
    options.flow.max_dimension = options.flow.max_dimension.min(FLOW_PX);
    let telemetry = None;
    let task = Job { recording: &path, growth, is_paced: is_file, telemetry, options: &options };
    let found = live::run(&task, &mut |line| lines.write(line), &|| talk.is_stopped());
    drop(folder);
    match found {
        Ok(end) => talk.say(&in_words(&end)),
        Err(error) if talk.stopped_by().is_some() => tracing::error!("{error}"),
        Err(error) => return Err(Failure::Input(anyhow!("{}: {error}", source.display()))),
    }
    Ok(path)
}

/// Opens a source; says whether it is an ordinary file, which may still grow.
fn open(source: &Path) -> Result<(Box<dyn Read + Send>, bool), Failure> {
    if source == Path::new(STDIN) {
        if io::stdin().is_terminal() {
            return Err(Failure::Usage("-: standard input is a terminal; pipe a video into it".to_owned()));
        }
        return Ok((Box::new(io::stdin()), false));
    }
    let unreadable = || format!("{}: cannot be read", source.display());
    let is_pipe = fs::metadata(source).with_context(unreadable)?.file_type().is_fifo();
    Ok((Box::new(files::open_stream(source).with_context(unreadable)?), !is_pipe))
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
        let copied = self.copy_all();
        let synced = self.file.sync_all();
        self.growth.finish();
        copied.and(synced)
    }

    fn copy_all(&mut self) -> io::Result<()> {
        let mut chunk = vec![0; CHUNK_BYTES];
        let mut grown = Instant::now();
        loop {
            match self.input.read(&mut chunk) {
                Ok(0) if self.grows && grown.elapsed() < END_OF_GROWTH => thread::sleep(POLL),
                Ok(0) => return Ok(()),
                Ok(count) => {
                    self.file.write_all(&chunk[..count])?;
                    self.growth.grow();
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
}

impl Lines {
    fn create(path: &Path, form: Form) -> anyhow::Result<Self> {
        let file = File::create(path).with_context(|| format!("{}: cannot be written", path.display()))?;
        Ok(Self { file, stdout: (form != Form::Nothing).then(io::stdout) })
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
