//! The memory of a board, through an attached probe. Only this file and the list of probes use the crate probe-rs.

use std::error::Error;

use probe_rs::{
    Core, MemoryInterface as _, Permissions, Session, Target, config::Registry, probe::Probe,
};
use virtual_board::{link, rtt::Memory};

/// Finds the chip that has this name.
///
/// # Errors
/// No chip has this name. The error is one line of text.
pub fn target(chip: &str) -> Result<Target, String> {
    let found = Registry::from_builtin_families().get_target_by_name(chip).ok();
    found.filter(|target| target.name.starts_with("STM32F4")).ok_or_else(|| {
        format!("--chip is {chip}, allowed is the whole name of an STM32F4, such as STM32F446RETx")
    })
}

/// An attached probe. To attach or detach halts the core for a moment.
pub struct Attached(Session);

impl Attached {
    /// Attaches to the chip.
    ///
    /// # Errors
    /// The probe does not find this chip. The error is one line of text.
    pub fn to(probe: Probe, target: Target) -> Result<Self, String> {
        // these permissions allow nothing to be erased or unlocked
        let session = probe.attach(target, Permissions::new());
        session.map(Self).map_err(|error| one_line(&error))
    }
}

impl link::Probe for Attached {
    fn core(&mut self) -> Result<impl link::Core, String> {
        self.0.core(0).map(Opened).map_err(|error| one_line(&error))
    }
}

/// The board's core. probe-rs queries the access port whenever it opens a core.
struct Opened<'a>(Core<'a>);

impl Memory for Opened<'_> {
    type Error = String;

    fn read(&mut self, address: u32, into: &mut [u8]) -> Result<(), String> {
        self.0.read(address.into(), into).map_err(|error| one_line(&error))
    }

    fn write(&mut self, address: u32, from: &[u8]) -> Result<(), String> {
        let written = self.0.write(address.into(), from);
        // an error of the flush is returned as an error of this write
        written.and_then(|()| self.0.flush()).map_err(|error| one_line(&error))
    }
}

impl link::Core for Opened<'_> {
    fn is_halted(&mut self) -> Result<bool, String> {
        self.0.core_halted().map_err(|error| one_line(&error))
    }
}

/// An error and its causes, as one line.
pub fn one_line(error: &dyn Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        let next = error.to_string();
        if !text.contains(&next) {
            text = format!("{text}: {next}");
        }
        cause = error.source();
    }
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}
