//! Reads all files that a user names. Each kind of file has a largest size. A read can be interrupted. The error for a
//! file that is too large names the size limit.

use std::{fs::File, io::Read as _, path::Path};

use crate::{error::Error, interrupt};

pub mod table;

/// A kind of file: its content, and its largest size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Kind {
    name: &'static str,
    limit_mib: u64,
}

pub const SCENE: Kind = Kind { name: "a scene", limit_mib: 1 };
/// A curve that gives the least motion that a hand feels at each frequency.
pub const CURVE: Kind = Kind { name: "a curve", limit_mib: 1 };
/// A record: a log or a capture of telemetry. Two hours of frames are below the size limit.
pub const RECORD: Kind = Kind { name: "a record", limit_mib: 256 };
pub const STUDY: Kind = Kind { name: "a study", limit_mib: 1 };
pub const DEVICE: Kind = Kind { name: "a device record", limit_mib: 1 };
pub const PROGRAM: Kind = Kind { name: "a program", limit_mib: 64 };

/// Number of bytes that are read between two checks of the interrupt flag.
const PIECE: u64 = 1 << 20;

/// Reads a whole file.
///
/// # Errors
/// [`Error::Input`] if the file cannot be read or is too large for its kind. [`Error::Interrupted`] on interruption.
pub fn read(path: &Path, kind: Kind) -> Result<Vec<u8>, Error> {
    let unreadable = |error| Error::Input(format!("{} cannot be read: {error}", path.display()));
    let limit = kind.limit_mib << 20;
    let mut file = File::open(path).map_err(unreadable)?;
    let mut bytes = vec![];
    loop {
        interrupt::check()?;
        let rest = (limit + 1).saturating_sub(bytes.len() as u64);
        let read = file.by_ref().take(rest.min(PIECE)).read_to_end(&mut bytes);
        match read.map_err(unreadable)? {
            0 => return Ok(bytes),
            _ if bytes.len() as u64 > limit => {
                let (path, Kind { name, limit_mib }) = (path.display(), kind);
                return Err(Error::Input(format!(
                    "{path} is larger than {name} may be, allowed {limit_mib} MiB"
                )));
            }
            _ => {}
        }
    }
}

/// Reads a whole file of text.
///
/// # Errors
/// The errors of [`read`], and [`Error::Input`] if the file is not UTF-8.
pub fn read_text(path: &Path, kind: Kind) -> Result<String, Error> {
    let bytes = read(path, kind)?;
    utf8(&bytes).map(str::to_owned).map_err(|why| Error::Input(why).of(&path.display().to_string()))
}

/// Returns bytes as text.
///
/// # Errors
/// One line with the position, from 1 on, of the first byte that is not UTF-8 text, and a guess of the encoding.
pub fn utf8(bytes: &[u8]) -> Result<&str, String> {
    let at = match std::str::from_utf8(bytes) {
        Ok(text) => match text.find('\0') {
            Some(at) => at,
            None => return Ok(text),
        },
        Err(error) => error.valid_up_to(),
    };
    let control = |byte: &u8| byte.is_ascii_control() && !b"\t\r\n".contains(byte);
    let seems = match bytes {
        [0xff, 0xfe, ..] | [0xfe, 0xff, ..] | [0, ..] | [_, 0, ..] => ": UTF-16?",
        _ if bytes.iter().any(control) => "",
        _ => ": Windows-1252?",
    };
    Err(format!("not UTF-8, byte {}{seems}", at + 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_read_up_to_its_limit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        let kind = Kind { name: "a test", limit_mib: 2 };
        for (length, fits) in [(0, true), (3 << 19, true), (2 << 20, true), ((2 << 20) + 1, false)]
        {
            std::fs::write(&path, vec![b'x'; length]).unwrap();
            let read = read(&path, kind);
            assert_eq!(read.is_ok_and(|bytes| bytes.len() == length), fits, "{length}");
        }
        let error = read(&path, kind).unwrap_err().to_string();
        assert!(error.ends_with("file is larger than a test may be, allowed 2 MiB"), "{error}");
        std::fs::write(&path, b"ab\xff").unwrap();
        let error = read_text(&path, kind).unwrap_err().to_string();
        assert!(error.ends_with("file: not UTF-8, byte 3: Windows-1252?"), "{error}");
    }

    #[test]
    fn what_is_no_text_is_named_by_its_first_byte() {
        for (bytes, why) in [
            (&b"\xff\xfea\0"[..], "not UTF-8, byte 1: UTF-16?"),
            (b"\xfe\xff\0a", "not UTF-8, byte 1: UTF-16?"),
            (b"a\0b\0", "not UTF-8, byte 2: UTF-16?"),
            (b"\0a\0b", "not UTF-8, byte 1: UTF-16?"),
            (b"a\tb\r\n5 \xb5m", "not UTF-8, byte 8: Windows-1252?"),
            (b"\x80\x01", "not UTF-8, byte 1"),
            (b"a,b\n\0\0", "not UTF-8, byte 5"),
        ] {
            assert_eq!(utf8(bytes).unwrap_err(), why);
        }
        assert_eq!(utf8("5 \u{b5}m".as_bytes()), Ok("5 \u{b5}m"));
    }
}
