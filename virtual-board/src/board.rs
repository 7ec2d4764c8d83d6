//! The boards of the firmware's src/board/, and how the simulated device is connected to their pins.

use std::sync::Arc;

use host_sim::error::Error;

pub use crate::wiring::{Force, Wiring};
use crate::{
    amplifier::Amplifier,
    elf::Elf,
    mcu::{Chip, Listeners, Mcu, Pin},
    rtt::Rtt,
};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Board {
    /// Name of the board. The firmware's feature has the same name.
    pub name: &'static str,
    pub chip: Chip,
    /// Name of the chip for debug probes.
    pub part: &'static str,
    pub wiring: Wiring,
    /// Lowest normal supply voltage of the chip, in mV.
    pub supply_mv: u32,
}

const fn pin(port: char, number: u8) -> Pin {
    Pin { port, number }
}

/// The NUCLEO-F446RE, whose force output is the DAC. It is the default board.
pub const NUCLEO_F446RE: Board = Board {
    name: "nucleo-f446re",
    chip: Chip { core_hz: 180_000_000, flash_bytes: 0x8_0000, id: 0x421, over_drive: true },
    part: "STM32F446RETx",
    wiring: Wiring {
        encoder: [pin('A', 0), pin('A', 1)],
        captured: Some([pin('A', 6), pin('A', 7)]),
        force: Force::Dac { pin: pin('A', 4) },
        enable: pin('A', 10),
        stop: pin('B', 12),
    },
    supply_mv: 3200, // regulator of 3.3 V
};

/// The STM32F407G-DISC1, whose force output is PWM.
pub const DISCOVERY_F407: Board = Board {
    name: "discovery-f407",
    chip: Chip { core_hz: 168_000_000, flash_bytes: 0x10_0000, id: 0x413, over_drive: false },
    part: "STM32F407VGTx",
    wiring: Wiring {
        encoder: [pin('A', 15), pin('A', 1)],
        captured: None,
        force: Force::Pwm { magnitude: pin('E', 9), sign: pin('E', 11) },
        enable: pin('E', 13),
        stop: pin('E', 15),
    },
    supply_mv: 2900, // regulator of 3.3 V and a diode: 3.0 V
};

pub const BOARDS: [Board; 2] = [NUCLEO_F446RE, DISCOVERY_F407];

impl Board {
    pub fn asked(name: &str) -> Result<Self, Error> {
        Self::named(name).ok_or_else(|| {
            Error::Input(format!("--board is {name}, allowed {}", Self::names(", ")))
        })
    }

    pub fn named(name: &str) -> Option<Self> {
        BOARDS.into_iter().find(|board| board.name == name)
    }

    /// The names of all boards, separated by `between`.
    pub fn names(between: &str) -> String {
        BOARDS.map(|board| board.name).join(between)
    }

    pub const fn cycles_per_sample(&self) -> u64 {
        self.chip.core_hz / 10_000
    }
}

/// A board with its supply on. It has the chip with its program, the amplifier and a probe.
pub struct Powered {
    pub board: Board,
    pub mcu: Mcu,
    pub amplifier: Arc<Amplifier>,
    pub rtt: Rtt,
}

impl Powered {
    /// Switches a board on, with the emergency stop closed. No instruction has run yet.
    ///
    /// # Errors
    /// The ELF has no RTT control block.
    pub fn on(board: Board, elf: &Elf) -> Result<Self, String> {
        let rtt = elf.address_of("_SEGGER_RTT").ok_or("the ELF has no symbol _SEGGER_RTT")?;
        let Wiring { force, enable, stop, .. } = board.wiring;
        let amplifier = Arc::new(Amplifier::new(board.wiring));
        let captured = board.wiring.captured.is_some();
        let mut listeners = Listeners { captured, stop: Some(stop), ..Listeners::default() };
        let mut outputs = vec![("ch3", enable)];
        match force {
            Force::Dac { .. } => listeners.dac = Some(Arc::clone(&amplifier) as _),
            Force::Pwm { magnitude, sign } => outputs.extend([("ch1", magnitude), ("ch2", sign)]),
        }
        for (channel, pin) in outputs {
            listeners.channels.push((channel, pin));
            listeners.pins.push((pin, Arc::clone(&amplifier) as _));
        }
        let mut mcu = Mcu::new(board.chip, &elf.flash, listeners);
        mcu.set_break(false);
        mcu.set_supply_mv(board.supply_mv);
        Ok(Self { board, mcu, amplifier, rtt: Rtt::new(rtt) })
    }
}
