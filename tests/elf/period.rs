//! Tests the output period, which is set on the console of one image. At each period, every frame of a hit equals the
//! frame that the core computes on the host. The tests also check the time of the tasks, and which estimators have
//! enough time.

use virtual_board::{
    board::{BOARDS, Board, Force},
    device::built_in,
    mcu::{LINK, RENDER, SAMPLE, Watch},
    world::World,
};
use zwidth::{
    device::{Device, designs::NamedFilter},
    experiment::Order,
    period::{GUARD, PERIODS, cycles_allowed, leaves_time},
    safety::Request,
    store::Stored,
    telemetry::{Decoder, Flags, Record},
    velocity::EstimatorName,
};

use crate::{
    estimator_cost::TABLE,
    figure::figure,
    firmware::{Firmware, arm, ok},
    mailbox::cost_row,
    twin::Twin,
};

each_board!(
    every_period_has_the_time_and_its_hit_is_the_cores,
    ignored: "a hit at every period; that at period 1 runs by default"
);
each_board!(
    every_estimator_has_the_time_or_is_refused,
    ignored: "an image of its own; CI runs it"
);

/// Largest fraction of the time between two outputs that `sample` and `render` may take together. The worst case is on
/// the slower board at period 1. There it is an output of a return move that measures the speed.
const LOAD: f64 = 0.25;

#[test]
fn an_output_with_every_sample_is_set_on_the_console() {
    hit_at(&Firmware::of(BOARDS[0]), built_in(BOARDS[0]), None, 1);
}

fn every_period_has_the_time_and_its_hit_is_the_cores(board: Board) {
    let firmware = Firmware::of(board);
    for period in PERIODS {
        let (watch, sent) = hit_at(&firmware, built_in(board), None, period);
        let [sample, render, link] = [SAMPLE, RENDER, LINK].map(|task| watch.tasks[&task]);
        let outputs = u64::from(period);
        let between = (outputs * board.cycles_per_sample()) as f64;
        let load = (outputs * sample.most + render.most) as f64 / between;
        println!(
            "{} period {period}: sample {}..{}, render {}..{}, link at most {}, {:.1} % of the time, delays {:?}, \
             event to register {}..{}, {:.1} % of the frames",
            board.name,
            sample.least,
            sample.most,
            render.least,
            render.most,
            link.most,
            100.0 * load,
            watch.delays,
            watch.commands.least,
            watch.commands.most,
            100.0 * sent,
        );
        for (key, value) in [
            ("sample_least", sample.least),
            ("sample_most", sample.most),
            ("render_least", render.least),
            ("render_most", render.most),
            ("delay_least", *watch.delays.keys().next().unwrap()),
            ("delay_most", *watch.delays.keys().last().unwrap()),
            ("register_least", watch.commands.least),
            ("register_most", watch.commands.most),
        ] {
            figure(&format!("elf/period/{}/{period}/{key}", board.name), value);
        }
        figure(&format!("elf/period/{}/{period}/load", board.name), load);
        figure(&format!("elf/period/{}/{period}/sent", board.name), sent);
        assert!(load <= LOAD, "{load}");
        assert!(watch.delay_spread() <= 64, "{:?}", watch.delays);
        assert_eq!((watch.primask, watch.forbidden_basepri), (0, 0));
    }
}

/// An order, and the condition on a frame that shows that an output has carried out the order.
struct Step {
    order: Order,
    told: fn(&Record, &Record) -> bool,
}

fn flagged(before: &Record, after: &Record, flag: Flags) -> bool {
    after.flags.contains(flag) && !before.flags.contains(flag)
}

/// A hit of this device at this period, with the design of this number and name. Returns what the virtual board
/// observed during the hit, and the share of frames that were received.
pub fn hit_at(
    firmware: &Firmware,
    device: &Device,
    design: Option<(u8, NamedFilter)>,
    period: u32,
) -> (Watch, f64) {
    let mut now = device.defaults();
    let settings = |stored: &Stored| Step {
        order: device.order(stored).unwrap(),
        told: |before, after| after.settings != before.settings,
    };
    let request = |request, told| Step { order: Order::Request(request), told };
    let mut world = firmware.boot();
    // The firmware's first settings are the first order.
    let mut steps = vec![settings(&now)];
    ok(&mut world, "zero");
    steps.push(request(Request::Zero, |before, after| flagged(before, after, Flags::ZEROED)));
    ok(&mut world, "unlock envelope");
    steps.push(request(Request::Unlock, |before, after| flagged(before, after, Flags::UNLOCKED)));
    ok(&mut world, &format!("period {period}"));
    let plan = (period != now.period)
        .then(|| Order::Period(device.period(&Stored { period, ..now }).unwrap()));
    let plan_before = steps.len();
    now.period = period;
    steps.push(settings(&now));
    if let Some((_, NamedFilter { name, velocity })) = design {
        let line = format!("design {}", name.text());
        assert_eq!(ok(&mut world, &line), format!("ok {line}"));
        now.settings.velocity = velocity;
        steps.push(settings(&now));
    }
    for line in ["wall 0.005", "k 8000", "b 30", "push 2.835", "settle 0.1", "window 0.1"] {
        ok(&mut world, line);
    }
    let wall = &mut now.settings.wall;
    wall.position_m = 0.005;
    steps.push(settings(&now));
    now.settings.wall.stiffness_n_per_m = 8000.0;
    steps.push(settings(&now));
    now.settings.wall.damping_n_s_per_m = 30.0;
    steps.push(settings(&now));
    (now.push_n, now.settle_s, now.window_s) = (2.835, 0.1, 0.1);
    ok(&mut world, "arm");
    steps.push(request(Request::Arm, |before, after| flagged(before, after, Flags::ON)));
    world.run(4_000).unwrap();
    let refused = world.ask(&format!("period {period}")).unwrap();
    assert_eq!(refused, "error: the force is on: disarm first");
    world.powered.mcu.watch_mut().clear();
    let asked = world.powered.mcu.counter_readings().len() as u64;
    ok(&mut world, "hit");
    let answered = world.powered.mcu.counter_readings().len() as u64;
    let over = world.reply(60_000).unwrap();
    assert!(over.starts_with("ok hit "), "{over}");
    let watch = world.powered.mcu.watch().clone();
    world.run(500).unwrap();
    let status = ok(&mut world, "status");
    assert!(status.contains("armed, fault none"), "{status}");
    let (mut records, dropped) = records(&mut world);
    let own = device.designs.number_of(&device.settings.velocity);
    let number = design.map_or(own, |(number, _)| number);
    let chosen = records.iter().position(|record| record.flags.design() == number).unwrap();
    for (n, record) in records.iter_mut().enumerate() {
        assert_eq!(record.flags.design(), if n < chosen { own } else { number }, "{n}");
        record.flags = record.flags.with_design(0); // the design's number comes from the console, not from the tasks
    }
    let sent = records.len() as f64 / (records.len() as u64 + dropped) as f64;
    assert!(sent > 0.99, "{sent}");

    // For each order, the output that carried it out. If the period changes, the order with the new plan comes before
    // the order with the new parameters.
    let mut met: Vec<(u64, Order)> = vec![];
    let mut pairs = records.windows(2);
    for (n, Step { order, told }) in steps.into_iter().enumerate() {
        let pair =
            pairs.find(|pair| told(&pair[0], &pair[1])).unwrap_or_else(|| panic!("{n}: {order:?}"));
        if n == plan_before {
            met.extend(plan.map(|plan| (pair[0].sample - 10, plan)));
        }
        met.push((pair[0].sample, order));
    }
    let hit = Order::Hit(device.hit_sequence(&now, false).unwrap());
    let readings = world.powered.mcu.counter_readings();
    let differs = |hit_at: u64| {
        let orders = met.iter().copied().chain([(hit_at, hit)]).collect();
        first_difference(device, &readings, &records, orders)
    };
    let found: Vec<_> = (asked..answered).map(differs).collect();
    let same = found.iter().flatten().count() < found.len();
    assert!(
        same,
        "period {period}: it differs at best from {:?} on",
        found.iter().flatten().max_by_key(|(sample, ..)| sample)
    );
    let contacts = records.iter().filter(|record| record.flags.contains(Flags::CONTACT)).count();
    println!("period {period}: {} frames equal, {contacts} in contact", records.len());
    assert!(contacts as u32 * period > 500, "{contacts}");
    (watch, sent)
}

/// Finds the first frame that differs from the core. Returns its sample, the core's record and the frame.
fn first_difference(
    device: &Device,
    readings: &[u32],
    records: &[Record],
    orders: Vec<(u64, Order)>,
) -> Option<(u64, Record, Record)> {
    let [first, readings @ ..] = readings else { panic!("no counts") };
    let mut twin = Twin::new(device, device.defaults(), *first);
    let mut orders = orders.into_iter().peekable();
    let mut records = records.iter().peekable();
    for (n, &count) in (0u64..).zip(readings) {
        let order = |_: &Record| orders.next_if(|(sample, _)| *sample <= n).map(|(_, order)| order);
        let output = twin.sample(count, order);
        if let Some(frame) = records.next_if(|record| record.sample == n)
            && output != Some(*frame)
        {
            return Some((n, output.unwrap_or(Record::EMPTY), *frame));
        }
    }
    None
}

pub fn records(world: &mut World<'_>) -> (Vec<Record>, u64) {
    let mut decoder = Decoder::new();
    let telemetry = std::mem::take(&mut world.telemetry);
    let mut found = vec![];
    for byte in telemetry {
        if let Some(frame) = decoder.push(byte) {
            found.extend(decoder.outputs(frame).map(|frame| frame.record));
        }
    }
    (found, decoder.dropped)
}

/// Cycles of an estimator's longest update. They are from the table that the test `estimator_cost` checks.
fn cycles_of(name: EstimatorName) -> u64 {
    cost_row("estimator_cost.csv", TABLE, name.text())[1].parse().unwrap()
}

/// Each estimator at each period, in and out of the wall, with commands and log lines all the time. No estimator makes
/// an output late. The board refuses the same estimators as the library.
fn every_estimator_has_the_time_or_is_refused(board: Board) {
    let firmware = Firmware::variant(board, &["estimators"]);
    let dac = matches!(board.wiring.force, Force::Dac { .. });
    // The library allows four fifths of the slowest board's cycles. A faster board has more cycles.
    let slowest = BOARDS.iter().map(|board| board.cycles_per_sample()).min().unwrap();
    let spare = (board.cycles_per_sample() - slowest) * 4 / 5;
    for period in PERIODS {
        let mut world = firmware.boot();
        ok(&mut world, &format!("period {period}"));
        arm(&mut world);
        let middle_m = world.position_m();
        world.hold(middle_m, true);
        world.run(300).unwrap();
        let (mut refused, mut worst, mut beside) = (vec![], ("", 0, 0), 0);
        // The estimator with the fewest cycles comes first, since the last sample of the previous estimator is measured
        // too.
        let mut names = EstimatorName::ALL.to_vec();
        names.sort_by_key(|&name| cycles_of(name));
        for name in names {
            world.powered.mcu.watch_mut().clear();
            let reply = world.ask(&format!("estimator {}", name.text())).unwrap();
            if let Err(slow) = leaves_time(name, period)
                && !reply.contains("which this board has not")
            {
                assert_eq!(reply, format!("error: {slow}"));
                refused.push(name.text());
                continue;
            }
            if reply.contains("which this board has not") {
                continue;
            }
            assert!(reply.starts_with("ok estimator"), "{reply}");
            for n in 0..500u32 {
                let phase = f64::from(n) / 500.0 * std::f64::consts::TAU;
                world.hold(middle_m + 0.0053 * 0.5 * (1.0 - phase.cos()), true);
                world.sample().unwrap();
                if n % 50 == 49 {
                    world.probe().unwrap();
                    world
                        .send(["status\n", "get\n", "rubbish\n", "k 7000\n"][(n / 50 % 4) as usize])
                        .unwrap();
                }
            }
            // Runs until all lines are answered. Some lines have to wait.
            world.run(600).unwrap();
            world.replies.clear();
            let status = ok(&mut world, "status");
            assert!(status.contains("armed, fault none"), "{} at {period}: {status}", name.text());
            let tasks = &world.powered.mcu.watch().tasks;
            let rest = tasks[&SAMPLE].most.saturating_sub(cycles_of(name));
            beside = beside.max(rest);
            assert!(
                rest <= u64::from(GUARD) + spare,
                "{} at {period}: {rest} beside it",
                name.text()
            );
            if tasks[&SAMPLE].most > worst.1 {
                worst = (name.text(), tasks[&SAMPLE].most, tasks[&RENDER].most);
            }
        }
        let (name, sample, render) = worst;
        println!(
            "{} period {period}: refused {refused:?}; the longest {name}, sample {sample}, render {render}; at most \
             {beside} of `sample` beside an estimator",
            board.name
        );
        let key = format!("elf/period/{}/{period}", board.name);
        figure(&format!("{key}/allowed"), cycles_allowed(period));
        figure(&format!("{key}/refused"), refused.join(" "));
        figure(&format!("{key}/slowest"), name);
        figure(&format!("{key}/slowest_sample"), sample);
        assert!(!dac || !refused.is_empty() || period > 1);
    }
}
