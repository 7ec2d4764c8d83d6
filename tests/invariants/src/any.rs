//! Strategies for designs, settings and motions. The strategies draw all accepted values, and draw the ends of each
//! range often.

use proptest::prelude::*;
use zwidth::{
    Design, Output, SettingsError, VelocitySettings, limits,
    velocity::{Edge, EstimatorName, PARAMETERS, Senses},
};

/// A fraction of a range. Its ends 0 and 1 are drawn often.
pub fn part() -> impl Strategy<Value = f64> + Clone {
    prop_oneof![8 => 0.0..=1.0f64, 1 => Just(0.0), 1 => Just(1.0)]
}

/// The value at this fraction of a range, on a logarithmic scale if both ends are above 0.
pub fn between(low: f64, high: f64, part: f64) -> f64 {
    if part <= 0.0 {
        low
    } else if part >= 1.0 {
        high
    } else if low > 0.0 {
        (low * (high / low).powf(part)).clamp(low, high)
    } else {
        // A range that begins or ends at 0, or includes 0.
        (low + (high - low) * part * part * part).clamp(low, high)
    }
}

pub fn output() -> impl Strategy<Value = Output> + Clone {
    prop_oneof![
        Just(Output::Continuous),
        (2u32..=24).prop_map(|bits| Output::Dac { bits }),
        (2u32..=1 << 24).prop_map(|steps| Output::Pwm { steps }),
    ]
}

pub fn design() -> impl Strategy<Value = Design> + Clone {
    (part(), part(), part(), part(), output()).prop_map(
        |(rate, resolution, force, period, output)| {
            let of = |range: std::ops::RangeInclusive<f64>, part| {
                between(*range.start(), *range.end(), part)
            };
            let periods = f64::from(*limits::PERIOD.start())..=f64::from(*limits::PERIOD.end());
            Design {
                rate_hz: of(limits::RATE_HZ, rate),
                resolution_m: of(limits::RESOLUTION_M, resolution),
                full_scale_n: of(limits::FULL_SCALE_N, force),
                period: of(periods, period).round() as u32,
                output,
            }
        },
    )
}

pub const PAPER: Design = Design {
    rate_hz: 1e4,
    resolution_m: 1e-6,
    full_scale_n: 5.906,
    period: 10,
    output: Output::Dac { bits: 12 },
};

pub fn estimator() -> impl Strategy<Value = EstimatorName> + Clone {
    prop::sample::select(EstimatorName::ALL)
}

/// Parameters of an estimator as fractions of their ranges, for [`tuned`].
pub type Parts = [f64; PARAMETERS];

pub fn parts() -> impl Strategy<Value = Parts> + Clone {
    prop::array::uniform8(part())
}

/// The estimator with its parameters at these fractions of their accepted ranges. `None` if the design leaves no range.
pub fn tuned(name: EstimatorName, parts: Parts, design: &Design) -> Option<VelocitySettings> {
    let mut numbers = [f64::NAN; PARAMETERS];
    for (place, parameter) in name.parameters().iter().enumerate() {
        if parameter.is_none() {
            numbers[place] = 0.0;
        }
    }
    // An error names the parameter and its range. Then this parameter is set.
    for _ in 0..2 * PARAMETERS {
        let Err(SettingsError { parameter, range, .. }) = name.settings(numbers).build(design)
        else {
            return Some(name.settings(numbers));
        };
        let place = name.keys().iter().position(|key| *key == parameter)?;
        let (low, high) = (*range.start(), *range.end());
        if low > high {
            return None;
        }
        let value = between(low, high, parts[place]);
        let whole = name.parameters()[place].is_some_and(|parameter| parameter.is_whole());
        numbers[place] = if whole { value.round().clamp(low.ceil(), high.floor()) } else { value };
    }
    None
}

/// A piece of a motion, in counts and samples.
#[derive(Clone, Copy, Debug)]
pub enum Piece {
    /// At rest for this number of samples.
    Hold(u16),
    /// A motion at constant speed. The numbers are the speed in counts per sample, and the number of samples.
    Slope(f64, u16),
    /// A motion with constant acceleration. The numbers are the acceleration in counts per sample^2, and the number of
    /// samples.
    Curve(f64, u16),
    /// A random motion to and fro. The numbers are the largest distance in counts, the number of samples, and the seed.
    Flicker(u16, u16, u64),
    /// A jump by this number of counts.
    Leap(i32),
}

/// Draws motions that a handle can make, with speeds up to `fastest` counts per sample.
pub fn motion(fastest: f64) -> impl Strategy<Value = Vec<Piece>> + Clone {
    let speed = move || {
        (part(), any::<bool>()).prop_map(move |(part, back)| {
            let speed = between(1e-4, fastest, part);
            if back { -speed } else { speed }
        })
    };
    prop::collection::vec(
        prop_oneof![
            1 => (1u16..200).prop_map(Piece::Hold),
            3 => (speed(), 1u16..300).prop_map(|(speed, samples)| Piece::Slope(speed, samples)),
            1 => (speed(), 1u16..300)
                .prop_map(|(speed, samples)| Piece::Curve(speed / f64::from(samples), samples)),
            2 => (1u16..1000, 1u16..200, any::<u64>()).prop_map(move |(counts, samples, seed)| {
                Piece::Flicker(counts.clamp(1, 1 + (fastest / 2.0) as u16), samples, seed)
            }),
        ],
        1..8,
    )
}

/// Draws motions that no handle can make. They jump over the whole range of a counter.
pub fn nonsense() -> impl Strategy<Value = Vec<Piece>> + Clone {
    prop::collection::vec(
        prop_oneof![
            3 => any::<i32>().prop_map(Piece::Leap),
            1 => prop::sample::select(vec![i32::MIN, i32::MAX, 32_767, -32_768]).prop_map(Piece::Leap),
            1 => (1u16..100).prop_map(Piece::Hold),
            2 => (-40_000.0..40_000.0, 1u16..100).prop_map(|(speed, samples)| Piece::Slope(speed, samples)),
            1 => (any::<u16>(), 1u16..100, any::<u64>())
                .prop_map(|(counts, samples, seed)| Piece::Flicker(counts.max(1), samples, seed)),
        ],
        1..20,
    )
}

/// Position of the handle at each sample, in counts from its start, as real numbers.
pub fn places(pieces: &[Piece]) -> Vec<f64> {
    let mut places = Vec::new();
    let mut at = 0.0f64;
    for piece in pieces {
        match *piece {
            Piece::Hold(samples) => places.extend((0..samples).map(|_| at)),
            Piece::Slope(speed, samples) => {
                places.extend((1..=samples).map(|n| at + speed * f64::from(n)));
            }
            Piece::Curve(acceleration, samples) => places.extend((1..=samples).map(|n| {
                let n = f64::from(n);
                at + acceleration * n * (n + 1.0) / 2.0
            })),
            Piece::Flicker(counts, samples, seed) => {
                let mut random = Random(seed);
                let from = at;
                places.extend((0..samples).map(|_| {
                    let away = random.below(2 * u64::from(counts) + 1) as f64 - f64::from(counts);
                    from + away
                }));
            }
            Piece::Leap(counts) => places.push(at + f64::from(counts)),
        }
        at = places.last().copied().unwrap_or(at);
    }
    places
}

/// The count at each sample of this motion.
pub fn counts(pieces: &[Piece]) -> Vec<i64> {
    places(pieces).into_iter().map(|place| place.floor() as i64).collect()
}

/// Random numbers for a test case that has a seed in place of a list of numbers.
#[derive(Clone, Copy, Debug)]
pub struct Random(pub u64);

impl Random {
    /// The next 64 random bits, by SplitMix64.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// A number from 0 to `end - 1`.
    pub fn below(&mut self, end: u64) -> u64 {
        ((u128::from(self.bits()) * u128::from(end)) >> 64) as u64
    }

    /// A number from 0 to 1.
    pub fn part(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Random senses, mostly without physical meaning.
    pub fn senses(&mut self) -> Senses {
        use zwidth::units::{Acceleration, Force};
        let bits = |random: &mut Self| (random.bits() as i32) >> random.below(31);
        let age = |random: &mut Self| (random.bits() as u32) >> random.below(31);
        Senses {
            force: Force::saturating_from_bits(bits(self)),
            acceleration: Acceleration::saturating_from_bits(bits(self)),
            edge: (self.below(3) > 0).then(|| Edge { age: age(self), up: self.below(2) == 0 }),
        }
    }
}

/// Draws changes of some words that a CRC-32 always detects. They change one word, or up to three bits. A CRC-32 misses
/// one in 2^32 of all other changes.
pub fn noticed(words: usize) -> impl Strategy<Value = Vec<(usize, u32)>> + Clone {
    prop_oneof![
        prop::collection::vec((0..words, 1u32..), 1),
        prop::collection::vec((0..words, (0..32u32).prop_map(|bit| 1 << bit)), 1..4),
    ]
}
