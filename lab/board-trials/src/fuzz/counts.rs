use std::ops::AddAssign;

use serde::Serialize;

/// Numbers of events in a session so far. JSON has the same fields as the printed text.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Counts {
    /// Lines that were typed.
    pub commands: u64,
    /// Lines of the board that equal the library's lines.
    pub replies: u64,
    /// Frames of the board that equal the library's frames.
    pub frames: u64,
    /// Samples at which output code and enable equal the library's.
    pub outputs: u64,
    pub faults: u64,
    /// Resets and power cycles.
    pub resets: u64,
    /// Cycles of the core.
    #[serde(skip)]
    pub cycles: u64,
    /// Commands with the reply `ok`.
    #[serde(skip)]
    pub obeyed: u64,
    /// Commands with the reply `error`.
    #[serde(skip)]
    pub refused: u64,
    /// Outputs with the full force.
    #[serde(skip)]
    pub armed: u64,
    /// Outputs with a nonzero force.
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
        self.armed += other.armed;
        self.forces += other.forces;
    }
}
