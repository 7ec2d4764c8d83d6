//! Passivity of the wall of a loop as it runs: estimator at the sample rate, force at the output rate, late.
//!
//! Colgate and Schenkel's argument, carried through for this loop. Whatever is passive and hangs on a mass behind
//! a damper b has an admittance whose every value lies in the disc of centre and radius `1 / 2b`. At the output
//! instants the loop's gain is the sum over the aliases `w_n = w + 2 pi n / T` of a held force, T the output period:
//! ```text
//! L(w) = -(1 - e^(-jwT)) / T  sum over n of C(w_n) Y(w_n) e^(-j w_n t_d) / w_n^2,     C = K + B V(e^(j w_n T_s))
//! ```
//! The values of Y at the aliases are free of each other, so L fills a disc too; the loop is stable with everything
//! passive exactly if that disc never holds -1:
//! ```text
//! c = -(1 - e^(-jwT)) / 2T  sum C e^(-j w_n t_d) / w_n^2,     r = |1 - e^(-jwT)| / 2T  sum |C| / w_n^2
//! b > max over w of  -Re c + sqrt(r^2 - (Im c)^2)
//! ```
//! With a force for every sample, at once, all terms of the sum have the same phase, r = |c|, and this is their
//! condition. For V = 0 and a latency of whole periods it is `K < b / (T/2 + t_d)`, the line of Gil, Sanchez,
//! Hulin, Preusche and Hirzinger (JCISE 9(1) 011005, 2009).
//!
//! C has the period of the sampling, so the sum is over `period` aliases, each with a sum in closed form over those
//! that the sampler cannot tell apart. With `t = w_n T_s` and a latency of d + f samples, 0 <= f < 1:
//! ```text
//! sum over l of e^(-j (t + 2 pi l)(d + f)) / (t + 2 pi l)^2 = e^(-j t d) ((1 - f) + f e^(-j t)) / (4 sin^2(t/2))
//! ```

use core::f64::consts::PI;

use nalgebra::Complex;

use super::{PER_DECADE, PassivityDemand, STABLE_RADIUS};
use crate::analysis::linear::{LinearError, Loop, boundary::minimum, transfer::TransferFunction};

/// Lowest frequency, radians per output period: rounding grows towards 0 as 1e-16 over it.
const OMEGA_MIN: f64 = 1e-6;
/// Points of a linear search over 0 to pi, and of one turn of the latency's phase.
const LINEAR: f64 = 512.0;
const PER_TURN: f64 = 32.0;
/// Halvings of a stiffness or a damping that is searched for.
const HALVINGS: u32 = 40;

/// The wall of a loop at its port.
#[derive(Clone, Debug)]
pub struct Passivity {
    period: u32,
    /// Whole samples of latency, and the rest.
    late: f64,
    rest: f64,
    sample_s: f64,
    estimator: TransferFunction,
    /// The estimator has a pole on the unit circle or outside.
    unstable: bool,
    points: Vec<Point>,
}

/// One frequency.
#[derive(Clone, Debug)]
struct Point {
    omega: f64,
    aliases: Vec<Alias>,
}

/// One alias: what K and B make of c, per unit, and of r.
#[derive(Clone, Copy, Debug)]
struct Alias {
    /// Its part of -c with C = 1.
    part: Complex<f64>,
    /// Its part of r with |C| = 1.
    most: f64,
    /// `most - |part|`, free of cancellation.
    less: f64,
    /// The estimator.
    velocity: Complex<f64>,
}

impl Passivity {
    /// Of that loop; its device and elements do not matter.
    ///
    /// # Errors
    /// As [`Loop::check`].
    pub fn new(of: &Loop) -> Result<Self, LinearError> {
        of.check()?;
        let late = of.latency_samples.floor();
        let mut passivity = Self {
            period: of.period,
            late,
            rest: of.latency_samples - late,
            sample_s: of.sample_s(),
            unstable: of.estimator.poles_beyond(STABLE_RADIUS) > 0,
            estimator: of.estimator.clone(),
            points: vec![],
        };
        let turns = 0.5 * (of.latency_samples / f64::from(of.period) + 1.0);
        let step = PI / LINEAR.max(PER_TURN * turns);
        let ratio = libm::pow(10.0, 1.0 / f64::from(PER_DECADE));
        let mut omega = OMEGA_MIN;
        while omega < PI {
            passivity.points.push(passivity.at(omega));
            omega = (omega * ratio).min(omega + step);
        }
        passivity.points.push(passivity.at(PI));
        Ok(passivity)
    }

    /// At a frequency in radians per output period.
    fn at(&self, omega: f64) -> Point {
        let period = f64::from(self.period);
        // (1 - e^(-j omega)) T_s^2 / 2T
        let half = 0.5 * omega;
        let scale = libm::sin(half) * self.sample_s / period;
        let held = Complex::new(libm::sin(half), libm::cos(half)) * scale;
        let aliases = (0..self.period).map(|m| {
            let angle = (omega + 2.0 * PI * f64::from(m)) / period;
            let turn = |angle: f64| Complex::new(libm::cos(angle), -libm::sin(angle));
            let sine = libm::sin(0.5 * angle);
            let weight = 0.25 / (sine * sine);
            let split = turn(angle) * self.rest + (1.0 - self.rest);
            let length = split.norm();
            let most = scale * weight;
            Alias {
                part: held * weight * turn(angle * self.late) * split,
                most,
                // 1 - |split|^2 = 4 f (1 - f) sin^2
                less: scale * self.rest * (1.0 - self.rest) / (1.0 + length),
                velocity: self.estimator.at(turn(angle)),
            }
        });
        Point { omega, aliases: aliases.collect() }
    }

    /// Device damping that a wall of stiffness K N/m and damping B N s/m (any sign) asks for. Infinite if the
    /// estimator has a pole on the unit circle or outside, for which the condition does not hold.
    ///
    /// # Errors
    /// If a number is not finite.
    pub fn demand(
        &self,
        stiffness_n_per_m: f64,
        damping_n_s_per_m: f64,
    ) -> Result<PassivityDemand, LinearError> {
        finite(stiffness_n_per_m, damping_n_s_per_m)?;
        if self.unstable {
            return Ok(PassivityDemand { damping_n_s_per_m: f64::INFINITY, frequency_hz: 0.0 });
        }
        let (k, b) = (stiffness_n_per_m, damping_n_s_per_m);
        let costs: Vec<f64> = self.points.iter().map(|point| point.cost(k, b)).collect();
        let highest = (0..costs.len()).max_by(|&i, &j| costs[i].total_cmp(&costs[j])).unwrap_or(0);
        let (mut worst, mut at) = (costs[highest], self.points[highest].omega);
        if highest > 0 && highest + 1 < self.points.len() {
            let ends = [highest - 1, highest + 1].map(|i| self.points[i].omega);
            let refined = minimum(|omega| -self.at(omega).cost(k, b), ends[0], ends[1]);
            let cost = self.at(refined).cost(k, b);
            if cost > worst {
                (worst, at) = (cost, refined);
            }
        }
        let output_hz = 1.0 / (self.sample_s * f64::from(self.period));
        Ok(PassivityDemand { damping_n_s_per_m: worst, frequency_hz: at / (2.0 * PI) * output_hz })
    }

    /// Largest K, N/m, up to which every wall from K = 0 on is passive on a device of that damping; `None` if
    /// K = 0 is not.
    ///
    /// # Errors
    /// If a number is not finite.
    pub fn stiffness_max(
        &self,
        device_damping_n_s_per_m: f64,
        damping_n_s_per_m: f64,
    ) -> Result<Option<f64>, LinearError> {
        finite(device_damping_n_s_per_m, damping_n_s_per_m)?;
        let asks = |k: f64| Ok(self.demand(k, damping_n_s_per_m)?.damping_n_s_per_m);
        if asks(0.0)? > device_damping_n_s_per_m {
            return Ok(None);
        }
        // K = b / T is beyond K < b / (T/2 + t_d) for a latency of half a period, and B moves it.
        let mut high = (device_damping_n_s_per_m / self.sample_s).max(1.0);
        while asks(high)? <= device_damping_n_s_per_m {
            high *= 2.0;
        }
        last(high, |k| Ok(asks(k)? <= device_damping_n_s_per_m)).map(Some)
    }

    /// Largest B, N s/m, at which K = 0 is passive on a device of that damping. Below it every B is: a wall that is
    /// passive is so at any fraction of its K and B, since the disc of a fraction lies in that of the whole.
    ///
    /// # Errors
    /// If a number is not finite.
    pub fn damping_max(&self, device_damping_n_s_per_m: f64) -> Result<f64, LinearError> {
        // What B costs is in proportion to it.
        Ok(device_damping_n_s_per_m / self.demand(0.0, 1.0)?.damping_n_s_per_m)
    }
}

impl Point {
    /// Device damping that the condition asks for at this frequency.
    fn cost(&self, k: f64, b: f64) -> f64 {
        let wall = |alias: &Alias| alias.velocity * b + k;
        let mut aliases = self.aliases.iter();
        let Some(first) = aliases.next() else { return 0.0 };
        // The first alias outweighs all others at low frequency. Turned to its phase, r - |c| is a sum without
        // the difference of large numbers.
        let main = first.part * wall(first);
        let size = main.norm();
        let turn = if size > 0.0 { main.conj() / size } else { Complex::new(1.0, 0.0) };
        let length = wall(first).norm();
        let (mut sum, mut along, mut across) = (main, size, 0.0);
        let (mut most, mut less) = (first.most * length, first.less * length);
        for alias in aliases {
            let wall = wall(alias);
            let part = alias.part * wall;
            let turned = part * turn;
            let largest = alias.most * wall.norm();
            sum += part;
            along += turned.re;
            across += turned.im;
            most += largest;
            less += largest - turned.re;
        }
        // r^2 - |c|^2
        let free = (less * (most + along) - across * across).max(0.0);
        sum.re + (free + sum.re * sum.re).sqrt()
    }
}

fn finite(stiffness: f64, damping: f64) -> Result<(), LinearError> {
    for (name, value) in [("virtual stiffness", stiffness), ("virtual damping", damping)] {
        if !value.is_finite() {
            return Err(LinearError::OutOfRange { name, low: f64::MIN, high: f64::MAX });
        }
    }
    Ok(())
}

/// The last value from 0 to `high` that passes; 0 does, `high` does not.
fn last(high: f64, passes: impl Fn(f64) -> Result<bool, LinearError>) -> Result<f64, LinearError> {
    let (mut good, mut bad) = (0.0, high);
    for _ in 0..HALVINGS {
        let middle = 0.5 * (good + bad);
        if passes(middle)? { good = middle } else { bad = middle }
    }
    Ok(good)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        analysis::linear::{Boundary, Device, passivity},
        scene::element::Arm,
    };

    fn running(rate_hz: f64, period: u32, latency_samples: f64, cutoff_hz: f64) -> Loop {
        let estimator = match cutoff_hz {
            0.0 => TransferFunction::finite_difference(rate_hz),
            _ => TransferFunction::paper(rate_hz, cutoff_hz),
        };
        let mut of = Loop::single_rate(Device::PAPER, rate_hz, estimator);
        (of.period, of.latency_samples) = (period, latency_samples);
        of
    }

    fn damping(of: &Loop, k: f64, b: f64) -> f64 {
        Passivity::new(of).unwrap().demand(k, b).unwrap().damping_n_s_per_m
    }

    #[test]
    fn with_a_force_for_every_sample_at_once_it_is_colgate_and_schenkels() {
        for (rate_hz, cutoff_hz) in [(1e3, 0.0), (1e3, 50.0), (1e4, 200.0), (1e4, 1500.0)] {
            let of = running(rate_hz, 1, 0.0, cutoff_hz);
            for (k, b) in [(1000.0, 0.0), (1000.0, 5.0), (20_000.0, 20.0), (0.0, 7.0), (0.0, -7.0)]
            {
                let known = passivity::demand(k, b, rate_hz, &of.estimator).unwrap();
                let here = damping(&of, k, b);
                assert!(
                    (here / known.damping_n_s_per_m - 1.0).abs() < 1e-6,
                    "{rate_hz} {cutoff_hz} {k} {b}: {here} {known:?}"
                );
            }
        }
    }

    /// K < b / (T/2 + t_d) by hand: T = 1 ms, t_d = 0, 1, 2, 3 ms on the paper's b.
    #[test]
    fn a_spring_behind_whole_periods_of_latency_is_passive_up_to_the_known_line() {
        for (period, latency, limit) in [
            (10, 0.0, 11_039.0),
            (10, 10.0, 3_679.667),
            (10, 20.0, 2_207.8),
            (1, 1.0, 36_796.67),
            (10, 30.0, 1_577.0),
        ] {
            let of = Passivity::new(&running(1e4, period, latency, 1500.0)).unwrap();
            let found = of.stiffness_max(5.5195, 0.0).unwrap().unwrap();
            assert!((found / limit - 1.0).abs() < 1e-5, "{period} {latency}: {found}");
        }
        // Half a period: at w = 0 the terms are T/4 + t_d/2 = T/2, and r^2 - |c|^2 = T^2/16.
        let of = Passivity::new(&running(1e4, 10, 5.0, 1500.0)).unwrap();
        let asks = 1e-3 * 0.5 * (1.0 + 1.25f64.sqrt());
        assert!(of.demand(1.0, 0.0).unwrap().damping_n_s_per_m >= asks * (1.0 - 1e-5));
    }

    /// The published sums, term by term.
    #[test]
    fn the_sums_in_closed_form_are_those_over_the_aliases() {
        let of = running(1e4, 4, 6.3, 700.0);
        let passivity = Passivity::new(&of).unwrap();
        let (k, b, period_s, latency_s) = (9000.0, 40.0, 4e-4, 6.3e-4);
        for omega in [1e-3, 0.3, 1.7, 3.0] {
            let (mut c, mut r) = (Complex::new(0.0, 0.0), 0.0);
            let held =
                (Complex::new(1.0, 0.0) - Complex::new(0.0, -omega).exp()) / (2.0 * period_s);
            for n in -200_000..=200_000 {
                let w = (omega + 2.0 * PI * f64::from(n)) / period_s;
                let back = Complex::new(0.0, -w * 1e-4).exp();
                let wall = of.estimator.at(back) * b + k;
                c -= held * wall * Complex::new(0.0, -w * latency_s).exp() / (w * w);
                r += held.norm() * wall.norm() / (w * w);
            }
            let sums = -c.re + (r * r - c.im * c.im).sqrt();
            let here = passivity.at(omega).cost(k, b);
            assert!((here / sums - 1.0).abs() < 1e-4, "{omega}: {here} {sums}");
        }
    }

    /// No passive thing that is hung on the device may make a passive wall unstable. Sprung masses and arms try.
    #[test]
    fn a_passive_wall_is_stable_whatever_hangs_on_it() {
        for (period, latency, cutoff_hz, b) in [
            (10, 10.0, 1500.0, 0.0),
            (10, 10.0, 100.0, 2.0),
            (10, 3.5, 500.0, 1.0),
            (1, 2.0, 300.0, 3.0),
        ] {
            let mut of = running(1e4, period, latency, cutoff_hz);
            let passivity = Passivity::new(&of).unwrap();
            let passive = passivity.stiffness_max(5.5195, b).unwrap().unwrap();
            for k in (0..50).map(|n| passive * f64::from(n) / 50.0) {
                let asks = passivity.demand(k, b).unwrap().damping_n_s_per_m;
                assert!(asks <= 5.5195 * (1.0 + 1e-9), "{k} of {passive} asks for {asks}");
            }
            let mut least = f64::INFINITY;
            for mass_kg in [0.01, 0.05, 0.2, 1.0, 5.0] {
                for stiffness_n_per_m in [0.0, 1e3, 1e4, 1e5, 1e6] {
                    of.device = Device { mass_kg, damping_n_s_per_m: 5.5195, stiffness_n_per_m };
                    for arm in [None, Some(stiffness_n_per_m)] {
                        of.elements.arm = arm.map(|stiffness| Arm {
                            mass_kg: 0.3,
                            damping_n_s_per_m: 0.0,
                            stiffness_n_per_m: 0.3 * stiffness,
                            rest_position_m: 0.0,
                            grip_stiffness_n_per_m: 2.0 * stiffness + 500.0,
                            grip_damping_n_s_per_m: 0.0,
                        });
                        let limit = Boundary::new(&of).unwrap().at(b).unwrap();
                        let held = limit.stiffness_max >= passive * (1.0 - 1e-6);
                        assert!(
                            held && !limit.unstable_at_zero,
                            "{mass_kg} {stiffness_n_per_m} {limit:?}"
                        );
                        least = least.min(limit.stiffness_max);
                    }
                }
            }
            println!(
                "period {period}, latency {latency}: passive up to {passive:.1}, least stable {least:.1}"
            );
            if b == 0.0 {
                assert!(least < 1.01 * passive, "a spring's limit is reached: {least} {passive}");
            }
        }
    }
}
