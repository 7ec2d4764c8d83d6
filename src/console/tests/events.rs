//! What experiments say when they end.

use super::*;
use crate::{
    experiment::{AbortReason, CalibrationEnd, RunningVariance, Verdict},
    units::{Force, OutputCode},
};

/// Positions 10, 12, 14: mean 12, RMS sqrt(8/3).
fn window() -> RunningVariance {
    let mut window = RunningVariance::default();
    for counts in [10, 12, 14] {
        window.push(crate::units::Position::from_counts(counts));
    }
    window
}

#[test]
fn a_hit_says_its_verdict_or_why_there_is_none() {
    let mut bench = Bench::new(ARMED);
    for (verdict, name) in [
        (Verdict::Stable, "stable"),
        (Verdict::Unstable, "unstable"),
        (Verdict::NoContact, "no contact"),
    ] {
        bench.report(Event::HitOver(verdict, window()));
        let rms = Decimal(window().rms_counts() * 1e-6);
        let mean = Decimal(window().mean_counts() * 1e-6);
        assert_eq!(bench.take().0, [format!("ok hit {name}, rms {rms} m, mean {mean} m")]);
    }
    bench.report(Event::HitAborted(AbortReason::NotBack));
    let said = "error: hit: the handle did not come back to the start in time: is it held?";
    assert_eq!(bench.take().0, [said]);
}

#[test]
fn a_calibration_says_its_force_when_it_holds_and_when_it_is_over() {
    let mut bench = Bench::new(ARMED);
    bench.console.stored.full_scale_n = 5.0;
    let force = Force::saturating_from_bits(1 << 28);
    let record = Record { force, command: OutputCode(2560), ..Record::EMPTY };
    for (event, said) in [
        (Event::CalibrationHolds, "calibrate holds 25 %"),
        (
            Event::CalibrationOver(CalibrationEnd::Moved),
            "ok calibrate over: the handle moved, at 25 %",
        ),
    ] {
        let (status, activity) = (ARMED, Activity::Calibration);
        bench.console.report(&Report { record, streamed: record, status, activity, event });
        let said = format!("{said} of full scale, code 2560, 1.25 N with full scale 5 N");
        assert_eq!(bench.take().0, [said]);
    }
}
