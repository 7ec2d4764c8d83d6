//! Likely causes of a residual that is larger than the model allows.

use super::{
    fit::Fitted,
    layout::{Layout, Parameter},
    search::{Model, Search},
    terms::{Term, said},
};
use crate::numerics::fft::RealSpectrum;

/// Smallest share of the residual that a named cause explains.
const NAMED_SHARE: f64 = 0.1;
/// Smallest share of the residual's power with which a frequency counts as a vibration.
const LINE_SHARE: f64 = 0.3;
/// Lowest frequency that counts as a vibration, in Hz.
const VIBRATION_HZ: f64 = 5.0;

/// The force of a possible cause. The arguments are the command, the position (measured from the reference) and the
/// speed.
type Force = fn(f64, f64, f64) -> f64;

/// Forces that `identify` recognises as causes, but cannot fit.
const FORCES: [(Force, &str); 3] = [
    (
        |command, _, _| command.powi(3),
        "an amplifier that is not linear (third power of the command)",
    ),
    (|_, _, speed| -speed * speed.abs(), "drag (square of the speed)"),
    (|_, x, speed| -x * speed.signum(), "friction that depends on the position"),
];

/// Direction of the force on a second mass. The arguments are speed and acceleration.
type Side = fn(f64, f64) -> f64;

/// Forces on the second mass behind a backlash: its damping, and its inertia.
const SIDES: [Side; 2] = [|speed, _| speed, |_, acceleration| acceleration];

/// Likely causes of what the model does not explain in the residual. The most likely cause comes first.
pub(super) fn likely(search: &Search<'_>, model: &Model) -> String {
    let all = model.solution.weighed_m.norm_squared();
    let mut causes: Vec<(f64, String)> = vec![];
    let mut add = |explained: Option<f64>, cause: String| {
        let share = explained.unwrap_or(0.0) / all;
        if share > NAMED_SHARE {
            causes.push((share, cause));
        }
    };
    for term in [Term::Friction, Term::Amplifier, Term::Phase] {
        if !term.is_in(model.layout().terms) {
            add(search.explains(term, model), said(term).into());
        }
    }
    if !search.options.fit_latency {
        let free = Layout { latency_s: None, ..*model.layout() };
        let explained = search.explains_by(free, Parameter::Latency, model);
        add(explained, "another latency (--fit-latency)".into());
    }
    for (force, cause) in FORCES {
        add(search.explains_force(force, model), cause.into());
    }
    let play = SIDES.iter().filter_map(|side| search.explains_play(side, model));
    add(play.reduce(f64::max), "backlash before a second mass".into());
    if let Some((share, hz)) = vibration(search.records, model) {
        let cause = format!("a flexible transmission or a second mass ({hz:.0} Hz)");
        add(Some(share * all), cause);
    }
    causes.sort_by(|a, b| b.0.total_cmp(&a.0));
    let named: Vec<String> = causes.into_iter().map(|(_, cause)| cause).collect();
    if named.is_empty() {
        return "none of what can be fitted; a stop, a hand, friction that is not Coulomb's?"
            .into();
    }
    named.join(", ")
}

/// The frequency that has the largest share of the residual's power, and this share. `None` if no frequency counts as a
/// vibration.
fn vibration(records: &[Fitted<'_>], model: &Model) -> Option<(f64, f64)> {
    let pieces = model.weighed.pieces();
    let (fitted, piece) = records.iter().zip(&pieces).max_by_key(|(fitted, _)| fitted.rows())?;
    let spectrum = RealSpectrum::new(piece.residual.len());
    let powers = spectrum.powers(piece.residual, 0..spectrum.length() / 2);
    let all: f64 = powers.iter().sum();
    let hz = |place: usize| place as f64 / (spectrum.length() as f64 * fitted.record.step_s);
    let place = (1..powers.len()).max_by(|a, b| powers[*a].total_cmp(&powers[*b]))?;
    // The line of a vibration in the spectrum is wide if the vibration decays fast. So the power within a tenth of the
    // frequency on both sides is added.
    let reach = (place / 10).max(2);
    let near = powers[place.saturating_sub(reach).max(1)..(place + reach).min(powers.len())].iter();
    let share = near.sum::<f64>() / all;
    (hz(place) > VIBRATION_HZ && share > LINE_SHARE).then(|| (share, hz(place)))
}
