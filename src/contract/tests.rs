use std::{cell::RefCell, vec, vec::Vec};

use embedded_hal::digital::{Error, ErrorKind, ErrorType, InputPin};

use super::*;

std::thread_local! {
    /// The calls that the board has received, in their order.
    static DONE: RefCell<Vec<&'static str>> = const { RefCell::new(Vec::new()) };
}

fn note(what: &'static str) {
    DONE.with_borrow_mut(|done| done.push(what));
}

struct Force;

impl ForceOutput for Force {
    fn write(&mut self, _: OutputCode, mirrored: bool) {
        note(if mirrored { "mirrored" } else { "write" });
    }
    fn zero() {
        note("zero");
    }
    fn start() {
        note("start output");
    }
}

struct Line;

impl Enable for Line {
    fn on(&mut self) {
        note("enable");
    }
    fn off() {
        note("disable");
    }
    fn is_on(&self) -> bool {
        true
    }
    fn was_stopped(&self) -> bool {
        false
    }
}

struct Timer;

impl SampleTimer for Timer {
    fn start() {
        note("start sampling");
    }
    fn is_late() -> bool {
        false
    }
    fn acknowledge(&mut self) {}
}

struct Quadrature;

impl Encoder for Quadrature {
    fn start() {
        note("start encoder");
    }
    fn count(&self) -> u32 {
        0
    }
    fn sense(&mut self) -> (u32, Senses) {
        (0, Senses::NONE)
    }
    fn turn(_: bool) {}
}

/// A pin with this level. `None` is a pin that cannot be read.
struct Pin(Option<bool>);

#[derive(Debug)]
struct Unreadable;

impl Error for Unreadable {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

impl ErrorType for Pin {
    type Error = Unreadable;
}

impl InputPin for Pin {
    fn is_high(&mut self) -> Result<bool, Unreadable> {
        self.0.ok_or(Unreadable)
    }
    fn is_low(&mut self) -> Result<bool, Unreadable> {
        self.is_high().map(|high| !high)
    }
}

#[test]
fn enable_goes_first_when_off_and_last_when_on() {
    off::<Force, Line>();
    Drive::new(Force, Line).on();
    assert_eq!(DONE.take(), vec!["disable", "zero", "zero", "enable"]);
}

#[test]
fn sampling_starts_right_after_the_output() {
    start::<Quadrature, Force, Timer>();
    assert_eq!(DONE.take(), vec!["start encoder", "start output", "start sampling"]);
}

#[test]
fn a_command_goes_to_the_output_as_it_is() {
    let mut drive = Drive::new(Force, Line);
    drive.write(OutputCode::default(), false);
    drive.write(OutputCode::default(), true);
    assert_eq!(DONE.take(), vec!["write", "mirrored"]);
}

#[test]
fn only_a_low_pin_is_no_stop() {
    for (level, closed) in [(Some(false), true), (Some(true), false), (None, false)] {
        assert_eq!(EmergencyStop::new(Pin(level)).is_closed(), closed, "{level:?}");
    }
}

/// An event that happens after some reads of the board. With each event the hardware switches enable off.
#[derive(Clone, Copy, Debug)]
enum Event {
    /// The stop opens, and closes again after this number of reads.
    Stop(u32),
    Supply,
    /// A debugger halts the core, which may set the flag of the stop.
    Halt(bool),
}

std::thread_local! {
    static BOARD: RefCell<(u32, u32, Option<Event>)> = const { RefCell::new((0, 0, None)) };
}

/// Counts one read of the board. If the event has happened by now, returns it and the number of reads since then.
fn come() -> Option<(Event, u32)> {
    BOARD.with_borrow_mut(|(reads, at, event)| {
        *reads += 1;
        event.filter(|_| *reads > *at).map(|event| (event, *reads - *at))
    })
}

struct Events;

impl Enable for Events {
    fn on(&mut self) {}
    fn off() {}
    fn is_on(&self) -> bool {
        come().is_none()
    }
    fn was_stopped(&self) -> bool {
        matches!(come(), Some((Event::Stop(_) | Event::Halt(true), _)))
    }
}

impl ErrorType for Events {
    type Error = Unreadable;
}

impl InputPin for Events {
    fn is_high(&mut self) -> Result<bool, Unreadable> {
        Ok(matches!(come(), Some((Event::Stop(open), since)) if since <= open))
    }
    fn is_low(&mut self) -> Result<bool, Unreadable> {
        self.is_high().map(|high| !high)
    }
}

impl Supply for Events {
    fn has_dropped() {}
    fn is_low(&mut self) -> bool {
        matches!(come(), Some((Event::Supply, _)))
    }
}

impl DebugHalts for Events {
    fn clock() -> u16 {
        0
    }

    fn since_the_last(&mut self, _: u64, _: u32) -> bool {
        matches!(come(), Some((Event::Halt(_), _)))
    }
    fn rate_is_wrong(&mut self) -> bool {
        false
    }
}

/// An event happens before, between or after any of the reads. The first output that sees the event must report the
/// right cause.
#[test]
fn whatever_happens_between_two_reads_is_named_after_its_cause() {
    use crate::safety::{FaultSet, Inputs};
    let quiet = Inputs {
        stop_closed: true,
        supply_good: true,
        settings_valid: true,
        halted: false,
        found: FaultSet::EMPTY,
    };
    for event in [
        Event::Stop(1),
        Event::Stop(2),
        Event::Stop(100),
        Event::Supply,
        Event::Halt(false),
        Event::Halt(true),
    ] {
        for at in 0..12 {
            BOARD.set((0, at, Some(event)));
            let seen = (0..4)
                .map(|_| {
                    let drive = Drive::new(Force, Events);
                    let mut stop = EmergencyStop::new(Events);
                    let sensed = sense(
                        (true, FaultSet::EMPTY),
                        (0, 10),
                        &drive,
                        &mut stop,
                        &mut Events,
                        &mut Events,
                    );
                    Inputs::of(sensed, false, true)
                })
                .find(|inputs| *inputs != quiet);
            let expected = match event {
                Event::Stop(_) => Inputs { stop_closed: false, ..quiet },
                Event::Supply => Inputs { supply_good: false, ..quiet },
                Event::Halt(_) => Inputs { halted: true, ..quiet },
            };
            assert_eq!(seen, Some(expected), "{event:?} at read {at}");
        }
    }
}
