//! The module for the browser. The module runs only when it is called; see the library.
#![forbid(unsafe_code)]

use live_web as _;

fn main() {}
