//! The replies to commands. Each is one line, `ok ...` or `error: ...`.

use core::fmt;

use super::{Decimal, ParseError, Situation, spoken::Spoken, usages};
use crate::{
    SettingsError,
    device::{
        Device, Unfit,
        designs::{Designs, NamedFilter},
        record,
    },
    period::PERIODS,
    safety::{
        Fault, Refusal,
        envelope::{Key, Outside},
    },
    store::{LAYOUT, Source, Stored},
    telemetry::{Frame, Record},
    velocity::{EstimatorName, Parameter},
};

/// A reply of the board. Write it with [`Text::of`](super::Text::of). It has no line end.
#[derive(Clone, Copy, Debug)]
pub enum Reply<'a> {
    /// All commands with their usage.
    Help,
    /// The version: the program's commit, the device, and the versions of the data layouts.
    Version(&'a str, &'a Device<'a>),
    /// The command of this name is done.
    Done(&'static str),
    /// The command is done, and a value is now in force. The fields are its name, the value and its unit.
    Value(&'static str, f64, &'static str),
    /// The command is done, and a word is now in force. The fields are the name of the setting and the word.
    Word(&'static str, &'a str),
    /// State of supervisor and experiment, with the newest output.
    Status(&'a Situation, &'a Record),
    /// The settings in force, and the device's designs.
    Settings(&'a Stored, &'a Designs<'a>),
    /// The designs of a device.
    Designs(&'a Designs<'a>),
    /// There is no such design. The reply lists the designs of the device.
    UnknownDesign(&'a Designs<'a>),
    /// Settings were loaded, from this source.
    Loaded(Source),
    /// The latched fault and all causes.
    Faults(&'a Situation),
    /// The line is no command.
    Parse(ParseError),
    /// The command is not allowed now, for this reason.
    Refused(Refusal),
    /// A value is out of range: the parameter and its range.
    Range(&'a SettingsError),
    /// The board cannot run these settings.
    Unfit(Unfit),
    /// This wall is outside the device's envelope. The [`Key`] names the estimator and the output period of the
    /// envelope's table.
    Outside(Outside, &'a Device<'a>, Key),
    /// The hardware failed during this action.
    Failed(&'a str),
}

impl fmt::Display for Reply<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.say(f, Spoken::AT_HANDLE)
    }
}

/// A reply with its numbers in the units of a device.
pub struct ReplyIn<'a>(pub Reply<'a>, pub Spoken);

impl fmt::Display for ReplyIn<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.say(f, self.1)
    }
}

impl Reply<'_> {
    fn say(&self, f: &mut fmt::Formatter<'_>, spoken: Spoken) -> fmt::Result {
        match self {
            Self::Help => {
                f.write_str("ok ")?;
                for (n, usage) in usages().enumerate() {
                    f.write_str(if n > 0 { ", " } else { "" })?;
                    write!(f, "{}", spoken.usage(usage))?;
                }
                Ok(())
            }
            Self::Version(commit, device) => {
                let Device { board, key, scene_hash, envelope, .. } = device;
                write!(f, "{}, board {}, ", Built(commit), board.text())?;
                write!(f, "scene {} {scene_hash:08x}, ", key.name.text())?;
                write!(f, "envelope {:08x}, ", envelope.hash())?;
                let (record, telemetry) = (record::LAYOUT, Frame::VERSION_2);
                write!(f, "layouts record {record}, settings {LAYOUT}, telemetry {telemetry}")
            }
            Self::Done(name) => write!(f, "ok {name}"),
            Self::Value(name, value, unit) => {
                write!(f, "ok {name} {}", spoken.number(*value, unit))
            }
            Self::Word(name, word) => write!(f, "ok {name} {word}"),
            Self::Status(now, record) => status(f, now, record),
            Self::Settings(stored, designs) => settings(f, stored, designs, spoken),
            Self::Designs(designs) => {
                f.write_str("ok designs")?;
                names(f, designs)
            }
            Self::UnknownDesign(designs) => {
                f.write_str("error: unknown design, allowed")?;
                names(f, designs)
            }
            Self::Loaded(source) => write!(f, "ok load: {source}"),
            Self::Faults(now) => faults(f, now),
            Self::Parse(error) => {
                f.write_str("error: ")?;
                error.say(f, spoken)
            }
            Self::Refused(refusal) => refused(f, *refusal),
            Self::Range(error) => write!(f, "error: {}", spoken.refusal(error)),
            Self::Unfit(unfit) => {
                f.write_str("error: ")?;
                match unfit {
                    Unfit::Sense(name, sense) => {
                        let (name, sense) = (name.text(), sense.text());
                        write!(f, "estimator {name} needs {sense}, which this board has not")
                    }
                    Unfit::TooSlow(slow) => write!(f, "{slow}"),
                    Unfit::Period(period) => {
                        write!(f, "period is {}, allowed", Decimal(*period))?;
                        PERIODS.into_iter().try_for_each(|period| write!(f, " {period}"))
                    }
                }
            }
            Self::Outside(outside, device, key) => {
                write!(f, "error: {}", outside.text())?;
                if *outside == Outside::UnknownKey {
                    known(f, device, key)?;
                }
                if let Some(allowed) = outside.allowed() {
                    // The unit of K also converts B, because both contain the radius to the same power.
                    let [low, high] = spoken.limits(allowed, "N/m");
                    write!(f, " {low} to {high}")?;
                }
                f.write_str(", or unlock envelope")
            }
            Self::Failed(what) => write!(f, "error: {what} failed"),
        }
    }
}

/// The beginning of a reply to `version`. It has the package's version and this commit. A board that runs uses it, and
/// also a board that refuses its image or record.
pub(super) struct Built<'a>(pub &'a str);

impl fmt::Display for Built<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, concat!("ok version ", env!("CARGO_PKG_VERSION"), ", commit {}"), self.0)
    }
}

/// All designs that this build can run.
fn names(f: &mut fmt::Formatter<'_>, designs: &Designs<'_>) -> fmt::Result {
    if designs.iter().next().is_none() {
        return f.write_str(" none");
    }
    designs.iter().try_for_each(|(_, NamedFilter { name, .. })| write!(f, " {}", name.text()))
}

/// Lists the estimators, with their cutoffs, and the designs that have a table in the envelope at the output period of
/// `key`.
fn known(f: &mut fmt::Formatter<'_>, device: &Device<'_>, key: &Key) -> fmt::Result {
    let mut last = None;
    for key in device.envelope.beside(key) {
        if key.design > 0 {
            write!(f, "; design {}", device.designs.name_of(key.design).text())?;
            continue;
        }
        if last != Some(key.estimator) {
            write!(f, "; known: {}", key.estimator.text())?;
            last = Some(key.estimator);
        }
        write!(f, " {}", Decimal(key.cutoff_hz))?;
    }
    Ok(())
}

fn status(f: &mut fmt::Formatter<'_>, now: &Situation, record: &Record) -> fmt::Result {
    let status = &now.status;
    write!(f, "ok status {}, fault ", status.state.name())?;
    fault(f, status.fault.map(|record| record.fault))?;
    write!(f, ", {}", now.activity.name())?;
    write!(
        f,
        ", sample {}, position {} counts, velocity {} counts/sample, force {} %, code {}",
        record.sample,
        record.position.counts(),
        Decimal(f64::from(record.velocity.bits()) / 65_536.0),
        Decimal(f64::from(record.force.bits()) / f64::from(1u32 << 30) * 100.0),
        record.command.code(),
    )?;
    for (fact, yes, no) in [
        (status.zeroed, "zeroed", "not zeroed"),
        (status.contact, "in contact", "free"),
        (status.inputs.stop_closed, "stop closed", "stop open"),
        (status.inputs.supply_good, "supply good", "supply low"),
        (status.inputs.settings_valid, "settings valid", "settings refused"),
        (status.unlocked, "envelope unlocked", "envelope locked"),
    ] {
        write!(f, ", {}", if fact { yes } else { no })?;
    }
    Ok(())
}

fn settings(
    f: &mut fmt::Formatter<'_>,
    stored: &Stored,
    designs: &Designs<'_>,
    spoken: Spoken,
) -> fmt::Result {
    let wall = &stored.settings.wall;
    let plus = |reversed: bool| if reversed { '-' } else { '+' };
    let said = |value: f64, unit: &'static str| spoken.number(value, unit);
    write!(
        f,
        "ok get k {}, b {}, wall {}, ",
        said(wall.stiffness_n_per_m, "N/m"),
        said(wall.damping_n_s_per_m, "N s/m"),
        said(wall.position_m, "m"),
    )?;
    let (estimator, values) = EstimatorName::of(&stored.settings.velocity);
    for (parameter, value) in estimator.parameters().into_iter().zip(values) {
        if let Some(Parameter { name, unit, .. }) = parameter {
            write!(f, "{name} {} {unit}, ", Decimal(value))?;
        }
    }
    write!(
        f,
        "estimator {}, push {}, {}, device {}, motor {}, encoder {}",
        estimator.text(),
        said(stored.push_n, "N"),
        if wall.push_only { "push only" } else { "two-sided" },
        stored.device.name.text(),
        plus(stored.signs.motor_reversed),
        plus(stored.signs.encoder_reversed),
    )?;
    write!(
        f,
        ", full scale {}, start {}, settle {} s, window {} s, rms {}",
        said(stored.full_scale_n, "N"),
        said(stored.start_m, "m"),
        Decimal(stored.settle_s),
        Decimal(stored.window_s),
        said(stored.rms_limit_m, "m"),
    )?;
    write!(f, ", criterion {}", stored.criterion.name())?;
    if let Some(limit_n) = stored.force_rms_limit_n {
        write!(f, ", force rms {}", said(limit_n, "N"))?;
    }
    let grid = &stored.grid;
    let (k, b) = (|value| spoken.bare(value, "N/m"), |value| spoken.bare(value, "N s/m"));
    write!(
        f,
        ", walk k {} step {} to {}, b {} step {} to {}, period {} samples",
        k(grid.stiffness_start_n_per_m),
        k(grid.stiffness_step_n_per_m),
        said(grid.stiffness_max_n_per_m, "N/m"),
        b(grid.damping_start_n_s_per_m),
        b(grid.damping_step_n_s_per_m),
        said(grid.damping_max_n_s_per_m, "N s/m"),
        stored.period,
    )?;
    if designs.count() == 0 {
        return Ok(());
    }
    let number = designs.number_of(&stored.settings.velocity);
    write!(f, ", design {}", designs.name_of(number).text())
}

fn faults(f: &mut fmt::Formatter<'_>, now: &Situation) -> fmt::Result {
    let status = &now.status;
    let Some(first) = status.fault else {
        return f.write_str("ok faults none");
    };
    write!(
        f,
        "ok faults {}, sample {}, position {} counts, velocity {} counts/sample, force {} %",
        first.fault,
        first.sample,
        first.position.counts(),
        Decimal(f64::from(first.velocity.bits()) / 65_536.0),
        Decimal(f64::from(first.force.bits()) / f64::from(1u32 << 30) * 100.0),
    )?;
    for (name, set) in [("all", status.causes), ("still there", status.present)] {
        write!(f, ", {name}")?;
        for fault in Fault::ALL.iter().filter(|fault| set.contains(**fault)) {
            write!(f, " {}", fault.code())?;
        }
        f.write_str(if set.is_empty() { " none" } else { "" })?;
    }
    Ok(())
}

fn refused(f: &mut fmt::Formatter<'_>, refusal: Refusal) -> fmt::Result {
    write!(f, "error: {}", refusal.text())?;
    match refusal {
        Refusal::Faulted(code) | Refusal::CausePresent(code) => write!(f, ", fault {code}"),
        _ => Ok(()),
    }
}

fn fault(f: &mut fmt::Formatter<'_>, latched: Option<Fault>) -> fmt::Result {
    match latched {
        None => f.write_str("none"),
        Some(fault) => write!(f, "{fault}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Settings, WallSettings,
        console::{Command, REPLY_MAX, Text, allowed},
        device::{
            designs::{DESIGNS_MAX, tests::NAMED},
            tests::DEVICE,
        },
        experiment::{Activity, Criterion, WalkSettings},
        safety::{
            FaultRecord, FaultSet, Inputs, State, Status,
            envelope::{Boundary, Envelope},
        },
        store::{DeviceKey, Name, Signs},
        units::{Force, Position, Velocity},
    };
    use std::vec::Vec;

    const fn key(cutoff_hz: f64, period: u32) -> Key {
        Key { estimator: EstimatorName::Butterworth, cutoff_hz, period, design: 0 }
    }
    const fn boundary(cutoff_hz: f64) -> Boundary<'static> {
        Boundary { key: key(cutoff_hz, 10), points: &[] }
    }

    const NOW: Situation = Situation {
        status: Status {
            state: State::Off,
            fault: None,
            causes: FaultSet::EMPTY,
            present: FaultSet::EMPTY,
            zeroed: true,
            unlocked: false,
            contact: false,
            inputs: Inputs {
                stop_closed: true,
                supply_good: true,
                settings_valid: true,
                halted: false,
                found: FaultSet::EMPTY,
            },
        },
        activity: Activity::None,
    };

    #[track_caller]
    fn shows(reply: Reply<'_>, text: &str) {
        assert_eq!(Text::<REPLY_MAX>::of(reply).as_str(), text);
    }

    #[test]
    fn values_come_back_with_their_unit_and_refusals_with_a_reason() {
        let mut words = [0; 16];
        let words = Envelope::put(&[boundary(1000.0), boundary(1500.0)], &mut words).unwrap();
        let device = &Device { envelope: Envelope::read(words).unwrap(), ..*DEVICE };
        shows(Reply::Value("k", 2000.0, "N/m"), "ok k 2000 N/m");
        shows(Reply::Word("stream", "on"), "ok stream on");
        shows(Reply::Done("arm"), "ok arm");
        shows(
            Reply::Version("0123456789ab-dirty", &DEVICE),
            "ok version 0.1.0, commit 0123456789ab-dirty, board a-board, scene bench 0badcafe, envelope 6f34aa47, \
             layouts record 4, settings 5, telemetry 2",
        );
        shows(
            Reply::Refused(Refusal::Faulted(Fault::LateRender)),
            "error: a fault is latched: see faults, then clear, fault 20 (late render)",
        );
        shows(
            Reply::Parse(ParseError::Missing("k N_PER_M")),
            "error: something is missing: k N_PER_M",
        );
        shows(
            Reply::Outside(
                Outside::Stiffness { lowest: 0.0, highest: 8000.0 },
                device,
                key(1000.0, 10),
            ),
            "error: beyond the envelope: k at this b is allowed from 0 to 8000, or unlock envelope",
        );
        shows(
            Reply::Outside(Outside::UnknownKey, device, key(1234.0, 10)),
            "error: no envelope for this device, estimator, cutoff and output period; known: \
             butterworth 1000 1500, or unlock envelope",
        );
        shows(
            Reply::Outside(Outside::UnknownKey, device, key(1500.0, 1)),
            "error: no envelope for this device, estimator, cutoff and output period, or unlock envelope",
        );
        let range = SettingsError { parameter: "stiffness_n_per_m", value: 2e7, range: 0.0..=1e7 };
        shows(Reply::Range(&range), "error: stiffness_n_per_m is 20000000, allowed 0 to 10000000");
    }

    #[test]
    fn help_fits_and_names_every_command() {
        let rotary = Spoken::of(&Device { radius_m: 0.1, ..*DEVICE });
        let text = Text::<REPLY_MAX>::of(ReplyIn(Reply::Help, rotary));
        assert!(!text.as_str().contains('~'), "{}", text.as_str());
        let text = Text::<REPLY_MAX>::of(Reply::Help);
        assert!(!text.as_str().contains('~'), "{}", text.as_str());
        for usage in usages() {
            assert!(text.as_str().contains(usage), "{usage}");
        }
    }

    #[test]
    fn the_longest_replies_fit_into_one_line() {
        let record = FaultRecord {
            sample: u64::MAX,
            position: Position::from_counts(i32::MIN),
            velocity: Velocity::saturating_from_bits(i32::MIN),
            force: Force::saturating_from_bits(-(1 << 30) + 1),
            ..FaultRecord::bare(Fault::PushWithoutMotion)
        };
        let every = Fault::ALL.iter().fold(FaultSet::EMPTY, |set, fault| set.with(*fault));
        let status = Status {
            state: State::Fault,
            fault: Some(record),
            causes: every,
            present: every,
            inputs: Inputs { settings_valid: false, ..NOW.status.inputs },
            ..NOW.status
        };
        let now = Situation { status, ..NOW };
        let output = Record {
            sample: u64::MAX,
            position: record.position,
            velocity: record.velocity,
            force: record.force,
            ..Record::EMPTY
        };
        let stored = Stored {
            device: DeviceKey::of("0123456789abcdef"),
            settings: Settings {
                velocity: EstimatorName::ButterworthPrewarped
                    .defaults()
                    .with_tuning(1.234_567_890_12e-5),
                wall: WallSettings {
                    position_m: -1.234_567_890_12e-5,
                    stiffness_n_per_m: 1.234_567_890_12e-5,
                    damping_n_s_per_m: 1.234_567_890_12e-5,
                    push_only: false,
                },
            },
            period: u32::MAX,
            push_n: -1.234_567_890_12e-5,
            signs: Signs { motor_reversed: true, encoder_reversed: false },
            start_m: -1.234_567_890_12e-5,
            settle_s: 1.234_567_890_12e-5,
            window_s: 1.234_567_890_12e-5,
            rms_limit_m: 1.234_567_890_12e-5,
            criterion: Criterion::Quiet,
            force_rms_limit_n: Some(1.234_567_890_12e-5),
            full_scale_n: 1.234_567_890_12e-5,
            grid: WalkSettings {
                stiffness_start_n_per_m: 1.234_567_890_12e-5,
                stiffness_step_n_per_m: 1.234_567_890_12e-5,
                stiffness_max_n_per_m: 1.234_567_890_12e-5,
                damping_start_n_s_per_m: 1.234_567_890_12e-5,
                damping_step_n_s_per_m: 1.234_567_890_12e-5,
                damping_max_n_s_per_m: 1.234_567_890_12e-5,
            },
        };
        let many: Vec<NamedFilter> = (10..10 + DESIGNS_MAX)
            .map(|n| NamedFilter {
                name: Name::new(&std::format!("0123456789abcd{n}")).unwrap(),
                ..NAMED[0]
            })
            .collect();
        let mut words = [0; 512];
        let length = Designs::put(&many, &mut words).unwrap();
        let designs = &Designs::split(many.len(), &words[..length]).unwrap().0;
        for reply in [
            Reply::Status(&now, &output),
            Reply::Faults(&now),
            Reply::Faults(&NOW),
            Reply::Settings(&stored, designs),
            Reply::Designs(designs),
            Reply::Loaded(Source::Defaults),
        ] {
            for radius_m in [0.0, 1.234_567_890_12e-3] {
                let spoken = Spoken::of(&Device { radius_m, ..*DEVICE });
                let text = Text::<REPLY_MAX>::of(ReplyIn(reply, spoken));
                assert!(!text.as_str().contains(['~', '\n', '?']), "{}", text.as_str());
                assert!(text.as_str().starts_with("ok "));
            }
        }
        shows(Reply::Faults(&NOW), "ok faults none");
    }

    #[test]
    fn a_refused_command_has_a_reply_that_says_what_helps() {
        let refusal = allowed(&Command::Walk, &NOW).unwrap_err();
        shows(Reply::Refused(refusal), "error: not armed: arm first and wait for the ramp");
    }
}
