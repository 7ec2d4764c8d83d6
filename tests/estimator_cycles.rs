//! The velocity estimators that look at more than the position, fed with random senses, on an
//! emulated Cortex-M4 (`tests/estimator_cost.rs` has the others): the same bits as on the host, no panic in the
//! image, and the cycles of the worst sample.
#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "a test fails loudly"
)]

mod common;

use virtual_board::{
    board::BOARDS,
    elf::Elf,
    mcu::{Listeners, Mcu},
};
use zwidth::{
    Design, Output,
    units::{Acceleration, Force, Position},
    velocity::{Edge, EstimatorName, Senses, State},
};

/// As `tests/estimator-cycles`.
const DESIGN: Design = Design {
    rate_hz: 1e4,
    resolution_m: 1e-6,
    full_scale_n: 5.906,
    period: 10,
    output: Output::Continuous,
};
/// A quarter of the sample period at 180 MHz and 10 kHz.
const CYCLES_MAX: u32 = 4500;
/// What a person may wait for one answer of the image, in cycles: building settings is soft-float.
const PATIENCE: u64 = 10_000_000;

struct Image {
    mcu: Mcu,
    mailbox: u32,
}

impl Image {
    fn boot() -> Self {
        common::cargo(&["build", "--profile", "firmware", "--package", "estimator-cycles"]);
        let path = common::target_folder().join(common::TARGET).join("firmware/estimator-cycles");
        let elf = Elf::load(&path).unwrap();
        for (name, ..) in &elf.symbols {
            assert!(!name.contains("panicking"), "{name} is in the image");
        }
        let mailbox = elf.address_of("MAILBOX").unwrap();
        let mut mcu = Mcu::new(BOARDS[0].chip, &elf.flash, Listeners::default());
        mcu.run_until(100_000).unwrap();
        Self { mcu, mailbox }
    }

    fn read(&self, word: u32) -> u32 {
        let mut bytes = [0; 4];
        self.mcu.read(self.mailbox + 4 * word, &mut bytes);
        u32::from_le_bytes(bytes)
    }

    fn ask(&mut self, what: u32, words: &[(u32, u32)]) {
        for (word, value) in words.iter().copied().chain([(0, what)]) {
            self.mcu.write(self.mailbox + 4 * word, &value.to_le_bytes());
        }
        let limit = self.mcu.now() + PATIENCE;
        while self.read(0) != 0 {
            assert!(self.mcu.now() < limit, "no answer");
            assert_ne!(self.read(0), u32::MAX, "refused");
            self.mcu.run_until(self.mcu.now() + 100).unwrap();
        }
    }
}

/// A small generator of numbers (Marsaglia, J. Stat. Soft. 8(14), 2003).
struct Random(u32);

impl Random {
    fn next(&mut self) -> u32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 17;
        self.0 ^= self.0 << 5;
        self.0
    }

    /// Motion of every kind for a while each: at rest, slow, fast, at the limit, jumping, reversing.
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

#[test]
fn an_estimator_with_senses_is_the_same_on_the_board_and_within_its_cycles() {
    let mut image = Image::boot();
    for &name in EstimatorName::ALL.iter().filter(|name| name.missing(&[]).is_some()) {
        let mut worst = 0;
        let mut sizes = [0; 2];
        let default = name.parameters().map(|p| p.map_or(0.0, |parameter| parameter.default));
        let longest = name.parameters()[0].is_some_and(|p| p.unit == "samples").then_some(62.0);
        for tuning in [Some(default[0]), longest].into_iter().flatten() {
            let parameters = [tuning, default[1]];
            let estimator = name.settings(parameters).build(&DESIGN).unwrap();
            let mut position = i32::MAX - 1000;
            let mut state = State::at_rest(Position::from_counts(position));
            let [p, q] = parameters.map(f64::to_bits);
            image.ask(
                1,
                &[
                    (1, name.number()),
                    (2, p as u32),
                    (3, (p >> 32) as u32),
                    (4, q as u32),
                    (5, (q >> 32) as u32),
                    (6, position as u32),
                ],
            );
            sizes = [image.read(13), image.read(14)];
            let mut random = Random(1);
            for n in 0..2000 {
                position = position.wrapping_add(random.difference(n));
                let [force, acceleration, age, kind] = [(); 4].map(|()| random.next());
                let edge = match kind % 4 {
                    0 => None,
                    1 => Some(Edge { age, up: kind & 8 != 0 }),
                    _ => Some(Edge { age: age % Edge::SAMPLE, up: kind & 8 != 0 }),
                };
                let senses = Senses {
                    force: Force::saturating_from_bits(force as i32),
                    acceleration: Acceleration::saturating_from_bits(acceleration as i32),
                    edge,
                };
                let expected =
                    estimator.update(&mut state, Position::from_counts(position), &senses);
                image.ask(
                    2,
                    &[
                        (6, position as u32),
                        (7, force),
                        (8, acceleration),
                        (9, edge.map_or(0, |edge| edge.age)),
                        (10, edge.map_or(0, |edge| 1 + u32::from(edge.up))),
                    ],
                );
                assert_eq!(image.read(11) as i32, expected.bits(), "{name:?}, sample {n}");
                worst = worst.max(image.read(12));
            }
        }
        let [coefficients, state] = sizes;
        println!(
            "{}: {worst} cycles; {coefficients} bytes of any estimator, {state} of any state",
            name.text()
        );
        assert!(worst <= CYCLES_MAX, "{name:?}: {worst} cycles");
        assert!(worst >= 10, "the cycle counter runs");
        common::assert_cost(name.text(), worst);
    }
}
