//! The board behind TCP ports, as other tools use it.

use std::{
    io::{Read as _, Write as _},
    net::TcpStream,
    thread,
    time::{Duration, Instant},
};

use host_sim::scene::NamedScene;
use virtual_board::{
    board::NUCLEO_F446RE,
    link::{
        COMMANDS, LOG, Link as _, REPLIES, RttTcp, TELEMETRY,
        serve::{Ports, Server},
    },
    log::Decoder,
    session::Session,
};
use zwidth::telemetry;

use crate::firmware::Firmware;

fn server() -> Server {
    let Firmware { board, elf, table, .. } = Firmware::of(NUCLEO_F446RE);
    let scene = NamedScene::load(board.name).unwrap();
    Server::start(Session { board, scene, elf, table }, None, Ports::default()).unwrap()
}

/// Reads until the text contains `wanted`, for 60 s at most.
fn until(link: &mut RttTcp, channel: usize, text: &mut Vec<u8>, wanted: &str) {
    let end = Instant::now() + Duration::from_secs(60);
    while !String::from_utf8_lossy(text).contains(wanted) {
        assert!(Instant::now() < end, "{wanted}: {}", String::from_utf8_lossy(text));
        assert_eq!(link.lost(), None);
        link.read(channel, text);
        thread::sleep(Duration::from_millis(1));
    }
}

/// Commands get their replies, and the log repeats the replies. Every byte of the telemetry belongs to a frame. The
/// board runs in real time. A second client waits until the first client has disconnected.
#[test]
fn three_ports_are_a_board() {
    let server = server();
    let mut link = RttTcp::connect(&format!("127.0.0.1:{}", server.port)).unwrap();
    let (mut log, mut replies, mut frames) = (vec![], vec![], vec![]);
    link.read(TELEMETRY, &mut frames);
    let commands = b"zero\nk 200\nb 2\nwall 0.005\narm\n";
    assert_eq!(link.write(COMMANDS, commands), commands.len());
    until(&mut link, REPLIES, &mut replies, "ok arm");
    // The board is never faster than real time. The board may be slower if other programs need the processor.
    let begun = Instant::now();
    let before = server.board.wires.seen().time_s;
    let mut ran_s = 0.0;
    while ran_s < 0.3 {
        thread::sleep(Duration::from_millis(20));
        ran_s = server.board.wires.seen().time_s - before;
        let here_s = begun.elapsed().as_secs_f64();
        assert!(ran_s < here_s + 0.05 && here_s < 30.0, "{ran_s} s in {here_s} s");
    }
    assert!(server.board.wires.seen().enabled);
    link.write(COMMANDS, b"disarm\n");
    until(&mut link, REPLIES, &mut replies, "ok disarm");
    link.read(TELEMETRY, &mut frames);

    let table = Firmware::of(NUCLEO_F446RE).table;
    let replies = String::from_utf8(replies).unwrap();
    let said: Vec<&str> = replies.lines().filter(|line| line.starts_with("ok")).collect();
    assert!(said.len() >= 6, "{replies}");
    // The log of a busy machine comes later.
    let end = Instant::now() + Duration::from_secs(60);
    loop {
        link.read(LOG, &mut log);
        let logged = Decoder::new(&table).feed(&log).unwrap();
        let of_log: Vec<&String> = logged.iter().filter(|line| line.starts_with("ok")).collect();
        if of_log.len() >= said.len() || Instant::now() > end {
            assert_eq!(said, of_log);
            break;
        }
        thread::sleep(Duration::from_millis(1));
    }

    let mut decoder = telemetry::Decoder::new();
    let found = frames.iter().filter(|byte| decoder.push(**byte).is_some()).count();
    assert!(found > 100, "{found} frames");
    assert_eq!((decoder.dropped, decoder.garbage), (0, 0));

    let mut second = TcpStream::connect(("127.0.0.1", server.port + 2)).unwrap();
    second.set_read_timeout(Some(Duration::from_millis(50))).unwrap();
    assert!(second.read(&mut [0; 64]).is_err(), "two owners");
    drop(link);
    let mut commands = TcpStream::connect(("127.0.0.1", server.port)).unwrap();
    second.set_read_timeout(Some(Duration::from_millis(500))).unwrap();
    let (mut text, mut bytes) = (String::new(), [0; 64]);
    let end = Instant::now() + Duration::from_secs(60);
    while !text.contains("ok version") && !text.contains("ok zwidth") {
        assert!(Instant::now() < end, "{text}");
        commands.write_all(b"version\n").unwrap();
        // The first reply can go to the first client, if the port of the replies still serves it.
        let count = second.read(&mut bytes).unwrap_or(0);
        text.push_str(&String::from_utf8_lossy(&bytes[..count]));
    }
}

/// A port that is in use or not valid gives an error of one line.
#[test]
fn a_port_that_is_taken_is_named() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port();
    let Firmware { board, elf, table, .. } = Firmware::of(NUCLEO_F446RE);
    let scene = NamedScene::load(board.name).unwrap();
    let started =
        Server::start(Session { board, scene, elf, table }, None, Ports { rtt: port, gdb: None });
    let error = started.err().unwrap().to_string();
    assert!(error.contains(&format!("--rtt {port}")), "{error}");
    for address in ["nowhere", "127.0.0.1:65535", "127.0.0.1:x"] {
        assert!(RttTcp::connect(address).err().unwrap().contains("is no HOST:PORT"), "{address}");
    }
}
