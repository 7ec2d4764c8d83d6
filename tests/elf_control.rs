//! The release ELF under load: its telemetry against the core on the host, bit for bit; the delay
//! of its samples; its interrupt masks; its cycles, stack, flash and RAM.

#![allow(clippy::unwrap_used, reason = "a test may stop")]
#![allow(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "small numbers"
)]

mod elf;

use std::sync::OnceLock;

use elf::{
    Firmware, Replay, arm,
    code::{Code, Instruction},
    ok,
};
use host_sim::scene::NamedScene;
use virtual_board::{
    board::BOARDS,
    mcu::{Cycles, LINK, RENDER, SAMPLE, Watch},
    world::World,
};
use zwidth::{
    Control, Design, Settings, VelocitySettings, WallSettings,
    safety::SLEW,
    telemetry::{Decoder, Flags, Record},
    units::Force,
    velocity::Senses,
};

/// Samples under load.
const SAMPLES: u64 = 50_000;

/// What a session leaves behind.
struct Session {
    counts: Vec<u32>,
    records: Vec<Record>,
    /// Settings in the order in which the firmware took them.
    controls: Vec<Control>,
    lines: usize,
    watch: Watch,
}

/// The device that the firmware is built for.
fn design(firmware: &Firmware) -> Design {
    let scene = &firmware.scene;
    Design {
        output: match firmware.board.name {
            "nucleo-f446re" => zwidth::Output::Dac { bits: 12 },
            _ => zwidth::Output::Pwm { steps: 4200 },
        },
        ..scene.design()
    }
}

fn settings(cutoff_hz: f64, position_m: f64, k: f64, b: f64) -> Settings {
    Settings {
        velocity: VelocitySettings::Butterworth { cutoff_hz, prewarp: false },
        wall: WallSettings {
            position_m,
            stiffness_n_per_m: k,
            damping_n_s_per_m: b,
            push_only: true,
        },
    }
}

/// The handle is moved in and out of the wall, through 0 and back, while commands come in without
/// a pause and every output goes out as telemetry.
fn session(firmware: &Firmware) -> Session {
    let mut world = firmware.boot();
    let design = design(firmware);
    let mut now = settings(1500.0, 0.07, 0.0, 0.0);
    // The firmware proposes its first settings to itself, which counts as a change.
    let mut taken = vec![now, now];
    arm(&mut world);
    for (wall_m, k, b) in [(0.005, 0.0, 0.0), (0.005, 8000.0, 0.0), (0.005, 8000.0, 30.0)] {
        now = settings(1500.0, wall_m, k, b);
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
            // Gains at any time, the cutoff outside of contact only.
            let k = 1000.0 + (n / 400 * 37 % 15_000) as f64;
            now.wall.stiffness_n_per_m = k;
            world.send(&format!("k {k}\n")).unwrap();
            taken.push(now);
        }
        if n % 4_000 == 1_000 {
            let cutoff_hz = 100.0 + (n % 3_001) as f64;
            now.velocity = VelocitySettings::Butterworth { cutoff_hz, prewarp: false };
            world.send(&format!("cutoff {cutoff_hz}\n")).unwrap();
            taken.push(now);
        }
        if n % 100 == 20 {
            world
                .send(["status\n", "get\n", "rubbish\n", "help\n"][(n / 100 % 4) as usize])
                .unwrap();
        }
    }
    world.run(200).unwrap(); // the last replies
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

/// Each board's session, run once.
fn sessions() -> &'static [(Firmware, Session); 2] {
    static SESSIONS: OnceLock<[(Firmware, Session); 2]> = OnceLock::new();
    SESSIONS.get_or_init(|| {
        BOARDS.map(|board| {
            let firmware = Firmware::of(board);
            let session = session(&firmware);
            (firmware, session)
        })
    })
}

#[test]
fn telemetry_is_what_the_core_says_to_the_same_counts_bit_for_bit() {
    for (_, session) in sessions() {
        let [first, counts @ ..] = &session.counts[..] else { panic!("no counts") };
        let mut replay = Replay::new(*first, &session.controls);
        let mut records = session.records.iter().peekable();
        let (mut compared, mut forces, mut contacts, mut saturated, mut below) = (0, 0, 0, 0, 0);
        let skipped = records.peek().unwrap().sample;
        for (n, &count) in (0u64..).zip(counts) {
            let (control, motion) = replay.sample(n, count, records.peek().copied(), &Senses::NONE);
            if !motion.due || n < skipped {
                continue;
            }
            let Some(record) = records.next() else { break };
            assert_eq!(record.sample, n);
            assert_eq!(record.position, motion.position, "{n}");
            assert_eq!(record.velocity, motion.velocity, "{n}");
            compared += 1;
            below += u64::from(motion.position.counts() < 0);
            let drive = control.render(motion, Force::ZERO);
            if record.flags.contains(Flags::ARMED) && !record.flags.contains(Flags::CHANGING) {
                assert_eq!((record.force, record.command), (drive.force, drive.command), "{n}");
                forces += 1;
                contacts += u64::from(drive.contact);
                saturated += u64::from(drive.saturated);
            }
        }
        assert!(compared * 10 >= SAMPLES, "{compared}");
        assert!(forces > 3_000 && contacts > 500 && saturated > 100 && below > 1_000);
        println!(
            "{compared} outputs equal, {forces} with force, {contacts} in contact, {saturated} saturated, {below} below zero"
        );
    }
}

/// With the handle held still 0.3 mm inside the wall nothing but a change moves the force. What may
/// not change there is refused. Random instants and changes are in tests/force_step.rs.
#[test]
fn a_change_in_contact_moves_the_force_by_five_per_cent_an_output_at_most() {
    for board in BOARDS {
        let firmware = Firmware::of(board);
        let mut world = firmware.boot();
        arm(&mut world);
        let free_m = world.position_m();
        for n in 1..=106 {
            world.hold(free_m + 50e-6 * f64::from(n), true);
            world.sample().unwrap();
        }
        world.run(200).unwrap();
        world.telemetry.clear();
        for (line, allowed) in [
            ("k 1000", true),
            ("k 19000", true),
            ("b 900", true),
            ("cutoff 100", false),
            ("wall 0.001", false),
            ("estimator butterworth-prewarped", false),
            ("k 0", true),
            ("k 12000", true),
        ] {
            let reply = world.ask(line).unwrap();
            assert_eq!(reply.starts_with("ok"), allowed, "{line}: {reply}");
            world.run(230).unwrap();
        }
        let mut decoder = Decoder::new();
        let telemetry = std::mem::take(&mut world.telemetry);
        let records = telemetry.into_iter().filter_map(|byte| decoder.push(byte));
        let forces: Vec<i32> = records.map(|frame| frame.record.force.bits()).collect();
        let steps: Vec<i32> = forces.windows(2).map(|pair| (pair[1] - pair[0]).abs()).collect();
        let moved = steps.iter().filter(|step| **step > SLEW / 2).count();
        println!("{}: {moved} steps, the largest {:?}", board.name, steps.iter().max());
        assert!(steps.iter().all(|step| *step <= SLEW));
        assert!(moved > 40, "{moved}");
    }
}

/// Longest difference between two delays, cycles: instructions that cannot be interrupted.
const SPREAD: u64 = 64;

/// What is wrong with the samples' time.
fn delayed(watch: &Watch) -> Result<(), String> {
    if watch.delay_spread() > SPREAD {
        return Err(format!("spread {} cycles", watch.delay_spread()));
    }
    match (watch.primask, watch.forbidden_basepri) {
        (0, 0) => Ok(()),
        (primask, basepri) => Err(format!("PRIMASK in {primask} steps, BASEPRI in {basepri}")),
    }
}

#[test]
fn nothing_delays_the_samples() {
    for (firmware, session) in sessions() {
        let watch = &session.watch;
        println!("{}: cycles from event to count: {:?}", firmware.board.name, watch.delays);
        assert!(watch.delays.values().sum::<u64>() >= SAMPLES);
        assert_eq!(delayed(watch), Ok(()), "{:?}", watch.delays);
        // The positive control: samples did come while the logger masked the lower tasks.
        let masked: u64 = watch.events_by_basepri.range(1..).map(|(_, n)| n).sum();
        println!("events by BASEPRI: {:?}", watch.events_by_basepri);
        assert!(masked >= 1, "{:?}", watch.events_by_basepri);
        assert!(session.lines > 500, "{}", session.lines);
    }
}

/// With the logger that everybody uses, which logs inside a critical section, the same look finds
/// delays: by the spread of the delays alone, and by the mask.
#[test]
fn the_usual_logger_would_be_noticed() {
    let mut spreads = Vec::new();
    for features in [&[][..], &["usual-logger"]] {
        let firmware = Firmware::variant(BOARDS[0], features);
        let mut world = firmware.boot();
        arm(&mut world);
        world.powered.mcu.watch_mut().clear();
        for n in 0..4_000 {
            if n % 20 == 0 {
                world.send(["status\n", "get\n", "help\n"][n / 20 % 3]).unwrap();
            }
            world.sample().unwrap();
            if n % 50 == 0 {
                world.probe().unwrap();
            }
        }
        let watch = world.powered.mcu.watch();
        println!("{features:?}: spread {}, {:?}", watch.delay_spread(), delayed(watch));
        assert_eq!(delayed(watch).is_ok(), features.is_empty());
        assert_eq!(watch.primask == 0, features.is_empty());
        spreads.push(watch.delay_spread());
    }
    assert!(spreads[0] <= SPREAD && spreads[1] > 10 * SPREAD, "{spreads:?}");
}

/// What the DAC takes to settle, s, by its data sheet: part of the latency after its register is written.
const DAC_SETTLES_S: f64 = 3e-6;

/// A PWM takes a command over at that time after its sample, s (`LEAD_CYCLES` of the board): what comes
/// later acts 25 us later.
const TAKEN_OVER_S: f64 = 14e-6;

/// Part of that time which has to be left: zero wait states are the model's, not the chip's.
const RESERVE: f64 = 0.2;

#[test]
fn commands_reach_their_register_within_the_latency_that_the_simulator_is_given() {
    for board in BOARDS {
        let firmware = Firmware::of(board);
        let mut world = firmware.boot();
        arm(&mut world);
        world.powered.mcu.watch_mut().clear();
        for line in ["settle 0.1", "window 0.1", "kstart 2000", "kstep 4000", "bstart 20"] {
            ok(&mut world, line);
        }
        // Everything that an output may have to do: ways back, hits, changes that fade, a walk's
        // walls, a calibration, a black box that is read out, an arm anew.
        for (line, samples) in [
            ("hit", 12_000),
            ("k 30000", 100),
            ("b 200", 100),
            ("stop", 500),
            ("cutoff 400", 100),
            ("walk", 40_000),
            ("stop", 20_000),
            ("start -0.01", 100),
            ("hit", 3_000),
            ("stop", 20_000),
            ("calibrate 9", 2_000),
            ("stop", 2_000),
            ("faults", 1_000),
            ("disarm", 100),
            ("unlock envelope", 100),
            ("arm", 4_000),
        ] {
            world.send(&format!("{line}\n")).unwrap();
            world.run(samples).unwrap();
        }
        let all = world.powered.mcu.watch().commands;
        // A hit without changes, in contact: what the simulator's latency stands for.
        ok(&mut world, "start 0");
        ok(&mut world, "settle 3");
        ok(&mut world, "hit");
        world.run(20_000).unwrap();
        world.powered.mcu.watch_mut().clear();
        world.run(10_000).unwrap();
        let status = ok(&mut world, "status");
        assert!(status.contains("hit, ") && status.contains("in contact"), "{status}");
        let steady = world.powered.mcu.watch().commands;

        let cycles = |seconds: f64| seconds * board.chip.core_hz as f64;
        let latency = NamedScene::load(board.name).unwrap().scene.actuator.latency;
        let settles = match board.wiring.force {
            virtual_board::board::Force::Dac { .. } => cycles(DAC_SETTLES_S),
            virtual_board::board::Force::Pwm { .. } => 0.0,
        };
        let stated = latency * board.cycles_per_sample() as f64 - settles;
        println!(
            "{}: event to register {}..{} cycles in a hit, of {stated:.0}; {}..{} in all",
            board.name, steady.least, steady.most, all.least, all.most
        );
        assert!(steady.runs >= 1_000 && all.runs > 8_000, "{steady:?} {all:?}");
        assert!(steady.most as f64 <= stated, "{steady:?} of {stated}");
        let reserved = cycles(TAKEN_OVER_S) * (1.0 - RESERVE);
        assert!(all.most as f64 <= reserved, "{all:?} of {reserved}");
    }
}

/// Cycles from exception entry to return that the sampling task may take, by DESIGN.
const SAMPLE_CYCLES: u64 = 320;
/// Cycles of it that `Sampler::sample` may take: encoder, velocity, what is due.
const CORE_CYCLES: u64 = 150;

#[test]
fn tasks_and_memory_stay_in_their_budget() {
    println!("board           sample      of it core  render      link        stack  flash   RAM");
    for (firmware, session) in sessions() {
        let tasks = [SAMPLE, RENDER, LINK].map(|task| session.watch.tasks[&task]);
        let core = session.watch.marked;
        let elf = &firmware.elf;
        let flash: usize = elf.flash.iter().map(|(_, bytes)| bytes.len()).sum();
        let ram: u32 = [".data", ".bss", ".uninit"]
            .iter()
            .filter_map(|name| elf.section(name))
            .map(|(_, size)| size)
            .sum();
        let stack = 0x2000_0000 + 112 * 1024 - session.watch.lowest_stack;
        let range = |cycles: Cycles| format!("{}..{}", cycles.least, cycles.most);
        let [sample, render, link] = tasks.map(range);
        let core_range = range(core);
        let name = firmware.board.name;
        println!(
            "{name:15} {sample:11} {core_range:11} {render:11} {link:11} {stack:6} {flash:6} {ram:6}"
        );
        println!("means: sample {:.0}, core {:.0}", tasks[0].mean(), core.mean());
        assert_eq!(core.runs, tasks[0].runs);
        assert!(core.least > 50 && core.most <= CORE_CYCLES, "{core:?}");
        assert!(tasks[0].most <= SAMPLE_CYCLES, "{:?}", tasks[0]);
        assert!(tasks[1].most <= 9_000, "half a period of samples: {:?}", tasks[1]);
        assert!(stack + ram < 112 * 1024 / 2);
        assert!(flash < 256 * 1024);
    }
}

/// Zero, arm, disarm, faults at every place of the output period, and what ends them: no sample is
/// longer for it. The sums of the session above have none of these.
#[test]
fn no_sample_is_longer_than_its_budget_whatever_happens() {
    for board in BOARDS {
        let firmware = Firmware::of(board);
        let mut world = firmware.boot();
        arm(&mut world);
        world.powered.mcu.watch_mut().clear();
        let recover = |world: &mut World<'_>| {
            world.run(30).unwrap();
            for line in ["clear", "zero", "arm"] {
                ok(world, line);
            }
            world.run(4_000).unwrap();
            let status = ok(world, "status");
            assert!(status.contains("ok status armed"), "{status}");
        };
        for phase in 0..10 {
            // A jump of the count: found in one sample, gone in the next.
            world.run(phase).unwrap();
            world.hold(world.position_m() + 700e-6, true);
            world.run(30).unwrap();
            assert!(ok(&mut world, "status").contains("fault 10"));
            world.hold(world.position_m(), false);
            recover(&mut world);
            if phase % 3 != 0 {
                continue;
            }
            // An emergency stop, and a zero at another time.
            world.run(phase).unwrap();
            world.emergency_stop(true);
            world.run(30).unwrap();
            world.emergency_stop(false);
            world.run(phase).unwrap();
            recover(&mut world);
        }
        // Outputs that do not come: late with a due sample, stuck, and back.
        for samples in [25, 150] {
            world.powered.mcu.mask(RENDER, true);
            world.run(samples).unwrap();
            world.powered.mcu.mask(RENDER, false);
            world.run(200).unwrap();
            assert!(ok(&mut world, "status").contains("fault 20"));
            recover(&mut world);
        }
        for line in [
            "cutoff 1200",
            "disarm",
            "estimator first-order",
            "estimator butterworth",
            "save",
            "load",
            "zero",
        ] {
            ok(&mut world, line);
            world.run(500).unwrap();
        }
        let sample = world.powered.mcu.watch().tasks[&SAMPLE];
        println!("{}: sample {}..{}", board.name, sample.least, sample.most);
        assert!(sample.most <= SAMPLE_CYCLES, "{sample:?}");
    }
}

/// Nobody reads: the channels fill up. One command more may act, and its reply waits for room; what
/// comes after it is not obeyed, but for what ends something.
#[test]
fn nothing_changes_without_an_acknowledgement() {
    for board in BOARDS {
        let firmware = Firmware::of(board);
        let mut world = firmware.boot();
        arm(&mut world);
        let unread = |world: &mut World<'_>, line: &str| {
            world.send(&format!("{line}\n")).unwrap();
            for _ in 0..30 {
                world.sample().unwrap();
            }
        };
        for k in 1..=300 {
            unread(&mut world, &format!("k {k}"));
        }
        unread(&mut world, "disarm");
        world.replies.clear();
        world.lines.clear();
        world.run(2_000).unwrap();
        // The log has them all in order, from the last that found room in it to the one that waited.
        let acknowledged = |lines: &mut dyn Iterator<Item = &str>| {
            lines
                .filter_map(|line| line.split_once("ok k ")?.1.split(' ').next()?.parse().ok())
                .max()
        };
        let in_log: Option<u32> = acknowledged(&mut world.lines.iter().map(String::as_str));
        let replied: Option<u32> = acknowledged(&mut world.replies.lines());
        let last = in_log.max(replied).expect("no reply at all");
        let told = world.replies.lines().find(|line| line.contains("nobody was reading"));
        println!("{}: up to k {last}, then {told:?}", board.name);
        let told = told.expect("the host is told").to_owned();
        assert!(told.contains(&format!(": {} commands ignored", 300 - last)), "{told}");
        assert!((20..300).contains(&last), "{last}");
        let settings = ok(&mut world, "get");
        assert!(settings.contains(&format!("k {last} ")), "{settings}");
        let status = ok(&mut world, "status");
        assert!(status.contains("ok status off"), "{status}");
    }
}

/// Machine code of the sampling task, and of what it calls (the guard's rare cases): nothing in it
/// disables interrupts, raises a mask or calls through a pointer.
#[test]
fn the_sampling_task_enters_no_critical_section() {
    for board in BOARDS {
        let elf = Firmware::of(board).elf;
        let code = Code::of(&elf);
        let mut functions = vec![elf.address_of("TIM5").unwrap()];
        let mut n = 0;
        while n < functions.len() {
            for Instruction { at, first, second } in code.instructions(functions[n]) {
                assert!(first != 0xB672 && first != 0xB671, "cpsid at {at:#x}");
                // MSR PRIMASK or BASEPRI_MAX
                let msr = first & 0xFFF0 == 0xF380 && second & 0xFF00 == 0x8800;
                assert!(!(msr && matches!(second & 0xFF, 16 | 18)), "mask raised at {at:#x}");
            }
            let flow = code.flow(functions[n]);
            assert!(!flow.indirect, "{}", code.name(functions[n]));
            let new: Vec<u32> = flow.to.into_iter().filter(|f| !functions.contains(f)).collect();
            functions.extend(new);
            n += 1;
        }
        let names: Vec<_> = functions.iter().map(|&function| code.name(function)).collect();
        println!("{}: {names:?}", board.name);
        assert!(functions.len() <= 3, "{names:?}");
    }
}
