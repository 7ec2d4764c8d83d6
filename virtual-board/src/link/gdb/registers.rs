//! The core's registers in gdb's order. `gdbstub_arch` has no description of a Cortex-M.

use std::sync::LazyLock;

use gdbstub::arch::{self, Arch};

use crate::mcu::Registers;

/// A Cortex-M4 with its floating-point unit.
pub(super) enum CortexM4 {}

impl Arch for CortexM4 {
    type Usize = u32;
    type Registers = InOrder;
    type BreakpointKind = usize;
    type RegId = ();

    fn target_description_xml() -> Option<&'static str> {
        Some(&DESCRIPTION)
    }
}

/// Registers in the order of [`DESCRIPTION`].
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct InOrder(pub(super) Registers);

/// Names of the registers from MSP to CONTROL, in the order of [`Registers::system`].
const SYSTEM: [&str; 6] = ["msp", "psp", "primask", "basepri", "faultmask", "control"];

/// Description of the target for gdb, with the features and names that gdb's manual requires ("ARM Features").
static DESCRIPTION: LazyLock<String> = LazyLock::new(|| {
    let core = (0..13).map(|number| register(&format!("r{number}"), 32, "uint32"));
    let named = [("sp", "data_ptr"), ("lr", "uint32"), ("pc", "code_ptr"), ("xpsr", "uint32")];
    let core = core.chain(named.map(|(name, kind)| register(name, 32, kind)));
    let kind = |name: &str| if name.ends_with("sp") { "data_ptr" } else { "uint32" };
    let system = SYSTEM.map(|name| register(name, 32, kind(name)));
    let float = (0..16).map(|number| register(&format!("d{number}"), 64, "ieee_double"));
    let float = float.chain([register("fpscr", 32, "uint32")]);
    format!(
        "<?xml version=\"1.0\"?><!DOCTYPE target SYSTEM \"gdb-target.dtd\"><target version=\"1.0\">\
         <architecture>arm</architecture>{}{}{}</target>",
        feature("m-profile", core),
        feature("m-system", system),
        feature("vfp", float)
    )
});

fn register(name: &str, bits: u32, kind: &str) -> String {
    format!("<reg name=\"{name}\" bitsize=\"{bits}\" type=\"{kind}\"/>")
}

fn feature(name: &str, registers: impl IntoIterator<Item = String>) -> String {
    let registers: String = registers.into_iter().collect();
    format!("<feature name=\"org.gnu.gdb.arm.{name}\">{registers}</feature>")
}

impl InOrder {
    fn words(&mut self) -> impl Iterator<Item = &mut u32> {
        let Registers { core, xpsr, system, float, fpscr } = &mut self.0;
        core.iter_mut().chain([xpsr]).chain(system).chain(float).chain([fpscr])
    }
}

impl arch::Registers for InOrder {
    type ProgramCounter = u32;

    fn pc(&self) -> u32 {
        self.0.core[15]
    }

    fn gdb_serialize(&self, mut write_byte: impl FnMut(Option<u8>)) {
        for word in self.clone().words() {
            word.to_le_bytes().into_iter().for_each(|byte| write_byte(Some(byte)));
        }
    }

    fn gdb_deserialize(&mut self, bytes: &[u8]) -> Result<(), ()> {
        let mut pieces = bytes.chunks_exact(4);
        for word in self.words() {
            let piece = pieces.next().and_then(|piece| piece.try_into().ok()).ok_or(())?;
            *word = u32::from_le_bytes(piece);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use gdbstub::arch::Registers as _;

    use super::*;

    #[test]
    fn the_description_has_a_place_for_every_byte() {
        let bits: usize = DESCRIPTION
            .split("bitsize=\"")
            .skip(1)
            .map(|rest| rest.split('"').next().unwrap().parse::<usize>().unwrap())
            .sum();
        let mut bytes = vec![];
        let mut registers = InOrder::default();
        for (number, word) in (1..).zip(registers.words()) {
            *word = number;
        }
        registers.gdb_serialize(|byte| bytes.push(byte.unwrap()));
        assert_eq!(bits, 8 * bytes.len());
        let mut back = InOrder::default();
        back.gdb_deserialize(&bytes).unwrap();
        assert_eq!(back, registers);
        assert!(back.gdb_deserialize(&bytes[..20]).is_err());
    }
}
