//! `identify --plan`: the console commands of a designed excitation.

use serde::Serialize;

use super::IdentifyArgs;
use crate::{
    analysis::identify::{Plan, plan},
    cli::Common,
    error::Error,
    output::estimated::print_console_of,
    scene::{NamedScene, Units},
};

#[derive(Serialize)]
struct Json {
    scene: String,
    start_m: f64,
    push_n: f64,
    pulses: Vec<JsonPulse>,
    force_rms_n: f64,
    continuous_force_n: f64,
    guessed: Vec<String>,
    console: Vec<String>,
}

#[derive(Serialize)]
struct JsonPulse {
    push_n: f64,
    seconds: f64,
    excursion_m: f64,
    speed_m_per_s: f64,
}

pub(super) fn run(args: &IdentifyArgs, common: &Common) -> Result<(), Error> {
    if common.out.is_some() {
        return Err(Error::input("--out: --plan writes no file"));
    }
    let scene = NamedScene::load(&args.base)?;
    let found = plan(&scene.scene).map_err(|error| Error::Input(error).of(&scene.name))?;
    let units = scene.scene.units;
    let console = console(&found, units);
    let guessed: Vec<String> = scene
        .scene
        .on_board()
        .guessed
        .iter()
        .filter(|guess| {
            ["safety.travel", "safety.speed_max", "motor.continuous"]
                .iter()
                .any(|of| guess.key().starts_with(of))
        })
        .map(|guess| guess.told(units))
        .collect();
    let pulses = found.pulses.iter().map(|one| JsonPulse {
        push_n: one.push_n,
        seconds: one.seconds,
        excursion_m: one.excursion_m,
        speed_m_per_s: one.speed_m_per_s,
    });
    let json = Json {
        scene: scene.name.clone(),
        start_m: found.start_m,
        push_n: found.push_n,
        pulses: pulses.collect(),
        force_rms_n: found.rms_n,
        continuous_force_n: found.continuous_n,
        guessed: guessed.clone(),
        console: console.clone(),
    };
    print_console_of(common.json, &scene.scene, json, || {
        let mut text = format!(
            "# Pulses for {}, planned with its own mass, damping and spring. It moves: keep clear.",
            scene.name
        );
        for one in &found.pulses {
            text += &units.text(&format!(
                "\n# {:.3} N for {} s: {:.5} m from the start, {:.3} m/s",
                one.push_n, one.seconds, one.excursion_m, one.speed_m_per_s
            ));
        }
        text += &units.text(&format!(
            "\n# force {:.3} N RMS, the motor stands {:.3} N for ever",
            found.rms_n, found.continuous_n
        ));
        for guess in &guessed {
            text += &format!("\n# guessed, not in the scene: {guess}");
        }
        for weak in found.pulses.iter().filter(|one| !one.moves(&scene.scene)) {
            text += &units.text(&format!(
                "\n# {:.3} N hardly moves the handle, friction holds it: more travel or speed in [safety] makes it stronger",
                weak.push_n
            ));
        }
        text += "\n# zero: with the handle at the scene's position 0";
        let device = &scene.scene.device;
        if device.stiffness_n_per_m > 0.0 {
            text += &units.text(&format!("; its spring rests at {:.5} m", device.rest_position_m));
        }
        text += "\n# wait is the virtual board's: on a board wait for status to say armed, then for ok pulses over";
        text + "\n" + &console.join("\n")
    })
}

/// A number at the handle for the console: with so many decimals there, or with five digits about the axis.
fn said(units: Units, key: &str, at_handle: f64, decimals: usize) -> String {
    match units.key(key) {
        None => format!("{at_handle:.decimals$}"),
        Some((_, factor)) => {
            let digits = format!("{:.4e}", at_handle * factor);
            digits.parse().map_or(digits, |value: f64| value.to_string())
        }
    }
}

/// The lines for the console, as `cargo board run` takes them too.
fn console(plan: &Plan, units: Units) -> Vec<String> {
    let mut lines: Vec<String> = ["zero", "k 0", "b 0", "arm", "wait 1"].map(String::from).to_vec();
    lines.push(format!("start {}", said(units, "start_m", plan.start_m, 6)));
    lines.push(format!("pulses {}", said(units, "push_n", plan.push_n, 4)));
    lines.push(format!("wait {:.0}", plan.seconds.ceil()));
    lines.push("disarm".into());
    lines
}
