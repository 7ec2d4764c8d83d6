//! Tests the lines that report the end of an experiment.

use super::*;
use crate::{
    experiment::{AbortReason, CalibrationEnd, RunningVariance, Verdict},
    units::{Force, OutputCode},
};

/// A window with the positions 10, 12 and 14. Their mean is 12, their RMS sqrt(8/3).
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
        // The energy is 2^40 LSB of force times counts. This is 1024 counts at full scale.
        let [taken, given] = [-1.0, 2.0].map(|part| Decimal(part * 1024.0 * (5.906 * 1e-6)));
        let said =
            format!("ok hit {name}, rms {rms} m, mean {mean} m, taken {taken} J, given {given} J");
        assert_eq!(bench.take().0, [said]);
    }
    bench.report(Event::HitAborted(AbortReason::NotBack));
    let said = "error: hit: the handle did not come back to the start in time: is it held?";
    assert_eq!(bench.take().0, [said]);
    bench.report(Event::PulsesOver(Ok(())));
    assert_eq!(bench.take().0, ["ok pulses over"]);
    bench.report(Event::PulsesOver(Err(AbortReason::Off)));
    assert_eq!(bench.take().0, ["error: pulses: the force went off: see status and faults"]);
}

#[test]
fn a_calibration_says_its_force_when_it_holds_and_when_it_is_over() {
    let mut bench = Bench::new(ARMED);
    bench.console.stored.change(|stored| stored.full_scale_n = 5.0);
    let force = Force::saturating_from_bits(1 << 28);
    let record = Record { force, command: OutputCode(2560), ..Record::EMPTY };
    for (event, said) in [
        (Event::CalibrationHolds, "calibrate holds 25 %"),
        (
            Event::CalibrationOver(CalibrationEnd::Moved),
            "ok calibrate over: the handle moved, at 25 %",
        ),
    ] {
        (bench.status, bench.activity) = (ARMED, Activity::Calibration);
        bench.tell(record, event);
        let said = format!("{said} of full scale, code 2560, 1.25 N with full scale 5 N");
        assert_eq!(bench.take().0, [said]);
    }
}

/// Outputs that are closer than a millisecond share a frame. An output begins a new frame if it does not directly
/// follow the last output, or has other settings or another fault. With a long period, each output is sent at once.
#[test]
fn outputs_of_a_millisecond_share_a_frame() {
    use crate::telemetry::Decoder;
    let mut bench = Bench::new(OFF);
    bench.console.port.frames.clear();
    let send = |bench: &mut Bench, samples: &[u64], settings: u16, fault: u8| {
        for &sample in samples {
            let record = Record { sample, settings, fault, ..Record::EMPTY };
            bench.tell(record, Event::None);
        }
    };
    let frames = |bench: &mut Bench| {
        let mut decoder = Decoder::new();
        let mut found: Vec<(u8, Vec<u64>)> = Vec::new();
        for frame in std::mem::take(&mut bench.console.port.frames) {
            let version = frame[2];
            for byte in frame {
                if let Some(frame) = decoder.push(byte) {
                    let samples = decoder.outputs(frame).map(|frame| frame.record.sample);
                    found.push((version, samples.collect()));
                }
            }
        }
        assert_eq!((decoder.dropped, decoder.garbage), (0, 0));
        found
    };
    send(&mut bench, &[0, 10, 20], 1, 0);
    assert_eq!(frames(&mut bench), [0, 10, 20].map(|n| (2, std::vec![n])));
    bench.console.stored.change(|stored| stored.period = 2);
    send(&mut bench, &[30, 32, 34, 36, 38, 40], 1, 0);
    assert_eq!(frames(&mut bench), [(2, std::vec![30, 32, 34, 36, 38])]);
    send(&mut bench, &[42], 2, 0);
    send(&mut bench, &[44, 46], 2, 20);
    send(&mut bench, &[50, 70], 2, 20); // some are missing
    bench.console.stored.change(|stored| stored.period = 10);
    send(&mut bench, &[80, 90], 2, 20);
    let expected: [(u8, &[u64]); 6] =
        [(2, &[40]), (2, &[42]), (2, &[44, 46]), (2, &[50]), (2, &[70, 80]), (2, &[90])];
    let expected = expected.map(|(version, samples)| (version, samples.to_vec()));
    assert_eq!(frames(&mut bench), expected);
    bench.console.stored.change(|stored| stored.period = 1);
    let all: Vec<u64> = (100..120).collect();
    send(&mut bench, &all, 2, 20);
    let halves = [(2, all[..10].to_vec()), (2, all[10..].to_vec())];
    assert_eq!(frames(&mut bench), halves);
}
