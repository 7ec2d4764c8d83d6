//! Computes the envelope in a board's device record. It makes a sweep for every estimator, design and output period of
//! the scene.

use zwidth::{
    VelocitySettings,
    device::record::BoardFacts,
    safety::envelope::{Boundary, Key, Point},
    velocity::EstimatorName,
};

use crate::{
    error::Error,
    scene::{BoardTable, NamedScene, Scene, VelocityTable, record::Prepared},
    simulation::prepared::PreparedScene,
    study::{
        How,
        envelope::envelopes,
        sweep::{Plan, SweepResult, filters, sweep},
    },
};

/// Number of walks per cutoff. A sweep has the same number.
pub const REPEATS: u32 = 4;

/// A part of the envelope: an estimator or a design, with an output period.
#[derive(Clone, Debug)]
pub struct Part {
    pub estimator: EstimatorName,
    /// Name and number of the design; `None` if the part is an estimator.
    pub design: Option<(String, u8)>,
    /// Number of samples from output to output.
    pub period: u32,
    /// The scene with this estimator or design, and this period.
    scene: Scene,
    filters: Vec<VelocitySettings>,
}

impl Part {
    /// All parts of a scene, at the cutoffs of its sweep and at the cutoff of the initial settings `first`.
    ///
    /// # Errors
    /// [`Error::Input`]: a value of the scene is not allowed with one of the parts.
    pub fn all(scene: &Scene, first: &VelocitySettings) -> Result<Vec<Self>, Error> {
        let mut parts = vec![];
        let part = |scene: Scene, design: Option<(String, u8)>, period: u32| {
            let mut scene = scene;
            scene.actuator.period = period;
            scene.check().map_err(|why| {
                let why = scene.units.text(&why);
                let name = scene.velocity.estimator().text();
                Error::Input(format!("with {name} of the envelope: {why}"))
            })?;
            let own = first
                .cutoff_hz()
                .filter(|_| design.is_none() && scene.velocity.estimator() == first.name());
            let cutoffs_hz: Vec<f64> = scene.sweep.cutoffs_hz.iter().copied().chain(own).collect();
            let filters = filters(&scene.velocity, &cutoffs_hz);
            let estimator = scene.velocity.estimator();
            Ok::<Self, Error>(Self { estimator, design, period, scene, filters })
        };
        for estimator in scene.board_estimators().map_err(Error::Input)? {
            for period in scene.board_periods() {
                let mut scene = scene.clone();
                take(&mut scene, estimator);
                parts.push(part(scene, None, period)?);
            }
        }
        for (name, number) in scene.designs.keys().zip(1..) {
            for period in scene.board_periods() {
                let scene = scene.with_design(name).map_err(Error::Input)?;
                parts.push(part(scene, Some((name.clone(), number)), period)?);
            }
        }
        Ok(parts)
    }

    pub fn walks(&self) -> u64 {
        self.filters.len() as u64 * u64::from(REPEATS)
    }
}

#[derive(Clone, Debug)]
pub struct Found {
    pub part: Part,
    pub sweep: SweepResult,
    boundaries: Vec<(Key, Vec<Point>)>,
}

impl Found {
    /// The boundaries in the form that the core uses.
    pub fn boundaries(&self) -> impl Iterator<Item = Boundary<'_>> {
        self.boundaries.iter().map(|(key, points)| Boundary { key: *key, points })
    }

    pub fn rows(&self) -> usize {
        self.boundaries.iter().map(|(_, points)| points.len()).sum()
    }
}

/// The device record that `cargo sim prepare` makes for a scene.
pub struct DeviceRecord {
    pub prepared: Prepared,
    /// The sweeps that give the envelope.
    pub found: Vec<Found>,
    pub bytes: Vec<u8>,
}

impl DeviceRecord {
    /// Makes the record of a scene on a board, with the envelope of these parts. If there are no parts, the record has
    /// no measurements. Calls `done` after each walk.
    ///
    /// # Errors
    /// The scene does not fit the board, or `stop` was set. The scene is refused before the first walk.
    pub fn of(
        named: &NamedScene,
        board: &BoardFacts,
        (first, parts): (VelocitySettings, Vec<Part>),
        how: How<'_>,
        done: impl Fn() + Sync,
    ) -> Result<Self, Error> {
        let prepared = fitting(named, board, first, !parts.is_empty())?;
        let found = board_envelope(how, parts, done).map_err(|error| error.of(&named.name))?;
        let boundaries: Vec<Boundary<'_>> = found.iter().flat_map(Found::boundaries).collect();
        let bytes = prepared.record(&boundaries, board)?;
        Ok(Self { prepared, found, bytes })
    }
}

/// Checks that the device fits a board, with or without an envelope. Returns the device as prepared for the board.
///
/// # Errors
/// [`Error::Input`]: the device does not fit the board.
pub fn fitting(
    named: &NamedScene,
    board: &BoardFacts,
    first: VelocitySettings,
    has_envelope: bool,
) -> Result<Prepared, Error> {
    let fits = named.scene.check_fits(has_envelope);
    fits.map_err(|why| Error::Input(why).of(&named.name))?;
    named.prepared(board, first)
}

/// The scene with the initial estimator, for which the cutoff is recommended.
///
/// # Errors
/// [`Error::Input`]: the scene names no estimator of the board.
pub fn with_first_estimator(named: &NamedScene) -> Result<NamedScene, Error> {
    let mut named = named.clone();
    let estimators = named.scene.board_estimators().map_err(Error::Input)?;
    if let Some(first) = estimators.first() {
        take(&mut named.scene, *first);
    }
    Ok(named)
}

/// Sets the estimator of the scene. If the scene already has this estimator, the scene's settings do not change.
/// Otherwise the new estimator has its default settings.
fn take(scene: &mut Scene, estimator: EstimatorName) {
    if scene.velocity.estimator() != estimator {
        scene.velocity = VelocityTable::from(estimator.defaults()).with_cutoff(None);
    }
}

/// Whether a scene states the initial settings.
pub fn says_first(scene: &Scene) -> bool {
    let said = |board: &BoardTable| board.cutoff_hz.is_some() || board.design.is_some();
    scene.board.as_ref().is_some_and(said) || scene.velocity.cutoff_hz().is_some()
}

/// The settings with which the board starts. They have the design or the cutoff of the scene. If the scene has neither,
/// the recommended cutoff is used. If no cutoff is recommended either, the middle cutoff of the scene's list is used.
///
/// # Errors
/// [`Error::Input`]: the scene names no estimator of the board.
pub fn first_settings(
    scene: &Scene,
    recommended_hz: Option<f64>,
) -> Result<VelocitySettings, Error> {
    let design = scene.board.as_ref().and_then(|board| board.design.as_ref());
    if let Some(design) = design.and_then(|name| scene.designs.get(name)) {
        return design
            .settings()
            .ok_or_else(|| Error::Internal("a design without a cutoff".into()));
    }
    let estimators = scene.board_estimators().map_err(Error::Input)?;
    let cutoffs = &scene.sweep.cutoffs_hz;
    let middle = cutoffs.get(cutoffs.len() / 2).copied().unwrap_or_default();
    let asked = scene.board.as_ref().and_then(|board| board.cutoff_hz);
    let asked = asked.or(scene.velocity.cutoff_hz());
    let cutoff_hz = asked.or(recommended_hz).unwrap_or(middle);
    let first = estimators.first().copied();
    let first = first.filter(|first| *first != scene.velocity.estimator());
    Ok(first.map_or(scene.velocity, |first| first.defaults().into()).at(cutoff_hz))
}

/// Makes the sweeps of all parts. Calls `done` after each walk.
///
/// # Errors
/// A setting is out of range, or `stop` was set.
pub fn board_envelope(
    how: How<'_>,
    parts: Vec<Part>,
    done: impl Fn() + Sync,
) -> Result<Vec<Found>, Error> {
    let mut found = vec![];
    for part in parts {
        let prepared = PreparedScene::new(&part.scene)?;
        prepared.check_approach()?;
        let plan = Plan { name: "", prepared: &prepared, filters: &part.filters };
        let results = sweep(how.engine, &[plan], how.numeric, REPEATS, how.stop, |_| done())?;
        let Some(swept) = results.into_iter().next() else { continue };
        let mut boundaries = vec![];
        for envelope in envelopes(how, &prepared, &swept)? {
            let velocity = envelope.velocity;
            // Unless a design is used, the firmware only knows walls for estimators whose further parameters have their
            // defaults.
            if part.design.is_none() && !velocity.differs_by_tuning_only() {
                continue;
            }
            let key = Key {
                estimator: part.estimator,
                cutoff_hz: velocity.tuning().map_or(0.0, |(_, value)| value),
                period: part.period,
                design: part.design.as_ref().map_or(0, |(_, number)| *number),
            };
            boundaries.push((key, envelope.intervals));
        }
        found.push(Found { part, sweep: swept, boundaries });
    }
    Ok(found)
}
