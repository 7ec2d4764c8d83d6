//! `prepare`: makes the device record of a scene, for a board's firmware.

use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;
use zwidth::{
    Output,
    device::{Device, record::BoardFacts},
    safety::{CurrentSettings, SafetySettings},
};

use super::{Common, progress};
use crate::{
    error::Error,
    output::{
        in_units::InUnits,
        recommended::{Answer, outside, sentences},
        terminal::print_result,
    },
    scene::{
        Criterion, NamedScene, Scene,
        record::{Prepared, board_facts, words},
    },
    study::{
        board_envelope::{
            DeviceRecord, Found, Part, first_settings, fitting, says_first, with_first_estimator,
        },
        recommended::{QuietStudy, recommended},
    },
};

/// Makes the device record of a scene. With this record, the image of a board becomes the firmware of the device.
///
/// The command makes all checks of the board, computes the envelope of walls that are predicted to be stable, and
/// prints the board's settings. The record is a separate file. ZWIDTH_DEVICE=FILE cargo flash builds the record into
/// the image. The record can also be programmed alone, or be given to cargo board with --device FILE.
#[derive(Debug, Args)]
pub struct PrepareArgs {
    /// Built-in scene or scene file. The scene's name becomes the device's name.
    #[arg(required_unless_present = "starter")]
    scene: Option<String>,
    /// The board [default: the scene's board.name].
    #[arg(long, value_name = "NAME", required_unless_present = "scene")]
    board: Option<String>,
    /// A first record for a device that nobody has measured: no wall, low limits of speed and heat. Counts and force
    /// are those of SCENE, or, without SCENE, of the board's own scene.
    #[arg(long)]
    starter: bool,
}

/// Time from a fault until the force is off, in s, if the board detects the fault by itself (docs/safety.md).
const OFF_S: f64 = 3e-3;

/// The settings that the board will have.
#[derive(Serialize)]
struct Json {
    device: String,
    board: &'static str,
    file: String,
    bytes: usize,
    record_hash: String,
    scene_hash: String,
    envelope_hash: String,
    resolution_m: f64,
    full_scale_n: f64,
    continuous_force_n: f64,
    hit_longest_s: f64,
    speed_max_m_per_s: f64,
    travel_m: [f64; 2],
    latency_samples: f64,
    period_samples: u32,
    sign_test_expected_counts: f64,
    sign_test_counts: u32,
    heaviest_mass_kg: f64,
    heaviest_damping_n_s_per_m: f64,
    /// Largest energy that the wall gives in a contact with the passivity controller. `null` without the controller.
    passivity_reserve_j: Option<f64>,
    /// Speed that the free handle reaches under full force until a fault has switched the force off. `fault_travel_m`
    /// is the distance that the handle travels in this time.
    fault_speed_m_per_s: f64,
    fault_travel_m: f64,
    /// Voltages at rest and at full command, as fractions of the analogue supply. `null` if the input is not used.
    current_sense: Option<[f64; 2]>,
    estimator: &'static str,
    cutoff_hz: Option<f64>,
    envelope: Vec<PartJson>,
    /// The recommendation of `sweep`. Absent for a starter.
    #[serde(flatten)]
    recommended: Option<Answer>,
    guessed: Vec<String>,
    /// Keys of the scene whose values are estimated.
    estimated: Vec<String>,
}

#[derive(Serialize)]
struct PartJson {
    /// Name of the design. It is `null` for the scene's own estimator, which is prepared at the scene's cutoffs.
    design: Option<String>,
    estimator: &'static str,
    period_samples: u32,
    boundaries: usize,
    rows: usize,
    ideal_cutoff_hz: Option<f64>,
    stiffness_peak_n_per_m: f64,
}

pub fn run(args: &PrepareArgs, common: &Common) -> Result<(), Error> {
    let named = args.scene.as_ref().or(args.board.as_ref());
    let mut scene = NamedScene::load(named.map_or("", String::as_str))?;
    let own = scene.scene.board.as_ref().map(|board| board.name.as_str());
    let Some(board) = args.board.as_deref().or(own) else {
        return Err(Error::Input(format!("{}: board.name is missing, or --board", scene.name)));
    };
    let board = board_facts(board)?;
    if args.starter {
        scene = starter(scene, args.scene.is_none(), &board);
    }
    let file = common.out.clone().unwrap_or_else(|| beside(&scene));
    let mut outputs = common.outputs(&scene.files)?;
    let place = outputs.file(&file)?;
    let asked = first_settings(&scene.scene, None)?;
    let file_of = named.unwrap_or(&scene.name);
    let all = |first: &_| Part::all(&scene.scene, first).map_err(|error| error.of(file_of));
    let parts = if args.starter { vec![] } else { all(&asked)? };
    fitting(&scene, &board, asked, !args.starter)?; // before the walks, which take long
    let quiet = (!args.starter).then(|| quiet_walls(&scene, common)).transpose()?;
    let (first, parts) = match quiet.as_ref().and_then(QuietStudy::cutoff_hz) {
        Some(hz) if !says_first(&scene.scene) => {
            let first = first_settings(&scene.scene, Some(hz))?;
            (first, all(&first)?)
        }
        _ => (asked, parts),
    };
    let bar = progress::bar(parts.iter().map(Part::walks).sum());
    let of = (first, parts);
    let made = DeviceRecord::of(&scene, &board, of, common.how(), || bar.inc(1))?;
    bar.finish_and_clear();
    let DeviceRecord { prepared, found, bytes } = made;
    outputs.write(place, &bytes)?;
    outputs.commit()?;
    let record = words(&bytes);
    let device = Device::from_record(&record, &board).map_err(Error::input)?;
    let (prepared, found) = (&prepared, &found);
    let says = Said { named: &scene, scene: &scene.scene, board, prepared, device, found, quiet };
    let json = says.json(&file, bytes.len());
    let units = scene.scene.units;
    print_result(common.json, InUnits(units, json), || {
        let guessed = says.left_out();
        units.text(&says.text(&file, bytes.len())) + &guessed
    })
}

fn quiet_walls(scene: &NamedScene, common: &Common) -> Result<QuietStudy, Error> {
    let how = common.how();
    let cutoffs_hz = &scene.scene.sweep.cutoffs_hz;
    let bar = progress::bar(cutoffs_hz.len() as u64);
    let first = with_first_estimator(scene)?;
    let found = recommended(how, &first, cutoffs_hz, true, |_| bar.inc(1));
    bar.finish_and_clear();
    found.map_err(|error| error.of(&scene.name))
}

/// Path of the file `NAME.device`. It is in the scene's folder. For a built-in scene it is in the current folder.
fn beside(scene: &NamedScene) -> PathBuf {
    let folder = scene.files.first().and_then(|file| file.parent()).unwrap_or(Path::new(""));
    folder.join(format!("{}.device", scene.name))
}

/// Largest speed in a starter's record, in m/s.
const STARTER_SPEED_M_PER_S: f64 = 0.1;
/// Assumed continuous force of the motor, as a fraction of full scale.
const STARTER_CONTINUOUS: f64 = 0.1;
/// Force of the starter's sign test, as a fraction of full scale.
const STARTER_SIGN_TEST: f64 = 0.02;

/// A safe scene for a device that nobody has measured.
fn starter(mut named: NamedScene, is_boards: bool, board: &BoardFacts) -> NamedScene {
    named = named.on(board);
    if is_boards {
        named.name = "starter".into();
    }
    let full_n = named.scene.full_scale_n();
    let scene = &mut named.scene;
    let mut safety = scene.safety.unwrap_or_default();
    safety.speed_max_m_per_s = Some(STARTER_SPEED_M_PER_S);
    safety.ramp_in_s = Some(1.0);
    safety.sign_test_force = Some(STARTER_SIGN_TEST);
    safety.sign_test_counts = None;
    // The check of a push expects almost no motion with the largest allowed mass and damping, so every device passes
    // it.
    safety.heaviest_mass_kg = Some(*SafetySettings::HEAVIEST_MASS_KG.end());
    safety.heaviest_damping_n_s_per_m = Some(*SafetySettings::HEAVIEST_DAMPING_N_S_PER_M.end());
    scene.safety = Some(safety);
    let mut motor = scene.motor.unwrap_or_default();
    motor.continuous_force_n = Some(STARTER_CONTINUOUS * full_n);
    scene.motor = Some(motor);
    let mut back = scene.back.unwrap_or_default();
    back.speed_m_per_s = Some(STARTER_SPEED_M_PER_S / 2.0);
    back.force_n = Some(STARTER_CONTINUOUS * full_n);
    scene.back = Some(back);
    named
}

/// The board's settings, as they are written for people and for programs.
struct Said<'a> {
    named: &'a NamedScene,
    scene: &'a Scene,
    board: BoardFacts,
    prepared: &'a Prepared,
    device: Device<'a>,
    found: &'a [Found],
    /// The recommendation of `sweep`. `None` for a starter.
    quiet: Option<QuietStudy>,
}

impl Said<'_> {
    /// Motion of the free handle in the sign test, in counts.
    fn sign_test_counts(&self) -> f64 {
        let Device { safety, design, .. } = &self.device;
        self.scene.sign_test_m(safety.sign_test_force) / design.resolution_m
    }

    /// Speed in m/s and travel in m that the free handle reaches from rest under full force, until a fault switches the
    /// force off. They are F t / m and F t^2 / (2 m). Damping is left out, because it would only reduce speed and
    /// travel.
    fn fault(&self) -> [f64; 2] {
        let speed = self.device.design.full_scale_n * OFF_S / self.scene.device.mass_kg;
        [speed, 0.5 * speed * OFF_S]
    }

    /// Voltages of the amplifier's current output at rest and at full command, as fractions of the supply.
    fn current_sense(&self) -> Option<[f64; 2]> {
        let CurrentSettings { rest, full } = self.device.current;
        (self.device.current != CurrentSettings::UNUSED).then_some([rest, full])
    }

    fn json(&self, file: &Path, bytes: usize) -> Json {
        let Device { key, design, safety, duty, settings, envelope, .. } = &self.device;
        let part = |found: &Found| PartJson {
            design: found.part.design.as_ref().map(|(name, _)| name.clone()),
            estimator: found.part.estimator.text(),
            period_samples: found.part.period,
            boundaries: found.boundaries().count(),
            rows: found.rows(),
            ideal_cutoff_hz: found.sweep.ideal.map(|ideal| ideal.cutoff_hz),
            stiffness_peak_n_per_m: peak(found),
        };
        Json {
            device: key.name.text().into(),
            board: self.board.name,
            file: file.display().to_string(),
            bytes,
            record_hash: format!("{:08x}", key.hash),
            scene_hash: format!("{:08x}", self.device.scene_hash),
            envelope_hash: format!("{:08x}", envelope.hash()),
            resolution_m: design.resolution_m,
            full_scale_n: design.full_scale_n,
            continuous_force_n: duty.continuous_force_n,
            hit_longest_s: duty.longest_hit_s(design),
            speed_max_m_per_s: safety.speed_max_m_per_s,
            travel_m: [safety.travel_low_m, safety.travel_high_m],
            latency_samples: self.device.latency_samples,
            period_samples: design.period,
            sign_test_expected_counts: self.sign_test_counts(),
            sign_test_counts: safety.sign_test_counts,
            heaviest_mass_kg: safety.heaviest_mass_kg,
            heaviest_damping_n_s_per_m: safety.heaviest_damping_n_s_per_m,
            passivity_reserve_j: self.scene.reserve_j(),
            fault_speed_m_per_s: self.fault()[0],
            fault_travel_m: self.fault()[1],
            current_sense: self.current_sense(),
            estimator: settings.velocity.name().text(),
            cutoff_hz: cutoff(&self.device),
            envelope: self.found.iter().map(part).collect(),
            recommended: self.quiet.as_ref().map(|study| Answer::of(self.named, study)),
            guessed: self.prepared.guessed.clone(),
            estimated: self.scene.estimated_keys(),
        }
    }

    fn text(&self, file: &Path, bytes: usize) -> String {
        let Device { key, design, safety, duty, settings, envelope, .. } = &self.device;
        let output = match design.output {
            Output::Continuous => "force without steps".to_owned(),
            Output::Dac { bits } => format!("DAC of {bits} bits"),
            Output::Pwm { steps } => format!("PWM of {steps} steps"),
        };
        let mm = |metres: f64| zwidth::shorten(1e3 * metres);
        let (rate, period) = (design.rate_hz, design.period);
        let cutoff = cutoff(&self.device).map_or_else(String::new, |hz| format!(" at {hz} Hz"));
        let expected = self.sign_test_counts();
        let mut lines = vec![
            format!(
                "{}: {}, {bytes} bytes, record {:08x}, scene {:08x}, envelope {:08x}",
                key.name.text(),
                file.display(),
                key.hash,
                self.device.scene_hash,
                envelope.hash()
            ),
            format!(
                "  board      {}, {output}, {rate} samples a second, an output with every {period}th",
                self.board.name
            ),
            format!(
                "  position   {} um a count; force only from {} to {} mm, start {} mm, wall {} mm",
                zwidth::shorten(1e6 * design.resolution_m),
                mm(safety.travel_low_m),
                mm(safety.travel_high_m),
                mm(self.device.back.start_m),
                mm(settings.wall.position_m)
            ),
            format!(
                "  force      {} N at full command, {} N for ever: a hit takes {:.1} s at most",
                zwidth::shorten(design.full_scale_n),
                zwidth::shorten(duty.continuous_force_n),
                duty.longest_hit_s(design)
            ),
            format!(
                "  speed      off above {} m/s; a faster step than {} m/s is no motion",
                safety.speed_max_m_per_s, safety.speed_believable_m_per_s
            ),
            format!(
                "  latency    {} samples, {:.1} us",
                self.device.latency_samples,
                1e6 * self.device.latency_samples / rate
            ),
            format!(
                "  sign test  {} % of full scale moves the free handle by {expected:.0} counts; {} needed",
                zwidth::shorten(100.0 * safety.sign_test_force),
                safety.sign_test_counts
            ),
            format!(
                "  push       above 10 % has to move the count as it would {} kg with {} N s/m",
                zwidth::shorten(safety.heaviest_mass_kg),
                zwidth::shorten(safety.heaviest_damping_n_s_per_m)
            ),
            {
                let [speed, travel] = self.fault();
                format!(
                    "  a fault    is off within {} ms: until then full force gives the free handle {} m/s and {} mm",
                    1e3 * OFF_S,
                    zwidth::shorten(speed),
                    mm(travel)
                )
            },
            format!("  estimator  {}{cutoff} at first", settings.velocity.name().text()),
        ];
        if let Some(reserve_j) = self.scene.reserve_j() {
            lines.push(format!("  passivity  a contact gives at most {reserve_j:.3e} J"));
        }
        if let Some([rest, full]) = self.current_sense() {
            lines.push(format!(
                "  current    read on PB0: {rest} of the analogue supply at rest, {full} at full command"
            ));
        }
        for found in self.found {
            let ideal = found.sweep.ideal.map_or_else(
                || "no stable wall".to_owned(),
                |ideal| {
                    format!(
                        "ideal {} Hz; K up to {} N/m at the cutoff with the most",
                        ideal.cutoff_hz,
                        peak(found)
                    )
                },
            );
            let estimator = found.part.estimator.text();
            let of = match &found.part.design {
                None => estimator.to_owned(),
                Some((name, _)) => format!("design {name} ({estimator})"),
            };
            lines.push(format!(
                "  envelope   {of}, output period {}: {} cutoffs, {} rows; {ideal}",
                found.part.period,
                found.boundaries().count(),
                found.rows()
            ));
        }
        if self.found.is_empty() {
            lines.push("  envelope   none: every wall is refused until unlock envelope".into());
        } else {
            lines.push(format!("  judged by  {}", self.judged_by()));
        }
        if let Some(study) = &self.quiet {
            lines.extend(sentences(self.named, study).first().map(|said| format!("  {said}")));
            let first_hz = self.device.settings.velocity.cutoff_hz();
            let note = first_hz.and_then(|first_hz| outside(study, first_hz));
            lines.extend(
                note.map(|note| format!("  note: at first {note}: board.cutoff_hz sets it")),
            );
        }
        let hit = &self.named.scene.wall_hit;
        if let (Criterion::Quiet, Some(limit_n)) = (hit.criterion, hit.force_rms_limit_n) {
            lines.push(format!(
                "  note: the record has no limit of the force's RMS: type `force_rms {limit_n}` on the board's console"
            ));
        }
        let wall_m = settings.wall.position_m;
        if wall_m > safety.travel_high_m {
            lines.push(format!(
                "  note: the wall, {} mm, is beyond the travel: fault 15 comes before it",
                mm(wall_m)
            ));
        }
        // Only a starter can expect fewer counts here, because its device is unknown.
        let needed = f64::from(safety.sign_test_counts);
        if expected < needed {
            lines.push(
                "  note: the sign test sees less than it needs: the board does not arm".into(),
            );
        } else if expected < 2.0 * needed {
            lines.push("  note: the sign test sees little more than it needs".into());
        }
        lines.join("\n")
    }

    /// The criterion by which the sweeps of the envelope judge a stable wall.
    fn judged_by(&self) -> String {
        let wall_hit = &self.scene.wall_hit;
        let limit = match wall_hit.criterion {
            Criterion::Felt => format!("motion felt below {} dB", wall_hit.felt_limit_db),
            Criterion::Quiet => {
                let limit_n = zwidth::shorten(wall_hit.force_rms_limit_n());
                format!("quiet, RMS of the force below {limit_n} N")
            }
            criterion => {
                let of = wall_hit.rms_of().name();
                let limit = zwidth::shorten(1e6 * wall_hit.rms_limit_m);
                let unsaturated = criterion == Criterion::Unsaturated;
                let more = if unsaturated { ", no output at the limit" } else { "" };
                format!("RMS of the {of} below {limit} um{more}")
            }
        };
        format!("{limit}; the {} pushes ([wall_hit])", wall_hit.push_by.name())
    }

    /// Lines with the guessed values and the estimated values, in the keys and units of the scene's file.
    fn left_out(&self) -> String {
        let guessed = match self.prepared.guessed.as_slice() {
            [] => String::new(),
            guessed => format!("\n  guessed    {}", guessed.join(", ")),
        };
        let note = self.scene.estimated_note().map(|note| format!("\n  note: {note}"));
        guessed + &note.unwrap_or_default()
    }
}

fn cutoff(device: &Device<'_>) -> Option<f64> {
    device.settings.velocity.cutoff_hz()
}

fn peak(found: &Found) -> f64 {
    let points = found.boundaries().flat_map(|boundary| boundary.points.to_vec());
    points.map(|point| point.stiffness_high_n_per_m).fold(0.0, f64::max)
}
