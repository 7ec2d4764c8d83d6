//! Measures the figures for the decision against idsp's biquad as the velocity filter. Both filters get the same
//! coefficients and inputs. The tests compare design and output. `docs/theory.md` quotes these figures, and
//! `tests/elf/control_path.rs` has the instruction counts.

use crate::figure::figure;
use dsp_fixedpoint::Q32;
use dsp_process::SplitProcess;
use idsp::iir;
use zwidth::{
    Design, Output, VelocitySettings,
    units::Velocity,
    velocity::{Biquad, BiquadState, Estimator},
};

/// Three filters with the same coefficients.
struct Peers {
    ours: (Biquad, BiquadState),
    coefficients: iir::Biquad<Q32<30>>,
    dither: iir::DirectForm1Dither,
    wide: iir::DirectForm1Wide,
}

impl Peers {
    fn new(cutoff_hz: f64) -> Self {
        let settings = VelocitySettings::Butterworth { cutoff_hz };
        let design = Design {
            rate_hz: 1e4,
            resolution_m: 1e-6,
            full_scale_n: 1.0,
            period: 10,
            output: Output::Continuous,
        };
        let Estimator::LowPass(ours) = settings.build(&design).unwrap() else { panic!() };
        let [b0, b1, b2, a1, a2] = ours.bits();
        // In idsp, a1 and a2 have the sign of the recurrence.
        let coefficients = iir::Biquad { ba: [b0, b1, b2, -a1, -a2].map(Q32::from_bits) };
        Self {
            ours: (ours, BiquadState::default()),
            coefficients,
            dither: iir::DirectForm1Dither::default(),
            wide: iir::DirectForm1Wide::default(),
        }
    }

    /// Advances all three filters. Returns the outputs of our filter, of first-order error feedback, and of wide state,
    /// in LSB of the velocity.
    fn update(&mut self, counts: i32) -> [i32; 3] {
        let input = Velocity::saturating_from_counts(counts);
        [
            self.ours.0.update(&mut self.ours.1, input).bits(),
            self.coefficients.process(&mut self.dither, input.bits()),
            self.coefficients.process(&mut self.wide, input.bits()),
        ]
    }
}

#[test]
fn an_overshoot_at_full_scale_saturates_here_and_wraps_there() {
    let mut peers = Peers::new(1000.0);
    let lowest = (0..1000)
        .map(|_| peers.update(32_767))
        .fold([0; 3], |low, out| [0, 1, 2].map(|n: usize| low[n].min(out[n])));
    println!("lowest output on a step to +32767 counts per sample: {lowest:?}");
    for (who, low) in ["here", "idsp", "idsp_wide"].into_iter().zip(lowest) {
        figure(&format!("host/peers/lowest/{who}"), low);
    }
    assert_eq!(lowest[0], 0);
    assert!(lowest[1] < 0 && lowest[2] < 0, "the peers no longer wrap: try them again");
}

#[test]
fn after_a_stop_first_order_feedback_leaves_a_limit_cycle_at_low_cutoffs() {
    let mut worst = [0; 3];
    for cutoff_hz in [0.35, 0.4, 0.5, 0.7, 1.0, 2.0] {
        let mut peers = Peers::new(cutoff_hz);
        for n in 0..100_000 {
            peers.update(n % 201 - 100);
        }
        for n in 0..(20.0 * 1e4 / cutoff_hz) as u32 + 5000 {
            let out = peers.update(0);
            if f64::from(n) > 20.0 * 1e4 / cutoff_hz {
                worst = [0, 1, 2].map(|n: usize| worst[n].max(out[n].abs()));
            }
        }
    }
    println!("largest rest 20/fc after a stop, LSB: {worst:?}");
    for (who, rest) in ["here", "idsp", "idsp_wide"].into_iter().zip(worst) {
        figure(&format!("host/peers/rest/{who}"), rest);
    }
    assert!(worst[0] <= 1);
    assert!(worst[1] > 1, "the peer no longer has a limit cycle: try it again");
}

#[test]
fn at_constant_speed_the_wide_state_drifts_away() {
    let mut peers = Peers::new(1.0);
    let mut sum = [0i64; 3];
    let mut before = 0;
    let (transient, samples) = (200_000, 8_000_000);
    for n in 1..=transient + samples {
        let count = n * 3 / 10;
        let moved = count - before;
        before = count;
        let out = peers.update(moved);
        if n > transient {
            sum = [0, 1, 2].map(|n: usize| sum[n] + i64::from(out[n] - (moved << 16)));
        }
    }
    let counts = sum.map(|sum| sum as f64 / 65_536.0);
    println!("sum(out - in) after {samples} samples at 1 Hz, counts: {counts:.3?}");
    for (who, drift) in ["here", "idsp", "idsp_wide"].into_iter().zip(counts) {
        figure(&format!("host/peers/drift/{who}"), drift);
    }
    assert!(counts[0].abs() < 1.1);
    // First order: bounded by 2^30 / S = 39 counts here. Wide state: grows without limit.
    assert!(counts[1].abs() < 39.0);
    assert!(counts[2].abs() > 50.0, "the peer no longer drifts: try it again");
}
