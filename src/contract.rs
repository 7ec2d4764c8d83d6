//! The interface between board and tasks. `src/board` of the firmware implements it once per board.
//!
//! | part | asked by | what for |
//! |---|---|---|
//! | [`Encoder`] | `sample` | the count, read first of all; then other senses |
//! | [`SampleTimer`] | `sample` | one interrupt per sample |
//! | [`ForceOutput`], [`Enable`] in a [`Drive`] | `render` | the command, and whether it acts |
//! | [`EmergencyStop`] on a pin | `render` | the switch |
//! | [`Supply`] | `render`, its own interrupt | off when the supply falls |
//! | [`DebugHalts`] | `render`, `link` | time that passed without samples, and their rate; a clock |
//! | [`SetUp`] | `render` | check of the registers for changes after set-up |
//! | [`ReadBack`] | `render` | voltage of the force output, current of the motor |
//! | [`FaultMemory`] | `render` | the first fault, over a reset |
//! | [`NorFlash`], [`UpChannel`], [`CommandChannel`] | `link` | settings, telemetry and replies, commands |
//! | [`OutputWatchdog`] | `render` | enable off, in hardware, when outputs stop |
//! | [`SelfTest`] | `link` | tests of the board's hardware |
//! | [`Watchdog`] | `idle` | reset when the tasks stop |
//!
//! `sample` has the highest priority (15), then `render` and the supply's interrupt (14), `link` (1), `idle` (0).
//! Functions that `sample` and `render` call are inlined and have a concrete type, so a call takes only the time of the
//! register accesses. These functions take a bounded number of cycles: they do not wait, lock or panic. [`off`] works
//! at every priority, and in the panic and fault handlers.
//!
//! **Signs.** In the whole core the direction into the wall is positive. The count rises as the handle moves into the
//! wall, and a positive [`OutputCode`] pushes into it. A board may have another polarity: the other channel leads, or
//! the motor is wound the other way. Only [`Encoder::turn`] and the argument `mirrored` correct this. The settings
//! `encoder` and `motor` control these two. The sign test of `arm` checks that both settings together are right.
//!
//! Traits of other crates are used where they fit: [`InputPin`] for the switch, [`NorFlash`] for the settings. These
//! traits do not fit: `OutputPin` has one owner, but any task may switch enable off, and on our boards the hardware may
//! switch it off too. `SetDutyCycle` sets one channel, but magnitude and sign of a force change together. embedded-hal
//! 1.0 has no quadrature counter, converter, timer or watchdog. `embedded_io` waits for room or for data.

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

/// Samples per second of every board, in Hz.
pub const RATE_HZ: u32 = 1000 * SAMPLES_PER_MS;

/// A board: its constants and the types of its parts.
pub trait Board: Sized {
    /// Name of the board. The feature that selects it, its scene and `--board` have the same name.
    const NAME: &'static str;
    /// Kind and code range of the force output.
    const OUTPUT: Output;
    /// Senses that an estimator can use beside the count.
    const SENSES: &'static [Sense];
    /// Time from the reading of the counter to the force, in samples. The board's scene has the same number.
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
    /// Detector of halts by a debugger.
    type DebugHalts: DebugHalts;
    /// Switches enable off when outputs stop.
    type OutputWatchdog: OutputWatchdog;
    /// Registers that decide about the force.
    type SetUp: SetUp;
    /// Converters for force output and current.
    type ReadBack: ReadBack;
    /// Self-test of the board's hardware.
    type SelfTest: SelfTest;
    /// Resets the chip when the tasks stop.
    type Watchdog: Watchdog;
    /// Memory that a reset does not erase.
    type FaultMemory: FaultMemory;
    /// Flash with two erase blocks for the settings, and nothing else.
    type Flash: NorFlash<Error = FlashError>;
    /// Channel of telemetry frames towards the host.
    type Telemetry: UpChannel;
    /// Channel of replies towards the host.
    type Replies: UpChannel;
    /// Channel of commands from the host.
    type Commands: CommandChannel;

    /// Sets the board up. It first switches force and enable off, before any step that may take time. It does not start
    /// the timers of the control loop yet.
    fn take(device: Self::Device, core: Self::Core) -> Parts<Self>;

    /// Requests the interrupt of the task `render`. The task `sample` calls it.
    fn request_render();

    /// Requests the interrupt of the task `link`. The task `render` calls it.
    fn request_link();

    /// Switches off until the next reset. Writes `fault` to the memory that a reset does not erase. Any task may call
    /// this function. No task runs afterwards.
    fn end(fault: Fault) -> !;

    /// Number of log lines that were dropped since the start because there was no room. The number wraps.
    fn log_dropped() -> u32;
}

/// Starts the encoder and the output's clock, and right after that the sampling. The phase of a PWM depends on the time
/// from the start of the output's clock to the start of the sampling. Call this function once, with all interrupts on.
pub fn start<E: Encoder, F: ForceOutput, T: SampleTimer>() {
    E::start();
    F::start();
    T::start();
}

/// Switches off: first enable inactive, then zero force. This function consists of a few stores. Any task and handler
/// may call it.
#[inline(always)]
pub fn off<F: ForceOutput, E: Enable>() {
    E::off();
    F::zero();
}

/// Reads what a board reports at an output. `switched_on` says whether the task `render` has switched the amplifier on.
/// `found` has the faults that were found since the last output. `sample` is the number of the sample, and `period` the
/// number of samples from output to output.
///
/// An effect is read before its causes: enable before everything that switches enable off, the flag of an open stop
/// before the stop's level. So if an effect was read, its cause is read too, whatever happens between two reads. For
/// example, a stop is not mistaken for a halt. The guard's new findings are a cause too: read them after this call.
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

/// All parts of a board that the tasks own.
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
    /// Detector of halts by a debugger.
    pub halts: B::DebugHalts,
    /// Switches enable off when outputs stop.
    pub output_watchdog: B::OutputWatchdog,
    /// Registers that decide about the force.
    pub set_up: B::SetUp,
    /// Converters for force output and current.
    pub read_back: B::ReadBack,
    /// Self-test of the board's hardware.
    pub self_test: B::SelfTest,
    /// Resets the chip when the tasks stop.
    pub watchdog: B::Watchdog,
    /// Memory that a reset does not erase.
    pub memory: B::FaultMemory,
    /// Why the program starts.
    pub reset_cause: ResetCause,
    /// Flash for the settings.
    pub settings: B::Flash,
    /// Channels to and from the host.
    pub link: Link<B>,
}

/// The channels to and from the host.
pub struct Link<B: Board> {
    /// Channel for the telemetry frames.
    pub telemetry: B::Telemetry,
    /// Channel for the replies, as lines of text.
    pub replies: B::Replies,
    /// Channel of the commands, as lines of text.
    pub commands: B::Commands,
}

/// Counts the encoder's edges, four per line, in 32 bits that wrap. Edges closer than 0.1 us may be lost.
pub trait Encoder {
    /// Counts from now on. The count was 0 until then, so a handle that moves during boot causes no jump at the first
    /// sample.
    fn start();

    /// The count now, in 32 bits that wrap.
    fn count(&self) -> u32;

    /// Reads the count first, then the board's other senses. The task `sample` calls it once per sample.
    fn sense(&mut self) -> (u32, Senses);

    /// Reverses the direction, or restores it. The count goes on from its value. Called by `render`, with the force
    /// off.
    fn turn(reversed: bool);
}

/// The clock of the control loop. It requests an interrupt at [`RATE_HZ`], at equal intervals. It stands still while a
/// debugger has the core halted.
pub trait SampleTimer {
    /// Starts the samples. The first sample comes one period later.
    fn start();

    /// Whether more than two fifths of a sample's time have passed since its beginning. If every sample has an output,
    /// such an output then has time only for its necessary work. The task `render` calls it.
    fn is_late() -> bool;

    /// Clears the request of the present sample. Called by `sample`.
    fn acknowledge(&mut self);
}

/// The force output. It turns a complete command, magnitude and sign together, into a force.
pub trait ForceOutput {
    /// Sets the output to a command, which the core has clamped to the range of [`Board::OUTPUT`]. `mirrored` mirrors
    /// the command about zero force, if the motor is mounted the other way round. The output has no effect while enable
    /// is inactive. Called once per output, by `render`.
    fn write(&mut self, command: OutputCode, mirrored: bool);

    /// Sets zero force at once, or with the output's next period. Any task and handler may call it.
    fn zero();

    /// Starts the output's own clock, if it has one.
    fn start();
}

/// The amplifier's enable line. It is inactive:
/// * in reset;
/// * when the emergency stop opens (in hardware alone);
/// * while a debugger has the core halted;
/// * when the crystal or clock input fails;
/// * when outputs stop ([`OutputWatchdog`]).
pub trait Enable {
    /// Makes the line active, unless the emergency stop is open. Clears the flag of [`was_stopped`](Self::was_stopped).
    fn on(&mut self);

    /// Makes the line inactive at once. Any task and handler may call it.
    fn off();

    /// Whether the line is active. The level is read back, so the result is false as soon as hardware has switched the
    /// line off.
    fn is_on(&self) -> bool;

    /// Whether the emergency stop was open at any time since [`on`](Self::on), however briefly.
    fn was_stopped(&self) -> bool;
}

/// The supply supervisor. Its interrupt has the priority of `render`, so that the force is off at once.
pub trait Supply {
    /// The interrupt's handler: switches the force off and notes that the supply was low.
    fn has_dropped();

    /// Whether the supply is too low to write flash, or was too low since the last call. Called by `render`.
    fn is_low(&mut self) -> bool;
}

/// Finds halts by a debugger. A timer that keeps running during a halt shows the time that passed without samples.
pub trait DebugHalts {
    /// Whether the core was halted since the last output. `sample` is the number of this output's sample, and `period`
    /// the number of samples from output to output. The task `render` calls it at each output.
    fn since_the_last(&mut self, sample: u64, period: u32) -> bool;

    /// Count of the timer that keeps running during a halt. It has
    /// [`HaltWatch::TICKS_PER_SAMPLE`](crate::safety::HaltWatch::TICKS_PER_SAMPLE) ticks per sample, and wraps. The
    /// task `link` calls it.
    fn clock() -> u16;

    /// Whether this timer and the samples have drifted apart, see [`RateWatch`](crate::safety::RateWatch). Called by
    /// `render` after each output.
    fn rate_is_wrong(&mut self) -> bool;
}

/// Checks the registers that decide whether a force acts, when it acts and which force it is.
pub trait SetUp {
    /// Whether the channels to and from the host are still as at set-up. If they have changed, a `disarm` may not
    /// arrive. A call checks half of this, and the next call the other half.
    fn channels_hold(&mut self) -> bool;

    /// Whether all registers are still as at the first call. Called by `render` after each output.
    fn holds(&mut self) -> bool;
    /// Drives the pin of enable low until the next reset, by the registers of its port. This works whatever the timer
    /// does and whatever the pin's mode is. It is called if a register has changed.
    fn hold_enable_low(&mut self);
}

/// Reads the force output and the motor's current back, with A/D converters.
pub trait ReadBack {
    /// The lowest and the highest code. Between them the output surely follows its command. `None` if the output cannot
    /// be read back.
    const SWING: Option<[i32; 2]>;

    /// Begins to read the force output. `render` calls it at the beginning of each output, some microseconds before it
    /// writes the new code. So the reading belongs to the last output.
    fn begin(&mut self);

    /// Returns the readings that [`begin`](Self::begin) started. The task `render` calls it in the same output, after
    /// the force is written.
    fn finish(&mut self) -> Readings;
}

/// Hardware that makes enable inactive when no output has come for
/// [`OUTPUT_WATCHDOG_US`](crate::period::OUTPUT_WATCHDOG_US). This hardware also works if the core stands still, is
/// locked up or has masked its interrupts.
pub trait OutputWatchdog {
    /// Starts the time again. The task `render` calls it with each output, also with the force off, so that the
    /// hardware never acts during [`Enable::on`]. `sample` is the number of the output's sample. `halted` says whether
    /// a debugger has halted the core since the last output.
    fn renew(&mut self, sample: u32, halted: bool);

    /// Whether the watchdog's clock and the samples have drifted apart, see [`RateWatch`](crate::safety::RateWatch).
    fn rate_is_wrong(&self) -> bool;
}

/// Tests that a board can make by itself.
pub trait SelfTest {
    /// Tests this part, with the force off, and leaves everything as it was. Called by `link`. A test takes at most 15
    /// ms. `render` waits for at most 4 ms during the test. Enable is active for at most 4 ms, at zero force.
    fn test(&mut self, part: Part) -> Found;
}

/// Resets the chip if [`feed`](Self::feed) is not called in time. A reset switches everything off. The watchdog has its
/// own oscillator. Only a reset stops the watchdog.
pub trait Watchdog {
    /// Tells the watchdog that all tasks are alive. `idle` calls it at least every 20 ms. Without this call the reset
    /// comes after 30 to 100 ms.
    fn feed(&mut self);
}

/// Memory that keeps its content over a reset, but perhaps not over a loss of power.
pub trait FaultMemory {
    /// Reads the content. It is a record, or zeros, or after power-on any values.
    fn read(&self) -> [u32; FaultRecord::WORDS];

    /// Writes all words of a record.
    fn write(&mut self, words: &[u32; FaultRecord::WORDS]);

    /// Writes zeros in place of a record.
    fn erase(&mut self) {
        self.write(&[0; FaultRecord::WORDS]);
    }
}

/// A channel towards the host. It never waits, and drops what does not fit.
pub trait UpChannel {
    /// Writes all of `bytes`, or nothing. Returns whether it wrote them. The task `link` calls it.
    fn write(&mut self, bytes: &[u8]) -> bool;
}

/// The channel from the host.
pub trait CommandChannel {
    /// Takes the next byte that has come, if there is one. Called by `link`.
    fn read(&mut self) -> Option<u8>;
}

/// The error bits of the flash controller's status register. With 0 the address or the length was not allowed, and the
/// controller was not used.
///
/// Erase and write stall the core, on some boards for up to a second. `link` erases and writes only with the force off.
/// Meanwhile the board gives the watchdog more time.
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
    /// Combines this force output and this enable line. Both must be off.
    pub const fn new(force: F, enable: E) -> Self {
        Self { force, enable }
    }

    /// Writes a command to the output. See [`ForceOutput::write`].
    #[inline(always)]
    pub fn write(&mut self, command: OutputCode, mirrored: bool) {
        self.force.write(command, mirrored);
    }

    /// Enables the amplifier at zero force. The emergency stop's hardware can still prevent it.
    pub fn on(&mut self) {
        F::zero();
        self.enable.on();
    }

    /// Whether the amplifier is enabled. False as soon as hardware or a task has switched it off.
    #[inline(always)]
    pub fn is_on(&self) -> bool {
        self.enable.is_on()
    }

    /// Whether the emergency stop was open since the amplifier was enabled, even for a moment.
    #[inline(always)]
    pub fn was_stopped(&self) -> bool {
        self.enable.was_stopped()
    }
}

/// The emergency stop. It is a normally closed switch from the pin to ground, and the pin has a pull-up. An open switch
/// or a cut wire means stop.
pub struct EmergencyStop<P>(P);

impl<P: InputPin> EmergencyStop<P> {
    /// The switch on this pin. The pin's pull-up must be on.
    pub const fn new(pin: P) -> Self {
        Self(pin)
    }

    /// Whether the switch is closed. A pin that cannot be read counts as open.
    #[inline(always)]
    pub fn is_closed(&mut self) -> bool {
        self.0.is_low().unwrap_or(false)
    }
}

#[cfg(test)]
mod tests;
