//! Puts the checksum of the firmware's image into the ELF of the linker. `zwidth::image` says which bytes the checksum
//! covers and which code checks it.
#![forbid(unsafe_code)]

use object::{
    Object, ObjectSymbol,
    read::elf::{ElfFile32, ProgramHeader},
};
use zwidth::image::{Image, UNSEALED};

/// The linker's symbol at the seal. `PARTS` has the symbols at the start and end of each part that the seal covers. The
/// symbols are defined in memory.x and in cortex-m-rt's link.x.
pub const SEAL: &str = "_seal";
const PARTS: [[&str; 2]; 3] =
    [["__vector_table", SEAL], ["__stext", "__etext"], ["__srodata", "__erodata"]];
/// Three symbols of the linker: where flash holds the initial values of the variables, and where the variables start
/// and end in RAM.
const VARIABLES: [&str; 3] = ["__sidata", "__sdata", "__edata"];

/// Access to the symbols and bytes of an image.
pub trait Linked {
    fn address_of(&self, symbol: &str) -> Option<u32>;

    /// The pieces that are programmed into flash. Each has its address and its bytes.
    fn pieces(&self) -> impl Iterator<Item = (u32, &[u8])>;
}

fn word_at(image: &impl Linked, address: u32) -> Option<u32> {
    image.pieces().find_map(|(from, bytes)| {
        let word = bytes.get(address.checked_sub(from)? as usize..)?.first_chunk()?;
        Some(u32::from_le_bytes(*word))
    })
}

/// Start and end address of each part of an image: vectors, code, constants, initial values of the variables.
///
/// # Errors
/// The error names the missing symbol.
pub fn parts(image: &impl Linked) -> Result<[[u32; 2]; 4], String> {
    let at = |name: &str| image.address_of(name).ok_or_else(|| format!("it has no symbol {name}"));
    let [from, begin, end] = VARIABLES;
    let (from, length) = (at(from)?, at(end)?.wrapping_sub(at(begin)?));
    let [vectors, code, constants] = PARTS;
    let part = |[from, to]: [&str; 2]| Ok::<_, String>([at(from)?, at(to)?]);
    Ok([part(vectors)?, part(code)?, part(constants)?, [from, from.wrapping_add(length)]])
}

/// Returns the address of the seal and the value that it must have.
///
/// # Errors
/// The file is no image of this firmware.
pub fn seal_of(image: &impl Linked) -> Result<(u32, u32), String> {
    let at = image.address_of(SEAL).ok_or_else(|| format!("it has no symbol {SEAL}"))?;
    let words = |[from, to]: [u32; 2]| {
        let word = |address| {
            word_at(image, address).ok_or_else(|| format!("it has nothing at {address:#x}"))
        };
        (from..to).step_by(4).map(word).collect::<Result<Vec<_>, _>>()
    };
    let [vectors, code, constants, variables] = parts(image)?.map(words);
    let (vectors, code, constants, variables) = (vectors?, code?, constants?, variables?);
    let parts = [&vectors[..], &code, &constants, &variables];
    match (Image { parts, seal: &[UNSEALED] }).checksum() {
        UNSEALED => Err("its checksum is that of an image without one: change it".into()),
        sum => Ok((at, sum)),
    }
}

struct File<'a> {
    /// Name and address of each symbol.
    symbols: Vec<(&'a str, u64)>,
    /// The pieces that are programmed into flash. Each has its address, its offset in the file, and its bytes.
    pieces: Vec<(u32, u32, &'a [u8])>,
}

impl Linked for File<'_> {
    fn address_of(&self, symbol: &str) -> Option<u32> {
        let (_, address) = self.symbols.iter().find(|(name, _)| *name == symbol)?;
        u32::try_from(*address).ok()
    }

    fn pieces(&self) -> impl Iterator<Item = (u32, &[u8])> {
        self.pieces.iter().map(|(from, _, bytes)| (*from, *bytes))
    }
}

/// Writes the seal into the bytes of an ELF. Returns the offset of the four changed bytes, or `None` if the seal was
/// already correct.
///
/// # Errors
/// The file is no ELF of this firmware.
pub fn seal(elf: &mut [u8]) -> Result<Option<usize>, String> {
    let (place, sum) = {
        let file: ElfFile32 = ElfFile32::parse(&*elf).map_err(|error| error.to_string())?;
        let endian = file.endian();
        let symbols = file.symbols().filter_map(|s| Some((s.name().ok()?, s.address()))).collect();
        let headers = file.elf_program_headers().iter();
        let pieces = headers
            .filter(|header| header.p_type(endian) == object::elf::PT_LOAD)
            .filter_map(|header| {
                let data = header.data(endian, &*elf).ok()?;
                Some((header.p_paddr(endian), header.p_offset(endian), data))
            })
            .collect();
        let file = File { symbols, pieces };
        let (at, sum) = seal_of(&file)?;
        let place = file.pieces.iter().find_map(|(from, offset, bytes)| {
            let inside = at.checked_sub(*from)?;
            (inside as usize + 4 <= bytes.len()).then(|| (offset + inside) as usize)
        });
        (place.ok_or_else(|| format!("it has nothing at {SEAL}"))?, sum)
    };
    let seal = elf.get_mut(place..place + 4).ok_or_else(|| format!("it ends before {SEAL}"))?;
    let has_changed = seal != sum.to_le_bytes();
    seal.copy_from_slice(&sum.to_le_bytes());
    Ok(has_changed.then_some(place))
}
