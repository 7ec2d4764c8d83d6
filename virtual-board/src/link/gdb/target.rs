//! Operations that gdb may do on the board.

use std::{collections::BTreeSet, ops::Range, time::Instant};

use gdbstub::{
    common::Signal,
    outputln,
    target::{
        Target, TargetError, TargetResult,
        ext::{
            base::{
                BaseOps,
                singlethread::{
                    SingleThreadBase, SingleThreadRangeStepping, SingleThreadRangeSteppingOps,
                    SingleThreadResume, SingleThreadResumeOps, SingleThreadSingleStep,
                    SingleThreadSingleStepOps,
                },
            },
            breakpoints::{
                Breakpoints, BreakpointsOps, HwBreakpoint, HwBreakpointOps, SwBreakpoint,
                SwBreakpointOps,
            },
            monitor_cmd::{ConsoleOutput, MonitorCmd, MonitorCmdOps},
        },
    },
};
use host_sim::output::terminal::note;

use super::registers::{CortexM4, InOrder};
use crate::{
    mcu::{AfterHalt, Met, Refused, Stops},
    world::{Halted, World},
};

/// The bit in DBGMCU's register for APB1 that stops the watchdog in a halt.
const WATCHDOG_STOPS: u32 = 1 << 12;
/// Error numbers of gdb's protocol. `EFAULT` means a bad address, `EROFS` read-only memory.
const EFAULT: u8 = 14;
const EROFS: u8 = 30;
const MONITOR: &str = "monitor halt, monitor reset, monitor watchdog stop|run";

pub(super) struct Debugged<'a, 'b> {
    pub(super) world: &'a mut World<'b>,
    /// The present halt, its start in real time, and how many of its cycles were simulated so far.
    halt: Option<(Halted, Instant, u64)>,
    stops: Stops,
    /// The breakpoints that gdb calls "hardware".
    hardware: BTreeSet<u32>,
    /// Whether the watchdog stops in each halt, as in a halt by a probe's script.
    watchdog_stops: bool,
}

impl<'a, 'b> Debugged<'a, 'b> {
    /// Takes the world and halts its core.
    pub(super) fn new(world: &'a mut World<'b>) -> Self {
        let (stops, hardware) = (Stops::default(), BTreeSet::new());
        let mut target = Self { world, halt: None, stops, hardware, watchdog_stops: true };
        target.stop();
        target
    }

    pub(super) fn stop(&mut self) {
        if self.halt.is_none() {
            if self.watchdog_stops {
                self.world.powered.mcu.stop_in_halts(WATCHDOG_STOPS);
            }
            self.halt = Some((self.world.begin_halt(), Instant::now(), 0));
        }
    }

    /// Simulates the real time of the halt that has passed. Peripherals that a halt does not stop run on.
    pub(super) fn stay(&mut self) {
        let Some((_, begun, passed)) = &mut self.halt else { return };
        let per_us = u128::from(self.world.powered.mcu.core_hz() / 1_000_000);
        let cycles = u64::try_from(begun.elapsed().as_micros() * per_us).unwrap_or(u64::MAX);
        let new = cycles.saturating_sub(*passed);
        *passed += new;
        self.world.stay_halted(new);
    }

    pub(super) fn go_on(&mut self) {
        self.stay();
        if let Some((halted, ..)) = self.halt.take() {
            self.world.end_halt(&halted, AfterHalt::Kept);
        }
    }

    pub(super) fn stops(&self) -> &Stops {
        &self.stops
    }

    /// Whether the core met a hardware breakpoint.
    pub(super) fn is_hardware(&self, met: Met) -> bool {
        matches!(met, Met::Breakpoint(at) if self.hardware.contains(&at))
    }

    fn run(&mut self, step: Option<Range<u32>>) {
        self.stops.step = step;
        self.go_on();
    }
}

impl Target for Debugged<'_, '_> {
    type Arch = CortexM4;
    type Error = String;

    fn base_ops(&mut self) -> BaseOps<'_, CortexM4, String> {
        BaseOps::SingleThread(self)
    }

    fn support_breakpoints(&mut self) -> Option<BreakpointsOps<'_, Self>> {
        Some(self)
    }

    fn support_monitor_cmd(&mut self) -> Option<MonitorCmdOps<'_, Self>> {
        Some(self)
    }
}

impl SingleThreadBase for Debugged<'_, '_> {
    fn read_registers(&mut self, registers: &mut InOrder) -> TargetResult<(), Self> {
        registers.0 = self.world.powered.mcu.core_registers();
        Ok(())
    }

    fn write_registers(&mut self, registers: &InOrder) -> TargetResult<(), Self> {
        self.world.powered.mcu.set_core_registers(&registers.0);
        Ok(())
    }

    fn read_addrs(&mut self, address: u32, data: &mut [u8]) -> TargetResult<usize, Self> {
        match self.world.powered.mcu.look(address, data) {
            0 if !data.is_empty() => Err(TargetError::Errno(EFAULT)),
            count => Ok(count),
        }
    }

    fn write_addrs(&mut self, address: u32, data: &[u8]) -> TargetResult<(), Self> {
        let Some((halted, ..)) = &mut self.halt else { return Err(TargetError::NonFatal) };
        match self.world.put(halted, address, data) {
            Ok(()) => Ok(()),
            Err(Refused::Nothing) => Err(TargetError::Errno(EFAULT)),
            Err(Refused::Flash) => {
                note(&format!(
                    "gdb: {address:#010x} is flash, which cannot be written here; another image: --elf"
                ));
                Err(TargetError::Errno(EROFS))
            }
        }
    }

    fn support_resume(&mut self) -> Option<SingleThreadResumeOps<'_, Self>> {
        Some(self)
    }
}

impl SingleThreadResume for Debugged<'_, '_> {
    fn resume(&mut self, _: Option<Signal>) -> Result<(), String> {
        self.run(None);
        Ok(())
    }

    fn support_single_step(&mut self) -> Option<SingleThreadSingleStepOps<'_, Self>> {
        Some(self)
    }

    fn support_range_step(&mut self) -> Option<SingleThreadRangeSteppingOps<'_, Self>> {
        Some(self)
    }
}

impl SingleThreadSingleStep for Debugged<'_, '_> {
    fn step(&mut self, _: Option<Signal>) -> Result<(), String> {
        self.run(Some(0..0));
        Ok(())
    }
}

impl SingleThreadRangeStepping for Debugged<'_, '_> {
    fn resume_range_step(&mut self, start: u32, end: u32) -> Result<(), String> {
        self.run(Some(start..end));
        Ok(())
    }
}

impl Breakpoints for Debugged<'_, '_> {
    fn support_sw_breakpoint(&mut self) -> Option<SwBreakpointOps<'_, Self>> {
        Some(self)
    }

    fn support_hw_breakpoint(&mut self) -> Option<HwBreakpointOps<'_, Self>> {
        Some(self)
    }
}

// Both kinds of breakpoint are addresses at which the core stops. Nothing is written into flash.
impl SwBreakpoint for Debugged<'_, '_> {
    fn add_sw_breakpoint(&mut self, address: u32, _: usize) -> TargetResult<bool, Self> {
        self.stops.breakpoints.insert(address & !1);
        Ok(true)
    }

    fn remove_sw_breakpoint(&mut self, address: u32, _: usize) -> TargetResult<bool, Self> {
        Ok(self.stops.breakpoints.remove(&(address & !1)))
    }
}

impl HwBreakpoint for Debugged<'_, '_> {
    fn add_hw_breakpoint(&mut self, address: u32, kind: usize) -> TargetResult<bool, Self> {
        self.hardware.insert(address & !1);
        self.add_sw_breakpoint(address, kind)
    }

    fn remove_hw_breakpoint(&mut self, address: u32, kind: usize) -> TargetResult<bool, Self> {
        self.hardware.remove(&(address & !1));
        self.remove_sw_breakpoint(address, kind)
    }
}

impl MonitorCmd for Debugged<'_, '_> {
    fn handle_monitor_cmd(
        &mut self,
        line: &[u8],
        mut out: ConsoleOutput<'_>,
    ) -> Result<(), String> {
        let line = String::from_utf8_lossy(line);
        match line.split_whitespace().collect::<Vec<_>>()[..] {
            ["halt"] => outputln!(out, "halted"),
            ["reset"] | ["reset", "halt" | "init"] => {
                self.stay();
                self.world.reset();
                outputln!(
                    out,
                    "reset, halted at the start of the program; gdb: maintenance flush register-cache"
                );
            }
            ["watchdog", "stop"] => self.watchdog(true, &mut out),
            ["watchdog", "run"] => self.watchdog(false, &mut out),
            [] | ["help"] => outputln!(out, "{MONITOR}"),
            _ => outputln!(out, "error: monitor {line} is unknown, allowed {MONITOR}"),
        }
        Ok(())
    }
}

impl Debugged<'_, '_> {
    fn watchdog(&mut self, stops: bool, out: &mut ConsoleOutput<'_>) {
        self.watchdog_stops = stops;
        let what = if stops { "stands still" } else { "runs on, and resets the board" };
        outputln!(out, "from the next halt on the watchdog {what} in a halt");
    }
}
