//! The device record of a scene. The firmware of a board reads its device from this record.

use std::path::Path;

use zwidth::{
    Output, VelocitySettings,
    device::{
        Device,
        designs::{Designs, NamedFilter},
        record::{BoardFacts, WORDS_MAX, hash_of},
    },
    experiment::Criterion,
    safety::envelope::{Boundary, Envelope},
    store::{DeviceKey, Name},
    velocity::Sense,
};

use super::{BUILT_IN, NamedScene, OnBoard, Quantisation, Scene};
use crate::{error::Error, input, range::within};

/// Rate, output, inputs and latency of the board with this name. They are read from the board's built-in scene.
pub fn board_facts(name: &str) -> Result<BoardFacts, Error> {
    let of = |scene: &NamedScene| scene.scene.board.as_ref().map(|board| board.name.clone());
    let mut boards = vec![];
    for &(built_in, _) in BUILT_IN {
        let scene = NamedScene::load(built_in)?;
        if of(&scene).as_deref() != Some(built_in) {
            continue;
        }
        if built_in == name {
            let design = scene.scene.design();
            return Ok(BoardFacts {
                name: built_in,
                rate_hz: design.rate_hz,
                output: design.output,
                senses: &[Sense::Force],
                latency_samples: scene.scene.actuator.latency,
            });
        }
        boards.push(built_in);
    }
    Err(Error::Input(format!("the board is `{name}`, allowed {}", boards.join(", "))))
}

/// A device with all that a board needs.
#[derive(Clone, Debug)]
pub struct Prepared {
    /// The device, without designs and envelope.
    pub device: Device<'static>,
    pub designs: Vec<NamedFilter>,
    /// The values that were guessed for keys that the scene leaves out, as `key value` in the scene's units.
    pub guessed: Vec<String>,
}

impl NamedScene {
    /// The same device with the board's output. Its latency is at least the board's latency.
    #[must_use]
    pub fn on(&self, board: &BoardFacts) -> Self {
        let mut named = self.clone();
        named.name.truncate(named.name.floor_char_boundary(Name::LEN));
        let scene = &mut named.scene;
        scene.output = match board.output {
            Output::Continuous => None,
            Output::Dac { bits } => Some(Quantisation::Dac { bits }),
            Output::Pwm { steps } => Some(Quantisation::Pwm { steps }),
        };
        scene.actuator.latency = scene.actuator.latency.max(board.latency_samples);
        named
    }

    /// Prepares the device for this board. The estimator `velocity` is active at the start.
    ///
    /// # Errors
    /// [`Error::Input`]: the scene does not suit the board.
    pub fn prepared(
        &self,
        board: &BoardFacts,
        velocity: VelocitySettings,
    ) -> Result<Prepared, Error> {
        let scene = &self.scene;
        let refuse = |why: String| Error::Input(format!("{}: {why}", self.name));
        let Some(name) = Name::new(&self.name).filter(|_| !self.name.is_empty()) else {
            let most = Name::LEN;
            return Err(refuse(format!(
                "the device's name is that of its scene file, allowed 1 to {most} bytes"
            )));
        };
        if scene.design().output != board.output {
            let needed = match board.output {
                Output::Continuous => "no [output]".to_owned(),
                Output::Dac { bits } => format!("[output] kind = \"dac\", bits = {bits}"),
                Output::Pwm { steps } => format!("[output] kind = \"pwm\", steps = {steps}"),
            };
            return Err(refuse(format!("the board {} needs {needed}", board.name)));
        }
        let on = |key: &str| format!("{key} on the board {}", board.name);
        within(&on("control.rate_hz"), scene.control.rate_hz, board.rate_hz..=board.rate_hz)
            .and_then(|()| {
                let longest = *super::ranges::LATENCY.end();
                let latency = scene.actuator.latency;
                within(&on("actuator.latency"), latency, board.latency_samples..=longest)
            })
            .map_err(refuse)?;
        if scene.passivity.is_some() && scene.actuator.latency_samples() > 0 {
            return Err(refuse(format!(
                "actuator.latency with [passivity] on a board is {}, allowed below 0.5",
                scene.actuator.latency
            )));
        }
        let OnBoard { safety, calibration, duty, current, back, signs, guessed } = scene.on_board();
        // The list `estimated` does not change the device.
        let content = Scene { estimated: vec![], ..scene.clone() };
        let text = toml::to_string(&content)
            .map_err(|error| Error::Internal(format!("{}: {error}", self.name)))?;
        let settings = scene.settings(velocity, 0.0, 0.0);
        let mut hit = scene.hit_settings();
        hit.push_n = 0.0; // no push until a user sets one
        (hit.settle_s, hit.window_s) = (scene.wall_hit.settle_s, scene.wall_hit.window_s); // the same for every protocol
        let device = Device {
            board: Name::of(board.name),
            key: DeviceKey { name, hash: 0 },
            scene_hash: hash_of(text.as_bytes()),
            design: scene.design(),
            latency_samples: scene.actuator.latency,
            senses: board.senses,
            envelope: Envelope::EMPTY,
            designs: Designs::NONE,
            safety,
            duty,
            current,
            radius_m: scene.units.radius_m(),
            back,
            calibration,
            signs,
            settings,
            hit,
            criterion: match scene.wall_hit.criterion {
                super::Criterion::Quiet => Criterion::Quiet,
                _ => Criterion::Rms, // a board has only these two criteria
            },
            walk: scene.walk_plan(),
        };
        let guessed = guessed.iter().map(|guess| guess.told(scene.units)).collect();
        let prepared = Prepared { device, designs: scene.named_filters(), guessed };
        // finds an error here that the board would report at boot
        prepared.record(&[], board).map_err(|error| error.of(&self.name))?;
        Ok(prepared)
    }
}

impl Prepared {
    /// The bytes of the device's record with this envelope.
    ///
    /// # Errors
    /// [`Error::Input`]: the record is too long, or the board would reject it.
    pub fn record(
        &self,
        boundaries: &[Boundary<'_>],
        board: &BoardFacts,
    ) -> Result<Vec<u8>, Error> {
        let mut words = [0; WORDS_MAX];
        let words = self.device.to_record(&self.designs, boundaries, &mut words).ok_or_else(|| {
            let rows: usize = boundaries.iter().map(|boundary| boundary.points.len()).sum();
            let sector = WORDS_MAX / 256;
            Error::Input(format!(
                "the envelope has {rows} rows, and the record has {sector} KiB: leave out values of sweep.cutoffs_hz, \
                 board.estimators or board.periods, or designs"
            ))
        })?;
        Device::from_record(words, board)
            .map_err(|error| Error::Input(format!("the device record: {error}")))?;
        Ok(words.iter().flat_map(|word| word.to_le_bytes()).collect())
    }
}

/// The bytes of a record as words. Bytes after the last whole word are left out.
pub fn words(bytes: &[u8]) -> Vec<u32> {
    bytes.as_chunks().0.iter().map(|&word| u32::from_le_bytes(word)).collect()
}

/// Reads the bytes of a device record. Only the length is checked, not the content.
///
/// # Errors
/// [`Error::Input`] if the file cannot be read or does not fit into a flash sector.
pub fn load(path: &Path) -> Result<Vec<u8>, Error> {
    let bytes = input::read(path, input::DEVICE)?;
    if bytes.len() > 4 * WORDS_MAX {
        let (path, sector) = (path.display(), WORDS_MAX / 256);
        return Err(Error::Input(format!("{path} is longer than a record may be, {sector} KiB")));
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use zwidth::{
        safety::envelope::{Key, Point},
        velocity::EstimatorName,
    };

    #[test]
    fn an_envelope_that_does_not_fit_the_sector_is_refused_with_what_to_leave_out() {
        let scene = NamedScene::load("nucleo-f446re").unwrap();
        let board = board_facts("nucleo-f446re").unwrap();
        let velocity = VelocitySettings::Butterworth { cutoff_hz: 1500.0 };
        let prepared = scene.prepared(&board, velocity).unwrap();
        let points = |rows: u32| {
            let point = |n| Point {
                damping_n_s_per_m: f64::from(n),
                stiffness_low_n_per_m: 0.0,
                stiffness_high_n_per_m: 1.0,
            };
            (0..rows).map(point).collect::<Vec<_>>()
        };
        let of = |rows| {
            let key = Key {
                estimator: EstimatorName::Butterworth,
                cutoff_hz: 1500.0,
                period: 10,
                design: 0,
            };
            prepared.record(&[Boundary { key, points: &points(rows) }], &board)
        };
        assert_eq!(of(1326).map(|bytes| bytes.len()).ok(), Some(4 * (WORDS_MAX - 1)));
        let error = of(1327).map(|bytes| bytes.len()).unwrap_err().to_string();
        assert!(error.contains("the envelope has 1327 rows, and the record has 16 KiB"), "{error}");
    }

    #[test]
    fn a_board_judges_at_first_as_the_scene_does() {
        let mut scene = NamedScene::load("nucleo-f446re").unwrap();
        let board = board_facts("nucleo-f446re").unwrap();
        let velocity = VelocitySettings::Butterworth { cutoff_hz: 1500.0 };
        for (of_scene, of_board) in [
            (crate::scene::Criterion::Quiet, Criterion::Quiet),
            (crate::scene::Criterion::Felt, Criterion::Rms),
        ] {
            scene.scene.wall_hit.judge(of_scene, None);
            let bytes = scene.prepared(&board, velocity).unwrap().record(&[], &board).unwrap();
            let words = words(&bytes);
            let device = Device::from_record(&words, &board).unwrap();
            assert_eq!(device.defaults().criterion, of_board);
        }
    }

    #[test]
    fn a_device_takes_from_its_scene_what_a_guess_would_else_be() {
        let own = NamedScene::load("nucleo-f446re").unwrap();
        let mut bare = own.clone();
        (bare.scene.safety, bare.scene.motor, bare.scene.back) = (None, None, None);
        assert_eq!(own.scene.on_board().guessed, []);
        let (own, bare) = (own.scene.on_board(), bare.scene.on_board());
        // The guesses are scaled from the paper's device, so only two rounded values differ.
        assert_eq!((own.back, own.calibration), (bare.back, bare.calibration));
        assert_eq!(own.safety.travel_high_m, bare.safety.travel_high_m);
        assert!((bare.safety.sign_test_counts as f64 / 200.0 - 1.0).abs() < 0.03);
        assert!((bare.duty.continuous_force_n / 4.1 - 1.0).abs() < 0.01);
        assert_eq!(bare.guessed.len(), 19);
    }
}
