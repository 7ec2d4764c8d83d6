//! The connection to one page. The page's messages are read at once, even while data waits to be sent.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use axum::extract::ws::{Message, WebSocket};
use futures_util::{
    SinkExt as _, StreamExt as _,
    stream::{SplitSink, SplitStream},
};
use live::{
    access::MESSAGES_PER_S,
    message::Question,
    page::{Page, TICK},
};
use serde_json::json;
use tokio::{
    sync::{OwnedSemaphorePermit, mpsc},
    time::{MissedTickBehavior, interval},
};

use super::App;

/// Serves a page until it is closed.
pub async fn run(app: Arc<App>, socket: WebSocket, _place: OwnedSemaphorePermit) {
    let page = Page::enter(&app.shared);
    let (to, from) = socket.split();
    let (tell, told) = mpsc::channel(16);
    tokio::select! {
        () = read(&app, &page, from, tell) => {}
        () = write(&page, to, told) => {}
        () = silence(&page) => {}
    }
    page.leave();
}

/// Returns when the page's script has not answered for too long, even if the page's socket accepts data.
async fn silence(page: &Page) {
    let mut look = interval(TICK);
    while !page.is_gone() {
        look.tick().await;
    }
}

async fn read(
    app: &Arc<App>,
    page: &Page,
    mut from: SplitStream<WebSocket>,
    tell: mpsc::Sender<String>,
) {
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
            // Sent by the browser, even if the page's script hangs.
            Message::Ping(_) | Message::Pong(_) => continue,
            Message::Binary(_) | Message::Close(_) => return,
        };
        match page.take(&text) {
            Ok(None) => {}
            Ok(Some(question)) => answer(app, question, &tell),
            Err(refused) => {
                let _ = tell.try_send(refused);
            }
        }
    }
}

/// Computes the prediction in the background, and sends it when its walk has ended.
fn answer(app: &Arc<App>, question: Question, tell: &mpsc::Sender<String>) {
    let (app, tell) = (Arc::clone(app), tell.clone());
    tokio::spawn(async move {
        if let Some(predicted) = app.predict(question).await {
            let message = json!({ "type": "predicted", "predicted": &*predicted });
            let _ = tell.send(message.to_string()).await;
        }
    });
}

type To = SplitSink<WebSocket, Message>;

async fn write(page: &Page, mut to: To, mut told: mpsc::Receiver<String>) {
    let mut tick = interval(TICK);
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    if to.send(Message::Text(page.hello().into())).await.is_err() {
        return;
    }
    loop {
        let sent = tokio::select! {
            _ = tick.tick() => show(page, &mut to).await,
            Some(text) = told.recv() => to.send(Message::Text(text.into())).await,
            else => return,
        };
        if sent.is_err() {
            return;
        }
    }
}

async fn show(page: &Page, to: &mut To) -> Result<(), axum::Error> {
    let tick = page.tick();
    for bytes in tick.pictures {
        to.feed(Message::Binary(bytes.into())).await?;
    }
    if let Some(state) = tick.state {
        to.feed(Message::Text(state.into())).await?;
    }
    to.flush().await
}
