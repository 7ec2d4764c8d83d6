//! Compares the fixed-point velocity filter with theory: its coefficients, cutoff, frequency response and gain at DC.

use std::f64::consts::PI;

use crate::figure::figure;
use zwidth::{
    CounterWidth, Design, Output, Sampler, Settings, VelocitySettings, WallSettings, shorten,
    units::Velocity,
    velocity::{Biquad, BiquadState, CUTOFF_MAX, CUTOFF_MIN, Estimator, true_cutoff_hz},
};

const RATES_HZ: [f64; 3] = [1e3, 1e4, 5e4];
/// The value of one LSB of a coefficient, 2^-30.
const COEFFICIENT_LSB: f64 = 1.0 / (1u64 << 30) as f64;
/// The value of one LSB of a velocity, 2^-16 counts per sample.
const VELOCITY_LSB: f64 = 1.0 / (1u64 << 16) as f64;

fn low_pass(cutoff_hz: f64, prewarp: bool) -> VelocitySettings {
    match prewarp {
        false => VelocitySettings::Butterworth { cutoff_hz },
        true => VelocitySettings::ButterworthPrewarped { cutoff_hz },
    }
}

fn filter(cutoff_hz: f64, rate_hz: f64, prewarp: bool) -> Biquad {
    let settings = low_pass(cutoff_hz, prewarp);
    let Estimator::LowPass(biquad) = settings.build(&design(rate_hz)).unwrap() else { panic!() };
    biquad
}

fn design(rate_hz: f64) -> Design {
    Design {
        rate_hz,
        resolution_m: 1e-6,
        full_scale_n: 1.0,
        period: 10,
        output: Output::Continuous,
    }
}

/// Cutoffs over the accepted range, as fractions of the rate.
fn cutoffs() -> impl Iterator<Item = f64> {
    let steps = 60;
    let ratio = CUTOFF_MAX / CUTOFF_MIN;
    // The exact ends, so that rounding does not leave the range.
    (0..=steps).map(move |n| match n {
        0 => CUTOFF_MIN,
        n if n == steps => CUTOFF_MAX,
        n => CUTOFF_MIN * ratio.powf(f64::from(n) / f64::from(steps)),
    })
}

#[test]
fn coefficients_are_those_of_scipy_within_their_stated_lsb() {
    // Largest errors of b0, b1, b2, a1 and a2, in this order: see `ButterworthDesign::quantise`.
    const ERROR_MAX_LSB: [f64; 5] = [1.0, 2.0, 1.0, 1.0, 0.5];
    for (prewarp, golden) in [
        (false, include_str!("../golden/butterworth.csv")),
        (true, include_str!("../golden/butterworth_prewarped.csv")),
    ] {
        let mut worst = [0f64; 5];
        let mut rows = 0;
        for row in golden.lines().filter(|line| line.starts_with(|c: char| c.is_ascii_digit())) {
            let columns: Vec<f64> = row.split(',').map(|value| value.parse().unwrap()).collect();
            let [rate_hz, cutoff_hz] = [columns[0], columns[1]];
            let settings = low_pass(cutoff_hz, prewarp);
            let Ok(Estimator::LowPass(biquad)) = settings.build(&design(rate_hz)) else {
                continue; // outside the accepted range, which has its own tests
            };
            rows += 1;
            for (n, bits) in biquad.bits().into_iter().enumerate() {
                let error = f64::from(bits) - columns[2 + n] / COEFFICIENT_LSB;
                worst[n] = worst[n].max(error.abs());
            }
        }
        println!("prewarp {prewarp}: {rows} rows, worst error in LSB {worst:.3?}");
        if !prewarp {
            for (name, worst) in ["b0", "b1", "b2", "a1", "a2"].into_iter().zip(worst) {
                figure(&format!("host/filter/{name}_lsb"), worst);
            }
        }
        assert!(rows > 100, "the golden file has {rows} usable rows");
        for (worst, max) in worst.into_iter().zip(ERROR_MAX_LSB) {
            assert!(worst <= max + 1e-6, "{worst} LSB");
        }
    }
}

#[test]
fn the_dc_gain_is_exactly_one() {
    for rate_hz in RATES_HZ {
        for cutoff in cutoffs() {
            let [b0, b1, b2, a1, a2] =
                filter(cutoff * rate_hz, rate_hz, false).bits().map(i64::from);
            assert_eq!(b0 + b1 + b2, (1 << 30) + a1 + a2);
        }
    }
}

#[test]
fn every_accepted_cutoff_is_within_one_percent_after_quantisation() {
    let mut worst = 0f64;
    for rate_hz in RATES_HZ {
        // Dense at the low end, where one LSB of the DC sum matters.
        let dense = (0..2000).map(|n| CUTOFF_MIN * (1.0 + f64::from(n) / 200.0));
        for cutoff_hz in dense.chain(cutoffs()).map(|cutoff| cutoff * rate_hz) {
            let asked = true_cutoff_hz(cutoff_hz, rate_hz, false);
            let got = filter(cutoff_hz, rate_hz, false).cutoff_hz(rate_hz);
            worst = worst.max((got / asked - 1.0).abs());
        }
    }
    println!("worst relative error of the -3 dB frequency: {worst:.5}");
    figure("host/filter/cutoff_error", worst);
    assert!(worst <= 0.01, "{worst}");
}

#[test]
fn outside_the_accepted_range_the_cutoff_is_refused_by_name() {
    for rate_hz in RATES_HZ {
        for cutoff_hz in [
            0.0,
            -1.0,
            0.99 * CUTOFF_MIN * rate_hz,
            0.4995 * rate_hz,
            rate_hz,
            f64::NAN,
            f64::INFINITY,
        ] {
            let settings = VelocitySettings::Butterworth { cutoff_hz };
            let error = settings.build(&design(rate_hz)).unwrap_err();
            assert_eq!(error.parameter, "cutoff_hz");
            let text = error.to_string();
            let [low, high] = [CUTOFF_MIN, CUTOFF_MAX].map(|limit| shorten(limit * rate_hz));
            assert!(text.ends_with(&format!("allowed {low} to {high}")), "{text}");
        }
    }
    let prewarped = low_pass(3900.0, true);
    assert_eq!(prewarped.build(&design(1e4)).unwrap_err().parameter, "cutoff_hz");
}

/// Gain |H| at `hz` by equation (2) of the paper, without the core's coefficients.
fn theory(hz: f64, cutoff_hz: f64, rate_hz: f64) -> f64 {
    // The bilinear transform maps the digital frequency to this analog frequency.
    let analog_hz = rate_hz / PI * (PI * hz / rate_hz).tan();
    1.0 / (1.0 + (analog_hz / cutoff_hz).powi(4)).sqrt()
}

/// Runs the filter on a sine. Returns the gain, measured by correlation over whole periods after the transient.
fn measured_gain(biquad: &Biquad, hz: f64, rate_hz: f64, settle: u32, periods: u32) -> f64 {
    const AMPLITUDE: f64 = 2e9; // in velocity LSB, near full scale
    let mut state = BiquadState::default();
    let samples = (f64::from(periods) * rate_hz / hz).round() as u32;
    let (mut cosine, mut sine) = (0.0, 0.0);
    for n in 0..settle + samples {
        let phase = 2.0 * PI * hz / rate_hz * f64::from(n);
        let input = Velocity::saturating_from_bits((AMPLITUDE * phase.sin()) as i32);
        let output = f64::from(biquad.update(&mut state, input).bits());
        if n >= settle {
            cosine += output * phase.cos();
            sine += output * phase.sin();
        }
    }
    2.0 * cosine.hypot(sine) / f64::from(samples) / AMPLITUDE
}

#[test]
fn the_measured_frequency_response_is_the_theoretical_one() {
    /// Largest allowed error. It comes from the leakage of the correlation, and from periods that are no whole number
    /// of samples.
    const ERROR_MAX: f64 = 2e-3;
    let rate_hz = 1e4;
    let mut worst = 0f64;
    for cutoff_hz in [5.0, 20.0, 50.0, 200.0, 500.0, 1000.0, 1500.0, 2000.0, 3000.0, 4000.0, 4990.0]
    {
        let biquad = filter(cutoff_hz, rate_hz, false);
        let true_hz = true_cutoff_hz(cutoff_hz, rate_hz, false);
        let settle = (20.0 * rate_hz / cutoff_hz) as u32 + 100;
        for factor in [0.1, 0.3, 0.7, 1.0, 1.3, 2.0, 4.0] {
            let hz = true_hz * factor;
            if hz > 0.45 * rate_hz {
                continue;
            }
            let gain = measured_gain(&biquad, hz, rate_hz, settle, 50);
            let error = (gain - theory(hz, cutoff_hz, rate_hz)).abs();
            assert!(error < ERROR_MAX, "cutoff {cutoff_hz}, {hz} Hz: off by {error}");
            worst = worst.max(error);
        }
        let at_cutoff = measured_gain(&biquad, true_hz, rate_hz, settle, 200);
        assert!((at_cutoff - 0.5f64.sqrt()).abs() < ERROR_MAX, "{cutoff_hz}: {at_cutoff}");
    }
    println!("worst error of the gain: {worst:.2e}");
    figure("host/filter/response_error", worst);
}

fn control(cutoff_hz: f64, rate_hz: f64) -> zwidth::LoopParameters {
    let design = Design {
        rate_hz,
        resolution_m: 1e-6,
        full_scale_n: 5.906,
        period: 10,
        output: Output::Continuous,
    };
    Settings {
        velocity: VelocitySettings::Butterworth { cutoff_hz },
        wall: WallSettings {
            position_m: 0.07,
            stiffness_n_per_m: 1000.0,
            damping_n_s_per_m: 1.0,
            push_only: true,
        },
    }
    .build(&design)
    .unwrap()
}

#[test]
fn at_constant_speed_the_sum_of_the_output_follows_the_sum_of_the_input_for_ever() {
    /// Largest allowed span of the position error, in counts. The counts have a ripple of one count. The filter hardly
    /// increases this ripple.
    const SPAN_MAX_COUNTS: f64 = 1.1;
    const SAMPLES: i64 = 1_000_000;
    let rate_hz = 1e4;
    let mut worst = 0f64;
    for cutoff_hz in cutoffs().step_by(3).map(|cutoff| cutoff * rate_hz) {
        let control = control(cutoff_hz, rate_hz);
        // Speeds in counts per sample: fractions, a slow speed, and speeds up to the last speed below the limit.
        for (counts, samples) in [(3, 10), (-1, 3), (1, 1000), (100, 7), (32_766, 1), (-65_531, 2)]
        {
            let mut sampler = Sampler::new(0, CounterWidth::Bits32);
            let transient = (20.0 * rate_hz / cutoff_hz) as i64;
            let (mut sum, mut low, mut high) = (0i64, i64::MAX, i64::MIN);
            let mut before = 0i64;
            for n in 1..=transient + SAMPLES {
                let count = n * counts / samples;
                let velocity = sampler.sample(&control, count as u32).motion.velocity;
                sum += i64::from(velocity.bits()) - ((count - before) << 16);
                before = count;
                if n >= transient {
                    (low, high) = (low.min(sum), high.max(sum));
                }
            }
            let span = (high - low) as f64 * VELOCITY_LSB;
            assert!(span <= SPAN_MAX_COUNTS, "{cutoff_hz} Hz, {counts}/{samples}: {span} counts");
            worst = worst.max(span);
        }
    }
    println!("largest span of sum(out - in) over {SAMPLES} samples: {worst:.3} counts");
    figure("host/filter/drift_counts", worst);
}

#[test]
fn a_handle_that_stops_leaves_at_most_one_lsb_after_twenty_over_the_cutoff() {
    let mut worst = 0;
    for rate_hz in RATES_HZ {
        for cutoff_hz in cutoffs().map(|cutoff| cutoff * rate_hz) {
            let biquad = filter(cutoff_hz, rate_hz, false);
            let mut state = BiquadState::default();
            let mut seed = 1u32;
            let moving = ((2.0 * rate_hz / cutoff_hz) as u32).max(1000);
            for _ in 0..moving {
                seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                let speed = (seed >> 8) as i32 % 30_000;
                biquad.update(&mut state, Velocity::saturating_from_counts(speed));
            }
            let wait = (20.0 * rate_hz / cutoff_hz).ceil() as u32;
            for n in 0..wait + 5000 {
                let left = biquad.update(&mut state, Velocity::ZERO).bits().abs();
                if n >= wait {
                    worst = worst.max(left);
                    assert!(left <= 1, "{left} LSB left at {cutoff_hz} Hz, {rate_hz} Hz");
                }
            }
        }
    }
    println!("largest rest: {worst} LSB");
    figure("host/filter/rest_lsb", worst);
}

#[test]
fn an_overload_saturates_and_ends_with_its_input() {
    for cutoff_hz in [10.0, 640.0, 4000.0, 4990.0] {
        let biquad = filter(cutoff_hz, 1e4, false);
        let mut state = BiquadState::default();
        let full = Velocity::saturating_from_counts(i32::MAX);
        let mut peak = 0;
        for _ in 0..20_000 {
            peak = peak.max(biquad.update(&mut state, full).bits());
        }
        assert_eq!(peak, full.bits(), "the overshoot is cut at the limit");
        let back = Velocity::saturating_from_counts(i32::MIN);
        let lowest = (0..20_000).map(|_| biquad.update(&mut state, back).bits()).min().unwrap();
        assert_eq!(lowest, back.bits());
    }
}

#[test]
fn retuning_while_moving_makes_no_kick() {
    let speed = Velocity::saturating_from_counts(100);
    let mut state = BiquadState::default();
    let (low, high) = (filter(20.0, 1e4, false), filter(4000.0, 1e4, false));
    for _ in 0..100_000 {
        low.update(&mut state, speed);
    }
    for n in 0..1000 {
        let filter = if n % 7 < 3 { &low } else { &high };
        let off = filter.update(&mut state, speed).bits() - speed.bits();
        assert!(off.abs() <= 1, "{off} LSB at sample {n}");
    }
}

/// RMS error of the filter's output that a white rounding error of one LSB causes. It is computed from the impulse
/// response.
fn shaped_noise_lsb(biquad: &Biquad, order: usize) -> f64 {
    let [_, _, _, a1, a2] = biquad.bits().map(|bits| f64::from(bits) * COEFFICIENT_LSB);
    let numerator: &[f64] = if order == 1 { &[1.0, -1.0] } else { &[1.0, -2.0, 1.0] };
    let (mut y1, mut y2, mut sum) = (0.0, 0.0, 0.0);
    for n in 0..2_000_000 {
        let y = numerator.get(n).copied().unwrap_or(0.0) - a1 * y1 - a2 * y2;
        (y2, y1) = (y1, y);
        sum += y * y;
    }
    (sum / 12.0).sqrt()
}

#[test]
fn the_quieter_order_of_error_feedback_is_chosen() {
    use zwidth::velocity::Shaping;
    for cutoff in [4e-5, 1e-3, 0.01, 0.03, 0.05, 0.055, 0.07, 0.1, 0.2, 0.4, 0.49] {
        let biquad = filter(cutoff * 1e4, 1e4, false);
        let [first, second] = [1, 2].map(|order| shaped_noise_lsb(&biquad, order));
        figure(&format!("host/filter/shaping/{cutoff}/first"), first);
        figure(&format!("host/filter/shaping/{cutoff}/second"), second);
        let quieter = if first < second { Shaping::First } else { Shaping::Second };
        assert_eq!(biquad.shaping(), quieter, "{cutoff} of the rate: {first} {second} LSB");
    }
    // Near the crossing of the two forms, the selected form may have slightly more noise.
    let noisier = (550..750).map(|hz| {
        let biquad = filter(f64::from(hz), 1e4, false);
        let [first, second] = [1, 2].map(|order| shaped_noise_lsb(&biquad, order));
        let taken = if biquad.shaping() == Shaping::First { first } else { second };
        taken / first.min(second) - 1.0
    });
    let noisier = noisier.fold(0.0, f64::max);
    assert!(noisier < 0.01, "{noisier}");
    figure("host/filter/shaping/noisier", noisier);
}
