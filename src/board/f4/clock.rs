//! The 8 MHz that everything runs from, before anything else: they may not be there.

use stm32f4xx_hal::pac;
use zwidth::contract::UpChannel as _;

use super::super::super::common::rtt::UpLink;

/// Looks at the ready flag, some eight cycles of the 16 MHz out of reset each: a tenth of a second. A crystal needs a few
/// milliseconds (data sheets).
const LOOKS: u32 = 200_000;

const MISSING: &[u8] =
    b"error: no 8 MHz clock, nothing runs: see the solder bridges in docs/wiring.md\n";

/// Switches HSE on and waits until it is ready; without it says so, and stays here.
pub fn wait(rcc: &pac::RCC, external: bool, replies: &mut UpLink) {
    rcc.cr().modify(|_, w| w.hsebyp().bit(external));
    rcc.cr().modify(|_, w| w.hseon().set_bit());
    if (0..LOOKS).any(|_| rcc.cr().read().hserdy().bit_is_set()) {
        return;
    }
    defmt::error!("no 8 MHz clock, nothing runs");
    replies.write(MISSING);
    loop {
        cortex_m::asm::nop();
    }
}
