//! Grey-box identification of a device from recorded voltage and position (paper, section 2.2.2).
//!
//! ```text
//! Record(s) -> checks -> guess -> fit -> residual, confidence -> checks -> Identification
//! m x'' + b x' + k (x - x0) = gain u        eq. (6); u held between rows, late by the latency
//! ```
//! Mass, damping, stiffness, rest position and the initial state of each record are fitted. If a second record has a
//! known added mass, the gain is fitted too. The latency is fitted on request. A quantiser that rounds down has a mean
//! error of half a count, which is corrected. The intervals include what is left of this error
//! (`residual`). A record without sufficient information is refused with the reason. `docs/identification.md` is the
//! page for users.

mod asked;
mod checks;
mod cogs;
mod columns;
mod confidence;
mod cycle;
mod fit;
mod gain;
mod guess;
mod joint;
mod json;
mod layout;
mod made;
mod misfit;
mod missing;
mod model;
mod motion;
mod plan;
mod planned;
mod record;
mod residual;
mod rotary;
mod search;
mod starts;
mod telemetry;
mod terms;
#[cfg(test)]
mod tests;
mod weighting;
mod widen;

pub use asked::{Asked, GainAsked, check, identify_in, read, read_all};
pub use columns::Drive;
pub use confidence::{CONFIDENCE, Estimate};
pub use gain::Gain;
pub use joint::Joint;
pub use json::Json;
pub use made::Made;
pub use plan::Pulse;
pub use planned::Planned;
pub use record::{FEWEST_ROWS, Record, Span};
pub use residual::Residual;
pub use telemetry::{OutputScale, from_capture, from_capture_csv};
pub use terms::{Cogging, FAMILY_P, Found, Phase, Stribeck, Term, Terms, Tested};

use std::{f64::consts::TAU, sync::atomic::AtomicBool};

use crate::scene::{Rounding, Scene};
use fit::{Fitted, Problem};
use layout::{Included, Layout, Parameter, Values};
use misfit::Misfit;
use residual::Weighed;
use search::{Model, Search};
use weighting::Weighting;

/// Time by which the fit begins later in the record if the latency is fitted, in s.
const LATENCY_ROOM_S: f64 = 0.01;
/// Largest residual that is no outlier, as a multiple of the RMS. Gaussian noise is above it in one of 10^10 rows.
const OUTLIER: f64 = 6.5;

/// What is known before an identification, and its options.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    pub gain: Gain,
    /// Time until the voltage of a row acts, in s. If the latency is fitted, the fit begins with this value.
    pub latency_s: f64,
    pub fit_latency: bool,
    pub spring: bool,
    /// Size of a count in m; 0 for a sensor without counts.
    pub resolution_m: f64,
    pub rounding: Rounding,
    /// Largest magnitude of a command, in V.
    pub limit_v: f64,
    /// Terms that are fitted in addition to mass, damping and spring.
    pub terms: Terms,
    /// Position at which the spring rests if no other force acts, in m. If it is `None`, the fitted x0 includes the
    /// effect of a constant force.
    pub rest_position_m: Option<f64>,
    /// Distance over which the encoder's signals repeat, in m; `None` if it is not known.
    pub cycle_m: Option<f64>,
}

impl Options {
    /// Mean error of a quantiser that rounds down, in m.
    fn half_count_m(&self) -> f64 {
        match self.rounding {
            Rounding::Floor => 0.5 * self.resolution_m,
            Rounding::Round => 0.0,
        }
    }

    /// Options with the scene's latency, encoder and voltage limit.
    pub fn of_scene(scene: &Scene, gain: Gain) -> Self {
        Self {
            gain,
            latency_s: scene.actuator.latency / scene.control.rate_hz,
            fit_latency: false,
            spring: true,
            resolution_m: scene.encoder.resolution_m,
            rounding: scene.encoder.rounding,
            limit_v: scene.actuator.limit_v,
            terms: Terms::Auto,
            rest_position_m: None,
            cycle_m: scene.encoder_error.map(|error| error.cycle_m),
        }
    }
}

/// The measured position of one record and the position of the model, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// First row of the record that is fitted.
    pub first: usize,
    /// Position of the model in m, from the first fitted row on.
    pub model_m: Vec<f64>,
    /// Measured position minus position of the model, in m. The quantiser's offset of half a count is removed first.
    pub residual_m: Vec<f64>,
    /// Position of the model at the first fitted row, in m.
    pub position_m: f64,
    /// Speed of the model at the first fitted row, in m/s.
    pub speed_m_per_s: f64,
}

impl Fit {
    /// A fit from measured positions and residuals. Positions are measured from `reference_m`.
    fn new(
        first: usize,
        (measured, residual_m): (&[f64], &[f64]),
        [x, speed_m_per_s]: [f64; 2],
        reference_m: f64,
    ) -> Self {
        let model = measured.iter().zip(residual_m).map(|(x, left)| x - left + reference_m);
        Self {
            first,
            model_m: model.collect(),
            residual_m: residual_m.to_vec(),
            position_m: x + reference_m,
            speed_m_per_s,
        }
    }

    /// Root mean square of the residual, in m.
    pub fn rms_m(&self) -> f64 {
        let squares = self.residual_m.iter().map(|left| left * left).sum::<f64>();
        (squares / self.residual_m.len() as f64).sqrt()
    }

    /// Five values for each fitted row: time, voltage, measured position, position of the model, and the difference of
    /// the positions.
    pub fn rows(&self, record: &Record) -> impl Iterator<Item = [f64; 5]> {
        let both = self.model_m.iter().zip(&self.residual_m);
        (self.first..).zip(both).map(|(row, (model_m, residual_m))| {
            let (volts, position_m) = (record.command[row], record.position_m[row]);
            [record.time_s(row), volts, position_m, *model_m, *residual_m]
        })
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct Identification {
    pub drive: Drive,
    pub mass_kg: Estimate,
    pub damping_n_s_per_m: Estimate,
    /// The spring's k in N/m and x0 in m. `None` for a device without a spring.
    pub spring: Option<Spring>,
    /// Force per unit of the command. It is in N/V or N/A, or it is 1 if the command is the force. A known gain has no
    /// interval.
    pub gain_n_per_v: Estimate,
    /// Latency in s. A known latency has no interval.
    pub latency_s: Estimate,
    pub terms: Found,
    pub fits: Vec<Fit>,
    pub residual: Residual,
    /// The largest ratio of an interval's half-width to its half-width for white noise.
    pub widening: f64,
    pub joint: Joint,
    pub evaluations: usize,
    pub warnings: Vec<String>,
    values: Values,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spring {
    pub stiffness_n_per_m: Estimate,
    pub rest_position_m: Estimate,
}

/// Identifies the device of `records`. With [`Gain::AddedMass`] there are two records. The second record has the added
/// mass. With another gain, any number of records of one device are fitted together.
///
/// # Errors
/// The message has one line. It says why the records are not sufficient.
pub fn identify(records: &[Record], options: &Options) -> Result<Identification, String> {
    identified(records, options, &AtomicBool::new(false))
}

/// Identifies the device. If `stop` is set, the function ends soon, and its result has no meaning.
fn identified(
    records: &[Record],
    options: &Options,
    stop: &AtomicBool,
) -> Result<Identification, String> {
    let added = match options.gain {
        Gain::AddedMass { mass_kg } if records.len() == 2 => [0.0, mass_kg].to_vec(),
        Gain::AddedMass { .. } => {
            return Err(format!("--added-mass needs two records, not {}", records.len()));
        }
        _ => vec![0.0; records.len()],
    };
    let reference_m = records.first().map_or(0.0, mean);
    let layout = Layout {
        spring: options.spring,
        rest_m: options
            .rest_position_m
            .filter(|_| options.spring)
            .map(|rest_m| rest_m - reference_m),
        gain: options.gain.known_n_per_v()?,
        latency_s: (!options.fit_latency).then_some(options.latency_s),
        terms: Included::default(),
        cycles_per_m: None,
        cogs_per_m: None,
        reference_m,
        records: records.len(),
        resting: 0,
    };
    let mut fitted = vec![];
    for (record, added_kg) in records.iter().zip(added) {
        let first = first_row(record, options).map_err(|error| of(record, &error))?;
        checks::before(record, first, options).map_err(|error| of(record, &error))?;
        let positions = record.position_m.iter().map(|x| x + options.half_count_m() - reference_m);
        fitted.push(Fitted { record, positions_m: positions.collect(), first, added_kg, stop });
    }
    let values = first_values(&fitted, layout, options)?;
    if options.terms.asks(Term::Offset) && options.spring && options.rest_position_m.is_none() {
        return Err("a constant force moves the place where a spring rests and nothing else: give --rest-position, where \
                    it rests without that force, or --no-spring"
            .into());
    }
    let (mut model, mut tests, mut weighting) = search::choose(&fitted, &values, options)
        .map_err(|error| without_mass(&fitted, options).unwrap_or(error))?;
    let mut held = None;
    if let Some(latency) = model.estimates.latency.filter(|latency| latency.value < 0.0) {
        let warning = checks::early(&latency, fitted[0].record.step_s)?;
        held = Some((Estimate { value: 0.0, ..latency }, warning));
        let none = Layout { latency_s: Some(0.0), ..layout };
        (model, tests, weighting) = search::choose(&fitted, &values.within(none), options)?;
    }
    let search = Search { records: &fitted, options, weighting };
    let mut found = conclude(&search, &model, tests)?;
    if let Some((latency_s, warning)) = held {
        found.latency_s = latency_s;
        found.warnings.push(warning);
    }
    Ok(found)
}

/// Predicts the positions of another record of the same device. Only first position and first speed are fitted to it.
///
/// # Errors
/// The record is shorter than the latency, or the model does not describe it.
pub fn predict(found: &Identification, record: &Record, options: &Options) -> Result<Fit, String> {
    let first = first_row(record, options).map_err(|error| of(record, &error))?;
    let layout = Layout { records: 1, resting: 0, ..*found.values.layout() };
    let reference_m = layout.reference_m;
    let positions = record.position_m.iter().map(|x| x + options.half_count_m() - reference_m);
    let fitted = Fitted {
        record,
        positions_m: positions.collect(),
        first,
        added_kg: 0.0,
        stop: &AtomicBool::new(false),
    };
    let mut values = found.values.within(layout);
    let measured = &fitted.positions_m[first..];
    let seconds = (FEWEST_ROWS - 1) as f64 * record.step_s;
    values.set_start(0, [measured[0], (measured[FEWEST_ROWS - 1] - measured[0]) / seconds]);
    let records = [fitted.clone()];
    let mut problem = Problem { records: &records, values, weighting: &Weighting::White };
    let residual = problem.fit_starts();
    let residual_m = -residual.ok_or_else(|| of(record, "the model does not describe it"))?;
    Ok(Fit::new(first, (measured, residual_m.as_slice()), problem.values.start(0), reference_m))
}

fn of(record: &Record, error: &str) -> String {
    format!("{}: {error}", record.name)
}

fn mean(record: &Record) -> f64 {
    record.position_m.iter().sum::<f64>() / record.len() as f64
}

/// First row from which on all commands that act are in the record.
fn first_row(record: &Record, options: &Options) -> Result<usize, String> {
    let room_s = if options.fit_latency { options.latency_s + LATENCY_ROOM_S } else { 0.0 };
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
    let first = ((options.latency_s + room_s) / record.step_s - 1e-6).ceil() as usize;
    if first.saturating_add(FEWEST_ROWS) > record.len() {
        return Err(format!(
            "{} rows of {} s leave fewer than {FEWEST_ROWS} after the latency of {} s",
            record.len(),
            record.step_s,
            options.latency_s
        ));
    }
    Ok(first)
}

/// The reason why a record does not show the mass. `None` if a device without a mass does not explain the record.
fn without_mass(fitted: &[Fitted<'_>], options: &Options) -> Option<String> {
    fitted.iter().find_map(|Fitted { record, positions_m, first, .. }| {
        let latency = options.latency_s / record.step_s;
        let guess = guess::guess(record, positions_m, *first, latency)?;
        let explained = guess::without_mass(record, positions_m, *first, latency)?;
        let is_hidden = guess.gain <= 0.0 && explained >= checks::EXPLAINED_MIN;
        is_hidden.then(|| of(record, &checks::not_driven(Some(explained))))
    })
}

/// First values of all parameters. They come from the records alone.
fn first_values(
    fitted: &[Fitted<'_>],
    layout: Layout,
    options: &Options,
) -> Result<Values, String> {
    let mut guesses = vec![];
    for Fitted { record, positions_m, first, .. } in fitted {
        let latency = options.latency_s / record.step_s;
        let guess = guess::guess(record, positions_m, *first, latency)
            .ok_or_else(|| of(record, "the equation of motion has no solution for this record"))?;
        if guess.gain > 0.0 {
            guesses.push(guess);
            continue;
        }
        // The integrals are wrong over a time in which friction holds the handle at rest. So only windows in motion are
        // used.
        let held = options.terms.may_have_friction();
        let mut windows = guess::WINDOWS.into_iter().filter(|_| held).filter_map(|windows| {
            guess::moving((record, positions_m, *first), latency, (options.spring, true), windows)
        });
        match windows.next() {
            Some((guess, _)) => guesses.push(guess),
            None => {
                let alone = guess::without_mass(record, positions_m, *first, latency);
                return Err(of(record, &checks::not_driven(alone)));
            }
        }
    }
    let guess = *guesses.first().ok_or("no record")?;
    let gain = match (layout.gain, options.gain, guesses.as_slice()) {
        (Some(gain), ..) => gain,
        (None, Gain::AddedMass { mass_kg }, [light, heavy])
            if 1.0 / heavy.gain > 1.0 / light.gain =>
        {
            mass_kg / (1.0 / heavy.gain - 1.0 / light.gain)
        }
        _ => {
            return Err("the second record does not show more mass than the first: was the mass added there?".into());
        }
    };
    let mass = gain / guess.gain;
    let mut values = Values::zeros(layout);
    for (parameter, value) in [
        (Parameter::Mass, mass),
        (Parameter::Damping, guess.d * mass),
        (Parameter::Stiffness, guess.w * mass),
        (Parameter::Constant, guess.offset * mass),
        (Parameter::Gain, gain),
        (Parameter::Latency, options.latency_s),
    ] {
        values.set(parameter, value);
    }
    for (index, guess) in guesses.iter().enumerate() {
        values.set_start(index, [guess.x, guess.v]);
    }
    Ok(values)
}

/// Checks a fitted model, and makes the result.
fn conclude(
    search: &Search<'_>,
    model: &Model,
    tests: Vec<Tested>,
) -> Result<Identification, String> {
    let fitted = search.records;
    let Model { solution, estimates: found, .. } = model;
    let reference_m = model.layout().reference_m;
    // The force weighting hides slow errors. So it shows the first position and speed badly.
    let mut unweighted =
        Problem { records: fitted, values: model.values().clone(), weighting: &Weighting::White };
    let started = search.weighting.is_force().then(|| unweighted.fit_starts()).flatten();
    let values = &unweighted.values;
    let shown = started.map(|residual| {
        let residual_m = -residual;
        (Weighed::new(fitted, (&residual_m, reference_m), search.options), residual_m)
    });
    let (weighed, residual_m) = match &shown {
        Some((weighed, residual_m)) => (weighed, residual_m),
        None => (&model.weighed, &solution.residual_m),
    };
    let residual = weighed.found;
    let mut fits = vec![];
    let mut top = 0;
    for (index, Fitted { positions_m, first, .. }) in fitted.iter().enumerate() {
        let measured = &positions_m[*first..];
        let own = residual_m.rows(top, measured.len());
        top += measured.len();
        fits.push(Fit::new(*first, (measured, own.as_slice()), values.start(index), reference_m));
    }
    if !search.weighting.is_force() {
        checks::explains(residual.rms_m, fit::motion(fitted))?;
    }
    let seconds = fitted.iter().map(|fitted| fitted.rows() as f64 * fitted.record.step_s);
    let mut warnings = checks::after(found, &tests, seconds.fold(0.0, f64::max))?;
    if let Some(latency) = found.latency {
        let room_s = fitted.iter().map(|fitted| fitted.first as f64 * fitted.record.step_s);
        if latency.value > room_s.fold(f64::INFINITY, f64::min) {
            return Err(format!(
                "the latency is {:.4} s; begin with a --latency near it",
                latency.value
            ));
        }
    }
    let volts = fitted.iter().flat_map(|fitted| &fitted.record.command);
    let largest_v = volts.fold(0.0, |most: f64, volt| most.max(volt.abs()));
    warnings.extend(checks::questions(
        found.mass.value,
        values.of(Parameter::Gain).abs() * largest_v,
        fastest(fitted),
    ));
    warnings.extend(checks::untold(&tests));
    warnings.extend(search.delay_instead(model).map(|rows| {
        format!(
            "a latency of {rows:.3} rows explains this as well as the lag of the amplifier: the record is too short or too \
             noisy to tell them apart"
        )
    }));
    for (fitted, piece) in
        fitted.iter().zip(weighed.pieces()).filter(|_| search.options.resolution_m > 0.0)
    {
        if let Some((row, counts)) = checks::step(piece.residual) {
            let row = fitted.first + row;
            warnings.push(format!(
                "{}: the position steps by {counts:.0} counts at {:.4} s (row {row} of the record, from 0), which no force \
                 does: counts were lost, or the counter was set; --from and --to take a part",
                fitted.record.name,
                fitted.record.time_s(row)
            ));
        }
    }
    warnings.extend(of_hidden(found.hidden, values.layout().terms));
    warnings.extend(of_residual(&residual, found.widening, search, model));
    Ok(Identification {
        drive: fitted[0].record.drive,
        mass_kg: found.mass,
        damping_n_s_per_m: found.damping,
        spring: found.spring.map(|[stiffness_n_per_m, rest]| Spring {
            stiffness_n_per_m,
            rest_position_m: Estimate { value: rest.value + reference_m, ..rest },
        }),
        gain_n_per_v: found.gain.unwrap_or_else(|| Estimate::given(values.of(Parameter::Gain))),
        latency_s: found.latency.unwrap_or_else(|| Estimate::given(values.of(Parameter::Latency))),
        terms: Found {
            friction_n: found.friction,
            lag_s: found.lag,
            stribeck: found
                .stribeck
                .map(|[_, static_n, speed_m_per_s]| Stribeck { static_n, speed_m_per_s }),
            offset_n: found.offset,
            cogging: found.cogging.map(|[amplitude_n, phase_rad, pitch_m]| Cogging {
                amplitude_n,
                pitch_m,
                phase_rad: Estimate { value: wrapped(phase_rad.value), ..phase_rad },
            }),
            phase: found.phase.map(|[first_m, second_m, phase_rad, cycle_m]| Phase {
                first_m,
                second_m,
                phase_rad: Estimate { value: wrapped(phase_rad.value), ..phase_rad },
                cycle_m,
            }),
            tests,
        },
        fits,
        residual,
        widening: found.widening,
        joint: found.joint,
        evaluations: solution.evaluations,
        warnings,
        values: values.clone(),
    })
}

/// Largest mean speed over ten rows, in m/s.
fn fastest(fitted: &[Fitted<'_>]) -> f64 {
    let of = |fitted: &Fitted<'_>| {
        let ends = fitted.positions_m.iter().zip(fitted.positions_m.iter().skip(10));
        let most = ends.map(|(from, to)| (to - from).abs()).fold(0.0, f64::max);
        most / (10.0 * fitted.record.step_s)
    };
    fitted.iter().map(of).fold(0.0, f64::max)
}

/// The same angle in rad, between minus half a turn and half a turn.
fn wrapped(angle: f64) -> f64 {
    angle - TAU * (angle / TAU).round()
}

/// The warning about hidden terms, which have widened intervals. `terms` are the terms of the model.
fn of_hidden(hidden: Included, terms: Included) -> Option<String> {
    let of = |terms: Included| Term::ALL.into_iter().filter(move |term| term.is_in(terms));
    let names: Vec<&str> = of(hidden).map(terms::said).collect();
    let options: Vec<String> = of(terms).map(|term| format!("--{}", term.name())).collect();
    let fitted = if options.is_empty() { "--terms none".into() } else { options.join(" ") };
    (!names.is_empty()).then(|| {
        format!(
            "this record cannot tell from noise whether there is: {}; the intervals are wide enough for it; if you know that \
             there is none, give {fitted}",
            names.join(", ")
        )
    })
}

/// The warnings that the residual gives reason for.
fn of_residual(
    residual: &Residual,
    widening: f64,
    search: &Search<'_>,
    model: &Model,
) -> Vec<String> {
    let mut warnings = vec![];
    if search.weighting.is_force() {
        warnings.push(format!(
            "the residual is not quantisation and noise alone (autocorrelation {:.3} from row to row): \
             something is not modelled; the fit weighs it as the force that is missing, and the intervals count with its colour; likely missing: {}",
            residual.autocorrelation,
            missing::likely(search, model)
        ));
    } else if residual.is_bound_by_quantisation() {
        warnings.push(format!(
            "quantisation, not noise, makes the residual ({:.0} % of its sawtooth is left); the intervals count with \
             that and are up to {widening:.1} times those of white noise",
            100.0 * residual.coherence
        ));
        let said = search.misfit(model).map(|larger| match larger {
            Misfit::Larger(is, allowed) => {
                format!("larger than they allow: {is:.2} counts RMS, {allowed:.2} with this model")
            }
            Misfit::InMotion => "larger in motion than they allow".into(),
            Misfit::Coloured(is, allowed) => format!(
                "more coloured than they allow: {is:.3} counts RMS of its means over stretches, {allowed:.3} with this model"
            ),
        });
        if let Some(said) = said {
            warnings.push(format!(
                "the residual is not quantisation and noise alone but {said}; the intervals do not hold what the model \
                 lacks; likely missing: {}",
                missing::likely(search, model)
            ));
        }
    } else if !residual.is_white() {
        warnings.push(format!(
            "the residual is not white (autocorrelation {:.3} from row to row, Ljung-Box p = {:.1e}): something is not \
             modelled; the intervals are up to {widening:.1} times those of white noise and still do not hold what the \
             model lacks; likely missing: {}",
            residual.autocorrelation,
            residual.whiteness_p,
            missing::likely(search, model)
        ));
    }
    if residual.peak_per_rms > OUTLIER {
        warnings.push(format!(
            "a position is {:.1} times the RMS off the model: a lost count, a stop or a knock?",
            residual.peak_per_rms
        ));
    }
    warnings
}
