//! The emulated microcontroller. No other module uses the emulator crate.
//!
//! Instructions are exact, but their cycles are approximate. The core's cycle model has zero wait states. An
//! exception's entry takes 12 cycles and 8 stacking accesses. The return takes about 18 cycles. So each interrupt takes
//! some 16 cycles more than on silicon. No cycle count was compared with silicon.
//!
//! This module adds what the emulator lacks: four priority bits, the vector table's address, TIM1's break input and
//! automatic output enable, the voltage detector, a crystal that fails, ITSTATE in a stacked xPSR, and time while
//! asleep.

mod bench;
mod bus;
mod converter;
mod crystal;
mod debugger;
mod dma;
mod encoder;
mod fast;
mod flag;
mod gate;
mod inject;
mod main_output;
mod outside;
mod reads;
mod snapshot;
mod soc;
mod supply;
mod watch;

use std::{
    collections::BTreeMap,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering::Relaxed},
    },
};

use rsemu::{
    core::space::RamStore,
    cpu::arm::v7m::{Regs, sys::Exception},
};

use self::{
    bus::Clock,
    fast::Fast,
    soc::{Memories, Soc, WIRED},
    watch::{Step, mend_itstate},
};
pub use bench::Bench;
pub use debugger::{AfterHalt, Halt, Met, Refused, Registers, Stops};
pub use encoder::EdgeNotes;
pub use snapshot::Snapshot;
pub use watch::{Cycles, Entry, LINK, RENDER, SAMPLE, Watch};

const RAM: u32 = 0x2000_0000;
const RAM_BYTES: u32 = 0x2_0000;
const FLASH: u32 = 0x0800_0000;
const PACE_IRQ: u16 = 50;
const SUPPLY_IRQ: u16 = 1;
const HARD_FAULT: u16 = 3;
/// Bits of ITSTATE in xPSR.
const IT_BITS: u32 = 0x0600_FC00;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Chip {
    /// Core clock after set-up, in Hz. It is a multiple of 32 kHz and of 8 MHz.
    pub core_hz: u64,
    pub flash_bytes: usize,
    /// Identification of the chip (`DEV_ID`).
    pub id: u32,
    /// Whether the regulator has an over-drive, which 180 MHz needs.
    pub over_drive: bool,
}

/// Normal supply of the chip, in mV.
pub const SUPPLY_MV: u32 = 3300;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Pin {
    /// Letter of the port, from 'A' to 'E'.
    pub port: char,
    /// Number of the pin in its port, from 0 to 15.
    pub number: u8,
}

impl Pin {
    fn port_index(self) -> usize {
        (self.port as usize).saturating_sub('A' as usize).min(4)
    }
}

pub trait PinListener: Send + Sync {
    fn level(&self, cycle: u64, pin: Pin, high: bool);
}

pub trait DacListener: Send + Sync {
    /// Called when the DAC's output changes. From `cycle` on the DAC gives `code`. `None` means that the DAC is off.
    fn code(&self, cycle: u64, code: Option<u32>);
}

/// Connections of the chip, and where its observations are stored.
#[derive(Clone, Default)]
pub struct Listeners {
    /// TIM1's channels, `"ch1"` to `"ch4"`, and the output pin of each.
    pub channels: Vec<(&'static str, Pin)>,
    pub pins: Vec<(Pin, Arc<dyn PinListener>)>,
    pub dac: Option<Arc<dyn DacListener>>,
    /// Whether the encoder's A and B are also connected to TIM3's channels 1 and 2.
    pub captured: bool,
    /// The pin of TIM1's break input.
    pub stop: Option<Pin>,
    /// Values that a self-test measures.
    pub bench: Arc<Bench>,
    /// For each word of RAM, whether it was read. `None` if nobody needs these notes.
    pub reads: Option<Arc<Vec<AtomicBool>>>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stopped {
    /// The core locked up at this address.
    LockedUp(u32),
}

/// Pins that are driven from outside the chip. Each has its level, and the level of its alternate function if that is
/// driven too.
type Outside = BTreeMap<Pin, (bool, Option<bool>)>;

pub struct Mcu {
    chip: Chip,
    listeners: Listeners,
    memories: Memories,
    clock: Arc<Clock>,
    soc: Soc,
    /// A copy of the core's registers after the last step. A read of the registers from the emulator takes half as long
    /// as a step.
    registers: Regs,
    /// Whether the last step left the program counter unchanged. Then the core sleeps, is locked up, or branches to the
    /// same address.
    stands: bool,
    now: u64,
    /// Cycle at which a device has its next event.
    next: u64,
    /// Cycle at which the flash is no longer busy. Until then the core stalls.
    stalled: u64,
    asleep: u64,
    instructions: u64,
    resets: u64,
    /// Cycle of the last sampling event. The second value tells whether the program has not yet read the counter after
    /// it.
    event: (u64, bool),
    events: u64,
    /// Cycle of the last write of a force that [`Watch`] has counted.
    commanded_at: u64,
    /// Program counters at which hard faults occurred.
    hard_faults: Vec<u32>,
    /// Number of words that DMA2 has stored.
    stored_by_dma: u64,
    /// Whether the run continues after a lock-up, until the watchdog resets the core.
    outlives: bool,
    watch: Watch,
    outside: Outside,
    /// The last saved copy of flash. The second value is the number of accesses to the flash registers at that time.
    flash_saved: Option<(Arc<Vec<u8>>, u64)>,
    fast: Fast,
}

impl Mcu {
    /// A chip after power-on reset, with the pieces of the program at their flash addresses.
    ///
    /// # Panics
    /// A piece lies outside the flash.
    pub fn new(chip: Chip, program: &[(u32, Vec<u8>)], listeners: Listeners) -> Self {
        let mut flash = vec![0xFF; chip.flash_bytes];
        for (address, bytes) in program {
            let start = (address - FLASH) as usize;
            flash[start..start + bytes.len()].copy_from_slice(bytes);
        }
        let memories = Memories {
            ram: Arc::new(RamStore::new(u64::from(RAM_BYTES))),
            backup: Arc::new(RamStore::new(0x1000)),
            flash,
        };
        let clock = Arc::new(Clock::default());
        let soc = Soc::new(&chip, &memories, &clock, &listeners, SUPPLY_MV);
        Self {
            chip,
            listeners,
            memories,
            clock,
            registers: soc.cpu.regs(),
            stands: false,
            soc,
            now: 0,
            next: 0,
            stalled: 0,
            asleep: 0,
            instructions: 0,
            resets: 0,
            event: (0, false),
            events: 0,
            commanded_at: 0,
            hard_faults: Vec::new(),
            stored_by_dma: 0,
            outlives: false,
            watch: Watch::new(),
            outside: Outside::new(),
            flash_saved: None,
            fast: Fast::default(),
        }
    }

    /// Runs until `cycle`. It may end a few cycles later, because instructions are not split.
    ///
    /// # Errors
    /// The core locked up.
    pub fn run_until(&mut self, cycle: u64) -> Result<(), Stopped> {
        while self.now < cycle {
            self.advance::<true>(cycle)?;
        }
        self.give_back();
        self.clock.set(self.now);
        Ok(())
    }

    /// Runs one instruction. With `MANY` it runs until `cycle` or the next event. A sleeping core sleeps until `cycle`
    /// or the next event. Returns whether instructions ran.
    #[inline(always)]
    fn advance<const MANY: bool>(&mut self, cycle: u64) -> Result<bool, Stopped> {
        self.clock.set(self.now);
        if self.now >= self.next || self.clock.take_touched() {
            self.service();
        }
        let called = self.soc.pace_line.get()
            || self.soc.supply_line.get()
            || self.soc.crystal.flag.load(Relaxed);
        let sleeps = self.stands && self.soc.cpu.is_asleep() && !called;
        let stays = sleeps || self.outlives && self.stands && self.soc.cpu.is_locked_up();
        let stalls = self.now < self.stalled;
        if stays || stalls || self.clock.stands() {
            let to = self.next.min(cycle);
            self.asleep += if stalls { 0 } else { to - self.now };
            self.now = to;
            return Ok(false);
        }
        let until = self.next.min(cycle);
        if MANY && self.run_here(until) {
            if self.now >= until {
                return Ok(true);
            }
            self.clock.set(self.now);
        }
        self.step();
        if self.stands && self.soc.cpu.is_locked_up() && !self.outlives {
            return Err(Stopped::LockedUp(self.soc.cpu.pc()));
        }
        Ok(true)
    }

    /// Advances the devices to the present and sets the core's interrupt lines.
    fn service(&mut self) {
        let due = self.soc.pace.next_event();
        self.soc.pace.bring_to(self.now);
        for device in &self.soc.others {
            device.bring_to(self.now);
        }
        if self.soc.dma.serve(&self.soc.space, self.soc.dma_gate.clocked.get()) {
            self.stored_by_dma += 1;
        }
        if self.soc.flash_registers.next_event() <= self.now {
            self.soc.flash_registers.advance_to(self.now);
        }
        // A fetch waits while the flash is busy (RM0390 3.5, RM0090 3.6). On the chip a loop in the caches runs on. In
        // this model the core always waits.
        let written = self.soc.flash_registers.next_event();
        self.stalled = if written == u64::MAX { 0 } else { written };
        let before = self.soc.cpu.irq_asserted(PACE_IRQ);
        let line = self.soc.pace_line.get();
        if line && !before && due <= self.now {
            self.event = (due, true);
            self.events += 1;
            self.watch.event(self.registers.basepri);
        }
        self.soc.cpu.set_irq(PACE_IRQ, line);
        self.soc.cpu.set_irq(SUPPLY_IRQ, self.soc.supply_line.get());
        self.soc.cpu.set_nmi(self.soc.crystal.flag.load(Relaxed));
        self.next = self
            .soc
            .others
            .iter()
            .chain([&self.soc.flash_registers])
            .map(bus::Lazy::next_event)
            .fold(self.soc.pace.next_event(), u64::min);
        self.next = self.next.max(self.now + 1);
        if self.soc.watchdog_bites.take() {
            self.restart("iwdgrst");
        } else if self.soc.cpu.reset_requested() {
            self.restart("sftrst");
        }
    }

    fn step(&mut self) {
        self.give_back();
        let cpu = &self.soc.cpu;
        let before = self.registers;
        let cycles = cpu.step();
        self.now += self.clock.stretched(cycles);
        self.instructions += 1;
        let after = cpu.regs();
        let stood = self.stands;
        self.stands = after.r[15] == before.r[15];
        self.registers = after;
        if self.stands && !stood && cpu.is_asleep() {
            self.stop_if_deep();
        }
        self.follow_step(after.r[15]);
        let exception = exception_of(after.xpsr);
        if exception != exception_of(before.xpsr)
            && before.xpsr & IT_BITS != 0
            && after.r[14] >= 0xFFFF_FFE0
        {
            mend_itstate(&self.memories.ram, after.msp, before.r[15], before.xpsr, &mut self.watch);
        }
        if exception == HARD_FAULT && exception_of(before.xpsr) != HARD_FAULT {
            self.hard_faults.push(before.r[15]);
        }
        self.note_entry((exception_of(before.xpsr), before.r[15]), (exception, after.r[15]));
        let cpu = &self.soc.cpu;
        let step = Step {
            cycles,
            exception,
            primask: after.primask,
            basepri: after.basepri,
            stack: after.msp,
            pc: before.r[15],
        };
        self.watch.step(&step, |number| cpu.with_sys(|sys| sys.is_active(Exception(number))));
        let commanded_at = self.soc.commanded_at.load(Relaxed);
        if commanded_at != self.commanded_at {
            self.commanded_at = commanded_at;
            if exception == RENDER {
                self.watch.command(commanded_at.saturating_sub(self.event.0));
            }
        }
        if self.soc.fed.get() {
            self.soc.fed.take();
            self.watch.feed(self.now);
        }
        if self.event.1 && exception == SAMPLE {
            let read = self.soc.encoder.read_at.load(Relaxed);
            if read >= self.event.0 {
                self.watch.delay(read - self.event.0);
                self.event.1 = false;
            }
        }
    }

    /// Notes the start of a task. A task may start directly after its own end.
    fn note_entry(&mut self, (was, from): (u16, u32), (exception, pc): (u16, u32)) {
        let Some(addresses) = self.watch.noted() else { return };
        let again = was == exception && from != pc;
        let begins = exception != 0
            && (again || !self.watch.is_active(exception))
            && self.handler(exception) == Some(pc);
        if begins || exception == 0 && was != 0 {
            let words = addresses.map(|address| {
                let mut word = [0; 4];
                self.read(address, &mut word);
                u32::from_le_bytes(word)
            });
            self.watch.enter(exception, words);
        }
    }

    /// Address of an exception's code.
    fn handler(&self, exception: u16) -> Option<u32> {
        let vector = self.memories.flash.get(4 * usize::from(exception)..)?.first_chunk()?;
        Some(u32::from_le_bytes(*vector) & !1)
    }

    /// Resets the chip by its reset pin.
    pub fn reset(&mut self) {
        self.restart("pinrst");
    }

    /// Switches the supply off and on. Only flash keeps its contents.
    pub fn power_cycle(&mut self) {
        for memory in [&self.memories.ram, &self.memories.backup] {
            memory.fill(0, memory.len(), 0).expect(WIRED);
        }
        self.restart("porrst");
    }

    /// Resets everything except the memories and the parts outside the chip.
    fn restart(&mut self, cause: &str) {
        self.memories.flash = self.soc.flash.contents();
        let (open, supply_mv) = (self.soc.stop.load(Relaxed), self.soc.supply.mv());
        self.clock = Arc::new(Clock::default());
        self.clock.set(self.now);
        let encoder = Arc::clone(&self.soc.encoder);
        self.soc = Soc::new(&self.chip, &self.memories, &self.clock, &self.listeners, supply_mv);
        self.soc.encoder.go_on_from(&encoder);
        self.flash_saved = None;
        self.start_anew();
        self.drive_pins();
        self.soc.set_break(open);
        self.soc.note_reset(cause);
        self.registers = self.soc.cpu.regs();
        self.stands = false;
        self.next = self.now;
        self.stalled = 0;
        self.event = (0, false);
        self.resets += 1;
        self.watch.restart();
    }

    /// Number of cycles since power-on.
    pub fn now(&self) -> u64 {
        self.now
    }

    pub fn core_hz(&self) -> u64 {
        self.chip.core_hz
    }

    /// Number of sampling events so far.
    pub fn events(&self) -> u64 {
        self.events
    }

    /// Cycle of the last sampling event, if there was one since the last reset.
    pub fn last_event(&self) -> Option<u64> {
        (self.event.0 > 0).then_some(self.event.0)
    }

    /// Cycle of the last write of a force, to the DAC or to a compare register.
    pub fn written_at(&self) -> u64 {
        self.soc.commanded_at.load(Relaxed)
    }

    /// Number of resets so far. Power-on does not count.
    pub fn resets(&self) -> u64 {
        self.resets
    }

    /// Addresses of the instructions that ended in a hard fault.
    pub fn hard_faults(&self) -> &[u32] {
        &self.hard_faults
    }

    pub fn instructions(&self) -> u64 {
        self.instructions
    }

    pub fn is_asleep(&self) -> bool {
        self.soc.cpu.is_asleep()
    }

    /// Number of cycles for which the core has slept so far.
    pub fn asleep(&self) -> u64 {
        self.asleep
    }

    pub fn watch(&self) -> &Watch {
        &self.watch
    }

    pub fn watch_mut(&mut self) -> &mut Watch {
        &mut self.watch
    }

    pub fn bench(&self) -> &Bench {
        &self.listeners.bench
    }

    pub fn pin(&self, pin: Pin) -> bool {
        self.soc.pin(pin)
    }

    /// Advances the timers, and delivers all changes of pins up to now.
    pub fn settle(&mut self) {
        self.settle_to(self.now);
    }

    /// Does the same as [`settle`](Self::settle), but delivers the encoder's edges only up to `cycle`, within the last
    /// instruction. The caller may still add later edges. A timer that was advanced beyond these edges would capture
    /// them late.
    pub fn settle_to(&mut self, cycle: u64) {
        self.clock.set(self.now);
        self.soc.pwm.catch_up_by_edges();
        self.soc.encoder.deliver(cycle);
    }

    /// Reads RAM. Addresses outside RAM read as zero.
    pub fn read(&self, address: u32, into: &mut [u8]) {
        if self.memories.ram.read_at(u64::from(address.wrapping_sub(RAM)), into).is_err() {
            into.fill(0);
        }
    }

    /// Writes RAM. Writes outside RAM are ignored.
    pub fn write(&mut self, address: u32, from: &[u8]) {
        let _ = self.memories.ram.write_at(u64::from(address.wrapping_sub(RAM)), from);
    }

    pub fn flash(&self) -> Vec<u8> {
        self.soc.flash.contents()
    }
}

fn exception_of(xpsr: u32) -> u16 {
    (xpsr & 0x1FF) as u16
}
