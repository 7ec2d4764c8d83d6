//! The device record in a virtual board's flash.

use std::{path::Path, sync::OnceLock};

use host_sim::{
    error::Error,
    scene::{
        NamedScene, Scene,
        record::{board_facts, load, words},
    },
};
use zwidth::{VelocitySettings, device::Device};

use crate::{
    board::{BOARDS, Board},
    elf::Elf,
};

/// Name of the symbol with the record's address in the image (memory.x). `SECTOR` is the size reserved for the record,
/// in bytes.
const SYMBOL: &str = "_device_record";
const SECTOR: usize = 16 * 1024;

/// The name of each board, and the device record that its image is built with.
const BUILT_IN: [(&str, &[u8]); BOARDS.len()] = [
    ("nucleo-f446re", include_bytes!("../../scenes/nucleo-f446re.device")),
    ("discovery-f407", include_bytes!("../../scenes/discovery-f407.device")),
];

/// Cutoff of the board after boot, in Hz. It is used if the scene gives none.
const CUTOFF_HZ: f64 = 1500.0;

impl Elf {
    /// The image with this record in place of the image's own record. The rest of the flash sector is erased.
    ///
    /// # Errors
    /// The image is from an older firmware, which has no device record.
    pub fn with_record(&self, record: &[u8]) -> Result<Self, Error> {
        let Some(address) = self.address_of(SYMBOL) else {
            return Err(Error::input(format!(
                "the image has no place for a device record: {SYMBOL}"
            )));
        };
        let mut elf = self.clone();
        let mut sector = record.to_vec();
        sector.resize(SECTOR.max(sector.len()), 0xFF);
        elf.flash.push((address, sector));
        Ok(elf)
    }
}

/// The device of the record in the board's image.
///
/// # Panics
/// Never: tests check that the record is valid.
pub fn built_in(board: Board) -> &'static Device<'static> {
    static DEVICES: [OnceLock<Device<'static>>; BOARDS.len()] =
        [const { OnceLock::new() }; BOARDS.len()];
    let records = BUILT_IN.iter().zip(&DEVICES);
    let found = records.into_iter().find(|((name, _), _)| *name == board.name);
    let ((_, bytes), device) = found.expect("every board has a record");
    device.get_or_init(|| read(bytes, board).expect("the record of a board is whole"))
}

/// Reads a record as a device. The device's memory is never freed, since a program reads one record only.
///
/// # Errors
/// The record is not valid for that board.
pub fn read(record: &[u8], board: Board) -> Result<Device<'static>, Error> {
    Device::from_record(words(record).leak(), &board_facts(board.name)?).map_err(Error::input)
}

/// Checks that the board's record and the scene use the same units. An invalid record is not an error here, since the
/// board itself reports an invalid record.
///
/// # Errors
/// One of the two is linear and the other rotary, or their radii differ.
pub fn same_units(record: &[u8], board: Board, scene: &Scene) -> Result<(), String> {
    let words = words(record);
    let facts = board_facts(board.name).map_err(|error| error.to_string())?;
    let Ok(device) = Device::from_record(&words, &facts) else { return Ok(()) };
    let (has, wanted) = (device.radius_m, scene.units.radius_m());
    if has == wanted {
        return Ok(());
    }
    Err(format!(
        "its handle_radius_m is {has}, allowed that of the scene, {wanted} (0: a linear device); the console has its units"
    ))
}

/// Reads the record file of the option `--device`, for this scene.
///
/// # Errors
/// The file cannot be read, or the record has other units than the scene.
pub fn given(path: &Path, board: Board, scene: &NamedScene) -> Result<Vec<u8>, Error> {
    let bytes = load(path)?;
    same_units(&bytes, board, &scene.scene)
        .map_err(|text| Error::Input(format!("--device {}: {text}", path.display())))?;
    Ok(bytes)
}

/// Whether the scene is the board's own scene, whose record the image has.
pub fn is_built_in(scene: &NamedScene, board: Board) -> bool {
    scene.files.is_empty() && scene.name == board.name
}

/// The record of a scene on that board, without an envelope. `None` for the board's own scene.
///
/// # Errors
/// The scene does not fit the board.
pub fn record(scene: &NamedScene, board: Board) -> Result<Option<Vec<u8>>, Error> {
    if is_built_in(scene, board) {
        return Ok(None);
    }
    let facts = board_facts(board.name)?;
    let asked = scene.scene.board.as_ref().and_then(|table| table.cutoff_hz);
    let asked = asked.or(scene.scene.velocity.cutoff_hz());
    let velocity = VelocitySettings::Butterworth { cutoff_hz: asked.unwrap_or(CUTOFF_HZ) };
    scene.on(&facts).prepared(&facts, velocity)?.record(&[], &facts).map(Some)
}
