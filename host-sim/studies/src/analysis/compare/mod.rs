//! Compares all velocity estimators. The same search tunes each estimator for the area of its boundary.
//!
//! * [`search`]: finds the tuning with the largest Z-width area, by the same rule for each estimator, over the same
//!   range of [`bandwidth`]. [`tuned`] is its result.
//! * [`signal`]: delay and noise of the estimator alone, on prescribed motions.
//! * [`roughness`](mod@roughness): roughness of the force in contact.
//! * [`fidelity`]: distance of the rendered impedance from the commanded impedance.
//! * [`usable`](mod@usable): the area of the walls that are rendered as commanded, within a limit.
//! * [`cost`]: cycles and memory on the Cortex-M4.
//! * [`peers`]: the default filters of other systems, without tuning.
//! * [`table`]: all results as columns. [`winners`]: the best estimators of each criterion.
//!
//! All these parts run the core itself. Only walks of the usual low-passes run in the lanes of
//! [`engine`](crate::engine) by default, with the same bits.

pub mod axis;
pub mod bandwidth;
pub mod cost;
pub mod fidelity;
pub(super) mod looked;
pub mod peers;
pub mod roughness;
pub mod search;
pub mod signal;
pub mod table;
pub mod terminal;
pub mod tuned;
pub mod usable;
pub mod winners;

use std::sync::atomic::AtomicBool;

use rayon::prelude::*;
use zwidth::{
    VelocitySettings,
    velocity::{EstimatorName, Sense},
};

pub use cost::Cost;
pub use fidelity::Fidelity;
pub use roughness::Contact;
pub use signal::Signal;
pub use tuned::Tuned;

use crate::{
    engine::Engine,
    error::Error,
    interrupt,
    numerics::statistics::Repeats,
    scene::{LATENCY_KNOWN_MAX, NamedScene, Scene},
    simulation::prepared::{Numeric, PreparedScene},
    study::{
        boundary::{Boundaries, Boundary},
        schedule::{Length, longest_first},
        sweep::start_offset_counts,
        walk::walk,
    },
};

/// An estimator in the comparison.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Entry {
    /// An estimator that the search tunes.
    Tuned(EstimatorName),
    /// An observer that knows the latency. It gets each force when the force acts, and not when the force is granted.
    ObserverInTime,
    /// A common choice: a first-order low-pass at 50 Hz. It is not tuned.
    AdHoc,
}

const AD_HOC_HZ: f64 = 50.0;

impl Entry {
    /// The default list of estimators. It leaves out the forms that serve only as the defaults of other systems.
    pub fn usual(scene: &Scene) -> Vec<Self> {
        let mut all = Self::all(scene);
        let rare = [
            EstimatorName::SecondOrder,
            EstimatorName::Smoothing,
            EstimatorName::TrackingLead,
            EstimatorName::WindowDifference,
            EstimatorName::Biquad,
            EstimatorName::Biquad2,
        ];
        all.retain(|entry| !rare.iter().any(|name| *entry == Self::Tuned(*name)));
        all
    }

    /// Every estimator whose inputs the scene has. The ad-hoc estimator comes last. Pre-warped forms are left out,
    /// because pre-warping only changes the cutoff.
    pub fn all(scene: &Scene) -> Vec<Self> {
        let twice = [EstimatorName::ButterworthPrewarped, EstimatorName::FirstOrderPrewarped];
        let can = |name: &EstimatorName| name.sense().is_none_or(|sense| scene.feeds(sense));
        let tuned = EstimatorName::ALL.iter().filter(|name| !twice.contains(name) && can(name));
        let in_time = (1..=LATENCY_KNOWN_MAX).contains(&scene.actuator.latency_samples());
        let more = in_time.then_some(Self::ObserverInTime).into_iter().chain([Self::AdHoc]);
        tuned.map(|&name| Self::Tuned(name)).chain(more).collect()
    }

    /// The estimators with these names in the given order, without repeated names. An empty list gives the
    /// [usual](Self::usual) estimators. Error messages name the list with `option`.
    ///
    /// # Errors
    /// A name is unknown, or the scene does not have the inputs of the estimator.
    pub fn named(names: &[String], scene: &NamedScene, option: &str) -> Result<Vec<Self>, Error> {
        if names.is_empty() {
            return Ok(Self::usual(&scene.scene));
        }
        let all = Self::all(&scene.scene);
        let mut entries = vec![];
        for name in names {
            let found = all.iter().find(|entry| entry.name() == *name);
            let refused = || Error::Input(format!("{option}: {}", not_among(name, &all, scene)));
            let entry = *found.ok_or_else(refused)?;
            if !entries.contains(&entry) {
                entries.push(entry);
            }
        }
        Ok(entries)
    }

    pub fn name(self) -> String {
        match self {
            Self::Tuned(name) => name.text().into(),
            Self::ObserverInTime => "observer told in time".into(),
            Self::AdHoc => format!("first-order at {AD_HOC_HZ} Hz"),
        }
    }

    /// Approximate duration of the search of this entry.
    fn length(self, engine: Engine, scene: &Scene, stop: &AtomicBool) -> Result<Length, Error> {
        let start = settings_of(self, scene);
        let walker = search::Walker { engine, scene: &self.told(scene), stop, done: &|_| () };
        walker.length(&start)
    }

    /// The scene for this entry. If the entry needs the latency, the estimator knows the latency in this scene.
    fn told(self, scene: &Scene) -> Scene {
        let mut scene = scene.clone();
        scene.actuator.latency_known |= self == Self::ObserverInTime;
        scene
    }
}

/// Error message for a name that is not in the list. The message says why.
fn not_among(name: &str, all: &[Entry], scene: &NamedScene) -> String {
    let reason = match name.parse::<EstimatorName>() {
        Err(_) => match EstimatorName::replacing(name) {
            Some(other) => format!("is no more: use {other}"),
            None => {
                let names: Vec<String> = all.iter().map(|entry| entry.name()).collect();
                format!("is unknown, allowed {}", names.join(", "))
            }
        },
        Ok(known) if known.sense() == Some(Sense::Acceleration) => {
            format!("needs a table [accelerometer], which {} has not", scene.name)
        }
        Ok(known) if known.sense() == Some(Sense::Edge) => {
            format!("cannot be with [encoder_noise] or [jitter], which {} has", scene.name)
        }
        Ok(_) => "differs from the one without pre-warping by its cutoff only".to_owned(),
    };
    format!("{name} {reason}")
}

/// Inputs of an estimator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    PositionOnly,
    /// The position and one more input: a force, an acceleration or the times of edges.
    MoreThanPosition,
}

impl Class {
    pub const ALL: [Self; 2] = [Self::PositionOnly, Self::MoreThanPosition];

    /// Name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::PositionOnly => "position_only",
            Self::MoreThanPosition => "more_than_position",
        }
    }

    pub fn text(self) -> &'static str {
        match self {
            Self::PositionOnly => "position only",
            Self::MoreThanPosition => "with more than the position",
        }
    }
}

pub use crate::study::boundary::BoundaryPoint as Wall;

impl Wall {
    /// A wall with this B. Its K is half of the mean K that the boundaries reach at this B, but at least the first K of
    /// the walk.
    pub fn half_of(boundaries: Option<&Boundaries>, scene: &Scene, damping_n_s_per_m: f64) -> Self {
        let reached = boundaries.map_or(0.0, |boundaries| {
            Repeats::of(boundaries.stiffnesses_at(damping_n_s_per_m).into_iter()).mean
        });
        let first = scene.walk_plan().stiffness_start_n_per_m;
        Self { stiffness_n_per_m: (reached / 2.0).max(first), damping_n_s_per_m }
    }
}

/// The walls at which estimators are compared. They are derived from the boundaries of one estimator, the tuned finite
/// difference and Butterworth filter. Their B are half of a given B, this B, and twice this B, but never outside the
/// scene's walk. The K of a wall is half of the mean K that this estimator reaches at the wall's B. K is at least the
/// walk's first K.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// The walls, in ascending order of B.
    pub walls: [Wall; 3],
    /// Mean area if the loop gets the true velocity instead of an estimate, in N^2 s/m^2.
    pub told_area: f64,
}

impl Place {
    /// The wall at which the force is compared. It has the B at which K of each boundary is read.
    pub fn middle(&self) -> Wall {
        self.walls[1]
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct Compared {
    pub entry: Entry,
    pub settings: VelocitySettings,
    pub tuned: Tuned,
    /// Boundaries of this tuning by the scene's own criterion. `None` if the search already used that criterion.
    pub beside: Option<Boundaries>,
    pub signal: Signal,
    /// Results of the contacts with each of the walls.
    pub contacts: [Contact; 3],
    pub fidelity: Fidelity,
    /// Cost on the Cortex-M4; `None` if it was not measured.
    pub cost: Option<Cost>,
}

impl Compared {
    pub fn class(&self) -> Class {
        match self.settings.name().sense() {
            None => Class::PositionOnly,
            Some(_) => Class::MoreThanPosition,
        }
    }

    /// Text that names the inputs of the estimator.
    pub fn needs(&self) -> &'static str {
        match self.settings.name().sense() {
            None => "position only",
            Some(Sense::Force) => "commanded force + mass",
            Some(Sense::Acceleration) => "accelerometer",
            Some(Sense::Edge) => "edge times",
        }
    }
}

pub fn with_filter(scene: &Scene, settings: &VelocitySettings) -> Scene {
    Scene { velocity: (*settings).into(), ..scene.clone() }
}

/// The estimator that defines the walls of the comparison.
const REFERENCE: Entry = Entry::Tuned(EstimatorName::Butterworth);

/// Default B at which K is read, in N s/m. The tuned finite difference and Butterworth filter may not reach twice this
/// B. Then half of the largest B that it reaches is used instead.
const USUAL_DAMPING_N_S_PER_M: f64 = 100.0;

/// The B at which K is read. It is the default, or half of the largest B that the boundaries reach if this half is
/// smaller. The half is rounded down to the walk's grid. The result is at least the walk's first B.
pub fn damping_of(boundaries: Option<&Boundaries>, scene: &Scene) -> f64 {
    let plan = scene.walk_plan();
    let reached = boundaries.map_or(0.0, |boundaries| {
        boundaries.dampings_max_n_s_per_m().into_iter().fold(f64::INFINITY, f64::min)
    });
    let (first, step) = (plan.damping_start_n_s_per_m, plan.damping_step_n_s_per_m);
    let steps = ((0.5 * reached - first) / step).floor().max(0.0);
    USUAL_DAMPING_N_S_PER_M.clamp(first, first + steps * step)
}

/// Largest number of walks that a comparison of `entries` can need.
pub fn most_walks(entries: &[Entry], budget: search::Budget) -> u64 {
    let reference = u64::from(!entries.contains(&REFERENCE));
    (entries.len() as u64 + reference) * budget.most() + u64::from(budget.repeats)
}

/// Compares `entries`. The tuned finite difference and Butterworth filter defines the walls ([`Place`]) of the
/// contacts, even if this filter is not an entry. `beside` is the same scene with another criterion for a stable hit.
/// The areas by this criterion are reported too. Calls `done` with the number of finished walks.
///
/// # Errors
/// The handle does not reach the wall, or `stop` was set.
pub fn compare(
    engine: Engine,
    (scene, beside): (&Scene, Option<&Scene>),
    entries: &[Entry],
    damping_n_s_per_m: Option<f64>,
    budget: search::Budget,
    stop: &AtomicBool,
    done: impl Fn(u64) + Sync,
) -> Result<(Place, Vec<Compared>), Error> {
    let mut searched = entries.to_vec();
    if !entries.contains(&REFERENCE) {
        searched.push(REFERENCE);
    }
    let lengths = searched.iter().map(|entry| entry.length(engine, scene, stop));
    let lengths = lengths.collect::<Result<Vec<_>, Error>>()?;
    let found = longest_first(&lengths, |n| {
        let entry = searched[n];
        let (start, is_free) = (settings_of(entry, scene), entry != Entry::AdHoc);
        search::tune(engine, &entry.told(scene), &start, is_free, budget, stop, &done)
    });
    let found = found.into_iter().collect::<Result<Vec<_>, Error>>()?;
    let reference = searched.iter().zip(&found).find(|(entry, _)| **entry == REFERENCE);
    let plan = scene.walk_plan();
    let reference = reference.map(|(_, (_, tuned))| &tuned.boundaries);
    let damping_n_s_per_m = damping_n_s_per_m.unwrap_or_else(|| damping_of(reference, scene));
    let walls = [0.5, 1.0, 2.0].map(|times| {
        let damping_n_s_per_m = (times * damping_n_s_per_m)
            .clamp(plan.damping_start_n_s_per_m, plan.damping_max_n_s_per_m);
        Wall::half_of(reference, scene, damping_n_s_per_m)
    });
    let told = PreparedScene::told(scene)?;
    let told: Vec<Result<Boundary, Error>> = (0..budget.repeats)
        .into_par_iter()
        .map(|repeat| {
            let start = start_offset_counts(repeat, budget.repeats);
            walk(engine, &told, Numeric::Fixed, VelocitySettings::Difference {}, start, stop)
        })
        .collect();
    done(budget.repeats.into());
    let told = told.into_iter().collect::<Result<Boundaries, Error>>()?;
    let place = Place { walls, told_area: told.area() };
    let compared: Vec<Result<Compared, Error>> = entries
        .par_iter()
        .zip(found)
        .map(|(&entry, (settings, tuned))| {
            let with = with_filter(&entry.told(scene), &settings);
            interrupt::unless(stop)?;
            let prepared = PreparedScene::new(&with)?;
            let signal = signal::measure(&with, settings).map_err(Error::input)?;
            let contact = |wall: Wall| {
                roughness::measure(&prepared, Numeric::Fixed, &wall.hit(settings), stop)
            };
            let [soft, middle, hard] = walls.map(contact);
            let contacts = [soft?, middle?, hard?];
            let fidelity = fidelity::measure(&with, settings, &walls, stop)?;
            let cost = cost::of(settings.name());
            let beside = beside.map(|own| {
                let scene = &entry.told(own);
                let walker = search::Walker { engine, scene, stop, done: &|_| () };
                walker.boundaries(&settings, budget)
            });
            let beside = beside.transpose()?;
            Ok(Compared { entry, settings, tuned, beside, signal, contacts, fidelity, cost })
        })
        .collect();
    Ok((place, compared.into_iter().collect::<Result<_, _>>()?))
}

/// Settings at which the search starts. If an estimator has a model of the device, this model gets the scene's mass.
pub fn settings_of(entry: Entry, scene: &Scene) -> VelocitySettings {
    let start = match entry {
        Entry::Tuned(name) => with_own_mass(name.defaults(), scene),
        Entry::ObserverInTime => with_own_mass(EstimatorName::Observer.defaults(), scene),
        Entry::AdHoc => VelocitySettings::FirstOrder { cutoff_hz: AD_HOC_HZ },
    };
    // The defaults are made for 10 kHz and 1 um. If the core refuses a default here, it is multiplied by a power of
    // two: the one nearest to 1 that gives an accepted value.
    let Some((_, tuning)) = start.tuning() else { return start };
    let design = scene.design();
    let powers = (0..64).flat_map(|n| [n, -n]).map(|n| 2f64.powi(n));
    let mut tunings = powers.map(|power| start.with_tuning(tuning * power));
    tunings.find(|settings| settings.build(&design).is_ok()).unwrap_or(start)
}

fn with_own_mass(settings: VelocitySettings, scene: &Scene) -> VelocitySettings {
    match settings {
        VelocitySettings::Observer { .. } => settings.with_second(scene.device.mass_kg),
        other => other,
    }
}
