//! The way to the start of a hit or a pulse: cooling down if the motor is warm, then the return move.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use super::{AbortReason, Duty, DutyPlan, Return, ReturnPlan, ReturnStep};
use crate::units::{Force, Position};

/// An approach in progress.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Approach {
    /// None: the motor cools down.
    back: Option<Return>,
    /// Outputs spent cooling down.
    cooled: u32,
}

impl Approach {
    /// The push for this output; none: the handle stands at the start, and the motor has its reserve. `contact`: the
    /// handle is inside the wall.
    ///
    /// # Errors
    /// It does not get there.
    #[inline(always)]
    pub fn output(
        &mut self,
        (back, stands): (&ReturnPlan, &DutyPlan),
        (position, contact): (Position, bool),
        duty: &Duty,
    ) -> Result<Option<Force>, AbortReason> {
        if self.back.is_none() && !duty.is_ready(stands) {
            self.cooled = self.cooled.saturating_add(1);
            let patient = self.cooled <= stands.patience();
            return if patient { Ok(Some(Force::ZERO)) } else { Err(AbortReason::TooWarm) };
        }
        let moved = self.back.get_or_insert_with(|| Return::new(*back)).output(position, contact);
        match moved {
            ReturnStep::Push(force) => Ok(Some(force)),
            ReturnStep::TooLong => Err(AbortReason::NotBack),
            // Whatever warmed the motor on the way, what follows has its reserve.
            ReturnStep::Arrived if !duty.is_ready(stands) => {
                self.back = None;
                Ok(Some(Force::ZERO))
            }
            ReturnStep::Arrived => Ok(None),
        }
    }

    /// The motor cools down.
    #[cfg(test)]
    pub fn cools(&self) -> bool {
        self.back.is_none()
    }
}
