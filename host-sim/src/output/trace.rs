//! All samples of one hit, as CSV and as a figure.

use std::fmt::Write as _;

use crate::{
    error::Error,
    output::figure::{Figure, TracePlot, hit_trace},
    scene::{NamedScene, velocity::describe},
    simulation::{
        prepared::{HitReport, WallHit},
        trace::{Row, Trace},
    },
};

/// The CSV of a trace, one row per sample. The columns:
/// - `force_n`: the commanded force, constant between outputs.
/// - `output_n`: the force on the handle at the end of the sample, after latency and output quantisation.
/// - `flags`: the sum of the bits in [`trace`](crate::simulation::trace).
/// - `port_energy_j`: the energy that the wall has taken in this contact, see [`zwidth::port`].
pub fn csv(trace: &Trace) -> String {
    let mut text = String::from(
        "time_s,position_m,count,velocity_m_per_s,force_n,output_n,flags,port_energy_j\n",
    );
    for (n, row) in trace.rows.iter().enumerate() {
        let time_s = n as f64 / trace.rate_hz;
        let Row { position_m, count, velocity_m_per_s, force_n, output_n, flags, port_energy_j } =
            row;
        let _ = writeln!(
            text,
            "{time_s},{position_m},{count},{velocity_m_per_s},{force_n},{output_n},{flags},{port_energy_j}"
        );
    }
    text
}

/// Draws the position over time, with the settling phase and the window.
pub fn figure(
    trace: &Trace,
    scene: &NamedScene,
    hit: &WallHit,
    report: &HitReport,
) -> Result<Figure, Error> {
    let wall_hit = &scene.scene.wall_hit;
    let [settle_s, window_s] = wall_hit.times_s();
    Ok(hit_trace(&TracePlot {
        title: format!("Wall hit, {}", scene.name),
        units: scene.scene.units,
        subtitle: format!(
            "K = {}, B = {}, {}",
            scene.scene.units.said(hit.stiffness_n_per_m, "N/m"),
            scene.scene.units.said(hit.damping_n_s_per_m, "N s/m"),
            describe(&hit.velocity, scene.scene.control.rate_hz)
        ),
        rate_hz: trace.rate_hz,
        positions_m: trace.rows.iter().map(|row| row.position_m).collect(),
        wall_m: scene.scene.wall.position_m,
        settle_s,
        window_s,
        rms_limit_m: wall_hit.rms_limit_m,
        verdict: report.verdict.text().into(),
        rms_m: report.rms_m,
    })?)
}
