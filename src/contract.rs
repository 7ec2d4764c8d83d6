//! What a board gives to the tasks: the one list of it, which `src/board` of the firmware implements once per board.
//!
//! | part | asked by | what for |
//! |---|---|---|
//! | [`Encoder`] | `sample` | the count, first of all; other senses after it |
//! | [`SampleTimer`] | `sample` | one interrupt per sample |
//! | [`ForceOutput`], [`Enable`] in a [`Drive`] | `render` | the command, and whether it acts |
//! | [`EmergencyStop`] on a pin | `render` | the switch |
//! | [`Supply`] | `render`, its own interrupt | off when the supply falls |
//! | [`DebugHalts`] | `render`, `link` | time that passed without samples, and their rate; a clock |
//! | [`SetUp`] | `render` | registers that are not as they were set up |
//! | [`ReadBack`] | `render` | voltage of the force output, current of the motor |
//! | [`FaultMemory`] | `render` | the first fault, over a reset |
//! | [`NorFlash`], [`UpChannel`], [`CommandChannel`] | `link` | settings, telemetry and replies, commands |
//! | [`OutputWatchdog`] | `render` | enable off, in hardware, when outputs stop |
//! | [`SelfTest`] | `link` | what the board finds out about itself |
//! | [`Watchdog`] | `idle` | reset when the tasks stop |
//!
//! `sample` has the highest priority (15), then `render` and the supply's interrupt (14), `link` (1), `idle` (0). What
//! `sample` and `render` ask for is inlined, takes a bounded number of cycles (no waiting, no lock, no panic), and is a
//! concrete type everywhere, so it costs what the registers cost. [`off`] works from every priority, from the
//! panic handler and the fault handlers.
//!
//! **Signs.** Into the wall is positive, everywhere in the core: the count rises into the wall, and a positive
//! [`OutputCode`] pushes into it. A board's own polarity (which channel leads, which way a motor is wound) is met by
//! [`Encoder::turn`] and `mirrored`, from the settings `encoder` and `motor`, and nowhere else; the sign test of `arm`
//! finds out whether both together are right.
//!
//! Traits of others are used where they fit: [`InputPin`] for the switch, [`NorFlash`] for the settings. They do not fit
//! elsewhere: `OutputPin` has an owner, enable is dropped by whoever comes first, and on our boards it is a timer's main
//! output, which hardware drops too; `SetDutyCycle` sets one channel, magnitude and sign have to change together;
//! embedded-hal 1.0 has no quadrature counter, converter, timer or watchdog; `embedded_io` waits for room or for data.

use embedded_hal::digital::InputPin;
use embedded_storage::nor_flash::{NorFlash, NorFlashError, NorFlashErrorKind};

use crate::{
    Output,
    period::SAMPLES_PER_MS,
    safety::{Fault, FaultRecord, FaultSet, Readings, ResetCause, Sensed},
    self_test::{Found, Part},
    units::OutputCode,
    velocity::{Sense, Senses},
};

/// Samples per second of every board, Hz.
pub const RATE_HZ: u32 = 1000 * SAMPLES_PER_MS;

/// A board: its constants and the types of its parts.
pub trait Board: Sized {
    /// Name, also the feature that selects it, its scene and `--board`.
    const NAME: &'static str;
    /// How the force output turns a force into an output code.
    const OUTPUT: Output;
    /// What an estimator can look at beside the count.
    const SENSES: &'static [Sense];
    /// From the counter's reading to the force, samples: measured, and the same in the board's scene.
    const LATENCY_SAMPLES: f64;

    /// All peripherals of the chip.
    type Device;
    /// All peripherals of the core.
    type Core;
    /// Counter of the handle's position.
    type Encoder: Encoder;
    /// Timer that begins each sample.
    type SampleTimer: SampleTimer;
    /// Force output to the amplifier.
    type Force: ForceOutput;
    /// The amplifier's enable line.
    type Enable: Enable;
    /// The emergency stop's pin.
    type StopInput: InputPin;
    /// Detector of a low supply voltage.
    type Supply: Supply;
    /// Halts by a debugger.
    type DebugHalts: DebugHalts;
    /// Enable off when outputs stop.
    type OutputWatchdog: OutputWatchdog;
    /// Registers that decide about the force.
    type SetUp: SetUp;
    /// Converters for force output and current.
    type ReadBack: ReadBack;
    /// Self-test of the board's hardware.
    type SelfTest: SelfTest;
    /// Reset when the tasks stop.
    type Watchdog: Watchdog;
    /// What a reset must not wipe out.
    type FaultMemory: FaultMemory;
    /// Two erase blocks for the settings, and nothing else in it.
    type Flash: NorFlash<Error = FlashError>;
    /// Channel of bytes towards the host.
    type Up: UpChannel;
    /// Channel of commands from the host.
    type Commands: CommandChannel;

    /// Sets the board up, with force and enable off before anything else that may take time. No timer that the control
    /// needs runs yet.
    fn take(device: Self::Device, core: Self::Core) -> Parts<Self>;

    /// Pends the interrupt of `render`; by `sample`.
    fn request_render();

    /// Pends the interrupt of `link`; by `render`.
    fn request_link();

    /// Off for good, with that fault in the memory that outlives the reset that follows; from any task. Nothing else runs
    /// any more.
    fn end(fault: Fault) -> !;

    /// Lines of the log that found no room, ever; wraps.
    fn log_dropped() -> u32;
}

/// Starts the encoder, the output's clock and, right after that, the sampling: the distance of the two sets the phase of a
/// PWM. Once, with all interrupts on.
pub fn start<E: Encoder, F: ForceOutput, T: SampleTimer>() {
    E::start();
    F::start();
    T::start();
}

/// Off: enable inactive first, then zero force. From any task and handler; a handful of stores.
#[inline(always)]
pub fn off<F: ForceOutput, E: Enable>() {
    E::off();
    F::zero();
}

/// What a board says at an output: `switched_on` if the output task has switched the amplifier on, what it `found` after
/// the last output, number of the sample and samples from output to output.
///
/// Effects are read before their causes: enable before what drops it, the note that the stop was open before its level.
/// So whatever happens between two of these reads, an effect that is seen has its cause, and no stop passes for a halt.
/// The guard's findings, the other cause, are to be read after this.
#[inline(always)]
pub fn sense<F: ForceOutput, E: Enable, P: InputPin>(
    (switched_on, found): (bool, FaultSet),
    (sample, period): (u64, u32),
    drive: &Drive<F, E>,
    stop: &mut EmergencyStop<P>,
    supply: &mut impl Supply,
    halts: &mut impl DebugHalts,
) -> Sensed {
    let enabled = drive.is_on();
    let was_stopped = drive.was_stopped();
    let stop_closed = stop.is_closed();
    let supply_good = !supply.is_low();
    let halted = halts.since_the_last(sample, period);
    Sensed { switched_on, halted, was_stopped, stop_closed, supply_good, enabled, found }
}

/// All of a board that the tasks own.
pub struct Parts<B: Board> {
    /// Counter of the handle's position.
    pub encoder: B::Encoder,
    /// Timer that begins each sample.
    pub sample_timer: B::SampleTimer,
    /// Force output and enable together.
    pub drive: Drive<B::Force, B::Enable>,
    /// Emergency stop with its pin.
    pub stop: EmergencyStop<B::StopInput>,
    /// Detector of a low supply voltage.
    pub supply: B::Supply,
    /// Halts by a debugger.
    pub halts: B::DebugHalts,
    /// Enable off when outputs stop.
    pub output_watchdog: B::OutputWatchdog,
    /// Registers that decide about the force.
    pub set_up: B::SetUp,
    /// Converters for force output and current.
    pub read_back: B::ReadBack,
    /// Self-test of the board's hardware.
    pub self_test: B::SelfTest,
    /// Reset when the tasks stop.
    pub watchdog: B::Watchdog,
    /// What a reset must not wipe out.
    pub memory: B::FaultMemory,
    /// Why the program starts.
    pub reset_cause: ResetCause,
    /// Where settings are kept.
    pub settings: B::Flash,
    /// Channels to and from the host.
    pub link: Link<B>,
}

/// The channels to and from the host.
pub struct Link<B: Board> {
    /// Frames of telemetry, in bytes.
    pub telemetry: B::Up,
    /// Replies, lines of text.
    pub replies: B::Up,
    /// Commands, lines of text.
    pub commands: B::Commands,
}

/// Counts the encoder's edges, four per line, in 32 bits that wrap. Edges closer than 0.1 us may be lost.
pub trait Encoder {
    /// Counts from now on: 0 until then. A handle that moves during the boot has not jumped by the first sample.
    fn start();

    /// The count now, in 32 bits that wrap.
    fn count(&self) -> u32;

    /// The count now, read first of all, and what else the board senses. Once per sample, by `sample`.
    fn sense(&mut self) -> (u32, Senses);

    /// Turns the direction round, or back. The count goes on from where it is. By `render`, with the force off.
    fn turn(reversed: bool);
}

/// The clock of the control: an interrupt at [`RATE_HZ`], at exactly equal distances, which stands still while a debugger
/// has the core halted.
pub trait SampleTimer {
    /// Runs from now on; the first sample comes one period later.
    fn start();

    /// More than two fifths of the present sample are over: an output of every sample has no time left but for what it
    /// must do. By `render`.
    fn is_late() -> bool;

    /// Takes the request of the present sample back; by `sample`.
    fn acknowledge(&mut self);
}

/// The force output: a command becomes a force, as a whole.
pub trait ForceOutput {
    /// Puts a command out, which the core has clamped to what [`Board::OUTPUT`] has; mirrored about zero force if the
    /// motor is mounted the other way round. Moves nothing while enable is inactive. Once per output, by `render`.
    fn write(&mut self, command: OutputCode, mirrored: bool);

    /// Zero force at once, or with the output's next period. From any task and handler.
    fn zero();

    /// Starts the output's own clock, if it has one.
    fn start();
}

/// The amplifier's enable line. Inactive in reset, when the emergency stop opens (in hardware, without any code), while a
/// debugger has the core halted, when the core's clock fails, and when outputs stop ([`OutputWatchdog`]).
pub trait Enable {
    /// Active, unless the emergency stop is open; forgets that it was.
    fn on(&mut self);

    /// Inactive, now. From any task and handler.
    fn off();

    /// Whether it is active: read back, so false as soon as hardware has dropped it.
    fn is_on(&self) -> bool;

    /// Whether the emergency stop was open at any time since [`on`](Self::on), however short.
    fn was_stopped(&self) -> bool;
}

/// The supply supervisor. It has an interrupt of `render`'s priority, so that the force is off at once.
pub trait Supply {
    /// The interrupt's handler: switches the force off and remembers that the supply was low.
    fn has_dropped();

    /// The supply is too low to write flash by, or was since this was last asked. By `render`.
    fn is_low(&mut self) -> bool;
}

/// Finds halts by a debugger: time that passed on a timer that runs on, without samples.
pub trait DebugHalts {
    /// Whether the core was halted since the last output; asked at each, with the number of its sample and the samples
    /// between two. By `render`.
    fn since_the_last(&mut self, sample: u64, period: u32) -> bool;

    /// That clock, [`HaltWatch::TICKS_PER_SAMPLE`](crate::safety::HaltWatch::TICKS_PER_SAMPLE) to a sample; it wraps. By
    /// `link`.
    fn clock() -> u16;

    /// Whether that clock and the samples have drifted apart, see [`RateWatch`](crate::safety::RateWatch). By `render`,
    /// with each output, once it is out.
    fn rate_is_wrong(&mut self) -> bool;
}

/// The registers that decide whether, when and which force acts.
pub trait SetUp {
    /// Whether the channels to and from the host are still where they were set up. A `disarm` would not be heard.
    fn channels_hold(&mut self) -> bool;

    /// Whether all of them are still as they were at the first call. By `render`, with each output, once it is out.
    fn holds(&mut self) -> bool;
    /// They are not: drives the pin of enable low by its port, whatever the timer and its pin's mode have become. Until
    /// the next reset.
    fn hold_enable_low(&mut self);
}

/// Reads the force output and the motor's current back, with A/D converters.
pub trait ReadBack {
    /// Lowest and highest code up to which the output surely follows its command; `None`: it cannot be read back.
    const SWING: Option<[i32; 2]>;

    /// Begins to read what the last output has put out. By `render`, at the beginning of each: what is written some
    /// microseconds later is not read.
    fn begin(&mut self);

    /// The converters' readings. Called by `render`, in the same output, after the force is written.
    fn finish(&mut self) -> Readings;
}

/// Enable goes inactive, by hardware alone, when no output has come for
/// [`OUTPUT_WATCHDOG_US`](crate::period::OUTPUT_WATCHDOG_US): the core may stand still,
/// be locked up, mask its interrupts or do anything else.
pub trait OutputWatchdog {
    /// An output is out. By `render`, with each, whether force is on or off: so the hardware never acts while
    /// [`Enable::on`] does. `sample` is the number of its sample, `halted` whether a debugger has had the core halted since
    /// the last one.
    fn renew(&mut self, sample: u32, halted: bool);

    /// Whether its clock and the samples have drifted apart, see [`RateWatch`](crate::safety::RateWatch).
    fn rate_is_wrong(&self) -> bool;
}

/// Tests the parts of a board that the board can test by itself.
pub trait SelfTest {
    /// Tests that part, with the force off, and leaves everything as it was. By `link`, which is kept for 15 ms at most;
    /// `render` waits for 4 ms at most. Enable is active for as long at most, at zero force.
    fn test(&mut self, part: Part) -> Found;
}

/// Reset, hence everything off, when it is not fed. It has an oscillator of its own, and nothing but a reset stops it.
pub trait Watchdog {
    /// All tasks are alive. By `idle`, at least each 20 ms; the reset comes after 30 to 100 ms.
    fn feed(&mut self);
}

/// Memory that a reset leaves as it is; a loss of power need not.
pub trait FaultMemory {
    /// What it holds: a record, zeros, or anything after power-on.
    fn read(&self) -> [u32; FaultRecord::WORDS];

    /// Writes all words of a record.
    fn write(&mut self, words: &[u32; FaultRecord::WORDS]);

    /// Writes zeros in place of a record.
    fn erase(&mut self) {
        self.write(&[0; FaultRecord::WORDS]);
    }
}

/// A channel towards the host that drops what does not fit, and never waits.
pub trait UpChannel {
    /// Writes all of `bytes`, or nothing; says which. By `link`.
    fn write(&mut self, bytes: &[u8]) -> bool;
}

/// The channel from the host.
pub trait CommandChannel {
    /// Reads what has come, up to `bytes`; says how much. By `link`.
    fn read(&mut self, bytes: &mut [u8]) -> usize;
}

/// What the flash controller did not like, as the bits of its status register; 0 if it was not asked, because place or
/// length is not allowed.
///
/// Erase and write stall the core for up to a second on some boards: `link` asks for them with the force off only, and the
/// board gives the watchdog more time meanwhile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FlashError(pub u32);

impl NorFlashError for FlashError {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

impl From<NorFlashErrorKind> for FlashError {
    fn from(_: NorFlashErrorKind) -> Self {
        Self(0)
    }
}

/// Force and enable of one amplifier.
pub struct Drive<F, E> {
    force: F,
    enable: E,
}

impl<F: ForceOutput, E: Enable> Drive<F, E> {
    /// A drive made of this force output and this enable line; both must be off.
    pub const fn new(force: F, enable: E) -> Self {
        Self { force, enable }
    }

    /// Puts a command out, see [`ForceOutput::write`].
    #[inline(always)]
    pub fn write(&mut self, command: OutputCode, mirrored: bool) {
        self.force.write(command, mirrored);
    }

    /// Enables the amplifier at zero force. The emergency stop's hardware has the last word.
    pub fn on(&mut self) {
        F::zero();
        self.enable.on();
    }

    /// Whether the amplifier is enabled; false as soon as hardware or a task has dropped it.
    #[inline(always)]
    pub fn is_on(&self) -> bool {
        self.enable.is_on()
    }

    /// Whether the emergency stop was open since the amplifier was enabled, if only for a moment.
    #[inline(always)]
    pub fn was_stopped(&self) -> bool {
        self.enable.was_stopped()
    }
}

/// Normally closed switch to ground with a pull-up: an open switch or a cut wire reads as a stop.
pub struct EmergencyStop<P>(P);

impl<P: InputPin> EmergencyStop<P> {
    /// On that pin, with its pull-up on.
    pub const fn new(pin: P) -> Self {
        Self(pin)
    }

    /// The switch is closed: no stop. A pin that cannot be read is one.
    #[inline(always)]
    pub fn is_closed(&mut self) -> bool {
        self.0.is_low().unwrap_or(false)
    }
}

#[cfg(test)]
mod tests;
