//! `cargo live`: a board in the browser. The library holds what needs no network: the history that the plots are cut
//! from, the board's side, who may do what. It needs no threads either where somebody else calls it: the page without a
//! server.
#![forbid(unsafe_code)]

pub mod access;
pub mod history;
pub mod hub;
pub mod message;
pub mod page;
pub mod picture;
pub mod predicted;
pub mod seats;
pub mod spectrum;
pub mod trigger;
