//! The firmware's own sampling and output tasks once more, on the host, from the counts that the board read.
//!
//! What a person typed is an order at an output that telemetry tells: the number of the settings, a flag. So every frame
//! has to be that record, bit for bit, from the first one on: velocity, sign test, ramp, return move, hit, fade, flags.

use virtual_board::board::{Board, Force as Wired};
use zwidth::{
    CounterWidth, Design, HitSettings, LoopParameters, Output, Settings, VelocitySettings,
    WallSettings,
    device::{Device, HISTORY},
    experiment::{
        CalibrationSettings, DutySettings, Order, ReturnSettings, Sampling, Scheduler, WalkSettings,
    },
    safety::{
        BlackBox, FaultSet, Guard, GuardCommand, GuardView, GuardedSampler, OutputCommand,
        SafetySettings, Sensed, Supervisor, envelope::Envelope,
    },
    store::{DeviceKey, Loaded, Source, Stored},
    telemetry::Record,
    units::Position,
    velocity::{Sense, Senses},
};

/// The device that the image of that board is built for, without its envelope.
pub fn device(board: Board) -> Device {
    let output = match board.wiring.force {
        Wired::Dac { .. } => Output::Dac { bits: 12 },
        Wired::Pwm { .. } => Output::Pwm { steps: 4200 },
    };
    Device {
        key: DeviceKey::of(board.name),
        design: Design {
            rate_hz: 1e4,
            resolution_m: 1e-6,
            full_scale_n: 5.906,
            period: 10,
            output,
        },
        latency_samples: 0.0,
        senses: &[Sense::Force],
        envelope: &Envelope::EMPTY,
        safety: SafetySettings {
            speed_max_m_per_s: 1.0,
            speed_believable_m_per_s: 5.0,
            travel_low_m: -0.04,
            travel_high_m: 0.11,
            ramp_in_s: 0.2,
            sign_test_force: 0.05,
            sign_test_counts: 200,
        },
        duty: DutySettings { continuous_force_n: 4.1, time_constant_s: 30.0 },
        back: ReturnSettings::SOFT,
        calibration: CalibrationSettings {
            percent: 0.0,
            rise_percent_per_s: 2.0,
            hold_s: 30.0,
            travel_m: 1e-3,
        },
        settings: Settings {
            velocity: VelocitySettings::Butterworth { cutoff_hz: 1500.0 },
            wall: WallSettings {
                position_m: 0.07,
                stiffness_n_per_m: 0.0,
                damping_n_s_per_m: 0.0,
                push_only: true,
            },
        },
        hit: HitSettings { push_n: 0.0, settle_s: 4.0, window_s: 2.0, rms_limit_m: 1.5e-5 },
        walk: WalkSettings {
            stiffness_start_n_per_m: 2000.0,
            stiffness_step_n_per_m: 2000.0,
            stiffness_max_n_per_m: 1e7,
            damping_start_n_s_per_m: 10.0,
            damping_step_n_s_per_m: 10.0,
            damping_max_n_s_per_m: 4000.0,
        },
    }
}

/// What reaches the sampling task.
#[derive(Clone)]
struct ToSample {
    parameters: LoopParameters,
    down: GuardCommand,
}

impl Sampling for ToSample {
    fn set_parameters(&mut self, parameters: LoopParameters) {
        self.parameters = parameters;
    }

    fn command(&mut self, command: GuardCommand) {
        self.down = command;
    }

    fn turn_encoder(&mut self, _: bool) {}
}

/// Both tasks.
pub struct Twin {
    sampler: GuardedSampler,
    guard: Guard,
    view: GuardView,
    to_sample: ToSample,
    scheduler: Scheduler<HISTORY>,
    was_on: bool,
    positions: Vec<Position>,
}

impl Twin {
    /// A board that starts with these settings, its counter at `first`.
    pub fn new(device: &Device, stored: Stored, first: u32) -> Self {
        let loaded = Loaded { stored, source: Source::Empty, damaged: 0 };
        let start = device.start(&loaded, None).unwrap();
        let history = BlackBox::new(start.period.keep);
        Self {
            sampler: GuardedSampler::new(first, CounterWidth::Bits32),
            guard: Guard::NOTHING,
            view: GuardView::NOTHING,
            to_sample: ToSample {
                parameters: start.control,
                down: GuardCommand::start(&start.safety),
            },
            scheduler: Scheduler::new(
                Supervisor::new(start.safety, None),
                start.control,
                stored.signs,
                start.period.duty,
                history,
            ),
            was_on: false,
            positions: Vec::new(),
        }
    }

    /// One sample; if an output is due, its record, after which the order that is there is met.
    pub fn sample(
        &mut self,
        count: u32,
        order: impl FnOnce(&Record) -> Option<Order>,
    ) -> Option<Record> {
        let ToSample { parameters, down } = &self.to_sample;
        let step = self.sampler.step(parameters, count, &Senses::NONE, down, &mut self.guard);
        let motion = step.report.motion;
        if step.told {
            self.view.take(self.guard, motion.number());
        }
        if step.cut {
            self.was_on = false;
        }
        self.positions.push(motion.position);
        if !step.due {
            return None;
        }
        let sensed = Sensed {
            switched_on: self.was_on,
            halted: false,
            was_stopped: false,
            stop_closed: true,
            supply_good: true,
            enabled: self.was_on,
            found: FaultSet::EMPTY,
        };
        let guard = self.view.at(motion.number());
        let rendered = self.scheduler.output(&step.report, &guard, sensed);
        self.was_on = matches!(rendered.grant, OutputCommand::On(_));
        self.to_sample.command(self.scheduler.command());
        let positions = std::mem::take(&mut self.positions);
        let record = self.scheduler.follow(&rendered, motion.position, positions.into_iter());
        if self.scheduler.is_ready()
            && let Some(order) = order(&record)
        {
            self.scheduler.meet(order, &mut self.to_sample);
            self.was_on &= !self.scheduler.is_off();
        }
        self.scheduler.report(record);
        Some(record)
    }
}
