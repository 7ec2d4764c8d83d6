//! Every sample of one hit, as CSV and as a figure.

use std::fmt::Write as _;

use crate::{
    error::Error,
    output::figure::{Figure, TracePlot, hit_trace},
    scene::NamedScene,
    simulation::{
        Sample,
        controller::Controller as _,
        prepared::{HitReport, PreparedScene, WallHit},
    },
};

/// Bit of the `flags` column: the handle is inside the wall.
pub const CONTACT: u8 = 1;
/// Bit of the `flags` column: an output was computed with this sample.
pub const RENDERED: u8 = 2;
/// Bit of the `flags` column: the last output saturated.
pub const SATURATED: u8 = 4;

/// Most samples of a trace: 200 s at 10 kHz, about half a gigabyte with the CSV.
const SAMPLES_MAX: u64 = 2_000_000;

/// Samples of a hit.
fn samples(prepared: &PreparedScene) -> u64 {
    u64::from(prepared.plan().settle) + u64::from(prepared.plan().window)
}

/// One hit, sample by sample.
#[derive(Clone, Debug)]
pub struct Trace {
    rate_hz: f64,
    velocity_lsb_m_per_s: f64,
    full_scale_n: f64,
    surface: i32,
    rows: Vec<Row>,
}

#[derive(Clone, Copy, Debug)]
struct Row {
    position_m: f64,
    count: i32,
    velocity_m_per_s: f64,
    force_n: f64,
    output_n: f64,
    flags: u8,
}

impl Trace {
    /// Why a hit of that scene is too long to be kept sample by sample, if it is.
    pub fn refused(prepared: &PreparedScene) -> Option<String> {
        let samples = samples(prepared);
        (samples > SAMPLES_MAX).then(|| {
            format!(
                "wall_hit.settle_s and wall_hit.window_s make {samples} samples, allowed {SAMPLES_MAX} in a trace"
            )
        })
    }

    /// An empty trace of that hit.
    ///
    /// # Errors
    /// A setting of `hit` is out of range, or the hit is too long.
    pub fn new(prepared: &PreparedScene, hit: &WallHit) -> Result<Self, Error> {
        if let Some(reason) = Self::refused(prepared) {
            return Err(Error::Input(reason));
        }
        let design = prepared.design();
        Ok(Self {
            rate_hz: design.rate_hz,
            velocity_lsb_m_per_s: design.resolution_m * design.rate_hz,
            full_scale_n: design.full_scale_n,
            surface: prepared.fixed(hit).map_err(Error::input)?.controller().surface(),
            rows: Vec::with_capacity(usize::try_from(samples(prepared)).unwrap_or_default()),
        })
    }

    /// Takes one sample.
    pub fn push(&mut self, sample: &Sample) {
        let (held_n, held_flag) =
            self.rows.last().map_or((0.0, 0), |row| (row.force_n, row.flags & SATURATED));
        let (force_n, flags) = match sample.rendered {
            Some(rendered) => (
                rendered.force * self.full_scale_n,
                RENDERED | if rendered.saturated { SATURATED } else { 0 },
            ),
            None => (held_n, held_flag),
        };
        self.rows.push(Row {
            position_m: sample.position_m,
            count: sample.count,
            velocity_m_per_s: sample.velocity * self.velocity_lsb_m_per_s,
            force_n,
            output_n: sample.output_n,
            flags: flags | if sample.count > self.surface { CONTACT } else { 0 },
        });
    }

    /// One row per sample. `force_n` is the force that the controller asks for, held from output to
    /// output; `output_n` is the force on the handle at the end of the sample, after latency and
    /// output quantisation; `flags` is the sum of [`CONTACT`], [`RENDERED`] and [`SATURATED`].
    pub fn csv(&self) -> String {
        let mut text =
            String::from("time_s,position_m,count,velocity_m_per_s,force_n,output_n,flags\n");
        for (n, row) in self.rows.iter().enumerate() {
            #[expect(clippy::cast_precision_loss, reason = "at most 2^25 samples")]
            let time_s = n as f64 / self.rate_hz;
            let Row { position_m, count, velocity_m_per_s, force_n, output_n, flags } = row;
            let _ = writeln!(
                text,
                "{time_s},{position_m},{count},{velocity_m_per_s},{force_n},{output_n},{flags}"
            );
        }
        text
    }

    /// Position over time, with settle phase and window.
    pub fn figure(
        &self,
        scene: &NamedScene,
        hit: &WallHit,
        report: &HitReport,
    ) -> Result<Figure, Error> {
        let wall_hit = &scene.scene.wall_hit;
        Ok(hit_trace(&TracePlot {
            title: format!("Wall hit, {}", scene.name),
            subtitle: format!(
                "K = {} N/m, B = {} N s/m, {}",
                hit.stiffness_n_per_m,
                hit.damping_n_s_per_m,
                scene.scene.velocity.describe(hit.cutoff_hz, scene.scene.control.rate_hz)
            ),
            rate_hz: self.rate_hz,
            positions_m: self.rows.iter().map(|row| row.position_m).collect(),
            wall_m: scene.scene.wall.position_m,
            settle_s: wall_hit.settle_s,
            window_s: wall_hit.window_s,
            rms_limit_m: wall_hit.rms_limit_m,
            verdict: report.verdict.text().into(),
            rms_m: report.rms_m,
        })?)
    }
}
