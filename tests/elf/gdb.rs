//! Tests the port of `cargo board serve` for gdb, packet by packet. .ci/clients tests this port with gdb itself.

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
        COMMANDS, Link as _, REPLIES, RttTcp,
        serve::{Ports, Server},
    },
    mcu::{AfterHalt, Stops},
    session::Session,
};

use crate::firmware::Firmware;

fn session() -> Session {
    let Firmware { board, elf, table, .. } = Firmware::of(NUCLEO_F446RE);
    let scene = NamedScene::load(board.name).unwrap();
    Session { board, scene, elf, table }
}

struct Gdb(TcpStream);

impl Gdb {
    fn attach(server: &Server) -> Self {
        let stream = TcpStream::connect(("127.0.0.1", server.gdb.unwrap())).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        Self(stream)
    }

    fn send(&mut self, packet: &str) {
        let sum = packet.bytes().fold(0u8, u8::wrapping_add);
        write!(self.0, "${packet}#{sum:02x}").unwrap();
    }

    /// The next packet, with repeated characters expanded.
    fn reply(&mut self) -> String {
        let mut bytes = vec![];
        while bytes.iter().rev().nth(2) != Some(&b'#') {
            let mut byte = [0];
            self.0.read_exact(&mut byte).unwrap();
            if !bytes.is_empty() || byte[0] == b'$' {
                bytes.push(byte[0]);
            }
        }
        write!(self.0, "+").unwrap();
        let packet = bytes[1..bytes.len() - 3].to_vec();
        let (mut text, mut rest) = (String::new(), packet.into_iter());
        while let Some(byte) = rest.next() {
            match byte {
                b'*' => {
                    let last = text.chars().last().unwrap();
                    text.extend((0..rest.next().unwrap() - 29).map(|_| last));
                }
                byte => text.push(char::from(byte)),
            }
        }
        text
    }

    fn ask(&mut self, packet: &str) -> String {
        self.send(packet);
        self.reply()
    }
}

/// Reads until the text contains `wanted`, for 60 s at most.
fn until(link: &mut RttTcp, wanted: &str) -> String {
    let (end, mut text) = (Instant::now() + Duration::from_secs(60), vec![]);
    while !String::from_utf8_lossy(&text).contains(wanted) {
        assert!(Instant::now() < end, "{wanted}: {}", String::from_utf8_lossy(&text));
        link.read(REPLIES, &mut text);
        thread::sleep(Duration::from_millis(1));
    }
    String::from_utf8(text).unwrap()
}

/// A client halts the board only when the client sends something. Then core and plant are halted, and the force is off
/// at once. The client can write all memory that it can read, except flash. Fault 32 follows when the core runs again,
/// as after any debugger's halt.
#[test]
fn a_halt_takes_the_force_away() {
    let server = Server::start(session(), None, Ports { rtt: 0, gdb: Some(0) }).unwrap();
    let mut link = RttTcp::connect(&format!("127.0.0.1:{}", server.port)).unwrap();
    link.write(COMMANDS, b"zero\nk 200\nb 2\nwall 0.005\narm\n");
    until(&mut link, "ok arm");
    let mut gdb = Gdb::attach(&server);
    let before = server.board.wires.seen();
    thread::sleep(Duration::from_millis(300));
    let now = server.board.wires.seen();
    assert!(now.enabled && now.time_s > before.time_s + 0.02, "{before:?} {now:?}");

    let first = gdb.ask("?");
    assert!(first.starts_with("S05") || first.starts_with("T05"), "{first}");
    thread::sleep(Duration::from_millis(30));
    let halted = server.board.wires.seen();
    assert!(!halted.enabled, "{halted:?}");
    let registers = gdb.ask("g");
    assert_eq!(registers.len(), 2 * 4 * (16 + 1 + 6 + 32 + 1));
    thread::sleep(Duration::from_millis(30));
    assert_eq!(server.board.wires.seen().position_m, halted.position_m);
    assert_eq!(gdb.ask("g"), registers, "the core stands");
    assert_eq!(gdb.ask("me0042000,4"), "21040000", "the chip's id");
    assert_eq!(gdb.ask("m60000000,4"), "E0e", "there is nothing");
    assert_eq!(gdb.ask("M8000000,4:00000000"), "E1e", "flash");
    assert_eq!(gdb.ask("M2001f000,8:0123456789abcdef"), "OK");
    assert_eq!(gdb.ask("m2001f000,8"), "0123456789abcdef");
    assert_eq!(gdb.ask("M40007408,4:00090000"), "OK", "the DAC's code");
    assert_eq!(gdb.ask("m40007408,2"), "0009");

    gdb.send("D");
    assert_eq!(gdb.reply(), "OK");
    link.write(COMMANDS, b"faults\n");
    let said = until(&mut link, "ok faults");
    assert!(said.contains("faults 32 (debugger halt)"), "{said}");
    assert!(!server.board.wires.seen().enabled);
}

/// A hand moves the handle. A run with halts gives the same counts, sample by sample, as a run without halts. The halts
/// have different lengths and begin at different times within a step of the plant.
#[test]
fn core_and_plant_stand_still_together() {
    let session = session();
    let run = |halts: bool| {
        let mut world = session.boot().unwrap();
        world.powered.mcu.take_counter_readings();
        world.lead(0.1);
        for n in 0..100 {
            if halts && n % 3 == 0 {
                let stops = Stops { step: Some(0..0), ..Stops::default() };
                for _ in 0..n {
                    world.sample_until_met(&stops).unwrap();
                }
                let halted = world.begin_halt();
                world.stay_halted(1_000 + 7 * n);
                world.end_halt(&halted, AfterHalt::Kept);
            }
            world.sample().unwrap();
        }
        world.powered.mcu.take_counter_readings()
    };
    let (whole, halted) = (run(false), run(true));
    let steps = whole.windows(2).filter(|pair| pair[0] != pair[1]).count();
    assert!(steps > 80, "the handle moves");
    assert_eq!(whole[..90], halted[..90]);
}
