//! Tests that need the supervisor's own state.

use super::*;
use crate::{
    Gain, Motion,
    safety::{
        plan::tests::{DESIGN, SETTINGS},
        tests::{GOOD, control},
    },
    units::Velocity,
    wall::Wall,
};

fn supervisor() -> Supervisor {
    Supervisor::new(SETTINGS.build(&DESIGN).unwrap(), None)
}

/// A flipped bit in any of the doubled values is found.
#[test]
fn it_is_whole_until_a_copy_differs() {
    assert!(supervisor().is_whole());
    let mut broken = supervisor();
    broken.state.spoil(State::Armed);
    assert!(!broken.is_whole());
    let mut broken = supervisor();
    let plan = SETTINGS.build(&crate::Design { period: 5, ..DESIGN }).unwrap();
    broken.plan.spoil(plan);
    assert!(!broken.is_whole());
    let mut broken = supervisor();
    broken.unlocked.spoil(true);
    assert!(!broken.is_whole());
    let mut broken = supervisor();
    broken.zeroed.spoil(true);
    assert!(!broken.is_whole());
    // An event of the guard that was not cleared, although force is on.
    let mut broken = supervisor();
    broken.down.acknowledged ^= 1 << 3;
    assert!(broken.is_whole());
    broken.state.set(State::Armed);
    assert!(!broken.is_whole());
    // A fault that was not latched, although force is on.
    let mut broken = supervisor();
    broken.fault = Some(FaultRecord::bare(Fault::OverSpeed));
    assert!(broken.is_whole());
    broken.state.set(State::Armed);
    assert!(!broken.is_whole());
    let mut broken = supervisor();
    let wall = Wall {
        surface: Position::from_counts(100),
        stiffness: Gain::from_f64(1.0).unwrap(),
        damping: Gain::from_f64(1.0).unwrap(),
        push_only: true,
    };
    let mut fade = GainFade::new(wall, Force::ZERO);
    broken.fade = Some(fade);
    assert!(broken.is_whole());
    fade.spoil();
    broken.fade = Some(fade);
    assert!(!broken.is_whole());
}

/// Makes one output. Returns its command, the state after it, and whether a changed number was found.
fn output(mut supervisor: Supervisor, inputs: Inputs) -> (OutputCommand, State, bool) {
    let (up, control) = (SampleReport::BEFORE, control(0.01, 2000.0));
    let asked = (Proposal::default(), control.render(up.motion, Force::ZERO));
    let grant = supervisor.grant(&control, &up, &Guard::NOTHING, asked, inputs).grant;
    (grant, *supervisor.state, supervisor.causes.contains(Fault::Memory))
}

/// With a changed time or position, a wrong sign could pass.
#[test]
fn a_flipped_bit_in_the_sign_test_is_found_by_the_next_output() {
    let mut supervisor = supervisor();
    supervisor.state.set(State::SignTest);
    let (command, state, found) = output(supervisor, GOOD);
    assert!(matches!(command, OutputCommand::On(_)) && state == State::SignTest && !found);
    let mut other = *supervisor.sign;
    other.step(&supervisor.plan, Position::default());
    supervisor.sign.spoil(other);
    assert_eq!(output(supervisor, GOOD), (OutputCommand::Off, State::Fault, true));
}

/// An output that changes the state writes both copies, so it must check them first.
#[test]
fn a_flipped_state_is_found_by_an_output_that_changes_it() {
    const STATES: [State; 5] =
        [State::Off, State::SignTest, State::RampIn, State::Armed, State::Fault];
    let output = |state, copy, inputs| {
        let mut supervisor = supervisor();
        supervisor.state.set(state);
        supervisor.state.spoil(copy);
        output(supervisor, inputs)
    };
    let open = Inputs { stop_closed: false, ..GOOD };
    for inputs in [GOOD, open] {
        for state in STATES {
            for copy in STATES {
                let found = output(state, copy, inputs);
                if state == copy {
                    assert!(!found.2, "{state:?} {inputs:?}");
                } else {
                    assert_eq!(
                        found,
                        (OutputCommand::Off, State::Fault, true),
                        "{state:?} {copy:?}"
                    );
                }
            }
        }
    }
}

/// Only a request makes a zero.
#[test]
fn a_flipped_bit_of_the_number_of_zeroings_makes_no_zero_valid() {
    for zeroed in [0, 1, 2] {
        let right = Guard { zeros: zeroed, ..Guard::NOTHING };
        for bit in 0..u32::BITS {
            let mut supervisor = supervisor();
            for _ in 0..zeroed {
                supervisor.down.zeros = supervisor.down.zeros.next();
            }
            supervisor.zeros.set(zeroed);
            // in what the guard has told
            supervisor.follow_zero(&Guard { zeros: zeroed ^ 1 << bit, ..right });
            supervisor.follow_zero(&right);
            assert_eq!((*supervisor.zeroed, *supervisor.zeros), (false, zeroed), "{bit}");
            supervisor.down.zeros = supervisor.down.zeros.next();
            supervisor.follow_zero(&Guard { zeros: zeroed + 1, ..right });
            assert!(*supervisor.zeroed && supervisor.is_whole());
            // in one of the two copies
            supervisor.zeroed.set(false);
            supervisor.zeros.spoil((zeroed + 1) ^ 1 << bit);
            supervisor.follow_zero(&Guard { zeros: zeroed + 1, ..right });
            assert!(!*supervisor.zeroed && !supervisor.is_whole());
        }
    }
}

/// The task `sample` has cut the output if its report has a fault, or if there were events after the last `clear`.
#[test]
fn it_is_cut_by_what_is_there_or_was_not_cleared() {
    let mut supervisor = supervisor();
    let (quiet, none) = (SampleReport::BEFORE, Guard::NOTHING);
    assert!(!supervisor.is_cut(&quiet, &none));
    let present = FaultSet::EMPTY.with(Fault::CountJump);
    assert!(supervisor.is_cut(&SampleReport { present, ..quiet }, &none));
    let told = Guard { events: 1, ..none };
    assert!(supervisor.is_cut(&quiet, &told));
    assert!(supervisor.is_cut(&SampleReport { present, ..quiet }, &told));
    supervisor.down.acknowledged = 1;
    assert!(!supervisor.is_cut(&quiet, &told));
    assert!(supervisor.is_cut(&quiet, &none));
}

/// The fault is what the task `sample` found first, not the finding with the lowest code.
#[test]
fn a_fault_of_the_guard_is_named_after_what_it_found_first() {
    let mut supervisor = supervisor();
    let first = FaultSet::EMPTY.with(Fault::OverSpeed);
    let causes = first.with(Fault::CountJump);
    let guard = Guard { events: 1, first, causes, ..Guard::NOTHING };
    supervisor.look(&SampleReport::BEFORE, &guard, GOOD, (false, false));
    let record = supervisor.status().fault.unwrap();
    assert_eq!((record.fault, record.causes), (Fault::OverSpeed, causes));
}

#[test]
fn beyond_travel_is_beyond_its_ends() {
    for (counts, beyond) in [(200_000, false), (200_001, true), (-100_000, false), (-100_001, true)]
    {
        let mut supervisor = supervisor();
        supervisor.state.set(State::Armed);
        let position = Position::from_counts(counts);
        let motion = Motion { sample: 0, position, velocity: Velocity::ZERO };
        let up = SampleReport { motion, present: FaultSet::EMPTY };
        // The position is renamed, as by `zero`, so its jump is no over-speed.
        supervisor.look(&up, &Guard::NOTHING, GOOD, (false, true));
        let found = supervisor.status().fault.map(|record| record.fault);
        assert_eq!(found, beyond.then_some(Fault::BeyondTravel), "{counts}");
    }
}

/// The record of a requested fault has position, velocity and force of the last output.
#[test]
fn a_trip_keeps_what_the_last_output_was() {
    let mut supervisor = supervisor();
    supervisor.record = Record {
        sample: 1234,
        position: Position::from_counts(-5),
        velocity: Velocity::saturating_from_bits(77),
        force: Force::saturating_from_bits(99),
        flags: Flags::ON.with_if(Flags::ARMED, true),
        ..Record::EMPTY
    };
    assert_eq!(supervisor.request(Request::Trip(Fault::HostSilent)), Ok(()));
    let record = supervisor.status().fault.unwrap();
    assert_eq!(record.fault, Fault::HostSilent);
    assert_eq!((record.sample, record.position.counts()), (1234, -5));
    assert_eq!((record.velocity.bits(), record.force.bits()), (77, 99));
    assert_eq!(record.flags, supervisor.record.flags);
}

/// A flipped bit has made a fault that never occurred. The new fault, which reports the flipped bit, replaces it.
#[test]
fn a_fault_that_a_bit_has_made_gives_way_to_what_found_it() {
    let mut broken = supervisor();
    broken.state.set(State::Armed);
    broken.fault = Some(FaultRecord::bare(Fault::OverSpeed));
    broken.causes = FaultSet::EMPTY.with(Fault::OverSpeed);
    let memory = FaultSet::EMPTY.with(Fault::Memory);
    let record = FaultRecord { causes: memory, ..FaultRecord::bare(Fault::Memory) };
    broken.trip(Some(record));
    assert_eq!((*broken.state, broken.fault, broken.causes), (State::Fault, Some(record), memory));
    assert_eq!(broken.take_memory_update(), Some(MemoryUpdate::Write(record)));
    // A fault that was latched stays the first fault.
    broken.trip(Some(FaultRecord::bare(Fault::CountJump)));
    assert_eq!(broken.fault, Some(record));
}
