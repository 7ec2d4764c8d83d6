//! Force calibration.

use proptest::prelude::*;
use zwidth::{
    Design,
    experiment::{Calibration, CalibrationEnd, CalibrationSettings},
    units::{Force, Position},
};

use crate::any;

/// Settings of a calibration that are accepted. Percent, rise and hold are at these fractions of their ranges.
fn settings(design: &Design, percent: f64, rise: f64, hold: f64) -> CalibrationSettings {
    CalibrationSettings {
        percent,
        rise_percent_per_s: any::between(0.1, 100.0, rise),
        hold_s: any::between(1.0, 60.0, hold),
        travel_m: 50.0 * design.resolution_m,
    }
}

crate::properties! {
    /// A calibration's force rises at most at its set rate and reaches each new force. The force never exceeds the
    /// larger of the old and the new force. If the sign of the percent changes, so does the sign of the force. A
    /// calibration ends at the first of these events: the handle touches the wall, the handle moves, the force was held
    /// for the set time, two minutes have passed.
    bounded(150, (design, rise, hold, targets, moves) in (
        any::design(),
        any::part(),
        any::part(),
        prop::collection::vec((-30.0..=30.0f64, 1u16..2000), 1..6),
        prop::option::of((1u16..3000, prop::bool::ANY)),
    )) {
        let output_s = f64::from(design.period) / design.rate_hz;
        let plan = |percent: f64| settings(&design, percent, rise, hold).build(&design).unwrap();
        let (mut one, mut other) = (Calibration::new(plan(targets[0].0)), Calibration::new(plan(-targets[0].0)));
        let says = settings(&design, 0.0, rise, hold);
        let per_output = says.rise_percent_per_s * output_s / 100.0 + 2f64.powi(-30);
        let largest = targets.iter().map(|(percent, _)| percent.abs()).fold(0.0, f64::max) / 100.0;
        let (mut last, mut outputs) = (0.0f64, 0u32);
        for (percent, asked) in &targets {
            one.retarget(plan(*percent));
            other.retarget(plan(-percent));
            let mut held = 0u32;
            for _ in 0..*asked {
                let moved = moves.filter(|(at, _)| u32::from(*at) == outputs);
                let contact = moved.is_some_and(|(_, contact)| contact);
                let counts = if moved.is_some_and(|(_, contact)| !contact) { 51 } else { (outputs % 3) as i32 };
                let [force, mirrored] =
                    [(&mut one, counts), (&mut other, -counts)].map(|(run, at)| run.output(Position::from_counts(at), contact));
                outputs += 1;
                let force = match force {
                    Ok(force) => force,
                    Err(end) => {
                        assert_eq!(mirrored, Err(end));
                        let over = f64::from(held) * output_s >= says.hold_s - output_s
                            || f64::from(outputs) * output_s >= 120.0 - output_s;
                        match end {
                            CalibrationEnd::Contact => assert!(contact),
                            CalibrationEnd::Moved => assert!(counts > 50),
                            CalibrationEnd::TimeUp => assert!(over, "{held} of {outputs} outputs"),
                            CalibrationEnd::Off => panic!("nobody switched off"),
                        }
                        return Ok(());
                    }
                };
                assert!(!contact && counts <= 50);
                assert_eq!(mirrored, Ok(Force::saturating_from_bits(-force.bits())));
                let part = f64::from(force.bits()) / f64::from(1 << 30);
                assert!((part - last).abs() <= per_output, "{part} after {last}");
                assert!(part.abs() <= largest && largest <= 0.3);
                let there = (part - percent / 100.0).abs() <= 2f64.powi(-30);
                held = if there { held + 1 } else { 0 };
                assert!(f64::from(held) * output_s <= says.hold_s + 2.0 * output_s);
                assert!(f64::from(outputs) * output_s <= 120.0 + 2.0 * output_s);
                // On the way to the new force, the force never stops changing and never reverses.
                assert!(there || (percent / 100.0 - last) * (part - last) > 0.0);
                last = part;
            }
        }
    }
}
