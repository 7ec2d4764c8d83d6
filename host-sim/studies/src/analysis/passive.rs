//! Shows the effect of the passivity controller ([`zwidth::passivity`]) on a scene's walls. This module compares the
//! areas with and without the controller, and hits the walls on the boundaries.

use std::sync::atomic::AtomicBool;

use rayon::prelude::*;
use serde::Serialize;

use super::compare::roughness;
use zwidth::VelocitySettings;

use crate::{
    error::Error,
    interrupt,
    scene::{PassivityTable, RmsOf, Scene, Walk},
    simulation::{
        Sample,
        port::PortReport,
        prepared::{Numeric, PreparedScene, WallHit},
    },
    study::{
        How,
        boundary::Boundaries,
        limits::{Limit, Question, Situation, limits},
    },
    table::{Cell, Kind, Table, Told},
};

/// Largest number of walls that are hit on a boundary. The walls are evenly spaced in B.
const WALLS: usize = 24;

#[derive(Clone, Debug)]
pub struct PassiveQuestion {
    /// Limits for the motion at a wall that counts as stable.
    pub limits: Vec<Limit>,
    pub filters: Vec<VelocitySettings>,
    pub repeats: u32,
    pub walk: Walk,
    pub table: PassivityTable,
    /// How long the hits last before their measurement window, in s. A limit cycle gets energy during the whole hit.
    pub settles_s: Vec<f64>,
}

impl PassiveQuestion {
    pub fn walks(&self) -> u64 {
        (2 * self.limits.len() * self.filters.len()) as u64 * u64::from(self.repeats)
    }
}

/// Results of hits at the walls of a boundary. All hits have the same duration. Values are means over the walls, unless
/// their comment says that they are the largest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Length {
    /// Nominal cutoff of the estimator, in Hz; `None` if it has no cutoff.
    pub cutoff_hz: Option<f64>,
    #[serde(skip)]
    pub limit: Limit,
    /// Whether the passivity controller is on.
    pub controller: bool,
    /// Duration of the hit before its window, in s.
    pub settle_s: f64,
    pub walls: usize,
    /// Largest energy that a wall has given in a contact, in J. It is computed from force and counts.
    pub given_j: f64,
    /// Largest energy that a wall has given in a contact, in J. It is computed from force and true motion.
    pub given_by_motion_j: f64,
    /// Power `b <v^2>` that the device's damping takes from the limit cycle in the window, in W. What drives the limit
    /// cycle supplies the same power.
    pub fed_w: f64,
    /// The force that the controller withholds, as a fraction of the wall's force.
    pub withheld_fraction: f64,
    /// The largest withheld fraction that a wall has.
    pub withheld_most_fraction: f64,
    /// Mean penetration in the window, divided by `push / K`. A value above 1 means that the handle sinks deeper into
    /// the wall than its K allows.
    pub sag: f64,
}

/// Results of hits at the walls of a boundary. Values are means over the walls, unless their comment says that they are
/// the largest.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Hits {
    pub walls: usize,
    /// Largest energy that a wall has given in a contact, in J.
    pub given_j: f64,
    /// Number of walls that have given more energy than the reserve allows.
    #[serde(rename = "walls_beyond_reserve")]
    pub beyond: usize,
    /// Fraction of the outputs in contact that the controller has changed.
    pub limited_fraction: f64,
    /// The force that the controller withholds, as a fraction of the wall's force.
    pub withheld_fraction: f64,
    /// Fraction of the outputs at which the force saturated.
    pub saturated_fraction: f64,
    /// RMS of the motion in the window, in m.
    pub rms_motion_m: f64,
    /// RMS of the force above 100 Hz in the window, in N.
    pub roughness_n: f64,
}

/// The results of one cutoff at one limit, either with or without the controller.
#[derive(Clone, Debug)]
pub struct PassiveRow {
    /// Nominal cutoff of the estimator, in Hz; `None` if it has no cutoff.
    pub cutoff_hz: Option<f64>,
    pub limit: Limit,
    /// Whether the passivity controller is on.
    pub controller: bool,
    pub boundaries: Boundaries,
    /// Hits in this loop. The first element is at the walls of the boundary that was found without the controller. The
    /// second element is at the walls of the boundary that was found with it. If the controller is off, the second
    /// element is empty.
    pub hits: [Hits; 2],
}

#[derive(Clone, Debug)]
pub struct PassiveStudy {
    pub question: PassiveQuestion,
    /// Largest energy that the controller allows a wall to give in a contact, in J.
    pub reserve_j: f64,
    /// The rows, ordered by limit and cutoff. The row without the controller comes before the row with it.
    pub rows: Vec<PassiveRow>,
    /// The results for each duration of the hits, ordered by limit, cutoff and duration. Those without the controller
    /// come first. All hits are at the boundaries that were found without the controller.
    pub lengths: Vec<Length>,
}

/// Walks every cutoff with and without the controller, and hits the walls of the boundaries. Calls `done` after each
/// walk.
///
/// # Errors
/// A setting is out of range, the handle does not reach the wall, or `stop` was set.
pub fn passive(
    how: How<'_>,
    scene: &Scene,
    question: PassiveQuestion,
    done: impl Fn() + Sync,
) -> Result<PassiveStudy, Error> {
    let plain = Scene { passivity: None, ..scene.clone() };
    let with = Scene { passivity: Some(question.table), ..scene.clone() };
    with.check().map_err(Error::Input)?;
    let reserve_j = with.reserve_j().unwrap_or(0.0);
    let asked = Question {
        limits: question.limits.clone(),
        rms_of: RmsOf::Motion,
        filters: question.filters.clone(),
        repeats: question.repeats,
        walk: question.walk,
        situations: vec![Situation { push: scene.wall_hit.push_by, arm: None }],
        told: false,
    };
    let how = How { numeric: Numeric::Fixed, ..how };
    let walked = |scene: &Scene| limits(how, scene, &asked, &done);
    let [without, passive] = [walked(&plain)?, walked(&with)?];
    let (mut rows, mut by_length) = (vec![], vec![]);
    for (before, after) in without.iter().zip(&passive) {
        for (plain_at, passive_at) in before.result.cutoffs.iter().zip(&after.result.cutoffs) {
            let velocity = plain_at.velocity;
            let walls = [plain_at, passive_at].map(|at| walls(&at.boundaries, velocity));
            for (controller, scene, at) in [(false, &plain, plain_at), (true, &with, passive_at)] {
                let prepared = PreparedScene::new(scene)?;
                let [own, passive] = &walls;
                let of = |walls: &[WallHit]| hits(&prepared, walls, reserve_j, how.stop);
                for &settle_s in &question.settles_s {
                    let mut scene = scene.clone();
                    scene.wall_hit.settle_s = settle_s;
                    let (limit, cutoff_hz) = (before.limit, velocity.cutoff_hz());
                    let mut length = length(&PreparedScene::new(&scene)?, own, limit, how.stop)?;
                    (length.cutoff_hz, length.controller) = (cutoff_hz, controller);
                    by_length.push(length);
                }
                rows.push(PassiveRow {
                    cutoff_hz: velocity.cutoff_hz(),
                    limit: before.limit,
                    controller,
                    boundaries: at.boundaries.clone(),
                    hits: [of(own)?, if controller { of(passive)? } else { Hits::default() }],
                });
            }
        }
    }
    by_length.sort_by_key(|length: &Length| length.controller);
    Ok(PassiveStudy { question, reserve_j, rows, lengths: by_length })
}

/// Some walls on the first of the repeated boundaries.
fn walls(boundaries: &Boundaries, velocity: VelocitySettings) -> Vec<WallHit> {
    let Some(first) = boundaries.first() else { return vec![] };
    let step = first.points.len().div_ceil(WALLS).max(1);
    first.points.iter().step_by(step).map(|wall| wall.hit(velocity)).collect()
}

/// Sums up the energy of a wall's force along the true motion. In each contact the energy begins at zero.
struct MotionAccount {
    /// Largest delay from a count to its force, in samples.
    until_it_acts: u64,
    /// Position of the first count in contact, in m.
    contact_m: f64,
    /// Number of samples since the last contact.
    free: u64,
    /// The output that there would be without the wall, in N. It is the push, rounded to an output code.
    rest_n: f64,
    energy_j: f64,
    /// Largest energy that the wall has given so far.
    given_j: f64,
}

impl MotionAccount {
    fn new(until_it_acts: u64, contact_m: f64) -> Self {
        Self {
            until_it_acts,
            contact_m,
            free: u64::MAX / 2,
            rest_n: 0.0,
            energy_j: 0.0,
            given_j: 0.0,
        }
    }

    /// Adds a sample. During this sample the handle moved by `moved_m`.
    fn take(&mut self, sample: &Sample, moved_m: f64) {
        self.free = if sample.position_m > self.contact_m { 0 } else { self.free + 1 };
        if self.free > self.until_it_acts {
            (self.rest_n, self.energy_j) = (sample.output_n, 0.0);
        } else {
            self.energy_j += (self.rest_n - sample.output_n) * moved_m;
            self.given_j = self.given_j.max(-self.energy_j);
        }
    }
}

/// Result of a hit: the energy at its port, the largest energy that was given along the true motion, the power of the
/// damping, and the sag.
type Shown = (PortReport, f64, f64, f64);

/// Hits the walls with the duration in the scene.
fn length(
    prepared: &PreparedScene,
    walls: &[WallHit],
    limit: Limit,
    stop: &AtomicBool,
) -> Result<Length, Error> {
    let hit = prepared.scene().wall_hit.clone();
    let damping_n_s_per_m = prepared.scene().device.damping_n_s_per_m;
    let (surface_m, rate_hz) = (prepared.scene().wall.position_m, prepared.design().rate_hz);
    let settle = u64::from(prepared.plan().settle);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "1000 at most")]
    let latency = prepared.scene().actuator.latency.ceil() as u64;
    let contact_m = surface_m - prepared.scene().encoder.resolution_m;
    let until_it_acts = latency + u64::from(prepared.design().period);
    let of_wall = |wall: &WallHit| {
        interrupt::unless(stop)?;
        let mut before: Option<Sample> = None;
        let (mut account, mut squares, mut samples) =
            (MotionAccount::new(until_it_acts, contact_m), 0.0, 0.0);
        let report = prepared.hit(Numeric::Fixed, wall, |sample| {
            if let Some(before) = before {
                let moved_m = sample.position_m - before.position_m;
                account.take(&before, moved_m);
                if sample.index > settle {
                    squares += (moved_m * rate_hz).powi(2);
                    samples += 1.0;
                }
            }
            before = Some(*sample);
        })?;
        let fed_w = damping_n_s_per_m * squares / f64::max(samples, 1.0);
        let sag = wall.stiffness_n_per_m * (report.mean_m - surface_m) / hit.push_n;
        Ok::<_, Error>((report.port, account.given_j, fed_w, sag))
    };
    let all: Vec<Shown> = walls.par_iter().map(of_wall).collect::<Result<_, _>>()?;
    let part = 1.0 / all.len().max(1) as f64;
    let most = |of: fn(&Shown) -> f64| all.iter().map(of).fold(0.0, f64::max);
    let mean = |of: fn(&Shown) -> f64| all.iter().map(of).fold(0.0, |sum, one| sum + part * one);
    Ok(Length {
        cutoff_hz: None,
        limit,
        controller: false,
        settle_s: hit.settle_s,
        walls: all.len(),
        given_j: most(|(port, ..)| port.given_j),
        given_by_motion_j: most(|(_, given_j, ..)| *given_j),
        fed_w: mean(|(.., fed_w, _)| *fed_w),
        withheld_fraction: mean(|(port, ..)| port.withheld_fraction),
        withheld_most_fraction: most(|(port, ..)| port.withheld_fraction),
        sag: mean(|(.., sag)| *sag),
    })
}

fn hits(
    prepared: &PreparedScene,
    walls: &[WallHit],
    reserve_j: f64,
    stop: &AtomicBool,
) -> Result<Hits, Error> {
    let all: Vec<_> = walls
        .par_iter()
        .map(|wall| {
            interrupt::unless(stop)?;
            let (report, roughness_n) = roughness::of_hit(prepared, Numeric::Fixed, wall);
            Ok::<_, Error>((report?, roughness_n))
        })
        .collect::<Result<_, _>>()?;
    let mut sum = Hits { walls: all.len(), ..Hits::default() };
    let part = 1.0 / all.len().max(1) as f64;
    for (report, roughness_n) in &all {
        let port = &report.port;
        sum.given_j = sum.given_j.max(port.given_j);
        sum.beyond += usize::from(port.given_j > reserve_j);
        sum.limited_fraction += part * port.limited_fraction;
        sum.withheld_fraction += part * port.withheld_fraction;
        sum.saturated_fraction += part * report.saturated_fraction;
        sum.rms_motion_m += part * report.rms_motion_m;
        sum.roughness_n += part * roughness_n;
    }
    Ok(sum)
}

/// What a row of the table needs: the study, a boundary, the name of the boundary whose walls were hit, and the hits.
type Hit<'a> = (&'a PassiveStudy, &'a PassiveRow, &'static str, Hits);

use Kind::{Flag, Number, Text, Whole};

impl PassiveStudy {
    const LENGTHS: [Told<Length>; 12] = [
        ("cutoff_hz", Number, |row| Cell::number(row.cutoff_hz)),
        ("limit", Number, |row| row.limit.told().0.into()),
        ("limit_unit", Text, |row| row.limit.told().1.into()),
        ("controller", Flag, |row| row.controller.into()),
        ("settle_s", Number, |row| row.settle_s.into()),
        ("walls", Whole, |row| Cell::count(row.walls)),
        ("given_j", Number, |row| row.given_j.into()),
        ("given_by_motion_j", Number, |row| row.given_by_motion_j.into()),
        ("fed_w", Number, |row| row.fed_w.into()),
        ("withheld_fraction", Number, |row| row.withheld_fraction.into()),
        ("withheld_most_fraction", Number, |row| row.withheld_most_fraction.into()),
        ("sag", Number, |row| row.sag.into()),
    ];

    /// A table with a row for each limit, cutoff and duration of the hits, with and without the controller.
    pub fn length_table(&self) -> Table {
        Table::of(&Self::LENGTHS, &self.lengths)
    }

    /// A table with a row for each limit, each cutoff, and each boundary whose walls were hit.
    pub fn table(&self) -> Table {
        let columns: [Told<Hit<'_>>; 20] = [
            ("cutoff_hz", Number, |(_, row, ..)| Cell::number(row.cutoff_hz)),
            ("limit", Number, |(_, row, ..)| row.limit.told().0.into()),
            ("limit_unit", Text, |(_, row, ..)| row.limit.told().1.into()),
            ("controller", Flag, |(_, row, ..)| row.controller.into()),
            ("area_n2_s_per_m2", Number, |(_, row, ..)| row.boundaries.area().into()),
            ("area_low_n2_s_per_m2", Number, |(_, row, ..)| row.boundaries.area_range()[0].into()),
            ("area_high_n2_s_per_m2", Number, |(_, row, ..)| row.boundaries.area_range()[1].into()),
            ("stiffness_peak_n_per_m", Number, |(_, row, ..)| {
                row.boundaries.stiffness_peak_n_per_m().into()
            }),
            ("capped_walks", Whole, |(_, row, ..)| Cell::count(row.boundaries.capped())),
            ("walks", Whole, |(study, ..)| Cell::Whole(study.question.repeats.into())),
            ("walls_of", Text, |(.., walls_of, _)| (*walls_of).into()),
            ("walls", Whole, |(.., hits)| Cell::count(hits.walls)),
            ("reserve_j", Number, |(study, ..)| study.reserve_j.into()),
            ("given_j", Number, |(.., hits)| hits.given_j.into()),
            ("walls_beyond_reserve", Whole, |(.., hits)| Cell::count(hits.beyond)),
            ("limited_fraction", Number, |(.., hits)| hits.limited_fraction.into()),
            ("withheld_fraction", Number, |(.., hits)| hits.withheld_fraction.into()),
            ("saturated_fraction", Number, |(.., hits)| hits.saturated_fraction.into()),
            ("rms_motion_m", Number, |(.., hits)| hits.rms_motion_m.into()),
            ("roughness_n", Number, |(.., hits)| hits.roughness_n.into()),
        ];
        let rows = self.rows.iter().flat_map(|row| {
            let [without, with] = row.hits;
            let with = row.controller.then_some((self, row, "with", with));
            [(self, row, "without", without)].into_iter().chain(with)
        });
        Table::of(&columns, &rows.collect::<Vec<_>>())
    }
}
