//! The device record, in its own flash sector (memory.x). The build puts the first record there. Another record can be
//! programmed in its place.

use zwidth::device::record::WORDS_MAX;

const BYTES: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/device.record"));

/// The record that the build puts into the image. Another record may be programmed over it later. No code reads it by
/// this name, so that the compiler cannot assume its content.
#[used]
// SAFETY: the section holds nothing else, and memory.x keeps a whole sector for it.
#[unsafe(link_section = ".device")]
static BUILT_IN: [u8; BYTES.len()] = *BYTES.as_array().expect("of that length");

// SAFETY: memory.x defines this symbol at the beginning of a sector. The sector has this number of words, and nothing
// writes it while the program runs.
unsafe extern "C" {
    safe static _device_record: [u32; WORDS_MAX];
}

pub fn device_record() -> &'static [u32] {
    &_device_record
}
