//! Runs every estimator on the board's core. The image has no panic. The velocities equal the host's bit for bit. No
//! update takes more than a quarter of the sample period. The cycles are the emulator's, with zero wait states. The
//! cycles were not compared with silicon.

use zwidth::{
    Design, Output, VelocitySettings,
    units::{Acceleration, Force, Position},
    velocity::{Edge, EstimatorName, Senses, State},
};

use crate::figure::figure;
use crate::mailbox::{Mailbox, assert_cost};

/// Largest allowed number of cycles. It is a quarter of the sample period of 100 us at 168 MHz, the clock of the slower
/// board.
const CYCLES_MAX: u32 = 4200;
const SAMPLES: usize = 4096;
/// The table that `cargo sim compare` uses.
pub const TABLE: &str = include_str!("../../host-sim/data/estimator_cost.csv");
const DESIGN: Design = Design {
    rate_hz: 1e4,
    resolution_m: 1e-6,
    full_scale_n: 5.906,
    period: 10,
    output: Output::Continuous,
};

fn words_of(senses: &Senses) -> [u32; 4] {
    let Senses { force, acceleration, edge } = senses;
    let (age, kind) = edge.map_or((0, 0), |edge| (edge.age, 1 + u32::from(edge.up)));
    [force.bits().cast_unsigned(), acceleration.bits().cast_unsigned(), age, kind]
}

/// A small random number generator (Marsaglia, J. Stat. Soft. 8(14), 2003).
struct Random(u32);

impl Random {
    fn next(&mut self) -> u32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 17;
        self.0 ^= self.0 << 5;
        self.0
    }

    /// Random values for the inputs beside the count. The force is any force. The edge belongs to this sample or an
    /// older one, or is missing.
    fn senses(&mut self) -> Senses {
        let [force, acceleration, age, kind] = [(); 4].map(|()| self.next());
        let up = kind & 8 != 0;
        Senses {
            force: Force::saturating_from_bits(force as i32),
            acceleration: Acceleration::saturating_from_bits(acceleration as i32),
            edge: match kind % 4 {
                0 => None,
                1 => Some(Edge { age, up }),
                _ => Some(Edge { age: age % Edge::SAMPLE, up }),
            },
        }
    }

    /// Difference of counts at sample `n`. The kinds of motion follow each other, each for some time: rest, slow, fast,
    /// at the limit, jumps, reversals.
    fn difference(&mut self, n: u32) -> i32 {
        let random = self.next();
        match n / 70 % 7 {
            0 => 0,
            1 => i32::from(random.is_multiple_of(20)),
            2 => (random % 7) as i32 - 3,
            3 => 300,
            4 => {
                if n.is_multiple_of(2) {
                    32_767
                } else {
                    -32_767
                }
            }
            5 => -32_767,
            _ => random as i32,
        }
    }
}

/// Inputs that may make an update long. They have standstill, full windows, ends of the range, reversals, chatter,
/// noise of every size, and random jumps.
fn inputs() -> Vec<i32> {
    let mut seed = 1u32;
    let mut random = move || {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (seed >> 4) as i32
    };
    let mut all = vec![0; 100];
    all.extend((0..200).map(|n| i32::from(n % 3 == 0)));
    all.extend([1; 100]);
    all.extend([32_767; 150]);
    all.extend([-32_767; 150]);
    all.extend((0..200).map(|n| if n % 2 == 0 { 32_767 } else { -32_767 }));
    all.extend([0; 300]);
    // For adaptive windowing: a line whose bounds come closer and closer.
    all.extend((0..64).map(|n| 100 + if n % 2 == 0 { 1 } else { -1 } * (64 - n) / 8));
    all.extend((0..200).map(|n| n * n / 40));
    for bits in 1..16 {
        all.extend((0..100).map(|_| (random() & ((1 << bits) - 1)) - (1 << (bits - 1))));
    }
    all.extend([i32::MAX, i32::MIN, 0, i32::MIN, i32::MAX]);
    let mut motion = Random(1);
    let left = SAMPLES.saturating_sub(all.len()) as u32;
    assert!(left > 1000, "all kinds of motion fit");
    all.extend((0..left).map(|n| motion.difference(n)));
    all
}

/// The estimator with its smallest, default and largest parameter values.
fn tunings(name: EstimatorName) -> Vec<VelocitySettings> {
    let usual = name.defaults();
    let tuning = usual.tuning().map_or(0.0, |(_, value)| value);
    let mut all = vec![usual];
    for factor in [0.05, 0.2, 2.0, 30.0] {
        let settings = usual.with_tuning(tuning * factor);
        if settings.build(&DESIGN).is_ok() && tuning != 0.0 {
            all.push(settings);
        }
    }
    if name.parameters()[0].is_some_and(|parameter| parameter.unit == "samples")
        && usual.with_tuning(62.0).build(&DESIGN).is_ok()
    {
        all.push(usual.with_tuning(62.0));
    }
    if name.text().starts_with("foaw") {
        all.push(usual.with_tuning(32.0).with_second(1000.0)); // every window is tried
    }
    all
}

#[test]
#[ignore = "a program of its own for the target; CI runs it"]
fn on_the_target_every_estimator_is_as_on_the_host_and_takes_a_quarter_of_the_period_at_most() {
    let mut target = Mailbox::of("estimator-cost", &["estimators"]);
    let inputs = inputs();
    let mut measured = vec![];
    for &name in EstimatorName::ALL {
        let (mut most, mut usual, mut bytes) = (0, 0, 0);
        let mut random = Random(1);
        let sensed = name.missing(&[]).is_some();
        let senses: Vec<Senses> =
            inputs.iter().map(|_| if sensed { random.senses() } else { Senses::NONE }).collect();
        for settings in tunings(name) {
            let words: Vec<u32> = senses.iter().flat_map(words_of).collect();
            target.set("SENSES", &words);
            let (_, parameters) = EstimatorName::of(&settings);
            let halves = |value: f64| [value.to_bits() as u32, (value.to_bits() >> 32) as u32];
            let parameters: Vec<u32> = parameters.into_iter().flat_map(halves).collect();
            let job: Vec<u32> = [&[name.id()], &parameters[..], &[inputs.len() as u32]].concat();
            let (velocities, cycles, size) = target.run(name.text(), &job, &inputs);
            let estimator = settings.build(&DESIGN).unwrap();
            let mut state = State::at_rest(Position::default());
            let mut count = 0i32;
            for (n, ((input, velocity), senses)) in
                inputs.iter().zip(velocities).zip(&senses).enumerate()
            {
                count = count.wrapping_add(*input);
                let position = Position::from_counts(count);
                let host = estimator.update(&mut state, position, senses);
                assert_eq!(velocity, host.bits(), "{settings:?}, sample {n}");
            }
            most = most.max(*cycles.iter().max().unwrap());
            if usual == 0 {
                usual = cycles.iter().sum::<u32>() / SAMPLES as u32;
            }
            bytes = size;
        }
        println!("{}: at most {most} cycles, mean {usual} at the default; {bytes} B", name.text());
        for (key, value) in [("most", most), ("mean", usual)] {
            figure(&format!("elf/estimator_cost/{}/{key}", name.text()), value);
        }
        assert!(most > 0 && most <= CYCLES_MAX, "{name:?}: {most} cycles");
        measured.push((name, most));
    }
    // Checked last, so that all rows are printed before a check fails.
    for (name, most) in measured {
        assert_cost("estimator_cost.csv", TABLE, name.text(), most);
    }
}
