//! Tests that nothing changes without an acknowledgement, and that no input keeps the task too busy.

use super::*;

#[test]
fn until_a_line_is_taken_no_command_is_obeyed_but_those_that_end_something() {
    let mut bench = Bench::new(ARMED);
    bench.console.port.deaf = true;
    bench.type_in("version"); // its reply waits
    assert_eq!(bench.type_in("k 100"), (Vec::new(), Vec::new()));
    assert_eq!(bench.type_in("nonsense"), (Vec::new(), Vec::new()));
    bench.report(Event::HitOver(crate::experiment::Verdict::Stable, Default::default())); // lost
    assert_eq!(bench.orders("disarm"), Order::Request(Request::Disarm));
    bench.answer(Ok(())); // lost as well
    assert_eq!(bench.orders("stop"), Order::Stop);
    bench.answer(Ok(()));
    bench.console.port.deaf = false;
    // sent again at every 32nd call
    let said = (0..64).find_map(|_| {
        bench.console.pass(true);
        Some(bench.take().0).filter(|lines| !lines.is_empty())
    });
    let said = said.unwrap();
    assert!(said[0].starts_with("ok version"), "{said:?}");
    assert_eq!(said[1..], ["error: nobody was reading: 2 commands ignored, 3 lines lost"]);
    assert!(is_answer(&said[0]) && !is_answer(&said[1]));
    assert_eq!(said[1].parse(), Ok(Unread { ignored: 2, lost: 3 }));
    assert_eq!(said[0].parse::<Unread>(), Err(()));
    assert!(matches!(bench.orders("k 100"), Order::LoopParameters(..)));
}

#[test]
fn a_line_that_was_only_late_is_said_alone() {
    let mut bench = Bench::new(OFF);
    bench.console.port.deaf = true;
    bench.type_in("version");
    bench.console.port.deaf = false;
    for _ in 0..64 {
        bench.console.pass(true);
    }
    let (lines, _) = bench.take();
    assert!(lines.len() == 1 && lines[0].starts_with("ok version"), "{lines:?}");
}

#[test]
fn one_line_a_pass_and_at_most_a_channel_of_bytes() {
    let mut bench = Bench::new(OFF);
    bench.console.port.typed.extend(*b"version\nversion\n");
    for left in [8, 0] {
        bench.console.pass(true);
        assert_eq!((bench.take().0.len(), bench.console.port.typed.len()), (1, left));
    }
    bench.console.port.typed.extend([b' '; 1000]);
    bench.console.pass(true);
    assert_eq!(bench.console.port.typed.len(), 1000 - 256);
}

/// Passes with a report each. Returns the number of the pass after which the console says that it is deaf.
fn deaf_after(bench: &mut Bench, reports: bool) -> Option<u32> {
    (1..200).find(|_| {
        if reports {
            bench.report(Event::None);
        }
        bench.console.pass(true);
        bench.console.is_deaf()
    })
}

#[test]
fn an_order_that_is_never_answered_or_has_no_room_is_noticed() {
    let mut bench = Bench::new(ARMED);
    assert_eq!(deaf_after(&mut bench, true), None);
    bench.console.flip_awaited();
    assert_eq!(bench.type_in("disarm"), (Vec::new(), Vec::new()));
    assert_eq!(deaf_after(&mut bench, true), Some(49));
    let mut bench = Bench::new(ARMED);
    bench.console.port.clogged = true;
    bench.type_in("disarm");
    assert!(bench.console.is_deaf());
}

#[test]
fn reports_that_never_come_are_noticed() {
    let mut bench = Bench::new(ARMED);
    assert_eq!(deaf_after(&mut bench, false), Some(51));
}

#[test]
fn bytes_of_0_are_passed_over_together() {
    let mut bench = Bench::new(ARMED);
    bench.console.port.typed.extend([0; 248]);
    assert_eq!(bench.orders("disarm"), Order::Request(Request::Disarm));
}
