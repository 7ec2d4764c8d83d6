//! Tests the release ELF under load, in a session that is run once. The telemetry must equal what the core computes on
//! the host, bit for bit. The delay of samples, interrupt masks, cycles and memory must be within limits. Further tests
//! cover the time limits of faults in any sample, commands in any order, the latency of commands, and a host that does
//! not read.

mod acknowledgement;
mod budget;
mod commands;
mod delay;
mod equality;
mod latency;

use std::sync::OnceLock;

use virtual_board::{
    board::{BOARDS, Board, Force},
    mcu::Watch,
};
use zwidth::{
    Design, LoopParameters, Settings, VelocitySettings, WallSettings,
    telemetry::{Decoder, Record},
};

use crate::firmware::{Firmware, arm, ok};

/// Number of samples under load.
const SAMPLES: u64 = 50_000;

struct Session {
    counts: Vec<u32>,
    records: Vec<Record>,
    /// All settings that the firmware has used, in this order.
    controls: Vec<LoopParameters>,
    lines: usize,
    watch: Watch,
}

/// The device that the firmware is built for.
fn design(firmware: &Firmware) -> Design {
    let scene = &firmware.scene;
    Design {
        output: match firmware.board.wiring.force {
            Force::Dac { .. } => zwidth::Output::Dac { bits: 12 },
            Force::Pwm { .. } => zwidth::Output::Pwm { steps: 4200 },
        },
        ..scene.design()
    }
}

fn settings(velocity: VelocitySettings, position_m: f64, k: f64, b: f64) -> Settings {
    Settings {
        velocity,
        wall: WallSettings {
            position_m,
            stiffness_n_per_m: k,
            damping_n_s_per_m: b,
            push_only: true,
        },
    }
}

/// Runs the session. The handle moves in and out of the wall, through 0 and back. Commands come without a pause. Every
/// output is sent as telemetry.
fn session(firmware: &Firmware) -> Session {
    let mut world = firmware.boot();
    let design = design(firmware);
    let mut now = settings(firmware.first(), 0.07, 0.0, 0.0);
    // The firmware's first settings count as a change.
    let mut taken = vec![now, now];
    arm(&mut world);
    for (wall_m, k, b) in [(0.005, 0.0, 0.0), (0.005, 8000.0, 0.0), (0.005, 8000.0, 30.0)] {
        now = settings(firmware.first(), wall_m, k, b);
        taken.push(now);
    }
    let middle_m = world.position_m();
    world.powered.mcu.watch_mut().clear();
    world.powered.mcu.watch_mut().marks = firmware.core_of_sample();
    for n in 0..SAMPLES {
        let phase = n as f64 / 4_000.0 * std::f64::consts::TAU;
        world.hold(middle_m - 0.02 * phase.sin(), true);
        world.sample().unwrap();
        if n % 50 == 0 {
            world.probe().unwrap();
        }
        if n % 400 == 399 {
            // Gains change at any time; the cutoff changes outside of contact only.
            let k = 1000.0 + (n / 400 * 37 % 15_000) as f64;
            now.wall.stiffness_n_per_m = k;
            world.send(&format!("k {k}\n")).unwrap();
            taken.push(now);
        }
        if n % 4_000 == 1_000 {
            let cutoff_hz = 100.0 + (n % 3_001) as f64;
            now.velocity = VelocitySettings::Butterworth { cutoff_hz };
            world.send(&format!("cutoff {cutoff_hz}\n")).unwrap();
            taken.push(now);
        }
        if n % 100 == 20 {
            world
                .send(["status\n", "get\n", "rubbish\n", "help\n"][(n / 100 % 4) as usize])
                .unwrap();
        }
    }
    world.run(200).unwrap(); // time for the last replies
    let status = ok(&mut world, "status");
    assert!(status.contains("fault none"), "{status}");
    assert!(!world.lines.iter().any(|line| line.contains("not now")), "{:?}", world.lines);
    let mut decoder = Decoder::new();
    let telemetry = std::mem::take(&mut world.telemetry);
    let records = telemetry.into_iter().filter_map(|byte| decoder.push(byte));
    let records: Vec<_> = records.map(|frame| frame.record).collect();
    assert_eq!((decoder.dropped, decoder.garbage), (0, 0));
    Session {
        counts: world.powered.mcu.counter_readings(),
        records,
        controls: taken.iter().map(|settings| settings.build(&design).unwrap()).collect(),
        lines: world.lines.len(),
        watch: world.powered.mcu.watch().clone(),
    }
}

/// The session of a board, which is run once.
fn session_of(board: Board) -> &'static (Firmware, Session) {
    static SESSIONS: [OnceLock<(Firmware, Session)>; BOARDS.len()] =
        [const { OnceLock::new() }; BOARDS.len()];
    let place = BOARDS.iter().position(|other| *other == board).unwrap();
    SESSIONS[place].get_or_init(|| {
        let firmware = Firmware::of(board);
        let session = session(&firmware);
        (firmware, session)
    })
}
