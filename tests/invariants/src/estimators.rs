//! Properties of every estimator of the table, with all accepted parameters on all accepted designs.

use proptest::prelude::*;
use zwidth::{
    CounterWidth, Design, LoopParameters, Sampler, Settings, VelocitySettings, WallSettings,
    units::{Acceleration, Force, Position, Velocity},
    velocity::{self, Edge, EstimatorName, Senses, State},
};

use crate::{
    any::{self, Random},
    stated::{LSB, Resonance, stated},
};

/// An estimator of the table with its parameters.
#[derive(Clone, Copy, Debug)]
struct Tuned {
    design: Design,
    settings: VelocitySettings,
}

impl Tuned {
    fn estimator(&self) -> velocity::Tuned {
        velocity::Tuned::first(self.settings.build(&self.design).unwrap())
    }

    fn name(&self) -> EstimatorName {
        self.settings.name()
    }

    fn control(&self) -> LoopParameters {
        let wall =
            WallSettings { position_m: 0.0, stiffness_n_per_m: 0.0, damping_n_s_per_m: 0.0, push_only: true };
        Settings { velocity: self.settings, wall }.build(&self.design).unwrap()
    }
}

fn tuned() -> impl Strategy<Value = Tuned> + Clone {
    (any::design(), any::estimator(), any::parts()).prop_filter_map("no tuning is left", |(design, name, parts)| {
        Some(Tuned { design, settings: any::tuned(name, parts, &design)? })
    })
}

/// Estimators that run one after another on the same design.
fn several() -> impl Strategy<Value = Vec<Tuned>> {
    let one = (any::estimator(), any::parts());
    (any::design(), prop::collection::vec(one, 2..6)).prop_map(|(design, each)| {
        let tuned = |(name, parts)| Some(Tuned { design, settings: any::tuned(name, parts, &design)? });
        each.into_iter().filter_map(tuned).collect()
    })
}

/// A running estimator, which starts at rest at a count.
struct Run {
    estimator: velocity::Tuned,
    state: State,
}

impl Run {
    fn at(tuned: &Tuned, count: i32) -> Self {
        Self { estimator: tuned.estimator(), state: State::at_rest(Position::from_counts(count)) }
    }

    fn step(&mut self, count: i64, senses: &Senses) -> i32 {
        let position = Position::from_counts(count as i32);
        let velocity = self.estimator.update(&mut self.state, position, senses).bits();
        assert!(velocity.abs() <= Velocity::LIMIT << Velocity::FRACTION_BITS, "{velocity} is beyond the range");
        velocity
    }
}

/// The latest edge at sample `n` of a handle at position `speed * n + phase`.
fn edge(speed: f64, phase: f64, n: f64) -> Option<Edge> {
    let border = (speed * n + phase).floor() + f64::from(speed < 0.0);
    let age = n - (border - phase) / speed;
    // Before the motion began there was no edge.
    (speed != 0.0 && age <= n).then_some(Edge { age: (age * LSB) as u32, up: speed > 0.0 })
}

fn mirrored(senses: &Senses) -> Senses {
    Senses {
        force: Force::saturating_from_bits(-senses.force.bits()),
        acceleration: Acceleration::saturating_from_bits(-senses.acceleration.bits()),
        edge: senses.edge.map(|edge| Edge { up: !edge.up, ..edge }),
    }
}

/// Number of LSB by which the velocity of a mirrored motion may differ, because halves are rounded up.
fn mirror_lsb(name: EstimatorName) -> i32 {
    use EstimatorName as N;
    match name {
        N::Difference | N::FoawEnd | N::FoawBest | N::TimeStamps => 0,
        _ => 2,
    }
}

/// Number of LSB by which the sum of 300 velocities may differ from the counts, if the speed is a whole number of
/// counts per sample.
const SUM_LSB: f64 = 20.0;

crate::properties! {
    /// A handle that was always at rest has the velocity 0 exactly, at any count.
    rest(500, (tuned, count) in (tuned(), any::<i32>())) {
        let mut run = Run::at(&tuned, count);
        for _ in 0..200 {
            assert_eq!(run.step(count.into(), &Senses::NONE), 0);
        }
    }

    /// The same motion at another position gives the same velocities bit for bit. This holds across a wrap of the
    /// count, and for a counter of 16 bits.
    shifted(400, (tuned, pieces, by, seed) in (
        tuned(),
        prop_oneof![any::motion(20_000.0), any::nonsense()],
        prop_oneof![any::<i32>(), Just(i32::MAX), Just(i32::MIN)],
        any::<u64>(),
    )) {
        let mut random = Random(seed);
        let (mut here, mut there) = (Run::at(&tuned, 0), Run::at(&tuned, by));
        let control = tuned.control();
        let mut narrow = Sampler::new(0, CounterWidth::Bits16);
        let mut follows = true;
        let mut last = 0;
        for count in any::counts(&pieces) {
            let senses = random.senses();
            let velocity = here.step(count, &senses);
            assert_eq!(velocity, there.step(count + i64::from(by), &senses));
            // True as long as a counter of 16 bits can follow.
            follows &= (count - last).abs() < 1 << 15;
            last = count;
            let sampled = narrow.sense(&control, count as u32 & 0xFFFF, &senses);
            assert!(!follows || sampled.motion.velocity.bits() == velocity);
        }
    }

    /// The mirrored motion gives the mirrored velocities. They are exact, or within 2 LSB if the estimator rounds. If
    /// it may resonate, the limit is larger.
    mirror(400, (tuned, pieces, seed) in (tuned(), any::motion(20_000.0), any::<u64>())) {
        let mut random = Random(seed);
        let (mut one, mut other) = (Run::at(&tuned, 0), Run::at(&tuned, 0));
        let resonance = stated(&tuned.settings, &tuned.design).resonance;
        let lsb = resonance.map_or(mirror_lsb(tuned.name()).into(), |both| 2.0 * both.rounding);
        let (mut last, mut fastest) = (0, 0);
        for count in any::counts(&pieces) {
            let senses = random.senses();
            fastest = fastest.max((count - last).abs());
            last = count;
            let (velocity, back) = (one.step(count, &senses), other.step(-count, &mirrored(&senses)));
            // A state that saturates has one LSB more range down than up. A slow filter keeps this difference.
            let saturates = |both: Resonance| {
                velocity.abs() >= Velocity::LIMIT << Velocity::FRACTION_BITS
                    || fastest as f64 * both.inside >= f64::from(Velocity::LIMIT)
            };
            if resonance.is_some_and(saturates) {
                break;
            }
            assert!(f64::from((velocity + back).abs()) <= lsb, "{velocity} and {back}");
        }
    }

    /// Nothing overflows and every velocity is in range, for any counts and inputs, also after new tunings and
    /// restarts.
    no_overflow(400, (each, pieces, seed) in (
        several(),
        prop::collection::vec(prop_oneof![any::nonsense(), any::motion(32_767.0)], 2..5),
        any::<u64>(),
    )) {
        let Some(first) = each.first() else { return Ok(()) };
        let mut random = Random(seed);
        let mut run = Run::at(first, 0);
        let mut from = 0;
        for (pieces, tuned) in pieces.iter().zip(each.iter().cycle()) {
            run.estimator = tuned.estimator().after(&run.estimator);
            let counts = any::counts(pieces);
            for count in &counts {
                run.step(from + count, &random.senses());
            }
            from += counts.last().copied().unwrap_or_default();
        }
    }

    /// After the change of speed has settled, a constant speed is measured within the error of docs/estimators.md.
    /// Whole counts per sample have their own limit.
    slopes(150, (tuned, part, back, whole, phase) in (
        tuned(),
        any::part(),
        any::<bool>(),
        any::<bool>(),
        0.0..1.0f64,
    )) {
        let says = stated(&tuned.settings, &tuned.design);
        let stamps = says.error.is_nan();
        let fastest = if says.settles[1] > 0.0 { 30_000.0 / says.settles[1] } else { 20_000.0 };
        let slowest = if stamps { 1e-3 } else { 1e-5f64.min(fastest) };
        let mut speed = any::between(slowest, fastest.min(20_000.0), part.sqrt().sqrt());
        if whole {
            speed = speed.round();
        }
        let waits = says.settles[0] + says.settles[1] * speed + if stamps && speed > 0.0 { 3.0 / speed } else { 0.0 };
        if waits > 40_000.0 {
            return Ok(()); // a slow tuning takes seconds
        }
        let speed = if back { -speed } else { speed };
        let mut error = if speed.fract() == 0.0 { says.whole } else { says.error };
        if let VelocitySettings::TimeStamps { span_samples } = tuned.settings {
            error = speed.abs() / (LSB * (f64::from(span_samples) - 0.5)) + 0.5 / LSB;
        }
        if !says.holds {
            return Ok(());
        }
        let mut run = Run::at(&tuned, phase.floor() as i32);
        let mut sum = 0.0;
        for n in 1..waits as u32 + 300 {
            let n = f64::from(n);
            let senses = Senses { edge: edge(speed, phase, n), ..Senses::NONE };
            let velocity = f64::from(run.step((speed * n + phase).floor() as i64, &senses)) / LSB;
            let off = (velocity - speed).abs();
            assert!(n < waits || off <= error + 1e-9, "{off} at {speed}, stated {error}");
            sum += if n < waits { 0.0 } else { velocity - speed };
            // A value's rounding error is carried to the next value, so errors do not add up.
            let whole = speed.fract() == 0.0 && error <= 2.0 / LSB && !stamps;
            assert!(!whole || sum.abs() <= SUM_LSB / LSB, "{sum} in all at {speed}");
        }
    }

    /// The velocity of a linear estimator equals the velocity by its equations in f64, for any motion. The two may
    /// differ by 3 LSB and by the effect of rounded coefficients.
    linear(200, (tuned, pieces, seed) in (tuned(), any::motion(300.0), any::<u64>())) {
        let says = stated(&tuned.settings, &tuned.design);
        let mut random = Random(seed);
        let counts = any::counts(&pieces);
        // The known force is small, as in the motion of a handle. A larger known force may saturate the state.
        let push = |random: &mut Random| Force::saturating_from_bits((random.bits() as i32) >> 12);
        let senses: Vec<Senses> =
            counts.iter().map(|_| Senses { force: push(&mut random), ..Senses::NONE }).collect();
        let fastest = counts.windows(2).map(|pair| (pair[1] - pair[0]).abs()).max().unwrap_or(0).max(counts[0].abs());
        let full = says.twin.run(&counts, &senses);
        if full.iter().any(|velocity| velocity.abs() > 30_000.0) {
            return Ok(()); // the state saturates
        }
        let mut run = Run::at(&tuned, 0);
        let lsb = says.lsb(fastest as f64 * LSB);
        for ((count, senses), twin) in counts.iter().zip(&senses).zip(full) {
            let off = f64::from(run.step(*count, senses)) - twin * LSB;
            assert!(off.abs() <= lsb, "{off} LSB of {lsb}");
        }
    }

    /// If edge times are ideal, the velocity of `time-stamps` is a mean of the true velocity, even around a reversal.
    /// In either direction the velocity never exceeds the handle's largest speed, except for the rounding of the times.
    true_edges(200, (span, phase, pieces) in (
        1u32..=62,
        0.0..1.0f64,
        prop_oneof![any::motion(0.5), any::motion(5.0), any::motion(300.0)],
    )) {
        let tuned = Tuned { design: any::PAPER, settings: VelocitySettings::TimeStamps { span_samples: span } };
        let mut run = Run::at(&tuned, 0);
        let (mut last, mut age) = (phase, None);
        let (mut slowest, mut fastest) = (0f64, 0f64);
        let mut up = true;
        // The handle is at rest first, with one sample before the motion.
        for place in std::iter::once(0.0).chain(any::places(&pieces)) {
            let now = place + phase;
            let speed = now - last;
            (slowest, fastest) = (slowest.min(speed), fastest.max(speed));
            age = age.map(|age: f64| age + 1.0);
            if now.floor() != last.floor() {
                // The edge that was crossed last.
                up = speed > 0.0;
                let border = now.floor() + f64::from(!up);
                age = Some((now - border) / speed);
            }
            last = now;
            let edge = age.map(|age| Edge { age: (age * LSB) as u32, up });
            let velocity = f64::from(run.step(now.floor() as i64, &Senses { edge, ..Senses::NONE })) / LSB;
            let rounding = fastest.max(-slowest) / (LSB * (f64::from(span) - 0.5)) + 1.0 / LSB;
            assert!((slowest - rounding..=fastest + rounding).contains(&velocity), "{velocity} of {slowest} to {fastest}");
        }
    }

    /// After a handle has stopped and its velocity has settled, the velocity is 0 within the limit for whole counts.
    stop(100, (tuned, pieces) in (tuned(), any::motion(300.0))) {
        let says = stated(&tuned.settings, &tuned.design);
        let stamps = says.error.is_nan();
        // Levant's differentiator needs more time after a larger deviation.
        let mut waits = says.settles[0] + 1000.0 * says.settles[1];
        if stamps {
            waits = 33_000.0; // the velocity is 0 after 2^15 samples without an edge
        }
        if waits > 40_000.0 {
            return Ok(());
        }
        if !says.holds {
            return Ok(());
        }
        let mut run = Run::at(&tuned, 0);
        let counts = any::counts(&pieces);
        for count in &counts {
            run.step(*count, &Senses::NONE);
        }
        let last = counts.last().copied().unwrap_or_default();
        let whole = if stamps { 0.0 } else { says.whole };
        for n in 0..waits as u32 + 100 {
            let velocity = f64::from(run.step(last, &Senses::NONE)) / LSB;
            assert!(f64::from(n) < waits || velocity.abs() <= whole, "{velocity} after {n}");
        }
    }

    /// After one estimator is replaced by another, the velocity jumps at most by the limit that docs/estimators.md has
    /// for the new estimator.
    restart(400, (each, pieces, next, seed) in (
        several(),
        prop_oneof![any::motion(3000.0), any::motion(5.0)],
        prop_oneof![-3i64..=3, -32_000i64..=32_000],
        any::<u64>(),
    )) {
        let [before, after, ..] = each.as_slice() else { return Ok(()) };
        if *before.estimator() == *after.estimator() {
            return Ok(()); // the estimator continues without a restart
        }
        let mut random = Random(seed);
        let mut sampler = Sampler::new(0, CounterWidth::Bits32);
        let (mut velocity, mut at) = (0.0, 0);
        for count in any::counts(&pieces) {
            let sampled = sampler.sense(&before.control(), count as u32, &Senses::NONE);
            (velocity, at) = (f64::from(sampled.motion.velocity.bits()) / LSB, count);
        }
        let senses = Senses { edge: None, ..random.senses() };
        let first = sampler.sense(&after.control().after(&before.control()), (at + next) as u32, &senses);
        let jump = (f64::from(first.motion.velocity.bits()) / LSB - velocity).abs();
        let says = stated(&after.settings, &after.design).jump(velocity, next as f64, &senses);
        assert!(jump <= says, "{jump} for {says}, from {velocity} to {next} counts");
    }
}
