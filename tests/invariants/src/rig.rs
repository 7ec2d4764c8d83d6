//! The sampling task, the output task and a handle. The two tasks run in the same order as on the board. The test case
//! sets the handle's position.

use zwidth::{
    CounterWidth, Design, LoopParameters, Settings, VelocitySettings, WallSettings,
    safety::{
        FaultSet, Guard, GuardCommand, GuardView, GuardedSampler, Inputs, Proposal, Refusal,
        Rendered, Request, SafetyPlan, SafetySettings, State, Step, Supervisor,
    },
    units::Force,
    velocity::Senses,
};

pub const GOOD: Inputs = Inputs {
    stop_closed: true,
    supply_good: true,
    settings_valid: true,
    halted: false,
    found: FaultSet::EMPTY,
};

/// A wall without a force.
pub const NO_WALL: WallSettings = WallSettings {
    position_m: 0.0,
    stiffness_n_per_m: 0.0,
    damping_n_s_per_m: 0.0,
    push_only: true,
};

/// The widest limits that are accepted. So no limit ends a test case.
pub fn wide(design: &Design) -> SafetySettings {
    let unit = design.resolution_m * design.rate_hz;
    SafetySettings {
        speed_max_m_per_s: 32_766.0 * unit,
        speed_believable_m_per_s: 32_766.0 * unit,
        travel_low_m: -f64::from(1 << 30) * design.resolution_m,
        travel_high_m: f64::from(1 << 30) * design.resolution_m,
        ramp_in_s: 0.02,
        sign_test_force: 0.05,
        sign_test_counts: 10,
        heaviest_mass_kg: 1e6,
        heaviest_damping_n_s_per_m: 1e6,
        passive_acceleration_m_per_s2: 0.0,
    }
}

#[derive(Clone, Copy)]
pub struct Rig {
    pub design: Design,
    pub control: LoopParameters,
    pub supervisor: Supervisor,
    sampler: GuardedSampler,
    guard: Guard,
    view: GuardView,
    down: GuardCommand,
    pub push: Force,
    pub inputs: Inputs,
    pub count: i64,
    /// The force of the hardware. `None` while the hardware is off.
    pub output: Option<Force>,
    position: i32,
}

impl Rig {
    /// A rig that is off, at count 0.
    pub fn new(design: Design, plan: SafetyPlan, control: LoopParameters) -> Self {
        Self {
            design,
            control,
            supervisor: Supervisor::new(plan, None),
            sampler: GuardedSampler::new(0, CounterWidth::Bits32),
            guard: Guard::NOTHING,
            view: GuardView::NOTHING,
            down: GuardCommand::start(&plan),
            push: Force::ZERO,
            inputs: GOOD,
            count: 0,
            output: None,
            position: 0,
        }
    }

    /// Position of the handle at the last output, in counts.
    pub fn position(&self) -> i32 {
        self.position
    }

    /// Runs one sample, and the output if one is due.
    pub fn sample(&mut self) -> (Step, Option<Rendered>) {
        let Self { sampler, control, down, guard, count, .. } = self;
        let step = sampler.step(control, *count as u32, &Senses::NONE, down, guard);
        let number = step.report.motion.number();
        if step.told {
            self.view.take(self.guard, number);
        }
        if step.cut {
            self.output = None;
        }
        let rendered = step.due.then(|| {
            let Self { control, push, inputs, .. } = self;
            let guard = self.view.at(number);
            let drive = control.render(step.report.motion, *push);
            let asked = (Proposal { push: *push, still: false }, drive);
            let rendered = self.supervisor.grant(control, &step.report, &guard, asked, *inputs);
            self.output = rendered.grant.force();
            self.position = step.report.motion.position.counts();
            self.down = self.supervisor.down();
            rendered
        });
        (step, rendered)
    }

    pub fn output(&mut self) -> Rendered {
        loop {
            if let (_, Some(rendered)) = self.sample() {
                return rendered;
            }
        }
    }

    /// Carries out a request after an output.
    pub fn ask(&mut self, request: Request) -> Result<(), Refusal> {
        let result = self.supervisor.request(request);
        self.down = self.supervisor.down();
        result
    }

    /// Replaces the settings after an output, if this is allowed.
    pub fn change(&mut self, control: LoopParameters) -> Result<(), Refusal> {
        self.supervisor.may_change(&self.control, &control)?;
        self.control = control.after(&self.control);
        Ok(())
    }

    pub fn state(&self) -> State {
        self.supervisor.status().state
    }

    /// Sets the zero, and runs the sign test with a handle that follows the force. After the sign test, the ramp
    /// begins.
    pub fn pass_sign_test(&mut self) {
        self.output();
        self.ask(Request::Zero).unwrap();
        self.output();
        self.output();
        self.ask(Request::Arm).unwrap();
        // Two outputs may be a quarter of the test. In so short a test the response is far above the limit.
        let quarter = 0.025 * self.design.rate_hz / f64::from(self.design.period);
        let faster = (200.0 / (quarter * quarter)).ceil() as i64;
        let (mut speed, mut outputs) = (0, 0);
        while self.state() != State::RampIn {
            let force = self.output().grant.force().unwrap_or_default();
            speed += faster * i64::from(force.bits().signum());
            self.count += speed;
            outputs += 1;
            assert!(
                outputs < 10_000 && self.state() != State::Fault,
                "{:?}",
                self.supervisor.status()
            );
        }
    }

    /// Runs until the full force is allowed, with the handle at rest.
    pub fn armed(mut self) -> Self {
        self.pass_sign_test();
        while self.state() != State::Armed {
            self.output();
        }
        for _ in 0..50 {
            self.output();
        }
        self
    }
}

pub fn control(
    design: &Design,
    velocity: VelocitySettings,
    wall: WallSettings,
) -> Option<LoopParameters> {
    Settings { velocity, wall }.build(design).ok()
}
