//! The black box. It keeps the records of the outputs in the half second before a fault.

#![deny(clippy::float_arithmetic)]

use crate::telemetry::Record;

/// A ring of the newest `N` records. It stops at a fault, so that its records can be sent.
///
/// 500 records of 40 bytes are half a second at 1 kHz (20 kB). At higher output rates only every `every`-th output is
/// kept, so the ring still spans half a second. The record that stops the ring is always kept.
#[derive(Clone, Debug)]
pub struct BlackBox<const N: usize> {
    records: [Record; N],
    next: usize,
    len: usize,
    every: u32,
    skipped: u32,
    frozen: bool,
}

impl<const N: usize> BlackBox<N> {
    /// An empty ring that keeps every `every`-th record (0 counts as 1).
    pub const fn new(every: u32) -> Self {
        const { assert!(N > 0) };
        Self { records: [Record::EMPTY; N], next: 0, len: 0, every, skipped: 0, frozen: false }
    }

    /// The smallest `every` with which `N` records span at least half a second.
    pub const fn every(rate_hz: u32, period: u32) -> u32 {
        let period = if period == 0 { 1 } else { period };
        let outputs = rate_hz / period / 2;
        #[expect(clippy::cast_possible_truncation, reason = "a ring of 2^32 records is none")]
        let every = outputs.div_ceil(N as u32);
        if every == 0 { 1 } else { every }
    }

    /// Keeps every `every`-th record from now on.
    pub const fn keep(&mut self, every: u32) {
        self.every = every;
    }

    /// Takes the record of an output. If `fault` is true, the ring stops with this record as its last. It then takes
    /// nothing more until [`release`](Self::release).
    #[inline]
    pub fn push(&mut self, record: Record, fault: bool) {
        if self.frozen {
            return;
        }
        self.frozen = fault;
        self.skipped = self.skipped.saturating_add(1);
        if !fault && self.skipped < self.every {
            return;
        }
        self.skipped = 0;
        if let Some(place) = self.records.get_mut(self.next) {
            *place = record;
        }
        self.next = if self.next + 1 < N { self.next + 1 } else { 0 };
        self.len = (self.len + 1).min(N);
    }

    /// Whether a fault stopped the ring.
    pub fn is_frozen(&self) -> bool {
        self.frozen
    }

    /// Empties the ring, and records again.
    pub fn release(&mut self) {
        (self.next, self.len, self.skipped, self.frozen) = (0, 0, 0, false);
    }

    /// Number of records in the ring.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether the ring has no record.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Returns the `n`-th record. Number 0 is the oldest.
    pub fn get(&self, n: usize) -> Option<&Record> {
        if n >= self.len {
            return None;
        }
        let start = if self.len < N { 0 } else { self.next };
        let place = start + n;
        self.records.get(if place < N { place } else { place - N })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    fn record(sample: u64) -> Record {
        Record { sample, ..Record::EMPTY }
    }

    fn samples<const N: usize>(ring: &BlackBox<N>) -> Vec<u64> {
        (0..ring.len()).map(|n| ring.get(n).unwrap().sample).collect()
    }

    #[test]
    fn it_keeps_the_newest_and_stops_at_the_fault() {
        let mut ring = BlackBox::<4>::new(1);
        assert!(ring.is_empty() && ring.get(0).is_none());
        for n in 0..3 {
            ring.push(record(n), false);
        }
        assert_eq!(samples(&ring), [0, 1, 2]);
        for n in 3..9 {
            ring.push(record(n), n == 8);
        }
        ring.push(record(9), false);
        ring.push(record(10), true);
        assert!(ring.is_frozen());
        assert_eq!(samples(&ring), [5, 6, 7, 8]);
        ring.release();
        ring.push(record(11), false);
        assert_eq!(samples(&ring), [11]);
    }

    #[test]
    fn after_every_record_it_holds_the_last_ones_in_order() {
        let mut ring = BlackBox::<4>::new(1);
        for n in 0..20 {
            ring.push(record(n), false);
            let expected: Vec<u64> = (n.saturating_sub(3)..=n).collect();
            assert_eq!(samples(&ring), expected);
            assert!(!ring.is_empty());
        }
    }

    #[test]
    fn from_another_period_on_it_keeps_other_records() {
        let mut ring = BlackBox::<8>::new(1);
        ring.push(record(0), false);
        ring.keep(3);
        for n in 1..7 {
            ring.push(record(n), false);
        }
        assert_eq!(samples(&ring), [0, 3, 6]);
    }

    #[test]
    fn at_a_high_rate_it_thins_out_but_keeps_the_last() {
        assert_eq!(BlackBox::<500>::every(10_000, 10), 1);
        assert_eq!(BlackBox::<500>::every(10_000, 1), 10);
        assert_eq!(BlackBox::<500>::every(50_000, 1), 50);
        assert_eq!(BlackBox::<500>::every(1000, 0), 1);
        let mut ring = BlackBox::<8>::new(3);
        for n in 0..11 {
            ring.push(record(n), n == 10);
        }
        assert_eq!(samples(&ring), [2, 5, 8, 10]);
    }
}
