//! Tests with random sequences of events and commands.

use super::*;
use crate::{
    console::{Command, Situation, allowed},
    experiment::Activity,
};
use proptest::prelude::*;

#[derive(Clone, Debug)]
enum Event {
    Ask(Request),
    Jump(i32),
    Kick(f64),
    Inputs(Inputs),
    Miss(u32),
    Push(i32),
    Wall(f64, f64),
    Dead(bool),
    Motor(f64),
    Run(u32),
}

fn event() -> impl Strategy<Value = Event> {
    let requests = [
        Request::Arm,
        Request::Arm,
        Request::Disarm,
        Request::Clear,
        Request::Clear,
        Request::Zero,
        Request::Zero,
        Request::Unlock,
        Request::Turn,
        Request::Stall(true),
        Request::Stall(false),
        Request::Trip(Fault::Settings),
        Request::Trip(Fault::Panic),
    ];
    let mostly = |likely: bool| prop::bool::weighted(if likely { 0.9 } else { 0.1 });
    prop_oneof![
        8 => prop::sample::select(requests.to_vec()).prop_map(Event::Ask),
        1 => (-2000i32..2000).prop_map(Event::Jump),
        1 => (-2.0..2.0f64).prop_map(Event::Kick),
        2 => (mostly(true), mostly(true), mostly(true), mostly(false)).prop_map(
            |(stop_closed, supply_good, settings_valid, halted)| Event::Inputs(Inputs {
                stop_closed, supply_good, settings_valid, halted, found: FaultSet::EMPTY,
            })
        ),
        1 => (0u32..25).prop_map(Event::Miss),
        2 => (-(1i32 << 30)..=1 << 30).prop_map(Event::Push),
        2 => (-0.01..0.02f64, 0.0..1e6f64).prop_map(|(x, k)| Event::Wall(x, k)),
        1 => mostly(false).prop_map(Event::Dead),
        1 => prop::sample::select(std::vec![1.0, 1.0, 1.0, -1.0]).prop_map(Event::Motor),
        10 => prop_oneof![1u32..40, 3200u32..3300].prop_map(Event::Run),
    ]
}

impl Bench {
    fn happen(&mut self, event: &Event) -> u32 {
        match *event {
            Event::Ask(request) => {
                let before = self.supervisor.status();
                let result = self.ask(request);
                let after = self.supervisor.status();
                if result.is_err() {
                    assert_eq!(before, after, "a refusal changes nothing");
                }
                let inputs = before.inputs;
                if request == Request::Arm && result.is_ok() {
                    assert!(before.state == State::Off && before.fault.is_none());
                    assert!(inputs.stop_closed && inputs.supply_good && inputs.settings_valid);
                }
                let now = Situation { status: before, activity: Activity::None };
                let (command, same) = match request {
                    Request::Arm => (Command::Arm, result.is_err()),
                    Request::Clear => (Command::Clear, false),
                    Request::Zero => (Command::Zero, false),
                    Request::Unlock => (Command::UnlockEnvelope, false),
                    Request::Turn => (Command::MotorReversed(true), false),
                    _ => (Command::Help, false),
                };
                // A command that the console refuses is refused here too. The exception is `arm` before a zero that is
                // under way.
                match allowed(&command, &now) {
                    Err(Refusal::NotZeroed) => {}
                    Err(_) => assert!(result.is_err(), "{request:?}"),
                    Ok(()) => {
                        // The console cannot predict these refusals.
                        let newer = [Err(Refusal::WallThere), Err(Refusal::Zeroing)];
                        let known = result.is_ok() || newer.contains(&result);
                        assert!(known || same || command == Command::Help, "{result:?}");
                    }
                }
                if request == Request::Clear && result.is_ok() {
                    assert!(before.present.is_empty());
                }
                0
            }
            Event::Jump(counts) => {
                self.offset = self.offset.wrapping_add_signed(counts);
                1
            }
            Event::Kick(velocity) => {
                self.velocity_m_per_s = velocity;
                1
            }
            Event::Inputs(inputs) => {
                self.inputs = inputs;
                1
            }
            Event::Miss(outputs) => {
                self.missing = outputs;
                1
            }
            Event::Push(bits) => {
                self.push = Force::saturating_from_bits(bits);
                1
            }
            Event::Wall(position_m, stiffness) => {
                self.control = control(position_m, stiffness);
                1
            }
            Event::Dead(dead) => {
                self.dead = dead;
                1
            }
            Event::Motor(sign) => {
                self.motor = sign;
                1
            }
            Event::Run(samples) => samples,
        }
    }
}

const CASES: u32 = if cfg!(miri) { 1 } else { 2000 };
const EVENTS: usize = if cfg!(miri) { 2 } else { 60 };
const WALLS: usize = if cfg!(miri) { 3 } else { 20 };

proptest! {
    #![proptest_config(ProptestConfig::with_cases(CASES))]

    /// The main property, over any sequence of events and commands. Force acts only while the supervisor is on. Before
    /// the sign test has passed, the force is at most 5 %. No force acts while a fault is latched or while the guard
    /// cuts the output. The state armed is reached only through sign test and ramp.
    #[test]
    fn no_force_unless_armed(events in prop::collection::vec(event(), 1..EVENTS)) {
        let mut bench = Bench::new();
        let mut state = State::Off;
        let mut found = false;
        for event in &events {
            for _ in 0..bench.happen(event) {
                let step = bench.sample();
                let status = bench.supervisor.status();
                // The force is off with this sample, or with the output that this sample requests, or else with the
                // next sample.
                prop_assert!(!((found || step.cut) && bench.output.is_some()));
                found = !step.report.present.is_empty();
                prop_assert_eq!(status.fault.is_some(), status.state == State::Fault);
                if let Some(rendered) = bench.last.take() {
                    let zero = bench.control.actuator.zero();
                    match rendered.grant {
                        OutputCommand::On(granted) => {
                            prop_assert!(status.state.is_on());
                            prop_assert!(status.inputs.stop_closed && status.inputs.supply_good);
                            prop_assert!(status.inputs.settings_valid && !status.inputs.halted);
                            let small = granted.force().bits().abs() <= SLEW;
                            prop_assert!(small || status.state != State::SignTest);
                        }
                        OutputCommand::Off => {
                            prop_assert!(!status.state.is_on());
                            prop_assert_eq!(rendered.record.force, Force::ZERO);
                            prop_assert_eq!(rendered.record.command, zero);
                        }
                    }
                    let legal = match (state, status.state) {
                        (_, State::Off | State::Fault) => true,
                        (State::Off | State::Fault | State::SignTest, State::SignTest) => true,
                        (State::SignTest | State::RampIn, State::RampIn) => true,
                        (State::RampIn | State::Armed, State::Armed) => true,
                        // The bench was disarmed and armed again between two outputs.
                        (State::RampIn | State::Armed, State::SignTest) => true,
                        _ => false,
                    };
                    prop_assert!(legal, "{state:?} to {:?}", status.state);
                    state = status.state;
                }
            }
        }
    }

    /// Gains and pushes change at random while armed. The force must never change by more than 5 % per output. The
    /// handle is held in the wall, so its motion does not change the force, and the wall's position stays.
    #[test]
    fn changes_are_ramped(
        walls in prop::collection::vec((0.0..1e6f64, -(1i32 << 30)..=1 << 30, 1u32..30), 1..WALLS)
    ) {
        let mut bench = super::fade::in_the_wall(2000.0);
        bench.still = true;
        let mut last = bench.output.unwrap().bits();
        for (stiffness, push, outputs) in walls {
            let from = bench.control;
            bench.control = control(0.01, stiffness);
            prop_assert_eq!(bench.supervisor.may_change(&from, &bench.control), Ok(()));
            prop_assert!(bench.supervisor.may_change(&from, &control(0.011, stiffness)).is_err());
            bench.push = Force::saturating_from_bits(push);
            for _ in 0..outputs {
                bench.run(10);
                let force = bench.output.unwrap();
                let step = i64::from(force.bits()) - i64::from(last);
                prop_assert!(step.abs() <= i64::from(SLEW), "{step}");
                last = force.bits();
            }
        }
    }
}
