use std::ops::AddAssign;

use serde::Serialize;

/// Numbers of events in a session so far. JSON has the same fields as the printed text.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Counts {
    /// Number of lines that were typed.
    pub commands: u64,
    /// Number of the board's lines that equal the library's lines.
    pub replies: u64,
    /// Number of the board's telemetry frames that equal the library's frames.
    pub frames: u64,
    /// Number of samples at which the board's output code and enable equal the library's.
    pub outputs: u64,
    pub faults: u64,
    /// Number of resets and power cycles.
    pub resets: u64,
    /// Number of cycles that the core has run.
    #[serde(skip)]
    pub cycles: u64,
    /// Number of commands that got the reply `ok`.
    #[serde(skip)]
    pub obeyed: u64,
    /// Number of commands that got the reply `error`.
    #[serde(skip)]
    pub refused: u64,
    /// Number of commands that the board has ignored and counted, because nobody was reading.
    #[serde(skip)]
    pub ignored: u64,
    /// Number of lines of the board that had no room, and that the board has counted.
    #[serde(skip)]
    pub lost: u64,
    /// Number of outputs at which the full force was allowed.
    #[serde(skip)]
    pub armed: u64,
    /// Number of outputs with a force other than zero.
    #[serde(skip)]
    pub forces: u64,
}

impl AddAssign for Counts {
    fn add_assign(&mut self, other: Self) {
        self.commands += other.commands;
        self.replies += other.replies;
        self.frames += other.frames;
        self.outputs += other.outputs;
        self.faults += other.faults;
        self.resets += other.resets;
        self.cycles += other.cycles;
        self.obeyed += other.obeyed;
        self.refused += other.refused;
        self.ignored += other.ignored;
        self.lost += other.lost;
        self.armed += other.armed;
        self.forces += other.forces;
    }
}
