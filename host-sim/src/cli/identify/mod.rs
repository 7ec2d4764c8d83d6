//! `identify`: the parameters of a device from recorded voltage and position.

mod json;
mod plan;
mod rotary;
mod told;

use std::{
    f64::consts::TAU,
    fmt::Write as _,
    path::{Path, PathBuf},
};

use clap::{Args, ValueEnum};
use serde::Serialize;

use self::json::Json;
use super::Common;
use crate::{
    analysis::identify::{self, Gain, Identification, Options, OutputScale, Record, Span, Terms},
    error::{Error, printable},
    input,
    numerics::integrator::Integrator,
    output::{in_units::InUnits, table::Kind, terminal::print_result},
    range::within,
    scene::{
        NamedScene, Scene, Units,
        element::{Amplifier, EncoderError, Friction, Offset},
        ranges,
    },
};

/// Allowed `--encoder-cycle`, m, as in a scene.
const CYCLE_M: std::ops::RangeInclusive<f64> = 1e-8..=1.0;
/// Allowed `--resolution` beside 0, m, as in a scene.
const RESOLUTION_M: std::ops::RangeInclusive<f64> = 1e-8..=1e-3;

/// Identifies mass, damping, stiffness and rest position of a device from recorded voltage and position (paper,
/// section 2.2.2), with 95 % intervals; --out SCENE.toml writes them into a scene. One record cannot tell them from
/// the force per volt: give it as --gain, by motor and amplifier, by a weight, or add a second record with
/// --added-mass. A record that cannot tell is refused with the reason. docs/identification.md says how to record.
#[derive(Debug, Args)]
pub struct IdentifyArgs {
    /// Records: CSV with the columns time_s,voltage_v,position_m (of a rotary base scene position_rad), a telemetry capture, or the CSV that `telemetry`
    /// makes of one. Several records of one device are fitted at once.
    #[arg(required_unless_present = "plan", value_name = "LOG")]
    logs: Vec<PathBuf>,
    /// Scene that gives encoder, voltage limit, latency and sample rate, and all else that a scene needs.
    #[arg(long, value_name = "SCENE", default_value = "paper-1um")]
    base: String,
    #[command(flatten)]
    gain: GainArgs,
    /// From a row's time to its voltage's effect, in samples of the base scene [default: the base scene's].
    #[arg(long, value_name = "SAMPLES", allow_negative_numbers = true)]
    latency: Option<f64>,
    /// Fit the latency too, beginning with --latency.
    #[arg(long)]
    fit_latency: bool,
    /// The device has no spring: stiffness 0, no rest position.
    #[arg(long)]
    no_spring: bool,
    /// No record yet: print the console commands of a designed excitation for the base scene's device, pulses within the
    /// travel and speed of its [safety] and the force of its [motor].
    #[arg(long, conflicts_with_all = ["logs", "csv", "plot", "from", "to"])]
    plan: bool,
    #[command(flatten)]
    terms: TermArgs,
    /// Where the spring rests without any other force, m, of a rotary base scene rad: a constant force can then be told from it.
    #[arg(long, value_name = "M", allow_negative_numbers = true, conflicts_with = "no_spring")]
    rest_position: Option<f64>,
    /// Travel per cycle of the encoder's signals, m or rad [default: that of the base scene's [encoder_error], else it is
    /// looked for].
    #[arg(long, value_name = "M", allow_negative_numbers = true)]
    encoder_cycle: Option<f64>,
    /// Size of a count, m or rad; 0 for a sensor without counts [default: the base scene's].
    #[arg(long, value_name = "M", allow_negative_numbers = true)]
    resolution: Option<f64>,
    /// Use the records from this time stamp on, s.
    #[arg(long, value_name = "S", allow_negative_numbers = true)]
    from: Option<f64>,
    /// Use the records up to this time stamp, s.
    #[arg(long, value_name = "S", allow_negative_numbers = true)]
    to: Option<f64>,
    /// Write voltage, measured and modelled position of the first record as CSV.
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Draw measured against model of the first record (the paper's figure 4); .svg or .png.
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
}

/// Which terms are fitted beside mass, damping and spring.
#[derive(Debug, Args)]
struct TermArgs {
    /// `auto`: those terms that the record tells, each by a test; `none`: mass, damping and spring only.
    #[arg(long, value_enum, default_value_t = TermsName::Auto, value_name = "WHICH")]
    terms: TermsName,
    /// Fit Coulomb friction, whatever the test says; with it, only terms that are named.
    #[arg(long, conflicts_with = "terms")]
    friction: bool,
    /// Fit a constant force; needs --rest-position or --no-spring.
    #[arg(long, conflicts_with = "terms")]
    offset: bool,
    /// Fit the first-order lag of the amplifier.
    #[arg(long, conflicts_with = "terms")]
    amplifier: bool,
    /// Fit the periodic error of the encoder.
    #[arg(long, conflicts_with = "terms")]
    phase: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum TermsName {
    Auto,
    None,
}

impl TermArgs {
    fn terms(&self) -> Terms {
        let Self { terms, friction, offset, amplifier, phase } = *self;
        if friction || offset || amplifier || phase {
            return Terms::These { friction, amplifier, offset, phase };
        }
        match terms {
            TermsName::Auto => Terms::Auto,
            TermsName::None => Terms::NONE,
        }
    }
}

/// The ways to the force per volt; exactly one of them.
#[derive(Debug, Args)]
struct GainArgs {
    /// Force per volt, N/V, of a rotary base scene N m/V [default there: that of its [rotary]].
    #[arg(long, value_name = "N_PER_V", allow_negative_numbers = true, conflicts_with_all = ["torque_constant", "amplifier_gain", "drum_radius", "calibration_mass", "calibration_voltage", "added_mass"])]
    gain: Option<f64>,
    /// k_t of gain = k_t k_amp / r_c, N m/A.
    #[arg(long, value_name = "N_M_PER_A", allow_negative_numbers = true, requires_all = ["amplifier_gain", "drum_radius"], conflicts_with_all = ["calibration_mass", "calibration_voltage", "added_mass"])]
    torque_constant: Option<f64>,
    /// k_amp, A/V.
    #[arg(
        long,
        value_name = "A_PER_V",
        allow_negative_numbers = true,
        requires = "torque_constant"
    )]
    amplifier_gain: Option<f64>,
    /// r_c, m.
    #[arg(long, value_name = "M", allow_negative_numbers = true, requires = "torque_constant")]
    drum_radius: Option<f64>,
    /// Mass of a weight that the motor holds, kg: gain = mass 9.80665 m/s^2 / voltage.
    #[arg(
        long,
        value_name = "KG",
        allow_negative_numbers = true,
        requires = "calibration_voltage",
        conflicts_with = "added_mass"
    )]
    calibration_mass: Option<f64>,
    /// Voltage that holds that weight still, V.
    #[arg(long, value_name = "V", allow_negative_numbers = true, requires = "calibration_mass")]
    calibration_voltage: Option<f64>,
    /// The second record was made with this much mass added to the device, kg: the gain is identified too.
    #[arg(long, value_name = "KG", allow_negative_numbers = true)]
    added_mass: Option<f64>,
}

impl GainArgs {
    /// Of a rotary base scene it is told in N m/V, and is the scene's own where nothing says it.
    fn source(&self, base: &Scene) -> Result<Gain, Error> {
        let Self { gain, torque_constant, amplifier_gain, drum_radius, .. } = *self;
        let Self { calibration_mass, calibration_voltage, added_mass, .. } = *self;
        if let Some(gain) = gain {
            let (_, per_told) = base.units.written("N/V");
            return Ok(Gain::Given(gain / per_told));
        }
        if let (Some(torque_constant_n_m_per_a), Some(amplifier_a_per_v), Some(drum_radius_m)) =
            (torque_constant, amplifier_gain, drum_radius)
        {
            return Ok(Gain::Motor { torque_constant_n_m_per_a, amplifier_a_per_v, drum_radius_m });
        }
        if let (Some(mass_kg), Some(voltage_v)) = (calibration_mass, calibration_voltage) {
            return Ok(Gain::Weight { mass_kg, voltage_v });
        }
        let added = added_mass.map(|mass_kg| Gain::AddedMass { mass_kg });
        let own = base.units.is_rotary().then_some(Gain::Given(base.actuator.gain_n_per_v));
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

pub fn run(args: &IdentifyArgs, common: &Common) -> Result<(), Error> {
    if args.plan {
        return plan::run(args, common);
    }
    let base = NamedScene::load(&args.base)?;
    let units = base.scene.units;
    let gain = args.gain.source(&base.scene)?;
    let inputs = [&args.logs[..], &base.files].concat();
    let moments = Kind::Moments { rate_hz: base.scene.control.rate_hz };
    let mut outputs = common.outputs(&inputs)?;
    let out = outputs.option(common.out.as_ref())?;
    let file = outputs.table(args.csv.as_ref(), moments, Some(&base))?;
    let plot = outputs.figure(args.plot.as_ref())?;
    let options = options(args, &base.scene, gain)?;
    let records: Result<Vec<Record>, Error> =
        args.logs.iter().map(|log| read(log, args, &base.scene, &options)).collect();
    let records = records?;
    let said = |text: &str| told::said(units, text);
    let found = identify::identify(&records, &options);
    let mut found = found.map_err(|error| Error::Input(said(&error)))?;
    found.warnings.iter_mut().for_each(|warning| *warning = said(warning));
    let scene = scene(&base.scene, &found, &options, args);
    let (made, notes) = match units.is_rotary() {
        true => {
            rotary::tables(&base, &scene).map(|(tables, notes)| (Made::Rotary(tables), notes))?
        }
        false => (Made::Linear(&scene), vec![]),
    };
    if let Some(out) = out {
        scene.check().map_err(|error| {
            Error::Input(format!("{}: with the identified device {error}", args.base))
        })?;
        let text = scene_text(&made, &notes, &found, &options, &records, units)?;
        NamedScene::parse("identified".into(), text.clone(), &args.base)?;
        outputs.write(out, text.as_bytes())?;
    }
    if let Some(file) = file {
        outputs.write(file, told::csv(&records[0], &found, units).as_bytes())?;
    }
    if let Some(plot) = plot {
        outputs.draw(plot, &told::draw(&records[0], &found, units)?)?;
    }
    outputs.commit()?;
    let json =
        WithScene { rest: InUnits(units, Json::new(&records, &found, &options)), scene: made };
    print_result(common.json, json, || {
        let notes = notes.iter().map(|note| format!("\nwarning: {note}"));
        told::table(&records, &found, &options, units) + &notes.collect::<String>()
    })
}

fn options(args: &IdentifyArgs, scene: &Scene, gain: Gain) -> Result<Options, Error> {
    let mut options = Options::of_scene(scene, gain);
    options.fit_latency = args.fit_latency;
    options.spring = !args.no_spring;
    options.terms = args.terms.terms();
    // What was typed is m, or of a rotary base scene rad.
    let per_m = scene.units.key("_m").map_or(1.0, |(_, per_m)| per_m);
    let unit = if scene.units.is_rotary() { "rad" } else { "m" };
    let in_range = |option: &str, typed: f64, range, unit: &str| {
        within(option, typed, range).map_err(|error| Error::Input(format!("{error} {unit}")))
    };
    let length = |option: &str, typed: f64, range: std::ops::RangeInclusive<f64>| {
        let [low, high] = [range.start(), range.end()].map(|end| end * per_m);
        in_range(option, typed, low..=high, unit).map(|()| typed / per_m)
    };
    if let Some(rest) = args.rest_position {
        options.rest_position_m = Some(length("--rest-position", rest, ranges::POSITION_M)?);
    }
    if let Some(cycle) = args.encoder_cycle {
        options.cycle_m = Some(length("--encoder-cycle", cycle, CYCLE_M)?);
    }
    if let Some(latency) = args.latency {
        in_range("--latency", latency, ranges::LATENCY, "samples")?;
        options.latency_s = latency / scene.control.rate_hz;
    }
    if let Some(resolution) = args.resolution {
        options.resolution_m = match resolution {
            0.0 => 0.0,
            typed => length("--resolution", typed, RESOLUTION_M)?,
        };
    }
    for (option, time_s) in [("--from", args.from), ("--to", args.to)] {
        in_range(option, time_s.unwrap_or(0.0), -1e9..=1e9, "s")?;
    }
    // Refuses it before any record is read.
    options.gain.known_n_per_v().map_err(|error| Error::Input(scene.units.text(&error)))?;
    Ok(options)
}

/// A record from a file of any of the accepted forms.
fn read(
    path: &Path,
    args: &IdentifyArgs,
    scene: &Scene,
    options: &Options,
) -> Result<Record, Error> {
    let name = path.display().to_string();
    let bytes = input::read(path, input::RECORD)?;
    let span = Span { from_s: args.from, to_s: args.to };
    let scale = OutputScale::of_scene(scene, options.resolution_m)
        .map_err(|error| Error::Input(error).of(&args.base))?;
    let telemetry = |header: &str| header.contains("position_counts");
    let record = match std::str::from_utf8(&bytes) {
        Ok(text) if text.lines().next().is_some_and(telemetry) => {
            identify::from_capture_csv(&name, text, &scale, span)
        }
        Ok(text) if scene.units.is_rotary() => {
            Record::from_rotary_csv(&name, text, span, scene.units.radius_m())
        }
        Ok(text) => Record::from_csv(&name, text, span),
        Err(_) => identify::from_capture(&name, &bytes, &scale, span),
    };
    record.map_err(|error| Error::Input(error).of(&name))
}

/// The base scene with what was identified.
fn scene(base: &Scene, found: &Identification, options: &Options, args: &IdentifyArgs) -> Scene {
    let mut scene = base.clone();
    scene.device.mass_kg = found.mass_kg.value;
    scene.device.damping_n_s_per_m = found.damping_n_s_per_m.value.max(0.0);
    scene.device.stiffness_n_per_m = 0.0;
    if let Some(spring) = &found.spring {
        scene.device.stiffness_n_per_m = spring.stiffness_n_per_m.value;
        scene.device.rest_position_m = spring.rest_position_m.value;
    }
    scene.actuator.gain_n_per_v = found.gain_n_per_v.value;
    // A latency that was said belongs to the log (0 for a voltage measured at the motor); the loop's
    // is another, and a shorter one would promise walls that the device cannot render.
    if args.fit_latency {
        scene.actuator.latency = (found.latency_s.value * scene.control.rate_hz).max(0.0);
    }
    if options.resolution_m > 0.0 {
        scene.encoder.resolution_m = options.resolution_m;
    }
    with_terms(scene, &found.terms)
}

/// The terms as elements of the scene. What only an integrator can do gets one, with as few steps as it takes.
fn with_terms(mut scene: Scene, terms: &identify::Found) -> Scene {
    if let Some(friction) = terms.friction_n {
        let coulomb_n = friction.value;
        // Static friction and the fall between the two are not in a record of a moving handle.
        scene.friction =
            Some(Friction { coulomb_n, static_n: coulomb_n, stribeck_speed_m_per_s: 1e-3 });
        if scene.integrator.is_none() {
            let steps = (0..=12).map(|n| Integrator::Rk4 { steps_per_sample: 1 << n });
            let mut scenes = steps.map(|steps| Scene { integrator: Some(steps), ..scene.clone() });
            let found = scenes.find(|scene| scene.check().is_ok());
            scene.integrator = found
                .and_then(|scene| scene.integrator)
                .or(Some(Integrator::Rk4 { steps_per_sample: 1 }));
        }
    }
    if let Some(lag) = terms.lag_s {
        scene.amplifier = Some(Amplifier { bandwidth_hz: 1.0 / (TAU * lag.value) });
    }
    if let Some(offset) = terms.offset_n {
        scene.offset = Some(Offset { force_n: offset.value });
    }
    if let Some(phase) = &terms.phase {
        scene.encoder_error = Some(EncoderError {
            cycle_m: phase.cycle_m.value,
            first_m: phase.first_m.value,
            second_m: phase.second_m.value.max(0.0),
            phase_rad: phase.phase_rad.value,
        });
    }
    scene
}

/// The result with the scene that it makes, in the units and keys of that scene's own file.
#[derive(Serialize)]
struct WithScene<'a> {
    #[serde(flatten)]
    rest: InUnits<Json<'a>>,
    scene: Made<'a>,
}

/// The scene that it makes.
#[derive(Serialize)]
#[serde(untagged)]
enum Made<'a> {
    Linear(&'a Scene),
    Rotary(toml::Table),
}

fn scene_text(
    made: &Made<'_>,
    notes: &[String],
    found: &Identification,
    options: &Options,
    records: &[Record],
    units: Units,
) -> Result<String, Error> {
    let tables = toml::to_string(made)
        .map_err(|error| Error::Internal(format!("cannot write the scene: {error}")))?;
    let mut text = format!("# Identified by `cargo sim identify` from {}.\n", of_records(records));
    for row in told::rows(found, options, units) {
        let _ = writeln!(text, "# {}", row.text());
    }
    for warning in found.warnings.iter().chain(notes) {
        let _ = writeln!(text, "# Warning: {warning}.");
    }
    Ok(format!("{text}\n{tables}"))
}

/// Names of the records on one line.
fn of_records(records: &[Record]) -> String {
    let names = records.iter().map(|record| printable(&record.name, false));
    names.collect::<Vec<_>>().join(", ")
}
