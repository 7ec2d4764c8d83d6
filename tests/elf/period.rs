//! Period 1: the release ELF built for an output with every sample, 10 kHz. It closes the loop, gives
//! bit for bit what the core gives, and has the time for it.

use virtual_board::{
    board::Board,
    mcu::{RENDER, SAMPLE},
};
use zwidth::{
    CounterWidth, Design, Sampled, Sampler, Settings, VelocitySettings, WallSettings,
    telemetry::{Decoder, Flags, Record},
    units::Force,
};

use crate::{
    figure::figure,
    firmware::{Firmware, arm, ok},
};

each_board!(an_output_with_every_sample_works_and_has_the_time, ignored: "images of their own; CI runs it");

/// `sample` and `render` together, as a part of the time between two samples.
const LOAD: f64 = 0.25;

fn records(telemetry: Vec<u8>) -> (Vec<Record>, u64) {
    let mut decoder = Decoder::new();
    let frames = telemetry.into_iter().filter_map(|byte| decoder.push(byte));
    (frames.map(|frame| frame.record).collect(), decoder.dropped)
}

fn an_output_with_every_sample_works_and_has_the_time(board: Board) {
    println!("board           sample     render     load   event to DAC  delay  telemetry");
    let firmware = Firmware::variant(board, &["period-1"]);
    let mut world = firmware.boot();
    arm(&mut world);
    world.telemetry.clear();
    world.powered.mcu.watch_mut().clear();

    // In closed loop: the push drives the handle against the wall, where it comes to rest.
    ok(&mut world, "hit");
    let (mut latest, mut least) = (0, u64::MAX);
    for n in 0..5_000 {
        let before = world.powered.amplifier.changes().commands;
        world.sample().unwrap();
        let changes = world.powered.amplifier.changes();
        let event = world.powered.mcu.last_event().unwrap();
        if changes.commands != before && changes.command_at >= event {
            latest = latest.max(changes.command_at - event);
            least = least.min(changes.command_at - event);
        }
        if n % 50 == 49 {
            world.probe().unwrap();
        }
    }
    let (found, dropped) = records(std::mem::take(&mut world.telemetry));
    let status = ok(&mut world, "status");
    assert!(status.contains("armed, fault none") && status.contains("in contact"), "{status}");
    let surface_m = firmware.scene.device.rest_position_m + 0.005;
    let depth_m = world.position_m() - surface_m;
    assert!((1e-4..1e-3).contains(&depth_m), "2.8 N on 8000 N/m: {depth_m}");
    for pair in found.windows(2) {
        assert!(pair[1].sample > pair[0].sample);
    }
    let sent = found.len() as f64 / (found.len() as u64 + dropped) as f64;
    let consecutive = found.windows(2).filter(|p| p[1].sample == p[0].sample + 1).count();
    assert!(consecutive > 4_000, "{consecutive}");

    let watch = world.powered.mcu.watch().clone();
    let [sample, render] = [SAMPLE, RENDER].map(|task| watch.tasks[&task]);
    assert!(render.runs + 1 >= sample.runs, "{render:?} {sample:?}");
    let load = (sample.most + render.most) as f64 / board.cycles_per_sample() as f64;
    // Of a PWM the pin's edges tell nothing about when a command was written.
    let to_dac = match board.wiring.force {
        virtual_board::board::Force::Dac { .. } => format!("{least}..{latest}"),
        virtual_board::board::Force::Pwm { .. } => "-".to_owned(),
    };
    println!(
        "{:15} {}..{}   {}..{} {:5.1} % {to_dac:12}  {:?} {:5.1} %",
        board.name,
        sample.least,
        sample.most,
        render.least,
        render.most,
        100.0 * load,
        watch.delays,
        100.0 * sent,
    );
    let delays = &watch.delays;
    for (key, value) in [
        ("sample_least", sample.least),
        ("sample_most", sample.most),
        ("render_least", render.least),
        ("render_most", render.most),
        ("delay_least", *delays.keys().next().unwrap()),
        ("delay_most", *delays.keys().last().unwrap()),
        ("dac_least", least),
        ("dac_most", latest),
    ] {
        figure(&format!("elf/period/{}/{key}", board.name), value);
    }
    figure(&format!("elf/period/{}/load", board.name), load);
    figure(&format!("elf/period/{}/sent", board.name), sent);
    assert!(load <= LOAD, "{load}");
    assert!(watch.delay_spread() <= 64, "{:?}", watch.delays);
    assert_eq!((watch.primask, watch.forbidden_basepri), (0, 0));

    same_as_the_core(&firmware, &mut world);
}

/// The forces of a handle that is led in and out of the wall, against the core's.
fn same_as_the_core(firmware: &Firmware, world: &mut virtual_board::world::World<'_>) {
    ok(world, "stop");
    let middle_m = world.position_m();
    world.hold(middle_m, true);
    world.run(300).unwrap();
    world.telemetry.clear();
    let begun = world.powered.mcu.counter_readings().len();
    for n in 0..2_000 {
        let phase = f64::from(n) / 1_000.0 * std::f64::consts::TAU;
        world.hold(middle_m - 0.001 * phase.sin(), true);
        world.sample().unwrap();
        if n % 50 == 49 {
            world.probe().unwrap();
        }
    }
    world.run(10).unwrap();
    let (found, _) = records(std::mem::take(&mut world.telemetry));
    let design = Design { period: 1, output: output(firmware), ..firmware.scene.design() };
    let settings = Settings {
        velocity: VelocitySettings::Butterworth { cutoff_hz: 1500.0 },
        wall: WallSettings {
            position_m: 0.005,
            stiffness_n_per_m: 8000.0,
            damping_n_s_per_m: 30.0,
            push_only: true,
        },
    };
    let control = settings.build(&design).unwrap();
    let readings = world.powered.mcu.counter_readings();
    // The counter's reading at position 0: what it reads now less what the firmware makes of it.
    let last = found.last().unwrap();
    let zero = readings[usize::try_from(last.sample).unwrap() + 1]
        .wrapping_add_signed(-last.position.counts());
    let mut sampler = Sampler::new(0, CounterWidth::Bits32);
    let (mut compared, mut contacts) = (0, 0);
    let mut found = found.iter().peekable();
    for (n, reading) in (0u64..).zip(&readings[1..]) {
        let Sampled { motion, due } = sampler.sample(&control, reading.wrapping_sub(zero));
        assert!(due);
        let Some(record) = found.next_if(|record| record.sample == n) else { continue };
        if n < begun as u64 {
            continue; // the filter has another past: it was not zeroed on the way
        }
        let drive = control.render(motion, Force::ZERO);
        assert_eq!((record.position, record.velocity), (motion.position, motion.velocity), "{n}");
        assert!(record.flags.contains(Flags::ARMED) && !record.flags.contains(Flags::CHANGING));
        assert_eq!(
            (record.force, record.command),
            (drive.force, control.actuator.command(drive.force)),
            "{n}"
        );
        compared += 1;
        contacts += u32::from(drive.contact);
    }
    assert!(compared > 1_000 && contacts > 300, "{compared} {contacts}");
}

fn output(firmware: &Firmware) -> zwidth::Output {
    match firmware.board.wiring.force {
        virtual_board::board::Force::Dac { .. } => zwidth::Output::Dac { bits: 12 },
        virtual_board::board::Force::Pwm { .. } => zwidth::Output::Pwm { steps: 4200 },
    }
}
