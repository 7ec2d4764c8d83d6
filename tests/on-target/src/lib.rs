//! The control path alone, compiled for the board. `tests/elf/control_path.rs` checks the machine code of all functions
//! between encoder and command, and of every estimator (feature `estimators`). One function with floats does not belong
//! to the control path. This function shows that the check finds functions with floats.
#![cfg_attr(target_os = "none", no_std)]

mod supervision;

use dsp_fixedpoint::Q32;
use dsp_process::SplitProcess;
use zwidth::{
    Drive, LoopParameters, Motion, Sampler, Settings,
    experiment::{Calibration, Duty, DutyPlan, Hit, HitSequence, Verdict},
    units::{Force, Position, Velocity},
    velocity::{Biquad, BiquadState},
};

/// Called for every sample.
#[unsafe(no_mangle)] // SAFETY: no other symbol has this name
pub extern "C" fn zwidth_sample(
    sampler: &mut Sampler,
    control: &LoopParameters,
    counter: u32,
    motion: &mut Motion,
) {
    *motion = sampler.sample(control, counter).motion;
}

/// Does the same as [`zwidth_sample`], with any estimator.
#[cfg(feature = "estimators")]
#[unsafe(no_mangle)] // SAFETY: no other symbol has this name
pub extern "C" fn zwidth_estimate(
    estimator: &zwidth::velocity::Estimator,
    state: &mut zwidth::velocity::State,
    position: &Position,
    senses: &zwidth::velocity::Senses,
) -> i32 {
    estimator.update(state, *position, senses).bits()
}

/// Called for every output.
#[unsafe(no_mangle)] // SAFETY: no other symbol has this name
pub extern "C" fn zwidth_render(
    control: &LoopParameters,
    motion: &Motion,
    push: &Force,
    drive: &mut Drive,
) {
    *drive = control.render(*motion, *push);
}

/// Called for every sample of a hit.
#[unsafe(no_mangle)] // SAFETY: no other symbol has this name
pub extern "C" fn zwidth_hit(hit: &mut Hit, position: &Position, contact: bool) -> i32 {
    match hit.sample(*position, contact) {
        None => 0,
        Some(Verdict::Stable) => 1,
        Some(Verdict::Unstable) => 2,
        Some(Verdict::NoContact) => 3,
    }
}

/// What a hit computes for an output.
#[unsafe(no_mangle)] // SAFETY: no other symbol has this name
pub extern "C" fn zwidth_trial(
    trial: &mut HitSequence,
    position: &Position,
    contact: bool,
    duty: &mut Duty,
    plan: &DutyPlan,
    push: &mut Force,
) -> bool {
    *push = trial.output(*position, contact, duty).unwrap_or_default();
    duty.add(plan, *push);
    trial.sample(*position, contact).or_else(|| trial.early_verdict()).is_some()
}

/// What a calibration computes for an output.
#[unsafe(no_mangle)] // SAFETY: no other symbol has this name
pub extern "C" fn zwidth_calibration(
    calibration: &mut Calibration,
    position: &Position,
    push: &mut Force,
) -> bool {
    *push = calibration.output(*position, false).unwrap_or_default();
    calibration.is_complete_now()
}

/// The velocity filter alone, to compare its instructions with idsp's.
#[unsafe(no_mangle)] // SAFETY: no other symbol has this name
pub extern "C" fn zwidth_filter(filter: &Biquad, state: &mut BiquadState, input: &Velocity) -> i32 {
    filter.update(state, *input).bits()
}

/// idsp's biquad with first-order error feedback.
#[unsafe(no_mangle)] // SAFETY: no other symbol has this name
pub extern "C" fn idsp_dither(
    filter: &idsp::iir::Biquad<Q32<30>>,
    state: &mut idsp::iir::DirectForm1Dither,
    input: i32,
) -> i32 {
    filter.process(state, input)
}

/// idsp's biquad with a 64-bit output state.
#[unsafe(no_mangle)] // SAFETY: no other symbol has this name
pub extern "C" fn idsp_wide(
    filter: &idsp::iir::Biquad<Q32<30>>,
    state: &mut idsp::iir::DirectForm1Wide,
    input: i32,
) -> i32 {
    filter.process(state, input)
}

/// Converts settings to integers with floats. This is not a part of the control path.
#[unsafe(no_mangle)] // SAFETY: no other symbol has this name
pub extern "C" fn zwidth_build(
    settings: &Settings,
    design: &zwidth::Design,
    control: &mut LoopParameters,
) {
    if let Ok(built) = settings.build(design) {
        *control = built;
    }
}

#[cfg(target_os = "none")]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {}
}
