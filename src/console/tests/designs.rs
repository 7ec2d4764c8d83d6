//! Tests the designs of a device. They are chosen by name with the force off. Replies, saved settings and telemetry
//! name them.

use std::sync::LazyLock;

use super::*;
use crate::{
    device::{
        designs::tests::NAMED,
        record::{BoardFacts, WORDS_MAX},
        tests::BOUNDARY,
    },
    safety::envelope::{Boundary, Key},
    telemetry::Decoder,
};

/// [`DEVICE`] with two designs. Only the second has a table in the envelope.
fn device() -> &'static Device<'static> {
    static WORDS: LazyLock<([u32; WORDS_MAX], usize)> = LazyLock::new(|| {
        let key = Key { design: 2, ..BOUNDARY.key };
        let mut words = [0; WORDS_MAX];
        let rows = [BOUNDARY, Boundary { key, ..BOUNDARY }];
        let record = DEVICE.to_record(&NAMED, &rows, &mut words).unwrap().len();
        (words, record)
    });
    static NAMED_DEVICE: LazyLock<Device<'static>> = LazyLock::new(|| {
        let board = BoardFacts {
            name: "a-board",
            rate_hz: DEVICE.design.rate_hz,
            output: DEVICE.design.output,
            senses: DEVICE.senses,
            latency_samples: DEVICE.latency_samples,
        };
        let (words, record) = &*WORDS;
        Device::from_record(&words[..*record], &board).unwrap()
    });
    &NAMED_DEVICE
}

fn name(bench: &mut Bench) -> String {
    let said = bench.says("get");
    said.rsplit_once(", design ").expect(&said).1.to_string()
}

#[test]
fn a_device_without_designs_says_so_and_get_is_silent() {
    let mut bench = Bench::new(OFF);
    assert_eq!(bench.says("designs"), "ok designs none");
    assert_eq!(bench.says("design paper"), "error: unknown design, allowed none");
    assert!(!bench.says("get").contains("design"));
}

#[test]
fn a_design_is_taken_whole_and_only_with_the_force_off() {
    let mut bench = Bench::on(device(), OFF);
    assert_eq!(bench.says("designs"), "ok designs 0123456789abcdef paper");
    let unknown = "error: unknown design, allowed 0123456789abcdef paper";
    assert_eq!(bench.says("design none"), unknown);
    for (number, design) in bench.console.device.designs.iter() {
        let line = format!("design {}", design.name.text());
        let mut wanted = bench.stored();
        wanted.settings.velocity = design.velocity;
        let order = bench.orders(&line);
        assert_eq!(order, bench.console.device.order(&wanted).unwrap());
        assert_eq!(bench.answer(Ok(())), [format!("ok {line}")]);
        assert_eq!(bench.stored(), wanted);
        assert_eq!((name(&mut bench).as_str(), number), (design.name.text(), bench.console.design));
    }
    for status in [ARMED, FREE] {
        bench.status = status;
        bench.report(Event::None);
        assert_eq!(bench.says("design paper"), "error: the force is on: disarm first");
    }
}

/// Apart from the designs, the envelope here knows a single cutoff. Any other tuning is accepted with the force off,
/// but then the force cannot be switched on.
#[test]
fn free_tuning_needs_the_envelope_unlocked() {
    let mut bench = Bench::on(device(), OFF);
    let gains = |bench: &mut Bench| {
        for line in ["k 1000", "b 20"] {
            bench.orders(line);
            bench.answer(Ok(()));
        }
    };
    gains(&mut bench);
    bench.orders("design paper");
    bench.answer(Ok(()));
    assert_eq!(bench.console.device.inside(&bench.stored()), Ok(()));
    bench.status = ARMED;
    bench.report(Event::None);
    let refused = bench.says("cutoff 1499");
    let known = "; known: butterworth 1500; design paper, or unlock envelope";
    assert!(refused.starts_with("error: no envelope") && refused.ends_with(known), "{refused}");
    bench.status = FREE;
    bench.report(Event::None);
    bench.orders("cutoff 1499");
    assert_eq!(bench.answer(Ok(())), ["ok cutoff 1499 Hz"]);
    assert_eq!(name(&mut bench), "none");
    // With the force off the tuning is accepted, as an order that keeps the force off. `arm` gives the reason.
    bench.status = OFF;
    bench.report(Event::None);
    let order = bench.orders("cutoff 1498");
    assert!(matches!(order, Order::LoopParameters(_, crate::experiment::Gains::Outside)));
    bench.answer(Ok(()));
    bench.status.inputs.settings_valid = false;
    bench.report(Event::None);
    assert!(bench.says("arm").ends_with(known));
}

#[test]
fn saved_settings_come_back_as_the_design_they_are() {
    let mut bench = Bench::on(device(), OFF);
    bench.orders("design 0123456789abcdef");
    bench.answer(Ok(()));
    bench.orders("save");
    bench.answer(Ok(()));
    bench.answer(Ok(()));
    bench.take();
    bench.orders("cutoff 1500");
    bench.answer(Ok(()));
    assert_eq!(name(&mut bench), "paper");
    // Like `design`, it needs the force off.
    bench.status = ARMED;
    bench.report(Event::None);
    assert_eq!(bench.says("load"), "error: the force is on: disarm first");
    bench.status = OFF;
    bench.report(Event::None);
    bench.orders("load");
    bench.answer(Ok(()));
    assert_eq!(name(&mut bench), "0123456789abcdef");
}

#[test]
fn telemetry_has_the_number_of_the_design_but_for_the_black_box() {
    let mut bench = Bench::on(device(), OFF);
    let numbers = |bench: &mut Bench| -> Vec<u8> {
        let frames = std::mem::take(&mut bench.console.port.frames);
        let mut decoder = Decoder::new();
        let frames = frames.into_iter().flatten().filter_map(|byte| decoder.push(byte));
        frames.map(|frame| frame.record.flags.design()).collect()
    };
    bench.report(Event::None);
    numbers(&mut bench);
    bench.orders("design 0123456789abcdef");
    bench.answer(Ok(()));
    bench.report(Event::None);
    bench.orders("cutoff 500");
    bench.answer(Ok(()));
    bench.report(Event::None);
    // The settings at the start are those of the design `paper`. When an output accepts new settings, its frame is sent
    // before the console stores them.
    assert_eq!(numbers(&mut bench), [2, 1, 1, 0]);
    bench.orders("design paper");
    bench.answer(Ok(()));
    let record = Record { flags: crate::telemetry::Flags::REPLAY, ..Record::EMPTY };
    bench.tell(record, Event::None);
    assert_eq!(numbers(&mut bench), [0, 0]);
}
