//! The firmware's beginning. It boots and sleeps, and touches no pin: every output stays as the
//! reset left it, an input, so that the amplifier's enable is held inactive by its external
//! resistor. The tasks that sample and render are not here yet; the control core they will call
//! is the library of this package.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod image {
    use zwidth as _; // what the image will run, linked from the first day

    #[cortex_m_rt::entry]
    fn main() -> ! {
        loop {
            cortex_m::asm::wfi();
        }
    }

    #[panic_handler]
    fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
        loop {
            cortex_m::asm::wfi();
        }
    }
}

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("this is the firmware; build it with `cargo firmware`, or run `cargo sim`");
}
