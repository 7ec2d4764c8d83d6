use super::*;
use crate::{
    analysis::linear::{Boundary, Device, passivity},
    scene::element::Arm,
};

fn running(rate_hz: f64, period: u32, latency_samples: f64, cutoff_hz: f64) -> Loop {
    let estimator = match cutoff_hz {
        0.0 => TransferFunction::finite_difference(rate_hz),
        _ => TransferFunction::paper(rate_hz, cutoff_hz).unwrap(),
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
        for (k, b) in [(1000.0, 0.0), (1000.0, 5.0), (20_000.0, 20.0), (0.0, 7.0), (0.0, -7.0)] {
            let known = passivity::tests::demand(k, b, rate_hz, &of.estimator).unwrap();
            let here = damping(&of, k, b);
            assert!(
                (here / known.damping_n_s_per_m - 1.0).abs() < 1e-6,
                "{rate_hz} {cutoff_hz} {k} {b}: {here} {known:?}"
            );
        }
    }
}

/// The limit K < b / (T/2 + t_d) is computed by hand for the paper's b, T = 1 ms, and t_d = 0, 1, 2 and 3 ms.
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
    // With half a period of latency, at w = 0 the terms are T/4 + t_d/2 = T/2, and r^2 - |c|^2 = T^2/16.
    let of = Passivity::new(&running(1e4, 10, 5.0, 1500.0)).unwrap();
    let asks = 1e-3 * 0.5 * (1.0 + 1.25f64.sqrt());
    assert!(of.demand(1.0, 0.0).unwrap().damping_n_s_per_m >= asks * (1.0 - 1e-5));
}

/// Compares the closed sums of the condition with sums term by term.
#[test]
fn the_sums_in_closed_form_are_those_over_the_aliases() {
    let of = running(1e4, 4, 6.3, 700.0);
    let passivity = Passivity::new(&of).unwrap();
    let (k, b, period_s, latency_s) = (9000.0, 40.0, 4e-4, 6.3e-4);
    for omega in [1e-3, 0.3, 1.7, 3.0] {
        let (mut c, mut squares, mut ones) = (Complex::new(0.0, 0.0), 0.0, 0.0);
        let held = (Complex::new(1.0, 0.0) - Complex::new(0.0, -omega).exp()) / (2.0 * period_s);
        for n in -200_000..=200_000 {
            let w = (omega + 2.0 * PI * f64::from(n)) / period_s;
            let back = Complex::new(0.0, -w * 1e-4).exp();
            let wall = of.estimator.at(back) * b + k;
            c -= held * wall * Complex::new(0.0, -w * latency_s).exp() / (w * w);
            squares += held.norm() * wall.norm_sqr() / (w * w);
            ones += held.norm() / (w * w);
        }
        let sums = -c.re + (squares * ones - c.im * c.im).sqrt();
        let here = passivity.at(omega).cost(k, b);
        assert!((here / sums - 1.0).abs() < 1e-4, "{omega}: {here} {sums}");
    }
}

/// No passive load on the device may make a passive wall unstable. The loads are sprung masses and arms.
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

/// Limits from an independent program that uses normalised differences. The limits are for the paper's device and loop,
/// with an output every 10 samples, no latency and 1500 Hz. With a time-invariant hand the limits are 4340, 4407, 3421
/// and 1437 N/m.
#[test]
fn the_ports_of_the_papers_loop_are_passive_up_to_the_known_stiffnesses() {
    let of = Passivity::new(&running(1e4, 10, 10.0, 1500.0)).unwrap();
    for (b, known) in [(1.0, 4287.0), (2.0, 4160.0), (3.0, 2800.0), (4.0, 241.0)] {
        let found = of.stiffness_max(5.5195, b).unwrap().unwrap();
        println!("B {b}: {found}");
        assert!((found / known - 1.0).abs() < 0.005, "{b}: {found} for {known}");
    }
}

/// Number of output periods in the record. Before the record, the loop settles for the same number of periods.
const PERIODS: u32 = 4000;

/// A motion that is described by its speeds at the samples of one output period. From one period to the next, the phase
/// of the speeds changes by `omega`.
struct Motion {
    omega: f64,
    speeds: Vec<Complex<f64>>,
}

/// The damping that a device needs, and the motion that takes the largest energy out of a wall and a damper. The result
/// comes from the loop's own kernels over a period, without a sum over aliases.
fn worst(of: &Loop, k: f64, b: f64, omega: f64) -> (f64, Motion) {
    let period = of.period as usize;
    let sample_s = of.sample_s();
    let turn = |periods: f64| Complex::from_polar(1.0, -omega * periods);
    // The part of the command that comes from a speed of 1, for each number of samples since this speed.
    let response = step_response(&of.estimator, 400 * period);
    let mut command: Vec<Complex<f64>> = vec![turn(1.0) / (turn(1.0) * -1.0 + 1.0) * k; period];
    for (ago, value) in (1..).zip(&response) {
        let sample = (period - ago % period) % period;
        let periods = (ago + sample) / period;
        let back = turn(periods as f64);
        command[sample] += back * (b * value);
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "whole samples")]
    let late = of.latency_samples as usize;
    let force = |sample: usize| {
        let periods = late / period + usize::from(sample < late % period);
        -turn(periods as f64)
    };
    // Power that flows out of the port: Re(conj(v_i) F_i), where F = force * (sum of command * v).
    let form = nalgebra::DMatrix::from_fn(period, period, |i, j| {
        (force(i) * command[j] + (force(j) * command[i]).conj()) * (0.5 * sample_s)
    });
    let eigen = form.symmetric_eigen();
    let highest = eigen.eigenvalues.imax();
    let speeds = eigen.eigenvectors.column(highest).iter().copied().collect();
    (eigen.eigenvalues[highest], Motion { omega, speeds })
}

/// Sums of the estimator's impulse response. Element n is the estimate n samples after the position has made a step of
/// 1.
fn step_response(of: &TransferFunction, samples: usize) -> Vec<f64> {
    let mut loops = Difference::new(of);
    (0..samples).map(|_| loops.next(1.0)).collect()
}

/// Runs the estimator, sample by sample.
struct Difference {
    of: TransferFunction,
    inputs: Vec<f64>,
    outputs: Vec<f64>,
}

impl Difference {
    fn new(of: &TransferFunction) -> Self {
        Self { of: of.clone(), inputs: vec![0.0; 8], outputs: vec![0.0; 8] }
    }

    fn next(&mut self, position: f64) -> f64 {
        self.inputs.rotate_right(1);
        self.inputs[0] = position;
        let products = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let all = products(&self.of.num, &self.inputs) - products(&self.of.den[1..], &self.outputs);
        self.outputs.rotate_right(1);
        self.outputs[0] = all / self.of.den[0];
        self.outputs[0]
    }
}

/// Steps the loop with this motion. Returns a ratio: the energy that leaves wall and damper, divided by the energy that
/// the damper takes. Both energies are sums over the second half of the periods.
fn energy_out(of: &Loop, k: f64, b: f64, motion: &Motion) -> f64 {
    let (period, sample_s) = (of.period as usize, of.sample_s());
    let mut estimator = Difference::new(&of.estimator);
    let mut commands = std::collections::VecDeque::new();
    let (mut position, mut acting) = (0.0, 0.0);
    let (mut out, mut taken) = (0.0, 0.0);
    // After a period the motion is back at its start, except for its phase. So the mean speed gives the position.
    let drift: Complex<f64> = motion.speeds.iter().sum::<Complex<f64>>() * sample_s;
    let start = drift / (Complex::from_polar(1.0, motion.omega) - 1.0);
    position += start.re;
    for n in 0..2 * PERIODS as usize * period {
        let velocity = estimator.next(position);
        if n % period == 0 {
            commands.push_back((n as f64 + of.latency_samples, -(k * position + b * velocity)));
        }
        while commands.front().is_some_and(|(at, _)| *at <= n as f64) {
            (_, acting) = commands.pop_front().unwrap();
        }
        let turned = Complex::from_polar(1.0, motion.omega * (n / period) as f64);
        let speed = (motion.speeds[n % period] * turned).re;
        if n >= PERIODS as usize * period {
            out += acting * speed * sample_s;
            taken += of.device.damping_n_s_per_m * speed * speed * sample_s;
        }
        position += speed * sample_s;
    }
    (out - taken) / taken
}

#[test]
fn a_constructed_motion_takes_energy_out_just_outside_and_none_just_inside() {
    for (period, latency, cutoff_hz, b) in [
        (10, 10.0, 1500.0, 4.0),
        (10, 10.0, 1500.0, 1.0),
        (10, 0.0, 500.0, 5.0),
        (5, 7.0, 1500.0, 3.0),
        (1, 2.0, 300.0, 3.0),
    ] {
        let of = running(1e4, period, latency, cutoff_hz);
        let passivity = Passivity::new(&of).unwrap();
        let limit = passivity.stiffness_max(5.5195, b).unwrap().unwrap();
        for (share, outside) in [(1.02, true), (0.98, false)] {
            let k = share * limit;
            let demand = passivity.demand(k, b).unwrap();
            // The record has a whole number of turns of the motion, so stored energy comes back.
            let wanted = demand.frequency_hz * f64::from(period) / 1e4 * f64::from(PERIODS);
            let omega = 2.0 * PI * wanted.round().max(1.0) / f64::from(PERIODS);
            let (asks, motion) = worst(&of, k, b, omega);
            let near = (asks / demand.damping_n_s_per_m - 1.0).abs() < 1e-3;
            assert!(near, "{period} {latency} {cutoff_hz} {b}: {asks} {demand:?}");
            let out = energy_out(&of, k, b, &motion);
            println!(
                "period {period} latency {latency} {cutoff_hz} Hz B {b} K {k:.0}: {out:.2e} of what b takes"
            );
            assert_eq!(out > 0.0, outside, "{period} {latency} {cutoff_hz} {b} {k}: {out}");
        }
    }
}
