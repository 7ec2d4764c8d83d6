//! Tests the console of a rotary device. Typed and printed values are about its axis. The values in orders are at the
//! handle.

use super::*;
use crate::{
    experiment::{CalibrationEnd, RunningVariance, Verdict},
    safety::envelope::Envelope,
};
use std::sync::LazyLock;

/// The radius is a quarter of a metre, because its powers are exact.
static PADDLE: LazyLock<Device<'static>> =
    LazyLock::new(|| Device { radius_m: 0.25, envelope: Envelope::EMPTY, ..*DEVICE });

#[test]
fn settings_are_typed_about_the_axis_and_ordered_at_the_handle() {
    let mut bench = Bench::on(&PADDLE, FREE);
    for (line, said, at_handle) in
        [("k 100", "ok k 100 N m/rad", 1600.0), ("b 1", "ok b 1 N m s/rad", 16.0)]
    {
        bench.orders(line);
        assert_eq!(bench.answer(Ok(())), [said]);
        let wall = bench.stored().settings.wall;
        assert!([wall.stiffness_n_per_m, wall.damping_n_s_per_m].contains(&at_handle), "{line}");
    }
    bench.orders("wall 0.2");
    assert_eq!(bench.answer(Ok(())), ["ok wall 0.2 rad"]);
    assert_eq!(bench.stored().settings.wall.position_m, 0.05);
    for (line, said) in [
        ("push 0.5", "ok push 0.5 N m"),
        ("start 0.04", "ok start 0.04 rad"),
        ("rms 0.0001", "ok rms 0.0001 rad"),
        ("kstep 125", "ok kstep 125 N m/rad"),
        ("bmax 10", "ok bmax 10 N m s/rad"),
        ("settle 3", "ok settle 3 s"),
    ] {
        assert_eq!(bench.says(line), said);
    }
    let stored = bench.stored();
    assert_eq!([stored.push_n, stored.start_m, stored.rms_limit_m], [2.0, 0.01, 2.5e-5]);
    assert_eq!(
        (stored.grid.stiffness_step_n_per_m, stored.grid.damping_max_n_s_per_m),
        (2000.0, 160.0)
    );
    assert_eq!(
        bench.says("get"),
        "ok get k 100 N m/rad, b 1 N m s/rad, wall 0.2 rad, cutoff 1500 Hz, estimator butterworth, push 0.5 N m, \
         push only, device bench, motor +, encoder +, full scale 1.4765 N m, start 0.04 rad, settle 3 s, window 2 s, \
         rms 0.0001 rad, criterion rms, walk k 125 step 125 to 625000 N m/rad, b 0.625 step 0.625 to 10 N m s/rad, period 10 samples"
    );
}

#[test]
fn refusals_and_usages_are_about_the_axis() {
    let mut bench = Bench::on(&PADDLE, FREE);
    assert_eq!(
        bench.says("k 700000"),
        "error: stiffness_n_m_per_rad is 700000, allowed 0 to 625000"
    );
    assert_eq!(bench.says("push 2"), "error: push_n_m is 2, allowed -1.4765 to 1.4765");
    assert_eq!(bench.says("wall"), "error: something is missing: wall RADIANS");
    assert!(bench.says("k x").ends_with(": k N_M_PER_RAD"));
    let help = bench.says("help");
    assert!(help.contains("push NEWTON_METRES") && !help.contains(" METRES"), "{help}");
}

#[test]
fn experiments_are_told_about_the_axis() {
    let mut bench = Bench::on(&PADDLE, FREE);
    let mut window = RunningVariance::default();
    for counts in [999, 1001] {
        window.push(Position::from_counts(counts));
    }
    bench.report(Event::HitOver(Verdict::Stable, window));
    assert_eq!(
        bench.take().0,
        [
            "ok hit stable, rms 0.000004 rad, mean 0.004 rad, taken -0.006047744 J, given 0.012095488 J"
        ]
    );
    bench.report(Event::CalibrationOver(CalibrationEnd::Moved));
    let said = bench.take().0;
    assert!(said[0].ends_with("0 N m with full scale 1.4765 N m"), "{said:?}");
    for line in ["kstart 100", "kstep 100", "kmax 200", "bstart 1", "bstep 1", "bmax 2"] {
        assert!(bench.says(line).starts_with("ok "), "{line}");
    }
    assert_eq!(bench.says("walk"), "ok walk");
    bench.console.pass(true);
    bench.take();
    bench.answer(Ok(()));
    bench.console.pass(true);
    bench.take();
    bench.answer(Ok(()));
    bench.report(Event::HitOver(Verdict::Unstable, window));
    let said = bench.take().0;
    assert_eq!(said[0], "walk hit 1: k 100 N m/rad, b 1 N m s/rad, unstable, rms 0.000004 rad");
    let over = "area 0 N^2 m^2 s/rad^2, peak k 0 N m/rad, largest b 0 N m s/rad";
    assert!(said[1].contains(over), "{said:?}");
}
