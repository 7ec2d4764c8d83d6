//! `identify`: the parameters of a device from recorded voltage and position.

mod json;
mod plan;

use std::{
    f64::consts::TAU,
    fmt::Write as _,
    path::{Path, PathBuf},
};

use clap::{Args, ValueEnum};

use self::json::Json;
use super::Common;
use crate::{
    analysis::identify::{
        self, CONFIDENCE, Estimate, Gain, Identification, Options, OutputScale, Record, Span,
        Terms, Tested,
    },
    error::{Error, printable},
    input,
    numerics::integrator::Integrator,
    output::{
        figure::{self, ResponsePlot},
        files::Outputs,
        terminal::print_result,
    },
    range::within,
    scene::{
        NamedScene, Scene,
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
    /// Records: CSV with the columns time_s,voltage_v,position_m, a telemetry capture, or the CSV that `telemetry`
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
    /// Where the spring rests without any other force, m: a constant force can then be told from it.
    #[arg(long, value_name = "M", allow_negative_numbers = true, conflicts_with = "no_spring")]
    rest_position: Option<f64>,
    /// Travel per cycle of the encoder's signals, m [default: that of the base scene's [encoder_error], else it is
    /// looked for].
    #[arg(long, value_name = "M", allow_negative_numbers = true)]
    encoder_cycle: Option<f64>,
    /// Size of a count, m; 0 for a sensor without counts [default: the base scene's].
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
    /// Force per volt, N/V.
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
    fn source(&self) -> Result<Gain, Error> {
        let Self { gain, torque_constant, amplifier_gain, drum_radius, .. } = *self;
        let Self { calibration_mass, calibration_voltage, added_mass, .. } = *self;
        if let Some(gain) = gain {
            return Ok(Gain::Given(gain));
        }
        if let (Some(torque_constant_n_m_per_a), Some(amplifier_a_per_v), Some(drum_radius_m)) =
            (torque_constant, amplifier_gain, drum_radius)
        {
            return Ok(Gain::Motor { torque_constant_n_m_per_a, amplifier_a_per_v, drum_radius_m });
        }
        if let (Some(mass_kg), Some(voltage_v)) = (calibration_mass, calibration_voltage) {
            return Ok(Gain::Weight { mass_kg, voltage_v });
        }
        added_mass.map(|mass_kg| Gain::AddedMass { mass_kg }).ok_or_else(|| {
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
    let gain = args.gain.source()?;
    let base = NamedScene::load(&args.base)?;
    let inputs = [&args.logs[..], &base.files].concat();
    let mut outputs = Outputs::new(common.force, &inputs);
    let out = outputs.option(common.out.as_ref())?;
    let file = outputs.option(args.csv.as_ref())?;
    let plot = outputs.figure(args.plot.as_ref())?;
    let options = options(args, &base.scene, gain)?;
    let records: Result<Vec<Record>, Error> =
        args.logs.iter().map(|log| read(log, args, &base.scene, &options)).collect();
    let records = records?;
    let found = identify::identify(&records, &options).map_err(Error::Input)?;
    let scene = scene(&base.scene, &found, &options, args);
    let checked = scene.check().map_err(|error| {
        Error::Input(format!("{}: with the identified device {error}", args.base))
    });
    if let Some(out) = out {
        checked?;
        outputs.write(out, scene_text(&scene, &found, &options, &records)?.as_bytes())?;
    }
    if let Some(file) = file {
        outputs.write(file, csv(&records[0], &found).as_bytes())?;
    }
    if let Some(plot) = plot {
        outputs.draw(plot, &draw(&records[0], &found)?)?;
    }
    outputs.commit()?;
    let json = Json::new(&records, &found, &options, &scene);
    print_result(common.json, json, || table(&records, &found, &options))
}

fn options(args: &IdentifyArgs, scene: &Scene, gain: Gain) -> Result<Options, Error> {
    let mut options = Options::of_scene(scene, gain);
    options.fit_latency = args.fit_latency;
    options.spring = !args.no_spring;
    options.terms = args.terms.terms();
    options.rest_position_m = args.rest_position;
    if let Some(rest_m) = args.rest_position {
        within("--rest-position", rest_m, ranges::POSITION_M).map_err(Error::Input)?;
    }
    if let Some(cycle_m) = args.encoder_cycle {
        within("--encoder-cycle", cycle_m, CYCLE_M).map_err(Error::Input)?;
        options.cycle_m = Some(cycle_m);
    }
    if let Some(latency) = args.latency {
        within("--latency", latency, ranges::LATENCY).map_err(Error::Input)?;
        options.latency_s = latency / scene.control.rate_hz;
    }
    if let Some(resolution_m) = args.resolution {
        if resolution_m != 0.0 {
            within("--resolution", resolution_m, RESOLUTION_M).map_err(Error::Input)?;
        }
        options.resolution_m = resolution_m;
    }
    for (option, time_s) in [("--from", args.from), ("--to", args.to)] {
        within(option, time_s.unwrap_or(0.0), -1e9..=1e9).map_err(Error::Input)?;
    }
    // Refuses it before any record is read.
    options.gain.known_n_per_v().map_err(Error::Input)?;
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

fn scene_text(
    scene: &Scene,
    found: &Identification,
    options: &Options,
    records: &[Record],
) -> Result<String, Error> {
    let tables = toml::to_string(scene)
        .map_err(|error| Error::Internal(format!("cannot write the scene: {error}")))?;
    let mut text = format!("# Identified by `cargo sim identify` from {}.\n", of_records(records));
    for row in rows(found, options) {
        let _ = writeln!(text, "# {}", row.text());
    }
    for warning in &found.warnings {
        let _ = writeln!(text, "# Warning: {warning}.");
    }
    Ok(format!("{text}\n{tables}"))
}

/// Names of the records on one line.
fn of_records(records: &[Record]) -> String {
    let names = records.iter().map(|record| printable(&record.name, false));
    names.collect::<Vec<_>>().join(", ")
}

/// A parameter as a reader sees it.
struct Row {
    name: &'static str,
    unit: &'static str,
    estimate: Estimate,
}

impl Row {
    /// Name, value, and the interval to two digits of its width.
    fn text(&self) -> String {
        let Self { name, unit, estimate: Estimate { value, half_width, .. } } = self;
        if *half_width == 0.0 {
            return format!("{name:<14} {value} {unit} (given)");
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let decimals = (1.0 - half_width.log10().floor()).clamp(0.0, 12.0) as usize;
        format!("{name:<14} {value:.decimals$} +- {half_width:.decimals$} {unit}")
    }
}

fn rows(found: &Identification, options: &Options) -> Vec<Row> {
    let row = |name, unit, estimate| Row { name, unit, estimate };
    let mut rows =
        vec![row("mass", "kg", found.mass_kg), row("damping", "N s/m", found.damping_n_s_per_m)];
    if let Some(spring) = &found.spring {
        rows.push(row("stiffness", "N/m", spring.stiffness_n_per_m));
        rows.push(row("rest position", "m", spring.rest_position_m));
    }
    rows.push(row("gain", "N/V", found.gain_n_per_v));
    if options.fit_latency {
        rows.push(row("latency", "s", found.latency_s));
    }
    let terms = &found.terms;
    rows.extend(terms.friction_n.map(|friction| row("friction", "N", friction)));
    rows.extend(terms.lag_s.map(|lag| row("amplifier lag", "s", lag)));
    rows.extend(terms.offset_n.map(|offset| row("offset", "N", offset)));
    if let Some(phase) = &terms.phase {
        rows.push(row("encoder error", "m", phase.first_m));
        rows.push(row("  per cycle of", "m", phase.cycle_m));
        rows.push(row("  phase at 0", "rad", phase.phase_rad));
        rows.extend((phase.second_m.half_width > 0.0).then(|| row("  twice", "m", phase.second_m)));
    }
    rows
}

fn csv(record: &Record, found: &Identification) -> String {
    let mut text = String::from("time_s,voltage_v,position_m,model_m,residual_m\n");
    let fit = &found.fits[0];
    for (index, (model_m, residual_m)) in fit.model_m.iter().zip(&fit.residual_m).enumerate() {
        let row = fit.first + index;
        let (volts, position_m) = (record.voltage_v[row], record.position_m[row]);
        let _ = writeln!(
            text,
            "{:.7},{volts},{position_m},{model_m:.9},{residual_m:.3e}",
            record.time_s(row)
        );
    }
    text
}

fn draw(record: &Record, found: &Identification) -> Result<figure::Figure, Error> {
    let fit = &found.fits[0];
    let spring = found.spring.as_ref().map_or("no spring".to_owned(), |spring| {
        let (k, x0) = (spring.stiffness_n_per_m.value, spring.rest_position_m.value);
        format!("k = {k:.4} N/m, x0 = {x0:.4} m")
    });
    let stem = Path::new(&record.name).file_stem().unwrap_or_default().to_string_lossy();
    Ok(figure::pulse_response(&ResponsePlot {
        title: format!("Measured response and identified model, {stem}"),
        subtitle: format!(
            "m = {:.4} kg, b = {:.4} N s/m, {spring}; residual {:.2} µm RMS",
            found.mass_kg.value,
            found.damping_n_s_per_m.value,
            found.residual.rms_m * 1e6
        ),
        start_s: record.start_s,
        step_s: record.step_s,
        voltage_v: record.voltage_v.clone(),
        measured_m: record.position_m.clone(),
        first: fit.first,
        model_m: fit.model_m.clone(),
        residual_m: fit.residual_m.clone(),
    })?)
}

fn table(records: &[Record], found: &Identification, options: &Options) -> String {
    let count: usize = found.fits.iter().map(|fit| fit.model_m.len()).sum();
    let percent = CONFIDENCE * 100.0;
    let mut text = format!("{}: {count} rows, {percent} % intervals", of_records(records));
    for row in rows(found, options) {
        let _ = write!(text, "\n  {}", row.text());
    }
    for Tested { term, z, p } in &found.terms.tests {
        let _ =
            write!(text, "\n  {} told from none: {z:.1} standard errors, p = {p:.1e}", term.name());
    }
    let residual = &found.residual;
    let _ = write!(text, "\nresidual {:.3} um RMS", residual.rms_m * 1e6);
    let white = if residual.is_white() { "white" } else { "not white" };
    if let (Some(rms), Some(noise)) = (residual.rms_counts, residual.noise_counts) {
        let _ = write!(text, " = {rms:.3} counts");
        if residual.is_white() || residual.is_bound_by_quantisation() {
            let _ = write!(text, ": quantisation and noise of {noise:.3} counts");
        }
    }
    let _ = write!(text, "; {white} (Ljung-Box p = {:.2e})", residual.whiteness_p);
    for warning in &found.warnings {
        let _ = write!(text, "\nwarning: {warning}");
    }
    text
}
