//! Reads a board's binary telemetry from a file and makes rows of it.

use std::{
    collections::BTreeSet,
    fmt::Write as _,
    sync::atomic::{AtomicBool, Ordering::Relaxed},
};

use zwidth::{
    port::Exchanged,
    telemetry::{Decoder, Flags, Frame, InForce, Key, Record},
    units::{Force, Position},
};

/// The contents of one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Chunk {
    /// Sequence number of the frame in the stream.
    pub sequence: u32,
    /// Outputs of the frame. The oldest comes first.
    pub outputs: Vec<Record>,
    /// Push of the running experiment at each output.
    pub pushes: Vec<Force>,
    /// Positions of the sample before the frame, then of each sample up to the newest output. The list is empty in
    /// layout 1, and if all samples of the frame are outputs.
    pub positions: Vec<Position>,
    /// Settings that the frame reports. Settings of estimators that this build does not know are left out.
    pub settings: Vec<InForce>,
    /// State of the sampler. Only a key frame has it.
    pub key: Option<Key>,
    /// Energy between wall and hand up to the newest output. Only a key frame has it.
    pub port: Option<Exchanged>,
}

/// All frames of a capture, and the number of missing frames.
#[derive(Clone, Debug, PartialEq)]
pub struct Capture {
    /// The outputs in the order of arrival. If a frame has several outputs, each of them has its own element.
    pub frames: Vec<Frame>,
    /// The same data frame by frame, with the counts of all samples.
    pub chunks: Vec<Chunk>,
    /// Number of missing frames. It follows from gaps in the sequence numbers.
    pub dropped: u64,
    /// Number of bytes that belong to no frame.
    pub garbage_bytes: u64,
}

impl Chunk {
    /// The contents of the frame that the decoder has just found.
    fn of(decoder: &Decoder, newest: Frame) -> Self {
        let parts = decoder.parts();
        let outputs: Vec<Record> = decoder.outputs(newest).map(|frame| frame.record).collect();
        let mut places = [Position::default(); Frame::SAMPLES + 1];
        Self {
            sequence: newest.sequence,
            pushes: (0..outputs.len()).map(|n| parts.push(n)).collect(),
            positions: parts.positions(newest.record.position, &mut places).to_vec(),
            settings: parts.settings().flatten().collect(),
            key: parts.key(),
            port: parts.port(),
            outputs,
        }
    }
}

impl Capture {
    /// Decodes a capture. It may begin or end within a frame, and it may contain any other bytes.
    pub fn decode(bytes: &[u8]) -> Self {
        Self::decode_until(bytes, &AtomicBool::new(false))
    }

    /// Decodes a capture. If `stop` is set, it ends early and returns the part that was decoded.
    pub fn decode_until(bytes: &[u8], stop: &AtomicBool) -> Self {
        let mut decoder = Decoder::new();
        let (mut frames, mut chunks) = (Vec::new(), Vec::new());
        let mut bytes = bytes.iter();
        while !stop.load(Relaxed) {
            let byte = bytes.next();
            let found = match byte {
                Some(byte) => decoder.push(*byte),
                None => decoder.finish(),
            };
            let Some(frame) = found else {
                if byte.is_none() {
                    break;
                }
                continue;
            };
            frames.extend(decoder.outputs(frame));
            chunks.push(Chunk::of(&decoder, frame));
        }
        Self { frames, chunks, dropped: decoder.dropped, garbage_bytes: decoder.garbage }
    }

    /// Codes of the faults that were latched during the capture, in ascending order.
    pub fn faults(&self) -> Vec<u8> {
        let codes = self.frames.iter().map(|frame| frame.record.fault);
        codes.filter(|code| *code != 0).collect::<BTreeSet<_>>().into_iter().collect()
    }

    /// The records of the longest run without a reset of the board, in the order of their samples. If the black box was
    /// read, some records were received twice. Each of them appears once in the result.
    pub fn longest_run(&self) -> Vec<Record> {
        let live = |frame: &&Frame| !frame.record.flags.contains(Flags::REPLAY);
        let mut runs = vec![Vec::new()];
        let mut last = 0;
        for frame in &self.frames {
            // A record from the black box belongs to the run in which the black box was read.
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

    /// The outputs as CSV, one row each. The numbers are the integers of the control loop, so nothing is rounded. The
    /// velocity is in 2^-16 counts per sample, and the force in 2^-30 of full scale.
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

#[cfg(test)]
mod tests {
    use super::*;
    use zwidth::units::Velocity;

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
    fn the_longest_run_is_there_once_and_in_order() {
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
    }

    #[test]
    fn an_empty_capture_has_no_rows() {
        let capture = Capture::decode(&[]);
        assert_eq!(capture.csv().lines().count(), 1);
        assert_eq!((capture.dropped, capture.garbage_bytes), (0, 0));
    }
}
