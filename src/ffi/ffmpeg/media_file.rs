//! Containers, their streams and packets.

use std::ffi::{CStr, c_int};
use std::path::Path;
use std::ptr;
use std::sync::Arc;

use ffmpeg_sys_the_third as sys;

use super::formats::{self, Admission};
use super::input::{self, Input};
use super::{Decoder, FfmpegError, checked, is_short_of_memory, stated, url_of, words};
use crate::files::Growth;

/// Duration of a growing file that FFmpeg analyzes before the first frame, microseconds.
///
/// FFmpeg's default of 5 s would delay everything by as much.
const PROBED_US: &CStr = c"500000";

/// Number of consecutive read errors that count as the end of a file.
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
    /// Converts ticks to seconds.
    pub fn seconds(self, ticks: i64) -> f64 {
        (ticks as f64 * f64::from(self.num)) / f64::from(self.den)
    }
}

/// Encoding of the text in the packets of a text track.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TextCoding {
    /// Plain text.
    Plain,
    /// MP4's timed text (3GPP TS 26.245): two bytes of length, the text, then boxes of style.
    Timed,
    /// Advanced SubStation Alpha: eight fields and commas before the text.
    SubStation,
}

/// Content of a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StreamKind {
    /// Video.
    Video,
    /// A single image attached to the file, such as a cover, or thumbnails of the video.
    Cover,
    /// Sound.
    Sound,
    /// Timed text.
    Text(TextCoding),
    /// Telemetry of an action camera, in MP4 and MOV.
    Gpmf,
    /// Anything else.
    Other,
}

/// Properties of a stream, as declared by its container.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stream {
    /// Index in the file, from 0.
    pub index: usize,
    /// Content.
    pub kind: StreamKind,
    /// Unit of its time stamps.
    pub time_base: TimeBase,
    /// Start time stamp.
    pub start: Option<i64>,
    /// Number of presented packets according to the container; packets hidden by an edit list are not counted.
    pub num_packets: Option<u64>,
    /// Duration, seconds.
    pub duration_s: Option<f64>,
    /// Frames per second: the container's nominal rate, or that of its first packets.
    pub rate: Option<f64>,
    /// Rotation to be applied to its images, degrees clockwise, from 0 to 359.
    pub rotation_deg: i32,
    /// True if the container or its first packets declare two fields per frame.
    pub is_interlaced: bool,
}

impl Stream {
    /// Start time on the container's clock, seconds; 0 if it is not declared.
    pub fn start_s(&self) -> f64 {
        self.start.map_or(0.0, |ticks| self.time_base.seconds(ticks))
    }
}

/// Packet of a stream. It holds its data until the next one is read into it.
pub struct Packet {
    pub(super) packet: *mut sys::AVPacket,
}

// SAFETY: the packet and its data are owned, and only the owner's thread accesses them.
#[allow(unsafe_code)]
unsafe impl Send for Packet {}

#[allow(unsafe_code)]
impl Packet {
    /// Creates an empty packet.
    ///
    /// # Errors
    /// [`FfmpegError::Memory`].
    pub fn new() -> Result<Self, FfmpegError> {
        // SAFETY: allocates, or returns null.
        let packet = unsafe { sys::av_packet_alloc() };
        if packet.is_null() { Err(FfmpegError::Memory) } else { Ok(Self { packet }) }
    }

    /// Index of its stream.
    pub fn stream(&self) -> usize {
        // SAFETY: the packet is allocated as long as `self` lives.
        usize::try_from(unsafe { (*self.packet).stream_index }).unwrap_or(usize::MAX)
    }

    /// Presentation time, in ticks of its stream.
    pub fn time(&self) -> Option<i64> {
        // SAFETY: as above.
        stated(unsafe { (*self.packet).pts })
    }

    /// Duration, in ticks of its stream; 0 if unknown.
    pub fn duration(&self) -> i64 {
        // SAFETY: as above.
        unsafe { (*self.packet).duration }.max(0)
    }

    /// Content.
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
    /// Index of the stream whose packets are read; `None` for all.
    kept: Option<usize>,
    /// Input that the context reads; closed after it.
    _input: Input,
}

// SAFETY: the context is owned and not bound to the thread that created it.
#[allow(unsafe_code)]
unsafe impl Send for MediaFile {}

#[allow(unsafe_code)]
impl MediaFile {
    /// Opens a file and analyzes its header and first packets.
    ///
    /// No other file is opened, whatever the container contains.
    ///
    /// # Errors
    /// [`FfmpegError::Open`] if FFmpeg does not know the format or finds it damaged, or if the format is not an
    /// accepted one; [`FfmpegError::Playlist`].
    pub fn open(path: &Path) -> Result<Self, FfmpegError> {
        Self::open_as(path, None)
    }

    /// As [`MediaFile::open`], for a file that is still being written. Reading waits for data at its end.
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
        // SAFETY: the context is new; the strings end in a zero byte and outlive the calls; if opening fails, FFmpeg
        // frees the context and does not change the input.
        let opened = unsafe {
            (*context).pb = input.context;
            (*context).io_open = Some(input::refuse);
            let mut options = ptr::null_mut();
            // No protocol has this name: a demuxer that bypasses `io_open` cannot open anything either.
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

    /// Restricts reading to the packets of one stream.
    pub fn keep_only(&mut self, index: usize) {
        self.kept = Some(index);
        for stream in self.streams() {
            let discard = if stream.index == index { sys::AVDiscard::DEFAULT } else { sys::AVDiscard::ALL };
            // SAFETY: the stream is one of the context's.
            unsafe { (*self.raw_stream(stream.index)).discard = discard }
        }
    }

    /// Reads the next packet, after [`Self::keep_only`] of that stream; `false` at the end, or if no more can be read.
    ///
    /// # Errors
    /// [`FfmpegError::Memory`].
    pub fn read(&mut self, packet: &mut Packet) -> Result<bool, FfmpegError> {
        let mut num_errors = 0;
        loop {
            // SAFETY: context and packet are allocated; the previous content of the packet is released first.
            let code = unsafe {
                sys::av_packet_unref(packet.packet);
                sys::av_read_frame(self.context, packet.packet)
            };
            match checked(code) {
                // Packets that FFmpeg buffered during the analysis come first, including those of streams discarded
                // since.
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

    /// Width of a pixel over its height, as a fraction, for the current frame of the stream's decoder.
    ///
    /// The container's value takes precedence over the frame's; `None` if neither has one.
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

    /// Number of presented packets according to the container.
    ///
    /// The index of an MP4 or MOV file has an entry for each packet that its edit list keeps, with a flag for those
    /// that are only decoded and not presented.
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

/// Detects the container format of a file.
///
/// # Errors
/// [`FfmpegError::Open`], [`FfmpegError::Playlist`].
#[allow(unsafe_code)]
fn probe(input: &Input, url: &CStr) -> Result<*const sys::AVInputFormat, FfmpegError> {
    let mut format = ptr::null();
    // SAFETY: reads from the open input and rewinds it; the URL ends in a zero byte, and its extension is read.
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

/// Dispositions of streams that are no video: single images.
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

/// Rotation of the stream's display matrix.
#[allow(unsafe_code)]
fn rotation_deg(stream: *const sys::AVStream) -> i32 {
    let mut matrix = [0_i32; 9];
    let (data, size) = display_matrix(stream);
    if data.is_null() || size < size_of_val(&matrix) {
        return 0;
    }
    // SAFETY: `data` points to `size` bytes, which suffice; both functions read only the matrix.
    let counterclockwise_deg = unsafe {
        ptr::copy_nonoverlapping(data, matrix.as_mut_ptr().cast::<u8>(), size_of_val(&matrix));
        sys::av_display_rotation_get(matrix.as_ptr())
    };
    if counterclockwise_deg.is_finite() { (-counterclockwise_deg.round() as i32).rem_euclid(360) } else { 0 }
}

/// Pointer to the display matrix, and its size in bytes; null if there is none.
#[cfg(ffmpeg_6_1)]
#[allow(unsafe_code)]
fn display_matrix(stream: *const sys::AVStream) -> (*const u8, usize) {
    // SAFETY: the caller's stream is valid; the parameters' array has the length stored with it.
    unsafe {
        let parameters = &*(*stream).codecpar;
        let (all, count) = (parameters.coded_side_data, parameters.nb_coded_side_data);
        let found = sys::av_packet_side_data_get(all, count, sys::AVPacketSideDataType::DISPLAYMATRIX);
        if found.is_null() { (ptr::null(), 0) } else { ((*found).data, (*found).size) }
    }
}

/// Pointer to the display matrix, and its size in bytes; null if there is none.
#[cfg(not(ffmpeg_6_1))]
#[allow(unsafe_code)]
fn display_matrix(stream: *const sys::AVStream) -> (*const u8, usize) {
    let mut size = 0;
    // SAFETY: the caller's stream is valid; the call also writes the size of the data that it returns.
    let data = unsafe { sys::av_stream_get_side_data(stream, sys::AVPacketSideDataType::DISPLAYMATRIX, &mut size) };
    (data, size)
}
