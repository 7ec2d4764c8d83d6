//! Converts a device record, and settings saved on a board, back into a scene.
//!
//! A record has only the values that the board needs. Mass, damping, stiffness and the elements of the plant come from
//! another scene. A copy of the board's settings sectors can replace the default settings in the record.

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};
use zwidth::{
    Output,
    device::{
        Device,
        record::{BOARD_AT, BadRecord},
    },
    experiment::Criterion as Judged,
    safety::CurrentSettings,
    store::{Loaded, Name, load},
    velocity::EstimatorName,
};

use super::{
    BoardTable, Criterion, MotorTable, PassivityTable, Quantisation, ReturnTable, SafetyTable,
    Scene, Sign, VelocityTable, record::board_facts,
};
use crate::error::Error;

/// Number of bytes in one of the two settings sectors.
const SECTOR: usize = 16 * 1024;

/// Reads the device from the words of a record. The device is read for the board that the record names.
///
/// # Errors
/// [`Error::Input`] has the error that the board would report, and a remedy.
pub fn device(words: &[u32]) -> Result<Device<'_>, Error> {
    let name = words.get(BOARD_AT / 4..BOARD_AT / 4 + Name::LEN / 4).unwrap_or_default();
    let bytes: Vec<u8> = name.iter().flat_map(|word| word.to_le_bytes()).collect();
    let text = String::from_utf8_lossy(&bytes);
    // The board's name is only needed for a valid record. For a file that is not a valid record, every board gives the
    // same error.
    let board =
        board_facts(text.trim_end_matches('\0')).or_else(|_| board_facts("nucleo-f446re"))?;
    Device::from_record(words, &board)
        .map_err(|bad| Error::Input(format!("no device record: {bad}{}", help(&bad))))
}

/// What to do about an error in a record. The text is printed after the text of the error.
fn help(bad: &BadRecord) -> String {
    let anew = "; make it anew: cargo sim prepare, with the scene that it was made of";
    match *bad {
        BadRecord::Layout(_) => anew.into(),
        BadRecord::Board(_) => "; no board of that name is known".into(),
        BadRecord::Estimator(id) => EstimatorName::replacing_id(id)
            .map_or(String::new(), |other| format!(" any more{anew}, and {other} in it")),
        _ => String::new(),
    }
}

/// Reads the settings from a copy of both settings sectors. Sector 1 is first in the copy. If the copy has no settings
/// of this device, the defaults are returned.
///
/// # Errors
/// [`Error::Input`]: the copy has the wrong length.
pub fn saved(device: &Device<'_>, bytes: Vec<u8>) -> Result<Loaded, Error> {
    if bytes.len() != 2 * SECTOR {
        let (length, needed) = (bytes.len(), 2 * SECTOR);
        return Err(Error::Input(format!(
            "{length} bytes, needed {needed}: sectors 1 and 2, from address 0x08004000 on"
        )));
    }
    Ok(load(&mut Copied(bytes), device.defaults()))
}

/// Replaces the settings in the record with the loaded settings.
#[must_use]
pub fn with_settings<'a>(device: Device<'a>, loaded: &Loaded) -> Device<'a> {
    let stored = &loaded.stored;
    let mut of = device;
    of.design.period = stored.period;
    of.design.full_scale_n = stored.full_scale_n;
    of.settings.velocity = stored.settings.velocity;
    of.settings.wall = stored.settings.wall;
    of.signs = stored.signs;
    of.back.start_m = stored.start_m;
    of.hit.push_n = stored.push_n;
    of.hit.settle_s = stored.settle_s;
    of.hit.window_s = stored.window_s;
    of.hit.rms_limit_m = stored.rms_limit_m;
    of.criterion = stored.criterion;
    of.walk = stored.grid;
    of
}

impl Scene {
    /// This scene with all values of a device record, except K and B of the wall, which scenes do not have.
    ///
    /// # Errors
    /// Record and scene contradict each other. The error has key, value and allowed range.
    pub fn with_device(&self, device: &Device<'_>) -> Result<Self, String> {
        let mut scene = self.clone();
        scene.units = super::Units::Linear;
        let Device {
            design, safety, duty, current, back, calibration, settings, hit, walk, ..
        } = device;
        scene.encoder.resolution_m = design.resolution_m;
        scene.actuator.gain_n_per_v = zwidth::shorten(design.full_scale_n / scene.actuator.limit_v);
        scene.actuator.period = design.period;
        scene.actuator.latency = device.latency_samples;
        scene.control.rate_hz = design.rate_hz;
        scene.output = match design.output {
            Output::Continuous => None,
            Output::Dac { bits } => Some(Quantisation::Dac { bits }),
            Output::Pwm { steps } => Some(Quantisation::Pwm { steps }),
        };
        let own = VelocityTable::from(settings.velocity);
        scene.velocity = own.with_cutoff(None); // `[board]` has the cutoff
        scene.wall.position_m = settings.wall.position_m;
        scene.wall.push_only = settings.wall.push_only;
        scene.device.start_position_m = back.start_m;
        scene.wall_hit.settle_s = hit.settle_s;
        scene.wall_hit.window_s = hit.window_s;
        scene.wall_hit.rms_limit_m = hit.rms_limit_m;
        if (device.criterion == Judged::Quiet) != (scene.wall_hit.criterion == Criterion::Quiet) {
            let criterion = match device.criterion {
                Judged::Rms => Criterion::Rms,
                Judged::Quiet => Criterion::Quiet,
            };
            scene.wall_hit.judge(criterion, None);
        }
        if hit.push_n != 0.0 {
            scene.wall_hit.push_n = hit.push_n;
        }
        scene.walk.stiffness_start_n_per_m = walk.stiffness_start_n_per_m;
        scene.walk.stiffness_step_n_per_m = walk.stiffness_step_n_per_m;
        scene.walk.stiffness_max_n_per_m = walk.stiffness_max_n_per_m;
        scene.walk.damping_start_n_s_per_m = walk.damping_start_n_s_per_m;
        scene.walk.damping_step_n_s_per_m = walk.damping_step_n_s_per_m;
        scene.walk.damping_max_n_s_per_m = walk.damping_max_n_s_per_m;
        let designs = device
            .designs
            .iter()
            .map(|(_, filter)| (filter.name.text().to_owned(), filter.velocity.into()));
        scene.designs = designs.collect();
        let known: Vec<_> = device.envelope.boundaries().map(|(key, _)| key).collect();
        let plain = || known.iter().filter(|key| key.design == 0);
        let mut cutoffs: Vec<f64> =
            plain().map(|key| key.cutoff_hz).filter(|hz| *hz > 0.0).collect();
        cutoffs.sort_by(f64::total_cmp);
        cutoffs.dedup();
        if !cutoffs.is_empty() {
            scene.sweep.cutoffs_hz = cutoffs;
        }
        let mut estimators: Vec<String> =
            plain().map(|key| key.estimator.text().to_owned()).collect();
        estimators.dedup();
        let mut periods: Vec<u32> = known.iter().map(|key| key.period).collect();
        periods.sort_unstable();
        periods.dedup();
        let sign = |reversed: bool| reversed.then_some(Sign::Minus);
        scene.board = Some(BoardTable {
            name: device.board.text().into(),
            cutoff_hz: own.cutoff_hz(),
            design: None,
            estimators,
            periods,
            motor: sign(device.signs.motor_reversed),
            encoder: sign(device.signs.encoder_reversed),
        });
        scene.safety = Some(SafetyTable {
            speed_max_m_per_s: Some(safety.speed_max_m_per_s),
            speed_believable_m_per_s: Some(safety.speed_believable_m_per_s),
            travel_low_m: Some(safety.travel_low_m),
            travel_high_m: Some(safety.travel_high_m),
            ramp_in_s: Some(safety.ramp_in_s),
            sign_test_force: Some(safety.sign_test_force),
            sign_test_counts: Some(safety.sign_test_counts),
            heaviest_mass_kg: Some(safety.heaviest_mass_kg),
            heaviest_damping_n_s_per_m: Some(safety.heaviest_damping_n_s_per_m),
            calibration_travel_m: Some(calibration.travel_m),
        });
        let passive = safety.passive_acceleration_m_per_s2;
        scene.passivity =
            (passive > 0.0).then_some(PassivityTable { acceleration_m_per_s2: Some(passive) });
        let sensed = (*current != CurrentSettings::UNUSED).then_some(*current);
        scene.motor = Some(MotorTable {
            continuous_force_n: Some(duty.continuous_force_n),
            time_constant_s: Some(duty.time_constant_s),
            current_sense_rest: sensed.map(|current| current.rest),
            current_sense_full: sensed.map(|current| current.full),
        });
        scene.back = Some(ReturnTable {
            speed_m_per_s: Some(back.speed_m_per_s),
            force_n: Some(back.force_n),
            stiffness_n_per_m: Some(back.stiffness_n_per_m),
            damping_n_s_per_m: Some(back.damping_n_s_per_m),
            integral_n_per_m_s: Some(back.integral_n_per_m_s),
            tolerance_m: Some(back.tolerance_m),
            timeout_s: Some(back.timeout_s),
        });
        scene.check().and_then(|()| scene.check_start())?;
        Ok(scene)
    }
}

struct Copied(Vec<u8>);

/// Error of an access outside the two sectors.
#[derive(Debug)]
struct Outside;

impl NorFlashError for Outside {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::OutOfBounds
    }
}

impl ErrorType for Copied {
    type Error = Outside;
}

impl Copied {
    fn part(&mut self, from: u32, length: usize) -> Result<&mut [u8], Outside> {
        let from = from as usize;
        self.0.get_mut(from..from + length).ok_or(Outside)
    }
}

impl ReadNorFlash for Copied {
    const READ_SIZE: usize = 4;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Outside> {
        bytes.copy_from_slice(self.part(offset, bytes.len())?);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.0.len()
    }
}

impl NorFlash for Copied {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = SECTOR;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Outside> {
        self.part(from, to.saturating_sub(from) as usize)?.fill(0xFF);
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Outside> {
        for (place, byte) in self.part(offset, bytes.len())?.iter_mut().zip(bytes) {
            *place &= byte; // programming flash only clears bits
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::scene::{
        NamedScene,
        record::{self, words},
    };

    fn built_in(name: &str) -> Vec<u32> {
        let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes");
        words(&record::load(&scenes.join(format!("{name}.device"))).unwrap())
    }

    #[test]
    fn a_record_that_was_read_back_prepares_the_same_device() {
        for name in ["nucleo-f446re", "discovery-f407"] {
            let words = built_in(name);
            let device = device(&words).unwrap();
            let mut named = NamedScene::load(name).unwrap();
            let read = named.scene.with_device(&device).unwrap();
            named.scene = read;
            let board = board_facts(name).unwrap();
            let again = named.prepared(&board, device.settings.velocity).unwrap();
            assert_eq!(again.guessed.len(), 0, "{name}: {:?}", again.guessed);
            let same = Device {
                key: device.key,
                scene_hash: device.scene_hash,
                envelope: device.envelope,
                designs: device.designs,
                ..again.device
            };
            assert_eq!(same, device, "{name}");
        }
    }

    #[test]
    fn saved_settings_take_the_place_of_the_records() {
        let words = built_in("nucleo-f446re");
        let device = device(&words).unwrap();
        let empty = vec![0xFF; 2 * SECTOR];
        let none = saved(&device, empty.clone()).unwrap();
        assert_eq!(none.stored, device.defaults());
        let mut flash = Copied(empty);
        let mut stored = device.defaults();
        (stored.push_n, stored.full_scale_n, stored.start_m) = (1.25, 5.0, 0.01);
        (stored.signs.motor_reversed, stored.criterion) = (true, Judged::Quiet);
        assert!(zwidth::store::save(&mut flash, &stored).is_ok());
        let loaded = saved(&device, flash.0.clone()).unwrap();
        assert_eq!(loaded.stored, stored);
        let base = NamedScene::load("nucleo-f446re").unwrap().scene;
        let read = base.with_device(&with_settings(device, &loaded)).unwrap();
        assert_eq!((read.wall_hit.push_n, read.full_scale_n()), (1.25, 5.0));
        assert_eq!(read.device.start_position_m, 0.01);
        assert_eq!(read.wall_hit.criterion, Criterion::Quiet);
        assert_eq!(read.board.unwrap().motor, Some(Sign::Minus));
        assert!(saved(&device, vec![0; 100]).unwrap_err().to_string().contains("100 bytes"));
    }

    #[test]
    fn what_is_no_record_says_so_and_an_old_one_what_to_do() {
        let mut old = built_in("nucleo-f446re");
        old[0] = old[0] & 0x00FF_FFFF | 2 << 24;
        let error = device(&old).unwrap_err().to_string();
        assert!(error.contains("its layout is 2, this firmware takes 4; make it anew"), "{error}");
        assert!(
            device(&[0; 200]).unwrap_err().to_string().contains("what is in its place is none")
        );
        assert!(device(&[]).is_err());
        let gone = BadRecord::Estimator(28);
        let text = format!("{gone}{}", help(&gone));
        assert!(text.contains("number 28, is not in this image any more; make it anew"), "{text}");
        assert!(text.ends_with("and kalman-3 in it"), "{text}");
        assert_eq!(help(&BadRecord::Estimator(999)), "");
    }
}
