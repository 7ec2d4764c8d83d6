//! `hit`: one wall hit.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::{
    Common,
    conditions::Judged,
    shared::{AtCutoff, Subject},
};
use crate::{
    error::Error,
    notation::rounded,
    output::{estimated::print_of, table::Kind, trace},
    scene::velocity::describe,
    simulation::{prepared::HitReport, trace::Trace},
    study::asked::prepare,
};

/// Hits one wall, and says whether the wall is stable.
#[derive(Debug, Args)]
pub struct HitArgs {
    #[command(flatten)]
    at: AtCutoff,
    #[command(flatten)]
    judged: Judged,
    /// Stiffness of the wall in N/m, or in N m/rad for a rotary scene.
    #[arg(long, value_name = "K", allow_negative_numbers = true)]
    stiffness: f64,
    /// Damping of the wall in N s/m, or in N m s/rad for a rotary scene.
    #[arg(long, value_name = "B", allow_negative_numbers = true)]
    damping: f64,
    /// Write every sample as CSV.
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
    /// Draw the true position over time; .svg or .png. The figure gives the RMS of the counts.
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
}

#[derive(Serialize)]
struct Json<'a> {
    #[serde(flatten)]
    subject: Subject<'a>,
    stiffness_n_per_m: f64,
    damping_n_s_per_m: f64,
    verdict: &'static str,
    stable: bool,
    rms_m: f64,
    mean_m: f64,
    peak_penetration_m: f64,
    saturated_fraction: f64,
    contact_fraction: f64,
    velocity_clipped_fraction: f64,
    criterion: &'static str,
    /// Protocol of the hit. It is left out if it is the paper's protocol.
    #[serde(skip_serializing_if = "Option::is_none")]
    protocol: Option<&'static str>,
    rms_of: &'static str,
    rms_motion_m: f64,
    window_at_limit_fraction: f64,
    /// Sensation level of the motion, in dB. `null` if the window cannot have one.
    sensation_db: Option<f64>,
    force_rms_n: f64,
    /// Penetration ratio of the window. `null` if the wall gave no force.
    penetration_ratio: Option<f64>,
    /// One entry for each push that the test of the wall needs.
    pushes: Vec<Push>,
    /// Energy that the wall has taken in the last contact, in J. It is computed from the wall's force and the counts.
    port_taken_j: f64,
    /// Largest net energy that the wall has given in any contact, in J.
    port_given_j: f64,
    /// Fraction of the outputs in contact that the passivity controller changed. `port_withheld_fraction` is the
    /// fraction of the force that the controller withheld.
    #[serde(skip_serializing_if = "Option::is_none")]
    port_limited_fraction: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    port_withheld_fraction: Option<f64>,
}

/// Results of a hit at one push.
#[derive(Serialize)]
struct Push {
    push_n: f64,
    verdict: &'static str,
    rms_m: f64,
    rms_motion_m: f64,
    force_rms_n: f64,
    penetration_ratio: Option<f64>,
}

pub fn run(args: &HitArgs, common: &Common) -> Result<(), Error> {
    let (mut scene, hit) = args.at.load(Some([args.stiffness, args.damping]))?;
    args.judged.apply(&mut scene)?;
    let units = scene.scene.units;
    let kind = Kind::Moments { rate_hz: scene.scene.control.rate_hz };
    let mut outputs = common.outputs(&scene.files)?;
    let csv = outputs.table(args.trace.as_ref(), kind, Some(&scene))?;
    let plot = outputs.figure(args.plot.as_ref())?;
    let prepared = prepare(&scene)?.with_felt();
    let numeric = common.numeric;
    let pushes = if csv.is_none() && plot.is_none() {
        prepared.reports(numeric, &hit, |_| ())?
    } else {
        let mut samples = Trace::new(&prepared, &hit).map_err(|error| error.of(&scene.name))?;
        let pushes = prepared.reports(numeric, &hit, |sample| samples.push(sample))?;
        outputs.tell(csv, units, || trace::csv(&samples))?;
        outputs.draw(plot, || trace::figure(&samples, &scene, &hit, &deciding(&pushes)?))?;
        pushes
    };
    outputs.commit()?;
    let report = deciding(&pushes)?;
    let passive = scene.scene.passivity.is_some();
    let json = Json {
        subject: Subject::new(&scene, &hit.velocity, common),
        stiffness_n_per_m: hit.stiffness_n_per_m,
        damping_n_s_per_m: hit.damping_n_s_per_m,
        verdict: report.verdict.name(),
        stable: report.is_stable(),
        rms_m: report.rms_m,
        mean_m: report.mean_m,
        peak_penetration_m: report.peak_penetration_m,
        saturated_fraction: report.saturated_fraction,
        contact_fraction: report.contact_fraction,
        velocity_clipped_fraction: report.velocity_clipped_fraction,
        criterion: scene.scene.wall_hit.criterion.name(),
        protocol: scene.scene.wall_hit.protocol.named(),
        rms_of: scene.scene.wall_hit.rms_of().name(),
        rms_motion_m: report.rms_motion_m,
        window_at_limit_fraction: report.at_limit_fraction,
        sensation_db: report.sensation_db,
        force_rms_n: report.force_rms_n,
        penetration_ratio: report.penetration_ratio,
        pushes: pushes
            .iter()
            .map(|&(push_n, of)| Push {
                push_n,
                verdict: of.verdict.name(),
                rms_m: of.rms_m,
                rms_motion_m: of.rms_motion_m,
                force_rms_n: of.force_rms_n,
                penetration_ratio: of.penetration_ratio,
            })
            .collect(),
        port_taken_j: report.port.taken_j,
        port_given_j: report.port.given_j,
        port_limited_fraction: passive.then_some(report.port.limited_fraction),
        port_withheld_fraction: passive.then_some(report.port.withheld_fraction),
    };
    let judged_m = if json.rms_of == "counts" { json.rms_m } else { json.rms_motion_m };
    let limit = match json.sensation_db {
        Some(_) if json.criterion == "felt" => String::new(),
        _ => format!(" (limit {} um)", rounded(scene.scene.rms_limit_m() * 1e6, 4)),
    };
    let clipped = json.velocity_clipped_fraction * 100.0;
    let note = (clipped > 0.0)
        .then(|| format!("\nvelocity at the end of its range in {clipped:.2} % of the samples"));
    let mut window = format!(
        "RMS of the counts {:.3} um, of the motion {:.3} um, outputs of the window at the limit {:.2} %",
        json.rms_m * 1e6,
        json.rms_motion_m * 1e6,
        json.window_at_limit_fraction * 100.0
    );
    if let Some(level_db) = json.sensation_db {
        let curve = match scene.scene.wall_hit.felt.text() {
            None => "the built-in model of what a hand feels",
            Some(_) => "wall_hit.felt_curve",
        };
        window += &format!(", {level_db:.1} dB over {curve}");
    }
    window += &format!("\nRMS of the force {:.3} N", json.force_rms_n);
    if let Some(ratio) = json.penetration_ratio {
        window += &format!(", K times the penetration is {ratio:.3} of the wall's force");
    }
    let mut port = format!(
        "in the last contact the wall took {} mJ; the most that it gave in a contact is {} mJ",
        rounded(1e3 * json.port_taken_j, 3),
        rounded(1e3 * json.port_given_j, 3)
    );
    if let (Some(limited), Some(withheld)) =
        (json.port_limited_fraction, json.port_withheld_fraction)
    {
        port += &format!(
            "\nits passivity controller changed {:.2} % of the outputs in contact, and withheld {:.2} % of the force",
            100.0 * limited,
            100.0 * withheld
        );
    }
    if json.criterion != "rms" || json.rms_of != "counts" {
        window += &format!("\njudged by: {}, RMS of {}", json.criterion, json.rms_of);
    }
    if json.criterion == "quiet" {
        let limit_n = scene.scene.wall_hit.force_rms_limit_n();
        window += &format!(", of the force below {limit_n:.3} N");
        for push in &json.pushes {
            window += &format!(
                "\n  pushed with {:.3} N: {}, RMS {:.3} um and {:.3} N",
                push.push_n,
                push.verdict,
                push.rms_motion_m * 1e6,
                push.force_rms_n
            );
        }
    }
    if let Some(protocol) = json.protocol {
        window += &format!("\nprotocol: {protocol}");
    }
    print_of(common.json, &scene.scene, &json, || {
        scene.scene.units.text(&format!(
            "{}: {}, RMS {:.3} um{limit}\n\
             {}, K = {} N/m, B = {} N s/m\n\
             mean {:.3} mm, peak penetration {:.3} mm, outputs saturated {:.2} %, window in contact {:.1} %\n\
             {window}\n{port}{}",
            scene.name,
            json.verdict,
            judged_m * 1e6,
            describe(&hit.velocity, scene.scene.control.rate_hz),
            json.stiffness_n_per_m,
            json.damping_n_s_per_m,
            json.mean_m * 1e3,
            json.peak_penetration_m * 1e3,
            json.saturated_fraction * 100.0,
            json.contact_fraction * 100.0,
            note.unwrap_or_default()
        ))
    })
}

fn deciding(pushes: &[(f64, HitReport)]) -> Result<HitReport, Error> {
    HitReport::deciding(pushes).ok_or_else(|| Error::Internal("a hit has no push".into()))
}
