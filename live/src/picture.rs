//! Makes the plots of a page from the history. The values are in SI units, in short binary messages.
#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    clippy::cast_sign_loss,
    reason = "some million rows; a picture has fewer digits; exact up to 2^53 samples"
)]

use std::fmt::Write as _;

use host_sim::{
    output::in_units::csv,
    scene::{Scene, Units},
};

use crate::{
    history::{Bin, History, SIGNALS},
    hub::Hub,
    spectrum,
};

/// Number of rows in a spectrum.
const SPECTRUM_ROWS: u16 = 8192;
/// Number of rows in a phase plane.
const PHASE_ROWS: u64 = 2048;
const BANDS: u32 = 240;

/// Factors that convert the control loop's integers to SI units.
#[derive(Clone, Copy, Debug)]
pub struct Scale {
    /// One LSB of position, velocity and force, in m, m/s and N.
    pub lsb: [f64; SIGNALS],
    pub rate_hz: f64,
    pub resolution_m: f64,
    /// Force at full command in N.
    pub full_scale_n: f64,
}

impl Scale {
    pub fn of(scene: &Scene) -> Self {
        let (resolution_m, rate_hz) = (scene.encoder.resolution_m, scene.control.rate_hz);
        let full_scale_n = scene.full_scale_n();
        let velocity = resolution_m * rate_hz / 65_536.0;
        let lsb = [resolution_m, velocity, full_scale_n / f64::from(1u32 << 30)];
        Self { lsb, rate_hz, resolution_m, full_scale_n }
    }

    fn of_row(&self, signal: usize, value: i32) -> f32 {
        (f64::from(value) * self.lsb[signal]) as f32
    }
}

#[derive(Clone, Copy, Debug)]
pub struct View {
    pub span_s: f64,
    /// Largest number of columns of the plot.
    pub columns: u64,
    /// Number of the row at which the view ends. With `None`, the view ends at the newest row.
    pub end: Option<u64>,
}

/// Number of rows in a time span.
pub fn rows_of(history: &History, scale: &Scale, span_s: f64) -> u64 {
    (span_s * scale.rate_hz / history.step() as f64).ceil() as u64
}

/// The smallest and largest values in each column. The message begins with a head of 32 bytes. The head has the
/// message's kind, which is 1, and the number of columns, as u32. Then it has the first row, the rows per column and the
/// samples per row, as f64. After the head come six arrays of f32, and the flags as f32.
pub fn curves(history: &History, scale: &Scale, view: &View) -> Vec<u8> {
    let rows = rows_of(history, scale, view.span_s);
    let stride = History::stride(rows, view.columns);
    let end = view.end.unwrap_or(history.rows()[1]);
    let first = end.saturating_sub(rows) / stride * stride;
    let count = usize::try_from((end - first).div_ceil(stride)).unwrap_or_default();
    let bins = history.bins(first, stride, count);
    let mut bytes = Vec::with_capacity(32 + 28 * count);
    put(&mut bytes, [1, count]);
    for number in [first as f64, stride as f64, history.step() as f64] {
        bytes.extend(number.to_le_bytes());
    }
    for signal in 0..SIGNALS {
        for end in 0..2 {
            let value = |bin: &Bin| match bin.is_empty() {
                true => f32::NAN,
                false => scale.of_row(signal, bin.ends[signal][end]),
            };
            bytes.extend(bins.iter().flat_map(|bin| value(bin).to_le_bytes()));
        }
    }
    bytes.extend(bins.iter().flat_map(|bin| f32::from(bin.flags).to_le_bytes()));
    bytes
}

/// The amplitudes of velocity and force before the row `end`. The message begins with a head of four u32: the message's
/// kind, which is 2, the number of pairs for velocity, the number of pairs for force, and 0. After the head come pairs
/// of frequency and amplitude.
pub fn spectra(history: &History, scale: &Scale, end: Option<u64>) -> Option<Vec<u8>> {
    let end = end.unwrap_or(history.rows()[1]);
    let bins = history.bins(end.checked_sub(SPECTRUM_ROWS.into())?, 1, SPECTRUM_ROWS.into());
    if bins.iter().any(Bin::is_empty) {
        return None;
    }
    let lowest_hz = scale.rate_hz / history.step() as f64 / f64::from(SPECTRUM_ROWS);
    let of = |signal: usize| {
        let value = |bin: &Bin| f64::from(bin.ends[signal][0]) * scale.lsb[signal];
        let values: Vec<f64> = bins.iter().map(value).collect();
        spectrum::bands(&spectrum::amplitudes(&values), BANDS)
    };
    let both = [of(1), of(2)];
    let mut bytes = Vec::new();
    put(&mut bytes, [2, both[0].len(), both[1].len(), 0]);
    for bands in &both {
        for (bin, amplitude) in bands {
            bytes.extend(((*bin as f64 * lowest_hz) as f32).to_le_bytes());
            bytes.extend((*amplitude as f32).to_le_bytes());
        }
    }
    Some(bytes)
}

/// The last positions and velocities. The message begins with a head of two u32: the message's kind, which is 3, and
/// the number of points. After the head come both arrays.
pub fn phase(history: &History, scale: &Scale, end: Option<u64>) -> Vec<u8> {
    let [begin, newest] = history.rows();
    let end = end.unwrap_or(newest);
    let first = end.saturating_sub(PHASE_ROWS).max(begin);
    let count = usize::try_from(end.saturating_sub(first)).unwrap_or_default();
    let bins = history.bins(first, 1, count);
    let there: Vec<&Bin> = bins.iter().filter(|bin| !bin.is_empty()).collect();
    let mut bytes = Vec::new();
    put(&mut bytes, [3, there.len()]);
    for signal in 0..2 {
        let value = |bin: &&Bin| scale.of_row(signal, bin.ends[signal][0]).to_le_bytes();
        bytes.extend(there.iter().flat_map(value));
    }
    bytes
}

fn put<const N: usize>(bytes: &mut Vec<u8>, numbers: [usize; N]) {
    for number in numbers {
        bytes.extend(u32::try_from(number).unwrap_or(u32::MAX).to_le_bytes());
    }
}

/// The rows as the text of a table, in the units of the scene.
pub fn table(hub: &Hub, scale: &Scale, units: Units, from: u64, count: u64) -> String {
    let history = hub.history();
    let [begin, end] = history.rows();
    let mut text = String::from("time_s,position_m,velocity_m_per_s,force_n,flags\n");
    for number in from.max(begin)..from.saturating_add(count).min(end) {
        let Some(row) = history.row(number) else { continue };
        let time_s = (number * history.step()) as f64 / scale.rate_hz;
        let _ = write!(text, "{time_s}");
        for (value, lsb) in row.values.iter().zip(scale.lsb) {
            let _ = write!(text, ",{}", f64::from(*value) * lsb);
        }
        let _ = writeln!(text, ",{}", row.flags);
    }
    csv(units, text)
}
