//! Saves and restores the whole state of the chip.
//!
//! The emulator's devices save their registers. The devices do not save inputs that another device drives: pins, the
//! encoder's levels, the supply. After a restore these inputs are driven again. This crate's own state is copied:
//! memories, time, queues of edges, observations. Snapshots share a copy of flash if the flash registers were not
//! accessed between them.

use std::sync::{Arc, atomic::Ordering::Relaxed};

use rsemu::{
    core::{
        device::Device,
        space::RamStore,
        state::{ChunkReader, MachineShape, StateReader, StateWriter},
    },
    cpu::arm::v7m::Regs,
};

use super::{
    Mcu, Outside, Watch,
    bus::{ClockState, Lazy, Storage},
    encoder::EncoderState,
    soc::{FLAGS, Soc, WIRED},
};

#[derive(Clone)]
pub struct Snapshot {
    devices: Vec<u8>,
    flash: Arc<Vec<u8>>,
    ram: Vec<u8>,
    backup: Vec<u8>,
    clock: ClockState,
    encoder: EncoderState,
    /// For each timer, the number of cycles for which halts have stopped it.
    stood: Vec<u64>,
    /// Registers of DBGMCU, DAC, ADCs and DMA2, which the emulator does not model. `dma` has more of DMA2's state: the
    /// waiting word, the count, and whether the stream has just been enabled.
    stored: [Vec<u32>; 4],
    dma: ([u32; 2], bool),
    flags: [bool; FLAGS],
    supply: [u32; 3],
    written_at: u64,
    outside: Outside,
    registers: Regs,
    stands: bool,
    times: [u64; 8],
    event: (u64, bool),
    hard_faults: Vec<u32>,
    watch: Watch,
}

impl Snapshot {
    /// Registers, memories and devices of the chip, to compare two states.
    pub fn bytes(&self) -> impl Iterator<Item = u8> + '_ {
        [&self.devices, &*self.flash, &self.ram, &self.backup].into_iter().flatten().copied()
    }
}

/// Name of a device in the saved state. The emulator orders devices by name, so the names have two digits.
fn name(index: usize) -> String {
    format!("{index:02}")
}

fn save<'a>(devices: impl Iterator<Item = &'a dyn Device>) -> Vec<u8> {
    let mut writer = StateWriter::new(MachineShape::new());
    for (index, device) in devices.enumerate() {
        let mut chunk = writer.chunk(&name(index), "device", 0).expect(WIRED);
        device.save(&mut chunk).expect(WIRED);
    }
    writer.to_vec().expect(WIRED)
}

/// Restores devices in their order.
fn load<'a>(devices: impl Iterator<Item = &'a dyn Device>, bytes: &[u8]) {
    let reader = StateReader::new(bytes).expect(WIRED);
    for (index, device) in devices.enumerate() {
        let (_, _, chunk) = reader.load_raw(&name(index)).expect(WIRED);
        device.load(&mut ChunkReader::new(chunk)).expect(WIRED);
    }
}

fn copy(memory: &RamStore) -> Vec<u8> {
    let mut bytes = vec![0; usize::try_from(memory.len()).unwrap_or_default()];
    memory.read_at(0, &mut bytes).expect(WIRED);
    bytes
}

impl Soc {
    fn blocks(&self) -> [&Storage; 4] {
        [&self.dbgmcu, &self.dac, &self.adc, &self.dma.registers]
    }

    /// All devices but flash. The core is last. A device that gates a timer's clock comes before the timer.
    fn devices(&self) -> impl Iterator<Item = &dyn Device> {
        self.rcc_and_power()
            .chain(self.timers().map(|lazy| &*lazy.device))
            .chain(self.ports())
            .chain(std::iter::once(&self.cpu as &dyn Device))
    }
}

impl Mcu {
    pub fn snapshot(&mut self) -> Snapshot {
        let flash = self.saved_flash();
        let soc = &self.soc;
        soc.lazies().for_each(Lazy::pay);
        Snapshot {
            devices: save(soc.devices()),
            flash,
            ram: copy(&self.memories.ram),
            backup: copy(&self.memories.backup),
            clock: self.clock.state(),
            encoder: soc.encoder.state(),
            stood: soc.timers().map(|lazy| lazy.stood.load(Relaxed)).collect(),
            stored: soc.blocks().map(|block| block.words()),
            dma: (
                [&soc.dma.fetched, &soc.dma.count].map(|word| word.load(Relaxed)),
                soc.dma.begins.load(Relaxed),
            ),
            flags: soc.flags().map(|flag| flag.load(Relaxed)),
            supply: soc.supply.state(),
            written_at: soc.commanded_at.load(Relaxed),
            outside: self.outside.clone(),
            registers: self.registers,
            stands: self.stands,
            times: [
                self.now,
                self.next,
                self.asleep,
                self.instructions,
                self.resets,
                self.events,
                self.commanded_at,
                self.stored_by_dma,
            ],
            event: self.event,
            hard_faults: self.hard_faults.clone(),
            watch: self.watch.clone(),
        }
    }

    /// Restores a state of this chip or of another chip with the same program.
    pub fn restore(&mut self, from: &Snapshot) {
        self.restore_flash(&from.flash);
        self.clock.restore(&from.clock);
        self.outside = from.outside.clone();
        self.drive_pins();
        let soc = &self.soc;
        soc.supply.restore(from.supply);
        soc.encoder.restore(&from.encoder);
        load(soc.devices(), &from.devices);
        soc.lazies().for_each(Lazy::owe_nothing);
        self.memories.ram.write_at(0, &from.ram).expect(WIRED);
        self.memories.backup.write_at(0, &from.backup).expect(WIRED);
        for (lazy, stood) in soc.timers().zip(&from.stood) {
            lazy.stood.store(*stood, Relaxed);
        }
        for (block, words) in soc.blocks().into_iter().zip(&from.stored) {
            block.restore(words);
        }
        let (words, begins) = &from.dma;
        for (to, from) in [&soc.dma.fetched, &soc.dma.count].into_iter().zip(words) {
            to.store(*from, Relaxed);
        }
        soc.dma.begins.store(*begins, Relaxed);
        for (flag, value) in soc.flags().into_iter().zip(from.flags) {
            flag.store(value, Relaxed);
        }
        soc.commanded_at.store(from.written_at, Relaxed);
        self.registers = from.registers;
        self.stands = from.stands;
        [
            self.now,
            self.next,
            self.asleep,
            self.instructions,
            self.resets,
            self.events,
            self.commanded_at,
            self.stored_by_dma,
        ] = from.times;
        self.event = from.event;
        self.hard_faults.clone_from(&from.hard_faults);
        self.watch.clone_from(&from.watch);
        self.look_anew();
        self.clock.restore(&from.clock);
    }

    /// Flash with its registers. The copy is renewed only after an access to the registers.
    fn saved_flash(&mut self) -> Arc<Vec<u8>> {
        let touched = self.soc.flash_touched.load(Relaxed);
        if let Some((saved, at)) = &self.flash_saved
            && *at == touched
        {
            return Arc::clone(saved);
        }
        let saved = Arc::new(save(std::iter::once(&*self.soc.flash as &dyn Device)));
        // A busy flash changes without an access.
        let idle = self.soc.flash.next_event_tick().is_none();
        self.flash_saved = idle.then(|| (Arc::clone(&saved), touched));
        saved
    }

    fn restore_flash(&mut self, from: &Arc<Vec<u8>>) {
        let touched = self.soc.flash_touched.load(Relaxed);
        let same = self.flash_saved.as_ref();
        if same.is_some_and(|(saved, at)| Arc::ptr_eq(saved, from) && *at == touched) {
            return;
        }
        load(std::iter::once(&*self.soc.flash as &dyn Device), from);
        self.forget_flash();
        let idle = self.soc.flash.next_event_tick().is_none();
        self.flash_saved = idle.then(|| (Arc::clone(from), touched));
    }
}
