//! Functions that supervise the control path, and functions for communication. `tests/elf/control_path.rs` also checks
//! the machine code of these functions.

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use zwidth::{
    LoopParameters,
    console::{Command, Line, LineReader, REPLY_MAX, Reply, Situation, Text, allowed, parse},
    encoder::Bits32,
    safety::{
        BlackBox, FaultRecord, Guard, GuardCommand, GuardedSampler, Inputs, MemoryUpdate, Proposal,
        Rendered, Request, SampleReport, Supervisor,
        envelope::{Envelope, Key},
    },
    store::{Stored, load, save},
    telemetry::{Decoder, Frame},
    units::Force,
    velocity::Senses,
};

/// Called for every sample, with the guard.
#[unsafe(no_mangle)] // SAFETY: no other symbol has this name
pub extern "C" fn zwidth_guarded_sample(
    sampler: &mut GuardedSampler<Bits32>,
    control: &LoopParameters,
    counter: u32,
    senses: &Senses,
    down: &GuardCommand,
    up: &mut SampleReport,
    guard: &mut Guard,
) -> bool {
    let step = sampler.step(control, counter, senses, down, guard);
    *up = step.report;
    step.cut
}

/// Called for every output, with the supervisor.
#[unsafe(no_mangle)] // SAFETY: no other symbol has this name
pub extern "C" fn zwidth_supervised_render(
    supervisor: &mut Supervisor,
    control: &LoopParameters,
    up: &SampleReport,
    guard: &Guard,
    push: &Force,
    inputs: &Inputs,
    rendered: &mut Rendered,
    down: &mut GuardCommand,
    memory: &mut Option<MemoryUpdate>,
) {
    let asked = (Proposal { push: *push, still: false }, control.render(up.motion, *push));
    *rendered = supervisor.grant(control, up, guard, asked, *inputs);
    *down = supervisor.down();
    *memory = supervisor.take_memory_update();
}

/// Called between two outputs.
#[unsafe(no_mangle)] // SAFETY: no other symbol has this name
pub extern "C" fn zwidth_request(supervisor: &mut Supervisor, request: &Request) -> bool {
    supervisor.request(*request).is_ok()
}

/// Called for every output. Stores the output in the black box and in a telemetry frame.
#[unsafe(no_mangle)] // SAFETY: no other symbol has this name
pub extern "C" fn zwidth_keep(
    ring: &mut BlackBox<500>,
    rendered: &Rendered,
    sequence: u32,
    bytes: &mut [u8; Frame::LEN],
) {
    ring.push(rendered.record, rendered.record.fault != 0);
    *bytes = Frame { sequence, record: rendered.record }.encode();
}

/// Uses the memory of faults and a decoder of telemetry.
#[unsafe(no_mangle)] // SAFETY: no other symbol has this name
pub extern "C" fn zwidth_memory(
    words: &mut [u32; FaultRecord::WORDS],
    decoder: &mut Decoder,
    byte: u8,
) -> bool {
    if let Some(record) = FaultRecord::from_words(words) {
        *words = record.to_words();
    }
    decoder.push(byte).is_some()
}

/// Reads one byte from the link.
#[unsafe(no_mangle)] // SAFETY: no other symbol has this name
pub extern "C" fn zwidth_link(
    reader: &mut LineReader<64>,
    byte: u8,
    now: &Situation,
    command: &mut Command,
) -> bool {
    match reader.push(byte) {
        Some(Line::Text(line)) => parse(line).is_ok_and(|parsed| {
            *command = parsed;
            allowed(&parsed, now).is_ok()
        }),
        Some(Line::TooLong) | None => false,
    }
}

/// Writes one reply to the link.
#[unsafe(no_mangle)] // SAFETY: no other symbol has this name
pub extern "C" fn zwidth_reply(reply: &Reply<'_>, text: &mut Text<REPLY_MAX>) {
    *text = Text::of(reply);
}

/// Compares a wall with the envelope.
#[unsafe(no_mangle)] // SAFETY: no other symbol has this name
pub extern "C" fn zwidth_envelope(envelope: &Envelope<'_>, key: &Key, k: f64, b: f64) -> bool {
    envelope.allows(key, k, b).is_ok()
}

/// A flash of two sectors, in memory.
#[derive(Debug)]
pub struct Memory([u8; 2 * Self::ERASE_SIZE]);

impl Memory {
    fn place(&mut self, from: u32, length: usize) -> Result<&mut [u8], NorFlashErrorKind> {
        let bytes = self.0.get_mut(from as usize..);
        bytes.and_then(|bytes| bytes.get_mut(..length)).ok_or(NorFlashErrorKind::OutOfBounds)
    }
}

impl ErrorType for Memory {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Memory {
    const READ_SIZE: usize = 4;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        let held = self.place(offset, bytes.len())?;
        for (byte, held) in bytes.iter_mut().zip(held) {
            *byte = *held;
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.0.len()
    }
}

impl NorFlash for Memory {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = 16 * 1024;

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        for (held, byte) in self.place(offset, bytes.len())?.iter_mut().zip(bytes) {
            *held &= byte;
        }
        Ok(())
    }

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        self.place(from, to.wrapping_sub(from) as usize)?.fill(u8::MAX);
        Ok(())
    }
}

/// Loads settings from flash and saves them.
#[unsafe(no_mangle)] // SAFETY: no other symbol has this name
pub extern "C" fn zwidth_store(flash: &mut Memory, stored: &mut Stored) -> bool {
    *stored = load(flash, *stored).stored;
    save(flash, stored).is_ok()
}
