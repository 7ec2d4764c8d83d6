//! Compares three boundaries of one estimator: the linear envelope, the walls that are passive with any hand, and the
//! simulated boundary. Each point of the simulated boundary is explained.
//!
//! The simulated boundary may be above the linear envelope. Above the envelope the linear loop is unstable, so the
//! handle does not come to rest. Quantisation, saturation and the one-sided wall turn the growing oscillation into a
//! limit cycle. The wall counts as stable if the RMS of this limit cycle is below the limit of the wall hit. The
//! simulated boundary may also be below the linear envelope, because the hit starts far from rest and saturation delays
//! the force.

use std::sync::atomic::AtomicBool;

use zwidth::VelocitySettings;

use crate::{
    analysis::linear::{self, LinearError, passivity::Passivity},
    engine::Engine,
    error::Error,
    interrupt,
    simulation::prepared::{HitReport, Numeric, PreparedScene},
    study::{boundary::BoundaryPoint, walk::walk},
};

/// A point of the simulated boundary, with the linear analysis of its wall and the result of its hit.
#[derive(Clone, Debug, PartialEq)]
pub struct Explained {
    pub point: BoundaryPoint,
    /// End of the linear envelope at this B, in N/m. The linear loop is stable for every K from 0 to this value. The
    /// value is infinite if it is stable for every K.
    pub linear_n_per_m: f64,
    /// Further intervals of K above the envelope in which the linear loop is stable, in N/m.
    pub further_stable_n_per_m: Vec<(f64, f64)>,
    pub report: HitReport,
}

impl Explained {
    /// Whether the linear loop is unstable at this wall. If so, the wall is above the envelope and in no further stable
    /// interval.
    pub fn is_unstable(&self) -> bool {
        let k = self.point.stiffness_n_per_m;
        let further = |&(from, to): &(f64, f64)| (from..=to).contains(&k);
        k > self.linear_n_per_m && !self.further_stable_n_per_m.iter().any(further)
    }
}

/// Walks along the simulated boundary from the scene's own start, and compares every point with the linear envelope.
///
/// # Errors
/// A setting is out of range, the handle does not reach the wall, or `stop` was set.
pub fn explain(
    engine: Engine,
    prepared: &PreparedScene,
    numeric: Numeric,
    velocity: VelocitySettings,
    envelope: &linear::Boundary,
    stop: &AtomicBool,
) -> Result<Vec<Explained>, Error> {
    let boundary = walk(engine, prepared, numeric, velocity, 0.0, stop)?;
    boundary
        .points
        .into_iter()
        .map(|point| {
            interrupt::unless(stop)?;
            let limit = envelope.at(point.damping_n_s_per_m).map_err(Error::input)?;
            let report = prepared.report(numeric, &point.hit(velocity))?;
            Ok(Explained {
                point,
                linear_n_per_m: limit.stiffness_max,
                further_stable_n_per_m: limit.further_stable,
                report,
            })
        })
        .collect()
}

/// Number of intervals into which the edge of the passive region is divided. The edge goes from B = 0 to the largest B
/// at which K = 0 is passive.
const REGION_POINTS: u32 = 64;

/// The edge of the region of walls that are passive with any hand. It begins at B = 0.
///
/// # Errors
/// The device's damping is not finite.
pub fn passive_region(
    device_damping_n_s_per_m: f64,
    passivity: &Passivity,
) -> Result<Vec<BoundaryPoint>, LinearError> {
    let damping_max = passivity.damping_max(device_damping_n_s_per_m)?;
    let mut points = vec![];
    for n in 0..=REGION_POINTS {
        let damping_n_s_per_m = damping_max * f64::from(n) / f64::from(REGION_POINTS);
        let stiffness = passivity.stiffness_max(device_damping_n_s_per_m, damping_n_s_per_m)?;
        let stiffness_n_per_m = stiffness.unwrap_or(0.0);
        points.push(BoundaryPoint { damping_n_s_per_m, stiffness_n_per_m });
    }
    Ok(points)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        analysis::linear::{Device, Loop, TransferFunction},
        scene::NamedScene,
        simulation::prepared::WallHit,
    };

    #[test]
    fn points_above_the_envelope_are_limit_cycles_and_a_strict_limit_refuses_them() {
        let mut scene = NamedScene::load("paper-1um").unwrap().scene;
        let device = Device {
            mass_kg: scene.device.mass_kg,
            damping_n_s_per_m: scene.device.damping_n_s_per_m,
            stiffness_n_per_m: scene.device.stiffness_n_per_m,
        };
        let cutoff_hz = 500.0;
        let rate_hz = scene.control.rate_hz;
        let mut of = Loop::single_rate(
            device,
            rate_hz,
            TransferFunction::paper(rate_hz, cutoff_hz).unwrap(),
        );
        of.period = scene.actuator.period;
        of.latency_samples = scene.actuator.latency;
        let envelope = linear::Boundary::new(&of).unwrap();
        let stop = AtomicBool::new(false);
        let explained = explain(
            Engine::lanes(),
            &PreparedScene::new(&scene).unwrap(),
            Numeric::Fixed,
            VelocitySettings::Butterworth { cutoff_hz },
            &envelope,
            &stop,
        )
        .unwrap();
        let above: Vec<&Explained> = explained.iter().filter(|e| e.is_unstable()).collect();
        assert!(above.len() >= 20 && explained.len() > above.len() + 10, "{}", above.len());
        // A handle that rests between two counts has an RMS below half a count.
        let at_rest_m = 0.5 * scene.encoder.resolution_m;
        assert!(above.iter().all(|e| e.report.is_stable() && e.report.rms_m > at_rest_m));
        scene.wall_hit.rms_limit_m = at_rest_m;
        let strict = PreparedScene::new(&scene).unwrap();
        for e in above {
            let wall = WallHit {
                velocity: VelocitySettings::Butterworth { cutoff_hz },
                stiffness_n_per_m: e.point.stiffness_n_per_m,
                damping_n_s_per_m: e.point.damping_n_s_per_m,
                start_offset_counts: 0.0,
            };
            assert!(!strict.hit(Numeric::Fixed, &wall, |_| {}).unwrap().is_stable(), "{e:?}");
        }
    }

    /// The loop is unstable at K = 0 and stable in an interval of higher K. A point in this interval is no limit cycle.
    #[test]
    fn a_point_in_a_further_stable_stretch_is_stable() {
        // The filter is far slower than the device with its spring.
        let device = Device { mass_kg: 0.4, damping_n_s_per_m: 5.0, stiffness_n_per_m: 1e4 };
        let of = Loop::single_rate(device, 1e4, TransferFunction::paper(1e4, 20.0).unwrap());
        let envelope = linear::Boundary::new(&of).unwrap();
        let scene = NamedScene::load("paper-1um").unwrap().scene;
        let (damping_n_s_per_m, limit) = (250..320)
            .map(|tenths| f64::from(tenths) / 10.0)
            .map(|damping| (damping, envelope.at(damping).unwrap()))
            .find(|(_, limit)| limit.unstable_at_zero && !limit.further_stable.is_empty())
            .unwrap();
        let &(from, to) = limit.further_stable.first().unwrap();
        let report = PreparedScene::new(&scene)
            .unwrap()
            .hit(
                Numeric::Fixed,
                &WallHit {
                    velocity: VelocitySettings::Butterworth { cutoff_hz: 1500.0 },
                    stiffness_n_per_m: 20_000.0,
                    damping_n_s_per_m: 50.0,
                    start_offset_counts: 0.0,
                },
                |_| {},
            )
            .unwrap();
        let at = |stiffness_n_per_m: f64| Explained {
            point: BoundaryPoint { damping_n_s_per_m, stiffness_n_per_m },
            linear_n_per_m: limit.stiffness_max,
            further_stable_n_per_m: limit.further_stable.clone(),
            report,
        };
        for (k, unstable) in
            [(0.99 * from, true), (1.01 * from, false), (0.99 * to, false), (1.01 * to, true)]
        {
            assert!(k > limit.stiffness_max);
            assert_eq!(at(k).is_unstable(), unstable, "{k}");
            assert_eq!(envelope.unstable_roots(k, damping_n_s_per_m) > 0, unstable, "{k}");
        }
    }

    #[test]
    fn the_passive_region_ends_where_the_demand_is_the_device_damping() {
        let mut of =
            Loop::single_rate(Device::PAPER, 1e3, TransferFunction::finite_difference(1e3));
        // The condition b > K T/2 + |B| gives a triangle.
        let passivity = Passivity::new(&of).unwrap();
        let region = passive_region(5.5, &passivity).unwrap();
        let (first, last) = (region[0], region[region.len() - 1]);
        assert!((first.stiffness_n_per_m - 11_000.0).abs() < 0.1, "{first:?}");
        assert!((last.damping_n_s_per_m - 5.5).abs() < 1e-6, "{last:?}");
        for point in &region {
            let k = 2e3 * (5.5 - point.damping_n_s_per_m);
            assert!((point.stiffness_n_per_m - k).abs() < 0.1, "{point:?}");
        }
        assert_eq!(passivity.stiffness_max(5.5, 6.0).unwrap(), None);
        // The real loop is stable inside its own envelope, which begins at 3693 N/m.
        of = Loop::single_rate(Device::PAPER, 1e4, TransferFunction::paper(1e4, 1500.0).unwrap());
        (of.period, of.latency_samples) = (10, 10.0);
        let b = of.device.damping_n_s_per_m;
        let region = passive_region(b, &Passivity::new(&of).unwrap()).unwrap();
        let envelope = linear::Boundary::new(&of).unwrap();
        assert!((region[0].stiffness_n_per_m / 3679.67 - 1.0).abs() < 1e-4, "{:?}", region[0]);
        for point in region {
            let limit = envelope.at(point.damping_n_s_per_m).unwrap().stiffness_max;
            assert!(point.stiffness_n_per_m < limit, "{point:?} {limit}");
        }
    }
}
