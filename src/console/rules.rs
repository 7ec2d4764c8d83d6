//! The table of conditions under which each command is allowed.

use super::Command;
use crate::{
    experiment::Activity,
    safety::{Fault, Refusal, State, Status},
};

/// Everything that decides whether a command is allowed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Situation {
    /// Status that the supervisor reports.
    pub status: Status,
    /// Experiment that is running, if any.
    pub activity: Activity,
}

/// A condition that must be fulfilled before a command is obeyed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Need {
    /// The force is off: neither armed nor arming.
    Off,
    /// The supervisor allows `arm`.
    MayArm,
    /// The full force acts.
    Armed,
    /// Neither sign test nor ramp is running.
    NotArming,
    /// The handle is out of the wall, or the force is off. With the force off a wall has no effect.
    NoContact,
    /// No experiment is running.
    Idle,
    /// No experiment is running, or only a calibration. A calibration continues with the new force.
    IdleOrCalibration,
    /// No walk, pulse train or quiet hit is running, because these use K, B and push.
    NoWalk,
    NoFault,
    Fault,
    CauseGone,
    /// The supply is high enough.
    Supply,
    Unlocked,
}

/// The conditions for each command, in the order in which they are checked.
const fn needs(command: &Command) -> &'static [Need] {
    use Need as N;
    match command {
        Command::Help
        | Command::Version
        | Command::Status
        | Command::Get
        | Command::Designs
        | Command::Faults
        | Command::Stream(_)
        | Command::Stop
        | Command::Alive(_)
        | Command::Disarm => &[],
        Command::Arm => &[N::MayArm],
        Command::Clear => &[N::Fault, N::CauseGone],
        Command::UnlockEnvelope => &[N::NoFault],
        Command::Zero => &[N::NotArming, N::Idle, N::NoContact],
        Command::Stiffness(_) | Command::Damping(_) | Command::Push(_) | Command::Grid(..) => {
            &[N::NoWalk]
        }
        Command::Start(_)
        | Command::Settle(_)
        | Command::Window(_)
        | Command::RmsLimit(_)
        | Command::Criterion(_)
        | Command::ForceRmsLimit(_) => &[N::Idle],
        // These commands need the force off. With a wrong sign every wall pulls. Another full scale changes every
        // force. With another period every number of outputs has another meaning. With another design the hand feels
        // another device.
        Command::MotorReversed(_)
        | Command::EncoderReversed(_)
        | Command::FullScale(_)
        | Command::Design(_)
        | Command::Period(_) => &[N::Off],
        Command::Wall(_)
        | Command::Cutoff(_)
        | Command::Tuning(_)
        | Command::Further(..)
        | Command::Estimator(_)
        | Command::Load => &[N::NotArming, N::NoWalk, N::NoContact],
        // Flash is programmed 32 bits at a time, for which the chip needs 2.7 V. The supply detector may accept a
        // slightly lower voltage. A record may then be lost. Its CRC shows the loss.
        Command::Save | Command::SelfTest => &[N::Off, N::Supply],
        Command::Hit | Command::Pulses(_) => &[N::NoFault, N::Armed, N::Idle],
        Command::Calibrate(_) => &[N::NoFault, N::Armed, N::IdleOrCalibration, N::NoContact],
        Command::Walk => &[N::NoFault, N::Armed, N::Idle, N::Unlocked],
    }
}

impl Need {
    /// The refusal if the condition is not fulfilled.
    fn refusal(self, now: &Situation) -> Option<Refusal> {
        let status = &now.status;
        let (state, inputs) = (status.state, status.inputs);
        let unmet = |met: bool, refusal: Refusal| (!met).then_some(refusal);
        match self {
            Self::Off => match state {
                State::Off | State::Fault => None,
                State::SignTest | State::RampIn | State::Armed => Some(Refusal::On),
            },
            Self::MayArm => status.may_arm().err(),
            Self::Armed => unmet(state == State::Armed, Refusal::NotArmed),
            Self::NotArming => {
                let arming = matches!(state, State::SignTest | State::RampIn);
                unmet(!arming, Refusal::Arming)
            }
            Self::NoContact => unmet(!(state.is_on() && status.contact), Refusal::Contact),
            Self::Idle => unmet(now.activity == Activity::None, Refusal::Busy),
            Self::IdleOrCalibration => {
                let free = matches!(now.activity, Activity::None | Activity::Calibration);
                unmet(free, Refusal::Busy)
            }
            Self::NoWalk => {
                let own =
                    matches!(now.activity, Activity::Walk | Activity::Pushes | Activity::Pulses);
                unmet(!own, Refusal::Busy)
            }
            Self::NoFault => (state == State::Fault).then(|| {
                let fault = status.fault.map_or(Fault::Settings, |record| record.fault);
                Refusal::Faulted(fault)
            }),
            Self::Fault => unmet(state == State::Fault, Refusal::NoFault),
            Self::CauseGone => status.present.first().map(Refusal::CausePresent),
            Self::Supply => unmet(inputs.supply_good, Refusal::Supply),
            Self::Unlocked => unmet(status.unlocked, Refusal::Locked),
        }
    }
}

/// Whether `command` is allowed now. Ranges and the envelope are checked where the settings are built.
///
/// The supervisor checks dangerous commands again, with its own, newer state. It may refuse a command that is allowed
/// here.
///
/// # Errors
/// The first condition that is not fulfilled.
pub fn allowed(command: &Command, now: &Situation) -> Result<(), Refusal> {
    match needs(command).iter().find_map(|need| need.refusal(now)) {
        None => Ok(()),
        Some(refusal) => Err(refusal),
    }
}

/// Whether [`Command::Load`] may now change the settings that need the force off: direction of motor and encoder, full
/// scale, design, output period.
///
/// # Errors
/// The force is on.
pub fn is_off(now: &Situation) -> Result<(), Refusal> {
    Need::Off.refusal(now).map_or(Ok(()), Err)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        console::{GridValue, lines::EXPERIMENTS, parse, usages},
        safety::{FaultRecord, FaultSet, Inputs},
        store::Name,
        velocity::EstimatorName,
    };
    use std::vec::Vec;

    const COMMANDS: [Command; 39] = [
        Command::Help,
        Command::Version,
        Command::Status,
        Command::Get,
        Command::Zero,
        Command::Arm,
        Command::Disarm,
        Command::Stiffness(1.0),
        Command::Damping(1.0),
        Command::Wall(1.0),
        Command::Cutoff(1.0),
        Command::Estimator(EstimatorName::Butterworth),
        Command::Push(1.0),
        Command::Hit,
        Command::Walk,
        Command::Stop,
        Command::UnlockEnvelope,
        Command::Stream(true),
        Command::Stream(false),
        Command::Save,
        Command::Load,
        Command::Faults,
        Command::Clear,
        Command::Calibrate(10.0),
        Command::FullScale(5.0),
        Command::Start(0.0),
        Command::Settle(4.0),
        Command::Window(2.0),
        Command::RmsLimit(1e-5),
        Command::Grid(GridValue::StiffnessStep, 1.0),
        Command::MotorReversed(true),
        Command::EncoderReversed(true),
        Command::Further(1, 1.0),
        Command::Period(1.0),
        Command::Alive(200.0),
        Command::Designs,
        Command::Design(Name::of("quiet")),
        Command::SelfTest,
        Command::Pulses(1.0),
    ];

    /// All possible situations. They combine 5 states, 5 activities, and 7 facts that are true or false.
    fn situations() -> Vec<Situation> {
        let states = [State::Off, State::SignTest, State::RampIn, State::Armed, State::Fault];
        let activities = [
            Activity::None,
            Activity::Hit,
            Activity::Walk,
            Activity::Calibration,
            Activity::Pulses,
        ];
        let mut all = Vec::new();
        for state in states {
            for activity in activities {
                // Under Miri only some combinations are tried. Each fact is still true in some and false in others.
                for facts in (0..128u32).step_by(if cfg!(miri) { 23 } else { 1 }) {
                    let fact = |n: u32| facts >> n & 1 == 1;
                    let fault =
                        (state == State::Fault).then(|| FaultRecord::bare(Fault::OverSpeed));
                    let present = FaultSet::EMPTY.with_if(Fault::OverSpeed, fact(6));
                    all.push(Situation {
                        status: Status {
                            state,
                            fault,
                            causes: FaultSet::EMPTY,
                            present,
                            zeroed: fact(0),
                            unlocked: fact(1),
                            contact: fact(2),
                            inputs: Inputs {
                                stop_closed: fact(3),
                                supply_good: fact(4),
                                settings_valid: fact(5),
                                halted: false,
                                found: FaultSet::EMPTY,
                            },
                        },
                        activity,
                    });
                }
            }
        }
        all
    }

    /// Checks for every situation that `command` is allowed exactly when `expected` says so.
    fn met(command: Command, expected: impl Fn(&Situation) -> bool) {
        for now in situations() {
            assert_eq!(allowed(&command, &now).is_ok(), expected(&now), "{command:?} {now:?}");
        }
    }

    fn goes_by_settings(now: &Situation) -> bool {
        matches!(now.activity, Activity::Walk | Activity::Pulses)
    }

    fn in_contact(now: &Situation) -> bool {
        now.status.contact && now.status.state.is_on()
    }

    /// A host recognises the reports of an experiment by the name of its command.
    #[test]
    fn what_needs_the_full_force_is_an_experiment() {
        let needs_force = |name: &&str| {
            let typed = [*name, &std::format!("{name} 1")].map(|line| parse(line.as_bytes()));
            typed.iter().flatten().any(|command| needs(command).contains(&Need::Armed))
        };
        let names = usages().filter_map(|usage| usage.split(' ').next());
        assert_eq!(names.filter(needs_force).collect::<Vec<_>>(), EXPERIMENTS);
    }

    #[test]
    fn whatever_looks_or_makes_safer_is_always_met() {
        for command in COMMANDS {
            let harmless = matches!(
                command,
                Command::Help
                    | Command::Version
                    | Command::Status
                    | Command::Get
                    | Command::Designs
                    | Command::Faults
                    | Command::Stream(_)
                    | Command::Disarm
                    | Command::Alive(_)
                    | Command::Stop
            );
            let always = situations().iter().all(|now| allowed(&command, now).is_ok());
            assert_eq!(always, harmless, "{command:?}");
        }
    }

    #[test]
    fn arm_needs_zero_settings_no_fault_stop_and_supply() {
        met(Command::Arm, |now| {
            let (status, inputs) = (now.status, now.status.inputs);
            status.state == State::Off
                && status.zeroed
                && !status.contact
                && inputs.stop_closed
                && inputs.supply_good
                && inputs.settings_valid
        });
    }

    #[test]
    fn nothing_that_moves_the_wall_or_the_velocity_is_met_in_contact() {
        for command in
            [Command::Wall(1.0), Command::Cutoff(1.0), Command::Load, COMMANDS[11], COMMANDS[32]]
        {
            met(command, |now| {
                !in_contact(now)
                    && !goes_by_settings(now)
                    && !matches!(now.status.state, State::SignTest | State::RampIn)
            });
        }
        met(Command::Zero, |now| {
            !in_contact(now)
                && now.activity == Activity::None
                && !matches!(now.status.state, State::SignTest | State::RampIn)
        });
    }

    #[test]
    fn gains_push_and_grid_are_free_but_for_a_walk_and_pulses() {
        let grid = Command::Grid(GridValue::DampingMax, 1.0);
        for command in [Command::Stiffness(1.0), Command::Damping(1.0), Command::Push(1.0), grid] {
            met(command, |now| !goes_by_settings(now));
        }
        for n in [25, 26, 27, 28] {
            met(COMMANDS[n], |now| now.activity == Activity::None);
        }
    }

    #[test]
    fn experiments_need_full_force_and_a_walk_the_key() {
        let ready =
            |now: &Situation| now.status.state == State::Armed && now.activity == Activity::None;
        met(Command::Hit, ready);
        met(Command::Pulses(1.0), ready);
        met(Command::Walk, |now| ready(now) && now.status.unlocked);
        met(Command::Calibrate(10.0), |now| {
            now.status.state == State::Armed
                && matches!(now.activity, Activity::None | Activity::Calibration)
                && !now.status.contact
        });
    }

    #[test]
    fn flash_is_written_and_signs_full_scale_design_and_period_change_only_with_the_force_off() {
        for command in [
            Command::MotorReversed(true),
            Command::EncoderReversed(false),
            Command::FullScale(5.0),
            Command::Design(Name::of("quiet")),
            Command::Period(1.0),
        ] {
            met(command, |now| !now.status.state.is_on());
        }
        met(Command::SelfTest, |now| !now.status.state.is_on() && now.status.inputs.supply_good);
        met(Command::Save, |now| !now.status.state.is_on() && now.status.inputs.supply_good);
        for now in situations() {
            assert_eq!(is_off(&now).is_ok(), !now.status.state.is_on());
        }
    }

    #[test]
    fn clear_needs_a_fault_whose_cause_is_gone() {
        met(Command::Clear, |now| {
            now.status.state == State::Fault && now.status.present.is_empty()
        });
        met(Command::UnlockEnvelope, |now| now.status.state != State::Fault);
    }

    #[test]
    fn refusals_name_what_is_in_the_way_first() {
        let mut now = situations()[0]; // off, nothing fulfilled
        assert_eq!(allowed(&Command::Arm, &now), Err(Refusal::StopOpen));
        now.status.state = State::Fault;
        now.status.fault = Some(FaultRecord::bare(Fault::LateRender));
        assert_eq!(allowed(&Command::Arm, &now), Err(Refusal::Faulted(Fault::LateRender)));
        now.status.state = State::Armed;
        now.status.contact = true;
        assert_eq!(allowed(&Command::Wall(0.0), &now), Err(Refusal::Contact));
        assert_eq!(allowed(&Command::Save, &now), Err(Refusal::On));
        now.activity = Activity::Hit;
        assert_eq!(allowed(&Command::Walk, &now), Err(Refusal::Busy));
    }
}
