//! Finds the telemetry frames in a stream of bytes.

use super::{Frame, Parts, Record, parts::kind};

/// Finds the frames of both layouts in a stream that may begin anywhere and contain anything.
///
/// After garbage the decoder searches for the next frame at every byte. So only the damaged frame is lost.
#[derive(Clone, Copy, Debug)]
pub struct Decoder {
    window: [u8; Frame::LEN_MAX],
    last: [u8; Frame::LEN_MAX],
    length: usize,
    filled: usize,
    next: Option<u32>,
    earlier: [Record; Frame::OUTPUTS - 1],
    /// Number of outputs in the last frame, without its newest output.
    before: usize,
    /// Number of frames so far.
    pub frames: u64,
    /// Number of frames that are missing in the stream. It follows from the gaps in the sequence numbers.
    pub dropped: u64,
    /// Bytes that belong to no frame.
    pub garbage: u64,
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

impl Decoder {
    /// Makes a decoder that has not taken any byte yet.
    pub const fn new() -> Self {
        Self {
            window: [0; Frame::LEN_MAX],
            last: [0; Frame::LEN_MAX],
            length: 0,
            filled: 0,
            next: None,
            earlier: [Record::EMPTY; Frame::OUTPUTS - 1],
            before: 0,
            frames: 0,
            dropped: 0,
            garbage: 0,
        }
    }

    /// Takes one byte. Returns the newest output of a frame that this byte completes. [`earlier`](Self::earlier) has
    /// the outputs before it.
    pub fn push(&mut self, byte: u8) -> Option<Frame> {
        if let Some(place) = self.window.get_mut(self.filled) {
            *place = byte;
            self.filled += 1;
        }
        self.pull()
    }

    /// Takes a complete frame out of the bytes so far, if there is one. Call it again for more: bytes that look like
    /// the start of a long frame may hold several short frames.
    fn pull(&mut self) -> Option<Frame> {
        while let Some(length) = self.length() {
            if self.filled < length {
                return None;
            }
            let frame = self.window.get(..length).and_then(Frame::read);
            if let Some(frame) = frame
                && self.take_earlier(&frame, length)
            {
                let both = self.last.get_mut(..length).zip(self.window.get(..length));
                if let Some((last, taken)) = both {
                    last.copy_from_slice(taken);
                }
                self.length = length;
                self.pass(length);
                self.count(&frame);
                return Some(frame);
            }
            self.skip();
        }
        None
    }

    /// The outputs of the last frame without the newest one. The oldest output comes first.
    pub fn earlier(&self) -> &[Record] {
        self.earlier.get(..self.before).unwrap_or_default()
    }

    /// The parts of the last frame.
    pub fn parts(&self) -> Parts<'_> {
        Parts::of(self.last.get(..self.length).unwrap_or_default())
    }

    /// Returns all outputs of the last frame, oldest first. `newest` is what [`push`](Self::push) returned. Each output
    /// becomes a frame with the same sequence number.
    pub fn outputs(&self, newest: Frame) -> impl Iterator<Item = Frame> {
        let frame = move |&record| Frame { record, ..newest };
        self.earlier().iter().map(frame).chain([newest])
    }

    /// Returns the length of the frame at the beginning of the window, as far as it is known. Returns `None` if the
    /// window is empty.
    fn length(&mut self) -> Option<usize> {
        loop {
            let taken = self.window.get(..self.filled).unwrap_or_default();
            match *taken {
                [] => return None,
                [first] if first == Frame::MAGIC[0] => return Some(3),
                [first, second] if [first, second] == Frame::MAGIC => return Some(3),
                [first, second, ..] if [first, second] != Frame::MAGIC => {}
                [_, _, Frame::VERSION, ..] => return Some(Frame::LEN),
                [_, _, Frame::VERSION_2, ..] => {
                    let behind = taken.get(Frame::HEAD..).and_then(<[u8]>::first_chunk::<2>);
                    let Some(length) = behind else { return Some(Frame::HEAD + 2) };
                    let length = usize::from(u16::from_le_bytes(*length));
                    if (Frame::LEN + 4..=Frame::LEN_MAX).contains(&length) {
                        return Some(length);
                    }
                }
                _ => {}
            }
            self.skip();
        }
    }

    /// Stores the outputs before the newest one. Returns false if the bytes are not those of a frame.
    fn take_earlier(&mut self, frame: &Frame, length: usize) -> bool {
        self.before = 0;
        if self.window.get(2) != Some(&Frame::VERSION_2) {
            return true;
        }
        let frame_bytes = self.window.get(..length).unwrap_or_default();
        let Some(&period) = frame_bytes.get(Frame::HEAD + 2) else { return false };
        let parts = Parts::of(frame_bytes);
        // Parts of an unknown kind, from a later image, are skipped.
        for (_, part) in parts.all().filter(|(kind, _)| *kind == kind::EARLIER) {
            let (outputs, rest) = part.as_chunks::<{ Frame::EARLIER }>();
            if !rest.is_empty() || outputs.len() > self.earlier.len() {
                return false;
            }
            let Record { sample, settings, fault, .. } = frame.record;
            let samples = (1..=outputs.len() as u64).rev();
            for ((place, output), back) in self.earlier.iter_mut().zip(outputs).zip(samples) {
                let sample = sample.wrapping_sub(back * u64::from(period));
                let Some(record) = Record::of(&mut &output[..]) else { return false };
                *place = Record { sample, settings, fault, ..record };
            }
            self.before = outputs.len();
        }
        parts.are_whole()
    }

    fn count(&mut self, frame: &Frame) {
        self.frames += 1;
        let gap = self.next.map_or(0, |next| frame.sequence.wrapping_sub(next));
        // If the sequence goes back, the board has started again. This is more probable than four billion dropped
        // frames.
        if gap < u32::MAX / 2 {
            self.dropped += u64::from(gap);
        }
        self.next = Some(frame.sequence.wrapping_add(1));
    }

    /// Ends the stream. Call this function until it returns `None`, because frames may follow bytes that only look like
    /// the start of a longer frame. The bytes of an unfinished frame are garbage too.
    pub fn finish(&mut self) -> Option<Frame> {
        while self.filled > 0 {
            if let Some(frame) = self.pull() {
                return Some(frame);
            }
            if self.filled > 0 {
                self.skip();
            }
        }
        None
    }

    /// Drops bytes up to the next byte that could begin a frame.
    fn skip(&mut self) {
        let [first, second] = Frame::MAGIC;
        let may_start = |place: usize| {
            self.window.get(place) == Some(&first)
                && (place + 1 >= self.filled || self.window.get(place + 1) == Some(&second))
        };
        let start = (1..self.filled).find(|&place| may_start(place)).unwrap_or(self.filled);
        self.garbage += start as u64;
        self.pass(start);
    }

    /// Removes this number of bytes from the front of the window. The window must have at least as many bytes.
    fn pass(&mut self, bytes: usize) {
        // `min` is for the compiler, which does not know that `bytes` is within the window.
        self.window.copy_within(bytes.min(Frame::LEN_MAX).., 0);
        self.filled = self.filled.saturating_sub(bytes);
    }
}
