//! Numbers of a scene that may be wrong. Each number is changed alone. The search first tries the values of a list.

use crate::{
    numerics::integrator::Integrator,
    scene::{
        Scene,
        element::{Amplifier, EncoderNoise, Friction},
    },
};

/// A number of the scene that may differ in the device.
#[derive(Clone, Debug)]
pub struct Suspect {
    /// Name in reports.
    pub name: &'static str,
    /// Key of the number in a scene file with linear units.
    pub key: &'static str,
    /// Unit of the values, as seen at the handle.
    pub unit: &'static str,
    /// The value in the scene; `None` if the scene does not have the element.
    pub own: Option<f64>,
    /// Values that the search tries first, in ascending order. All are above 0.
    pub values: Vec<f64>,
    edit: fn(&mut Scene, f64),
}

/// Factors by which the scene's own value is multiplied.
const TIMES: [f64; 9] = [0.5, 0.7, 0.85, 0.95, 1.05, 1.15, 1.3, 1.5, 2.0];
/// Bandwidths that are tried for the amplifier, in Hz.
const AMPLIFIERS_HZ: [f64; 8] = [50.0, 100.0, 200.0, 400.0, 800.0, 1500.0, 3000.0, 4900.0];
/// Values that are tried for dry friction, as a share of full force.
const DRY: [f64; 6] = [0.002, 0.005, 0.01, 0.02, 0.05, 0.1];
/// Values that are tried for the noise of the encoder, in counts RMS.
const NOISE: [f64; 5] = [0.1, 0.3, 1.0, 3.0, 10.0];
/// Latencies that are tried in addition to the scene's latency, in output periods.
const LATER: [f64; 8] = [0.05, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0, 1.5];
/// Seed of the random noise. It is used if the scene has no noise of its own.
const SEED: u32 = 1;
/// Stribeck speed of friction that is added to a scene without friction, in m/s. The static and the Coulomb friction of
/// this added friction are equal.
const STRIBECK_M_PER_S: f64 = 1e-3;

/// Divides mass, damping, stiffness and all other forces of the device by `times`. The device then moves as if the
/// motor's force were `times` as large as in the scene. The board does not know of this change. A count of the wrong
/// size has the same effect.
fn force(scene: &mut Scene, times: f64) {
    scene.device.mass_kg /= times;
    scene.device.damping_n_s_per_m /= times;
    scene.device.stiffness_n_per_m /= times;
    if let Some(friction) = &mut scene.friction {
        friction.coulomb_n /= times;
        friction.static_n /= times;
    }
    if let Some(cogging) = &mut scene.cogging {
        cogging.amplitude_n /= times;
    }
    if let Some(offset) = &mut scene.offset {
        offset.force_n /= times;
    }
}

fn friction(scene: &mut Scene, coulomb_n: f64) {
    let part = scene.friction.map_or(1.0, |own| own.static_n / own.coulomb_n);
    let stribeck_speed_m_per_s =
        scene.friction.map_or(STRIBECK_M_PER_S, |own| own.stribeck_speed_m_per_s);
    let static_n = coulomb_n * part;
    scene.friction = Some(Friction { coulomb_n, static_n, stribeck_speed_m_per_s });
    scene.integrator = scene.integrator.or(Some(Integrator::Rk4 { steps_per_sample: 1 }));
}

pub fn suspects(scene: &Scene) -> Vec<Suspect> {
    let mut all = vec![];
    let mut add =
        |name, key, unit, own: Option<f64>, mut values: Vec<f64>, edit: fn(&mut Scene, f64)| {
            values.sort_by(f64::total_cmp);
            all.push(Suspect { name, key, unit, own, values, edit });
        };
    let times = |own: f64| TIMES.iter().map(|times| times * own).collect::<Vec<_>>();
    let device = &scene.device;
    let (kg, b, k) = (device.mass_kg, device.damping_n_s_per_m, device.stiffness_n_per_m);
    add("mass", "device.mass_kg", "kg", Some(kg), times(kg), |scene, kg| scene.device.mass_kg = kg);
    let wide = |own: f64| {
        let wide = [0.1, 0.25, 4.0, 10.0].map(|times| times * own);
        times(own).into_iter().chain(wide).collect()
    };
    if b > 0.0 {
        let key = "device.damping_n_s_per_m";
        add("damping", key, "N s/m", Some(b), wide(b), |scene, b| {
            scene.device.damping_n_s_per_m = b
        });
    }
    if k > 0.0 {
        let key = "device.stiffness_n_per_m";
        add("stiffness", key, "N/m", Some(k), wide(k), |scene, k| {
            scene.device.stiffness_n_per_m = k
        });
    }
    // `force` does not divide the masses of an arm or of a second body. So it is not offered for scenes with these
    // elements.
    if scene.arm.is_none() && scene.mode.is_none() {
        let (key, unit) = ("actuator.gain_n_per_v", "times the scene's");
        add("force per command", key, unit, Some(1.0), times(1.0), force);
    }
    let (latency, period) = (scene.actuator.latency, f64::from(scene.actuator.period));
    let later = LATER.iter().map(|part| latency + part * period);
    let sooner = [0.25, 0.5, 0.75, 0.9].iter().map(|part| part * latency);
    let latencies = sooner.chain(later).filter(|latency| *latency > 0.0).collect();
    add("latency", "actuator.latency", "samples", Some(latency), latencies, |scene, samples| {
        scene.actuator.latency = samples
    });
    let own = scene.amplifier.map(|amplifier| amplifier.bandwidth_hz);
    let wider = |own| TIMES.iter().chain(&[0.1, 0.25, 4.0]).map(|times| times * own).collect();
    let bandwidths = own.map_or(AMPLIFIERS_HZ.to_vec(), wider);
    add("amplifier", "amplifier.bandwidth_hz", "Hz", own, bandwidths, |scene, bandwidth_hz| {
        scene.amplifier = Some(Amplifier { bandwidth_hz });
    });
    let own = scene.friction.map(|friction| friction.coulomb_n).filter(|own| *own > 0.0);
    let full_n = scene.full_scale_n();
    let dry = own.map_or(DRY.map(|part| part * full_n).to_vec(), wider);
    add("dry friction", "friction.coulomb_n", "N", own, dry, friction);
    let own = scene.encoder_noise.map(|noise| noise.rms_m);
    let resolution_m = scene.encoder.resolution_m;
    let noise = own.map_or(NOISE.map(|counts| counts * resolution_m).to_vec(), times);
    add("encoder noise", "encoder_noise.rms_m", "m", own, noise, |scene, rms_m| {
        let seed = scene.encoder_noise.map_or(SEED, |own| own.seed);
        scene.encoder_noise = Some(EncoderNoise { rms_m, seed });
    });
    all
}

impl Suspect {
    pub fn with(&self, scene: &Scene, value: f64) -> Scene {
        let mut changed = scene.clone();
        (self.edit)(&mut changed, value);
        changed
    }

    /// Relative distance of a value from the scene's value. A scene without the element has no value. Then the distance
    /// is measured from a value beyond the values that are tried first.
    pub fn far(&self, value: f64) -> f64 {
        let none = || match (self.values.first(), self.values.last()) {
            (_, Some(last)) if self.name == "amplifier" => 2.0 * last,
            (Some(first), _) => 0.5 * first,
            _ => 0.0,
        };
        let own = self.own.unwrap_or_else(none);
        (value - own).abs() / (value + own)
    }
}
