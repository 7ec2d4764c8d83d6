//! A current-mode amplifier on the force output. While it is enabled, its force is proportional to the command.
//!
//! The command is integrated over time in whole units, so that each machine gives the same run. Full scale is 2047
//! units for the DAC and 1 unit for the PWM.

use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::{
    mcu::{DacListener, Pin, PinListener},
    wiring::{Force, Wiring},
};

pub struct Amplifier {
    wiring: Wiring,
    state: Mutex<State>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct State {
    enabled: bool,
    /// The command in units, which acts if the amplifier is enabled.
    command: i64,
    magnitude: bool,
    away: bool,
    since: u64,
    sum: i64,
    changes: Changes,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Changes {
    /// Cycle at which enable became inactive.
    pub disabled_at: Option<u64>,
    /// Cycle of the last change of the command.
    pub command_at: u64,
    pub commands: u64,
}

impl State {
    fn accumulate(&mut self, cycle: u64) {
        let span = i64::try_from(cycle.saturating_sub(self.since)).unwrap_or(i64::MAX);
        if self.enabled {
            self.sum += self.command * span;
        }
        self.since = self.since.max(cycle);
    }

    fn set_command(&mut self, cycle: u64, command: i64) {
        if command != self.command {
            self.command = command;
            self.changes.command_at = cycle;
            self.changes.commands += 1;
        }
    }
}

impl Amplifier {
    pub fn new(wiring: Wiring) -> Self {
        Self { wiring, state: Mutex::default() }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn saved(&self) -> State {
        *self.state()
    }

    pub(crate) fn restore(&self, from: State) {
        *self.state() = from;
    }

    fn full_scale(&self) -> f64 {
        match self.wiring.force {
            Force::Dac { .. } => 2047.0,
            Force::Pwm { .. } => 1.0,
        }
    }

    /// Mean force from the last call up to `cycle`, as a fraction of full scale.
    #[expect(
        clippy::cast_precision_loss,
        reason = "a few thousand units over a few thousand cycles"
    )]
    pub fn mean_until(&self, cycle: u64, from: u64) -> f64 {
        let mut state = self.state();
        state.accumulate(cycle);
        let sum = std::mem::take(&mut state.sum);
        if cycle <= from {
            return 0.0;
        }
        sum as f64 / (cycle - from) as f64 / self.full_scale()
    }

    /// Integral of the command up to `cycle`. The caller later passes it to [`go_on`](Self::go_on).
    pub(crate) fn pause(&self, cycle: u64) -> i64 {
        let mut state = self.state();
        state.accumulate(cycle);
        state.sum
    }

    /// Continues at `cycle` with this integral. Input since [`pause`](Self::pause) is ignored.
    pub(crate) fn go_on(&self, cycle: u64, sum: i64) {
        let mut state = self.state();
        state.accumulate(cycle);
        state.sum = sum;
    }

    pub fn is_enabled(&self) -> bool {
        self.state().enabled
    }

    /// The present command in units. It is kept also while the amplifier is disabled.
    pub fn command(&self) -> i64 {
        self.state().command
    }

    pub fn changes(&self) -> Changes {
        self.state().changes
    }
}

impl PinListener for Amplifier {
    fn level(&self, cycle: u64, pin: Pin, high: bool) {
        let mut state = self.state();
        state.accumulate(cycle);
        if pin == self.wiring.enable {
            if state.enabled && !high {
                state.changes.disabled_at = Some(cycle);
            }
            state.enabled = high;
        }
        if let Force::Pwm { magnitude, sign } = self.wiring.force {
            if pin == magnitude {
                state.magnitude = high;
            } else if pin == sign {
                state.away = high;
            }
            let command = match (state.magnitude, state.away) {
                (false, _) => 0,
                (true, false) => 1,
                (true, true) => -1,
            };
            state.set_command(cycle, command);
        }
    }
}

impl DacListener for Amplifier {
    fn code(&self, cycle: u64, code: Option<u32>) {
        let mut state = self.state();
        state.accumulate(cycle);
        state.set_command(cycle, code.map_or(0, |code| i64::from(code) - 2048));
    }
}
