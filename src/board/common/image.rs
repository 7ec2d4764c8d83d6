//! Finds the parts of the image in flash. Symbols of memory.x and of cortex-m-rt's link.x mark them.

use core::{ptr, slice};

use zwidth::image::Image;

// SAFETY: words of flash that nothing writes while the program runs. Only the seal is read. Of the other symbols only
// the address is used.
unsafe extern "C" {
    safe static __vector_table: u32;
    safe static _seal: [u32; 1];
    safe static __stext: u32;
    safe static __etext: u32;
    safe static __srodata: u32;
    safe static __erodata: u32;
    safe static __sidata: u32;
    safe static __sdata: u32;
    safe static __edata: u32;
}

pub fn image() -> Image<'static> {
    let variables = (&raw const __edata).addr() - (&raw const __sdata).addr();
    let from = (&raw const __sidata).addr();
    let parts = [
        (&raw const __vector_table, (&raw const _seal).addr()),
        (&raw const __stext, (&raw const __etext).addr()),
        (&raw const __srodata, (&raw const __erodata).addr()),
        (&raw const __sidata, from + variables),
    ];
    Image { parts: parts.map(|(from, to)| words(from, to)), seal: &_seal }
}

fn words(from: *const u32, to: usize) -> &'static [u32] {
    let from = from.expose_provenance();
    // SAFETY: the words are flash between two symbols of the linker. Both addresses are multiples of four.
    unsafe {
        slice::from_raw_parts(ptr::with_exposed_provenance(from), (to - from) / size_of::<u32>())
    }
}
