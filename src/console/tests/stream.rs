//! Tests the parts of telemetry apart from the outputs: the counts of all samples, and the keys.

use super::*;
use crate::{
    CounterWidth, LoopParameters,
    safety::{Guard, GuardCommand},
    telemetry::{Decoder, Flags, Frame, InForce, Key},
    velocity::{Senses, State as Estimated},
};

#[derive(Debug)]
struct Seen {
    newest: u64,
    positions: Vec<Position>,
    push: Force,
    settings: Vec<InForce>,
    key: Option<Key>,
    port: Option<Exchanged>,
}

struct Moving {
    bench: Bench,
    parameters: LoopParameters,
    sampler: GuardedSampler,
    numbers: u16,
    decoder: Decoder,
    down: GuardCommand,
}

impl Moving {
    fn new() -> Self {
        let bench = Bench::new(FREE);
        let parameters = DEVICE.control(&bench.console.stored).unwrap();
        let sampler = GuardedSampler::new(0, CounterWidth::Bits32);
        let plan = DEVICE
            .start(&Loaded { stored: DEVICE.defaults(), source: Source::Empty, damaged: 0 }, None);
        let down = GuardCommand { stall: true, ..GuardCommand::start(&plan.unwrap().safety) };
        Self { bench, parameters, sampler, numbers: 1, decoder: Decoder::new(), down }
    }

    /// Runs one millisecond. Returns the content of its frame, if there was one.
    fn run(&mut self, event: Event) -> Option<Seen> {
        let mut motion = None;
        let from = self.sampler.sampler().next();
        for n in from..=from.div_ceil(10) * 10 {
            let count = u32::try_from(n * n / 50).unwrap();
            let step = self.sampler.step(
                &self.parameters,
                count,
                &Senses::NONE,
                &self.down,
                &mut Guard::NOTHING.clone(),
            );
            motion = Some(step.report.motion);
            self.bench.console.port.positions.push(step.report.motion.position);
        }
        let motion = motion.unwrap();
        self.bench.console.port.sampler = Some(self.sampler);
        let record = Record {
            sample: motion.sample,
            position: motion.position,
            velocity: motion.velocity,
            settings: self.numbers,
            ..Record::EMPTY
        };
        self.told(record, record, event)
    }

    fn told(&mut self, record: Record, streamed: Record, event: Event) -> Option<Seen> {
        let Bench { status, activity, .. } = self.bench;
        let push = Force::saturating_from_bits(1 << 20);
        self.bench.console.report(&Report {
            record,
            streamed,
            push,
            port: PORT,
            status,
            activity,
            event,
        });
        self.bench.take();
        let bytes = std::mem::take(&mut self.bench.console.port.frames).concat();
        let found = bytes.into_iter().filter_map(|byte| self.decoder.push(byte)).last();
        found.map(|frame: Frame| {
            let parts = self.decoder.parts();
            let mut places = [Position::default(); Frame::SAMPLES + 1];
            Seen {
                newest: frame.record.sample,
                positions: parts.positions(frame.record.position, &mut places).to_vec(),
                push: parts.push(0),
                settings: parts.settings().flatten().collect(),
                key: parts.key(),
                port: parts.port(),
            }
        })
    }

    /// Whether the frame has all samples that were not sent before, up to its newest sample.
    fn positions(&self, seen: &Seen, samples: u64) -> bool {
        let [newest, samples] = [seen.newest, samples].map(|n| usize::try_from(n).unwrap());
        seen.positions == self.bench.console.port.positions[newest - samples..=newest]
    }
}

/// Every frame has the counts of its millisecond. One frame in a hundred has a key, from which the next key can be
/// computed.
#[test]
fn counts_come_with_every_frame_and_a_key_each_100_ms() {
    let mut moving = Moving::new();
    let (mut keys, mut estimated) = (Vec::new(), None);
    for n in 0..=250u64 {
        let seen = moving.run(Event::None).unwrap();
        assert_eq!((seen.newest, seen.push.bits()), (10 * n, 1 << 20));
        assert!(moving.positions(&seen, if n == 0 { 0 } else { 10 }), "{seen:?}");
        let estimator = &moving.parameters.estimator;
        if let Some(state) = &mut estimated {
            for position in &seen.positions[1..] {
                estimator.update(state, *position, &Senses::NONE);
            }
        }
        assert_eq!(seen.port, seen.key.map(|_| PORT));
        let Some(key) = seen.key else { continue };
        keys.push(key.sample);
        assert_eq!(seen.settings.len(), 1);
        assert_eq!((seen.settings[0].number, key.settings), (1, 1));
        let built = seen.settings[0].settings.build(&seen.settings[0].design).unwrap();
        assert_eq!(built, moving.parameters);
        let state = Estimated::of(estimator, (key.position, key.velocity), key.memory()).unwrap();
        let bytes = |state: &Estimated| {
            let mut bytes = [0; 99];
            state.put(estimator, &mut bytes).map(|length| bytes[..length].to_vec())
        };
        assert_eq!(estimated.as_ref().map_or(bytes(&state), bytes), bytes(&state));
        estimated = Some(state);
    }
    assert_eq!(keys, [0, 1000, 2000]);
}

/// After a gap a reader gets a key. A gap comes from a full channel, after which the counts are sent again, or from
/// telemetry that was off. A record of the black box has neither counts nor a key.
#[test]
fn a_key_follows_every_gap() {
    let mut moving = Moving::new();
    let key = |seen: &Option<Seen>| seen.as_ref().unwrap().key;
    assert!(key(&moving.run(Event::None)).is_some());
    assert!(key(&moving.run(Event::None)).is_none());
    moving.bench.console.port.full = true;
    assert!(moving.run(Event::None).is_none());
    moving.bench.console.port.full = false;
    let seen = moving.run(Event::None).unwrap();
    assert!(seen.key.is_some() && moving.positions(&seen, 20), "{seen:?}");
    assert!(key(&moving.run(Event::None)).is_none());

    moving.bench.says("stream off");
    assert!((0..5).all(|_| moving.run(Event::None).is_none()));
    moving.bench.says("stream on");
    let seen = moving.run(Event::None).unwrap();
    assert!(seen.key.is_some() && moving.positions(&seen, 10), "{seen:?}");

    let sent = moving.bench.console.port.positions.len() as u64 - 1;
    let old = Record { sample: sent - 50, flags: Flags::REPLAY, ..Record::EMPTY };
    let now = Record { sample: sent, settings: 1, ..Record::EMPTY };
    let seen = moving.told(now, old, Event::None).unwrap();
    assert!(
        seen.positions.is_empty() && seen.key.is_none() && seen.newest == sent - 50,
        "{seen:?}"
    );
    assert!((0..3).all(|_| moving.run(Event::None).is_some()));
}

/// A new key follows when the settings change, and when the position is made zero.
#[test]
fn a_key_follows_whatever_changes_the_estimator_or_the_wall() {
    let mut moving = Moving::new();
    assert!(moving.run(Event::None).unwrap().key.is_some());
    let mut number = 1;
    for line in ["k 3000", "cutoff 700", "estimator difference"] {
        let Order::LoopParameters(parameters, _) = moving.bench.orders(line) else {
            panic!("{line}")
        };
        let seen = moving.run(Event::Answer(Ok(()))).unwrap();
        assert!(seen.key.is_none(), "{line}");
        moving.parameters = parameters.after(&moving.parameters);
        number += 1;
        moving.numbers = number;
        let seen = moving.run(Event::None).unwrap();
        let key = seen.key.unwrap();
        assert_eq!((key.settings, seen.settings[0].number), (number, number), "{line}");
        let built = seen.settings[0].settings.build(&seen.settings[0].design).unwrap();
        let same = LoopParameters { estimator: moving.parameters.estimator, ..built };
        assert_eq!(
            (same, *built.estimator),
            (moving.parameters, *moving.parameters.estimator),
            "{line}"
        );
        assert!(moving.run(Event::None).unwrap().key.is_none(), "{line}");
    }
    // A refused change is not a change.
    moving.bench.orders("k 3100");
    moving.run(Event::Answer(Err(Refusal::Contact)));
    assert!(moving.run(Event::None).unwrap().key.is_none());
    moving.down.zeros = moving.down.zeros.next();
    let seen = moving.run(Event::None).unwrap();
    assert_eq!(seen.key.unwrap().zeros, 1);
    assert!(moving.run(Event::None).unwrap().key.is_none());
}

/// The console's task is late here. The sampler already uses settings whose order is not answered yet.
#[test]
fn a_key_of_settings_that_are_not_answered_yet_names_them() {
    let mut moving = Moving::new();
    moving.run(Event::None);
    let Order::LoopParameters(parameters, _) = moving.bench.orders("cutoff 700") else { panic!() };
    let old = moving.parameters;
    // the outputs of two milliseconds, of which the second has the new settings
    let sample = moving.sampler.sampler().next() + 9;
    for n in 0..20u32 {
        moving.parameters = if n < 10 { old } else { parameters.after(&old) };
        let count = 900 + n;
        let step = moving.sampler.step(
            &moving.parameters,
            count,
            &Senses::NONE,
            &moving.down,
            &mut Guard::NOTHING.clone(),
        );
        moving.bench.console.port.positions.push(step.report.motion.position);
    }
    moving.bench.console.port.sampler = Some(moving.sampler);
    let record = |sample, settings| Record { sample, settings, ..Record::EMPTY };
    let first = moving.told(record(sample, 1), record(sample, 1), Event::Answer(Ok(()))).unwrap();
    let key = first.key.unwrap();
    assert_eq!((key.sample, key.settings), (sample + 10, 2));
    assert_eq!(first.settings.iter().map(|settings| settings.number).collect::<Vec<_>>(), [1, 2]);
    let second = moving.told(record(sample + 10, 2), record(sample + 10, 2), Event::None).unwrap();
    assert_eq!(second.settings[0].number, 2);
}
