//! Computes the energy at the port from the outputs of a capture, and compares it with the energy that the capture's
//! key frames report.

use zwidth::{
    port::PortEnergy,
    telemetry::{Flags, Record},
    units::Force,
};

use super::telemetry::Chunk;

/// Time until a push has its full force, in ms. There is one output per millisecond. Each output adds at most 5 % of
/// full scale.
const PUSH_MS: u64 = 41;
/// Number of samples per millisecond at the boards' sample rate.
const SAMPLES_PER_MS: u64 = 10;

/// The energy that the core has computed, up to the last output.
#[derive(Clone, Copy, Debug, Default)]
pub struct Account {
    port: Option<PortEnergy>,
    /// Sample number of the last output, and number of samples since the output before.
    last: Option<(u64, u64)>,
    push: Force,
    /// Sample number of the last change of the push.
    pushed: u64,
    zeros: Option<u16>,
}

/// A difference in energy: the sample number, the energy that the board reports, and the energy that the core computes.
pub type Other = (u64, i64, i64);

impl Account {
    /// Adds a frame of the capture. Returns the number of key frames that were compared, and a difference if there is
    /// one.
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

    /// The force of the wall from this output on, and whether the handle is in contact. `None` if the force is unknown.
    /// The force is unknown during the sign test and the ramp, and while a push rises.
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
