//! Every velocity estimator, tuned by the same search on the same boundary, and what each of them
//! costs.
//!
//! * [`search`]: the tuning with the largest Z-width area, by the same number of walks for each;
//! * [`signal`]: delay and noise of the estimator alone, on prescribed motions;
//! * [`contact`]: what the hand feels of it: how rough the force is in contact, and how far the
//!   rendered impedance is from the commanded one;
//! * [`cost`]: cycles and memory on the Cortex-M4.
//!
//! The core itself runs in all of them.

pub mod contact;
pub mod cost;
pub mod search;
pub mod signal;
pub mod table;

use std::sync::atomic::AtomicBool;

use rayon::prelude::*;
use zwidth::{
    VelocitySettings,
    velocity::{EstimatorName, Sense},
};

pub use contact::Contact;
pub use cost::Cost;
pub use search::Tuned;
pub use signal::Signal;

use crate::{
    error::Error,
    rig::{Numeric, Rig},
    scene::Scene,
    velocity::Velocity,
};

/// An estimator in the comparison.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Entry {
    /// Tuned by the search.
    Tuned(EstimatorName),
    /// As it is often set without thinking: a first-order low-pass at 50 Hz.
    AdHoc,
}

/// The acceleration only with an accelerometer, hence last.
const ALL_SENSES: &[Sense] = &[Sense::Force, Sense::Edge, Sense::Acceleration];

/// Cutoff of [`Entry::AdHoc`], Hz.
const AD_HOC_HZ: f64 = 50.0;

impl Entry {
    /// Every estimator that the scene can feed, each once (pre-warping moves a cutoff, nothing else),
    /// and the ad-hoc one last.
    pub fn all(scene: &Scene) -> Vec<Self> {
        let twice = [EstimatorName::ButterworthPrewarped, EstimatorName::FirstOrderPrewarped];
        let can = |name: &EstimatorName| {
            let acceleration = scene.accelerometer.is_some();
            name.missing(if acceleration { ALL_SENSES } else { &ALL_SENSES[..2] }).is_none()
        };
        let tuned = EstimatorName::ALL.iter().filter(|name| !twice.contains(name) && can(name));
        tuned.map(|&name| Self::Tuned(name)).chain([Self::AdHoc]).collect()
    }

    /// Name in tables.
    pub fn name(self) -> String {
        match self {
            Self::Tuned(name) => name.text().into(),
            Self::AdHoc => format!("first-order at {AD_HOC_HZ} Hz"),
        }
    }
}

/// Where the boundaries are read off, and the wall at which force is compared.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// B at which K is read off each boundary, N s/m.
    pub damping_n_s_per_m: f64,
    /// K of the wall at which contacts are compared, N/m; B is the one above.
    pub stiffness_n_per_m: f64,
}

/// All about one estimator.
#[derive(Clone, Debug, PartialEq)]
pub struct Compared {
    /// Which one.
    pub entry: Entry,
    /// Its settings after the search.
    pub settings: VelocitySettings,
    /// The search and the boundaries at its result.
    pub tuned: Tuned,
    /// Delay and noise.
    pub signal: Signal,
    /// In contact.
    pub contact: Contact,
    /// On the Cortex-M4; `None` if it was not measured.
    pub cost: Option<Cost>,
}

/// The scene with that estimator, and the cutoff to run it with.
pub fn with_estimator(scene: &Scene, settings: &VelocitySettings) -> (Scene, f64) {
    let (velocity, cutoff_hz) = Velocity::of(settings);
    let mut scene = scene.clone();
    scene.velocity = velocity;
    if let Some(cutoff_hz) = cutoff_hz {
        scene.sweep.cutoffs_hz = vec![cutoff_hz];
    }
    (scene, cutoff_hz.unwrap_or(0.0))
}

/// Compares `entries`. The first of them, tuned, also gives the wall at which contacts are compared:
/// half of the K that it reaches at `damping_n_s_per_m`. `done` is called after each walk.
///
/// # Errors
/// The handle does not reach the wall, or `stop` was set.
pub fn compare(
    scene: &Scene,
    entries: &[Entry],
    damping_n_s_per_m: f64,
    budget: search::Budget,
    stop: &AtomicBool,
    done: impl Fn() + Sync,
) -> Result<(Place, Vec<Compared>), Error> {
    let found: Vec<Result<(VelocitySettings, Tuned), Error>> = entries
        .par_iter()
        .with_max_len(1)
        .map(|&entry| {
            let start = settings_of(entry, scene);
            let fixed = entry == Entry::AdHoc;
            search::tune(scene, &start, fixed, budget, stop, &done)
        })
        .collect();
    let found = found.into_iter().collect::<Result<Vec<_>, Error>>()?;
    let reference = found.first().and_then(|(_, tuned)| tuned.stiffness_at(damping_n_s_per_m));
    let plan = scene.walk_plan();
    let place = Place {
        damping_n_s_per_m,
        stiffness_n_per_m: reference.map_or(plan.stiffness_start_n_per_m, |k| k / 2.0),
    };
    let compared: Vec<Result<Compared, Error>> = entries
        .par_iter()
        .zip(found)
        .map(|(&entry, (settings, tuned))| {
            let (with, cutoff_hz) = with_estimator(scene, &settings);
            let rig = Rig::new(&with)?;
            let signal = signal::measure(&with, cutoff_hz).map_err(Error::input)?;
            let contact = contact::measure(&rig, Numeric::Fixed, cutoff_hz, &place)?;
            let cost = cost::of(settings.name());
            Ok(Compared { entry, settings, tuned, signal, contact, cost })
        })
        .collect();
    Ok((place, compared.into_iter().collect::<Result<_, _>>()?))
}

/// Where the search starts. What is known of the device is told: the observer gets its mass.
fn settings_of(entry: Entry, scene: &Scene) -> VelocitySettings {
    match entry {
        Entry::Tuned(name) => match name.defaults() {
            VelocitySettings::Observer { bandwidth_hz, .. } => {
                VelocitySettings::Observer { bandwidth_hz, mass_kg: scene.device.mass_kg }
            }
            defaults => defaults,
        },
        Entry::AdHoc => VelocitySettings::FirstOrder { cutoff_hz: AD_HOC_HZ, prewarp: false },
    }
}
