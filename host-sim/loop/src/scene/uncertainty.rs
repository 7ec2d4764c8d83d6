//! Uncertainty of a device's numbers, and random devices drawn from it.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Scene, Units};
use crate::{numerics::random, range::within};

/// Standard deviations of values of `[device]` and `[actuator]`, in their units; 0: known exactly. The drawn values are
/// jointly Gaussian. A device outside the scene's ranges is drawn again.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Uncertainty {
    /// Standard deviation of the device's mass.
    #[serde(default)]
    pub mass_kg: f64,
    /// Standard deviation of the device's damping.
    #[serde(default)]
    pub damping_n_s_per_m: f64,
    /// Standard deviation of the device's stiffness.
    #[serde(default)]
    pub stiffness_n_per_m: f64,
    /// Standard deviation of the device's rest position.
    #[serde(default)]
    pub rest_position_m: f64,
    /// Standard deviation of the actuator's gain.
    #[serde(default)]
    pub gain_n_per_v: f64,
    /// Standard deviation of the latency in samples.
    #[serde(default)]
    pub latency: f64,
    /// Each entry has two keys of this table, or their rotary names, and the correlation, -1 to 1. Absent pairs: 0.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub correlations: Vec<(String, String, f64)>,
}

/// Number of uncertain quantities.
const COUNT: usize = 6;
/// Largest number of draws for one device. A draw outside the scene's ranges is repeated.
const DRAWS_MAX: u64 = 1000;
/// Largest remaining variance that counts as 0, because it is a rounding error.
const ROUNDING: f64 = 1e-9;

type Matrix = [[f64; COUNT]; COUNT];

impl Uncertainty {
    /// The keys, in the order of the draws.
    pub const NAMES: [&str; COUNT] = [
        "mass_kg",
        "damping_n_s_per_m",
        "stiffness_n_per_m",
        "rest_position_m",
        "gain_n_per_v",
        "latency",
    ];

    fn deviations(&self) -> [f64; COUNT] {
        [
            self.mass_kg,
            self.damping_n_s_per_m,
            self.stiffness_n_per_m,
            self.rest_position_m,
            self.gain_n_per_v,
            self.latency,
        ]
    }

    /// Index of the quantity that has this name in linear or in rotary scenes.
    pub fn place(name: &str) -> Option<usize> {
        let is = |known: &&str| {
            *known == name || Units::rotary_key(known).is_some_and(|rotary| rotary == name)
        };
        Self::NAMES.iter().position(is)
    }

    /// Cholesky factor of the correlation matrix.
    fn factor(&self) -> Result<Matrix, String> {
        let mut wanted: Matrix = [[0.0; COUNT]; COUNT];
        for (n, row) in wanted.iter_mut().enumerate() {
            row[n] = 1.0;
        }
        for (a, b, correlation) in &self.correlations {
            let place = |name: &String| {
                Self::place(name).ok_or_else(|| {
                    let allowed = Self::NAMES.join(", ");
                    format!("uncertainty.correlations: {name} is unknown, allowed {allowed}")
                })
            };
            let (a, b) = (place(a)?, place(b)?);
            if a == b {
                return Err(
                    "uncertainty.correlations: a name stands twice in one, allowed two names"
                        .into(),
                );
            }
            within("uncertainty.correlations", *correlation, -1.0..=1.0)?;
            (wanted[a][b], wanted[b][a]) = (*correlation, *correlation);
        }
        let mut factor: Matrix = [[0.0; COUNT]; COUNT];
        for row in 0..COUNT {
            for column in 0..=row {
                let done: f64 = (0..column).map(|n| factor[row][n] * factor[column][n]).sum();
                let left = wanted[row][column] - done;
                factor[row][column] = if row != column {
                    if factor[column][column] > 0.0 { left / factor[column][column] } else { 0.0 }
                } else if left < -ROUNDING {
                    return Err(
                        "uncertainty.correlations contradict each other, allowed a positive \
                                semidefinite matrix"
                            .into(),
                    );
                } else {
                    left.max(0.0).sqrt()
                };
            }
        }
        Ok(factor)
    }

    /// Random deviation of each quantity, for the device with number `n` of a seed.
    fn offsets(&self, seed: u64, n: u64) -> Result<[f64; COUNT], String> {
        let factor = self.factor()?;
        let normal: Vec<f64> =
            (0..COUNT as u64).map(|k| random::gaussian(seed, n * COUNT as u64 + k)).collect();
        let mut offsets = self.deviations();
        for (offset, row) in offsets.iter_mut().zip(&factor) {
            *offset *= row.iter().zip(&normal).map(|(a, b)| a * b).sum::<f64>();
        }
        Ok(offsets)
    }
}

impl Scene {
    pub(super) fn check_uncertainty(&self) -> Result<(), String> {
        let Some(uncertainty) = &self.uncertainty else { return Ok(()) };
        for (name, value) in Uncertainty::NAMES.iter().zip(uncertainty.deviations()) {
            within(&format!("uncertainty.{name}"), value, 0.0..=1e9)?;
        }
        uncertainty.factor().map(|_| ())
    }

    /// Draws the device with number `n` from `[uncertainty]`. Without `[uncertainty]`, returns the scene itself. The
    /// result depends only on `seed` and `n`.
    ///
    /// # Errors
    /// None of the draws is within the scene's ranges.
    pub fn drawn(&self, seed: u64, n: u64) -> Result<Self, String> {
        let Some(uncertainty) = &self.uncertainty else { return Ok(self.clone()) };
        for attempt in 0..DRAWS_MAX {
            let [m, b, k, x, gain, latency] = uncertainty.offsets(seed, n * DRAWS_MAX + attempt)?;
            let mut scene = self.clone();
            scene.device.mass_kg += m;
            scene.device.damping_n_s_per_m += b;
            scene.device.stiffness_n_per_m += k;
            scene.device.rest_position_m += x;
            scene.actuator.gain_n_per_v += gain;
            scene.actuator.latency += latency;
            if scene.check().is_ok() {
                return Ok(scene);
            }
        }
        Err("uncertainty: hardly any device that it draws is within the scene's ranges; lower it"
            .into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::NamedScene;

    fn scene(table: &str) -> Result<Scene, crate::error::Error> {
        let text = format!("{}\n{table}", include_str!("../../../../scenes/paper-2um.toml"));
        NamedScene::parse("s".into(), text, "s.toml").map(|named| named.scene)
    }

    #[test]
    fn devices_have_the_deviations_and_correlations_that_are_asked_for() {
        let table = "[uncertainty]\nmass_kg = 0.02\ndamping_n_s_per_m = 0.8\nlatency = 1.0\n\
                     correlations = [[\"mass_kg\", \"latency\", 0.6]]";
        let scene = scene(table).unwrap();
        let count = 5000u32;
        let drawn: Vec<[f64; 3]> = (0..u64::from(count))
            .map(|n| {
                let one = scene.drawn(7, n).unwrap();
                assert_eq!(one.device.stiffness_n_per_m, scene.device.stiffness_n_per_m);
                [
                    (one.device.mass_kg - scene.device.mass_kg) / 0.02,
                    (one.device.damping_n_s_per_m - scene.device.damping_n_s_per_m) / 0.8,
                    one.actuator.latency - scene.actuator.latency,
                ]
            })
            .collect();
        let mean =
            |of: &dyn Fn(&[f64; 3]) -> f64| drawn.iter().map(of).sum::<f64>() / f64::from(count);
        // the tolerances are four standard errors
        for n in 0..3 {
            assert!(mean(&|d| d[n]).abs() < 0.057);
            assert!((mean(&|d| d[n] * d[n]) - 1.0).abs() < 0.08);
        }
        assert!((mean(&|d| d[0] * d[2]) - 0.6).abs() < 0.066, "{}", mean(&|d| d[0] * d[2]));
        assert!(mean(&|d| d[0] * d[1]).abs() < 0.057);
        assert_eq!(scene.drawn(7, 3).unwrap(), scene.drawn(7, 3).unwrap());
        assert_ne!(scene.drawn(7, 3).unwrap(), scene.drawn(8, 3).unwrap());
    }

    #[test]
    fn what_cannot_be_drawn_is_refused_in_one_line() {
        for (table, says) in [
            ("mass_kg = -0.1", "uncertainty.mass_kg"),
            ("correlations = [[\"mass_kg\", \"mass\", 0.1]]", "mass is unknown"),
            ("correlations = [[\"mass_kg\", \"latency\", 1.5]]", "1.5"),
            ("correlations = [[\"latency\", \"latency\", 0.5]]", "twice"),
            (
                "correlations = [[\"mass_kg\", \"latency\", 0.9], [\"mass_kg\", \"gain_n_per_v\", 0.9], \
                 [\"latency\", \"gain_n_per_v\", -0.9]]",
                "contradict",
            ),
            ("weight = 1.0", "weight"),
        ] {
            let error = scene(&format!("[uncertainty]\n{table}")).unwrap_err().to_string();
            assert!(error.contains(says), "{table}: {error}");
        }
        // a tenth of the draws have a negative latency; these draws are repeated
        let scene = scene("[uncertainty]\nlatency = 8.0").unwrap();
        assert!((0..200).all(|n| scene.drawn(1, n).unwrap().actuator.latency >= 0.0));
    }
}
