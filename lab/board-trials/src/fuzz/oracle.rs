//! The oracle: the firmware's library without a chip ([`CoreProgram`]), which runs beside the image on the virtual
//! board. The library's tasks run when the image's tasks run. The library's tasks get the counts, bytes, reports and
//! orders that the image had then. Image and library must give the same replies, frames and outputs.

use std::{
    collections::VecDeque,
    fmt::Debug,
    mem::{replace, take},
    ops::RangeInclusive,
};

use virtual_board::{
    core_program::{CoreProgram, Memories},
    mcu::{Entry, LINK, RENDER, SAMPLE},
};
use zwidth::{
    device::Device,
    port::Exchanged,
    safety::ResetCause,
    telemetry::{Decoder, InForce, Key, Record},
    units::{Force, Position},
    velocity::EstimatorName,
};

use super::{counts::Counts, rule};

/// Number of entries in the queue of reports. It is the same as on a board.
const REPORTS: u32 = 16;

/// What the image has read and done since the last call.
pub struct Observed {
    /// The values that the image has read from the encoder's counter.
    pub counts: Vec<u32>,
    /// The starts of tasks. Each entry has three offsets that were valid then: the read offsets of commands and of
    /// reports, and the write offset of orders.
    pub entries: Vec<Entry>,
    pub replies: Vec<u8>,
    pub telemetry: Vec<u8>,
    /// Whether flash may be busy with a save.
    pub saves: bool,
}

/// The content of a telemetry frame. It has outputs and parts.
#[derive(Clone)]
struct Told {
    sequence: u32,
    outputs: Vec<(Record, Force)>,
    positions: Vec<Position>,
    /// Whether the frame may have waited for a save. During a long wait the image loses the frame's positions.
    waited: bool,
    settings: Vec<Option<InForce>>,
    port: Option<Exchanged>,
    key: Option<Key>,
}

impl Told {
    /// Describes how the image's frame differs. Three differences are allowed. The key part may be of another sample,
    /// or in another frame, because both depend on when `link` was preempted. A frame that waited for a save may lack
    /// the positions, because this depends on how long flash is busy.
    fn difference(&self, library: &Self) -> Option<String> {
        let keys = self.key.as_ref().zip(library.key.as_ref());
        let keys = keys.filter(|(key, its)| key.sample == its.sample);
        let both = [self, library];
        let mut outputs = self.outputs.iter().zip(&library.outputs);
        different(both.map(|told| told.sequence))
            .or_else(|| outputs.find_map(|(output, its)| different([output, its])))
            .or_else(|| different(both.map(|told| told.outputs.len())))
            .or_else(|| {
                let lost = self.waited && self.positions.is_empty();
                if lost { None } else { different(both.map(|told| &told.positions)) }
            })
            .or_else(|| different(<[_; 2]>::from(keys?)))
            .or_else(|| keys.and_then(|_| different(both.map(|told| (&told.settings, told.port)))))
    }
}

/// A text with both values if the image's value differs from the library's. Otherwise `None`.
fn different<T: PartialEq + Debug>([image, library]: [T; 2]) -> Option<String> {
    (image != library).then(|| format!("the image tells {image:?}, the library {library:?}"))
}

/// The lines and frames that one side has sent and that are not compared yet.
#[derive(Clone, Default)]
struct Said {
    replies: Vec<u8>,
    decoder: Decoder,
    frames: VecDeque<Told>,
    /// This many of the next frames may have waited for a save.
    waiting: usize,
}

/// Largest number of frames that can wait during a save. It includes frames that are being sent.
const WAITING: usize = 64;

impl Said {
    fn take(&mut self, replies: &[u8], telemetry: &[u8], saves: bool) {
        self.waiting = if saves { WAITING } else { self.waiting };
        self.replies.extend(replies);
        for byte in telemetry {
            let Some(newest) = self.decoder.push(*byte) else { continue };
            let (parts, mut places) = (self.decoder.parts(), [Position::default(); _]);
            let outputs = self.decoder.outputs(newest).enumerate();
            self.frames.push_back(Told {
                sequence: newest.sequence,
                outputs: outputs.map(|(n, frame)| (frame.record, parts.push(n))).collect(),
                positions: parts.positions(newest.record.position, &mut places).to_vec(),
                waited: self.waiting > 0,
                settings: parts.settings().collect(),
                port: parts.port(),
                key: parts.key(),
            });
            self.waiting = self.waiting.saturating_sub(1);
        }
    }
}

#[derive(Clone)]
pub struct Oracle {
    device: &'static Device<'static>,
    memories: Memories,
    cause: ResetCause,
    /// The library's program. `None` until the image has read its first count.
    program: Option<CoreProgram>,
    image: Said,
    library: Said,
    counts: VecDeque<u32>,
    entries: VecDeque<Entry>,
    /// The typed bytes that the image has not read yet. `words` has the three offsets of the image's last [`Entry`].
    sent: VecDeque<u8>,
    words: [u32; 3],
    /// Whether the image has put the same order into the queue as the library.
    given: bool,
    stop_open: bool,
    supply_low: bool,
}

impl Oracle {
    /// An oracle for a board at its first power-on.
    pub fn new(device: &'static Device<'static>) -> Self {
        Self {
            device,
            memories: Memories::default(),
            cause: ResetCause::Power,
            program: None,
            image: Said::default(),
            library: Said::default(),
            counts: VecDeque::new(),
            entries: VecDeque::new(),
            sent: VecDeque::new(),
            words: [0; 3],
            given: true,
            stop_open: false,
            supply_low: false,
        }
    }

    /// The library's program. `None` until the image has started.
    pub fn program(&self) -> Option<&CoreProgram> {
        self.program.as_ref()
    }

    /// Passes typed bytes to the library.
    pub fn send(&mut self, bytes: &[u8]) {
        self.sent.extend(bytes);
    }

    /// Whether all typed bytes have been read and answered.
    pub fn is_idle(&self) -> bool {
        self.sent.is_empty()
            && self.entries.is_empty()
            && self.program.as_ref().is_some_and(|program| !program.is_waiting())
    }

    /// Whether no output is running. An event now happens between two outputs.
    pub fn is_between_outputs(&self) -> bool {
        !self.entries.iter().any(|entry| entry.exception != LINK)
            && self.program.as_ref().is_none_or(|program| program.due.is_none())
    }

    /// Restarts the library, after a restart of the board.
    pub fn reset(&mut self, cause: ResetCause) {
        let Self { device, stop_open, supply_low, .. } = *self;
        let mut memories = self.program.as_mut().map_or(self.memories, CoreProgram::memories);
        if cause == ResetCause::Power {
            memories.lose_power();
        }
        *self = Self { memories, cause, stop_open, supply_low, ..Self::new(device) };
    }

    pub fn emergency_stop(&mut self, open: bool) {
        self.stop_open = open;
        self.program.iter_mut().for_each(|program| program.emergency_stop(open));
    }

    /// Lets the supply fall below the detector's level or rise above it.
    pub fn supply(&mut self, low: bool) {
        self.supply_low = low;
        self.program.iter_mut().for_each(|program| program.supply(low));
    }

    /// Runs the library as far as the image has run. The image's command channel has `size` bytes.
    ///
    /// # Errors
    /// The image has done something different from the library.
    pub fn follow(
        &mut self,
        observed: Observed,
        size: u32,
        counts: &mut Counts,
    ) -> Result<(), String> {
        self.counts.extend(observed.counts);
        self.entries.extend(observed.entries);
        self.image.take(&observed.replies, &observed.telemetry, observed.saves);
        let Some(mut program) =
            self.program.take().map_or_else(|| self.begin(), |known| Ok(Some(known)))?
        else {
            return Ok(());
        };
        let ran = self.run(&mut program, size);
        let said = program.channels();
        self.library.take(&take(&mut said.replies), &take(&mut said.telemetry), false);
        self.program = Some(program);
        ran.and_then(|()| self.compare(counts))
    }

    fn begin(&mut self) -> Result<Option<CoreProgram>, String> {
        let Some(count) = self.counts.pop_front() else { return Ok(None) };
        let mut program = CoreProgram::start(self.device, &self.memories, self.cause, count)
            .map_err(|error| error.to_string())?;
        program.emergency_stop(self.stop_open);
        program.supply(self.supply_low);
        Ok(Some(program))
    }

    /// Runs the image's tasks in the library, as far as the inputs of the tasks are known.
    fn run(&mut self, program: &mut CoreProgram, size: u32) -> Result<(), String> {
        while let Some(entry) = self.entries.front() {
            if entry.exception != LINK {
                if !self.preempt(program)? {
                    break;
                }
                continue;
            }
            let ends = |entry: &Entry| matches!(entry.exception, LINK | 0);
            let Some(inside) = self.entries.iter().skip(1).position(ends) else { break };
            let samples = self.entries.range(1..=inside).filter(|e| e.exception == SAMPLE);
            if samples.count() > self.counts.len() {
                break;
            }
            self.link(program, inside, size)?;
        }
        Ok(())
    }

    /// Takes the next entry and runs its task, unless the task is `link`. Returns false if the inputs of the task are
    /// not known yet.
    fn preempt(&mut self, program: &mut CoreProgram) -> Result<bool, String> {
        match self.entries.front().map(|entry| entry.exception) {
            Some(SAMPLE) => {
                let Some(count) = self.counts.pop_front() else { return Ok(false) };
                let was_due = program.due.is_some();
                let is_due = program.sample(count);
                rule(!(is_due && was_due), || "an output is missing".into())?;
            }
            Some(RENDER) => program.render(self.given),
            _ => {}
        }
        self.entries.pop_front();
        Ok(true)
    }

    /// Runs `link` and the tasks that preempted it. Those are the next `inside` entries.
    fn link(&mut self, program: &mut CoreProgram, inside: usize, size: u32) -> Result<(), String> {
        let Some(end) = self.entries.get(inside + 1).map(|entry| entry.words) else {
            return Ok(());
        };
        let Some(Entry { words, .. }) = self.entries.pop_front() else { return Ok(()) };
        let count = (end[0] + size - words[0]) % size;
        let count = usize::try_from(count).unwrap_or_default().min(self.sent.len());
        let mut bytes = Some(self.sent.drain(..count).collect());
        self.words = words;
        for _ in 0..inside {
            let words = self.entries.front().map_or(end, |entry| entry.words);
            self.catch_up(program, words, &mut bytes)?;
            self.preempt(program)?;
        }
        self.catch_up(program, end, &mut bytes)?;
        pass(program, &mut bytes);
        rule(self.given || program.channels().order.is_none(), || {
            "the library gives an order that the image does not".into()
        })
    }

    /// Runs `link` to the point at which the image had the offsets `words`.
    fn catch_up(
        &mut self,
        program: &mut CoreProgram,
        words: [u32; 3],
        bytes: &mut Option<Vec<u8>>,
    ) -> Result<(), String> {
        let [_, reports, orders] = replace(&mut self.words, words);
        self.given &= program.channels().order.is_some();
        for _ in 0..(words[1] + REPORTS - reports) % REPORTS {
            rule(program.report(), || "the image has an output that the library has not".into())?;
        }
        if words[2] != orders {
            if program.channels().order.is_none() {
                pass(program, bytes);
            }
            self.given = program.channels().order.is_some();
            rule(self.given, || "the image gives an order that the library does not".into())?;
        }
        Ok(())
    }

    /// Compares replies and frames of both sides.
    fn compare(&mut self, counts: &mut Counts) -> Result<(), String> {
        let Self { image, library, .. } = self;
        while let (Some(said), Some(meant)) = (line(&image.replies), line(&library.replies)) {
            let replies = [&image.replies[..said], &library.replies[..meant]]
                .map(|bytes| String::from_utf8_lossy(bytes).trim_end().to_owned());
            rule(is_same(&replies[0], &replies[1]), || {
                format!("the image says {:?}, the library {:?}", replies[0], replies[1])
            })?;
            image.replies.drain(..said);
            library.replies.drain(..meant);
            counts.replies += 1;
        }
        while let (Some(said), Some(meant)) = (image.frames.front(), library.frames.front()) {
            if let Some(what) = said.difference(meant) {
                return Err(format!("frame {}: {what}", said.sequence));
            }
            image.frames.pop_front();
            library.frames.pop_front();
            counts.frames += 1;
        }
        Ok(())
    }

    /// Compares the hardware's enable and output code with the library's. A code is 0 at zero force. No task may be
    /// running during the call.
    pub fn outputs(&mut self, code: i32, enabled: bool) -> Result<(), String> {
        let Some(program) = self.program.as_ref().filter(|_| self.entries.is_empty()) else {
            return Ok(());
        };
        let (output, active) = (program.output().unwrap_or_default(), program.is_enabled());
        // While the output is off, the value that remains in the register gives no force.
        let is_same = active == enabled && (code == output || !enabled && code == 0);
        rule(program.due.is_some() || is_same, || {
            format!(
                "the output is {code} codes from zero, enable {enabled}; the library's is {output}, enable {active}"
            )
        })
    }

    /// Checks that both sides have sent the same bytes. All typed lines must have been answered before the call.
    ///
    /// # Errors
    /// One side has sent less than the other.
    pub fn is_complete(&self) -> Result<(), String> {
        let waiting = [&self.image, &self.library]
            .map(|said| (String::from_utf8_lossy(&said.replies), said.frames.len()));
        rule(waiting.iter().all(|(replies, frames)| replies.is_empty() && *frames == 0), || {
            format!("only one of both has said {waiting:?}")
        })
    }
}

/// Ends a run of `link`, with the bytes that the image has read during it.
fn pass(program: &mut CoreProgram, bytes: &mut Option<Vec<u8>>) {
    if let Some(bytes) = bytes.take() {
        program.channels().typed.extend(&bytes);
        program.pass(!bytes.is_empty());
    }
}

/// Length of the first line with its line feed, in bytes.
fn line(bytes: &[u8]) -> Option<usize> {
    bytes.iter().position(|byte| *byte == b'\n').map(|at| at + 1)
}

/// Replies with a list that depends on the features of the build. Each entry has the beginning of the reply, and the
/// text between two items of the list.
const LISTS: [(&str, &str); 2] = [("ok help, ", ", "), ("error: unknown estimator, allowed ", " ")];
/// Numbers of the estimators that are in every build.
const EVERYWHERE: RangeInclusive<u32> = 1..=5;

/// Whether the image also has this item of the library's list. The library has all estimators and their commands.
pub fn is_in_image(item: &str) -> bool {
    let tunes = item.strip_prefix("tuning").is_some_and(|number| number >= "3");
    !tunes && item.parse::<EstimatorName>().map_or(true, |name| EVERYWHERE.contains(&name.id()))
}

/// Whether the image's line equals the library's, apart from the commit and the lists of the build.
fn is_same(said: &str, meant: &str) -> bool {
    let around = |text: &str| -> Option<[String; 3]> {
        let (before, rest) = text.split_once(", commit ")?;
        let (commit, after) = rest.split_once(", ")?;
        Some([before, commit, after].map(str::to_owned))
    };
    let is_commit = |commit: &str| {
        let hash = commit.strip_suffix("-dirty").unwrap_or(commit);
        hash == "unknown" || hash.len() == 12 && hash.bytes().all(|byte| byte.is_ascii_hexdigit())
    };
    let is_list = |(begin, between): &(&str, &str)| {
        let lists = said.strip_prefix(begin).zip(meant.strip_prefix(begin));
        lists.is_some_and(|(said, meant)| {
            said.split(between).eq(meant.split(between).filter(|item| is_in_image(item)))
        })
    };
    said == meant
        || LISTS.iter().any(is_list)
        || matches!(
            (around(said), around(meant)),
            (Some([before, commit, after]), Some([meant, _, then]))
                if before == meant && is_commit(&commit) && after == then
        )
}
