//! The command `selftest` tests the parts of the board one by one, each between two outputs. The board cannot arm
//! during the test or during `save`.

use super::{Awaited, Console};
use crate::{
    console::Port,
    device::Device,
    experiment::Order,
    safety::Request,
    self_test::{Found, Part},
};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SelfTestStep {
    /// Number of the next part, or `None` before the first order is answered.
    next: Option<usize>,
    failed: u32,
    /// Whether the test of enable has failed. If so, no further part of the test may drive the amplifier.
    unsafe_to_drive: bool,
}

impl SelfTestStep {
    pub(in crate::console) const BEGIN: Self =
        Self { next: None, failed: 0, unsafe_to_drive: false };
}

/// The line about a part: what was found, or why it was not tested.
struct Tested(Part, Result<Found, &'static str>);

impl core::fmt::Display for Tested {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "selftest {}: ", self.0.text())?;
        match &self.1 {
            Ok(found) => found.fmt(f),
            Err(why) => write!(f, "fail, not tried: {why}"),
        }
    }
}

impl<P: Port> Console<P> {
    /// Tests the next part. The task `render` has answered that the force is off, and it does not arm until the console
    /// allows it. Until then a jump of the count is no fault. The console asks `render` before each part, so that all
    /// tasks run between two parts.
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
        let latched = self.latest.is_some_and(|(now, _)| now.status.fault.is_some());
        let Device { safety, design, .. } = self.device;
        let fastest_hz = safety.speed_believable_m_per_s / design.resolution_m;
        let found = match part.drives() {
            true if latched => Err("a fault is latched, clear it first"),
            true if step.unsafe_to_drive => Err("enable failed"),
            _ => Ok(self.port.test(part).of_fastest(fastest_hz)),
        };
        let is_right = found.as_ref().is_ok_and(Found::is_right);
        self.write(&Tested(part, found));
        let failed = step.failed + u32::from(!is_right);
        let unsafe_to_drive = step.unsafe_to_drive || part == Part::Enable && !is_right;
        self.go_on(SelfTestStep { next: Some(at + 1), failed, unsafe_to_drive });
    }

    fn go_on(&mut self, step: SelfTestStep) {
        self.order(Order::Request(Request::Stall(true)), Awaited::SelfTest(step));
    }
}
