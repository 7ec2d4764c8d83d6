//! Telemetry. Each millisecond has one frame, with the outputs and with the counts of all samples in this millisecond.
//! Some frames also have a key: the state of the estimator. From a key a reader can compute every later sample.

use super::Console;
use crate::{
    Design, LoopParameters,
    console::Port,
    experiment::Report,
    period::{SAMPLES_PER_MS, outputs_per_ms},
    port::Exchanged,
    store::Stored,
    telemetry::{Flags, Frame, InForce, Key, Record},
    units::{Force, Position},
    velocity::Tuned,
};

/// The longest time between two keys, as a number of samples. It is 100 ms.
const KEY_EVERY: u64 = 100 * SAMPLES_PER_MS as u64;

#[derive(Clone)]
pub(in crate::console) struct Stream {
    pub(in crate::console) on: bool,
    sequence: u32,
    /// Outputs of the frame that is being filled. They follow each other without a gap, and have the same settings and
    /// fault.
    outputs: [Record; Frame::OUTPUTS],
    pushes: [Force; Frame::OUTPUTS],
    /// Energy that wall and hand have exchanged up to the newest output.
    port: Exchanged,
    count: usize,
    /// Number of the last sample whose count was sent.
    told: Option<u64>,
    key: Option<Mark>,
    /// The settings that `render` accepted last. `proposed` are the settings whose order is under way.
    accepted: Option<Chosen>,
    proposed: Option<Chosen>,
}

/// Values at the last key. If one of them changes, a new key is sent.
#[derive(Clone, Copy)]
struct Mark {
    sample: u64,
    tuning: u16,
    zeros: u16,
    settings: u16,
}

/// Settings, and the estimator that was built from them.
#[derive(Clone, Copy)]
struct Chosen {
    in_force: InForce,
    tuned: Tuned,
}

impl Stream {
    /// Makes a stream that is on from the first sample, with these settings.
    pub(super) fn new(first: Option<(Design, &Stored, &LoopParameters)>) -> Self {
        let chosen = |(design, stored, parameters): (Design, &Stored, &LoopParameters)| Chosen {
            in_force: InForce { number: 0, design, settings: stored.settings },
            tuned: parameters.estimator,
        };
        Self {
            on: true,
            sequence: 0,
            outputs: [Record::EMPTY; Frame::OUTPUTS],
            pushes: [Force::ZERO; Frame::OUTPUTS],
            port: Exchanged::default(),
            count: 0,
            told: None,
            key: None,
            accepted: first.map(chosen),
            proposed: None,
        }
    }

    /// Notes that an order for these settings is under way. Predicts the number and tuning that they will have.
    pub(super) fn propose(&mut self, design: Design, stored: &Stored, parameters: &LoopParameters) {
        self.proposed = self.accepted.map(|Chosen { in_force, tuned }| Chosen {
            in_force: InForce {
                number: in_force.number.wrapping_add(1),
                design,
                settings: stored.settings,
            },
            tuned: parameters.estimator.after(&tuned),
        });
    }

    /// Takes the answer to an order. Returns the settings that the order put in force. Returns `None` if the order was
    /// refused or had no settings.
    pub(super) fn answered(&mut self, met: bool) -> Option<InForce> {
        let chosen = self.proposed.take().filter(|_| met)?;
        self.accepted = Some(chosen);
        Some(chosen.in_force)
    }

    fn number(&mut self, record: Record) -> Frame {
        let sequence = self.sequence;
        self.sequence = sequence.wrapping_add(1);
        Frame { sequence, record }
    }
}

impl<P: Port> Console<P> {
    /// Sends telemetry, if it is on. A full channel drops the frame. Then the sequence number of this frame is missing.
    pub(super) fn stream(&mut self, report: &Report) {
        let Report { streamed: mut record, push, port, .. } = *report;
        if !self.stream.on {
            self.stream.count = 0;
            return;
        }
        // A record of the black box has no design, because the design before the fault is no longer known.
        if !record.flags.contains(Flags::REPLAY) {
            record.flags = record.flags.with_design(self.design);
        }
        let most = outputs_per_ms(self.stored.period) as usize;
        let period = u64::from(self.stored.period);
        let Stream { outputs, count, .. } = &self.stream;
        if let Some(last) = count.checked_sub(1).and_then(|last| outputs.get(last))
            && (last.sample.wrapping_add(period), last.settings, last.fault)
                != (record.sample, record.settings, record.fault)
        {
            self.flush();
        }
        self.stream.port = port;
        let Stream { outputs, pushes, count, .. } = &mut self.stream;
        if let (Some(place), Some(pushed)) = (outputs.get_mut(*count), pushes.get_mut(*count)) {
            (*place, *pushed) = (record, push);
            *count += 1;
        }
        if self.stream.count >= most {
            self.flush();
        }
    }

    /// Sends the frame that is being filled. All its outputs have the same output period.
    #[inline(never)] // its frame is not needed below `report`
    pub(in crate::console) fn flush(&mut self) {
        let Stream { outputs, pushes, port, count, .. } = self.stream;
        self.stream.count = 0;
        let Some((newest, earlier)) = outputs.get(..count).and_then(<[Record]>::split_last) else {
            return;
        };
        let frame = self.stream.number(*newest);
        let mut bytes = [0; Frame::LEN_MAX];
        let period = u8::try_from(self.stored.period).unwrap_or(u8::MAX);
        if newest.flags.contains(Flags::REPLAY) {
            let sent = if earlier.is_empty() {
                self.port.write_frame(&frame.encode())
            } else {
                self.port.write_frame(frame.encode_after(earlier, period, &mut bytes).finish())
            };
            if !sent {
                self.stream.key = None;
            }
            return;
        }
        let mut writer = frame.encode_after(earlier, period, &mut bytes);
        // The frame gets all samples that were not sent yet. After a gap it gets only those of one millisecond.
        let told = self.stream.told;
        let since = told.map_or(u64::MAX, |told| newest.sample.wrapping_sub(told));
        let follows = since <= Frame::SAMPLES as u64;
        let samples = if follows { since } else { newest.sample.min(SAMPLES_PER_MS.into()) };
        let mut places = [Position::default(); Frame::SAMPLES + 1];
        let places = places.get_mut(..=usize::try_from(samples).unwrap_or_default());
        let key = if let Some(places) = places
            && let Some(sampler) = self.port.samples(newest.sample, places)
        {
            if period > 1 || samples != count as u64 {
                writer = writer.positions(places);
            }
            self.stream.told = Some(newest.sample);
            self.stream.key_of((sampler.sampler(), sampler.zeros()), follows)
        } else {
            self.stream.told = None;
            None
        };
        writer = writer.pushes(pushes.get(..count).unwrap_or_default());
        if let Some((mark, key)) = key {
            self.stream.key = Some(mark);
            let Stream { accepted, proposed, .. } = &self.stream;
            let all =
                [accepted.as_ref(), proposed.as_ref().filter(|_| key.settings != mark.settings)];
            for chosen in all.into_iter().flatten() {
                writer = writer.settings(&chosen.in_force);
            }
            writer = writer.key(&key).port(port);
        }
        if !self.port.write_frame(writer.finish()) {
            // The next frame sends the content of this frame again.
            (self.stream.told, self.stream.key) = (told, None);
        }
    }
}

impl Stream {
    /// The key for this frame, if one is due.
    fn key_of(
        &self,
        (sampler, zeros): (&crate::Sampler, u16),
        follows: bool,
    ) -> Option<(Mark, Key)> {
        let accepted = self.accepted.as_ref()?;
        let state = &sampler.state();
        let mark = Mark {
            sample: sampler.next().wrapping_sub(1),
            tuning: state.number(),
            zeros,
            settings: accepted.in_force.number,
        };
        let same = |last: &Mark| {
            (last.tuning, last.zeros, last.settings) == (mark.tuning, mark.zeros, mark.settings)
                && mark.sample.wrapping_sub(last.sample) < KEY_EVERY
        };
        if follows && self.key.as_ref().is_some_and(same) {
            return None;
        }
        let ran = [self.proposed.as_ref(), Some(accepted)];
        let ran =
            ran.into_iter().flatten().rev().find(|chosen| chosen.tuned.number() == mark.tuning)?;
        let key = Key::of((mark.sample, zeros), state, ran.in_force.number, &ran.tuned)?;
        Some((mark, key))
    }
}
