//! A board's binary telemetry, captured into a file, as rows.

use std::{collections::BTreeSet, fmt::Write as _};

use zwidth::telemetry::{Decoder, Flags, Frame, Record};

use crate::{
    error::Error,
    output::figure::{self, Figure, TelemetryPlot, TelemetryPoint},
    scene::Scene,
};

/// Facts that the figure shows, and whether they are bad news.
const FACTS: [(&str, Flags, bool); 6] = [
    ("on", Flags::ON, false),
    ("armed", Flags::ARMED, false),
    ("contact", Flags::CONTACT, false),
    ("changing", Flags::CHANGING, false),
    ("saturated", Flags::SATURATED, true),
    ("fault", Flags::FAULT, true),
];

/// All frames of a capture, and what was between them.
#[derive(Clone, Debug, PartialEq)]
pub struct Capture {
    /// The frames, in the order in which they came.
    pub frames: Vec<Frame>,
    /// Frames that are missing between them, as their sequence tells.
    pub dropped: u64,
    /// Bytes that belong to no frame.
    pub garbage_bytes: u64,
}

impl Capture {
    /// Decodes a capture that may begin and end anywhere and hold anything.
    pub fn decode(bytes: &[u8]) -> Self {
        let mut decoder = Decoder::new();
        let frames = bytes.iter().filter_map(|byte| decoder.push(*byte)).collect();
        decoder.finish();
        Self { frames, dropped: decoder.dropped, garbage_bytes: decoder.garbage }
    }

    /// Codes of the faults that were latched during the capture, rising.
    pub fn faults(&self) -> Vec<u8> {
        let codes = self.frames.iter().map(|frame| frame.record.fault);
        codes.filter(|code| *code != 0).collect::<BTreeSet<_>>().into_iter().collect()
    }

    /// The records of the longest stretch without a reset of the board, in the order of their
    /// samples: what came twice, because the black box was read out, is in it once.
    fn longest_run(&self) -> Vec<Record> {
        let live = |frame: &&Frame| !frame.record.flags.contains(Flags::REPLAY);
        let mut runs = vec![Vec::new()];
        let mut last = 0;
        for frame in &self.frames {
            // A replayed record belongs to the run that it was asked for in.
            if live(&frame) {
                if frame.record.sample < last {
                    runs.push(Vec::new());
                }
                last = frame.record.sample;
            }
            if let Some(run) = runs.last_mut() {
                run.push(frame.record);
            }
        }
        let mut longest = runs.into_iter().max_by_key(Vec::len).unwrap_or_default();
        longest.sort_by_key(|record| record.sample);
        longest.dedup_by_key(|record| record.sample);
        longest
    }

    /// Position, velocity, force and flags over time: in SI units with the scene that the board
    /// plays, else in the units of the control.
    ///
    /// # Errors
    /// There are no frames.
    pub fn figure(&self, name: &str, scene: Option<&Scene>) -> Result<Figure, Error> {
        let records = self.longest_run();
        // Records come at equal distances; what is farther apart has lost some in between.
        let usual = records.windows(2).map(|pair| pair[1].sample - pair[0].sample).min();
        let mut before = None;
        let points = records.iter().map(|record| {
            let distance = before.replace(record.sample).map(|before| record.sample - before);
            TelemetryPoint {
                after_gap: distance.zip(usual).is_some_and(|(distance, usual)| distance > usual),
                ..point(record, scene)
            }
        });
        let [time, position, velocity, force] = match scene {
            Some(_) => ["Time t [s]", "Position x [mm]", "Velocity v [m/s]", "Force F [N]"],
            None => ["Sample n", "Position [counts]", "Velocity [counts/sample]", "Force [%]"],
        };
        let plot = TelemetryPlot {
            title: format!("Telemetry, {name}"),
            subtitle: format!(
                "{} records, {} dropped, fault codes {:?}; force that acts, into the wall positive",
                records.len(),
                self.dropped,
                self.faults()
            ),
            time_title: time.to_owned(),
            titles: [position, velocity, force].map(str::to_owned),
            facts: FACTS
                .map(|(name, flag, bad)| (name.to_owned(), u32::from(flag.bits()), bad))
                .to_vec(),
            points: points.collect(),
        };
        figure::telemetry(&plot)
            .map_err(|error| Error::Internal(format!("cannot draw the telemetry: {error}")))
    }

    /// One row per frame, in the integers of the control, so that nothing is rounded: velocity in
    /// 2^-16 counts per sample, force in 2^-30 of full scale.
    pub fn csv(&self) -> String {
        let mut text = String::from(
            "sequence,sample,position_counts,velocity_q16,force_q30,command,flags,settings,fault\n",
        );
        for Frame { sequence, record } in &self.frames {
            let _ = writeln!(
                text,
                "{sequence},{},{},{},{},{},{},{},{}",
                record.sample,
                record.position.counts(),
                record.velocity.bits(),
                record.force.bits(),
                record.command.code(),
                record.flags.bits(),
                record.settings,
                record.fault
            );
        }
        text
    }
}

/// A record on the figure's axes.
fn point(record: &Record, scene: Option<&Scene>) -> TelemetryPoint {
    let counts = f64::from(record.position.counts());
    let speed = f64::from(record.velocity.bits()) / 65_536.0;
    let force = f64::from(record.force.bits()) / f64::from(1u32 << 30);
    #[expect(clippy::cast_precision_loss, reason = "2^53 samples are 28,000 years")]
    let sample = record.sample as f64;
    let (time, values) = match scene {
        None => (sample, [counts, speed, 100.0 * force]),
        Some(scene) => {
            let (resolution_m, rate_hz) = (scene.encoder.resolution_m, scene.control.rate_hz);
            let velocity_m_per_s = speed * resolution_m * rate_hz;
            let values =
                [1e3 * counts * resolution_m, velocity_m_per_s, force * scene.full_scale_n()];
            (sample / rate_hz, values)
        }
    };
    TelemetryPoint { time, values, after_gap: false, facts: u32::from(record.flags.bits()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use zwidth::units::{Force, Position, Velocity};

    fn frame(sequence: u32, fault: u8) -> Frame {
        Frame {
            sequence,
            record: Record {
                sample: 10 * u64::from(sequence),
                position: Position::from_counts(-5),
                velocity: Velocity::saturating_from_bits(1 << 15),
                force: Force::saturating_from_bits(-(1 << 29)),
                flags: Flags::CONTACT,
                settings: 2,
                fault,
                ..Record::default()
            },
        }
    }

    #[test]
    fn a_capture_with_garbage_and_a_drop_becomes_rows() {
        let mut bytes = b"garbage".to_vec();
        for (sequence, fault) in [(1, 0), (2, 20), (5, 20)] {
            bytes.extend(frame(sequence, fault).encode());
        }
        bytes.extend(&frame(6, 0).encode()[..10]);
        let capture = Capture::decode(&bytes);
        assert_eq!(capture.frames, [frame(1, 0), frame(2, 20), frame(5, 20)]);
        assert_eq!((capture.dropped, capture.garbage_bytes), (2, 17));
        assert_eq!(capture.faults(), [20]);
        let csv = capture.csv();
        let rows: Vec<&str> = csv.lines().collect();
        assert_eq!(rows.len(), 4);
        assert_eq!(rows[3], "5,50,-5,32768,-536870912,0,1,2,20");
        assert_eq!(rows[0].split(',').count(), rows[3].split(',').count());
    }

    #[test]
    fn the_figure_shows_the_longest_run_once_and_in_order() {
        let mut bytes = Vec::new();
        for (sequence, sample, replay) in [
            (0, 500, false),
            (1, 0, false),
            (2, 10, false),
            (3, 0, true),
            (4, 10, true),
            (5, 60, false),
        ] {
            let mut frame = frame(sequence, 0);
            frame.record.sample = sample;
            frame.record.flags = frame.record.flags.with_if(Flags::REPLAY, replay);
            bytes.extend(frame.encode());
        }
        let capture = Capture::decode(&bytes);
        let samples: Vec<u64> = capture.longest_run().iter().map(|record| record.sample).collect();
        assert_eq!(samples, [0, 10, 60]);
        let scene = crate::scene::NamedScene::load("paper-1um").unwrap().scene;
        for (scene, title) in [(None, "Position [counts]"), (Some(&scene), "Velocity v [m/s]")] {
            let figure = capture.figure("capture.bin", scene).unwrap();
            assert!(figure.svg().contains(title) && figure.svg().contains("saturated"));
        }
        assert!(Capture::decode(&[]).figure("none", None).is_err());
    }

    #[test]
    fn an_empty_capture_has_no_rows() {
        let capture = Capture::decode(&[]);
        assert_eq!(capture.csv().lines().count(), 1);
        assert_eq!((capture.dropped, capture.garbage_bytes), (0, 0));
    }
}
