//! Settings may change at any time of a hit. From one output to the next, the force then steps by at most 5 % of full
//! scale, in addition to the effect of position and velocity. The test runs guard, supervisor and a simulated device.
//! The firmware's own rules decide which commands are accepted.
//!
//! A twin gives the effect of position and velocity. The twin is a copy of sampler and supervisor from before the
//! change. The twin gets the same counts, and uses the old settings for one more output.

use host_sim::{
    plant::{Plant as _, PlantStep},
    scene::NamedScene,
};
use proptest::{
    prelude::*,
    test_runner::{RngAlgorithm, TestRng, TestRunner},
};
use zwidth::{
    CounterWidth, Design, LoopParameters, Motion, Sampler, Settings, VelocitySettings,
    WallSettings,
    console::{Command, Situation, allowed},
    experiment::Activity,
    safety::{
        FaultSet, Guard, GuardCommand, GuardedSampler, Inputs, Proposal, Rendered, Request, SLEW,
        SafetySettings, State, Supervisor,
    },
    telemetry::{Flags, Record},
    units::Force,
    velocity::{EstimatorName, Senses},
};

const GOOD: Inputs = Inputs {
    stop_closed: true,
    supply_good: true,
    settings_valid: true,
    halted: false,
    found: FaultSet::EMPTY,
};
/// Position of the wall at the start, in m, measured from the zero of the count.
const WALL_M: f64 = 0.004;

#[derive(Clone, Copy, Debug)]
enum Ask {
    Stiffness(f64),
    Damping(f64),
    Wall(f64),
    Cutoff(f64),
    Estimator(EstimatorName),
}

/// The device with sampler and supervisor.
#[derive(Clone)]
struct Loop {
    design: Design,
    settings: Settings,
    control: LoopParameters,
    sampler: GuardedSampler,
    guard: Guard,
    supervisor: Supervisor,
    down: GuardCommand,
    push: Force,
    plant: PlantStep,
    state: [f64; 2],
    force_n: f64,
    last: Option<Rendered>,
}

impl Loop {
    /// Armed, with the zero set at rest.
    fn armed() -> Self {
        let scene = NamedScene::load("paper-1um").unwrap().scene;
        let design = scene.design();
        let settings = Settings {
            velocity: VelocitySettings::Butterworth { cutoff_hz: 1500.0 },
            wall: WallSettings {
                position_m: WALL_M,
                stiffness_n_per_m: 8000.0,
                damping_n_s_per_m: 30.0,
                push_only: true,
            },
        };
        let safety = SafetySettings {
            speed_max_m_per_s: 1.0,
            speed_believable_m_per_s: 5.0,
            travel_low_m: -1.0,
            travel_high_m: 1.0,
            ramp_in_s: 0.2,
            sign_test_force: 0.05,
            sign_test_counts: 20,
            heaviest_mass_kg: 8.0,
            heaviest_damping_n_s_per_m: 110.0,
            passive_acceleration_m_per_s2: 0.0,
        };
        let plan = safety.build(&design).unwrap();
        let plant = PlantStep::new(&scene.device, 1.0 / design.rate_hz, 0.0);
        let rest_m = scene.device.rest_position_m;
        let counter = (rest_m / design.resolution_m).floor() as u32;
        let mut this = Self {
            design,
            settings,
            control: settings.build(&design).unwrap(),
            sampler: GuardedSampler::new(counter, CounterWidth::Bits32),
            supervisor: Supervisor::new(plan, None),
            guard: Guard::NOTHING,
            down: GuardCommand::start(&plan),
            push: Force::ZERO,
            state: plant.at_rest(rest_m),
            plant,
            force_n: 0.0,
            last: None,
        };
        this.run(20);
        this.supervisor.request(Request::Zero).unwrap();
        this.run(20);
        this.supervisor.request(Request::Arm).unwrap();
        this.run(3_500);
        assert_eq!(this.supervisor.status().state, State::Armed);
        this.push = Force::saturating_from_bits((0.48 * f64::from(1u32 << 30)) as i32);
        this
    }

    fn counter(&self) -> u32 {
        let counts = (self.plant.position_m(&self.state) / self.design.resolution_m).floor();
        (counts as i64) as u32
    }

    /// Runs one sample with this reading of the counter. Returns the output if one was due.
    fn control(&mut self, counter: u32) -> Option<Rendered> {
        let Self { sampler, control, down, guard, .. } = self;
        let step = sampler.step(control, counter, &Senses::NONE, down, guard);
        step.due.then(|| {
            let drive = self.control.render(step.report.motion, self.push);
            let asked = (Proposal { push: self.push, still: false }, drive);
            let rendered =
                self.supervisor.grant(&self.control, &step.report, &self.guard, asked, GOOD);
            self.down = self.supervisor.down();
            rendered
        })
    }

    fn sample(&mut self) -> (u32, Option<Rendered>) {
        let counter = self.counter();
        let rendered = self.control(counter);
        if let Some(rendered) = rendered {
            let force = rendered.grant.force().map_or(0, Force::bits);
            self.force_n = f64::from(force) / f64::from(1u32 << 30) * self.design.full_scale_n;
            self.last = Some(rendered);
        }
        self.state = self.plant.advance(&self.state, self.force_n);
        (counter, rendered)
    }

    fn run(&mut self, samples: u32) {
        for _ in 0..samples {
            self.sample();
        }
    }

    /// The settings that the firmware would use after this command. `None` if the firmware refuses the command now.
    fn ask(&self, ask: Ask) -> Option<Settings> {
        let mut settings = self.settings;
        let command = match ask {
            Ask::Stiffness(k) => {
                settings.wall.stiffness_n_per_m = k;
                Command::Stiffness(k)
            }
            Ask::Damping(b) => {
                settings.wall.damping_n_s_per_m = b;
                Command::Damping(b)
            }
            Ask::Wall(x) => {
                settings.wall.position_m = x;
                Command::Wall(x)
            }
            Ask::Cutoff(cutoff_hz) => {
                settings.velocity = VelocitySettings::Butterworth { cutoff_hz };
                Command::Cutoff(cutoff_hz)
            }
            Ask::Estimator(name) => {
                settings.velocity = name.following(&settings.velocity);
                Command::Estimator(name)
            }
        };
        let situation = Situation { status: self.supervisor.status(), activity: Activity::Hit };
        allowed(&command, &situation).ok().map(|()| settings)
    }
}

fn ask() -> impl Strategy<Value = Ask> {
    prop_oneof![
        3 => (0.0f64..5.3).prop_map(|log| Ask::Stiffness(10f64.powf(log))),
        3 => (0.0f64..3.5).prop_map(|log| Ask::Damping(10f64.powf(log))),
        1 => (-0.001f64..0.008).prop_map(Ask::Wall),
        2 => (0.0f64..1.0).prop_map(|part| Ask::Cutoff(10.0 * 370f64.powf(part))),
        1 => proptest::sample::select(EstimatorName::ALL).prop_map(Ask::Estimator),
    ]
}

/// Numbers of events that have occurred. They show that the test has covered these events.
#[derive(Debug, Default)]
struct Seen {
    changes: u32,
    in_contact: u32,
    large: u32,
    refused: u32,
    refused_late: u32,
}

/// Runs a hit of 0.3 s with changes at these samples. Each change takes effect some samples after it was accepted.
/// Compares each output with the twin's output.
fn hit(start: &Loop, changes: &[(u32, u32, Ask)], seen: &mut Seen) -> Result<(), TestCaseError> {
    let mut real = start.clone();
    let mut twin = real.clone();
    let mut waiting: Option<(u32, Settings)> = None;
    for n in 0..3_000u32 {
        for &(_, delay, ask) in changes.iter().filter(|(at, ..)| *at == n) {
            match real.ask(ask) {
                Some(settings) if waiting.is_none() => waiting = Some((n + delay, settings)),
                Some(_) => {}
                None => seen.refused += 1,
            }
        }
        if let Some((_, settings)) = waiting.take_if(|(at, _)| *at <= n) {
            let control = settings.build(&real.design).unwrap().after(&real.control);
            if real.supervisor.may_change(&real.control, &control).is_ok() {
                (real.settings, real.control) = (settings, control);
                seen.changes += 1;
                seen.in_contact +=
                    u32::from(real.last.unwrap().record.flags.contains(Flags::CONTACT));
            } else {
                seen.refused_late += 1;
            }
        }
        let before = real.last.unwrap().record;
        if !before.flags.contains(Flags::CONTACT) {
            // Outside the wall a new estimate causes no force. When the handle reaches the wall, the velocity of the
            // new estimator is used.
            (twin.sampler, twin.down) = (real.sampler, real.down);
            twin.control.estimator = real.control.estimator;
        }
        let (counter, rendered) = real.sample();
        let kept = twin.control(counter);
        let (Some(rendered), Some(kept)) = (rendered, kept) else { continue };
        let twin_contact = kept.record.flags.contains(Flags::CONTACT);
        let force =
            |rendered: &Rendered| rendered.grant.force().map(|force| i64::from(force.bits()));
        let (Some(now), Some(kept)) = (force(&rendered), force(&kept)) else {
            // A fault has switched the force off. Then the step of the force does not come from a change.
            prop_assert!(rendered.record.fault != 0);
            return Ok(());
        };
        // If a correction was fading before, it has also faded in the twin, by up to this value.
        let fading = if before.flags.contains(Flags::CHANGING) { i64::from(SLEW) } else { 0 };
        // If a wall was removed before the handle reached it, the removed wall gives no force. The force continues from
        // its last value.
        let gone = twin_contact && !rendered.record.flags.contains(Flags::CONTACT);
        let kept = if gone { i64::from(before.force.bits()) } else { kept };
        let step = (now - kept).abs();
        prop_assert!(step <= i64::from(SLEW) + fading, "{step} at sample {n}: {changes:?}");
        let Record { sample, position, velocity, .. } = rendered.record;
        let motion = Motion { sample, position, velocity };
        let asked = i64::from(real.control.render(motion, real.push).force.bits());
        seen.large += u32::from((asked - kept).abs() > i64::from(SLEW));
        twin = real.clone();
    }
    Ok(())
}

#[test]
fn no_change_at_any_instant_of_a_hit_makes_the_force_step() {
    let start = Loop::armed();
    let seen = std::cell::RefCell::new(Seen::default());
    let changes = prop::collection::vec((0u32..3_000, 0u32..25, ask()), 1..40);
    let mut runner = TestRunner::new(ProptestConfig {
        cases: 400,
        failure_persistence: None,
        ..ProptestConfig::default()
    });
    runner.run(&changes, |changes| hit(&start, &changes, &mut seen.borrow_mut())).unwrap();
    let seen = seen.into_inner();
    println!("{seen:?}");
    assert!(seen.changes > 1_000 && seen.in_contact > 300 && seen.large > 300 && seen.refused > 50);
    assert!(seen.refused_late > 5);
}

/// A wide filter follows every flicker of the counts. A very narrow filter must not treat the slope of the last flicker
/// as an acceleration. The narrow filter must start from the velocity.
#[test]
fn a_very_low_cutoff_does_not_go_on_from_the_slope_of_a_high_one() {
    let deviation = |restarted: bool| {
        let mut real = Loop::armed();
        let speed = 8.4f64; // counts per sample
        let begin = real.counter();
        let mut largest: f64 = 0.0;
        for n in 0..60_000u32 {
            if n == 2_003 {
                real.settings.velocity = VelocitySettings::Butterworth { cutoff_hz: 0.4 };
                let control = real.settings.build(&real.design).unwrap();
                real.control = if restarted { control.after(&real.control) } else { control };
            }
            let counter = begin.wrapping_add((f64::from(n) * speed).floor() as u32);
            let Loop { sampler, control, down, guard, .. } = &mut real;
            down.rendered = n.wrapping_sub(1) / 10 * 10; // every output is in time
            let step = sampler.step(control, counter, &Senses::NONE, down, guard);
            if n > 1_000 {
                let velocity = f64::from(step.report.motion.velocity.bits()) / 65_536.0;
                largest = largest.max((velocity - speed).abs());
            }
        }
        largest
    };
    let (restarted, not) = (deviation(true), deviation(false));
    println!("largest deviation {restarted} counts per sample, {not} without a new start");
    assert!(restarted < 1.0 && not > 50.0, "{restarted} {not}");
}

/// The cutoff changes at constant speed. The filter's state is kept, so the velocity continues.
#[test]
fn a_new_cutoff_keeps_the_state_of_the_filter() {
    let mut real = Loop::armed();
    let speed = 120.25f64; // counts per sample
    let begin = real.counter();
    let counter = |n: u32| begin.wrapping_add((f64::from(n) * speed).floor() as u32);
    let velocity = |real: &mut Loop, n: u32| {
        let Loop { sampler, control, down, guard, .. } = real;
        let step = sampler.step(control, counter(n), &Senses::NONE, down, guard);
        f64::from(step.report.motion.velocity.bits()) / 65_536.0
    };
    let mut largest: f64 = 0.0;
    for n in 0..40_000u32 {
        if n % 400 == 399 {
            let cutoff_hz = [1500.0, 100.0, 4000.0, 300.0, 2500.0][(n / 400 % 5) as usize];
            real.settings.velocity = VelocitySettings::Butterworth { cutoff_hz };
            real.control = real.settings.build(&real.design).unwrap();
        }
        let velocity = velocity(&mut real, n);
        if n > 4_000 {
            largest = largest.max((velocity - speed).abs());
        }
    }
    // The remaining deviation is the flicker of the counts, one count per sample. A wide filter passes this flicker. A
    // narrow filter that follows keeps the flicker in its state.
    println!("largest deviation {largest} of {speed} counts per sample");
    assert!(largest < 2.0, "{largest}");
}

/// Draws an estimator that uses only the position, with any tuning that is fast enough for a hand.
fn tuned() -> impl Strategy<Value = VelocitySettings> {
    let names: Vec<_> =
        EstimatorName::ALL.iter().copied().filter(|name| name.sense().is_none()).collect();
    (proptest::sample::select(names), 0.0f64..1.0).prop_map(|(name, part)| {
        let defaults = name.defaults();
        let between = |low: f64, high: f64| low * (high / low).powf(part);
        let Some((parameter, default)) = defaults.tuning() else { return defaults };
        let value = match parameter.unit {
            "Hz" => between(2.0, 2400.0),
            "samples" => between(2.0, 32.0).round(),
            _ => default * between(0.3, 30.0),
        };
        // A value that an estimator does not accept is replaced by the nearest accepted value.
        let design = NamedScene::load("paper-1um").unwrap().scene.design();
        let allowed = defaults.with_tuning(f64::NAN).build(&design).unwrap_err().range;
        defaults.with_tuning(value.clamp(*allowed.start(), *allowed.end()))
    })
}

/// Overshoot of an estimator after a step of speed, as a multiple of the speed. Returns also the delay after a step of
/// acceleration, in samples. The delay is the largest error minus one count, divided by the acceleration.
fn swings(control: &LoopParameters) -> [f64; 2] {
    const SPEED: f64 = 100.0;
    const ACCELERATION: f64 = 0.1;
    let most = |samples: u32, position: fn(f64) -> f64, truly: fn(f64) -> f64| {
        let mut sampler = Sampler::new(0, CounterWidth::Bits32);
        let off = |n| {
            let count = (position(f64::from(n)).floor() as i64) as u32;
            let velocity = f64::from(sampler.sample(control, count).motion.velocity.bits());
            (velocity / 65_536.0 - truly(f64::from(n))).abs()
        };
        (0..samples).map(off).fold(0.0, f64::max)
    };
    let step = most(20_000, |n| SPEED * n, |_| 0.0);
    let ramp = most(4_000, |n| ACCELERATION * n * n / 2.0, |n| ACCELERATION * n);
    [(step / SPEED).max(1.0), (ramp - 1.0).max(0.0) / ACCELERATION]
}

/// A new estimator during a motion starts as if the handle had always moved at the old estimator's last velocity. So
/// the error of the new estimator has three parts. The first part is the error that the new estimator would have if it
/// had always run. The second part is the response to two differences: the error of the old estimator, and the error of
/// the new estimator. This response fades, and swings as after a step of speed. The third part comes from the
/// acceleration, which the new estimator does not know yet. The change adds no further error.
#[test]
fn an_exchanged_estimator_is_as_good_as_one_that_has_always_run() {
    const WARM_UP: u32 = 40_000;
    const AFTER: u32 = 4_000;
    let design = NamedScene::load("paper-1um").unwrap().scene.design();
    let worst = std::cell::Cell::new(0f64);
    let motions = (tuned(), tuned(), -4.0f64..1.4, 0.0f64..6.3, 1.0f64..60.0);
    let config =
        ProptestConfig { cases: 1000, failure_persistence: None, ..ProptestConfig::default() };
    let random = TestRng::deterministic_rng(RngAlgorithm::ChaCha);
    let mut runner = TestRunner::new_with_rng(config, random);
    let check =
        |(old, new, log_hz, phase, speed): (VelocitySettings, VelocitySettings, f64, f64, f64)| {
            let omega = std::f64::consts::TAU * f64::exp(log_hz) / design.rate_hz;
            let position = |n: f64| speed / omega * (omega * n + phase).sin();
            let truly = |n: f64| speed * (omega * n + phase).cos();
            let controls = [old, new].map(|velocity| {
                let wall = WallSettings {
                    position_m: WALL_M,
                    stiffness_n_per_m: 0.0,
                    damping_n_s_per_m: 0.0,
                    push_only: true,
                };
                Settings { velocity, wall }.build(&design).unwrap()
            });
            let count = |n: u32| (position(f64::from(n)).floor() as i64) as u32;
            let mut exchanged = Sampler::new(count(0), CounterWidth::Bits32);
            let mut always = exchanged;
            let controls = [controls[0], controls[1].after(&controls[0])];
            let (mut before, mut most, mut usual) = (0f64, 0f64, 0f64);
            for n in 1..WARM_UP + AFTER {
                let control = &controls[usize::from(n >= WARM_UP)];
                let off = |sampler: &mut Sampler, control: &LoopParameters| {
                    let velocity = sampler.sample(control, count(n)).motion.velocity;
                    (f64::from(velocity.bits()) / 65_536.0 - truly(f64::from(n))).abs()
                };
                let (own, warm) = (off(&mut exchanged, control), off(&mut always, &controls[1]));
                if n + 1 == WARM_UP {
                    before = own;
                }
                if n + AFTER >= WARM_UP {
                    usual = usual.max(warm);
                }
                if n >= WARM_UP {
                    most = most.max(own);
                }
            }
            let [step, ramp] = swings(&controls[1]);
            let stated = usual + step * (usual + before) + ramp * speed * omega + 1.0;
            worst.set(worst.get().max(most / stated));
            prop_assert!(most <= stated, "{most}, {usual}, {before}, {step}, {ramp}");
            Ok(())
        };
    runner.run(&motions, check).unwrap();
    println!("at most {:.3} of what both are off by, and a count", worst.get());
}
