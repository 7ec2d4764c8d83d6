//! Telemetry as bytes.

use std::{cell::RefCell, rc::Rc, sync::LazyLock};

use proptest::prelude::*;
use zwidth::{
    LoopParameters,
    Design, Settings, VelocitySettings, WallSettings,
    console::{Console, Port},
    device::Device,
    experiment::{Activity, Event, Order, Report},
    safety::{FaultSet, GuardedSampler, Inputs, State, Status},
    self_test::{Found, Part},
    store::{Loaded, Source, Stored},
    telemetry::{Decoder, Flags, Frame, Record},
    units::{Force, Position, Velocity},
};

use crate::{any, limits};

fn record() -> impl Strategy<Value = Record> {
    let velocity = -(32_767i32 << 16)..=32_767 << 16;
    let force = -(1i32 << 30)..=1 << 30;
    (any::<u64>(), any::<i32>(), velocity, force, any::output(), any::<u16>(), any::<u16>(), any::<u8>())
        .prop_map(|(sample, position, velocity, force, output, flags, settings, fault)| {
            let force = Force::saturating_from_bits(force);
            let wall = WallSettings {
                position_m: 0.0,
                stiffness_n_per_m: 0.0,
                damping_n_s_per_m: 0.0,
                push_only: true,
            };
            let velocity_settings = VelocitySettings::Difference {};
            let design = Design { output, ..any::PAPER };
            let loop_parameters = Settings { velocity: velocity_settings, wall }.build(&design).unwrap();
            Record {
                sample,
                position: Position::from_counts(position),
                velocity: Velocity::saturating_from_bits(velocity),
                force,
                command: loop_parameters.actuator.command(force),
                flags: Flags::from_bits(flags),
                settings,
                fault,
            }
        })
}

/// CRC-32/ISO-HDLC, calculated bit by bit.
fn crc(bytes: &[u8]) -> u32 {
    let mut crc = u32::MAX;
    for byte in bytes {
        crc ^= u32::from(*byte);
        for _ in 0..8 {
            crc = if crc & 1 == 1 { crc >> 1 ^ 0xEDB8_8320 } else { crc >> 1 };
        }
    }
    !crc
}

/// The bytes of a frame, written as the table of docs/telemetry.md says.
fn bytes(frame: &Frame) -> Vec<u8> {
    let record = &frame.record;
    let mut bytes = vec![0x5A, 0x57, 1, record.fault];
    bytes.extend(frame.sequence.to_le_bytes());
    bytes.extend(record.sample.to_le_bytes());
    bytes.extend(record.position.counts().to_le_bytes());
    bytes.extend(record.velocity.bits().to_le_bytes());
    bytes.extend(record.force.bits().to_le_bytes());
    bytes.extend(record.command.code().to_le_bytes());
    bytes.extend(record.flags.bits().to_le_bytes());
    bytes.extend(record.settings.to_le_bytes());
    bytes.extend(crc(&bytes).to_le_bytes());
    bytes
}

/// A host that reads all frames and sends nothing.
#[derive(Clone, Default)]
struct Listener(Rc<RefCell<Vec<u8>>>);

impl Port for Listener {
    const COMMIT: &'static str = "unknown";

    fn read(&mut self) -> Option<u8> {
        None
    }

    fn write_line(&mut self, _: &str) -> bool {
        true
    }

    fn write_frame(&mut self, frame: &[u8]) -> bool {
        self.0.borrow_mut().extend(frame);
        true
    }

    fn samples(&mut self, _: u64, _: &mut [Position]) -> Option<GuardedSampler> {
        None
    }

    fn order(&mut self, _: Order) -> bool {
        true
    }

    fn is_in_force(&mut self, _: &LoopParameters) -> bool {
        true
    }

    fn load(&mut self, defaults: Stored) -> Loaded {
        Loaded { stored: defaults, source: Source::Empty, damaged: 0 }
    }

    fn test(&mut self, _: Part) -> Found {
        Found::Clock(0)
    }

    fn save(&mut self, _: &Stored) -> bool {
        false
    }
}

static DEVICE: LazyLock<Device<'static>> = LazyLock::new(|| limits::device(any::PAPER));

/// A report that has only this output.
fn report(record: Record) -> Report {
    let status = Status {
        state: State::Off,
        fault: None,
        causes: FaultSet::EMPTY,
        present: FaultSet::EMPTY,
        zeroed: false,
        unlocked: false,
        contact: false,
        inputs: Inputs {
            stop_closed: true,
            supply_good: true,
            settings_valid: true,
            halted: false,
            found: FaultSet::EMPTY,
        },
    };
    Report { record, streamed: record, push: Force::ZERO, port: Default::default(), status, activity: Activity::None, event: Event::None }
}

crate::properties! {
    /// A frame has the bytes of the documentation's table, and is read back unchanged. After a change of one word, or
    /// of up to three bits, no frame is read, because a CRC-32 always detects these changes.
    as_on_the_page(1000, (sequence, record, flips) in (
        any::<u32>(),
        record(),
        any::noticed(Frame::LEN / 4),
    )) {
        let frame = Frame { sequence, record };
        let sent = frame.encode();
        assert_eq!(sent.to_vec(), bytes(&frame));
        assert_eq!(Frame::decode(&sent), Some(frame));
        let mut other = sent;
        for (word, flip) in flips {
            for (byte, flip) in other[4 * word..].iter_mut().zip(flip.to_le_bytes()) {
                *byte ^= flip;
            }
        }
        assert_eq!(Frame::decode(&other), (other == sent).then_some(frame));
    }

    /// A stream may begin anywhere, lack frames and contain garbage. Every complete frame of the stream is read in
    /// order. Dropped frames and garbage are counted.
    out_of_a_stream(150, (first, skipped, parts) in (
        prop_oneof![any::<u32>(), u32::MAX - 20..],
        0usize..40,
        prop::collection::vec((
            record(),
            prop_oneof![3 => Just(0u32), 1 => 1u32..5],
            prop::collection::vec(prop_oneof![Just(0x5A), Just(0x57), any::<u8>()], 0..60),
        ), 1..15),
    )) {
        let mut decoder = Decoder::new();
        let (mut sent, mut found, mut garbage, mut dropped) = (Vec::new(), Vec::new(), 0, 0);
        let torn = Frame { sequence: first.wrapping_sub(1), record: Record::EMPTY }.encode();
        // The rest of a frame whose beginning was cut off.
        let rest = if skipped == 0 { &[][..] } else { &torn[skipped..] };
        found.extend(rest.iter().filter_map(|byte| decoder.push(*byte)));
        garbage += rest.len() as u64;
        let mut sequence = first;
        for (record, lost, noise) in parts {
            sequence = sequence.wrapping_add(lost);
            dropped += if sent.is_empty() { 0 } else { u64::from(lost) };
            let frame = Frame { sequence, record };
            sequence = sequence.wrapping_add(1);
            garbage += noise.len() as u64;
            found.extend(noise.iter().chain(&frame.encode()).filter_map(|byte| decoder.push(*byte)));
            sent.push(frame);
        }
        found.extend(std::iter::from_fn(|| decoder.finish()));
        assert_eq!(found, sent);
        assert_eq!((decoder.frames, decoder.garbage, decoder.dropped), (sent.len() as u64, garbage, dropped));
    }
    /// At every output period, the decoder returns the outputs of the stream unchanged, each with its settings and its
    /// fault. At the end, less than a millisecond of data still waits.
    streamed(100, (period, first, parts) in (
        prop::sample::select(vec![1u32, 2, 5, 10]),
        any::<u32>(),
        prop::collection::vec((
            record(),
            prop_oneof![15 => Just(0u64), 1 => 1u64..30],
            prop_oneof![8 => Just(0u16), 1 => Just(1)],
            prop_oneof![8 => Just(0u8), 1 => Just(1)],
        ), 1..60),
    )) {
        let listener = Listener::default();
        let stored = Stored { period, ..DEVICE.defaults() };
        let mut console = Console::new(listener.clone(), &DEVICE, stored, Source::Empty);
        let mut before = Record { sample: u64::from(first), ..Record::EMPTY };
        let sent: Vec<Record> = parts.into_iter().map(|(record, lost, settings, fault)| {
            before = Record {
                sample: before.sample + u64::from(period) * (1 + lost),
                settings: before.settings + settings,
                fault: before.fault ^ fault,
                // The console sets this number. This device has no design.
                flags: match record.flags.contains(Flags::REPLAY) {
                    true => record.flags,
                    false => record.flags.with_design(0),
                },
                ..record
            };
            before
        }).collect();
        sent.iter().for_each(|record| console.report(&report(*record)));
        let (mut decoder, mut found) = (Decoder::new(), Vec::new());
        for byte in listener.0.take() {
            if let Some(frame) = decoder.push(byte) {
                found.extend(decoder.outputs(frame).map(|frame| frame.record));
            }
        }
        assert_eq!((decoder.garbage, decoder.dropped), (0, 0));
        assert_eq!(found, sent[..found.len()]);
        assert!(sent.len() - found.len() < 10 / period as usize, "{} of {}", found.len(), sent.len());
    }
}
