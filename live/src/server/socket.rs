//! One page: what it says is read at once, whatever it has still to be told.

use std::{
    sync::{Arc, Mutex, MutexGuard},
    time::{Duration, Instant},
};

use axum::extract::ws::{Message, WebSocket};
use futures_util::{
    SinkExt as _, StreamExt as _,
    stream::{SplitSink, SplitStream},
};
use live::{access::MESSAGES_PER_S, message::FromPage, predicted, seats::Asked, trigger::Watch};
use serde_json::json;
use tokio::{
    sync::mpsc,
    time::{MissedTickBehavior, interval},
};
use zwidth::{safety::Fault, telemetry::Flags, velocity::EstimatorName};

use super::{
    App, Place, lock,
    picture::{self, View},
};

/// Between two pictures.
const TICK: Duration = Duration::from_millis(33);
/// Part of a triggered view that lies before the trigger.
const BEFORE: f64 = 0.25;

/// What a page looks at.
struct Looks {
    view: View,
    paused: bool,
    watch: Watch,
}

struct Page {
    app: Arc<App>,
    id: u64,
    looks: Mutex<Looks>,
}

impl Page {
    fn looks(&self) -> MutexGuard<'_, Looks> {
        lock(&self.looks)
    }
}

/// Talks to a page until it goes.
pub async fn run(app: Arc<App>, socket: WebSocket, _place: Place) {
    let id = app.seats().enter(Instant::now());
    let view = View { span_s: 5.0, columns: 800, end: None };
    let looks = Mutex::new(Looks { view, paused: false, watch: Watch::default() });
    let page = Arc::new(Page { app: Arc::clone(&app), id, looks });
    let (to, from) = socket.split();
    let (tell, told) = mpsc::channel(16);
    tokio::select! {
        () = read(&page, from, tell) => {}
        () = write(&page, to, told) => {}
    }
    let owned = app.seats().leave(id);
    if owned {
        // Nobody is there who may command: at once, not only when the promise is broken.
        app.hub.touch(None, app.scale.resolution_m);
        let on = app.hub.known().is_on();
        if on {
            app.hub.note("the page that commanded has gone: force off");
            app.hub.stop(0);
        }
    }
}

async fn read(page: &Arc<Page>, mut from: SplitStream<WebSocket>, tell: mpsc::Sender<String>) {
    let (mut second, mut messages) = (Instant::now(), 0);
    while let Some(Ok(message)) = from.next().await {
        let now = Instant::now();
        if now - second > Duration::from_secs(1) {
            (second, messages) = (now, 0);
        }
        messages += 1;
        if messages > MESSAGES_PER_S {
            return;
        }
        let text = match message {
            Message::Text(text) => text,
            Message::Pong(_) => {
                page.app.seats().hear(page.id, now);
                continue;
            }
            Message::Ping(_) => continue,
            Message::Binary(_) | Message::Close(_) => return,
        };
        let obeyed = FromPage::read(&text)
            .and_then(|message| obey(page, message, &tell).map_err(str::to_owned));
        if let Err(why) = obeyed {
            let _ = tell.try_send(json!({ "type": "refused", "why": why }).to_string());
        }
    }
}

fn obey(
    page: &Arc<Page>,
    message: FromPage,
    tell: &mpsc::Sender<String>,
) -> Result<(), &'static str> {
    let app = &page.app;
    let now = Instant::now();
    let owns = app.seats().owns(page.id);
    let needs_control = matches!(
        message,
        FromPage::Command { .. } | FromPage::Finger { .. } | FromPage::EmergencyStop { .. }
    );
    if needs_control && !owns {
        return Err("another page has control: ask for it");
    }
    match message {
        FromPage::Command { line } if app.hub.command(&line) => {}
        FromPage::Command { .. } => return Err("too many commands wait"),
        FromPage::Stop { id } => app.hub.stop(id),
        FromPage::Finger { target_m } => app.hub.touch(target_m, app.scale.resolution_m),
        FromPage::EmergencyStop { open } => app.hub.emergency_stop(open),
        FromPage::Ask => {
            let asked = app.seats().ask(page.id, now);
            if asked == Asked::Waiting {
                app.hub.note(&format!("page {} asks for control", page.id));
            }
        }
        FromPage::Give => {
            let given = app.seats().give(page.id, now);
            if !given {
                return Err("nobody asks for control");
            }
            // Who takes over begins with the force off.
            app.hub.touch(None, app.scale.resolution_m);
            app.hub.stop(0);
        }
        FromPage::View { span_s, columns, paused } => {
            let newest = app.hub.history().rows()[1];
            let mut looks = page.looks();
            looks.view.span_s = span_s;
            looks.view.columns = columns;
            if paused != looks.paused {
                looks.paused = paused;
                looks.view.end = paused.then_some(newest);
                looks.watch = Watch::default();
            }
        }
        FromPage::Trigger(trigger) => {
            let history = app.hub.history();
            let mut looks = page.looks();
            looks.watch.arm(trigger, &history);
            looks.paused = false;
            looks.view.end = None;
        }
        FromPage::Predict { estimator, cutoff_hz } => {
            let (page, tell) = (Arc::clone(page), tell.clone());
            tokio::spawn(async move {
                if let Some(predicted) = page.app.predict(estimator, cutoff_hz).await {
                    let message = json!({ "type": "predicted", "predicted": &*predicted });
                    let _ = tell.send(message.to_string()).await;
                }
            });
        }
    }
    Ok(())
}

type To = SplitSink<WebSocket, Message>;

async fn write(page: &Page, mut to: To, mut told: mpsc::Receiver<String>) {
    let mut tick = interval(TICK);
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    if to.send(Message::Text(hello(page).into())).await.is_err() {
        return;
    }
    let (mut ticks, mut seen) = (0u32, Seen::default());
    loop {
        let next = tokio::select! {
            _ = tick.tick() => None,
            text = told.recv() => match text {
                Some(text) => Some(text),
                None => return,
            },
        };
        let sent = match next {
            Some(text) => to.send(Message::Text(text.into())).await,
            None => {
                ticks = ticks.wrapping_add(1);
                show(page, &mut to, ticks, &mut seen).await
            }
        };
        if sent.is_err() {
            return;
        }
    }
}

/// What the page was told.
#[derive(Default)]
struct Seen {
    line: u64,
    stops: u64,
}

async fn show(page: &Page, to: &mut To, ticks: u32, seen: &mut Seen) -> Result<(), axum::Error> {
    for bytes in pictures(page, ticks) {
        to.feed(Message::Binary(bytes.into())).await?;
    }
    let stops = page.app.hub.known().stops;
    let stopped = std::mem::replace(&mut seen.stops, stops) != stops;
    if ticks.is_multiple_of(2) || stopped {
        to.feed(Message::Text(state(page, seen).into())).await?;
    }
    if ticks.is_multiple_of(3) {
        to.feed(Message::Ping(Vec::new().into())).await?;
    }
    to.flush().await
}

fn pictures(page: &Page, ticks: u32) -> Vec<Vec<u8>> {
    let App { hub, scale, .. } = &*page.app;
    let history = hub.history();
    let mut looks = page.looks();
    looks.watch.look(&history);
    if let Some(met) = looks.watch.met.filter(|_| !looks.paused) {
        let after = picture::rows_of(&history, scale, (1.0 - BEFORE) * looks.view.span_s);
        if history.rows()[1] >= met + after {
            looks.paused = true;
            looks.view.end = Some(met + after);
        }
    }
    let mut made = vec![picture::curves(&history, scale, &looks.view)];
    if ticks.is_multiple_of(6) {
        made.extend(picture::spectra(&history, scale, looks.view.end));
    }
    if !ticks.is_multiple_of(2) {
        made.push(picture::phase(&history, scale, looks.view.end));
    }
    made
}

/// What does not change: m and N at the handle, and where its axis is.
fn hello(page: &Page) -> String {
    let App { scene, board, scale, hub, .. } = &*page.app;
    let limits = scene.scene.on_board().safety;
    let estimator = |name: &EstimatorName| {
        let tuned = name.parameters()[0];
        let tuning =
            tuned.map(|p| json!({ "name": p.name, "unit": p.unit, "frequency": p.is_frequency() }));
        json!({ "name": name.text(), "tuning": tuning })
    };
    let fault = |fault: &Fault| {
        let code = fault.code();
        json!({ "code": code, "text": fault.text(), "remedy": remedy(code) })
    };
    json!({
        "type": "hello",
        "id": page.id,
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

/// What to do about a fault: the last column of its row in the book.
fn remedy(code: u8) -> &'static str {
    const PAGE: &str = include_str!("../../../docs/troubleshooting.md");
    let is_its = |line: &&str| {
        let head = line.strip_prefix("| ").and_then(|rest| rest.split_whitespace().next());
        head.is_some_and(|head| head.parse() == Ok(code))
    };
    let line = PAGE.lines().find(is_its).unwrap_or_default();
    line.trim_end_matches([' ', '|']).rsplit('|').next().unwrap_or_default().trim()
}

/// What changes.
fn state(page: &Page, seen: &mut Seen) -> String {
    let App { hub, scale, .. } = &*page.app;
    let rows = hub.history().rows();
    let view = {
        let looks = page.looks();
        json!({ "end": looks.view.end, "paused": looks.paused, "met": looks.watch.met, "rows": rows })
    };
    let (owner, asking, pages) = {
        let seats = page.app.seats();
        (seats.owner(), seats.asking(), seats.pages())
    };
    let handle = hub.seen().map(|seen| {
        json!({
            "position_m": seen.position_m, "finger_n": seen.finger_n, "enabled": seen.enabled, "speed": seen.speed,
        })
    });
    let known = hub.known();
    let from = seen.line;
    let lines: Vec<_> = known.lines.iter().filter(|line| line.number > from).collect();
    seen.line = lines.last().map_or(from, |line| line.number);
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
        "record": record,
        "settings": known.settings,
        "status": known.status,
        "version": known.version,
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
