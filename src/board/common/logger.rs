//! defmt's global logger: RTT up channel 0, without ever delaying the sampling task.
//!
//! A frame is put together in a staging buffer while the lower tasks are masked ([`mask`](super::mask)). Then it is
//! written to the channel whole or not at all. Lines are lost if the reader is slow, has stopped or has set its channel
//! to blocking. No task waits. Logging from the sampling task, a fault handler or inside another frame traps.

use core::{
    cell::UnsafeCell,
    sync::atomic::{AtomicU32, Ordering::Relaxed},
};

use zwidth::contract::UpChannel as _;

use super::{mask, rtt::UpLink};

/// Length of the longest encoded frame, in bytes. A longer frame is dropped.
const FRAME_BYTES: usize = 256;

/// Number of frames that were dropped since the start. The number wraps.
static DROPPED: AtomicU32 = AtomicU32::new(0);

struct State {
    encoder: defmt::Encoder,
    frame: [u8; FRAME_BYTES],
    length: usize,
    open: bool,
    mask_before: u8,
}

struct Shared(UnsafeCell<State>);

// SAFETY: the contents are touched only between `mask::raise` and `mask::restore`. Between these two no other task that
// may log can run. In any other task `raise` traps.
unsafe impl Sync for Shared {}

static STATE: Shared = Shared(UnsafeCell::new(State {
    encoder: defmt::Encoder::new(),
    frame: [0; FRAME_BYTES],
    length: 0,
    open: false,
    mask_before: 0,
}));

impl State {
    /// Appends `bytes` to the frame. If they do not fit, only `length` grows. A frame with a `length` above
    /// [`FRAME_BYTES`] is dropped later.
    fn stage(frame: &mut [u8; FRAME_BYTES], length: &mut usize, bytes: &[u8]) {
        // The two slices are made in this order, because then the compiler sees that their lengths are equal. So the
        // code contains no panic.
        let rest = frame.get_mut(*length..);
        if let Some(room) = rest.and_then(|rest| rest.get_mut(..bytes.len())) {
            room.copy_from_slice(bytes);
        }
        *length = length.saturating_add(bytes.len());
    }
}

pub fn dropped() -> u32 {
    DROPPED.load(Relaxed)
}

#[defmt::global_logger]
struct Logger;

// SAFETY: `acquire` excludes all other callers until `release`, see `Shared`; a second frame
// inside a frame traps.
unsafe impl defmt::Logger for Logger {
    fn acquire() {
        let before = mask::raise();
        // SAFETY: see `Shared`.
        let state = unsafe { &mut *STATE.0.get() };
        if state.open {
            cortex_m::asm::udf();
        }
        state.open = true;
        state.mask_before = before;
        state.length = 0;
        let State { encoder, frame, length, .. } = state;
        encoder.start_frame(|bytes| State::stage(frame, length, bytes));
    }

    unsafe fn write(bytes: &[u8]) {
        // SAFETY: defmt calls this between `acquire` and `release` only.
        let State { encoder, frame, length, .. } = unsafe { &mut *STATE.0.get() };
        encoder.write(bytes, |bytes| State::stage(frame, length, bytes));
    }

    unsafe fn release() {
        // SAFETY: defmt calls this after `acquire` only.
        let state = unsafe { &mut *STATE.0.get() };
        let State { encoder, frame, length, .. } = state;
        encoder.end_frame(|bytes| State::stage(frame, length, bytes));
        let whole = state.frame.get(..state.length);
        let taken = whole.is_some_and(|whole| UpLink::<0>.write(whole));
        if !taken {
            DROPPED.store(DROPPED.load(Relaxed).wrapping_add(1), Relaxed);
        }
        state.open = false;
        mask::restore(state.mask_before);
    }

    unsafe fn flush() {}
}
