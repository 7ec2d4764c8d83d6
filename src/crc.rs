//! The checksum of everything that is stored or sent: CRC-32/ISO-HDLC (that of zlib and Ethernet).
//!
//! One table of 1 KiB for all; about 8 cycles a byte on a Cortex-M4. It detects every error burst
//! of up to 32 bits, so every change of a single byte.

use crc::{CRC_32_ISO_HDLC, Crc};

static TABLE: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

pub(crate) fn of_bytes(bytes: &[u8]) -> u32 {
    TABLE.checksum(bytes)
}

/// Of words, each taken with its least significant byte first.
pub(crate) fn of_words(words: &[u32]) -> u32 {
    of_pieces([words])
}

/// Of words in several pieces, as of one.
pub(crate) fn of_pieces<'a>(pieces: impl IntoIterator<Item = &'a [u32]>) -> u32 {
    let mut digest = TABLE.digest();
    for word in pieces.into_iter().flatten() {
        digest.update(&word.to_le_bytes());
    }
    digest.finalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_catalogued_checksum_and_words_are_little_endian() {
        assert_eq!(of_bytes(b"123456789"), 0xCBF4_3926); // check value of the CRC catalogue
        assert_eq!(of_words(&[0x3433_3231, 0x3837_3635]), of_bytes(b"12345678"));
    }
}
