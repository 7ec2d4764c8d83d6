//! What must always hold of the library, each as a property that random cases try.
//!
//! A property is a line of text, a strategy that makes cases, and a check, by area in the modules below. What a check
//! compares with is written a second time here, from the pages and not from the code. `cargo test` tries each property
//! with a fixed seed, `cargo invariants` for as long as wanted with any ([`campaign`]).

#![forbid(unsafe_code)]
#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_precision_loss,
    clippy::cast_sign_loss,
    reason = "a test fails loudly; what is cast is small or meant to be cut"
)]

mod any;
pub mod campaign;
mod orders;
mod property;
mod rig;
mod stated;

properties_of! {
    black_box,
    calibration,
    counter,
    duty,
    envelope,
    estimators,
    force,
    frames,
    guard,
    hit,
    limits,
    parser,
    return_move,
    ring,
    store,
    walk,
}

pub use property::Property;
