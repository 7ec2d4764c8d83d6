//! Runs one fault case: from `arm`, through the fault, to the next `arm`.

use board_trials::campaign::fault_case::{Before, FaultCase, RENDER_US, WATCHDOG_US};
use virtual_board::world::{Snapshot, World};
use zwidth::telemetry::{Decoder, Flags, Record};

use crate::firmware::{Firmware, arm, ok};

/// How much of the black box is checked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Depth {
    /// The beginning of the black box.
    Short,
    /// The whole black box.
    Full,
}

pub struct CaseResult {
    /// Time until enable was inactive, in us.
    pub off_us: f64,
    /// Time until the output code is that of zero force, in us.
    pub zero_us: f64,
    pub kept: String,
}

/// Prepares a board that is armed or not, as the fault case needs it. The handle is moved by 0.1 mm first, so that the
/// position differs from the counter's reading.
pub fn prepare(firmware: &Firmware, before: Before, depth: Depth) -> Snapshot {
    let mut world = firmware.boot();
    let world = &mut world;
    let rest_m = firmware.scene.device.rest_position_m;
    world.lead_to(rest_m + 100e-6).unwrap();
    let zero_m = world.position_m();
    match before {
        Before::Off => {
            for line in ["zero", "unlock envelope", "wall 0.005", "k 8000", "b 30"] {
                ok(world, line);
            }
            world.hold(zero_m, false);
        }
        Before::Pressed => {
            world.hold(zero_m, false);
            arm(world);
            world.lead_to(zero_m + 5.3e-3).unwrap();
            // Enough samples to fill the black box.
            world.run(if depth == Depth::Full { 1_000 } else { 50 }).unwrap();
            assert_ne!(world.powered.mcu.force_registers(), zero_registers(world));
        }
        Before::Moving => {
            world.hold(zero_m, false);
            arm(world);
            ok(world, "hit");
            let start_m = world.position_m();
            while world.position_m() < start_m + 1e-3 {
                world.sample().unwrap();
            }
        }
    }
    assert_eq!(world.powered.amplifier.is_enabled(), before != Before::Off, "{before:?}");
    world.snapshot()
}

/// Registers of the force output at zero force. The registers that the board does not use are 0.
fn zero_registers(world: &World<'_>) -> [u32; 3] {
    match world.powered.board.wiring.force {
        virtual_board::board::Force::Dac { .. } => [0, 0, 2048],
        virtual_board::board::Force::Pwm { .. } => [0, 0, 0],
    }
}

/// Causes the fault on a prepared board. Checks the result, and that the board recovers.
pub fn run_case(
    firmware: &Firmware,
    prepared: &Snapshot,
    case: &FaultCase,
    depth: Depth,
) -> CaseResult {
    let name = case.name;
    let mut world = firmware.boot();
    let world = &mut world;
    world.restore(prepared);
    let settings = ok(world, "get");
    let outputs = world.powered.mcu.events() / 10;
    let mut begun = (case.begin)(&firmware.elf, world).unwrap();
    if let Some(cause) = case.cause {
        cause(&firmware.elf, world).unwrap();
        begun = world.powered.mcu.now();
        world.run(if case.resets { 700 } else { 40 }).unwrap();
    }
    let patience = if case.limit_us > 20_000.0 { 1_100 } else { 40 };
    for _ in 0..patience {
        world.sample().unwrap();
    }
    let us = |cycles: u64| cycles as f64 / (world.powered.mcu.core_hz() as f64 / 1e6);
    let changes = world.powered.amplifier.changes();
    let off = changes.disabled_at.filter(|&at| at >= begun);
    let off_us = us(off.unwrap_or_else(|| panic!("{name}: enable stays active")) - begun);
    assert!(!world.powered.amplifier.is_enabled(), "{name}");
    assert!(off_us <= case.limit_us, "{name}: off after {off_us} us");
    // The amplifier is off. The code follows when the program handles the fault or restarts.
    let zero_us = us(changes.command_at.saturating_sub(begun));
    assert_eq!(world.powered.amplifier.command(), 0, "{name}");
    // A reset switches enable off by itself. The code follows within one output after the program has restarted.
    let booting_us = match case.cause {
        Some(_) if case.resets => WATCHDOG_US, // no code runs until then
        _ if case.resets => RENDER_US,
        _ => 0.0,
    };
    let allowed_us = case.limit_us.max(RENDER_US) + case.halted_us + booting_us;
    assert!(zero_us <= allowed_us, "{name}: zero force after {zero_us} us");
    if !case.resets {
        assert_eq!(world.powered.mcu.force_registers(), zero_registers(world), "{name}");
    }
    // The force stays off, and the board reports the fault.
    world.run(500).unwrap();
    world.replies.clear();
    let status = ok(world, "status");
    assert!(status.contains(&format!("fault {} ", case.code)), "{name}: {status}");
    world.telemetry.clear();
    let faults = ok(world, "faults");
    let all = faults.split(", all").nth(1).unwrap().split(',').next().unwrap();
    let all: Vec<u32> = all.split_whitespace().filter_map(|word| word.parse().ok()).collect();
    let expected = if case.all.is_empty() { &[case.code] } else { case.all };
    assert_eq!(all, expected, "{name}: {faults}");
    let mut kept = vec!["fault"];
    assert_eq!(world.powered.mcu.resets() > 0, case.resets, "{name}");
    if !case.resets {
        assert_eq!(ok(world, "get"), settings, "{name}");
        kept.push("settings");
        black_box(world, case, depth, outputs);
        kept.push("black box");
    }
    for line in if case.stays { &["arm", "clear"][..] } else { &["arm"] } {
        let refused = world.ask(line).unwrap();
        assert!(refused.starts_with("error"), "{name}: {line}: {refused}");
    }
    // The fault is still stored after a reset. On the second board, the recovery has no reset.
    if firmware.board == virtual_board::board::NUCLEO_F446RE && !case.stays {
        world.reset();
        world.run(300).unwrap();
        let status = ok(world, "status");
        assert!(status.contains(&format!("fault {} ", case.code)), "{name}, reset: {status}");
        kept.push("over a reset");
    }
    recover(firmware, case, world);
    CaseResult { off_us, zero_us, kept: kept.join(", ") }
}

/// Checks that the black box sends its marked records without a gap. The last record has the fault.
fn black_box(world: &mut World<'_>, case: &FaultCase, depth: Depth, outputs: u64) {
    let name = case.name;
    let samples = if depth == Depth::Full { 5_200 } else { 300 };
    world.run(samples).unwrap();
    let mut decoder = Decoder::new();
    let frames = std::mem::take(&mut world.telemetry);
    let records: Vec<Record> = frames
        .into_iter()
        .filter_map(|byte| decoder.push(byte))
        .map(|frame| frame.record)
        .filter(|record| record.flags.contains(Flags::REPLAY))
        .collect();
    let least = if depth == Depth::Full { outputs.min(500) } else { 20 } as usize;
    assert!(records.len() >= least, "{name}: {} records", records.len());
    for pair in records.windows(2) {
        // A masked `render` causes a gap by itself.
        assert!(pair[1].sample > pair[0].sample, "{name}");
        if pair[1].fault == 0 {
            assert_eq!(pair[1].sample - pair[0].sample, 10, "{name}");
        }
    }
    if depth == Depth::Full {
        let [before @ .., last] = &records[..] else { unreachable!() };
        assert_eq!(u32::from(last.fault), case.code, "{name}");
        assert!(before.iter().all(|record| record.fault == 0), "{name}");
        assert!(
            before.iter().rev().take(50).all(|record| record.flags.contains(Flags::ON)),
            "{name}"
        );
    }
}

/// Ends the cause. Only `clear` and `arm` may bring the force back.
fn recover(firmware: &Firmware, case: &FaultCase, world: &mut World<'_>) {
    let name = case.name;
    (case.end)(world).unwrap();
    world.lead_to(firmware.scene.device.rest_position_m).unwrap();
    world.run(500).unwrap();
    assert!(!world.powered.amplifier.is_enabled(), "{name}: force came back by itself");
    let refused = world.ask("arm").unwrap();
    assert!(refused.starts_with("error"), "{name}: {refused}");
    ok(world, "clear");
    world.run(100).unwrap();
    assert!(!world.powered.amplifier.is_enabled(), "{name}: force came back with clear");
    let after = ok(world, "status");
    assert!(after.contains("ok status off, fault none"), "{name}: {after}");
    world.hold(world.position_m(), false);
    for line in ["zero", "unlock envelope", "arm"] {
        ok(world, line);
    }
    world.run(20).unwrap();
    assert!(world.powered.amplifier.is_enabled(), "{name}: it cannot be armed again");
}
