//! The interface that a controller has in the sampled loop. The core has this interface too.

use zwidth::{
    Design, Drive, LoopParameters, Motion, Sampler, Settings, SettingsError,
    encoder::Bits32,
    units::{Force, Velocity},
    velocity::Senses,
};

use super::quantiser::floor;
use crate::plant::RUN;

/// What a controller computes for an output.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControllerOutput {
    /// Commanded force after saturation, as a fraction of full scale.
    pub force: f64,
    /// Force that the actuator's code stands for, as a fraction of full scale.
    pub output: f64,
    /// Whether the demand was above the actuator's limit.
    pub saturated: bool,
    /// Part of the wall's force that the passivity controller withheld, as a fraction of full scale.
    pub withheld: f64,
    /// Push of the motor at this output, as a fraction of full scale.
    pub push: f64,
}

/// Inputs of the controller at the samples of a run.
#[derive(Clone, Copy, Debug)]
pub struct Readings<'a> {
    /// Encoder counts, one per sample.
    pub counts: &'a [i32],
    /// The inputs in addition to the counts. The list is empty if the controller needs none.
    pub senses: &'a [Senses],
    /// True speeds in m/s. Only a controller with [`IS_TOLD`](Controller::IS_TOLD) gets them.
    pub speeds_m_per_s: &'a [f64],
}

impl<'a> Readings<'a> {
    /// The count of each sample, with the other inputs of the sample.
    #[inline]
    pub fn each(&self) -> impl Iterator<Item = (i32, &'a Senses)> + use<'a> {
        let senses = self.senses;
        let sensed = move |place: usize| senses.get(place).unwrap_or(&Senses::NONE);
        self.counts.iter().enumerate().map(move |(place, count)| (*count, sensed(place)))
    }
}

/// A controller in the loop. It gets counts and gives forces.
pub trait Controller {
    /// Takes the samples of a run. Only the last sample may have an output. Stores the velocities if `velocities` is
    /// given.
    fn samples(&mut self, readings: Readings<'_>, mut velocities: Option<&mut [f64; RUN]>) {
        for (place, (count, senses)) in readings.each().enumerate() {
            self.sample(count, senses);
            if Self::IS_TOLD
                && let Some(speed_m_per_s) = readings.speeds_m_per_s.get(place)
            {
                self.told(*speed_m_per_s);
            }
            if let Some(velocity) = velocities.as_mut().and_then(|all| all.get_mut(place)) {
                *velocity = self.velocity();
            }
        }
    }
    /// Takes one sample with its other inputs. Returns `true` if an output is due with this sample.
    fn sample(&mut self, count: i32, senses: &Senses) -> bool;
    /// Computes the output that is due with the last sample.
    fn render(&mut self) -> ControllerOutput;
    /// The velocity at the last sample, in counts per sample.
    fn velocity(&self) -> f64;
    /// Position of the wall's surface, in counts. At larger counts the handle is in contact.
    fn surface(&self) -> i32;
    /// Whether the controller uses the true speed.
    const IS_TOLD: bool = false;
    /// Takes the true speed at the last sample, in m/s.
    fn told(&mut self, _speed_m_per_s: f64) {}
    /// The controller's push into the wall, as a fraction of full scale.
    fn push(&self) -> f64;
    /// Sets the push that acts from the next output on.
    fn set_push(&mut self, push: f64);
    /// The force that the output gives for the commanded `force`, after rounding. Both are fractions of full scale.
    fn put_out(&self, force: f64) -> f64;
}

/// The core with the true velocity instead of an estimate. No estimator can be better than this controller.
#[derive(Clone, Copy, Debug)]
pub struct Told {
    core: Fixed,
    lsb_per_m_per_s: f64,
}

impl Told {
    pub fn new(core: Fixed, design: &Design) -> Self {
        Self { core, lsb_per_m_per_s: lsb_per_m_per_s(design) }
    }
}

/// Factor from m/s to LSB of [`Velocity`].
pub fn lsb_per_m_per_s(design: &Design) -> f64 {
    f64::from(1u32 << Velocity::FRACTION_BITS) / (design.resolution_m * design.rate_hz)
}

impl Controller for Told {
    const IS_TOLD: bool = true;

    fn sample(&mut self, count: i32, senses: &Senses) -> bool {
        self.core.sample(count, senses)
    }

    fn told(&mut self, speed_m_per_s: f64) {
        let lsb = floor(speed_m_per_s * self.lsb_per_m_per_s + 0.5);
        self.core.set_velocity(Velocity::saturating_from_bits(lsb));
    }

    fn render(&mut self) -> ControllerOutput {
        self.core.render()
    }

    fn velocity(&self) -> f64 {
        self.core.velocity()
    }

    fn surface(&self) -> i32 {
        self.core.surface()
    }

    fn push(&self) -> f64 {
        self.core.push()
    }

    fn set_push(&mut self, push: f64) {
        self.core.set_push(push);
    }

    fn put_out(&self, force: f64) -> f64 {
        self.core.put_out(force)
    }
}

/// The fixed-point core: the code that the firmware runs.
#[derive(Clone, Copy, Debug)]
pub struct Fixed {
    control: LoopParameters,
    sampler: Sampler<Bits32>,
    motion: Motion,
    push: Force,
    per_force_bit: f64,
    zero_code: i32,
    per_code: f64,
}

impl Fixed {
    /// Makes a core with these settings and a constant push. It is at rest at `count`.
    pub fn new(
        settings: &Settings,
        design: &Design,
        push: Force,
        count: i32,
    ) -> Result<Self, SettingsError> {
        let control = settings.build(design)?;
        let sampler = Sampler::new(count.cast_unsigned(), Bits32);
        let motion = { sampler }.sample(&control, count.cast_unsigned()).motion;
        Ok(Self {
            control,
            sampler,
            motion,
            push,
            per_force_bit: 1.0 / f64::from(Force::FULL_SCALE.bits()),
            zero_code: control.actuator.zero().code(),
            per_code: 1.0 / f64::from(control.actuator.codes_per_full_scale()),
        })
    }

    /// The core's settings as integers.
    pub fn control(&self) -> &LoopParameters {
        &self.control
    }

    /// Position and velocity that the core has at the last sample.
    pub fn motion(&self) -> Motion {
        self.motion
    }

    /// Takes the samples of a run, and stores the velocity of each sample in `velocities`.
    #[inline(never)] // compiled once for all plants
    pub fn take(&mut self, readings: Readings<'_>, velocities: &mut [Velocity; RUN]) {
        let Readings { counts, senses, .. } = readings;
        if let Some(sampled) = self.sampler.sense_all(&self.control, counts, senses, velocities) {
            self.motion = sampled.motion;
        }
    }

    #[inline]
    pub fn set_velocity(&mut self, velocity: Velocity) {
        self.motion.velocity = velocity;
    }
}

#[inline]
pub fn counts_per_sample(velocity: Velocity) -> f64 {
    f64::from(velocity.bits()) / f64::from(1u32 << Velocity::FRACTION_BITS)
}

impl Controller for Fixed {
    fn samples(&mut self, readings: Readings<'_>, velocities: Option<&mut [f64; RUN]>) {
        let mut taken = [Velocity::ZERO; RUN];
        self.take(readings, &mut taken);
        if let Some(velocities) = velocities {
            *velocities = taken.map(counts_per_sample);
        }
    }

    #[inline]
    fn sample(&mut self, count: i32, senses: &Senses) -> bool {
        let sampled = self.sampler.sense(&self.control, count.cast_unsigned(), senses);
        self.motion = sampled.motion;
        sampled.due
    }

    #[inline(always)] // a call would move the state of the loop from registers to memory
    fn render(&mut self) -> ControllerOutput {
        let Drive { force, saturated, .. } = self.control.render(self.motion, self.push);
        let command = self.control.actuator.command(force);
        ControllerOutput {
            force: f64::from(force.bits()) * self.per_force_bit,
            output: f64::from(command.code() - self.zero_code) * self.per_code,
            saturated,
            withheld: 0.0,
            push: self.push(),
        }
    }

    #[inline]
    fn velocity(&self) -> f64 {
        counts_per_sample(self.motion.velocity)
    }

    fn surface(&self) -> i32 {
        self.control.wall.surface().counts()
    }

    fn push(&self) -> f64 {
        f64::from(self.push.bits()) * self.per_force_bit
    }

    fn set_push(&mut self, push: f64) {
        self.push = Force::saturating_from_bits(floor(push / self.per_force_bit + 0.5));
    }

    fn put_out(&self, force: f64) -> f64 {
        let bits = floor(force / self.per_force_bit + 0.5);
        let command = self.control.actuator.command(Force::saturating_from_bits(bits));
        f64::from(command.code() - self.zero_code) * self.per_code
    }
}
