//! The parts of a frame. They hold everything that follows the newest output.
//!
//! Each part has a kind, a length and bytes of this length. `docs/telemetry.md` has the tables.

use super::{Frame, Record, put, take};
use crate::{
    Design, Output, Settings, VelocitySettings, WallSettings, crc,
    port::Exchanged,
    units::{Force, Position, Velocity},
    velocity::{EstimatorName, State, Tuned},
};

pub(super) mod kind {
    /// The outputs before the newest one.
    pub const EARLIER: u8 = 1;
    /// Differences between the counts of the samples. Each has one byte, or five if it is large.
    pub const COUNTS: u8 = 2;
    /// Differences between the counts of the samples, two in a byte. This kind is used if all differences are small.
    pub const SMALL_COUNTS: u8 = 3;
    /// Pushes of an experiment.
    pub const PUSHES: u8 = 4;
    /// Settings that are in force.
    pub const SETTINGS: u8 = 5;
    /// State of the estimator.
    pub const STATE: u8 = 6;
    /// More of the estimator's state.
    pub const MORE: u8 = 7;
    /// Energy at the port.
    pub const PORT: u8 = 8;
}

/// A byte that says that the difference follows in four more bytes.
const ESCAPE: i8 = i8::MIN;

/// Length of the longest state of an estimator, in bytes. It holds a window of 255 samples.
pub const STATE_MAX: usize = 510;

/// The settings in force, and the number by which records refer to them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InForce {
    /// Number of the settings, as in [`Record::settings`].
    pub number: u16,
    /// The device, with its calibrated full scale.
    pub design: Design,
    /// Estimator and wall in SI units.
    pub settings: Settings,
}

/// State of the sampler after a sample. Every later velocity follows from this state and the counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Key {
    /// Number of the sample, from 0.
    pub sample: u64,
    /// [`InForce::number`] of the settings with this estimator.
    pub settings: u16,
    /// [`Tuned::number`] of the estimator's tuning.
    pub tuning: u16,
    /// Number of times that the count was zeroed. The number wraps.
    pub zeros: u16,
    /// Position at this sample. It is 0 if the count was zeroed with this sample.
    pub position: Position,
    /// Velocity at this sample.
    pub velocity: Velocity,
    memory: [u8; STATE_MAX],
    length: usize,
}

impl Key {
    /// Makes the key of this state of `estimator`. Returns `None` if its memory does not fit.
    pub fn of(
        (sample, zeros): (u64, u16),
        state: &State,
        settings: u16,
        estimator: &Tuned,
    ) -> Option<Self> {
        let mut memory = [0; STATE_MAX];
        let length = state.put(estimator, &mut memory)?;
        let (position, velocity) = state.last();
        let tuning = state.number();
        Some(Self { sample, settings, tuning, zeros, position, velocity, memory, length })
    }

    #[cfg(test)]
    pub(super) fn from_parts(
        (sample, settings, tuning, zeros): (u64, u16, u16, u16),
        (position, velocity): (Position, Velocity),
        bytes: &[u8],
    ) -> Self {
        let mut memory = [0; STATE_MAX];
        memory[..bytes.len()].copy_from_slice(bytes);
        let length = bytes.len();
        Self { sample, settings, tuning, zeros, position, velocity, memory, length }
    }

    /// Memory of the estimator.
    pub fn memory(&self) -> &[u8] {
        self.memory.get(..self.length).unwrap_or_default()
    }
}

/// A frame of layout 2 that is being written.
pub struct FrameWriter<'a> {
    bytes: &'a mut [u8; Frame::LEN_MAX],
    used: usize,
    /// Offset of the byte that holds the length of the part that is being written.
    part: usize,
}

impl<'a> FrameWriter<'a> {
    /// Makes a writer that begins after the frame's head.
    pub(super) const fn new(bytes: &'a mut [u8; Frame::LEN_MAX], used: usize) -> Self {
        Self { bytes, used, part: 0 }
    }

    fn begin(&mut self, kind: u8) {
        self.put(&[kind, 0]);
        self.part = self.used - 1;
    }

    #[expect(clippy::cast_possible_truncation, reason = "parts are made that short")]
    fn end(&mut self) {
        let length = (self.used - self.part - 1) as u8;
        if let Some(place) = self.bytes.get_mut(self.part) {
            *place = length;
        }
    }

    fn put<const N: usize>(&mut self, bytes: &[u8; N]) {
        if let Some(mut place) = self.bytes.get_mut(self.used..) {
            put(&mut place, bytes);
        }
        self.used = (self.used + N).min(Frame::LEN_MAX);
    }

    /// Adds the outputs before the newest one, oldest first.
    pub(super) fn earlier(&mut self, outputs: &[Record]) {
        self.begin(kind::EARLIER);
        for record in outputs {
            self.put(&record.position.counts().to_le_bytes());
            self.put(&record.velocity.bits().to_le_bytes());
            self.put(&record.force.bits().to_le_bytes());
            self.put(&record.command.code().to_le_bytes());
            self.put(&record.flags.bits().to_le_bytes());
        }
        self.end();
    }

    /// Adds the position of the sample before the frame, then of each sample up to the newest output. These samples are
    /// at most [`Frame::SAMPLES`].
    #[must_use]
    pub fn positions(mut self, positions: &[Position]) -> Self {
        let differences = || {
            positions.windows(2).filter_map(|pair| {
                if let [a, b] = pair { Some(b.wrapping_since(*a)) } else { None }
            })
        };
        let small = differences().all(|difference| (-8..8).contains(&difference));
        if small && positions.len() % 2 == 1 {
            self.begin(kind::SMALL_COUNTS);
            let mut differences = differences();
            while let (Some(first), Some(second)) = (differences.next(), differences.next()) {
                let [first, second] =
                    [first, second].map(|difference| difference.to_le_bytes()[0] & 15);
                self.put(&[first | second << 4]);
            }
        } else {
            self.begin(kind::COUNTS);
            for difference in differences() {
                match i8::try_from(difference) {
                    Ok(byte) if byte != ESCAPE => self.put(&byte.to_le_bytes()),
                    _ => {
                        self.put(&ESCAPE.to_le_bytes());
                        self.put(&difference.to_le_bytes());
                    }
                }
            }
        }
        self.end();
        self
    }

    /// Adds the pushes of an experiment at the outputs, oldest first. If all are zero, the part is left out.
    #[must_use]
    pub fn pushes(mut self, pushes: &[Force]) -> Self {
        if pushes.iter().any(|push| *push != Force::ZERO) {
            self.begin(kind::PUSHES);
            for push in pushes.iter().take(Frame::OUTPUTS) {
                self.put(&push.bits().to_le_bytes());
            }
            self.end();
        }
        self
    }

    /// Adds the settings in force.
    #[must_use]
    pub fn settings(mut self, in_force: &InForce) -> Self {
        let InForce { number, design, settings } = in_force;
        let (estimator, numbers) = EstimatorName::of(&settings.velocity);
        let (kind, steps) = match design.output {
            Output::Continuous => (0, 0),
            Output::Dac { bits } => (1, bits),
            Output::Pwm { steps } => (2, steps),
        };
        let wall = &settings.wall;
        self.begin(kind::SETTINGS);
        self.put(&number.to_le_bytes());
        self.put(&estimator.id().to_le_bytes());
        self.put(&design.period.to_le_bytes());
        self.put(&[kind, u8::from(wall.push_only)]);
        self.put(&steps.to_le_bytes());
        let fixed = [
            design.rate_hz,
            design.resolution_m,
            design.full_scale_n,
            wall.position_m,
            wall.stiffness_n_per_m,
            wall.damping_n_s_per_m,
        ];
        for number in fixed.iter().chain(numbers.iter().take(estimator.keys().len())) {
            self.put(&number.to_le_bytes());
        }
        self.end();
        self
    }

    /// Adds the sampler's state after a sample.
    #[must_use]
    pub fn key(mut self, key: &Key) -> Self {
        self.begin(kind::STATE);
        self.put(&key.sample.to_le_bytes());
        for number in [key.settings, key.tuning, key.zeros] {
            self.put(&number.to_le_bytes());
        }
        self.put(&key.position.counts().to_le_bytes());
        self.put(&key.velocity.bits().to_le_bytes());
        let mut rest = key.memory();
        while let Some((byte, behind)) = rest.split_first() {
            if self.used - self.part > usize::from(u8::MAX) {
                self.end();
                self.begin(kind::MORE);
            }
            self.put(&[*byte]);
            rest = behind;
        }
        self.end();
        self
    }

    /// Adds the energy that wall and hand have exchanged up to the newest output.
    #[must_use]
    pub fn port(mut self, port: Exchanged) -> Self {
        self.begin(kind::PORT);
        self.put(&port.energy.to_le_bytes());
        self.put(&port.given.to_le_bytes());
        self.end();
        self
    }

    /// Adds the checksum, and returns all bytes of the frame.
    pub fn finish(self) -> &'a [u8] {
        let Self { bytes, used, .. } = self;
        let body = used.min(Frame::LEN_MAX - 4);
        #[expect(clippy::cast_possible_truncation, reason = "at most the longest frame")]
        let whole = (body + 4) as u16;
        if let Some(place) = bytes.get_mut(Frame::HEAD..).and_then(<[u8]>::first_chunk_mut::<2>) {
            *place = whole.to_le_bytes();
        }
        let check = crc::of_bytes(bytes.get(..body).unwrap_or_default());
        if let Some(place) = bytes.get_mut(body..).and_then(<[u8]>::first_chunk_mut::<4>) {
            *place = check.to_le_bytes();
        }
        bytes.get(..body + 4).unwrap_or_default()
    }
}

/// The parts of a frame of layout 2. Other frames have none.
#[derive(Clone, Copy, Debug)]
pub struct Parts<'a>(&'a [u8]);

impl<'a> Parts<'a> {
    /// The parts in a frame's bytes.
    pub(super) fn of(frame: &'a [u8]) -> Self {
        let body = frame.split_last_chunk::<4>().map_or(&[][..], |(body, _)| body);
        match body.get(2) {
            Some(&Frame::VERSION_2) => Self(body.get(Frame::HEAD + 4..).unwrap_or_default()),
            _ => Self(&[]),
        }
    }

    /// Returns the kind and the bytes of each part.
    pub(super) fn all(self) -> impl Iterator<Item = (u8, &'a [u8])> {
        let mut rest = self.0;
        core::iter::from_fn(move || {
            let [kind, length] = take(&mut rest)?;
            let (part, behind) = rest.split_at_checked(length.into())?;
            rest = behind;
            Some((kind, part))
        })
    }

    fn find(self, wanted: u8) -> Option<&'a [u8]> {
        self.all().find_map(|(kind, part)| (kind == wanted).then_some(part))
    }

    /// Whether the parts exactly fill the frame, and each part of a known kind is long enough.
    pub(super) fn are_whole(self) -> bool {
        let filled: usize = self.all().map(|(_, part)| part.len() + 2).sum();
        let told = self.all().all(|(kind, part)| match kind {
            kind::COUNTS => differences(kind, part).count() <= Frame::SAMPLES && is_whole(part),
            kind::SMALL_COUNTS => part.len() * 2 <= Frame::SAMPLES,
            kind::PUSHES => part.len() % 4 == 0 && part.len() <= 4 * Frame::OUTPUTS,
            kind::SETTINGS => part.len() >= SETTINGS_LEAST,
            kind::STATE => part.len() >= STATE_LEAST,
            kind::PORT => part.len() >= PORT_LEAST,
            _ => true,
        });
        filled == self.0.len() && told
    }

    /// Returns the position of the sample before the frame, then of each sample up to the newest output. If every
    /// sample has an output, there are none. `newest` is the position of the newest output.
    pub fn positions(
        self,
        newest: Position,
        places: &mut [Position; Frame::SAMPLES + 1],
    ) -> &[Position] {
        let found = self.all().find(|(kind, _)| matches!(*kind, kind::COUNTS | kind::SMALL_COUNTS));
        let Some((kind, part)) = found else { return &[] };
        let count = differences(kind, part).count().min(Frame::SAMPLES);
        let moved = differences(kind, part).fold(0i32, i32::wrapping_add);
        let mut position = newest.wrapping_add(moved.wrapping_neg());
        let steps = [0].into_iter().chain(differences(kind, part));
        for (place, difference) in places.iter_mut().zip(steps) {
            position = position.wrapping_add(difference);
            *place = position;
        }
        places.get(..=count).unwrap_or_default()
    }

    /// Returns the push of an experiment at the `n`-th output of the frame. Number 0 is the oldest output.
    pub fn push(self, n: usize) -> Force {
        let (pushes, _) = self.find(kind::PUSHES).unwrap_or_default().as_chunks();
        pushes
            .get(n)
            .map_or(Force::ZERO, |bits| Force::saturating_from_bits(i32::from_le_bytes(*bits)))
    }

    /// Returns the settings in the frame. An item is `None` if this build lacks the estimator.
    pub fn settings(self) -> impl Iterator<Item = Option<InForce>> + use<'a> {
        self.all().filter(|(kind, _)| *kind == kind::SETTINGS).map(|(_, part)| settings(part))
    }

    /// Energy that wall and hand have exchanged up to the newest output, if the frame has it.
    pub fn port(self) -> Option<Exchanged> {
        let mut rest = self.find(kind::PORT)?;
        let mut number = || take(&mut rest).map(i64::from_le_bytes);
        Some(Exchanged { energy: number()?, given: number()? })
    }

    /// The sampler's state, if this is a key frame.
    pub fn key(self) -> Option<Key> {
        let mut rest = self.find(kind::STATE)?;
        let sample = u64::from_le_bytes(take(&mut rest)?);
        let mut number = || take(&mut rest).map(u16::from_le_bytes);
        let (settings, tuning, zeros) = (number()?, number()?, number()?);
        let mut bits = || take(&mut rest).map(i32::from_le_bytes);
        let position = Position::from_counts(bits()?);
        let velocity = Velocity::saturating_from_bits(bits()?);
        let mut memory = [0; STATE_MAX];
        let more = self.all().filter(|(kind, _)| *kind == kind::MORE).flat_map(|(_, part)| part);
        let mut length = 0;
        for byte in rest.iter().chain(more) {
            *memory.get_mut(length)? = *byte;
            length += 1;
        }
        Some(Key { sample, settings, tuning, zeros, position, velocity, memory, length })
    }
}

const PORT_LEAST: usize = 2 * 8;
const SETTINGS_LEAST: usize = 2 + 4 + 4 + 2 + 4 + 6 * 8;
const STATE_LEAST: usize = 8 + 3 * 2 + 2 * 4;

/// Whether every escape is followed by its four bytes.
fn is_whole(mut rest: &[u8]) -> bool {
    while let Some((first, behind)) = rest.split_first() {
        let more = if first.cast_signed() == ESCAPE { 4 } else { 0 };
        let Some(behind) = behind.get(more..) else { return false };
        rest = behind;
    }
    true
}

/// Returns the differences that a part with counts contains.
fn differences(kind: u8, part: &[u8]) -> impl Iterator<Item = i32> {
    let (mut rest, mut second) = (part, None);
    core::iter::from_fn(move || {
        if kind == kind::SMALL_COUNTS {
            if let Some(difference) = second.take() {
                return Some(difference);
            }
            let [both] = take(&mut rest)?;
            let both = both.cast_signed();
            second = Some(i32::from(both >> 4));
            return Some(i32::from(both << 4 >> 4));
        }
        let [byte] = take(&mut rest)?;
        if byte.cast_signed() == ESCAPE {
            return take(&mut rest).map(i32::from_le_bytes);
        }
        Some(byte.cast_signed().into())
    })
}

fn settings(part: &[u8]) -> Option<InForce> {
    let mut rest = part;
    let number = u16::from_le_bytes(take(&mut rest)?);
    let mut word = || take(&mut rest).map(u32::from_le_bytes);
    let (id, period) = (word()?, word()?);
    let [kind, push_only] = take(&mut rest)?;
    let steps = u32::from_le_bytes(take(&mut rest)?);
    let mut float = || take(&mut rest).map(f64::from_le_bytes);
    let (rate_hz, resolution_m, full_scale_n) = (float()?, float()?, float()?);
    let (position_m, stiffness_n_per_m, damping_n_s_per_m) = (float()?, float()?, float()?);
    let estimator = EstimatorName::ALL.iter().find(|name| name.id() == id)?;
    let mut numbers = [0.0; _];
    for place in numbers.iter_mut().take(estimator.keys().len()) {
        *place = float()?;
    }
    let output = match kind {
        0 => Output::Continuous,
        1 => Output::Dac { bits: steps },
        2 => Output::Pwm { steps },
        _ => return None,
    };
    let velocity: VelocitySettings = estimator.settings(numbers);
    let wall = WallSettings {
        position_m,
        stiffness_n_per_m,
        damping_n_s_per_m,
        push_only: push_only != 0,
    };
    let design = Design { rate_hz, resolution_m, full_scale_n, period, output };
    Some(InForce { number, design, settings: Settings { velocity, wall } })
}
