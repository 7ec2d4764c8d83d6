//! Tests what keeps control, with a client on the server's socket and the firmware's library as the board.

use std::{
    io::{Read as _, Write as _},
    net::TcpStream,
    thread,
    time::Instant,
};

use host_sim::scene::NamedScene;
use live::hub::Hub;
use serde_json::{Value, json};
use virtual_board::{board::NUCLEO_F446RE, link::CoreBoard};

use super::*;

/// Time within which a page whose script does not answer loses control.
const IN_TIME: Duration = Duration::from_secs(3);
const TEXT: u8 = 1;
const PONG: u8 = 10;

/// A WebSocket.
struct Client(TcpStream);

impl Client {
    /// `address` is the page's address.
    fn open(address: &str) -> Self {
        let (host, token) = address["http://".len()..].split_once("/?").unwrap();
        let mut stream = TcpStream::connect(host).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
        let key = "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==";
        write!(
            stream,
            "GET /ws?{token} HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\n\
             Connection: Upgrade\r\nUpgrade: websocket\r\n{key}\r\n\r\n"
        )
        .unwrap();
        let mut head = vec![];
        while !head.ends_with(b"\r\n\r\n") {
            head.push(0);
            stream.read_exact(head.last_mut().map(std::slice::from_mut).unwrap()).unwrap();
        }
        assert!(head.starts_with(b"HTTP/1.1 101"), "{}", String::from_utf8_lossy(&head));
        Self(stream)
    }

    /// Sends at most 125 bytes. The mask is 0, so the bytes stay as they are. The server may have closed the socket.
    fn send(&mut self, kind: u8, data: &str) {
        let length = u8::try_from(data.len()).unwrap();
        assert!(length < 126);
        let frame = [&[0x80 | kind, 0x80 | length, 0, 0, 0, 0], data.as_bytes()].concat();
        let _ = self.0.write_all(&frame);
    }

    fn command(&mut self, line: &str) {
        self.send(TEXT, &json!({ "type": "command", "line": line }).to_string());
    }

    /// The next state. `None` if the server has closed the socket.
    fn state(&mut self) -> Option<Value> {
        loop {
            let mut head = [0; 2];
            self.0.read_exact(&mut head).ok()?;
            let mut length = [0; 8];
            let more = [0, 2, 8][usize::from(head[1].saturating_sub(125))];
            self.0.read_exact(&mut length[8 - more..]).ok()?;
            let length = if more == 0 { u64::from(head[1]) } else { u64::from_be_bytes(length) };
            let mut data = vec![0; usize::try_from(length).ok()?];
            self.0.read_exact(&mut data).ok()?;
            if head[0] == 0x80 | TEXT {
                let message: Value = serde_json::from_slice(&data).unwrap();
                if message["type"] == "state" {
                    return Some(message);
                }
            }
        }
    }
}

/// A client arms the board, and from then on answers the server's numbers in that way. Pings it answers always. Returns
/// whether it has control, and whether the force is on, in the end.
fn kept(answer: impl Fn(u64) -> Option<u64>) -> (bool, bool) {
    let scene = NamedScene::load(NUCLEO_F446RE.name).unwrap();
    let mut board = CoreBoard::start(&scene, NUCLEO_F446RE).unwrap();
    let wires = Arc::clone(&board.wires);
    let (hub, talk) = Hub::start(Box::new(wires.link()), Some(wires), None, None);
    let shared = Shared::new(Arc::clone(&hub), scene, NUCLEO_F446RE, None);
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let (app, listener) = runtime.block_on(open(shared, 0)).unwrap();
    let server = runtime.spawn({
        let app = Arc::clone(&app);
        async move { listen(app, listener).await }
    });
    thread::spawn(move || {
        while !talk.is_finished() {
            board.millisecond(1.0);
            thread::sleep(Duration::from_millis(1));
        }
    });
    let mut client = Client::open(&app.access.address());
    client.command("arm");
    let mut begun: Option<Instant> = None;
    while begun.is_none_or(|begun| begun.elapsed() < IN_TIME)
        && let Some(state) = client.state()
    {
        if state["record"]["armed"] == true {
            begun.get_or_insert_with(Instant::now);
        }
        let number = state["number"].as_u64().unwrap();
        let answered = if begun.is_some() { answer(number) } else { Some(number) };
        client.send(PONG, "");
        if let Some(number) = answered {
            client.send(TEXT, &json!({ "type": "alive", "number": number }).to_string());
        }
    }
    let begun = begun.expect("the board is armed");
    thread::sleep(IN_TIME.saturating_sub(begun.elapsed()));
    let found = (app.shared.seats().owner.is_some(), hub.known().is_on());
    hub.end();
    server.abort();
    found
}

/// The numbers prove that the page's script runs. A browser answers pings also for a page whose script hangs.
#[test]
fn a_page_keeps_control_while_its_script_answers() {
    thread::scope(|scope| {
        let cases = [
            ("it answers", scope.spawn(|| kept(Some)), true),
            ("it answers pings only", scope.spawn(|| kept(|_| None)), false),
            ("with an old number", scope.spawn(|| kept(|number| number.checked_sub(1))), false),
            ("with a number that was not asked", scope.spawn(|| kept(|n| Some(n + 1))), false),
        ];
        for (what, case, keeps) in cases {
            assert_eq!(case.join().unwrap(), (keeps, keeps), "{what}");
        }
    });
}
