//! Properties of the wall hit: its RMS, its verdict and the time of the verdict.

use proptest::prelude::*;
use zwidth::{
    experiment::{Hit, HitPlan, RmsLimit, Verdict},
    units::{Force, Position},
};

/// Draws the positions of a hit, with a random mean and a random spread. Each position also says whether there is
/// contact.
fn positions() -> impl Strategy<Value = Vec<(i32, bool)>> {
    (any::<i32>(), 0u32..=32, 0..=3u8).prop_flat_map(|(around, bits, contact)| {
        let spread = (1i64 << bits) - 1;
        let position = (-spread..=spread).prop_map(move |away| {
            (i64::from(around) + away).clamp(i32::MIN.into(), i32::MAX.into()) as i32
        });
        let contact = prop::bool::weighted([0.0, 0.02, 0.5, 1.0][usize::from(contact)]);
        prop::collection::vec((position, contact), 2..150)
    })
}

/// Computes `2^32 n^2` times the variance. The test compares this number with `n^2` times the square of a limit, which
/// is in 2^-16 counts.
fn scatter(window: &[(i32, bool)]) -> i128 {
    let n = window.len() as i128;
    // Positions are relative to the first position, since a sum over all pairs would take too long.
    let first = i128::from(window.first().map_or(0, |(x, _)| *x));
    let sum: i128 = window.iter().map(|(x, _)| i128::from(*x) - first).sum();
    let squares: i128 = window.iter().map(|(x, _)| (i128::from(*x) - first).pow(2)).sum();
    n * squares - sum * sum
}

/// Whether `4 * 2^30 a` is below `b`, without overflow.
fn is_below(a: i128, b: u128) -> bool {
    match a.unsigned_abs().checked_mul(1 << 32) {
        Some(a) => a < b,
        None => a.unsigned_abs() < b >> 32,
    }
}

fn model(plan: &HitPlan, limit: u32, samples: &[(i32, bool)]) -> Verdict {
    let window = &samples[plan.settle as usize..][..plan.window as usize];
    if !window.iter().any(|(_, contact)| *contact) {
        return Verdict::NoContact;
    }
    let n = window.len() as u128;
    let stable = is_below(scatter(window), (n * u128::from(limit)).pow(2));
    if stable { Verdict::Stable } else { Verdict::Unstable }
}

/// A limit near which the verdict changes. It is the RMS of the positions, or a random value near this RMS.
fn limit_near(window: &[(i32, bool)], off: i64) -> u32 {
    let n = window.len() as f64;
    let rms = (scatter(window) as f64).sqrt() / n * 65_536.0;
    ((rms.round() as i64).saturating_add(off)).clamp(65, i64::from(u32::MAX)) as u32
}

crate::properties! {
    /// The verdict of a hit comes exactly at the last sample of its window. This holds for an RMS below, at and above
    /// the limit, with contact and without. An early verdict equals the late verdict. Samples after the end change
    /// nothing.
    judged(1500, (samples, settle, off) in (positions(), 0u32..60, -2i64..=2)) {
        let settle = settle.min(samples.len() as u32 - 1);
        let window = samples.len() as u32 - settle;
        let limit = limit_near(&samples[settle as usize..], off);
        let plan = HitPlan { push: Force::ZERO, settle, window, limit: RmsLimit::from_bits(limit) };
        let expected = model(&plan, limit, &samples);
        let mut hit = Hit::new(plan);
        for (n, (position, contact)) in samples.iter().enumerate() {
            assert!(hit.certain_verdict().is_none_or(|early| early == expected), "early, at {n}");
            let said = hit.sample(Position::from_counts(*position), *contact);
            assert_eq!(said, (n + 1 == samples.len()).then_some(expected), "at {n}");
        }
        let judged = &samples[settle as usize..];
        let mean = judged.iter().map(|(x, _)| f64::from(*x)).sum::<f64>() / f64::from(window);
        let rms = (scatter(judged) as f64).sqrt() / f64::from(window);
        let scale = 1.0 + mean.abs();
        assert!((hit.scatter().mean_counts() - mean).abs() <= 1e-9 * scale);
        assert!((hit.scatter().rms_counts() - rms).abs() <= 1e-9 * (1.0 + rms));
        for (position, contact) in [(i32::MAX, true), (i32::MIN, false)] {
            assert_eq!(hit.sample(Position::from_counts(position), contact), Some(expected));
        }
    }

    /// If all positions are shifted by whole counts, or mirrored, the verdict is the same.
    moved_and_mirrored(500, (samples, by, limit) in (
        prop::collection::vec((-1_000_000i32..1_000_000, any::<bool>()), 1..100),
        -1_000_000_000i32..1_000_000_000,
        1u32..=u32::MAX,
    )) {
        let window = samples.len() as u32;
        let plan = HitPlan { push: Force::ZERO, settle: 0, window, limit: RmsLimit::from_bits(limit) };
        let of = |place: &dyn Fn(i32) -> i32| {
            let mut hit = Hit::new(plan);
            let said = samples.iter().map(|(x, contact)| hit.sample(Position::from_counts(place(*x)), *contact));
            said.last().flatten().unwrap()
        };
        let verdict = of(&|x| x);
        assert_eq!(of(&|x| x + by), verdict);
        assert_eq!(of(&|x| -x), verdict);
    }
}
