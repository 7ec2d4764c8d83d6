//! Tests frames of both layouts: whole, damaged, and between garbage.

use super::*;
use crate::{
    Design, Output, Settings, WallSettings,
    velocity::{EstimatorName, PARAMETERS},
};
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

/// Some bytes look like the start of a long frame, but the stream ends too early for it. The frames inside these bytes
/// are found, in order.
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

/// Number of frames in a stream. `NOISE` is the largest number of garbage bytes before each frame.
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

    /// A stream has frames of both layouts between garbage. Every output is found once, in order, as it was sent.
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
            // All outputs of a frame get the values that they must share.
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
                frame.encode_after(earlier, *period, &mut whole).finish()
            };
            prop_assert!(earlier.is_empty() || bytes.len() == 46 + 18 * earlier.len());
            // One of the frames lacks its first bytes.
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
        let bytes = Frame { sequence: 1, record: *newest }.encode_after(earlier, 1, &mut whole).finish();
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

fn in_force(
    number: u16,
    name: EstimatorName,
    numbers: [f64; PARAMETERS],
    output: Output,
) -> InForce {
    let design = Design {
        rate_hz: 1e4,
        resolution_m: 1e-6,
        full_scale_n: 5.906 + numbers[0],
        period: 5,
        output,
    };
    let wall = WallSettings {
        position_m: numbers[1],
        stiffness_n_per_m: numbers[2],
        damping_n_s_per_m: numbers[3],
        push_only: number.is_multiple_of(2),
    };
    InForce { number, design, settings: Settings { velocity: name.settings(numbers), wall } }
}

prop_compose! {
    fn moves()(
        start in any::<i32>(),
        small in any::<bool>(),
        moves in prop::collection::vec(
            prop_oneof![8 => -8i32..8, 4 => -140i32..140, 1 => any::<i32>()], 0..=Frame::SAMPLES
        ),
    ) -> Vec<Position> {
        let moves = moves.into_iter().map(|moved| if small { moved.rem_euclid(16) - 8 } else { moved });
        let position = |position: &mut i32, moved: i32| {
            *position = position.wrapping_add(moved);
            Some(Position::from_counts(*position))
        };
        [0].into_iter().chain(moves).scan(start, position).collect()
    }
}

proptest! {
    /// Counts with wraps and escapes, pushes, settings of every estimator and its state are read as they were written.
    /// With a flipped bit nothing is read.
    #[test]
    fn every_part_comes_back(
        frame in frames(), positions in moves(),
        pushes in prop::collection::vec(-(1i32 << 30)..1 << 30, 1..=Frame::OUTPUTS),
        name in prop::sample::select(EstimatorName::ALL), numbers in prop::array::uniform8(1.0f64..60.0),
        output in prop_oneof![
            Just(Output::Continuous), (2u32..24).prop_map(|bits| Output::Dac { bits }),
            (2u32..9000).prop_map(|steps| Output::Pwm { steps })
        ],
        (number, tuning, zeros) in any::<(u16, u16, u16)>(),
        memory in prop::collection::vec(any::<u8>(), 0..=STATE_MAX), with_key in any::<bool>(), place in any::<usize>(),
    ) {
        let numbers = numbers.map(f64::round);
        let pushes: Vec<_> = pushes.into_iter().map(Force::saturating_from_bits).collect();
        let settings = in_force(number, name, numbers, output);
        // A number for which the estimator has no parameter is not written.
        let numbers = EstimatorName::of(&settings.settings.velocity).1;
        prop_assert_eq!(EstimatorName::of(&name.settings(numbers)).1, numbers);
        let frame = Frame { record: Record { position: *positions.last().unwrap(), ..frame.record }, ..frame };
        let key = Key::from_parts(
            (frame.record.sample, number, tuning, zeros), (positions[0], frame.record.velocity), &memory,
        );
        let mut bytes = [0; Frame::LEN_MAX];
        let mut writer = frame.encode_after(&[], 5, &mut bytes).positions(&positions).pushes(&pushes);
        if with_key {
            writer = writer.settings(&settings).key(&key);
        }
        let sent = writer.finish().to_vec();
        let mut decoder = Decoder::new();
        let found: Vec<_> = sent.iter().filter_map(|byte| decoder.push(*byte)).collect();
        prop_assert_eq!(found, [frame]);
        let parts = decoder.parts();
        let mut places = [Position::default(); Frame::SAMPLES + 1];
        prop_assert_eq!(parts.positions(frame.record.position, &mut places), &positions[..]);
        for (n, push) in pushes.iter().enumerate() {
            prop_assert_eq!(parts.push(n), *push);
        }
        prop_assert_eq!(parts.push(pushes.len()), Force::ZERO);
        let told: Vec<_> = parts.settings().collect();
        prop_assert_eq!(told, if with_key { std::vec![Some(settings)] } else { std::vec![] });
        prop_assert_eq!(parts.key(), with_key.then_some(key));
        let mut flipped = sent.clone();
        flipped[place / 8 % sent.len()] ^= 1 << (place % 8);
        let mut decoder = Decoder::new();
        let found = flipped.iter().filter_map(|byte| decoder.push(*byte)).count();
        prop_assert_eq!(found + core::iter::from_fn(|| decoder.finish()).count(), 0);
        prop_assert_eq!(decoder.parts().key(), None);
    }
}
