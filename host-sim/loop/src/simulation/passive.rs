//! The passivity controller, which acts after the wall's controller. It lets the wall give no more energy than a
//! reserve. The two together do the same as the core's [`PassiveWall`], for any arithmetic.

use zwidth::{
    passivity::{PassiveWall, Passivity},
    units::{Force, Position},
    velocity::Senses,
};

use super::controller::{Controller, ControllerOutput};

/// Full scale in LSB of force.
pub(super) const FULL_SCALE: f64 = (1u32 << Force::FRACTION_BITS) as f64;

/// Converts a fraction of full scale to LSB of force. The conversion is exact for the core's forces.
pub(super) fn bits(fraction: f64) -> i64 {
    let exact = fraction * FULL_SCALE;
    #[expect(clippy::cast_possible_truncation, reason = "at most two full scales")]
    let bits = {
        let towards_zero = exact as i64; // exact for the core's forces; faster than a call of `round`
        if towards_zero as f64 == exact { towards_zero } else { exact.round() as i64 }
    };
    bits
}

/// A controller followed by the passivity controller.
#[derive(Clone, Copy, Debug)]
pub struct Passive<C> {
    controller: C,
    plan: Passivity,
    wall: PassiveWall,
    at: Position,
}

impl<C> Passive<C> {
    /// Adds the passivity controller to a controller at rest at `count`.
    pub fn new(controller: C, plan: Passivity, count: i32) -> Self {
        let at = Position::from_counts(count);
        Self { controller, plan, wall: PassiveWall::new(at), at }
    }
}

impl<C: Controller> Controller for Passive<C> {
    const IS_TOLD: bool = C::IS_TOLD;

    fn sample(&mut self, count: i32, senses: &Senses) -> bool {
        self.at = Position::from_counts(count);
        self.wall.sample(self.at);
        self.controller.sample(count, senses)
    }

    fn render(&mut self) -> ControllerOutput {
        let output = self.controller.render();
        let push = output.push;
        let wants = bits(push - output.force);
        let contact = self.at.counts() > self.surface();
        let given = self.wall.render(&self.plan, wants, contact, self.at);
        if given == wants {
            return output;
        }
        let [given, withheld] = [given, wants - given].map(|bits| bits as f64 / FULL_SCALE);
        let force = push - given;
        ControllerOutput { force, output: self.controller.put_out(force), withheld, ..output }
    }

    fn velocity(&self) -> f64 {
        self.controller.velocity()
    }

    fn surface(&self) -> i32 {
        self.controller.surface()
    }

    fn told(&mut self, speed_m_per_s: f64) {
        self.controller.told(speed_m_per_s);
    }

    fn push(&self) -> f64 {
        self.controller.push()
    }

    fn set_push(&mut self, push: f64) {
        self.controller.set_push(push);
    }

    fn put_out(&self, force: f64) -> f64 {
        self.controller.put_out(force)
    }
}
