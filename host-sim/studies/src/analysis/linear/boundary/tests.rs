//! Compares the boundary with eigenvalues that are computed independently. The loops are random or extreme.

use super::{
    super::{Device, Elements, Loop, TransferFunction},
    *,
};
use zwidth::velocity::{ButterworthDesign, FirstOrder};

use crate::{
    figure::figure,
    scene::element::{Amplifier, Arm, Mode},
    simulation::twin::LowPass,
};

const LOOPS: u32 = 400;

/// Relative distance from a crossing at which the number of unstable eigenvalues is compared, on both sides of the
/// crossing.
const ASIDE: f64 = 1e-4;

/// Tolerance for an eigenvalue on the circle. The largest eigenvalue of the matrix is about a hundred times larger than
/// an eigenvalue on the circle.
const ON_CIRCLE: f64 = 1e-8;

/// Random numbers in [0, 1) from a 64-bit linear congruential generator (Knuth's MMIX).
struct Dice(u64);

impl Dice {
    fn roll(&mut self) -> f64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        f64::from(u32::try_from(self.0 >> 32).unwrap()) / 4_294_967_296.0
    }

    fn logarithmic(&mut self, low: f64, high: f64) -> f64 {
        low * (high / low).powf(self.roll())
    }

    fn below(&mut self, n: u32) -> u32 {
        let n_f = f64::from(n) * self.roll();
        (0..n).rev().find(|i| f64::from(*i) <= n_f).unwrap_or(0)
    }

    /// Makes a realistic device with any estimator, rate, period and latency.
    fn of(&mut self) -> Loop {
        let rate_hz = [1e3, 1e4, 5e4][self.below(3) as usize];
        let device = Device {
            mass_kg: self.logarithmic(0.01, 10.0),
            damping_n_s_per_m: self.logarithmic(0.01, 100.0),
            stiffness_n_per_m: [0.0, self.logarithmic(1.0, 1e5)][self.below(2) as usize],
        };
        let cutoff = rate_hz * self.logarithmic(1e-3, 0.45);
        let plain = TransferFunction::finite_difference(rate_hz);
        let second = |prewarp| {
            let cutoff = if prewarp { cutoff.min(0.38 * rate_hz) } else { cutoff };
            LowPass::from(ButterworthDesign::new(cutoff, rate_hz, prewarp).unwrap())
        };
        let first = LowPass::from(FirstOrder::new(cutoff, rate_hz, false).unwrap());
        let estimator = match self.below(4) {
            0 => plain,
            1 => plain.then(&first.into()),
            2 => plain.then(&second(true).into()),
            _ => plain.then(&second(false).into()),
        };
        let period = [1, 2, 5, 10][self.below(4) as usize];
        let latency_samples = match self.below(3) {
            0 => 0.0,
            1 => f64::from(self.below(12)),
            _ => 12.0 * self.roll(),
        };
        let elements = Elements::default();
        Loop { device, elements, rate_hz, period, latency_samples, estimator }
    }

    /// Makes a realistic loop with at least one linear element.
    fn augmented(&mut self) -> Loop {
        let of = self.of();
        let which = 1 + self.below(7);
        let amplifier = Amplifier { bandwidth_hz: of.rate_hz * self.logarithmic(1e-2, 100.0) };
        let mass_kg = of.device.mass_kg * self.logarithmic(0.1, 3.0);
        let frequency = 2.0 * PI * of.rate_hz * self.logarithmic(1e-3, 0.6);
        let mode = Mode {
            mass_kg,
            stiffness_n_per_m: mass_kg * frequency * frequency,
            damping_n_s_per_m: mass_kg * frequency * self.logarithmic(1e-2, 2.0),
        };
        let arm = Arm {
            mass_kg: self.logarithmic(0.1, 5.0),
            damping_n_s_per_m: self.logarithmic(0.1, 50.0),
            stiffness_n_per_m: [0.0, self.logarithmic(10.0, 1e3)][self.below(2) as usize],
            rest_position_m: 0.0,
            grip_damping_n_s_per_m: self.logarithmic(1.0, 100.0),
            grip_stiffness_n_per_m: self.logarithmic(100.0, 1e4),
        };
        let elements = Elements {
            amplifier: (which & 1 != 0).then_some(amplifier),
            mode: (which & 2 != 0).then_some(mode),
            arm: (which & 4 != 0).then_some(arm),
        };
        Loop { elements, ..of }
    }

    /// A random damping, from much too small to much too large.
    fn damping(&mut self, of: &Loop) -> f64 {
        let scale = of.device.mass_kg * of.rate_hz / f64::from(of.period);
        if self.below(5) == 0 { 0.0 } else { scale * self.logarithmic(1e-4, 3.0) }
    }
}

#[test]
fn eigenvalues_agree_on_both_sides_of_every_crossing() {
    agree_at_crossings(Dice(1), Dice::of);
}

#[test]
fn eigenvalues_agree_on_both_sides_of_every_crossing_with_linear_elements() {
    figure("sim_studies/crossings/loops", LOOPS);
    figure("sim_studies/crossings/found", agree_at_crossings(Dice(4), Dice::augmented));
}

/// Checks the crossings of many loops, and returns their number.
fn agree_at_crossings(mut dice: Dice, roll: fn(&mut Dice) -> Loop) -> u32 {
    let (mut crossings, mut unstable_at_zero, mut further, mut inconsistent) = (0, 0, 0, 0);
    for _ in 0..LOOPS {
        let of = roll(&mut dice);
        let boundary = Boundary::new(&of).unwrap();
        let monodromy = Monodromy::new(&of).unwrap();
        let damping = dice.damping(&of);
        inconsistent += u32::from(!boundary.intervals(&boundary.points, damping).consistent);
        let limit = boundary.at(damping).unwrap();
        for c in &limit.phase_crossings {
            let k = c.stiffness_n_per_m;
            let nearest = |k: f64| {
                let on_circle = |z: &nalgebra::Complex<f64>| (z.norm_sqr() - 1.0).abs();
                let all = monodromy.eigenvalues(k, damping).unwrap();
                all.into_iter().min_by(|a, b| on_circle(a).total_cmp(&on_circle(b))).unwrap()
            };
            let w = c.frequency_hz * 2.0 * PI * f64::from(of.period) / of.rate_hz;
            let z = nearest(k);
            assert!((z.norm_sqr() - 1.0).abs() < ON_CIRCLE, "{of:?} B {damping} {c:?}: {z}");
            assert!((z.re - w.cos()).abs() < 1e-5, "{of:?} B {damping} {c:?}: {z}");
            crossings += 1;
        }
        if limit.unstable_at_zero {
            assert_eq!(limit.stiffness_max, 0.0);
            unstable_at_zero += 1;
        } else {
            let k = limit.stiffness_max;
            for share in [1e-3, 0.3, 0.9, 1.0 - ASIDE] {
                assert!(
                    monodromy.spectral_radius(k * share, damping) < 1.0,
                    "{of:?} B {damping} K {}",
                    k * share
                );
            }
            assert!(
                monodromy.spectral_radius(k * (1.0 + ASIDE), damping) > 1.0,
                "{of:?} B {damping} K {k}"
            );
        }
        for (low, high) in &limit.further_stable {
            further += 1;
            assert!(
                monodromy.spectral_radius((low * high).sqrt(), damping) < 1.0,
                "{of:?} B {damping} {low} {high}"
            );
        }
    }
    println!(
        "{crossings} crossings, {unstable_at_zero} unstable at 0, {further} further intervals, {inconsistent} inconsistent"
    );
    assert!(crossings > 400 && unstable_at_zero > 20);
    assert_eq!(inconsistent, 0);
    crossings
}

#[test]
fn a_body_that_no_spring_holds_does_not_make_the_loop_unstable() {
    // A spring of almost 0 gives the same loop as a spring of 0. With exactly 0, the body's position is an eigenvalue
    // of 1.
    let arm = Arm {
        mass_kg: 1.2,
        damping_n_s_per_m: 12.0,
        stiffness_n_per_m: 0.0,
        rest_position_m: 0.0,
        grip_damping_n_s_per_m: 25.0,
        grip_stiffness_n_per_m: 0.0,
    };
    let mode = Mode { mass_kg: 0.15, stiffness_n_per_m: 0.0, damping_n_s_per_m: 4.0 };
    let gripped = Arm { grip_stiffness_n_per_m: 1200.0, ..arm };
    let apart = Arm { grip_damping_n_s_per_m: 0.0, ..arm };
    let amplifier = Some(Amplifier { bandwidth_hz: 400.0 });
    for (mode, arm, amplifier) in [
        (None, Some(arm), None),
        (Some(mode), None, amplifier),
        (Some(mode), Some(arm), None),
        (Some(mode), Some(gripped), amplifier),
        (Some(Mode { stiffness_n_per_m: 6e4, ..mode }), Some(arm), None),
        (None, Some(apart), None),
        (Some(Mode { damping_n_s_per_m: 0.0, ..mode }), Some(arm), amplifier),
        // If a body has a spring to the ground, this body and all bodies that are connected to it do not float.
        (Some(mode), Some(Arm { stiffness_n_per_m: 300.0, ..apart }), amplifier),
        (Some(mode), Some(Arm { stiffness_n_per_m: 300.0, ..arm }), None),
        (Some(mode), Some(Arm { stiffness_n_per_m: 300.0, ..gripped }), None),
    ] {
        for period in [1, 10] {
            let limit = |spring: f64| {
                let near = |stiffness: f64| if stiffness == 0.0 { spring } else { stiffness };
                let mode = mode.map(|m| Mode { stiffness_n_per_m: near(m.stiffness_n_per_m), ..m });
                let arm = arm.map(|a| Arm { stiffness_n_per_m: near(a.stiffness_n_per_m), ..a });
                let estimator = TransferFunction::paper(1e4, 500.0).unwrap();
                let elements = Elements { amplifier, mode, arm };
                let of =
                    Loop { elements, period, ..Loop::single_rate(Device::PAPER, 1e4, estimator) };
                Boundary::new(&of).unwrap().at(20.0).unwrap()
            };
            let (free, held) = (limit(0.0), limit(1e-6));
            assert!(!free.unstable_at_zero, "{mode:?} {arm:?} {free:?}");
            let (k, near) = (free.stiffness_max, held.stiffness_max);
            assert!(k > 1000.0 && (k / near - 1.0).abs() < 1e-6, "{mode:?} {arm:?} {k} {near}");
        }
    }
}

#[test]
fn what_nothing_damps_holds_no_wall() {
    // Two bodies are joined by a spring or a damper, without a connection to the ground. Because of rounding, they
    // could seem to be on a spring of 1e-12 N/m to the ground.
    let device = Device { mass_kg: 1.3, damping_n_s_per_m: 0.0, stiffness_n_per_m: 0.0 };
    let joined = |stiffness_n_per_m, damping_n_s_per_m| {
        Some(Mode { mass_kg: 0.18, stiffness_n_per_m, damping_n_s_per_m })
    };
    for (mode, rate_hz, period) in [
        (joined(0.0, 400.0), 1e4, 10),
        (joined(3e4, 0.0), 1e3, 10),
        (joined(3e4, 4.0), 1e3, 1),
        (None, 1e4, 10),
    ] {
        let estimator = TransferFunction::finite_difference(rate_hz);
        let elements = Elements { mode, ..Elements::default() };
        let of = Loop { elements, period, ..Loop::single_rate(device, rate_hz, estimator) };
        let limit = Boundary::new(&of).unwrap().at(0.0).unwrap();
        assert!(limit.unstable_at_zero, "{mode:?} {limit:?}");
        let ends = limit.phase_crossings.iter().map(|c| c.stiffness_n_per_m);
        assert!(ends.clone().all(|k| k > 1.0), "{mode:?} {limit:?}");
    }
}

#[test]
fn half_the_rate_is_no_crossing_where_the_sampling_zero_lies() {
    // The response of an undamped device is 0 at z = -1. With a rounded pi, a root once seemed to enter the circle at z
    // = -1, with K = 4 m/T^2.
    let device = Device { mass_kg: 1.5725, damping_n_s_per_m: 0.0, stiffness_n_per_m: 177.4748 };
    let (mass_kg, damping_n_s_per_m) = (0.88, 0.0);
    let mode = Some(Mode { mass_kg, stiffness_n_per_m: 110.4708, damping_n_s_per_m });
    let arm = Some(Arm {
        mass_kg: 0.1844,
        damping_n_s_per_m,
        stiffness_n_per_m: 0.0,
        rest_position_m: 0.0,
        grip_damping_n_s_per_m: 22.4,
        grip_stiffness_n_per_m: 333.28,
    });
    let elements = Elements { amplifier: None, mode, arm };
    let of = Loop {
        elements,
        ..Loop::single_rate(device, 5e4, TransferFunction::paper(5e4, 1500.0).unwrap())
    };
    let limit = Boundary::new(&of).unwrap().at(1624.8).unwrap();
    assert!(limit.stiffness_max > 1e7 && limit.phase_crossings.len() == 1, "{limit:?}");
}

#[test]
fn narrow_resonances_are_not_stepped_over() {
    let mut dice = Dice(5);
    let mut stable = 0;
    for _ in 0..150 {
        let mut of = dice.augmented();
        let frequency = 2.0 * PI * of.rate_hz * dice.logarithmic(1e-3, 0.4);
        let mass_kg = of.device.mass_kg * dice.logarithmic(1e-4, 1e-1);
        of.elements.mode = Some(Mode {
            mass_kg,
            stiffness_n_per_m: mass_kg * frequency * frequency,
            damping_n_s_per_m: mass_kg * frequency * dice.logarithmic(1e-6, 1e-3),
        });
        let boundary = Boundary::new(&of).unwrap();
        let monodromy = Monodromy::new(&of).unwrap();
        let damping = dice.damping(&of);
        let found = boundary.intervals(&boundary.points, damping);
        assert!(found.consistent, "{of:?} B {damping}");
        let limit = boundary.at(damping).unwrap();
        stable += u32::from(limit.stiffness_max > 0.0);
        for share in [0.01, 0.1, 0.3, 0.9, 0.999] {
            let radius = monodromy.spectral_radius(limit.stiffness_max * share, damping);
            assert!(
                limit.stiffness_max == 0.0 || radius < 1.0 + 1e-9,
                "{of:?} B {damping} {limit:?} {share}: {radius}"
            );
        }
    }
    assert!(stable > 30, "{stable}");
}

#[test]
fn no_interval_escapes_a_scan() {
    // Eigenvalues on a dense grid of K find no stable or unstable interval that the crossings miss.
    let mut dice = Dice(2);
    for roll in 0..100 {
        let of = if roll < 60 { dice.of() } else { dice.augmented() };
        let boundary = Boundary::new(&of).unwrap();
        let monodromy = Monodromy::new(&of).unwrap();
        let damping = dice.damping(&of);
        let limit = boundary.at(damping).unwrap();
        let mut k = boundary.own_stiffness * 1e-7;
        while k < boundary.own_stiffness * 1e3 {
            let radius = monodromy.spectral_radius(k, damping);
            let inside = k < limit.stiffness_max
                || limit.further_stable.iter().any(|(a, b)| k > *a && k < *b);
            assert!(
                (radius < 1.0) == inside || (radius - 1.0).abs() < 1e-7,
                "{of:?} B {damping} K {k}: {radius} {limit:?}"
            );
            k *= 1.05;
        }
    }
}

#[test]
fn winding_number_counts_as_eigenvalues_do() {
    let mut dice = Dice(3);
    let mut seen = [0; 4];
    for roll in 0..100 {
        let of = if roll < 60 { dice.of() } else { dice.augmented() };
        let boundary = Boundary::new(&of).unwrap();
        let damping = dice.damping(&of);
        let k = boundary.own_stiffness * dice.logarithmic(1e-4, 1.0);
        let (count, margin) = boundary.count(&boundary.points, k, damping);
        if margin > CLEAR_MARGIN {
            assert_eq!(
                boundary.winding(&boundary.points, k, damping),
                count,
                "{of:?} B {damping} K {k}"
            );
            seen[count.min(3) as usize] += 1;
        }
    }
    assert!(seen[0] > 5 && seen[2] > 5, "{seen:?}");
}

#[test]
fn long_latency_follows_gils_rule() {
    // For low damping, K < b / (T/2 + latency) (Gil et al. 2009). The limit here is within 2 % of it for latencies of
    // 200 samples or more.
    for latency_samples in [50.0, 200.5, 1000.0] {
        let device = Device { mass_kg: 10.0, damping_n_s_per_m: 1.0, stiffness_n_per_m: 0.0 };
        let estimator = TransferFunction::finite_difference(1e4);
        let of = Loop { latency_samples, ..Loop::single_rate(device, 1e4, estimator) };
        let k = Boundary::new(&of).unwrap().at(0.0).unwrap().stiffness_max;
        let rule = 1.0 / ((0.5 + latency_samples) * 1e-4);
        assert!((k / rule - 1.0).abs() < 0.02, "{latency_samples}: {k} against {rule}");
    }
}

#[test]
fn latency_is_split_exactly() {
    // The limit is continuous in the latency, also at whole samples and whole periods.
    let estimator = TransferFunction::paper(1e4, 500.0).unwrap();
    let at = |latency_samples: f64| {
        let of = Loop {
            period: 10,
            latency_samples,
            ..Loop::single_rate(Device::PAPER, 1e4, estimator.clone())
        };
        Boundary::new(&of).unwrap().at(20.0).unwrap().stiffness_max
    };
    for whole in [1.0, 7.0, 10.0, 20.0] {
        let (before, on, after) = (at(whole - 1e-6), at(whole), at(whole + 1e-6));
        assert!(
            (before / on - 1.0).abs() < 1e-5 && (after / on - 1.0).abs() < 1e-5,
            "{before} {on} {after}"
        );
        assert!(before > on && on > after);
    }
}

#[test]
fn lower_cutoff_never_helps_from_100_hz_up() {
    // Figure 2 of the paper. The largest K was computed with exact eigenvalues in another program.
    for damping in [10.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 5000.0] {
        let mut last = 0.0;
        for step in 0..60 {
            let cutoff = 100.0 * 40.0_f64.powf(f64::from(step) / 59.0);
            let of = Loop::single_rate(
                Device::PAPER,
                1e4,
                TransferFunction::paper(1e4, cutoff).unwrap(),
            );
            let k = Boundary::new(&of).unwrap().at(damping).unwrap().stiffness_max;
            assert!(k >= last, "B {damping}: {k} at {cutoff} Hz, {last} below it");
            last = k;
        }
    }
}

#[test]
fn gain_margin_fails_where_damping_alone_is_unstable() {
    let boundary = Boundary::new(&Loop::single_rate(
        Device::PAPER,
        1e4,
        TransferFunction::paper(1e4, 20.0).unwrap(),
    ))
    .unwrap();
    let fails = boundary.at(100.0).unwrap();
    assert!(fails.unstable_at_zero && !fails.gain_margin_holds());
    assert_eq!(fails.gain_margin(), None, "it would have called every stiffness stable");
    let holds = boundary.at(10.0).unwrap();
    assert!(holds.gain_margin_holds() && holds.gain_margin() == Some(holds.stiffness_max));
}

#[test]
fn powers_of_two_of_force_scale_the_limit_exactly() {
    for scale in [0.125, 64.0] {
        let d = Device::PAPER;
        let scaled = Device {
            mass_kg: d.mass_kg * scale,
            damping_n_s_per_m: d.damping_n_s_per_m * scale,
            stiffness_n_per_m: d.stiffness_n_per_m * scale,
        };
        for period in [1, 10] {
            let limit = |device: Device, damping: f64| {
                let estimator = TransferFunction::paper(1e4, 500.0).unwrap();
                let of = Loop { period, ..Loop::single_rate(device, 1e4, estimator) };
                Boundary::new(&of).unwrap().at(damping).unwrap().stiffness_max
            };
            assert_eq!(limit(scaled, 50.0 * scale), limit(d, 50.0) * scale);
        }
    }
}

#[test]
fn crossings_and_winding_number_count_alike_for_long_latency() {
    for latency_samples in [30.0, 200.5, 1000.0] {
        let device = Device { mass_kg: 10.0, damping_n_s_per_m: 1.0, stiffness_n_per_m: 0.0 };
        let estimator = TransferFunction::finite_difference(1e4);
        let of = Loop { latency_samples, ..Loop::single_rate(device, 1e4, estimator) };
        let boundary = Boundary { monodromy: None, ..Boundary::new(&of).unwrap() };
        for damping in [0.0, 1.0] {
            let found = boundary.intervals(&boundary.points, damping);
            assert!(found.consistent && found.crossings.len() > 10);
            for i in 0..10 {
                let ends = [i, i + 1].map(|j| found.crossings[j].stiffness_n_per_m);
                let k = (ends[0] * ends[1]).sqrt();
                let count = boundary.winding(&boundary.points, k, damping);
                assert_eq!(
                    found.unstable[i + 1],
                    i64::from(count),
                    "latency {latency_samples} B {damping} K {k}"
                );
            }
        }
    }
}

#[test]
fn stable_interval_is_followed_until_it_closes() {
    // The filter is far slower than the device with its spring. With growing damping, the loop first becomes unstable
    // at K = 0. A stable interval remains at higher K, and shrinks to a point. Two crossings meet at this point. It is
    // between search points.
    let device = Device { mass_kg: 0.4, damping_n_s_per_m: 5.0, stiffness_n_per_m: 1e4 };
    let of = Loop::single_rate(device, 1e4, TransferFunction::paper(1e4, 20.0).unwrap());
    let boundary = Boundary::new(&of).unwrap();
    let interval = |damping: f64| {
        let limit = boundary.at(damping).unwrap();
        if limit.stiffness_max > 0.0 {
            Some((0.0, limit.stiffness_max))
        } else {
            limit.further_stable.first().copied()
        }
    };
    let (mut open, mut closed) = (25.0, 32.0);
    assert!(interval(open).is_some() && interval(closed).is_none());
    for _ in 0..45 {
        let middle = 0.5 * (open + closed);
        if interval(middle).is_some() { open = middle } else { closed = middle }
    }
    let (low, high) = interval(open).unwrap();
    println!("closes at B {open} with K {low} to {high}");
    assert!(boundary.at(open).unwrap().unstable_at_zero && low > 0.0);
    // The width of the interval is proportional to sqrt(distance). The distance is that of B from the point at which
    // the interval closes. Here the distance is 1e-12.
    assert!((high - low) / low < 1e-4, "{low} {high}");
    let wider = interval(open - 0.1).unwrap();
    let k = 0.5 * (wider.0 + wider.1);
    assert!(Monodromy::new(&of).unwrap().spectral_radius(k, open - 0.1) < 1.0);
    assert!(Monodromy::new(&of).unwrap().spectral_radius(k, open + 0.1) > 1.0);
}
