//! `cargo board campaign` in small: what its classes mean on the image, and that threads change nothing.

use host_sim::scene::NamedScene;
use virtual_board::{
    board::NUCLEO_F446RE,
    campaign::{
        rows::{Row, rows},
        run::Ground,
        situation::Situation,
        verdict::{Class, Verdict},
    },
    elf::Elf,
    image, log,
    session::Session,
};

#[test]
fn a_fault_is_off_in_time_bounded_or_unnoticed_as_the_plant_says() {
    let board = NUCLEO_F446RE;
    let elf = Elf::load(&image::build(board.name).unwrap()).unwrap();
    let table = log::table(&elf.bytes).unwrap();
    let session = Session { board, scene: NamedScene::load(board.name).unwrap(), elf, table };
    let wanted = [
        ("no sample is due", Class::OffInTime, Class::OffInTime),
        ("enable's pin high, then stop", Class::OffInTime, Class::OffInTime),
        ("count frozen", Class::OffInTime, Class::Unnoticed),
        ("RTT: block zeroed", Class::NoEffect, Class::NoEffect),
    ];
    let named = |row: &Row| wanted.iter().any(|(name, ..)| row.name == *name);
    let chosen: Vec<_> = rows(board, false).into_iter().filter(named).collect();
    let ground = Ground::new(&session, &chosen).unwrap();
    let verdicts = ground.rows(&chosen, 2).unwrap();
    assert_eq!(verdicts.len(), 2 * wanted.len());
    for (row, situation, Verdict { class, off_s, speed_m_per_s, travel_m, .. }) in verdicts {
        let row = &chosen[row];
        let &(_, free, contact) = wanted.iter().find(|(name, ..)| row.name == *name).unwrap();
        let expected = if situation == Situation::Free { free } else { contact };
        println!("{} {situation:?}: {class:?}, {off_s:?}, {speed_m_per_s}, {travel_m}", row.name);
        assert_eq!(class, expected, "{} {situation:?}", row.name);
        // A reason is given where, and only where, a fault stays.
        let stays = class == Class::Unnoticed;
        assert_eq!(row.reason(situation).is_some(), stays, "{} {situation:?}", row.name);
        assert_eq!(off_s.is_none(), matches!(class, Class::Unnoticed | Class::NoEffect));
        if off_s.is_some_and(|off_s| off_s <= 3e-3) {
            assert!(speed_m_per_s <= 0.1, "{} {situation:?}: {speed_m_per_s}", row.name);
        }
    }
    let flips = [1, 2].map(|threads| {
        let flips = ground.flips((1, 0), 16, threads).unwrap();
        flips.into_iter().map(|(at, flip)| (at, flip.what, flip.verdict)).collect::<Vec<_>>()
    });
    assert_eq!(flips[0], flips[1]);
    assert!(flips[0].iter().any(|(.., verdict)| verdict.class != Class::NoEffect));
}
