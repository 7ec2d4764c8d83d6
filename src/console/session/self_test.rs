//! `selftest`: the parts of the board one by one, each between two outputs, as `save` writes flash.

use super::{Awaited, Console};
use crate::{
    console::Port,
    experiment::Order,
    safety::Request,
    self_test::{Found, Part},
};

/// How far it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SelfTestStep {
    /// The part that is next; none before the first order is answered.
    next: Option<usize>,
    failed: u32,
}

impl SelfTestStep {
    pub(in crate::console) const BEGIN: Self = Self { next: None, failed: 0 };
}

/// What is said of a part.
struct Tested(Part, Found);

impl core::fmt::Display for Tested {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "selftest {}: {}", self.0.text(), self.1)
    }
}

impl<P: Port> Console<P> {
    /// The output task has answered: force is off, nothing may arm until it is told so, and no count is a jump. Each
    /// part asks anew, so that all tasks run between two.
    #[inline(never)] // its stack does not belong to every answer
    pub(super) fn test(&mut self, step: SelfTestStep) {
        let Some(at) = step.next else {
            return self.go_on(SelfTestStep { next: Some(0), ..step });
        };
        let Some(&part) = Part::ALL.get(at) else {
            self.order(Order::Request(Request::Stall(false)), Awaited::Quiet);
            return match step.failed {
                0 => self.write(&"ok selftest"),
                failed => self.write(&format_args!(
                    "error: selftest: {failed} of {} failed",
                    Part::ALL.len()
                )),
            };
        };
        let found = self.port.test(part);
        self.write(&Tested(part, found));
        let failed = step.failed + u32::from(!found.is_right());
        self.go_on(SelfTestStep { next: Some(at + 1), failed });
    }

    fn go_on(&mut self, step: SelfTestStep) {
        self.order(Order::Request(Request::Stall(true)), Awaited::SelfTest(step));
    }
}
