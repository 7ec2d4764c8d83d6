//! The scene's accelerometer in lanes: [`Sensor::read`] over vectors. All hits have the same noise sequence, so a lane
//! looks up the noise by sample number.

use std::sync::Arc;

use zwidth::{units::Acceleration, velocity::Fusion};

use crate::{
    engine::{
        lanes::ROWS,
        simd_ops::{SimdOps, lanes_mut},
    },
    simulation::accelerometer::{Readings, Sensor},
};

pub struct Accelerometer<S: SimdOps> {
    pub scale: Scale<S>,
    pub sensed: Sensed<S>,
    /// Noise of the next readings, in counts per sample^2.
    pub drawn: [S::f64s; ROWS],
    noise: Arc<[f64]>,
    /// Number of the next sample in each lane's hit.
    sample: S::u64s,
}

/// State of the sensors after a reading.
#[derive(Clone, Copy)]
pub struct Sensed<S: SimdOps> {
    /// Speed at the last sample, in counts per sample.
    speed: S::f64s,
    /// Output of the sensor's low-pass, in counts per sample^2.
    filtered: S::f64s,
}

/// Constants of a [`Sensor`], the same in all lanes.
#[derive(Clone, Copy)]
pub struct Scale<S: SimdOps> {
    speed: S::f64s,
    follows: S::f64s,
    bias: S::f64s,
    full_scale: S::f64s,
    /// Smallest step between two readings. `None` if the sensor does not quantise.
    resolution: Option<S::f64s>,
}

impl<S: SimdOps> Accelerometer<S> {
    pub fn none(simd: S) -> Self {
        let zero = simd.splat_f64s(0.0);
        let scale =
            Scale { speed: zero, follows: zero, bias: zero, full_scale: zero, resolution: None };
        let (noise, drawn, sample) = (Arc::default(), [zero; ROWS], simd.splat_u64s(0));
        Self { scale, sensed: Sensed { speed: zero, filtered: zero }, drawn, noise, sample }
    }

    /// Puts a sensor into a lane. The lane starts as if the sensor had not been read yet.
    pub fn start(&mut self, simd: S, lane: usize, readings: &Readings) {
        let Readings { sensor, speed, ref noise } = *readings;
        let splat = |value: f64| simd.splat_f64s(value);
        self.scale = Scale {
            speed: splat(speed),
            follows: splat(sensor.follows),
            bias: splat(sensor.bias),
            full_scale: splat(sensor.full_scale),
            resolution: (sensor.resolution > 0.0).then(|| splat(sensor.resolution)),
        };
        self.noise = noise.clone();
        lanes_mut::<_, u64>(&mut self.sample)[lane] = 0;
        lanes_mut::<_, f64>(&mut self.sensed.speed)[lane] = 0.0;
        lanes_mut::<_, f64>(&mut self.sensed.filtered)[lane] = 0.0;
    }

    /// Looks up the noise of the next samples.
    #[inline(always)]
    pub fn draw(&mut self, samples: usize) {
        for lane in 0..S::F64_LANES {
            let sample = &mut lanes_mut::<_, u64>(&mut self.sample)[lane];
            let begin = usize::try_from(*sample).unwrap_or(usize::MAX);
            *sample += samples as u64;
            let noise = self.noise.get(begin..).unwrap_or_default();
            let noise = noise.iter().chain(std::iter::repeat(&0.0));
            for (drawn, noise) in self.drawn.iter_mut().take(samples).zip(noise) {
                lanes_mut(drawn)[lane] = *noise;
            }
        }
    }
}

impl<S: SimdOps> Sensed<S> {
    /// The acceleration that the core's observer gets at this sample. `speed` is the handle's speed in m/s.
    #[inline(always)]
    pub fn read(&mut self, simd: S, scale: &Scale<S>, speed: S::f64s, noise: S::f64s) -> S::u64s {
        const LIMIT: f64 = Acceleration::LIMIT as f64 * Sensor::LSB;
        const MORE: f64 = (1u32 << Fusion::KNOWN_MORE) as f64;
        let shown = self.shown(simd, scale, speed, noise);
        let bits = simd.mul_f64s(shown, simd.splat_f64s(Sensor::LSB));
        let bits = simd.round(clamped(simd, bits, simd.splat_f64s(LIMIT)));
        simd.to_integer(simd.mul_f64s(bits, simd.splat_f64s(MORE)))
    }

    /// [`Sensor::shown`] over vectors. The result is in counts per sample^2.
    #[inline(always)]
    fn shown(&mut self, simd: S, scale: &Scale<S>, speed: S::f64s, noise: S::f64s) -> S::f64s {
        let last = std::mem::replace(&mut self.speed, simd.mul_f64s(speed, scale.speed));
        let step = simd.sub_f64s(simd.sub_f64s(self.speed, last), self.filtered);
        self.filtered = simd.add_f64s(self.filtered, simd.mul_f64s(scale.follows, step));
        let reading = simd.add_f64s(simd.add_f64s(self.filtered, noise), scale.bias);
        let shown = clamped(simd, reading, scale.full_scale);
        match scale.resolution {
            None => shown,
            Some(step) => simd.mul_f64s(simd.round(simd.div_f64s(shown, step)), step),
        }
    }
}

#[inline(always)]
fn clamped<S: SimdOps>(simd: S, value: S::f64s, limit: S::f64s) -> S::f64s {
    simd.min_of(simd.max_of(value, simd.neg_f64s(limit)), limit)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::{engine::simd_ops::lanes, scene::Accelerometer as Scene};

    /// Compares every lane with a scalar sensor. The lanes start one after the other, at rest, with the same speeds.
    fn hold<S: SimdOps>(simd: Option<S>, readings: &Readings, speeds_m_per_s: &[f64]) {
        let Some(simd) = simd else { return };
        let mut sensors = Accelerometer::none(simd);
        let mut alone = vec![(readings.sensor, None); S::F64_LANES];
        let (mut rest, mut block) = (speeds_m_per_s, 0);
        while !rest.is_empty() {
            let lane = block % S::F64_LANES;
            sensors.start(simd, lane, readings);
            alone[lane] = (readings.sensor, None);
            let (taken, later) = rest.split_at(rest.len().min(1 + block * 7 % ROWS));
            (rest, block) = (later, block + 1);
            sensors.draw(taken.len());
            for (n, speed) in taken.iter().enumerate() {
                let mut speeds = simd.splat_f64s(*speed);
                for (lane, (_, last)) in alone.iter().enumerate() {
                    if last.is_none() {
                        lanes_mut(&mut speeds)[lane] = 0.0;
                    }
                }
                let Accelerometer { scale, sensed, drawn, .. } = &mut sensors;
                let shown = { *sensed }.shown(simd, scale, speeds, drawn[n]);
                let known = sensed.read(simd, scale, speeds, drawn[n]);
                for (lane, (sensor, last)) in alone.iter_mut().enumerate() {
                    let speed = lanes::<_, f64>(&speeds)[lane] * readings.speed;
                    let mut read = Acceleration::ZERO;
                    if let Some(last) = last.replace(speed) {
                        let exact = { *sensor }.shown(speed - last);
                        let shown = lanes::<_, f64>(&shown)[lane];
                        assert_eq!(shown.to_bits(), exact.to_bits(), "{lane}, {shown} {exact}");
                        read = sensor.read(speed - last);
                    }
                    let told = i64::from(read.bits()) << Fusion::KNOWN_MORE;
                    assert_eq!(lanes::<_, i64>(&known)[lane], told, "lane {lane}, {read:?}");
                }
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(256))]

        /// The lanes' readings equal those of a single sensor to the last bit, before and after rounding to an LSB.
        #[test]
        fn every_lane_reads_as_a_sensor_alone(
            (offset, step) in (-8.0..4.0f64, -6.0..1.0f64),
            (full_scale, bias) in (-6.0..2.1f64, -1.0..1.0f64),
            resolution in prop::option::of(-8.0..0.0f64),
            noise in prop::option::of(-4.0..0.0f64),
            bandwidth_hz in prop::option::of(10.0..4000.0f64),
            tie in any::<bool>(),
            steps in prop::collection::vec(prop_oneof![Just(0.0), -1.0..1.0f64], 400),
        ) {
            let full_scale_m_per_s2 = 10f64.powf(full_scale);
            let share = |power: Option<f64>| {
                power.map_or(0.0, |power| full_scale_m_per_s2 * 10f64.powf(power))
            };
            // With `tie`, the reading at rest is exactly between two steps, or between two LSB.
            let mut bias_m_per_s2 = bias * full_scale_m_per_s2;
            if tie && resolution.is_some() {
                bias_m_per_s2 = (0.5 * share(resolution)).copysign(bias);
            } else if tie {
                bias_m_per_s2 = (bias_m_per_s2 * Sensor::LSB).floor() / Sensor::LSB;
                bias_m_per_s2 += 0.5 / Sensor::LSB;
            }
            let scene = Scene {
                full_scale_m_per_s2,
                resolution_m_per_s2: share(resolution),
                noise_m_per_s2_per_sqrt_hz: share(noise) / 70.0,
                bias_m_per_s2,
                bandwidth_hz,
            };
            // with these values 1 m/s^2 is one count per sample^2
            let (rate_hz, resolution_m) = (2f64.powi(13), 2f64.powi(-26));
            let sensor = Sensor::new(&scene, rate_hz, resolution_m);
            let readings = Readings::new(sensor, 1e4, 300); // the product of a speed and 1e4 is rounded
            let (offset, step) = (10f64.powf(offset), 10f64.powf(step) / rate_hz);
            let speeds: Vec<f64> = steps.iter().map(|at| offset + step * at).collect();
            hold(Some(pulp::Scalar), &readings, &speeds);
            #[cfg(target_arch = "x86_64")]
            {
                hold(pulp::x86::V3::try_new(), &readings, &speeds);
                hold(pulp::x86::V4::try_new(), &readings, &speeds);
            }
            #[cfg(target_arch = "aarch64")]
            hold(pulp::aarch64::Neon::try_new(), &readings, &speeds);
        }
    }
}
