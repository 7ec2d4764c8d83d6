//! What the simulator predicts for the page's (K, B) plane. It is the boundary of an estimator with one tuning, walked
//! as by `cargo sim walk`, and the board's envelope.

use std::sync::atomic::AtomicBool;

use host_sim::{
    engine::Engine,
    scene::{Criterion, NamedScene, Scene},
    simulation::prepared::{Numeric, PreparedScene},
    study::{boundary::Boundary, walk},
};
use serde::Serialize;
use zwidth::{
    CounterWidth, Sampler, Settings, WallSettings,
    device::Device,
    safety::envelope::Key,
    velocity::{EstimatorName, VelocitySettings},
};

/// A boundary for the page, in m and N at the handle.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Predicted {
    pub estimator: String,
    pub cutoff_hz: f64,
    /// The points of the boundary. Each is B in N s/m and K in N/m.
    pub points: Vec<[f64; 2]>,
    /// Area under the boundary, in N^2 s/m^2.
    pub area: f64,
    /// Boundary of the quiet walls, whatever criterion the scene has. Empty if the grid has no quiet wall.
    pub quiet: Vec<[f64; 2]>,
    /// Area under the quiet boundary, in N^2 s/m^2.
    pub quiet_area: f64,
    /// The rows of the board's envelope. Each row is B, lowest K and highest K.
    pub envelope: Vec<[f64; 3]>,
    /// Delay of the estimated velocity at constant acceleration, in s.
    pub delay_s: Option<f64>,
    /// RMS error of the estimated velocity at 20 mm/s, in m/s. Only the rounding to whole counts causes it.
    pub noise_m_per_s: Option<f64>,
    /// Reason why there is no boundary. `None` if there is one.
    pub error: Option<String>,
}

/// Walks a boundary in the simulator, which takes about a second. `device` is the device of the board's record. It is
/// `None` if the record has no envelope.
pub fn predict(
    scene: &NamedScene,
    device: Option<&Device<'_>>,
    estimator: &str,
    cutoff_hz: f64,
    ended: &AtomicBool,
) -> Predicted {
    let mut predicted = Predicted {
        estimator: estimator.to_owned(),
        cutoff_hz,
        envelope: device.map_or_else(Vec::new, |device| envelope(device, estimator, cutoff_hz)),
        ..Predicted::default()
    };
    let Some(name) = EstimatorName::ALL.iter().find(|name| name.text() == estimator) else {
        predicted.error = Some(format!("there is no estimator {estimator}"));
        return predicted;
    };
    let velocity = name.following(&scene.scene.velocity.at(cutoff_hz));
    (predicted.delay_s, predicted.noise_m_per_s) = quality(&scene.scene, velocity).unzip();
    let points = |of: &Boundary| -> Vec<[f64; 2]> {
        of.points.iter().map(|p| [p.damping_n_s_per_m, p.stiffness_n_per_m]).collect()
    };
    let mut scene = scene.scene.clone();
    scene.velocity = velocity.into();
    match boundary(&scene, velocity, ended) {
        Ok(found) => (predicted.points, predicted.area) = (points(&found), found.area),
        Err(error) => predicted.error = Some(error),
    }
    scene.wall_hit.judge(Criterion::Quiet, None);
    if let Ok(found) = boundary(&scene, velocity, ended) {
        (predicted.quiet, predicted.quiet_area) = (points(&found), found.area);
    }
    predicted
}

/// Speed at which the noise is measured, in m/s.
pub const SPEED: f64 = 0.02;
/// Acceleration at which the delay is measured, in m/s^2.
const RISE: f64 = 1.0;
/// Number of samples before a measurement. `LOOKED_AT` is the number of samples in the measurement.
const SETTLE: u32 = 5_000;
const LOOKED_AT: u32 = 5_000;

/// The rows of a filter in a device's envelope, for the device's own output period. Each row is B, lowest K and highest
/// K.
fn envelope(device: &Device<'_>, estimator: &str, cutoff_hz: f64) -> Vec<[f64; 3]> {
    let same = |other: f64| (other - cutoff_hz).abs() <= 1e-9 * other.abs().max(cutoff_hz.abs());
    let is_its = |key: &Key| {
        (key.period, key.design) == (device.design.period, 0)
            && key.estimator.text() == estimator
            && same(key.cutoff_hz)
    };
    let all = device.envelope.boundaries();
    all.filter(|(key, _)| is_its(key))
        .flat_map(|(_, points)| points)
        .map(|p| [p.damping_n_s_per_m, p.stiffness_low_n_per_m, p.stiffness_high_n_per_m])
        .collect()
}

/// Delay and noise of the core's estimator. They are measured with known motions in whole counts.
fn quality(scene: &Scene, velocity: VelocitySettings) -> Option<(f64, f64)> {
    let (rate_hz, resolution_m) = (scene.control.rate_hz, scene.encoder.resolution_m);
    let wall = WallSettings {
        position_m: 1.0,
        stiffness_n_per_m: 0.0,
        damping_n_s_per_m: 0.0,
        push_only: true,
    };
    let control = Settings { velocity, wall }.build(&scene.design()).ok()?;
    let lsb = resolution_m * rate_hz / 65_536.0;
    let errors = |rise: f64| -> Vec<f64> {
        let mut sampler = Sampler::new(0, CounterWidth::Bits32);
        let moved = |n: u32| {
            let t = f64::from(n) / rate_hz;
            [SPEED * t + 0.5 * rise * t * t, SPEED + rise * t]
        };
        let step = |n: u32| {
            let [place_m, speed] = moved(n);
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "below 2^20"
            )]
            let counts = (place_m / resolution_m) as u32;
            let sampled = sampler.sample(&control, counts);
            speed - f64::from(sampled.motion.velocity.bits()) * lsb
        };
        (0..SETTLE + LOOKED_AT).map(step).skip(SETTLE as usize).collect()
    };
    let mean = |all: &[f64]| all.iter().sum::<f64>() / f64::from(LOOKED_AT);
    let (late, even) = (errors(RISE), errors(0.0));
    let delay_s = (mean(&late) - mean(&even)) / RISE;
    let squares: Vec<f64> = even.iter().map(|error| error * error).collect();
    Some((delay_s, mean(&squares).sqrt()))
}

fn boundary(
    scene: &Scene,
    velocity: VelocitySettings,
    ended: &AtomicBool,
) -> Result<Boundary, String> {
    let prepared = PreparedScene::new(scene).map_err(|error| error.to_string())?;
    walk::walk(Engine::lanes(), &prepared, Numeric::default(), velocity, 0.0, ended)
        .map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use virtual_board::{board::NUCLEO_F446RE, device};

    /// At low frequencies a second-order Butterworth lags by sqrt 2 / w, and the finite difference lags by half a
    /// sample. The predicted boundary equals the simulator's walk.
    #[test]
    fn delay_and_noise_are_the_filters() {
        let scene = NamedScene::load("nucleo-f446re").unwrap();
        let of = |hz| quality(&scene.scene, scene.scene.velocity.at(hz)).unwrap();
        for cutoff_hz in [50.0, 200.0] {
            let (delay_s, noise) = of(cutoff_hz);
            let wanted_s = 2f64.sqrt() / (2.0 * std::f64::consts::PI * cutoff_hz) + 0.5e-4;
            assert!((delay_s / wanted_s - 1.0).abs() < 0.03, "{cutoff_hz}: {delay_s}, {wanted_s}");
            assert!(noise < 0.001);
        }
        let [slow, fast] = [100.0, 2000.0].map(of);
        assert!(slow.0 > fast.0 && slow.1 < fast.1);
        let ended = AtomicBool::new(false);
        let nothing = predict(&scene, None, "nonsense", 1000.0, &ended);
        assert!(nothing.error.unwrap().contains("nonsense") && nothing.delay_s.is_none());
    }

    #[test]
    fn quiet_walls_are_those_of_the_simulator() {
        let ended = AtomicBool::new(false);
        let scene = NamedScene::load("nucleo-f446re").unwrap();
        let predicted = predict(&scene, None, "butterworth", 360.0, &ended);
        assert!(predicted.quiet_area > 3.5e7 && predicted.quiet_area < predicted.area);
        let stiffest = predicted.quiet.iter().map(|[_, k]| *k).fold(0.0, f64::max);
        assert!((150e3..165e3).contains(&stiffest), "{stiffest}");
    }

    #[test]
    fn the_envelope_is_that_of_the_boards_record() {
        let ended = AtomicBool::new(true);
        let scene = NamedScene::load("nucleo-f446re").unwrap();
        let built_in = device::built_in(NUCLEO_F446RE);
        let rows = |device, hz| predict(&scene, device, "butterworth", hz, &ended).envelope.len();
        assert!(rows(Some(built_in), 1500.0) > 10);
        assert_eq!([rows(Some(built_in), 1501.0), rows(None, 1500.0)], [0, 0]);
    }
}
