//! The firmware's ELF file. Only its parts for flash are used.

use std::path::Path;

use host_sim::{error::Error, input};

use object::{
    Object, ObjectSection, ObjectSymbol,
    read::elf::{ElfFile32, ProgramHeader},
};
use seal::Linked;

#[derive(Clone, Debug)]
pub struct Elf {
    pub bytes: Vec<u8>,
    /// The contents of flash. Each piece has its address and its bytes.
    pub flash: Vec<(u32, Vec<u8>)>,
    /// The symbols. Each has its name, its address without the Thumb bit, and its size.
    pub symbols: Vec<(String, u32, u32)>,
    /// The sections. Each has its name, address and size.
    pub sections: Vec<(String, u32, u32)>,
}

/// Part of a symbol name. The symbol is the static variable in which `sample` keeps its data between two samples.
pub const SAMPLE_STATE: &str = "task6sample5PLACE";

impl Elf {
    /// Reads a file.
    ///
    /// # Errors
    /// The file cannot be read, or the file is not a 32-bit little-endian ELF.
    pub fn load(path: &Path) -> Result<Self, Error> {
        Self::parse(input::read(path, input::PROGRAM)?, &path.display().to_string())
    }

    /// Parses the bytes of a file. `origin` names the file in error messages.
    ///
    /// # Errors
    /// The bytes are not a 32-bit little-endian ELF.
    pub fn parse(bytes: Vec<u8>, origin: &str) -> Result<Self, Error> {
        let bad =
            |reason: String| Error::Input(format!("{origin} is no program of a board: {reason}"));
        let file: ElfFile32 = ElfFile32::parse(&*bytes).map_err(|error| bad(error.to_string()))?;
        let endian = file.endian();
        let mut flash = Vec::new();
        for header in file.elf_program_headers() {
            if header.p_type(endian) == object::elf::PT_LOAD && header.p_filesz(endian) > 0 {
                let data = header
                    .data(endian, &*bytes)
                    .map_err(|()| bad("a segment lies outside the file".into()))?;
                flash.push((header.p_paddr(endian), data.to_vec()));
            }
        }
        let narrow = |value: u64| u32::try_from(value).unwrap_or(u32::MAX);
        let symbols = file
            .symbols()
            .filter_map(|s| {
                Some((s.name().ok()?.to_owned(), narrow(s.address()) & !1, narrow(s.size())))
            })
            // A symbol `.L..` names several statics that the compiler merged. Each static also has its own symbol.
            .filter(|(name, ..)| !name.starts_with(".L"))
            .collect();
        let sections = file
            .sections()
            .filter_map(|s| {
                Some((s.name().ok()?.to_owned(), narrow(s.address()), narrow(s.size())))
            })
            .collect();
        drop(file);
        Ok(Self { bytes, flash, symbols, sections })
    }

    /// Whether flash contains this text.
    pub fn contains(&self, text: &str) -> bool {
        let text = text.as_bytes();
        self.flash.iter().any(|(_, data)| data.windows(text.len()).any(|part| part == text))
    }

    pub fn address_of(&self, name: &str) -> Option<u32> {
        self.symbols.iter().find(|(n, ..)| n == name).map(|(_, address, _)| *address)
    }

    /// Address and size of the symbol whose name contains `part`.
    pub fn place_of(&self, part: &str) -> Result<(u32, u32), String> {
        let found = self.symbols.iter().find(|(name, ..)| name.contains(part));
        found
            .map(|&(_, address, size)| (address, size))
            .ok_or_else(|| format!("the ELF has no symbol {part}"))
    }

    /// Writes the checksum into `flash`. `bytes` stays the same.
    ///
    /// # Errors
    /// The ELF is not an image of this firmware.
    pub fn seal(&mut self) -> Result<(), String> {
        let (at, sum) = seal::seal_of(self)?;
        let place = self.flash.iter_mut().find_map(|(from, bytes)| {
            bytes.get_mut(at.checked_sub(*from)? as usize..)?.first_chunk_mut::<4>()
        });
        *place.ok_or_else(|| format!("the ELF has nothing at {}", seal::SEAL))? = sum.to_le_bytes();
        Ok(())
    }

    /// Address and size of a section.
    pub fn section(&self, name: &str) -> Option<(u32, u32)> {
        self.sections.iter().find(|(n, ..)| n == name).map(|(_, address, size)| (*address, *size))
    }
}

impl Linked for Elf {
    fn address_of(&self, symbol: &str) -> Option<u32> {
        self.address_of(symbol)
    }

    fn pieces(&self) -> impl Iterator<Item = (u32, &[u8])> {
        self.flash.iter().map(|(from, bytes)| (*from, &bytes[..]))
    }
}
