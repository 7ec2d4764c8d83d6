//! The energy at the port, computed once more from the outputs of a capture, and compared with what its keys tell.

use zwidth::{
    port::PortEnergy,
    telemetry::{Flags, Record},
    units::Force,
};

use super::telemetry::Chunk;

/// A push is whole after so many outputs of a millisecond: it comes in by at most 5 % of full scale each.
const PUSH_MS: u64 = 41;
/// Samples of a millisecond at the boards' rate.
const SAMPLES_PER_MS: u64 = 10;

/// The account up to the last output that was seen.
#[derive(Clone, Copy, Debug, Default)]
pub struct Account {
    port: Option<PortEnergy>,
    /// The last output, and how far the one before it was.
    last: Option<(u64, u64)>,
    push: Force,
    /// Sample at which the push became another.
    pushed: u64,
    zeros: Option<u16>,
}

/// An account that is another one: sample, the board's, the core's.
pub type Other = (u64, i64, i64);

impl Account {
    /// Takes a frame: how many keys were compared, and what differs.
    pub fn take(&mut self, chunk: &Chunk) -> (u64, Option<Other>) {
        for (record, push) in chunk.outputs.iter().zip(&chunk.pushes) {
            self.output(record, *push);
        }
        let Some(newest) = chunk.outputs.last() else { return (0, None) };
        let Some(told) = chunk.port else { return (0, None) };
        let zeros = chunk.key.as_ref().map(|key| key.zeros);
        let same = zeros == self.zeros;
        self.zeros = zeros;
        let energy = self.port.filter(|_| same).map(|port| port.energy());
        self.port = self.wall(newest).map(|wall| {
            let contact = wall.1;
            PortEnergy::resumed(wall.0, contact, newest.position, told.energy)
        });
        match energy {
            None => (0, None),
            Some(energy) if energy == told.energy => (1, None),
            Some(energy) => (1, Some((newest.sample, told.energy, energy))),
        }
    }

    fn output(&mut self, record: &Record, push: Force) {
        if push != self.push {
            (self.push, self.pushed) = (push, record.sample);
        }
        let step = self.last.map(|(sample, _)| record.sample.wrapping_sub(sample));
        let follows = self.last.is_some_and(|(_, before)| step == Some(before));
        self.last = Some((record.sample, step.unwrap_or_default()));
        let wall = self.wall(record);
        match (&mut self.port, wall) {
            (Some(port), Some((wall, contact))) if follows => {
                port.acts(wall, contact, record.position)
            }
            _ => self.port = None,
        }
    }

    /// What the wall gives from that output on, and whether it is in contact; none where that cannot be told: sign test and
    /// ramp, a push that is still coming in.
    fn wall(&self, record: &Record) -> Option<(i64, bool)> {
        let has = |flag| record.flags.contains(flag);
        if !has(Flags::ON) {
            return Some((0, false));
        }
        let coming = record.sample.wrapping_sub(self.pushed) < PUSH_MS * SAMPLES_PER_MS;
        if !has(Flags::ARMED) || has(Flags::CHANGING) && coming {
            return None;
        }
        let wall = i64::from(self.push.bits()) - i64::from(record.force.bits());
        Some((wall, has(Flags::CONTACT)))
    }
}
