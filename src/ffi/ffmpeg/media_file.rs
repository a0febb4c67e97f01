//! A container: its streams, and the packets that they consist of.

use std::ffi::{CStr, c_int};
use std::path::Path;
use std::ptr;
use std::sync::Arc;

use ffmpeg_sys_the_third as sys;

use super::formats::{self, Admission};
use super::input::{self, Input};
use super::{Decoder, FfmpegError, checked, is_short_of_memory, stated, url_of, words};
use crate::files::Growth;

/// Time of a growing file, microseconds, that FFmpeg examines before the first frame; its default of 5 s would delay
/// everything by as much.
const PROBED_US: &CStr = c"500000";

/// Errors in a row after which a file is taken to be at its end.
const MAX_READ_ERRORS: u32 = 64;

/// Seconds per tick, as a fraction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TimeBase {
    /// Numerator.
    pub num: i32,
    /// Denominator, not zero.
    pub den: i32,
}

impl TimeBase {
    /// A number of ticks in seconds.
    pub fn seconds(self, ticks: i64) -> f64 {
        (ticks as f64 * f64::from(self.num)) / f64::from(self.den)
    }
}

/// Coding of the text in the packets of a text track.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TextCoding {
    /// The text itself.
    Plain,
    /// MP4's timed text (3GPP TS 26.245): two bytes of length, the text, then boxes of style.
    Timed,
    /// Advanced SubStation Alpha: eight fields and commas before the text.
    SubStation,
}

/// Content of a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StreamKind {
    /// Moving pictures.
    Video,
    /// A single image that belongs to the file, such as a cover, or thumbnails of the video.
    Cover,
    /// Sound.
    Sound,
    /// Text with times.
    Text(TextCoding),
    /// Telemetry of an action camera, in MP4 and MOV.
    Gpmf,
    /// Anything else.
    Other,
}

/// Properties of a stream, as its container states them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stream {
    /// Place in the file, from 0.
    pub index: usize,
    /// Content.
    pub kind: StreamKind,
    /// Unit of its time stamps.
    pub time_base: TimeBase,
    /// Time stamp of its beginning.
    pub start: Option<i64>,
    /// Packets that the container counts in it and shows: those that an edit list hides are not among them.
    pub num_packets: Option<u64>,
    /// Length, seconds.
    pub duration_s: Option<f64>,
    /// Pictures per second: the container's nominal rate, or what its first packets show.
    pub rate: Option<f64>,
    /// Degrees clockwise by which its pictures are to be turned, from 0 to 359.
    pub rotation_deg: i32,
    /// Two fields per frame, as declared by the container or its first packets.
    pub is_interlaced: bool,
}

impl Stream {
    /// Beginning on the container's clock, seconds; 0 where it is not stated.
    pub fn start_s(&self) -> f64 {
        self.start.map_or(0.0, |ticks| self.time_base.seconds(ticks))
    }
}

/// A piece of a stream. It holds its data until the next one is read into it.
pub struct Packet {
    pub(super) packet: *mut sys::AVPacket,
}

// SAFETY: the packet and its data are owned, and no thread but the owner's touches them.
#[allow(unsafe_code)]
unsafe impl Send for Packet {}

#[allow(unsafe_code)]
impl Packet {
    /// A packet that holds nothing yet.
    ///
    /// # Errors
    /// [`FfmpegError::Memory`].
    pub fn new() -> Result<Self, FfmpegError> {
        // SAFETY: allocates, or returns null.
        let packet = unsafe { sys::av_packet_alloc() };
        if packet.is_null() { Err(FfmpegError::Memory) } else { Ok(Self { packet }) }
    }

    /// The stream that it belongs to.
    pub fn stream(&self) -> usize {
        // SAFETY: the packet is allocated as long as `self` lives.
        usize::try_from(unsafe { (*self.packet).stream_index }).unwrap_or(usize::MAX)
    }

    /// When it is to be shown, in ticks of its stream.
    pub fn time(&self) -> Option<i64> {
        // SAFETY: as above.
        stated(unsafe { (*self.packet).pts })
    }

    /// For how long, in ticks of its stream; 0 if it does not say.
    pub fn duration(&self) -> i64 {
        // SAFETY: as above.
        unsafe { (*self.packet).duration }.max(0)
    }

    /// Its content.
    pub fn data(&self) -> &[u8] {
        // SAFETY: as above; `data` is null or points to `size` bytes that the packet owns.
        unsafe {
            let (data, size) = ((*self.packet).data, (*self.packet).size);
            if data.is_null() { &[] } else { std::slice::from_raw_parts(data, usize::try_from(size).unwrap_or(0)) }
        }
    }
}

#[allow(unsafe_code)]
impl Drop for Packet {
    fn drop(&mut self) {
        // SAFETY: was allocated by `new`, and is freed once.
        unsafe { sys::av_packet_free(&mut self.packet) }
    }
}

/// An open container.
pub struct MediaFile {
    context: *mut sys::AVFormatContext,
    /// The stream whose packets are read; `None` for all.
    kept: Option<usize>,
    /// Read by the context, and closed after it.
    _input: Input,
}

// SAFETY: the context is owned and has no ties to the thread that made it.
#[allow(unsafe_code)]
unsafe impl Send for MediaFile {}

#[allow(unsafe_code)]
impl MediaFile {
    /// Opens a file and looks at its head and its first packets. No other file is opened, whatever the container says.
    ///
    /// # Errors
    /// [`FfmpegError::Open`] where FFmpeg does not know it or finds it broken, or it is not a format of one file;
    /// [`FfmpegError::Playlist`].
    pub fn open(path: &Path) -> Result<Self, FfmpegError> {
        Self::open_as(path, None)
    }

    /// As [`MediaFile::open`], of a file that is still written. Reading waits for data at its end.
    ///
    /// # Errors
    /// As [`MediaFile::open`].
    pub fn open_growing(path: &Path, growth: Arc<Growth>) -> Result<Self, FfmpegError> {
        Self::open_as(path, Some(growth))
    }

    fn open_as(path: &Path, growth: Option<Arc<Growth>>) -> Result<Self, FfmpegError> {
        let is_growing = growth.is_some();
        let url = url_of(path).ok_or_else(|| FfmpegError::Open("path contains a zero byte".to_owned()))?;
        let refused = |code| FfmpegError::Open(words(code));
        let input = Input::open(path, growth)?;
        let format = probe(&input, &url)?;
        // SAFETY: allocates, or returns null.
        let mut context = unsafe { sys::avformat_alloc_context() };
        if context.is_null() {
            return Err(FfmpegError::Memory);
        }
        // SAFETY: the context is new; the strings end in a zero byte and outlive the calls; where opening fails, FFmpeg
        // frees the context and leaves the input alone.
        let opened = unsafe {
            (*context).pb = input.context;
            (*context).io_open = Some(input::refuse);
            let mut options = ptr::null_mut();
            // No protocol has this name: a demuxer that does not ask `io_open` opens nothing either.
            sys::av_dict_set(&mut options, c"protocol_whitelist".as_ptr(), c"none".as_ptr(), 0);
            if is_growing {
                sys::av_dict_set(&mut options, c"analyzeduration".as_ptr(), PROBED_US.as_ptr(), 0);
            }
            let opened = sys::avformat_open_input(&mut context, url.as_ptr(), format, &mut options);
            sys::av_dict_free(&mut options);
            opened
        };
        checked(opened).map_err(refused)?;
        let file = Self { context, kept: None, _input: input };
        // SAFETY: the context is open; it is closed when `file` is dropped.
        checked(unsafe { sys::avformat_find_stream_info(file.context, ptr::null_mut()) }).map_err(refused)?;
        Ok(file)
    }

    /// Value of the container's metadata under a key.
    pub fn metadata(&self, key: &CStr) -> Option<String> {
        // SAFETY: the context is open; an entry belongs to it, and its value ends in a zero byte.
        unsafe {
            let entry = sys::av_dict_get((*self.context).metadata, key.as_ptr(), ptr::null(), 0);
            entry.as_ref().map(|entry| CStr::from_ptr(entry.value).to_string_lossy().into_owned())
        }
    }

    /// All streams, in the order of the file.
    pub fn streams(&self) -> Vec<Stream> {
        // SAFETY: the context is open.
        let count = unsafe { (*self.context).nb_streams } as usize;
        (0..count).map(|index| self.stream(index)).collect()
    }

    /// Reads the packets of one stream only.
    pub fn keep_only(&mut self, index: usize) {
        self.kept = Some(index);
        for stream in self.streams() {
            let discard = if stream.index == index { sys::AVDiscard::DEFAULT } else { sys::AVDiscard::ALL };
            // SAFETY: the stream is one of the context's.
            unsafe { (*self.raw_stream(stream.index)).discard = discard }
        }
    }

    /// Reads the next packet, of the stream that is kept, if one is; `false` at the end, or where nothing more can be
    /// read.
    ///
    /// # Errors
    /// [`FfmpegError::Memory`].
    pub fn read(&mut self, packet: &mut Packet) -> Result<bool, FfmpegError> {
        let mut num_errors = 0;
        loop {
            // SAFETY: context and packet are allocated; what the packet held is given back first.
            let code = unsafe {
                sys::av_packet_unref(packet.packet);
                sys::av_read_frame(self.context, packet.packet)
            };
            match checked(code) {
                // Packets that FFmpeg buffered while probing come first, also those of streams discarded since.
                Ok(_) if self.kept.is_some_and(|kept| kept != packet.stream()) => num_errors = 0,
                Ok(_) => return Ok(true),
                Err(sys::AVERROR_EOF) => return Ok(false),
                Err(code) if is_short_of_memory(code) => return Err(FfmpegError::Memory),
                Err(_) => num_errors += 1,
            }
            if num_errors > MAX_READ_ERRORS {
                return Ok(false);
            }
        }
    }

    /// Width of a pixel over its height, as a fraction, of the frame that a decoder of the stream is at: what the
    /// container states, else what the frame does; `None` where neither says anything.
    pub fn pixel_aspect(&self, stream: usize, decoder: &Decoder) -> Option<(u32, u32)> {
        // SAFETY: context, stream and frame are valid; the call only reads them.
        let aspect = unsafe { sys::av_guess_sample_aspect_ratio(self.context, self.raw_stream(stream), decoder.frame) };
        let part = |value| u32::try_from(value).ok().filter(|value| *value > 0);
        Some((part(aspect.num)?, part(aspect.den)?))
    }

    /// Parameters for a stream's decoder.
    pub(super) fn parameters(&self, index: usize) -> *const sys::AVCodecParameters {
        // SAFETY: the stream is one of the context's, and every stream has parameters.
        unsafe { (*self.raw_stream(index)).codecpar }
    }

    /// # Panics
    /// If there is no such stream.
    fn raw_stream(&self, index: usize) -> *mut sys::AVStream {
        // SAFETY: `streams` points to `nb_streams` streams, and `index` is below.
        unsafe {
            assert!(index < (*self.context).nb_streams as usize, "stream {index} is not one of the file's");
            *(*self.context).streams.add(index)
        }
    }

    fn stream(&self, index: usize) -> Stream {
        let stream = self.raw_stream(index);
        // SAFETY: stream and parameters are valid as long as the context is open.
        let (base, start, length, whole_length, rate, field_order) = unsafe {
            let rate = sys::av_guess_frame_rate(self.context, stream, ptr::null_mut());
            let field_order = (*(*stream).codecpar).field_order;
            let stream = &*stream;
            (stream.time_base, stream.start_time, stream.duration, (*self.context).duration, rate, field_order)
        };
        let time_base = TimeBase { num: base.num, den: base.den.max(1) };
        let whole = || stated(whole_length).map(|length| length as f64 / f64::from(sys::AV_TIME_BASE));
        Stream {
            index,
            kind: kind(stream),
            time_base,
            start: stated(start),
            num_packets: self.num_packets(stream),
            duration_s: stated(length).map(|length| time_base.seconds(length)).or_else(whole),
            rate: (rate.num > 0 && rate.den > 0).then(|| f64::from(rate.num) / f64::from(rate.den)),
            rotation_deg: rotation_deg(stream),
            is_interlaced: is_interlaced(field_order),
        }
    }

    /// Packets that are stated and shown. The index of an MP4 or MOV file has an entry for each that its edit list
    /// leaves, with a mark at those that are only there to be decoded.
    fn num_packets(&self, stream: *mut sys::AVStream) -> Option<u64> {
        // SAFETY: the stream is one of the context's; entries are read below their count.
        let (stated, entries) = unsafe { ((*stream).nb_frames, sys::avformat_index_get_entries_count(stream)) };
        let stated = u64::try_from(stated).ok().filter(|count| *count > 0)?;
        // SAFETY: an open context has a format, whose name is a constant.
        let format = unsafe { CStr::from_ptr((*(*self.context).iformat).name) };
        if !format.to_bytes().starts_with(b"mov,") || entries <= 0 {
            return Some(stated);
        }
        let is_shown = |&entry: &c_int| {
            // SAFETY: as above.
            let entry = unsafe { sys::avformat_index_get_entry(stream, entry).as_ref() };
            entry.is_some_and(|entry| entry.flags() & sys::AVINDEX_DISCARD_FRAME == 0)
        };
        Some((0..entries).filter(is_shown).count() as u64).filter(|shown| *shown > 0)
    }
}

#[allow(unsafe_code)]
impl Drop for MediaFile {
    fn drop(&mut self) {
        // SAFETY: was opened by `open`, and is closed once.
        unsafe { sys::avformat_close_input(&mut self.context) }
    }
}

/// Finds out the container format of a file.
///
/// # Errors
/// [`FfmpegError::Open`], [`FfmpegError::Playlist`].
#[allow(unsafe_code)]
fn probe(input: &Input, url: &CStr) -> Result<*const sys::AVInputFormat, FfmpegError> {
    let mut format = ptr::null();
    // SAFETY: reads from the open input and rewinds it; the URL ends in a zero byte, and its extension is looked at.
    let probed =
        unsafe { sys::av_probe_input_buffer2(input.context, &mut format, url.as_ptr(), ptr::null_mut(), 0, 0) };
    checked(probed).map_err(|code| FfmpegError::Open(words(code)))?;
    // SAFETY: a format that was found has a name, which is a constant.
    let name = unsafe { CStr::from_ptr((*format).name) }.to_string_lossy();
    match formats::admission(&name) {
        Admission::Open => Ok(format),
        Admission::Playlist => Err(FfmpegError::Playlist(name.into_owned())),
        Admission::Refuse => Err(FfmpegError::Open(format!("{name} is not a video format"))),
    }
}

fn is_interlaced(order: sys::AVFieldOrder) -> bool {
    use sys::AVFieldOrder as Order;
    matches!(order, Order::TT | Order::BB | Order::TB | Order::BT)
}

/// Dispositions of streams of single images.
const NO_VIDEO: c_int = (sys::AV_DISPOSITION_ATTACHED_PIC
    | sys::AV_DISPOSITION_TIMED_THUMBNAILS
    | sys::AV_DISPOSITION_STILL_IMAGE) as c_int;

#[allow(unsafe_code)]
fn kind(stream: *const sys::AVStream) -> StreamKind {
    // SAFETY: the caller's stream is valid, and has parameters.
    let (medium, codec, tag, disposition) = unsafe {
        let parameters = &*(*stream).codecpar;
        (parameters.codec_type, parameters.codec_id, parameters.codec_tag, (*stream).disposition)
    };
    match medium {
        sys::AVMediaType::VIDEO if disposition & NO_VIDEO != 0 => StreamKind::Cover,
        sys::AVMediaType::VIDEO => StreamKind::Video,
        sys::AVMediaType::AUDIO => StreamKind::Sound,
        sys::AVMediaType::SUBTITLE => text_coding(codec).map_or(StreamKind::Other, StreamKind::Text),
        _ if tag == u32::from_le_bytes(*b"gpmd") => StreamKind::Gpmf,
        _ => StreamKind::Other,
    }
}

fn text_coding(codec: sys::AVCodecID) -> Option<TextCoding> {
    use sys::AVCodecID as Id;
    match codec {
        Id::SUBRIP | Id::TEXT | Id::WEBVTT => Some(TextCoding::Plain),
        Id::MOV_TEXT => Some(TextCoding::Timed),
        Id::ASS => Some(TextCoding::SubStation),
        _ => None,
    }
}

/// The rotation that the stream's display matrix asks for.
#[allow(unsafe_code)]
fn rotation_deg(stream: *const sys::AVStream) -> i32 {
    let mut matrix = [0_i32; 9];
    let (data, size) = display_matrix(stream);
    if data.is_null() || size < size_of_val(&matrix) {
        return 0;
    }
    // SAFETY: `data` points to `size` bytes, of which there are enough; both functions read the matrix alone.
    let counterclockwise_deg = unsafe {
        ptr::copy_nonoverlapping(data, matrix.as_mut_ptr().cast::<u8>(), size_of_val(&matrix));
        sys::av_display_rotation_get(matrix.as_ptr())
    };
    if counterclockwise_deg.is_finite() { (-counterclockwise_deg.round() as i32).rem_euclid(360) } else { 0 }
}

/// Where the display matrix lies, and its size in bytes; null if there is none.
#[cfg(ffmpeg_6_1)]
#[allow(unsafe_code)]
fn display_matrix(stream: *const sys::AVStream) -> (*const u8, usize) {
    // SAFETY: the caller's stream is valid; the parameters' array has the length that stands next to it.
    unsafe {
        let parameters = &*(*stream).codecpar;
        let (all, count) = (parameters.coded_side_data, parameters.nb_coded_side_data);
        let found = sys::av_packet_side_data_get(all, count, sys::AVPacketSideDataType::DISPLAYMATRIX);
        if found.is_null() { (ptr::null(), 0) } else { ((*found).data, (*found).size) }
    }
}

/// Where the display matrix lies, and its size in bytes; null if there is none.
#[cfg(not(ffmpeg_6_1))]
#[allow(unsafe_code)]
fn display_matrix(stream: *const sys::AVStream) -> (*const u8, usize) {
    let mut size = 0;
    // SAFETY: the caller's stream is valid; the call writes the size next to the pointer that it gives.
    let data = unsafe { sys::av_stream_get_side_data(stream, sys::AVPacketSideDataType::DISPLAYMATRIX, &mut size) };
    (data, size)
}
