//! Measures all filters at all cutoffs.

use std::sync::atomic::{AtomicBool, Ordering};

use filter_forms::{Form, Format, Prototype};
use rayon::prelude::*;

use super::{
    Bench, Criterion, Refused, Variant,
    area::{self, Areas},
    cost,
    criterion::{Exact, Measured},
    drift,
    headroom::Reversal,
    noise::{Motions, Noise},
    response::{HIGHEST, Tones},
    rest,
};
use crate::{error::Error, scene::Scene};

#[derive(Clone, Debug, PartialEq)]
pub struct FilterRow {
    pub variant: Variant,
    pub cutoff: usize,
    /// Measured values, or the reason why the format cannot have the cutoff.
    pub measured: Result<Measured, Refused>,
    /// Criteria that the filter exceeds. Empty if the filter is good enough or refused.
    pub missed: Vec<Criterion>,
}

impl FilterRow {
    pub fn would_do(&self) -> bool {
        self.measured.is_ok() && self.missed.is_empty()
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct Filters {
    /// The reference values. There is one entry per cutoff.
    pub exact: Vec<Exact>,
    /// Rows in the order of [`Variant::ALL`]. Within a variant, the cutoffs ascend.
    pub rows: Vec<FilterRow>,
    /// Time of one update on this machine for each variant, in ns.
    pub host_ns: Vec<f64>,
}

/// The variant whose areas are the reference, because it is nearest to the exact filter.
pub const REFERENCE: Variant = Variant { format: Format::F64, form: Form::StateVariable };

/// Cutoff at which the time of an update on this machine is measured, as a share of the sample rate. Every format can
/// have this cutoff.
const TIMED_AT: f64 = 0.15;

/// Measures all filters. `done` is called after each walk and each filter.
///
/// # Errors
/// The handle does not reach the wall, or `stop` was set.
pub fn measure(
    scene: &Scene,
    cutoffs_hz: &[f64],
    repeats: u32,
    stop: &AtomicBool,
    done: impl Fn() + Sync,
) -> Result<Filters, Error> {
    let bench = Bench::of(scene);
    let signals: Option<Vec<Signals>> = cutoffs_hz
        .par_iter()
        .with_max_len(1)
        .map(|&cutoff_hz| at_cutoff(&bench, cutoff_hz, stop, &done))
        .collect();
    let signals = signals.ok_or(Error::Interrupted)?;
    let prepared = area::prepare(scene)?;
    let areas = area::measure(&prepared, &bench, cutoffs_hz, repeats, stop, &done)?;
    let place = |variant: usize, cutoff: usize| variant * cutoffs_hz.len() + cutoff;
    let reference = Variant::ALL.iter().position(|v| *v == REFERENCE).unwrap_or(0);
    let none = Areas(vec![]);
    let exact: Vec<Exact> = signals
        .iter()
        .enumerate()
        .map(|(cutoff, (encoder, _))| {
            let areas = areas[place(reference, cutoff)].as_ref().unwrap_or(&none);
            let cutoff_hz = cutoffs_hz[cutoff];
            Exact {
                cutoff_hz,
                has_cutoff: Prototype::new(cutoff_hz, bench.rate_hz).true_cutoff() <= HIGHEST,
                encoder: *encoder,
                area: areas.mean(),
                area_spread: areas.spread(),
            }
        })
        .collect();
    let mut rows = vec![];
    for (number, &variant) in Variant::ALL.iter().enumerate() {
        for cutoff in 0..cutoffs_hz.len() {
            let mut measured = signals[cutoff].1[number].clone();
            if let (Ok(measured), Some(own)) = (&mut measured, &areas[place(number, cutoff)]) {
                let reference = areas[place(reference, cutoff)].as_ref().unwrap_or(&none);
                measured.area = Some(own.mean());
                measured.area_change = own.change(reference);
            }
            let missed = measured.as_ref().map_or(vec![], |measured| {
                let missed = |c: &Criterion| c.missed(measured, &exact[cutoff]);
                Criterion::ALL.into_iter().filter(missed).collect()
            });
            rows.push(FilterRow { variant, cutoff, measured, missed });
        }
    }
    let host_ns = Variant::ALL.iter().map(|&variant| {
        let filter = bench.filter(variant, TIMED_AT * bench.rate_hz);
        filter.map_or(f64::NAN, |filter| cost::host_ns(&filter))
    });
    Ok(Filters { exact, rows, host_ns: host_ns.collect() })
}

/// The noise that the encoder causes in the exact output, and the measured values of each variant.
type Signals = (Noise, Vec<Result<Measured, Refused>>);

/// Measures all variants at one cutoff. Returns `None` if `stop` was set.
fn at_cutoff(
    bench: &Bench,
    cutoff_hz: f64,
    stop: &AtomicBool,
    done: &(impl Fn() + Sync),
) -> Option<Signals> {
    let tones = Tones::new(bench, cutoff_hz);
    let motions = Motions::new(bench, cutoff_hz);
    let reversal = Reversal::new(bench, cutoff_hz);
    let measure = |&variant: &Variant| {
        if stop.load(Ordering::Relaxed) {
            return None;
        }
        let measured = bench.filter(variant, cutoff_hz).map(|filter| Measured {
            response: tones.measure(&filter),
            drift_counts: drift::measure(bench, &filter, cutoff_hz),
            noise: motions.measure(&filter),
            rest_counts: rest::measure(bench, &filter, cutoff_hz),
            headroom_counts: reversal.measure(&filter),
            area: None,
            area_change: None,
        });
        done();
        Some(measured)
    };
    let measured = Variant::ALL.par_iter().with_max_len(1).map(measure).collect::<Option<_>>()?;
    Some((motions.encoder, measured))
}
