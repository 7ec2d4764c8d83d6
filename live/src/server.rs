//! The HTTP and WebSocket server. It listens on the loopback interface only.

mod socket;
#[cfg(test)]
mod tests;

use std::{
    collections::HashMap,
    net::Ipv4Addr,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering::Relaxed},
    },
    time::Duration,
};

use axum::{
    Router,
    extract::{Path, Query, Request, State, WebSocketUpgrade},
    http::{HeaderMap, HeaderValue, StatusCode, header},
    middleware::{self, Next},
    response::{IntoResponse, Response},
    routing::get,
};
use host_sim::{
    error::Error,
    interrupt,
    output::terminal::{note, print_text},
};
use live::{
    access::{Access, MESSAGE_MAX, PAGES_MAX},
    hub::lock,
    message::Question,
    page::Shared,
    predicted::{Predicted, predict},
};
use tokio::{net::TcpListener, sync::Semaphore};

/// Time between two checks whether the pages still answer.
const LOOK: Duration = Duration::from_millis(20);
/// Largest number of rows that a saved table may have.
const ROWS_MAX: u64 = 200_000;
/// Largest number of predictions that are stored.
const PREDICTIONS: usize = 200;

macro_rules! assets {
    ($($name:literal: $kind:literal),*) => {
        /// Name, media type and content of each file that the server offers.
        const ASSETS: &[(&str, &str, &[u8])] = &[
            $(($name, $kind, include_bytes!(concat!("../assets/", $name)))),*
        ];
    };
}

assets! {
    "style.css": "text/css", "uPlot.min.css": "text/css", "uPlot.iife.min.js": "text/javascript",
    "app.js": "text/javascript", "connect.js": "text/javascript", "link.js": "text/javascript", "plots.js": "text/javascript",
    "plane.js": "text/javascript", "handle.js": "text/javascript", "console.js": "text/javascript",
    "field.js": "text/javascript",
    "save.js": "text/javascript", "units.js": "text/javascript", "uPlot.LICENSE": "text/plain"
}
const PAGE: &str = include_str!("../assets/index.html");
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; \
                      img-src 'self' data: blob:; connect-src 'self'; form-action 'none'; base-uri 'none'; \
                      frame-ancestors 'none'";

pub struct App {
    shared: Arc<Shared>,
    access: Access,
    /// Limits the number of sockets.
    room: Arc<Semaphore>,
    predictions: Mutex<HashMap<String, Arc<Predicted>>>,
    predicting: Semaphore,
    ended: AtomicBool,
}

impl App {
    /// The simulator's prediction. For each combination of estimator and cutoff, the boundary is walked only once.
    async fn predict(self: &Arc<Self>, question: Question) -> Option<Arc<Predicted>> {
        let Question { estimator, cutoff_hz } = question;
        let key = format!("{estimator} {cutoff_hz}");
        let _turn = self.predicting.acquire().await.ok()?;
        if let Some(found) = lock(&self.predictions).get(&key) {
            return Some(Arc::clone(found));
        }
        let app = Arc::clone(self);
        let walk = move || {
            let Shared { scene, device, .. } = &*app.shared;
            predict(scene, device.as_ref(), &estimator, cutoff_hz, &app.ended)
        };
        let found = Arc::new(tokio::task::spawn_blocking(walk).await.ok()?);
        let mut all = lock(&self.predictions);
        if all.len() >= PREDICTIONS {
            all.clear();
        }
        all.insert(key, Arc::clone(&found));
        Some(found)
    }
}

/// Serves until the program is interrupted.
///
/// # Errors
/// The port is already in use.
pub fn serve(shared: Shared, port: u16) -> Result<(), Error> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .map_err(|error| Error::Internal(error.to_string()))?;
    let served = runtime.block_on(async {
        let (app, listener) = open(shared, port).await?;
        print_text(&app.access.address())?;
        note("open this address in a browser on this machine; end with Ctrl-C");
        listen(app, listener).await
    });
    runtime.shutdown_timeout(Duration::from_millis(100));
    served
}

async fn open(shared: Shared, port: u16) -> Result<(Arc<App>, TcpListener), Error> {
    let taken = |error: std::io::Error| Error::Input(format!("--port {port}: {error}"));
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port)).await.map_err(taken)?;
    let port = listener.local_addr().map_err(taken)?.port();
    let mut secret = [0; 16];
    getrandom::fill(&mut secret).map_err(|error| Error::Internal(error.to_string()))?;
    let app = Arc::new(App {
        shared: Arc::new(shared),
        access: Access::new(secret, port),
        room: Arc::new(Semaphore::new(PAGES_MAX)),
        predictions: Mutex::default(),
        predicting: Semaphore::new(1),
        ended: AtomicBool::new(false),
    });
    Ok((app, listener))
}

async fn listen(app: Arc<App>, listener: TcpListener) -> Result<(), Error> {
    let with_state = || Arc::clone(&app);
    let router = Router::new()
        .route("/", get(([(header::CONTENT_TYPE, "text/html; charset=utf-8")], PAGE)))
        .route("/ws", get(upgrade))
        .route("/rows.csv", get(rows))
        .layer(middleware::from_fn_with_state(with_state(), with_token))
        .route("/assets/{name}", get(asset))
        .layer(middleware::from_fn_with_state(with_state(), only_here))
        .with_state(with_state());
    tokio::select! {
        ended = axum::serve(listener, router) => ended.map_err(|error| Error::Internal(error.to_string())),
        ended = attend(&app) => ended,
    }
}

/// Checks whether the pages still answer. Returns when the program is to end.
async fn attend(app: &App) -> Result<(), Error> {
    let mut look = tokio::time::interval(LOOK);
    loop {
        look.tick().await;
        let Shared { hub, .. } = &*app.shared;
        hub.attend(app.shared.seats().attended_until());
        if interrupt::is_requested() {
            app.ended.store(true, Relaxed);
            return interrupt::check();
        }
    }
}

/// Refuses each request whose host is not a name of this machine.
async fn only_here(State(app): State<Arc<App>>, request: Request, next: Next) -> Response {
    if !app.access.is_our_host(text(request.headers(), header::HOST)) {
        return (StatusCode::FORBIDDEN, "another host").into_response();
    }
    let mut response = next.run(request).await;
    for (name, value) in [
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::X_FRAME_OPTIONS, "DENY"),
        (header::CACHE_CONTROL, "no-store"),
    ] {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    response
}

fn text(headers: &HeaderMap, name: header::HeaderName) -> Option<&str> {
    headers.get(name).and_then(|value| value.to_str().ok())
}

type Words = Query<HashMap<String, String>>;

/// Requires the secret token for all files but the public ones.
async fn with_token(
    State(app): State<Arc<App>>,
    words: Words,
    request: Request,
    next: Next,
) -> Response {
    if app.access.is_our_token(words.get("token").map(String::as_str)) {
        return next.run(request).await;
    }
    let why = "open the address that cargo live has printed: its token is missing or wrong";
    (StatusCode::FORBIDDEN, why).into_response()
}

async fn asset(Path(name): Path<String>) -> Response {
    match ASSETS.iter().find(|(known, ..)| *known == name) {
        Some((_, kind, bytes)) => ([(header::CONTENT_TYPE, *kind)], *bytes).into_response(),
        None => StatusCode::NOT_FOUND.into_response(),
    }
}

/// Answers with the rows of a view. The query has `from` and `rows`.
async fn rows(State(app): State<Arc<App>>, words: Words) -> Response {
    let number = |name: &str| words.get(name).and_then(|word| word.parse::<u64>().ok());
    let (Some(from), Some(count)) = (number("from"), number("rows").filter(|n| *n <= ROWS_MAX))
    else {
        let text = format!("from=N and rows=N, at most {ROWS_MAX}");
        return (StatusCode::BAD_REQUEST, text).into_response();
    };
    ([(header::CONTENT_TYPE, "text/csv")], app.shared.table(from, count)).into_response()
}

/// Opens a socket, but only to pages of this server.
async fn upgrade(
    State(app): State<Arc<App>>,
    headers: HeaderMap,
    upgrade: WebSocketUpgrade,
) -> Response {
    if !app.access.is_our_origin(text(&headers, header::ORIGIN)) {
        return (StatusCode::FORBIDDEN, "another origin").into_response();
    }
    let Ok(place) = Arc::clone(&app.room).try_acquire_owned() else {
        let text = format!("{PAGES_MAX} pages are open already");
        return (StatusCode::SERVICE_UNAVAILABLE, text).into_response();
    };
    upgrade
        .max_message_size(MESSAGE_MAX)
        .max_frame_size(MESSAGE_MAX)
        .on_upgrade(move |socket| socket::run(app, socket, place))
}
