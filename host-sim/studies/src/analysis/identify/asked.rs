//! What a person asks of records, checked before the first one is read; the command line and Python ask the same.

use std::{ops::RangeInclusive, path::Path, sync::atomic::AtomicBool};

use super::{
    Gain, Identification, Options, OutputScale, Record, Span, Terms, from_capture,
    from_capture_csv, identified, telemetry::is_capture_csv,
};
use crate::{
    error::Error,
    input, interrupt,
    range::within,
    scene::{NamedScene, Scene, Units, ranges},
};

/// Allowed `--encoder-cycle`, m, as in a scene.
const CYCLE_M: RangeInclusive<f64> = 1e-8..=1.0;
/// Allowed `--resolution` beside 0, m, as in a scene.
const RESOLUTION_M: RangeInclusive<f64> = 1e-8..=1e-3;

/// The ways to the force per volt; one of them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GainAsked {
    /// Force per volt, N/V, or in the units that it is said in.
    pub gain: Option<f64>,
    /// k_t of gain = k_t k_amp / r_c, N m/A.
    pub torque_constant: Option<f64>,
    /// k_amp of this gain, A/V.
    pub amplifier_gain: Option<f64>,
    /// r_c of this gain, m.
    pub drum_radius: Option<f64>,
    /// Mass of a weight that the motor holds, kg.
    pub calibration_mass: Option<f64>,
    /// Voltage that holds that weight still, V.
    pub calibration_voltage: Option<f64>,
    /// Mass that was added to the device for the second record, kg.
    pub added_mass: Option<f64>,
}

impl GainAsked {
    /// The one that is given; of a rotary base scene its own where none is.
    ///
    /// # Errors
    /// None is, or more than one, or a part of one.
    pub fn source(&self, base: &Scene, said_in: Units) -> Result<Gain, Error> {
        let Self { gain, torque_constant, amplifier_gain, drum_radius, .. } = *self;
        let Self { calibration_mass, calibration_voltage, added_mass, .. } = *self;
        let motor = [torque_constant, amplifier_gain, drum_radius];
        let weight = [calibration_mass, calibration_voltage];
        let is_given = |parts: &[Option<f64>]| parts.iter().any(Option::is_some);
        let ways = [&[gain][..], &motor, &weight, &[added_mass]];
        if ways.iter().filter(|parts| is_given(parts)).count() > 1 {
            return Err(Error::input(
                "the force per volt is given in more than one way, allowed one",
            ));
        }
        if let Some(gain) = gain {
            return Ok(Gain::Given(gain / said_in.written("N/V").1));
        }
        if let [Some(torque_constant_n_m_per_a), Some(amplifier_a_per_v), Some(drum_radius_m)] =
            motor
        {
            return Ok(Gain::Motor { torque_constant_n_m_per_a, amplifier_a_per_v, drum_radius_m });
        }
        if let [Some(mass_kg), Some(voltage_v)] = weight {
            return Ok(Gain::Weight { mass_kg, voltage_v });
        }
        let added = added_mass.map(|mass_kg| Gain::AddedMass { mass_kg });
        let in_part = is_given(&motor) || is_given(&weight);
        let own = base.units.is_rotary() && !in_part;
        let own = own.then_some(Gain::Given(base.actuator.gain_n_per_v));
        added.or(own).ok_or_else(|| {
            Error::Input(
                "the force per volt is not given, and one record shows mass, damping and stiffness only in terms of it: \
                 give --gain, or --torque-constant, --amplifier-gain and --drum-radius, or --calibration-mass and \
                 --calibration-voltage, or a second record with --added-mass"
                    .into(),
            )
        })
    }
}

/// What is asked, beside the force per volt.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Asked {
    /// From a row's time to its voltage's effect, samples of the base scene; that scene's if it is not said.
    pub latency: Option<f64>,
    /// Fit the latency too.
    pub fit_latency: bool,
    /// The device has a spring.
    pub spring: bool,
    /// Terms beside mass, damping and spring.
    pub terms: Terms,
    /// Where the spring rests without any other force, m, or in the units that it is said in; so are the next two.
    pub rest_position: Option<f64>,
    /// Travel per cycle of the encoder's signals.
    pub encoder_cycle: Option<f64>,
    /// Size of a count; 0 for a sensor without counts.
    pub resolution: Option<f64>,
    /// Part of the records.
    pub span: Span,
}

impl Asked {
    /// With what the base scene knows. `said_in` is what lengths are said in.
    ///
    /// # Errors
    /// Something is out of range.
    pub fn options(&self, base: &Scene, gain: Gain, said_in: Units) -> Result<Options, Error> {
        let mut options = Options::of_scene(base, gain);
        options.fit_latency = self.fit_latency;
        options.spring = self.spring;
        options.terms = self.terms;
        let per_m = said_in.key("_m").map_or(1.0, |(_, per_m)| per_m);
        let unit = if said_in.is_rotary() { "rad" } else { "m" };
        let in_range = |option: &str, said: f64, range, unit: &str| {
            within(option, said, range).map_err(|error| Error::Input(format!("{error} {unit}")))
        };
        let length = |option: &str, said: f64, range: RangeInclusive<f64>| {
            let [low, high] = [range.start(), range.end()].map(|end| end * per_m);
            in_range(option, said, low..=high, unit).map(|()| said / per_m)
        };
        if let Some(rest) = self.rest_position {
            options.rest_position_m = Some(length("--rest-position", rest, ranges::POSITION_M)?);
        }
        if let Some(cycle) = self.encoder_cycle {
            options.cycle_m = Some(length("--encoder-cycle", cycle, CYCLE_M)?);
        }
        if let Some(latency) = self.latency {
            in_range("--latency", latency, ranges::LATENCY, "samples")?;
            options.latency_s = latency / base.control.rate_hz;
        }
        if let Some(resolution) = self.resolution {
            options.resolution_m = match resolution {
                0.0 => 0.0,
                said => length("--resolution", said, RESOLUTION_M)?,
            };
        }
        for (option, time_s) in [("--from", self.span.from_s), ("--to", self.span.to_s)] {
            if let Some(time_s) = time_s.filter(|time_s| !time_s.is_finite()) {
                return Err(Error::Input(format!(
                    "{option} is {time_s}, allowed any finite number of s"
                )));
            }
        }
        // Refuses it before any record is read.
        let gain = options.gain.known_n_per_v();
        gain.map_err(|error| Error::Input(base.units.text(&error)))?;
        Ok(options)
    }
}

/// A record from a file of any of the accepted forms. `base_name` is what messages call the base scene.
///
/// # Errors
/// The file cannot be read, or is no record.
pub fn read(
    path: &Path,
    (base, base_name): (&NamedScene, &str),
    options: &Options,
    span: Span,
) -> Result<Record, Error> {
    let (name, scene) = (path.display().to_string(), &base.scene);
    let bytes = input::read(path, input::RECORD)?;
    let scale = OutputScale::of_scene(scene, options.resolution_m)
        .map_err(|error| Error::Input(error).of(base_name))?;
    let record = match input::utf8(&bytes) {
        Ok(text) if is_capture_csv(text) => from_capture_csv(&name, text, &scale, span),
        Ok(text) => Record::from_csv(&name, text, span, scene.units, options.resolution_m),
        Err(_) => from_capture(&name, &bytes, &scale, span),
    };
    record.map_err(|error| Error::Input(error).of(&name))
}

/// What a rotary record's columns and options are called, where a text names those of a linear one.
const NAMES: [(&str, &str); 4] = [
    ("position_m is in m: are these mm?", "position_rad is in rad: are these degrees?"),
    ("position_m in m", "position_rad in rad"),
    ("--resolution in m", "--resolution in rad"),
    ("--gain in N/V", "--gain in N m/V"),
];

/// An error or a warning of the analysis, in the units of the base scene.
fn said(units: Units, text: &str) -> String {
    let said = units.text(text);
    match units {
        Units::Linear => said,
        Units::Rotary { .. } => {
            NAMES.iter().fold(said, |said, (linear, rotary)| said.replace(linear, rotary))
        }
    }
}

/// As [`identify`](super::identify), of a base scene in those units: what is said is in them.
///
/// # Errors
/// The records do not tell, or `stop` was set.
pub fn identify_in(
    units: Units,
    records: &[Record],
    options: &Options,
    stop: &AtomicBool,
) -> Result<Identification, Error> {
    let found = identified(records, options, stop);
    interrupt::unless(stop)?; // what it says then may be of a search that was cut
    let mut found = found.map_err(|error| Error::Input(said(units, &error)))?;
    found.warnings.iter_mut().for_each(|warning| *warning = said(units, warning));
    Ok(found)
}
