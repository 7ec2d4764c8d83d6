//! `render`: with every period-th sample, priority 14, pended by `sample`.

use core::sync::atomic::Ordering::Relaxed;

use heapless::spsc::{Consumer, Producer};
use zwidth::{Control, Drive as Rendered, Motion, units::Force};

use super::FLAGS;
use crate::board::{Drive, EmergencyStop, Supply};

/// One output, for telemetry.
#[derive(Clone, Copy, Debug)]
pub struct Record {
    /// The sample that it answers.
    pub motion: Motion,
    /// What was asked for.
    pub drive: Rendered,
    /// The amplifier is on.
    pub on: bool,
}

/// The output task. It alone writes the force output.
pub struct Render {
    drive: Drive,
    stop: EmergencyStop,
    supply: Supply,
    control: Control,
    motions: Consumer<'static, Motion>,
    controls: Producer<'static, Control>,
    proposals: Consumer<'static, Control>,
    records: Producer<'static, Record>,
}

impl Render {
    #[expect(
        clippy::too_many_arguments,
        reason = "each is owned by this task alone"
    )]
    pub(super) fn new(
        drive: Drive,
        stop: EmergencyStop,
        supply: Supply,
        control: Control,
        motions: Consumer<'static, Motion>,
        controls: Producer<'static, Control>,
        proposals: Consumer<'static, Control>,
        records: Producer<'static, Record>,
    ) -> Self {
        Self {
            drive,
            stop,
            supply,
            control,
            motions,
            controls,
            proposals,
            records,
        }
    }

    /// The output for the newest due sample. Late by a period: `sample` switches off.
    #[inline(always)]
    pub fn run(&mut self) {
        let mut due = None;
        while let Some(motion) = self.motions.dequeue() {
            if motion.due {
                due = Some(motion);
            }
        }
        let Some(motion) = due else { return };
        let drive = self.control.render(motion, Force::ZERO);
        self.drive.write(drive.command);
        FLAGS
            .answered
            .store(super::low_half(motion.sample), Relaxed);
        // A full queue drops records, never outputs.
        let on = self.drive.is_on() && self.stop.is_closed() && !self.supply.is_low();
        self.records.enqueue(Record { motion, drive, on }).ok();
        if self.controls.ready() {
            if let Some(control) = self.proposals.dequeue() {
                self.controls.enqueue(control).ok();
                self.control = control;
            }
        }
        super::pend_link();
    }
}
