//! Simulated time, and how the peripherals are connected to the bus.

use std::{
    fmt,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering::Relaxed},
    },
};

use rsemu::core::{
    device::Device,
    space::{AccessConstraints, MemAttrs, MemOps, MemResult, Region, RegionKind},
    value::Width,
};

use super::{DacListener, gate::Block};

/// Simulated time, in core cycles of the clock that the program has set up.
#[derive(Debug, Default)]
pub(super) struct Clock {
    /// Start of the present instruction, in cycles.
    now: AtomicU64,
    /// Time of the edge that is being delivered, in cycles. For an event of TIM1, the edge may be earlier than `now`.
    edge: AtomicU64,
    /// Whether a peripheral was accessed, which may have changed the time of its next event.
    touched: AtomicBool,
    /// Whether the chip's clock differs from the clock that was set up.
    changed: AtomicBool,
    /// State of a changed clock. The four fields are the cycle of the change, the cycles lost before the change, the
    /// present frequency and the frequency that the program has set up. Frequencies are in MHz.
    since: AtomicU64,
    lost: AtomicU64,
    mhz: AtomicU64,
    set_up_mhz: AtomicU64,
}

impl Clock {
    pub(super) fn now(&self) -> u64 {
        self.now.load(Relaxed)
    }

    pub(super) fn set(&self, now: u64) {
        self.now.store(now, Relaxed);
        self.edge.store(now, Relaxed);
    }

    pub(super) fn edge(&self) -> u64 {
        self.edge.load(Relaxed)
    }

    pub(super) fn take_touched(&self) -> bool {
        // The program has one thread. An atomic swap would make each step about as slow as an instruction.
        let touched = self.touched.load(Relaxed);
        if touched {
            self.touched.store(false, Relaxed);
        }
        touched
    }

    /// Changes the chip's clock to `mhz` from now on. The program has set up `set_up_mhz`.
    pub(super) fn change(&self, mhz: u64, set_up_mhz: u64) {
        let now = self.now();
        self.lost.store(now - self.own(now), Relaxed);
        self.since.store(now, Relaxed);
        self.mhz.store(mhz, Relaxed);
        self.set_up_mhz.store(set_up_mhz, Relaxed);
        self.changed.store(true, Relaxed);
    }

    #[inline(always)]
    pub(super) fn is_changed(&self) -> bool {
        self.changed.load(Relaxed)
    }

    #[inline(always)]
    pub(super) fn stands(&self) -> bool {
        self.changed.load(Relaxed) && self.mhz.load(Relaxed) == 0
    }

    /// Duration of `cycles` cycles of the chip's clock, in cycles of the clock that was set up.
    #[inline(always)]
    pub(super) fn stretched(&self, cycles: u64) -> u64 {
        if !self.changed.load(Relaxed) {
            return cycles;
        }
        (cycles * self.set_up_mhz.load(Relaxed)).div_ceil(self.mhz.load(Relaxed).max(1))
    }

    /// Number of cycles that the chip's clock has counted up to `cycle`.
    fn own(&self, cycle: u64) -> u64 {
        if !self.changed.load(Relaxed) {
            return cycle;
        }
        let (since, lost) = (self.since.load(Relaxed), self.lost.load(Relaxed));
        let passed = cycle.saturating_sub(since);
        let (mhz, set_up) = (self.mhz.load(Relaxed), self.set_up_mhz.load(Relaxed));
        cycle.min(since).saturating_sub(lost) + passed * mhz / set_up
    }

    /// The cycle at which the chip's clock reaches `count`.
    fn when_own(&self, count: u64) -> u64 {
        if !self.changed.load(Relaxed) || count == u64::MAX {
            return count;
        }
        let (since, lost) = (self.since.load(Relaxed), self.lost.load(Relaxed));
        let left = count.saturating_sub(since - lost);
        match self.mhz.load(Relaxed) {
            _ if left == 0 => count.saturating_add(lost),
            0 => u64::MAX,
            mhz => since
                .saturating_add(left.saturating_mul(self.set_up_mhz.load(Relaxed)).div_ceil(mhz)),
        }
    }

    pub(super) fn state(&self) -> ClockState {
        let all = [&self.now, &self.edge, &self.since, &self.lost, &self.mhz, &self.set_up_mhz];
        (
            all.map(|word| word.load(Relaxed)),
            [&self.touched, &self.changed].map(|flag| flag.load(Relaxed)),
        )
    }

    pub(super) fn restore(&self, (words, flags): &ClockState) {
        let all = [&self.now, &self.edge, &self.since, &self.lost, &self.mhz, &self.set_up_mhz];
        all.into_iter().zip(words).for_each(|(to, from)| to.store(*from, Relaxed));
        let all = [&self.touched, &self.changed];
        all.into_iter().zip(flags).for_each(|(to, from)| to.store(*from, Relaxed));
    }
}

/// The fields of a [`Clock`], for a snapshot.
pub(super) type ClockState = ([u64; 6], [bool; 2]);

/// Actions before and after an access of a bus master to a device's registers.
pub(super) trait Port: Send + Sync + fmt::Debug {
    /// Runs before every access. Advances the device to the present.
    fn before(&self);
    /// Runs before a word is written to `offset`. Returns the value to write.
    fn write(&self, _offset: u64, value: u32) -> u32 {
        value
    }
    /// Runs after a word was read from `offset`. Returns the value that the core gets.
    fn read(&self, _offset: u64, value: u32) -> u32 {
        value
    }
    /// Reads a register for a debugger, without side effects.
    fn look(&self, offset: u64, value: u32) -> u32 {
        self.read(offset, value)
    }
}

/// A device whose clock is the core's clock, divided by an integer. The device is advanced only when it is accessed.
#[derive(Clone)]
pub(super) struct Lazy {
    pub(super) device: Arc<dyn Device>,
    operations: Arc<dyn MemOps>,
    clock: Arc<Clock>,
    /// Core cycles per tick.
    divider: u64,
    /// Whether the device's clock does not depend on the chip's clock.
    apart: bool,
    /// Core cycles for which the device was stopped while the core was halted.
    pub(super) stood: Arc<AtomicU64>,
    /// The cycle to which the device must be advanced before an access. 0 means that it is up to date.
    owed: Arc<AtomicU64>,
}

impl fmt::Debug for Lazy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Lazy").finish_non_exhaustive()
    }
}

impl Lazy {
    pub(super) fn new(device: Arc<dyn Device>, divider: u64, clock: &Arc<Clock>) -> Self {
        let operations = registers_of(&*device);
        let clock = Arc::clone(clock);
        let [stood, owed] = [Arc::default(), Arc::default()];
        Self { device, operations, clock, divider, apart: false, stood, owed }
    }

    /// Makes the device's clock independent. It then runs on when the chip's clock stops.
    pub(super) fn apart(self) -> Self {
        Self { apart: true, ..self }
    }

    pub(super) fn advance_to(&self, cycle: u64) {
        let owed = self.owed.load(Relaxed);
        self.owed.store(0, Relaxed);
        let cycle = cycle.max(owed);
        let cycle = if self.apart { cycle } else { self.clock.own(cycle) };
        self.device.advance_to(cycle.saturating_sub(self.stood.load(Relaxed)) / self.divider);
    }

    /// Advances the device to `cycle` if an event is due by then. Otherwise only stores `cycle` as owed.
    #[inline]
    pub(super) fn bring_to(&self, cycle: u64) {
        if self.next_event() <= cycle {
            self.advance_to(cycle);
        } else {
            self.owed.store(self.owed.load(Relaxed).max(cycle), Relaxed);
        }
    }

    /// Advances the device to the owed cycle. Call this function before an access and before a change of the device's
    /// time.
    #[inline]
    pub(super) fn pay(&self) {
        let owed = self.owed.load(Relaxed);
        if owed > 0 {
            self.advance_to(owed);
        }
    }

    /// Clears the owed cycle, after the device's state was replaced.
    pub(super) fn owe_nothing(&self) {
        self.owed.store(0, Relaxed);
    }

    pub(super) fn stand_still(&self, cycles: u64) {
        self.pay();
        self.stood.fetch_add(cycles, Relaxed);
    }

    /// Advances the device to the present like [`bring_to`](Self::bring_to), but event by event. So each edge is
    /// delivered at its own time.
    pub(super) fn catch_up_by_edges(&self) {
        let now = self.clock.now();
        loop {
            let next = self.next_event();
            if next > now {
                break;
            }
            self.clock.edge.store(next, Relaxed);
            self.advance_to(next);
        }
        self.clock.edge.store(now, Relaxed);
        self.bring_to(now);
    }

    /// Cycle of the device's next event.
    pub(super) fn next_event(&self) -> u64 {
        let count = self.device.next_event_tick().map_or(u64::MAX, |tick| {
            tick.saturating_mul(self.divider).saturating_add(self.stood.load(Relaxed))
        });
        if self.apart { count } else { self.clock.when_own(count) }
    }

    /// Reads a register without side effects.
    pub(super) fn peek(&self, offset: u64) -> u32 {
        self.pay();
        let mut word = [0; 4];
        // A missing register reads as 0.
        let _ = self.operations.read(offset, &mut word, MemAttrs::DEBUG);
        u32::from_le_bytes(word)
    }

    /// Writes a register as the core would.
    pub(super) fn poke(&self, offset: u64, value: u32) {
        self.pay();
        let _ = self.operations.write(offset, &value.to_le_bytes(), MemAttrs::default());
    }
}

pub(super) fn registers_of(device: &dyn Device) -> Arc<dyn MemOps> {
    let region = device.region("").expect("a device with registers");
    let RegionKind::Io(operations) = region.kind() else { panic!("registers are an I/O region") };
    Arc::clone(operations)
}

/// A device's registers on the bus, behind a [`Port`].
#[derive(Debug)]
pub(super) struct Registers<P> {
    lazy: Lazy,
    port: P,
}

impl<P: Port + 'static> Registers<P> {
    pub(super) fn region(lazy: &Lazy, port: P) -> Region {
        let length = lazy.device.region("").map_or(0x400, |region| region.len());
        Region::io("registers", length, Arc::new(Self { lazy: lazy.clone(), port }))
    }
}

impl<P: Port> MemOps for Registers<P> {
    fn read(&self, offset: u64, into: &mut [u8], attributes: MemAttrs) -> MemResult {
        self.port.before();
        self.lazy.pay();
        self.lazy.clock.touched.store(true, Relaxed);
        if into.len() < 4 && self.lazy.operations.constraints().min == Width::U32 {
            let mut word = [0; 4];
            self.lazy.operations.read(offset & !3, &mut word, attributes)?;
            let start = (offset & 3) as usize;
            into.copy_from_slice(&word[start..start + into.len()]);
            return Ok(());
        }
        self.lazy.operations.read(offset, into, attributes)?;
        if let Ok(word) = <[u8; 4]>::try_from(&*into) {
            let word = u32::from_le_bytes(word);
            let word = if attributes.debug {
                self.port.look(offset, word)
            } else {
                self.port.read(offset, word)
            };
            into.copy_from_slice(&word.to_le_bytes());
        }
        Ok(())
    }

    fn write(&self, offset: u64, from: &[u8], attributes: MemAttrs) -> MemResult {
        self.port.before();
        self.lazy.pay();
        self.lazy.clock.touched.store(true, Relaxed);
        if let Ok(word) = <[u8; 4]>::try_from(from) {
            let word = self.port.write(offset, u32::from_le_bytes(word)).to_le_bytes();
            return self.lazy.operations.write(offset, &word, attributes);
        }
        if self.lazy.operations.constraints().min == Width::U32 {
            // The bus bridge puts a half-word on both halves of the word. The blocks here use the lower half.
            let mut word = [0; 4];
            word[..from.len()].copy_from_slice(from);
            let word = self.port.write(offset & !3, u32::from_le_bytes(word)).to_le_bytes();
            return self.lazy.operations.write(offset & !3, &word, attributes);
        }
        self.lazy.operations.write(offset, from, attributes)
    }

    fn constraints(&self) -> AccessConstraints {
        // Peripherals of these chips accept half-words, but some devices of the emulator accept only words.
        let mut constraints = self.lazy.operations.constraints();
        constraints.min = Width::U8;
        constraints
    }
}

/// A port that only advances its device before an access.
#[derive(Debug)]
pub(super) struct Plain(pub(super) Lazy);

impl Port for Plain {
    fn before(&self) {
        self.0.advance_to(self.0.clock.now());
    }
}

/// A block of registers that store what is written, without a model of the device.
#[derive(Debug)]
pub(super) struct Storage {
    words: Vec<AtomicU32>,
}

impl Storage {
    /// 1 KiB of registers with the value 0.
    pub(super) fn new() -> Arc<Self> {
        Arc::new(Self { words: (0..256).map(|_| AtomicU32::new(0)).collect() })
    }

    pub(super) fn region(self: &Arc<Self>) -> Region {
        Region::io("storage", 0x400, Arc::clone(self) as Arc<dyn MemOps>)
    }

    fn word(&self, offset: u64) -> &AtomicU32 {
        let index = usize::try_from(offset / 4).unwrap_or(0);
        &self.words[index % self.words.len()]
    }

    pub(super) fn get(&self, offset: u64) -> u32 {
        self.word(offset).load(Relaxed)
    }

    pub(super) fn set(&self, offset: u64, value: u32) {
        self.word(offset).store(value, Relaxed);
    }

    pub(super) fn words(&self) -> Vec<u32> {
        self.words.iter().map(|word| word.load(Relaxed)).collect()
    }

    pub(super) fn restore(&self, words: &[u32]) {
        for (to, from) in self.words.iter().zip(words) {
            to.store(*from, Relaxed);
        }
    }
}

impl MemOps for Storage {
    fn read(&self, offset: u64, into: &mut [u8], _: MemAttrs) -> MemResult {
        let word = self.get(offset).to_le_bytes();
        let start = (offset & 3) as usize;
        for (to, from) in into.iter_mut().zip(&word[start..]) {
            *to = *from;
        }
        Ok(())
    }

    fn write(&self, offset: u64, from: &[u8], _: MemAttrs) -> MemResult {
        let cell = self.word(offset);
        let mut word = cell.load(Relaxed).to_le_bytes();
        let start = (offset & 3) as usize;
        for (to, from) in word[start..].iter_mut().zip(from) {
            *to = *from;
        }
        cell.store(u32::from_le_bytes(word), Relaxed);
        Ok(())
    }
}

/// The DAC. While channel 1 is enabled, the output has the value of the channel's holding register.
pub(super) struct Dac {
    pub(super) registers: Arc<Storage>,
    pub(super) clock: Arc<Clock>,
    pub(super) written_at: Arc<AtomicU64>,
    pub(super) listener: Option<Arc<dyn DacListener>>,
}

impl fmt::Debug for Dac {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Dac").finish_non_exhaustive()
    }
}

impl Dac {
    const CR: u64 = 0x00;
    const DHR12R1: u64 = 0x08;

    fn tell(&self) {
        self.written_at.store(self.clock.now(), Relaxed);
        if let Some(listener) = &self.listener {
            let on = self.registers.get(Self::CR) & 1 != 0;
            let code = self.registers.get(Self::DHR12R1) & 0xFFF;
            listener.code(self.clock.now(), on.then_some(code));
        }
    }
}

impl Block for Dac {
    fn reset(&self) {
        self.registers.restore(&[0; 256]);
        self.tell();
    }
}

impl MemOps for Dac {
    fn read(&self, offset: u64, into: &mut [u8], attributes: MemAttrs) -> MemResult {
        self.registers.read(offset, into, attributes)
    }

    fn write(&self, offset: u64, from: &[u8], attributes: MemAttrs) -> MemResult {
        self.registers.write(offset, from, attributes)?;
        self.tell();
        Ok(())
    }
}
