//! The part of the supervisor that runs in every sample.

use proptest::prelude::*;
use zwidth::{
    CounterWidth, VelocitySettings,
    safety::{Fault, FaultSet, Guard, GuardCommand, GuardView, GuardedSampler, HaltWatch},
    velocity::Senses,
};

use crate::{
    any::{self, Random},
    rig::{NO_WALL, control, wide},
};

crate::properties! {
    /// A move above its limit by one count, a speed above its limit by one LSB, and a missing output are found in the
    /// sample in which they happen. From then on every sample switches the force off until the fault is cleared. A
    /// sample with an output is the exception, because its output reports the fault.
    found_at_once(400, (period, jump, speed, samples, seed) in (
        prop_oneof![1u32..4, Just(10u32)],
        1u32..40,
        1u32..40,
        1u32..400,
        any::<u64>(),
    )) {
        let design = zwidth::Design { period, ..any::PAPER };
        let control = control(&design, VelocitySettings::Difference {}, NO_WALL).unwrap();
        let mut random = Random(seed);
        let mut sampler = GuardedSampler::new(0, CounterWidth::Bits32);
        let mut guard = Guard::NOTHING;
        let start = GuardCommand::start(&wide(&design).build(&design).unwrap());
        let mut down = GuardCommand { jump, speed: speed << 16, ..start };
        let mut count = 0i64;
        // `open` are the faults that were found and not cleared. `since` are the faults that were found and not noted
        // yet.
        let (mut open, mut since) = (FaultSet::EMPTY, FaultSet::EMPTY);
        let mut zeros = 0;
        for n in 0..samples {
            let most = i64::from(jump.min(speed));
            let counts = match random.below(12) {
                0 => i64::from(jump) + random.below(2) as i64,
                1 => i64::from(speed) + random.below(2) as i64,
                _ => random.below(most as u64 + 1) as i64,
            };
            let moved = if random.below(2) == 0 { counts } else { -counts };
            count += moved;
            let due = n % period == 0;
            let late = due && n.wrapping_sub(down.rendered) != period && !down.stall;
            let found = FaultSet::EMPTY
                .with_if(Fault::CountJump, counts > i64::from(jump))
                .with_if(Fault::OverSpeed, counts > i64::from(speed))
                .with_if(Fault::LateRender, late);
            let events = guard.events;
            let step = sampler.step(&control, count as u32, &Senses::NONE, &down, &mut guard);
            open = open.union(found);
            since = since.union(found);
            let seen = found.without(FaultSet::EMPTY.with(Fault::LateRender));
            assert_eq!(seen.without(step.report.present), FaultSet::EMPTY, "{seen:?} is not told with its sample");
            assert_eq!(step.report.present.without(open), FaultSet::EMPTY, "nothing else is there");
            assert_eq!(step.due, due);
            assert_eq!(step.report.motion.sample, u64::from(n));
            let answered = due && period > 1;
            let renamed = down.zeros.number() != zeros;
            if !renamed {
                assert_eq!(step.cut, !open.is_empty() && !answered, "sample {n}");
            }
            if renamed && !answered {
                // The zero is carried out: the position of this sample is now 0.
                assert_eq!((guard.zeros, step.report.motion.position.counts()), (down.zeros.number(), 0));
                zeros = down.zeros.number();
            }
            if guard.events != events {
                assert_eq!(guard.events, events.wrapping_add(1));
                assert_eq!(guard.causes.without(open), FaultSet::EMPTY);
                assert_eq!(since.without(guard.causes), FaultSet::EMPTY, "{since:?} is noted");
                since = FaultSet::EMPTY;
            }
            if due && random.below(15) > 0 {
                down.rendered = n;
            }
            if due && down.rendered == n {
                down.stall = random.below(10) == 0;
                if random.below(8) == 0 && since.is_empty() {
                    down.acknowledged = guard.events;
                    open = FaultSet::EMPTY;
                }
                if random.below(10) == 0 && down.zeros.number() == zeros {
                    down.zeros = down.zeros.next();
                }
            }
        }
    }

    /// What the output task knows of the guard is never newer than the sample that the output answers. It includes the
    /// zeros up to this sample.
    never_newer(500, (first, told) in (
        any::<u32>(),
        prop::collection::vec((0u32..30, 0u32..30), 1..40),
    )) {
        let mut view = GuardView::NOTHING;
        // Samples continue. Some samples are answered, and some samples get a zero.
        let (mut now, mut zeros) = (first, 0);
        let mut done: Vec<(u64, u32)> = Vec::new();
        let mut age = 0u64;
        for (later, before) in told {
            age += u64::from(later) + 1;
            now = now.wrapping_add(later + 1);
            zeros += 1;
            done.push((age, zeros));
            view.take(Guard { zeros, events: zeros, ..Guard::NOTHING }, now);
            let back = before.min(later);
            let answered = age - u64::from(back);
            let seen = view.at(now.wrapping_sub(back));
            let expected = done.iter().rfind(|(at, _)| *at <= answered).map_or(0, |(_, zeros)| *zeros);
            assert_eq!((seen.zeros, seen.events), (expected, zeros));
            // The next zero is requested by an output that has seen this zero.
            assert_eq!(view.at(now).zeros, zeros);
        }
    }

    /// If a core was halted for longer than an output period and two samples, the halt is found once. If the outputs
    /// are late by less than a period, no halt is found.
    halts(500, (period, outputs, seed) in (prop_oneof![Just(1u32), Just(10), Just(100)], 2u32..60, any::<u64>())) {
        let mut random = Random(seed);
        let mut watch = HaltWatch::default();
        let ticks = f64::from(HaltWatch::TICKS_PER_SAMPLE);
        let (mut still, mut halted) = (random.part() * 1e5, 0.0);
        let mut last_late = 0.0;
        for n in 0..outputs {
            let late = random.part() * (f64::from(period) - 0.01);
            if n > 0 && random.below(6) == 0 {
                // A halt that is long enough, or none, with any lateness before and after it.
                halted = 2.0 * f64::from(period) + 2.3 + random.part() * (16_000.0 - 4.0 * f64::from(period));
                still += halted;
            }
            let sample = u64::from(n * period);
            let time = (sample as f64 + still + late) * ticks;
            let found = watch.found(time as u64 as u16, sample, period);
            if n > 0 {
                let passed = halted + late - last_late;
                assert_eq!(found, halted > 0.0, "{passed} samples more than were taken");
            }
            (halted, last_late) = (0.0, late);
        }
    }
}
