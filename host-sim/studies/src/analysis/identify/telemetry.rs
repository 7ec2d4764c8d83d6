//! Makes a record from the firmware's telemetry. The telemetry is a capture, or the CSV that `telemetry --csv` writes.

use std::ops::RangeInclusive;

use zwidth::{
    Output,
    telemetry::Flags,
    units::{Force, Position},
};

use super::{
    columns::is_time,
    record::{Record, Row, Span},
};
use crate::{
    analysis::telemetry::Capture,
    input::{
        self,
        table::{FROM_0, Table},
    },
    scene::Scene,
};

/// Columns that the CSV of `telemetry` must have.
const COLUMNS: [&str; 5] = ["sample", "position_counts", "force_q30", "command", "flags"];
/// Range of a number of 32 bits.
const WORD: RangeInclusive<f64> = i32::MIN as f64..=i32::MAX as f64;

/// Converts the integers of telemetry to volts and metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutputScale {
    rate_hz: f64,
    resolution_m: f64,
    limit_v: f64,
    /// The code of zero force, and the number of codes per full scale. `None` if the force itself is converted.
    codes: Option<(f64, f64)>,
}

/// One frame of a capture, or one row of a CSV.
#[derive(Clone, Copy)]
struct Sent {
    line: usize,
    sample: f64,
    counts: f64,
    force: f64,
    command: f64,
    flags: Flags,
}

impl OutputScale {
    /// The conversion for a scene. It uses the scene's sample rate, the size of a count, and the volts of full scale.
    /// If the scene has an `[output]` table, the codes of the output are converted. Otherwise the force before the
    /// rounding to codes is converted.
    ///
    /// # Errors
    /// The scene's output is impossible. The message has one line.
    pub fn of_scene(scene: &Scene, resolution_m: f64) -> Result<Self, String> {
        let output = scene.design().output;
        let actuator =
            zwidth::actuator::Actuator::new(output).map_err(|error| error.to_string())?;
        let codes = (output != Output::Continuous).then(|| {
            (f64::from(actuator.zero().code()), f64::from(actuator.codes_per_full_scale()))
        });
        let (rate_hz, limit_v) = (scene.control.rate_hz, scene.actuator.limit_v);
        Ok(Self { rate_hz, resolution_m, limit_v, codes })
    }

    /// Whether the code agrees with the force. They may differ by the rounding of the code.
    fn fits(&self, sent: &Sent) -> bool {
        let asked = sent.force / f64::from(Force::FULL_SCALE.bits());
        self.codes
            .is_none_or(|(zero, full_scale)| (sent.command - zero - asked * full_scale).abs() < 1.0)
    }

    fn row(&self, sent: &Sent) -> Row {
        let share = match self.codes {
            Some((zero, full_scale)) => (sent.command - zero) / full_scale,
            None => sent.force / f64::from(Force::FULL_SCALE.bits()),
        };
        Row {
            line: sent.line,
            time_s: sent.sample / self.rate_hz,
            command: share * self.limit_v,
            position_m: sent.counts * self.resolution_m,
        }
    }
}

/// Reads the record in a binary capture.
///
/// # Errors
/// There are no frames, or the frames do not give a record. The message has one line.
pub fn from_capture(
    name: &str,
    bytes: &[u8],
    scale: &OutputScale,
    span: Span,
) -> Result<Record, String> {
    let capture = Capture::decode(bytes);
    if capture.frames.is_empty() {
        let no_text = input::utf8(bytes).err().map_or_else(String::new, |why| why + "; ");
        return Err(format!(
            "{no_text}no telemetry: no frame of layout 1 or 2 in {} bytes",
            bytes.len()
        ));
    }
    let frames = capture.frames.iter().enumerate();
    let sent = frames.map(|(index, frame)| {
        let record = &frame.record;
        Sent {
            line: index + 1,
            sample: record.sample as f64,
            counts: f64::from(Position::counts(record.position)),
            force: f64::from(record.force.bits()),
            command: f64::from(record.command.code()),
            flags: record.flags,
        }
    });
    record(name, sent.collect(), scale, span, "frame")
}

/// Whether a text is a CSV that `telemetry --csv` has written. Such a CSV has counts and no time.
pub(super) fn is_capture_csv(text: &str) -> bool {
    Table::new(text).is_ok_and(|table| {
        let header = table.header();
        header.iter().any(|column| column == COLUMNS[1]) && !header.iter().any(|it| is_time(it))
    })
}

/// Reads the record in a CSV that `telemetry --csv` has written.
///
/// # Errors
/// The text is no such CSV. The message has one line with the error and its place.
pub fn from_capture_csv(
    name: &str,
    text: &str,
    scale: &OutputScale,
    span: Span,
) -> Result<Record, String> {
    let mut columns = COLUMNS.map(|column| (column, WORD));
    columns[0].1 = FROM_0;
    columns[4].1 = 0.0..=f64::from(u16::MAX);
    let rows = Table::new(text)?.numbers(&columns)?;
    let sent = rows.into_iter().map(|(line, row)| {
        let mut cells = COLUMNS.iter().zip(row);
        if let Some((column, cell)) = cells.find(|(_, cell)| cell.fract() != 0.0) {
            return Err(format!("line {line}: {column} is `{cell}`, allowed whole numbers"));
        }
        let [sample, counts, force, command, flags] = row;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "16 bits")]
        let flags = Flags::from_bits(flags as u16);
        Ok(Sent { line, sample, counts, force, command, flags })
    });
    record(name, sent.collect::<Result<_, _>>()?, scale, span, "line")
}

fn record(
    name: &str,
    sent: Vec<Sent>,
    scale: &OutputScale,
    span: Span,
    place: &str,
) -> Result<Record, String> {
    let live = sent.into_iter().filter(|sent| !sent.flags.contains(Flags::REPLAY));
    let inside = span.of(live.collect(), |sent: &Sent| sent.sample / scale.rate_hz)?;
    if let Some(off) = inside.iter().find(|sent| !sent.flags.contains(Flags::ON)) {
        let time_s = off.sample / scale.rate_hz;
        let on: Vec<f64> = inside
            .chunk_by(|a, b| a.flags.contains(Flags::ON) == b.flags.contains(Flags::ON))
            .filter(|chunk| chunk[0].flags.contains(Flags::ON))
            .max_by_key(|chunk| chunk.len())
            .map(|chunk| [chunk[0], chunk[chunk.len() - 1]].map(|sent| sent.sample / scale.rate_hz))
            .into_iter()
            .flatten()
            .collect();
        let longest = match on[..] {
            [from_s, to_s] => format!("; it is on longest with --from {from_s:.4} --to {to_s:.4}"),
            _ => String::new(),
        };
        return Err(format!(
            "{place} {}: the output is off at {time_s:.4} s, where the amplifier does not hold the force at 0{longest}",
            off.line
        ));
    }
    if let Some(other) = inside.iter().find(|sent| !scale.fits(sent)) {
        return Err(format!(
            "{place} {}: command {} is not that of a force of {:.1} % by the base scene's [output]: it has to be the board's",
            other.line,
            other.command,
            100.0 * other.force / f64::from(Force::FULL_SCALE.bits())
        ));
    }
    let rows: Vec<Row> = inside.iter().map(|sent| scale.row(sent)).collect();
    Ok(Record { may_clip: false, ..Record::even(name, &rows, scale.resolution_m, place)? })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{NamedScene, Quantisation};
    use zwidth::{
        telemetry::{Frame, Record as Sample},
        units::Velocity,
    };

    fn scale(output: Option<Quantisation>) -> OutputScale {
        let mut scene = NamedScene::load("paper-1um").unwrap().scene;
        scene.output = output;
        OutputScale::of_scene(&scene, 1e-6).unwrap()
    }

    /// A capture with a frame of every tenth sample, beginning at 1 s. `change` may change each frame.
    fn capture(change: impl Fn(u32, &mut Sample)) -> Vec<u8> {
        let dac = zwidth::actuator::Actuator::new(Output::Dac { bits: 12 }).unwrap();
        let force = Force::saturating_from_bits(-(1 << 28));
        let frames = (0..200_u32).map(|sequence| {
            let mut record = Sample {
                sample: 10_000 + 10 * u64::from(sequence),
                position: Position::from_counts(sequence.cast_signed() - 50),
                velocity: Velocity::ZERO,
                force,
                command: dac.command(force),
                flags: Flags::ON,
                ..Sample::default()
            };
            change(sequence, &mut record);
            Frame { sequence, record }.encode()
        });
        frames.flatten().collect()
    }

    fn read(bytes: &[u8], span: Span) -> Result<Record, String> {
        from_capture("capture", bytes, &scale(None), span)
    }

    #[test]
    fn force_and_codes_become_volts() {
        let bytes = capture(|_, _| ());
        let record = read(&bytes, Span::default()).unwrap();
        assert_eq!((record.len(), record.start_s, record.command[3]), (200, 1.0, -2.5));
        assert!((record.step_s - 1e-3).abs() < 1e-12 && !record.may_clip);
        assert!((record.position_m[0] + 50e-6).abs() < 1e-18);
        let dac = scale(Some(Quantisation::Dac { bits: 12 }));
        let coded = from_capture("capture", &bytes, &dac, Span::default()).unwrap();
        assert!((coded.command[3] + 10.0 * 512.0 / 2047.0).abs() < 1e-12);
        let csv = Capture::decode(&bytes).csv();
        assert_eq!(from_capture_csv("capture", &csv, &dac, Span::default()).unwrap(), coded);
        for other in [Quantisation::Dac { bits: 10 }, Quantisation::Pwm { steps: 4200 }] {
            let error = from_capture("capture", &bytes, &scale(Some(other)), Span::default());
            let error = error.unwrap_err();
            assert!(
                error.contains("frame 1: command 1536 is not that of a force of -25.0 %"),
                "{error}"
            );
        }
    }

    #[test]
    fn a_replay_is_no_part_of_the_record() {
        let bytes = capture(|n, record| {
            if n < 50 {
                (record.flags, record.sample) = (Flags::REPLAY, 3);
            }
        });
        assert_eq!(read(&bytes, Span::default()).unwrap().len(), 150);
    }

    #[test]
    fn what_is_no_record_is_refused_with_the_place() {
        let off = capture(|n, record| {
            if n < 20 || n == 150 {
                record.flags = Flags::default();
            }
        });
        let error = read(&off, Span::default()).unwrap_err();
        assert!(error.contains("frame 1: the output is off at 1.0000 s"), "{error}");
        assert!(error.contains("--from 1.0200 --to 1.1490"), "{error}");
        let on = Span { from_s: Some(1.02), to_s: Some(1.149) };
        assert_eq!(read(&off, on).unwrap().len(), 130);

        let dropped: Vec<u8> = capture(|_, _| ())
            .chunks(40)
            .enumerate()
            .filter(|(n, _)| *n != 70)
            .flat_map(|(_, frame)| frame.to_vec())
            .collect();
        let error = read(&dropped, Span::default()).unwrap_err();
        assert!(
            error.contains("frame 71: the time stamps are not even: from 1.069 s to 1.071 s"),
            "{error}"
        );
        let reset = capture(|n, record| record.sample = 10 * u64::from(n % 120));
        let error = read(&reset, Span::default()).unwrap_err();
        assert!(error.contains("frame 121: time goes from"), "{error}");
        let error = read(&[0xff, 0x5a, 0x57], Span::default()).unwrap_err();
        assert!(error.contains("no frame of layout 1 or 2 in 3 bytes"), "{error}");
    }
}
