//! Properties of the force that supervisor, wall, gain fade, ramp and output give together.

use proptest::prelude::*;
use zwidth::{
    Design, LoopParameters, Output, VelocitySettings, WallSettings,
    experiment::DutySettings,
    safety::{FaultSet, Inputs, OutputCommand, Rendered, Request, SLEW, State},
    units::Force,
};

use crate::{
    any::{self, Random},
    orders::Orders,
    rig::{GOOD, NO_WALL, Rig, control, wide},
    stated::{LSB, stated},
};

/// Designs that the supervisor accepts: their output period is at most 12.5 ms.
fn design() -> impl Strategy<Value = Design> + Clone {
    any::design().prop_map(|design| {
        let most = (0.0125 * design.rate_hz).floor() as u32;
        Design { period: design.period.min(most), ..design }
    })
}

/// An event after an output.
#[derive(Clone, Copy, Debug)]
enum Event {
    /// The handle stays for this number of outputs.
    Wait(u8),
    /// The handle moves. The first number is the counts per output, the second the number of outputs.
    Move(i32, u8),
    /// A new wall: K and B as fractions of their ranges, the distance from the handle to the surface in counts, and
    /// whether the wall only pushes.
    Wall(f64, f64, Option<i32>, bool),
    /// The wall stays, but K and B change to these fractions of their ranges.
    Gains(f64, f64),
    /// The push of the experiment, in LSB of the force.
    Push(i32),
    /// Another estimator, by its index in the list and its parameters.
    Estimator(usize, any::Parts),
    Ask(Request),
    Inputs(Inputs),
}

fn event(moves: bool) -> impl Strategy<Value = Event> {
    let surface = prop::option::weighted(0.5, prop_oneof![-300i32..300, -20i32..20]);
    let requests = vec![
        Request::Arm,
        Request::Disarm,
        Request::Clear,
        Request::Zero,
        Request::Zero,
        Request::Zero,
        Request::Unlock,
        Request::Turn,
        Request::Stall(true),
        Request::Stall(false),
    ];
    prop_oneof![
        4 => (1u8..40).prop_map(Event::Wait),
        if moves { 6 } else { 0 } => (prop_oneof![-3i32..=3, -400i32..=400], 1u8..10)
            .prop_map(|(counts, outputs)| Event::Move(counts, outputs)),
        3 => (any::part(), any::part(), surface, any::<bool>())
            .prop_map(|(k, b, surface, push_only)| Event::Wall(k, b, surface, push_only)),
        3 => (any::part(), any::part()).prop_map(|(k, b)| Event::Gains(k, b)),
        2 => (-(1i32 << 30)..=1 << 30).prop_map(Event::Push),
        1 => (any::<usize>(), any::parts()).prop_map(|(place, parts)| Event::Estimator(place, parts)),
        2 => prop::sample::select(requests).prop_map(Event::Ask),
    ]
}

fn trouble() -> impl Strategy<Value = Event> {
    let mostly = |likely| prop::bool::weighted(likely);
    let inputs = (mostly(0.9), mostly(0.9), mostly(0.9), mostly(0.1)).prop_map(
        |(stop_closed, supply_good, settings_valid, halted)| {
            Event::Inputs(Inputs { stop_closed, supply_good, settings_valid, halted, found: FaultSet::EMPTY })
        },
    );
    prop_oneof![5 => event(true), 1 => inputs, 1 => Just(Event::Inputs(GOOD)), 1 => Just(Event::Ask(Request::Arm))]
}

/// A rig, and the settings in force on it.
struct Bench {
    rig: Rig,
    velocity: VelocitySettings,
    wall: WallSettings,
    push_only: bool,
    /// Number of accepted changes of the settings.
    changes: u32,
}

impl Bench {
    fn new(design: Design, push_only: bool) -> Self {
        let velocity = VelocitySettings::Difference {};
        let plan = wide(&design).build(&design).unwrap();
        let control = control(&design, velocity, NO_WALL).unwrap();
        Self { rig: Rig::new(design, plan, control), velocity, wall: NO_WALL, push_only, changes: 0 }
    }

    fn armed(design: Design, push_only: bool) -> Self {
        let mut bench = Self::new(design, push_only);
        bench.rig = bench.rig.armed();
        bench
    }

    /// K and B at these fractions of their ranges. A range goes from full scale in 10^4 counts to full scale in one
    /// count.
    fn gains(&self, k: f64, b: f64) -> [f64; 2] {
        let design = &self.rig.design;
        let unit = design.full_scale_n / design.resolution_m;
        let gain = |part: f64, low: f64, high: f64| if part == 0.0 { 0.0 } else { any::between(low, high, part) };
        let k = gain(k, 1e-4 * unit, unit).min(1e7);
        [k, gain(b, 1e-3 * unit / design.rate_hz, 10.0 * unit / design.rate_hz).min(1e4)]
    }

    fn put(&mut self, velocity: VelocitySettings, wall: WallSettings) {
        let Some(control) = control(&self.rig.design, velocity, wall) else { return };
        if self.rig.change(control).is_ok() {
            (self.velocity, self.wall) = (velocity, wall);
            self.changes += 1;
        }
    }

    /// Carries out an event. Returns the number of outputs that follow, and the handle's motion before each of these
    /// outputs, in counts.
    fn happen(&mut self, event: Event) -> (u8, i32) {
        match event {
            Event::Wait(outputs) => return (outputs, 0),
            Event::Move(counts, outputs) => return (outputs, counts),
            Event::Wall(k, b, surface, push_only) => {
                let [stiffness_n_per_m, damping_n_s_per_m] = self.gains(k, b);
                let position_m = surface.map_or(self.wall.position_m, |away| {
                    (f64::from(self.rig.position()) + f64::from(away)) * self.rig.design.resolution_m
                });
                let push_only = push_only || self.push_only;
                let wall = WallSettings { position_m, stiffness_n_per_m, damping_n_s_per_m, push_only };
                self.put(self.velocity, wall);
            }
            Event::Gains(k, b) => {
                let [stiffness_n_per_m, damping_n_s_per_m] = self.gains(k, b);
                self.put(self.velocity, WallSettings { stiffness_n_per_m, damping_n_s_per_m, ..self.wall });
            }
            Event::Push(bits) => self.rig.push = Force::saturating_from_bits(bits),
            Event::Estimator(place, parts) => {
                let names = zwidth::velocity::EstimatorName::ALL;
                if let Some(velocity) = any::tuned(names[place % names.len()], parts, &self.rig.design) {
                    self.put(velocity, self.wall);
                }
            }
            Event::Ask(request) => {
                let before = self.rig.supervisor.status();
                if self.rig.ask(request).is_err() {
                    assert_eq!(self.rig.supervisor.status(), before, "a refusal changes nothing");
                }
            }
            Event::Inputs(inputs) => self.rig.inputs = inputs,
        }
        (0, 0)
    }
}

/// The code of a force as the documentation gives it. The code is nearest to the force's fraction of full scale, and
/// halves are rounded away from zero.
fn code(output: Output, force: Force) -> i64 {
    let (zero, full) = match output {
        Output::Continuous => return force.bits().into(),
        Output::Dac { bits } => (1i64 << (bits - 1), (1i64 << (bits - 1)) - 1),
        Output::Pwm { steps } => (0, i64::from(steps)),
    };
    let size = i64::from(force.bits().abs()) * full;
    let whole = size >> 30;
    let up = i64::from(size - (whole << 30) >= 1 << 29);
    zero + i64::from(force.bits().signum()) * (whole + up)
}

fn check(bench: &Bench, rendered: &Rendered) {
    let status = bench.rig.supervisor.status();
    let output = bench.rig.design.output;
    let record = &rendered.record;
    match rendered.grant {
        OutputCommand::On(granted) => {
            assert!(status.state.is_on() && bench.rig.inputs == GOOD, "force in {:?}", status.state);
            assert_eq!((granted.force(), granted.command()), (record.force, record.command));
            assert!(granted.force().bits().abs() <= 1 << 30);
            assert!(status.state != State::SignTest || granted.force().bits().abs() <= SLEW);
        }
        OutputCommand::Off => {
            assert!(!status.state.is_on(), "no force in {:?}", status.state);
            assert_eq!(record.force, Force::ZERO);
        }
    }
    assert_eq!(i64::from(record.command.code()), code(output, record.force));
}

crate::properties! {
    /// After any changes, requests, motions and inputs, the force is within full scale. The output code is the code
    /// nearest to this force. While the supervisor is off, the force is 0 and the code is the code of 0. In the sign
    /// test the force is at most 5 % of full scale.
    within_full_scale(150, (design, push_only, events) in (
        design(),
        any::<bool>(),
        prop::collection::vec(trouble(), 1..60),
    )) {
        let mut bench = Bench::armed(design, push_only);
        for event in events {
            let (outputs, counts) = bench.happen(event);
            for _ in 0..outputs.max(1) {
                bench.rig.count += i64::from(counts);
                let rendered = bench.rig.output();
                check(&bench, &rendered);
            }
        }
    }

    /// Compares two outputs with the handle at the same position and speed. The force steps by at most 5 % of full
    /// scale per millisecond, or per output if outputs are rarer. This holds for any change, zero and arming. Switching
    /// off is the exception.
    slew(250, (design, armed, events) in (
        design(),
        any::<bool>(),
        prop::collection::vec(event(true), 1..60),
    )) {
        // A wall that no longer pulls gives up its force at once. No settings on a board allow this.
        let mut bench = Bench::new(design, true);
        if armed {
            bench.rig = bench.rig.armed();
        } else {
            bench.rig.pass_sign_test();
        }
        let mut last = (bench.rig.output(), bench.rig.count);
        for event in events {
            let (outputs, counts) = bench.happen(event);
            for _ in 0..outputs.max(1) {
                bench.rig.count += i64::from(counts);
                let tests = bench.rig.state() == State::SignTest;
                let now = (bench.rig.output(), bench.rig.count);
                check(&bench, &now.0);
                let moves = last.0.record.velocity != now.0.record.velocity;
                let same = last.1 == now.1 && !moves;
                if let Some(force) = now.0.grant.force().filter(|_| same) {
                    // Off means no force.
                    let before = last.0.grant.force().unwrap_or_default();
                    let step = i64::from(force.bits()) - i64::from(before.bits());
                    // The sign test, which may end here, has a single step within a millisecond.
                    let ms = f64::from(design.period) / design.rate_hz * 1e3;
                    let most = if tests { 1.0 } else { ms.min(1.0) } * f64::from(SLEW);
                    assert!(step.abs() <= most as i64 + 2, "{step} of {most} in {:?}", bench.rig.state());
                }
                last = now;
            }
        }
    }

    /// While the force is on, no request and no change of settings puts a wall at the handle's position, even directly
    /// after a zero. The force is not switched on inside a wall.
    no_wall_on_the_handle(250, (design, place, events) in (
        design(),
        prop::option::of(-300i64..300),
        prop::collection::vec((any::<bool>(), event(false)), 1..40),
    )) {
        let mut bench = Bench::new(design, false);
        match place {
            // The force is off. To pass the sign test, the handle would have to move. But the sign test may begin.
            Some(place) => {
                bench.rig.output();
                bench.rig.count += place;
                bench.rig.output();
            }
            None => bench.rig = bench.rig.armed(),
        }
        for (zero, event) in events {
            if zero {
                bench.happen(Event::Ask(Request::Zero));
            }
            let (outputs, _) = bench.happen(event);
            for _ in 0..outputs.max(1) {
                bench.rig.output();
                let status = bench.rig.supervisor.status();
                assert!(!(status.state.is_on() && status.contact), "in contact, {:?}", status.state);
            }
        }
    }

    /// A wall that only pushes never pulls. Without a push no force points into the wall, for any change and fade of
    /// gains, and any motion of the handle. With a push, no force exceeds the push.
    never_pulls(250, (design, push, events) in (
        design(),
        prop_oneof![2 => Just(0i32), 1 => 0i32..=1 << 30],
        prop::collection::vec(event(true), 1..60),
    )) {
        let mut bench = Bench::armed(design, true);
        bench.rig.push = Force::saturating_from_bits(push);
        // A push rises by 5 % per output.
        for _ in 0..25 {
            bench.rig.output();
        }
        for event in events {
            if matches!(event, Event::Push(_) | Event::Ask(Request::Arm)) {
                continue;
            }
            let (outputs, counts) = bench.happen(event);
            for _ in 0..outputs.max(1) {
                bench.rig.count += i64::from(counts);
                let force = bench.rig.output().grant.force().unwrap_or_default();
                assert!(force.bits() <= push, "{force:?} into the wall, pushed with {push}");
            }
        }
    }

    /// The force of a wall is the force of its spring and damper in SI units, within a few parts in 10^9. At the
    /// surface, beyond full scale, and where the wall would pull, the force follows the documentation.
    spring_and_damper(1500, (design, k, b, push_only, depth, speed, push, surface) in (
        any::design(),
        any::part(),
        any::part(),
        any::<bool>(),
        prop_oneof![-3i32..=3, -100_000i32..100_000],
        prop_oneof![Just(0i32), -200_000i32..200_000],
        -(1i32 << 30)..=1 << 30,
        -1_000_000i32..1_000_000,
    )) {
        let wall = WallSettings {
            position_m: f64::from(surface) * design.resolution_m,
            stiffness_n_per_m: any::between(0.0, 1e7, k),
            damping_n_s_per_m: any::between(0.0, 1e4, b),
            push_only,
        };
        let Some(control) = control(&design, VelocitySettings::Difference {}, wall) else { return Ok(()) };
        let motion = zwidth::Motion {
            sample: 0,
            position: zwidth::units::Position::from_counts(surface + depth),
            velocity: zwidth::units::Velocity::saturating_from_bits(speed),
        };
        let push = Force::saturating_from_bits(push);
        let drive = control.render(motion, push);
        let metres = f64::from(depth) * design.resolution_m;
        let metres_per_s = f64::from(speed) / LSB * design.resolution_m * design.rate_hz;
        let [spring, damper] = [wall.stiffness_n_per_m * metres, wall.damping_n_s_per_m * metres_per_s];
        let mut back = spring + damper;
        if push_only {
            back = back.max(0.0);
        }
        let asked = f64::from(push.bits()) / f64::from(1 << 30) - if depth > 0 { back / design.full_scale_n } else { 0.0 };
        let given = f64::from(drive.force.bits()) / f64::from(1 << 30);
        let error = 2e-9 + 1e-9 * (spring.abs() + damper.abs()) / design.full_scale_n;
        assert!((given - asked.clamp(-1.0, 1.0)).abs() <= error, "{given} for {asked}");
        assert_eq!(drive.contact, depth > 0);
        let clear = (asked.abs() - 1.0).abs() > error;
        assert!(!clear || drive.saturated == (asked.abs() > 1.0), "{asked}");
        let code_of = |force| i64::from(control.actuator.command(force).code());
        assert_eq!(code_of(drive.force), code(design.output, drive.force));
        // Odd symmetry: the code of the opposite force is at the same distance from the code of 0.
        let opposite = Force::saturating_from_bits(-drive.force.bits());
        let zero = i64::from(control.actuator.zero().code());
        assert_eq!(code_of(opposite) - zero, zero - code_of(drive.force));
    }

    /// If an estimator gets a new tuning at any time, the estimator restarts before the new tuning runs. The velocity
    /// jumps at most by the limit of docs/estimators.md for a restart.
    restarts_first(150, (design, names, pieces, at, seed) in (
        design(),
        prop::collection::vec((any::estimator(), any::parts()), 2..6),
        prop_oneof![any::motion(2000.0), any::motion(3.0)],
        prop::collection::vec(1u16..300, 1..6),
        any::<u64>(),
    )) {
        let mut tuned = names.into_iter().filter_map(|(name, parts)| any::tuned(name, parts, &design));
        let Some(first) = tuned.next() else { return Ok(()) };
        let loop_of = |velocity| control(&design, velocity, NO_WALL).unwrap();
        let duty = DutySettings { continuous_force_n: design.full_scale_n, time_constant_s: 30.0 };
        let Ok(duty) = duty.build(&design, 1) else { return Ok(()) };
        let mut orders = Orders::new(wide(&design).build(&design).unwrap(), duty, loop_of(first));
        let mut random = Random(seed);
        let counts: Vec<i64> = any::counts(&pieces);
        let mut waits = at.into_iter();
        let mut wait = waits.next();
        let (mut order, mut asked) = (None::<LoopParameters>, None);
        let (mut velocity, mut last) = (0.0, 0);
        // The motion forward, then backward. So the motion continues while the settings change.
        for count in counts.iter().chain(counts.iter().rev()) {
            let senses = zwidth::velocity::Senses { edge: None, ..random.senses() };
            let before = *orders.control();
            let report = orders.sample(*count, &senses, &mut order);
            let now = f64::from(report.motion.velocity.bits()) / LSB;
            if let Some(next) = asked
                && *loop_of(next).estimator == *before.estimator
            {
                asked = None;
                // While the force is off, the estimator knows no force.
                let known = zwidth::velocity::Senses { force: Force::ZERO, ..senses };
                let says = stated(&next, &design).jump(velocity, (count - last) as f64, &known);
                let jump = (now - velocity).abs();
                assert!(jump <= says, "{next:?}: {jump} for {says}, from {velocity}");
            }
            (velocity, last) = (now, *count);
            wait = wait.map(|wait| wait - 1);
            if wait == Some(0) {
                // Two tunings may be equal as integers. Then the estimator continues.
                let running = &before.estimator;
                if let Some(next) = tuned.next().filter(|next| *loop_of(*next).estimator != **running) {
                    (order, asked) = (Some(loop_of(next)), Some(next));
                }
                wait = waits.next();
            }
        }
    }
}
