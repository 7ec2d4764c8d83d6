//! Telemetry on the wire.

use proptest::prelude::*;
use zwidth::{
    Design, Settings, VelocitySettings, WallSettings,
    telemetry::{Decoder, Flags, Frame, Record},
    units::{Force, Position, Velocity},
};

use crate::any;

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

/// CRC-32/ISO-HDLC bit by bit.
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

/// The page's table.
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

crate::properties! {
    /// A frame is the bytes of the page's table, comes back as it was, and with all a CRC-32 notices for certain, any
    /// change of a word or of up to three bits, does not come at all.
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

    /// From a stream that begins anywhere, loses frames and holds garbage every whole frame is read, in order; drops and
    /// garbage are counted.
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
        // what is left of a frame that was cut in front
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
}
