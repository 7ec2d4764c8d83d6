//! Tests guard and supervisor together, as they run in the two tasks.

use super::{plan::tests::*, *};
use crate::{
    CounterWidth, LoopParameters, Settings, VelocitySettings, WallSettings, units::Force,
    velocity::Senses,
};
use std::{sync::OnceLock, vec::Vec};

mod fade;
mod faults;
mod random;
mod requests;

pub(super) const GOOD: Inputs = Inputs {
    stop_closed: true,
    supply_good: true,
    settings_valid: true,
    halted: false,
    found: FaultSet::EMPTY,
};

pub(super) fn control(position_m: f64, stiffness_n_per_m: f64) -> LoopParameters {
    let settings = Settings {
        velocity: VelocitySettings::Butterworth { cutoff_hz: 1500.0 },
        wall: WallSettings {
            position_m,
            stiffness_n_per_m,
            damping_n_s_per_m: 0.0,
            push_only: true,
        },
    };
    settings.build(&DESIGN).unwrap()
}

/// Both tasks, a motor of 5.906 N at full scale, and a handle of 0.4 kg with 5.5 N s/m. A count is 1 um, and samples
/// come at 10 kHz.
#[derive(Clone)]
struct Bench {
    control: LoopParameters,
    sampler: GuardedSampler,
    guard: Guard,
    supervisor: Supervisor,
    down: GuardCommand,
    push: Force,
    /// Whether the handle is held on purpose.
    still: bool,
    inputs: Inputs,
    /// Number of outputs that the task `render` will miss from now on.
    missing: u32,
    /// Number of samples by which the next output is late. `asked` is the output that was requested.
    delay: u32,
    asked: Option<(u32, Step)>,
    /// Whether the encoder is dead, so that it does not count.
    dead: bool,
    /// Whether a vice holds the handle.
    held: bool,
    /// Sign of the motor.
    motor: f64,
    position_m: f64,
    velocity_m_per_s: f64,
    offset: u32,
    /// The force that the hardware gives. It is the last granted force, unless the task `sample` has cut it.
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
            down: GuardCommand::start(&plan),
            push: Force::ZERO,
            still: false,
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

    /// Runs one sample. Returns the guard's result.
    fn sample(&mut self) -> Step {
        #[expect(clippy::cast_possible_truncation, reason = "a few metres at most")]
        let count = (self.position_m / 1e-6).floor() as i32;
        let counter = if self.dead { self.offset } else { self.offset.wrapping_add_signed(count) };
        let Self { sampler, control, down, guard, .. } = self;
        let step = sampler.step(control, counter, &Senses::NONE, down, guard);
        if step.due {
            if self.missing > 0 {
                self.missing -= 1;
            } else {
                self.asked = Some((std::mem::take(&mut self.delay), step));
            }
        }
        match &mut self.asked {
            Some((0, asked)) => {
                let Self { control, guard, push, still, inputs, .. } = self;
                let proposal = Proposal { push: *push, still: *still };
                let drive = control.render(asked.report.motion, *push);
                let rendered = self.supervisor.grant(
                    control,
                    &asked.report,
                    guard,
                    (proposal, drive),
                    *inputs,
                );
                self.asked = None;
                self.output = rendered.grant.force();
                self.down = self.supervisor.down();
                self.updates.extend(self.supervisor.take_memory_update());
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

    /// Runs until the output is off, at most 10 000 samples. Returns the number of samples.
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

    /// An armed bench: the count is zeroed, and the ramp is over. It is made once for all tests, because it takes Miri
    /// many seconds.
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

    /// Puts new parameters in force, as the renderer does.
    fn retune(&mut self, control: LoopParameters) {
        self.control = control.after(&self.control);
    }

    /// A hand moves the handle by `counts` until the next output.
    fn drag(&mut self, counts: i32) {
        for _ in 0..10 {
            self.position_m += f64::from(counts) * 1e-7;
            self.sample();
        }
    }

    /// After a fault, clears it and arms again.
    fn recover(&mut self) {
        self.ask(Request::Clear).unwrap();
        self.run(20);
        assert_eq!((self.state(), self.output), (State::Off, None));
        if !self.supervisor.status().zeroed {
            assert_eq!(self.ask(Request::Arm), Err(Refusal::NotZeroed));
            self.ask(Request::Zero).unwrap();
            self.run(20);
        }
        self.ask(Request::Arm).unwrap();
        self.run(4000);
        assert_eq!(self.state(), State::Armed);
    }
}
