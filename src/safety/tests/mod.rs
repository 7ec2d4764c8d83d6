//! Guard and supervisor together, as the tasks run them.

use super::{plan::tests::*, *};
use crate::{Control, CounterWidth, Settings, VelocitySettings, WallSettings, units::Force};
use std::{sync::OnceLock, vec::Vec};

mod random;

const GOOD: Inputs =
    Inputs { stop_closed: true, supply_good: true, settings_valid: true, halted: false };

fn control(position_m: f64, stiffness_n_per_m: f64) -> Control {
    let settings = Settings {
        velocity: VelocitySettings::Butterworth { cutoff_hz: 1500.0, prewarp: false },
        wall: WallSettings {
            position_m,
            stiffness_n_per_m,
            damping_n_s_per_m: 0.0,
            push_only: true,
        },
    };
    settings.build(&DESIGN).unwrap()
}

/// Both tasks, a motor and a handle: 0.4 kg, 5.5 N s/m, 5.906 N at full scale, 1 um, 10 kHz.
#[derive(Clone)]
struct Bench {
    control: Control,
    sampler: GuardedSampler,
    guard: Guard,
    supervisor: Supervisor,
    down: Down,
    push: Force,
    inputs: Inputs,
    /// Outputs that the rendering task misses from now on.
    missing: u32,
    /// Samples by which the next output comes late, and the one that is asked for.
    delay: u32,
    asked: Option<(u32, Step)>,
    /// The encoder does not count.
    dead: bool,
    /// A vice holds the handle.
    held: bool,
    /// Sign of the motor.
    motor: f64,
    position_m: f64,
    velocity_m_per_s: f64,
    offset: u32,
    /// What the hardware does: the last grant, unless the sampling task cut it.
    output: Option<Force>,
    last: Option<Rendered>,
    updates: Vec<MemoryUpdate>,
}

impl Bench {
    fn new() -> Self {
        let plan = SETTINGS.build(&DESIGN).unwrap();
        Self {
            control: control(0.01, 2000.0),
            sampler: GuardedSampler::new(5, CounterWidth::Bits32),
            supervisor: Supervisor::new(plan, None),
            guard: Guard::NOTHING,
            down: Down::start(&plan),
            push: Force::ZERO,
            inputs: GOOD,
            missing: 0,
            delay: 0,
            asked: None,
            dead: false,
            held: false,
            motor: 1.0,
            position_m: 0.0,
            velocity_m_per_s: 0.0,
            offset: 5,
            output: None,
            last: None,
            updates: Vec::new(),
        }
    }

    /// One sample; returns what the guard saw.
    fn sample(&mut self) -> Step {
        #[expect(clippy::cast_possible_truncation, reason = "a few metres at most")]
        let count = (self.position_m / 1e-6).floor() as i32;
        let counter = if self.dead { self.offset } else { self.offset.wrapping_add_signed(count) };
        let step = self.sampler.step(&self.control, counter, &self.down, &mut self.guard);
        if step.motion.due {
            if self.missing > 0 {
                self.missing -= 1;
            } else {
                self.asked = Some((std::mem::take(&mut self.delay), step));
            }
        }
        match &mut self.asked {
            Some((0, asked)) => {
                let Step { motion, present, .. } = *asked;
                let up = Up { motion, present, guard: self.guard };
                self.asked = None;
                let rendered = self.supervisor.render(&self.control, &up, self.push, self.inputs);
                self.output = rendered.grant.force();
                self.down = rendered.down;
                self.updates.extend(rendered.memory);
                self.last = Some(rendered);
            }
            Some((delay, _)) => *delay -= 1,
            None => {}
        }
        if step.cut {
            self.output = None;
        }
        let force = self.output.map_or(0.0, |f| f64::from(f.bits()) / 2f64.powi(30) * 5.906);
        let acceleration = (force * self.motor - 5.5 * self.velocity_m_per_s) / 0.4;
        if !self.held {
            self.velocity_m_per_s += acceleration * 1e-4;
            self.position_m += self.velocity_m_per_s * 1e-4;
        }
        step
    }

    fn run(&mut self, samples: u32) {
        for _ in 0..samples {
            self.sample();
        }
    }

    /// Samples until the output is off, at most 10 000.
    fn samples_until_off(&mut self) -> u32 {
        (1..=10_000)
            .find(|_| {
                self.sample();
                self.output.is_none()
            })
            .expect("the output stays on")
    }

    fn ask(&mut self, request: Request) -> Result<(), Refusal> {
        let result = self.supervisor.request(request);
        self.down = self.supervisor.down(); // at once, as the rendering task does
        result
    }

    fn state(&self) -> State {
        self.supervisor.status().state
    }

    fn fault(&self) -> Option<Fault> {
        self.supervisor.status().fault.map(|record| record.fault)
    }

    /// Zeroed, armed, ramp over; once for all tests, because it takes Miri many seconds.
    fn armed() -> Self {
        static ARMED: OnceLock<Bench> = OnceLock::new();
        let bench = ARMED.get_or_init(|| {
            let mut bench = Self::new();
            bench.run(1);
            bench.ask(Request::Zero).unwrap();
            bench.run(20);
            bench.ask(Request::Arm).unwrap();
            bench.run(4000);
            assert_eq!(bench.state(), State::Armed);
            bench
        });
        bench.clone()
    }

    /// After a fault: clear, then arm again.
    fn recover(&mut self) {
        self.ask(Request::Clear).unwrap();
        self.run(20);
        assert_eq!((self.state(), self.output), (State::Off, None));
        if !self.supervisor.status().zeroed {
            assert_eq!(self.ask(Request::Arm), Err(Refusal::NotZeroed));
            self.ask(Request::Zero).unwrap();
        }
        self.ask(Request::Arm).unwrap();
        self.run(4000);
        assert_eq!(self.state(), State::Armed);
    }
}

#[test]
fn arm_tests_the_sign_then_ramps_in() {
    let mut bench = Bench::new();
    bench.run(1);
    assert_eq!(bench.ask(Request::Arm), Err(Refusal::NotZeroed));
    bench.ask(Request::Zero).unwrap();
    bench.run(20);
    assert_eq!(bench.last.unwrap().record.position.counts(), 0);
    bench.push = Force::saturating_from_bits(1 << 28);
    bench.control = control(1.0, 2000.0); // out of reach
    bench.ask(Request::Arm).unwrap();
    assert_eq!(bench.ask(Request::Arm), Err(Refusal::AlreadyOn));
    let (mut forces, mut states) = (Vec::new(), Vec::new());
    for _ in 0..400 {
        bench.run(10);
        forces.push(bench.output.unwrap().bits());
        states.push(bench.state());
    }
    let count = |state| states.iter().filter(|s| **s == state).count();
    assert_eq!((count(State::SignTest), count(State::RampIn)), (100, 200));
    assert!(forces[..100].iter().all(|force| force.abs() <= SLEW));
    assert!(forces.windows(2).all(|pair| (pair[1] - pair[0]).abs() <= SLEW));
    assert_eq!(forces[399], 1 << 28);
    let armed = FaultRecord::bare(Fault::ResetWhileArmed);
    assert_eq!(bench.updates, [MemoryUpdate::Write(armed)]);
    bench.ask(Request::Disarm).unwrap();
    bench.run(10);
    assert_eq!((bench.state(), bench.output), (State::Off, None));
    assert_eq!(bench.updates[1..], [MemoryUpdate::Erase]);
}

#[test]
#[cfg_attr(miri, ignore = "arms four times in closed loop")]
fn a_turned_motor_and_a_dead_encoder_do_not_get_past_arm() {
    for (motor, dead) in [(-1.0, false), (1.0, true)] {
        let mut bench = Bench::new();
        (bench.motor, bench.dead) = (motor, dead);
        bench.run(1);
        bench.ask(Request::Zero).unwrap();
        bench.run(20);
        bench.ask(Request::Arm).unwrap();
        bench.run(11);
        assert!(bench.samples_until_off() <= 1010);
        assert_eq!(bench.fault(), Some(Fault::SignTestFailed));
        assert!(!bench.supervisor.status().zeroed);
        (bench.motor, bench.dead) = (1.0, false);
        bench.recover();
    }
}

#[test]
fn a_count_jump_is_off_with_the_same_sample() {
    let mut bench = Bench::armed();
    bench.offset = bench.offset.wrapping_add(600);
    let step = bench.sample();
    assert!(step.present.contains(Fault::CountJump) && bench.output.is_none());
    // and stays off by the sampling task alone, whatever rendering writes meanwhile
    for _ in 0..50 {
        let step = bench.sample();
        assert!(step.cut || step.motion.due);
    }
    let status = bench.supervisor.status();
    let record = status.fault.unwrap();
    assert_eq!((record.fault, record.sample), (Fault::CountJump, step.motion.sample));
    assert!(!status.zeroed);
    assert_eq!(bench.updates.last(), Some(&MemoryUpdate::Write(record)));
    assert_eq!(bench.ask(Request::Arm), Err(Refusal::Faulted(Fault::CountJump)));
    bench.recover();
    assert!(!bench.sample().cut);
}

#[test]
fn arm_is_refused_in_the_wall_whether_wall_or_handle_went_there() {
    let mut bench = Bench::new();
    bench.held = true;
    bench.run(1);
    bench.ask(Request::Zero).unwrap();
    bench.run(20);
    bench.control = control(-0.01, 2000.0);
    bench.run(20);
    assert_eq!(bench.ask(Request::Arm), Err(Refusal::Contact));
    bench.control = control(0.01, 2000.0);
    bench.run(20);
    bench.held = false;
    bench.ask(Request::Arm).unwrap();
}

/// With a cutoff of 0.5 Hz the estimate knows nothing of a fast handle for a long time.
#[test]
fn high_speed_is_found_from_the_counts_whatever_the_cutoff() {
    let mut bench = Bench::armed();
    let settings = Settings {
        velocity: VelocitySettings::Butterworth { cutoff_hz: 0.5, prewarp: false },
        wall: WallSettings {
            position_m: 1.0,
            stiffness_n_per_m: 0.0,
            damping_n_s_per_m: 0.0,
            push_only: true,
        },
    };
    bench.control = settings.build(&DESIGN).unwrap();
    bench.run(200);
    bench.velocity_m_per_s = 1.5;
    assert!(bench.samples_until_off() <= 20, "one output period and what is left of the last");
    assert_eq!(bench.fault(), Some(Fault::OverSpeed));
}

#[test]
fn high_speed_is_a_fault_with_force_and_none_without() {
    let mut bench = Bench::new();
    bench.velocity_m_per_s = 1.5;
    bench.run(100);
    assert_eq!(bench.fault(), None);
    let mut bench = Bench::armed();
    bench.velocity_m_per_s = 1.5;
    assert!(bench.samples_until_off() <= 10); // the estimate follows within the filter's delay
    bench.run(10);
    assert_eq!(bench.fault(), Some(Fault::OverSpeed));
    bench.velocity_m_per_s = 0.0;
    bench.run(100);
    bench.recover();
}

#[test]
fn out_of_range_needs_a_zero_before_clear() {
    let mut bench = Bench::new();
    bench.offset = (1 << 30) + 1;
    bench.sampler = GuardedSampler::new(bench.offset, CounterWidth::Bits32);
    bench.run(20);
    assert_eq!(bench.fault(), Some(Fault::OutOfRange));
    assert_eq!(bench.ask(Request::Clear), Err(Refusal::CausePresent(Fault::OutOfRange)));
    bench.ask(Request::Zero).unwrap();
    bench.run(20);
    bench.recover();
}

#[test]
fn a_missing_output_is_off_when_the_next_is_due_and_a_stuck_task_is_named() {
    let mut bench = Bench::armed();
    while !bench.sample().motion.due {}
    bench.missing = 1; // this one is lost; found at the due sample after it
    assert_eq!(bench.samples_until_off(), 20);
    bench.run(20);
    assert_eq!(bench.fault(), Some(Fault::LateRender));
    bench.recover();
    while !bench.sample().motion.due {}
    bench.missing = 30;
    assert_eq!(
        bench.samples_until_off(),
        21,
        "found at the second due sample, cut by the next one"
    );
    bench.run(400);
    let status = bench.supervisor.status();
    assert_eq!(status.fault.unwrap().fault, Fault::LateRender);
    assert!(status.causes.contains(Fault::StuckRender));
    bench.recover();
}

/// `render` comes back when the sample after has noted that it was late: what the guard found is then
/// newer than the sample that is answered.
#[test]
fn a_late_output_is_named_with_the_sample_at_which_it_was_missed() {
    let mut bench = Bench::armed();
    while !bench.sample().motion.due {}
    bench.missing = 1;
    bench.run(10);
    bench.delay = 4;
    bench.run(9);
    let missed = bench.sample().motion;
    assert!(missed.due);
    bench.run(4);
    let record = bench.supervisor.status().fault.unwrap();
    assert_eq!(record.fault, Fault::LateRender);
    assert!((missed.sample..=missed.sample + 1).contains(&record.sample), "{record:?}");
}

#[test]
#[cfg_attr(miri, ignore = "arms four times in closed loop")]
fn stop_supply_settings_and_debugger_are_off_within_one_output_and_need_their_cause_gone() {
    for (fault, inputs, refusal) in [
        (Fault::EmergencyStop, Inputs { stop_closed: false, ..GOOD }, Some(Refusal::StopOpen)),
        (Fault::BrownOut, Inputs { supply_good: false, ..GOOD }, Some(Refusal::Supply)),
        (Fault::Settings, Inputs { settings_valid: false, ..GOOD }, Some(Refusal::Settings)),
        (Fault::Debugger, Inputs { halted: true, ..GOOD }, None),
    ] {
        let mut bench = Bench::armed();
        bench.inputs = inputs;
        assert!(bench.samples_until_off() <= 10);
        assert_eq!(bench.fault(), Some(fault));
        bench.run(20);
        assert_eq!(bench.ask(Request::Clear), Err(Refusal::CausePresent(fault)));
        bench.inputs = GOOD;
        bench.run(20);
        bench.recover();
        // off, it is no fault and only stands in the way of arm
        bench.ask(Request::Disarm).unwrap();
        bench.inputs = inputs;
        bench.run(20);
        assert_eq!(bench.fault(), None);
        assert_eq!(bench.ask(Request::Arm).err(), refusal);
    }
}

#[test]
fn an_encoder_that_dies_in_free_motion_is_found_by_the_push() {
    let mut bench = Bench::armed();
    bench.dead = true;
    bench.offset = 0; // close to where it is: no jump
    bench.push = Force::saturating_from_bits(1 << 28);
    let samples = bench.samples_until_off();
    assert!((500..=540).contains(&samples), "{samples}");
    assert_eq!(bench.fault(), Some(Fault::PushWithoutMotion));
}

#[test]
fn a_handle_that_is_held_on_purpose_is_no_dead_encoder() {
    let mut bench = Bench::armed();
    bench.held = true;
    bench.supervisor.expect_still(true);
    bench.push = Force::saturating_from_bits(1 << 28);
    bench.run(if cfg!(miri) { 1_000 } else { 20_000 });
    assert_eq!((bench.state(), bench.fault()), (State::Armed, None));
    bench.supervisor.expect_still(false);
    let samples = bench.samples_until_off();
    assert!((500..=540).contains(&samples), "{samples}");
    assert_eq!(bench.fault(), Some(Fault::PushWithoutMotion));
}

#[test]
fn a_turned_sign_loses_the_zero_and_is_refused_while_on() {
    let mut bench = Bench::armed();
    assert_eq!(bench.ask(Request::Turn), Err(Refusal::On));
    assert!(bench.supervisor.status().zeroed);
    bench.ask(Request::Disarm).unwrap();
    bench.ask(Request::Zero).unwrap();
    assert_eq!(bench.ask(Request::Turn), Err(Refusal::Zeroing));
    bench.run(20);
    bench.ask(Request::Turn).unwrap();
    assert!(!bench.supervisor.status().zeroed);
    assert_eq!(bench.ask(Request::Arm), Err(Refusal::NotZeroed));
}

#[test]
fn the_first_fault_stays_and_later_ones_are_noted() {
    let mut bench = Bench::armed();
    bench.inputs.stop_closed = false;
    bench.run(10);
    bench.offset = bench.offset.wrapping_add(10_000);
    bench.run(20);
    bench.ask(Request::Trip(Fault::BrownOut)).unwrap();
    let status = bench.supervisor.status();
    assert_eq!(status.fault.unwrap().fault, Fault::EmergencyStop);
    assert!(status.causes.contains(Fault::CountJump) && status.causes.contains(Fault::BrownOut));
}

#[test]
fn a_fault_of_the_last_run_waits_for_clear() {
    let plan = SETTINGS.build(&DESIGN).unwrap();
    let mut bench = Bench::new();
    bench.supervisor = Supervisor::new(plan, Some(FaultRecord::bare(Fault::WatchdogReset)));
    bench.run(20);
    assert_eq!(bench.ask(Request::Arm), Err(Refusal::Faulted(Fault::WatchdogReset)));
    bench.recover();
}

#[test]
fn a_zero_while_armed_makes_no_step_and_no_jump() {
    let mut bench = Bench::armed();
    bench.held = true;
    bench.control = control(0.01, 1e5);
    bench.supervisor.expect_still(true);
    bench.push = Force::saturating_from_bits(-(1 << 29));
    bench.run(200);
    let mut last = bench.output.unwrap().bits();
    assert_eq!(last, -(1 << 29));
    bench.push = Force::ZERO; // fades, and the zero comes in the midst of it
    for n in 0..15 {
        if n == 4 {
            bench.ask(Request::Zero).unwrap();
        }
        bench.run(10);
        let force = bench.output.unwrap().bits();
        assert!((force - last).abs() <= SLEW, "{n}: {last} {force}");
        last = force;
    }
    assert_eq!((bench.state(), last), (State::Armed, 0));
    assert_eq!(bench.last.unwrap().record.position.counts(), 0);
}

#[test]
fn a_zero_that_would_put_the_handle_into_the_wall_is_refused_while_armed() {
    let mut bench = Bench::armed();
    bench.velocity_m_per_s = -0.1;
    bench.run(200);
    bench.held = true;
    bench.control = control(-0.000_5, 1e5); // free here, but 500 counts deep once this place is 0
    bench.run(20);
    assert_eq!(bench.ask(Request::Zero), Err(Refusal::WallThere));
    bench.run(200);
    assert_eq!(bench.output, Some(Force::ZERO));
    bench.control = control(0.000_5, 1e5);
    bench.run(20);
    bench.ask(Request::Zero).unwrap();
    bench.control = control(-0.01, 1e5);
    bench.run(20);
    assert_eq!(bench.ask(Request::Zero), Err(Refusal::Contact));
}

#[test]
#[cfg_attr(miri, ignore = "carries the handle over 1 m")]
fn beyond_its_travel_the_handle_gets_no_force_and_may_be_moved_back() {
    let carry = |bench: &mut Bench, to_m: f64| {
        while (bench.position_m - to_m).abs() > 1e-9 {
            bench.position_m += (to_m - bench.position_m).clamp(-5e-5, 5e-5); // 0.5 m/s
            bench.run(1);
        }
        bench.run(200); // the estimate comes to rest
    };
    for side in [1.0, -1.0] {
        let mut bench = Bench::armed();
        bench.control = control(1.0, 2000.0); // out of reach
        bench.held = true;
        let zero_m =
            bench.position_m - f64::from(bench.last.unwrap().record.position.counts()) * 1e-6;
        carry(&mut bench, zero_m + side * 0.1999);
        assert_eq!(bench.state(), State::Armed);
        carry(&mut bench, zero_m + side * 0.2001);
        assert_eq!((bench.fault(), bench.output), (Some(Fault::BeyondTravel), None));
        assert!(bench.supervisor.status().zeroed);
        bench.ask(Request::Clear).unwrap();
        bench.run(20);
        bench.ask(Request::Arm).unwrap();
        bench.run(20);
        assert_eq!((bench.fault(), bench.output), (Some(Fault::BeyondTravel), None));
        carry(&mut bench, zero_m + side * 0.1);
        bench.held = false;
        bench.velocity_m_per_s = 0.0;
        bench.recover();
    }
}

#[test]
fn flash_writing_is_no_fault_and_not_met_with_force_on() {
    let mut bench = Bench::armed();
    assert_eq!(bench.ask(Request::Stall(true)), Err(Refusal::On));
    bench.ask(Request::Disarm).unwrap();
    bench.run(20);
    bench.ask(Request::Stall(true)).unwrap();
    // The very next sample may be the first one after the stall.
    bench.offset = bench.offset.wrapping_add(5000);
    bench.run(1);
    bench.run(1);
    assert!(bench.guard.causes.is_empty());
    bench.run(18);
    assert_eq!(bench.ask(Request::Arm), Err(Refusal::Stalled));
    bench.offset = bench.offset.wrapping_add(5000);
    bench.run(20);
    bench.ask(Request::Stall(false)).unwrap();
    bench.run(20);
    assert_eq!(bench.fault(), None);
    bench.offset = bench.offset.wrapping_add(5000);
    bench.run(20);
    assert_eq!(bench.fault(), Some(Fault::CountJump));
}

/// The guard is told the force that acts, none while off, and tells the estimator.
#[test]
#[cfg(feature = "observer")]
fn an_observer_under_guard_knows_the_force_last_granted() {
    let velocity = VelocitySettings::Observer { bandwidth_hz: 20.0, mass_kg: 0.4 };
    let wall = WallSettings {
        position_m: 0.5,
        stiffness_n_per_m: 0.0,
        damping_n_s_per_m: 0.0,
        push_only: true,
    };
    let late = |told: bool| {
        let mut bench = Bench::armed();
        let observer = Settings { velocity, wall }.build(&DESIGN).unwrap();
        bench.control = observer;
        bench.run(2000);
        bench.push = Force::saturating_from_bits(1 << 28); // a quarter of full scale: 370 counts in 10 ms
        let mut worst = 0.0f64;
        for _ in 0..200 {
            let step = bench.sample();
            if told {
                assert_eq!(bench.down.force, bench.output.unwrap_or_default());
            } else {
                bench.down.force = Force::ZERO;
            }
            let counts_per_sample = bench.velocity_m_per_s / 1e-6 / 1e4;
            worst = worst
                .max((f64::from(step.motion.velocity.bits()) / 65_536.0 - counts_per_sample).abs());
        }
        bench.ask(Request::Disarm).unwrap();
        bench.run(10);
        assert_eq!(bench.down.force, Force::ZERO);
        worst
    };
    let (told, untold) = (late(true), late(false));
    assert!(told < 0.2 * untold, "{told} {untold}");
}
