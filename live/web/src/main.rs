//! The module for the browser: it does nothing but to be asked, see the library.
#![forbid(unsafe_code)]

use live_web as _;

fn main() {}
