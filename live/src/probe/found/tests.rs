//! Tests the search with lists of simulated probes, and the attaching with the simulated probe of probe-rs.

use std::fmt;

use probe_rs::{
    integration::FakeProbe,
    probe::{DebugProbe, DebugProbeError, ProbeCreationError, ProbeFactory, list::ProbeLister},
};
use virtual_board::{
    board::BOARDS,
    elf::Elf,
    link::{Core as _, Probe as _, ProbeLink},
    rtt::Memory as _,
};

use super::*;
use crate::probe::attached::{Attached, target};

#[derive(Debug)]
struct Busy;

impl fmt::Display for Busy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a probe of the tests")
    }
}

impl ProbeFactory for Busy {
    fn open(&self, _: &DebugProbeSelector) -> Result<Box<dyn DebugProbe>, DebugProbeError> {
        Err(ProbeCreationError::CouldNotOpen.into())
    }

    fn list_probes(&self) -> Vec<ProbeListItem> {
        vec![]
    }
}

#[derive(Debug)]
struct Plugged(Vec<ProbeListItem>);

impl ProbeLister for Plugged {
    fn open(&self, _: &DebugProbeSelector) -> Result<Probe, DebugProbeError> {
        Err(ProbeCreationError::NotFound.into())
    }

    fn list_with_access(&self, selector: Option<&DebugProbeSelector>) -> Vec<ProbeListItem> {
        let meant = |item: &&ProbeListItem| selector.is_none_or(|s| s.matches_probe(&item.info));
        self.0.iter().filter(meant).cloned().collect()
    }
}

fn item(serial: &str, accessibility: Accessibility) -> ProbeListItem {
    let serial = Some(serial.to_owned());
    let info = DebugProbeInfo::new("STLink V2-1", 0x0483, 0x374b, serial, &Busy, None, false);
    ProbeListItem { info, accessibility }
}

fn plugged(serials: &[&str]) -> Lister {
    let items = serials.iter().map(|serial| item(serial, Accessibility::Accessible));
    Lister::with_lister(Box::new(Plugged(items.collect())))
}

#[test]
fn one_probe_is_it_and_of_several_one_has_to_be_named() {
    assert_eq!(one(&plugged(&["A"]), "").unwrap().serial_number.unwrap(), "A");
    let two = plugged(&["A", "B"]);
    for wanted in ["", "0483:374b"] {
        let error = one(&two, wanted).unwrap_err();
        assert!(error.starts_with("2 probes found"), "{error}");
        for selector in ["--probe=0483:374b:A (STLink V2-1)", "--probe=0483:374b:B"] {
            assert!(error.contains(selector), "{error}");
        }
    }
    assert_eq!(one(&two, "0483:374b:B").unwrap().serial_number.unwrap(), "B");
    assert_eq!(one(&two, "0483:374B:A").unwrap().serial_number.unwrap(), "A");
}

#[test]
fn none_and_another_are_told_apart() {
    let error = one(&plugged(&[]), "").unwrap_err();
    assert!(error.starts_with("no debug probe found") && error.contains("udev"), "{error}");
    let error = one(&plugged(&[]), "0483:374b").unwrap_err();
    assert!(error.starts_with("no debug probe found"), "{error}");
    let error = one(&plugged(&["A"]), "1366:0101").unwrap_err();
    assert!(error.contains("no probe is 1366:0101; there is --probe=0483:374b:A"), "{error}");
    for wanted in ["stlink", "0483", "0483:", ":", "0483:xyzw", "10483:374b"] {
        let error = one(&plugged(&["A"]), wanted).unwrap_err();
        assert!(error.starts_with(&format!("{wanted} is no VID:PID")), "{error}");
    }
}

#[test]
fn a_probe_that_may_not_be_used_or_has_an_owner_is_named() {
    let items = vec![item("A", Accessibility::PermissionDenied)];
    let error = one(&Lister::with_lister(Box::new(Plugged(items))), "").unwrap_err();
    assert!(error.starts_with("STLink V2-1 (0483:374b:A): this user may not"), "{error}");
    assert!(error.contains("udev"), "{error}");
    let info = one(&plugged(&["A"]), "").unwrap();
    let error = open(&info, None).unwrap_err();
    assert!(error.contains("0483:374b:A") && error.contains("one owner at a time"), "{error}");
}

#[test]
fn the_chips_of_all_boards_are_known() {
    for board in BOARDS {
        assert_eq!(target(board.part).unwrap().name, board.part);
    }
    for chip in ["STM32F999", "STM32F4", "nRF52840_xxAA", ""] {
        let error = target(chip).unwrap_err();
        assert!(error.starts_with(&format!("--chip is {chip}, allowed is")), "{error}");
    }
}

/// The simulated probe has a core that can be halted, and memory that reads as zero.
#[test]
fn a_core_that_is_attached_runs_and_its_memory_is_looked_into() {
    let probe = FakeProbe::with_mocked_core().into_probe();
    let mut attached = Attached::to(probe, target("STM32F446RETx").unwrap()).unwrap();
    let mut bytes = [1; 5];
    {
        let mut core = attached.core().unwrap();
        assert_eq!(core.is_halted(), Ok(false));
        core.read(0x2000_0001, &mut bytes).unwrap();
    }
    assert_eq!(bytes, [0; 5]);
    let elf = Elf {
        bytes: vec![],
        flash: vec![(0x0800_0000, vec![0; 8])],
        symbols: vec![("_SEGGER_RTT".to_owned(), 0x2000_0000, 120)],
        sections: vec![],
    };
    let error = ProbeLink::attach(attached, &elf).map(|(_, met)| met).unwrap_err();
    assert!(error.contains("no RTT control block at 0x20000000"), "{error}");
}
