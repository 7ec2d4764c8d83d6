//! Identifies the device of a board from the firmware's own telemetry, by the procedure of docs/identification.md on
//! the release ELF.

use host_sim::{
    analysis::{
        identify::{Gain, Options, OutputScale, Span, from_capture, from_capture_csv, identify},
        telemetry::Capture,
    },
    scene::NamedScene,
};
use virtual_board::{board::Board, world::World};

use crate::{
    figure::figure,
    firmware::{Firmware, ok},
};

each_board!(the_device_is_identified_from_the_firmwares_telemetry, ignored: "a recording; CI makes it");
each_board!(the_device_is_identified_from_the_pulse_train, ignored: "a recording; CI makes it");

/// Largest allowed relative error. It comes from the emulator's timing and the rounding of telemetry.
const ERROR_MAX: f64 = 2e-3;

/// A hit without a reachable wall is a pulse of 0.2 s. The second pulse starts where the first started.
fn the_device_is_identified_from_the_firmwares_telemetry(board: Board) {
    let found = found_after(board, |world| {
        for line in ["start 0.035", "settle 0.1", "window 0.1"] {
            ok(world, line);
        }
        for push in ["push 1.2", "push -1.2"] {
            ok(world, push);
            ok(world, "hit");
            let over = world.reply(40_000).unwrap();
            assert!(over.starts_with("ok hit no contact"), "{over}");
        }
        world.run(16_000).unwrap();
    });
    for (name, value) in found {
        figure(&format!("elf/identify_telemetry/{}/{name}", board.name), value);
    }
}

fn the_device_is_identified_from_the_pulse_train(board: Board) {
    let found = found_after(board, |world| {
        ok(world, "start 0.035");
        ok(world, "pulses 1.2");
        assert_eq!(world.reply(400_000).unwrap(), "ok pulses over");
    });
    for (name, value) in found {
        figure(&format!("elf/identify_pulses/{}/{name}", board.name), value);
    }
}

/// Identifies the device from the telemetry of `moves`. Returns the latency in samples, and the relative errors of
/// mass, damping and stiffness.
fn found_after(board: Board, moves: impl FnOnce(&mut World)) -> [(&'static str, f64); 4] {
    let firmware = Firmware::of(board);
    let mut scene = firmware.scene.clone();
    scene.output = NamedScene::load(board.name).unwrap().scene.output;
    let mut world = firmware.boot();
    for line in ["zero", "arm"] {
        ok(&mut world, line);
        world.run(200).unwrap();
    }
    world.run(4_000).unwrap();
    world.telemetry.clear();
    moves(&mut world);
    assert!(ok(&mut world, "status").contains("fault none"));

    let bytes = std::mem::take(&mut world.telemetry);
    let resolution_m = scene.encoder.resolution_m;
    let scale = OutputScale::of_scene(&scene, resolution_m).unwrap();
    let record = from_capture("capture", &bytes, &scale, Span::default()).unwrap();
    let csv = Capture::decode(&bytes).csv();
    assert_eq!(from_capture_csv("capture", &csv, &scale, Span::default()).unwrap(), record);

    let gain = Gain::Given(scene.actuator.gain_n_per_v);
    let options = Options { fit_latency: true, latency_s: 0.0, ..Options::of_scene(&scene, gain) };
    let found = identify(&[record], &options).unwrap();
    let spring = found.spring.unwrap();
    println!("{}: {:?}", board.name, (found.mass_kg, found.damping_n_s_per_m, spring));
    println!(
        "{}: latency {:.3} samples, residual {:.3} counts, {:?}",
        board.name,
        found.latency_s.value * scene.control.rate_hz,
        found.residual.rms_counts.unwrap(),
        found.warnings
    );
    let latency = found.latency_s.value * scene.control.rate_hz;
    let device = &scene.device;
    let errors = [
        ("m", found.mass_kg, device.mass_kg),
        ("b", found.damping_n_s_per_m, device.damping_n_s_per_m),
        ("k", spring.stiffness_n_per_m, device.stiffness_n_per_m),
    ];
    let errors = errors.map(|(name, estimate, truth)| {
        let error = estimate.value / truth - 1.0;
        println!("{}: {name} {error:+.1e} relative", board.name);
        assert!(error.abs() < ERROR_MAX, "{name}: {error}");
        (name, error.abs())
    });
    // The firmware's zero was the rest position.
    assert!(spring.rest_position_m.value.abs() < 20.0 * resolution_m);
    let [m, b, k] = errors;
    [("latency", latency), m, b, k]
}
