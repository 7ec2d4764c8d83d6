//! A host that uses `alive` and then stops sending it.

use virtual_board::board::Board;

use crate::firmware::{Firmware, ok};

each_board!(the_force_goes_in_time_when_the_host_falls_silent);

/// `alive` every 150 ms keeps the force on. `alive` also sets the period within which the host must send it again. If
/// the host sends nothing, the amplifier is switched off at the end of this period, or at most one output later. This
/// is tested at four phases between the command and the outputs.
fn the_force_goes_in_time_when_the_host_falls_silent(board: Board) {
    let firmware = Firmware::of(board);
    let mut world = firmware.armed();
    for _ in 0..3 {
        ok(&mut world, "alive 200");
        world.run(1_500).unwrap();
        assert!(world.powered.amplifier.is_enabled());
    }
    let kept = world.snapshot();
    for phase in (0..10).step_by(3) {
        world.restore(&kept);
        world.run(phase).unwrap();
        world.send("alive 50\n").unwrap();
        let sent = world.powered.mcu.now();
        world.run(450).unwrap();
        assert!(world.powered.amplifier.is_enabled(), "phase {phase}");
        world.run(100).unwrap();
        let off = world.powered.amplifier.changes().disabled_at.unwrap();
        let ms = (off - sent) as f64 / world.powered.mcu.core_hz() as f64 * 1e3;
        // The command is read at most one output later, and takes effect at most one further output later.
        assert!((49.0..=53.0).contains(&ms), "phase {phase}: off after {ms} ms");
        let faults = world.ask("faults").unwrap();
        assert!(faults.contains("34 (host silent)"), "{faults}");
        ok(&mut world, "clear");
    }
}
