//! The devices around the core, with their addresses and connections.

use std::sync::{
    Arc,
    atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering::Relaxed},
};

use rsemu::{
    core::{
        device::Device,
        props::Props,
        space::{AddressSpace, DispatchPolicy, RamStore, Region, RegionRef},
        wire::{Level, WireBuilder, WireId, WireIdAllocator, WireSink, WireSource},
    },
    cpu::arm::v7m::{ArmV7m, Config},
    dev::stm32::{exti::Exti, flash::Flash, gpio::Gpio, iwdg::Iwdg, pwr::Pwr, rcc::Rcc, tim::Tim},
};

use super::{
    Chip, Listeners, Pin, PinListener, RAM, RAM_BYTES,
    bench::{FlashPort, PacePort, WIRES, Wire},
    bus::{Clock, Dac, Lazy, Plain, Port, Registers, Storage},
    converter::Converters,
    crystal::{ClockPort, Crystal},
    dma::Dma,
    encoder::{CapturePort, CounterPort, EncoderInput},
    flag::{Flag, Latch},
    gate::Gate,
    main_output::{BDTR, BREAK_ENABLE, Break, BreakInput, MAIN_OUTPUT_ENABLE, Unlock},
    reads::Noted,
    supply::{PowerPort, Supply},
};

/// Message for errors of the emulator's set-up. Such an error is an error of this crate, because the set-up consists of
/// constants.
pub(super) const WIRED: &str = "the emulator has this device, property and pin";

#[derive(Clone)]
pub(super) struct Memories {
    pub(super) ram: Arc<RamStore>,
    pub(super) backup: Arc<RamStore>,
    pub(super) flash: Vec<u8>,
}

pub(super) struct Soc {
    pub(super) cpu: ArmV7m,
    pub(super) pace: Lazy,
    pub(super) pwm: Lazy,
    pub(super) encoder: Arc<EncoderInput>,
    pub(super) flash: Arc<Flash>,
    /// The flash's registers. `flash_touched` is the number of accesses to these registers.
    pub(super) flash_registers: Lazy,
    pub(super) flash_touched: Arc<AtomicU64>,
    pub(super) rcc: Lazy,
    pub(super) others: Vec<Lazy>,
    exti: Lazy,
    pub(super) pace_line: Arc<Flag>,
    /// Interrupt line of the supply detector.
    pub(super) supply_line: Arc<Flag>,
    pub(super) watchdog_bites: Arc<Flag>,
    /// Whether the watchdog was fed since the flag was last read.
    pub(super) fed: Arc<Flag>,
    pub(super) stop: Arc<AtomicBool>,
    /// The break flag of TIM1.
    pub(super) broken: Arc<AtomicBool>,
    /// The pin to which the emergency stop is connected.
    input: Option<BreakInput>,
    /// Whether BDTR was written since the reset. The first write freezes its lock level.
    locked: Arc<AtomicBool>,
    pub(super) supply: Arc<Supply>,
    pub(super) dbgmcu: Arc<Storage>,
    halt_timer: Lazy,
    /// TIM8. The update of TIM8 requests a store by DMA2, and this store switches the output off.
    pub(super) output_timer: Lazy,
    pub(super) crystal: Arc<Crystal>,
    pub(super) dma: Arc<Dma>,
    pub(super) dma_gate: Arc<Gate>,
    pub(super) space: Arc<AddressSpace>,
    watchdog: Lazy,
    pub(super) dac: Arc<Storage>,
    pub(super) adc: Arc<Storage>,
    /// Cycle of the last write of a force, to the DAC or to a compare register.
    pub(super) commanded_at: Arc<AtomicU64>,
    gpio: Vec<Arc<Gpio>>,
}

pub(super) const FLAGS: usize = 10;

/// Longest time to program a word of 32 bits, and longest time to erase 16 KiB at this width (data sheets of STM32F446
/// and STM32F407, 6.3.12 and 5.3.12: flash memory programming).
const PROGRAM_US: u64 = 100;
const ERASE_MS: u64 = 500;

#[derive(Debug)]
struct WatchdogPort {
    lazy: Lazy,
    clock: Arc<Clock>,
    fed: Arc<Flag>,
}

/// Value of the register KR that feeds the watchdog. KR is at offset 0.
const RELOAD: u32 = 0xAAAA;

impl Port for WatchdogPort {
    fn before(&self) {
        self.lazy.advance_to(self.clock.now());
    }

    fn write(&self, offset: u64, value: u32) -> u32 {
        if (offset, value) == (0, RELOAD) {
            self.fed.0.store(true, Relaxed);
        }
        value
    }
}

/// Connects a timer channel to the alternate function of one pin.
struct ToPort(Arc<Gpio>, u32);

impl WireSink for ToPort {
    fn set_level(&self, _: WireId, _: u32, level: Level) {
        self.0.set_alternate(self.1, level.is_high());
    }
}

struct ToListener(Arc<dyn PinListener>, Arc<Clock>, Pin);

impl WireSink for ToListener {
    fn set_level(&self, _: WireId, _: u32, level: Level) {
        self.0.level(self.1.edge(), self.2, level.is_high());
    }
}

const RCC_CSR: u64 = 0x74;
const RMVF: u32 = 1 << 24;
const DBGMCU_APB1_FZ: u64 = 0x08;
const DBGMCU_APB2_FZ: u64 = 0x0C;

impl Soc {
    /// Sets the break input. While the input is active and the break is enabled, MOE stays clear.
    pub(super) fn set_break(&self, open: bool) {
        self.stop.store(open, Relaxed);
        if open && self.input.as_ref().is_some_and(BreakInput::is_connected) {
            self.break_output();
        }
    }

    /// Applies the start of a break.
    pub(super) fn break_output(&self) {
        let bdtr = self.pwm.peek(BDTR);
        if bdtr & BREAK_ENABLE != 0 {
            self.broken.store(true, Relaxed);
            self.pwm.catch_up_by_edges();
            self.pwm.poke(BDTR, bdtr & !MAIN_OUTPUT_ENABLE);
        }
    }

    #[expect(clippy::too_many_lines, reason = "one table of the chip, read from top to bottom")]
    pub(super) fn new(
        chip: &Chip,
        memories: &Memories,
        clock: &Arc<Clock>,
        listeners: &Listeners,
        supply_mv: u32,
    ) -> Self {
        let ids = WireIdAllocator::new();
        let wire = |device: &dyn Device, port: &str, sink: Arc<dyn WireSink>| {
            let id = ids.alloc();
            let wire = WireBuilder::new().source(id).sink(sink, 0).build_shared();
            device.connect(port, WireSource::new(wire, id)).expect(WIRED);
        };
        let timer = |variant: &str, width: u64| {
            let reset = if width == 32 { u64::from(u32::MAX) } else { 0xFFFF };
            let props =
                Props::new().with("variant", variant).with("width", width).with("arr-reset", reset);
            Arc::new(Tim::new(&props).expect(WIRED))
        };
        let pwm_timer = timer("advanced", 16);
        let encoder_timer = timer("general", 32);
        let pace_timer = timer("general", 32);
        let capture_timer = timer("general", 16);
        let halt_timer = timer("basic", 16);
        let output_timer = timer("advanced", 16);
        let rcc = Arc::new(
            Rcc::new(&Props::new().with("variant", "f4").with("hse", 8_000_000u64)).expect(WIRED),
        );
        let pwr = Arc::new(
            Pwr::new(&Props::new().with("variant", if chip.over_drive { "f42x" } else { "f4" }))
                .expect(WIRED),
        );
        let flash = Arc::new(
            Flash::new(
                &Props::new()
                    .with("variant", "f4")
                    .with("size", memories.flash.len() as u64)
                    .with("program-time", chip.core_hz / 1_000_000 * PROGRAM_US)
                    .with("erase-time", chip.core_hz / 1000 * ERASE_MS),
            )
            .expect(WIRED),
        );
        flash.load_image(0, &memories.flash).expect(WIRED);
        let watchdog = Arc::new(Iwdg::with_window(false));
        let gpio: Vec<_> = (0..5)
            .map(|port| {
                let moder = [0xA800_0000u64, 0x280, 0, 0, 0][port];
                Arc::new(Gpio::new(&Props::new().with("moder-reset", moder)).expect(WIRED))
            })
            .collect();

        let dac = Storage::new();
        let adc = Storage::new();
        let commanded_at = Arc::new(AtomicU64::new(0));
        let dma = Dma::new();
        let dma_gate = Gate::of(Arc::clone(&dma) as _);
        let converters = Gate::of(Arc::new(Converters {
            registers: Arc::clone(&adc),
            dac: Arc::clone(&dac),
            written_at: Arc::clone(&commanded_at),
            clock: Arc::clone(clock),
            bench: Arc::clone(&listeners.bench),
        }));
        let dac_gate = Gate::of(Arc::new(Dac {
            registers: Arc::clone(&dac),
            clock: Arc::clone(clock),
            written_at: Arc::clone(&commanded_at),
            listener: listeners.dac.clone(),
        }));
        let locked = Arc::new(AtomicBool::new(false));
        let broken = Arc::new(AtomicBool::new(false));
        // RCC's clock and reset bits of a block.
        let from_rcc = |bit: &str, id: WireId, sink: Arc<dyn WireSink>, line: u32| {
            let wire = WireBuilder::new().source(id).sink(sink, line).build_shared();
            rcc.connect(bit, WireSource::new(wire, id)).expect(WIRED);
            rcc.announce(bit);
        };
        let gated: [(&str, u32, &dyn Device); 12] = [
            ("ahb1", 0, &*gpio[0]),
            ("ahb1", 1, &*gpio[1]),
            ("ahb1", 2, &*gpio[2]),
            ("ahb1", 3, &*gpio[3]),
            ("ahb1", 4, &*gpio[4]),
            ("apb1", 0, &*encoder_timer),
            ("apb1", 1, &*capture_timer),
            ("apb1", 3, &*pace_timer),
            ("apb1", 4, &*halt_timer),
            ("apb1", 28, &*pwr),
            ("apb2", 0, &*pwm_timer),
            ("apb2", 1, &*output_timer),
        ];
        for (bus, bit, device) in gated {
            for (register, pin) in [("en", "enable"), ("rst", "reset")] {
                let id = ids.alloc();
                let sink = device.sink(pin, &[id]).expect(WIRED);
                from_rcc(&format!("{bus}{register}{bit}"), id, sink.sink, sink.line);
            }
        }
        for (bus, bit, gate) in
            [("ahb1", 22, &dma_gate), ("apb1", 29, &dac_gate), ("apb2", 8, &converters)]
        {
            from_rcc(&format!("{bus}en{bit}"), ids.alloc(), Arc::clone(&gate.clocked) as _, 0);
            from_rcc(&format!("{bus}rst{bit}"), ids.alloc(), Arc::clone(gate) as _, 0);
        }
        let unlock = Unlock { locked: Arc::clone(&locked), broken: Arc::clone(&broken) };
        from_rcc("apb2rst0", ids.alloc(), Arc::new(unlock), 0);
        wire(&*output_timer, "dma-up", Arc::new(Latch(Arc::clone(&dma.request))));
        let pace_line = Arc::new(Flag::default());
        wire(&*pace_timer, "irq", Arc::clone(&pace_line) as _);
        let watchdog_bites = Arc::new(Flag::default());
        wire(&*watchdog, "reset", Arc::new(Latch(Arc::clone(&watchdog_bites))));
        for (channel, pin) in &listeners.channels {
            let port = Arc::clone(&gpio[pin.port_index()]);
            wire(&*pwm_timer, channel, Arc::new(ToPort(port, u32::from(pin.number))));
        }
        for (pin, listener) in &listeners.pins {
            let sink = ToListener(Arc::clone(listener), Arc::clone(clock), *pin);
            wire(&*gpio[pin.port_index()], &format!("p{}", pin.number), Arc::new(sink));
        }
        let inputs = |timer: &Tim| {
            ["ti1", "ti2"].map(|name| {
                let id = ids.alloc();
                (id, timer.sink(name, &[id]).expect(WIRED))
            })
        };
        let counted = inputs(&encoder_timer);
        let captured = listeners.captured.then(|| inputs(&capture_timer));

        let lazy = |device: Arc<dyn Device>, divider| Lazy::new(device, divider, clock);
        let pwm = lazy(pwm_timer, 1);
        let pace = lazy(pace_timer, 2);
        let halt_timer = lazy(halt_timer, 2);
        let output_timer = lazy(output_timer, 1);
        // RCC needs a clock only for the delays of the ready bits. The unit is cycles of HSE.
        let rcc = lazy(rcc, chip.core_hz / 8_000_000).apart();
        let pwr = lazy(pwr, 8);
        let flash_registers = lazy(Arc::clone(&flash) as _, 1);
        let watchdog = lazy(watchdog, chip.core_hz / 32_000).apart();
        let encoder = Arc::new(EncoderInput::new(
            (lazy(encoder_timer, 2), counted),
            (lazy(capture_timer, 2), captured),
        ));

        for (channel, (port, number)) in WIRES.into_iter().enumerate() {
            let (encoder, clock) = (Arc::clone(&encoder), Arc::clone(clock));
            let sink = Wire { encoder, channel, clock, bench: Arc::clone(&listeners.bench) };
            wire(&*gpio[port], &format!("p{number}"), Arc::new(sink));
        }

        let stop = Arc::new(AtomicBool::new(false));
        let supply = Supply::of_mv(supply_mv);
        let supply_line = Arc::new(Flag::default());
        let exti = Arc::new(Exti::new(&Props::new()).expect(WIRED));
        wire(&*exti, "irq16", Arc::clone(&supply_line) as _);
        let id = ids.alloc();
        supply.connect(id, exti.sink("line16", &[id]).expect(WIRED));
        let exti = lazy(exti, 1);
        let dbgmcu = Storage::new();
        dbgmcu.set(0, chip.id);
        // Flash and RAM are found in a table, which halves the time of an access. Other devices are found by a search.
        let cover = u64::from(RAM + RAM_BYTES);
        let table = DispatchPolicy::Dense { page_bits: 16, cover };
        let space = AddressSpace::new("cpu", 32).with_dispatch(table);
        let map = |region: Region, address: u64| {
            space.topology().map(region, address).expect("addresses do not overlap");
        };
        let map_shared = |region: Option<RegionRef>, address: u64| {
            space.topology().map(region.expect(WIRED), address).expect("addresses do not overlap");
        };
        map_shared(flash.region("array"), 0x0800_0000);
        let ram = match &listeners.reads {
            None => Region::ram("ram", Arc::clone(&memories.ram)),
            Some(words) => Noted::region(&memories.ram, words),
        };
        map(ram, 0x2000_0000);
        map(Region::ram("backup", Arc::clone(&memories.backup)), 0x4002_4000);
        map(
            Registers::region(
                &encoder.counter,
                CounterPort(Arc::clone(&encoder), Arc::clone(clock)),
            ),
            0x4000_0000,
        );
        map(
            Registers::region(
                &encoder.capture,
                CapturePort(Arc::clone(&encoder), Arc::clone(clock)),
            ),
            0x4000_0400,
        );
        let bench = &listeners.bench;
        let port = PacePort {
            lazy: pace.clone(),
            clock: Arc::clone(clock),
            bench: Arc::clone(bench),
            core_hz: chip.core_hz,
            option: AtomicU32::new(0),
            read: AtomicU64::new(0),
        };
        map(Registers::region(&pace, port), 0x4000_0C00);
        map(Registers::region(&halt_timer, Plain(halt_timer.clone())), 0x4000_1000);
        map(Registers::region(&output_timer, Plain(output_timer.clone())), 0x4001_0400);
        map(dma_gate.region(), 0x4002_6400);
        let fed = Arc::new(Flag::default());
        let port = WatchdogPort {
            lazy: watchdog.clone(),
            clock: Arc::clone(clock),
            fed: Arc::clone(&fed),
        };
        map(Registers::region(&watchdog, port), 0x4000_3000);
        map(
            Registers::region(
                &pwr,
                PowerPort {
                    lazy: pwr.clone(),
                    clock: Arc::clone(clock),
                    supply: Arc::clone(&supply),
                },
            ),
            0x4000_7000,
        );
        map(Registers::region(&exti, Plain(exti.clone())), 0x4001_3C00);
        map(converters.region(), 0x4001_2000);
        map(dac_gate.region(), 0x4000_7400);
        let open = Arc::clone(&stop);
        let clock = Arc::clone(clock);
        let input = listeners.stop.map(|pin| BreakInput::new(&*gpio[pin.port_index()], pin.number));
        let crystal = Arc::<Crystal>::default();
        let port = Break {
            lazy: pwm.clone(),
            open,
            crystal: Arc::clone(&crystal),
            broken: Arc::clone(&broken),
            locked: Arc::clone(&locked),
            input: input.clone(),
            clock: Arc::clone(&clock),
            written_at: Arc::clone(&commanded_at),
        };
        map(Registers::region(&pwm, port), 0x4001_0000);
        for (index, port) in gpio.iter().enumerate() {
            map_shared(port.region(""), 0x4002_0000 + 0x400 * index as u64);
        }
        let port = ClockPort {
            lazy: rcc.clone(),
            clock: Arc::clone(&clock),
            crystal: Arc::clone(&crystal),
            gated: [&pwm, &pace, &halt_timer, &output_timer, &encoder.counter, &encoder.capture]
                .map(Lazy::clone)
                .to_vec(),
        };
        map(Registers::region(&rcc, port), 0x4002_3800);
        let flash_touched = Arc::new(AtomicU64::new(0));
        let port = FlashPort {
            lazy: flash_registers.clone(),
            clock: Arc::clone(&clock),
            touched: Arc::clone(&flash_touched),
            bench: Arc::clone(bench),
        };
        map(Registers::region(&flash_registers, port), 0x4002_3C00);
        map(dbgmcu.region(), 0xE004_2000);

        // The chips have 4 priority bits; the emulator's default is 3.
        let mut config = Config::CORTEX_M4F;
        config.reset_vtor = 0x0800_0000;
        let cpu = ArmV7m::new(config.with_priority_bits(4));
        let space = Arc::new(space);
        cpu.attach_space(Arc::clone(&space));
        Self {
            cpu,
            pace,
            pwm,
            encoder,
            flash,
            rcc: rcc.clone(),
            flash_registers,
            flash_touched,
            others: vec![rcc, pwr, watchdog.clone(), output_timer.clone()],
            exti,
            halt_timer,
            output_timer,
            crystal,
            dma,
            dma_gate,
            space,
            watchdog,
            pace_line,
            supply_line,
            watchdog_bites,
            fed,
            stop,
            broken,
            input,
            locked,
            supply,
            dbgmcu,
            dac,
            adc,
            commanded_at,
            gpio,
        }
    }

    /// Sets RCC's flags as after a reset by `cause`. Each reset also pulls the reset pin.
    pub(super) fn note_reset(&self, cause: &str) {
        // A reset of the block itself leaves the flags of power-on. RMVF clears these flags.
        self.rcc.poke(RCC_CSR, RMVF);
        for input in ["pinrst", cause] {
            let id = WireIdAllocator::new().alloc();
            let pin = self.rcc.device.sink(input, &[id]).expect(WIRED);
            pin.sink.set_level(id, pin.line, Level::from_bool(true));
            pin.sink.set_level(id, pin.line, Level::from_bool(false));
        }
    }

    pub(super) fn tim1_stops(&self) -> bool {
        self.dbgmcu.get(DBGMCU_APB2_FZ) & 1 != 0
    }

    pub(super) fn tim5_stops(&self) -> bool {
        self.dbgmcu.get(DBGMCU_APB1_FZ) >> 3 & 1 != 0
    }

    /// Stops the blocks whose DBGMCU bits are set while the core is halted for `cycles`.
    pub(super) fn stand_still(&self, cycles: u64) {
        let [apb1, apb2] = [DBGMCU_APB1_FZ, DBGMCU_APB2_FZ].map(|offset| self.dbgmcu.get(offset));
        for (register, bit, device) in [
            (apb1, 0, &self.encoder.counter),
            (apb1, 1, &self.encoder.capture),
            (apb1, 3, &self.pace),
            (apb1, 4, &self.halt_timer),
            (apb1, 12, &self.watchdog),
            (apb2, 0, &self.pwm),
            (apb2, 1, &self.output_timer),
        ] {
            if register >> bit & 1 != 0 {
                device.stand_still(cycles);
            }
        }
    }

    pub(super) fn rcc_and_power(&self) -> impl Iterator<Item = &dyn Device> {
        self.others[..2].iter().chain([&self.exti]).map(|lazy| &*lazy.device)
    }

    pub(super) fn timers(&self) -> impl Iterator<Item = &Lazy> {
        let encoder = &self.encoder;
        let [tim1, tim5] = [&self.pwm, &self.pace];
        let others = [&self.halt_timer, &self.output_timer, &self.watchdog];
        [tim1, tim5, &encoder.counter, &encoder.capture].into_iter().chain(others)
    }

    pub(super) fn lazies(&self) -> impl Iterator<Item = &Lazy> {
        self.timers().chain(&self.others).chain([&self.exti, &self.flash_registers])
    }

    pub(super) fn ports(&self) -> impl Iterator<Item = &dyn Device> {
        self.gpio.iter().map(|port| &**port as &dyn Device)
    }

    /// The flags that a snapshot saves. They are the interrupt lines, the watchdog's reset, TIM8's request, the stop,
    /// the break flag, BDTR's lock, and the crystal's state.
    pub(super) fn flags(&self) -> [&AtomicBool; FLAGS] {
        let [pace, supply, bites, asks] =
            [&self.pace_line, &self.supply_line, &self.watchdog_bites, &self.dma.request]
                .map(|flag| &flag.0);
        let Crystal { dead, switched, flag } = &*self.crystal;
        let [stop, broken, locked] = [&*self.stop, &self.broken, &self.locked];
        [pace, supply, bites, asks, stop, broken, locked, dead, switched, flag]
    }

    pub(super) fn set_pin(&self, pin: Pin, high: bool) {
        self.gpio[pin.port_index()].set_external(u32::from(pin.number), high);
    }

    pub(super) fn set_alternate(&self, pin: Pin, high: bool) {
        self.gpio[pin.port_index()].set_alternate(u32::from(pin.number), high);
    }

    pub(super) fn pin(&self, pin: Pin) -> bool {
        self.gpio[pin.port_index()].pin_levels() >> pin.number & 1 == 1
    }
}
