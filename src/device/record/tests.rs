//! Tests that a record is read as it was made, and that every error in a record is found and named.

use proptest::prelude::*;
use std::{string::ToString, vec::Vec};

use super::*;
use crate::{
    VelocitySettings,
    device::{
        designs::tests::NAMED,
        tests::{BOUNDARY, DEVICE, point},
    },
    safety::envelope::{Key, Outside},
    velocity::{EstimatorName, Sense},
};

const BOARD: BoardFacts = BoardFacts {
    name: "a-board",
    rate_hz: 10_000.0,
    output: Output::Dac { bits: 12 },
    senses: &[Sense::Force],
    latency_samples: 0.115,
};

fn record(device: &Device<'_>) -> Vec<u32> {
    device.to_record(&[], &[BOUNDARY], &mut [0; WORDS_MAX]).unwrap().to_vec()
}

fn refused(words: &[u32]) -> BadRecord {
    Device::from_record(words, &BOARD).unwrap_err()
}

/// Returns the words with a correct checksum.
fn signed(mut words: Vec<u32>) -> Vec<u32> {
    let (check, body) = words.split_last_mut().unwrap();
    *check = crc::of_words(body);
    words
}

#[test]
fn a_record_comes_back_and_erased_flash_behind_it_does_not_matter() {
    let mut words = record(&DEVICE);
    assert_eq!(words.len(), 18 + 2 * 47 + 5 + 2 * 3);
    let hash = *words.last().unwrap();
    let key = DeviceKey { hash, ..DEVICE.key };
    let expected = Device { key, ..*DEVICE };
    assert_eq!(Device::from_record(&words, &BOARD), Ok(expected));
    words.resize(WORDS_MAX, BLANK);
    assert_eq!(Device::from_record(&words, &BOARD), Ok(expected));
    let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
    assert_eq!(&bytes[BOARD_AT..BOARD_AT + 8], b"a-board\0");
}

/// Every byte is changed to every value that differs in one bit or in all bits. The record is cut at every length.
#[test]
fn no_record_with_a_wrong_byte_and_none_that_is_cut_short_is_taken() {
    let words = record(&DEVICE);
    let mut sector = words.clone();
    sector.resize(WORDS_MAX, BLANK);
    for byte in 0..4 * words.len() {
        for turned in [0xFF, 1, 2, 4, 8, 16, 32, 64, 128u32] {
            let mut bad = sector.clone();
            bad[byte / 4] ^= turned << (8 * (byte % 4));
            let why = refused(&bad);
            let expected = match byte {
                0..3 => matches!(why, BadRecord::Foreign),
                3 => matches!(why, BadRecord::Layout(layout) if layout != LAYOUT),
                4..8 => matches!(why, BadRecord::Length(_) | BadRecord::Damaged),
                _ => why == BadRecord::Damaged,
            };
            assert!(expected, "byte {byte}: {why}");
        }
    }
    for cut in 0..words.len() {
        let mut programmed = words[..cut].to_vec();
        assert_ne!(Device::from_record(&programmed, &BOARD).err(), None, "{cut}");
        programmed.resize(WORDS_MAX, BLANK);
        let why = refused(&programmed);
        let expected = match cut {
            0 => BadRecord::Blank,
            1 => BadRecord::Length(BLANK),
            _ => BadRecord::Damaged,
        };
        assert_eq!(why, expected, "{cut}");
    }
}

#[test]
fn what_is_wrong_with_a_whole_record_is_named() {
    let says = |words: &[u32], text: &str| assert_eq!(refused(words).to_string(), text);
    let with = |edit: fn(&mut Device<'static>)| {
        let mut device = *DEVICE;
        edit(&mut device);
        record(&device)
    };
    says(&[], "what is in its place is none");
    says(&[BLANK; 100], "there is none");
    says(&[0; 100], "what is in its place is none");
    let mut later = record(&DEVICE);
    later[0] += 1 << 24;
    says(&signed(later), "its layout is 5, this firmware takes 4");
    let mut long = record(&DEVICE);
    long[1] = 5000;
    says(&signed(long), "its length is 5000 words, allowed 112 to 4096");
    says(&with(|device| device.board = Name::of("other")), "it is for the board other");
    says(&with(|device| device.key.name = Name::of("")), "a name in it is no text");
    says(&with(|device| device.board = Name::of("")), "a name in it is no text");
    let output = "its force output is not this board's";
    says(&with(|device| device.design.output = Output::Dac { bits: 10 }), output);
    let rate = with(|device| device.design.rate_hz = 5e3);
    says(&rate, "rate_hz is 5000, allowed 10000 to 10000");
    let fast = refused(&with(|device| device.latency_samples = 0.1)).to_string();
    assert!(fast.starts_with("latency_samples is 0.1, allowed 0.115 to "), "{fast}");
    let travel = refused(&with(|device| device.safety.travel_high_m = f64::NAN)).to_string();
    assert!(travel.starts_with("travel_high_m is nan, allowed "), "{travel}");
    let period = with(|device| device.design.period = 3);
    says(&period, "the board cannot run its estimator at its output period");
    let mut envelope = record(&DEVICE);
    envelope[BEFORE_TABLES + 4] = 3;
    says(&signed(envelope), "its envelope is no table");
    let mut estimator = record(&DEVICE);
    estimator[FIXED - 1] = 999;
    says(&signed(estimator), "its estimator, number 999, is not in this image");
    let mut kind = record(&DEVICE);
    kind[13] = 3;
    says(&signed(kind), output);
}

/// A NaN in place of any number is refused.
#[test]
fn a_number_that_is_none_is_refused_wherever_it_stands() {
    let words = record(&DEVICE);
    // Parameters that the estimator does not have.
    let unused = 30..37;
    for number in 0..NUMBERS {
        let mut bad = words.clone();
        let [low, high] = halves(f64::NAN);
        (bad[FIXED + 2 * number], bad[FIXED + 2 * number + 1]) = (low, high);
        let why = refused(&signed(bad));
        let expected = match unused.contains(&number) {
            true => why == BadRecord::Unknown,
            false => matches!(why, BadRecord::Range(_)),
        };
        assert!(expected, "{number}: {why}");
    }
}

/// Each of these numbers is refused. With it, the board could miss a fault or could not stop a motion.
#[test]
fn a_device_that_nobody_holds_is_refused() {
    type Edit = fn(&mut Device<'static>);
    let edits: [(&str, Edit); 8] = [
        ("latency_samples", |device| device.latency_samples = 1e300),
        ("travel_low_m", |device| device.safety.travel_low_m = -11.0),
        ("travel_high_m", |device| device.safety.travel_high_m = 1000.0),
        ("heaviest_mass_kg", |device| device.safety.heaviest_mass_kg = 1e-5),
        ("heaviest_mass_kg", |device| device.safety.heaviest_mass_kg = 2e6),
        ("radius_m", |device| device.radius_m = 1e-300),
        ("radius_m", |device| device.radius_m = -0.01),
        ("speed_believable_m_per_s", |device| device.safety.speed_believable_m_per_s = 101.0),
    ];
    for (key, edit) in edits {
        let mut device = *DEVICE;
        edit(&mut device);
        let why = refused(&record(&device)).to_string();
        assert!(why.starts_with(key) && why.contains("allowed"), "{key}: {why}");
    }
    for flag in [4, 5, 7, 16, 31] {
        let mut flags = record(&DEVICE);
        flags[11] |= 1 << flag;
        assert_eq!(refused(&signed(flags)), BadRecord::Unknown, "{flag}");
    }
}

#[test]
fn designs_stand_before_the_envelope_and_each_is_checked() {
    let points = [BOUNDARY.points[1]];
    let of_design = Boundary { key: Key { design: 2, ..BOUNDARY.key }, points: &points };
    let made = |designs: &[NamedFilter]| {
        let mut words = [0; WORDS_MAX];
        DEVICE.to_record(designs, &[BOUNDARY, of_design], &mut words).unwrap().to_vec()
    };
    let words = made(&NAMED);
    let device = Device::from_record(&words, &BOARD).unwrap();
    assert_eq!(words.len(), record(&DEVICE).len() + 2 * 21 + 5 + 3);
    assert!(device.designs.iter().map(|(_, design)| design).eq(NAMED));
    let again =
        device.to_record(&NAMED, &[BOUNDARY, of_design], &mut [0; WORDS_MAX]).unwrap().to_vec();
    assert_eq!(again, words);
    // The record states one design more than it has. So words of the envelope are read as a design.
    let mut short = words.clone();
    short[11] += 1 << DESIGNS;
    assert_eq!(refused(&signed(short)), BadRecord::Designs);
    let mut many = words;
    many[11] |= 0xFF << DESIGNS;
    assert_eq!(refused(&signed(many)).to_string(), "its designs are no table");
    let fast =
        NamedFilter { velocity: VelocitySettings::Butterworth { cutoff_hz: 5000.0 }, ..NAMED[0] };
    let why = refused(&made(&[NAMED[1], fast])).to_string();
    assert!(why.starts_with("cutoff_hz is 5000, allowed "), "{why}");
}

/// The gains of the design are allowed only at the output periods of its rows.
#[test]
fn a_design_has_its_own_rows_of_the_envelope() {
    let low = [point(0.0, 100.0), point(50.0, 100.0)];
    let of_design = Boundary { key: Key { design: 2, ..BOUNDARY.key }, points: &low };
    let mut words = [0; WORDS_MAX];
    let words = DEVICE.to_record(&NAMED, &[BOUNDARY, of_design], &mut words).unwrap();
    let device = Device::from_record(words, &BOARD).unwrap();
    let mut stored = device.defaults();
    (stored.settings.wall.stiffness_n_per_m, stored.settings.wall.damping_n_s_per_m) =
        (100.0, 20.0);
    stored.settings.velocity = NAMED[1].velocity;
    assert_eq!(device.key(&stored).design, 2);
    assert_eq!(device.inside(&stored), Ok(()));
    stored.settings.wall.stiffness_n_per_m = 101.0;
    assert_eq!(device.inside(&stored), Err(Outside::Stiffness { lowest: 0.0, highest: 100.0 }));
    assert_eq!(DEVICE.inside(&stored), Ok(()));
    stored.settings.wall.stiffness_n_per_m = 1.0;
    stored.period = 5;
    assert_eq!(device.inside(&stored), Err(Outside::UnknownKey));
    // Design number 1 has no table in the envelope.
    (stored.period, stored.settings.velocity) = (10, NAMED[0].velocity);
    assert_eq!(device.inside(&stored), Err(Outside::UnknownKey));
}

#[test]
fn a_record_that_has_no_room_is_not_made() {
    let points = [BOUNDARY.points[0]; 1400];
    let boundary = Boundary { points: &points, ..BOUNDARY };
    assert_eq!(DEVICE.to_record(&[], &[boundary], &mut [0; WORDS_MAX]), None);
}

proptest! {
    #[test]
    fn every_number_keeps_its_place(numbers in any::<[f64; NUMBERS]>(), words in any::<[u32; 3]>(), signs in any::<[bool; 2]>()) {
        let mut made = record(&DEVICE);
        for (n, number) in numbers.into_iter().enumerate() {
            // the estimator does not have these parameters
            let number = if (30..37).contains(&n) { 0.0 } else { number };
            [made[FIXED + 2 * n], made[FIXED + 2 * n + 1]] = halves(number);
        }
        (made[2], made[12], made[15]) = (words[0], words[1], words[2]);
        made[11] = (u32::from(signs[0]) * MOTOR_REVERSED) | (u32::from(signs[1]) * ENCODER_REVERSED);
        let made = signed(made);
        let device = Device::decode(&made, &BOARD).unwrap();
        prop_assert_eq!(device.key.hash, *made.last().unwrap());
        let mut sector = [0; WORDS_MAX];
        let again = device.to_record(&[], &[BOUNDARY], &mut sector).unwrap();
        for n in 0..made.len() - 1 {
            prop_assert_eq!(again[n], made[n], "word {}", n);
        }
    }

    #[test]
    fn arbitrary_words_never_panic(words in proptest::collection::vec(any::<u32>(), 0..200)) {
        let mut words = words;
        let _ = Device::from_record(&words, &BOARD);
        if words.len() > 2 {
            (words[0], words[1]) = (HEAD, u32::try_from(words.len()).unwrap());
            let _ = Device::from_record(&signed(words), &BOARD);
        }
    }
}

#[test]
fn an_estimator_of_another_build_has_a_number_that_is_free() {
    assert_eq!(EstimatorName::from_id(999), None);
}
