//! Keeps the first fault in the backup RAM. The record survives a reset. It does not survive a loss of power, because
//! the regulator of the backup RAM stays off.

use core::ptr;

use stm32f4xx_hal::rcc::Rcc;
use zwidth::{
    contract,
    safety::{Fault, FaultRecord},
};

use super::supply::Supply;

/// Address of the backup RAM, which has 4 KiB.
const ADDRESS: *mut [u32; FaultRecord::WORDS] = ptr::without_provenance_mut(0x4002_4000);

pub struct FaultMemory(());

impl FaultMemory {
    /// Switches on the RAM's clock, and opens the RAM for writing.
    pub fn new(supply: &Supply, rcc: &mut Rcc) -> Self {
        rcc.ahb1enr().modify(|_, w| w.bkpsramen().set_bit());
        supply.open_backup();
        Self(())
    }
}

impl contract::FaultMemory for FaultMemory {
    fn read(&self) -> [u32; FaultRecord::WORDS] {
        read()
    }

    fn write(&mut self, words: &[u32; FaultRecord::WORDS]) {
        write(words);
    }
}

fn read() -> [u32; FaultRecord::WORDS] {
    // SAFETY: RAM at this address on every chip here, aligned, used by this file only; any words
    // are valid.
    unsafe { ptr::read_volatile(ADDRESS) }
}

fn write(words: &[u32; FaultRecord::WORDS]) {
    // SAFETY: as in `read`. A handler that interrupts a write ends the program.
    unsafe { ptr::write_volatile(ADDRESS, *words) }
}

/// Notes a fault. Only the panic and fault handlers call it. If the force was on, the record also states that this
/// fault switched the force off.
pub(in crate::board) fn note(fault: Fault) {
    let record = match FaultRecord::from_words(&read()) {
        Some(record) if record.fault == Fault::ResetWhileArmed => record.renamed(fault),
        Some(_) => return, // an earlier fault is the first one
        None => FaultRecord::bare(fault),
    };
    write(&record.to_words());
}
