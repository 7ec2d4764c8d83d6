//! DMA2 copies words from memory to a peripheral's register on request, without the core.
//!
//! The model follows RM0090 10.3 and 10.5 (RM0390 9.3 and 9.5), for transfers from memory to a peripheral in direct
//! mode. When a stream is enabled, it fetches its first word. A request of the selected channel waits until it is
//! served. Then the stream stores the word and fetches the next word. When the stream's count reaches 0, a circular
//! stream begins again. A stream that is not circular is switched off. An enabled stream is write-protected. Not
//! modelled are other directions, the FIFO, double buffers, interrupts, and the duration of a transfer (some ten
//! cycles).

use std::sync::{
    Arc,
    atomic::{AtomicBool, AtomicU32, Ordering::Relaxed},
};

use rsemu::core::{
    space::{AccessConstraints, AddressSpace, MemAttrs, MemOps, MemResult},
    value::Width,
};

use super::{bus::Storage, flag::Flag, gate::Block};

/// Offset of the first stream, and the distance from one stream to the next.
const FIRST: u64 = 0x10;
const STRIDE: u64 = 0x18;
const CR: u64 = 0x00;
const NDTR: u64 = 0x04;
const PAR: u64 = 0x08;
const M0AR: u64 = 0x0C;
const FCR: u64 = 0x14;

const ENABLE: u32 = 1;
const CIRCULAR: u32 = 1 << 8;
const DIRECTION: u32 = 0b11 << 6;
const TO_PERIPHERAL: u32 = 0b01 << 6;
const INCREMENTS: u32 = 0b11 << 9;
const SIZES: u32 = 0b1111 << 11;
const WORDS: u32 = 0b1010 << 11;
/// These bits of CR can be written while the stream is enabled. They are EN and the interrupt enables.
const OPEN: u32 = 0b1_1111;
/// FCR after reset: direct mode, FIFO empty. `FIFO_LEVEL` is the mask of FCR's bits FS, and `FIFO_HOLDS_ONE` is the
/// value of these bits for one word.
const FCR_RESET: u32 = 0x21;
const FIFO_LEVEL: u32 = 0b111 << 3;
const FIFO_HOLDS_ONE: u32 = 0b001 << 3;

/// The stream and channel of TIM8's update (RM0090 table 43, RM0390 9.3.3).
const STREAM: u64 = 1;
const CHANNEL: u32 = 7;

/// The controller. Its only connected request is TIM8_UP.
#[derive(Debug)]
pub(super) struct Dma {
    pub(super) registers: Arc<Storage>,
    /// Request line of TIM8's update.
    pub(super) request: Arc<Flag>,
    /// The word that waits in the stream.
    pub(super) fetched: AtomicU32,
    /// The stream's count at its start.
    pub(super) count: AtomicU32,
    /// Whether the stream was enabled but has fetched nothing yet.
    pub(super) begins: AtomicBool,
}

const fn at(register: u64) -> u64 {
    FIRST + STRIDE * STREAM + register
}

impl Dma {
    pub(super) fn new() -> Arc<Self> {
        let dma = Arc::new(Self {
            registers: Storage::new(),
            request: Arc::default(),
            fetched: AtomicU32::new(0),
            count: AtomicU32::new(0),
            begins: AtomicBool::new(false),
        });
        dma.reset();
        dma
    }

    /// Serves the requests. `clocked` says whether the controller has a clock. Returns true if a word was stored.
    pub(super) fn serve(&self, space: &AddressSpace, clocked: bool) -> bool {
        let control = self.registers.get(at(CR));
        let on = control & ENABLE != 0 && clocked;
        let fetch = || {
            let from = u64::from(self.registers.get(at(M0AR)));
            // On the chip, an address without memory would cause a transfer error.
            let word = space.read(from, Width::U32, MemAttrs::default()).unwrap_or_default();
            self.fetched.store(u32::try_from(word).unwrap_or_default(), Relaxed);
            let fifo = self.registers.get(at(FCR));
            self.registers.set(at(FCR), fifo & !FIFO_LEVEL | FIFO_HOLDS_ONE);
        };
        if on && self.begins.swap(false, Relaxed) {
            fetch();
        }
        let modelled = control & (DIRECTION | INCREMENTS | SIZES) == TO_PERIPHERAL | WORDS;
        let left = self.registers.get(at(NDTR)) & 0xFFFF;
        if !on || !modelled || control >> 25 & 7 != CHANNEL || left == 0 || !self.request.take() {
            return false;
        }
        let to = u64::from(self.registers.get(at(PAR)));
        let word = u64::from(self.fetched.load(Relaxed));
        let _ = space.write(to, Width::U32, word, MemAttrs::default());
        let left = match left - 1 {
            0 if control & CIRCULAR != 0 => self.count.load(Relaxed),
            0 => {
                self.registers.set(at(CR), control & !ENABLE);
                0
            }
            left => left,
        };
        self.registers.set(at(NDTR), left);
        fetch();
        true
    }
}

impl Block for Dma {
    fn reset(&self) {
        self.registers.restore(&[0; 256]);
        for stream in 0..8 {
            self.registers.set(FIRST + STRIDE * stream + FCR, FCR_RESET);
        }
        self.begins.store(false, Relaxed);
    }
}

impl MemOps for Dma {
    fn read(&self, offset: u64, into: &mut [u8], attributes: MemAttrs) -> MemResult {
        self.registers.read(offset, into, attributes)
    }

    fn write(&self, offset: u64, from: &[u8], attributes: MemAttrs) -> MemResult {
        let stream = offset.checked_sub(FIRST).map(|after| (after / STRIDE, (after % STRIDE) & !3));
        let Some((stream, register)) = stream.filter(|(stream, _)| *stream < 8) else {
            return self.registers.write(offset, from, attributes);
        };
        let control = FIRST + STRIDE * stream + CR;
        let before = self.registers.get(control);
        let was_on = before & ENABLE != 0;
        if was_on && matches!(register, NDTR | PAR | M0AR) {
            return Ok(());
        }
        self.registers.write(offset, from, attributes)?;
        if register == CR {
            if was_on {
                let now = self.registers.get(control);
                self.registers.set(control, before & !OPEN | now & OPEN);
            } else if stream == STREAM && self.registers.get(control) & ENABLE != 0 {
                self.count.store(self.registers.get(at(NDTR)), Relaxed);
                self.begins.store(true, Relaxed);
            }
        }
        Ok(())
    }

    fn constraints(&self) -> AccessConstraints {
        self.registers.constraints()
    }
}
