//! Finds the requested probe among the probes that are connected.

use probe_rs::probe::{
    DebugProbeInfo, DebugProbeSelector, Probe, WireProtocol,
    list::{Accessibility, Lister, ProbeListItem},
};

use super::attached::one_line;

#[cfg(test)]
mod tests;

/// How a user gets permission to open probes.
const RULES: &str = "on Linux a user needs udev rules for probes (https://probe.rs/docs/getting-started/probe-setup)";

/// Finds the requested probe. `wanted` is `VID:PID[:SERIAL]`. If it is empty, exactly one probe must be connected.
///
/// # Errors
/// There is no such probe, there are several, or this user may not open the probe. The error is one line of text.
pub fn one(lister: &Lister, wanted: &str) -> Result<DebugProbeInfo, String> {
    let selector = match wanted {
        "" => None,
        _ => Some(wanted.parse::<DebugProbeSelector>().map_err(|_| {
            format!("{wanted} is no VID:PID[:SERIAL] in hexadecimal, such as 0483:374b")
        })?),
    };
    let mut items = lister.list_with_access(selector.as_ref());
    let Some(ProbeListItem { info, accessibility }) = items.pop() else {
        let others = lister.list_all();
        return Err(match &selector {
            Some(_) if !others.is_empty() => {
                format!("no probe is {wanted}; there is {}", listed(&others))
            }
            _ => format!(
                "no debug probe found: is its cable in? {RULES}. A CMSIS-DAP probe of version 1 is not supported here"
            ),
        });
    };
    if !items.is_empty() {
        let all: Vec<_> = items.into_iter().map(|item| item.info).chain([info]).collect();
        return Err(format!("{} probes found, which one? {}", all.len(), listed(&all)));
    }
    match accessibility {
        Accessibility::Accessible => Ok(info),
        Accessibility::PermissionDenied => {
            Err(format!("{}: this user may not use it; {RULES}", name(&info)))
        }
    }
}

pub fn name(info: &DebugProbeInfo) -> String {
    format!("{} ({})", info.identifier, DebugProbeSelector::from(info))
}

fn listed(all: &[DebugProbeInfo]) -> String {
    let each = |info: &DebugProbeInfo| {
        format!("--probe={} ({})", DebugProbeSelector::from(info), info.identifier)
    };
    all.iter().map(each).collect::<Vec<_>>().join(", ")
}

/// Opens the probe for this process alone. This does not affect the board.
///
/// # Errors
/// Another program uses the probe, the probe does not support SWD at that speed, or the probe is disconnected. The
/// error is one line of text.
pub fn open(info: &DebugProbeInfo, speed_khz: Option<u32>) -> Result<Probe, String> {
    let failed = |error| format!("{}: {}", name(info), one_line(&error));
    let mut probe = info.open().map_err(|error| {
        format!("{}; it has one owner at a time: another program may have it", failed(error))
    })?;
    probe.select_protocol(WireProtocol::Swd).map_err(failed)?;
    if let Some(speed_khz) = speed_khz {
        probe
            .set_speed(speed_khz)
            .map_err(|error| format!("--speed {speed_khz}: {}", failed(error)))?;
    }
    Ok(probe)
}
