//! The messages to and from a page. A server and a worker in the page use the same code.

use std::{
    sync::{Arc, Mutex, MutexGuard},
    time::Duration,
};

use host_sim::scene::NamedScene;
use serde_json::json;
use virtual_board::board::Board;
use zwidth::{device::Device, safety::Fault, telemetry::Flags, velocity::EstimatorName};

use crate::{
    hub::{Hub, lock},
    message::{FromPage, Question},
    picture::{self, Scale, View},
    predicted,
    seats::Seats,
    trigger::Watch,
};

/// Time between two calls of [`Page::tick`].
pub const TICK: Duration = Duration::from_millis(30);
/// Part of a triggered view that is before the trigger.
const BEFORE: f64 = 0.25;

pub struct Shared {
    pub hub: Arc<Hub>,
    pub scene: NamedScene,
    pub board: Board,
    /// The device whose record the board must have. `None` if the board may have any record.
    pub device: Option<Device<'static>>,
    pub scale: Scale,
    seats: Mutex<Seats>,
}

impl Shared {
    pub fn new(
        hub: Arc<Hub>,
        scene: NamedScene,
        board: Board,
        device: Option<Device<'static>>,
    ) -> Self {
        let scale = Scale::of(&scene.scene);
        Self { hub, scene, board, device, scale, seats: Mutex::default() }
    }

    /// The error text if the board has the wrong record. The board's reply to `version` may name another device record,
    /// or say that the board cannot run with its record. Otherwise `None`.
    fn other_record(&self, version: &str) -> Option<String> {
        let device = self.device.as_ref()?;
        let (scene, envelope) = (device.scene_hash, device.envelope.hash());
        let name = device.key.name.text();
        let wanted = format!("scene {name} {scene:08x}, envelope {envelope:08x}");
        if version.is_empty() || version.contains(&format!(", {wanted}, ")) {
            return None;
        }
        let (_, has) = version.split_once(", board ").unwrap_or_default();
        if let Some((_, why)) = has.split_once(", fault ") {
            return Some(format!("Nothing runs on the board, fault {why}."));
        }
        Some(format!(
            "The board has another device record than cargo live was given ({wanted}): {has}. Give the scene of its \
             record, or --device FILE."
        ))
    }

    pub fn seats(&self) -> MutexGuard<'_, Seats> {
        lock(&self.seats)
    }

    /// The rows as the text of a table, in the units of the scene.
    pub fn table(&self, from: u64, count: u64) -> String {
        picture::table(&self.hub, &self.scale, self.scene.scene.units, from, count)
    }
}

/// What a page shows, and what it has already received.
struct Looks {
    view: View,
    paused: bool,
    watch: Watch,
    /// Number of the last line that the page has received. `stops` and `ticks` are the numbers of stops and of ticks so
    /// far.
    line: u64,
    stops: u64,
    ticks: u32,
    /// The number that the page must repeat next. Every state has it; the right answer makes it the next number.
    number: u64,
}

/// The messages that a page gets next.
pub struct Tick {
    /// The values to plot. Each picture is a binary message.
    pub pictures: Vec<Vec<u8>>,
    /// State of the board as JSON.
    pub state: Option<String>,
}

pub struct Page {
    shared: Arc<Shared>,
    id: u64,
    looks: Mutex<Looks>,
}

impl Page {
    pub fn enter(shared: &Arc<Shared>) -> Self {
        let id = shared.seats().enter(shared.hub.now());
        let view = View { span_s: 5.0, columns: 800, end: None };
        let looks = Looks {
            view,
            paused: false,
            watch: Watch::default(),
            line: 0,
            stops: 0,
            ticks: 0,
            number: 0,
        };
        Self { shared: Arc::clone(shared), id, looks: Mutex::new(looks) }
    }

    pub fn leave(&self) {
        let Shared { hub, scale, .. } = &*self.shared;
        let left = self.shared.seats().leave(self.id, hub.now());
        if let Some(silent) = left {
            if silent {
                hub.note("the page with control did not answer: it has lost control");
            }
            // Without an owner, the force goes off at once. It does not wait until the board misses `alive`.
            hub.touch(None, scale.resolution_m);
            let on = hub.known().is_on();
            if on {
                hub.note("the page that commanded has gone: force off");
                hub.stop(0);
            }
        }
    }

    /// Whether the page has not answered for so long that it is treated as closed.
    pub fn is_gone(&self) -> bool {
        self.shared.seats().is_gone(self.id, self.shared.hub.now())
    }

    /// Reads a message and carries it out. If the message asks for a prediction, returns the question for the caller to
    /// answer.
    ///
    /// # Errors
    /// The message is not valid, not allowed for this page, or not possible now. The error is a text for the page.
    pub fn take(&self, message: &str) -> Result<Option<Question>, String> {
        let refused = |line: Option<String>, why: &str| {
            json!({ "type": "refused", "line": line, "why": why }).to_string()
        };
        let message = FromPage::read(message).map_err(|why| refused(None, &why))?;
        let line = match &message {
            FromPage::Command { line, .. } => Some(line.clone()),
            _ => None,
        };
        self.obey(message).map_err(|why| refused(line, why))
    }

    fn obey(&self, message: FromPage) -> Result<Option<Question>, &'static str> {
        let Shared { hub, scale, .. } = &*self.shared;
        let owns = self.shared.seats().owns(self.id);
        let needs_control = matches!(
            message,
            FromPage::Command { .. } | FromPage::Finger { .. } | FromPage::EmergencyStop { .. }
        );
        if needs_control && !owns {
            return Err("another page has control: ask for it");
        }
        match message {
            FromPage::Command { line, stopped } => hub.command(&line, stopped)?,
            FromPage::Stop { id } => hub.stop(id),
            FromPage::Finger { target_m } => hub.touch(target_m, scale.resolution_m),
            FromPage::EmergencyStop { open } => hub.emergency_stop(open),
            FromPage::Ask {} => {
                let waits = self.shared.seats().ask(self.id);
                if waits {
                    hub.note(&format!("page {} asks for control", self.id));
                }
            }
            FromPage::Give {} => {
                let given = self.shared.seats().give(self.id);
                if !given {
                    return Err("nobody asks for control");
                }
                // Under a new owner the force is off at first.
                hub.touch(None, scale.resolution_m);
                hub.stop(0);
            }
            FromPage::Alive { number } => {
                let mut looks = lock(&self.looks);
                if number == looks.number {
                    looks.number += 1;
                    self.shared.seats().hear(self.id, hub.now());
                }
            }
            FromPage::View { span_s, columns, paused } => {
                let newest = hub.history().rows()[1];
                let mut looks = lock(&self.looks);
                looks.view.span_s = span_s;
                looks.view.columns = columns;
                if paused != looks.paused {
                    looks.paused = paused;
                    looks.view.end = paused.then_some(newest);
                    looks.watch = Watch::default();
                }
            }
            FromPage::Trigger { on } => {
                let mut looks = lock(&self.looks);
                looks.watch.arm(on, &hub.history());
                looks.paused = false;
                looks.view.end = None;
            }
            FromPage::Predict(question) => return Ok(Some(question)),
        }
        Ok(None)
    }

    /// The messages for the page that have arisen since the last tick.
    pub fn tick(&self) -> Tick {
        let mut looks = lock(&self.looks);
        looks.ticks = looks.ticks.wrapping_add(1);
        let ticks = looks.ticks;
        let pictures = self.pictures(&mut looks);
        let stops = self.shared.hub.known().stops;
        let stopped = std::mem::replace(&mut looks.stops, stops) != stops;
        let state = (ticks.is_multiple_of(2) || stopped).then(|| self.state(&mut looks));
        Tick { pictures, state }
    }

    fn pictures(&self, looks: &mut Looks) -> Vec<Vec<u8>> {
        let Shared { hub, scale, .. } = &*self.shared;
        let history = hub.history();
        looks.watch.look(&history);
        if let Some(met) = looks.watch.met.filter(|_| !looks.paused) {
            let after = picture::rows_of(&history, scale, (1.0 - BEFORE) * looks.view.span_s);
            if history.rows()[1] >= met + after {
                looks.paused = true;
                looks.view.end = Some(met + after);
            }
        }
        let mut made = vec![picture::curves(&history, scale, &looks.view)];
        if looks.ticks.is_multiple_of(6) {
            made.extend(picture::spectra(&history, scale, looks.view.end));
        }
        if !looks.ticks.is_multiple_of(2) {
            made.push(picture::phase(&history, scale, looks.view.end));
        }
        made
    }

    /// The data that does not change. Values are in m and N at the handle, and the handle's distance from its axis is
    /// given too.
    pub fn hello(&self) -> String {
        let Shared { scene, board, scale, hub, .. } = &*self.shared;
        let limits = scene.scene.on_board().safety;
        let estimator = |name: &EstimatorName| {
            let tuned = name.parameters()[0];
            let tuning = tuned
                .map(|p| json!({ "name": p.name, "unit": p.unit, "frequency": p.is_frequency() }));
            json!({ "name": name.text(), "tuning": tuning })
        };
        let fault = |fault: &Fault| {
            let code = fault.code();
            json!({ "code": code, "text": fault.text(), "remedy": remedy(code) })
        };
        json!({
            "type": "hello",
            "id": self.id,
            "scene": scene.name,
            "board": board.name,
            "virtual": hub.seen().is_some(),
            "rate_hz": scale.rate_hz,
            "resolution_m": scale.resolution_m,
            "full_scale_n": scale.full_scale_n,
            "radius_m": scene.scene.units.radius_m(),
            "travel_m": [limits.travel_low_m, limits.travel_high_m],
            "wall_m": scene.scene.wall.position_m,
            "noise_speed_m_per_s": predicted::SPEED,
            "estimators": EstimatorName::ALL.iter().map(estimator).collect::<Vec<_>>(),
            "faults": Fault::ALL.iter().map(fault).collect::<Vec<_>>(),
        })
        .to_string()
    }

    /// What has changed since the last tick, as JSON.
    fn state(&self, looks: &mut Looks) -> String {
        let Shared { hub, scale, .. } = &*self.shared;
        let rows = hub.history().rows();
        let view = json!({ "end": looks.view.end, "paused": looks.paused, "met": looks.watch.met, "rows": rows });
        let (owner, asking, pages) = {
            let seats = self.shared.seats();
            (seats.owner, seats.asking, seats.pages.len())
        };
        let handle = hub.seen().map(|seen| {
            json!({
                "position_m": seen.position_m, "finger_n": seen.finger_n, "enabled": seen.enabled, "speed": seen.speed,
            })
        });
        let known = hub.known();
        let from = looks.line;
        let lines: Vec<_> = known.lines.iter().filter(|line| line.number > from).collect();
        looks.line = lines.last().map_or(from, |line| line.number);
        let record = known.record.map(|record| {
            let is = |flag: Flags| record.flags.contains(flag);
            json!({
                "sample": record.sample,
                "position_m": f64::from(record.position.counts()) * scale.lsb[0],
                "velocity_m_per_s": f64::from(record.velocity.bits()) * scale.lsb[1],
                "force_n": f64::from(record.force.bits()) * scale.lsb[2],
                "on": is(Flags::ON), "armed": is(Flags::ARMED), "contact": is(Flags::CONTACT),
                "saturated": is(Flags::SATURATED), "changing": is(Flags::CHANGING), "zeroed": is(Flags::ZEROED),
                "stop_closed": is(Flags::STOP_CLOSED), "unlocked": is(Flags::UNLOCKED), "fault": record.fault,
            })
        });
        json!({
            "type": "state",
            "number": looks.number,
            "record": record,
            "settings": known.settings,
            "settings_after": known.settings_after,
            "status": known.status,
            "version": known.version,
            "other_record": self.shared.other_record(&known.version),
            "estimators": known.estimators,
            "stops": hub.stopped(),
            "lost": known.lost,
            "counts": known.counts,
            "stopped": known.stopped,
            "lines": lines,
            "owner": owner,
            "asking": asking,
            "pages": pages,
            "view": view,
            "handle": handle,
        })
        .to_string()
    }
}

/// What to do about a fault. The text is the last column of the fault's row in docs/troubleshooting.md.
fn remedy(code: u8) -> &'static str {
    const PAGE: &str = include_str!("../../docs/troubleshooting.md");
    let is_its = |line: &&str| {
        let head = line.strip_prefix("| ").and_then(|rest| rest.split_whitespace().next());
        head.is_some_and(|head| head.parse() == Ok(code))
    };
    let line = PAGE.lines().find(is_its).unwrap_or_default();
    line.trim_end_matches([' ', '|']).rsplit('|').next().unwrap_or_default().trim()
}

#[cfg(test)]
mod tests {
    use std::collections::VecDeque;

    use virtual_board::{board::NUCLEO_F446RE, device, link::Link};

    use super::*;

    struct Nothing;

    impl Link for Nothing {
        fn read(&mut self, _: usize, _: &mut Vec<u8>) {}

        fn write(&mut self, _: usize, bytes: &[u8]) -> usize {
            bytes.len()
        }

        fn lost(&self) -> Option<String> {
            None
        }
    }

    /// Two pages of a board that sends nothing.
    fn pages() -> (Arc<Shared>, VecDeque<Page>) {
        let (hub, _) = Hub::new(Box::new(Nothing), None, None, Box::new(|| Duration::ZERO));
        let scene = NamedScene::load("nucleo-f446re").unwrap();
        let device = *device::built_in(NUCLEO_F446RE);
        let shared = Arc::new(Shared::new(hub, scene, NUCLEO_F446RE, Some(device)));
        let pages = (0..2).map(|_| Page::enter(&shared)).collect();
        (shared, pages)
    }

    #[test]
    fn a_board_with_another_record_is_told_by_its_hashes() {
        let (shared, _) = pages();
        let device = shared.device.unwrap();
        let version = |scene: u32, envelope: u32| {
            let hashes = format!("scene nucleo-f446re {scene:08x}, envelope {envelope:08x}");
            format!("ok version 1, commit 2, board nucleo-f446re, {hashes}, layouts record 4")
        };
        let (scene, envelope) = (device.scene_hash, device.envelope.hash());
        assert_eq!(shared.other_record(""), None, "it has not said");
        assert_eq!(shared.other_record(&version(scene, envelope)), None);
        for other in [version(scene ^ 1, envelope), version(scene, envelope ^ 1)] {
            let said = shared.other_record(&other).unwrap();
            assert!(said.contains("--device FILE") && said.contains(&format!("{scene:08x}")));
        }
        let none = "ok version 1, commit 2, board nucleo-f446re, no device record: it is damaged";
        assert!(shared.other_record(none).unwrap().contains("no device record: it is damaged"));
        let spoiled =
            "ok version 1, commit 2, board nucleo-f446re, fault 46 (image): it is not sealed";
        let said = "Nothing runs on the board, fault 46 (image): it is not sealed.";
        assert_eq!(shared.other_record(spoiled).as_deref(), Some(said));
    }

    #[test]
    fn a_command_that_is_refused_is_named() {
        let (shared, pages) = pages();
        let refused = |page: &Page, message: &str| {
            let told = page.take(message).err().unwrap();
            serde_json::from_str::<serde_json::Value>(&told).unwrap()
        };
        let watcher = refused(&pages[1], r#"{"type":"command","line":"k 1"}"#);
        assert_eq!(watcher["line"], "k 1");
        shared.hub.stop(0);
        let late = refused(&pages[0], r#"{"type":"command","line":"arm","stopped":0}"#);
        assert_eq!((&late["line"], &late["why"]), (&json!("arm"), &json!("a stop came first")));
        assert!(pages[0].take(r#"{"type":"command","line":"arm","stopped":1}"#).is_ok());
    }
}
