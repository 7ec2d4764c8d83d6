//! Checks the options of an identification before the first record is read. Command line and Python share this code.

use std::{
    ops::RangeInclusive,
    path::{Path, PathBuf},
    sync::atomic::AtomicBool,
};

use super::{
    Drive, Fit, Gain, Identification, Options, OutputScale, Record, Span, Terms, checks,
    from_capture, from_capture_csv, identified, predict, telemetry::is_capture_csv,
};
use crate::{
    error::Error,
    input, interrupt,
    range::within,
    scene::{NamedScene, Scene, Units, ranges},
};

/// Values in m that `--encoder-cycle` may have. A scene allows the same range.
const CYCLE_M: RangeInclusive<f64> = 1e-8..=1.0;
/// Limit of the command if it is not known, as a multiple of the largest command. No command reaches it.
const BEYOND: f64 = 1.001;

/// The options that say how large the force per volt is. They belong to several sources. Only one source may be given.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GainAsked {
    /// Force per volt, in N/V or in the units of the options.
    pub gain: Option<f64>,
    /// Torque constant k_t in N m/A. The gain is k_t k_amp / r_c.
    pub torque_constant: Option<f64>,
    /// Amplifier gain k_amp in A/V. The gain is k_t k_amp / r_c.
    pub amplifier_gain: Option<f64>,
    /// Drum radius r_c in m. The gain is k_t k_amp / r_c.
    pub drum_radius: Option<f64>,
    /// Mass of a weight that the motor holds, in kg.
    pub calibration_mass: Option<f64>,
    /// Voltage with which the motor holds this weight still, in V.
    pub calibration_voltage: Option<f64>,
    /// Mass that was added to the device for the second record, in kg.
    pub added_mass: Option<f64>,
}

impl GainAsked {
    /// Says where the gain comes from, according to the options. If they name no source and the base scene is rotary,
    /// the base scene's gain is used. A log with the force needs no source.
    ///
    /// # Errors
    /// No source, several sources or an incomplete source is given, or the source does not fit the log.
    pub fn source(&self, base: &Scene, said_in: Units, drive: Drive) -> Result<Gain, Error> {
        let Self { gain, torque_constant, amplifier_gain, drum_radius, .. } = *self;
        let Self { calibration_mass, calibration_voltage, added_mass, .. } = *self;
        let motor = [torque_constant, amplifier_gain, drum_radius];
        let weight = [calibration_mass, calibration_voltage];
        let is_given = |parts: &[Option<f64>]| parts.iter().any(Option::is_some);
        let ways = [&[gain][..], &motor, &weight, &[added_mass]];
        let given = ways.iter().filter(|parts| is_given(parts)).count();
        if drive == Drive::Force {
            return match given {
                0 => Ok(Gain::Force),
                _ => Err(Error::input(
                    "the log has the force itself, so that no gain is looked for: leave out --gain and what it can be had from",
                )),
            };
        }
        if given > 1 {
            return Err(Error::Input(format!(
                "the force per {} is given in more than one way, allowed one",
                drive.per()
            )));
        }
        if let Some(gain) = gain {
            return Ok(Gain::Given(gain / said_in.written("N/V").1));
        }
        let in_part = is_given(&motor) || is_given(&weight);
        let (amplifier, ways) = match drive {
            Drive::Current => (
                amplifier_gain.is_none().then_some(1.0),
                "--torque-constant and --drum-radius, without --amplifier-gain",
            ),
            _ => (
                amplifier_gain,
                "--torque-constant, --amplifier-gain and --drum-radius, or --calibration-mass and --calibration-voltage",
            ),
        };
        if let (Some(torque_constant_n_m_per_a), Some(amplifier_a_per_v), Some(drum_radius_m)) =
            (torque_constant, amplifier, drum_radius)
        {
            return Ok(Gain::Motor { torque_constant_n_m_per_a, amplifier_a_per_v, drum_radius_m });
        }
        if let ([Some(mass_kg), Some(voltage_v)], Drive::Voltage) = (weight, drive) {
            return Ok(Gain::Weight { mass_kg, voltage_v });
        }
        let added = added_mass.map(|mass_kg| Gain::AddedMass { mass_kg });
        let own = drive == Drive::Voltage && base.units.is_rotary() && !in_part;
        let own = own.then_some(Gain::Given(base.actuator.gain_n_per_v));
        added.or(own).ok_or_else(|| {
            Error::Input(format!(
                "the force per {} is not given, and one record shows mass, damping and stiffness only in terms of it: \
                 give --gain, or {ways}, or a second record with --added-mass",
                drive.per()
            ))
        })
    }
}

/// The options of an identification, except those for the force per volt.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Asked {
    /// Whether the base scene is that of the device. If not, only the written scene takes values from it: the latency
    /// must be given, and the size of a count is found in the records.
    pub is_based: bool,
    /// Time until the command of a row acts, in rows of the log. The default is the base scene's latency.
    pub latency: Option<f64>,
    pub fit_latency: bool,
    pub spring: bool,
    /// Terms that are fitted in addition to mass, damping and spring.
    pub terms: Terms,
    /// Position at which the spring rests if no other force acts, in m or in the units of the options. `encoder_cycle`
    /// and `resolution` have the same units.
    pub rest_position: Option<f64>,
    /// Distance over which the encoder's signals repeat.
    pub encoder_cycle: Option<f64>,
    /// Size of a count; 0 for a sensor without counts.
    pub resolution: Option<f64>,
    pub span: Span,
}

impl Asked {
    /// The options, completed with values of the base scene. The gain and a latency in rows are still missing, because
    /// they depend on the logs. `said_in` is the unit of lengths.
    ///
    /// # Errors
    /// An option is out of range.
    pub(super) fn options(&self, base: &Scene, said_in: Units) -> Result<Options, Error> {
        let mut options = Options::of_scene(base, Gain::Force);
        if !self.is_based {
            if self.latency.is_none() && !self.fit_latency {
                return Err(Error::input(
                    "it is not known when the command of a row acts: give --latency (0 if it acts at the time of its row), \
                     --fit-latency, or the scene of the device as --base",
                ));
            }
            options = Options {
                latency_s: 0.0,
                resolution_m: 0.0,
                limit_v: f64::INFINITY,
                cycle_m: None,
                ..options
            };
        }
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
            in_range("--latency", latency, ranges::LATENCY, "rows")?;
        }
        if let Some(resolution) = self.resolution {
            options.resolution_m = match resolution {
                0.0 => 0.0,
                said => length("--resolution", said, checks::RESOLUTION_M)
                    .map_err(|error| Error::Input(format!("{error}, or 0")))?,
            };
        }
        for (option, time_s) in [("--from", self.span.from_s), ("--to", self.span.to_s)] {
            if let Some(time_s) = time_s.filter(|time_s| !time_s.is_finite()) {
                return Err(Error::Input(format!(
                    "{option} is {time_s}, allowed any finite number of s"
                )));
            }
        }
        Ok(options)
    }
}

/// Reads the records, and completes the options with values from the records. `said_in` is the unit of lengths and of
/// the gain.
///
/// # Errors
/// A file is no record, the records have different kinds of commands, or an option does not fit the records.
pub fn read_all(
    logs: &[PathBuf],
    (base, base_name): (&NamedScene, &str),
    (asked, gain): (&Asked, &GainAsked),
    said_in: Units,
) -> Result<(Vec<Record>, Options), Error> {
    let options = asked.options(&base.scene, said_in)?;
    let read = |log: &PathBuf| read(log, (base, base_name), &options, asked.span);
    let records: Vec<Record> = logs.iter().map(read).collect::<Result<_, Error>>()?;
    let options = of_records(options, (asked, gain), &base.scene, said_in, &records)?;
    Ok((records, options))
}

/// Completes the options with values that depend on the records.
pub(super) fn of_records(
    mut options: Options,
    (asked, gain): (&Asked, &GainAsked),
    base: &Scene,
    said_in: Units,
    records: &[Record],
) -> Result<Options, Error> {
    let first = records.first().ok_or_else(|| Error::input("no record"))?;
    if let Some(other) = records.iter().find(|record| record.drive != first.drive) {
        return Err(Error::Input(format!(
            "{} has a {} and {} a {}, allowed one kind of command",
            first.name, first.drive, other.name, other.drive
        )));
    }
    options.gain = gain.source(base, said_in, first.drive)?;
    if !asked.is_based {
        let commands = records.iter().flat_map(|record| &record.command);
        let largest =
            commands.fold(f64::MIN_POSITIVE, |most: f64, command| most.max(command.abs()));
        options.limit_v = BEYOND * largest;
        if asked.resolution.is_none() {
            options.resolution_m = checks::grid(records).unwrap_or(0.0);
        }
    }
    if let Some(rows) = asked.latency {
        options.latency_s = rows * first.step_s;
    }
    let known = options.gain.known_n_per_v();
    known.map_err(|error| Error::Input(base.units.text(&error)))?;
    Ok(options)
}

/// Predicts another record with [`predict`]. `--from` and `--to` do not apply to it. Error messages use `units`.
///
/// # Errors
/// The file is no record, its command is another one, or the model does not describe it.
pub fn check(
    log: &Path,
    (base, base_name): (&NamedScene, &str),
    found: &Identification,
    options: &Options,
) -> Result<(Record, Fit), Error> {
    let record = read(log, (base, base_name), options, Span::default())?;
    if record.drive != found.drive {
        return Err(Error::Input(format!(
            "{} has a {}, needed a {}",
            record.name, record.drive, found.drive
        )));
    }
    let fit = predict(found, &record, options);
    let fit = fit.map_err(|error| Error::Input(said(base.scene.units, &error)))?;
    Ok((record, fit))
}

/// Reads a record from a file in any accepted format. Error messages name the base scene with `base_name`.
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
        Ok(text) if !is_capture_csv(text) => {
            Record::from_csv(&name, text, span, scene.units, options.resolution_m)
        }
        _ if !options.limit_v.is_finite() || options.resolution_m == 0.0 => {
            Err("a capture has codes and counts: give the scene of its device as --base".into())
        }
        Ok(text) => from_capture_csv(&name, text, &scale, span),
        Err(_) => from_capture(&name, &bytes, &scale, span),
    };
    record.map_err(|error| Error::Input(error).of(&name))
}

/// Texts of messages that must change for a rotary record. Each pair has the linear text and the rotary text.
const NAMES: [(&str, &str); 4] = [
    ("position_m is in m: are these mm?", "position_rad is in rad: are these degrees?"),
    ("position_m in m", "position_rad in rad"),
    ("--resolution in m", "--resolution in rad"),
    ("--gain in N/V", "--gain in N m/V"),
];

/// Converts an error or a warning of the analysis to the units of the base scene.
fn said(units: Units, text: &str) -> String {
    let said = units.text(text);
    match units {
        Units::Linear => said,
        Units::Rotary { .. } => {
            NAMES.iter().fold(said, |said, (linear, rotary)| said.replace(linear, rotary))
        }
    }
}

/// Calls [`identify`](super::identify) for a base scene in `units`. Error messages and warnings use these units too.
///
/// # Errors
/// The records are not sufficient, or `stop` was set.
pub fn identify_in(
    units: Units,
    records: &[Record],
    options: &Options,
    stop: &AtomicBool,
) -> Result<Identification, Error> {
    let found = identified(records, options, stop);
    interrupt::unless(stop)?; // once stopped, the result may come from an incomplete search
    let mut found = found.map_err(|error| Error::Input(said(units, &error)))?;
    found.warnings.iter_mut().for_each(|warning| *warning = said(units, warning));
    Ok(found)
}
