//! Stores every sample of one hit.

use crate::{
    error::Error,
    simulation::{
        Sample,
        controller::Controller as _,
        port::PortWatch,
        prepared::{PreparedScene, WallHit},
    },
};

/// Bit of the flags: the handle is inside the wall.
pub const CONTACT: u8 = 1;
/// Bit of the flags: an output was computed with this sample.
pub const RENDERED: u8 = 2;
/// Bit of the flags: the last output saturated.
pub const SATURATED: u8 = 4;

/// Largest number of samples in a trace: 200 s at 10 kHz, about half a gigabyte with the CSV.
const SAMPLES_MAX: u64 = 2_000_000;

fn samples(prepared: &PreparedScene) -> u64 {
    u64::from(prepared.plan().settle) + u64::from(prepared.plan().window)
}

#[derive(Clone, Debug)]
pub struct Trace {
    pub rate_hz: f64,
    velocity_lsb_m_per_s: f64,
    full_scale_n: f64,
    surface: i32,
    port: PortWatch,
    /// The samples. The first sample is at 0 s.
    pub rows: Vec<Row>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// True position of the handle, m.
    pub position_m: f64,
    pub count: i32,
    /// The controller's velocity, m/s.
    pub velocity_m_per_s: f64,
    /// Commanded force, N; constant between outputs.
    pub force_n: f64,
    /// Force on the handle at the end of the sample, after latency and output quantisation, N.
    pub output_n: f64,
    /// Sum of [`CONTACT`], [`RENDERED`] and [`SATURATED`].
    pub flags: u8,
    /// Energy that the wall has taken in this contact, J, from the wall's force and the counts. Negative if the wall
    /// has given energy.
    pub port_energy_j: f64,
}

impl Trace {
    /// Error message if a hit of this scene is too long to store every sample. Otherwise `None`.
    pub fn refused(prepared: &PreparedScene) -> Option<String> {
        let samples = samples(prepared);
        (samples > SAMPLES_MAX).then(|| {
            format!(
                "wall_hit.settle_s and wall_hit.window_s make {samples} samples, allowed {SAMPLES_MAX} in a trace"
            )
        })
    }

    /// An empty trace for this hit.
    ///
    /// # Errors
    /// A setting of `hit` is out of range, or the hit is too long.
    pub fn new(prepared: &PreparedScene, hit: &WallHit) -> Result<Self, Error> {
        if let Some(reason) = Self::refused(prepared) {
            return Err(Error::Input(reason));
        }
        let design = prepared.design();
        let surface = prepared.fixed(hit).map_err(Error::input)?.controller().surface();
        Ok(Self {
            rate_hz: design.rate_hz,
            velocity_lsb_m_per_s: design.resolution_m * design.rate_hz,
            full_scale_n: design.full_scale_n,
            surface,
            port: prepared.port_watch(hit, surface),
            rows: Vec::with_capacity(usize::try_from(samples(prepared)).unwrap_or_default()),
        })
    }

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
        self.port.sample(sample);
        self.rows.push(Row {
            position_m: sample.position_m,
            count: sample.count,
            velocity_m_per_s: sample.velocity * self.velocity_lsb_m_per_s,
            force_n,
            output_n: sample.output_n,
            flags: flags | if sample.count > self.surface { CONTACT } else { 0 },
            port_energy_j: self.port.report(sample.count).taken_j,
        });
    }
}
