//! The JSON object of `identify`. A result in Python has the same keys.

use serde::Serialize;

use super::{CONFIDENCE, Drive, Estimate, Found, Identification, Options, Record, Tested};

/// The whole result; docs/files.md has the keys.
#[derive(Serialize)]
pub struct Json<'a> {
    logs: Vec<&'a str>,
    rows: usize,
    step_s: f64,
    confidence: f64,
    gain_source: &'static str,
    mass_kg: Interval,
    damping_n_s_per_m: Interval,
    stiffness_n_per_m: Option<Interval>,
    rest_position_m: Option<Interval>,
    drive: String,
    gain_n_per_v: Option<Interval>,
    #[serde(skip_serializing_if = "Option::is_none")]
    gain_n_per_a: Option<Interval>,
    latency_s: Interval,
    #[serde(skip_serializing_if = "Option::is_none")]
    terms: Option<TermsJson>,
    initial: Vec<Initial>,
    residual: ResidualJson,
    widening: f64,
    warnings: &'a [String],
}

/// A value and its interval. If the value was given, both ends of the interval are the value.
#[derive(Serialize)]
struct Interval {
    value: f64,
    low: f64,
    high: f64,
    white_half_width: f64,
}

impl From<Estimate> for Interval {
    fn from(estimate: Estimate) -> Self {
        let Estimate { value, white_half_width, .. } = estimate;
        Self { value, low: estimate.low(), high: estimate.high(), white_half_width }
    }
}

/// The terms that are fitted in addition to mass, damping and spring. The key is absent if there are none.
#[derive(Serialize)]
struct TermsJson {
    friction_n: Option<Interval>,
    static_friction_n: Option<Interval>,
    stribeck_speed_m_per_s: Option<Interval>,
    amplifier_lag_s: Option<Interval>,
    offset_n: Option<Interval>,
    cogging: Option<CoggingJson>,
    encoder_error: Option<PhaseJson>,
    tests: Vec<TestJson>,
}

#[derive(Serialize)]
struct CoggingJson {
    amplitude_n: Interval,
    pitch_m: Interval,
    phase_rad: Interval,
}

#[derive(Serialize)]
struct PhaseJson {
    first_m: Interval,
    second_m: Interval,
    phase_rad: Interval,
    cycle_m: Interval,
}

/// The test that showed that a term is not 0.
#[derive(Serialize)]
struct TestJson {
    term: &'static str,
    standard_errors: f64,
    p: f64,
}

impl TermsJson {
    fn new(found: &Found) -> Option<Self> {
        let test = |tested: &Tested| TestJson {
            term: tested.term.name(),
            standard_errors: tested.z,
            p: tested.p,
        };
        (!found.tests.is_empty()).then(|| Self {
            friction_n: found.friction_n.map(Interval::from),
            static_friction_n: found.stribeck.map(|one| one.static_n.into()),
            stribeck_speed_m_per_s: found.stribeck.map(|one| one.speed_m_per_s.into()),
            amplifier_lag_s: found.lag_s.map(Interval::from),
            offset_n: found.offset_n.map(Interval::from),
            cogging: found.cogging.map(|cogging| CoggingJson {
                amplitude_n: cogging.amplitude_n.into(),
                pitch_m: cogging.pitch_m.into(),
                phase_rad: cogging.phase_rad.into(),
            }),
            encoder_error: found.phase.map(|phase| PhaseJson {
                first_m: phase.first_m.into(),
                second_m: phase.second_m.into(),
                phase_rad: phase.phase_rad.into(),
                cycle_m: phase.cycle_m.into(),
            }),
            tests: found.tests.iter().map(test).collect(),
        })
    }
}

/// State of a record at its first fitted row.
#[derive(Serialize)]
struct Initial {
    time_s: f64,
    position_m: f64,
    speed_m_per_s: f64,
}

#[derive(Serialize)]
struct ResidualJson {
    rms_m: f64,
    rms_counts: Option<f64>,
    noise_counts: Option<f64>,
    white: bool,
    whiteness_p: f64,
    autocorrelation: f64,
    bound_by_quantisation: bool,
    coherence: f64,
    peak_per_rms: f64,
}

impl<'a> Json<'a> {
    pub fn new(records: &'a [Record], found: &'a Identification, options: &Options) -> Self {
        let residual = &found.residual;
        let gain = |drive| (found.drive == drive).then(|| found.gain_n_per_v.into());
        let initial = records.iter().zip(&found.fits).map(|(record, fit)| Initial {
            time_s: record.time_s(fit.first),
            position_m: fit.position_m,
            speed_m_per_s: fit.speed_m_per_s,
        });
        Self {
            logs: records.iter().map(|record| record.name.as_str()).collect(),
            rows: found.fits.iter().map(|fit| fit.model_m.len()).sum(),
            step_s: records[0].step_s,
            confidence: CONFIDENCE,
            gain_source: options.gain.source(),
            mass_kg: found.mass_kg.into(),
            damping_n_s_per_m: found.damping_n_s_per_m.into(),
            stiffness_n_per_m: found.spring.map(|spring| spring.stiffness_n_per_m.into()),
            rest_position_m: found.spring.map(|spring| spring.rest_position_m.into()),
            drive: found.drive.to_string(),
            gain_n_per_v: gain(Drive::Voltage),
            gain_n_per_a: gain(Drive::Current),
            latency_s: found.latency_s.into(),
            terms: TermsJson::new(&found.terms),
            initial: initial.collect(),
            residual: ResidualJson {
                rms_m: residual.rms_m,
                rms_counts: residual.rms_counts,
                noise_counts: residual.noise_counts,
                white: residual.is_white(),
                whiteness_p: residual.whiteness_p,
                autocorrelation: residual.autocorrelation,
                bound_by_quantisation: residual.is_bound_by_quantisation(),
                coherence: residual.coherence,
                peak_per_rms: residual.peak_per_rms,
            },
            widening: found.widening,
            warnings: &found.warnings,
        }
    }
}
