//! `identify`: finds the parameters of a device from recorded command and position.

mod plan;
mod told;

use std::{fmt::Write as _, path::PathBuf};

use clap::{Args, ValueEnum};
use serde::Serialize;
use toml::Value;

use super::Common;
use crate::{
    analysis::identify::{
        self, Asked, GainAsked, Identification, Json, Made, Options, Record, Span, Term, Terms,
    },
    error::{Error, printable},
    interrupt,
    output::{in_units::InUnits, table::Kind, terminal::print_result},
    scene::{NamedScene, Units},
};

/// Identifies mass, damping, stiffness and rest position of a device from recorded voltage and position (paper, section
/// 2.2.2), with 95 % intervals. --out SCENE.toml writes these parameters into a scene. From one record, parameters and
/// force per volt cannot be separated. Give this force as --gain, by motor and amplifier, or by a weight; or add a
/// second record with --added-mass. A record with too little information is refused, with the reason.
/// docs/identification.md says how to record.
#[derive(Debug, Args)]
pub struct IdentifyArgs {
    /// Records: CSV with time, command and position, a telemetry capture, or its CSV from `telemetry`. A column's name
    /// has quantity and unit, for example time_s or `Time (ms)`. The command is a voltage, a force, a torque or a
    /// current. Several records of one device are fitted at once.
    #[arg(required_unless_present = "plan", value_name = "LOG")]
    logs: Vec<PathBuf>,
    /// Scene of the device: encoder, voltage limit, latency, sample rate, and all other keys of a scene. Without it,
    /// give --latency or --fit-latency; the size of a count is found in the records; and the written scene takes the
    /// other keys from paper-1um.
    #[arg(long, value_name = "SCENE")]
    base: Option<String>,
    #[command(flatten)]
    gain: GainArgs,
    /// Time from a row until its command acts, in rows of the log [default: that of --base].
    #[arg(long, value_name = "ROWS", allow_negative_numbers = true)]
    latency: Option<f64>,
    /// Fit the latency too. The search begins at --latency.
    #[arg(long)]
    fit_latency: bool,
    /// The device has no spring: stiffness 0, no rest position.
    #[arg(long)]
    no_spring: bool,
    /// Without a record: print the console commands of an excitation for the base scene's device. The pulses stay
    /// within travel and speed of [safety] and the force of [motor].
    #[arg(long, conflicts_with_all = ["logs", "csv", "plot", "from", "to"])]
    plan: bool,
    #[command(flatten)]
    terms: TermArgs,
    /// Rest position of the spring without any other force, in m, or in rad with a rotary base scene. With this
    /// position, a constant force can be found too.
    #[arg(long, value_name = "M", allow_negative_numbers = true, conflicts_with = "no_spring")]
    rest_position: Option<f64>,
    /// Travel per cycle of the encoder's signals, m or rad [default: from the base scene's [encoder_error]; without
    /// this table the travel is searched].
    #[arg(long, value_name = "M", allow_negative_numbers = true)]
    encoder_cycle: Option<f64>,
    /// Size of a count in m or rad, or 0 for a sensor without counts [default: that of --base].
    #[arg(long, value_name = "M", allow_negative_numbers = true)]
    resolution: Option<f64>,
    /// Counts per turn of the encoder's axis, after quadrature, in place of --resolution. Needs a rotary base scene
    /// [default: that of --base].
    #[arg(long, value_name = "N", allow_negative_numbers = true, conflicts_with = "resolution")]
    counts_per_turn: Option<f64>,
    /// Use the records from this time stamp on, in s.
    #[arg(long, value_name = "S", allow_negative_numbers = true)]
    from: Option<f64>,
    /// Use the records up to this time stamp, in s.
    #[arg(long, value_name = "S", allow_negative_numbers = true)]
    to: Option<f64>,
    /// Predict this record with the result, and tell the error. Only its first position and speed are fitted. It is a
    /// record of the same device that the result has not seen.
    #[arg(long, value_name = "LOG")]
    check: Option<PathBuf>,
    /// Write voltage, measured position and modelled position of the first record as CSV.
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Draw measured and modelled position of the first record (the paper's figure 4); .svg or .png.
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
}

/// The terms that can be fitted in addition to mass, damping and spring.
#[derive(Debug, Args)]
struct TermArgs {
    /// `auto`: the terms that tests find in the record; `none`: only mass, damping and spring.
    #[arg(long, value_enum, default_value_t = TermsName::Auto, value_name = "WHICH")]
    terms: TermsName,
    /// Fit Coulomb friction, without a test. Then only named terms are fitted.
    #[arg(long, conflicts_with = "terms")]
    friction: bool,
    /// Fit friction that falls with the speed, and dry friction with it.
    #[arg(long, conflicts_with = "terms")]
    stribeck: bool,
    /// Fit a constant force; needs --rest-position or --no-spring.
    #[arg(long, conflicts_with = "terms")]
    offset: bool,
    /// Fit a force that is periodic in the position.
    #[arg(long, conflicts_with = "terms")]
    cogging: bool,
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
        let Self { terms, friction, stribeck, offset, cogging, amplifier, phase } = *self;
        let has = |term| match term {
            Term::Friction => friction,
            Term::Stribeck => stribeck,
            Term::Amplifier => amplifier,
            Term::Offset => offset,
            Term::Cogging => cogging,
            Term::Phase => phase,
        };
        if Term::ALL.into_iter().any(has) {
            return Terms::these(has);
        }
        match terms {
            TermsName::Auto => Terms::Auto,
            TermsName::None => Terms::NONE,
        }
    }
}

/// Options that give the force per volt. Only one way may be used.
#[derive(Debug, Args)]
struct GainArgs {
    /// Force per volt, N/V. With a rotary base scene: N m/V [default: from its [rotary]]. For a log with a current:
    /// force per ampere. For a log with a force: leave this out.
    #[arg(long, value_name = "N_PER_V", allow_negative_numbers = true, conflicts_with_all = ["torque_constant", "amplifier_gain", "drum_radius", "calibration_mass", "calibration_voltage", "added_mass"])]
    gain: Option<f64>,
    /// k_t in gain = k_t k_amp / r_c, in N m/A.
    #[arg(long, value_name = "N_M_PER_A", allow_negative_numbers = true, requires = "drum_radius", conflicts_with_all = ["calibration_mass", "calibration_voltage", "added_mass"])]
    torque_constant: Option<f64>,
    /// k_amp in gain = k_t k_amp / r_c, in A/V. For a log with a current: leave this out.
    #[arg(
        long,
        value_name = "A_PER_V",
        allow_negative_numbers = true,
        requires = "torque_constant"
    )]
    amplifier_gain: Option<f64>,
    /// r_c in gain = k_t k_amp / r_c, in m.
    #[arg(long, value_name = "M", allow_negative_numbers = true, requires = "torque_constant")]
    drum_radius: Option<f64>,
    /// Mass of a weight that the motor holds, in kg: gain = mass 9.80665 m/s^2 / voltage.
    #[arg(
        long,
        value_name = "KG",
        allow_negative_numbers = true,
        requires = "calibration_voltage",
        conflicts_with = "added_mass"
    )]
    calibration_mass: Option<f64>,
    /// Voltage at which the motor holds the weight, in V.
    #[arg(long, value_name = "V", allow_negative_numbers = true, requires = "calibration_mass")]
    calibration_voltage: Option<f64>,
    /// Mass that was added to the device for the second record, in kg. The gain is then identified too.
    #[arg(long, value_name = "KG", allow_negative_numbers = true)]
    added_mass: Option<f64>,
}

impl GainArgs {
    fn asked(&self) -> GainAsked {
        let Self { gain, torque_constant, amplifier_gain, drum_radius, .. } = *self;
        let Self { calibration_mass, calibration_voltage, added_mass, .. } = *self;
        GainAsked {
            gain,
            torque_constant,
            amplifier_gain,
            drum_radius,
            calibration_mass,
            calibration_voltage,
            added_mass,
        }
    }
}

impl IdentifyArgs {
    fn base(&self) -> &str {
        self.base.as_deref().unwrap_or("paper-1um")
    }

    /// The base scene, with the encoder's counts of the options.
    fn base_scene(&self) -> Result<NamedScene, Error> {
        let base = NamedScene::load(self.base())?;
        let Some(counts) = self.counts_per_turn else { return Ok(base) };
        let mut tables = base.table()?;
        let Some(Value::Table(rotary)) = tables.get_mut("rotary") else {
            return Err(Error::input(
                "--counts-per-turn needs a rotary scene as --base; with any other, give --resolution in m",
            ));
        };
        rotary.insert("counts_per_turn".into(), counts.into());
        let scene = NamedScene::of_table(base.name, tables, "--counts-per-turn")?;
        Ok(NamedScene { files: base.files, ..scene })
    }

    fn asked(&self) -> Asked {
        Asked {
            is_based: self.base.is_some(),
            latency: self.latency,
            fit_latency: self.fit_latency,
            spring: !self.no_spring,
            terms: self.terms.terms(),
            rest_position: self.rest_position,
            encoder_cycle: self.encoder_cycle,
            resolution: self.resolution,
            span: Span { from_s: self.from, to_s: self.to },
        }
    }
}

pub fn run(args: &IdentifyArgs, common: &Common) -> Result<(), Error> {
    if args.plan {
        return plan::run(args, common);
    }
    let base = args.base_scene()?;
    let units = base.scene.units;
    let inputs = [&args.logs[..], args.check.as_slice(), &base.files].concat();
    let moments = Kind::Moments { rate_hz: base.scene.control.rate_hz };
    let mut outputs = common.outputs(&inputs)?;
    let out = outputs.option(common.out.as_ref())?;
    let file = outputs.table(args.csv.as_ref(), moments, Some(&base))?;
    let plot = outputs.figure(args.plot.as_ref())?;
    let asked = args.asked();
    let of_base = (&base, args.base());
    let (records, options) =
        identify::read_all(&args.logs, of_base, (&asked, &args.gain.asked()), units)?;
    let found = identify::identify_in(units, &records, &options, interrupt::flag())?;
    let made = Made::new(&base, &found, &options)?;
    let checked = args.check.as_ref().map(|log| identify::check(log, of_base, &found, &options));
    let checked = checked.transpose()?.map(|(record, fit)| Checked {
        rms_m: fit.rms_m(),
        rows: fit.residual_m.len(),
        log: record.name,
    });
    if let Some(out) = out {
        let text = scene_text(&made, args.base(), &found, &options, &records, units)?;
        outputs.write(out, text.as_bytes())?;
    }
    outputs.tell(file, units, || told::csv(&records[0], &found))?;
    outputs.draw(plot, || told::draw(&records[0], &found, units))?;
    outputs.commit()?;
    let json = WithScene {
        rest: InUnits(units, Json::new(&records, &found, &options)),
        check: checked.as_ref().map(|checked| InUnits(units, checked)),
        scene: &made,
    };
    print_result(common.json, json, || {
        let checked = checked.iter().map(|Checked { log, rows, rms_m }| {
            let rms = units.said(rms_m * 1e6, "um");
            format!("\ncheck {}: {rows} rows, prediction off by {rms} RMS", printable(log, false))
        });
        let notes = made.notes.iter().map(|note| format!("\nwarning: {note}"));
        told::table(&records, &found, &options, units) + &checked.chain(notes).collect::<String>()
    })
}

/// The result, and the scene that is made from it. Both have the units and keys of the scene's file.
#[derive(Serialize)]
struct WithScene<'a> {
    #[serde(flatten)]
    rest: InUnits<Json<'a>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    check: Option<InUnits<&'a Checked>>,
    scene: &'a Made,
}

/// How well another record is predicted.
#[derive(Serialize)]
struct Checked {
    log: String,
    rows: usize,
    rms_m: f64,
}

fn scene_text(
    made: &Made,
    base_name: &str,
    found: &Identification,
    options: &Options,
    records: &[Record],
    units: Units,
) -> Result<String, Error> {
    let tables = made.named(base_name)?.text;
    let mut text = format!("# Identified by `cargo sim identify` from {}.\n", of_records(records));
    for row in told::rows(found, options, units) {
        let _ = writeln!(text, "# {}", row.text());
    }
    for warning in found.warnings.iter().chain(&made.notes) {
        let _ = writeln!(text, "# Warning: {warning}.");
    }
    Ok(format!("{text}\n{tables}"))
}

/// Names of the records in one line.
fn of_records(records: &[Record]) -> String {
    let names = records.iter().map(|record| printable(&record.name, false));
    names.collect::<Vec<_>>().join(", ")
}
