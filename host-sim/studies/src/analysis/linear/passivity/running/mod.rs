//! Passivity of a wall in the real loop: the estimator runs at the sample rate, the force changes at the output rate,
//! and there is latency.
//!
//! The loop is periodic with the output period T. The hand may be periodic too. So the condition is for the port alone.
//! It is valid for any motion, by a linear or a non-linear hand. A motion of frequency w contains the aliases `w_n =
//! w + 2 pi n / T` with independent speeds v_n. The command depends on one weighted sum of these speeds. The force is
//! this command with its hold:
//! ```text
//! u = - sum over n of C(w_n) v_n / (j w_n),     F_n = u (1 - e^(-jwT)) e^(-j w_n t_d) / (j w_n T),   C = K + B V(e^(j w_n T_s))
//! ```
//! The power out of the wall is a Hermitian form of rank two in v. The vectors p and q of the two sums define this
//! form. The damper b of the device absorbs the power `b |v|^2`. No motion takes energy out of wall and damper exactly
//! if b is at least the largest eigenvalue of the form, `1/2 (sqrt(|p|^2 |q|^2 - Im^2 <p, q>) - Re <p, q>)`, at every
//! w:
//! ```text
//! c = -(1 - e^(-jwT)) / 2T  sum C e^(-j w_n t_d) / w_n^2,     r^2 = |1 - e^(-jwT)|^2 / 4T^2  sum |C|^2 / w_n^2  sum 1 / w_n^2
//! b > max over w of  -Re c + sqrt(r^2 - (Im c)^2)
//! ```
//! The eigenvector of the largest eigenvalue is the worst motion. With a force for every sample and without latency, C
//! is the same at all relevant aliases and r = |c|. In this case the condition is equal to the condition of Colgate and
//! Schenkel. For a time-invariant hand the condition is weaker. The aliases of a time-invariant hand respond
//! independently, so r is only the sum of `|C| / w_n^2`. This sum is at most the r of the formula (Cauchy and Schwarz).
//!
//! For V = 0 and a latency of whole periods, the result is `K < b / (T/2 + t_d)`, the line of Gil, Sanchez, Hulin,
//! Preusche and Hirzinger (JCISE 9(1) 011005, 2009). Fardad and Bamieh, IEEE TAC 54(10), 2009, treat passivity of
//! sampled-data systems in this form.
//!
//! C is periodic with the sample rate. So the sum has `period` terms. Each term is a sum in closed form over the
//! frequencies that the sampler cannot distinguish. With `t = w_n T_s` and a latency of d + f samples, 0 <= f < 1:
//! ```text
//! sum over l of e^(-j (t + 2 pi l)(d + f)) / (t + 2 pi l)^2 = e^(-j t d) ((1 - f) + f e^(-j t)) / (4 sin^2(t/2))
//! ```

use core::f64::consts::PI;

use nalgebra::Complex;

use super::{PER_DECADE, PassivityDemand, STABLE_RADIUS};
use crate::analysis::linear::{LinearError, Loop, boundary::minimum, transfer::TransferFunction};

/// Lowest frequency of the search, in radians per output period. The rounding error is 1e-16 divided by the frequency,
/// so at lower frequencies the error would be large.
const OMEGA_MIN: f64 = 1e-6;
/// Number of search points from 0 to pi.
const LINEAR: f64 = 512.0;
/// Number of search points per turn of the phase that the latency causes.
const PER_TURN: f64 = 32.0;
/// Number of times that a search for a stiffness or a damping halves its interval.
const HALVINGS: u32 = 40;

/// The wall of a loop, as seen at the port to the hand.
#[derive(Clone, Debug)]
pub struct Passivity {
    period: u32,
    /// The latency as whole samples, and the remaining part of a sample.
    late: f64,
    rest: f64,
    sample_s: f64,
    estimator: TransferFunction,
    /// Whether the estimator has a pole on or outside the unit circle.
    unstable: bool,
    points: Vec<Point>,
}

/// A frequency and its aliases, the frequencies that the sampler cannot distinguish from it.
#[derive(Clone, Debug)]
struct Point {
    omega: f64,
    aliases: Vec<Alias>,
}

/// One alias: its terms of c and r for given K and B.
#[derive(Clone, Copy, Debug)]
struct Alias {
    /// Term of -c if C is 1.
    part: Complex<f64>,
    /// Term of r if |C| is 1.
    most: f64,
    /// The difference `most - |part|`. It is computed without cancellation.
    less: f64,
    /// Response of the estimator at the frequency of the alias.
    velocity: Complex<f64>,
}

impl Passivity {
    /// Prepares the wall of a loop. The device and the elements of the loop are not used.
    ///
    /// # Errors
    /// An error of [`Loop::check`].
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

    /// The terms at a frequency, which is in radians per output period.
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

    /// The damping that a device needs so that a wall with K in N/m and B in N s/m is passive. B may have any sign. If
    /// the estimator has a pole on or outside the unit circle, no damping is enough, and the value is infinite.
    ///
    /// # Errors
    /// A number is not finite.
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

    /// Largest passive K in N/m on a device with this damping. Every wall from K = 0 to this K is passive. `None` if K
    /// = 0 is not passive.
    ///
    /// # Errors
    /// A number is not finite.
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
        // K = b / T is above the limit K < b / (T/2 + t_d) for a latency of half a period. B changes this limit.
        let mut high = (device_damping_n_s_per_m / self.sample_s).max(1.0);
        while asks(high)? <= device_damping_n_s_per_m {
            high *= 2.0;
        }
        last(high, |k| Ok(asks(k)? <= device_damping_n_s_per_m)).map(Some)
    }

    /// Largest B in N s/m at which K = 0 is passive on a device with this damping. Every smaller B is also passive. If
    /// K and B of a passive wall are multiplied by a factor below 1, the wall stays passive, because its disc lies in
    /// the disc of the original wall.
    ///
    /// # Errors
    /// A number is not finite.
    pub fn damping_max(&self, device_damping_n_s_per_m: f64) -> Result<f64, LinearError> {
        // The necessary damping is proportional to B.
        Ok(device_damping_n_s_per_m / self.demand(0.0, 1.0)?.damping_n_s_per_m)
    }
}

impl Point {
    /// The damping that a device needs at this frequency.
    fn cost(&self, k: f64, b: f64) -> f64 {
        let wall = |alias: &Alias| alias.velocity * b + k;
        let mut aliases = self.aliases.iter();
        let Some(first) = aliases.next() else { return 0.0 };
        // The first alias dominates at low frequency. All terms are rotated by the phase of the first alias. So r - |c|
        // is computed as a sum, and not as a difference of large numbers.
        let main = first.part * wall(first);
        let size = main.norm();
        let turn = if size > 0.0 { main.conj() / size } else { Complex::new(1.0, 0.0) };
        let length = wall(first).norm();
        let (mut sum, mut along, mut across) = (main, size, 0.0);
        let (mut most, mut less) = (first.most * length, first.less * length);
        // How much |C| differs between the aliases around the first one. The weights are those of the sums.
        let (mut weight, mut apart, mut squares) = (first.most, 0.0, 0.0);
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
            let off = wall.norm() - length;
            weight += alias.most;
            apart += alias.most * off;
            squares += alias.most * off * off;
        }
        // `still` is r^2 - |c|^2 for a time-invariant hand. For any hand, the Cauchy-Schwarz difference is added to
        // r^2.
        let still = less * (most + along) - across * across;
        let free = (still + (weight * squares - apart * apart)).max(0.0);
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

/// Searches the largest value from 0 to `high` for which `passes` is true. `passes` must be true for 0 and false for
/// `high`.
fn last(high: f64, passes: impl Fn(f64) -> Result<bool, LinearError>) -> Result<f64, LinearError> {
    let (mut good, mut bad) = (0.0, high);
    for _ in 0..HALVINGS {
        let middle = 0.5 * (good + bad);
        if passes(middle)? { good = middle } else { bad = middle }
    }
    Ok(good)
}

#[cfg(test)]
mod tests;
