//! The telemetry equals what the core computes on the host. A change of settings moves the force slowly.

use virtual_board::board::Board;
use zwidth::{
    Sampled,
    safety::SLEW,
    telemetry::{Decoder, Flags},
    units::Force,
    velocity::Senses,
};

use super::{SAMPLES, session_of};
use crate::firmware::{Firmware, Replay};

each_board!(
    a_change_in_contact_moves_the_force_by_five_per_cent_an_output_at_most,
    telemetry_is_what_the_core_says_to_the_same_counts_bit_for_bit
);

fn telemetry_is_what_the_core_says_to_the_same_counts_bit_for_bit(board: Board) {
    let (_, session) = session_of(board);
    let [first, counts @ ..] = &session.counts[..] else { panic!("no counts") };
    let mut replay = Replay::new(*first, &session.controls);
    let mut records = session.records.iter().peekable();
    let (mut compared, mut forces, mut contacts, mut saturated, mut below) = (0, 0, 0, 0, 0);
    let skipped = records.peek().unwrap().sample;
    for (n, &count) in (0u64..).zip(counts) {
        let (control, Sampled { motion, due }) =
            replay.sample(n, count, records.peek().copied(), &Senses::NONE);
        if !due || n < skipped {
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
            assert_eq!(
                (record.force, record.command),
                (drive.force, control.actuator.command(drive.force)),
                "{n}"
            );
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

/// The handle is held 0.3 mm inside the wall, so only a change of settings moves the force. Changes that are not
/// allowed in contact are refused. tests/host/force_step.rs has random times and changes.
fn a_change_in_contact_moves_the_force_by_five_per_cent_an_output_at_most(board: Board) {
    let firmware = Firmware::of(board);
    let mut world = firmware.armed();
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
