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

/// This bit of the flags says that the handle is inside the wall.
pub const CONTACT: u8 = 1;
/// This bit of the flags says that an output was computed with this sample.
pub const RENDERED: u8 = 2;
/// This bit of the flags says that the last output saturated.
pub const SATURATED: u8 = 4;

/// Largest number of samples in a trace. It is 200 s at 10 kHz, or about half a gigabyte with the CSV.
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
    /// True position of the handle in m.
    pub position_m: f64,
    pub count: i32,
    /// The controller's velocity in m/s.
    pub velocity_m_per_s: f64,
    /// Commanded force in N. It is constant between outputs.
    pub force_n: f64,
    /// Force on the handle at the end of the sample, in N. Latency and output quantisation are included.
    pub output_n: f64,
    /// Sum of [`CONTACT`], [`RENDERED`] and [`SATURATED`].
    pub flags: u8,
    /// Energy that the wall has taken in this contact, in J. It is computed from the wall's force and the counts. It is
    /// negative if the wall has given energy.
    pub port_energy_j: f64,
}

impl Trace {
    /// The error message if a hit of this scene has too many samples to store them all. Otherwise `None`.
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
