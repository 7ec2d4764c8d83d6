//! The inputs (senses) that a controller can have in addition to the count: commanded force, acceleration, and edge
//! times.
//!
//! Few estimators use these inputs. So a run is compiled in two forms: without these inputs ([`Blind`]) and with these
//! inputs ([`Full`]). The prepared scene selects one form per run. Only the input that the hit's estimator uses is
//! computed.

use zwidth::{
    units::Force,
    velocity::{Edge, Sense, Senses},
};

use crate::{
    scene::{LATENCY_KNOWN_MAX, Scene, element::EncoderError},
    simulation::{
        accelerometer::{Readings, Sensor, round},
        edge::last_edge,
        quantiser::Quantiser,
    },
};

/// Motion of a handle at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Handle {
    pub position_m: f64,
    pub speed_m_per_s: f64,
}

/// Computes the inputs in addition to the count, from the motion between samples.
pub trait Sensing: Copy {
    /// Whether there is any input in addition to the count.
    fn looks(&self) -> bool;
    fn senses(&self) -> &Senses;
    /// Takes a force that the controller granted, as a fraction of full scale.
    fn granted(&mut self, force: f64);
    /// Takes the handle's motion over one sample.
    fn moved(&mut self, from: Handle, to: Handle);
}

/// The inputs of a controller that gets nothing but the count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Blind;

impl Sensing for Blind {
    #[inline(always)]
    fn looks(&self) -> bool {
        false
    }

    #[inline(always)]
    fn senses(&self) -> &Senses {
        &Senses::NONE
    }

    #[inline(always)]
    fn granted(&mut self, _: f64) {}

    #[inline(always)]
    fn moved(&mut self, _: Handle, _: Handle) {}
}

/// The inputs that estimators can use.
///
/// *Force*: the force that was granted last, after saturation. This force stays constant until the next output, as in
/// the firmware ([`zwidth::safety::GuardedSampler`]). The estimator assumes that the force has acted since the last
/// sample. This assumption suits our boards, whose latency is below half a sample. With `actuator.latency_known`, the
/// estimator gets the force only when the force acts. This is later by the latency, rounded to whole samples.
///
/// *Acceleration*: the mean over the sample, computed from the speeds. If the scene's accelerometer has a bandwidth, a
/// first-order low-pass follows. Noise, bias, range and resolution are applied last.
///
/// *Edges*: the last crossing of the border between two counts. The path is the cubic through the positions and speeds
/// at both ends of the sample (Hermite), with the scene's encoder error. Under a constant force the error of the path
/// is below 1e-6 counts for the scenes' devices. If the force changes by dF within the sample, the error is up to
/// `0.0162 dF T^2 / m`: 0.005 counts for the whole range of the paper's device. Noise and jitter change once per
/// sample, so edges would not agree with the counts. For this reason a scene with noise or jitter has no edges
/// ([`Scene::feeds`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Full {
    /// The input that the estimator uses in addition to the counts. `None` if the estimator uses only counts.
    looks_at: Option<Sense>,
    encoder: Quantiser,
    /// Factor from m/s to counts per sample.
    speed: f64,
    accelerometer: Option<Sensor>,
    encoder_error: Option<EncoderError>,
    told: Told,
    senses: Senses,
}

/// Ring of granted forces that the estimator has not received yet, one per sample.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Told {
    granted: Force,
    ring: [Force; LATENCY_KNOWN_MAX as usize],
    /// Number of used entries in the ring. If it is 0, the estimator gets a force at once.
    samples: usize,
    next: usize,
}

impl Told {
    fn new(scene: &Scene) -> Self {
        let actuator = &scene.actuator;
        let samples = if actuator.latency_known { actuator.latency_samples() as usize } else { 0 };
        Self { granted: Force::ZERO, ring: [Force::ZERO; _], samples, next: 0 }
    }

    /// Moves the ring on by one sample. Returns the force that the estimator gets at this sample.
    fn moved(&mut self) -> Force {
        if self.samples == 0 {
            return self.granted;
        }
        let told = std::mem::replace(&mut self.ring[self.next], self.granted);
        self.next = (self.next + 1) % self.samples;
        told
    }
}

impl Full {
    /// The inputs of this scene, at rest before sample 0, for an estimator that uses `looks_at`.
    pub fn new(scene: &Scene, looks_at: Option<Sense>) -> Self {
        let design = scene.design();
        let (rate_hz, resolution_m) = (design.rate_hz, design.resolution_m);
        Self {
            looks_at,
            encoder: Quantiser::of(&scene.encoder),
            speed: 1.0 / (resolution_m * rate_hz),
            accelerometer: scene
                .accelerometer
                .as_ref()
                .map(|sensor| Sensor::new(sensor, rate_hz, resolution_m)),
            encoder_error: scene.encoder_error,
            told: Told::new(scene),
            senses: Senses::NONE,
        }
    }

    /// Sensor and noise of the accelerometer, for hits of `samples` samples.
    pub(crate) fn readings(&self, samples: u32) -> Option<Readings> {
        self.accelerometer.map(|sensor| Readings::new(sensor, self.speed, samples))
    }
}

impl Sensing for Full {
    #[inline]
    fn looks(&self) -> bool {
        self.looks_at.is_some()
    }

    #[inline]
    fn senses(&self) -> &Senses {
        &self.senses
    }

    #[inline]
    fn granted(&mut self, force: f64) {
        let bits = round(force * f64::from(Force::FULL_SCALE.bits()));
        self.told.granted = Force::saturating_from_bits(bits);
    }

    #[inline]
    fn moved(&mut self, from: Handle, to: Handle) {
        self.senses.force = self.told.moved();
        if self.looks_at == Some(Sense::Force) {
            return;
        }
        let [v0, v1] = [from, to].map(|handle| handle.speed_m_per_s * self.speed);
        if let Some(sensor) = &mut self.accelerometer {
            self.senses.acceleration = sensor.read(v1 - v0);
        }
        if self.looks_at != Some(Sense::Edge) {
            return;
        }
        let [shown, shown_then] = [from, to].map(|Handle { position_m, speed_m_per_s }| {
            let (error_m, slope) = self
                .encoder_error
                .map_or((0.0, 0.0), |e| (e.error_m(position_m), e.slope(position_m)));
            let position = self.encoder.place(position_m + error_m);
            [position, speed_m_per_s * (1.0 + slope) * self.speed]
        });
        self.senses.edge = match last_edge(shown, shown_then) {
            Some((at, up)) => {
                let age = ((1.0 - at) * f64::from(Edge::SAMPLE)).floor();
                Some(Edge { age: whole(age).min(Edge::SAMPLE - 1), up })
            }
            None => self
                .senses
                .edge
                .map(|edge| Edge { age: edge.age.saturating_add(Edge::SAMPLE), ..edge }),
        };
    }
}

fn whole(value: f64) -> u32 {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "saturates, as it must"
    )]
    let whole = value as u32;
    whole
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Accelerometer, NamedScene};
    use zwidth::VelocitySettings;

    fn full(edit: impl FnOnce(&mut Scene)) -> Full {
        let mut scene = NamedScene::load("paper-1um").unwrap().scene;
        edit(&mut scene);
        Full::new(&scene, scene.velocity.sense())
    }

    fn handle(position_m: f64, speed_m_per_s: f64) -> Handle {
        Handle { position_m, speed_m_per_s }
    }

    #[test]
    fn the_force_is_the_one_last_granted_whatever_the_latency() {
        let mut sensing = full(|scene| scene.actuator.latency = 10.25);
        assert_eq!(sensing.senses.force, Force::ZERO);
        sensing.granted(0.375);
        sensing.moved(handle(0.0, 0.0), handle(1e-6, 0.0));
        assert_eq!(sensing.senses.force.bits(), 3 << 27);
        sensing.granted(-1.0);
        sensing.moved(handle(0.0, 0.0), handle(1e-6, 0.0));
        assert_eq!(sensing.senses.force.bits(), -(1 << 30));
    }

    #[test]
    fn with_a_known_latency_it_is_the_one_that_acts() {
        for (latency, samples) in [(0.49, 0), (2.6, 3), (64.0, 64)] {
            let mut sensing = full(|scene| {
                scene.actuator.latency = latency;
                scene.actuator.latency_known = true;
                scene.check().unwrap();
            });
            for n in 0..200 {
                sensing.granted(f64::from(n + 1) / 1024.0);
                sensing.moved(handle(0.0, 0.0), handle(0.0, 0.0));
                let told = (n + 1 - samples).max(0) << 20;
                assert_eq!(sensing.senses.force.bits(), told, "{latency} {n}");
            }
        }
    }

    #[test]
    fn an_edge_gets_older_until_the_next_one() {
        let (at, on) = (handle(0.5e-6, 0.01), handle(1.5e-6, 0.01)); // one count per sample
        let mut rest =
            full(|scene| scene.velocity = VelocitySettings::TimeStamps { span_samples: 1 }.into());
        rest.moved(handle(0.5e-6, 0.0), handle(0.5e-6, 0.0));
        assert_eq!(rest.senses.edge, None);
        rest.moved(at, on);
        let half = rest.senses.edge.unwrap();
        assert!(half.up && half.age.abs_diff(1 << 15) <= 1, "{half:?}");
        let still = handle(1.5e-6, 0.0);
        rest.moved(still, still);
        assert_eq!(rest.senses.edge, Some(Edge { age: half.age + (1 << 16), up: true }));
    }

    #[test]
    fn edges_come_where_the_wrong_encoder_shows_them() {
        let error = EncoderError { cycle_m: 4e-6, first_m: 2e-7, second_m: 0.0, phase_rad: 0.7 };
        let mut wrong = full(|scene| {
            scene.velocity = VelocitySettings::TimeStamps { span_samples: 1 }.into();
            scene.encoder_error = Some(error);
        });
        let speed = 3e-7; // m per sample
        let shown = |n: f64| (n * speed + error.error_m(n * speed)) * 1e6;
        let mut edges = 0;
        for n in 0..200 {
            let (from, to) = (f64::from(n), f64::from(n + 1));
            wrong.moved(handle(from * speed, speed * 1e4), handle(to * speed, speed * 1e4));
            if shown(from).floor() == shown(to).floor() {
                continue;
            }
            let age = f64::from(wrong.senses.edge.unwrap().age) / f64::from(Edge::SAMPLE);
            let border = shown(to).floor();
            assert!((shown(to - age) - border).abs() < 2e-3, "{n}: {}", shown(to - age) - border);
            edges += 1;
        }
        assert!(edges > 50);
    }

    #[test]
    fn an_accelerometer_has_bias_range_resolution_bandwidth_and_noise() {
        let with = |edit: fn(&mut Accelerometer)| {
            let mut sensor = Accelerometer {
                full_scale_m_per_s2: 50.0,
                resolution_m_per_s2: 0.0,
                noise_m_per_s2_per_sqrt_hz: 0.0,
                bias_m_per_s2: 0.0,
                bandwidth_hz: None,
            };
            edit(&mut sensor);
            full(|scene| {
                scene.velocity = VelocitySettings::Fusion { crossover_hz: 0.0 }.into();
                scene.accelerometer = Some(sensor);
            })
        };
        // 1 m/s^2 is 0.01 counts per sample^2
        let read = |sensing: &mut Full, m_per_s2: f64| {
            sensing.moved(handle(0.0, 0.0), handle(0.0, m_per_s2 * 1e-4));
            f64::from(sensing.senses.acceleration.bits()) / 2f64.powi(24) * 100.0
        };
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-5, "{a} {b}");
        near(read(&mut with(|_| {}), 3.0), 3.0);
        near(read(&mut with(|s| s.bias_m_per_s2 = -0.5), 3.0), 2.5);
        near(read(&mut with(|_| {}), -70.0), -50.0);
        near(read(&mut with(|s| s.resolution_m_per_s2 = 0.4), 3.0), 3.2);
        let mut slow = with(|s| s.bandwidth_hz = Some(100.0));
        near(read(&mut slow, 3.0), 3.0 * (1.0 - (-2.0 * core::f64::consts::PI * 0.01).exp()));
        let mut noisy = with(|s| s.noise_m_per_s2_per_sqrt_hz = 0.01);
        let readings: Vec<f64> = (0..20_000).map(|_| read(&mut noisy, 0.0)).collect();
        let mean = readings.iter().sum::<f64>() / 20_000.0;
        let rms = (readings.iter().map(|x| x * x).sum::<f64>() / 20_000.0).sqrt();
        // The RMS is the density times the square root of half the rate, which is 0.7071. The tolerance is five
        // standard errors.
        assert!((rms / 0.5f64.sqrt() - 1.0).abs() < 0.025 && mean.abs() < 0.025, "{rms} {mean}");
    }
}
