//! Telemetry, read by its page, and each frame worked out once more: position and velocity by the core from the
//! counts that the program read, the force by the core's wall, the rest by rules.

use std::collections::VecDeque;

use zwidth::{CounterWidth, LoopParameters, Motion, Sampler, units::Force, velocity::Senses};

/// Full scale of the force.
pub const FULL: i64 = 1 << 30;
/// 5 % of it: the largest step of a change, and of the sign test.
const SLEW: i64 = FULL / 20;
/// Sample by which the program has proposed its first settings to itself.
const STARTED: u64 = 100;
/// Samples that the calculation is behind the board, so that every answer is in.
const BEHIND: u64 = 40;

/// A frame as it came.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    pub sequence: u32,
    pub sample: u64,
    pub position: i32,
    pub velocity: i32,
    pub force: i32,
    pub code: i32,
    pub flags: u16,
    pub settings: u16,
    pub fault: u8,
    /// An experiment pushes, or did so a moment ago.
    pub busy: bool,
    /// How many samples its counts go back, and by how much the position moved in them; of layout 2.
    pub moved: Option<(u64, i32)>,
}

/// Bits of the flags.
pub mod flag {
    pub const CONTACT: u16 = 1;
    pub const RENDERED: u16 = 2;
    pub const SATURATED: u16 = 4;
    pub const ON: u16 = 8;
    pub const ARMED: u16 = 16;
    pub const CHANGING: u16 = 32;
    pub const FAULT: u16 = 64;
    pub const ZEROED: u16 = 128;
    pub const STOP_CLOSED: u16 = 256;
    pub const UNLOCKED: u16 = 512;
    pub const REPLAY: u16 = 1024;
}

impl Frame {
    /// Takes the first frame off `bytes`, of one output in either layout, if it is there as a whole.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn take(bytes: &mut Vec<u8>) -> Result<Option<Self>, String> {
        let length = match bytes.get(..3) {
            None => return Ok(None),
            Some(b"ZW\x01") => 40,
            Some(b"ZW\x02") => match bytes.get(36..38) {
                None => return Ok(None),
                Some(length) => usize::from(u16::from_le_bytes([length[0], length[1]])),
            },
            Some(other) => return Err(format!("a frame begins with {other:02x?}")),
        };
        if bytes.len() < length {
            return Ok(None);
        }
        let frame: Vec<u8> = bytes.drain(..length).collect();
        Self::read(&frame).map(Some)
    }

    /// Reads one frame.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn read(bytes: &[u8]) -> Result<Self, String> {
        let word = |at: usize| u32::from_le_bytes([0, 1, 2, 3].map(|n| bytes[at + n]));
        let half = |at: usize| u16::from_le_bytes([0, 1].map(|n| bytes[at + n]));
        let body = bytes.len() - 4;
        if crc(&bytes[..body]) != word(body) {
            return Err("a frame's CRC is wrong".into());
        }
        Ok(Self {
            sequence: word(4),
            sample: u64::from(word(8)) | u64::from(word(12)) << 32,
            position: word(16).cast_signed(),
            velocity: word(20).cast_signed(),
            force: word(24).cast_signed(),
            code: word(28).cast_signed(),
            flags: half(32),
            settings: half(34),
            fault: bytes[3],
            busy: false,
            moved: if bytes[2] == 2 { moved(&bytes[40..body])? } else { None },
        })
    }

    pub fn is(&self, flag: u16) -> bool {
        self.flags & flag != 0
    }
}

/// How many samples the counts of a frame go back, and the sum of them, if its parts have any.
fn moved(mut parts: &[u8]) -> Result<Option<(u64, i32)>, String> {
    let mut found = None;
    while let [kind, length, rest @ ..] = parts {
        let (part, behind) =
            rest.split_at_checked((*length).into()).ok_or("a part of a frame is cut")?;
        parts = behind;
        let mut steps: Vec<i32> = Vec::new();
        match kind {
            2 => {
                let mut at = 0;
                while at < part.len() {
                    let wide = part[at] == 0x80;
                    let step = match part.get(at + 1..at + 5) {
                        Some(bytes) if wide => i32::from_le_bytes([0, 1, 2, 3].map(|n| bytes[n])),
                        _ if wide => return Err("an escape is cut".into()),
                        _ => part[at].cast_signed().into(),
                    };
                    steps.push(step);
                    at += if wide { 5 } else { 1 };
                }
            }
            3 => {
                for both in part {
                    let signed = |bits: u8| i32::from(bits) - if bits > 7 { 16 } else { 0 };
                    steps.extend([signed(both & 15), signed(both >> 4)]);
                }
            }
            _ => continue,
        }
        let sum = steps.iter().fold(0i32, |sum, step| sum.wrapping_add(*step));
        if found.replace((steps.len() as u64, sum)).is_some() {
            return Err("a frame has its counts twice".into());
        }
    }
    Ok(found)
}

/// CRC-32 as in zlib, bit by bit.
fn crc(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |mut crc, byte| {
        crc ^= u32::from(*byte);
        for _ in 0..8 {
            crc = crc >> 1 ^ if crc & 1 != 0 { 0xEDB8_8320 } else { 0 };
        }
        crc
    })
}

/// What was asked for and holds from the sample after an output on.
#[derive(Clone, Copy, Debug)]
#[expect(clippy::large_enum_variant, reason = "a few of them wait at a time")]
pub enum Change {
    Parameters(LoopParameters),
    Zero,
}

/// The force of the last frame that was looked at.
#[derive(Clone, Copy, Debug)]
struct Last {
    sample: u64,
    force: i64,
    correction: i64,
    settings: u16,
    /// A push is fading out.
    pushed: bool,
}

/// The core beside the board.
#[derive(Clone, Debug)]
pub struct Twin {
    sampler: Option<Sampler>,
    parameters: LoopParameters,
    /// Codes from no force to full scale, and the code of no force.
    codes: (i64, i64),
    /// Number of the next sample, and the counts from it on.
    sample: u64,
    counts: VecDeque<u32>,
    /// The newest count, and the longest step from count to count that nobody has asked for yet.
    newest: Option<u32>,
    longest_step: u32,
    /// Count at which the position is 0, by subtraction alone.
    zero: u32,
    changes: VecDeque<(u64, Change)>,
    /// Since the last frame: the settings before, how often they changed, and whether the count was zeroed.
    before: Option<LoopParameters>,
    changed: u16,
    zeroed: bool,
    frames: VecDeque<Frame>,
    last: Option<Last>,
    /// Outputs with force since it came on.
    on_for: i64,
    /// Frames compared, and those whose force was worked out.
    pub compared: [u64; 2],
}

impl Twin {
    /// Beside a board that has just started with these settings.
    pub fn new(parameters: LoopParameters, codes: (i64, i64)) -> Self {
        Self {
            sampler: None,
            parameters,
            codes,
            sample: 0,
            counts: VecDeque::new(),
            newest: None,
            longest_step: 0,
            zero: 0,
            changes: VecDeque::new(),
            before: None,
            changed: 0,
            zeroed: false,
            frames: VecDeque::new(),
            last: None,
            on_for: 0,
            compared: [0; 2],
        }
    }

    /// Sample that the board has come to.
    pub fn newest(&self) -> u64 {
        (self.sample + self.counts.len() as u64).saturating_sub(1)
    }

    /// The output that answered last, as far as samples tell.
    pub fn output(&self) -> u64 {
        self.newest() / 10 * 10
    }

    /// Takes counts that the program has read: the first since its start, then one a sample.
    pub fn read(&mut self, counts: Vec<u32>) {
        for &count in &counts {
            let step = count.wrapping_sub(self.newest.unwrap_or(count)).cast_signed();
            self.longest_step = self.longest_step.max(step.unsigned_abs());
            self.newest = Some(count);
        }
        let mut counts = counts.into_iter();
        if self.sampler.is_none()
            && let Some(first) = counts.next()
        {
            self.sampler = Some(Sampler::new(first, CounterWidth::Bits32));
        }
        self.counts.extend(counts);
    }

    /// The longest step from count to count since this was asked.
    pub fn take_longest_step(&mut self) -> u32 {
        std::mem::take(&mut self.longest_step)
    }

    /// Something holds from the sample after this output on, or, for new settings, from the output beside it whose
    /// frame has a new number of settings: the reply comes before that frame, or after it.
    pub fn change(&mut self, output: u64, change: Change) {
        self.changes.push_back((output, change));
        self.place();
    }

    /// A frame has come.
    pub fn expect(&mut self, frame: Frame) {
        self.frames.push_back(frame);
        self.place();
    }

    /// The newest change of settings that no frame has told apart is moved to the output that a frame tells.
    fn place(&mut self) {
        let last = self.last.map(|last| (last.sample, last.settings));
        let frames = self.frames.iter().map(|frame| (frame.sample, frame.settings));
        let seen: Vec<_> = last.into_iter().chain(frames).collect();
        let outputs = seen.windows(2).filter_map(|pair| {
            let [(sample, before), (next, after)] = [pair[0], pair[1]];
            let ahead = sample + 1 >= self.sample; // what the core has taken stays
            (ahead && sample + 10 == next && before.wrapping_add(1) == after).then_some(sample)
        });
        for output in outputs {
            let of_settings =
                |change: &&mut (u64, Change)| matches!(change.1, Change::Parameters(_));
            let mut changes: Vec<_> = self.changes.iter_mut().filter(of_settings).collect();
            if changes.iter().all(|(at, _)| *at != output)
                && let Some((at, _)) = changes.iter_mut().find(|(at, _)| at.abs_diff(output) <= 10)
            {
                *at = output;
            }
        }
    }

    /// Works out what the board has done, up to a little before the present, and before `framed` if frames come.
    ///
    /// # Errors
    /// A frame says something else.
    pub fn follow(&mut self, framed: Option<u64>) -> Result<(), String> {
        let end = framed.unwrap_or(u64::MAX);
        while self.counts.len() as u64 > BEHIND && self.sample < end {
            let Some(count) = self.counts.pop_front() else { break };
            self.step(count)?;
        }
        Ok(())
    }

    fn step(&mut self, count: u32) -> Result<(), String> {
        let Some(sampler) = &mut self.sampler else { return Ok(()) };
        let mut zero = false;
        while let Some((at, change)) = self.changes.front().copied()
            && at < self.sample
        {
            self.changes.pop_front();
            match change {
                Change::Parameters(new) => {
                    let new = new.after(&self.parameters);
                    self.before.get_or_insert(self.parameters);
                    self.changed += 1;
                    self.parameters = new;
                }
                Change::Zero => zero = true,
            }
        }
        let mut sampled = sampler.sense(&self.parameters, count, &Senses::NONE);
        if zero {
            sampler.zero();
            sampled.motion.position = sampler.position();
            self.zero = count;
            self.zeroed = true;
        }
        let number = self.sample;
        self.sample += 1;
        if !sampled.due || self.frames.front().is_none_or(|frame| frame.sample > number) {
            return Ok(());
        }
        let Some(frame) = self.frames.pop_front() else { return Ok(()) };
        if frame.sample < number {
            return Err(format!("a frame of sample {}, which is no output's", frame.sample));
        }
        self.compare(&frame, sampled.motion, count)?;
        self.before = None;
        self.zeroed = false;
        self.changed = 0;
        Ok(())
    }

    fn compare(&mut self, frame: &Frame, motion: Motion, count: u32) -> Result<(), String> {
        self.compared[0] += 1;
        let wrong = |what: &str, said: i64, true_value: i64| {
            Err(format!(
                "{what} in the frame of sample {}: {said}, should be {true_value}",
                frame.sample
            ))
        };
        let place = count.wrapping_sub(self.zero).cast_signed();
        if frame.position != motion.position.counts() || frame.position != place {
            return wrong("position", frame.position.into(), place.into());
        }
        if frame.velocity != motion.velocity.bits() {
            return wrong("velocity", frame.velocity.into(), motion.velocity.bits().into());
        }
        let drive = self.parameters.render(motion, Force::ZERO);
        let surface = self.parameters.wall.surface().counts();
        let contact = place > surface;
        if frame.is(flag::CONTACT) != contact && !frame.busy {
            return wrong("contact", frame.is(flag::CONTACT).into(), contact.into());
        }
        let force = i64::from(frame.force);
        let (per_full_scale, zero) = self.codes;
        let codes = (force.abs() * per_full_scale + FULL / 2) >> 30;
        let code = zero + if force < 0 { -codes } else { codes };
        if i64::from(frame.code) != code {
            return wrong("code", frame.code.into(), code);
        }
        let last = self.last.filter(|last| last.sample + 10 == frame.sample);
        if let Some(last) = last
            && !frame.busy
            && frame.sample > STARTED
            && last.settings.wrapping_add(self.changed) != frame.settings
        {
            let expected = last.settings.wrapping_add(self.changed);
            return wrong("number of settings", frame.settings.into(), expected.into());
        }
        self.on_for = match (frame.is(flag::ON), last) {
            (true, Some(_)) => self.on_for + 1,
            (true, None) => self.on_for + 1000, // nobody saw how it came on
            (false, _) => 0,
        };
        let mut now = Last {
            sample: frame.sample,
            force,
            correction: 0,
            settings: frame.settings,
            pushed: frame.busy,
        };
        let wanted = i64::from(drive.force.bits());
        let (ramp, changing) = (!frame.is(flag::ARMED), frame.is(flag::CHANGING));
        if !frame.is(flag::ON) {
            if force != 0 {
                return wrong("force while off", force, 0);
            }
        } else if ramp {
            // The sign test takes 100 outputs, the ramp 200.
            let most = SLEW.max((self.on_for - 99) * (FULL / 200) + 1);
            if force.abs() > most {
                return wrong("force before it is armed", force, most);
            }
        } else if force.abs() > FULL {
            return wrong("force", force, FULL);
        } else if frame.busy {
            // An experiment pushes as it likes.
        } else if !changing {
            self.compared[1] += 1;
            if force != wanted {
                return wrong("force", force, wanted);
            }
            if frame.is(flag::SATURATED) != drive.saturated {
                return wrong(
                    "saturated",
                    frame.is(flag::SATURATED).into(),
                    drive.saturated.into(),
                );
            }
        } else {
            now.pushed = last.is_none_or(|last| last.pushed);
            now.correction = force - wanted;
            if force > 0 && !now.pushed {
                return wrong("a push-only wall pulls: force", force, 0);
            }
            if let Some(last) = last.filter(|last| !last.pushed) {
                let old = self.before.map_or(drive, |old| old.render(motion, Force::ZERO));
                let kept = (i64::from(old.force.bits()) + last.correction).clamp(-FULL, FULL);
                let base = if self.zeroed { last.force } else { kept };
                // Never against the wall: what would pull is no force at all.
                let least = base.min(0);
                let step = (force - least).abs();
                if step > SLEW + 2 {
                    return wrong("step of a change", step, SLEW);
                }
                if force.abs() == FULL {
                    let fading = last.correction.abs() - SLEW;
                    now.correction = last.correction.signum() * fading.max(0);
                }
            }
        }
        self.last = Some(now);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::{super::settings::Settings, *};
    use crate::board::NUCLEO_F446RE;

    /// The example of the telemetry's page.
    #[test]
    fn a_frame_is_read_as_the_page_has_it() {
        let bytes = [
            0x5A, 0x57, 1, 0, 7, 0, 0, 0, 0x10, 0x27, 0, 0, 0, 0, 0, 0, 0x70, 0x11, 1, 0, 0, 0x80,
            0, 0, 0, 0, 0, 0xE0, 0, 4, 0, 0, 0x9B, 1, 3, 0, 0x65, 0xAB, 0x1F, 0x5C,
        ];
        let frame = Frame::read(&bytes).unwrap();
        assert_eq!((frame.sequence, frame.sample, frame.position), (7, 10_000, 70_000));
        assert_eq!((frame.velocity, frame.force, frame.code), (32_768, -(1 << 29), 1024));
        let on = flag::CONTACT
            | flag::RENDERED
            | flag::ON
            | flag::ARMED
            | flag::ZEROED
            | flag::STOP_CLOSED;
        assert_eq!((frame.flags, frame.settings, frame.fault), (on, 3, 0));
        let mut damaged = bytes;
        damaged[20] ^= 1;
        assert!(Frame::read(&damaged).is_err());
    }

    /// While the black box is read out a later change is placed by the frames before: those are met.
    #[test]
    fn a_change_stays_at_its_output_when_the_one_before_is_taken() {
        let parameters = Settings::defaults().parameters(NUCLEO_F446RE).unwrap();
        let last = Last { sample: 9930, force: 0, correction: 0, settings: 34, pushed: false };
        let mut twin =
            Twin { sample: 9932, last: Some(last), ..Twin::new(parameters, (2047, 2048)) };
        twin.frames.push_back(Frame {
            sequence: 0,
            sample: 9940,
            position: 0,
            velocity: 0,
            force: 0,
            code: 2048,
            flags: 0,
            settings: 35,
            fault: 0,
            busy: false,
            moved: None,
        });
        for output in [9940, 9980] {
            twin.change(output, Change::Parameters(parameters));
        }
        assert_eq!(twin.changes.iter().map(|change| change.0).collect::<Vec<_>>(), [9940, 9980]);
    }
}
