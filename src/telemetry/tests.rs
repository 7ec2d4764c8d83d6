//! Both layouts, whole, damaged and between garbage.

use super::*;
use proptest::prelude::*;
use std::vec::Vec;

prop_compose! {
    fn frames()(
        sequence in any::<u32>(), sample in any::<u64>(), position in any::<i32>(),
        velocity in -(32_767i32 << 16)..=32_767 << 16, force in -(1i32 << 30)..=1 << 30,
        command in any::<i32>(), flags in any::<u16>(), settings in any::<u16>(),
        fault in any::<u8>(),
    ) -> Frame {
        Frame {
            sequence,
            record: Record {
                sample,
                position: Position::from_counts(position),
                velocity: Velocity::saturating_from_bits(velocity),
                force: Force::saturating_from_bits(force),
                command: OutputCode(command),
                flags: Flags::from_bits(flags),
                settings,
                fault,
            },
        }
    }
}

fn frame(sequence: u32) -> Frame {
    Frame { sequence, ..Frame::default() }
}

/// The bytes that `docs/telemetry.md` shows.
const EXAMPLE: [u8; Frame::LEN] = [
    0x5A, 0x57, 1, 0, 7, 0, 0, 0, 0x10, 0x27, 0, 0, 0, 0, 0, 0, 0x70, 0x11, 1, 0, 0, 0x80, 0, 0, 0,
    0, 0, 0xE0, 0, 4, 0, 0, 0x9B, 1, 3, 0, 0, 0, 0, 0,
];

#[test]
fn the_layout_is_the_documented_one() {
    let bytes = Frame {
        sequence: 7,
        record: Record {
            sample: 10_000,
            position: Position::from_counts(70_000),
            velocity: Velocity::saturating_from_bits(1 << 15),
            force: Force::saturating_from_bits(-(1 << 29)),
            command: OutputCode(1024),
            flags: Flags::from_bits(0x019B),
            settings: 3,
            fault: 0,
        },
    }
    .encode();
    assert_eq!(bytes[..36], EXAMPLE[..36]);
    assert_eq!(bytes[36..], crc::of_bytes(&EXAMPLE[..36]).to_le_bytes());
    let document = include_str!("../../docs/telemetry.md");
    let dump: Vec<_> = bytes.iter().map(|b| std::format!("{b:02X}")).collect();
    let shown = document.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(shown.contains(&dump.join(" ")), "{}", dump.join(" "));
}

#[test]
fn drops_are_counted_across_the_wrap_and_a_restart_is_none() {
    let mut decoder = Decoder::new();
    for sequence in [u32::MAX - 1, u32::MAX, 0, 3, 4, 0, 1] {
        let found: Vec<_> =
            frame(sequence).encode().into_iter().filter_map(|byte| decoder.push(byte)).collect();
        assert_eq!(found, [frame(sequence)]);
    }
    assert_eq!((decoder.frames, decoder.dropped, decoder.garbage), (7, 2, 0));
}

/// The stream ends before what said that it is a long frame: what stands in it is found, and in order.
#[test]
fn frames_behind_the_beginning_of_a_long_one_that_never_ends_are_found() {
    let mut stream = [0; 40];
    stream[..3].copy_from_slice(b"ZW\x02");
    stream[36] = 200;
    let mut decoder = Decoder::new();
    let bytes = [&stream[..], &frame(1).encode(), &frame(2).encode(), b"ZW"].concat();
    assert_eq!(bytes.into_iter().filter_map(|byte| decoder.push(byte)).count(), 0);
    let found: Vec<_> = core::iter::from_fn(|| decoder.finish()).collect();
    assert_eq!(found, [frame(1), frame(2)]);
    assert_eq!((decoder.frames, decoder.dropped, decoder.garbage), (2, 0, 42));
}

/// Frames in a stream, and bytes of garbage before each.
const PARTS: usize = if cfg!(miri) { 3 } else { 20 };
const NOISE: usize = if cfg!(miri) { 8 } else { 90 };

proptest! {
    #[test]
    fn any_frame_comes_back_and_no_flipped_byte_passes(
        frame in frames(), place in 0..Frame::LEN, flip in 1u8..
    ) {
        let mut bytes = frame.encode();
        prop_assert_eq!(Frame::decode(&bytes), Some(frame));
        bytes[place] ^= flip;
        prop_assert_eq!(Frame::decode(&bytes), None);
    }

    #[test]
    fn every_whole_frame_is_found_between_garbage(
        parts in prop::collection::vec(
            (frames(), prop::collection::vec(prop_oneof![Just(b'Z'), Just(b'W'), any::<u8>()], 0..NOISE)),
            0..PARTS,
        )
    ) {
        let mut decoder = Decoder::new();
        let (mut found, mut sent, mut garbage) = (Vec::new(), Vec::new(), 0);
        for (frame, noise) in &parts {
            sent.push(*frame);
            garbage += noise.len() as u64;
            for byte in noise.iter().copied().chain(frame.encode()) {
                found.extend(decoder.push(byte));
            }
        }
        found.extend(core::iter::from_fn(|| decoder.finish()));
        prop_assert_eq!(found, sent);
        prop_assert_eq!(decoder.garbage, garbage);
    }

    /// Frames of both layouts between garbage: every output once, in order, as it was sent.
    #[test]
    fn every_output_of_long_frames_is_found_between_garbage_and_short_ones(
        parts in prop::collection::vec(
            (
                prop::collection::vec(frames(), 1..=Frame::OUTPUTS),
                1u8..=10,
                prop::collection::vec(prop_oneof![Just(b'Z'), Just(b'W'), Just(2), Just(60), any::<u8>()], 0..NOISE),
            ),
            0..PARTS,
        ),
        cut in prop_oneof![Just(0usize), 40usize..200],
    ) {
        let mut decoder = Decoder::new();
        let (mut found, mut sent, mut garbage) = (Vec::new(), Vec::new(), 0);
        let mut take = |decoder: &mut Decoder, byte: Option<u8>| {
            let frame = match byte {
                Some(byte) => decoder.push(byte),
                None => decoder.finish(),
            };
            if let Some(frame) = frame {
                found.extend(decoder.outputs(frame));
            }
            frame.is_some()
        };
        let mut whole = [0; Frame::LEN_MAX];
        for (n, (outputs, period, noise)) in parts.iter().enumerate() {
            // what the outputs of a frame share
            let Frame { sequence, record: Record { sample, settings, fault, .. } } = outputs[0];
            let count = outputs.len() as u64;
            let outputs: Vec<_> = outputs.iter().zip((0..count).rev()).map(|(output, back)| {
                let sample = sample.wrapping_sub(back * u64::from(*period));
                Record { sample, settings, fault, ..output.record }
            }).collect();
            let (newest, earlier) = outputs.split_last().unwrap();
            let frame = Frame { sequence, record: *newest };
            let short = frame.encode();
            let bytes = if earlier.is_empty() && n % 2 == 0 {
                &short[..]
            } else {
                frame.encode_after(earlier, *period, &mut whole)
            };
            prop_assert!(earlier.is_empty() || bytes.len() == 46 + 18 * earlier.len());
            // one of them is cut in front
            let bytes = if n == 1 { &bytes[cut.min(bytes.len())..] } else { bytes };
            if n == 1 && cut > 0 {
                garbage += bytes.len() as u64;
            } else {
                sent.extend(outputs.iter().map(|record| Frame { sequence, record: *record }));
            }
            garbage += noise.len() as u64;
            for byte in noise.iter().chain(bytes) {
                take(&mut decoder, Some(*byte));
            }
        }
        while take(&mut decoder, None) {}
        prop_assert_eq!(found, sent);
        prop_assert_eq!(decoder.garbage, garbage);
    }

    #[test]
    fn no_flipped_bit_of_a_long_frame_passes(
        outputs in prop::collection::vec(frames(), 1..=Frame::OUTPUTS), place in any::<usize>(), bit in 0..8,
    ) {
        let outputs: Vec<_> = outputs.iter().map(|frame| frame.record).collect();
        let (newest, earlier) = outputs.split_last().unwrap();
        let mut whole = [0; Frame::LEN_MAX];
        let bytes = Frame { sequence: 1, record: *newest }.encode_after(earlier, 1, &mut whole);
        let length = bytes.len();
        whole[place % length] ^= 1u8 << bit;
        let mut decoder = Decoder::new();
        let found = whole[..length].iter().filter_map(|byte| decoder.push(*byte)).count();
        prop_assert_eq!(found + core::iter::from_fn(|| decoder.finish()).count(), 0);
    }

    #[test]
    fn a_cut_frame_costs_itself_only(cut in 1..Frame::LEN) {
        let mut decoder = Decoder::new();
        let stream = [&frame(0).encode()[..], &frame(1).encode()[cut..], &frame(2).encode()]
            .concat();
        let found: Vec<_> = stream.into_iter().filter_map(|b| decoder.push(b)).collect();
        prop_assert_eq!(found, [frame(0), frame(2)]);
        prop_assert_eq!(decoder.dropped, 1);
    }
}
