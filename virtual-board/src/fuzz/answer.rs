//! A board as it says it is, and what a command is answered with.

use super::settings::{OutOfRange, Settings};

/// The board as it says it is, with an output.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct View {
    pub sample: u64,
    pub position: i32,
    pub velocity: i32,
    pub force: i32,
    pub code: i32,
    pub on: bool,
    pub armed: bool,
    pub contact: bool,
    pub zeroed: bool,
    pub stop_closed: bool,
    pub supply_good: bool,
    /// Gains inside the envelope, or that unlocked, when the output was made.
    pub valid: bool,
    pub unlocked: bool,
    pub fault: u8,
}

/// What else goes on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activity {
    Idle,
    Hit,
    Walk,
    Calibration,
    Pulses,
}

/// What a good reply does.
#[derive(Clone, Debug, PartialEq)]
pub enum Effect {
    None,
    /// New settings of the loop.
    Loop(Settings),
    /// New settings of the experiments.
    Keep(Settings),
    /// Directions, and the zero is lost.
    Signs(Settings),
    Zero,
    Arm,
    Disarm,
    Clear,
    Unlock,
    Begin(Activity),
    Stop,
    Stream(bool),
    Save,
    /// Settings out of flash.
    Load(Settings),
    /// The black box is read out.
    Replay,
}

/// What has to be answered.
#[derive(Clone, Debug, PartialEq)]
pub struct Answer {
    pub text: String,
    pub effect: Effect,
    /// The output task decided it: what the command asks for holds from the sample after its output on.
    pub ordered: bool,
}

impl Answer {
    pub(super) fn said(text: impl Into<String>) -> Self {
        Self { text: text.into(), effect: Effect::None, ordered: false }
    }

    pub(super) fn refused(why: &str) -> Self {
        Self::said(format!("error: {why}"))
    }

    pub(super) fn of_range(error: &OutOfRange) -> Self {
        let OutOfRange { name, value, allowed: [low, high] } = error;
        Self::refused(&format!("{name} is {value}, allowed {low} to {high}"))
    }

    pub(super) fn ok(text: impl std::fmt::Display, effect: Effect) -> Self {
        Self { text: format!("ok {text}"), effect, ordered: true }
    }

    pub(super) fn now(self) -> Self {
        Self { ordered: false, ..self }
    }
}

/// Names of the faults, as their page has them.
pub const FAULTS: [(u8, &str); 24] = [
    (10, "count jump"),
    (11, "over-speed"),
    (12, "out of range"),
    (13, "push without motion"),
    (14, "sign test failed"),
    (15, "beyond travel"),
    (20, "late render"),
    (21, "stuck render"),
    (22, "watchdog reset"),
    (23, "reset while armed"),
    (24, "sample rate"),
    (30, "emergency stop"),
    (31, "brown-out"),
    (32, "debugger halt"),
    (33, "clock failure"),
    (34, "host silent"),
    (35, "force output"),
    (36, "motor current"),
    (40, "settings"),
    (41, "panic"),
    (42, "hard fault"),
    (43, "registers"),
    (44, "memory"),
    (45, "unexpected interrupt"),
];

/// A fault as it is printed.
pub fn fault_text(code: u8) -> String {
    let name = FAULTS.iter().find(|(known, _)| *known == code).map_or("?", |(_, name)| name);
    if code == 0 { "none".into() } else { format!("{code} ({name})") }
}
