//! Shared functions of the tests of the ELF.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::{Arc, Mutex},
};

use addr2line::{
    Context,
    gimli::{Dwarf, EndianSlice, LittleEndian},
};
use defmt_decoder::Table;
use host_sim::scene::{NamedScene, Scene};
use object::{Object as _, ObjectSection as _};
use virtual_board::{
    board::Board,
    device,
    elf::Elf,
    image, log,
    world::{Snapshot, World},
};
use zwidth::{
    CounterWidth, LoopParameters, Sampled, Sampler, VelocitySettings,
    telemetry::{Flags, Record},
    velocity::Senses,
};

/// Addresses, each with its bytes.
type Flash = Vec<(u32, Vec<u8>)>;

/// The release ELF of a board. It is built if needed.
pub struct Firmware {
    pub board: Board,
    pub elf: Elf,
    pub table: Table,
    pub scene: Scene,
}

impl Firmware {
    pub fn of(board: Board) -> Self {
        Self::variant(board, &[])
    }

    /// The firmware of a board with more features.
    pub fn variant(board: Board, features: &[&str]) -> Self {
        let path = image::build_variant(board.name, features).unwrap();
        let elf = Elf::load(&path).unwrap();
        let table = log::table(&elf.bytes).unwrap();
        let scene = NamedScene::load("paper-1um").unwrap().scene;
        Self { board, elf, table, scene }
    }

    /// Finds the source line of an address in the debug information.
    pub fn lines(&self) -> Context<EndianSlice<'_, LittleEndian>> {
        let file = object::File::parse(&*self.elf.bytes).unwrap();
        let sections: BTreeMap<&str, &[u8]> = file
            .sections()
            .filter_map(|section| Some((section.name().ok()?, section.data().ok()?)))
            .collect();
        let section = |name| sections.get(name).copied().unwrap_or_default();
        let dwarf =
            Dwarf::load(|id| Ok::<_, ()>(EndianSlice::new(section(id.name()), LittleEndian)));
        Context::from_dwarf(dwarf.unwrap()).unwrap()
    }

    /// Addresses of the sampling task's instructions that come from the inlined [`zwidth::Sampler::sample`]. The
    /// addresses are from the debug information.
    pub fn core_of_sample(&self) -> BTreeSet<u32> {
        let lines = self.lines();
        let of_core = |address: u32| {
            let mut frames = lines.find_frames(u64::from(address)).skip_all_loads().unwrap();
            while let Some(frame) = frames.next().unwrap() {
                if frame.function.is_some_and(|function| {
                    function.raw_name().unwrap().contains("7control16Sampler$LT$W$GT$5sense")
                }) {
                    return true;
                }
            }
            false
        };
        let (_, start, size) = self.elf.symbols.iter().find(|(name, ..)| name == "TIM5").unwrap();
        let marks: BTreeSet<u32> =
            (*start..start + size).step_by(2).filter(|&address| of_core(address)).collect();
        assert!(marks.len() > 50, "no debug information of the core: {}", marks.len());
        marks
    }

    /// A booted board. The handle rests at the device's rest position.
    pub fn boot(&self) -> World<'_> {
        self.booted(self.switched_on())
    }

    fn switched_on(&self) -> World<'_> {
        let Self { board, elf, table, scene } = self;
        World::new(*board, elf, table, scene, scene.device.rest_position_m).unwrap()
    }

    /// The filter after boot.
    pub fn first(&self) -> VelocitySettings {
        device::built_in(self.board).settings.velocity
    }

    /// A booted board that [`arm`] has armed. Arming takes a third of a second of the board's time, so the board is
    /// armed only once.
    pub fn armed(&self) -> World<'_> {
        static ARMED: Mutex<BTreeMap<Flash, Arc<Snapshot>>> = Mutex::new(BTreeMap::new());
        let kept = ARMED.lock().unwrap().get(&self.elf.flash).cloned();
        if let Some(kept) = kept {
            let mut world = self.switched_on();
            world.restore(&kept);
            return world;
        }
        let mut world = self.boot();
        arm(&mut world);
        let kept = Arc::new(world.snapshot());
        ARMED.lock().unwrap().insert(self.elf.flash.clone(), kept);
        world
    }

    /// A booted board on which every edge of the encoder comes at its exact time, and not only once per sample.
    pub fn boot_with_edge_times(&self) -> World<'_> {
        let rest_m = self.scene.device.rest_position_m;
        let Self { board, elf, table, scene } = self;
        self.booted(World::with_edge_times(*board, elf, table, scene, rest_m).unwrap())
    }

    fn booted<'a>(&'a self, mut world: World<'a>) -> World<'a> {
        let rest_m = self.scene.device.rest_position_m;
        world.powered.mcu.take_edge_notes(); // starts the notes
        world.run(200).unwrap();
        world.hold(rest_m, false);
        world
    }
}

/// The core on the host, with the firmware's inputs and commands.
pub struct Replay<'a> {
    sampler: Sampler,
    /// Settings in the order in which they took effect in the firmware.
    controls: &'a [LoopParameters],
    control: LoopParameters,
    number: u16,
    zeroed: bool,
}

impl<'a> Replay<'a> {
    pub fn new(first: u32, controls: &'a [LoopParameters]) -> Self {
        let sampler = Sampler::new(first, CounterWidth::Bits32);
        Self { sampler, controls, control: controls[0], number: 0, zeroed: false }
    }

    /// Runs sample `n`. `next` is the first record at or after this sample. Settings that an output takes over act from
    /// the next sample on, and the next record shows them. The command `zero` acts already in this sample.
    pub fn sample(
        &mut self,
        n: u64,
        reading: u32,
        next: Option<&Record>,
        senses: &Senses,
    ) -> (LoopParameters, Sampled) {
        let mut zero = false;
        if n % 10 == 1
            && let Some(next) = next
        {
            if next.settings != self.number {
                self.number = next.settings;
                self.control = self.controls[usize::from(self.number)].after(&self.control);
            }
            zero = next.flags.contains(Flags::ZEROED) && !self.zeroed;
            self.zeroed |= zero;
        }
        let control = self.control;
        let mut sampled = self.sampler.sense(&control, reading, senses);
        if zero {
            self.sampler.zero();
            sampled.motion.position = self.sampler.position();
        }
        (control, sampled)
    }
}

pub fn word(world: &World<'_>, address: u32) -> u32 {
    let mut bytes = [0; 4];
    world.powered.mcu.read(address, &mut bytes);
    u32::from_le_bytes(bytes)
}

/// Sends a line and requires the reply `ok`.
#[track_caller]
pub fn ok(world: &mut World<'_>, line: &str) -> String {
    let reply = world.ask(line).unwrap();
    assert!(reply.starts_with("ok"), "{line}: {reply}");
    reply
}

/// Arms at full force. The handle is free, 5 mm in front of a wall.
#[track_caller]
pub fn arm(world: &mut World<'_>) {
    for line in ["zero", "unlock envelope", "wall 0.005", "k 8000", "b 30", "push 2.835", "arm"] {
        ok(world, line);
    }
    until_armed(world);
}

/// Runs until the sign test and the ramp have ended.
#[track_caller]
pub fn until_armed(world: &mut World<'_>) {
    let mut status = String::new();
    for _ in 0..40 {
        status = ok(world, "status");
        if status.contains("ok status armed") {
            return;
        }
        world.run(100).unwrap();
    }
    panic!("{status}");
}
