//! Properties of the library that must always hold. Random cases try each property.
//!
//! A property has a line of text, a strategy for its cases, and a check. Each module below has the properties of one
//! area of the library. A check compares the library with a second implementation, which is written from the
//! documentation and not from the code. `cargo test` tries each property with a fixed seed. `cargo invariants` tries
//! the properties for any time, with any seed ([`campaign`]).

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
