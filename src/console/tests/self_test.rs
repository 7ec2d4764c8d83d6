//! Tests the command `selftest`. The console sends an order before it tests a part.

use std::vec;

use super::*;

/// After each answer the console tests one part. The board cannot arm before the last answer. The test first gives up
/// the zero of the position.
#[test]
fn a_self_test_asks_before_each_part_and_tells_what_has_failed() {
    let (stall, go_on) =
        (Order::Request(Request::Stall(true)), Order::Request(Request::Stall(false)));
    for wrong in [None, Some(Part::Output)] {
        let mut bench = Bench::new(OFF);
        bench.console.port.wrong = wrong;
        assert_eq!(bench.orders("selftest"), Order::Request(Request::Turn));
        bench.report(Event::Answer(Ok(())));
        assert_eq!(bench.take(), (vec![], vec![stall]));
        for (n, part) in Part::ALL.into_iter().enumerate() {
            assert_eq!(bench.console.port.tested.len(), n, "before it was allowed");
            bench.report(Event::Answer(Ok(())));
            let (lines, orders) = bench.take();
            let result = if wrong == Some(part) { "fail" } else { "pass" };
            let name = part.text();
            assert!(lines[0].starts_with(&format!("selftest {name}: {result}, ")), "{lines:?}");
            assert_eq!((lines.len(), orders), (1, vec![stall]));
        }
        assert_eq!(bench.console.port.tested, Part::ALL);
        bench.report(Event::Answer(Ok(())));
        let last = if wrong.is_some() { "error: selftest: 1 of 9 failed" } else { "ok selftest" };
        assert_eq!(bench.take(), (vec![last.into()], vec![go_on]));
        assert!(bench.answer(Ok(())).is_empty());
    }
}

/// After a fault the output may still have a force. The same is true if enable does not switch off. In both cases no
/// part of the test may drive the amplifier.
#[test]
fn a_self_test_does_not_drive_what_is_not_safe() {
    for (fault, wrong) in [(true, None), (false, Some(Part::Enable))] {
        let status = Status { fault: fault.then(|| FaultRecord::bare(Fault::ForceOutput)), ..OFF };
        let mut bench = Bench::new(status);
        bench.console.port.wrong = wrong;
        bench.orders("selftest");
        for _ in 0..=Part::ALL.len() {
            bench.report(Event::Answer(Ok(())));
        }
        let (lines, _) = bench.take();
        let why = if fault { "a fault is latched, clear it first" } else { "enable failed" };
        for part in Part::ALL.into_iter().filter(|part| part.drives()) {
            let tried = part == Part::Enable && !fault;
            assert_eq!(bench.console.port.tested.contains(&part), tried, "{part:?}");
            let said = format!("selftest {}: fail, not tried: {why}", part.text());
            assert_eq!(lines.contains(&said), !tried, "{lines:?}");
        }
        let tried = Part::ALL.len() - if fault { 3 } else { 2 };
        assert_eq!(bench.console.port.tested.len(), tried);
    }
}

#[test]
fn a_self_test_that_is_refused_ends_the_stall() {
    let refused = "error: the supply is too low";
    for parts in [0, 3] {
        let mut bench = Bench::new(OFF);
        bench.orders("selftest");
        for _ in 0..=parts {
            bench.report(Event::Answer(Ok(())));
        }
        bench.take();
        bench.report(Event::Answer(Err(Refusal::Supply)));
        let end = vec![Order::Request(Request::Stall(false))];
        assert_eq!(bench.take(), (vec![refused.into()], end));
        assert!(bench.answer(Ok(())).is_empty());
        assert!(bench.says("get").starts_with("ok get"));
        assert_eq!(bench.console.port.tested.len(), parts);
    }
}
