//! Two biquads in series, which follow the finite difference. Together they have four poles and four zeros.
//!
//! The output of the first section is a [`Velocity`], rounded with its own error feedback. So nothing is lost between
//! the two sections at rest and at a constant speed. [`CascadeDesign`](super::CascadeDesign) has the equations.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use super::{Biquad, BiquadState, Form, Senses};
use crate::units::Velocity;

/// Two biquads in series. Made by [`CascadeDesign::quantise`](super::CascadeDesign::quantise).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cascade {
    pub(super) sections: [Biquad; 2],
}

impl Cascade {
    /// The sections in their order.
    pub fn sections(&self) -> &[Biquad; 2] {
        &self.sections
    }
}

impl Form for Cascade {
    type State = [BiquadState; 2];
    const REST: [BiquadState; 2] = [<Biquad as Form>::REST; 2];

    fn at(&self, velocity: Velocity) -> [BiquadState; 2] {
        let [first, second] = &self.sections;
        [first.at(velocity), second.at(velocity)]
    }

    #[inline]
    fn step(&self, state: &mut [BiquadState; 2], difference: i32, _: &Senses) -> Velocity {
        let [first, second] = &self.sections;
        let [of_first, of_second] = state;
        let between = first.update(of_first, Velocity::saturating_from_counts(difference));
        second.update(of_second, between)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::velocity::CascadeDesign;
    use std::vec::Vec;

    const FIRST: [f64; 4] = [430.0, 0.3, 1e-4, -0.4];
    const SECOND: [f64; 4] = [1.7, 0.8, -1e-4, 0.2];

    fn run(form: &Cascade, velocity: Velocity, counts: impl Iterator<Item = i32>) -> Vec<i32> {
        let mut state = form.at(velocity);
        counts.map(|count| form.step(&mut state, count, &Senses::default()).bits()).collect()
    }

    /// The reference is the product of both transfer functions, as one recursion of fourth order.
    #[test]
    fn it_is_the_product_of_its_sections() {
        let design = CascadeDesign::new(FIRST, SECOND, 1e4).unwrap();
        let [one, two] = design.sections;
        let times = |p: &[f64; 3], q: &[f64; 3]| {
            let mut product = [0.0; 5];
            for (n, a) in p.iter().enumerate() {
                for (m, b) in q.iter().enumerate() {
                    product[n + m] += a * b;
                }
            }
            product
        };
        let of = |[a1, a2]: [f64; 2]| [1.0, a1, a2];
        let (b, a) = (times(&one.b, &two.b), times(&of(one.a), &of(two.a)));
        let counts: Vec<i32> = (0..4000).map(|n| if n % 37 == 0 { 3 } else { n % 5 - 2 }).collect();
        let mut exact: Vec<f64> = Vec::new();
        for n in 0..4000usize {
            let past = |k: usize| if k <= n { f64::from(counts[n - k]) } else { 0.0 };
            let sum: f64 = (0..5).map(|k| b[k] * past(k)).sum();
            let back: f64 = (1..=4.min(n)).map(|k| a[k] * exact[n - k]).sum();
            exact.push(sum - back);
        }
        let found = run(&design.quantise(), Velocity::ZERO, counts.into_iter());
        let off = found.iter().zip(&exact).map(|(bits, v)| (f64::from(*bits) - v * 65_536.0).abs());
        let worst = off.fold(0.0, f64::max);
        assert!(worst < 8.0, "{worst} LSB");
    }

    #[test]
    fn a_constant_speed_stays_and_the_sum_of_outputs_follows_the_counts() {
        let form = CascadeDesign::new(FIRST, SECOND, 1e4).unwrap().quantise();
        let speed = Velocity::saturating_from_counts(7);
        assert!(run(&form, speed, (0..2000).map(|_| 7)).iter().all(|bits| *bits == 7 << 16));
        let found = run(&form, Velocity::ZERO, (0..200_000).map(|n| i32::from(n % 3 == 0)));
        let sum: i64 = found.iter().map(|bits| i64::from(*bits)).sum();
        let counts = i64::from(200_000 / 3 + 1) << 16;
        assert!((sum - counts).abs() < 3 << 16, "{sum} {counts}");
    }

    #[test]
    fn a_refusal_names_the_section_and_leads_add_up() {
        let of = |place: usize, value: f64| {
            let mut second = SECOND;
            second[place] = value;
            CascadeDesign::new(FIRST, second, 1e4)
        };
        for (place, key) in ["second_ratio", "second_damping", "second_lead_s", "second_zero"]
            .into_iter()
            .enumerate()
        {
            assert_eq!(of(place, -2.0).unwrap_err().parameter, key);
        }
        let error = of(0, 5.0).unwrap_err();
        assert_eq!(*error.range.end(), 0.2 * 1e4 / 430.0);
        for end in [*error.range.start(), *error.range.end()] {
            assert!(CascadeDesign::new(FIRST, [end, 1.0, 0.0, 0.0], 1e4).is_ok(), "{end}");
        }
        let delay: f64 = of(0, 1.7)
            .unwrap()
            .sections
            .iter()
            .map(|section| {
                let ([b0, b1, b2], [a1, a2]) = (section.b, section.a);
                ((b1 + 2.0 * b2) - (a1 + 2.0 * a2)) / (b0 + b1 + b2)
            })
            .sum();
        let lead_s = FIRST[2] + SECOND[2];
        assert!((0.5 + delay + lead_s * 1e4).abs() < 1e-9, "{delay}");
    }
}
