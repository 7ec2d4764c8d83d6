//! A short `cargo board campaign`. The results do not depend on the number of threads.

use board_trials::campaign::{
    row::Row,
    rows::rows,
    run::Ground,
    situation::{SITUATIONS, Situation, ready},
    verdict::{Class, Verdict},
};
use host_sim::scene::NamedScene;
use virtual_board::{board::NUCLEO_F446RE, elf::Elf, image, log, session::Session};

fn session() -> Session {
    let board = NUCLEO_F446RE;
    let elf = Elf::load(&image::build(board.name).unwrap()).unwrap();
    let table = log::table(&elf.bytes).unwrap();
    Session { board, scene: NamedScene::load(board.name).unwrap(), elf, table }
}

/// At output periods below 1 ms an output checks either the numbers of loop and supervisor or those of the experiment.
#[test]
fn a_number_that_changes_in_memory_is_found_at_each_output_period() {
    let session = session();
    for period in [1, 2, 5] {
        let at = format!("period {period}");
        for name in ["motor's sign in memory", "push of a hit in memory"] {
            let rows = rows(session.board, false);
            let row = rows.iter().find(|row| row.name == name).unwrap();
            for outputs in [0, 1] {
                let mut world = ready(&session, Situation::Free, &[&at]).unwrap();
                world.run(outputs * period).unwrap();
                (row.begin)(&session.elf, &mut world).unwrap();
                let off = (1..=20).find(|_| {
                    world.sample().unwrap();
                    !world.powered.amplifier.is_enabled()
                });
                println!("period {period}, {name}: off after {off:?} samples");
                assert!(
                    off.is_some_and(|samples| samples <= 2 * period + 1),
                    "{at}, {name}: {off:?}"
                );
                world.run(500).unwrap(); // the hit ends
                let faults = world.ask("faults").unwrap();
                assert!(faults.contains("44"), "{at}, {name}: {faults}");
            }
        }
    }
}

#[test]
fn a_fault_is_off_in_time_bounded_or_unnoticed_as_the_plant_says() {
    let session = session();
    let wanted = [
        ("no sample is due", Class::OffInTime, Class::OffInTime),
        ("enable's pin high, then stop", Class::OffInTime, Class::OffInTime),
        ("count frozen", Class::OffInTime, Class::Unnoticed),
        ("RTT: block zeroed", Class::OffInTime, Class::OffInTime),
        ("crystal stops", Class::OffInTime, Class::OffInTime),
        ("an order comes again", Class::OffInTime, Class::OffInTime),
        ("a core that sleeps deep", Class::NoEffect, Class::NoEffect),
        ("settings: flash at random", Class::NoEffect, Class::NoEffect),
        ("backup RAM at random", Class::NoEffect, Class::NoEffect),
    ];
    let named = |row: &Row| wanted.iter().any(|(name, ..)| row.name == *name);
    let chosen: Vec<_> = rows(session.board, false).into_iter().filter(named).collect();
    let ground = Ground::new(&session, &chosen).unwrap();
    let verdicts = ground.rows(&chosen, 2).unwrap();
    // In contact, rows that begin with the force off are not run. At full force, only rows with a short limit are run.
    // During a return move, no row is run.
    let each = |situation| verdicts.iter().filter(|(_, at, _)| *at == situation).count();
    assert_eq!(SITUATIONS.map(each), [wanted.len(), wanted.len() - 2, wanted.len() - 3, 0]);
    for (row, situation, verdict) in verdicts {
        let Verdict { class, off_s, speed_m_per_s, travel_m, .. } = verdict;
        let row = &chosen[row];
        let &(_, free, contact) = wanted.iter().find(|(name, ..)| row.name == *name).unwrap();
        let expected = if situation.is_free() { free } else { contact };
        println!("{} {situation:?}: {class:?}, {off_s:?}, {speed_m_per_s}, {travel_m}", row.name);
        assert_eq!(class, expected, "{} {situation:?}", row.name);
        // Only a row whose fault is never found has a reason.
        let stays = class == Class::Unnoticed;
        assert_eq!(row.reason(situation).is_some(), stays, "{} {situation:?}", row.name);
        assert_eq!(off_s.is_none(), matches!(class, Class::Unnoticed | Class::NoEffect));
        assert_eq!(verdict.wrong(row.reason(situation)), None, "{} {situation:?}", row.name);
    }
    let flips = [1, 2].map(|threads| {
        let flips = ground.flips((1, 0), 16, threads).unwrap();
        flips.into_iter().map(|(at, flip)| (at, flip.what, flip.verdict)).collect::<Vec<_>>()
    });
    assert_eq!(flips[0], flips[1]);
    assert!(flips[0].iter().any(|(.., verdict)| verdict.class != Class::NoEffect));
}
