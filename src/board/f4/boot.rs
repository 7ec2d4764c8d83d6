//! Checks at boot whether the chip is the right one, and whether the 8 MHz clock is present. All other clocks are made
//! from it. If the chip is wrong or the clock is missing, the board reports it and stops here. All pins then stay as
//! after reset.

use stm32f4xx_hal::pac;
use zwidth::contract::UpChannel as _;

use super::super::super::common::rtt::Replies;

const OTHER_CHIP: &[u8] =
    b"error: another chip than this image is for, nothing runs: see docs/first-power-up.md\n";
const NO_CLOCK: &[u8] =
    b"error: no 8 MHz clock, nothing runs: see the solder bridges in docs/wiring.md\n";

/// Number of times that the clock's ready flag is read before the board gives up. A read takes some eight cycles of the
/// 16 MHz reset clock, so all reads together take a tenth of a second. A crystal needs a few milliseconds (data
/// sheets).
const LOOKS: u32 = 200_000;

/// Compares the number of this chip's type, `DEV_ID`, with `expected` (RM0390 33.6.1, RM0090 38.6.1). If they differ,
/// the board reports it and stops.
pub fn expect_chip(dbgmcu: &pac::DBGMCU, expected: u32, replies: &mut Replies) {
    let id = u32::from(dbgmcu.idcode().read().dev_id().bits());
    if id != expected {
        defmt::error!("chip {=u32:#x}, this image is for {=u32:#x}: nothing runs", id, expected);
        stay(replies, OTHER_CHIP);
    }
}

pub fn expect_clock(rcc: &pac::RCC, external: bool, replies: &mut Replies) {
    rcc.cr().modify(|_, w| w.hsebyp().bit(external));
    rcc.cr().modify(|_, w| w.hseon().set_bit());
    if (0..LOOKS).all(|_| rcc.cr().read().hserdy().bit_is_clear()) {
        defmt::error!("no 8 MHz clock, nothing runs");
        stay(replies, NO_CLOCK);
    }
}

fn stay(replies: &mut Replies, why: &[u8]) -> ! {
    replies.write(why);
    loop {
        cortex_m::asm::nop();
    }
}
