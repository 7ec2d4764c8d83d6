//! The report of a designed excitation: the JSON object of `identify --plan`. A plan in Python has the same keys.

use serde::Serialize;

use super::plan::{Plan, Pulse, plan};
use crate::{
    error::Error,
    scene::{NamedScene, Units},
};

/// The whole report; docs/files.md has the keys.
#[derive(Clone, Debug, Serialize)]
pub struct Planned {
    pub scene: String,
    /// Position at which each pulse starts.
    pub start_m: f64,
    pub push_n: f64,
    pub pulses: Vec<Pulse>,
    /// RMS of the force over the whole train.
    pub force_rms_n: f64,
    /// Force that the motor can give continuously.
    pub continuous_force_n: f64,
    /// Limits that the scene does not have and whose values were guessed. They are in the scene's units.
    pub guessed: Vec<String>,
    /// The lines to type at the console, in the scene's units. `cargo board run` accepts these lines too.
    pub console: Vec<String>,
}

impl Planned {
    /// Plans the pulses for the scene's device on its board.
    ///
    /// # Errors
    /// The travel has no room for a train.
    pub fn new(scene: &NamedScene) -> Result<Self, Error> {
        let found = plan(&scene.scene).map_err(|error| Error::Input(error).of(&scene.name))?;
        let units = scene.scene.units;
        let guessed = scene.scene.on_board().guessed;
        let of_plan = ["safety.travel", "safety.speed_max", "motor.continuous"];
        let matters = |key: &str| of_plan.iter().any(|of| key.starts_with(of));
        Ok(Self {
            scene: scene.name.clone(),
            start_m: found.start_m,
            push_n: found.push_n,
            pulses: found.pulses.to_vec(),
            force_rms_n: found.rms_n,
            continuous_force_n: found.continuous_n,
            guessed: guessed
                .iter()
                .filter(|guess| matters(guess.key()))
                .map(|guess| guess.told(units))
                .collect(),
            console: console(&found, units),
        })
    }
}

/// A number as the console accepts it. A linear number has `decimals` decimals. A rotary number has five digits.
fn said(units: Units, key: &str, at_handle: f64, decimals: usize) -> String {
    match units.key(key) {
        None => format!("{at_handle:.decimals$}"),
        Some((_, factor)) => {
            let digits = format!("{:.4e}", at_handle * factor);
            digits.parse().map_or(digits, |value: f64| value.to_string())
        }
    }
}

fn console(plan: &Plan, units: Units) -> Vec<String> {
    let mut lines: Vec<String> = ["zero", "k 0", "b 0", "arm", "wait 1"].map(String::from).to_vec();
    lines.push(format!("start {}", said(units, "start_m", plan.start_m, 6)));
    lines.push(format!("pulses {}", said(units, "push_n", plan.push_n, 4)));
    lines.push(format!("wait {:.0}", plan.seconds.ceil()));
    lines.push("disarm".into());
    lines
}
