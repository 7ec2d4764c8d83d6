//! Walls under a varying push: taps, and an unsteady hand.
//!
//! | protocol | push divided by the scene's push | window |
//! |----------|----------------------------|--------|
//! | `taps` | 1 for the first half of [`TAP_S`]. Then a critically damped spring pulls the handle back to its start. The spring's force is at most 1, and is 1 at the wall. A push from the start reaches the wall in 50 ms. | For each tap but the first: the second half of the time from contact to the end of the push. The worst tap decides. Motion and force are measured relative to the best-fitting polynomial of degree 5, so that slow creep of the wall is not judged as bouncing. |
//! | `hand` | `1 + 0.3 (sin + sin + sin) / 3` at 0.7, 1.9 and 4.3 Hz | The scene's window. The RMS of motion and force includes only frequencies above 20 Hz, from a spectrum with Hann's window. |
//!
//! The scene selects whether motor or hand pushes. Push and force stay constant between two outputs.

use std::f64::consts::TAU;

use zwidth::{
    Design,
    experiment::{Hit, HitPlan, RunningVariance, Verdict},
    units::{Position, Velocity},
};

use super::{PreparedScene, run::Observer};
use crate::{
    plant::{AnyPlant, Plant},
    scene::{Criterion, HAND_SWAY, Protocol, PushBy, Scene, TAP_S},
    simulation::{
        Sample, Simulation,
        controller::Controller,
        hit::{HitError, HitReport, WallHit},
        port::PortReport,
        window::{Band, Measures, Stiff, Watch},
    },
};

/// Time from the start of a tap until the handle reaches the wall, in s.
const TO_WALL_S: f64 = 0.05;
/// Frequencies of a hand's sway in Hz.
const SWAY_HZ: [f64; 3] = [0.7, 1.9, 4.3];
/// Frequency above which a wall must be quiet under a hand's push, in Hz.
const REST_HZ: f64 = 20.0;
/// Degree of the polynomial that is subtracted from the motion of a tapped wall. In a window of a tenth of a second the
/// polynomial follows motion up to about 25 Hz.
const DEGREE: usize = 5;

/// Start position of a tap, in m. From rest at this position, the push moves the handle to the wall in [`TO_WALL_S`].
/// If the scene's start position is nearer to the wall, the tap starts there.
pub(super) fn tap_start_m(scene: &Scene, plant: &AnyPlant) -> f64 {
    let push_n = scene.push_n(PushBy::Motor); // a hand's push is part of the plant
    let (wall_m, start_m) = (scene.wall.position_m, scene.device.start_position_m);
    let mut state = plant.at_rest(wall_m);
    let mut time_s = 0.0;
    while time_s < TO_WALL_S {
        state = plant.advance(&state, push_n);
        time_s += 1.0 / scene.control.rate_hz;
    }
    (wall_m - (plant.position_m(&state) - wall_m).max(scene.encoder.resolution_m)).max(start_m)
}

enum Push {
    Taps { back_m: f64, per_m: f64, per_m_per_s: f64 },
    Hand,
}

impl Push {
    fn of(prepared: &PreparedScene) -> Self {
        let PreparedScene { scene, start_m: back_m, .. } = prepared;
        match scene.wall_hit.protocol {
            Protocol::Taps => {
                let per_m = 1.0 / (scene.wall.position_m - back_m);
                let rate = (per_m * scene.wall_hit.push_n.abs() / scene.device.mass_kg).sqrt();
                Self::Taps { back_m: *back_m, per_m, per_m_per_s: 2.0 * per_m / rate }
            }
            _ => Self::Hand,
        }
    }

    /// The push at this time, divided by the scene's push.
    fn share(&self, time_s: f64, position_m: f64, speed_m_per_s: f64) -> f64 {
        match self {
            Self::Taps { .. } if is_pressed(time_s) => 1.0,
            Self::Taps { back_m, per_m, per_m_per_s } => {
                (per_m * (back_m - position_m) - per_m_per_s * speed_m_per_s).clamp(-1.0, 1.0)
            }
            Self::Hand => {
                let sway: f64 = SWAY_HZ.iter().map(|hz| libm::sin(TAU * hz * time_s)).sum();
                1.0 + HAND_SWAY * sway / SWAY_HZ.len() as f64
            }
        }
    }
}

/// Whether the time is in the first half of a tap, while the push acts.
fn is_pressed(time_s: f64) -> bool {
    (time_s / TAP_S).fract() < 0.5
}

#[derive(Clone, Debug, Default)]
struct Seen {
    counts: Vec<i32>,
    positions_m: Vec<f64>,
    /// Each entry is one output: the index of its sample, the output and the push. The last two are fractions of full
    /// scale.
    outputs: Vec<(usize, f64, f64)>,
}

impl Seen {
    fn push(&mut self, sample: &Sample) {
        if let Some(rendered) = sample.rendered {
            self.outputs.push((self.counts.len(), rendered.output, rendered.push));
        }
        self.counts.push(sample.count);
        self.positions_m.push(sample.position_m);
    }

    /// Drops the first half of the samples, and keeps the second half.
    fn half(mut self) -> Self {
        let half = self.counts.len() / 2;
        self.counts.drain(..half);
        self.positions_m.drain(..half);
        self.outputs.retain(|(place, ..)| *place >= half);
        for (place, ..) in &mut self.outputs {
            *place -= half;
        }
        self
    }
}

impl PreparedScene {
    /// Runs a hit with a varying push. With `bounded`, returns `None` as soon as the hit is certain to be unstable.
    pub(super) fn varied_hit<C: Controller>(
        &self,
        of: &WallHit,
        controller: C,
        mut observe: Option<&mut Observer<'_>>,
        bounded: bool,
    ) -> Result<Option<HitReport>, HitError> {
        let surface = controller.surface();
        let (start_m, plant) = (self.start_m(of), &self.parts.plant);
        let (rate_hz, push) = (self.design.rate_hz, Push::of(self));
        let mut simulation =
            Simulation::new(self.parts.clone(), controller, self.sensing(of), start_m);
        let mut port = self.port_watch(of, surface);
        let (mut deepest_m, mut outputs, mut saturated, mut clipped) = (f64::NEG_INFINITY, 0, 0, 0);
        let mut last = self.first_count(of);
        let (mut seen, mut worst): (Seen, Option<HitReport>) = Default::default();
        let taps = self.scene.wall_hit.protocol == Protocol::Taps;
        for index in 0..self.samples() {
            let time_s = f64::from(index) / rate_hz;
            if index % self.design.period == 0 {
                let state = simulation.state();
                let at = [plant.position_m(state), plant.speed_m_per_s(state)];
                self.push_with(&mut simulation, push.share(time_s, at[0], at[1]));
            }
            let sample = simulation.step();
            if !Position::from_counts(sample.count).in_range() {
                return Err(HitError::OutOfRange(index.into()));
            }
            if let Some(observe) = &mut observe {
                observe(&sample);
            }
            port.sample(&sample);
            deepest_m = f64::max(deepest_m, sample.position_m);
            clipped += u32::from(sample.count.abs_diff(last) > Velocity::LIMIT.unsigned_abs());
            last = sample.count;
            if let Some(rendered) = sample.rendered {
                outputs += 1;
                saturated += u32::from(rendered.saturated);
            }
            let begun = index >= self.plan.settle;
            if taps {
                // The contact lasts from the first touch to the end of the push, even if the handle leaves the wall in
                // between.
                let contact = !seen.counts.is_empty() || sample.count > surface;
                if begun && is_pressed(time_s) && contact {
                    seen.push(&sample);
                }
                let ends = !is_pressed(f64::from(index + 1) / rate_hz);
                if ends && !seen.counts.is_empty() {
                    let mut report = self.judged(of, surface, std::mem::take(&mut seen).half());
                    if report.verdict == Verdict::NoContact {
                        report.verdict = Verdict::Unstable; // the handle bounced back
                    }
                    if bounded && !report.is_stable() {
                        return Ok(None);
                    }
                    worst = Some(self.worse(worst, report));
                }
            } else if begun {
                seen.push(&sample);
            }
        }
        let report = worst.unwrap_or_else(|| self.judged(of, surface, seen));
        let surface_m = f64::from(surface) * self.design.resolution_m;
        let report = HitReport {
            peak_penetration_m: (deepest_m - surface_m).max(0.0),
            saturated_fraction: f64::from(saturated) / f64::from(outputs),
            velocity_clipped_fraction: f64::from(clipped) / f64::from(self.samples()),
            port: port.report(last),
            ..report
        };
        Ok((!bounded || report.verdict != Verdict::Unstable).then_some(report))
    }

    /// Sets the push to `share` times the scene's push.
    fn push_with<C: Controller>(&self, simulation: &mut Simulation<C>, share: f64) {
        let push_n = share * self.scene.wall_hit.push_n;
        match self.scene.wall_hit.push_by {
            PushBy::Motor => {
                simulation.controller_mut().set_push(push_n / self.parts.full_scale_n);
            }
            PushBy::Hand => {
                let mut scene = self.scene.clone();
                scene.wall_hit.push_n = push_n;
                simulation.set_plant(Self::plant(&scene));
            }
        }
    }

    /// Selects the worse of two taps. An unstable tap is worse than a stable tap. Of two stable taps, the tap whose RMS
    /// is larger is worse. The criterion selects the signal of this RMS.
    fn worse(&self, kept: Option<HitReport>, next: HitReport) -> HitReport {
        let loud = |report: &HitReport| match self.scene.wall_hit.criterion {
            Criterion::Quiet => report.force_rms_n,
            _ => report.rms_m,
        };
        match kept {
            Some(kept) if !kept.is_stable() => kept,
            Some(kept) if next.is_stable() && loud(&next) <= loud(&kept) => kept,
            _ => next,
        }
    }

    /// Judges one window of a hit.
    fn judged(&self, of: &WallHit, surface: i32, seen: Seen) -> HitReport {
        let Seen { counts, positions_m, outputs } = seen;
        let mut watch =
            Watch { origin_m: positions_m.first().copied().unwrap_or(0.0), ..Watch::default() };
        positions_m.iter().for_each(|position_m| watch.sample(*position_m));
        outputs.iter().for_each(|(_, output, _)| watch.output(*output));
        let mut scatter = RunningVariance::default();
        counts.iter().for_each(|count| scatter.push(Position::from_counts(*count)));
        let contact = counts.iter().filter(|count| **count > surface).count();
        let [samples, contact] =
            [counts.len(), contact].map(|n| u32::try_from(n).unwrap_or(u32::MAX));
        let hit = Hit::in_window(HitPlan { window: samples, ..self.plan }, contact, scatter);
        let wall = Stiff { stiffness_n_per_m: of.stiffness_n_per_m, surface };
        let push = outputs.iter().map(|(.., push)| push).sum::<f64>() / outputs.len().max(1) as f64;
        let judge = self.judge.clone().about(push);
        let mut measures = judge.measures(&hit, wall, &watch, Vec::new);
        if outputs.is_empty() {
            measures.at_limit_fraction = 0.0;
        }
        let Design { resolution_m, full_scale_n, rate_hz, .. } = self.design;
        let quick = |values: Vec<f64>| match self.scene.wall_hit.protocol {
            Protocol::Hand => {
                let band = Band::new(values.len(), rate_hz, [REST_HZ, 0.5 * rate_hz], |_| 1.0);
                band.energy(values).sqrt()
            }
            _ => about_polynomial(values),
        };
        let forces = held(&outputs, counts.len());
        let counts = counts.iter().map(|count| f64::from(*count - surface)).collect();
        measures.rms_m = quick(counts) * resolution_m;
        measures.rms_motion_m = quick(positions_m);
        measures.force_rms_n = quick(forces) * full_scale_n;
        HitReport {
            verdict: judge.verdict(&hit, wall, &measures),
            measures: Measures { sensation_db: None, ..measures },
            mean_m: scatter.mean_counts() * self.design.resolution_m,
            contact_fraction: f64::from(contact) / f64::from(samples.max(1)),
            peak_penetration_m: 0.0,
            saturated_fraction: 0.0,
            velocity_clipped_fraction: 0.0,
            port: PortReport::default(),
        }
    }
}

/// The outputs at `samples` samples. Each output stays constant until the next output.
fn held(outputs: &[(usize, f64, f64)], samples: usize) -> Vec<f64> {
    let ends = outputs.iter().skip(1).map(|(place, ..)| *place).chain([samples]);
    outputs
        .iter()
        .zip(ends)
        .flat_map(|((place, output, _), end)| vec![*output; end - place])
        .collect()
}

/// RMS of the values, relative to the polynomial of [`DEGREE`] that fits best. The calculation uses orthogonal
/// polynomials.
fn about_polynomial(mut values: Vec<f64>) -> f64 {
    let length = values.len();
    let degree = DEGREE.min(length / 4); // a lower degree for few values
    let at = |n: usize| 2.0 * (n as f64 + 0.5) / length as f64 - 1.0;
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let mut basis: Vec<Vec<f64>> = vec![];
    for power in 0..=degree {
        let mut next: Vec<f64> = match basis.last() {
            Some(last) if power > 0 => last.iter().enumerate().map(|(n, p)| at(n) * p).collect(),
            _ => vec![1.0; length],
        };
        for before in &basis {
            let share = dot(&next, before);
            next.iter_mut().zip(before).for_each(|(value, p)| *value -= share * p);
        }
        let size = dot(&next, &next).sqrt();
        if size == 0.0 {
            break;
        }
        next.iter_mut().for_each(|value| *value /= size);
        let share = dot(&values, &next);
        values.iter_mut().zip(&next).for_each(|(value, p)| *value -= share * p);
        basis.push(next);
    }
    (dot(&values, &values) / length.max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// RMS of a signal over a tenth of a second at 10 kHz.
    fn window(of: impl Fn(f64) -> f64) -> f64 {
        about_polynomial((0..1000).map(|n| of(f64::from(n) / 1e4)).collect())
    }

    #[test]
    fn what_dies_away_is_followed_and_what_bounces_is_not() {
        for time_s in [0.025, 0.05, 0.2] {
            let left = window(|t| 1.0 + libm::exp(-t / time_s));
            assert!(left < 0.005, "{time_s}: {left}");
        }
        for hz in [60.0, 100.0, 800.0] {
            let left = window(|t| 2f64.sqrt() * libm::sin(TAU * hz * t + 0.3));
            assert!((0.9..1.01).contains(&left), "{hz}: {left}");
        }
        for few in 0..30 {
            assert!(about_polynomial(vec![7.0; few]).abs() < 1e-12, "{few}");
        }
    }

    #[test]
    fn an_output_is_held_until_the_next_one() {
        assert_eq!(held(&[(1, 0.5, 0.0), (3, 0.25, 0.0)], 5), [0.5, 0.5, 0.25, 0.25]);
        assert_eq!(held(&[], 5), [0.0; 0]);
    }
}
