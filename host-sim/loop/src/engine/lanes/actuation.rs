//! Commands that have not taken effect yet. A command takes effect at the same time in all lanes.

use super::{Aligned, Row};
use crate::engine::simd_ops::SimdOps;

/// Commands that have not taken effect yet, and the time since the last output. This time is the same for all lanes.
pub struct Actuation<S: SimdOps, const R: usize> {
    pub period: u32,
    /// Number of samples from an output to the sample in which its command takes effect, modulo `period`.
    pub arrival: u32,
    /// Number of samples since the last output was due. The phases `period` and 0 have the same meaning.
    pub phase: u32,
    /// Ring of the commands that have not taken effect yet, in N.
    pub commands_n: Vec<Row<S, R>>,
    pub newest: usize,
}

impl<S: SimdOps, const R: usize> Actuation<S, R> {
    pub fn new(simd: S, period: u32, latency: u32) -> Self {
        let room = (latency / period + 1) as usize;
        let commands_n = vec![Aligned([simd.splat_f64s(0.0); R]); room];
        Self { period, arrival: latency % period, phase: 0, commands_n, newest: 0 }
    }

    /// Whether an output is due with the next sample.
    pub fn is_due(&self) -> bool {
        self.phase == 0 || self.phase == self.period
    }

    /// Number of samples before the next event: an output that is due, or a command that arrives.
    #[inline(always)]
    pub fn samples_to_event(&self) -> u32 {
        match self.phase {
            0 => 0,
            phase if phase <= self.arrival => self.arrival - phase,
            phase => self.period - phase,
        }
    }

    /// Number of samples before the next output that is due.
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
