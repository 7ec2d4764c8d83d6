//! Commands that have not taken effect yet. They take effect at the same time in all lanes.

use super::{Aligned, Row};
use crate::engine::simd_ops::SimdOps;

/// Time since the last output, the same for all lanes, and the commands that have not taken effect yet.
pub struct Actuation<S: SimdOps, const R: usize> {
    pub period: u32,
    /// Samples after an output at which a command takes effect.
    pub arrival: u32,
    /// Samples since the last output was due. A phase of `period` is the same as 0.
    pub phase: u32,
    /// Ring of commands that have not taken effect yet, N.
    pub commands_n: Vec<Row<S, R>>,
    pub newest: usize,
}

impl<S: SimdOps, const R: usize> Actuation<S, R> {
    /// State before the first sample.
    pub fn new(simd: S, period: u32, latency: u32) -> Self {
        let room = (latency / period + 1) as usize;
        let commands_n = vec![Aligned([simd.splat_f64s(0.0); R]); room];
        Self { period, arrival: latency % period, phase: 0, commands_n, newest: 0 }
    }

    /// Whether an output is due with the next sample.
    pub fn is_due(&self) -> bool {
        self.phase == 0 || self.phase == self.period
    }

    /// Samples before the next sample in which an output is due or a command arrives.
    #[inline(always)]
    pub fn samples_to_event(&self) -> u32 {
        match self.phase {
            0 => 0,
            phase if phase <= self.arrival => self.arrival - phase,
            phase => self.period - phase,
        }
    }

    /// Samples before the next sample in which an output is due.
    pub fn samples_to_output(&self) -> u32 {
        if self.is_due() { 0 } else { self.period - self.phase }
    }

    #[inline(always)]
    pub fn send(&mut self, forces_n: [S::f64s; R]) {
        self.newest = self.following();
        if let Some(slot) = self.commands_n.get_mut(self.newest) {
            slot.0 = forces_n;
        }
    }

    #[inline(always)]
    fn following(&self) -> usize {
        if self.newest + 1 < self.commands_n.len() { self.newest + 1 } else { 0 }
    }

    /// The command that arrives next.
    #[inline(always)]
    pub fn oldest(&self) -> [S::f64s; R] {
        self.commands_n[self.following()].0
    }
}
