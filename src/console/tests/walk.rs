//! Tests all orders of a walk, and all ways in which it can end.

use super::*;
use crate::experiment::{AbortReason, RunningVariance, Verdict};

const START: &str = "ok walk";
const NO_RESULT: &str = "area 0 N^2 s/m^2, peak k 0 N/m, largest b 0 N s/m";

/// A bench on which a walk has just begun. Its grid has K 1000 and 2000 N/m, and B 10 and 20 N s/m.
fn begun() -> Bench {
    let mut bench = Bench::new(FREE);
    for line in ["kstart 1000", "kstep 1000", "kmax 2000", "bstart 10", "bstep 10", "bmax 20"] {
        assert!(bench.says(line).starts_with("ok "));
    }
    assert_eq!(bench.says("walk"), START);
    bench
}

#[track_caller]
fn next(bench: &mut Bench) -> Order {
    bench.console.pass(true);
    let (lines, orders) = bench.take();
    assert!(lines.is_empty() && orders.len() == 1, "{lines:?} {orders:?}");
    orders[0]
}

/// Checks that the wall of a cell is ordered, then its hit. Accepts both orders.
#[track_caller]
fn cell(bench: &mut Bench, k: f64, b: f64) {
    let mut stored = bench.stored();
    stored.settings.wall.stiffness_n_per_m = k;
    stored.settings.wall.damping_n_s_per_m = b;
    assert_eq!(next(bench), DEVICE.order(&stored).unwrap());
    assert!(bench.answer(Ok(())).is_empty());
    let hit = DEVICE.hit_sequence(&stored, true).unwrap();
    assert_eq!(next(bench), Order::Hit(hit));
    assert!(bench.answer(Ok(())).is_empty());
    // The console gives no further order before the verdict.
    bench.console.pass(true);
    assert_eq!(bench.take(), (Vec::new(), Vec::new()));
}

fn judge(bench: &mut Bench, verdict: Verdict) -> Vec<String> {
    bench.report(Event::HitOver(verdict, RunningVariance::default()));
    bench.take().0
}

/// Checks the end of a walk. The stored wall is ordered again, without a reply, and commands are obeyed again.
#[track_caller]
fn over(bench: &mut Bench) {
    assert_eq!(next(bench), DEVICE.order(&bench.stored()).unwrap());
    assert!(bench.answer(Ok(())).is_empty());
    assert_eq!(bench.says("push 1"), "ok push 1 N");
}

#[test]
fn a_walk_sets_wall_and_hit_of_each_cell_and_ends_with_its_totals() {
    let mut bench = begun();
    cell(&mut bench, 1000.0, 10.0);
    assert_eq!(
        judge(&mut bench, Verdict::Stable),
        ["walk hit 1: k 1000 N/m, b 10 N s/m, stable, rms 0 m"]
    );
    cell(&mut bench, 2000.0, 10.0);
    assert_eq!(
        judge(&mut bench, Verdict::Unstable),
        [
            "walk hit 2: k 2000 N/m, b 10 N s/m, unstable, rms 0 m",
            "walk boundary 1: k 1000 N/m, b 10 N s/m"
        ]
    );
    cell(&mut bench, 1000.0, 20.0);
    judge(&mut bench, Verdict::Stable);
    cell(&mut bench, 2000.0, 20.0);
    assert_eq!(
        judge(&mut bench, Verdict::Unstable),
        [
            "walk hit 4: k 2000 N/m, b 20 N s/m, unstable, rms 0 m",
            "walk boundary 2: k 1000 N/m, b 20 N s/m",
            "ok walk over, area 20000 N^2 s/m^2, peak k 1000 N/m, largest b 20 N s/m, hits 4, \
             points 2, ended by damping_max"
        ]
    );
    over(&mut bench);
}

#[test]
fn while_it_goes_on_what_it_sets_is_busy_and_the_rest_is_said() {
    let mut bench = begun();
    cell(&mut bench, 1000.0, 10.0);
    for line in ["k 5", "b 5", "push 1", "kstep 5", "wall 0.05", "hit", "walk"] {
        assert_eq!(bench.says(line), "error: an experiment is running: stop first", "{line}");
    }
    assert!(bench.says("status").contains(", walk, "));
}

#[test]
fn a_verdict_that_leads_nowhere_ends_it_and_says_what_helps() {
    for (verdict, why) in [
        (Verdict::Unstable, "the first point is unstable: lower kstart or bstart"),
        (Verdict::NoContact, "the push does not bring the handle to the wall: raise push"),
    ] {
        let mut bench = begun();
        cell(&mut bench, 1000.0, 10.0);
        let said = judge(&mut bench, verdict);
        let end = format!("error: walk: {why}, {NO_RESULT}, hits 1, points 0");
        assert_eq!((said.len(), said[1].as_str()), (2, end.as_str()));
        over(&mut bench);
    }
}

/// The line that ends a walk before its first verdict.
fn aborted(why: &str) -> String {
    format!("error: walk: {why}, {NO_RESULT}, hits 0, points 0")
}

#[test]
fn stop_ends_it_at_any_moment() {
    for steps in 0..3 {
        let mut bench = begun();
        match steps {
            0 => {}
            1 => {
                next(&mut bench);
                bench.console.port.typed.extend(*b"stop\n");
                // the order for the wall is accepted first
                bench.console.pass(true);
                assert!(bench.take().1.is_empty());
                bench.answer(Ok(()));
                next(&mut bench);
                bench.answer(Ok(()));
                bench.console.pass(true);
                assert_eq!(bench.take().1, [Order::Stop]);
            }
            _ => cell(&mut bench, 1000.0, 10.0),
        }
        if steps == 0 {
            cell(&mut bench, 1000.0, 10.0);
        }
        if steps != 1 {
            assert_eq!(bench.orders("stop"), Order::Stop);
        }
        assert_eq!(bench.answer(Ok(())), [aborted("stopped"), "ok stop".into()]);
        over(&mut bench);
    }
}

#[test]
fn a_hit_without_a_verdict_ends_it() {
    let mut bench = begun();
    cell(&mut bench, 1000.0, 10.0);
    bench.report(Event::HitAborted(AbortReason::TooWarm));
    let why = "the motor does not cool down: does the handle rest in a wall?";
    assert_eq!(bench.take().0, [aborted(why)]);
    over(&mut bench);
}

#[test]
fn an_order_that_is_refused_ends_it() {
    for hit in [false, true] {
        let mut bench = begun();
        next(&mut bench);
        if hit {
            bench.answer(Ok(()));
            next(&mut bench);
        }
        assert_eq!(
            bench.answer(Err(Refusal::Contact)),
            [aborted("in contact: leave the wall first")]
        );
        over(&mut bench);
    }
}

#[test]
fn force_that_goes_off_between_two_hits_ends_it() {
    let mut bench = begun();
    bench.status = OFF;
    bench.report(Event::None);
    bench.console.pass(true);
    let (lines, orders) = bench.take();
    assert_eq!(lines, [aborted("the force went off: see status and faults")]);
    assert!(orders.is_empty());
    over(&mut bench);
}

#[test]
fn a_wall_or_hit_that_cannot_be_built_ends_it() {
    let mut bench = begun();
    bench.console.stored.change(|stored| stored.settings.wall.position_m = f64::NAN);
    bench.console.pass(true);
    let (lines, orders) = bench.take();
    assert!(lines[0].starts_with("walk: position_m is "), "{lines:?}");
    assert_eq!((&lines[1..], orders.len()), (&[aborted("a wall is out of range")][..], 0));
    let mut bench = begun();
    next(&mut bench);
    bench.answer(Ok(()));
    bench.console.stored.change(|stored| stored.settle_s = -1.0);
    bench.console.pass(true);
    assert_eq!(bench.take().0, [aborted("a setting is out of range")]);
}

#[test]
fn a_walk_that_could_not_run_is_not_begun() {
    let mut bench = Bench::new(FREE);
    bench.console.stored.change(|stored| stored.grid.stiffness_step_n_per_m = -1.0);
    assert!(bench.says("walk").starts_with("error: stiffness_step_n_per_m is -1, allowed "));
    let mut bench = Bench::new(FREE);
    bench.console.stored.change(|stored| stored.start_m = 0.09);
    assert!(bench.says("walk").starts_with("error: start_m is 0.09, allowed "));
    // each setting can be changed, wherever the wall is
    for line in ["push 1.5", "kstart 1000", "settle 3", "start 0"] {
        assert!(bench.says(line).starts_with("ok "), "{line}");
    }
    bench.console.stored.change(|stored| stored.settings.wall.position_m = -0.05);
    let refused = bench.says("walk");
    assert!(refused.starts_with("error: position_m is -0.05, allowed -0.039999 to "), "{refused}");
}

#[test]
fn a_walk_that_nobody_reads_ends_and_says_so_once_somebody_does() {
    let mut bench = begun();
    cell(&mut bench, 1000.0, 10.0);
    bench.console.port.deaf = true;
    judge(&mut bench, Verdict::Stable);
    bench.console.pass(true); // it ends
    assert!(bench.take().1.is_empty());
    bench.console.pass(true); // the stored wall
    assert_eq!(bench.take().1, [DEVICE.order(&bench.stored()).unwrap()]);
    bench.answer(Ok(()));
    bench.console.port.deaf = false;
    for _ in 0..64 {
        bench.console.pass(true);
    }
    let (lines, _) = bench.take();
    assert!(lines[0].starts_with("walk hit 1"), "{lines:?}");
    let end = format!("error: walk: nobody read its results, {NO_RESULT}, hits 1, points 0");
    assert_eq!(lines[1..], [end]);
}

#[test]
fn a_walk_that_nobody_has_begun_gives_no_order() {
    for in_walk in [true, false] {
        let mut bench = Bench::new(FREE);
        bench.console.damage(in_walk);
        for _ in 0..3 {
            bench.console.pass(true);
            bench.report(Event::None);
        }
        let (lines, orders) = bench.take();
        assert!(orders.is_empty() && lines.is_empty(), "{in_walk}: {lines:?}");
        // No walk is running any more, and a new walk can begin.
        assert!(bench.says("walk").starts_with("ok walk"));
    }
}
