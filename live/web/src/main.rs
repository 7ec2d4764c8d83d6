//! The module for the browser. It runs only when it is called. The library has its functions.
#![forbid(unsafe_code)]

use live_web as _;

fn main() {}
