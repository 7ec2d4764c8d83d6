//! `identify --plan`: the console commands of a designed excitation.

use super::IdentifyArgs;
use crate::{
    analysis::identify::Planned, cli::Common, error::Error, output::estimated::print_console_of,
};

pub(super) fn run(args: &IdentifyArgs, common: &Common) -> Result<(), Error> {
    if common.out.is_some() {
        return Err(Error::input("--out: --plan writes no file"));
    }
    let scene = args.base_scene()?;
    let told = Planned::new(&scene)?;
    let units = scene.scene.units;
    print_console_of(common.json, &scene.scene, &told, || {
        let mut text = format!(
            "# Pulses for {}, planned with its own mass, damping and spring. It moves: keep clear.",
            scene.name
        );
        for one in &told.pulses {
            text += &units.text(&format!(
                "\n# {:.3} N for {} s: {:.5} m from the start, {:.3} m/s",
                one.push_n, one.seconds, one.excursion_m, one.speed_m_per_s
            ));
        }
        text += &units.text(&format!(
            "\n# force {:.3} N RMS, the motor stands {:.3} N for ever",
            told.force_rms_n, told.continuous_force_n
        ));
        for guess in &told.guessed {
            text += &format!("\n# guessed, not in the scene: {guess}");
        }
        for weak in told.pulses.iter().filter(|one| !one.moves(&scene.scene)) {
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
        text + "\n" + &told.console.join("\n")
    })
}
