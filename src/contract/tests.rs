use std::{cell::RefCell, vec, vec::Vec};

use embedded_hal::digital::{Error, ErrorKind, ErrorType, InputPin};

use super::*;

std::thread_local! {
    /// What was done to the board, in order.
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
    fn acknowledge(&mut self) {}
}

/// A level, or none if it cannot be read.
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
    start::<Force, Timer>();
    assert_eq!(DONE.take(), vec!["start output", "start sampling"]);
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
