//! `cargo live`: a board in the browser. The library has the parts that need no network: the history for the plots, the
//! communication with the board, and the rule which of several pages controls it. The page without a server uses these
//! parts without threads.
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
