//! Runs the firmware's library with a simulated device, without a chip. Console, supervisor, experiments and core are
//! the same code as in the release image. This code runs sample by sample with the simulator's plant. Instructions,
//! registers and flash are not simulated. So this board runs about a hundred times faster than the emulator.

use std::{collections::VecDeque, sync::Arc};

use host_sim::{
    error::Error,
    plant::{AnyPlant, AnyState, Moment, Plant as _},
    scene::NamedScene,
    simulation::{Parts, prepared::PreparedScene},
};
use zwidth::{device::Device, safety::ResetCause};

#[cfg(test)]
mod tests;

use super::{
    REPLIES, TELEMETRY,
    wires::{SLICE, Seen, Wires},
};
use crate::{
    board::Board,
    core_program::{CoreProgram, Memories},
    device,
    world::Finger,
};

/// Size of the command channel, in bytes. It is the same as on a board.
const TYPED: usize = 255;
/// Number of samples for which a hand holds the handle at the scene's position 0. The program starts in the first half,
/// and sets the count to zero in the second half.
const HELD_SAMPLES: u64 = 600;

/// The device of a scene on a board. For the board's own scene, this is the device of the board's image. The device's
/// memory is never freed.
fn device_of(scene: &NamedScene, board: Board) -> Result<&'static Device<'static>, Error> {
    let Some(record) = device::record(scene, board)? else { return Ok(device::built_in(board)) };
    Ok(Box::leak(Box::new(device::read(&record, board)?)))
}

pub struct CoreBoard {
    program: CoreProgram,
    parts: Parts<AnyPlant>,
    state: AnyState,
    rate_hz: f64,
    samples: u64,
    disabled_at: Option<u64>,
    stop_open: bool,
    /// Forces that do not act on the plant yet, in N. Each has the sample in which it begins to act. `acting_n` is the
    /// force that acts now.
    on_the_way: VecDeque<(u64, f64)>,
    acting_n: f64,
    finger: Option<Finger>,
    line: Vec<u8>,
    pub wires: Arc<Wires>,
}

impl CoreBoard {
    /// Switches the board on. The zero was set at the scene's position 0, where a hand has just released the handle.
    /// The device record is made for `board`.
    ///
    /// # Errors
    /// No record of that board fits the scene.
    pub fn start(scene: &NamedScene, board: Board) -> Result<Self, Error> {
        let device = device_of(scene, board)?;
        let parts = PreparedScene::new(&scene.scene)?.parts().clone();
        let state = parts.plant.at_rest(0.0);
        let count = parts.encoder.count(0.0).cast_unsigned();
        let program = CoreProgram::start(device, &Memories::default(), ResetCause::Power, count);
        let mut board = Self {
            program: program.map_err(Error::input)?,
            parts,
            state,
            rate_hz: scene.scene.control.rate_hz,
            samples: 0,
            disabled_at: None,
            stop_open: false,
            on_the_way: VecDeque::new(),
            acting_n: 0.0,
            finger: None,
            line: vec![],
            wires: Arc::default(),
        };
        board.zero();
        Ok(board)
    }

    /// Holds the handle at the scene's 0, sets the count to zero and releases the handle. Discards the board's output
    /// until then.
    fn zero(&mut self) {
        for n in 0..HELD_SAMPLES {
            self.sample();
            self.state = self.parts.plant.at_rest(0.0);
            if n == HELD_SAMPLES / 2 {
                self.program.channels().typed.extend(b"zero\n");
            }
        }
        self.program.channels().replies.clear();
        self.program.channels().telemetry.clear();
    }

    /// Runs the board for 1 ms. `speed` is the number of simulated seconds per real second. It is only displayed.
    pub fn millisecond(&mut self, speed: f64) {
        self.finger = self.wires.finger();
        let wanted = self.wires.is_stop_open();
        if wanted != self.stop_open {
            self.stop_open = wanted;
            self.enabling(|program| program.emergency_stop(wanted));
        }
        self.hear();
        for _ in 0..SLICE {
            self.sample();
        }
        self.wires.take(REPLIES, &mut self.program.channels().replies);
        self.wires.take(TELEMETRY, &mut self.program.channels().telemetry);
        self.look(speed);
    }

    /// Reads typed bytes. A self-test is refused, since there is no hardware to test.
    fn hear(&mut self) {
        let room = TYPED.saturating_sub(self.program.channels().typed.len());
        for byte in self.wires.typed(room) {
            if byte != b'\n' {
                self.line.push(byte);
                continue;
            }
            if self.line.trim_ascii() == b"selftest" {
                let said = b"error: selftest: the core runs here without a board\n";
                self.program.channels().replies.extend(said);
            } else {
                self.program.channels().typed.extend(&self.line);
                self.program.channels().typed.push_back(b'\n');
            }
            self.line.clear();
        }
        self.line.truncate(TYPED); // limits a line that never ends
    }

    /// Applies a change that may disable the amplifier. If the amplifier is then disabled, the force ends.
    fn enabling<T>(&mut self, what: impl FnOnce(&mut CoreProgram) -> T) -> T {
        let before = self.program.is_enabled();
        let done = what(&mut self.program);
        if !self.program.is_enabled() {
            if before {
                self.disabled_at = Some(self.samples);
            }
            self.acting_n = 0.0;
            self.on_the_way.clear();
        }
        done
    }

    /// Runs one sample. First the count is read, then an output is computed if it is due, then the plant moves.
    fn sample(&mut self) {
        let index = self.samples;
        let next_n = self.on_the_way.front().filter(|(at, _)| *at == index);
        let next_n = next_n.map_or(self.acting_n, |(_, force_n)| *force_n);
        let moment = Moment { index, before_n: self.acting_n, after_n: next_n };
        let count = self.parts.encoder.count(self.parts.plant.reading_m(&self.state, &moment));
        let reversed = self.program.is_encoder_reversed();
        let count = if reversed { count.wrapping_neg() } else { count };
        if self.enabling(|program| program.sample(count.cast_unsigned())) {
            self.enabling(|program| program.render(true));
            if let Some(part) = self.program.output_part().filter(|_| self.program.is_enabled()) {
                let at = index + u64::from(self.parts.latency);
                self.on_the_way.push_back((at, part * self.parts.full_scale_n));
            }
            while self.program.report() {}
            self.program.pass(true);
        }
        let finger_n = self.finger_n();
        let before_n = self.acting_n + finger_n;
        let arriving = self.on_the_way.front().copied().filter(|(at, _)| *at <= index);
        self.state = match arriving {
            None => self.parts.plant.advance(&self.state, before_n),
            Some((_, arriving_n)) => {
                self.on_the_way.pop_front();
                self.acting_n = arriving_n;
                self.parts.plant.advance_split(&self.state, before_n, arriving_n + finger_n)
            }
        };
        self.samples += 1;
    }

    fn finger_n(&self) -> f64 {
        let plant = &self.parts.plant;
        self.finger.map_or(0.0, |finger| {
            finger.force_n(plant.position_m(&self.state), plant.speed_m_per_s(&self.state))
        })
    }

    fn look(&self, speed: f64) {
        #[expect(clippy::cast_precision_loss, reason = "for people; exact for ages")]
        let seconds = |samples: u64| samples as f64 / self.rate_hz;
        self.wires.show(Seen {
            time_s: seconds(self.samples),
            position_m: self.parts.plant.position_m(&self.state),
            finger_n: self.finger_n(),
            enabled: self.program.is_enabled(),
            disabled_s: self.disabled_at.map(seconds),
            speed,
        });
    }
}
