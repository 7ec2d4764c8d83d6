//! Tests hits and walks with the criterion `quiet`. A hit has several pushes, one after the other. The counts, the
//! force and the wall of each push are judged.
//!
//! The device has counts of 1 um, a DAC of 12 bits and 5.906 N at full scale; the wall of these tests is at 0.07 m.

use super::*;
use crate::experiment::{RunningVariance, Verdict, quiet::PUSHES};

const PUSH_N: f64 = 2.0;
const K: f64 = 50_000.0;
const CODE_N: f64 = 5.906 / 2047.0;

/// A bench that is armed, with the wall at 0.07 m and the criterion `quiet`.
fn bench() -> Bench {
    let mut bench = Bench::new(FREE);
    bench.console.stored.change(|stored| {
        stored.settings.wall.stiffness_n_per_m = K;
        stored.settings.wall.damping_n_s_per_m = 10.0;
    });
    for (line, said) in [
        ("push 2", "ok push 2 N"),
        ("criterion quiet", "ok criterion quiet"),
        ("force_rms 0.1", "ok force_rms 0.1 N"),
    ] {
        assert_eq!(bench.says(line), said);
    }
    bench
}

/// The counts and codes of a handle that rests in the wall at 0.07 m, pushed by `push_n`. The codes vary by `swing`.
fn window(push_n: f64, swing: i32) -> [RunningVariance; 2] {
    let [mut counts, mut codes] = [RunningVariance::default(); 2];
    let behind = DEVICE.design.position("position_m", push_n / K).unwrap().counts();
    for sign in [-1, 1] {
        counts.push(Position::from_counts(70_000 + behind));
        codes.push_number(2048 + sign * swing);
    }
    [counts, codes]
}

fn over(bench: &mut Bench, verdict: Verdict, [counts, codes]: [RunningVariance; 2]) -> Vec<String> {
    bench.report(Event::HitOver(verdict, counts));
    bench.report(Event::HitCodes(codes));
    bench.take().0
}

/// Lets the console order the hit with this push. The hit is accepted, and reports the verdict and codes that vary by
/// `swing`.
#[track_caller]
fn pushed(bench: &mut Bench, share: f64, (verdict, swing): (Verdict, i32)) -> Vec<String> {
    let push_n = share * PUSH_N;
    let stored = Stored { push_n, ..bench.stored() };
    bench.console.pass(true);
    let plan = DEVICE.hit_sequence(&stored, false).unwrap();
    assert_eq!(bench.take(), (Vec::new(), std::vec![Order::Hit(plan)]));
    assert!(bench.answer(Ok(())).is_empty());
    over(bench, verdict, window(push_n, swing))
}

fn force_rms(line: &str) -> f64 {
    let (_, rest) = line.split_once("force rms ").unwrap();
    rest.split(' ').next().unwrap().parse().unwrap()
}

#[test]
fn a_quiet_hit_tries_four_pushes_and_says_the_loudest() {
    let mut bench = bench();
    assert_eq!(bench.says("hit"), "ok hit");
    for (n, (share, swing)) in PUSHES.into_iter().zip([2, 4, 3]).enumerate() {
        let said = pushed(&mut bench, share, (Verdict::Stable, swing));
        let head = format!("hit push {}: {} N, stable, rms 0 m, force rms ", n + 1, share * PUSH_N);
        assert!(said.len() == 1 && said[0].starts_with(&head), "{said:?}");
        assert!((force_rms(&said[0]) - f64::from(swing) * CODE_N).abs() < 1e-9, "{said:?}");
    }
    let said = pushed(&mut bench, PUSHES[3], (Verdict::Stable, 1));
    assert!(
        said.len() == 2 && said[1].starts_with("ok hit stable, rms 0 m, mean 0.07004 m, taken ")
    );
    assert!((force_rms(&said[1]) - 4.0 * CODE_N).abs() < 1e-9, "{said:?}");
    // and no further order
    bench.console.pass(true);
    assert_eq!(bench.take(), (Vec::new(), Vec::new()));
    assert_eq!(bench.says("push 1"), "ok push 1 N");
}

/// The limit is 0.1 N here. A swing of 34 codes is below it, one of 35 codes is above it.
#[test]
fn a_push_with_too_much_force_ends_it() {
    for (swing, held) in [(34, true), (35, false)] {
        let mut bench = bench();
        bench.says("hit");
        pushed(&mut bench, PUSHES[0], (Verdict::Stable, 1));
        let said = pushed(&mut bench, PUSHES[1], (Verdict::Stable, swing));
        assert_eq!(said.len(), if held { 1 } else { 2 }, "{said:?}");
        assert_eq!(said[0].contains("N, stable, "), held, "{said:?}");
        assert_eq!(said.last().unwrap().starts_with("ok hit unstable, "), !held, "{said:?}");
    }
}

#[test]
fn without_a_limit_of_its_own_it_is_a_share_of_the_push_that_was_set() {
    // The limit is 0.14 N here. A swing of 48 codes is below it, one of 49 codes is above it, also with 0.97 of the
    // push.
    for (swing, held) in [(48, true), (49, false)] {
        let mut bench = bench();
        assert_eq!(bench.says("force_rms 0"), "ok force_rms 0 N");
        bench.says("hit");
        let said = pushed(&mut bench, PUSHES[0], (Verdict::Stable, swing));
        assert_eq!(said[0].contains("N, stable, "), held, "{said:?}");
    }
}

#[test]
fn a_wall_that_does_not_stand_is_unstable_and_one_without_contact_stays_that() {
    let mut bench = bench();
    bench.says("hit");
    bench.console.pass(true);
    bench.take();
    bench.answer(Ok(()));
    let (mut sunk, [_, codes]) = (RunningVariance::default(), window(0.97 * PUSH_N, 0));
    sunk.push(Position::from_counts(70_050));
    let said = over(&mut bench, Verdict::Stable, [sunk, codes]);
    assert!(said[0].contains("N, unstable, ") && said[0].contains(", ratio 1.2"), "{said:?}");
    assert!(said[1].starts_with("ok hit unstable, "), "{said:?}");
    bench.says("hit");
    let said = pushed(&mut bench, PUSHES[0], (Verdict::NoContact, 0));
    assert!(said[1].starts_with("ok hit no contact, "), "{said:?}");
}

#[test]
fn it_can_be_stopped_and_ends_with_the_force() {
    let mut stopped = bench();
    stopped.says("hit");
    pushed(&mut stopped, PUSHES[0], (Verdict::Stable, 1));
    stopped.console.pass(true);
    stopped.answer(Ok(()));
    stopped.take();
    for line in ["k 10", "push 1", "criterion rms", "hit", "walk"] {
        assert_eq!(stopped.says(line), "error: an experiment is running: stop first");
    }
    stopped.type_in("stop");
    assert_eq!(stopped.answer(Ok(())), ["error: hit: stopped", "ok stop"]);
    stopped.console.pass(true);
    assert_eq!(stopped.take(), (Vec::new(), Vec::new()));

    let mut off = bench();
    off.says("hit");
    pushed(&mut off, PUSHES[0], (Verdict::Stable, 1));
    off.status = OFF;
    off.report(Event::None);
    off.console.pass(true);
    let (said, orders) = off.take();
    assert_eq!(said, ["error: hit: the force went off: see status and faults"]);
    assert!(orders.is_empty());
}

#[test]
fn a_push_that_the_largest_of_them_would_not_fit_is_refused() {
    let mut bench = bench();
    assert_eq!(
        bench.says("push 5.8"),
        "error: push_n is 5.8, allowed -5.73398058252 to 5.73398058252"
    );
    assert_eq!(bench.says("criterion rms"), "ok criterion rms");
    assert_eq!(bench.says("push 5.8"), "ok push 5.8 N");
    assert!(bench.says("criterion quiet").starts_with("error: push_n is 5.8"));
    assert!(
        bench.says("force_rms 6").starts_with("error: force_rms_limit_n is 6, allowed 0 to 5.906")
    );
    assert!(bench.says("get").contains(", criterion rms, force rms 0.1 N, "));
}

#[test]
fn a_walk_tries_every_push_of_a_cell_before_it_goes_on() {
    let mut bench = bench();
    for line in ["kstart 50000", "kstep 50000", "kmax 100000", "bstart 10", "bstep 10", "bmax 10"] {
        assert!(bench.says(line).starts_with("ok "));
    }
    assert_eq!(bench.says("walk"), "ok walk");
    let mut ordered = 0;
    for (n, share) in PUSHES.into_iter().enumerate() {
        bench.console.pass(true);
        let orders = bench.take().1;
        ordered += orders.len();
        bench.answer(Ok(()));
        if n == 0 {
            // the wall was ordered first
            bench.console.pass(true);
            ordered += bench.take().1.len();
            bench.answer(Ok(()));
        }
        let said = over(&mut bench, Verdict::Stable, window(share * PUSH_N, 1));
        assert_eq!(said.len(), usize::from(n == 3), "{said:?}");
        if n == 3 {
            let head = "walk hit 1: k 50000 N/m, b 10 N s/m, stable, rms 0 m, force rms ";
            assert!(said[0].starts_with(head), "{said:?}");
        }
    }
    assert_eq!(ordered, 5);
}
