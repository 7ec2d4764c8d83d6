//! Guards the end of the stack. Between the statics and the stack there is a region where the memory protection unit
//! allows no access.
//!
//! The stack grows down towards the statics. A task that overruns it causes a hard fault here, before it writes into
//! the statics. At this fault the core cannot stack its registers. The handler does not need them, because the handler
//! never returns. If the core locks up instead, the output watchdog switches off.

/// Bytes of the region. The region begins at a multiple of this number.
const BYTES: u32 = 256;

/// MPU_RASR (ARMv7-M): the region is on, has 2^(7 + 1) bytes, and allows neither access nor code.
const REGION: u32 = 1 << 28 | 7 << 1 | 1;
/// MPU_RBAR: the written address belongs to region 0.
const VALID: u32 = 1 << 4;
/// MPU_CTRL: the unit is on. Outside the region the default memory map is used. In the hard fault handler the unit is
/// off.
const CONTROL: u32 = 1 << 2 | 1;

unsafe extern "C" {
    /// Symbol of cortex-m-rt at the end of the statics.
    static __sheap: u8;
}

pub fn set_up(mpu: &mut cortex_m::peripheral::MPU) {
    let end = (&raw const __sheap) as u32;
    // SAFETY: a region between the statics and the stack, where nothing is.
    unsafe {
        mpu.rbar.write(end.next_multiple_of(BYTES) | VALID);
        mpu.rasr.write(REGION);
        mpu.ctrl.write(CONTROL);
    }
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}
